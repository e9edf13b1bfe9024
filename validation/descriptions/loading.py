"""A robot by name or by file, whatever kind of description the file is."""

from __future__ import annotations

from pathlib import Path

from validation.simulator.description import USUAL_ROBOT, Robot, read_robot, shipped_robots


def load_robot(robot: str | Path | Robot = USUAL_ROBOT) -> Robot:
    """Return a shipped robot by name, or that of a robot's file, a URDF, an SDF or an MJCF.

    A robot itself is returned as it is.

    Raises:
        ValueError: there is none, or its file says something that cannot be; the message names
            file, section and key.
    """
    if isinstance(robot, Robot):
        return robot
    if str(robot) not in shipped_robots():
        # here: reading descriptions of others takes long to import
        from validation.descriptions.foreign_robot import is_description
        from validation.descriptions.importing import import_robot

        if is_description(robot):
            return import_robot(robot).robot
    return read_robot(robot)
