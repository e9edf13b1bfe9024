"""Robots for others: URDF and MJCF in MuJoCo, SDF in Drake, numbers of ros2_control and nav2."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from ruamel.yaml import YAML

from ssmr.robot.drive import wheel_references
from ssmr.scenarios import TRAJECTORIES
from ssmr.types import Commands, State
from validation import load_robot
from validation.descriptions.importing import import_robot
from validation.plants.profile import bare_profile, load_profile, make_plant, shipped_profiles
from validation.robots import export_robot
from validation.simulator.checking import spot_turn
from validation.simulator.description import WHEELS, Robot, shipped_robots
from validation.simulator.exporting import SETTLING, mjcf_text
from validation.simulator.motors import set_motors
from validation.simulator.plant import MujocoPlant

SIDE_SIGNS = ((-1.0, "left"), (1.0, "right"))


def places(robot: Robot) -> np.ndarray[Any, Any]:
    """(4, 3) middles of the wheels in the base frame [m]."""
    signs = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    return np.column_stack(
        [0.5 * signs * [robot.wheelbase, robot.track], np.full(4, robot.axle_height)]
    )


def read_back(robot: Robot) -> mujoco.MjModel:
    """The URDF of a robot as MuJoCo reads it."""
    text = export_robot(robot, "urdf")
    return mujoco.MjModel.from_xml_string(
        text.replace(
            ">", '><mujoco><compiler fusestatic="false" discardvisual="true"/></mujoco>', 1
        )
    )


@pytest.mark.parametrize("name", shipped_robots())
def test_a_urdf_read_back_in_mujoco_is_the_robot(name: str) -> None:
    robot = load_robot(name)
    model = read_back(robot)
    assert model.body_mass.sum() == pytest.approx(robot.mass, rel=1e-6)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    middles = np.array([data.body(f"{wheel}_wheel_link").xpos for wheel in WHEELS])
    np.testing.assert_allclose(middles - data.body("base_link").xpos, places(robot), atol=1e-6)
    chassis = model.body("chassis_link")
    np.testing.assert_allclose(np.sort(chassis.inertia), np.sort(robot.inertia), rtol=1e-6)
    np.testing.assert_allclose(chassis.ipos, robot.com, atol=1e-6)


def in_plain_mujoco(
    text: str,
    start: np.ndarray[Any, Any],
    references: np.ndarray[Any, Any],
    step: float | None = None,
) -> np.ndarray[Any, Any]:
    """(N + 1, 3) x, y, yaw of an MJCF's robot under (N, 2) wheel rates from a whole state on.

    Its steps are the file's unless another is given [s].
    """
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep = step or model.opt.timestep
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    right = ["right" in model.actuator(k).name for k in range(model.nu)]
    poses = []
    for pair in [*references, references[-1]]:
        w, x, y, z = data.qpos[3:7]
        poses.append(
            [*data.qpos[:2], np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))]
        )
        data.ctrl[:] = np.where(right, pair[1], pair[0])
        mujoco.mj_step(model, data)
    return np.array(poses)


CALIBRATED = ("thesis-lab", "husky-tile", "thesis-printed", "pioneer3at", "warthog-grass")


@pytest.mark.parametrize(
    ("name", "limit"),
    [
        # limits are shared out, and in the slow tests each robot has both
        pytest.param(name, limit, marks=[pytest.mark.slow] * ((i + k) % 2))
        for i, name in enumerate(CALIBRATED)
        for k, limit in enumerate((None, 10.0))
    ],
)
def test_a_calibrated_mjcf_is_the_plant_in_plain_mujoco(name: str, limit: float | None) -> None:
    """To a hundredth of a millimetre, with slips that settle as the file's; these move it by 0.1.

    Also with tyres that grip better along than across, and with motors at their limit.
    """
    given = name in shipped_profiles()
    profile = load_profile(name) if given else bare_profile(load_robot(name))
    section = profile.section("mujoco")
    drive = section.drive if limit is None else replace(section.drive, torque_limit=limit)
    plant = MujocoPlant(section.parameters, drive)
    commands = TRAJECTORIES["traj4"].commands()
    references = wheel_references(commands, drive, plant.dt, State())
    measured = in_plain_mujoco(
        mjcf_text(section.parameters, drive), plant.placed(State()), references
    )
    own = plant.run(commands, State(), plant.dt)
    np.testing.assert_allclose(measured[:, :2], own.xy, atol=1e-4)
    set_motors(plant.model, section.parameters, drive, settling=SETTLING)
    same = plant.run(commands, State(), plant.dt)
    np.testing.assert_allclose(measured[:, :2], same.xy, atol=1e-5)
    np.testing.assert_allclose(np.unwrap(measured[:, 2]), same.yaw, atol=1e-5)


@pytest.mark.parametrize(
    ("written", "name"),
    [
        # robots are shared out, and in the slow tests each has all steps
        pytest.param(written, name, marks=[pytest.mark.slow] * ((i - k) % 4 > 0))
        for i, written in enumerate((None, 0.0005, 0.001, 0.0025, 0.005))
        for k, name in enumerate(("thesis-lab", "husky-tile", "husky", "jackal"))
    ],
)
def test_an_mjcf_holds_up_to_the_step_that_it_says(name: str, written: float | None) -> None:
    """To 5 mm at the end of trajectory 4, from the plant at its own step.

    The plant's path itself moves by up to 2.7 mm from 2 ms to 5 ms.
    """
    profile = load_profile(name) if name in shipped_profiles() else bare_profile(load_robot(name))
    section = profile.section("mujoco")
    plant = make_plant(profile, "mujoco")
    assert isinstance(plant, MujocoPlant)
    commands = TRAJECTORIES["traj4"].commands()
    wanted = plant.run(commands, State(), plant.dt).xy[-1]
    text = export_robot(profile.robot, "mjcf", profile, timestep=written)
    found = re.search(r"step of (\S+) ms; it will do for any up to (\S+) ms", text)
    assert found is not None
    assert float(found[1]) == pytest.approx(1e3 * (written or plant.dt))
    longest = 1e-3 * float(found[2])
    for step in (0.001, 0.0025, 0.005, longest):
        if step <= longest:
            # of instants between commands and steps, for the longest is no part of a period
            fine = wheel_references(commands, section.drive, 1e-5, State())
            references = fine[:: round(step / 1e-5)]
            end = in_plain_mujoco(text, plant.placed(State()), references, step)[-1, :2]
            assert np.hypot(*(end - wanted)) < 0.005, step


def test_only_an_mjcf_has_a_step() -> None:
    with pytest.raises(ValueError, match="timestep: sdf has no place for it"):
        export_robot("husky", "sdf", timestep=0.002)
    with pytest.raises(ValueError, match="timestep"):
        export_robot("husky", "mjcf", timestep=0.0)


SCHEMA = {
    **dict.fromkeys(("left_wheel_names", "right_wheel_names"), list),
    **dict.fromkeys(("wheel_separation", "wheel_radius", "wheel_separation_multiplier"), float),
    **dict.fromkeys(("left_wheel_radius_multiplier", "right_wheel_radius_multiplier"), float),
    **dict.fromkeys(
        [
            f"{axis}.{end}_{what}"
            for axis in ("linear.x", "angular.z")
            for end in ("min", "max")
            for what in ("velocity", "acceleration", "jerk")
        ],
        float,
    ),
    **dict.fromkeys(
        [
            f"{axis}.has_{what}_limits"
            for axis in ("linear.x", "angular.z")
            for what in ("velocity", "acceleration")
        ],
        bool,
    ),
    "cmd_vel_timeout": float,
    **dict.fromkeys(("pose_covariance_diagonal", "twist_covariance_diagonal"), list),
}
"""Names and types of parameters of ros2_control's diff_drive_controller, as its
`diff_drive_controller/src/diff_drive_controller_parameter.yaml` declares them (ros2_controllers,
commit 0193629): string_array, double, bool. Others that it has are not written here."""


def of_controller(text: str) -> dict[str, Any]:
    """Return the parameters of a file for ros2_control, checked against its own schema."""
    document = YAML(typ="safe").load(text)
    parameters: dict[str, Any] = document["diff_drive_controller"]["ros__parameters"]
    for name, value in parameters.items():
        # ROS refuses whole numbers where it wants others
        assert type(value) is SCHEMA[name], (name, value)
    for side in ("left", "right"):
        joints = parameters[f"{side}_wheel_names"]
        assert len(joints) == 2
        assert all(isinstance(joint, str) for joint in joints)
    return parameters


def test_ros2_control_has_the_joints_of_the_users_urdf(tmp_path: Path) -> None:
    """Also by way of the robot's own file; and one that we write has the joints that it says."""
    text = export_robot("husky", "urdf")
    for wheel, joint in {"front_left": "fl: #1", "rear_right": "hinten'rechts"}.items():
        text = text.replace(f"{wheel}_wheel_joint", joint)
    urdf = tmp_path / "mine.urdf"
    urdf.write_text(text.replace('name="husky"', 'name="mine"'))
    draft = import_robot(urdf)
    (tmp_path / "mine.toml").write_text(draft.text)
    for robot in (urdf, tmp_path / "mine.toml", draft.robot):
        parameters = of_controller(export_robot(robot, "diff-drive"))
        assert parameters["left_wheel_names"] == ["fl: #1", "rear_left_wheel_joint"]
        assert parameters["right_wheel_names"] == ["front_right_wheel_joint", "hinten'rechts"]
    for to in ("urdf", "sdf"):
        assert 'name="fl: #1"' in export_robot(draft.robot, to)
    with pytest.raises(ValueError, match="must be four different names"):
        replace(draft.robot, joints="a, b, c")


