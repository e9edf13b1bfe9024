"""The recording of a comparison: the robots in motion, and the commands that drove them."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from validation.report.motions import Comparison, compared_tracks
from validation.report.palette import Rgb

if TYPE_CHECKING:
    from validation.report.scene import Series

_COMMANDED: Rgb = (86, 180, 233)


def write_comparison(comparison: Comparison, path: Path) -> None:
    """Write a comparison as a rerun recording, whole or not at all.

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
        report=c.markdown(),
        about={"comparison": c.facts, "options": {k: str(v) for k, v in c.options.items()}, "versions": c.versions},
        gaps=np.array([0.5 * (a.t[-1] + b.t[0]) for a, b in pairwise(c.reference)]),
    )
    write_scene(scene, path)


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
