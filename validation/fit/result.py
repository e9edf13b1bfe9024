"""What a comparison, a fit, a tracked reference or a tuning found: frozen values that programs make and sinks take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ssmr.metrics.paths import HorizonErrors, PathMetrics
from ssmr.types import FloatArray, Trajectory


@dataclass(frozen=True)
class FittedParameter:
    """One number that a fit found."""

    name: str
    """As the command line calls it."""
    unit: str
    """Of all numbers here; `1` for a pure number."""
    value: float
    """The best found."""
    lower: float
    """Bound of the search."""
    upper: float
    """Bound of the search."""
    scale: str
    """`linear` or `log`: how the space between the bounds was searched."""
    before: float
    """What it was in the profile that the fit began with; infinite for a limit that was off."""
    at_bound: bool
    """It ended at one of its bounds."""
    standard_error: float | None = None
    """None where it could not be estimated, or was not."""
    interval_95: tuple[float, float] | None = None
    """Where it lies with 95 %, by the same estimate and within the bounds."""


@dataclass(frozen=True, eq=False)
class FitTrace:
    """How a fit went, generation by generation, in the unit cube."""

    best_cost: FloatArray
    """(G,) least cost yet; the first is that of the initial population."""
    median_cost: FloatArray
    """(G,) median over the population's members of finite cost; NaN where there is none."""
    best: FloatArray
    """(G, n) the best member."""
    population: FloatArray
    """(S, n) all members at the end."""
    costs: FloatArray
    """(S,) their costs; infinite for one that never had any."""


@dataclass(frozen=True, eq=False)
class Scored:
    """A fitted plant on one source, used for the fit or held out."""

    label: str
    """The source as the user named it, with its input where it is a recording driven by both."""
    reference_name: str
    """The plant that made the truth, or `recording`."""
    truth: tuple[Trajectory, ...]
    """The motion wanted, piece by piece."""
    motion: tuple[Trajectory, ...]
    """The fitted plant's, at the same stamps."""
    before: tuple[Trajectory, ...]
    """The same plant's with the numbers of the profile that the fit began with; empty where it could not be driven."""
    metrics: PathMetrics
    """Distances of `motion` from `truth`, over all pieces."""
    horizons: Mapping[float, HorizonErrors]
    """Errors of the relative pose, by horizon [s]; empty where the truth is a plant's."""


@dataclass(frozen=True, eq=False)
class FitResult:
    """What a fit found, and how far to believe it."""

    model: str
    """The plant that was fitted."""
    profile: str
    """Name of the profile that the fit began with."""
    source: str
    """What it was fitted to, as the user named it."""
    seed: int
    """Of the search."""
    status: str
    """`finished` or `interrupted`."""
    stopped_by: str
    """`generations`, `improvement`, `target`, or `interrupt`."""
    cost: float
    """Of the best candidate."""
    cost_name: str
    """`path`, `sync` or `horizon`."""
    evaluations: int
    """Candidates rated."""
    generations: int
    """Completed after the initial population."""
    wall_s: float
    """Time that the search took [s], over all runs that a resumed fit consists of."""
    parameters: tuple[FittedParameter, ...]
    """In the order of the search."""
    correlation: FloatArray | None
    """(n, n) of the parameters; None where it was not estimated."""
    uncertainty_method: str
    """How the standard errors were found; empty where they were not."""
    notes: tuple[str, ...]
    """What the fit cannot say, in plain sentences."""
    train: tuple[Scored, ...]
    """On what it was fitted to, source by source."""
    train_metrics: PathMetrics
    """Over all of `train`."""
    train_horizons: Mapping[float, HorizonErrors]
    """Over all of `train`."""
    before_horizons: Mapping[float, HorizonErrors]
    """Over all of `train`, of the plant before the fit; empty where it could not be driven everywhere."""
    held_out: tuple[Scored, ...]
    """On what the fit has not seen."""
    trace: FitTrace
    """How the search went."""
    options: Mapping[str, object]
    """How it was run: objective, weights, strategy, population, spans."""
    versions: Mapping[str, str]
    """Of this project, Python and the packages that decide numbers."""
