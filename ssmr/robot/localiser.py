"""The localiser of a log: which point and heading of the robot it tells, and how late.

A localiser, such as lidar odometry or motion capture, sits somewhere on the robot and looks some
way; its position and its heading may be filtered differently and so come with different delays. A
prediction is compared with a log only after the robot's motion has been seen in the same way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ssmr.geometry import (
    compose_poses,
    invert_pose,
    rotate_body_to_world,
    rotate_world_to_body,
    shift_state,
)
from ssmr.parameters import check_parameters, parameter
from ssmr.types import FloatArray, State, Trajectory


@dataclass(frozen=True)
class Localiser:
    """A frame that is fixed to the robot's body, whose pose a log tells with delays."""

    tracked_x: float = parameter(
        0.0, unit="m", low=-10.0, high=10.0, search=(-1.56, 1.56), of="half_wheelbase"
    )
    """Place of the tracked point ahead of the body's reference point [m]."""
    tracked_y: float = parameter(
        0.0, unit="m", low=-10.0, high=10.0, search=(-0.7, 0.7), of="half_track"
    )
    """Place of the tracked point to the left of the body's reference point [m]."""
    tracked_yaw: float = parameter(0.0, unit="rad", low=-3.2, high=3.2, search=(-0.3, 0.3))
    """Heading of the tracked frame in the body [rad]; a lidar that looks a little to the left has a
    positive one."""
    position_late: float = parameter(0.0, unit="s", low=-2.0, high=2.0, search=(-1.0, 1.0))
    """Delay of the positions behind the motion that the plant is driven with [s]: the log's wheels,
    or its commands with the plant's own delay. Negative where positions are early, because the
    wheels are logged late."""
    yaw_late: float = parameter(0.0, unit="s", low=-2.0, high=2.0, search=(-1.0, 1.0))
    """Delay of the headings behind the same motion [s]."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_parameters(self)

    @property
    def point(self) -> tuple[float, float]:
        """Return the tracked point (x, y) in the body [m]."""
        return self.tracked_x, self.tracked_y

    def body_state(self, seen: State) -> State:
        """Return the state of the body whose tracked frame has the state `seen`."""
        v_x, v_y = rotate_body_to_world([seen.v_x, seen.v_y], self.tracked_yaw)
        turned = replace(seen, yaw=seen.yaw - self.tracked_yaw, v_x=float(v_x), v_y=float(v_y))
        return shift_state(turned, (-self.tracked_x, -self.tracked_y))

    def body_pose(self, seen: ArrayLike) -> FloatArray:
        """Return (..., 3) poses of the body from those of the tracked frame."""
        return compose_poses(seen, invert_pose((*self.point, self.tracked_yaw)))

    def body_twist(self, seen: ArrayLike) -> FloatArray:
        """Return (..., 3) twists v_x, v_y, yaw rate of the body from those of the tracked frame."""
        twist = np.asarray(seen, dtype=np.float64)
        velocity = rotate_body_to_world(twist[..., :2], self.tracked_yaw)
        lever = twist[..., 2:] * np.array([-self.tracked_y, self.tracked_x])
        return np.concatenate([velocity - lever, twist[..., 2:]], axis=-1)

    def seen_pose(self, body: ArrayLike) -> FloatArray:
        """Return (..., 3) poses of the tracked frame from those of the body."""
        return compose_poses(body, (*self.point, self.tracked_yaw))

    def logged_poses(
        self, body: FloatArray, period: float, t: FloatArray | None = None
    ) -> FloatArray:
        """Return the poses that the log tells of a body which moves in a line between samples.

        Args:
            body: (N, 3) poses of the body.
            period: time between them [s].
            t: (M,) stamps of the log [s], the first of which is that of the first pose; None: the
                poses' own.

        Returns:
            (M, 3) poses of the tracked frame. A log may begin while the robot drives: before the
            first pose and after the last the body goes on as there.
        """
        clock = period * np.arange(len(body), dtype=np.float64)
        return self._late_poses(body, clock, clock if t is None else t - t[0])

    def _late_poses(self, body: FloatArray, clock: FloatArray, stamps: FloatArray) -> FloatArray:
        """Return (M, 3) poses at stamps of a log, of a body's at a clock, see `logged_poses`."""
        table = np.column_stack([clock, body])
        # ten thousand samples beyond its ends, longer than any delay, it moves as it did there
        ends = table[[0, -1]]
        ends += 1e4 * (ends - table[[1, -2]])
        clock, *columns = np.vstack([ends[:1], table, ends[1:]]).T

        def at(late: float) -> FloatArray:
            return np.column_stack([np.interp(stamps - late, clock, column) for column in columns])

        pose = self.seen_pose(at(self.position_late))
        if self.yaw_late != self.position_late:
            pose[:, 2] = at(self.yaw_late)[:, 2] + self.tracked_yaw
        return pose

    def seen(self, motion: Trajectory, t: ArrayLike | None = None) -> Trajectory:
        """Return a body's motion as the log tells it.

        Args:
            motion: the body's motion.
            t: (M,) stamps of the log [s], the first of which is that of the motion's first sample;
                None: the motion's own.

        Returns:
            The motion of the tracked frame at these stamps, linear between samples. Only the pose
            is late, see `logged_poses`.
        """
        stamps = motion.t if t is None else np.asarray(t, dtype=np.float64)
        clock = motion.t if t is None else motion.t + stamps[0]
        signals = [motion.pose, motion.twist, motion.wheels, *motion.channels.values()]
        table = self.seen_table(np.column_stack(signals), clock, stamps)
        columns = dict[str, slice | int]()
        first = 8
        for name, values in motion.channels.items():
            stop = first + values[0].size
            columns[name] = first if values.ndim == 1 else slice(first, stop)
            first = stop
        return Trajectory.of_table(stamps, table, columns)

    def seen_table(self, rows: FloatArray, clock: FloatArray, t: FloatArray) -> FloatArray:
        """Return (M, k) numbers of a body's motion as the log tells them at its stamps, see `seen`.

        Args:
            rows: (m, k) samples, the fields of a `State` first.
            clock: (m,) stamps of the samples [s].
            t: (M,) stamps of the log [s].
        """
        lever = rows[:, 5:6] * np.array([-self.tracked_y, self.tracked_x])
        velocity = rotate_world_to_body(rows[:, 3:5] + lever, self.tracked_yaw)
        told = [np.interp(t, clock, column) for column in (*velocity.T, *rows[:, 5:].T)]
        return np.column_stack([self._late_poses(rows[:, :3], clock, t), *told])
