"""Robots that differ from their profile: drawn as declared, made as said, and what the worst of them cost."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.control.loop import LoopSettings
from ssmr.parameters import described
from tests.conftest import ROUNDOFF
from validation.bench.gains import load_gains
from validation.bench.loops import make_controller, make_robot, run_robots
from validation.bench.mismatch import (
    SCORING,
    TUNING,
    Mismatch,
    draw_mismatches,
    mismatched,
    spread,
    worst_mean,
)
from validation.bench.waypoint_files import open_reference
from validation.identify.tuning import TuneCost, costs_of
from validation.plants.profile import Profile, load_profile
from validation.simulator.plant import MujocoPlant
from validation.tune import tune

SETTINGS = LoopSettings("truth", disturbance=False)
FEW: dict[str, Any] = {
    "plants": ("linear",),
    "free": ("q_x", "r_v"),
    "population": 6,
    "generations": 2,
    "held_out": ("line@0.5",),
}


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=40))
def test_the_worst_lie_between_mean_and_worst(values: list[float]) -> None:
    slack = 1e-9  # of sums of up to 40 numbers as great as 1e3
    assert np.mean(values) - slack <= worst_mean(values) <= max(values) + slack


def test_the_worst_count_in_part_where_a_fifth_is_no_whole_number() -> None:
    assert worst_mean(np.arange(1.0, 8.0)) == pytest.approx((7.0 + 0.4 * 6.0) / 1.4, rel=ROUNDOFF)
    assert worst_mean([1.0, 2.0, 3.0, 4.0, 5.0]) == 5.0
    assert worst_mean([7.3]) == 7.3, "one robot costs what it costs, to the bit"
    assert worst_mean([[1.0, 2.0], [3.0, math.inf]]).tolist() == [3.0, math.inf]
    found = spread([1.0, 2.0, 3.0, 6.0, 3.0])
    assert found == pytest.approx({"mean": 3.0, "std": math.sqrt(14.0 / 4.0), "cvar": 6.0, "worst": 6.0}, rel=ROUNDOFF)
    assert spread([2.0])["std"] == 0.0
    assert spread([2.0, math.inf])["mean"] == math.inf


@given(st.integers(1, 40), st.integers(0, 2**40))
def test_draws_lie_in_their_ranges_once_in_every_strip(count: int, seed: int) -> None:
    robot = load_profile("thesis-lab").robot
    drawn = draw_mismatches(count, seed, TUNING, robot)
    assert drawn == draw_mismatches(count, seed, TUNING, robot)
    for name, d in described(Mismatch).items():
        low, high = d.bounds(robot.sizes) or (0.0, 0.0)
        values = np.sort([getattr(m, name) for m in drawn])
        share = np.log(values / low) / np.log(high / low) if d.scale == "log" else (values - low) / (high - low)
        assert np.all(np.abs(share * count - np.arange(count) - 0.5) <= 0.5 + 1e-9), name


def ends_alone(lab: Profile) -> list[Mismatch]:
    """Both ends of every range, each alone."""
    ranges = {name: d.bounds(lab.robot.sizes) or () for name, d in described(Mismatch).items()}
    return [Mismatch(**{name: end}) for name, ends in ranges.items() for end in ends]


def test_every_mismatch_has_a_label_of_its_own(lab: Profile) -> None:
    single = ends_alone(lab)
    assert len({m.label for m in (*single, Mismatch())}) == 2 * len(described(Mismatch)) + 1


def test_a_mismatch_becomes_the_simulated_robot(lab: Profile) -> None:
    section = lab.plants["mujoco"]
    robot = mismatched(lab, "mujoco", Mismatch(1.2, 1.3, -0.05, 0.02, 0.1, 0.05, 0.04))
    assert isinstance(robot.body, MujocoPlant)
    c, p = robot.body.calibration, section.parameters
    assert c.mass == 1.2 * p.mass
    wheels, kg = p.robot.yaw_inertia - p.robot.masses.inertia[2], p.robot.masses.total - p.robot.base_mass
    assert (c.yaw_inertia - wheels) / (p.yaw_inertia - wheels) == pytest.approx((c.mass - kg) / (p.mass - kg), rel=ROUNDOFF)
    assert (c.friction, c.com_x, c.com_y) == (1.3 * p.friction, p.com_x - 0.05, p.com_y + 0.02)
    assert c.wheel_radius == 0.96 * p.wheel_radius
    assert c.radius_difference == pytest.approx(0.05 * c.wheel_radius, rel=ROUNDOFF)
    assert robot.drive == replace(section.drive, delay_v=section.drive.delay_v + 0.1, delay_w=section.drive.delay_w + 0.1)
    assert robot.known == section.drive, "no controller knows of it"


def test_sides_stay_within_what_a_simulated_robot_can_have() -> None:
    tile = load_profile("husky-tile")
    body = mismatched(tile, "mujoco", Mismatch(sides=0.06)).body
    assert isinstance(body, MujocoPlant)
    assert mismatched(tile, "improved", Mismatch(delay=-5.0)).drive.delay_v == 0.0
    assert 0.058 < body.calibration.radius_difference / body.calibration.wheel_radius < 0.1


@pytest.mark.parametrize("plant", ["kinematic", "coulomb", "improved", "linear", "four_wheel"])
def test_every_plant_drives_with_every_mismatch(lab: Profile, plant: str) -> None:
    """No mismatch is the profile's own robot, to the bit; the others each change the motion, but for what a plant lacks."""
    law, (_, ways) = make_controller(lab, load_gains("lqr", "tuned")), open_reference("u-turn", 0.5)
    single = ends_alone(lab)
    robots = [make_robot(lab, plant), *(mismatched(lab, plant, m) for m in (Mismatch(), *single))]
    around: Any = [SETTINGS] * len(robots)
    own, same, *others = (r.columns("x", "y", "yaw") for r in run_robots(robots, [law] * len(robots), around, ways, [0]))
    assert np.array_equal(own, same)
    idle = [m.label for m, run in zip(single, others, strict=True) if np.array_equal(run, own)]
    lacks = {"kinematic": ("mass", "friction", "cm right", "cm left"), "four_wheel": (), "coulomb": ("cm right", "cm left")}
    wanted = lacks.get(plant, ("cm right", "cm left", "cm back", "cm ahead"))
    assert idle == [m.label for m in single if any(word in m.label for word in wanted)]


