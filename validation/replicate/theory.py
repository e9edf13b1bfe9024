"""What needs no drive: friction laws (Sec. 2.3, Fig. 2.9), and the bounds of the PID's gains (Sec. 4.3.3)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from matplotlib.axes import Axes

from ssmr.control.pid import PidGains
from ssmr.control.stability import CascadeLoop, gain_range
from ssmr.models.coulomb import CoulombParameters, resistance
from ssmr.models.friction import arctangent_friction, coulomb_friction, hyperviscous_friction, implied_steepness
from ssmr.models.linear import LinearParameters, coefficients, matrices
from ssmr.parameters import packed
from ssmr.robot.vehicle import Drive, Vehicle, vehicle_body
from ssmr.simulation import PLANAR_DT, PlanarModel
from validation.replicate.chapters import Findings, Section, Task
from validation.replicate.control import GAIN_NAMES
from validation.report.drawing import ALARM, QUIET, Ink, Row, draw_section, ink_of, side_by_side, text_row
from validation.thesis import published
from validation.thesis.verdicts import Pair, Rows

_STEEP = 10.0
"""The thesis asks for k_s much greater than 1. This is taken to mean at least this many s/m."""
_SPEED = 0.5
"""Speed at which turning is looked at [m/s], that of trajectories 2 to 4, and of the faster references."""
_MOST = 100.0
"""Greatest gain that is looked at."""
_ALONG = ("K_P_rho", "K_I_rho", "K_P_u", "K_I_u")
"""Gains of the loop along the path; the others are those across."""
_MOST_GROWTH = 2.0
"""Greatest rate that is drawn [1/s]."""
_Law = Callable[[float], float]
_Laws = Mapping[str, tuple[Ink, _Law]]


def _laws(task: Task) -> Findings:
    """Find how steep an arctangent the fitted coefficients imply."""
    dry, viscous, drawn = CoulombParameters(), LinearParameters(), published.value("text", "k_s_figure_2_9")
    (dry_force, dry_moment), (force, moment) = _dry(_SPEED, 1e-3), _viscous(1.0, 1.0)
    steepness = {"k_s of K_u and u_x": (viscous.k_u, dry.u_x), "k_s of K_y and mu_c": (viscous.k_y, dry.mu_c)}
    rows = {
        name: {"value": Pair(drawn, implied_steepness(*numbers), "at_least", "s/m", beside={"at_least": _STEEP})}
        for name, numbers in steepness.items()
    }
    rows["speed of equal resistance"] = {"value": Pair(None, dry_force / force, "none", "m/s")}
    rows["yaw rate of equal resistance"] = {"value": Pair(None, dry_moment / moment, "none", "rad/s")}
    words = {
        "steep": _STEEP,
        "drawn": drawn,
        "share": arctangent_friction(1.0, 1.0, 0.25, drawn),
        "passes": 1e3 / hyperviscous_friction(1.0, 1.0, 1.0, drawn),
    }
    return Findings({"Fig. 2.9": rows}, words, panels=_drawn_laws(drawn))


def _dry(v: float, w: float) -> tuple[float, float]:
    """Return the Coulomb model's resisting force [N] and moment [N m] with the numbers of Tab. 3.8."""
    force, moment = resistance(v, w, PlanarModel(CoulombParameters(), Vehicle(), Drive()).packed(PLANAR_DT))
    return force, moment


def _viscous(v: float, w: float) -> tuple[float, float]:
    """Return the linear model's resisting force [N] and moment [N m] with the numbers of Tab. 3.14."""
    vehicle = Vehicle()
    rates = coefficients(vehicle_body(packed(vehicle)), packed(LinearParameters()))
    return rates.friction * vehicle.mass * v, rates.friction_yaw * vehicle.yaw_inertia * w


