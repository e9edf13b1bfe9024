"""Kills this process at an event of the file system, or in the middle of a write; the campaign puts this on the path.

`SSMR_FAULTS_ROOT`: the folder whose events count. `SSMR_FAULTS_COUNT`: file for their number. `SSMR_FAULTS_KILL`: the event,
from 1 on, before which the process is killed. `SSMR_FAULTS_CUT`: the size [bytes] that no file can pass alive.
"""

from __future__ import annotations

import os
import resource
import signal
import sys
import threading

_EVENTS = {"os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.truncate", "os.link", "os.symlink", "os.utime"}


def _watch(root: str, kill_at: int, count_into: str | None) -> None:
    seen, lock = 0, threading.Lock()

    def look(event: str, arguments: tuple[object, ...]) -> None:
        nonlocal seen
        if event == "open":
            path, _, flags = arguments
            if not isinstance(flags, int) or not flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
                return
        elif event in _EVENTS:
            path = arguments[0]
        else:
            return
        try:
            where = os.path.abspath(os.fsdecode(path))  # type: ignore[arg-type]
        except TypeError:  # an open file's number
            return
        if not where.startswith(root):
            return
        with lock:
            seen += 1
            if seen == kill_at:
                os.kill(os.getpid(), signal.SIGKILL)
            if count_into is not None:
                file = os.open(count_into, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
                os.write(file, str(seen).encode())
                os.close(file)

    sys.addaudithook(look)


if "SSMR_FAULTS_CUT" in os.environ:
    signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
    most = int(os.environ["SSMR_FAULTS_CUT"])
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
if "SSMR_FAULTS_ROOT" in os.environ:
    _watch(os.environ["SSMR_FAULTS_ROOT"], int(os.environ.get("SSMR_FAULTS_KILL", "0")), os.environ.get("SSMR_FAULTS_COUNT"))
