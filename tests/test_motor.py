"""The motors' speed loop: its law and its limits.

Tests/test_same_motor.py drives it in every plant.
"""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from ssmr.models.coulomb import CoulombParameters
from ssmr.models.improved import ImprovedParameters
from ssmr.models.linear import LinearParameters
from ssmr.parameters import pack_numbers
from ssmr.robot.drive import (
    Motor,
    Sides,
    advance_integral,
    motor_numbers,
    motor_torques,
    side_rates,
    side_thrusts,
)
from ssmr.robot.vehicle import Drive, Vehicle, vehicle_body
from ssmr.simulation import PlanarModel, PlanarPlant, _planar_start, move_robot
from ssmr.types import Commands, State
from tests.robots import husky
from validation.simulator.calibration import Calibration
from validation.simulator.description import SIDES, WHEELS
from validation.simulator.model import robot_model
from validation.simulator.motors import SLIP_INERTIA, actuator_inputs

LEAKY = Drive(
    delay_v=0.0,
    delay_w=0.0,
    v_max=5.0,
    w_max=5.0,
    command_ramp=0.05,
    torque_limit=30.0,
    integral_gain=800.0,
    dc_stiffness=1900.0,
)
STILL = Sides(0.0, 0.0)
JOINTS = tuple(f"{wheel}_wheel" for wheel in WHEELS)
SMOOTH = (
    CoulombParameters(0.0, 0.0, 60.0),
    ImprovedParameters(0.0, 0.0, 0.0, 60.0),
    LinearParameters(0.0, 0.0, 60.0 / 0.1651),
)
"""The dynamic planar models without friction, with the same loop."""


def torques(wheels: tuple[float, float], actual: Sides, gain: float, motor: Motor) -> Sides:
    """Return the torques without an integral part."""
    return motor_torques(Sides(*wheels), STILL, actual, gain, motor)


def test_without_an_integral_part_the_torque_is_proportional_and_limited() -> None:
    seven = motor_numbers(Drive(), 0.001)
    assert torques((3.0, -3.0), Sides(2.9, -2.9), 100.0, seven) == pytest.approx((10.0, -10.0))
    assert torques((3.0, -3.0), STILL, 100.0, seven) == (14.0, -14.0)
    free = motor_numbers(Drive(torque_limit=math.inf, no_load_rate=5.0), 0.001)
    assert torques((3.0, 0.0), STILL, 100.0, free).left == pytest.approx(300.0)


@pytest.mark.parametrize("rate", [-8.0, -2.0, 0.0, 3.0, 6.0, 9.0])
def test_a_motor_at_full_voltage_loses_torque_with_its_rate(rate: float) -> None:
    """From the stall torque to the no-load rate, forwards and backwards.

    Below full voltage the loop does not notice.
    """
    motor = motor_numbers(Drive(torque_limit=10.0, no_load_rate=6.0), 0.001)
    most, least = (torques((w, w), Sides(rate, rate), 1e6, motor).left for w in (100.0, -100.0))
    assert most == pytest.approx(20.0 * (1.0 - rate / 6.0))
    assert least == pytest.approx(-20.0 * (1.0 + rate / 6.0))
    if abs(rate) < 5.0:
        assert torques((rate + 0.01, rate), Sides(rate, rate), 100.0, motor) == pytest.approx(
            (1.0, 0.0)
        )


def test_the_integral_part_leaks_to_its_stiffness_and_is_stepped_exactly() -> None:
    error = 0.01
    often = 0.0
    once = advance_integral(0.0, error, motor_numbers(LEAKY, 0.3))
    for _ in range(300):
        often = advance_integral(often, error, motor_numbers(LEAKY, 0.001))
    assert once == pytest.approx(often, rel=1e-12)
    assert once == pytest.approx(1900.0 * error * -math.expm1(-0.3 * 800.0 / 1900.0))
    assert advance_integral(0.0, error, motor_numbers(LEAKY, 1e3)) == pytest.approx(1900.0 * error)
    # a stuck wheel winds it up to the motor's limit
    assert advance_integral(0.0, 10.0, motor_numbers(LEAKY, 1.0)) == 60.0
    true = motor_numbers(replace(LEAKY, dc_stiffness=1e9), 0.3)
    assert advance_integral(0.0, error, true) == pytest.approx(800.0 * error * 0.3, rel=1e-6)


@pytest.mark.parametrize("difference", [-0.01, 0.0, 0.008])
def test_thrust_and_rates_have_one_power(difference: float) -> None:
    """Torque times wheel rate is thrust times ground speed on each side, for any radii."""
    vehicle = vehicle_body(pack_numbers(Vehicle(radius_difference=difference)))
    rates = side_rates(0.4, 0.3, vehicle)
    torque = Sides(7.0, -3.0)
    thrust = side_thrusts(torque, rates, vehicle, motor_numbers(Drive(), 0.001))
    speeds = 0.4 - vehicle.effective_half_track * 0.3, 0.4 + vehicle.effective_half_track * 0.3
    assert np.multiply(torque, rates) == pytest.approx(np.multiply(thrust, speeds))


@pytest.mark.parametrize("limit", [3.0, math.inf])
@pytest.mark.parametrize("parameters", SMOOTH)
def test_the_torque_that_is_reported_is_the_one_that_moves_the_robot(
    parameters: object, limit: float
) -> None:
    """Sides of unlike radii thrust with torque over their own radius, at the limit and below."""
    vehicle = Vehicle(radius_difference=0.009)
    dt = 1e-6
    robot = PlanarModel(parameters, vehicle, Drive(torque_limit=limit)).packed(dt)
    start = _planar_start(State(v_x=0.4, yaw_rate=0.3).motion, robot)
    now, _ = move_robot(*start, Sides(2.5, 3.5), 0.0, robot)
    left = now.torque_left / robot.vehicle.radius_left
    right = now.torque_right / robot.vehicle.radius_right
    assert (limit == 3.0) == (abs(now.torque_right) == 6.0)
    assert (now.v - 0.4) / dt == pytest.approx((left + right) / vehicle.mass, rel=1e-3)
    assert (now.w - 0.3) / dt == pytest.approx(
        0.275 * (right - left) / vehicle.yaw_inertia, rel=1e-3
    )


