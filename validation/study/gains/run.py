"""Every shipped set of gains on every named reference at both speeds, on a planar model and on the MuJoCo Husky."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from ssmr.control.loop import LoopSettings
from validation import store
from validation.plants.profile import Profile
from validation.show.drawing import controller_ink, draw_footer, inset, line_legend, put_together, side_by_side, text_row
from validation.show.tables import NOTHING, Cell, Grid, markdown_table
from validation.track.gains import load_gains, names
from validation.track.tracking import make_controller, make_robot, rate, run_robots
from validation.track.waypoint_files import REFERENCES, open_reference
from validation.tune.cost import TuneCost, costs_of

SCHEMA = "ssmr.study/1"
SPEEDS = (0.25, 0.5)
"""The thesis' [m/s]."""
COST = TuneCost(guard=0.0)
"""Sec. 4.3.3 for all laws alike, so that they can be compared."""


@dataclass(frozen=True)
class Score:
    """One set of gains on one reference."""

    gains: str
    """Name of the set."""
    plant: str
    """Which robot."""
    reference: str
    """Which one."""
    speed: float
    """Of the reference [m/s]."""
    cost: float | None
    """Mean over the seeds; None where one lost the reference."""
    d_rms_m: float | None
    """The same."""
    e_rho_rms_m: float | None
    """The same."""
    lost: int
    """Seeds that lost the reference."""


@dataclass(frozen=True)
class GainStudy:
    """All scores, and how they were made."""

    profile: str
    """Name of the profile."""
    seeds: tuple[int, ...]
    """Of noise and disturbance; no tuning has seen them."""
    plants: tuple[str, ...]
    """Which robots."""
    scores: tuple[Score, ...]
    """By plant, reference, speed and set."""
    versions: Mapping[str, str]
    """Of this project, Python and the packages that decide numbers."""

    @property
    def sets(self) -> tuple[str, ...]:
        """Names of the sets, in order."""
        return tuple(dict.fromkeys(s.gains for s in self.scores))

    def of(self, plant: str) -> list[tuple[str, list[Score]]]:
        """By reference and speed, the scores of all sets on a plant."""
        rows: dict[str, list[Score]] = {}
        for s in self.scores:
            if s.plant == plant:
                rows.setdefault(f"{s.reference} {s.speed:g}", []).append(s)
        return list(rows.items())


def study_gains(
    profile: Profile,
    plants: Sequence[str],
    seeds: Sequence[int],
    workers: int | None = None,
    on_reference: Callable[[str], object] | None = None,
) -> GainStudy:
    """Drive every set along every reference.

    Args:
        profile: of the plants.
        plants: which ones.
        seeds: of noise and disturbance.
        workers: threads; the result does not depend on it.
        on_reference: told what is done.
    """
    sets = [load_gains(name.rpartition("-")[0], name) for name in names()]
    laws = [make_controller(profile, g) for g in sets]
    scores = []
    for plant in plants:
        robot = make_robot(profile, plant)
        for reference in REFERENCES:
            for speed in SPEEDS:
                _, waypoints = open_reference(reference, speed)
                target, n = waypoints.trajectory(LoopSettings().position_period), len(seeds)
                runs = run_robots(
                    [robot] * n * len(laws), [law for law in laws for _ in seeds], [LoopSettings()] * n * len(laws),
                    waypoints, seeds, workers,
                )  # fmt: skip
                for k, g in enumerate(sets):
                    mine = runs[k * n : (k + 1) * n]
                    lost = sum(run.lost for run in mine)
                    rated = [] if lost else [rate(run, waypoints, robot) for run in mine]
                    scores.append(
                        Score(
                            g.name,
                            plant,
                            reference,
                            speed,
                            float(np.mean(costs_of(mine, target, waypoints.speed, COST))) if rated else None,
                            float(np.mean([r["d_rms_m"] for r in rated])) if rated else None,
                            float(np.mean([r["e_rho_rms_m"] for r in rated])) if rated else None,
                            lost,
                        )
                    )
                if on_reference is not None:
                    on_reference(f"{plant}: {reference} {speed:g}")
    return GainStudy(profile.name, tuple(seeds), tuple(plants), tuple(scores), store.versions())


