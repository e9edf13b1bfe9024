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
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from ssmr.types import CommandKind, FloatArray, frozen_array
from validation.files.limits import USUAL, LogLimits, find_time_fault
from validation.files.reading import FileError
from validation.files.signals import TIME_ROUNDOFF, BoolArray, fresh_poses, held, refreshed


class Column(NamedTuple):
    """Properties of a column that is known by its name."""

    unit: str
    group: str
    """Group of the columns that are sampled together with it."""
    most: float
    """Size from which its numbers are damaged, or in another unit."""
    usual: float = math.inf
    """Greatest size that it has on a ground robot."""
    others: str = ""
    """Units that it may be in where it is larger."""

    def fault(self, values: FloatArray) -> tuple[int, str] | None:
        """Return the index of the first impossible one of (M,) values, and its fault, if any."""
        beyond = np.flatnonzero(~(np.abs(values) <= self.most))
        if not len(beyond):
            return None
        k = int(beyond[0])
        number = f"{values[k]:g} {self.unit}".strip()
        if math.isfinite(values[k]):
            return k, f"{number}, more than {self.most:g}"
        return k, f"{number}, wanted a finite number [{self.unit}]"


_RPM = "rpm, ticks or degrees per second"
_DEGREES = "degrees per second"
_CURRENT = Column("A", "channels", 1e100, 1000.0, "mA")
_VOLTAGE = Column("V", "channels", 1e100, 200.0, "mV")
COLUMNS: Mapping[str, Column] = MappingProxyType(
    {
        **dict.fromkeys(("x", "y"), Column("m", "pose", 1e8)),
        "yaw": Column("rad", "pose", 1e7),
        **dict.fromkeys(("enc_left", "enc_right"), Column("rad/s", "wheels", 1e4, 100.0, _RPM)),
        "odom_v": Column("m/s", "odom", 100.0, 10.0, "mm/s or km/h"),
        "odom_w": Column("rad/s", "odom", 1000.0, 15.0, _DEGREES),
        **dict.fromkeys(("odom_x", "odom_y"), Column("m", "odom", 1e8)),
        "odom_yaw": Column("rad", "odom", 1e7),
        "gyro_z": Column("rad/s", "imu", 1000.0, 15.0, _DEGREES),
        **dict.fromkeys(("gps_east", "gps_north"), Column("m", "gps", 1e8)),
        "cmd_v": Column("m/s", "cmd", 100.0, 10.0, "mm/s or km/h"),
        "cmd_w": Column("rad/s", "cmd", 1000.0, 15.0, _DEGREES),
        **dict.fromkeys(("acc_x", "acc_y", "acc_z"), Column("m/s²", "channels", 1e5, 160.0, "mg")),
        **dict.fromkeys(("current_left", "current_right"), _CURRENT),
        **dict.fromkeys(("voltage_left", "voltage_right"), _VOLTAGE),
    }
)
"""Columns whose meaning is known. Their first group that a log has sets its rate, unless a rate is
asked for."""
_ANY_COLUMN = Column("", "channels", 1e100)
"""Any other column."""
_GROUPS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        group: tuple(name for name, column in COLUMNS.items() if column.group == group)
        for group in dict.fromkeys(column.group for column in COLUMNS.values())
    }
)
"""Names of the groups, and the known columns of each."""
RECORDED = ("cmd_v", "cmd_w", "enc_left", "enc_right", "gyro_z", "x", "y", "yaw")
"""Columns of a robot's motion: a log on one clock has at least one of them."""
_NOTHING = f"there is none of the columns {', '.join(RECORDED)}"
POSE_COLUMNS = ("x", "y", "yaw")
COMMAND_COLUMNS: Mapping[CommandKind, tuple[str, str]] = MappingProxyType(
    {"twist": ("cmd_v", "cmd_w"), "wheels": ("enc_left", "enc_right")}
)
"""The two columns that drive a plant, by kind of command."""

