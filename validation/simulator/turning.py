"""A turn on the spot, its measures, and its closed form."""

from __future__ import annotations

import math

import numpy as np

from ssmr.robot.ground import SkidTurn, turn_on_the_spot
from ssmr.types import Commands, Plant, State, Trajectory
from validation.simulator.calibration import Calibration, contact_half_width
from validation.simulator.description import WHEELS
from validation.simulator.health import LIFT_SHARE

SAMPLE = 0.01
"""Period of samples [s]."""
_SPIN_RATE = 0.6
"""Commanded yaw rate of the turn on the spot [rad/s]."""
_SPIN_TIME = 38.0
"""Duration of the turn on the spot [s]: about three turns."""
SPIN_LEAD = 2.0
"""Time in the turn on the spot at which the measurement starts [s]."""
STRAIGHT_SPEED = 0.5
"""Commanded speed of the straight drive [m/s]."""


def held_twist(v: float, w: float, seconds: float) -> Commands:
    """Return a constant command of speed [m/s] and yaw rate [rad/s]."""
    return Commands(0.05, np.tile([v, w], (round(seconds / 0.05), 1)))


def spin_on_spot(plant: Plant, seconds: float = _SPIN_TIME, rate: float = _SPIN_RATE) -> Trajectory:
    """Turn on the spot at a commanded yaw rate [rad/s]; return the motion, sampled every `SAMPLE`.

    Raises:
        DivergedError: the simulator gave up.
    """
    return plant.run(held_twist(0.0, rate, seconds), State(), SAMPLE)


def closed_form(
    calibration: Calibration, shift: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
) -> SkidTurn:
    """Return the turn on the spot by mechanics, with the robot's centre of mass and wheels.

    Args:
        calibration: parameters of the robot.
        shift: four shares by which loads differ from those at rest, as `turn_on_the_spot` has them
            [1].
    """
    robot = calibration.robot
    half_width = calibration.capsule_half_width
    if calibration.wheel_shape != "capsule":
        half_width = contact_half_width(robot, calibration.wheel_shape)
    share = 1.0 - len(WHEELS) * robot.wheel_mass / calibration.mass
    return turn_on_the_spot(
        wheelbase=robot.wheelbase,
        track=2.0 * calibration.half_track,
        x=share * calibration.com_x,
        y=share * calibration.com_y,
        ratio=calibration.friction_ratio,
        half_width=half_width,
        shift=shift,
    )


def measure_spin(motion: Trajectory, calibration: Calibration) -> dict[str, float]:
    """Return measures of a turn on the spot, by name; some need a whole turn, and lack without."""
    tail = motion.t >= SPIN_LEAD - 1e-9
    loads = motion.channels["wheel_load_N"][tail]
    rate = motion.twist[tail, 2]
    wheels = motion.wheels[tail, 1] - motion.wheels[tail, 0]
    xy = motion.xy[tail]
    yaw = motion.yaw[tail]
    radius = calibration.wheel_radius
    lifted = (loads < LIFT_SHARE * loads.mean(axis=0)).any(axis=1)
    speed = np.hypot(*motion.twist[tail, :2].T)
    out = {
        "multiplier_expected": closed_form(calibration).multiplier,
        "lifted_share": float(lifted.mean()),
        "glide": float(speed.max() / (0.5 * radius * wheels.mean())),
        "wander_m": float(np.hypot(*(xy - xy[0]).T).max()),
    }
    turned = yaw - yaw[0]
    whole = math.floor(float(turned[-1]) / (2.0 * math.pi) + 1e-9)
    if whole >= 1:
        end = np.argmax(turned >= 2.0 * math.pi * whole)
        span = slice(0, max(end, 1))
        rims = radius * wheels[span].mean()
        yaw_rate = rate[span].mean()
        out["multiplier"] = float(rims / (2.0 * calibration.half_track * yaw_rate))
        out["ripple"] = float(np.ptp(rate[span]) / yaw_rate)
        out["drift_m"] = float(np.hypot(*(xy[end] - xy[0]))) / whole
    return out
