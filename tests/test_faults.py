"""Mishaps of users, on every program: a clear line, the right status, whole files.

Mistyped options, files that are missing, empty, damaged or of another kind, folders and disks that
take nothing, and an end in mid-run.
"""

from __future__ import annotations

import itertools
import json
import random
import resource
import runpy
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.appendices import is_possible
from tests.drive_train_logs import in_the_air, on_grass
from validation.files.csv_logs import write_csv
from validation.plants.profile import load_profile

pytestmark = pytest.mark.filterwarnings("ignore")  # of libraries, on damaged files

SMALL = "--population 5 --generations 1"
COMMANDS: dict[str, tuple[str, str]] = {
    "compare": ("compare FILE --plants kinematic --horizons 1,2 --no-rerun", "log.csv"),
    "compare with a profile": (
        "compare traj4 --plants linear --reference linear --no-rerun --profile FILE",
        "lab.toml",
    ),
    "fit": (f"fit kinematic --to FILE --horizons 1,2 {SMALL}", "log.csv"),
    "track": ("track pid FILE --speed 0.5 --plant kinematic --no-rerun", "way.csv"),
    "track with gains": (
        "track pid line --speed 0.5 --plant kinematic --no-rerun --gains FILE",
        "pid.toml",
    ),
    "tune": (
        f"tune pid --reference FILE --speed 0.5 --plant kinematic --held-out line@0.5 {SMALL}",
        "way.csv",
    ),
    "recordings info": ("recordings info FILE", "log.csv"),
    "recordings convert": ("recordings convert FILE", "log.csv"),
    "robots check": ("robots check FILE", "robot.toml"),
    "study drivetrain": ("study drivetrain --recording FILE --ground grass.csv", "up.csv"),
}
"""Commands of a second, and the file that each reads."""


def with_nan(text: bytes) -> bytes:
    """Put a NaN in the place of one number of a table or a TOML file."""
    lines = text.split(b"\n")
    if b"," in lines[0]:
        lines[2] = lines[2].rpartition(b",")[0] + b",nan"
    else:
        k = next(k for k, line in enumerate(lines) if b" = " in line and line[-1:].isdigit())
        lines[k] = lines[k].partition(b" = ")[0] + b" = nan"
    return b"\n".join(lines)


