"""Robots that follow a reference as a rerun recording: a target moves on, the robots leave trails, plots say why.

Like a comparison's recording, in metres, seconds and radians on the timeline `sim_time`; see `validation.rerun_log`:

- `world/reference/path`, `.../ticks`: the whole reference, and where its target is at round times;
- `world/target`: the moving target, an arrow along its heading;
- `world/<plant>/robot`, `.../trail`, `.../end`: the robot, where it has been, its name where it ends;
- `plots/<quantity>/<plant>`, `plots/<quantity>/<plant>_wanted`, `..._command`: what is drawn over time;
- `report`: the report as text.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ssmr.geometry import quat_wxyz_to_xyzw, yaw_to_quat_wxyz
from validation.report.palette import Rgb, mix
from validation.report.rerun_file import TIMELINE, encode, rr, write_about
from validation.report.rerun_layout import (
    Series,
    blueprint,
    follower,
    overviews,
    plot_view,
    rrb,
    thinning_note,
    write_series,
)
from validation.report.rerun_robots import (
    BLACK,
    WHITE,
    Extent,
    Track,
    identify,
    lines,
    opacity_of,
    outline,
    round_interval,
    write_ground,
    write_motion,
    write_path,
    write_robot,
    write_signpost,
)
from validation.report.robot_mesh import robot_mesh
from validation.simulator.terrain import FLAT
from validation.store import write_atomic
from validation.track.data import TrackedRobot
from validation.track.table import headline, require_comparable, track_facts, track_markdown

_TRAIL_UPDATES, _TRAIL_POINTS = 200, 600  # a trail grows at most so many times, and has at most so many points
TRAIL_HEIGHT = 0.016
"""Just above the reference [m]."""
_TARGET_INK: Rgb = (20, 20, 24)
_QUANTITIES = (("speed", "m/s", "v_x", "u_ref", "v_cmd", 0), ("yaw_rate", "rad/s", "yaw_rate", "w_ref", "w_cmd", 2))
"""Velocities in plots: name, unit, columns of the actual, wanted and commanded one, and index in the target's twist."""
_ERRORS = (("e_rho", "m"), ("e_y", "m"), ("e_alpha", "rad"))


def write_track_rerun(results: Sequence[TrackedRobot], path: Path) -> None:
    """Write robots that followed one reference as a rerun recording, whole or not at all.

    Args:
        results: up to five, of different plants, on the same reference; the first one's robot is solid.
        path: the file, `.rrd`; one that is there already is replaced.

    Raises:
        ValueError: robots that cannot be shown beside one another.
        OSError: the file cannot be written.
        RuntimeError: rerun is switched off by `RERUN=off`.
    """
    require_comparable(results)
    first = results[0]
    *robots, reference = followed_tracks(results)

    def fill(recording: rr.RecordingStream) -> None:
        plots = _plots(results, reference)
        recording.send_blueprint(_layout([reference, *robots], plots))
        options = {name: str(value) for name, value in first.options.items()}
        about, versions = track_facts(first), first.versions
        properties: dict[str, Mapping[str, object]] = {"tracking": about, "options": options, "versions": versions}
        report = track_markdown(results) + thinning_note([reference, *robots], plots)
        write_about(recording, f"{headline(first)}, profile {first.profile_label}", properties, report)
        _write_scene(recording, reference, robots)
        for entity, series in plots.items():
            write_series(recording, f"plots/{entity}", series, np.empty(0))

    whose = first.profile, first.body.name, first.seed
    asked = (first.controller, sorted(first.gains.items()), first.reference, first.speed, *whose)
    data = encode("track", identify((*asked, sorted(map(repr, first.options.items()))), [reference, *robots]), fill)
    write_atomic(path, lambda temporary: temporary.write_bytes(data))


def followed_tracks(results: Sequence[TrackedRobot]) -> list[Track]:
    """Return the robots and, last, the target that they follow."""
    ground = next((r.terrain for r in results if r.terrain != FLAT), FLAT)  # planar models stand on none
    longest = max(results, key=lambda r: len(r.target)).target
    motions = [*((r.plant, r.run.motion) for r in results), ("reference", longest)]
    return [Track(name, (motion,), None, terrain=ground, robot=results[0].body) for name, motion in motions]


# --- the scene ---


def _write_scene(recording: rr.RecordingStream, reference: Track, robots: Sequence[Track]) -> None:
    """Log ground, reference, target, robots and their trails."""
    robot, extent, solid = robot_mesh(reference.robot), Extent([reference, *robots]), robots[0]
    recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    write_ground(recording, "world/ground", reference.terrain, extent)
    write_path(recording, reference, round_interval((reference.t[-1] - reference.t[0]) / 8.0))
    _write_target(recording, reference, extent.scale)
    for rank, track in enumerate(robots):
        entity, n = f"world/{track.name}/robot", min(len(track.t), len(solid.t))
        apart = None if rank == 0 else np.hypot(*(track.pose[:n, :2] - solid.pose[:n, :2]).T)
        write_robot(recording, entity, robot, track, opacity_of(robot, apart))
        write_motion(recording, entity, robot, track, track.pose, track.raised)
        recording.log(f"{entity}/outline", outline(robot, robot.box[1, 2], track.colour), static=True)
        _write_trail(recording, track)
        write_signpost(recording, track, extent, rank)


