"""Robots in motion as a rerun recording: one scene for every program that has motions.

The recording carries its own layout.
The world is in metres, z up, on the timeline `sim_time`; lines over time are in the units of the
picture:

- `world/NAME/robot`: the reference point on the ground over time; below it `base`, the four wheels,
  the robot's `name`, `contact_force`, the force of the ground on each wheel, and `rotation_centre`;
- `world/NAME/path`: the whole path;
- `world/target`: the moving target of a controller, an arrow along its heading;
- `plots/QUANTITY/NAME`: lines over time;
- `report`: the report as text.
"""

from __future__ import annotations

import hashlib
import os
import uuid
from collections.abc import Iterable, Sequence
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np

os.environ.setdefault("RERUN_ANALYTICS", "false")  # rerun looks at it when it is imported

try:
    import rerun as rr
    import rerun.blueprint as rrb
except ImportError as missing:
    raise ImportError(
        "recordings need the package rerun-sdk; save(folder, recording=False) does without"
    ) from missing

from ssmr.geometry import quat_wxyz_to_xyzw, shift_reference, yaw_to_quat_wxyz
from ssmr.robot.ground import LEFT
from ssmr.types import FloatArray
from validation.output import Document, each_line, one_line, return_memory, write_atomic
from validation.report.columns import Unit, length_unit
from validation.report.palette import BLACK, WHITE, mix_colours, plant_colour
from validation.report.report import Report
from validation.report.scene_robots import (
    GROUND,
    Extent,
    Plots,
    Series,
    Track,
    bright_colour,
    looks_of,
    shades_of,
)
from validation.simulator.description import WHEELS
from validation.simulator.wheel_loads import QUASI_STATIC

_TIMELINE = "sim_time"
_GRID = (186, 191, 198)
_SKY = (238, 240, 243)
_TARGET = (20, 20, 24)
_BELOW = 0.004
"""The ground is drawn so much too low, so that lines on it show [m]."""
_LOAD_LENGTH = 0.45
"""Length of the arrow of a mean wheel load, of a robot of a Husky's size [m]."""
_LEAST_TURNING = 0.05
"""Yaw rate below which the centre of rotation is far off, and noise moves it by metres [rad/s]."""
_NEAR = 1.5
"""Distance up to which that centre is drawn, of a robot of a Husky's size [m]."""
_ABOVE = 0.07
"""Height of a name above the one before, over the distance of the eye: names never overlap."""
_LEGEND = 0.48
"""The time that is left free for the legend, to the right of all lines, over theirs.

It is less than half, or the axis would often end at a round number, whose label is cut."""
_VIEWS = (
    {
        "position_error": "Position error",
        "yaw_error": "Yaw error",
        "e_rho": "e_rho: how far ahead the target is",
        "e_y": "e_y: its offset to the left",
        "e_alpha": "e_alpha: error of heading",
    },
    {
        "yaw_rate": "Yaw rate",
        "yaw_acceleration": "Yaw acceleration",
        "speed": "Speed",
        "side_speed": "Speed to the left",
        "rotation_centre": "Centre of rotation, ahead",
        "wheel_rate": "Commanded wheel rates",
    },
    {
        "wheel_load": "Wheel loads",
        "force_x": "Forces along the wheels",
        "force_y": "Forces across the wheels",
        "torque": "Motor torques on each side",
    },
)
"""Groups of plots above one another, a tab each: titles by the quantity, which is the beginning of
their entities."""


