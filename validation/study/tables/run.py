"""The thesis' tables of tracked references (Tab. 4.5-4.36) with this project's robots: printed beside what comes out.

Reference against simulated: the improved model with noise and disturbance, as in the thesis' simulations. Simulated against
real: the MuJoCo Husky stands where the real robot stood, with the lab's noise and, as in a lab, nobody pushing it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from ssmr.control.loop import ClosedRun, LoopSettings
from ssmr.metrics.declared import Metrics, compare_paths
from validation import store
from validation.plants.profile import Profile
from validation.show.drawing import draw_footer, inset, put_together, side_by_side, text_row
from validation.show.tables import NOTHING, Cell, Grid, markdown_table
from validation.thesis import published
from validation.thesis.verdicts import FACTOR
from validation.track.gains import load_gains
from validation.track.tracking import make_controller, make_robot, rate, run_robots
from validation.track.waypoint_files import open_reference

SCHEMA = "ssmr.study/1"
TABLES = tuple(f"4.{i}" for i in (*range(5, 20), *range(22, 37)))
"""Those of single references; 4.37 and 4.38 repeat them."""
METRICS = ("d_rms_m", "d_haus_m", "d_ratio")
"""Of each row. Reference against simulated: a d_rms of at most `FACTOR` times the printed one agrees."""
REAL_SEEDS = 1000
"""Where the seeds of the MuJoCo Husky's noise begin: the real robot's noise was not the simulation's."""
KNOWN = ("line", "circle")
"""References whose geometry the thesis tells."""

Comparison = Literal["reference_vs_simulated", "simulated_vs_real"]


@dataclass(frozen=True)
class Entry:
    """One row of one table."""

    table: str
    """Its number."""
    comparison: Comparison
    """What is held against what."""
    controller: str
    """`pid` or `lqr`."""
    gains: str
    """Name of the gain set."""
    reference: str
    """Which one."""
    speed: float
    """Of the reference [m/s]."""
    printed: Mapping[str, float]
    """By metric; empty where the table is lost."""
    suspect: str
    """Why the print is not to be believed; empty else."""
    mean: Mapping[str, float]
    """By metric, over the seeds that kept the reference; empty if none did."""
    deviation: Mapping[str, float]
    """Standard deviation over the same."""
    lost: int
    """Seeds that lost the reference."""
    n: int
    """Seeds."""
    mujoco: Mapping[str, float]
    """Reference against simulated: the same of the MuJoCo Husky, which nobody pushes; else empty."""

    @property
    def verdict(self) -> str:
        """In words."""
        if not self.printed:
            return "print lost"
        if not self.mean:
            return "lost the reference"
        limit = self.printed["d_rms_m"] * (FACTOR if self.comparison == "reference_vs_simulated" else 1.0)
        if self.mean["d_rms_m"] <= limit:
            return "agrees"
        if self.suspect:
            return "print is suspect"
        return "differs" if self.reference in KNOWN else "other geometry"


def _entry(
    number: str, profile: Profile, seeds: int, workers: int | None, runs: dict[tuple[str, str, float, str], list[ClosedRun]]
) -> Entry:
    content = published.table(number)
    controller, reference, speed = content["controller"], content["trajectory"], float(content["speed_m_s"])
    gains = load_gains(controller, content.get("gains", "published"))
    law = make_controller(profile, gains)
    _, waypoints = open_reference(reference, speed)

    def driven(plant: str) -> list[ClosedRun]:
        key = (controller, reference, speed, plant)
        if key not in runs:
            robot = make_robot(profile, plant)
            real = plant == "mujoco"
            settings = LoopSettings(disturbance=not real)
            first = REAL_SEEDS if real else 0
            runs[key] = run_robots(
                [robot] * seeds, [law] * seeds, [settings] * seeds, waypoints, range(first, first + seeds), workers
            )
        return runs[key]

    def followed(plant: str) -> list[Metrics]:
        robot = make_robot(profile, plant)
        return [rate(run, waypoints, robot) for run in driven(plant) if not run.lost]

    husky: list[Metrics] = []
    if content["comparison"] == "reference_vs_simulated":
        found, husky = followed("improved"), followed("mujoco")
    else:
        both = zip(driven("improved"), driven("mujoco"), strict=True)
        found = [compare_paths(s.motion, r.motion) for s, r in both if not (s.lost or r.lost)]
    table = np.array([[m[name] for name in METRICS] for m in found]).reshape(-1, len(METRICS))
    rows = list(content["rows"])
    suspect = content.get("note", "") if content.get("suspect") else ""
    if number == "4.23":
        suspect = "its gap is not that of the printed gains (docs/errata.md, 43)"
    return Entry(
        number,
        content["comparison"],
        controller,
        gains.name,
        reference,
        speed,
        {m: published.value(number, rows[0], m) for m in METRICS} if rows else {},
        suspect,
        dict(zip(METRICS, map(float, table.mean(axis=0)), strict=True)) if len(table) else {},
        dict(zip(METRICS, map(float, table.std(axis=0)), strict=True)) if len(table) else {},
        seeds - len(table),
        seeds,
        {name: float(np.mean([m[name] for m in husky])) for name in METRICS} if husky else {},
    )


@dataclass(frozen=True)
class ControlTables:
    """All rows, and how they were made."""

    profile: str
    """Name of the profile."""
    seeds: int
    """Draws of noise and disturbance for each row."""
    entries: tuple[Entry, ...]
    """In the order of the thesis."""
    versions: Mapping[str, str]
    """Of this project, Python and the packages that decide numbers."""


