"""Robots in motion as a rerun recording that carries its own layout: one scene for every program that has motions.

Everything is in metres, seconds and radians, z up, on the timeline `sim_time`:

- `world/NAME/robot`: the reference point on the ground over time; below it `base` and the four wheels;
- `world/NAME/path`, `.../ticks`, `.../end`: the whole path, where the robot was at round times, its name where it ends;
- `world/target`: the moving target of a controller, an arrow along its heading;
- `plots/QUANTITY/NAME`: what is drawn over time;
- `history/NAME`: what changed from step to step of a search, on a timeline of its own;
- `report`: the report as text.
"""

from __future__ import annotations

import hashlib
import math
import os
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

os.environ.setdefault("RERUN_ANALYTICS", "false")  # rerun looks at it when it is imported

try:
    import rerun as rr
    import rerun.blueprint as rrb
except ImportError as missing:
    raise ImportError("recordings need the package rerun-sdk; save(folder, recording=False) does without") from missing

from ssmr.geometry import (
    quat_wxyz_to_xyzw,
    roll_pitch_yaw_to_quat_wxyz,
    shift_reference,
    yaw_to_quat_wxyz,
)
from ssmr.types import FloatArray
from validation.report.looks import Looks, Solid, looks_of, tinted
from validation.report.palette import Rgb, colour, mix
from validation.report.tracks import (
    BLACK,
    GROUND,
    MOST_SAMPLES,
    OTHER_GROUND,
    POSE_PERIOD,
    Extent,
    History,
    Series,
    Track,
)
from validation.simulator.description import WHEELS
from validation.store import write_atomic
from validation.words import each_line, one_line

_TIMELINE = "sim_time"
_GRID: Rgb = (186, 191, 198)
_SKY: Rgb = (238, 240, 243)
_TARGET: Rgb = (20, 20, 24)
_LEGEND_SHARE = 0.4  # room right of the plots, over their duration, so that legends hide no line
_BELOW = 0.004  # the ground is drawn so much too low, so that lines on it show [m]
_MOST_POINTS = 200  # along a side of uneven ground


@dataclass(frozen=True, eq=False, kw_only=True)
class Scene:
    """What a recording shows."""

    program: str
    """Program that made it; recordings of one program share a layout in the viewer."""
    title: str
    """Name of the recording in the viewer's list."""
    tracks: Sequence[Track]
    """The robots; the first one's is solid, and the eye follows it."""
    plots: Mapping[str, Series]
    """Lines over time by entity, `speed/mujoco`."""
    views: Sequence[Mapping[str, str]]
    """Groups of plots above one another: titles by the beginning of their entities, a tab each."""
    report: str
    """Markdown."""
    about: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    """How it was made: values by name, by group."""
    gaps: FloatArray = field(default_factory=lambda: np.empty(0))
    """(G,) instants at which lines are interrupted [s]."""
    target: Track | None = None
    """A moving target."""
    histories: Sequence[History] = ()
    """Courses of searches."""

    def identity(self) -> uuid.UUID:
        """Return the recording's id: a digest of how it was made and of the motions that came out.

        A run that is repeated compares equal, and two that differ can be open in one viewer.
        """
        digest = hashlib.sha256(repr((self.title, {k: dict(v) for k, v in self.about.items()})).encode())
        for track in self.tracks:
            digest.update(track.name.encode() + track.t.tobytes() + track.pose.tobytes())
        return uuid.UUID(bytes=digest.digest()[:16], version=4)


def write_scene(scene: Scene, path: Path) -> None:
    """Write a scene as a rerun recording, whole or not at all.

    Raises:
        OSError: the file cannot be written.
        RuntimeError: rerun is switched off by `RERUN=off`.
    """
    recording = rr.RecordingStream(f"ssmr-testbed {scene.program}", recording_id=scene.identity(), send_properties=False)
    if not recording.is_enabled():
        raise RuntimeError("rerun is switched off: unset the environment variable RERUN to write recordings")
    stream, strict = recording.binary_stream(), rr.strict_mode()
    rr.set_strict_mode(True)  # else rerun warns and leaves something out
    try:
        _fill(recording, scene)
    finally:
        rr.set_strict_mode(strict)
        data = stream.read()  # rerun complains of a stream that is not read
    if not data:
        raise RuntimeError("rerun encoded nothing")
    write_atomic(path, lambda temporary: temporary.write_bytes(data))


