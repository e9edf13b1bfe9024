"""Paths that reverse and turn on the spot: who drives them, how well, and who is refused."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from ssmr.control.loop import LoopSettings, run_loop
from ssmr.control.waypoints import Waypoints
from ssmr.geometry import wrap_angle
from tests.ros_drive import Faults, drive_with_faults
from validation.experiment.loops import (
    chosen_controller,
    limits_of,
    make_robot,
    open_path,
    run_robots,
)
from validation.experiment.tracked import track_metrics
from validation.experiment.waypoint_files import read_waypoints
from validation.files.reading import FileError
from validation.plants.profile import Profile, load_profile
from validation.report.tracking import Tracked
from validation.ros.control import Control, control
from validation.simulator.plant import MujocoPlant
from validation.track import track
from validation.tune import tune

QUARTER = 0.5 * math.pi
BEND = [
    (1.2 + 0.8 * math.sin(a), 0.8 - 0.8 * math.cos(a), a) for a in np.linspace(0.0, QUARTER, 20)
]
PATHS: dict[str, list[tuple[float, float, float]]] = {
    # forwards round a bend, then backwards into the dock
    "dock": [(0.0, 0.0, 0.0), *BEND, (2.0, 1.6, QUARTER), (2.0, -0.8, QUARTER)],
    "backwards": [(0.0, 0.0, 0.0), (-1.5, 0.0, 0.0), (-2.5, 0.5, -0.46)],
    "corner": [(0.0, 0.0, 0.0), (1.5, 0.0, 0.0), (1.5, 1.5, QUARTER)],
    "spot": [(0.0, 0.0, 0.0), (1.5, 0.0, 0.0), (1.5, 0.0, QUARTER), (1.5, 1.5, QUARTER)],
    "about": [(0.0, 0.0, 0.0), (1.5, 0.0, 0.0), (1.5, 0.0, math.pi), (0.2, 0.0, math.pi)],
}
REVERSING = ("dock", "backwards")


def path_file(folder: Path, name: str) -> Path:
    """Return a file of waypoints without times."""
    rows = [f"{x:.4f},{y:.4f},{yaw:.4f}" for x, y, yaw in PATHS[name]]
    path = folder / f"{name}.csv"
    path.write_text("\n".join(["x,y,yaw", *rows]) + "\n", encoding="utf-8")
    return path


def rest_of(tracked: Tracked, plant: int) -> float:
    """Return the distance at which a robot rests from the last waypoint [m]."""
    return float(tracked.robots[plant].metrics["rest_off_m"])


@pytest.mark.parametrize("law", ["mpc", "lqr-scheduled+predictor"])
@pytest.mark.parametrize("name", PATHS)
def test_a_robot_ends_within_millimetres(name: str, law: str, tmp_path: Path) -> None:
    """On the planar model, whose friction holds a robot some millimetres off, and in MuJoCo."""
    path = path_file(tmp_path, name)
    tracked = track(law, path, ("improved", "mujoco"), speed=0.4)
    for k, most in enumerate((0.012, 0.006)):
        followed = tracked.robots[k]
        assert not followed.run.lost
        assert rest_of(tracked, k) < most, followed.plant
        assert followed.metrics["cross_track_max_m"] < 0.08
        assert abs(float(wrap_angle(followed.run.column("yaw")[-1] - PATHS[name][-1][2]))) < 0.06
        assert (followed.target.twist[:, 0].min() < -0.3) == (name in REVERSING)


@pytest.mark.parametrize("law", ["pid", "lqr"])
def test_every_law_turns_on_the_spot(law: str, tmp_path: Path) -> None:
    tracked = track(law, path_file(tmp_path, "spot"), ("mujoco",), speed=0.4)
    assert rest_of(tracked, 0) < 0.03
    assert tracked.robots[0].metrics["cross_track_max_m"] < 0.12


@pytest.mark.parametrize("law", ["pid", "lqr", "pid+predictor"])
def test_a_law_that_cannot_reverse_is_refused_by_name_and_place(law: str, tmp_path: Path) -> None:
    path = str(path_file(tmp_path, "dock"))
    refusal = (
        r"dock: waypoint 22: the path asks the robot to drive backwards at \(2, 1.6\) m, "
        + f"which {law}".replace("+", r"\+")
        + r" cannot do; these can: lqr-scheduled, lqr-scheduled\+predictor, mpc"
    )
    with pytest.raises(ValueError, match=refusal):
        track(law, path, speed=0.4)
    with pytest.raises(ValueError, match=refusal):
        tune(law, path, speed=0.4, generations=1)
    with pytest.raises(ValueError, match=refusal):
        control(Control(law, path, speed=0.4))


def test_a_law_of_the_users_follows_what_it_says(lab: Profile, tmp_path: Path) -> None:
    class Mine:
        def command(self, now: object) -> tuple[float, float]:
            return 0.0, 0.0

    path = str(path_file(tmp_path, "dock"))
    robots = [make_robot(lab, "mujoco")]
    with pytest.raises(ValueError, match=r"drive backwards at .* which Mine cannot do"):
        open_path(path, 0.4, robots, chosen_controller(Mine, lab)[0])
    Mine.manoeuvres = ("drive backwards",)  # type: ignore[attr-defined]
    open_path(path, 0.4, robots, chosen_controller(Mine, lab)[0])


@cache
def by_mpc(corner: float, backwards: bool, wait: float) -> tuple[float, float]:
    """Return how far mpc ends from a path that goes back, and how far it passes its corner [m]."""
    profile = load_profile("thesis-lab")
    robot = make_robot(profile, "improved")
    t = [0.0, 3.0, 3.0 + wait, 6.0 + wait] if wait else [0.0, 3.0, 6.0]
    end = [1.0 + math.cos(corner), math.sin(corner)]
    xy = [[0.0, 0.0], *[[1.0, 0.0]] * (len(t) - 2), end]
    yaw = np.zeros(len(t)) if backwards else None
    mpc = chosen_controller("mpc", profile)[0]
    _, waypoints, _ = open_path(Waypoints(np.array(t), np.array(xy), yaw), None, [robot], mpc)
    run = run_loop(robot.plant, mpc.on(robot.drive), waypoints, LoopSettings("truth", rest=5.0), 0)
    places = run.columns("x", "y")
    return math.dist(places[-1], end), float(np.hypot(*(places - [1.0, 0.0]).T).min())


@pytest.mark.parametrize("wait", [0.0, 2.0])
@pytest.mark.parametrize(
    ("corner", "backwards"), [(140.0, False), (149.0, False), (180.0, False), (180.0, True)]
)
def test_mpc_goes_on_where_its_path_goes_back(corner: float, backwards: bool, wait: float) -> None:
    """Both legs are equally near there: it stood for ever where the clock did not lead."""
    rest, beside = by_mpc(math.radians(corner), backwards, wait)
    assert rest < 0.012
    assert beside < 0.1  # a target that turns at once at full speed is not followed to the corner


@pytest.mark.parametrize("x_icr", [-0.2, 0.0, 0.2])
@pytest.mark.parametrize("delay", [0.0, 0.3])
@pytest.mark.parametrize("share", [0.2, 0.5, 1.2])
def test_mpc_rests_at_the_end_whatever_share_of_a_turn_a_robot_has(
    lab: Profile, tmp_path: Path, share: float, delay: float, x_icr: float
) -> None:
    """Its model has the turn that was asked for, and a middle that never moves aside.

    Before it had learnt, slow robots took their errors for uncertain times, and those that turn
    about a point ahead of their middle stood still: to turn led away from the path at first.
    """
    icr = lab.section("kinematic").parameters
    numbers = {"delay_v": delay, "delay_w": delay, "x_icr": x_icr, "w_max": math.inf}
    numbers["command_half_track"] = 0.5 * share * (icr.y_l - icr.y_r)
    robot = make_robot(lab.with_(kinematic=numbers), "kinematic")
    assert all(math.isfinite(limit) for limit in limits_of([robot], 0.4))
    mpc = chosen_controller("mpc", lab)[0]
    corner = tmp_path / "corner.csv"
    corner.write_text("x,y\n0,0\n2,0\n2,2\n0,2\n", encoding="utf-8")
    for path, speed, beside in (("circle@0.25", None, 0.12), (str(corner), 0.4, 0.3)):
        _, waypoints, _ = open_path(path, speed, [robot], mpc)
        (run,) = run_robots([robot], [mpc], [LoopSettings(rest=2.0)], waypoints, [0])
        metrics = track_metrics(run, waypoints, robot.limits)
        assert metrics["rest_off_m"] < 0.04
        assert metrics["cross_track_max_m"] < beside


@pytest.mark.parametrize("stop_at", [math.inf, 6.5])
@pytest.mark.parametrize("name", ["dock", "spot", "about"])
def test_the_follower_of_ros_drives_the_same_path(
    lab: Profile, tmp_path: Path, name: str, stop_at: float
) -> None:
    """Also where an emergency stop holds it for two seconds while it turns on the spot."""
    section = lab.plants["mujoco"]
    law = chosen_controller("mpc", lab)[0].on(section.drive)
    path = str(path_file(tmp_path, name))
    _, waypoints, _ = open_path(path, 0.4, [make_robot(lab, "mujoco")], law)
    robot = MujocoPlant(section.parameters, section.drive)
    faults = Faults(
        begin=stop_at, stopped=lambda t: 0.0 <= t < 1.0, confirmed=lambda t: not 0.0 <= t < 2.0
    )
    done = drive_with_faults(robot, law, waypoints, faults)
    assert not done.stopped
    assert done.follower.phase == "arrived"
    assert done.rest_off < 0.01
    assert done.off().max() < 0.08
    assert done.rows[-1][0] < waypoints.duration + 10.0


def test_a_reference_with_times_turns_in_its_waits(lab: Profile) -> None:
    robots = [make_robot(lab, "improved")]
    mpc = chosen_controller("mpc", lab)[0]
    places = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    patient = Waypoints(np.array([0.0, 3.0, 9.0, 12.0]), places)
    _, path, sentences = open_path(patient, None, robots, mpc)
    assert path.duration == pytest.approx(12.0)
    assert sentences == []
    assert path.xy[[0, 1, -2, -1]] == pytest.approx(places)
    hasty = Waypoints(np.array([0.0, 3.0, 3.5, 6.5]), places)
    _, path, (sentence,) = open_path(hasty, None, robots, mpc)
    assert f"takes {path.duration:.1f} s instead of 6.5 s" in sentence
    assert path.duration > 8.0


def test_a_path_that_reverses_has_no_side_behind_its_target(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="lookahead keeps the robot behind"):
        track("mpc", path_file(tmp_path, "dock"), speed=0.4, lookahead=0.2)


@pytest.mark.parametrize(
    ("text", "refusal"),
    [
        ("x,y,yaw\n0,0,0\n1,0,0\n1,1,0\n", "line 4, column yaw: the robot drives along its yaw"),
        ("x,y,yaw\n0,0,0\n1,0,0\n1,0,0\n2,0,0\n", "line 4: it is where the one before is"),
        ("x,y,yaw\n0,0,0\n1,0,north\n", "line 3, column yaw: .*'north'"),
        ("x,y,yaw,Yaw\n0,0,0,0\n1,0,0,0\n", "column yaw: the header names this column twice"),
    ],
)
def test_yaws_that_say_nothing_are_refused_by_line(text: str, refusal: str, tmp_path: Path) -> None:
    path = tmp_path / "way.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(FileError, match=refusal):
        read_waypoints(path, 0.4)


def test_as_many_yaws_as_waypoints() -> None:
    with pytest.raises(ValueError, match="yaw has shape"):
        Waypoints.from_path([[0.0, 0.0], [1.0, 0.0]], 0.4, [0.0])
