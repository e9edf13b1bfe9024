"""What single columns of a log show to be wrong, whatever the motion was.

One column twice, one that keeps its value, numbers that are too large, wheels or a pose that follow
from other columns as no sensor does.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from ssmr.geometry import integrate_rates
from ssmr.types import FloatArray, IndexArray
from validation.files.columns import POSE_COLUMNS, column_of, trust_in
from validation.files.log import LogFault
from validation.files.motion import (
    ENCODERS,
    ODOMETRY,
    TWIST,
    NewPoses,
    Way,
    motion_by_sensor,
)
from validation.files.sensors import MOST_WINDOWS, Signals
from validation.files.signals import TIME_ROUNDOFF, sturdy_fit

_MOVES = 0.1
"""Rate from which a robot moves [m/s, rad/s]."""


def same_columns(e: Signals) -> Iterator[LogFault]:
    """Both wheels from one column, although the robot turns."""
    if e.wheels is not None and e.turning is not None and np.array_equal(*e.wheels):
        if np.mean(np.abs(e.turning) > _MOVES) > 0.1:
            sentence = "enc_left and enc_right are the same numbers, although the robot turns"
            yield LogFault("same", ENCODERS, sentence)


def set_points(e: Signals) -> Iterator[LogFault]:
    """Wheel rates that follow from the commands exactly, as set points do."""
    wheels = e.log.group_of(ENCODERS)
    commands = e.log.group_of(TWIST)
    if wheels is None or commands is None:
        return
    now = np.searchsorted(commands.t, wheels.t, side="right") - 1
    rates = np.column_stack([wheels.columns[name] for name in ENCODERS])[now >= 0]
    twists = np.column_stack([commands.columns[name] for name in TWIST])
    moving = np.any(rates != 0.0, axis=1)
    size = np.std(rates, axis=0)
    # a logger may write a command a few samples before the set points that follow from it
    asked = [twists[np.maximum(now[now >= 0] - late, 0)] for late in range(4)]
    # what holds exactly shows in a few thousand rows of a log of hours
    some = slice(None, None, 1 + len(rates) // MOST_WINDOWS)
    for basis in asked[:2]:
        factors = np.column_stack([sturdy_fit(basis[some], side) for side in rates[some].T])
        rest = np.min([np.abs(told @ factors - rates) for told in asked], axis=0)
        if min(size) > 0.1 and np.all(np.percentile(rest[moving], 98.0, axis=0) < 1e-3 * size):
            sentence = (
                "enc_left and enc_right follow from cmd_v and cmd_w exactly: they are set points, "
                "and not what encoders measured"
            )
            yield LogFault("setpoints", ENCODERS, sentence)
            return


_FROZEN = 0.2
"""Share of the windows with motion from which a column that keeps its value is frozen [1];
localisers stall for less."""
_STAYS = 1.5
"""Time for which a value stays the same, over the length of a window, from which it is kept [1]."""


def frozen(e: Signals) -> Iterator[LogFault]:
    """Columns that keep their value for long while others say that the robot moves."""
    speeds, turns = motion_by_sensor(e.means)
    told = [*speeds.items(), *turns.items()]
    kept_for = []
    for name, values in e.log.columns.items():
        own = column_of(name).group
        others = [rates for sensor, rates in told if sensor != own]
        known = column_of(name).usual < math.inf or name in POSE_COLUMNS
        # joysticks command nothing; currents and accelerations are noisy
        if not others or not known or name in TWIST or (name not in e.means and np.ptp(values)):
            continue
        size = np.nan_to_num(np.abs(others))
        moves = np.median(size, axis=0) > _MOVES
        kept = np.ones(len(moves), dtype=bool)
        if name in e.means:
            kept = stuck_samples(e, name, "frozen") > 0.95
            if name in ENCODERS and np.any(values):
                # where both sides stand, the robot may be pushed, or its localiser moves alone
                side = ENCODERS[name == ENCODERS[0]]
                kept &= (e.means[name] != 0.0) | (e.means.get(side, 1.0) != 0.0)
        if name not in POSE_COLUMNS:  # a rate may stay the same where the others do
            varies = np.median(np.abs(np.diff(others, append=math.nan)), axis=0) > 0.3 * _MOVES
            moves &= varies | (e.means.get(name, 0.0) == 0.0)
        n = np.count_nonzero(moves & kept)
        if n > max(5, _FROZEN * np.count_nonzero(moves)):
            kept_for.append(name)
    if kept_for:
        names = ", ".join(kept_for).replace(
            "yaw", "yaw (numbers of a quaternion in another order?)"
        )
        words = "the same value in much of the time in which the robot moves: " + names
        yield LogFault("frozen", tuple(kept_for), words)


def stuck_samples(e: Signals, name: str, kind: str) -> FloatArray:
    """Return (N,) shares of windows in which a column is clipped at its bound, or frozen."""
    group = e.log.groups[column_of(name).group]
    values = group.columns[name]
    stays = np.abs(values) > (1.0 - 1e-4) * (np.max(np.abs(values)) + 1e-9)
    if kind == "frozen":
        new = np.flatnonzero(np.diff(values, prepend=math.nan) != 0.0)
        kept = np.diff(group.t[new], append=group.t[-1]) > _STAYS * e.windows.width
        kept &= ~stays[new] | (name in POSE_COLUMNS) | (len(new) == 1)
        stays = np.repeat(kept, np.diff(new, append=len(values)))
    way = {name: (group.t, integrate_rates(group.t, stays.astype(np.float64)))}
    return e.windows.means_of(way, column_of(name).group)[name]


def degrees_of_latitude(e: Signals) -> Iterator[LogFault]:
    """Positions that are degrees on the earth: far from zero, and in a spot that is tiny."""
    ways = [told.speed for told in e.told.values() if told.speed is not None]
    if not ways or not e.log.has(("x", "y")):
        return
    xy = np.array([e.log.columns[name] for name in ("x", "y")])
    extent = float(np.max(np.ptp(xy, axis=1)))
    on_earth = np.all(np.abs(xy) <= 180.0) and np.max(np.abs(xy)) > 1e3 * extent
    if on_earth and 0.0 < extent < 0.1 and np.median(np.abs(ways[0])) > _MOVES * extent:
        sentence = (
            f"x and y keep within {extent:.2g} about {np.mean(xy[0]):.4g} and {np.mean(xy[1]):.4g} "
            "while the wheels drive: they are degrees of latitude and longitude; metres east and "
            "north are wanted"
        )
        yield LogFault("scale", ("x", "y"), sentence)


def too_large(e: Signals) -> Iterator[LogFault]:
    """Numbers that are larger than a robot's can be."""
    for name, values in e.log.columns.items():
        column = column_of(name)
        greatest = float(np.abs(values).max())
        if greatest > column.usual:
            sentence = (
                f"{name} reaches {greatest:.4g} {column.unit}, "
                f"more than {column.usual:g}: it may be in {column.others}"
            )
            yield LogFault("scale", (name,), sentence)


