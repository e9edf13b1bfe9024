"""`python -m validation.track CONTROLLER REFERENCE`: a closed loop around any plant, held against its reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import tyro

from ssmr.closed_loop import Feedback, LoopSettings
from ssmr.controllers.laws import CONTROLLERS
from validation import cli, store
from validation.gains import DEFAULT, load_gains, names
from validation.profiles import PLANTS, load
from validation.results import TrackResult
from validation.terrain import parse_terrain
from validation.track_report import as_document, track_notes, track_tables
from validation.tracking import Robot, make_controller, make_robot, odometry_of, require_practicable, track
from validation.waypoint_files import open_reference

DEFAULT_SPEED = 0.25
"""Of the named references [m/s]; the slower of the thesis' two."""
NAMED = ("line", "circle", "sine", "generic")


def default_gains(controller: str) -> str:
    """`published` where the thesis has gains for that controller, else `tuned`, else the defaults of the law."""
    there = names(controller)
    return next((name for name in ("published", "tuned") if f"{controller}-{name}" in there), DEFAULT)


def main(
    controller: Annotated[str, tyro.conf.Positional, cli.one_of(CONTROLLERS)],
    reference: Annotated[str, tyro.conf.Positional],
    /,
    *,
    speed: float | None = None,
    plant: str = "improved",
    profile: str = "thesis-lab",
    gains: str | None = None,
    feedback: Feedback = "noisy",
    no_noise: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    no_disturbance: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    lookahead: float = 0.0,
    terrain: str = "flat",
    seed: int = 0,
    workers: int | None = None,
    out: Path | None = None,
    view: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    no_rerun: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
) -> None:
    """Let a robot follow a reference under a controller.

    Prints tables and writes track.json, track.png and track.rrd.

    Args:
        controller: pid and lqr are the thesis'; lqr-scheduled (linearised about the operating speed) and smc (sliding mode)
            go beyond it.
        reference: line, circle, sine, generic, or a file of waypoints (.csv, .xlsx: x, y[, t]).
        speed: Mean speed between waypoints [m/s]; 0.25 for named references. A file with times needs none, and a speed
            replaces them.
        plant: Which plant is the robot; several, comma-separated, are driven one beside the other, and the first is the one
            that track.json reports.
        profile: Name of a shipped profile or path of a TOML file.
        gains: published, manual (lqr), tuned, or the path of a TOML file; published where the thesis has any, else
            tuned, else default (the law's own).
        feedback: What the controller sees: truth, noisy (with the lab's noise, Tab. 3.4), or ekf (a state filter on noisy
            encoders and gyro).
        no_noise: No noise and no disturbance: truth as feedback.
        no_disturbance: Do not push the robot's yaw at random (Sec. 3.4.5).
        lookahead: Distance at which the robot keeps behind its target [m] (Sec. 4.5).
        terrain: What a MuJoCo Husky stands on: flat, ramp:SLOPE_DEG, rough:HEIGHT_MM or split:FRICTION_RATIO, with more keys
            as in validation.compare.
        seed: Seed of noise and disturbance.
        workers: Threads; the result does not depend on it.
        out: Folder for the results; runs/track/CONTROLLER-REFERENCE if not given.
        view: Open the recording in the rerun viewer.
        no_rerun: Do not write track.rrd.
    """
    with cli.mistakes_are_users():
        plants = cli.parse_names(plant, PLANTS, "plant")
        if seed < 0 or (workers is not None and workers < 1):
            raise cli.UserError(f"--seed {seed} must not be negative and --workers {workers} must be positive")
        if view and no_rerun:
            raise cli.UserError("--view shows the rerun recording; leave out --no-rerun")
        chosen = load(profile)
        wanted = load_gains(controller, gains or default_gains(controller))
        make_controller(chosen, wanted)
        label, waypoints = open_reference(reference, DEFAULT_SPEED if speed is None and reference in NAMED else speed)
        settings = LoopSettings(
            "truth" if no_noise else feedback, disturbance=not (no_noise or no_disturbance), lookahead=lookahead
        )
        ground = parse_terrain(terrain)
        if ground.kind != "flat" and "mujoco" not in plants:
            raise cli.UserError(f"--terrain {terrain} needs --plant mujoco: the planar models know only level ground")
        robots: list[Robot] = [make_robot(chosen, name, ground) for name in plants]
        for robot in robots:
            require_practicable(waypoints, robot.drive, label)
    results = [
        track(robot, chosen, wanted, label, waypoints, replace(settings, filter=odometry_of(robot.drive)), seed, workers)
        for robot in robots
    ]
    folder = cli.output_folder(out or Path("runs") / "track" / f"{controller}-{Path(reference).stem}")
    written = write(results, folder, recording=not no_rerun)
    cli.report(track_tables(results), track_notes(results), written)
    if view:
        from validation.rerun_log import open_viewer

        open_viewer(folder / "track.rrd")


def write(results: Sequence[TrackResult], folder: Path, *, recording: bool = True) -> list[Path]:
    """Write track.png, track.rrd (if wanted) and, last, track.json; return what was written."""
    from validation.figures import save_figure
    from validation.track_figure import draw_track

    written = [folder / "track.png"]
    save_figure(draw_track(results), written[0])
    if recording:
        from validation.track_rerun import write_track_rerun

        written.append(folder / "track.rrd")
        write_track_rerun(results, written[-1])
    written.append(folder / "track.json")
    store.write_json(written[-1], as_document(results))
    return written


if __name__ == "__main__":
    cli.run(main, "python -m validation.track")
