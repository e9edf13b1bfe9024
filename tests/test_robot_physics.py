"""What physics demands of any robot, shipped or drawn at random; tests/test_husky_physics.py has the Husky's own."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from ssmr.robot.vehicle import Drive
from ssmr.scenarios import TRAJECTORIES
from ssmr.types import Commands, FloatArray, State
from tests.robots import HUSKY, documents, scaled
from validation.plants.profile import load_profile
from validation.simulator.calibration import Calibration
from validation.simulator.description import parse_robot
from validation.simulator.physics import PhysicsSettings
from validation.simulator.plant import MujocoPlant

SIMILAR = 1e-7
"""Of similar motions, over their size: rounding, where the solver does not stop before it must."""

DRAWN = settings(derandomize=True, deadline=None, phases=[Phase.explicit, Phase.generate])
"""The same robots are drawn in each run. One that fails is shown as it was drawn: each try to simplify it costs a second."""

DRIVES: dict[str, dict[str, float]] = {
    "proportional": {
        "torque_limit": math.inf, "delay_v": 0.2, "delay_w": 0.1, "hold": 0.05, "v_max": 1.0, "w_max": 2.0,
        "acceleration_v": 2.0, "acceleration_w": 5.0, "wheel_lag": 0.02, "command_radius": 0.165,
    },
    "integral": {
        "torque_limit": 60.0, "no_load_rate": 30.0, "gear_loss": 2.0, "integral_gain": 800.0, "dc_stiffness": 1900.0,
        "delay_v": 0.0, "delay_w": 0.0, "hold": 0.05, "command_ramp": 0.05, "command_radius": 0.165,
    },
}  # fmt: skip
"""Drives of a robot of the Husky's size."""


def motion(document: dict[str, Any], drive: dict[str, float], length: float, mass: float, given_rates: bool) -> FloatArray:
    """Drive a robot of the Husky's size, enlarged `length` times in space and root `length` times in time.

    Returns:
        (M, 10) place over wheel radius, yaw, wheel rates times the unit of time, loads over a quarter of the weight, and
        torques over weight and wheel radius.
    """
    time, torque = math.sqrt(length), mass * length
    factors = {
        "v_max": time, "w_max": 1.0 / time, "acceleration_v": 1.0, "acceleration_w": 1.0 / length,
        "command_half_track": length, "command_radius": length, "torque_limit": torque, "no_load_rate": 1.0 / time,
        "gear_loss": torque, "integral_gain": torque, "dc_stiffness": torque * time,
    }  # fmt: skip
    robot = parse_robot(scaled(document, length, mass))
    calibration = Calibration.of(robot, timestep=0.002 * time, rolling_resistance=0.02, radius_difference=0.001 * length)
    plant = MujocoPlant(
        calibration,
        Drive(**{name: value * factors.get(name, time) for name, value in drive.items()}),
        settings=PhysicsSettings(solver="Newton"),
    )
    for model in (plant.model, plant._prescribed):
        model.opt.tolerance = 0.0
    twists = TRAJECTORIES["traj4"].commands().values[:120]
    commands = Commands(0.05 * time, twists * [time, 1.0 / time])
    if given_rates:
        commands = Commands(0.05 * time, 4.0 / time * np.column_stack([twists[:, 0], twists[:, 0] + twists[:, 1]]), "wheels")
    found = plant.run(commands, State(), 0.05 * time)
    radius, weight = robot.geometry.wheel_radius, calibration.mass * 9.81
    return np.column_stack(
        [
            found.xy / radius,
            found.yaw,
            found.wheels * math.sqrt(radius),
            found.channels["wheel_load_N"] / (0.25 * weight),
            found.channels["torque_N_m"].sum(axis=1) / (weight * radius),
        ]
    )


@settings(DRAWN, max_examples=8)
@given(documents(), st.sampled_from(list(DRIVES)), st.floats(0.25, 4.0), st.floats(0.1, 10.0), st.booleans())
def test_similar_robots_move_alike(
    document: dict[str, Any], kind: str, length: float, mass: float, given_rates: bool
) -> None:
    """Froude's similarity: lengths grow by a factor, times by its root, masses by any factor.

    Where a number of one robot's size stood in the composed model, the contacts or the motors, these would part.
    """
    document = scaled(document, 0.1651 / document["geometry"]["wheel_radius"], 73.3 / document["mass"]["total"])
    drive = {**DRIVES[kind], "command_half_track": 0.6 * document["geometry"]["track"]}
    one, other = (motion(document, drive, *factors, given_rates) for factors in ((1.0, 1.0), (length, mass)))
    size = np.maximum(np.abs(one).max(axis=0), 1.0)  # wheels that turn at given rates take great torques
    assert np.abs((one - other) / size).max() < SIMILAR
    assert np.hypot(*one[-1, :2]) > 1.0


@pytest.mark.parametrize("profile", ["thesis-lab", "husky-tile"])
def test_the_composed_husky_is_the_hand_made_one(profile: str) -> None:
    """Without models/husky.xml, the Husky's numbers alone make the same robot."""
    section = load_profile(profile).plants["mujoco"]
    composed = replace(section.parameters, robot=replace(HUSKY, mjcf=""))
    commands = TRAJECTORIES["traj4"].commands()
    one, other = (MujocoPlant(c, section.drive).run(commands, State(), 0.05) for c in (section.parameters, composed))
    assert np.array_equal(one.pose, other.pose)
    assert np.array_equal(one.channels["wheel_load_N"], other.channels["wheel_load_N"])
