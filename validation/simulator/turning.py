"""Drives that show how a robot rolls, turns on the spot and stands on a slope, and the closed forms beside them."""

from __future__ import annotations

import math

import numpy as np

from ssmr.errors import DivergedError
from ssmr.robot.ground import SkidTurn, turn_on_the_spot
from ssmr.robot.vehicle import Drive
from ssmr.types import Commands, Plant, State, Trajectory
from validation.simulator.calibration import Calibration
from validation.simulator.description import WHEELS
from validation.simulator.health import LIFT_SHARE
from validation.simulator.model import GRAVITY
from validation.simulator.plant import MujocoPlant

SAMPLE = 0.01
"""Period of samples [s]."""
SPIN_RATE = 0.6
SPIN_TIME = 38.0
SPIN_LEAD = 2.0
"""Turn on the spot: commanded yaw rate [rad/s], duration [s], and start of the measurement [s];
about three turns."""
STRAIGHT_SPEED = 0.5
STRAIGHT_TIME = 8.0
_STRAIGHT_LEAD = 3.0
_STRAIGHT_YAW = 0.4
"""Straight drive: commanded speed [m/s], duration [s], start of the measurement [s], and heading
[rad] between the axes."""
TURNED = 0.25 * math.pi
_SURGE_LEAD = 3.0
"""Angle by which the ground is turned under trajectory 3, which should change nothing [rad], and
the time from which on its speed is measured [s]."""
_SLOPE = math.radians(8.0)
_SLOPE_TIME = 6.0
_SLOPE_LEAD = 2.0
"""Side slope [rad], duration of standing on it [s], and start of the measurement [s]."""


def _twist(v: float, w: float, seconds: float) -> Commands:
    return Commands(0.05, np.tile([v, w], (round(seconds / 0.05), 1)))


def rolling_radius(plant: Plant, speed: float = STRAIGHT_SPEED) -> tuple[float, float]:
    """Drive straight ahead at a commanded speed [m/s].

    Returns:
        Rolling radius of the tyres [m], and deviation to the left over the length [1].

    Raises:
        DivergedError: the simulator gave up.
    """
    motion = plant.run(_twist(speed, 0.0, STRAIGHT_TIME), State(yaw=_STRAIGHT_YAW), SAMPLE)
    tail = motion.t >= _STRAIGHT_LEAD
    along = np.array([math.cos(_STRAIGHT_YAW), math.sin(_STRAIGHT_YAW)])
    first = motion.xy[tail][0]
    last = motion.xy[-1]
    ahead = float(along @ (last - first))
    aside = float(along[0] * (last - first)[1] - along[1] * (last - first)[0])
    turned = float(motion.wheels[tail].mean()) * float(motion.t[-1] - motion.t[tail][0])
    if not (ahead > 0.0 and turned > 0.0):
        raise DivergedError("a drive straight ahead went nowhere")
    return ahead / turned, aside / ahead


def creep(plant: MujocoPlant) -> float:
    """Return the speed at which a robot at rest slides down a side slope [m/s].

    Raises:
        DivergedError: the simulator gave up.
    """
    level = np.array(plant.model.opt.gravity)
    plant.model.opt.gravity[:] = 0.0, GRAVITY * math.sin(_SLOPE), -GRAVITY * math.cos(_SLOPE)
    try:
        motion = plant.run(_twist(0.0, 0.0, _SLOPE_TIME), State(), SAMPLE)
    finally:
        plant.model.opt.gravity[:] = level
    tail = motion.t >= _SLOPE_LEAD
    first = motion.xy[tail][0]
    last = motion.xy[-1]
    return float(np.hypot(*(last - first)) / (motion.t[-1] - motion.t[tail][0]))


def surge(motion: Trajectory, wheel_radius: float, drive: Drive) -> float:
    """Return the greatest speed on trajectory 3, once under way, over that of the wheels straight ahead, less 1 [1]."""
    rim = STRAIGHT_SPEED * wheel_radius / drive.command_radius
    return float(motion.twist[motion.t >= _SURGE_LEAD, 0].max()) / rim - 1.0


def spin(plant: Plant, seconds: float = SPIN_TIME, rate: float = SPIN_RATE) -> Trajectory:
    """Turn on the spot at a commanded yaw rate [rad/s]; return the motion, sampled every `SAMPLE`.

    Raises:
        DivergedError: the simulator gave up.
    """
    return plant.run(_twist(0.0, rate, seconds), State(), SAMPLE)


def closed_form(
    calibration: Calibration, shift: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
) -> SkidTurn:
    """Return the turn on the spot of a robot with this centre of mass and these wheels by mechanics.

    Args: calibration: parameters of the robot. shift: four shares by which loads differ from those
        at rest, as `turn_on_the_spot` has them [1].
    """
    # contact points, from the wheel's middle [m]
    outermost = {"ellipsoid": 0.0, "capsule": calibration.capsule_half_width}
    half_width = outermost.get(
        calibration.wheel_shape, 0.5 * calibration.robot.geometry.wheel_width
    )
    share = 1.0 - len(WHEELS) * calibration.robot.masses.wheel / calibration.mass
    return turn_on_the_spot(
        calibration.robot.geometry.wheelbase,
        2.0 * calibration.half_track,
        share * calibration.com_x,
        share * calibration.com_y,
        calibration.friction_ratio,
        half_width,
        (shift[0], shift[1], shift[2], shift[3]),
    )


def measure_spin(motion: Trajectory, calibration: Calibration) -> dict[str, float]:
    """Return the measures of a turn on the spot, by name; those of whole turns only if there was one."""
    tail = motion.t >= SPIN_LEAD - 1e-9
    loads = motion.channels["wheel_load_N"][tail]
    rate = motion.twist[tail, 2]
    wheels = motion.wheels[tail, 1] - motion.wheels[tail, 0]
    xy = motion.xy[tail]
    yaw = motion.yaw[tail]
    out = {
        "multiplier_expected": closed_form(calibration).multiplier,
        "lifted_share": float((loads < LIFT_SHARE * loads.mean(axis=0)).any(axis=1).mean()),
        "glide": float(
            np.hypot(*motion.twist[tail, :2].T).max()
            / (0.5 * calibration.wheel_radius * wheels.mean())
        ),
        "wander_m": float(np.hypot(*(xy - xy[0]).T).max()),
    }
    whole = math.floor(float(yaw[-1] - yaw[0]) / (2.0 * math.pi) + 1e-9)
    if whole >= 1:
        end = int(np.argmax(yaw - yaw[0] >= 2.0 * math.pi * whole))
        span = slice(0, max(end, 1))
        out["multiplier"] = float(
            calibration.wheel_radius
            * wheels[span].mean()
            / (2.0 * calibration.half_track * rate[span].mean())
        )
        out["ripple"] = float(np.ptp(rate[span]) / rate[span].mean())
        out["drift_m"] = float(np.hypot(*(xy[end] - xy[0]))) / whole
    return out
