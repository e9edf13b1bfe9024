"""A drive by hand: keys become commands, and the log holds what was driven."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.errors import DivergedError
from ssmr.types import State
from validation import drive as module
from validation.compare import Compare, prepare
from validation.drive import KEYS, STEPS, TICK, HandCommand, Script, drive, drive_by_hand, read_keys
from validation.files.formats import read_log
from validation.plants.profile import Profile

SCRIPT = "0.5 up up up\n1 left\n# straight on\n1.5 enter\n\n2 space\n"


@pytest.fixture
def script(tmp_path: Path) -> Path:
    path = tmp_path / "keys.txt"
    path.write_text(SCRIPT)
    return path


@given(st.lists(st.sampled_from([*KEYS.values(), "w"])))
def test_no_keys_ask_for_more_than_the_greatest_and_space_always_stops(keys: list[str]) -> None:
    hand = HandCommand(1.0, 2.0)
    for key in keys:
        before = hand.command()
        hand.press(key)
        v, w = hand.command()
        assert abs(v) <= 1.0
        assert abs(w) <= 2.0
        assert abs(v - before[0]) <= 1.0 / STEPS + 1e-12 or key == "space"
    hand.press("enter")
    assert hand.command()[1] == 0.0
    hand.press("space")
    assert hand.command() == (0.0, 0.0)


def test_a_script_is_read_or_refused_with_the_line(script: Path) -> None:
    assert read_keys(script)[:4] == [(0.5, "up"), (0.5, "up"), (0.5, "up"), (1.0, "left")]
    for text in ("1 up\n0.5 up", "up", "1", "1 w", "nan up", "-1 up", "1 2"):
        script.write_text(text)
        with pytest.raises(ValueError, match=f"line {len(text.splitlines())} must be TIME KEY"):
            read_keys(script)


def test_a_drive_is_logged_and_compared_and_replaces_no_former_one(script: Path, tmp_path: Path) -> None:
    """Each command holds from its key on, until two seconds after the last key; the log adds noise and rest."""
    found = [drive("husky", plants=("kinematic",), keys=script, seed=3, workers=1, out=tmp_path) for _ in range(2)]
    commands = found[0].commands[0]
    assert (commands.dt, commands.n) == (TICK, round(4.0 / TICK))
    at = {s: tuple(commands.values[round(s / TICK)]) for s in (0.48, 0.5, 1.0, 1.5, 2.0, 3.98)}
    wanted = {0.48: (0.0, 0.0), 0.5: (0.3, 0.0), 1.0: (0.3, 0.2), 1.5: (0.3, 0.0), 2.0: (0.0, 0.0), 3.98: (0.0, 0.0)}
    assert all(at[s] == pytest.approx(pair) for s, pair in wanted.items())
    first, second = tmp_path / "drive.csv", tmp_path / "drive-2.csv"
    assert first.read_bytes() == second.read_bytes()  # one seed, one noise
    log = read_log(first)
    assert {"cmd_v", "cmd_w", "enc_left", "enc_right", "gyro_z", "x", "y", "yaw"} <= set(log.columns)
    assert log.t[-1] == pytest.approx(14.0, abs=0.1)  # rest before and after
    end = found[0].plants["mujoco"].pieces[0].xy[-1]
    assert math.dist((log.columns["x"][-1], log.columns["y"][-1]), end) < 0.03  # motion capture's noise


class _Viewer:
    """MuJoCo's viewer without a screen: it presses a key, and is closed or interrupted after some pictures."""

    def __init__(self, pictures: int, interrupt: bool) -> None:
        self.left, self.interrupt, self.closed = pictures, interrupt, False
        self.states: list[Sequence[State]] = []
        self.dropped = 0.0

    def is_open(self, now: float) -> bool:
        return self.left > 0

    def keys(self, now: float) -> list[str]:
        return ["up"]

    def show(self, now: float, states: Sequence[State], command: tuple[float, float]) -> None:
        self.left -= 1
        self.states.append(states)
        if self.interrupt and not self.left:
            raise KeyboardInterrupt

    def close(self) -> None:
        self.closed = True


@pytest.mark.parametrize("interrupt", [False, True])
def test_a_window_is_driven_until_it_is_closed(
    lab: Profile, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, interrupt: bool
) -> None:
    """What was shown is what is logged, also of a drive that Ctrl-C ended."""
    viewer = _Viewer(20, interrupt)
    monkeypatch.setattr(module, "Window", lambda stage: viewer)
    found = drive(profile=lab, plants=("kinematic",), out=tmp_path)
    assert viewer.closed
    assert found.status == ("interrupted" if interrupt else "finished")
    assert found.commands[0].n == 20
    assert found.commands[0].values[-1, 0] == pytest.approx(1.0)
    motion = prepare(Compare("traj1", lab, ("mujoco",))).plants["mujoco"].run(
        found.commands[0], lab.section("mujoco").localiser.body_state(State()), TICK
    )  # fmt: skip
    shown = viewer.states[-1][0]
    assert [shown.x, shown.y, shown.yaw] == pytest.approx(motion.pose[-1], abs=1e-9)


def test_a_plant_that_diverges_ends_the_drive_and_loses_nothing(lab: Profile, script: Path) -> None:
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
    prepared = prepare(Compare("traj1", lab, ("mujoco", "kinematic")))
    prepared = replace(prepared, plants={**prepared.plants, "kinematic": ghost})
    commands, ended = drive_by_hand(prepared, Script(read_keys(script)))
    assert str(ended) == "kinematic: it gave up"
    assert np.shape(commands) == (60, 2)
