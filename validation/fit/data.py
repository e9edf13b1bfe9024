"""Values that a search finds: those that fits and tunings have in common, and the fit's own."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from ssmr.metrics.declared import Metrics
from ssmr.metrics.poses import HorizonErrors
from ssmr.metrics.windows import WindowErrors
from ssmr.types import FloatArray, Trajectory
from validation.plants.profile import Profile
from validation.report.tables import with_robot
from validation.simulator.description import USUAL_ROBOT


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

    def as_dict(self) -> dict[str, Any]:
        """Return the parameter as a result file holds it."""
        found = asdict(self)
        del found["name"]
        return {**found, "before": self.before if np.isfinite(self.before) else None}


@dataclass(frozen=True, eq=False)
class SearchTrace:
    """Course of a search, generation by generation, in the unit cube."""

    best_cost: FloatArray
    """(G,) least cost so far; the first is that of the initial population."""
    median_cost: FloatArray
    """(G,) median over the population's members of finite cost; NaN where there is none."""
    population: FloatArray
    """(S, n) all members at the end."""
    costs: FloatArray
    """(S,) their costs; infinite for one that never had any."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SearchData:
    """The part of a result that fits and tunings have in common."""

    begun_with: str
    """Name of the profile that the search began with."""
    robot: str = USUAL_ROBOT
    """Name of the robot that the profile is of."""
    seed: int
    """Seed of the search."""
    status: str
    """`finished` or `interrupted`."""
    stopped_by: str
    """`generations`, `improvement`, `target`, `least squares` or `interrupt`."""
    cost: float
    """Cost of the best candidate."""
    cost_name: str
    """Name of the cost: `path`, `sync` or `horizon` of a fit, `path` or `time` of a tuning."""
    evaluations: int
    """Number of candidates that were rated."""
    evaluations_by_stage: Mapping[str, int] = field(default_factory=dict)
    """Number of candidates that each stage of the search rated."""
    generations: int
    """Number of generations after the initial population."""
    wall_s: float
    """Time that the search took [s], over all runs of a resumed one."""
    parameters: tuple[FittedParameter, ...]
    """The numbers that were searched, in their order."""
    remarks: tuple[str, ...]
    """Sentences on what the search cannot say, such as parameters at their bounds."""
    trace: SearchTrace
    """Course of the search."""
    options: Mapping[str, object]
    """Options that it was run with."""
    versions: Mapping[str, str]
    """Versions of this project, Python and the packages that decide numbers."""

    @property
    def profile_label(self) -> str:
        """Name of the profile, and of the robot where the first does not tell the second."""
        return with_robot(self.begun_with, self.robot)

    def shared_dict(self) -> dict[str, Any]:
        """Return what the JSON files of fits and tunings have in common."""
        plain = ("seed", "status", "stopped_by", "cost", "cost_name", "evaluations", "generations", "wall_s")
        return {
            "profile": self.begun_with,
            "robot": self.robot,
            **{name: getattr(self, name) for name in plain},
            "parameters": {p.name: p.as_dict() for p in self.parameters},
            "notes": list(self.remarks),
            "options": dict(self.options),
            "versions": dict(self.versions),
            "best_cost_by_generation": self.trace.best_cost[np.isfinite(self.trace.best_cost)].tolist(),
        }


@dataclass(frozen=True, eq=False)
class Scored:
    """A fitted plant on one source, used for the fit or held out."""

    label: str
    """The source as the user named it, with its input where it is a recording driven by both."""
    reference_name: str
    """The plant that made the true motion, or `recording`."""
    truth: tuple[Trajectory, ...]
    """The true motion, piece by piece."""
    motion: tuple[Trajectory, ...]
    """The fitted plant's motion, at the same stamps."""
    before: tuple[Trajectory, ...]
    """Motion of the plant with the numbers from before the fit; empty where it could not be driven."""
    metrics: Metrics
    """Distances of `motion` from `truth`, over all pieces."""
    horizons: Mapping[float, HorizonErrors]
    """Errors of the relative pose, by horizon [s]; empty where the truth is a plant's motion."""
    windows: Mapping[float, WindowErrors] = field(default_factory=dict)
    """Errors over windows that begin every second, by horizon [s]; empty where the truth is a plant's motion."""
    jumps: tuple[tuple[int, ...], ...] = ()
    """Indices, piece by piece, of the first samples after jumps of the localiser; empty where there is none."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FitData(SearchData):
    """A plant's fitted parameters, their uncertainty, and how well they predict motion."""

    model: str
    """The plant that was fitted."""
    profile: Profile
    """The profile that the fit began with, with the fitted numbers and their provenance in it."""
    source: str
    """The sources that it was fitted to, as the user named them, separated by commas."""
    correlation: FloatArray | None
    """(n, n) correlation of the parameters' errors; None where it was not estimated."""
    uncertainty_method: str
    """Method of the standard errors in words; empty where there are none."""
    train: tuple[Scored, ...]
    """Scores on each source that it was fitted to."""
    train_metrics: Metrics
    """Metrics over all of `train`."""
    train_horizons: Mapping[float, HorizonErrors]
    """Errors by horizon over all of `train`."""
    train_windows: Mapping[float, WindowErrors] = field(default_factory=dict)
    """Errors over windows that begin every second, by horizon [s], over all of `train`."""
    before_horizons: Mapping[float, HorizonErrors]
    """Errors by horizon over all of `train` before the fit; empty where the plant could not be driven everywhere."""
    held_out: tuple[Scored, ...]
    """Scores on each source that the fit has not seen."""

    def as_dict(self) -> dict[str, Any]:
        """Return what fit.json holds."""
        names, correlation = [p.name for p in self.parameters], self.correlation
        return {
            "schema": "ssmr.fit/1",
            "model": self.model,
            "source": self.source,
            **self.shared_dict(),
            "search": self.options.get("search", "jde"),
            "evaluations_by_stage": dict(self.evaluations_by_stage),
            "correlation": None if correlation is None else {"names": names, "matrix": correlation.tolist()},
            "standard_errors_by": self.uncertainty_method,
            "train": _scores(self.train_metrics, self.train_horizons, self.train_windows),
            "train_by_source": {s.label: _scores(s.metrics, s.horizons, s.windows) for s in self.train},
            "held_out": {s.label: _scores(s.metrics, s.horizons, s.windows) for s in self.held_out},
        }


def _scores(
    metrics: Metrics, horizons: Mapping[float, HorizonErrors], windows: Mapping[float, WindowErrors]
) -> dict[str, Any]:
    out: dict[str, Any] = dict(metrics)
    if horizons:
        out["horizons"] = {f"{h:g}": asdict(errors) for h, errors in horizons.items()}
        for horizon, errors in windows.items():
            out["horizons"].setdefault(f"{horizon:g}", {})["overlapping"] = asdict(errors.summary())
    return out
