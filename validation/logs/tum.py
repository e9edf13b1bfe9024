"""TUM trajectories, which evo reads: `t x y z qx qy qz qw` on each line. They are written only."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ssmr.geometry import quat_wxyz_to_xyzw, yaw_to_quat_wxyz
from validation.logs.log import Log, LogFormat
from validation.logs.recording import RecordingError
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


TUM = LogFormat("TUM trajectory", (".tum",), write=write_tum)
