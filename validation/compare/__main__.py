"""`python -m validation.compare SOURCE`: every plant, the same commands, one reference."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ssmr.types import CommandKind
from validation import cli
from validation.compare.result import Comparison
from validation.compare.run import Settings, compare, write
from validation.motion.sources import open_source
from validation.plants.profile import PLANTS, load, make_plant
from validation.robots.terrain import parse_terrain


def main(
    source: Annotated[str, tyro.conf.Positional],
    /,
    *,
    profile: str | None = None,
    plants: str = ",".join(PLANTS),
    reference: str | None = None,
    input: Literal["commands", "wheels"] = "commands",
    horizons: str = "2,6,30,60",
    start: Annotated[float | None, tyro.conf.arg(name="from")] = None,
    until: float | None = None,
    noise: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    disturbance: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    terrain: str = "flat",
    seed: int = 0,
    workers: int | None = None,
    out: Path | None = None,
    view: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    no_rerun: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
) -> None:
    """Drive every plant with the same commands and compare each with the reference.

    Prints a table and writes compare.json, compare.png and compare.rrd.

    Args:
        source: traj1 ... traj4 (traj4@improved: held against that plant), or the path of a recording (.csv, .bag, .mcap,
            or a ROS 2 bag's folder).
        profile: Name of a shipped profile or path of a TOML file; thesis-lab for scenarios, husky-tile for recordings.
        plants: Which plants, comma-separated.
        reference: Plant to compare with; by default mujoco for a scenario, the recording itself for a recording.
        input: What of a recording drives the plants: its commands, or its measured wheel rates.
        horizons: Seconds after which relative poses are compared on a recording.
        start: Leave out what was recorded before this time [s].
        until: Leave out what was recorded after this time [s].
        noise: See the plants through the lab's state filter: 50 Hz, with its noise.
        disturbance: Push all plants with the same random yaw acceleration.
        terrain: What the MuJoCo Husky stands on: flat, ramp:SLOPE_DEG, rough:HEIGHT_MM, split:FRICTION_RATIO; with more keys
            ramp:slope_deg=5,toward_deg=90, rough:height_mm=5,length_mm=300,seed=1 or
            split:friction_ratio=0.5,edge_deg=0,edge_m=0. The planar models know only level ground of one friction.
        seed: Seed of noise and disturbance.
        workers: Threads; the result does not depend on it.
        out: Folder for the results; runs/compare/SOURCE if not given.
        view: Open the recording in the rerun viewer.
        no_rerun: Do not write compare.rrd.
    """
    kind: CommandKind = "wheels" if input == "wheels" else "twist"
    with cli.mistakes_are_users():
        wanted = cli.parse_names(plants, PLANTS, "plant")
        if reference is not None:
            cli.parse_names(reference, PLANTS, "plant")
        if seed < 0 or (workers is not None and workers < 1):
            raise cli.UserError(f"--seed {seed} must not be negative and --workers {workers} must be positive")
        if view and no_rerun:
            raise cli.UserError("--view shows the rerun recording; leave out --no-rerun")
        settings = Settings(
            input, cli.parse_numbers(horizons, "--horizons"), noise, disturbance, seed, parse_terrain(terrain)
        )
        opened = open_source(source, kind, start, until)
        chosen = load(profile or ("husky-tile" if opened.reference == "recording" else "thesis-lab"))
        for name in dict.fromkeys((*wanted, reference or opened.reference)):
            if name != "recording":
                make_plant(chosen, name, settings.terrain)
    comparison = compare(opened, chosen, wanted, reference, settings, workers)
    folder = cli.output_folder(out or Path("runs") / "compare" / Path(source).stem)
    written = write(comparison, chosen, folder, recording=not no_rerun)
    _report(comparison, written)
    if view:
        from validation.compare.rerun import open_viewer

        open_viewer(folder / "compare.rrd")


def _report(comparison: Comparison, written: Sequence[Path]) -> None:
    from validation.compare.table import comparison_table, horizon_table, load_table

    tables = [comparison_table(comparison), horizon_table(comparison), load_table(comparison)]
    for result in comparison.plants.values():
        if result.health is not None and not result.health.ok:
            cli.warn(f"{result.name}: {result.health.advice}")
    cli.report([table for table in tables if table is not None], (), written)


if __name__ == "__main__":
    cli.run(main, "python -m validation.compare")
