"""The fault campaign, `python -m tests.faults [PART ...]`: what users and machines do wrong, by the ten thousand.

Parts:

- `files`: valid files of every kind that is read, damaged in many ways, through their readers;
- `numbers`: every constructor of the project that takes numbers, and every plant, with NaN, infinite, huge, tiny, zero and
  negative ones;
- `writes`: programs that write to a full disk, or where nothing can be written;
- `kills`: fits, tunings and replications that are killed at random moments, again and again, then resumed to the end, beside
  an undisturbed run.

What is wanted: a value that is finite throughout, or one clear line; never a traceback for a user, a file half-written, or a
number that is not finite in a result. It ends with status 1 if there was anything else, and writes what it counted.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from ssmr.errors import SsmrError
from ssmr.types import Commands, State
from validation import store

ROOT = Path(__file__).resolve().parents[1]
LONGEST_LINE = 700
"""Of an error message: a list of names is long, an array that is printed whole is longer."""
LONGEST_READ = 20.0
"""A reader that takes longer over one small file hangs [s]."""


@dataclasses.dataclass
class Tally:
    """What came of one kind of input."""

    inputs: int = 0
    accepted: int = 0
    refused: int = 0
    faults: list[str] = dataclasses.field(default_factory=list)

    def fault(self, text: str) -> None:
        """Note what should not have been."""
        self.faults.append(" ".join(text.split())[:300])


# --- damage ---

NASTY = (
    b"nan", b"inf", b"-inf", b"1e308", b"-1e400", b"1e-320", b"0", b"-0", b"", b"\x00", b"\xff\xfe", "ü–".encode(),
    b"9" * 400, b"true", b"[]", b"{}", b"'", b'"', b"\\", b",", b"=", b"#", b"\r", b"0x1F", b"1_000", b"- 1", b"None",
    b"<a>", b"[red]",
)  # fmt: skip


def damaged(data: bytes, rng: random.Random) -> bytes:
    """The same with one to four things wrong."""
    out = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(out) + 1)
        span = min(len(out) - at, rng.choice((1, 4, 16, 64, 512)))
        kind = rng.randrange(9)
        if kind == 0 and span:
            out[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            del out[at:]
        elif kind == 2:
            del out[at : at + span]
        elif kind == 3:
            out[at:at] = rng.randbytes(span)
        elif kind == 4:
            out[at : at + span] = rng.randbytes(span)
        elif kind == 5:
            out[at:at] = out[at : at + span]
        else:  # a word, a number or a field by something else
            words = [i for i, byte in enumerate(out) if byte in b" ,=\n:"]
            if words:
                start = rng.choice(words) + 1
                end = next((i for i in words if i >= start), len(out))
                out[start:end] = rng.choice(NASTY)
    return bytes(out)


def finite(value: Any, depth: int = 0) -> bool:
    """Whether all numbers in a value are finite, or a limit that is off (infinite by design in dataclasses)."""
    if isinstance(value, np.ndarray):
        return value.dtype.kind not in "fc" or bool(np.isfinite(value).all())
    if isinstance(value, float):
        return not math.isnan(value)
    if depth > 4:
        return True
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return all(finite(getattr(value, f.name), depth + 1) for f in dataclasses.fields(value))
    if isinstance(value, dict):
        return all(finite(v, depth + 1) for v in value.values())
    if isinstance(value, tuple | list):
        return all(finite(v, depth + 1) for v in value[:1000])
    return True


def try_once(tally: Tally, what: str, call: Callable[[], Any]) -> None:
    """Call; a finite value or a `ValueError` or `SsmrError` of one line is right."""
    tally.inputs += 1
    began = time.perf_counter()
    try:
        value = call()
    except (ValueError, SsmrError) as error:
        text = str(error)
        if not text.strip() or "\n" in text.strip() or len(text) > LONGEST_LINE:
            tally.fault(f"{what}: no clear line: {type(error).__name__} {text!r}")
        else:
            tally.refused += 1
    except Exception as error:  # noqa: BLE001 - whatever else is raised is what is looked for
        tally.fault(f"{what}: {type(error).__name__}: {error}")
    else:
        if finite(value):
            tally.accepted += 1
        else:
            tally.fault(f"{what}: a number that is not finite was let through")
    if time.perf_counter() - began > LONGEST_READ:
        tally.fault(f"{what}: took {time.perf_counter() - began:.0f} s")


# --- files ---


def good_files(folder: Path) -> dict[str, tuple[Path, Callable[[Path], Any], float]]:
    """A valid file of each kind, what reads it, and which share of the inputs it gets."""
    from validation.fit import search
    from validation.logs.bag_writer import write_bag
    from validation.logs.groups import groups_of
    from validation.logs.recording import Recording
    from validation.logs.recording_csv import write_csv
    from validation.motion import sources
    from validation.plants import profile as profiles
    from validation.track import gains, waypoint_files

    t = np.arange(0.0, 4.0, 0.04)
    yaw = 0.3 * t
    columns = {
        "t": t, "cmd_v": np.full_like(t, 0.5), "cmd_w": np.full_like(t, 0.3), "enc_left": 3.0 + 0 * t,
        "enc_right": 3.5 + 0 * t,
        "gyro_z": np.full_like(t, 0.3), "x": np.sin(yaw) / 0.6, "y": (1 - np.cos(yaw)) / 0.6, "yaw": yaw,
    }  # fmt: skip
    recording = Recording.from_columns("good", columns)
    made: dict[str, tuple[Path, Callable[[Path], Any], float]] = {}

    def add(name: str, suffix: str, write: Callable[[Path], object], read: Callable[[Path], Any], share: float) -> None:
        path = folder / f"{name}{suffix}"
        write(path)
        made[name] = (path, read, share)

    drive = lambda p: sources.open_source(str(p))  # noqa: E731 - what a user's command does with the path
    add("recording", ".csv", lambda p: write_csv(recording, p), drive, 0.25)
    groups = groups_of(recording, "good")
    for suffix in (".bag", ".mcap"):
        add(f"bag{suffix}", suffix, lambda p: write_bag(groups, p), drive, 0.10)
    rows = "x,y,t\n" + "".join(f"{0.1 * i},{0.02 * i * i},{0.4 * i}\n" for i in range(20))
    add("waypoints", ".csv", lambda p: p.write_text(rows), lambda p: waypoint_files.read_waypoints(p), 0.15)
    add("sheet", ".xlsx", _write_sheet, lambda p: waypoint_files.read_waypoints(p, 0.25), 0.05)
    shipped = ROOT / "validation"
    for name in ("thesis-lab", "husky-tile"):
        source = shipped / "plants" / "profiles" / f"{name}.toml"
        add(f"profile {name}", ".toml", lambda p, s=source: shutil.copy(s, p), lambda p: profiles.load_profile(str(p)), 0.10)
    for name in ("pid-tuned", "smc-tuned"):
        source = shipped / "track" / "gain_sets" / f"{name}.toml"
        law = name.partition("-")[0]
        read = lambda p, law=law: gains.load_gains(law, str(p))  # noqa: E731
        add(f"gains {name}", ".toml", lambda p, s=source: shutil.copy(s, p), read, 0.05)
    kept = _small_search()
    add("checkpoint", ".npz", kept.save, lambda p: search.Search.load(p, kept.identity)[0].jde.best_cost, 0.05)
    return made


def _write_sheet(path: Path) -> None:
    import openpyxl

    book = openpyxl.Workbook()
    for row in [("x", "y"), *((0.1 * i, 0.2 * i) for i in range(10))]:
        book.active.append(row)
    book.save(path)


def _small_search() -> Any:
    from ssmr.search.jde import Jde, JdeSettings
    from validation.fit.search import Search

    jde = Jde(3, JdeSettings(population=8), seed=0)
    search = Search(jde, {"what": "a small one"})
    for _ in range(3):
        jde.tell(np.sum((jde.ask() - 0.3) ** 2, axis=1))
        search.remember()
    return search


def campaign_files(count: int, seed: int) -> dict[str, Tally]:
    """Damaged files through their readers."""
    rng, out = random.Random(seed), {}
    with tempfile.TemporaryDirectory() as folder:
        for name, (path, read, share) in good_files(Path(folder)).items():
            tally = out[f"{name}"] = Tally()
            data = path.read_bytes()
            read(path)  # a good one is read
            for k in range(max(1, round(share * count))):
                path.write_bytes(damaged(data, rng))
                try_once(tally, f"{name}, seed {seed}, input {k}", partial(read, path))
    return out


# --- numbers ---

EXTREMES = (
    math.nan, math.inf, -math.inf, 0.0, -0.0, 1e308, -1e308, 1e-308, 5e-324, -1.0, 1e6, -1e6, 1e15, 1e-15, 1.0, 0.5, 2.0,
)  # fmt: skip
WHOLE_EXTREMES = (0, -1, 1, 2, -(2**31), 2**31, 2**63, -(2**63), 10**30)
"""For what counts something."""


def extremes(kind: type, rng: random.Random, most: int) -> dict[str, Any]:
    """One to `most` of a dataclass' numbers by extreme ones."""
    fields = [f for f in dataclasses.fields(kind) if f.init and type(f.default) in (int, float)]
    chosen = rng.sample(fields, rng.randint(1, min(most, len(fields))))
    return {f.name: rng.choice(WHOLE_EXTREMES if type(f.default) is int else EXTREMES) for f in chosen}


