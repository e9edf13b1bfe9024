"""The base of all studies' results, which puts study.json and study.md together."""

from __future__ import annotations

import contextlib
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence, Sized
from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar

from validation import store
from validation.plants.profile import Profile, choose_profile
from validation.report.result import Result
from validation.report.tables import Grid, markdown, markdown_table, with_robot
from validation.simulator.description import USUAL_ROBOT, Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_REPORTED = ("mujoco", "numpy", "numba", "ssmr-testbed")
"""Packages whose versions a report names; study.json has all of them."""


FINISHED, INTERRUPTED = "finished", "interrupted"
"""How a study can end."""


class Course:
    """Course of a study: whether it was interrupted."""

    status = FINISHED
    """`finished` or `interrupted`."""


@contextlib.contextmanager
def keeping(found: Sized) -> Iterator[Course]:
    """Within, a study adds its cases to `found`, each when it is finished; Ctrl-C ends the block early and keeps them.

    Every study runs its cases in such a block, and hands the status of the course to its result.

    Raises:
        KeyboardInterrupt: it was pressed before the first case was finished.
    """
    course = Course()
    try:
        yield course
    except KeyboardInterrupt:
        if not len(found):
            raise
        course.status = INTERRUPTED


@dataclass(frozen=True, eq=False, kw_only=True)
class StudyResult(Result):
    """The findings of one study. A study's own result derives from this and adds its fields."""

    program = "study"
    schema: ClassVar[str] = "ssmr.study/1"
    study: ClassVar[str]
    """Name of the study, as on the command line."""
    title: ClassVar[str]
    """Heading of the report."""
    robot: str = USUAL_ROBOT
    """Name of the robot that was studied."""
    versions: Mapping[str, str] = field(default_factory=store.versions)
    """Versions of this project, Python and the packages that decide numbers."""
    status: str = FINISHED
    """`finished`, or `interrupted`: then it holds the cases that were finished before, and no others."""

    @abstractmethod
    def heading(self) -> str:
        """Return what was studied, in one line that names the profile."""

    @abstractmethod
    def findings(self) -> dict[str, Any]:
        """Return what study.json holds besides its schema, the study's name and the versions."""

    def of_profile(self, profile: str) -> str:
        """Return in words which profile was studied, and which robot where the profile's name does not tell it."""
        return f"profile {with_robot(profile, self.robot)}"

    @property
    def made_by(self) -> str:
        """Profile, versions and command, as the footer of a picture has them; the result has a `profile`."""
        of, versions = self.of_profile(getattr(self, "profile", "")), self.versions
        used = " · ".join(f"{name} {versions.get(name, '?')}" for name in ("mujoco", "ssmr-testbed"))
        return f"{of} · {used} · python -m validation.study {self.study}"

    def figure(self) -> Figure:
        """Return its picture: what `draw_NAME` of the module `figure` in the study's package makes of it."""
        drawn: Figure = getattr(import_module(f"validation.study.{self.study}.figure"), f"draw_{self.study}")(self)
        return drawn

    def report_grids(self) -> Sequence[Grid]:
        """Return the tables of the report: those of the terminal, unless a study has more."""
        return self.grids()

    def explanations(self) -> Sequence[str]:
        """Return sentences on what the columns mean, for the report."""
        return ()

    def as_dict(self) -> dict[str, Any]:
        """Return what study.json holds: plain values, no NaN."""
        own = {"schema": self.schema, "study": self.study, "status": self.status, "robot": self.robot}
        whole = {**own, **self.findings(), "versions": dict(self.versions)}
        return dict(store.plain(whole))

    def report(self) -> list[str]:
        """Return study.md as lines: heading, tables with their captions, notes, versions."""
        lines = [f"# {self.title}: {markdown(self.heading())}", ""]
        if self.status != FINISHED:
            lines += ["The study was interrupted; only what was finished before is here.", ""]
        for grid in self.report_grids():
            lines += [f"## {markdown(grid.title)}", "", *markdown_table(grid), ""]
            lines += [markdown(grid.caption), ""] if grid.caption else []
        for title, sentences in (("Columns", self.explanations()), ("Notes", self.notes())):
            lines += [f"## {title}", "", *(f"- {markdown(sentence)}" for sentence in sentences), ""] if sentences else []
        return [*lines, ", ".join(f"{name} {self.versions[name]}" for name in _REPORTED if name in self.versions) + ".", ""]


def profile_of(profile: Profile | str | None, robot: Robot | str | None = None, usual: str = "thesis-lab") -> Profile:
    """Return a profile: itself, a shipped one by name, or one from the path of a TOML file.

    Without a profile it is the usual one, or the robot's own numbers if that is of another robot than `robot`.

    Raises:
        ValueError: there is none of that name, its numbers are wrong, or it is of another robot.
    """
    return choose_profile(profile, robot, usual)