def test_ros2_control_has_the_limits_of_the_driver() -> None:
    parameters = of_controller(export_robot("jackal", "diff-drive"))
    drive = load_robot("jackal").drive
    for axis, most in (("linear.x", drive.v_max), ("angular.z", drive.w_max)):
        assert parameters[f"{axis}.has_velocity_limits"] is True
        assert parameters[f"{axis}.max_velocity"] == most
        assert parameters[f"{axis}.min_velocity"] == -most


def test_ros2_control_has_what_a_profile_knows_of_the_driver_and_of_odometry() -> None:
    """A filter that sums up its twists for a second is as uncertain as the band says."""
    profile = load_profile("warthog-grass")
    section = profile.section("kinematic")
    n = of_controller(export_robot("warthog", "diff-drive", profile))
    for axis, most in (
        ("linear.x", section.drive.acceleration_v),
        ("angular.z", section.drive.acceleration_w),
    ):
        assert n[f"{axis}.has_acceleration_limits"] is True
        assert n[f"{axis}.max_acceleration"] == pytest.approx(most)
        assert n[f"{axis}.min_acceleration"] == pytest.approx(-most)
    # a command or two that come late do not stop it
    assert n["cmd_vel_timeout"] > 2.0 * section.drive.hold
    pace = profile.fitted_at
    assert pace is not None
    rate = pace.lateral_acceleration / pace.speed
    steps = 50
    path = np.zeros((steps + 1, 3))
    path[:, 0] = pace.speed * np.linspace(0.0, 1.0, steps + 1)
    band = replace(section.bands["wheels"], position_noise=1e-6, yaw_noise=1e-6)
    (walked,) = band.covariance(path, [0], [steps])
    twist = n["twist_covariance_diagonal"]
    # steps of 1/50 s that err independently
    assert twist[0] * steps / 50.0**2 == pytest.approx(walked[0, 0], rel=1e-3)
    turned = band.turn_walk**2 * rate + (band.turn_scale * rate) ** 2
    assert 0.3 * turned < twist[5] * steps / 50.0**2 <= turned
    assert n["pose_covariance_diagonal"][0] > walked[0, 0]


