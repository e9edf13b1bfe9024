"""Whether a pose is nothing but the integral of wheels, commands or odometry.

A controller's odometry, a table of dead reckoning and a filter of wheels alone follow from them to
a few millimetres and milliradians. A localiser does not: wheels slip, and sensors have noise.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from ssmr.types import FloatArray, IndexArray
from validation.files.columns import POSE_COLUMNS, column_of, trust_in
from validation.files.log import LogFault
from validation.files.motion import ENCODERS, ODOMETRY, TWIST, NewPoses, Way
from validation.files.sensors import Signals
from validation.files.signals import TIME_ROUNDOFF

_WINDOW_S = 6.0
"""Length of the windows over which ways and turns are compared [s]."""
_FEWEST = 8
"""Number of windows with motion from which they tell anything."""
_MOVED = 0.03
"""Mean speed [m/s] or yaw rate [rad/s] in a window from which the robot moved."""
_SHORT_S = 0.6
"""Length of the windows that show the noise of a localiser [s]."""
_FOLLOWS = 0.004
"""Error of a way [m] and of a turn [rad] of `_WINDOW_S` below which they follow from rates: wheels
that slip make more."""
_NOISELESS = 0.001
"""The same of `_SHORT_S`: less than the noise of a localiser."""
_FOLLOWS_TWIST = 0.015
"""The same for the speeds in the messages of the poses themselves, which are only some of those
that were integrated."""
_MOST_LAG = 0.4
"""Longest delay between poses and rates that is tried [s]."""
_FINER = (0.02, 0.01, 0.005, 0.0025, 0.00125)
"""Steps in which the best delay is refined [s]."""


_Ways = Sequence[Way]
"""Sums of rates from which something may follow, each times a factor."""


def _possible_origins(signals: Signals) -> Iterator[tuple[tuple[str, ...], _Ways, _Ways]]:
    """Yield columns from which poses may follow, their sums for ways and those for turns.

    They are the wheels and the odometry, each alone and with a gyro, and the commands.
    """
    ways = signals.ways
    for names in (ENCODERS, ODOMETRY, TWIST):
        if not {*names} <= ways.keys():
            continue
        own = [ways[name] for name in names]
        yield names, own, own
        if "gyro_z" in ways and names != TWIST:
            t, turned = ways["gyro_z"]
            yield (*names, "gyro_z"), own, [(t, turned), (t, t)]


def _window_errors(
    poses: NewPoses, speeds: _Ways, turns: _Ways, window: float
) -> tuple[float, float] | None:
    """Return the median errors of ways [m] and turns [rad] of a window that rates tell.

    The factors of the rates, and the delays of positions and headings behind them, are those that
    fit best. None where the robot hardly moves.

    Args:
        poses: the new poses.
        speeds: sums that their ways may follow from.
        turns: sums that their turns may follow from.
        window: length of the windows [s].
    """
    start = max(stamps[0] for stamps, _ in (*speeds, *turns))
    stop = min(stamps[-1] for stamps, _ in (*speeds, *turns))
    inside = (poses.t > start + _MOST_LAG) & (poses.t < stop - _MOST_LAG)
    t = poses.t[inside]
    if len(t) < _FEWEST:
        return None
    x, y, yaw = poses.pose[inside].T
    half = 0.5 * np.diff(yaw)
    middle = yaw[:-1] + half
    # arcs: a chord times what bends it
    chords = np.diff(x) * np.cos(middle) + np.diff(y) * np.sin(middle)
    arcs = chords / np.sinc(np.clip(half / np.pi, -0.5, 0.5))
    way = np.cumulative_sum(arcs, include_initial=True)
    starts = np.searchsorted(t, np.arange(t[0], t[-1] - window, 0.5 * window))
    ends = np.searchsorted(t, t[starts] + window - TIME_ROUNDOFF)
    ends = np.minimum(ends, len(t) - 1)
    spans = np.column_stack([starts, ends])[t[ends] - t[starts] < 1.2 * window]
    if len(spans) < _FEWEST:
        return None
    along = _median_error(t, way, spans, speeds)
    turned = _median_error(t, yaw, spans, turns)
    return None if along is None or turned is None else (along, turned)


def _median_error(
    t: FloatArray, values: FloatArray, spans: IndexArray, ways: _Ways
) -> float | None:
    """Return the median error with which (M,) values at (M,) stamps [s] follow from sums of rates.

    `spans` has the (W, 2) first and last samples of windows. None where the values hardly change.
    """
    rises = np.diff(values[spans])[:, 0]
    moved = np.abs(rises) > _MOVED * np.median(np.diff(t[spans]))
    if np.count_nonzero(moved) < _FEWEST:
        return None

    def error(lag: float) -> float:
        at = t[spans] + lag
        design = np.column_stack([np.diff(np.interp(at, *way))[:, 0] for way in ways])
        rest = np.abs(design @ np.linalg.lstsq(design, rises)[0] - rises)
        return float(np.median(rest[moved]))

    lag = min(np.arange(-_MOST_LAG, _MOST_LAG + 0.01, 0.04).tolist(), key=error)
    for step in _FINER:
        lag = min((lag - step, lag, lag + step), key=error)
    return error(lag)


def circular(e: Signals) -> Iterator[LogFault]:
    """A pose that follows from other columns of its log."""
    poses = e.poses
    if poses is None or trust_in(poses.group.source) <= 1:
        return
    measured = False
    for names, speeds, turns in _possible_origins(e):
        source = e.log.groups[column_of(names[0]).group].source
        own = bool(e.log.topics) and source == poses.group.source
        if own and measured:
            continue  # a localiser tells its own speed, and wheels do not follow
        errors = _window_errors(poses, speeds, turns, _WINDOW_S)
        measured |= errors is not None and names[0] in ENCODERS
        most = _FOLLOWS_TWIST if own else _FOLLOWS
        if errors is None or max(errors) > most:
            continue
        noise = _window_errors(poses, speeds, turns, _SHORT_S)
        if noise is None or max(noise) < max(_NOISELESS, 0.3 * most):
            sentence = (
                f"x, y and yaw follow from {' and '.join(names)} to "
                f"{1e3 * errors[0]:.1f} mm and {math.degrees(errors[1]):.2f} deg in 6 s: the pose "
                "is their integral, and says nothing of how the robot moved; take the pose of a "
                "localiser"
            )
            yield LogFault("circular", POSE_COLUMNS, sentence)
            return
