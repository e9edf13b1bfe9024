"""Drive a robot by hand in real time, with other plants beside it, and log the drive."""

from __future__ import annotations

import contextlib
import itertools
import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ssmr.errors import SsmrError
from ssmr.simulation import SAMPLE_DT
from ssmr.types import Commands, Plant, State
from validation.bench.simulated_logs import log_of_drive
from validation.bench.sources import Pacer, Piece, Source
from validation.compare import Compare, PreparedComparison, prepare
from validation.drive.hands import Hands, Press, script_line
from validation.drive.window import DriveWindow
from validation.files.formats import write_log
from validation.plants.profile import Profile
from validation.plants.table import STANDARD, USUAL_PLANTS
from validation.progress import Report, silent
from validation.report.motions import Comparison
from validation.report.stage import Stage
from validation.simulator.description import Robot
from validation.simulator.terrain import FLAT, Terrain
from validation.store import make_folder
from validation.words import one_line

_logger = logging.getLogger(__name__)

TICK = 0.02
"""Time for which a command is held [s]: a whole number of every plant's steps, and of pictures that look smooth."""
_TICKS_A_LINE = 50
"""Ticks after which the journal says that the drive still goes on."""
_SHOWN_S = 0.5
"""Time after which robots are shown in the window though the loop is late [s]."""
_MOST_BEHIND = 1.0
"""Lateness that is caught up with [s]; a greater one is dropped, and the robot is slow for as long."""
_USUAL_LIMIT = 1.0
"""Greatest speed and yaw rate of a robot without limits [m/s, rad/s]."""
_AFTER_KEYS = 2.0
"""Time for which a drive by script goes on after its last key [s]."""


@dataclass(frozen=True, eq=False)
class HandDrive:
    """A drive that has ended."""

    prepared: PreparedComparison
    """The plants, and the commands that they were given."""
    interrupted: bool
    """True if Ctrl-C ended it."""
    failure: str = ""
    """Why a plant ended it, by which nothing later was driven; empty if none did."""
    dropped: float = 0.0
    """Time by which the machine was too slow [s]: the drive took so much longer than its log says."""

    def write_recording(self, folder: Path) -> Path:
        """Write the drive as a recording, drive.csv or drive-2.csv and so on: no former one is replaced; return its path.

        It holds the commands, the sensors with their noise, and five seconds of rest before and after.

        Raises:
            OSError: it cannot be written.
        """
        make_folder(folder)
        path, options = unused(folder, "drive.csv"), self.prepared.options
        commands, profile = self.prepared.source.pieces[0].commands, self.prepared.profile
        write_log(log_of_drive(path, commands, STANDARD, profile, options.seed, terrain=options.terrain), path)
        return path

    def compare(self, workers: int | None = None, progress: Report = silent) -> Comparison:
        """Return the comparison of all plants with MuJoCo's robot over this drive."""
        options = replace(self.prepared.options, workers=workers, progress=progress)
        return replace(self.prepared, options=options).run()


def unused(folder: Path, name: str) -> Path:
    """Return the path of a file in a folder, with the first number behind its name that no file there has."""
    stem, dot, suffix = name.partition(".")
    names = itertools.chain([name], (f"{stem}-{k}{dot}{suffix}" for k in itertools.count(2)))
    return next(folder / name for name in names if not (folder / name).exists())


def prepare_drive(
    profile: str | Path | Profile | None = None,
    plants: Sequence[str] = USUAL_PLANTS,
    seed: int = 0,
    *,
    robot: str | Path | Robot | None = None,
    terrain: Terrain = FLAT,
) -> PreparedComparison:
    """Build the plants of a drive: MuJoCo's robot and those that run beside it; the arguments are those of `compare`.

    Raises:
        ValueError: a name that there is not, or a negative seed.
    """
    return prepare(Compare(_source(np.zeros((1, 2))), profile, tuple(plants), STANDARD, robot, seed=seed, terrain=terrain))


