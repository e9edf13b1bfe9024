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
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from ssmr.metrics.declared import Metrics, compare_pieces, compare_signals
from ssmr.metrics.windows import horizon_windows
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
    standing_sentences,
    unknown_robot_notes,
    warm_up,
    window_errors_of,
)
from validation.experiment.user_law import UserMetric, add_user_model, load_user_metric
from validation.files.formats import profile_of_log
from validation.files.limits import USUAL
from validation.files.log import ReadOptions
from validation.plants.profile import Profile, choose_profile, make_plant
from validation.plants.table import PLANTS, USUAL_PLANTS, known_plants, plant_kind
from validation.progress import Progress
from validation.report.motion_panels import comparison_figure
from validation.report.motions import (
    Comparison,
    PlantResult,
    alike_sentences,
    comparison_tables,
    headline_horizon,
    health_warnings,
    indistinguishable_pairs,
    point_sentences,
    write_comparison,
)
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


_Driven = tuple[list[Trajectory], float, Health | None]
"""A plant's motion over the pieces, the wall time that it took [s], and its health."""


@dataclass(frozen=True, eq=False)
class _Comparing:
    """Inputs of a comparison, checked."""

    source: Source
    profile: Profile
    reference: str
    plants: Mapping[str, Plant]
    options: Compare
    metric: UserMetric | None = None

    def run(self) -> Comparison:
        """Drive the plants and compare them; an SsmrError says that one diverged."""
        source = self.source
        profile = self.profile
        o = self.options
        truth = tuple(piece.reference for piece in source.pieces if piece.reference is not None)
        remarks = list[str]()
        if truth:
            pace = pace_of(truth, profile.robot.wheel_radius)
            remarks = profile.too_fast(pace, source.title)
        for remark in remarks:
            cli.warn(remark)
        driven = self._drive_all()
        recorded = self.reference == RECORDING
        gyro = find_gyro_judge(source) if recorded else None
        # plants are judged by one of them where nothing was recorded
        if not recorded:
            truth = tuple(driven[self.reference][0])
        results = {name: self._result(name, *d, truth, gyro) for name, d in driven.items()}
        scoring = self._windows() if recorded else {}
        gyro_first = gyro is not None and gyro.first
        pairs = indistinguishable_pairs(results, gyro_first)
        ill = health_warnings(results)
        label = one_line(with_robot(profile.name, profile.robot.name))
        title = f"{one_line(source.name)} · profile {label}"
        if o.terrain != FLAT:
            title += f" · mujoco on {o.terrain.words}"
        caption = [f"compared with {self.reference} · seed {o.seed} · best value in bold"]
        if not recorded:
            caption += self._before_reading(results)
        caption += ill
        tables = comparison_tables(results, self.reference, title, "\n".join(caption), gyro_first)
        notes = []
        if o.profile is None and o.robot is None:
            notes += unknown_robot_notes(source, profile.robot)
        headline = headline_horizon(scoring)
        if headline:
            notes += standing_sentences(source, headline)
        if gyro is not None:
            notes.append(gyro.sentence)
        notes += [*source.warnings, *alike_sentences(results, pairs), *self._unjudged(results)]
        return Comparison(
            program="compare",
            title=f"{one_line(source.name)}, {label}",
            tables=tables,
            sentences=(*remarks, *notes),
            alarms=ill,
            options=o.as_dict(),
            document=self._document(results, gyro, pairs),
            draw=comparison_figure,
            record=write_comparison,
            source=source.name,
            profile=profile.name,
            reference_name=self.reference,
            reference=truth,
            commands=tuple(piece.commands for piece in source.pieces),
            plants=results,
            seed=o.seed,
            terrain=o.terrain,
            scoring=scoring,
            robot=profile.robot,
        )

    def _document(
        self,
        results: Mapping[str, PlantResult],
        gyro: GyroJudge | None,
        pairs: dict[str, Any] | None,
    ) -> dict[str, Any]:
        """Contents of compare.json without options and tables."""
        judge: dict[str, Any] = {}
        if gyro is not None:
            judge["heading_judge"] = "gyro" if gyro.first else "localiser"
            judge["judges_apart_rad"] = gyro.apart
        return {
            "schema": "ssmr.compare/1",
            "source": self.source.name,
            "profile": self.profile.name,
            "robot": self.profile.robot.name,
            "reference": self.reference,
            "seed": self.options.seed,
            **judge,
            "alike": pairs,
            "plants": {name: result.as_dict() for name, result in results.items()},
            "parameters": {name: dict(result.parameters) for name, result in results.items()},
        }

    def _windows(self) -> dict[float, Any]:
        """Windows of each horizon on all pieces of a log."""
        scoring = {}
        stamped = [(piece, piece.t) for piece in self.source.pieces if piece.t is not None]
        for horizon in self.options.horizons:
            scoring[horizon] = tuple(p.windows(horizon_windows, t, horizon) for p, t in stamped)
        return scoring

    def _before_reading(self, results: Mapping[str, PlantResult]) -> list[str]:
        """Return what one must know to read the distances between plants."""
        origins = self.profile.origins(self.plants, self.source.name)
        return [*point_sentences(results), *origins, *self._unlike_torques(results)]

    def _unlike_torques(self, results: Mapping[str, PlantResult]) -> list[str]:
        """Return a sentence on torques that differ because only one of two is a body's."""
        of_body = plant_kind(self.reference).torques
        with_torque = [n for n, r in results.items() if "torque_rms_N_m" in r.metrics]
        unlike = [name for name in with_torque if plant_kind(name).torques != of_body]
        if not unlike:
            return []
        return [
            f"torque rms does not compare {', '.join(unlike)} with {self.reference}: a planar "
            "model's torques come of frictions that were fitted to paths."
        ]

    def _unjudged(self, results: Mapping[str, PlantResult]) -> list[str]:
        """Return a sentence on the plants whose predictions no log has judged yet."""
        if not self.options.bands:
            return []
        plants = ", ".join(name for name, result in results.items() if result.band is None)
        if not plants:
            return []
        profile = one_line(self.profile.name)
        return [
            f"The profile {profile} holds no band of {plants} driven by {self.options.input}: "
            "calibrate and fit write one from a log."
        ]

    def _result(
        self,
        name: str,
        pieces: list[Trajectory],
        wall: float,
        health: Health | None,
        truth: tuple[Trajectory, ...],
        gyro: GyroJudge | None,
    ) -> PlantResult:
        """Compare a plant's motion with the true one, and its headings with the gyro's."""
        plant = self.plants[name]
        section = self.profile.section(name)
        source = self.source
        horizons = self.options.horizons if self.reference == RECORDING else ()
        driven = [(source, pieces)]
        by_gyro = []
        if gyro is not None:
            by_gyro.append((gyro.judging(source, section.localiser.yaw_late), pieces))
        band = section.bands.get(self.options.input) if self.options.bands else None
        coverage = {}
        if band is not None:
            coverage = coverage_of(driven, horizons, band)
            for horizon, shares in coverage_of(by_gyro, horizons, band).items():
                coverage[horizon]["yaw_gyro"] = shares["yaw"]
        metrics = Metrics({**compare_pieces(pieces, truth), **compare_signals(pieces, truth)})
        if self.metric is not None:
            metrics = self.metric.added(metrics, pieces, truth)
        loads = None
        if isinstance(plant, MujocoPlant):
            loads = summarise(tuple(pieces), resting_loads(plant))
        simulated = sum(piece.commands.duration for piece in source.pieces)
        return PlantResult(
            name=name,
            pieces=tuple(pieces),
            metrics=metrics,
            horizons=horizons_of(driven, horizons),
            wall_s=wall,
            real_time_factor=simulated / wall,
            health=health,
            localiser=section.localiser,
            loads=loads,
            parameters=self.profile.as_dict([name])[name],
            windows=window_errors_of(driven, horizons),
            band=band,
            coverage=coverage,
            by_gyro=window_errors_of(by_gyro, horizons),
        )

    def _driven(self, plant: Plant, piece: Piece, localiser: Localiser) -> Trajectory:
        """Return a plant's motion over a piece; what disturbs it does not depend on its step."""
        push = None
        if self.options.disturbance:
            rng = np.random.default_rng(self.options.seed)
            push = yaw_disturbance(piece.commands.duration, plant.dt, rng)
        return drive(plant, piece, localiser, self.source.sample_dt, push)

    def _at_limit(self, plant: MujocoPlant, motions: list[Trajectory], at: Localiser) -> str | None:
        """Return a sentence on motors that stayed at their limit; None where they did not.

        Only if they did is the run repeated, with half the physics step.
        """
        motor = motor_numbers(plant.drive, plant.dt)
        at_rest = [m.channels["torque_N_m"] + motor.braking * m.wheels for m in motions]
        limited = np.abs(np.vstack(at_rest)).max(axis=1) > 0.999 * motor.limit
        seconds = np.mean(limited) * sum(piece.commands.duration for piece in self.source.pieces)
        if seconds < _LONG_AT_LIMIT:
            return None
        finer = replace(plant.calibration, timestep=0.5 * plant.dt)
        robot = MujocoPlant(finer, plant.drive, terrain=plant.terrain, settings=plant.settings)
        ends = [self._driven(robot, piece, at).pose[-1] for piece in self.source.pieces]
        moves = [m.pose[-1] - end for m, end in zip(motions, ends, strict=True)]
        moved = max(float(np.hypot(move[0], move[1])) for move in moves)
        return (
            f"motors were at their limit of {motor.limit:g} N m a side for {seconds:.1f} s; the "
            f"end of its path is uncertain by some {1e3 * moved:.1f} mm"
        )

    def _drive_all(self) -> dict[str, _Driven]:
        """Drive plants side by side, each over the pieces one after another."""
        stop = threading.Event()
        lock = threading.Lock()
        o = self.options
        done = 0
        total = len(self.plants) * len(self.source.pieces)

        def one_plant(rank: int, name: str) -> _Driven:
            nonlocal done
            plant = self.plants[name]
            localiser = self.profile.section(name).localiser
            health = None
            began = time.perf_counter()
            motions = []
            for piece in self.source.pieces:
                if stop.is_set():
                    break
                motions.append(self._driven(plant, piece, localiser))
                with lock:
                    done += 1
                    o.progress(Progress(done, total, f"{name} has driven"))
            wall = time.perf_counter() - began
            if isinstance(plant, MujocoPlant):
                motions = [with_quasi_static(motion, plant, localiser) for motion in motions]
                if o.terrain.level:  # on a ramp loads say nothing of health
                    given = any(piece.commands.kind == "wheels" for piece in self.source.pieces)
                    health = run_health(plant.model, motions, given_rates=given)
                    if not given:
                        health = replace(health, at_limit=self._at_limit(plant, motions, localiser))
            if o.noise and name != self.reference:
                # each plant has its own noise, whichever thread comes first
                rng = np.random.default_rng([o.seed, rank])
                motions = [measure(m, SensorNoise(), rng) for m in motions]
            return motions, wall, health

        # the time of a run shall not contain that of compiling
        for plant in self.plants.values():
            warm_up(plant)
        with ThreadPoolExecutor(o.workers) as pool:
            try:
                outcomes = pool.map(one_plant, itertools.count(), self.plants)
                return dict(zip(self.plants, outcomes, strict=True))
            except BaseException:
                stop.set()  # an interrupt or a failed plant ends the others at their next piece
                raise


