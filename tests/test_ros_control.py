"""The node that drives.

It is the closed loop of the process, stops when in doubt, and keeps every drive.
"""

from __future__ import annotations

import contextlib
import json
import logging
import math
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ssmr.control.law import Observation
from ssmr.control.laws import Controller
from ssmr.control.loop import VELOCITY_PERIOD, LoopSettings, run_loop
from ssmr.control.references import line
from ssmr.control.waypoints import Waypoints
from ssmr.errors import ControllerError
from ssmr.types import State
from tests.conftest import distances_to_path
from tests.ros_fakes import FakeNode, RobotNode, message, odometry
from tests.test_user_law import FAULTY, GOOD, written
from validation import cli
from validation.experiment.gains import load_gains
from validation.experiment.loops import chosen_controller, make_controller
from validation.plants.profile import Profile, make_plant
from validation.ros import messages as msg
from validation.ros.__main__ import PROGRAM
from validation.ros.control import STOP_TIME, Control, ControlNode, _with_topics
from validation.ros.follower import FRESH, PathFollower, StoppedError
from validation.ros.watch import BRAKING, SURE

COMMAND = "/cmd_vel"
POSE = msg.tracking_topic("husky")
BEND = Waypoints(
    np.arange(13.0) * 0.5,
    1.2 * np.column_stack([np.sin(np.arange(13) / 10), 1 - np.cos(np.arange(13) / 10)]),
)
"""A left bend of 1.2 m radius at 0.24 m/s, 6 s long."""
SHORT = Waypoints(BEND.t[:7], BEND.xy[:7])
REST = Observation(0.0, 0.0, 0.0, 0.0, 0.0)


def law(lab: Profile, name: str = "pid") -> Controller:
    return make_controller(lab, load_gains(name))


def follower_of(lab: Profile, waypoints: Waypoints = BEND, **settings: Any) -> PathFollower:
    return PathFollower(law(lab), waypoints, **settings)


def started(
    follower: PathFollower, at: Observation = REST, stamp: float = 10.0, period: float = 0.02
) -> float:
    """Messages of a robot that stands, until the follower drives; the stamp then."""
    for k in range(20):
        follower.update(stamp + k * period, at, stamp + k * period)
        if follower.phase == "driving":
            return stamp + k * period
    return math.nan


# --- the path follower ---


@pytest.mark.parametrize("name", ["pid", "lqr-scheduled", "lqr-scheduled+predictor"])
def test_driving_by_messages_is_the_closed_loop_of_the_process(lab: Profile, name: str) -> None:
    """Same instants, perfect messages, any start: the same motion, to the first tick."""
    controller = law(lab, name)
    settings = LoopSettings("truth", disturbance=False, position_period=0.01, rest=4.0)
    plant = make_plant(lab, "improved")
    expected = run_loop(plant, controller, SHORT.braked(BRAKING), settings, 0).motion
    state = plant.reset(State(3.0, -2.0, 2.5))
    follower = PathFollower(controller, SHORT, v_limit=1.0)
    command = (0.0, 0.0)
    steps = round(0.01 / plant.dt)

    def seen() -> Observation:
        return Observation(
            state.x, state.y, math.remainder(state.yaw, 2.0 * math.pi), state.v_x, state.yaw_rate
        )

    begin = started(follower, seen(), 5.0, 0.01)
    k = 0
    while follower.phase == "driving":
        if k:
            follower.update(begin + 0.01 * k, seen(), begin + 0.01 * k)
        if k % 5 == 0:
            command = follower.command(begin + 0.01 * k)
        for _ in range(steps):
            state = plant.step(command, plant.dt)
        k += 1
    run = follower.run()
    n = len(run.t)
    np.testing.assert_allclose(run.columns("x", "y"), expected.xy[:n], atol=1e-3)
    np.testing.assert_allclose(run.column("yaw"), expected.yaw[:n], atol=2e-3)


