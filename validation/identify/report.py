"""Report of a search, as fits and tunings give it.

It has the numbers within their bounds, the course of the search, and its picture.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ssmr.search.space import ParameterSpace
from ssmr.types import FloatArray
from validation.identify.search import Search
from validation.identify.uncertainty import Uncertainty
from validation.output import Document, shorten_text
from validation.report import drawing
from validation.report.columns import Unit
from validation.report.drawing import ALARM, Ink, PanelRow
from validation.report.report import FINISHED, INTERRUPTED, Report
from validation.report.table import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LEAST_IN = 2.7  # height of the first row [in]
_STRIP_IN = 0.52  # height of a parameter's strip [in]
_STRIPS_IN = 0.8  # height that the panel of strips needs besides [in]


@dataclass(frozen=True)
class _FittedParameter:
    """One number that a search found."""

    name: str
    """Name of the parameter."""
    unit: str
    """Unit of all numbers here; `1` for a pure number."""
    value: float
    """Best value that was found."""
    lower: float
    """Lower bound of the search."""
    upper: float
    """Upper bound of the search."""
    scale: str
    """`linear` or `log`: the scale on which the space between the bounds was searched."""
    before: float
    """Value before the search; infinite for a limit that was off."""
    at_bound: bool
    """True if it ended at one of its bounds."""
    standard_error: float | None = None
    """Standard error; None where it could not be estimated, or was not."""
    interval_95: tuple[float, float] | None = None
    """95 % interval by the same estimate, within the bounds."""
    untold: bool = False
    """Whether the data hardly determine it."""

    def share(self, value: float) -> float:
        """Return a value's place between the bounds, 0 to 1 on the scale of the search.

        It is -inf for a value that has no logarithm.
        """
        if self.scale != "log":
            return (value - self.lower) / (self.upper - self.lower)
        if value <= 0.0:
            return -math.inf
        return math.log(value / self.lower) / math.log(self.upper / self.lower)

    @property
    def warning(self) -> str:
        """`at bound`, `uncertain` for a number that the data hardly determine, both or ""."""
        return ", ".join(["at bound"] * self.at_bound + ["uncertain"] * self.untold)


def fitted_parameters(
    space: ParameterSpace,
    point: FloatArray,
    before: Iterable[float],
    sure: Uncertainty | None = None,
) -> tuple[_FittedParameter, ...]:
    """Return the parameters at an (n,) point of the unit cube, with the values of before.

    They have the errors that `sure` knows.
    """
    ends = space.values(point).tolist(), before, space.at_bound(point).tolist()
    rows = []
    for k, (p, value, was, bound) in enumerate(zip(space.parameters, *ends, strict=True)):
        row = _FittedParameter(
            p.name, p.unit, value, p.lower, p.upper, p.scale, before=float(was), at_bound=bound
        )
        if sure is not None and math.isfinite(sure.standard_error[k]):
            low, high = sure.interval[k].tolist()
            row = replace(
                row,
                standard_error=float(sure.standard_error[k]),
                interval_95=(low, high),
                untold=bool(sure.untold[k]),
            )
        rows.append(row)
    return tuple(rows)


_MEANINGS = {
    "alpha_l": "left radius factor",
    "alpha_r": "right radius factor",
    "y_l": "left half-track",
    "y_r": "right half-track",
    "x_icr": "ICR ahead of middle",
    "drift": "outward drift in bends",
    "tracked_x": "pose source ahead",
    "tracked_yaw": "pose source turned left",
    "position_late": "delay of positions",
    "yaw_late": "delay of headings",
}
"""What parameters are whose names are symbols, or might be read as something else."""


def _meaning_of(name: str) -> str:
    """Return in words what a parameter is; an empty text where its name says it."""
    number, _, _ = name.partition("@")
    return _MEANINGS.get(number, "")


def correlation_table(
    title: str, parameters: Sequence[_FittedParameter], correlation: FloatArray | None
) -> Table:
    """Return the (n, n) correlations of the errors of parameters; no rows if they are unknown."""
    names = [p.name for p in parameters]
    rows = []
    for name, row in zip(names, [] if correlation is None else correlation, strict=False):
        rows.append({"error of": name, **dict(zip(names, map(float, row), strict=True))})
    units = {name: Unit("1", 1.0, 2) for name in names}
    return Table(title, rows, units=units, headings={name: name for name in names})


_LIMITS = ("acceleration", "torque_limit", "v_max", "w_max")
"""Beginnings of the names of limits."""


def bound_sentences(space: ParameterSpace, point: FloatArray) -> list[str]:
    """Return a sentence for each parameter that a search left at a bound, with advice."""
    out = []
    for p, at_bound, x in zip(space.parameters, space.at_bound(point), point, strict=True):
        if not at_bound:
            continue
        end, bound = ("lower", p.lower) if x < 0.5 else ("upper", p.upper)
        advice = "give it wider bounds, or fix it (--bounds and --fix of fit and tune)"
        if end == "upper" and p.name.startswith(_LIMITS):
            advice = "where the source never reaches this limit, more fits as well; fix it"
        # no number lies beyond this bound, so wider bounds are no advice
        if bound in (p.least, p.greatest):
            beyond = "below" if end == "lower" else "above"
            advice = f"values {beyond} are impossible; fix it there, or look for a cause"
        out.append(f"{p.name} ended at its {end} bound, {p.text(bound)}: {advice}.")
    return out


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class SearchReport(Report, ABC):
    """The report on a search."""

    course: Search
    """The search, with all of its generations."""
    seed: int
    """Seed of the search."""
    parameters: tuple[_FittedParameter, ...]
    """The numbers that were searched, in their order."""

    @property
    def cost(self) -> float:
        """Cost of the best candidate."""
        return self.course.cost

    @property
    @abstractmethod
    def cost_name(self) -> str:
        """Name of the cost: `path`, `sync` or `horizon` of a fit, `path` or `time` of a tuning."""

    def notes(self) -> list[str]:
        """Return how an interrupted search goes on, and the remarks."""
        notes = super().notes()
        if self.course.interrupted and self.course.checkpoint:
            kept = f"The search is kept in {self.course.checkpoint}; "
            notes.insert(1, f"{kept}the same command with --resume goes on from there.")
        return notes

    @property
    def effort(self) -> str:
        """The cost, and what the search took, in words."""
        c = self.course
        least = f"cost by {self.cost_name} {self.cost:.4g}, smaller is better"
        done = f"{c.evaluations} candidates in {c.jde.generation} generations"
        return f"{least} · {done} · {c.wall_s:.1f} s · stopped by {c.stopped_by}"

    def searched(self) -> Document:
        """Return the common part of the JSON files of fits and tunings."""
        c = self.course
        history = c.jde.history
        return {
            "stopped_by": c.stopped_by,
            "cost": self.cost,
            "cost_name": self.cost_name,
            "evaluations": c.evaluations,
            "evaluations_by_stage": c.by_stage,
            "generations": c.jde.generation,
            "wall_s": c.wall_s,
            "parameters": {p.name: asdict(p) for p in self.parameters},
            "best_cost_by_generation": history[np.isfinite(history)].tolist(),
        }

    def values(self, heading: str, before: str, caption: str = "") -> Table:
        """Return the parameters row by row.

        `heading` names their column, and `before` that of their values before the search.
        """
        has_errors = any(p.standard_error is not None for p in self.parameters)
        has_meanings = any(_meaning_of(p.name) for p in self.parameters)
        rows = []
        for p in self.parameters:
            meaning = {"meaning": _meaning_of(p.name)} if has_meanings else {}
            error = {"standard_error": p.standard_error} if has_errors else {}
            rows.append(
                {
                    heading: p.name,
                    **meaning,
                    "unit": "" if p.unit == "1" else p.unit,
                    "value": p.value,
                    **error,
                    "lower_bound": p.lower,
                    "upper_bound": p.upper,
                    before: p.before,
                    "warning": p.warning,
                }
            )
        return Table(self.title, rows, f"{self.effort}\n{caption}")


def status_of(search: Search) -> str:
    """Return how a report's search ended."""
    return INTERRUPTED if search.interrupted else FINISHED


