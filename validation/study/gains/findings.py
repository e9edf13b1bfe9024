"""The numbers of a gains study: the cost and the errors of each set of gains on each reference."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from validation import store
from validation.plants.profile import Profile
from validation.study.result import require_seed


@dataclass(frozen=True)
class GainsOptions:
    """Options of the study of gains."""

    profile: str | Profile = "thesis-lab"
    """Robot: name of a shipped profile, or path of a TOML file."""
    plants: tuple[str, ...] = ("improved", "mujoco")
    """Plants to drive."""
    seeds: int = 3
    """Number of draws of noise and disturbance."""
    seed: int = 11
    """First seed of noise and disturbance; no shipped set was tuned with seeds from 11 on."""

    def __post_init__(self) -> None:
        """Check the seeds.

        Raises:
            ValueError: no seeds, or no plants.
        """
        require_seed(self.seed, self.seeds)
        if not self.plants:
            raise ValueError("plants must name at least one")


@dataclass(frozen=True)
class GainScore:
    """The score of one set of gains on one reference."""

    gains: str
    """Name of the set."""
    plant: str
    """Name of the plant."""
    reference: str
    """Name of the reference."""
    speed: float
    """Speed along the reference [m/s]."""
    cost: float | None
    """Mean cost (Sec. 4.3.3) over the seeds [1]; None if the reference was lost under one of them."""
    d_rms_m: float | None
    """Mean d_rms over the seeds [m]; None if the reference was lost under one of them."""
    e_rho_rms_m: float | None
    """Mean e_rho over the seeds [m]; None if the reference was lost under one of them."""
    lost: int
    """Number of seeds under which the reference was lost."""


@dataclass(frozen=True)
class GainScores:
    """All scores of a gains study: what tables and pictures are made from."""

    profile: str
    """Name of the profile."""
    options: GainsOptions
    """Options of the study."""
    scores: tuple[GainScore, ...]
    """Scores by plant, reference, speed and set."""
    versions: Mapping[str, str] = field(default_factory=store.versions)
    """Versions of this project, Python and the packages that decide numbers."""

    @property
    def sets(self) -> tuple[str, ...]:
        """Names of the sets, in order."""
        return tuple(dict.fromkeys(s.gains for s in self.scores))

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
        return f"profile {self.profile}, means over the seeds {first} to {last}"
