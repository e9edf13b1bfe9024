"""Sources: a scenario or a log as commands for plants, and as the motion to compare them with."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from pathlib import Path
from typing import Literal

import numpy as np

from ssmr.geometry import rotate_body_to_world, rotate_world_to_body
from ssmr.scenarios import TRAJECTORIES
from ssmr.simulation import SAMPLE_DT
from ssmr.types import (
    MOTOR_COLUMNS,
    CommandKind,
    Commands,
    FloatArray,
    IndexArray,
    State,
    Trajectory,
)
from validation.descriptions.loading import load_robot
from validation.files.columns import BESIDE_MOTION, COMMAND_COLUMNS, POSE_COLUMNS
from validation.files.formats import (
    SHIPPED_LOGS,
    AnyLog,
    is_log,
    log_name,
    log_path,
    readable,
)
from validation.files.inspection import (
    LEAST_COMMAND,
    WHEELS_MEAN_S,
    WHEELS_TURN,
    Inspected,
    open_log,
    too_short,
)
from validation.files.log import PLAIN, Group, Log, ReadOptions
from validation.files.motion import ENCODERS, ODOMETRY
from validation.files.reading import exists
from validation.files.signals import (
    TIME_ROUNDOFF,
    BoolArray,
    fresh_poses,
    held,
    moving_mean,
    refreshed,
)
from validation.output import one_line
from validation.plants.table import ALL_PLANTS, STANDARD, is_foreign, is_plant
from validation.simulator.description import Robot

RECORDING_GRID = 0.01
"""Period at which a log's inputs are held for the plants [s]: a whole number of every plant's
steps, finer than any log of ours."""
RECORDING = "recording"
"""The name of the reference where plants are compared with a log."""
_ODD = 1.3
"""Ratio of wheel radii beyond which it is another robot's, or the units are others."""
_BEGIN = 0.5
"""Length of the beginning whose poses say how a robot moves at first, and of the spans of which
slopes are taken [s]."""

WindowCut = Callable[[FloatArray, float, BoolArray | None], tuple[IndexArray, IndexArray]]
"""Function of stamps [s], a horizon [s] and the usable samples that returns starts and ends of
windows."""
Rates = Literal["instant", "mean"]
"""Wheel rates of a log: those at their stamps, or means since the stamps before, as counts of
encoders give them."""
Span = tuple[float | None, float | None]
"""Part of a log between two times [s]; None for its first or its last."""


@dataclass(frozen=True, eq=False)
class Piece:
    """One gap-free stretch of a source."""

    commands: Commands
    """Commands of the plants, from the first stamp on."""
    start: State
    """State of the tracked point at the first stamp."""
    t: FloatArray | None
    """(M,) stamps at which plants are compared [s]; None for a scenario, whose stamps are the
    simulation's."""
    reference: Trajectory | None
    """The recorded motion at those stamps; None for a scenario, whose reference is a plant."""
    fresh: BoolArray | None = None
    """(M,) where the recorded pose was new: scoring windows begin and end there."""
    jumps: tuple[int, ...] = ()
    """Indices of the first samples after jumps of the localiser: plants drive on, but no scoring
    window spans one."""
    moves: BoolArray | None = None
    """(M,) where the robot moves; None where nobody knows, and every window counts."""
    headings: FloatArray | None = None
    """(M,) headings of a better judge than the reference's, as late as these [rad]; None without
    one."""
    begins: tuple[float, float] = (-math.inf, math.inf)
    """Stamps from which on and before which windows may begin [s]."""
    torques: FloatArray | None = None
    """(M, 2) true torques of the left and the right motors [N m], NaN where nobody knows them; None
    where none can be believed."""

    def windows(
        self, cut: WindowCut, t: FloatArray, horizon: float, standing: bool = False
    ) -> tuple[IndexArray, IndexArray]:
        """Return (W,) starts and (W,) ends of windows of a `horizon` [s] between jumps.

        `cut` finds them in stamps `t`. Windows in which the robot stands throughout are left out;
        with `standing` they alone are returned.
        """
        bounds = []
        for a, b in pairwise((0, *self.jumps, len(t))):
            fresh = None if self.fresh is None else self.fresh[a:b]
            starts, ends = cut(t[a:b], horizon, fresh)
            bounds.append((a + starts, a + ends))
        starts, ends = map(np.concatenate, zip(*bounds, strict=True))
        # number of samples with motion before each sample: equal at both ends of a standing window
        moved = np.arange(len(t) + 1)
        if self.moves is not None:
            moved = np.cumulative_sum(self.moves, include_initial=True)
        kept = (moved[ends + 1] == moved[starts]) == standing
        first, stop = self.begins
        kept &= (t[starts] >= first) & (t[starts] < stop)
        return starts[kept], ends[kept]


