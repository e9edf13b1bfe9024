"""A drive by hand: keys and sticks become commands, and the log holds what was driven."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.errors import DivergedError
from ssmr.types import State
from validation.drive import run as driving
from validation.drive.hands import KEYS, STEPS, Hands, read_keys
from validation.drive.run import TICK, HandDrive, drive_by_hand, prepare_drive
from validation.files.formats import read_log
from validation.plants.profile import Profile
from validation.report.stage import Stage

SCRIPT = ["0.5 up up up", "1 left", "# straight on", "1.5 enter", "", "2 space"]


@pytest.fixture(scope="module")
def driven(lab: Profile) -> HandDrive:
    return drive_by_hand(prepare_drive(lab, ("kinematic",), seed=3), script=read_keys(SCRIPT))


@given(st.lists(st.sampled_from([*KEYS.values(), "w"])))
def test_no_keys_ask_for_more_than_the_greatest_and_space_always_stops(keys: list[str]) -> None:
    hands = Hands(1.0, 2.0)
    for key in keys:
        before = hands.command()
        hands.press(key)
        v, w = hands.command()
        assert abs(v) <= 1.0
        assert abs(w) <= 2.0
        assert abs(v - before[0]) <= 1.0 / STEPS + 1e-12 or key == "space"
    hands.press("enter")
    assert hands.command()[1] == 0.0
    hands.press("space")
    assert hands.command() == (0.0, 0.0)


def test_a_stick_has_its_way_and_stops_the_robot_when_it_is_let_go() -> None:
    hands = Hands(1.0, 2.0)
    hands.press("up")
    assert hands.command((0.05, -0.1)) == pytest.approx((0.1, 0.0))  # sticks never rest at zero
    assert hands.command((0.5, -1.2)) == pytest.approx((0.5, -2.0))
    assert hands.command((0.0, 0.05)) == (0.0, 0.0)
    hands.press("down")
    assert hands.command((0.0, 0.05)) == pytest.approx((-0.1, 0.0))


def test_a_script_is_read_or_refused_with_the_line() -> None:
    assert read_keys(SCRIPT)[:4] == [(0.5, "up"), (0.5, "up"), (0.5, "up"), (1.0, "left")]
    assert read_keys(["0.5 0.3 -0.1 # by a stick"]) == [(0.5, (0.3, -0.1))]
    for lines in (["1 up", "0.5 up"], ["up"], ["1"], ["1 w"], ["nan up"], ["-1 up"], ["1 2"], ["1 2 nan"], ["1 2 3 4"]):
        with pytest.raises(ValueError, match=f"line {len(lines)} must be TIME KEY"):
            read_keys(lines)


def test_a_drive_holds_each_command_from_its_key_on(driven: HandDrive) -> None:
    commands = driven.prepared.source.pieces[0].commands
    assert (commands.dt, commands.n) == (TICK, round(4.0 / TICK))  # two seconds after the last key
    at = {s: tuple(commands.values[round(s / TICK)]) for s in (0.48, 0.5, 1.0, 1.5, 2.0, 3.98)}
    assert at[0.48] == (0.0, 0.0)
    assert at[0.5] == pytest.approx((0.3, 0.0))
    assert at[1.0] == pytest.approx((0.3, 0.2))
    assert at[1.5] == pytest.approx((0.3, 0.0))
    assert at[2.0] == at[3.98] == (0.0, 0.0)


def test_the_log_holds_the_drive_and_replaces_none(driven: HandDrive, tmp_path: Path) -> None:
    first, second = driven.write_recording(tmp_path / "new"), driven.write_recording(tmp_path / "new")
    assert [first.name, second.name] == ["drive.csv", "drive-2.csv"]
    assert first.read_bytes() == second.read_bytes()  # one seed, one noise
    log = read_log(first)
    assert {"cmd_v", "cmd_w", "enc_left", "enc_right", "gyro_z", "x", "y", "yaw"} <= set(log.columns)
    assert log.t[-1] == pytest.approx(14.0, abs=0.1)  # rest before and after
    assert log.columns["cmd_v"].max() == pytest.approx(0.3)
    shown = driven.compare(workers=1).plants["mujoco"].pieces[0]
    assert math.dist((log.columns["x"][-1], log.columns["y"][-1]), shown.xy[-1]) < 0.03  # motion capture's noise


class _Window:
    """A window without a screen: it presses a key, and is closed or interrupted after some pictures."""

    def __init__(self, stage: Stage, pictures: int, interrupt: bool) -> None:
        self.stage, self.left, self.interrupt, self.closed = stage, pictures, interrupt, False
        self.poses: list[np.ndarray] = []

    @property
    def is_open(self) -> bool:
        return self.left > 0

    def keys(self) -> list[str]:
        return ["up"]

    def sticks(self) -> None:
        return None

    def show(self, poses: list[np.ndarray], turns: np.ndarray, status: str) -> None:
        self.left -= 1
        self.poses.append(np.array(poses))
        assert turns.shape == (2, 2)
        if self.interrupt and not self.left:
            raise KeyboardInterrupt

    def close(self) -> None:
        self.closed = True


@pytest.mark.parametrize("interrupt", [False, True])
def test_a_window_is_driven_in_real_time_until_it_is_closed(
    lab: Profile, monkeypatch: pytest.MonkeyPatch, interrupt: bool
) -> None:
    now, opened = [0.0], list[_Window]()

    def open_window(stage: Stage) -> _Window:
        opened.append(_Window(stage, 20, interrupt))
        return opened[0]

    monkeypatch.setattr(driving, "DriveWindow", open_window)
    found = drive_by_hand(
        prepare_drive(lab, ("kinematic",)), clock=lambda: now[0], sleep=lambda s: now.__setitem__(0, now[0] + s)
    )
    assert (found.interrupted, found.dropped, opened[0].closed) == (interrupt, 0.0, True)
    commands = found.prepared.source.pieces[0].commands
    assert commands.n == 20
    assert commands.values[-1, 0] == pytest.approx(1.0)
    assert now[0] == pytest.approx((20 - interrupt) * TICK)
    start = lab.section("mujoco").localiser.body_state(State())
    motion = found.prepared.plants["mujoco"].run(commands, start, TICK)
    assert opened[0].poses[-1][0] == pytest.approx(motion.pose[-1], abs=1e-9)  # what was shown is what is logged


def test_a_plant_that_diverges_ends_the_drive_and_loses_nothing(lab: Profile, tmp_path: Path) -> None:
    prepared = prepare_drive(lab, ("kinematic",))

    class Diverging:
        steps = 0

        def reset(self, state: State) -> State:
            self.steps = 0
            return state

        def step(self, command: tuple[float, float], dt: float) -> State:
            self.steps += 1
            if self.steps > 60:
                raise DivergedError("it gave up", t=0.0, state=State())
            return State()

    ghost: Any = Diverging()
    found = drive_by_hand(replace(prepared, plants={**prepared.plants, "kinematic": ghost}), script=read_keys(SCRIPT))
    assert found.failure == "kinematic: it gave up"
    assert found.prepared.source.pieces[0].commands.n == 60
    assert read_log(found.write_recording(tmp_path)).t[-1] == pytest.approx(10.0 + 60 * TICK, abs=0.1)
