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

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from ssmr.geometry import wrap_angle
from ssmr.types import FloatArray
from validation.report.motions import Comparison
from validation.report.palette import Rgb, colour, mix
from validation.report.rerun_file import encode, rr, write_about
from validation.report.rerun_layout import (
    Series,
    blueprint,
    eye,
    follower,
    overviews,
    plot_view,
    rrb,
    thinning_note,
    view,
    write_series,
)
from validation.report.rerun_robots import (
    BLACK,
    SOLID,
    WHITE,
    Extent,
    Track,
    identify,
    labels,
    opacity_of,
    outline,
    round_interval,
    write_ground,
    write_motion,
    write_patch,
    write_path,
    write_robot,
    write_signpost,
)
from validation.report.robot_mesh import RobotMesh, robot_mesh
from validation.simulator.description import WHEELS
from validation.simulator.terrain import FLAT
from validation.simulator.wheel_loads import QUASI_STATIC
from validation.store import write_atomic

LINEUP_GAP = np.array([1.75, 1.25, 0.0])
"""Distance between rows and between neighbours in the line-up, for robots as large as a Husky [m]."""
ABREAST = 3
"""Robots in a row of the line-up."""
PLACE: Rgb = (70, 74, 80)
COMMANDED: Rgb = (86, 180, 233)
WHEEL_COLOURS = tuple(colour(name) for name in ("mujoco", "improved", "coulomb", "linear"))


@dataclass(frozen=True, eq=False)
class History:
    """Values that change from step to step of a search, not over the robots' time."""

    what: str
    """Name of the entity, below `history/`."""
    title: str
    timeline: str
    """Name of the timeline that counts the steps."""
    names: tuple[str, ...]
    """k names."""
    colours: tuple[Rgb, ...]
    """k colours."""
    values: FloatArray
    """(G, k), of the steps 0 to G - 1; where one is not finite, the line is interrupted."""


def write_recording(comparison: Comparison, path: Path, text: str | None = None, histories: Sequence[History] = ()) -> None:
    """Write a comparison, its report and histories as a rerun recording, whole or not at all.

    The recording's id is a digest of what was asked for and of the motions that came out: a run that is repeated compares
    equal, and two that differ can be open in one viewer.

    Raises:
        OSError: the file cannot be written.
        RuntimeError: rerun is switched off by `RERUN=off`.
    """
    c, tracks = comparison, compared_tracks(comparison)
    text = comparison.markdown() if text is None else text

    def fill(recording: rr.RecordingStream) -> None:
        plots = _command_plots(comparison)
        for track in tracks:
            plots.update(_plots_of(track))
        gaps = np.array([0.5 * (a.t[-1] + b.t[0]) for a, b in pairwise(c.reference)])
        recording.send_blueprint(_layout(tracks, plots, histories))
        options = {name: str(value) for name, value in c.options.items()}
        about, versions = c.facts, c.versions
        properties: dict[str, Mapping[str, object]] = {"comparison": about, "options": options, "versions": versions}
        report = text + thinning_note(tracks, plots)
        write_about(recording, f"{c.source}, profile {c.profile_label}", properties, report)
        _write_scene(recording, tracks)
        for entity, series in plots.items():
            write_series(recording, f"plots/{entity}", series, gaps)
        for history in histories:
            _write_history(recording, history)

    identity = identify((c.source, c.profile, c.robot.name, c.reference_name, c.seed, sorted(c.options.items())), tracks)
    data = encode("compare", identity, fill)
    write_atomic(path, lambda temporary: temporary.write_bytes(data))


def compared_tracks(comparison: Comparison) -> list[Track]:
    """Return all robots, the reference first."""
    plants = comparison.plants
    known = plants.get(comparison.reference_name) or next(iter(plants.values()))  # where a recording was tracked, they say
    ground = comparison.terrain
    reference = Track(comparison.reference_name, comparison.reference, None, known.localiser, ground, comparison.robot)
    others = [result for result in plants.values() if result.name != reference.name]
    return [
        reference,
        *(Track(result.name, result.pieces, reference, result.localiser, ground, comparison.robot) for result in others),
    ]


