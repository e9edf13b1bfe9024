"""One suite over every plant: whatever moves when it is commanded must keep these laws."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import astuple, replace
from typing import Any

import numpy as np
import pytest

from ssmr.control.loop import POSITION_PERIOD
from ssmr.geometry import compose_poses
from ssmr.robot.drive import wheel_rates, wheel_references, whole_steps
from ssmr.scenarios import COMMAND_PERIOD
from ssmr.types import CommandKind, Commands, Plant, State, Trajectory
from tests.conftest import DRAKE_SYMMETRY, EXACT, SYMMETRY
from validation.experiment.sources import RECORDING_GRID
from validation.plants.profile import Profile, load_profile, make_plant
from validation.plants.table import plant_kind

Make = Callable[[], Any]  # BodyPlant

WEAVE = Commands(0.05, np.column_stack([np.full(40, 0.5), np.sin(np.arange(40) * 0.3)]))
"""Two seconds of starting and weaving."""


def mirrored(commands: Commands) -> Commands:
    """The same drive seen in a mirror: left is right."""
    return replace(commands, values=commands.values * [1.0, -1.0])


def symmetry(plant: Plant) -> float:
    """Tolerance to which a plant is symmetric and knows no directions of the world."""
    return DRAKE_SYMMETRY if plant.name == "drake" else SYMMETRY


def test_its_name_is_that_of_its_declaration_and_its_step_divides_every_period(
    make: Make, lab: Profile
) -> None:
    plant = make()
    assert isinstance(lab.section(plant.name).parameters, plant_kind(plant.name).parameters)
    for period in (COMMAND_PERIOD, POSITION_PERIOD, RECORDING_GRID):
        assert whole_steps(period, plant.dt, "the period") >= 1


def test_equal_runs_are_equal_bit_for_bit_even_after_another_run(make: Make) -> None:
    plant = make()
    first = plant.run(WEAVE, State(), 0.01)
    plant.run(mirrored(WEAVE), State(x=3.0, yaw=1.0, v_x=0.3), 0.01)
    again = plant.run(WEAVE, State(), 0.01)
    other = make().run(WEAVE, State(), 0.01)
    for name in ("pose", "twist", "wheels"):
        assert np.abs(getattr(first, name) - getattr(again, name)).max() == EXACT
        assert np.abs(getattr(first, name) - getattr(other, name)).max() == EXACT


def test_a_run_equals_its_single_steps(make: Make) -> None:
    plant = make()
    push = np.random.default_rng(7).normal(0.0, 2.0, round(WEAVE.duration / plant.dt))
    fast = plant.run(WEAVE, State(0.1, -0.2, 0.3, 0.2), 0.01, push)
    states = [plant.reset(State(0.1, -0.2, 0.3, 0.2))]
    period = whole_steps(WEAVE.dt, plant.dt, "the command period")
    for k, acceleration in enumerate(push.tolist()):
        v, w = WEAVE.values[k // period].tolist()
        states.append(plant.step((v, w), plant.dt, acceleration))
    slow = np.array(
        [astuple(state) for state in states[:: whole_steps(0.01, plant.dt, "the sample period")]]
    )
    # yaw is unwrapped once a sample in one, once a step in the other
    assert np.abs(fast.pose - slow[:, :3]).max() <= 1e-12
    assert np.abs(fast.twist - slow[:, 3:6]).max() <= 1e-12


def test_bodies_move_as_the_plant_does(make: Make) -> None:
    """One of two, in steps of any length, whatever the other does."""
    plant = make()
    start = State(0.1, -0.2, 0.3, 0.2)
    references = wheel_references(WEAVE, plant.drive, plant.dt, start)
    push = np.random.default_rng(7).normal(0.0, 2.0, len(references))
    alone = plant.run(WEAVE, start, WEAVE.dt, push)
    bodies = plant.make_bodies([plant, make()], start, 1)
    period = whole_steps(WEAVE.dt, plant.dt, "the command period")
    cuts = [0, *period * np.array([1, 2, 5, 21, WEAVE.n])]
    for first, end in itertools.pairwise(cuts):
        both = np.stack([references[first:end], 0.5 * references[first:end]])
        bodies.advance(both, np.stack([push[first:end], 0.0 * push[first:end]]))
        assert not bodies.gave_up.any()
        now = bodies.states()
        assert now.shape == (2, 10)
        k = end // period
        assert np.abs(now[0, :3] - alone.pose[k]).max() <= 1e-12
        assert np.abs(now[0, 3:6] - alone.twist[k]).max() <= 1e-12
    assert np.hypot(*(now[0, :2] - now[1, :2])) > 0.1


def test_left_and_right_are_alike(make_exact: Make) -> None:
    plant = make_exact()
    one = plant.run(WEAVE, State(), 0.01)
    other = plant.run(mirrored(WEAVE), State(), 0.01)
    flip = np.array([1.0, -1.0, -1.0])
    assert np.abs(one.pose - other.pose * flip).max() <= symmetry(plant)
    assert np.abs(one.twist - other.twist * flip).max() <= symmetry(plant)
    assert np.abs(one.wheels - other.wheels[:, ::-1]).max() <= symmetry(plant)


@pytest.mark.parametrize("frame", [(2.0, -1.0, 0.7), (-30.0, 5.0, 3.0), (0.0, 0.0, -10.0)])
def test_the_world_frame_does_not_matter(
    make_exact: Make, frame: tuple[float, float, float]
) -> None:
    plant = make_exact()
    here = plant.run(WEAVE, State(), 0.01)
    there = plant.run(WEAVE, State(*frame), 0.01)
    assert np.abs(compose_poses(np.array(frame), here.pose) - there.pose).max() <= symmetry(plant)
    assert np.abs(here.twist - there.twist).max() <= symmetry(plant)


def test_reset_starts_where_it_was_asked_to(make: Make) -> None:
    plant = make()
    wanted = State(1.0, 2.0, 7.0, 0.4, 0.0, 0.2, *wheel_rates(0.4, 0.2, 0.275, 0.1651))
    began = plant.reset(wanted)
    assert np.allclose(astuple(began)[:3], astuple(wanted)[:3], atol=1e-9)
    assert began.v_x == pytest.approx(0.4)
    assert began.yaw_rate == pytest.approx(0.2)


def test_numbers_stay_finite_under_commands_far_beyond_saturation(make: Make) -> None:
    wild = Commands(0.05, np.random.default_rng(8).uniform(-100.0, 100.0, (60, 2)))
    motion = make().run(wild, State(), 0.01)
    assert np.abs(motion.pose).max() < 100.0


def test_a_robot_that_is_told_to_stand_stands(make: Make) -> None:
    motion = make().run(Commands(0.05, np.zeros((100, 2))), State(), 0.01)
    assert np.abs(motion.pose).max() <= 1e-9


def test_what_it_returns_is_not_its_memory(make: Make) -> None:
    plant = make()
    before = plant.reset(State())
    kept = replace(before)
    plant.step((0.5, 0.3), 0.5)
    assert before == kept
    motion = plant.run(WEAVE, State(), 0.01)
    copy = motion.pose.copy()
    plant.run(mirrored(WEAVE), State(), 0.01)
    assert np.array_equal(motion.pose, copy)
    with pytest.raises(ValueError, match="read-only"):
        motion.pose[0, 0] = 1.0


def test_periods_that_physics_does_not_divide_are_refused(make: Make) -> None:
    plant = make()
    with pytest.raises(ValueError, match="whole number of physics steps"):
        plant.run(WEAVE, State(), 0.01 + 0.3 * plant.dt)
    with pytest.raises(ValueError, match="whole number of physics steps"):
        plant.step((0.0, 0.0), 0.4 * plant.dt)
    with pytest.raises(ValueError, match="whole number of physics steps"):
        plant.run(Commands(0.0517 + 0.1 * plant.dt, WEAVE.values), State(), 0.01)


def test_whole_turns_are_counted_however_seldom_one_looks(make: Make) -> None:
    """At some 1.5 rad/s three seconds are more than half a turn."""
    plant = make()
    spin = Commands(0.05, np.tile([0.0, 1.6], (240, 1)))
    seldom = plant.run(spin, State(yaw=9.0), 3.0)
    often = plant.run(spin, State(yaw=9.0), 0.05)
    assert often.yaw[-1] - 9.0 > 2 * np.pi
    assert np.abs(seldom.yaw - often.yaw[::60]).max() <= SYMMETRY
    plant.reset(State(yaw=9.0))
    stepped = [plant.step((0.0, 1.6), 3.0).yaw for _ in range(4)]
    assert np.abs(stepped - often.yaw[60::60]).max() <= SYMMETRY


def test_n_commands_leave_n_plus_one_states(make: Make) -> None:
    motion = make().run(WEAVE, State(), WEAVE.dt)
    assert len(motion) == WEAVE.n + 1


def test_prescribed_wheel_rates_turn_the_wheels(make: Make) -> None:
    rates = Commands(0.05, np.tile([2.0, 3.0], (60, 1)), "wheels")
    motion = make().run(rates, State(), 0.05)
    assert np.abs(motion.wheels[-1] - [2.0, 3.0]).max() < 1e-3
    assert motion.twist[-1, 0] > 0.3
    assert motion.twist[-1, 2] > 0.0


def test_turning_left_turns_left(make: Make) -> None:
    motion = make().run(Commands(0.05, np.tile([0.0, 0.8], (100, 1))), State(), 0.05)
    assert motion.pose[-1, 2] > 0.5
    assert motion.wheels[-1, 1] > 0.0 > motion.wheels[-1, 0]


def test_nothing_happens_before_the_delay_is_over(make: Make) -> None:
    motion = make().run(WEAVE, State(), 0.01)
    early = motion.t <= 0.19
    assert isinstance(motion, Trajectory)
    assert np.abs(motion.pose[early]).max() <= 1e-9
    assert motion.pose[-1, 0] > 0.1


@pytest.mark.parametrize("kind", ["twist", "wheels"])
@pytest.mark.parametrize("model", ["improved", "kinematic"])
def test_a_long_run_is_driven_in_parts_to_the_bit(
    model: str, kind: CommandKind, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant = make_plant(load_profile("husky-tile"), model)
    values = np.random.default_rng(1).uniform(-1.0, 1.0, (60, 2))
    commands = Commands(0.05, values, kind)
    push = np.random.default_rng(2).standard_normal(round(commands.duration / plant.dt))
    whole = plant.run(commands, State(v_x=0.2), 0.01, push)
    monkeypatch.setattr("ssmr.simulation._AT_ONCE", 7)
    parts = plant.run(commands, State(v_x=0.2), 0.01, push)
    for name in ("pose", "twist", "wheels"):
        assert np.array_equal(getattr(parts, name), getattr(whole, name)), name
    for name, channel in whole.channels.items():
        assert np.array_equal(parts.channels[name], channel), name
