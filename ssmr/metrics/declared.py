"""Every metric, declared once: its name, unit, meaning, what is wanted of it, and how it is computed and pooled.

A metric of paths is one row of `METRICS`, one of a signal at equal times one row of `SIGNALS`.
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
from ssmr.metrics.paths import BENDING_FLOOR, LARGEST, LENGTH_FLOOR, PathMeasures, measure_paths
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
    wanted: Literal["low", "one", "high"]
    """Direction in which it is better: towards zero, towards one, or upwards."""
    meaning: str
    """One sentence without its end, for the legend of a report."""


@dataclass(frozen=True)
class PathMetric(Metric):
    """A metric of a candidate's path against a reference's."""

    of: Callable[[PathMeasures, tuple[float, float]], Any]
    """Part of the measures of one piece's path, or of its errors at equal times, that it is made
    of."""
    pool: Callable[[Sequence[Any], Sequence[int]], float]
    """Value over all pieces, from those parts and the numbers of samples of the reference."""


@dataclass(frozen=True)
class SignalMetric(Metric):
    """A root mean square difference of a signal at equal times."""

    of: Callable[[Trajectory], FloatArray | None]
    """The (M,) or (M, k) signal of a motion; None where the motion does not know it."""


class Metrics(dict[str, float]):
    """Values by the name of their metric; a KeyError for one that there is not lists all."""

    def __missing__(self, name: str) -> float:
        """Raise the KeyError."""
        raise KeyError(f"no metric '{name}'; there are: {', '.join(self)}")


def _mean_square(values: Sequence[float], samples: Sequence[int]) -> float:
    """Pool root mean squares: their squares are averaged, weighted by the reference's samples."""
    if len(values) == 1:
        return values[0]
    return math.sqrt(
        np.average([value**2 for value in values], weights=np.array(samples, dtype=np.float64))
    )


def _greatest(values: Sequence[float], samples: Sequence[int]) -> float:
    return max(values)


def _ratio_of_totals(
    floor: float,
) -> Callable[[Sequence[tuple[float, float]], Sequence[int]], float]:
    """Pool amounts of candidate and reference: add them up, then take the ratio; two amounts under `floor` are equal."""

    def pool(amounts: Sequence[tuple[float, float]], samples: Sequence[int]) -> float:
        candidate, reference = map(float, np.sum(amounts, axis=0))
        return 1.0 if candidate < floor and reference < floor else candidate / max(reference, floor)

    return pool


METRICS: Mapping[str, PathMetric] = MappingProxyType({metric.name: metric for metric in (
    PathMetric(
        "d_rms_m", "d_rms", "m", "low",
        "root mean square, over the reference's samples, of the distance to the closest sample of the robot's path; "
        "one-sided: leaving the reference's path after having covered it costs nothing",
        lambda m, sync: m.d_rms, _mean_square,
    ),
    PathMetric(
        "d_haus_m", "d_haus", "m", "low",
        "the largest of those distances, the one-sided Hausdorff distance from the reference to the robot's path",
        lambda m, sync: m.d_haus, _greatest,
    ),
    PathMetric(
        "d_ratio", "d_ratio", "1", "one",
        "length of the robot's path over that of the reference; above 1 the robot drives farther",
        lambda m, sync: m.lengths, _ratio_of_totals(LENGTH_FLOOR),
    ),
    PathMetric(
        "e_bend_ratio", "e_bend ratio", "1", "one",
        "bending energy (curvature squared, summed along the path) of the robot's path over that of the reference; "
        "above 1 the robot's path is more curved",
        lambda m, sync: m.bendings, _ratio_of_totals(BENDING_FLOOR),
    ),
    PathMetric(
        "d_rms_symmetric_m", "d_rms sym", "m", "low",
        "d_rms of both directions, from the reference to the robot and back, each with the same weight",
        lambda m, sync: m.d_rms_symmetric, _mean_square,
    ),
    PathMetric(
        "d_haus_symmetric_m", "d_haus sym", "m", "low",
        "the larger of the Hausdorff distances of both directions",
        lambda m, sync: m.d_haus_symmetric, _greatest,
    ),
    PathMetric(
        "sync_rms_m", "sync rms", "m", "low",
        "root mean square of the distance between robot and reference at the same instant",
        lambda m, sync: sync[0], _mean_square,
    ),
    PathMetric(
        "yaw_rms_rad", "yaw rms", "rad", "low",
        "root mean square of the difference between the headings of robot and reference at the same instant, wrapped",
        lambda m, sync: sync[1], _mean_square,
    ),
)})  # fmt: skip
"""Metrics of a candidate's path, by name, in the order of all tables. Ratios are candidate over
reference."""


def _torques(motion: Trajectory) -> FloatArray | None:
    """The sides' torques; a motion whose torques are all zero comes from a model without motors."""
    torques = motion.channels.get("torque_N_m")
    return torques if torques is not None and np.any(torques) else None


SIGNALS: Mapping[str, SignalMetric] = MappingProxyType({metric.name: metric for metric in (
    SignalMetric(
        "yaw_rate_rms_rad_s", "yaw rate rms", "rad/s", "low",
        "root mean square of the difference between the yaw rates at the same instant; it sees delays, and inertia in quick "
        "turns",
        lambda motion: motion.twist[:, 2],
    ),
    SignalMetric(
        "yaw_acceleration_rms_rad_s2", "yaw acc rms", "rad/s²", "low",
        "the same of the yaw accelerations; it sees models that tremble",
        lambda motion: motion.channels.get("yaw_acceleration_rad_s2"),
    ),
    SignalMetric(
        "torque_rms_N_m", "torque rms", "N m", "low",
        "the same of the motors' torques, over both sides; it sees friction and inertia",
        _torques,
    ),
)})  # fmt: skip
"""Metrics of signals at equal times, by name. They see the dynamics, which paths hardly show."""