def test_it_waits_for_a_robot_that_stands_and_speaks_steadily(lab: Profile) -> None:
    follower = follower_of(lab)
    assert follower.command(0.0) == (0.0, 0.0)
    fast = REST._replace(v=0.3)
    turning = REST._replace(w=-0.1)
    for why, at, stamp, period in (
        ("moves", fast, 10, 0.02),
        ("moves", turning, 12, 0.02),
        ("steadily", REST, 20, 1.0),
    ):
        assert math.isnan(started(follower, at, stamp, period))
        assert why in follower.why_waiting
    assert started(follower, REST, 50.0) == pytest.approx(50.1)
    with pytest.raises(StoppedError, match="not driven"):
        follower_of(lab).run()


def test_it_stops_on_stale_feedback_and_says_what_came_instead(lab: Profile) -> None:
    follower = follower_of(lab)
    now = started(follower)
    follower.command(now + FRESH)
    with pytest.raises(StoppedError, match=r"^no feedback for 0\.51 s$"):
        follower.command(now + FRESH + 0.01)
    with pytest.raises(
        StoppedError, match=r"no feedback that can be used for 0\.60 s: 27 messages were refused"
    ):
        follower.command(now + 0.6, "27 messages were refused")
    for k in range(40):
        follower.update(now, REST, now + 0.02 * k)
    with pytest.raises(StoppedError, match=r"used for 0\.80 s: 40 messages are not newer than"):
        follower.command(now + 0.8)


@pytest.mark.parametrize(
    ("jump", "x", "why"),
    [
        (FRESH + 0.01, 0.0, "stamps of the feedback jumped"),
        (0.02, 0.5, r"pose jumped, or stayed behind, by 0\.50 m"),
        (0.02, -2.0, r"pose jumped, or stayed behind, by 2\.00 m"),
        (0.4, 0.05, ""),
    ],
)
def test_it_stops_when_clock_or_pose_jump(lab: Profile, jump: float, x: float, why: str) -> None:
    follower = follower_of(lab)
    now = started(follower)
    with pytest.raises(StoppedError, match=why) if why else contextlib.nullcontext():
        for k in range(SURE):
            at = jump + 0.02 * k
            follower.update(now + at, REST._replace(x=x), now + at)


def test_one_wrong_pose_is_passed_over(lab: Profile) -> None:
    follower = follower_of(lab)
    now = started(follower)
    for k in range(1, 20):
        x = 9.0 if k == 5 else 0.0
        follower.update(now + 0.02 * k, REST._replace(x=x), now + 0.02 * k)
    assert np.all(follower.run().column("seen_x") == BEND.start.x)


def test_old_messages_and_those_that_are_not_finite_change_nothing(lab: Profile) -> None:
    follower = follower_of(lab)
    now = started(follower)
    for k in range(1, 10):
        at = now + 0.02 * k
        follower.update(at, REST, at)
        follower.update(at - 0.01, REST._replace(x=5.0), at)
        follower.update(at + 0.005, REST._replace(yaw=math.nan), at)
    run = follower.run()
    assert run.t[-1] == pytest.approx(0.18)
    assert np.all(run.column("seen_x") == BEND.start.x)


def test_it_stops_a_robot_that_goes_astray(lab: Profile) -> None:
    follower = follower_of(lab)
    now = started(follower)

    def go_backwards() -> None:
        for k in range(1, 400):
            back = REST._replace(x=-0.02 * k, v=-1.0)
            follower.update(now + 0.02 * k, back, now + 0.02 * k)

    with pytest.raises(StoppedError, match="does somebody else drive it"):
        go_backwards()


def test_commands_keep_their_limits_and_those_that_cannot_be_are_refused(lab: Profile) -> None:
    follower = follower_of(lab, v_limit=0.26, w_limit=0.1)
    now = started(follower)
    sent = [(0.0, 0.0)] * 5
    seen = REST
    for k in range(1, 55):  # a robot that answers late, on a path that bends more than it may
        v, w = sent[-5]
        x = seen.x + 0.05 * v * math.cos(seen.yaw)
        y = seen.y + 0.05 * v * math.sin(seen.yaw)
        seen = Observation(x, y, seen.yaw + 0.05 * w, v, w)
        follower.update(now + 0.05 * k, seen, now + 0.05 * k)
        sent.append(follower.command(now + 0.05 * k))
    assert np.abs(sent).max(axis=0).tolist() == [0.26, 0.1]
    with pytest.raises(ValueError, match=r"0\.24 m/s"):
        follower_of(lab, v_limit=0.2)
    for bad in ({"v_limit": -1.0}, {"w_limit": math.nan}, {"lookahead": -0.1}):
        with pytest.raises(ValueError, match=next(iter(bad))):
            follower_of(lab, **bad)