def write_scene(
    report: Report,
    title: str,
    tracks: Sequence[Track],
    plots: Plots,
    path: Path,
    target: Track | None = None,
) -> None:
    """Write robots in motion as a rerun recording, whole or not at all.

    Args:
        report: the report that stands beside them; recordings of one program share a layout in the
            viewer.
        title: name of the recording in the viewer's list.
        tracks: the robots; the first one's is solid, and the eye follows it.
        plots: lines over time besides those that follow from the motions.
        path: where to.
        target: a moving target, if there is one.

    Raises:
        OSError: the file cannot be written.
        RuntimeError: rerun is switched off by `RERUN=off`.
    """
    identity = _identity_of(title, tracks)
    recording = rr.RecordingStream(
        f"ssmr-testbed {report.program}", recording_id=identity, send_properties=False
    )
    if not recording.is_enabled():
        raise RuntimeError(
            "rerun is switched off: unset the environment variable RERUN to write recordings"
        )
    stream = recording.binary_stream()
    strict = rr.strict_mode()
    rr.set_strict_mode(True)  # else rerun warns and leaves something out
    try:
        recording.send_recording_name(one_line(title))
        text = each_line(report.to_markdown())
        document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
        recording.log("report", document, static=True)
        _fill_recording(recording, tracks, plots, target)
    finally:
        rr.set_strict_mode(strict)
        data = stream.read()  # rerun complains of a stream that is not read
    if not data:
        raise RuntimeError("rerun encoded nothing")
    write_atomic(path, lambda temporary: temporary.write_bytes(data))


def _identity_of(title: str, tracks: Sequence[Track]) -> uuid.UUID:
    """Return a recording's id: a digest of its title and its motions.

    A run that is repeated compares equal, and two that differ can be open in one viewer.
    """
    digest = hashlib.sha256(title.encode(errors="surrogateescape"))
    for track in tracks:
        for part in (track.name.encode(), track.t.data, track.pose.data):
            digest.update(part)
    return uuid.UUID(bytes=digest.digest()[:16], version=4)


def _fill_recording(
    recording: rr.RecordingStream, tracks: Sequence[Track], plots: Plots, target: Track | None
) -> None:
    unit = length_unit([track.errors[0].max() for track in tracks])
    lines: Plots = {}
    for track in tracks:
        lines |= _plots_of(track, unit)
    lines |= plots
    return_memory()  # rerun has its own
    extent = Extent(tracks)
    recording.send_blueprint(_make_layout(tracks, lines, extent))
    parts = [[("/", None, rr.ViewCoordinates.RIGHT_HAND_Z_UP)], _ground_parts(extent)]
    for rank, track in enumerate(tracks):
        parts += [
            _robot_parts(track, rank == 0),
            _path_parts(track, rank),
            _name_parts(track, rank, extent),
        ]
    if target is not None:
        parts += [_path_parts(target, 0), _target_parts(target, extent.scale)]
    # lines are interrupted in the middle of each gap
    gaps = np.array([0.5 * (a.t[-1] + b.t[0]) for a, b in pairwise(tracks[0].pieces)])
    parts += [_line_parts(f"plots/{entity}", each, gaps) for entity, each in lines.items()]
    for entity, t, values in chain.from_iterable(parts):
        if t is None:
            recording.log(entity, values, static=True)
        else:
            recording.send_columns(entity, [rr.TimeColumn(_TIMELINE, duration=t)], values)


_Parts = Iterable[tuple[str, FloatArray | None, Any]]
"""Parts of a recording: entity, stamps [s] or None for what does not change, and values."""


# --- the world ---


def _robot_parts(track: Track, solid: bool) -> _Parts:
    """A robot's bodies and its motion.

    One beside another is drawn transparent, in shades of its plant's colour.
    """
    looks = looks_of(track.robot)
    entity = f"world/{track.name}/robot"
    for body, solids in looks.solids.items():
        for kind, of_kind in solids.items():
            yield f"{entity}/{body}/{kind}", None, _make_shapes(kind, of_kind, track, solid)
    rows = track.rows
    t = track.t[rows]
    turns = track.turns[rows]
    zero = np.zeros(len(rows))
    yield entity, t, _pose_columns(track.body[rows])
    yield f"{entity}/base", None, rr.Transform3D(translation=looks.places["base"])
    for wheel in WHEELS:
        # about y, the axle: a positive turn rolls forward
        half = 0.5 * turns[:, 0 if wheel.endswith("left") else 1]
        quat_xyzw = np.column_stack([zero, np.sin(half), zero, np.cos(half)])
        # a static one would not combine with turns over time
        translation = np.tile(looks.places[wheel], (len(rows), 1))
        turned = rr.Transform3D.columns(translation=translation, quaternion=quat_xyzw)
        yield f"{entity}/{wheel}", t, turned
    yield from _force_parts(track)
    yield from _centre_parts(track)


