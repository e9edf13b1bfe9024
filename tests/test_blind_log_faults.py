"""Faults and sound variations of logs, invented without a look at the code that judges them.

A table of faults is put into simulated and real logs, and a table of sound variations beside it;
`recordings info` says what it finds. `python -m tests.test_blind_log_faults` prints who was
named, left open, passed over or blamed wrongly; `--only KIND` takes some, `--seed N` other draws.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import runpy
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.ndimage import uniform_filter1d

from tests.blind_drives import (
    BACKWARDS,
    BASES,
    LOCALISERS,
    REAL,
    ROBOTS,
    Array,
    Log,
    base_log,
    make_log,
    vary_slowly,
)

Change = Callable[[Log, np.random.Generator], None]
"""Changes a log's table, in place."""
WHEELS = ("enc_left", "enc_right")
PLACE = ("x", "y")
POSE = ("x", "y", "yaw")
COMMANDS = ("cmd_v", "cmd_w")


@dataclass(frozen=True)
class Fault:
    """What is wrong, and what may be said of it."""

    name: str
    change: Change
    columns: tuple[str, ...]
    """Columns that may be blamed; an open disagreement must name one of them."""
    kinds: tuple[str, ...]
    """Of docs/logs.md, each a right name."""
    draws: int = 2
    backwards: bool = False
    """Only a robot that also drives backwards shows it."""
    shown: Callable[[Report], bool] = lambda report: False
    """Whether another documented field shows it."""


@dataclass(frozen=True)
class Report:
    """What `recordings info` found."""

    status: int
    said: str
    info: dict

    @property
    def faults(self) -> list[dict]:
        """Kind, columns and sentence of each."""
        return self.info.get("faults", [])

    def late(self, name: str) -> float:
        """How late a signal is.

        Returns:
            Its delay behind the gyro [s], nan where it is not known.
        """
        found = self.info.get("offsets_s", {}).get(name)
        return np.nan if found is None else float(found)

    @property
    def commands_late(self) -> float:
        """How late the robot follows its commands, by the table of offsets [s]."""
        rows = self.info.get("offsets", [])
        rows = rows if isinstance(rows, list) else []
        return max((row["late_s"] for row in rows if row.get("behind") == "cmd"), default=np.nan)


def inspect_log(log: Log, folder: Path) -> Report:
    """Run `python -m validation.recordings info` in this process.

    Returns:
        What it wrote and said.
    """
    path, found = folder / "log.csv", folder / "info.json"
    found.unlink(missing_ok=True)
    log.table.to_csv(path, index=False, float_format="%.15g")
    said = io.StringIO()
    arguments = ["recordings", "info", str(path), "--json", str(found), "--overwrite", *log.options]
    kept, sys.argv, status = sys.argv, arguments, 0
    with (
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(said),
        warnings.catch_warnings(),
    ):
        warnings.filterwarnings("ignore", "'validation", RuntimeWarning)
        try:
            runpy.run_module("validation.recordings", run_name="__main__", alter_sys=True)
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else int(end.code is not None)
        finally:
            sys.argv = kept
    info = json.loads(found.read_text()) if found.is_file() else {}
    return Report(status, said.getvalue(), info)


# ------------------------------------------------------------------------------- changes


def scale(log: Log, _: np.random.Generator, *, columns: tuple[str, ...], by: float) -> None:
    for name in columns:
        log.table[name] *= by


def add(log: Log, _: np.random.Generator, *, column: str, by: float) -> None:
    log.table[column] += by


def swap(log: Log, _: np.random.Generator, *, columns: tuple[str, str], half: bool = False) -> None:
    first, second = columns
    rows = log.half if half else np.ones(len(log.t), dtype=bool)
    log.table.loc[rows, [first, second]] = log.table.loc[rows, [second, first]].to_numpy()


def grow(log: Log, _: np.random.Generator, *, columns: tuple[str, ...], to: float) -> None:
    t = log.t
    factor = 1 + (to - 1) * (t - t[0]) / (t[-1] - t[0])
    for name in columns:
        if name in PLACE:
            steps = np.diff(fill_column(log, name), prepend=0.0)
            steps[0] = fill_column(log, name)[0]
            put_column(log, name, np.cumsum(steps * factor))
        else:
            log.table[name] *= factor


def drift(log: Log, _: np.random.Generator, *, column: str, to: float) -> None:
    t = log.t
    log.table[column] += to * (t - t[0]) / (t[-1] - t[0])


def fill_column(log: Log, name: str) -> Array:
    """A column without its empty cells.

    Returns:
        (rows,), interpolated between samples.
    """
    values = log.table[name].to_numpy(float)
    good = np.isfinite(values)
    return np.interp(log.t, log.t[good], values[good])


def put_column(log: Log, name: str, values: Array) -> None:
    log.table[name] = np.where(np.isfinite(log.table[name].to_numpy(float)), values, np.nan)


def delay(log: Log, _: np.random.Generator, *, columns: tuple[str, ...], by: float) -> None:
    for name in columns:
        put_column(log, name, np.interp(log.t - by, log.t, fill_column(log, name)))


def smooth(log: Log, _: np.random.Generator, *, columns: tuple[str, ...], over: float) -> None:
    count = max(1, round(over / float(np.median(np.diff(log.t)))))
    for name in columns:
        put_column(log, name, uniform_filter1d(fill_column(log, name), count, mode="nearest"))


def clip(log: Log, _: np.random.Generator, *, columns: tuple[str, ...], share: float) -> None:
    level = share * max(np.nanquantile(np.abs(log.table[name]), 0.98) for name in columns)
    for name in columns:
        log.table[name] = log.table[name].clip(-level, level)


def wrap(log: Log, _: np.random.Generator, *, columns: tuple[str, ...], share: float) -> None:
    level = share * max(np.nanquantile(np.abs(log.table[name]), 0.98) for name in columns)
    for name in columns:
        log.table[name] = (log.table[name] + level) % (2 * level) - level


def truncate(log: Log, _: np.random.Generator, *, columns: tuple[str, ...], share: float) -> None:
    for name in columns:
        step = share * np.nanquantile(np.abs(log.table[name]), 0.98)
        log.table[name] = np.trunc(log.table[name] / step) * step


