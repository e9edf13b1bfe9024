"""A tuning as one picture: the course of the search, the gains, and the paths that tuned and earlier gains lead to."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ssmr.control.loop import ClosedRun
from validation.bench.tracked import gains_text
from validation.fit.search_figure import SearchLooks, draw_title, search_page, title_path
from validation.report import drawing
from validation.report.drawing import ALARM, BESIDE_INK, NARROW, REFERENCE_DASHES, REFERENCE_INK, Ink, Panel, Row
from validation.report.tables import length_unit, shortened
from validation.tune.data import TuneData, TunedRun
from validation.tune.table import against, cost_text, run_text, tune_notes

MAX_TRAIN, MAX_HELD_OUT, MAX_ABREAST = 8, 4, 4
"""Greatest numbers of references with a panel of their path, and of panels in a row."""

_SECTION_IN = 0.3
_PATHS_IN = {1: 3.4, 2: 3.3, 3: 3.1, 4: 2.75}  # height of a row of paths by how many stand in it


def _draw_header(result: TuneData, ax: Axes) -> None:
    """Draw the title, how the search ended, and the legend of paths."""
    names = [Path(name).name for name in result.source.split(",")]
    about = f"compared with {against(result)}"
    draw_title(result, f"{result.controller} tuned on ", shortened(", ".join(names), 90), about, ax)
    handles: list[Artist] = [
        Line2D([], [], color=REFERENCE_INK, linewidth=1.1, linestyle=REFERENCE_DASHES),
        Line2D([], [], color=BESIDE_INK, linewidth=1.3),
    ]
    labels = ["reference", shortened(result.baseline_name, 40)]
    for plant in dict.fromkeys(f.plant for f in (*result.train, *result.held_out)):
        handles.append(Line2D([], [], color=drawing.ink_of(plant), linewidth=NARROW))
        labels.append(f"tuned, {plant}")
    drawing.line_legend(ax, handles, labels)


def _draw_run(run: ClosedRun, ink: Ink, width: float, zorder: float, gid: str, ax: Axes) -> None:
    """Draw a path, and a cross where the robot was lost."""
    x, y = run.columns("x", "y").T
    ax.plot(x, y, color=ink, linewidth=width, zorder=zorder, gid=gid)
    if run.lost and len(x):
        drawing.draw_loss(ax, x[-1], y[-1], f"{gid} lost")


def _quality(followed: TunedRun) -> list[tuple[str, bool]]:
    """Return cost and d_rms of the tuned gains and of the baseline, a line each, and whether the robot was lost."""
    runs = {"tuned": followed.tuned, "baseline": followed.baseline}
    unit = length_unit([run.metrics["d_rms_m"] for run in runs.values()])
    words = {name: f"{'' if run.lost else 'cost '}{cost_text(run.cost, run.lost)}" for name, run in runs.items()}
    return [
        (f"{name}: {words[name]}, d_rms {unit.text(run.metrics['d_rms_m'])} {unit.symbol}", run.lost)
        for name, run in runs.items()
    ]


def _draw_path(followed: TunedRun, held_out: bool, ax: Axes) -> None:
    """Draw the reference, and the robot's path with the tuned gains and with those of the baseline."""
    f = followed
    drawing.inset(ax, above=0.36)
    drawing.draw_reference(ax, f.target.xy)
    _draw_run(f.baseline.run, BESIDE_INK, 1.3, 2.2, "baseline", ax)
    _draw_run(f.tuned.run, drawing.ink_of(f.plant), NARROW, 2.5, "tuned", ax)
    if len(f.tuned.run.t):
        drawing.draw_dart(ax, f.tuned.run.columns("x", "y", "yaw")[-1], f.plant, 11.0)
    drawing.equal_scales(ax, 0.6)
    ax.locator_params(nbins=5)
    ax.set(xlabel="x [m]", ylabel="y [m]", label="held out" if held_out else "train")
    title_path(run_text(f, 80), 31.0, 0.3, ax)
    for k, (text, lost) in enumerate(_quality(f)):
        ax.annotate(text, (0.0, 1.0), (0.0, 17.0 - 12.0 * k), xycoords="axes fraction", textcoords="offset points",
                    va="bottom", fontsize=8.5, color=ALARM if lost else "0.15" if k == 0 else "0.45")  # fmt: skip
    if held_out:
        drawing.corner_note(ax, "held out")


def _path_rows(result: TuneData) -> tuple[list[Row], list[str]]:
    """Return rows of paths, and a sentence on what found no room."""
    panels: list[Panel] = [partial(_draw_path, f, False) for f in result.train[:MAX_TRAIN]]
    panels += [partial(_draw_path, f, True) for f in result.held_out[:MAX_HELD_OUT]]
    if not panels:
        return [], []
    abreast = math.ceil(len(panels) / math.ceil(len(panels) / MAX_ABREAST))
    heading = "Paths [m]: the ring is the start of the reference, the square its end"
    rows = [drawing.text_row(_SECTION_IN, partial(drawing.draw_section, heading))]
    for k in range(0, len(panels), abreast):
        rows.append(Row(_PATHS_IN[abreast], tuple((1.0 / abreast, panel) for panel in panels[k : k + abreast])))
    without = [run_text(f) for f in (*result.train[MAX_TRAIN:], *result.held_out[MAX_HELD_OUT:])]
    return rows, [f"Without a picture of their own: {', '.join(without)}."] if without else []


def tune_figure(result: TuneData) -> Figure:
    """Draw a tuning, 1600 px wide: convergence, gains within their bounds, the paths along each reference, and notes."""
    paths, left_out = _path_rows(result)
    ink: Ink = drawing.ink_of(result.train[0].plant) if result.train else "0.1"
    looks = SearchLooks(result, ink, "Gains", "baseline", before_cost=result.baseline_cost)
    held = result.held_gains
    notes = [*tune_notes(result), *left_out, *([f"Gains that were held: {gains_text(held)}."] if held else [])]
    return search_page(partial(_draw_header, result), looks, paths, notes)
