"""The gyro of a log as a second judge of heading: where the localiser stalls, it is the better one.

A gyro on another robot may have the wrong sign, each has a bias, and it measures at once what
wheels and poses tell later. All three are found from the log. Its error after some seconds is then
a few thousandths of a radian, so where the two judges differ by much more, the localiser is wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ssmr.geometry import integral
from ssmr.metrics.windows import overlapping_windows
from ssmr.types import FloatArray
from validation.bench.sources import Source
from validation.files.faults import find_rest
from validation.files.offsets import estimate_offsets

_WINDOW_S = 6.0  # length of the windows in which gyro and localiser are compared [s]
_WORST_RAD = 0.02
"""Median difference of the two over such a window up to which the localiser is the first judge
[rad]: a sound gyro strays by 0.004, and lidar odometry of slow robots differs from it by 0.004 to
0.016."""
_ALIKE = 0.5  # least correlation of their turns, below which the gyro measures something else
# least correlation of gyro and wheels from which the delay between them is known
_SAME_MOTION = 0.9


@dataclass(frozen=True, eq=False)
class GyroJudge:
    """Headings by the gyro of a log."""

    headings: tuple[FloatArray, ...]
    """(M,) heading of each piece of the source, from 0 on, on the clock of the wheels [rad]."""
    late: tuple[FloatArray, ...]
    """(M,) the same headings of each piece, delayed as the localiser's are, so that both can be
    compared [rad]."""
    apart: float
    """Median difference between the turns by gyro and by localiser over 6 s [rad]."""

    @property
    def first(self) -> bool:
        """Whether the gyro is named before the localiser."""
        return self.apart > _WORST_RAD

    @property
    def sentence(self) -> str:
        """Sentence that says what the rule chose and why."""
        who, why = ("gyro", "more than") if self.first else ("localiser", "no more than")
        return (
            f"Gyro and localiser differ by {self.apart:.3f} rad after {_WINDOW_S:g} s in the median, {why} "
            f"{_WORST_RAD:g}: the {who} is the first judge of heading"
        )

    def judging(self, source: Source, late: float) -> Source:
        """Return the source with headings by the gyro in place of the localiser's, told as `late` as those [s]."""
        pieces = []
        for piece, heading in zip(source.pieces, self.headings, strict=True):
            reference = piece.reference
            assert reference is not None
            yaw = np.interp(reference.t - late, reference.t, heading)
            pieces.append(
                replace(
                    piece,
                    reference=replace(
                        reference, pose=np.column_stack([reference.pose[:, :2], yaw])
                    ),
                )
            )
        return replace(source, pieces=tuple(pieces))


def find_gyro_judge(source: Source) -> GyroJudge | None:
    """Return the headings by the gyro of a log, its sign, bias and clock put right; None where it has none of use.

    The localiser tells the sign. The bias is the mean at rest or, where the robot never stands, the
    median of how gyro and localiser drift apart.
    """
    log = source.log
    pairs = [(piece, piece.reference) for piece in source.pieces if piece.reference is not None]
    if log is None or "gyro_z" not in log.columns:
        return None
    windows = [piece.windows(overlapping_windows, motion.t, _WINDOW_S) for piece, motion in pairs]

    def turned(values: Sequence[FloatArray]) -> FloatArray:
        """Return by how much values of the pieces grow over all windows."""
        return np.concatenate([v[j] - v[i] for v, (i, j) in zip(values, windows, strict=True)])

    raw = [integral(m.t, m.twist[:, 2]) for _, m in pairs]
    pose = turned([m.pose[:, 2] for _, m in pairs])
    gyro = turned(raw)
    alike = float(gyro @ pose) / max(float(np.sqrt((gyro @ gyro) * (pose @ pose))), 1e-9)
    if abs(alike) < _ALIKE:
        return None
    sign = float(np.sign(alike))
    rest = find_rest(log)
    offsets = estimate_offsets(log.changed("imu", {"gyro_z": sign * log.columns["gyro_z"]}))
    late = {
        o.late: o.seconds for o in offsets if o.late == "pose_yaw" or o.correlation > _SAME_MOTION
    }

    def put(by: str, bias: float) -> tuple[FloatArray, ...]:
        """Return the headings on the clock of wheels or poses."""
        right = (
            (m.t, sign * (heading - bias * (m.t - m.t[0])))
            for (_, m), heading in zip(pairs, raw, strict=True)
        )
        return tuple(np.interp(t - late.get(by, 0.0), t, heading) for t, heading in right)

    drift = (turned(put("pose_yaw", 0.0)) - pose) / turned([m.t for _, m in pairs])
    bias = sign * float(np.median(drift)) if rest is None else rest.bias
    apart = turned(put("pose_yaw", bias)) - pose
    return GyroJudge(put("wheels", bias), put("pose_yaw", bias), float(np.median(np.abs(apart))))
