"""The picture of errors over short windows, by speed and yaw rate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ssmr.types import FloatArray
from validation.show.drawing import Panel, Row, draw_footer, draw_section, ink_of, put_together, side_by_side, text_row

_DARK = 0.6
"""Share of the greatest error from which on numbers are written in white."""


@dataclass(frozen=True, eq=False)
class BinnedErrors:
    """Median errors of plants by speed and yaw rate."""

    speeds: tuple[float, ...]
    """(R + 1,) edges [m/s]."""
    yaw_rates: tuple[float, ...]
    """(C + 1,) edges [rad/s]."""
    count: NDArray[np.int64]
    """(R, C) number of windows in each bin."""
    medians: Mapping[str, FloatArray]
    """(2, R, C) median sizes of position [m] and yaw errors [rad] by plant; NaN where there are few windows."""
    window: float
    """Length of a window [s]."""


_MEASURES = ((0, "Position", "mm", 1e3, 0), (1, "Yaw", "mrad", 1e3, 0))


def _draw_map(
    residuals: BinnedErrors, values: FloatArray, most: float, title: str, ink: object, first: bool, ax: Axes
) -> None:
    ax.imshow(values, origin="lower", cmap="YlOrBr", vmin=0.0, vmax=most, aspect="auto")
    for (i, j), value in np.ndenumerate(values):
        if not np.isnan(value):
            ax.text(
                j,
                i,
                f"{value:.0f}",
                ha="center",
                va="center",
                fontsize=9.0,
                color="white" if value > _DARK * most else "0.15",
            )
    _name_bins(residuals, ax, first)
    ax.set_title(title, color=ink)


def _draw_count(residuals: BinnedErrors, ax: Axes) -> None:
    ax.imshow(np.zeros(residuals.count.shape), origin="lower", cmap="Greys", vmin=0.0, vmax=1.0, aspect="auto")
    for (i, j), n in np.ndenumerate(residuals.count):
        ax.text(j, i, str(n), ha="center", va="center", fontsize=9.0, color="0.45")
    _name_bins(residuals, ax, True)
    ax.set_title("windows")


def _name_bins(residuals: BinnedErrors, ax: Axes, first: bool) -> None:
    rates, speeds = residuals.yaw_rates, residuals.speeds
    ax.set_xticks(np.arange(len(rates)) - 0.5, [f"{r:g}" for r in rates], fontsize=8.0)
    ax.set_yticks(np.arange(len(speeds)) - 0.5, [f"{s:g}" for s in speeds] if first else [""] * len(speeds), fontsize=8.0)
    ax.grid(visible=False)
    ax.set_xlabel("yaw rate [rad/s]")
    if first:
        ax.set_ylabel("speed [m/s]")


def draw_residuals(residuals: BinnedErrors, how: str) -> Figure:
    """Draw position errors above and yaw errors below: the number of windows, then a map for each plant."""
    rows: list[Row] = []
    for k, what, unit, scale, _ in _MEASURES:
        maps = {name: scale * m[k] for name, m in residuals.medians.items()}
        known = [v for m in maps.values() for v in m[~np.isnan(m)]]
        most = float(max(known, default=1.0))
        panels: list[Panel] = [partial(_draw_count, residuals)]
        panels += [partial(_draw_map, residuals, values, most, name, ink_of(name), False) for name, values in maps.items()]
        heading = f"{what}, median error after {residuals.window:g} s [{unit}], {how}"
        rows += [text_row(0.3, partial(draw_section, heading)), side_by_side(3.0, panels)]
    foot = "bins with few windows are left empty · the darker, the greater the error; one scale for each row"
    return put_together([*rows, text_row(0.3, lambda ax: draw_footer(foot, ax))])