def _fill(recording: rr.RecordingStream, scene: Scene) -> None:
    """Send everything to a recording."""
    recording.send_blueprint(_layout(scene))
    recording.send_recording_name(one_line(scene.title))
    for group, values in scene.about.items():
        entries = rr.AnyValues()
        for key, value in values.items():
            entries.with_component_from_data(one_line(key), one_line(value))  # rerun remembers one type a key in a process
        if values:
            recording.send_property(group, entries)
    report = rr.TextDocument(each_line(scene.report + _thinning(scene)), media_type=rr.MediaType.MARKDOWN)
    recording.log("report", report, static=True)
    recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    everything = [*scene.tracks, *([] if scene.target is None else [scene.target])]
    extent = Extent(everything)
    _write_ground(recording, scene.tracks[0], extent)
    for rank, track in enumerate(scene.tracks):
        _write_robot(recording, track, scene.tracks[0] if rank else None)
        _write_path(recording, track, rank)
        _write_signpost(recording, track, extent, rank)
    if scene.target is not None:
        _write_path(recording, scene.target, 0)
        _write_target(recording, scene.target, extent.scale)
    for entity, series in scene.plots.items():
        _write_series(recording, f"plots/{entity}", series, scene.gaps)
    for history in scene.histories:
        _write_history(recording, history)


def _thinning(scene: Scene) -> str:
    """Return a paragraph that says how a long recording is thinned; empty where it is not."""
    period = max(track.pose_period for track in scene.tracks)
    samples = max((series.samples for series in scene.plots.values()), default=0)
    how = [f"shows robots and paths every {period:.2f} s"] * (period > POSE_PERIOD)
    if samples > MOST_SAMPLES:
        how.append(f"draws lines over time through their least and greatest values, {MOST_SAMPLES} of {samples} samples")
    return f"\n\nThis recording is long. To keep the file small, it {' and '.join(how)}.\n" if how else ""


# --- the world ---


def _write_robot(recording: rr.RecordingStream, track: Track, solid: Track | None) -> None:
    """Log a robot's bodies and its motion; one beside another is drawn transparent, in shades of its plant's colour."""
    looks, entity = looks_of(track.robot), f"world/{track.name}/robot"
    for body, solids in looks.solids.items():
        for kind in dict.fromkeys(s.kind for s in solids):
            alike = [s for s in solids if s.kind == kind]
            recording.log(f"{entity}/{body}/{kind.lower()}", _shapes(kind, alike, track, solid is None), static=True)
    recording.log(f"{entity}/outline", _outline(looks, track), static=True)
    rows = track.rows
    time, pose, turns = rr.TimeColumn(_TIMELINE, duration=track.t[rows]), track.body[rows], track.turns[rows]
    height, roll, pitch = track.raised[rows].T
    quat_xyzw = quat_wxyz_to_xyzw(roll_pitch_yaw_to_quat_wxyz(roll, pitch, pose[:, 2]))
    translation = np.column_stack([pose[:, :2], height])
    recording.send_columns(entity, [time], rr.Transform3D.columns(translation=translation, quaternion=quat_xyzw))
    recording.log(f"{entity}/base", rr.Transform3D(translation=looks.places["base"]), static=True)
    zero = np.zeros(len(rows))
    for wheel in WHEELS:
        half = 0.5 * turns[:, 0 if wheel.endswith("left") else 1]  # about y, the axle: a positive turn rolls forward
        quat_xyzw = np.column_stack([zero, np.sin(half), zero, np.cos(half)])
        translation = np.tile(looks.places[wheel], (len(rows), 1))  # a static one would not combine with turns over time
        columns = rr.Transform3D.columns(translation=translation, quaternion=quat_xyzw)
        recording.send_columns(f"{entity}/{wheel}", [time], columns)


def _shapes(kind: str, solids: Sequence[Solid], track: Track, opaque: bool) -> Any:
    """Return solids of one kind as rerun has them."""
    own = track.name == "mujoco"
    colours = [s.rgba if own else tinted(s.rgba, track.bright, 0.25 if opaque else 0.6) for s in solids]
    look: dict[str, Any] = {
        "colors": np.round(255.0 * np.array(colours)).astype(np.uint8),
        "fill_mode": rr.components.FillMode.Solid if opaque else rr.components.FillMode.TransparentFillMajorWireframe,
        "quaternions": [quat_wxyz_to_xyzw(s.quat_wxyz) for s in solids],
    }
    middles, sizes = [s.position for s in solids], np.array([s.size for s in solids])
    if kind == "BOX":
        return rr.Boxes3D(half_sizes=sizes, centers=middles, **look)
    if kind == "ELLIPSOID":
        return rr.Ellipsoids3D(half_sizes=sizes, centers=middles, **look)
    if kind == "CYLINDER":
        return rr.Cylinders3D(lengths=2.0 * sizes[:, 1], radii=sizes[:, 0], centers=middles, **look)
    turned = np.array([_turned(s.quat_wxyz, [0.0, 0.0, s.size[1]]) for s in solids])  # a capsule's place is that of its end
    return rr.Capsules3D(lengths=2.0 * sizes[:, 1], radii=sizes[:, 0], translations=middles - turned, **look)


