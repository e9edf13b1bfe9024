"""Compiled code on disk is never another function's, nor older than its sources.

Whoever has the same sources shares it.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from ssmr import _jit

ROOT = Path(__file__).resolve().parents[1]

VALUES = '''"""What kernels in another file refer to."""

from typing import NamedTuple

import numpy as np

from ssmr._jit import built_in, jit, jit_alone
from llvmlite import ir
from numba import types

BY_NAME = 10.0
BY_MODULE = 20.0
IN_AN_ARRAY = np.array([30.0])


class One(NamedTuple):
    x: float


class Two(NamedTuple):
    x: float


One._advance = jit(lambda x: x + 50.0)
Two._advance = jit(lambda x: x + 60.0)


@jit
def inlined(x):
    return x + 70.0


@jit_alone
def called(x):
    return x + 80.0


@built_in
def written(typing):
    """Return a number that is an instruction."""

    def build(context, builder, signature, arguments):
        return ir.Constant(ir.DoubleType(), 90.0)

    return types.float64(), build


@built_in
def chosen(typing, kind):
    """Call what belongs to a type."""
    law = kind.instance_class._advance._numba_type_

    def build(context, builder, signature, arguments):
        x = builder.extract_value(arguments[0], 0)
        moved = builder.fadd(x, ir.Constant(ir.DoubleType(), 100.0))
        return context.get_function(law, call)(builder, [moved])

    call = typing.resolve_function_type(law, [types.float64], {})
    return types.float64(kind), build


@jit
def refused(x):
    if x > 0.0:
        raise ValueError("positive", x)
    return x


def left_alone():
    """Return what no kernel uses."""
    return 110.0
'''
KERNELS = '''"""A kernel for each way in which code refers to what stands elsewhere."""

import values
from ssmr._jit import jit_alone
from values import BY_NAME, IN_AN_ARRAY, One, Two, called, chosen, inlined, written


def made(number):
    @jit_alone
    def by_cell():
        return number

    return by_cell


@jit_alone
def by_argument(x=120.0):
    return x


@jit_alone
def inside():
    return [x + 130.0 for x in (0.0,)][0]


@jit_alone
def by_law(kind):
    return chosen(kind)


by_name = jit_alone(lambda: BY_NAME)
by_module = jit_alone(lambda: values.BY_MODULE)
in_an_array = jit_alone(lambda: IN_AN_ARRAY[0])
by_inlined = jit_alone(lambda: inlined(0.0))
by_called = jit_alone(lambda: called(0.0))
by_written = jit_alone(lambda: written())
by_cell = made(140.0)
'''
RUN = """
from numba.core import event
with event.install_recorder("numba:compile") as recorder:
    from kernels import *
    print(by_name(), by_module(), in_an_array(), by_law(One(0.0)), by_law(Two(0.0)),
        by_inlined(), by_called(), by_written(), by_argument(), inside(), by_cell())
kept = [each.data["dispatcher"] for _, each in recorder.buffer if each.is_start]
print(sum(hasattr(each._cache, "_function") for each in kept))
"""
NUMBERS = [10.0, 20.0, 30.0, 150.0, 160.0, 70.0, 80.0, 90.0, 120.0, 130.0, 140.0]
EVERY = len(NUMBERS) + 1
"""Kernels that a first start compiles, with the one that others call."""


def start(folder: Path, run: str = RUN, *before: Path) -> subprocess.Popen[str]:
    places = os.pathsep.join(map(str, (*before, folder, ROOT)))
    environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache"), "PYTHONPATH": places}
    environment.pop("NUMBA_CACHE_DIR", None)
    # Python notices no edit within a second that keeps a file's size
    environment["PYTHONDONTWRITEBYTECODE"] = "1"
    return subprocess.Popen(
        [sys.executable, "-c", run],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def said(process: subprocess.Popen[str]) -> tuple[list[float], int]:
    """Return the numbers, and how many kernels were compiled."""
    words = process.communicate(timeout=240)[0].split()
    try:
        return [float(word) for word in words[:-1]], int(words[-1])
    except ValueError:
        pytest.fail(" ".join(words))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "values.py").write_text(VALUES, encoding="utf-8")
    (tmp_path / "kernels.py").write_text(KERNELS, encoding="utf-8")
    return tmp_path


def edited(folder: Path, *edits: tuple[str, str]) -> None:
    for name in ("values.py", "kernels.py"):
        text = (folder / name).read_text(encoding="utf-8")
        for old, new in edits:
            text = re.sub(rf"\b{old}\b", new, text)
        (folder / name).write_text(text, encoding="utf-8")


def test_an_edit_compiles_what_uses_it_and_nothing_else(folder: Path) -> None:
    assert said(start(folder)) == (NUMBERS, EVERY)
    edited(
        folder,
        ("What kernels in another file refer to", "Much\n\nmore"),
        ("Return a number", "Return"),
        ("110.0", "111.0"),
    )
    assert said(start(folder)) == (NUMBERS, 0)
    edited(folder, *((f"{n}.0", f"{n + 1}.0") for n in (10, 30, 50, 70, 90, 120, 140)))
    odd = [11.0, 20.0, 31.0, 151.0, 160.0, 71.0, 80.0, 91.0, 121.0, 130.0, 141.0]
    assert said(start(folder)) == (odd, 7)
    edited(folder, *((f"{n}.0", f"{n + 1}.0") for n in (20, 60, 80, 130)))
    every = [11.0, 21.0, 31.0, 151.0, 161.0, 71.0, 81.0, 91.0, 121.0, 131.0, 141.0]
    assert said(start(folder)) == (every, 5)
    edited(folder, ("100.0", "101.0"))
    assert said(start(folder)) == ([*every[:3], 152.0, 162.0, *every[5:]], 2)


def test_what_an_inlined_function_raises_keeps_its_arguments(folder: Path) -> None:
    """Also where its caller comes from disk, and where Python calls it."""
    run = """