def lose(log: Log, rng: np.random.Generator, *, columns: tuple[str, ...], share: float) -> None:
    for name in columns:
        log.table.loc[rng.random(len(log.t)) < share, name] = 0.0


def spike(log: Log, rng: np.random.Generator, *, column: str, times: float) -> None:
    size = times * np.nanquantile(np.abs(log.table[column]), 0.98)
    filled = np.flatnonzero(np.isfinite(log.table[column].to_numpy(float)))
    where = rng.choice(filled[5:-5], 12, replace=False)
    log.table.loc[where, column] += size * rng.choice([-1.0, 1.0], 12)


def hold(log: Log, _: np.random.Generator, *, columns: tuple[str, ...], period: float) -> None:
    t = log.t
    slots = np.floor((t - t[0]) / period)
    first = np.searchsorted(slots, slots)
    for name in columns:
        put_column(log, name, fill_column(log, name)[first])


def freeze(log: Log, rng: np.random.Generator, *, columns: tuple[str, ...], part: str) -> None:
    t = log.t - log.t[0]
    begin, end = {"half": (0.5, 1.0), "whole": (0.0, 1.0), "while": (0.35, 0.6)}[part]
    rows = (t >= begin * t[-1]) & (t <= end * t[-1])
    for name in columns:
        log.table.loc[rows & np.isfinite(log.table[name]), name] = fill_column(log, name)[rows][0]


def unsigned(log: Log, _: np.random.Generator, *, columns: tuple[str, ...]) -> None:
    for name in columns:
        log.table[name] = log.table[name].abs()


def jump(log: Log, rng: np.random.Generator, *, count: int, size: float) -> None:
    t = log.t
    for moment in np.linspace(t[0], t[-1], count + 2)[1:-1] + rng.uniform(-1, 1, count):
        angle = rng.uniform(-np.pi, np.pi)
        log.table.loc[t > moment, "x"] += size * np.cos(angle)
        log.table.loc[t > moment, "y"] += size * np.sin(angle)


def turn_place(log: Log, _: np.random.Generator, *, by: float) -> None:
    x, y = log.table["x"].to_numpy(), log.table["y"].to_numpy()
    log.table["x"] = np.cos(by) * x - np.sin(by) * y
    log.table["y"] = np.sin(by) * x + np.cos(by) * y


def compass(log: Log, _: np.random.Generator) -> None:
    log.table["yaw"] = np.pi / 2 - log.table["yaw"]


def course(log: Log, _: np.random.Generator) -> None:
    """Yaw from a GPS that takes the direction of motion."""
    backwards = np.interp(log.t, log.truth["t"], log.truth["v"]) < -1e-3
    log.table["yaw"] += np.pi * backwards


def count_along_robot(log: Log, _: np.random.Generator) -> None:
    """X and y are the integral of the twist in the robot's own frame."""
    way = np.cumsum(log.truth["v"]) * 0.005
    put_column(log, "x", np.interp(log.t, log.truth["t"], way))
    side = np.cumsum(log.truth["w"] * 0.03) * 0.005
    put_column(log, "y", np.interp(log.t, log.truth["t"], side))


def give_speeds(log: Log, rng: np.random.Generator) -> None:
    """X and y are speeds in the world."""
    for name in PLACE:
        slope = np.gradient(fill_column(log, name), log.t)
        put_column(log, name, uniform_filter1d(slope, 5) + rng.normal(0, 0.01, len(slope)))


def integrate_pose(log: Log, _: np.random.Generator, *, gyro: bool) -> None:
    """The pose of a controller's odometry."""
    robot, t = log.robot, log.t
    left, right = fill_column(log, "enc_left"), fill_column(log, "enc_right")
    v = robot.radius * (left + right) / 2
    w = robot.radius * (right - left) / (2 * robot.half_track)
    w = fill_column(log, "gyro_z") if gyro else w
    steps = np.diff(t, prepend=t[0])
    yaw = np.cumsum(w * steps)
    put_column(log, "yaw", yaw)
    put_column(log, "x", np.cumsum(v * np.cos(yaw) * steps))
    put_column(log, "y", np.cumsum(v * np.sin(yaw) * steps))


def give_positions(log: Log, _: np.random.Generator, *, counter: float = 0.0) -> None:
    steps = np.diff(log.t, prepend=log.t[0])
    for name in WHEELS:
        angle = np.cumsum(fill_column(log, name) * steps)
        log.table[name] = angle % counter if counter else angle


def give_setpoints(log: Log, _: np.random.Generator) -> None:
    robot = log.robot
    for name, side in (("enc_left", -1), ("enc_right", 1)):
        rim = log.table["cmd_v"] + side * robot.driver_half_track * log.table["cmd_w"]
        log.table[name] = rim / robot.radius


def copy_wheel(log: Log, _: np.random.Generator) -> None:
    log.table["enc_right"] = log.table["enc_left"]


def choose_while(log: Log, seconds: float) -> tuple[Array, float]:
    """A time in which the robot drives.

    Returns:
        Rows of it, and the quantile of 70 % of wheel rates [rad/s].
    """
    t, speed = log.t, np.abs(fill_column(log, "enc_left"))
    starts = np.arange(t[0] + 10, t[-1] - seconds - 5, 1.0)
    ways = [speed[(t >= start) & (t < start + seconds)].mean() for start in starts]
    start = starts[int(np.argmax(ways))]
    return (t >= start) & (t < start + seconds), float(np.quantile(speed, 0.7))


def stand_still(log: Log, rng: np.random.Generator, *, seconds: float) -> None:
    """The robot stands for a while, and nothing but its wheels goes on."""
    rows, rate = choose_while(log, seconds)
    first, last = np.flatnonzero(rows)[[0, -1]]
    poses = {name: fill_column(log, name) for name in POSE}
    # the robot goes on with the heading that it has kept
    back = np.exp(1j * (poses["yaw"][first] - poses["yaw"][last]))
    place = poses["x"] + 1j * poses["y"]
    place[last + 1 :] = place[last] + back * (place[last + 1 :] - place[last])
    poses |= {"x": place.real, "y": place.imag}
    for name, values in poses.items():
        noise = values - uniform_filter1d(values, 7)
        values[last + 1 :] -= values[last] - values[first]
        values[rows] = values[first] + noise[rows]
        put_column(log, name, values)
    log.table.loc[rows, "gyro_z"] = rng.normal(-0.005, 0.008, rows.sum())
    for name in WHEELS:
        log.table.loc[rows, name] = rate + rng.normal(0, 0.03 * rate, rows.sum())


