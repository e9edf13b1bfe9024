"""Physics settings: what is set is what the compiled model has, and nothing else moves."""

from __future__ import annotations

import mujoco
import numpy as np

from ssmr.robot.vehicle import Drive
from ssmr.types import Commands, State
from tests.robots import husky
from validation.simulator.model import robot_model
from validation.simulator.parts import robot_parts
from validation.simulator.physics import SHIPPED, PhysicsSettings
from validation.simulator.plant import MujocoPlant

EVERYTHING = PhysicsSettings(
    cone="pyramidal", impratio=7.0, solimp=(0.5, 0.9, 0.002, 0.5, 2.0), solref=(0.03, 0.8),
    solver="PGS", iterations=9, integrator="Euler",
)  # fmt: skip


def test_everything_said_is_in_the_model_and_the_calibration_stays() -> None:
    calibration = husky(friction=0.4, mass=80.0)
    model = robot_model(calibration, settings=EVERYTHING)
    shipped = robot_model(calibration)
    tires = robot_parts(model).tires
    assert model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    assert model.opt.solver == mujoco.mjtSolver.mjSOL_PGS
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER
    assert (model.opt.impratio, model.opt.iterations) == (7.0, 9)
    for kind, rows in (("geom", tires), ("pair", range(model.npair))):
        assert np.allclose(getattr(model, f"{kind}_solimp")[list(rows)], EVERYTHING.solimp)
        assert np.allclose(getattr(model, f"{kind}_solref")[list(rows)], EVERYTHING.solref)
    for name in ("body_mass", "body_inertia", "geom_size", "actuator_gainprm", "dof_armature"):
        assert np.array_equal(getattr(model, name), getattr(shipped, name)), name


def test_prescribed_wheels_have_the_settings_too() -> None:
    """A recording's wheel rates drive another model than commands do."""
    commands = Commands(0.05, np.tile([-3.0, 3.0], (40, 1)), kind="wheels")
    ends = []
    for settings in (SHIPPED, PhysicsSettings(solver="PGS", iterations=1)):
        plant = MujocoPlant(husky(), Drive(), settings=settings)
        ends.append(plant.run(commands, State(), 0.05).yaw[-1])
    assert abs(ends[0] - ends[1]) > 0.005
