"""List robots, check one, and draft the file of a new one."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from ssmr.errors import DivergedError
from validation.plants.profile import load_profile, shipped
from validation.robots.advice import (
    Advice,
    advice_on_geometry,
    advice_on_loads,
    advice_on_masses,
    advice_on_motors,
    advice_on_simulation,
)
from validation.robots.measuring import measure_robot
from validation.robots.mechanics import WEIGHT_PER_KG, load_shares, spot_turn
from validation.robots.result import KnownRobot, RobotCheck, RobotList
from validation.simulator.description import WHEELS, Robot, load_robot, shipped_robots
from validation.simulator.sdf_writing import sdf_text
from validation.simulator.urdf_writing import urdf_text
from validation.words import one_line


def list_robots() -> RobotList:
    """Return the robots that come with the package, each with the shipped profiles of it."""
    of: dict[str, list[str]] = {}
    for profile in shipped():
        of.setdefault(load_profile(profile).robot.name, []).append(profile)
    found = []
    for name in shipped_robots():
        robot = load_robot(name)
        spot = spot_turn(robot)
        assert spot is not None, f"{name} does not stand on its wheels"
        found.append(KnownRobot(robot, spot.turn.multiplier, tuple(of.get(name, ()))))
    return RobotList(tuple(found))


def export_robot(robot: str | Path | Robot, to: Literal["urdf", "sdf"] = "urdf") -> str:
    """Return a robot as the text of a URDF, or of an SDF model for Gazebo.

    Args:
        robot: name of a shipped robot, path of a robot's file, or the robot itself.
        to: the format.

    Raises:
        RobotError: there is no such robot, or its file cannot be read.
    """
    chosen = robot if isinstance(robot, Robot) else load_robot(robot)
    return sdf_text(chosen) if to == "sdf" else urdf_text(chosen, {wheel: f"{wheel}_wheel_joint" for wheel in WHEELS})


def check_robot(robot: str | Path | Robot) -> RobotCheck:
    """Return whether a robot can be as its file describes it, and how it turns and stands.

    Args:
        robot: name of a shipped robot, path of a robot's file, or the robot itself.

    Raises:
        RobotError: there is no such robot, or its file cannot be read. What can be read and cannot be is advice.
    """
    chosen = robot if isinstance(robot, Robot) else load_robot(robot)
    spot = spot_turn(chosen)
    loads = tuple(float(share) * chosen.masses.total * WEIGHT_PER_KG for share in load_shares(chosen))
    advice = [
        *advice_on_geometry(chosen),
        *advice_on_masses(chosen),
        *advice_on_loads(chosen),
        *advice_on_motors(chosen, spot),
    ]
    measured = None
    try:
        measured = measure_robot(chosen)
    except ValueError as error:
        if not any(each.fault for each in advice):
            advice.append(Advice(f"no model can be built of it: {one_line(error)}"))
    except DivergedError as error:
        advice.append(Advice(f"its simulation fails: {one_line(error)}; are masses, inertia and gain what they should be?"))
    if measured is not None:
        advice += advice_on_simulation(chosen, measured, None if spot is None else spot.turn.multiplier)
    ordered = sorted(advice, key=lambda each: not each.fault)
    return RobotCheck(chosen, spot, loads, measured, tuple(ordered))
