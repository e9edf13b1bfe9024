"""Candidates of a plant that has no compiled loop for populations: they are driven one after another."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence

import numpy as np

from ssmr.errors import SsmrError
from ssmr.types import FloatArray, Plant
from validation.plants.kind import PlantProfile, Stretch


class OneByOne:
    """Candidates that are driven one after another; the caller spreads them over threads."""

    def __init__(
        self, build: Callable[[PlantProfile], Plant], candidates: Sequence[PlantProfile | None], workers: int
    ) -> None:
        """Build the candidates.

        Args:
            build: function that builds the plant from its numbers.
            candidates: numbers of each candidate; None stands for one that cannot be built.
            workers: no effect.
        """
        self._candidates = candidates
        self._plants: list[Plant | None] = []
        for candidate in candidates:
            try:
                self._plants.append(None if candidate is None else build(candidate))
            except ValueError:
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
