"""Look into a log of a robot, clean it, convert it.

On the command line: `python -m validation.recordings info|convert SOURCE`.
"""

from __future__ import annotations

if __name__ == "__main__":
    from validation.interrupts import end_quietly

    end_quietly()

import filecmp
import inspect
import math
import re
import shlex
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro

from ssmr.types import FloatArray
from validation import cli
from validation.descriptions.loading import load_robot
from validation.files.columns import COLUMNS, COMMAND_COLUMNS, POSE_COLUMNS
from validation.files.formats import (
    AnyLog,
    check_apart,
    format_of_target,
    log_name,
    write_log,
)
from validation.files.inspection import REST_LEAST, Inspected, open_log, unbiased
from validation.files.log import Log, LogFault, ReadOptions
from validation.files.names import as_option
from validation.files.offsets import Offset, lateness_of_first, take_out_offsets, why_without_stamps
from validation.files.reading import FileError, exists, read_file
from validation.files.sensors import Signals
from validation.output import Document, file_name, make_folder, write_json
from validation.report.columns import DEGREES, Unit
from validation.report.report import Report
from validation.report.table import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_OURS = b'"ssmr.info/1"'
"""Text in files that are replaced unasked, for this program wrote them."""
_MOST_OURS = 1 << 26
"""Greatest size of such a file [bytes]."""


# --- options ---


@dataclass(frozen=True)
class LogOptions(cli.Options, ReadOptions):
    """Options by which a log is opened, whatever is done with it."""

    source: tyro.conf.Positional[AnyLog]
    """Path of a log (.csv, .bag, .mcap, or the folder of a ROS 2 bag), or a shipped one: sample,
    husky or warthog."""
    _: KW_ONLY
    robot: cli.AnyRobot = None
    """Name of a shipped robot, or path of a robot's file (.toml)."""
    overwrite: bool = False
    """Replace a file that is there already."""
    config: cli.AnyPath = None
    """JSON file of a run of this program: its options hold where no others are given."""

    @property
    def radius(self) -> float | None:
        """Radius of the robot's wheels [m]; None where no robot is named."""
        return None if self.robot is None else load_robot(self.robot).wheel_radius

    def opened(self) -> Inspected:
        """Return the log, to be looked at."""
        return open_log(self.source, self, self.radius)

    def words(self) -> str:
        """Return the log and how it is read, as a command line has them."""
        topics = ",".join(f"{role}={topic}" for role, topic in self.topics.items())
        said = {"topics": topics, "columns": as_option(self.columns)}
        if self.ticks_per_turn:
            said["ticks-per-turn"] = f"{self.ticks_per_turn:g}"
        words = [shlex.quote(log_name(self.source))]
        words += [f"--{name} {shlex.quote(text)}" for name, text in said.items() if text]
        return " ".join(words)


@dataclass(frozen=True, kw_only=True)
class Info(LogOptions):
    """Options of `info`."""

    json: cli.AnyPath = None
    """JSON file to write the findings into as well."""
    out: cli.AnyPath = None
    """Folder for the findings, info.json, and for a picture of the log part by part, info.png."""

    def targets(self) -> list[Path]:
        """Return the files that are asked for."""
        out = [] if self.out is None else [Path(self.out, f"info.{end}") for end in ("json", "png")]
        return out if self.json is None else [Path(self.json), *out]