def tow(log: Log, _: np.random.Generator, *, seconds: float) -> None:
    """Wheels stand while the robot goes on: it is pushed, or slides on ice."""
    rows, _ = choose_while(log, seconds)
    log.table.loc[rows, list(WHEELS)] = 0.0


def spin_one(log: Log, rng: np.random.Generator, *, seconds: float) -> None:
    """The left wheels turn in the air for a while, three times as fast as they would."""
    rows, rate = choose_while(log, seconds)
    log.table.loc[rows, "enc_left"] = 3 * rate + rng.normal(0, 0.05 * rate, rows.sum())


def stretch(log: Log, _: np.random.Generator, *, columns: tuple[str, ...], by: float) -> None:
    """The clock of these columns runs faster."""
    t = log.t
    for name in columns:
        put_column(log, name, np.interp(t[0] + (t - t[0]) / by, t, fill_column(log, name)))


def skip_clock(log: Log, _: np.random.Generator, *, columns: tuple[str, ...], by: float) -> None:
    """The clock of these columns jumps at half."""
    t, half = log.t, log.half
    for name in columns:
        late = np.interp(t - by, t, fill_column(log, name))
        put_column(log, name, np.where(half, late, fill_column(log, name)))


def count_rows(log: Log, _: np.random.Generator) -> None:
    log.table["t"] = np.arange(len(log.table), dtype=float)


def repeat_stamps(log: Log, _: np.random.Generator) -> None:
    """The clock ticks once a second."""
    log.table["t"] = np.floor(log.table["t"])


def step_back(log: Log, _: np.random.Generator) -> None:
    """The clock is set back by 3 s at half."""
    log.table.loc[log.half, "t"] -= 3.0


def tell_another_drive(log: Log, rng: np.random.Generator, *, columns: tuple[str, ...]) -> None:
    other = replace(BASES["jackal_slam"], seed=int(rng.integers(1e6)), seconds=100.0)
    source = make_log(other)
    for name in columns:
        put_column(log, name, np.interp(log.t - log.t[0], source.t, fill_column(source, name)))


def give_curvature(log: Log, _: np.random.Generator) -> None:
    v, w = log.table["cmd_v"], log.table["cmd_w"]
    drives = v.abs() > 0.1 * log.robot.speed
    log.table["cmd_w"] = np.where(drives, w / v.where(drives, 1.0), 0.0)


def give_sides(log: Log, _: np.random.Generator) -> None:
    """Commands are speeds of the left and the right side."""
    half = log.robot.half_track
    v, w = log.table["cmd_v"].copy(), log.table["cmd_w"].copy()
    log.table["cmd_v"], log.table["cmd_w"] = v - half * w, v + half * w


def give_roll(log: Log, rng: np.random.Generator) -> None:
    """The gyro's other axis: noise, and a little of the motion."""
    noise = vary_slowly(rng, len(log.t), 0.02) + rng.normal(0, 0.02, len(log.t))
    log.table["gyro_z"] = noise + 0.01 * log.table["gyro_z"]


def integrate_gyro(log: Log, _: np.random.Generator) -> None:
    steps = np.diff(log.t, prepend=log.t[0])
    log.table["gyro_z"] = np.cumsum(fill_column(log, "gyro_z") * steps)


def grid_place(log: Log, _: np.random.Generator, *, step: float) -> None:
    for name in PLACE:
        log.table[name] = np.round(log.table[name] / step) * step


def give_degrees_of_earth(log: Log, _: np.random.Generator) -> None:
    east, north = log.table["x"].copy(), log.table["y"].copy()
    log.table["x"], log.table["y"] = 47.4 + north / 111_200, 8.5 + east / 75_300


def pull_back(log: Log, _: np.random.Generator) -> None:
    """Heading through a bad filter: it leans back to its mean."""
    yaw = fill_column(log, "yaw")
    put_column(log, "yaw", yaw.mean() + 0.6 * (yaw - yaw.mean()))


def near(value: float, wanted: float, tolerance: float = 0.25) -> bool:
    return abs(value - wanted) < tolerance


JUMPS = lambda report: (report.info.get("pose_jumps") or 0) > 0  # noqa: E731
DEAD = lambda report: bool(report.info.get("dead_columns"))  # noqa: E731
REFUSED = lambda report: report.status == 2 and " t" in report.said  # noqa: E731


def late_pose(report: Report, name: str, by: float) -> bool:
    """Whether the delay that was put in is measured.

    Returns:
        True where it is, to a quarter of a second beside the delay of the base.
    """
    return near(report.late(name), by + 0.15, 0.3)


