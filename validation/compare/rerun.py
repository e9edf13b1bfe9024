"""The recording sink: a comparison as a rerun file that carries its own layout, to be played back and looked into.

Everything is in metres, seconds and radians, z up, on the timeline `sim_time`:

- `world/<plant>/robot`: the reference point on the ground over time; below it `base` and the four wheels, a mesh each;
- `world/<plant>/path`, `.../ticks`, `.../end`: the whole path, where the plant was at round times, its name where it ends;
- `lineup/<plant>/robot`: the same robots side by side, each displaced from its place as it is from the reference's robot
  (where one strays far, they are only turned);
- `plots/<quantity>/<plant>`: what is drawn over time;
- `history/<what>`: what changed from step to step, on a timeline of its own;
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
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssmr.geometry import (
    quat_wxyz_to_xyzw,
    relative,
    roll_pitch_yaw_to_quat_wxyz,
    rotate_body_to_world,
    shift_reference,
    wrap_angle,
)
from ssmr.types import FloatArray, Trajectory
from validation.compare.data import ComparisonData
from validation.robots.husky import WHEELS
from validation.robots.terrain import FLAT, Terrain
from validation.robots.wheel_loads import QUASI_STATIC
from validation.show.palette import Rgb, colour, mix
from validation.show.robot_mesh import RobotMesh, robot_mesh, tinted, wheel_quat_wxyz, wheel_turns
from validation.store import write_atomic

os.environ.setdefault("RERUN_ANALYTICS", "false")  # rerun looks at it when it is imported

import rerun as rr
import rerun.blueprint as rrb

from validation.show.rerun_ground import write_ground

logger = logging.getLogger(__name__)

APPLICATION = "ssmr-testbed"
TIMELINE = "sim_time"
POSE_PERIOD = 0.02
"""Time between two poses of a robot [s]: 50 Hz is smooth to the eye. Plots keep every sample."""
VIEWER_GRACE = 3.0
"""A viewer that cannot open its window has given up by then [s]."""

SOLID, GLASS, FAINT_GLASS = 255, 150, 32
"""Opacity of robots, 0-255. Those that mostly overlap the reference's are faint: solid ones would cut into each other."""
GLASS_INSET = 0.985
"""Size of a transparent robot over the real one's: where it stands just as the reference's robot does, it hides inside."""
LINEUP_GAP = np.array([1.75, 1.25, 0.0])
"""Distance between rows and between neighbours in the line-up [m]."""
ABREAST = 3
"""Robots in a row of the line-up."""
LEGEND_SHARE = 0.4
"""Room right of the plots, over their duration, so that legends hide no line."""
FIELD_OF_VIEW = math.radians(55.0)
"""Of the viewer's eye, from top to bottom [rad]."""

SKY: Rgb = (238, 240, 243)
GRID: Rgb = (186, 191, 198)
PLACE: Rgb = (70, 74, 80)
COMMANDED: Rgb = (86, 180, 233)
WHEEL_COLOURS = tuple(colour(name) for name in ("mujoco", "improved", "coulomb", "linear"))
BLACK: Rgb = (0, 0, 0)
WHITE: Rgb = (255, 255, 255)


