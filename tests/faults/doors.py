"""The three doors through which a case goes: a call, a program in this process, and a program as a process of its own."""

from __future__ import annotations

import contextlib
import gc
import io
import logging
import os
import re
import runpy
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ssmr.errors import SsmrError
from tests.faults.judge import FAULT, LONGEST_WAIT, Outcome, files_in, finite
from validation.cli.process import _compiles

ROOT = Path(__file__).resolve().parents[2]
HOOKS = Path(__file__).parent / "hooks"
NOBODY = 65534
"""User and group who own nothing."""
_READS = "+dac_read_search"
AS_NOBODY = (
    "setpriv",
    f"--reuid={NOBODY}",
    f"--regid={NOBODY}",
    "--clear-groups",
    f"--inh-caps={_READS}",
    f"--ambient-caps={_READS}",
)
_TICK = 1.0
"""Time between two looks at a case that runs [s]."""
_IDLE = 1e-3
"""Processor's time within a tick below which a case only waits [s]; on a busy machine it gets more than that."""
_LONGEST_IDLE = 90.0
"""Time of waiting after which a case hangs [s]."""


class Broken(Exception):
    """A promise that a case found broken: its class of faults and what was seen."""

    def __init__(self, kind: str, text: str) -> None:
        """Keep both."""
        super().__init__(text)
        self.kind = kind


class Hang(BaseException):
    """It takes too long."""


@contextlib.contextmanager
def time_limit(limit: float = LONGEST_WAIT) -> Iterator[None]:
    """Within, raise `Hang` from what takes the processor for longer than this [s], or waits without end.

    Neither the time that other processes take is counted nor that of compiling, which the first case does for all.
    """
    now = time.process_time()
    began, last, active = now, now, time.monotonic()

    def look(*_: object) -> None:
        nonlocal began, last, active
        now, clock = time.process_time(), time.monotonic()
        if any(map(_compiles, sys._current_frames().values())):
            began = now
        if now - last > _IDLE:
            active = clock
        last = now
        if now - began > limit or clock - active > _LONGEST_IDLE:
            raise Hang

    before = signal.signal(signal.SIGALRM, look)
    signal.setitimer(signal.ITIMER_REAL, _TICK, _TICK)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def call(what: str, function: Callable[[], Any], limit: float = LONGEST_WAIT) -> Outcome:
    """Call a function of the library: `ValueError` or `SsmrError` of one line is a refusal, a finite value is right."""
    out = Outcome(what)
    try:
        with time_limit(limit), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # numpy's, on numbers that are refused later; programs are judged by them
            value = function()
        if not finite(value):
            out.fault("non-finite", "a number that is not finite was let through")
    except (ValueError, SsmrError) as error:
        out.status, out.stderr = 2, f"error: {error}"
    except Hang:
        out.status, out.hung = None, True
    except MemoryError:
        out.status, out.stderr = 1, "run failed: there is not enough memory"
    except Broken as broken:
        out.fault(broken.kind, broken)
    except Exception as error:  # noqa: BLE001 - whatever else is raised is what is looked for
        out.status = 1
        out.fault("traceback", f"{type(error).__name__}: {error}")
        out.stderr = "run failed: "
    return out


def program(what: str, name: str, argv: Sequence[str], folder: Path) -> Outcome:
    """Run a program in this process, whole, in a folder; the streams have the encodings and the strictness of real ones."""
    raw = {"stdout": io.BytesIO(), "stderr": io.BytesIO()}
    out = Outcome(what, folder=folder, before=frozenset(files_in(folder)), foreign=" ".join(argv))
    with _as_it_was(), contextlib.ExitStack() as stack:
        stdout = io.TextIOWrapper(raw["stdout"], encoding="utf-8", errors="strict", write_through=True)
        stderr = io.TextIOWrapper(raw["stderr"], encoding="utf-8", errors="backslashreplace", write_through=True)
        stack.enter_context(contextlib.redirect_stdout(stdout))
        stack.enter_context(contextlib.redirect_stderr(stderr))
        os.chdir(folder)
        sys.argv = [name, *argv]
        try:
            with time_limit(), warnings.catch_warnings():
                warnings.simplefilter("default")
                runpy.run_module(f"validation.{name}", run_name="__main__", alter_sys=True)
        except SystemExit as left:
            out.status = left.code if isinstance(left.code, int) else int(left.code is not None)
        except Hang:
            out.status, out.hung = None, True
        except BaseException as error:  # noqa: BLE001 - whatever else is raised is what is looked for
            out.status = 1
            out.fault("traceback", f"{type(error).__name__}: {error}")
        stdout.flush()
        stderr.flush()
        stdout.detach()
        stderr.detach()
    out.stdout = raw["stdout"].getvalue().decode("utf-8", "surrogateescape")
    out.stderr = raw["stderr"].getvalue().decode("utf-8", "surrogateescape")
    return _with_report(out)


