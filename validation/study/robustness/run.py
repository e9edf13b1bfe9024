"""How much a trajectory tracker bears: closed loops of MuJoCo Huskies that are not the robot their controller expects.

Around a profile stands a grid of mismatches: friction, centre of mass, delay, sensor noise and torque. Every controller
meets the same mismatches with the same noise: first each alone, under several seeds, which tells what breaks whom; then a
random sample of the full grid, which tells how errors spread.

The torque limit of a profile need not bind: those shipped have 400 N m a wheel, beyond the peaks that a step of the command
takes. So the share of `LEVELS` is not of the limit but of the greatest torque that the nominal robot needs when it is driven
along the reference open loop, at the reference's own velocities. That is the mission's need and no controller's doing.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from ssmr.control.laws import LAWS
from ssmr.control.loop import POSITION_PERIOD, ClosedRun, Feedback, LoopSettings, draw, make_clock
from ssmr.control.tick import LOST
from ssmr.control.waypoints import Waypoints
from ssmr.errors import SsmrError
from ssmr.estimation.ekf import SensorModel
from ssmr.parameters import require_in_range
from ssmr.robot.drive import WHOLE_STEPS
from ssmr.robot.sensors import SensorNoise
from ssmr.robot.vehicle import Drive
from ssmr.types import Commands, Trajectory
from validation import cli, store
from validation.plants.profile import Profile
from validation.robots.plant import Health, MujocoPlant, check_health
from validation.show.tables import Cell, Grid, Unit, markdown_table
from validation.track import gains as gain_sets
from validation.track.gains import DEFAULT, GainSet, load_gains
from validation.track.tracking import Robot, make_controller, odometry_of, rate, require_practicable, run_robots

SCHEMA = "ssmr.study/1"
BATCH = 64
"""Robots in a batch at most."""
CVAR_LEVEL = 0.5
"""The conditional value at risk is the mean of what is worse than this quantile."""
COARSE_PERIOD = 0.01
"""Period of the position loop where physics steps do not divide the usual one [s]."""
MILLIMETRES = Unit("mm", 1e3, 1)
NOMINAL = "nominal"
"""What a robot without a mismatch is called."""

LEVELS: Mapping[str, tuple[float, ...]] = MappingProxyType(
    {
        "friction": (1.0, 0.7, 1.3),
        "com_x": (0.0, -0.05, 0.05),
        "com_y": (0.0, -0.05, 0.05),
        "delay": (0.0, -0.1, 0.1),
        "noise": (1.0, 2.0),
        "torque": (1.0, 0.8),
    }
)
"""Of each field of `Mismatch`, the nominal level first."""

Kind = Literal["nominal", "alone", "grid"]


MOST = 100_000
"""Seeds and runs that are allowed."""


@dataclass(frozen=True)
class Mismatch:
    """What a robot has other than its profile."""

    friction: float = 1.0
    """Factor of the friction of tyre on ground [1]."""
    com_x: float = 0.0
    """Shift of the centre of mass forward [m]."""
    com_y: float = 0.0
    """The same to the left [m]."""
    delay: float = 0.0
    """Added to the dead times of commands, which do not become negative [s]."""
    noise: float = 1.0
    """Factor of the variances of what the controller sees [1]."""
    torque: float = 1.0
    """Below 1: torque limit over the torque that the reference takes [1]; 1: the profile's limit."""

    @property
    def label(self) -> str:
        """What differs, in words; `nominal` for nothing."""
        differing = [level_text(name, value) for name, value in asdict(self).items() if value != LEVELS[name][0]]
        return ", ".join(differing) or NOMINAL


def level_text(name: str, value: float) -> str:
    """One field of a mismatch, in words."""
    if name in ("friction", "torque"):
        return f"{name} {100.0 * (value - 1.0):+.0f} %"
    if name == "noise":
        return f"noise variance x {value:g}"
    if name == "delay":
        return f"delay {value:+.1f} s"
    where = {"com_x": ("ahead", "back"), "com_y": ("left", "right")}[name][value < 0.0]
    return f"mass {100.0 * abs(value):.0f} cm {where}"


@dataclass(frozen=True)
class Case:
    """One run that every controller has to make."""

    kind: Kind
    """The robot of the profile, one mismatch `alone`, or a point of the full grid."""
    mismatch: Mismatch
    """What the robot has other than its profile."""
    seed: int
    """Of noise and disturbance."""