@dataclass(frozen=True, eq=False)
class Track:
    """One robot of the scene, a plant or the recorded one, with its M samples of all pieces in a row."""

    name: str
    pieces: tuple[Trajectory, ...]
    reference: Track | None
    """The robot to compare with; None for that robot itself."""
    tracked_point: tuple[float, float] = (0.0, 0.0)
    """The point of the body whose poses these are [m]."""
    terrain: Terrain = FLAT
    """What is under it."""

    @property
    def colour(self) -> Rgb:
        """Its plant's."""
        return colour(self.name)

    @property
    def bright(self) -> Rgb:
        """Its colour where it must show on dark, as on the viewer's plots: near-black becomes grey."""
        return mix(self.colour, WHITE, 0.55) if max(self.colour) < 80 else self.colour

    @cached_property
    def t(self) -> FloatArray:
        """(M,) stamps [s]."""
        return np.concatenate([p.t for p in self.pieces])

    @cached_property
    def pose(self) -> FloatArray:
        """(M, 3) poses [m, m, rad]."""
        return np.concatenate([p.pose for p in self.pieces])

    @cached_property
    def body(self) -> FloatArray:
        """(M, 3) poses of the body's own reference point, the middle between the axles [m, m, rad]."""
        return shift_reference(self.pose, np.negative(self.tracked_point))

    @cached_property
    def raised(self) -> FloatArray:
        """(M, 3) height [m], roll and pitch [rad]: as simulated, or as four wheels lie on the ground."""
        height, tilt = self.channel("height_m"), self.channel("roll_pitch_rad")
        return self.terrain.lie(self.body) if height is None or tilt is None else np.column_stack([height, tilt])

    @cached_property
    def turns(self) -> FloatArray:
        """(M, 2) angles through which the left and right wheels have turned since their piece began [rad]."""
        return np.concatenate([wheel_turns(p.t, p.wheels) for p in self.pieces])

    @cached_property
    def seen(self) -> FloatArray:
        """(M, 3) poses seen from the reference's robot [m, m, rad]."""
        return relative((self.reference or self).pose, self.pose)

    @cached_property
    def apart(self) -> FloatArray:
        """(M,) distance from the reference's robot [m]."""
        return np.hypot(self.seen[:, 0], self.seen[:, 1])

    @cached_property
    def shown(self) -> NDArray[np.intp]:
        """Indices of the samples whose pose is shown: of each piece the first in every `POSE_PERIOD`, and the last."""
        slots = [np.floor((p.t - p.t[0]) / POSE_PERIOD + 1e-6) for p in self.pieces]
        keep = [np.r_[True, np.diff(s) > 0.0] | (np.arange(len(s)) == len(s) - 1) for s in slots]
        return np.flatnonzero(np.concatenate(keep))

    def channel(self, name: str) -> FloatArray | None:
        """A channel over all samples; None where a piece lacks it."""
        if not all(name in p.channels for p in self.pieces):
            return None
        return np.concatenate([p.channels[name] for p in self.pieces])


@dataclass(frozen=True, eq=False)
class History:
    """What changed from step to step, not over the robots' time."""

    what: str
    """Its entity is `history/<what>`."""
    title: str
    timeline: str
    """What the steps are called."""
    names: tuple[str, ...]
    """k names."""
    colours: tuple[Rgb, ...]
    """k colours."""
    values: FloatArray
    """(G, k), of the steps 0 to G - 1; where one is not finite, the line is interrupted."""


def write_recording(comparison: ComparisonData, path: Path, report_markdown: str, histories: Sequence[History] = ()) -> None:
    """Write a comparison as a rerun recording, whole or not at all.

    The recording's id is a digest of what was asked for and of the motions that came out: a run that is repeated compares
    equal, and two that differ can be open in one viewer.

    Args:
        comparison: what to show.
        path: the file, `.rrd`; one that is there already is replaced.
        report_markdown: the report, in markdown.
        histories: what else to plot, each on its own timeline.

    Raises:
        OSError: the file cannot be written.
        RuntimeError: rerun is switched off by `RERUN=off`.
    """
    data = _encoded(comparison, report_markdown, histories)
    write_atomic(path, lambda temporary: temporary.write_bytes(data))


def open_viewer(path: Path) -> bool:
    """Open a recording in rerun's own viewer, which then lives on by itself and listens on the loopback interface alone.

    Args:
        path: the recording.

    Returns:
        Whether there is a viewer; if not, the log says why and what to do.
    """
    by_hand = f"open it where there is a screen: rerun {path}"
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        logger.warning("there is no display for the rerun viewer; %s", by_hand)
        return False
    command = [sys.executable, "-m", "rerun_cli", str(path), "--bind", "127.0.0.1", "--port", "auto"]
    quiet = subprocess.DEVNULL
    try:
        viewer = subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True)
    except OSError as error:
        logger.warning("the rerun viewer cannot be started (%s); %s", error, by_hand)
        return False
    try:
        viewer.wait(VIEWER_GRACE)
    except subprocess.TimeoutExpired:
        return True
    logger.warning("the rerun viewer ended at once, as it does where it can open no window; %s", by_hand)
    return False


