"""A follower in simulated time, on a MuJoCo robot with faults: what it notices, and what it does.

`tests/ros_drive.py` holds the drive.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from ssmr.control.references import circle, line
from ssmr.control.waypoints import Waypoints
from tests.ros_drive import Driven, Faults, drive_with_faults
from validation.experiment.loops import chosen_controller, make_robot
from validation.plants.profile import load_profile
from validation.ros.watch import GENTLE, Gap, SenderClock

PROFILES = ("thesis-lab", pytest.param("husky-tile", marks=pytest.mark.slow))
"""One robot shows what the follower does; the other one shows it again."""


@cache
def robot_of(profile: str) -> Any:
    return make_robot(load_profile(profile), "mujoco")


def drive(
    profile: str, name: str = "mpc", faults: Faults | None = None, turns: float = 0.6
) -> Driven:
    robot = robot_of(profile)
    law, _ = chosen_controller(name, load_profile(profile))
    law = law.on(robot.drive)
    return drive_with_faults(robot.body, law, circle(0.4, turns=turns), faults)


@pytest.mark.parametrize("profile", PROFILES)
def test_odometry_that_becomes_late_moves_the_robot_a_few_millimetres(profile: str) -> None:
    # the dead time is learnt in a dozen seconds on tile
    late = Faults(late=lambda t: 0.205 if t >= 0.0 else 0.005)
    done = drive(profile, faults=late, turns=1.0)
    assert not done.stopped
    assert done.off().max() <= 0.015
    sent = done.table()[:, 5:]
    limits = np.array([done.follower.v_limit, done.follower.w_limit])
    assert np.mean(np.any(np.abs(sent) >= 0.999 * limits, axis=1)) < 0.01
    assert done.follower.late == pytest.approx(0.2, abs=0.05)
    assert done.rest_off <= 0.03


def test_a_slow_clock_of_the_sender_is_not_called_late() -> None:
    done = drive("thesis-lab", faults=Faults(rate=1.3))
    assert not done.stopped
    assert abs(done.follower.late) < 0.03
    assert done.off().max() <= 0.01


@pytest.mark.parametrize("profile", PROFILES)
def test_after_an_emergency_stop_the_robot_itself_moves_gently(profile: str) -> None:
    done = drive(profile, faults=Faults(stopped=lambda t: 0.0 <= t < 6.0))
    assert not done.stopped
    assert done.follower.held_time == pytest.approx(6.0, abs=0.6)
    assert np.abs(done.table(6.0)[:, 3]).max() <= GENTLE * 0.4
    assert done.off(6.0).max() <= 0.03
    assert done.rest_off <= 0.03


def test_silence_of_less_than_half_a_second_is_driven_through() -> None:
    done = drive("husky-tile", faults=Faults(silent=lambda t: t >= 0.0 and t % 1.0 < 0.45))
    assert not done.stopped
    assert done.off().max() <= 0.02


@pytest.mark.parametrize("name", ["lqr", "lqr-scheduled+predictor"])
def test_other_laws_see_no_fault_where_none_is(name: str) -> None:
    assert not drive("husky-tile", name).stopped


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("name", ["pid", "lqr", "lqr-scheduled", "lqr+predictor", "mpc"])
def test_a_robot_rests_before_or_behind_its_end_by_a_few_millimetres(
    name: str, profile: str
) -> None:
    """Beside it, it rests as it drove when its target came to rest.

    A robot that stands moves to no side, and laws turn it to its path within about a metre of way.
    """
    done = drive(profile, name)
    way = done.follower.waypoints
    heading = float(way.headings[-1])
    table = done.table()
    places = table[:, 1:3] - way.xy[-1]
    along = places @ [np.cos(heading), np.sin(heading)]
    aside = places @ [-np.sin(heading), np.cos(heading)]
    assert abs(along[-1]) <= 0.01
    ended = int(np.argmax(table[:, 0] > way.duration))
    assert abs(aside[-1] - aside[ended]) <= 0.01


def ages_seen(ages: list[float], period: float = 0.02) -> list[float]:
    """Return the latenesses of messages of some ages."""
    clock = SenderClock()
    seen = []
    for k, age in enumerate(ages):
        clock.take(period * k, age)
        seen.append(clock.lateness)
    return seen


def test_a_step_of_the_age_is_lateness_and_its_end_is_too() -> None:
    ages = [9.0, *[9.0 + 0.004 * k for k in range(20)], 9.4, 9.4, 9.2, 9.08]
    seen = ages_seen(ages)
    assert max(seen[:21]) == 0.0
    assert seen[21:] == pytest.approx([0.324, 0.324, 0.124, 0.004], abs=0.001)


@pytest.mark.parametrize("period", [0.02, 0.1, 0.2])
def test_of_messages_that_come_late_by_chance_each_has_its_own_lateness(period: float) -> None:
    late = np.random.default_rng(5).uniform(0.0, 0.3, round(60.0 / period))
    seen = np.array(ages_seen(list(9.0 + late), period))
    quickest = np.minimum.accumulate(late)
    known = np.abs(seen - (late - quickest))[round(10.0 / period) :]
    assert known.max() < 0.05


@pytest.mark.parametrize("period", [0.02, 0.1, 0.2])
def test_a_gap_depends_on_the_way_and_not_on_the_rate_of_messages(period: float) -> None:
    gap = Gap(0.1, 0.02, 0.1)
    passed = 0.0
    while gap.share() <= 1.0:
        gap.add(np.array([0.2 * period, 0.0]), 0.4 * period, period)
        passed += period
    assert passed == pytest.approx(0.1 / (0.2 - 0.02 - 0.04), abs=period)
    gap.size = np.zeros(1)
    for _ in range(1000):
        gap.add(np.array([0.05 * period, 0.0]), 0.4 * period, period)
    assert gap.share() == 0.0


LANDING = line(0.8, 6.0)
"""Its waypoints are 20 mm apart, so it begins to brake with 0.5 m/s2 at one of them."""


@pytest.mark.parametrize(
    "way", [line(0.5), circle(0.4), LANDING], ids=["line", "circle", "at a waypoint"]
)
def test_a_way_that_brakes_is_the_same_way(way: Waypoints) -> None:
    braked = way.braked(0.5)
    assert braked.length == pytest.approx(way.length, rel=1e-3)
    speed = way.segment_speeds[-1]
    assert braked.duration - way.duration == pytest.approx(0.5 * speed / 0.5, abs=0.01)
    assert np.all(np.diff(braked.segment_speeds[-3:]) < 0.0)
    assert braked.segment_speeds[-1] < 0.5 * speed
    assert len(way.braked(1e9)) >= len(way)
