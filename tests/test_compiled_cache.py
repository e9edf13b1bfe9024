"""Compiled code on disk is never another function's or user's, and a damaged file costs time."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ssmr import _jit

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


def test_two_first_starts_at_once_and_whatever_lies_in_the_cache_give_the_right_numbers(
    folder: Path,
) -> None:
    """A race can leave code under another signature's name, and a full disk half a file."""
    first = start(folder)
    second = start(folder)
    assert said(first) == said(second) == RIGHT
    data = kept(folder, ".nbc")
    assert len(data) == 4
    contents = [path.read_bytes() for path in data]
    for path, other in zip(data, contents[1:] + contents[:1], strict=True):
        path.write_bytes(other)
    assert said(start(folder)) == RIGHT, "each file has the code of another signature"
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


@pytest.mark.parametrize("place", ["parent", "root", "folder"])
@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="this system does not say who owns a folder")
def test_a_folder_where_others_can_write_is_no_cache(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Numba unpickles what lies there, so that it could run their code."""
    monkeypatch.setattr(_jit.config, "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    mine = Path(_jit._cache_folder())
    assert mine.is_dir()
    foreign = {"parent": tmp_path, "root": mine.parent, "folder": mine}[place]
    foreign.chmod(0o777)
    assert _jit._cache_folder() == ""
    assert str(mine.parent) in caplog.text
    foreign.chmod(0o700)
    assert _jit._cache_folder() == str(mine)
    if os.geteuid() == 0 and place != "parent":
        os.chown(foreign, 65534, -1)
        assert _jit._cache_folder() == "", "it belongs to somebody else"
