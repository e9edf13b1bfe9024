"""A robot by name or by file, whatever kind of description the file is."""

from __future__ import annotations

from pathlib import Path

from validation.simulator.description import USUAL_ROBOT, Robot, read_robot, shipped_robots


def load_robot(name_or_path: str | Path = USUAL_ROBOT) -> Robot:
    """Return a shipped robot by name, or that of a robot's file, a URDF, an SDF or an MJCF.

    Raises:
        ValueError: there is none, or its file says something that cannot be; the message names
            file, section and key.
    """
    if str(name_or_path) not in shipped_robots():
        # here: reading descriptions of others takes long to import
        from validation.descriptions.foreign_robot import is_description
        from validation.descriptions.importing import import_robot

        if is_description(name_or_path):
            return import_robot(name_or_path).robot
    return read_robot(name_or_path)
