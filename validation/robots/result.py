"""What the program finds out about robots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from validation import store
from validation.report.result import Result
from validation.report.tables import Grid, text_tables
from validation.robots.data import CheckedRobot
from validation.robots.numbers import robot_numbers
from validation.robots.table import check_grid, known_grid, number_grid
from validation.simulator.description import Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCHEMA = "ssmr.robot/1"


@dataclass(frozen=True, eq=False)
class RobotCheck(CheckedRobot, Result):
    """What was found out about a robot, ready to be shown and saved as robot.json and robot.png."""

    program: ClassVar[str] = "robot"

    def grids(self) -> Sequence[Grid]:
        """Return what was measured, and then every number with its source."""
        return [check_grid(self), number_grid(self.robot)]

    def notes(self) -> Sequence[str]:
        """Return the verdict and the advice."""
        verdict = "nothing is wrong with it" if self.ok else "something is wrong with it"
        lines = [f"{'FAULT' if each.fault else 'hint'}: {each.text}" for each in self.advice]
        return [f"{self.robot.name}: {verdict}{':' if lines else ''}", *lines]

    def figure(self) -> Figure:
        """Return its picture: the robot from above and from its right side, with dimensions and loads."""
        from validation.robots.figure import draw_robot

        return draw_robot(self)

    def as_dict(self) -> dict[str, Any]:
        """Return what robot.json holds; null stands for what no model could show."""
        robot, found, spot = self.robot, self.measured, self.spot
        mu, drive = robot.simulation.friction, robot.drive
        entry = {
            "schema": SCHEMA,
            "name": robot.name,
            "title": robot.title,
            "mass_kg": robot.masses.total,
            "wheelbase_m": robot.geometry.wheelbase,
            "track_m": robot.geometry.track,
            "wheel_radius_m": robot.geometry.wheel_radius,
            "turning_multiplier": None if found is None else found.multiplier,
            "closed_form": None if spot is None else spot.turn.multiplier,
            "yaw_ripple": None if found is None else found.ripple,
            "static_loads_N": list(self.static_loads),
            "apparent_mass_kg": None if found is None else found.apparent_mass,
            "friction": mu,
            "side_torque_needed_N_m": None if spot is None else mu * spot.side_torque + drive.gear_loss,
            "side_torque_N_m": 2.0 * drive.torque_limit,
            "ok": self.ok,
            "advice": [each.text for each in self.advice],
            "faults": sum(each.fault for each in self.advice),
            "numbers": {n.key: asdict(n) for n in robot_numbers(robot)},
            "versions": dict(self.versions),
        }
        return dict(store.plain(entry))


@dataclass(frozen=True)
class KnownRobot:
    """A robot that comes with the package."""

    robot: Robot
    """The robot."""
    multiplier: float
    """Multiplier of its turn on the spot by mechanics [1]."""
    profiles: tuple[str, ...]
    """Names of the shipped profiles of it."""


@dataclass(frozen=True, eq=False)
class RobotList:
    """The robots that come with the package."""

    robots: tuple[KnownRobot, ...]
    """Them all, by name."""

    def grids(self) -> Sequence[Grid]:
        """Return the table of robots."""
        rows = [(known.robot, known.multiplier, known.profiles) for known in self.robots]
        return [known_grid(rows)]

    def notes(self) -> Sequence[str]:
        """Return how to see more."""
        return ["`check NAME` shows all numbers of one with their sources, and a picture"]

    def table(self, width: int = 110) -> str:
        """Return its table as text of at most `width` columns."""
        return text_tables(self.grids(), self.notes(), width)

    def as_dict(self) -> dict[str, Any]:
        """Return the table as plain values."""
        return {
            known.robot.name: {
                "title": known.robot.title,
                "mass_kg": known.robot.masses.total,
                "wheelbase_m": known.robot.geometry.wheelbase,
                "track_m": known.robot.geometry.track,
                "wheel_radius_m": known.robot.geometry.wheel_radius,
                "closed_form": known.multiplier,
                "profiles": list(known.profiles),
            }
            for known in self.robots
        }


@dataclass(frozen=True, eq=False)
class DraftedRobot:
    """A new robot's file, before it is written."""

    robot: Robot
    """The robot that the file describes."""
    text: str
    """What the file says."""
    remarks: tuple[str, ...]
    """What was estimated or guessed, and what to do next."""

    def grids(self) -> Sequence[Grid]:
        """Return the table of its numbers."""
        return [number_grid(self.robot)]

    def notes(self) -> Sequence[str]:
        """Return what was estimated or guessed, and what to do next."""
        return self.remarks

    def table(self, width: int = 110) -> str:
        """Return its table and remarks as text of at most `width` columns."""
        return text_tables(self.grids(), self.notes(), width)

    def as_dict(self) -> dict[str, Any]:
        """Return what the file says, as a document."""
        return self.robot.as_document()

    def save(self, path: str | Path) -> Path:
        """Write the robot's file, whole or not at all; return its path.

        Raises:
            ValueError: there is something of that name already.
            OSError: the file cannot be written.
        """
        target = Path(path)
        if target.exists() or target.is_symlink():
            raise ValueError(f"{path}: there is such a file already, and it is not overwritten; name another")
        target.parent.mkdir(parents=True, exist_ok=True)
        store.write_text(target, self.text)
        return target
