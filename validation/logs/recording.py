"""Recordings of a robot on one clock: its commands, its wheels and its pose.

A recording has a time `t` [s] that increases and any of the columns of `RECORDING_COLUMNS`; other columns are kept as
channels. A long step of time is a gap, and nothing here bridges one: `Recording.segments` returns the stretches between
gaps. The pose is that of the point which the localiser tracked.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssmr.geometry import rotate_body_to_world
from ssmr.types import CommandKind, Commands, FloatArray, State, frozen_array
from validation.logs.files import TableError

_logger = logging.getLogger(__name__)

RECORDING_COLUMNS: Mapping[str, str] = MappingProxyType(
    {"cmd_v": "m/s"}
    | dict.fromkeys(("cmd_w", "enc_left", "enc_right", "gyro_z"), "rad/s")
    | {"x": "m", "y": "m", "yaw": "rad"}
)
"""Units of the columns whose meaning is known."""
_KNOWN = ", ".join(RECORDING_COLUMNS)
COMMAND_COLUMNS: Mapping[CommandKind, tuple[str, str]] = MappingProxyType(
    {"twist": ("cmd_v", "cmd_w"), "wheels": ("enc_left", "enc_right")}
)
"""The two columns that drive a plant, by kind of command."""
POSE_COLUMNS = ("x", "y", "yaw")

TIME_ROUNDOFF = 1e-6
"""Instants closer than this are the same one: well over rounding, well under any sample step [s]."""
_STILL_AFTER = 1.0
"""A pose that repeats for longer means that the robot stands, not that the localiser is slower than the log [s]."""


class RecordingError(TableError):
    """A file is no recording that can be used."""

    wanted = "a CSV recording (.csv)"
    header = f"a recording begins with a header line, separated by commas, that names t and any of {_KNOWN}"


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording of one robot, M samples; checked, copied and read-only."""

    name: str
    """Name in tables and pictures: the file's name without its ending."""
    t: FloatArray
    """(M,) strictly increasing [s], M at least 2."""
    columns: Mapping[str, FloatArray]
    """Known columns by name, at least one, each (M,) as recorded: yaw may be wrapped."""
    channels: Mapping[str, FloatArray] = field(default_factory=dict)
    """Other columns by name, each (M,)."""
    gap_factor: float = 2.5
    """A step longer than this many periods is a gap: at 2.5 one dropped sample is tolerated, two are not."""
    period: float = math.nan
    """Median sample step [s]; taken from `t` unless given. `cut` keeps it, so that cutting moves no gap."""

    def __post_init__(self) -> None:
        """Check the columns and make them read-only.

        Raises:
            ValueError: fewer than two samples, time that does not increase, lengths that differ, numbers not finite,
                no known column, a channel that a file cannot name, or a gap factor or period that makes no sense.
        """
        t = frozen_array(self.t, "t", (None,))
        if len(t) < 2:
            raise ValueError(f"a recording needs at least two samples, got {len(t)}")
        if np.any(t[1:] <= t[:-1]):
            raise ValueError(f"t must increase; it does not after sample {int(np.argmax(t[1:] <= t[:-1]))}")
        if not self.gap_factor >= 1.0:
            raise ValueError(f"the gap factor must be at least 1, got {self.gap_factor}")
        unknown = [n for n in self.columns if n not in RECORDING_COLUMNS]
        if unknown or not self.columns:
            raise ValueError(f"unknown columns: {', '.join(unknown) or 'none at all'}; wanted any of {_KNOWN}")
        misplaced = [n for n in self.channels if n == "t" or n in RECORDING_COLUMNS or not is_channel_name(n)]
        if misplaced:
            raise ValueError(f"no name for a channel: {misplaced[0]!r}")
        object.__setattr__(self, "t", t)
        if math.isnan(self.period):
            object.__setattr__(self, "period", float(np.median(np.diff(t))))
        if not self.period > 0.0:
            raise ValueError(f"the period must be positive, got {self.period} s")
        for kind in ("columns", "channels"):
            frozen = {n: frozen_array(values, n, (len(t),)) for n, values in getattr(self, kind).items()}
            object.__setattr__(self, kind, MappingProxyType(frozen))

    @classmethod
    def from_columns(cls, name: str, columns: Mapping[str, ArrayLike], gap_factor: float = 2.5) -> Recording:
        """Return a recording of (M,) columns by name, `t` among them: known columns, and channels for the others.

        Raises:
            ValueError: there is no `t`, or the recording would not be valid.
        """
        if "t" not in columns:
            raise ValueError(f"{name} has no column t")
        arrays = {n: np.asarray(values, dtype=np.float64) for n, values in columns.items()}
        known = {n: a for n, a in arrays.items() if n in RECORDING_COLUMNS}
        channels = {n: a for n, a in arrays.items() if n != "t" and n not in RECORDING_COLUMNS}
        return cls(name, arrays["t"], known, channels, gap_factor)

    def __len__(self) -> int:
        """Return the number of samples, M."""
        return len(self.t)

    def all_columns(self) -> dict[str, FloatArray]:
        """Return t, the known columns and the channels by name, each (M,)."""
        return {"t": self.t, **self.columns, **self.channels}

    @property
    def has_commands(self) -> bool:
        """True if body velocities were recorded as commands: cmd_v and cmd_w."""
        return all(n in self.columns for n in COMMAND_COLUMNS["twist"])

    @property
    def has_wheels(self) -> bool:
        """True if wheel rates were recorded: enc_left and enc_right."""
        return all(n in self.columns for n in COMMAND_COLUMNS["wheels"])

    @property
    def has_pose(self) -> bool:
        """True if x, y and yaw were recorded."""
        return all(n in self.columns for n in POSE_COLUMNS)

    def table(self, names: Sequence[str]) -> FloatArray:
        """Return (M, len(names)) known columns side by side.

        Raises:
            ValueError: a column was not recorded; the message names it.
        """
        missing = [n for n in names if n not in self.columns]
        if missing:
            raise ValueError(f"recording {self.name} has no column {', '.join(missing)}; it has {', '.join(self.columns)}")
        return frozen_array(np.stack([self.columns[n] for n in names], axis=1), self.name, (len(self), len(names)))

    @cached_property
    def pose(self) -> FloatArray:
        """(M, 3): x [m], y [m], yaw [rad, unwrapped] of the tracked point; ValueError where a column is missing."""
        pose = self.table(POSE_COLUMNS).copy()
        pose[:, 2] = np.unwrap(pose[:, 2])
        pose.setflags(write=False)
        return pose

    def segments(self) -> tuple[Segment, ...]:
        """Return the stretches between gaps, in order; a sample alone between two gaps belongs to none.

        Raises:
            ValueError: every step is a gap, as a cut around one may leave it.
        """
        gaps = np.flatnonzero(np.diff(self.t) > self.gap_factor * self.period + TIME_ROUNDOFF)
        edges = [0, *(gaps + 1).tolist(), len(self)]
        segments = tuple(Segment(self, a, b) for a, b in pairwise(edges) if b - a >= 2)
        alone = len(self) - sum(map(len, segments))
        if alone:
            _logger.info("%s: %d samples stand alone between gaps and are left out", self.name, alone)
        if not segments:
            raise ValueError(f"recording {self.name} is nothing but gaps between {self.t[0]:g} and {self.t[-1]:g} s")
        return segments

    def cut(self, start_s: float | None = None, stop_s: float | None = None) -> Recording:
        """Return the samples with `start_s` <= t <= `stop_s` [s]; None leaves that end as it is.

        Raises:
            ValueError: fewer than two samples lie there.
        """
        start, stop = (-math.inf if start_s is None else start_s), (math.inf if stop_s is None else stop_s)
        keep = (self.t >= start) & (self.t <= stop)
        if (n := np.count_nonzero(keep)) < 2:
            span = f"it spans {self.t[0]:g} to {self.t[-1]:g} s"
            raise ValueError(f"recording {self.name} has {n} samples in {start:g} to {stop:g} s, wanted two or more; {span}")
        columns, channels = ({n: a[keep] for n, a in group.items()} for group in (self.columns, self.channels))
        return replace(self, t=self.t[keep], columns=columns, channels=channels)


