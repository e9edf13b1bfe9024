"""SIGTERM, SIGHUP and SIGINT at random moments: 143, 129 or 130, one line, and the result of a search that had begun."""

from __future__ import annotations

import functools
import random
import signal
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from tests.faults import disks, files
from tests.faults.doors import process
from tests.faults.judge import Outcome
from tests.faults.pool import Part

STATUS = {signal.SIGTERM: 143, signal.SIGHUP: 129, signal.SIGINT: 130}
"""Exit status by signal."""
KEPT = {"fit": "fit.json", "tune": "tune.json"}
"""Results that an interrupted search writes, once it has found anything: then its checkpoint is there."""


def plan(inputs: int, kills: int) -> dict[str, int]:
    """Return how many signals each program gets."""
    return dict.fromkeys(disks.COMMANDS, max(1, round(3 * kills / 4 / len(disks.COMMANDS))))


@functools.cache
def _duration(command: str) -> float:
    with tempfile.TemporaryDirectory(prefix="ssmr-faults-calm-") as place:
        files.lay_out(Path(place) / "work")
        began = time.perf_counter()
        process(command, disks.argv_of(command, "out"), Path(place) / "work")
        return time.perf_counter() - began


def run(command: str, rng: random.Random, folder: Path) -> tuple[Outcome, Sequence[int]]:
    """Send a program a signal; its folder must be whole."""
    work = folder / "work"
    files.lay_out(work)
    number, share = rng.choice(list(STATUS)), rng.uniform(0.02, 1.0)
    delay, sent = share * _duration(command), []

    def meanwhile(running: subprocess.Popen[bytes]) -> None:
        until = time.monotonic() + delay
        while time.monotonic() < until and running.poll() is None:
            time.sleep(0.01)
        if running.poll() is None:
            running.send_signal(number)
            sent.append((work / "out" / "checkpoint.npz").is_file())

    what = f"{command}: {number.name} after {100.0 * share:.0f} % of its time"
    out = process(what, disks.argv_of(command, "out"), work, meanwhile=meanwhile)
    if sent and out.status == -number:  # the system's own answer, before the program has one: a shell shows the same
        out.status, out.stderr = STATUS[number], out.stderr or "ended by the system"
    lost = command in KEPT and not (work / "out" / KEPT[command]).is_file()
    if sent == [True] and out.status and lost and "--resume" not in out.stderr:
        out.fault("damaged file", f"{KEPT[command]} is not there, and nothing says that the search is kept")
    return disks.only(out, work / "out"), (0, STATUS[number]) if sent else (0,)


PART = Part(plan, run, patience=600.0)
