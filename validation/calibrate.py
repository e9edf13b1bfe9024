"""From logs to a calibrated robot: `python -m validation.calibrate LOG... --robot R`.

Fits are judged on data that they have not seen.
"""

from __future__ import annotations

if __name__ == "__main__":
    from validation.interrupts import end_quietly

    end_quietly()

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, cast

import tyro

from ssmr.types import CommandKind
from validation import cli, output
from validation.compare import compare
from validation.experiment.gyro import with_gyro
from validation.experiment.scores import band_of
from validation.experiment.sources import Source, source_of, unknown_robot_notes
from validation.files.formats import AnyLog, log_name, profile_of_log
from validation.files.inspection import Inspected, open_log
from validation.files.log import LogFault, ReadOptions
from validation.fit import Fit, Fitted, run_fit, with_band
from validation.identify import verdict
from validation.identify.beginning import FIRST_FITTED
from validation.identify.judging import band_of_one_day, held_out_scores
from validation.identify.report import correlation_table
from validation.identify.targets import (
    Input,
    choose_inputs,
    distinct_names,
    file_of,
    split_ground,
    without_ground,
)
from validation.output import Document, Progress, file_name, one_line, said_once
from validation.plants.profile import Profile, choose_profile
from validation.plants.table import PLANTS
from validation.refitting import ESSENTIAL, fit_widely, settings_of
from validation.report import drawing
from validation.report.comparison import Comparison
from validation.report.motions import interval_table
from validation.report.page import calibration_page
from validation.report.report import FINISHED, INTERRUPTED, Report, Writers
from validation.report.table import Table
from validation.robots import export_robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Calibrate(cli.Common, ReadOptions):
    """Options of `calibrate`."""

    logs: tyro.conf.Positional[AnyLog | Sequence[AnyLog]]
    """Logs of the robot with poses, and with wheel rates, commands or both. Several logs
    are fitted with one body, and each with a localiser (pose source) of its own. Logs written as
    LOG@GROUND share the friction and rolling resistance of that ground."""
    robot: cli.AnyRobot = None
    """Name of a shipped robot, or path of a robot's file (.toml); the profile's if not given."""
    profile: cli.AnyProfile = None
    """Name of a shipped profile, or path of a profile (.toml), from whose numbers fits change what
    the logs tell; if not given, the robot's own numbers, or husky-tile for a Husky."""
    plants: Sequence[str] = (FIRST_FITTED, "mujoco")
    """Plants to calibrate, separated by commas; kinematic is always among them."""
    held_out: AnyLog | None = None
    """Log to judge on, with the mean localiser of the others; it is not among the data that are
    fitted to. If not given, each of several logs judges a fit to the others, and of a single log
    each third of the time in motion."""
    trust: bool = False
    """Fit even where columns seem to have a wrong sign, place, unit or frame."""

    def __post_init__(self) -> None:
        """Take a single log for a list of one, and check the options."""
        if not isinstance(self.logs, tuple | list):
            object.__setattr__(self, "logs", (self.logs,))
        super().__post_init__()
        if not self.logs:
            raise ValueError("no log is named")

    def folder(self) -> Path:
        """Return the folder that the files are written to."""
        return Path("runs") / "calibrate" / self.label

    @property
    def given(self) -> tuple[AnyLog, ...]:
        """The logs as the user gave them."""
        return cast(tuple[AnyLog, ...], self.logs)

    @property
    def names(self) -> tuple[str, ...]:
        """The logs as the user named them."""
        return tuple(map(log_name, self.given))

    @property
    def label(self) -> str:
        """Name of the logs in names of files."""
        label = file_name(Path(self.names[0]).stem)
        return label if len(self.names) == 1 else f"{label}-and-{len(self.names) - 1}"

    def plans(self, inputs: Iterable[Input]) -> list[tuple[str, Input]]:
        """Return the plants and inputs of the fits, in their order."""
        others = [plant for plant in self.plants if plant != FIRST_FITTED]
        return list(product([FIRST_FITTED, *others], inputs))

    def writes(self) -> tuple[str, ...]:
        """Return the names of the files that it writes into its folder."""
        return (*super().writes(), "profile.toml", "diff_drive.yaml", "calibrate.html")


