"""One robot that followed a reference: its run, the reference, metrics and options."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ssmr.control.loop import VELOCITY_PERIOD, ClosedRun
from ssmr.control.lqr import V_LIMIT, W_LIMIT
from ssmr.control.tick import LOST
from ssmr.control.waypoints import ALPHA_SWITCH, Waypoints
from ssmr.metrics.declared import (
    METRICS,
    Metric,
    Metrics,
    command_measures,
    compare_paths,
    cross_track_max,
)
from ssmr.types import Trajectory
from validation.output import Document

_AT_LIMIT = 0.999
"""Share of a limit from which a torque or a command counts as saturated."""
_LIMITED = {
    "side_torque_limit_N_m": ("torque_left", "torque_right"),
    "v_max_m_s": ("v_cmd",),
    "w_max_rad_s": ("w_cmd",),
}
"""Names of the limits among the options of a result, and the columns of the log that each holds
for."""

_LOOP_METRICS = (
    Metric(
        "e_rho_rms_m",
        "e_rho rms",
        "m",
        "low",
        "root mean square of the distance to the moving target, as the controller sees it; "
        "it is negative behind",
    ),
    Metric(
        "e_y_rms_m", "e_y rms", "m", "low", "root mean square of the target's offset to the left"
    ),
    Metric(
        "e_alpha_rms_rad",
        "e_alpha rms",
        "rad",
        "low",
        "root mean square of the reference's heading less the robot's; "
        f"it counts as zero where the target is farther than {ALPHA_SWITCH:g} m",
    ),
    Metric(
        "u_rms_ratio",
        "speed over reference",
        "1",
        "one",
        "root mean square of the robot's speed over that of the reference, "
        "its mean where it is steady (Sec. 4.4.3)",
    ),
    Metric(
        "saturated_fraction",
        "time at a limit",
        "share",
        "low",
        "share of time in which a torque or a command was at its limit",
    ),
    Metric(
        "cross_track_max_m",
        "cross track",
        "m",
        "low",
        "greatest distance of the robot from the path of its reference, "
        f"within {LOST:g} m of way from its target",
    ),
    Metric(
        "command_effort",
        "effort",
        "1",
        "low",
        "root mean square of the commands, speed and yaw rate each as a share of its limit",
    ),
    Metric(
        "command_jerk",
        "jerk",
        "1/s²",
        "low",
        "root mean square of the second derivative in time of the commands as such shares: "
        "how restless they are",
    ),
    Metric(
        "dead_time_learnt_s",
        "learnt",
        "s",
        "low",
        "time by which the robot answers later than its controller's driver, as it was learnt",
    ),
    Metric(
        "rest_off_m",
        "rest",
        "m",
        "low",
        "distance from the last waypoint at which the robot rests behind the reference's end",
    ),
)
TRACK_METRICS: Mapping[str, Metric] = {
    **METRICS,
    **{metric.name: metric for metric in _LOOP_METRICS},
}
"""Metrics of a robot that follows a reference, by name: those of its path, then those of the
loop."""
MOST_BESIDE = 5
"""Greatest number of robots that can be told apart in one picture or recording."""
OF_THE_PATH = (
    "d_rms_m",
    "d_haus_m",
    "d_ratio",
    "e_bend_ratio",
    "sync_rms_m",
    "yaw_rms_rad",
    "cross_track_max_m",
    "rest_off_m",
)
"""Metrics of each robot that compare its motion with the reference."""
OF_THE_LOOP = (
    *("e_rho_rms_m", "e_y_rms_m", "e_alpha_rms_rad", "u_rms_ratio", "saturated_fraction"),
    *("command_effort", "command_jerk", "dead_time_learnt_s"),
)
"""Metrics of each robot that the controller's errors and commands give."""


@dataclass(frozen=True, eq=False)
class Followed:
    """One robot that followed a reference under a controller."""

    plant: str
    """Name of the plant that was the robot."""
    run: ClosedRun
    """The log of the run, tick by tick."""
    target: Trajectory
    """The reference at the ticks of the run."""
    metrics: Metrics
    """Metrics by name, see `TRACK_METRICS`; of a tuning the `cost`, too."""
    options: Document
    """Feedback, disturbance, look-ahead, periods and limits."""
    cpu_s: float = 0.0
    """Time of a processor that simulating took [s]."""

    @classmethod
    def of(
        cls,
        plant: str,
        run: ClosedRun,
        waypoints: Waypoints,
        options: Document,
        cpu_s: float = 0.0,
    ) -> Followed:
        """Return a robot whose run ends with its reference, see `track_metrics`."""
        metrics = track_metrics(run, waypoints, options)
        run = run.until(waypoints.duration)
        return cls(plant, run, reference_of(run, waypoints), metrics, options, cpu_s)

    @property
    def real_time_factor(self) -> float:
        """Simulated time over a processor's [1]."""
        simulated = float(self.run.t[-1]) if len(self.run.t) else 0.0
        return simulated / max(self.cpu_s, 1e-9)

    def as_dict(self) -> Document:
        """Return the metrics, whether the robot was lost, and how long simulating took."""
        return {
            **self.metrics,
            "lost": self.run.lost,
            "cpu_s": self.cpu_s,
            "real_time_factor": self.real_time_factor,
        }