def test_a_tracking_system_judges_and_its_half_turns_are_no_jumps(lab: Profile) -> None:
    """The tracking system's frame is its own: only the way from the start counts (Sec. 4.2)."""
    follower = follower_of(lab)
    turned = math.pi - 0.05
    follower.track(9.99, Observation(7.0, 8.0, turned, math.nan, math.nan))
    now = started(follower)
    for k in range(11):
        t = now + 0.02 * k
        way = 0.01 * k
        follower.update(t, REST._replace(x=0.5 * way), t)
        there = (
            7.0 + way * math.cos(turned),
            8.0 + way * math.sin(turned),
            math.remainder(turned + way, 2 * math.pi),
        )
        follower.track(t, Observation(*there, 0.0, 0.0))
    assert follower.tracked
    start = BEND.start
    run = follower.run()
    x, y, yaw = run.columns("x", "y", "yaw")[-1]
    assert math.hypot(x - start.x, y - start.y) == pytest.approx(0.1, abs=1e-9)
    assert yaw == pytest.approx(start.yaw + 0.1, abs=1e-9)
    assert run.column("seen_x")[-1] - run.column("seen_x")[0] == pytest.approx(
        0.05 * math.cos(start.yaw), abs=1e-9
    )


# --- the node ---


def options_of(**options: Any) -> Control:
    """Options whose topics have their usual names."""
    return _with_topics(Control("pid", "circle", **options), "husky")


def node_of(lab: Profile, **options: Any) -> tuple[ControlNode, FakeNode, PathFollower]:
    node = FakeNode()
    follower = follower_of(lab, line(0.2, 1.2))
    return ControlNode(node, follower, options_of(**options)), node, follower


def speak(node: FakeNode, until: float, begin: float = 0.0, x: float = 0.0) -> None:
    """Let odometry of a robot that stands come at 50 Hz."""
    for k in range(round(50.0 * begin), round(50.0 * until)):
        node.plan(
            msg.FILTERED_TOPIC,
            0.02 * k,
            odometry(0.02 * k + 1.0, x),
        )


