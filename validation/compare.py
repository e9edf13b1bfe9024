"""Drive every plant with the same commands and compare each with one reference.

On the command line: `python -m validation.compare SOURCE`.
"""

from __future__ import annotations

if __name__ == "__main__":
    from validation.interrupts import end_quietly

    end_quietly()

import itertools
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import tyro

from ssmr.metrics.bands import Band
from ssmr.metrics.declared import Metrics, compare_pieces, compare_signals
from ssmr.robot.drive import motor_numbers
from ssmr.robot.localiser import Localiser
from ssmr.robot.sensors import SensorNoise, measure, yaw_disturbance
from ssmr.scenarios import TRAJECTORIES
from ssmr.types import Plant, Trajectory
from validation import cli
from validation.experiment.gyro import GyroJudge, find_gyro_judge
from validation.experiment.sources import (
    RECORDING,
    Piece,
    Source,
    coverage_of,
    drive,
    horizons_of,
    open_source,
    pace_of,
    unknown_robot_notes,
    warm_up,
    window_errors_of,
)
from validation.experiment.user_law import add_user_model, load_user_metric
from validation.files.formats import profile_of_log
from validation.files.limits import USUAL
from validation.files.log import ReadOptions
from validation.plants.profile import Profile, choose_profile, make_plant
from validation.plants.table import PLANTS, USUAL_PLANTS, known_plants
from validation.progress import Progress
from validation.report.comparison import Comparison
from validation.report.motions import PlantResult, health_warnings
from validation.simulator.description import with_robot
from validation.simulator.health import Health, run_health
from validation.simulator.plant import MujocoPlant
from validation.simulator.terrain import FLAT
from validation.simulator.wheel_loads import resting_loads, summarise, with_quasi_static
from validation.words import file_name, one_line

_LONG_AT_LIMIT = 0.5
"""Time at a motor's limit from which on a run says so [s]; setting off takes less."""


@dataclass(frozen=True)
class Compare(cli.Filmed):
    """Options of `compare`."""

    source: Annotated[str | Path | Source, cli.text_of("SOURCE"), tyro.conf.Positional]
    """Motion to drive: traj1 to traj4, traj4@improved for how that plant drives it, the path of a
    recording, or one that is shipped: sample (simulated), husky or warthog (real)."""
    profile: Annotated[
        cli.AnyProfile,
        cli.profile_option("thesis-lab for scenarios, its own for a shipped log, else husky-tile"),
    ] = None
    plants: Annotated[
        cli.Names, cli.option(metavar="PLANT,...", default="mujoco and the planar models")
    ] = USUAL_PLANTS
    """Plants to drive, separated by commas, such as mujoco,improved; `all` adds four_wheel. A wrong
    name lists all names."""
    reference: Annotated[
        str | None,
        cli.option(
            metavar="PLANT", default="mujoco for a scenario, the recording itself for a recording"
        ),
    ] = None
    """Plant to compare the others with."""
    robot: cli.AnyRobot = None
    input: Annotated[Literal["commands", "wheels"], cli.option()] = "commands"
    """Signal of the recording that drives the plants: its commands, or its measured wheel rates."""
    horizons: Annotated[cli.Numbers, cli.option()] = (2.0, 6.0, 30.0, 60.0)
    """Times after which the poses of plant and recording are compared [s]."""
    start: Annotated[cli.Number, cli.option("from", metavar="SECONDS", default="the beginning")] = (
        None
    )
    """Leave out what was recorded before this time [s]."""
    until: Annotated[cli.Number, cli.option(metavar="SECONDS", default="the end")] = None
    """Leave out what was recorded after this time [s]."""
    columns: cli.Columns = field(default_factory=dict)
    limits: cli.Limits = USUAL
    bands: cli.Flag = False
    """Draw where each plant says that the robot will be with 90 %, and count how often it is
    there."""
    noise: cli.Flag = False
    """See the plants through the lab's state filter: at 50 Hz, with its noise."""
    disturbance: cli.Flag = False
    """Push all plants with the same random yaw acceleration."""
    terrain: cli.Ground = FLAT
    own_model: cli.OwnModel = None
    own_metric: cli.OwnMetric = None

    def folder(self) -> Path:
        """Return the folder that the files are written to."""
        name = Path(str(self.source)).stem
        if self.terrain != FLAT:
            name += "-" + self.terrain.spec.replace(":", "-")
        return Path("runs") / "compare" / file_name(name)

    def as_dict(self) -> dict[str, Any]:
        """Return the options as compare.json has them; the seed stands beside them."""
        names = ("input", "horizons", "noise", "disturbance")
        options = {name: getattr(self, name) for name in names}
        options["terrain"] = self.terrain.spec
        if self.start is not None:
            options["from"] = self.start
        if self.until is not None:
            options["until"] = self.until
        return options


