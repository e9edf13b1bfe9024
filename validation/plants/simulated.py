"""Simulated robots as plants: MuJoCo's, and ODE's and Drake's with the same numbers as second opinions on it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from ssmr.errors import ParameterError, SsmrError
from ssmr.types import FloatArray, Plant
from validation.engines.body import EngineBody, RigidNumbers
from validation.engines.drake import DrakeBody
from validation.engines.ode import OdeBody, OdeSettings
from validation.engines.plant import EnginePlant
from validation.plants.kind import SEEN, Occasion, PlantKind, PlantProfile, Stretch
from validation.simulator.calibration import Calibration
from validation.simulator.physics import SHIPPED, PhysicsSettings
from validation.simulator.plant import MujocoPlant
from validation.simulator.terrain import FLAT, Terrain

_BODY = ("friction", "wheel_radius", "radius_difference", "com_x", "com_y")
_FREE: Mapping[Occasion, tuple[str, ...]] = {
    "scenario": ("command_half_track", "wheel_radius", "delay", "acceleration_v", "tracked_x"),
    "commands": (*_BODY, "delay", "acceleration_v", "acceleration_w", "wheel_lag", *SEEN),
    "wheels": (*_BODY, *SEEN),
}
_ENGINES: dict[str, Callable[[RigidNumbers], EngineBody]] = {
    "ode": lambda numbers: OdeBody(numbers, OdeSettings()),
    "drake": DrakeBody,
}
"""For each other engine, what builds the robot in it with the best settings that were found."""
_COLOURS = {"mujoco": "#e69f00", "ode": "#8c510a", "drake": "#35978f"}  # amber: the Husky is yellow


class OneByOne:
    """Candidates that are driven one after another; the caller spreads them over threads."""

    def __init__(
        self, build: Callable[[PlantProfile], Plant], candidates: Sequence[PlantProfile | None], workers: int
    ) -> None:
        """Build the candidates; None stands for one that cannot be built, and `workers` has no effect."""
        self._candidates = candidates
        self._plants: list[Plant | None] = []
        for candidate in candidates:
            try:
                self._plants.append(None if candidate is None else build(candidate))
            except ParameterError:
                self._plants.append(None)

    def poses(self, which: Sequence[int], piece: Stretch, sample_dt: float) -> FloatArray:
        """Drive some of the candidates, see `Population.poses`."""
        samples = 1 + round(piece.commands.duration / sample_dt) if piece.t is None else len(piece.t)
        out = np.full((len(which), samples, 3), np.nan)
        for row, i in enumerate(which):
            plant, candidate = self._plants[i], self._candidates[i]
            if plant is not None and candidate is not None:
                localiser = candidate.localiser
                with contextlib.suppress(SsmrError):
                    motion = plant.run(piece.commands, localiser.body_state(piece.start), sample_dt)
                    out[row] = localiser.seen(motion, piece.t).pose
        return out


def declare(name: str) -> PlantKind:
    """Return the declaration of an engine's robot; an engine besides MuJoCo is loaded when its robot is built."""

    def build(section: PlantProfile, terrain: Terrain = FLAT, settings: PhysicsSettings = SHIPPED) -> Plant:
        if name == "mujoco":
            return MujocoPlant(section.parameters, section.drive, terrain=terrain, settings=settings)
        return EnginePlant(name, _ENGINES[name], section.parameters, section.drive, terrain)

    population = partial(OneByOne, build)
    return PlantKind(
        name, Calibration, Calibration.of, build, population, _FREE, _COLOURS[name], together=False,
        usual_drive=lambda robot: robot.motor_drive,
    )  # fmt: skip
