"""Study of runs: every plant is fitted to the first half of each log and judged on the second.

See docs/runs.md.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from matplotlib.axes import Axes

from ssmr.models.law import PLANAR_MODELS
from validation import cli, output
from validation.calibrate import BODY, FIRST_FITTED, begin_at
from validation.compare import compare
from validation.experiment.runs import warm_up
from validation.experiment.sources import open_source
from validation.files.formats import log_path, profile_of_log, read_log
from validation.fit import Fitted, fit
from validation.output import Progress, file_name, one_line, shortened
from validation.plants.profile import Profile, bare_profile, choose_profile, make_plant
from validation.plants.table import PLANTS
from validation.report import drawing
from validation.report.columns import DEGREES, METRES, Unit
from validation.report.comparison import Comparison
from validation.report.motions import alike_sentences
from validation.report.table import Row, Table
from validation.study.common import AnyStudy, Study
from validation.sweep import sweep
from validation.workers import threads_of

SCHEMA = "ssmr.study.runs/1"
"""Schema of study.json and of the file of each run."""
_HORIZONS = (2.0, 6.0, 15.0, 30.0, 60.0)
"""Times after which predictions are judged [s]."""
_ACROSS = 3
"""Number of panels in a row of the picture."""
_COSTS = {"mujoco": 1.0, "four_wheel": 0.2}
"""Processor time of fit and judgement over the length of a log, by plant [1]."""
_COST = 0.05
"""The same for every other plant."""
_INTERVAL = ("position_median_m", "position_low_m", "position_high_m")
_MEDIANS = (*_INTERVAL, "yaw_median_rad")
"""Columns of a row that come from the errors over the windows of one horizon."""


@dataclass(frozen=True)
class RunsStudy(AnyStudy):
    """Options of the study of runs."""

    logs: tyro.conf.Positional[Sequence[str]]
    """Logs, each with its robot where that is not --robot: grass.csv@warthog,
    tile.csv@my_robot.toml."""
    plants: tuple[str, ...] = PLANTS
    """Plants to fit and to judge."""
    robot: cli.AnyRobot = None
    """Name of a shipped robot, or path of a robot's file (.toml); the profile's if not given."""

    def __post_init__(self) -> None:
        """Raise a ValueError where there is no log, or an unknown plant."""
        super().__post_init__()
        if not self.logs:
            raise ValueError("no log is named; name files such as grass.csv@warthog")
        if unknown := sorted(set(self.plants) - set(PLANTS)):
            raise ValueError(f"unknown plant '{unknown[0]}'; there are: {', '.join(PLANTS)}")

    def writes(self) -> tuple[str, ...]:
        """Return the names of the files that it writes into its folder."""
        names = [*super().writes()]
        for name in _runs(self):
            names += [f"{name}.json", f"{name}.toml"]
        return tuple(names)


FittedLog = tuple[str, Profile]
"""A log, and the profile that its fits begin with."""


def _runs(o: RunsStudy) -> dict[str, FittedLog]:
    """Return the runs by name, each log with its robot.

    A run begins without any fit of the robot: a shipped profile may know the second half of the
    log.

    Raises:
        ValueError: an unknown robot, or two logs of one name.
    """
    runs: dict[str, FittedLog] = {}
    for given in o.logs:
        log = given
        robot = o.robot
        # a file may have an @ in its name
        if "@" in given and not Path(given).exists():
            log, _, robot_of_log = given.rpartition("@")
            robot = robot_of_log or robot
        profile = choose_profile(None, robot, profile_of_log(log))
        name = file_name(Path(log).stem.removesuffix("_train"))
        if name in runs:
            raise ValueError(f"two logs have the name {name}; give one of them another")
        runs[name] = (log, bare_profile(profile.robot))
    return runs


def _measure(o: RunsStudy, name: str, log: str, profile: Profile) -> Row:
    """Fit every plant to the first half of a log's motion and judge all on the second.

    Files of a finished run lie in the study's folder: `NAME.json`, and then `NAME.toml`, the
    profile with all fits. A run that was finished before is read back.
    """
    folder = output.make_folder(o.out or o.folder())
    file = folder / f"{name}.json"
    fitted_profile = folder / f"{name}.toml"
    request = {
        "schema": SCHEMA,
        "plants": list(o.plants),
        "seed": o.seed,
        "versions": dict(output.versions()),
        "log": hashlib.sha256(log_path(log).read_bytes()).hexdigest(),
        "robot": profile.robot.name,
    }
    # the profile is written last: a run that has both files is finished
    if file.is_file() and fitted_profile.is_file():
        before = json.loads(file.read_text(encoding="utf-8"))
        if before.get("asked") == request:
            return {"found": before}
    middle = _middle_of_motion(log)
    numbers: dict[str, Row] = {}
    for plant, fitted in _fit_all(o, log, profile, middle, folder / name):
        profile = fitted.profile
        numbers[plant] = {
            p.name if p.unit == "1" else f"{p.name}_{p.unit}": p.value for p in fitted.parameters
        }
    judged = compare(
        log,
        profile,
        plants=o.plants,
        input="wheels",
        since=middle,
        horizons=_HORIZONS,
        bands=True,
        seed=o.seed,
        workers=1,
    )
    pairs = judged.alike
    found = {
        "schema": SCHEMA,
        "files": [fitted_profile.name],
        "asked": request,
        "rows": _rows_of(name, judged),
        "numbers": numbers,
        "alike": pairs,
        "told": alike_sentences(judged.scores, pairs),
        "heading_judge": "gyro" if judged.gyro_first else "localiser",
    }
    output.write_json(file, found)
    profile.save(fitted_profile)
    return {"found": found}


def _middle_of_motion(log: str) -> float:
    """Return the stamp that halves the time in which a log's robot moves [s]."""
    pieces = open_source(log, "wheels").pieces
    stamps = [p.t[p.moves] for p in pieces if p.t is not None and p.moves is not None]
    return float(np.median(np.concatenate(stamps)))


