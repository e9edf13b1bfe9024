"""The program `python -m validation.study STUDY`: questions that take many runs, each with a module of its own.

A study is a function here, which reads its options, and a line in `STUDIES`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, cast

import tyro
from matplotlib.figure import Figure

from ssmr.control.laws import CONTROLLERS
from ssmr.control.loop import Feedback
from validation import cli, store
from validation.plants.profile import PLANTS, load
from validation.show.tables import Grid, rich_table
from validation.track.waypoint_files import open_reference


def robustness(
    *,
    controllers: str = ",".join(CONTROLLERS),
    gains: str = "published",
    reference: str = "generic",
    speed: float = 0.25,
    profile: str = "thesis-lab",
    runs: int = 200,
    seeds: int = 4,
    seed: int = 0,
    bound: float = 0.5,
    feedback: Feedback = "noisy",
    no_disturbance: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    timestep: float = 0.002,
    workers: int | None = None,
    out: Path = Path("runs/study/robustness"),
) -> None:
    """Let trackers meet MuJoCo Huskies that are not the robot of their profile: friction, mass, delay, noise, torque.

    Args:
        controllers: Which, comma-separated.
        gains: Name of a set of gains (published, manual, tuned, default), for each controller that has it; the others get
            their defaults. Or the path of a TOML file, for one controller.
        reference: line, circle, sine, generic, or the path of a waypoint file.
        speed: Of the reference [m/s].
        profile: Name of a shipped profile or path of a TOML file.
        runs: For each controller: single mismatches first, the rest a random sample of the full grid.
        seeds: Of noise, for each single mismatch.
        seed: Of the sample and of noise.
        bound: A run whose d_rms or e_rho rms is greater counts as failed [m].
        feedback: What controllers see.
        no_disturbance: Do not push the robots' yaw at random.
        timestep: Physics step [s].
        workers: Threads; the result does not depend on it.
        out: Folder for the results.
    """
    from validation.study.robustness import run as study
    from validation.study.robustness.figure import draw_robustness

    with cli.mistakes_are_users():
        names = cli.parse_names(controllers, CONTROLLERS, "controller")
        _check(seed, workers)
        settings = study.RobustnessSettings(runs, seeds, seed, bound, feedback, not no_disturbance, timestep)
        chosen = load(profile)
        sets, remarks = study.choose_gains(names, gains)
        name, waypoints = open_reference(reference, speed)
        study.check(chosen, sets, name, waypoints, settings)
    for remark in remarks:
        cli.warn(remark)
    folder = cli.output_folder(out)
    result = study.study_robustness(chosen, sets, name, waypoints, settings, workers)
    written = _write(folder, study.as_document(result), draw_robustness(result), study.markdown(result))
    tables = [
        (study.spread_grid(result), study.heading(result), study.spread_caption(result)),
        (study.alone_grid(result, "d_rms_m"), "d_rms under each mismatch alone", ""),
        (study.alone_grid(result, "e_rho_rms_m"), "e_rho under each mismatch alone", study.alone_caption(result)),
    ]
    _report(tables, study.remarks(result), written)


def filter(
    *,
    references: str = "sine,circle",
    speed: float = 0.25,
    profiles: str = "thesis-lab,husky-tile",
    frictions: str = "0.3,0.6,0.9",
    bias: float = -0.0156,
    seeds: int = 20,
    seed: int = 0,
    timestep: float = 0.002,
    workers: int | None = None,
    out: Path = Path("runs/study/filter"),
) -> None:
    """Measure how fast the state filter loses its way on the MuJoCo Husky, by surface and by sensors.

    Args:
        references: What is driven, comma-separated: line, circle, sine, generic, or paths of waypoint files.
        speed: Of the references [m/s].
        profiles: Names of shipped profiles or paths of TOML files, comma-separated.
        frictions: The last profile's robot is driven with these too, comma-separated; '' for none.
        bias: Of the biased gyro [rad/s].
        seeds: How many draws of the sensors' noise.
        seed: The first of them.
        timestep: Physics step [s].
        workers: Threads; the result does not depend on it.
        out: Folder for the results.
    """
    from validation.study.filter import run as study
    from validation.study.filter.figure import draw_filter

    with cli.mistakes_are_users():
        _check(seed, workers)
        settings = study.FilterSettings(seeds, seed, bias, timestep)
        chosen = [load(name) for name in _split(profiles, "--profiles")]
        surfaces = study.surfaces_of(chosen, cli.parse_numbers(frictions, "--frictions") if frictions.strip() else ())
        missions = dict(open_reference(name, speed) for name in _split(references, "--references"))
        study.check(surfaces, missions, settings)
    folder = cli.output_folder(out)
    result = study.study_filter(surfaces, missions, settings, workers)
    written = _write(folder, study.as_document(result), draw_filter(result), study.markdown(result))
    position, yaw = study.captions(result)
    tables = [
        (study.drift_grid(result, "position"), f"Dead reckoning, {study.heading(result)}: position", position),
        (study.drift_grid(result, "yaw"), "Yaw", yaw),
    ]
    _report(tables, [], written)


def tables(
    *,
    profile: str = "thesis-lab",
    seeds: int = 10,
    workers: int | None = None,
    out: Path = Path("runs/study/tables"),
) -> None:
    """Make the thesis' tables of tracked references (Tab. 4.5-4.36) with the improved model and the MuJoCo Husky.

    Args:
        profile: Name of a shipped profile or path of a TOML file.
        seeds: Draws of noise and disturbance for each row.
        workers: Threads; the result does not depend on it.
        out: Folder for the results.
    """
    from validation.study.tables import run as study

    with cli.mistakes_are_users():
        _check(seeds, workers)
        chosen = load(profile)
        if seeds < 1:
            raise cli.UserError(f"--seeds {seeds} must be positive")
    folder = cli.output_folder(out)
    with cli.progress() as bar:
        task = bar.add_task("tables", total=len(study.TABLES))
        result = study.study_tables(
            chosen, seeds, workers, lambda number: bar.update(task, advance=1, description=f"Tab. {number}")
        )
    written = _write(folder, study.as_document(result), study.draw_tables(result), study.markdown(result))
    _report([(study.grid(result, kind), caption, "") for kind, caption in study.CAPTIONS.items()], [], written)


def gains(
    *,
    profile: str = "thesis-lab",
    plants: str = "improved,mujoco",
    seeds: int = 3,
    seed: int = 11,
    workers: int | None = None,
    out: Path = Path("runs/study/gains"),
) -> None:
    """Drive every shipped set of gains along every named reference at both of the thesis' speeds.

    Args:
        profile: Name of a shipped profile or path of a TOML file.
        plants: Which robots, comma-separated.
        seeds: Draws of noise and disturbance.
        seed: The first of them; no shipped set was tuned on those from 11 on.
        workers: Threads; the result does not depend on it.
        out: Folder for the results.
    """
    from validation.study.gains import run as study

    with cli.mistakes_are_users():
        _check(seed, workers)
        if seeds < 1:
            raise cli.UserError(f"--seeds {seeds} must be positive")
        wanted = cli.parse_names(plants, PLANTS, "plant")
        chosen = load(profile)
    folder = cli.output_folder(out)
    with cli.progress() as bar:
        task = bar.add_task("gains", total=len(wanted) * len(study.REFERENCES) * len(study.SPEEDS))

        def tell(what: str) -> None:
            bar.update(task, advance=1, description=what)

        result = study.study_gains(chosen, wanted, range(seed, seed + seeds), workers, tell)
    written = _write(folder, study.as_document(result), study.draw_gains(result), study.markdown(result))
    _report([(table, title, "") for table, title in study.tables(result)], [], written)


def terrain(
    *,
    profile: str = "thesis-lab",
    horizon: float = 6.0,
    seeds: int = 3,
    seed: int = 0,
    workers: int | None = None,
    out: Path = Path("runs/study/terrain"),
) -> None:
    """Measure how far planar models and trackers hold as speed, slope, roughness and difference of friction grow.

    Args:
        profile: Name of a shipped profile or path of a TOML file.
        horizon: After which relative poses are compared [s].
        seeds: How many rough grounds.
        seed: Of the first of them, and of noise.
        workers: Threads; the result does not depend on it.
        out: Folder for the results.
    """
    from validation.study.terrain import run as study
    from validation.study.terrain.figure import draw_terrain

    with cli.mistakes_are_users():
        _check(seed, workers)
        settings = study.TerrainSettings(seeds=seeds, seed=seed, horizon=horizon)
        chosen = load(profile)
    folder = cli.output_folder(out)
    with cli.progress() as bar:
        task = bar.add_task("terrain", total=study.steps(settings))
        result = study.study_terrain(chosen, settings, workers, lambda what: bar.update(task, advance=1, description=what))
    written = _write(folder, study.as_document(result), draw_terrain(result), study.markdown(result))
    _report([(table, title, "") for table, title in study.tables(result)], [], written)


def contact(
    *,
    only: str | None = None,
    profile: str = "thesis-lab",
    recording: str | None = None,
    recording_profile: str = "husky-tile",
    start: Annotated[float | None, tyro.conf.arg(name="from")] = None,
    until: float | None = None,
    workers: int | None = None,
    out: Path = Path("runs/study/contact"),
) -> None:
    """Try physics settings on the MuJoCo Husky: cone, solver, contact, step, wheels, centre of mass; alone and together.

    Args:
        only: Which groups besides what is shipped, comma-separated (cone, impratio, "time step", ...); all if not given.
        profile: Name of a shipped profile or path of a TOML file, for the lab's robot.
        recording: Path of a real robot's recording (.csv, or a bag) with wheel rates; adds its columns.
        recording_profile: The same as `profile`, for the robot of the recording.
        start: Leave out what was recorded before this time [s].
        until: Leave out what was recorded after this time [s].
        workers: Threads; the result does not depend on it, but for the cost of a step.
        out: Folder for the results.
    """
    from validation.motion.sources import open_source
    from validation.study.contact import run as study
    from validation.study.contact.bench import make_bench
    from validation.study.contact.figure import draw_contact

    with cli.mistakes_are_users():
        _check(0, workers)
        chosen = study.choose(study.groups() if only is None else cli.parse_names(only, study.groups(), "group"))
        if recording is None and (start is not None or until is not None):
            raise cli.UserError("--from and --until cut a recording; name one with --recording")
        lab, recorded, source = load(profile), None, None
        if recording is not None:
            recorded, source = load(recording_profile), open_source(recording, "wheels", start, until)
            if source.reference != "recording":
                raise cli.UserError(f"--recording {recording} is a scenario; wanted the path of a recording")
        bench = make_bench(lab, recorded, source)
        study.check(bench, chosen)
    folder = cli.output_folder(out)
    result = study.study_contact(bench, chosen, workers)
    written = _write(folder, study.as_document(result), draw_contact(result), study.markdown(result))
    tables = [(study.measure_grid(result, names), title, "") for title, names in study.TABLES.items()]
    _report(tables, study.remarks(result), written)


STUDIES: Mapping[str, Callable[..., None]] = {
    "robustness": robustness,
    "filter": filter,
    "tables": tables,
    "gains": gains,
    "terrain": terrain,
    "contact": contact,
}
"""By name, as on the command line."""


def _check(seed: int, workers: int | None) -> None:
    if seed < 0 or (workers is not None and workers < 1):
        raise cli.UserError(f"--seed {seed} must not be negative and --workers {workers} must be positive")


def _split(text: str, what: str) -> list[str]:
    """Comma-separated names, none twice.

    Raises:
        UserError: none at all, or one twice.
    """
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names or len(set(names)) < len(names):
        raise cli.UserError(f"{what} '{text}' must name at least one, and none twice")
    return names


def _write(folder: Path, document: Mapping[str, Any], figure: Figure, report: Sequence[str]) -> list[Path]:
    """Write study.png, study.md and, last, study.json; return what was written."""
    from validation.show.drawing import save_figure

    picture, text, numbers = (folder / f"study.{ending}" for ending in ("png", "md", "json"))
    save_figure(figure, picture)
    store.write_atomic(text, lambda temporary: temporary.write_text("\n".join(report), encoding="utf-8"))
    store.write_json(numbers, document)
    return [picture, text, numbers]


def _report(tables: Sequence[tuple[Grid, str, str]], remarks: Sequence[str], written: Sequence[Path]) -> None:
    for remark in remarks:
        cli.warn(remark)
    cli.report((rich_table(grid, title, caption) for grid, title, caption in tables), (), written)


def program() -> Callable[..., Any]:
    """What parses the command line: one subcommand a study."""
    commands = [Annotated[Any, tyro.conf.subcommand(name=name, constructor=study)] for name, study in STUDIES.items()]
    together = commands[0]
    for command in commands[1:]:
        together = together | command
    return cast(Callable[..., Any], together)


if __name__ == "__main__":
    cli.run(program(), "python -m validation.study")
