"""A program's streams, signals, temporary files and faults, as its surroundings see them."""

from __future__ import annotations

import json
import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import mujoco
import pytest

from ssmr import _jit
from ssmr.errors import SsmrError
from tests.conftest import Launch
from validation import cli, store
from validation.simulator.parts import mujoco_failures

ROOT = Path(__file__).resolve().parents[1]
PROGRAM = """
import sys, time
from pathlib import Path
from validation import cli, store
def main(out: Path, /) -> None:
    try:
        print("ready", flush=True)
        time.sleep(60)
    except KeyboardInterrupt:
        store.write_text(out, "kept")
        raise
cli.run(main, "program")
"""


@pytest.fixture
def start(launch: Launch) -> Launch:
    """A maker of processes that run the text of a program."""

    def program(text: str, *arguments: str, **options: object) -> subprocess.Popen[str]:
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options}
        return launch([sys.executable, "-c", text, *arguments], env=environment, text=True, **streams)

    return program


@pytest.mark.usefixtures("hangup")
@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGINT, 130)])
def test_a_signal_ends_the_work_and_keeps_the_result(
    start: Launch, number: signal.Signals, status: int, tmp_path: Path
) -> None:
    process = start(PROGRAM, str(tmp_path / "kept.txt"))
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(number)
    _, said = process.communicate(timeout=30)
    assert (process.returncode, said) == (
        status,
        "interrupted\n" if status == 130 else f"ended by {signal.Signals(number).name}\n",
    )
    assert [p.name for p in tmp_path.iterdir()] == ["kept.txt"]


def test_under_nohup_a_hangup_is_ignored(start: Launch, tmp_path: Path) -> None:
    ignoring = "import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)\n" + PROGRAM
    process = start(ignoring, str(tmp_path / "kept.txt"))
    assert process.stdout is not None
    process.stdout.readline()
    process.send_signal(signal.SIGHUP)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.3)


def test_closed_streams_do_no_harm(tmp_path: Path) -> None:
    """A file that took the number of a closed stream would get what is printed."""
    program = "from validation import cli, store; from pathlib import Path\n"
    program += "def main(out: Path, /) -> None:\n    store.write_text(out, 'x'); print('printed'); cli.warn('warned')\n"
    program += "cli.run(main, 'program')"
    out = tmp_path / "out.txt"
    command = f'{sys.executable} -c "$PROGRAM" {out} >&- 2>&- <&-'
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PROGRAM": program}
    assert subprocess.run(["sh", "-c", command], env=environment, timeout=60, check=False).returncode == 0
    assert out.read_text() == "x"


def test_a_reader_that_leaves_is_no_failure(start: Launch) -> None:
    program = "from validation.cli import run\ndef main() -> None:\n    print('x' * 10**6)\nrun(main, 'program', [])"
    process = start(program)
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    said = process.stderr.read()
    process.stderr.close()
    assert (process.wait(60), said) == (0, "")


def test_a_fault_of_the_program_is_one_line_and_a_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))

    def main() -> None:
        with cli.mistakes_are_users():
            json.loads("no json")  # a ValueError that nobody foresaw is no mistake of the user

    with pytest.raises(SystemExit) as left:
        cli.run(main, "program", [])
    assert left.value.code == cli.EXIT_FAULT
    (line,) = capsys.readouterr().err.splitlines()
    (report,) = tmp_path.iterdir()
    assert line.startswith("program has a fault (JSONDecodeError: ")
    assert str(report) in line
    assert stat.S_IMODE(report.stat().st_mode) == 0o600
    text = report.read_text()
    assert all(part in text for part in ("Traceback", "json.loads", "mujoco 3", "command: "))


@pytest.mark.parametrize(
    ("error", "status"), [(SsmrError("it diverged"), 1), (MemoryError(), 1), (OSError(28, "disk is full", "x.json"), 1)]
)
def test_failed_runs_have_their_status(error: Exception, status: int, capsys: pytest.CaptureFixture[str]) -> None:
    def main() -> None:
        raise error

    with pytest.raises(SystemExit) as left:
        cli.run(main, "program", [])
    assert left.value.code == status
    assert capsys.readouterr().err.startswith("run failed: ")


# ------------------------------------------------------------------------------------------- files
def test_a_failure_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    store.write_text(path, "old")

    def fail(temporary: Path) -> None:
        temporary.write_text("half")
        raise OSError(28, "disk is full")

    with pytest.raises(OSError, match="disk is full"):
        store.write_atomic(path, fail)
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]
    assert path.read_text() == "old"