UNITS: Mapping[str, tuple[str, float]] = MappingProxyType(
    {
        "ms": ("s", 1e-3),
        "us": ("s", 1e-6),
        "ns": ("s", 1e-9),
        "min": ("s", 60.0),
        "deg": ("rad", math.pi / 180.0),
        "turns": ("rad", 2.0 * math.pi),
        "deg/s": ("rad/s", math.pi / 180.0),
        "rpm": ("rad/s", math.pi / 30.0),
        "rad/min": ("rad/s", 1.0 / 60.0),
        "mm": ("m", 1e-3),
        "cm": ("m", 1e-2),
        "km": ("m", 1e3),
        "ft": ("m", 0.3048),
        "in": ("m", 0.0254),
        "km/h": ("m/s", 1.0 / 3.6),
        "mm/s": ("m/s", 1e-3),
        "cm/s": ("m/s", 1e-2),
        "m/min": ("m/s", 1.0 / 60.0),
        "ft/s": ("m/s", 0.3048),
        "mph": ("m/s", 0.44704),
    }
)
"""Units that loggers write: the unit in `COLUMNS` of the same quantity, and the factor to it."""

POSITIONS: Mapping[str, float] = MappingProxyType(
    {"rad": 1.0, "deg": math.pi / 180.0, "turns": 2.0 * math.pi}
)
"""Units of the positions of wheels, and the angle of each [rad]; ticks are another."""

_GAP_FACTOR = 2.5
"""A step longer than this many periods is a gap: one dropped sample is tolerated, two are not."""


_BURSTS = 5.0
"""Ratio of the pauses between bursts of samples and the steps inside them, at least [1]."""
_FEW_STEPS = 100
"""Number of steps from which pauses are told from gaps."""


def column_of(name: str) -> Column:
    """Return the properties of a column."""
    return COLUMNS.get(name, _ANY_COLUMN)


def is_column_name(name: str) -> bool:
    """Return whether a file's header can hold this name and give it back."""
    return bool(name) and name.isprintable() and name == name.strip()


def _usual_step(t: FloatArray) -> float:
    """Return the median step of (M,) stamps [s]; of bursts with equal pauses, the pause."""
    steps = np.diff(t)
    usual = float(np.median(steps))
    pause, longest = np.percentile(steps, (97.0, 99.5))
    bursts = len(steps) > _FEW_STEPS and pause > _BURSTS * usual and longest < 2.0 * pause
    return float(pause if bursts else usual)


@dataclass(frozen=True, eq=False)
class Group:
    """Columns that were sampled together, M samples."""

    source: str
    """Topic or file that the samples come from."""
    t: FloatArray
    """(M,) strictly increasing [s]; M is at least 2."""
    columns: Mapping[str, FloatArray]
    """Columns by name, each (M,), finite; angles are unwrapped."""
    period: float = math.nan
    """Median step of time [s], or the step between bursts of samples; that of `t` unless it is
    given. A cut keeps it, so that it moves no gap."""

    def __post_init__(self) -> None:
        """Take the period from the stamps where it is not given."""
        if math.isnan(self.period):
            object.__setattr__(self, "period", _usual_step(self.t))

    def table(self, names: Sequence[str]) -> FloatArray | None:
        """Return (M, len(names)) columns side by side; None where one is missing."""
        if not all(n in self.columns for n in names):
            return None
        return np.column_stack([self.columns[n] for n in names])

    def where(self, keep: BoolArray) -> Group:
        """Return the samples for which the (M,) `keep` is true."""
        columns = {name: values[keep] for name, values in self.columns.items()}
        return replace(self, t=self.t[keep], columns=columns)

    def longest_step(self, period: float = 0.0) -> float:
        """Return the longest step of time [s] that is no gap, at the group's period or a longer."""
        return _GAP_FACTOR * max(self.period, period) + TIME_ROUNDOFF

    def gaps(self) -> list[tuple[float, float]]:
        """Return the beginning and the end of each gap [s]."""
        at = np.flatnonzero(np.diff(self.t) > self.longest_step())
        return [(float(self.t[k]), float(self.t[k + 1])) for k in at]

    def in_gaps(self, t: FloatArray, margin: float = 0.0, least: float = 0.0) -> BoolArray:
        """Return (N,) whether instants `t` [s] lie in gaps.

        Args:
            t: (N,) instants [s].
            margin: time after the beginning and before the end of a gap that does not count as in
                it [s].
            least: shorter gaps, or equal ones, do not count [s].
        """
        at = np.flatnonzero(np.diff(self.t) > max(self.longest_step(), least))
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