def _force_parts(track: Track) -> _Parts:
    """The forces of the ground as arrows in the robot's axes, where its plant has them.

    They stand beside the wheels, because these would hide them.
    """
    names = ("force_x_N", "force_y_N", "wheel_load_N")
    channels = [channel for channel in map(track.channel, names) if channel is not None]
    if len(channels) < len(names):
        return
    looks = looks_of(track.robot)
    rows = track.rows
    forces = np.stack(channels, axis=-1)  # (M, 4, 3)
    # arrows are seen beside a robot of any weight
    mean_load = max(float(forces[:, :, 2].mean()), 1e-9)
    vectors = _LOAD_LENGTH * looks.scale / mean_load * forces[rows]
    outwards = 0.6 * track.robot.wheel_width * LEFT
    below = []
    for wheel, beside in zip(WHEELS, outwards.tolist(), strict=True):
        x, y, _ = looks.places[wheel]
        below.append([x, y + beside, 0.0])
    entity = f"world/{track.name}/robot/contact_force"
    look = rr.Arrows3D.from_fields(colors=[bright_colour(track.name)], radii=[0.012 * looks.scale])
    yield entity, None, look
    origins = np.tile(below, (len(rows), 1))
    columns = rr.Arrows3D.columns(vectors=vectors.reshape(-1, 3), origins=origins)
    yield entity, track.t[rows], columns.partition([len(WHEELS)] * len(rows))


def _centre_parts(track: Track) -> _Parts:
    """The point of the robot's plane that stands, while the robot turns and it is near."""
    rows = track.rows
    scale = looks_of(track.robot).scale
    centre = rotation_centre(track)[rows]
    near = np.hypot(centre[:, 0], centre[:, 1]) < _NEAR * scale  # not where it is NaN
    entity = f"world/{track.name}/robot/rotation_centre"
    look = rr.Points3D.from_fields(colors=[bright_colour(track.name)], radii=[0.04 * scale])
    yield entity, None, look
    places = np.column_stack([centre[near], np.zeros(np.count_nonzero(near))])
    points = rr.Points3D.columns(positions=places).partition(near.astype(int))
    yield entity, track.t[rows], points


def _pose_columns(pose: FloatArray) -> Any:
    """(M, 3) poses [m, m, rad] on the ground as columns."""
    translation = np.column_stack([pose[:, :2], np.zeros(len(pose))])
    quat_xyzw = quat_wxyz_to_xyzw(yaw_to_quat_wxyz(pose[:, 2]))
    return rr.Transform3D.columns(translation=translation, quaternion=quat_xyzw)


def _make_shapes(
    kind: str, solids: Sequence[Sequence[FloatArray]], track: Track, opaque: bool
) -> Any:
    modes = rr.components.FillMode
    sizes, middles, quats, colours = (np.array(part) for part in zip(*solids, strict=True))
    if track.name != "mujoco":
        shade = 0.4 + 0.6 * colours[:, :3].max(axis=1, keepdims=True)
        colours[:, :3] = shade * np.array(bright_colour(track.name)) / 255.0
    look: Document = {
        "colors": np.round(255.0 * colours).astype(np.uint8),
        "fill_mode": modes.Solid if opaque else modes.TransparentFillMajorWireframe,
        "quaternions": [quat_wxyz_to_xyzw(quat) for quat in quats],
    }
    if kind == "cylinder":
        return rr.Cylinders3D(lengths=2.0 * sizes[:, 1], radii=sizes[:, 0], centers=middles, **look)
    return rr.Boxes3D(half_sizes=sizes, centers=middles, **look)


def _path_parts(track: Track, rank: int) -> _Parts:
    """The path, one strip a piece."""
    ink = plant_colour(track.name)
    height = 0.008 if rank else 0.012
    strips = []
    for piece, kept in zip(track.pieces, track.shown, strict=True):
        xy = piece.xy[kept]
        strips.append(np.column_stack([xy, np.full(len(xy), height)]))
    width = rr.Radius.ui_points(2.0 if rank else 3.0)
    yield f"world/{track.name}/path", None, rr.LineStrips3D(strips, colors=[ink], radii=width)


