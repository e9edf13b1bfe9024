"""A new robot's file from what a tape measure and a scale say."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType

from validation.robots.mechanics import spot_turn
from validation.robots.result import DraftedRobot
from validation.robots.writing import RobotDraft, drafted_text
from validation.simulator.description import Link, Robot, shipped_robots
from validation.words import one_line

SURE_FRICTION = 1.0
"""Friction of ground on which motors whose torque nobody knows are taken to turn the robot on the spot [1]."""


@dataclass(frozen=True)
class TapeMeasure:
    """What is known of a robot that has no description: five numbers, and any others."""

    wheelbase: float
    """Distance of the axles [m]."""
    track: float
    """Distance of the middles of the left and right tyres [m]."""
    wheel_radius: float
    """Rolling radius of the wheels [m]: what the robot drives in one turn of them, over 2 pi."""
    wheel_width: float
    """Width of the tyres [m]."""
    mass: float
    """Mass of the whole robot, with battery [kg]."""
    wheel_mass: float | None = None
    """Mass of one wheel [kg]; estimated if not given."""
    axle_height: float | None = None
    """Height of the axles above the base frame's origin [m]; 0 if not given."""
    friction: float | None = None
    """Sliding friction of its tyres on the ground [1]; 0.3 if not given."""
    torque_limit: float | None = None
    """Greatest torque of one wheel [N m]; enough to turn on the spot on ground of friction 1 if not given."""
    v_max: float | None = None
    """Greatest speed that its driver accepts [m/s]; no limit if not given."""
    w_max: float | None = None
    """Greatest yaw rate that its driver accepts [rad/s]; no limit if not given."""
    command_half_track: float | None = None
    """Half of the track that its driver turns yaw rates into wheel rates with [m]; half of the track if not given."""
    link: Link = "belt"
    """Link between the wheels of a side: `belt`, they turn together; `none`, each wheel has a motor."""
    title: str = ""
    """Name for people, with the maker's."""


_PLACES: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "wheelbase": ("geometry.wheelbase", "between the axles"),
        "track": ("geometry.track", "between the middles of the left and right tyres"),
        "wheel_radius": ("geometry.wheel_radius", "what it drives in one turn of its wheels, over 2 pi"),
        "wheel_width": ("geometry.wheel_width", ""),
        "axle_height": ("geometry.axle_height", "of the axles above the base frame's origin"),
        "mass": ("mass.total", "with battery"),
        "wheel_mass": ("mass.wheel", "one wheel"),
        "v_max": ("drive.v_max", ""),
        "w_max": ("drive.w_max", ""),
        "command_half_track": (
            "drive.command_half_track",
            "half of wheel separation times multiplier in the driver's settings",
        ),
        "torque_limit": ("drive.torque_limit", "of one wheel"),
        "friction": ("simulation.friction", "tyre on ground"),
    }
)
"""Where each number of a `TapeMeasure` stands in the file, and a few words beside it."""
_TO_DO = (
    "weigh each of the four wheels while the robot stands on them: the loads give com x and y; lift one end by a known "
    "height and "
    "weigh again for z",
    "measure the hull between the tyres (body_size, body_centre) for pictures and for the estimate of inertia",
    "drive a metre and count the wheels' turns: wheel_radius is the distance over 2 pi turns",
    "drag the robot sideways with a spring scale: friction is force over weight; then turn it on the spot and read the "
    "motors' currents",
)
"""What to measure after the five numbers, the most important first."""


def draft_from_tape(name: str, known: TapeMeasure) -> DraftedRobot:
    """Return the file of a robot of which a tape measure and a scale know a few numbers.

    Raises:
        ValueError: the name is taken or cannot be one, or a number cannot be.
    """
    require_free_name(name)
    draft = RobotDraft(name, known.title, heading=(
        f"The robot {name}. The numbers below were given to `python -m validation.robots new`; lines that begin with # are",
        "estimates from them. To replace one, measure it, take the # away, and say in [sources] where it is from.",
    ))  # fmt: skip
    for f in fields(TapeMeasure):
        value = getattr(known, f.name)
        if f.name in _PLACES and value is not None:
            key, remark = _PLACES[f.name]
            if not math.isfinite(value):
                raise ValueError(f"{f.name} is {value}, wanted a finite number")
            draft.say(key, value, "measured: given to `new`", remark)
    draft.say("geometry.link", known.link, "assumed: " + _LINK_WORDS[known.link], _LINK_WORDS[known.link])
    if known.torque_limit is None:
        say_sure_torque(draft)
    robot, text = drafted_text(draft)
    left = [key for key in ("com", "inertia", "wheel", "wheel_inertia") if f"mass.{key}" not in robot.said]
    remarks = [f"estimated from the size: {', '.join(left)} of [mass], the hull, gain and armature"]
    remarks += [f"next: {words}" for words in _TO_DO]
    return DraftedRobot(robot, text, tuple(remarks))


_LINK_WORDS: Mapping[str, str] = MappingProxyType(
    {"belt": "the wheels of a side turn together", "none": "each wheel has a motor of its own"}
)


def require_free_name(name: str) -> None:
    """Refuse the name of a robot that comes with the package: a name would mean two robots.

    Raises:
        ValueError: it is one.
    """
    if name in shipped_robots():
        raise ValueError(f"name '{one_line(name)}' belongs to a robot that comes with the package; take another")


def say_sure_torque(draft: RobotDraft) -> Robot:
    """Give a draft the torque that surely turns it on the spot, and return the robot before that.

    Raises:
        ValueError: the draft says something that cannot be.
    """
    robot, _ = drafted_text(draft)
    spot = spot_turn(robot)
    if spot is not None:
        torque = float(f"{0.5 * SURE_FRICTION * spot.side_torque:.3g}")
        words = f"enough to turn on the spot on ground of friction {SURE_FRICTION:g}"
        draft.say("drive.torque_limit", torque, f"assumed: {words}", f"of one wheel; assumed: {words}")
    return robot
