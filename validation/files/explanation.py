"""The explanation of a log: the hypothesis after which its signals agree best.

It is named if it beats those that blame other columns by enough; else the log cannot say which of
them is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from ssmr.types import FloatArray, IndexArray
from validation.files.agreement import Agreement
from validation.files.columns import POSE_COLUMNS
from validation.files.hypotheses import Idea, best_span, find_delays, list_ideas
from validation.files.log import LogFault
from validation.files.sensors import Signals

# ------------------------------------------------------------------------------------------ judge
_LEAST = 8.0
"""Gain from which something is no accident [nats]."""
_LEAST_EACH = 0.05
"""The same of each window of the log."""
_WHOLE = 0.85
"""Share of a log from which a span is the whole."""
_EXPLAINED = 0.5
"""Share of what is left over that a hypothesis may leave."""
_ORDINARY = 0.3
"""Cost of a pair of sound signals in a window."""
_TIE = 0.1
"""Share of the best gain by which the second one must be worse."""
_MOST_FAULTS = 3


class Explanation(NamedTuple):
    """A hypothesis and how much it explains."""

    gain: float
    idea: Idea
    span: slice
    """Windows for which it holds."""


def explanations(e: Agreement) -> list[Explanation]:
    """Return the hypotheses by what they explain, the best first."""
    found = []
    n = len(e.signals.windows.t)
    for idea in list_ideas(e):
        gains = 0.5 * idea.after.gain_over(e)  # windows overlap by half
        span = best_span(gains) if idea.parts else slice(0, n)
        if span.stop - span.start > _WHOLE * n:
            span = slice(0, n)
        partly = span.stop - span.start < n
        price = 4.0 + 0.5 * math.log(n) * (idea.freedom + 2.0 * partly)
        gain = float(gains[span].sum()) - price
        if gain > max(_LEAST, _LEAST_EACH * n) and _explains_span(e, idea, span):
            found.append(Explanation(gain, idea, span))
    return sorted(found, key=lambda v: -v.gain)


def _explains_span(e: Agreement, idea: Idea, span: slice) -> bool:
    """Return whether little is left over between the signals that a hypothesis changes."""
    changed = [k for k, pair in enumerate(e.pairs) if pair is not idea.after.pairs[k]]
    before = float(np.mean(np.nan_to_num(e.costs)[changed, span]))
    left = float(np.mean(np.nan_to_num(idea.after.costs)[changed, span]))
    partly = span.stop - span.start < e.costs.shape[1]
    return bool(left < max((_EXPLAINED / 2.0 if partly else _EXPLAINED) * before, _ORDINARY))


def _correct_signals(e: Agreement, best: Explanation) -> Agreement:
    """Return what a log tells with the mistake undone where it was made."""
    inside = np.zeros(len(e.signals.windows.t), dtype=bool)
    inside[best.span] = True
    changed = {}
    for name, values in best.idea.after.means.items():
        if values is not e.means[name]:
            changed[name] = np.where(inside, values, e.means[name])
    return replace(e.but(changed), untold=best.idea.after.untold)


def judged(signals: Signals) -> Iterator[LogFault]:
    """Yield what the signals of a log show to be wrong."""
    if not signals.means:
        return
    e = Agreement.of_log(signals)
    if not e.pairs:
        return
    blamed = set[str]()
    for _ in range(_MOST_FAULTS):
        found = [v for v in explanations(e) if not blamed & {*v.idea.columns}]
        if not found:
            break
        best = found[0]
        rivals = {best.idea.columns: best}
        for other in found[1:]:
            near = other.gain > (1.0 - _TIE) * best.gain
            if near and not {*best.idea.columns} & {*other.idea.columns}:
                rivals.setdefault(other.idea.columns, other)
        yield _make_fault(signals, list(rivals.values()))
        if "t" in best.idea.columns:
            return  # whatever else there is, is of that
        blamed |= {*chain(*rivals)}
        e = _correct_signals(e, best)


def _make_fault(signals: Signals, rivals: Sequence[Explanation]) -> LogFault:
    """Return the fault of one hypothesis, or of several that are as good."""
    best = rivals[0]
    t = signals.windows.t
    start = end = None
    when = ""
    if best.span.stop - best.span.start < len(t):
        start, end = float(t[best.span.start]), float(t[best.span.stop - 1])
        when = f" from {start:.0f} to {end:.0f} s"
        if best.span.stop == len(t):
            when = f" from {start:.0f} s on"
    words = ", or ".join(v.idea.words for v in rivals)
    kinds = {v.idea.kind for v in rivals}
    kind = best.idea.kind if len(kinds) == 1 else "disagree"
    if len(rivals) > 1:
        words += "; the log cannot say which"
    columns = tuple(dict.fromkeys(chain(*(v.idea.columns for v in rivals))))
    return LogFault(kind, columns, f"{words}{when and f';{when}'}", start, end)


# ------------------------------------------------------------------------------------------ parts
_PART_S = 10.0
"""Length of a part of a log [s]; those of a long log are longer."""
_MOST_PARTS = 40
"""Most parts of a log."""
_SURE = 0.8
"""Share of yaw rates that is explained from which a part tells a delay [1]."""
_DRIVES = 0.05
"""Speed from which a part tells radii [m/s]."""
_TURNS = 0.1
"""Mean yaw rate from which it tells a width [rad/s]."""


def find_parts(signals: Signals) -> list[dict[str, Any]]:
    """Return what each part of a log tells of the robot, as the JSON file has it.

    Rows have `from_s`, `to_s`, `wheel_radius_left`, `wheel_radius_right`, `half_track` [m],
    `delay_s`, how late headings are behind gyro or wheels, and `residuals` by signal, over its
    ordinary noise; None for what a part does not tell.
    """
    t = signals.windows.t
    if not len(t):
        return []
    agreement = Agreement.of_log(signals)
    n = min(_MOST_PARTS, max(1, round(float(np.ptp(t)) / _PART_S)))
    edges = np.linspace(t[0], t[-1] + 1e-6, n + 1)
    parts = []
    for start, stop, late in zip(edges, edges[1:], _late_headings(agreement, edges), strict=False):
        inside = np.flatnonzero((t >= start) & (t < stop))
        if not len(inside):
            continue
        left, right, half_track = _sizes_of_part(agreement, inside)
        parts.append(
            {
                "from_s": float(start),
                "to_s": float(stop),
                "wheel_radius_left": left,
                "wheel_radius_right": right,
                "half_track": half_track,
                "delay_s": late,
                "residuals": _residuals_of_part(agreement, inside),
            }
        )
    return parts


def _sizes_of_part(e: Agreement, inside: IndexArray) -> tuple[float | None, ...]:
    """Return both radii and the effective half-track [m] in some windows; None where untold."""
    speeds, turns = e.told
    if e.signals.wheels is None or "pose" not in speeds or len(inside) < 4:
        return None, None, None
    v = speeds["pose"][inside]
    w = turns.get("imu", turns["pose"])[inside]
    left, right = e.signals.wheels[:, inside]
    zero = np.zeros(len(v))
    # r_l l + b w = v, and r_r r - b w = v
    rows = np.concatenate([np.column_stack([left, zero, w]), np.column_stack([zero, right, -w])])
    if np.sqrt(np.mean(v**2)) < _DRIVES:
        return None, None, None
    turns_enough = float(np.mean(np.abs(w))) > _TURNS
    known = rows if turns_enough else rows[:, :2]
    sizes = np.linalg.lstsq(known, np.concatenate([v, v]))[0].tolist()
    return sizes[0], sizes[1], sizes[2] if turns_enough else None


def _late_headings(e: Agreement, edges: FloatArray) -> list[float | None]:
    """Return how late headings are behind gyro or wheels in parts [s]; None where untold."""
    windows = e.signals.windows
    first = next((name for name in ("imu", "wheels") if name in windows.at), "")
    if not first or not {*POSE_COLUMNS} <= e.means.keys():
        return [None] * (len(edges) - 1)
    starts = np.searchsorted(windows.t, edges[:-1])
    late, sure = find_delays(e, {"yaw": e.signals.ways["yaw"]}, starts.tolist())
    taken = np.median(windows.at["pose"] - windows.at[first])
    known = (sure > _SURE) & np.isfinite(late)
    return [float(taken + lag) if told else None for lag, told in zip(late, known, strict=True)]


def _residuals_of_part(e: Agreement, inside: IndexArray) -> dict[str, float | None]:
    """Return by signal what is left over beside the others, over its noise, in the median."""
    names = {"imu": "gyro", "pose": "pose", "odom": "odometry", "wheels": "wheels"}
    found = dict[str, float | None]()
    for sensor, name in {**names, "cmd": "commands"}.items():
        costs = [pair.cost[inside] for pair in e.pairs if sensor in (pair.a, pair.b)]
        told = np.concatenate([*costs, []])
        told = told[np.isfinite(told)]
        if costs:
            found[name] = float(np.sqrt(np.expm1(np.median(told)))) if len(told) else None
    return found
