"""A log: what a robot's sensors said, as columns of numbers with units, in groups that have stamps of their own.

Every reader returns a `Log`. `Log.on_one_clock` brings its groups onto one clock. There
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
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssmr.types import CommandKind, FloatArray, frozen_array
from validation.files.limits import USUAL, LogLimits, find_time_fault
from validation.files.reading import FileError
from validation.files.signals import TIME_ROUNDOFF, fresh_poses, held, refreshed


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
        """Return the index of the first of (M,) values that cannot be, and what is wrong with it; None if all can be."""
        beyond = np.flatnonzero(~(np.abs(values) <= self.most))
        if not len(beyond):
            return None
        k = int(beyond[0])
        wanted = (
            f"more than {self.most:g}"
            if math.isfinite(values[k])
            else f"wanted a finite number [{self.unit}]"
        )
        return k, f"{f'{values[k]:g} {self.unit}'.strip()}, {wanted}"


_RPM = "rpm, ticks or degrees per second"
_DEGREES = "degrees per second"
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
        **dict.fromkeys(
            ("current_left", "current_right"), Column("A", "channels", 1e100, 1000.0, "mA")
        ),
        **dict.fromkeys(
            ("voltage_left", "voltage_right"), Column("V", "channels", 1e100, 200.0, "mV")
        ),
    }
)
"""Columns whose meaning is known. Their first group that a log has sets its rate, unless a rate is
asked for."""
ANY_COLUMN = Column("", "channels", 1e100)
"""Any other column."""
GROUPS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        g: tuple(n for n, c in COLUMNS.items() if c.group == g)
        for g in dict.fromkeys(c.group for c in COLUMNS.values())
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
        **{"ms": ("s", 1e-3), "us": ("s", 1e-6), "ns": ("s", 1e-9), "min": ("s", 60.0)},
        **{"deg": ("rad", math.pi / 180.0), "turns": ("rad", 2.0 * math.pi)},
        **{
            "deg/s": ("rad/s", math.pi / 180.0),
            "rpm": ("rad/s", math.pi / 30.0),
            "rad/min": ("rad/s", 1.0 / 60.0),
        },
        **{
            "mm": ("m", 1e-3),
            "cm": ("m", 1e-2),
            "km": ("m", 1e3),
            "ft": ("m", 0.3048),
            "in": ("m", 0.0254),
        },
        **{
            "km/h": ("m/s", 1.0 / 3.6),
            "mm/s": ("m/s", 1e-3),
            "cm/s": ("m/s", 1e-2),
            "m/min": ("m/s", 1.0 / 60.0),
        },
        **{"ft/s": ("m/s", 0.3048), "mph": ("m/s", 0.44704)},
    }
)
"""Units that loggers write: the one that is meant by `COLUMNS`, and the factor to it."""

# A step longer than this many periods is a gap: one dropped sample is tolerated, two are not
_GAP_FACTOR = 2.5


def column_of(name: str) -> Column:
    """Return what is known of a column."""
    return COLUMNS.get(name, ANY_COLUMN)


def is_column_name(name: str) -> bool:
    """Return whether a file's header can hold this name and give it back."""
    return bool(name) and name.isprintable() and name == name.strip()


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
    """Median step of time [s], that of `t` unless it is given; a cut keeps it, so that it moves no
    gap."""

    def __post_init__(self) -> None:
        """Take the period from the stamps where it is not given."""
        if math.isnan(self.period):
            object.__setattr__(self, "period", float(np.median(np.diff(self.t))))

    def table(self, names: Sequence[str]) -> FloatArray | None:
        """Return (M, len(names)) columns side by side; None where one is missing."""
        return (
            np.column_stack([self.columns[n] for n in names])
            if all(n in self.columns for n in names)
            else None
        )

    def where(self, keep: NDArray[np.bool_]) -> Group:
        """Return the samples for which the (M,) `keep` is true."""
        return replace(
            self, t=self.t[keep], columns={name: a[keep] for name, a in self.columns.items()}
        )

    def longest_step(self, period: float = 0.0) -> float:
        """Return the longest step of time [s] that is no gap, at the group's own period or at a longer `period` [s]."""
        return _GAP_FACTOR * max(self.period, period) + TIME_ROUNDOFF

    def gaps(self) -> list[tuple[float, float]]:
        """Return the beginning and the end of each gap [s]."""
        at = np.flatnonzero(np.diff(self.t) > self.longest_step())
        return [(float(self.t[k]), float(self.t[k + 1])) for k in at]

    def in_gaps(self, t: FloatArray, margin: float = 0.0, least: float = 0.0) -> NDArray[np.bool_]:
        """Return (N,) whether instants `t` [s] lie in gaps.

        Args: t: (N,) instants [s]. margin: time after the beginning and before the end of a gap
            that does not count as in it [s]. least: shorter gaps, or equal ones, do not count [s].
        """
        at = np.flatnonzero(np.diff(self.t) > max(self.longest_step(), least))
        if not len(at):
            return np.zeros(len(t), dtype=bool)
        start = self.t[at] + margin
        stop = self.t[at + 1] - margin
        last = np.searchsorted(start, t, side="left") - 1
        return (last >= 0) & (t < stop[last])