def test_a_multiplier_by_mechanics_has_its_doubt() -> None:
    """Those of calibrated robots lie within two of it."""
    for name, profile in (("husky", "husky-tile"), ("warthog", "warthog-grass")):
        text = export_robot(name, "diff-drive")
        line = next(row for row in text.splitlines() if "wheel_separation_multiplier: " in row)
        value, _, error = line.partition(": ")[2].partition("  # standard error ")
        p = load_profile(profile).section("kinematic").parameters
        measured = (p.y_l - p.y_r) / load_robot(name).track
        assert abs(measured - float(value)) < 2.0 * float(error) < 0.5 * float(value)


@pytest.mark.parametrize("name", shipped_robots())
def test_ros2_control_turns_a_robot_as_it_is_told(name: str) -> None:
    """diff_drive_controller's rates for a turn on the spot turn the robot at that rate."""
    robot = load_robot(name)
    numbers = of_controller(export_robot(robot, "diff-drive"))
    assert "front_right_wheel_joint" in numbers["right_wheel_names"]
    rate = 0.2
    rim = 0.5 * rate * numbers["wheel_separation"] * numbers["wheel_separation_multiplier"]
    wheels = rim / (numbers["wheel_radius"] * numbers["left_wheel_radius_multiplier"])
    spot = spot_turn(robot)
    assert spot is not None
    assert spot.yaw_rate * wheels * robot.wheel_radius == pytest.approx(rate, rel=1e-5)


