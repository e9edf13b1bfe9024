"""Draw figures of docs/centre_of_mass.md and README.md; with `--tables RECORDING`, measure for docs/identification.md.

Run from the project's root: `python docs/make_identification_figures.py [--tables husky_tile_train.csv]`. The figures need
no recording: they use profile `husky-tile` and the numbers below, whose origin docs/centre_of_mass.md explains.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Rectangle
from numpy.typing import NDArray

from ssmr.metrics.poses import horizon_windows
from ssmr.robot.skid_turn import turn_on_the_spot
from ssmr.types import FloatArray
from validation import load_robot
from validation.logs.recording_csv import read_csv
from validation.plants.profile import PLANTS, load_profile
from validation.show.palette import colour

_ROBOT = load_robot("husky")
WHEELBASE, TRACK = _ROBOT.geometry.wheelbase, _ROBOT.geometry.track

OUTLINE = 0.99, 0.67
"""Length and width of a Husky A200 [m]."""
WHEEL = 0.33, 0.1143
"""Diameter and width of its wheels [m]."""
SPLIT = 500.0
"""End of the part of the recording that the fit used [s]."""
GYRO_LAG = 0.2
"""Delay of the recording's poses and wheel rates behind its gyro [s]."""
AIMS: Mapping[tuple[str, str], tuple[float, float]] = {
    ("wheels", "mujoco"): (31.0, math.degrees(0.036)),
    ("wheels", "kinematic"): (31.0, math.degrees(0.036)),
    **{("wheels", plant): (33.0, math.degrees(0.040)) for plant in ("improved", "coulomb", "linear")},
    ("commands", "mujoco"): (40.0, math.degrees(0.045)),
}
"""Targets of the project for the held-out median error after 6 s, by input and plant [mm], [deg]."""
IMAGES = Path(__file__).parent / "img"


@dataclass(frozen=True)
class Place:
    """A place at which the centre of mass is held, and the result of fitting the other parameters."""

    label: str
    x: float
    y: float
    ratio: float
    """Lateral over longitudinal friction."""
    cost: float | None
    """Cost on the first 500 s, at a step of 5 ms, with version 1.1's profile [m]; none where it was not measured."""
    refitted: bool
    """Whether a search of the other parameters was finished; if not, the cost is an upper bound."""
    marker: str
    colour: str


PLACES = (
    Place("fitted", -0.039531, 0.01885, 1.0, None, True, "o", "#0072b2"),
    Place("fitted in version 1.1", -0.0424, -0.0088, 1.0, 0.0775, True, "D", "#56b4e9"),
    Place("middle", 0.0, 0.0, 1.0, 0.0942, True, "s", "#444444"),
    Place("maker's present", -0.00065, -0.085, 1.0, 0.2573, True, "^", "#d55e00"),
    Place("maker's earlier", -0.087, 0.0, 1.0, 0.3779, True, "v", "#a0529a"),
    Place("middle", 0.0, 0.0, 0.937, 0.0781, False, "s", "#444444"),
    Place("maker's present", -0.00065, -0.085, 0.848, 0.0803, False, "^", "#d55e00"),
)


def measured_multiplier() -> tuple[float, float]:
    """Return the multiplier of the kinematic baseline and its standard error."""
    profile = load_profile("husky-tile")
    found, errors = profile.plants["kinematic"].parameters, _provenance("kinematic")["standard_errors"]
    return (found.y_l - found.y_r) / TRACK, math.hypot(errors["y_l"], errors["y_r"]) / TRACK


def _provenance(plant: str) -> Mapping[str, Any]:
    found: Mapping[str, Any] = load_profile("husky-tile").provenance[plant]
    return found


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _draw_robot(ax: Axes) -> None:
    """Draw body and tyres from above, the front up."""
    length, (diameter, tyre) = OUTLINE[0], WHEEL
    boxes = [(0.0, 0.0, TRACK - tyre + 0.06, length, "#f7f2e4")]
    boxes += [(y, x, tyre, diameter, "0.82") for x, y in zip(strict=True)]
    for y, x, wide, long, fill in boxes:
        corner = y - 0.5 * wide, x - 0.5 * long
        ax.add_patch(FancyBboxPatch(corner, wide, long, "round,pad=0,rounding_size=0.03", facecolor=fill, edgecolor="0.35"))
    ax.plot([0.0, 0.0], [-0.5 * WHEELBASE, 0.5 * WHEELBASE], color="0.6", lw=0.7, ls=":")
    ax.plot([-0.5 * TRACK, 0.5 * TRACK], [0.0, 0.0], color="0.6", lw=0.7, ls=":")
    ax.annotate("", (0.0, 0.46), (0.0, 0.33), arrowprops={"arrowstyle": "-|>", "color": "0.35"})
    ax.text(0.02, 0.40, "front", fontsize=8.5, color="0.35", ha="right", va="center")


