"""The recording of a comparison: the robots in motion, their errors, rates, torques and loads over time."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from ssmr.geometry import wrap_angle
from ssmr.types import FloatArray
from validation.report.motions import Comparison
from validation.report.palette import Rgb, colour, mix
from validation.report.tracks import BLACK, WHITE, History, Series, Track
from validation.simulator.description import WHEELS
from validation.simulator.wheel_loads import QUASI_STATIC

_COMMANDED: Rgb = (86, 180, 233)
_WHEELS = tuple(colour(name) for name in ("mujoco", "improved", "coulomb", "linear"))


def write_comparison(comparison: Comparison, path: Path, text: str | None = None, histories: Sequence[History] = ()) -> None:
    """Write a comparison as a rerun recording, whole or not at all.

    Args:
        comparison: the motions.
        path: the file.
        text: markdown of its report; that of the comparison if not given.
        histories: courses of a search.

    Raises:
        OSError: the file cannot be written.
        RuntimeError: rerun is switched off by `RERUN=off`.
    """
    from validation.report.scene import Scene, write_scene  # here: rerun may be missing

    c, tracks = comparison, compared_tracks(comparison)
    plots = _command_plots(c)
    for track in tracks:
        plots.update(_plots_of(track))
    name = tracks[0].name
    torque = "torque/mujoco" if "torque/mujoco" in plots else "torque"
    scene = Scene(
        program="compare",
        title=f"{c.source}, profile {c.profile_label}",
        tracks=tracks,
        plots=plots,
        views=[
            {"position_error": f"Position error to {name} [mm]", "yaw_error": f"Yaw error to {name} [deg]"},
            {
                "yaw_rate": "Yaw rate [rad/s]",
                "yaw_acceleration": "Yaw acceleration [rad/s²]",
                "speed": "Speed [m/s]",
                "wheel_rate": "Commanded wheel rates [rad/s]",
            },
            {"wheel_load": "Wheel loads [N]", torque: "Motor torques of a side [N m]"},
        ],
        report=c.markdown() if text is None else text,
        about={"comparison": c.facts, "options": {k: str(v) for k, v in c.options.items()}, "versions": c.versions},
        gaps=np.array([0.5 * (a.t[-1] + b.t[0]) for a, b in pairwise(c.reference)]),
        histories=histories,
    )
    write_scene(scene, path)


def compared_tracks(comparison: Comparison) -> list[Track]:
    """Return all robots, the reference first."""
    plants = comparison.plants
    known = plants.get(comparison.reference_name) or next(iter(plants.values()))  # where a recording was tracked, they say
    ground, robot = comparison.terrain, comparison.robot
    reference = Track(comparison.reference_name, comparison.reference, None, known.localiser, ground, robot)
    others = [result for result in plants.values() if result.name != reference.name]
    return [reference, *(Track(r.name, r.pieces, reference, r.localiser, ground, robot) for r in others)]


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
        add("position_error", "mm", 1e3 * track.apart)
        add("yaw_error", "deg", np.degrees(wrap_angle(track.seen[:, 2])))
    torque, loads, formula = map(track.channel, ("torque_N_m", "wheel_load_N", QUASI_STATIC))
    if torque is not None:
        names = [f"{track.name} {side} [N m]" for side in ("left", "right")]
        shades = [mix(track.bright, WHITE, 0.35), mix(track.bright, BLACK, 0.25)]
        plots[f"torque/{track.name}"] = Series(names, shades, track.t, torque)
    if loads is not None:
        names = [f"{wheel.replace('_', ' ')} [N]" for wheel in WHEELS]
        plots[f"wheel_load/{track.name}"] = Series(names, _WHEELS, track.t, loads)
    if formula is not None:
        names = [f"{wheel.replace('_', ' ')} quasi-static [N]" for wheel in WHEELS]
        pale = [mix(c, WHITE, 0.5) for c in _WHEELS]
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
        shades = [mix(_COMMANDED, WHITE, 0.35), mix(_COMMANDED, BLACK, 0.25)]
        return {"wheel_rate/commanded": Series(names, shades, t, values, held=True)}
    return {
        "speed/commanded": Series(["commanded [m/s]"], [_COMMANDED], t, values[:, 0], held=True),
        "yaw_rate/commanded": Series(["commanded [rad/s]"], [_COMMANDED], t, values[:, 1], held=True),
    }