def test_a_file_is_on_the_disk_before_it_takes_its_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After a power cut there is the old file or the new one, never a name without contents."""
    done: list[str] = []
    replace, synchronise = os.replace, os.fsync
    monkeypatch.setattr(os, "replace", lambda a, b: (done.append("rename"), replace(a, b)))
    monkeypatch.setattr(
        os, "fsync", lambda fd: (done.append("folder" if stat.S_ISDIR(os.fstat(fd).st_mode) else "file"), synchronise(fd))
    )
    store.write_text(tmp_path / "a.txt", "text")
    assert done == ["file", "rename", "folder"]


# ------------------------------------------------------------------------------------------- compiled code
def cache_folder(monkeypatch: pytest.MonkeyPatch, cache: Path) -> str:
    """The folder that is chosen where the package cannot be written."""
    monkeypatch.setattr(_jit.config, "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    monkeypatch.setattr(_jit, "_PACKAGE", Path("/proc/nowhere"))
    return _jit._cache_folder()


@pytest.mark.parametrize("planted", ["writable", "writable above", "link", "foreign"])
def test_compiled_code_of_others_is_not_trusted(planted: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Numba unpickles what lies there, and whoever may write above it can swap it."""
    folder = Path(cache_folder(monkeypatch, tmp_path))
    if planted.startswith("writable"):
        (folder if planted == "writable" else folder.parent).chmod(0o777)
    elif planted == "link":
        folder.rmdir()
        (tmp_path / "other").mkdir(mode=0o700)
        folder.symlink_to(tmp_path / "other")
    elif os.geteuid() == 0:
        os.chown(folder, 12345, 12345)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: 12345)
    assert cache_folder(monkeypatch, tmp_path) == ""


def test_ctrl_c_while_a_program_is_loaded_is_no_traceback(start: Launch) -> None:
    """Python calls the first argument `-m` as long as it loads what it was asked for."""
    process = start("import sys, time; sys.argv = ['-m']; import validation; print('loading', flush=True); time.sleep(30)")
    assert process.stdout is not None
    process.stdout.readline()
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=20)
    assert (process.returncode, said) == (-signal.SIGINT, "")


def test_a_signal_that_comes_while_numba_compiles_is_kept_until_it_has(start: Launch, tmp_path: Path) -> None:
    """Its compiler swallows an interrupt; the program would go on as if nothing had been asked."""
    program = """
import numba, time
from validation import cli
from llvmlite.binding import executionengine
def slow(*arguments):
    print("compiling", flush=True)
    time.sleep(0.5)
    print("compiled", flush=True)
exec("def compile_for(slow):\\n    slow()", vars(executionengine))
def main() -> None:
    executionengine.compile_for(slow)
    time.sleep(30)
cli.run(main, "program", [])
"""
    process = start(program)
    assert process.stdout is not None
    assert process.stdout.readline() == "compiling\n"
    process.send_signal(signal.SIGTERM)
    said, warned = process.communicate(timeout=20)
    assert (process.returncode, said, warned) == (143, "compiled\n", "ended by SIGTERM\n")


def interrupt(touched: Path | None) -> None:
    if touched is not None:
        touched.touch()
    raise KeyboardInterrupt


SWALLOWED = {
    "the end of an object's life": (
        """
class Short:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)
Short()
time.sleep(20.0)
""",
        "interrupted",
        130,
    ),
    "a library": ("keep(lambda: json.loads('{'))", "ended by SIGTERM", 143),
    "nobody: a fault of this project's own": ("keep(lambda: Wanted())", "has a fault", 70),
}
"""Work, by what becomes of the interrupt in it; what is said then, and the exit status."""


@pytest.mark.parametrize("by", SWALLOWED)
def test_an_interrupt_that_is_swallowed_ends_the_work_all_the_same(by: str, tmp_path: Path) -> None:
    work, said, status = SWALLOWED[by]
    program = f"""
import json, signal, time
from validation import cli
def Wanted():
    raise ZeroDivisionError("of the project")
def keep(then):
    try:
        signal.raise_signal(signal.SIGTERM)
    except KeyboardInterrupt:
        then()
def main() -> None:
    \"\"\"Work.\"\"\"
    exec(WORK)
WORK = {work!r}
cli.run(main, "the program", [])
"""
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, timeout=60, check=False
    )
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    assert done.returncode == status


# ------------------------------------------------------------------------------------------- memory


def test_what_else_mujoco_cannot_do_is_a_failed_run() -> None:
    with pytest.raises(SsmrError, match="mujoco gave up: mj_stackAlloc: insufficient memory"), mujoco_failures():
        raise mujoco.FatalError("mj_stackAlloc:\n insufficient memory")
