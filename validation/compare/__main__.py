"""The command line `python -m validation.compare SOURCE`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from validation import cli
from validation.logs.limits import USUAL
from validation.words import file_name


@dataclass(frozen=True)
class RecordingOptions:
    """Options that matter only where SOURCE is a recording."""

    input: Annotated[Literal["commands", "wheels"], cli.option()] = "commands"
    """Signal of the recording that drives the plants: its commands, or its measured wheel rates."""
    horizons: Annotated[cli.Numbers, cli.option()] = (2.0, 6.0, 30.0, 60.0)
    """Times after which the poses of plant and recording are compared [s]."""
    start: Annotated[cli.Number, cli.option("from", metavar="SECONDS", default="the beginning")] = None
    """Leave out what was recorded before this time [s]."""
    until: Annotated[cli.Number, cli.option(metavar="SECONDS", default="the end")] = None
    """Leave out what was recorded after this time [s]."""
    limits: cli.Limits = USUAL


@dataclass(frozen=True)
class Environment:
    """Options that make the simulated world less perfect."""

    noise: cli.Flag = False
    """See the plants through the lab's state filter: at 50 Hz, with its noise."""
    disturbance: cli.Flag = False
    """Push all plants with the same random yaw acceleration."""
    terrain: Annotated[str, cli.option(metavar="GROUND")] = "flat"
    """Ground under the MuJoCo robot: flat, ramp:DEG, rough:MM or split:RATIO; see docs/terrain.md for more keys."""


@dataclass(frozen=True)
class CompareOutput(cli.Output):
    """Options for what is written and shown."""

    out: Annotated[Path | None, cli.out_option("runs/compare/SOURCE; on a terrain SOURCE-TERRAIN")] = None


@dataclass(frozen=True)
class CompareOptions:
    """The options of `python -m validation.compare`."""

    source: Annotated[str, tyro.conf.Positional, cli.option(metavar="SOURCE")]
    """Motion to drive: traj1 to traj4, traj4@improved for how that plant drives it, or the path of a recording."""
    robot: cli.RobotName = None
    profile: Annotated[str | None, cli.profile_option("thesis-lab for scenarios, husky-tile for recordings")] = None
    plants: Annotated[cli.Names, cli.option(metavar="PLANT,...", default="mujoco and the planar models")] = ()
    """Plants to drive, separated by commas, such as mujoco,improved; `all` adds four_wheel. A wrong name lists all names."""
    reference: Annotated[
        str | None, cli.option(metavar="PLANT", default="mujoco for a scenario, the recording itself for a recording")
    ] = None
    """Plant to compare the others with."""
    recording: RecordingOptions = RecordingOptions()
    environment: Environment = Environment()
    run: cli.Run = field(default_factory=cli.Run)
    output: CompareOutput = CompareOutput()

    def folder(self) -> Path:
        """Return the folder that the files are written to."""
        ground = "" if self.environment.terrain == "flat" else "-" + self.environment.terrain.replace(":", "-")
        return self.output.out or Path("runs") / "compare" / file_name(Path(self.source).stem + ground)


def main(options: CompareOptions) -> None:
    """Drive every plant with the same commands and compare each with the reference.

    Prints tables and writes compare.json, compare.png and compare.rrd.
    """
    from validation.compare.run import CompareSettings, prepare
    from validation.plants.table import PLANTS, USUAL_PLANTS
    from validation.simulator.terrain import parse_terrain

    log, environment, output = options.recording, options.environment, options.output
    plants = PLANTS if options.plants == ("all",) else options.plants or USUAL_PLANTS
    with cli.mistakes_are_users():
        output.check()
        settings = CompareSettings(
            log.input, log.horizons, log.start, log.until, environment.noise, environment.disturbance,
            options.run.seed, parse_terrain(environment.terrain), log.limits,
        )  # fmt: skip
        prepared = prepare(options.source, options.profile, plants, options.reference, settings, robot=options.robot)
    with cli.shown("comparing") as progress:
        comparison = prepared.run(options.run.workers, progress)
    folder = cli.output_folder(options.folder())
    written = comparison.save(folder, recording=not output.no_rerun)
    for result in comparison.plants.values():
        if result.health is not None and result.health.advice:
            cli.warn(f"{result.name}: {result.health.advice}")
    cli.report_result(comparison, written)
    output.draw(comparison)
    output.show(folder / "compare.rrd")


PROGRAM = main

if __name__ == "__main__":
    cli.leave_out("pandas")
    cli.run(PROGRAM, "python -m validation.compare")
