"""Files: valid ones of every kind that is read, damaged in many ways, through their readers and through whole programs."""

from __future__ import annotations

import csv
import functools
import io
import os
import random
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from tests.faults.damage import damaged, hostile_table
from tests.faults.doors import call, program
from tests.faults.judge import USUAL as STATUSES
from tests.faults.judge import Outcome, visible
from tests.faults.pool import Part


def open_log(path: Path) -> Any:
    """Read a log as a user's command does."""
    from validation.motion import sources

    return sources.open_source(str(path))


def read_way(path: Path) -> Any:
    """Read waypoints."""
    from validation.bench import waypoint_files

    return waypoint_files.read_waypoints(path, 0.25)


def read_profile(path: Path) -> Any:
    """Read a profile."""
    from validation.plants import profile

    return profile.load_profile(str(path))


def read_gains(law: str, path: Path) -> Any:
    """Read gains."""
    from validation.bench import gains

    return gains.load_gains(law, str(path))


def read_search(path: Path) -> Any:
    """Read the checkpoint of a search."""
    from validation.fit import search

    return search.Search.load(path, {"what": "a small one"})[0].jde.best_cost


@dataclass(frozen=True)
class Kind:
    """A kind of file."""

    name: str
    """Name of a good one in the folder of `templates`; a folder is damaged in one of its files."""
    share: float
    """Share of all files."""
    read: Callable[[Path], Any]
    """Reader, as a program calls it."""
    programs: tuple[str, ...] = ()
    """Commands that read it, with FILE for its path."""
    table: bool = False
    """Whether it is a table of text, which can be well formed and yet mean what nobody meant."""


_LOG = (
    "recordings info FILE",
    "recordings info FILE",
    "recordings convert FILE --out made.csv",
    "recordings convert FILE --out made.mcap",
    "recordings convert FILE --out made.bag --until 2",
    "recordings convert FILE --out made.tum --rate 20",
    "compare FILE --plants kinematic --horizons 1,2 --no-rerun",
    "fit linear --to FILE --population 8 --generations 1 --horizons 1",
)
_TINY = " --population 8 --generations 2"
_WAY = ("track pid FILE --plant kinematic --no-rerun", "track smc FILE --plant kinematic --no-rerun --speed 0.5")
_PROFILE = (
    "compare traj4 --profile FILE --plants kinematic,improved,linear,coulomb --reference improved --no-rerun",
    "track lqr line --speed 0.5 --profile FILE --no-rerun",
)
KINDS: Mapping[str, Kind] = {
    "recording, CSV": Kind("good.csv", 0.22, open_log, _LOG, table=True),
    "ROS 1 bag": Kind("good.bag", 0.12, open_log, _LOG),
    "MCAP": Kind("good.mcap", 0.12, open_log, _LOG),
    "ROS 2 folder, MCAP": Kind("ros2-mcap", 0.06, open_log, _LOG),
    "ROS 2 folder, sqlite": Kind("ros2-sqlite", 0.06, open_log, _LOG),
    "waypoints, CSV": Kind("way.csv", 0.10, read_way, _WAY, table=True),
    "profile, thesis-lab": Kind("good.toml", 0.08, read_profile, _PROFILE),
    "profile, husky-tile": Kind("husky.toml", 0.06, read_profile, _PROFILE),
    "gains, pid": Kind("pid.toml", 0.04, partial(read_gains, "pid"), ("track pid line --speed 1 --gains FILE --no-rerun",)),
    "gains, smc": Kind("smc.toml", 0.04, partial(read_gains, "smc"), ("track smc line --speed 1 --gains FILE --no-rerun",)),
    "checkpoint": Kind("checkpoint.npz", 0.05, read_search, ("fit linear --to traj4@linear --resume --out DIR" + _TINY,)),
}  # fmt: skip
_WHOLE = 0.25  # of the files go through a whole program


@functools.cache
def templates() -> Path:
    """Return a folder with a good file of each kind; it is made once in each process."""
    from tests.faults import makers

    folder = Path(tempfile.mkdtemp(prefix="ssmr-faults-good-"))
    makers.make_all(folder)
    import atexit

    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def lay_out(folder: Path) -> None:
    """Put good files, and things that are no files, where a command line may name them."""
    folder.mkdir(parents=True)
    for name in ("good.csv", "up.csv", "grass.csv", "way.csv", "good.toml", "good.bag", "good.mcap"):
        shutil.copy(templates() / name, folder)
    (folder / "empty.csv").touch()
    (folder / "folder.csv").mkdir()
    for suffix in ("csv", "toml"):
        os.mkfifo(folder / f"pipe.{suffix}")
        (folder / f"zero.{suffix}").symlink_to("/dev/zero")
    (folder / "loop.csv").symlink_to("loop.csv")
    (folder / "deep.toml").write_text("a = " + "[" * 3000 + "]" * 3000)
    for name in ("red \x1b[31m.csv", "\udcff.csv", "x].csv"):
        shutil.copy(templates() / "good.csv", folder / name)
    (folder / "[").mkdir()
    shutil.copy(templates() / "good.csv", folder / "[" / "x].csv")


def plan(inputs: int, kills: int) -> dict[str, int]:
    """Return how many files of each kind there are: two fifths of all inputs."""
    return {name: max(1, round(0.42 * inputs * kind.share)) for name, kind in KINDS.items()}


def _damage(path: Path, kind: Kind, rng: random.Random) -> None:
    target = rng.choice(sorted(p for p in path.rglob("*") if p.is_file())) if path.is_dir() else path
    data = target.read_bytes()
    if kind.table and rng.random() < 0.5:
        rows = hostile_table(list(csv.reader(io.StringIO(data.decode()))), rng)
        text = io.StringIO()
        csv.writer(text).writerows(rows)
        target.write_bytes(text.getvalue().encode("utf-8", "surrogateescape"))
    else:
        target.write_bytes(damaged(data, rng))


def run(name: str, rng: random.Random, folder: Path) -> tuple[Outcome, Sequence[int]]:
    """Damage a file, and let a reader or a program have it."""
    kind = KINDS[name]
    good, path = templates() / kind.name, folder / kind.name
    shutil.copytree(good, path) if good.is_dir() else shutil.copy(good, path)
    _damage(path, kind, rng)
    if rng.random() > _WHOLE:
        return call(f"read {kind.name}", lambda: kind.read(path)), STATUSES
    command = rng.choice(kind.programs).replace("FILE", kind.name).replace("DIR", ".")
    who, *argv = command.split()
    out = program(visible(command), who, argv, folder)
    out.foreign += "nan inf" if kind.name.endswith(".csv") else ""  # names of columns that are nasty words
    return out, STATUSES


PART = Part(plan, run)
