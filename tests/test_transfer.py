"""Transfer: a plant agrees with itself, losers come last, references suit the robot."""

from __future__ import annotations

import math
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ssmr.types import FloatArray
from tests.conftest import ROUNDOFF
from tests.test_gains import hopeless
from validation.experiment.gains import dump_gains
from validation.experiment.loops import make_robot
from validation.plants.profile import Profile, load_profile
from validation.report.report import Report
from validation.study import transfer
from validation.study.transfer import (
    TransferStudy,
    chosen_column,
    cost_agreement,
    mean_costs,
    missions_of,
    rank_correlation,
    rank_places,
    regret_of_choice,
    study_transfer,
)


def costs_of_some(draw: st.DrawFn, rows: int, columns: int) -> FloatArray:
    numbers = arrays(
        np.float64,
        (rows, columns),
        elements=st.one_of(st.integers(1, 6).map(float), st.just(math.inf)),
    )
    return np.asarray(draw(numbers))


@st.composite
def two_tables(draw: st.DrawFn) -> tuple[FloatArray, FloatArray]:
    """Costs on two plants, with equal ones and with losses."""
    rows = draw(st.integers(1, 4))
    columns = draw(st.integers(2, 6))
    return costs_of_some(draw, rows, columns), costs_of_some(draw, rows, columns)


@given(two_tables())
def test_a_plant_agrees_with_itself(tables: tuple[FloatArray, FloatArray]) -> None:
    costs, _ = tables
    with patch.object(transfer, "_DRAWS", 1):  # intervals are not asked for
        same = cost_agreement(costs, costs)
    assert (same["regret"], same["same_winner"]) == (0.0, len(costs))
    tau = rank_correlation(costs, costs)
    assert tau == pytest.approx(1.0, abs=ROUNDOFF) or (
        math.isnan(tau) and len(set(rank_places(costs).tolist())) == 1
    )


@given(two_tables(), st.data())
def test_the_order_of_controllers_is_of_no_account(
    tables: tuple[FloatArray, FloatArray], data: st.DataObject
) -> None:
    costs, truth = tables
    order = data.draw(st.permutations(range(costs.shape[1])))
    mixed = costs[:, order]
    true = truth[:, order]
    assert (rank_places(mixed) == rank_places(costs)[list(order)]).all()
    assert rank_correlation(mixed, true) == pytest.approx(
        rank_correlation(costs, truth), abs=ROUNDOFF, nan_ok=True
    )
    assert regret_of_choice(mixed, true) == regret_of_choice(costs, truth)


@given(two_tables())
def test_who_loses_more_is_placed_behind(tables: tuple[FloatArray, FloatArray]) -> None:
    costs, truth = tables
    lost = np.isinf(costs).sum(axis=0)
    place = rank_places(costs)
    for a in range(costs.shape[1]):
        for b in range(costs.shape[1]):
            assert lost[a] <= lost[b] or place[a] > place[b]
    chosen = chosen_column(costs, truth)
    assert lost[chosen] == lost.min()
    assert 0.0 <= regret_of_choice(costs, truth) or np.isinf(truth).any(), (
        "of those that keep all, none is better than the best"
    )


def test_rank_correlation_and_regret_of_a_hand_made_table() -> None:
    truth = np.array([[1.0, 2.0, 4.0], [3.0, 4.0, 6.0]])
    model = np.array([[2.0, 1.0, 9.0]] * 2)
    measured = cost_agreement(model, truth)
    assert measured["tau"] == pytest.approx(1.0 / 3.0, rel=ROUNDOFF), (
        "one pair of three is turned round"
    )
    assert (measured["chosen"], measured["same_winner"]) == (1, 0)
    assert measured["regret"] == pytest.approx(3.0 / 2.0 - 1.0, rel=ROUNDOFF)
    assert rank_correlation(-model, truth) == pytest.approx(-1.0 / 3.0, rel=ROUNDOFF)
    lost = np.array([[1.0, math.inf, 4.0], [3.0, 1.0, 6.0]])
    assert rank_places(lost).tolist() == [0, 2, 1]
    assert mean_costs(lost).tolist() == [2.0, 1.0, 5.0]
    assert regret_of_choice(model, lost) == math.inf
    assert math.isnan(rank_correlation(np.ones((1, 3)), truth[:1])), "who cannot tell has no ranks"
    assert regret_of_choice(np.ones((1, 3)), truth[:1]) == 3.0, "who cannot tell may take the worst"


@pytest.fixture(scope="module")
def small(lab: Profile, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Options: own gains and an uncompiled law beside shipped ones, on short references."""
    path = tmp_path_factory.mktemp("transfer") / "hopeless.toml"
    path.write_text(dump_gains(hopeless()), encoding="utf-8")
    return {
        "profile": lab, "plants": ("kinematic",), "controllers": ("pid", "mpc", f"pid:{path}"),
        "references": ("u-turn@0.4", "line@0.75"),
    }  # fmt: skip


@pytest.fixture(scope="module")
def study(small: dict[str, Any]) -> Report:
    return study_transfer(**small, workers=2)


def found_in(study: Report) -> dict[str, Any]:
    plants: dict[str, Any] = study.as_dict()["profiles"]["thesis-lab"]["plants"]
    return plants


def test_a_lost_run_is_counted_and_comes_last(study: Report) -> None:
    assert study.tables()[1].rows[-1]["controller"] == "pid hopeless"
    for own in found_in(study).values():
        assert {name for name, each in own["contenders"].items() if each["lost"]} == {
            "pid hopeless"
        }


def test_the_judge_agrees_with_itself(study: Report) -> None:
    own = found_in(study)["mujoco"]
    best = study.tables()[1].rows[0]["controller"]
    assert (own["all"]["regret"], own["all"]["same_winner"], own["all"]["chosen"]) == (0.0, 2, best)
    assert own["all"]["tau"] == pytest.approx(1.0, abs=ROUNDOFF)
    assert {each["gap"] for each in own["contenders"].values()} <= {0.0, None}


def test_references_are_as_fast_as_the_robot_can_drive() -> None:
    """The Husky on tile turns at 0.9 rad/s at most: a U-turn at 0.5 m/s is too fast for it."""
    robot = make_robot(load_profile("husky-tile"), "improved")
    o = TransferStudy(references=("u-turn", "line@0.5", "line"))
    missions = list(missions_of(o, robot).values())
    assert [name for name, _ in missions] == ["u-turn", "u-turn", "line", "line"], (
        "line@0.5 stands there twice"
    )
    assert [w.speed for _, w in missions[2:]] == pytest.approx([0.5, 0.25], rel=ROUNDOFF)
    slow, fast = (w for _, w in missions[:2])
    assert slow.speed == pytest.approx(0.25, rel=ROUNDOFF)
    assert 0.4 < fast.speed < 0.48
    # only the turn is slowed
    assert fast.segment_speeds.max() == pytest.approx(0.5, rel=1e-3)
    assert fast.segment_speeds[len(fast) // 2] < 0.4