def draw_centre() -> None:
    """Draw the robot from above, the claimed places of its centre, and the multiplier and cost of each."""
    mujoco = load_profile("husky-tile").plants["mujoco"].parameters
    figure = _figure(13.0, 4.4)
    top, near, turns, costs = figure.subplots(1, 4, width_ratios=(0.75, 0.95, 1.15, 1.15))
    _draw_robot(top)
    near.axhline(mujoco.com_x, color="#0072b2", lw=1.0, ls="--")
    near.axhline(0.0, color="0.6", lw=0.7, ls=":")
    near.axvline(0.0, color="0.6", lw=0.7, ls=":")
    beside = {
        "fitted": (2, 13),
        "fitted in version 1.1": (0, -14),
        "middle": (22, 8),
        "maker's present": (-2, -14),
        "maker's earlier": (0, -15),
    }
    for place in PLACES:
        if place.ratio == 1.0:
            for ax, size in ((top, 4), (near, 8)):
                ax.plot(place.y, place.x, place.marker, color=place.colour, markersize=size, markeredgecolor="white")
            near.annotate(place.label, (place.y, place.x), beside[place.label], textcoords="offset points", fontsize=8.5,
                          color=place.colour, ha="center", va="center")  # fmt: skip
    top.add_patch(Rectangle((-0.12, -0.12), 0.16, 0.16, fill=False, edgecolor="0.2", linewidth=0.9))
    top.set(
        xlim=(0.39, -0.39),
        ylim=(-0.53, 0.53),
        aspect="equal",
        xlabel="left of the middle [m]",
        ylabel="ahead of the middle [m]",
    )
    near.set(xlim=(0.05, -0.12), ylim=(-0.13, 0.04), aspect="equal", xlabel="left of the middle [m]")
    near.set_xticks([0.0, -0.05, -0.1])
    near.set_yticks([0.0, -0.05, -0.1])
    top.set_title("The robot from above", fontsize=10, pad=18)
    near.set_title("Centre of mass, with equal friction\nalong and across the wheels", fontsize=10, pad=18)
    rows = np.arange(len(PLACES))[::-1]
    measured, error = measured_multiplier()
    turns.axvspan(measured - 1.96 * error, measured + 1.96 * error, color="0.8", lw=0.0)
    turns.annotate(
        f"recording: {measured:.2f}",
        (measured, len(PLACES) - 0.52),
        ha="center",
        va="bottom",
        fontsize=8.5,
        color="0.3",
        annotation_clip=False,
    )
    for row, place in zip(rows, PLACES, strict=True):
        expected = turn_on_the_spot(WHEELBASE, TRACK, place.x, place.y, place.ratio).multiplier
        found = [(turns, expected, f"{expected:.2f}")]
        if place.cost is not None:
            found.append((costs, place.cost, f"{'' if place.refitted else '≤ '}{place.cost:.4f}"))
        for ax, value, text in found:
            ax.plot(value, row, place.marker, color=place.colour, markersize=8, zorder=3, markeredgecolor=place.colour,
                    markerfacecolor=place.colour if place.refitted else "white")  # fmt: skip
            ax.annotate(text, (value, row), (9, 0), textcoords="offset points", ha="left", va="center", fontsize=8.5)
    names = [
        f"{p.label}\n({1e3 * p.x:.0f}, {1e3 * p.y:.0f}) mm, friction ratio {p.ratio:.3g}".replace("-", "−") for p in PLACES
    ]
    turns.set_yticks(rows, names, fontsize=8.5)
    costs.set_yticks(rows, [])
    turns.set(xlim=(0.9, 2.5), xlabel="wheels' over robot's yaw rate [1]")
    costs.set(xlim=(0.0, 0.48), xlabel="cost on the first 500 s [m]")
    turns.set_title("Multiplier with this centre\n", fontsize=10, pad=18)
    costs.set_title("Cost of the fit with this centre,\nin version 1.1", fontsize=10, pad=18)
    for ax in (turns, costs):
        ax.set_ylim(-0.6, len(PLACES) - 0.5)
        ax.axhline(1.5, color="0.6", lw=0.8, ls="--")
        ax.grid(axis="y", color="0.92")
        ax.tick_params(axis="y", length=0)
        ax.spines["left"].set_visible(False)
    for ax in (top, near, turns, costs):
        ax.spines[["top", "right"]].set_visible(False)
        ax.set_axisbelow(True)
    figure.savefig(IMAGES / "centre_of_mass.png")


