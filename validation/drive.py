"""Drive a robot by hand in real time, with other plants beside it, and log the drive: `python -m validation.drive`."""
# pyright: reportAttributeAccessIssue=false
# (mujoco's compiled modules have no type stubs)

from __future__ import annotations

import itertools
import logging
import math
import os
import re
import sys
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import mujoco
import numpy as np

from ssmr.errors import SsmrError
from ssmr.simulation import SAMPLE_DT
from ssmr.types import Commands, FloatArray, State
from validation import cli
from validation.bench.logs import log_of_drive
from validation.bench.sources import Pacer, Piece, Source
from validation.compare import Compare, PreparedComparison, prepare
from validation.files.formats import write_log
from validation.plants.table import STANDARD, USUAL_PLANTS
from validation.report.motions import Comparison
from validation.report.report import FINISHED, INTERRUPTED
from validation.report.stage import Stage
from validation.report.tracks import bright
from validation.simulator.terrain import FLAT
from validation.store import make_folder
from validation.words import one_line, visible

_logger = logging.getLogger(__name__)

TICK = 0.02
"""Time for which a command is held [s]: a whole number of every plant's steps, and of pictures that look smooth."""
KEYS = {265: "up", 264: "down", 263: "left", 262: "right", 257: "enter", 32: "space"}
"""Keys by their number in GLFW: MuJoCo's viewer has other meanings for nearly all letters, and none for these."""
STEPS = 10
"""Presses from rest to the greatest speed or yaw rate."""
_SHOWN_S = 0.5
"""Time after which robots are shown in the window though the loop is late [s]."""
_MOST_BEHIND = 1.0
"""Lateness that is caught up with [s]; a greater one is dropped, and the robot is slow for as long."""
_USUAL_LIMIT = 1.0
"""Greatest speed and yaw rate of a robot without limits [m/s, rad/s]."""
_AFTER_KEYS = 2.0
"""Time for which a drive by script goes on after its last key [s]."""
_HELP = "arrows: faster, slower, left, right\nenter: straight on, space: stop\nclose the window to end"


class NoWindowError(SsmrError, ValueError):
    """No window can be opened here; the message says what to do."""


@dataclass(frozen=True)
class HandDrive(cli.Filmed):
    """Options of `drive`."""

    robot: cli.AnyRobot = None
    profile: Annotated[cli.AnyProfile, cli.profile_option("thesis-lab")] = None
    plants: Annotated[cli.Names, cli.option(metavar="PLANT,...", default="the planar models")] = ()
    """Plants that run beside the MuJoCo robot, separated by commas; `mujoco` for none."""
    terrain: cli.Ground = FLAT
    until: Annotated[cli.Number, cli.option(metavar="SECONDS", default="until the window is closed")] = None
    """Time after which the drive ends."""
    keys: Annotated[Path | None, cli.option(metavar="FILE", default="a window")] = None
    """Script of keys, to drive without a window and without waiting: lines `TIME KEY ...`, such as 2.5 up up left."""

    def folder(self) -> Path:
        """Return the folder that the files are written to."""
        return Path("runs") / "drive"


@cli.program(HandDrive)
def drive(o: HandDrive) -> Comparison:
    """Drive a robot by hand in MuJoCo's viewer, in real time, with the other plants beside it as ghosts.

    Every press of an arrow is a tenth of the greatest speed or yaw rate; enter goes straight on, space stops. The drive ends
    when the window is closed, or with Ctrl-C. It is written as drive.csv, with noise of the sensors, which compare and fit
    take; and all plants are compared over it.

    Raises:
        SsmrError: nothing was driven.
        ValueError: a name that there is not, a script that cannot be read, or no window can be opened.
    """
    if o.until is not None and not o.until > 0.0:
        raise ValueError(f"--until {o.until:g} s must be positive")
    script = None if o.keys is None else Script(read_keys(o.keys))
    before, plants = _source(np.zeros((1, 2))), o.plants or USUAL_PLANTS
    asked = Compare(before, o.profile, plants, STANDARD, o.robot, terrain=o.terrain, seed=o.seed)
    prepared = prepare(replace(asked, workers=o.workers, progress=o.progress))
    screen = script or Window(Stage(prepared.profile.robot, _names(prepared)))
    commands, ended = drive_by_hand(prepared, screen, math.inf if o.until is None else o.until)
    folder = make_folder(o.out or o.folder())
    files = itertools.chain(["drive.csv"], (f"drive-{k}.csv" for k in itertools.count(2)))
    path = next(folder / name for name in files if not (folder / name).exists())  # no former drive is replaced
    log = log_of_drive(path, Commands(TICK, commands), STANDARD, prepared.profile, o.seed, terrain=o.terrain)
    write_log(log, path)
    which = "".join(f" --{k} {visible(v)}" for k, v in (("profile", o.profile), ("robot", o.robot)) if v)
    which = which or f" --profile {prepared.profile.name}"
    ground = "" if o.terrain == FLAT else f" --terrain {visible(o.terrain.spec)}"
    _logger.info("next: ssmr compare %s%s%s, or ssmr fit improved --to %s%s", path, which, ground, path, which)
    comparison = replace(prepared, source=_source(commands)).run()
    slow = [f"the drive took {screen.dropped:.1f} s longer than its log says: this machine is too slow"]
    return replace(
        comparison,
        alarms=[*comparison.alarms, *(slow if screen.dropped else ())],
        failure=SsmrError(f"the drive ended before this: {ended}") if isinstance(ended, SsmrError) else None,
        status=INTERRUPTED if isinstance(ended, KeyboardInterrupt) else FINISHED,
    )