@dataclass(frozen=True)
class ReadOptions:
    """Choices for formats with topics, and limits for all; a format without topics refuses their names."""

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

    def factor(self, name: str, unit: str) -> float:
        """Return the factor from a unit to that of a column; a ValueError says which units there are."""
        wanted = "s" if name == "t" else column_of(name).unit
        base, factor = UNITS.get(unit, (unit, 1.0))
        if base == wanted or not unit:
            return factor
        if name in COMMAND_COLUMNS["wheels"] and base == "m/s":
            if self.radius is None:
                raise ValueError(
                    f"{name} in {unit} needs the radius of the wheels; name the robot by --robot"
                )
            return factor / self.radius
        known = ", ".join((wanted, *(u for u, (of, _) in UNITS.items() if of == wanted)))
        raise ValueError(f"{name} cannot be in '{unit}'; its units are {known}")


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


def unwrapped(angles: FloatArray) -> FloatArray:
    """Return (M,) angles without jumps by a turn: of 2 pi, or of 360 where they are in degrees, which is a fault to name."""
    steps = np.abs(np.diff(angles))
    return np.unwrap(
        angles, period=360.0 if np.any((steps > 300.0) & (steps < 361.0)) else 2.0 * math.pi
    )


@dataclass(frozen=True, eq=False)
class Log:
    """A log of one robot."""

    path: Path
    """File that it was read from."""
    groups: Mapping[str, Group]
    """Groups of columns by name."""
    topics: Sequence[Topic] = ()
    """Topics of the file, where its format has any."""
    remarks: Sequence[str] = ()
    """Sentences about the file's clocks."""
    limits: LogLimits = USUAL
    """Limits that it was read with; they hold for its common clock as well."""
    recorded: Mapping[str, Group] = field(default_factory=dict)
    """Groups with the stamps of their own, if `groups` were brought onto one clock; else empty."""

    @classmethod
    def of_columns(
        cls, path: str | Path, columns: Mapping[str, ArrayLike], limits: LogLimits = USUAL
    ) -> Log:
        """Return a log of (M,) columns by name on one clock, `t` [s] among them; they are copied and read-only.

        Raises: FileError: there is no `t`, it does not increase, there are fewer than two samples,
            lengths differ, numbers are
                not finite, a name cannot stand in a file, or no column is one of `RECORDED`.
        """
        path = Path(path)
        arrays = {n: np.asarray(a, dtype=np.float64) for n, a in columns.items()}
        if "t" not in arrays or len(arrays["t"]) < 2:
            raise FileError(path, "a log needs a column t, and at least two samples")
        if unknown := [name for name in arrays if not is_column_name(name)]:
            raise FileError(path, f"{unknown[0]!r} is no name of a column")
        if not any(name in RECORDED for name in arrays):
            raise FileError(path, _NOTHING)
        groups: dict[str, dict[str, FloatArray]] = {name: {} for name in GROUPS}
        try:
            t = frozen_array(arrays.pop("t"), "t", (None,))
            for name, a in arrays.items():
                known = column_of(name)
                groups[known.group][name] = frozen_array(
                    unwrapped(a) if known.unit == "rad" else a, name, (len(t),)
                )
        except ValueError as cause:
            raise FileError(path, str(cause)) from cause
        if np.any(t[1:] <= t[:-1]):
            raise FileError(
                path, f"t must increase; it does not after sample {int(np.argmax(t[1:] <= t[:-1]))}"
            )
        return cls(
            path,
            {name: Group(path.name, t, own) for name, own in groups.items() if own},
            limits=limits,
        )

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

    def changed(self, name: str, columns: Mapping[str, FloatArray]) -> Log:
        """Return the log with columns of the group `name` replaced or added, each (M,)."""
        group = self.groups[name]
        changed = replace(group, columns={**group.columns, **columns})
        recorded = {other: g for other, g in self.recorded.items() if other != name}
        return replace(self, groups={**self.groups, name: changed}, recorded=recorded)

    def own_group(self, column: str) -> Group:
        """Return the group of a column that the log has, with stamps of its own."""
        name = column_of(column).group
        return self.recorded.get(name) or self.groups[name]

    # ----------------------------------------------------------------------------------------- on
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
        """Return (M, len(names)) columns of a log on one clock side by side; a ValueError names those that are missing."""
        there = self.columns
        if missing := [n for n in names if n not in there]:
            raise ValueError(
                f"log {self.name} has no column {', '.join(missing)}; it has {', '.join(there)}"
            )
        return frozen_array(
            np.stack([there[n] for n in names], axis=1), self.name, (len(self.t), len(names))
        )

    def stretches(self) -> list[slice]:
        """Return the samples between gaps of a log on one clock, but for lone ones; a ValueError says if there is none."""
        t = self.t
        longest = next(iter(self.groups.values())).longest_step()
        edges = [0, *(np.flatnonzero(np.diff(t) > longest) + 1).tolist(), len(t)]
        pieces = [slice(a, b) for a, b in pairwise(edges) if b - a >= 2]
        if not pieces:
            raise ValueError(
                f"log {self.name} is nothing but gaps between {t[0]:g} and {t[-1]:g} s"
            )
        return pieces

    def on_one_clock(self, rate: float | None = None) -> Log:
        """Return the log with all groups on one clock.

        Args: rate: samples a second [Hz]. None: the stamps that the groups share, or the rate of
            the first group of `GROUPS`.

        Raises: FileError: the groups do not overlap, leave nothing between their gaps, hold no
            column of `RECORDED`, or make
                more samples than the limits allow.
        """
        if not any(name in RECORDED for name in self.columns):
            raise FileError(self.path, _NOTHING)
        if rate is None and self.is_on_one_clock:
            return self
        t = self._clock(rate)
        period = float(np.median(np.diff(t)))
        keep = np.ones(len(t), dtype=bool)
        columns: dict[str, dict[str, FloatArray]] = {}
        for name, group in self.groups.items():
            if name == "cmd":
                columns[name] = {n: held(t, group.t, values) for n, values in group.columns.items()}
                continue
            # gaps at the common period as well
            keep &= ~group.in_gaps(t, TIME_ROUNDOFF, group.longest_step(period))
            new = slice(None) if np.array_equal(t, group.t) else _measured(name, group)
            columns[name] = {
                n: np.interp(t, group.t[new], values[new]) for n, values in group.columns.items()
            }
        if np.count_nonzero(keep) < 2:
            raise FileError(
                self.path, f"nothing is left between the gaps: {_spans(self.groups.values())}"
            )
        t, period = t[keep], float(np.median(np.diff(t[keep])))
        groups = {
            name: Group(
                self.groups[name].source, t, {n: a[keep] for n, a in arrays.items()}, period
            )
            for name, arrays in columns.items()
        }
        return replace(self, groups=groups, recorded=self.groups)

    def _clock(self, rate: float | None) -> FloatArray:
        """Return the (N,) instants of a common clock: shared stamps, or a grid over the time of all measured groups."""
        measured = [g for name, g in self.groups.items() if name != "cmd"] or list(
            self.groups.values()
        )
        first = self.groups[min(self.groups, key=[*GROUPS, *self.groups].index)]
        if rate is None and all(np.array_equal(g.t, first.t) for g in measured):
            return first.t
        dt = float(np.median(np.diff(first.t))) if rate is None else 1.0 / rate
        start = max(float(g.t[0]) for g in measured)
        stop = min(float(g.t[-1]) for g in measured)
        if stop - start < dt:
            what = f"the topics do not overlap: {_spans(measured)}; leave one out with topics ROLE=none"
            raise FileError(self.path, what)
        n = (stop - start) / dt + TIME_ROUNDOFF
        width = len(self.columns)
        for limit, many in (("samples", n), ("cells", n * width)):
            if many > getattr(self.limits, limit):
                many_samples = f"{stop - start:.6g} s at {1.0 / dt:.6g} Hz are too many samples of {width} columns"
                raise FileError(
                    self.path,
                    f"{many_samples}, for {self.limits.says(limit)}; ask for a lower rate",
                )
        return np.asarray(start + dt * np.arange(int(n) + 1), dtype=np.float64)

    # -----------------------------------------------------------------------------------------
    # changes
    def cut(self, start: float | None = None, stop: float | None = None) -> Log:
        """Return the samples from `start` to `stop` [s], None for an end; empty groups drop out. A FileError if all do."""
        low = -math.inf if start is None else start
        high = math.inf if stop is None else stop
        within = {name: (g.t >= low) & (g.t <= high) for name, g in self.groups.items()}
        groups = {
            name: self.groups[name].where(keep)
            for name, keep in within.items()
            if np.count_nonzero(keep) > 1
        }
        if not groups:
            what = f"nothing was logged in {low:g} to {high:g} s; there is {_spans(self.groups.values())}"
            raise FileError(self.path, what)
        return replace(self, groups=groups)


