"""The robots that a controller is tested on: mismatches, one at a time and together, and the options of the study.

`validation.bench.mismatch` says by how much a robot may differ from its profile. Every set of gains drives the same robots
with the same noise: first each mismatch alone, under several seeds, which shows what the controller is sensitive to; then
robots that are drawn at random, which shows how its errors spread.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from ssmr.control.laws import CONTROLLERS, PLAIN_CONTROLLERS
from ssmr.control.loop import POSITION_PERIOD, Feedback, LoopSettings
from ssmr.control.tick import LOST
from ssmr.control.waypoints import Waypoints
from ssmr.parameters import require_in_range, require_within
from ssmr.robot.drive import WHOLE_STEPS
from ssmr.robot.vehicle import Drive
from validation.bench.gains import GainSet
from validation.bench.mismatch import STUDYING, Mismatch, draw_mismatches, single_mismatches
from validation.plants.filters import odometry_of
from validation.plants.profile import Profile
from validation.simulator.description import Robot, load_robot
from validation.study.result import MOST_RUNS, require_seeds

_COARSE_PERIOD = 0.01
"""Period of the position loop where the physics step does not divide the usual one [s]."""
CaseKind = Literal["nominal", "alone", "drawn"]
"""The profile's own robot, one mismatch alone, or a robot that is drawn at random."""


@dataclass(frozen=True)
class RobustnessCase:
    """One run that every controller makes."""

    kind: CaseKind
    """Whether it is the nominal robot, a single mismatch or a combination."""
    mismatch: Mismatch
    """The difference between the robot and its profile."""
    seed: int
    """Seed of noise and disturbance."""


def draw_cases(runs: int, seeds: int, seed: int, robot: Robot) -> list[RobustnessCase]:
    """Return the runs of a study.

    Args:
        runs: number of runs. The nominal robot and the single mismatches come first; the remaining robots are drawn.
        seeds: number of noise seeds, counted from `seed`, for the nominal robot and for each single mismatch.
        seed: seed of the drawing, and first seed of noise. Each drawn robot has a noise seed of its own.
        robot: the robot that others differ from.

    Raises:
        ValueError: `runs` leaves fewer than 2 drawn robots.
    """
    noise = range(seed, seed + seeds)
    single = [RobustnessCase("nominal", Mismatch(), k) for k in noise]
    single += [RobustnessCase("alone", m, k) for m in single_mismatches(robot) for k in noise]
    left = runs - len(single)
    if left < 2:
        raise ValueError(
            f"{runs} runs are too few: wanted {len(single) + 2} or more, for {len(single)} drive one mismatch alone"
        )
    drawn = draw_mismatches(left, seed, STUDYING, robot)
    return [*single, *(RobustnessCase("drawn", m, seed + seeds + k) for k, m in enumerate(drawn))]


@dataclass(frozen=True)
class RobustnessOptions:
    """Options of the study of robustness."""

    controllers: tuple[str, ...] = PLAIN_CONTROLLERS
    """Controllers to test."""
    gains: tuple[str, ...] | Mapping[str, GainSet] = ("published", "tuned", "robust")
    """Names of gain sets (published, manual, tuned, robust, default, or a profile's), of which each controller drives those
    that it has, or its defaults if it has none; or the path of a TOML file, for one controller. From Python also gain sets
    by any name."""
    reference: str | Waypoints = "generic"
    """Path to follow: line, circle, sine, generic, or a waypoint file."""
    speed: float = 0.25
    """Speed along the reference [m/s]."""
    profile: str | Profile | None = None
    """Robot that the controllers are designed for: name of a shipped profile, or path of a TOML file."""
    runs: int = 200
    """Runs of each set of gains: single mismatches first, then robots that are drawn at random."""
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
        draw_cases(self.runs, self.seeds, self.seed, load_robot())
        self.loop()

    @property
    def position_period(self) -> float:
        """Period of the position loop [s]: the usual one, if the physics step divides it."""
        steps = POSITION_PERIOD / self.timestep
        return POSITION_PERIOD if abs(steps - round(steps)) <= WHOLE_STEPS else _COARSE_PERIOD

    def loop(self, drive: Drive | None = None) -> LoopSettings:
        """Return feedback, noise and periods of a loop; a state filter knows the drive's odometry."""
        odometry, period = odometry_of(drive or Drive()), self.position_period
        return LoopSettings(self.feedback, filter=odometry, disturbance=self.disturbance, position_period=period)
