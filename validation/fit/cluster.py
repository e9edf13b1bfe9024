"""Generations rated by the workers of a dask.distributed cluster (extra `cluster`); the costs are those of one process."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from ssmr.types import FloatArray
from validation import store
from validation.fit.problem import FitProblem

CONNECT_TIMEOUT = 15.0
"""Time within which the scheduler must answer, and then have a worker [s]."""
_START = "dask scheduler --host 127.0.0.1 --dashboard-address 127.0.0.1:8787"
"""A scheduler that only this machine reaches: there is no password, and both addresses would be open to all otherwise."""
_MUST_AGREE = ("ssmr-testbed", "mujoco", "numpy", "numba")  # packages whose versions decide the numbers

_one_at_a_time = threading.Lock()  # a worker process rates one share at a time: the compiled loops use all its threads


class ClusterError(ValueError):
    """A cluster that cannot be used; the message says why."""


def _rate(problem: FitProblem, points: FloatArray, limits: FloatArray, threads: int) -> FloatArray:
    """Return the costs of a share of the generation; this runs on a worker."""
    with _one_at_a_time:
        return problem.costs(points, limits, workers=threads)


class Cluster:
    """A connection to a scheduler whose workers rate generations; a context manager that closes it."""

    def __init__(self, address: str, problem: FitProblem) -> None:
        """Connect, check that the workers run equal versions, and hand them the problem once.

        Raises:
            ClusterError: dask.distributed is not installed, no scheduler answers, or versions differ.
        """
        try:
            from distributed import Client
        except ImportError as error:
            raise ClusterError(
                "a scheduler needs dask.distributed: pip install 'ssmr-testbed[cluster]' (in a source tree: '.[cluster]')"
            ) from error
        try:
            self._client: Any = Client(address, timeout=CONNECT_TIMEOUT, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise ClusterError(f"no dask scheduler answers at {address}; start one with: {_START}") from error
        try:
            self._client.wait_for_workers(1, timeout=CONNECT_TIMEOUT)
            self._check_versions()
        except TimeoutError as error:
            self.close()
            raise ClusterError(f"the scheduler at {address} has no worker; docs/many_machines.md starts one") from error
        except ClusterError:
            self.close()
            raise
        self._problem = self._client.scatter(problem, broadcast=True)

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection; the cluster goes on."""
        self._client.close()

    def _check_versions(self) -> None:
        here = store.versions()
        for worker, there in self._client.run(store.versions).items():
            differs = [f"{p} {there.get(p)} there, {here[p]} here" for p in _MUST_AGREE if there.get(p) != here[p]]
            if differs:
                raise ClusterError(f"worker {worker} has other versions, so its numbers would differ: {'; '.join(differs)}")

    def __call__(
        self, points: FloatArray, limits: FloatArray, on_share: Callable[[float], object] | None = None
    ) -> FloatArray:
        """Rate a generation: each worker process gets every n-th candidate, see `SearchProblem.costs`.

        Raises:
            KeyboardInterrupt: Ctrl-C was pressed; the work that has not begun is cancelled.
        """
        workers = self._client.scheduler_info(n_workers=-1)["workers"]
        addresses = sorted(workers)[: len(points)]
        shares = [np.arange(len(points))[i :: len(addresses)] for i in range(len(addresses))]
        futures = [
            self._client.submit(
                _rate, self._problem, points[share], limits[share], workers[address]["nthreads"], workers=[address],
                allow_other_workers=True, pure=False,
            )
            for address, share in zip(addresses, shares, strict=True)
        ]  # fmt: skip
        try:
            while on_share is not None and not all(f.done() for f in futures):
                on_share(sum(f.done() for f in futures) / len(futures))
                time.sleep(0.05)
            costs = np.empty(len(points))
            for share, found in zip(shares, self._client.gather(futures), strict=True):
                costs[share] = found
        except KeyboardInterrupt:
            self._client.cancel(futures)
            raise
        return costs
