"""MuJoCo's failures in Python's terms: MuJoCo itself raises `FatalError`, or a `ValueError` that nobody's value caused."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import mujoco

from ssmr.errors import SsmrError

_SAID = "there is not enough memory for the simulator"
_NO_MEMORY = ("Could not allocate memory", "Caught an unknown exception")
"""What its messages say then; the second is that of its bindings where a copy of a model does not fit."""


@contextlib.contextmanager
def mujoco_failures() -> Iterator[None]:
    """Within, or in a function that this decorates, what MuJoCo cannot do is said in Python's terms.

    Raises:
        MemoryError: there is not enough memory for a model, its data, or a batch.
        SsmrError: the simulator gave up for another reason, such as contacts that do not fit into its arena.
    """
    try:
        yield
    except MemoryError as error:
        if str(error):
            raise
        raise MemoryError(_SAID) from error  # Python's own says nothing
    except (mujoco.FatalError, ValueError, RuntimeError) as error:
        if any(words in str(error) for words in _NO_MEMORY):
            raise MemoryError(_SAID) from error
        if isinstance(error, mujoco.FatalError):
            raise SsmrError(f"mujoco gave up: {' '.join(str(error).split())}") from error
        raise
