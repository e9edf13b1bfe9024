"""The tracker that drives by messages: it is the closed loop of the process, and it stops when in doubt."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from ssmr.control.laws import Controller
from ssmr.control.loop import LoopSettings, run_loop
from ssmr.control.waypoints import Waypoints
from ssmr.types import State
from validation.bench.gains import load_gains
from validation.bench.loops import make_controller
from validation.plants.profile import Profile, make_plant
from validation.ros.messages import Seen
from validation.ros.pilot import FRESH, Phase, Pilot, PilotSettings, StoppedError

BEND = Waypoints(np.arange(13.0) * 0.5, 1.2 * np.column_stack([np.sin(np.arange(13) / 10), 1 - np.cos(np.arange(13) / 10)]))
"""A left bend of 1.2 m radius at 0.24 m/s, 6 s long."""
SHORT = Waypoints(BEND.t[:7], BEND.xy[:7])


def law(lab: Profile, name: str = "pid") -> Controller:
    return make_controller(lab, load_gains(name))


def standing(pilot: Pilot, at: Seen, n: int = 20, period: float = 0.02) -> float:
    """Messages of a robot that stands, until the pilot drives; the time then."""
    for k in range(n):
        stamp = at.stamp + k * period
        pilot.see(at._replace(stamp=stamp), stamp)
        if pilot.phase is Phase.DRIVING:
            return stamp
    return at.stamp + n * period


REST = Seen(10.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("name", ["pid", "lqr-scheduled", "lqr-scheduled+predictor"])
def test_driving_by_messages_is_the_closed_loop_of_the_process(lab: Profile, name: str) -> None:
    """Same instants, perfect messages, any start: the same motion, to what the first tick's period makes of it."""
    controller, settings = law(lab, name), LoopSettings("truth", disturbance=False, position_period=0.01)
    plant = make_plant(lab, "improved")
    expected = run_loop(plant, controller, SHORT, settings, 0).motion
    elsewhere = np.array([3.0, -2.0, 2.5])
    turn, place = elsewhere[2] - SHORT.start.yaw, elsewhere[:2]
    c, s = math.cos(turn), math.sin(turn)
    state = plant.reset(State(*map(float, elsewhere)))
    pilot = Pilot(controller, SHORT, PilotSettings())
    command, poses, steps = (0.0, 0.0), [], round(0.01 / plant.dt)

    def seen(t: float) -> Seen:
        yaw = math.remainder(state.yaw, 2.0 * math.pi)
        return Seen(t, state.x, state.y, yaw, state.v_x, state.yaw_rate)

    begin = standing(pilot, seen(5.0)._replace(stamp=5.0), period=0.01)
    k = 0
    while pilot.phase is Phase.DRIVING:
        if k:
            pilot.see(seen(begin + 0.01 * k), begin + 0.01 * k)
        if k % 5 == 0:
            command = pilot.command(begin + 0.01 * k)
        poses.append((state.x, state.y))
        for _ in range(steps):
            state = plant.step(command, plant.dt)
        k += 1
    back = (np.array(poses) - place) @ np.array([[c, -s], [s, c]]) + [SHORT.start.x, SHORT.start.y]
    np.testing.assert_allclose(back, expected.xy[: len(back)], atol=1e-3)
    assert len(back) == len(expected)
    run = pilot.run()
    np.testing.assert_allclose(run.columns("x", "y"), expected.xy, atol=1e-3)
    np.testing.assert_allclose(run.column("yaw"), expected.yaw, atol=2e-3)


def test_it_waits_for_a_robot_that_stands_and_speaks_steadily(lab: Profile) -> None:
    pilot = Pilot(law(lab), BEND, PilotSettings())
    assert pilot.command(0.0) == (0.0, 0.0)
    moving = REST._replace(v=0.3)
    standing(pilot, moving)
    assert pilot.phase is Phase.WAITING
    assert "moves" in pilot.why_waiting
    for k in range(10):  # a message a second
        pilot.see(REST._replace(stamp=20.0 + k), 20.0 + k)
    assert pilot.phase is Phase.WAITING
    assert "steadily" in pilot.why_waiting
    standing(pilot, REST._replace(stamp=30.0))
    assert pilot.phase is Phase.DRIVING


def test_it_starts_where_the_robot_stands_or_not_at_all(lab: Profile) -> None:
    away = REST._replace(x=2.0, y=1.0, yaw=-2.0)
    relative = Pilot(law(lab), BEND, PilotSettings())
    begin = standing(relative, away)
    relative.see(away._replace(stamp=begin + 0.02), begin + 0.02)
    start = BEND.start
    assert relative.run().columns("x", "y", "yaw")[0] == pytest.approx([start.x, start.y, start.yaw])
    absolute = Pilot(law(lab), BEND, PilotSettings(absolute=True))
    standing(absolute, away)
    assert absolute.phase is Phase.WAITING
    assert "2.24 m from the reference's start" in absolute.why_waiting


def test_absolute_places_are_taken_as_they_are_and_yaw_near_the_reference(lab: Profile) -> None:
    backwards = Waypoints.from_path(np.array([[0.0, 0.0], [-1.0, -1e-3], [-2.0, 0.0]]), 0.2)  # heading -pi + 1e-3
    pilot = Pilot(law(lab), backwards, PilotSettings(absolute=True))
    at = REST._replace(x=-0.1, y=0.05, yaw=math.pi - 0.01)
    begin = standing(pilot, at)
    pilot.see(at._replace(stamp=begin + 0.02), begin + 0.02)
    x, y, yaw = pilot.run().columns("x", "y", "yaw")[0]
    assert (x, y) == pytest.approx((-0.1, 0.05))
    assert yaw == pytest.approx(backwards.start.yaw, abs=0.02)