def find_saturated(run: ClosedRun, limits: Document) -> NDArray[np.bool_]:
    """Return (M,) whether a torque or a command was at its limit, by the options of a result."""
    at_limit = np.zeros(len(run.t), dtype=np.bool_)
    for name, columns in _LIMITED.items():
        limit = limits.get(name, math.inf)
        at_limit |= (np.abs(run.columns(*columns)) >= _AT_LIMIT * limit).any(axis=1)
    return at_limit


def reference_of(run: ClosedRun, waypoints: Waypoints, *, whole: bool = False) -> Trajectory:
    """Return the reference at the ticks of a run, to the run's end, or with `whole` to its own."""
    n = len(run.t)
    period = float(run.t[1] - run.t[0]) if n > 1 else waypoints.duration
    full = waypoints.trajectory(period)
    if whole:
        return full
    return Trajectory(full.t[:n], full.pose[:n], full.twist[:n], full.wheels[:n])


def track_metrics(run: ClosedRun, waypoints: Waypoints, limits: Document) -> Metrics:
    """Return the metrics of a run; one that was lost is compared with the whole reference.

    What comes behind the reference's end counts only for where the robot rests.

    Args:
        run: at least one tick.
        waypoints: the reference.
        limits: the greatest torque of a side, speed and yaw rate, by their names among the options
            of a result, and the period of commands, `velocity_period_s`, if it is not the default.
            A limit that is off counts as the thesis' (1 m/s, 2 rad/s).
    """
    *_, end = run.columns("x", "y")
    rest_off = math.dist(end, waypoints.xy[-1])
    learnt = run.column("dead_time_learnt")
    rests = run.t[-1] > waypoints.duration + run.t[1]
    run = run.until(waypoints.duration)

    def rms(name: str) -> float:
        return float(np.sqrt(np.mean(np.square(run.column(name)))))

    def number(name: str, default: float) -> float:
        value = limits.get(name, default)
        return value if math.isfinite(value) else default

    along = np.cumulative_sum(waypoints.lengths, include_initial=True)
    aims = np.interp(run.t, waypoints.t - waypoints.t[0], along)
    period = number("velocity_period_s", VELOCITY_PERIOD)
    # a command is in the log from the first tick at or after its time
    given = np.arange(0.0, run.t[-1] + 1e-9, period)
    rows = np.minimum(np.searchsorted(run.t, given - 1e-9), len(run.t) - 1)
    largest = np.array([number("v_max_m_s", V_LIMIT), number("w_max_rad_s", W_LIMIT)])
    shares = run.columns("v_cmd", "w_cmd")[rows] / largest
    effort, jerk = command_measures(shares, period)
    cross_track = cross_track_max(run.columns("x", "y"), waypoints.xy, along, aims, LOST)
    return Metrics(
        {
            **compare_paths(run.motion, reference_of(run, waypoints, whole=True)),
            "e_rho_rms_m": rms("e_rho"),
            "e_y_rms_m": rms("e_y"),
            "e_alpha_rms_rad": rms("e_alpha"),
            "u_rms_ratio": rms("v_x") / max(waypoints.rms_speed, 1e-9),
            "saturated_fraction": float(np.mean(find_saturated(run, limits))),
            "cross_track_max_m": cross_track,
            "command_effort": effort,
            "command_jerk": jerk,
            # nothing was learnt by a law without a predictor
            "dead_time_learnt_s": float(learnt[-1]) if learnt.any() else math.nan,
            "rest_off_m": rest_off if rests else math.nan,
        }
    )


def lost_text(run: ClosedRun) -> str:
    """Return the time and place where a robot was lost; empty for one that was not."""
    if not run.lost:
        return ""
    if not len(run.t):
        return "lost at once"
    away = math.hypot(*(run.columns("target_x", "target_y")[-1] - run.columns("x", "y")[-1]))
    return f"lost at t = {run.t[-1]:.2f} s, {away:.2f} m from its target"
