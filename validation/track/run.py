"""Let robots follow a reference: the function behind `python -m validation.track`."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ssmr.control.loop import Feedback, LoopSettings
from ssmr.control.tick import LOST
from ssmr.control.waypoints import Waypoints
from ssmr.estimation.commission import stood
from ssmr.estimation.sensing import SensorModel, gyro_at_rest
from ssmr.geometry import rotate_body_to_world
from ssmr.types import State
from validation import store
from validation.plants.filters import THESIS
from validation.plants.profile import Profile, choose_profile
from validation.progress import Progress, Report, silent
from validation.simulator.description import Robot
from validation.simulator.terrain import FLAT, Terrain
from validation.track.commissioning import COMMISSIONED, chosen_filter
from validation.track.data import TrackedRobot, reference_of
from validation.track.gains import GainSet, load_gains, origin_sentence
from validation.track.loops import (
    AnyController,
    ClosedLoopRobot,
    demand_of,
    make_controller,
    make_robot,
    make_user_controller,
    rate,
    require_practicable,
    run_robots,
)
from validation.track.result import TrackResult
from validation.track.user_law import is_user_law, load_user_law
from validation.track.waypoint_files import open_reference


@dataclass(frozen=True)
class TrackSettings:
    """The options of tracking besides controller, reference, plants, profile and gains."""

    speed: float | None = None
    """Mean speed between waypoints [m/s]; it replaces the times of a file. None: those times, or 0.25 m/s for a named
    reference."""
    feedback: Feedback = "noisy"
    """Signal that the controller sees: the `truth`, the `noisy` truth (Tab. 3.4), or an `ekf` on noisy sensors."""
    disturbance: bool = True
    """Push the robot's yaw at random (Sec. 3.4.5)."""
    lookahead: float = 0.0
    """Distance at which the robot keeps behind its target [m] (Sec. 4.5)."""
    terrain: Terrain = FLAT
    """Ground of the MuJoCo robot."""
    seed: int = 0
    """Seed of noise and disturbance."""
    robot: Robot | str | Path | None = None
    """The robot: itself, its name or its path; None for that of the profile."""
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Pose at which the robot starts, seen from the start of the reference: ahead [m], to the left [m], yaw [rad]."""
    filter: str | Path = "thesis"
    """State filter of the feedback `ekf`: the `thesis`' filter; one that is `commissioned` by simulated drives, knows the
    robot's constants and learns how they change; one that is `learning` on a robot that nobody has commissioned; or the path
    of a TOML file."""
    gyro_bias: float = 0.0
    """Reading of the gyro at rest [rad/s], of which no filter is told; one that learns listens for `STANDS` before the robot
    drives. For the feedback `ekf`."""
    missed_ticks: tuple[float, float] = (0.0, 0.0)
    """Share of their ticks that damaged encoders of the left and of the right side miss [1] (Sec. 4.5); for the feedback
    `ekf`, which alone reads them."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a negative seed, or for a feedback, a look-ahead, a start or encoders that cannot be."""
        if self.seed < 0:
            raise ValueError(f"seed {self.seed} must not be negative")
        x, y, yaw = self.start
        if not math.hypot(x, y) < LOST:
            raise ValueError(
                f"start is {math.hypot(x, y):.3g} m from the reference's; beyond {LOST:g} m the robot is lost at once"
            )
        if not abs(yaw) <= math.pi:
            raise ValueError(f"start has a yaw of {yaw:g} rad, wanted at most pi (30 degrees are 0.5236 rad)")
        LoopSettings(self.feedback, sensors=self.sensors, lookahead=self.lookahead)
        asked = {"missed_ticks": any(self.missed_ticks), "gyro_bias": self.gyro_bias, "filter": str(self.filter) != THESIS}
        if self.feedback != "ekf" and (named := [name for name, differs in asked.items() if differs]):
            raise ValueError(f"{named[0]} needs the feedback ekf; nobody reads the sensors under {self.feedback}")

    @property
    def sensors(self) -> SensorModel:
        """Encoders and gyro of the state filter."""
        left, right = self.missed_ticks
        return SensorModel(gyro_bias=self.gyro_bias, missed_left=left, missed_right=right)


