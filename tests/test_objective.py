"""Costs: their parts; neither early abandonment nor workers change them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

import validation.identify.problem
from ssmr.metrics.declared import compare_paths
from ssmr.metrics.windows import overlapping_windows
from ssmr.robot.localiser import Localiser
from ssmr.types import State
from tests.conftest import EXACT, ROUNDOFF
from tests.robots import HUSKY
from validation.experiment.runs import drive_piece
from validation.experiment.sources import Source, open_source
from validation.files.log import Log
from validation.identify.objective import FitCost, make_raters
from validation.identify.problem import FitProblem
from validation.plants.kind import side_torques
from validation.plants.profile import PLANTS, Profile, make_plant
from validation.plants.searchable import find_number, make_space, searchable_numbers, with_values
from validation.plants.table import plant_kind
from validation.simulator.plant import MujocoPlant


def recorded(lab: Profile, plant: str = "improved", seconds: float = 60.0) -> Log:
    """A drive of a planar plant as a log at 20 Hz with one gap in it."""
    rng = np.random.default_rng(2)
    t = 0.05 * np.arange(round(seconds / 0.05))
    v = np.repeat(rng.uniform(-0.3, 0.5, len(t) // 100 + 1), 100)[: len(t)]
    w = np.repeat(rng.uniform(-0.8, 0.8, len(t) // 100 + 1), 100)[: len(t)]
    from ssmr.types import Commands

    motion = make_plant(lab, plant).run(Commands(0.05, np.column_stack([v, w])), State(), 0.05)
    columns = {
        "t": t,
        "cmd_v": v,
        "cmd_w": w,
        "enc_left": motion.wheels[:-1, 0],
        "enc_right": motion.wheels[:-1, 1],
        "x": motion.pose[:-1, 0],
        "y": motion.pose[:-1, 1],
        "yaw": motion.pose[:-1, 2],
    }
    keep = np.abs(t - 0.4 * seconds) > 0.2
    return Log.of_columns("log.csv", {k: c[keep] for k, c in columns.items()})


def scenario(lab: Profile, name: str = "traj4@improved") -> Source:
    source = open_source(name)
    plant = make_plant(lab, source.reference)
    pieces = []
    for piece in source.pieces:
        motion = drive_piece(plant, piece, Localiser(), source.sample_dt)
        pieces.append(replace(piece, reference=motion))
    return replace(source, pieces=tuple(pieces))


def log_target(lab: Profile, kind: str = "twist") -> Source:
    return open_source(recorded(lab), kind)  # type: ignore[arg-type]


FREE = {
    "improved": ("u_x", "mu_s", "mu_d", "gain"),
    "coulomb": ("u_x", "mu_c", "gain"),
    "mujoco": ("command_half_track", "tracked_x"),
}


def problem(lab: Profile, target: Source, cost: FitCost, model: str = "improved") -> FitProblem:
    return FitProblem(
        model, lab.plants[model], make_space(model, FREE[model], {}, HUSKY), [target], cost
    )


def points(n: int, size: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((size, n))


def test_the_true_parameters_cost_nothing(lab: Profile) -> None:
    for cost in (FitCost("path"), FitCost("sync")):
        p = problem(lab, scenario(lab), cost)
        truth = p.space.points(
            [find_number("improved", n, HUSKY).read(p.base) for n in p.space.names]
        )
        assert p.costs(truth[None])[0] < 1e-9
    p = problem(lab, log_target(lab), FitCost("horizon", horizons=(2.0,)))
    truth = p.space.points([find_number("improved", n, HUSKY).read(p.base) for n in p.space.names])
    # the start's twist is estimated, and inputs are held between samples
    assert p.costs(truth[None])[0] < 0.003


@pytest.mark.parametrize("objective", ["path", "sync"])
def test_the_cost_is_made_of_what_comparisons_print(lab: Profile, objective: Any) -> None:
    """The cost of paths is Eq. 3.1, 20 d_rms + 8 d_haus + 5 |1 - d_ratio|."""
    target = scenario(lab)
    p = problem(lab, target, FitCost(objective, yaw_weight=0.5), "coulomb")
    x = points(3, 2)
    for point, cost in zip(x, p.costs(x), strict=True):
        candidate = p.candidate(point)
        assert candidate is not None
        plant = make_plant(Profile("", "", {"coulomb": candidate}, {}), "coulomb")
        motion = drive_piece(plant, target.pieces[0], candidate.localiser, target.sample_dt)
        m = compare_paths(motion, target.truth[0])
        wanted = {
            "path": 20 * m["d_rms_m"] + 8 * m["d_haus_m"] + 5 * abs(1 - m["d_ratio"]),
            "sync": m["sync_rms_m"] + 0.5 * m["yaw_rms_rad"],
        }
        assert cost == pytest.approx(wanted[objective], rel=1e-9)


def test_horizon_cost_is_a_mean_over_windows_that_span_no_gap(lab: Profile) -> None:
    target = log_target(lab)
    for piece in target.pieces:
        assert piece.t is not None
        starts, ends = overlapping_windows(piece.t, 2.0, piece.fresh)
        assert np.all(piece.t[ends] - piece.t[starts] >= 2.0 - 1e-9)
        assert np.all(piece.t[ends] - piece.t[starts] < 2.2)
        assert len(starts) > 0
    raters = make_raters(FitCost("horizon", yaw_weight=0.0, horizons=(2.0,)), [target])
    shift = 0.1  # every window of a robot that stands still is off by what the recorded one moved
    still = [np.repeat(truth.pose[:1], len(truth), axis=0)[None] for truth in target.truth]
    moved = []
    for piece, truth in zip(target.pieces, target.truth, strict=True):
        assert piece.t is not None
        a, b = overlapping_windows(piece.t, 2.0, piece.fresh)
        moved.append(np.hypot(*(truth.pose[b, :2] - truth.pose[a, :2]).T))
    got = sum(float(r.cost(s)[0]) for r, s in zip(raters, still, strict=True))
    assert got == pytest.approx(np.concatenate(moved).mean(), rel=ROUNDOFF)
    turned = [truth.pose[None] + np.array([shift, 0.0, 0.0]) for truth in target.truth]
    assert sum(float(r.cost(s)[0]) for r, s in zip(raters, turned, strict=True)) == pytest.approx(
        0.0, abs=1e-12
    )


@pytest.mark.parametrize("kind", ["twist", "wheels"])
def test_abandoning_changes_nothing(lab: Profile, kind: str) -> None:
    """A cost within its limit is exact; one beyond is a lower bound that exceeds the limit."""
    target = log_target(lab, kind)
    p = FitProblem(
        "linear",
        lab.plants["linear"],
        make_space("linear", plant_kind("linear").free["commands"], {}, HUSKY),
        [target],
        FitCost("horizon"),
    )
    x = points(len(p.space), 24)
    whole = p.costs(x)
    limits = np.where(np.arange(len(x)) % 2, np.inf, 0.3 * np.nan_to_num(whole, posinf=1.0))
    some = p.costs(x, limits)
    within = whole <= limits
    assert within.any()
    assert np.array_equal(some[within], whole[within])
    assert np.all(some[~within] > limits[~within])
    assert np.all(some[~within] <= whole[~within])
    assert np.any(some[~within] < whole[~within])  # it did save work


@pytest.mark.parametrize("model", ["improved", "mujoco"])
def test_workers_do_not_matter(lab: Profile, model: str) -> None:
    target = scenario(lab)
    p = problem(lab, target, FitCost("sync"), model)
    x = points(len(p.space), 3)
    assert (
        np.abs(
            np.subtract(*(np.nan_to_num(p.costs(x, workers=w), posinf=-1.0) for w in (1, 2)))
        ).max()
        == EXACT
    )


def test_more_candidates_than_are_kept_at_once_are_rated_as_few_are(lab: Profile) -> None:
    p = problem(lab, scenario(lab), FitCost("sync"))
    x = points(len(p.space), 7)
    costs = p.costs(x)
    errors = p.residuals(x)
    with patch.object(validation.identify.problem, "_CHUNK", 3):
        assert np.array_equal(p.costs(x), costs)
        assert np.array_equal(p.residuals(x), errors, equal_nan=True)


def test_a_cost_does_not_depend_on_the_company(lab: Profile) -> None:
    """Bit for bit the same alone and among many: shares of a generation may be rated anywhere."""
    for target, cost in (
        (scenario(lab), FitCost("path")),
        (scenario(lab), FitCost("sync")),
        (log_target(lab), FitCost("horizon")),
    ):
        p = problem(lab, target, cost, "coulomb")
        x = points(3, 7)
        assert np.array_equal(p.costs(x), np.concatenate([p.costs(one[None]) for one in x]))


SOLVER_LEAVES_M = 3e-6
"""Conjugate gradients leave this error of a path [m]. It shows because populations drive bodies
from the origin, and turn their motions to where they begin."""
SOLVER_LEAVES_N_M = 0.005
"""They leave this root mean square of a torque, of which up to 60 N m is at work [N m]. Single
samples, where a wheel's slip changes its direction, hang on the last digit."""