# ------------------------------------------------------------------------------------------
# a pose that follows
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
_QUIET = 1.5e-4
"""Noise of a sample [m, rad] that no localiser reaches: half of that of motion capture."""
_OWN = 0.7
"""Noise of what is left over, over that of poses, below which these have none of their own [1]."""
_NEARER = 0.4
"""Error of turns by wheels over that by a gyro below which a heading is made of the wheels."""
_SOUND_GYRO = 0.01
"""Error of turns of `_WINDOW_S` by a gyro that is sound [rad]."""
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

    They are the wheels and the odometry, each alone and with a gyro, and the commands. Each is
    integrated by its means, and as most robots do it: a rate times the time since the one before.
    """
    summed = {
        name: (group.t, np.cumsum(rates * np.diff(group.t, prepend=group.t[0])))
        for group in signals.log.groups.values()
        for name, rates in group.columns.items()
    }
    for names in (ENCODERS, ODOMETRY, TWIST):
        for ways in (signals.ways, summed):
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
    step = max(0.5 * window, np.ptp(t) / MOST_WINDOWS)
    starts = np.searchsorted(t, np.arange(t[0], t[-1] - window, step))
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
    """A pose that follows from other columns of its log.

    It has less noise of its own than any localiser, or follows wheels better than a gyro does.
    """
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
        short = _window_errors(poses, speeds, turns, _SHORT_S)
        measured |= errors is not None and names[0] in ENCODERS
        if errors is None or short is None:
            continue
        most = _FOLLOWS_TWIST if own else _FOLLOWS
        follows = max(errors) < most and (
            max(short) < 0.3 * most if own else _has_no_noise(poses, short)
        )
        way = f"{1e3 * errors[0]:.1f} mm and {math.degrees(errors[1]):.2f} deg in 6 s"
        if names == ENCODERS and not follows and "gyro_z" in e.ways:
            t, turned = e.ways["gyro_z"]
            gyro = [(t, turned), (t, t)]
            by_gyro = _window_errors(poses, speeds, gyro, _SHORT_S)
            long = _window_errors(poses, speeds, gyro, _WINDOW_S)
            if by_gyro is not None and long is not None and long[1] < _SOUND_GYRO:
                follows = short[1] < _NEARER * by_gyro[1] and short[1] < errors[1]
                way = (
                    f"{1e3 * short[1]:.2f} mrad in {_SHORT_S:g} s, and from the gyro to "
                    f"{1e3 * by_gyro[1]:.2f}"
                )
        if follows:
            sentence = (
                f"x, y and yaw follow from {' and '.join(names)} to {way}: the pose "
                "is their integral, and says nothing of how the robot moved; take the pose of a "
                "localiser"
            )
            yield LogFault("circular", POSE_COLUMNS, sentence)
            return


def _has_no_noise(poses: NewPoses, left: tuple[float, float]) -> bool:
    """Return whether poses have less noise than a localiser's, or no more than their digits.

    Or theirs is that of the rates: what is `left` over of ways [m] and turns [rad] has less.
    """
    steps = np.abs(np.diff(poses.pose, axis=0))
    rough = np.median(np.abs(np.diff(poses.pose, 3, axis=0)), axis=0) / 3.0
    least = [np.min(column[column > 0.0], initial=1.0) for column in steps.T]
    quiet = rough < np.maximum(_QUIET, 0.6 * np.array(least))
    ways = np.all(quiet[:2]) or left[0] < _OWN * float(max(rough[:2]))
    turns = quiet[2] or left[1] < _OWN * float(rough[2])
    return bool(ways and turns)


FACTS = (circular, same_columns, set_points, degrees_of_latitude, frozen)
"""The tests that come before signals are compared, in their order."""
