"""Round trips of odometry over DDS, idle and busy: `python -m benchmarks.ros` (extra `ros2`).

A second process sends back whatever comes, as a robot answers a controller. Times are those of one
clock, in this process.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.rows import MissingError, Row, measure_if_installed, report_rows
from validation import cli
from validation.ros import messages as msg
from validation.ros.dds import Graph, Node

RATE = 100.0
"""Messages a second, twice as many as a Husky's odometry."""
_THERE = "/there"
_BACK = "/back"
_KIND = "nav_msgs/msg/Odometry"


def _connect_node(name: str, domain: int, sent: str, heard: str) -> Node:
    """Return a node that sends odometry on one topic and receives it on another."""
    try:
        node = Node(name, Graph(domain=domain))
    except ValueError as error:
        raise MissingError(str(error)) from error
    node.advertise(sent, _KIND)
    node.subscribe(heard, _KIND, lambda m: msg.read_odometry(m)[0], 32)
    return node


def _send_odometry(node: Node, topic: str, stamp: float) -> None:
    """Send an odometry whose stamp [s] tells it from others."""
    node.publish(topic, msg.odometry_message(stamp, np.zeros(3), (0.1, 0.2), np.eye(3), np.eye(3)))


def echo_messages(domain: int) -> None:
    """Send back every message, without end."""
    node = _connect_node("echo", domain, _BACK, _THERE)
    while True:
        for _, stamp in node.receive(1.0):
            _send_odometry(node, _BACK, stamp)


@contextlib.contextmanager
def _running_processes(codes: Sequence[str]) -> Iterator[None]:
    """Yield processes of Python that run these lines, killed at the end."""
    started = [subprocess.Popen([sys.executable, "-c", code]) for code in codes]
    try:
        yield
    finally:
        for process in started:
            process.kill()
            process.wait()


def _round_trips(node: Node, count: int, busy: int) -> Row:
    """Send `count` messages while `busy` processes compute; count and time those that return."""
    trips = []
    with _running_processes(["while True: pass"] * busy):
        start = time.monotonic()
        began = time.process_time()
        for k in range(count + int(RATE)):  # and a second for the last ones
            if k < count:
                _send_odometry(node, _THERE, time.monotonic())
            while (left := start + (k + 1) / RATE - time.monotonic()) > 0.0:
                for _, stamp in node.receive(left):
                    if stamp >= start:
                        trips.append(time.monotonic() - stamp)
        spent = 1e3 * (time.process_time() - began) / count
    median, p95 = 1e3 * np.percentile(trips or [np.inf], [50.0, 95.0])
    row = {"median_ms": median, "p95_ms": p95, "lost": count - len(trips), "processor_ms": spent}
    return {"busy_processes": busy, "load": os.getloadavg()[0], "messages": count, **row}


def _measure_round_trips(count: int, loads: Sequence[int]) -> list[Row]:
    """Return a row for each number of processes that take all of a processor."""
    domain = 1 + os.getpid() % 100  # one that is hardly taken
    node = _connect_node("sender", domain, _THERE, _BACK)
    with _running_processes([f"from benchmarks.ros import echo_messages; echo_messages({domain})"]):
        for _ in range(300):
            _send_odometry(node, _THERE, 0.0)
            if node.receive(0.1):
                break
        else:
            raise ValueError("the other process did not answer within 30 s")
        rows = [_round_trips(node, count, busy) for busy in loads]
    node.close()
    return rows


def main(
    out: Path = Path("runs/benchmarks/ros.json"), seconds: float = 20.0, quick: bool = False
) -> None:
    """Measure round trips; print them and write them as JSON.

    Args:
        out: Where the JSON goes.
        seconds: How long messages are sent at each load [s].
        quick: Send for two seconds: a check that everything runs.
    """
    if not 1.0 <= seconds <= 3600.0:
        raise ValueError(f"--seconds {seconds:g}: must be 1 to 3600")
    count = round(RATE * (2.0 if quick else seconds))
    measure = partial(_measure_round_trips, count, (0, os.cpu_count() or 1))
    rows = measure_if_installed(quick, measure) or []
    report_rows(f"benchmarks/ros: odometry there and back, {RATE:g} Hz", rows, out)


if __name__ == "__main__":
    cli.run_command(main, "python -m benchmarks.ros")