@dataclass(frozen=True)
class ReadOptions:
    """Choices for reading a log; a format without topics refuses their names."""

    topics: Mapping[str, str] = field(default_factory=dict)
    """Topic of each role (cmd, odom, wheels, imu, pose, gps), or `none`; roles that are not named
    are guessed."""
    limits: LogLimits = USUAL
    """Greatest sizes that a log may have."""
    columns: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    """For columns of a CSV file that have other names or units, the name there and the unit, empty
    where it is ours."""
    radius: float | None = None
    """Radius of the wheels [m], which some units and faults need; None where nobody knows it."""

    ticks_per_turn: float | None = None
    """Ticks of an encoder in a turn of its wheel, for columns in ticks; None where nobody says."""

    def angle(self, unit: str) -> float:
        """Return the angle of a unit of wheels' positions [rad]; a ValueError asks for ticks."""
        if unit in POSITIONS:
            return POSITIONS[unit]
        if not self.ticks_per_turn:
            raise ValueError("ticks need their number in a turn of the wheel: --ticks-per-turn N")
        return 2.0 * math.pi / self.ticks_per_turn

    def factor(self, name: str, unit: str) -> float:
        """Return the factor from a unit to that of a column; a ValueError lists the units."""
        column_unit = "s" if name == "t" else column_of(name).unit
        base, factor = UNITS.get(unit, (unit, 1.0))
        if base == column_unit or not unit:
            return factor
        if name in COMMAND_COLUMNS["wheels"] and base == "m/s":
            if self.radius is None:
                raise ValueError(
                    f"{name} in {unit} needs the radius of the wheels; name the robot by --robot"
                )
            return factor / self.radius
        units = [column_unit, *(u for u, (of, _) in UNITS.items() if of == column_unit)]
        raise ValueError(f"{name} cannot be in '{unit}'; its units are {', '.join(units)}")


PLAIN = ReadOptions()
"""Everything as usual."""


@dataclass(frozen=True, eq=False)
class Topic:
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


def unwrapped(angles: FloatArray) -> FloatArray:
    """Return (M,) angles without jumps by a turn, of 2 pi, or of 360 if they are in degrees."""
    # degrees are a fault that is named later
    steps = np.abs(np.diff(angles))
    if np.any((steps > 300.0) & (steps < 361.0)):
        return np.unwrap(angles, period=360.0)
    far = steps[steps > math.pi]
    if np.ptp(angles) > 4.0 * math.pi and np.any((far < 5.0) | (far > 7.0)):
        return angles
    return np.unwrap(angles)


class DataFrame(Protocol):
    """A frame of pandas, as far as a log needs it; pandas itself takes long to import."""

    attrs: Any
    columns: Any
    iloc: Any
    index: Any
    reset_index: Any

    def __len__(self) -> int:
        """Return the number of rows."""
        ...


