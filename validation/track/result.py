"""What a comparison, a fit, a tracked reference or a tuning found: frozen values that programs make and sinks take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ssmr.control.loop import ClosedRun
from ssmr.control.waypoints import ALPHA_SWITCH
from ssmr.metrics.declared import METRICS, Metric, Metrics
from ssmr.types import Trajectory
from validation.robots.terrain import FLAT, Terrain

TRACK_METRICS: Mapping[str, Metric] = {
    **METRICS,
    **{metric.name: metric for metric in (
        Metric(
            "e_rho_rms_m", "e_rho rms", "m", "low",
            "root mean square of the distance to the moving target, as the controller sees it; it is negative behind",
        ),
        Metric("e_y_rms_m", "e_y rms", "m", "low", "root mean square of the target's offset to the left"),
        Metric(
            "e_alpha_rms_rad", "e_alpha rms", "rad", "low",
            "root mean square of the reference's heading less the robot's; "
            f"it counts as zero where the target is farther than {ALPHA_SWITCH:g} m",
        ),
        Metric(
            "u_rms_ratio", "u rms ratio", "1", "one",
            "root mean square of the robot's speed over the mean speed of the reference (Sec. 4.4.3)",
        ),
        Metric(
            "saturated_fraction", "saturated", "share", "low",
            "share of time in which a torque or a command was at its limit",
        ),
    )},
}  # fmt: skip
"""Metrics of a robot that follows a reference, by name: those of its path, then those of the loop."""


@dataclass(frozen=True, eq=False)
class TrackResult:
    """A robot that followed a reference under a controller."""

    controller: str
    """`pid`, `lqr`, `lqr-scheduled` or `smc`."""
    gains_name: str
    """Name or file of the gain set."""
    gains: Mapping[str, float]
    """By name."""
    reference: str
    """As the user named it."""
    speed: float
    """Mean speed of the reference [m/s]."""
    plant: str
    """Which plant was the robot."""
    profile: str
    """Name of the profile that gave its parameters."""
    seed: int
    """Of noise and disturbance."""
    run: ClosedRun
    """What happened, tick by tick."""
    target: Trajectory
    """The reference at the same ticks."""
    metrics: Metrics
    """How well."""
    wall_s: float
    """Time that simulating took [s]."""
    options: Mapping[str, object]
    """How it was run: feedback, disturbance, look-ahead, periods."""
    versions: Mapping[str, str]
    """Of this project, Python and the packages that decide numbers."""
    terrain: Terrain = FLAT
    """What a MuJoCo Husky stood on."""
