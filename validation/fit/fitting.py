"""What is made of a fit's outcome: parameters with their errors, scores, a profile with provenance. No command line here."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from ssmr.errors import SsmrError
from ssmr.metrics.paths import HorizonErrors, compare_pieces
from ssmr.search.jde import JdeSettings
from ssmr.types import FloatArray, Trajectory
from validation import store
from validation.fit.objective import Problem, Target
from validation.fit.result import FitResult, FittedParameter, Scored
from validation.fit.search import Search
from validation.fit.uncertainty import Uncertainty, estimate, sentences
from validation.motion.driving import drive, horizons_of
from validation.plants.profile import PlantProfile, Profile, make_plant
from validation.plants.searchable import find

SCORE_HORIZONS = (2.0, 6.0, 30.0, 60.0)
"""Of the relative pose error that results report [s]."""


def identity(problem: Problem, settings: JdeSettings, seed: int, start: FloatArray | None) -> dict[str, str]:
    """Digests of all that decides a search's outcome, by what they are of."""
    space = [(p.name, p.lower, p.upper, p.scale) for p in problem.space.parameters]
    data = hashlib.sha256()
    for target in problem.targets:
        data.update(target.label.rpartition("/")[2].encode())
        for piece, truth in zip(target.source.pieces, target.truth, strict=True):
            for array in (piece.commands.values, truth.t, truth.pose):
                data.update(np.ascontiguousarray(array).tobytes())
    plain = {
        "model": problem.model,
        "parameters or bounds": space,
        "profile": asdict(problem.base),
        "objective": asdict(problem.settings),
        "settings of the search": asdict(settings),
        "start": None if start is None else start.tolist(),
        "seed": seed,
    }
    digests = {name: hashlib.sha256(repr(value).encode()).hexdigest() for name, value in plain.items()}
    return {**digests, "sources": data.hexdigest()}


@dataclass(frozen=True, eq=False)
class Asked:
    """What a fit was asked for, besides its problem."""

    profile: Profile
    """That the fit begins with."""
    source: str
    """As the user named it."""
    held_out: tuple[Target, ...]
    """What it is judged on."""
    seed: int
    """Of the search."""
    options: Mapping[str, object]
    """For the record."""


def conclude(search: Search, problem: Problem, asked: Asked, workers: int) -> FitResult:
    """Make of a search's outcome a result: parameters with their errors, scores on what was fitted and what was not.

    Raises:
        SsmrError: no candidate was fit to be driven, or the best one fails on what was held out.
    """
    jde = search.jde
    if not np.isfinite(jde.best_cost):
        raise SsmrError("no candidate could be driven: every one was impossible or diverged; look at --bounds and --fix")
    point = jde.best
    uncertainty = None if search.interrupted else estimate(problem, point, workers)
    fitted = problem.candidate(point)
    assert fitted is not None
    train = tuple(score(problem, fitted, target) for target in problem.targets)
    return FitResult(
        model=problem.model,
        profile=asked.profile.name,
        source=asked.source,
        seed=asked.seed,
        status="interrupted" if search.interrupted else "finished",
        stopped_by=jde.finished or "interrupt",
        cost=float(jde.best_cost),
        cost_name=problem.settings.name,
        evaluations=jde.evaluations,
        generations=jde.generation,
        wall_s=search.wall_s,
        parameters=_parameters(problem, point, uncertainty),
        correlation=None if uncertainty is None else uncertainty.correlation,
        uncertainty_method="" if uncertainty is None else uncertainty.method,
        notes=sentences(problem.model, problem.space, point, uncertainty),
        train=train,
        train_metrics=compare_pieces([m for s in train for m in s.motion], [t for s in train for t in s.truth]),
        train_horizons=horizons_over([(t, s.motion) for t, s in zip(problem.targets, train, strict=True)]),
        before_horizons=(
            horizons_over([(t, s.before) for t, s in zip(problem.targets, train, strict=True)])
            if all(s.before for s in train)
            else {}
        ),
        held_out=tuple(score(problem, fitted, target) for target in asked.held_out),
        trace=search.trace(),
        options=asked.options,
        versions=store.versions(),
    )


def _parameters(problem: Problem, point: FloatArray, uncertainty: Uncertainty | None) -> tuple[FittedParameter, ...]:
    values, at_bound = problem.space.values(point), problem.space.at_bound(point)
    out = []
    for i, p in enumerate(problem.space.parameters):
        error, interval = None, None
        if uncertainty is not None and np.isfinite(uncertainty.standard_error[i]):
            error = float(uncertainty.standard_error[i])
            interval = (float(uncertainty.interval[i, 0]), float(uncertainty.interval[i, 1]))
        before = find(problem.model, p.name).read(problem.base)
        out.append(
            FittedParameter(
                p.name, p.unit, float(values[i]), p.lower, p.upper, p.scale, before, bool(at_bound[i]), error, interval
            )
        )
    return tuple(out)


