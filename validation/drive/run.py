"""Drive a robot by hand in real time, with other plants beside it, and log the drive."""

from __future__ import annotations

import itertools
import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ssmr.errors import SsmrError
from ssmr.simulation import SAMPLE_DT
from ssmr.types import Commands, Plant, State
from validation.compare.result import Comparison
from validation.compare.run import CompareSettings, PreparedComparison, prepare
from validation.drive.hands import Hands
from validation.drive.window import DriveWindow
from validation.logs.formats import write_log
from validation.logs.log import Log
from validation.motion.sources import Piece, Source
from validation.plants.profile import Profile
from validation.plants.table import STANDARD, USUAL_PLANTS
from validation.progress import Report, silent
from validation.recordings.simulated_log import log_of_drive
from validation.ros.pacing import Pacer
from validation.show.stage import Stage
from validation.simulator.description import Robot
from validation.store import make_folder

_logger = logging.getLogger(__name__)

TICK = 0.02
"""Time for which a command is held [s]: a whole number of every plant's steps, and of pictures that look smooth."""
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
    dropped: float = 0.0
    """Time by which the machine was too slow [s]: the drive took so much longer than its log says."""

    def write_recording(self, folder: Path) -> Path:
        """Write the drive as a recording, drive.csv or drive-2.csv and so on: no former one is replaced; return its path.

        It holds the commands, the sensors with their noise, and five seconds of rest before and after.

        Raises:
            OSError: it cannot be written.
        """
        make_folder(folder)
        names = itertools.chain(["drive.csv"], (f"drive-{k}.csv" for k in itertools.count(2)))
        path = next(folder / name for name in names if not (folder / name).exists())
        commands, profile = self.prepared.source.pieces[0].commands, self.prepared.profile
        write_log(Log(path, log_of_drive(commands, STANDARD, profile, self.prepared.settings.seed)), path)
        return path

    def compare(self, workers: int | None = None, progress: Report = silent) -> Comparison:
        """Return the comparison of all plants with MuJoCo's robot over this drive."""
        return self.prepared.run(workers, progress)


def prepare_drive(
    profile: str | Path | Profile | None = None,
    plants: Sequence[str] = USUAL_PLANTS,
    seed: int = 0,
    *,
    robot: str | Path | Robot | None = None,
) -> PreparedComparison:
    """Build the plants of a drive: MuJoCo's robot and those that run beside it; the arguments are those of `compare`.

    Raises:
        ValueError: a name that there is not, or a negative seed.
    """
    return prepare(_source(np.zeros((1, 2))), profile, plants, STANDARD, CompareSettings(seed=seed), robot=robot)


def drive_by_hand(
    prepared: PreparedComparison,
    until: float = math.inf,
    script: Sequence[tuple[float, str]] | None = None,
    *,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], object] = time.sleep,
) -> HandDrive:
    """Drive in a window until it is closed, or by a script of keys without one.

    Args:
        prepared: the plants, see `prepare_drive`.
        until: time after which the drive ends [s].
        script: instants [s] and keys; None for a window, in real time. By a script it is as fast as the machine.
        clock: function that returns monotonic time [s].
        sleep: function that waits [s].

    Returns:
        The drive, also where Ctrl-C ended it.

    Raises:
        NoWindowError: no window can be opened.
        SsmrError: a plant diverged, or nothing was driven.
    """
    names = [STANDARD, *(name for name in prepared.plants if name != STANDARD)]
    plants = [prepared.plants[name] for name in names]
    starts = [prepared.profile.section(name).localiser.body_state(State()) for name in names]
    for plant in plants:
        plant.step((0.0, 0.0), TICK)  # compiles what is compiled
    states = [plant.reset(start) for plant, start in zip(plants, starts, strict=True)]
    drive = prepared.profile.robot.drive
    greatest = (limit if math.isfinite(limit) else _USUAL_LIMIT for limit in (drive.v_max, drive.w_max))
    hands, given = Hands(*greatest), list[tuple[float, float]]()
    interrupted, pacer, window = False, Pacer(clock, sleep, _MOST_BEHIND), None
    if script is not None:
        until = min(until, (script[-1][0] if script else 0.0) + _AFTER_KEYS)
    try:
        if script is None:
            window = DriveWindow(Stage(prepared.profile.robot, names))
            pacer = Pacer(clock, sleep, _MOST_BEHIND)
        _loop(plants, states, hands, given, until, script or (), window, pacer)
    except KeyboardInterrupt:
        interrupted = True
    finally:
        if window is not None:
            window.close()
    if not given:
        raise SsmrError("nothing was driven, so no file is written")
    driven = replace(prepared, source=_source(np.array(given)))
    return HandDrive(driven, interrupted, pacer.dropped)


def _source(values: np.ndarray) -> Source:
    return Source("a drive by hand", (Piece(Commands(TICK, values), State(), None, None),), STANDARD, SAMPLE_DT)


def _loop(
    plants: Sequence[Plant],
    states: list[State],
    hands: Hands,
    given: list[tuple[float, float]],
    until: float,
    script: Sequence[tuple[float, str]],
    window: DriveWindow | None,
    pacer: Pacer,
) -> None:
    """Step all plants tick by tick; `given` has the commands of every tick that has begun, however this ends."""
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
        given.append(command)
        states[:] = [plant.step(command, TICK) for plant in plants]
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
