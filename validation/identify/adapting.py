"""Calibrating on while driving: a plant's numbers follow a log, and predict from its past alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from ssmr.geometry import compose_poses, relative_pose
from ssmr.types import FloatArray, Trajectory
from validation.experiment.gyro import with_gyro
from validation.experiment.sources import Piece, Source, source_of
from validation.files.columns import COMMAND_COLUMNS, POSE_COLUMNS
from validation.files.inspection import Inspected
from validation.files.log import Log
from validation.identify.judging import motions_of, plant_on
from validation.identify.objective import FitCost, true_motion
from validation.identify.problem import FitProblem
from validation.identify.refine import Remembered, descend_from
from validation.identify.uncertainty import USUAL_SPREAD
from validation.plants.kind import Occasion, PlantProfile
from validation.plants.searchable import make_space
from validation.plants.table import plant_kind

Adapted = tuple[list[Piece], list[Trajectory], list[float], tuple[Trajectory, ...]]
"""Predictions of a plant whose numbers follow a log: the log's pieces once for each set of numbers,
with the windows that begin while it holds; the plant's motion over each of them, and the delay of
its headings there [s]; and its motion over each piece of the log, put together from what each set
of numbers drives."""


class _Past:
    """A problem whose errors are those of windows that have ended."""

    robust = True
    cheap = False
    dear = False

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
    problem = _prior_problem(model, base, source, occasion)
    ends = np.concatenate([rater.ends for rater, _ in problem.days[0].raters])
    truths = [true_motion(piece) for piece in source.pieces]
    first = truths[0].t[0]
    changes = np.arange(first + seconds, truths[-1].t[-1], seconds)
    driven = Remembered()
    point = problem.begun
    pieces = []
    every = list[Trajectory]()
    late = []
    sets = []
    for begin, end in zip((-np.inf, *changes), (*changes, np.inf), strict=True):
        known = ends <= begin
        if known.any():
            past = _Past(problem, driven, known)
            point, _ = descend_from(past, point, Remembered(), 1, lambda: None)
        plant = plant_on(problem, point, source)
        motions = motions_of(problem, plant, source)
        sets.append((begin, motions))
        pieces += [replace(piece, begins=(begin, end)) for piece in source.pieces]
        every += motions
        late.append(plant.localiser.yaw_late)
    path = []
    for k, truth in enumerate(truths):
        path.append(_join_parts(truth.t, [(begin, motions[k]) for begin, motions in sets]))
    return pieces, every, late, tuple(path)


def _prior_problem(
    model: str, base: PlantProfile, source: Source, occasion: Occasion
) -> FitProblem:
    """Return the problem of a fit to a log that has a profile with its spread as its prior."""
    space = make_space(model, plant_kind(model).free[occasion], {}, base.robot)
    usual = {p.name: USUAL_SPREAD * (p.upper - p.lower) for p in space.parameters}
    base = replace(base, spread={**usual, **base.spread})
    return FitProblem(model, base, space, [with_gyro(source)], FitCost())


class Calibrating:
    """A plant whose numbers follow a robot while it drives: give it samples as they come.

    ```
    calibrating = Calibrating("kinematic", profile.section("kinematic"))
    if calibrating.add(t, (left, right), (x, y, yaw)):
        use(calibrating.plant)
    ```
    """

    plant: PlantProfile
    """The plant with the latest numbers."""

    def __init__(
        self, model: str, base: PlantProfile, seconds: float = 30.0, memory: float = 600.0
    ) -> None:
        """Begin with a plant whose numbers and spread are the prior.

        Args:
            model: name of the plant; the kinematic one takes a second for each fit.
            base: its numbers.
            seconds: time between two fits [s].
            memory: time after which samples are forgotten [s].
        """
        self.plant = base
        self._model = model
        self._base = base
        self._seconds = seconds
        self._kept = round(memory / seconds)
        self._blocks: list[list[Sequence[float]]] = [[]]

    def add(self, t: float, rates: Sequence[float], pose: Sequence[float]) -> bool:
        """Take a sample; return whether the numbers are new.

        A call in which they are fitted lasts as long as the fit.

        Args:
            t: its stamp [s], later than the one before.
            rates: rates of the left and the right wheels [rad/s].
            pose: x, y [m] and yaw [rad] of the pose source.
        """
        block = self._blocks[-1]
        block.append((t, *rates, *pose))
        if t - block[0][0] < self._seconds:
            return False
        table = np.array(list(chain.from_iterable(self._blocks))).T
        self._blocks = [*self._blocks[-self._kept :], []]
        columns = dict(zip(("t", *COMMAND_COLUMNS["wheels"], *POSE_COLUMNS), table, strict=True))
        try:
            log = Log.of_columns("the drive", columns)
            source = source_of(Inspected(log), "the drive", "wheels")
            problem = _prior_problem(self._model, self._base, source, "wheels")
        except ValueError:
            # the robot stood, or its poses have too many gaps
            return False
        point, _ = descend_from(problem, problem.begun, Remembered(), 1, lambda: None)
        self.plant = problem.candidate(point) or self.plant
        return True


def _join_parts(t: FloatArray, parts: Sequence[tuple[float, Trajectory]]) -> Trajectory:
    """Return one motion at (M,) stamps [s], each part of which drives on from its own time."""
    pose = parts[0][1].pose.copy()
    twist = parts[0][1].twist.copy()
    for begin, motion in parts[1:]:
        k = np.searchsorted(t, begin)
        # the last pose before the change stands for both
        if 0 < k < len(t):
            pose[k:] = compose_poses(
                pose[k - 1], relative_pose(motion.pose[k - 1], motion.pose[k:])
            )
            twist[k:] = motion.twist[k:]
        elif k == 0:
            pose = motion.pose.copy()
            twist = motion.twist.copy()
    return Trajectory(t, pose, twist, parts[0][1].wheels)
