"""What makes a step of MuJoCo quick leaves the motion as it was."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from mujoco import rollout

from ssmr.geometry import compose_poses
from ssmr.robot.drive import wheel_references
from ssmr.robot.vehicle import Drive
from ssmr.scenarios import TRAJECTORIES
from ssmr.simulation import SAMPLE_DT
from ssmr.types import State
from tests.robots import HUSKY, SAME_LOADS, SAME_PATH, former_model, husky
from validation import load_robot
from validation.plants.kind import PlantProfile
from validation.plants.profile import bare_profile, load_profile, shipped_profiles
from validation.simulator.calibration import Calibration
from validation.simulator.description import SCHEMA, Robot, parse_robot, shipped_robots
from validation.simulator.motors import actuator_inputs
from validation.simulator.physics import SHIPPED, SOLVING, PhysicsSettings, Solver, _solver_for
from validation.simulator.plant import MujocoPlant

NEWTON = PhysicsSettings(solver="Newton")
SENSED = 1e-4
"""Of the yaw acceleration, relative: MuJoCo's own sensor does not know of the servos' damping,
which is integrated implicitly; the channel is the change of the yaw rate over the step."""


def same_motion(calibration: Calibration, drive: Drive, scenario: str) -> str:
    """Drive with both solvers, compare paths and loads, and return the shipped solver."""
    commands = TRAJECTORIES[scenario].commands()
    plant = MujocoPlant(calibration, drive)
    now, then = (
        p.run(commands, State(), SAMPLE_DT)
        for p in (plant, MujocoPlant(calibration, drive, settings=NEWTON))
    )
    loads, former = (motion.channels["wheel_load_N"] for motion in (now, then))
    assert np.hypot(*(now.xy - then.xy).T).max() <= SAME_PATH
    assert (np.sqrt(np.mean((loads - former) ** 2, axis=0)) <= SAME_LOADS * former[0]).all()
    return mujoco.mjtSolver(plant.model.opt.solver).name.removeprefix("mjSOL_")


@pytest.mark.parametrize("scenario", ["traj1", "traj4"])
@pytest.mark.parametrize("name", [name for name in shipped_profiles() if name != "thesis-printed"])
def test_profiles_drive_the_same_paths_with_either_solver(name: str, scenario: str) -> None:
    section = load_profile(name).plants["mujoco"]
    assert same_motion(section.parameters, section.drive, scenario) == "CG"


def sized(mass: float) -> Robot:
    """Return a robot of a Husky's proportions and another mass [kg]."""
    scale = (mass / HUSKY.mass) ** (1.0 / 3.0)
    names = ("wheelbase", "track", "wheel_radius", "wheel_width")
    geometry = {name: scale * getattr(HUSKY, name) for name in names}
    masses = {
        "total": mass,
        "wheel_inertia": [scale**5 * inertia for inertia in HUSKY.wheel_inertia],
    }
    return parse_robot({"schema": SCHEMA, "name": "sized", "geometry": geometry, "mass": masses})


@pytest.mark.parametrize("scenario", ["traj2", "traj4"])
@pytest.mark.parametrize(
    "robot",
    [sized(8.0), sized(800.0), *map(load_robot, shipped_robots())],
    ids=["8 kg", "800 kg", *shipped_robots()],
)
def test_robots_of_any_size_drive_the_same_paths_with_either_solver(
    robot: Robot, scenario: str
) -> None:
    """MuJoCo's tolerance is relative to the robot's inertia, so one tolerance does for all."""
    section = bare_profile(robot).plants["mujoco"]
    assert same_motion(replace(section.parameters, friction=0.6), section.drive, scenario) == "CG"


