"""The recording sink: a comparison as a rerun file that carries its own layout, to be played back and looked into.

Everything is in metres, seconds and radians, z up, on the timeline `sim_time`:

- `world/<plant>/robot`: the reference point on the ground over time; below it `base` and the four wheels, a mesh each;
- `world/<plant>/path`, `.../ticks`, `.../end`: the whole path, where the plant was at round times, its name where it ends;
- `lineup/<plant>/robot`: the same robots abreast, each displaced from its place as it is from the reference's robot;
- `plots/<quantity>/<plant>`: what is drawn over time;
- `report`: the report as text.
"""

from __future__ import annotations

import hashlib
import logging
import math
import os
import subprocess
import sys
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssmr.geometry import quat_wxyz_to_xyzw, relative, rotate_body_to_world, shift_reference, wrap_angle, yaw_to_quat_wxyz
from ssmr.types import Commands, FloatArray, Trajectory
from validation.husky import WHEELS, xml_path
from validation.palette import Rgb, colour, mix
from validation.results import Comparison
from validation.robot_mesh import BodyMesh, body_mesh, tinted

os.environ.setdefault("RERUN_ANALYTICS", "false")  # rerun looks at it when it is imported

import rerun as rr  # noqa: E402
import rerun.blueprint as rrb  # noqa: E402

logger = logging.getLogger(__name__)

APPLICATION = "ssmr-testbed"
TIMELINE = "sim_time"

GHOST_INSET = 0.985
"""A transparent robot's size over the real one's: where it stands in the same place as the reference's, it vanishes inside."""
POSE_PERIOD = 0.02
"""Time between two poses of a robot [s]: 50 Hz is smooth to the eye. Series keep every sample."""
GLASS, TINTED_GLASS = 32, 150
"""Opacity, 0-255, in the scene of a robot that mostly overlaps the reference's, where solid ones would cut into each other, and
of one that mostly does not."""
LEGEND_SHARE = 0.4
"""Room right of the plots, over their duration, so that legends hide no line."""
LANE = 1.25
ROW = 1.75
ABREAST = 3
"""The line-up: distance between neighbours and between rows [m], and robots in a row."""
FIELD_OF_VIEW = math.radians(55.0)
"""Of the viewer's eye, from top to bottom [rad]."""

SKY: Rgb = (238, 240, 243)
GROUND: Rgb = (222, 225, 229)
GRID: Rgb = (186, 191, 198)
DARK: Rgb = (70, 74, 80)

Placed = tuple[FloatArray, BodyMesh]


@dataclass(frozen=True, eq=False)
class _Track:
    """One robot of the scene: a plant, or the recorded one."""

    name: str
    pieces: tuple[Trajectory, ...]
    is_reference: bool

    @property
    def colour(self) -> Rgb:
        return colour(self.name)

    @property
    def line_colour(self) -> Rgb:
        """Its colour on the viewer's plots, which are dark or bright as the user likes: near-black becomes grey."""
        return mix(self.colour, (255, 255, 255), 0.55) if max(self.colour) < 80 else self.colour

    @property
    def t(self) -> FloatArray:
        """(M,) stamps of all pieces [s]."""
        return np.concatenate([p.t for p in self.pieces])

    @property
    def pose(self) -> FloatArray:
        """(M, 3) poses of all pieces."""
        return np.concatenate([p.pose for p in self.pieces])

    @property
    def spin(self) -> FloatArray:
        """(M, 2) angles through which the left and right wheels have turned [rad]: the integral of their rates over each piece."""
        return np.concatenate([_integral(p.t, p.wheels) for p in self.pieces])