def _fit_all(
    o: RunsStudy, log: str, profile: Profile, until: float, folder: Path
) -> Iterator[tuple[str, Fitted]]:
    """Yield every plant with its fit up to a time [s], which begins where the last one ended."""
    # first the kinematic model: others than planar ones begin with the body that it finds
    for plant in sorted(o.plants, key=lambda plant: plant != FIRST_FITTED):
        heavy = plant not in PLANAR_MODELS and FIRST_FITTED in o.plants
        fitted = fit(
            plant,
            log,
            profile=profile,
            input="wheels",
            until=until,
            seed=o.seed,
            workers=o.workers if isinstance(o.workers, str) else 1,
            search="lsq" if heavy else "hybrid",
            guess=begin_at(plant, BODY, profile) if heavy else None,
            out=folder / plant,
        )
        profile = fitted.profile
        yield plant, fitted


def _rows_of(name: str, judged: Comparison) -> Sequence[Row]:
    """Return a row for each plant and horizon."""
    rows = []
    for plant, result in judged.scores.items():
        for horizon, errors in result.overlapping.items():
            row = {"log": name, "plant": plant, "horizon_s": horizon}
            row |= {key: getattr(errors, key) for key in _MEDIANS}
            for part, share in result.coverage.get(horizon, {}).items():
                row[f"coverage_90_{part}"] = share
            row["n"] = errors.n
            if by_gyro := result.by_gyro.get(horizon):
                row["yaw_gyro_median_rad"] = by_gyro.summary().yaw_median_rad
            rows.append(row)
    return rows


