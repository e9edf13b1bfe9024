"""The sections of a replication, and what a section needs and finds.

A section runs by itself and answers for some tables of the thesis. Its findings are kept as `sections/KEY.json` and its
pictures in `figures/`, each written whole or not at all, the JSON file last. They are used again as long as settings,
inputs, code and versions are the same, see `keeping`.
"""

from __future__ import annotations

import hashlib
import json
import logging
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from matplotlib.figure import Figure

from ssmr.parameters import MOST_SEED, require_within
from ssmr.search.jde import JdeSettings
from validation import store
from validation.files import reading
from validation.fit.checkpoint import CheckpointError
from validation.fit.data import SearchData
from validation.fit.targets import MOST_TIME
from validation.progress import Report, silent
from validation.report.drawing import save_figure
from validation.report.tables import Grid
from validation.simulator.description import models_folder
from validation.thesis.verdicts import Pair

_R = TypeVar("_R", bound=SearchData)
_log = logging.getLogger(__name__)
SECTION_FOLDER, FIGURE_FOLDER = "sections", "figures"
"""Names of the folders inside that of the results."""
_PRESENTATION = frozenset(
    {
        "replicate/__main__.py",
        "replicate/result.py",
        "replicate/report.py",
        "replicate/tables.py",
        "replicate/templates/replicate.html",
        "thesis/verdicts.py",
    }
)
"""Paths of modules that only judge and show findings: after a change to one of them, kept findings are used again."""


@dataclass(frozen=True)
class Table:
    """A table of the thesis beside ours."""

    caption: str
    """Caption in this project's words."""
    rows: Mapping[str, Mapping[str, Pair]]
    """Printed and own numbers by row and metric, which are named as in `published.toml`."""


@dataclass(frozen=True)
class Picture:
    """A picture that was written."""

    file: str
    """Name of the file in `figures/`."""
    caption: str
    """Description of what it shows."""


@dataclass(frozen=True)
class Findings:
    """The findings of a section."""

    tables: Mapping[str, Table] = field(default_factory=dict)
    """Tables by their number in the thesis, or by its section or figure where it has no table."""
    grids: Mapping[str, Grid] = field(default_factory=dict)
    """Tables without a counterpart in the thesis, by caption."""
    notes: tuple[str, ...] = ()
    """Sentences on how the numbers were found, and on their limits."""
    pictures: tuple[Picture, ...] = ()
    """Pictures, in the order of the report."""
    numbers: Mapping[str, Any] = field(default_factory=dict)
    """Further numbers for replicate.json, ready for JSON."""


@dataclass(frozen=True)
class ReplicationSettings:
    """Everything that decides the numbers of a replication."""

    quick: bool = False
    """Whether budgets are reduced; the report says so in every chapter that it concerns."""
    seed: int = 1
    """Seed of the searches."""
    fit_population: int = 50
    """Number of candidates of a fit (Tab. 3.7, 3.10, 3.13)."""
    fit_generations: int = 300
    """Greatest number of generations of a fit (Tab. 3.7, 3.10, 3.13)."""
    noise_seeds: int = 10
    """Number of draws of noise and disturbance for each row of chapter 4."""
    tune_seeds: int = 3
    """Number of searches for each controller's gains."""
    tune_population: int | None = None
    """Number of candidates of a tuning; None for that of Tab. 4.3 and 4.20."""
    tune_generations: int | None = None
    """Greatest number of generations of a tuning; None for that of Tab. 4.3 and 4.20."""
    repeats: int = 25
    """Number of runs of a simulation that is timed."""
    recording: str = ""
    """Path of a real robot's recording; empty for none."""
    split: float | None = None
    """Time after which the recording is scored by itself [s]; None for the end of what `husky-tile` was fitted to."""

    def __post_init__(self) -> None:
        """Check the ranges, before hours of work.

        Raises:
            ValueError: a number is out of its range; the message names it.
        """
        counts = ("noise_seeds", "tune_seeds", "repeats")
        require_within(self, counts, 1, 1000, whole=True)
        require_within(self, ("seed",), 0, MOST_SEED - 1000, whole=True)  # others are counted from it
        JdeSettings(self.fit_population, self.fit_generations)
        JdeSettings(50 if self.tune_population is None else self.tune_population, self.tune_generations or 1)
        require_within(self, ("split",), -MOST_TIME, MOST_TIME)


