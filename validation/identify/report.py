"""Report of a search, as fits and tunings give it: numbers within their bounds, the course of the search, its picture."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ssmr.search.space import ParameterSpace
from ssmr.types import FloatArray
from validation.identify.search import Search
from validation.identify.uncertainty import Uncertainty
from validation.report import drawing
from validation.report.drawing import ALARM, Ink, PanelRow
from validation.report.report import FINISHED, INTERRUPTED, Report
from validation.report.table import Table
from validation.words import shortened

# a number with a wider interval, as a share of the space between its bounds, is marked as uncertain
_VAGUE_SHARE = 0.5
# height of the first row; of a strip, and what their panel needs besides
_LEAST_IN, _STRIP_IN, _STRIPS_IN = 2.7, 0.52, 0.8


@dataclass(frozen=True)
class FittedParameter:
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

    def share(self, value: float) -> float:
        """Return a value's place between the bounds, 0 to 1 on the scale of the search; -inf where it has no logarithm."""
        if self.scale == "log":
            return (
                math.log(value / self.lower) / math.log(self.upper / self.lower)
                if value > 0.0
                else -math.inf
            )
        return (value - self.lower) / (self.upper - self.lower)

    @property
    def warning(self) -> str:
        """`at bound`, `uncertain` where its interval takes up more than half of the bounds, both or nothing."""
        low, high = map(self.share, self.interval_95 or (self.value, self.value))
        return ", ".join(["at bound"] * self.at_bound + ["uncertain"] * (high - low > _VAGUE_SHARE))


def fitted_parameters(
    space: ParameterSpace,
    point: FloatArray,
    before: Iterable[float],
    sure: Uncertainty | None = None,
) -> tuple[FittedParameter, ...]:
    """Return the parameters at an (n,) point of the unit cube, with the values of before, and with errors that are known."""
    ends = space.values(point).tolist(), before, space.at_bound(point).tolist()
    rows = [
        FittedParameter(p.name, p.unit, value, p.lower, p.upper, p.scale, float(was), bound)
        for p, value, was, bound in zip(space.parameters, *ends, strict=True)
    ]
    errors = zip(sure.standard_error.tolist(), sure.interval.tolist(), strict=True) if sure else []
    for k, (error, (low, high)) in enumerate(errors):
        if math.isfinite(error):
            rows[k] = replace(rows[k], standard_error=error, interval_95=(low, high))
    return tuple(rows)


def bound_sentences(space: ParameterSpace, point: FloatArray) -> list[str]:
    """Return a sentence for each parameter that a search left at a bound, with advice that can be followed."""
    out = []
    for p, at_bound, x in zip(space.parameters, space.at_bound(point), point, strict=True):
        if at_bound:
            end, bound, limit = (
                ("lower", p.lower, p.least) if x < 0.5 else ("upper", p.upper, p.greatest)
            )
            advice = "give it wider bounds, or fix it"
            if bound == limit:
                advice = f"values {'below' if end == 'lower' else 'above'} are impossible; fix it there, or look for a cause"
            out.append(f"{p.name} ended at its {end} bound, {p.text(bound)}: {advice}.")
    return out


@dataclass(frozen=True, eq=False, kw_only=True)
class SearchReport(Report):
    """The report on a search."""

    cost: float
    """Cost of what was found."""
    cost_name: str
    """Name of the cost: `path`, `sync` or `horizon` of a fit, `path` or `time` of a tuning."""
    parameters: tuple[FittedParameter, ...]
    """The numbers that were searched, in their order."""
    course: Search
    """The search, with all of its generations."""

    @property
    def effort(self) -> str:
        """The cost, and what the search took, in words."""
        c = self.course
        cost = f"{self.cost_name} cost {self.cost:.4g}"
        done = f"{c.evaluations} evaluations in {c.jde.generation} generations"
        return f"{cost} · {done} · {c.wall_s:.1f} s · stopped by {c.stopped_by}"

    def searched(self) -> dict[str, Any]:
        """Return what the JSON files of fits and tunings have in common."""
        c = self.course
        parameters = {p.name: asdict(p) for p in self.parameters}
        return {
            "stopped_by": c.stopped_by,
            "cost": self.cost,
            "cost_name": self.cost_name,
            "evaluations": c.evaluations,
            "evaluations_by_stage": c.by_stage,
            "generations": c.jde.generation,
            "wall_s": c.wall_s,
            "parameters": parameters,
            "best_cost_by_generation": [
                cost for cost in c.jde.history.tolist() if math.isfinite(cost)
            ],
        }

    def values(self, what: str, before: str, caption: str = "") -> Table:
        """Return the parameters row by row; `what` and `before` name the first column and the one of earlier values."""
        known = any(p.standard_error is not None for p in self.parameters)
        rows = [
            {
                what: p.name,
                "unit": "" if p.unit == "1" else p.unit,
                "value": p.value,
                **({"standard_error": p.standard_error} if known else {}),
                "lower_bound": p.lower,
                "upper_bound": p.upper,
                before: p.before,
                "warning": p.warning,
            }
            for p in self.parameters
        ]
        return Table(self.title, rows, f"{self.effort}\n{caption}")