class _Run(NamedTuple):
    """A plant's drive over the pieces of a source."""

    name: str
    plant: Plant
    pieces: tuple[Trajectory, ...]
    """Its motion, piece by piece."""
    wall_s: float
    """Time that it took [s]."""
    health: Health | None
    """The verdict on its wheel loads; None where it has none, or on a slope."""


@cli.program(Compare)
def compare(o: Compare) -> Comparison:
    """Drive every plant with the same commands and compare each with the reference.

    Prints tables and writes compare.json, compare.png and compare.rrd.

    Raises:
        SsmrError: a plant diverged.
        ValueError: an unknown name, a recording that cannot be read, or values that do not go
            together.
    """
    own_plants = add_user_model(o.own_model)
    profile = _profile(o)
    source = _opened(o, profile)
    reference = o.reference or source.reference
    # only a recording can be a reference that is not driven
    others = {reference} - ({RECORDING} if source.reference == RECORDING else set())
    plants = _plants(o, profile, own_plants, others)
    metric = None if o.own_metric is None else load_user_metric(o.own_metric)
    truth = tuple(piece.reference for piece in source.pieces if piece.reference is not None)
    remarks = _remarks(o, profile, source, truth, plants)
    runs = _drive_all(o, profile, source, plants, reference)
    gyro = None
    horizons: Sequence[float] = ()
    if reference == RECORDING:
        gyro = find_gyro_judge(source)
        horizons = o.horizons
    else:
        # plants are judged by one of them where nothing was recorded
        truth = runs[reference].pieces
    results = {}
    for name, run in runs.items():
        section = profile.section(name)
        band = section.bands.get(o.input) if o.bands else None
        scored = _scored(source, run, truth, horizons, gyro=gyro, band=band, at=section.localiser)
        if metric is not None:
            scored = replace(scored, metrics=metric.added(scored.metrics, run.pieces, truth))
        results[name] = scored
    for sentence in health_warnings(results):
        cli.warn(sentence)
    return Comparison(
        title=f"{one_line(source.name)}, {with_robot(profile.name, profile.robot.name)}",
        options=o.as_dict(),
        source=source,
        profile=profile,
        reference=reference,
        truth=truth,
        plants=results,
        seed=o.seed,
        terrain=o.terrain,
        gyro=gyro,
        remarks=remarks,
    )


def _profile(o: Compare) -> Profile:
    """Return the profile in force."""
    name = o.source.name if isinstance(o.source, Source) else str(o.source)
    if name.partition("@")[0] in TRAJECTORIES:
        return choose_profile(o.profile, o.robot, "thesis-lab")
    return choose_profile(o.profile, o.robot, profile_of_log(name))


def _opened(o: Compare, profile: Profile) -> Source:
    """Return the source, opened; a ValueError says what is wrong with it."""
    if isinstance(o.source, Source):
        if o.start is not None or o.until is not None:
            raise ValueError(
                "start and until cut a recording that is given by its path; cut yours before"
            )
        return o.source
    radius = None
    if o.profile is not None or o.robot is not None:
        radius = profile.robot.geometry.wheel_radius
    kind: Literal["twist", "wheels"] = "wheels" if o.input == "wheels" else "twist"
    reading = ReadOptions({}, o.limits, o.columns, radius)
    return open_source(str(o.source), kind, o.start, o.until, reading)


def _plants(
    o: Compare, profile: Profile, own: Iterable[str], others: Iterable[str]
) -> dict[str, Plant]:
    """Return the plants to drive, by name; a ValueError says which there are."""
    chosen = {*(PLANTS if o.plants == ("all",) else o.plants), *own}
    names = known_plants()
    if not chosen:
        raise ValueError(f"plants is empty; there are: {', '.join(names)}")
    driven = {*chosen, *others}
    if unknown := sorted(driven - set(names)):
        raise ValueError(f"unknown plant '{', '.join(unknown)}'; there are: {', '.join(names)}")
    return {name: make_plant(profile, name, o.terrain) for name in names if name in driven}


def _remarks(
    o: Compare,
    profile: Profile,
    source: Source,
    truth: Sequence[Trajectory],
    plants: Iterable[str],
) -> list[str]:
    """Return what is known before the drive; what may make it worthless is a warning, too."""
    remarks = []
    if truth:
        pace = pace_of(truth, profile.robot.geometry.wheel_radius)
        remarks = profile.too_fast(pace, source.title)
    for remark in remarks:
        cli.warn(remark)
    if o.profile is None and o.robot is None:
        remarks += unknown_robot_notes(source, profile.robot)
    if o.bands:
        bandless = [name for name in plants if o.input not in profile.section(name).bands]
        if bandless:
            remarks.append(
                f"The profile {one_line(profile.name)} holds no band of {', '.join(bandless)} "
                f"driven by {o.input}: calibrate and fit write one from a log."
            )
    return remarks


