"""The computed rest of a robot is where it settles, and a plant that is given other numbers equals one built with them."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

from ssmr.robot.vehicle import Drive
from ssmr.scenarios import TRAJECTORIES
from ssmr.simulation import SAMPLE_DT
from ssmr.types import Commands, State
from tests.robots import husky
from validation import load_robot
from validation.plants.one_by_one import OneByOne, Workshop
from validation.plants.profile import load_profile
from validation.plants.table import plant_kind
from validation.simulator.calibration import Calibration
from validation.simulator.parts import scratch
from validation.simulator.physics import PhysicsSettings
from validation.simulator.plant import MujocoPlant
from validation.simulator.resting import level_rest, solved_exactly

SETTLED = 1e-9
"""Heights [m] and parts of quaternions [1]: settling for four seconds comes as near to rest as this."""

STILL = 1e-5
"""Change of a load [N], and yaw rate [rad/s], of a robot at rest."""


def settled(plant: MujocoPlant, seconds: float) -> np.ndarray:
    """Height, roll and pitch of a robot that has been let go."""
    data = mujoco.MjData(plant.model)
    with solved_exactly(plant.model):
        mujoco.mj_step(plant.model, data, nstep=round(seconds / plant.dt))
    return lie(data.qpos)


def lie(qpos: np.ndarray) -> np.ndarray:
    """Height, and the x and y of the upright axis as the world sees it: of no heading but their size."""
    w, x, y, z = qpos[3:7]
    return np.array([qpos[2], 2.0 * (w * x + y * z), 2.0 * (w * y - x * z)])


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"com_x": -0.1, "com_y": 0.1, "com_z": 0.3},
        {"com_x": 0.1, "radius_difference": -0.01, "wheel_radius": 0.15},
        {"wheel_shape": "cylinder", "com_y": 0.1},
        {"wheel_shape": "capsule", "friction_ratio": 0.2, "friction": 0.8, "com_x": -0.08},
        {"mass": 40.0, "yaw_inertia": 2.5},
        {"mass": 300.0, "yaw_inertia": 14.0, "com_y": -0.1},
        {"timestep": 0.0005, "armature": 1e-6},
    ],
)
def test_a_robot_rests_as_it_settles(change: dict[str, Any]) -> None:
    plant = MujocoPlant(husky(**change), Drive())
    found = level_rest(plant.model, scratch(plant.model), plant.calibration)
    assert found is not None
    assert np.abs(lie(found) - settled(plant, 4.0)).max() <= SETTLED


@pytest.mark.parametrize("name", ["jackal", "warthog"])
def test_other_robots_rest_as_they_settle(name: str) -> None:
    plant = MujocoPlant(Calibration.of(load_robot(name)), Drive())
    found = level_rest(plant.model, scratch(plant.model), plant.calibration)
    assert found is not None
    assert np.abs(lie(found) - settled(plant, 4.0)).max() <= SETTLED


def test_what_the_body_does_at_rest_is_nothing() -> None:
    plant = MujocoPlant(husky(com_x=0.12, com_y=-0.05), Drive(), settings=PhysicsSettings(solver="Newton"))
    stand = plant.run(Commands(0.05, np.zeros((40, 2))), State(), SAMPLE_DT)
    assert np.ptp(stand.channels["wheel_load_N"], axis=0).max() < STILL
    assert np.abs(stand.twist[:, 2]).max() < STILL


def test_how_it_rests_does_not_hang_on_what_was_computed_before() -> None:
    plant = MujocoPlant(husky(com_x=0.05), Drive())
    first = level_rest(plant.model, scratch(plant.model), plant.calibration)
    MujocoPlant(husky(com_x=-0.1, wheel_radius=0.15), Drive()).run(TRAJECTORIES["traj1"].commands(), State(), SAMPLE_DT)
    assert np.array_equal(first, level_rest(plant.model, scratch(plant.model), plant.calibration))


def test_a_robot_that_tips_over_has_no_rest_that_is_computed() -> None:
    plant = MujocoPlant(husky(), Drive())
    tipping = replace(plant.calibration, com_x=0.4)
    plant.renumber(tipping, Drive())  # it is let go instead
    assert level_rest(plant.model, scratch(plant.model), tipping) is None


def motion(plant: MujocoPlant, kind: str) -> np.ndarray:
    """All numbers of a run."""
    commands = TRAJECTORIES["traj4"].commands()
    commands = replace(commands, values=commands.values[:100])
    if kind == "wheels":
        commands = Commands(0.05, 5.0 * commands.values, "wheels")
    push = np.random.default_rng(3).normal(0.0, 0.5, round(commands.duration / plant.dt))
    run = plant.run(commands, State(1.0, 2.0, 0.5), SAMPLE_DT, push)
    return np.column_stack([run.pose, run.twist, run.wheels, *(np.atleast_2d(c.T).T for c in run.channels.values())])


@pytest.mark.parametrize("kind", ["twist", "wheels"])
def test_a_plant_with_other_numbers_is_one_built_with_them_to_the_bit(kind: str) -> None:
    section = load_profile("husky-tile").plants["mujoco"]
    other = replace(section.parameters, friction=0.8, com_x=0.05, mass=90.0, wheel_radius=0.17, armature=0.5, gain=300.0)
    drive = replace(section.drive, torque_limit=20.0, integral_gain=500.0, gear_loss=1.0, no_load_rate=8.0)
    built, changed = MujocoPlant(other, drive), MujocoPlant(section.parameters, section.drive)
    motion(changed, kind)
    changed.renumber(other, drive)
    assert changed.yaw_inertia == built.yaw_inertia
    assert np.array_equal(motion(changed, kind), motion(built, kind))
    changed.renumber(section.parameters, section.drive)
    assert np.array_equal(motion(changed, kind), motion(MujocoPlant(section.parameters, section.drive), kind))


def test_a_plant_only_gets_the_numbers_of_its_structure() -> None:
    plant = MujocoPlant(husky(), Drive())
    with pytest.raises(ValueError, match="same structure"):
        plant.renumber(husky(wheel_shape="cylinder"), Drive())
    with pytest.raises(ValueError, match="must lie between"):
        plant.renumber(husky(yaw_inertia=50.0), Drive())
    plant.renumber(husky(friction=0.5), Drive())
    assert np.array_equal(motion(plant, "twist"), motion(MujocoPlant(husky(friction=0.5), Drive()), "twist"))


def test_candidates_are_made_of_those_of_the_last_generation() -> None:
    section = load_profile("husky-tile").plants["mujoco"]
    built: list[MujocoPlant] = []

    def build(candidate: Any) -> MujocoPlant:
        built.append(MujocoPlant(candidate.parameters, candidate.drive))
        return built[-1]

    workshop = Workshop(build, lambda plant, candidate: plant.renumber(candidate.parameters, candidate.drive))
    for generation in range(3):
        friction = [0.3 + 0.1 * generation, 0.6]
        chosen = [replace(section, parameters=replace(section.parameters, friction=f)) for f in friction]
        candidates = OneByOne(workshop.make, [chosen[0], None, chosen[1]], 1, workshop.done_with)
        assert [p and p.calibration.friction for p in candidates._plants] == [friction[0], None, friction[1]]
        del candidates
    assert len(built) == 2


def test_a_population_does_not_hang_on_those_before_it() -> None:
    """Order and reuse of plants change nothing."""
    section = load_profile("husky-tile").plants["mujoco"]
    stretch = type("Stretch", (), {"commands": Commands(0.05, np.tile([0.5, 0.3], (20, 1))), "start": State(), "t": None})()
    chosen = [replace(section, parameters=replace(section.parameters, friction=f)) for f in (0.3, 0.6, 0.9)]
    population = plant_kind("mujoco").population
    forward = population(chosen, 1).poses([0, 1, 2], stretch, SAMPLE_DT)
    backward = population(chosen[::-1], 1).poses([0, 1, 2], stretch, SAMPLE_DT)
    assert np.array_equal(forward, backward[::-1])
    bad = replace(section, parameters=replace(section.parameters, yaw_inertia=50.0))
    mixed = population([bad, chosen[1]], 1).poses([0, 1], stretch, SAMPLE_DT)
    assert np.isnan(mixed[0]).all()
    assert np.array_equal(mixed[1], forward[1])


def test_another_candidate_is_quickly_made() -> None:
    """Beside a second of its simulated settling, which it cost before."""
    section = load_profile("husky-tile").plants["mujoco"]
    plant = MujocoPlant(section.parameters, section.drive)
    other, data, taken = replace(section.parameters, friction=0.4), mujoco.MjData(plant.model), []
    for _ in range(20):
        began = time.thread_time()
        plant.renumber(other, section.drive)
        between = time.thread_time()
        mujoco.mj_step(plant.model, data, nstep=500)
        taken.append((between - began, time.thread_time() - between))
    renumbering, settling = np.min(taken, axis=0)
    assert renumbering < 0.3 * settling
