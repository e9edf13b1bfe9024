"""Options of a tuning, besides those of its cost and its search."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from ssmr.control.loop import Feedback, LoopSettings
from ssmr.parameters import require_within
from validation.fit.search import FreeParameters
from validation.plants.table import SIMULATED
from validation.simulator.description import Robot

Robots = Literal["nominal", "robust"]
MOST_DRAWS = 1000
"""Greatest number of robots that are drawn for a tuning."""


@dataclass(frozen=True)
class TuneTask:
    """The robots, references and noise that a controller is tuned and judged with."""

    plants: tuple[str, ...] = ("improved",)
    """Plants that the controller must drive; the cost is the mean over all."""
    speed: float = 0.25
    """Speed of references that name none [m/s]."""
    held_out: tuple[str, ...] | None = None
    """References to judge the gains on. None takes line, circle, generic, slalom, square, u-turn and stop-and-go, at the
    greatest speed that is tuned on, except those that are tuned on."""
    feedback: Feedback = "noisy"
    """Pose and speed that the controller sees: truth, noisy or ekf."""
    noise: bool = True
    """Noise in the feedback, and random disturbances of the yaw rate."""
    lookahead: float = 0.0
    """Distance at which the robot keeps behind its target [m]."""
    robot: Robot | str | Path | None = None
    """The robot: itself, its name or its path; None for that of the profile."""
    robots: Robots = "nominal"
    """nominal: the robot of the profile. robust: robots drawn at random that differ from it in mass, friction, centre of
    mass, delay, strength of the sides and slip; the cost is the mean over the worst fifth of them."""
    draws: int | None = None
    """Number of robots that are drawn, and number of others that the gains are scored on; None for 20, or 10 with mujoco."""

    def __post_init__(self) -> None:
        """Check the speed, and the numbers of the loop.

        Raises:
            ValueError: no plant, an unknown feedback or kind of robots, or a number out of its range.
        """
        require_within(self, ("speed",), 1e-3, 100.0)
        if self.robots not in get_args(Robots):
            raise ValueError(f"unknown robots '{self.robots}'; there are: {', '.join(get_args(Robots))}")
        if self.draws is not None:
            require_within(self, ("draws",), 1, MOST_DRAWS, whole=True)
        if not self.plants:
            raise ValueError("plants is empty; name at least one")
        self.loop()

    @property
    def drawn(self) -> int:
        """Number of robots that are drawn; 0 for the profile's own."""
        usual = 10 if any(name in SIMULATED for name in self.plants) else 20
        return 0 if self.robots == "nominal" else self.draws or usual

    def loop(self) -> LoopSettings:
        """Return the settings of the closed loop."""
        return LoopSettings(self.feedback if self.noise else "truth", disturbance=self.noise, lookahead=self.lookahead)


@dataclass(frozen=True)
class TuneParameters(FreeParameters):
    """The gains that are tuned, and those that the search begins with: None takes the published set, else the defaults."""

    gains: str | None = None
    """Gain set to begin with, to hold what is not searched, and to compare the outcome with."""
    all: bool = False
    """Search the gains too that the thesis sets by hand: feedforward, K_alpha, K_y, K_I."""
    from_scratch: bool = False
    """Leave the gains it begins with out of the first population."""
