"""Episodes of trajectory tracking: their distributions, and one that was drawn.

Everything about an episode follows from a generator: the robot, the reference, where it starts, and
all noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np

from ssmr.control.loop import VELOCITY_PERIOD, LoopSettings
from ssmr.control.references import winding_path
from ssmr.control.waypoints import Waypoints, targets_at
from ssmr.parameters import require_in_range
from ssmr.robot.drive import wheel_rates, whole_steps
from ssmr.robot.sensors import yaw_disturbance
from ssmr.robot.vehicle import Drive
from ssmr.types import FloatArray, State
from validation.experiment.waypoint_files import open_reference
from validation.plants.profile import PlantProfile, choose_profile
from validation.simulator.calibration import Calibration
from validation.simulator.description import Robot
from validation.simulator.plant import MujocoPlant

AHEAD_TICKS = (0, 4, 8, 12)
"""Ticks from now to each target in an observation: up to 0.6 s ahead, three dead times of the
thesis' robot."""
ERRORS = 5
"""Numbers of a target in an observation: e_rho, e_y [m], e_alpha [rad], its speed [m/s] and yaw
rate [rad/s]."""
_LOST_TRACKS = 2.0
"""Distance from the target at which an episode ends, over the robot's track [1]; 1.1 m for a
Husky."""
# Greatest deviations of a drawn robot from its profile [1].
FRICTION = 0.3
"""Of friction, over the profile's."""
MASS = 0.1
"""Of mass and inertia, over the profile's."""
DELAY = 0.25
"""Of the dead times, over the profile's."""
_RADIUS_DIFFERENCE = 0.01
"""Of the left radii from the right, over the radius."""
_CENTRE = 0.1
"""Of the centre of mass, over wheelbase and track."""
_START_PLACE = 0.5
"""Greatest deviation of a drawn start from the reference's in x and y, over the track [1]."""
_START_YAW = 0.5
"""Greatest deviation of a drawn start from the reference's heading [rad]."""
CURVATURE = 1.3
"""Greatest curvature of a drawn reference times the track [1]."""
_YAW_SHARE = 0.45
"""Greatest share of the drive's yaw rate that a drawn reference asks for [1]."""
_SPEED_SHARE = 0.8
"""Greatest share of the drive's speed that is drawn [1]."""


@dataclass(frozen=True)
class TrackTask:
    """Task that the episodes of an environment set."""

    profiles: str | None = None
    """Names or paths of profiles, comma-separated; each episode takes one at random. None for
    `thesis-lab`, or the robot's own numbers if that is of another robot than `robot`."""
    reference: str | None = None
    """A reference by name or the path of a file of waypoints; None for a winding path that is drawn
    for each episode."""
    speed: float | tuple[float, float] = (0.2, 0.8)
    """Reference speed, or the range in which each episode draws one [m/s]."""
    robot: str | Path | Robot | None = None
    """The robot, its name or its path; None for that of the profiles."""
    seconds: float = 20.0
    """Greatest length of an episode [s]; a reference that ends before ends the episode."""
    spread: float = 1.0
    """Share of the greatest deviations of robots and starts that is drawn [1]; 0 for the profiles'
    own robots, at rest at the first waypoint."""
    noise: bool = True
    """Whether feedback is noisy (Tab. 3.4) and the yaw is pushed at random (Sec. 3.4.5)."""
    timestep: float = 0.005
    """Physics step [s]: longer than that of the shipped profiles, 0.002, which is the physics of
    all other programs."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a number outside its range."""
        require_in_range(self, "seconds", VELOCITY_PERIOD, 3600.0)
        require_in_range(self, "spread", 0.0, 1.0)
        low, high = self.speeds
        if not 0.0 < low <= high < math.inf:
            raise ValueError(
                f"speed {self.speed} must be a positive number, or two that do not fall [m/s]"
            )

    @property
    def speeds(self) -> tuple[float, float]:
        """The least and the greatest reference speed [m/s]."""
        if isinstance(self.speed, tuple):
            return self.speed
        return (self.speed, self.speed)


