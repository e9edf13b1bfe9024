"""Every program that reads logs takes every layout of a bag's topics, or says why it does not.

A pose may be a topic of its own, an odometry's or a transform; wheels, commands and a gyro may each
be missing. A layout is some of the topics of one bag.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from tests import bag_factory as make
from tests.bag_factory import Message
from tests.conftest import exit_status
from validation import recordings
from validation.calibrate import calibrate
from validation.compare import compare
from validation.files import guarded
from validation.files.bags import read_bag
from validation.files.columns import column_of
from validation.files.log import PLAIN
from validation.fit import fit

WHEELS = "/joint_states"
COMMANDS = "/cmd_vel"
ODOMETRY = "/odometry"
POSES = (ODOMETRY, "/mocap/pose", "/tf:odom.base_link", "")
"""Topics that tell where the robot is, and none."""
LAYOUTS = [
    pytest.param(
        {*names} - {""},
        id="".join(names),
        marks=[pytest.mark.slow] * ((c, g) != (w ^ p // 2, w ^ p % 2)),
    )
    for p, w, c, g in product(range(len(POSES)), *[range(2)] * 3)
    if any(names := (POSES[p], (WHEELS, "")[w], (COMMANDS, "")[c], ("/imu", "")[g]))
]
"""Topics of each layout; eight are fast, in which any two kinds of topics stand in every way."""


class Reader(NamedTuple):
    """A program that reads logs."""

    program: Any
    inputs: tuple[str, ...]
    """Topics of which it needs one, besides a pose; empty where it takes any."""
    options: Sequence[str]


COMPARED = ("--plants", "kinematic", "--no-rerun", "--input")
FITTED = ("--search", "jde", "--population", "5", "--generations", "1", "--input")
READERS = {
    "info": Reader(recordings.PROGRAM["info"], (), ()),
    "convert": Reader(recordings.PROGRAM["convert"], (), ("--sync",)),
    "compare by wheels": Reader(compare, (WHEELS,), (*COMPARED, "wheels")),
    "compare by commands": Reader(compare, (COMMANDS, ODOMETRY), (*COMPARED, "commands")),
    "fit by wheels": Reader(fit, (WHEELS,), (*FITTED, "wheels", "kinematic", "--to")),
    "fit by commands": Reader(
        fit, (COMMANDS, ODOMETRY), (*FITTED, "commands", "kinematic", "--to")
    ),
    "calibrate": Reader(
        calibrate, (WHEELS, COMMANDS), ("--plants", "kinematic", "--trust", "--robot", "husky")
    ),
}


def messages() -> list[Message]:
    """All topics of a robot that weaves for half a minute, seen by a localiser with noise."""
    messages = list[Message]()
    noise = np.random.default_rng(1)
    x = y = yaw = 0.0
    for t in (0.1 * np.arange(300)).tolist():
        v = 0.5 + 0.2 * math.sin(0.3 * t)
        w = 0.4 * math.sin(0.5 * t)
        x += 0.1 * v * math.cos(yaw)
        y += 0.1 * v * math.sin(yaw)
        yaw += 0.1 * w
        seen = tuple((np.array([x, y, yaw]) + noise.normal(0.0, 0.004, 3)).tolist())
        slip = 0.05 * math.sin(7.0 * t)  # so that the wheels are no set points
        sides = {"left": 6.0 * v - 3.0 * w + slip, "right": 6.0 * v + 3.0 * w}
        made = {
            "/mocap/pose": make.pose_stamped(t, *seen),
            ODOMETRY: make.odometry(t, seen, v, w),
            "/tf": make.transform(t, "odom", "base_link", seen),
            WHEELS: make.joints(t, sides),
            COMMANDS: make.twist(v, w),
            "/imu": make.imu(t, (0.0, 0.0, w + 0.002 * math.cos(5.0 * t))),
        }
        messages += [(topic, t, message) for topic, message in made.items()]
    return messages


@pytest.fixture(scope="module")
def answer(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, guarded.Answer]:
    """The bag of all topics, and what its reader answers."""
    path = make.write(tmp_path_factory.mktemp("bag"), "mcap", messages())
    asked = list[guarded.Answer]()
    ask = guarded.ask
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(guarded, "ask", lambda *task: asked.append(ask(*task)) or asked[0])
        read_bag(path, PLAIN)
    return path, asked[0]


@pytest.fixture(params=LAYOUTS)
def topics(
    request: pytest.FixtureRequest,
    answer: tuple[Path, guarded.Answer],
    monkeypatch: pytest.MonkeyPatch,
) -> set[str]:
    """The topics of each layout in turn, which are all that a reader of bags then finds."""
    (count, kinds, others), parts = answer[1]
    kept = [k for k, (name, _, _) in enumerate(kinds) if name in request.param]
    some = [parts[3 * k + part] for k in kept for part in range(3)]
    monkeypatch.setattr(
        guarded, "ask", lambda *_: ((count, [kinds[k] for k in kept], others), some)
    )
    return set(request.param)


def test_a_column_lies_in_its_group(answer: tuple[Path, guarded.Answer], topics: set[str]) -> None:
    log = read_bag(answer[0], PLAIN)
    assert log.has(("x", "y", "yaw")) == bool(topics & {*POSES})
    for name, group in log.groups.items():
        assert {column_of(column).group for column in group.columns} == {name}
        assert log.group_of(list(group.columns)) is group


@pytest.mark.usefixtures("one_start")
@pytest.mark.parametrize("name", READERS)
def test_a_program_takes_a_layout_or_says_what_it_lacks(
    answer: tuple[Path, guarded.Answer],
    topics: set[str],
    name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    reader = READERS[name]
    has_all = not reader.inputs or (topics & {*reader.inputs} and topics & {*POSES})
    status = exit_status(reader.program, *reader.options, str(answer[0]))
    assert status == (0 if has_all else 2)


def short_log(path: Path, rows: int, period: float) -> Path:
    """A log of few rows, of a robot on a circle, with all columns."""
    t = period * np.arange(rows)
    yaw = 0.3 * t
    x = 0.5 / 0.3 * np.sin(yaw)
    y = 0.5 / 0.3 * (1.0 - np.cos(yaw))
    one = np.ones(rows)
    names = "t,x,y,yaw,enc_left,enc_right,cmd_v,cmd_w,gyro_z"
    columns = [t, x, y, yaw, 2.5 * one, 3.5 * one, 0.5 * one, 0.3 * one, 0.3 * one]
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=names, comments="")
    return path


@pytest.mark.parametrize("period", [0.05, 1.0])
@pytest.mark.parametrize("rows", [2, 4, 15])
@pytest.mark.parametrize("name", READERS)
def test_a_program_takes_a_log_of_few_rows_or_says_that_it_is_short(
    name: str, rows: int, period: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = short_log(tmp_path / "short.csv", rows, period)
    assert exit_status(READERS[name].program, *READERS[name].options, str(path)) in (0, 2)
