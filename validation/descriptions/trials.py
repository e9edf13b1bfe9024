"""Six short trials of a robot with its own physics, and what they tell."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np

from ssmr.errors import DivergedError
from ssmr.robot.ground import SkidTurn, turn_on_the_spot
from ssmr.types import FloatArray, Trajectory
from validation.descriptions.own_robot import LOADS, Measures, OwnRobot
from validation.simulator.health import LIFT_SHARE

SPEEDS = (0.08, 0.25, 0.5)
"""Speeds of the rims in the three turns on the spot over sqrt(g r) [1], as for robots of every size
(Froude's similarity)."""
_LEAD = 0.8
"""Time after which a motion counts [s]."""
_LEAST_YAW = 0.5 * math.pi
"""Heading that the slowest turn sweeps by mechanics [rad]: a pyramid is the same after each."""
_WINDOW = math.radians(12.0)
"""Heading over which the turning ratio is a mean [rad]."""
_SLOPE = math.radians(8.0)
"""Slope on which the robot stands [rad]."""
_SLOPE_TIME = 2.0
"""Duration of standing on the slope [s]; the second half counts."""
_DRIVE_TIME = 3.0
"""Duration of the straight drive and of the curve [s]."""
_INSIDE = 0.4
"""Rate of the inner wheels in the curve over that of the outer ones [1]."""
_LOADED = 0.6
"""Load at rest over a quarter of the weight below which a wheel may lift [1]."""
_LONGEST = 12.0
"""Greatest duration of a turn [s]."""


def mechanical_turn(robot: OwnRobot, *, in_the_middle: bool = False) -> SkidTurn:
    """Return the turn on the spot by mechanics, with its weight where it is or in the middle."""
    wheeled = robot.wheeled
    _, centre, _ = wheeled.lump(wheeled.group(wheeled.root))
    x, y = (0.0, 0.0) if in_the_middle else (float(centre[0]), float(centre[1]))
    half = float(np.mean([drum.contact_half_width for drum in robot.tyres if drum is not None]))
    # a wheel that would lift carries nothing; mechanics knows no such turn
    most_x = 0.499 * wheeled.wheelbase
    most_y = 0.499 * wheeled.track
    inside = (float(np.clip(x, -most_x, most_x)), float(np.clip(y, -most_y, most_y)))
    return turn_on_the_spot(wheeled.wheelbase, wheeled.track, *inside, half_width=half)


def examine(robot: OwnRobot) -> Measures:
    """Return what six short trials tell: stand, turn, straight, curve, slope, and half the step.

    A trial in which the simulator gives up leaves its numbers out, and counts as `diverged`.
    """
    measures = robot.measures
    measures["diverged"] = 0.0
    measures["speed_unit_m_s"] = math.sqrt(robot.gravity * robot.radius)
    for trial in (_stand, _straight, _turns, _curve, _slopes):
        try:
            measures |= trial(robot, measures)
        except DivergedError:
            measures["diverged"] += 1.0
            if trial is _stand:
                break
    return measures


def _stand(robot: OwnRobot, _: Measures) -> Measures:
    """Stand on level ground: the loads of the wheels."""
    standing = robot.settle()
    loads = standing.channels["wheel_load_N"][standing.t > 0.5 * standing.t[-1]].mean(axis=0)
    return dict(zip(LOADS, loads.tolist(), strict=True))


def _speed(robot: OwnRobot, froude: float) -> float:
    """Return a rim speed [m/s] that the inputs of the servos allow."""
    unit = robot.measures["speed_unit_m_s"]
    return min(froude * unit, 0.95 * robot.top_rate * robot.radius)


def _straight(robot: OwnRobot, _: Measures) -> Measures:
    """Drive straight ahead: rolling radius, deviation, and how smooth the loads are."""
    rate = _speed(robot, SPEEDS[1]) / robot.radius
    ride = robot.ride((rate, rate), _DRIVE_TIME)
    tail = ride.t > _LEAD
    way = ride.pose[-1, :2] - ride.pose[tail][0, :2]
    yaw = float(ride.pose[tail][0, 2])
    ahead = float(way @ [math.cos(yaw), math.sin(yaw)])
    aside = float(way @ [-math.sin(yaw), math.cos(yaw)])
    turned = _mean_rate(ride, tail) * float(ride.t[-1] - ride.t[tail][0])
    weight = robot.mass * robot.gravity
    loads = ride.channels["wheel_load_N"][tail].sum(axis=1)
    measures = Measures(load_ripple_share=float(loads.std()) / weight)
    if ahead > 0.2 * robot.radius and turned > 0.0:
        measures["rolling_radius_m"] = ahead / turned
        measures["veer_share"] = aside / ahead
    return measures


def _mean_rate(motion: Trajectory, tail: Any) -> float:
    """Return the mean rate of all wheels over a part of a motion [rad/s]."""
    return float(motion.channels["wheel_rad_s"][tail].mean())


def _turns(robot: OwnRobot, known: Measures) -> Measures:
    """Turn on the spot at three speeds; the middle one sweeps all headings."""
    turn = mechanical_turn(robot)
    middle = mechanical_turn(robot, in_the_middle=True)
    measures = Measures(closed_form=turn.multiplier, closed_form_middle=middle.multiplier)
    radius = known.get("rolling_radius_m", robot.radius)
    track = robot.wheeled.track
    # left wheels of the axles that are driven: others only roll along
    axles = 2 * np.flatnonzero(robot.driven.reshape(2, 2).all(axis=1))
    if not len(axles):
        axles = np.array([0, 2])
    for froude, name in zip(SPEEDS, ("slow", "", "fast"), strict=True):
        speed = _speed(robot, froude)
        rate = speed / robot.radius
        yaw = 2.0 * math.pi if name == "" else _LEAST_YAW
        seconds = min(_LEAD + 1.1 * yaw * 0.5 * track * turn.multiplier / speed, _LONGEST)
        ride = robot.ride((-rate, rate), seconds)
        tail = ride.t > _LEAD
        turning = ride.channels["wheel_rad_s"][tail]
        wheels = 0.5 * (turning[:, axles + 1] - turning[:, axles]).mean(axis=1)
        label = f"droop_{name}".rstrip("_")
        measures[label] = 1.0 - float(wheels.mean()) / rate
        measures["saturated"] = max(measures.get("saturated", 0.0), robot.saturated(ride))
        if name == "":
            resting = [known[load] for load in LOADS]
            measures |= _turn_measures(robot, ride, radius * wheels, np.array(resting))
    measures["droop_at_speed"] = measures["droop"]
    measures["droop"] = max(measures["droop"], measures.pop("droop_slow"))
    return measures


def _turn_measures(
    robot: OwnRobot, ride: Trajectory, rims: FloatArray, resting: FloatArray
) -> Measures:
    """Return the turning ratio over all headings, hopping, and how far the middle goes.

    Args:
        robot: the robot.
        ride: a turn on the spot.
        rims: (m,) mean speed of the rims after the lead [m/s].
        resting: (4,) loads at rest [N].
    """
    tail = ride.t > _LEAD
    quarter = 0.25 * robot.mass * robot.gravity
    lifted = (ride.channels["wheel_load_N"][tail] < LIFT_SHARE * quarter).mean(axis=0)
    yaw = ride.pose[tail, 2]
    xy = ride.pose[tail, :2]
    measures = Measures(
        # a wheel that the weight leaves with little load lifts without hopping
        lifted_share=float(np.where(resting > _LOADED * quarter, lifted, 0.0).max()),
        sideways_m=float(np.hypot(*(xy - xy[0]).T).max()),
    )
    turned = float(yaw[-1] - yaw[0])
    if turned < 0.1:
        return measures
    t = ride.t[tail]
    half = 0.5 * robot.wheeled.track
    swept = np.concatenate([[0.0], np.cumsum(0.5 * (rims[1:] + rims[:-1]) * np.diff(t))]) / half
    measures["multiplier"] = float(swept[-1]) / turned
    rising = np.maximum.accumulate(yaw - yaw[0])
    marks = np.arange(0.0, turned, _WINDOW)
    if len(marks) > 3:
        at = np.interp(marks, rising + 1e-12 * np.arange(len(rising)), swept)
        ratios = np.diff(at) / _WINDOW
        measures["multiplier_min"] = float(ratios.min())
        measures["multiplier_max"] = float(ratios.max())
    return measures


def _curve(robot: OwnRobot, known: Measures) -> Measures:
    """Drive a curve, with its own step and with half of it."""
    rate = _speed(robot, SPEEDS[2]) / robot.radius
    rates = (_INSIDE * rate, rate)
    ride = robot.ride(rates, _DRIVE_TIME)
    tail = ride.t > _LEAD
    rims = known.get("rolling_radius_m", robot.radius) * _mean_rate(ride, tail)
    measures = Measures()
    if rims > 0.0:
        speeds = np.convolve(ride.twist[tail, 0], np.full(10, 0.1), "valid")
        measures["surge_share"] = float(speeds.max()) / rims - 1.0
    finer = mujoco.MjModel.__copy__(robot.model)
    finer.opt.timestep *= 0.5
    half = robot.ride(rates, _DRIVE_TIME, finer)
    measures["step_halved_m"] = float(np.hypot(*(half.pose[-1] - ride.pose[-1])[:2]))
    measures["curve_m"] = rims * _DRIVE_TIME
    return measures


def _slopes(robot: OwnRobot, known: Measures) -> Measures:
    """Stand on a slope, along it and across it: rolling is told from sliding."""
    g = robot.gravity
    radius = known.get("rolling_radius_m", robot.radius)
    measures = Measures(creep_m_s=0.0)
    for direction in robot.wheeled.turn[:2]:
        model = mujoco.MjModel.__copy__(robot.model)
        down = g * math.sin(_SLOPE) * direction
        model.opt.gravity = down - [0.0, 0.0, g * math.cos(_SLOPE)]
        ride = robot.ride((0.0, 0.0), _SLOPE_TIME, model)
        tail = ride.t > 0.5 * _SLOPE_TIME
        seconds = float(ride.t[-1] - ride.t[tail][0])
        moved = float(np.hypot(*(ride.pose[-1] - ride.pose[tail][0])[:2])) / seconds
        if "rolls_m_s" not in measures:
            measures["rolls_m_s"] = radius * abs(_mean_rate(ride, tail))
            moved -= measures["rolls_m_s"]
        measures["creep_m_s"] = max(measures["creep_m_s"], moved)
    return measures


def in_words(measures: Measures) -> str:
    """Return what the trials say, in the words of people who ask."""
    if "multiplier" not in measures:
        return "It does not turn on the spot at all."
    droop = measures["droop_at_speed"]
    middle = measures["closed_form_middle"]
    expected = measures["closed_form"]
    measured = measures["multiplier"]
    left = [90.0]
    for factor in (1.0 - droop, 1.0 / middle, middle / expected, expected / measured):
        left.append(left[-1] * factor)
    names = (
        "wheels that lag behind their rates",
        "skidding, as on a real robot,",
        "weight off the middle",
        "contacts, which hop or depend on the heading,",
    )
    parts = []
    for name, before, after in zip(names, left, left[1:], strict=False):
        lost = before - after
        if abs(lost) >= 1.0:
            parts.append(f"{name} {'take' if lost > 0.0 else 'give back'} {abs(lost):.0f}°")
    text = f"It turns {left[-1]:.0f}° for 90° on its wheels"
    text += f": {', '.join(parts)}" if parts else ": nothing is lost"
    if measures["lifted_share"] > 0.01:
        text += f"; a wheel is off the ground {100.0 * measures['lifted_share']:.0f} % of the time"
    return text + "."
