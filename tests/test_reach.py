"""Demands of a reference beside the robot's limits, and gains from another profile."""

from __future__ import annotations

import re

import pytest

from ssmr.control.references import eight
from validation import load_profile
from validation.experiment.loops import demand_of, limits_of, make_robot, slowed_to_feasible
from validation.plants.profile import Profile
from validation.track import track


def test_a_robot_without_slip_moves_as_it_is_told(lab: Profile) -> None:
    section = lab.plants["kinematic"]
    speed, turns, acceleration, _ = limits_of([make_robot(lab, "kinematic")], 0.4)
    drive = section.drive
    p = section.parameters
    rolled = section.vehicle.wheel_radius / drive.command_radius
    share = 0.5 * (p.alpha_l + p.alpha_r)  # type: ignore[attr-defined]
    assert speed == pytest.approx(drive.v_max * rolled * share, rel=0.02)
    assert turns == pytest.approx(drive.w_max * rolled, rel=0.1)
    assert acceleration > 5.0  # at once


def test_an_acceleration_limit_is_found_again(lab: Profile) -> None:
    limit = lab.plants["mujoco"].drive.acceleration_v
    robots = [make_robot(lab, "mujoco")]
    assert limits_of(robots, 0.4).acceleration == pytest.approx(limit, rel=0.05)
    assert limits_of(robots, 0.4, 0.9).acceleration == pytest.approx(0.9 * limit, rel=0.05)


@pytest.mark.parametrize("plant", ["improved", "four_wheel", "mujoco"])
def test_the_tile_husky_turns_at_less_than_an_eight_asks_for(plant: str) -> None:
    """Told 2 rad/s it turns at 0.9 rad/s: its driver reckons with half of its track."""
    robot = make_robot(load_profile("husky-tile"), plant)
    message = demand_of(eight(0.5), robot, "husky-tile", "eight")
    asks = f"eight at 0.5 m/s asks {plant} of husky-tile for more than 0.\\d\\d m/s, "
    match = re.fullmatch(
        asks + r"(0.\d\d) rad/s or (\d.\d\d) rad/s\^2, which it can do; "
        r"slowed where it must be, it takes (\d\d.\d) s instead of 13.1 s.",
        message or "",
    )
    assert match is not None, message
    turns, _, seconds = map(float, match.groups())
    assert 0.85 < turns < 1.0
    # half of the way asks for more than it has, and for up to a third more
    assert 13.5 < seconds < 17.0
    slowed = slowed_to_feasible(eight(0.5), robot)
    assert demand_of(slowed, robot, "husky-tile", "eight") is None


def test_it_is_said_at_the_start_and_kept_in_the_result() -> None:
    tracked = track("lqr", "eight@0.5", "improved", "husky-tile", "tuned")
    origin, demand, fast, late = tracked.remarks
    assert origin.startswith(
        "The gains lqr-tuned were found on the profile thesis-lab, not on husky-tile"
    )
    assert demand.startswith("eight at 0.5 m/s asks improved of husky-tile")
    assert "husky-tile was fitted at 0.35 m/s" in fast
    assert "0.1 s" in late
    assert {origin, demand, fast, late} <= set(tracked.as_dict()["notes"])
