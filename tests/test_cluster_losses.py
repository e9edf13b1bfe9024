"""A cluster that is lost in mid-fit is one line, and what was rated is kept; one that loses a worker goes on."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.test_objective import problem, scenario
from validation.fit import cluster as cluster_module
from validation.fit.cluster import Cluster, ClusterError, ClusterLostError
from validation.fit.objective import FitCost
from validation.fit.run import fit
from validation.plants.profile import Profile

pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")


class Machines:
    """A scheduler, and workers without nurses that would start them anew."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "scheduler.json"
        self.scheduler = self._start("scheduler", "--port", "0", "--host", "127.0.0.1", "--no-dashboard")
        deadline = time.monotonic() + 60.0
        while not self.file.exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        self.address: str = json.loads(self.file.read_text(encoding="utf-8"))["address"]
        self.workers: list[subprocess.Popen[bytes]] = []

    def _start(self, what: str, *arguments: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "dask", what, "--scheduler-file", str(self.file), *arguments]
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def add_worker(self) -> None:
        """Start a worker."""
        options = ("--no-nanny", "--nthreads", "1", "--no-dashboard", "--host", "127.0.0.1", "--death-timeout", "20")
        self.workers.append(self._start("worker", *options))

    def close(self) -> None:
        """End all processes."""
        for process in (*self.workers, self.scheduler):
            with contextlib.suppress(ProcessLookupError):
                os.kill(process.pid, signal.SIGKILL)
            process.wait()


@pytest.fixture
def machines(tmp_path: Path) -> Iterator[Machines]:
    found = Machines(tmp_path)
    yield found
    found.close()


def soon(what: Any) -> None:
    """Do something when the generation has begun."""
    threading.Timer(0.05, what).start()


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_module, "WORKER_TIMEOUT", 2.0)


def test_a_worker_that_dies_is_replaced_by_the_others(lab: Profile, machines: Machines) -> None:
    """One of two dies while it rates; then all die and a new one comes, which does not know the problem."""
    machines.add_worker()
    machines.add_worker()
    p = problem(lab, scenario(lab), FitCost("sync"), "coulomb")
    x = np.random.default_rng(0).random((40, len(p.space)))
    limits = np.full(len(x), np.inf)
    wanted = p.costs(x, limits)
    with Cluster(machines.address, p) as cluster:
        soon(machines.workers[0].kill)
        assert np.array_equal(cluster(x, limits), wanted)
        machines.workers[1].kill()
        machines.add_worker()
        assert np.array_equal(cluster(x, limits), wanted)
        soon(machines.workers[2].kill)
        machines.add_worker()
        assert np.array_equal(cluster(x, limits), wanted)


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("victim", ["scheduler", "worker"])
def test_a_lost_cluster_is_one_line_and_resuming_ends_like_the_undisturbed(
    victim: str, machines: Machines, tmp_path: Path
) -> None:
    machines.add_worker()
    options: dict[str, Any] = {"population": 8, "generations": 60, "patience": 999, "free": ("gain",), "seed": 1}
    kept = tmp_path / "checkpoint.npz"

    def kill(now: Any) -> None:
        if now.done >= 3.0:
            (machines.scheduler if victim == "scheduler" else machines.workers[0]).kill()

    began = time.monotonic()
    with pytest.raises(Exception, match=r"is lost: .*; \d+ generations are kept in .*, and resume goes on") as caught:
        fit("improved", "traj3@improved", checkpoint=kept, scheduler=machines.address, progress=kill, **options)
    assert isinstance(caught.value.__cause__, ClusterLostError)
    assert "\n" not in str(caught.value)
    assert time.monotonic() - began < 90.0
    again = fit("improved", "traj3@improved", checkpoint=kept, resume=True, **options)
    through = fit("improved", "traj3@improved", **options)
    assert again.cost == through.cost
    assert again.parameters == through.parameters
    assert (again.evaluations, again.generations) == (through.evaluations, through.generations)


@pytest.mark.parametrize(
    "address", ["nonsense", "", "tcp://", "tcp://127.0.0.1:1", "tcp://127.0.0.1:99999999", "tcp://a\0b:1"]
)
def test_an_address_where_nobody_answers_is_refused_at_once(address: str, lab: Profile) -> None:
    began = time.monotonic()
    with pytest.raises(ClusterError, match="no dask scheduler answers"):
        Cluster(address, problem(lab, scenario(lab), FitCost(), "coulomb"))
    assert time.monotonic() - began < 10.0