def _encoded(comparison: ComparisonData, report_markdown: str, histories: Sequence[History]) -> bytes:
    """The whole recording as the bytes of a file."""
    c, tracks = comparison, _tracks(comparison)

    def fill(recording: rr.RecordingStream) -> None:
        plots = _plots(comparison, tracks)
        recording.send_blueprint(_layout(tracks, plots, histories), make_active=False, make_default=True)
        _write_properties(recording, comparison)
        recording.log("report", rr.TextDocument(report_markdown, media_type=rr.MediaType.MARKDOWN), static=True)
        _write_scene(recording, tracks)
        for entity, series in plots.items():
            write_series(recording, f"plots/{entity}", series, _gaps(tracks[0]))
        for history in histories:
            _write_history(recording, history)

    return encode(identify((c.source, c.profile, c.reference_name, c.seed, sorted(c.options.items())), tracks), fill)


def encode(identity: uuid.UUID, fill: Callable[[rr.RecordingStream], None]) -> bytes:
    """What `fill` sends to a recording of this id, as the bytes of a file; misuse of rerun raises.

    Raises:
        RuntimeError: rerun is switched off by `RERUN=off`.
    """
    recording = rr.RecordingStream(APPLICATION, recording_id=identity, send_properties=False)
    if not recording.is_enabled():
        raise RuntimeError("rerun is switched off: unset the environment variable RERUN to write recordings")
    stream = recording.binary_stream()
    try:
        with _strict():
            fill(recording)
    finally:
        data = stream.read()  # after a failure too: rerun complains of a stream that is not read
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


def _tracks(comparison: ComparisonData) -> list[Track]:
    """All robots, the reference first."""
    plants = comparison.plants
    known = plants.get(comparison.reference_name) or next(
        iter(plants.values())
    )  # where a recording was tracked its plants say
    ground = comparison.terrain
    reference = Track(comparison.reference_name, comparison.reference, None, known.tracked_point, ground)
    others = [result for result in plants.values() if result.name != reference.name]
    return [reference, *(Track(result.name, result.pieces, reference, result.tracked_point, ground) for result in others)]


def identify(asked: object, tracks: Sequence[Track]) -> uuid.UUID:
    """The id of a recording: a digest of what was asked for, by its `repr`, and of the motions that came out."""
    digest = hashlib.sha256(repr(asked).encode())
    for track in tracks:
        digest.update(track.name.encode() + track.t.tobytes() + track.pose.tobytes())
    return uuid.UUID(bytes=digest.digest()[:16], version=4)


def _write_properties(recording: rr.RecordingStream, comparison: ComparisonData) -> None:
    recording.send_recording_name(f"{comparison.source}, profile {comparison.profile}")
    about = rr.AnyValues(
        source=comparison.source,
        profile=comparison.profile,
        reference=comparison.reference_name,
        seed=comparison.seed,
    )
    recording.send_property("comparison", about)
    write_circumstances(recording, comparison.options, comparison.versions)


def write_circumstances(recording: rr.RecordingStream, options: Mapping[str, object], versions: Mapping[str, str]) -> None:
    """Send how it was run, and with what, as properties of the recording."""
    for name, values in (("options", options), ("versions", versions)):
        entries = rr.AnyValues()
        for key, value in values.items():
            entries.with_component_from_data(key, str(value))
        if values:
            recording.send_property(name, entries)


# --- the scene ---


def _write_scene(recording: rr.RecordingStream, tracks: Sequence[Track]) -> None:
    """Log ground, robots, paths and labels, of the world and of the line-up."""
    robot, extent, close = robot_mesh(), Extent(tracks), _stays_close(tracks)
    margin = 0.5 * extent.reach + 5.0
    recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    write_ground(recording, "world/ground", tracks[0].terrain, extent.middle - margin, extent.middle + margin)
    write_ground(recording, "lineup/ground", FLAT, np.full(2, -50.0), np.full(2, 50.0))
    interval = round_interval((tracks[0].t[-1] - tracks[0].t[0]) / 8.0)
    for rank, track in enumerate(tracks):
        world, lineup, place = f"world/{track.name}", f"lineup/{track.name}", _place(rank, len(tracks))
        opacity = opacity_of(robot, None if track.reference is None else track.apart)
        write_robot(recording, f"{world}/robot", robot, track, opacity)
        write_motion(recording, f"{world}/robot", robot, track, track.body, track.raised)
        write_path(recording, track, interval)
        write_robot(recording, f"{lineup}/robot", robot, track, SOLID)
        write_motion(recording, f"{lineup}/robot", robot, track, track.seen * ([1, 1, 1] if close else [0, 0, 1]) + place)
        recording.log(f"{world}/robot/outline", outline(robot, robot.box[1, 2], track.colour), static=True)
        recording.log(f"{lineup}/place", outline(robot, 0.0, PLACE), rr.Transform3D(translation=place), static=True)
        name = f"{track.name} (reference)" if track.reference is None else track.name
        recording.log(f"{lineup}/name", labels([np.add(place, (0.3, 0.0, 0.75))], [name], track.bright), static=True)
        write_signpost(recording, track, extent, rank)


