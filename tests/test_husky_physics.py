"""The MuJoCo Husky before any fit: what physics demands of it."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from ssmr.geometry import rotate_body_to_world
from ssmr.robot.drive import wheel_rates
from ssmr.robot.vehicle import Drive
from ssmr.scenarios import TRAJECTORIES
from ssmr.simulation import SAMPLE_DT
from ssmr.types import Commands, State
from tests.conftest import ROUNDOFF
from tests.robots import HUSKY, TRACK, WHEELBASE, husky
from validation.simulator.calibration import Calibration
from validation.simulator.description import WHEELS
from validation.simulator.health import DEVIATION_LIMIT, LIFT_SHARE, check_health
from validation.simulator.model import GRAVITY, robot_model
from validation.simulator.parts import robot_parts
from validation.simulator.physics import PhysicsSettings
from validation.simulator.plant import MujocoPlant

HALVING = 0.010
"""What halving the time step may move the end of a trajectory by [m]."""

MUJOCO_CONTACT = PhysicsSettings(solimp=(0.9, 0.95, 0.001, 0.5, 2.0))
"""MuJoCo's default impedance."""
IMU_AHEAD = HUSKY.imu[0]
STIFF = Drive(
    delay_v=0.0,
    delay_w=0.0,
    v_max=5.0,
    w_max=5.0,
    torque_limit=math.inf,
    command_half_track=0.5 * TRACK * 1.8,
)


@pytest.mark.parametrize("scenario", list(TRAJECTORIES))
def test_the_shipped_lab_profile_is_healthy_and_converged(scenario: str, lab: object) -> None:
    section = lab.plants["mujoco"]  # type: ignore[attr-defined]
    ends = []
    for factor in (1.0, 0.5):
        calibration = replace(section.parameters, timestep=factor * section.parameters.timestep)
        motion = MujocoPlant(calibration, section.drive).run(
            TRAJECTORIES[scenario].commands(), State(), SAMPLE_DT
        )
        assert check_health(motion.channels["wheel_load_N"])["ok"]
        ends.append(motion.xy[-1])
    assert np.hypot(*(ends[0] - ends[1])) <= HALVING


def settled(calibration: Calibration) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = robot_model(calibration)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=round(1.0 / model.opt.timestep))
    return model, data