FILES: dict[str, Callable[[bytes], bytes] | None] = {
    "missing": None,
    "empty": lambda text: b"",
    "rubbish": lambda text: bytes(range(256)) * 20,
    "another kind of file": lambda text: b'{"a": [1, 2, 3]}\n',
    "a heading alone": lambda text: text[: text.index(b"\n") + 1],
    "cut off": lambda text: text[: len(text) // 2],
    "NaN": with_nan,
    "windows": lambda text: b"\xef\xbb\xbf" + text.replace(b"\n", b"\r\n"),
}
"""What became of the file; None for no file at all."""
MAY_BE_READ = {"a heading alone", "cut off", "NaN", "windows"}
"""Files that may still hold all that a program needs."""
OPTIONS: dict[str, str] = {
    "unknown": "--nosuch 3",
    "mistyped": "--oute out",
    "without its value": "--out",
    "text for a number": "--seed many",
    "negative": "--seed -1",
    "no workers": "--workers 0",
    "a file for a folder": "--out way.csv/out",
    "a folder that cannot be": "--out /proc/nowhere",
    "a second argument": "log.csv log.csv log.csv",
}
READERS = ("compare", "recordings info", "study drivetrain")
"""One of each way in which options are read: those of a program, of a subcommand and of a study."""


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a good file of each kind."""
    folder = tmp_path_factory.mktemp("good")
    t = np.arange(0.0, 12.0, 0.05)
    yaw = 0.3 * t
    columns = {
        "t": t,
        "cmd_v": 0 * t + 0.5,
        "cmd_w": 0 * t + 0.3,
        "enc_left": 0 * t + 3.0,
        "enc_right": 0 * t + 3.5,
        "gyro_z": 0 * t + 0.3,
        "x": np.sin(yaw) / 0.6,
        "y": (1.0 - np.cos(yaw)) / 0.6,
        "yaw": yaw,
    }
    rows = [
        ",".join(columns),
        *(",".join(f"{v:.6f}" for v in row) for row in zip(*columns.values(), strict=True)),
    ]
    (folder / "log.csv").write_text("\n".join(rows) + "\n")
    (folder / "way.csv").write_text(
        "x,y\n" + "".join(f"{0.1 * i},{0.004 * i * i}\n" for i in range(20))
    )
    load_profile("thesis-lab").save(folder / "lab.toml")
    source = Path(__file__).resolve().parents[1]
    shutil.copy(
        source / "validation" / "experiment" / "gain_sets" / "pid-tuned.toml", folder / "pid.toml"
    )
    shutil.copy(source / "models" / "husky.toml", folder / "robot.toml")
    for log, name in ((in_the_air(commands=18), "up.csv"), (on_grass(commands=24), "grass.csv")):
        write_csv(log, folder / name)
    return folder


def problems(status: int, error: str, before: set[Path], folder: Path) -> list[str]:
    """Return what is wrong with the end of a program that began with these files in its folder."""
    measured = [f"status {status}"] if status not in (0, 1, 2, *STOPPED) else []
    lines = [line for line in error.splitlines() if line.startswith(("error: ", "run failed: "))]
    ours = len(lines) == 1 and error.rstrip().endswith(lines[0])
    tyros = not lines and error.count("\u256d") == 1 and error.rstrip().endswith("\u256f")
    if "Traceback" in error or (status in (1, 2) and not (ours or tyros)):
        measured.append(f"no clear line: {error[-300:]}")
    written = {path for path in folder.rglob("*") if path.is_file()} - before
    if status == 2 and written:
        measured.append(f"wrote {sorted(map(str, written))} on a mistake")
    return measured + [f"{path.name}: {why}" for path in written if (why := damage(path))]


def damage(path: Path) -> str:
    """Return what is wrong with a file that was written; nothing for a whole one."""
    if ".part" in path.name:
        return "left over"
    try:
        if path.suffix == ".json":
            # NaN and Infinity are no integers
            json.loads(path.read_text(), parse_constant=lambda text: int(text))
        elif path.suffix == ".toml":
            tomllib.loads(path.read_text())
        elif path.suffix == ".png":
            with Image.open(path) as image:
                image.verify()
        elif path.suffix == ".npz":
            with np.load(path) as file:
                dict(file)
        return "" if path.stat().st_size else "empty"
    except (ValueError, OSError) as error:
        return str(error)


def call(
    words: list[str], capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> tuple[int, str]:
    """Run a program in this process, as `python -m` does; return its status and standard error."""
    monkeypatch.setattr(sys, "argv", [words[0], *words[1:]])
    capfd.readouterr()
    status = 0
    with np.errstate(all="warn"):
        try:
            runpy.run_module(f"validation.{words[0]}", run_name="__main__", alter_sys=True)
        except SystemExit as left:
            status = left.code if isinstance(left.code, int) else 0
    return status, capfd.readouterr().err


@pytest.mark.parametrize("name", [*filter(is_possible, COMMANDS)])
def test_what_users_meet(
    name: str,
    good: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """Every program with every mishap of its file, and every mistake in shared options."""
    cases = [*itertools.product(["well", *FILES], [""])]
    if name in READERS:
        cases += itertools.product(["well"], OPTIONS)
    bad = []
    for k, (file, option) in enumerate(cases):
        folder = tmp_path / str(k)
        shutil.copytree(good, folder)
        monkeypatch.chdir(folder)
        command, read = COMMANDS[name]
        if file in FILES:
            change = FILES[file]
            path = folder / read
            path.write_bytes(change(path.read_bytes())) if change else path.unlink()
        before = {path for path in folder.rglob("*") if path.is_file()}
        words = [*command.replace("FILE", read).split(), *OPTIONS.get(option, "").split()]
        status, error = call(words, capfd, monkeypatch)
        wanted = {0} if file == "well" and not option else {0, 2} if file in MAY_BE_READ else {2}
        measured = problems(status, error, before, folder) + (
            [f"status {status}"] if status not in wanted else []
        )
        bad += [f"{name}, {file} {option}: {'; '.join(measured)}"] * bool(measured)
        shutil.rmtree(folder)
    assert bad == [], "\n".join(bad)


ENDS: dict[str, signal.Signals | None] = {
    "killed": signal.SIGKILL, "Ctrl-C": signal.SIGINT, "ended": signal.SIGTERM, "full disk": None,
}  # fmt: skip
STOPPED = (130, -signal.SIGINT, -signal.SIGTERM)
"""Statuses of programs that a signal ends: 130, and the signal itself while they are being
loaded."""
LONG = {
    "fit": "fit improved --to traj4@linear --population 30 --generations 60 --patience 99 "
    "--search jde --out out",
    "recordings": "recordings convert log.csv --out out/made.csv --overwrite",
    "replicate": "replicate --quick --only 3.12,accelerations --out out",
}
"""Commands of some seconds."""


@pytest.mark.slow  # six processes each
@pytest.mark.parametrize("name", [*filter(is_possible, LONG)])
def test_an_end_in_mid_run(name: str, good: Path, tmp_path: Path) -> None:
    """Whatever ends a program, each file is whole or not there.

    Then the same command comes to its end.
    """
    program, *words = LONG[name].split()
    rng = random.Random(name)
    bad = list[str]()
    took = 0.0
    for end in ("undisturbed", *ENDS, "again"):
        again = ["--resume"] if name == "fit" and end not in ("undisturbed", "full disk") else []
        folder = tmp_path / ("undisturbed" if end == "undisturbed" else "rough")
        if not folder.exists():
            shutil.copytree(good, folder)
            (folder / "out").mkdir()
        before = {path for path in folder.rglob("*") if path.is_file()}
        began = time.monotonic()
        limit = (
            (lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (500, 500)))
            if end == "full disk"
            else None
        )
        child = subprocess.Popen(
            [sys.executable, "-m", f"validation.{program}", *words, *again],
            cwd=folder,
            text=True,
            preexec_fn=limit,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        if (how := ENDS.get(end)) is not None:
            time.sleep(rng.uniform(0.5, 1.0) * took)
            child.send_signal(how)
        _, error = child.communicate(timeout=300)
        took = took or time.monotonic() - began
        left = (
            []
            if end == "killed" and child.returncode == -9
            else problems(child.returncode, error, before, folder)
        )
        if end in ("undisturbed", "again") and child.returncode:
            left.append(f"status {child.returncode}: {error}")
        bad += [f"{end}: {what}" for what in left]
    results = [
        sorted(p.name for p in (tmp_path / way / "out").rglob("*") if p.suffix != ".npz")
        for way in ("undisturbed", "rough")
    ]
    assert bad == [], "\n".join(bad)
    assert results[0] == results[1]
