"""How well a plant at a point of a fit's problem predicts: along its sources, and along others."""

from __future__ import annotations

import contextlib
from collections.abc import Container, Iterable, Sequence
from copy import copy
from itertools import chain, product

import numpy as np

from ssmr.errors import ParameterError, SsmrError
from ssmr.metrics.bands import QUARTERS, Band
from ssmr.types import FloatArray, Plant, Trajectory
from validation.experiment.runs import drive_source
from validation.experiment.scores import Driven, NamedScores, Scores, band_of
from validation.experiment.sources import Source
from validation.identify.problem import FitProblem
from validation.identify.targets import score_pieces
from validation.identify.uncertainty import FEWEST_DAYS, Uncertainty, usual_spread
from validation.plants.kind import PlantProfile
from validation.plants.searchable import with_values
from validation.plants.table import SIMULATED, plant_kind
from validation.simulator.physics import SHIPPED
from validation.simulator.terrain import FLAT


def _build_level_plant(model: str, plant: PlantProfile) -> Plant:
    """Return a plant on level ground; a ParameterError says that it cannot have such numbers."""
    return plant_kind(model).build(plant, FLAT, SHIPPED)


def require_possible(problem: FitProblem, given: Container[str]) -> None:
    """Refuse numbers that no candidate can have.

    Those are the profile's, a number that can go to neither of its bounds, and given bounds of mass
    and inertia that no body has. Where default bounds reach farther than a robot's other numbers
    allow, candidates beyond are rated as impossible.
    """
    ends: list[dict[str, float]] = [{}]
    for k, p in enumerate(problem.space.parameters):
        both = np.tile(problem.begun, (2, 1))
        both[:, k] = 0.0, 1.0
        # a number that may go nowhere, as a ratio of frictions on tyres that have one
        if not any(map(problem.candidate, both)):
            ends.append({p.name: p.lower})
        is_inertia = p.name in ("yaw_inertia", "mass") and problem.model in SIMULATED
        if is_inertia and p.name in given:
            ends += [{p.name: p.lower}, {p.name: p.upper}]
    for end in ends:
        try:
            plant = with_values(problem.model, problem.base, list(end), end.values())
            _build_level_plant(problem.model, plant)
        except ParameterError as error:
            lead = "".join(f"bounds of {name}: " for name in end)
            raise ValueError(f"{lead}{error}") from error


def motions_of(problem: FitProblem, plant: PlantProfile, source: Source) -> tuple[Trajectory, ...]:
    """Drive a plant along one source; an SsmrError says that it diverged."""
    return drive_source(_build_level_plant(problem.model, plant), source, plant.localiser)


def plant_on(problem: FitProblem, point: FloatArray, source: Source) -> PlantProfile:
    """Return the plant at an (n,) point of the unit cube on one source, which is possible."""
    plant = problem.candidate(point, source.tags)
    assert plant is not None
    return plant


Judges = Iterable[tuple[FitProblem, FloatArray, Sequence[Source]]]
"""Problems of fits, the (n,) point of the unit cube where each ended, and sources that it has not
seen."""


def held_out_scores(
    judges: Judges,
) -> tuple[NamedScores, NamedScores, NamedScores, list[Driven], list[str]]:
    """Return the scores on held-out sources before and after fits, by source, and notes.

    Those of all sources together come third, as `Fitted.judged` has them, and the sources as the
    fitted plants drive them fourth. Data may hold a motion that a fitted plant cannot make; the
    rest is still judged.
    """
    notes = []
    able = []
    before = []
    after = []
    for problem, point, sources in judges:
        for source in sources:
            try:
                motions = motions_of(problem, plant_on(problem, point, source), source)
                before.append(motions_of(problem, problem.before(source.tags), source))
            except SsmrError as error:
                lead = f"The plant cannot be driven along {source.name}, which was held out"
                notes.append(f"{lead}: {error}.")
                continue
            able.append(source)
            after.append(motions)
    if not able:
        return {}, {}, {}, [], notes
    unfitted, all_before = scores_by_source(able, before)
    fitted, all_after = scores_by_source(able, after)
    driven = list[Driven]()
    for source, motions in zip(able, after, strict=True):
        driven.append(source.driven(motions))
    return unfitted, fitted, {"before": all_before, "after": all_after}, driven, notes


def scores_by_source(
    sources: Sequence[Source], motions: Sequence[Sequence[Trajectory]]
) -> tuple[NamedScores, Scores]:
    """Return the scores of a plant's motions on each source, and on all together."""
    each = {}
    for source, driven in zip(sources, motions, strict=True):
        each[source.name] = score_pieces(source.pieces, driven)
    pieces = list(chain(*(source.pieces for source in sources)))
    return each, score_pieces(pieces, list(chain(*motions)))


def left_out_band(problem: FitProblem, sure: Uncertainty, best: FloatArray) -> Band | None:
    """Spread of predictions along the recordings when parts of the data are left out.

    They are whole logs where there are enough of them: each is predicted as a log that is judged
    alone is, by the numbers and the mean localiser of the others. A single log has a day of its
    own, from which another one differs: see `_draw_days`.
    """
    alone = len(problem.days) == 1
    by_log = len(problem.days) >= FEWEST_DAYS
    parts = []
    for k, point in enumerate(sure.without):
        driven = []
        for source in problem.sources:
            if by_log and source.tags != problem.days[k].tags:
                continue
            plant = problem.candidate(point, source.tags)
            if by_log:
                plant = _from_others(problem, k, point)
            if alone:
                plant = _draw_days(problem, point)[k]
            plant = plant or plant_on(problem, best, source)
            driven += source.driven(motions_of(problem, plant, source))
        parts.append(driven)
    return band_of(parts, by_log, alone)


def band_of_one_day(judges: Judges) -> Band | None:
    """Return the band of predictions of other days, from parts that fits to a day have not seen."""
    parts = []
    for problem, point, sources in judges:
        for plant, source in product(filter(None, _draw_days(problem, point)), sources):
            with contextlib.suppress(SsmrError):
                parts.append(source.driven(motions_of(problem, plant, source)))
    return band_of(parts, True, True)


def _draw_days(problem: FitProblem, point: FloatArray) -> list[PlantProfile | None]:
    """Return plants on other days than the log's at an (n,) point of the unit cube.

    Each number is one usual spread from day to day more or less than there, by the draw of a coin;
    None stands for what is impossible.
    """
    spread = np.array(list(map(usual_spread, problem.space.names)))
    signs = np.random.default_rng(0).choice((-1.0, 1.0), (QUARTERS, len(point)))
    tags = problem.days[0].tags
    return [problem.candidate(np.clip(point + spread * each, 0.0, 1.0), tags) for each in signs]


def _from_others(problem: FitProblem, k: int, point: FloatArray) -> PlantProfile | None:
    """Return the plant on the k-th log without any number that this log alone has."""
    log, *ground = problem.days[k].tags
    is_own = [name.partition("@")[2] == log for name in problem.space.names]
    others = copy(problem)
    others.weights = np.where(is_own, 0.0, problem.weights)
    return others.candidate(point, ground)
