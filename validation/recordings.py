"""`python -m validation.recordings info|convert SOURCE`: what a log holds; a log as a recording, a trajectory or a bag."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, cast

import tyro

from validation import cli
from validation.bag_recording import as_group, groups_of_bag
from validation.bags import ENDINGS, Bag, Stamps, Stream, choose_topics, is_bag, read_bag
from validation.dead_reckoning import reckon, with_filter
from validation.profiles import load
from validation.recording import Recording, RecordingError, read_csv, write_csv
from validation.recording_export import write_bag, write_tum
from validation.recording_report import group_table, log_notes, offset_table, reckoning_table, stream_table
from validation.signals import (
    Group,
    aligned,
    cut_groups,
    estimate_offsets,
    find_rest,
    groups_of,
    merge,
    smoothed_groups,
    synchronised,
    unbiased,
)
from validation.simulated_log import is_simulated, simulated_log

FORMATS = (".csv", ".tum", ".mcap", ".bag")
"""What can be written, by ending."""


@dataclass(frozen=True, eq=False)
class Log:
    """A log that was opened."""

    path: Path
    """What the user named."""
    groups: Mapping[str, Group]
    """What it holds."""
    bag: Bag | None = None
    """Where it is a bag."""
    chosen: Mapping[str, Stream] | None = None
    """Which topics were taken for what."""
    faults: Sequence[str] = ()
    """Of topics that were left out for it."""


def open_log(source: str, topics: str, stamps: Stamps, profile: str, seed: int, *, lenient: bool = False) -> Log:
    """What SOURCE means.

    Args:
        source: path of a recording, or a drive to be simulated, such as traj4@mujoco.
        topics: ROLE=TOPIC, comma-separated.
        stamps: which clock of a bag counts.
        profile: of the plant that is driven.
        seed: of its sensors' noise.
        lenient: leave out topics that make no group, and say so in `faults`.

    Raises:
        ValueError: it cannot be opened.
        SsmrError: the plant diverged.
    """
    path, named = Path(source), parse_topics(topics)
    if is_simulated(source):
        return Log(path, simulated_log(source, load(profile), seed))
    if path.suffix.lower() == ".csv" and not path.is_dir():
        if named:
            raise cli.UserError(f"--topics names topics of bags; {source} is a CSV file, whose columns have names")
        return Log(path, groups_of(read_csv(path), path.name))
    if not path.exists() or path.is_dir() or is_bag(path):
        bag = read_bag(path, stamps)
        chosen = choose_topics(bag, named)
        if not lenient:
            return Log(path, groups_of_bag(bag, chosen), bag, chosen)
        groups, faults = {}, []
        for role, stream in chosen.items():
            try:
                groups[role] = as_group(bag, role, stream, "pose" in chosen)
            except RecordingError as error:
                faults.append(str(error))
        return Log(path, groups, bag, chosen, faults)
    raise cli.UserError(f"{source}: recordings are .csv, .bag, .mcap, or the folder of a ROS 2 bag")


def parse_topics(text: str) -> dict[str, str]:
    """`role=/topic,role=/topic` as a mapping.

    Raises:
        UserError: something else.
    """
    found: dict[str, str] = {}
    for part in filter(None, (p.strip() for p in text.split(","))):
        role, equals, topic = (s.strip() for s in part.partition("="))
        if not equals or not topic or role in found:
            raise cli.UserError(
                f"--topics '{part}' is no ROLE=TOPIC of its own, such as odom=/husky_velocity_controller/odom"
            )
        found[role] = topic
    return found


def info(
    source: Annotated[str, tyro.conf.Positional],
    /,
    *,
    topics: str = "",
    stamps: Stamps = "header",
    profile: str = "thesis-lab",
    seed: int = 0,
) -> None:
    """Say what a log holds: topics or columns, rates, gaps, clocks, offsets of time, the gyro's bias, dead reckoning.

    Args:
        source: Path of a recording (.csv, .bag, .mcap, or a ROS 2 bag's folder), or a drive to be simulated and logged, see
            convert.
        topics: What topics are, such as cmd=/cmd_vel,odom=/odom,gps=none; roles are cmd, odom, wheels, imu, pose, gps. What
            is not named is guessed by type.
        stamps: Which clock of a bag counts: that of the header, or that of writing.
        profile: Of the plant, where SOURCE is a drive to be simulated.
        seed: Of its sensors' noise.
    """
    with cli.mistakes_are_users():
        log = open_log(source, topics, stamps, profile, seed, lenient=True)
    name = log.path.name
    tables = [stream_table(log.bag, log.chosen or {}) if log.bag is not None else group_table(name, log.groups)]
    tables += [t for t in (offset_table(estimate_offsets(log.groups)), reckoning_table(reckon(log.groups))) if t is not None]
    for fault in log.faults:
        cli.warn(fault)
    console = cli.report_console()
    for table in tables:
        console.print(table)
    for note in log_notes(log.bag, log.groups, find_rest(log.groups)):
        console.print(note, highlight=False, markup=False)


def convert(
    source: Annotated[str, tyro.conf.Positional],
    /,
    *,
    out: Path | None = None,
    topics: str = "",
    stamps: Stamps = "header",
    rate: float | None = None,
    smooth: float = 0.0,
    align: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    unbias: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    sync: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    ekf: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    start: Annotated[float | None, tyro.conf.arg(name="from")] = None,
    until: float | None = None,
    profile: str = "thesis-lab",
    seed: int = 0,
) -> None:
    """Write a log as a recording (.csv), a TUM trajectory (.tum), a ROS 2 bag (.mcap) or a ROS 1 bag (.bag).

    A recording has one clock; in bags every group keeps its own stamps, unless --rate is given.

    Args:
        source: Path of a recording (.csv, .bag, .mcap, or a ROS 2 bag's folder), or a drive to be simulated and logged:
            traj1 ... traj4 or varied, each with @PLANT.
        out: File to write, its ending says what; runs/recordings/SOURCE.csv if not given.
        topics: What topics are, such as cmd=/cmd_vel,odom=/odom,gps=none; roles are cmd, odom, wheels, imu, pose, gps. What
            is not named is guessed by type.
        stamps: Which clock of a bag counts: that of the header, or that of writing.
        rate: Samples a second [Hz]; by default the log's own.
        smooth: Standard deviation of the Gaussian that smooths what was measured [s]; 0: none.
        align: Let the world begin at the first pose.
        unbias: Take the gyro's mean at rest out.
        sync: Take estimated offsets of time out of what was measured; commands stay.
        ekf: Let the state filter of wheels and gyro fill x, y and yaw.
        start: Leave out what was logged before this time [s].
        until: Leave out what was logged after this time [s].
        profile: Of the plant, where SOURCE is a drive to be simulated.
        seed: Of its sensors' noise.
    """
    with cli.mistakes_are_users():
        target = out or Path("runs") / "recordings" / f"{Path(source).stem}.csv"
        _check(target, rate, smooth, seed)
        log = open_log(source, topics, stamps, profile, seed)
        if target.exists() and log.path.exists() and target.samefile(log.path):
            raise cli.UserError(f"--out {target} is the log itself; name another file")
        offsets = estimate_offsets(log.groups)
        groups = synchronised(log.groups, offsets) if sync else log.groups
        if unbias:
            groups = unbiased(log.path, groups)
        if ekf:
            groups = _filtered(log.path, groups)
        groups = cut_groups(log.path, smoothed_groups(groups, smooth), start, until)
        recording = merge(log.path, groups, rate)
        if align:
            recording = Recording.from_columns(recording.name, aligned(_columns(recording)), recording.gap_factor)
            groups = {name: replace(g, columns=aligned(g.columns)) for name, g in groups.items()}
        if target.suffix.lower() == ".tum" and not recording.has_pose:
            raise cli.UserError(f"{source} has no pose for {target.name}; --ekf makes one of wheels and gyro")
        cli.output_folder(target.parent)
        try:
            _write(recording, groups if rate is None else groups_of(recording, source), target)
        except OSError as error:
            raise cli.UserError(f"--out {target}: the file cannot be written ({error.strerror or error})") from error
    table = offset_table(offsets)
    taken = ["offsets of time were taken out, but for the commands'"] if sync and offsets else []
    cli.report([table] if table is not None else [], [_summary(recording), *taken], [target])


def _check(target: Path, rate: float | None, smooth: float, seed: int) -> None:
    if target.suffix.lower() not in FORMATS:
        raise cli.UserError(f"--out {target}: no format has the ending '{target.suffix}'; there are: {', '.join(FORMATS)}")
    if target.is_dir():
        raise cli.UserError(f"--out {target} is a folder; name a file")
    if rate is not None and not 0.0 < rate < float("inf"):
        raise cli.UserError(f"--rate {rate} must be positive [Hz]")
    if not 0.0 <= smooth < float("inf"):
        raise cli.UserError(f"--smooth {smooth} must not be negative [s]")
    if seed < 0:
        raise cli.UserError(f"--seed {seed} must not be negative")


def _filtered(path: Path, groups: Mapping[str, Group]) -> Mapping[str, Group]:
    found = with_filter(groups)
    if found is None:
        raise RecordingError(path, "--ekf needs wheels or odometry, and with an IMU samples of both at the same time")
    return found


def _columns(recording: Recording) -> dict[str, Any]:
    return {"t": recording.t, **recording.columns, **recording.channels}


def _write(recording: Recording, groups: Mapping[str, Group], target: Path) -> None:
    ending = target.suffix.lower()
    if ending in ENDINGS:
        write_bag(groups, target)
    elif ending == ".tum":
        write_tum(recording, target)
    else:
        write_csv(recording, target)


def _summary(recording: Recording) -> str:
    names = ", ".join((*recording.columns, *recording.channels))
    span = f"{recording.t[0]:.3f} to {recording.t[-1]:.3f} s"
    return f"{len(recording)} samples, {span}, {1.0 / recording.period:.2f} Hz: {names}"


def program() -> Callable[..., Any]:
    """What parses the command line: two subcommands."""
    first = Annotated[Any, tyro.conf.subcommand(name="info", constructor=info)]
    second = Annotated[Any, tyro.conf.subcommand(name="convert", constructor=convert)]
    return cast(Callable[..., Any], first | second)


if __name__ == "__main__":
    cli.run(program(), "python -m validation.recordings")
