"""How fast a Husky loses its way by dead reckoning: the state filter of encoders and gyro against MuJoCo's truth.

On every surface the same mission is driven: a regulator that sees the true state keeps the robot on the reference, and the
filter looks on. So distance and turns are the same everywhere, if the reference is one that every robot can follow, and
between seeds nothing differs but the sensors' noise.

Errors are those of the pose relative to where a stretch of `WINDOW` began, for on a path that closes an error of scale
returns to nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from ssmr.control.loop import LoopSettings, make_clock
from ssmr.control.waypoints import Waypoints
from ssmr.estimation.ekf import EkfSettings, run_ekf
from ssmr.estimation.sensing import SensorModel, simulate_sensors
from ssmr.geometry import relative, wrap_angle
from ssmr.parameters import require_in_range
from ssmr.types import FloatArray, State, Trajectory
from validation import cli, store
from validation.plants.profile import Profile
from validation.robots.plant import MujocoPlant
from validation.show.tables import NOTHING, Cell, Grid, markdown_table
from validation.track.gains import DEFAULT, load_gains
from validation.track.tracking import Robot, make_controller, odometry_of, require_practicable, run_robots

SCHEMA = "ssmr.study/1"
TRACKER = "lqr-scheduled"
"""What keeps the robot on the reference, with the gains of its class; whatever does that well will do."""
TICK = 0.01
"""Period of the tracker, and of the truth's samples [s]: the filter's 20 ms are two of them."""
WINDOW = 3.0
"""Length of a stretch over which relative errors are taken [m]: 12 s at 0.25 m/s."""
CURVE = 161
"""Samples of an error over the distance, from 0 to the end of the drive."""
REAL_BIAS = -0.0156
"""A real Husky's gyro on tile [rad/s]."""
STILL = 1e-3
"""Who turns by less has no yaw drift per radian [rad]."""


@dataclass(frozen=True)
class Variant:
    """A filter and its sensors."""

    name: str
    """What tables call it."""
    gyro: bool = True
    """Whether there is one."""
    bias: float = 0.0
    """Of the gyro, unknown to the filter [rad/s]."""
    radius_known: bool = False
    """Whether the odometry has the tyres' rolling radius, instead of the driver's."""


def variants(bias: float = REAL_BIAS) -> tuple[Variant, ...]:
    """The filters that are held against each other; `bias` [rad/s] is that of the gyro of one of them."""
    return (
        Variant("wheels", gyro=False),
        Variant("wheels + gyro"),
        Variant("biased gyro", bias=bias),
        Variant("radius known", radius_known=True),
    )


@dataclass(frozen=True, eq=False)
class Surface:
    """A robot on a ground."""

    name: str
    """What tables call it."""
    profile: Profile
    """Its numbers, but for the friction."""
    friction: float
    """Of tyre on ground [1]."""

    def robot(self, timestep: float) -> Robot:
        """The MuJoCo Husky there, with a physics step [s]."""
        section = self.profile.plants["mujoco"]
        parameters = replace(section.parameters, friction=self.friction, timestep=timestep)
        return Robot("mujoco", MujocoPlant(parameters, section.drive))

    def settings(self, variant: Variant) -> EkfSettings:
        """What a filter believes there: the driver's half-track, and its radius or the true one."""
        section = self.profile.plants["mujoco"]
        odometry = odometry_of(section.drive)
        return replace(odometry, radius=section.parameters.wheel_radius) if variant.radius_known else odometry


def surfaces_of(profiles: Sequence[Profile], frictions: Sequence[float]) -> tuple[Surface, ...]:
    """Every profile as it is, then the last one's robot with other frictions.

    Raises:
        ValueError: two of them would have one name.
    """
    last = profiles[-1]
    made = [Surface(p.name, p, p.plants["mujoco"].parameters.friction) for p in profiles]
    made += [Surface(f"{last.name}, friction {f:g}", last, f) for f in frictions]
    if len({s.name for s in made}) != len(made):
        raise ValueError("a surface is named twice")
    return tuple(made)


