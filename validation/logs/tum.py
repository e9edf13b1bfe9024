"""TUM trajectories, which evo reads: `t x y z qx qy qz qw` on each line. They are written only."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ssmr.geometry import quat_wxyz_to_xyzw, yaw_to_quat_wxyz
from validation.logs.files import quoted
from validation.logs.log import Log, LogFormat
from validation.logs.recording import POSE_COLUMNS, RecordingError
from validation.store import write_atomic


def write_tum(log: Log, path: Path) -> None:
    """Write the poses of a log, whole or not at all.

    Raises:
        RecordingError: there is no pose.
        OSError: the file cannot be written.
    """
    recording = log.recording()
    if not recording.has_pose:
        raise RecordingError(log.path, f"there is no pose for {path.name}; ekf makes one from wheels and gyro")
    quat = quat_wxyz_to_xyzw(yaw_to_quat_wxyz(recording.pose[:, 2]))
    table = np.column_stack([recording.t, recording.pose[:, :2], np.zeros(len(recording)), quat])
    write_atomic(path, lambda beside: np.savetxt(beside, table, fmt="%.9f"))


def tum_losses(log: Log, path: Path) -> list[str]:
    """Return a sentence about the columns that a trajectory does not hold."""
    recording = log.recording()
    left_out = [name for name in (*recording.columns, *recording.channels) if name not in POSE_COLUMNS]
    return [f"{path.name} holds the pose to nine decimals, and not: {quoted(left_out)}"] if left_out else []


TUM = LogFormat("TUM trajectory", (".tum",), write=write_tum, losses=tum_losses)
