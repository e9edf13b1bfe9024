"""The computed rest of a robot is where it settles.

A plant that is given other numbers equals one built with them.
"""

from __future__ import annotations

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
from validation.plants.profile import load_profile
from validation.plants.table import plant_kind
from validation.simulator.calibration import Calibration
from validation.simulator.physics import PhysicsSettings
from validation.simulator.plant import MujocoPlant
from validation.simulator.resting import level_rest, solved_exactly

SETTLED = 1e-9
"""Heights [m] and parts of quaternions [1]: settling for four seconds comes as near to rest as
this."""

STILL = 1e-5
"""Change of a load [N], and yaw rate [rad/s], of a robot at rest."""


def settled(plant: MujocoPlant, seconds: float) -> np.ndarray:
    """Height, roll and pitch of a robot that has been let go."""
    data = mujoco.MjData(plant.model)
    with solved_exactly(plant.model):
        mujoco.mj_step(plant.model, data, nstep=round(seconds / plant.dt))
    return lie(data.qpos)


def lie(qpos: np.ndarray) -> np.ndarray:
    """Height, and x and y of the upright axis in the world, whose size has no heading."""
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
        {"robot": "jackal"},
        {"robot": "warthog"},
    ],
)
def test_a_robot_rests_as_it_settles(change: dict[str, Any]) -> None:
    plant = MujocoPlant(
        Calibration.of(load_robot(change["robot"])) if "robot" in change else husky(**change),
        Drive(),
    )
    measured = level_rest(plant.model, mujoco.MjData(plant.model), plant.calibration)
    assert measured is not None
    assert np.abs(lie(measured) - settled(plant, 4.0)).max() <= SETTLED


def test_what_the_body_does_at_rest_is_nothing() -> None:
    plant = MujocoPlant(
        husky(com_x=0.12, com_y=-0.05), Drive(), settings=PhysicsSettings(solver="Newton")
    )
    stand = plant.run(Commands(0.05, np.zeros((40, 2))), State(), SAMPLE_DT)
    assert np.ptp(stand.channels["wheel_load_N"], axis=0).max() < STILL
    assert np.abs(stand.twist[:, 2]).max() < STILL


def test_how_it_rests_does_not_hang_on_what_was_computed_before() -> None:
    plant = MujocoPlant(husky(com_x=0.05), Drive())
    first = level_rest(plant.model, mujoco.MjData(plant.model), plant.calibration)
    MujocoPlant(husky(com_x=-0.1, wheel_radius=0.15), Drive()).run(
        TRAJECTORIES["traj1"].commands(), State(), SAMPLE_DT
    )
    assert np.array_equal(
        first, level_rest(plant.model, mujoco.MjData(plant.model), plant.calibration)
    )


def test_a_robot_that_tips_over_has_no_rest_that_is_computed() -> None:
    tipping = husky(com_x=0.4)
    plant = MujocoPlant(tipping, Drive())  # it is let go instead
    assert level_rest(plant.model, mujoco.MjData(plant.model), tipping) is None


def test_a_population_does_not_hang_on_those_before_it() -> None:
    """Order and reuse of plants change nothing."""
    section = load_profile("husky-tile").plants["mujoco"]
    stretch = type(
        "Stretch",
        (),
        {"commands": Commands(0.05, np.tile([0.5, 0.3], (20, 1))), "start": State(), "t": None},
    )()
    chosen = [
        replace(section, parameters=replace(section.parameters, friction=f))
        for f in (0.3, 0.6, 0.9)
    ]
    population = plant_kind("mujoco").population
    forward = population(chosen, 1).motions([0, 1, 2], stretch, SAMPLE_DT)
    backward = population(chosen[::-1], 1).motions([0, 1, 2], stretch, SAMPLE_DT)
    assert np.array_equal(forward, backward[::-1])
    bad = replace(section, parameters=replace(section.parameters, yaw_inertia=50.0))
    mixed = population([bad, chosen[1]], 1).motions([0, 1], stretch, SAMPLE_DT)
    assert np.isnan(mixed[0]).all()
    assert np.array_equal(mixed[1], forward[1])