@dataclass(frozen=True, kw_only=True)
class Convert(LogOptions):
    """Options of `convert`."""

    out: cli.AnyPath = None
    """File to write; its ending says in which format. If not given, runs/recordings/SOURCE.csv."""
    rate: float | None = None
    """Samples a second, where it is another rate than the log's own."""
    unbias: bool = False
    """Take out the gyro's mean at rest."""
    sync: bool = False
    """Take estimated offsets of time out of the measurements; commands keep the robot's delay."""
    since: cli.Since = None
    """Leave out what was logged before this time."""
    until: float | None = None
    """Leave out what was logged after this time."""

    def targets(self) -> list[Path]:
        """Return the file that is asked for, if one is."""
        return [] if self.out is None else [Path(self.out)]

    def __post_init__(self) -> None:
        """Raise a ValueError for a rate that is not positive."""
        super().__post_init__()
        if self.rate is not None and not 0.0 < self.rate < math.inf:
            raise ValueError(f"rate {self.rate} must be positive [Hz]")


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class LogReport(Report):
    """Contents of a log, or a log in another form."""

    program = "recordings"
    endings = ()
    inspected: Inspected
    """The log as it was opened, and what it shows."""
    log: Log
    """The log that is written: the same one, or a new one whose signals share one clock."""

    def figure(self) -> Figure:
        """Return its picture: the log part by part."""
        return _draw_parts(self.title, self.inspected.parts, self.inspected.faults)

    def write(self, path: str | Path) -> None:
        """Write the file that it is for, whole or not at all.

        The folder of `path` is made if it is missing.

        Raises:
            ValueError: `path` is a folder, the log itself or a part of it, or cannot hold it.
            OSError: the file cannot be written.
        """
        path = Path(path)
        check_apart(path, self.log.path)
        path.parent.mkdir(parents=True, exist_ok=True)
        if not self.about:
            write_log(self.log, path)
        elif path.suffix == ".png":
            self.save_picture(path)
        else:
            write_json(path, self.as_dict())


# --- programs ---


@cli.make_program(Info)
def info(o: Info) -> LogReport:
    """Report what a log contains.

    Prints topics or columns, rates, gaps, faults, time offsets and the gyro's bias.

    Raises:
        ValueError: the log cannot be opened.
    """
    found = o.opened()
    log = found.log
    rows = [
        {"fault": f.kind, "columns": ", ".join(f.columns), "what": f.sentence} for f in found.faults
    ]
    faults = Table("Faults", rows, "These are not what their names say.")
    notes = [*log.remarks, *_log_sentences(found), *found.sentences(), *found.lacks]
    uses = _name_uses(found)
    if "yes" in uses and found.unsolved:
        uses += "; correct the faults first"
    return LogReport(
        title=log.path.name,
        inspected=found,
        log=log,
        shown=[
            faults,
            _contents_table(log),
            _offset_table(found.offsets),
            _parts_table(found.parts),
        ],
        remarks=[*notes, _next_step(o, found), uses],
        about=_log_document(found),
    )


def _log_document(found: Inspected) -> Document:
    """Findings as the JSON file has them."""
    log = found.log
    offsets = found.offsets
    rest = found.rest
    groups = {}
    for name, group in log.groups.items():
        groups[name] = {
            "source": group.source,
            "samples": len(group.t),
            "rate_hz": 1.0 / group.period,
            "from_s": group.t[0],
            "to_s": group.t[-1],
            "columns": list(group.columns),
            "gaps_s": group.gaps(),
        }
    # a signal that others are behind has no delay, unless it is late itself
    seconds = {offset.behind: 0.0 for offset in offsets}
    for offset in offsets:
        seconds[offset.late] = offset.seconds
    jumps = found.jumps
    taken = [topic for topic in log.topics if topic.role]
    clock = "columns"
    if taken:
        clock = "written" if all(topic.remark for topic in taken) else "header"
    return {
        "schema": "ssmr.info/1",
        "source": str(log.path),
        "groups": groups,
        "chosen": _chosen_signals(log),
        "good_for": found.good_for(),
        "lacks": list(found.lacks),
        "clock": clock,
        "offsets_s": {name: seconds.get(name) for name in ("wheels", "pose_yaw", "position")},
        "offsets": [asdict(offset) for offset in offsets],
        "pose_jumps": None if jumps is None else len(jumps.t),
        "pose_catches_up": None if jumps is None else jumps.caught_up,
        "pose_jumps_at_s": None if jumps is None else jumps.t.tolist(),
        "pose_jumps_m": None if jumps is None else jumps.metres.tolist(),
        "pose_jumps_rad": None if jumps is None else jumps.radians.tolist(),
        "uncommanded_share": found.uncommanded_share,
        "dead_columns": list(found.dead_columns),
        "faults": [asdict(fault) for fault in found.faults],
        "gyro_at_rest": rest,
        "parts": found.parts,
    }


_WHAT = {
    "pose": POSE_COLUMNS,
    "wheels": COMMAND_COLUMNS["wheels"],
    "commands": COMMAND_COLUMNS["twist"],
    "gyro": ("gyro_z",),
}


