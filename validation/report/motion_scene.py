"""The recording of a comparison: the robots in motion, and the commands that drove them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from validation.report.motions import Comparison
from validation.report.palette import Rgb
from validation.report.tracks import History, Track

if TYPE_CHECKING:
    from validation.report.scene import Series

_COMMANDED: Rgb = (86, 180, 233)


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

    c = comparison
    scene = Scene(
        program="compare",
        title=f"{c.source}, profile {c.profile_label}",
        tracks=compared_tracks(c),
        plots=_command_plots(c),
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


def _command_plots(comparison: Comparison) -> dict[str, Series]:
    """Return the commands by entity: each at its instant, and the last once more at its end; empty without commands."""
    from validation.report.scene import Series, shades_of

    if not comparison.commands:
        return {}
    commands, starts = comparison.commands, [piece.t[0] for piece in comparison.reference]
    t = np.concatenate([start + c.dt * np.arange(c.n + 1) for start, c in zip(starts, commands, strict=True)])
    values = np.concatenate([np.vstack([c.values, c.values[-1:]]) for c in commands])
    if commands[0].kind == "wheels":
        names = ["left commanded [rad/s]", "right commanded [rad/s]"]
        return {"wheel_rate/commanded": Series(names, shades_of(_COMMANDED), t, values, held=True)}
    return {
        "speed/commanded": Series(["commanded [m/s]"], [_COMMANDED], t, values[:, 0], held=True),
        "yaw_rate/commanded": Series(["commanded [rad/s]"], [_COMMANDED], t, values[:, 1], held=True),
    }
