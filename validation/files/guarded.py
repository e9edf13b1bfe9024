"""Foreign files, which can be damaged or bombs, are read in a child process with limits.

The child is a new Python that calls one function and sends back what it returns: a value of JSON,
and bytes. What it unpacks on the disk is gone afterwards. Where an operating system has no limits
for processes, only the time is limited.
"""

from __future__ import annotations

import io
import json
import math
import os
import subprocess  # nosec B404 # it runs this file
import sys
import tempfile
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any, NamedTuple

from validation.output import shortened

_CALL = """
import json, sys
sys.path[:], *task = json.load(sys.stdin)
from validation.files.guarded import serve
serve(*task)
"""
_LONGEST = 200
"""Greatest length of an error's text in a message."""


class Allowance(NamedTuple):
    """Limits of a child process, which ends beyond them."""

    seconds: float
    """Time by the clock and of the processor [s]."""
    memory: int
    """Addresses [bytes]."""
    disk: int = 0
    """Size of a file that it writes [bytes]."""


Answer = tuple[Any, Sequence[Any]]
"""Answer of a function in a child process: a value of JSON, and buffers of bytes."""


def ask(function: Callable[..., Answer], arguments: Sequence[Any], allowance: Allowance) -> Answer:
    """Return the answer of a function of a module, called in a child process.

    Its arguments are values of JSON.

    Raises:
        ValueError: the function raised something, or used more than it may.
    """
    task = [sys.path, function.__module__, function.__name__, arguments, allowance]
    with tempfile.TemporaryDirectory() as folder:
        # threads and arenas of memory would count against the limit
        lean = {"OPENBLAS_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "1", "TMPDIR": folder}
        try:
            ran = subprocess.run(  # nosec B603 # the arguments are our own
                [sys.executable, "-P", "-c", _CALL],
                input=json.dumps(task).encode(),
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                timeout=allowance.seconds,
                env=os.environ | lean,
            )
        except subprocess.TimeoutExpired as error:
            raise ValueError(
                f"reading it does not come to an end in {error.timeout:.3g} s"
            ) from error
    if ran.returncode:
        what = (
            "reading it takes more than "
            f"{allowance.seconds:.3g} s and {allowance.memory / 2**30:.3g} GiB, "
            "or ends the reader"
        )
        raise ValueError(f"{what}: does something in it grow without end?")
    output = io.BytesIO(ran.stdout)
    fault, answer, sizes = json.loads(output.readline())
    if fault:
        raise ValueError(fault)
    return answer, [output.read(size) for size in sizes]


def serve(module: str, name: str, arguments: Sequence[Any], allowance: Sequence[Any]) -> None:
    """Call a function within limits of the operating system, and write its answer to stdout."""
    function = getattr(import_module(module), name)
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # prints of a library are no answer
    if os.name == "posix":
        import resource

        seconds, memory, disk = allowance
        limits = {"CORE": 0, "CPU": math.ceil(seconds), "AS": memory, "FSIZE": disk}
        for name, most in limits.items():
            resource.setrlimit(getattr(resource, f"RLIMIT_{name}"), (most, most))
    fault = ""
    try:
        answer, parts = function(*arguments)
    except Exception as error:  # noqa: BLE001 - readers of foreign formats promise nothing narrower
        fault = shortened(error, _LONGEST) or type(error).__name__
        answer = None
        parts = ()
    head = json.dumps([fault, answer, [len(part) for part in parts]])
    output.writelines([head.encode(), b"\n", *parts])
    output.close()
