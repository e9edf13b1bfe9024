"""Trajectories as evo and the benchmarks of SLAM write them: TUM and KITTI, lines of numbers."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from ssmr.geometry import quat_wxyz_to_xyzw, quat_wxyz_to_yaw, yaw_to_quat_wxyz
from validation.files.columns import POSE_COLUMNS
from validation.files.log import Log, ReadOptions
from validation.files.reading import FileError, opened
from validation.output import write_atomic

_KITTI_DT = 0.1
"""Time between the poses of KITTI, which have no stamps [s]."""


def read_trajectory(path: Path, options: ReadOptions, radius: float | None = None) -> Log:
    """Read poses: TUM with `t x y z qx qy qz qw` on a line, KITTI with the rows of [R | p].

    KITTI's have no stamps: they count as ten a second. Where they hardly move along their y, they
    are those of a camera, whose z points ahead and x to the right.

    Raises:
        FileError: the file cannot be read, or is neither.
    """
    wanted = "wanted lines of 8 numbers, t x y z qx qy qz qw, or of KITTI's 12"
    with opened(path, options.limits.bytes_of("table_size"), "table_size") as file:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of an empty file
                table = np.loadtxt(file, ndmin=2)
        except (ValueError, UnicodeDecodeError) as error:
            raise FileError(path, f"this is no trajectory: {error}; {wanted}") from error
    rows, width = table.shape
    if width not in (8, 12) or rows < 2 or not np.all(np.isfinite(table)):
        there = f"{rows} lines of {width} numbers" if table.size else "no numbers"
        raise FileError(path, f"there are {there}; {wanted}, all finite")
    remarks = list[str]()
    if width == 8:
        yaw = quat_wxyz_to_yaw(table[:, [7, 4, 5, 6]])
        kept = np.isfinite(yaw) & (np.diff(table[:, 0], prepend=math.nan) != 0.0)
        if not np.all(kept):
            what = "whose quaternion is zero, or with the stamp of the one before"
            remarks.append(f"poses {what}, left out: {np.count_nonzero(~kept)}")
        if np.count_nonzero(kept) < 2:
            raise FileError(path, f"there are fewer than two poses: {'; '.join(remarks)}")
        t, x, y, yaw = np.column_stack([table[:, :3], yaw])[kept].T
    else:
        t = np.asarray(_KITTI_DT * np.arange(rows), dtype=np.float64)
        x, y, z = table[:, [3, 7, 11]].T
        yaw = np.arctan2(table[:, 4], table[:, 0])
        remarks.append("there are no stamps in KITTI's poses: ten a second are taken")
        if np.ptp(y) < np.ptp(z):
            y = -x
            x = z
            yaw = np.arctan2(-table[:, 2], table[:, 10])
            remarks.append("they are taken for those of a camera: z ahead, x to the right")
    log = Log.of_columns(path, {"t": t, "x": x, "y": y, "yaw": yaw}, options.limits)
    return replace(log, remarks=remarks)


def write_tum(log: Log, path: Path) -> None:
    """Write the poses of a log as evo reads them, whole or not at all.

    Each line is `t x y z qx qy qz qw`.

    Raises:
        FileError: there is no pose.
        OSError: the file cannot be written.
    """
    common = log.on_one_clock()
    if not common.has(POSE_COLUMNS):
        raise FileError(log.path, f"there is no pose for {path.name}")
    x, y, yaw = common.table(POSE_COLUMNS).T
    quaternions = quat_wxyz_to_xyzw(yaw_to_quat_wxyz(yaw))
    table = np.column_stack([common.t, x, y, np.zeros(len(x)), quaternions])
    write_atomic(path, lambda beside: np.savetxt(beside, table, fmt="%.9f"))
