"""Scores: how far the motion of a plant lies from the true one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from itertools import product

import numpy as np

from ssmr.geometry import relative_pose, wrap_angle
from ssmr.metrics.bands import NEW_GROUND, Band, estimated_band, interval_score
from ssmr.metrics.declared import Metrics
from ssmr.metrics.windows import (
    HorizonErrors,
    OverlappingErrors,
    WindowErrors,
    horizon_errors,
    horizon_windows,
    overlapping_windows,
)
from ssmr.types import FloatArray, IndexArray, Trajectory
from validation.experiment.sources import Piece, Source, WindowCut
from validation.output import Document
from validation.plants.profile import Pace

HEADLINE_HORIZON = 6.0
"""Horizon whose errors stand for a plant where only one has room [s], or the one closest to it."""
_BAND_HORIZONS = (2.0, 6.0, 15.0, 30.0, 60.0)
"""Lengths of the windows whose errors say how uncertainty grows [s]."""
_STANDING_SHARE = 0.1
"""Share of windows without any motion from which they are worth a sentence."""
Driven = Sequence[tuple[Piece, Trajectory]]
"""Pieces of one source or several, each with a plant's motion over it."""


@dataclass(frozen=True, eq=False)
class Scores:
    """Errors of a plant's motion along a source."""

    metrics: Metrics
    """Distances from the true motion, over all pieces."""
    horizons: Mapping[float, HorizonErrors] = field(default_factory=dict)
    """Errors of the relative pose, by horizon [s]; empty where the truth is a plant's motion."""
    windows: Mapping[float, WindowErrors] = field(default_factory=dict)
    """Errors over windows that begin every second, by horizon [s]; empty likewise."""
    by_gyro: Mapping[float, WindowErrors] = field(default_factory=dict)
    """As `windows`, with the gyro as the judge of heading; empty without a useful gyro."""
    band: Band | None = None
    """Uncertainty of the plant's predictions; None if not asked for, or not known."""
    held: Mapping[float, Mapping[str, tuple[float, float]]] = field(default_factory=dict)
    """Share of windows that end inside the band, and its interval score [m or rad], by horizon [s]
    for `position`, `yaw` and `yaw_gyro`."""

    @cached_property
    def overlapping(self) -> Mapping[float, OverlappingErrors]:
        """Medians over `windows` with their intervals, by horizon [s]."""
        return {horizon: errors.summary() for horizon, errors in self.windows.items()}

    @cached_property
    def overlapping_by_gyro(self) -> Mapping[float, OverlappingErrors]:
        """Medians over `by_gyro` with their intervals, by horizon [s]."""
        return {horizon: errors.summary() for horizon, errors in self.by_gyro.items()}

    @property
    def headline(self) -> float | None:
        """The horizon closest to `HEADLINE_HORIZON` [s]; None if there are no horizons."""
        return headline_horizon(self.windows)

    def as_dict(self) -> Document:
        """Return the scores as JSON files have them."""
        document: Document = dict(self.metrics)
        horizons = {f"{h:g}": asdict(errors) for h, errors in self.horizons.items()}
        for horizon, medians in self.overlapping.items():
            overlapping = asdict(medians)
            if horizon in self.by_gyro:
                by_gyro = asdict(self.overlapping_by_gyro[horizon])
                for key in ("yaw_median_rad", "yaw_low_rad", "yaw_high_rad"):
                    overlapping[key.replace("yaw", "yaw_gyro")] = by_gyro[key]
            entry = horizons.setdefault(f"{horizon:g}", {})
            entry["overlapping"] = overlapping
            if held := self.held.get(horizon):
                entry["coverage_90"] = {part: share for part, (share, _) in held.items()}
                entry["interval_score_90"] = {part: score for part, (_, score) in held.items()}
        if horizons:
            document["horizons"] = horizons
        return document


NamedScores = Mapping[str, Scores]
"""Scores by the name of a plant, or of a source."""


def headline_horizon(horizons: Iterable[float]) -> float | None:
    """Return the horizon closest to `HEADLINE_HORIZON` [s]; None if there are no horizons."""
    return min(horizons, key=lambda h: (abs(h - HEADLINE_HORIZON), h), default=None)


def score_windows(
    metrics: Metrics,
    pieces: Sequence[Piece],
    motions: Sequence[Trajectory],
    horizons: Sequence[float],
    by_gyro: Sequence[Piece] | None = None,
    band: Band | None = None,
) -> Scores:
    """Return the errors over the windows of logs, and how often a band held them.

    Windows follow one another and never span a gap or a jump of the localiser. Those in which the
    robot stands are only counted. A horizon without any other is left out.

    Args:
        metrics: distances of all pieces.
        pieces: pieces of one source or several; only those of logs have windows.
        motions: a plant's motion over each piece.
        horizons: lengths of the windows [s].
        by_gyro: the same pieces, judged by a gyro's headings.
        band: uncertainty that the plant's profile states.
    """
    driven = list(zip(pieces, motions, strict=True))
    judged = list(zip(by_gyro or (), motions, strict=False))
    errors = {}
    windows = {}
    gyro = {}
    held = {}
    for horizon in horizons:
        if steps := signed_windows(driven, horizon, horizon_windows):
            standing = _count_windows(pieces, horizon, horizon_windows, True)
            errors[horizon] = horizon_errors(*_error_sizes(steps), standing)
        if steps := signed_windows(driven, horizon):
            windows[horizon] = WindowErrors(horizon, *_error_sizes(steps))
            if band is not None:
                held[horizon] = _held_shares(steps, band)
        if steps := signed_windows(judged, horizon):
            gyro[horizon] = WindowErrors(horizon, *_error_sizes(steps))
            if band is not None:
                held[horizon]["yaw_gyro"] = _held_shares(steps, band)["yaw"]
    return Scores(metrics, errors, windows, gyro, band, held)