def ending(search: Search, alarms: Sequence[str] = ()) -> dict[str, Any]:
    """Return the fields of a report that say whether its search was interrupted, and how to go on; others' alarms first."""
    if not search.interrupted:
        return {"status": FINISHED, "alarms": tuple(alarms)}
    sentence = f"the search is kept in {search.checkpoint}; the same command with --resume goes on from there"
    return {
        "status": INTERRUPTED,
        "alarms": (*alarms, sentence) if search.checkpoint else tuple(alarms),
    }


def search_figure(
    report: SearchReport, ink: Ink, before: str, rows: Sequence[PanelRow] = ()
) -> Figure:
    """Draw a search, 1600 px wide: course, values within their bounds, further rows of panels and notes.

    What was found is drawn in `ink`; `before` is the name of the values of before.
    """
    height = max(_LEAST_IN, _STRIPS_IN + _STRIP_IN * len(report.parameters))
    course = partial(_draw_course, report, ink)
    strips = partial(_draw_strips, report, ink, before)
    first = (
        ((0.36, course), (0.64, strips)) if len(report.course.jde.history) > 1 else ((1.0, strips),)
    )
    page = [
        drawing.text_row(0.3, partial(drawing.draw_section, shortened(report.title, 110))),
        drawing.text_row(
            0.25, partial(drawing.draw_footer, f"{report.effort} · seed {report.document['seed']}")
        ),
        PanelRow(height, first),
        *rows,
        *drawing.note_rows(report.notes()),
    ]
    return drawing.put_together(page)


def _draw_course(report: SearchReport, ink: Ink, ax: Axes) -> None:
    costs = report.course.jde.history
    known = costs[np.isfinite(costs)]
    ax.plot(
        np.arange(len(costs)),
        np.where(np.isfinite(costs), costs, np.nan),
        color=ink,
        marker="o",
        markersize=2.5,
    )
    if known.min() > 0.0 and known.max() > 10.0 * known.min():
        ax.set_yscale("log")
        drawing.plain_ticks(ax.yaxis, (1.0, 2.0, 5.0))
    ax.xaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
    ax.set(title="Least cost by generation", xlabel="generation")


def _draw_strips(report: SearchReport, ink: Ink, before: str, ax: Axes) -> None:
    """Draw the parameters within their bounds, a strip each: value, 95 % interval and value of before."""
    drawing.inset(ax, left=1.3, right=1.0)
    ax.set(xlim=(0.0, 1.0), ylim=(len(report.parameters) - 0.45, -0.6), xticks=[])
    ax.set_title(f"Values within their bounds, 95 % intervals (bars) and {before} (ticks)")
    ax.set_yticks(range(len(report.parameters)), [p.name for p in report.parameters])
    ax.tick_params(length=0.0, pad=46.0)
    ax.spines[:].set_visible(False)
    ax.grid(visible=False)
    for row, p in enumerate(report.parameters):
        colour: Ink = ALARM if p.at_bound else ink
        low, high, was, x = (
            min(max(p.share(value), 0.0), 1.0)
            for value in (*(p.interval_95 or (p.value, p.value)), p.before, p.value)
        )
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
        for text, at, away, align in (
            (f"{p.value:.4g}{unit}", x, (0.0, 7.0), "center"),
            (f"{p.lower:.4g}", 0.0, (-7.0, -3.0), "right"),
            (f"{p.upper:.4g}{unit}", 1.0, (7.0, -3.0), "left"),
        ):
            ax.annotate(
                text,
                (at, row),
                away,
                textcoords="offset points",
                ha=align,
                fontsize=8.5,
                annotation_clip=False,
            )
