"""The physics settings that the contact study tries: one at a time from those shipped, and together as in other simulators.

The thesis tried friction models, iterations, steps and contact layers of ODE in Gazebo (Sec. 3.7) without success. These are
the settings of MuJoCo that correspond to them. docs/contact.md says what they do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from validation.simulator.calibration import Calibration
from validation.simulator.description import Robot, load_robot
from validation.simulator.physics import SHIPPED, PhysicsSettings


@dataclass(frozen=True)
class PhysicsVariant:
    """Physics settings to be tried."""

    group: str
    """Name of what is varied."""
    name: str
    """Name in tables; unique in its group."""
    settings: PhysicsSettings = SHIPPED
    """Settings of the physics engine."""
    changes: Mapping[str, float | str] = field(default_factory=dict)
    """Fields of `Calibration` that change too."""

    def calibration(self, base: Calibration) -> Calibration:
        """Return a robot's parameters with the changes.

        Raises:
            ValueError: they do not fit together.
        """
        return replace(base, **dict(self.changes))  # type: ignore[arg-type]

    @property
    def key(self) -> str:
        """Group and name."""
        return f"{self.group}: {self.name}"


BASELINE = PhysicsVariant("shipped", "as shipped")
"""Settings that all others are compared with."""
MUJOCO_IMPEDANCE = (0.9, 0.95, 0.001, 0.5, 2.0)
"""MuJoCo's default `solimp`."""
_HARD_IMPEDANCE = (0.99, 0.999, 0.001, 0.5, 2.0)
_HARD_REFERENCE = (0.004, 1.0)
"""`solimp` and `solref` of a contact as hard as a step of 1 to 2 ms lets it be."""
_MAKER_NOW, _MAKER_EARLIER = (-0.00065, -0.085), (-0.08748, -0.00085)
"""Centres of mass of a Husky's descriptions by its maker [m]."""


class _Sizes(NamedTuple):
    """A robot's lengths and times over those of the usual robot, for which the settings below are given."""

    owner: str  # whose centres of mass are tried
    depth: float  # of the contact
    time: float  # of the contact
    ahead: float
    left: float

    def soft(self, at_no_depth: float, width: float = 0.005) -> PhysicsSettings:
        """Return the shipped contact with another impedance at zero depth, or another depth [m]."""
        return PhysicsSettings(solimp=(at_no_depth, 0.95, self.depth * width, 0.5, 2.0))

    def centre(self, place: tuple[float, float]) -> Mapping[str, float | str]:
        """Return a centre of mass at the same place between the wheels."""
        return {"com_x": self.ahead * place[0], "com_y": self.left * place[1]}


def _sizes(robot: Robot | None) -> _Sizes:
    own, usual = (r.geometry for r in (robot or load_robot(), load_robot()))
    depth = own.wheel_radius / usual.wheel_radius
    owner = "maker's" if own == usual else "Husky maker's"
    return _Sizes(owner, depth, math.sqrt(depth), own.wheelbase / usual.wheelbase, own.track / usual.track)


def _one_at_a_time(sizes: _Sizes) -> list[PhysicsVariant]:
    default = PhysicsSettings(solimp=MUJOCO_IMPEDANCE)
    v, s = PhysicsVariant, PhysicsSettings
    made = [v("cone", "pyramidal", s(cone="pyramidal"))]
    made += [v("cone", "pyramidal, impratio 1", s(cone="pyramidal", impratio=1.0))]
    made += [v("impratio", f"{x:g}", s(impratio=x)) for x in (1.0, 10.0, 1000.0)]
    made += [v("noslip", f"{n} iterations", s(noslip=n)) for n in (3, 10)]
    made += [v("noslip", "3 iterations, impratio 1", s(noslip=3, impratio=1.0))]
    made += [v("condim", f"{n}", s(condim=n)) for n in (4, 6)]
    widths = [(w * sizes.depth, sizes.soft(0.1, 1e-3 * w)) for w in (2.0, 10.0)]
    made += [v("solimp", f"over {mm:.3g} mm of depth", soft) for mm, soft in widths]
    made += [v("solimp", f"{d:g} at no depth", sizes.soft(d)) for d in (0.3, 0.5, 0.9)]
    made += [v("solimp", "MuJoCo's default", default), v("solimp", "hard", s(solimp=_HARD_IMPEDANCE))]
    made += [v("solref", f"{t:.3g} s", s(solref=(t, 1.0))) for t in (sizes.time * x for x in (0.005, 0.01, 0.04))]
    made += [v("solref", f"damping ratio {d:g}", s(solref=(0.02 * sizes.time, d))) for d in (0.3, 3.0)]
    made += [v("solver", "Newton, 2 iterations", s(solver="Newton", iterations=2))]
    made += [v("solver", f"CG, {n} iterations", s(solver="CG", iterations=n)) for n in (5, 50)]
    made += [v("solver", f"PGS, {n} iteration{'s' * (n > 1)}", s(solver="PGS", iterations=n)) for n in (1, 5, 20, 50, 200)]
    made += [v("integrator", name, s(integrator=name)) for name in ("Euler", "implicit", "RK4")]
    made += [v("time step", f"{1e3 * dt:g} ms", changes={"timestep": dt}) for dt in (0.0005, 0.001, 0.005, 0.01)]
    made += [v("wheels", shape, changes={"wheel_shape": shape}) for shape in ("capsule", "cylinder")]
    for ratio in (1.24, 0.6):
        made += [v("anisotropy", f"{ratio:g}, capsule", changes={"wheel_shape": "capsule", "friction_ratio": ratio})]
        for shape in ("ellipsoid", "cylinder"):
            made += [v("anisotropy", f"{ratio:g}, {shape}", s(tangent_ratio=ratio), {"wheel_shape": shape})]
    whose, now = sizes.owner, sizes.centre(_MAKER_NOW)
    made += [v("centre of mass", f"{whose}, now", changes=now)]
    made += [v("centre of mass", f"{whose}, earlier", changes=sizes.centre(_MAKER_EARLIER))]
    made += [v("centre of mass", f"{whose}, now; pyramidal", s(cone="pyramidal"), now)]
    aside = -0.03 * sizes.left
    words = f"{-1e3 * aside:.3g} mm to the right; pyramidal"
    return [*made, v("centre of mass", words, s(cone="pyramidal"), {"com_y": aside})]


