"""The MuJoCo Husky as a plant. Another simulation engine is a folder beside this file with a declaration like this one."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

import numpy as np

from ssmr.errors import SsmrError
from ssmr.geometry import shift_reference, shift_state
from ssmr.types import FloatArray
from validation.plants.kind import PlantKind, PlantProfile, Stretch
from validation.robots.calibration import HuskyCalibration
from validation.robots.physics import SHIPPED, PhysicsSettings
from validation.robots.plant import MujocoPlant
from validation.robots.terrain import FLAT, Terrain

_DRIVEN = ("delay", "acceleration_v", "acceleration_w")


def build(section: PlantProfile, terrain: Terrain = FLAT, settings: PhysicsSettings = SHIPPED) -> MujocoPlant:
    """Return the plant with a profile's numbers.

    Raises:
        ValueError: numbers that do not go together.
    """
    return MujocoPlant(section.parameters, section.drive, terrain=terrain, settings=settings)


class MujocoPopulation:
    """Candidates of the MuJoCo Husky, driven one after another; the caller spreads them over threads."""

    def __init__(self, candidates: Sequence[PlantProfile | None], workers: int) -> None:
        """Keep the candidates; each is built when it is first driven. `workers` has no effect."""
        self._candidates = candidates
        self._plants: dict[int, MujocoPlant | None] = {}

    def _plant(self, i: int) -> MujocoPlant | None:
        """Return the plant of a candidate; None where its numbers are impossible."""
        if i not in self._plants:
            candidate = self._candidates[i]
            try:
                self._plants[i] = None if candidate is None else build(candidate)
            except ValueError:
                self._plants[i] = None
        return self._plants[i]

    def poses(self, which: Sequence[int], piece: Stretch, sample_dt: float) -> FloatArray:
        """Drive some of the candidates, see `Population.poses`."""
        samples = 1 + round(piece.commands.duration / sample_dt) if piece.t is None else len(piece.t)
        out = np.full((len(which), samples, 3), np.nan)
        for row, i in enumerate(which):
            plant, candidate = self._plant(i), self._candidates[i]
            if plant is not None and candidate is not None:
                x, y = candidate.tracked_point
                with contextlib.suppress(SsmrError):
                    motion = plant.run(piece.commands, shift_state(piece.start, (-x, -y)), sample_dt)
                    pose = shift_reference(motion.pose, (x, y))
                    if piece.t is not None:
                        pose = np.column_stack([np.interp(piece.t, motion.t + piece.t[0], column) for column in pose.T])
                    out[row] = pose
        return out


KIND = PlantKind(
    "mujoco",
    HuskyCalibration,
    build,
    MujocoPopulation,
    free={
        "scenario": ("command_half_track", "wheel_radius", "delay", "acceleration_v", "tracked_x"),
        "recording": (
            *("friction", "wheel_radius", "radius_difference", "com_x", "com_y"),
            *(*_DRIVEN, "wheel_lag", "tracked_x", "tracked_y"),
        ),
    },
    together=False,
)
