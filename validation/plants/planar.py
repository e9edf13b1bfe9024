"""The planar models as plants: each is declared from its law, so a new model needs nothing here."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ssmr.lanes import run_population, seen_poses
from ssmr.models.law import planar_law
from ssmr.parameters import described
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.simulation import PlanarModel, PlanarPlant
from ssmr.types import FloatArray
from validation.plants.kind import Occasion, PlantKind, PlantProfile, Stretch
from validation.simulator.description import Robot
from validation.simulator.physics import PhysicsSettings
from validation.simulator.terrain import Terrain

_READ_OFF = ("effective_half_track", "delay", "acceleration_v")
"""Numbers that the thesis read off response curves or took for given, and a fit to a scenario has to find."""
_RECORDED = (
    *("wheel_radius", "effective_half_track", "delay", "acceleration_v", "acceleration_w"),
    *("tracked_x", "tracked_y"),
)
"""Numbers beside the model's own that a fit to a recording has to find."""
_KINEMATIC: Mapping[Occasion, tuple[str, ...]] = {
    "scenario": ("alpha_l", "alpha_r", "y_l", "y_r", "x_icr"),
    "recording": (
        *("alpha_l", "alpha_r", "y_l", "y_r"),  # x_icr and tracked_x are one number to a recording
        *("delay", "acceleration_v", "acceleration_w", "wheel_lag", "tracked_x"),
    ),
}
"""The kinematic model has no dynamics that could lag behind its wheels, and its constants hold the half-track."""


def model_of(section: PlantProfile) -> PlanarModel:
    """Return the planar model with a profile's numbers."""
    return PlanarModel(section.parameters, section.vehicle, section.drive)


def defaults(kind: type, robot: Robot) -> Any:
    """Return the thesis' parameters of a planar model, scaled to a robot's size; friction and shares stay as they are.

    Of robots of one shape that do all things in the same time, mass times radius squared decides the gain between wheel rate
    and torque, and mass times radius that between speed and torque. Centres of rotation lie at the effective half-track.
    """
    thesis, own, numbers = Vehicle(), robot.vehicle, kind()
    mass, radius = own.mass / thesis.mass, own.wheel_radius / thesis.wheel_radius
    ratios = {
        "gain": mass * radius**2,
        "gain_over_radius": mass * radius,
        "half_track": own.effective_half_track / thesis.effective_half_track,
    }
    sizes = {n: next((size for size in d.of if size in ratios), None) for n, d in described(kind).items()}
    scaled = {n: getattr(numbers, n) * ratios[size] for n, size in sizes.items() if size is not None}
    return replace(numbers, **scaled)


def declare(name: str) -> PlantKind:
    """Return the declaration of a planar model.

    Raises:
        ValueError: there is no such model.
    """
    law = planar_law(name)
    own = tuple(n for n, d in described(law.parameters).items() if d.search is not None)
    free: Mapping[Occasion, tuple[str, ...]] = {"scenario": (*own, *_READ_OFF), "recording": (*own, *_RECORDED)}
    drive = tuple(n for n in described(Drive) if n != "torque_limit" or not law.obeys)
    chosen = _KINEMATIC if law.obeys else free
    usual = partial(defaults, law.parameters)
    return PlantKind(name, law.parameters, usual, _build, PlanarPopulation, chosen, law.colour, law.vehicle, drive)


def _build(section: PlantProfile, terrain: Terrain, settings: PhysicsSettings) -> PlanarPlant:
    """Return the plant; planar models know only level ground of one friction, and no physics settings."""
    return PlanarPlant(model_of(section))


class PlanarPopulation:
    """Candidates of a model that one compiled loop drives on all threads."""

    def __init__(
        self,
        candidates: Sequence[PlantProfile | None],
        workers: int,
        make: Callable[[PlantProfile], Any] = model_of,
        run: Callable[..., FloatArray] = run_population,
    ) -> None:
        """Keep the candidates; None stands for one that cannot be built.

        `make` returns the model with a candidate's numbers, and `run` drives models as `run_population` does.
        """
        self._candidates, self._workers, self._run = candidates, workers, run
        self._models = [None if c is None else make(c) for c in candidates]

    def poses(self, which: Sequence[int], piece: Stretch, sample_dt: float) -> FloatArray:
        """Drive some of the candidates, see `Population.poses`."""
        built = [(row, self._models[i], self._candidates[i]) for row, i in enumerate(which)]
        known = [(row, model, candidate) for row, model, candidate in built if model is not None and candidate is not None]
        if not known:
            samples = 1 + round(piece.commands.duration / sample_dt) if piece.t is None else len(piece.t)
            return np.full((len(which), samples, 3), np.nan)
        localisers = [candidate.localiser for _, _, candidate in known]
        starts = {localiser: localiser.body_state(piece.start) for localiser in set(localisers)}
        models, begins = [m for _, m, _ in known], [starts[one] for one in localisers]
        poses = self._run(models, piece.commands, begins, sample_dt, workers=self._workers)
        told = seen_poses(poses, localisers, sample_dt, piece.t, self._workers)
        if len(known) == len(which):
            return told
        out = np.full((len(which), told.shape[1], 3), np.nan)
        out[[row for row, _, _ in known]] = told
        return out