def write_signpost(recording: rr.RecordingStream, track: Track, extent: Extent, rank: int) -> None:
    """Log a robot's name beyond its end, the higher the later its rank."""
    entity = f"world/{track.name}/end"
    post = np.append(extent.end + extent.post * extent.along, 0.045 * extent.distance * (rank + 1.0))
    end = [np.append(track.pieces[-1].xy[-1], 0.01), post]
    recording.log(entity, lines([end], track.colour, 0.7), static=True)
    recording.log(f"{entity}/name", labels([post], [track.name], track.bright), static=True)


def opacity_of(robot: RobotMesh, apart: FloatArray | None) -> int:
    """A robot is the fainter the more it overlaps another, by its distances from that [m]; solid where there is none."""
    if apart is None:
        return SOLID
    return FAINT_GLASS if np.median(apart) < robot.box[1, 0] else GLASS


def _stays_close(tracks: Sequence[Track]) -> bool:
    """Whether no robot ever strays farther from the reference's than to its neighbour's place in the line-up."""
    return all(track.apart.max() < LINEUP_GAP[1] for track in tracks)


def _place(rank: int, count: int) -> FloatArray:
    """(3,) place of a robot in the line-up [m]: the first row from the left, later rows ahead of it."""
    row, column = divmod(rank, ABREAST)
    in_row = min(count - row * ABREAST, ABREAST)
    return LINEUP_GAP * (row, 0.5 * (in_row - 1) - column, 0.0)


def write_robot(recording: rr.RecordingStream, entity: str, robot: RobotMesh, track: Track, opacity: int) -> None:
    """Log each body's mesh, in the robot's own colours for MuJoCo's and in shades of the plant's for others."""
    size, darkest = (1.0, 0.25) if opacity == SOLID else (GLASS_INSET, 0.6)
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
    strips = [np.column_stack([p.xy, height + track.terrain.height_at(p.xy)]) for p in track.pieces]
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
    """The least of 1, 2, 5, 10, 20, 30, 60 s and whole minutes that is no shorter."""
    return next((float(s) for s in (1, 2, 5, 10, 20, 30, 60) if s >= seconds), 60.0 * math.ceil(seconds / 60.0))


def lines(strips: Sequence[ArrayLike], rgb: Rgb, width: float) -> rr.LineStrips3D:
    """Line strips as wide on the screen from near and far."""
    return rr.LineStrips3D([np.asarray(strip) for strip in strips], colors=[rgb], radii=rr.Radius.ui_points(width))


def outline(robot: RobotMesh, height: float, rgb: Rgb) -> rr.LineStrips3D:
    """A rectangle around the robot as seen from above, with a mark where its front is."""
    z = height + 0.004
    (rear, right, _), (front, left, _) = robot.box
    around = [[front, left, z], [front, right, z], [rear, right, z], [rear, left, z], [front, left, z]]
    nose = [[front, 0.25 * left, z], [front + 0.1, 0.0, z], [front, 0.25 * right, z]]
    return lines([around, nose], rgb, 1.2)


def labels(points: Sequence[ArrayLike], texts: Sequence[str], rgb: Rgb) -> rr.Points3D:
    """Texts at (N, 3) points, bright, since the viewer writes them on dark patches."""
    radii = rr.Radius.ui_points(0.1)
    return rr.Points3D(points, labels=texts, colors=[mix(rgb, WHITE, 0.6)], radii=radii, show_labels=True)


# --- the plots ---