@dataclass(frozen=True)
class FilterSettings:
    """What a study can be asked for besides surfaces and references."""

    seeds: int = 20
    """How many draws of the sensors' noise."""
    seed: int = 0
    """The first of them."""
    bias: float = REAL_BIAS
    """Of the biased gyro [rad/s]."""
    timestep: float = 0.002
    """Physics step [s]."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            ValueError: no seeds, a bias that is no number, or a step that the simulation cannot have.
        """
        if self.seeds < 1:
            raise ValueError(f"--seeds {self.seeds} must be positive")
        if not math.isfinite(self.bias):
            raise ValueError(f"--bias {self.bias} must be finite")
        require_in_range(self, "timestep", 1e-5, 0.01)


@dataclass(frozen=True)
class Drift:
    """How far a filter is off after one drive."""

    position: float
    """Error of the relative position over stretches of `WINDOW`, over their length [1]."""
    yaw: float
    """Error of the relative yaw over the same, over what the robot turned meanwhile [1]; NaN where it did not turn."""
    end: float
    """Error of the position at the end over the whole distance [1]."""
    end_yaw: float
    """Error of the yaw at the end, signed [rad]."""


def travelled(truth: Trajectory) -> FloatArray:
    """(M,) distance driven [m]."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truth.xy, axis=0).T))])


def drift_of(believed: Trajectory, truth: Trajectory) -> Drift:
    """How far a filter is off.

    Args:
        believed: what it says, at the instants of `truth`.
        truth: where the robot was; at least `WINDOW` long.

    Raises:
        ValueError: the drive is too short.
    """
    along = travelled(truth)
    count = int(along[-1] / WINDOW + 1e-9)
    if count < 1:
        raise ValueError(f"a drive of {along[-1]:.2f} m is shorter than the {WINDOW:g} m over which drift is taken")
    ends = np.minimum(np.searchsorted(along, WINDOW * np.arange(count + 1) - 1e-9), len(along) - 1)
    first, last = ends[:-1], ends[1:]
    error = relative(truth.pose[first], truth.pose[last]) - relative(believed.pose[first], believed.pose[last])
    turned = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(truth.pose[:, 2])))])
    turn = float(turned[ends[-1]] - turned[ends[0]])
    off = believed.pose[-1] - truth.pose[-1]
    return Drift(
        float(np.hypot(error[:, 0], error[:, 1]).sum() / (along[ends[-1]] - along[ends[0]])),
        float(np.abs(wrap_angle(error[:, 2])).sum() / turn) if turn > STILL else math.nan,
        float(np.hypot(off[0], off[1]) / along[-1]),
        float(off[2]),
    )


@dataclass(frozen=True, eq=False)
class Reckoned:
    """One filter on one surface along one reference, under all seeds."""

    drifts: tuple[Drift, ...]
    """By seed."""
    errors: FloatArray
    """(seeds, CURVE) error of the position [m] over the distance, evenly from 0 to the end."""

    def mean(self, name: str) -> float:
        """Mean over seeds of a field of `Drift`."""
        return float(np.mean([getattr(d, name) for d in self.drifts]))

    def std(self, name: str) -> float:
        """Standard deviation over seeds of the same; 0 for one."""
        values = [getattr(d, name) for d in self.drifts]
        return float(np.std(values, ddof=1)) if len(values) > 1 else 0.0


@dataclass(frozen=True, eq=False)
class Drive:
    """One reference driven on one surface."""

    surface: str
    """Its name."""
    reference: str
    """As the user named it."""
    distance: float
    """Driven [m]."""
    turned: float
    """To either side [rad]."""
    slide: float
    """Root mean square of the lateral speed, which the filter takes to be 0, over that of the speed [1]."""
    filters: Mapping[str, Reckoned]
    """By name of the variant."""


@dataclass(frozen=True, eq=False)
class FilterStudy:
    """A study that was made."""

    surfaces: tuple[Surface, ...]
    """On which grounds."""
    references: tuple[str, ...]
    """Along what."""
    speed: float
    """Of the references [m/s]."""
    settings: FilterSettings
    """What was asked for."""
    drives: tuple[Drive, ...]
    """Reference by reference, surface by surface."""
    versions: Mapping[str, str] = field(default_factory=store.versions)
    """Of the packages."""


def check(surfaces: Sequence[Surface], references: Mapping[str, Waypoints], settings: FilterSettings) -> None:
    """Refuse, before anything is driven, what cannot be.

    Raises:
        ValueError: a surface, a step or a reference that do not go together.
    """
    loop = LoopSettings("truth", disturbance=False, position_period=TICK)
    for surface in surfaces:
        surface.robot(settings.timestep)
        for name, waypoints in references.items():
            require_practicable(waypoints, surface.profile.plants["mujoco"].drive, name)
            make_clock(waypoints, loop, settings.timestep)
            if waypoints.speed * waypoints.duration < 1.1 * WINDOW:
                raise ValueError(f"{name} is shorter than the {WINDOW:g} m over which drift is taken, with some to spare")


def study_filter(
    surfaces: Sequence[Surface],
    references: Mapping[str, Waypoints],
    settings: FilterSettings | None = None,
    workers: int | None = None,
) -> FilterStudy:
    """Drive every reference on every surface and let every filter look on.

    Args:
        surfaces: robots and grounds.
        references: by name; of one speed.
        settings: seeds, bias, physics step.
        workers: threads; the result does not depend on it.

    Raises:
        LostError: a robot left the reference.
        ValueError: numbers that do not go together.
    """
    settings = settings or FilterSettings()
    robots = [s.robot(settings.timestep) for s in surfaces]
    tracker = load_gains(TRACKER, DEFAULT)
    laws = [make_controller(s.profile, tracker) for s in surfaces]
    loop = LoopSettings("truth", disturbance=False, position_period=TICK)
    drives = []
    with cli.progress() as bar:
        task = bar.add_task("driving", total=len(references) * len(surfaces))
        for name, waypoints in references.items():
            runs = run_robots(robots, laws, [loop] * len(robots), waypoints, [0], workers)
            for surface, run in zip(surfaces, runs, strict=True):
                truth = run.require_kept(f"{TRACKER} on {name}, {surface.name},").motion
                drives.append(_look_on(surface, name, truth, settings))
                bar.advance(task)
    speed = next(iter(references.values())).speed
    return FilterStudy(tuple(surfaces), tuple(references), speed, settings, tuple(drives))


def _look_on(surface: Surface, reference: str, truth: Trajectory, settings: FilterSettings) -> Drive:
    """All filters under all seeds along one drive."""
    along, filters = travelled(truth), {}
    for variant in variants(settings.bias):
        drifts, errors = [], []
        for k in range(settings.seeds):
            rng = np.random.default_rng([settings.seed, k])
            log = simulate_sensors(truth, rng, SensorModel(gyro_bias=variant.bias))
            (x, y, yaw), (v, _, w) = truth.pose[0].tolist(), truth.twist[0].tolist()
            start = State(x, y, yaw, v_x=v, yaw_rate=w)
            gyro = log.gyro if variant.gyro else None
            believed = run_ekf(log.t, log.left, log.right, gyro, surface.settings(variant), start)
            seen = np.searchsorted(truth.t, log.t - 1e-9)
            then = Trajectory(truth.t[seen], truth.pose[seen], truth.twist[seen], truth.wheels[seen])
            drifts.append(drift_of(believed, then))
            off = np.hypot(*(believed.xy - then.xy).T)
            errors.append(np.interp(np.linspace(0.0, along[-1], CURVE), along[seen], off))
        filters[variant.name] = Reckoned(tuple(drifts), np.array(errors))
    slide = math.sqrt(np.mean(np.square(truth.twist[:, 1])) / np.mean(np.square(truth.twist[:, 0])))
    turned = float(np.abs(np.diff(truth.pose[:, 2])).sum())
    return Drive(surface.name, reference, float(along[-1]), turned, slide, MappingProxyType(filters))


def as_document(study: FilterStudy) -> dict[str, Any]:
    """study.json."""
    s = study
    drives = [
        {
            "reference": d.reference,
            "surface": d.surface,
            "distance_m": d.distance,
            "turned_rad": d.turned,
            "slide_ratio": d.slide,
            "filters": {
                name: {
                    "position_drift_ratio": {"mean": r.mean("position"), "std": r.std("position")},
                    "yaw_drift_ratio": {"mean": r.mean("yaw"), "std": r.std("yaw")},
                    "end_position_ratio": {"mean": r.mean("end"), "std": r.std("end")},
                    "end_yaw_rad": {"mean": r.mean("end_yaw"), "std": r.std("end_yaw")},
                    "error_m": r.errors.mean(axis=0).tolist(),
                }
                for name, r in d.filters.items()
            },
        }
        for d in s.drives
    ]
    document = {
        "schema": SCHEMA,
        "study": "filter",
        "profile": ", ".join(dict.fromkeys(surface.profile.name for surface in s.surfaces)),
        "references": list(s.references),
        "speed_m_s": s.speed,
        "seed": s.settings.seed,
        "options": {k: v for k, v in asdict(s.settings).items() if k != "seed"},
        "window_m": WINDOW,
        "tracker": TRACKER,
        "variants": [asdict(v) for v in variants(s.settings.bias)],
        "versions": dict(s.versions),
        "drives": drives,
        "surfaces": {
            surface.name: {
                "profile": surface.profile.name,
                "friction": surface.friction,
                "filter": asdict(surface.settings(Variant("wheels + gyro"))),
                "parameters": surface.profile.as_dict()["mujoco"],
            }
            for surface in s.surfaces
        },
    }
    plain = store.plain(document)
    assert isinstance(plain, dict)
    return plain


def _with_std(reckoned: Reckoned, name: str) -> str:
    mean, std = 100.0 * reckoned.mean(name), 100.0 * reckoned.std(name)
    return f"{mean:.2f} ± {std:.2f}" if math.isfinite(mean) else NOTHING


def drift_grid(study: FilterStudy, name: str) -> Grid:
    """A field of `Drift` in percent: a drive a row, a filter a column."""
    header = (("reference", ""), ("surface", ""), *((v.name, "%") for v in variants()))
    groups = [
        tuple(
            (Cell(d.reference), Cell(d.surface), *(Cell(_with_std(r, name)) for r in d.filters.values()))
            for d in study.drives
            if d.reference == reference
        )
        for reference in study.references
    ]
    return Grid(header, tuple(groups), left=2)


def heading(study: FilterStudy) -> str:
    """What was studied, in one line."""
    s = study
    return f"{', '.join(s.references)} at {s.speed:.3g} m/s, {s.settings.seeds} seeds from {s.settings.seed}"


def captions(study: FilterStudy) -> tuple[str, str]:
    """What the two tables mean."""
    return (
        f"Error of the relative position over stretches of {WINDOW:g} m, in percent of their length; mean and standard "
        "deviation over seeds.",
        "Error of the relative yaw over the same stretches, in percent of what the robot turned in them. "
        f"The biased gyro shows {study.settings.bias:+g} rad/s at rest.",
    )


def markdown(study: FilterStudy) -> list[str]:
    """study.md, as lines."""
    position, yaw = captions(study)
    lines = [f"# Dead reckoning: {heading(study)}", ""]
    lines += ["## Position", "", *markdown_table(drift_grid(study, "position")), "", position, ""]
    lines += ["## Yaw", "", *markdown_table(drift_grid(study, "yaw")), "", yaw, ""]
    versions = ", ".join(f"{k} {v}" for k, v in study.versions.items() if k in ("mujoco", "numpy", "numba", "ssmr-testbed"))
    return [*lines, f"Step {study.settings.timestep:g} s; {versions}.", ""]
