"""`python -m validation.recordings info|convert SOURCE`: what a log holds; a log as a recording, a trajectory or a bag."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, cast

import tyro

from validation import cli
from validation.logs.bags import Stamps
from validation.logs.dead_reckoning import reckon
from validation.logs.recording import Recording
from validation.logs.signals import (
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
from validation.recordings.report import group_table, log_notes, offset_table, reckoning_table, stream_table
from validation.recordings.run import _check, _columns, _filtered, _summary, _write, open_log


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


def program() -> Callable[..., Any]:
    """What parses the command line: two subcommands."""
    first = Annotated[Any, tyro.conf.subcommand(name="info", constructor=info)]
    second = Annotated[Any, tyro.conf.subcommand(name="convert", constructor=convert)]
    return cast(Callable[..., Any], first | second)


if __name__ == "__main__":
    cli.run(program(), "python -m validation.recordings")