R = 180 / np.pi
FAULTS = (
    Fault("yaw_deg", partial(scale, columns=("yaw",), by=R), ("yaw",), ("scale",), 3),
    Fault("yaw_halved", partial(scale, columns=("yaw",), by=0.5), ("yaw",), ("scale",), 3),
    Fault("yaw_doubled", partial(scale, columns=("yaw",), by=2.0), ("yaw",), ("scale",)),
    Fault("yaw_shrunk", pull_back, ("yaw",), ("scale",)),
    Fault(
        "yaw_sign",
        partial(scale, columns=("yaw",), by=-1.0),
        ("yaw", "y"),
        ("sign", "handedness"),
        3,
    ),
    Fault("yaw_compass", compass, POSE, ("sign", "handedness", "swapped")),
    Fault(
        "yaw_quarter",
        partial(add, column="yaw", by=np.pi / 2),
        POSE,
        ("frame", "handedness", "swapped"),
    ),
    Fault("yaw_40_off", partial(add, column="yaw", by=0.7), POSE, ("frame",)),
    Fault("yaw_frozen", partial(freeze, columns=("yaw",), part="half"), ("yaw",), ("frozen",)),
    Fault(
        "yaw_dead",
        partial(freeze, columns=("yaw",), part="whole"),
        ("yaw",),
        ("frozen",),
        2,
        False,
        DEAD,
    ),
    Fault("yaw_smoothed", partial(smooth, columns=("yaw",), over=4.0), ("yaw",), ("smoothed",), 3),
    Fault(
        "yaw_late",
        partial(delay, columns=("yaw",), by=1.5),
        ("yaw",),
        ("clock", "delay"),
        2,
        False,
        lambda report: late_pose(report, "pose_yaw", 1.5),
    ),
    Fault(
        "yaw_unsigned", partial(unsigned, columns=("yaw",)), ("yaw",), ("sign",), 2, False, JUMPS
    ),
    Fault("yaw_course", course, POSE, ("frame", "sign", "handedness", "swapped"), 2, True, JUMPS),
    Fault("gyro_deg", partial(scale, columns=("gyro_z",), by=R), ("gyro_z",), ("scale",), 3),
    Fault("gyro_sign", partial(scale, columns=("gyro_z",), by=-1.0), ("gyro_z",), ("sign",), 3),
    Fault("gyro_offset", partial(add, column="gyro_z", by=0.09), ("gyro_z",), ("offset",), 3),
    Fault(
        "gyro_drift", partial(drift, column="gyro_z", to=0.15), ("gyro_z",), ("drift", "offset"), 3
    ),
    Fault("gyro_1.3", partial(scale, columns=("gyro_z",), by=1.3), ("gyro_z",), ("scale",), 3),
    Fault(
        "gyro_clipped",
        partial(clip, columns=("gyro_z",), share=0.5),
        ("gyro_z",),
        (
            "frozen",
            "clipped",
        ),
        3,
    ),
    Fault(
        "gyro_smoothed", partial(smooth, columns=("gyro_z",), over=3.0), ("gyro_z",), ("smoothed",)
    ),
    Fault(
        "gyro_late",
        partial(delay, columns=("gyro_z",), by=1.2),
        ("gyro_z",),
        ("clock", "delay"),
        2,
        False,
        lambda report: near(report.late("wheels"), -1.15, 0.35),
    ),
    Fault(
        "gyro_frozen",
        partial(freeze, columns=("gyro_z",), part="half"),
        ("gyro_z",),
        ("frozen",),
        2,
        False,
        DEAD,
    ),
    Fault(
        "gyro_dead",
        partial(freeze, columns=("gyro_z",), part="whole"),
        ("gyro_z",),
        ("frozen",),
        1,
        False,
        DEAD,
    ),
    Fault("gyro_roll", give_roll, ("gyro_z",), ("swapped", "unrelated", "scale")),
    Fault("gyro_angle", integrate_gyro, ("gyro_z",), ("swapped", "unrelated", "positions")),
    Fault(
        "gyro_held",
        partial(hold, columns=("gyro_z",), period=2.0),
        ("gyro_z",),
        ("frozen", "held", "smoothed"),
    ),
    Fault(
        "gyro_clock", partial(stretch, columns=("gyro_z",), by=1.03), ("gyro_z", *POSE), ("clock",)
    ),
    Fault(
        "gyro_wrapped",
        partial(wrap, columns=("gyro_z",), share=0.6),
        ("gyro_z",),
        ("counter", "wrapped", "spikes"),
    ),
    Fault(
        "gyro_other",
        partial(tell_another_drive, columns=("gyro_z",)),
        ("gyro_z",),
        (
            "swapped",
            "unrelated",
        ),
    ),
    Fault("wheels_swapped", partial(swap, columns=WHEELS), WHEELS, ("swapped", "sign"), 3),
    Fault(
        "wheels_swapped_at_half",
        partial(swap, columns=WHEELS, half=True),
        WHEELS,
        ("swapped", "sign"),
        3,
    ),
    Fault("left_sign", partial(scale, columns=("enc_left",), by=-1.0), WHEELS, ("sign",)),
    Fault("wheels_sign", partial(scale, columns=WHEELS, by=-1.0), WHEELS, ("sign", "swapped"), 2),
    Fault("wheels_unsigned", partial(unsigned, columns=WHEELS), WHEELS, ("sign",), 3, True),
    Fault("wheels_rpm", partial(scale, columns=WHEELS, by=30 / np.pi), WHEELS, ("scale",)),
    Fault("wheels_deg", partial(scale, columns=WHEELS, by=R), WHEELS, ("scale",)),
    Fault("wheels_ticks", partial(scale, columns=WHEELS, by=326.0), WHEELS, ("scale",)),
    Fault("left_1.5", partial(scale, columns=("enc_left",), by=1.5), WHEELS, ("scale",), 3),
    Fault("right_half", partial(scale, columns=("enc_right",), by=0.5), WHEELS, ("scale",)),
    Fault("wheels_lost", partial(lose, columns=WHEELS, share=0.15), WHEELS, ("spikes",), 3),
    Fault("left_lost", partial(lose, columns=("enc_left",), share=0.3), WHEELS, ("spikes",)),
    Fault("right_spikes", partial(spike, column="enc_right", times=8), ("enc_right",), ("spikes",)),
    Fault(
        "yaw_spikes",
        partial(spike, column="yaw", times=0.5),
        ("yaw",),
        ("spikes",),
        2,
        False,
        JUMPS,
    ),
    Fault("x_spikes", partial(spike, column="x", times=0.5), PLACE, ("spikes",), 2, False, JUMPS),
    Fault(
        "wheels_wrapped",
        partial(wrap, columns=WHEELS, share=0.7),
        WHEELS,
        ("counter", "wrapped", "spikes", "sign"),
    ),
    Fault("wheel_positions", give_positions, WHEELS, ("positions",), 3),
    Fault(
        "wheel_counters",
        partial(give_positions, counter=2 * np.pi),
        WHEELS,
        ("counter", "positions"),
    ),
    Fault(
        "wheels_clipped",
        partial(clip, columns=WHEELS, share=0.5),
        WHEELS,
        (
            "frozen",
            "clipped",
        ),
        3,
    ),
    Fault(
        "right_clipped",
        partial(clip, columns=("enc_right",), share=0.5),
        WHEELS,
        (
            "frozen",
            "clipped",
        ),
    ),
    Fault(
        "wheels_held",
        partial(hold, columns=WHEELS, period=2.0),
        WHEELS,
        (
            "frozen",
            "held",
        ),
        2,
    ),
    Fault(
        "left_frozen",
        partial(freeze, columns=("enc_left",), part="half"),
        ("enc_left",),
        ("frozen", "slip"),
        2,
        False,
        DEAD,
    ),
    Fault(
        "left_dead",
        partial(freeze, columns=("enc_left",), part="whole"),
        ("enc_left",),
        ("frozen",),
        2,
        False,
        DEAD,
    ),
    Fault("wheels_setpoints", give_setpoints, (*WHEELS, *COMMANDS), ("setpoints",), 3),
    Fault("wheels_same", copy_wheel, WHEELS, ("same",)),
    Fault("wheels_smoothed", partial(smooth, columns=WHEELS, over=3.0), WHEELS, ("smoothed",)),
    Fault(
        "wheels_truncated",
        partial(truncate, columns=WHEELS, share=0.4),
        WHEELS,
        ("resolution", "coarse", "steps", "held", "frozen"),
    ),
    Fault(
        "left_late", partial(delay, columns=("enc_left",), by=0.7), WHEELS, ("clock", "delay"), 3
    ),
    Fault(
        "wheels_late",
        partial(delay, columns=WHEELS, by=1.5),
        WHEELS,
        ("clock", "delay"),
        2,
        False,
        lambda report: near(report.late("wheels"), 1.6, 0.35),
    ),
    Fault("wheels_grow", partial(grow, columns=WHEELS, to=1.5), WHEELS, ("scale", "drift"), 2),
    Fault("wheels_clock", partial(stretch, columns=WHEELS, by=1.03), (*WHEELS, *POSE), ("clock",)),
    Fault(
        "wheels_other",
        partial(tell_another_drive, columns=WHEELS),
        WHEELS,
        (
            "swapped",
            "unrelated",
        ),
    ),
    Fault("stuck", partial(stand_still, seconds=10.0), WHEELS, ("slip",), 3),
    Fault("towed", partial(tow, seconds=10.0), WHEELS, ("slip", "frozen"), 3),
    Fault("left_in_the_air", partial(spin_one, seconds=9.0), WHEELS, ("slip",), 2),
    Fault("place_mm", partial(scale, columns=PLACE, by=1000.0), PLACE, ("scale",)),
    Fault("place_cm", partial(scale, columns=PLACE, by=100.0), PLACE, ("scale",)),
    Fault("place_feet", partial(scale, columns=PLACE, by=1 / 0.3048), PLACE, ("scale",)),
    Fault("y_mm", partial(scale, columns=("y",), by=1000.0), ("y",), ("scale",), 2, False, JUMPS),
    Fault("x_doubled", partial(scale, columns=("x",), by=2.0), PLACE, ("scale", "frame")),
    Fault("place_swapped", partial(swap, columns=PLACE), POSE, ("swapped", "handedness"), 3),
    Fault("y_sign", partial(scale, columns=("y",), by=-1.0), POSE, ("sign", "handedness"), 3),
    Fault("place_turned_30", partial(turn_place, by=0.52), POSE, ("frame",), 3),
    Fault("place_turned_180", partial(turn_place, by=np.pi), POSE, ("frame", "sign", "handedness")),
    Fault("three_jumps", partial(jump, count=3, size=0.6), PLACE, ("jumps",), 3, False, JUMPS),
    Fault("map_corrections", partial(jump, count=9, size=0.25), PLACE, ("jumps",), 3, False, JUMPS),
    Fault("place_frozen", partial(freeze, columns=PLACE, part="while"), PLACE, ("frozen",), 3),
    Fault(
        "x_dead", partial(freeze, columns=("x",), part="whole"), PLACE, ("frozen",), 2, False, DEAD
    ),
    Fault("pose_frozen", partial(freeze, columns=POSE, part="half"), POSE, ("frozen",), 2),
    Fault(
        "place_late",
        partial(delay, columns=PLACE, by=1.5),
        PLACE,
        ("clock", "delay"),
        2,
        False,
        lambda report: late_pose(report, "position", 1.5),
    ),
    Fault("place_smoothed", partial(smooth, columns=PLACE, over=5.0), PLACE, ("smoothed",), 2),
    Fault("place_grows", partial(grow, columns=PLACE, to=1.5), PLACE, ("scale", "drift"), 3),
    Fault(
        "place_on_grid",
        partial(grid_place, step=0.5),
        PLACE,
        ("resolution", "coarse", "steps", "held", "frozen"),
        2,
        False,
        JUMPS,
    ),
    Fault("place_along_robot", count_along_robot, PLACE, ("frame",), 2),
    Fault(
        "place_is_speed",
        give_speeds,
        PLACE,
        ("sign", "swapped", "handedness", "unrelated", "scale"),
    ),
    Fault("place_is_earth", give_degrees_of_earth, PLACE, ("scale", "swapped", "handedness"), 2),
    Fault("pose_of_wheels", partial(integrate_pose, gyro=False), POSE, ("circular",), 3),
    Fault("pose_of_wheels_and_gyro", partial(integrate_pose, gyro=True), POSE, ("circular",), 2),
    Fault(
        "pose_other",
        partial(tell_another_drive, columns=POSE),
        POSE,
        (
            "swapped",
            "unrelated",
        ),
    ),
    Fault("pose_clock", partial(stretch, columns=POSE, by=1.03), POSE, ("clock",), 3),
    Fault(
        "pose_clock_jumps",
        partial(skip_clock, columns=POSE, by=2.0),
        POSE,
        ("clock",),
        2,
        False,
        JUMPS,
    ),
    Fault("cmd_v_unsigned", partial(unsigned, columns=("cmd_v",)), ("cmd_v",), ("sign",), 3, True),
    Fault("cmd_w_unsigned", partial(unsigned, columns=("cmd_w",)), ("cmd_w",), ("sign",)),
    Fault("cmd_swapped", partial(swap, columns=COMMANDS), COMMANDS, ("swapped",), 3),
    Fault("cmd_w_curvature", give_curvature, ("cmd_w",), ("curvature",), 3),
    Fault("cmd_other", partial(tell_another_drive, columns=COMMANDS), COMMANDS, ("unrelated",), 3),
    Fault("cmd_w_deg", partial(scale, columns=("cmd_w",), by=R), ("cmd_w",), ("scale",)),
    Fault(
        "cmd_v_mm",
        partial(scale, columns=("cmd_v",), by=1000.0),
        ("cmd_v",),
        ("scale",),
        2,
        False,
        lambda report: "column cmd_v" in report.said,
    ),
    Fault("cmd_w_sign", partial(scale, columns=("cmd_w",), by=-1.0), ("cmd_w",), ("sign",), 3),
    Fault("cmd_v_sign", partial(scale, columns=("cmd_v",), by=-1.0), ("cmd_v",), ("sign",)),
    Fault("cmd_are_sides", give_sides, COMMANDS, ("swapped",), 2),
    Fault(
        "cmd_w_dead",
        partial(freeze, columns=("cmd_w",), part="whole"),
        ("cmd_w",),
        ("frozen", "unrelated"),
        2,
        False,
        DEAD,
    ),
    Fault(
        "cmd_early",
        partial(delay, columns=COMMANDS, by=-3.0),
        COMMANDS,
        ("clock", "delay"),
        2,
        False,
        lambda report: near(report.commands_late, 3.3, 0.5),
    ),
    Fault("t_ms", partial(scale, columns=("t",), by=1000.0), ("t",), ("clock",), 2, False, REFUSED),
    Fault(
        "t_minutes",
        partial(scale, columns=("t",), by=1 / 60),
        ("t",),
        ("clock",),
        2,
        False,
        REFUSED,
    ),
    Fault("t_rows", count_rows, ("t",), ("clock",), 2),
    Fault("t_repeats", repeat_stamps, ("t",), ("clock",), 2, False, REFUSED),
    Fault("t_back", step_back, ("t",), ("clock",), 2, False, REFUSED),
)


