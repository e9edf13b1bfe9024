"""Tables of the study of runs, and what a robot's other logs are worth.

A log's second half judges fits of one plant that have not seen it: one to its first half, one to
the robot's other logs, this one again with numbers that follow the half as it is driven and predict
from its past alone, and one to the first half that has the others' numbers and spread as its prior.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from scipy import stats

from validation.identify.uncertainty import FEWEST_DAYS
from validation.report import drawing
from validation.report.columns import DEGREES, METRES, Unit
from validation.report.table import Row, Table

INTERVAL = ("position_median_m", "position_low_m", "position_high_m")
"""Columns of a row with a median and its interval."""
OWN = "its first half"
OTHERS = "the other logs"
ON = "the other logs, and on while it drives"
BOTH = "its first half, begun with the others"
_TOLD = 6.0
"""Horizon of the sentence and of the picture [s]."""
_LEVEL = 0.9
"""Confidence of the interval of a ratio [1]."""
_INKS = {
    OWN: drawing.BESIDE_INK,
    OTHERS: "#e6ab02",
    ON: "#1b9e77",
    BOTH: drawing.ink_of("kinematic"),
}


def errors_table(title: str, rows: Sequence[Row], names: Sequence[str] = ("plant",)) -> Table:
    """Return the errors on second halves by horizon; `names` are columns that say whose."""
    shown = []
    for row in sorted(rows, key=lambda row: row["horizon_s"]):
        judge = "yaw_gyro" if row["heading_judge"] == "gyro" else "yaw"
        shown.append(
            {
                "horizon_s": row["horizon_s"],
                **{name: row[name] for name in names},
                "position_median_m": tuple(row[key] for key in INTERVAL),
                "yaw_median_rad": row["yaw_median_rad"],
                "yaw_gyro_median_rad": row.get("yaw_gyro_median_rad"),
                "position_inside_share": row.get("coverage_90_position"),
                "yaw_inside_share": row.get(f"coverage_90_{judge}"),
                "windows": row["n"],
            }
        )
    units = {
        "horizon_s": Unit("s", 1.0, 0, significant=3),
        "position_median_m": METRES,
        "yaw_median_rad": DEGREES,
        "yaw_gyro_median_rad": DEGREES,
    }
    judges = " or ".join(dict.fromkeys(row["heading_judge"] for row in rows))
    caption = (
        "in brackets: an interval that holds the median with 90 %\n"
        "inside: share of windows within the band, which promises 90 %; "
        f"the {judges} is the judge of heading"
    )
    return Table(title, shown, caption, group="horizon_s", units=units)


def worth(rows: Sequence[Row], fitted_to: str) -> str:
    """Return a sentence with the ratio of a fit's errors to those of the logs' own fits."""
    errors: dict[str, dict[str, float]] = {OWN: {}, fitted_to: {}}
    for row in rows:
        if row["horizon_s"] == _TOLD and row["fitted_to"] in errors:
            errors[row["fitted_to"]][row["log"]] = row["position_median_m"]
    own = errors[OWN]
    ratios = [math.log(error / own[log]) for log, error in errors[fitted_to].items()]
    better = sum(ratio < 0.0 for ratio in ratios)
    mean = float(np.mean(ratios))
    words = (
        f"Fitted to {fitted_to}, kinematic has {math.exp(mean):.2f} of the position error after "
        f"{_TOLD:g} s that its own first half gives it"
    )
    if len(ratios) >= FEWEST_DAYS:
        # logs are few, so the mean's interval is Student's
        reach = stats.t.ppf(0.5 + 0.5 * _LEVEL, len(ratios) - 1) * stats.sem(ratios)
        words += f" ({math.exp(mean - reach):.2f}–{math.exp(mean + reach):.2f} with 90 %)"
    return f"{words}: geometric mean of {len(ratios)} logs, of which {better} are better."


def robots_panel(rows: Sequence[Row]) -> Callable[[Axes], None]:
    """Return a function that draws each log's error after each of the fits."""
    told = [row for row in rows if row["horizon_s"] == _TOLD]
    logs = list(dict.fromkeys(row["log"] for row in told))

    def draw(ax: Axes) -> None:
        for k, (fitted_to, ink) in enumerate(_INKS.items()):
            of_fit = [row for row in told if row["fitted_to"] == fitted_to]
            places = np.array([logs.index(row["log"]) for row in of_fit]) + 0.17 * (k - 1.5)
            median, low, high = (np.array([row[key] for row in of_fit]) for key in INTERVAL)
            reach = [median - low, high - median]
            ax.errorbar(places, median, reach, fmt="o", color=ink, label=f"fitted to {fitted_to}")
        ax.set(
            yscale="log",
            ylabel=f"position error after {_TOLD:g} s [m]",
            title="What a robot's other logs are worth (bars: 90 % interval of the median)",
        )
        ax.set_xticks(range(len(logs)), logs, rotation=15.0, ha="right")
        drawing.plain_ticks(ax.yaxis, (1.0, 3.0))
        ax.legend(frameon=False, fontsize=8.0)

    return draw
