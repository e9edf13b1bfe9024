"""Write the tables of docs/tile.md: each log is calibrated, and `table` lays the results together.

Run from the project's root: `python docs/make_runs_tables.py FOLDER [OUT]`. FOLDER has the
recordings, also in folders of it. Results stay in OUT (runs/every_log); what is there is not made
again.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from validation.calibrate import calibrate
from validation.compare import compare
from validation.descriptions.loading import load_robot
from validation.fit import fit
from validation.plants.profile import Profile, bare_profile, load_profile
from validation.table import table

PAGE = Path(__file__).with_name("tile.md")
LOGS = {
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
"""Names of logs on the page, in its order; each begins with its robot's."""
PLANTS = ("kinematic", "four_wheel", "mujoco")
OWN, OTHERS, ON, BOTH = FITS = ("own", "the others", "the others, and on", "both")
"""Fits of the kinematic plant that each log judges where they have not seen it; folders of OUT."""
ADAPT_S = 30.0
"""Time between two sets of numbers where a fit goes on while the robot drives [s]."""
Rows = Mapping[tuple[str, str], Mapping[str, Any]]
"""Rows of a table by log and plant; each has its values by key."""


def calibrate_log(name: str, log: Path, profile: Profile, plants: Sequence[str], to: Path) -> None:
    """Calibrate plants on a log, each third of which judges numbers from the other two."""
    folder = to / name
    if not (folder / "calibrate.json").is_file():
        calibrated = calibrate(str(log), profile=profile, plants=plants, trust=True)
        calibrated.kept.save(folder, recording=False)
        calibrated.save(folder)


def judge_others(name: str, logs: Mapping[str, Path], bare: Profile, out: Path) -> Profile:
    """Fit the kinematic plant to a robot's other logs, and judge it on the one that is left.

    Returns the fitted profile; it is judged as it is, and going on while the robot drives.
    """
    saved = out / OTHERS / name / "profile.toml"
    if saved.is_file():
        return load_profile(saved)
    robot = bare.robot.name
    others = [str(log) for other, log in logs.items() if other.startswith(robot) and other != name]
    fitted = fit(PLANTS[0], others, profile=bare, input="wheels").profile
    for which, adapt in ((ON, ADAPT_S), (OTHERS, None)):
        judged = compare(str(logs[name]), fitted, PLANTS[:1], input="wheels", adapt=adapt)
        judged.save(out / which / name, recording=False)
    fitted.save(saved)
    return fitted


def read_rows(folder: Path, program: str, *columns: str) -> Rows:
    """Return what a program found, with these columns."""
    files = sorted(folder.glob(f"*/{program}.json"))
    rows = table(files, columns=("run", "plant", *columns)).shown[0].rows
    return {(row["run"], row["plant"]): row for row in rows}


def show_number(value: float | None, digits: int = 3) -> str:
    """Return a number with so many digits behind the point, and a dash for none."""
    if value is None:
        return "–"
    return f"{value:.2f}" if abs(value) >= 3.0 else f"{value:.{digits}f}"


def error_lines(out: Path) -> Iterator[Sequence[str]]:
    """Yield the errors of each log and plant: before and after the fit, and how often inside."""
    position = [f"after.6.position_{key}_m" for key in ("median", "low", "high")]
    yaw = "after.6.yaw_median_rad"
    far = "after.30.position_median_m"
    before = "before.6.position_median_m"
    found = read_rows(out / OWN, "calibrate", before, *position, yaw, far)
    inside = "horizons.6.coverage_90.position"
    bands = read_rows(out / OWN, "compare", inside)
    for log, label in LOGS.items():
        for plant in PLANTS:
            row = found.get((log, plant))
            if row is None:
                continue
            median, low, high = (show_number(row[key]) for key in position)
            share = bands[log, plant][inside]
            yield (
                label if plant == PLANTS[0] else "",
                plant,
                show_number(row[before]),
                f"{median} ({low}–{high})",
                show_number(row[yaw]),
                "–" if share is None else f"{100.0 * share:.0f}",
                show_number(row[far]),
            )


