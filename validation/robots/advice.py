"""What is wrong with a robot and what would be right, a sentence each."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from validation.robots.measuring import Measured
from validation.robots.mechanics import (
    WEIGHT_PER_KG,
    SpotTurn,
    load_shares,
    robot_outline,
    spreads,
    tyre_hull_overlap,
    whole_com,
)
from validation.simulator.description import WHEELS, Robot

LITTLE_LOAD = 0.3
"""Load over a quarter of the weight below which a wheel is said to carry little [1]."""
RIPPLE_LIMIT, MULTIPLIER_LIMIT = 0.02, 0.02
"""Range of the yaw rate over its mean, and deviation of the multiplier from its closed form, that a robot may have [1]."""
DRIVER_LIMIT = 0.25
"""Deviation of the body's yaw rate from the commanded one that is not worth a word [1]."""
COMPACT = 0.35
"""Spread of the base's mass over that of a uniform hull below which its inertia is said to be small [1]."""


@dataclass(frozen=True)
class Advice:
    """One sentence about a robot."""

    text: str
    """What is wrong, and what would be right."""
    fault: bool = True
    """Whether the robot cannot be as it is described, or cannot drive; else it is worth a second look."""


def _names(wheels: list[str]) -> str:
    """Return wheels in words."""
    if len(wheels) == len(WHEELS):
        return "all tyres"
    words = [wheel.replace("_", " ") for wheel in wheels]
    return f"the {' and '.join(words)} tyre{'s' * (len(words) > 1)}"


def advice_on_geometry(robot: Robot) -> Iterator[Advice]:
    """Yield what is wrong with tyres and hull: they touch each other, or the ground."""
    g = robot.geometry
    if 2.0 * g.wheel_radius >= g.wheelbase:
        yield Advice(
            f"front and rear tyres touch each other: with a wheelbase of {g.wheelbase:g} m, wheel_radius must be less than "
            f"{0.5 * g.wheelbase:.4g} m, not {g.wheel_radius:g} m"
        )
    if g.wheel_width >= g.track:
        yield Advice(
            f"left and right tyres touch each other: with a track of {g.track:g} m, wheel_width must be less than that, "
            f"not {g.wheel_width:g} m"
        )
    overlaps = tyre_hull_overlap(robot)
    touching = [wheel for wheel, (across, round_) in overlaps.items() if min(across, round_) > 1e-6]
    if touching:
        deep = max(overlaps[wheel][0] for wheel in touching)
        widest = g.track - g.wheel_width - 2.0 * abs(g.body_centre[1])
        remedy = f"body_size may be {widest:.4g} m wide there" if widest > 0.0 else "the track is too small for any hull"
        yield Advice(f"{_names(touching)} reach {1e3 * deep:.0f} mm into the hull: between the tyres {remedy}")
    bottom = g.body_centre[2] - 0.5 * g.body_size[2] + g.base_height
    if bottom < -1e-6:
        yield Advice(
            f"the hull reaches {-1e3 * bottom:.0f} mm below the ground: with tyres of {g.wheel_radius:g} m and axles at "
            f"{g.axle_height:g} m, the base frame is {g.base_height:.4g} m above the ground; correct axle_height or "
            "body_centre"
        )


def advice_on_masses(robot: Robot) -> Iterator[Advice]:
    """Yield what is wrong with moments of inertia and the centre of mass."""
    m, spread = robot.masses, spreads(robot)
    if spread.min() <= -1e-9 * spread.max():
        worst = int(np.argmin(spread))
        others = [k for k in range(3) if k != worst]
        inertia = m.inertia
        yield Advice(
            f"no body has the moments of inertia {_listed(inertia)} kg m2: that about {'xyz'[worst]} must be at most "
            "the sum of "
            f"the other two, {inertia[others[0]] + inertia[others[1]]:.4g} kg m2; leave inertia out to have that of a box"
        )
    else:
        yield from _advice_on_size(robot)
    low, high = robot_outline(robot)
    outside = [k for k in range(3) if not low[k] <= m.com[k] <= high[k]]
    if outside:
        k = outside[0]
        yield Advice(
            f"the centre of mass lies outside of the robot: {'xyz'[k]} is {m.com[k]:g} m, hull and tyres reach from "
            f"{low[k]:.3g} to {high[k]:.3g} m"
        )
    yield from _advice_on_wheels(robot)


def _advice_on_size(robot: Robot) -> Iterator[Advice]:
    """Yield whether the mass would have to lie outside of the robot for these moments of inertia, or all in its middle."""
    com, (low, high) = np.array(robot.masses.com), robot_outline(robot)
    most = np.maximum((high - com) * (com - low), 0.0)  # all mass at both ends
    spread = np.maximum(spreads(robot), 0.0)
    usual = np.array(robot.geometry.body_size) ** 2 / 12.0
    for k, axis in enumerate("xyz"):
        if spread[k] > most[k] * (1.0 + 1e-9):
            yield Advice(
                f"these moments of inertia need mass {1e3 * math.sqrt(spread[k]):.0f} mm from its centre along {axis} "
                "in the "
                f"mean, and hull and tyres allow {1e3 * math.sqrt(most[k]):.0f} mm: is it inertia about another point, "
                "or in "
                "another unit?",
                fault=False,
            )
    if spread.sum() < COMPACT**2 * usual.sum():
        box = (usual.sum() - usual) * robot.base_mass
        yield Advice(
            f"the moments of inertia {_listed(robot.masses.inertia)} kg m2 are those of a much smaller body; a uniform "
            "hull of "
            f"this size and mass has {_listed(box)} kg m2",
            fault=False,
        )