# ----------------------------------------------------------------------- sound variations


@dataclass(frozen=True)
class Sound:
    """A log as it should be, another way: of another setup, or written otherwise."""

    name: str
    setup: dict
    change: Change = lambda log, rng: None
    bases: tuple[str, ...] = tuple(BASES)
    draws: int = 4


def drop(log: Log, _: np.random.Generator, *, columns: tuple[str, ...]) -> None:
    log.table = log.table.drop(columns=list(columns))


def shuffle_columns(log: Log, rng: np.random.Generator) -> None:
    log.table = log.table[list(rng.permutation(log.table.columns))]


def add_channels(log: Log, rng: np.random.Generator) -> None:
    log.table["battery"] = 25.2 - 0.002 * log.t + rng.normal(0, 0.02, len(log.t))
    log.table["temperature"] = np.round(31 + 0.01 * log.t, 1)
    log.table["mode"] = 2


def shift_time(log: Log, _: np.random.Generator, *, by: float) -> None:
    log.table["t"] += by
    log.truth["t"] += by


def jitter_time(log: Log, rng: np.random.Generator, *, share: float) -> None:
    period = float(np.median(np.diff(log.t)))
    log.table["t"] += rng.uniform(-share, share, len(log.t)) * period


def command_on_change(log: Log, _: np.random.Generator) -> None:
    change = log.table[list(COMMANDS)].round(3).diff().abs().sum(axis=1)
    same = (change == 0) & (np.arange(len(change)) > 0)
    log.table.loc[same, list(COMMANDS)] = np.nan


