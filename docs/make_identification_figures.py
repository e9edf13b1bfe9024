"""Draw the figure of docs/tile.md; with `--tables RECORDING`, measure what the gyro explains.

Run from the project's root: `python docs/make_identification_figures.py [--tables
husky_tile_train.csv]`. The figure needs no recording: it shows what profile `husky-tile` says of
itself.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ssmr.geometry import integrate_rates
from ssmr.metrics.windows import horizon_windows
from ssmr.types import FloatArray, IndexArray
from validation.files.columns import COMMAND_COLUMNS, POSE_COLUMNS
from validation.files.csv_logs import read_csv
from validation.files.signals import fresh_poses
from validation.plants.profile import PLANTS, load_profile
from validation.report.palette import plant_colour, spell_name

SPLIT = 500.0
"""End of the part of the recording that the fit used [s]."""
GYRO_LAG = 0.2
"""Delay of the recording's poses and wheel rates behind its gyro [s]."""
OUT = Path(__file__).parent / "img" / "tile.png"


def _provenance(plant: str) -> Mapping[str, Any]:
    measured: Mapping[str, Any] = load_profile("husky-tile").provenance[plant]
    return measured


def draw_tile() -> None:
    """Draw the median errors after 6 s of every plant, on data of the fit and on held-out data."""
    figure = Figure(figsize=(9.0, 4.4), dpi=130, layout="constrained")
    panels = figure.subplots(2, 2, sharey=True, sharex="col")
    rows = {plant: len(PLANTS) - 1 - i for i, plant in enumerate(PLANTS)}
    for given, line in zip(("wheels", "commands"), panels, strict=True):
        for k, (ax, what, unit) in enumerate(
            zip(line, ("position_{}_6s_m", "yaw_{}_6s_rad"), (1e3, math.degrees(1.0)), strict=True)
        ):
            for plant, row in rows.items():
                ink = tuple(c / 255.0 for c in plant_colour(plant))
                train, held = (
                    next(v for label, v in _provenance(plant)[part].items() if given in label)
                    for part in ("train", "held_out")
                )
                low, middle, high = (
                    unit * held[what.format(word)] for word in ("low", "median", "high")
                )
                ax.errorbar(
                    middle,
                    row,
                    xerr=[[middle - low], [high - middle]],
                    fmt="o",
                    color=ink,
                    markersize=7,
                    capsize=3,
                    lw=1.5,
                )
                ax.plot(
                    unit * train[what.format("median")],
                    row,
                    "o",
                    markerfacecolor="white",
                    markeredgecolor=ink,
                    markersize=6,
                )
            ax.set_ylim(-0.6, len(PLANTS) - 0.4)
            ax.set_xlim(0.0, (60.0, 4.2)[k])
            ax.grid(axis="x", color="0.93")
            ax.spines[["top", "right", "left"]].set_visible(False)
            ax.tick_params(axis="y", length=0)
            ax.set_axisbelow(True)
            ax.set_title(
                ("Position", "Heading")[k]
                + f", from {'measured wheel rates' if given == 'wheels' else 'commands'}",
                fontsize=10,
                loc="left",
            )
        line[0].set_yticks(list(rows.values()), [spell_name(plant) for plant in rows])
    for ax, name in zip(
        panels[1],
        ("median position error after 6 s [mm]", "median heading error after 6 s [deg]"),
        strict=True,
    ):
        ax.set_xlabel(name)
    ax = panels[0, 0]
    marks = [
        *ax.plot([], [], "o", color="0.3", label="held out: the last 150 s (bar: 90 % interval)"),
        *ax.plot(
            [],
            [],
            "o",
            markerfacecolor="white",
            markeredgecolor="0.3",
            label="data of the fit: the first 500 s",
        ),
    ]
    figure.legend(handles=marks, loc="outside lower center", ncols=2, frameon=False, fontsize=8.5)
    figure.savefig(OUT)


# --- numbers from the recording ---


def _overlapping(
    t: FloatArray, fresh: NDArray[np.bool_] | None, horizon: float
) -> tuple[IndexArray, IndexArray]:
    """Return the windows that begin every second."""
    entries: set[tuple[int, int]] = set()
    for offset in np.arange(0.0, horizon, 1.0):
        first = int(np.searchsorted(t, t[0] + offset - 1e-9))
        if first >= len(t) - 1:
            break
        starts, ends = horizon_windows(t[first:], horizon, None if fresh is None else fresh[first:])
        entries |= {(first + int(a), first + int(b)) for a, b in zip(starts, ends, strict=True)}
    pairs = np.array(sorted(entries), dtype=np.intp).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def _least_sizes(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the residuals of a regression that minimises the sum of their absolute values."""
    weight = np.ones(len(b))
    for _ in range(50):
        x = np.linalg.lstsq(a * weight[:, None], b * weight, rcond=None)[0]
        weight = 1.0 / np.sqrt(np.maximum(np.abs(b - a @ x), 1e-3))
    return b - a @ x


def table_floor(path: str) -> None:
    """Print how much of the heading after 6 s gyro and wheel rotation explain."""
    log = read_csv(path)
    rows = []
    for stretch in log.stretches():
        t = log.t[stretch]
        wheels = log.table(COMMAND_COLUMNS["wheels"])[stretch]
        gyro = log.columns["gyro_z"][stretch]
        pose = log.table(POSE_COLUMNS)[stretch]
        turned = integrate_rates(t, gyro)
        rolled = np.cumulative_sum(
            wheels[: len(t) - 1] * np.diff(t)[:, None], axis=0, include_initial=True
        )
        for i, j in zip(*_overlapping(t, fresh_poses(t, pose), 6.0), strict=True):
            if t[i] - GYRO_LAG >= t[0]:
                by_gyro = np.interp(t[j] - GYRO_LAG, t, turned) - np.interp(
                    t[i] - GYRO_LAG, t, turned
                )
                difference = wheels[[j - 1, i], 1] - wheels[[j - 1, i], 0]
                rows.append(
                    [
                        t[i],
                        pose[j, 2] - pose[i, 2],
                        by_gyro,
                        t[j] - t[i],
                        *(rolled[j] - rolled[i]),
                        difference[0] - difference[1],
                    ]
                )
    data = np.array(rows)
    print(
        "yaw of the localiser after 6 s: windows; median and rms left by the gyro; "
        "by the wheels' rotation [rad]"
    )
    for part, which in (("train", data[:, 0] < SPLIT - 6.0), ("held out", data[:, 0] >= SPLIT)):
        left = [
            _least_sizes(data[which][:, columns], data[which, 1]) for columns in ([2, 3], [4, 5, 6])
        ]
        print(
            part,
            which.sum(),
            *(f"{np.median(np.abs(e)):.4f} {math.sqrt(float(np.mean(e**2))):.4f}" for e in left),
        )


if __name__ == "__main__":
    if sys.argv[1:2] == ["--tables"]:
        table_floor(sys.argv[2])
    draw_tile()
