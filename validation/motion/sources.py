"""Open a scenario or a recording: commands that drive the plants, and the motion to compare them with."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ssmr.geometry import rotate_world_to_body
from ssmr.scenarios import TRAJECTORIES
from ssmr.simulation import SAMPLE_DT
from ssmr.types import CommandKind, Commands, FloatArray, IndexArray, State, Trajectory
from validation.logs.files import exists
from validation.logs.formats import is_log, log_path, read_recording, readable
from validation.logs.groups import groups_of
from validation.logs.health import find_faults
from validation.logs.limits import USUAL, LogLimits
from validation.logs.recording import Recording, Segment
from validation.plants.table import ALL_PLANTS, STANDARD

_logger = logging.getLogger(__name__)

RECORDING_GRID = 0.01
"""Period at which a recording's inputs are held for the plants [s]: a whole number of every plant's steps, finer than any
log of ours."""

_MOST_PIECES = 10_000
"""Greatest number of gap-free stretches of a recording: a log that has more has no rate of its own."""
RECORDING = "recording"
"""The name of the reference where plants are compared with a recorded motion."""

ODOMETRY_SPEEDS = {"odom_v": "cmd_v", "odom_w": "cmd_w"}
"""Channels of a log that stand for commands which were not recorded."""

WindowCut = Callable[[FloatArray, float, NDArray[np.bool_] | None], tuple[IndexArray, IndexArray]]
"""Function of stamps [s], a horizon [s] and the usable samples that returns starts and ends of windows."""


@dataclass(frozen=True, eq=False)
class Piece:
    """One gap-free stretch of a source."""

    commands: Commands
    """Commands of the plants, from the first stamp on."""
    start: State
    """State of the tracked point at the first stamp."""
    t: FloatArray | None
    """(M,) stamps at which plants are compared [s]; None for a scenario, whose stamps are the simulation's."""
    reference: Trajectory | None
    """The recorded motion at those stamps; None for a scenario, whose reference is a plant."""
    fresh: NDArray[np.bool_] | None = None
    """(M,) where the recorded pose was new: scoring windows begin and end there."""
    jumps: tuple[int, ...] = ()
    """Indices of the first samples after jumps of the localiser: plants drive on, but no scoring window spans one."""

    def windows(self, cut: WindowCut, t: FloatArray, horizon: float) -> tuple[IndexArray, IndexArray]:
        """Return (W,) starts and (W,) ends of scoring windows in this piece: `cut` for each stretch between jumps.

        Args:
            cut: function that cuts windows, such as `horizon_windows`.
            t: (M,) the piece's stamps, for a scenario the simulation's [s].
            horizon: length of a window [s].
        """
        found = []
        for a, b in pairwise((0, *self.jumps, len(t))):
            starts, ends = cut(t[a:b], horizon, None if self.fresh is None else self.fresh[a:b])
            found.append((a + starts, a + ends))
        return np.concatenate([starts for starts, _ in found]), np.concatenate([ends for _, ends in found])


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
    """Sentences about what is wrong with a recording."""
    title: str = ""
    """Name of a recording in sentences, with its span of time where it was cut."""


def open_source(
    name: str, kind: CommandKind = "twist", start: float | None = None, stop: float | None = None, limits: LogLimits = USUAL
) -> Source:
    """Open a scenario or a recording by its name.

    Args:
        name: `traj1` ... `traj4`, one of them with `@PLANT`, the path of a recording, or `sample`.
        kind: which of a recording's inputs drives the plants.
        start: leave out what was recorded before [s].
        stop: leave out what was recorded after [s].
        limits: greatest sizes and numbers of a recording; the usual ones if not given.

    Raises:
        ValueError: an unknown name, a recording that cannot be read or lacks what is asked for.
    """
    scenario, _, plant = name.partition("@")
    if scenario in TRAJECTORIES:
        if plant and plant not in ALL_PLANTS:
            raise ValueError(f"unknown plant '{plant}' in '{name}'; there are: {', '.join(ALL_PLANTS)}")
        if kind == "wheels":
            raise ValueError(f"{name} is a scenario and has no measured wheel rates; input by wheels needs a recording")
        if start is not None or stop is not None:
            raise ValueError(f"a time span cuts recordings; {name} is a scenario")
        piece = Piece(TRAJECTORIES[scenario].commands(), State(), None, None)
        return Source(name, (piece,), plant or STANDARD, SAMPLE_DT)
    path = log_path(name)
    if exists(path) or is_log(path):
        recording = read_recording(path, limits).cut(start, stop)
        periods = (float(recording.t[-1]) - float(recording.t[0])) / RECORDING_GRID
        if periods > limits.samples:
            raise ValueError(f"{name} has {periods:.4g} periods of {RECORDING_GRID} s, but {limits.says('samples')}; cut it")
        if (stretches := len(recording.segments())) > _MOST_PIECES:
            raise ValueError(
                f"{name} has {stretches} stretches between gaps, wanted at most {_MOST_PIECES}: its steps of time vary"
            )
        span = "" if start is None and stop is None else f", {recording.t[0]:.0f} to {recording.t[-1]:.0f} s"
        return source_of(recording, name, kind, recording.name + span)
    paths = f"paths of recordings ({readable()})"
    raise ValueError(
        f"no source '{name}'; there are: {', '.join(TRAJECTORIES)}, each also as NAME@PLANT, sample, and {paths}"
    )


