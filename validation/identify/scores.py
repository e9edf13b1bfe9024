"""Scores of a fitted plant: how far its motion and its torques are from the true ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from typing import Any

import numpy as np

from ssmr.metrics.declared import Metrics, compare_pieces
from ssmr.metrics.windows import HorizonErrors, WindowErrors
from ssmr.types import Trajectory
from validation.experiment.sources import horizons_of, window_errors_of
from validation.identify.objective import FitCost, FitTarget
from validation.report.motions import HEADLINE_HORIZON

HORIZONS = (2.0, 6.0, 30.0, 60.0)
"""Horizons of the relative pose errors in results [s]."""


@dataclass(frozen=True, eq=False)
class Scored:
    """A fitted plant on one source, or on several together."""

    label: str
    """The source as the user named it, with its input where it is a recording driven by both."""
    motion: tuple[Trajectory, ...]
    """The fitted plant's motion, piece by piece."""
    metrics: Metrics
    """Distances of `motion` from the true one, over all pieces."""
    horizons: Mapping[float, HorizonErrors]
    """Errors of the relative pose, by horizon [s]; empty where the truth is a plant's motion."""
    windows: Mapping[float, WindowErrors]
    """Errors over windows that begin every second, by horizon [s]; empty where the truth is a
    plant's motion."""
    torque_rms: float | None
    """Root mean square error of the sides' torques [N m]; None where one of the two has none."""

    def as_dict(self) -> dict[str, Any]:
        """Return the scores as fit.json holds them."""
        horizons = {
            f"{h:g}": {**asdict(errors), "overlapping": asdict(self.windows[h].summary())}
            for h, errors in self.horizons.items()
        }
        document: dict[str, Any] = dict(self.metrics)
        if self.torque_rms is not None:
            document["torque_rms_N_m"] = self.torque_rms
        if horizons:
            document["horizons"] = horizons
        return document


def score(
    label: str, targets: Sequence[FitTarget], motions: Sequence[tuple[Trajectory, ...]]
) -> Scored:
    """Return the scores of a plant's motions over the pieces of some targets, under a label."""
    driven = [(target.source, motion) for target, motion in zip(targets, motions, strict=True)]
    truth = tuple(chain(*(target.truth for target in targets)))
    motion = tuple(chain(*motions))
    errors = horizons_of(driven, HORIZONS), window_errors_of(driven, HORIZONS)
    torques = np.concatenate(list(map(FitTarget.torque_errors, targets, motions)))
    rms = None
    if len(torques):
        rms = float(np.sqrt(np.mean(torques**2)))
    return Scored(label, motion, compare_pieces(motion, truth), *errors, rms)


def worse_sentences(
    cost: FitCost, even_if_worse: bool, before: Sequence[Scored], after: Sequence[Scored]
) -> list[str]:
    """Return a sentence where the error on held-out sources is larger than before the fit."""

    def size(s: Scored) -> float:
        """The error at the headline's horizon, weighed as in the cost; of scenarios, d_rms."""
        if not s.windows:
            return s.metrics["d_rms_m"]
        horizon = min(s.windows, key=lambda h: abs(h - HEADLINE_HORIZON))
        e = s.windows[horizon].summary()
        yaw = cost.yaw_weight * e.yaw_median_rad
        return cost.position_weight * e.position_median_m + yaw

    was = float(np.mean([*map(size, before)])) if before else 0.0
    now = float(np.mean([*map(size, after)])) if after else 0.0
    if now <= was:
        return []
    kept = "keeps the old ones (--even-if-worse)"
    if even_if_worse:
        kept = "has the fitted numbers all the same"
    return [
        f"The fit's error on held-out data is larger than before, {now:.3g} m instead of "
        f"{was:.3g} m: profile.toml {kept}."
    ]
