"""Many candidates of one plant driven over the same piece of a source, on all threads of one process."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import Protocol

import numba
import numpy as np

from ssmr._jit import config
from ssmr.errors import SsmrError
from ssmr.geometry import shift_reference
from ssmr.simulate import PLANAR_DT, PlanarModel, run_population
from ssmr.types import FloatArray
from validation.motion.driving import drive, start_of
from validation.motion.sources import Piece
from validation.plants.profile import PlantProfile
from validation.robots.plant import MujocoPlant


class Population(Protocol):
    """S candidates, ready to be driven."""

    def poses(self, which: Sequence[int], piece: Piece, sample_dt: float) -> FloatArray:
        """Drive some of the candidates over one piece.

        Args:
            which: their indices.
            piece: inputs, start and stamps.
            sample_dt: period at which plants are sampled [s].

        Returns:
            (len(which), M, 3) poses of each candidate's tracked point at the piece's stamps, or at the samples of the
            simulation where the piece has none; NaN for a candidate that cannot be built or diverges.
        """
        ...


def resampled(poses: FloatArray, sample_dt: float, stamps: FloatArray) -> FloatArray:
    """(S, M, 3) poses sampled every `sample_dt` [s], linearly interpolated at (K,) `stamps` after the first [s]."""
    at = np.clip(stamps / sample_dt, 0.0, poses.shape[1] - 1.0)
    k = np.minimum(np.floor(at).astype(np.intp), poses.shape[1] - 2)
    weight = (at - k)[:, None]
    return poses[:, k] + weight * (poses[:, k + 1] - poses[:, k])


class PlanarPopulation:
    """Candidates of a planar model, by one compiled loop on all threads."""

    def __init__(self, candidates: Sequence[PlantProfile | None], workers: int) -> None:
        """Pack the candidates; None stands for one that cannot be built."""
        self._candidates, self._workers = candidates, workers
        self._models = [None if c is None else PlanarModel(c.parameters, c.vehicle, c.drive) for c in candidates]

    def poses(self, which: Sequence[int], piece: Piece, sample_dt: float) -> FloatArray:
        """See `Population.poses`."""
        built = [(row, self._models[i], self._candidates[i]) for row, i in enumerate(which)]
        known = [(row, model, candidate) for row, model, candidate in built if model is not None and candidate is not None]
        samples = 1 + round(piece.commands.duration / sample_dt) if piece.t is None else len(piece.t)
        out = np.full((len(which), samples, 3), np.nan)
        if not known:
            return out
        starts = [start_of(piece, candidate.tracked_point) for _, _, candidate in known]
        numba.set_num_threads(min(self._workers, config.NUMBA_NUM_THREADS))
        poses = run_population([model for _, model, _ in known], piece.commands, starts, sample_dt, PLANAR_DT)
        if piece.t is not None:
            poses = resampled(poses, sample_dt, piece.t - piece.t[0])
        offsets = np.array([candidate.tracked_point for _, _, candidate in known])
        out[[row for row, _, _ in known]] = shift_reference(poses, offsets[:, None, :])
        return out


class MujocoPopulation:
    """Candidates of the MuJoCo Husky, one after another: who has many spreads them over threads (`shares`)."""

    def __init__(self, candidates: Sequence[PlantProfile | None]) -> None:
        """Keep the candidates; each is built when it is first driven."""
        self._candidates = candidates
        self._plants: dict[int, MujocoPlant | None] = {}

    def _plant(self, i: int) -> MujocoPlant | None:
        """The candidate's plant; None where its numbers are impossible."""
        if i not in self._plants:
            candidate = self._candidates[i]
            try:
                made = None if candidate is None else MujocoPlant(candidate.parameters, candidate.drive)
                self._plants[i] = made
            except ValueError:
                self._plants[i] = None
        return self._plants[i]

    def poses(self, which: Sequence[int], piece: Piece, sample_dt: float) -> FloatArray:
        """See `Population.poses`."""
        samples = 1 + round(piece.commands.duration / sample_dt) if piece.t is None else len(piece.t)
        out = np.full((len(which), samples, 3), np.nan)
        for row, i in enumerate(which):
            plant, candidate = self._plant(i), self._candidates[i]
            if plant is not None and candidate is not None:
                with contextlib.suppress(SsmrError):
                    out[row] = drive(plant, piece, candidate.tracked_point, sample_dt).pose
        return out


def shares(model: str, size: int, workers: int) -> tuple[list[list[int]], int]:
    """How `size` candidates are rated side by side.

    Returns:
        The indices of each share, and how many shares run at once: MuJoCo's one by one, on as many threads as there are
        workers; a planar model's all in one, whose loop is itself spread over the workers.
    """
    if model == "mujoco":
        return [[i] for i in range(size)], workers
    return [list(range(size))], 1


def make_population(model: str, candidates: Sequence[PlantProfile | None], workers: int) -> Population:
    """Candidates of the plant of that name; None stands for one that cannot be built."""
    return MujocoPopulation(candidates) if model == "mujoco" else PlanarPopulation(candidates, workers)