def _turned(quat_wxyz: FloatArray, vector: ArrayLike) -> FloatArray:
    w, axis, v = quat_wxyz[0], quat_wxyz[1:], np.asarray(vector)
    return np.asarray(v + 2.0 * np.cross(axis, np.cross(axis, v) + w * v))


def _lines(strips: Sequence[ArrayLike], rgb: Rgb, width: float) -> rr.LineStrips3D:
    """Return line strips as wide on the screen from near and far."""
    return rr.LineStrips3D([np.asarray(strip) for strip in strips], colors=[rgb], radii=rr.Radius.ui_points(width))


def _labels(points: ArrayLike, texts: Sequence[str], rgb: Rgb) -> rr.Points3D:
    """Return texts at (N, 3) points, dark: the viewer writes them on grey patches, or on white ones in its light theme."""
    ink = [mix(rgb, BLACK, 0.7)]
    return rr.Points3D(points, labels=list(texts), colors=ink, radii=rr.Radius.ui_points(0.1), show_labels=True)


def _outline(looks: Looks, track: Track) -> rr.LineStrips3D:
    """Return a rectangle above the robot, with a mark where its front is."""
    (rear, right, _), (front, left, top) = looks.box
    z = top + _BELOW
    around = [[front, left, z], [front, right, z], [rear, right, z], [rear, left, z], [front, left, z]]
    nose = [[front, 0.25 * left, z], [front + 0.1 * looks.scale[0], 0.0, z], [front, 0.25 * right, z]]
    return _lines([around, nose], colour(track.name), 1.2)


def _write_path(recording: rr.RecordingStream, track: Track, rank: int) -> None:
    """Log the path, one strip a piece, and a point at round times; the first one's points say the time."""
    entity, height, ink = f"world/{track.name}", 0.012 if rank == 0 else 0.008, colour(track.name)
    thinned = track.pose_period > POSE_PERIOD
    paths = [p.xy[kept] if thinned else p.xy for p, kept in zip(track.pieces, track.shown, strict=True)]
    strips = [np.column_stack([xy, height + track.terrain.height_at(xy)]) for xy in paths]
    recording.log(f"{entity}/path", _lines(strips, ink, 3.0 if rank == 0 else 2.0), static=True)
    interval = _round_interval((track.t[-1] - track.t[0]) / 8.0)
    stamps, points = list[float](), list[list[float]]()
    for piece in track.pieces:
        for k in range(math.ceil(piece.t[0] / interval), math.floor(piece.t[-1] / interval) + 1):
            stamps.append(k * interval)
            xy = np.array([[np.interp(stamps[-1], piece.t, column) for column in piece.xy.T]])
            points.append([*xy[0], height + float(track.terrain.height_at(xy)[0])])
    if points:
        marks = rr.Points3D(points, colors=[ink], radii=rr.Radius.ui_points(4.0 if rank == 0 else 3.0))
        recording.log(f"{entity}/ticks", marks, static=True)
        if rank == 0:
            recording.log(f"{entity}/ticks/time", _labels(points, [f"{s:g} s" for s in stamps], _GRID), static=True)


def _round_interval(seconds: float) -> float:
    """Return the least of 1, 2, 5, 10, 20, 30, 60 s and whole minutes that is no shorter."""
    return next((float(s) for s in (1, 2, 5, 10, 20, 30, 60) if s >= seconds), 60.0 * math.ceil(seconds / 60.0))


def _write_signpost(recording: rr.RecordingStream, track: Track, extent: Extent, rank: int) -> None:
    """Log a robot's name beyond its end, the higher the later its rank."""
    entity = f"world/{track.name}/end"
    post = np.append(extent.end + extent.post * extent.along, 0.045 * extent.distance * (rank + 1.0))
    end = [np.append(track.pieces[-1].xy[-1], 0.01), post]
    recording.log(entity, _lines([end], colour(track.name), 0.7), static=True)
    recording.log(f"{entity}/name", _labels([post], [track.name], track.bright), static=True)


