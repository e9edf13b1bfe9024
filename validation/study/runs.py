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
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from matplotlib.axes import Axes

from ssmr.models.law import PLANAR_MODELS
from validation import cli, output
from validation.compare import compare
from validation.experiment.runs import warm_up
from validation.experiment.sources import open_source
from validation.files.formats import log_path, profile_of_log, read_log
from validation.fit import Fitted, fit
from validation.identify.beginning import FIRST_FITTED
from validation.output import Progress, file_name, one_line, said_once, shortened
from validation.plants.profile import Profile, bare_profile, choose_profile, make_plant
from validation.plants.table import PLANTS
from validation.report import drawing
from validation.report.comparison import Comparison
from validation.report.motions import alike_sentences
from validation.report.table import Row, Table
from validation.study.common import AnyStudy, Study
from validation.study.runs_tables import (
    BOTH,
    INTERVAL,
    ON,
    OTHERS,
    OWN,
    errors_table,
    robots_panel,
    worth,
)
from validation.sweep import sweep
from validation.workers import threads_of

SCHEMA = "ssmr.study.runs/1"
"""Schema of study.json and of the file of each run."""
_HORIZONS = (2.0, 6.0, 15.0, 30.0, 60.0)
"""Times after which predictions are judged [s]."""
_ACROSS = 3
"""Number of panels in a row of the picture."""
_ADAPT_S = 30.0
"""Time between two sets of numbers where fits go on while the robot drives [s]."""
_COSTS = {"mujoco": 1.0, "four_wheel": 0.2}
"""Processor time of fit and judgement over the length of a log, by plant [1]."""
_COST = 0.05
"""The same for every other plant."""
_MEDIANS = (*INTERVAL, "yaw_median_rad")
"""Columns of a row that come from the errors over the windows of one horizon."""


@dataclass(frozen=True)
class RunsStudy(AnyStudy):
    """Options of the study of runs."""

    logs: tyro.conf.Positional[Sequence[str | Path]]
    """Logs, each with its robot where that is not --robot: grass.csv@warthog,
    tile.csv@my_robot.toml."""
    plants: Sequence[str] = PLANTS
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


_FittedLog = tuple[str, Profile, list[str]]
"""A log, the profile that its fits begin with, and the other logs of its robot."""


def _runs(o: RunsStudy) -> dict[str, _FittedLog]:
    """Return the runs by name, each log with its robot and the other logs of that.

    A run begins without any fit of the robot: a shipped profile may know the second half of the
    log.

    Raises:
        ValueError: an unknown robot, or two logs of one name.
    """
    profiles: dict[str, tuple[str, Profile]] = {}
    for given in map(str, o.logs):
        log = given
        robot = o.robot
        # a file may have an @ in its name
        if "@" in given and not Path(given).exists():
            log, _, robot_of_log = given.rpartition("@")
            robot = robot_of_log or robot
        profile = choose_profile(None, robot, profile_of_log(log))
        name = file_name(Path(log).stem.removesuffix("_train"))
        if name in profiles:
            raise ValueError(f"two logs have the name {name}; give one of them another")
        profiles[name] = (log, bare_profile(profile.robot))
    runs = {}
    for name, (log, profile) in profiles.items():
        others = []
        for other, of_other in profiles.values():
            if other != log and of_other.robot.name == profile.robot.name:
                others.append(other)
        runs[name] = (log, profile, others)
    return runs


