"""Robots in motion, as scenes show them: where each is, what of it is shown, and from where all can be seen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ssmr.geometry import integral, relative, rotate_body_to_world
from ssmr.robot.localiser import Localiser
from ssmr.types import FloatArray, IndexArray, Trajectory
from validation.report.looks import looks_of
from validation.report.palette import Rgb, colour, mix
from validation.simulator.description import Robot, load_robot
from validation.simulator.terrain import FLAT, Terrain

BLACK: Rgb = (0, 0, 0)
WHITE: Rgb = (255, 255, 255)
GROUND: Rgb = (222, 225, 229)
OTHER_GROUND: Rgb = (160, 188, 214)
POSE_PERIOD = 0.02
"""Time between two poses of a robot [s]: 50 Hz is smooth to the eye."""
MOST_POSES = 45_000
"""Most poses of a robot: 50 Hz for a quarter of an hour, 6 Hz for two hours."""
MOST_SAMPLES = 45_000
"""Most samples of lines over time: twenty for each point of a screen's width."""
_FIELD_OF_VIEW = math.radians(55.0)  # of the viewer's eye, from top to bottom


@dataclass(frozen=True, eq=False)
class Track:
    """One robot of the scene, a plant or the recorded one, with its M samples of all pieces in a row."""

    name: str
    pieces: tuple[Trajectory, ...]
    reference: Track | None = None
    """The robot to compare with; None for that robot itself."""
    localiser: Localiser = Localiser()
    """The frame in the body whose poses these are."""
    terrain: Terrain = FLAT
    """Ground under the robot."""
    robot: Robot = field(default_factory=load_robot)
    """What the robot looks like, and where its wheels are."""

    @property
    def bright(self) -> Rgb:
        """Colour of the plant on a dark background, as in the viewer's plots: near-black becomes grey."""
        own = colour(self.name)
        return mix(own, WHITE, 0.55) if max(own) < 80 else own

    @cached_property
    def t(self) -> FloatArray:
        """(M,) stamps [s]."""
        return np.concatenate([p.t for p in self.pieces])

    @cached_property
    def pose(self) -> FloatArray:
        """(M, 3) poses [m, m, rad]."""
        return np.concatenate([p.pose for p in self.pieces])

    @property
    def body(self) -> FloatArray:
        """(M, 3) poses of the body's own reference point, the middle between the axles [m, m, rad]."""
        return self.localiser.body_pose(self.pose)

    @property
    def raised(self) -> FloatArray:
        """(M, 3) height [m], roll and pitch [rad]: as simulated, or as four wheels lie on the ground."""
        height, tilt = self.channel("height_m"), self.channel("roll_pitch_rad")
        if height is not None and tilt is not None:
            return np.column_stack([height, tilt])
        return self.terrain.lie(self.body, self.robot.geometry.wheelbase, self.robot.geometry.track)

    @property
    def turns(self) -> FloatArray:
        """(M, 2) angles through which the left and right wheels have turned since their piece began [rad]."""
        return np.concatenate([integral(p.t, p.wheels) for p in self.pieces])

    @cached_property
    def seen(self) -> FloatArray:
        """(M, 3) poses seen from the reference's robot [m, m, rad]."""
        return relative((self.reference or self).pose, self.pose)

    @cached_property
    def apart(self) -> FloatArray:
        """(M,) distance from the reference's robot [m]."""
        return np.hypot(self.seen[:, 0], self.seen[:, 1])

    @cached_property
    def pose_period(self) -> float:
        """Time between two poses that are shown [s]."""
        return max(POSE_PERIOD, sum(float(p.t[-1] - p.t[0]) for p in self.pieces) / MOST_POSES)

    @cached_property
    def shown(self) -> list[IndexArray]:
        """Of each piece the indices of the samples that are shown: the first in every `pose_period`, and the last."""
        slots = [np.floor((p.t - p.t[0]) / self.pose_period + 1e-6) for p in self.pieces]
        return [np.flatnonzero(np.r_[True, np.diff(s) > 0.0] | (np.arange(len(s)) == len(s) - 1)) for s in slots]

    @property
    def rows(self) -> IndexArray:
        """The indices of `shown` among all samples."""
        starts = np.cumsum([0, *(len(p.t) for p in self.pieces[:-1])])
        return np.concatenate([start + kept for start, kept in zip(starts, self.shown, strict=True)])

    def channel(self, name: str) -> FloatArray | None:
        """Return a channel over all samples; None where a piece lacks it."""
        if not all(name in p.channels for p in self.pieces):
            return None
        return np.concatenate([p.channels[name] for p in self.pieces])


