"""A plant driven over a source's pieces, seen as the reference is; its horizon scores; and the pace of real time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from ssmr.metrics.poses import HorizonErrors, horizon_errors, horizon_windows, relative_pose_error
from ssmr.metrics.windows import WindowErrors, overlapping_windows
from ssmr.robot.localiser import Localiser
from ssmr.types import FloatArray, IndexArray, Plant, Trajectory
from validation.logs.rest import ASKS_FOR_MOTION, WHEELS_MEAN_S, WHEELS_TURN, moving_mean
from validation.motion.sources import Piece, Source, WindowCut

STANDING_SHARE = 0.1
"""Share of windows without any motion from which they are worth a sentence: they lower every median."""


class Pacer:
    """Waits for instants counted from one start, and catches up after lateness, unless that is too much."""

    def __init__(self, clock: Callable[[], float], sleep: Callable[[float], object], most_behind: float = math.inf) -> None:
        """Start now; `clock` returns monotonic time [s], and `sleep` waits for some time [s] or a little longer.

        A lateness greater than `most_behind` [s] is dropped, so that time does not run fast for long after a stall.
        """
        self._clock, self._sleep, self._most_behind = clock, sleep, most_behind
        self._start = clock()
        self.dropped = 0.0
        """Time that was dropped [s]."""

    def wait(self, instant: float) -> float:
        """Sleep until `instant` [s] after the start, unless that has passed, and return the lateness [s]."""
        deadline = self._start + instant
        while (left := deadline - self._clock()) > 0.0:
            self._sleep(left)
        late = self._clock() - deadline
        if late > self._most_behind:
            self._start += late
            self.dropped += late
        return late


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


def scoring_windows(source: Source, horizon: float) -> tuple[tuple[IndexArray, IndexArray], ...]:
    """Return starts and ends of the windows of `horizons_of`, piece by piece; none for a piece without stamps."""
    nothing = np.empty(0, dtype=np.intp)
    return tuple((nothing, nothing) if p.t is None else p.windows(horizon_windows, p.t, horizon) for p in source.pieces)


def standing_share(source: Source, horizon: float) -> float | None:
    """Return the share of the windows of `window_errors_of` in which the robot never moves [1]; None without windows.

    Wheel rates say whether it moves, commands where there are no wheel rates.
    """
    still = []
    for piece in source.pieces:
        if piece.t is None or piece.reference is None:
            continue
        moved = np.cumulative_sum(_moves(piece, piece.t, piece.reference), include_initial=True)
        starts, ends = piece.windows(overlapping_windows, piece.t, horizon)
        still.append(moved[ends + 1] == moved[starts])
    found = np.concatenate(still) if still else np.empty(0)
    return float(found.mean()) if len(found) else None


def _moves(piece: Piece, t: FloatArray, recorded: Trajectory) -> IndexArray:
    """Return (M,) 1 where the robot moves, else 0."""
    if np.any(recorded.wheels):
        rates = np.column_stack([moving_mean(t, side, WHEELS_MEAN_S) for side in recorded.wheels.T])
        return (np.abs(rates).max(axis=1) > WHEELS_TURN).astype(np.intp)
    values = piece.commands.values
    at = np.minimum(((t - t[0]) / piece.commands.dt).astype(np.intp), len(values) - 1)
    return (np.abs(values[at]).max(axis=1) > ASKS_FOR_MOTION).astype(np.intp)


def standing_sentences(source: Source, horizon: float) -> list[str]:
    """Return a sentence on a recording in which the robot often stands; none for one in which it drives."""
    share = standing_share(source, horizon)
    if share is None or share < STANDING_SHARE:
        return []
    windows = f"{100.0 * share:.0f} % of the windows of {horizon:g} s"
    return [f"{source.title}: the robot stands still throughout {windows}, which lowers all medians"]


def _errors_of(
    driven: Sequence[tuple[Source, Sequence[Trajectory]]], horizon: float, windows: WindowCut
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
