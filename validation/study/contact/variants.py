"""The physics settings that the contact study tries: one at a time from those shipped, and together as in other simulators.

The thesis tried friction models, iterations, steps and contact layers of ODE in Gazebo (Sec. 3.7) without success. These are
the settings of MuJoCo that correspond to them. docs/contact.md says what they do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from validation.simulator.calibration import Calibration
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
_MAKER_NOW: Mapping[str, float | str] = {"com_x": -0.00065, "com_y": -0.085}
_MAKER_EARLIER: Mapping[str, float | str] = {"com_x": -0.08748, "com_y": -0.00085}
"""Centres of mass of the maker's robot descriptions [m]."""


def _soft(at_no_depth: float) -> PhysicsSettings:
    """Return the shipped contact with another impedance at zero depth."""
    return PhysicsSettings(solimp=(at_no_depth, 0.95, 0.005, 0.5, 2.0))


def _one_at_a_time() -> list[PhysicsVariant]:
    default = PhysicsSettings(solimp=MUJOCO_IMPEDANCE)
    v, s = PhysicsVariant, PhysicsSettings
    made = [v("cone", "pyramidal", s(cone="pyramidal"))]
    made += [v("cone", "pyramidal, impratio 1", s(cone="pyramidal", impratio=1.0))]
    made += [v("impratio", f"{x:g}", s(impratio=x)) for x in (1.0, 10.0, 1000.0)]
    made += [v("noslip", f"{n} iterations", s(noslip=n)) for n in (3, 10)]
    made += [v("noslip", "3 iterations, impratio 1", s(noslip=3, impratio=1.0))]
    made += [v("condim", f"{n}", s(condim=n)) for n in (4, 6)]
    made += [v("solimp", f"over {w:g} mm of depth", s(solimp=(0.1, 0.95, 1e-3 * w, 0.5, 2.0))) for w in (2.0, 10.0)]
    made += [v("solimp", f"{d:g} at no depth", _soft(d)) for d in (0.3, 0.5, 0.9)]
    made += [v("solimp", "MuJoCo's default", default), v("solimp", "hard", s(solimp=_HARD_IMPEDANCE))]
    made += [v("solref", f"{t:g} s", s(solref=(t, 1.0))) for t in (0.005, 0.01, 0.04)]
    made += [v("solref", f"damping ratio {d:g}", s(solref=(0.02, d))) for d in (0.3, 3.0)]
    made += [v("solver", "Newton, 2 iterations", s(iterations=2))]
    made += [v("solver", f"CG, {n} iterations", s(solver="CG", iterations=n)) for n in (5, 50)]
    made += [v("solver", f"PGS, {n} iteration{'s' * (n > 1)}", s(solver="PGS", iterations=n)) for n in (1, 5, 20, 50, 200)]
    made += [v("integrator", name, s(integrator=name)) for name in ("Euler", "implicit", "RK4")]
    made += [v("time step", f"{1e3 * dt:g} ms", changes={"timestep": dt}) for dt in (0.0005, 0.001, 0.005, 0.01)]
    made += [v("wheels", shape, changes={"wheel_shape": shape}) for shape in ("capsule", "cylinder")]
    for ratio in (1.24, 0.6):
        made += [v("anisotropy", f"{ratio:g}, capsule", changes={"wheel_shape": "capsule", "friction_ratio": ratio})]
        for shape in ("ellipsoid", "cylinder"):
            made += [v("anisotropy", f"{ratio:g}, {shape}", s(tangent_ratio=ratio), {"wheel_shape": shape})]
    made += [v("centre of mass", "maker's, now", changes=_MAKER_NOW)]
    made += [v("centre of mass", "maker's, earlier", changes=_MAKER_EARLIER)]
    made += [v("centre of mass", "maker's, now; pyramidal", s(cone="pyramidal"), _MAKER_NOW)]
    made += [v("centre of mass", "30 mm to the right; pyramidal", s(cone="pyramidal"), {"com_y": -0.03})]
    return made


def _together() -> list[PhysicsVariant]:
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
    made += [v(group, "MuJoCo's defaults, maker's centre", plain, {**cylinders, **_MAKER_NOW})]
    tab316 = replace(ode, cone="elliptic", iterations=400, tangent_ratio=0.6)
    made += [v(group, "near Tab. 3.16", tab316, {**fine, "friction": 0.25})]
    made += [v(group, "near ODE", ode, fine), v(group, "near ODE, 10 iterations", replace(ode, iterations=10), fine)]
    group = "near ODE, maker's centre"
    off = {**fine, **_MAKER_NOW}
    soft = replace(ode, cone="elliptic", solimp=None, solref=None)
    made += [v(group, "as it is", ode, off), v(group, "and an elliptic cone", replace(ode, cone="elliptic"), off)]
    made += [v(group, "and soft contact", soft, off), v(group, "and the centre in the middle", soft, fine)]
    return made


def physics_variants() -> tuple[PhysicsVariant, ...]:
    """Return all variants, the baseline first."""
    return (BASELINE, *_one_at_a_time(), *_together())


def variant_groups() -> tuple[str, ...]:
    """Return the names of what is varied, in order."""
    return tuple(dict.fromkeys(v.group for v in physics_variants()))


def chosen_variants(only: Sequence[str]) -> tuple[PhysicsVariant, ...]:
    """Return the baseline and the variants of some groups; all variants if none is named.

    Raises:
        ValueError: an unknown group.
    """
    unknown = [name for name in only if name not in variant_groups()]
    if unknown:
        raise ValueError(f"unknown group '{', '.join(unknown)}' in only; there are: {', '.join(variant_groups())}")
    return tuple(v for v in physics_variants() if not only or v.group in only or v == BASELINE)
