"""A plant driven over a source's pieces, seen as the reference is; and its horizon scores."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssmr.metrics.poses import HorizonErrors, horizon_errors, horizon_windows, relative_pose_error
from ssmr.metrics.windows import WindowErrors, overlapping_windows
from ssmr.robot.localiser import Localiser
from ssmr.types import FloatArray, Plant, Trajectory
from validation.motion.sources import Piece, Source, WindowCut


def drive(plant: Plant, piece: Piece, localiser: Localiser, sample_dt: float, push: FloatArray | None = None) -> Trajectory:
    """Drive a plant over one piece and return its motion as the reference tells its own, at the reference's stamps.

    Args:
        plant: what to drive; reset first.
        piece: commands, start and stamps.
        localiser: the frame in the plant's body that is compared, and its delays.
        sample_dt: period at which the plant is sampled [s].
        push: (n,) disturbing yaw acceleration of each physics step [rad/s2].
    """
    return localiser.seen(plant.run(piece.commands, localiser.body_state(piece.start), sample_dt, push), piece.t)


def horizons_of(
    driven: Sequence[tuple[Source, Sequence[Trajectory]]], horizons: Sequence[float]
) -> dict[float, HorizonErrors]:
    """Return errors of the relative pose by horizon [s] over several sources together; only recordings have windows.

    Windows follow one another and never span a gap or a jump of the localiser. A horizon without any is left out.
    """
    errors = {horizon: _errors_of(driven, horizon, horizon_windows) for horizon in horizons}
    return {horizon: horizon_errors(*found) for horizon, found in errors.items() if found is not None}


def window_errors_of(
    driven: Sequence[tuple[Source, Sequence[Trajectory]]], horizons: Sequence[float]
) -> dict[float, WindowErrors]:
    """Return errors of the relative pose over windows that begin every second, by horizon [s], as `horizons_of` does."""
    errors = {horizon: _errors_of(driven, horizon, overlapping_windows) for horizon in horizons}
    return {horizon: WindowErrors(horizon, *found) for horizon, found in errors.items() if found is not None}


def _errors_of(
    driven: Sequence[tuple[Source, Sequence[Trajectory]]],
    horizon: float,
    windows: WindowCut,
) -> tuple[FloatArray, FloatArray] | None:
    """Return (W,) position errors [m] and yaw errors [rad] over all windows; None where there is none."""
    found = [
        relative_pose_error(motion.pose, piece.reference.pose, *piece.windows(windows, piece.t, horizon))
        for source, motions in driven
        for motion, piece in zip(motions, source.pieces, strict=True)
        if piece.reference is not None and piece.t is not None
    ]
    if not sum(len(position) for position, _ in found):
        return None
    return np.concatenate([position for position, _ in found]), np.concatenate([yaw for _, yaw in found])
