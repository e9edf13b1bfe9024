"""Every appendix can be deleted with its tests and pages: the rest neither knows nor needs it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from itertools import chain
from pathlib import Path

import pytest

from tests.appendices import APPENDICES, ROOT, is_deleted, is_there, room_of_appendix
from tests.test_architecture import imports, modules, room_of

ROOMS = {room_of_appendix(name).replace("/", ".") for name in APPENDICES}
LEFT_OUT = shutil.ignore_patterns("__pycache__", "*.nb?", ".git", ".*_cache", ".venv", "runs")
THERE = [name for name in APPENDICES if is_there(name)]
"""Appendices that were not deleted: in a copy without one, the others can be deleted too."""
Run = Callable[..., str]


def test_no_core_room_imports_an_appendix() -> None:
    for name in modules():
        if room_of(name) not in ROOMS:
            known = {room_of(other) for other in imports(name)} | {
                other.partition(".")[0] for other in imports(name)
            }
            assert not known & ROOMS, f"{name} imports {sorted(known & ROOMS)}"
    stub = (ROOT / "validation" / "__init__.pyi").read_text(encoding="utf-8")
    for name in APPENDICES:
        assert f" .{name}" not in stub
        assert f"import {name} " not in stub


@pytest.mark.parametrize("name", THERE)
def test_every_pattern_of_an_appendix_is_a_file(name: str) -> None:
    for pattern in APPENDICES[name]:
        assert list(ROOT.glob(pattern)) or is_deleted(ROOT / pattern), pattern


@pytest.fixture
def run_in_rest(names: list[str], tmp_path: Path) -> Run:
    """Return a function that runs Python in a copy without appendices, and returns its output."""
    root = tmp_path / "rest"
    shutil.copytree(ROOT, root, ignore=LEFT_OUT)
    for pattern in chain.from_iterable(APPENDICES[name] for name in names):
        for path in root.glob(pattern):
            shutil.rmtree(path) if path.is_dir() else path.unlink()

    def run(*arguments: str) -> str:
        done = subprocess.run(
            [sys.executable, *arguments],
            cwd=root,
            env={**os.environ, "PYTHONPATH": str(root)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    assert str(root) in run("-c", "import ssmr, validation; print(validation.__file__)")
    return run


def run_tests(run: Run, *arguments: str) -> None:
    """Run tests of a copy."""
    run("-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments)


@pytest.mark.parametrize(
    "names",
    # none imports another, so what stands without all of them hardly falls without one
    [THERE, *(pytest.param([name], marks=pytest.mark.slow) for name in THERE)],
    ids="-".join,
)
def test_the_house_stands_without_appendices(names: list[str], run_in_rest: Run) -> None:
    # how the rest is written was judged with the whole
    rooms = "room or module or import or cycle or program or whole or pure or door"
    run_tests(run_in_rest, "-n", "0", "tests/test_architecture.py", "-k", rooms)
    assert not {*names} & {*run_in_rest("-m", "validation", "--help").split()}


@pytest.mark.slow  # all other tests run in the copy, and the type checker reads everything anew
@pytest.mark.parametrize("names", [[name] for name in THERE], ids="-".join)
def test_the_rest_works_without_an_appendix(names: list[str], run_in_rest: Run) -> None:
    packages = [
        p for p in ("ssmr", "validation", "benchmarks") if (ROOT / p).is_dir() and p not in names
    ]
    run_in_rest("-m", "mypy", *(f"--package={package}" for package in packages))
    printed = run_in_rest("-m", "validation", "compare", "traj4", "--no-rerun", "--out", "here")
    assert "d_rms" in printed
    run_tests(run_in_rest, "--ignore=tests/test_appendices.py")
