"""Parts that studies share: options, and a picture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from validation import cli
from validation.plants.profile import Profile, choose_profile
from validation.report.report import Report


@dataclass(frozen=True, kw_only=True)
class StudyOptions(cli.Common):
    """Options of every study."""

    profile: cli.AnyProfile = None
    """Name of a shipped profile, or path of a profile (.toml); if not given, thesis-lab, and for
    another --robot the numbers of its file."""
    robot: cli.AnyRobot = None
    """Name of a shipped robot, or path of a robot's file (.toml); the profile's if not given."""

    def folder(self) -> Path:
        """Return the folder that the files are written to."""
        return Path("runs") / "study" / type(self).__module__.rpartition(".")[2]

    def robot_profile(self) -> Profile:
        """Return the profile; a ValueError refuses an unknown name, or that of another robot."""
        return choose_profile(self.profile, self.robot, "thesis-lab")


class Study(Report):
    """Result of a study."""

    program = "study"
    endings = ("png", "md")