@dataclass(frozen=True, eq=False)
class Segment:
    """Consecutive samples of a recording, M of them, without a gap; a view that copies nothing."""

    recording: Recording
    start: int
    """Index of its first sample in the recording."""
    stop: int
    """Index after its last sample in the recording."""

    def __post_init__(self) -> None:
        """Check; ValueError if these are not at least two samples of the recording."""
        if not (0 <= self.start and self.start + 2 <= self.stop <= len(self.recording)):
            raise ValueError(f"no segment of {len(self.recording)} samples: {self.start} to {self.stop}")

    def __len__(self) -> int:
        """Return the number of samples, M."""
        return self.stop - self.start

    @property
    def t(self) -> FloatArray:
        """(M,) strictly increasing, on the recording's clock [s]."""
        return self.recording.t[self.start : self.stop]

    @property
    def pose(self) -> FloatArray:
        """(M, 3): x [m], y [m], yaw [rad, unwrapped] of the tracked point; ValueError where a column is missing."""
        return self.recording.pose[self.start : self.stop]

    def inputs(self, kind: CommandKind) -> FloatArray:
        """Return the (M, 2) samples that can drive a plant: cmd_v, cmd_w for `twist`; enc_left, enc_right for `wheels`.

        Raises:
            ValueError: the kind is unknown, or its columns were not recorded.
        """
        if kind not in COMMAND_COLUMNS:
            raise ValueError(f"unknown kind of command '{kind}'; there are: {', '.join(COMMAND_COLUMNS)}")
        return self.recording.table(COMMAND_COLUMNS[kind])[self.start : self.stop]

    def commands(self, kind: CommandKind, dt: float) -> Commands:
        """Return the inputs on a uniform grid that begins with the first sample.

        Commands are held until the next sample (zero-order hold): each grid time takes the last sample at or before it,
        where a sample up to `TIME_ROUNDOFF` later counts too. Wheel rates are measurements of something that goes on
        between samples: each side is interpolated linearly from one fresh sample of its own to the next and taken in the
        middle of each period. Holding them would make the wheels late by half a sample.

        There are ceil(duration / dt) commands, so that only the last may end after the last sample.

        Args:
            kind: `twist` or `wheels`.
            dt: period of the grid [s].

        Returns:
            N commands; command k is held over [t_0 + k dt, t_0 + (k + 1) dt).

        Raises:
            ValueError: the columns were not recorded, or the period is not positive.
        """
        values = self.inputs(kind)
        if not (math.isfinite(dt) and dt > 0.0):
            raise ValueError(f"the command period must be positive, got {dt} s")
        t = self.t - self.t[0]
        n = max(1, math.ceil((float(t[-1]) - TIME_ROUNDOFF) / dt))
        if kind == "wheels":
            middle = (np.arange(n) + 0.5) * dt
            known = [refreshed(t, side[:, None]) for side in values.T]
            sides = [np.interp(middle, t[new], side[new]) for new, side in zip(known, values.T, strict=True)]
            return Commands(dt, np.column_stack(sides), kind)
        held = np.searchsorted(t, np.arange(n) * dt + TIME_ROUNDOFF, side="right") - 1
        return Commands(dt, values[held], kind)

    @property
    def fresh(self) -> NDArray[np.bool_]:
        """(M,) bool, True where the localiser gave a new pose; see `fresh_poses`."""
        return fresh_poses(self.t, self.pose)

    def initial_state(self, span: float = 0.5) -> State:
        """Return pose and wheel rates of the first sample, and the constant twist that fits the first poses best.

        A straight line is fitted to yaw; then, along that yaw, the arc p(t) = p_0 + t sinc(w t / 2) R(yaw_0 + w t / 2) v to
        the positions. Both are linear least squares, and exact for a constant twist. Only fresh samples are used.

        Args:
            span: length of the beginning that is used [s]; three fresh samples are used even if they take longer.

        Returns:
            The state at the first sample. Wheel rates are zero where none were recorded, the twist where no pose is new.

        Raises:
            ValueError: there is no pose.
        """
        fresh = np.flatnonzero(self.fresh)
        fresh = fresh[: max(3, np.count_nonzero(self.t[fresh] - self.t[0] <= span + TIME_ROUNDOFF))]
        wheels = self.inputs("wheels")[0] if self.recording.has_wheels else np.zeros(2)
        v, yaw_rate = np.zeros(2), 0.0
        if len(fresh) >= 2:
            t, pose = self.t[fresh] - self.t[0], self.pose[fresh] - self.pose[0]
            centred = t - t.mean()
            yaw_rate = float(centred @ pose[:, 2] / (centred @ centred))
            half_turn = 0.5 * yaw_rate * t
            chord = (t * np.sinc(half_turn / np.pi))[:, None, None] * np.eye(2)  # of unit v_x and of unit v_y, in the body
            yaw = self.pose[0, 2] + pose[:, 2].mean() - yaw_rate * t.mean() + half_turn
            arcs = rotate_body_to_world(chord, yaw[:, None])  # (n, which of v, which of xy)
            design = np.swapaxes(arcs - arcs.mean(axis=0), 1, 2).reshape(-1, 2)
            v = np.linalg.lstsq(design, (pose[:, :2] - pose[:, :2].mean(axis=0)).ravel())[0]
        x, y, yaw_0 = map(float, self.pose[0])
        return State(x, y, yaw_0, float(v[0]), float(v[1]), yaw_rate, float(wheels[0]), float(wheels[1]))


