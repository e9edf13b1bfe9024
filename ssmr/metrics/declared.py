"""Every metric, declared once: name, unit, meaning, direction, computation and pooling.

A metric of paths is one row of `_PATH_METRICS`, one of a signal at equal times one row of
`_SIGNAL_METRICS`.
Tables, pictures, reports and JSON files read these tables, so a new metric is one new row.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ssmr._jit import jit_alone
from ssmr.geometry import wrap_angle
from ssmr.metrics.paths import (
    BENDING_FLOOR,
    LARGEST,
    LENGTH_FLOOR,
    PathMeasures,
    measure_paths,
    path_segments,
    squared_distance,
)
from ssmr.metrics.windows import TIME_TOLERANCE
from ssmr.types import FloatArray, Trajectory


@dataclass(frozen=True)
class Metric:
    """The declaration of a metric."""

    name: str
    """Key in results and JSON files, with its unit: `d_rms_m`."""
    label: str
    """Heading of its column: `d_rms`."""
    unit: str
    """Unit of the value in SI; `share` is one of time, `×` a multiple of real time."""
    direction: Literal["low", "one", "high"]
    """Direction in which it is better: towards zero, towards one, or upwards."""
    meaning: str
    """One sentence without its end, for the legend of a report."""


class Metrics(dict[str, float]):
    """Values by the name of their metric; the KeyError of an unknown name lists all."""

    def __missing__(self, name: str) -> float:
        """Raise the KeyError."""
        raise KeyError(f"no metric '{name}'; there are: {', '.join(self)}")


def _mean_square(values: Sequence[float], samples: Sequence[int]) -> float:
    """Pool root mean squares: their squares are averaged, weighted by the reference's samples."""
    if len(values) == 1:
        return values[0]
    squares = [value**2 for value in values]
    return math.sqrt(np.average(squares, weights=np.array(samples, dtype=np.float64)))


def _greatest_size(values: Sequence[float], samples: Sequence[int]) -> float:
    return max(values)


def _ratio_of_totals(
    floor: float,
) -> Callable[[Sequence[tuple[float, float]], Sequence[int]], float]:
    """Pool amounts of candidate and reference: add them up, then take the ratio.

    Two amounts under `floor` are equal.
    """

    def pool(amounts: Sequence[tuple[float, float]], samples: Sequence[int]) -> float:
        candidate, reference = map(float, np.sum(amounts, axis=0))
        if candidate < floor and reference < floor:
            return 1.0
        return candidate / max(reference, floor)

    return pool


_PathMetric = tuple[
    Metric,
    Callable[[PathMeasures, tuple[float, float]], Any],
    Callable[[Sequence[Any], Sequence[int]], float],
]
_PATH_METRICS: tuple[_PathMetric, ...] = (
    (
        Metric(
            name="d_rms_m",
            label="d_rms",
            unit="m",
            direction="low",
            meaning="root mean square, over the reference's samples, of the distance to the "
            "robot's path; one-sided: leaving the reference's path after "
            "having covered it costs nothing",
        ),
        lambda m, sync: m.d_rms,
        _mean_square,
    ),
    (
        Metric(
            name="d_haus_m",
            label="d_haus",
            unit="m",
            direction="low",
            meaning="the largest of those distances, the one-sided Hausdorff distance from the "
            "reference to the robot's path",
        ),
        lambda m, sync: m.d_haus,
        _greatest_size,
    ),
    (
        Metric(
            name="d_ratio",
            label="d_ratio",
            unit="1",
            direction="one",
            meaning="length of the robot's path over that of the reference; above 1 the robot "
            "drives farther",
        ),
        lambda m, sync: m.lengths,
        _ratio_of_totals(LENGTH_FLOOR),
    ),
    (
        Metric(
            name="e_bend_ratio",
            label="e_bend ratio",
            unit="1",
            direction="one",
            meaning="bending energy (curvature squared, summed along the path) of the robot's path "
            "over that of the reference; above 1 the robot's path is more curved",
        ),
        lambda m, sync: m.bendings,
        _ratio_of_totals(BENDING_FLOOR),
    ),
    (
        Metric(
            name="d_rms_symmetric_m",
            label="d_rms sym",
            unit="m",
            direction="low",
            meaning="d_rms of both directions, from the reference to the robot and back, each "
            "with the same weight",
        ),
        lambda m, sync: m.d_rms_symmetric,
        _mean_square,
    ),
    (
        Metric(
            name="d_haus_symmetric_m",
            label="d_haus sym",
            unit="m",
            direction="low",
            meaning="the larger of the Hausdorff distances of both directions",
        ),
        lambda m, sync: m.d_haus_symmetric,
        _greatest_size,
    ),
    (
        Metric(
            name="sync_rms_m",
            label="sync rms",
            unit="m",
            direction="low",
            meaning="root mean square of the distance between robot and reference at the same "
            "instant",
        ),
        lambda m, sync: sync[0],
        _mean_square,
    ),
    (
        Metric(
            name="yaw_rms_rad",
            label="yaw rms",
            unit="rad",
            direction="low",
            meaning="root mean square of the difference between the headings of robot and "
            "reference at the same instant, wrapped",
        ),
        lambda m, sync: sync[1],
        _mean_square,
    ),
)
"""Metrics of a candidate's path against a reference's, each with the part of the measures of one
piece's path, or of its errors at equal times, that it is made of; and with the value over all
pieces, from those parts and the numbers of samples of the reference."""
METRICS: Mapping[str, Metric] = MappingProxyType({m.name: m for m, *_ in _PATH_METRICS})
"""Metrics of a candidate's path, by name, in the order of all tables. Ratios are candidate over
reference."""


