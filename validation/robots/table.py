"""Tables of robots."""

from __future__ import annotations

import math
from collections.abc import Sequence

from validation.report.tables import NOTHING, Cell, Grid, one_line
from validation.robots.data import CheckedRobot
from validation.robots.numbers import robot_numbers
from validation.simulator.description import WHEELS, Robot


def number_grid(robot: Robot) -> Grid:
    """Return the table of all numbers of a robot with grade and source, a group for each section of its file.

    Many numbers share a source, which may be a paragraph: the table has its number, the caption its text.
    """
    header = (("number", ""), ("value", ""), ("unit", ""), ("grade [source]", ""))
    groups: dict[str, list[tuple[Cell, ...]]] = {}
    sources: dict[str, int] = {}
    for number in robot_numbers(robot):
        source = sources.setdefault(number.source, len(sources) + 1)
        row = (number.key, number.text(), number.unit or NOTHING, f"{number.grade} [{source}]")
        groups.setdefault(number.key.partition(".")[0], []).append(tuple(map(Cell, row)))
    title = f"{robot.title or robot.name}: its numbers"
    caption = "\n".join(f"[{n}] {one_line(source)}" for source, n in sources.items())
    return Grid(header, tuple(map(tuple, groups.values())), 1, title, caption, trailing=2)


def check_grid(check: CheckedRobot) -> Grid:
    """Return the table of what was found out about a robot."""
    robot, found, spot = check.robot, check.measured, check.spot
    mu, limit = robot.simulation.friction, 2.0 * robot.drive.torque_limit
    weight = 0.25 * 9.81 * robot.masses.total
    rows: list[tuple[str, float | None, float | None, str]] = [
        ("turning multiplier", found.multiplier if found else None, spot.turn.multiplier if spot else None, "1"),
        ("ripple of the yaw rate", 100.0 * found.ripple if found and found.ripple is not None else None, 0.0, "%"),
        *(
            (f"load {wheel.replace('_', ' ')}", load, still, "N")
            for wheel, load, still in zip(WHEELS, found.loads if found else [None] * 4, check.loads, strict=True)
        ),
        ("apparent mass", found.apparent_mass if found else None, _apparent(robot), "kg"),
        (
            "torque of a side for a turn on the spot",
            None,
            mu * spot.side_torque + robot.drive.gear_loss if spot else None,
            "N m",
        ),
        ("torque that a side has", None, limit, "N m"),
        ("friction up to which it can turn", None, _friction(check) if spot else None, "1"),
        ("lowest of the four loads over a quarter of the weight", None, min(check.loads) / weight, "1"),
    ]
    header = (("", ""), ("in MuJoCo", ""), ("by mechanics", ""), ("unit", ""))
    cells = [(Cell(name), Cell(_number(a)), Cell(_number(b)), Cell(unit)) for name, a, b, unit in rows]
    caption = (
        f"on level ground of friction {mu:g}; the multiplier is the wheels' yaw rate over the body's, turning on the spot"
    )
    return Grid(header, (tuple(cells),), 1, f"{robot.title or robot.name}: what it does", caption, trailing=1)


def _apparent(robot: Robot) -> float:
    """Return the mass and what turns with the wheels over the radius squared [kg]."""
    turning = robot.simulation.armature + robot.masses.wheel_inertia[1]
    return robot.masses.total + len(WHEELS) * turning / robot.geometry.wheel_radius**2


def _friction(check: CheckedRobot) -> float:
    """Return the friction of ground up to which the motors can turn the robot on the spot [1]."""
    assert check.spot is not None
    drive = check.robot.drive
    return max((2.0 * drive.torque_limit - drive.gear_loss) / float(check.spot.side_torque), 0.0)


def _number(value: float | None) -> str:
    if value is None:
        return NOTHING
    if math.isinf(value):
        return "∞"
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.4g}" if abs(value) > 1e-9 else "0"


def known_grid(known: Sequence[tuple[Robot, float, tuple[str, ...]]]) -> Grid:
    """Return the table of robots, each with its multiplier by mechanics and the names of its profiles."""
    header = (
        ("name", ""), ("robot", ""), ("mass", "kg"), ("wheelbase", "m"), ("track", "m"), ("wheel radius", "m"),
        ("multiplier", "1"), ("profiles", ""),
    )  # fmt: skip
    rows = []
    for robot, multiplier, profiles in known:
        g = robot.geometry
        lengths = (f"{robot.masses.total:.1f}", f"{g.wheelbase:.3f}", f"{g.track:.3f}", f"{g.wheel_radius:.4f}")
        names = ", ".join(profiles) or NOTHING
        rows.append(tuple(map(Cell, (robot.name, robot.title or NOTHING, *lengths, f"{multiplier:.3f}", names))))
    caption = "multiplier: yaw rate that the wheels ask for over that of the body, turning on the spot, by mechanics"
    return Grid(header, (tuple(rows),), 2, "Robots that come with the package", caption, trailing=1)
