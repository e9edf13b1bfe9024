"""What the parts of a replication find, and how it is kept on disk so that an interrupted one goes on where it stopped.

A section is a part that runs by itself and answers for some of the thesis' tables. What it finds is kept as
`sections/KEY.json`, its pictures beside it in `figures/`, each written whole or not at all, the JSON last; it is used again
where settings, inputs, code and versions are the same, which one digest stands for.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from matplotlib.figure import Figure

from validation import cli, store
from validation.fit.data import SearchData
from validation.fit.search import CheckpointError
from validation.progress import Report
from validation.robots.husky import xml_path
from validation.show.drawing import save_figure
from validation.show.tables import Cell, Grid
from validation.thesis.verdicts import Pair

R = TypeVar("R", bound=SearchData)
SCHEMA = "ssmr.evidence/1"
SECTIONS, FIGURES = "sections", "figures"
"""Folders in that of the results."""
PRESENTATION = frozenset(
    {
        "replicate/__main__.py",
        "replicate/run.py",
        "replicate/report.py",
        "replicate/tables.py",
        "replicate/html_page.py",
        "replicate/templates/replicate.html",
        "thesis/verdicts.py",
    }
)
"""Modules of `validation` that only judge and show what was found: a change to one of them makes nothing stale."""


@dataclass(frozen=True)
class Table:
    """A table of the thesis beside ours."""

    caption: str
    """What it holds, in this project's words."""
    rows: Mapping[str, Mapping[str, Pair]]
    """By row, then by metric; rows and metrics are named as in `published.toml`."""


@dataclass(frozen=True)
class Picture:
    """A figure that was written."""

    file: str
    """Its name in `figures/`."""
    caption: str
    """What is seen."""


@dataclass(frozen=True)
class Findings:
    """What a section found."""

    tables: Mapping[str, Table] = field(default_factory=dict)
    """By the thesis' number, or by section or figure where the thesis has no table."""
    grids: Mapping[str, Grid] = field(default_factory=dict)
    """Tables with no counterpart in the thesis, by their captions."""
    notes: tuple[str, ...] = ()
    """Sentences on how it was found and what to beware of."""
    pictures: tuple[Picture, ...] = ()
    """In the order in which they are shown."""
    numbers: Mapping[str, Any] = field(default_factory=dict)
    """More numbers for `replicate.json`, ready for JSON."""


@dataclass(frozen=True)
class Effort:
    """What a section took."""

    wall_s: float
    """Time on the clock [s]."""
    cpu_s: float
    """Of all processors together [s]."""


@dataclass(frozen=True)
class Settings:
    """What decides a replication's numbers, all of it."""

    quick: bool = False
    """Reduced budgets; stands in every chapter that it concerns."""
    seed: int = 1
    """Of the searches."""
    fit_population: int = 50
    """Candidates of a fit; Tab. 3.7, 3.10, 3.13."""
    fit_generations: int = 300
    """Of a fit at most; the same tables."""
    noise_seeds: int = 10
    """Draws of noise and disturbance for each row of chapter 4."""
    tune_seeds: int = 3
    """Searches for each controller's gains."""
    tune_population: int | None = None
    """Candidates of a tuning; None for those of Tab. 4.3 and 4.20."""
    tune_generations: int | None = None
    """Of a tuning at most; None likewise."""
    repeats: int = 25
    """Of a simulation that is timed."""
    recording: str = ""
    """Path of a real robot's recording; empty for none."""
    split: float | None = None
    """What was recorded after this time is scored by itself [s]; None: until where profile `husky-tile` was fitted."""


QUICK = Settings(
    quick=True, fit_population=20, fit_generations=25, noise_seeds=2, tune_seeds=1, tune_population=20, tune_generations=12,
    repeats=7,
)  # fmt: skip
"""What `--quick` means."""


@dataclass(frozen=True)
class Context:
    """What a section gets to work with."""

    settings: Settings
    """Of the replication."""
    folder: Path
    """Of the results."""
    key: str
    """Of the section."""
    digest: str
    """Of all that decides what it finds."""
    workers: int
    """Threads; what is found does not depend on them, but for times."""

    def picture(self, name: str, figure: Figure, caption: str) -> Picture:
        """Write a figure."""
        file = f"{self.key}-{name}.png"
        save_figure(figure, self.folder / FIGURES / file)
        return Picture(file, caption)

    def checkpoint(self, name: str) -> Path:
        """Where a search of the section keeps its state; another digest has another file."""
        return self.folder / SECTIONS / f"{self.key}-{name}.{self.digest[:12]}.npz"


