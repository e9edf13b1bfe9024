"""What a comparison, a fit, a tracked reference or a tuning found: frozen values that programs make and sinks take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ssmr.control.loop import ClosedRun
from ssmr.metrics.paths import PathMetrics
from ssmr.types import Trajectory
from validation.robots.terrain import FLAT, Terrain


@dataclass(frozen=True)
class TrackMetrics:
    """How well a reference was followed: the thesis' figures, and those that see time and errors."""

    path: PathMetrics
    """Distances of the robot's path from the reference, and errors at equal times."""
    e_rho_rms_m: float
    """Root mean square of the signed distance to the target [m]."""
    e_y_rms_m: float
    """Of the offset across [m]."""
    e_alpha_rms_rad: float
    """Of the heading error, zero beyond 0.4 m from the target [rad]."""
    u_rms_ratio: float
    """Root mean square of speed over the reference's mean speed [1] (Sec. 4.4.3)."""
    saturated_fraction: float
    """Share of time in which a side's torque, or a command, was at its limit [1]."""


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
    metrics: TrackMetrics
    """How well."""
    wall_s: float
    """Time that simulating took [s]."""
    options: Mapping[str, object]
    """How it was run: feedback, disturbance, look-ahead, periods."""
    versions: Mapping[str, str]
    """Of this project, Python and the packages that decide numbers."""
    terrain: Terrain = FLAT
    """What a MuJoCo Husky stood on."""
