"""Let robots follow a reference under a controller.

On the command line: `python -m validation.track CONTROLLER REFERENCE`.
"""

from __future__ import annotations

if __name__ == "__main__":
    from validation.interrupts import end_quietly

    end_quietly()

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from ssmr.control.laws import Controller
from ssmr.control.loop import Feedback, LoopSettings
from ssmr.control.tick import LOST
from ssmr.control.waypoints import Waypoints
from ssmr.geometry import rotate_body_to_world
from ssmr.parameters import require_in_range
from ssmr.robot.sensors import SensorModel
from ssmr.simulation import PlanarModel
from ssmr.types import State
from validation import cli
from validation.experiment.gains import GainSet, origin_sentence
from validation.experiment.loops import (
    AnyController,
    ClosedLoopRobot,
    chosen_controller,
    demand_of,
    make_robot,
    open_path,
    run_robots,
)
from validation.experiment.sources import driver_warnings
from validation.experiment.tracked import (
    MOST_BESIDE,
    Followed,
    lost_text,
    reference_of,
)
from validation.experiment.user_law import load_user_metric
from validation.output import Progress, file_name
from validation.plants.profile import Pace, choose_profile, odometry_of
from validation.report.tracking import Tracked
from validation.simulator.plant import MujocoPlant
from validation.simulator.terrain import FLAT, Terrain

REST = 2.0
"""Time for which a robot is followed behind the reference's end, until it rests [s]."""
MORE_DELAY = 0.1
"""Delay that a robot is driven with once more, to say how much it matters [s]."""
SHORT = 40.0
"""Duration of a reference up to which that is done, so that it takes about a second [s]."""


@dataclass(frozen=True)
class TrackOptions(cli.Filmed):
    """Options of `track`."""

    controller: tyro.conf.Positional[str | type]
    """Controller: pid and lqr are those of the thesis; lqr-scheduled is linearised about the
    operating speed. Behind its name, +predictor lets a law act on the state one dead time ahead, as
    in lqr+predictor; mpc plans ahead within the limits. FILE.py:NAME is a class of your own, which
    is run."""
    reference: tyro.conf.Positional[Waypoints | str | Path]
    """Path to follow: line, circle, sine, generic, eight, slalom, square, spiral, u-turn,
    stop-and-go, long-line, each also with its speed, as eight@0.5; or a file of waypoints (.csv: x,
    y[, t][, yaw]). Waypoints at one place are a wait. It is driven backwards where the yaw [rad] is
    against the way."""
    plant: Sequence[str] = ("improved",)
    """Plant that is the robot. Several, separated by commas, are driven one beside the other; the
    first one is the one that track.json reports."""
    profile: cli.AnyProfile = None
    """Name of a shipped profile, or path of a profile (.toml); if not given, thesis-lab, and for
    another --robot the numbers of its file."""
    gains: GainSet | str | Path | None = None
    """Gains of the controller: published, manual (lqr only), tuned, default (the law's own), those
    of a profile by its name (husky-tile, warthog-grass), or the path of a TOML file. If not given,
    the profile's own if shipped, else published if the thesis has any, else tuned."""
    speed: float | None = None
    """Greatest speed [m/s]. A file then is a path without times: its corners are rounded and
    driven as fast as the robot can. Named references have 0.25 m/s if it is not given."""
    robot: cli.AnyRobot = None
    """Name of a shipped robot, or path of a robot's file (.toml); the profile's if not given."""
    feedback: Feedback = "noisy"
    """Signal that the controller sees: the truth; the truth with the lab's noise (Tab. 3.4); or the
    estimate of a state filter (EKF) on noisy encoders and gyro."""
    lookahead: float = 0.0
    """Distance at which the robot keeps behind its target (Sec. 4.5) [m]."""
    start: tuple[float, float, float] | list[float] | str = (0.0, 0.0, 0.0)
    """Pose at which the robot starts, seen from the start of the reference: ahead [m], to the left
    [m], yaw [rad], such as 0,0.5,0.52."""
    no_noise: bool = False
    """Switch noise and disturbance off: the controller sees the truth."""
    no_disturbance: bool = False
    """Do not push the robot's yaw at random (Sec. 3.4.5)."""
    gyro_bias: float = 0.0
    """Reading of the gyro at rest [rad/s]. It needs --feedback ekf."""
    standing: float = 10.0
    """Time at rest before the start [s], in which the filter takes the gyro's bias; with 0 it is
    not told."""
    late: float = 0.0
    """Time by which the robot answers later than its controller knows [s]."""
    terrain: Terrain | str = FLAT
    """Ground under the MuJoCo robot: flat, or ramp:DEG; docs/physics.md has more keys."""
    own_metric: Annotated[Callable[..., float] | str | None, tyro.conf.arg(name="metric")] = None
    """A column of your own: a function in a Python file, FILE.py:NAME, which is run."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a feedback, a look-ahead or a start that cannot be."""
        super().__post_init__()
        x, y, yaw = cli.read_value(self.start)
        distance = math.hypot(x, y)
        if not distance < LOST:
            raise ValueError(
                f"start is {distance:.3g} m from the reference's; "
                f"beyond {LOST:g} m the robot is lost at once"
            )
        if not abs(yaw) <= math.pi:
            raise ValueError(
                f"start has a yaw of {yaw:g} rad, wanted at most pi (30 degrees are 0.5236 rad)"
            )
        require_in_range(self, "late", 0.0, 2.0)
        LoopSettings(
            self.seen, sensors=self.sensors, standing=self.standing, lookahead=self.lookahead
        )
        if self.seen != "ekf" and self.gyro_bias:
            raise ValueError(
                f"gyro_bias needs the feedback ekf; nobody reads the sensors under {self.seen}"
            )

    @property
    def seen(self) -> Feedback:
        """Signal that the controller sees."""
        return "truth" if self.no_noise else self.feedback

    @property
    def sensors(self) -> SensorModel:
        """Encoders and gyro of the state filter."""
        return SensorModel(gyro_bias=self.gyro_bias)

    def folder(self) -> Path:
        """Return the folder that the files are written to."""
        if isinstance(self.controller, type):
            name = self.controller.__name__
        else:
            name = self.controller.rpartition(":")[2]
        label = "waypoints"
        if not isinstance(self.reference, Waypoints):
            label = Path(str(self.reference)).stem.partition("@")[0]
        return Path("runs") / "track" / file_name(f"{name}-{label}")


