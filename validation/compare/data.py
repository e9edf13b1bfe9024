"""The values that a comparison finds. Tables, pictures and recordings are made from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from ssmr.metrics.declared import Metrics
from ssmr.metrics.poses import HorizonErrors
from ssmr.metrics.windows import OverlappingErrors, WindowErrors
from ssmr.robot.localiser import Localiser
from ssmr.types import Commands, IndexArray, Trajectory
from validation.show.tables import with_robot
from validation.simulator.description import Robot, load_robot
from validation.simulator.health import Health
from validation.simulator.terrain import FLAT, Terrain
from validation.simulator.wheel_loads import WheelLoads


@dataclass(frozen=True, eq=False)
class PlantResult:
    """One plant's answer to the commands."""

    name: str
    """Name of the plant, such as `improved`."""
    pieces: tuple[Trajectory, ...]
    """The plant's motion: one piece for each gap-free stretch of the source, at the stamps of the reference's piece."""
    metrics: Metrics
    """Distances from the reference, over all pieces."""
    horizons: Mapping[float, HorizonErrors]
    """Errors of the relative pose, by horizon [s]; empty where the reference is a plant."""
    wall_s: float
    """Time that simulating took [s]."""
    real_time_factor: float
    """Simulated over wall time [1]."""
    health: Health | None = None
    """The verdict on the wheel loads; only a MuJoCo robot has one, and only on even ground."""
    localiser: Localiser = Localiser()
    """The frame in the plant's body whose motion `pieces` is."""
    loads: WheelLoads | None = None
    """The loads that its wheels carried; only a MuJoCo robot knows them."""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """All numbers that define the plant, as plain values."""
    windows: Mapping[float, WindowErrors] = field(default_factory=dict)
    """Errors over windows that begin every second, by horizon [s]; empty where the reference is a plant."""

    @cached_property
    def overlapping(self) -> Mapping[float, OverlappingErrors]:
        """Medians over `windows` with their intervals, by horizon [s]."""
        return {horizon: errors.summary() for horizon, errors in self.windows.items()}


@dataclass(frozen=True, eq=False)
class ComparisonData:
    """Every plant against the reference on one source."""

    source: str
    """The source as the user named it: `traj4`, or the file of a recording."""
    profile: str
    """Name of the profile that gave the parameters."""
    reference_name: str
    """Name of the reference plant, or `recording`."""
    reference: tuple[Trajectory, ...]
    """The reference's motion, piece by piece."""
    commands: tuple[Commands, ...]
    """The commands that drove the plants, piece by piece; each begins at the first stamp of its piece."""
    plants: Mapping[str, PlantResult]
    """Results by plant, in the order of all tables; the reference plant is among them."""
    seed: int
    """Seed of noise and disturbance."""
    options: Mapping[str, Any]
    """Options of the run: input, noise, disturbance, horizons, terrain, time span."""
    versions: Mapping[str, str]
    """Versions of this project, Python and the packages that decide numbers."""
    terrain: Terrain = FLAT
    """The ground that the MuJoCo robot stood on."""
    warnings: tuple[str, ...] = ()
    """Sentences about what is wrong with the recording."""
    scoring: Mapping[float, tuple[tuple[IndexArray, IndexArray], ...]] = field(default_factory=dict)
    """Starts and ends of the scoring windows that follow one another, by horizon [s] and piece; none spans a jump of the
    localiser. Empty where the reference is a plant."""
    robot: Robot = field(default_factory=load_robot)
    """The robot that the profile is of."""

    @property
    def profile_label(self) -> str:
        """Name of the profile, and of the robot where the first does not tell the second."""
        return with_robot(self.profile, self.robot.name)
