"""The gyro of a log as a second judge of heading: where the localiser stalls, it is the better one.

A gyro on another robot may have the wrong sign, each has a bias, and it measures a turn at once
that wheels and poses show later. All three are found from the log. Its error after some seconds is
then a few thousandths of a radian, so where the two judges differ by much more, the localiser is
wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ssmr.metrics.windows import overlapping_windows
from ssmr.types import FloatArray
from validation.experiment.sources import Piece, Source
from validation.files.offsets import estimate_offsets
from validation.files.sensors import Signals

_WINDOW_S = 6.0
"""Length of the windows in which gyro and localiser are compared [s]."""
_WORST_RAD = 0.02
"""Median difference of the two over such a window up to which the localiser is the first judge
[rad]: a sound gyro strays by 0.004, and lidar odometry of slow robots differs from it by 0.004 to
0.016."""
_LEAST_CORRELATION = 0.5
"""Correlation of their turns below which the gyro measures something else."""
_SAME_MOTION = 0.9
"""Least correlation of gyro and wheels from which the delay between them is known."""


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
        """Sentence on the choice of the rule and its reason."""
        difference = f"{self.apart:.3f} rad after {_WINDOW_S:g} s in the median"
        rule = f"no more than {_WORST_RAD:g}: headings are scored against the pose source"
        if self.first:
            rule = f"more than {_WORST_RAD:g}: headings are scored against the gyro"
        return f"Gyro and pose source differ by {difference}, {rule}."

    def as_dict(self) -> dict[str, object]:
        """Return the choice as compare.json has it."""
        judge = "gyro" if self.first else "localiser"
        return {"heading_judge": judge, "judges_apart_rad": self.apart}

    def judging(self, source: Source, late: float) -> list[Piece]:
        """Return the pieces with the gyro's headings for the localiser's, `late` by so much [s]."""
        pieces = []
        for piece, heading in zip(source.pieces, self.headings, strict=True):
            assert piece.t is not None
            pieces.append(replace(piece, headings=np.interp(piece.t - late, piece.t, heading)))
        return pieces


def find_gyro_judge(source: Source) -> GyroJudge | None:
    """Return the headings by the gyro of a log; None where it has none of use.

    Sign, bias and clock are put right. The localiser shows the sign. The bias is the mean at rest
    or, where the robot never stands, the median drift between gyro and localiser.
    """
    inspected = source.inspected
    pairs = [(piece, piece.reference) for piece in source.pieces if piece.reference is not None]
    if inspected is None or "gyro_z" not in inspected.log.columns:
        return None
    windows = [piece.windows(overlapping_windows, motion.t, _WINDOW_S) for piece, motion in pairs]

    def turned(values: Sequence[FloatArray]) -> FloatArray:
        """Return by how much values of the pieces grow over all windows."""
        return np.concatenate([v[j] - v[i] for v, (i, j) in zip(values, windows, strict=True)])

    motions = [motion for _, motion in pairs]
    ways = [np.interp(m.t, *inspected.ways["gyro_z"]) for m in motions]
    raw = [way - way[0] for way in ways]
    pose = turned([m.pose[:, 2] for m in motions])
    gyro = turned(raw)
    size = float(np.sqrt((gyro @ gyro) * (pose @ pose)))
    correlation = float(gyro @ pose) / max(size, 1e-9)
    if abs(correlation) < _LEAST_CORRELATION:
        return None
    sign = np.sign(correlation)
    late = {}
    log = inspected.log
    if sign < 0.0:
        log = log.changed("imu", {"gyro_z": -log.columns["gyro_z"]})
    for offset in inspected.offsets if sign > 0.0 else estimate_offsets(Signals(log)):
        if offset.late == "pose_yaw" or offset.correlation > _SAME_MOTION:
            late[offset.late] = offset.seconds

    def put(by: str, bias: float) -> tuple[FloatArray, ...]:
        """Return the headings on the clock of wheels or poses."""
        headings = []
        for m, heading in zip(motions, raw, strict=True):
            right = sign * (heading - bias * (m.t - m.t[0]))
            headings.append(np.interp(m.t - late.get(by, 0.0), m.t, right))
        return tuple(headings)

    rest = inspected.rest
    if rest is None:
        drift = (turned(put("pose_yaw", 0.0)) - pose) / turned([m.t for m in motions])
        bias = sign * np.median(drift)
    else:
        bias = rest["bias"]
    delayed = put("pose_yaw", bias)
    apart = np.median(np.abs(turned(delayed) - pose))
    return GyroJudge(put("wheels", bias), delayed, apart)


def with_gyro(source: Source) -> Source:
    """Return a source with the headings of its gyro, where this is the first judge of them.

    They are as late as its own; a remark says why. A source that has them stays as it is.
    """
    if any(piece.headings is not None for piece in source.pieces):
        return source
    judge = find_gyro_judge(source)
    if judge is None or not judge.first:
        return source
    pairs = zip(source.pieces, judge.late, strict=True)
    pieces = tuple(replace(piece, headings=headings) for piece, headings in pairs)
    remarks = (*source.remarks, f"{source.title}: {judge.sentence}")
    return replace(source, pieces=pieces, remarks=remarks)
