"""A kill while results are saved locks nobody out, and undrawable numbers are kept."""

from __future__ import annotations

import json
import logging
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ssmr.search.jde import Jde
from tests.conftest import exit_status
from validation.cli.__main__ import program_named
from validation.fit import fit

KILLED = """
import os, signal, sys
from pathlib import Path
name, *sys.argv[1:] = sys.argv[1:]
real = os.replace
def kill_after(source, target):
    real(source, target)
    if Path(target).name == name:
        os.kill(os.getpid(), signal.SIGKILL)
os.replace = kill_after
from validation.cli.__main__ import main
main()
"""
"""The command `ssmr`, killed as soon as a file of this name is there."""
COMPARE = ["compare", "traj2", "--plants", "linear", "--reference", "linear"]
FIT = [
    "fit",
    "kinematic",
    "--to",
    "traj4@kinematic",
    "--free",
    "alpha_l",
    "--population",
    "8",
    "--generations",
    "1",
]
WHOLE = {
    "compare": {"compare.json", "compare.png", "compare.rrd"},
    "fit": {"fit.json", "profile.toml", "fit.png", "checkpoint.npz"},
}


def again(command: list[str], folder: Path) -> int:
    """The exit status of a command that is given once more."""
    return exit_status(program_named(command[0]), *command[1:], "--out", str(folder))


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such kills")
@pytest.mark.parametrize(
    ("command", "name"),
    [
        (COMPARE, "compare.json"),
        (COMPARE, "compare.png"),
        (FIT, "checkpoint.npz"),
        (FIT, "fit.json"),
        (FIT, "profile.toml"),
    ],
)
def test_a_command_that_was_killed_between_two_files_can_be_given_again(
    command: list[str], name: str, tmp_path: Path
) -> None:
    done = subprocess.run(
        [sys.executable, "-c", KILLED, name, *command, "--out", str(tmp_path)], check=False
    )
    assert done.returncode == -signal.SIGKILL
    there = {path.name for path in tmp_path.iterdir()}
    assert name in there
    assert there < WHOLE[command[0]]
    assert again(command, tmp_path) == 0
    assert {path.name for path in tmp_path.iterdir()} == WHOLE[command[0]]


def test_a_file_that_our_results_do_not_name_is_somebody_elses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert again([*COMPARE, "--no-rerun"], tmp_path) == 0
    film = tmp_path / "compare.rrd"
    film.write_text("of somebody else")
    assert again(COMPARE, tmp_path) == 2
    assert "has a compare.rrd already" in capsys.readouterr().err
    assert film.read_text() == "of somebody else"
    document = json.loads((tmp_path / "compare.json").read_text())
    del document["files"]  # as version 2.0 wrote it
    (tmp_path / "compare.json").write_text(json.dumps(document))
    assert again(COMPARE, tmp_path) == 0
    (tmp_path / "compare.json").unlink()
    os.mkfifo(tmp_path / "compare.json")  # which nobody waits for
    assert again(COMPARE, tmp_path) == 2


def test_numbers_that_cannot_be_drawn_are_written(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A checkpoint may hold any cost."""
    fitted = fit(
        "kinematic", "traj4@kinematic", free=("alpha_l",), population=8, generations=2, search="jde"
    )
    state = {**fitted.course.jde.state(), "history": np.array([38.0, 0.0, 1.7e308])}
    huge = replace(fitted, course=replace(fitted.course, jde=Jde.restore(state)))
    (tmp_path / "fit.png").write_text("of an earlier fit")
    with caplog.at_level(logging.WARNING), np.errstate(all="ignore"):
        written = huge.save(tmp_path)
    assert [path.name for path in written] == ["fit.json", "profile.toml"]
    assert {path.name for path in tmp_path.iterdir()} == {"fit.json", "profile.toml"}
    (said,) = [
        record.getMessage() for record in caplog.records if "cannot be drawn" in record.getMessage()
    ]
    assert said.startswith(str(tmp_path / "fit.png"))
    assert json.loads((tmp_path / "fit.json").read_text())["cost"] == fitted.cost