def search_figure(
    report: SearchReport, ink: Ink, before: str, rows: Sequence[PanelRow] = ()
) -> Figure:
    """Draw a search, 1600 px wide: course, values within bounds, further rows of panels, notes.

    The found values are drawn in `ink`; `before` names the values of before.
    """
    height = max(_LEAST_IN, _STRIPS_IN + _STRIP_IN * len(report.parameters))
    strips = partial(_draw_strips, report, ink, before)
    first = PanelRow(height, [strips])
    # a single generation, as with one start of least squares, has no course to draw
    if len(report.course.jde.history) > 1:
        first = PanelRow(height, [partial(_draw_course, report, ink), strips], (0.36, 0.64))
    foot = f"{report.effort} · seed {report.seed}"
    title = shorten_text(report.title, 110)
    return drawing.draw_page(title, [first, *rows], notes=report.notes(), foot=foot)


def _draw_course(report: SearchReport, ink: Ink, ax: Axes) -> None:
    """Draw the least cost by generation; a generation without a finite cost leaves a gap."""
    costs = report.course.jde.history
    finite = costs[np.isfinite(costs)]
    ax.plot(
        np.arange(len(costs)),
        np.where(np.isfinite(costs), costs, np.nan),
        color=ink,
        marker="o",
        markersize=2.5,
    )
    # within less than a decade a logarithmic axis has hardly any ticks
    if finite.min() > 0.0 and finite.max() > 10.0 * finite.min():
        ax.set_yscale("log")
        drawing.plain_ticks(ax.yaxis, (1.0, 2.0, 5.0))
    ax.locator_params(axis="x", nbins=6, integer=True)
    ax.set(title="Least cost by generation", xlabel="generation")


