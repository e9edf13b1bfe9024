"""What a comparison, a fit, a tracked reference or a tuning found: frozen values that programs make and sinks take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ssmr.control.loop import ClosedRun
from ssmr.types import Trajectory
from validation.fit.result import FittedParameter, FitTrace
from validation.track.result import TrackMetrics


@dataclass(frozen=True, eq=False)
class Followed:
    """One reference, followed with the tuned gains and with those that the tuning is held against."""

    label: str
    """Reference, speed and plant in words: `generic at 0.25 m/s, improved`."""
    reference: str
    """As the user named it."""
    speed: float
    """Mean speed of the reference [m/s]."""
    plant: str
    """Which plant was the robot."""
    target: Trajectory
    """The whole reference."""
    tuned: ClosedRun
    """With the tuned gains; it may have been lost."""
    tuned_metrics: TrackMetrics
    """Of `tuned`."""
    tuned_cost: float
    """Infinite where it was lost."""
    baseline: ClosedRun
    """With the gains it is held against."""
    baseline_metrics: TrackMetrics
    """Of `baseline`."""
    baseline_cost: float
    """Infinite where it was lost."""


@dataclass(frozen=True, eq=False)
class TuneResult:
    """What a tuning found."""

    controller: str
    """`pid`, `lqr`, `lqr-scheduled` or `smc`."""
    profile: str
    """Name of the profile that gave the plants' parameters."""
    seed: int
    """Of the search, and of noise and disturbance."""
    status: str
    """`finished` or `interrupted`."""
    stopped_by: str
    """`generations`, `improvement`, `target`, or `interrupt`."""
    cost: float
    """Of the best candidate, over all of `train`."""
    baseline_name: str
    """Name of the gain set that the tuning is held against."""
    baseline_cost: float
    """Its cost; infinite where it loses a reference."""
    cost_name: str
    """`path` (the thesis') or `time`."""
    evaluations: int
    """Candidates rated."""
    generations: int
    """Completed after the initial population."""
    wall_s: float
    """Time that the search took [s]."""
    parameters: tuple[FittedParameter, ...]
    """What was searched; `before` is the baseline's."""
    gains: Mapping[str, float]
    """All gains of the controller, searched or held."""
    notes: tuple[str, ...]
    """Plain sentences: gains at their bounds, lost references."""
    train: tuple[Followed, ...]
    """What the cost is made of."""
    held_out: tuple[Followed, ...]
    """What the tuning has not seen."""
    trace: FitTrace
    """How the search went."""
    options: Mapping[str, object]
    """How it was run."""
    versions: Mapping[str, str]
    """Of this project, Python and the packages that decide numbers."""
