"""Candidates of a plant that has no compiled loop for populations: they are driven one after another."""

from __future__ import annotations

import contextlib
import weakref
from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

import numpy as np

from ssmr.errors import SsmrError
from ssmr.types import FloatArray, Plant
from validation.plants.kind import PlantProfile, Stretch

P = TypeVar("P", bound=Plant)

MOST_SPARE = 256
"""Plants that are kept for the next generation of candidates."""


class Workshop(Generic[P]):
    """Builder of plants that takes back what is done with, and gives it other numbers where the next plant is wanted."""

    def __init__(self, build: Callable[[PlantProfile], P], renumber: Callable[[P, PlantProfile], None]) -> None:
        """Start without plants.

        Args:
            build: function that builds a plant from its numbers, or raises a ValueError.
            renumber: function that gives a plant other numbers, or raises a ValueError; the plant is as if built anew.
        """
        self._build, self._renumber = build, renumber
        self._spare: list[P] = []

    def make(self, candidate: PlantProfile) -> P:
        """Return a plant with a candidate's numbers; it is the caller's until the caller is done with it.

        Raises:
            ValueError: no plant can have them.
        """
        try:
            plant = self._spare.pop()
        except IndexError:
            return self._build(candidate)
        try:
            self._renumber(plant, candidate)
        except ValueError:  # other parts, or numbers that do not go together: building it tells which
            return self._build(candidate)
        return plant

    def done_with(self, plants: Sequence[P | None]) -> None:
        """Take plants back that nobody uses any more."""
        room = max(0, MOST_SPARE - len(self._spare))
        self._spare.extend([plant for plant in plants if plant is not None][:room])


class OneByOne(Generic[P]):
    """Candidates that are driven one after another; the caller spreads them over threads."""

    def __init__(
        self,
        build: Callable[[PlantProfile], P],
        candidates: Sequence[PlantProfile | None],
        workers: int,
        done_with: Callable[[Sequence[P | None]], object] | None = None,
    ) -> None:
        """Build the candidates.

        Args:
            build: function that builds the plant from its numbers.
            candidates: numbers of each candidate; None stands for one that cannot be built.
            workers: no effect.
            done_with: told of the plants when these candidates are forgotten.
        """
        self._candidates = candidates
        self._plants: list[P | None] = []
        for candidate in candidates:
            try:
                self._plants.append(None if candidate is None else build(candidate))
            except ValueError:
                self._plants.append(None)
        if done_with is not None:
            weakref.finalize(self, done_with, self._plants)

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