class Extent:
    """Place and size of all paths, and the distance from which an eye sees them.

    Attributes:
        along: (2,) unit vector along their longest extent, from start to end.
        across: (2,) unit vector to the left of it.
        middle: (2,) middle of the extents [m].
        end: (2,) mean of the paths' ends [m].
        reach: the longest extent [m].
        distance: from where an eye sees all of it, with the robots and a margin, in a view twice as wide as high [m].
        post: how far beyond the end the signpost with the plants' names stands [m].
        scale: length or width of the robots over a Husky's, the greater ratio, by which distances around them grow.
    """

    def __init__(self, tracks: Sequence[Track]) -> None:
        xy = np.concatenate([track.pose[:, :2] for track in tracks])
        self.scale = scale = float(looks_of(tracks[0].robot).scale[:2].max())
        self.end = np.mean([track.pieces[-1].xy[-1] for track in tracks], axis=0)
        offsets = xy - xy.mean(axis=0)
        along = np.linalg.eigh(offsets.T @ offsets + np.diag([1e-9, 0.0]))[1][:, 1]  # along x where nothing moves
        self.along = along if along @ (self.end - xy[0]) >= 0.0 else -along
        self.across = rotate_body_to_world([0.0, 1.0], math.atan2(self.along[1], self.along[0]))
        frame = np.stack([self.along, self.across])
        inside = xy @ frame.T
        low, high = inside.min(axis=0), inside.max(axis=0)
        self.middle = 0.5 * (low + high) @ frame
        self.reach = float((high - low).max())
        slope = math.tan(0.5 * _FIELD_OF_VIEW)
        length, width = 0.5 * (high - low)
        beside = 0.8 * scale
        least = (length + beside) / (1.8 * slope), (0.6 * width + beside) / slope
        self.distance = max(3.0 * scale, *least) + 0.6 * float(width)
        self.post = max(beside, 0.1 * self.distance)


@dataclass(frozen=True, eq=False)
class Series:
    """Lines of one entity: k values over the same stamps. Of very many samples it keeps those that outline the lines."""

    names: Sequence[str]
    """k names, with unit."""
    colours: Sequence[Rgb]
    t: FloatArray
    """(M,) [s]."""
    values: FloatArray
    """(M,) or (M, k)."""
    held: bool = False
    """True where each value holds until the next, as commands do."""
    samples: int = field(init=False)
    """Number of samples that there were."""

    def __post_init__(self) -> None:
        """Keep what is drawn: copies, so that the rest can be forgotten."""
        kept = outline_of(self.values)
        for name, value in (("samples", len(self.t)), ("t", self.t[kept]), ("values", self.values[kept])):
            object.__setattr__(self, name, value)


@dataclass(frozen=True, eq=False)
class History:
    """Values that change from step to step of a search, not over the robots' time."""

    title: str
    timeline: str
    """Name of the timeline that counts the steps."""
    names: tuple[str, ...]
    """k names."""
    colours: tuple[Rgb, ...]
    """k colours."""
    values: FloatArray
    """(G, k), of the steps 0 to G - 1; where one is not finite, the line is interrupted."""


def outline_of(values: FloatArray, most: int = MOST_SAMPLES) -> IndexArray:
    """Return the indices of at most `most` samples that outline lines over time; all of them where there are no more.

    The least and the greatest value of every stretch are kept: the outline is that of the whole lines.

    Args:
        values: (M,) or (M, k) values of k lines.
        most: most samples, at least 2 k + 2.
    """
    table = values.reshape(len(values), -1)
    m, k = table.shape
    if m <= most:
        return np.arange(m)
    edges = np.linspace(0, m, (most - 2) // (2 * k) + 1).astype(np.intp)
    lengths, starts = np.diff(edges), edges[:-1]
    rows = np.minimum(starts[:, None] + np.arange(lengths.max()), edges[1:, None] - 1)  # shorter stretches repeat their end
    inside = table[rows]
    kept = [starts[:, None] + pick(inside, axis=1) for pick in (np.argmin, np.argmax)]
    return np.unique(np.concatenate([[0, m - 1], *(np.minimum(at, m - 1).ravel() for at in kept)])).astype(np.intp)
