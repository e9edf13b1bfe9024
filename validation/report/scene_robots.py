"""Robots in motion, as scenes show them: their looks, their places, and the extent of all."""
# pyright: reportAttributeAccessIssue=false
# (mujoco's compiled modules have no type stubs)

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import NamedTuple

import mujoco
import numpy as np

from ssmr.geometry import integrate_rates, relative_pose, wrap_angle
from ssmr.robot.localiser import Localiser
from ssmr.types import FloatArray, IndexArray, Trajectory
from validation.descriptions.loading import load_robot
from validation.report.palette import BLACK, WHITE, Rgb, mix_colours, plant_colour
from validation.simulator.composing import VISUAL_GROUP, compose_robot
from validation.simulator.description import WHEELS, Robot
from validation.simulator.terrain import FLAT, Terrain

GROUND: Rgb = (222, 225, 229)
"""Colour of the ground."""
POSE_PERIOD = 0.02
"""Time between two poses of a robot [s]: 50 Hz is smooth to the eye."""
MOST_SAMPLES = 45_000
"""Samples of a line over time, at most: twenty for each point of a screen's width."""
MOST_POSES = 45_000
"""Most poses of a robot: 50 Hz for a quarter of an hour, 6 Hz for two hours."""
_HUSKY_SIZE = (0.984, 0.689)
"""Length and width of a Husky, for which distances in scenes are given [m]."""


class _Looks:
    """The bodies of a robot that stands at the origin, with wheels that have not turned."""

    solids: dict[str, dict[str, list[list[FloatArray]]]]
    """Solids of `base` and of the four wheels, in the frame of the body, by their kind: `cylinder`,
    which stands along its own z, or `box`, which stands for all other shapes. Each has (3,) half
    lengths, or radius and half length [m], (3,) middle [m], (4,) orientation, w first, and (4,)
    colour and opacity, 0 to 1."""
    places: dict[str, FloatArray]
    """(3,) of each body, seen from the reference point on the ground below the middle between the
    axles [m]."""
    size: FloatArray
    """(3,) length, width and height of the robot [m]."""

    def __init__(self, robot: Robot) -> None:
        """Take the visual solids of a robot's MuJoCo model."""
        model = compose_robot(robot).compile()
        base = -np.array(model.site("reference").pos)
        self.places = {"base": base} | {wheel: base + model.body(wheel).pos for wheel in WHEELS}
        self.solids = {name: {} for name in self.places}
        low = np.full(3, np.inf)
        high = np.full(3, -np.inf)
        for g in np.flatnonzero(model.geom_group == VISUAL_GROUP):
            body = model.body(model.geom_bodyid[g]).name
            flat = np.empty(9)
            mujoco.mju_quat2Mat(flat, model.geom_quat[g])
            rotation = flat.reshape(3, 3)
            middle, half = np.split(model.geom_aabb[g], 2)
            middle = model.geom_pos[g] + rotation @ middle
            kind = "box"
            size = half
            if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_CYLINDER:
                kind = "cylinder"
                size = model.geom_size[g]
            numbers = (size, middle, model.geom_quat[g], model.geom_rgba[g])
            solid = [np.array(v, dtype=np.float64) for v in numbers]
            self.solids[body].setdefault(kind, []).append(solid)
            reach = np.abs(rotation) @ half
            low = np.minimum(low, self.places[body] + middle - reach)
            high = np.maximum(high, self.places[body] + middle + reach)
        self.size = high - low

    @property
    def scale(self) -> float:
        """Length or width of the robot over a Husky's, the greater ratio.

        Distances around the robot grow by it.
        """
        return (self.size[:2] / _HUSKY_SIZE).max()


looks_of = lru_cache(maxsize=8)(_Looks)
"""The looks of a robot, which are made once."""