def number_constructors() -> Iterator[tuple[str, type]]:
    """Every public dataclass of numbers whose fields all have defaults."""
    import importlib

    from tests.test_architecture import modules

    for name in sorted(modules()):
        if name == "validation.ros.port":
            continue
        module = importlib.import_module(name)
        for _, kind in inspect.getmembers(module, inspect.isclass):
            if kind.__module__ != name or not dataclasses.is_dataclass(kind) or kind.__name__.startswith("_"):
                continue
            fields = [f for f in dataclasses.fields(kind) if f.init]
            defaults = all(f.default is not dataclasses.MISSING for f in fields)
            if defaults and any(type(f.default) in (int, float) for f in fields) and "__post_init__" in vars(kind):
                yield f"{name}.{kind.__name__}", kind


def campaign_numbers(count: int, seed: int) -> dict[str, Tally]:
    """Constructors and arrays of numbers, then plants."""
    from ssmr.control.waypoints import Waypoints
    from ssmr.types import Trajectory
    from validation.robots.terrain import parse_terrain

    rng, out = random.Random(seed), {}
    kinds = list(number_constructors())
    each = max(1, count // (2 * len(kinds)))
    for name, kind in kinds:
        tally = out[name] = Tally()
        for k in range(each):
            values = extremes(kind, rng, 3)
            try_once(tally, f"{name} {values} input {k}", partial(kind, **values))
    arrays: dict[str, Callable[[np.ndarray], Any]] = {
        "Commands": lambda a: Commands(0.05, a[:, :2]),
        "Trajectory": lambda a: Trajectory(np.arange(len(a), dtype=float), a, a, a[:, :2]),
        "Waypoints": lambda a: Waypoints(a[:, 0], a[:, 1:3]),
    }
    for name, make in arrays.items():
        tally = out[f"arrays: {name}"] = Tally()
        for k in range(count // 20):
            table = np.cumsum(np.random.default_rng(rng.randrange(2**32)).random((rng.randint(1, 6), 3)), axis=0)
            for _ in range(rng.randint(1, 3)):
                table[rng.randrange(len(table)), rng.randrange(3)] = rng.choice(EXTREMES)
            try_once(tally, f"{name} input {k}", partial(make, table))
    words = [
        "flat",
        "ramp",
        "rough",
        "split",
        ":",
        "=",
        ",",
        "5",
        "nan",
        "1e9",
        "slope_deg",
        "seed",
        "-1",
        "height_mm",
        " ",
        "ü",
    ]
    tally = out["texts: --terrain"] = Tally()
    for k in range(count // 20):
        text = "".join(rng.choice(words) for _ in range(rng.randint(1, 7)))
        try_once(tally, f"terrain {text!r} input {k}", partial(parse_terrain, text))
    out |= campaign_plants(count // 10, rng)
    return out


def campaign_plants(count: int, rng: random.Random) -> dict[str, Tally]:
    """Every plant with extreme parameters, driven for a second: refused, failed with a word, or finite."""
    from validation.plants.profile import PLANTS, load_profile

    lab, out = load_profile("thesis-lab"), {}
    for name in PLANTS:
        tally = out[f"plant: {name}"] = Tally()
        section = lab.plants[name]
        for k in range(count // len(PLANTS)):
            part = rng.choice(("parameters", "parameters", "vehicle", "drive"))
            values = extremes(type(getattr(section, part)), rng, 2)

            try_once(tally, f"{name} {part} {values} input {k}", partial(_drive_changed, lab, name, part, values))
    return out


def _drive_changed(profile: Any, name: str, part: str, values: dict[str, Any]) -> Any:
    """A second of a plant with some numbers of its profile changed."""
    from validation.plants.profile import make_plant

    section = profile.plants[name]
    changed = dataclasses.replace(section, **{part: dataclasses.replace(getattr(section, part), **values)})
    other = dataclasses.replace(profile, plants={**profile.plants, name: changed})
    commands = Commands(0.05, np.tile([0.5, 0.4], (20, 1)))
    return make_plant(other, name).run(commands, State(), 0.05)


# --- writes ---


Done = subprocess.CompletedProcess[str]


def run_program(*argv: str, cwd: Path, file_limit: int | None = None, timeout: float = 300.0) -> Done:
    """A program as a user starts it; `file_limit`: the greatest file that it may write [bytes]."""

    def limit() -> None:
        import resource

        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (file_limit or 0, file_limit or 0))

    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, "-m", *argv], cwd=cwd, env=env, capture_output=True, text=True, timeout=timeout, check=False,
        preexec_fn=limit if file_limit is not None else None,
    )  # fmt: skip


PROGRAMS = (
    ("validation.compare", "traj4", "--plants", "improved", "--reference", "improved"),
    ("validation.track", "pid", "line"),
    ("validation.fit", "linear", "--to", "traj4@linear", "--population", "8", "--generations", "2"),
    ("validation.tune", "pid", "--reference", "line@0.5", "--population", "8", "--generations", "2"),
    ("validation.recordings", "convert", "traj4@improved"),
)
"""What is run where it cannot write."""


def campaign_writes() -> dict[str, Tally]:
    """A disk that is full after so many bytes, and folders that cannot be."""
    out = {}
    for program in PROGRAMS:
        name = program[0].removeprefix("validation.")
        single = name == "recordings"
        tally = out[f"full disk: {name}"] = Tally()
        for limit in (0, 2_000, 20_000, 100_000, 20_000_000):
            with tempfile.TemporaryDirectory() as folder:
                target = Path(folder) / ("out.csv" if single else "out")
                done = run_program(*program, "--out", str(target), cwd=Path(folder), file_limit=limit)
                _judge(tally, f"{name}, files of at most {limit} bytes", done, target, (0, 1, 2))
        tally = out[f"nowhere to write: {name}"] = Tally()
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / "file").write_text("in the way")
            places = [Path(folder) / "file" / "deeper", Path("/proc/nowhere"), Path("/dev/null/x")]
            for place in places:
                target = place / "out.csv" if single else place
                done = run_program(*program, "--out", str(target), cwd=Path(folder))
                _judge(tally, f"{name} into {place.name}", done, None, (1, 2))
    return out


def _judge(tally: Tally, what: str, done: Done, out: Path | None, allowed: tuple[int, ...]) -> None:
    """One clear line, no traceback, and no file that is damaged or left over."""
    tally.inputs += 1
    said = [line for line in done.stderr.splitlines() if line.strip()]
    left = [p for p in out.rglob("*") if ".part" in p.name] if out is not None and out.is_dir() else []
    broken = [p for p in out.rglob("*.json") if not _is_json(p)] if out is not None and out.is_dir() else []
    if "Traceback" in done.stderr or done.returncode not in allowed:
        tally.fault(f"{what}: status {done.returncode}: {said[-1] if said else 'nothing said'}")
    elif left or broken:
        tally.fault(f"{what}: left {[p.name for p in left + broken]}")
    elif done.returncode and not said:
        tally.fault(f"{what}: status {done.returncode} without a word")
    elif done.returncode:
        tally.refused += 1
    else:
        tally.accepted += 1


def _is_json(path: Path) -> bool:
    try:
        json.loads(path.read_text())
    except ValueError:
        return False
    return True


# --- kills ---

KILLED: dict[str, tuple[tuple[str, ...], tuple[str, ...], str]] = {
    "fit": (
        (
            "validation.fit",
            "linear",
            "--to",
            "traj4@improved",
            "--population",
            "16",
            "--generations",
            "60",
        ),
        ("--resume",),
        "fit.json",
    ),
    "tune": (
        ("validation.tune", "pid", "--reference", "line@0.5", "--population", "12", "--generations", "40"),
        ("--resume",),
        "tune.json",
    ),
    "replicate": (("validation.replicate", "--quick", "--only", "3.12,4.5,4.6"), (), "replicate.json"),
}
"""What is killed, how it is resumed, and what it leaves at its end."""
OF_THE_CLOCK = ("wall_s", "versions", "seconds", "real_time", "cpu", "date", "made")
"""Keys of a result that no two runs share."""


def outcome(path: Path) -> Any:
    """A result without what the clock decides."""

    def strip(value: Any) -> Any:
        if isinstance(value, dict):
            return {k: strip(v) for k, v in value.items() if not any(word in k for word in OF_THE_CLOCK)}
        return [strip(v) for v in value] if isinstance(value, list) else value

    return strip(json.loads(path.read_text()))


def campaign_kills(count: int, seed: int) -> dict[str, Tally]:
    """Kill, resume, kill, resume ... to the end; the result must be that of a run that nobody disturbed."""
    rng, out = random.Random(seed), {}
    for name, (program, resume, result) in KILLED.items():
        tally = out[f"killed: {name}"] = Tally()
        with tempfile.TemporaryDirectory() as folder:
            calm, rough = Path(folder) / "calm", Path(folder) / "rough"
            began = time.perf_counter()
            done = run_program(*program, "--out", str(calm), cwd=Path(folder), timeout=900.0)
            whole = time.perf_counter() - began
            if done.returncode:
                tally.fault(f"{name}, undisturbed: {done.stderr[-300:]}")
                continue
            wanted = outcome(calm / result)
            while tally.inputs < count // len(KILLED):
                shutil.rmtree(rough, ignore_errors=True)
                tally.inputs += _harass(tally, name, (program, resume), rough, whole, rng)
                if (rough / result).is_file() and outcome(rough / result) == wanted:
                    tally.accepted += 1
                else:
                    tally.fault(f"{name}: the resumed result differs from the undisturbed one, or is missing")
    return out


def _harass(
    tally: Tally, name: str, program: tuple[tuple[str, ...], tuple[str, ...]], out: Path, whole: float, rng: random.Random
) -> int:
    """Kill a program up to six times, then let it end; how often it was really killed."""
    env, kills = {**os.environ, "PYTHONPATH": str(ROOT)}, 0
    for attempt in range(7):
        argv = [sys.executable, "-m", *program[0], *(program[1] if attempt else ()), "--out", str(out)]
        process = subprocess.Popen(argv, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        try:
            process.wait(rng.uniform(0.3, 0.9) * whole if attempt < 6 else 900.0)
        except subprocess.TimeoutExpired:
            process.kill()
            kills += 1
        _, said = process.communicate()
        if "Traceback" in said:
            tally.fault(f"{name}, attempt {attempt}: {said[-300:]}")
        if process.returncode == 0:
            break
        if process.returncode not in (0, -signal.SIGKILL):
            tally.fault(f"{name}, attempt {attempt}: status {process.returncode}: {said[-200:]}")
            break
    return max(kills, 1)


# --- the whole ---

PARTS: dict[str, Callable[[int, int, int], dict[str, Tally]]] = {
    "files": lambda inputs, kills, seed: campaign_files(inputs * 7 // 10, seed),
    "numbers": lambda inputs, kills, seed: campaign_numbers(inputs * 3 // 5, seed),
    "writes": lambda inputs, kills, seed: campaign_writes(),
    "kills": lambda inputs, kills, seed: campaign_kills(kills, seed),
}


def main(
    parts: tyro.conf.Positional[tuple[str, ...]] = (),
    /,
    *,
    inputs: int = 10_000,
    kills: int = 60,
    seed: int = 0,
    out: Path = Path("runs/faults.json"),
) -> None:
    """Run the campaign.

    Args:
        parts: files, numbers, writes, kills; all if none is named.
        inputs: Files and numbers that are generated, at least.
        kills: How often a program is killed, at least.
        seed: Of everything that is random.
        out: Where the counts go.
    """
    document: dict[str, Any] = {"seed": seed, "versions": store.versions(), "parts": {}}
    failed = 0
    for part in parts or PARTS:
        began = time.perf_counter()
        for name, tally in PARTS[part](inputs, kills, seed).items():
            document["parts"].setdefault(part, {})[name] = dataclasses.asdict(tally)
            failed += len(tally.faults)
            print(f"{part:8s} {name:45s} {tally.inputs:6d} tried {tally.accepted:6d} good {tally.refused:6d} refused "
                  f"{len(tally.faults):4d} faults", flush=True)  # fmt: skip
            for fault in tally.faults[:5]:
                print(f"         {fault}", flush=True)
        document.setdefault("wall_s", {})[part] = round(time.perf_counter() - began, 1)
    out.parent.mkdir(parents=True, exist_ok=True)
    store.write_json(out, document)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    tyro.cli(main)
