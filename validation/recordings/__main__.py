"""`python -m validation.recordings info|convert SOURCE`: what a log holds; a log as a recording, a trajectory or a bag."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, cast

import tyro

from validation import cli
from validation.logs.formats import writable
from validation.logs.log import ReadOptions, Stamps
from validation.recordings.run import ConvertSettings
from validation.recordings.run import convert as convert_log
from validation.recordings.run import info as look_into
from validation.show.tables import rich_table


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
        found = look_into(source, ReadOptions(parse_topics(topics), stamps), profile, seed)
    for fault in found.log.faults:
        cli.warn(fault)
    console = cli.report_console()
    for grid in found.grids():
        console.print(rich_table(grid))
    for note in found.notes():
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
    target = out or Path("runs") / "recordings" / f"{Path(source).stem}.csv"
    with cli.mistakes_are_users():
        if target.suffix.lower() not in writable():
            known = ", ".join(writable())
            raise cli.UserError(f"--out {target}: no format has the ending '{target.suffix}'; there are: {known}")
        settings = ConvertSettings(rate, smooth, align, unbias, sync, ekf, start, until)
        converted = convert_log(source, settings, ReadOptions(parse_topics(topics), stamps), profile, seed)
        try:
            converted.save(target)
        except OSError as error:
            raise cli.UserError(f"--out {target}: the file cannot be written ({error.strerror or error})") from error
    cli.report(map(rich_table, converted.grids()), converted.notes(), [target])


def parse_topics(text: str) -> dict[str, str]:
    """Return `role=/topic,role=/topic` as a mapping.

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


def program() -> Callable[..., Any]:
    """What parses the command line: two subcommands."""
    first = Annotated[Any, tyro.conf.subcommand(name="info", constructor=info)]
    second = Annotated[Any, tyro.conf.subcommand(name="convert", constructor=convert)]
    return cast(Callable[..., Any], first | second)


if __name__ == "__main__":
    cli.run(program(), "python -m validation.recordings")