from ssmr._jit import jit_alone
from values import refused
for function in (jit_alone(lambda x: refused(x)), refused):
    try:
        function(5.0)
    except ValueError as error:
        print(*error.args)
"""
    for _ in range(2):
        assert start(folder, run).communicate(timeout=240)[0].split() == ["positive", "5.0"] * 2


def test_two_first_starts_at_once_and_damaged_files_give_the_right_numbers(folder: Path) -> None:
    both = [start(folder), start(folder)]
    assert [said(each)[0] for each in both] == [NUMBERS] * 2
    assert said(start(folder)) == (NUMBERS, 0)
    kept = sorted((folder / "cache").rglob("*.nb[ci]"))
    # code of one kernel, then the index of the next
    for k, path in enumerate(sorted({path.parent for path in kept})):
        (file,) = path.glob("*.nbi" if k % 2 else "*.nbc")
        file.write_bytes(b"" if k % 2 else file.read_bytes()[:-100])
    assert said(start(folder)) == (NUMBERS, EVERY)
    assert said(start(folder)) == (NUMBERS, 0), "they are written anew"


def test_copies_of_the_package_share_what_they_compile(tmp_path: Path) -> None:
    """So does one whose metrics were edited; where a kernel was, only that is compiled."""
    run = """
import numpy as np
from numba.core import event
with event.install_recorder("numba:compile") as recorder:
    from ssmr.metrics.paths import bending_energy, path_length
    import ssmr.metrics.declared
    path = np.linspace(0.0, 1.0, 11)[:, None] ** [1.0, 2.0]
    print(path_length(path), bending_energy(path))
kept = [each.data["dispatcher"] for _, each in recorder.buffer if each.is_start]
print(sum(hasattr(each._cache, "_function") for each in kept))
"""
    copies = [tmp_path / name for name in ("one", "another")]
    for copy in copies:
        shutil.copytree(ROOT / "ssmr", copy / "ssmr")
    numbers, compiled = said(start(tmp_path, run, copies[0]))
    assert compiled > 0
    assert said(start(tmp_path, run, copies[1])) == (numbers, 0)
    metrics = copies[0] / "ssmr" / "metrics" / "declared.py"
    metrics.write_text(metrics.read_text(encoding="utf-8") + "\nNEW = 1.0\n", encoding="utf-8")
    paths = copies[1] / "ssmr" / "metrics" / "paths.py"
    text = paths.read_text(encoding="utf-8")
    paths.write_text(text.replace("SPACING = 0.1", "SPACING = 0.2"), encoding="utf-8")
    assert said(start(tmp_path, run, copies[0])) == (numbers, 0)
    others, compiled = said(start(tmp_path, run, copies[1]))
    assert (others[0], compiled) == (numbers[0], 1)
    assert others[1] != numbers[1]


def test_what_nobody_uses_goes_and_what_somebody_uses_stays(folder: Path) -> None:
    said(start(folder))
    places = folder / "cache" / "ssmr-testbed"
    kept = {*places.iterdir()}
    unused = places / "numba-unused"
    unused.mkdir()
    for place in (unused, *kept):
        os.utime(place, (0.0, 0.0))
    said(start(folder))
    used = {place for place in kept if place.stat().st_mtime > 0.0}
    # none is alone in using the one that others call
    assert len(used) == len(kept) - 1 == EVERY - 1
    assert unused.is_dir()
    edited(folder, ("10.0", "11.0"))
    said(start(folder))
    assert len({*places.iterdir()} - used) == 1
    assert used < {*places.iterdir()}


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
