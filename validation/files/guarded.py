"""Foreign files, which can be damaged or bombs, are read in a child process with limits.

The child is a new Python that calls one function and sends back what it returns: a value of JSON,
and bytes. What it unpacks on the disk is gone afterwards. Only time of the processor counts, so a
busy machine changes nothing. Where an operating system has no limits for processes, the child
watches that time itself, and nothing else is limited.
"""

from __future__ import annotations

import io
import json
import math
import os
import signal
import subprocess  # nosec B404 # it runs this file
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from validation.output import shorten_text

_CALL = """
import json, sys
sys.path[:], *task = json.load(sys.stdin)
from validation.files.guarded import serve
serve(*task)
"""
_LONGEST = 200
"""Greatest length of an error's text in a message."""
_SPENT = int(getattr(signal, "SIGXCPU", 24))
"""Signal or status with which a child ends that has used its time."""
_WATCH_S = 0.05
"""Time between two looks at the time that is used [s]."""


Allowance = tuple[float, int, int]
"""Limits of a child process, which ends beyond them: time of the processor without the start of
Python [s], addresses [bytes], and the size of a file that it writes [bytes]."""
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
        ran = subprocess.run(  # nosec B603 # the arguments are our own
            [sys.executable, "-P", "-c", _CALL],
            input=json.dumps(task).encode(),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=os.environ | lean,
        )
    if ran.returncode:
        seconds, memory, _ = allowance
        what = f"takes more than {memory / 2**30:.3g} GiB, or ends the reader"
        if abs(ran.returncode) == _SPENT:
            what = f"takes more than the {seconds:.3g} s of processor time allowed"
        raise ValueError(f"reading it {what}: does something in it grow without end?")
    output = io.BytesIO(ran.stdout)
    fault, answer, sizes = json.loads(output.readline())
    if fault:
        raise ValueError(fault)
    return answer, [output.read(size) for size in sizes]


def serve(module: str, name: str, arguments: Sequence[Any], allowance: Sequence[Any]) -> None:
    """Call a function within its allowance, and write its answer to stdout."""
    function = getattr(import_module(module), name)
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # prints of a library are no answer
    _limit_process(*allowance)
    sys.addaudithook(_refuse_pipe)
    fault = ""
    try:
        answer, parts = function(*arguments)
    except Exception as error:  # noqa: BLE001 - readers of foreign formats promise nothing narrower
        fault = shorten_text(error, _LONGEST) or type(error).__name__
        answer = None
        parts = ()
    head = json.dumps([fault, answer, [len(part) for part in parts]])
    output.writelines([head.encode(), b"\n", *parts])
    output.close()


def _limit_process(seconds: float, memory: int, disk: int) -> None:
    """Limit what this process uses from now on; the arguments are those of `Allowance`."""
    end = time.process_time() + seconds
    if os.name != "posix":
        threading.Thread(target=_end_beyond, args=[end], daemon=True).start()
        return
    import resource

    limits = {"CORE": 0, "CPU": math.ceil(end), "AS": memory, "FSIZE": disk}
    for name, most in limits.items():
        kind = getattr(resource, f"RLIMIT_{name}")
        _, hard = resource.getrlimit(kind)
        # the soft limit, which has a signal of its own; the hard one may be lower already
        soft = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(kind, (soft, hard))


def _end_beyond(end: float) -> None:
    """End this process once it has used so much time of the processor [s]."""
    while time.process_time() < end:
        time.sleep(_WATCH_S)
    os._exit(_SPENT)


def _refuse_pipe(event: str, arguments: tuple[Any, ...]) -> None:
    """Raise a ValueError where a pipe is opened: to wait for one takes no time of the processor."""
    if event == "open" and isinstance(arguments[0], str) and Path(arguments[0]).is_fifo():
        raise ValueError(f"{arguments[0]} is a pipe, wanted a file")
