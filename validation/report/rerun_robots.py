"""Robots, paths, labels and the ground of a rerun scene."""

from __future__ import annotations

import hashlib
import math
import uuid
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ssmr.geometry import integral, quat_wxyz_to_xyzw, relative, roll_pitch_yaw_to_quat_wxyz, rotate_body_to_world
from ssmr.robot.localiser import Localiser
from ssmr.types import FloatArray, IndexArray, Trajectory
from validation.report.palette import Rgb, colour, mix
from validation.report.rerun_file import TIMELINE, rr
from validation.report.robot_mesh import RobotMesh, robot_mesh, tinted, wheel_quat_wxyz
from validation.report.thinning import POSE_PERIOD, pose_period
from validation.simulator.description import WHEELS, Robot, load_robot
from validation.simulator.terrain import FLAT, Terrain
from validation.words import one_line

SOLID, GLASS, FAINT_GLASS = 255, 150, 32
"""Opacity of robots, 0-255. Those that mostly overlap the reference's are faint: solid ones would cut into each other."""
_GLASS_INSET = 0.985
"""Size of a transparent robot over the real one's: where it stands just as the reference's robot does, it hides inside."""
_FIELD_OF_VIEW = math.radians(55.0)
"""Field of view of the viewer's eye, from top to bottom [rad]."""
GRID: Rgb = (186, 191, 198)
BLACK: Rgb = (0, 0, 0)
WHITE: Rgb = (255, 255, 255)
GROUND: Rgb = (222, 225, 229)
OTHER_GROUND: Rgb = (160, 188, 214)
DOWNHILL: Rgb = (110, 90, 60)
BELOW = 0.004
"""Distance by which the ground is drawn too low, so that lines on it show [m]."""
MOST_POINTS = 200
"""Along a side of uneven ground."""
LIGHT = np.array([0.45, -0.25, 0.86])
"""Direction of the light by which uneven ground is shaded; steep light, so that low bumps show."""
SHADING = 6.0
"""Factor by which shades exaggerate a slope."""


@dataclass(frozen=True, eq=False)
class Track:
    """One robot of the scene, a plant or the recorded one, with its M samples of all pieces in a row."""

    name: str
    pieces: tuple[Trajectory, ...]
    reference: Track | None
    """The robot to compare with; None for that robot itself."""
    localiser: Localiser = Localiser()
    """The frame in the body whose poses these are."""
    terrain: Terrain = FLAT
    """Ground under the robot."""
    robot: Robot = field(default_factory=load_robot)
    """What the robot looks like, and where its wheels are."""

    @property
    def colour(self) -> Rgb:
        """Colour of the plant."""
        return colour(self.name)

    @property
    def bright(self) -> Rgb:
        """Colour on a dark background, as in the viewer's plots: near-black becomes grey."""
        return mix(self.colour, WHITE, 0.55) if max(self.colour) < 80 else self.colour

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
        return pose_period(sum(float(p.t[-1] - p.t[0]) for p in self.pieces))

    @cached_property
    def shown_of(self) -> list[IndexArray]:
        """Of each piece the indices of the samples whose pose is shown: the first in every `pose_period`, and the last."""
        slots = [np.floor((p.t - p.t[0]) / self.pose_period + 1e-6) for p in self.pieces]
        return [np.flatnonzero(np.r_[True, np.diff(s) > 0.0] | (np.arange(len(s)) == len(s) - 1)) for s in slots]

    @cached_property
    def shown(self) -> IndexArray:
        """The same indices among all samples."""
        starts = np.cumsum([0, *(len(p.t) for p in self.pieces[:-1])])
        return np.concatenate([start + kept for start, kept in zip(starts, self.shown_of, strict=True)])

    @property
    def paths(self) -> list[FloatArray]:
        """The (m, 2) points of each piece's path [m]: all of them or, where poses are thinned, those of the poses."""
        if self.pose_period == POSE_PERIOD:
            return [p.xy for p in self.pieces]
        return [p.xy[kept] for p, kept in zip(self.pieces, self.shown_of, strict=True)]

    def channel(self, name: str) -> FloatArray | None:
        """A channel over all samples; None where a piece lacks it."""
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
        self.scale = scale = float(robot_mesh(tracks[0].robot).scale[:2].max())
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


def identify(asked: object, tracks: Sequence[Track]) -> uuid.UUID:
    """Return the id of a recording: a digest of what was asked for, by its `repr`, and of the motions that came out."""
    digest = hashlib.sha256(repr(asked).encode())
    for track in tracks:
        digest.update(track.name.encode() + track.t.tobytes() + track.pose.tobytes())
    return uuid.UUID(bytes=digest.digest()[:16], version=4)