@cli.make_program(TrackOptions)
def track(o: TrackOptions) -> Tracked:
    """Let a robot follow a reference under a controller.

    Prints tables and writes track.json, track.png and track.rrd, also for a robot that was lost;
    then the exit status is 1.

    Raises:
        LostError: a robot was lost before its first tick.
        ValueError: an unknown name, a file that cannot be read, a reference that the law
            cannot follow, or values that do not go together.
    """
    plants = tuple(o.plant)
    if not 1 <= len(set(plants)) == len(plants) <= MOST_BESIDE:
        named = ", ".join(plants) or "none"
        raise ValueError(f"plant must name 1 to {MOST_BESIDE} different plants, got {named}")
    profile = choose_profile(o.profile, o.robot, "thesis-lab")
    law, gains = chosen_controller(o.controller, profile, o.gains)
    metric = None if o.own_metric is None else load_user_metric(o.own_metric)
    terrain = cli.read_value(o.terrain)
    if terrain != FLAT and "mujoco" not in plants:
        raise ValueError(
            f"terrain {terrain.spec} needs the plant mujoco: "
            "the planar models know only level ground"
        )
    robots = [make_robot(profile, name, terrain, o.late) for name in plants]
    sentences: list[str | None] = []
    path = o.reference if isinstance(o.reference, Waypoints) else str(o.reference)
    label, waypoints, sentences[:] = open_path(path, o.speed, robots, law)
    if not sentences:
        sentences = [demand_of(waypoints, robot, profile.name, label) for robot in robots]
    if gains is not None:
        sentences.insert(0, origin_sentence(gains, profile.name))
    course = waypoints.course()
    sentences += profile.too_fast(Pace.of(course["v"], course["w"]), label)
    sentences += [*profile.unfitted(plants), *driver_warnings(plants, profile.robot)]
    remarks = [sentence for sentence in sentences if sentence is not None]
    for remark in remarks:
        cli.warn_user(remark)
    driven = []
    for k, robot in enumerate(robots):
        o.progress(Progress(k, len(robots), f"{robot.name} drives"))
        tracked = _drive_reference(o, robot, law, waypoints, label)
        # metrics of users see the reference to its end, also where the robot was lost
        if metric is not None:
            whole = reference_of(tracked.run, waypoints, whole=True)
            metrics = metric(tracked.metrics, [tracked.run.motion], [whole])
            tracked = replace(tracked, metrics=metrics)
        driven.append(tracked)
    if gains is not None and waypoints.duration <= SHORT:
        late = make_robot(profile, plants[0], terrain, o.late + MORE_DELAY)
        if isinstance(late.body, PlanarModel | MujocoPlant):
            remarks.append(
                _what_delay_does(driven[0], _drive_reference(o, late, law, waypoints, label))
            )
    return Tracked.of(
        driven,
        law.name,
        label,
        waypoints.speed,
        gains=gains,
        profile=profile,
        seed=o.seed,
        terrain=terrain,
        filter=_loop_settings(o, robots[0]).filter_at_start(o.seed) if o.seen == "ekf" else None,
        remarks=remarks,
    )