def study_tables(
    profile: Profile, seeds: int, workers: int | None = None, on_table: Callable[[str], object] | None = None
) -> ControlTables:
    """Make every row.

    Args:
        profile: of both plants.
        seeds: draws of noise and disturbance for each row.
        workers: threads; the result does not depend on it.
        on_table: told the number of each table when it is done.

    Raises:
        ValueError: no seeds.
    """
    if seeds < 1:
        raise ValueError(f"--seeds {seeds} must be positive")
    entries, runs = [], dict[tuple[str, str, float, str], list[ClosedRun]]()
    for number in TABLES:
        entries.append(_entry(number, profile, seeds, workers, runs))
        if on_table is not None:
            on_table(number)
    return ControlTables(profile.name, seeds, tuple(entries), store.versions())


def _text(values: Mapping[str, float], name: str) -> str:
    if name not in values:
        return NOTHING
    return f"{values[name]:.4f}" if name == "d_ratio" else f"{1e3 * values[name]:.1f}"


def grid(study: ControlTables, comparison: Comparison) -> Grid:
    """A table a row; the thesis' three figures beside ours."""
    rows = []
    for e in study.entries:
        if e.comparison == comparison:
            spread = f" ± {1e3 * e.deviation['d_rms_m']:.1f}" if e.deviation else ""
            rows.append(
                (
                    Cell(e.table),
                    Cell(e.controller),
                    Cell(f"{e.reference} {e.speed:g}"),
                    Cell(e.verdict),
                    *(
                        Cell(text)
                        for name in METRICS
                        for text in (
                            _text(e.printed, name),
                            _text(e.mean, name) + (spread if name == "d_rms_m" else ""),
                        )
                    ),
                )
            )
    header = (
        *(("Tab.", ""), ("law", ""), ("reference", ""), ("verdict", "")),
        *(("d_rms printed", "mm"), ("ours", "mm"), ("d_haus printed", "mm"), ("ours", "mm")),
        *(("d_ratio printed", ""), ("ours", "")),
    )
    return Grid(header, (tuple(rows),), left=4)


CAPTIONS: Mapping[Comparison, str] = {
    "reference_vs_simulated": "Reference against simulated: the improved model, with noise and disturbance",
    "simulated_vs_real": "Simulated against real: the improved model against the MuJoCo Husky",
}


def markdown(study: ControlTables) -> list[str]:
    """Both tables, in markdown."""
    out = [f"{study.seeds} seeds a row; profile {study.profile}; ± is the standard deviation over seeds.", ""]
    for comparison, caption in CAPTIONS.items():
        out += [f"**{caption}**", "", *markdown_table(grid(study, comparison)), ""]
    return out


def as_document(study: ControlTables) -> dict[str, Any]:
    """study.json."""
    document = {
        "schema": SCHEMA,
        "study": "tables",
        "profile": study.profile,
        "seeds": study.seeds,
        "versions": dict(study.versions),
        "tables": {
            e.table: {
                "comparison": e.comparison,
                "controller": e.controller,
                "gains": e.gains,
                "reference": e.reference,
                "speed_m_s": e.speed,
                "verdict": e.verdict,
                "note": e.suspect,
                "lost": e.lost,
                "printed": dict(e.printed),
                "ours": dict(e.mean),
                "deviation": dict(e.deviation),
                "mujoco": dict(e.mujoco),
            }
            for e in study.entries
        },
    }
    plain = store.plain(document)
    assert isinstance(plain, dict)
    return plain


def _draw(entries: Sequence[Entry], title: str, ax: Axes) -> None:
    """Printed and our d_rms, a table a row."""
    for k, e in enumerate(entries):
        ink = {"agrees": "#009e73", "differs": "#d55e00"}.get(e.verdict, "#777777")
        if e.mean:
            ax.errorbar(e.mean["d_rms_m"] * 1e3, k, xerr=e.deviation["d_rms_m"] * 1e3, fmt="o", color=ink, ms=6, capsize=3)
        if e.printed:
            ax.plot(e.printed["d_rms_m"] * 1e3, k, "|", color="black", ms=14, mew=2)
    ax.set_yticks(range(len(entries)), [f"{e.table}  {e.controller} {e.reference} {e.speed:g} m/s" for e in entries])
    ax.set_ylim(len(entries) - 0.5, -0.5)
    inset(ax, left=1.7)
    ax.set_xscale("log")
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_xlabel("d_rms [mm]")
    ax.set_title(title, loc="left", fontsize=11)
    ax.grid(axis="x", which="both", alpha=0.25)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def draw_tables(study: ControlTables) -> Figure:
    """Printed against ours, both comparisons side by side."""
    panels = []
    for comparison in CAPTIONS:
        some = [e for e in study.entries if e.comparison == comparison]
        title = comparison.replace("_", " ").replace("vs", "against")
        panels.append(lambda ax, some=some, title=title: _draw(some, title, ax))
    foot = (
        f"bar: printed · dot: ours, mean and standard deviation of {study.seeds} seeds · green: agrees · red: differs · "
        f"grey: print lost or suspect, or a geometry that the thesis does not tell · profile {study.profile}"
    )
    return put_together([side_by_side(5.2, panels), text_row(0.3, lambda ax: draw_footer(foot, ax))])