_DRIVEN = {"wheels": "measured wheel rates", "commands": "commands"}


def _fit_label(f: Fitted) -> str:
    """Return a fit's name in tables and sentences."""
    return f"{f.model} driven by {_DRIVEN[f.options['input']]}"


def _as_dict(f: Fitted) -> Document:
    """Return a fit as calibrate.json holds it."""
    numbers = {
        p.name: {"value": p.value, "unit": p.unit, "standard_error": p.standard_error}
        for p in f.parameters
    }
    document = {"input": f.options["input"], "parameters": numbers}
    for when, scored in f.judged.items():
        document[when] = {f"{h:g}": asdict(e) for h, e in scored.overlapping.items()}
    document["better"] = f.better
    return document


def _say_verdict(f: Fitted) -> str:
    """Return a sentence on the errors before and after a fit, and on the numbers that are kept."""
    errors = []
    for scored in f.judged.values():
        assert scored.headline is not None  # fits without windows to judge on were refused
        horizon = scored.headline
        e = scored.overlapping[horizon]
        errors.append(f"{e.position_median_m:.3f} m and {math.degrees(e.yaw_median_rad):.2f} deg")
    kept = "has the new numbers"
    if not f.better:
        kept = f"keeps the old numbers: {f.worse[0].rstrip('.')}"
    return (
        f"{_fit_label(f)}: {errors[1]} off after {horizon:g} s of unseen data, {errors[0]} before. "
        f"profile.toml {kept}."
    )


