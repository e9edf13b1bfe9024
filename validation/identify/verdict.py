"""Whether fits are better than what was before: judged by motion that they have not seen.

What judges is cut by the time in motion, for a robot that stands tells nothing. A single log is
judged in thirds, each by a fit to the others, and several logs one by one, each by a fit to the
rest. What is written comes from all of them afterwards.

Tyres lose air and wear, and ground gives way: the way that a side's wheels roll in a turn, by the
kinematic fit to a log alone, says so long before anybody sees it. What changed is named.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import chain, pairwise

import numpy as np

from ssmr.metrics.paired import SIGNIFICANCE, chance_of_difference, correct_by_holm
from ssmr.metrics.windows import EVERY_S
from ssmr.types import CommandKind, FloatArray
from validation.experiment.gyro import with_gyro
from validation.experiment.scores import (
    HEADLINE_HORIZON,
    Driven,
    NamedScores,
    Scores,
    signed_windows,
)
from validation.experiment.sources import Source, Span, source_of
from validation.files.inspection import Inspected
from validation.identify.objective import FitCost
from validation.identify.targets import source_outside, split_ground
from validation.output import Document, one_line
from validation.report.columns import Unit
from validation.report.table import Table

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
_REPEATS = 0.008
"""Robust standard deviation of rolling radii between halves of public logs [1]: what changes within
a log is no change of tyres."""
_CHANGES = {
    "wheel_radius_left": ("the left wheels roll", "shorter", "farther"),
    "wheel_radius_right": ("the right wheels roll", "shorter", "farther"),
    "right_over_left": ("the right wheels, beside the left ones, roll", "shorter", "farther"),
    "icr_distance": ("the robot turns as if its track were", "narrower", "wider"),
}
"""Words for a change of each number, for less and for more."""

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
    folds = []
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
        return f"fits to all logs, judged by {one_line(', '.join(held))}, which is not among them"
    if logs > 1:
        return "fits to all logs but one, each judged by that one"
    return "fits to two thirds of the time in motion, each judged by the other third"


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


def list_objections(judged: NamedScores, driven: Sequence[Driven], input: str) -> list[str]:
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
    for part, what in (("position", "positions"), ("yaw", "headings")):
        if is_better(getattr(was, part), getattr(now, part), horizon):
            objections.append(f"{what} are worse, by more than chance")
    way, turn = _still_errors(list(chain(*driven)), horizon)
    unexplained = [
        f"{error.mean():.2f} {unit} on a {what} of {size.mean():.2f} {unit}"
        for error, size, what, unit in (
            (now.position, way, "way", "m"),
            (now.yaw, turn, "turn", "rad"),
        )
        if error.mean() > _EXPLAINED * size.mean()
    ]
    if unexplained:
        objections.append(
            f"its {input} do not explain the motion: the error is {' and '.join(unexplained)}"
        )
    return objections


def _still_errors(driven: Driven, horizon: float) -> tuple[FloatArray, FloatArray]:
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
        product += error[:, 2] @ turned
        square += turned @ turned
    return product / max(square, 1e-9)


def tyre_row(
    log: str,
    numbers: Mapping[str, float],
    error_of: Callable[[Mapping[str, float]], float],
    radius: float,
) -> Document:
    """Return rolling radii of both sides, their ratio and the distance of the sides' centres.

    Args:
        log: name of the log.
        numbers: what a kinematic fit found in it alone, by name.
        error_of: function that returns the standard error of a weighted sum of these.
        radius: radius of the wheels that shares are of [m].
    """
    left = numbers["alpha_l"]
    ratio = numbers["alpha_r"] / left
    values = (radius * left, radius * ratio * left, ratio, numbers["y_l"] - numbers["y_r"])
    weights = (
        {"alpha_l": radius},
        {"alpha_r": radius},
        {"alpha_r": 1.0 / left, "alpha_l": -ratio / left},
        {"y_l": 1.0, "y_r": -1.0},
    )
    errors = dict(zip(_CHANGES, map(error_of, weights), strict=True))
    return {"log": log, **dict(zip(_CHANGES, values, strict=True)), "standard_errors": errors}


def change_sentences(rows: Sequence[Document]) -> list[str]:
    """Return a sentence for each number of a log that differs from the first log's beyond chance.

    Chances are corrected for the number of comparisons.
    """
    chances = []
    sentences = []
    for row in rows[1:]:
        first = rows[0]
        for key, (lead, *words) in _CHANGES.items():
            change = row[key] / first[key] - 1.0
            parts = [each["standard_errors"][key] / each[key] for each in (row, first)]
            error = math.hypot(*parts, _REPEATS)
            chances.append(math.erfc(abs(change) / error / math.sqrt(2.0)))
            sentences.append(
                f"On {row['log']} {lead} {100.0 * abs(change):.1f} ± {100.0 * error:.1f} % "
                f"{words[change > 0.0]} than on {first['log']}"
            )
    adjusted = correct_by_holm(chances).tolist()
    return [said for said, p in zip(sentences, adjusted, strict=True) if p < SIGNIFICANCE]


def tyre_tables(rows: Sequence[Document]) -> list[Table]:
    """Return a table of what logs tell of the tyres, if there are any."""
    shown = []
    for row in rows:
        cells = {"log": row["log"]}
        for key, error in row["standard_errors"].items():
            cells[key] = (row[key], row[key] - 2.0 * error, row[key] + 2.0 * error)
        shown.append(cells)
    units = {key: Unit("1" if key == "right_over_left" else "m", 1.0, 3) for key in _CHANGES}
    title = "Tyres by each log alone, with two standard errors"
    return [Table(title, shown, units=units)] * bool(shown)
