"""Fit a plant's parameters to motions by differential evolution."""

from __future__ import annotations

import contextlib
import datetime
import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ssmr.errors import SsmrError
from ssmr.metrics.declared import compare_pieces
from ssmr.search.jde import JdeSettings
from ssmr.search.space import ParameterSpace
from ssmr.types import FloatArray, Plant, Trajectory
from validation.bench.sources import drive, horizons_of, standing_sentences, window_errors_of
from validation.fit.data import Scored
from validation.fit.executors import dask_executor
from validation.fit.objective import FitCost, FitTarget
from validation.fit.problem import FitProblem
from validation.fit.refine import STARTS
from validation.fit.result import FitResult
from validation.fit.search import FreeParameters, Search, SearchOptions, put_options, search_for
from validation.fit.targets import FitSources, is_scenario, open_targets
from validation.fit.uncertainty import Uncertainty, estimate, found_parameters, sentences
from validation.plants.kind import Occasion, PlantProfile
from validation.plants.profile import Profile, choose_profile, make_plant
from validation.plants.searchable import find, make_space, with_values
from validation.plants.table import SIMULATED, plant_kind
from validation.progress import Progress, Report, silent
from validation.report.motions import HEADLINE_HORIZON
from validation.simulator.description import Robot

Method = Literal["jde", "hybrid", "lsq"]
"""How a fit searches: differential evolution; a short one, then least squares; or least squares from one start."""
_SIZES: Mapping[tuple[Method, bool], tuple[int, int]] = {
    ("jde", False): (50, 300),
    ("jde", True): (32, 60),
    ("hybrid", False): (20, 10),
    ("hybrid", True): (20, 4),
}
"""Usual population and generations of jDE for planar models (Tab. 3.7 of the thesis for `jde`) and for simulated bodies."""
_STARTS: Mapping[Method, int] = {"jde": 0, "hybrid": STARTS, "lsq": 1}
"""Greatest number of starts of least squares."""
_JAGGED = (50, 100)
"""Usual population and generations of a hybrid search of planar models for the path objective: distances between samples
make it jagged, so least squares go to the right place but not to the least cost there."""
PROFILES: Mapping[Occasion, str] = {"scenario": "thesis-lab", "recording": "husky-tile"}
"""The profile that a fit begins with unless another is given."""
_TOLD = ("input", "from", "until", "objective", "position_weight")  # options that the provenance of a fitted profile repeats
_SCORE_HORIZONS = (2.0, 6.0, 30.0, 60.0)  # horizons of the relative pose errors in results [s]


@dataclass(frozen=True)
class FitParameters(FreeParameters):
    """The parameters that are fitted, and the start of the search."""

    start: Mapping[str, float] | None = None
    """Values of one candidate of the first population; what is not named is the profile's. None draws all at random."""
    robot: Robot | str | Path | None = None
    """Robot whose numbers they are: itself, its name or its path; None for that of the profile."""


@dataclass(frozen=True)
class FitSearch(SearchOptions):
    """Options of a fit's search."""

    method: Method = "hybrid"
    """hybrid: a short differential evolution (jDE), then bounded least squares from its best candidate and from others far
    from it. jde: differential evolution alone, as in the thesis. lsq: least squares alone, from `start`, which is the
    profile's numbers if it is not given."""

    scheduler: str | None = None
    """Address of a dask scheduler, such as tcp://127.0.0.1:8786, whose workers rate the candidates of `jde`."""

    def record(self, settings: JdeSettings) -> dict[str, Any]:
        """Return what a result file holds of the search's settings."""
        return {"search": self.method, **super().record(settings)}