def alone() -> list[Mismatch]:
    """Every level other than the nominal, each on its own."""
    return [Mismatch(**{name: value}) for name, levels in LEVELS.items() for value in levels[1:]]


def full_grid() -> list[Mismatch]:
    """Every combination of levels."""
    return [Mismatch(**dict(zip(LEVELS, values, strict=True))) for values in itertools.product(*LEVELS.values())]


def make_cases(runs: int, seeds: int, seed: int) -> list[Case]:
    """The runs of a study.

    Args:
        runs: how many; what the nominal robot and the single mismatches leave is drawn from the full grid, no point of it
            twice until all had their turn.
        seeds: under how many seeds of noise, counted from `seed`, the nominal robot and each single mismatch are driven.
        seed: of the sample; and the first of noise. Runs of the sample have a noise of their own each.

    Raises:
        ValueError: too few runs for that.
    """
    noise = range(seed, seed + seeds)
    single = [Case("nominal", Mismatch(), k) for k in noise] + [Case("alone", m, k) for m in alone() for k in noise]
    left = runs - len(single)
    if left < 2:
        raise ValueError(
            f"{runs} runs are too few: {len(single)} go to single mismatches under {seeds} seeds; at least 2 more"
        )
    rng, grid = np.random.default_rng(seed), full_grid()
    order = np.concatenate([rng.permutation(len(grid)) for _ in range(math.ceil(left / len(grid)))])[:left]
    return [*single, *(Case("grid", grid[point], seed + seeds + k) for k, point in enumerate(order))]


@dataclass(frozen=True)
class RobustnessSettings:
    """What a study can be asked for besides controllers, reference and profile."""

    runs: int = 200
    """For each controller."""
    seeds: int = 4
    """Of noise, for each single mismatch."""
    seed: int = 0
    """Of everything random."""
    bound: float = 0.5
    """A run whose d_rms or root mean square of e_rho is greater has failed [m]."""
    feedback: Feedback = "noisy"
    """What controllers see."""
    disturbance: bool = True
    """Push the yaw at random (Sec. 3.4.5)."""
    timestep: float = 0.002
    """Physics step [s]. With 5 ms errors change by less than 8 %, but peaks of torque grow by 1.8 and the wheel loads under
    sliding mode are no longer smooth."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            ValueError: no seeds, too few runs, or a bound or a step that cannot be.
        """
        if not 1 <= self.seeds <= MOST or self.runs > MOST:
            raise ValueError(f"--seeds {self.seeds} must be positive, and no more than {MOST} like --runs {self.runs}")
        require_in_range(self, "timestep", 1e-5, 0.01)
        if not 0.0 < self.bound <= LOST:
            raise ValueError(
                f"--bound {self.bound:g} m must be positive and at most {LOST:g} m, where a robot counts as lost"
            )
        make_cases(self.runs, self.seeds, self.seed)
        self.loop(Mismatch())

    @property
    def position_period(self) -> float:
        """Period of the position loop [s]: the usual one, if physics steps divide it."""
        steps = POSITION_PERIOD / self.timestep
        return POSITION_PERIOD if abs(steps - round(steps)) <= WHOLE_STEPS else COARSE_PERIOD

    def loop(self, mismatch: Mismatch, drive: Drive | None = None) -> LoopSettings:
        """What stands around controller and robot; a state filter knows the driver's odometry."""
        noise = SensorNoise(**{name: mismatch.noise * value for name, value in asdict(SensorNoise()).items()})
        sensors = SensorModel()
        sensors = replace(
            sensors,
            variance_encoder=mismatch.noise * sensors.variance_encoder,
            variance_gyro=mismatch.noise * sensors.variance_gyro,
        )
        return LoopSettings(
            self.feedback,
            noise,
            sensors,
            odometry_of(drive or Drive()),
            disturbance=self.disturbance,
            position_period=self.position_period,
        )


