"""Findings on a robot's numbers from its file alone: nothing is driven.

Each function looks for one cause and returns what it found, or None.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import numpy as np

from ssmr.robot.ground import FRONT, LEFT, turn_on_the_spot
from ssmr.types import FloatArray
from validation.descriptions.foreign_robot import ROUNDED, ForeignRobot, flaw_of_inertia
from validation.descriptions.influences import weigh_influences
from validation.simulator.checking import (
    guessed_numbers,
    load_shares,
    robot_outline,
    spot_turn,
    turning_torque,
    whole_com,
)
from validation.simulator.description import GRAVITY, WHEELS, Robot

_DRIVER_LIMIT = 0.25
"""Deviation of the body's yaw rate from the commanded one that raises no question [1]."""
_CONTROLLER_LIMIT = 0.08
"""Greatest relative deviation of a controller's number that stands beside a description [1]."""
_DENSITIES = (30.0, 6000.0)
"""Masses a cubic metre of hull between which robots are [kg/m³]: an empty box of sheet, and steel
that fills most of it."""
_MOST_SPARE = 10.0
"""Torque of motors over that of a turn on the spot on ground of friction 1, beyond which it raises
a question [1]."""
_OFF_SHARE = 0.12
"""Difference of the loads of two axles or sides over the weight from which the weight is off the
middle [1]."""
_MOST_RATIO = 100.0
"""Turning ratio from which a robot as good as drives straight ahead [1]."""
_FAR_OFF = 0.25
"""Relative difference from which it is a fault and no question [1]."""
_HOLLOW = 0.05
"""Inertia of a body or a wheel over that of a box or a cylinder of its size and mass, below which
it raises a question [1]."""
_MOST_IN_WHEELS = 0.5
"""Share of the mass in the wheels beyond which it raises a question [1]."""
_SAME = 0.02
"""Deviation of two lengths that are one [1]."""


class Finding(NamedTuple):
    """Something that is wrong, or deserves a look."""

    kind: str
    """Its name in files, such as `weight_off`."""
    severity: Literal["fault", "question"]
    """`fault` for what cannot be or spoils a motion, `question` for what deserves a look."""
    cause: str
    """Sentence that says what is wrong."""
    change: str | None = None
    """The change that helps; None where only a look or a measurement tells it."""
    before: str | None = None
    """Measurement before the change; None where the change was not tried."""
    after: str | None = None
    """Measurement after the change."""

    @property
    def sentence(self) -> str:
        """All of it in a line."""
        text = self.cause
        if self.change:
            text += f"; {self.change}"
        if self.before and self.after:
            text += f" ({self.before} → {self.after})"
        return text


Others = ForeignRobot | None
"""Description of a robot by others; None for a file of ours."""


def static_findings(robot: Robot, foreign: ForeignRobot | None = None) -> list[Finding]:
    """Return what is wrong with a robot by its numbers alone, faults first."""
    found = [look(robot, foreign) for look in _LOOKS]
    if foreign is not None:
        for kind, severity, cause, _ in weigh_influences(robot, foreign):
            if severity:
                found.append(Finding(kind, severity, cause))
    findings = [finding for finding in found if finding is not None]
    return sorted(findings, key=lambda finding: finding.severity)


def _hull_is_guessed(robot: Robot) -> bool:
    """Return whether nobody said the size of the hull, so that nothing follows from it."""
    return "geometry.body_size" in guessed_numbers(robot)


def _weight_share_off(robot: Robot) -> float:
    """Return the loads in front less behind, and left less right, over the weight, added [1]."""
    shares = load_shares(robot)
    return float(abs(shares @ FRONT) + abs(shares @ LEFT))


def _weight_off(robot: Robot, _: Others) -> Finding | None:
    return _weight_outside(robot) or _wheel_without_load(robot) or _weight_beside(robot)


