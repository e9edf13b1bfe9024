"""A program's streams, signals, temporary files and faults, as its surroundings see them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from ssmr import _jit
from ssmr.errors import SsmrError
from tests.appendices import is_possible
from tests.conftest import Launch
from validation import cli, output

ROOT = Path(__file__).resolve().parents[1]
PROGRAM = """
import sys, time
from pathlib import Path
from validation import cli, output
def main(out: Path, /) -> None:
    try:
        print("ready", flush=True)
        time.sleep(60)
    except KeyboardInterrupt:
        output.write_text(out, "kept")
        raise
cli.run_command(main, "program")
"""


@pytest.fixture
def start(launch: Launch) -> Launch:
    """A maker of processes that run the text of a program."""

    def program(text: str, *arguments: str, **options: object) -> subprocess.Popen[str]:
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options}
        return launch(
            [sys.executable, "-c", text, *arguments], env=environment, text=True, **streams
        )

    return program


@pytest.mark.usefixtures("hangup")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_signal_ends_the_work_and_keeps_the_result(
    start: Launch, number: signal.Signals, tmp_path: Path
) -> None:
    process = start(PROGRAM, str(tmp_path / "kept.txt"))
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(number)
    _, message = process.communicate(timeout=30)
    assert (process.returncode, message) == (130, "interrupted\n")
    assert [p.name for p in tmp_path.iterdir()] == ["kept.txt"]


def test_under_nohup_a_hangup_is_ignored(start: Launch, tmp_path: Path) -> None:
    ignoring = "import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)\n" + PROGRAM
    process = start(ignoring, str(tmp_path / "kept.txt"))
    assert process.stdout is not None
    process.stdout.readline()
    process.send_signal(signal.SIGHUP)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.3)


def test_a_reader_that_leaves_is_no_failure(start: Launch) -> None:
    program = (
        "from validation.cli import run_command\n"
        "def main() -> None:\n"
        "    print('x' * 10**6)\n"
        "run_command(main, 'program', [])"
    )
    process = start(program)
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    message = process.stderr.read()
    process.stderr.close()
    assert (process.wait(60), message) == (0, "")


def test_a_fault_of_the_program_is_told_from_a_mistake(capsys: pytest.CaptureFixture[str]) -> None:
    def main() -> None:
        json.loads("no json")  # a ValueError that nobody foresaw is no mistake of the user

    with pytest.raises(SystemExit) as left:
        cli.run_command(main, "program", [])
    assert left.value.code == cli.EXIT_FAULT
    message = capsys.readouterr().err
    assert "Traceback" in message
    assert message.splitlines()[-1].startswith("program has a fault; ")


@pytest.mark.parametrize(
    ("error", "status"),
    [(SsmrError("it diverged"), 1), (MemoryError(), 1), (OSError(28, "disk is full", "x.json"), 1)],
)
def test_failed_runs_have_their_status(
    error: Exception, status: int, capsys: pytest.CaptureFixture[str]
) -> None:
    def main() -> None:
        raise error

    with pytest.raises(SystemExit) as left:
        cli.run_command(main, "program", [])
    assert left.value.code == status
    assert capsys.readouterr().err.startswith("run failed: ")


# ------------------------------------------------------------------------------------------- files
def test_a_failure_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    output.write_text(path, "old")

    def fail(temporary: Path) -> None:
        temporary.write_text("half")
        raise OSError(28, "disk is full")

    with pytest.raises(OSError, match="disk is full"):
        output.write_atomic(path, fail)
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]
    assert path.read_text() == "old"


# -------------------------------------------------------------------------------------------
# compiled code
def test_compiled_code_is_kept_where_nobody_else_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numba unpickles what lies there."""
    monkeypatch.setattr(_jit.config, "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = Path(_jit._cache_folder())
    assert folder.parent == tmp_path / "cache"
    assert folder.stat().st_mode & 0o777 == 0o700
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert _jit._cache_folder() == ""


PROGRAMS = ("compare", "fit", "calibrate", "track", "tune", "recordings", "robots", "study", "ros")
"""Without `replicate`, whose package has its function and so loads it before its program begins."""


@pytest.mark.parametrize(
    "name", ["validation", *(f"validation.{name}" for name in filter(is_possible, PROGRAMS))]
)
def test_ctrl_c_while_a_program_loads_its_libraries_has_no_traceback(
    name: str, launch: Launch, tmp_path: Path
) -> None:
    slow = "import time; print('loading', flush=True); time.sleep(30)"
    for library in ("numpy", "tyro", "rich"):
        (tmp_path / f"{library}.py").write_text(slow, encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    command = [sys.executable, "-m", name, "compare"]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = launch(command, env=environment, text=True, cwd=tmp_path, **streams)
    assert process.stdout is not None
    assert process.stdout.readline() == "loading\n"
    process.send_signal(signal.SIGINT)
    _, message = process.communicate(timeout=20)
    assert (process.returncode, message) == (-signal.SIGINT, "")


def test_importing_the_package_changes_no_signal(start: Launch) -> None:
    text = (
        "import signal, validation, validation.compare, validation.fit; "
        "print(signal.getsignal(signal.SIGINT))"
    )
    said, _ = start(text).communicate(timeout=60)
    assert "default_int_handler" in said


# ------------------------------------------------------------------------------------------- memory