def source_of(recording: Recording, name: str, kind: CommandKind = "twist", title: str | None = None) -> Source:
    """Return a recording as a motion to compare plants on; what is wrong with it is logged as a warning too.

    Where the recording has no commands, the speeds of its odometry stand for them, and a warning says so.

    Args:
        recording: the recording.
        name: name that the user gave it.
        kind: which of its inputs drives the plants.
        title: name in sentences; the recording's own if not given.

    Raises:
        ValueError: it lacks the inputs or the pose.
    """
    health = find_faults(groups_of(recording, name))
    stand_in = []
    if kind == "twist" and not recording.has_commands and set(ODOMETRY_SPEEDS) <= set(recording.channels):
        speeds = {command: recording.channels[speed] for speed, command in ODOMETRY_SPEEDS.items()}
        recording = replace(recording, columns={**recording.columns, **speeds})
        stand_in = ["no commands were recorded, so the odometry's speeds, odom_v and odom_w, drive the plants instead"]
    jumps = np.empty(0, dtype=np.intp) if health.jumps is None else health.jumps.index
    pieces = tuple(_piece(s, kind, jumps) for s in recording.segments())
    title = title or recording.name
    warnings = tuple(f"{title}: {sentence}" for sentence in [*stand_in, *health.sentences()])
    for warning in warnings:
        _logger.warning("%s", warning)
    return Source(name, pieces, RECORDING, RECORDING_GRID, warnings, title)


def _piece(segment: Segment, kind: CommandKind, jumps: IndexArray) -> Piece:
    commands = segment.commands(kind, RECORDING_GRID)
    start = segment.initial_state()
    before = (float(commands.values[0, 0]), float(commands.values[0, 1]))
    inside = jumps[(jumps > segment.start) & (jumps < segment.stop)] - segment.start
    motion = _recorded_motion(segment)
    return Piece(replace(commands, before=before), start, segment.t, motion, segment.fresh, tuple(inside.tolist()))


def _recorded_motion(segment: Segment) -> Trajectory:
    """Return the recorded pose; speeds are its slope over half a second, yaw rate the gyro's where there is one."""
    velocity = _slopes(segment.t, segment.pose, segment.fresh)
    twist = np.column_stack([rotate_world_to_body(velocity[:, :2], segment.pose[:, 2]), velocity[:, 2]])
    columns = segment.recording.columns
    if "gyro_z" in columns:
        twist[:, 2] = columns["gyro_z"][segment.start : segment.stop]
    wheels = segment.inputs("wheels") if segment.recording.has_wheels else np.zeros((len(segment.t), 2))
    return Trajectory(segment.t, segment.pose, twist, wheels)


def _slopes(t: FloatArray, values: FloatArray, fresh: NDArray[np.bool_], span: float = 0.5) -> FloatArray:
    """(M, k) rates of change over a centred `span` [s], from fresh samples only."""
    known_t, known = t[fresh], values[fresh]
    if len(known_t) < 2:
        return np.zeros_like(values)
    low, high = np.clip(t - 0.5 * span, known_t[0], known_t[-1]), np.clip(t + 0.5 * span, known_t[0], known_t[-1])
    rise = np.column_stack([np.interp(high, known_t, column) - np.interp(low, known_t, column) for column in known.T])
    return rise / np.maximum(high - low, 1e-9)[:, None]
