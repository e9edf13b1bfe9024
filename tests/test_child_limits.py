"""Child processes that read foreign files: time of the processor counts, never the clock."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pytest

from tests import child_work
from tests.bag_factory import circle, write
from tests.conftest import Launch, processor_time
from tests.urdf_factory import UrdfRobot
from validation.descriptions.importing import import_robot
from validation.files import bags, guarded
from validation.files.formats import read_log
from validation.simulator import foreign
from validation.simulator.description import models_folder

pytestmark = pytest.mark.usefixtures("with_children")

ALLOWED = (1.0, 1 << 30, 0)
START_S = 1.5
"""Time of the processor that starting the child may take, and rounding the limit up [s]."""


def test_what_does_not_end_has_its_time_of_the_processor() -> None:
    began = processor_time()
    with pytest.raises(ValueError, match="more than the 1 s of processor time allowed"):
        guarded.ask(child_work.spin, [], ALLOWED)
    assert ALLOWED[0] < processor_time() - began < ALLOWED[0] + START_S


def test_what_waits_is_not_refused_however_long_it_takes() -> None:
    assert guarded.ask(child_work.rest, [1.5 * ALLOWED[0]], ALLOWED) == ("rested", [])


def test_nothing_waits_for_a_pipe(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ValueError, match="pipe is a pipe, wanted a file"):
        guarded.ask(child_work.read, [str(tmp_path / "pipe")], ALLOWED)


def test_a_process_without_limits_watches_its_own_time() -> None:
    """As on Windows."""
    code = (
        "import os; os.name = 'other'; from validation.files.guarded import _limit_process; "
        "_limit_process(0.2, 0, 0); from tests.child_work import spin; spin()"
    )
    ended = subprocess.run([sys.executable, "-c", code], check=False)
    assert ended.returncode == guarded._SPENT


def test_sound_files_are_read_on_a_busy_machine(
    tmp_path: Path, launch: Launch, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bag, a URDF and an MJCF, beside sixteen processes that spin."""
    monkeypatch.setattr(bags, "_SECONDS", ALLOWED[0])
    monkeypatch.setattr(foreign, "ALLOWANCE", (ALLOWED[0], 2 << 30, 0))
    bag = write(tmp_path, "mcap", circle())
    (tmp_path / "r.urdf").write_text(UrdfRobot().text())
    mjcf = (models_folder() / "husky.xml").read_text(encoding="utf-8")
    for _ in range(16):
        # a little nice, or this would take half a minute on two cores
        launch([sys.executable, "-c", "import os; os.nice(5)\nwhile True: pass"])
    reads: list[Callable[[], object]] = [
        partial(read_log, bag),
        partial(import_robot, tmp_path / "r.urdf"),
        partial(foreign.try_compiling, mjcf),
    ]
    with ThreadPoolExecutor(len(reads)) as pool:
        for reading in [pool.submit(read) for read in reads]:
            assert reading.result()