def commands(node: FakeNode) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and (M, 2) commands that were sent."""
    return np.array([t for t, _ in node.of(COMMAND)]), np.array(
        [msg.read_twist(m) for _, m in node.of(COMMAND)]
    )


def stands(node: FakeNode) -> bool:
    """Whether the robot was commanded to stand at the end, and for how long it should be."""
    return bool(np.all(commands(node)[1][-9:] == 0.0))


def test_commands_come_at_20_hz_to_who_listens_and_end_in_a_stop(lab: Profile) -> None:
    loop, node, follower = with_robot(lab)
    node.robot_at = 1.0
    loop.run()
    assert follower.phase == "arrived"
    t, sent = commands(node)
    assert 1.0 <= t[0] < 1.2
    driving = t < t[-1] - STOP_TIME - 0.05
    assert np.count_nonzero(driving) >= 20.0 * follower.waypoints.duration - 2
    np.testing.assert_allclose(np.diff(t[driving]), VELOCITY_PERIOD, atol=1e-9)
    assert np.count_nonzero(np.all(sent == 0.0, axis=1)) >= 9
    assert stands(node)


NAN = math.nan
FAR = 1e300


@pytest.mark.parametrize(
    ("good", "bad", "why"),
    [
        (0.6, None, r"^no feedback for 0\.5\d s$"),
        (
            0.6,
            NAN,
            r"no feedback that can be used for 0\.5\d s: \d\d messages on \S+ were refused, "
            r".*position\.x is nan",
        ),
        (0.0, None, "no robot to drive after 2 s: no feedback yet"),
        (
            0.0,
            FAR,
            r"no robot to drive after 2 s: \d+ messages on \S+ were refused, "
            r".* position\.x is 1e\+300",
        ),
    ],
)
def test_feedback_that_ends_or_cannot_be_used_stops_the_robot_and_the_reason_is_said(
    lab: Profile, good: float, bad: float | None, why: str
) -> None:
    loop, node, _ = node_of(lab, patience=2.0)
    speak(node, good)
    if bad is not None:
        speak(node, 5.0, good, bad)
    with pytest.raises(StoppedError, match=why):
        loop.run()
    t, sent = commands(node) if node.sent else (np.zeros(0), np.zeros((0, 2)))
    if good:
        assert t[np.flatnonzero(np.any(sent != 0.0, axis=1))[-1]] < good + FRESH + 0.051
        assert stands(node)
    else:
        assert not node.sent, (
            "a robot that was not driven is not stopped either: somebody else may drive it"
        )


def test_the_law_may_see_the_tracking_systems_pose(lab: Profile) -> None:
    loop, node, follower = with_robot(lab, feedback="pose")
    node.tracking = POSE
    node.jumped = lambda t: 99.0 * t  # the odometry's pose is nobody's business
    loop.run()
    run = follower.run()
    assert np.hypot(*(run.columns("x", "y") - follower.waypoints.xy[-1])[-1]) < 0.1
    assert follower.tracked


def test_a_flood_of_odometry_delays_no_command(
    lab: Profile, caplog: pytest.LogCaptureFixture
) -> None:
    loop, node, _ = with_robot(lab)
    for k in range(3000):
        node.plan(msg.FILTERED_TOPIC, 1.0 + 1e-3 * k, odometry(2.0, NAN))
    with caplog.at_level(logging.INFO, "validation"):
        loop.run()
    assert np.diff(commands(node)[0]).max() <= 0.051
    assert len(caplog.records) <= 10
    assert stands(node)


# --- a robot that does not obey ---

AT_MOST = 1.2 * 0.2402 / 0.97, 1.2 * 0.2402 / 0.97
"""Commands of speed [m/s] and yaw rate [rad/s] after a hold: 1.2 times those of the path, or of a
bend of 1 m, by the linear model's 0.97."""


def with_robot(
    lab: Profile, name: str = "pid", feedback: Any = "odometry", **robot: float
) -> tuple[ControlNode, RobotNode, PathFollower]:
    node = RobotNode(COMMAND, **robot)
    follower = PathFollower(law(lab, name), BEND)
    return ControlNode(node, follower, options_of(feedback=feedback)), node, follower


@pytest.mark.parametrize("text", [True, False])
@pytest.mark.parametrize("name", ["pid", "lqr-scheduled+predictor", "mpc"])
def test_after_an_emergency_stop_and_a_confirmation_the_robot_goes_on_gently(
    lab: Profile, name: str, text: bool, caplog: pytest.LogCaptureFixture
) -> None:
    """With or without a topic of the stop.

    The target waits where the robot stopped, and nothing has to be caught up. A confirmation that
    comes while the stop is on counts for nothing.
    """
    loop, node, follower = with_robot(lab, name)
    node.blocked = lambda t: 3.0 <= t < 9.0
    for at, on in ((3.0, True), (9.0, False)) if text else ():
        node.plan(msg.STOP_TOPIC, at, message({"data": on}))
    for at in (5.0, 10.0) if text else (10.0,):
        node.plan(msg.RESTART_TOPIC, at, message({"data": True}))
    with caplog.at_level(logging.WARNING, "validation"):
        loop.run()
    assert ("the emergency stop is on" in caplog.text, "no motion is seen" in caplog.text) == (
        text,
        not text,
    )
    assert "the robot goes on" in caplog.text
    assert follower.phase == "arrived"
    assert follower.held_time == pytest.approx(7.0, abs=0.6)
    t, sent = commands(node)
    assert np.all(sent[(t > (3.1 if text else 4.2)) & (t < 10.0)] == 0.0)
    gently = (t > 3.8) & (t < 10.6)
    assert np.all(np.abs(sent[gently]).max(axis=0) <= np.array(AT_MOST) + 1e-3)
    run = follower.run()
    assert run.t[-1] >= follower.waypoints.duration - 0.05
    # it goes on from where it stood, so there is no way that it cuts short
    xy = run.columns("x", "y")
    assert distances_to_path(xy, follower.waypoints.xy).max() < 0.05


