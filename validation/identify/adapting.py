"""Calibrating on while driving: a plant's numbers follow a log, and predict from its past alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ssmr.geometry import compose, relative
from ssmr.types import FloatArray, Trajectory
from validation.experiment.gyro import with_gyro
from validation.experiment.sources import Piece, Source
from validation.identify.judging import motions_of, plant_on
from validation.identify.objective import FitCost, true_motion
from validation.identify.problem import FitProblem
from validation.identify.refine import Remembered, descend
from validation.identify.uncertainty import USUAL_SPREAD
from validation.plants.kind import Occasion, PlantProfile
from validation.plants.searchable import make_space
from validation.plants.table import plant_kind


class Adapted(NamedTuple):
    """Predictions of a plant whose numbers follow a log."""

    pieces: list[Piece]
    """The log's pieces once for each set of numbers, with the windows that begin while it holds."""
    motions: list[Trajectory]
    """The plant's motion over each of them."""
    late: list[float]
    """Delay of its headings there [s]."""
    path: tuple[Trajectory, ...]
    """Its motion over each piece of the log, put together from what each set of numbers drives."""


class Past:
    """A problem whose errors are those of windows that have ended."""

    robust = True
    cheap = False

    def __init__(self, problem: FitProblem, driven: Remembered, known: FloatArray) -> None:
        """Keep the problem, what of it was driven, and (K,) which of its errors are known."""
        self.pulls = problem.pulls
        self._problem = problem
        self._driven = driven
        self._known = np.append(known, np.ones(problem.pulls)) > 0.0

    def residuals(self, points: FloatArray, workers: int | str = 1) -> FloatArray:
        """Return (S, L) errors of (S, n) points of the unit cube."""
        errors = self._driven.look_up(points, lambda new: self._problem.residuals(new, 1))
        return errors[:, self._known]


def adapted_along(
    model: str, base: PlantProfile, source: Source, occasion: Occasion, seconds: float
) -> Adapted:
    """Drive a plant along a log with numbers that are fitted anew every so many seconds.

    The profile is the prior. A prediction has numbers that come from errors of windows which ended
    before it begins.

    Raises:
        ValueError: the log is too short.
        SsmrError: the plant diverged.
    """
    space = make_space(model, plant_kind(model).free[occasion], {}, base.robot)
    usual = {p.name: USUAL_SPREAD * (p.upper - p.lower) for p in space.parameters}
    base = replace(base, spread={**usual, **base.spread})
    problem = FitProblem(model, base, space, [with_gyro(source)], FitCost())
    ends = np.concatenate([rater.ends for rater, _ in problem.days[0].raters])
    truths = [true_motion(piece) for piece in source.pieces]
    first = float(truths[0].t[0])
    changes = np.arange(first + seconds, float(truths[-1].t[-1]), seconds)
    driven = Remembered()
    point = problem.begun
    adapted = Adapted([], [], [], ())
    sets = []
    for begin, end in zip((-np.inf, *changes), (*changes, np.inf), strict=True):
        known = ends <= begin
        if known.any():
            past = Past(problem, driven, known)
            point, _ = descend(past, point, Remembered(), 1, lambda: None)
        plant = plant_on(problem, point, source)
        motions = motions_of(problem, plant, source)
        sets.append((float(begin), motions))
        adapted.pieces.extend(replace(piece, begins=(begin, end)) for piece in source.pieces)
        adapted.motions.extend(motions)
        adapted.late.append(plant.localiser.yaw_late)
    path = []
    for k, truth in enumerate(truths):
        path.append(_together(truth.t, [(begin, motions[k]) for begin, motions in sets]))
    return adapted._replace(path=tuple(path))


def _together(t: FloatArray, parts: Sequence[tuple[float, Trajectory]]) -> Trajectory:
    """Return one motion at (M,) stamps [s], each part of which drives on from its own time."""
    pose = parts[0][1].pose.copy()
    twist = parts[0][1].twist.copy()
    for begin, motion in parts[1:]:
        k = int(np.searchsorted(t, begin))
        # the last pose before the change stands for both
        if 0 < k < len(t):
            pose[k:] = compose(pose[k - 1], relative(motion.pose[k - 1], motion.pose[k:]))
            twist[k:] = motion.twist[k:]
        elif k == 0:
            pose = motion.pose.copy()
            twist = motion.twist.copy()
    return Trajectory(t, pose, twist, parts[0][1].wheels)