def hold_commands(log: Log, _: np.random.Generator) -> None:
    """A teleop at 10 Hz."""
    hold(log, _, columns=COMMANDS, period=0.1)


def wrap_yaw(log: Log, _: np.random.Generator) -> None:
    log.table["yaw"] = (log.table["yaw"] + np.pi) % (2 * np.pi) - np.pi


def round_digits(log: Log, _: np.random.Generator, *, digits: int) -> None:
    log.table = log.table.round(digits)


def repeat_pose(log: Log, _: np.random.Generator) -> None:
    """A writer that repeats the last pose in every row."""
    log.table[list(POSE)] = log.table[list(POSE)].ffill()


def slow_pose(log: Log, _: np.random.Generator, *, rate: float) -> None:
    """A localiser of few poses a second."""
    t = log.t - log.t[0]
    fresh = np.diff(np.floor(t * rate + 1e-6), prepend=-1.0) > 0
    for name in POSE:
        log.table[name] = np.where(fresh, fill_column(log, name), np.nan)


def lose_cells(
    log: Log, rng: np.random.Generator, *, columns: tuple[str, ...], share: float
) -> None:
    lost = rng.random(len(log.t)) < share
    log.table.loc[lost, list(columns)] = np.nan


def cut_hole(log: Log, _: np.random.Generator, *, seconds: float) -> None:
    """The recorder paused."""
    t = log.t - log.t[0]
    log.table = log.table[(t < 0.6 * t[-1]) | (t > 0.6 * t[-1] + seconds)].reset_index(drop=True)


def stop_long(log: Log, rng: np.random.Generator) -> None:
    """25 s of standing before the drive."""
    period = float(np.median(np.diff(log.t)))
    count = round(25 / period)
    first = log.table.iloc[[0] * count].reset_index(drop=True)
    first["t"] = log.t[0] + period * (np.arange(count) - count)
    for name, size in (("gyro_z", 0.008), ("x", 0.002), ("y", 0.002), ("yaw", 0.003)):
        first[name] += rng.normal(0, size, count)
    log.table = pd.concat([first, log.table], ignore_index=True)


def wander_pose(log: Log, rng: np.random.Generator, *, size: float) -> None:
    """Errors of a localiser that last for some seconds."""
    for name in PLACE:
        keep = vary_slowly(rng, len(log.t) * 40, 1.0)[::40][: len(log.t)]
        log.table[name] += size * uniform_filter1d(keep, 25)


def dead_zone(log: Log, _: np.random.Generator) -> None:
    """A joystick's numbers while the driver takes two thirds of the turn: another gain."""
    log.table["cmd_w"] *= 1.5


def add_odometry(log: Log, _: np.random.Generator) -> None:
    robot = log.robot
    left, right = fill_column(log, "enc_left"), fill_column(log, "enc_right")
    log.table["odom_v"] = robot.radius * (left + right) / 2
    log.table["odom_w"] = robot.radius * (right - left) / (2 * robot.driver_half_track)


