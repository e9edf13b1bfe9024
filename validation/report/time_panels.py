"""The panels of a comparison's picture that run over time: velocities, yaw acceleration and wheel loads."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ssmr.types import FloatArray, Trajectory
from validation.report.drawing import ALARM, BROAD, NARROW, QUIET, Dashes, Span, at_least, corner_note, ink_of, joined
from validation.report.motions import Comparison
from validation.simulator.description import WHEELS
from validation.simulator.wheel_loads import QUASI_STATIC

_LONGEST_SHOWN = 60.0
"""Runs longer than this show velocities over a stretch only [s]: more would be a smear."""
_STRETCH = 36.0
"""Length of that stretch [s]."""
_MOVES = 0.02
"""Speed [m/s] or yaw rate [rad/s] above which a plant moves."""
_AS_GOOD = 0.05
"""Shares of time that differ by less are as good as each other [1]."""
_ZOOM_TIME = 0.6
"""Length of the panel of yaw acceleration [s]: a dozen periods of the driver's 20 Hz commands, each of them visible."""
_ZOOM_SAMPLES = 40
"""Least length of that panel, in samples."""
_MEAN_TIME = 0.25
"""Time over which wheel loads are averaged [s]: five periods of the driver's commands."""
_CLIP_PERCENTILE = 99.0
"""Percentile of a plant's own acceleration beyond which a sample may count as a spike [%]."""
_CLIP_RATIO = 3.0
"""A sample so many times beyond that percentile, and beyond all other plants, is a spike: it is cut off and noted."""
_CLIP_FLOOR = 0.1
"""Nothing is cut off where all other accelerations are below this [rad/s2]."""
_TURN_FLOOR = 0.01
"""A yaw rate that changes by less is noise and reverses no turn [rad/s]."""
_IMPULSIVE = frozenset({"kinematic"})
"""Plants without inertia: their yaw rate steps, and their acceleration is impulses that say nothing."""
_CHATTERING = "coulomb"
"""The plant whose acceleration is drawn thin and behind the others, for it may fill the panel."""
_Values = Callable[[Trajectory], FloatArray]
_DASHES: dict[str, Dashes] = {
    "improved": (0.0, (6.0, 1.5)),
    "coulomb": (0.0, (1.5, 1.0)),
    "linear": (0.0, (7.0, 1.5, 1.5, 1.5)),
    "kinematic": (0.0, (3.0, 1.2)),
    "four_wheel": (0.0, (9.0, 1.2)),
}
_SIDES: tuple[Dashes, Dashes] = ("solid", (0.0, (4.0, 1.5)))
COMMAND_INK = "0.5"


@dataclass(frozen=True, eq=False)
class DrawnMotion:
    """A motion to draw: the reference's or a plant's."""

    name: str
    pieces: tuple[Trajectory, ...]
    is_reference: bool

    @property
    def look(self) -> dict[str, Any]:
        """Properties of its line."""
        width = BROAD if self.is_reference else NARROW
        return {"color": ink_of(self.name), "linestyle": _DASHES.get(self.name, "solid"), "linewidth": width}

    def draw(self, ax: Axes, x: FloatArray, y: FloatArray) -> None:
        """Draw its line: the reference broad and behind, the others on top of it."""
        ax.plot(x, y, zorder=2.0 if self.is_reference else 2.5, gid=self.name, **self.look)


def drawn_motions(comparison: Comparison) -> list[DrawnMotion]:
    """Return the reference, then the other plants in their order."""
    others = [DrawnMotion(n, r.pieces, False) for n, r in comparison.plants.items() if n != comparison.reference_name]
    return [DrawnMotion(comparison.reference_name, comparison.reference, True), *others]


def over_time(pieces: Sequence[Trajectory], series: _Values, span: Span) -> tuple[FloatArray, FloatArray]:
    """Return stamps [s] and values within a span of time, with breaks at gaps."""
    kept = [(piece, (piece.t >= span[0]) & (piece.t <= span[1])) for piece in pieces]
    return joined([(piece.t[keep], series(piece)[keep]) for piece, keep in kept if keep.any()])


def sample_period(t: FloatArray) -> float:
    """Return the usual step between stamps [s]."""
    return float(np.median(np.diff(t))) if len(t) > 1 else 1.0


def has_channel(motion: DrawnMotion, channel: str) -> bool:
    """Return whether all pieces of a motion have a channel."""
    return all(channel in piece.channels for piece in motion.pieces)


def whole_span(comparison: Comparison) -> Span:
    """Return the first and the last stamp [s]."""
    return float(comparison.reference[0].t[0]), float(comparison.reference[-1].t[-1])


