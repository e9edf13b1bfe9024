"""Least squares after, or in the place of, differential evolution."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ssmr.geometry import wrap_angle
from ssmr.types import FloatArray
from tests.conftest import ROUNDOFF
from tests.robots import HUSKY
from tests.test_log_faults import drive
from tests.test_objective import scenario
from validation.fit import fit
from validation.identify.objective import FitCost, PathRater, _path_offsets
from validation.identify.problem import FitProblem
from validation.identify.refine import Corrected, Remembered, descend_from, descent_ends
from validation.plants.profile import Profile
from validation.plants.searchable import find_number, make_space
from validation.plants.table import plant_kind

FREE = ("u_x", "gain", "effective_half_track", "delay")
RECOVERED = 1e-3
"""Greatest error of a recovered number, as a share of the width of its bounds; the motions have no
noise."""


def quick(**more: Any) -> dict[str, Any]:
    return {"population": 12, "generations": 4, "free": FREE, "seed": 3, **more}


def truth(lab: Profile, names: tuple[str, ...]) -> FloatArray:
    return np.array(
        [find_number("improved", name, HUSKY).read(lab.plants["improved"]) for name in names]
    )


@pytest.mark.parametrize("objective", ["sync", "path"])
def test_a_short_search_arrives_at_the_numbers_that_made_the_motion(
    lab: Profile, objective: Any
) -> None:
    """Twelve candidates over four generations are nowhere near.

    Least squares go on to the truth.
    """
    options = {**quick(), "objective": objective}
    short = fit("improved", "traj4@improved", lab, search="jde", **options)
    whole = fit("improved", "traj4@improved", lab, search="hybrid", **options)
    assert whole.course.by_stage["jde"] == short.course.evaluations
    assert whole.course.evaluations == sum(whole.course.by_stage.values())
    assert whole.cost < 0.05 * short.cost
    for parameter, wanted in zip(whole.parameters, truth(lab, FREE), strict=True):
        assert abs(parameter.share(parameter.value) - parameter.share(wanted)) < RECOVERED, (
            parameter.name
        )


def test_least_squares_alone_begin_with_the_profile(lab: Profile) -> None:
    result = fit("improved", "traj4@improved", lab, free=FREE, objective="sync", search="lsq")
    assert result.cost < 1e-6  # these are the profile's own numbers
    assert result.course.jde.generation == 0
    away = fit(
        "improved",
        "traj4@improved",
        lab,
        free=FREE,
        objective="sync",
        search="lsq",
        guess={"delay": 0.3, "gain": 60.0},
    )
    assert away.cost < 1e-4
    assert away.course.stopped_by == "least squares"
    # others than the user's candidate are not even rated
    assert away.course.by_stage["jde"] == 1
    assert np.isfinite(away.course.jde.costs).sum() == 1


def test_least_squares_leave_the_start_on_a_log_in_which_the_robot_mostly_stands(
    tmp_path: Path,
) -> None:
    """The weak prior has more rows the longer a log is, and all are zero at the start."""
    columns = drive()
    late = {
        name: np.append(np.full(6, columns[name][0]), columns[name][:-6])
        for name in ("x", "y", "yaw")
    }
    rest = {name: values[-1] if name in late else 0.0 for name, values in (columns | late).items()}
    held = {
        name: np.append(values, np.full(6000, rest[name]))
        for name, values in (columns | late).items()
    }
    held["t"] = 0.05 * np.arange(len(held["t"]))
    np.savetxt(
        tmp_path / "still.csv",
        np.column_stack([*held.values()]),
        delimiter=",",
        header=",".join(held),
        comments="",
    )
    result = fit("kinematic", tmp_path / "still.csv", robot="husky", input="wheels", search="lsq")
    assert {p.name: p.value for p in result.parameters}["yaw_late"] == pytest.approx(0.3, abs=0.1)


def test_an_interrupted_search_goes_on_to_the_same_end(
    lab: Profile, tmp_path: Path, monkeypatch: Any
) -> None:
    whole = fit("improved", "traj4@improved", lab, search="hybrid", **quick(objective="sync"))
    real = FitProblem.residuals
    calls = []

    def cut(self: FitProblem, points: FloatArray, workers: int = 1) -> FloatArray:
        calls.append(len(points))
        if len(calls) == 6:
            raise KeyboardInterrupt
        return real(self, points, workers)

    monkeypatch.setattr(FitProblem, "residuals", cut)
    options = {"search": "hybrid", "out": tmp_path, **quick(objective="sync")}
    part = fit("improved", "traj4@improved", lab, **options)
    assert part.status == "interrupted"
    assert math.isfinite(part.cost)
    monkeypatch.setattr(FitProblem, "residuals", real)
    rest = fit(
        "improved",
        "traj4@improved",
        lab,
        search="hybrid",
        out=tmp_path,
        resume=True,
        **quick(objective="sync"),
    )
    assert rest.cost == whole.cost
    assert rest.course.evaluations == whole.course.evaluations
    assert [p.value for p in rest.parameters] == [p.value for p in whole.parameters]


# --------------------------------------------------------------------------------------------------
# parts


class Plateau:
    """Errors that a second number changes only in its lower half, where the optimum lies."""

    robust = False
    pulls = 0
    cheap = False
    dear = False

    def residuals(self, points: FloatArray, workers: int) -> FloatArray:
        """Return errors of (S, 2) points."""
        bend = np.minimum(points[:, 1], 0.55) - 0.2
        return np.column_stack([points[:, 0] - 0.4, bend, 0.3 * bend])


def test_a_plateau_is_left() -> None:
    points = np.array([[0.5, 0.95], [0.45, 0.9]])
    costs = np.linalg.norm(Plateau().residuals(points, 1), axis=1)
    ends = list(descent_ends(Plateau(), points, costs, 2, Remembered(), 1, lambda: None))
    assert ends[0][1] > 0.8
    assert ends[1] == pytest.approx([0.4, 0.2], abs=1e-3)


class Corner:
    """Errors with an optimum at (0.3, 0.4) and, beyond a ridge, a valley into a bound."""

    robust = False
    pulls = 0
    cheap = False
    dear = False

    def residuals(self, points: FloatArray, workers: int) -> FloatArray:
        """Return errors of (S, 2) points."""
        x = points[:, 0]
        return np.column_stack([np.minimum(x - 0.3, 1.3 - x), points[:, 1] - 0.4])


def test_a_valley_into_a_bound_is_left_though_all_candidates_are_in_it() -> None:
    points = np.array([[0.9, 0.95], [0.95, 0.1]])
    costs = np.linalg.norm(Corner().residuals(points, 1), axis=1)
    ends = list(descent_ends(Corner(), points, costs, 2, Remembered(), 1, lambda: None))
    assert ends[0] == pytest.approx([1.0, 0.4], abs=1e-3)
    assert ends[1] == pytest.approx([0.3, 0.4], abs=1e-3)


class Line:
    """A straight line through points of which some lie far off."""

    def __init__(self, outliers: int, robust: bool = False) -> None:
        self.robust = robust
        self.pulls = 0
        self.cheap = False
        self.dear = False
        rng = np.random.default_rng(1)
        self.x = np.linspace(-1.0, 1.0, 60)
        self.y = 0.3 + 0.4 * self.x + rng.normal(0.0, 0.01, 60)
        self.y[:outliers] += 1.0

    def residuals(self, points: FloatArray, workers: int) -> FloatArray:
        """Return errors of (S, 2) lines."""
        return points[:, :1] + points[:, 1:] * self.x - self.y


def test_errors_of_a_log_count_by_their_size() -> None:
    errors = {}
    for robust in (True, False):
        end = descend_from(Line(9, robust), np.array([0.9, 0.9]), Remembered(), 1, lambda: None)[0]
        errors[robust] = float(np.abs(end - [0.3, 0.4]).max())
    assert errors[True] < 0.03
    assert errors[False] > 0.1


def test_errors_that_are_a_little_wrong_are_corrected_where_a_descent_begins() -> None:
    """A line whose wrong twin lies higher by more than its errors, and with other slopes.

    The true line is asked where a descent begins, not for each derivative.
    """
    true = Line(0)
    wrong = Line(0)
    wrong.y = true.y + 0.05 + 0.02 * true.x
    asked = []

    def errors(points: FloatArray) -> FloatArray:
        asked.append(len(points))
        return true.residuals(points, 1)

    memory = Corrected(lambda points: wrong.residuals(points, 1), errors)
    begin = np.array([0.9, 0.9])
    end, _ = descend_from(wrong, begin, memory, 1, lambda: None)
    wanted, _ = descend_from(true, begin, Remembered(), 1, lambda: None)
    uncorrected, _ = descend_from(wrong, begin, Remembered(), 1, lambda: None)
    assert np.abs(end - wanted).max() < 1e-4
    assert np.abs(uncorrected - wanted).max() > 0.01
    assert asked == [1]  # there is one descent where errors count by their square
    memory.correct(end)
    looked_up = memory.look_up(end[None], lambda points: wrong.residuals(points, 1))
    assert looked_up == pytest.approx(true.residuals(end[None], 1), abs=ROUNDOFF)


class Bend:
    """Errors of a curve whose two numbers it bends with, each of which is dear."""

    robust = False
    pulls = 0
    cheap = False

    def __init__(self, dear: bool) -> None:
        self.dear = dear
        self.asked = 0
        self.x = np.linspace(0.0, 2.0, 40)

    def residuals(self, points: FloatArray, workers: int) -> FloatArray:
        """Return errors of (S, 3) points."""
        self.asked += len(points)
        a, b, c = points.T[:, :, None]
        return (
            a * np.exp(b * self.x) + c * self.x**2 - (0.3 * np.exp(0.7 * self.x) + 0.2 * self.x**2)
        )


def test_derivatives_of_dear_motions_are_guessed_on_the_way_to_the_same_end() -> None:
    """A second descent begins with differences, so guesses do not decide where it ends."""
    asked = {}
    for dear in (False, True):
        bend = Bend(dear)
        end, _ = descend_from(bend, np.array([0.8, 0.1, 0.9]), Remembered(), 1, lambda: None)
        assert end == pytest.approx([0.3, 0.7, 0.2], abs=1e-3)
        asked[dear] = bend.asked
    assert asked[True] < 0.8 * asked[False]


def test_offsets_of_a_path_are_perpendicular_to_it() -> None:
    """A path one decimetre to the left, with other samples: the offsets are (0, 0.1)."""
    truth = np.column_stack([np.linspace(0.0, 5.0, 101), np.zeros(101), np.zeros(101)])
    path = np.column_stack([np.linspace(-0.37, 5.4, 77), np.full(77, 0.1), np.zeros(77)])
    offsets = np.empty((1, 11, 2))
    _path_offsets(path[None], truth, 10, offsets)
    assert np.abs(offsets - [0.0, 0.1]).max() < 1e-12


def test_squares_of_residuals_are_the_costs_terms(lab: Profile) -> None:
    target = scenario(lab)
    space = make_space("improved", FREE, {}, HUSKY)
    points = np.random.default_rng(5).random((3, len(FREE)))
    for cost in (FitCost("sync", yaw_weight=0.3), FitCost("path")):
        problem = FitProblem("improved", lab.plants["improved"], space, [target], cost)
        squares = (problem.residuals(points) ** 2).sum(axis=1)
        assert len(problem.blocks) == problem.residuals(points).shape[1]
        if cost.objective == "sync":
            poses = plant_kind("improved").population([problem.candidate(p) for p in points], 1)
            error = (
                poses.motions(range(3), target.pieces[0], target.sample_dt) - target.truth[0].pose
            )
            error = error[:, :: round(0.1 / float(target.truth[0].t[1]))]
            wanted = (
                (error[..., :2] ** 2).sum(axis=2) + 0.09 * wrap_angle(error[..., 2]) ** 2
            ).mean(axis=1)
            assert np.allclose(squares, wanted, rtol=1e-12)
        else:
            assert isinstance(problem._raters[0], PathRater)
            # the faint errors at equal times come on top
            assert np.all(np.sqrt(squares) <= 1.1 * problem.costs(points))
