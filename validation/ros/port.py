"""A node's connection to a graph, whichever ROS that speaks: `ros1` and `ros2` are the two kinds of it."""

from __future__ import annotations

import queue
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from validation.ros.graph import Graph
from validation.ros.inbox import Inbox, Notices, Received

BREATH = 0.004
"""Time for which a thread rests after each message that it has received [s]. So one topic is heard 250 times a second: of a
flood, all but the last messages are thrown away before they are decoded, and the node's own loop gets its share of time."""
_CALLS = 10
"""Service calls that wait for the loop."""


class NoGraphError(ValueError):
    """There is no graph to join: what speaks to it is not installed, or nobody answers."""


class Call(NamedTuple):
    """A service call that waits for its answer."""

    request: Any
    """What was read from the request."""
    answer: Callable[[str], None]
    """Function to be called once, with an empty text or with the fault."""


class Port(ABC):
    """Topics and services of a node; incoming messages wait in one inbox. Types are named `package/Type`."""

    master: str
    """Who keeps the graph together, for messages."""
    graph = Graph()
    """What is joined, and the names there."""

    def __init__(self, graph: Graph) -> None:
        """Begin with nothing received."""
        self.graph = graph
        self.notices = Notices()
        """What the node has to say; its loop lets it be told."""
        self.inbox = Inbox(self.notices)
        """Incoming messages."""
        self.master_gone = threading.Event()
        """Set while the master does not answer, or after another one took its place; never in ROS 2, which has none."""
        self.calls: queue.Queue[Call] = queue.Queue(_CALLS)
        """Service calls."""

    @abstractmethod
    def simulate_time(self) -> None:
        """Tell the other nodes that time is simulated, until the port closes, where the graph can tell them."""

    @abstractmethod
    def advertise(self, topic: str, kind: str, *, latch: bool = False) -> None:
        """Open a topic for sending; with `latch`, who joins later gets the last message too."""

    @abstractmethod
    def make(self, kind: str) -> Any:
        """Return an empty message."""

    @abstractmethod
    def send(self, topic: str, fill: Callable[[Any], None]) -> None:
        """Send a message that `fill` has filled, without waiting for slow subscribers."""

    @abstractmethod
    def listeners(self, topic: str) -> int:
        """Return the number of listeners of a topic that is open for sending."""

    @abstractmethod
    def listen(self, topic: str, kind: str, read: Callable[[Any], Any] = lambda m: m, depth: int | None = None) -> None:
        """Let the messages of a topic come into the inbox.

        Args:
            topic: name of the topic.
            kind: its type, `package/Type`.
            read: function that returns what the node needs of a message, and raises a `ValueError` if it cannot be.
            depth: messages that are kept, the last ones; None keeps all, as fast as they come.
        """

    @abstractmethod
    def serve_set_pose(self, name: str, read: Callable[[Any], Any]) -> None:
        """Offer the service set_pose, where there is one; its calls, as `read` returns their pose, wait in `calls`."""

    @abstractmethod
    def close(self, why: str) -> None:
        """Leave the graph."""

    def receive(self, timeout: float = 0.0) -> Received | None:
        """Return the next message, waited for at most `timeout` [s]; None if none came."""
        return self.inbox.get(timeout)

    def drain(self) -> Iterator[Received]:
        """Yield all messages that have come so far."""
        return self.inbox.drain()

    def call(self) -> Call | None:
        """Return the next service call; None if there is none."""
        try:
            return self.calls.get_nowait()
        except queue.Empty:
            return None
