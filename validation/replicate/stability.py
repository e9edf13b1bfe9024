"""The section on the bounds of the PID's gains from the stability of the linear model (Sec. 4.3.3)."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ssmr.control.pid import PidGains
from ssmr.control.stability import CascadeLoop, gain_range
from ssmr.models.linear import LinearParameters, matrices
from ssmr.robot.vehicle import Drive, Vehicle
from validation.replicate.control import GAIN_NAMES
from validation.replicate.evidence import Context, Findings, Section, Table
from validation.report.drawing import ALARM, QUIET, draw_footer, ink_of, put_together, side_by_side, text_row
from validation.thesis import published
from validation.thesis.verdicts import Pair

_SPEED = 0.5
"""Speed of the target [m/s], the faster of the thesis' two."""
_MOST = 100.0
"""Greatest gain that is looked at."""
_ALONG = ("K_P_rho", "K_I_rho", "K_P_u", "K_I_u")
"""Gains of the loop along the path; the others are those across."""
_MOST_GROWTH = 2.0
"""Greatest rate that is drawn [1/s]."""
_ABREAST = 5
"""Number of panels beside one another."""


class _Searched(NamedTuple):
    """A gain of Tab. 4.4 that was searched."""

    row: str
    """Name of the row."""
    name: str
    """Name of our gain."""
    printed: tuple[float, float]
    """Range of the search."""
    optimum: float
    """Result of the search."""


def _searched_gains() -> list[_Searched]:
    rows = published.table("4.4")["rows"]
    return [
        _Searched(row, GAIN_NAMES["pid"][row], content["search"], content["optimised"])
        for row, content in rows.items()
        if "search" in content
    ]


def _loop(row: str, dead_time: float | None = None) -> CascadeLoop:
    """Return the loop that a gain belongs to, around the linear model with the published parameters."""
    drive = Drive()
    a, b = matrices(Vehicle(), LinearParameters(), drive)
    delay = drive.delay_v if dead_time is None else dead_time
    if row in _ALONG:
        return CascadeLoop("along", -a[1, 1], b[1, 0], _SPEED, dead_time=delay)
    return CascadeLoop("across", -a[3, 3], b[3, 1], _SPEED, dead_time=delay)


def bounds_table() -> Table:
    """Return the greatest gains that the linear model is stable with, beside the bounds of the thesis' search."""
    rows = {}
    for gain in _searched_gains():
        low, high = gain_range(_loop(gain.row), PidGains(), gain.name, _MOST) or (0.0, 0.0)
        free = gain_range(_loop(gain.row, 0.0), PidGains(), gain.name, _MOST) or (0.0, 0.0)
        upper = gain.printed[1]
        beside = {"at_least": upper, "stable_from": low, "without_dead_time": free[1]}
        unit = published.table("4.4")["rows"][gain.row]["unit"]
        rows[gain.row] = {"value": Pair(upper, high, "at_least", unit, beside=beside)}
    return Table("Greatest stable value of each gain of the PID while the others are the published ones", rows)


def _draw_gain(gain: _Searched, ax: Axes) -> None:
    """Draw the growth rate of the slowest error over a gain, from zero to twice the printed bound."""
    upper = gain.printed[1]
    values = np.linspace(0.0, 2.0 * upper, 41)
    for dead_time, ink in ((0.0, "0.72"), (None, ink_of("linear"))):
        loop = _loop(gain.row, dead_time)
        growth = [loop.growth(replace(PidGains(), **{gain.name: float(k)})) for k in values]
        ax.plot(values, growth, color=ink, linewidth=1.6, gid="growth" if dead_time is None else "without dead time")
    ax.axvspan(*gain.printed, color="0.5", alpha=0.13, linewidth=0.0)
    ax.axhline(0.0, color=QUIET, linewidth=0.9)
    ax.plot(gain.optimum, _loop(gain.row).growth(PidGains()), "o", color="black", markersize=5.0, zorder=4.0, gid="optimum")
    low, high = ax.get_ylim()
    low, high = max(low, -_MOST_GROWTH), min(max(high, 0.1), _MOST_GROWTH)
    ax.axhspan(0.0, high, color=ALARM, alpha=0.07, linewidth=0.0)
    ax.set(title=gain.row, xlim=(0.0, 2.0 * upper), ylim=(low, high))


def draw_bounds() -> Figure:
    """Draw how fast errors grow over each gain, with the range that the thesis searched."""
    gains = _searched_gains()
    rows = [
        side_by_side(2.4, [partial(_draw_gain, gain) for gain in gains[k : k + _ABREAST]])
        for k in range(0, len(gains), _ABREAST)
    ]
    foot = (
        f"growth rate of the slowest error [1/s] at {_SPEED:g} m/s, the other gains as published · green: with the dead "
        "time, grey: without · grey area: searched · point: the thesis' result · above zero the loop is unstable"
    )
    return put_together([*rows, text_row(0.3, partial(draw_footer, foot))])


def _stability(context: Context) -> Findings:
    """Find the bounds of Sec. 4.3.3."""
    table = bounds_table()
    beyond = [row for row, pairs in table.rows.items() if (pairs["value"].ours or 0.0) < (pairs["value"].published or 0.0)]
    notes = (
        "The thesis bounds the search of each gain with the linear model, to leave out what is unstable (Sec. 4.3.3), and "
        "prints the bounds in Tab. 4.4. Here the linear model and the PID's cascade, sampled at 8 and 50 ms, become a "
        f"matrix about straight driving at {_SPEED:g} m/s, with the dead time of Tab. 3.8; its eigenvalues tell. A printed "
        "bound agrees if ours is at least as great: then the search held no unstable value of that gain.",
        f"The searched ranges of {', '.join(beyond)} reach into instability, while the other gains are the published ones. "
        "Without dead time the position loop would have much wider bounds, but the velocity loop would not: its period of "
        "50 ms is longer than the model's time constants of 26 ms (speed) and 10 ms (yaw rate).",
        f"{_MOST:g} stands for no bound. A lower end above zero means that errors grow slowly below it, because integrals "
        "of other gains are then too strong.",
    )
    caption = (
        "Growth rate of the slowest error over each gain of the PID, the linear model with the published parameters. The "
        "grey areas are the ranges that the thesis searched."
    )
    return Findings({"Sec. 4.3.3": table}, notes=notes, pictures=(context.picture("bounds", draw_bounds(), caption),))


STABILITY_SECTIONS = (Section("stability", "Bounds of the PID's gains", ("Sec. 4.3.3",), (), _stability),)
"""The section on the bounds of the search for gains."""