@dataclass(frozen=True, eq=False)
class PreparedTracking:
    """A tracking run that is checked and has its robots, but has not been driven."""

    controller: AnyController
    gains: GainSet | None
    label: str
    waypoints: Waypoints
    profile: Profile
    robots: tuple[ClosedLoopRobot, ...]
    settings: TrackSettings
    remarks: tuple[str, ...] = ()
    """Sentences that should be known before it is driven: gains of another profile, a reference that asks for too much."""

    def run(self, workers: int | None = None, progress: Report = silent) -> TrackResult:
        """Drive every robot along the reference.

        Args:
            workers: threads, None for all processors; the result does not depend on it.
            progress: told after each robot.

        A robot that is lost on the way is part of the result, as far as it came; see `TrackResult.require_kept`.

        Raises:
            LostError: a robot was lost before its first tick.
        """
        found = []
        for k, robot in enumerate(self.robots):
            progress(Progress(k, len(self.robots), f"{robot.name} drives"))
            found.append(self._drive(robot, workers))
        return TrackResult(tuple(found), remarks=self.remarks)

    def _start(self) -> State:
        """Return the state at which the robot starts, at rest."""
        (x, y, yaw), at = self.settings.start, self.waypoints.start
        dx, dy = rotate_body_to_world(np.array([x, y]), at.yaw)
        return State(at.x + float(dx), at.y + float(dy), at.yaw + yaw)

    def _drive(self, robot: ClosedLoopRobot, workers: int | None) -> TrackedRobot:
        s = self.settings
        used = chosen_filter(s.filter, self.profile, robot.name)
        at_rest = gyro_at_rest(s.sensors.packed(), np.random.default_rng([s.seed, 2]))  # 0 and 1 draw the loop's noise
        told = stood(used.settings, at_rest)
        around = LoopSettings(s.feedback, sensors=s.sensors, filter=told, disturbance=s.disturbance, lookahead=s.lookahead)
        began = time.perf_counter()
        (run,) = run_robots([robot], [self.controller], [around], self.waypoints, [s.seed], workers, self._start())
        wall = time.perf_counter() - began
        if not len(run.t):
            run.require_kept(f"{self.controller.name} on {self.label} with the plant {robot.name}")
        options = {
            "feedback": around.feedback,
            "disturbance": around.disturbance,
            "lookahead_m": around.lookahead,
            "gyro_bias_rad_s": s.gyro_bias,
            "missed_ticks": list(s.missed_ticks),
            "start": list(s.start),
            **robot.limits,
            "position_period_s": around.position_period,
            "velocity_period_s": around.velocity_period,
            "terrain": robot.terrain.spec,
        }
        return TrackedRobot(
            self.controller.name,
            self.gains.name if self.gains else "none",
            dict(self.gains.values) if self.gains else {},
            self.label,
            self.waypoints.speed,
            robot.name,
            self.profile.name,
            s.seed,
            run,
            reference_of(run, self.waypoints),
            rate(run, self.waypoints, robot),
            wall,
            options,
            store.versions(),
            robot.terrain,
            self.profile.robot,
            used if s.feedback == "ekf" else None,
        )