def _write_target(recording: rr.RecordingStream, target: Track, scale: float) -> None:
    """Log a post with an arrow along the target's heading, as high as robots of this scale ask for, over time."""
    pose, top = target.pose[target.rows], [0.0, 0.0, 0.5 * scale]
    arrow = rr.Arrows3D(origins=[top], vectors=[[0.45 * scale, 0.0, 0.0]], colors=[_TARGET], radii=[0.025 * scale])
    recording.log("world/target", arrow, static=True)
    recording.log("world/target/post", _lines([[[0.0, 0.0, 0.0], top]], _TARGET, 2.5), static=True)
    time = rr.TimeColumn(_TIMELINE, duration=target.t[target.rows])
    translation = np.column_stack([pose[:, :2], target.terrain.height_at(pose[:, :2])])
    quat_xyzw = quat_wxyz_to_xyzw(yaw_to_quat_wxyz(pose[:, 2]))
    recording.send_columns("world/target", [time], rr.Transform3D.columns(translation=translation, quaternion=quat_xyzw))


def _write_ground(recording: rr.RecordingStream, track: Track, extent: Extent) -> None:
    """Log the ground below all paths and around them, just below the lines that are drawn on it."""
    terrain, margin = track.terrain, 0.5 * extent.reach + 5.0 * max(extent.scale, 1.0)
    low, high = extent.middle - margin, extent.middle + margin
    count = _MOST_POINTS if terrain.kind == "rough" else 2
    x, y = (np.linspace(a, b, count) for a, b in zip(low, high, strict=True))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    slopes = terrain.surface.at(points) if terrain.kind == "rough" else np.zeros((len(points), 3))
    normals = np.column_stack([-6.0 * slopes[:, 1:], np.ones(len(points))])  # steeper, so that low bumps show
    corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).reshape(-1)
    triangles = [(corner, corner + 1, corner + count + 1), (corner, corner + count + 1, corner + count)]
    ground = rr.Mesh3D(
        vertex_positions=np.column_stack([points, slopes[:, 0] - _BELOW]),
        triangle_indices=np.vstack([np.column_stack(half) for half in triangles]),
        vertex_normals=normals / np.linalg.norm(normals, axis=1)[:, None],
        albedo_factor=(*GROUND, 255),
    )
    recording.log("world/ground", ground, static=True)
    if terrain.kind == "split":
        along = np.array([math.cos(terrain.edge_heading), math.sin(terrain.edge_heading)])
        right = np.array([along[1], -along[0]])
        middle = extent.middle - (terrain.edge_offset + extent.middle @ right) * right + margin * right
        box = rr.Boxes3D(
            half_sizes=[[margin, margin, 0.5 * _BELOW]], centers=[[*middle, -_BELOW]], colors=[OTHER_GROUND],
            quaternions=[[0.0, 0.0, math.sin(0.5 * terrain.edge_heading), math.cos(0.5 * terrain.edge_heading)]],
            fill_mode=rr.components.FillMode.Solid,
        )  # fmt: skip
        recording.log("world/ground/other", box, static=True)
    if terrain.kind == "ramp" and terrain.slope > 0.0:
        downhill = -1.2 * extent.scale * np.array([math.cos(terrain.toward), math.sin(terrain.toward), 0.0])
        words = f"downhill, {math.degrees(terrain.slope):g}°"
        arrow = rr.Arrows3D(origins=[[0.0, 0.0, 0.02]], vectors=[downhill], radii=[0.02 * extent.scale], labels=[words])
        recording.log("world/ground/downhill", arrow, static=True)


# --- lines over time ---


def _write_series(recording: rr.RecordingStream, entity: str, series: Series, gaps: FloatArray) -> None:
    """Send the samples; at each instant of `gaps` [s] the lines are interrupted."""
    mode = rr.components.InterpolationMode.StepAfter if series.held else rr.components.InterpolationMode.Linear
    names, widths = list(series.names), [1.0 if series.held else 1.5] * len(series.names)
    style = rr.SeriesLines(names=names, colors=list(series.colours), widths=widths, interpolation_mode=mode)
    recording.log(entity, style, static=True)
    time = rr.TimeColumn(_TIMELINE, duration=series.t)
    recording.send_columns(entity, [time], rr.Scalars.columns(scalars=series.values))
    if len(gaps):
        time = rr.TimeColumn(_TIMELINE, duration=gaps)
        recording.send_columns(entity, [time], rr.Clear.columns(is_recursive=[False] * len(gaps)))


def _write_history(recording: rr.RecordingStream, history: History) -> None:
    """Send the values of all steps."""
    entity, steps = f"history/{history.title}", rr.TimeColumn(history.timeline, sequence=np.arange(len(history.values)))
    style = rr.SeriesLines(names=list(history.names), colors=list(history.colours), widths=[1.5] * len(history.names))
    recording.log(entity, style, static=True)
    values = np.where(np.isfinite(history.values), history.values, np.nan)
    recording.send_columns(entity, [steps], rr.Scalars.columns(scalars=values))


