"""The section on friction laws: the arctangent in place of the signum, and its line about rest (Sec. 2.3, Fig. 2.9)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ssmr.models.coulomb import CoulombParameters, resistance
from ssmr.models.friction import arctangent_friction, coulomb_friction, hyperviscous_friction, implied_steepness
from ssmr.models.linear import LinearParameters, coefficients
from ssmr.parameters import packed
from ssmr.robot.vehicle import Drive, Vehicle, vehicle_body
from ssmr.simulation import PLANAR_DT, PlanarModel
from validation.replicate.evidence import Context, Findings, Section, Table
from validation.report.drawing import Ink, Panel, draw_footer, ink_of, put_together, side_by_side, text_row
from validation.thesis import published
from validation.thesis.verdicts import Pair

_STEEP = 10.0
"""The thesis asks for k_s much greater than 1. This is taken to mean at least this many s/m."""
_DRIVEN = 0.5
"""Speed at which the resistance to turning is drawn [m/s], that of trajectories 2 to 4: all wheels roll forwards."""
_SMOOTH_INK: Ink = "#7a5195"
"""Ink of the arctangent, which is no plant."""


def friction_findings() -> tuple[Table, float, float]:
    """Return how steep an arctangent the fitted coefficients imply, and two numbers about Fig. 2.9.

    Returns:
        The table; the share of Coulomb friction that the arctangent of Fig. 2.9 has at 0.25 m/s [1]; and the speed at which
        its line about rest passes Coulomb friction [m/s].
    """
    dry, viscous, drawn = CoulombParameters(), LinearParameters(), published.value("text", "k_s_figure_2_9")
    (dry_force, dry_moment), (force, moment) = _dry(_DRIVEN, 1e-3), _viscous(1.0, 1.0)

    def steepness(viscous: float, coefficient: float) -> dict[str, Pair]:
        implied = implied_steepness(viscous, coefficient)
        return {"value": Pair(drawn, implied, "at_least", "s/m", beside={"at_least": _STEEP})}

    rows = {
        "k_s of K_u and u_x": steepness(viscous.k_u, dry.u_x),
        "k_s of K_y and mu_c": steepness(viscous.k_y, dry.mu_c),
        "speed of equal resistance": {"value": Pair(None, dry_force / force, "none", "m/s")},
        "yaw rate of equal resistance": {"value": Pair(None, dry_moment / moment, "none", "rad/s")},
    }
    return (
        Table("Steepness of the arctangent whose slope at rest is the linear model's friction", rows),
        arctangent_friction(1.0, 1.0, 0.25, drawn),
        1.0 / hyperviscous_friction(1.0, 1.0, 1.0, drawn),
    )


def _dry(v: float, w: float) -> tuple[float, float]:
    """Return the Coulomb model's resisting force [N] and moment [N m] with the numbers of Tab. 3.8."""
    force, moment = resistance(v, w, PlanarModel(CoulombParameters(), Vehicle(), Drive()).packed(PLANAR_DT))
    return force, moment


def _viscous(v: float, w: float) -> tuple[float, float]:
    """Return the linear model's resisting force [N] and moment [N m] with the numbers of Tab. 3.14."""
    vehicle = Vehicle()
    rates = coefficients(vehicle_body(packed(vehicle)), packed(LinearParameters()))
    return rates.friction * vehicle.mass * v, rates.friction_yaw * vehicle.yaw_inertia * w


def draw_friction() -> Figure:
    """Draw Fig. 2.9, and beside it what Tab. 3.8 and 3.14 make of force and moment."""
    panels: list[Panel] = [
        _draw_laws,
        partial(_draw_fitted, 0, 1.0, "Resistance to driving [N]", "speed [m/s]"),
        partial(_draw_fitted, 1, 1.5, "Resistance to turning [N m]", "yaw rate [rad/s]"),
    ]
    foot = (
        "middle and right: Tab. 3.8 and 3.14, the linear model as it is used (errata 4 and 5) · "
        f"turning at {_DRIVEN:g} m/s, where all wheels roll forwards"
    )
    return put_together([side_by_side(3.6, panels), text_row(0.3, partial(draw_footer, foot))])


def _draw_laws(ax: Axes) -> None:
    steepness = published.value("text", "k_s_figure_2_9")
    v = np.linspace(-0.25, 0.25, 1001)
    laws: Mapping[str, tuple[Ink, Callable[[float], float]]] = {
        "signum": (ink_of("coulomb"), lambda x: coulomb_friction(1.0, 1.0, x)),
        f"arctangent, k_s = {steepness:g} s/m": (_SMOOTH_INK, lambda x: arctangent_friction(1.0, 1.0, x, steepness)),
        "its line about rest": (ink_of("linear"), lambda x: hyperviscous_friction(1.0, 1.0, x, steepness)),
    }
    for name, (ink, law) in laws.items():
        ax.plot(v, [law(x) for x in v.tolist()], color=ink, linewidth=1.9, label=name, gid=name)
    ax.set(ylim=(-1.9, 1.9), xlim=(v[0], v[-1]), xlabel="sliding speed [m/s]", title="Fig. 2.9: friction over μN")
    ax.legend(frameon=False, fontsize=8.0, loc="lower right")


def _draw_fitted(part: int, most: float, title: str, label: str, ax: Axes) -> None:
    """Draw what both models oppose to a speed (part 0), or to a yaw rate at the speed of the trajectories (part 1)."""
    at = np.linspace(-most, most, 1001)
    for name, law in (("coulomb", _dry), ("linear", _viscous)):
        values = [law(*((x, 0.0) if part == 0 else (_DRIVEN, x)))[part] for x in at.tolist()]
        ax.plot(at, values, color=ink_of(name), linewidth=1.9, label=f"{name} model, published", gid=name)
    ax.set(title=title, xlabel=label, xlim=(-most, most), xticks=np.arange(-most, most + 0.1, 0.5))
    ax.legend(frameon=False, fontsize=8.0, loc="upper left")


def _laws(context: Context) -> Findings:
    table, share, passes = friction_findings()
    steepness = published.value("text", "k_s_figure_2_9")
    notes = (
        "The thesis derives the linear model's friction as the slope at rest of Coulomb friction whose signum is an "
        "arctangent of steepness k_s (Eq. 2.33-2.40). It asks for k_s much greater than 1, which is taken to mean at least "
        f"{_STEEP:g} s/m, and draws {steepness:g} in Fig. 2.9. With that, the arctangent has {100.0 * share:.0f} % of "
        f"Coulomb friction at 0.25 m/s, and its line passes Coulomb friction at {1e3 * passes:.0f} mm/s: it holds for a "
        "robot that hardly moves.",
        "The fitted K_u and K_y are not such slopes. Their lines meet the dry friction of Tab. 3.8 at about the speed and "
        "the greatest yaw rate of trajectory 4 (0.5 m/s, 0.75 rad/s), to which they were fitted: they are secants of it.",
    )
    caption = (
        "Left, Fig. 2.9 drawn anew: friction with the signum, with the arctangent, and its line about rest. Middle and "
        "right, what the published Coulomb and linear models oppose to driving and to turning."
    )
    return Findings({"Fig. 2.9": table}, notes=notes, pictures=(context.picture("laws", draw_friction(), caption),))


FRICTION_SECTIONS = (Section("friction", "Friction laws", ("Fig. 2.9",), (), _laws),)
"""The section on chapter 2."""