def _chosen_signals(log: Log) -> dict[str, str | None]:
    """Return the topic or the columns that were taken for each kind of signal; None without one."""
    chosen = dict[str, str | None]()
    for what, names in _WHAT.items():
        group = log.group_of(names)
        chosen[what] = None
        if group is not None:
            chosen[what] = group.source if log.topics else ", ".join(names)
    return chosen


@cli.make_program(Convert)
def convert(o: Convert) -> LogReport:
    """Write a log as .csv, or its poses as .tum, a trajectory for evo.

    Offsets of time, bias, cutting, one clock: that is the order of changes.

    Raises:
        ValueError: the log cannot be opened, does not hold what a change needs, or does not fit
            into the file.
    """
    if o.out is not None:
        format_of_target(o.out)
    inspected = o.opened()
    log = inspected.log
    if o.sync:
        log = take_out_offsets(inspected, inspected.offsets)
    if o.unbias:
        log = unbiased(log, inspected.rest)
    merged = log.cut(o.since, o.until).on_one_clock(o.rate)
    t = merged.t
    rate = 1.0 / next(iter(merged.groups.values())).period
    columns = ", ".join(merged.columns)
    notes = [f"{len(t)} samples, {t[0]:.3f} to {t[-1]:.3f} s, {rate:.2f} Hz: {columns}"]
    if o.sync and inspected.offsets:
        notes.append(
            "offsets of time were taken out of the measurements; commands keep the robot's delay"
        )
    return LogReport(
        title=log.path.name,
        inspected=inspected,
        log=merged,
        shown=[_offset_table(inspected.offsets)],
        remarks=notes,
    )


# --- tables and sentences ---


_LATITUDE = re.compile("(?i)(?=.*?([^, ]*lat[^, ]*))(?=.*?([^, ]*lon[^, ]*))")
"""Names of columns of which one is a latitude and one is a longitude."""


def _next_step(o: LogOptions, found: Inspected) -> str:
    log = found.log
    path = o.words()
    name = getattr(o.robot, "name", o.robot) or "ROBOT"
    if any(fault.kind == "circular" for fault in found.unsolved):
        return "next: take the pose of a localiser, by --topics pose=/NAME or --columns"
    if found.unsolved:
        return (
            "next: correct the faults in the log, for every comparison and fit believes its columns"
        )
    if missing := [name for name in POSE_COLUMNS if not log.has((name,))]:
        moving = (name for name, values in log.columns.items() if np.ptp(values) > 0.0)
        others = ", ".join(name for name in moving if name not in COLUMNS)
        remedy = ""
        if others:
            unit = "radians" if missing[0] == "yaw" else "metres"
            remedy = f"; if one of {others} is {missing[0]} in {unit}, --columns {missing[0]}=NAME "
            remedy += "says so"
        if missing[0] == "x" and (place := _LATITUDE.match(others)):
            remedy = place.expand(r"; --columns x=\2+\1:deg,y=\1+\2:deg makes metres of degrees")
        return (
            f"there is no {', '.join(missing)}, so no prediction of a pose can be judged"
            f"{remedy}; {_without_pose(found)}"
        )
    if found.lacks:
        return "next: drive what is missing, for a fit to this log would not be determined"
    if log.has(COMMAND_COLUMNS["wheels"]):
        return f"next: python -m validation.calibrate {path} --robot {name}"
    if not log.has(COMMAND_COLUMNS["twist"]) and not log.has(("odom_v", "odom_w")):
        return (
            "there are neither wheel rates nor commands, "
            "so nothing says how to drive a simulation; record one of them"
        )
    return f"next: python -m validation.compare {path} --robot {name} --input commands"


_USES = ("wheels", "commands", "gyro")


def _name_uses(found: Inspected) -> str:
    """Return the signals for which a log is good enough, and how late the robot follows."""
    good = found.good_for()
    words = {name: f"{name} {'yes' if good[name] else 'no'}" for name in _USES}
    if good["commands"]:
        words["commands"] += _delay_of_commands(found)
    part = found.sound_part
    only = f"; calibrate takes {part[0]:.1f} to {part[1]:.1f} s alone" if part is not None else ""
    return f"good enough to fit or to check by: {', '.join(words.values())}{only}"


