"""Draw the figure of docs/lab.md and print the multipliers of its table.

Both follow from the closed form alone. Run from the project's root: `python
docs/make_centre_of_mass_figure.py`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ssmr.robot.ground import turn_on_the_spot
from validation import load_profile, load_robot

OUT = Path(__file__).parent / "img" / "centre_of_mass.png"
HUSKY = load_robot("husky")
BODY = load_profile("husky-tile").plants["mujoco"].parameters
PLACES = {
    "fitted": (BODY.com_x, BODY.com_y, "#0072b2", "o"),
    "middle": (0.0, 0.0, "#444444", "s"),
    "maker, now": (-0.00065, -0.085, "#d55e00", "^"),
    "maker, earlier": (-0.087, 0.0, "#9f4ea0", "v"),
}
"""Centre of mass ahead of the middle and to its left [m], colour and marker."""
RECORDED = 1.721
ERROR = 0.005
"""Multiplier of the kinematic fit to the recording, and its standard error [1]."""


def multiplier(x: float, y: float, ratio: float = 1.0) -> float:
    """Return the wheels' yaw rate over the robot's, turning on the spot."""
    return turn_on_the_spot(HUSKY.wheelbase, HUSKY.track, x, y, ratio).multiplier


def draw() -> None:
    """Draw where the places lie, and what multiplier a centre on the robot's long axis gives."""
    figure = Figure(figsize=(11.0, 4.2), dpi=130, layout="constrained")
    above, law = figure.subplots(1, 2, width_ratios=(0.6, 1.0))
    for side in (-0.5, 0.5):
        for end in (-0.5, 0.5):
            above.plot(side * HUSKY.track, end * HUSKY.wheelbase, "s", color="0.8", markersize=22)
    for name, (x, y, colour, marker) in PLACES.items():
        above.plot(y, x, marker, color=colour, markersize=7, label=name)
        law.plot(
            x,
            multiplier(x, y),
            marker,
            color=colour,
            markersize=7,
            label=f"{name}: {multiplier(x, y):.2f}",
        )
    above.axhline(BODY.com_x, color=PLACES["fitted"][2], ls="--", lw=1.0)
    above.set(
        xlabel="left of the middle [m]",
        ylabel="ahead of the middle [m]",
        title="Centre of mass",
        aspect="equal",
    )
    above.legend(fontsize=8, frameon=False, loc="upper center", bbox_to_anchor=(0.5, 0.98), ncols=2)
    above.set(xlim=(0.38, -0.38), ylim=(-0.42, 0.5))
    along = np.linspace(-0.1, 0.1, 81)
    for ratio, style in ((1.0, "-"), (0.947, "--")):
        measured = [multiplier(float(x), 0.0, ratio) for x in along]
        law.plot(
            along,
            measured,
            style,
            color="0.3",
            lw=1.2,
            label=f"on the long axis, friction across/along {ratio:g}",
        )
    law.axhspan(
        RECORDED - 2.0 * ERROR,
        RECORDED + 2.0 * ERROR,
        color="0.85",
        label=f"recording: {RECORDED}, 95 %",
    )
    law.set(
        xlabel="centre of mass ahead of the middle [m]",
        ylabel="wheels' yaw rate over the robot's",
        title="What a turn tells",
    )
    law.legend(fontsize=8, frameon=False, loc="upper left", ncols=2)
    law.set_ylim(0.9, 2.8)
    for axes in (above, law):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(OUT)


if __name__ == "__main__":
    for label, (x, y, *_) in PLACES.items():
        turn = turn_on_the_spot(HUSKY.wheelbase, HUSKY.track, x, y)
        print(f"{label}: ({1e3 * x:.0f}, {1e3 * y:.0f}) mm, multiplier {turn.multiplier:.3f}")
    draw()