def test_the_linear_model_is_stepped_exactly_with_unlike_radii_too() -> None:
    model = PlanarModel(
        LinearParameters(), Vehicle(radius_difference=0.009), Drive(torque_limit=math.inf)
    )
    ends = []
    for dt in (0.05, 0.0005):
        robot = model.packed(dt)
        now, integral = _planar_start(State(v_x=0.4, yaw_rate=0.3).motion, robot)
        for _ in range(round(0.1 / dt)):
            now, integral = move_robot(now, integral, Sides(2.5, 3.5), 0.2, robot)
        ends.append((now.v, now.w))
    assert ends[0] == pytest.approx(ends[1], rel=1e-10)


@pytest.mark.parametrize("parameters", SMOOTH)
def test_the_integral_part_takes_the_droop_out_of_every_planar_model(parameters: object) -> None:
    """A lasting gear loss T costs T / (K_P + K_dc) of wheel rate."""
    drive = replace(LEAKY, gear_loss=4.0)
    motion = PlanarPlant(PlanarModel(parameters, Vehicle(), drive)).run(
        Commands(0.05, np.tile([0.5, 0.3], (400, 1))), State(), 0.05
    )
    commanded = side_rates(0.5, 0.3, vehicle_body(pack_numbers(Vehicle())))
    assert np.array(commanded) - motion.wheels[-1] == pytest.approx(
        np.full(2, 4.0 / (60.0 + 1900.0)), rel=1e-3
    )


@pytest.mark.parametrize("parameters", SMOOTH)
def test_sides_of_different_radius_turn_a_robot_that_is_told_to_drive_straight(
    parameters: object,
) -> None:
    vehicle = Vehicle(radius_difference=0.008)
    drive = replace(LEAKY, dc_stiffness=1e8)
    motion = PlanarPlant(PlanarModel(parameters, vehicle, drive)).run(
        Commands(0.05, np.tile([0.5, 0.0], (400, 1))), State(), 0.05
    )
    assert motion.twist[-1, 2] == pytest.approx(-0.008 * 0.5 / 0.1651 / (2 * 0.275), rel=1e-2)
    reported = PlanarPlant(PlanarModel(parameters, vehicle, drive)).run(
        Commands(0.05, [[3.0, 3.0]] * 9, "wheels"), State(), 0.05
    )
    assert reported.twist[-1] == pytest.approx([3.0 * 0.1651, 0.0, -3.0 * 0.008 / (2 * 0.275)])


def hung(drive: Drive, calibration: Calibration) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return a weightless robot in the air, whose motors turn nothing but its wheels."""
    model = robot_model(calibration, drive=drive)
    model.opt.gravity = 0.0
    data = mujoco.MjData(model)
    data.qpos[2] = 1.0
    return model, data


def test_a_simulated_wheel_that_was_stuck_is_let_go_without_wind_up() -> None:
    """The integral part holds little more than the motor's limit, a twentieth, as long as it slips.

    The torque no more.
    """
    calibration = husky(armature=0.2)
    model, data = hung(LEAKY, calibration)
    dofs = model.jnt_dofadr[[model.joint(name).id for name in JOINTS]]
    integrals = [model.actuator(f"{side}_integral").id for side in SIDES]
    for _ in range(2500):
        data.ctrl[:] = actuator_inputs(model, np.full(2, 5.0))
        data.qvel[dofs] = 0.0
        data.qpos[dofs + 1] = 0.0
        mujoco.mj_step(model, data)
    assert data.qfrc_actuator[dofs] == pytest.approx(np.full(4, 30.0))
    held = data.actuator_force[integrals]
    assert np.all((held > 0.99 * 60.0) & (held < 1.07 * 60.0))
    fastest = 0.0
    for _ in range(1000):
        mujoco.mj_step(model, data)
        fastest = max(fastest, float(data.qvel[dofs].max()))
    assert data.qvel[dofs] == pytest.approx(np.full(4, 5.0), rel=1e-2)
    assert fastest < 5.0 + 60.0 / calibration.gain


@pytest.mark.parametrize("stiffness", [500.0, 1900.0, 1e6, math.inf])
def test_a_lasting_load_costs_a_simulated_wheel_what_the_law_says(stiffness: float) -> None:
    """T / (K_P + K_dc), of any stiffness.

    That of the slip ends where the rate is lost in a millionth of the wheels' own.
    """
    model, data = hung(replace(LEAKY, dc_stiffness=stiffness), husky(armature=0.2))
    dofs = model.jnt_dofadr[[model.joint(name).id for name in JOINTS]]
    data.ctrl[:] = actuator_inputs(model, np.full(2, 3.0))
    data.qfrc_applied[dofs] = -5.0
    mujoco.mj_step(model, data, nstep=10000)
    lost = 3.0 - data.qvel[dofs]
    # MuJoCo's impedance of 0.9999 stands for a slip that gives way at rest: K_dc has an end
    turned = 2.0 * (husky().armature + husky().robot.wheel_inertia[1])
    stiffest = SLIP_INERTIA * turned / (1e-4 * model.opt.timestep)
    lasting = husky().gain + min(stiffness, stiffest)
    assert lost == pytest.approx(np.full(4, 10.0 / lasting), rel=2e-3, abs=1e-5)
