"""From a log to a calibrated robot, judged on what the fit has not seen: `python -m validation.calibrate LOG --robot R`."""

from __future__ import annotations

if __name__ == "__main__":
    from validation.interrupts import end_quietly

    end_quietly()

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Annotated, Any, get_args

import tyro
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ssmr.types import CommandKind
from validation import cli, store
from validation.bench.sources import open_source, stranger_sentences
from validation.files.agreement import LogFault
from validation.files.faults import Faults, find_faults
from validation.files.formats import log_path, profile_of_log, read_log
from validation.files.log import COMMAND_COLUMNS, Log, ReadOptions
from validation.fit import Fitted, Scored, fit
from validation.identify.targets import Input
from validation.plants.kind import SEEN
from validation.plants.profile import Profile, choose_profile
from validation.plants.searchable import find
from validation.plants.table import PLANTS, SIMULATED
from validation.progress import Progress
from validation.report import drawing
from validation.report.motions import HEADLINE_HORIZON, interval_table
from validation.report.report import FINISHED, Report
from validation.robots import export_robot
from validation.words import file_name, one_line

REFUSED = ("sign", "swapped", "scale", "handedness")
"""Kinds of faults with which no fit makes sense."""
TRAINED = 2.0 / 3.0
"""Share of a log that is fitted to, from its beginning, where no other log is held out [1]."""
FIRST_FITTED = "kinematic"
"""Others begin with what this plant says of pose source, wheels and driver."""
# share of time without a command in which wheels may turn [1]; beyond it commands say little
_UNCOMMANDED = 0.05
_DRIVER = (
    "command_radius",
    "command_half_track",
    "delay",
    "acceleration_v",
    "acceleration_w",
    "wheel_lag",
)
BODY = (*SEEN, "wheel_radius", "radius_difference")
"""Numbers that `begin_at` takes for a body with wheels of its own."""


@dataclass(frozen=True)
class Calibrate(cli.Common):
    """Options of `calibrate`."""

    log: Annotated[str | Path, cli.text_of("LOG"), tyro.conf.Positional]
    """Log of the robot with poses, and with wheel rates, commands or both."""
    robot: cli.AnyRobot = None
    profile: Annotated[
        cli.AnyProfile, cli.profile_option("the robot's own numbers, or husky-tile for a Husky")
    ] = None
    plants: Annotated[cli.Names, cli.option(metavar="PLANT,...", default="kinematic,mujoco")] = (
        FIRST_FITTED,
        "mujoco",
    )
    """Plants to calibrate, separated by commas; kinematic is always among them."""
    held_out: Annotated[
        str | Path | None, cli.option(metavar="LOG", default="the last third of the log")
    ] = None
    """Log to judge on; then the first one is fitted as a whole."""
    columns: cli.Columns = field(default_factory=dict)
    trust: cli.Flag = False
    """Fit even where columns seem to have a wrong sign, place, unit or frame."""

    def folder(self) -> Path:
        """Return the folder that the files are written to."""
        return Path("runs") / "calibrate" / file_name(Path(self.log).stem)

    def writes(self) -> tuple[str, ...]:
        """Return the names of the files that it writes into its folder."""
        return (*super().writes(), "profile.toml", "diff_drive.yaml")


def _label(f: Fitted) -> str:
    return f"{f.model} by {f.options['input']}"


def _scores(f: Fitted) -> dict[str, Scored]:
    return {"before": f.unfitted[0], "after": f.held_out[0]}


def _as_dict(f: Fitted) -> dict[str, Any]:
    numbers = {
        p.name: {k: getattr(p, k) for k in ("value", "unit", "standard_error")}
        for p in f.parameters
    }
    errors = {
        when: {f"{h:g}": asdict(e.summary()) for h, e in s.windows.items()}
        for when, s in _scores(f).items()
    }
    return {"input": f.options["input"], "parameters": numbers, **errors, "better": f.better}


def _verdict(f: Fitted) -> str:
    errors = []
    for scored in _scores(f).values():
        horizon = min(scored.windows, key=lambda h: abs(h - HEADLINE_HORIZON))
        e = scored.windows[horizon].summary()
        errors.append(f"{e.position_median_m:.3f} m and {math.degrees(e.yaw_median_rad):.2f} deg")
    kept = "has the new numbers" if f.better else "keeps the old numbers: the fit is no better"
    return f"{_label(f)}: {errors[1]} off after {horizon:g} s of new data, {errors[0]} before. profile.toml {kept}."


