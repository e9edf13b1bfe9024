"""Drives that show how the contacts of a robot let it roll, and stand on a slope."""

from __future__ import annotations

import math

import numpy as np

from ssmr.errors import DivergedError
from ssmr.robot.vehicle import Drive
from ssmr.types import Plant, State, Trajectory
from validation.simulator.description import GRAVITY
from validation.simulator.plant import MujocoPlant
from validation.simulator.turning import SAMPLE, STRAIGHT_SPEED, held_twist

_STRAIGHT_TIME = 8.0
"""Duration of the straight drive [s]."""
_STRAIGHT_LEAD = 3.0
"""Time in the straight drive at which the measurement starts [s]."""
_STRAIGHT_YAW = 0.4
"""Heading of the straight drive, which is none of the ground's axes [rad]."""
TURNED = 0.25 * math.pi
"""Angle by which the ground is turned under trajectory 3, which should change nothing [rad]."""
_SURGE_LEAD = 3.0
"""Time in trajectory 3 from which on its speed is measured [s]."""
_SLOPE = math.radians(8.0)
"""Side slope on which the robot stands [rad]."""
_SLOPE_TIME = 6.0
"""Duration of standing on the slope [s]."""
_SLOPE_LEAD = 2.0
"""Time on the slope at which the measurement starts [s]."""


def rolling_radius(plant: Plant, speed: float = STRAIGHT_SPEED) -> tuple[float, float]:
    """Drive straight ahead at a commanded speed [m/s].

    Returns:
        Rolling radius of the tyres [m], and deviation to the left over the length [1].

    Raises:
        DivergedError: the simulator gave up.
    """
    motion = plant.run(held_twist(speed, 0.0, _STRAIGHT_TIME), State(yaw=_STRAIGHT_YAW), SAMPLE)
    tail = motion.t >= _STRAIGHT_LEAD
    along = np.array([math.cos(_STRAIGHT_YAW), math.sin(_STRAIGHT_YAW)])
    way = motion.xy[-1] - motion.xy[tail][0]
    seconds = float(motion.t[-1] - motion.t[tail][0])
    ahead = float(along @ way)
    aside = float(along[0] * way[1] - along[1] * way[0])
    turned = float(motion.wheels[tail].mean()) * seconds
    if not (ahead > 0.0 and turned > 0.0):
        raise DivergedError("a drive straight ahead went nowhere")
    return ahead / turned, aside / ahead


def creep_speed(plant: MujocoPlant) -> float:
    """Return the speed at which a robot at rest slides down a side slope [m/s].

    Raises:
        DivergedError: the simulator gave up.
    """
    gravity = plant.model.opt.gravity
    level = np.array(gravity)
    gravity[:] = 0.0, GRAVITY * math.sin(_SLOPE), -GRAVITY * math.cos(_SLOPE)
    try:
        motion = plant.run(held_twist(0.0, 0.0, _SLOPE_TIME), State(), SAMPLE)
    finally:
        gravity[:] = level
    tail = motion.t >= _SLOPE_LEAD
    way = motion.xy[-1] - motion.xy[tail][0]
    return float(np.hypot(*way) / (motion.t[-1] - motion.t[tail][0]))


def surge_share(motion: Trajectory, wheel_radius: float, drive: Drive) -> float:
    """Return the greatest speed on trajectory 3, once under way, over that of the rims, less 1 [1].

    The rims' speed is that of a straight drive.
    """
    rim = STRAIGHT_SPEED * wheel_radius / drive.command_radius
    speeds = motion.twist[motion.t >= _SURGE_LEAD, 0]
    return float(speeds.max()) / rim - 1.0