def _name_parts(track: Track, rank: int, extent: Extent) -> _Parts:
    """The robot's name above it, the higher, the later its rank."""
    height = looks_of(track.robot).size[2] + _ABOVE * (rank + 1.5) * extent.distance
    label = rr.Points3D(
        [[0.0, 0.0, height]],
        labels=[track.name],
        colors=[
            mix_colours(plant_colour(track.name), BLACK, 0.65)
        ],  # on grey of a dark theme, and on light ground
        radii=rr.Radius.ui_points(1.0),
    )
    yield f"world/{track.name}/robot/name", None, label


def _target_parts(target: Track, scale: float) -> _Parts:
    arrow = rr.Arrows3D(
        origins=[[0.0, 0.0, 0.5 * scale]],
        vectors=[[0.45 * scale, 0.0, 0.0]],
        colors=[_TARGET],
        radii=[0.025 * scale],
    )
    yield "world/target", None, arrow
    yield "world/target", target.t[target.rows], _pose_columns(target.pose[target.rows])


def _ground_parts(extent: Extent) -> _Parts:
    """The ground below all paths and around them, just below the lines that are drawn on it."""
    margin = 0.5 * extent.reach + 5.0 * max(extent.scale, 1.0)
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    corners = extent.middle + margin * square
    ground = rr.Mesh3D(
        vertex_positions=np.column_stack([corners, np.full(4, -_BELOW)]),
        triangle_indices=[[0, 1, 2], [0, 2, 3]],
        vertex_normals=[[0.0, 0.0, 1.0]] * 4,
        albedo_factor=(*GROUND, 255),
    )
    yield "world/ground", None, ground


# --- lines over time ---


def _line_parts(entity: str, series: Series, gaps: FloatArray) -> _Parts:
    """The samples, thinned where there are very many.

    At each instant of `gaps` [s] the lines are interrupted.
    """
    mode = rr.components.InterpolationMode.Linear
    if series.held:
        mode = rr.components.InterpolationMode.StepAfter
    names = list(series.names)
    colours = list(series.colours)
    yield entity, None, rr.SeriesLines(names=names, colors=colours, interpolation_mode=mode)
    shown = series.thinned()
    yield entity, shown.t, rr.Scalars.columns(scalars=shown.values)
    if len(gaps):
        yield entity, gaps, rr.Clear.columns(is_recursive=[False] * len(gaps))


def _plots_of(track: Track, length: Unit) -> Plots:
    """Return the lines over time of one robot by entity.

    They are velocities, errors (in `length`), torques and the forces of the ground.
    """
    twist = np.concatenate([p.twist for p in track.pieces])
    body_twist = track.localiser.body_twist(twist)
    name = track.name
    ink = bright_colour(name)
    alone = [name], [ink]
    # four that can be told apart
    inks = [plant_colour(plant) for plant in ("mujoco", "improved", "coulomb", "linear")]
    wheels = [wheel.replace("_", " ") for wheel in WHEELS], inks
    # one entry of the legend
    pale = ["quasi-static"] * len(WHEELS), [mix_colours(ink, WHITE, 0.5) for ink in inks]
    sides = [f"{name} left", f"{name} right"], shades_of(ink)
    lines = [
        (f"speed/{name}", "m/s", twist[:, 0], alone),
        (f"side_speed/{name}", "m/s", body_twist[:, 1], alone),
        (f"rotation_centre/{name}", "m", rotation_centre(track)[:, 0], alone),
        (f"yaw_rate/{name}", "rad/s", twist[:, 2], alone),
        (f"yaw_acceleration/{name}", "rad/s²", track.channel("yaw_acceleration_rad_s2"), alone),
        (f"torque/{name}", "N m", track.channel("torque_N_m"), sides),
        *(
            (f"{kind}/{name}", "N", track.channel(f"{kind}_N"), wheels)
            for kind in ("wheel_load", "force_x", "force_y")
        ),
        (f"wheel_load/{name}_quasi_static", "N", track.channel(QUASI_STATIC), pale),
    ]
    if track.reference is not None:
        distance, turn = track.errors
        lines.append((f"position_error/{name}", length.symbol, length.scale * distance, alone))
        lines.append((f"yaw_error/{name}", "deg", np.degrees(turn), alone))
    # here already: all lines of hours would fill the memory
    return {
        entity: Series(names, unit, colours, track.t, values).thinned()
        for entity, unit, values, (names, colours) in lines
        if values is not None
    }