def fresh_poses(t: FloatArray, pose: FloatArray) -> NDArray[np.bool_]:
    """Return (M,) bool, True for rows of (M, 3) poses that are new.

    A pose equal to the one before, bit for bit, was only logged again. If that goes on for more than `_STILL_AFTER`, the
    robot stands, and the samples after that time are new. The first sample is always new.
    """
    changed = np.concatenate([[True], np.any(pose[1:] != pose[:-1], axis=1)])
    since = t[np.maximum.accumulate(np.where(changed, np.arange(len(t)), 0))]
    return changed | (t - since > _STILL_AFTER + TIME_ROUNDOFF)


def refreshed(t: FloatArray, values: FloatArray) -> NDArray[np.bool_]:
    """Return (M,) bool, True for rows of (M, k) values that were measured anew and not only logged again.

    A row equal to the one before counts as new if nothing new came for longer than a usual refresh takes, or for longer than
    `_STILL_AFTER`: then the value stayed the same.
    """
    changed = np.concatenate([[True], np.any(values[1:] != values[:-1], axis=1)])
    times = t[changed]
    usual = min(float(np.median(np.diff(times))), _STILL_AFTER) if len(times) > 1 else 0.0
    last = t[np.maximum.accumulate(np.where(changed, np.arange(len(t)), 0))]
    return changed | (t - last >= usual - TIME_ROUNDOFF)


def is_channel_name(name: str) -> bool:
    """Return whether a file's header can hold this name and give it back."""
    return bool(name) and name.isprintable() and name == name.strip()