def write_signpost(recording: rr.RecordingStream, track: Track, extent: Extent, rank: int) -> None:
    """Log a robot's name beyond its end, the higher the later its rank."""
    entity = f"world/{track.name}/end"
    post = np.append(extent.end + extent.post * extent.along, 0.045 * extent.distance * (rank + 1.0))
    end = [np.append(track.pieces[-1].xy[-1], 0.01), post]
    recording.log(entity, lines([end], track.colour, 0.7), static=True)
    recording.log(f"{entity}/name", labels([post], [track.name], track.bright), static=True)


def opacity_of(robot: RobotMesh, apart: FloatArray | None) -> int:
    """Return the opacity of a robot: solid without distances from another [m], fainter the more the two overlap."""
    if apart is None:
        return SOLID
    return FAINT_GLASS if np.median(apart) < robot.box[1, 0] else GLASS


def write_robot(recording: rr.RecordingStream, entity: str, robot: RobotMesh, track: Track, opacity: int) -> None:
    """Log each body's mesh, in the robot's own colours for MuJoCo's and in shades of the plant's for others."""
    size, darkest = (1.0, 0.25) if opacity == SOLID else (_GLASS_INSET, 0.6)
    for body, mesh in robot.bodies.items():
        looks = rr.Mesh3D(
            vertex_positions=size * mesh.vertices,
            vertex_normals=mesh.normals,
            vertex_colors=mesh.colours if track.name == "mujoco" else tinted(mesh.colours, track.bright, darkest),
            albedo_factor=(*WHITE, opacity),
        )
        recording.log(f"{entity}/{body}", looks, static=True)


def write_motion(
    recording: rr.RecordingStream,
    entity: str,
    robot: RobotMesh,
    track: Track,
    pose: FloatArray,
    raised: FloatArray | None = None,
) -> None:
    """Send where the reference point is, from (M, 3) poses, and how far the wheels have turned.

    `raised` is (M, 3) height, roll and pitch [m, rad, rad] where the ground is uneven.
    """
    time, pose, turns = rr.TimeColumn(TIMELINE, duration=track.t[track.shown]), pose[track.shown], track.turns[track.shown]
    height, roll, pitch = (np.zeros_like(pose) if raised is None else raised[track.shown]).T
    translation = np.column_stack([pose[:, :2], height])
    quat_xyzw = quat_wxyz_to_xyzw(roll_pitch_yaw_to_quat_wxyz(roll, pitch, pose[:, 2]))
    recording.send_columns(entity, [time], rr.Transform3D.columns(translation=translation, quaternion=quat_xyzw))
    recording.log(f"{entity}/base", rr.Transform3D(translation=robot.places["base"]), static=True)
    for wheel in WHEELS:
        translation = np.tile(robot.places[wheel], (len(pose), 1))  # a static one would not combine with turns over time
        quat_xyzw = quat_wxyz_to_xyzw(wheel_quat_wxyz(turns[:, 0 if wheel.endswith("left") else 1]))
        columns = rr.Transform3D.columns(translation=translation, quaternion=quat_xyzw)
        recording.send_columns(f"{entity}/{wheel}", [time], columns)


def write_path(recording: rr.RecordingStream, track: Track, interval: float) -> None:
    """Log the path, one strip a piece, and a point for every `interval` [s]; the reference's points say the time."""
    first = track.reference is None
    height = 0.012 if first else 0.008
    strips = [np.column_stack([xy, height + track.terrain.height_at(xy)]) for xy in track.paths]
    recording.log(f"world/{track.name}/path", lines(strips, track.colour, 2.2 if first else 1.5), static=True)
    stamps, points = list[float](), list[list[float]]()
    for piece in track.pieces:
        for k in range(math.ceil(piece.t[0] / interval), math.floor(piece.t[-1] / interval) + 1):
            stamps.append(k * interval)
            xy = np.array([[np.interp(stamps[-1], piece.t, column) for column in piece.xy.T]])
            points.append([*xy[0], height + float(track.terrain.height_at(xy)[0])])
    if points:
        marks = rr.Points3D(points, colors=[track.colour], radii=rr.Radius.ui_points(4.0 if first else 3.0))
        recording.log(f"world/{track.name}/ticks", marks, static=True)
    if points and first:
        recording.log(f"world/{track.name}/ticks/time", labels(points, [f"{s:g} s" for s in stamps], GRID), static=True)


def round_interval(seconds: float) -> float:
    """Return the least of 1, 2, 5, 10, 20, 30, 60 s and whole minutes that is no shorter."""
    return next((float(s) for s in (1, 2, 5, 10, 20, 30, 60) if s >= seconds), 60.0 * math.ceil(seconds / 60.0))


def lines(strips: Sequence[ArrayLike], rgb: Rgb, width: float) -> rr.LineStrips3D:
    """Return line strips as wide on the screen from near and far."""
    return rr.LineStrips3D([np.asarray(strip) for strip in strips], colors=[rgb], radii=rr.Radius.ui_points(width))


