"""What a reference asks of a robot beside what the robot can do: its greatest yaw rate and speed, driven and measured.

A limit of commands is no limit of motion: a skid-steering robot turns less than its driver is told, by friction and by the
difference between the driver's track and the effective one.
"""

from __future__ import annotations

import math

import numpy as np

from ssmr.control.waypoints import Waypoints
from ssmr.types import Commands, Plant, State

_SECONDS, _LAST = 6.0, 1.0
"""Time for which a command is driven, and the last part of it over which the motion is averaged [s]."""
_SAMPLE_DT = 0.05
_EASY_TURN, _EASY_SPEED = 0.25, 0.8
"""Shares of the limits of commands up to which a reference asks for so little that nothing is measured."""


def settled_motion(plant: Plant, v: float, w: float) -> tuple[float, float]:
    """Return the speed [m/s] and yaw rate [rad/s] of a plant that has been told to drive these for some seconds."""
    commands = Commands(_SAMPLE_DT, np.tile([v, w], (round(_SECONDS / _SAMPLE_DT), 1)))
    twist = plant.run(commands, State(), _SAMPLE_DT).twist[-round(_LAST / _SAMPLE_DT) :]
    return float(np.mean(twist[:, 0])), float(np.mean(twist[:, 2]))


def possible_share(
    plant: Plant, waypoints: Waypoints, limits: tuple[float, float], part: float = 1.0
) -> tuple[float, list[str]]:
    """Return the share of a reference's speed at which a plant can follow it, and what it asks for beyond that, in words.

    Args:
        plant: what is to follow; it is driven, and reset.
        waypoints: the reference.
        limits: greatest speed [m/s] and yaw rate [rad/s] that can be commanded.
        part: share of the greatest motion that the reference may take.

    Returns:
        The share, 1 where the reference asks for no more than that, and the demands that exceed it.
    """
    course, speeds = waypoints.course(), waypoints.segment_speeds
    k = int(np.argmax(np.abs(course["w"])))
    at, turn, fastest = float(course["v"][k]), float(abs(course["w"][k])), float(np.max(speeds))
    v_max, w_max = limits
    share, said = 1.0, []
    if turn > _EASY_TURN * w_max and math.isfinite(w_max):
        possible = abs(settled_motion(plant, at, math.copysign(w_max, float(course["w"][k])))[1])
        if turn > part * possible:
            share = min(share, part * possible / turn)
            said.append(f"a yaw rate of {turn:.2f} rad/s where {possible:.2f} rad/s are possible")
    if fastest > _EASY_SPEED * v_max:
        possible = settled_motion(plant, v_max, 0.0)[0]
        if fastest > part * possible:
            share = min(share, part * possible / fastest)
            said.append(f"{fastest:.2f} m/s where {possible:.2f} m/s are possible")
    return share, said


def demand_sentence(plant: Plant, waypoints: Waypoints, limits: tuple[float, float], whose: str, label: str) -> str | None:
    """Return a sentence on a reference that asks for more than a plant can do; None where it does not.

    Args:
        plant: what is to follow; it is driven, and reset.
        waypoints: the reference.
        limits: greatest speed [m/s] and yaw rate [rad/s] that can be commanded.
        whose: name of the plant and its profile in the sentence.
        label: name of the reference in the sentence.
    """
    share, said = possible_share(plant, waypoints, limits)
    if not said:
        return None
    slower = f"at {math.floor(100.0 * share * waypoints.speed) / 100.0:.2f} m/s it could be followed"
    return f"{label} at {waypoints.speed:.3g} m/s asks {whose} for {' and '.join(said)}; {slower}."
