"""Robots that differ from their profile: by how much they do, drawn at random, and what the worst of them cost.

This is the one place that says how uncertain a robot is. The ranges of `Mismatch` are those that the shipped profiles and
the errors of their identification show; `tune --robots robust` draws from them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ssmr.parameters import described, parameter
from ssmr.search.space import ParameterSpace, declared
from ssmr.types import FloatArray
from validation.bench.loops import ClosedLoopRobot, make_robot
from validation.plants.kind import PlantProfile
from validation.plants.profile import Profile
from validation.simulator.description import Robot

WORST = 0.2
"""Share of the robots that count as the worst: the conditional value at risk (CVaR) is the mean over them."""
TUNING, SCORING = range(2)
"""Purposes of a draw. With one seed, every purpose has robots of its own, which the others have not seen."""
_MOST_SIDES = 0.099
"""Greatest difference of the two sides' rolling radii, over the radius [1]; simulated robots allow a tenth."""


@dataclass(frozen=True)
class Mismatch:
    """The difference between a robot and its profile; each field declares the range that it is drawn from."""

    mass: float = parameter(1.0, unit="1", low=0.0, open_low=True, search=(0.7, 1.6), scale="log")
    """Factor of the mass, and of the body's yaw inertia with it [1]: the lab's robot weighs 73 kg, bare it weighs
    50, with its full load 125."""
    friction: float = parameter(1.0, unit="1", low=0.0, open_low=True, search=(0.7, 1.4), scale="log")
    """Factor of the friction between tyre and ground; of the lateral friction in planar models [1]. The profiles hold it at
    0.5, because 0.35 to 0.7 explain their motions as well."""
    com_x: float = parameter(0.0, unit="m", low=-10.0, search=(-0.156, 0.156), of="half_wheelbase")
    """Shift of the centre of mass forward [m]: the recorded Husky's lies 4.0 cm behind the middle. Of
    the planar models only `coulomb` and `kinematic` have it, as their centre of rotation."""
    com_y: float = parameter(0.0, unit="m", low=-10.0, search=(-0.07, 0.07), of="half_track")
    """Shift of the centre of mass to the left [m]: the recorded Husky's lies 1.9 cm to the left. Planar models have none."""
    delay: float = parameter(0.0, unit="s", low=-10.0, search=(-0.1, 0.1))
    """Addition to the dead times of commands, which stay at 0 or above [s]: three standard errors of husky-tile's; plants
    that were fitted to that one recording differ by 0.14 s."""
    sides: float = parameter(0.0, unit="1", low=-1.0, high=1.0, search=(-0.06, 0.06))
    """Way of the left wheels less that of the right in one turn, over its mean [1]: 0.058 on tile, 0.004 for the same
    machine on grass, -0.020 for the Warthog."""
    slip: float = parameter(0.0, unit="1", low=-1.0, high=0.9, search=(-0.05, 0.05))
    """Share by which wheels roll less far than the profile says [1]: of the way that was commanded the profiles' robots go
    0.93 to 0.98."""

    @property
    def label(self) -> str:
        """The differences in words; `nominal` if there is none."""
        usual = Mismatch()
        texts = {
            "mass": f"mass {100.0 * (self.mass - 1.0):+.0f} %",
            "friction": f"friction {100.0 * (self.friction - 1.0):+.0f} %",
            "com_x": f"centre {100.0 * abs(self.com_x):.2g} cm {'back' if self.com_x < 0.0 else 'ahead'}",
            "com_y": f"centre {100.0 * abs(self.com_y):.2g} cm {'right' if self.com_y < 0.0 else 'left'}",
            "delay": f"delay {self.delay:+.2f} s",
            "sides": f"{'left' if self.sides > 0.0 else 'right'} wheels {100.0 * abs(self.sides):.2g} % larger",
            "slip": f"slip {100.0 * self.slip:+.0f} %",
        }
        return ", ".join(text for name, text in texts.items() if getattr(self, name) != getattr(usual, name)) or "nominal"


def _space(robot: Robot) -> ParameterSpace:
    """Return the ranges of a robot: shifts of the centre of mass grow with its wheelbase and track."""
    return ParameterSpace(tuple(declared(d, d.bounds(robot.sizes)) for d in described(Mismatch).values()))


def draw_mismatches(count: int, seed: int, purpose: int, robot: Robot) -> tuple[Mismatch, ...]:
    """Return mismatches drawn at random: each range is cut into `count` strips, and every strip is drawn from once.

    Args:
        count: number of robots.
        seed: seed of the draw.
        purpose: `TUNING` or `SCORING`.
        robot: the robot, whose size matters for shifts of the centre of mass.
    """
    space, rng = _space(robot), np.random.default_rng((seed, purpose))
    strips = rng.permuted(np.tile(np.arange(count), (len(space), 1)), axis=1).T
    points = (strips + rng.random(strips.shape)) / max(count, 1)
    return tuple(Mismatch(**dict(zip(space.names, map(float, space.values(p)), strict=True))) for p in points)