def drive_by_hand(
    prepared: PreparedComparison,
    until: float = math.inf,
    script: Sequence[tuple[float, Press]] | None = None,
    *,
    journal: Path | None = None,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], object] = time.sleep,
) -> HandDrive:
    """Drive in a window until it is closed, or by a script of keys without one.

    Args:
        prepared: the plants, see `prepare_drive`.
        until: time after which the drive ends [s].
        script: instants [s] and keys; None for a window, in real time. By a script it is as fast as the machine.
        journal: new file that is written as the drive goes on, so that nothing is lost where this process is killed: a
            script that drives the same again.
        clock: function that returns monotonic time [s].
        sleep: function that waits [s].

    Returns:
        The drive, also where Ctrl-C or a plant that diverged ended it.

    Raises:
        NoWindowError: no window can be opened.
        SsmrError: nothing was driven.
    """
    names = [STANDARD, *(name for name in prepared.plants if name != STANDARD)]
    plants = {name: prepared.plants[name] for name in names}
    starts = [prepared.profile.section(name).localiser.body_state(State()) for name in names]
    for plant in plants.values():
        plant.step((0.0, 0.0), TICK)  # compiles what is compiled
    for plant, start in zip(plants.values(), starts, strict=True):
        plant.reset(start)
    drive = prepared.profile.robot.drive
    greatest = (limit if math.isfinite(limit) else _USUAL_LIMIT for limit in (drive.v_max, drive.w_max))
    about = f"{prepared.profile.name}, {prepared.profile.robot.name}, {prepared.options.terrain.spec}"
    hands, given = Hands(*greatest), _Given(journal, about)
    interrupted, failure, pacer, window = False, "", Pacer(clock, sleep, _MOST_BEHIND), None
    if script is not None:
        until = min(until, (script[-1][0] if script else 0.0) + _AFTER_KEYS)
    try:
        if script is None:
            window = DriveWindow(Stage(prepared.profile.robot, names, prepared.options.terrain))
            pacer = Pacer(clock, sleep, _MOST_BEHIND)
        _loop(plants, hands, given, until, script or (), window, pacer)
    except KeyboardInterrupt:
        interrupted = True
    except _FailedError as error:
        failure = str(error)
    finally:
        if window is not None:
            window.close()
    if not given.commands:
        raise SsmrError(f"nothing was driven, so no file is written{failure and ': '}{failure}")
    driven = replace(prepared, source=_source(np.array(given.commands)))
    return HandDrive(driven, interrupted, failure, pacer.dropped)


class _FailedError(SsmrError):
    """A plant gave up."""


class _Given:
    """The commands of every tick that has begun, and the file that keeps them where this process is killed."""

    def __init__(self, journal: Path | None, about: str) -> None:
        self.commands: list[tuple[float, float]] = []
        self._journal, self._head = journal, f"# {one_line(about)}\n"

    def add(self, command: tuple[float, float]) -> None:
        """Keep the next command; the file gets those that differ from the one before, and one a second."""
        tick = len(self.commands)
        if self._journal is not None and (tick % _TICKS_A_LINE == 0 or command != self.commands[-1]):
            with contextlib.suppress(OSError), self._journal.open("a", encoding="utf-8") as file:
                file.write(("" if tick else self._head) + script_line(tick * TICK, command))
        self.commands.append(command)


def _source(values: np.ndarray) -> Source:
    return Source("a drive by hand", (Piece(Commands(TICK, values), State(), None, None),), STANDARD, SAMPLE_DT)


def _loop(
    plants: Mapping[str, Plant],
    hands: Hands,
    given: _Given,
    until: float,
    script: Sequence[tuple[float, Press]],
    window: DriveWindow | None,
    pacer: Pacer,
) -> None:
    """Step all plants tick by tick.

    Raises:
        _FailedError: a plant gave up; `given` ends before the tick in which it did.
    """
    turns, told, waiting, shown = np.zeros((len(plants), 2)), False, list(script), 0.0
    late = 0.0
    for tick in itertools.count():
        now = tick * TICK
        if now >= until - 1e-9 or (window is not None and not window.is_open):
            return
        while waiting and waiting[0][0] <= now + 1e-9:
            hands.press(waiting.pop(0)[1])
        for key in window.keys() if window is not None else ():
            hands.press(key)
        command = hands.command(None if window is None else window.sticks())
        given.add(command)
        states = []
        for name, plant in plants.items():
            try:
                states.append(plant.step(command, TICK))
            except SsmrError as error:
                given.commands.pop()
                raise _FailedError(f"{name}: {error}") from error
        turns += TICK * np.array([(s.wheel_left, s.wheel_right) for s in states])
        if window is None:
            continue
        if late < TICK or now - shown > _SHOWN_S:  # where drawing is slow, the robot shall not be
            shown = now
            poses = [np.array([s.x, s.y, s.yaw]) for s in states]
            window.show(poses, turns, f"{now + TICK:.1f} s   {command[0]:+.2f} m/s   {command[1]:+.2f} rad/s")
        late = pacer.wait(now + TICK)
        if pacer.dropped and not told:
            told = True
            _logger.warning("this machine is too slow for real time: the robot moves slowly, its log has its own time")
