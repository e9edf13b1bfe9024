"""Kills at events of the file system and in the middle of writes, then the same program again, beside an undisturbed run.

`SIGKILL` comes just before a file is opened for writing, renamed or removed, or a folder made: at an event that is drawn
from all those of an undisturbed run. Or the process dies where a file that it writes passes a size that is drawn.
"""

from __future__ import annotations

import functools
import json
import random
import signal
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.faults import files
from tests.faults.doors import environment, process
from tests.faults.judge import Outcome, why_damaged
from tests.faults.pool import Part

MOST_KILLS = 3
"""Kills of one story, before the program may end."""


@dataclass(frozen=True)
class Story:
    """A program that is killed: its command line, how it is resumed, and its share of the kills."""

    argv: str
    share: float
    resume: str = ""


STORIES: Mapping[str, Story] = {
    "fit": Story("fit linear --to traj4@linear --population 8 --generations 12", 0.2, "--resume"),
    "fit a recording": Story("fit kinematic --to good.csv --horizons 1,2 --population 8 --generations 10", 0.12, "--resume"),
    "tune": Story("tune pid --reference line@0.5 --held-out line@1 --population 8 --generations 8", 0.2, "--resume"),
    "replicate": Story("replicate --quick --only 3.12,accelerations", 0.2),
    "compare": Story("compare traj4 --plants improved --reference improved", 0.08),
    "track": Story("track pid line --speed 0.5", 0.08),
    "study filter": Story(
        "study filter --references line --speed 0.5 --profiles thesis-lab --frictions 0.5 --seeds 1 --timestep 0.005", 0.06
    ),
    "recordings convert": Story("recordings convert good.csv", 0.06),
}
OF_THE_CLOCK = (
    "wall_s",
    "versions",
    "seconds",
    "real_time",
    "cpu",
    "date",
    "made",
    "effort",
    "evaluations_per",
    "rate_hz",
    "content",
)
"""Keys of a result that no two runs share; `content` is the digest of a section with its times."""


def plan(inputs: int, kills: int) -> dict[str, int]:
    """Return how many stories there are: each has two kills on average."""
    return {name: max(1, round(0.5 * kills * story.share)) for name, story in STORIES.items()}


def result_of(folder: Path) -> dict[str, Any]:
    """Return the results in a folder but for what the clock decides, by file; pictures and recordings are there or not."""

    def strip(value: Any) -> Any:
        if isinstance(value, dict):
            return {k: strip(v) for k, v in value.items() if not any(word in k for word in OF_THE_CLOCK)}
        return [strip(v) for v in value] if isinstance(value, list) else value

    found: dict[str, Any] = {}
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        name = str(path.relative_to(folder))
        if path.suffix == ".json":
            found[name] = strip(json.loads(path.read_text()))
        elif path.suffix in (".toml", ".csv", ".tum"):
            found[name] = [line for line in path.read_text().splitlines() if not line.startswith("#")]
        elif path.suffix != ".npz":
            found[name] = "is there"
    return found


def argv_of(story: Story, out: str) -> list[str]:
    """Return the command line that writes into a folder."""
    name, *rest = story.argv.split()
    return [f"validation.{name}", *rest, "--out", f"{out}/made.csv" if name == "recordings" else out]


@functools.cache
def undisturbed(name: str) -> tuple[dict[str, Any], int, int]:
    """Return the results of an undisturbed run, the number of its events, and the size of its largest file [bytes]."""
    with tempfile.TemporaryDirectory(prefix="ssmr-faults-calm-") as place:
        work, counted = Path(place) / "work", Path(place) / "count"
        files.lay_out(work)
        (work / "calm").mkdir()
        env = environment(hooked=True, SSMR_FAULTS_ROOT=str(work), SSMR_FAULTS_COUNT=str(counted))
        done = process(name, argv_of(STORIES[name], "calm"), work, env=env, timeout=900.0)
        if done.status:
            raise RuntimeError(f"{name}, undisturbed: status {done.status}: {done.stderr[-300:]}")
        sizes = [p.stat().st_size for p in (work / "calm").rglob("*") if p.is_file()]
        return result_of(work / "calm"), int(counted.read_text()), max(sizes)


def run(name: str, rng: random.Random, folder: Path) -> tuple[Outcome, Sequence[int]]:
    """Kill a program up to three times, let it end, and compare."""
    story, work = STORIES[name], folder / "work"
    wanted, events, largest = undisturbed(name)
    files.lay_out(work)
    (work / "rough").mkdir()
    seen, kills, told = [], 0, []
    for attempt in range(MOST_KILLS + 1):
        argv = argv_of(story, "rough") + (story.resume.split() if attempt else [])
        env = environment()
        if attempt < rng.randint(1, MOST_KILLS):
            env = environment(hooked=True, SSMR_FAULTS_ROOT=str(work))
            if rng.random() < 0.75:
                env["SSMR_FAULTS_KILL"] = str(rng.randint(1, events))
            else:
                env["SSMR_FAULTS_CUT"] = str(rng.randrange(largest))
            told.append(env.get("SSMR_FAULTS_KILL", "in " + env.get("SSMR_FAULTS_CUT", "")))
        out = process("", argv, work, env=env, timeout=600.0)
        if out.status not in (-signal.SIGKILL, -signal.SIGXFSZ):
            break
        kills += 1
        for path in (work / "rough").rglob("*"):
            if path.is_file() and ".part" not in path.name and (why := why_damaged(path)):
                seen.append(("damaged file", f"after kill {kills}: {path.name}: {why}"))
    out.what, out.weight = f"{story.argv}, killed at {', '.join(told)}", max(kills, 1)
    out.folder, out.before, out.stdout = work / "rough", frozenset(), out.stdout.replace("rough/", "")
    out.faults += seen
    if out.status == 0:
        found = result_of(work / "rough")
        if found != wanted:
            names = [n for n in wanted.keys() | found.keys() if wanted.get(n) != found.get(n)]
            out.fault("differs", f"from the undisturbed result: {', '.join(sorted(names))}")
    return out, (0,)


PART = Part(plan, run, patience=3000.0)
