"""Demands of a reference beside the robot's limits, and gains from another profile."""

from __future__ import annotations

import re

import pytest

from ssmr.control.references import eight
from validation import load_profile
from validation.experiment.loops import demand_of, make_robot, settled_motion
from validation.plants.profile import Profile, make_plant
from validation.track import track


def test_a_settled_motion_of_a_robot_without_slip_is_the_command(lab: Profile) -> None:
    section = lab.plants["kinematic"]
    v, w = settled_motion(make_plant(lab, "kinematic"), 0.4, 0.0)
    assert w == pytest.approx(0.0, abs=0.05)
    rolled = section.vehicle.wheel_radius / section.drive.command_radius
    p = section.parameters
    share = 0.5 * (p.alpha_l + p.alpha_r)  # type: ignore[attr-defined]
    assert v == pytest.approx(0.4 * rolled * share, rel=0.02)


@pytest.mark.parametrize("plant", ["improved", "four_wheel", "mujoco"])
def test_the_tile_husky_turns_at_less_than_an_eight_asks_for(plant: str) -> None:
    """Told 2 rad/s it turns at 0.9 rad/s: its driver reckons with half of its track."""
    robot = make_robot(load_profile("husky-tile"), plant)
    message = demand_of(eight(0.5), robot, "husky-tile", "eight")
    asks = f"eight at 0.5 m/s asks {plant} of husky-tile for a yaw rate of 1.20 rad/s"
    match = re.fullmatch(
        asks + r" where (0.\d\d) rad/s are possible; at (0.\d\d) m/s it could be followed.",
        message or "",
    )
    assert match is not None, message
    possible, speed = map(float, match.groups())
    assert 0.85 < possible < 1.0
    assert speed == pytest.approx(0.5 * possible / 1.2, abs=0.011)
    assert demand_of(eight(speed - 0.02), robot, "husky-tile", "eight") is None


def test_it_is_said_at_the_start_and_kept_in_the_result() -> None:
    tracked = track("lqr", "eight@0.5", "improved", "husky-tile", "tuned")
    origin, demand, fast = tracked.remarks
    assert origin.startswith(
        "The gains lqr-tuned were found on the profile thesis-lab, not on husky-tile"
    )
    assert demand.startswith("eight at 0.5 m/s asks improved of husky-tile")
    assert "husky-tile was fitted at 0.35 m/s" in fast
    assert {origin, demand, fast} <= set(tracked.as_dict()["notes"])