def _source(commands: FloatArray) -> Source:
    return Source("a drive by hand", (Piece(Commands(TICK, commands), State(), None, None),), STANDARD, SAMPLE_DT)


class HandCommand:
    """The command that keys ask for.

    The viewer tells of the first press of a key alone, and neither that it is held nor that it is let go. So every press is
    a step: up and down change the speed by a tenth of the greatest, left and right the yaw rate; what is asked for stays.
    Enter goes straight on, space stops.
    """

    def __init__(self, v_max: float, w_max: float) -> None:
        """Begin at rest; the greatest speed [m/s] and yaw rate [rad/s] are positive."""
        self._most = v_max, w_max
        self._ahead = self._left = 0  # in steps

    def press(self, key: str) -> None:
        """Take the press of a key; one that is not in `KEYS` does nothing."""
        ahead, left = {"up": (1, 0), "down": (-1, 0), "left": (0, 1), "right": (0, -1)}.get(key, (0, 0))
        self._ahead = 0 if key == "space" else max(-STEPS, min(STEPS, self._ahead + ahead))
        self._left = 0 if key in ("space", "enter") else max(-STEPS, min(STEPS, self._left + left))

    def command(self) -> tuple[float, float]:
        """Return speed [m/s] and yaw rate [rad/s] that are asked for."""
        v_max, w_max = self._most
        return v_max * self._ahead / STEPS, w_max * self._left / STEPS


def read_keys(path: Path) -> list[tuple[float, str]]:
    """Return instants [s] and keys of a script with lines `TIME KEY ...`; `#` begins a remark.

    Raises:
        ValueError: it cannot be read, or has a line of another form, a key that there is not, or a time that goes back.
    """
    found: list[tuple[float, str]] = []
    form = re.compile(rf"(\d+\.?\d*)((?:\s+(?:{'|'.join(KEYS.values())}))+)")
    try:
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
            if not (text := line.partition("#")[0].strip()):
                continue
            match = form.fullmatch(text)
            if match is None or (found and float(match[1]) < found[-1][0]):
                wanted = f"TIME KEY ... with keys among {', '.join(KEYS.values())}, no earlier than the last"
                raise ValueError(f"line {number} must be {wanted}")
            found += [(float(match[1]), key) for key in match[2].split()]
    except (OSError, ValueError) as error:
        raise ValueError(f"--keys {path}: {getattr(error, 'strerror', None) or error}") from error
    return found


class Script:
    """Keys at their instants, in place of a window; nothing is shown, and nothing waits."""

    dropped = 0.0

    def __init__(self, keys: Sequence[tuple[float, str]]) -> None:
        """Take instants [s] and keys."""
        self._keys, self._end = deque(keys), (keys[-1][0] if keys else 0.0) + _AFTER_KEYS

    def is_open(self, now: float) -> bool:
        """Return whether the drive goes on at an instant [s]."""
        return now < self._end - 1e-9

    def keys(self, now: float) -> list[str]:
        """Return the keys until an instant [s] that no call returned before."""
        found = []
        while self._keys and self._keys[0][0] <= now + 1e-9:
            found.append(self._keys.popleft()[1])
        return found

    def show(self, now: float, states: Sequence[State], command: tuple[float, float]) -> None:
        """Show nothing."""

    def close(self) -> None:
        """Do nothing."""