def test_a_population_drives_as_a_comparison_does(lab: Profile) -> None:
    """Candidates of every plant, by commands and by wheel rates, end where the plant alone ends."""
    for kind in ("twist", "wheels"):
        target = log_target(lab, kind)
        piece = target.pieces[0]
        for name, plant in lab.plants.items():
            other = replace(plant, localiser=Localiser(0.12, -0.03, 0.05, -0.09, 0.02))
            many = (
                plant_kind(name)
                .population([plant, None, other], 2)
                .motions([0, 1, 2], piece, target.sample_dt)
            )
            assert np.isnan(many[1]).all()
            for row, profile in ((0, plant), (2, other)):
                made = make_plant(Profile("", "", {name: profile}, {}), name)
                alone = drive_piece(made, piece, profile.localiser, target.sample_dt)
                most = SOLVER_LEAVES_M if plant_kind(name).torques else 1e-12
                assert np.abs(many[row][:, :3] - alone.pose).max() < most
                assert many.shape[2] == (5 if plant_kind(name).torques else 3)
                if plant_kind(name).torques:
                    torques = side_torques(alone)
                    assert torques is not None
                    off = many[row][:, 3:] - torques
                    assert np.array_equal(np.isnan(many[row][:, 3:]), np.isnan(torques))
                    assert np.sqrt(np.nanmean(off**2)) < SOLVER_LEAVES_N_M