@cli.program(Compare)
def compare(o: Compare) -> Comparison:
    """Drive every plant with the same commands and compare each with the reference.

    Prints tables and writes compare.json, compare.png and compare.rrd.

    Raises:
        SsmrError: a plant diverged.
        ValueError: an unknown name, a recording that cannot be read, or values that do not go
            together.
    """
    source = o.source
    user_plants = add_user_model(o.own_model)
    name = source.name if isinstance(source, Source) else str(source)
    is_trajectory = name.partition("@")[0] in TRAJECTORIES
    default = "thesis-lab" if is_trajectory else profile_of_log(name)
    profile = choose_profile(o.profile, o.robot, default)
    if not isinstance(source, Source):
        radius = None
        if o.profile is not None or o.robot is not None:
            radius = profile.robot.wheel_radius
        kind: Literal["twist", "wheels"] = "wheels" if o.input == "wheels" else "twist"
        reading = ReadOptions({}, o.limits, o.columns, radius)
        source = open_source(name, kind, o.start, o.until, reading)
    elif o.start is not None or o.until is not None:
        raise ValueError(
            "start and until cut a recording that is given by its path; cut yours before"
        )
    reference = o.reference or source.reference
    plants = PLANTS if o.plants == ("all",) else o.plants
    names = known_plants()
    if not plants and not user_plants:
        raise ValueError(f"plants is empty; there are: {', '.join(names)}")
    driven = {*plants, *user_plants, reference}
    if source.reference == RECORDING:
        driven.discard(RECORDING)
    if unknown := sorted(driven - set(names)):
        raise ValueError(f"unknown plant '{', '.join(unknown)}'; there are: {', '.join(names)}")
    robots = {name: make_plant(profile, name, o.terrain) for name in names if name in driven}
    metric = None if o.own_metric is None else load_user_metric(o.own_metric)
    return _Comparing(source, profile, reference, robots, o, metric).run()


if __name__ == "__main__":
    compare.main()
