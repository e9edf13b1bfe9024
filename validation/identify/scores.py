"""How well a fitted plant predicts the motions of one or several sources."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from typing import Any

from ssmr.errors import SsmrError
from ssmr.metrics.declared import Metrics, compare_pieces
from ssmr.metrics.windows import HorizonErrors, WindowErrors
from ssmr.types import Plant, Trajectory
from validation.bench.sources import drive, horizons_of, window_errors_of
from validation.identify.objective import FitTarget
from validation.identify.problem import FitProblem
from validation.plants.kind import PlantProfile
from validation.plants.profile import Profile, make_plant

HORIZONS = (2.0, 6.0, 30.0, 60.0)
"""Horizons of the relative pose errors in results [s]."""


@dataclass(frozen=True, eq=False)
class Scored:
    """A fitted plant on one source, or on several together."""

    label: str
    """The source as the user named it, with its input where it is a recording driven by both."""
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
    windows: Mapping[float, WindowErrors]
    """Errors over windows that begin every second, by horizon [s]; empty where the truth is a plant's motion."""

    def as_dict(self) -> dict[str, Any]:
        """Return the scores as fit.json holds them."""
        overlapping = {h: asdict(errors.summary()) for h, errors in self.windows.items()}
        horizons = {f"{h:g}": {**asdict(errors), "overlapping": overlapping[h]} for h, errors in self.horizons.items()}
        return {**self.metrics, **({"horizons": horizons} if horizons else {})}


def built(model: str, plant: PlantProfile) -> Plant:
    """Return the plant of these numbers; a ValueError says why there is none."""
    return make_plant(Profile("with these values", "", {model: plant}, {}), model)


def scored(problem: FitProblem, fitted: PlantProfile, target: FitTarget) -> Scored:
    """Drive the fitted plant, and the one of before, along one source; an SsmrError says that the fitted one diverged."""

    def motion(plant: PlantProfile) -> tuple[Trajectory, ...]:
        made = built(problem.model, plant)
        return tuple(drive(made, piece, plant.localiser, target.source.sample_dt) for piece in target.source.pieces)

    driven, before = motion(fitted), tuple[Trajectory, ...]()
    with contextlib.suppress(SsmrError):
        before = motion(problem.base)
    return score(target.label, [target], [driven], before)


def score(
    label: str, targets: Sequence[FitTarget], motions: Sequence[tuple[Trajectory, ...]], before: tuple[Trajectory, ...] = ()
) -> Scored:
    """Return the scores of motions along several sources together."""
    driven = [(target.source, motion) for target, motion in zip(targets, motions, strict=True)]
    truth, motion = tuple(chain(*(target.truth for target in targets))), tuple(chain(*motions))
    errors = horizons_of(driven, HORIZONS), window_errors_of(driven, HORIZONS)
    return Scored(label, truth, motion, before, compare_pieces(motion, truth), *errors)
