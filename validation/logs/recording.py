"""Recordings of a robot: what was commanded, what the wheels did and where the robot went, read from and written to CSV.

A recording file has a header line, a column `t` [s] that increases and any of the columns of `COLUMNS`; all other numeric
columns are kept as channels. A long step of time is a gap, and nothing here bridges one: `Recording.segments` hands out
the stretches between gaps. The pose is that of the point which the localiser tracked.
"""

from __future__ import annotations

import codecs
import csv
import io
import logging
import math
import os
import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssmr.geometry import rotate_body_to_world
from ssmr.types import CommandKind, Commands, FloatArray, State, frozen_array

logger = logging.getLogger(__name__)

COLUMNS: Mapping[str, str] = MappingProxyType(
    {"cmd_v": "m/s"}
    | dict.fromkeys(("cmd_w", "enc_left", "enc_right", "gyro_z"), "rad/s")
    | {"x": "m", "y": "m", "yaw": "rad"}
)
"""The columns whose meaning is known, each with its unit."""
INPUTS: Mapping[CommandKind, tuple[str, str]] = MappingProxyType(
    {"twist": ("cmd_v", "cmd_w"), "wheels": ("enc_left", "enc_right")}
)
"""The two columns that drive a plant, by kind of command."""
POSE = ("x", "y", "yaw")

TIME_ROUNDOFF = 1e-6
"""Instants closer than this are the same one: well over rounding, well under any sample step [s]."""
STILL_AFTER = 1.0
"""A pose that repeats for longer is a robot standing still, not a localiser slower than the log [s]."""


DAMAGE = (
    OSError,
    EOFError,
    struct.error,
    zlib.error,
    SyntaxError,  # what Python's XML parser raises
    LookupError,
    ValueError,
    TypeError,
    AttributeError,
    ArithmeticError,
    AssertionError,
    NotImplementedError,
    RuntimeError,
    MemoryError,
)
"""What readers of foreign formats raise on damaged files, besides their own errors; they promise nothing narrower."""


class TableError(ValueError):
    """A file is not the table it should be: what was wrong, where, and what would be right, in one line."""

    wanted: ClassVar[str]
    """What the file should have been, with its ending."""
    header: ClassVar[str]
    """What its first line should have said."""
    counted: ClassVar[str] = "line"
    """What an editor calls the lines of such a file."""

    def __init__(self, path: Path, what: str, line: int | None = None, column: str | None = None) -> None:
        """Keep where it went wrong: the file, the line as an editor counts it and the column's name, where there is one."""
        super().__init__(path, what, line, column)
        self.path, self.what, self.line, self.column = path, what, line, column

    def __str__(self) -> str:
        line = "" if self.line is None else f", {self.counted} {self.line}"
        column = "" if self.column is None else f", column {self.column}"
        return f"{self.path}{line}{column}: {self.what}"


class RecordingError(TableError):
    """A file is no recording."""

    wanted = "a recording (.csv, .bag, .mcap, or a ROS 2 bag's folder)"
    header = f"a recording begins with a header line, separated by commas, that names t and any of {', '.join(COLUMNS)}"