def _turn_notes(fits: Sequence[Fitted], kept: Comparison) -> list[str]:
    """Return a sentence on each plant that turns worse than the kinematic one, beyond chance.

    Data that no fit has seen judge, and those of `kept` say whether it turns too much or too
    little.
    """
    firsts = {f.options["input"]: f for f in fits if f.model == FIRST_FITTED}
    notes = []
    for f in fits:
        scored = f.judged["after"]
        assert scored.headline is not None
        first = firsts[f.options["input"]]
        now = scored.overlapping[scored.headline]
        was = first.judged["after"].overlapping[scored.headline]
        windows = [f.judged["after"].windows[scored.headline].yaw for f in (first, f)]
        if verdict.is_better(windows[0], windows[1], scored.headline):
            size = f"{now.yaw_median_rad:.3f} rad for {was.yaw_median_rad:.3f}"
            share = verdict.turn_share(with_gyro(kept.source).driven(kept.runs[f.model].motions))
            notes.append(
                f"{_fit_label(f)}: headings are worse than those of {FIRST_FITTED} by more than "
                f"chance, {size}. By {kept.options['input']} it turns {1.0 + share:.3f} times as "
                "much as the robot there."
            )
    return notes


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Calibrated(Report):
    """A calibrated robot."""

    program = "calibrate"
    endings = ("png", "md")
    asked: Calibrate
    """The options."""
    seed: int
    """Seed of the fits."""
    faults: Sequence[LogFault]
    """Faults of the logs."""
    fits: Sequence[Fitted]
    """The fits, in their order."""
    kept: Comparison
    """The simulations along the last part that judged the fits, by the fits that had not seen
    it."""
    judged_on: str
    """What judged the fits, in words."""
    days: Sequence[Document]
    """What each of several logs tells alone of the tyres, see `verdict.tyre_row`."""

    @property
    def profile(self) -> Profile:
        """The profile with all numbers that are better than those of before."""
        profile = self.fits[-1].profile
        return replace(profile, name=file_name(f"{profile.robot.name}-{self.asked.label}"))

    def files(self) -> Writers:
        """Return functions that write the two parameter files, the page and the picture."""
        drive = export_robot(self.profile.robot, "diff-drive", self.profile, self.drive_errors())
        return {
            "profile.toml": self.profile.save,
            "diff_drive.yaml": lambda path: output.write_text(path, drive),
            **super().files(),
            "calibrate.html": lambda path: output.write_text(path, self.page()),
        }

    def drive_errors(self) -> dict[str, float]:
        """Return standard errors of the numbers of diff_drive.yaml, of those that were fitted."""
        robot = self.profile.robot
        share = self.profile.section(FIRST_FITTED).vehicle.wheel_radius / robot.wheel_radius
        sums = {
            "wheel_separation_multiplier": {"y_l": 1.0 / robot.track, "y_r": -1.0 / robot.track},
            "left_wheel_radius_multiplier": {"alpha_l": share},
            "right_wheel_radius_multiplier": {"alpha_r": share},
        }
        fit = self.fits[0]
        errors = {name: fit.error_of(weights) for name, weights in sums.items() if fit.better}
        return {name: error for name, error in errors.items() if math.isfinite(error)}

    def tables(self) -> list[Table]:
        """Return the errors before and after each fit, and the fitted numbers."""
        errors = []
        values = []
        for f in self.fits:
            label = _fit_label(f)
            values.append(replace(f.values("parameter", "before"), title=f"{label}, fitted"))
            for when, scored in f.judged.items():
                errors += [(h, f"{label}, {when}", e) for h, e in scored.overlapping.items()]
        table = interval_table(sorted(errors, key=lambda each: each[0]), "numbers")
        title = "Error of the relative pose on unseen data, and how sure that is"
        return [replace(table, title=title), *values, *verdict.tyre_tables(self.days)]

    def page(self) -> str:
        """Return everything that its user wants to know as one HTML page, the verdict first."""
        tables = self.tables()
        for k, f in enumerate(self.fits):
            title = f"{_fit_label(f)}, correlations"
            tables.insert(2 * k + 2, correlation_table(title, f.parameters, f.correlation))
        return calibration_page(self, self.kept, tables, [fault.sentence for fault in self.faults])

    def verdict(self) -> str:
        """Return which fits are better on data that they have not seen, and what judged them."""
        better = ", ".join(_fit_label(f) for f in self.fits if f.better)
        words = [f"profile.toml has new numbers of {better}: better on unseen data."] * bool(better)
        for f in self.fits:
            if not f.better:
                why = " ".join(f.worse) or "nothing judges it."
                words.append(f"It keeps the old numbers of {_fit_label(f)}: {why}")
        words.append(f"That is a verdict on {self.judged_on}; what is written was fitted to all.")
        return " ".join(words)

    def notes(self) -> list[str]:
        """Return the remarks, a verdict on each fit, and the fits' notes."""
        notes = [*super().notes(), *map(_say_verdict, self.fits)]
        notes += [*_turn_notes(self.fits, self.kept), *verdict.change_sentences(self.days)]
        # the first note of a fit that is no better says so, and the verdict does too
        notes += said_once({_fit_label(f): f.notes()[not f.better :] for f in self.fits})
        return [*map(one_line, dict.fromkeys(notes))]

    def document(self) -> Document:
        """Return the document of calibrate.json without its tables."""
        plants: dict[str, Document] = {}
        for f in self.fits:
            entry = _as_dict(f)
            # a plant's second fit is that of its driver
            if plants.setdefault(f.model, entry) is not entry:
                plants[f.model]["commands"] = entry
        return {
            "schema": "ssmr.calibrate/1",
            "log": ",".join(self.asked.names),
            "robot": self.profile.robot.name,
            "seed": self.seed,
            "judged_on": self.judged_on,
            "written_from": "all",
            "faults": list(map(asdict, self.faults)),
            "days": self.days,
            "plants": plants,
        }

    def figure(self) -> Figure:
        """Draw the errors by horizon before and after each fit, and the verdicts."""
        marks = []
        for s in self.fits:
            marker = "s" if s.options["input"] == "wheels" else "o"
            for when, scored in s.judged.items():
                ink = drawing.ink_of(s.model, 0.5 * (when == "before"))
                label = f"{_fit_label(s)}, {when}"
                look: Document = {"label": label, "color": ink, "marker": marker}
                marks.append((scored.overlapping, look))
        legend = [drawing.key_line(**look) for _, look in marks]
        panels = [partial(drawing.draw_horizons, marks, part) for part in ("position", "yaw")]
        verdicts = list(map(_say_verdict, self.fits))
        row = drawing.PanelRow(3.6, panels)
        return drawing.draw_page(self.title, [row], legend=legend, notes=verdicts)


