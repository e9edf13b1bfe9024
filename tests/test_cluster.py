"""Workers of a dask scheduler: equal to the bit, others named, and a line for all that breaks."""

from __future__ import annotations

import re
import sys
import threading
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from ssmr import _jit
from ssmr.errors import SsmrError
from ssmr.models.law import OWN_MODELS
from tests import test_objective
from tests.conftest import EXACT
from tests.test_objective import scenario
from tests.test_user_law import MODEL
from validation import workers
from validation.fit import Fit, fit
from validation.identify.objective import FitCost
from validation.identify.problem import FitProblem
from validation.output import Progress
from validation.plants.profile import Profile
from validation.plants.table import plant_kind
from validation.sweep import sweep
from validation.tune import tune

distributed = pytest.importorskip("distributed")
cfexecutor = import_module("distributed.cfexecutor")
wire = import_module("distributed.protocol.pickle")
"""The functions by which dask sends a problem."""


@pytest.fixture
def cluster() -> Iterator[Any]:
    """A scheduler with two workers of a thread each, which are spoken to by its address alone."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, protocol="tcp", dashboard_address=None
    ) as running:
        yield running
        for client in workers._clients.values():
            client.close()
        workers._clients.clear()


SHORT: dict[str, Any] = {"profile": "thesis-lab", "population": 8, "generations": 1}


@pytest.mark.parametrize("model", ["improved", "mujoco"])
def test_costs_and_errors_are_equal_to_the_bit(cluster: Any, lab: Profile, model: str) -> None:
    p = test_objective.problem(lab, scenario(lab), FitCost("sync"), model)
    x = test_objective.points(len(p.space), 5)
    for rate in (p.costs, p.residuals):
        here, there = (rate(x, workers=w) for w in (2, cluster.scheduler_address))
        assert np.array_equal(here, there, equal_nan=True)


def test_a_fit_and_a_tuning_are_equal_to_the_bit(cluster: Any) -> None:
    """With standard errors, and with what the guard leaves over."""
    ways = (2, cluster.scheduler_address)
    fits = [fit("linear", "traj2@mujoco", search="jde", workers=w, **SHORT) for w in ways]
    assert fits[0].cost == fits[1].cost
    assert fits[0].parameters == fits[1].parameters
    tuned = [tune("pid", "line", held_out=("line",), workers=w, **SHORT) for w in ways]
    assert tuned[0].gains == tuned[1].gains
    assert tuned[0].cost == tuned[1].cost


def test_a_sweep_and_a_study_are_equal(cluster: Any) -> None:
    address = cluster.scheduler_address
    offset = 3

    def odd(k: int) -> dict[str, int]:
        if k % 2:
            raise SsmrError("an odd number")
        return {"odd": k + offset}  # a closure travels too

    here, there = (sweep({"a": 1, "b": 2}, {"m": odd}, workers=w) for w in (1, address))
    assert here.rows == there.rows == [{"variant": "a"}, {"variant": "b", "odd": 5}]
    assert here.notes == there.notes == ["a: m failed: an odd number."]
    if find_spec("validation.study") is None:
        pytest.skip("the appendix of studies was deleted")
    transfer = import_module("validation.study.transfer")
    few: dict[str, Any] = {
        "plants": ("kinematic",),
        "controllers": ("pid:tuned", "lqr:tuned"),
        "references": ("line@0.8",),
    }
    studies = [
        transfer.study_transfer(workers=w, **few).as_dict()["profiles"] for w in (1, address)
    ]
    assert studies[0] == studies[1]


def test_a_model_of_the_users_own_travels_by_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_jit, "_saves", _jit._saves)
    file = tmp_path / "mine.py"
    file.write_text(MODEL, encoding="utf-8")
    problems: list[FitProblem] = []
    with patch.dict(OWN_MODELS), patch.object(FitProblem, "costs", autospec=True) as costs:
        costs.side_effect = lambda self, *rest: problems.append(self) or np.ones(8)
        fit("slip", "traj2@kinematic", own_model=f"{file}:LAW", free=("slip",), **SHORT)
    points = np.linspace(0.0, 1.0, 3)[:, None]
    with patch.dict(OWN_MODELS):
        here = problems[0].costs(points)
        sent = wire.dumps(problems[0])
    file.unlink()
    with patch.dict(OWN_MODELS), patch.dict(sys.modules):
        OWN_MODELS.pop("slip", None)
        del sys.modules["user_mine"]
        plant_kind.cache_clear()
        there = wire.loads(sent).costs(points)
    plant_kind.cache_clear()
    assert np.abs(here - there).max() == EXACT


def test_other_versions_and_processors_are_named_once(
    cluster: Any, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A mixed cluster works; so does a worker that comes later."""
    ours = workers._versions_here()

    def versions_here() -> dict[str, str]:
        if threading.current_thread() is threading.main_thread():
            return {**ours, "processor": "abacus"}
        return dict(ours)

    monkeypatch.setattr(workers, "_versions_here", versions_here)
    calls = [(k,) for k in range(3)]
    for count in (2, 2, 3):
        cluster.scale(count)
        cluster.wait_for_workers(count)
        results = dict(workers.complete_calls(cluster.scheduler_address, abs, calls))
        assert results == {0: 0, 1: 1, 2: 2}
        named = re.findall(r"the worker (\S+) has processor .*, not abacus:", caplog.text)
        assert len(named) == len(set(named)) == count