def searched(context: Context, name: str, search: Callable[[dict[str, Any], Report], R]) -> R:
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
    with cli.shown(context.key) as show:
        try:
            result = search({**options, "resume": state.is_file()}, show)
        except CheckpointError as error:
            cli.warn(f"{error}; the search begins anew")
            result = search({**options, "resume": False}, show)
    if result.status == "interrupted":
        raise KeyboardInterrupt
    return result


@dataclass(frozen=True)
class Section:
    """A part of a replication."""

    key: str
    """Its name on the command line and on disk."""
    title: str
    """In words."""
    tables: tuple[str, ...]
    """What it answers for."""
    needs: tuple[str, ...]
    """Which settings decide what it finds."""
    run: Callable[[Context], Findings]
    """Find it."""

    def digest(self, settings: Settings) -> str:
        """Of settings, inputs, code and versions that decide what it finds."""
        chosen = {name: getattr(settings, name) for name in self.needs}
        recording = chosen.get("recording")
        if recording:
            path = Path(recording)
            files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
            chosen["recording"] = hashlib.sha256(b"".join(p.read_bytes() for p in files)).hexdigest()
        whole = {"section": self.key, "settings": chosen, "versions": store.versions(), "code": code_digest()}
        return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()


@cache
def code_digest() -> str:
    """Of everything in this project that decides numbers: sources, models, profiles, gains, references, printed tables."""
    package = Path(__file__).resolve().parents[1]
    kinds = ("*.py", "*.toml", "*.csv", "*.html")
    files = [*(package.parent / "ssmr").rglob("*.py"), *(p for kind in kinds for p in package.rglob(kind)), xml_path()]
    digest = hashlib.sha256()
    for path in sorted(files):
        name = path.relative_to(package).as_posix() if path.is_relative_to(package) else path.name
        if name not in PRESENTATION:
            digest.update(name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def keep(folder: Path, section: Section, digest: str, settings: Settings, found: Findings, effort: Effort) -> None:
    """Write what a section found, whole or not at all, and clear away its searches' states."""
    document = {
        "schema": SCHEMA,
        "section": section.key,
        "digest": digest,
        "settings": {name: getattr(settings, name) for name in section.needs},
        "versions": store.versions(),
        "effort": asdict(effort),
        "findings": asdict(found),
    }
    store.write_json(folder / SECTIONS / f"{section.key}.json", store.plain(document))
    for state in (folder / SECTIONS).glob(f"{section.key}-*.npz"):
        state.unlink(missing_ok=True)


def kept(folder: Path, section: Section, digest: str) -> tuple[Findings, Effort] | None:
    """What the section found before, if it is of this digest and whole; None else."""
    try:
        document = json.loads((folder / SECTIONS / f"{section.key}.json").read_text(encoding="utf-8"))
        if document["schema"] != SCHEMA or document["digest"] != digest:
            return None
        found, effort = _findings(document["findings"]), Effort(**document["effort"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
    whole = all((folder / FIGURES / picture.file).is_file() for picture in found.pictures)
    return (found, effort) if whole else None


def _findings(data: Mapping[str, Any]) -> Findings:
    if set(data) != {f.name for f in fields(Findings)}:
        raise ValueError("these are the findings of another version")
    return Findings(
        {
            number: Table(
                t["caption"], {row: {m: Pair(**pair) for m, pair in pairs.items()} for row, pairs in t["rows"].items()}
            )
            for number, t in data["tables"].items()
        },
        {caption: _grid(grid) for caption, grid in data["grids"].items()},
        tuple(data["notes"]),
        tuple(Picture(**picture) for picture in data["pictures"]),
        data["numbers"],
    )


def _grid(data: Mapping[str, Any]) -> Grid:
    header = tuple((name, unit) for name, unit in data["header"])
    groups = tuple(tuple(tuple(Cell(**cell) for cell in row) for row in group) for group in data["groups"])
    return Grid(header, groups, data["left"])


def choose(sections: Sequence[Section], wanted: str) -> tuple[Section, ...]:
    """The sections that a list of keys and table numbers names, in their own order; all for an empty list.

    Raises:
        ValueError: a name that none answers to.
    """
    names = [part.strip() for part in wanted.split(",") if part.strip()]
    for name in names:
        if not any(name == s.key or name in s.tables for s in sections):
            known = ", ".join(s.key for s in sections)
            raise ValueError(
                f"--only '{name}' is no section ({known}) and no table that one of them answers for, such as 3.9"
            )
    return tuple(s for s in sections if not names or s.key in names or any(t in names for t in s.tables))
