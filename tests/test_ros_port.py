"""Whether a master is there, asked of servers that are none, slow or right."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from xmlrpc.server import SimpleXMLRPCServer

import pytest

from validation.ros.ros1 import ask_master, stay_on_loopback


@contextmanager
def server(answer: Callable[[str], Any]) -> Iterator[str]:
    """Something that speaks XML-RPC; its address."""
    with SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False, allow_none=True) as made:
        made.register_function(answer, "getPid")
        thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield f"http://127.0.0.1:{made.server_address[1]}"
        finally:
            made.shutdown()
            thread.join()


def test_a_master_says_its_process() -> None:
    asked: list[str] = []
    with server(lambda caller: asked.append(caller) or [1, "", 4321]) as uri:
        assert ask_master(uri, "/node", 5.0) == 4321
    assert asked == ["/node"]


@pytest.mark.parametrize("answer", [[0, "no", 0], [1, ""], "hello", [1, "", None]])
def test_who_does_not_speak_as_a_master_is_none(answer: Any) -> None:
    with server(lambda _: answer) as uri, pytest.raises(OSError, match=r"master"):
        ask_master(uri, "/node", 5.0)


def test_nobody_is_refused_and_somebody_silent_is_waited_for_in_vain() -> None:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        uri = f"http://127.0.0.1:{s.getsockname()[1]}"
        with pytest.raises(ConnectionRefusedError):
            ask_master(uri, "/node", 5.0)
        s.listen()
        with pytest.raises(TimeoutError):
            ask_master(uri, "/node", 0.05)


@pytest.mark.parametrize(
    ("master", "told", "expected"),
    [
        ("http://localhost:11311", {}, "127.0.0.1"),
        ("http://127.0.0.1:11311", {}, "127.0.0.1"),
        ("http://[::1]:11311", {}, "127.0.0.1"),
        ("http://robot.lab:11311", {}, None),
        ("http://localhost:11311", {"ROS_IP": "10.0.0.2"}, "10.0.0.2"),
        ("http://localhost:11311", {"ROS_HOSTNAME": "desk"}, None),
        ("nonsense", {}, None),
    ],
)
def test_a_node_stays_on_loopback_unless_told_otherwise(
    monkeypatch: pytest.MonkeyPatch, master: str, told: dict[str, str], expected: str | None
) -> None:
    for name in ("ROS_IP", "ROS_HOSTNAME"):
        monkeypatch.setenv(name, "")  # so that it is put back afterwards
        monkeypatch.delenv(name)
    for name, value in told.items():
        monkeypatch.setenv(name, value)
    stay_on_loopback(master)
    assert os.environ.get("ROS_IP") == expected
