"""The result of a gains study: the cost and the errors of each set of gains on each reference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from validation.plants.profile import Profile
from validation.show.tables import NOTHING, Cell, Grid
from validation.simulator.description import Robot
from validation.study.result import StudyResult, require_seeds
from validation.study.scores import FollowedScore


@dataclass(frozen=True)
class GainsOptions:
    """Options of the study of gains."""

    profile: str | Profile | None = None
    """Robot: name of a shipped profile, or path of a TOML file."""
    plants: tuple[str, ...] = ("improved", "mujoco")
    """Plants to drive."""
    seeds: int = 3
    """Number of draws of noise and disturbance."""
    seed: int = 11
    """First seed of noise and disturbance; no shipped set was tuned with seeds from 11 on."""
    robot: str | Robot | None = None
    """Robot: its name or the path of its file; the profile's if none is named."""

    def __post_init__(self) -> None:
        """Raise a ValueError for no seeds, or no plants."""
        require_seeds(self)
        if not self.plants:
            raise ValueError("plants must name at least one")


@dataclass(frozen=True, kw_only=True)
class GainScore(FollowedScore):
    """The score of one set of gains on one reference."""

    gains: str
    """Name of the set."""
    plant: str
    """Name of the plant."""
    reference: str
    """Name of the reference."""
    speed: float
    """Speed along the reference [m/s]."""


_MEASURES = (("cost", "Cost (Sec. 4.3.3)", "", 1.0, 2), ("d_rms_m", "d_rms", "mm", 1e3, 1))
"""Field, title, unit, scale and digits of each measure that has a table."""


@dataclass(frozen=True)
class GainStudy(StudyResult):
    """The cost of every shipped set of gains on every named reference."""

    study = "gains"
    title = "Gains"
    profile: str
    """Name of the profile."""
    options: GainsOptions
    """Options of the study."""
    scores: tuple[GainScore, ...]
    """Scores by plant, reference, speed and set."""

    @property
    def sets(self) -> tuple[str, ...]:
        """Names of the sets, in order."""
        return tuple(dict.fromkeys(s.gains for s in self.scores))

    @property
    def plants(self) -> tuple[str, ...]:
        """Names of the plants that were driven, in order."""
        return tuple(dict.fromkeys(s.plant for s in self.scores))

    def by_reference(self, plant: str) -> list[tuple[str, list[GainScore]]]:
        """Return the scores of all sets on a plant, by reference and speed."""
        rows: dict[str, list[GainScore]] = {}
        for s in self.scores:
            if s.plant == plant:
                rows.setdefault(f"{s.reference} {s.speed:g}", []).append(s)
        return list(rows.items())

    def heading(self) -> str:
        """Return what was studied, in one line."""
        first, last = self.options.seed, self.options.seed + self.options.seeds - 1
        return f"{self.of_profile(self.profile)}, means over the seeds {first} to {last}"

    def grids(self) -> list[Grid]:
        """Return cost and d_rms of every set by reference, for each plant."""
        return [self._grid(plant, k) for plant in self.plants for k in range(len(_MEASURES))]

    def findings(self) -> dict[str, Any]:
        """Return seeds, plants and all scores."""
        o = self.options
        return {
            "profile": self.profile,
            "seeds": list(range(o.seed, o.seed + o.seeds)),
            "plants": list(o.plants),
            "scores": [vars(s) for s in self.scores],
        }

    def _grid(self, plant: str, measure: int) -> Grid:
        """Return one measure of every set by reference; the least of each row is emphasised."""
        name, title, unit, scale, digits = _MEASURES[measure]
        rows, every = [], dict[str, list[float | None]]()
        for label, scores in self.by_reference(plant):
            values: list[float | None] = [getattr(s, name) for s in scores]
            least = min((v for v in values if v is not None), default=None)
            texts = ["lost" if v is None else f"{scale * v:.{digits}f}" for v in values]
            rows.append((Cell(label), *(Cell(text, v == least) for text, v in zip(texts, values, strict=True))))
            for s, v in zip(scores, values, strict=True):
                every.setdefault(s.gains, []).append(v)
        means = []
        for values in every.values():
            known = [v for v in values if v is not None]
            means.append(Cell(f"{scale * np.mean(known):.{digits}f}" if len(known) == len(values) else NOTHING))
        rows.append((Cell("mean"), *means))
        header = (("reference", ""), *((" ".join(n.rsplit("-", 1)), unit) for n in self.sets))
        return Grid(header, (tuple(rows),), 1, f"{title}, plant {plant}; {self.heading()}")
