"""A MuJoCo robot's wheel loads, beside their static shares and quasi-static load transfer."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from ssmr.robot.ground import LoadModel
from ssmr.robot.localiser import Localiser
from ssmr.types import FloatArray, State, Trajectory
from validation.output import Document
from validation.simulator.description import WHEELS
from validation.simulator.health import LIFT_SHARE
from validation.simulator.model import GRAVITY
from validation.simulator.plant import MujocoPlant

MEASURED = "wheel_load_N"
"""Channel of a motion with the (M, 4) simulated loads [N]."""
QUASI_STATIC = "quasi_static_load_N"
"""Channel of a motion with the (M, 4) loads by the formula, from that same motion [N]."""


def _load_model(plant: MujocoPlant) -> LoadModel:
    """Return the numbers of the quasi-static formula, read off a robot's compiled model at rest."""
    model = plant.model
    data = mujoco.MjData(plant.model)
    mujoco.mj_setState(model, data, plant.placed(State()), mujoco.mjtState.mjSTATE_FULLPHYSICS)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    root = model.body("base").id
    com = data.subtree_com[root]
    front = model.body("front_left").pos
    right = model.body("rear_right").pos
    spin = sum(model.body(wheel).inertia[1] for wheel in WHEELS)
    return LoadModel(
        mass=model.body_subtreemass[root],
        com_x=com[0],
        com_y=com[1],
        com_height=com[2],
        wheelbase=front[0] - right[0],
        track=front[1] - right[1],
        spin_inertia=spin,
    )


def resting_loads(plant: MujocoPlant) -> FloatArray:
    """Return the (4,) wheel loads [N] at rest on level ground, from mass and centre of mass."""
    calibration = plant.calibration
    return calibration.static_shares * calibration.mass * GRAVITY


def with_quasi_static(motion: Trajectory, plant: MujocoPlant, localiser: Localiser) -> Trajectory:
    """Return a motion of the plant's tracked frame with the channel `QUASI_STATIC` added."""
    middle = replace(motion, twist=localiser.body_twist(motion.twist))
    gravity = plant.terrain.gravity_in_body(motion.yaw - localiser.tracked_yaw, GRAVITY)
    loads = _load_model(plant).along(middle, gravity, plant.calibration.wheel_radius)
    return replace(motion, channels={**motion.channels, QUASI_STATIC: loads})


def summarise_loads(pieces: tuple[Trajectory, ...], static: FloatArray) -> Document:
    """Return what the wheels carried over all pieces, each with both channels.

    `static` are the (4,) loads at rest on level ground [N]. Lists are in the order of `WHEELS`:
    loads at rest, mean, least and greatest [N], and the share of time in which a wheel carried less
    than 2 % of a quarter of the weight [1]. The root mean squares are over all wheels [N]:
    simulated less static loads, and simulated less quasi-static ones, which load transfer does not
    explain.
    """
    measured = np.concatenate([piece.channels[MEASURED] for piece in pieces])
    formula = np.concatenate([piece.channels[QUASI_STATIC] for piece in pieces])
    lifted = measured < LIFT_SHARE * static.mean()

    def rms(values: FloatArray) -> float:
        return float(np.sqrt(np.mean(values**2)))

    return {
        "static_N": static.tolist(),
        "mean_N": measured.mean(axis=0).tolist(),
        "lowest_N": measured.min(axis=0).tolist(),
        "highest_N": measured.max(axis=0).tolist(),
        "off_ground_share": np.mean(lifted, axis=0).tolist(),
        "static_rms_N": rms(measured - static),
        "quasi_static_rms_N": rms(measured - formula),
    }
