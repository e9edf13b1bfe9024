"""The picture of a study of noise: for each signal a stretch of it, what the filter leaves, and its spectrum."""

from __future__ import annotations

from functools import partial

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from validation.report.drawing import (
    DASHED,
    QUIET,
    Row,
    draw_footer,
    note_rows,
    plain_ticks,
    put_together,
    side_by_side,
    text_row,
)
from validation.study.noise.result import NoiseStudy, NoisySignal

MOST_DRAWN = 10
"""Greatest number of signals in a picture; the table has all."""
_SIGNAL, _NOISE = "#0072b2", "#d55e00"


def _draw_signal(signal: NoisySignal, ax: Axes) -> None:
    t, values, noise = signal.shown
    ax.plot(t, values, ".", color="0.45", markersize=3.5, gid="measured")
    ax.plot(t, values - noise, color=_SIGNAL, linewidth=1.2, gid="without noise")
    ax.set(title=signal.label, xlabel="time [s]", xlim=(t[0], t[-1]))


def _draw_noise(signal: NoisySignal, ax: Axes) -> None:
    t, _, noise = signal.shown
    std = signal.estimate.variance**0.5
    ax.plot(t, noise, color=_NOISE, linewidth=0.8, marker=".", markersize=3.0, gid="noise")
    for level in (-2.0 * std, 2.0 * std):
        ax.axhline(level, color=QUIET, linewidth=0.9, linestyle=DASHED)
    most = 1.1 * max(3.0 * std, float(abs(noise).max()))
    ax.set(title=f"above {signal.filter.passband:.3g} Hz: {std:.2g} rms", xlabel="time [s]", xlim=(t[0], t[-1]),
           ylim=(-most, most))  # fmt: skip


def _draw_spectrum(signal: NoisySignal, ax: Axes) -> None:
    frequencies, density = signal.spectrum
    seen = density > 0.0
    ax.loglog(frequencies[seen], density[seen], color="0.35", linewidth=1.0, gid="spectrum")
    level, passband = 2.0 * signal.estimate.white / signal.filter.rate, signal.filter.passband
    ax.plot([frequencies[0], frequencies[-1]], [level, level], color=_NOISE, linewidth=1.4, gid="white")
    ax.axvline(passband, color=QUIET, linewidth=0.9, linestyle=DASHED)
    ax.axvspan(passband, frequencies[-1], color=_NOISE, alpha=0.08, linewidth=0.0)
    remarks = f": {', '.join(signal.remarks)}" if signal.remarks else ""
    ax.set(title=f"density [unit²/Hz]{remarks}", xlabel="frequency [Hz]", xlim=(frequencies[0], frequencies[-1]))
    for axis in (ax.xaxis, ax.yaxis):
        plain_ticks(axis)


def draw_noise(study: NoiseStudy) -> Figure:
    """Draw each signal, its noise and its spectrum side by side, 1600 px wide."""
    drawn = study.signals[:MOST_DRAWN]
    rows: list[Row] = []
    for signal in drawn:
        panels = [partial(draw, signal) for draw in (_draw_signal, _draw_noise, _draw_spectrum)]
        rows.append(side_by_side(2.1, panels))
    more = len(study.signals) - len(drawn)
    foot = (
        f"{study.heading()} · points: measured; blue: without what is above the passband; middle: that, with twice its "
        f"standard deviation; right: spectrum, and white noise that leaves as much{f' · {more} more' if more else ''}"
    )
    return put_together([*rows, *note_rows(study.notes()), text_row(0.3, partial(draw_footer, foot))])
