"""A log: the signals of a robot's sensors, in groups that have stamps of their own.

Signals are columns of numbers with units. Every reader returns a `Log`. `Log.on_one_clock` brings
its groups onto one clock. There
measurements are interpolated linearly between samples that were not only logged again, and commands
are held until the next one; they count as zero once they are older than half a second, as in a
robot's driver. A gap in a group becomes a gap of the log, which nothing bridges. Groups that share
their stamps keep them, unless another rate is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from ssmr.types import FloatArray, frozen_array, increasing_times
from validation.files.columns import (
    BESIDE_MOTION,
    GROUPS,
    NO_COLUMN,
    RECORDED,
    column_of,
    is_column_name,
    unwrapped,
)
from validation.files.limits import USUAL, LogLimits, find_time_fault
from validation.files.reading import FileError
from validation.files.signals import TIME_ROUNDOFF, BoolArray, fresh_poses, held, refreshed

_GAP_FACTOR = 2.5
"""A step longer than this many periods is a gap: one lost sample is tolerated, two are not, unless
chance loses more."""
_BESIDE = ("cmd", *BESIDE_MOTION)
"""Groups that need not be known at an instant for a log to have it."""
_BURSTS = 5.0
"""Ratio of the pauses between bursts of samples and the steps inside them, at least [1]."""
_FEW_STEPS = 100
"""Number of steps from which pauses are told from gaps."""


def _usual_step(t: FloatArray) -> float:
    """Return the median step of (M,) stamps [s]; of bursts with equal pauses, the pause."""
    steps = np.diff(t)
    usual = float(np.median(steps))
    pause, longest = np.percentile(steps, (97.0, 99.5))
    bursts = len(steps) > _FEW_STEPS and pause > _BURSTS * usual and longest < 2.0 * pause
    return float(pause if bursts else usual)


def _longest_step(t: FloatArray) -> float:
    """Return the longest step of (M,) stamps that is no gap [s].

    Where samples are lost by chance, each with the probability with which the next one is lost too,
    several in a row are so frequent that they end no piece; what chance does not explain does.
    """
    period = _usual_step(t)
    losses = max(1, int(np.count_nonzero(np.diff(t) > 1.5 * period)))
    in_a_row = int(math.log(losses) / math.log(len(t) / losses))
    return (max(1, in_a_row) + 1.5) * period


class _Value:
    """Base of dataclasses whose arrays and mappings nobody can change, also by another name."""

    def __post_init__(self) -> None:
        """Keep copies of what could be changed."""
        for name, value in vars(self).items():
            object.__setattr__(self, name, _read_only(value))

    def __reduce__(self) -> tuple[Any, ...]:
        """Let other processes receive it, which a read-only mapping would not."""
        values = vars(self).values()
        plain = (dict(value) if isinstance(value, Mapping) else value for value in values)
        return type(self), tuple(plain)


def _read_only(value: Any) -> Any:
    """Return an array, a mapping or a list that cannot be changed; anything else as it is."""
    if isinstance(value, Mapping):
        return MappingProxyType({name: _read_only(part) for name, part in value.items()})
    if isinstance(value, list):
        return tuple(value)
    if isinstance(value, np.ndarray) and value.flags.writeable:
        value = value.copy()
        value.setflags(write=False)
    return value


@dataclass(frozen=True, eq=False)
class Group(_Value):
    """Columns that were sampled together, M samples."""

    source: str
    """Topic or file that the samples come from."""
    t: FloatArray
    """(M,) strictly increasing [s]; M is at least 2."""
    columns: Mapping[str, FloatArray]
    """Columns by name, each (M,), finite; angles are unwrapped."""
    longest: float = math.nan
    """Longest step that is no gap [s]; that of `t` unless it is given. A cut keeps it, so that it
    moves no gap."""

    def __post_init__(self) -> None:
        """Take the longest step from the stamps where it is not given."""
        super().__post_init__()
        if math.isnan(self.longest):
            object.__setattr__(self, "longest", _longest_step(self.t))

    @property
    def period(self) -> float:
        """Median step of time [s], or the step between bursts of samples."""
        return _usual_step(self.t)

    def table(self, names: Sequence[str]) -> FloatArray | None:
        """Return (M, len(names)) columns side by side; None where one is missing."""
        if not all(n in self.columns for n in names):
            return None
        return np.column_stack([self.columns[n] for n in names])

    def where(self, keep: BoolArray | slice) -> Group:
        """Return the samples for which the (M,) `keep` is true, or a view of some in a row."""
        columns = {name: values[keep] for name, values in self.columns.items()}
        return replace(self, t=self.t[keep], columns=columns)

    def breaks(self, period: float = 0.0) -> BoolArray:
        """Return (M - 1,) which steps of time are gaps, also at a common period [s]."""
        return np.diff(self.t) > max(self.longest, _GAP_FACTOR * period) + TIME_ROUNDOFF

    def gaps(self) -> list[list[float]]:
        """Return the beginning and the end of each gap [s]."""
        return np.column_stack([self.t[:-1], self.t[1:]])[self.breaks()].tolist()

    def in_gaps(self, t: FloatArray, margin: float = 0.0, period: float = 0.0) -> BoolArray:
        """Return (N,) whether instants `t` [s] lie in gaps.

        Args:
            t: (N,) instants [s].
            margin: time after the beginning and before the end of a gap that does not count as in
                it [s].
            period: common period, at which shorter gaps do not count [s].
        """
        at = np.flatnonzero(self.breaks(period))
        if not len(at):
            return np.zeros(len(t), dtype=bool)
        start = self.t[at] + margin
        stop = self.t[at + 1] - margin
        last = np.searchsorted(start, t, side="left") - 1
        return (last >= 0) & (t < stop[last])


@dataclass(frozen=True)
class LogFault:
    """A contradiction between the columns of a log and their names."""

    kind: str
    """Its kind, one of those that docs/logs.md lists, such as `sign` or `circular`."""
    columns: tuple[str, ...]
    """Columns that it is in, or may be in."""
    sentence: str
    """Sentence on the fault."""
    from_s: float | None = None
    """When it begins, where it does not hold for the whole log [s]."""
    to_s: float | None = None
    """When it ends, likewise [s]."""


@dataclass(frozen=True, kw_only=True)
class ReadOptions:
    """How logs are read: options of every program that reads some."""

    topics: Mapping[str, str] = field(default_factory=dict)
    """Topic of each role, such as cmd=/cmd_vel,pose=/tf:map.base_link,gps=none; guessed from types,
    names and motions if not given. Roles are cmd, odom, wheels, imu, pose, gps and battery."""
    columns: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    """Columns of a CSV file with other names or units:
    x=pos_x,yaw=heading:deg,t=stamp:ms,enc_left=wl:m/s, a mean as enc_left=fl+rl, yaw=qx+qy+qz+qw,
    and positions of wheels as enc_left=ticks_l:ticks; of a bag, the joints of each side."""
    ticks_per_turn: float | None = None
    """Ticks of an encoder in a turn of its wheel, for columns in ticks."""
    limits: LogLimits = USUAL
    """Other limits of a recording, such as span=1e7,gap=1e4. A wrong name lists all."""


PLAIN = ReadOptions()
"""Everything as usual."""


@dataclass(frozen=True, eq=False)
class Topic(_Value):
    """A topic of a file that has topics, M samples."""

    name: str
    type: str
    """Message type as ROS 2 writes it, such as nav_msgs/msg/Odometry."""
    t: FloatArray
    """(M,) stamps, not decreasing, counted from the file's epoch [s]; zeros where the topic cannot
    be read."""
    columns: Mapping[str, FloatArray] | None
    """Columns as they were sent, each (M,), NaN is possible; None where the topic cannot be
    read."""
    remark: str = ""
    """Why its stamps are the times of writing; empty where they are those of the messages."""
    role: str = ""
    """Role that it is taken for; empty for none."""
    fault: str = ""
    """Sentence on a clock that is not that of the other topics."""
    unread: str = ""
    """Sentence on what in it is not understood, and how to name it."""


@runtime_checkable
class DataFrame(Protocol):
    """A frame of pandas, as far as a log needs it; pandas itself takes long to import."""

    attrs: Any
    columns: Any
    copy: Any
    iloc: Any
    index: Any
    reset_index: Any

    def __len__(self) -> int:
        """Return the number of rows."""
        ...


@dataclass(frozen=True, eq=False)
class Log(_Value):
    """A log of one robot."""

    path: Path
    """File that it was read from."""
    groups: Mapping[str, Group]
    """Groups of columns by name; each column is in the group that `column_of` says."""
    topics: Sequence[Topic] = ()
    """Topics of the file, where its format has any."""
    remarks: Sequence[str] = ()
    """Sentences about the file's clocks, and about what was chosen or left out."""
    limits: LogLimits = USUAL
    """Limits that it was read with; they hold for its common clock as well."""
    faults: Sequence[LogFault] = ()
    """Faults that showed when it was read, and were put right."""

    @classmethod
    def of_columns(
        cls, path: str | Path, columns: Mapping[str, ArrayLike], limits: LogLimits = USUAL
    ) -> Log:
        """Return a log of (M,) columns by name on one clock, `t` [s] among them.

        The columns are copied and read-only.

        Raises:
            FileError: there is no `t`, it does not increase, there are fewer than two samples,
                lengths differ, numbers are not finite, a name cannot stand in a file, or no column
                is one of `RECORDED`.
        """
        path = Path(path)
        if "t" not in columns or len(np.asarray(columns["t"])) < 2:
            raise FileError(path, "a log needs a column t, and at least two samples")
        odd = [name for name in columns if not is_column_name(name)]
        if odd:
            raise FileError(path, f"{odd[0]!r} is no name of a column")
        if not any(name in RECORDED for name in columns):
            raise FileError(path, NO_COLUMN)
        members: dict[str, dict[str, FloatArray]] = {name: {} for name in GROUPS}
        try:
            t = increasing_times(columns["t"])
            for name, given in columns.items():
                column = column_of(name)
                values = np.asarray(given, dtype=np.float64)
                if column.unit == "rad":
                    values = unwrapped(values)
                if name != "t":
                    members[column.group][name] = frozen_array(values, name, (len(t),))
        except ValueError as cause:
            raise FileError(path, str(cause)) from cause
        groups = {name: Group(path.name, t, part) for name, part in members.items() if part}
        return cls(path, groups, limits=limits)

    @property
    def name(self) -> str:
        """Name in tables and pictures: the file's name without its ending."""
        return self.path.stem

    @property
    def columns(self) -> dict[str, FloatArray]:
        """All columns of all groups by name."""
        return {name: a for group in self.groups.values() for name, a in group.columns.items()}

    def has(self, names: Iterable[str]) -> bool:
        """Return whether it has all of these columns."""
        return set(names) <= set(self.columns)

    def group_of(self, names: Sequence[str]) -> Group | None:
        """Return the group that has all of these columns; None where there is none."""
        group = self.groups.get(column_of(names[0]).group)
        return group if group is not None and {*names} <= group.columns.keys() else None

    def changed(self, name: str, columns: Mapping[str, FloatArray]) -> Log:
        """Return the log with columns of the group `name` replaced or added, each (M,)."""
        group = self.groups[name]
        changed = replace(group, columns={**group.columns, **columns})
        return replace(self, groups={**self.groups, name: changed})

    def without(self, names: Iterable[str]) -> Log:
        """Return the log without these columns, and without groups that have no others."""
        groups = {}
        for name, group in self.groups.items():
            left = {n: values for n, values in group.columns.items() if n not in names}
            if left:
                groups[name] = replace(group, columns=left)
        return replace(self, groups=groups)

    # -----------------------------------------------------------------------------------------
    # one clock
    @property
    def t(self) -> FloatArray:
        """(M,) stamps that all groups share [s]; ValueError for a log that is not on one clock."""
        if not self.is_on_one_clock:
            raise ValueError(
                f"the groups of {self.name} have stamps of their own; bring it onto one clock"
            )
        return next(iter(self.groups.values())).t

    @property
    def is_on_one_clock(self) -> bool:
        """True if all groups share their stamps."""
        first, *others = self.groups.values()
        return all(g.t is first.t or np.array_equal(g.t, first.t) for g in others)

    def table(self, names: Sequence[str]) -> FloatArray:
        """Return (M, len(names)) columns of a log on one clock side by side.

        Raises:
            ValueError: a column is missing.
        """
        columns = self.columns
        if missing := ", ".join(n for n in names if n not in columns):
            raise ValueError(
                f"log {self.name} has no column {missing}; it has {', '.join(columns)}"
            )
        table = np.stack([columns[n] for n in names], axis=1)
        return frozen_array(table, self.name, (len(self.t), len(names)))

    def stretches(self) -> list[slice]:
        """Return the samples between gaps of a log on one clock, at least two in a stretch.

        Raises:
            ValueError: there is no stretch.
        """
        t = self.t
        after_gaps = np.flatnonzero(next(iter(self.groups.values())).breaks()) + 1
        edges = [0, *after_gaps.tolist(), len(t)]
        if not (pieces := [slice(a, b) for a, b in pairwise(edges) if b - a >= 2]):
            raise ValueError(
                f"log {self.name} is nothing but gaps between {t[0]:g} and {t[-1]:g} s"
            )
        return pieces

    def on_one_clock(self, rate: float | None = None) -> Log:
        """Return the log with all groups on one clock.

        Args:
            rate: samples a second [Hz]. None: the stamps that the groups share, or the rate of the
                first group of `GROUPS`.

        Raises:
            FileError: the groups do not overlap, leave nothing between their gaps, hold no column
                of `RECORDED`, or make more samples than the limits allow.
        """
        if not any(name in RECORDED for name in self.columns):
            raise FileError(self.path, NO_COLUMN)
        if rate is None and self.is_on_one_clock:
            return self
        t = self._clock(rate)
        period = float(np.median(np.diff(t)))
        is_shared = {name: np.array_equal(t, group.t) for name, group in self.groups.items()}
        for name in self.groups.keys() - {*_BESIDE}:
            group = self.groups[name]
            # gaps at the common period as well
            t = t[~group.in_gaps(t, TIME_ROUNDOFF, period)]
        if len(t) < 2:
            raise FileError(
                self.path, f"nothing is left between the gaps: {_spans(self.groups.values())}"
            )
        groups = {}
        for name, group in self.groups.items():
            new = slice(None) if is_shared[name] else _measured(name, group)
            columns = {}
            for n, values in group.columns.items():
                if name == "cmd":
                    columns[n] = held(t, group.t, values)
                else:
                    columns[n] = np.interp(t, group.t[new], values[new])
            groups[name] = Group(group.source, t, columns)
        return replace(self, groups=groups)

    def _clock(self, rate: float | None) -> FloatArray:
        """Return the (N,) instants of a common clock: shared stamps, or a grid over their time.

        The grid covers the time of all measured groups.
        """
        measured = [g for name, g in self.groups.items() if name not in _BESIDE]
        measured = measured or list(self.groups.values())
        first = self.groups[min(self.groups, key=[*GROUPS, *self.groups].index)]
        if rate is None and all(np.array_equal(g.t, first.t) for g in measured):
            return first.t
        dt = _usual_step(first.t) if rate is None else 1.0 / rate
        start = max(float(g.t[0]) for g in measured)
        stop = min(float(g.t[-1]) for g in measured)
        span = stop - start
        if span < dt:
            raise FileError(
                self.path,
                f"the topics do not overlap: {_spans(measured)}; "
                "leave one out with topics ROLE=none",
            )
        n = span / dt + TIME_ROUNDOFF
        if n > self.limits.samples:
            raise FileError(
                self.path,
                f"{span:.6g} s at {1.0 / dt:.6g} Hz are too many samples, for "
                f"{self.limits.says('samples')}; ask for a lower rate",
            )
        return np.asarray(start + dt * np.arange(int(n) + 1), dtype=np.float64)

    # -----------------------------------------------------------------------------------------
    # changes
    def cut(self, start: float | None = None, stop: float | None = None) -> Log:
        """Return the samples from `start` to `stop` [s], None for an end; empty groups drop out.

        Raises:
            FileError: all groups are empty.
        """
        low = -math.inf if start is None else start
        high = math.inf if stop is None else stop
        groups = {}
        for name, group in self.groups.items():
            first = np.searchsorted(group.t, low)
            end = np.searchsorted(group.t, high, side="right")
            if end - first > 1:
                groups[name] = group.where(slice(first, end))
        if not groups:
            raise FileError(
                self.path,
                f"nothing was logged in {low:g} to {high:g} s; "
                f"there is {_spans(self.groups.values())}",
            )
        return replace(self, groups=groups)


