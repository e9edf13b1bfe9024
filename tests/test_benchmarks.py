"""Every benchmark runs, quickly."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import simulate
from benchmarks.rows import MissingError, measure_if_installed
from validation import cli

ROOT = Path(__file__).resolve().parents[1]
NAMES = sorted(
    p.stem for p in (ROOT / "benchmarks").glob("*.py") if p.stem not in ("__init__", "rows")
)
APART = {"ros"}
"""Benchmarks that run as processes of their own: what they start would not leave this one as it
was."""


@pytest.mark.parametrize("name", NAMES)
def test_a_quick_run_ends_well(name: str, tmp_path: Path) -> None:
    out = tmp_path / "benchmark.json"
    if name in APART:
        command = [sys.executable, "-m", f"benchmarks.{name}", "--quick", "--out", str(out)]
        done = subprocess.run(
            command, cwd=ROOT, env=dict(os.environ), capture_output=True, text=True, timeout=600
        )
        assert done.returncode == 0, done.stderr
    else:
        importlib.import_module(f"benchmarks.{name}").main(out=out, quick=True)
    assert json.loads(out.read_text(encoding="utf-8"))["schema"] == "ssmr.benchmark/1"


@pytest.mark.parametrize(
    ("option", "message"),
    [("--foo", "Unrecognized options: --foo"), ("--repeats=x", "Error parsing --repeats")],
)
def test_a_mistyped_option_is_a_users_mistake(
    option: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as left:
        cli.run_command(simulate.main, "python -m benchmarks.simulate", [option])
    assert left.value.code == cli.EXIT_USER_ERROR
    errors = capsys.readouterr().err
    assert message in errors
    assert "Traceback" not in errors


def test_only_a_quick_run_goes_on_without_what_is_missing() -> None:
    def measure() -> list[int]:
        raise MissingError("no such thing")

    assert measure_if_installed(True, measure) is None
    with pytest.raises(MissingError):
        measure_if_installed(False, measure)