def fit(
    model: str,
    to: str | Path | Sequence[str | Path],
    profile: Profile | str | Path | None = None,
    *,
    sources: FitSources | None = None,
    parameters: FitParameters | None = None,
    cost: FitCost | None = None,
    search: FitSearch | None = None,
    progress: Report = silent,
    **options: Any,
) -> FitResult:
    """Fit a plant's parameters to motions, by self-adaptive differential evolution (jDE), least squares or both.

    Every field of the four groups of options can be given by its own name too: `fit("linear", "traj4@mujoco",
    generations=5, held_out=("traj1",))`. Ctrl-C ends the search; the result then holds the best found so far.

    Args:
        model: the plant to fit.
        to: the source to fit it to, or several: `traj4@mujoco` (the scenario as that plant drives it), or the path of a
            recording.
        profile: the numbers to begin with, or the name or path of a profile; thesis-lab for scenarios and husky-tile for
            recordings if it is None, or the robot's own numbers if these are of another robot than `robot`.
        sources: inputs and time span of recordings, and sources that are held out.
        parameters: the parameters to search, with their bounds.
        cost: the distance that is made small.
        search: sizes, seed, threads and checkpoint of the search.
        progress: called as the search goes on.
        options: fields of the four groups by name.

    Raises:
        ValueError: a name, number or file that cannot be used; the message says which.
        TypeError: an unknown option.
        SsmrError: a plant diverged, or no candidate could be driven.
        OSError: the checkpoint cannot be written.
        KeyboardInterrupt: interrupted before any candidate was rated.
    """
    sources, parameters, cost, search = put_options(
        options, sources or FitSources(), parameters or FitParameters(), cost or FitCost(), search or FitSearch()
    )
    names = [str(to)] if isinstance(to, str | Path) else [str(name) for name in to]
    occasion: Occasion = "scenario" if all(map(is_scenario, names)) else "recording"
    usual = plant_kind(model).free[occasion]
    base = choose_profile(profile, parameters.robot, PROFILES[occasion])
    begun = with_values(model, base.plants[model], list(parameters.fix), parameters.fix.values())
    free = usual if parameters.free is None else parameters.free
    space = make_space(model, [n for n in free if n not in parameters.fix], parameters.bounds, begun.robot)
    method = search.method
    start = _first_points(space, model, begun, {} if parameters.start is None and method == "lsq" else parameters.start)
    targets, held_out = open_targets(names, base, sources)
    problem = FitProblem(model, begun, space, targets, cost)
    _require_possible(problem, parameters.bounds)
    settings = search.settings(*_sizes(problem, method))
    found = _searched(problem, settings, search, start, progress)
    total = settings.generations + 1 + found.starts
    progress(Progress(total, total, "standard errors and scores"))
    point, before = found.best, [find(model, name, begun.robot).read(begun) for name in space.names]
    uncertainty, scores, troubles = _judged(problem, found, held_out, search.threads)
    result = FitResult(
        model=model,
        begun_with=base.name,
        robot=base.robot.name,
        profile=base,
        source=",".join(names),
        seed=search.seed,
        cost_name=str(problem.cost.objective),
        parameters=found_parameters(space, point, before, uncertainty),
        correlation=None if uncertainty is None else uncertainty.correlation,
        uncertainty_method="" if uncertainty is None else uncertainty.method,
        remarks=(*_warnings([*targets, *held_out]), *sentences(model, space, point, uncertainty), *troubles),
        **scores,
        options=_record(problem, settings, sources, parameters, search),
        **found.outcome(),
    )
    return replace(result, profile=_fitted_profile(result, base, problem.candidate(point), _in_words(method, settings)))


def _searched(
    problem: FitProblem, settings: JdeSettings, search: FitSearch, start: FloatArray | None, progress: Report
) -> Search:
    """Return the search after all its stages, or where it was interrupted."""
    with contextlib.ExitStack() as stack:
        rated_by = search
        if search.scheduler is not None:
            executor, shares = stack.enter_context(dask_executor(search.scheduler))
            rated_by = replace(search, executor=executor, workers=shares)
        found = search_for(problem, settings, rated_by, start, progress, _STARTS[search.method])
    if found.starts and not found.interrupted:
        found.refine(problem, search.threads, search.checkpoint, progress)
    return found