def _delay_of_commands(found: Inspected) -> str:
    """Return how late the robot follows, in brackets; nothing where that is not found."""
    why = why_without_stamps(found.log)
    first = lateness_of_first(found.offsets)
    seconds = [offset.seconds + first for offset in found.offsets if offset.late == "cmd"]
    if not seconds:
        return f" (how late the robot follows cannot be told: {why})" if why else ""
    if seconds[0] > 0.0:
        return f" (stamped {seconds[0]:.2f} s after the robot obeyed)"
    # late writing of the others moves commands without stamps ahead
    less = ", less the time that writing took" if why else ""
    return f" (the robot follows {-seconds[0]:.2f} s later{less})"


def _without_pose(signals: Signals) -> str:
    """Return the effective track by wheels and gyro, as a sentence on a log without a pose."""
    gyro = signals.means.get("gyro_z")
    if gyro is None or signals.wheels is None:
        return "with a gyro and wheel rates, how the robot turns could be said"
    left, right = signals.wheels
    # least squares of right - left over the yaw rate
    ratio = (right - left) @ gyro / (gyro @ gyro)
    return (
        f"gyro and wheels say that right less left is {ratio:.2f} times the yaw rate: "
        f"an effective track of {ratio:.2f} wheel radii, "
        "such as for wheel_separation of a driver"
    )


def _contents_table(log: Log) -> Table:
    rows = []
    for topic in log.topics:
        columns = "not read" if topic.columns is None else ", ".join(topic.columns)
        row = {"topic": topic.name, "type": topic.type.rpartition("/")[2], **_sampling_row(topic.t)}
        rows.append({**row, "taken for": topic.role or "–", "columns": columns})
    if not rows:
        for name, group in log.groups.items():
            columns = ", ".join(group.columns)
            rows.append({"group": name, **_sampling_row(group.t), "columns": columns})
    return Table(log.path.name, rows)


_SIZES = {
    "wheel_radius_left": "radius_left_m",
    "wheel_radius_right": "radius_right_m",
    "half_track": "half_track_m",
    "delay_s": "delay_s",
}
"""Columns of the table of parts, by their keys."""


def _parts_table(parts: Sequence[Document]) -> Table:
    rows = []
    for part in parts:
        row = {"from_s": part["from_s"], "to_s": part["to_s"]}
        row |= {column: part[key] for key, column in _SIZES.items()}
        rows.append(row | part["residuals"])
    caption = (
        "Each part alone. Radii and half-track are those with which the wheels tell its motion; "
        "behind them is what is left over of each signal beside the others, over its noise."
    )
    digits = {"from_s": 0, "to_s": 0, "radius_left_m": 4, "radius_right_m": 4, "half_track_m": 3}
    units = {name: Unit(name[-1], 1.0, n) for name, n in digits.items()}
    units |= {"delay_s": Unit("s", 1.0, 3)}
    units |= {name: Unit("1", 1.0, 2) for row in rows for name in row if name not in units}
    return Table("Part by part", rows, caption, units=units)


def _draw_parts(title: str, parts: Sequence[Document], faults: Sequence[LogFault]) -> Figure:
    """Draw what each part tells over time: radii, half-track, delay and residuals."""
    from validation.report import drawing

    if not parts:
        raise ValueError("the log has no parts that signals could be compared in")
    t = [part["from_s"] for part in parts] + [parts[-1]["to_s"]]
    panels = {
        "wheel radius [m]": {
            side: [part[f"wheel_radius_{side}"] for part in parts] for side in ("left", "right")
        },
        "half-track [m]": {"": [part["half_track"] for part in parts]},
        "delay of headings [s]": {"": [part["delay_s"] for part in parts]},
        "left over, of the noise": {
            name: [part["residuals"][name] for part in parts] for name in parts[0]["residuals"]
        },
    }

    def draw(label: str, ax: Axes) -> None:
        for name, values in panels[label].items():
            heights = np.array([math.nan if each is None else each for each in values])
            ax.stairs(heights, t, baseline=None, label=name or None, linewidth=1.5)
        ax.set_ylabel(label)
        if len(panels[label]) > 1:
            ax.legend(fontsize="small", ncols=len(panels[label]))

    rows = [drawing.PanelRow(1.8, [partial(draw, label)]) for label in panels]
    return drawing.draw_page(title, rows, notes=[fault.sentence for fault in faults])