@pytest.mark.parametrize("frame", [(0.0, 0.0, 0.0), (-30.0, 5.0, 3.0)])
def test_left_and_right_are_alike_in_any_frame_within_a_solvers_tolerance(
    frame: tuple[float, float, float],
) -> None:
    """The laws of tests/test_plant_conformance.py for the shipped solver, over a trajectory."""
    section = load_profile("husky-tile").plants["mujoco"]
    centred = replace(section.parameters, com_y=0.0, radius_difference=0.0)
    plant = MujocoPlant(centred, section.drive)
    commands = TRAJECTORIES["traj4"].commands()
    mirrored = replace(commands, values=commands.values * [1.0, -1.0])
    one = plant.run(commands, State(), SAMPLE_DT)
    other = plant.run(mirrored, State(*frame), SAMPLE_DT)
    there = compose_poses(np.array(frame), one.pose * [1.0, -1.0, -1.0])
    assert np.hypot(*(there - other.pose)[:, :2].T).max() <= 2.0 * SAME_PATH


def test_newtons_method_is_taken_where_conjugate_gradients_converge_badly() -> None:
    """The printed numbers have a twentieth of the friction across the wheels.

    Other physics may be as stiff as it likes.
    """
    printed = load_profile("thesis-printed").plants["mujoco"]
    plants = [
        MujocoPlant(printed.parameters, printed.drive, settings=s)
        for s in (SHIPPED, PhysicsSettings(solver="CG"))
    ]
    assert [mujoco.mjtSolver(plant.model.opt.solver).name for plant in plants] == [
        "mjSOL_NEWTON",
        "mjSOL_CG",
    ]
    exact, far = (
        plant.run(TRAJECTORIES["traj4"].commands(), State(), SAMPLE_DT).xy for plant in plants
    )
    assert np.hypot(*(exact - far).T).max() > 0.4 * SAME_PATH
    assert _solver_for(SHIPPED, 1.0) == "CG"
    assert _solver_for(PhysicsSettings(impratio=1.0), 1.0) == "Newton"


@pytest.mark.parametrize("solver", list(SOLVING))
def test_a_solver_that_is_asked_for_has_its_own_tolerance(solver: Solver) -> None:
    option = MujocoPlant(husky(), Drive(), settings=PhysicsSettings(solver=solver)).model.opt
    assert (option.tolerance, option.iterations) == SOLVING[solver]
    few = MujocoPlant(
        husky(), Drive(), settings=PhysicsSettings(solver=solver, iterations=7)
    ).model.opt
    assert few.iterations == 7


@pytest.fixture(scope="module")
def lab_section() -> PlantProfile:
    return load_profile("thesis-lab").plants["mujoco"]


def test_the_yaw_acceleration_is_that_of_mujocos_sensor(lab_section: PlantProfile) -> None:
    plant = MujocoPlant(lab_section.parameters, lab_section.drive, settings=NEWTON)
    full = former_model(lab_section)
    commands = TRAJECTORIES["traj1"].commands()
    steps = wheel_references(commands, lab_section.drive, plant.dt, State())
    _, sensors = rollout.rollout(
        full, mujoco.MjData(full), plant.placed(State())[None], actuator_inputs(full, steps)[None]
    )
    sensed = sensors[0][
        :: round(SAMPLE_DT / plant.dt), full.sensor("angular_acceleration").adr[0] + 2
    ]
    motion = plant.run(commands, State(), SAMPLE_DT).channels["yaw_acceleration_rad_s2"]
    assert np.abs(motion[: len(sensed)] - sensed).max() <= SENSED * np.abs(sensed).max()


def test_the_imu_is_mujocos_own_and_reading_it_changes_nothing(lab_section: PlantProfile) -> None:
    read, unread = (MujocoPlant(lab_section.parameters, lab_section.drive) for _ in range(2))
    full = former_model(lab_section)
    state = np.empty(mujoco.mj_stateSize(full, mujoco.mjtState.mjSTATE_INTEGRATION))
    data = mujoco.MjData(full)
    for k in range(40):
        command = (0.5, 0.3 * math.sin(0.2 * k))
        assert read.step(command, 0.05) == unread.step(command, 0.05)
        mujoco.mj_getState(
            read.model, read._bodies.data_of(0), state, mujoco.mjtState.mjSTATE_INTEGRATION
        )
        mujoco.mj_setState(full, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_forward(full, data)
        gyro, force = read.imu()
        assert gyro == pytest.approx(data.sensor("imu_gyro").data, abs=1e-12)
        # two solvers' accelerations
        assert force == pytest.approx(data.sensor("imu_accelerometer").data, abs=1e-3)