def errors_by_fit(out: Path) -> dict[str, dict[str, list[float]]]:
    """Return the errors after 6 s of position [m] and of yaw [rad] by fit and log."""
    errors: dict[str, dict[str, list[float]]] = {}
    for fit_of in FITS:
        judged = ("compare", "horizons.6.overlapping")
        if fit_of in (OWN, BOTH):
            judged = ("calibrate", "after.6")
        keys = [f"{judged[1]}.{name}" for name in ("position_median_m", "yaw_median_rad")]
        rows = read_rows(out / fit_of, judged[0], *keys)
        errors[fit_of] = {log: [rows[log, PLANTS[0]][key] for key in keys] for log in LOGS}
    return errors


def fit_lines(out: Path) -> Iterator[Sequence[str]]:
    """Yield the errors of each log after each fit of the kinematic plant."""
    errors = errors_by_fit(out)
    for log, label in LOGS.items():
        places, yaws = zip(*(errors[fit_of][log] for fit_of in FITS), strict=True)
        yield label, *map(show_number, places), ", ".join(map(show_number, yaws))


def tell_worth(out: Path) -> Iterator[str]:
    """Yield a sentence for each fit on the ratio of its errors to those of the logs' own fits."""
    errors = errors_by_fit(out)
    for fit_of in FITS[1:]:
        ratios = np.log([errors[fit_of][log][0] / errors[OWN][log][0] for log in LOGS])
        # logs are few, so the mean's interval of 90 % is Student's
        reach = stats.t.ppf(0.95, len(ratios) - 1) * stats.sem(ratios)
        mean, low, high = np.exp(ratios.mean() + reach * np.array([0.0, -1.0, 1.0]))
        yield f"{fit_of}: {mean:.2f} ({low:.2f}–{high:.2f}), better on {np.sum(ratios < 0.0)}"


def ground_lines(out: Path) -> Iterator[Sequence[str]]:
    """Yield the numbers of each log's ground."""
    names = "alpha_l alpha_r y_l y_r drift position_late stiffness_x stiffness_y friction".split()
    keys = {name: f"parameters.{name}.value" for name in names}
    found = read_rows(out / OWN, "calibrate", *keys.values())
    for log, label in LOGS.items():
        planar, tyres, mujoco = (
            {name: found[log, plant][key] for name, key in keys.items()} for plant in PLANTS
        )
        track = load_robot(log.partition("_")[0]).track
        yield (
            label,
            show_number(0.5 * (planar["alpha_l"] + planar["alpha_r"])),
            show_number((planar["y_l"] - planar["y_r"]) / track, 2),
            show_number(planar["drift"], 2),
            f"{show_number(tyres['stiffness_x'], 1)}, {show_number(tyres['stiffness_y'], 1)}",
            show_number(mujoco["friction"], 2),
            show_number(planar["position_late"], 2),
        )


def write_table(page: str, name: str, lines: Iterator[Sequence[str]]) -> str:
    """Return a page whose table between the marks of a name has these lines below its heading."""
    text = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    mark = re.compile(rf"(<!--{name}-->\n.*?\n.*?\n).*?(\n<!--/-->)", re.DOTALL)
    return mark.sub(lambda found: found[1] + text + found[2], page)


def main(data: str, to: str = "runs/every_log") -> None:
    """Make what is missing, and write each table between its marks."""
    out = Path(to)
    logs = {name: next(Path(data).rglob(f"{name}_train.csv")) for name in LOGS}
    for name, log in logs.items():
        bare = bare_profile(load_robot(name.partition("_")[0]))
        calibrate_log(name, log, bare, PLANTS, out / OWN)
        others = judge_others(name, logs, bare, out)
        calibrate_log(name, log, others, PLANTS[:1], out / BOTH)
    page = PAGE.read_text(encoding="utf-8")
    tables = {"errors": error_lines, "by robot": fit_lines, "grounds": ground_lines}
    for name, lines in tables.items():
        page = write_table(page, name, lines(out))
    PAGE.write_text(page, encoding="utf-8")
    print("\n".join(tell_worth(out)))


if __name__ == "__main__":
    main(*sys.argv[1:])