def outline(robot: RobotMesh, height: float, rgb: Rgb) -> rr.LineStrips3D:
    """Return a rectangle around the robot as seen from above, with a mark where its front is."""
    z = height + 0.004
    (rear, right, _), (front, left, _) = robot.box
    around = [[front, left, z], [front, right, z], [rear, right, z], [rear, left, z], [front, left, z]]
    nose = [[front, 0.25 * left, z], [front + 0.1 * robot.scale[0], 0.0, z], [front, 0.25 * right, z]]
    return lines([around, nose], rgb, 1.2)


def labels(points: Sequence[ArrayLike], texts: Sequence[str], rgb: Rgb) -> rr.Points3D:
    """Return texts at (N, 3) points, dark: the viewer writes them on grey patches, or on white ones in its light theme."""
    texts, radii = [one_line(text) for text in texts], rr.Radius.ui_points(0.1)
    return rr.Points3D(points, labels=texts, colors=[mix(rgb, BLACK, 0.7)], radii=radii, show_labels=True)


def write_ground(recording: rr.RecordingStream, entity: str, terrain: Terrain, extent: Extent) -> None:
    """Log the ground below all paths and around them, just below the lines that are drawn on it."""
    margin = 0.5 * extent.reach + 5.0 * max(extent.scale, 1.0)
    write_patch(recording, entity, terrain, extent.middle - margin, extent.middle + margin, extent.scale)


def write_patch(
    recording: rr.RecordingStream, entity: str, terrain: Terrain, low: np.ndarray, high: np.ndarray, scale: float = 1.0
) -> None:
    """Log the ground between two corners [m], with what is drawn on it for robots of that size over a Husky's."""
    if terrain.kind == "rough":
        recording.log(entity, _uneven(terrain, low, high), static=True)
        return
    corners = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
    recording.log(entity, _sheet(corners, -BELOW, GROUND), static=True)
    if terrain.kind == "split":
        reach = float(np.hypot(*(high - low)))
        along = np.array([math.cos(terrain.edge_heading), math.sin(terrain.edge_heading)])
        right = np.array([along[1], -along[0]])
        middle = 0.5 * (low + high)
        start = middle + (-terrain.edge_offset - middle @ right) * right
        half = [start - 0.5 * reach * along, start - 0.5 * reach * along + 0.5 * reach * right]
        half += [start + 0.5 * reach * along + 0.5 * reach * right, start + 0.5 * reach * along]
        recording.log(f"{entity}/other", _sheet(half, -0.5 * BELOW, OTHER_GROUND), static=True)
    if terrain.kind == "ramp" and terrain.slope > 0.0:
        downhill = -np.array([math.cos(terrain.toward), math.sin(terrain.toward), 0.0])
        words, origin = f"downhill, {math.degrees(terrain.slope):g}°", [0.0, 0.0, 0.02]
        vector, radius = 1.2 * scale * downhill, 0.02 * scale
        arrow = rr.Arrows3D(origins=[origin], vectors=[vector], colors=[DOWNHILL], radii=[radius], labels=[words])
        recording.log(f"{entity}/downhill", arrow, static=True)


def _sheet(corners: list, z: float, rgb: Rgb) -> rr.Mesh3D:
    return rr.Mesh3D(
        vertex_positions=[(float(x), float(y), z) for x, y in corners],
        triangle_indices=[(0, 1, 2), (0, 2, 3)],
        vertex_normals=[(0.0, 0.0, 1.0)] * 4,
        vertex_colors=[rgb] * 4,
    )


def _uneven(terrain: Terrain, low: np.ndarray, high: np.ndarray) -> rr.Mesh3D:
    """A net over the ground, shaded by its slopes, which would hardly show at their true size."""
    n = [int(min(MOST_POINTS, max(2, math.ceil((b - a) / (0.2 * terrain.length))))) for a, b in zip(low, high, strict=True)]
    x, y = (np.linspace(a, b, k) for a, b, k in zip(low, high, n, strict=True))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    surface = terrain.surface.at(points)
    normals = np.column_stack([-SHADING * surface[:, 1:], np.ones(len(points))])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    shade = np.clip(normals @ LIGHT / LIGHT[2], 0.55, 1.12)
    corner = (np.arange(n[1] - 1)[:, None] * n[0] + np.arange(n[0] - 1)).reshape(-1)
    triangles = np.vstack([
        np.column_stack([corner, corner + 1, corner + n[0] + 1]),
        np.column_stack([corner, corner + n[0] + 1, corner + n[0]]),
    ])  # fmt: skip
    return rr.Mesh3D(
        vertex_positions=np.column_stack([points, surface[:, 0] - BELOW]),
        triangle_indices=triangles,
        vertex_normals=np.tile([0.0, 0.0, 1.0], (len(points), 1)),
        vertex_colors=np.clip(shade[:, None] * np.array(GROUND), 0, 255).astype(np.uint8),
    )
