"""Incoming messages between the threads that receive them and the loop that uses them, and what is said about refused ones.

A flood must not slow the loop. So each topic keeps only its last messages, a message is read and checked once, where it
comes in, and whatever is said about messages is said once a second. There is no ROS in this module.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from validation.words import shortened

SAY_PERIOD = 1.0
"""Time between two lines of one kind [s]."""
_LONGEST = 300
"""Characters of a line that are said of foreign text."""


class Received(NamedTuple):
    """What was read from a message, and the time of its arrival."""

    topic: str
    arrival: float
    """Monotonic time [s]."""
    message: Any
    """Value that the topic's reader returned."""


@dataclass
class _Pending:
    """Sentences of one kind that were not said yet."""

    said_at: float = float("-inf")
    count: int = 0
    level: int = logging.INFO
    text: str = ""


class Notices:
    """Sentences by kind: the last one of each kind is said once a second, with the number of those left out."""

    def __init__(self) -> None:
        """Begin with nothing to say."""
        self._kinds: dict[str, _Pending] = {}
        self._lock = threading.Lock()

    def add(self, kind: str, text: str, level: int = logging.WARNING) -> None:
        """Keep a sentence; any thread may call this. Kinds come from this program and never from a message."""
        with self._lock:
            pending = self._kinds.setdefault(kind, _Pending())
            pending.count += 1
            pending.level, pending.text = level, text

    def tell(self, logger: logging.Logger, now: float, *, all_of_them: bool = False) -> None:
        """Log what is due at `now` [s], or everything that was not said yet. Only the node's own loop calls this."""
        if not self._kinds:
            return
        with self._lock:
            due = []
            for pending in self._kinds.values():
                if pending.count and (all_of_them or now - pending.said_at >= SAY_PERIOD):
                    more = f" (and {pending.count - 1} more of this kind)" if pending.count > 1 else ""
                    due.append((pending.level, shortened(pending.text, _LONGEST) + more))
                    pending.said_at, pending.count = now, 0
        for level, line in due:
            logger.log(level, "%s", line)


@dataclass
class _Box:
    """One topic's messages."""

    read: Callable[[Any], Any]
    kept: deque[Received]
    refused_since: int = 0
    """Messages that were refused since the last good one."""
    why: str = ""


@dataclass
class Tally:
    """Numbers of messages by topic."""

    taken: Counter[str] = field(default_factory=Counter)
    """Messages that were read."""
    refused: Counter[str] = field(default_factory=Counter)
    """Messages that say something that cannot be."""
    replaced: Counter[str] = field(default_factory=Counter)
    """Messages that newer ones took the place of before the loop came for them."""

    def lines(self) -> list[str]:
        """Return sentences about what was not used."""
        return [
            f"{what}: {', '.join(f'{topic} {n}' for topic, n in sorted(counts.items()))}"
            for what, counts in (("messages refused", self.refused), ("messages replaced by newer ones", self.replaced))
            if counts
        ]


class Inbox:
    """The last messages of each topic, read and checked. Any thread puts them in, one loop takes them out."""

    def __init__(self, notices: Notices, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin without topics; `clock` returns monotonic time [s]."""
        self._notices, self._clock = notices, clock
        self._boxes: dict[str, _Box] = {}
        self._came = threading.Condition()
        self.tally = Tally()

    def open(self, topic: str, read: Callable[[Any], Any], depth: int | None) -> None:
        """Take a topic's messages as `read` returns them, and keep the last `depth` of them; None keeps all."""
        self._boxes[topic] = _Box(read, deque(maxlen=depth))

    def put(self, topic: str, message: Any) -> None:
        """Read a message and keep it; one of which `read` raises a `ValueError` is counted, and said."""
        box, arrival = self._boxes[topic], self._clock()
        try:
            value = box.read(message)
        except ValueError as error:
            with self._came:
                self.tally.refused[topic] += 1
                box.refused_since, box.why = box.refused_since + 1, str(error)
            self._notices.add(topic, f"{topic}: {error}; ignored")
            return
        with self._came:
            self.tally.taken[topic] += 1
            if len(box.kept) == box.kept.maxlen:
                self.tally.replaced[topic] += 1
            box.refused_since = 0
            box.kept.append(Received(topic, arrival, value))
            self._came.notify()

    def refusals(self, topic: str) -> str:
        """Return how many messages of a topic were refused since its last good one, and why; empty if none was."""
        with self._came:
            box = self._boxes[topic]
            if not box.refused_since:
                return ""
            return f"{box.refused_since} messages on {topic} were refused, the last one because {box.why}"

    def _oldest(self) -> _Box | None:
        return min((b for b in self._boxes.values() if b.kept), key=lambda b: b.kept[0].arrival, default=None)

    def get(self, timeout: float = 0.0) -> Received | None:
        """Return the oldest message, waited for at most `timeout` [s]; None if none came."""
        with self._came:
            if (box := self._oldest()) is None and timeout > 0.0:
                self._came.wait(timeout)
                box = self._oldest()
            return box.kept.popleft() if box is not None else None

    def drain(self) -> Iterator[Received]:
        """Yield what has come so far, the oldest first. What comes meanwhile waits, so this ends in any flood."""
        with self._came:
            found = sorted((r for b in self._boxes.values() for r in b.kept), key=lambda r: r.arrival)
            for box in self._boxes.values():
                box.kept.clear()
        yield from found