@dataclass(frozen=True, eq=False)
class Log:
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
    recorded: Mapping[str, Group] = field(default_factory=dict)
    """Groups with the stamps of their own, if `groups` were brought onto one clock; else empty."""

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
            raise FileError(path, _NOTHING)
        members: dict[str, dict[str, FloatArray]] = {name: {} for name in _GROUPS}
        try:
            t = frozen_array(columns["t"], "t", (None,))
            for name, given in columns.items():
                column = column_of(name)
                values = np.asarray(given, dtype=np.float64)
                if column.unit == "rad":
                    values = unwrapped(values)
                if name != "t":
                    members[column.group][name] = frozen_array(values, name, (len(t),))
        except ValueError as cause:
            raise FileError(path, str(cause)) from cause
        back = np.flatnonzero(t[1:] <= t[:-1])
        if len(back):
            raise FileError(path, f"t must increase; it does not after sample {back[0]}")
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
        recorded = {other: g for other, g in self.recorded.items() if other != name}
        return replace(self, groups={**self.groups, name: changed}, recorded=recorded)

    def without(self, names: Iterable[str]) -> Log:
        """Return the log without these columns, and without groups that have no others."""
        groups = {}
        for name, group in self.groups.items():
            left = {n: values for n, values in group.columns.items() if n not in names}
            if left:
                groups[name] = replace(group, columns=left)
        return replace(self, groups=groups, recorded={})

    def own_group(self, column: str) -> Group:
        """Return the group of a column that the log has, with stamps of its own."""
        name = column_of(column).group
        return self.recorded.get(name) or self.groups[name]

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
        missing = [n for n in names if n not in columns]
        if missing:
            raise ValueError(
                f"log {self.name} has no column {', '.join(missing)}; it has {', '.join(columns)}"
            )
        table = np.stack([columns[n] for n in names], axis=1)
        return frozen_array(table, self.name, (len(self.t), len(names)))

    def stretches(self) -> list[slice]:
        """Return the samples between gaps of a log on one clock, at least two in a stretch.

        Raises:
            ValueError: there is no stretch.
        """
        t = self.t
        longest = next(iter(self.groups.values())).longest_step()
        after_gaps = np.flatnonzero(np.diff(t) > longest) + 1
        edges = [0, *after_gaps.tolist(), len(t)]
        pieces = [slice(a, b) for a, b in pairwise(edges) if b - a >= 2]
        if not pieces:
            raise ValueError(
                f"log {self.name} is nothing but gaps between {t[0]:g} and {t[-1]:g} s"
            )
        return pieces

    def on_one_clock(self, rate: float | None = None) -> Log:
        """Return the log with all groups on one clock.

        Args:
            rate: samples a second [Hz]. None: the stamps that the groups share, or the rate of the
                first group of `_GROUPS`.

        Raises:
            FileError: the groups do not overlap, leave nothing between their gaps, hold no column
                of `RECORDED`, or make more samples than the limits allow.
        """
        if not any(name in RECORDED for name in self.columns):
            raise FileError(self.path, _NOTHING)
        if rate is None and self.is_on_one_clock:
            return self
        t = self._clock(rate)
        period = float(np.median(np.diff(t)))
        keep = np.ones(len(t), dtype=bool)
        moved: dict[str, dict[str, FloatArray]] = {}
        for name, group in self.groups.items():
            moved[name] = {}
            if name != "cmd":
                # gaps at the common period as well
                keep &= ~group.in_gaps(t, TIME_ROUNDOFF, group.longest_step(period))
            new = slice(None) if np.array_equal(t, group.t) else _measured(name, group)
            for n, values in group.columns.items():
                if name == "cmd":
                    moved[name][n] = held(t, group.t, values)
                else:
                    moved[name][n] = np.interp(t, group.t[new], values[new])
        t = t[keep]
        if len(t) < 2:
            raise FileError(
                self.path, f"nothing is left between the gaps: {_spans(self.groups.values())}"
            )
        period = float(np.median(np.diff(t)))
        groups = {}
        for name, columns in moved.items():
            kept = {n: values[keep] for n, values in columns.items()}
            groups[name] = Group(self.groups[name].source, t, kept, period)
        return replace(self, groups=groups, recorded=self.groups)

    def _clock(self, rate: float | None) -> FloatArray:
        """Return the (N,) instants of a common clock: shared stamps, or a grid over their time.

        The grid covers the time of all measured groups.
        """
        measured = [g for name, g in self.groups.items() if name != "cmd"]
        measured = measured or list(self.groups.values())
        first = self.groups[min(self.groups, key=[*_GROUPS, *self.groups].index)]
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
            keep = (group.t >= low) & (group.t <= high)
            if np.count_nonzero(keep) > 1:
                groups[name] = group.where(keep)
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
    gap = np.diff(group.t) > group.longest_step()
    return new | np.append(gap, True) | np.append(True, gap)
