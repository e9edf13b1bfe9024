"""The frames of a graph, as /tf tells them: which are seen, and where one lies in another."""

from __future__ import annotations

import numpy as np

from ssmr.geometry import compose_poses, relative_pose
from ssmr.types import FloatArray
from validation.ros.messages import Transform

_MOST_FRAMES = 1000
"""Frames that are remembered: whoever reaches the graph can send any number."""


class FrameTree:
    """Poses of frames in their parents, the newest of each."""

    def __init__(self) -> None:
        """Begin without a frame."""
        self._parents: dict[str, tuple[str, FloatArray]] = {}

    def take(self, transforms: list[Transform]) -> None:
        """Take poses (3,) of frames in their parents [m, m, rad]."""
        for parent, child, pose in transforms:
            if child in self._parents or len(self._parents) < _MOST_FRAMES:
                self._parents[child] = (parent, pose)

    def pose_in(self, target: str, frame: str) -> FloatArray | None:
        """Return the (3,) pose of a frame in another [m, m, rad]; None where nothing tells it."""
        ours = self._poses_above(frame)
        for shared, pose in self._poses_above(target).items():
            if shared in ours:
                return relative_pose(pose, ours[shared])
        return None

    def _poses_above(self, frame: str) -> dict[str, FloatArray]:
        """Return the poses of a frame in itself, in its parent, and so on."""
        poses = {frame: np.zeros(3)}
        pose = poses[frame]
        while frame in self._parents:
            frame, step = self._parents[frame]
            if frame in poses:
                break  # they go in a circle
            pose = compose_poses(step, pose)
            poses[frame] = pose
        return poses

    @property
    def names(self) -> set[str]:
        """The frames that are seen."""
        return {*self._parents, *(parent for parent, _ in self._parents.values())}