_Windows = tuple[FloatArray, IndexArray, IndexArray, FloatArray]
"""(M, 3) path of a plant, (W,) starts and ends of windows, and the (W, 3) errors over them."""


def _error_sizes(steps: Sequence[_Windows]) -> tuple[FloatArray, FloatArray]:
    """Return (W,) position errors [m] and sizes of yaw errors [rad] over all windows."""
    error = np.concatenate([step[3] for step in steps])
    return np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2])


def _held_shares(steps: Sequence[_Windows], band: Band) -> dict[str, tuple[float, float]]:
    """Return what `Scores.held` has for `position` and `yaw` at one horizon."""
    edges = np.concatenate([band.edges(*step) for step in steps], axis=1)
    held = {}
    for part, edge, error in zip(("position", "yaw"), edges, _error_sizes(steps), strict=True):
        held[part] = (float(np.mean(error <= edge)), interval_score(error, edge))
    return held


def _count_windows(
    pieces: Iterable[Piece], horizon: float, cut: WindowCut, standing: bool = False
) -> int:
    """Return the number of windows of some pieces in which the robot moves, or stands."""
    logged = ((piece, piece.t) for piece in pieces if piece.t is not None)
    return sum(len(piece.windows(cut, t, horizon, standing)[0]) for piece, t in logged)


def signed_windows(
    driven: Driven, horizon: float, cut: WindowCut = overlapping_windows
) -> list[_Windows]:
    """Return predictions over windows of a horizon [s] and their errors, piece by piece.

    An error is the plant's motion less the recorded one, x, y [m] in the frame of the start, and
    yaw [rad], for which a better judge of a piece counts. Pieces without windows are left out.
    """
    signed = []
    for piece, motion in driven:
        if piece.reference is None or piece.t is None:
            continue
        i, j = piece.windows(cut, piece.t, horizon)
        if not len(i):
            continue
        p = motion.pose
        q = piece.reference.pose
        error = relative_pose(p[i], p[j]) - relative_pose(q[i], q[j])
        if piece.headings is not None:
            error[:, 2] = p[j, 2] - p[i, 2] - (piece.headings[j] - piece.headings[i])
        error[:, 2] = wrap_angle(error[:, 2])
        signed.append((p, i, j, error))
    return signed


def band_of(parts: Sequence[Driven], by_log: bool = False, drawn: bool = False) -> Band | None:
    """Return the band of a plant's predictions of logs, see `estimated_band`.

    None where there are too few windows. `parts` has the logs as a plant drives them whose numbers
    were found without their first, second, ... part of time; or if `by_log`, each log as a plant
    drives it whose numbers the others gave. With `drawn` days the plants differ as days do.
    """
    unseen = []
    for horizon, (k, driven) in product(_BAND_HORIZONS, enumerate(parts)):
        steps = signed_windows(driven, horizon)
        total = sum(len(starts) for _, starts, _, _ in steps)
        first = 0
        for path, starts, ends, error in steps:
            # the part of time that each window lies in
            place = np.arange(first, first + len(starts)) * len(parts) // total
            first += len(starts)
            inside = (place == k) | by_log
            unseen.append((horizon, path, starts[inside], ends[inside], error[inside]))
    return estimated_band(unseen, 1.0 if drawn else NEW_GROUND)


def pace_of(motions: Sequence[Trajectory], radius: float) -> Pace:
    """Return the pace of motions; the speed is that of wheels of a radius [m], if there are any.

    Without motions it is zero.
    """
    if not motions:
        return Pace()
    v = np.concatenate([m.twist[:, 0] for m in motions])
    w = np.concatenate([m.twist[:, 2] for m in motions])
    wheels = radius * np.concatenate([m.wheels.mean(axis=1) for m in motions])
    # poses may jump, which wheels do not
    return Pace.of(wheels if np.any(wheels) else v, w)


def standing_sentences(source: Source, horizon: float) -> list[str]:
    """Return a sentence on a log in which the robot stands in many windows; none for others."""
    standing = _count_windows(source.pieces, horizon, overlapping_windows, True)
    moving = _count_windows(source.pieces, horizon, overlapping_windows)
    share = standing / max(standing + moving, 1)
    if share < _STANDING_SHARE:
        return []
    what = (
        f"the robot stands still throughout {100.0 * share:.0f} % of the windows of {horizon:g} s"
    )
    return [f"{source.title}: {what}, which count in no median"]