MEASURES: Mapping[str, tuple[str, str]] = {"cost": ("Cost of Sec. 4.3.3", ""), "d_rms_m": ("d_rms", "mm")}
"""What tables show, with title and unit."""


def grid(study: GainStudy, plant: str, measure: str) -> Grid:
    """One measure of every set, a reference a row; the least of each row is emphasised."""
    scale, digits = (1e3, 1) if measure == "d_rms_m" else (1.0, 2)
    rows, every = [], dict[str, list[float | None]]()
    for label, scores in study.of(plant):
        values = [getattr(s, measure) for s in scores]
        least = min((v for v in values if v is not None), default=None)
        rows.append((Cell(label), *(Cell("lost" if v is None else f"{scale * v:.{digits}f}", v == least) for v in values)))
        for s, v in zip(scores, values, strict=True):
            every.setdefault(s.gains, []).append(v)
    means = []
    for values in every.values():
        known = [v for v in values if v is not None]
        means.append(Cell(f"{scale * np.mean(known):.{digits}f}" if len(known) == len(values) else NOTHING))
    rows.append((Cell("mean"), *means))
    unit = MEASURES[measure][1]
    return Grid((("reference", ""), *((" ".join(n.rsplit("-", 1)), unit) for n in study.sets)), (tuple(rows),), left=1)


def tables(study: GainStudy) -> list[tuple[Grid, str]]:
    """All tables with their titles."""
    return [
        (grid(study, plant, m), f"{title}, plant {plant}") for plant in study.plants for m, (title, _) in MEASURES.items()
    ]


def markdown(study: GainStudy) -> list[str]:
    """All tables, in markdown."""
    out = [f"Means over the seeds {', '.join(map(str, study.seeds))}; profile {study.profile}.", ""]
    for table, title in tables(study):
        out += [f"**{title}**", "", *markdown_table(table), ""]
    return out


def as_document(study: GainStudy) -> dict[str, Any]:
    """study.json."""
    plain = store.plain(
        {
            "schema": SCHEMA,
            "study": "gains",
            "profile": study.profile,
            "seeds": list(study.seeds),
            "plants": list(study.plants),
            "versions": dict(study.versions),
            "scores": [vars(s) for s in study.scores],
        }
    )
    assert isinstance(plain, dict)
    return plain


def _draw(study: GainStudy, plant: str, ax: Axes) -> None:
    rows = study.of(plant)
    marks = {"published": "s", "manual": "D", "tuned": "o"}
    for name in study.sets:
        controller, _, kind = name.rpartition("-")
        points = [
            (s.cost, k) for k, (_, scores) in enumerate(rows) for s in scores if s.gains == name and s.cost is not None
        ]
        if points:
            face = controller_ink(controller) if kind == "tuned" else "white"
            ax.plot(
                *zip(*points, strict=True),
                marks[kind],
                color=controller_ink(controller),
                mfc=face,
                ms=7,
                mew=1.5,
                label=name,
            )
    inset(ax, left=1.0)
    ax.set_yticks(range(len(rows)), [label for label, _ in rows])
    ax.set_ylim(len(rows) - 0.5, -0.5)
    ax.set_xscale("log")
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_xlabel("cost, Sec. 4.3.3")
    ax.set_title(plant, loc="left", fontsize=11)
    ax.grid(axis="both", which="major", alpha=0.3)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def draw_gains(study: GainStudy) -> Figure:
    """Costs by reference, a panel for each plant."""
    panels = [lambda ax, plant=plant: _draw(study, plant, ax) for plant in study.plants]

    def legend(ax: Axes) -> None:
        ax.set_axis_off()
        drawn = ax.get_figure(root=True)
        assert drawn is not None
        handles, labels = drawn.axes[0].get_legend_handles_labels()
        line_legend(ax, handles, labels)

    foot = f"means over {len(study.seeds)} seeds of noise and disturbance that no tuning has seen · profile {study.profile}"
    return put_together([side_by_side(3.8, panels), text_row(0.45, legend), text_row(0.3, lambda ax: draw_footer(foot, ax))])