def check_group(path: Path, group: Group, limits: LogLimits) -> None:
    """Raise a FileError for times and numbers that cannot be; it names the group's source, the time and the column."""
    if late := find_time_fault(group.t, limits):
        raise FileError(path, f"{group.source}, sample {late.row + 1}: {late.what}")
    for name, values in group.columns.items():
        if fault := column_of(name).fault(values):
            k, what = fault
            raise FileError(path, f"{group.source}, {group.t[k]:.3f} s: {name} is {what}")


def _spans(groups: Iterable[Group]) -> str:
    return ", ".join(f"{g.source} {g.t[0]:.6g} to {g.t[-1]:.6g} s" for g in groups)


def _measured(name: str, group: Group) -> NDArray[np.bool_]:
    """Return (M,) where a group's samples were measured anew, or stand beside a gap.

    A localiser or encoder that is slower than its log repeats its last value. To interpolate
    between repetitions would make it late, by half of the time for which it is repeated.
    """
    if name not in ("pose", "wheels", "odom"):
        return np.ones(len(group.t), dtype=bool)
    new = (fresh_poses if name == "pose" else refreshed)(
        group.t, np.column_stack(list(group.columns.values()))
    )
    gap = np.diff(group.t) > group.longest_step()
    return new | np.append(gap, True) | np.append(True, gap)