def mismatched(profile: Profile, mismatch: Mismatch, timestep: float, torque: float) -> Robot:
    """A robot that is not quite the profile's.

    Args:
        profile: its numbers.
        mismatch: and what differs.
        timestep: physics step [s].
        torque: greatest of a wheel that the reference takes [N m].

    Raises:
        ValueError: numbers that do not go together.
    """
    section, m = profile.plants["mujoco"], mismatch
    p, drive = section.parameters, section.drive
    calibration = replace(
        p, friction=m.friction * p.friction, com_x=p.com_x + m.com_x, com_y=p.com_y + m.com_y, timestep=timestep
    )
    driver = replace(
        drive,
        delay_v=max(0.0, drive.delay_v + m.delay),
        delay_w=max(0.0, drive.delay_w + m.delay),
        torque_limit=m.torque * torque if m.torque < 1.0 else drive.torque_limit,
    )
    return Robot("mujoco", MujocoPlant(calibration, driver))


def torque_needed(profile: Profile, waypoints: Waypoints, timestep: float) -> float:
    """Greatest torque of a wheel when the nominal robot is driven at the reference's velocities, open loop [N m]."""
    robot = mismatched(profile, Mismatch(), timestep, math.inf)
    assert isinstance(robot.body, MujocoPlant)
    hold = robot.drive.hold
    motion = robot.body.run(Commands(hold, waypoints.trajectory(hold).twist[:-1, [0, 2]]), waypoints.start, robot.body.dt)
    return 0.5 * float(np.abs(motion.channels["torque_N_m"]).max())


@dataclass(frozen=True)
class Outcome:
    """How one run went. The numbers are finite, also those of a run that was lost."""

    d_rms_m: float
    """Over all of the reference's samples, however far the robot came, of the distance to its path [m]."""
    e_rho_rms_m: float
    """Of how far ahead of the robot its target is; what a lost robot did not drive counts as `LOST` [m]."""
    lost_at_s: float | None
    """When the robot was lost [s]; None if it was not."""

    def failed(self, bound: float) -> bool:
        """Whether it was lost, or farther off than `bound` [m]."""
        return self.lost_at_s is not None or max(self.d_rms_m, self.e_rho_rms_m) > bound


def outcome_of(run: ClosedRun, waypoints: Waypoints, robot: Robot, ticks: int) -> Outcome:
    """How a run went that would have had so many ticks."""
    if not run.lost:
        metrics = rate(run, waypoints, robot)
        return Outcome(metrics.path.d_rms_m, metrics.e_rho_rms_m, None)
    kept = ClosedRun(run.t[:-1], run.table[:-1], True)  # the last tick is out of bounds, however far
    lost_at = float(run.t[-1]) if len(run.t) else 0.0
    if len(kept.t) < 2:
        return Outcome(LOST, LOST, lost_at)
    squares = np.sum(np.minimum(np.square(kept.column("e_rho")), LOST**2)) + (ticks - len(kept.t)) * LOST**2
    return Outcome(min(rate(kept, waypoints, robot).path.d_rms_m, LOST), math.sqrt(squares / ticks), lost_at)


def cvar(values: Sequence[float], level: float = CVAR_LEVEL) -> float:
    """Conditional value at risk: the mean of the greatest share 1 - `level` of values, a part of one counted as such.

    Raises:
        ValueError: no values, or a level outside [0, 1).
    """
    if not len(values) or not 0.0 <= level < 1.0:
        raise ValueError(f"{len(values)} values at level {level}: wanted some, and a level from 0 to below 1")
    falling = np.sort(np.asarray(values, dtype=np.float64))[::-1]
    tail = (1.0 - level) * len(falling)
    weights = np.clip(tail - np.arange(len(falling)), 0.0, 1.0)
    return float(weights @ falling / tail)


@dataclass(frozen=True)
class Spread:
    """How a number spreads over runs; the unit is that of the number."""

    mean: float
    """Of all."""
    std: float
    """Of all, with n - 1; 0 for one."""
    cvar: float
    """Mean of the worse half."""
    worst: float
    """The greatest."""


def spread(values: Sequence[float]) -> Spread:
    """How values spread."""
    array = np.asarray(values, dtype=np.float64)
    return Spread(float(array.mean()), float(array.std(ddof=1)) if len(array) > 1 else 0.0, cvar(values), float(array.max()))


@dataclass(frozen=True, eq=False)
class Tested:
    """One controller after all its runs."""

    gains: GainSet
    """Its gains."""
    outcomes: tuple[Outcome, ...]
    """In the order of the study's cases."""
    health: Health
    """Wheel loads of its first nominal run, driven again."""