def track(
    controller: str,
    reference: Waypoints | str | Path,
    plant: str | Sequence[str] = "improved",
    profile: Profile | str | Path | None = None,
    gains: GainSet | str | Path | None = None,
    settings: TrackSettings | None = None,
    workers: int | None = None,
    progress: Report = silent,
    **options: Any,
) -> TrackResult:
    """Let one robot or several follow a reference under a controller.

    Every field of the settings can be given by its own name too: `track("pid", "circle", robot="jackal", speed=0.5)`.

    Args:
        controller: `pid`, `lqr`, `lqr-scheduled` or `smc`; one of them behind a predictor, such as `lqr+predictor`; `mpc`;
            or a class of your own, `FILE.py:NAME` (`ssmr.control.mission` says what it is asked).
        reference: waypoints, such as `ssmr.circle(speed=0.5)`; or `line`, `circle`, `sine` or `generic`; or the path of a
            file of waypoints.
        plant: name of the plant that is the robot, or names of several, which are driven one beside the other.
        profile: parameters of the plants: a profile, its name or its path; None for `thesis-lab`, or the robot's own
            numbers if that is of another robot than `robot`.
        gains: a set of gains, its name (`published`, `manual`, `tuned`, a profile's) or its path; None for those of the
            profile if any are shipped, else the published ones where the thesis has any, else the tuned ones.
        settings: speed, feedback, disturbance, look-ahead, terrain, seed and robot.
        workers: threads, None for all processors; the result does not depend on it.
        progress: told how far the work is.
        options: fields of the settings by name.

    Returns:
        The result, which prints (`table()`), draws (`figure()`) and saves (`save(folder)`) itself. `metrics["d_rms_m"]` is
        a metric of the first plant. A robot that was lost is in it as far as it came; `require_kept()` then raises.

    Raises:
        LostError: a robot was lost before its first tick.
        ValueError: a name that there is not, a file that cannot be read, a reference that no wheel can follow, or values
            that do not go together.
    """
    changed = replace(settings or TrackSettings(), **options)
    return prepare_tracking(controller, reference, plant, profile, gains, changed).run(workers, progress)


def prepare_tracking(
    controller: str,
    reference: Waypoints | str | Path,
    plant: str | Sequence[str] = "improved",
    profile: Profile | str | Path | None = None,
    gains: GainSet | str | Path | None = None,
    settings: TrackSettings | None = None,
) -> PreparedTracking:
    """Check everything that tracking is asked for, and build its robots; the arguments are those of `track`.

    Raises:
        ValueError: as `track`.
    """
    settings = settings or TrackSettings()
    plants = (plant,) if isinstance(plant, str) else tuple(plant)
    if not plants or len(set(plants)) < len(plants):
        raise ValueError(f"plant must name one plant or several different ones, got {', '.join(plants) or 'none'}")
    chosen = choose_profile(profile, settings.robot, "thesis-lab")
    law, wanted = chosen_controller(controller, chosen, gains)
    if isinstance(reference, Waypoints):
        label, waypoints = "waypoints", reference
        if settings.speed is not None:
            waypoints = Waypoints.from_path(reference.xy, settings.speed)
    else:
        label, waypoints = open_reference(str(reference), settings.speed)
    if settings.terrain != FLAT and "mujoco" not in plants:
        raise ValueError(f"terrain {settings.terrain.spec} needs the plant mujoco: the planar models know only level ground")
    robots = tuple(make_robot(chosen, name, settings.terrain) for name in plants)
    for made in robots:
        if str(settings.filter) != COMMISSIONED:  # that one has to be driven, the others are there or not
            chosen_filter(settings.filter, chosen, made.name)
        require_practicable(waypoints, made.drive, label)
    said = [demand_of(waypoints, made, chosen.name, label) for made in robots]
    if wanted is not None:
        said.insert(0, origin_sentence(wanted, chosen.name))
    remarks = tuple(sentence for sentence in said if sentence is not None)
    return PreparedTracking(law, wanted, label, waypoints, chosen, robots, settings, remarks)


def chosen_controller(
    controller: str, profile: Profile, gains: GainSet | str | Path | None = None
) -> tuple[AnyController, GainSet | None]:
    """Return a controller by its name, or a user's class by `FILE.py:NAME`, and its gains; a user's class has none.

    Raises:
        ValueError: there is no such controller, file, class or set of gains, or they do not go together.
    """
    if is_user_law(controller):
        if gains is not None:
            raise ValueError(f"gains are for the shipped controllers; {controller} brings its own")
        return make_user_controller(profile, load_user_law(controller)), None
    wanted = gains if isinstance(gains, GainSet) else load_gains(controller, str(gains) if gains else None, profile.name)
    if wanted.controller != controller:
        raise ValueError(f"gains belong to {wanted.controller}, wanted {controller}")
    return make_controller(profile, wanted), wanted