@dataclass(frozen=True, eq=False)
class Track:
    """One robot of the scene, a plant or the recorded one.

    Its M samples are those of all pieces in a row.
    """

    name: str
    pieces: tuple[Trajectory, ...]
    reference: Track | None = None
    """The robot to compare with; None for that robot itself."""
    localiser: Localiser = Localiser()
    """The frame in the body whose poses these are."""
    terrain: Terrain = FLAT
    """Ground under the robot."""
    robot: Robot = field(default_factory=load_robot)
    """Description of the robot: its looks, and where its wheels are."""

    @cached_property
    def t(self) -> FloatArray:
        """(M,) stamps [s]."""
        return _join_signals([p.t for p in self.pieces])

    @cached_property
    def pose(self) -> FloatArray:
        """(M, 3) poses [m, m, rad]."""
        return _join_signals([p.pose for p in self.pieces])

    @property
    def body(self) -> FloatArray:
        """(M, 3) poses of the body's reference point, the middle between the axles [m, m, rad]."""
        return self.localiser.body_pose(self.pose)

    @property
    def turns(self) -> FloatArray:
        """(M, 2) turns of the left and right wheels since their piece began [rad]."""
        return np.concatenate([integrate_rates(p.t, p.wheels) for p in self.pieces])

    @property
    def errors(self) -> tuple[FloatArray, FloatArray]:
        """(M,) distances from the reference's robot [m], and (M,) differences of heading [rad]."""
        x, y, turn = relative_pose((self.reference or self).pose, self.pose).T
        return np.hypot(x, y), wrap_angle(turn)

    @cached_property
    def shown(self) -> list[IndexArray]:
        """Indices of the samples of each piece that are shown.

        These are the first in every 20 ms or more, and the last.
        """
        period = max(POSE_PERIOD, sum(p.t[-1] - p.t[0] for p in self.pieces) / MOST_POSES)
        shown = []
        for piece in self.pieces:
            # 1e-6: a stamp on the border of two slots belongs to the later one
            slots = np.floor((piece.t - piece.t[0]) / period + 1e-6)
            first = np.r_[True, np.diff(slots) > 0.0]
            first[-1] = True
            shown.append(np.flatnonzero(first))
        return shown

    @property
    def rows(self) -> IndexArray:
        """The indices of `shown` among all samples."""
        rows = []
        start = 0
        for piece, shown in zip(self.pieces, self.shown, strict=True):
            rows.append(start + shown)
            start += len(piece.t)
        return np.concatenate(rows)

    def channel(self, name: str) -> FloatArray | None:
        """Return a channel over all samples; None where a piece lacks it."""
        if not all(name in p.channels for p in self.pieces):
            return None
        return _join_signals([p.channels[name] for p in self.pieces])


def _join_signals(parts: Sequence[FloatArray]) -> FloatArray:
    """Return parts in a row; one alone is not copied."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def bright_colour(name: str) -> Rgb:
    """Return the colour of a plant in the figures, or grey where near-black would not show."""
    rgb = plant_colour(name)
    if max(rgb) < 80:
        return mix_colours(rgb, WHITE, 0.5)
    return rgb


class Series(NamedTuple):
    """Lines of one entity: k values over the same stamps."""

    names: Sequence[str]
    """k names."""
    unit: str
    """Symbol of their unit."""
    colours: Sequence[Rgb]
    t: FloatArray
    """(M,) [s]."""
    values: FloatArray
    """(M,) or (M, k)."""
    held: bool = False
    """True where each value holds until the next, as commands do."""

    def thinned(self) -> Series:
        """Return a copy of the samples that are shown, fewer where there are very many."""
        every = slice(None, None, math.ceil(len(self.t) / MOST_SAMPLES))
        return self._replace(t=self.t[every].copy(), values=self.values[every].copy())


Plots = dict[str, Series]
"""Lines over time by entity, such as `speed/mujoco`."""


def shades_of(ink: Rgb) -> list[Rgb]:
    """Return a paler and a darker shade of a colour, for the left and the right side."""
    return [mix_colours(ink, WHITE, 0.35), mix_colours(ink, BLACK, 0.25)]


class Extent:
    """Place and size of all paths."""

    middle: FloatArray
    """(2,) middle of all positions [m]."""
    along: FloatArray
    """(2,) unit vector from the start to the ends, along x where nothing moves."""
    reach: float
    """The longest extent [m]."""
    scale: float
    """Size of the robots over a Husky's."""
    distance: float
    """Distance from which an eye sees all paths [m]."""

    def __init__(self, tracks: Sequence[Track]) -> None:
        """Measure robots in motion."""
        xy = np.concatenate([track.pose[:, :2] for track in tracks])
        low = xy.min(axis=0)
        high = xy.max(axis=0)
        first = tracks[0]
        way = np.mean([track.pose[-1, :2] for track in tracks], axis=0) - first.pose[0, :2]
        # robots that turn on the spot have no direction
        length = np.hypot(*way)
        self.middle = 0.5 * (low + high)
        self.along = way / length if length > 1e-6 else np.array([1.0, 0.0])
        self.reach = (high - low).max()
        self.scale = looks_of(first.robot).scale
        self.distance = max(3.0 * self.scale, 0.9 * self.reach)
