"""Tuning: costs by their formulas, the stability guard, resumption.

Track and tune as their users call them.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from ssmr.control.loop import ClosedRun, LoopSettings
from ssmr.control.references import circle, line
from ssmr.control.waypoints import Waypoints
from ssmr.metrics.declared import compare_paths
from tests.conftest import ROUNDOFF
from validation.experiment.gains import load_gains
from validation.experiment.loops import make_controller, make_robot, run_robots
from validation.experiment.tracked import track_metrics
from validation.identify.tuning import (
    TARGET_SHARE,
    TuneCase,
    TuneCost,
    TuneMeasure,
    TuneProblem,
    costs_of,
    delay_robot,
    make_tuning_space,
)
from validation.output import Progress
from validation.plants.profile import Profile
from validation.simulator.physics import PhysicsSettings
from validation.simulator.plant import MujocoPlant
from validation.simulator.terrain import parse_terrain
from validation.track import track
from validation.tune import Tuned, tune

QUIET = LoopSettings("truth", disturbance=False)


def case(
    lab: Profile, plant: str = "linear", settings: LoopSettings = QUIET, speed: float = 0.5
) -> TuneCase:
    return TuneCase("circle", "circle", circle(speed, 0.8, 0.5), make_robot(lab, plant), settings)


def problem(
    lab: Profile, cost: TuneCost | None = None, controller: str = "pid", *cases: TuneCase
) -> TuneProblem:
    base = load_gains(controller, "published")
    space = make_tuning_space(controller, None, False, {})
    return TuneProblem(lab, base, space, cases or (case(lab),), cost or TuneCost(guard=0.0))


def published_point(p: TuneProblem) -> np.ndarray:
    return p.space.points(np.array([p.base.values[name] for name in p.space.names]))


# --------------------------------------------------------------------------------------------------
# costs


def test_the_cost_is_that_of_the_thesis(lab: Profile) -> None:
    """Sec. 4.3.3 and 4.4.3, with |1 - ratio|."""
    weights = TuneCost(k_u=50.0, guard=0.0)
    p = problem(lab, weights)
    one = case(lab)
    (run,) = run_robots([one.robot], [make_controller(lab, p.base)], [QUIET], one.waypoints, [0])
    m = compare_paths(run.motion, one.target)
    u_rms = track_metrics(run, one.waypoints, one.robot.limits)["u_rms_ratio"]
    wanted = (
        100 * m["d_rms_m"]
        + 15 * m["d_haus_m"]
        + 10 * abs(1 - m["d_ratio"])
        + 10 * abs(1 - m["e_bend_ratio"])
        + 50 * abs(1 - u_rms)
    )
    # the point went through the unit cube
    assert p.costs(published_point(p)[None])[0] == pytest.approx(wanted, rel=1e-9)


def test_the_time_cost_sees_the_clock(lab: Profile) -> None:
    """A robot that follows the path late costs nothing by path and its distance by time."""
    waypoints = line(0.5, 4.0)
    target = waypoints.trajectory(0.008)
    late = np.zeros((len(target), 25))
    late[:, :3] = target.pose
    late[:, 3] = 0.5
    late[:, 0] = np.clip(late[:, 0] - 0.1, 0.0, None)
    run = ClosedRun(np.array(target.t), late, lost=False)
    apart = np.hypot(*(late[:, :2] - target.xy).T)
    by = {
        name: float(
            costs_of([run], target, 0.5, TuneCost(name, k_ratio=0.0, k_haus=0.0, guard=0.0))[0]
        )  # type: ignore[arg-type]
        for name in ("path", "time")
    }
    assert by["time"] == pytest.approx(100 * math.sqrt(np.mean(apart**2)), rel=ROUNDOFF)
    assert by["path"] < 0.2 * by["time"]


@pytest.mark.parametrize("guard", [0.0, 0.2])
def test_limits_and_workers_change_no_kept_cost(lab: Profile, guard: float) -> None:
    p = problem(lab, TuneCost(guard=guard), "pid", case(lab), case(lab, speed=0.25))
    steps = 0.01 * np.random.default_rng(0).standard_normal((12, len(p.space)))
    points = np.clip(published_point(p) + steps, 0.0, 1.0)
    whole = p.costs(points, None, 2)
    assert 4 <= np.isfinite(whole).sum() < 12  # the others leave the path more than before
    assert np.array_equal(whole, p.costs(points, None, 1))
    finite = np.where(np.isfinite(whole), whole, 1.0)
    limits = np.where(np.arange(12) % 2 == 0, np.inf, 0.5 * finite)
    some = p.costs(points, limits, 1)
    kept = some <= limits
    assert np.array_equal(some[kept], whole[kept])
    assert np.all(whole[~kept] > limits[~kept])


def test_the_guard_is_asked_for_what_would_win_alone(lab: Profile) -> None:
    p = problem(lab, TuneCost(guard=0.1), "pid", case(lab))
    points = np.random.default_rng(0).random((6, len(p.space)))
    points[0] = published_point(p)
    whole = p.costs(points)
    driven: list[int] = []
    runs = p._runs
    with patch.object(p, "_runs", lambda *rest: driven.append(len(rest[2])) or runs(*rest)):
        assert p.costs(points, np.full(6, whole[0]))[0] == whole[0]
        assert driven == [6, 1 + np.sum(whole[1:] <= whole[0])]
        p.costs(points, np.zeros(6))
        assert driven[2:] == [6]


def test_metres_are_the_distances_to_the_path_and_to_the_target(lab: Profile) -> None:
    p = problem(lab, TuneCost("metres", guard=0.0))
    one = case(lab)
    (run,) = run_robots([one.robot], [make_controller(lab, p.base)], [QUIET], one.waypoints, [0])
    m = compare_paths(run.motion, one.target)
    wanted = m["d_rms_m"] + TARGET_SHARE * m["sync_rms_m"]
    # the one counts every tick alike, the other every stretch of time: the last tick differs
    assert p.costs(published_point(p)[None])[0] == pytest.approx(wanted, rel=1e-4)


@pytest.mark.parametrize("measure", ["metres", "path", "time"])
def test_gains_that_leave_the_path_more_than_before_are_refused(
    lab: Profile, measure: TuneMeasure
) -> None:
    """Feedback of the lateral error takes the robot to its path; less of it, farther away."""
    one = case(lab, "improved")
    base = load_gains("pid", "published")
    space = make_tuning_space("pid", ["k_p_y"], False, {"k_p_y": (0.1, 2.0 * base.values["k_p_y"])})
    p = TuneProblem(lab, base, space, (one,), TuneCost(measure, guard=0.0))
    before = base.values["k_p_y"]
    points = space.points(np.array([[0.3 * before], [before]]))
    less, same = p.costs(points)
    assert less == np.inf
    assert math.isfinite(same)


def test_the_guard_refuses_what_more_delay_would_break(lab: Profile) -> None:
    published = load_gains("pid", "published")
    fierce = replace(published, values={**published.values, "k_p_u": 1.5, "k_i_u": 2.0})
    space = make_tuning_space("pid", None, False, {}, start=fierce.values)
    point = space.points(np.array([fierce.values[name] for name in space.names]))
    costs = []
    for guard in (0.0, 0.4):
        p = TuneProblem(lab, fierce, space, (case(lab, "improved"),), TuneCost(guard=guard))
        costs.append(p.costs(point[None])[0])
    assert np.isfinite(costs[0])
    assert costs[1] == np.inf


def test_a_delayed_robot_stands_on_the_same_ground_with_the_same_physics(lab: Profile) -> None:
    ramp = make_robot(lab, "mujoco", parse_terrain("ramp:5"))
    late = delay_robot(ramp, 0.1)
    assert late.terrain == ramp.terrain
    assert isinstance(ramp.body, MujocoPlant)
    numbers = lab.plants["mujoco"]
    pyramidal = MujocoPlant(
        numbers.parameters, numbers.drive, settings=PhysicsSettings(cone="pyramidal")
    )
    body = delay_robot(replace(ramp, body=pyramidal), 0.1).body
    assert isinstance(body, MujocoPlant)
    assert body.model.opt.cone == pyramidal.model.opt.cone != ramp.body.model.opt.cone


def test_impossible_gains_cost_infinity_and_are_not_driven(lab: Profile) -> None:
    space = make_tuning_space("lqr", ["q_x", "r_v"], False, {"r_v": (0.0, 1.0)})
    p = TuneProblem(lab, load_gains("lqr", "published"), space, (case(lab),), TuneCost(guard=0.0))
    assert p.costs(np.array([[0.5, 0.0]]))[0] == np.inf


# --------------------------------------------------------------------------------------------------
# programs


def test_bounds_hold_the_start_and_are_widened_for_it() -> None:
    """The tuned LQR lies outside Tab. 4.21's bounds: a start within costs 3.6 times as much."""
    start = load_gains("lqr", "tuned").values
    usual = make_tuning_space("lqr", None, False, {})
    wide = make_tuning_space("lqr", None, False, {}, start=start)
    outside = [p.name for p in usual.parameters if not p.lower <= start[p.name] <= p.upper]
    assert outside == ["q_yaw", "q_w", "r_v"]
    assert [
        p.name for p, q in zip(wide.parameters, usual.parameters, strict=True) if p != q
    ] == outside
    assert all(p.lower < start[p.name] < p.upper for p in wide.parameters)
    with pytest.raises(
        ValueError,
        match=r"the bounds of q_yaw, 5 to 15, leave out 3.3723, "
        "where the search begins; widen them",
    ):
        make_tuning_space("lqr", None, False, {"q_yaw": (5.0, 15.0)}, start=start)