@dataclass(frozen=True, eq=False)
class Recording:
    """What was recorded of one robot, M samples of it; checked, copied and read-only."""

    name: str
    """What tables and pictures call it; a file's name without its ending."""
    t: FloatArray
    """(M,) strictly increasing [s], M at least 2."""
    columns: Mapping[str, FloatArray]
    """Columns of `COLUMNS` that were recorded, at least one, each (M,) as recorded: yaw may be wrapped."""
    channels: Mapping[str, FloatArray] = field(default_factory=dict)
    """What else was recorded, by name, each (M,)."""
    gap_factor: float = 2.5
    """A step longer than this many periods is a gap: at 2.5 one dropped sample is tolerated, two are not."""
    period: float = math.nan
    """Median sample step [s]; taken from `t` unless given. `cut` hands it on, so that cutting moves no gap."""

    def __post_init__(self) -> None:
        """Check and freeze.

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
        unknown = [n for n in self.columns if n not in COLUMNS]
        if unknown or not self.columns:
            raise ValueError(f"unknown columns: {', '.join(unknown) or 'none at all'}; wanted any of {', '.join(COLUMNS)}")
        misplaced = [n for n in self.channels if n == "t" or n in COLUMNS or not _is_name(n)]
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
        """Sort (M,) columns, `t` among them, into time, known columns and channels.

        Raises:
            ValueError: there is no `t`, or the recording would not be valid.
        """
        if "t" not in columns:
            raise ValueError(f"{name} has no column t")
        arrays = {n: np.asarray(values, dtype=np.float64) for n, values in columns.items()}
        known = {n: a for n, a in arrays.items() if n in COLUMNS}
        channels = {n: a for n, a in arrays.items() if n != "t" and n not in COLUMNS}
        return cls(name, arrays["t"], known, channels, gap_factor)

    def __len__(self) -> int:
        """How many samples there are, M."""
        return len(self.t)

    @property
    def has_commands(self) -> bool:
        """Whether body velocities were commanded: cmd_v and cmd_w."""
        return all(n in self.columns for n in INPUTS["twist"])

    @property
    def has_wheels(self) -> bool:
        """Whether wheel rates were measured: enc_left and enc_right."""
        return all(n in self.columns for n in INPUTS["wheels"])

    @property
    def has_pose(self) -> bool:
        """Whether x, y and yaw were recorded."""
        return all(n in self.columns for n in POSE)

    def table(self, names: Sequence[str]) -> FloatArray:
        """(M, len(names)) known columns side by side.

        Raises:
            ValueError: some were not recorded; the message names them.
        """
        missing = [n for n in names if n not in self.columns]
        if missing:
            raise ValueError(f"recording {self.name} has no column {', '.join(missing)}; it has {', '.join(self.columns)}")
        return frozen_array(np.stack([self.columns[n] for n in names], axis=1), self.name, (len(self), len(names)))

    @cached_property
    def pose(self) -> FloatArray:
        """(M, 3): x [m], y [m], yaw [rad, unwrapped] of the tracked point; ValueError where a column is missing."""
        pose = self.table(POSE).copy()
        pose[:, 2] = np.unwrap(pose[:, 2])
        pose.setflags(write=False)
        return pose

    def segments(self) -> tuple[Segment, ...]:
        """The stretches between gaps, in order; a sample alone between two gaps belongs to none.

        Raises:
            ValueError: every step is a gap, as a cut around one may leave it.
        """
        gaps = np.flatnonzero(np.diff(self.t) > self.gap_factor * self.period + TIME_ROUNDOFF)
        edges = [0, *(gaps + 1).tolist(), len(self)]
        segments = tuple(Segment(self, a, b) for a, b in pairwise(edges) if b - a >= 2)
        alone = len(self) - sum(map(len, segments))
        if alone:
            logger.info("%s: %d samples stand alone between gaps and are left out", self.name, alone)
        if not segments:
            raise ValueError(f"recording {self.name} is nothing but gaps between {self.t[0]:g} and {self.t[-1]:g} s")
        return segments

    def cut(self, start_s: float | None = None, stop_s: float | None = None) -> Recording:
        """The samples with `start_s` <= t <= `stop_s` [s]; None leaves that end as it is.

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
        """How many samples there are, M."""
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
        """(M, 2) what can drive a plant, as sampled: cmd_v, cmd_w for `twist`; enc_left, enc_right for `wheels`.

        Raises:
            ValueError: the kind is unknown, or its columns were not recorded.
        """
        if kind not in INPUTS:
            raise ValueError(f"unknown kind of command '{kind}'; there are: {', '.join(INPUTS)}")
        return self.recording.table(INPUTS[kind])[self.start : self.stop]

    def commands(self, kind: CommandKind, dt: float) -> Commands:
        """The inputs on a uniform grid that begins with the first sample.

        What was commanded is held until the next sample (zero-order hold): each grid time takes the last sample at or before
        it; one that comes up to `TIME_ROUNDOFF` later counts as at it. What was measured, the wheel rates, goes on between
        samples: it is interpolated linearly from one fresh sample to the next, and taken in the middle of each period;
        holding it would make the wheels late by half a sample.

        There are just as many commands as reach the last sample: ceil(duration / dt), so only the last may end after it.

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
            known = _refreshed(t, values)
            middle = (np.arange(n) + 0.5) * dt
            return Commands(dt, np.column_stack([np.interp(middle, t[known], c) for c in values[known].T]), kind)
        held = np.searchsorted(t, np.arange(n) * dt + TIME_ROUNDOFF, side="right") - 1
        return Commands(dt, values[held], kind)

    @property
    def fresh(self) -> NDArray[np.bool_]:
        """(M,) bool: where the localiser gave a new pose.

        A pose equal to the one before, bit for bit, was only logged again, unless that goes on for more than `STILL_AFTER`:
        then the robot stands still, and the samples after that time count. The first sample always does.
        """
        changed = np.concatenate([[True], np.any(self.pose[1:] != self.pose[:-1], axis=1)])
        since = self.t[np.maximum.accumulate(np.where(changed, np.arange(len(self)), 0))]
        return changed | (self.t - since > STILL_AFTER + TIME_ROUNDOFF)

    def initial_state(self, span: float = 0.5) -> State:
        """Pose and wheel rates of the first sample, and the constant twist that fits the first poses best.

        A straight line is fitted to yaw; then, along that yaw, the arc p(t) = p_0 + t sinc(w t / 2) R(yaw_0 + w t / 2) v to
        the positions. Both are linear least squares, and exact for a constant twist. Only fresh samples are used.

        Args:
            span: how much of the beginning to use [s]; three fresh samples are used even if they take longer.

        Returns:
            The state at the first sample; wheel rates are zero where none were recorded, the twist where no pose is new.

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


