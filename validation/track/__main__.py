"""`python -m validation.track CONTROLLER REFERENCE`: a closed loop around any plant, held against its reference."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import tyro

from ssmr.control.laws import CONTROLLERS
from ssmr.control.loop import Feedback, LoopSettings
from validation import cli
from validation.plants.profile import PLANTS, load
from validation.robots.terrain import parse_terrain
from validation.track.gains import load_gains
from validation.track.report import track_notes, track_tables
from validation.track.run import DEFAULT_SPEED, NAMED, default_gains, write
from validation.track.tracking import Robot, make_controller, make_robot, odometry_of, require_practicable, track
from validation.track.waypoint_files import open_reference


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
        from validation.show.viewer import open_viewer

        open_viewer(folder / "track.rrd")


if __name__ == "__main__":
    cli.run(main, "python -m validation.track")
