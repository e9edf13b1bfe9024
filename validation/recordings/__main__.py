"""The command line `python -m validation.recordings info|convert SOURCE`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from validation import cli
from validation.logs.formats import check_apart
from validation.logs.limits import USUAL
from validation.logs.log import ReadOptions, Stamps
from validation.recordings.run import ConvertSettings, commission_log, convert, info
from validation.recordings.simulated_log import LogSettings
from validation.words import file_name


@dataclass(frozen=True)
class LogOptions:
    """Options for reading a log; topics and stamps are those of a ROS bag."""

    topics: Annotated[cli.Topics, cli.option(default="guessed from the message types")] = field(default_factory=dict)
    """Topic of each role, such as cmd=/cmd_vel,odom=/odom,gps=none. Roles are cmd, odom, wheels, imu, pose and gps."""
    stamps: Annotated[Stamps, cli.option()] = "header"
    """Clock that counts: header, when a message was measured; or bag, when it was written."""
    limits: cli.Limits = USUAL

    def reading(self) -> ReadOptions:
        """Return the options as the library takes them."""
        return ReadOptions(self.topics, self.stamps, limits=self.limits)


@dataclass(frozen=True)
class SimulationOptions:
    """The robot, and options that matter only where SOURCE is a drive to be simulated."""

    robot: Annotated[
        str | None, cli.option(metavar="ROBOT", default="the profile's; for dead reckoning on a log a stock Husky")
    ] = None
    """Name of a shipped robot, or path of a robot's file (.toml)."""
    profile: Annotated[str | None, cli.profile_option("thesis-lab")] = None
    seed: cli.Seed = 0
    missed_left: Annotated[cli.Number, cli.option(metavar="SHARE", default="0")] = None
    """Share of their ticks that damaged encoders of the left side miss (Sec. 4.5)."""
    missed_right: Annotated[cli.Number, cli.option(metavar="SHARE", default="0")] = None
    """Share of their ticks that damaged encoders of the right side miss (Sec. 4.5)."""
    swing: Annotated[cli.Number, cli.option(metavar="METRES", default="0")] = None
    """Amplitude of an oscillation of the localiser that is no motion of the robot (Sec. 4.5)."""
    swing_hz: Annotated[cli.Number, cli.option(metavar="HZ", default="1")] = None
    """Frequency of that oscillation."""

    def faults(self) -> LogSettings:
        """Return the faults of the simulated log as the library takes them."""
        asked = {name: getattr(self, name) for name in ("missed_left", "missed_right", "swing", "swing_hz")}
        return LogSettings(**{name: value for name, value in asked.items() if value is not None})


LogSource = Annotated[
    str,
    tyro.conf.Positional,
    cli.option(
        metavar="SOURCE",
        help="Path of a recording (.csv, .bag, .mcap, or the folder of a ROS 2 bag), or a drive to be simulated and logged: "
        "traj1, traj2, traj3, traj4 or varied, each with @PLANT.",
    ),
]


@dataclass(frozen=True)
class InfoOptions:
    """The options of `info`."""

    source: LogSource
    json: Annotated[Path | None, cli.option(metavar="FILE", default="none")] = None
    """JSON file to write the findings into as well."""
    filter: Annotated[str, cli.option(metavar="thesis|learning|FILE.toml")] = "learning"
    """State filter beside the thesis' in the table of dead reckoning: one that is learning on a robot that nobody has
    commissioned, or that of a file, which commission writes."""
    bag: LogOptions = field(default_factory=LogOptions)
    simulation: SimulationOptions = SimulationOptions()