def _write_scene(recording: rr.RecordingStream, tracks: Sequence[Track]) -> None:
    """Log ground, robots, paths and labels, of the world and of the line-up."""
    robot, extent, close = robot_mesh(tracks[0].robot), Extent(tracks), _stays_close(tracks)
    gap = _gap(robot)
    recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    write_ground(recording, "world/ground", tracks[0].terrain, extent)
    write_patch(recording, "lineup/ground", FLAT, np.full(2, -50.0), np.full(2, 50.0))
    interval = round_interval((tracks[0].t[-1] - tracks[0].t[0]) / 8.0)
    for rank, track in enumerate(tracks):
        world, lineup, place = f"world/{track.name}", f"lineup/{track.name}", _place(rank, len(tracks), gap)
        opacity = opacity_of(robot, None if track.reference is None else track.apart)
        write_robot(recording, f"{world}/robot", robot, track, opacity)
        write_motion(recording, f"{world}/robot", robot, track, track.body, track.raised)
        write_path(recording, track, interval)
        write_robot(recording, f"{lineup}/robot", robot, track, SOLID)
        write_motion(recording, f"{lineup}/robot", robot, track, track.seen * ([1, 1, 1] if close else [0, 0, 1]) + place)
        recording.log(f"{world}/robot/outline", outline(robot, robot.box[1, 2], track.colour), static=True)
        recording.log(f"{lineup}/place", outline(robot, 0.0, PLACE), rr.Transform3D(translation=place), static=True)
        name = f"{track.name} (reference)" if track.reference is None else track.name
        recording.log(f"{lineup}/name", labels([place + (0.3, 0.0, 0.75) * robot.scale], [name], track.bright), static=True)
        write_signpost(recording, track, extent, rank)


def _stays_close(tracks: Sequence[Track]) -> bool:
    """Return whether every robot stays closer to the reference's than its neighbour's place in the line-up."""
    return all(track.apart.max() < _gap(robot_mesh(track.robot))[1] for track in tracks)


def _gap(robot: RobotMesh) -> FloatArray:
    """(3,) distance between rows and between neighbours in the line-up [m]."""
    return LINEUP_GAP * robot.scale


def _place(rank: int, count: int, gap: FloatArray) -> FloatArray:
    """(3,) place of a robot in the line-up [m]: the first row from the left, later rows ahead of it."""
    row, column = divmod(rank, ABREAST)
    in_row = min(count - row * ABREAST, ABREAST)
    return gap * (row, 0.5 * (in_row - 1) - column, 0.0)


def _write_history(recording: rr.RecordingStream, history: History) -> None:
    """Send the values of all steps."""
    entity, steps = f"history/{history.what}", rr.TimeColumn(history.timeline, sequence=np.arange(len(history.values)))
    style = rr.SeriesLines(names=list(history.names), colors=list(history.colours), widths=[1.5] * len(history.names))
    recording.log(entity, style, static=True)
    values = np.where(np.isfinite(history.values), history.values, np.nan)
    recording.send_columns(entity, [steps], rr.Scalars.columns(scalars=values))


def _plots_of(track: Track) -> dict[str, Series]:
    """Return the series of one robot by entity."""

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
        pale = [mix(c, WHITE, 0.5) for c in WHEEL_COLOURS]
        plots[f"wheel_load/{track.name}_quasi_static"] = Series(names, pale, track.t, formula)
    return plots


def _command_plots(comparison: Comparison) -> dict[str, Series]:
    """Return the commands by entity: each at its instant, and the last once more at its end; empty without commands."""
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
    errors = [*plot("position_error", f"Position error to {name} [m]"), *plot("yaw_error", f"Yaw error to {name} [rad]")]
    report = rrb.TextDocumentView(origin="/report", name="Report")
    steps = [
        rrb.TimeSeriesView(origin=f"/history/{h.what}", name=f"{h.title} (choose the timeline '{h.timeline}')")
        for h in histories
    ]
    left = rrb.Vertical(rrb.Tabs(overview, above, report, *steps), rrb.Horizontal(lineup, close), row_shares=[6, 5])
    return blueprint(left, [errors, motion, wheels])


def _views_of_robots(tracks: Sequence[Track]) -> list[rrb.Spatial3DView]:
    """The scene from aside and from above, the line-up, and the reference's robot from near."""
    extent, reference = Extent(tracks), tracks[0].name
    rows = math.ceil(len(tracks) / ABREAST)
    gap, scale = _gap(robot_mesh(tracks[0].robot)), extent.scale
    heart = np.array([0.4 * gap[0] * (rows - 1), 0.1 * scale, 0.2 * scale])
    names = [f"- /world/{track.name}/end/**" for track in tracks]
    bodies = [f"- /world/{track.name}/robot/{body}" for track in tracks[1:] for body in ("base", *WHEELS)]

    how = "displaced" if _stays_close(tracks) else "turned"
    return [
        *overviews(extent, names),
        view(
            f"Side by side, {how} as seen from {reference}",
            "/lineup",
            eye(heart + scale * (3.1 + 0.5 * rows) * np.array([-0.73, -0.14, 0.62]), heart),
        ),
        follower(tracks[0], [*names, f"- /world/{reference}/ticks/time", *bodies]),
    ]