@dataclass(frozen=True, eq=False)
class Source:
    """A motion to compare plants on."""

    name: str
    """Name that the user gave it."""
    pieces: tuple[Piece, ...]
    """Gap-free stretches, at least one."""
    reference: str
    """`recording`, or the plant that a scenario is compared with unless the user names another."""
    sample_dt: float
    """Period at which plants are sampled [s]."""
    warnings: tuple[str, ...] = ()
    """Sentences on what is wrong with a log, for programs to say."""
    remarks: tuple[str, ...] = ()
    """Sentences on what a log's signals are taken for."""
    title: str = ""
    """Name of a log in sentences, with its span of time where it was cut."""
    tags: tuple[str, ...] = ()
    """Names by which numbers are a log's own in a fit: its own name, and that of its ground."""
    inspected: Inspected | None = None
    """The log itself, on one clock, and what it shows; None of a scenario."""

    @property
    def truth(self) -> tuple[Trajectory, ...]:
        """The recorded motion, piece by piece; empty of a scenario."""
        return tuple(piece.reference for piece in self.pieces if piece.reference is not None)

    def driven(self, motions: Sequence[Trajectory]) -> list[tuple[Piece, Trajectory]]:
        """Return each piece with a plant's motion over it."""
        return list(zip(self.pieces, motions, strict=True))


# ------------------------------------------------------------------------------------------ opening
AnySource = AnyLog | Source
"""A source: the name of a scenario, a log, or a source itself."""


def source_name(given: AnySource) -> str:
    """Return the name of a source as its user gave it, see `log_name`."""
    return given.name if isinstance(given, Source) else log_name(given)


def open_source(
    given: AnySource,
    kind: CommandKind = "twist",
    start: float | None = None,
    stop: float | None = None,
    options: ReadOptions = PLAIN,
    radius: float | None = None,
    rates: Rates = "instant",
) -> Source:
    """Open a scenario (`traj1` ... `traj4`, also with `@PLANT`) or a log; a source stays as it is.

    A log is given by its path or the name of a shipped one, as a frame of pandas with the columns
    of a CSV file, or as a `Log`. `kind` says which of its inputs drives the plants; samples before
    `start` or after `stop` [s] are left out; `options` say how it is read, and `radius` is that of
    the robot's wheels [m], where it is known; `rates` is what a log's wheel rates are.

    Raises:
        ValueError: an unknown name, a log that cannot be read or lacks the inputs or the pose, or a
            time span of something else than a log.
    """
    name = source_name(given)
    is_path = isinstance(given, str | Path)
    is_scenario = is_path and name.partition("@")[0] in TRAJECTORIES
    if (is_scenario or isinstance(given, Source)) and (start is not None or stop is not None):
        what = "a scenario" if is_scenario else "a source already: cut its log"
        raise ValueError(f"a time span cuts recordings; {name} is {what}")
    if isinstance(given, Source):
        return given
    if is_scenario:
        return _open_scenario(name, kind)
    if is_path and not exists(log_path(name)) and not is_log(log_path(name)):
        scenarios = f"{', '.join(TRAJECTORIES)}, each also as NAME@PLANT"
        raise ValueError(
            f"no source '{name}'; there are: {scenarios}, "
            f"the logs {', '.join(SHIPPED_LOGS)}, and paths of recordings ({readable()})"
        )
    return source_of(open_log(given, options, radius), name, kind, (start, stop), rates)


def _open_scenario(name: str, kind: CommandKind) -> Source:
    """Open a scenario; the arguments are those of `open_source`."""
    scenario, _, plant = name.partition("@")
    if plant and not is_plant(plant):
        raise ValueError(f"unknown plant '{plant}' in '{name}'; there are: {', '.join(ALL_PLANTS)}")
    if kind == "wheels":
        raise ValueError(
            f"{name} is a scenario and has no measured wheel rates; "
            "input by wheels needs a recording"
        )
    piece = Piece(TRAJECTORIES[scenario].commands(), State(), None, None)
    return Source(name, (piece,), plant or STANDARD, SAMPLE_DT)