def write_recording(comparison: Comparison, path: Path, report_markdown: str) -> None:
    """Write a comparison as a rerun recording, whole or not at all.

    The recording's id is a digest of what was asked for and of the motions that came out, so that a run that is repeated compares
    equal, and two that differ can be opened in one viewer.

    Args:
        comparison: what to show.
        path: the file, `.rrd`; one that is there already is replaced.
        report_markdown: the report, in markdown.

    Raises:
        OSError: the file cannot be written.
        RuntimeError: rerun is switched off (`RERUN=off`), or refused what it was given.
    """
    data = _encoded(comparison, report_markdown)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        partial.write_bytes(data)
        os.replace(partial, path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def open_viewer(path: Path) -> bool:
    """Open a recording in rerun's own viewer, which listens on the loopback interface alone; return at once.

    Args:
        path: the recording.

    Returns:
        Whether a viewer was started; if not, the log says why and what to do.
    """
    by_hand = f"open it on a machine with a screen: rerun {path}"
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        logger.warning("there is no display for the rerun viewer; %s", by_hand)
        return False
    command = [sys.executable, "-m", "rerun", str(path), "--bind", "127.0.0.1", "--port", "auto"]
    try:
        viewer = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
    except OSError as error:
        logger.warning("the rerun viewer cannot be started (%s); %s", error, by_hand)
        return False
    try:
        status = viewer.wait(VIEWER_GRACE)
    except subprocess.TimeoutExpired:
        return True
    if status != 0:
        logger.warning("the rerun viewer ended at once with status %d; %s", status, by_hand)
    return status == 0


VIEWER_GRACE = 3.0
"""A viewer that cannot open its window has given up by then [s]."""


def _encoded(comparison: Comparison, report_markdown: str) -> bytes:
    """The whole recording as the bytes of a file."""
    tracks = _tracks(comparison)
    recording = rr.RecordingStream(APPLICATION, recording_id=_identity(comparison, tracks), send_properties=False)
    if not recording.is_enabled():
        raise RuntimeError("rerun is switched off; unset the environment variable RERUN to write recordings")
    stream = recording.binary_stream()
    with _strict():
        recording.send_blueprint(_layout(comparison, tracks), make_active=False, make_default=True)
        _write_properties(recording, comparison)
        recording.log("report", rr.TextDocument(report_markdown, media_type=rr.MediaType.MARKDOWN), static=True)
        _write_scene(recording, tracks)
        _write_plots(recording, comparison, tracks)
    data = stream.read()
    if not data:
        raise RuntimeError("rerun encoded nothing")
    return data


@contextmanager
def _strict() -> Iterator[None]:
    """Within, rerun raises where it would warn and leave something out."""
    before = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        yield
    finally:
        rr.set_strict_mode(before)


def _tracks(comparison: Comparison) -> list[_Track]:
    """All robots, the reference first."""
    reference = comparison.reference_name
    others = [_Track(name, result.pieces, False) for name, result in comparison.plants.items() if name != reference]
    return [_Track(reference, comparison.reference, True), *others]


def _identity(comparison: Comparison, tracks: Sequence[_Track]) -> uuid.UUID:
    asked = (comparison.source, comparison.profile, comparison.reference_name, comparison.seed, sorted(comparison.options.items()))
    digest = hashlib.sha256(repr(asked).encode())
    for track in tracks:
        digest.update(track.name.encode() + track.t.tobytes() + track.pose.tobytes())
    return uuid.UUID(bytes=digest.digest()[:16], version=4)


def _write_properties(recording: rr.RecordingStream, comparison: Comparison) -> None:
    recording.send_recording_name(f"{comparison.source}, profile {comparison.profile}")
    about = {
        "source": comparison.source,
        "profile": comparison.profile,
        "reference": comparison.reference_name,
        "seed": comparison.seed,
    }
    recording.send_property("comparison", rr.AnyValues(**about))
    for name, values in (("options", comparison.options), ("versions", comparison.versions)):
        if values:
            recording.send_property(name, rr.AnyValues(**{key: str(value) for key, value in values.items()}))


# --- the scene ---------------------------------------------------------------------------------------------------------------


def _integral(t: FloatArray, rate: FloatArray) -> FloatArray:
    """(M, k) integral of (M, k) rates over (M,) stamps from the first one on, by trapezoids."""
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(t)[:, None]
    return np.concatenate([np.zeros((1, rate.shape[1])), np.cumsum(steps, axis=0)])


def spin_quat_wxyz(angle: ArrayLike) -> FloatArray:
    """(..., 4) unit quaternions, w first, of rotations by (...) angles [rad] about y, the wheels' axle: positive rolls forward."""
    half = 0.5 * np.asarray(angle, dtype=np.float64)
    zero = np.zeros_like(half)
    return np.stack([np.cos(half), zero, np.sin(half), zero], axis=-1)


def _shown(t: FloatArray) -> NDArray[np.intp]:
    """Indices of the stamps that are shown: about every `POSE_PERIOD`, the first of each and the last."""
    slot = np.floor((t - t[0]) / POSE_PERIOD + 1e-6)
    return np.flatnonzero(np.r_[True, np.diff(slot) > 0.0] | (np.arange(len(t)) == len(t) - 1))


def _robot() -> dict[str, Placed]:
    """Each body's place [m], seen from the reference point on the ground below the middle between the axles, and its mesh."""
    model = mujoco.MjModel.from_xml_path(str(xml_path()))
    above = -model.site("reference").pos
    meshes = {name: body_mesh(model, name) for name in ("base", *WHEELS)}
    return {name: (above if name == "base" else above + mesh.position, mesh) for name, mesh in meshes.items()}


def _write_scene(recording: rr.RecordingStream, tracks: Sequence[_Track]) -> None:
    robot = _robot()
    scene = _Extent.of(tracks)
    recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    recording.log("world/ground", _slab(scene.low - 0.5 * scene.size - 5.0, scene.high + 0.5 * scene.size + 5.0), static=True)
    recording.log("lineup/ground", _slab(np.array([-50.0, -50.0]), np.array([50.0, 50.0])), static=True)
    interval = _round_interval(scene.duration / 8.0)
    length, width, height = _size(robot)
    for rank, track in enumerate(tracks):
        t, place = track.t, _place(rank, len(tracks))
        shown = np.concatenate([first + _shown(p.t) for first, p in zip(_firsts(track.pieces), track.pieces, strict=True)])
        time = rr.TimeColumn(TIMELINE, duration=t[shown])
        spin, seen = track.spin[shown], relative(tracks[0].pose, track.pose)
        seen[:, 2] = wrap_angle(seen[:, 2])
        for tree, pose, opacity in (
            (f"world/{track.name}", track.pose[shown], _opacity(track, tracks[0], length)),
            (f"lineup/{track.name}", seen[shown] + place, 255),
        ):
            _write_robot(recording, f"{tree}/robot", robot, track, opacity)
            _write_motion(recording, f"{tree}/robot", robot, time, pose, spin)
        _write_outline(recording, f"world/{track.name}/robot/outline", np.array([0.0, 0.0, height]), length, width, track.colour)
        _write_path(recording, track, interval)
        _write_end(recording, track, scene, rank)
        _write_outline(recording, f"lineup/{track.name}/place", place, length, width, DARK)
        name = f"{track.name} (reference)" if track.is_reference else track.name
        recording.log(f"lineup/{track.name}/name", _labels([place + [0.3, 0.0, 0.62]], [name], track.colour), static=True)


def _firsts(pieces: Sequence[Trajectory]) -> list[int]:
    """The index of each piece's first sample among the samples of all."""
    return [0, *np.cumsum([len(p) for p in pieces])[:-1].tolist()]


def _place(rank: int, count: int) -> FloatArray:
    """(3,) place of a robot in the line-up [m]: at most three abreast, from the left, later rows ahead."""
    row, column = divmod(rank, ABREAST)
    abreast = min(count - row * ABREAST, ABREAST)
    return np.array([ROW * row, LANE * (0.5 * (abreast - 1) - column), 0.0])


def _size(robot: Mapping[str, Placed]) -> tuple[float, float, float]:
    """Length, width and height of the robot [m]."""
    corners = np.concatenate([place + mesh.vertices for place, mesh in robot.values()])
    length, width, _ = np.ptp(corners, axis=0)
    return float(length), float(width), float(corners[:, 2].max())


def _opacity(track: _Track, reference: _Track, length: float) -> int:
    if track.is_reference:
        return 255
    apart = np.hypot(*(track.pose - reference.pose)[:, :2].T)
    return GLASS if np.median(apart) < 0.5 * length else TINTED_GLASS


def _write_outline(recording: rr.RecordingStream, entity: str, centre: FloatArray, length: float, width: float, rgb: Rgb) -> None:
    """Log a rectangle around the robot seen from above, with a mark where its front is."""
    x, y = 0.5 * length, 0.5 * width
    around = np.array([[x, y], [x, -y], [-x, -y], [-x, y], [x, y]])
    nose = np.array([[x, 0.25 * y], [x + 0.1, 0.0], [x, -0.25 * y]])
    strips = [centre + np.column_stack([strip, np.full(len(strip), 0.004)]) for strip in (around, nose)]
    recording.log(entity, rr.LineStrips3D(strips, colors=[rgb], radii=rr.Radius.ui_points(1.2)), static=True)


def _write_robot(recording: rr.RecordingStream, entity: str, robot: Mapping[str, Placed], track: _Track, opacity: int) -> None:
    """Log each body's mesh once."""
    inset = 1.0 if opacity == 255 else GHOST_INSET
    for body, (_, mesh) in robot.items():
        colours = mesh.colours
        if track.name != "mujoco":
            colours = tinted(mesh.colours, track.colour, darkest=0.25 if opacity == 255 else 0.6)
        looks = rr.Mesh3D(
            vertex_positions=inset * mesh.vertices, vertex_normals=mesh.normals, vertex_colors=colours, albedo_factor=[255, 255, 255, opacity]
        )
        recording.log(f"{entity}/{body}", looks, static=True)


def _write_motion(
    recording: rr.RecordingStream, entity: str, robot: Mapping[str, Placed], time: rr.TimeColumn, pose: FloatArray, spin: FloatArray
) -> None:
    """Send (M, 3) poses of the reference point and (M, 2) angles of the left and right wheels."""
    translation = np.column_stack([pose[:, :2], np.zeros(len(pose))])
    quat_xyzw = quat_wxyz_to_xyzw(yaw_to_quat_wxyz(pose[:, 2]))
    recording.send_columns(entity, [time], rr.Transform3D.columns(translation=translation, quaternion=quat_xyzw))
    recording.log(f"{entity}/base", rr.Transform3D(translation=robot["base"][0]), static=True)
    for wheel in WHEELS:
        quat_xyzw = quat_wxyz_to_xyzw(spin_quat_wxyz(spin[:, 0 if wheel.endswith("left") else 1]))
        place = np.tile(robot[wheel][0], (len(spin), 1))
        recording.send_columns(f"{entity}/{wheel}", [time], rr.Transform3D.columns(translation=place, quaternion=quat_xyzw))


def _write_path(recording: rr.RecordingStream, track: _Track, interval: float) -> None:
    """Log the path, one strip a piece, and a point for every `interval` [s]; the reference's points say the time."""
    height, width = (0.012, 2.2) if track.is_reference else (0.008, 1.5)
    strips = [np.column_stack([p.xy, np.full(len(p), height)]) for p in track.pieces]
    recording.log(
        f"world/{track.name}/path",
        rr.LineStrips3D(strips, colors=[track.colour], radii=rr.Radius.ui_points(width)),
        static=True,
    )
    stamps, points = list[float](), list[tuple[float, float, float]]()
    for piece in track.pieces:
        at = np.arange(math.ceil(piece.t[0] / interval), math.floor(piece.t[-1] / interval) + 1) * interval
        stamps += at.tolist()
        points += [(np.interp(s, piece.t, piece.pose[:, 0]), np.interp(s, piece.t, piece.pose[:, 1]), height) for s in at]
    if points:
        marks = rr.Points3D(points, colors=[track.colour], radii=rr.Radius.ui_points(4.0 if track.is_reference else 3.0))
        recording.log(f"world/{track.name}/ticks", marks, static=True)
        if track.is_reference:
            recording.log(f"world/{track.name}/ticks/time", _labels(points, [f"{s:g} s" for s in stamps], GRID), static=True)


def _write_end(recording: rr.RecordingStream, track: _Track, scene: _Extent, row: int) -> None:
    """Log the plant's name on a signpost beside the ends of the paths, with a line from its own end."""
    end = np.append(track.pieces[-1].xy[-1], 0.012)
    post = np.append(scene.end + 0.1 * scene.distance * scene.along, 0.045 * scene.distance * (row + 1.0))
    lead = rr.LineStrips3D([[end, post]], colors=[track.colour], radii=rr.Radius.ui_points(0.7))
    recording.log(f"world/{track.name}/end", lead, static=True)
    recording.log(f"world/{track.name}/end/name", _labels([post], [track.name], track.colour), static=True)


def _labels(points: ArrayLike, texts: Sequence[str], rgb: Rgb) -> rr.Points3D:
    """Texts at (N, 3) points, bright, as the viewer writes them on dark patches."""
    return rr.Points3D(points, labels=texts, colors=[mix(rgb, (255, 255, 255), 0.6)], radii=rr.Radius.ui_points(0.1), show_labels=True)


def _slab(low: FloatArray, high: FloatArray) -> rr.Mesh3D:
    """The ground between two corners, just below the lines that are drawn on it."""
    z = -0.004
    corners = [(low[0], low[1], z), (high[0], low[1], z), (high[0], high[1], z), (low[0], high[1], z)]
    return rr.Mesh3D(
        vertex_positions=corners, triangle_indices=[(0, 1, 2), (0, 2, 3)], vertex_normals=[(0, 0, 1)] * 4, vertex_colors=[GROUND] * 4
    )


def _round_interval(seconds: float) -> float:
    """The least of 1, 2, 5, 10, 20, 30, 60 s and whole minutes that is no shorter."""
    return next((float(s) for s in (1, 2, 5, 10, 20, 30, 60) if s >= seconds), 60.0 * math.ceil(seconds / 60.0))


@dataclass(frozen=True, eq=False)
class _Extent:
    """Where and how large the scene is, as a camera must know."""

    low: FloatArray
    """(2,) corner of the box around all paths [m]."""
    high: FloatArray
    """(2,) opposite corner [m]."""
    end: FloatArray
    """(2,) mean of the paths' ends [m]."""
    along: FloatArray
    """(2,) unit vector along the paths, from their start to their end."""
    half_length: float
    """Half the extent along that [m]."""
    half_width: float
    """Half the extent across it [m]."""
    middle: FloatArray
    """(2,) middle of the extents [m]."""
    duration: float
    """From the first stamp to the last [s]."""

    @property
    def size(self) -> float:
        """The larger extent [m]."""
        return 2.0 * max(self.half_length, self.half_width)

    @property
    def distance(self) -> float:
        """How far off an eye sees all of it, with the robots and a margin, in a view twice as wide as high [m]."""
        slope = math.tan(0.5 * FIELD_OF_VIEW)
        return max((self.half_length + 0.6) / (1.8 * slope), (0.6 * self.half_width + 0.8) / slope) + 0.6 * self.half_width

    @classmethod
    def of(cls, tracks: Sequence[_Track]) -> _Extent:
        """Measure all paths."""
        xy = np.concatenate([track.pose[:, :2] for track in tracks])
        ends = np.array([track.pieces[-1].xy[-1] for track in tracks])
        away = ends.mean(axis=0) - tracks[0].pieces[0].xy[0]
        along = np.linalg.eigh(np.cov((xy - xy.mean(axis=0)).T) + 1e-12 * np.diag([2.0, 1.0]))[1][:, -1]
        along = along if along @ away >= 0.0 else -along
        frame = np.stack([along, rotate_body_to_world([0.0, 1.0], math.atan2(along[1], along[0]))])
        inside = xy @ frame.T
        low, high = inside.min(axis=0), inside.max(axis=0)
        half = 0.5 * (high - low)
        stamps = tracks[0].t
        return cls(
            xy.min(axis=0), xy.max(axis=0), ends.mean(axis=0), along, float(half[0]), float(half[1]), 0.5 * (low + high) @ frame,
            float(stamps[-1] - stamps[0]),
        )  # fmt: skip


# --- the plots ---------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Series:
    """What one entity draws: k lines over the same stamps."""

    names: Sequence[str]
    colours: Sequence[Rgb]
    t: FloatArray
    """(M,) [s]."""
    values: FloatArray
    """(M,) or (M, k)."""
    width: float = 1.5
    held: bool = False
    """Whether each value holds until the next, as commands do."""


def _write_series(recording: rr.RecordingStream, entity: str, series: _Series, gaps: FloatArray) -> None:
    """Send the samples; at each instant of `gaps` [s] the lines are interrupted."""
    mode = rr.components.InterpolationMode.StepAfter if series.held else rr.components.InterpolationMode.Linear
    style = rr.SeriesLines(
        names=list(series.names),
        colors=list(series.colours),
        widths=[series.width] * len(series.names),
        interpolation_mode=mode,
    )
    recording.log(entity, style, static=True)
    recording.send_columns(entity, [rr.TimeColumn(TIMELINE, duration=series.t)], rr.Scalars.columns(scalars=series.values))
    if len(gaps):
        recording.send_columns(entity, [rr.TimeColumn(TIMELINE, duration=gaps)], rr.Clear.columns(is_recursive=[False] * len(gaps)))


def _write_plots(recording: rr.RecordingStream, comparison: Comparison, tracks: Sequence[_Track]) -> None:
    gaps = np.array([0.5 * (a.t[-1] + b.t[0]) for a, b in pairwise(comparison.reference)])
    for track in tracks:
        for entity, series in _plots_of(track, tracks[0]).items():
            _write_series(recording, f"plots/{entity}", series, gaps)
    for entity, series in _command_plots(comparison.commands, comparison.reference).items():
        _write_series(recording, f"plots/{entity}", series, gaps)


def _plots_of(track: _Track, reference: _Track) -> dict[str, _Series]:
    """All series of one robot by entity, below `plots`."""
    t, name, lines = track.t, track.name, (track.line_colour,)
    twist = np.concatenate([p.twist for p in track.pieces])
    plots = {
        f"yaw_rate/{name}": _Series([f"{name} [rad/s]"], lines, t, twist[:, 2]),
        f"speed/{name}": _Series([f"{name} [m/s]"], lines, t, twist[:, 0]),
    }
    if not track.is_reference:
        apart = track.pose - reference.pose
        plots[f"position_error/{name}"] = _Series([f"{name} [m]"], lines, t, np.hypot(apart[:, 0], apart[:, 1]))
        plots[f"yaw_error/{name}"] = _Series([f"{name} [rad]"], lines, t, wrap_angle(apart[:, 2]))
    acceleration = _channel(track, "yaw_acceleration_rad_s2")
    if acceleration is not None:
        plots[f"yaw_acceleration/{name}"] = _Series([f"{name} [rad/s²]"], lines, t, acceleration)
    torque = _channel(track, "torque_N_m")
    if torque is not None:
        shades = (mix(track.line_colour, (255, 255, 255), 0.35), mix(track.line_colour, (0, 0, 0), 0.25))
        names = [f"{name} left [N m]", f"{name} right [N m]"]
        plots[f"torque/{name}"] = _Series(names, shades, t, torque)
    loads = _channel(track, "wheel_load_N")
    if loads is not None:
        names = [f"{wheel.replace('_', ' ')} [N]" for wheel in WHEELS]
        plots[f"wheel_load/{name}"] = _Series(names, [colour(n) for n in LOAD_COLOURS], t, loads)
    return plots


LOAD_COLOURS = ("mujoco", "improved", "coulomb", "linear")
"""Whose colours the four wheels borrow."""


def _channel(track: _Track, name: str) -> FloatArray | None:
    """A channel over all pieces; None if it was not recorded in each."""
    if not all(name in p.channels for p in track.pieces):
        return None
    return np.concatenate([p.channels[name] for p in track.pieces])


def _command_plots(commands: Sequence[Commands], reference: Sequence[Trajectory]) -> dict[str, _Series]:
    """What was commanded, by entity: each command at its instant, and the last again where its piece ends."""
    t = np.concatenate([p.t[0] + c.dt * np.arange(c.n + 1) for c, p in zip(commands, reference, strict=True)])
    values = np.concatenate([np.vstack([c.values, c.values[-1:]]) for c in commands])
    grey: Rgb = (150, 154, 160)
    if commands[0].kind == "wheels":
        names = ["left commanded [rad/s]", "right commanded [rad/s]"]
        return {"wheel_command/rates": _Series(names, [mix(grey, (255, 255, 255), 0.5), grey], t, values, held=True)}
    return {
        "speed/commanded": _Series(["commanded [m/s]"], [grey], t, values[:, 0], width=1.0, held=True),
        "yaw_rate/commanded": _Series(["commanded [rad/s]"], [grey], t, values[:, 1], width=1.0, held=True),
    }


# --- the layout --------------------------------------------------------------------------------------------------------------


def _layout(comparison: Comparison, tracks: Sequence[_Track]) -> rrb.Blueprint:
    """The scene and the line-up on the left, report and plots on the right."""
    scene, reference = _Extent.of(tracks), comparison.reference_name
    first, last = float(tracks[0].t[0]), float(tracks[0].t[-1]) + LEGEND_SHARE * scene.duration
    absolute = rr.TimeRangeBoundary.absolute
    span = rrb.TimeAxis(view_range=rr.TimeRange(start=absolute(seconds=first), end=absolute(seconds=last)))

    def plot(quantity: str, title: str) -> rrb.TimeSeriesView:
        return rrb.TimeSeriesView(origin=f"/plots/{quantity}", name=title, axis_x=span, plot_legend=rrb.Corner2D.RightTop)

    middle = np.append(scene.middle + 0.05 * scene.distance * scene.along, 0.0)
    aside = rotate_body_to_world([0.0, -1.0], math.atan2(scene.along[1], scene.along[0]))
    grid = rrb.LineGrid3D(visible=True, spacing=1.0, stroke_width=1.0, color=GRID)
    overview = rrb.Spatial3DView(
        origin="/world",
        name="Scene (grid 1 m)",
        background=SKY,
        line_grid=grid,
        eye_controls=_eye(middle + scene.distance * np.append(math.cos(0.6) * aside, math.sin(0.6)), middle),
    )
    away = [f"- /world/{track.name}/end/**" for track in tracks]
    above = rrb.Spatial3DView(
        origin="/world",
        contents=["/world/**", *away],
        name="From above",
        background=SKY,
        line_grid=grid,
        eye_controls=_eye(middle + [0.0, 0.0, 1.1 * scene.distance], middle, up=np.append(-aside, 0.0)),
    )
    rows = math.ceil(len(tracks) / ABREAST)
    heart, far = np.array([0.4 * ROW * (rows - 1), 0.1, 0.2]), 3.1 + 0.5 * rows
    lineup = rrb.Spatial3DView(
        origin="/lineup",
        name=f"Side by side, displaced as seen from {reference}",
        background=SKY,
        line_grid=False,
        eye_controls=_eye(heart + far * np.array([-0.73, -0.14, 0.62]), heart),
    )
    start = tracks[0].pieces[0].pose[0]
    behind = np.append(shift_reference(start, (-1.5, -1.2))[:2], 1.15)
    close = rrb.Spatial3DView(
        origin="/world",
        contents=["/world/**", *away, f"- /world/{reference}/ticks/time", *_bodies_of(tracks[1:])],
        name=f"Following {reference}",
        background=SKY,
        line_grid=grid,
        eye_controls=_eye(behind, np.append(start[:2], 0.2), follow=f"/world/{reference}/robot/base"),
    )
    report = rrb.TextDocumentView(origin="/report", name="Report")
    position = plot("position_error", f"Position error to {reference} [m]")
    turn = plot("yaw_error", f"Yaw error to {reference} [rad]")
    commands = [plot("wheel_command", "Commanded wheel rates [rad/s]")] if comparison.commands[0].kind == "wheels" else []
    torques = plot("torque/mujoco", "Motor torques of mujoco [N m]") if "mujoco" in comparison.plants else plot("torque", "Motor torques [N m]")
    wheels = [plot("wheel_load", "Wheel loads [N]")] if any(_channel(k, "wheel_load_N") is not None for k in tracks) else []
    left = rrb.Vertical(rrb.Tabs(overview, above, report), rrb.Horizontal(lineup, close), row_shares=[1, 1])
    right = rrb.Vertical(
        rrb.Tabs(position, turn),
        rrb.Tabs(plot("yaw_rate", "Yaw rate [rad/s]"), plot("yaw_acceleration", "Yaw acceleration [rad/s²]"), plot("speed", "Speed [m/s]"), *commands),
        rrb.Tabs(*wheels, torques),
    )
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[8, 5]),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed", play_state="playing", loop_mode="off"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _bodies_of(tracks: Sequence[_Track]) -> list[str]:
    """View contents without the meshes of these robots; their outlines stay."""
    return [f"- /world/{track.name}/robot/{body}" for track in tracks for body in ("base", *WHEELS)]


def _eye(position: FloatArray, target: FloatArray, up: FloatArray | None = None, follow: str | None = None) -> rrb.EyeControls3D:
    """An eye that turns about `target`, which is fixed unless an entity is to be followed."""
    return rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, position=position, look_target=target, eye_up=up, tracking_entity=follow)
