"""Runs: plants that are driven along a source."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from ssmr.robot.bodies import BodyPlant
from ssmr.robot.drive import motor_numbers
from ssmr.robot.localiser import Localiser
from ssmr.robot.sensors import yaw_disturbance
from ssmr.types import Commands, FloatArray, Plant, State, Trajectory
from validation.experiment.sources import Piece, Source
from validation.output import Document, Progress, Progressing, ignore_progress
from validation.simulator.description import WHEELS
from validation.simulator.health import Health, run_health
from validation.simulator.plant import MujocoPlant
from validation.simulator.wheel_loads import resting_loads, summarise_loads, with_quasi_static

_LONG_AT_LIMIT = 0.5
"""Time at a motor's limit from which on a run says so [s]; setting off takes less."""


@dataclass(frozen=True, eq=False)
class Run:
    """A plant that was driven along a source."""

    plant: str
    """Name of the plant, such as `improved`."""
    motions: tuple[Trajectory, ...]
    """Its motion over each piece of the source, at the stamps of the reference."""
    localiser: Localiser = Localiser()
    """The frame in the plant's body whose motion that is."""
    wall_s: float = 0.0
    """Time that simulating took [s]."""
    cpu_s: float = 0.0
    """Time of a processor that simulating took [s]: other work of the machine does not count."""
    health: Health | None = None
    """The verdict on the wheel loads; only a MuJoCo robot has one, and only on level ground."""
    loads: Document | None = None
    """The loads that its wheels carried, see `summarise_loads`; only a MuJoCo robot knows them."""

    @property
    def real_time_factor(self) -> float:
        """Simulated time over a processor's [1]."""
        simulated = sum(float(motion.t[-1] - motion.t[0]) for motion in self.motions)
        return simulated / max(self.cpu_s, 1e-9)

    def as_dict(self) -> Document:
        """Return how long it took, and what its wheels carried, as compare.json has them."""
        document: Document = {
            "wall_s": self.wall_s,
            "cpu_s": self.cpu_s,
            "real_time_factor": self.real_time_factor,
        }
        if self.health is not None:
            document["health"] = self.health
        if self.loads is not None:
            document["wheel_loads"] = {"wheels": WHEELS, **self.loads}
        return document


Runs = Mapping[str, Run]
"""Runs by plant."""


def drive_piece(
    plant: Plant,
    piece: Piece,
    localiser: Localiser,
    sample_dt: float,
    push: FloatArray | None = None,
) -> Trajectory:
    """Drive a plant over one piece, and return the motion that the localiser sees at its stamps.

    The plant begins at the piece's start and is sampled every `sample_dt` [s]; `push` is the (n,)
    disturbing yaw acceleration of each physics step [rad/s²].
    """
    start = localiser.body_state(piece.start)
    drive = piece.commands, start, sample_dt, push
    t = piece.t
    if t is None or not (isinstance(plant, BodyPlant) and hasattr(plant, "run_parts")):
        return localiser.seen(plant.run(*drive), t)
    table = np.vstack(list(_see_parts(plant.run_parts(*drive), localiser, sample_dt, t)))
    return Trajectory.of_table(t, table, plant.channels(piece.commands.kind))


def _see_parts(
    parts: Iterable[FloatArray], localiser: Localiser, period: float, t: FloatArray
) -> Iterator[FloatArray]:
    """Yield part by part what a localiser sees of a run at stamps `t` [s], see `seen_table`."""
    # it asks for no sample that is later or earlier than a stamp by so much
    reach = abs(localiser.position_late) + abs(localiser.yaw_late) + period
    rows = list[FloatArray]()
    done = end = 0
    for part in parts:
        table = np.vstack([*rows, part])
        end += len(part)
        clock = period * np.arange(end - len(table), end) + t[0]
        stop = np.searchsorted(t, clock[-1] - reach)
        yield localiser.seen_table(table, clock, t[done:stop])
        done = stop
        rows = [table[clock > clock[-1] - 3.0 * reach]]
    yield localiser.seen_table(table, clock, t[done:])


def drive_source(plant: Plant, source: Source, localiser: Localiser) -> tuple[Trajectory, ...]:
    """Drive a plant over the pieces of a source one after another; return its motions."""
    dt = source.sample_dt
    return tuple(drive_piece(plant, piece, localiser, dt) for piece in source.pieces)