@cli.make_program(Calibrate)
def calibrate(o: Calibrate) -> Calibrated:
    """Calibrate a robot from a log: name its faults, fit, and judge the fits on unseen data.

    Body and pose source are fitted from wheel rates, the driver from commands. Writes profile.toml,
    diff_drive.yaml for ros2_control, calibrate.md, calibrate.png and calibrate.json.

    Raises:
        ValueError: a name or file that cannot be used, or columns that contradict one another.
        SsmrError: a plant diverged.
    """
    if unknown := [name for name in o.plants if name not in PLANTS]:
        raise ValueError(f"unknown plant '{unknown[0]}'; there are: {', '.join(PLANTS)}")
    profile = choose_profile(o.profile, o.robot, profile_of_log(o.names[0]))
    robot = profile.robot
    open_one = partial(open_log, options=o, radius=robot.wheel_radius)
    names = distinct_names("calibrate", o.given)
    opened = dict(zip(names, map(open_one, map(without_ground, o.given)), strict=True))
    held = dict[str, Inspected]()
    if o.held_out is not None:
        name = log_name(o.held_out)
        if file_of(name) in map(file_of, names):
            raise ValueError(f"{name} is fitted to as a whole; it cannot be held out as well")
        held[name] = open_one(without_ground(o.held_out))
    notes: list[str] = []
    faults: list[LogFault] = []
    inputs: list[Input] = ["wheels", "commands"]
    for name, inspected in opened.items():
        found = inspected.faults
        opened[name], own, own_notes = choose_inputs(inspected, o.trust, cli.warn_user)
        inputs = [each for each in inputs if each in own]
        faults += found
        sentences = [*(fault.sentence for fault in found), *own_notes]
        notes += [f"{inspected.log.name}: {sentence}" for sentence in sentences]
    if not inputs:
        raise ValueError("no input, wheel rates or commands, is in all logs")
    kinds: dict[Input, CommandKind] = {"wheels": "wheels", "commands": "twist"}
    folds = {each: verdict.divide_logs(opened, held, kinds[each]) for each in inputs}
    if o.profile is None and o.robot is None:
        whole = source_of(opened[names[0]], split_ground(names[0])[0], kinds[inputs[0]])
        unknown = unknown_robot_notes(whole, robot)
        for warning in unknown[1:]:
            cli.warn_user(warning)
        notes += unknown
    fits, unseeing = _fit_all(o, profile, folds)
    first = folds[inputs[0]]
    unseen = first[_judge_of(first)][1][0]
    kept = compare(
        replace(unseen, name=split_ground(unseen.name)[0]),
        unseeing,
        tuple(dict.fromkeys(f.model for f in fits)),
        input=inputs[0],
        bands=True,
        seed=o.seed,
    )
    with_logs = ", ".join(Path(name).name for name in o.names)
    return Calibrated(
        kept=kept,
        title=one_line(f"{robot.title or robot.name}, calibrated with {with_logs}"),
        options={"plants": o.plants, "held_out": next(iter(held), None), "trust": o.trust},
        status=fits[-1].status if len(fits) == len(o.plans(inputs)) else INTERRUPTED,
        asked=o,
        seed=o.seed,
        faults=faults,
        fits=fits,
        remarks=notes,
        judged_on=verdict.describe_judges(len(opened), [*held]),
        days=_watch_tyres(folds["wheels"][-1][0], profile) if "wheels" in folds else (),
    )


