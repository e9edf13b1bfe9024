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

    def pose_in(self, target: str, frame: str) -> FloatArray:
        """Return the (3,) pose of a frame in another [m, m, rad].

        Raises:
            ValueError: nothing connects them; the message names the frames that are seen.
        """
        ours = self._poses_above(frame)
        for shared, pose in self._poses_above(target).items():
            if shared in ours:
                return relative_pose(pose, ours[shared])
        seen = sorted({frame, *self._parents, *dict(self._parents.values())})
        raise ValueError(
            f"nobody says where {frame} is in {target}; frames that are seen: {', '.join(seen)}"
        )

    def _poses_above(self, frame: str) -> dict[str, FloatArray]:
        """Return the poses of a frame in itself, in its parent, and so on."""
        poses = {frame: np.zeros(3)}
        # until there is no parent, or they go in a circle
        while (link := self._parents.get(frame)) and link[0] not in poses:
            poses[link[0]] = compose_poses(link[1], poses[frame])
            frame = link[0]
        return poses