def rotation_centre(track: Track) -> FloatArray:
    """Return the (M, 2) centre of rotation ahead of the body's reference point and to its left [m].

    It is NaN where the robot hardly turns. There v_x - omega y = 0 and v_y + omega x = 0.
    """
    twist = track.localiser.body_twist(np.concatenate([p.twist for p in track.pieces]))
    turning = np.where(np.abs(twist[:, 2]) < _LEAST_TURNING, np.nan, twist[:, 2])
    return np.column_stack([-twist[:, 1], twist[:, 0]]) / turning[:, None]


# --- the layout ---


def _make_layout(tracks: Sequence[Track], plots: Plots, extent: Extent) -> rrb.Blueprint:
    """Return the layout: robots and report on the left, plots on the right; it plays at once."""
    units = {entity.partition("/")[0]: series.unit for entity, series in plots.items()}
    first = tracks[0].t[0]
    last = max(track.t[-1] for track in tracks)
    shown = rr.TimeRange(
        start=rr.TimeRangeBoundary.absolute(seconds=first),
        end=rr.TimeRangeBoundary.absolute(seconds=last + _LEGEND * (last - first)),
    )
    groups = []
    for group in _VIEWS:
        views = []
        for quantity, title in group.items():
            if quantity in units:
                view = rrb.TimeSeriesView(
                    origin=f"/plots/{quantity}",
                    name=f"{title} [{units[quantity]}]",
                    axis_x=rrb.TimeAxis(view_range=shown),
                    plot_legend=rrb.Corner2D.RightTop,
                )
                views.append(view)
        if views:
            groups.append(rrb.Tabs(*views))
    return rrb.Blueprint(
        rrb.Horizontal(
            _views_of_robots(tracks, extent), rrb.Vertical(*groups), column_shares=[8, 5]
        ),
        rrb.TimePanel(timeline=_TIMELINE, state="collapsed", play_state="playing", loop_mode="off"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _views_of_robots(tracks: Sequence[Track], extent: Extent) -> rrb.Vertical:
    """Return the whole scene with the report behind it, above a view of the first robot."""
    first = tracks[0]
    scale = extent.scale
    distance = extent.distance
    across = np.array([-extent.along[1], extent.along[0]])
    overview = np.append(extent.middle - 0.75 * distance * across, 0.7 * distance)
    whole = _world_view(
        "Scene (grid 1 m)", [], position=overview, look_target=np.append(extent.middle, 0.0)
    )
    start = first.pose[0]
    behind = shift_reference(start, (-1.5 * scale, -1.2 * scale))[:2]
    hull = next(iter(looks_of(first.robot).solids["base"]))
    close = _world_view(
        f"Following {first.name}",
        [f"- /world/{track.name}/robot/name" for track in tracks],
        position=np.append(behind, 1.15 * scale),
        look_target=np.append(start[:2], 0.2 * scale),
        tracking_entity=f"/world/{first.name}/robot/base/{hull}",
    )
    tabs = rrb.Tabs(whole, rrb.TextDocumentView(origin="/report", name="Report"))
    return rrb.Vertical(tabs, close, row_shares=[6, 5])


def _world_view(name: str, without: Sequence[str], **eye: Any) -> rrb.Spatial3DView:
    """Return a view of the world, seen by an eye that turns about its target."""
    grid = rrb.LineGrid3D(visible=True, spacing=1.0, stroke_width=1.0, color=_GRID)
    looks = rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, **eye)
    return rrb.Spatial3DView(
        name=name,
        origin="/world",
        contents=["/world/**", *without],
        background=_SKY,
        line_grid=grid,
        eye_controls=looks,
    )
