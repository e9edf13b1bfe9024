"""What the nodes need of a connection to a graph; `ros2` has it over DDS, and tests have one without."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import Any

from validation.ros.graph import Graph
from validation.ros.inbox import Inbox, Notices, Received

BREATH = 0.004
"""Time for which a thread rests after each message that it has received [s]. So one topic is heard 250 times a second: of a
flood, all but the last messages are thrown away before they are decoded, and the node's own loop gets its share of time."""


class NoGraphError(ValueError):
    """There is no graph to join: cyclonedds is not installed, or the network interface is not there."""


class Port(ABC):
    """Topics of a node; incoming messages wait in one inbox. Types are named `package/Type`."""

    graph = Graph()
    """What is joined, and the names there."""

    def __init__(self, graph: Graph) -> None:
        """Begin with nothing received."""
        self.graph = graph
        self.notices = Notices()
        """What the node has to say; its loop lets it be told."""
        self.inbox = Inbox(self.notices)
        """Incoming messages."""

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
    def close(self) -> None:
        """Leave the graph."""

    def receive(self, timeout: float = 0.0) -> Received | None:
        """Return the next message, waited for at most `timeout` [s]; None if none came."""
        return self.inbox.get(timeout)

    def drain(self) -> Iterator[Received]:
        """Yield all messages that have come so far."""
        return self.inbox.drain()
