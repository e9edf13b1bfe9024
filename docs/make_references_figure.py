"""Draw the named references of docs/tracking.md that are this project's own.

Run from the project's root: `python docs/make_references_figure.py`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from validation.experiment.waypoint_files import REFERENCES

OUT = Path(__file__).parent / "img" / "references.png"
NAMES = [
    name for name in REFERENCES if name not in ("line", "circle", "sine", "generic", "long-line")
]
"""References with a panel; a line of 200 m has nothing to see."""
SPEED = 0.5
"""[m/s]"""


def draw() -> None:
    """Draw the path of each reference above its yaw rate, or speed if it is straight."""
    figure = Figure(figsize=(16.0, 4.6), dpi=100, layout="constrained")
    rows = figure.subplots(2, len(NAMES), height_ratios=(3.0, 2.0))
    for name, path, time in zip(NAMES, *rows, strict=True):
        waypoints = REFERENCES[name](SPEED)
        x, y = waypoints.xy.T
        path.plot(x, y, color="#1f5fa8", linewidth=1.8)
        path.plot(x[0], y[0], "o", markersize=8, color="0.1", fillstyle="none")
        path.plot(x[-1], y[-1], "s", markersize=5, color="0.1")
        path.set_aspect("equal", adjustable="datalim")
        path.set_title(f"{name}, {waypoints.length:.1f} m")
        path.set_xlabel("x [m]")
        motion = waypoints.trajectory(0.02)
        straight = not np.any(motion.twist[:, 2])
        time.plot(
            motion.t[:-1], motion.twist[:-1, 0 if straight else 2], color="#1f5fa8", linewidth=1.3
        )
        time.set_title(
            f"{'speed [m/s]' if straight else 'yaw rate [rad/s]'} at {SPEED:g} m/s", fontsize=9
        )
        time.set_xlabel("time [s]")
    rows[0, 0].set_ylabel("y [m]")
    for ax in rows.flat:
        ax.grid(color="0.92")
        ax.set_axisbelow(True)
    figure.savefig(OUT)


if __name__ == "__main__":
    draw()
