"""The command `ssmr`, which every program can be called by."""

from __future__ import annotations

import ast
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

import validation
from validation import cli
from validation.cli import __main__ as ssmr

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
        assert f"• {name} {says}" in text
    assert "Simulate skid-steering robots" in text
    assert "--version Print the version." in text


def test_the_version_is_said(call: Call) -> None:
    assert call("--version") == (0, f"ssmr-testbed {version('ssmr-testbed')}\n", "")


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
        (("compere", "traj4"), f"Available subcommands: {', '.join(ssmr.PROGRAMS)}"),
        (("robots", "chek"), "Available subcommands: list, check, new, import, export"),
        (("compare", "traj9"), "error: no source 'traj9'"),
    ],
)
def test_a_mistake_says_what_there_is(arguments: tuple[str, ...], message: str, call: Call) -> None:
    status, output, errors = call(*arguments)
    assert (status, output) == (2, "")
    assert message in " ".join(re.sub("[╭╮╰╯│─]", " ", errors).split())


def commands_of(programs: Mapping[str, Any], lead: str = "") -> Iterator[tuple[str, Any]]:
    """Yield each command that has options, with its words."""
    for name, command in programs.items():
        if isinstance(command, Mapping):
            yield from commands_of(command, f"{lead}{name} ")
        else:
            yield f"{lead}{name}", command


PROGRAMS = {name: ssmr.program_named(name) for name in ssmr.PROGRAMS}


@pytest.mark.parametrize(
    ("words", "command"),
    [pytest.param(words, command, id=words) for words, command in commands_of(PROGRAMS)],
)
def test_help_is_about_options_alone(
    words: str, command: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        cli.parse_command(command, words, ["--help"])
    text = capsys.readouterr().out
    assert "-h, --help" in text
    for noise in ("Raises", "Returns", "Args:", "(default: )", "None)", "False)", "tyro"):
        assert noise not in text, noise


def test_texts_of_options_are_single_lines(call: Call) -> None:
    """Else each further line of one is a candidate of completion, and help has ragged lines."""
    _, script, _ = call("--tyro-print-completion", "bash")
    (spec,) = re.findall(r"^COMPLETION_SPEC = (.*)$", script, re.MULTILINE)

    def texts_of(command: dict[str, Any]) -> Iterator[str]:
        yield from (option["description"] for option in command["options"])
        for one in command["subcommands"].values():
            yield from texts_of(one)

    texts = list(texts_of(ast.literal_eval(spec)))
    assert len(texts) > 200
    for noise in ("\n", "  ", "None)", "%%"):
        assert [text for text in texts if noise in text] == []


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash here")
def test_bash_completes_programs_studies_and_options(tmp_path: Path, call: Call) -> None:
    status, script, _ = call("--tyro-print-completion", "bash")
    assert status == 0
    (tmp_path / "complete.sh").write_text(script)

    def completed(*words: str) -> set[str]:
        typed = " ".join(map(shlex.quote, words))
        ask = f"source complete.sh; COMP_WORDS=({typed}); COMP_CWORD={len(words) - 1}"
        find = "complete -p ssmr | sed 's/.*-F \\([^ ]*\\).*/\\1/'"
        ask += f"; $({find}); printf '%s\\n' \"${{COMPREPLY[@]}}\""
        # the script asks for a python3, as an environment has
        path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
        env = {**os.environ, "PATH": path}
        done = subprocess.run(
            ["bash", "-c", ask], capture_output=True, text=True, cwd=tmp_path, timeout=60, env=env
        )
        return {word.split("\t")[0].strip() for word in done.stdout.splitlines()}

    assert completed("ssmr", "") == {*ssmr.PROGRAMS, "-h", "--help", "--version"}
    assert "check" in completed("ssmr", "robots", "")
    assert completed("ssmr", "compare", "--plan") == {"--plants"}
    assert completed("ssmr", "compare", "--input", "") == {"commands", "wheels"}
    assert all(word.startswith("-") for word in completed("ssmr", "fit", ""))