def draw_tile() -> None:
    """Draw the median errors after 6 s of every plant on the recording: on the data of the fit and on held-out data."""
    figure = _figure(9.0, 4.4)
    panels = figure.subplots(2, 2, sharey=True, sharex="col")
    rows = {plant: len(PLANTS) - 1 - i for i, plant in enumerate(PLANTS)}
    for given, line in zip(("wheels", "commands"), panels, strict=True):
        for k, (ax, what, unit) in enumerate(
            zip(line, ("position_{}_6s_m", "yaw_{}_6s_rad"), (1e3, math.degrees(1.0)), strict=True)
        ):
            for plant, row in rows.items():
                ink = tuple(c / 255.0 for c in colour(plant))
                train, held = (
                    next(v for label, v in _provenance(plant)[part].items() if given in label)
                    for part in ("train", "held_out")
                )
                low, middle, high = (unit * held[what.format(word)] for word in ("low", "median", "high"))
                ax.errorbar(
                    middle, row, xerr=[[middle - low], [high - middle]], fmt="o", color=ink, markersize=7, capsize=3, lw=1.5
                )
                ax.plot(
                    unit * train[what.format("median")], row, "o", markerfacecolor="white", markeredgecolor=ink, markersize=6
                )
                if (given, plant) in AIMS:
                    ax.plot([AIMS[given, plant][k]] * 2, [row - 0.32, row + 0.32], color="0.25", lw=1.4, zorder=1)
            ax.set_ylim(-0.6, len(PLANTS) - 0.4)
            ax.set_xlim(0.0, (60.0, 4.2)[k])
            ax.grid(axis="x", color="0.93")
            ax.spines[["top", "right", "left"]].set_visible(False)
            ax.tick_params(axis="y", length=0)
            ax.set_axisbelow(True)
            ax.set_title(
                ("Position", "Heading")[k] + f", from {'measured wheel rates' if given == 'wheels' else 'commands'}",
                fontsize=10,
                loc="left",
            )
        line[0].set_yticks(list(rows.values()), list(rows))
    for ax, name in zip(
        panels[1], ("median position error after 6 s [mm]", "median heading error after 6 s [deg]"), strict=True
    ):
        ax.set_xlabel(name)
    ax = panels[0, 0]
    marks = [
        *ax.plot([], [], "o", color="0.3", label="held out: the last 150 s (bar: 90 % interval)"),
        *ax.plot([], [], "o", markerfacecolor="white", markeredgecolor="0.3", label="data of the fit: the first 500 s"),
        *ax.plot([], [], "|", color="0.25", markersize=11, markeredgewidth=1.4, label="target for held out"),
    ]
    figure.legend(handles=marks, loc="outside lower center", ncols=3, frameon=False, fontsize=8.5)
    figure.savefig(IMAGES / "tile.png")


# --- numbers from the recording ---


def _overlapping(
    t: FloatArray, fresh: NDArray[np.bool_] | None, horizon: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the windows that begin every second."""
    found: set[tuple[int, int]] = set()
    for offset in np.arange(0.0, horizon, 1.0):
        first = int(np.searchsorted(t, t[0] + offset - 1e-9))
        if first >= len(t) - 1:
            break
        starts, ends = horizon_windows(t[first:], horizon, None if fresh is None else fresh[first:])
        found |= {(first + int(a), first + int(b)) for a, b in zip(starts, ends, strict=True)}
    pairs = np.array(sorted(found), dtype=np.intp).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def _least_sizes(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the residuals of a regression that minimises the sum of their absolute values."""
    weight = np.ones(len(b))
    for _ in range(50):
        x = np.linalg.lstsq(a * weight[:, None], b * weight, rcond=None)[0]
        weight = 1.0 / np.sqrt(np.maximum(np.abs(b - a @ x), 1e-3))
    return b - a @ x


def table_floor(path: str) -> None:
    """Print how much of the heading after 6 s the gyro explains, and how much a constant map of wheel rotation can."""
    recording = read_csv(path)
    rows = []
    for piece in recording.segments():
        t, wheels = piece.t, piece.inputs("wheels")
        gyro = recording.columns["gyro_z"][piece.start : piece.stop]
        turned = np.concatenate([[0.0], np.cumsum(0.5 * (gyro[1:] + gyro[:-1]) * np.diff(t))])
        rolled = np.concatenate([np.zeros((1, 2)), np.cumsum(wheels[: len(t) - 1] * np.diff(t)[:, None], axis=0)])
        for i, j in zip(*_overlapping(t, piece.fresh, 6.0), strict=True):
            if t[i] - GYRO_LAG >= t[0]:
                by_gyro = np.interp(t[j] - GYRO_LAG, t, turned) - np.interp(t[i] - GYRO_LAG, t, turned)
                difference = wheels[[j - 1, i], 1] - wheels[[j - 1, i], 0]
                rows.append(
                    [
                        t[i],
                        piece.pose[j, 2] - piece.pose[i, 2],
                        by_gyro,
                        t[j] - t[i],
                        *(rolled[j] - rolled[i]),
                        difference[0] - difference[1],
                    ]
                )
    data = np.array(rows)
    print("yaw of the localiser after 6 s: windows; median and rms left by the gyro; by the wheels' rotation [rad]")
    for part, which in (("train", data[:, 0] < SPLIT - 6.0), ("held out", data[:, 0] >= SPLIT)):
        left = [_least_sizes(data[which][:, columns], data[which, 1]) for columns in ([2, 3], [4, 5, 6])]
        print(part, which.sum(), *(f"{np.median(np.abs(e)):.4f} {math.sqrt(float(np.mean(e**2))):.4f}" for e in left))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--tables"]:
        table_floor(sys.argv[2])
    draw_centre()
    draw_tile()
