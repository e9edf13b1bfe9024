"""State filters that closed loops use: by name, from a file, or commissioned on the robot itself."""

from __future__ import annotations

from pathlib import Path

from ssmr.control.loop import Feedback, LoopSettings
from ssmr.control.references import eight
from ssmr.estimation.settings import EkfSettings, commission
from validation.bench.gains import DEFAULT, load_gains
from validation.bench.loops import make_controller, make_robot, run_robots
from validation.plants.filters import StateFilter, load_filter, odometry_of
from validation.plants.profile import Profile

COMMISSIONED = "commissioned"
"""Name of a filter that gets the robot's constants from simulated drives."""
TRACKER = "lqr-scheduled"
"""Controller that keeps a robot on a reference, with the gains of its class; any good one would do."""
_SPEED, _SEEDS = 0.25, (1000, 1001)
"""Speed of the drives by which a filter is commissioned [m/s], and their seeds, which no other run has."""


def commissioned(profile: Profile, plant: str, feedback: Feedback = "noisy") -> EkfSettings:
    """Return a filter that knows a robot's constants from two drives along an eight.

    A scheduled LQR drives them on level ground, pushed as in Sec. 3.4.5.

    Args:
        profile: the robot and its plants.
        plant: name of the plant that is driven.
        feedback: what the controller sees in these drives.

    Raises:
        LostError: the robot left the eight.
        ProfileError: there is no such plant, or it has no closed loops.
    """
    robot, law = make_robot(profile, plant), make_controller(profile, load_gains(TRACKER, DEFAULT))
    odometry = odometry_of(robot.drive)
    loop, n = LoopSettings(feedback, filter=odometry), len(_SEEDS)
    runs = run_robots([robot] * n, [law] * n, [loop] * n, eight(_SPEED), _SEEDS)
    drives = [run.require_kept(f"{plant} of {profile.name}, which was to be commissioned,").motion for run in runs]
    return commission(drives, odometry)


def chosen_filter(name_or_path: str | Path, profile: Profile, plant: str) -> StateFilter:
    """Return the state filter of a robot: `thesis`, `learning`, `commissioned`, or that of a TOML file.

    Raises:
        ValueError: there is none of that name, or its file says something that cannot be.
        LostError: the robot left the reference on which it was to be commissioned.
    """
    if str(name_or_path) == COMMISSIONED:
        return StateFilter(COMMISSIONED, commissioned(profile, plant))
    return load_filter(name_or_path, odometry_of(profile.section(plant).drive), (COMMISSIONED,))