@pytest.mark.parametrize(
    "address", ["foo", "tcp://10.0.0.1:8786", "tcp://localhost", "http://127.0.0.1:80", "tls://:1"]
)
def test_an_address_that_is_none_or_open_to_others_is_refused(address: str) -> None:
    with pytest.raises(ValueError, match=r"workers is '.*wanted a number of threads"):
        Fit("linear", "traj4", workers=address)
    assert Fit("linear", "traj4", workers="3").workers == 3
    Fit("linear", "traj4", workers="tls://far.example:8786")
    Fit("linear", "traj4", workers="tcp://[::1]:8786")


def test_a_scheduler_that_is_not_there_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "_PATIENCE_S", 0.2)
    with pytest.raises(ValueError, match="no dask scheduler with workers answers at tcp"):
        fit("linear", "traj2@mujoco", workers="tcp://127.0.0.1:9", **SHORT)


def test_a_result_that_went_away_with_its_worker_is_computed_again(
    cluster: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask then unpacks the result as if it were an error (a ValueError, as ours are)."""
    cascade = cfexecutor._cascade_future
    left = ["once"]

    def lose_the_first(future: Any, told: Any) -> Any:
        if left:
            left.clear()
            told.set_exception(ValueError("not enough values to unpack (expected 3, got 2)"))
            return None
        return cascade(future, told)

    monkeypatch.setattr(cfexecutor, "_cascade_future", lose_the_first)
    calls = [(k, 2) for k in range(4)]
    found = dict(workers.complete_calls(cluster.scheduler_address, pow, calls))
    assert found == {k: k**2 for k in range(4)}
    assert not left

    def refuse(k: int) -> None:
        raise ValueError(f"no {k}")

    with pytest.raises(ValueError, match="no 0"):
        list(workers.complete_calls(cluster.scheduler_address, refuse, [(0,)]))


@pytest.mark.parametrize("breaks", ["interrupt", "worker", "scheduler"])
def test_what_breaks_off_leaves_the_checkpoint(
    breaks: str, cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One worker of two that goes away is replaced by the other; the last one ends the search."""
    monkeypatch.setattr(workers, "_PATIENCE_S", 3.0)
    small: dict[str, Any] = {**SHORT, "generations": 3, "search": "jde", "out": tmp_path}
    address = cluster.scheduler_address

    def break_off(now: Progress) -> None:
        if now.done == 2.5:
            if breaks == "interrupt":
                raise KeyboardInterrupt
            if breaks == "scheduler":
                cluster.close()
            else:
                cluster.scale(len(cluster.workers) - 1)

    def search(**more: Any) -> Any:
        return fit("linear", "traj2@mujoco", workers=address, **small, **more)

    if breaks == "interrupt":
        assert search(progress=break_off).status == "interrupted"
    else:
        if breaks == "worker":
            assert search(progress=break_off).status == "finished"
        with pytest.raises(SsmrError, match=f"{address} or its workers are gone .* --resume"):
            search(progress=break_off, overwrite=True)
    resumed = fit("linear", "traj2@mujoco", resume=True, **small)
    assert resumed.cost == fit("linear", "traj2@mujoco", **{**small, "out": None}).cost
