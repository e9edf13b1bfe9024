"""The robots that a controller is tested on: mismatches, one at a time and together, and the options of the study.

A mismatch changes friction, centre of mass, dead time, sensor noise or torque limit of the profile's robot. Every controller
drives the same robots with the same noise: first each mismatch alone, under several seeds, which shows what the controller
is sensitive to; then a random sample of all combinations, which shows how its errors spread.

The torque limit of the shipped profiles (30 N m a wheel) is hardly ever reached. So the share in `LEVELS` does not refer to
that limit but to the greatest torque that the nominal robot needs when it is driven along the reference without feedback,
at the reference's own velocities. That torque depends on the mission and not on any controller.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from types import MappingProxyType
from typing import Literal

import numpy as np

from ssmr.control.laws import CONTROLLERS, PLAIN_CONTROLLERS
from ssmr.control.loop import POSITION_PERIOD, Feedback, LoopSettings
from ssmr.control.tick import LOST
from ssmr.control.waypoints import Waypoints
from ssmr.estimation.sensing import SensorModel
from ssmr.parameters import require_in_range, require_within
from ssmr.robot.drive import WHOLE_STEPS
from ssmr.robot.sensors import SensorNoise
from ssmr.robot.vehicle import Drive
from validation.plants.profile import Profile
from validation.simulator.description import Robot, load_robot
from validation.simulator.plant import MujocoPlant
from validation.study.result import MOST_RUNS, require_seeds
from validation.track.gains import GainSet
from validation.track.loops import ClosedLoopRobot, odometry_of

_COARSE_PERIOD = 0.01
"""Period of the position loop where the physics step does not divide the usual one [s]."""
NOMINAL = "nominal"
"""Label of a robot without a mismatch."""

LEVELS: Mapping[str, tuple[float, ...]] = MappingProxyType(
    {
        "friction": (1.0, 0.7, 1.3),
        "com_x": (0.0, -0.05, 0.05),
        "com_y": (0.0, -0.05, 0.05),
        "delay": (0.0, -0.1, 0.1),
        "noise": (1.0, 2.0),
        "torque": (1.0, 0.8),
    }
)
"""Values of each field of `Mismatch` that are tried on the usual robot, the nominal one first."""


def levels_of(robot: Robot) -> Mapping[str, tuple[float, ...]]:
    """Return the values that are tried on a robot: shifts of the centre of mass grow with its wheelbase and track."""
    own, usual = robot.geometry, load_robot().geometry
    sizes = {"com_x": own.wheelbase / usual.wheelbase, "com_y": own.track / usual.track}
    return MappingProxyType({n: tuple(sizes.get(n, 1.0) * value for value in values) for n, values in LEVELS.items()})


CaseKind = Literal["nominal", "alone", "grid"]
"""The profile's own robot, one mismatch alone, or one combination of mismatches."""


@dataclass(frozen=True)
class Mismatch:
    """The difference between a robot and its profile."""

    friction: float = 1.0
    """Factor of the friction between tyre and ground [1]."""
    com_x: float = 0.0
    """Shift of the centre of mass forward [m]."""
    com_y: float = 0.0
    """Shift of the centre of mass to the left [m]."""
    delay: float = 0.0
    """Addition to the dead times of commands, which stay at 0 or above [s]."""
    noise: float = 1.0
    """Factor of the variances of the feedback [1]."""
    torque: float = 1.0
    """Torque limit over the torque that the reference needs, if below 1; at 1 the profile's limit holds [1]."""

    @property
    def label(self) -> str:
        """The differences in words; `nominal` if there is none."""
        differing = [_level_text(name, value) for name, value in asdict(self).items() if value != LEVELS[name][0]]
        return ", ".join(differing) or NOMINAL


def _level_text(name: str, value: float) -> str:
    """Return one field of a mismatch in words."""
    if name in ("friction", "torque"):
        return f"{name} {100.0 * (value - 1.0):+.0f} %"
    if name == "noise":
        return f"noise variance x {value:g}"
    if name == "delay":
        return f"delay {value:+.1f} s"
    where = {"com_x": ("ahead", "back"), "com_y": ("left", "right")}[name][value < 0.0]
    return f"mass {100.0 * abs(value):.2g} cm {where}"


Levels = Mapping[str, tuple[float, ...]]
"""Values by field of `Mismatch`, as `LEVELS` has them."""


def single_mismatches(levels: Levels = LEVELS) -> list[Mismatch]:
    """Return every level other than the nominal one, each on its own."""
    return [Mismatch(**{name: value}) for name, values in levels.items() for value in values[1:]]


def full_grid(levels: Levels = LEVELS) -> list[Mismatch]:
    """Return every combination of levels."""
    return [Mismatch(**dict(zip(levels, values, strict=True))) for values in itertools.product(*levels.values())]


@dataclass(frozen=True)
class RobustnessCase:
    """One run that every controller makes."""

    kind: CaseKind
    """Whether it is the nominal robot, a single mismatch or a combination."""
    mismatch: Mismatch
    """The difference between the robot and its profile."""
    seed: int
    """Seed of noise and disturbance."""


