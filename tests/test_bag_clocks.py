"""Clocks of a bag: where the origin of one lies, and how late others write, moves nothing."""

from __future__ import annotations

import contextlib
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests import bag_factory as make
from tests.bag_factory import Message
from validation import recordings
from validation.files import guarded
from validation.files.bags import read_bag
from validation.files.inspection import Inspected
from validation.files.log import PLAIN, Log
from validation.files.offsets import why_without_stamps
from validation.files.reading import FileError

LATE = 0.08
"""Time by which the wheels follow the commands [s]."""
STAMP = 1e-6
"""Error of stamps that are doubles of a Unix time in nanoseconds, and then of seconds [s]."""
LEAST_LATE = 0.002
"""Time by which messages are written after their stamps, at least [s]."""
COMMANDS = "/cmd_vel"


def drive() -> list[Message]:
    """A minute of a robot that weaves; its commands have no stamps, the others are written late."""
    rng = np.random.default_rng(1)
    messages = list[Message]()
    x = y = yaw = 0.0
    for t in (0.05 * np.arange(1200)).tolist():
        v = 0.5 + 0.2 * math.sin(0.3 * t)
        w, asked = (0.4 * math.sin(0.5 * s) + 0.3 * math.sin(1.3 * s) for s in (t, t + LATE))
        x += 0.05 * v * math.cos(yaw)
        y += 0.05 * v * math.sin(yaw)
        yaw += 0.05 * w
        slip = 0.05 * math.sin(7.0 * t)  # so that the wheels are no set points
        sides = {"left": 6.0 * v - 3.0 * w + slip, "right": 6.0 * v + 3.0 * w}
        made = {
            "/joint_states": make.joints(t, sides),
            "/mocap/pose": make.pose_stamped(
                t, *(rng.normal(0.0, 0.004, 3) + np.array([x, y, yaw])).tolist()
            ),
        }
        for name, message in made.items():
            messages.append((name, t + LEAST_LATE + float(rng.exponential(0.01)), message))
        messages.append((COMMANDS, t, make.twist(v, asked)))
    return sorted(messages, key=lambda message: message[1])


@pytest.fixture(scope="module")
def answer(tmp_path_factory: pytest.TempPathFactory) -> guarded.Answer:
    """Return what a reader of the bag answers."""
    path = make.write(tmp_path_factory.mktemp("bag"), "mcap", drive())
    asked = list[guarded.Answer]()
    ask = guarded.ask
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(guarded, "ask", lambda *task: asked.append(ask(*task)) or asked[0])
        read_bag(path, PLAIN)
    return asked[0]


def read_with_clocks(
    answer: guarded.Answer,
    header: float = 0.0,
    writing: float = 0.0,
    rate: float = 1.0,
    waits: float = 0.0,
) -> Log:
    """Read the bag with other clocks.

    Args:
        answer: what its reader answers.
        header: time by which the clock of the stamps is ahead [s].
        writing: time by which the clock of writing is ahead [s].
        rate: seconds of the clock of the stamps in one of writing; 0 stands still.
        waits: time after which commands are written [s].
    """
    (count, kinds, others), parts = answer
    moved = []
    for k, (name, _, _) in enumerate(kinds):
        written, stamps, numbers = (
            np.frombuffer(part, t)
            for part, t in zip(parts[3 * k : 3 * k + 3], ("i8", "i8", "f8"), strict=True)
        )
        start = make.START * 10**9
        wait = waits if name == COMMANDS else 0.0
        written = written + round((writing + wait) * 1e9)
        if name != COMMANDS:
            since = np.rint(rate * (stamps - start)).astype("i8")
            stamps = start + since + round(header * 1e9)
        moved += [written.tobytes(), stamps.tobytes(), numbers.tobytes()]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(guarded, "ask", lambda *_: ((count, kinds, others), moved))
        patch.setattr("validation.files.bags._allowance", lambda _: (1, 1, 1))
        return read_bag(Path("drive.mcap"), PLAIN)


def delay_of_commands(log: Log) -> float | None:
    offsets = Inspected(log).offsets
    return next((-offset.seconds for offset in offsets if offset.late == "cmd"), None)


ORIGINS = st.floats(-1.6e9, 2e9) | st.floats(-1.0, 1.0)
"""Times by which a clock may be ahead [s]; a stamp of 0 would be none."""