def _together(sizes: _Sizes) -> list[PhysicsVariant]:
    default, v, s = PhysicsSettings(solimp=MUJOCO_IMPEDANCE), PhysicsVariant, PhysicsSettings
    group = "default contact"
    made = [v(group, f"{1e3 * dt:g} ms", default, {"timestep": dt}) for dt in (0.0005, 0.005)]
    made += [v(group, "noslip 10", replace(default, noslip=10)), v(group, "impratio 10", replace(default, impratio=10.0))]
    made += [v(group, "cylinders", default, {"wheel_shape": "cylinder"})]
    cylinders: dict[str, float | str] = {"wheel_shape": "cylinder"}
    plain = s("pyramidal", 1.0, solimp=MUJOCO_IMPEDANCE, iterations=100, integrator="Euler")
    ode = s(
        "pyramidal", 1.0, solimp=_HARD_IMPEDANCE, solref=_HARD_REFERENCE, solver="PGS", iterations=50, integrator="Euler"
    )
    fine: dict[str, float | str] = {**cylinders, "timestep": 0.001}
    group = "together"
    made += [v(group, "MuJoCo's defaults", plain, cylinders)]
    whose, now = sizes.owner, sizes.centre(_MAKER_NOW)
    made += [v(group, f"MuJoCo's defaults, {whose} centre", plain, {**cylinders, **now})]
    tab316 = replace(ode, cone="elliptic", iterations=400, tangent_ratio=0.6)
    made += [v(group, "near Tab. 3.16", tab316, {**fine, "friction": 0.25})]
    made += [v(group, "near ODE", ode, fine), v(group, "near ODE, 10 iterations", replace(ode, iterations=10), fine)]
    group = "near ODE, maker's centre"
    off = {**fine, **now}
    soft = replace(ode, cone="elliptic", solimp=None, solref=None)
    made += [v(group, "as it is", ode, off), v(group, "and an elliptic cone", replace(ode, cone="elliptic"), off)]
    made += [v(group, "and soft contact", soft, off), v(group, "and the centre in the middle", soft, fine)]
    return made


def physics_variants(robot: Robot | None = None) -> tuple[PhysicsVariant, ...]:
    """Return all variants for a robot, the usual one if it is not given; the baseline is the first.

    Depths and times of the contact follow from the size of the wheels as the shipped ones do, and centres of mass from the
    places of the wheels. MuJoCo's own defaults, hard contacts and time steps are the same for all robots.
    """
    sizes = _sizes(robot)
    return (BASELINE, *_one_at_a_time(sizes), *_together(sizes))


def variant_groups() -> tuple[str, ...]:
    """Return the names of what is varied, in order."""
    return tuple(dict.fromkeys(v.group for v in physics_variants()))


def chosen_variants(only: Sequence[str], robot: Robot | None = None) -> tuple[PhysicsVariant, ...]:
    """Return the baseline and a robot's variants of some groups; all variants if none is named.

    Raises:
        ValueError: an unknown group.
    """
    unknown = [name for name in only if name not in variant_groups()]
    if unknown:
        raise ValueError(f"unknown group '{', '.join(unknown)}' in only; there are: {', '.join(variant_groups())}")
    return tuple(v for v in physics_variants(robot) if not only or v.group in only or v == BASELINE)