def _measure(o: RunsStudy, name: str, log: str, profile: Profile, others: list[str]) -> Row:
    """Fit every plant to the first half of a log's motion and judge all on the second.

    The kinematic one is also fitted to the robot's other logs, and from there to that half.

    Files of a finished run lie in the study's folder: `NAME.json`, and then `NAME.toml`, the
    profile with all fits. A run that was finished before is read back.
    """
    folder = output.make_folder(Path(o.out or o.folder()))
    file = folder / f"{name}.json"
    fitted_profile = folder / f"{name}.toml"
    request = {
        "schema": SCHEMA,
        "plants": list(o.plants),
        "seed": o.seed,
        "versions": dict(output.versions()),
        "logs": [
            hashlib.sha256(log_path(each).read_bytes()).hexdigest() for each in (log, *others)
        ],
        "robot": profile.robot.name,
    }
    # the profile is written last: a run that has both files is finished
    if file.is_file() and fitted_profile.is_file():
        before = json.loads(file.read_text(encoding="utf-8"))
        if before.get("asked") == request:
            return {"found": before}
    middle = _middle_of_motion(log)
    by_robot = dict[str, tuple[Profile, float | None]]()
    if others and FIRST_FITTED in o.plants:
        pooled = _fit(o, FIRST_FITTED, others, profile, folder / name / "others").profile
        own = _fit(o, FIRST_FITTED, log, pooled, folder / name / "both", until=middle)
        by_robot = {OTHERS: (pooled, None), ON: (pooled, _ADAPT_S), BOTH: (own.profile, None)}
    numbers: dict[str, Row] = {}
    for plant, fitted in _fit_all(o, log, profile, middle, folder / name):
        profile = fitted.profile
        numbers[plant] = {
            p.name if p.unit == "1" else f"{p.name}_{p.unit}": p.value for p in fitted.parameters
        }
    judge = partial(
        compare,
        log,
        input="wheels",
        since=middle,
        horizons=_HORIZONS,
        bands=True,
        seed=o.seed,
        workers=1,
    )
    judged = judge(profile, plants=o.plants)
    pairs = judged.alike
    rows = _rows_of(name, judged)
    compared = []
    if by_robot:
        compared = [{**row, "fitted_to": OWN} for row in rows if row["plant"] == FIRST_FITTED]
    for fitted_to, (each, adapt) in by_robot.items():
        again = _rows_of(name, judge(each, plants=(FIRST_FITTED,), adapt=adapt))
        compared += [{**row, "fitted_to": fitted_to} for row in again]
    found = {
        "schema": SCHEMA,
        "files": [fitted_profile.name],
        "asked": request,
        "rows": rows,
        "rows_by_robot": compared,
        "numbers": numbers,
        "alike": pairs,
        "told": alike_sentences(judged.scores, pairs),
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
        search = "hybrid" if plant in PLANAR_MODELS else "lsq"
        fitted = _fit(o, plant, log, profile, folder / plant, until=until, search=search)
        profile = fitted.profile
        yield plant, fitted


def _fit(
    o: RunsStudy,
    plant: str,
    logs: str | Sequence[str],
    profile: Profile,
    folder: Path,
    **settings: Any,
) -> Fitted:
    """Return the fit of a plant to logs by their wheel rates; `settings` are options of `fit`."""
    return fit(
        plant,
        logs,
        profile=profile,
        input="wheels",
        seed=o.seed,
        workers=o.workers if isinstance(o.workers, str) else 1,
        out=folder,
        **settings,
    )


def _rows_of(name: str, judged: Comparison) -> Sequence[Row]:
    """Return a row for each plant and horizon."""
    rows = []
    for plant, result in judged.scores.items():
        for horizon, errors in result.overlapping.items():
            row = {"log": name, "plant": plant, "horizon_s": horizon}
            row |= {key: getattr(errors, key) for key in _MEDIANS}
            for part, (share, score) in result.held.get(horizon, {}).items():
                row[f"coverage_90_{part}"] = share
                row[f"interval_score_90_{part}"] = score
            row["n"] = errors.n
            row["heading_judge"] = "gyro" if judged.gyro_first else "localiser"
            if by_gyro := result.by_gyro.get(horizon):
                row["yaw_gyro_median_rad"] = by_gyro.summary().yaw_median_rad
            rows.append(row)
    return rows


@cli.program(RunsStudy)
def study_runs(o: RunsStudy) -> Study:
    """Fit every plant to the first half of each log by its wheel rates; judge it on the second.

    Halves are those of the time in motion.

    Planar models are fitted by the hybrid search from the robot's profile, and others by least
    squares that begin where the kinematic one ends. Where a robot has several logs, the kinematic
    one is also fitted to a log's others, and from there to its first half.

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
    seconds = sum(float(np.ptp(read_log(log_path(log)).t)) for log, _, _ in runs.values())
    minutes = sum(_COSTS.get(plant, _COST) for plant in o.plants) * seconds / 60.0
    o.progress(Progress(0, len(runs), f"at most {math.ceil(minutes)} minutes of one processor"))
    measures = {"fit and judgement": lambda variant: _measure(o, *variant)}
    variants = {name: (name, *run) for name, run in runs.items()}
    # a scheduler gets the candidates of each fit: logs and files stay here
    swept = sweep(variants, measures, workers=threads_of(o.workers), progress=o.progress)
    logs = {row["variant"]: row["found"] for row in swept.rows if "found" in row}
    tables = [errors_table(one_line(name), run["rows"]) for name, run in logs.items()]
    by_robot = list(chain.from_iterable(run["rows_by_robot"] for run in logs.values()))
    if by_robot:
        title = "What a robot's other logs are worth: kinematic on each second half"
        told = [row for row in by_robot if row["horizon_s"] in (6.0, 30.0)]
        tables.append(errors_table(title, told, ("log", "fitted_to")))
    for plant in o.plants:
        numbers = [{"log": name, **run["numbers"][plant]} for name, run in logs.items()]
        tables.append(Table(f"{plant} on each ground", numbers))
    rows = list(chain.from_iterable(run["rows"] for run in logs.values()))
    notes = said_once({name: run["told"] for name, run in logs.items()})
    notes += [worth(by_robot, fitted_to) for fitted_to in (OTHERS, ON, BOTH) if by_robot]
    panels = _panels(logs)
    panels += [drawing.PanelRow(3.0, [robots_panel(by_robot)])] * bool(by_robot)
    return Study(
        title=f"{len(logs)} logs, each fitted on its first half and judged on its second",
        shown=tables,
        remarks=[*swept.notes, *notes],
        status=swept.status,
        about={
            "schema": SCHEMA,
            "study": "runs",
            "rows": rows,
            "rows_by_robot": by_robot,
            "winners": {name: run["alike"] for name, run in logs.items()},
            "numbers": {name: run["numbers"] for name, run in logs.items()},
        },
        panels=panels,
    )


def _panels(logs: dict[str, Any]) -> list[drawing.PanelRow]:
    """Return panels of the median error of position over the horizon, a panel for each log."""
    keys = ("horizon_s", *INTERVAL)

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
