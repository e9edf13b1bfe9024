"""A population over a cluster: two real worker processes, the same fit."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import EXACT
from tests.test_fit import call, document
from tests.test_objective import log_target, problem, scenario
from validation.fit.cluster import Cluster, ClusterError
from validation.fit.objective import FitCost
from validation.plants.profile import Profile

distributed = pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")


@pytest.fixture(scope="module")
def address():  # type: ignore[no-untyped-def]
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None, silence_logs=50
    ) as cluster:
        yield cluster.scheduler_address


@pytest.mark.parametrize("model", ["coulomb", "mujoco"])
def test_costs_are_those_of_one_process(lab: Profile, address: str, model: str) -> None:
    p = problem(lab, scenario(lab), FitCost("sync"), model)
    x = np.random.default_rng(0).random((5, len(p.space)))
    limits = np.array([np.inf, np.inf, 1e-6, np.inf, np.inf])
    shares: list[float] = []
    with Cluster(address, p) as cluster:
        there = cluster(x, limits, shares.append)
    assert np.abs(there - p.costs(x, limits)).max() == EXACT
    assert all(0.0 <= share <= 1.0 for share in shares)


def test_a_recording_travels_too(lab: Profile, address: str) -> None:
    p = problem(lab, log_target(lab), FitCost("horizon", horizons=(2.0,)), "coulomb")
    x = np.random.default_rng(1).random((3, len(p.space)))
    with Cluster(address, p) as cluster:
        there = cluster(x, np.full(3, np.inf))
    assert np.array_equal(there, p.costs(x))


def test_a_fit_is_the_same(address: str, tmp_path: Path) -> None:
    args = ["linear", "--to", "traj3@linear", "--population", "10", "--generations", "5"]
    assert call(*args, "--out", str(tmp_path / "here")) == 0
    assert call(*args, "--out", str(tmp_path / "there"), "--scheduler", address) == 0
    here, there = document(tmp_path / "here"), document(tmp_path / "there")
    assert here["parameters"] == there["parameters"]
    assert here["cost"] == there["cost"]


def test_other_versions_are_refused(lab: Profile, address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from validation import store

    now = store.versions()
    monkeypatch.setattr("validation.fit.cluster.store.versions", lambda: {**now, "mujoco": "2.0"})
    p = problem(lab, scenario(lab), FitCost(), "coulomb")
    monkeypatch.setattr(distributed.Client, "run", lambda self, function: {"worker": now})
    with pytest.raises(ClusterError, match=r"mujoco .* there, 2\.0 here"):
        Cluster(address, p)


def test_without_the_extra_the_message_says_what_to_install(lab: Profile, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ClusterError, match=r"pip install 'ssmr-testbed\[cluster\]'"):
        Cluster("tcp://127.0.0.1:9", problem(lab, scenario(lab), FitCost(), "coulomb"))