def test_a_tuning_that_finds_nothing_better_keeps_what_it_began_with(
    lab: Profile, tmp_path: Path
) -> None:
    """One gain, in bounds that hold the start at their end and beyond it only what is worse."""
    start = load_gains("lqr", "published").values["r_v"]
    options = {
        "plant": ("linear",),
        "free": ("r_v",),
        "bounds": {"r_v": (start, 400.0)},
        "held_out": ("line@0.5",),
    }
    tuned = tune("lqr", "circle@0.5", lab, no_noise=True, population=8, generations=1, **options)
    assert dict(tuned.gains) == dict(load_gains("lqr", "published").values)
    assert tuned.cost == tuned.baseline_cost
    assert tuned.as_dict()["worse_than_start"] is False
    assert any("No candidate costs less than lqr-published" in note for note in tuned.notes())
    assert tuned.parameters[0].value == start


def test_the_shipped_gains_stand_beside_the_tuned_ones(lab: Profile) -> None:
    options = {
        "plant": ("linear",),
        "free": ("q_x",),
        "population": 5,
        "generations": 1,
        "held_out": ("square@0.5",),
    }
    tuned = tune("lqr", "circle@0.5", lab, no_noise=True, **options)
    assert tuned.shipped is not None
    assert tuned.shipped.name == "lqr-tuned"
    (trained,), (held,) = tuned.train.values(), tuned.held_out.values()
    assert tuned.shipped_cost == pytest.approx(trained["shipped"].metrics["cost"], rel=ROUNDOFF)
    document = tuned.as_dict()
    assert document["shipped_cost"] == tuned.shipped_cost
    assert (
        document["held_out"]["square at 0.5 m/s, linear"]["shipped"]["cost"]
        == held["shipped"].metrics["cost"]
    )
    own = tune("lqr", ("circle@0.5",), lab, no_noise=True, gains="tuned", **options)
    assert "shipped" not in next(iter(own.train.values())), (
        "the shipped gains are what it began with"
    )
    assert own.shipped_cost == own.baseline_cost


