"""The numbers of a terrain study: what was varied, and the errors of planar models, trackers and load formulas."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ssmr.models.table import PLANAR_MODELS
from ssmr.types import FloatArray, Trajectory
from validation.plants.profile import Profile
from validation.simulator.description import Robot
from validation.simulator.terrain import FLAT, Terrain
from validation.simulator.wheel_loads import MEASURED, QUASI_STATIC
from validation.study.result import require_seeds

PLANAR = PLANAR_MODELS
AxisName = Literal["speed", "slope", "roughness", "friction"]

AXES: Mapping[AxisName, tuple[str, str, float]] = {
    "speed": ("speed on level ground", "m/s", 1.0),
    "slope": ("slope", "deg", 180.0 / math.pi),
    "roughness": ("rms height of rough ground", "mm", 1e3),
    "friction": ("friction lost right of an edge", "%", 100.0),
}
"""Name of each quantity that grows, the unit in which it is shown, and how many of those make one SI unit."""
BASE: Mapping[AxisName, float] = {"speed": 0.5, "slope": 0.0, "roughness": 0.0, "friction": 0.0}
"""Value on each axis that the thesis' experiments have [SI]."""
TRACKED = "generic"
"""Reference of the closed loops."""


@dataclass(frozen=True)
class TerrainAxes:
    """The values that a terrain study drives, and the trackers that it tests."""

    speeds: tuple[float, ...] = (0.2, 0.35, 0.5, 0.7, 0.85, 1.0)
    """Speeds on level ground [m/s]."""
    slopes: tuple[float, ...] = tuple(map(math.radians, (0.0, 1.0, 2.0, 4.0, 7.0, 10.0)))
    """Slopes of ramps [rad]."""
    heights: tuple[float, ...] = (0.0, 0.0005, 0.001, 0.002, 0.004, 0.008)
    """Root mean square heights of rough ground [m]."""
    lost: tuple[float, ...] = (0.0, 0.1, 0.2, 0.4, 0.6, 0.8)
    """Shares of the friction that one side has lost [1]."""
    directions: tuple[float, ...] = tuple(map(math.radians, (0.0, 90.0, 180.0, 270.0)))
    """Headings in which ramps rise [rad]."""
    controllers: tuple[str, ...] = ("pid", "lqr")
    """Trackers, with their tuned gains."""

    def __post_init__(self) -> None:
        """Raise a ValueError for an axis without values."""
        for axis in AXES:
            if not self.values(axis):
                raise ValueError(f"there are no values of {axis}")

    def values(self, axis: AxisName) -> tuple[float, ...]:
        """Return the values on an axis [SI]."""
        by_axis = {"speed": self.speeds, "slope": self.slopes, "roughness": self.heights, "friction": self.lost}
        return by_axis[axis]


_ALL_AXES = TerrainAxes()


@dataclass(frozen=True)
class TerrainOptions:
    """Options of the study of terrain."""

    profile: str | Profile | None = None
    """Robot: name of a shipped profile, or path of a TOML file."""
    horizon: float = 6.0
    """Time after which relative poses are compared [s]."""
    seeds: int = 3
    """Number of rough grounds of each height."""
    seed: int = 0
    """Seed of the first rough ground, and of noise."""
    axes: TerrainAxes = _ALL_AXES
    """Values to drive; only from Python."""
    robot: str | Robot | None = None
    """Robot: its name or the path of its file; the profile's if none is named."""

    def __post_init__(self) -> None:
        """Raise a ValueError for no seeds, or a horizon longer than the trajectories."""
        require_seeds(self)
        if not 0.0 < self.horizon <= 20.0:
            raise ValueError(f"horizon {self.horizon:g} s must be positive and within the trajectories' 20 s")

    def grounds(self, axis: AxisName, value: float) -> list[Terrain]:
        """Return the grounds that belong to one value: ramps in every direction, or several grounds of one roughness."""
        if axis == "slope" and value > 0.0:
            return [Terrain("ramp", slope=value, toward=d) for d in self.axes.directions]
        if axis == "roughness" and value > 0.0:
            return [Terrain("rough", height=value, seed=self.seed + k) for k in range(self.seeds)]
        if axis == "friction" and value > 0.0:  # where the edge runs the other way, left and right change sides
            return [Terrain("split", friction_ratio=1.0 - value, edge_heading=h) for h in (0.0, math.pi)]
        return [FLAT]


@dataclass(frozen=True)
class ModelErrors:
    """The errors of one planar model at one value of one axis."""

    axis: AxisName
    """Quantity that grows."""
    value: float
    """Value of that quantity [SI]."""
    plant: str
    """Name of the planar model."""
    position_m: float | None
    """Median error of the position after the horizon [m]; None where every MuJoCo run failed."""
    yaw_rad: float | None
    """Median error of the heading after the horizon [rad]; None where every MuJoCo run failed."""
    d_rms_m: float | None
    """Mean d_rms over whole runs [m]; None where every MuJoCo run failed."""
    failed: int
    """Number of runs in which the MuJoCo robot fell over or the simulator gave up."""


@dataclass(frozen=True)
class TrackerErrors:
    """The errors of one tracker on the MuJoCo robot at one value of one axis."""

    axis: AxisName
    """Quantity that grows."""
    value: float
    """Value of that quantity [SI]."""
    controller: str
    """Name of the tracker."""
    d_rms_m: float | None
    """Mean d_rms over the grounds [m]; None where it lost the reference on all of them."""
    lost: int
    """Number of grounds on which it lost the reference."""


@dataclass(frozen=True, eq=False)
class LoadRun:
    """The wheel loads of one manoeuvre."""

    terrain: Terrain
    """Ground of the manoeuvre."""
    motion: Trajectory
    """Motion of the MuJoCo robot, with its simulated and its quasi-static loads as channels."""

    def errors(self, static: FloatArray) -> tuple[float, float, float]:
        """Return root mean squares [N] of the simulated loads about their mean, and from static and quasi-static loads."""
        simulated = self.motion.channels[MEASURED]
        formulas = (simulated.mean(), static, self.motion.channels[QUASI_STATIC])
        spread, from_static, from_quasi_static = (float(np.sqrt(np.mean((simulated - f) ** 2))) for f in formulas)
        return spread, from_static, from_quasi_static
