"""Drive every plant with the same commands and compare each with one reference."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ssmr.metrics.declared import compare_pieces
from ssmr.robot.sensors import SensorNoise, measure, yaw_disturbance
from ssmr.types import Commands, Plant, State, Trajectory
from validation import store
from validation.compare.data import PlantResult
from validation.compare.result import Comparison
from validation.compare.table import headline_horizon
from validation.logs.limits import USUAL, LogLimits
from validation.motion.driving import drive, horizons_of, scoring_windows, standing_sentences, window_errors_of
from validation.motion.sources import RECORDING, Source, open_source
from validation.plants.profile import Profile, choose_profile, make_plant
from validation.plants.table import ALL_PLANTS, USUAL_PLANTS
from validation.progress import Progress, Report, silent
from validation.simulator.description import Robot
from validation.simulator.health import Health, examine, run_health
from validation.simulator.plant import MujocoPlant
from validation.simulator.terrain import FLAT, Terrain
from validation.simulator.wheel_loads import resting_loads, summarise, with_quasi_static

WARM_UP = Commands(0.05, np.array([[0.1, 0.0]]))
"""Commands driven once before the clock runs, so that wall times do not hold compilation."""


@dataclass(frozen=True)
class CompareSettings:
    """The options of a comparison besides source, profile and plants.

    Raises:
        ValueError: a negative seed, or horizons that are not positive and increasing.
    """

    input: Literal["commands", "wheels"] = "commands"
    """Signal of a recording that drives the plants: its commands or its measured wheel rates."""
    horizons: tuple[float, ...] = (2.0, 6.0, 30.0, 60.0)
    """Times after which relative poses are compared on a recording [s]."""
    start: float | None = None
    """Leave out what was recorded before this time [s]."""
    until: float | None = None
    """Leave out what was recorded after this time [s]."""
    noise: bool = False
    """See the plants through the lab's state filter, with its noise (Tab. 3.4, 3.5)."""
    disturbance: bool = False
    """Push the plants' yaw at random (Sec. 3.4.5)."""
    seed: int = 0
    """Seed of noise and disturbance."""
    terrain: Terrain = FLAT
    """Ground of the MuJoCo robot; the planar models know only level ground of one friction."""
    limits: LogLimits = USUAL
    """Greatest sizes and numbers of a recording."""

    def __post_init__(self) -> None:
        h = self.horizons
        if any(not 0.0 < s < np.inf for s in h) or any(b <= a for a, b in pairwise(h)):
            raise ValueError(f"horizons {h} must be positive numbers that increase, such as (2, 6, 30, 60)")
        if self.seed < 0:
            raise ValueError(f"seed {self.seed} must not be negative")

    def as_dict(self) -> dict[str, Any]:
        """Return the options as compare.json has them; the seed stands beside them."""
        span = {"from": self.start, "until": self.until}
        options = {name: getattr(self, name) for name in ("input", "horizons", "noise", "disturbance")}
        return {**options, "terrain": self.terrain.spec, **{k: v for k, v in span.items() if v is not None}}


@dataclass(frozen=True, eq=False)
class PreparedComparison:
    """A comparison that is checked and has its plants, but has not been run."""

    source: Source
    profile: Profile
    reference: str
    plants: Mapping[str, Plant]
    settings: CompareSettings

    def run(self, workers: int | None = None, progress: Report = silent) -> Comparison:
        """Drive the plants and compare them.

        Args:
            workers: threads, None for all processors; the result does not depend on it.
            progress: told after each piece of the source that a plant has driven.

        Raises:
            SsmrError: a plant diverged.
        """
        source, settings = self.source, self.settings
        motions, wall = self._drive_all(workers, progress)
        health = {name: self._health(name, driven) for name, driven in motions.items()}  # of the motion, not of its noise
        if settings.noise:
            for index, name in enumerate(self.plants):
                if name != self.reference:
                    rng = np.random.default_rng([settings.seed, index])
                    motions[name] = [measure(m, SensorNoise(), rng) for m in motions[name]]
        recorded = self.reference == RECORDING
        against = [piece.reference for piece in source.pieces] if recorded else motions[self.reference]
        truth = tuple(m for m in against if m is not None)
        simulated = sum(piece.commands.duration for piece in source.pieces)
        every = self.profile.as_dict(self.plants)
        results = {}
        for name in self.plants:
            plant, driven = self.plants[name], motions[name]
            horizons = horizons_of([(source, driven)], settings.horizons) if recorded else {}
            loads = summarise(tuple(driven), resting_loads(plant)) if isinstance(plant, MujocoPlant) else None
            results[name] = PlantResult(
                name, tuple(driven), compare_pieces(driven, truth), horizons, wall[name], simulated / wall[name],
                health[name], self.profile.section(name).localiser, loads, every[name],
                window_errors_of([(source, driven)], settings.horizons) if recorded else {},
            )  # fmt: skip
        commands = tuple(piece.commands for piece in source.pieces)
        scoring = {horizon: scoring_windows(source, horizon) for horizon in settings.horizons} if recorded else {}
        headline = headline_horizon(scoring)
        standing = standing_sentences(source, headline) if headline else []
        return Comparison(
            source.name, self.profile.name, self.reference, truth, commands, results, settings.seed,
            settings.as_dict(), store.versions(), settings.terrain, (*source.warnings, *standing), scoring,
            self.profile.robot,
        )  # fmt: skip

    def _health(self, name: str, motions: Sequence[Trajectory]) -> Health | None:
        """Return the verdict on a plant's run; None for a plant without wheel loads, and on ground that is not even."""
        plant, localiser = self.plants[name], self.profile.section(name).localiser
        if not isinstance(plant, MujocoPlant) or not self.settings.terrain.even:
            return None
        bodies = [replace(motion, twist=localiser.body_twist(motion.twist)) for motion in motions]
        given = any(piece.commands.kind == "wheels" for piece in self.source.pieces)
        return run_health(examine(plant.model, plant.calibration), bodies, given_rates=given)

    def _drive_all(self, workers: int | None, progress: Report) -> tuple[dict[str, list[Trajectory]], dict[str, float]]:
        """Return all motions and each plant's wall time; plants run side by side, the pieces of one after another."""
        stop, told = threading.Event(), threading.Lock()
        done, total = 0, len(self.plants) * len(self.source.pieces)

        def one_plant(name: str) -> tuple[list[Trajectory], float]:
            nonlocal done
            plant, localiser = self.plants[name], self.profile.section(name).localiser
            plant.run(WARM_UP, State(), 0.05)
            began = time.perf_counter()
            motions = []
            for piece in self.source.pieces:
                if not stop.is_set():
                    push = None
                    if self.settings.disturbance:
                        rng = np.random.default_rng(self.settings.seed)
                        push = yaw_disturbance(piece.commands.duration, plant.dt, rng)
                    motions.append(drive(plant, piece, localiser, self.source.sample_dt, push))
                    with told:
                        done += 1
                        progress(Progress(done, total, f"{name} has driven"))
            wall = time.perf_counter() - began
            if isinstance(plant, MujocoPlant):
                motions = [with_quasi_static(motion, plant, localiser) for motion in motions]
            return motions, wall

        with ThreadPoolExecutor(workers) as pool:
            try:
                driven = dict(zip(self.plants, pool.map(one_plant, self.plants), strict=True))
            except BaseException:
                stop.set()  # an interrupt or a failed plant ends the others at their next piece
                raise
        return {name: d[0] for name, d in driven.items()}, {name: d[1] for name, d in driven.items()}