def energy(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    mujoco.mj_energyPos(model, data)
    mujoco.mj_energyVel(model, data)
    return float(data.energy.sum())


@pytest.mark.parametrize("velocity", [(0.8, 0.0, 0.0), (0.5, 0.2, 1.0), (0.0, 0.0, -2.0)])
def test_undriven_energy_only_falls(velocity: tuple[float, float, float]) -> None:
    """No motor torque.

    Kinetic and potential energy, taken every 20 ms, never rise but by what the pressed tyres give
    back.
    """
    model, data = settled(husky(friction=0.5))
    model.actuator_gainprm[:, 0] = 0.0
    model.actuator_biasprm[:, 2] = 0.0
    wheel = wheel_rates(velocity[0], velocity[2], 0.5 * TRACK, 0.1651)
    data.qvel[:2] = velocity[:2]
    data.qvel[5] = velocity[2]
    data.qvel[6:10] = [wheel[w.endswith("right")] for w in WHEELS]
    # weight times half the depth of the tyres' impression: what contact can store [J]
    elastic = 0.5 * 73.3 * 9.81 * 0.003
    trace = []
    for _ in range(100):
        trace.append(energy(model, data))
        mujoco.mj_step(model, data, nstep=10)
    rises = np.maximum(np.diff(trace), 0.0)
    assert rises.sum() <= elastic
    assert trace[-1] < trace[0]


# ------------------------------------------------------------------------------- the model as
# compiled


@pytest.mark.parametrize(
    "calibration",
    [
        husky(),
        husky(
            mass=85.0, com_x=-0.05, com_y=0.02, yaw_inertia=5.0, wheel_radius=0.158, friction=0.3
        ),
        husky(half_track=0.275),
    ],
)
def test_the_compiled_model_has_the_calibrations_numbers(calibration: Calibration) -> None:
    model = robot_model(calibration)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    base = model.body("base").id
    assert model.body_subtreemass[base] == pytest.approx(calibration.mass, rel=ROUNDOFF)
    for wheel, sx, sy in zip(WHEELS, (1, 1, -1, -1), (1, -1, 1, -1), strict=True):
        assert np.allclose(
            model.body(wheel).pos[:2],
            [sx * WHEELBASE / 2, sy * calibration.half_track],
            atol=ROUNDOFF,
        )
    for geom in robot_parts(model).tires:
        assert model.geom_friction[geom, 0] == calibration.friction
        assert model.geom_condim[geom] == 3
        assert model.geom_priority[geom] == 1
    assert np.allclose(
        model.body_ipos[base], [calibration.com_x, calibration.com_y, calibration.com_z]
    )
    centred = robot_model(replace(calibration, com_x=0.0, com_y=0.0))
    mujoco.mj_forward(centred, again := mujoco.MjData(centred))
    full = np.zeros((centred.nv, centred.nv))
    mujoco.mj_fullM(centred, again, full)
    assert full[5, 5] == pytest.approx(calibration.yaw_inertia, rel=ROUNDOFF)


def test_seven_newton_metres_a_wheel_turn_the_robot_below_a_friction_of_0_353() -> None:
    """Four sliding contacts ask a side for r mu (m g / 2) wheelbase / hypot(track, wheelbase)."""
    limit = 2 * 7.0 / (0.1651 * 0.5 * 73.30 * 9.81 * WHEELBASE / math.hypot(TRACK, WHEELBASE))
    assert limit == pytest.approx(0.353, abs=0.0005)
    turn = Commands(0.05, np.tile([0.0, 0.6], (120, 1)))
    for friction, turns in ((0.99 * limit, True), (1.005 * limit, False)):
        motion = MujocoPlant(husky(friction=friction), replace(STIFF, torque_limit=7.0)).run(
            turn, State(), 0.05
        )
        assert (motion.yaw[-1] > 0.1) == turns


def test_imu_reads_gravity_at_rest_and_the_turn() -> None:
    plant = MujocoPlant(husky(), STIFF)
    assert np.allclose(plant.imu()[1], [0.0, 0.0, GRAVITY], atol=0.01)
    for _ in range(80):
        state = plant.step((0.0, 0.6), 0.05)
    gyro, force = plant.imu()
    assert gyro[2] == pytest.approx(state.yaw_rate, rel=ROUNDOFF)
    # 190 mm ahead of the middle
    assert force[0] == pytest.approx(-(state.yaw_rate**2) * IMU_AHEAD, rel=0.01)


def test_the_health_gate_tells_a_bad_run_and_what_to_change() -> None:
    plant = MujocoPlant(husky(friction=0.8, wheel_shape="cylinder"), STIFF, settings=MUJOCO_CONTACT)
    run = plant.run(Commands(0.05, np.tile([0.0, 0.6], (100, 1))), State(), 0.01)
    assert "soft contact" in check_health(run.channels["wheel_load_N"])["advice"]
    smooth = np.full((100, 4), 180.0)
    assert set(check_health(smooth).items()) >= {("ok", True), ("advice", "")}
    lifted = smooth.copy()
    lifted[50, 2] = 0.0
    assert check_health(lifted)["lowest_load_share"] < LIFT_SHARE
    assert "left the ground" in check_health(lifted)["advice"]
    rough = smooth * (1.0 + 1.5 * DEVIATION_LIMIT * np.sign(np.sin(np.arange(100.0))))[:, None]
    assert "not smooth" in check_health(rough)["advice"]


def test_the_forces_of_the_ground_move_the_robot_and_stay_within_friction() -> None:
    """Their sum over a weave is the change of momentum of the whole robot, in the world's axes.

    In the jolt of the start its body pitches, which moves the centre of mass besides.
    """
    calibration = husky(friction=0.6, rolling_resistance=0.0)
    plant = MujocoPlant(calibration, STIFF)
    twists = TRAJECTORIES["traj4"].commands()
    motion = plant.run(twists, State(), plant.dt)
    names = ("force_x_N", "force_y_N")
    of_wheels = np.stack([motion.channels[name] for name in names], axis=-1)  # (M, 4, 2)
    size = np.hypot(of_wheels[:, :, 0], of_wheels[:, :, 1])
    assert (size - 0.6 * motion.channels["wheel_load_N"]).max() < 1e-3 * GRAVITY * calibration.mass
    total = rotate_body_to_world(of_wheels.sum(axis=1), motion.yaw)
    velocity = motion.twist[:, :2] + motion.twist[:, 2:] * [-calibration.com_y, calibration.com_x]
    momentum = calibration.mass * rotate_body_to_world(velocity, motion.yaw)
    gained = plant.dt * np.cumsum(total[:-1], axis=0)
    error = gained - (momentum[1:] - momentum[0])
    calm = motion.t[1:] > 1.0
    assert np.abs(error[calm]).max() < 0.001 * np.abs(momentum).max()


def test_each_wheel_feels_the_ground_as_on_four_rigid_tyres() -> None:
    """On the spot friction is the same on all wheels, and opposes their slip (docs/physics.md)."""
    calibration = husky(friction=0.6, rolling_resistance=0.0)
    plant = MujocoPlant(calibration, STIFF)
    motion = plant.run(Commands(0.05, np.tile([0.0, 0.6], (100, 1))), State(), SAMPLE_DT)
    along, across = (motion.channels[name][-1] for name in ("force_x_N", "force_y_N"))
    diagonal = math.hypot(TRACK, WHEELBASE)
    most = 0.25 * 0.6 * calibration.mass * GRAVITY
    assert along / most == pytest.approx(np.array([-1, 1, -1, 1]) * WHEELBASE / diagonal, abs=0.02)
    assert across / most == pytest.approx(np.array([-1, -1, 1, 1]) * TRACK / diagonal, abs=0.02)
