"""Small machines and odd terminals: little memory, few descriptors, ASCII, closed streams, no home, readers that leave."""

from __future__ import annotations

import os
import random
import resource
import subprocess
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from tests.faults import files
from tests.faults.disks import COMMANDS, argv_of
from tests.faults.doors import environment, process
from tests.faults.judge import Outcome
from tests.faults.pool import Part

ENVIRONMENTS: Mapping[str, Mapping[str, str | None]] = {
    "ASCII terminal": {"PYTHONIOENCODING": "ascii", "LC_ALL": "C", "PYTHONUTF8": "0"},
    "Latin-1 terminal": {"PYTHONIOENCODING": "latin-1"},
    "C locale": {"LC_ALL": "C", "LANG": None, "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    "no home": {"HOME": None, "XDG_CACHE_HOME": None},
    "home that is a file": {"HOME": "/dev/null", "XDG_CACHE_HOME": None},
    "dumb terminal": {"TERM": "dumb"},
    "terminal of one column": {"COLUMNS": "1", "LINES": "1"},
    "terminal of zero columns": {"COLUMNS": "0"},
    "forced colours": {"FORCE_COLOR": "1", "COLUMNS": "80"},
    "no temporary folder": {"TMPDIR": "/nowhere"},
    "other backend": {"MPLBACKEND": "TkAgg", "DISPLAY": None},
    "other time zone": {"TZ": "Mars/Olympus"},
    "optimised": {"PYTHONOPTIMIZE": "2"},
    "warnings as errors off": {"PYTHONWARNINGS": "default"},
}
"""Environments by name: variables that are set, or taken away where they are None."""
LIMITS: Mapping[str, tuple[int, Sequence[int]]] = {
    "address space": (resource.RLIMIT_AS, tuple(int(g * (1 << 30)) for g in (1, 1.5, 2, 3, 4, 6))),
    "descriptors": (resource.RLIMIT_NOFILE, (12, 16, 24, 32, 48, 64)),
    "processes": (resource.RLIMIT_NPROC, (1, 8)),
}
"""Limits of the system, and the values that are tried."""
STREAMS = ("head -1", "closed stdout", "closed stderr", "full stdout", "no streams")


def plan(inputs: int, kills: int) -> dict[str, int]:
    """Return how many cases there are: each command once, or as often as there are limits."""
    scale = min(1.0, inputs / 20_000)
    counts = dict.fromkeys(ENVIRONMENTS, len(COMMANDS)) | dict.fromkeys(STREAMS, len(COMMANDS))
    counts |= {name: len(values) * len(COMMANDS) for name, (_, values) in LIMITS.items()}
    return {name: max(1, round(scale * n)) for name, n in counts.items()}


def run(kind: str, rng: random.Random, folder: Path) -> tuple[Outcome, Sequence[int]]:
    """Run a command there."""
    work = folder / "work"
    files.lay_out(work)
    command = rng.choice(list(COMMANDS))
    argv = argv_of(command, "out")
    if kind in STREAMS:
        return _odd_streams(kind, command, argv, work)
    if kind in ENVIRONMENTS:
        out = process(f"{command}, {kind}", argv, work, env=environment(**ENVIRONMENTS[kind]))
        if kind == "forced colours":
            out.stdout = out.stderr = ""  # colours are what is asked for
        return out, (0,)
    number, values = LIMITS[kind]
    value = rng.choice(values)

    def limit() -> None:
        resource.setrlimit(number, (value, value))

    what = f"{command}, {kind} {value if value < 1 << 20 else f'{value / (1 << 30):g} GiB'}"
    return process(what, argv, work, before_it=limit), (0, 1)


def _odd_streams(kind: str, command: str, argv: list[str], work: Path) -> tuple[Outcome, Sequence[int]]:
    close: dict[str, Callable[[], None]] = {
        "closed stdout": lambda: os.close(1),
        "closed stderr": lambda: os.close(2),
        "no streams": lambda: (os.close(0), os.close(1), os.close(2)) and None,
    }
    if kind == "head -1":
        reading, writing = os.pipe()
        with subprocess.Popen(["head", "-1"], stdin=reading, stdout=subprocess.DEVNULL):
            os.close(reading)
            out = process(f"{command} | head -1", argv, work, stdout=writing)
            os.close(writing)
        return out, (0, 1, 141)
    if kind == "full stdout":
        with open("/dev/full", "w") as full:
            return process(f"{command} > /dev/full", argv, work, stdout=full), (1,)
    out = process(f"{command}, {kind}", argv, work, before_it=close[kind])
    if kind != "closed stdout" and out.status and not out.stderr:
        out.stderr = "error: nobody could hear it"
    return out, (0, 1)


PART = Part(plan, run, patience=600.0)