@pytest.mark.parametrize("plant", ["linear", "mujoco"])
def test_a_start_is_seen_from_that_of_the_reference(lab: Profile, plant: str) -> None:
    """1 m ahead of the reference's start, 0.5 m to its left, and turned left by a quarter."""
    up = Waypoints.from_path([[2.0, 3.0], [2.0, 4.0]], 0.5)
    robot = track("pid", up, plant, lab, start=(1.0, 0.5, 0.5 * math.pi), feedback="truth").robots[
        0
    ]
    assert np.allclose(robot.run.table[0, :3], (1.5, 4.0, math.pi), atol=1e-9)


def test_tune_beats_what_it_began_with_and_resumes(lab: Profile, tmp_path: Path) -> None:
    def stop(progress: Progress) -> None:
        if progress.done == 2.0:
            raise KeyboardInterrupt

    def tuned(folder: Path, **more: Any) -> Tuned:
        few = {
            "plant": ("linear",),
            "held_out": ("line@0.5",),
            "population": 8,
            "generations": 4,
            "free": ("q_x", "r_v"),
        }
        return tune("lqr", ("circle@0.5",), lab, seed=3, out=folder, **few, **more)

    whole = tuned(tmp_path / "a")
    assert whole.cost <= whole.baseline_cost
    assert whole.gains["k_alpha"] == 1.0
    path = next(path for path in whole.save(tmp_path / "a") if path.suffix == ".toml")
    again = load_gains("lqr", str(path))
    assert (again.values, again.provenance["seed"]) == (whole.gains, 3)
    assert tuned(tmp_path / "b", progress=stop).status == "interrupted"
    resumed = tuned(tmp_path / "b", resume=True)
    assert (resumed.gains, resumed.cost, resumed.course.evaluations) == (
        whole.gains,
        whole.cost,
        whole.course.evaluations,
    )
