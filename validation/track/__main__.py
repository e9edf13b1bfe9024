"""The command line `python -m validation.track CONTROLLER REFERENCE`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from ssmr.control.loop import Feedback
from validation import cli
from validation.simulator.terrain import parse_terrain
from validation.track.run import TrackSettings, prepare_tracking
from validation.words import file_name


def _read_start(text: str) -> tuple[float, float, float]:
    try:
        x, y, yaw = map(float, text.split(","))
    except ValueError as error:
        raise cli.UserError(f"'{text}' is no pose X,Y,YAW [m, m, rad] such as 0,0.5,0.52") from error
    return x, y, yaw


def _read_shares(text: str) -> tuple[float, float]:
    try:
        left, right = map(float, text.split(","))
    except ValueError as error:
        raise cli.UserError(f"'{text}' is no pair of shares LEFT,RIGHT such as 0.02,0") from error
    return left, right


@dataclass(frozen=True)
class LawOptions:
    """Options of the controller and of what it sees."""

    own: Annotated[str | None, cli.option("controller", metavar="FILE.py:NAME", default="none")] = None
    """A controller of your own, in the place of CONTROLLER: a class in a Python file, which is run."""
    gains: Annotated[
        str | None,
        cli.option(
            metavar="GAINS",
            default="the profile's own if shipped, else published where the thesis has any, else tuned, else default",
        ),
    ] = None
    """Gains of the controller: published, manual (lqr only), tuned, default (the law's own), those of a profile by its name
    (husky-tile, warthog-grass), or the path of a TOML file."""
    feedback: Annotated[Feedback, cli.option()] = "noisy"
    """Signal that the controller sees: the truth; the truth with the lab's noise (Tab. 3.4); or the estimate of a state
    filter (EKF) on noisy encoders and gyro."""
    filter: Annotated[str, cli.option(metavar="thesis|commissioned|learning|FILE.toml")] = "thesis"
    """State filter of --feedback ekf: the thesis'; one that is commissioned by simulated drives, knows the robot's constants
    and learns how they change; one that is learning on a robot that nobody has commissioned; or that of a TOML file, such as
    filter.toml beside the results of such a run."""
    lookahead: Annotated[float, cli.option(metavar="METRES")] = 0.0
    """Distance at which the robot keeps behind its target (Sec. 4.5)."""
    start: Annotated[tuple[float, float, float], cli.parsed(_read_start, "X,Y,YAW"), cli.option(default="0,0,0")] = (
        0.0,
        0.0,
        0.0,
    )
    """Pose at which the robot starts, seen from the start of the reference: ahead [m], to the left [m], yaw [rad], such as
    0,0.5,0.52."""


@dataclass(frozen=True)
class World:
    """Options of the simulated world."""

    no_noise: cli.Flag = False
    """Switch noise and disturbance off: the controller sees the truth."""
    no_disturbance: cli.Flag = False
    """Do not push the robot's yaw at random (Sec. 3.4.5)."""
    gyro_bias: Annotated[float, cli.option(metavar="RAD/S")] = 0.0
    """Reading of the gyro at rest, of which no filter is told; one that learns listens for 5 s before the robot drives. It
    needs --feedback ekf."""
    missed_ticks: Annotated[
        tuple[float, float], cli.parsed(_read_shares, "LEFT,RIGHT"), cli.option(default="0,0, sound encoders")
    ] = (0.0, 0.0)
    """Damaged encoders: the share of their ticks that those of the left and of the right side miss (Sec. 4.5), such as
    0.02,0. It needs --feedback ekf, which alone reads the encoders."""
    terrain: Annotated[str, cli.option(metavar="GROUND")] = "flat"
    """Ground that the MuJoCo robot stands on: flat, ramp:SLOPE_DEG, rough:HEIGHT_MM or split:FRICTION_RATIO, with more keys
    as in validation.compare."""


@dataclass(frozen=True)
class TrackOutput(cli.Output):
    """Options for what is written and shown."""

    out: Annotated[Path | None, cli.out_option("runs/track/CONTROLLER-REFERENCE")] = None


@dataclass(frozen=True)
class TrackOptions:
    """The options of `python -m validation.track`."""

    controller: Annotated[str, tyro.conf.Positional, cli.option(metavar="CONTROLLER")]
    """Controller: pid and lqr are those of the thesis; lqr-scheduled (linearised about the operating speed) and smc (sliding
    mode) go beyond it. With +predictor behind its name, such as lqr+predictor, a law acts on the state one dead time ahead;
    mpc plans ahead within the limits."""
    reference: Annotated[str | None, tyro.conf.Positional, cli.option(metavar="REFERENCE", default="none")] = None
    """Path to follow: line, circle, sine, generic, eight, slalom, square, spiral, u-turn, stop-and-go, long-line, each also
    with its speed, as eight@0.5; or a file of waypoints (.csv: x, y[, t]). Waypoints at one place are a wait."""
    speed: Annotated[cli.Number, cli.option(metavar="M/S", default="the times of the file; 0.25 for a named reference")] = (
        None
    )
    """Mean speed between waypoints [m/s]. It replaces the times of a file."""
    plant: Annotated[cli.Names, cli.option(metavar="PLANT,...")] = ("improved",)
    """Plant that is the robot. Several, separated by commas, are driven one beside the other; the first one is the one that
    track.json reports."""
    robot: cli.RobotName = None
    profile: Annotated[str | None, cli.profile_option("thesis-lab")] = None
    control: LawOptions = LawOptions()
    environment: World = World()
    run: cli.Run = field(default_factory=cli.Run)
    output: TrackOutput = TrackOutput()


def main(options: TrackOptions) -> None:
    """Let a robot follow a reference under a controller.

    Prints tables and writes track.json, track.png and track.rrd, also for a robot that was lost; then the exit status is 1.
    """
    control, world, output = options.control, options.environment, options.output
    with cli.mistakes_are_users():
        output.check()
        controller, reference = cli.controller_and_reference(options.controller, options.reference, control.own)
        settings = TrackSettings(
            options.speed,
            "truth" if world.no_noise else control.feedback,
            not (world.no_noise or world.no_disturbance),
            control.lookahead,
            parse_terrain(world.terrain),
            options.run.seed,
            options.robot,
            control.start,
            control.filter,
            world.gyro_bias,
            world.missed_ticks,
        )
        asked = prepare_tracking(controller, reference, options.plant, options.profile, control.gains, settings)
    for remark in asked.remarks:
        cli.warn(remark)
    with cli.shown("tracking") as progress:
        tracked = asked.run(options.run.workers, progress)
    stem = file_name(f"{asked.controller.name}-{asked.label}")
    folder = cli.output_folder(output.out or Path("runs") / "track" / stem)
    cli.report_result(tracked, tracked.save(folder, recording=not output.no_rerun))
    output.draw(tracked)
    output.show(folder / "track.rrd")
    tracked.require_kept()


PROGRAM = main

if __name__ == "__main__":
    cli.run(PROGRAM, "python -m validation.track")
