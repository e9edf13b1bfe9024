"""A robot in MuJoCo: how it turns on the spot, what its wheels carry, how heavy it feels."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ssmr.robot.vehicle import Drive
from ssmr.types import Commands, State
from validation.simulator.calibration import Calibration
from validation.simulator.description import ROTOR_SHARE, Robot
from validation.simulator.health import examine
from validation.simulator.plant import MujocoPlant
from validation.simulator.turning import SAMPLE, SPIN_LEAD, closed_form, measure_spin, spin

_RIM_SPEED = 0.13
"""Speed of the rims in the measured turn over sqrt(g r) [1]: slow enough for mechanics without inertia, and alike for robots
of every size (Froude's similarity)."""
_TURNS = 2.2
"""Turns that mechanics expects in the measured time [1]; the motors lag a little behind."""
_SERVO_TIME = 2e-4
"""Time constant of the measuring motors [s]: a seventieth of what robots have. Wheels that have a motor each, of which one
skids and the other rolls, then turn alike to within half a percent."""
_STAND_TIME = 2.0
"""Time for which the robot stands before its loads are read [s]; the simulator has let it settle before."""


@dataclass(frozen=True)
class Measured:
    """What a robot's MuJoCo model shows."""

    multiplier: float | None
    """Yaw rate that the wheels ask for over that of the body, turning on the spot [1]; None without a whole turn."""
    ripple: float | None
    """Range of the yaw rate over its mean in that turn [1]."""
    lifted_share: float
    """Share of the time of that turn in which a wheel was off the ground [1]."""
    loads: tuple[float, ...]
    """Loads of the four wheels at rest on level ground [N], in the order of `WHEELS`."""
    apparent_mass: float
    """Constant thrust over acceleration [kg]: the mass, and what turns with the wheels over the radius squared."""


def measure_robot(robot: Robot) -> Measured:
    """Return what the robot's MuJoCo model shows.

    The turn has motors without limit and delay, much stiffer than the robot's own and with rotors
    that are not light: it shows the robot, not them.

    Raises:
        ValueError: no model can be built of the robot's numbers; the message says why.
        DivergedError: the simulator gave up.
    """
    calibration = Calibration.of(robot)
    own = MujocoPlant(calibration, robot.drive)
    period = own.dt * max(round(SAMPLE / own.dt), 1)
    standing = own.run(Commands(period, np.zeros((round(_STAND_TIME / period), 2))), State(), period)
    loads = standing.channels["wheel_load_N"][len(standing.t) // 2 :].mean(axis=0)
    step = SAMPLE / math.ceil(SAMPLE / calibration.timestep - 1e-9)  # one that divides the period of samples
    size = calibration.mass * calibration.wheel_radius**2
    armature = max(calibration.armature, ROTOR_SHARE * size)  # a stiff motor makes a light wheel tremble
    inertia = 0.5 * size + 2.0 * armature  # of a side
    stiff = replace(calibration, timestep=step, armature=armature, gain=max(calibration.gain, inertia / _SERVO_TIME))
    expected = closed_form(calibration)
    rim = _RIM_SPEED * math.sqrt(9.81 * calibration.wheel_radius)
    rate = rim / calibration.half_track
    turn = _TURNS * 2.0 * math.pi * min(expected.multiplier, 10.0) / rate
    seconds = 0.05 * math.ceil((SPIN_LEAD + turn) / 0.05)
    plant = MujocoPlant(stiff, _free_drive(calibration))
    found = measure_spin(spin(plant, seconds, rate), stiff)
    return Measured(
        found.get("multiplier"), found.get("ripple"), found["lifted_share"], tuple(map(float, loads)),
        examine(own.model, calibration).apparent_mass,
    )  # fmt: skip


def _free_drive(calibration: Calibration) -> Drive:
    """Return motors without limits and delays, which take commands as the robot's geometry has them."""
    return Drive(
        math.inf, math.inf, 0.0, 0.0, 0.05, command_half_track=calibration.half_track,
        command_radius=calibration.wheel_radius, torque_limit=math.inf,
    )  # fmt: skip
