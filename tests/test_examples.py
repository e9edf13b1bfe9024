"""The scripts of examples/ run as they stand."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
SAYS = {
    "compare_plants.py": ("improved", "compare.rrd"),
    "fit_a_log.py": ("husky-tile: ", "fitted: "),
    "other_robots.py": ("warthog", "mm apart"),
    "sweep.py": ("friction 0.3: ", "mm from the improved model"),
    "own_controller.py": ("Chase follows slalom", "mpc follows slalom"),
    "sensitivity.py": ("mujoco: wheel_radius             247", "improved: mass"),
}
"""Each example prints these words, among others."""


def test_every_example_is_tried() -> None:
    assert {path.name for path in EXAMPLES.glob("*.py")} == set(SAYS)


@pytest.mark.parametrize("name", SAYS)
def test_an_example_runs(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    printed = capsys.readouterr().out
    for words in SAYS[name]:
        assert words in printed