@dataclass(frozen=True, eq=False, kw_only=True)
class Calibrated(Report):
    """A calibrated robot."""

    profile: Profile
    """The profile with all numbers that are better than those of before."""
    fits: Sequence[Fitted]
    """The fits, in their order."""

    def files(self, recording: bool) -> dict[str, Callable[[Path], object]]:
        """Return functions that write its files: profile.toml, diff_drive.yaml, the page and the picture."""
        drive = export_robot(self.profile.robot, "diff-drive", self.profile)
        return {
            "profile.toml": self.profile.save,
            "diff_drive.yaml": lambda path: store.write_text(path, drive),
            **super().files(recording),
        }


@cli.program(Calibrate)
def calibrate(o: Calibrate) -> Calibrated:
    """Calibrate a robot from a log: first what the log says wrongly, then fits with a verdict on data they have not seen.

    Body and pose source are fitted from wheel rates, the driver from commands. Writes profile.toml,
    diff_drive.yaml for ros2_control, calibrate.md, calibrate.png and calibrate.json.

    Raises: ValueError: a name or file that cannot be used, or a log whose columns contradict one
        another. SsmrError: a plant diverged.
    """
    if unknown := [name for name in o.plants if name not in PLANTS]:
        raise ValueError(f"unknown plant '{unknown[0]}'; there are: {', '.join(PLANTS)}")
    name = str(o.log)
    profile = choose_profile(o.profile, o.robot, profile_of_log(name))
    read = ReadOptions(columns=o.columns, radius=profile.robot.geometry.wheel_radius)
    log = read_log(log_path(o.log), read)
    faults = find_faults(log, read.radius)
    inputs, notes = _inputs(o, log, faults)
    t = log.on_one_clock().t
    until = None if o.held_out is not None else float(t[0] + TRAINED * (t[-1] - t[0]))
    if o.profile is None and o.robot is None:
        kind: CommandKind = "wheels" if inputs[0] == "wheels" else "twist"
        notes += stranger_sentences(open_source(name, kind, options=read), profile.robot)
    sources = logging.getLogger("validation.bench.sources")
    sources.disabled = True  # what is wrong with a log is said once, in the notes
    try:
        fits = _fits(o, profile, inputs, until)
    finally:
        sources.disabled = False
    return _report(o, fits, faults.named, notes)


def _fits(
    o: Calibrate, profile: Profile, inputs: Sequence[Input], until: float | None
) -> list[Fitted]:
    """Return the fits, each begun with the profile of the one before; the last one may have been interrupted."""
    fits = list[Fitted]()
    track = profile.robot.geometry.track
    plans = list(
        product([FIRST_FITTED, *(plant for plant in o.plants if plant != FIRST_FITTED)], inputs)
    )
    for k, (plant, kind) in enumerate(plans):
        settings: dict[str, Any] = {}
        if driver := kind == "commands" and len(inputs) == 2:
            settings = {
                "free": _DRIVER,
                "bounds": {"command_half_track": (0.2 * track, 1.5 * track)},
            }
        if plant in SIMULATED:
            settings |= {
                "search": "lsq",
                "start": begin_at(plant, _DRIVER if driver else BODY, profile),
            }

        def show(now: Progress, k: int = k, what: str = f"{plant} by {kind}") -> None:
            o.progress(
                Progress(
                    k + min(now.done / max(now.total, 1.0), 1.0), len(plans), f"{what}: {now.text}"
                )
            )

        done = fit(
            plant, str(o.log), profile, input=kind, until=until, held_out=(str(o.held_out or o.log),),
            seed=o.seed, workers=o.workers, progress=show, columns=o.columns, **settings,
        )  # fmt: skip
        if not (done.held_out and done.held_out[0].windows):
            raise ValueError(
                f"{o.log}: nothing is left to judge on; name another log with --held-out"
            )
        fits.append(done)
        profile = done.profile
        if done.status != FINISHED:
            break
    return fits


