"""jDE finds the friction of a MuJoCo robot from motion and torques; the path hardly tells it."""

from __future__ import annotations

import numpy as np
import pytest

from tests.conftest import ROUNDOFF
from tests.recovery import HYBRID, JDE, LEAST_SQUARES, TORQUE, drawn, noisy_target, recover
from validation.identify.objective import FitCost, FitTarget, make_raters, make_torque_raters
from validation.plants.kind import CAUSES, TORQUES
from validation.plants.table import plant_kind

CLOSE = 0.03
"""Greatest error of a friction that counts as found [1]."""
DRAWS = 20


def test_torques_tell_friction_and_the_path_hardly_does() -> None:
    """One robot, from the profile's numbers: 0.57 for a profile that says 0.5."""
    both = recover(3, LEAST_SQUARES)
    path = recover(3, LEAST_SQUARES, torque_weight=0.0)
    assert abs(both.off["friction"]) < CLOSE
    assert abs(both.off["friction"]) < 3.0 * both.errors["friction"]
    assert path.errors["friction"] > 5.0 * both.errors["friction"]
    told = "The path hardly tells friction"
    assert any(note.startswith(told) for note in path.notes)
    assert not any(note.startswith(told) for note in both.notes)


@pytest.mark.slow
def test_jde_finds_the_friction_of_nineteen_robots_of_twenty() -> None:
    """From default bounds, with noise on poses and torques; the hybrid search does it in less time."""
    every = [(recover(seed, JDE), recover(seed, HYBRID)) for seed in range(DRAWS)]
    for found in zip(*every, strict=True):
        close = [abs(one.off["friction"]) <= CLOSE for one in found]
        sure = [abs(one.off["friction"]) <= 3.0 * one.errors["friction"] for one in found]
        assert np.count_nonzero(np.logical_and(close, sure)) >= DRAWS - 1
    jde, hybrid = (sum(one.seconds for one in found) for found in zip(*every, strict=True))
    assert hybrid < jde


def test_a_fit_of_a_body_frees_causes_only() -> None:
    for name in ("mujoco", "four_wheel"):
        assert plant_kind(name).free["scenario"] == CAUSES
    assert "tracked_x" not in CAUSES


@pytest.fixture(scope="module")
def target() -> FitTarget:
    return noisy_target(drawn(0), 0)


def test_the_error_of_torques_is_what_it_says(target: FitTarget) -> None:
    """A constant error of e is an RMS of e, and costs what as many centimetres do."""
    (truth,) = target.truth
    assert target.torques is not None
    (known,) = target.torques
    (rater,) = make_torque_raters(FitCost("sync"), [target])
    assert rater is not None
    off = known + np.array([3.0, -3.0])
    assert rater.cost(off[None])[0] == pytest.approx(0.03, rel=ROUNDOFF)
    assert (rater.residuals(off[None]) ** 2).sum() == pytest.approx(0.03**2, rel=ROUNDOFF)
    noise = target.torque_errors([truth])
    assert np.sqrt(np.mean(noise**2)) == pytest.approx(TORQUE, rel=0.05)  # 2 500 samples


def test_torques_that_nobody_knows_do_not_count(target: FitTarget) -> None:
    """What lies where the truth is not known changes no cost, and shares no block with what is known."""
    (known,) = target.torques or ()
    half = len(known) // 2
    partly = known.copy()
    partly[half:, 0] = np.nan
    partly[:, 1] = np.nan
    some = FitTarget("some", target.source, target.truth, torques=(partly,))
    (rater,) = make_torque_raters(FitCost("horizon"), [some])
    assert rater is not None
    off = known + 2.0
    wild = off.copy()
    wild[half:, 0] = 1e3
    wild[:, 1] = -1e3
    assert rater.cost(off[None])[0] == rater.cost(wild[None])[0] == pytest.approx(0.02)
    assert rater.residuals(wild[None]).shape == (1, len(rater.blocks))
    nobody = FitTarget("none", target.source, target.truth, torques=(np.full_like(known, np.nan),))
    assert make_torque_raters(FitCost("sync"), [nobody, target])[0] is None
    assert make_torque_raters(FitCost("sync", torque_weight=0.0), [target]) == [None]


def test_planar_torques_are_not_believed(target: FitTarget) -> None:
    """A planar model's torques are numbers of its fit: its kind says so, and it is fitted by its path."""
    assert not plant_kind("improved").torques
    assert TORQUES in target.truth[0].channels
    (rater,) = make_raters(FitCost("sync"), [target])
    (torques,) = make_torque_raters(FitCost("sync"), [target])
    assert torques is not None
    assert set(torques.blocks) <= set(rater.blocks)
