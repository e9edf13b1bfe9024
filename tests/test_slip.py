"""Tyres that slip as they roll, in MuJoCo; tests/test_four_wheel_agreement.py compares their curves with a model's."""

from __future__ import annotations

import math
from typing import get_args

import mujoco
import numpy as np
import pytest

from ssmr.robot.vehicle import Drive
from ssmr.types import Commands, FloatArray, State
from tests.robots import HUSKY, husky
from validation.engines.body import RigidNumbers
from validation.simulator.calibration import Calibration
from validation.simulator.description import GRAVITY, WheelShape
from validation.simulator.exporting import mjcf_text
from validation.simulator.physics import PhysicsSettings
from validation.simulator.plant import MujocoPlant
from validation.simulator.slip import LEAST_ROLLING
from validation.simulator.terrain import FLAT, Terrain
from validation.simulator.turning import closed_form

FREE = Drive(torque_limit=math.inf)


def turned(calibration: Calibration, seconds: float = 6.0, speed: float = 0.0) -> FloatArray:
    """Mean twist in the last second of a bend whose wheels ask for 0.5 rad/s."""
    r, half = calibration.wheel_radius, calibration.half_track
    rates = np.tile([(speed - half * 0.5) / r, (speed + half * 0.5) / r], (round(seconds / 0.02), 1))
    motion = MujocoPlant(calibration, FREE).run(Commands(0.02, rates, kind="wheels"), State(), 0.02)
    return np.asarray(motion.twist[-50:].mean(axis=0))


@pytest.mark.parametrize("shape", get_args(WheelShape))
@pytest.mark.parametrize("compliance", [1e-3, 0.2])
def test_a_turn_on_the_spot_is_that_of_the_closed_form(compliance: float, shape: WheelShape) -> None:
    """All of each tyre slides there: its force is friction times load, whatever the compliance."""
    calibration = husky(slip_compliance=compliance, wheel_shape=shape, com_x=0.02)
    assert 0.5 / turned(calibration)[2] == pytest.approx(closed_form(calibration).multiplier, rel=1e-3)


def test_the_step_hardly_matters() -> None:
    one, other = (turned(husky(slip_compliance=0.1, timestep=dt), speed=1.0) for dt in (0.002, 0.001))
    np.testing.assert_allclose(one, other, rtol=5e-4)


def test_steps_are_the_runs_to_the_bit() -> None:
    plant, commands = MujocoPlant(husky(slip_compliance=0.1), HUSKY.drive), np.tile([0.6, 0.5], (40, 1))
    motion, state = plant.run(Commands(0.05, commands), State(), 0.05), plant.reset(State())
    for command in commands:
        state = plant.step((command[0], command[1]), 0.05)
    assert (state.x, state.y) == tuple(motion.pose[-1, :2])


def test_a_standing_robot_creeps_down_a_slope_as_slowly_as_said() -> None:
    """A standing tyre's slip is taken over the least rolling speed: it creeps at that times compliance and slope."""
    compliance, slope = 0.1, math.radians(8.0)
    plant = MujocoPlant(husky(slip_compliance=compliance), FREE, terrain=Terrain(slope))
    motion = plant.run(Commands(0.05, np.zeros((60, 2)), kind="wheels"), State(), 0.05)
    least = LEAST_ROLLING * math.sqrt(GRAVITY * plant.calibration.wheel_radius)
    share = math.tan(slope) / plant.calibration.friction
    expected = 3.0 * plant.calibration.friction * compliance * (1.0 - (1.0 - share) ** (1.0 / 3.0)) * least
    rolled = plant.calibration.wheel_radius * motion.wheels[-1].mean()  # motors that hold the wheels give a little
    assert abs(motion.twist[-1, 0] - rolled) == pytest.approx(expected, rel=0.02)


def test_what_cannot_slip_says_so() -> None:
    slipping = husky(slip_compliance=0.1)
    with pytest.raises(ValueError, match="MuJoCo alone has no tyres that slip"):
        mjcf_text(slipping, HUSKY.motor_drive)
    with pytest.raises(ValueError, match="this engine's tyres do not slip"):
        RigidNumbers.of(slipping, FREE, FLAT)
    with pytest.raises(ValueError, match="friction_ratio must be 1"):
        husky(slip_compliance=0.1, friction_ratio=0.9, wheel_shape="capsule")
    for settings in (PhysicsSettings(cone="pyramidal"), PhysicsSettings(solver="PGS")):
        with pytest.raises(ValueError, match="tyres that slip need"):
            MujocoPlant(slipping, FREE, settings=settings)


def test_other_models_are_left_alone() -> None:
    """The callback is the whole process': a model without these tyres moves as it did before."""
    ball = '<body pos="0 0 .1"><freejoint/><geom size=".1"/></body>'
    text = f'<mujoco><worldbody><geom type="plane" size="9 9 1"/>{ball}</worldbody></mujoco>'
    model, ends = mujoco.MjModel.from_xml_string(text), []
    MujocoPlant(husky(slip_compliance=0.1), FREE)
    callback = mujoco.get_mjcb_passive()
    for used in (callback, None):
        mujoco.set_mjcb_passive(used)
        data = mujoco.MjData(model)
        data.qvel[0] = 1.0
        mujoco.mj_step(model, data, nstep=100)
        ends.append(data.qpos.tolist())
    mujoco.set_mjcb_passive(callback)
    assert ends[0] == ends[1]
