"""A channel of a log is one line of a table: read of tables and bags, kept beside the motion."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tests.bag_factory import Message, circle, stamped, write
from validation.experiment.sources import open_source
from validation.files.columns import BESIDE_MOTION, column_of
from validation.files.formats import read_log, write_log
from validation.files.inspection import Inspected
from validation.files.log import ReadOptions
from validation.files.reading import FileError


def volts_at(t: float) -> float:
    return 26.0 - 0.5 * t


def with_battery(voltages: dict[float, float]) -> list[Message]:
    """A robot on a circle from 1 s to 4 s, and states of its battery by their time."""
    states: list[Message] = []
    for t, voltage in voltages.items():
        fields = stamped(t, voltage=voltage)
        states.append(("/battery_state", t + 0.01, ("sensor_msgs/msg/BatteryState", fields)))
    return sorted([*circle(), *states], key=lambda message: message[1])


def test_a_rare_channel_of_a_bag_cuts_nothing_of_the_motion(tmp_path: Path) -> None:
    rare = {t: volts_at(t) for t in (1.6, 2.6, 3.5)}
    alone = read_log(write(tmp_path, "mcap", circle(), "alone"))
    log = read_log(write(tmp_path, "mcap", with_battery(rare), "drive"))
    (topic,) = [topic for topic in log.topics if topic.name == "/battery_state"]
    assert topic.role == "battery"
    common = log.on_one_clock()
    assert len(common.t) == len(alone.on_one_clock().t)
    known = (common.t > 0.7) & (common.t < 2.4)
    # a bag counts its stamps from the first, which is at 1 s
    np.testing.assert_allclose(common.columns["battery"][known], volts_at(common.t[known] + 1.0))
    write_log(log, tmp_path / "drive.csv")
    again = read_log(tmp_path / "drive.csv")
    assert np.array_equal(again.columns["battery"], common.columns["battery"])
    assert Inspected(log).faults == Inspected(alone).faults


def test_a_channel_is_one_of_the_recorded_motion(tmp_path: Path) -> None:
    rare = {t: volts_at(t) for t in (1.0, 2.0, 3.0, 4.0)}
    path = write(tmp_path, "mcap", with_battery(rare))
    (piece,) = open_source(str(path), "wheels").pieces
    assert piece.reference is not None
    values = piece.reference.channels["battery"]
    np.testing.assert_allclose(values, volts_at(piece.reference.t + 1.0), atol=0.03)


def test_a_channel_that_says_nothing_is_left_out_unless_it_is_asked_for(tmp_path: Path) -> None:
    path = write(tmp_path, "mcap", with_battery(dict.fromkeys((1.5, 2.5, 3.5), math.nan)))
    log = read_log(path)
    assert "battery" not in log.groups
    (said,) = [remark for remark in log.remarks if "battery" in remark]
    assert said.startswith("battery is left out: /battery_state")
    with pytest.raises(FileError, match="topics battery=none leaves it out"):
        read_log(path, ReadOptions(topics={"battery": "/battery_state"}))


def test_every_channel_comes_from_messages_of_one_type() -> None:
    for group, channels in BESIDE_MOTION.items():
        assert len({column.message for column in channels.values()}) == 1
        assert all(column_of(name).group == group and column_of(name).field for name in channels)
