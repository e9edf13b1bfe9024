"""Two runs at once in one folder: both end well, and each file is whole, from one of both."""

from __future__ import annotations

import random
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from tests.faults import files
from tests.faults.doors import environment, process
from tests.faults.judge import Outcome
from tests.faults.kills import result_of
from tests.faults.pool import Part

COMMANDS: Mapping[str, str] = {
    "track": "track pid line --speed 0.5",
    "compare": "compare traj4 --plants improved --reference improved --disturbance",
    "fit": "fit linear --to traj4@improved --population 8 --generations 4",
    "tune": "tune pid --reference line@0.5 --held-out line@1 --population 8 --generations 2",
    "replicate": "replicate --quick --only 3.12",
}


def plan(inputs: int, kills: int) -> dict[str, int]:
    """Return how many pairs there are."""
    return dict.fromkeys(COMMANDS, max(1, kills // 50))


def run(command: str, rng: random.Random, folder: Path) -> tuple[Outcome, Sequence[int]]:
    """Run two seeds alone, then both at once in one folder."""
    work = folder / "work"
    files.lay_out(work)
    seeds = rng.sample(range(100), 2)
    name, *rest = COMMANDS[command].split()
    argv = {s: [f"validation.{name}", *rest, "--seed", str(s)] for s in seeds}
    alone = {}
    for s in seeds:
        done = process(f"{command}, seed {s} alone", [*argv[s], "--out", f"alone{s}"], work)
        if done.status:
            return done, (0,)
        alone[s] = result_of(work / f"alone{s}")
    shutil.rmtree(work / "both", ignore_errors=True)
    other = subprocess.Popen(
        [sys.executable, "-m", *argv[seeds[1]], "--out", "both"], cwd=work, env=environment(), stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )  # fmt: skip
    out = process(f"{command}, seeds {seeds} at once", [*argv[seeds[0]], "--out", "both"], work)
    out.stderr += other.communicate(timeout=300.0)[1].decode()
    out.status = out.status or other.returncode
    out.folder, out.before, out.stdout = work / "both", frozenset(), ""
    for file, value in result_of(work / "both").items():
        if value not in (alone[seeds[0]].get(file), alone[seeds[1]].get(file)):
            out.fault("damaged file", f"{file} is neither run's")
    return out, (0,)


PART = Part(plan, run, patience=900.0)