def _weight_beside(robot: Robot) -> Finding | None:
    off = _weight_share_off(robot)
    if off < _OFF_SHARE:
        return None
    x, y = whole_com(robot)[:2]
    loads = ", ".join(f"{share * robot.mass * GRAVITY:.0f}" for share in load_shares(robot))
    ratio = turn_on_the_spot(robot.wheelbase, robot.track, x, y).multiplier
    middle = turn_on_the_spot(robot.wheelbase, robot.track).multiplier
    outcome = "told to turn on the spot, it drives straight ahead"
    # where it hardly turns, the ratio is a number of no robot
    if ratio < _MOST_RATIO:
        outcome = f"it turns with a ratio of {ratio:.2f} instead of {middle:.2f}"
    return Finding(
        "weight_off",
        "fault" if off > _FAR_OFF else "question",
        f"the weight lies {_offset(x, y)} the middle between the wheels, which carry {loads} N: "
        f"{outcome}",
        "weigh the wheels of the robot; if they carry the same, put the body's centre of mass "
        "into the middle",
    )


def _offset(x: float, y: float) -> str:
    """Return words for a place beside another one [m]; empty for as good as the same place."""
    parts = []
    if abs(x) > 0.002:
        parts.append(f"{1e3 * abs(x):.0f} mm {'ahead of' if x > 0.0 else 'behind'}")
    if abs(y) > 0.002:
        parts.append(f"{1e3 * abs(y):.0f} mm to the {'left' if y > 0.0 else 'right'} of")
    return " and ".join(parts)


def _weight_outside(robot: Robot) -> Finding | None:
    if _hull_is_guessed(robot):
        return None
    lowest, highest = robot_outline(robot)
    for axis, com, low, high in zip("xyz", robot.com, lowest, highest, strict=True):
        if not low <= com <= high:
            return Finding(
                "weight_off",
                "fault",
                f"the centre of mass lies outside of the robot: {axis} is {com:g} m, "
                f"hull and tyres reach from {low:.3g} to {high:.3g} m",
            )
    return None


def _wheel_without_load(robot: Robot) -> Finding | None:
    shares = load_shares(robot)
    if shares.min() > 0.0:
        return None
    x, y = whole_com(robot)[:2]
    wheel = WHEELS[int(np.argmin(shares))].replace("_", " ")
    used = 2.0 * abs(x) / robot.wheelbase + 2.0 * abs(y) / robot.track
    return Finding(
        "weight_off",
        "fault",
        f"the {wheel} wheel carries nothing: the whole robot's centre of mass is {x:.3g} m "
        f"ahead and {y:.3g} m to the left of the middle; twice that as shares of wheelbase and "
        f"track must add up to less than 1, not {used:.2f}",
    )


def _wheel_inertia(robot: Robot, foreign: Others) -> Finding | None:
    across, spin = robot.wheel_inertia
    wheels = [(robot.wheel_mass, np.diag([across, spin, across]))]
    if foreign is not None:
        wheels = [*foreign.tensors_of(foreign.wheeled.bodies).values()]
    for mass, tensor in wheels:
        wheel = f"a wheel of {mass:g} kg and {robot.wheel_radius:g} m"
        # all the mass at the rim
        most = mass * robot.wheel_radius**2
        usual = f"a cylinder has m r^2 / 2 = {0.5 * most:.4g}"
        finding = _find_impossible_inertia(wheel, tensor, most, usual)
        greatest = float(np.linalg.eigvalsh(tensor)[-1])
        if finding is None and greatest < 0.5 * _HOLLOW * most:
            finding = Finding(
                "inertia",
                "question",
                f"{wheel} has {greatest:.2g} kg m2 about its axle, as if its mass lay in the axle: "
                "it takes hardly any torque to turn",
                usual,
            )
        if finding is not None:
            return finding
    return None


