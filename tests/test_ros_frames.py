"""Paths that have a frame: where it is told, where they are driven, and what its jumps are."""

from __future__ import annotations

import logging
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.control.waypoints import Waypoints
from ssmr.geometry import compose_poses, invert_pose, wrap_angle
from tests.conftest import ROUNDOFF, distances_to_path
from tests.ros_fakes import FakeNode, RobotNode, message
from validation import cli
from validation.experiment.gains import load_gains
from validation.experiment.loops import make_controller
from validation.experiment.waypoint_files import frame_of_waypoints, read_waypoints
from validation.files.reading import FileError
from validation.plants.profile import Profile
from validation.ros import messages as msg
from validation.ros.__main__ import PROGRAM
from validation.ros.control import Control, ControlNode, _waypoints_of, _with_topics
from validation.ros.follower import PathFollower, StoppedError

COMMAND = "/cmd_vel"
ODOM_IN_MAP = np.array([4.0, -3.0, 2.5])
"""Pose of the odometry's frame in the map [m, m, rad]; the robot stands at its origin."""
BEND = Waypoints(
    np.arange(13.0) * 0.5,
    1.2 * np.column_stack([np.sin(np.arange(13) / 10), 1 - np.cos(np.arange(13) / 10)]),
)
"""A left bend of 1.2 m radius at 0.24 m/s, 6 s long."""


