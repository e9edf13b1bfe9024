"""Many candidates of one plant, driven over the same stretch of a source on all threads of one process."""

from __future__ import annotations

from collections.abc import Sequence

from validation.plants.kind import PlantProfile, Population
from validation.plants.table import plant_kind


def shares(plant: str, size: int, workers: int) -> tuple[list[list[int]], int]:
    """Return how `size` candidates of a plant are rated side by side.

    Returns:
        The indices of each share, and how many shares run at once: single candidates on as many threads as there are
        workers, or all in one share whose compiled loop is itself spread over the workers.
    """
    if plant_kind(plant).together:
        return [list(range(size))], 1
    return [[i] for i in range(size)], workers


def make_population(plant: str, candidates: Sequence[PlantProfile | None], workers: int) -> Population:
    """Return candidates of the plant of that name, ready to be driven; None stands for one that cannot be built."""
    return plant_kind(plant).population(candidates, workers)