def check_group(path: Path, group: Group, limits: LogLimits) -> None:
    """Raise a FileError for impossible times and numbers.

    It names the group's source, the time and the column.
    """
    late = find_time_fault(group.t, limits)
    if late is not None:
        row, what = late
        raise FileError(path, f"{group.source}, sample {row + 1}: {what}")
    for name, values in group.columns.items():
        fault = column_of(name).fault(values)
        if fault is not None:
            k, what = fault
            raise FileError(path, f"{group.source}, {group.t[k]:.3f} s: {name} is {what}")


def _spans(groups: Iterable[Group]) -> str:
    return ", ".join(f"{g.source} {g.t[0]:.6g} to {g.t[-1]:.6g} s" for g in groups)


def _measured(name: str, group: Group) -> BoolArray:
    """Return (M,) where a group's samples were measured anew, or stand beside a gap.

    A localiser or encoder that is slower than its log repeats its last value. To interpolate
    between repetitions would make it late, by half of the time for which it is repeated.
    """
    if name not in ("pose", "wheels", "odom"):
        return np.ones(len(group.t), dtype=bool)
    table = np.column_stack(list(group.columns.values()))
    new = fresh_poses(group.t, table) if name == "pose" else refreshed(group.t, table)
    gap = group.breaks()
    return new | np.append(gap, True) | np.append(True, gap)