def places_in_map(xy: np.ndarray[Any, Any], odom: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return (N, 2) places [m] of the odometry's frame in the map."""
    poses = np.column_stack([xy, np.zeros(len(xy))])
    return np.asarray(compose_poses(odom, poses)[:, :2])


def bend_in_map(odom: np.ndarray[Any, Any] = ODOM_IN_MAP) -> Waypoints:
    """Return the bend from a robot's place at the odometry's origin, in the map."""
    heading = BEND.start.yaw
    turned = compose_poses(odom, np.array([0.0, 0.0, -heading]))
    return Waypoints(BEND.t, places_in_map(BEND.xy, turned))


def tell_transform(node: RobotNode, arrival: float, *transforms: tuple[str, str, Any]) -> None:
    """Let a message of /tf come."""
    came = []
    for parent, child, pose in transforms:
        came += msg.transform_message(arrival, (parent, child), np.array(pose))["transforms"]
    node.plan("/tf", arrival, message({"transforms": came}))


def framed_drive(
    lab: Profile, way: Waypoints, name: str = "mpc", **options: Any
) -> tuple[ControlNode, RobotNode, PathFollower]:
    """Return a drive of a robot that stands at the origin of its odometry, along a path in map."""
    node = RobotNode(COMMAND)
    options = {"frame": "map", **options}
    o = _with_topics(Control(name, "circle", **options), "husky")
    law = make_controller(lab, load_gains(name))
    follower = PathFollower(law, way, framed=bool(o.frame), patience=o.patience)
    return ControlNode(node, follower, o), node, follower


def sent_by(node: RobotNode) -> np.ndarray[Any, Any]:
    """Return (M, 3) instants [s] and commands."""
    return np.array([(t, *msg.read_twist(m)) for t, m in node.of(COMMAND)])


def path_of(node: RobotNode) -> np.ndarray[Any, Any]:
    """Return (M, 2) where a robot was in its odometry's frame, by the commands that it obeyed."""
    return np.array(node.ways)


# --- frames ---

POSES = st.tuples(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.floats(-9.0, 9.0))


@given(st.lists(st.tuples(st.integers(0, 7), POSES), min_size=2, max_size=8), st.data())
def test_one_frame_in_another_is_the_way_back_turned_round(
    links: list[tuple[int, tuple[float, float, float]]], data: st.DataObject
) -> None:
    """In any tree; a frame whose parent is later in the list makes trees, and others circles."""
    tree = msg.FrameTree()
    for child, (parent, pose) in enumerate(links):
        tree.take([(f"f{parent}", f"f{child}", np.array(pose))])
    frames = [f"f{k}" for k in range(9)]
    a, b, c = (data.draw(st.sampled_from(frames)) for _ in range(3))
    try:
        there = tree.pose_in(a, b)
        onwards = tree.pose_in(b, c)
    except ValueError:  # nothing connects them
        return
    back = tree.pose_in(b, a)
    if all(parent > child for child, (parent, _) in enumerate(links)):
        assert compose_poses(there, back) == pytest.approx(np.zeros(3), abs=1e6 * ROUNDOFF)
        whole = compose_poses(there, onwards)
        assert whole == pytest.approx(tree.pose_in(a, c), abs=1e6 * ROUNDOFF)


def test_frames_without_end_take_no_memory_without_end() -> None:
    tree = msg.FrameTree()
    tree.take([("odom", "base_link", np.zeros(3))])
    for k in range(5000):
        tree.take([("odom", f"f{k}", np.zeros(3))])
    with pytest.raises(ValueError, match="nobody says where f4999 is in odom"):
        tree.pose_in("odom", "f4999")
    tree.take([("odom", "base_link", np.ones(3))])
    assert tree.pose_in("odom", "base_link") == pytest.approx(np.ones(3))


# --- drives ---


@pytest.mark.parametrize("name", ["pid", "mpc"])
def test_a_path_in_a_frame_is_driven_as_one_from_the_robot(lab: Profile, name: str) -> None:
    """Wherever the frame is: where the robot stands at its beginning nothing else is commanded."""
    loop, node, follower = framed_drive(lab, bend_in_map(), name)
    tell_transform(node, 0.0, ("map", "odom", ODOM_IN_MAP), ("odom", "base_link", np.zeros(3)))
    loop.run()
    assert follower.phase == "arrived"
    other, anchored, _ = framed_drive(lab, BEND, name, frame="")
    other.run()
    ours, theirs = sent_by(node), sent_by(anchored)
    n = min(len(ours), len(theirs))
    np.testing.assert_allclose(ours[:n], theirs[:n], atol=1e-5)
    run = follower.run()
    xy = run.columns("x", "y")
    assert distances_to_path(xy, follower.waypoints.xy).max() < 0.05
    driven = places_in_map(path_of(node), ODOM_IN_MAP)
    assert distances_to_path(driven, follower.waypoints.xy).max() < 0.05


def test_a_taught_path_is_repeated_from_where_the_robot_now_stands(lab: Profile) -> None:
    """Beside the beginning and turned, as a robot is put back: it ends at the same place."""
    for off in ((0.0, 0.2, 0.2), (-0.25, -0.1, -0.3)):
        stands = compose_poses(ODOM_IN_MAP, np.array(off))
        loop, node, follower = framed_drive(lab, bend_in_map())
        tell_transform(node, 0.0, ("map", "odom", stands))
        loop.run()
        driven = places_in_map(path_of(node), stands)
        assert np.hypot(*(driven[-1] - follower.waypoints.xy[-1])) < 0.03
        away = distances_to_path(driven, follower.waypoints.xy)
        assert away[-len(away) // 2 :].max() < 0.03


@pytest.mark.parametrize("off", [(0.7, 0.0, 0.0), (0.0, 0.0, 0.6), (0.0, 0.3, math.pi)])
def test_a_robot_that_stands_elsewhere_is_not_driven(
    lab: Profile, off: tuple[float, float, float]
) -> None:
    loop, node, _ = framed_drive(lab, bend_in_map(), patience=3.0)
    tell_transform(node, 0.0, ("map", "odom", compose_poses(ODOM_IN_MAP, np.array(off))))
    why = rf"stands {math.hypot(*off[:2]):.2f} m and -?{off[2]:.2f} rad from the beginning"
    with pytest.raises(StoppedError, match=why):
        loop.run()
    assert not node.sent


def test_a_frame_that_nobody_publishes_is_said_with_those_that_are_seen(lab: Profile) -> None:
    loop, node, _ = framed_drive(lab, bend_in_map(), patience=3.0)
    tell_transform(node, 0.0, ("odom", "base_link", np.zeros(3)), ("earth", "utm", np.zeros(3)))
    why = "nobody says where odom is in map; frames that are seen: base_link, earth, odom, utm"
    with pytest.raises(StoppedError, match=f"no robot to drive after 3 s: {why}"):
        loop.run()
    assert not node.sent


def drive_with_step(
    lab: Profile, name: str, step: tuple[float, float, float]
) -> tuple[float, RobotNode, PathFollower]:
    """Drive while the frame moves by a step in it; return how far from the end the robot rests."""
    loop, node, follower = framed_drive(lab, bend_in_map(), name)
    after = compose_poses(ODOM_IN_MAP, np.array(step))
    for k in range(400):
        tell_transform(node, 0.05 * k, ("map", "odom", ODOM_IN_MAP if k < 60 else after))
    loop.run()
    driven = places_in_map(path_of(node), after)
    return math.dist(driven[-1], follower.waypoints.xy[-1]), node, follower


@pytest.mark.parametrize("name", ["pid", "lqr-scheduled+predictor", "mpc"])
def test_a_jump_of_the_frame_is_no_jump_of_the_robot(lab: Profile, name: str) -> None:
    """A localiser corrects itself: the robot goes on to the path where that now is."""
    usual, _, _ = drive_with_step(lab, name, (0.0, 0.0, 0.0))
    for step in ((0.0, 0.15, 0.0), (0.05, -0.1, 0.1), (-0.3, 0.0, 0.0)):
        rests, node, follower = drive_with_step(lab, name, step)
        assert follower.phase == "arrived"
        assert follower.held_time == 0.0
        assert follower.frame_step == pytest.approx(math.hypot(*step[:2]), abs=0.15)
        way = math.hypot(*step[:2])
        # mpc makes up for it; the others are late by some of it when the end comes
        assert rests < usual + (0.03 if name == "mpc" else 0.5 * way)
        _, v, w = np.abs(sent_by(node)).max(axis=0)
        assert v <= follower.v_limit
        assert w <= follower.w_limit


def test_a_frame_that_takes_the_path_away_stops_the_robot(lab: Profile) -> None:
    loop, node, _ = framed_drive(lab, bend_in_map())
    away = compose_poses(ODOM_IN_MAP, np.array([0.0, 0.9, 0.0]))
    for k in range(200):
        tell_transform(node, 0.05 * k, ("map", "odom", ODOM_IN_MAP if k < 60 else away))
    with pytest.raises(
        StoppedError, match=r"m from its path at .*; the path's frame moved by 0\.9"
    ):
        loop.run()
    assert np.all(sent_by(node)[-9:, 1:] == 0.0)


def test_a_heading_that_the_frame_turns_past_half_a_turn_goes_on(lab: Profile) -> None:
    """The law's heading has no jump where the frame's passes from pi to -pi."""
    odom = np.array([1.0, 2.0, math.pi - 0.01])
    loop, node, follower = framed_drive(lab, bend_in_map(odom))
    for k in range(300):
        turned = odom + np.array([0.0, 0.0, min(0.001 * k, 0.05)])
        turned[2] = float(wrap_angle(turned[2]))
        tell_transform(node, 0.05 * k, ("map", "odom", turned))
    loop.run()
    assert follower.phase == "arrived"
    yaw = follower.run().column("seen_yaw")
    assert np.abs(np.diff(yaw)).max() < 0.1


def test_odometry_of_another_frame_is_refused_and_said(lab: Profile) -> None:
    """Two nodes send it: the one that was there first is believed."""
    loop, node, _ = framed_drive(lab, BEND, frame="", patience=3.0)
    other = msg.odometry_message(1.0, np.ones(3), (0.0, 0.0), np.eye(3), np.eye(3))
    other["child_frame_id"] = "camera_link"
    node.plan(msg.FILTERED_TOPIC, 0.0, message(other))
    why = r"its frames are \[.odom., .base_link.\], and were \[.odom., .camera_link.\]"
    with pytest.raises(StoppedError, match=why):
        loop.run()


# --- files, topics, the command line ---


def test_a_file_names_its_frame(tmp_path: Path) -> None:
    path = tmp_path / "way.csv"
    for text, frame in (
        ("x,y,frame\n0,0,map\n1,0,map\n", "map"),
        ("Frame;x;y\nrobot1/odom;0,5;0\nrobot1/odom;1;0\n", "robot1/odom"),
        ("x,y\n0,0\n1,0\n", ""),
        ("x,y,frame\n0,0,\n1,0,\n", ""),
    ):
        path.write_text(text, encoding="utf-8")
        assert frame_of_waypoints(str(path)) == frame
        assert len(read_waypoints(path, 0.2)) == 2
    for mixed in ("odom", "map2", "", "a/map"):
        path.write_text(f"x,y,frame\n0,0,map\n1,0,{mixed}\n", encoding="utf-8")
        with pytest.raises(FileError, match="not all waypoints are in the frame 'map'"):
            frame_of_waypoints(str(path))
    assert frame_of_waypoints("circle@0.4") == ""


def path_message(xy: np.ndarray[Any, Any], frame: str = "map") -> Any:
    """Return a nav_msgs/Path."""
    poses = [msg.pose_message(0.0, "", np.resize([*at, 0.0], 3)) for at in xy]
    return message(
        {"header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame}, "poses": poses}
    )


def test_places_of_a_path_are_read_or_refused() -> None:
    frame, poses = msg.read_path(path_message(np.array([[0, 0], [1, 0], [1, 0], [1, 2]]), "/map"))
    assert frame == "map"
    assert poses[:, :2].tolist() == [[0, 0], [1, 0], [1, 2]]
    for bad in (np.zeros((0, 2)), np.zeros((3, 2)), np.array([[0.0, 0.0], [math.nan, 1.0]])):
        with pytest.raises(ValueError, match=r"two places|is nan"):
            msg.read_path(path_message(bad))


@pytest.mark.parametrize(
    ("yaws", "backwards"),
    [
        ([math.pi, math.pi, 3.0], [False, False]),  # one for all but the goal
        ([3.1, 3.2, 3.2], [True, True]),
        ([0.0, 0.1, 3.2], [False, False]),  # nobody knows
        ([0.0, 0.1, 0.0], [False, False]),
        ([0.0, 1.5, 0.0], [False, False]),  # across
    ],
)
def test_a_path_is_driven_backwards_where_its_poses_say_so(
    yaws: list[float], backwards: list[bool]
) -> None:
    xy = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    _, poses = msg.read_path(path_message(np.column_stack([xy, yaws])))
    path = _waypoints_of(poses)
    assert path.xy.tolist() == xy.tolist()
    assert path.backwards.tolist() == backwards


@pytest.mark.parametrize("kind", ["file", "topic"])
def test_the_program_drives_a_path_in_a_frame(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    node = RobotNode(COMMAND)
    planner = FakeNode()
    tell_transform(node, 0.0, ("map", "odom", ODOM_IN_MAP))
    nodes = {"path": planner, "husky_control": node}
    control = sys.modules[ControlNode.__module__]
    monkeypatch.setattr(control, "Node", lambda name, graph: nodes[name])
    straight = places_in_map(np.array([[0.0, 0.0], [0.7, 0.0], [1.4, 0.0]]), ODOM_IN_MAP)
    reference = "/plan"
    if kind == "file":
        rows = [f"{x},{y},map" for x, y in straight]
        (tmp_path / "way.csv").write_text("\n".join(["x,y,frame", *rows]), encoding="utf-8")
        reference = str(tmp_path / "way.csv")
    else:
        planner.plan("/plan", 0.5, path_message(straight))
    command = ("control", "mpc", reference, "--speed", "0.25", "--out", str(tmp_path / "out"))
    cli.run_command(PROGRAM, "ros", command)
    capsys.readouterr()
    end = places_in_map(path_of(node), ODOM_IN_MAP)[-1]
    assert np.hypot(*(end - straight[-1])) < 0.03
    text = (tmp_path / "out" / "track.json").read_text(encoding="utf-8")
    assert '"frame": "map"' in text
    if kind == "file":
        with pytest.raises(SystemExit) as ended:
            cli.run_command(PROGRAM, "ros", (*command, "--frame", "odom"))
        assert ended.value.code == cli.EXIT_USER_ERROR
        assert "is in the frame map, and --frame is odom" in " ".join(
            capsys.readouterr().err.split()
        )


def test_a_path_that_never_comes_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    node = RobotNode(COMMAND)
    monkeypatch.setattr(sys.modules[ControlNode.__module__], "Node", lambda name, graph: node)
    with pytest.raises(SystemExit) as ended:
        cli.run_command(PROGRAM, "ros", ("control", "mpc", "/plan", "--out", str(tmp_path / "o")))
    assert ended.value.code == 1
    assert "no path on /plan for 30 s: nothing came" in capsys.readouterr().err
    assert not node.sent


def test_the_pose_is_followed_in_its_own_frame(
    lab: Profile, caplog: pytest.LogCaptureFixture
) -> None:
    """With --feedback pose the frame is that of the poses, and /tf is not needed."""
    world = np.array([5.0, 0.0, 0.0])
    loop, node, follower = framed_drive(
        lab, bend_in_map(world), frame="world", feedback="pose", pose="/mocap"
    )
    node.tracking = "/mocap"
    with caplog.at_level(logging.WARNING, "validation"):
        loop.run()
    assert follower.phase == "arrived"
    assert np.hypot(*(path_of(node)[-1] + world[:2] - follower.waypoints.xy[-1])) < 0.03
    assert invert_pose(world)[0] == -5.0