_WITHOUT_POSE = (
    "the pose by which predictions are judged; "
    "`recordings info` says what its gyro and wheels tell without"
)
_WITHOUT_WHEELS = (
    "the wheel rates; `--input commands` drives by commands or by the odometry's speeds"
)


def _require_columns(log: Log, names: Sequence[str], what: str) -> None:
    lack = [name for name in names if not log.has([name])]
    if lack:
        raise ValueError(f"log {log.name} has no column {', '.join(lack)}, {what}")


def source_of(
    inspected: Inspected,
    name: str,
    kind: CommandKind = "twist",
    span: Span = (None, None),
    rates: Rates = "instant",
) -> Source:
    """Return a log, or a part of it, as a motion to compare plants on.

    Where the log has no commands, the speeds of its odometry stand for them, and a warning says so.
    `name` is the one that the user gave it; `kind` says which of its inputs drives the plants,
    `span` which part of it they drive along, and `rates` what its wheel rates are.

    Raises:
        ValueError: it lacks the inputs or the pose, or nothing was logged in the span.
    """
    log = inspected.common.cut(*span)
    names = COMMAND_COLUMNS[kind]
    sentences = [*(fault.sentence for fault in inspected.faults), *inspected.sentences()]
    _require_columns(log, POSE_COLUMNS, _WITHOUT_POSE)
    if kind == "wheels":
        _require_columns(log, names, _WITHOUT_WHEELS)
    times = f", {log.t[0]:.0f} to {log.t[-1]:.0f} s" if span != (None, None) else ""
    title = log.name + times
    if kind == "twist" and not log.has(names) and log.has(ODOMETRY):
        names = ODOMETRY
        sentences.append(
            "no commands were recorded, "
            "so the odometry's speeds, odom_v and odom_w, drive the plants instead"
        )
    periods = (float(log.t[-1]) - float(log.t[0])) / RECORDING_GRID
    if periods > log.limits.samples:
        raise ValueError(
            f"{name} has {periods:.4g} periods of {RECORDING_GRID} s, "
            f"but {log.limits.says('samples')}; cut it"
        )
    pose = log.table(POSE_COLUMNS)
    gyro = log.columns.get("gyro_z")
    moves = np.abs(log.table(names)).max(axis=1) > LEAST_COMMAND
    wheels = log.table(ENCODERS) if log.has(ENCODERS) else np.zeros((len(pose), 2))
    if log.has(ENCODERS):
        means = [moving_mean(log.t, side, WHEELS_MEAN_S) for side in wheels.T]
        moves = np.abs(means).max(axis=0) > WHEELS_TURN
    others = {key: log.table(pair) for key, pair in MOTOR_COLUMNS.items() if log.has(pair)}
    others |= {
        name: log.columns[name] for name in chain(*BESIDE_MOTION.values()) if log.has([name])
    }
    fresh = fresh_poses(log.t, pose)
    on_time, jumps = _sound_poses(inspected, log.t)
    ends = fresh & on_time
    group = inspected.log.group_of(names)
    assert group is not None
    pieces = []
    stretches = log.stretches()
    for s, t in zip(stretches, map(log.t.__getitem__, stretches), strict=True):
        stamps, samples = _samples_within(group, names, t)
        commands = commands_on_grid(stamps, samples, kind, RECORDING_GRID, t, rates)
        turning = None if gyro is None else gyro[s]
        motion = _recorded_motion(t, pose[s], fresh[s], wheels[s], turning)
        channels = {key: table[s] for key, table in others.items()}
        inside = jumps[(jumps > s.start) & (jumps < s.stop)] - s.start
        piece = Piece(
            # the delay lines are filled with the first command: nobody knows the ones before
            commands=replace(commands, before=tuple(commands.values[0].tolist())),
            start=_initial_state(t, pose[s], fresh[s], wheels[s][0]),
            t=motion.t,
            reference=replace(motion, channels=channels),
            fresh=ends[s],
            jumps=tuple(inside.tolist()),
            moves=moves[s],
        )
        pieces.append(piece)
    sentences += too_short(max(np.ptp(log.t[s]) for s in stretches))
    warnings = tuple(one_line(f"{log.name}: {sentence}") for sentence in sentences)
    return Source(
        name, tuple(pieces), RECORDING, RECORDING_GRID, warnings, title=title, inspected=inspected
    )


