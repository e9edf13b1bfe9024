"""Foreign files, which can be damaged or bombs: they are read in a child process that neither lasts nor grows for long.

The child is a new Python that calls one function and sends back what it returns: a value of JSON, and bytes. It works in a
folder of its own, which is gone afterwards with all that was unpacked there. Where an operating system has no limits for
processes, only the time is limited.
"""

from __future__ import annotations

import importlib
import json
import math
import os
import subprocess  # nosec B404 # it runs this file
import sys
import tempfile
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from validation.words import shortened

_CALL = "import sys; sys.path[:] = {path!r}; from validation.files.guarded import serve; serve()"
_PATIENCE = 2.0  # greatest time by the clock over that of the processor
_LONGEST = 200  # greatest length of what a message says of an error


class Allowance(NamedTuple):
    """What a child may use; beyond it ends."""

    seconds: float
    """Time of the processor [s]; by the clock it may take twice as long, for other work goes on beside it."""
    memory: int
    """Addresses [bytes]."""
    disk: int = 0
    """Size of a file that it writes [bytes]."""


Answer = tuple[Any, Sequence[Any]]
"""What a function gives in a child process: a value of JSON, and buffers of bytes."""


def ask(function: Callable[..., Answer], arguments: Sequence[Any], allowance: Allowance) -> tuple[Any, list[memoryview]]:
    """Return what a function gives that a child process calls.

    Args:
        function: a function of a module.
        arguments: values of JSON; paths must be absolute.
        allowance: what the child may use.

    Raises:
        ValueError: the function raised something, or used more than it may.
    """
    asked = json.dumps([function.__module__, function.__name__, arguments, allowance])
    call = _CALL.format(path=[os.path.abspath(place) for place in sys.path])
    with tempfile.TemporaryDirectory() as folder:
        lean = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "1", "TMPDIR": folder}
        try:
            ran = subprocess.run(  # nosec B603 # the arguments are our own
                [sys.executable, "-P", "-c", call],
                input=asked.encode(),
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                timeout=_PATIENCE * allowance.seconds,
                env=lean,
                cwd=folder,
            )
        except subprocess.TimeoutExpired as error:
            raise ValueError(f"reading it does not come to an end in {error.timeout:.3g} s") from error
    if ran.returncode:
        most = f"{allowance.seconds:.3g} s and {allowance.memory / 2**30:.3g} GiB"
        raise ValueError(f"reading it takes more than {most}, or ends the reader: does something in it grow without end?")
    start = ran.stdout.index(b"\n") + 1
    fault, answer, sizes = json.loads(ran.stdout[:start])
    if fault:
        raise ValueError(fault)
    rest = memoryview(ran.stdout)
    parts = []
    for size in sizes:
        parts.append(rest[start : start + size])
        start += size
    return answer, parts


def serve() -> None:
    """Call the function that standard input names, within its limits, and write what it gives to standard output."""
    module, name, arguments, allowance = json.load(sys.stdin)
    function = getattr(importlib.import_module(module), name)
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no answer
    _limit(Allowance(*allowance))
    fault = ""
    try:
        answer, parts = function(*arguments)
    except Exception as error:  # noqa: BLE001 - readers of foreign formats promise nothing narrower
        fault = shortened(error, _LONGEST) or type(error).__name__
        answer, parts = None, ()
    sizes = [len(part) for part in parts]
    output.write(json.dumps([fault, answer, sizes]).encode() + b"\n")
    for part in parts:
        output.write(part)
    output.close()


def _limit(allowance: Allowance) -> None:
    """Let the operating system hold this process to what it may use, where it can."""
    if os.name == "posix":
        import resource

        for what, most in (
            (resource.RLIMIT_CORE, 0),
            (resource.RLIMIT_CPU, math.ceil(allowance.seconds)),
            (resource.RLIMIT_AS, allowance.memory),
            (resource.RLIMIT_FSIZE, allowance.disk),
        ):
            resource.setrlimit(what, (most, most))