def test_a_stop_between_two_messages_holds_the_robot_too(lab: Profile) -> None:
    follower = follower_of(lab)
    now = started(follower)
    follower.take_stop(True)
    follower.take_stop(False)
    follower.update(now + 0.02, REST, now + 0.02)
    assert follower.held
    assert follower.command(now + 0.02) == (0.0, 0.0)
    follower.confirm()
    follower.update(now + 0.04, REST, now + 0.04)
    assert not follower.held


def test_it_gives_up_on_a_robot_that_does_not_move(lab: Profile) -> None:
    loop, node, _ = with_robot(lab)
    node.blocked = lambda t: t > 2.0
    with pytest.raises(StoppedError, match=r"held for 10 s \(no motion is seen where it is told"):
        loop.run()
    assert stands(node)
    t, sent = commands(node)
    assert np.all(sent[t > 3.2] == 0.0)


@pytest.mark.parametrize("released", [True, False])
def test_a_robot_that_nobody_confirms_is_given_up_after_the_patience(
    lab: Profile, released: bool
) -> None:
    loop, node, _ = with_robot(lab)
    node.blocked = lambda t: t > 2.0
    node.plan(msg.STOP_TOPIC, 2.0, message({"data": True}))
    why = "the emergency stop is on"
    if released:
        node.plan(msg.STOP_TOPIC, 4.0, message({"data": False}))
        why = "the emergency stop was released: confirm that the robot may go on"
    with pytest.raises(StoppedError, match=rf"^the robot was held for 30 s \({why}\)$"):
        loop.run()
    t, sent = commands(node)
    assert np.all(sent[t > 2.1] == 0.0)
    assert t[-1] - STOP_TIME == pytest.approx(32.0, abs=0.2)


def test_a_confirmation_waits_until_the_robot_stands(lab: Profile) -> None:
    follower = follower_of(lab)
    now = started(follower)
    follower.take_stop(True)
    follower.take_stop(False)
    follower.confirm()
    x = 0.0
    for k, v in enumerate([0.3, 0.2, 0.1, 0.06, 0.04]):
        x += 0.02 * v
        follower.update(now + 0.02 * (k + 1), REST._replace(x=x, v=v), now + 0.02 * (k + 1))
        assert bool(follower.held) == (v > 0.05)


def test_a_robot_that_comes_no_nearer_to_its_end_has_arrived_after_three_seconds(
    lab: Profile, tmp_path: Path
) -> None:
    """Its law lets it rest more than 20 mm before the end."""
    short = FAULTY.format("return (0.2, 0.0) if now.seen.x < 1.1 else (0.0, 0.0)")
    law_of_user, _ = chosen_controller(f"{written(tmp_path, short)}:Mine", lab)
    node = RobotNode(COMMAND)
    follower = PathFollower(law_of_user, line(0.2, 1.2))
    ControlNode(node, follower, options_of()).run()
    assert follower.phase == "arrived"
    assert stands(node)
    run = follower.run()
    off = np.hypot(*(run.columns("x", "y") - follower.waypoints.xy[-1]).T)
    assert off[-1] > 0.02
    rests = run.t[np.flatnonzero(np.diff(off) < -1e-4)[-1]]
    assert run.t[-1] - max(rests, follower.waypoints.duration) == pytest.approx(3.0, abs=0.3)


def test_any_error_stops_the_robot(lab: Profile, tmp_path: Path) -> None:
    """The error can come from a user's law or from the program itself."""
    fault = FAULTY.format("return (0.1, 0.0) if now.t < 2.0 else 1 / 0")
    bad, _ = chosen_controller(f"{written(tmp_path, fault)}:Mine", lab)
    node = RobotNode(COMMAND)
    loop = ControlNode(node, PathFollower(bad, BEND), options_of())
    with pytest.raises(StoppedError, match="ZeroDivisionError"):
        loop.run()
    assert stands(node)
    loop, node, follower = with_robot(lab)
    command = follower.command

    def broken(now: float, fault: str = "") -> Any:
        if now > 103.0:
            raise MemoryError
        return command(now, fault)

    follower.command = broken  # type: ignore[method-assign]
    with pytest.raises(MemoryError):
        loop.run()
    assert stands(node)
    assert np.any(commands(node)[1][-12] != 0.0), "ten commands, or by rounding eleven"


