"""What a comparison, a fit, a tracked reference or a tuning found: frozen values that programs make and sinks take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ssmr.closed_loop import ClosedRun
from ssmr.metrics import HorizonErrors, PathMetrics
from ssmr.types import Commands, FloatArray, Trajectory
from validation.mujoco_plant import Health
from validation.terrain import FLAT, Terrain
from validation.wheel_loads import WheelLoads


@dataclass(frozen=True, eq=False)
class PlantResult:
    """One plant's answer to the commands."""

    name: str
    """`coulomb`, `improved`, `linear`, `kinematic` or `mujoco`."""
    pieces: tuple[Trajectory, ...]
    """Its motion, one piece for each gap-free stretch of the source, at the same stamps as the reference's piece."""
    metrics: PathMetrics
    """Distances from the reference, over all pieces."""
    horizons: Mapping[float, HorizonErrors]
    """Errors of the relative pose, by horizon [s]; empty where the reference is a plant."""
    wall_s: float
    """Time that simulating took [s]."""
    real_time_factor: float
    """Simulated over wall time [1]."""
    health: Health | None = None
    """Whether the wheel loads can be believed; only the MuJoCo Husky has them, and on uneven ground they have no verdict."""
    tracked_point: tuple[float, float] = (0.0, 0.0)
    """The point (x, y) of the plant's body whose motion `pieces` is [m]."""
    loads: WheelLoads | None = None
    """What its wheels carried; only the MuJoCo Husky knows."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """Every plant against the reference on one source."""

    source: str
    """As the user named it: `traj4`, or the file of a recording."""
    profile: str
    """Name of the profile that gave the parameters."""
    reference_name: str
    """Name of the reference plant, or `recording`."""
    reference: tuple[Trajectory, ...]
    """The reference's motion, piece by piece."""
    commands: tuple[Commands, ...]
    """What drove the plants, piece by piece; each begins at the first stamp of its piece."""
    plants: Mapping[str, PlantResult]
    """By name, in the order asked for; the reference plant is among them."""
    seed: int
    """Seed of noise and disturbance."""
    options: Mapping[str, str | float | bool]
    """How it was run: input, noise, disturbance, horizons, time span."""
    versions: Mapping[str, str]
    """Of this project, Python and the packages that decide numbers."""
    terrain: Terrain = FLAT
    """What the MuJoCo Husky stood on."""


@dataclass(frozen=True)
class FittedParameter:
    """One number that a fit found."""

    name: str
    """As the command line calls it."""
    unit: str
    """Of all numbers here; `1` for a pure number."""
    value: float
    """The best found."""
    lower: float
    """Bound of the search."""
    upper: float
    """Bound of the search."""
    scale: str
    """`linear` or `log`: how the space between the bounds was searched."""
    before: float
    """What it was in the profile that the fit began with; infinite for a limit that was off."""
    at_bound: bool
    """It ended at one of its bounds."""
    standard_error: float | None = None
    """None where it could not be estimated, or was not."""
    interval_95: tuple[float, float] | None = None
    """Where it lies with 95 %, by the same estimate and within the bounds."""


@dataclass(frozen=True, eq=False)
class FitTrace:
    """How a fit went, generation by generation, in the unit cube."""

    best_cost: FloatArray
    """(G,) least cost yet; the first is that of the initial population."""
    median_cost: FloatArray
    """(G,) median over the population's members of finite cost; NaN where there is none."""
    best: FloatArray
    """(G, n) the best member."""
    population: FloatArray
    """(S, n) all members at the end."""
    costs: FloatArray
    """(S,) their costs; infinite for one that never had any."""