def draw_cases(runs: int, seeds: int, seed: int, levels: Levels = LEVELS) -> list[RobustnessCase]:
    """Return the runs of a study.

    Args:
        runs: number of runs. The nominal robot and the single mismatches come first; the remaining runs are drawn from all
            combinations, none of which repeats before all were drawn.
        seeds: number of noise seeds, counted from `seed`, for the nominal robot and for each single mismatch.
        seed: seed of the drawing, and first seed of noise. Each drawn combination has a noise seed of its own.
        levels: the values that are tried.

    Raises:
        ValueError: `runs` leaves fewer than 2 combinations.
    """
    noise = range(seed, seed + seeds)
    single = [RobustnessCase("nominal", Mismatch(), k) for k in noise]
    single += [RobustnessCase("alone", m, k) for m in single_mismatches(levels) for k in noise]
    left = runs - len(single)
    if left < 2:
        raise ValueError(
            f"{runs} runs are too few: {len(single)} go to single mismatches under {seeds} seeds; at least 2 more"
        )
    rng, grid = np.random.default_rng(seed), full_grid(levels)
    order = np.concatenate([rng.permutation(len(grid)) for _ in range(math.ceil(left / len(grid)))])[:left]
    return [*single, *(RobustnessCase("grid", grid[point], seed + seeds + k) for k, point in enumerate(order))]


@dataclass(frozen=True)
class RobustnessOptions:
    """Options of the study of robustness."""

    controllers: tuple[str, ...] = PLAIN_CONTROLLERS
    """Controllers to test."""
    gains: str | Mapping[str, GainSet] = "published"
    """Name of a gain set (published, manual, tuned, default): a controller that lacks it gets its defaults. Or the path of a
    TOML file, for one controller."""
    reference: str | Waypoints = "generic"
    """Path to follow: line, circle, sine, generic, or a waypoint file."""
    speed: float = 0.25
    """Speed along the reference [m/s]."""
    profile: str | Profile | None = None
    """Robot that the controllers are designed for: name of a shipped profile, or path of a TOML file."""
    runs: int = 200
    """Runs of each controller: single mismatches first, then a random sample of all combinations."""
    seeds: int = 4
    """Seeds of noise for each single mismatch."""
    seed: int = 0
    """Seed of the sample and of noise."""
    bound: float = 0.5
    """A run has failed if its d_rms or the root mean square of its e_rho is greater than this [m]."""
    feedback: Feedback = "noisy"
    """Pose that the controllers see: the noisy one of the lab, the true one, or that of a state filter."""
    disturbance: bool = True
    """Push the robots' yaw at random (Sec. 3.4.5)."""
    timestep: float = 0.002
    """Physics step [s]; 5 ms change errors by less than 8 %, but make peaks of torque 1.8 times as high."""
    robot: str | Robot | None = None
    """Robot: its name or the path of its file; the profile's if none is named."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            ValueError: an unknown controller, no seeds, too few or too many runs, a bound or a step outside its range.
        """
        unknown = [name for name in self.controllers if name not in CONTROLLERS]
        if unknown or not self.controllers:
            raise ValueError(f"unknown controller '{', '.join(unknown)}'; there are: {', '.join(CONTROLLERS)}")
        require_seeds(self)
        require_within(self, ("runs",), 1, MOST_RUNS, whole=True)
        require_in_range(self, "timestep", 1e-5, 0.01)
        require_in_range(self, "speed", 0.0, 100.0, open_low=True)
        if not 0.0 < self.bound <= LOST:
            raise ValueError(f"bound {self.bound:g} m must be positive and at most {LOST:g} m, where a robot counts as lost")
        draw_cases(self.runs, self.seeds, self.seed)
        self.loop(Mismatch())

    @property
    def position_period(self) -> float:
        """Period of the position loop [s]: the usual one, if the physics step divides it."""
        steps = POSITION_PERIOD / self.timestep
        return POSITION_PERIOD if abs(steps - round(steps)) <= WHOLE_STEPS else _COARSE_PERIOD

    def loop(self, mismatch: Mismatch, drive: Drive | None = None) -> LoopSettings:
        """Return feedback, noise and periods of a loop; a state filter knows the drive's odometry."""
        noise = SensorNoise(**{name: mismatch.noise * value for name, value in asdict(SensorNoise()).items()})
        usual = SensorModel()
        sensors = replace(
            usual,
            variance_encoder=mismatch.noise * usual.variance_encoder,
            variance_gyro=mismatch.noise * usual.variance_gyro,
        )
        odometry, period = odometry_of(drive or Drive()), self.position_period
        return LoopSettings(self.feedback, noise, sensors, odometry, disturbance=self.disturbance, position_period=period)


def mismatched(profile: Profile, mismatch: Mismatch, timestep: float, torque: float) -> ClosedLoopRobot:
    """Return a MuJoCo robot that differs from its profile.

    Args:
        profile: parameters of the nominal robot.
        mismatch: the differences.
        timestep: physics step [s].
        torque: greatest torque of a wheel that the reference needs [N m].

    Raises:
        ValueError: the changed parameters are out of range.
    """
    section, m = profile.plants["mujoco"], mismatch
    p, drive = section.parameters, section.drive
    calibration = replace(
        p, friction=m.friction * p.friction, com_x=p.com_x + m.com_x, com_y=p.com_y + m.com_y, timestep=timestep
    )
    changed = replace(
        drive,
        delay_v=max(0.0, drive.delay_v + m.delay),
        delay_w=max(0.0, drive.delay_w + m.delay),
        torque_limit=m.torque * torque if m.torque < 1.0 else drive.torque_limit,
    )
    return ClosedLoopRobot("mujoco", MujocoPlant(calibration, changed), profile.plants["mujoco"].drive)