def shown_span(comparison: Comparison) -> Span:
    """Return the span that velocities are shown over [s].

    It is a whole run; of a long one the part of its longest piece in which a plant moves most of the time, the nearest to
    the piece's middle where several are as good.
    """
    start, stop = whole_span(comparison)
    if stop - start <= _LONGEST_SHOWN:
        return start, stop
    motion = drawn_motions(comparison)[-1]
    longest = max(motion.pieces, key=lambda piece: float(piece.t[-1] - piece.t[0]))
    first, last = float(longest.t[0]), float(longest.t[-1])
    begins = np.append(np.arange(first, last - _STRETCH, 1.0), 0.5 * (first + last - _STRETCH))
    moved = np.cumulative_sum(np.abs(longest.twist[:, (0, 2)]).max(axis=1) > _MOVES, include_initial=True)
    inside = [np.searchsorted(longest.t, begins + end) for end in (0.0, _STRETCH)]
    share = (moved[inside[1]] - moved[inside[0]]) / np.maximum(inside[1] - inside[0], 1)
    good = begins[share >= share.max() - _AS_GOOD]
    nearest = float(good[np.argmin(np.abs(good - begins[-1]))])
    begin = min(max(first, nearest), stop - _STRETCH)
    return begin, begin + _STRETCH


def time_axis(comparison: Comparison, ax: Axes, remark: str = "") -> None:
    """Give a panel the span of time that all share; its label says where that is not the whole run."""
    span, (start, stop) = shown_span(comparison), whole_span(comparison)
    ax.set_xlim(*span)
    part = "" if span == (start, stop) else f", part of {start:.0f} to {stop:.0f} s"
    ax.set_xlabel(f"time [s]{part}{remark}")


def draw_velocity(comparison: Comparison, title: str, column: int, command: int, ax: Axes) -> None:
    """Draw one component of every robot's velocity, and of the command if it is a velocity."""
    span = shown_span(comparison)
    for motion in drawn_motions(comparison):
        motion.draw(ax, *over_time(motion.pieces, lambda piece: piece.twist[:, column], span))
    if has_speed_commands(comparison):
        parts = []
        for commands, piece in zip(comparison.commands, comparison.reference, strict=True):
            t = piece.t[0] + commands.dt * np.arange(commands.n + 1)
            keep = (t >= span[0] - commands.dt) & (t <= span[1])
            values = np.append(commands.values[:, command], commands.values[-1, command])
            if keep.any():
                parts.append((t[keep], values[keep]))
        t, values = joined(parts)
        ax.plot(t, values, color=COMMAND_INK, linewidth=1.0, drawstyle="steps-post", zorder=1.8, gid="command")
    ax.set_title(title)
    at_least(ax, 0.1)
    time_axis(comparison, ax)


def has_speed_commands(comparison: Comparison) -> bool:
    """Return whether the plants were driven by speed and yaw rate, not by wheel rates."""
    return all(commands.kind == "twist" for commands in comparison.commands)


def is_impulsive(comparison: Comparison, name: str) -> bool:
    """Return whether a plant's yaw rate jumps: it has no inertia, or wheel rates drive a planar model."""
    return name in _IMPULSIVE or (not has_speed_commands(comparison) and name not in ("mujoco", comparison.reference_name))


def draw_acceleration(comparison: Comparison, motions: Sequence[DrawnMotion], ax: Axes) -> None:
    """Yaw accelerations around the swiftest reversal of the turn, where friction changes its sign."""
    leader = next((motion for motion in motions if motion.name == _CHATTERING), motions[0])
    reverses, i, t = _swiftest_turn(leader)
    stamps = leader.pieces[i].t
    half = 0.5 * max(_ZOOM_TIME, _ZOOM_SAMPLES * sample_period(stamps))
    begin = max(float(stamps[0]), min(t - half, float(stamps[-1]) - 2.0 * half))
    span = begin, min(begin + 2.0 * half, float(stamps[-1]))
    curves = {}
    for motion in motions:
        x, y = over_time([motion.pieces[i]], lambda piece: piece.channels["yaw_acceleration_rad_s2"], span)
        curves[motion.name] = y
        if motion.name == _CHATTERING:
            # least and greatest accelerations since the sample before, which samples alone would hide
            _, band = over_time([motion.pieces[i]], lambda piece: piece.channels["yaw_acceleration_range_rad_s2"], span)
            curves[f"{motion.name} between samples"] = band.ravel()
            ink = ink_of(motion.name)
            ax.fill_between(x, band[:, 0], band[:, 1], color=ink, alpha=0.2, linewidth=0.0, step="pre", zorder=1.6)
            ax.plot(x, y, color=ink, linewidth=0.9, zorder=1.7, gid=motion.name)
        else:
            motion.draw(ax, x, y)
    low, high, cut = _clip(curves)
    left_out = [motion.name for motion in drawn_motions(comparison) if is_impulsive(comparison, motion.name)]
    where = "where the turn reverses" if reverses else "where the turn changes most"
    ax.set(title=f"Yaw acceleration [rad/s²] {where}", xlim=span, ylim=(low, high))
    ax.set_xlabel(f"time [s], a sample every {1e3 * sample_period(stamps):.3g} ms")
    shaded = [f"{leader.name}: its range is shaded"] if leader.name == _CHATTERING else []
    corner_note(ax, "; ".join([*cut, *shaded, *([f"{', '.join(left_out)}: impulses, not drawn"] if left_out else [])]))