def _refreshed(t: FloatArray, values: FloatArray) -> NDArray[np.bool_]:
    """(M,) bool: which rows of (M, k) measured values were measured anew, and not only logged again.

    A row equal to the one before counts if nothing new came for longer than a usual refresh takes, or than `STILL_AFTER`:
    then the value held.
    """
    changed = np.concatenate([[True], np.any(values[1:] != values[:-1], axis=1)])
    times = t[changed]
    usual = min(float(np.median(np.diff(times))), STILL_AFTER) if len(times) > 1 else 0.0
    last = t[np.maximum.accumulate(np.where(changed, np.arange(len(t)), 0))]
    return changed | (t - last >= usual - TIME_ROUNDOFF)


def read_csv(path: str | Path, gap_factor: float = 2.5) -> Recording:
    """Read a recording.

    A UTF-8 byte order mark, any line ending and blank lines are fine. A channel without any number in it, or with numbers
    missing or not finite, is left out with a warning.

    Args:
        path: a CSV file.
        gap_factor: a step longer than this many periods is a gap.

    Raises:
        RecordingError: the file cannot be read or is no valid recording.
    """
    path = Path(path)
    (first, *rows), (line, *lines) = read_table(path, RecordingError)
    header = _read_header(path, first, line)
    cells = list(zip(*rows, strict=True)) or [()] * len(header)
    columns: dict[str, FloatArray] = {}
    for name, column in zip(header, cells, strict=True):
        values = read_column(path, name, column, lines, RecordingError)
        if values is not None:
            columns[name] = values
    if len(rows) < 2:
        some = "is one sample" if rows else "are no samples"
        raise RecordingError(path, f"there {some} after the header; a recording needs at least two")
    t = columns["t"]
    back = np.flatnonzero(t[1:] <= t[:-1])
    if len(back):
        k = int(back[0])
        raise RecordingError(path, f"time must increase, but {t[k + 1]:.9g} s follows {t[k]:.9g} s", lines[k + 1], "t")
    return Recording.from_columns(path.stem, columns, gap_factor)


def write_csv(recording: Recording | Mapping[str, ArrayLike], path: str | Path) -> None:
    """Write a recording, or (M,) columns by name with `t` among them, whole or not at all; `read_csv` gets equal bits back.

    Raises:
        ValueError: the columns are no valid recording.
        OSError: the file cannot be written.
    """
    path = Path(path)
    if not isinstance(recording, Recording):
        recording = Recording.from_columns(path.stem, recording)
    columns = {"t": recording.t, **recording.columns, **recording.channels}
    beside = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with beside.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(zip(*(a.tolist() for a in columns.values()), strict=True))
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)


def _is_name(name: str) -> bool:
    """Whether a header can hold this name and give it back."""
    return bool(name) and name.isprintable() and name == name.strip()