def drive_by_hand(
    prepared: PreparedComparison, screen: Window | Script, until: float = math.inf
) -> tuple[FloatArray, KeyboardInterrupt | SsmrError | None]:
    """Drive all plants, MuJoCo's robot first, by the keys of a window or a script.

    Args:
        prepared: the plants.
        screen: where keys come from; the drive ends with it.
        until: time after which the drive ends, too [s].

    Returns:
        (n, 2) the commands, one for each `TICK` [m/s, rad/s], and the Ctrl-C or the failure of a plant that ended them.

    Raises:
        SsmrError: nothing was driven.
    """
    profile, plants, names = prepared.profile, prepared.plants, _names(prepared)
    for name in names:
        plants[name].step((0.0, 0.0), TICK)  # compiles what is compiled
        plants[name].reset(profile.section(name).localiser.body_state(State()))
    limits = profile.robot.drive.v_max, profile.robot.drive.w_max
    hand = HandCommand(*(limit if math.isfinite(limit) else _USUAL_LIMIT for limit in limits))
    given = list[tuple[float, float]]()
    ended: KeyboardInterrupt | SsmrError | None = None
    try:
        while (now := len(given) * TICK) < until - 1e-9 and screen.is_open(now):
            for key in screen.keys(now):
                hand.press(key)
            states = []
            for name in names:
                states.append(plants[name].step(hand.command(), TICK))
            given.append(hand.command())
            screen.show(now + TICK, states, hand.command())
    except (KeyboardInterrupt, SsmrError) as error:
        ended = SsmrError(f"{name}: {error}") if isinstance(error, SsmrError) else error
    finally:
        screen.close()
    if not given:
        raise SsmrError(f"nothing was driven, so no file is written{'' if ended is None else f': {ended}'}")
    return np.array(given), ended


def _names(prepared: PreparedComparison) -> list[str]:
    return [STANDARD, *(name for name in prepared.plants if name != STANDARD)]


class Window:
    """MuJoCo's viewer, which shows a stage from behind its first robot in real time; the mouse moves the eye."""

    def __init__(self, stage: Stage) -> None:
        """Open the window.

        Raises:
            NoWindowError: there is no screen, or no OpenGL for a window.
        """
        instead = "drive without a window by --keys FILE"
        if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise NoWindowError(f"there is no screen for MuJoCo's viewer; {instead}")
        import mujoco.viewer

        self._stage, self._pressed, self._turns = stage, deque[int](maxlen=100), np.zeros((len(stage.names), 2))
        try:
            self._viewer: Any = mujoco.viewer.launch_passive(
                stage.model, stage.data, key_callback=self._pressed.append, show_left_ui=False, show_right_ui=False
            )
        except (RuntimeError, mujoco.FatalError) as error:  # on macOS it says that mjpython must run the program
            raise NoWindowError(f"MuJoCo's viewer cannot be opened ({one_line(error)}); {instead}") from error
        with self._viewer.lock():
            camera = self._viewer.cam
            camera.type, camera.trackbodyid = mujoco.mjtCamera.mjCAMERA_TRACKING, stage.model.body("0").id
            camera.distance, camera.azimuth, camera.elevation = 4.5 * stage.looks.scale, 0.0, -30.0
        self._pacer, self._late, self._shown = Pacer(time.monotonic, time.sleep, _MOST_BEHIND), 0.0, 0.0

    @property
    def dropped(self) -> float:
        """Time by which the machine was too slow [s]: the drive took so much longer than its log says."""
        return self._pacer.dropped

    def is_open(self, now: float) -> bool:
        """Return whether the user has not closed the window yet."""
        return bool(self._viewer.is_running())

    def close(self) -> None:
        """Close the window."""
        self._viewer.close()

    def keys(self, now: float) -> list[str]:
        """Return the keys that were pressed since the last call."""
        codes = [self._pressed.popleft() for _ in range(len(self._pressed))]
        return [KEYS[code] for code in codes if code in KEYS]

    def show(self, now: float, states: Sequence[State], command: tuple[float, float]) -> None:
        """Show all robots, ghosts with their names, and time and command; then wait until that instant [s] has come."""
        stage, viewer = self._stage, self._viewer
        self._turns += TICK * np.array([(s.wheel_left, s.wheel_right) for s in states])
        if self._late < TICK or now - self._shown > _SHOWN_S:  # where drawing is slow, the robot shall not be
            self._shown = now
            with viewer.lock():
                for rank, s in enumerate(states):
                    pose = np.array([s.x, s.y, s.yaw])
                    stage.place(rank, pose, self._turns[rank])
                stage.settle()
                self._write_names(states)
            status = f"{now:.1f} s   {command[0]:+.2f} m/s   {command[1]:+.2f} rad/s"
            places = mujoco.mjtGridPos
            viewer.set_texts([(None, places.mjGRID_TOPLEFT, _HELP, ""), (None, places.mjGRID_BOTTOMLEFT, status, "")])
            viewer.sync()
        self._late = self._pacer.wait(now)

    def _write_names(self, states: Sequence[State]) -> None:
        """Write the names of the ghosts above them."""
        scene, looks = self._viewer.user_scn, self._stage.looks
        scene.ngeom = 0
        for rank, name in enumerate(self._stage.names[1:], start=1):
            geom, rgba = scene.geoms[scene.ngeom], np.array([*bright(name), 255], dtype=np.float32) / 255.0
            place = np.array([states[rank].x, states[rank].y, (1.4 + 0.3 * rank) * looks.size[2]])
            mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_LABEL, np.full(3, 0.1), place, np.eye(3).ravel(), rgba)
            geom.label = visible(name)[:90]
            scene.ngeom += 1


if __name__ == "__main__":
    drive.main()