@cli.program(RunsStudy)
def study_runs(o: RunsStudy) -> Study:
    """Fit every plant to the first half of each log by its wheel rates; judge it on the second.

    Halves are those of the time in motion.

    Planar models are fitted by the hybrid search from the robot's profile, and others by least
    squares that begin where the kinematic one ends.

    Writes study.json, study.md and study.png, and for each log its profile with all fits. A study
    that was broken off goes on where it was.

    Raises:
        ValueError: a log, robot or plant that cannot be used.
        SsmrError: no log could be fitted.
    """
    runs = _runs(o)
    # a fault of a plant shows before hours of fits
    for plant in o.plants:
        warm_up(make_plant(next(iter(runs.values()))[1], plant))
    seconds = sum(float(np.ptp(read_log(log_path(log)).t)) for log, _ in runs.values())
    minutes = sum(_COSTS.get(plant, _COST) for plant in o.plants) * seconds / 60.0
    o.progress(Progress(0, len(runs), f"at most {math.ceil(minutes)} minutes of one processor"))
    measures = {"fit and judgement": lambda variant: _measure(o, *variant)}
    variants = {name: (name, *run) for name, run in runs.items()}
    # a scheduler gets the candidates of each fit: logs and files stay here
    swept = sweep(variants, measures, workers=threads_of(o.workers), progress=o.progress)
    logs = {row["variant"]: row["found"] for row in swept.rows if "found" in row}
    tables = [_table(name, run["rows"], run["heading_judge"]) for name, run in logs.items()]
    for plant in o.plants:
        numbers = [{"log": name, **run["numbers"][plant]} for name, run in logs.items()]
        tables.append(Table(f"{plant} on each ground", numbers))
    rows: list[Row] = []
    # a note that several logs share is said once
    logs_by_note: dict[str, list[str]] = {}
    for name, run in logs.items():
        rows += run["rows"]
        for note in run["told"]:
            logs_by_note.setdefault(note, []).append(name)
    notes = [f"{', '.join(names)}: {note}" for note, names in logs_by_note.items()]
    return Study(
        title=f"{len(logs)} logs, each fitted on its first half and judged on its second",
        shown=tables,
        remarks=[*swept.notes, *notes],
        status=swept.status,
        about={
            "schema": SCHEMA,
            "study": "runs",
            "rows": rows,
            "winners": {name: run["alike"] for name, run in logs.items()},
            "numbers": {name: run["numbers"] for name, run in logs.items()},
        },
        panels=_panels(logs),
    )


def _table(name: str, rows: list[Row], judge: str) -> Table:
    inside = "coverage_90_yaw_gyro" if judge == "gyro" else "coverage_90_yaw"
    ordered = sorted(rows, key=lambda row: (row["horizon_s"], PLANTS.index(row["plant"])))
    shown = [
        {
            "horizon_s": row["horizon_s"],
            "plant": row["plant"],
            "position_median_m": tuple(row[key] for key in _INTERVAL),
            "yaw_median_rad": row["yaw_median_rad"],
            "yaw_gyro_median_rad": row.get("yaw_gyro_median_rad"),
            "position_inside_share": row.get("coverage_90_position"),
            "yaw_inside_share": row.get(inside),
            "windows": row["n"],
        }
        for row in ordered
    ]
    units = {
        "horizon_s": Unit("s", 1.0, 0, significant=3),
        "position_median_m": METRES,
        "yaw_median_rad": DEGREES,
        "yaw_gyro_median_rad": DEGREES,
    }
    caption = (
        "in brackets: an interval that holds the median with 90 %\n"
        "inside: share of windows within the band, which promises 90 %; "
        f"the {judge} is the judge of heading"
    )
    return Table(one_line(name), shown, caption, group="horizon_s", units=units)


def _panels(logs: dict[str, Any]) -> list[drawing.PanelRow]:
    """Return panels of the median error of position over the horizon, a panel for each log."""
    keys = ("horizon_s", *_INTERVAL)

    def panel(name: str, ax: Axes) -> None:
        rows = logs[name]["rows"]
        for plant in dict.fromkeys(row["plant"] for row in rows):
            of_plant = [row for row in rows if row["plant"] == plant]
            t, median, low, high = ([row[key] for row in of_plant] for key in keys)
            ink = drawing.ink_of(plant)
            ax.plot(t, median, marker="o", markersize=3.0, color=ink, label=plant, gid=plant)
            ax.fill_between(t, low, high, color=ink, alpha=0.1)
        ax.set(
            xscale="log",
            yscale="log",
            title=shortened(name, 40),
            xlabel="horizon [s]",
            ylabel="position error [m]",
        )
        drawing.plain_ticks(ax.xaxis, (1.0, 2.0, 6.0))
        drawing.plain_ticks(ax.yaxis, (1.0, 3.0))
        if name == next(iter(logs)):
            ax.legend(frameon=False, fontsize=8.0)

    panels = [partial(panel, name) for name in logs]
    rows = []
    for k in range(0, len(panels), _ACROSS):
        rows.append(drawing.PanelRow(3.0, panels[k : k + _ACROSS]))
    return rows