@dataclass(frozen=True, eq=False)
class Robustness:
    """A study that was made."""

    profile: str
    """Name of the profile."""
    parameters: Mapping[str, Any]
    """Its numbers of the MuJoCo Husky."""
    reference: str
    """As the user named it."""
    speed: float
    """Mean speed of the reference [m/s]."""
    duration: float
    """Of a mission [s]."""
    torque: float
    """Greatest of a wheel that the reference takes [N m]."""
    settings: RobustnessSettings
    """What was asked for."""
    cases: tuple[Case, ...]
    """What every controller met."""
    tested: Mapping[str, Tested]
    """By controller."""
    versions: Mapping[str, str] = field(default_factory=store.versions)
    """Of the packages."""

    def outcomes(self, controller: str, kind: Kind, mismatch: Mismatch | None = None) -> list[Outcome]:
        """Of one controller: those of a kind, all or with one mismatch."""
        pairs = zip(self.cases, self.tested[controller].outcomes, strict=True)
        return [o for c, o in pairs if c.kind == kind and mismatch in (None, c.mismatch)]

    def failures(self, outcomes: Sequence[Outcome]) -> int:
        """How many failed."""
        return sum(o.failed(self.settings.bound) for o in outcomes)


def choose_gains(controllers: Sequence[str], name_or_path: str) -> tuple[dict[str, GainSet], list[str]]:
    """Each controller's gains of that name, and remarks on those that have none: they get their class's defaults.

    Raises:
        GainsError: no controller has such a set, or a file's is not this controller's.
    """
    known = {full.removeprefix(f"{c}-") for c in LAWS for full in gain_sets.names(c)} | {DEFAULT}
    chosen, remarks = {}, []
    for controller in controllers:
        if name_or_path in known and f"{controller}-{name_or_path}" not in gain_sets.names(controller):
            chosen[controller] = load_gains(controller, DEFAULT)
            if name_or_path != DEFAULT:
                remarks.append(f"{controller} has no gains '{name_or_path}'; its defaults are taken")
        else:
            chosen[controller] = load_gains(controller, name_or_path)
    return chosen, remarks


def check(
    profile: Profile, gains: Mapping[str, GainSet], reference: str, waypoints: Waypoints, settings: RobustnessSettings
) -> None:
    """Refuse, before anything is driven, what cannot be.

    Raises:
        ValueError: gains, a profile, a step or a reference that do not go together.
    """
    for g in gains.values():
        make_controller(profile, g)
    require_practicable(waypoints, profile.plants["mujoco"].drive, reference)
    for mismatch in (Mismatch(), *alone()):
        mismatched(profile, mismatch, settings.timestep, profile.plants["mujoco"].drive.torque_limit)
    make_clock(waypoints, settings.loop(Mismatch()), settings.timestep)


def study_robustness(
    profile: Profile,
    gains: Mapping[str, GainSet],
    reference: str,
    waypoints: Waypoints,
    settings: RobustnessSettings | None = None,
    workers: int | None = None,
) -> Robustness:
    """Let every controller meet the same mismatches.

    Args:
        profile: the nominal robot, and the linear model that model-based laws are designed on.
        gains: by controller.
        reference: what the user calls the waypoints.
        waypoints: what is followed.
        settings: how many runs, of what.
        workers: threads; the result does not depend on it.

    Raises:
        SsmrError: the nominal robot cannot be driven.
        ValueError: numbers that do not go together.
    """
    settings = settings or RobustnessSettings()
    laws = {name: make_controller(profile, g) for name, g in gains.items()}
    cases = make_cases(settings.runs, settings.seeds, settings.seed)
    torque = torque_needed(profile, waypoints, settings.timestep)
    robots = {c.mismatch: mismatched(profile, c.mismatch, settings.timestep, torque) for c in cases}
    ticks = make_clock(waypoints, settings.loop(Mismatch()), settings.timestep).ticks
    tested = {}
    with cli.progress() as bar:
        task = bar.add_task("driving", total=len(laws) * len(cases))
        for name, law in laws.items():
            bar.update(task, description=f"driving {name}")
            outcomes: list[Outcome] = []
            health = None
            for first in range(0, len(cases), BATCH):
                part = cases[first : first + BATCH]
                crew = [robots[c.mismatch] for c in part]
                loops = [settings.loop(c.mismatch, robots[c.mismatch].drive) for c in part]
                runs = run_robots(crew, [law] * len(part), loops, waypoints, [c.seed for c in part], workers)
                outcomes += [outcome_of(run, waypoints, robot, ticks) for run, robot in zip(runs, crew, strict=True)]
                health = health or health_of(runs[0], waypoints, crew[0], loops[0], part[0].seed)
                bar.advance(task, len(part))
            assert health is not None
            tested[name] = Tested(gains[name], tuple(outcomes), health)
    return Robustness(
        profile.name,
        profile.as_dict()["mujoco"],
        reference,
        waypoints.speed,
        waypoints.duration,
        torque,
        settings,
        tuple(cases),
        MappingProxyType(tested),
    )


