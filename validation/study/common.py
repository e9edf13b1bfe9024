"""Parts that studies share: options, and a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from validation import cli
from validation.output import Document
from validation.plants.profile import Profile, choose_profile
from validation.report.drawing import PanelRow, draw_page
from validation.report.report import Report
from validation.report.table import Table


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


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Study(Report):
    """Result of a study."""

    program = "study"
    endings = ("png", "md")
    shown: Sequence[Table]
    """Tables, the most important one first."""
    about: Document
    """Values that study.json has besides its tables."""
    panels: Sequence[PanelRow]
    """Panels of its picture, row by row."""
    remarks: Sequence[str] = ()
    """Sentences below the tables."""

    def tables(self) -> Sequence[Table]:
        """Return its tables."""
        return self.shown

    def notes(self) -> Sequence[str]:
        """Return the remarks."""
        return [*super().notes(), *self.remarks]

    def document(self) -> Document:
        """Return what study.json has besides its tables."""
        return self.about

    def figure(self) -> Figure:
        """Draw its panels, with notes and options."""
        return draw_page(self.title, self.panels, notes=self.notes(), foot=self.made_by)
