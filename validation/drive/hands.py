"""Keys and a gamepad become a twist command."""

from __future__ import annotations

import math
from collections.abc import Sequence

KEYS = {265: "up", 264: "down", 263: "left", 262: "right", 257: "enter", 32: "space"}
"""Keys by their number in GLFW: MuJoCo's viewer has other meanings for nearly all letters, and none for these."""
STEPS = 10
"""Presses from rest to the greatest speed or yaw rate."""
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

    def press(self, key: str) -> None:
        """Take the press of a key; one that is not in `KEYS` does nothing."""
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
            self._ahead = self._left = 0
            self._stick_moved = bool(ahead or left)
            return self._v_max * ahead, self._w_max * left
        return self._v_max * self._ahead / STEPS, self._w_max * self._left / STEPS


def read_keys(lines: Sequence[str]) -> list[tuple[float, str]]:
    """Return instants [s] and keys of a script: lines `TIME KEY ...`; `#` begins a remark.

    Raises:
        ValueError: a line of another form, a key that there is not, or a time that goes back.
    """
    found: list[tuple[float, str]] = []
    for number, line in enumerate(lines, start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        try:
            instant = float(words[0])
        except ValueError:
            instant = math.nan
        last = found[-1][0] if found else 0.0
        if not last <= instant < math.inf or len(words) < 2 or not {*words[1:]} <= {*KEYS.values()}:
            keys = ", ".join(KEYS.values())
            raise ValueError(f"line {number} must be TIME KEY ..., no earlier than the last, with keys among {keys}")
        found += [(instant, key) for key in words[1:]]
    return found
