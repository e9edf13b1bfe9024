"""`python -m validation.compare SOURCE`: every plant, the same commands, one reference."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ssmr.metrics.paths import compare_pieces
from ssmr.robot.sensors import SensorNoise, measure, yaw_disturbance
from ssmr.robot.vehicle import Vehicle
from ssmr.types import Commands, Plant, State, Trajectory
from validation import cli, store
from validation.compare.result import Comparison, PlantResult
from validation.motion.driving import drive, score_horizons
from validation.motion.sources import Source
from validation.plants.profile import PLANTS, Profile, make_plant
from validation.robots.husky import WHEELS, HuskyCalibration
from validation.robots.plant import Health, MujocoPlant, check_health
from validation.robots.terrain import FLAT, Terrain
from validation.robots.wheel_loads import WheelLoads, summarise, with_quasi_static

SCHEMA = "ssmr.compare/1"
WARM_UP = Commands(0.05, np.array([[0.1, 0.0]]))
"""Driven once before the clock runs, so that wall times do not hold compilation."""


@dataclass(frozen=True)
class Settings:
    """What a comparison can be asked for besides source, profile and plants."""

    input: Literal["commands", "wheels"] = "commands"
    """What drives the plants on a recording."""
    horizons: tuple[float, ...] = (2.0, 6.0, 30.0, 60.0)
    """Of the relative pose error [s]."""
    noise: bool = False
    """Look at the plants through the lab's state filter (Tab. 3.4, 3.5)."""
    disturbance: bool = False
    """Push the plants' yaw at random (Sec. 3.4.5)."""
    seed: int = 0
    """Seed of both."""
    terrain: Terrain = FLAT
    """What the MuJoCo Husky stands on; the planar models know only level ground of one friction."""


def compare(
    source: Source,
    profile: Profile,
    plants: Sequence[str] = PLANTS,
    reference: str | None = None,
    settings: Settings | None = None,
    workers: int | None = None,
) -> Comparison:
    """Drive every plant with the same commands and hold each against the reference.

    Args:
        source: what drives the plants.
        profile: their parameters.
        plants: which ones.
        reference: a plant, added to `plants` if need be; None for the source's own.
        settings: horizons, noise, disturbance, seed.
        workers: threads; the result does not depend on it.

    Raises:
        SsmrError: a plant diverged.
        ValueError: names or numbers that do not go together.
    """
    settings = settings or Settings()
    reference = reference or source.reference
    names = [name for name in PLANTS if name in plants or name == reference]
    made = {name: make_plant(profile, name, settings.terrain) for name in names}
    motions, wall = _drive_all(made, profile, source, settings, workers)
    if settings.noise:
        for index, name in enumerate(names):
            if name != reference:
                rng = np.random.default_rng([settings.seed, index])
                motions[name] = [measure(m, SensorNoise(), rng) for m in motions[name]]
    against = [p.reference for p in source.pieces] if reference == "recording" else motions[reference]
    truth = tuple(m for m in against if m is not None)
    simulated = sum(piece.commands.duration for piece in source.pieces)
    results = {}
    for name in names:
        results[name] = PlantResult(
            name,
            tuple(motions[name]),
            compare_pieces(motions[name], truth),
            score_horizons(motions[name], source, settings.horizons) if reference == "recording" else {},
            wall[name],
            simulated / wall[name],
            _health(motions[name]) if settings.terrain.even else None,
            profile.plants[name].tracked_point,
            _loads(motions[name], profile.plants[name].parameters),
        )
    return Comparison(
        source.name,
        profile.name,
        reference,
        truth,
        tuple(piece.commands for piece in source.pieces),
        results,
        settings.seed,
        {**{k: v for k, v in asdict(settings).items() if k != "seed"}, "terrain": settings.terrain.spec},
        store.versions(),
        settings.terrain,
    )


def _drive_all(
    made: Mapping[str, Plant], profile: Profile, source: Source, settings: Settings, workers: int | None
) -> tuple[dict[str, list[Trajectory]], dict[str, float]]:
    """All motions and each plant's wall time; plants run side by side, the pieces of one after another."""
    stop = threading.Event()

    def one_plant(name: str) -> tuple[list[Trajectory], float]:
        plant, tracked = made[name], profile.plants[name].tracked_point
        plant.run(WARM_UP, State(), 0.05)
        began = time.perf_counter()
        motions = []
        for piece in source.pieces:
            if not stop.is_set():
                push = None
                if settings.disturbance:
                    push = yaw_disturbance(piece.commands.duration, plant.dt, np.random.default_rng(settings.seed))
                motions.append(drive(plant, piece, tracked, source.sample_dt, push))
                bar.advance(task)
        wall = time.perf_counter() - began
        if isinstance(plant, MujocoPlant):
            motions = [with_quasi_static(motion, plant, tracked) for motion in motions]
        return motions, wall

    with cli.progress() as bar, ThreadPoolExecutor(workers) as pool:
        task = bar.add_task(f"driving {len(made)} plants", total=len(made) * len(source.pieces))
        try:
            done = dict(zip(made, pool.map(one_plant, made), strict=True))
        except BaseException:
            stop.set()  # an interrupt or a failed plant ends the others at their next piece
            raise
    return {name: d[0] for name, d in done.items()}, {name: d[1] for name, d in done.items()}


def _health(motions: Sequence[Trajectory]) -> Health | None:
    """The worst verdict over all pieces, for a plant that knows its wheel loads."""
    verdicts = [check_health(m.channels["wheel_load_N"]) for m in motions if "wheel_load_N" in m.channels]
    if not verdicts:
        return None
    return Health(min(v.lowest_load_share for v in verdicts), max(v.load_deviation for v in verdicts))


def _loads(motions: Sequence[Trajectory], parameters: object) -> WheelLoads | None:
    """What the wheels carried, for a plant that knows."""
    if not isinstance(parameters, HuskyCalibration):
        return None
    return summarise(tuple(motions), Vehicle(mass=parameters.mass))


def as_document(comparison: Comparison, profile: Profile) -> dict[str, Any]:
    """compare.json."""
    plants = {}
    for name, result in comparison.plants.items():
        plants[name] = {**asdict(result.metrics), "wall_s": result.wall_s, "real_time_factor": result.real_time_factor}
        if result.horizons:
            plants[name]["horizons"] = {f"{h:g}": asdict(errors) for h, errors in result.horizons.items()}
        if result.health is not None:
            plants[name]["health"] = {**asdict(result.health), "ok": result.health.ok, "advice": result.health.advice}
        if result.loads is not None:
            plants[name]["wheel_loads"] = {"wheels": WHEELS, **asdict(result.loads)}
    return {
        "schema": SCHEMA,
        "source": comparison.source,
        "profile": comparison.profile,
        "reference": comparison.reference_name,
        "seed": comparison.seed,
        "options": dict(comparison.options),
        "versions": dict(comparison.versions),
        "plants": plants,
        "parameters": {name: profile.as_dict()[name] for name in comparison.plants},
    }


def write(comparison: Comparison, profile: Profile, out: Path, *, recording: bool = True) -> list[Path]:
    """Write compare.png, compare.rrd (if wanted) and, last, compare.json into `out`; return what was written."""
    from validation.compare.figure import comparison_figure, save_figure
    from validation.compare.table import report_markdown

    written = [out / "compare.png"]
    save_figure(comparison_figure(comparison), written[0])
    if recording:
        from validation.compare.rerun import write_recording

        written.append(out / "compare.rrd")
        write_recording(comparison, written[1], report_markdown(comparison))
    written.append(out / "compare.json")
    store.write_json(written[-1], as_document(comparison, profile))
    return written
