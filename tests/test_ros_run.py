"""Drives through the command line on a port that is none: what is left of them, however they end."""

from __future__ import annotations

import functools
import json
import math
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.ros_fakes import FakeClock, FakePort, make
from validation import cli
from validation.ros import messages as msg
from validation.ros import run as running
from validation.ros.__main__ import _STOPPING, PROGRAM, _Interrupt
from validation.ros.control import ControlNode, RobotTopics

TOPICS = RobotTopics()
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Drive:
    """A robot that follows any speed on a line, and a command line that drives it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, out: Path) -> None:
        self.out, self.clock, self.path = out, FakeClock(), out.parent / "way.csv"
        self.path.write_text("x,y\n0,0\n1,0\n2,0\n", encoding="utf-8")  # 8 s
        self.port = FakePort(self.clock)
        monkeypatch.setattr(running, "open_port", lambda name, graph: self.port)
        monkeypatch.setattr(running, "ControlNode", functools.partial(ControlNode, clock=self.clock))

    def speak(self, until: float) -> None:
        """Let odometry come for some seconds."""
        for k in range(round(50.0 * until)):
            t = 0.02 * k
            message = make("nav_msgs/Odometry")
            x = 0.25 * max(t - 0.1, 0.0)
            msg.fill_odometry(message, t + 1.0, np.array([x, 0.0, 0.0]), (0.0, 0.0), np.eye(3), np.eye(3))
            self.port.plan(TOPICS.odometry, t, message)

    def interrupt_at(self, instant: float, *numbers: int) -> None:
        """Let signals come with the commands after some seconds."""
        ordinary, left = self.port.send, list(numbers)

        def send(topic: str, fill: Any) -> None:
            ordinary(topic, fill)
            if self.clock() >= 100.0 + instant and left:
                os.kill(os.getpid(), left.pop(0))

        self.port.send = send  # type: ignore[method-assign]

    def run(self) -> int:
        """Drive; the exit status."""
        handlers = {n: signal.getsignal(n) for n in SIGNALS}
        try:
            cli.run(PROGRAM, "ros", ("control", "pid", str(self.path), "--speed", "0.25", "--out", str(self.out)))
        except SystemExit as ended:
            return int(ended.code or 0)
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
        return 0

    def document(self) -> dict[str, Any]:
        """What track.json holds."""
        found: dict[str, Any] = json.loads((self.out / "track.json").read_text(encoding="utf-8"))
        return found

    def stood(self) -> bool:
        """Whether the robot was told to stand at the end, and for how long it should be."""
        return [msg.read_twist(m) for _, m in self.port.of(TOPICS.command)][-9:] == [(0.0, 0.0)] * 9


@pytest.fixture
def drive(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Drive:
    return Drive(monkeypatch, tmp_path / "out")


def test_a_drive_that_arrives_says_so(drive: Drive) -> None:
    drive.speak(9.0)
    assert drive.run() == 0
    assert (drive.document()["status"], drive.document()["stopped_because"]) == ("arrived", "")
    assert drive.stood()


@pytest.mark.usefixtures("hangup")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_stop_the_robot_and_keep_the_drive(drive: Drive, capsys: pytest.CaptureFixture[str], number: int) -> None:
    """Others that come while the robot is being stopped change nothing."""
    drive.speak(9.0)
    drive.interrupt_at(4.0, number, signal.SIGINT, signal.SIGTERM)
    assert drive.run() == 128 + number
    found = drive.document()
    assert found["status"] == "interrupted"
    assert found["schema"] == "ssmr.track/1"
    assert math.isfinite(found["metrics"]["d_rms_m"])
    assert (drive.out / "track.png").is_file()
    assert drive.stood()
    assert drive.port.closed
    said = capsys.readouterr()
    assert "ended before the reference did (interrupted)" in " ".join(said.out.split())
    ended = "interrupted" if number == signal.SIGINT else f"ended by {signal.Signals(number).name}"
    assert said.err.strip().splitlines()[-1] == ended


def test_a_drive_that_had_to_be_stopped_is_kept_too(drive: Drive, capsys: pytest.CaptureFixture[str]) -> None:
    drive.speak(3.0)
    assert drive.run() == 1
    found = drive.document()
    assert found["status"] == "stopped"
    assert "no feedback" in found["stopped_because"]
    assert capsys.readouterr().err.strip().splitlines()[-1] == f"run failed: {found['stopped_because']}"
    assert drive.stood()


@pytest.mark.parametrize("instant", [0.14, 0.2, 0.3])
def test_whatever_there_is_of_a_short_drive_is_kept(drive: Drive, instant: float) -> None:
    """A robot that has not moved yet has a path without length."""
    drive.speak(9.0)
    drive.interrupt_at(instant, signal.SIGINT)
    assert drive.run() == 130
    assert drive.document()["status"] == "interrupted"
    assert drive.stood()


def test_who_was_never_driven_leaves_nothing(drive: Drive, capsys: pytest.CaptureFixture[str]) -> None:
    assert drive.run() == 1
    assert not (drive.out / "track.json").exists()
    assert "no robot to drive after 30 s" in capsys.readouterr().err


@pytest.fixture
def handlers() -> Iterator[None]:
    """Handlers of signals, put back afterwards."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("handlers")
def test_signals_in_the_moments_after_the_first_are_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    interrupt, now = _Interrupt(), [50.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    with pytest.raises(KeyboardInterrupt):
        interrupt(signal.SIGINT, None)
    interrupt(signal.SIGTERM, None)
    now[0] += _STOPPING + 0.1
    with pytest.raises(KeyboardInterrupt):
        interrupt(signal.SIGTERM, None)


@pytest.mark.usefixtures("handlers")
def test_what_was_to_be_ignored_stays_so_but_for_ctrl_c() -> None:
    """As under nohup; a shell without job control ignores Ctrl-C for programs in the background."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    interrupt = _Interrupt()
    assert [signal.getsignal(number) is interrupt for number in SIGNALS] == [True, False, False]