class EpisodeSource:
    """Everything of which the episodes of a task are made."""

    def __init__(self, task: TrackTask) -> None:
        """Read profiles and reference.

        Raises:
            ValueError: profiles or waypoints that cannot be read, a driver without a greatest
                speed, several robots or kinds of motor, or a physics step that does not divide the
                period of commands.
        """
        self.task = task
        names: list[str | None] = [None]
        if task.profiles is not None:
            names = [name.strip() for name in task.profiles.split(",") if name.strip()]
        profiles = [choose_profile(name, task.robot, "thesis-lab") for name in names]
        if len({p.robot for p in profiles}) != 1:
            robots = ", ".join(profile.robot.name for profile in profiles)
            raise ValueError(f"the profiles must be of one robot, they are of {robots}")
        self.sections: list[PlantProfile] = []
        self.of_wheels = False
        """Whether the driver's limits are those of its wheels' rates alone."""
        for profile in profiles:
            section = profile.plants["mujoco"]
            drive = section.drive
            if not math.isfinite(drive.v_max):
                raise ValueError(
                    f"the driver of {section.robot.name} has no greatest speed, of which actions "
                    "are shares; set v_max in its file, under [drive]"
                )
            if not math.isfinite(drive.w_max):
                self.of_wheels = True
                drive = replace(drive, w_max=drive.v_max / drive.command_half_track)
            parameters = replace(section.parameters, timestep=task.timestep)
            self.sections.append(replace(section, parameters=parameters, drive=drive))
        first = self.sections[0]
        if len({s.parameters.wheel_shape for s in self.sections}) != 1:
            raise ValueError("all profiles must have one shape of tyre")
        self.waypoints: Waypoints | None = None
        slowest, fastest = task.speeds
        longest = task.seconds
        if task.reference is not None:
            self.waypoints = open_reference(task.reference, fastest)[1]
            longest = min(longest, self._at(slowest).duration)
        timestep = first.parameters.timestep
        self.steps = whole_steps(VELOCITY_PERIOD, timestep, "the period of commands")
        self.most_ticks = math.ceil(longest / VELOCITY_PERIOD - 1e-9)
        drives = [section.drive for section in self.sections]
        latest = max(max(d.delay_v, d.delay_w) + d.command_ramp for d in drives)
        self.past = 1 + math.ceil((1.0 + DELAY) * latest / VELOCITY_PERIOD - 1e-9)
        self.track = 2.0 * first.parameters.half_track
        self.lost = _LOST_TRACKS * self.track

    @cached_property
    def top(self) -> FloatArray:
        """(2,) greatest command that any drive lets through: speed [m/s] and yaw rate [rad/s]."""
        return np.max([(s.drive.v_max, s.drive.w_max) for s in self.sections], axis=0)

    @cached_property
    def bounds(self) -> FloatArray:
        """(n,) greatest size of each number of an observation."""
        v, w = self.top
        reach = self.lost + v * VELOCITY_PERIOD * max(AHEAD_TICKS)
        target = [reach, reach, math.pi, 2.0 * v, 4.0 * w]
        return np.array([2.0 * v, 4.0 * w, *target * len(AHEAD_TICKS), *[v, w] * self.past])

    @property
    def slices(self) -> dict[str, tuple[slice, tuple[int, ...]]]:
        """The parts of an observation by name: where each stands, and its shape."""
        end = 2 + ERRORS * len(AHEAD_TICKS)
        return {
            "speed": (slice(0, 2), (2,)),
            "targets": (slice(2, end), (len(AHEAD_TICKS), ERRORS)),
            "commands": (slice(end, None), (self.past, 2)),
        }

    def make_plant(self, calibration: Calibration, drive: Drive) -> MujocoPlant:
        """Return a robot with these numbers and without sensors, which nobody reads here."""
        plant = MujocoPlant(calibration, drive)
        plant.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
        return plant

    def _at(self, speed: float) -> Waypoints:
        """Return the reference of the task at a speed [m/s]."""
        assert self.waypoints is not None  # only asked for then
        if len({*self.task.speeds}) == 1:
            return self.waypoints
        return self.waypoints.at_speed(speed)

    def draw_episode(
        self, rng: np.random.Generator
    ) -> tuple[Calibration, Drive, State, FloatArray, FloatArray, FloatArray]:
        """Return an episode of T ticks, whole before it begins; equal generators give equal ones.

        Returns:
            The numbers of the robot and its drive; the state in which it starts, rolling straight
            ahead as it was commanded until then; (T + 1 + the farthest preview, 5) x, y, heading,
            speed and yaw rate of the target at each tick; (T + 1, 5) errors of the feedback in x,
            y, yaw, speed and yaw rate at each tick; and (T, n) yaw accelerations at each physics
            step [rad/s2].
        """
        section = self.sections[rng.integers(len(self.sections))]
        calibration, drive = self._draw_robot(section, rng)
        slowest, fastest = self.task.speeds
        limit = max(_SPEED_SHARE * drive.v_max, slowest)
        speed = float(rng.uniform(slowest, min(fastest, limit)))
        if self.waypoints is None:  # a winding path that is long enough
            most = min(CURVATURE / self.track, _YAW_SHARE * drive.w_max / speed)
            piece = 1.5 * self.track
            count = 2 + math.ceil(speed * self.task.seconds / piece)
            waypoints = winding_path(speed, rng.uniform(-most, most, count).tolist(), piece)
        else:
            waypoints = self._at(speed)
        n = min(self.most_ticks, math.ceil(waypoints.duration / VELOCITY_PERIOD - 1e-9))
        times = VELOCITY_PERIOD * np.arange(n + 1.0 + max(AHEAD_TICKS))
        targets = targets_at(waypoints.course(), times)
        start = self._draw_start(waypoints.start, speed, drive, rng)
        seed = int(rng.integers(2**32))
        off = np.zeros((n + 1, 5))
        pushes = np.zeros((n, self.steps))
        if self.task.noise:
            draws = np.random.default_rng([seed, 0]).standard_normal(off.shape)
            off = draws * np.array(LoopSettings().deviations())
            push = np.random.default_rng([seed, 1])
            dt = VELOCITY_PERIOD / self.steps
            pushes = yaw_disturbance(n * VELOCITY_PERIOD, dt, push).reshape(pushes.shape)
        return calibration, drive, start, targets, off, pushes

    def _draw_robot(
        self, section: PlantProfile, rng: np.random.Generator
    ) -> tuple[Calibration, Drive]:
        c = section.parameters
        d = section.drive
        friction, mass, delay, radius, x, y = self.task.spread * rng.uniform(-1.0, 1.0, 6)
        calibration = replace(
            c,
            friction=min(c.friction * (1.0 + FRICTION * friction), 5.0),
            mass=c.mass * (1.0 + MASS * mass),
            yaw_inertia=c.yaw_inertia * (1.0 + MASS * mass),
            radius_difference=c.radius_difference + _RADIUS_DIFFERENCE * radius * c.wheel_radius,
            com_x=c.com_x + _CENTRE * x * section.robot.wheelbase,
            com_y=c.com_y + _CENTRE * y * 2.0 * c.half_track,
        )
        factor = 1.0 + DELAY * delay
        return calibration, replace(d, delay_v=factor * d.delay_v, delay_w=factor * d.delay_w)

    def _draw_start(
        self, first: State, speed: float, drive: Drive, rng: np.random.Generator
    ) -> State:
        """Return a state near the first waypoint, rolling straight ahead."""
        place = _START_PLACE * self.track
        x, y, yaw = self.task.spread * rng.uniform(-1.0, 1.0, 3) * (place, place, _START_YAW)
        v = self.task.spread * float(rng.uniform(0.0, speed))
        wheels = wheel_rates(v, 0.0, drive.command_half_track, drive.command_radius)
        return State(
            first.x + x,
            first.y + y,
            first.yaw + yaw,
            v,
            wheel_left=float(wheels.left),
            wheel_right=float(wheels.right),
        )
