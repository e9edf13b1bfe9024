"""Plants that are driven by wheel rates have no lag of their own behind them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ssmr.models.four_wheel_plant import FOUR_WHEEL_DT
from ssmr.types import Commands, FloatArray, Plant, State
from validation.descriptions.loading import load_robot
from validation.experiment.sources import RECORDING_GRID
from validation.plants.profile import bare_profile
from validation.plants.table import plant_kind
from validation.simulator.calibration import Calibration
from validation.simulator.model import FREE_DRIVE
from validation.simulator.plant import MujocoPlant

FREQUENCY = 0.25
"""That of the speed [Hz]: slow against every lag."""


def speed(t: FloatArray) -> FloatArray:
    return np.asarray(0.5 + 0.2 * np.sin(2.0 * np.pi * FREQUENCY * t))


def lag_of(plant: Plant, radius: float) -> tuple[float, FloatArray]:
    """Lag of the way of a robot that drives straight on behind its wheels' [s].

    With it come its (M, 2) wheel rates from 4 s on.
    """
    n = 2000
    rates = speed((np.arange(n) + 0.5) * RECORDING_GRID) / radius
    start = State(v_x=0.5, wheel_left=0.5 / radius, wheel_right=0.5 / radius)
    commands = Commands(RECORDING_GRID, np.column_stack([rates, rates]), "wheels")
    driven = plant.run(commands, start, RECORDING_GRID)
    settled = driven.t > 3.99
    t = driven.t[settled]
    angular = 2.0 * np.pi * FREQUENCY
    columns = np.column_stack([np.sin(angular * t), -np.cos(angular * t), t, np.ones_like(t)])
    late, with_it, _, _ = np.linalg.lstsq(columns, driven.pose[settled, 0])[0]
    return -float(np.arctan2(late, with_it)) / angular, driven.wheels[settled]


@pytest.mark.parametrize("link", ["belt", "none"])
def test_mujoco_has_no_lag_behind_given_wheels(link: str) -> None:
    """Implicit damping explains 0.1 to 0.2 ms of what is left.

    That is half of a step or a step, over the feedback's time constant of 50, times the contact's
    9.5 ms.
    """
    pioneer = load_robot("pioneer3at")
    robot = replace(pioneer, link=link)  # type: ignore[arg-type]
    plant = MujocoPlant(Calibration.of(robot), FREE_DRIVE)
    lag, wheels = lag_of(plant, plant.calibration.wheel_radius)
    assert abs(lag) < 0.0003
    last_steps = np.arange(4.0, 20.0 + 1e-9, RECORDING_GRID)
    middles = last_steps - 0.5 * plant.dt  # the mean of a step is that of its middle
    told = speed(middles) / plant.calibration.wheel_radius
    assert np.abs(wheels - told[:, None])[:-1].max() < 0.003


@pytest.mark.parametrize("stiffness", [7.0, 20.0])
def test_four_tyres_lag_by_their_slip(stiffness: float) -> None:
    """A robot with acceleration a slips by a / (g C), so it has its wheels' speed v / (g C) later.

    The forces of a step are those of the rates before it, which adds half a step.
    """
    section = bare_profile(load_robot("husky")).section("four_wheel")
    grip = {"stiffness_x": stiffness, "stiffness_y": stiffness}
    parameters = replace(section.parameters, **grip, friction=5.0)  # so much that no brush slides
    plant = plant_kind("four_wheel").build(replace(section, parameters=parameters))
    lag, _ = lag_of(plant, parameters.wheel_radius)
    assert lag == pytest.approx(0.5 / (9.81 * stiffness) + 0.5 * FOUR_WHEEL_DT, abs=0.0002)


@pytest.mark.parametrize("name", ["kinematic", "improved", "linear"])
def test_planar_models_have_no_lag_behind_given_wheels(name: str) -> None:
    section = bare_profile(load_robot("husky")).section(name)
    lag, _ = lag_of(plant_kind(name).build(section), section.vehicle.wheel_radius)
    assert abs(lag) < 1e-5