def _sampling_row(t: FloatArray) -> Document:
    period = np.median(np.diff(t)) if len(t) > 1 else 0.0
    rate = 1.0 / period if period > 0.0 else math.nan
    start, stop = (float(t[0]), float(t[-1])) if len(t) and t[-1] > t[0] else (math.nan, math.nan)
    return {"samples": len(t), "rate_Hz": rate, "from_s": start, "to_s": stop}


def _offset_table(offsets: Sequence[Offset]) -> Table:
    rows = []
    for o in offsets:
        # what leads is what the other one is behind
        late, behind = (o.late, o.behind) if o.seconds >= 0.0 else (o.behind, o.late)
        rows.append(
            {
                "signal": late,
                "behind": behind,
                "late_s": abs(o.seconds),
                "correlation": o.correlation,
                "standard_error_s": o.standard_error,
            }
        )
    units = {
        "late_s": Unit("s", 1.0, 4),
        "standard_error_s": Unit("s", 1.0, 4),
        "correlation": Unit("1", 1.0, 3),
    }
    caption = "Delays come from comparing yaw rates; for position, speeds."
    return Table("Offsets of time", rows, caption, units=units)


def _log_sentences(found: Inspected) -> list[str]:
    notes = []
    log = found.log
    rest = found.rest
    # several groups may come from one source
    gaps_by_source = {group.source: group.gaps() for group in log.groups.values()}
    for source, gaps in gaps_by_source.items():
        if gaps:
            start, end = gaps[0]
            number = f"{len(gaps)} gap{'s' * (len(gaps) > 1)}"
            notes.append(f"{source}: {number}, the first from {start:.3f} to {end:.3f} s")
    if rest is not None:
        notes.append(
            f"gyro at rest, {rest['seconds']:.1f} s in all: mean {rest['bias']:+.5f} rad/s "
            f"({DEGREES.text(rest['bias'])}°/s), standard deviation {rest['std']:.5f} rad/s"
        )
    elif "imu" in log.groups:
        notes.append(
            f"gyro: its bias is unknown, because the wheels never stand for {REST_LEAST:g} s in all"
        )
    return notes


# --- the command line ---


def _make_command(program: cli.Program[Any, Any]) -> Callable[[Any], None]:
    """Return the function behind a subcommand, which writes its file.

    A conversion that names none has one in runs/recordings.
    """

    def main(o: Any) -> None:
        source = log_name(o.source)
        named = o.targets()
        for target in named:
            check_apart(target, source)
            cli.require_writable(target.parent)
        if isinstance(o, Info) and o.out is not None:
            make_folder(Path(o.out))
        report = program.run(o)
        for target in named if not o.overwrite else ():
            _require_free(target, report)
        default = [Path("runs", "recordings", f"{file_name(Path(source).stem)}.csv")]
        written = named or default * isinstance(o, Convert)
        for target in written:
            report.write(target)
        cli.report_result(report, written)

    main.__doc__ = inspect.getdoc(program.function)
    main.__name__ = program.__name__
    main.__annotations__ = {"o": Annotated[program.options, tyro.conf.arg(name="")]}
    return main


def _require_free(path: Path, report: LogReport) -> None:
    """Refuse to replace a file that says something else, and was not written by `info`.

    A picture was, if the findings beside it were.
    """
    findings = path.with_suffix(".json") if path.suffix == ".png" else path
    if not exists(path) or (exists(findings) and _OURS in read_file(findings, _MOST_OURS)):
        return
    with tempfile.TemporaryDirectory() as folder:
        beside = Path(folder) / path.name
        report.write(beside)
        # as where the same command was interrupted behind its file
        if filecmp.cmp(path, beside, shallow=False):
            return
    raise FileError(
        path, "there is such a file already; name another, or replace it by --overwrite"
    )


PROGRAM = {"info": _make_command(info), "convert": _make_command(convert)}

if __name__ == "__main__":
    cli.run_command(PROGRAM, "python -m validation.recordings")
