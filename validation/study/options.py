"""Options that studies share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, get_args

from validation import cli
from validation.plants.profile import Profile, choose_profile

AS_NAMES = get_args(cli.Names)[1]
"""Annotation of an option that the command line reads as comma-separated names, whatever it may be in Python."""
MOST_RUNS = 100_000
"""Greatest number of runs of one study."""


@dataclass(frozen=True, kw_only=True)
class AnyStudy(cli.Common):
    """Options of every study."""

    def folder(self) -> Path:
        """Return the folder that the files are written to."""
        return Path("runs") / "study" / type(self).__module__.rpartition(".")[2]


@dataclass(frozen=True, kw_only=True)
class StudyOptions(AnyStudy):
    """Options of every study of one robot."""

    profile: Annotated[cli.AnyProfile, cli.profile_option("thesis-lab")] = None
    robot: cli.AnyRobot = None

    def robot_profile(self) -> Profile:
        """Return the profile.

        Raises:
            ValueError: there is none of that name, its numbers are wrong, or it is of another robot.
        """
        return choose_profile(self.profile, self.robot, "thesis-lab")
