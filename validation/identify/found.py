"""What a search found, as fits and tunings report it: numbers within their bounds, and the course of the search."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ssmr.search.space import ParameterSpace
from ssmr.types import FloatArray
from validation.identify.search import Search
from validation.report.report import Report
from validation.report.table import Table

_VAGUE_SHARE = 0.5  # a number with a wider interval, as a share of the space between its bounds, is marked as uncertain
_STOPPED = {
    "generations": "all generations done",
    "improvement": "no more improvement",
    "target": "target reached",
    "interrupt": "INTERRUPTED",
    "least squares": "least squares ended",
}


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
        """Return where a value lies between the bounds, on the scale of the search: 0 at the lower, 1 at the upper bound.

        On a logarithmic scale a value that is not positive lies infinitely far below.
        """
        if self.scale == "log":
            return math.log(value / self.lower) / math.log(self.upper / self.lower) if value > 0.0 else -math.inf
        return (value - self.lower) / (self.upper - self.lower)

    @property
    def is_vague(self) -> bool:
        """Whether its 95 % interval takes up more than half of the space between its bounds."""
        ends = self.interval_95
        return ends is not None and self.share(ends[1]) - self.share(ends[0]) > _VAGUE_SHARE

    @property
    def warning(self) -> str:
        """`at bound`, `uncertain`, both or nothing."""
        return ", ".join(["at bound"] * self.at_bound + ["uncertain"] * self.is_vague)

    def as_dict(self) -> dict[str, Any]:
        """Return the parameter as a JSON file holds it."""
        return {name: value for name, value in asdict(self).items() if name != "name"}


def found_parameters(
    space: ParameterSpace,
    point: FloatArray,
    before: Sequence[float],
    errors: FloatArray | None = None,
    intervals: FloatArray | None = None,
) -> tuple[FittedParameter, ...]:
    """Return the parameters at an (n,) point of the unit cube.

    Args:
        space: the parameters with their bounds.
        point: where the search ended.
        before: (n,) values of before.
        errors: (n,) standard errors, NaN where there is none.
        intervals: (n, 2) ends of their 95 % intervals.
    """
    out = []
    rows = zip(space.parameters, space.values(point), before, space.at_bound(point), strict=True)
    for i, (p, value, was, bound) in enumerate(rows):
        error, ends = None, None
        if errors is not None and intervals is not None and np.isfinite(errors[i]):
            error, ends = float(errors[i]), (float(intervals[i, 0]), float(intervals[i, 1]))
        out.append(
            FittedParameter(
                p.name, p.unit, float(value), p.lower, p.upper, p.scale, float(was), bool(bound), error, ends
            )
        )  # fmt: skip
    return tuple(out)


def bound_sentences(space: ParameterSpace, point: FloatArray) -> list[str]:
    """Return a sentence for each parameter that a search left at a bound, with advice that can be followed."""
    out = []
    for p, at_bound, x in zip(space.parameters, space.at_bound(point), point, strict=True):
        if at_bound:
            end, bound, limit = ("lower", p.lower, p.least) if x < 0.5 else ("upper", p.upper, p.greatest)
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
        c, cost = self.course, f"{self.cost_name} cost {self.cost:.4g}"
        done = f"{c.evaluations} evaluations in {c.jde.generation} generations"
        return f"{cost} · {done} · {c.wall_s:.1f} s · {_STOPPED.get(c.stopped_by, c.stopped_by)}"


def search_document(
    course: Search, cost: float, cost_name: str, seed: int, parameters: Sequence[FittedParameter]
) -> dict[str, Any]:
    """Return what the JSON files of fits and tunings have in common."""
    return {
        "seed": seed,
        "stopped_by": course.stopped_by,
        "cost": cost,
        "cost_name": cost_name,
        "evaluations": course.evaluations,
        "evaluations_by_stage": course.by_stage,
        "generations": course.jde.generation,
        "wall_s": course.wall_s,
        "parameters": {p.name: p.as_dict() for p in parameters},
        "best_cost_by_generation": [cost for cost in course.best_cost if math.isfinite(cost)],
    }


def found_table(title: str, parameters: Sequence[FittedParameter], what: str, before: str, caption: str = "") -> Table:
    """Return the parameters row by row; `what` and `before` name the first column and the one of earlier values."""
    known = any(p.standard_error is not None for p in parameters)
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
        for p in parameters
    ]
    return Table(title, rows, caption)