def _inputs(o: Calibrate, log: Log, faults: Faults) -> tuple[list[Input], list[str]]:
    """Return what can drive plants along a log, and a note where something cannot; a ValueError refuses a faulty log."""
    if not o.trust and (refused := [fault for fault in faults.named if fault.kind in REFUSED]):
        for fault in faults.named:
            cli.warn(f"{log.name}: {fault.sentence}")
        named = ", ".join(dict.fromkeys(column for fault in refused for column in fault.columns))
        raise ValueError(f"{log.name}: look at {named} first; --trust calibrates all the same")
    often = (faults.uncommanded_share or 0.0) > _UNCOMMANDED
    columns = {
        "wheels": log.has(COMMAND_COLUMNS["wheels"]),
        "commands": log.has(COMMAND_COLUMNS["twist"]) and not often,
    }
    if inputs := [name for name in get_args(Input)[::-1] if columns[name]]:
        return inputs, [
            "The wheels often turn without a command, so the driver was not fitted."
        ] * often
    raise ValueError(
        f"{log.name} has neither wheel rates, enc_left and enc_right, nor commands that drive it"
    )


def begin_at(plant: str, free: Sequence[str], profile: Profile) -> dict[str, float]:
    """Return what the baseline's numbers say of a simulated plant's, within its bounds, to begin a fit with."""
    section = profile.section(FIRST_FITTED)
    radius = section.vehicle.wheel_radius
    p = section.parameters
    numbers = {
        "wheel_radius": 0.5 * radius * (p.alpha_l + p.alpha_r),
        "radius_difference": radius * (p.alpha_l - p.alpha_r),
    }
    of_first = [find(FIRST_FITTED, name, section.robot) for name in free if name not in numbers]
    numbers |= {s.name: s.read(section) for s in of_first}
    return {
        s.name: min(max(numbers[s.name], s.lower), s.upper)
        for s in (find(plant, name, section.robot) for name in free)
    }


def _report(
    o: Calibrate, fits: Sequence[Fitted], faults: Sequence[LogFault], notes: Sequence[str]
) -> Calibrated:
    plants: dict[str, dict[str, Any]] = {}
    for f in fits:
        if plants.setdefault(f.model, entry := _as_dict(f)) is not entry:
            plants[f.model]["commands"] = entry
    profile = fits[-1].profile
    faulty = [f"The log: {fault.sentence}." for fault in faults]
    remarks = [f"{_label(s)}: {note}" for s in fits for note in s.notes()[not s.better :]]
    errors = [
        (h, f"{_label(s)}, {w}", e.summary())
        for s in fits
        for w, one in _scores(s).items()
        for h, e in one.windows.items()
    ]
    table = interval_table(sorted(errors, key=lambda each: each[0]), "numbers")
    title = "Error of the relative pose on data that no fit has seen, and how sure that is"
    values = (replace(s.values("parameter", "before"), title=f"{_label(s)}, fitted") for s in fits)
    return Calibrated(
        program="calibrate",
        title=one_line(f"{profile.robot.title or profile.robot.name}, calibrated with {Path(o.log).name}"),
        tables=[replace(table, title=title), *values],
        document={"schema": "ssmr.calibrate/1", "log": str(o.log), "robot": profile.robot.name, "seed": o.seed,
                  "faults": [asdict(fault) for fault in faults], "plants": plants},
        draw=_draw,
        sentences=[one_line(n) for n in dict.fromkeys([*faulty, *(_verdict(s) for s in fits), *notes, *remarks])],
        options={"plants": o.plants, "held_out": None if o.held_out is None else str(o.held_out), "trust": o.trust},
        status=fits[-1].status,
        has_text=True,
        profile=replace(profile, name=file_name(f"{profile.robot.name}-{Path(o.log).stem}")),
        fits=tuple(fits),
    )  # fmt: skip


def _draw(c: Calibrated) -> Figure:
    marks = [
        drawing.HorizonMarks(
            f"{_label(s)}, {when}", drawing.ink_of(s.model) if when == "after" else drawing.BESIDE_INK,
            "s" if s.options["input"] == "wheels" else "o", one.horizons, {h: e.summary() for h, e in one.windows.items()},
        )
        for s in c.fits
        for when, one in _scores(s).items()
    ]  # fmt: skip

    handles = [Line2D([], [], color=m.ink, marker=m.marker) for m in marks]
    header = partial(
        drawing.draw_header, title=c.title, handles=handles, labels=[m.name for m in marks]
    )
    panels = [
        partial(drawing.draw_horizons, marks, "position"),
        partial(drawing.draw_horizons, marks, "yaw"),
    ]
    rows = [drawing.text_row(0.6, header), drawing.side_by_side(3.6, panels)]
    return drawing.put_together([*rows, *drawing.note_rows([_verdict(s) for s in c.fits])])


if __name__ == "__main__":
    calibrate.main()
