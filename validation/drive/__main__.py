"""The command line `python -m validation.drive`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from ssmr.errors import SsmrError
from validation import cli
from validation.simulator.terrain import FLAT
from validation.words import visible


@dataclass(frozen=True)
class HandOptions(cli.Filmed):
    """The options of `python -m validation.drive`."""

    robot: cli.AnyRobot = None
    profile: Annotated[cli.AnyProfile, cli.profile_option("thesis-lab")] = None
    plants: Annotated[cli.Names, cli.option(metavar="PLANT,...", default="the planar models")] = ()
    """Plants that run beside the MuJoCo robot, separated by commas; `mujoco` for none."""
    terrain: cli.Ground = FLAT
    until: Annotated[cli.Number, cli.option(metavar="SECONDS", default="until the window is closed")] = None
    """Time after which the drive ends."""
    keys: Annotated[Path | None, cli.option(metavar="FILE", default="a window")] = None
    """Script of keys, to drive without a window and without waiting: lines `TIME KEY ...`, such as 2.5 up up left, or
    `TIME M/S RAD/S`."""

    def folder(self) -> Path:
        """Return the folder that the files are written to."""
        return Path("runs") / "drive"


def main(options: HandOptions) -> None:
    """Drive a robot by hand in MuJoCo's viewer, in real time, with the other plants beside it as ghosts.

    Every press of an arrow is a tenth of the greatest speed or yaw rate; enter goes straight on, space stops. A gamepad's
    sticks do as well.

    The drive ends when the window is closed, or with Ctrl-C. It is written as drive.csv, with noise of the sensors, which
    compare and fit take; and all plants are compared over it. Of a drive that is killed, unsaved.keys stays, for --keys.
    """
    from validation.drive.hands import read_keys
    from validation.drive.run import drive_by_hand, prepare_drive, unused
    from validation.drive.window import NoWindowError
    from validation.plants.table import USUAL_PLANTS

    folder = options.out or options.folder()
    with cli.mistakes_are_users():
        options.check()
        if options.until is not None and not options.until > 0.0:
            raise cli.UserError(f"--until {options.until:g} s must be positive")
        script = None
        if options.keys is not None:
            try:
                script = read_keys(options.keys.read_text(encoding="utf-8").splitlines())
            except (OSError, ValueError) as error:
                raise cli.UserError(f"--keys {options.keys}: {getattr(error, 'strerror', None) or error}") from error
        prepared = prepare_drive(
            options.profile, options.plants or USUAL_PLANTS, options.seed, robot=options.robot,
            terrain=options.terrain,
        )  # fmt: skip
    cli.output_folder(folder)
    for left in sorted({*folder.glob("unsaved*.keys")} - {options.keys}):
        cli.warn(
            f"a drive was killed before it was saved; --keys {visible(left)} drives it again, and then you can delete it"
        )
    journal = unused(folder, "unsaved.keys")
    try:
        driven = drive_by_hand(
            prepared,
            math.inf if options.until is None else options.until,
            script,
            journal=journal if script is None else None,
        )
    except NoWindowError as error:
        raise cli.UserError(str(error)) from error
    recording = driven.write_recording(folder)
    journal.unlink(missing_ok=True)
    try:
        with cli.shown("comparing") as progress:
            comparison = driven.compare(options.workers, progress)
    except BaseException:
        cli.warn(f"the drive is saved as {visible(recording)}, and was not compared")
        raise
    if driven.dropped:
        cli.warn(f"the drive took {driven.dropped:.1f} s longer than its log says: this machine is too slow for real time")
    which = "".join(f" --{k} {visible(v)}" for k, v in (("profile", options.profile), ("robot", options.robot)) if v)
    which = which or f" --profile {prepared.profile.name}"
    ground = "" if options.terrain == FLAT else f" --terrain {visible(options.terrain.spec)}"
    print(f"next: ssmr compare {visible(recording)}{which}{ground}, or ssmr fit improved --to {visible(recording)}{which}")
    cli.finish(comparison, options, folder, recording)
    if driven.failure:
        raise SsmrError(f"the drive ended before this: {driven.failure}")
    if driven.interrupted:
        raise KeyboardInterrupt


PROGRAM = main

if __name__ == "__main__":
    cli.leave_out("pandas")
    cli.run(PROGRAM, "python -m validation.drive")
