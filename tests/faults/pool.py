"""Cases over processes: what comes of a case does not depend on how many there are, nor on what ran before it."""

from __future__ import annotations

import dataclasses
import multiprocessing
import os
import random
import resource
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, NamedTuple

from tests.faults.judge import Outcome, Verdict, judge, visible

PARTS = (
    "usual",
    "arguments",
    "files",
    "numbers",
    "disks",
    "kills",
    "signals",
    "pairs",
    "surroundings",
    "strangers",
    "ros",
)
"""Modules of the campaign; each has a `PART`."""
_BATCH = 8
_RENEW = 600  # cases after which a process is replaced: what libraries keep for ever shall not decide later cases
_ADDRESS_SPACE = 16 << 30


class Case(NamedTuple):
    """One case; with the seed it decides everything."""

    part: str
    kind: str
    number: int

    def __str__(self) -> str:
        return f"{self.part}/{self.kind}/{self.number}"


@dataclasses.dataclass(frozen=True)
class Part:
    """A part of the campaign."""

    plan: Callable[[int, int], dict[str, int]]
    """Function of the inputs and the kills that are asked for: how many cases of each kind there are."""
    run: Callable[[str, random.Random, Path], tuple[Outcome, Sequence[int]]]
    """Function of kind, generator and empty folder: the outcome of one case, and the statuses that are allowed."""
    patience: float = 240.0
    """Time after which a case is given up from outside [s]."""


def part_of(name: str) -> Part:
    """Return a part by the name of its module."""
    found: Part = import_module(f"tests.faults.{name}").PART
    return found


def run_case(case: Case, seed: int) -> Verdict:
    """Return the verdict on a case, which gets a folder and a generator of its own."""
    rng = random.Random(f"{seed} {case}")
    folder = Path(tempfile.mkdtemp(prefix="ssmr-faults-"))
    try:
        outcome, allowed = part_of(case.part).run(case.kind, rng, folder)
        return judge(outcome, allowed)
    finally:
        for path in [folder, *folder.rglob("*")]:
            if path.is_dir() and not path.is_symlink():
                os.chmod(path, 0o700)
        shutil.rmtree(folder, ignore_errors=True)


def _work(pipe: Connection, seed: int) -> None:
    """Run batches of cases as they come, and send each verdict."""
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE, resource.RLIM_INFINITY))
    os.dup2(os.open(os.devnull, os.O_RDWR), 0)
    while (batch := pipe.recv()) is not None:
        for case in batch:
            try:
                pipe.send((case, run_case(case, seed)))
            except BaseException as error:
                fault = ("traceback", f"of the campaign itself: {type(error).__name__}: {error}")
                pipe.send((case, Verdict(visible(case), False, 1, (fault,))))
                if not isinstance(error, Exception):
                    raise


class _Worker:
    """A process, the cases it was given, and when it was last heard."""

    def __init__(self, seed: int) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(theirs, seed))
        self.process.start()
        theirs.close()
        self.cases: list[Case] = []
        self.done, self.heard = 0, time.monotonic()

    def give(self, batch: list[Case]) -> None:
        self.cases, self.heard = list(batch), time.monotonic()
        self.pipe.send(batch)

    def end(self) -> None:
        self.process.kill()
        self.process.join()
        self.pipe.close()


def run_cases(cases: Sequence[Case], seed: int, workers: int) -> Iterator[tuple[Case, Verdict]]:
    """Yield each case and its verdict as they come; 0 workers run them here, in order."""
    if not workers:
        yield from ((case, run_case(case, seed)) for case in cases)
        return
    left = list(reversed(cases))
    team = [_Worker(seed) for _ in range(min(workers, len(cases)))]
    try:
        while left or any(w.cases for w in team):
            _hand_out(team, left, seed)
            busy: dict[Any, _Worker] = {w.pipe: w for w in team if w.cases}
            for pipe in wait(list(busy), timeout=1.0):
                yield _next(team, busy[pipe], left, seed)
            for worker in [w for w in team if w.cases]:
                if time.monotonic() - worker.heard > part_of(worker.cases[0].part).patience:
                    yield _lost(team, worker, left, seed, "hang")
    finally:
        for worker in team:
            worker.end()


def _hand_out(team: list[_Worker], left: list[Case], seed: int) -> None:
    """Give cases to workers that have none; a worker that has done many is replaced."""
    for k, worker in enumerate(team):
        if not worker.cases and left:
            if worker.done > _RENEW:
                worker.end()
                team[k] = worker = _Worker(seed)
            size = _BATCH if len(left) > 4 * _BATCH * len(team) else 1
            worker.give([left.pop() for _ in range(min(size, len(left)))])


def _next(team: list[_Worker], worker: _Worker, left: list[Case], seed: int) -> tuple[Case, Verdict]:
    """Return what a worker has to say."""
    try:
        case, verdict = worker.pipe.recv()
    except (EOFError, OSError):
        return _lost(team, worker, left, seed, "died")
    worker.cases.remove(case)
    worker.done, worker.heard = worker.done + 1, time.monotonic()
    if "hang" in dict(verdict.faults):  # what was broken off may be in any state
        left.extend(reversed(worker.cases))
        worker.end()
        team[team.index(worker)] = _Worker(seed)
    return case, verdict


def _lost(team: list[_Worker], worker: _Worker, left: list[Case], seed: int, kind: str) -> tuple[Case, Verdict]:
    """Replace a worker, give its further cases to others, and return the verdict on the case that it was at."""
    worker.process.join(0.0 if kind == "hang" else 10.0)
    case, *rest = worker.cases
    why = f"the process ended with {worker.process.exitcode}" if kind == "died" else "the process did not answer any more"
    left.extend(reversed(rest))
    worker.end()
    team[team.index(worker)] = _Worker(seed)
    print(f"{case}: {why}", file=sys.stderr, flush=True)
    return case, Verdict(str(case), False, 1, ((kind, why),))