@dataclass(frozen=True, eq=False)
class Scored:
    """A fitted plant on one source, used for the fit or held out."""

    label: str
    """The source as the user named it, with its input where it is a recording driven by both."""
    reference_name: str
    """The plant that made the truth, or `recording`."""
    truth: tuple[Trajectory, ...]
    """The motion wanted, piece by piece."""
    motion: tuple[Trajectory, ...]
    """The fitted plant's, at the same stamps."""
    before: tuple[Trajectory, ...]
    """The same plant's with the numbers of the profile that the fit began with; empty where it could not be driven."""
    metrics: PathMetrics
    """Distances of `motion` from `truth`, over all pieces."""
    horizons: Mapping[float, HorizonErrors]
    """Errors of the relative pose, by horizon [s]; empty where the truth is a plant's."""


@dataclass(frozen=True, eq=False)
class FitResult:
    """What a fit found, and how far to believe it."""

    model: str
    """The plant that was fitted."""
    profile: str
    """Name of the profile that the fit began with."""
    source: str
    """What it was fitted to, as the user named it."""
    seed: int
    """Of the search."""
    status: str
    """`finished` or `interrupted`."""
    stopped_by: str
    """`generations`, `improvement`, `target`, or `interrupt`."""
    cost: float
    """Of the best candidate."""
    cost_name: str
    """`path`, `sync` or `horizon`."""
    evaluations: int
    """Candidates rated."""
    generations: int
    """Completed after the initial population."""
    wall_s: float
    """Time that the search took [s], over all runs that a resumed fit consists of."""
    parameters: tuple[FittedParameter, ...]
    """In the order of the search."""
    correlation: FloatArray | None
    """(n, n) of the parameters; None where it was not estimated."""
    uncertainty_method: str
    """How the standard errors were found; empty where they were not."""
    notes: tuple[str, ...]
    """What the fit cannot say, in plain sentences."""
    train: tuple[Scored, ...]
    """On what it was fitted to, source by source."""
    train_metrics: PathMetrics
    """Over all of `train`."""
    train_horizons: Mapping[float, HorizonErrors]
    """Over all of `train`."""
    before_horizons: Mapping[float, HorizonErrors]
    """Over all of `train`, of the plant before the fit; empty where it could not be driven everywhere."""
    held_out: tuple[Scored, ...]
    """On what the fit has not seen."""
    trace: FitTrace
    """How the search went."""
    options: Mapping[str, object]
    """How it was run: objective, weights, strategy, population, spans."""
    versions: Mapping[str, str]
    """Of this project, Python and the packages that decide numbers."""


@dataclass(frozen=True)
class TrackMetrics:
    """How well a reference was followed: the thesis' figures, and those that see time and errors."""

    path: PathMetrics
    """Distances of the robot's path from the reference, and errors at equal times."""
    e_rho_rms_m: float
    """Root mean square of the signed distance to the target [m]."""
    e_y_rms_m: float
    """Of the offset across [m]."""
    e_alpha_rms_rad: float
    """Of the heading error, zero beyond 0.4 m from the target [rad]."""
    u_rms_ratio: float
    """Root mean square of speed over the reference's mean speed [1] (Sec. 4.4.3)."""
    saturated_fraction: float
    """Share of time in which a side's torque, or a command, was at its limit [1]."""


@dataclass(frozen=True, eq=False)
class TrackResult:
    """A robot that followed a reference under a controller."""

    controller: str
    """`pid`, `lqr`, `lqr-scheduled` or `smc`."""
    gains_name: str
    """Name or file of the gain set."""
    gains: Mapping[str, float]
    """By name."""
    reference: str
    """As the user named it."""
    speed: float
    """Mean speed of the reference [m/s]."""
    plant: str
    """Which plant was the robot."""
    profile: str
    """Name of the profile that gave its parameters."""
    seed: int
    """Of noise and disturbance."""
    run: ClosedRun
    """What happened, tick by tick."""
    target: Trajectory
    """The reference at the same ticks."""
    metrics: TrackMetrics
    """How well."""
    wall_s: float
    """Time that simulating took [s]."""
    options: Mapping[str, object]
    """How it was run: feedback, disturbance, look-ahead, periods."""
    versions: Mapping[str, str]
    """Of this project, Python and the packages that decide numbers."""
    terrain: Terrain = FLAT
    """What a MuJoCo Husky stood on."""


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