def compare(
    source: str | Path | Source,
    profile: str | Path | Profile | None = None,
    plants: Sequence[str] = USUAL_PLANTS,
    reference: str | None = None,
    settings: CompareSettings | None = None,
    workers: int | None = None,
    progress: Report = silent,
    *,
    robot: str | Path | Robot | None = None,
    **options: Any,
) -> Comparison:
    """Drive every plant with the same commands and compare each with the reference.

    Every field of the settings can be given by its own name too: `compare("drive.csv", input="wheels", start=50.0)`.

    Args:
        source: `traj1` ... `traj4`, one of them with `@PLANT`, the path of a recording, or an opened source.
        profile: the plants' parameters: a profile, its name or its path; None for `thesis-lab` on a scenario and
            `husky-tile` on a recording, or the robot's own numbers if they are of another robot than `robot`.
        plants: names of the plants to drive.
        reference: name of the plant to compare with, added to `plants` if need be; None for the source's own reference.
        settings: horizons, noise, disturbance, seed, terrain.
        workers: threads, None for all processors; the result does not depend on it.
        progress: told how far the work is.
        robot: the robot, its name or its path; None for that of the profile.
        options: fields of the settings by name.

    Returns:
        The comparison, which prints (`table()`), draws (`figure()`) and saves (`save(folder)`) itself.

    Raises:
        SsmrError: a plant diverged.
        ValueError: a name that there is not, a recording that cannot be read, or values that do not go together.
    """
    changed = replace(settings or CompareSettings(), **options)
    return prepare(source, profile, plants, reference, changed, robot=robot).run(workers, progress)


def prepare(
    source: str | Path | Source,
    profile: str | Path | Profile | None = None,
    plants: Sequence[str] = USUAL_PLANTS,
    reference: str | None = None,
    settings: CompareSettings | None = None,
    *,
    robot: str | Path | Robot | None = None,
) -> PreparedComparison:
    """Check everything that a comparison is asked for, and build its plants; the arguments are those of `compare`.

    Raises:
        ValueError: a name that there is not, a recording that cannot be read, or values that do not go together.
    """
    settings = settings or CompareSettings()
    if not isinstance(source, Source):
        kind: Literal["twist", "wheels"] = "wheels" if settings.input == "wheels" else "twist"
        source = open_source(str(source), kind, settings.start, settings.until, settings.limits)
    elif settings.start is not None or settings.until is not None:
        raise ValueError("settings.start and settings.until cut a recording that is given by its path; cut yours before")
    reference = reference or source.reference
    profile = choose_profile(profile, robot, "husky-tile" if source.reference == RECORDING else "thesis-lab")
    asked = {*plants, reference} - ({RECORDING} if source.reference == RECORDING else set())
    if unknown := sorted(asked - set(ALL_PLANTS)):
        raise ValueError(f"unknown plant '{', '.join(unknown)}'; there are: {', '.join(ALL_PLANTS)}")
    if not asked:
        raise ValueError(f"plants is empty; there are: {', '.join(ALL_PLANTS)}")
    made = {name: make_plant(profile, name, settings.terrain) for name in ALL_PLANTS if name in asked}
    return PreparedComparison(source, profile, reference, made, settings)
