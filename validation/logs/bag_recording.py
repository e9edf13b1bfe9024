"""Streams of a bag -> groups of columns, and a recording on one clock.

The yaw rate is the gyro's about the vertical that its accelerometer shows, however it is mounted. Positions of a satellite
receiver become metres east and north of the first fix.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from ssmr.types import FloatArray
from validation.logs.bags import ROLES, UNITS, Bag, Stamps, Stream, choose_topics, fits, read_bag
from validation.logs.recording import Recording, RecordingError
from validation.logs.signals import Group, merge

GRAVITY_SPAN = (8.8, 10.8)
"""A mean acceleration of such size [m/s2] is gravity, and shows the vertical; another one says nothing, and z is taken."""

EQUATOR, FLATTENING = 6378137.0, 1.0 / 298.257223563
"""Of the WGS 84 ellipsoid: semi-major axis [m], and flattening."""


def read_bag_recording(
    path: str | Path,
    topics: Mapping[str, str] = MappingProxyType({}),
    stamps: Stamps = "header",
) -> Recording:
    """A bag as a recording.

    Args:
        path: a `.bag` or `.mcap` file, or the folder of a ROS 2 bag.
        topics: topics by role, see `choose_topics`; what is not named is guessed.
        stamps: which clock counts, see `read_bag`.

    Returns:
        Columns cmd_v, cmd_w of `cmd`, enc_left, enc_right of `wheels`, gyro_z of `imu`, and x, y, yaw of `pose` or, where
        there is none, of `odom`. Channels odom_v [m/s], odom_w [rad/s] of `odom` (and odom_x, odom_y, odom_yaw where there
        is a `pose`), gps_east, gps_north [m] of `gps`. Times count from the bag's epoch.

    Raises:
        RecordingError: the bag cannot be read, or its streams make no recording.
    """
    bag = read_bag(path, stamps)
    return merge(bag.path, groups_of_bag(bag, choose_topics(bag, topics)))


def groups_of_bag(bag: Bag, chosen: Mapping[str, Stream]) -> dict[str, Group]:
    """Streams, by role, as groups of columns.

    Raises:
        RecordingError: nothing was chosen, numbers that are not finite, clocks that jumped, fewer than two samples.
    """
    if not chosen:
        there = ", ".join(f"{s.topic} ({s.type})" for s in bag.streams) or "no topic of a type that can be read"
        raise RecordingError(bag.path, f"there is nothing of use: wanted odometry, wheels, an IMU or a pose; found {there}")
    return {role: as_group(bag, role, stream, "pose" in chosen) for role, stream in chosen.items()}


def as_group(bag: Bag, role: str, stream: Stream, has_pose: bool) -> Group:
    """What one stream gives to a recording, checked; a pose of odometry is called so where the bag has another.

    Raises:
        RecordingError: as `groups_of_bag`.
    """
    leave = f"--topics {role}=none leaves it out"
    if stream.jumps:
        when, size = stream.jumps[0]
        many = f", and {len(stream.jumps) - 1} times more" if len(stream.jumps) > 1 else ""
        what = f"the clock of topic {stream.topic} jumps by {size:+.3f} s after {when:.3f} s{many}"
        raise RecordingError(bag.path, f"{what}; --stamps bag takes the times of writing, {leave}")
    first = np.concatenate([[True], np.diff(stream.t) > 0.0])  # of equal stamps
    if np.count_nonzero(first) < 2:
        raise RecordingError(bag.path, f"topic {stream.topic} has fewer than two samples; {leave}")
    t, columns = stream.t[first], {name: values[first] for name, values in stream.columns.items()}
    for name in _used(role, stream):
        bad = np.flatnonzero(~np.isfinite(columns[name]))
        if len(bad):
            what = f"topic {stream.topic}, {t[bad[0]]:.3f} s: {name} is {columns[name][bad[0]]}"
            raise RecordingError(bag.path, f"{what}, wanted a finite number [{UNITS[name]}]; {leave}")
    out = _CONVERTERS[role](t, columns)
    if role == "odom" and fits(stream, "pose"):
        prefix = "odom_" if has_pose else ""
        out |= {f"{prefix}{n}": values for n, values in _pose(t, columns).items()}
    return Group(stream.topic, t, out)


def _used(role: str, stream: Stream) -> tuple[str, ...]:
    """The columns of a stream that a recording is made of."""
    if role == "wheels":
        return _wheel_columns(stream.columns)
    pose = ROLES["pose"] if role == "odom" and fits(stream, "pose") else ()
    return (*ROLES[role], *pose, *(n for n in ("acc_x", "acc_y", "acc_z") if role == "imu" and n in stream.columns))


def _wheel_columns(columns: Mapping[str, FloatArray]) -> tuple[str, str]:
    kind = "rate" if "rate_left" in columns else "angle"
    return f"{kind}_left", f"{kind}_right"


_Columns = Mapping[str, FloatArray]


def _cmd(t: FloatArray, columns: _Columns) -> dict[str, FloatArray]:
    return {"cmd_v": columns["v"], "cmd_w": columns["w"]}


def _odom(t: FloatArray, columns: _Columns) -> dict[str, FloatArray]:
    return {"odom_v": columns["v"], "odom_w": columns["w"]}


def _wheels(t: FloatArray, columns: _Columns) -> dict[str, FloatArray]:
    left, right = (columns[name] for name in _wheel_columns(columns))
    if "rate_left" not in columns:
        left, right = (np.asarray(np.gradient(np.unwrap(a), t), dtype=np.float64) for a in (left, right))
    return {"enc_left": left, "enc_right": right}


def _imu(t: FloatArray, columns: _Columns) -> dict[str, FloatArray]:
    return {"gyro_z": np.column_stack([columns[f"gyro_{axis}"] for axis in "xyz"]) @ vertical(columns)}


def _pose(t: FloatArray, columns: _Columns) -> dict[str, FloatArray]:
    return {"x": columns["x"], "y": columns["y"], "yaw": np.unwrap(columns["yaw"])}


def _gps(t: FloatArray, columns: _Columns) -> dict[str, FloatArray]:
    east, north = to_local(columns["latitude"], columns["longitude"])
    return {"gps_east": east, "gps_north": north}


_CONVERTERS: Mapping[str, Callable[[FloatArray, _Columns], dict[str, FloatArray]]] = MappingProxyType(
    {"cmd": _cmd, "odom": _odom, "wheels": _wheels, "imu": _imu, "pose": _pose, "gps": _gps}
)


def vertical(columns: Mapping[str, FloatArray]) -> FloatArray:
    """(3,) unit vector that points up, in an IMU's own axes: where its mean acceleration shows, or z."""
    up = np.array([0.0, 0.0, 1.0])
    if all(f"acc_{axis}" in columns for axis in "xyz"):
        mean = np.array([np.mean(columns[f"acc_{axis}"]) for axis in "xyz"])
        size = float(np.linalg.norm(mean))
        if GRAVITY_SPAN[0] < size < GRAVITY_SPAN[1]:
            up = mean / size
    return up


def to_local(latitude: ArrayLike, longitude: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Metres east and north of the first of (M,) positions [deg], on the plane that touches the ellipsoid there.

    Good to some centimetres within a kilometre: it leaves out what is of second order in the distance over the radius.
    """
    lat, lon = np.radians(np.asarray(latitude, dtype=np.float64)), np.asarray(longitude, dtype=np.float64)
    eccentricity2 = FLATTENING * (2.0 - FLATTENING)
    root = math.sqrt(1.0 - eccentricity2 * math.sin(lat[0]) ** 2)
    meridian, transverse = EQUATOR * (1.0 - eccentricity2) / root**3, EQUATOR / root  # radii of curvature
    turned = np.radians(np.mod(lon - lon[0] + 180.0, 360.0) - 180.0)  # also across the date line
    return transverse * math.cos(lat[0]) * turned, meridian * (lat - lat[0])