QUICK_SETTINGS = ReplicationSettings(
    quick=True, fit_population=20, fit_generations=25, noise_seeds=2, tune_seeds=1, tune_population=20, tune_generations=12,
    repeats=7,
)  # fmt: skip
"""Reduced budgets, which take under three minutes."""


@dataclass(frozen=True)
class Context:
    """Everything that a section needs to run."""

    settings: ReplicationSettings
    """Settings of the replication."""
    folder: Path
    """Folder of the results."""
    key: str
    """Key of the section."""
    digest: str
    """Digest of everything that decides its findings."""
    workers: int
    """Number of threads; only times depend on it."""
    progress: Report = silent
    """Callback for the progress of the section."""

    def picture(self, name: str, figure: Figure, caption: str) -> Picture:
        """Write a picture into the folder of the results."""
        file = f"{self.key}-{name}.png"
        save_figure(figure, self.folder / FIGURE_FOLDER / file)
        return Picture(file, caption)

    def checkpoint(self, name: str) -> Path:
        """Return the file in which a search of the section keeps its state; its name depends on the digest."""
        return self.folder / SECTION_FOLDER / f"{self.key}-{name}.{self.digest[:12]}.npz"


def searched(context: Context, name: str, search: Callable[[dict[str, Any], Report], _R]) -> _R:
    """Search to the end, from where a search of the same name and digest stopped, if there is one.

    Args:
        context: settings and folder of the section.
        name: name of the search.
        search: makes the result, with these options of the search and this callback for progress.

    Raises:
        KeyboardInterrupt: it was stopped; its state is on disk.
    """
    state = context.checkpoint(name)
    options = {"checkpoint": state, "workers": context.workers}
    try:
        result = search({**options, "resume": state.is_file()}, context.progress)
    except CheckpointError as error:
        _log.warning("%s; the search begins anew", error)
        result = search({**options, "resume": False}, context.progress)
    if result.status == "interrupted":
        raise KeyboardInterrupt
    return result


@dataclass(frozen=True)
class Section:
    """One section of a replication, declared."""

    key: str
    """Name on the command line and on disk."""
    title: str
    """Heading."""
    tables: tuple[str, ...]
    """Numbers of the tables that it answers for."""
    needs: tuple[str, ...]
    """Names of the settings that decide its findings."""
    run: Callable[[Context], Findings]
    """Function that returns its findings."""
    installed: Callable[[], bool] = lambda: True
    """Function that says whether what it needs beside Python packages is installed."""

    def digest(self, settings: ReplicationSettings) -> str:
        """Return a digest of settings, inputs, code and versions, which decide its findings."""
        chosen = {name: getattr(settings, name) for name in self.needs}
        recording = chosen.get("recording")
        if recording:
            path, read = Path(recording), hashlib.sha256()
            for part in sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]:
                with reading.opened(part, sys.maxsize) as stream:
                    while block := stream.read(1 << 20):
                        read.update(block)
            chosen["recording"] = read.hexdigest()
        inputs = {"settings": chosen, "versions": store.versions(), "installed": self.installed(), "code": code_digest()}
        whole = {"section": self.key, **inputs}
        return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()


@cache
def code_digest() -> str:
    """Return a digest of all files that decide numbers: sources, models, profiles, gains, references, printed tables."""
    package = Path(__file__).resolve().parents[1]
    kinds = ("*.py", "*.toml", "*.csv", "*.html")
    files = [*(package.parent / "ssmr").rglob("*.py"), *(p for kind in kinds for p in package.rglob(kind))]
    files += models_folder().glob("husky.*")
    digest = hashlib.sha256()
    for path in sorted(files):
        name = path.relative_to(package).as_posix() if path.is_relative_to(package) else path.name
        if name not in _PRESENTATION:
            digest.update(name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


class Answer(NamedTuple):
    """A section with its findings."""

    section: Section
    """The section that ran."""
    findings: Findings
    """Its findings."""
    wall_s: float
    """Time that it took on the clock [s]."""
    cpu_s: float
    """Time that it took of all processors together [s]."""


def chosen_sections(sections: Sequence[Section], names: Sequence[str]) -> tuple[Section, ...]:
    """Return the sections with these keys or tables, in their own order; all sections if no name is given.

    Raises:
        ValueError: no section has such a key or table.
    """
    for name in names:
        if not any(name == s.key or name in s.tables for s in sections):
            known = ", ".join(s.key for s in sections)
            raise ValueError(
                f"'{name}' in only is no section ({known}) and no table that one of them answers for, such as 3.9"
            )
    return tuple(s for s in sections if not names or s.key in names or any(t in names for t in s.tables))