def _advice_on_wheels(robot: Robot) -> Iterator[Advice]:
    """Yield what is wrong with the moments of inertia of a wheel."""
    g, m = robot.geometry, robot.masses
    across, spin = m.wheel_inertia
    radius2 = g.wheel_radius**2
    if spin > m.wheel * radius2 * (1.0 + 1e-9):
        yield Advice(
            f"a wheel of {m.wheel:g} kg and {g.wheel_radius:g} m cannot have {spin:.4g} kg m2 about its axle: the most is "
            f"m r^2 = {m.wheel * radius2:.4g}, with all mass in the tread, and a solid cylinder has half of it"
        )
    most = m.wheel * (0.5 * radius2 + 0.25 * g.wheel_width**2)
    if across > most * (1.0 + 1e-9):
        yield Advice(
            f"a wheel of {m.wheel:g} kg, {g.wheel_radius:g} m and {g.wheel_width:g} m wide cannot have {across:.4g} kg m2 "
            f"about a diameter: the most is m (r^2 / 2 + width^2 / 4) = {most:.4g}"
        )
    if spin > 2.0 * across * (1.0 + 1e-9):
        yield Advice(
            f"no wheel has {spin:.4g} kg m2 about its axle and {across:.4g} about a diameter: the first is at most "
            "twice the "
            "second; are they swapped? wheel_inertia has the diameter first"
        )


def _listed(values: object) -> str:
    return ", ".join(f"{v:.4g}" for v in values)  # type: ignore[attr-defined]


def advice_on_loads(robot: Robot) -> Iterator[Advice]:
    """Yield whether the four wheels carry the robot."""
    g, shares = robot.geometry, load_shares(robot)
    x, y, z = whole_com(robot)
    where = f"the whole robot's centre of mass is {x:.3g} m ahead and {y:.3g} m to the left of the middle"
    least = int(np.argmin(shares))
    wheel = WHEELS[least].replace("_", " ")
    if shares[least] <= 0.0:
        used = 2.0 * abs(x) / g.wheelbase + 2.0 * abs(y) / g.track
        yield Advice(
            f"the {wheel} wheel carries nothing: {where}, and 2 |x| / wheelbase + 2 |y| / track must be less than 1, "
            f"not {used:.2f}"
        )
    elif shares[least] < 0.25 * LITTLE_LOAD:
        yield Advice(
            f"the {wheel} wheel carries only {100.0 * shares[least]:.1f} % of the weight: {where}; weigh each wheel if "
            "you can",
            fault=False,
        )
    height = z - g.axle_height + g.wheel_radius
    tip = math.degrees(math.atan2(0.5 * g.track - abs(y), max(height, 1e-9)))
    if 0.0 < tip < 25.0:
        yield Advice(f"it tips over on a side slope of {tip:.0f}°: its centre of mass is {height:.3g} m high", fault=False)


def advice_on_motors(robot: Robot, spot: SpotTurn | None) -> Iterator[Advice]:
    """Yield whether the motors can turn the robot on the spot, and whether its driver allows for slip."""
    drive, mu, radius = robot.drive, robot.simulation.friction, robot.geometry.wheel_radius
    if spot is None:
        return
    if not math.isfinite(drive.torque_limit):
        yield Advice("no torque_limit is given, so it can turn on any ground: say that of one wheel [N m]", fault=False)
    else:
        needed, has = mu * spot.side_torque + drive.gear_loss, 2.0 * drive.torque_limit
        most = (has - drive.gear_loss) / spot.side_torque
        if needed > has:
            yield Advice(
                f"it cannot turn on the spot on ground of friction {mu:g}: a side needs {needed:.4g} N m and its motors "
                "give "
                f"{has:.4g} N m; torque_limit must be at least {0.5 * needed:.4g} N m a wheel, or friction at most "
                f"{most:.2g}"
            )
    turned = drive.command_half_track / drive.command_radius * radius * spot.turn.yaw_rate
    if abs(turned - 1.0) > DRIVER_LIMIT and turned > 0.0:
        right = 1.0 / spot.turn.yaw_rate * drive.command_radius / radius
        yield Advice(
            f"turning on the spot it reaches {turned:.2f} of the yaw rate that is commanded, for skidding wheels slip: "
            "with a "
            f"command_half_track of {right:.3g} m, not {drive.command_half_track:g} m, it would reach all of it",
            fault=False,
        )


def advice_on_simulation(robot: Robot, found: Measured, closed_form: float | None) -> Iterator[Advice]:
    """Yield where the simulated robot does not do what mechanics says."""
    if found.multiplier is None or found.ripple is None:
        yield Advice("the simulated robot did not turn once on the spot in twice the time that mechanics allows it")
    elif closed_form is not None and abs(found.multiplier / closed_form - 1.0) > MULTIPLIER_LIMIT:
        yield Advice(
            f"the simulated robot turns with a multiplier of {found.multiplier:.3f}, and mechanics says {closed_form:.3f}: "
            "keep the usual wheel_shape and timestep"
        )
    if found.lifted_share > 0.0:
        yield Advice(
            f"a wheel leaves the ground in {100.0 * found.lifted_share:.0f} % of a slow turn on the spot: move the "
            "centre of "
            "mass to the middle and down, or lower the friction"
        )
    if found.ripple is not None and found.ripple > RIPPLE_LIMIT:
        yield Advice(
            f"the yaw rate of a turn on the spot varies by {100.0 * found.ripple:.1f} % of its mean: take a smaller "
            "timestep "
            f"than {robot.simulation.timestep:g} s, or a wheel_shape of ellipsoid",
            fault=False,
        )
    weight = robot.masses.total * WEIGHT_PER_KG
    if abs(sum(found.loads) / weight - 1.0) > 0.01:
        yield Advice(
            f"the wheels carry {sum(found.loads):.0f} N of a weight of {weight:.0f} N: does a part touch the ground?"
        )