def _find_impossible_inertia(
    body: str, tensor: FloatArray, most: float, usual: str
) -> Finding | None:
    """Return a finding where no rigid body has an inertia [kg m2], at most `most` by its size."""
    flaw = flaw_of_inertia(tensor, most)
    row = ", ".join(f"{moment:.4g}" for moment in np.diag(tensor))
    cause = f"{row} kg m2 is the inertia of no body, and {body} has it: {flaw}"
    return Finding("inertia", "fault", cause, usual) if flaw else None


def _body_inertia(robot: Robot, foreign: Others) -> Finding | None:
    lowest, highest = robot_outline(robot)
    most = 0.25 * robot.base_mass * float(np.sum((highest - lowest) ** 2))
    parts = [(f"the body of {robot.base_mass:.3g} kg", np.diag(robot.inertia), most)]
    if foreign is not None:
        wheeled = foreign.wheeled
        _, _, tensor = wheeled.lump(wheeled.base)
        parts = [(parts[0][0], tensor, most)]
        for name, (_, stated) in foreign.tensors_of(wheeled.base).items():
            parts.append((f"'{name}'", stated, math.inf))
    for part in parts:
        finding = _find_impossible_inertia(*part, "compute it from size and mass")
        if finding is not None:
            return finding
    total = sum(robot.inertia)
    box = robot.base_mass * sum(size**2 for size in robot.body_size) / 6.0
    if total < _HOLLOW * box:
        return Finding(
            "inertia",
            "question",
            f"the body's moments of inertia add up to {total:.2g} kg m2, and those of a box of its "
            f"mass and size to {box:.2g}: it turns and tilts as if its mass lay in a point",
            "compute it from size and mass",
        )
    for k, axis in enumerate("xyz"):
        if _hull_is_guessed(robot) and axis == "z":
            continue
        # mean square distance of the mass from the centre along this axis
        spread = math.sqrt(max(0.5 * total - robot.inertia[k], 0.0) / robot.base_mass)
        reach = max(float(highest[k]) - robot.com[k], robot.com[k] - float(lowest[k]))
        if spread > ROUNDED * reach > 0.0:
            return Finding(
                "inertia",
                "fault" if spread > 1.5 * reach else "question",
                f"the body's inertia needs its {robot.base_mass:.3g} kg to lie {spread:.2g} m from "
                f"its centre along {axis}, root mean square, and the robot reaches {reach:.2g} m: "
                "it is too large for a body of this mass and size",
                "a box has m (a^2 + b^2) / 12 about the axis across its sides a and b",
            )
    return None


def _judge_hull_density(robot: Robot, _: Others) -> Finding | None:
    if _hull_is_guessed(robot):
        return None
    length, width, height = robot.body_size
    bottom = robot.body_centre[2] - 0.5 * height + robot.base_height
    density = robot.base_mass / (length * width * height)
    if bottom < -1e-6:
        return Finding(
            "hull",
            "fault",
            f"the hull reaches {-1e3 * bottom:.0f} mm below the ground: with tyres of "
            f"{robot.wheel_radius:g} m and axles at {robot.axle_height:g} m, the base frame is "
            f"{robot.base_height:.4g} m above it",
            "correct axle_height or body_centre",
        )
    radius = robot.wheel_radius
    if length < 2.0 * radius or width < robot.wheel_width or height < 0.2 * radius:
        return Finding(
            "hull",
            "question",
            f"the hull of {length:.3g} x {width:.3g} x {height:.3g} m is smaller than a wheel: "
            "is it an antenna or a sensor",
            "measure the body, and say body_size and body_centre",
        )
    if _DENSITIES[0] < density < _DENSITIES[1]:
        return None
    return Finding(
        "hull",
        "question",
        f"the body has {density:.3g} kg a cubic metre of its hull, and water has 1000: "
        "are masses in kg and lengths in m?",
    )


def _mass_in_wheels(robot: Robot, _: Others) -> Finding | None:
    share = len(WHEELS) * robot.wheel_mass / robot.mass
    if share <= _MOST_IN_WHEELS:
        return None
    return Finding(
        "mass_in_wheels",
        "question",
        f"{100.0 * share:.0f} % of the mass is in the wheels: is the body "
        f"{robot.base_mass:.2g} kg? Wheels of a robot have about a seventh",
        "weigh body and wheels",
    )


