"""The command `ssmr`, which every program can be called by."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

import validation
from tests.conftest import exit_status
from validation.cli import __main__ as ssmr
from validation.robots import PROGRAM as ROBOTS
from validation.tune import tune

ROOT = Path(validation.__file__).parent


Call = Callable[..., tuple[int, str, str]]


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Call:
    """Return a function that runs the command and returns exit status, output and errors."""

    def called(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["/bin/ssmr", *arguments])
        status = 0
        try:
            ssmr.main()
        except SystemExit as left:
            status = int(left.code or 0)
        return status, *capsys.readouterr()

    return called


def test_every_program_is_there() -> None:
    packages = {path.parent.name for path in ROOT.glob("*/__main__.py")} - {"cli"}
    files = {
        path.stem
        for path in ROOT.glob("[a-z]*.py")
        if '__name__ == "__main__"' in path.read_text(encoding="utf-8")
    }
    assert set(ssmr.PROGRAMS) == packages | files


@pytest.mark.parametrize("arguments", [(), ("--help",)])
def test_help_lists_the_programs_with_a_line_each(arguments: tuple[str, ...], call: Call) -> None:
    status, output, _ = call(*arguments)
    assert status == 0
    text = " ".join(output.replace("│", " ").split())
    for name, says in ssmr.PROGRAMS.items():
        assert f"{name} {says}" in text


@pytest.mark.parametrize(
    ("program", "arguments"), [(tune, []), (ROBOTS, ["export"])], ids=["tune", "robots export"]
)
def test_help_fits_a_narrow_terminal_and_breaks_lines_between_words(
    program: Any,
    arguments: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A line ends where the first word of the next has no room.

    tyro leaves descriptions long, and docstrings broken.
    """
    monkeypatch.setenv("COLUMNS", "80")
    assert exit_status(program, *arguments, "--help") == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    ends = [
        (a, b)
        for a, b in pairwise(lines)
        if re.match(r" {16,}\S", b) and re.search(r"\w$", a) and "--" not in a[:6]
    ]
    assert ends or program is ROBOTS
    for line, after in ends:
        assert len(line) + 1 + len(re.split(r"[ ,]", after.split()[0])[0]) > 78, (line, after)


def test_a_program_is_called_as_by_its_module(tmp_path: Path) -> None:
    program = (
        "import sys; sys.argv[0] = '/bin/ssmr'; "
        "from validation.__main__ import main; sys.exit(main())"
    )
    command = [
        sys.executable,
        "-c",
        program,
        *"compare traj2 --plants kinematic,linear --reference linear --no-rerun".split(),
    ]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=300)
    assert done.returncode == 0, done.stderr
    assert set(
        json.loads((tmp_path / "runs/compare/traj2/compare.json").read_text())["plants"]
    ) == {"kinematic", "linear"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("compere", "traj4"), "error: there is no 'ssmr compere'; there are: compare, fit,"),
        (("study", "contacts"), "error: there is no 'ssmr study contacts'; there are: "),
        (("study", "gains", "--seeds", "1"), "error: there is no 'ssmr study gains';"),
        (("compare", "traj9"), "error: no source 'traj9'"),
        (("completion", "fish"), "error: invalid choice 'fish'"),
    ],
)
def test_a_mistake_is_one_line(arguments: tuple[str, ...], message: str, call: Call) -> None:
    status, output, errors = call(*arguments)
    assert (status, output) == (2, "")
    assert errors.startswith(message)
    assert errors.count("\n") == 1


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash here")
def test_bash_completes_programs_studies_and_options(tmp_path: Path, call: Call) -> None:
    status, script, _ = call("completion", "bash")
    assert status == 0
    (tmp_path / "complete.sh").write_text(script)

    def completed(*words: str) -> set[str]:
        ask = f"source complete.sh; COMP_WORDS=({' '.join(words)} ''); COMP_CWORD={len(words)}"
        find = "complete -p ssmr | sed 's/.*-F \\([^ ]*\\).*/\\1/'"
        ask += f"; $({find}); printf '%s\\n' \"${{COMPREPLY[@]}}\""
        # the script asks for a python3, as an environment has
        path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
        env = {**os.environ, "PATH": path}
        done = subprocess.run(
            ["bash", "-c", ask], capture_output=True, text=True, cwd=tmp_path, timeout=60, env=env
        )
        return {word.split("\t")[0].strip() for word in done.stdout.splitlines()}

    assert set(ssmr.PROGRAMS) <= completed("ssmr")
    assert "contact" in completed("ssmr", "study")
