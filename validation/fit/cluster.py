"""Generations rated by the workers of a dask.distributed cluster (extra `cluster`); the costs are those of one process."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from typing import Any

import numpy as np

from ssmr.errors import SsmrError
from ssmr.types import FloatArray, IndexArray
from validation import store
from validation.fit.problem import FitProblem

CONNECT_TIMEOUT = 15.0
"""Time within which the scheduler must answer, and then have a worker [s]."""
WORKER_TIMEOUT = 30.0
"""Time for which a search waits for a worker when there is none any more [s]; a worker that is started anew needs less."""
_CLOSE_TIMEOUT = 2.0
"""Time that closing a connection may take [s]."""
_ATTEMPTS = 5
"""Number of times that what lost workers had is rated again in one generation."""
_START = "dask scheduler --host 127.0.0.1 --dashboard-address 127.0.0.1:8787"
"""A scheduler that only this machine reaches: there is no password, and both addresses would be open to all otherwise."""
_MUST_AGREE = ("ssmr-testbed", "mujoco", "numpy", "numba")  # packages whose versions decide the numbers

_one_at_a_time = threading.Lock()  # a worker process rates one share at a time: the compiled loops use all its threads


class ClusterError(ValueError):
    """A cluster that cannot be used; the message says why."""


class ClusterLostError(SsmrError):
    """A cluster that could be used, and was lost in mid-search; `evidence` holds its address."""


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
        _silence_dask()
        self._address, self._problem = address, problem
        self._there: Any = None  # the problem on the workers
        self._known: set[str] = set()  # addresses of workers whose versions are known to be right
        try:
            _require_reachable(address)
            self._client: Any = Client(address, timeout=CONNECT_TIMEOUT, set_as_default=False)
        except (OSError, ValueError, OverflowError, TimeoutError) as error:
            raise ClusterError(f"no dask scheduler answers at {address}; start one with: {_START}") from error
        try:
            self._client.wait_for_workers(1, timeout=CONNECT_TIMEOUT)
            self._require_equal_versions()
        except TimeoutError as error:
            self.close()
            raise ClusterError(f"the scheduler at {address} has no worker; docs/many_machines.md starts one") from error
        except ImportError as error:
            self.close()
            raise ClusterError(f"a worker at {address} lacks a package that this project needs: {error}") from error
        except ClusterError:
            self.close()
            raise

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection; the cluster goes on."""
        with contextlib.suppress(OSError, TimeoutError):  # what is lost is closed
            self._client.close(timeout=_CLOSE_TIMEOUT)

    def _require_equal_versions(self) -> None:
        """Ask workers that have joined for their versions.

        Raises:
            ClusterError: theirs differ from ours.
        """
        here = store.versions()
        for worker, there in self._client.run(store.versions).items():
            differs = [f"{p} {there.get(p)} there, {here[p]} here" for p in _MUST_AGREE if there.get(p) != here[p]]
            if differs:
                raise ClusterError(f"worker {worker} has other versions, so its numbers would differ: {'; '.join(differs)}")
            self._known.add(worker)

    def __call__(
        self, points: FloatArray, limits: FloatArray, on_share: Callable[[float], object] | None = None
    ) -> FloatArray:
        """Rate a generation: each worker process gets every n-th candidate, see `SearchProblem.costs`.

        What a worker had when it was lost is rated by another one; the costs do not depend on that.

        Raises:
            KeyboardInterrupt: Ctrl-C was pressed; the work that has not begun is cancelled.
            ClusterLostError: the scheduler no longer answers, or for a while there is no worker.
        """
        costs = np.full(len(points), np.nan)
        left = np.arange(len(points))
        for _ in range(_ATTEMPTS):
            try:
                for share, found in self._shares(points, limits, left, on_share or (lambda _: None)):
                    costs[share] = found
                    left = np.setdiff1d(left, share)
            except _losses() as error:
                if self._client.status != "running":
                    raise self._lost("its scheduler no longer answers") from error
                self._there = None  # the problem itself may be lost with the worker that had it
            if not len(left):
                return costs
        raise self._lost(f"its workers were lost {_ATTEMPTS} times in one generation")

    def _lost(self, why: str) -> ClusterLostError:
        return ClusterLostError(f"the cluster at {self._address} is lost: {why}", address=self._address)

    def _workers(self) -> dict[str, int]:
        """Return the number of threads of each worker by address, as soon as there is one of equal versions.

        Raises:
            ClusterLostError: none comes.
        """
        deadline = time.monotonic() + WORKER_TIMEOUT
        while not (found := self._client.scheduler_info(n_workers=-1)["workers"]):
            if self._client.status != "running" or time.monotonic() > deadline:
                raise self._lost(f"it has had no worker for {WORKER_TIMEOUT:g} s")
            time.sleep(0.2)
        if not set(found) <= self._known:
            self._require_equal_versions()
        return {address: int(worker["nthreads"]) for address, worker in found.items()}

    def _shares(
        self, points: FloatArray, limits: FloatArray, which: IndexArray, tell: Callable[[float], object]
    ) -> Iterator[tuple[IndexArray, FloatArray]]:
        """Rate some candidates; yield each worker's share of them, and its costs, when all are rated."""
        workers = self._workers()
        if self._there is None:
            self._there = self._client.scatter(self._problem, broadcast=True)
        addresses = sorted(workers)[: len(which)]
        shares = [which[i :: len(addresses)] for i in range(len(addresses))]
        futures = [
            self._client.submit(
                _rate, self._there, points[share], limits[share], workers[address], workers=[address],
                allow_other_workers=True, pure=False,
            )
            for address, share in zip(addresses, shares, strict=True)
        ]  # fmt: skip
        try:
            self._await(futures, lambda done: tell(1.0 - (1.0 - done) * len(which) / len(points)))
            for share, future in zip(shares, futures, strict=True):
                yield share, future.result(timeout=CONNECT_TIMEOUT)
        except KeyboardInterrupt:
            with contextlib.suppress(*_losses()):
                self._client.cancel(futures)
            raise

    def _await(self, futures: Sequence[Any], tell: Callable[[float], object]) -> None:
        """Wait until all are done or cancelled; a cluster without workers is waited for only for a while.

        Raises:
            ClusterLostError: the scheduler no longer answers, or there is no worker.
        """
        asked = time.monotonic()
        while not all(future.done() for future in futures):
            tell(sum(future.done() for future in futures) / len(futures))
            if self._client.status != "running":
                raise self._lost("its scheduler no longer answers")
            if time.monotonic() - asked > 1.0:
                self._workers()
                asked = time.monotonic()
            time.sleep(0.05)


def _require_reachable(address: str) -> None:
    """Connect to a scheduler once: a client of dask that cannot connect tries again for long when it is thrown away.

    Raises:
        ValueError: this is no address.
        OSError: nobody answers there.
        OverflowError: the port is greater than any.
    """
    from distributed.comm import addressing

    scheme, place = addressing.parse_address(address)
    if scheme in ("tcp", "tls"):
        with socket.create_connection(addressing.parse_host_port(place), timeout=CONNECT_TIMEOUT):
            pass


def _losses() -> tuple[type[BaseException], ...]:
    """Return the errors in which dask ends when a scheduler, a worker or what a worker held is lost.

    A `KeyError` is the scheduler's, for a worker that left while something was sent to it.
    """
    from distributed import KilledWorker

    return (CancelledError, asyncio.CancelledError, KilledWorker, KeyError, OSError, TimeoutError)


def _silence_dask() -> None:
    """Let dask not log: it writes the tracebacks of losses that are dealt with here."""
    for name in ("distributed", "distributed.client", "distributed.core", "distributed.comm", "tornado", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