def _with_report(out: Outcome) -> Outcome:
    """Put the end of a report on a fault of the program in its place."""
    if found := re.search(r"\S*ssmr-report-\w+\.txt", out.stderr) if out.status == FAULT else None:
        report = Path(found[0])
        lines = report.read_text().strip().splitlines()
        report.unlink()
        places = [line.strip() for line in lines if "validation" in line or "ssmr" in line]
        out.stderr = f"{places[-1] if places else ''} {lines[-1]}"
    return out


@contextlib.contextmanager
def _as_it_was() -> Iterator[None]:
    """Within, a program may change what belongs to the process; afterwards it is as it was."""
    cwd, argv, meta, environment = os.getcwd(), sys.argv, sys.meta_path[:], dict(os.environ)
    numbers = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE]
    handlers, threshold, hook = {n: signal.getsignal(n) for n in numbers}, gc.get_threshold(), sys.excepthook
    root = logging.getLogger()
    logs, level = root.handlers[:], root.level
    root.handlers[:] = []
    programs = {k: sys.modules.pop(k) for k in list(sys.modules) if k.endswith(".__main__")}  # runpy warns of them
    try:
        yield
    finally:
        os.chdir(cwd)
        sys.argv, sys.meta_path[:], sys.excepthook = argv, meta, hook
        os.environ.clear()
        os.environ.update(environment)
        sys.modules.update(programs)
        gc.set_threshold(*threshold)
        root.handlers[:], root.level = logs, level
        for number, handler in handlers.items():
            signal.signal(number, handler)
        if "matplotlib.pyplot" in sys.modules:
            sys.modules["matplotlib.pyplot"].close("all")


def environment(hooked: bool = False, **changes: str | None) -> dict[str, str]:
    """Return the environment of a process: this one's with some variables changed, or left out where they are None."""
    path = os.pathsep.join([str(HOOKS), str(ROOT)] if hooked else [str(ROOT)])
    made = {**os.environ, "PYTHONPATH": path, **{k: v for k, v in changes.items() if v is not None}}
    return {k: v for k, v in made.items() if changes.get(k, "") is not None}


def process(
    what: str,
    argv: Sequence[str],
    folder: Path,
    *,
    env: Mapping[str, str] | None = None,
    timeout: float = 300.0,
    before_it: Callable[[], None] | None = None,
    meanwhile: Callable[[subprocess.Popen[bytes]], None] | None = None,
    stdout: Any = subprocess.PIPE,
    as_nobody: bool = False,
) -> Outcome:
    """Run `python -m ARGV` in a folder as a user would; `meanwhile` is called once it runs, `before_it` inside it.

    As nobody, it may read everything, wherever Python is installed, and write only what anybody may.
    """
    out = Outcome(what, folder=folder, before=frozenset(files_in(folder)), foreign=" ".join(argv))
    command = [*(AS_NOBODY if as_nobody and os.getuid() == 0 else ()), sys.executable, "-m", *argv]
    streams = {"stdin": subprocess.DEVNULL, "stdout": stdout, "stderr": subprocess.PIPE}
    with subprocess.Popen(
        command, cwd=folder, env=env or environment(), preexec_fn=before_it, start_new_session=True, **streams
    ) as running:
        try:
            if meanwhile is not None:
                meanwhile(running)
            said, faults = running.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            os.killpg(running.pid, signal.SIGKILL)
            said, faults = running.communicate()
            out.hung = True
    out.status = None if out.hung else running.returncode
    out.stdout, out.stderr = (said or b"").decode("utf-8", "replace"), faults.decode("utf-8", "replace")
    return _with_report(out)