def compare_signals(candidates: Sequence[Trajectory], references: Sequence[Trajectory]) -> Metrics:
    """Return those of `SIGNALS` that all of the motions know, over several stretches that nothing joins.

    Candidates are interpolated linearly; a reference's stamps beyond a candidate's span are left
    out.

    Raises:
        ValueError: not as many candidates as references, or a span without a stamp of the
            reference.
    """
    pairs = list(zip(candidates, references, strict=True))
    samples, metrics = [len(r) for r in references], Metrics()
    for name, metric in SIGNALS.items():
        signals = [(metric.of(c), metric.of(r)) for c, r in pairs]
        known = [(a, b) for a, b in signals if a is not None and b is not None]
        if known and len(known) == len(pairs):
            parts = [
                _signal_rms(c.t, a, r.t, b) for (c, r), (a, b) in zip(pairs, known, strict=True)
            ]
            metrics[name] = _mean_square(parts, samples)
    return metrics


def _signal_rms(
    t: FloatArray, candidate: FloatArray, stamps: FloatArray, reference: FloatArray
) -> float:
    """Return the root mean square difference of two signals at the stamps of the second."""
    inside = common_stamps(t, stamps)
    columns = (
        candidate.reshape(len(t), -1).T,
        reference[inside].reshape(np.count_nonzero(inside), -1).T,
    )
    off = [
        np.interp(stamps[inside], t, mine) - wanted for mine, wanted in zip(*columns, strict=True)
    ]
    return math.sqrt(np.mean(np.square(off)))


def common_stamps(t: FloatArray, stamps: FloatArray) -> NDArray[np.bool_]:
    """Return which of a reference's `stamps` [s] lie within the span of a candidate's stamps `t` [s].

    Raises:
        ValueError: none does.
    """
    inside: NDArray[np.bool_] = (stamps >= t[0] - TIME_TOLERANCE) & (
        stamps <= t[-1] + TIME_TOLERANCE
    )
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
    """All of `METRICS` over several stretches that nothing joins, such as a recording with gaps.

    Raises:
        ValueError: not as many candidates as references, none at all, or what `compare_paths`
            raises.
    """
    pairs = list(zip(candidates, references, strict=True))
    if not pairs:
        raise ValueError("there is nothing to compare")
    measured = [(measure_paths(c.pose, r.pose), equal_times_rms(c, r)) for c, r in pairs]
    if any(math.isnan(paths.d_rms) for paths, _ in measured):
        raise ValueError(f"a coordinate is beyond {LARGEST} m")
    samples = [len(r) for r in references]
    return Metrics(
        {
            name: metric.pool([metric.of(*m) for m in measured], samples)
            for name, metric in METRICS.items()
        }
    )


def equal_times_rms(candidate: Trajectory, reference: Trajectory) -> tuple[float, float]:
    """Return the root mean squares of the distance [m] and of the wrapped heading difference [rad] at equal stamps.

    The candidate is interpolated linearly, yaw the short way round; the reference's stamps beyond
    its span are left out.

    Raises:
        ValueError: no stamp of the reference lies within the candidate's span.
    """
    t, last = candidate.t, len(candidate.t) - 1
    inside = common_stamps(t, reference.t)
    at, wanted = reference.t[inside], reference.pose[inside]
    before = np.clip(np.searchsorted(t, at, side="right") - 1, 0, last)
    after = np.minimum(before + 1, last)
    share = np.clip(
        (at - t[before]) / np.where(after > before, t[after] - t[before], 1.0), 0.0, 1.0
    )
    step = candidate.pose[after] - candidate.pose[before]
    step[:, 2] = wrap_angle(step[:, 2])
    off = candidate.pose[before] + share[:, None] * step - wanted
    distances, turns = np.sum(off[:, :2] ** 2, axis=1), wrap_angle(off[:, 2]) ** 2
    return math.sqrt(np.mean(distances)), math.sqrt(np.mean(turns))


@jit_alone
def cross_track_max(
    xy: FloatArray, path: FloatArray, along: FloatArray, aims: FloatArray, reach: float
) -> float:
    """Return the greatest distance of a robot from the path beside its target [m]; zero where there are no samples.

    The path is the polyline of the (N, 2) waypoints `path` [m], `along` (N,) its length up to each.
    Of a path that crosses itself only the part near the target counts, so a robot that drives on
    another branch is not on its way: `aims` (M,) are its length up to the target of each of the (M,
    2) places `xy`, never decreasing, before and behind which `reach` of it is searched [m].
    """
    greatest, first, last = 0.0, 0, len(path) - 2
    for i in range(len(xy)):
        while first < last and along[first + 1] < aims[i] - reach:
            first += 1
        least, k = math.inf, first
        while k <= last and (along[k] <= aims[i] + reach or k == first):
            step_x, step_y = path[k + 1, 0] - path[k, 0], path[k + 1, 1] - path[k, 1]
            off_x, off_y = xy[i, 0] - path[k, 0], xy[i, 1] - path[k, 1]
            square = step_x * step_x + step_y * step_y
            share = (
                min(max((off_x * step_x + off_y * step_y) / square, 0.0), 1.0)
                if square > 0.0
                else 0.0
            )
            least = min(least, (off_x - share * step_x) ** 2 + (off_y - share * step_y) ** 2)
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
    jerk = math.sqrt(float(np.mean(np.sum(bends**2, axis=1)))) if len(bends) else 0.0
    return math.sqrt(float(np.mean(np.sum(shares**2, axis=1)))), jerk
