"""The scripts and the notebook of examples/ run as they stand."""

from __future__ import annotations

import json
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
    "first_steps.ipynb": ("compared with recording", "track.rrd"),
}
"""Each example prints these words, among others."""


def test_every_example_is_tried() -> None:
    assert {path.name for path in EXAMPLES.iterdir() if path.is_file()} == set(SAYS)


def code_of(path: Path) -> str:
    """The program, the code cells of a notebook one after the other."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        return text
    return "\n".join(
        "".join(cell["source"]) for cell in json.loads(text)["cells"] if cell["cell_type"] == "code"
    )


@pytest.mark.parametrize("name", SAYS)
def test_an_example_runs(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    program = tmp_path / Path(name).with_suffix(".py").name
    program.write_text(code_of(EXAMPLES / name), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    runpy.run_path(program.name, run_name="__main__")
    printed = capsys.readouterr().out
    for words in SAYS[name]:
        assert words in printed
