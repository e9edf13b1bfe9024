"""Every benchmark runs, quickly; C and numba agree."""

from __future__ import annotations

import importlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from benchmarks import simulate
from benchmarks.rows import MissingError, optional
from ssmr.errors import SsmrError
from ssmr.scenarios import TRAJECTORIES

ROOT = Path(__file__).resolve().parents[1]
NAMES = sorted(p.stem for p in (ROOT / "benchmarks").glob("*.py") if p.stem not in ("__init__", "rows"))
APART = {"ros", "cluster"}
"""Benchmarks that run as processes of their own: what they start would not leave this one as it was."""


@pytest.mark.parametrize("name", NAMES)
def test_a_quick_run_ends_well(name: str, tmp_path: Path) -> None:
    out, threads = tmp_path / "benchmark.json", numba.get_num_threads()
    if name in APART:
        command = [sys.executable, "-m", f"benchmarks.{name}", "--quick", "--out", str(out)]
        done = subprocess.run(command, cwd=ROOT, env=dict(os.environ), capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr
    else:
        try:
            importlib.import_module(f"benchmarks.{name}").main(out=out, quick=True)
        finally:
            numba.set_num_threads(threads)
    assert json.loads(out.read_text(encoding="utf-8"))["schema"] == "ssmr.benchmark/1"


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
def test_models_in_another_order_than_c_was_told_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Version 1.0 failed in this way: the order of models changed in Python alone."""
    header = simulate.shared_header()
    monkeypatch.setattr(simulate, "shared_header", lambda: header.replace("enum { ", "enum { ANOTHER, ", 1))
    with pytest.raises(SsmrError, match=r"C and numba disagree by .*; planar\.c is out of date"):
        simulate.planar_rows(TRAJECTORIES["traj4"].commands(), 1)


def test_only_a_quick_run_goes_on_without_what_is_missing() -> None:
    def measure() -> list[int]:
        raise MissingError("no such thing")

    assert optional(True, measure) is None
    with pytest.raises(MissingError):
        optional(False, measure)