def _sizes(problem: FitProblem, method: Method) -> tuple[int, int]:
    """Return the population and generations of jDE where the user names none; of `lsq` only the first candidate counts."""
    if method == "lsq":
        return 5, 1
    simulated = problem.model in SIMULATED
    jagged = method == "hybrid" and problem.cost.objective == "path" and not simulated
    return _JAGGED if jagged else _SIZES[method, simulated]


def _in_words(method: Method, settings: JdeSettings) -> str:
    """Return how a fit searched, as the provenance of a profile says it."""
    if method == "lsq":
        return "least squares"
    then = ", then least squares" if method == "hybrid" else ""
    return f"jDE {settings.strategy} {settings.crossover}, population {settings.population}{then}"


def _warnings(targets: Sequence[FitTarget]) -> list[str]:
    """Return what is wrong with recordings, each sentence once: a recording may stand there for each input and span."""
    said = [warning for target in targets for warning in target.source.warnings]
    said += [sentence for target in targets for sentence in standing_sentences(target.source, HEADLINE_HORIZON)]
    return list(dict.fromkeys(said))


def _record(
    problem: FitProblem, settings: JdeSettings, sources: FitSources, parameters: FitParameters, search: FitSearch
) -> dict[str, Any]:
    """Return the options as a result file holds them."""
    recorded = any(target.source.reference == "recording" for target in problem.targets)
    return {
        "input": sources.input if recorded else None,
        "from": sources.start_at,
        "until": sources.until,
        "objective": problem.cost.objective,
        **({"horizons_s": list(problem.cost.horizons)} if problem.cost.objective == "horizon" else {}),
        **({"yaw_weight_m_rad": problem.cost.yaw_weight} if problem.cost.objective != "path" else {}),
        **({"position_weight": problem.cost.position_weight} if problem.cost.position_weight != 1.0 else {}),
        "fixed": dict(parameters.fix) or None,
        **search.record(settings),
        "start": None if parameters.start is None else dict(parameters.start),
        "scheduler": search.scheduler,
    }


def _first_points(
    space: ParameterSpace, model: str, base: PlantProfile, start: Mapping[str, float] | None
) -> FloatArray | None:
    """Return the (1, n) candidate to begin with, in the unit cube; None for none."""
    if start is None:
        return None
    for name in start:
        find(model, name, base.robot)
        if name not in space.names:
            raise ValueError(f"start names {name}, which is not free")
    values = [start.get(name, find(model, name, base.robot).read(base)) for name in space.names]
    values = [p.upper if value == math.inf else value for p, value in zip(space.parameters, values, strict=True)]  # no limit
    return space.points(np.array(values)[None])


def _require_possible(problem: FitProblem, given: Container[str]) -> None:
    """Refuse numbers that no candidate can have: the profile's own, and given bounds of the inertia that no body has.

    Where default bounds reach farther than a robot's other numbers allow, candidates beyond are rated as impossible.
    """
    heavy = ("yaw_inertia", "mass") if problem.model in SIMULATED else ()
    bodies = [p for p in problem.space.parameters if p.name in heavy and p.name in given]
    ends = [{p.name: end} for p in bodies for end in (p.lower, p.upper)]
    for end in ({}, *ends):
        plant = with_values(problem.model, problem.base, list(end), end.values())
        try:
            _built(problem.model, plant)
        except ValueError as error:
            raise ValueError(f"{''.join(f'bounds of {name}: ' for name in end)}{error}") from error


def _built(model: str, plant: PlantProfile) -> Plant:
    return make_plant(Profile("with these values", "", {model: plant}, {}), model)


def _judged(
    problem: FitProblem, found: Search, held_out: Sequence[FitTarget], threads: int
) -> tuple[Uncertainty | None, dict[str, Any], list[str]]:
    """Return uncertainty (None after an interrupt), scores, and sentences on what could not be had."""
    uncertainty, troubles, point = None, list[str](), found.best
    if not found.interrupted:
        try:
            uncertainty = estimate(problem, point, threads, found.driven)
        except (SsmrError, np.linalg.LinAlgError) as error:
            troubles.append(f"Standard errors could not be estimated: {error}.")
    return uncertainty, _scores(problem, point, held_out, troubles), troubles