def _draw_strips(report: SearchReport, ink: Ink, before: str, ax: Axes) -> None:
    """Draw the parameters within their bounds: value, 95 % interval and value of before."""
    ax.set(xlim=(0.0, 1.0), ylim=(len(report.parameters) - 0.45, -0.6), xticks=[])
    ax.set_title(f"Values within their bounds, 95 % intervals (bars) and {before} (ticks)")
    names = [f"{_meaning_of(p.name)}  {p.name}".strip() for p in report.parameters]
    ax.set_yticks(range(len(names)), names)
    ax.tick_params(length=0.0, pad=46.0)
    ax.spines[:].set_visible(False)
    ax.grid(visible=False)
    for row, p in enumerate(report.parameters):
        colour = ALARM if p.at_bound else ink
        shares = map(p.share, (*(p.interval_95 or (p.value, p.value)), p.before, p.value))
        low, high, was, x = (min(max(share, 0.0), 1.0) for share in shares)
        ax.plot(
            [0.0, 1.0],
            [row, row],
            color="0.75",
            linewidth=1.2,
            marker="|",
            markersize=10.0,
            clip_on=False,
        )
        ax.plot(
            [low, high],
            [row, row],
            color=colour,
            linewidth=5.0,
            alpha=0.4,
            solid_capstyle="butt",
            clip_on=False,
        )
        ax.plot(was, row, "|", color="0.1", markersize=13.0, markeredgewidth=1.6, clip_on=False)
        ax.plot(
            x,
            row,
            "o",
            color=colour,
            markersize=8.5,
            markeredgecolor="white",
            zorder=3.5,
            clip_on=False,
        )
        unit = "" if p.unit == "1" else f" {p.unit}"
        texts = (
            (f"{p.value:.4g}{unit}", x, (0.0, 7.0), "center"),
            (f"{p.lower:.4g}", 0.0, (-7.0, -3.0), "right"),
            (f"{p.upper:.4g}{unit}", 1.0, (7.0, -3.0), "left"),
        )
        for text, at, offset, align in texts:
            ax.annotate(
                text,
                (at, row),
                offset,
                textcoords="offset points",
                ha=align,
                fontsize=8.5,
                annotation_clip=False,
            )
