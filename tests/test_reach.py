"""What a reference asks of a robot beside what the robot can do, and gains that were found on another profile."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from ssmr.control.references import circle, eight, line
from tests.conftest import ROUNDOFF
from validation import load_profile
from validation.bench.gains import GainSet, dump_gains, load_gains, origin_sentence
from validation.bench.loops import demand_of, make_robot, settled_motion
from validation.plants.profile import Profile, make_plant
from validation.track import TrackOptions, prepare_tracking, track


def test_a_settled_motion_of_a_robot_without_slip_is_the_command(lab: Profile) -> None:
    plant, drive = make_plant(lab, "kinematic"), lab.plants["kinematic"].drive
    p = lab.plants["kinematic"].parameters
    v, w = settled_motion(plant, 0.4, 0.0)
    assert w == pytest.approx(0.0, abs=0.05)
    rolled = lab.plants["kinematic"].vehicle.wheel_radius / drive.command_radius
    assert v == pytest.approx(0.4 * rolled * 0.5 * (p.alpha_l + p.alpha_r), rel=0.02)  # type: ignore[attr-defined]


@pytest.mark.parametrize("plant", ["improved", "four_wheel", "mujoco"])
def test_the_tile_husky_turns_at_less_than_an_eight_asks_for(plant: str) -> None:
    """Told 2 rad/s it turns at 0.9 rad/s: half as wide as its track is what its driver reckons with."""
    profile = load_profile("husky-tile")
    robot = make_robot(profile, plant)
    said = demand_of(eight(0.5), robot, "husky-tile", "eight")
    assert said is not None
    found = re.fullmatch(
        rf"eight at 0.5 m/s asks {plant} of husky-tile for a yaw rate of 1.20 rad/s where (0.\d\d) rad/s are possible; "
        r"at (0.\d\d) m/s it could be followed.",
        said,
    )
    assert found is not None, said
    possible, speed = map(float, found.groups())
    assert 0.85 < possible < 1.0
    assert speed == pytest.approx(0.5 * possible / 1.2, abs=0.011)
    assert demand_of(eight(speed - 0.02), robot, "husky-tile", "eight") is None


def test_a_speed_that_wheels_do_not_reach_is_said_too() -> None:
    profile = load_profile("husky-tile")
    said = demand_of(line(0.97), make_robot(profile, "improved"), "husky-tile", "line")
    assert said is not None
    assert re.search(r"for 0.97 m/s where 0.9\d m/s are possible; at 0.9\d m/s it could be followed", said)


def test_what_a_robot_can_do_is_not_worth_a_sentence(lab: Profile) -> None:
    for reference in (circle(0.5), eight(0.5), line(0.5)):
        assert demand_of(reference, make_robot(lab, "improved"), "thesis-lab", "it") is None


def test_it_is_said_at_the_start_and_kept_in_the_result() -> None:
    asked = prepare_tracking(TrackOptions("lqr", "eight@0.5", "improved", "husky-tile", "tuned"))
    origin, demand = asked.remarks
    assert origin.startswith("The gains lqr-tuned were found on the profile thesis-lab, not on husky-tile")
    assert demand.startswith("eight at 0.5 m/s asks improved of husky-tile")
    found = track("lqr", "circle@0.5", "improved", "husky-tile", "tuned")
    assert found.alarms == (origin,)
    assert origin in found.as_dict()["notes"]
    assert origin in " ".join(found.table().split())


def test_gains_that_do_not_say_where_they_are_from_are_taken_as_they_are(lab: Profile, tmp_path: Path) -> None:
    own = GainSet("lqr", "own", load_gains("lqr", "tuned").values)
    path = tmp_path / "own.toml"
    path.write_text(dump_gains(own))
    assert prepare_tracking(TrackOptions("lqr", "line", "linear", lab, str(path))).remarks == ()
    for name in ("published", "tuned", "manual"):
        assert origin_sentence(load_gains("lqr", name), "thesis-lab") is None


def test_the_speed_that_is_possible_is_that_of_the_greatest_demand() -> None:
    """Yaw rate grows with speed: a reference twice as fast asks for twice as much."""
    slow, fast = eight(0.25), eight(0.5)
    assert abs(fast.course()["w"]).max() == pytest.approx(2.0 * abs(slow.course()["w"]).max(), rel=1e3 * ROUNDOFF)