def test_a_robust_tuning_is_scored_on_robots_that_it_has_not_seen(lab: Profile) -> None:
    found = tune("lqr", "circle@0.5", lab, robots="robust", draws=6, seed=2, workers=2, **FEW)
    assert found.problem.mismatches == draw_mismatches(6, 2, TUNING, lab.robot)
    assert found.scored_on == draw_mismatches(6, 2, SCORING, lab.robot)
    assert {name: len(costs) for name, costs in found.scores.items()} == {"tuned": 6, "baseline": 6, "shipped": 6}
    assert found.cost <= found.baseline_cost
    assert found.gain_set.provenance["robots"][0] == found.problem.mismatches[0].label
    again = tune("lqr", "circle@0.5", lab, robots="robust", draws=6, seed=2, workers=1, **FEW)
    assert (again.gains, again.cost, again.scores) == (found.gains, found.cost, found.scores)


def test_the_cost_of_a_robust_tuning_is_that_of_the_worst(lab: Profile) -> None:
    """Five robots: the worst fifth is the worst one, and the same gains cost that much on each alone."""
    found = tune("lqr", "circle@0.5", lab, robots="robust", draws=5, seed=4, noise=False, **FEW)
    law = make_controller(lab, found.gain_set)
    _, ways = open_reference("circle", 0.5)
    robots = [mismatched(lab, "linear", m) for m in found.problem.mismatches]
    runs = run_robots(robots, [law] * 5, [SETTINGS] * 5, ways, [4])
    target = ways.trajectory(SETTINGS.position_period)
    costs = costs_of(runs, target, ways.rms_speed, TuneCost(k_u=50.0))
    assert found.cost == pytest.approx(float(costs.max()), rel=1e-6)


@pytest.mark.parametrize(("option", "said"), [({"robots": "drawn"}, "unknown robots"), ({"draws": 0}, "draws")])
def test_mistakes_are_said(lab: Profile, option: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        tune("lqr", "circle@0.5", lab, **option)
