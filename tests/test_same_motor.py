"""One drive in every plant: leaky PI loop, torque limit, gear loss, ramped commands.

On a straight line with much grip every robot is one mass and two spinning sides, so one equation
says what the motors do.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import astuple, replace
from functools import cache

import mujoco
import numpy as np
import pytest

from ssmr.models.four_wheel import FourWheelParameters
from ssmr.models.four_wheel_plant import FourWheelPlant
from ssmr.models.improved import ImprovedParameters
from ssmr.models.linear import LinearParameters
from ssmr.robot.drive import (
    Motor,
    Sides,
    advance_integral,
    gear_loss,
    motor_numbers,
    motor_torques,
    wheel_references,
)
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.scenarios import TRAJECTORIES
from ssmr.simulation import PlanarModel, PlanarPlant
from ssmr.types import Commands, FloatArray, Plant, State, Trajectory
from tests.conftest import distances_to_path
from tests.robots import HUSKY, husky
from validation.engines.body import EngineMissingError
from validation.engines.drake import DrakeBody
from validation.engines.ode import OdeBody
from validation.engines.plant import EnginePlant
from validation.plants.profile import Profile
from validation.simulator.bodies import MujocoBodies
from validation.simulator.plant import MujocoPlant

GAIN = 60.0
ARMATURE = 0.2
DT = 0.001
CALIBRATION = husky(friction=1.0, gain=GAIN, armature=ARMATURE, timestep=DT)
SPIN = ARMATURE + HUSKY.wheel_inertia[1]
MASS = CALIBRATION.mass
RADIUS = CALIBRATION.wheel_radius
COMMANDS = Commands(0.05, np.repeat([[0.6, 0.0], [-0.4, 0.0], [0.2, 0.0]], 24, axis=0))
"""The steps are more than the motors can do, and the integral part reaches its limit on each."""


def drive(stiffness: float) -> Drive:
    return Drive(
        delay_v=0.0,
        delay_w=0.0,
        command_ramp=0.05,
        command_half_track=0.275,
        command_radius=RADIUS,
        torque_limit=7.0,
        integral_gain=800.0,
        dc_stiffness=stiffness,
        gear_loss=3.0,
    )


def planar(parameters: object) -> Callable[[Drive], Plant]:
    vehicle = Vehicle(mass=MASS, wheel_radius=RADIUS, spin_inertia=2.0 * SPIN)
    return lambda d: PlanarPlant(PlanarModel(parameters, vehicle, d), DT)


def four_wheels(d: Drive) -> Plant:
    robot = {
        "mass": MASS,
        "yaw_inertia": CALIBRATION.yaw_inertia,
        "wheelbase": HUSKY.wheelbase,
        "half_track": CALIBRATION.half_track,
        "wheel_radius": RADIUS,
        "com_x": 0.0,
        "com_y": 0.0,
        "com_height": 0.19,
        "gain": GAIN,
        "armature": ARMATURE,
        "wheel_inertia": HUSKY.wheel_inertia[1],
        "friction": 1.0,
        "stiffness_x": 300.0,
        "stiffness_y": 300.0,
    }
    parameters = FourWheelParameters(**robot)  # type: ignore[arg-type]  # link has a default
    return FourWheelPlant(parameters, d, DT)


PLANTS: dict[str, Callable[[Drive], Plant]] = {
    "improved": planar(ImprovedParameters(0.0, 0.0, 0.0, GAIN)),
    "linear": planar(LinearParameters(0.0, 0.0, GAIN / RADIUS)),
    "four_wheel": four_wheels,
    "mujoco": lambda d: MujocoPlant(CALIBRATION, d),
    "ode": lambda d: EnginePlant("ode", OdeBody, CALIBRATION, d),
    "drake": lambda d: EnginePlant("drake", DrakeBody, CALIBRATION, d),
}


@cache
def expected(stiffness: float) -> tuple[FloatArray, FloatArray]:
    """Return (n,) ways [m] and torques of a side [N m], in twenty small steps a physics step."""
    few = 20
    d = drive(stiffness)
    motor: Motor = motor_numbers(d, DT / few)
    inertia = 0.5 * MASS * RADIUS**2 + 2.0 * SPIN
    rate = 0.0
    integral = 0.0
    way = 0.0
    rows = []
    for reference in wheel_references(COMMANDS, d, DT, State())[:, 0]:
        for _ in range(few):
            sides = (Sides(float(x), float(x)) for x in (reference, integral, rate))
            torque = motor_torques(*sides, GAIN, motor).left
            before = rate
            rate = rate + DT / few * (torque - gear_loss(rate, motor)) / inertia
            integral = advance_integral(integral, float(reference) - 0.5 * (before + rate), motor)
            way += DT / few * RADIUS * 0.5 * (before + rate)
        rows.append((way, torque))
    table = np.array(rows)
    return table[:, 0], table[:, 1]


def driven(name: str, stiffness: float) -> Trajectory:
    try:
        plant = PLANTS[name](drive(stiffness))
    except EngineMissingError as missing:
        pytest.skip(str(missing))
    return plant.run(COMMANDS, State(), DT)


@pytest.mark.parametrize("stiffness", [500.0, 2e4, np.inf])
@pytest.mark.parametrize("name", PLANTS)
def test_every_plant_has_the_same_motor(name: str, stiffness: float) -> None:
    """Within 2 mm at equal times, and half a newton metre.

    The motors stay at their 14 N m for two fifths of the time.
    """
    motion, (way, torque) = driven(name, stiffness), expected(stiffness)
    assert np.abs(motion.xy[1:, 0] - way).max() < 2e-3
    assert np.sqrt(np.mean((motion.channels["torque_N_m"][1:, 0] - torque) ** 2)) < 0.5


def test_mujocos_motor_is_the_same_in_a_rollout_in_steps_and_in_a_batch() -> None:
    plant = MujocoPlant(CALIBRATION, drive(np.inf))
    rollout = plant.run(COMMANDS, State(), DT)
    plant.reset(State())
    stepped = [plant.step((float(v), float(w)), COMMANDS.dt) for v, w in COMMANDS.values]
    bodies = MujocoBodies([plant], 1)
    bodies.place([0], [State()])
    references = wheel_references(COMMANDS, plant.drive, DT, State())
    bodies.advance(references[None], np.zeros((1, len(references))))
    every = round(COMMANDS.dt / DT)
    rolled = np.column_stack([rollout.xy[every::every, 0], rollout.twist[every::every, 0]])
    assert np.array([(now.x, now.v_x) for now in stepped]) == pytest.approx(rolled, abs=1e-12)
    assert bodies.states()[0, :8] == pytest.approx(astuple(stepped[-1]), abs=1e-12)


FINE = 0.00025
"""Step of the law applied as a force, whose error is of first order in it: a quarter of a
millimetre to one [s]."""


def apart(lab: Profile, trajectory: str, limit: float, stiffness: float) -> float:
    """Return the greatest distance [m] of MuJoCo's path from that of the law in small steps."""
    section = lab.section("mujoco")
    commands = TRAJECTORIES[trajectory].commands()
    drive = replace(section.drive, torque_limit=limit, dc_stiffness=stiffness)
    plant = MujocoPlant(replace(section.parameters, timestep=FINE), drive)
    model = plant.model
    data = mujoco.MjData(plant.model)
    motor = motor_numbers(plant.drive, plant.dt)
    mujoco.mj_setState(model, data, plant.placed(State()), mujoco.mjtState.mjSTATE_FULLPHYSICS)
    model = mujoco.MjModel.__copy__(model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    left = 0.0
    right = 0.0
    path = [data.qpos[:2].copy()]
    for reference in wheel_references(commands, plant.drive, plant.dt, State()):
        rates = Sides(*(float(data.qvel[dofs].mean()) for dofs in plant.parts.sides))
        commanded = Sides(*reference.tolist())
        torques = motor_torques(
            commanded, Sides(left, right), rates, section.parameters.gain, motor
        )
        for dofs, torque in zip(plant.parts.sides, torques, strict=True):
            data.qfrc_applied[dofs] = 0.5 * torque
        left = advance_integral(left, reference[0] - rates.left, motor)
        right = advance_integral(right, reference[1] - rates.right, motor)
        mujoco.mj_step(model, data)
        path.append(data.qpos[:2].copy())
    shipped = MujocoPlant(section.parameters, drive)
    return float(
        distances_to_path(shipped.run(commands, State(), shipped.dt).xy, np.array(path)).max()
    )


@pytest.mark.parametrize(
    ("trajectory", "limit", "stiffness"),
    [
        pytest.param("traj4", 30.0, 1e6, marks=pytest.mark.slow),
        ("traj4", 7.0, 500.0),
        ("traj4", 7.0, np.inf),
        pytest.param("traj1", 10.0, 1900.0, marks=pytest.mark.slow),
    ],
)
def test_mujoco_drives_the_path_of_the_law_applied_as_a_force(
    trajectory: str, limit: float, stiffness: float, lab: Profile
) -> None:
    """Paths of 5 to 10 m are 3 mm apart at most, also with motors mostly at their limit."""
    assert apart(lab, trajectory, limit, stiffness) < 3e-3


@pytest.mark.parametrize("limit", [5.0, 8.0, 9.0, 10.0, 11.0, 12.0, 15.0, 30.0])
def test_the_step_hardly_matters_at_the_motors_limit_either(limit: float, lab: Profile) -> None:
    """Half the step moves the end of trajectory 1 by 2.2 mm at most.

    Contacts and the integrator alone, by 0.4 mm.
    """
    section = lab.section("mujoco")
    ends = []
    for dt in (0.002, 0.001):
        plant = MujocoPlant(
            replace(section.parameters, timestep=dt), replace(section.drive, torque_limit=limit)
        )
        ends.append(plant.run(TRAJECTORIES["traj1"].commands(), State(), 0.05).xy[-1])
    assert math.dist(*ends) < 2.2e-3
