"""Settings of the test run: number of processes, order of tests, loss of a process."""

from __future__ import annotations

import os
import time
from collections import Counter
from typing import Any

import pytest
from numba.core import event

FIRST = ("test_closed_loop.py", "test_lanes.py", "test_faults.py")
"""Files that begin: one worker compiles the control loop while the other compiles the models, and
no work is done twice. The longest of all tests comes next."""


class Compiling(event.Listener):
    """Adds up the processor time for which this process compiles."""

    depth = 0
    began = 0.0
    total = 0.0

    def on_start(self, event: event.Event) -> None:
        """A function is compiled; others may be meanwhile, for which it waits."""
        if self.depth == 0:
            self.began = time.process_time()
        self.depth += 1

    def on_end(self, event: event.Event) -> None:
        """It is compiled."""
        self.depth -= 1
        if self.depth == 0:
            self.total += time.process_time() - self.began


COMPILING = Compiling()
WORKERS_COMPILED: list[float] = []
"""Processor times that the workers spent on compiling, as each reports its own [s]."""


def pytest_configure(config: pytest.Config) -> None:
    """The order below is kept, and compiling is timed."""
    config.option.loadscopereorder = False
    event.register("numba:compile", COMPILING)


def compiling_time() -> float:
    """The processor time for which this process and its workers have compiled [s]."""
    return sum(WORKERS_COMPILED) + COMPILING.total


def pytest_sessionfinish(session: pytest.Session) -> None:
    """A worker tells how long it compiled."""
    told = getattr(session.config, "workeroutput", None)
    if told is not None:
        told["compiling_s"] = compiling_time()


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """With an empty cache, that is part of what the tests take."""
    terminalreporter.write_line(f"compiling took {compiling_time():.0f} s of the processor's time")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """After the files that compile come those with the most tests, so no long one is left."""
    sizes = Counter(item.path for item in items)
    items.sort(key=lambda item: (item.path.name not in FIRST, -sizes[item.path], item.path))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """The whole suite takes all cores, at most four.

    Files that are named run in this process and start at once.
    """
    whole = config.args_source is pytest.Config.ArgsSource.TESTPATHS
    return min(4, os.cpu_count() or 1) if whole else 0


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any, error: object | None) -> None:
    """A worker that dies fails the run, also where it had no test to fail."""
    WORKERS_COMPILED.append(getattr(node, "workeroutput", {}).get("compiling_s", 0.0))
    if error:
        node.config.pluginmanager.get_plugin("session").testsfailed += 1
