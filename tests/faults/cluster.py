"""A fit over a dask cluster whose worker dies or whose scheduler vanishes: a line says how to go on; then the same end."""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from tests.faults import files
from tests.faults.doors import environment, process
from tests.faults.judge import Outcome
from tests.faults.kills import result_of
from tests.faults.pool import Part

FIT = ["validation.fit", "linear", "--to", "traj4@linear", "--population", "16", "--generations", "25"]
KINDS = ("one worker of two dies", "the only worker dies", "the scheduler vanishes", "all vanish")


def plan(inputs: int, kills: int) -> dict[str, int]:
    """Return how many cases there are; none without dask."""
    return dict.fromkeys(KINDS, max(1, kills // 50)) if importlib.util.find_spec("distributed") else {}


@functools.cache
def _undisturbed() -> Any:
    with tempfile.TemporaryDirectory(prefix="ssmr-faults-calm-") as place:
        files.lay_out(Path(place) / "work")
        process("undisturbed", [*FIT, "--out", "out"], Path(place) / "work")
        return _numbers(Path(place) / "work" / "out")


def _numbers(folder: Path) -> Any:
    found = result_of(folder)
    return found.get("profile.toml"), {k: found["fit.json"][k] for k in ("cost", "parameters", "evaluations", "generations")}


@contextlib.contextmanager
def _cluster(workers: int, place: Path) -> Iterator[tuple[str, subprocess.Popen[str], list[subprocess.Popen[str]]]]:
    """Start a scheduler and workers on this machine alone; yield the address and the processes."""
    started: list[subprocess.Popen[str]] = []

    def start(*argv: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-m", "distributed.cli." + argv[0], *argv[1:]], env=environment(), cwd=place, text=True,
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True,
        )  # fmt: skip
        started.append(process)
        return process

    try:
        scheduler = start("dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        assert scheduler.stderr is not None
        address = next(found[0] for line in scheduler.stderr if (found := re.search(r"tcp://[\d.:]+", line)))
        team = [
            start("dask_worker", address, "--host", "127.0.0.1", "--nthreads", "1", "--no-dashboard", "--no-nanny")
            for _ in range(workers)
        ]
        yield address, scheduler, team
    finally:
        for process in started:
            process.kill()
            process.communicate()


def run(kind: str, rng: random.Random, folder: Path) -> tuple[Outcome, Sequence[int]]:
    """Let the cluster lose a process in mid-fit, then resume without it."""
    work = folder / "work"
    files.lay_out(work)
    checkpoint = work / "out" / "checkpoint.npz"
    generations = rng.uniform(0.0, 2.0)
    with _cluster(2 if "two" in kind else 1, folder) as (address, scheduler, team):
        victims = {"the scheduler vanishes": [scheduler], "all vanish": [scheduler, *team]}.get(kind, team[:1])

        def meanwhile(running: subprocess.Popen[bytes]) -> None:
            until = time.monotonic() + 120.0
            while not checkpoint.is_file() and running.poll() is None and time.monotonic() < until:
                time.sleep(0.02)
            time.sleep(generations)
            for victim in victims:
                victim.send_signal(signal.SIGKILL)

        what = f"{kind} {generations:.1f} s after the first generation"
        out = process(what, [*FIT, "--scheduler", address, "--out", "out"], work, meanwhile=meanwhile, timeout=180.0)
    if out.status == 1 and "resume" not in out.stderr:
        out.fault("unclear line", f"nothing says how to go on: {out.stderr.strip()[-200:]}")
    if out.status != 0:
        again = process(what, [*FIT, "--resume", "--out", "out"], work)
        if again.status:
            out.fault("false status", f"resumed: {again.stderr}")
            return out, (0, 1)
    if _numbers(work / "out") != _undisturbed():
        out.fault("differs", "from the undisturbed result")
    out.folder = None if out.faults else work / "out"
    out.before, out.stdout = frozenset(), out.stdout.replace("out/", "")
    return out, (0, 1)


PART = Part(plan, run, patience=900.0)
