"""Messages between threads and loop, what is said about them, and floods on ports that are none."""

from __future__ import annotations

import logging
import math
import re
import threading
from collections import Counter
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.ros_floods import KINDS, SENT_TO_CONTROLLER, flood_without_ros
from validation.ros.inbox import SAY_PERIOD, Inbox, Notices

WITHOUT_ROS = [kind for kind in KINDS if kind != "quiet"]


class Said(logging.Logger):
    """A logger that keeps what it is told."""

    def __init__(self) -> None:
        super().__init__("said")
        self.lines: list[str] = []

    def log(self, level: int, msg: object, *args: object, **_: object) -> None:
        """Keep a line."""
        self.lines.append(str(msg) % args)


@given(st.lists(st.tuples(st.sampled_from("abc"), st.floats(0.0, 0.7)), max_size=60))
def test_a_kind_is_said_once_a_second_and_nothing_is_left_uncounted(events: list[tuple[str, float]]) -> None:
    notices, said, now = Notices(), Said(), 0.0
    times: dict[str, list[float]] = {kind: [] for kind in "abc"}
    for kind, pause in events:
        now += pause
        notices.add(kind, f"{kind}!")
        before = len(said.lines)
        notices.tell(said, now)
        for line in said.lines[before:]:
            times[line[0]].append(now)
    notices.tell(said, now, all_of_them=True)
    for spoken in times.values():
        assert all(later - earlier >= SAY_PERIOD for earlier, later in pairwise(spoken))
    told: Counter[str] = Counter()
    for line in said.lines:
        more = re.search(r"and (\d+) more", line)
        told[line[0]] += 1 + (int(more[1]) if more else 0)
    assert told == Counter(kind for kind, _ in events)


def test_what_is_said_is_short_and_without_control_characters() -> None:
    notices, said = Notices(), Said()
    notices.add("a", "frame \x1b[31m\n" + 10_000 * "x")
    notices.tell(said, 0.0)
    (line,) = said.lines
    assert line.isprintable()
    assert len(line) <= 300


def number(message: object) -> float:
    if not isinstance(message, float):
        raise ValueError(f"{message} is no number")
    return message


@given(st.lists(st.tuples(st.sampled_from("ab"), st.one_of(st.floats(0.0, 1.0), st.none())), max_size=50), st.integers(1, 5))
def test_the_last_good_messages_come_out_in_the_order_of_their_arrival(
    messages: list[tuple[str, float | None]], depth: int
) -> None:
    clock = iter(range(1000))
    inbox = Inbox(Notices(), lambda: float(next(clock)))
    for topic in "ab":
        inbox.open(topic, number, depth)
    for topic, message in messages:
        inbox.put(topic, message)
    good = [(topic, float(k), m) for k, (topic, m) in enumerate(messages) if m is not None]
    kept = [m for k, m in enumerate(good) if sum(later[0] == m[0] for later in good[k + 1 :]) < depth]
    assert [tuple(got) for got in inbox.drain()] == kept
    assert inbox.get() is None
    tally = inbox.tally
    assert tally.taken.total() == len(good)
    assert tally.refused.total() == len(messages) - len(good)
    assert tally.replaced.total() == len(good) - len(kept)


def test_refusals_are_counted_until_a_good_message_comes() -> None:
    inbox = Inbox(Notices(), lambda: 0.0)
    inbox.open("/a", number, 1)
    assert inbox.refusals("/a") == ""
    for message in (None, "x"):
        inbox.put("/a", message)
    assert inbox.refusals("/a") == "2 messages on /a were refused, the last one because x is no number"
    inbox.put("/a", 1.0)
    assert inbox.refusals("/a") == ""
    assert inbox.tally.lines() == ["messages refused: /a 2"]


def test_many_senders_at_once_lose_no_count() -> None:
    inbox = Inbox(Notices())
    inbox.open("/a", number, 3)

    def send() -> None:
        for k in range(500):
            inbox.put("/a", float(k) if k % 2 else None)

    threads = [threading.Thread(target=send) for _ in range(4)]
    for thread in threads:
        thread.start()
    taken = 0
    while any(thread.is_alive() for thread in threads):
        taken += len(list(inbox.drain()))
    for thread in threads:
        thread.join()
    taken += len(list(inbox.drain()))
    assert inbox.tally.refused["/a"] == inbox.tally.taken["/a"] == 1000
    assert taken + inbox.tally.replaced["/a"] == 1000


def test_waiting_ends_with_a_message_or_with_time() -> None:
    inbox = Inbox(Notices())
    inbox.open("/a", number, 1)
    assert inbox.get(0.01) is None
    later = threading.Timer(0.02, inbox.put, ("/a", 1.0))
    later.start()
    got = inbox.get(5.0)
    assert got is not None
    assert got.message == 1.0
    later.join()


@pytest.mark.parametrize("kind", WITHOUT_ROS)
def test_a_flood_is_a_few_lines_and_the_stop_comes_all_the_same(kind: str) -> None:
    found = flood_without_ros(kind, rate=1000.0, seconds=0.5)
    assert found.sent >= 1000
    assert found.lines <= 12
    assert found.errors == ()
    assert found.clock_ratio == pytest.approx(1.0, abs=1e-3)
    if kind in SENT_TO_CONTROLLER:
        assert found.stop_s <= 0.051
        assert found.gap_s <= 0.051
    elif kind != "lock":
        assert found.stop_s <= 0.5
    assert math.isnan(found.stop_s) == (kind == "lock")
