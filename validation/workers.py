"""Workers: threads here, or those of a dask scheduler. The only place that makes an executor.

dask sends Python objects as they are and runs them, see SECURITY.md. It is the extra `cluster`.
"""

from __future__ import annotations

import logging
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from functools import cache
from typing import Any
from weakref import WeakKeyDictionary

import llvmlite.binding
import numpy as np

from ssmr.errors import SsmrError
from ssmr.types import FloatArray
from validation.output import list_versions, one_line

_ADDRESS = re.compile(r"(tls://[^/]+|tcp://(localhost|127(\.\d+){3}|\[::1\])):\d+")
"""Addresses of schedulers: encrypted ones, and those of this machine."""
_SHARES = 4
"""Shares of a worker's thread: one that is done early takes another."""
_WORTH_S = 0.1
"""Least time of a share that is worth its way, on which dask spends some milliseconds [s]."""
_PATIENCE_S = 10.0
"""Time that a scheduler has to answer, and to have workers [s]."""
_clients: dict[str, Any] = {}
_compared: set[str] = set()
"""Addresses of the workers whose versions and processors were compared with those here."""
_scattered: WeakKeyDictionary[Any, tuple[Any, Any]] = WeakKeyDictionary()
"""The client and the future of each problem that lies at all of a scheduler's workers."""
_log = logging.getLogger(__name__)


def threads_of(workers: int | str | None) -> int:
    """Return how many threads compute here; a scheduler's address stands for all processors."""
    return workers if isinstance(workers, int) else os.cpu_count() or 1


def require_address(address: str) -> None:
    """Raise a ValueError for an address that is no scheduler's, or where others could listen."""
    if not _ADDRESS.fullmatch(address):
        raise ValueError(
            f"workers is '{one_line(address)}', wanted a number of threads or the address of a "
            "dask scheduler: tls://HOST:PORT, or tcp://127.0.0.1:PORT on this machine or as ssh "
            "forwards it; on others' networks a plain tcp:// lets them run code here and there"
        )


def complete_calls(
    workers: int | str | None, function: Callable[..., Any], calls: Sequence[Sequence[Any]]
) -> Iterator[tuple[int, Any]]:
    """Call a function side by side; yield the number and the result of each call as it ends.

    Calls that have not begun are dropped when the iterator is closed, or by an interrupt.

    Raises:
        ValueError: no scheduler answers at the address.
        SsmrError: the scheduler or its last worker went away.
    """
    client = _connect_client(workers) if isinstance(workers, str) else None
    pool: Executor
    if client is None:
        pool = ThreadPoolExecutor(threads_of(workers))
    else:
        pool = client.get_executor(pure=False)
    futures: dict[Future[Any], int] = {}
    own = None
    try:
        if client is not None:
            _warn_of_others(client)
        for number, result, own in _yield_outcomes(client, pool, function, calls, futures):
            if own is not None:
                raise own
            yield number, result
    except Exception as error:  # dask has no common one
        if client is None or error is own:
            raise
        raise _scheduler_gone(workers, error) from error
    finally:
        for future in futures:
            future.cancel()
        pool.shutdown()


def _yield_outcomes(
    client: Any,
    pool: Executor,
    function: Callable[..., Any],
    calls: Sequence[Sequence[Any]],
    futures: dict[Future[Any], int],
) -> Iterator[tuple[int, Any, Exception | None]]:
    """Yield number, result and error of each call as it ends; write the `futures` by their calls.

    A call whose result went away with its worker is made again.
    """
    for number, call in enumerate(calls):
        futures[pool.submit(_outcome_of, function, *call)] = number
    waiting = set(futures)
    lost = 0
    while waiting:
        done, waiting = wait(waiting, _PATIENCE_S, FIRST_COMPLETED)
        if client is not None and not done and not client.nthreads():
            raise RuntimeError("no worker is left")
        for future in sorted(done, key=futures.__getitem__):
            number = futures[future]
            try:
                result, error = future.result()
            except Exception:  # of the scheduler, whatever it is: it lost the result
                lost += 1
                if client is None or lost > len(calls) or not client.nthreads():
                    raise
                again = pool.submit(_outcome_of, function, *calls[number])
                futures[again] = number
                waiting.add(again)
            else:
                yield number, result, error


