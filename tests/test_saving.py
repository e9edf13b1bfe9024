"""A kill while results are saved locks nobody out, and undrawable numbers are kept."""

from __future__ import annotations

import json
import logging
import os
import re
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
from validation.output import write_atomic, write_text

pytestmark = pytest.mark.usefixtures("with_drawings")

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


DIES = """
import os, signal, sys
from pathlib import Path
from validation.output import write_atomic
def die(part):
    part.write_bytes(b"half of a")
    os.kill(os.getpid(), signal.SIGKILL)
write_atomic(Path(sys.argv[1]), die)
"""
"""A process that is killed while it writes a file."""


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such kills")
def test_what_a_killed_process_was_writing_goes_with_the_next_file(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    for _ in range(2):
        subprocess.run([sys.executable, "-c", DIES, str(path)], check=False)
    assert len(list(tmp_path.iterdir())) == 1  # the first went with the second

    def write_two(part: Path) -> None:
        part.write_text("outer")
        write_text(tmp_path / "b.txt", "inner")
        assert part.read_text() == "outer"  # what is being written stays

    write_atomic(path, write_two)
    written = {each.name: each.read_text() for each in tmp_path.iterdir()}
    assert written == {"a.txt": "outer", "b.txt": "inner"}


@pytest.mark.parametrize(
    "command",
    [
        "recordings convert sample --out there.csv",
        "recordings convert sample --out there.tum",
        "recordings info sample --json there.json",
        "robots new rover --wheelbase 0.5 --track 0.5 --wheel-radius 0.1 --wheel-width 0.05 "
        "--mass 50 --out there.toml",
        "robots export husky --out there.urdf",
    ],
)
def test_a_command_that_was_interrupted_behind_its_file_may_be_given_again(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    program, *words = command.split()
    for _ in range(2):
        assert exit_status(program_named(program), *words) == 0
    (there,) = tmp_path.iterdir()
    there.write_text("mine")
    assert exit_status(program_named(program), *words) == 2
    assert there.read_text() == "mine"


def test_a_picture_for_a_paper_is_cut_to_its_panels_and_equal_when_drawn_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A title, notes and a line on how it was made are the caption's work there."""
    monkeypatch.chdir(tmp_path)
    for name in ("whole.svg", "plain.svg", "again/plain.svg", "plain.pdf"):
        Path(name).parent.mkdir(exist_ok=True)
        plain = ["--plain"] * ("plain" in name)
        assert exit_status(program_named("compare"), *COMPARE[1:], "--out", name, *plain) == 0
    files = {path.name for path in tmp_path.glob("runs/compare/*/*")}
    assert files == WHOLE["compare"]  # the numbers are where they always are
    whole, plain, again = (
        Path(name).read_text(encoding="utf-8")
        for name in ("whole.svg", "plain.svg", "again/plain.svg")
    )
    assert len(plain) < len(whole)
    ids = re.compile(r"\b[a-z][0-9a-f]{10}\b")  # matplotlib makes them from places in memory
    assert ids.sub("", plain) == ids.sub("", again)
    assert Path("plain.pdf").read_bytes().startswith(b"%PDF")
    # what stood there is not lost
    assert exit_status(program_named("compare"), *COMPARE[1:], "--out", "plain.svg") == 2
    assert Path("plain.svg").read_text(encoding="utf-8") == plain