@dataclass(frozen=True)
class ChangeOptions(ConvertSettings):
    """Changes that are made to the log."""

    rate: Annotated[cli.Number, cli.option(metavar="HZ", default="the log's own")] = None
    smooth: Annotated[float, cli.option(metavar="SECONDS", default="0, no smoothing")] = 0.0
    align: cli.Flag = False
    unbias: cli.Flag = False
    sync: cli.Flag = False
    ekf: cli.Flag = False
    filter: Annotated[str, cli.option(metavar="thesis|learning|FILE.toml")] = "thesis"
    """State filter for --ekf."""
    gps_std: Annotated[float, cli.option(metavar="METRES", default="0, no GPS")] = 0.0
    """Standard deviation of GPS positions, which --ekf takes in by their stamps; --sync takes out their delay."""
    start: Annotated[float | None, cli.option("from", metavar="SECONDS", default="the beginning")] = None
    stop: Annotated[float | None, cli.option("until", metavar="SECONDS", default="the end")] = None


@dataclass(frozen=True)
class ConvertOptions:
    """The options of `convert`."""

    source: LogSource
    out: Annotated[Path | None, cli.option(metavar="FILE", default="runs/recordings/SOURCE.csv")] = None
    """File to write; its ending says in which format."""
    changes: ChangeOptions = ChangeOptions()
    bag: LogOptions = field(default_factory=LogOptions)
    simulation: SimulationOptions = SimulationOptions()


@dataclass(frozen=True)
class CommissionOptions:
    """The options of `commission`."""

    source: LogSource
    out: Annotated[Path | None, cli.option(metavar="FILE", default="runs/recordings/SOURCE.toml")] = None
    """TOML file to write the filter into."""
    bag: LogOptions = field(default_factory=LogOptions)
    simulation: SimulationOptions = SimulationOptions()


def _info(options: InfoOptions) -> None:
    """Report what a log contains.

    Prints topics or columns, rates, gaps, faults, time offsets and the gyro's bias.

    Compares dead reckoning on the log with the positions in it.
    """
    bag, simulation = options.bag, options.simulation
    with cli.mistakes_are_users():
        if options.json is not None:
            check_apart(options.json, options.source)
        found = info(
            options.source,
            bag.reading(),
            simulation.profile,
            simulation.seed,
            robot=simulation.robot,
            faults=simulation.faults(),
            filter=options.filter,
        )
    for fault in found.log.faults:
        cli.warn(fault)
    if options.json is not None:
        with cli.writes("--json", options.json):
            found.save(options.json)
    cli.report_result(found, [] if options.json is None else [options.json])


def _convert(options: ConvertOptions) -> None:
    """Write a log in another format: .csv, .tum, .mcap or .bag.

    A .tum file is a trajectory for evo, .mcap a ROS 2 bag, .bag a ROS 1 bag.

    Bags keep the stamps of every group of columns, unless --rate is given.
    """
    bag, changes, simulation = options.bag, options.changes, options.simulation
    target = options.out or Path("runs") / "recordings" / f"{file_name(Path(options.source).stem)}.csv"
    with cli.mistakes_are_users():
        converted = convert(
            options.source,
            changes,
            bag.reading(),
            simulation.profile,
            simulation.seed,
            target,
            robot=simulation.robot,
            faults=simulation.faults(),
        )
        with cli.writes("--out", target):
            converted.save(target)
    cli.report_result(converted, [target])


def _commission(options: CommissionOptions) -> None:
    """Write a state filter that knows the robot of a log, from its wheels and the poses of a better sensor.

    Offsets of time are taken out first. Use the file with --filter, on other drives.
    """
    o, simulation = options, options.simulation
    target = o.out or Path("runs") / "recordings" / f"{file_name(Path(o.source).stem)}.toml"
    with cli.mistakes_are_users():
        check_apart(target, o.source)
        made = commission_log(o.source, o.bag.reading(), simulation.profile, simulation.seed, robot=simulation.robot)
        with cli.writes("--out", target):
            made.save(target)
    print(f"{made.name}: {made.sentence()}\nwritten: {target}")


PROGRAM: Mapping[str, Callable[[Any], None]] = {"info": _info, "convert": _convert, "commission": _commission}

if __name__ == "__main__":
    cli.run(PROGRAM, "python -m validation.recordings")