def _outcome_of(function: Callable[..., Any], *call: Any) -> tuple[Any, Exception | None]:
    """Return what a call returns, or what it raises, which is then no error of the scheduler."""
    try:
        return function(*call), None
    except Exception as error:  # noqa: BLE001 - raised again where it was asked for
        return None, error


def rate_there(
    address: str,
    problem: Any,
    method: str,
    columns: Sequence[FloatArray],
    on_share: Callable[[float], object] | None = None,
) -> FloatArray:
    """Return what a problem's method returns for (S, ...) columns, from a scheduler's workers.

    Each share of them is rated on one thread, and the result is equal to the bit where versions and
    processors are. `on_share` is called with the share of the work that is done. The errors are
    those of `complete_calls`.
    """
    client = _connect_client(address)
    if problem not in _scattered or _scattered[problem][0] is not client:
        _scattered[problem] = client, client.scatter(problem, broadcast=True, hash=False)
    at_workers = _scattered[problem][1]
    threads = sum(client.nthreads().values())
    count = max(1, min(len(columns[0]), _SHARES * threads))
    shares = zip(*(np.array_split(column, count) for column in columns), strict=True)
    calls = [(at_workers, method, *share) for share in shares]
    rated = {}
    seconds = 0.0
    for number, (values, took) in complete_calls(address, _rate_share, calls):
        rated[number] = values
        seconds += took
        if on_share is not None:
            on_share(len(rated) / count)
    if seconds / count < _WORTH_S:
        _say_slow(address)
    return np.concatenate([rated[number] for number in range(count)])


def _scheduler_gone(address: int | str | None, error: Exception) -> SsmrError:
    why = f"{type(error).__name__}: {one_line(error)[:120]}"
    return SsmrError(
        f"the dask scheduler {address} or its workers are gone ({why}); "
        "a search keeps its checkpoint, and --resume goes on from it"
    )


@cache
def _say_slow(address: str) -> None:
    _log.warning(
        "a worker needs less than %g s for its candidates, and each way to it some milliseconds: "
        "threads here (--workers N) may be quicker than %s",
        *(_WORTH_S, address),
    )


def _rate_share(problem: Any, method: str, *share: FloatArray) -> tuple[FloatArray, float]:
    """Return the values of a share, and the time that it took on this worker [s]."""
    began = time.perf_counter()
    values = getattr(problem, method)(*share)
    return values, time.perf_counter() - began


def _connect_client(address: str) -> Any:
    """Return the client of a scheduler, of which this process has one.

    Raises:
        ValueError: dask is not installed, no scheduler answers, or it has no workers.
    """
    client = _clients.get(address)
    if client is not None and client.status == "running":
        return client
    require_address(address)
    try:
        from distributed import Client
    except ImportError as error:
        raise ValueError(
            f"a scheduler's workers need dask ({error}): "
            "pip install 'ssmr-testbed[cluster]' (in a source tree: '.[cluster]')"
        ) from None
    # what goes wrong is said here, in one line
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        client = Client(address, timeout=_PATIENCE_S, set_as_default=False)
        client.wait_for_workers(1, _PATIENCE_S)
    except OSError as error:
        if address in _clients:
            raise _scheduler_gone(address, error) from error
        raise ValueError(
            f"no dask scheduler with workers answers at {address} ({one_line(error)}); start them "
            f"with `dask scheduler` and `dask worker {address}`"
        ) from None
    _clients[address] = client
    return client


def _warn_of_others(client: Any) -> None:
    """Warn once of each worker whose versions or processor are not those here."""
    new = client.nthreads().keys() - _compared
    _compared.update(new)
    ours = _versions_here()
    for worker, theirs in client.run(_versions_here, workers=sorted(new)).items():
        unlike = [name for name in ours if theirs[name] != ours[name]]
        if unlike:
            words = ", ".join(f"{name} {theirs[name]}, not {ours[name]}" for name in unlike)
            _log.warning(
                "the worker %s has %s: its results may differ in their last digits", worker, words
            )


def _versions_here() -> Mapping[str, str]:
    """Return on what the last digits of results depend: versions and the processor."""
    return {**list_versions(), "processor": llvmlite.binding.get_host_cpu_name()}