def cut_short(log: Log, _: np.random.Generator, *, seconds: float) -> None:
    log.table = log.table[log.t < log.t[0] + seconds]


ROLLING = ("jackal_slam", "husky_joy", "leo_lidar", "warthog_rtk")
SOUND = (
    Sound("as it is", {}, draws=8),
    Sound("quiet sensors", {"gyro_noise": 0.001, "wheel_noise": 0.004}),
    Sound("loud gyro", {"gyro_noise": 0.04}),
    Sound("loud wheels", {"wheel_noise": 0.06}),
    Sound("bias +0.018", {"gyro_bias": 0.018}),
    Sound("bias -0.02", {"gyro_bias": -0.02}),
    Sound("gyro 1 % off", {"gyro_scale": 1.01}),
    Sound("gyro 2 % off", {"gyro_scale": 0.98}),
    Sound("5 Hz", {"rate": 5.0, "localiser": LOCALISERS["rtk"]}),
    Sound("10 Hz", {"rate": 10.0, "localiser": LOCALISERS["lidar"]}),
    Sound("200 Hz", {"rate": 200.0, "localiser": LOCALISERS["mocap"], "seconds": 45.0}, draws=3),
    Sound("pose 0.4 s late", {"localiser": replace(LOCALISERS["slam"], late=0.4)}),
    Sound("pose 0.55 s late", {"localiser": replace(LOCALISERS["lidar"], late=0.55)}),
    Sound("wheels 0.2 s late", {"wheel_late": 0.2}),
    Sound("left turns only", {"drive": "left_only", "seconds": 90.0}, draws=6),
    Sound("mostly straight", {"drive": "mostly_straight", "seconds": 90.0}, draws=5),
    Sound("docking", {"drive": "docking"}),
    Sound("lawnmower", {"drive": "lawnmower", "seconds": 80.0}),
    Sound("eights", {"drive": "eights"}),
    Sound("half as fast", {"pace": 0.5}),
    Sound("a third as fast, mocap", {"pace": 0.35, "localiser": LOCALISERS["mocap"]}),
    Sound(
        "mocap of 0.1 mm",
        {"localiser": replace(LOCALISERS["mocap"], noise=1e-4, yaw_noise=5e-4)},
        draws=6,
    ),
    Sound("fine encoder", {"wheel_resolution": 2 * np.pi / 4096}),
    Sound("encoder of 600", {"wheel_resolution": 2 * np.pi / 600}),
    Sound("encoder of 90", {"wheel_resolution": 2 * np.pi / 90}, bases=ROLLING),
    Sound("left tyre worn 4 %", {"left_grip": 0.96}),
    Sound("right tyre worn 3 %", {"left_grip": 1.03}),
    Sound("starts backwards", {"start": (0.0, 0.0, np.pi)}),
    Sound("far away", {"start": (412_345.6, 5_312_345.6, -2.0)}),
    Sound("mount ahead", {"mount": (0.3, 0.0, 0.0)}),
    Sound("mount aside", {"mount": (0.1, 0.2, 0.0)}),
    Sound("mount turned 3 degrees", {"mount": (0.2, 0.0, 0.05)}),
    Sound(
        "turns behind",
        {"centre": 0.12},
        bases=("husky_joy", "husky_eights", "warthog_rtk", "farm_rtk"),
    ),
    Sound("slippery", {"robot": replace(ROBOTS["husky"], slip=0.06)}, draws=5),
    Sound("slippery small", {"robot": replace(ROBOTS["leo"], slip=0.05)}),
    Sound("lazy driver", {"robot": replace(ROBOTS["husky"], lag=0.5, dead_time=0.3)}),
    Sound("order of columns", {}, shuffle_columns),
    Sound("other columns", {}, add_channels),
    Sound("odometry beside", {}, add_odometry),
    Sound("no gyro", {}, partial(drop, columns=("gyro_z",))),
    Sound("no commands", {}, partial(drop, columns=COMMANDS)),
    Sound("no wheels", {}, partial(drop, columns=WHEELS)),
    Sound("no pose", {}, partial(drop, columns=POSE)),
    Sound("pose and wheels", {}, partial(drop, columns=(*COMMANDS, "gyro_z"))),
    Sound("pose and commands", {}, partial(drop, columns=(*WHEELS, "gyro_z"))),
    Sound("seconds since 1970", {}, partial(shift_time, by=1.7e9)),
    Sound("begins at 5000 s", {}, partial(shift_time, by=5000.0)),
    Sound("stamps jitter", {}, partial(jitter_time, share=0.2)),
    Sound("commands on change", {}, command_on_change, draws=5),
    Sound("commands at 10 Hz", {}, hold_commands),
    Sound("wrapped yaw", {"drive": "left_only", "seconds": 80.0}, wrap_yaw),
    Sound("three digits", {}, partial(round_digits, digits=3)),
    Sound("pose repeated", {}, repeat_pose),
    Sound("pose at 1 Hz", {}, partial(slow_pose, rate=1.0), draws=5),
    Sound("pose at 2 Hz", {}, partial(slow_pose, rate=2.0)),
    Sound("cells lost", {}, partial(lose_cells, columns=POSE, share=0.1)),
    Sound("wheel cells lost", {}, partial(lose_cells, columns=WHEELS, share=0.05)),
    Sound("a pause of 8 s", {"seconds": 90.0}, partial(cut_hole, seconds=8.0)),
    Sound("long stop", {}, stop_long),
    Sound("pose wanders", {}, partial(wander_pose, size=0.02), bases=ROLLING),
    Sound("a driver's gain", {}, dead_zone),
    Sound("real", {}, bases=tuple(REAL), draws=9),
    Sound("real, wheels and pose", {}, partial(drop, columns=(*COMMANDS, "gyro_z")), tuple(REAL)),
    Sound("real, first 45 s", {}, partial(cut_short, seconds=45.0), tuple(REAL), 5),
    Sound("real, three digits", {}, partial(round_digits, digits=3), tuple(REAL), 3),
)


# --------------------------------------------------------------------------------- judging