def _write_target(recording: rr.RecordingStream, reference: Track, scale: float) -> None:
    """Log a post with an arrow along the reference's heading, as high as robots of this scale ask for, over time."""
    pose, top = reference.pose[reference.shown], [0.0, 0.0, 0.5 * scale]
    arrow = [0.45 * scale, 0.0, 0.0]
    looks = rr.Arrows3D(origins=[top], vectors=[arrow], colors=[_TARGET_INK], radii=[0.025 * scale])
    recording.log("world/target", looks, static=True)
    post = lines([[[0.0, 0.0, 0.0], top]], _TARGET_INK, 2.5)
    recording.log("world/target/post", post, static=True)
    time = rr.TimeColumn(TIMELINE, duration=reference.t[reference.shown])
    translation = np.column_stack([pose[:, :2], reference.terrain.height_at(pose[:, :2])])
    quat_xyzw = quat_wxyz_to_xyzw(yaw_to_quat_wxyz(pose[:, 2]))
    recording.send_columns("world/target", [time], rr.Transform3D.columns(translation=translation, quaternion=quat_xyzw))


def _write_trail(recording: rr.RecordingStream, track: Track) -> None:
    """Log where a robot has been, as it grows."""
    every = max(1, math.ceil(len(track.t) / _TRAIL_POINTS))
    points = np.column_stack([track.pose[:, :2], TRAIL_HEIGHT + track.terrain.height_at(track.pose[:, :2])])
    ends = np.unique(np.linspace(0, len(track.t) - 1, _TRAIL_UPDATES).astype(np.intp))
    trails = [[np.vstack([points[: end + 1 : every], points[end]])] for end in ends]
    time = rr.TimeColumn(TIMELINE, duration=track.t[ends])
    strips = rr.LineStrips3D.columns(strips=[strip for trail in trails for strip in trail])
    recording.send_columns(f"world/{track.name}/trail", [time], strips)
    style = rr.LineStrips3D.from_fields(colors=[track.colour], radii=rr.Radius.ui_points(2.2))
    recording.log(f"world/{track.name}/trail", style, static=True)


# --- the plots ---


def _plots(results: Sequence[TrackedRobot], reference: Track) -> dict[str, Series]:
    """Return all series by entity below `plots`."""
    plots = dict[str, Series]()
    grey = mix(BLACK, WHITE, 0.6)
    (target,) = reference.pieces
    for quantity, unit, *_, column in _QUANTITIES:
        plots[f"{quantity}/reference"] = Series([f"reference [{unit}]"], [grey], target.t[:-1], target.twist[:-1, column])
    for r in results:
        name, run = r.plant, r.run
        ink = Track(name, (), None).bright
        pale, dark = mix(ink, WHITE, 0.5), mix(ink, BLACK, 0.3)
        for quantity, unit, done, wanted, commanded, _ in _QUANTITIES:
            plots[f"{quantity}/{name}"] = Series([f"{name} [{unit}]"], [ink], run.t, run.column(done))
            plots[f"{quantity}/{name}_wanted"] = Series([f"{name} wanted [{unit}]"], [pale], run.t, run.column(wanted))
            command = Series([f"{name} command [{unit}]"], [dark], run.t, run.column(commanded), held=True)
            plots[f"{quantity}/{name}_command"] = command
        for error, unit in _ERRORS:
            plots[f"{error}/{name}"] = Series([f"{name} [{unit}]"], [ink], run.t, run.column(error))
        names = [f"{name} {side} [N m]" for side in ("left", "right")]
        shades = [mix(ink, WHITE, 0.35), mix(ink, BLACK, 0.25)]
        plots[f"torque/{name}"] = Series(names, shades, run.t, run.columns("torque_left", "torque_right"))
    return plots


def _layout(tracks: Sequence[Track], plots: Mapping[str, Series]) -> rrb.Blueprint:
    """Return looks at the robots and the report on the left, plots on the right."""
    names = [f"- /world/{track.name}/end/**" for track in tracks]
    scene, above = overviews(Extent(tracks), names)
    bodies = [f"- /world/{track.name}/robot/**" for track in tracks[2:]]
    close = follower(tracks[1], [*names, "- /world/reference/ticks/time", *bodies])
    report = rrb.TextDocumentView(origin="/report", name="Report")
    left = rrb.Vertical(rrb.Tabs(scene, above, report), close, row_shares=[6, 5])
    span = (0.0, max(float(track.t[-1]) for track in tracks[1:]))
    titles = {
        "speed": "Speed, wanted and commanded [m/s]",
        "yaw_rate": "Yaw rate, wanted and commanded [rad/s]",
        "e_rho": "e_rho: distance to the target [m]",
        "e_y": "e_y: its offset to the left [m]",
        "e_alpha": "e_alpha: error of heading [rad]",
        "torque": "Torques of the sides [N m]",
    }
    views = {entity: plot_view(plots, entity, title, span) for entity, title in titles.items()}
    errors = [view for error, _ in _ERRORS for view in views[error]]
    return blueprint(left, [views["speed"], views["yaw_rate"], errors, views["torque"]])