def mismatched(profile: Profile, plant: str, mismatch: Mismatch) -> ClosedLoopRobot:
    """Return a robot that differs from its profile, and of whose difference no controller knows.

    Args:
        profile: the numbers of the robot that it was taken for.
        plant: name of the plant.
        mismatch: the difference. What a plant lacks stays as it is: planar models have no lateral centre of mass, and the
            kinematic one has no mass and no friction.

    Raises:
        ProfileError: an unknown plant, or changed numbers that are out of range.
    """
    section = profile.section(plant)
    drive = section.drive
    late = {name: max(0.0, getattr(drive, name) + mismatch.delay) for name in ("delay_v", "delay_w")}
    has_body = hasattr(section.parameters, "wheel_radius")
    changed = _changed_body(section, mismatch) if has_body else _changed_model(section, mismatch)
    changed = replace(changed, drive=replace(drive, **late))
    robot = make_robot(replace(profile, plants={**profile.plants, plant: changed}), plant)
    return replace(robot, known=drive)


def _radii(body: Any, m: Mismatch) -> dict[str, float]:
    """Return the mean radius of the wheels and the difference of the sides' [m]."""
    way = 1.0 - m.slip
    sides = min(max(body.radius_difference / body.wheel_radius + m.sides, -_MOST_SIDES), _MOST_SIDES)
    difference = sides * way * body.wheel_radius if m.sides else way * body.radius_difference
    return {"wheel_radius": way * body.wheel_radius, "radius_difference": difference}


def _changed_body(section: PlantProfile, m: Mismatch) -> PlantProfile:
    """Return the numbers of a plant that has a body of its own: its wheels bear the load but do not become heavier."""
    robot, own = section.robot, section.parameters
    body: Any = own
    rest, rest_inertia = robot.masses.total - robot.base_mass, robot.yaw_inertia - robot.masses.inertia[2]
    more = (m.mass * body.mass - rest) / (body.mass - rest)
    numbers = {
        **_radii(body, m),
        "mass": m.mass * body.mass,
        "yaw_inertia": rest_inertia + more * (body.yaw_inertia - rest_inertia) if m.mass != 1.0 else body.yaw_inertia,
        "com_x": body.com_x + m.com_x,
        "com_y": body.com_y + m.com_y,
    }
    if hasattr(body, "friction"):
        numbers["friction"] = m.friction * body.friction
    return replace(section, parameters=replace(own, **numbers))


def _changed_model(section: PlantProfile, m: Mismatch) -> PlantProfile:
    """Return the numbers of a planar model.

    Its motors have no integral part and would not bear a load up: resistances stay those of the profile's weight.
    """
    robot, own, vehicle, way = section.robot, section.parameters, section.vehicle, 1.0 - m.slip
    aside, along = m.friction / m.mass, 1.0 / m.mass
    factors = {"mu_s": aside, "mu_d": aside, "mu_c": aside, "k_y": aside, "u_x": along, "k_u": along}
    sized = {**_radii(vehicle, m), "mass": m.mass * vehicle.mass, "yaw_inertia": m.mass * vehicle.yaw_inertia}
    if hasattr(own, "alpha_l"):
        sized = {}
        factors = {"alpha_l": way * (1.0 + 0.5 * m.sides), "alpha_r": way * (1.0 - 0.5 * m.sides)}
    numbers = {name: factor * getattr(own, name) for name, factor in factors.items() if hasattr(own, name)}
    # four contacts turn about a point that lies (1 + track^2 / wheelbase^2) times as far off as the centre of mass
    x_icr = (1.0 + (robot.geometry.track / robot.geometry.wheelbase) ** 2) * m.com_x
    if hasattr(own, "x_icr"):
        numbers["x_icr"] = own.x_icr + x_icr
    else:
        sized["x_icr"] = vehicle.x_icr + x_icr
    return replace(section, parameters=replace(own, **numbers), vehicle=replace(vehicle, **sized))


def worst_mean(values: ArrayLike) -> FloatArray:
    """Return the mean of the worst fifth of (n, ...) values along the first axis, the conditional value at risk (CVaR).

    Where a fifth is no whole number of values, the last one counts in part. It is infinite where one of them is.
    """
    array = np.asarray(values, dtype=np.float64)
    tail = WORST * len(array)
    weights = np.minimum(tail - np.arange(math.ceil(tail)), 1.0) / tail
    falling = np.sort(array, axis=0)[::-1][: len(weights)]
    return np.asarray(np.tensordot(weights, falling, axes=1))


def spread(values: Sequence[float]) -> dict[str, float]:
    """Return mean, std (n - 1; 0 for one), cvar (mean of the worst fifth) and worst of values; infinite where one is."""
    array = np.asarray(values, dtype=np.float64)
    if not np.isfinite(array).all():
        return dict.fromkeys(("mean", "std", "cvar", "worst"), math.inf)
    std = float(array.std(ddof=1)) if len(array) > 1 else 0.0
    return {"mean": float(array.mean()), "std": std, "cvar": float(worst_mean(array)), "worst": float(array.max())}