def _judge_torque_limit(robot: Robot, foreign: Others) -> Finding | None:
    limit = robot.drive.torque_limit
    if math.isinf(limit):
        return Finding(
            "effort",
            "question",
            "no torque_limit is given, so it can turn on any ground: say that of one wheel [N m]",
        )
    spot = spot_turn(robot)
    if spot is None:
        return None
    torque = turning_torque(robot, spot)
    loss = robot.drive.gear_loss
    needed = robot.friction * torque + loss
    # of others each motor is weighed for itself
    if needed > 2.0 * limit and foreign is None:
        return Finding(
            "motor_weak",
            "fault",
            f"it cannot turn on the spot on ground of friction {robot.friction:g}: a side needs "
            f"{needed:.4g} N m and its motors give {2.0 * limit:.4g} N m",
            f"torque_limit must be at least {0.5 * needed:.4g} N m a wheel, or friction at most "
            f"{(2.0 * limit - loss) / torque:.2g}",
        )
    if 2.0 * limit <= _MOST_SPARE * torque or torque <= 0.0:
        return None
    return Finding(
        "effort",
        "question",
        f"the limit of torque is {limit:.3g} N m a wheel, and {0.5 * torque:.3g} N m "
        "turn the robot on the spot on ground of friction 1: is it that of a wheel, behind "
        "the gear, in N m?",
    )


def _controller(robot: Robot, foreign: Others) -> Finding | None:
    drive = robot.drive
    given = "drive.command_half_track" in robot.given or "drive.command_radius" in robot.given
    spot = spot_turn(robot)
    off = _weight_share_off(robot)
    if not given or spot is None:
        return None
    # the maker's radius may be that of a loaded tyre
    if abs(drive.command_radius / robot.wheel_radius - 1.0) > 2.0 * _SAME:
        return Finding(
            "controller",
            "question",
            f"the controller reckons with wheels of {drive.command_radius:g} m, and they have "
            f"{robot.wheel_radius:g} m: every speed is wrong by "
            f"{100.0 * (robot.wheel_radius / drive.command_radius - 1.0):+.0f} %",
            f"set its wheel_radius to {robot.wheel_radius:g}",
        )
    # yaw rate of the body over the difference of the commanded rim speeds
    response = robot.wheel_radius / drive.command_radius * spot.yaw_rate
    reached = drive.command_half_track * response
    limit = _DRIVER_LIMIT if foreign is None else _CONTROLLER_LIMIT
    if response <= 0.0 or abs(reached - 1.0) <= limit or off > _OFF_SHARE:
        return None
    return Finding(
        "controller",
        "question",
        f"turning on the spot, it reaches {100.0 * reached:.0f} % of the commanded yaw rate "
        "because the wheels skid",
        f"set command_half_track to {1.0 / response:.3g} m (it is {drive.command_half_track:g} m), "
        f"which is a wheel_separation_multiplier of {2.0 / (response * robot.track):.3g} on "
        f"{robot.track:g} m, to correct this",
    )


def _guess(robot: Robot, _: Others) -> Finding | None:
    reasons = {
        "geometry.wheel_radius": "count the wheels' turns over a straight metre, for every speed "
        "scales with it",
        "mass.total": "weigh the robot, for every force scales with it",
    }
    for key, reason in reasons.items():
        if key in guessed_numbers(robot):
            return Finding("guess", "question", f"{key} is a guess: {reason}")
    return None


_LOOKS: Sequence[Callable[[Robot, Others], Finding | None]] = (
    _weight_off,
    _wheel_inertia,
    _body_inertia,
    _judge_hull_density,
    _mass_in_wheels,
    _judge_torque_limit,
    _guess,
    _controller,
)