def test_ros2_control_has_a_profiles_radii_and_separation() -> None:
    """Straight and turning by the kinematic plant, for rates of diff_drive_controller."""
    profile = load_profile("husky-tile")
    section = profile.section("kinematic")
    n = of_controller(export_robot("husky", "diff-drive", profile))
    v = 0.4
    w = 0.3
    half = 0.5 * n["wheel_separation"] * n["wheel_separation_multiplier"] * w
    rates = [
        (v + sign * half) / (n["wheel_radius"] * n[f"{side}_wheel_radius_multiplier"])
        for sign, side in SIDE_SIGNS
    ]
    end = (
        make_plant(profile, "kinematic")
        .run(Commands(0.1, np.tile(rates, (40, 1)), kind="wheels"), State(), 0.1)
        .twist[-1]
    )
    off_middle = 0.5 * (section.parameters.y_l + section.parameters.y_r) * w
    assert end[2] == pytest.approx(w, rel=1e-6)
    assert end[0] == pytest.approx(v + off_middle, rel=1e-6)


NAV2 = {
    "controller_server": {
        f"FollowPath.{name}": float
        for name in (
            *("vx_max", "vx_min", "wz_max", "ax_max", "ax_min", "az_max"),
            *("model_delay_vx", "model_delay_wz"),
        )
    },
    "velocity_smoother": dict.fromkeys(
        ("max_velocity", "min_velocity", "max_accel", "max_decel"), list
    ),
    "local_costmap": {"footprint": str},
    "global_costmap": {"footprint": str},
}
"""Names and types of parameters of nav2, as its sources declare them: `nav2_mppi_controller`
(optimizer.cpp, getParam of floats), `nav2_velocity_smoother` (velocity_smoother.cpp, vectors of
doubles), `nav2_costmap_2d` (costmap_2d_ros.cpp, a string); navigation2 a3a9704, 2026-08-21."""


def of_nav2(text: str) -> dict[str, Any]:
    """Return nav2's parameters by node and name, checked against its own declarations."""
    assert "&" not in text
    assert "*," not in text
    found: dict[str, Any] = {}
    for node, document in YAML(typ="safe").load(text).items():
        inner = document.get(node, document)["ros__parameters"]
        for name, value in inner.pop("FollowPath", {}).items():
            inner[f"FollowPath.{name}"] = value
        for name, value in inner.items():
            assert type(value) is NAV2[node][name], (node, name, value)
            if isinstance(value, list):
                assert [type(part) for part in value] == [float] * 3
        found |= inner
    return found


NAV2_ROBOTS = [*((robot, None) for robot in shipped_robots())] + [
    (load_profile(name).robot.name, name) for name in shipped_profiles()
]


@pytest.mark.parametrize(("name", "profile"), NAV2_ROBOTS)
def test_nav2_has_the_limits_the_dead_times_and_the_hull_of_a_profile(
    name: str, profile: str | None
) -> None:
    """The file has the numbers of the kinematic plant, which moves as the model in nav2's MPPI."""
    robot = load_robot(name)
    n = of_nav2(export_robot(robot, "nav2", profile))
    known = bare_profile(robot) if profile is None else load_profile(profile)
    drive = known.section("kinematic").drive
    late = drive.wheel_lag + 0.5 * drive.command_ramp
    mppi = {
        "vx_max": drive.v_max,
        "vx_min": -drive.v_max,
        "wz_max": drive.w_max,
        "ax_max": drive.acceleration_v,
        "ax_min": -drive.acceleration_v,
        "az_max": drive.acceleration_w,
        "model_delay_vx": drive.delay_v + late,
        "model_delay_wz": drive.delay_w + late,
    }
    finite = {f"FollowPath.{key}": value for key, value in mppi.items() if np.isfinite(value)}
    assert {key: n[key] for key in n if "." in key} == pytest.approx(finite, rel=1e-6)
    for upper, lower, v, w in (
        ("max_velocity", "min_velocity", drive.v_max, drive.w_max),
        ("max_accel", "max_decel", drive.acceleration_v, drive.acceleration_w),
    ):
        assert (upper in n) == (lower in n) == bool(np.isfinite(v + w))
        if upper in n:
            assert n[upper] == pytest.approx([v, 0.0, w], rel=1e-6)
            np.testing.assert_array_equal(n[lower], -np.array(n[upper]))
    # the polygon holds every wheel, and the base, and goes round once
    corners = np.array(json.loads(n["footprint"]))
    assert np.all(np.abs(places(robot)[:, :2]).max(axis=0) < corners.max(axis=0))
    assert np.all(corners.min(axis=0) < 0.0)
    sizes = np.abs(corners - np.roll(corners, 1, axis=0))
    np.testing.assert_allclose(sizes.sum(axis=0), 2.0 * np.ptp(corners, axis=0))
    assert np.all(np.count_nonzero(sizes, axis=1) == 1)