def _warm_up(plant: Plant) -> None:
    """Drive a plant for a moment, so that threads find its code compiled, and a fault shows."""
    plant.run(Commands(0.05, np.array([[0.1, 0.0]])), State(), 0.05)


def drive_all(
    source: Source,
    plants: Mapping[str, Plant],
    localisers: Mapping[str, Localiser],
    push_seed: int | None = None,
    workers: int | None = None,
    progress: Progressing = ignore_progress,
) -> dict[str, Run]:
    """Drive plants side by side along a source, each over the pieces one after another.

    Args:
        source: what drives the plants.
        plants: plants by name.
        localisers: the tracked frame of each of them.
        push_seed: seed of a random yaw acceleration that is the same for all; None for none.
        workers: threads; the result does not depend on it.
        progress: called after each piece.

    Raises:
        SsmrError: a plant diverged.
    """
    stop = threading.Event()
    lock = threading.Lock()
    done = 0
    total = len(plants) * len(source.pieces)

    def one_plant(name: str) -> Run:
        nonlocal done
        plant = plants[name]
        began = time.perf_counter()
        spent = time.thread_time()
        motions = []
        for piece in source.pieces:
            if stop.is_set():
                break
            motions.append(
                _drive_pushed(plant, piece, localisers[name], source.sample_dt, push_seed)
            )
            with lock:
                done += 1
                progress(Progress(done, total, f"{name} has driven"))
        wall = time.perf_counter() - began
        spent = time.thread_time() - spent
        run = Run(name, tuple(motions), localisers[name], wall, spent)
        if isinstance(plant, MujocoPlant) and not stop.is_set():
            return _examine_run(run, plant, source, push_seed)
        return run

    # the time of a run shall not contain that of compiling
    for plant in plants.values():
        _warm_up(plant)
    with ThreadPoolExecutor(workers) as pool:
        try:
            return dict(zip(plants, pool.map(one_plant, plants), strict=True))
        except BaseException:
            stop.set()  # an interrupt or a failed plant ends the others at their next piece
            raise


def _drive_pushed(
    plant: Plant, piece: Piece, localiser: Localiser, sample_dt: float, seed: int | None
) -> Trajectory:
    """Return a plant's motion over a piece; what disturbs it does not depend on its step."""
    push = None
    if seed is not None:
        push = yaw_disturbance(piece.commands.duration, plant.dt, np.random.default_rng(seed))
    return drive_piece(plant, piece, localiser, sample_dt, push)


def _examine_run(run: Run, plant: MujocoPlant, source: Source, push_seed: int | None) -> Run:
    """Return a run of MuJoCo's robot with the loads of its wheels and the verdict on them."""
    motions = tuple(with_quasi_static(motion, plant, run.localiser) for motion in run.motions)
    run = replace(run, motions=motions, loads=summarise_loads(motions, resting_loads(plant)))
    if not plant.terrain.level:  # on a ramp loads say nothing of health
        return run
    given = any(piece.commands.kind == "wheels" for piece in source.pieces)
    limit = None if given else _at_limit(run, plant, source, push_seed)
    health = run_health(plant.model, motions, given_rates=given, at_limit=limit)
    return replace(run, health=health)


def _at_limit(run: Run, plant: MujocoPlant, source: Source, push_seed: int | None) -> str | None:
    """Return a sentence on motors that stayed at their limit; None where they did not.

    Only if they did is the run repeated, with half the physics step.
    """
    motor = motor_numbers(plant.drive, plant.dt)
    at_rest = [m.channels["torque_N_m"] + motor.braking * m.wheels for m in run.motions]
    limited = np.abs(np.vstack(at_rest)).max(axis=1) > 0.999 * motor.limit
    seconds = np.mean(limited) * sum(piece.commands.duration for piece in source.pieces)
    if seconds < _LONG_AT_LIMIT:
        return None
    finer = replace(plant.calibration, timestep=0.5 * plant.dt)
    robot = MujocoPlant(finer, plant.drive, terrain=plant.terrain, settings=plant.settings)
    moved = 0.0
    for piece, motion in zip(source.pieces, run.motions, strict=True):
        again = _drive_pushed(robot, piece, run.localiser, source.sample_dt, push_seed)
        moved = max(moved, np.hypot(*(motion.pose[-1] - again.pose[-1])[:2]))
    return (
        f"motors were at their limit of {motor.limit:g} N m a side for {seconds:.1f} s; the "
        f"end of its path is uncertain by some {1e3 * moved:.1f} mm"
    )