@pytest.mark.parametrize("moves", [True, False])
def test_a_robot_that_did_not_move_is_asked_by_creeping_only_with_auto(
    lab: Profile, moves: bool
) -> None:
    """Over a tenth of a metre at most, whether it moves or not: who knows that it does not?"""
    _, node, _ = with_robot(lab)
    follower = PathFollower(law(lab), BEND, auto_restart=True)
    loop = ControlNode(node, follower, options_of(restart="auto"))
    node.blocked = lambda t: t > 2.0 and not (moves and t > 6.0)
    with contextlib.nullcontext() if moves else pytest.raises(StoppedError, match="held for 10 s"):
        loop.run()
    t, sent = commands(node)
    asked = (t > 3.2) & (t < 6.0 if moves else t < 20.0)
    assert 0.0 < 0.05 * np.abs(sent[asked, 0]).sum() <= 0.1 + 1e-9
    assert np.abs(sent[asked]).max() <= 0.05
    assert (follower.phase == "arrived") == moves


def test_it_does_not_start_under_an_emergency_stop(lab: Profile) -> None:
    loop, node, _ = with_robot(lab)
    node.plan(msg.STOP_TOPIC, 0.0, message({"data": True}))
    with pytest.raises(
        StoppedError, match=r"no robot to drive after 30 s: the emergency stop is on"
    ):
        loop.run()
    assert not node.sent


@pytest.mark.parametrize(
    ("late", "dead_time", "warned"),
    [(0.0, 0.2, False), (0.2, 0.2, True), (0.0, 0.45, True), (0.0, 0.5, True)],
)
@pytest.mark.parametrize("name", ["pid", "mpc"])
def test_late_odometry_is_said(
    lab: Profile,
    name: str,
    late: float,
    dead_time: float,
    warned: bool,
    caplog: pytest.LogCaptureFixture,
) -> None:
    loop, _, follower = with_robot(lab, name, late=late, dead_time=dead_time)
    with caplog.at_level(logging.WARNING, "validation"):
        loop.run()
    assert ("later than its profile says" in caplog.text) == warned
    assert follower.late == pytest.approx(late + dead_time - 0.2, abs=0.1)


def test_a_pose_that_jumps_stops_the_robot(lab: Profile) -> None:
    loop, node, _ = with_robot(lab)
    node.jumped = lambda t: 2.0 if t > 3.0 else 0.0
    with pytest.raises(StoppedError, match=r"the pose jumped, or stayed behind, by 2\.\d\d m"):
        loop.run()
    assert stands(node)
    t, sent = commands(node)
    assert t[np.flatnonzero(np.any(sent != 0.0, axis=1))[-1]] < 3.1


