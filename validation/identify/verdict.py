"""Whether fits are better than what was before: judged by motion that they have not seen.

What judges is cut by the time in motion, for a robot that stands tells nothing. A single log is
judged in thirds, each by a fit to the others, and several logs one by one, each by a fit to the
rest. What is written comes from all of them afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain, pairwise

import numpy as np

from ssmr.metrics.paired import SIGNIFICANCE, chance_of_difference
from ssmr.metrics.windows import EVERY_S
from ssmr.types import CommandKind, FloatArray
from validation.experiment.gyro import with_gyro
from validation.experiment.scores import HEADLINE_HORIZON, Driven, Scores, signed_windows
from validation.experiment.sources import Source, Span, source_of
from validation.files.inspection import Inspected
from validation.identify.objective import FitCost
from validation.identify.targets import source_outside, split_ground
from validation.output import one_line

_PARTS = 3
"""Number of parts of a single log, each of which judges a fit to the others."""
_CLEAR = 0.02
"""Share by which errors must fall in the median to be called better [1]."""
_NOTHING = 1e-9
"""Size of an error that is none [m]."""
_EXPLAINED = 0.5
"""Share of the motion itself at which an error says that the inputs do not explain it [1]."""
_FEWEST_BLOCKS = 4
"""Fewest windows without overlap that tell a difference from chance."""

Fold = tuple[list[Source], tuple[Source, ...]]
"""Sources that a fit sees, and those that judge it."""


def divide_logs(
    opened: Mapping[str, Inspected], held: Mapping[str, Inspected], kind: CommandKind
) -> list[Fold]:
    """Return what each fit of a calibration sees and what judges it.

    The last fit sees all logs; if some are `held` out, it is the only one. A log that only judges
    has the tag of its ground alone.
    """
    whole = [source_of(each, name, kind) for name, each in opened.items()]
    if held:
        judges = [source_of(each, name, kind) for name, each in held.items()]
        return [(whole, tuple(map(_as_judge, judges)))]
    folds: list[Fold] = []
    if len(whole) > 1:
        for source in whole:
            rest = [other for other in whole if other is not source]
            folds.append((rest, (_as_judge(source),)))
    else:
        ((name, inspected),) = opened.items()
        for span in _parts_of_motion(whole[0]):
            rest = [source_outside(inspected, name, kind, span)]
            part = source_of(inspected, name, kind, span)
            folds.append((rest, (_as_judge(replace(part, name=part.title)),)))
    return [*folds, (whole, ())]


def _as_judge(source: Source) -> Source:
    """Return a source with its better judge of headings, and no numbers of its own."""
    return replace(with_gyro(source), tags=tuple(filter(None, split_ground(source.name)[1:])))


def _parts_of_motion(source: Source) -> list[Span]:
    """Return the spans of a log that have equal times in motion [s]."""
    stamps = []
    for piece in source.pieces:
        assert piece.t is not None
        moves = np.ones(len(piece.t), dtype=bool) if piece.moves is None else piece.moves
        # a log in which nothing moves is refused where it is fitted to
        stamps.append(piece.t[moves] if moves.any() else piece.t)
    moving = np.concatenate(stamps)
    cuts = moving[np.arange(1, _PARTS) * len(moving) // _PARTS]
    return list(pairwise((None, *cuts.tolist(), None)))


def describe_judges(logs: int, held: Sequence[str]) -> str:
    """Return in words what judges fits to a number of logs, beside which others may be held out."""
    if held:
        return f"fits to all logs, by {one_line(', '.join(held))}, which is not among them"
    if logs > 1:
        return "fits to all logs but one, each by that one"
    return "fits to two thirds of the time in motion, each by the other third"


def is_better(now: FloatArray, was: FloatArray, horizon: float) -> bool:
    """Return whether (W,) errors fell in pairs, by more than chance and by a share.

    They belong to the same windows of a horizon [s], which begin every second. What is judged is
    the median of the windows' ratios, so a window that is hard for both counts no more than others.
    """
    ratio = np.log(np.maximum(now, _NOTHING) / np.maximum(was, _NOTHING))
    if np.median(ratio) >= math.log(1.0 - _CLEAR):
        return False
    times = EVERY_S * np.arange(len(now))
    return chance_of_difference(ratio, 0.0 * ratio, times, horizon) < SIGNIFICANCE


def _judging_horizon(scores: Scores) -> float:
    """Return the longest horizon up to the headline's of which enough windows fit side by side."""
    assert scores.headline is not None
    shorter = sorted((h for h in scores.windows if h <= scores.headline), reverse=True)
    for horizon in shorter:
        if len(scores.windows[horizon].yaw) * EVERY_S >= _FEWEST_BLOCKS * horizon:
            return horizon
    return shorter[-1]


def list_objections(
    judged: Mapping[str, Scores], driven: Sequence[Driven], input: str
) -> list[str]:
    """Return why the numbers of a fit are not to be used.

    Args:
        judged: scores on unseen data `before` and `after` the fit.
        driven: these data as the fitted plants drive them.
        input: what drives the plants, in words.
    """
    horizon = _judging_horizon(judged["after"])
    was, now = (scores.windows[horizon] for scores in judged.values())
    radian = FitCost().yaw_weight
    sizes = [errors.position + radian * errors.yaw for errors in (now, was)]
    objections = []
    if not is_better(sizes[0], sizes[1], horizon):
        objections.append("the fit is no better, by more than chance and 2 %")
    for part in ("position", "yaw"):
        if is_better(getattr(was, part), getattr(now, part), horizon):
            what = "headings" if part == "yaw" else "positions"
            objections.append(f"{what} are worse, by more than chance")
    way, turn = still_errors(list(chain(*driven)), horizon)
    for error, size, what, unit in (
        (now.position, way, "way", "m"),
        (now.yaw, turn, "turn", "rad"),
    ):
        if float(error.mean()) > _EXPLAINED * float(size.mean()):
            objections.append(
                f"its {input} do not explain the motion: the error is "
                f"{error.mean():.2f} {unit} on a {what} of {size.mean():.2f} {unit}"
            )
    return objections


def still_errors(driven: Driven, horizon: float) -> tuple[FloatArray, FloatArray]:
    """Return (W,) errors of positions [m] and headings [rad] of a plant that does not move.

    They are those over all windows of a horizon [s].
    """
    still = [(piece, replace(motion, pose=0.0 * motion.pose)) for piece, motion in driven]
    error = np.concatenate([step[3] for step in signed_windows(still, horizon)])
    return np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2])


def turn_share(driven: Driven) -> float:
    """Return by which share a plant turns more than the robot, along a log that it drives."""
    product = 0.0
    square = 0.0
    for path, i, j, error in signed_windows(driven, HEADLINE_HORIZON):
        turned = path[j, 2] - path[i, 2] - error[:, 2]
        product += float(error[:, 2] @ turned)
        square += float(turned @ turned)
    return product / max(square, 1e-9)
