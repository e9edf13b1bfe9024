"""Laws that every plant obeys: Newton's, the motor's line, a tyre's damping."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.models.coulomb import CoulombParameters
from ssmr.models.friction import AlongAcross, Tyre, felt_slip, steady_bend
from ssmr.models.improved import ImprovedParameters
from ssmr.models.linear import LinearParameters, rate_coefficients
from ssmr.parameters import pack_numbers
from ssmr.robot.ground import LoadModel
from ssmr.robot.vehicle import Drive, Vehicle, vehicle_body
from ssmr.simulation import PlanarModel, PlanarPlant
from ssmr.types import Commands, FloatArray, State, Trajectory
from validation.plants.profile import Profile, make_plant

VEHICLE = Vehicle()
FREE = Drive(delay_v=0.0, delay_w=0.0, torque_limit=math.inf, v_max=100.0)
MOVING = State(v_x=0.4, yaw_rate=0.3, wheel_left=2.0, wheel_right=3.0)
PLANAR = (CoulombParameters(), ImprovedParameters(), LinearParameters())
STALL = 3.0
NO_LOAD = 6.0
"""Greatest torque of a wheel [N m] and rate at which none is left [rad/s]."""
ROLLING = 0.03
"""Rolling resistance over load: a third of what the motors can do at rest."""


@pytest.mark.parametrize("parameters", [CoulombParameters(gain=5.0), ImprovedParameters(gain=5.0)])
def test_heun_quarters_its_error_with_half_the_step(parameters: Any) -> None:
    """Far from any sign change, where friction is constant."""
    ends = []
    for dt in (0.004, 0.002, 0.001, 0.0005):
        plant = PlanarPlant(PlanarModel(parameters, VEHICLE, replace(FREE, hold=0.1)), dt)
        commands = Commands(0.1, np.tile([1.0, 0.8], (10, 1)), before=(1.0, 0.8))
        start = State(v_x=0.5, yaw_rate=0.4)
        ends.append(plant.run(commands, start, 0.1).pose[-1])
    steps = [float(np.linalg.norm(a - b)) for a, b in itertools.pairwise(ends)]
    orders = np.log2(np.array(steps[:-1]) / np.array(steps[1:]))
    assert np.all(np.abs(orders - 2.0) < 0.15), orders


@pytest.mark.parametrize("name", ["coulomb", "improved", "linear", "four_wheel"])
def test_a_disturbance_is_an_acceleration_to_the_left(name: str, lab: Profile) -> None:
    """A push of 2 rad/s² changes the yaw rate by 2 rad/s² times the step, whatever else acts."""
    plant: Any = make_plant(lab, name)
    commands = Commands(0.05, np.tile([0.4, 0.3], (1, 1)))
    steps = round(0.05 / plant.dt)
    pushed, left_alone = (
        plant.run(commands, MOVING, plant.dt, np.full(steps, push)).twist[1, 2]
        for push in (2.0, 0.0)
    )
    assert pushed - left_alone == pytest.approx(2.0 * plant.dt, rel=0.05)


def test_mujoco_is_pushed_to_the_left_too(lab: Profile) -> None:
    plant: Any = make_plant(lab, "mujoco")
    commands = Commands(0.05, np.tile([0.4, 0.3], (4, 1)))
    steps = round(0.2 / plant.dt)
    pushed, left_alone = (
        plant.run(commands, MOVING, 0.05, np.full(steps, push)).yaw[-1] for push in (2.0, 0.0)
    )
    assert pushed > left_alone


def fast(name: str, lab: Profile) -> tuple[Trajectory, float]:
    """Return the drive of a robot that was told to be too fast, and its resistance [N m]."""
    section = lab.section(name)
    limits = {"torque_limit": STALL, "no_load_rate": NO_LOAD, "acceleration_v": math.inf}
    drive = replace(section.drive, **limits, v_max=100.0, integral_gain=0.0)
    parameters = section.parameters
    vehicle = section.vehicle
    weight = 73.3 * 9.81
    if name == "linear":
        vehicle = Vehicle()
        slowing = rate_coefficients(vehicle_body(pack_numbers(vehicle)), pack_numbers(parameters))[
            1
        ]
        resistance = slowing * vehicle.mass
    elif name == "improved":
        parameters = replace(parameters, u_x=ROLLING)
        resistance = ROLLING * weight
    else:
        parameters = replace(parameters, rolling_resistance=ROLLING, com_x=0.0, com_y=0.0)
        resistance = ROLLING * weight
    changed = replace(section, parameters=parameters, vehicle=vehicle, drive=drive)
    plant = make_plant(Profile("fast", "", {name: changed}, {}), name)
    return plant.run(Commands(0.05, np.tile([9.0, 0.0], (400, 1))), State(), 0.05), resistance


@pytest.mark.parametrize("name", ["linear", "improved", "four_wheel", "mujoco"])
def test_a_robot_at_full_voltage_drives_where_its_motors_line_meets_the_resistance(
    name: str, lab: Profile
) -> None:
    """2 L (1 - w / w_0) a side is what half of the resistance takes, times the radius."""
    motion, resistance = fast(name, lab)
    rate = float(motion.wheels[-1].mean())
    section = lab.section(name)
    radius = (
        section.vehicle if name in ("linear", "improved") else section.parameters
    ).wheel_radius
    speed = float(motion.twist[-1, 0])
    force = resistance * speed if name == "linear" else resistance
    line = 2.0 * STALL * (1.0 - rate / NO_LOAD)
    assert line == pytest.approx(0.5 * force * radius, rel=0.02)
    assert motion.channels["torque_N_m"][-1] == pytest.approx(np.full(2, line), rel=0.02)
    assert speed == pytest.approx(rate * radius, rel=0.01)


@pytest.mark.parametrize("dt", [0.001, 0.05])
def test_the_linear_model_at_its_motors_limit_is_stepped_exactly(dt: float) -> None:
    """Constant thrust F against friction f v: v = F / (f m) (1 - exp(-f t)), for any step."""
    drive = replace(FREE, torque_limit=2.0)
    plant = PlanarPlant(PlanarModel(LinearParameters(), VEHICLE, drive), dt)
    motion = plant.run(Commands(0.05, np.tile([50.0, 0.0], (20, 1))), State(), 0.05)
    slowing = rate_coefficients(
        vehicle_body(pack_numbers(VEHICLE)), pack_numbers(LinearParameters())
    )[1]
    thrust = 2.0 * 2.0 * 2.0 / VEHICLE.wheel_radius
    t = motion.t
    wanted = thrust / (slowing * VEHICLE.mass) * -np.expm1(-slowing * t)
    assert motion.twist[:, 0] == pytest.approx(wanted, rel=1e-9)
    assert np.all(motion.channels["torque_N_m"][1:] == 4.0)


@pytest.mark.parametrize("parameters", PLANAR)
def test_motors_at_their_limit_on_one_side_alone_know_no_side(parameters: Any) -> None:
    """The left motor's limit does to a right bend what the right one's does to a left bend."""
    plant = PlanarPlant(PlanarModel(parameters, VEHICLE, replace(FREE, torque_limit=3.0)), 0.01)
    start = State(
        v_x=0.5, wheel_left=0.5 / VEHICLE.wheel_radius, wheel_right=0.5 / VEHICLE.wheel_radius
    )
    for wanted in (0.55, 0.65, 0.8):
        left, right = (
            plant.run(
                Commands(0.05, np.tile([wanted, turn], (20, 1)), before=(wanted, turn)), start, 0.05
            )
            for turn in (0.3, -0.3)
        )
        assert np.abs(left.pose * [1.0, -1.0, -1.0] - right.pose).max() < 1e-12
        limited = np.abs(left.channels["torque_N_m"]) >= 6.0 - 1e-9
        if wanted == 0.55:
            assert np.any(limited[:, 0] != limited[:, 1])


TYRE = Tyre(0.6, 10.0, 8.0, 0.1, 0.02)


@given(x=st.floats(-0.3, 0.3), y=st.floats(-0.3, 0.3), rolling=st.floats(0.5, 4.0))
def test_a_steady_tyre_feels_its_slip_whatever_its_damping(
    x: float, y: float, rolling: float
) -> None:
    """Bend and lead add up to sliding over rolling speed, as long as the brushes do not slide."""
    sliding = AlongAcross(0.02 * x, 0.02 * y)
    for damping in (0.0, 0.01, 0.05):
        tyre = TYRE._replace(damping=damping)
        felt = felt_slip(steady_bend(sliding, rolling, tyre), sliding, rolling, tyre)
        assert np.array(felt) == pytest.approx(np.array(sliding) / rolling, abs=1e-12)


def test_a_standing_tyre_damps_what_shakes_it() -> None:
    """Over a cycle its force takes energy: lead / relaxation length times the squared speed."""
    phase = np.linspace(0.0, 2.0 * math.pi, 2001)
    place = 1e-3 * np.sin(phase)
    speed = 1e-3 * np.cos(phase)
    felt = np.array(
        [
            felt_slip(AlongAcross(p / TYRE.relaxation, 0.0), AlongAcross(s, 0.0), 0.0, TYRE).x
            for p, s in zip(place, speed, strict=True)
        ]
    )
    work = np.trapezoid(felt * speed, phase)
    wanted = TYRE.damping / TYRE.relaxation * 1e-6 * math.pi
    assert work == pytest.approx(wanted, rel=1e-6)


def path_of(twist: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:
    """Return (M,) headings and (M, 2) places of the middle of a robot with (M, 3) smooth twists."""
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * dt * (twist[1:, 2] + twist[:-1, 2]))])
    cos = np.cos(yaw)
    sin = np.sin(yaw)
    world = np.column_stack(
        [twist[:, 0] * cos - twist[:, 1] * sin, twist[:, 0] * sin + twist[:, 1] * cos]
    )
    places = np.cumsum(0.5 * dt * (world[1:] + world[:-1]), axis=0)
    return yaw, np.vstack([np.zeros(2), places])


def test_loads_follow_from_how_the_centre_of_mass_is_accelerated() -> None:
    """The acceleration is that of the path in the world, differentiated twice and turned."""
    dt = 1e-3
    t = dt * np.arange(3001)
    twist = np.column_stack([0.5 + 0.2 * np.sin(t), 0.1 * np.cos(1.3 * t), 0.8 * np.sin(2.0 * t)])
    model = LoadModel(70.0, 0.12, -0.07, 0.2, 0.5, 0.6)
    yaw, middle = path_of(twist, dt)
    cos = np.cos(yaw)
    sin = np.sin(yaw)
    at = middle + np.column_stack(
        [
            model.com_x * cos - model.com_y * sin,
            model.com_x * sin + model.com_y * cos,
        ]
    )
    world = np.gradient(np.gradient(at, dt, axis=0), dt, axis=0)
    ahead = cos * world[:, 0] + sin * world[:, 1]
    aside = cos * world[:, 1] - sin * world[:, 0]
    level = np.tile([0.0, 0.0, -9.81], (len(t), 1))
    none = np.zeros(len(t))
    wanted = model.quasi_static(np.column_stack([ahead, aside]), level, none, none, none)
    pose = np.column_stack([middle, yaw])
    motion = Trajectory(t, pose, twist, np.full((len(t), 2), 1e-12))
    inside = slice(200, -200)
    got = model.along(motion, level, 0.16)
    assert np.ptp(wanted[inside], axis=0).max() > 10.0
    assert np.abs(got[inside] - wanted[inside]).max() < 0.3  # slopes are taken over 0.1 s