@given(header=ORIGINS, writing=st.floats(0.0, 2e9) | st.floats(0.0, 1.0))
def test_the_origin_of_a_clock_moves_nothing(
    answer: guarded.Answer, header: float, writing: float
) -> None:
    usual = read_with_clocks(answer)
    moved = read_with_clocks(answer, header, writing)
    assert moved.faults == usual.faults
    assert list(moved.remarks) == list(usual.remarks)
    for name, group in usual.groups.items():
        np.testing.assert_allclose(moved.groups[name].t, group.t, atol=STAMP)
    was = delay_of_commands(usual)
    assert was == pytest.approx(LATE, abs=0.03)  # half a period, for which a command is held
    assert delay_of_commands(moved) == pytest.approx(was, abs=10.0 * STAMP)


@pytest.mark.parametrize("rate", [0.6, 0.995, 1.0, 1.003])
@pytest.mark.parametrize("ahead", [1.0 - make.START, 0.0, 0.4])
def test_commands_keep_their_place_on_a_clock_of_any_rate(
    answer: guarded.Answer, rate: float, ahead: float
) -> None:
    log = read_with_clocks(answer, header=ahead, rate=rate)
    late = log.groups["cmd"].t - log.groups["wheels"].t
    # of two in a hundred messages that are written least late, and of those between
    assert np.all(np.abs(late + rate * LEAST_LATE) < 1e-3)


def test_a_delay_that_cannot_be_is_not_told(answer: guarded.Answer) -> None:
    """Commands that are written after what they cause have stamps that nobody knows."""
    log = read_with_clocks(answer, header=0.39, waits=0.5)
    assert delay_of_commands(log) is None
    assert "no stamps" in why_without_stamps(log)


def test_a_clock_that_stands_still_is_none(answer: guarded.Answer) -> None:
    log = read_with_clocks(answer, rate=0.0)
    assert any("/mocap/pose: the stamps of the messages stand still" in r for r in log.remarks)
    assert delay_of_commands(log) == pytest.approx(LATE, abs=0.05)


@pytest.mark.parametrize(
    ("waits", "said"),
    [(0.0, "later, less the time that writing took"), (0.5, "cannot be told: the")],
)
def test_info_says_what_is_known_of_the_delay(
    answer: guarded.Answer, waits: float, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = read_with_clocks(answer, waits=waits)
    monkeypatch.setattr(recordings, "open_log", lambda *_: Inspected(log))
    assert any(said in note for note in recordings.info("drive.mcap").notes())


TICKS = st.lists(st.integers(0, 4), min_size=1, max_size=6).map(sorted)
"""Times of a few messages, of which many are equal [0.1 s]."""
FEW = (
    (COMMANDS, "geometry_msgs/msg/Twist", ("v", "w")),
    ("/joint_states", "sensor_msgs/msg/JointState", ("left.velocity", "right.velocity")),
    ("/mocap/pose", "geometry_msgs/msg/PoseStamped", ("x", "y", "yaw")),
)
"""Topics of a bag with few messages."""


@given(
    written=TICKS,
    wheels=TICKS | st.just([0]),
    poses=TICKS | st.just([0]),
    origin=st.sampled_from([0, 5, make.START * 10]),
)
def test_few_messages_with_any_stamps_are_read_or_refused_by_name(
    written: list[int], wheels: list[int], poses: list[int], origin: int
) -> None:
    """Clocks that stand still for a while or for ever, or say nothing."""
    few = []
    for ticks, (_, _, columns) in zip(([0], wheels, poses), FEW, strict=True):
        header = np.resize(ticks, len(written)).astype("i8")
        header = np.where(header > 0, header + origin, 0) * 100_000_000
        when = (make.START * 10 + np.array(written)) * 100_000_000
        numbers = 0.1 * np.arange(1.0, 1.0 + len(written) * len(columns))
        few += [when.tobytes(), header.tobytes(), numbers.tobytes()]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(guarded, "ask", lambda *_: ((3, FEW, []), few))
        patch.setattr("validation.files.bags._allowance", lambda _: (1, 1, 1))
        with contextlib.suppress(FileError):
            inspected = Inspected(read_bag(Path("drive.mcap"), PLAIN))
            assert not inspected.offsets
            assert not any(inspected.good_for().values())