def _clip(curves: Mapping[str, FloatArray]) -> tuple[float, float, list[str]]:
    """Limits of an axis that hold zero and each curve, less lonely spikes; and the spikes that are cut off, in words."""
    peaks = {name: float(np.max(np.abs(y))) for name, y in curves.items()}
    low, high, cut = 0.0, 0.0, []
    for name, y in curves.items():
        own = float(np.percentile(np.abs(y), _CLIP_PERCENTILE, method="lower"))
        usual = max(own, *(peak for other, peak in peaks.items() if other != name), 0.0)
        if usual > _CLIP_FLOOR and peaks[name] > _CLIP_RATIO * usual:
            cut.append(f"{name}, which reaches {peaks[name]:.3g}, is cut off")
            y = np.clip(y, -usual, usual)
        low, high = min(low, float(y.min())), max(high, float(y.max()))
    reach = max(high - low, _CLIP_FLOOR)
    return low - 0.25 * reach, high + 0.05 * reach, cut


def _swiftest_turn(motion: DrawnMotion) -> tuple[bool, int, float]:
    """Find where a yaw rate changes its sign most swiftly, or else where its acceleration is greatest.

    Returns:
        Whether it changes its sign; the index of the piece; the time [s].
    """
    best = (False, -1.0, 0, 0.0)
    for i, piece in enumerate(motion.pieces):
        rate, reach = piece.twist[:, 2], max(1, round(0.1 / sample_period(piece.t)))
        k = np.arange(len(piece))
        change = np.abs(rate[np.minimum(k + reach, len(piece) - 1)] - rate[np.maximum(k - reach, 0)])
        crossing = np.append(rate[1:] * rate[:-1] < 0.0, False) & (change > _TURN_FLOOR)
        acceleration = np.abs(piece.channels["yaw_acceleration_rad_s2"])
        for found, score in ((True, np.where(crossing, change, -1.0)), (False, acceleration)):
            m = int(np.argmax(score))
            if score[m] >= 0.0:
                best = max(best, (found, float(score[m]), i, float(piece.t[m])))
    return best[0], best[2], best[3]


def _running_mean(t: FloatArray, values: FloatArray) -> FloatArray:
    """Return means of (M, k) values over `_MEAN_TIME` around each sample, over less at the ends."""
    reach = int(0.5 * _MEAN_TIME / sample_period(t))
    total = np.cumulative_sum(values, axis=0, include_initial=True)
    k = np.arange(len(t))
    low, high = np.maximum(k - reach, 0), np.minimum(k + reach + 1, len(t))
    return (total[high] - total[low]) / (high - low)[:, None]


def draw_loads(comparison: Comparison, motion: DrawnMotion, ax: Axes) -> None:
    """Draw the loads of the four wheels, and the verdict on the contact."""
    span = shown_span(comparison)
    t, loads = over_time(motion.pieces, lambda piece: piece.channels["wheel_load_N"], span)
    _, means = over_time(motion.pieces, lambda piece: _running_mean(piece.t, piece.channels["wheel_load_N"]), span)
    for k, wheel in enumerate(WHEELS):
        ink, name = ink_of(motion.name) if wheel.startswith("front") else "0.25", wheel.replace("_", " ")
        ax.plot(t, loads[:, k], color=ink, linewidth=0.6, alpha=0.35, zorder=1.8)
        ax.plot(t, means[:, k], color=ink, linestyle=_SIDES[wheel.endswith("right")], linewidth=1.6, label=name, gid=wheel)
    told = f"; lines are means over {_MEAN_TIME:g} s"
    if has_channel(motion, QUASI_STATIC):
        _, formula = over_time(motion.pieces, lambda piece: piece.channels[QUASI_STATIC], span)
        ax.plot(t, formula, color=QUIET, linestyle=(0, (1, 1)), linewidth=1.0, zorder=2.5)
        told += ", dotted: quasi-static"
    ax.legend(loc="lower right", bbox_to_anchor=(1.01, 0.98), ncols=4, frameon=False, fontsize=9.0, handlelength=1.8,
              columnspacing=1.2, borderaxespad=0.0)  # fmt: skip
    ax.set_title("Wheel loads [N]")
    time_axis(comparison, ax, told)
    at_least(ax, 10.0)
    low, high = ax.get_ylim()
    ax.set_ylim(low - 0.3 * (high - low), high)  # room for the verdict
    result = comparison.plants.get(motion.name)
    if result is not None and result.health is not None:
        health = result.health
        verdict = health.verdict if health.ok else health.verdict.upper()
        shares = f"lowest load {health.lowest_load_share:.0%} of a wheel's mean, deviation {health.load_deviation:.1%}"
        numbers = (
            ("loads' sum off by {:.1f} N rms", health.load_sum_rms_N),
            ("at most {:.0f} N m a side", health.peak_torque_N_m),
            ("{:.0f} kg to push", health.apparent_mass_kg),
        )
        known = "; ".join(words.format(value) for words, value in numbers if value is not None)
        corner_note(ax, f"{motion.name} {verdict}: {shares}\n{known}".strip(), ALARM if health.advice else QUIET)