def _watch_tyres(logs: Sequence[Source], profile: Profile) -> list[Document]:
    """Return what each of several logs tells alone of the tyres, by the kinematic plant."""
    rows = []
    for log in logs if len(logs) > 1 else ():
        options = Fit(FIRST_FITTED, [log], profile, input="wheels", search="lsq")
        found = run_fit(options, lambda warning: None)
        numbers = {p.name: p.value for p in found.parameters}
        radius = found.plant.vehicle.wheel_radius
        rows.append(verdict.tyre_row(Path(log.name).name, numbers, found.error_of, radius))
    return rows


def _fit_all(
    o: Calibrate, profile: Profile, folds: Mapping[Input, Sequence[verdict.Fold]]
) -> tuple[list[Fitted], Profile]:
    """Return the fits, each begun with the profile of the one before, and an unseeing profile.

    Each fold has a profile of its own, which has seen nothing of what judges it; that of the last
    part that judges is returned. The last fit may have been interrupted.

    Raises:
        KeyboardInterrupt: it was interrupted before anything was judged.
    """
    fits: list[Fitted] = []
    plans = o.plans(folds)
    profiles = [profile] * len(folds[plans[0][1]])
    known: dict[tuple[str, str], list[Fitted]] = {}
    for plant, kind in plans:
        done: list[Fitted] = []
        for k, (train, _) in enumerate(folds[kind]):
            begun = len(fits) * len(profiles) + k
            show = partial(_show_part, o, begun / len(profiles), len(plans), f"{plant} by {kind}")
            settings = settings_of(known, (plant, kind), k, done)
            options = Fit(
                plant,
                train,
                profiles[k],
                input=kind,
                seed=o.seed,
                workers=o.workers,
                progress=show,
                **settings,
            )
            done.append(fit_widely(options))
            if k == _judge_of(folds[kind]) and o.held_out is None:
                done[k] = with_band(done[k])
            if done[-1].status != FINISHED and k + 1 < len(profiles):
                if not fits:
                    raise KeyboardInterrupt
                return fits, profiles[_judge_of(folds[kind])]
        known[plant, kind] = done
        fits.append(_judge_fits(o, done, folds[kind]))
        if fits[-1].better:
            profiles = [each.profile for each in (*done[:-1], fits[-1])]
        if fits[-1].status != FINISHED:
            break
    return fits, profiles[_judge_of(folds[plans[0][1]])]


def _judge_of(folds: Sequence[verdict.Fold]) -> int:
    """Return the number of the last fold that has a judge."""
    return max(k for k, (_, judges) in enumerate(folds) if judges)


def _show_part(o: Calibrate, begun: float, parts: int, lead: str, now: Progress) -> None:
    """Show the progress of one fit of several, `begun` of the `parts` after others."""
    share = min(now.done / max(now.total, 1.0), 1.0)
    o.progress(Progress(begun + share, parts, f"{lead}: {now.text}"))


def _judge_fits(o: Calibrate, done: Sequence[Fitted], folds: Sequence[verdict.Fold]) -> Fitted:
    """Return the last of some fits, as all of them are judged by what each has not seen.

    Its bands are those of the errors there, unless a log was held out.
    """
    judges = []
    for f, (_, sources) in zip(done, folds, strict=True):
        judges.append((f.problem, f.course.best, sources))
    before, after, judged, driven, notes = held_out_scores(judges)
    f = done[-1]
    if not any(scores.windows for scores in after.values()):
        raise ValueError(
            f"{', '.join(o.names)}: nothing is left to judge on; name a log with --held-out"
        )
    objections = verdict.list_objections(judged, driven, f.options["input"])
    at_bound = [p.name for p in f.parameters if p.at_bound and p.name in ESSENTIAL]
    if at_bound:
        objections.append(f"{' and '.join(at_bound)} ended at a bound, so another cause is likely")
    band = None
    # a log that is held out judges, and nothing that is written comes from it
    if o.held_out is None:
        band = band_of(driven, True) if len(o.names) > 1 else band_of_one_day(judges)
    return replace(
        with_band(f, band),
        held_out=after,
        unfitted=before,
        judged=judged,
        objections=[f"{'; '.join(objections)}."] * bool(objections),
        remarks=[*f.remarks, *notes],
    )


if __name__ == "__main__":
    calibrate.main()