def test_beside_each_number_of_nav2_stands_how_sure_it_is(tmp_path: Path) -> None:
    """Errors are the profile's, of what was fitted; the others have the grade of their source."""
    profile = load_profile("husky-tile")
    known = {"delay": 0.0123, "acceleration_v": 0.234, "acceleration_w": 0.0345}
    origin = {**profile.provenance["kinematic"], "standard_errors": known}
    mine = replace(profile, provenance={**profile.provenance, "kinematic": origin})
    rows = {}
    for text in (export_robot("husky", "nav2", mine.save(tmp_path / "mine.toml"))).splitlines():
        name, _, rest = text.strip().partition(": ")
        rows[name] = rest.partition("  # ")[2]
    assert rows["ax_max"] == rows["ax_min"] == "acceleration_v: standard error 0.23"
    assert "acceleration_w: standard error 0.035" in rows["max_accel"]
    assert "delay_v: standard error 0.012" in rows["model_delay_vx"]
    assert "wheel_lag: of the profile" in rows["model_delay_wz"]
    assert rows["wz_max"] == "w_max: published"
    (tmp_path / "broken.toml").write_text(
        (tmp_path / "mine.toml").read_text().replace("[provenance.kinematic", "[provenance.other")
    )
    assert "standard error" not in export_robot("husky", "nav2", tmp_path / "broken.toml")
    with pytest.raises(ValueError, match="timestep: nav2 has no place for it"):
        export_robot("husky", "nav2", timestep=0.002)


@pytest.mark.parametrize("name", shipped_robots())
def test_an_sdf_read_by_drake_is_the_robot(name: str) -> None:
    multibody = pytest.importorskip(
        "pydrake.multibody.plant", reason="Drake, of the extra engines, reads SDF"
    )
    from pydrake.multibody.parsing import Parser
    from pydrake.systems.framework import DiagramBuilder

    robot = load_robot(name)
    builder = DiagramBuilder()
    plant, scene = multibody.AddMultibodyPlantSceneGraph(builder, 0.001)
    Parser(plant).AddModelsFromString(export_robot(robot, "sdf"), "sdf")
    plant.Finalize()
    context = plant.CreateDefaultContext()
    assert plant.CalcTotalMass(context) == pytest.approx(robot.mass, rel=1e-9)
    base = plant.GetBodyByName("base_link")
    height = plant.GetFreeBodyPose(context, base).translation()[2]
    assert height == pytest.approx(robot.base_height, abs=1e-12)
    spatial = base.default_spatial_inertia()
    np.testing.assert_allclose(spatial.get_com(), robot.com, atol=1e-12)
    central = spatial.Shift(spatial.get_com()).CalcRotationalInertia().get_moments()
    np.testing.assert_allclose(central, robot.inertia, rtol=1e-9)
    for wheel, place in zip(WHEELS, places(robot), strict=True):
        body = plant.GetBodyByName(f"{wheel}_wheel_link")
        measured = plant.EvalBodyPoseInWorld(context, body).translation()
        np.testing.assert_allclose(measured - [0.0, 0.0, height], place, atol=1e-12)
        (shape,) = plant.GetCollisionGeometriesForBody(body)
        properties = scene.model_inspector().GetProximityProperties(shape)
        friction = properties.GetProperty("material", "coulomb_friction")
        assert friction.dynamic_friction() == pytest.approx(robot.friction)
        joint = plant.GetJointByName(f"{wheel}_wheel_joint")
        assert tuple(joint.revolute_axis()) == (0.0, 1.0, 0.0)
        if np.isfinite(robot.drive.torque_limit):
            assert plant.GetJointActuatorByName(joint.name()).effort_limit() == pytest.approx(
                0.5 * robot.drive.torque_limit
            )
