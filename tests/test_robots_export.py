"""Robots that leave the house: a URDF read back by MuJoCo, and an SDF model read by Drake, are the robot."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from validation import load_robot
from validation.robots import export_robot
from validation.simulator.calibration import Calibration
from validation.simulator.composing import contact_settings
from validation.simulator.description import WHEELS, Robot, shipped_robots
from validation.simulator.model import robot_model


def places(robot: Robot) -> np.ndarray[Any, Any]:
    """(4, 3) middles of the wheels in the base frame [m]."""
    g = robot.geometry
    signs = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    return np.column_stack([0.5 * signs * [g.wheelbase, g.track], np.full(4, g.axle_height)])


def read_back(robot: Robot) -> mujoco.MjModel:
    """The URDF of a robot as MuJoCo reads it."""
    text = export_robot(robot, "urdf")
    return mujoco.MjModel.from_xml_string(
        text.replace(">", '><mujoco><compiler fusestatic="false" discardvisual="true"/></mujoco>', 1)
    )


@pytest.mark.parametrize("name", shipped_robots())
def test_a_urdf_read_back_in_mujoco_is_the_robot(name: str) -> None:
    robot = load_robot(name)
    model = read_back(robot)
    assert model.body_mass.sum() == pytest.approx(robot.masses.total, rel=1e-6)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    middles = np.array([data.body(f"{wheel}_wheel_link").xpos for wheel in WHEELS])
    np.testing.assert_allclose(middles - data.body("base_link").xpos, places(robot), atol=1e-6)
    chassis = model.body("chassis_link")
    np.testing.assert_allclose(np.sort(chassis.inertia), np.sort(robot.masses.inertia), rtol=1e-6)
    np.testing.assert_allclose(chassis.ipos, robot.masses.com, atol=1e-6)


def test_an_mjcf_read_back_is_the_robot_that_is_simulated() -> None:
    robot = load_robot("jackal")
    model, own = mujoco.MjModel.from_xml_string(export_robot(robot, "mjcf")), robot_model(Calibration.of(robot))
    np.testing.assert_allclose(model.body_inertia[:6], own.body_inertia[:6], rtol=1e-5)
    tire, opt = model.geom("front_left_tire"), model.opt
    np.testing.assert_allclose(tire.solimp, contact_settings(robot)[1], rtol=1e-5)
    assert (opt.impratio, opt.timestep, opt.cone) == (100.0, own.opt.timestep, own.opt.cone)


@pytest.mark.parametrize("name", shipped_robots())
def test_an_sdf_read_by_drake_is_the_robot(name: str) -> None:
    multibody = pytest.importorskip("pydrake.multibody.plant", reason="Drake, of the extra engines, reads SDF")
    from pydrake.multibody.parsing import Parser
    from pydrake.systems.framework import DiagramBuilder

    robot, builder = load_robot(name), DiagramBuilder()
    plant, scene = multibody.AddMultibodyPlantSceneGraph(builder, 0.001)
    Parser(plant).AddModelsFromString(export_robot(robot, "sdf"), "sdf")
    plant.Finalize()
    context = plant.CreateDefaultContext()
    assert plant.CalcTotalMass(context) == pytest.approx(robot.masses.total, rel=1e-9)
    base = plant.GetBodyByName("base_link")
    height = plant.GetFreeBodyPose(context, base).translation()[2]
    assert height == pytest.approx(robot.geometry.base_height, abs=1e-12)
    spatial = base.default_spatial_inertia()
    np.testing.assert_allclose(spatial.get_com(), robot.masses.com, atol=1e-12)
    central = spatial.Shift(spatial.get_com()).CalcRotationalInertia().get_moments()
    np.testing.assert_allclose(central, robot.masses.inertia, rtol=1e-9)
    for wheel, place in zip(WHEELS, places(robot), strict=True):
        body = plant.GetBodyByName(f"{wheel}_wheel_link")
        found = plant.EvalBodyPoseInWorld(context, body).translation()
        np.testing.assert_allclose(found - [0.0, 0.0, height], place, atol=1e-12)
        (shape,) = plant.GetCollisionGeometriesForBody(body)
        properties = scene.model_inspector().GetProximityProperties(shape)
        friction = properties.GetProperty("material", "coulomb_friction")
        assert friction.dynamic_friction() == pytest.approx(robot.simulation.friction)
        joint = plant.GetJointByName(f"{wheel}_wheel_joint")
        assert tuple(joint.revolute_axis()) == (0.0, 1.0, 0.0)
        if np.isfinite(robot.drive.torque_limit):
            assert plant.GetJointActuatorByName(joint.name()).effort_limit() == pytest.approx(0.5 * robot.drive.torque_limit)