@dataclass(frozen=True, eq=False)
class Series:
    """What one entity draws: k lines over the same stamps."""

    names: Sequence[str]
    """k names, with unit."""
    colours: Sequence[Rgb]
    t: FloatArray
    """(M,) [s]."""
    values: FloatArray
    """(M,) or (M, k)."""
    held: bool = False
    """Whether each value holds until the next, as commands do."""


def _gaps(reference: Track) -> FloatArray:
    """(pieces - 1,) instants between pieces [s]."""
    return np.array([0.5 * (a.t[-1] + b.t[0]) for a, b in pairwise(reference.pieces)])


def write_series(recording: rr.RecordingStream, entity: str, series: Series, gaps: FloatArray) -> None:
    """Send the samples; at each instant of `gaps` [s] the lines are interrupted."""
    mode = rr.components.InterpolationMode.StepAfter if series.held else rr.components.InterpolationMode.Linear
    style = rr.SeriesLines(
        names=list(series.names),
        colors=list(series.colours),
        widths=[1.0 if series.held else 1.5] * len(series.names),
        interpolation_mode=mode,
    )
    recording.log(entity, style, static=True)
    time = rr.TimeColumn(TIMELINE, duration=series.t)
    recording.send_columns(entity, [time], rr.Scalars.columns(scalars=series.values))
    if len(gaps):
        time = rr.TimeColumn(TIMELINE, duration=gaps)
        recording.send_columns(entity, [time], rr.Clear.columns(is_recursive=[False] * len(gaps)))


def _write_history(recording: rr.RecordingStream, history: History) -> None:
    """Send the values of all steps."""
    entity, steps = f"history/{history.what}", rr.TimeColumn(history.timeline, sequence=np.arange(len(history.values)))
    style = rr.SeriesLines(names=list(history.names), colors=list(history.colours), widths=[1.5] * len(history.names))
    recording.log(entity, style, static=True)
    values = np.where(np.isfinite(history.values), history.values, np.nan)
    recording.send_columns(entity, [steps], rr.Scalars.columns(scalars=values))


def _plots(comparison: ComparisonData, tracks: Sequence[Track]) -> dict[str, Series]:
    """All series by entity below `plots`."""
    plots = _command_plots(comparison)
    for track in tracks:
        plots.update(_plots_of(track))
    return plots


def _plots_of(track: Track) -> dict[str, Series]:
    """The series of one robot by entity."""

    def add(quantity: str, unit: str, values: FloatArray | None) -> None:
        if values is not None:
            plots[f"{quantity}/{track.name}"] = Series([f"{track.name} [{unit}]"], [track.bright], track.t, values)

    plots = dict[str, Series]()
    twist = np.concatenate([p.twist for p in track.pieces])
    add("speed", "m/s", twist[:, 0])
    add("yaw_rate", "rad/s", twist[:, 2])
    add("yaw_acceleration", "rad/s²", track.channel("yaw_acceleration_rad_s2"))
    if track.reference is not None:
        add("position_error", "m", track.apart)
        add("yaw_error", "rad", wrap_angle(track.seen[:, 2]))
    torque, loads = track.channel("torque_N_m"), track.channel("wheel_load_N")
    if torque is not None:
        names = [f"{track.name} {side} [N m]" for side in ("left", "right")]
        shades = [mix(track.bright, WHITE, 0.35), mix(track.bright, BLACK, 0.25)]
        plots[f"torque/{track.name}"] = Series(names, shades, track.t, torque)
    if loads is not None:
        names = [f"{wheel.replace('_', ' ')} [N]" for wheel in WHEELS]
        plots[f"wheel_load/{track.name}"] = Series(names, WHEEL_COLOURS, track.t, loads)
    formula = track.channel(QUASI_STATIC)
    if formula is not None:
        names = [f"{wheel.replace('_', ' ')} quasi-static [N]" for wheel in WHEELS]
        plots[f"wheel_load/{track.name}_quasi_static"] = Series(
            names, [mix(c, WHITE, 0.5) for c in WHEEL_COLOURS], track.t, formula
        )
    return plots