def score(problem: Problem, fitted: PlantProfile, target: Target) -> Scored:
    """The fitted plant, and the one before the fit, on one source."""
    motion = _motions(problem.model, fitted, target)
    try:
        before: Sequence[Trajectory] = _motions(problem.model, problem.base, target)
    except SsmrError:
        before = ()
    metrics = compare_pieces(motion, target.truth)
    horizons = horizons_of([(target.source, motion)], SCORE_HORIZONS)
    return Scored(target.label, target.source.reference, target.truth, tuple(motion), tuple(before), metrics, horizons)


def _motions(model: str, plant: PlantProfile, target: Target) -> list[Trajectory]:
    made = make_plant(Profile("", "", {model: plant}, {}), model)
    return [drive(made, piece, plant.tracked_point, target.source.sample_dt) for piece in target.source.pieces]


def horizons_over(driven: Sequence[tuple[Target, Sequence[Trajectory]]]) -> dict[float, HorizonErrors]:
    """Errors of the relative pose over several sources together."""
    return horizons_of([(target.source, motions) for target, motions in driven], SCORE_HORIZONS)


def fitted_profile(result: FitResult, base: Profile, problem: Problem, point: FloatArray, name: str, date: str) -> Profile:
    """The profile that the fit began with, its plant's numbers replaced, and where they come from."""
    plant = problem.candidate(point)
    assert plant is not None
    rounded = replace(plant)
    provenance = {
        "source": result.source,
        **{k: v for k, v in result.options.items() if v is not None and k in ("input", "from", "until", "objective")},
        "method": "jDE {strategy} {crossover}, population {population}".format(**result.options),
        "seed": result.seed,
        "status": result.status,
        "cost": result.cost,
        "evaluations": result.evaluations,
        "generations": result.generations,
        "date": date,
        "versions": dict(result.versions),
        "standard_errors": {p.name: p.standard_error for p in result.parameters if p.standard_error is not None},
        "standard_errors_by": result.uncertainty_method,
        "train": _summary(result.train),
        "held_out": _summary(result.held_out),
    }
    kept = {k: v for k, v in provenance.items() if v not in ({}, "")}
    return replace(
        base,
        name=name,
        plants={**base.plants, result.model: rounded},
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
            out[label] = {"d_rms_m": s.metrics.d_rms_m, "sync_rms_m": s.metrics.sync_rms_m}
    return out


def as_document(result: FitResult) -> dict[str, Any]:
    """fit.json."""

    def metrics(scored: Scored) -> dict[str, Any]:
        return _metrics(scored.metrics, scored.horizons)

    parameters = {
        p.name: {
            "value": p.value,
            "unit": p.unit,
            "lower": p.lower,
            "upper": p.upper,
            "scale": p.scale,
            "at_bound": p.at_bound,
            "standard_error": p.standard_error,
            "interval_95": p.interval_95,
            "before": p.before if np.isfinite(p.before) else None,
        }
        for p in result.parameters
    }
    names = [p.name for p in result.parameters]
    correlation = result.correlation
    return {
        "schema": "ssmr.fit/1",
        "model": result.model,
        "source": result.source,
        "profile": result.profile,
        "seed": result.seed,
        "status": result.status,
        "stopped_by": result.stopped_by,
        "cost": result.cost,
        "cost_name": result.cost_name,
        "evaluations": result.evaluations,
        "generations": result.generations,
        "wall_s": result.wall_s,
        "parameters": parameters,
        "correlation": None if correlation is None else {"names": names, "matrix": correlation.tolist()},
        "standard_errors_by": result.uncertainty_method,
        "notes": list(result.notes),
        "train": _metrics(result.train_metrics, result.train_horizons),
        "train_by_source": {s.label: metrics(s) for s in result.train},
        "held_out": {s.label: metrics(s) for s in result.held_out},
        "options": dict(result.options),
        "versions": dict(result.versions),
        "best_cost_by_generation": result.trace.best_cost[np.isfinite(result.trace.best_cost)].tolist(),
    }


def _metrics(metrics: Any, horizons: Mapping[float, HorizonErrors]) -> dict[str, Any]:
    out: dict[str, Any] = asdict(metrics)
    if horizons:
        out["horizons"] = {f"{h:g}": asdict(errors) for h, errors in horizons.items()}
    return out
