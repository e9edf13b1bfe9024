"""Every appendix can be deleted with its tests and pages: the rest neither knows nor needs it."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.appendices import APPENDICES, ROOT
from tests.test_architecture import imports, modules, room_of

ROOMS = {APPENDICES[name][0].replace("/", ".") for name in APPENDICES}
LEFT_OUT = shutil.ignore_patterns("__pycache__", "*.nb?", ".git", ".*_cache", ".venv", "runs")


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


@pytest.mark.parametrize("name", APPENDICES)
def test_every_pattern_of_an_appendix_is_a_file(name: str) -> None:
    for pattern in APPENDICES[name]:
        assert list(ROOT.glob(pattern)), pattern


@pytest.mark.slow  # the type checker reads everything anew
@pytest.mark.parametrize("name", APPENDICES)
def test_the_rest_works_without_an_appendix(name: str, tmp_path: Path) -> None:
    root = tmp_path / "rest"
    shutil.copytree(ROOT, root, ignore=LEFT_OUT)
    for pattern in APPENDICES[name]:
        for path in root.glob(pattern):
            shutil.rmtree(path) if path.is_dir() else path.unlink()

    def output_of(*arguments: str) -> str:
        command = [sys.executable, *arguments]
        done = subprocess.run(
            command, cwd=root, capture_output=True, text=True, timeout=900, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    packages = [p for p in ("ssmr", "validation", "benchmarks") if (root / p).is_dir()]
    output_of("-m", "mypy", *(f"--package={package}" for package in packages))
    output_of("-m", "pytest", "--collect-only", "-q", "-n", "0", "-p", "no:cacheprovider")
    printed = output_of("-m", "validation", "compare", "traj4", "--no-rerun", "--out", "here")
    assert "d_rms" in printed
    assert str(root) in output_of("-c", "import ssmr, validation; print(validation.__file__)")
    assert name not in output_of("-m", "validation", "--help").split()