def _command_plots(comparison: ComparisonData) -> dict[str, Series]:
    """What was commanded by entity: each command at its instant, and the last again where its time ends; if it was kept."""
    if not comparison.commands:
        return {}
    commands, starts = comparison.commands, [piece.t[0] for piece in comparison.reference]
    t = np.concatenate([start + c.dt * np.arange(c.n + 1) for start, c in zip(starts, commands, strict=True)])
    values = np.concatenate([np.vstack([c.values, c.values[-1:]]) for c in commands])
    if commands[0].kind == "wheels":
        names = ["left commanded [rad/s]", "right commanded [rad/s]"]
        shades = [mix(COMMANDED, WHITE, 0.35), mix(COMMANDED, BLACK, 0.25)]
        return {"wheel_rate/commanded": Series(names, shades, t, values, held=True)}
    return {
        "speed/commanded": Series(["commanded [m/s]"], [COMMANDED], t, values[:, 0], held=True),
        "yaw_rate/commanded": Series(["commanded [rad/s]"], [COMMANDED], t, values[:, 1], held=True),
    }


# --- the layout ---


class Extent:
    """Where the paths lie and how far an eye must stand off to see them.

    Attributes:
        along: (2,) unit vector along their longest extent, from start to end.
        across: (2,) unit vector to the left of it.
        middle: (2,) middle of the extents [m].
        end: (2,) mean of the paths' ends [m].
        reach: the longest extent [m].
        distance: from where an eye sees all of it, with the robots and a margin, in a view twice as wide as high [m].
        post: how far beyond the end the signpost with the plants' names stands [m].
    """

    def __init__(self, tracks: Sequence[Track]) -> None:
        xy = np.concatenate([track.pose[:, :2] for track in tracks])
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
        slope = math.tan(0.5 * FIELD_OF_VIEW)
        length, width = 0.5 * (high - low)
        self.distance = max(3.0, (length + 0.8) / (1.8 * slope), (0.6 * width + 0.8) / slope) + 0.6 * float(width)
        self.post = max(0.8, 0.1 * self.distance)


def _layout(tracks: Sequence[Track], plots: Mapping[str, Series], histories: Sequence[History]) -> rrb.Blueprint:
    """Three looks at the robots, the report and histories on the left, plots on the right."""
    overview, above, lineup, close = _views_of_robots(tracks)
    first, last = float(tracks[0].t[0]), float(tracks[0].t[-1])

    def plot(entity: str, title: str) -> list[rrb.TimeSeriesView]:
        return plot_view(plots, entity, title, (first, last))

    name = tracks[0].name
    motion = [
        *plot("yaw_rate", "Yaw rate [rad/s]"),
        *plot("yaw_acceleration", "Yaw acceleration [rad/s²]"),
        *plot("speed", "Speed [m/s]"),
        *plot("wheel_rate", "Commanded wheel rates [rad/s]"),
    ]
    torques = plot("torque/mujoco", "Motor torques of mujoco [N m]") or plot("torque", "Motor torques [N m]")
    wheels = [*plot("wheel_load", "Wheel loads [N]"), *torques]
    errors = [
        *plot("position_error", f"Position error to {name} [m]"),
        *plot("yaw_error", f"Yaw error to {name} [rad]"),
    ]
    report = rrb.TextDocumentView(origin="/report", name="Report")
    steps = [
        rrb.TimeSeriesView(origin=f"/history/{h.what}", name=f"{h.title} (choose the timeline '{h.timeline}')")
        for h in histories
    ]
    left = rrb.Vertical(rrb.Tabs(overview, above, report, *steps), rrb.Horizontal(lineup, close), row_shares=[6, 5])
    return blueprint(left, [errors, motion, wheels])


def plot_view(plots: Mapping[str, Series], entity: str, title: str, span: tuple[float, float]) -> list[rrb.TimeSeriesView]:
    """A view of all series below `plots/<entity>` from the first to the last instant [s], with room for a legend.

    Empty where there is no such series.
    """
    drawn = [series.values for name, series in plots.items() if f"{name}/".startswith(f"{entity}/")]
    at, duration = rr.TimeRangeBoundary.absolute, max(span[1] - span[0], 0.1)
    shown = rr.TimeRange(start=at(seconds=span[0]), end=at(seconds=span[0] + (1.0 + LEGEND_SHARE) * duration))
    return [
        rrb.TimeSeriesView(
            origin=f"/plots/{entity}",
            name=title,
            axis_x=rrb.TimeAxis(view_range=shown),
            axis_y=rrb.ScalarAxis(range=axis_range(drawn)),
            plot_legend=rrb.Corner2D.RightTop,
        )
        for _ in drawn[:1]
    ]