# --- the layout ---


def _layout(scene: Scene) -> rrb.Blueprint:
    """Return looks at the robots, the report and histories on the left, plots on the right; it plays at once."""
    first, extent = scene.tracks[0], Extent(scene.tracks)
    names = [f"- /world/{track.name}/end/**" for track in scene.tracks]
    middle = np.append(extent.middle + 0.6 * extent.post * extent.along, 0.0)
    aside = middle + extent.distance * np.append(-math.cos(0.75) * extent.across, math.sin(0.75))
    above = middle + np.array([0.0, 0.0, 1.1 * extent.distance])
    scale = extent.scale
    behind = np.append(shift_reference(first.pose[0], (-1.5 * scale, -1.2 * scale))[:2], 1.15 * scale)
    hull = looks_of(first.robot).solids["base"][0].kind.lower()
    near = _eye(behind, np.append(first.pose[0][:2], 0.2 * scale), follow=f"/world/{first.name}/robot/base/{hull}")
    looks = [
        _view("Scene (grid 1 m)", _eye(aside, middle)),
        _view("From above", _eye(above, middle, up=np.append(extent.across, 0.0)), names),
        rrb.TextDocumentView(origin="/report", name="Report"),
    ]
    for h in scene.histories:
        looks.append(rrb.TimeSeriesView(origin=f"/history/{h.title}", name=f"{h.title} (timeline '{h.timeline}')"))
    close = _view(f"Following {first.name}", near, [*names, f"- /world/{first.name}/ticks/time"])
    left = rrb.Vertical(rrb.Tabs(*looks), close, row_shares=[6, 5])
    span = float(first.t[0]), float(first.t[-1])
    groups = [[_plot(scene, entity, title, span) for entity, title in group.items()] for group in scene.views]
    tabs = [[view for views in group for view in views] for group in groups]
    right = rrb.Vertical(*(rrb.Tabs(*views) for views in tabs if views))
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[8, 5]),
        rrb.TimePanel(timeline=_TIMELINE, state="collapsed", play_state="playing", loop_mode="off"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _plot(scene: Scene, entity: str, title: str, span: tuple[float, float]) -> list[rrb.TimeSeriesView]:
    """A view of all series below `plots/<entity>`, with room for a legend; none where there is no such series."""
    drawn = [series.values for name, series in scene.plots.items() if f"{name}/".startswith(f"{entity}/")]
    if not drawn:
        return []
    at, duration = rr.TimeRangeBoundary.absolute, max(span[1] - span[0], 0.1)
    shown = rr.TimeRange(start=at(seconds=span[0]), end=at(seconds=span[0] + (1.0 + _LEGEND_SHARE) * duration))
    x, y = rrb.TimeAxis(view_range=shown), rrb.ScalarAxis(range=axis_range(drawn))
    return [rrb.TimeSeriesView(origin=f"/plots/{entity}", name=title, axis_x=x, axis_y=y, plot_legend=rrb.Corner2D.RightTop)]


def axis_range(drawn: Sequence[FloatArray]) -> tuple[float, float]:
    """Return the least and the greatest value on an axis.

    The viewer would take in a zero wherever a line is interrupted, and write numbers only at whole powers of ten where finer
    ones have no room: a range that holds but one of those is widened to the next.
    """
    low, high = min(float(v.min()) for v in drawn), max(float(v.max()) for v in drawn)
    step = 10.0 ** math.floor(math.log10(max(high - low, 1e-3)))
    if high - low > 1.3 * step and math.floor(high / step) - math.ceil(low / step) < 1:
        low, high = step * math.floor(low / step), step * math.ceil(high / step)
    margin = 0.05 * max(high - low, 1e-3)
    return low - margin, high + margin


def _view(name: str, looks: rrb.EyeControls3D, without: Sequence[str] = ()) -> rrb.Spatial3DView:
    """Return a view of the world, seen by an eye."""
    grid = rrb.LineGrid3D(visible=True, spacing=1.0, stroke_width=1.0, color=_GRID)
    seen = ["/world/**", *without]
    return rrb.Spatial3DView(name=name, origin="/world", contents=seen, background=_SKY, line_grid=grid, eye_controls=looks)


def _eye(
    position: FloatArray, target: FloatArray, up: FloatArray | None = None, follow: str | None = None
) -> rrb.EyeControls3D:
    """Return an eye that turns about `target`, which stays where it is unless an entity is to be followed."""
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=position, look_target=target, eye_up=up, tracking_entity=follow
    )
