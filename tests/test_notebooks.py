"""Notebooks run, and show tables and pictures: cells are executed by a kernel, as Jupyter's are."""

from __future__ import annotations

import ast
import base64
import json
import os
import sys
from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread
from nbclient import NotebookClient
from nbformat import NotebookNode, v4

from tests.test_in_python import Cells

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))
SAYS = {"first_steps.ipynb": ("compared with recording", "track.rrd")}
"""Each notebook prints these words, among others."""
Execute = Callable[[NotebookNode], list[NotebookNode]]

RESULTS = {
    "compare": 'compare("traj4", plants=("linear",), reference="improved")',
    "track": 'track("pid", "circle", plant=("linear",))',
    "fit": 'fit("linear", "traj4@linear", search="jde", generations=1, population=6)',
    "tune": 'tune("lqr", "circle@0.5", plant=("linear",), generations=1, population=6)',
    "check": 'check_robot("husky")',
}
"""Calls of programs whose results have a table and a picture."""
IMPORTS = """
from validation import compare, fit, track, tune
from validation.robots import check_robot
from validation.recordings import info
"""


@pytest.fixture
def execute(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Execute:
    """Return a function that runs a notebook by this Python and returns its cells with code."""
    kernel = tmp_path / "jupyter" / "kernels" / "python3"
    kernel.mkdir(parents=True)
    command = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]
    about = {"argv": command, "display_name": "Python 3", "language": "python"}
    (kernel / "kernel.json").write_text(json.dumps(about), encoding="utf-8")
    for name in ("JUPYTER_PATH", "JUPYTER_CONFIG_DIR", "JUPYTER_RUNTIME_DIR", "IPYTHONDIR"):
        monkeypatch.setenv(name, str(tmp_path / "jupyter"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    folder = tmp_path / "work"
    folder.mkdir()

    def executed(notebook: NotebookNode) -> list[NotebookNode]:
        resources = {"metadata": {"path": str(folder)}}
        NotebookClient(notebook, timeout=300, kernel_name="python3", resources=resources).execute()
        return [cell for cell in notebook.cells if cell.cell_type == "code"]

    return executed


def is_shown(cell: NotebookNode) -> bool:
    """Return whether a cell ends in a value that a notebook shows."""
    last = ast.parse(cell.source).body[-1]
    return isinstance(last, ast.Expr)


def data_of(cell: NotebookNode) -> dict[str, str]:
    """Return what a cell shows of its last value, by the type of media."""
    (shown,) = [output.data for output in cell.outputs if output.output_type == "execute_result"]
    return dict(shown)


def text_of(cells: Sequence[NotebookNode]) -> str:
    """Return what cells print."""
    return "".join(output.get("text", "") for cell in cells for output in cell.outputs)


def pixels_of(png: str) -> Any:
    """Return the pixels of a picture in base64."""
    return imread(BytesIO(base64.b64decode(png)))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_a_shipped_notebook_shows_tables_and_pictures(path: Path, execute: Execute) -> None:
    cells = execute(v4.reads(path.read_text(encoding="utf-8")))
    shown = [data_of(cell) for cell in cells if is_shown(cell)]
    assert all({"image/png", "text/html"} & set(data) for data in shown)
    assert sum("image/png" in data for data in shown) > 1
    for words in SAYS[path.name]:
        assert words in text_of(cells)


def test_results_show_their_table_and_their_picture(execute: Execute) -> None:
    calls = RESULTS | {"info": 'info("sample")'}
    sources = [IMPORTS, *(f"{name}_of = {call}\n{name}_of" for name, call in calls.items())]
    sources += ["print(info_of.table())", "compare_of.figure()"]
    cells = execute(v4.new_notebook(cells=list(map(v4.new_code_cell, sources))))
    _, *results, log, printed, drawn = cells
    for cell in results:
        data = data_of(cell)
        table = Cells()
        table.feed(data["text/html"])
        assert len(table.rows) > 1
        assert data["image/png"] in data["text/html"]
        assert pixels_of(data["image/png"]).shape[1] == 1600
    assert set(data_of(log)) == {"text/plain", "text/html"}
    assert "imu" in text_of([printed])
    figure = pixels_of(data_of(drawn)["image/png"])
    np.testing.assert_array_equal(figure, pixels_of(data_of(results[0])["image/png"]))
