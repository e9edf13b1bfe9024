"""The command line `python -m validation.ros sim|control`."""

from __future__ import annotations

if __name__ == "__main__":
    from validation.interrupts import end_quietly

    end_quietly()

import contextlib
import inspect
import signal
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Annotated, Any

import tyro

from validation import cli, output
from validation.output import file_name
from validation.report.report import INTERRUPTED
from validation.ros.control import Control, control
from validation.ros.simulation import Sim, sim


def _sim(options: Annotated[Sim, tyro.conf.arg(name="")]) -> None:
    with _one_signal_ends():
        sim(options)


def _control(options: Annotated[Control, tyro.conf.arg(name="")]) -> None:
    with _one_signal_ends() as ignore_signals:
        folder = Path(options.out or "runs/ros")
        cli.require_writable(folder)
        cli.require_apart(options, folder, ("track.json", "track.png"))
        report = replace(control(options), config=cli.config_of("control", options))
        ignore_signals()
        name = file_name(f"{report.controller}-{report.reference}")
        folder = Path(options.out or f"runs/ros/{name}")
        cli.report_result(report, report.save(output.make_folder(folder), recording=False))
    report.require_complete()
    if report.status == INTERRUPTED:
        raise KeyboardInterrupt


@contextlib.contextmanager
def _one_signal_ends() -> Iterator[Callable[[], None]]:
    """Let one signal end a node as Ctrl-C does, and none disturb the stop and the saving.

    Yields:
        The function after whose call no signal disturbs any more.
    """
    before: dict[int, Any] = {number: signal.getsignal(number) for number in cli.ENDING}

    def ignore() -> None:
        for number in before:
            signal.signal(number, signal.SIG_IGN)

    def end(number: int, frame: FrameType | None) -> None:
        ignore()
        raise KeyboardInterrupt

    # A shell without job control has programs in the background ignore Ctrl-C.
    for number, handler in before.items():
        if number == signal.SIGINT or handler is not signal.SIG_IGN:
            signal.signal(number, end)
    try:
        yield ignore
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


for _command, _node in ((_sim, sim), (_control, control)):
    _command.__doc__ = inspect.getdoc(_node)
    _command.__name__ = _node.__name__
PROGRAM: Mapping[str, Callable[[Any], None]] = {"sim": _sim, "control": _control}

if __name__ == "__main__":
    cli.run_command(PROGRAM, "python -m validation.ros")
