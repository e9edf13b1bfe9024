"""Values that a tuning finds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from ssmr.control.loop import ClosedRun
from ssmr.metrics.declared import Metrics
from ssmr.types import Trajectory
from validation.bench.gains import GainSet
from validation.bench.mismatch import Mismatch
from validation.fit.data import SearchData


class Followed(NamedTuple):
    """One run along a reference, and how well it went."""

    run: ClosedRun
    """The run; it may have been lost."""
    metrics: Metrics
    """Metrics of the run."""
    cost: float
    """Cost of the run; infinite where it was lost."""

    @property
    def lost(self) -> bool:
        """Whether the robot was lost."""
        return self.run.lost


@dataclass(frozen=True, eq=False)
class TunedRun:
    """One reference, followed with the tuned gains, with those of before, and with those that are shipped."""

    label: str
    """Reference, speed and plant in words: `generic at 0.25 m/s, improved`."""
    reference: str
    """The reference as the user named it."""
    speed: float
    """Mean speed of the reference [m/s]."""
    plant: str
    """Name of the plant that was the robot."""
    target: Trajectory
    """The whole reference."""
    tuned: Followed
    """The run with the tuned gains."""
    baseline: Followed
    """The run with the gains of before."""
    shipped: Followed | None = None
    """The run with the shipped gains; None where those are the gains of before, or where there are none."""

    @property
    def runs(self) -> dict[str, Followed]:
        """All runs by the name of their gains: `tuned`, `baseline` and, if there is one, `shipped`."""
        known = {"tuned": self.tuned, "baseline": self.baseline}
        return known if self.shipped is None else {**known, "shipped": self.shipped}


@dataclass(frozen=True, eq=False, kw_only=True)
class TuneData(SearchData):
    """Tuned gains, and how they follow references beside the gains of before."""

    controller: str
    """Name of the controller."""
    gain_set: GainSet
    """All gains of the controller, searched or held, with their provenance."""
    baseline_name: str
    """Name of the gain set that the tuned one is compared with."""
    baseline_cost: float
    """Cost of that gain set; infinite where it loses a reference."""
    shipped_name: str = ""
    """Name of the gain set that is shipped for this controller and profile; empty where there is none."""
    shipped_cost: float = math.nan
    """Cost of that gain set; infinite where it loses a reference, NaN where there is none."""
    worse_than_start: bool = False
    """Whether the search began with gains that cost less. It never does: the better of both are kept."""
    train: tuple[TunedRun, ...]
    """Runs along the references that it was tuned on."""
    held_out: tuple[TunedRun, ...]
    """Runs along references that the tuning has not seen."""

    tuned_on: tuple[Mismatch, ...] = ()
    """Differences of the drawn robots that it was tuned on; none if it was tuned on the profile's own."""
    scored_on: tuple[Mismatch, ...] = ()
    """Differences of other drawn robots, which the tuning has not seen."""
    scores: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """Costs with each of those robots, means over the references, by gains: `tuned`, `baseline`, and `shipped` if there are
    any others; infinite where a reference was lost."""

    @property
    def gains(self) -> Mapping[str, float]:
        """All gains by name."""
        return self.gain_set.values

    @property
    def source(self) -> str:
        """The references that it was tuned on, each once, separated by commas."""
        return ",".join(dict.fromkeys(run.reference for run in self.train))

    @property
    def held_gains(self) -> dict[str, float]:
        """The gains that were not searched."""
        searched = {p.name for p in self.parameters}
        return {name: value for name, value in self.gains.items() if name not in searched}