def test_it_stops_on_stale_feedback(lab: Profile) -> None:
    pilot = Pilot(law(lab), BEND, PilotSettings())
    now = standing(pilot, REST)
    pilot.command(now + FRESH)
    with pytest.raises(StoppedError, match=r"no feedback for 0\.5"):
        pilot.command(now + FRESH + 0.01)


def test_a_sender_that_repeats_itself_is_no_feedback(lab: Profile) -> None:
    pilot = Pilot(law(lab), BEND, PilotSettings())
    now = standing(pilot, REST)
    for k in range(40):
        pilot.see(REST._replace(stamp=now), now + 0.02 * k)
    with pytest.raises(StoppedError, match=r"no new feedback for 0\.80 s: 40 messages repeat the stamp"):
        pilot.command(now + 0.8)


def test_stale_feedback_says_what_came_instead(lab: Profile) -> None:
    pilot = Pilot(law(lab), BEND, PilotSettings())
    now = standing(pilot, REST)
    with pytest.raises(StoppedError, match=r"no feedback that can be used for 0\.60 s: 27 messages were refused"):
        pilot.command(now + 0.6, "27 messages were refused")


@pytest.mark.parametrize("jump", [-0.1, FRESH + 0.01])
def test_it_stops_when_the_senders_clock_jumps(lab: Profile, jump: float) -> None:
    pilot = Pilot(law(lab), BEND, PilotSettings())
    now = standing(pilot, REST)
    pilot.see(REST._replace(stamp=now), now)  # the same message again is nothing
    with pytest.raises(StoppedError, match="jumped"):
        pilot.see(REST._replace(stamp=now + jump), now + 0.02)


def test_it_stops_when_the_robot_is_somewhere_else(lab: Profile) -> None:
    pilot = Pilot(law(lab), BEND, PilotSettings())
    now = standing(pilot, REST)
    with pytest.raises(StoppedError, match="from its target"):
        pilot.see(REST._replace(stamp=now + 0.02, x=5.0), now + 0.02)


def test_commands_keep_their_limits(lab: Profile) -> None:
    pilot = Pilot(law(lab), BEND, PilotSettings(v_limit=0.26, w_limit=0.1))
    now = standing(pilot, REST)
    asked = []
    for k in range(1, 100):  # a robot that does not move, while its target does
        t = now + 0.05 * k
        pilot.see(REST._replace(stamp=t), t)
        asked.append(pilot.command(t))
    assert max(v for v, _ in asked) == 0.26
    assert max(abs(w) for _, w in asked) == 0.1


def test_limits_and_references_that_cannot_be_are_refused(lab: Profile) -> None:
    with pytest.raises(ValueError, match=r"0\.24 m/s"):
        Pilot(law(lab), BEND, PilotSettings(v_limit=0.2))
    for bad in ({"period": 0.0}, {"v_limit": -1.0}, {"w_limit": math.nan}, {"lookahead": -0.1}):
        with pytest.raises(ValueError, match=next(iter(bad))):
            replace(PilotSettings(), **bad)


def test_a_tracking_system_judges_and_its_half_turns_are_no_jumps(lab: Profile) -> None:
    """The tracking system's frame is its own: what counts is the way from where it was at the start (Sec. 4.2)."""
    pilot = Pilot(law(lab), BEND, PilotSettings())
    pilot.track(Seen(9.99, 7.0, 8.0, math.pi - 0.05, math.nan, math.nan))
    now = standing(pilot, REST)
    for k in range(11):
        t, way = now + 0.02 * k, 0.01 * k
        yaw = math.pi - 0.05 + way
        pilot.see(REST._replace(stamp=t, x=0.5 * way), t)
        pilot.track(
            Seen(
                t,
                7.0 + way * math.cos(math.pi - 0.05),
                8.0 + way * math.sin(math.pi - 0.05),
                math.remainder(yaw, 2 * math.pi),
                0,
                0,
            )
        )
    assert pilot.tracked
    start, run = BEND.start, pilot.run()
    x, y, yaw = run.columns("x", "y", "yaw")[-1]
    assert math.hypot(x - start.x, y - start.y) == pytest.approx(0.1, abs=1e-9)
    assert yaw == pytest.approx(start.yaw + 0.1, abs=1e-9)
    assert run.column("seen_x")[-1] - run.column("seen_x")[0] == pytest.approx(0.05 * math.cos(start.yaw), abs=1e-9)


def test_a_robot_that_was_never_driven_has_no_run(lab: Profile) -> None:
    with pytest.raises(StoppedError, match="not driven"):
        Pilot(law(lab), BEND, PilotSettings()).run()


@pytest.mark.parametrize("shift", [-1.0, 1e6, -1e6])
def test_a_tracking_system_whose_clock_is_reset_does_not_judge(lab: Profile, shift: float) -> None:
    pilot = Pilot(law(lab), BEND, PilotSettings())
    pilot.track(REST._replace(stamp=9.99))
    now = standing(pilot, REST)
    taken = []
    for k in range(1, 60):
        t = now + 0.02 * k
        pilot.see(REST._replace(stamp=t), t)
        taken.append(pilot.track(REST._replace(stamp=t + (shift if k >= 20 else 0.0))))
    assert all(taken[:19])
    assert not any(taken[19:])
    assert not pilot.tracked
    assert np.all(np.isfinite(pilot.run().columns("x", "y", "yaw")))