def _side_torques(motion: Trajectory) -> FloatArray | None:
    """Return the sides' torques; None if all are zero, as those of a model without motors."""
    torques = motion.channels.get("torque_N_m")
    return torques if torques is not None and np.any(torques) else None


_Signal = Callable[[Trajectory], FloatArray | None]
_SIGNAL_METRICS: tuple[tuple[Metric, _Signal], ...] = (
    (
        Metric(
            "yaw_rate_rms_rad_s",
            "yaw rate rms",
            "rad/s",
            "low",
            "root mean square of the difference between the yaw rates at the same instant; it sees "
            "delays, and inertia in quick turns",
        ),
        lambda motion: motion.twist[:, 2],
    ),
    (
        Metric(
            "yaw_acceleration_rms_rad_s2",
            "yaw acc rms",
            "rad/s²",
            "low",
            "the same of the yaw accelerations; it sees models that tremble",
        ),
        lambda motion: motion.channels.get("yaw_acceleration_rad_s2"),
    ),
    (
        Metric(
            "torque_rms_N_m",
            "torque rms",
            "N m",
            "low",
            "the same of the motors' torques, over both sides; it sees friction and inertia",
        ),
        _side_torques,
    ),
)
"""Root mean square differences of signals at equal times, each with the (M,) or (M, k) signal of a
motion, which is None where the motion does not know it."""
SIGNALS: Mapping[str, Metric] = MappingProxyType({m.name: m for m, _ in _SIGNAL_METRICS})
"""Metrics of signals at equal times, by name. They see the dynamics, which paths hardly show."""


def compare_signals(candidates: Sequence[Trajectory], references: Sequence[Trajectory]) -> Metrics:
    """Return the metrics in `SIGNALS` of signals that all motions have, over separate stretches.

    Candidates are interpolated linearly; a reference's stamps beyond a candidate's span are left
    out.

    Raises:
        ValueError: not as many candidates as references, or a span without a stamp of the
            reference.
    """
    pairs = list(zip(candidates, references, strict=True))
    samples = [len(r) for r in references]
    metrics = Metrics()
    for metric, signal_of in _SIGNAL_METRICS:
        parts = []
        for candidate, reference in pairs:
            signal = signal_of(candidate)
            reference_signal = signal_of(reference)
            if signal is not None and reference_signal is not None:
                parts.append(_signal_rms(candidate.t, signal, reference.t, reference_signal))
        if parts and len(parts) == len(pairs):
            metrics[metric.name] = _mean_square(parts, samples)
    return metrics


def _signal_rms(
    t: FloatArray, candidate: FloatArray, stamps: FloatArray, reference: FloatArray
) -> float:
    """Return the root mean square difference of two signals at the stamps of the second."""
    inside = _common_stamps(t, stamps)
    at = stamps[inside]
    columns = candidate.reshape(len(t), -1).T
    reference_columns = reference[inside].reshape(len(at), -1).T
    off = [
        np.interp(at, t, column) - reference_column
        for column, reference_column in zip(columns, reference_columns, strict=True)
    ]
    return math.sqrt(np.mean(np.square(off)))


def _common_stamps(t: FloatArray, stamps: FloatArray) -> NDArray[np.bool_]:
    """Return a mask of a reference's `stamps` [s] within the span of a candidate's, `t` [s].

    Raises:
        ValueError: none is.
    """
    after_start = stamps >= t[0] - TIME_TOLERANCE
    before_end = stamps <= t[-1] + TIME_TOLERANCE
    inside: NDArray[np.bool_] = after_start & before_end
    if not inside.any():
        raise ValueError(
            f"no stamp of the reference, {stamps[0]} to {stamps[-1]} s, "
            f"lies within the candidate's span, {t[0]} to {t[-1]} s"
        )
    return inside