def shown(texts: Iterable[str]) -> str:
    """Foreign text for a message: quoted, shortened, on one line."""
    quoted = [repr(s if len(s) <= 30 else s[:27] + "...") for s in texts]
    return ", ".join(quoted if len(quoted) <= 12 else [*quoted[:12], "..."])


def read_bytes(path: Path, error: type[TableError]) -> bytes:
    """What the file holds; an `error` where it cannot be read."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise error(path, f"there is no such file; wanted {error.wanted}") from None
    except IsADirectoryError:
        raise error(path, f"this is a folder; wanted {error.wanted}") from None
    except OSError as cause:
        raise error(path, f"the file cannot be read: {cause.strerror or cause}") from cause


def _read_text(path: Path, error: type[TableError]) -> str:
    """The file's text without its byte order mark; an `error` where there is none."""
    data = read_bytes(path, error).removeprefix(codecs.BOM_UTF8)
    try:
        text = data.decode("utf-8")
        bad, what = data.find(b"\0"), "a NUL byte"
    except UnicodeDecodeError as cause:
        text, bad, what = "", cause.start, "a byte that is not UTF-8"
    if bad >= 0:
        line = data.count(b"\n", 0, bad) + 1
        raise error(path, f"there is {what}; wanted a CSV file, which is plain UTF-8 text", line)
    return text


def read_table(path: Path, error: type[TableError]) -> tuple[list[list[str]], list[int]]:
    """Rows of cells, the header first, all of one length, and the line on which each begins; blank lines are left out.

    A UTF-8 byte order mark and any line ending are fine; whatever is no CSV file is an `error`.
    """
    rows: list[list[str]] = []
    lines: list[int] = []
    reader = csv.reader(io.StringIO(_read_text(path, error), newline=""), strict=True)
    line = 1
    try:
        for row in reader:
            if len(row) > 1 or any(map(str.strip, row)):
                if rows and len(row) != len(rows[0]):
                    raise error(path, f"there are {len(row)} fields, wanted {len(rows[0])} as in the header", line)
                rows.append(row)
                lines.append(line)
            line = reader.line_num + 1
    except csv.Error as cause:
        raise error(path, f"this is no CSV: {cause}", line) from cause
    if not rows:
        raise error(path, f"the file is empty; {error.header}")
    return rows, lines


def _read_header(path: Path, cells: Sequence[str], line: int) -> list[str]:
    """Names of the columns: `t`, at least one that is known, none twice."""
    names = [cell.strip() for cell in cells]
    for wanted, some in (("column t", ("t",)), ("known column", COLUMNS)):
        if not any(n in some for n in names):
            raise RecordingError(path, f"there is no {wanted} among {shown(names)}; {RecordingError.header}", line)
    for k, name in enumerate(names):
        if not _is_name(name):
            raise RecordingError(path, f"{shown([name])} names no column; wanted printable text", line, f"number {k + 1}")
        if name in names[:k]:
            raise RecordingError(path, "the header names this column twice; each needs a name of its own", line, name)
    return names


def _number(cell: str) -> float | None:
    """The number a cell holds, None where it holds none."""
    try:
        return None if "_" in cell else float(cell)  # Python reads 1_0 as 10, which no logger writes
    except ValueError:
        return None


def read_column(
    path: Path, name: str, cells: Sequence[str], lines: Sequence[int], error: type[TableError]
) -> FloatArray | None:
    """Numbers of a column, (M,); None, with a warning, for a channel that is text throughout or has holes.

    In `t` and the columns of `COLUMNS` whatever is no finite number is an `error`.
    """
    values = [_number(cell) for cell in cells]
    bad = [k for k, v in enumerate(values) if v is None or not math.isfinite(v)]
    if not bad:
        return np.array(values, dtype=np.float64)
    known = name == "t" or name in COLUMNS
    text = [k for k in bad if values[k] is None and cells[k].strip()]
    if known or (text and len(bad) < len(cells)):
        k = bad[0] if known else text[0]
        what = "nothing" if not cells[k].strip() else shown([cells[k].strip()])
        unit = f" [{COLUMNS.get(name, 's')}]" if known else ""
        raise error(path, f"there is {what}, wanted a finite number{unit}", lines[k], name)
    why = "text" if text else "no finite number"
    logger.warning("%s, line %d, column %s: there is %s; the channel is left out", path, lines[bad[0]], name, why)
    return None
