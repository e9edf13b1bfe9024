"""Keys and a gamepad become a twist command."""

from __future__ import annotations

import math
from collections.abc import Sequence

KEYS = {265: "up", 264: "down", 263: "left", 262: "right", 257: "enter", 32: "space"}
"""Keys by their number in GLFW: MuJoCo's viewer has other meanings for nearly all letters, and none for these."""
STEPS = 10
"""Presses from rest to the greatest speed or yaw rate."""
Press = str | tuple[float, float]
"""A key, or the speed [m/s] and yaw rate [rad/s] that hold until the next key."""
_DEAD = 0.12
"""Deflection of a stick that counts as none [1]."""


class Hands:
    """The command that keys and sticks ask for.

    The viewer tells of the first press of a key alone, and neither that it is held nor that it is let go. So every press is
    a step: up and down change the speed by a tenth of the greatest, left and right the yaw rate; what is asked for stays.
    Enter goes straight on, space stops. A stick that is moved has its way; let go, it stops the robot.
    """

    def __init__(self, v_max: float, w_max: float) -> None:
        """Begin at rest; the greatest speed [m/s] and yaw rate [rad/s] are positive."""
        self._v_max, self._w_max = v_max, w_max
        self._ahead = self._left = 0  # in steps
        self._stick_moved = False
        self._held = 0.0, 0.0

    def press(self, key: Press) -> None:
        """Take the press of a key; one that is not in `KEYS` does nothing."""
        self._held = 0.0, 0.0
        if not isinstance(key, str):
            v, w = (max(-most, min(most, asked)) for most, asked in zip((self._v_max, self._w_max), key, strict=True))
            self._ahead, self._left, self._held = 0, 0, (v, w)
            return
        ahead, left = {"up": (1, 0), "down": (-1, 0), "left": (0, 1), "right": (0, -1)}.get(key, (0, 0))
        self._ahead = 0 if key == "space" else max(-STEPS, min(STEPS, self._ahead + ahead))
        self._left = 0 if key in ("space", "enter") else max(-STEPS, min(STEPS, self._left + left))

    def command(self, sticks: Sequence[float] | None = None) -> tuple[float, float]:
        """Return speed [m/s] and yaw rate [rad/s] that are asked for.

        Args:
            sticks: deflections ahead and to the left, -1 to 1; None without a gamepad.
        """
        ahead, left = (0.0 if abs(s) < _DEAD else max(-1.0, min(1.0, s)) for s in sticks or (0.0, 0.0))
        if ahead or left or self._stick_moved:
            self._ahead, self._left, self._held = 0, 0, (0.0, 0.0)
            self._stick_moved = bool(ahead or left)
            return self._v_max * ahead, self._w_max * left
        return self._held[0] + self._v_max * self._ahead / STEPS, self._held[1] + self._w_max * self._left / STEPS


def script_line(instant: float, command: tuple[float, float]) -> str:
    """Return the line of a script that asks for a command [m/s, rad/s] from an instant [s] on."""
    return f"{instant:.2f} {command[0]!r} {command[1]!r}\n"


def read_keys(lines: Sequence[str]) -> list[tuple[float, Press]]:
    """Return instants [s] and keys of a script: lines `TIME KEY ...` or `TIME M/S RAD/S`; `#` begins a remark.

    Raises:
        ValueError: a line of another form, a key that there is not, or a time that goes back.
    """
    found: list[tuple[float, Press]] = []
    for number, line in enumerate(lines, start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        instant, *numbers = map(_number, words)
        last = found[-1][0] if found else 0.0
        keys: Sequence[Press] = words[1:]
        if len(numbers) == 2 and all(map(math.isfinite, numbers)):
            keys = [(numbers[0], numbers[1])]
        elif not {*keys} <= {*KEYS.values()}:
            keys = ()
        if not last <= instant < math.inf or not keys:
            there = ", ".join(KEYS.values())
            raise ValueError(
                f"line {number} must be TIME KEY ... with keys among {there}, or TIME M/S RAD/S, no earlier than the last"
            )
        found += [(instant, key) for key in keys]
    return found


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return math.nan