def compare_paths(candidate: Trajectory, reference: Trajectory) -> Metrics:
    """Return all of `METRICS` of a candidate against a reference.

    The geometric ones compare the whole paths, whatever their stamps; those at equal times the
    common span.

    Raises:
        ValueError: no stamp of the reference lies within the candidate's span, or a coordinate is
            beyond 1e75 m.
    """
    return compare_pieces([candidate], [reference])


def compare_pieces(candidates: Sequence[Trajectory], references: Sequence[Trajectory]) -> Metrics:
    """All of `METRICS` over separate stretches, such as a recording with gaps.

    Raises:
        ValueError: not as many candidates as references, none at all, or what `compare_paths`
            raises.
    """
    pairs = list(zip(candidates, references, strict=True))
    if not pairs:
        raise ValueError("there is nothing to compare")
    measured = []
    for candidate, reference in pairs:
        paths = measure_paths(candidate.pose, reference.pose)
        measured.append((paths, _equal_times_rms(candidate, reference)))
    if any(math.isnan(paths.d_rms) for paths, _ in measured):
        raise ValueError(f"a coordinate is beyond {LARGEST} m")
    samples = [len(r) for r in references]
    metrics = Metrics()
    for metric, part_of, pool in _PATH_METRICS:
        parts = [part_of(paths, sync) for paths, sync in measured]
        metrics[metric.name] = pool(parts, samples)
    return metrics


def _equal_times_rms(candidate: Trajectory, reference: Trajectory) -> tuple[float, float]:
    """Return the root mean squares of the errors of position [m] and of heading [rad].

    Headings' differences are wrapped. The candidate is interpolated linearly at the reference's
    stamps, yaw the short way round; stamps beyond its span are left out.

    Raises:
        ValueError: no stamp of the reference lies within the candidate's span.
    """
    t = candidate.t
    last = len(t) - 1
    inside = _common_stamps(t, reference.t)
    at = reference.t[inside]
    before = np.clip(np.searchsorted(t, at, side="right") - 1, 0, last)
    after = np.minimum(before + 1, last)
    interval = np.where(after > before, t[after] - t[before], 1.0)
    share = np.clip((at - t[before]) / interval, 0.0, 1.0)
    step = candidate.pose[after] - candidate.pose[before]
    step[:, 2] = wrap_angle(step[:, 2])
    pose = candidate.pose[before] + share[:, None] * step
    off = pose - reference.pose[inside]
    distances = np.sum(off[:, :2] ** 2, axis=1)
    turns = wrap_angle(off[:, 2]) ** 2
    return math.sqrt(np.mean(distances)), math.sqrt(np.mean(turns))


@jit_alone
def cross_track_max(
    xy: FloatArray, path: FloatArray, along: FloatArray, aims: FloatArray, reach: float
) -> float:
    """Return the greatest distance of a robot from the path beside its target [m].

    It is zero where there are no samples. The path is the polyline of the (N, 2) waypoints `path`
    [m], `along` (N,) its length up to each. Of a path that crosses itself only the part near the
    target counts, so a robot that drives on another branch is not on its way: `aims` (M,) are its
    length up to the target of each of the (M, 2) places `xy`, never decreasing, before and behind
    which `reach` of it is searched [m].
    """
    segments = path_segments(path)
    greatest = 0.0
    first = 0
    last = len(path) - 2
    for i in range(len(xy)):
        while first < last and along[first + 1] < aims[i] - reach:
            first += 1
        least = math.inf
        k = first
        while k <= last and (along[k] <= aims[i] + reach or k == first):
            square, _, _ = squared_distance(xy[i, 0], xy[i, 1], segments[k])
            least = min(least, square)
            k += 1
        greatest = max(greatest, least)
    return math.sqrt(greatest)


def command_measures(shares: FloatArray, period: float) -> tuple[float, float]:
    """Return effort [1] and jerk [1/s2] of a row of commands.

    The effort is the root mean square of the commands as shares of their limits; the jerk is that
    of their second derivative in time, by differences: zero for commands that grow evenly. Both add
    the squares of the two parts of a command.

    `shares` are (K, 2) commands over the limits of speed and yaw rate [1], `period` the time
    between them [s].
    """
    if len(shares) == 0:
        return math.nan, math.nan
    bends = np.diff(shares, 2, axis=0) / period**2
    return _row_rms(shares), _row_rms(bends) if len(bends) else 0.0


def _row_rms(rows: FloatArray) -> float:
    """Return the root mean square of the lengths of rows."""
    squares = np.sum(rows**2, axis=1)
    return math.sqrt(np.mean(squares))
