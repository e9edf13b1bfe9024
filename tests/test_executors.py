"""Costs that an executor of other processes rates are those of one process, and its loss is one line."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor

import numpy as np
import pytest

from ssmr.errors import SsmrError
from tests.conftest import EXACT
from tests.test_objective import log_target, problem, scenario
from validation.fit import fit
from validation.identify.executors import costs_by, dask_executor
from validation.identify.objective import FitCost
from validation.plants.profile import Profile

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")  # dask's own
OPTIONS = {"population": 10, "generations": 5, "seed": 3}


@pytest.fixture(scope="module")
def processes() -> Iterator[Executor]:
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        yield pool


@pytest.mark.parametrize("model", ["coulomb", "mujoco"])
def test_costs_are_those_of_one_process(lab: Profile, processes: Executor, model: str) -> None:
    for p in (problem(lab, scenario(lab), FitCost("sync"), model), problem(lab, log_target(lab), FitCost("horizon"), model)):
        points = np.random.default_rng(0).random((5, len(p.space)))
        limits = np.array([np.inf, np.inf, 1e-6, np.inf, np.inf])
        there = costs_by(processes, 2, p.costs, points, limits)
        assert np.abs(there - p.costs(points, limits)).max() == EXACT


def test_a_fit_by_processes_is_the_same_and_their_loss_keeps_what_was_rated(tmp_path, processes: Executor) -> None:  # type: ignore[no-untyped-def]
    here, there = (fit("linear", "traj3@linear", executor=executor, **OPTIONS) for executor in (None, processes))
    assert (here.cost, here.parameters) == (there.cost, there.parameters)
    lost = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"))

    def shut(progress: object) -> None:
        lost.shutdown()

    with pytest.raises(SsmrError, match=r"^the executor that rates .*; 1 generations are kept in .*, and resume goes on"):
        fit("linear", "traj3@linear", executor=lost, progress=shut, out=tmp_path, **OPTIONS)


def test_a_fit_by_dask_is_the_same() -> None:
    distributed = pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    with distributed.LocalCluster(
        2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, silence_logs=50
    ) as team:
        here, there = (fit("linear", "traj3@linear", scheduler=s, **OPTIONS) for s in (None, team.scheduler_address))
    assert (here.cost, here.parameters) == (there.cost, there.parameters)


@pytest.mark.parametrize("address", ["nonsense", "", "tcp://", "tcp://127.0.0.1:1", "tcp://127.0.0.1:99999999"])
def test_an_address_where_nobody_answers_is_refused(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    monkeypatch.setattr("validation.identify.executors.CONNECT_TIMEOUT", 0.5)
    with pytest.raises(ValueError, match="no dask scheduler answers"), dask_executor(address):
        pass
