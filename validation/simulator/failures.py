"""MuJoCo's own errors in this project's terms."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import mujoco

from ssmr.errors import SsmrError


@contextlib.contextmanager
def mujoco_failures() -> Iterator[None]:
    """Within, or in a function that this decorates, a simulator that gives up is a failed run.

    Raises:
        SsmrError: it gave up, as where contacts do not fit into its arena, or memory is short.
    """
    try:
        yield
    except mujoco.FatalError as error:
        raise SsmrError(f"mujoco gave up: {' '.join(str(error).split())}") from error