def test_a_body_is_driven_once_however_it_is_seen(lab: Profile, monkeypatch: Any) -> None:
    """Mount, place and lateness of a localiser move nothing, but the place sets the first twist."""
    driven = []
    real = MujocoPlant.run

    def count(self: MujocoPlant, *drive: Any) -> Any:
        driven.append(self)
        return real(self, *drive)

    monkeypatch.setattr(MujocoPlant, "run", count)
    target = log_target(lab, "wheels")
    section = lab.plants["mujoco"]
    # a body that no other test drives
    section = replace(section, parameters=replace(section.parameters, com_x=0.0123))
    ways = [Localiser(0.1, yaw_late=late, position_late=0.5 * late) for late in (0.0, 0.1, 0.2)]
    candidates = [replace(section, localiser=way) for way in ways]
    population = plant_kind("mujoco").population(candidates, 1)
    pieces = target.pieces
    together = [population.motions([0, 1, 2], piece, target.sample_dt) for piece in pieces]
    assert len(driven) == len(pieces)
    other = replace(section, localiser=Localiser(0.2))
    plant_kind("mujoco").population([other], 1).motions([0], pieces[0], target.sample_dt)
    start = pieces[0].start
    same = Localiser(0.1).body_twist([start.v_x, start.v_y, start.yaw_rate])
    is_same = np.array_equal(
        same, Localiser(0.2).body_twist([start.v_x, start.v_y, start.yaw_rate])
    )
    assert len(driven) == len(pieces) + (not is_same)
    # the motions of one alone are theirs to the bit
    for k, candidate in enumerate(candidates):
        alone = plant_kind("mujoco").population([candidate], 1)
        for piece, motions in zip(pieces, together, strict=True):
            own = alone.motions([0], piece, target.sample_dt)
            assert np.array_equal(own[0], motions[k], equal_nan=True)


def test_a_search_solves_less_exactly_and_its_results_do_not(lab: Profile) -> None:
    """Results of a fit to a log come from the profile's own step and solver."""
    target = log_target(lab, "wheels")
    exact = problem(lab, target, FitCost("horizon"), "mujoco")
    rough = exact.coarser()
    assert rough is not None
    point = exact.space.points(
        [find_number("mujoco", n, HUSKY).read(exact.base) for n in exact.space.names]
    )
    again = problem(lab, target, FitCost("horizon"), "mujoco")
    assert rough.costs(point[None])[0] != exact.costs(point[None])[0]
    assert again.costs(point[None])[0] == exact.costs(point[None])[0]
    seen = plant_kind("mujoco").population([exact.candidate(point)], 1)
    piece = target.pieces[0]
    motion = seen.motions([0], piece, target.sample_dt)
    made = make_plant(Profile("", "", {"mujoco": exact.base}, {}), "mujoco")
    alone = drive_piece(made, piece, exact.base.localiser, target.sample_dt)
    assert np.abs(motion[0][:, :3] - alone.pose).max() < SOLVER_LEAVES_M


def test_every_searchable_number_can_be_read_and_set(lab: Profile) -> None:
    for model in PLANTS:
        for number in searchable_numbers(model, HUSKY):
            value = 0.5 * (number.lower + number.upper)
            names = [number.name]
            values = [value]
            if number.name == "mu_d":
                names = ["mu_s", "mu_d"]
                values = [2.0 * value, value]
            assert number.read(with_values(model, lab.plants[model], names, values)) == value
        for occasion in ("scenario", "commands", "wheels"):
            names = plant_kind(model).free[occasion]
            assert len(make_space(model, names, {}, HUSKY)) == len(names)


def test_impossible_candidates_are_never_driven(lab: Profile) -> None:
    p = FitProblem(
        "improved",
        lab.plants["improved"],
        make_space("improved", ("mu_s", "mu_d"), {}, HUSKY),
        [scenario(lab)],
        FitCost(),
    )
    assert p.candidate(np.array([0.1, 0.9])) is None
    assert p.costs(np.array([[0.1, 0.9], [0.9, 0.1]])).tolist()[0] == np.inf
