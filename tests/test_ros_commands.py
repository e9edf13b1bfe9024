"""Priorities, timeouts, locks and the watchdog, without a clock."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from validation.ros.commands import BASE_TIMEOUT, SOURCES, STAND_STILL, CommandGate, CommandSource

REMOTE, JOY, MARKER, EXTERNAL = (s.topic for s in SOURCES)


def test_a_robot_that_nobody_commands_stands() -> None:
    gate = CommandGate()
    assert gate.command(0.0) == STAND_STILL
    assert gate.news() == []


def test_the_joystick_keeps_others_out_for_its_timeout() -> None:
    gate = CommandGate()
    assert gate.offer(EXTERNAL, (0.2, 0.0), 0.0)
    assert gate.offer(JOY, (0.1, 0.5), 0.1)
    assert not gate.offer(EXTERNAL, (0.2, 0.0), 0.2)
    assert gate.command(0.2) == (0.1, 0.5)
    assert not gate.offer(EXTERNAL, (0.2, 0.0), 0.6)
    assert gate.offer(EXTERNAL, (0.3, 0.0), 0.6 + 1e-9 + 1e-3)
    assert gate.command(0.61) == (0.3, 0.0)


def test_silence_brakes_after_the_base_timeout_and_is_said_once() -> None:
    gate = CommandGate()
    gate.offer(EXTERNAL, (0.2, 0.1), 5.0)
    assert gate.command(5.0 + BASE_TIMEOUT) == (0.2, 0.1)
    gate.news()
    assert gate.command(5.0 + BASE_TIMEOUT + 1e-6) == STAND_STILL
    assert gate.command(6.0) == STAND_STILL
    assert gate.news() == ["nothing on /cmd_vel for 0.25 s: the robot brakes"]
    assert gate.offer(EXTERNAL, (0.2, 0.1), 7.0)
    assert gate.command(7.0) == (0.2, 0.1)
    assert gate.news() == ["/cmd_vel commands"]


def test_a_lock_stops_at_once_and_lets_nobody_in() -> None:
    gate = CommandGate()
    gate.offer(JOY, (0.2, 0.1), 0.0)
    gate.lock(True)
    assert gate.command(0.0) == STAND_STILL
    assert not gate.offer(JOY, (0.2, 0.1), 0.1)
    assert gate.command(0.1) == STAND_STILL
    gate.lock(False)
    assert gate.command(0.15) == STAND_STILL, "what was commanded before a lock is void after it"
    assert gate.offer(JOY, (0.2, 0.1), 0.2)
    assert gate.command(0.2) == (0.2, 0.1)


def test_sources_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match="twice"):
        CommandGate((CommandSource("/a", 1), CommandSource("/a", 2)))
    with pytest.raises(ValueError, match="positive"):
        CommandSource("/a", 1, 0.0)
    with pytest.raises(ValueError, match="positive"):
        CommandGate(base_timeout=math.nan)


@given(st.lists(st.tuples(st.sampled_from([s.topic for s in SOURCES]), st.floats(0.0, 0.3)), min_size=1, max_size=60))
def test_whoever_commands_has_no_better_that_speaks(messages: list[tuple[str, float]]) -> None:
    """Against the definition: a message passes if all better sources were silent for more than 0.5 s."""
    gate, now, heard = CommandGate(), 0.0, dict.fromkeys((s.topic for s in SOURCES), -math.inf)
    priority = {s.topic: s.priority for s in SOURCES}
    passed: tuple[float, float] | None = None
    since = -math.inf
    for k, (topic, pause) in enumerate(messages):
        now += pause
        alone = all(now - heard[other] > 0.5 for other in heard if priority[other] > priority[topic])
        assert gate.offer(topic, (0.001 * k, 0.0), now) == alone
        heard[topic] = now
        if alone:
            passed, since = (0.001 * k, 0.0), now
        expected = passed if passed is not None and now - since <= BASE_TIMEOUT else STAND_STILL
        assert gate.command(now) == expected
