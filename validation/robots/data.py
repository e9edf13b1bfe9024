"""What was found out about a robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from validation import store
from validation.robots.advice import Advice
from validation.robots.measuring import Measured
from validation.robots.mechanics import SpotTurn
from validation.simulator.description import Robot


@dataclass(frozen=True, eq=False)
class CheckedRobot:
    """Whether a robot can be as its file describes it, with the numbers that show it."""

    robot: Robot
    """The robot."""
    spot: SpotTurn | None
    """Its turn on the spot by mechanics; None where its wheels do not carry it."""
    loads: tuple[float, ...]
    """Loads of the four wheels by mechanics [N]."""
    measured: Measured | None
    """What its MuJoCo model shows; None where none can be built."""
    advice: tuple[Advice, ...]
    """What is wrong; faults first."""
    versions: Mapping[str, str] = field(default_factory=store.versions)
    """Versions of this project, Python and the packages that decide numbers."""

    @property
    def ok(self) -> bool:
        """Whether no fault was found."""
        return not any(each.fault for each in self.advice)

    @property
    def static_loads(self) -> tuple[float, ...]:
        """Loads of the four wheels at rest [N]: of the MuJoCo model, or by mechanics where there is none."""
        return self.loads if self.measured is None else self.measured.loads