def health_of(run: ClosedRun, waypoints: Waypoints, robot: Robot, settings: LoopSettings, seed: int) -> Health:
    """Wheel loads of a run; of one that the simulator gave up, the worst there are."""
    try:
        return check_health(driven_again(run, waypoints, robot, settings, seed).channels["wheel_load_N"])
    except SsmrError:
        return Health(0.0, 1.0)


def driven_again(run: ClosedRun, waypoints: Waypoints, robot: Robot, settings: LoopSettings, seed: int) -> Trajectory:
    """The motion of a run as the plant itself reports it.

    It goes as far as whole periods of the velocity loop do. The run's commands are driven open loop, with the same
    disturbance: the same motion to the bit, but with its wheel loads.

    Raises:
        DivergedError: the simulator gave up.
    """
    assert isinstance(robot.body, MujocoPlant)
    clock = make_clock(waypoints, settings, robot.body.dt)
    commands = max(1, (len(run.t) - 1) * clock.position // clock.velocity)
    ticks = np.minimum(np.ceil(np.arange(commands) * clock.velocity / clock.position - WHOLE_STEPS), len(run.t) - 1)
    push = np.resize(draw(clock, settings, seed)[1], commands * clock.velocity)
    table = run.columns("v_cmd", "w_cmd")[ticks.astype(int)]
    return robot.body.run(Commands(settings.velocity_period, table), waypoints.start, robot.body.dt, push)


def as_document(study: Robustness) -> dict[str, Any]:
    """study.json."""
    s = study
    controllers: dict[str, Any] = {}
    for name, tested in s.tested.items():
        grid = s.outcomes(name, "grid")
        controllers[name] = {
            "gains": tested.gains.name,
            "gain_values": dict(tested.gains.values),
            "n": len(grid),
            "d_rms_m": asdict(spread([o.d_rms_m for o in grid])),
            "e_rho_rms_m": asdict(spread([o.e_rho_rms_m for o in grid])),
            "lost": sum(o.lost_at_s is not None for o in grid),
            "failed": s.failures(grid),
            "failure_rate": s.failures(grid) / len(grid),
            "nominal": _summary(s, s.outcomes(name, "nominal")),
            "alone": {m.label: _summary(s, s.outcomes(name, "alone", m)) for m in alone()},
            "health": {**asdict(tested.health), "ok": tested.health.ok},
            "runs": [asdict(o) for o in tested.outcomes],
        }
    document = {
        "schema": SCHEMA,
        "study": "robustness",
        "profile": s.profile,
        "reference": s.reference,
        "speed_m_s": s.speed,
        "duration_s": s.duration,
        "seed": s.settings.seed,
        "options": {k: v for k, v in asdict(s.settings).items() if k != "seed"},
        "position_period_s": s.settings.position_period,
        "reference_torque_N_m": s.torque,
        "cvar_level": CVAR_LEVEL,
        "levels": dict(LEVELS),
        "versions": dict(s.versions),
        "controllers": controllers,
        "cases": [{"kind": c.kind, "seed": c.seed, **asdict(c.mismatch)} for c in s.cases],
        "parameters": dict(s.parameters),
    }
    plain = store.plain(document)
    assert isinstance(plain, dict)
    return plain


def _summary(study: Robustness, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    return {
        "n": len(outcomes),
        "d_rms_m": asdict(spread([o.d_rms_m for o in outcomes])),
        "e_rho_rms_m": asdict(spread([o.e_rho_rms_m for o in outcomes])),
        "failed": study.failures(outcomes),
    }


def _percent(part: int, whole: int) -> str:
    return f"{100.0 * part / whole:.0f}"


def spread_grid(study: Robustness) -> Grid:
    """How errors spread over the sample of the grid: a controller a row."""
    rows = []
    spreads = {
        c: (spread([o.d_rms_m for o in grid]), spread([o.e_rho_rms_m for o in grid]))
        for c in study.tested
        for grid in [study.outcomes(c, "grid")]
    }
    for name, tested in study.tested.items():
        grid = study.outcomes(name, "grid")
        numbers = [getattr(s, part) for s in spreads[name] for part in ("mean", "std", "cvar", "worst")]
        lost = sum(o.lost_at_s is not None for o in grid)
        rows.append(
            (
                Cell(name),
                Cell(tested.gains.name.removeprefix(f"{name}-")),
                *(Cell(MILLIMETRES.text(number)) for number in numbers),
                Cell(_percent(lost, len(grid))),
                Cell(_percent(study.failures(grid), len(grid))),
            )
        )
    header = [("controller", ""), ("gains", "")]
    parts = ("mean", "std", "CVaR", "worst")
    header += [(f"{what} {part}", MILLIMETRES.symbol) for what in ("d_rms", "e_rho") for part in parts]
    return Grid((*header, ("lost", "%"), ("failed", "%")), (tuple(rows),), left=2)


def alone_grid(study: Robustness, name: Literal["d_rms_m", "e_rho_rms_m"]) -> Grid:
    """What each mismatch does on its own: the mean of an error over seeds, and how many of them failed, if any."""
    nominal = {c: study.outcomes(c, "nominal") for c in study.tested}
    single = {m: {c: study.outcomes(c, "alone", m) for c in study.tested} for m in alone()}

    def line(label: str, row: Mapping[str, list[Outcome]]) -> tuple[Cell, ...]:
        cells = [Cell(label)]
        for outcomes in row.values():
            failures = study.failures(outcomes)
            mean = MILLIMETRES.text(float(np.mean([getattr(o, name) for o in outcomes])))
            cells.append(Cell(f"{failures}/{len(outcomes)} failed, {mean}" if failures else mean))
        return tuple(cells)

    header = (("mismatch", ""), *((c, MILLIMETRES.symbol) for c in study.tested))
    return Grid(header, ((line(NOMINAL, nominal),), tuple(line(m.label, row) for m, row in single.items())), left=1)


def heading(study: Robustness) -> str:
    """What was studied, in one line."""
    s = study
    grid = sum(c.kind == "grid" for c in s.cases)
    return (
        f"{s.reference} at {s.speed:.3g} m/s, profile {s.profile}: {len(s.cases)} runs a controller, {grid} of them "
        f"a sample of the grid of {len(full_grid())}; seed {s.settings.seed}"
    )


def spread_caption(study: Robustness) -> str:
    """What the columns of the spread mean."""
    return (
        "Over the sample of the grid: d_rms, from the reference to the robot's path; e_rho, root mean square of how "
        "far ahead the moving target is; CVaR, mean of the worse half. "
        f"Failed: lost, or either beyond {study.settings.bound:g} m."
    )


def alone_caption(study: Robustness) -> str:
    """What the columns of the single mismatches mean."""
    return (
        f"Each mismatch alone: means over {study.settings.seeds} seeds of noise, and how many of them failed. "
        f"Torque: of the {study.torque:.0f} N m a wheel that the reference takes open loop."
    )


def remarks(study: Robustness) -> list[str]:
    """Sentences on what the tables do not say."""
    return [
        f"{name}: {tested.health.advice.split(':')[0]}, already with the nominal robot"
        for name, tested in study.tested.items()
        if not tested.health.ok
    ]


def markdown(study: Robustness) -> list[str]:
    """study.md, as lines."""
    lines = [f"# Robustness: {heading(study)}", "", *markdown_table(spread_grid(study)), "", spread_caption(study), ""]
    lines += ["## d_rms under each mismatch alone", "", *markdown_table(alone_grid(study, "d_rms_m")), ""]
    lines += ["## e_rho under each mismatch alone", "", *markdown_table(alone_grid(study, "e_rho_rms_m")), ""]
    lines += [alone_caption(study), ""]
    lines += [f"- {remark}." for remark in remarks(study)]
    versions = ", ".join(f"{k} {v}" for k, v in study.versions.items() if k in ("mujoco", "numpy", "numba", "ssmr-testbed"))
    return [*lines, "", f"Step {study.settings.timestep:g} s; {versions}.", ""]
