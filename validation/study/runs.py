"""Every log, every plant: each is fitted to the first half of a log and judged on the second (docs/runs.md)."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ssmr.models.law import PLANAR_MODELS
from validation import cli, store
from validation.bench.sources import open_source, warm_up
from validation.calibrate import BODY, FIRST_FITTED, begin_at
from validation.compare import compare
from validation.files.formats import log_path, profile_of_log, read_log
from validation.fit import fit
from validation.plants.profile import Profile, bare_profile, choose_profile, make_plant
from validation.plants.table import PLANTS
from validation.progress import Progress
from validation.report import drawing
from validation.report.columns import DEGREES, METRES, Unit
from validation.report.motions import alike_sentences
from validation.report.report import Report
from validation.report.table import Row, Table
from validation.study.sweep import AnyStudy, picture, sweep
from validation.words import file_name, one_line, shortened

SCHEMA = "ssmr.study.runs/1"
_HORIZONS = (2.0, 6.0, 15.0, 30.0, 60.0)
_ACROSS = 3
"""Number of panels in a row of the picture."""
_COSTS = {"mujoco": 1.0, "four_wheel": 0.2}
_COST = 0.05
"""Processor time of fit and judgement over the length of a log, by plant, and that of the others
[1]."""


@dataclass(frozen=True)
class RunsStudy(AnyStudy):
    """Options of the study of runs."""

    logs: Annotated[tuple[str, ...], tyro.conf.Positional, cli.option(metavar="FILE[@ROBOT]")]
    """Logs, each with its robot where that is not --robot: grass.csv@warthog,
    tile.csv@my_robot.toml."""
    plants: Annotated[cli.Names, cli.option(metavar="PLANT,...", default="all")] = PLANTS
    """Plants to fit and to judge."""
    robot: cli.AnyRobot = None

    def __post_init__(self) -> None:
        """Raise a ValueError where there is no log, or a plant that there is not."""
        super().__post_init__()
        if not self.logs:
            raise ValueError("no log is named; name files such as grass.csv@warthog")
        if unknown := sorted(set(self.plants) - set(PLANTS)):
            raise ValueError(f"unknown plant '{unknown[0]}'; there are: {', '.join(PLANTS)}")

    def writes(self) -> tuple[str, ...]:
        """Return the names of the files that it writes into its folder."""
        return (
            *super().writes(),
            *(f"{name}{ending}" for name in _runs(self) for ending in (".json", ".toml")),
        )


@dataclass(frozen=True)
class Run:
    """One log, with the profile that its fits begin with."""

    log: str
    profile: Profile

    @property
    def name(self) -> str:
        """Name in tables and of its files."""
        return file_name(Path(self.log).stem.removesuffix("_train"))


def _runs(o: RunsStudy) -> dict[str, Run]:
    """Return the runs by name, each log with its robot and none of its fits: a shipped profile may know the second half.

    Raises:
        ValueError: a robot that there is not, or two logs of one name.
    """
    runs: dict[str, Run] = {}
    for given in o.logs:
        log, _, robot = (
            given.rpartition("@") if "@" in given and not Path(given).exists() else (given, "", "")
        )
        run = Run(
            log, bare_profile(choose_profile(None, robot or o.robot, profile_of_log(log)).robot)
        )
        if run.name in runs:
            raise ValueError(f"two logs have the name {run.name}; give one of them another")
        runs[run.name] = run
    return runs


def _measure(o: RunsStudy, run: Run) -> Row:
    """Fit every plant to the first half of a log's motion and judge all on the second; what was finished is read back.

    Files of a finished run lie in the study's folder: `NAME.json`, and then `NAME.toml`, the
    profile with all fits.
    """
    folder = store.make_folder(o.out or o.folder())
    kept = folder / f"{run.name}.json"
    request = {
        "schema": SCHEMA, "plants": list(o.plants), "seed": o.seed, "versions": dict(store.versions()),
        "log": hashlib.sha256(log_path(run.log).read_bytes()).hexdigest(), "robot": run.profile.robot.name,
    }  # fmt: skip
    fitted_profile = folder / f"{run.name}.toml"
    if kept.is_file() and fitted_profile.is_file():
        before = json.loads(kept.read_text(encoding="utf-8"))
        if before.get("asked") == request:
            return {"found": before}
    pieces = open_source(run.log, "wheels").pieces
    in_motion = [
        piece.t[piece.moves] for piece in pieces if piece.t is not None and piece.moves is not None
    ]
    middle = float(np.median(np.concatenate(in_motion)))
    profile = run.profile
    numbers = dict[str, Row]()
    for plant in sorted(o.plants, key=lambda plant: plant != FIRST_FITTED):
        heavy = plant not in PLANAR_MODELS and FIRST_FITTED in o.plants
        fitted = fit(
            plant, run.log, profile=profile, input="wheels", until=middle, seed=o.seed, workers=1,
            search="lsq" if heavy else "hybrid", start=begin_at(plant, BODY, profile) if heavy else None,
            out=folder / run.name / plant,
        )  # fmt: skip
        profile = fitted.profile
        numbers[plant] = {
            p.name if p.unit == "1" else f"{p.name}_{p.unit}": p.value for p in fitted.parameters
        }
    judged = compare(
        run.log, profile, plants=o.plants, input="wheels", start=middle, horizons=_HORIZONS, bands=True,
        seed=o.seed, workers=1,
    )  # fmt: skip
    rows = [
        {
            "log": run.name, "plant": name, "horizon_s": horizon,
            **{k: getattr(e, k) for k in ("position_median_m", "yaw_median_rad", "position_low_m", "position_high_m")},
            **{f"coverage_90_{part}": share for part, share in result.coverage.get(horizon, {}).items()}, "n": e.n,
            **({"yaw_gyro_median_rad": g.summary().yaw_median_rad} if (g := result.by_gyro.get(horizon)) else {}),
        }
        for name, result in judged.plants.items()
        for horizon, e in result.overlapping.items()
    ]  # fmt: skip
    alike = judged.document["alike"]
    judge = judged.document.get("heading_judge", "localiser")
    summary = {
        "alike": alike,
        "told": alike_sentences(judged.plants, alike),
        "heading_judge": judge,
    }
    own = {"schema": SCHEMA, "files": [fitted_profile.name]}
    answer = {**own, "asked": request, "rows": rows, "numbers": numbers, **summary}
    store.write_json(kept, answer)
    profile.save(fitted_profile)
    return {"found": answer}


@cli.program(RunsStudy)
def study_runs(o: RunsStudy) -> Report:
    """Fit every plant to the first half of each log's time in motion by its wheel rates, and judge it on the second half.

    Planar models are fitted by the hybrid search from the robot's profile, and others by least
    squares that begin where the kinematic one ends.

    Writes study.json, study.md and study.png, and for each log its profile with all fits. A study
    that was broken off goes on where it was.

    Raises:
        ValueError: a log, robot or plant that cannot be used.
        SsmrError: no log could be fitted.
    """
    runs = _runs(o)
    for plant in o.plants:
        warm_up(make_plant(next(iter(runs.values())).profile, plant))
    seconds = sum(float(np.ptp(read_log(log_path(run.log)).t)) for run in runs.values())
    minutes = sum(_COSTS.get(plant, _COST) for plant in o.plants) * seconds / 60.0
    o.progress(Progress(0, len(runs), f"at most {math.ceil(minutes)} minutes of one processor"))
    swept = sweep(
        runs, {"fit and judgement": partial(_measure, o)}, workers=o.workers, progress=o.progress
    )
    logs = {row["variant"]: row["found"] for row in swept.rows if "found" in row}
    notes = {
        note: ", ".join(n for n in logs if note in logs[n]["told"])
        for one in logs.values()
        for note in one["told"]
    }
    return Report(
        program="study",
        title=f"{len(logs)} logs, each fitted on its first half and judged on its second",
        tables=[
            *(_table(name, one["rows"], one["heading_judge"]) for name, one in logs.items()),
            *(
                Table(
                    f"{p} on each ground", [{"log": n, **f["numbers"][p]} for n, f in logs.items()]
                )
                for p in o.plants
            ),
        ],
        sentences=[*swept.notes, *(f"{names}: {note}" for note, names in notes.items())],
        status=swept.status,
        document={
            "schema": SCHEMA,
            "study": "runs",
            "rows": [row for one in logs.values() for row in one["rows"]],
            **{
                key: {n: one[of] for n, one in logs.items()}
                for key, of in (("winners", "alike"), ("numbers", "numbers"))
            },
        },
        draw=partial(_draw, logs),
        has_text=True,
    )


def _table(name: str, rows: list[Row], judge: str) -> Table:
    shown = [
        {
            "horizon_s": row["horizon_s"],
            "plant": row["plant"],
            "position_median_m": (
                row["position_median_m"],
                row["position_low_m"],
                row["position_high_m"],
            ),
            "yaw_median_rad": row["yaw_median_rad"],
            "yaw_gyro_median_rad": row.get("yaw_gyro_median_rad"),
            "position_inside_share": row.get("coverage_90_position"),
            "yaw_inside_share": row.get(
                "coverage_90_yaw_gyro" if judge == "gyro" else "coverage_90_yaw"
            ),
            "windows": row["n"],
        }
        for row in sorted(rows, key=lambda row: (row["horizon_s"], PLANTS.index(row["plant"])))
    ]
    units = {
        "horizon_s": Unit("s", 1.0, 0, significant=3),
        "position_median_m": METRES,
        "yaw_median_rad": DEGREES,
    }
    units["yaw_gyro_median_rad"] = DEGREES
    caption = (
        "in brackets: an interval that holds the median with 90 %\n"
        f"inside: share of windows within the band, which promises 90 %; the {judge} is the judge of heading"
    )
    return Table(one_line(name), shown, caption, group="horizon_s", units=units)


def _draw(logs: dict[str, Any], report: Report) -> Figure:
    """Return the picture: the median error of position over the horizon, a panel for each log."""

    def panel(name: str, ax: Axes) -> None:
        rows = logs[name]["rows"]
        for plant in dict.fromkeys(row["plant"] for row in rows):
            keys = ("horizon_s", "position_median_m", "position_low_m", "position_high_m")
            t, median, low, high = (
                [row[key] for row in rows if row["plant"] == plant] for key in keys
            )
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

    names = list(logs)
    groups = [names[k : k + _ACROSS] for k in range(0, len(names), _ACROSS)]
    return picture(
        report,
        [drawing.side_by_side(3.0, [partial(panel, name) for name in group]) for group in groups],
    )
