"""What a search found, as fits and tunings report it: numbers within their bounds, and the course of the search."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from ssmr.search.space import ParameterSpace
from ssmr.types import FloatArray
from validation.identify.search import Search
from validation.report.report import FINISHED, INTERRUPTED, Report
from validation.report.table import Table

_VAGUE_SHARE = 0.5  # a number with a wider interval, as a share of the space between its bounds, is marked as uncertain


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
    def warning(self) -> str:
        """`at bound`, `uncertain` where its interval takes up more than half of the bounds, both or nothing."""
        low, high = map(self.share, self.interval_95 or (self.value, self.value))
        return ", ".join(["at bound"] * self.at_bound + ["uncertain"] * (high - low > _VAGUE_SHARE))


def found_parameters(space: ParameterSpace, point: FloatArray, before: Iterable[float]) -> tuple[FittedParameter, ...]:
    """Return the parameters at an (n,) point of the unit cube, with the values of before and no errors."""
    rows = zip(space.parameters, space.values(point).tolist(), before, space.at_bound(point).tolist(), strict=True)
    return tuple(
        FittedParameter(p.name, p.unit, value, p.lower, p.upper, p.scale, float(was), bound) for p, value, was, bound in rows
    )


def with_errors(
    parameters: Sequence[FittedParameter], errors: FloatArray, intervals: FloatArray
) -> tuple[FittedParameter, ...]:
    """Return the parameters with their (n,) standard errors and (n, 2) intervals; NaN is none."""
    return tuple(
        replace(p, standard_error=float(e), interval_95=(float(ends[0]), float(ends[1]))) if np.isfinite(e) else p
        for p, e, ends in zip(parameters, errors, intervals, strict=True)
    )


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
        return f"{cost} · {done} · {c.wall_s:.1f} s · stopped by {c.stopped_by}"

    def searched(self) -> dict[str, Any]:
        """Return what the JSON files of fits and tunings have in common."""
        c, parameters = self.course, {p.name: asdict(p) for p in self.parameters}
        return {
            "stopped_by": c.stopped_by,
            "cost": self.cost,
            "cost_name": self.cost_name,
            "evaluations": c.evaluations,
            "evaluations_by_stage": c.by_stage,
            "generations": c.jde.generation,
            "wall_s": c.wall_s,
            "parameters": parameters,
            "best_cost_by_generation": [cost for cost in c.best_cost if math.isfinite(cost)],
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


def ending(search: Search) -> dict[str, Any]:
    """Return the fields of a report that say whether its search was interrupted, and how to go on."""
    if not search.interrupted:
        return {"status": FINISHED}
    said = f"the search is kept in {search.checkpoint}; the same command with --resume goes on from there"
    return {"status": INTERRUPTED, "alarms": (said,) if search.checkpoint else ()}
