"""Robots that follow a reference as a rerun recording: the robots and the moving target, and plots that say why."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from validation.report.palette import mix
from validation.report.scene import Scene, write_scene
from validation.report.tracks import BLACK, WHITE, Series, Track
from validation.simulator.terrain import FLAT
from validation.track.data import TrackedRobot
from validation.track.table import headline, require_comparable, track_facts, track_markdown

_QUANTITIES = (("speed", "m/s", "v_x", "u_ref", "v_cmd", 0), ("yaw_rate", "rad/s", "yaw_rate", "w_ref", "w_cmd", 2))
"""Velocities in plots: name, unit, columns of the actual, wanted and commanded one, and index in the target's twist."""
_ERRORS = (("e_rho", "m"), ("e_y", "m"), ("e_alpha", "rad"))
_VIEWS = (
    {"speed": "Speed, wanted and commanded [m/s]"},
    {"yaw_rate": "Yaw rate, wanted and commanded [rad/s]"},
    {
        "e_rho": "e_rho: distance to the target [m]",
        "e_y": "e_y: its offset to the left [m]",
        "e_alpha": "e_alpha: error of heading [rad]",
    },
    {"torque": "Torques of the sides [N m]"},
)


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
    *robots, target = followed_tracks(results)
    options = {name: str(value) for name, value in first.options.items()}
    scene = Scene(
        program="track",
        title=f"{headline(first)}, profile {first.profile_label}",
        tracks=robots,
        plots=_plots(results, target),
        views=_VIEWS,
        report=track_markdown(results),
        about={"tracking": track_facts(first), "options": options, "versions": first.versions},
        target=target,
    )
    write_scene(scene, path)


def followed_tracks(results: Sequence[TrackedRobot]) -> list[Track]:
    """Return the robots and, last, the target that they follow."""
    ground = next((r.terrain for r in results if r.terrain != FLAT), FLAT)  # planar models stand on none
    longest = max(results, key=lambda r: len(r.target)).target
    motions = [*((r.plant, r.run.motion) for r in results), ("reference", longest)]
    return [Track(name, (motion,), None, terrain=ground, robot=results[0].body) for name, motion in motions]


def _plots(results: Sequence[TrackedRobot], target: Track) -> dict[str, Series]:
    """Return all series by entity below `plots`."""
    plots = dict[str, Series]()
    grey = mix(BLACK, WHITE, 0.6)
    (motion,) = target.pieces
    for quantity, unit, *_, column in _QUANTITIES:
        plots[f"{quantity}/reference"] = Series([f"reference [{unit}]"], [grey], motion.t[:-1], motion.twist[:-1, column])
    for r in results:
        name, run = r.plant, r.run
        ink = Track(name, ()).bright
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
