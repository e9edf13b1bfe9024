"""Columns, tables and files of studies that take the same measures of many variants."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, ClassVar

from ssmr.errors import SsmrError
from validation.report.tables import NOTHING, Cell, Grid, Unit
from validation.study.result import StudyResult


@dataclass(frozen=True)
class MeasureColumn:
    """One measure, as tables and picture show it."""

    name: str
    """Heading of the column."""
    unit: Unit
    """Unit in which it is shown."""
    value: Callable[[Any], float | None]
    """Function that takes it from the measures of a variant [SI]."""
    table: str
    """Title of the table that has it."""
    meaning: str
    """Explanation in a few words."""
    limits: tuple[float, float] | None = None
    """Value up to which it is good, and value from which on it is bad [SI]; None for a measure that is not judged."""

    def text(self, measures: Any) -> str:
        """Return the measure as it is written, without its unit."""
        value = self.value(measures)
        return NOTHING if value is None else self.unit.text(value)


@dataclass(frozen=True, eq=False)
class Tried:
    """A variant with what was measured."""

    variant: Any
    """Settings that were tried: a dataclass with `group`, `name`, `key`, `settings`, and `changes` of the calibration."""
    measures: Any
    """Measures, a dataclass; None for one that could not be taken."""
    failures: Mapping[str, str]
    """Reason for each drive that failed, by its name."""


class Attempts:
    """Measures of a variant as they are taken, with the reason for each that could not be taken."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self.found: dict[str, Any] = {}
        self.failures: dict[str, str] = {}

    def attempt(self, what: str, measure: Callable[[], Mapping[str, Any]]) -> bool:
        """Take some measures, and return whether drive and numbers allowed it."""
        try:
            self.found.update(measure())
        except (SsmrError, ValueError) as error:
            self.failures[what] = " ".join(str(error).split())
        return what not in self.failures


@dataclass(frozen=True, eq=False)
class MeasuredStudy(StudyResult):
    """Measures of many variants of a robot; a study derives from this and names its columns."""

    all_columns: ClassVar[tuple[MeasureColumn, ...]]
    """Every measure, in the order of tables."""
    profile: str
    """Name of the lab robot's profile."""
    recording: str | None
    """Name of the recording; None for none."""
    recording_profile: str | None
    """Name of the recorded robot's profile; None without a recording."""
    tried: tuple[Tried, ...]
    """Variants with their measures."""

    def by_group(self) -> dict[str, list[Tried]]:
        """Return the variants by group, in order."""
        groups: dict[str, list[Tried]] = {}
        for tried in self.tried:
            groups.setdefault(tried.variant.group, []).append(tried)
        return groups

    def columns(self) -> tuple[MeasureColumn, ...]:
        """Return the columns in which at least one variant has a number."""
        return tuple(c for c in self.all_columns if any(c.value(t.measures) is not None for t in self.tried))

    def heading(self) -> str:
        """Return what was studied, in one line."""
        text = f"{len(self.tried)} settings, {self.of_profile(self.profile)}"
        return text if self.recording is None else f"{text}; recording with profile {self.recording_profile}"

    def notes(self) -> list[str]:
        """Return a sentence for each measure that could not be taken."""
        return [f"{t.variant.key}: {what} failed: {why}." for t in self.tried for what, why in t.failures.items()]

    def grids(self) -> list[Grid]:
        """Return the measures by variant, a table for each title."""
        titles = list(dict.fromkeys(c.table for c in self.all_columns))
        return [self._measure_grid(title, first=title == titles[0]) for title in titles]

    def explanations(self) -> list[str]:
        """Return what each column means."""
        return [f"{c.name}: {c.meaning}" for c in self.columns()]

    def findings(self) -> dict[str, Any]:
        """Return each variant's settings, measures and failures."""
        recorded = {"recording": self.recording, "recording_profile": self.recording_profile}
        return {"profile": self.profile, **recorded, "variants": list(map(self.found_of, self.tried))}

    def found_of(self, tried: Tried) -> dict[str, Any]:
        """Return what study.json holds of a variant."""
        v, measures = tried.variant, tried.measures
        return {
            "group": v.group,
            "name": v.name,
            "settings": {k: value for k, value in asdict(v.settings).items() if value is not None},
            "calibration": dict(v.changes),
            **{f.name: getattr(measures, f.name) for f in fields(measures)},
            "failures": dict(tried.failures),
        }

    def _measure_grid(self, title: str, *, first: bool) -> Grid:
        columns = [c for c in self.columns() if c.table == title]
        header = [(c.name, c.unit.symbol) for c in columns]
        shown = f"{title}, {self.heading()}" if first else title
        return self.grouped(header, lambda t: [c.text(t.measures) for c in columns], shown)

    def grouped(self, header: Sequence[tuple[str, str]], texts: Callable[[Any], Sequence[str]], title: str) -> Grid:
        """Return a table with a row a variant, below the name of its group."""
        groups = []
        for group, tried in self.by_group().items():
            rows = [(Cell(group, best=True), *(Cell("") for _ in header))]
            rows += [(Cell(f"  {t.variant.name}"), *map(Cell, texts(t))) for t in tried]
            groups.append(tuple(rows))
        return Grid((("setting", ""), *header), tuple(groups), 1, title)
