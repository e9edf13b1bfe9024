"""Compiled code on disk is never another function's or user's, and a damaged file costs time."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ssmr import _jit

ROOT = Path(__file__).resolve().parents[1]
LAWS = '''"""Two laws of one layout, and a longer one."""

from typing import NamedTuple

from ssmr._jit import jit_alone


class Halved(NamedTuple):
    rate: float
    limit: float


class Doubled(NamedTuple):
    rate: float
    limit: float


class Shifted(NamedTuple):
    rate: float
    limit: float
    shift: float


@jit_alone
def speed(law):
    return 1.0 + law[0] / law[1]


@jit_alone
def shifted(law):
    return law.rate * law.limit + law.shift
'''
RUN = "import laws; print(laws.speed(laws.Halved(1.0, 2.0)), laws.speed(laws.Doubled(2.0, 1.0)), "
RUN += "laws.speed(laws.Shifted(3.0, 1.0, 5.0)), laws.shifted(laws.Shifted(3.0, 1.0, 5.0)))"
RIGHT = "1.5 3.0 4.0 8.0"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "laws.py").write_text(LAWS, encoding="utf-8")
    return tmp_path


def start(folder: Path) -> subprocess.Popen[str]:
    root = Path(__file__).resolve().parents[1]
    places = f"{root}{os.pathsep}{folder}"
    environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache"), "PYTHONPATH": places}
    environment.pop("NUMBA_CACHE_DIR", None)
    command = [sys.executable, "-c", RUN]
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


def said(process: subprocess.Popen[str]) -> str:
    return process.communicate(timeout=120)[0].strip()


def kept(folder: Path, ending: str) -> list[Path]:
    return sorted((folder / "cache").rglob(f"*{ending}"))


def test_two_first_starts_at_once_and_a_damaged_cache_give_the_right_numbers(folder: Path) -> None:
    """A full disk can leave half a file."""
    first = start(folder)
    second = start(folder)
    assert said(first) == said(second) == RIGHT
    assert len(kept(folder, ".nbc")) == 4
    for ending, damage in ((".nbc", b""), (".nbi", b""), (".nbc", None), (".nbi", None)):
        for path in kept(folder, ending):
            whole = path.read_bytes()
            path.write_bytes(whole[: len(whole) // 2] if damage is None else damage)
        assert said(start(folder)) == RIGHT, (
            f"{ending} files are {'cut' if damage is None else 'empty'}"
        )
    assert [path.read_bytes() != b"" for path in kept(folder, ".nbc")] == [True] * 4, (
        "they are written anew"
    )


def make_clone(root: Path) -> Path:
    """Return a folder with two kernels of its own, `ssmr.high` over `ssmr.low`, and a third."""
    package = root / "ssmr"
    for folder in (package, package / "metrics", package / "models"):
        folder.mkdir(parents=True)
        (folder / "__init__.py").touch()
    for name in ("_jit", "types", "errors"):
        shutil.copy(ROOT / "ssmr" / f"{name}.py", package)
    low = "from ssmr._jit import jit\n\n@jit\ndef low(x):\n    return 2.0 * x\n"
    high = "from ssmr._jit import jit_alone\nfrom ssmr.low import low\n\n"
    high += "@jit_alone\ndef high(x):\n    return low(x) + 1.0\n"
    other = "from ssmr._jit import jit_alone\n\n@jit_alone\ndef other(x):\n    return x - 1.0\n"
    # imported by its name, as the table of models does
    chosen = "from importlib import import_module\nfrom ssmr._jit import jit_alone\n\n"
    chosen += 'NAME = "law"\nlaw = import_module(f"ssmr.models.{NAME}").law\n\n'
    chosen += "@jit_alone\ndef chosen(x):\n    return law(x)\n"
    law = "from ssmr._jit import jit\n\n@jit\ndef law(x):\n    return 5.0 * x\n"
    kernels = {"low": low, "high": high, "other": other, "chosen": chosen, "models/law": law}
    for name, text in kernels.items():
        (package / f"{name}.py").write_text(text, encoding="utf-8")
    return root


USED = (
    "from ssmr.high import high; from ssmr.other import other; from ssmr.chosen import chosen; "
    "print(high(2.0), other(2.0), chosen(2.0))"
)


def use_clone(clone: Path, cache: Path) -> tuple[str, int]:
    """Return what the kernels of a clone give, and how many of them were compiled for that."""
    before = {path: path.stat().st_mtime_ns for path in cache.rglob("*.nbc")}
    environment = {**os.environ, "XDG_CACHE_HOME": str(cache), "PYTHONPATH": str(clone)}
    environment.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run(
        [sys.executable, "-P", "-c", USED],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
        cwd=clone,
    )
    after = {path: path.stat().st_mtime_ns for path in cache.rglob("*.nbc")}
    assert before.keys() <= after.keys(), "nothing is removed because it was not found"
    return done.stdout.strip(), sum(before.get(path) != changed for path, changed in after.items())


def test_clones_keep_their_code_and_an_edit_compiles_what_it_touches(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    here = make_clone(tmp_path / "here")
    there = make_clone(tmp_path / "there")
    assert use_clone(here, cache) == ("5.0 1.0 10.0", 3)
    assert use_clone(there, cache) == ("5.0 1.0 10.0", 3)
    for clone in (here, there, here):
        assert use_clone(clone, cache) == ("5.0 1.0 10.0", 0), "each finds its own"
    for name, old, new, says in (
        ("low", "2.0 * x", "3.0 * x", "7.0 1.0 10.0"),
        ("other", "x - 1.0", "x - 2.0", "7.0 0.0 10.0"),
        ("models/law", "5.0", "6.0", "7.0 0.0 12.0"),
    ):
        path = here / "ssmr" / f"{name}.py"
        path.write_text(path.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
        assert use_clone(here, cache) == (says, 1), f"an edit of {name} touches one kernel"
    (here / "ssmr" / "metrics" / "unrelated.py").write_text("x = 1\n", encoding="utf-8")
    assert use_clone(here, cache) == ("7.0 0.0 12.0", 0)
    assert use_clone(there, cache) == ("5.0 1.0 10.0", 0), "the other is as it was"


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="this system does not say who owns a folder")
def test_a_folder_where_others_can_write_is_no_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Numba unpickles what lies there, so that it could run their code."""
    monkeypatch.setattr(_jit.config, "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    mine = Path(_jit._cache_folder())
    assert mine.is_dir()
    mine.chmod(0o777)
    assert _jit._cache_folder() == ""
    assert str(mine) in caplog.text
    mine.chmod(0o700)
    assert _jit._cache_folder() == str(mine)
    if os.geteuid() == 0:
        os.chown(mine, 65534, -1)
        assert _jit._cache_folder() == "", "it belongs to somebody else"


def test_what_nobody_loads_for_long_goes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_jit, "_FOLDER", str(tmp_path))
    ages = {"numba-old": 2.0, "numba-new": 0.5}
    for name, age in ages.items():
        (tmp_path / name).mkdir()
        changed = time.time() - age * _jit._CACHE_LIFETIME
        os.utime(tmp_path / name, (changed, changed))
    _jit._remove_unused.__wrapped__()
    assert [path.name for path in tmp_path.iterdir()] == ["numba-new"]
