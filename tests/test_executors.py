"""A fit whose candidates an executor of other processes rates is that of one process, and its loss is one line."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ssmr.errors import SsmrError
from tests.conftest import EXACT
from tests.test_objective import log_target, problem, scenario
from validation.fit import fit
from validation.identify.objective import FitCost
from validation.identify.search import dask_executor
from validation.plants.profile import Profile

OPTIONS: dict[str, Any] = {"population": 10, "generations": 5, "seed": 3, "workers": 2}


def pool() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(2, multiprocessing.get_context("spawn"))


def test_a_fit_by_processes_is_the_same_and_their_loss_is_one_line(tmp_path: Path, lab: Profile) -> None:
    points, limits = np.random.default_rng(0).random((2, 5, 2)), np.array([np.inf, np.inf, 1e-6, np.inf, np.inf])
    with pool() as processes:
        here, there = (fit("linear", "traj3@linear", executor=executor, **OPTIONS) for executor in (None, processes))
        for p, x in zip(
            (problem(lab, scenario(lab), FitCost("sync"), "mujoco"), problem(lab, log_target(lab), FitCost(), "mujoco")),
            points,
            strict=True,
        ):
            assert np.abs(processes.submit(p.costs, x, limits).result() - p.costs(x, limits)).max() == EXACT
    assert (here.cost, here.parameters) == (there.cost, there.parameters)
    lost = pool()

    def shut(progress: object) -> None:
        lost.shutdown()

    with pytest.raises(SsmrError, match=r"^the executor that rates candidates failed: RuntimeError: [^\n]*$"):
        fit("linear", "traj3@linear", executor=lost, progress=shut, out=tmp_path, **OPTIONS)
    assert fit("linear", "traj3@linear", resume=True, out=tmp_path, **OPTIONS).cost == here.cost


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")  # dask's own
def test_a_fit_by_dask_is_the_same() -> None:
    distributed = pytest.importorskip("distributed", reason="dask is not installed")
    with (
        distributed.LocalCluster(
            2, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0", silence_logs=50
        ) as team,
    ):
        here, there = (fit("linear", "traj3@linear", scheduler=s, **OPTIONS) for s in (None, team.scheduler_address))
    assert (here.cost, here.parameters) == (there.cost, there.parameters)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nowhere"])
def test_a_scheduler_that_is_not_there_is_one_line(address: str) -> None:
    pytest.importorskip("distributed", reason="dask is not installed")
    with pytest.raises(ValueError, match="no dask scheduler answers"), dask_executor(address):
        pass
