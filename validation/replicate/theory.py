"""What needs no drive: friction laws (Sec. 2.3, Fig. 2.9), and the bounds of the PID's gains (Sec. 4.3.3)."""

from __future__ import annotations

from ssmr.control.pid import PidGains
from ssmr.control.stability import CascadeLoop, gain_range
from ssmr.models.coulomb import CoulombParameters
from ssmr.models.friction import arctangent_friction, hyperviscous_friction, implied_steepness
from ssmr.models.linear import LinearParameters, matrices
from ssmr.robot.vehicle import Drive, Vehicle
from validation.replicate.chapters import Findings, Section, Task
from validation.replicate.control import GAIN_NAMES
from validation.thesis import published
from validation.thesis.verdicts import Pair, Rows

_SPEED = 0.5
"""Speed at which turning is looked at [m/s], that of trajectories 2 to 4, and of the faster references."""
_MOST = 100.0
"""Greatest gain that is looked at."""
_ALONG = ("K_P_rho", "K_I_rho", "K_P_u", "K_I_u")
"""Gains of the loop along the path; the others are those across."""


def _laws(task: Task) -> Findings:
    """Find how steep an arctangent the fitted coefficients imply."""
    dry, viscous, drawn = CoulombParameters(), LinearParameters(), published.value("text", "k_s_figure_2_9")
    steepness = {"k_s of K_u and u_x": (viscous.k_u, dry.u_x), "k_s of K_y and mu_c": (viscous.k_y, dry.mu_c)}
    rows = {name: {"value": Pair(drawn, implied_steepness(*numbers), "words", "s/m")} for name, numbers in steepness.items()}
    words = {
        "drawn": drawn,
        "share": arctangent_friction(1.0, 1.0, 0.25, drawn),
        "passes": 1e3 / hyperviscous_friction(1.0, 1.0, 1.0, drawn),
    }
    return Findings({"Fig. 2.9": rows}, words)


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
            beside = {"stable_from": low, "without_dead_time": free[1]}
            rows[row] = {"value": Pair(upper, high, "limit", printed["unit"], beside=beside)}
    return rows


def _stability(task: Task) -> Findings:
    """Find the bounds of Sec. 4.3.3."""
    rows = bounds_rows()
    beyond = [row for row, pairs in rows.items() if (pairs["value"].ours or 0.0) < (pairs["value"].published or 0.0)]
    return Findings({"Sec. 4.3.3": rows}, {"speed": _SPEED, "beyond": ", ".join(beyond), "most": _MOST})


THEORY_SECTIONS = (Section("friction", ("Fig. 2.9",), _laws), Section("stability", ("Sec. 4.3.3",), _stability))
"""The sections that drive nothing."""