def _what_delay_does(as_it_is: Followed, later: Followed) -> str:
    """Return a sentence on a robot that was driven with `MORE_DELAY`, and as it is."""
    begin = f"With {MORE_DELAY:g} s more delay {as_it_is.plant} would"
    if later.run.lost:
        return f"{begin} be {lost_text(later.run)}."
    before, after = (1e3 * robot.metrics["d_rms_m"] for robot in (as_it_is, later))
    return f"{begin} be {after:.0f} mm off its path (d_rms), {before:.0f} mm as it is."


def _loop_settings(o: TrackOptions, robot: ClosedLoopRobot) -> LoopSettings:
    """Return the settings of a robot's closed loop."""
    return LoopSettings(
        o.seen,
        sensors=o.sensors,
        filter=odometry_of(robot.drive),
        standing=o.standing,
        disturbance=not (o.no_noise or o.no_disturbance),
        lookahead=o.lookahead,
        rest=REST,
    )


def _drive_reference(
    o: TrackOptions,
    robot: ClosedLoopRobot,
    law: AnyController,
    waypoints: Waypoints,
    label: str,
) -> Followed:
    """Drive a robot along the reference; one that is lost on the way gives the part it drove."""
    around = _loop_settings(o, robot)
    # the start is seen from that of the reference
    at = waypoints.start
    x, y, yaw = cli.read_value(o.start)
    dx, dy = map(float, rotate_body_to_world(np.array([x, y]), at.yaw))
    start = State(at.x + dx, at.y + dy, at.yaw + yaw)
    # the time of a run shall not contain that of compiling
    if isinstance(law, Controller):
        moment = Waypoints(np.array([0.0, 0.2]), np.array([[0.0, 0.0], [0.1, 0.0]]))
        run_robots([robot], [law], [replace(around, rest=0.0)], moment, [o.seed], o.workers)
    began = time.process_time()
    (run,) = run_robots([robot], [law], [around], waypoints, [o.seed], o.workers, start=start)
    spent = time.process_time() - began
    # without a tick there is nothing to report
    if not len(run.t):
        run.require_complete(f"{law.name} on {label} with the plant {robot.name}")
    return Followed.of(
        robot.name,
        run,
        waypoints,
        cpu_s=spent,
        options={
            "feedback": around.feedback,
            "disturbance": around.disturbance,
            "lookahead_m": around.lookahead,
            "gyro_bias_rad_s": o.gyro_bias,
            "standing_s": o.standing,
            "late_s": o.late,
            "start": list(o.start),
            **robot.limits,
            "position_period_s": around.position_period,
            "velocity_period_s": around.velocity_period,
            "terrain": robot.terrain.spec,
        },
    )


if __name__ == "__main__":
    track.main()