def _sound_poses(inspected: Inspected, t: FloatArray) -> tuple[BoolArray, IndexArray]:
    """Return (N,) where poses at instants `t` [s] are neither late nor between those of a jump.

    Second are the indices of the first instants after the jumps.
    """
    jumps = inspected.jumps
    poses = inspected.poses
    sound = np.ones(len(t), dtype=bool)
    if jumps is None or poses is None:
        return sound, np.empty(0, dtype=np.intp)
    # what lies between two poses of the log was made of the later one as well
    stamps = poses.group.t
    sound &= ~jumps.late[np.minimum(np.searchsorted(stamps, t), len(stamps) - 1)]
    begun = np.searchsorted(jumps.since, t, side="left")
    ended = np.searchsorted(jumps.t, t, side="right")
    return sound & (begun == ended), np.searchsorted(t, jumps.t)


def _samples_within(
    group: Group, names: Sequence[str], t: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return (K,) stamps [s] and (K, 2) columns of a group's samples over a stretch of time.

    The first one is the last before the (M,) instants `t` [s], the last one the first after them.
    """
    first = max(np.searchsorted(group.t, t[0], side="right") - 1, 0)
    stop = np.searchsorted(group.t, t[-1]) + 1
    columns = [group.columns[name][first:stop] for name in names]
    return group.t[first:stop], np.column_stack(columns)


def commands_on_grid(
    stamps: FloatArray,
    inputs: FloatArray,
    kind: CommandKind,
    dt: float,
    t: FloatArray | None = None,
    rates: Rates = "instant",
) -> Commands:
    """Return inputs on a uniform grid: ceil(duration / dt) commands, from the first instant on.

    Commands are held until the next sample (zero-order hold): each grid time takes the last sample
    at or before it, where a sample up to `TIME_ROUNDOFF` later counts too. Wheel rates are
    measurements of something that goes on between samples: each side is interpolated linearly from
    one fresh sample of its own to the next and taken in the middle of each period. Holding them
    would make the wheels late by half a sample.

    Args:
        stamps: (K,) stamps of the inputs [s].
        inputs: (K, 2) inputs.
        kind: which inputs they are.
        dt: period of the grid [s].
        t: (M,) instants that the grid covers [s], `stamps` if not given. Commands with stamps of
            their own count as zero before the first one, and when they are half a second old.
        rates: what wheel rates are; a mean is that of the middle of its period.
    """
    covered = stamps if t is None else t
    since = stamps - covered[0]
    length = covered[-1] - covered[0]
    n = max(1, math.ceil((length - TIME_ROUNDOFF) / dt))
    if kind == "wheels":
        middle = (np.arange(n) + 0.5) * dt
        sides = []
        for side in inputs.T:
            new = refreshed(since, side[:, None])
            at = since[new]
            if rates == "mean":
                at = at - 0.5 * np.diff(at, prepend=at[:1])
            sides.append(np.interp(middle, at, side[new]))
        return Commands(dt, np.column_stack(sides), kind)
    grid = np.asarray(np.arange(n) * dt, dtype=np.float64)
    if np.array_equal(stamps, covered):
        last = np.searchsorted(since, grid + TIME_ROUNDOFF, side="right") - 1
        return Commands(dt, inputs[last], kind)
    columns = [held(grid, since, column) for column in inputs.T]
    return Commands(dt, np.column_stack(columns), kind)


def _initial_state(t: FloatArray, pose: FloatArray, fresh: BoolArray, wheels: FloatArray) -> State:
    """Return the first of (M, 3) poses at stamps [s], and the constant twist that fits best there.

    A straight line is fitted to yaw; then, along that yaw, the arc p(t) = p_0 + t sinc(w t / 2)
    R(yaw_0 + w t / 2) v to the positions. Both are linear least squares, and exact for a constant
    twist. Only fresh samples of the first `_BEGIN` are used, or three of them; the twist is zero
    where no pose is new. `wheels` are the (2,) rates of that moment [rad/s].
    """
    first = np.flatnonzero(fresh)
    early = np.count_nonzero(t[first] - t[0] <= _BEGIN + TIME_ROUNDOFF)
    first = first[: max(3, early)]
    v = np.zeros(2)
    yaw_rate = 0.0
    if len(first) >= 2:
        at = t[first] - t[0]
        moved = pose[first] - pose[0]
        centred = at - at.mean()
        yaw_rate = centred @ moved[:, 2] / (centred @ centred)
        half_turn = 0.5 * yaw_rate * at
        # of unit v_x and of unit v_y, in the body
        chord = (at * np.sinc(half_turn / np.pi))[:, None, None] * np.eye(2)
        yaw = pose[0, 2] + moved[:, 2].mean() - yaw_rate * at.mean() + half_turn
        arcs = rotate_body_to_world(chord, yaw[:, None])  # (n, which of v, which of xy)
        design = np.swapaxes(arcs - arcs.mean(axis=0), 1, 2).reshape(-1, 2)
        offsets = moved[:, :2] - moved[:, :2].mean(axis=0)
        v = np.linalg.lstsq(design, offsets.ravel())[0]
    return State(*map(float, (*pose[0], *v, yaw_rate, *wheels)))


def _recorded_motion(
    t: FloatArray,
    pose: FloatArray,
    fresh: BoolArray,
    wheels: FloatArray,
    gyro: FloatArray | None,
) -> Trajectory:
    """Return the recorded poses with speeds, which are slopes of fresh samples over `_BEGIN`.

    The yaw rate is the gyro's if there is one.
    """
    velocity = np.zeros_like(pose)
    stamps = t[fresh]
    if len(stamps) > 1:
        low = np.clip(t - 0.5 * _BEGIN, stamps[0], stamps[-1])
        high = np.clip(t + 0.5 * _BEGIN, stamps[0], stamps[-1])
        rises = []
        for column in pose[fresh].T:
            rises.append(np.interp(high, stamps, column) - np.interp(low, stamps, column))
        velocity = np.column_stack(rises) / np.maximum(high - low, 1e-9)[:, None]
    speeds = rotate_world_to_body(velocity[:, :2], pose[:, 2])
    turning = velocity[:, 2] if gyro is None else gyro
    return Trajectory(t, pose, np.column_stack([speeds, turning]), wheels)


_SAME_SIZE = 0.1
"""Greatest relative difference of sizes at which one robot's driver still suits another."""


def unknown_robot_notes(source: Source, robot: Robot) -> list[str]:
    """Return the notes on a log of a robot that nobody named; it is taken for `robot`.

    Wheel rates against speed and yaw rate say how large wheels and effective track are, which is
    usually 1.2 to 2.2 times the track. Where these are odd for `robot`, a second note says so,
    which is a warning.
    """
    if source.reference != RECORDING or source.name in SHIPPED_LOGS:
        return []
    note = (
        f"{source.title}: taken for a {robot.title or robot.name}, "
        "because neither --robot nor --profile names another"
    )
    motions = [motion for motion in source.truth if np.any(motion.wheels)]
    if not motions:
        return [note]
    wheels = np.concatenate([motion.wheels for motion in motions])
    twist = np.concatenate([motion.twist for motion in motions])
    mean = wheels.mean(axis=1)
    difference = np.diff(wheels)[:, 0]
    radius = twist[:, 0] @ mean / max(mean @ mean, 1e-9)
    # the sign is the gyro's
    turned = max(abs(twist[:, 2] @ difference), 1e-9)
    width = radius * (difference @ difference / turned)
    odd = []
    for what, turns, value, size, least, most in (
        ("wheel radius", mean, radius, robot.wheel_radius, 1.0 / _ODD, _ODD),
        ("track", difference, width, robot.track, 0.9, 3.0),
    ):
        if np.abs(turns).max() > WHEELS_TURN and not least < value / size < most:
            odd.append(f"a {what} of {value:.2f} m for its {size:.2f} m")
    if odd:
        return [note, f"{source.title}: the log shows {' and '.join(odd)}. Name the robot"]
    return [note]


def driver_warnings(plants: Iterable[str], robot: Robot) -> list[str]:
    """Return a sentence for each MJCF among `plants` that is not as large as the profile's robot.

    The driver that makes wheel rates of commands is that of the profile.
    """
    sentences = []
    for name in filter(is_foreign, plants):
        theirs = load_robot(name)
        sizes = {
            "track": (theirs.track, robot.track),
            "wheel radius": (theirs.wheel_radius, robot.wheel_radius),
        }
        for what, (size, known) in sizes.items():
            if abs(size / known - 1.0) > _SAME_SIZE:
                sentences.append(
                    f"{name} has a {what} of {size:.3g} m, but its driver is that of {robot.name}, "
                    f"with {known:.3g} m; --robot {name} gives it its own"
                )
                break
    return sentences