def blueprint(left: rrb.Container, plots: Sequence[Sequence[rrb.TimeSeriesView]]) -> rrb.Blueprint:
    """Looks at robots on the left, on the right groups of plots above one another, a group's in tabs; it plays at once."""
    right = rrb.Vertical(*(rrb.Tabs(*views) for views in plots if views))
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[8, 5]),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed", play_state="playing", loop_mode="off"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def axis_range(drawn: Sequence[FloatArray]) -> tuple[float, float]:
    """From where to where an axis goes.

    The viewer would take in a zero wherever a line is interrupted, and write numbers only at whole powers of ten where finer
    ones have no room: a range that holds but one of those is widened to the next.
    """
    low, high = min(float(v.min()) for v in drawn), max(float(v.max()) for v in drawn)
    step = 10.0 ** math.floor(math.log10(max(high - low, 1e-3)))
    if high - low > 1.3 * step and math.floor(high / step) - math.ceil(low / step) < 1:
        low, high = step * math.floor(low / step), step * math.ceil(high / step)
    margin = 0.05 * max(high - low, 1e-3)
    return low - margin, high + margin


def _views_of_robots(tracks: Sequence[Track]) -> list[rrb.Spatial3DView]:
    """The scene from aside and from above, the line-up, and the reference's robot from near."""
    extent, reference = Extent(tracks), tracks[0].name
    rows = math.ceil(len(tracks) / ABREAST)
    heart = np.array([0.4 * LINEUP_GAP[0] * (rows - 1), 0.1, 0.2])
    names = [f"- /world/{track.name}/end/**" for track in tracks]
    bodies = [f"- /world/{track.name}/robot/{body}" for track in tracks[1:] for body in ("base", *WHEELS)]

    how = "displaced" if _stays_close(tracks) else "turned"
    return [
        *overviews(extent, names),
        view(
            f"Side by side, {how} as seen from {reference}",
            "/lineup",
            eye(heart + (3.1 + 0.5 * rows) * np.array([-0.73, -0.14, 0.62]), heart),
        ),
        follower(tracks[0], [*names, f"- /world/{reference}/ticks/time", *bodies]),
    ]


def view(name: str, origin: str, looks: rrb.EyeControls3D, without: Sequence[str] = ()) -> rrb.Spatial3DView:
    """What lies below `origin`, seen by an eye."""
    grid = rrb.LineGrid3D(visible=origin == "/world", spacing=1.0, stroke_width=1.0, color=GRID)
    contents = [f"{origin}/**", *without]
    return rrb.Spatial3DView(name=name, origin=origin, contents=contents, background=SKY, line_grid=grid, eye_controls=looks)


def overviews(extent: Extent, names: Sequence[str]) -> list[rrb.Spatial3DView]:
    """The world from aside and, without the `names`, from above."""
    middle = np.append(extent.middle + 0.6 * extent.post * extent.along, 0.0)
    aside = middle + extent.distance * np.append(-math.cos(0.6) * extent.across, math.sin(0.6))
    high = middle + np.array([0.0, 0.0, 1.1 * extent.distance])
    return [
        view("Scene (grid 1 m)", "/world", eye(aside, middle)),
        view("From above", "/world", eye(high, middle, up=np.append(extent.across, 0.0)), names),
    ]


def follower(track: Track, without: Sequence[str]) -> rrb.Spatial3DView:
    """The world from close behind a robot."""
    start = track.pose[0]
    behind = np.append(shift_reference(start, (-1.5, -1.2))[:2], 1.15)
    looks = eye(behind, np.append(start[:2], 0.2), follow=f"/world/{track.name}/robot/base")
    return view(f"Following {track.name}", "/world", looks, without)


def eye(
    position: FloatArray, target: FloatArray, up: FloatArray | None = None, follow: str | None = None
) -> rrb.EyeControls3D:
    """An eye that turns about `target`, which stays where it is unless an entity is to be followed."""
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=position, look_target=target, eye_up=up, tracking_entity=follow
    )
