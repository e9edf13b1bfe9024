"""Disks that are full, read-only, or gone while a program runs: one line, status 1 or 2, and what is there is whole."""

from __future__ import annotations

import atexit
import functools
import os
import random
import resource
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from tests.faults import files
from tests.faults.doors import NOBODY, environment, process
from tests.faults.judge import Outcome
from tests.faults.pool import Part

COMMANDS: Mapping[str, str] = {
    "compare": "compare traj4 --plants improved --reference improved",
    "track": "track pid line --speed 0.5",
    "fit": "fit linear --to traj4@linear --population 8 --generations 3",
    "tune": "tune pid --reference line@0.5 --held-out line@1 --population 8 --generations 2",
    "recordings convert": "recordings convert good.csv",
    "study filter": "study filter --references line --speed 0.5 --profiles thesis-lab --frictions 0.5 --seeds 1 "
    "--timestep 0.005",
    "replicate": "replicate --quick --only 3.12",
}
_LIMITS = (0, 100, 2_000, 20_000, 100_000, 20_000_000)
PLACES = ("full", "full tmpfs", "nowhere", "read-only", "vanishing", "becomes read-only")


def plan(inputs: int, kills: int) -> dict[str, int]:
    """Return how many cases there are: each place with each command, and each size of a full disk."""
    scale = min(1.0, inputs / 20_000)
    counts = {"full": len(_LIMITS), "full tmpfs": 2, "nowhere": 3, "read-only": 1, "vanishing": 4, "becomes read-only": 2}
    return {f"{place}: {name}": max(1, round(scale * counts[place])) for place in PLACES for name in COMMANDS}


def argv_of(command: str, out: Path | str) -> list[str]:
    """Return the command line that writes into a folder."""
    name, *rest = COMMANDS[command].split()
    return [f"validation.{name}", *rest, "--out", f"{out}/made.csv" if name == "recordings" else str(out)]


def run(kind: str, rng: random.Random, folder: Path) -> tuple[Outcome, Sequence[int]]:
    """Run a command where it cannot write, or cannot go on writing."""
    place, _, command = kind.partition(": ")
    work = folder / "work"
    files.lay_out(work)
    return {
        "full": _full, "full tmpfs": _full_tmpfs, "nowhere": _nowhere, "read-only": _read_only, "vanishing": _vanishing,
        "becomes read-only": _vanishing,
    }[place](place, command, rng, work)  # fmt: skip


def _full(place: str, command: str, rng: random.Random, work: Path) -> tuple[Outcome, Sequence[int]]:
    most = rng.choice(_LIMITS)

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    env = environment(XDG_CACHE_HOME=str(work.parent / "no-cache"))  # what libraries keep there is theirs to mend
    out = process(f"{command}, files of at most {most} bytes", argv_of(command, "out"), work, env=env, before_it=limit)
    return only(out, work / "out"), (0, 1, 2)


def _full_tmpfs(place: str, command: str, rng: random.Random, work: Path) -> tuple[Outcome, Sequence[int]]:
    small = work / "small"
    small.mkdir()
    size = rng.choice((16, 64, 256))
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}k", "tmpfs", small], capture_output=True, check=False
    )
    if mounted.returncode:
        return Outcome("not allowed to mount"), (0,)
    try:
        out = process(f"{command}, a disk of {size} kB", argv_of(command, small / "out"), work)
        out.folder = work / "kept"  # what is judged is what the disk has
        shutil.copytree(small, out.folder)
        out.before, out.stdout = frozenset(), out.stdout.replace(f"{small}/", "")
    finally:
        subprocess.run(["umount", small], check=True)
    return out, (0, 1, 2)


def _nowhere(place: str, command: str, rng: random.Random, work: Path) -> tuple[Outcome, Sequence[int]]:
    target = rng.choice((work / "good.csv" / "deeper", Path("/proc/nowhere"), Path("/dev/null/x"), Path("/sys/nowhere")))
    return process(f"{command} into {target}", argv_of(command, target), work), (1, 2)


def _read_only(place: str, command: str, rng: random.Random, work: Path) -> tuple[Outcome, Sequence[int]]:
    (work / "out").mkdir(mode=0o555)
    _opened(work)
    env = environment(HOME=str(_home()), XDG_CACHE_HOME=None)
    out = process(f"{command}, as nobody", argv_of(command, "out"), work, env=env, as_nobody=True)
    return only(out, work / "out"), (1, 2)


def _vanishing(place: str, command: str, rng: random.Random, work: Path) -> tuple[Outcome, Sequence[int]]:
    target = work / "out"
    target.mkdir(mode=0o777)
    target.chmod(0o777)
    _opened(work)
    delay = rng.uniform(0.3, 6.0)
    env = environment(HOME=str(_home()), XDG_CACHE_HOME=None)

    def meanwhile(running: subprocess.Popen[bytes]) -> None:
        until = time.monotonic() + delay
        while time.monotonic() < until and running.poll() is None:
            time.sleep(0.02)
        if place == "vanishing":
            shutil.rmtree(target, ignore_errors=True)
        else:
            target.chmod(0o555)

    out = process(
        f"{command}, {place} after {delay:.2f} s", argv_of(command, "out"), work, env=env, as_nobody=True,
        meanwhile=meanwhile,
    )  # fmt: skip
    target.is_dir() and target.chmod(0o777)
    if place == "vanishing" and out.status == 0 and not target.is_dir():
        out.stdout = ""  # it had ended, or made the folder anew; what it claimed was true when it said so
    return only(out, target), (0, 1, 2)


@functools.cache
def _home() -> Path:
    """Return the home of nobody, where compiled code is kept from one case to the next."""
    home = Path(tempfile.mkdtemp(prefix="ssmr-faults-home-"))
    atexit.register(shutil.rmtree, home, ignore_errors=True)
    if os.getuid() == 0:
        os.chown(home, NOBODY, NOBODY)
    return home


def _opened(work: Path) -> None:
    for path in (work.parent, work):
        path.chmod(0o755)


def only(out: Outcome, target: Path) -> Outcome:
    """Judge the target alone; what else lies around was there before."""
    before = {name for name in out.before if name.startswith(f"{target.name}/")}
    if target.is_dir():
        out.before = frozenset(name.removeprefix(f"{target.name}/") for name in before)
        out.stdout = out.stdout.replace(f"{target.name}/", "")
        out.folder = target
    return out


PART = Part(plan, run, patience=600.0)