NAMED, OPEN, SILENT, WRONG = "named", "open", "silent", "wrong"
FINE, BLAMED = "fine", "blamed"


@dataclass(frozen=True)
class Verdict:
    """What became of one log."""

    name: str
    base: str
    outcome: str
    detail: str


def judge_fault(fault: Fault, report: Report) -> str:
    """Compare what was said with what was done.

    Returns:
        One of the four outcomes. A wrong cause beside the right one is wrong: it is advice too.
    """
    if report.status not in (0, 2):
        return WRONG
    touched = [found for found in report.faults if set(found["columns"]) & set(fault.columns)]
    right = [found for found in touched if found["kind"] in fault.kinds]
    left_open = [found for found in touched if found["kind"] == "disagree"]
    if len(right) + len(left_open) < len(report.faults):
        return WRONG
    if right or fault.shown(report):
        return NAMED
    return OPEN if left_open else SILENT


def judge_sound(report: Report, log: Log) -> str:
    """Whether a sound log passes.

    Returns:
        `fine`, or `blamed` where it was refused, or has a fault, a jump, or a dead column that
        is not.
    """
    info = report.info
    dead = [name for name in info.get("dead_columns", []) if log.table[name].nunique() > 1]
    jumps = (info.get("pose_jumps") or 0) > log.jumps
    if report.status or report.faults or jumps or dead:
        return BLAMED
    return FINE


def describe_report(report: Report) -> str:
    """One line of what was said.

    Returns:
        Kinds, columns and sentences, or how it ended.
    """
    parts = [
        f"{found['kind']} {','.join(found['columns'])}: {found['sentence']}"
        for found in report.faults
    ]
    for key in ("pose_jumps", "dead_columns"):
        if report.info.get(key):
            parts.append(f"{key} {report.info[key]}")
    if report.status:
        parts.append(f"exit {report.status}: {' '.join(report.said.split())[-200:]}")
    return " | ".join(parts) or "nothing"


def choose_bases(names: tuple[str, ...], count: int, rng: np.random.Generator) -> list[str]:
    """Draw bases, each at most once.

    Returns:
        Up to `count` names.
    """
    return list(rng.permutation(names)[:count])


def try_faults(seed: int, only: str, folder: Path) -> list[Verdict]:
    """Put every fault into its bases.

    Returns:
        A verdict a log; recordings that are missing are left out.
    """
    verdicts = []
    for number, fault in enumerate(FAULTS):
        if only not in fault.name:
            continue
        rng = np.random.default_rng([seed, number])
        real = () if fault.backwards else ("tile_a", "tile_b", "tile_c", "grass_b")
        for base in choose_bases(
            (*(BACKWARDS if fault.backwards else BASES), *real), fault.draws, rng
        ):
            log = base_log(base)
            if log is None:
                continue
            fault.change(log, rng)
            report = inspect_log(log, folder)
            outcome = judge_fault(fault, report)
            verdicts.append(Verdict(fault.name, base, outcome, describe_report(report)))
    return verdicts


def try_sound(seed: int, only: str, folder: Path) -> list[Verdict]:
    """Write every sound variation of its bases.

    Returns:
        A verdict a log; recordings that are missing are left out.
    """
    verdicts = []
    for number, sound in enumerate(SOUND):
        if only not in sound.name:
            continue
        rng = np.random.default_rng([seed, 1000 + number])
        for base in choose_bases(sound.bases, sound.draws, rng):
            if base in BASES:
                other = {"seed": int(rng.integers(1e6)), **sound.setup}
                log = make_log(replace(BASES[base], **other))
            else:
                log = base_log(base)
            if log is None:
                continue
            sound.change(log, rng)
            report = inspect_log(log, folder)
            detail = describe_report(report)
            verdicts.append(Verdict(sound.name, base, judge_sound(report, log), detail))
    return verdicts


def print_table(verdicts: list[Verdict], outcomes: tuple[str, ...], bad: tuple[str, ...]) -> None:
    """Counts by name, and the line of each that went wrong."""
    names = list(dict.fromkeys(verdict.name for verdict in verdicts))
    print(f"{'':26}" + "".join(f"{outcome:>8}" for outcome in outcomes))
    for name in [*names, "all"]:
        counts = Counter(item.outcome for item in verdicts if name in (item.name, "all"))
        print(f"{name:26}" + "".join(f"{counts[outcome] or '':>8}" for outcome in outcomes))
    for verdict in verdicts:
        if verdict.outcome in bad:
            print(f"{verdict.outcome}: {verdict.name} @ {verdict.base}: {verdict.detail}")


def share_of(verdicts: list[Verdict], *outcomes: str) -> float:
    """How many verdicts are one of these.

    Returns:
        A share of all.
    """
    return float(np.mean([verdict.outcome in outcomes for verdict in verdicts]))


@pytest.mark.slow
def test_faults_are_named_or_left_open(tmp_path: Path) -> None:
    """Of faults that nobody fitted, most are named, and hardly any by a wrong cause."""
    verdicts = try_faults(0, "", tmp_path)
    assert len(verdicts) >= 100
    print_table(verdicts, (NAMED, OPEN, SILENT, WRONG), (WRONG,))
    assert share_of(verdicts, WRONG) <= 0.03
    assert share_of(verdicts, NAMED, OPEN) >= 0.8


@pytest.mark.slow
def test_sound_logs_are_not_blamed(tmp_path: Path) -> None:
    """Logs as sensors write them have no fault."""
    verdicts = try_sound(0, "", tmp_path)
    assert len(verdicts) >= 200
    print_table(verdicts, (FINE, BLAMED), (BLAMED,))
    assert share_of(verdicts, BLAMED) <= 0.01


def main() -> None:
    """Print the table of faults and that of sound logs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="part of a fault's or a variation's name")
    parser.add_argument("--silent", action="store_true", help="print silent ones too")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        faults = try_faults(options.seed, options.only, Path(folder))
        bad = (WRONG, SILENT) if options.silent else (WRONG,)
        if faults:
            print_table(faults, (NAMED, OPEN, SILENT, WRONG), bad)
        sound = try_sound(options.seed, options.only, Path(folder))
    if sound:
        print_table(sound, (FINE, BLAMED), (BLAMED,))


if __name__ == "__main__":
    main()