def _scores(problem: FitProblem, point: FloatArray, held_out: Sequence[FitTarget], troubles: list[str]) -> dict[str, Any]:
    """Return the fields of a `FitResult` that say how well the fitted plant predicts motion; `troubles` gets sentences."""
    fitted = problem.candidate(point)
    assert fitted is not None
    plants = [(_built(problem.model, p), p.localiser) for p in (fitted, problem.base)]

    def motions(target: FitTarget, which: int) -> tuple[Trajectory, ...]:
        plant, localiser = plants[which]
        return tuple(drive(plant, piece, localiser, target.source.sample_dt) for piece in target.source.pieces)

    def scored(target: FitTarget) -> Scored:
        motion = motions(target, 0)
        before: tuple[Trajectory, ...] = ()
        with contextlib.suppress(SsmrError):
            before = motions(target, 1)
        driven = [(target.source, motion)]
        return Scored(
            target.label, target.source.reference, target.truth, motion, before, compare_pieces(motion, target.truth),
            horizons_of(driven, _SCORE_HORIZONS), window_errors_of(driven, _SCORE_HORIZONS),
            tuple(piece.jumps for piece in target.source.pieces),
        )  # fmt: skip

    train, judged = tuple(map(scored, problem.targets)), list[Scored]()
    for target in held_out:
        try:
            judged.append(scored(target))
        except SsmrError as error:
            troubles.append(f"The fitted plant cannot be driven along {target.label}, which was held out: {error}.")
    sources = [target.source for target in problem.targets]
    befores = list(zip(sources, [s.before for s in train], strict=True))
    driven = list(zip(sources, [s.motion for s in train], strict=True))
    return {
        "train": train,
        "train_metrics": compare_pieces([m for s in train for m in s.motion], [t for s in train for t in s.truth]),
        "train_horizons": horizons_of(driven, _SCORE_HORIZONS),
        "train_windows": window_errors_of(driven, _SCORE_HORIZONS),
        "before_horizons": horizons_of(befores, _SCORE_HORIZONS) if all(s.before for s in train) else {},
        "held_out": tuple(judged),
    }


def _fitted_profile(result: FitResult, base: Profile, plant: PlantProfile | None, method: str) -> Profile:
    """Return the profile that the fit began with, its plant's numbers replaced, and their provenance."""
    assert plant is not None
    provenance = {
        "source": result.source,
        **{k: v for k, v in result.options.items() if v is not None and k in _TOLD},
        "method": method,
        "seed": result.seed,
        "status": result.status,
        "cost": result.cost,
        "evaluations": result.evaluations,
        "generations": result.generations,
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "versions": dict(result.versions),
        "standard_errors": {p.name: p.standard_error for p in result.parameters if p.standard_error is not None},
        "standard_errors_by": result.uncertainty_method,
        "train": _summary(result.train),
        "held_out": _summary(result.held_out),
    }
    kept = {k: v for k, v in provenance.items() if v not in ({}, "")}
    said = base.description
    if not base.provenance:
        said = (
            f"{base.robot.title or base.robot.name}, with what was fitted to {result.source}; the rest is as its file has it"
        )
    return replace(
        base,
        name=f"{base.name}-fitted",
        description=said,
        plants={**base.plants, result.model: plant},
        provenance={**base.provenance, result.model: kept},
    )


def _summary(scored: Sequence[Scored]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for s in scored:
        label = s.label.rpartition("/")[2]
        if 6.0 in s.horizons:
            errors = s.horizons[6.0]
            out[label] = {"position_median_6s_m": errors.position_median_m, "yaw_median_6s_rad": errors.yaw_median_rad}
        else:
            out[label] = {"d_rms_m": s.metrics["d_rms_m"], "sync_rms_m": s.metrics["sync_rms_m"]}
    return out
