"""Generations that an executor of `concurrent.futures` rates: processes here, or the workers of a dask scheduler."""

import contextlib
import logging
import re
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from typing import Any

import numpy as np

from ssmr.errors import SsmrError
from ssmr.types import FloatArray

CONNECT_TIMEOUT = 5.0  # time within which a scheduler must answer [s]
_MUST_AGREE = ("ssmr-testbed", "mujoco", "numpy", "numba")  # packages whose versions decide the numbers


def costs_by(
    executor: Executor, shares: int, rate: Callable[..., FloatArray], points: FloatArray, limits: FloatArray
) -> FloatArray:
    """Return the (S,) costs of (S, n) points with (S,) limits, which `rate` gives in another process, in so many shares."""
    costs = np.empty(len(points))
    parts = [slice(first, None, shares) for first in range(min(shares, len(points)))]
    try:
        found = executor.map(rate, [points[p] for p in parts], [limits[p] for p in parts], [1] * len(parts))
        for part, share in zip(parts, found, strict=True):
            costs[part] = share
    except Exception as error:  # executors have no common class of errors
        raise SsmrError(f"the executor that rates candidates failed: {type(error).__name__}: {error}") from error
    return costs


@contextlib.contextmanager
def dask_executor(address: str) -> Iterator[tuple[Executor, int]]:
    """Yield the executor of a dask scheduler, and the number of its workers; a ValueError says why there is none."""
    try:
        from distributed import Client
    except ImportError as error:
        raise ValueError("a scheduler needs dask: pip install 'ssmr-testbed[cluster]', here '.[cluster]'") from error
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # it logs what is reported here
    try:
        if not re.fullmatch(r"\w+://.+:\d+", address):
            raise ValueError(address)
        client: Any = Client(address, timeout=CONNECT_TIMEOUT)
    except (OSError, ValueError) as error:
        raise ValueError(f"no dask scheduler answers at {address}; start one: dask scheduler --host 127.0.0.1") from error
    with client:
        found = client.get_versions(packages=_MUST_AGREE)
        here, there = found["client"]["packages"], [worker["packages"] for worker in found["workers"].values()]
        if not there or any(versions[name] != here[name] for versions in there for name in _MUST_AGREE):
            raise ValueError(f"{address} has no worker, or one with other versions of {', '.join(_MUST_AGREE)}")
        yield client.get_executor(pure=False), len(there)