def _drawn_laws(steepness: float) -> list[Row]:
    """Return Fig. 2.9, and beside it what Tab. 3.8 and 3.14 make of force and moment."""
    laws: _Laws = {
        "signum": (ink_of("coulomb"), lambda x: coulomb_friction(1.0, 1.0, x)),
        f"arctangent, k_s = {steepness:g} s/m": ("#7a5195", lambda x: arctangent_friction(1.0, 1.0, x, steepness)),
        "its line about rest": (ink_of("linear"), lambda x: hyperviscous_friction(1.0, 1.0, x, steepness)),
    }

    def fitted(part: int) -> _Laws:
        def law(of: Callable[[float, float], tuple[float, float]]) -> _Law:
            return lambda x: of(*((x, 0.0) if part == 0 else (_SPEED, x)))[part]

        return {f"{n} model, published": (ink_of(n), law(of)) for n, of in (("coulomb", _dry), ("linear", _viscous))}

    def curves(laws: _Laws, most: float, title: str, label: str, ax: Axes) -> None:
        at = np.linspace(-most, most, 1001)
        for name, (ink, law) in laws.items():
            ax.plot(at, [law(x) for x in at.tolist()], color=ink, label=name, gid=name)
        ax.set(title=title, xlabel=label, xlim=(-most, most), xticks=np.linspace(-most, most, 5))
        ax.legend(frameon=False, fontsize=8.0)

    panels = [
        partial(curves, laws, 0.1, "Fig. 2.9: friction over μN", "sliding speed [m/s]"),
        partial(curves, fitted(0), 1.0, "Resistance to driving [N]", "speed [m/s]"),
        partial(curves, fitted(1), 1.5, "Resistance to turning [N m]", "yaw rate [rad/s]"),
    ]
    return [text_row(0.3, partial(draw_section, "Friction laws, and Tab. 3.8 and 3.14")), side_by_side(3.6, panels)]


def _loop(row: str, dead_time: float) -> CascadeLoop:
    a, b = matrices(Vehicle(), LinearParameters(), Drive())
    if row in _ALONG:
        return CascadeLoop("along", -a[1, 1], b[1, 0], _SPEED, dead_time=dead_time)
    return CascadeLoop("across", -a[3, 3], b[3, 1], _SPEED, dead_time=dead_time)


def bounds_rows() -> Rows:
    """Return the greatest gains that the linear model is stable with, beside the bounds of the thesis' search."""
    rows = {}
    for row, printed in published.table("4.4")["rows"].items():
        if "search" in printed:
            upper, name = printed["search"][1], GAIN_NAMES["pid"][row]
            low, high = gain_range(_loop(row, Drive().delay_v), PidGains(), name, _MOST) or (0.0, 0.0)
            free = gain_range(_loop(row, 0.0), PidGains(), name, _MOST) or (0.0, 0.0)
            beside = {"at_least": upper, "stable_from": low, "without_dead_time": free[1]}
            rows[row] = {"value": Pair(upper, high, "at_least", printed["unit"], beside=beside)}
    return rows


def _draw_growth(row: str, ax: Axes) -> None:
    """Draw the growth rate of the slowest error over a gain, from zero to twice the printed bound."""
    printed = published.table("4.4")["rows"][row]
    values = np.linspace(0.0, 2.0 * printed["search"][1], 41)
    for dead_time, ink in ((0.0, "0.72"), (Drive().delay_v, ink_of("linear"))):
        loop = _loop(row, dead_time)
        growth = [loop.growth(replace(PidGains(), **{GAIN_NAMES["pid"][row]: float(k)})) for k in values]
        ax.plot(values, np.clip(growth, -_MOST_GROWTH, _MOST_GROWTH), color=ink)
    ax.axvspan(*printed["search"], color="0.5", alpha=0.13, linewidth=0.0)
    ax.axvline(printed["optimised"], color="black", linewidth=0.9)
    ax.axhline(0.0, color=ALARM, linewidth=0.9)
    ax.set_title(row, color=QUIET)


def _stability(task: Task) -> Findings:
    """Find the bounds of Sec. 4.3.3."""
    rows = bounds_rows()
    beyond = [row for row, pairs in rows.items() if (pairs["value"].ours or 0.0) < (pairs["value"].published or 0.0)]
    gains = list(rows)
    heading = "Growth rate of the slowest error [1/s] over each gain; grey: without dead time, and the searched range"
    panels = [text_row(0.3, partial(draw_section, heading))]
    panels += [side_by_side(2.4, [partial(_draw_growth, row) for row in gains[k : k + 5]]) for k in range(0, len(gains), 5)]
    return Findings({"Sec. 4.3.3": rows}, {"speed": _SPEED, "beyond": ", ".join(beyond), "most": _MOST}, panels=panels)


THEORY_SECTIONS = (Section("friction", ("Fig. 2.9",), _laws), Section("stability", ("Sec. 4.3.3",), _stability))
"""The sections that drive nothing."""