# --- the command line ---

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Drive:
    """A robot that follows its commands, and a command line that drives it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, out: Path) -> None:
        self.out = out
        self.path = out.parent / "way.csv"
        self.node = RobotNode(COMMAND)
        self.path.write_text("x,y\n0,0\n1,0\n2,0\n", encoding="utf-8")  # 8 s
        module = sys.modules[ControlNode.__module__]
        monkeypatch.setattr(module, "Node", lambda name, graph: self.node)

    def interrupt_at(self, instant: float, *numbers: int) -> None:
        """Let signals come with the commands after some seconds."""
        left = list(numbers)

        def send(topic: str) -> None:
            if self.node.clock() >= 100.0 + instant and left:
                os.kill(os.getpid(), left.pop(0))

        self.node.on_publish = send

    def run(self) -> int:
        """Drive; the exit status."""
        try:
            cli.run_command(
                PROGRAM,
                "ros",
                ("control", "pid", str(self.path), "--speed", "0.25", "--out", str(self.out)),
            )
        except SystemExit as ended:
            return int(ended.code or 0)
        return 0

    def document(self) -> dict[str, Any]:
        """Return what track.json holds."""
        measured: dict[str, Any] = json.loads((self.out / "track.json").read_text(encoding="utf-8"))
        return measured


@pytest.fixture
def handlers() -> Iterator[None]:
    """Handlers of signals as a command line has them, which a node leaves as they were.

    Put back afterwards.
    """
    before = {number: signal.signal(number, signal.default_int_handler) for number in SIGNALS}
    yield
    assert {signal.getsignal(number) for number in SIGNALS} == {signal.default_int_handler}
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def drive(handlers: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Drive:
    return Drive(monkeypatch, tmp_path / "out")


def test_a_drive_that_arrives_or_has_to_be_stopped_is_kept(
    drive: Drive, capsys: pytest.CaptureFixture[str]
) -> None:
    assert drive.run() == 0
    assert (drive.document()["status"], drive.document()["stopped_because"]) == ("arrived", "")
    assert stands(drive.node)
    assert drive.node.closed
    drive.node = RobotNode(COMMAND)
    drive.node.silent_from = 3.0
    assert drive.run() == 1
    document = drive.document()
    assert document["status"] == "stopped"
    assert "no feedback" in document["stopped_because"]
    assert (
        capsys.readouterr().err.strip().splitlines()[-1]
        == f"run failed: {document['stopped_because']}"
    )
    assert stands(drive.node)


@pytest.mark.parametrize(
    ("number", "background"), [*((n, False) for n in SIGNALS), (signal.SIGINT, True)]
)
def test_signals_stop_the_robot_and_keep_the_drive(
    drive: Drive, capsys: pytest.CaptureFixture[str], number: int, background: bool
) -> None:
    """Others that come while it is being stopped change nothing.

    A shell has programs in the background ignore Ctrl-C.
    """
    before = (
        signal.signal(signal.SIGINT, signal.SIG_IGN) if background else signal.default_int_handler
    )
    drive.interrupt_at(4.0, number, signal.SIGINT, signal.SIGTERM)
    assert drive.run() == cli.EXIT_INTERRUPTED
    signal.signal(signal.SIGINT, before)
    document = drive.document()
    assert (document["status"], document["schema"]) == ("interrupted", "ssmr.track/1")
    assert math.isfinite(document["metrics"]["d_rms_m"])
    assert (drive.out / "track.png").is_file()
    assert stands(drive.node)
    text = capsys.readouterr()
    assert "ended before the reference did (interrupted)" in " ".join(text.out.split())
    assert text.err.strip().splitlines()[-1] == "interrupted"


def test_who_was_never_driven_leaves_nothing(
    drive: Drive, capsys: pytest.CaptureFixture[str]
) -> None:
    drive.node.silent_from = 0.05
    assert drive.run() == 1
    assert not (drive.out / "track.json").exists()
    assert "no robot to drive after 30 s" in capsys.readouterr().err


def fed(follower: PathFollower) -> None:
    """Messages of a robot that stands at its start, and commands."""
    for k in range(40):
        follower.update(10.0 + 0.02 * k, Observation(0.0, 0.0, 0.0, 0.0, 0.0), 0.02 * k)
        if follower.phase == "driving":
            follower.command(0.02 * k)


def test_a_fault_of_a_users_controller_ends_the_drive(lab: Profile, tmp_path: Path) -> None:
    good, _ = chosen_controller(f"{written(tmp_path, GOOD)}:Mine", lab)
    fed(PathFollower(good, line(0.5, 2.0)))
    late = FAULTY.format("return (0.1, 0.0) if now.t < 0.3 else 1 / 0")
    bad, _ = chosen_controller(f"{written(tmp_path, late)}:Mine", lab)
    with pytest.raises(ControllerError, match=r"mine\.py:6: ZeroDivisionError"):
        fed(PathFollower(bad, line(0.5, 2.0)))
    worse, _ = chosen_controller(f"{written(tmp_path, FAULTY.format('return 1 / 0'))}:Mine", lab)
    with pytest.raises(ControllerError, match="ZeroDivisionError"):
        PathFollower(worse, line(0.5, 2.0))
