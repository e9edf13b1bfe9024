"""Write the tables of docs/runs.md from one run of the study of runs.

Run from the project's root: `python docs/make_runs_tables.py runs/study/runs/study.json`. The page
says how to make that file, and its picture is the study's.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

PAGE = Path(__file__).with_name("runs.md")
LABELS = {
    "husky_tile": "Husky, tile",
    "husky_wet_grass": "Husky, wet grass",
    "husky_unnamed": "Husky, unnamed ground",
    "warthog_grass": "Warthog, grass",
    "warthog_grass_2": "Warthog, grass 2",
    "warthog_asphalt": "Warthog, asphalt",
    "warthog_asphalt_slow": "Warthog, slow asphalt",
    "warthog_gravel_fast": "Warthog, fast gravel",
    "warthog_ice": "Warthog, ice",
}
"""Names of logs on the page, in its order."""
FITS = {
    "its first half": "its first half",
    "the other logs": "the others",
    "the other logs, and on while it drives": "the others, and on",
    "its first half, begun with the others": "both",
}
"""Fits of the kinematic plant, and their headings."""
PLANTS = ("kinematic", "four_wheel", "mujoco")


def shown(value: float | None, digits: int = 3) -> str:
    """Return a number with so many digits behind the point, and a dash for none."""
    if value is None:
        return "–"
    return f"{value:.2f}" if abs(value) >= 3.0 else f"{value:.{digits}f}"


def share(value: float | None) -> str:
    """Return a share in per cent."""
    return "–" if value is None else f"{100.0 * value:.0f}"


def interval(row: dict[str, Any]) -> str:
    """Return a median of the position with its interval."""
    median, low, high = (shown(row[f"position_{key}_m"]) for key in ("median", "low", "high"))
    return f"{median} ({low}–{high})"


def table(headings: Sequence[str], rows: Iterator[Sequence[str]], words: int) -> str:
    """Return a table of Markdown, whose first `words` columns hold words."""
    lines = [headings, ["---"] * words + ["---:"] * (len(headings) - words), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def chosen(rows: Sequence[dict[str, Any]], **wanted: object) -> dict[str, Any]:
    """Return the row with these values; an empty one where there is none."""
    for row in rows:
        if all(row[key] == value for key, value in wanted.items()):
            return row
    return {}


def errors(study: dict[str, Any]) -> Iterator[Sequence[str]]:
    """Yield a row of errors for each log and plant."""
    rows = study["rows"]
    for log, label in LABELS.items():
        for plant in PLANTS:
            near = chosen(rows, log=log, plant=plant, horizon_s=6.0)
            far = chosen(rows, log=log, plant=plant, horizon_s=30.0)
            parts = ("position", f"yaw{judge_of(near)}")
            yield [
                label if plant == PLANTS[0] else "",
                plant,
                interval(near),
                yaw_of(near),
                ", ".join(share(near.get(f"coverage_90_{part}")) for part in parts),
                shown(far.get("position_median_m")),
            ]


def by_robot(study: dict[str, Any]) -> Iterator[Sequence[str]]:
    """Yield a row of errors after each fit for each log."""
    rows = study["rows_by_robot"]
    for log, label in LABELS.items():
        fits = [chosen(rows, log=log, horizon_s=6.0, fitted_to=fit) for fit in FITS]
        places = [shown(fit["position_median_m"]) for fit in fits]
        yield [label, *places, ", ".join(yaw_of(fit) for fit in fits)]


def judge_of(row: dict[str, Any]) -> str:
    """Return what names of columns have where the gyro is the first judge of headings."""
    return "_gyro" if row["heading_judge"] == "gyro" else ""


def yaw_of(row: dict[str, Any]) -> str:
    """Return the error of the heading by its first judge."""
    return shown(row[f"yaw{judge_of(row)}_median_rad"])


def grounds(study: dict[str, Any]) -> Iterator[Sequence[str]]:
    """Yield the numbers of each log's ground."""
    for log, label in LABELS.items():
        planar, tyres, mujoco = (study["numbers"][log][plant] for plant in PLANTS)
        track = 0.571 if log.startswith("husky") else 1.136
        yield [
            label,
            shown(0.5 * (planar["alpha_l"] + planar["alpha_r"])),
            shown((planar["y_l_m"] - planar["y_r_m"]) / track, 2),
            shown(planar["drift_s"], 2),
            f"{shown(tyres.get('stiffness_x'), 1)}, {shown(tyres.get('stiffness_y'), 1)}",
            shown(mujoco.get("friction"), 2),
            shown(planar["position_late_s"], 2),
        ]


def main(path: str) -> None:
    """Write each table between its marks."""
    study = json.loads(Path(path).read_text(encoding="utf-8"))
    fits = [f"{heading} [m]" for heading in FITS.values()]
    tables = {
        "errors": table(
            (
                "log",
                "plant",
                "6 s: position [m]",
                "yaw [rad]",
                "inside [%]: position, yaw",
                "30 s: position [m]",
            ),
            errors(study),
            2,
        ),
        "by robot": table(("log", *fits, "yaw, each [rad]"), by_robot(study), 1),
        "grounds": table(
            (
                "log",
                "rolling",
                "turn gain",
                "outward drift in bends [s]",
                "slip stiffness along, across",
                "MuJoCo's friction",
                "positions late [s]",
            ),
            grounds(study),
            1,
        ),
    }
    page = PAGE.read_text(encoding="utf-8")
    for name, text in tables.items():
        mark = re.compile(rf"(<!--{name}-->\n).*?(\n<!--/-->)", re.DOTALL)
        page = mark.sub(lambda found, text=text: found[1] + text + found[2], page)
    PAGE.write_text(page, encoding="utf-8")
    print("\n".join(note for note in study["notes"] if "has" in note))


if __name__ == "__main__":
    main(sys.argv[1])
