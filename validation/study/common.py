"""Parts that studies share: options, and a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from matplotlib.figure import Figure

from validation import cli
from validation.plants.profile import Profile, choose_profile
from validation.report import drawing
from validation.report.report import Report


@dataclass(frozen=True, kw_only=True)
class AnyStudy(cli.Common):
    """Options of every study."""

    def folder(self) -> Path:
        """Return the folder that the files are written to."""
        return Path("runs") / "study" / type(self).__module__.rpartition(".")[2]


@dataclass(frozen=True, kw_only=True)
class StudyOptions(AnyStudy):
    """Options of every study of one robot."""

    profile: cli.AnyProfile = None
    """Name of a shipped profile, or path of a profile (.toml); if not given, thesis-lab, and for
    another --robot the numbers of its file."""
    robot: cli.AnyRobot = None
    """Name of a shipped robot, or path of a robot's file (.toml); the profile's if not given."""

    def robot_profile(self) -> Profile:
        """Return the profile; a ValueError refuses an unknown name, or that of another robot."""
        return choose_profile(self.profile, self.robot, "thesis-lab")


def picture(study: Report, rows: Sequence[drawing.PanelRow]) -> Figure:
    """Return rows of panels as a figure, with the title, the notes and the footer of a study."""
    title = drawing.text_row(0.3, partial(drawing.draw_section, study.title))
    footer = drawing.text_row(0.26, partial(drawing.draw_footer, study.made_by))
    return drawing.put_together([title, *rows, *drawing.note_rows(study.notes()), footer])