def _drive_all(
    o: Compare, profile: Profile, source: Source, plants: Mapping[str, Plant], reference: str
) -> dict[str, _Run]:
    """Drive plants side by side, each over the pieces one after another."""
    stop = threading.Event()
    lock = threading.Lock()
    done = 0
    total = len(plants) * len(source.pieces)

    def one_plant(rank: int, name: str) -> _Run:
        nonlocal done
        plant = plants[name]
        localiser = profile.section(name).localiser
        health = None
        began = time.perf_counter()
        motions = []
        for piece in source.pieces:
            if stop.is_set():
                break
            motions.append(_driven(o, source, plant, piece, localiser))
            with lock:
                done += 1
                o.progress(Progress(done, total, f"{name} has driven"))
        wall = time.perf_counter() - began
        if isinstance(plant, MujocoPlant):
            motions = [with_quasi_static(motion, plant, localiser) for motion in motions]
            if o.terrain.level:  # on a ramp loads say nothing of health
                health = _health(o, source, plant, motions, localiser)
        if o.noise and name != reference:
            # each plant has its own noise, whichever thread comes first
            rng = np.random.default_rng([o.seed, rank])
            motions = [measure(m, SensorNoise(), rng) for m in motions]
        return _Run(name, plant, tuple(motions), wall, health)

    # the time of a run shall not contain that of compiling
    for plant in plants.values():
        warm_up(plant)
    with ThreadPoolExecutor(o.workers) as pool:
        try:
            outcomes = pool.map(one_plant, itertools.count(), plants)
            return dict(zip(plants, outcomes, strict=True))
        except BaseException:
            stop.set()  # an interrupt or a failed plant ends the others at their next piece
            raise


def _driven(
    o: Compare, source: Source, plant: Plant, piece: Piece, localiser: Localiser
) -> Trajectory:
    """Return a plant's motion over a piece; what disturbs it does not depend on its step."""
    push = None
    if o.disturbance:
        rng = np.random.default_rng(o.seed)
        push = yaw_disturbance(piece.commands.duration, plant.dt, rng)
    return drive(plant, piece, localiser, source.sample_dt, push)


def _health(
    o: Compare, source: Source, plant: MujocoPlant, motions: Sequence[Trajectory], at: Localiser
) -> Health:
    """Return the verdict on a robot's loads, and what motors at their limit make uncertain.

    Only if they stayed there is the run repeated, with half the physics step.
    """
    given_rates = any(piece.commands.kind == "wheels" for piece in source.pieces)
    health = run_health(plant.model, motions, given_rates=given_rates)
    if given_rates:
        return health
    motor = motor_numbers(plant.drive, plant.dt)
    at_rest = [m.channels["torque_N_m"] + motor.braking * m.wheels for m in motions]
    limited = np.abs(np.vstack(at_rest)).max(axis=1) > 0.999 * motor.limit
    seconds = np.mean(limited) * sum(piece.commands.duration for piece in source.pieces)
    if seconds < _LONG_AT_LIMIT:
        return health
    finer = replace(plant.calibration, timestep=0.5 * plant.dt)
    robot = MujocoPlant(finer, plant.drive, terrain=plant.terrain, settings=plant.settings)
    ends = [_driven(o, source, robot, piece, at).pose[-1] for piece in source.pieces]
    moves = [m.pose[-1] - end for m, end in zip(motions, ends, strict=True)]
    moved = max(float(np.hypot(move[0], move[1])) for move in moves)
    sentence = (
        f"motors were at their limit of {motor.limit:g} N m a side for {seconds:.1f} s; the "
        f"end of its path is uncertain by some {1e3 * moved:.1f} mm"
    )
    return replace(health, at_limit=sentence)


def _scored(
    source: Source,
    run: _Run,
    truth: tuple[Trajectory, ...],
    horizons: Sequence[float],
    *,
    gyro: GyroJudge | None,
    band: Band | None,
    at: Localiser,
) -> PlantResult:
    """Compare a plant's motion with the true one, and its headings with the gyro's."""
    pieces = run.pieces
    driven = [(source, pieces)]
    by_gyro = []
    if gyro is not None:
        by_gyro.append((gyro.judging(source, at.yaw_late), pieces))
    coverage = {}
    if band is not None:
        coverage = coverage_of(driven, horizons, band)
        for horizon, shares in coverage_of(by_gyro, horizons, band).items():
            coverage[horizon]["yaw_gyro"] = shares["yaw"]
    loads = None
    if isinstance(run.plant, MujocoPlant):
        loads = summarise(pieces, resting_loads(run.plant))
    simulated = sum(piece.commands.duration for piece in source.pieces)
    return PlantResult(
        name=run.name,
        pieces=pieces,
        metrics=Metrics({**compare_pieces(pieces, truth), **compare_signals(pieces, truth)}),
        horizons=horizons_of(driven, horizons),
        wall_s=run.wall_s,
        real_time_factor=simulated / run.wall_s,
        health=run.health,
        localiser=at,
        loads=loads,
        windows=window_errors_of(driven, horizons),
        band=band,
        coverage=coverage,
        by_gyro=window_errors_of(by_gyro, horizons),
    )


if __name__ == "__main__":
    compare.main()
