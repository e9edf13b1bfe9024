"""How noisy each signal of a log is, by what a high-pass filter leaves of it (Sec. 3.4.4; docs/logs.md).

The thesis uses Matlab's `highpass` with a passband from 10 Hz, a steepness of 0.85 and 60 dB of attenuation, and takes the
variance. Such a filter takes away the noise below its passband too, so the variance of white noise comes out too small by
the share of the band that is lost; and 60 dB of attenuation leave up to a thousandth of the motion itself. Here the share
is known and can be put back, and constants and ramps are taken away exactly.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Annotated, NamedTuple

import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import signal

from ssmr.parameters import require_within
from ssmr.types import FloatArray, frozen_array
from validation import cli
from validation.bench.logs import open_log
from validation.files.log import ANY_COLUMN, COLUMNS, POSE_COLUMNS, Group
from validation.files.signals import TIME_ROUNDOFF
from validation.report import drawing
from validation.report.report import Report
from validation.report.table import Row, Table
from validation.study.options import StudyOptions
from validation.study.sweep import picture, sweep

PASSBAND, STEEPNESS, ATTENUATION = 10.0, 0.85, 60.0
"""The thesis' filter: begin of the passband [Hz], steepness of the transition [1], attenuation of the stopband [dB]."""
_HIGHEST = 0.9  # begin of a passband over half the sample rate; above that, nothing would be left to measure
_LEAST_LEFT = 20  # samples behind a filter from which a variance is taken
_ROUNDING = 1e-9  # noise below this share of a signal's range is rounding
_EVEN = 1.5  # a step longer than this many periods ends a piece of even samples
_STILL = 1.0  # a value that repeats itself for longer is no measurement of something that moves [s]
_SHOWN, _MOST_DRAWN = 3.0, 10  # the stretch that is drawn [s], and the greatest number of signals in the picture
_SEGMENT = 512  # samples in a segment of a spectrum, at most


@dataclass(frozen=True, eq=False)
class HighPass:
    """A symmetric high-pass filter for samples at one rate."""

    rate: float
    """Samples a second [Hz]."""
    passband: float = PASSBAND
    """Begin of the passband [Hz]."""
    exact: bool = True
    """Whether constants and ramps are taken away exactly. Otherwise the filter is the thesis', 60 dB below its passband."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a passband that does not begin between zero and nine tenths of half the sample rate."""
        if not 0.0 < self.passband <= _HIGHEST * self.rate / 2.0:
            least = 2.0 * self.passband / _HIGHEST
            raise ValueError(
                f"a passband from {self.passband:g} Hz needs more than {least:g} samples a second, got {self.rate:.4g}"
            )

    @cached_property
    def taps(self) -> FloatArray:
        """(K,) coefficients, K odd, symmetric: the Kaiser window's design, of the least order for the attenuation.

        The transition is as wide as Matlab makes it: (1 - steepness) of the passband's begin, below it.
        """
        width = (1.0 - STEEPNESS) * self.passband
        count, beta = signal.kaiserord(ATTENUATION, width / (self.rate / 2.0))
        count += 1 - count % 2
        taps = signal.firwin(count, self.passband - width / 2.0, window=("kaiser", beta), pass_zero=False, fs=self.rate)
        if self.exact:
            window = np.kaiser(count, beta)
            taps = taps - window * (taps.sum() / window.sum())
        return frozen_array(taps, "taps", (None,))

    @property
    def kept(self) -> float:
        """Share of the variance of white noise that passes [1]."""
        return float(np.sum(np.square(self.taps)))

    def __call__(self, values: FloatArray) -> FloatArray:
        """Return (M - K + 1,) what passes of (M,) samples; the ends, where the filter sees only part, are left out.

        Raises:
            ValueError: there are fewer samples than the filter has coefficients.
        """
        if len(values) < len(self.taps):
            raise ValueError(f"the filter needs {len(self.taps)} samples without a gap, got {len(values)}")
        return np.asarray(signal.fftconvolve(values - values.mean(), self.taps, "valid") + values.mean() * self.taps.sum())


class NoiseEstimate(NamedTuple):
    """The noise of one signal."""

    variance: float  # variance of what passes, as the thesis takes it [unit²]
    white: float  # variance of white noise that would leave as much [unit²]
    error: float  # standard error of `white` if the noise is white and Gaussian [unit²]
    samples: int  # number of filtered samples


def estimate_noise(pieces: Sequence[FloatArray], filter: HighPass) -> NoiseEstimate:
    """Return the noise of a signal in pieces without a gap; pieces that are too short are left out.

    Args:
        pieces: (M,) samples each, at the filter's rate.
        filter: the high-pass filter.

    Raises:
        ValueError: too little is left.
    """
    passed = [filter(piece) for piece in pieces if len(piece) >= len(filter.taps)]
    left = np.concatenate(passed) if passed else np.empty(0)
    if len(left) < _LEAST_LEFT:
        raise ValueError(f"{len(left)} samples are left behind the filter, wanted {_LEAST_LEFT}")
    variance = float(np.var(left, ddof=1))
    if variance <= (_ROUNDING * max(float(np.ptp(piece)) for piece in pieces)) ** 2:
        raise ValueError("it shows no noise")
    white = variance / filter.kept
    correlation = np.correlate(filter.taps, filter.taps, "full") / filter.kept
    together = float(np.sum(np.square(correlation)))  # so many filtered samples count as one
    return NoiseEstimate(variance, white, white * math.sqrt(2.0 * together / len(left)), len(left))


class NoisySignal(NamedTuple):
    """The noise of one column of a log."""

    unit: str  # unit of the column; empty where it is not known
    filter: HighPass  # filter that it went through, at its own rate
    estimate: NoiseEstimate  # what was left
    tilt: float  # density in the lower half of the passband over that in the upper half [1]; 1 for white noise
    spectrum: tuple[FloatArray, FloatArray]  # (F,) frequencies [Hz] and (F,) density of the whole signal [unit²/Hz]
    shown: tuple[FloatArray, FloatArray]  # (S,) times [s] and noise of a short stretch, for the picture

    def row(self) -> Row:
        """Return the row of its table."""
        e = self.estimate
        numbers = {
            "rate_Hz": self.filter.rate, "passband_Hz": self.filter.passband, "samples": e.samples, "variance": e.variance,
            "kept_share": self.filter.kept, "white_variance": e.white, "white_standard_error": e.error,
            "white_std": math.sqrt(e.white), "low_over_high": self.tilt,
        }  # fmt: skip
        return {"unit": self.unit, **numbers}


def noise_of(group: Group, column: str, passband: float | None = None) -> NoisySignal:
    """Return the noise of a column of a log.

    Args:
        group: columns with the same stamps.
        column: name of the column.
        passband: begin of the passband [Hz]; None for 10 Hz, or a quarter of the sample rate where that is too slow.

    Raises:
        ValueError: the column has no noise to measure, or too few samples.
    """
    if not np.ptp(group.columns[column]) > 0.0:
        raise ValueError("it never changes")
    new = _measured_anew(group, column)
    t, values = group.t[new], group.columns[column][new]
    steps = np.diff(t)
    even = steps <= _EVEN * float(np.median(steps))
    if not even.any():
        raise ValueError("its samples are too far apart")
    edges = np.flatnonzero(np.diff(np.concatenate([[False], even, [False]]).astype(int))).reshape(-1, 2)
    pieces = [np.arange(first, last + 1) for first, last in edges]
    rate = 1.0 / float(np.mean(steps[even]))
    begin = passband or (PASSBAND if PASSBAND <= _HIGHEST * rate / 2.0 else rate / 4.0)
    filter = HighPass(rate, begin)
    estimate = estimate_noise([values[piece] for piece in pieces], filter)
    frequencies, density = spectrum = _spectrum([values[piece] for piece in pieces], rate)
    middle = 0.5 * (begin + 0.5 * rate)
    low, high = density[(frequencies >= begin) & (frequencies < middle)], density[frequencies >= middle]
    tilt = float(low.mean() / high.mean()) if len(low) and len(high) and high.mean() > 0.0 else math.nan
    longest, margin = max(pieces, key=len), len(filter.taps) // 2
    noise, at = filter(values[longest]), t[longest[margin : len(longest) - margin]]
    half = max(2, round(0.5 * _SHOWN * rate))
    window = slice(max(0, len(at) // 2 - half), len(at) // 2 + half)
    return NoisySignal(COLUMNS.get(column, ANY_COLUMN).unit, filter, estimate, tilt, spectrum, (at[window], noise[window]))


def _measured_anew(group: Group, column: str) -> NDArray[np.bool_]:
    """Return (M,) whether samples of a column are new and not only logged again.

    What repeats itself is taken once for each usual time between changes, and not at all once it has repeated itself for
    `_STILL`: then the robot stands, or the value is a set point. Poses and wheel rates are measured at once.
    """
    together = next((names for names in (POSE_COLUMNS, ("enc_left", "enc_right")) if column in names), (column,))
    values = np.column_stack([group.columns[name] for name in together if name in group.columns])
    t, changed = group.t, np.concatenate([[True], np.any(values[1:] != values[:-1], axis=1)])
    usual = min(float(np.median(np.diff(t[changed]))), _STILL) if np.count_nonzero(changed) > 1 else _STILL
    since = t - t[np.maximum.accumulate(np.where(changed, np.arange(len(t)), 0))]
    turn = np.floor((since + TIME_ROUNDOFF) / usual)
    again = np.concatenate([[False], (turn[1:] > turn[:-1]) & (since[1:] < _STILL)])
    return np.asarray(changed | again)


def _spectrum(pieces: Sequence[FloatArray], rate: float) -> tuple[FloatArray, FloatArray]:
    """Return (F,) frequencies [Hz] without zero and the (F,) one-sided density [unit²/Hz], over all pieces."""
    size = min(_SEGMENT, max(map(len, pieces)))
    found, total = np.zeros(size // 2), 0
    for piece in pieces:
        if len(piece) >= size:
            frequencies, density = signal.welch(piece, rate, nperseg=size, detrend="linear")
            found, total = found + len(piece) * density[1 : 1 + size // 2], total + len(piece)
    return frequencies[1 : 1 + size // 2], found / total


@dataclass(frozen=True)
class NoiseStudy(StudyOptions):
    """Options of the study of noise."""

    recording: Annotated[str, tyro.conf.Positional, cli.option(metavar="LOG")]
    """Path of a recording (.csv, .bag, .mcap, or the folder of a ROS 2 bag), or a drive to be simulated and logged, such as
    traj4@mujoco."""
    passband: Annotated[cli.Number, cli.option(metavar="HZ", default="10, or a quarter of a slow signal's rate")] = None
    """Begin of the filter's passband [Hz]."""
    start: Annotated[cli.Number, cli.option("from", metavar="SECONDS", default="the beginning")] = None
    """Leave out what was logged before this time [s]."""
    until: Annotated[cli.Number, cli.option(metavar="SECONDS", default="the end")] = None
    """Leave out what was logged after this time [s]."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a passband that is not positive."""
        require_within(self, ("passband",), 1e-6, 1e6)


@cli.program(NoiseStudy)
def study_noise(o: NoiseStudy) -> Report:
    """Measure how noisy each signal of a log is, by what a high-pass filter leaves of it (Sec. 3.4.4).

    Commands are left out.

    Raises:
        SsmrError: the plant of a simulated drive diverged.
        ValueError: the log cannot be read, or no column of it is long enough.
    """
    log = open_log(o.recording, profile=o.profile, seed=o.seed, robot=o.robot)
    groups = [group for key, group in log.cut(o.start, o.until).groups.items() if key != "cmd"]
    columns = {column: (group, column) for group in groups for column in group.columns}
    swept = sweep(columns, {"noise": lambda each: {"signal": noise_of(*each, o.passband)}}, workers=1, progress=o.progress)
    signals = {row["variant"]: row["signal"] for row in swept.rows if "signal" in row}
    slow = [name for name, s in signals.items() if o.passband is None and s.filter.passband < PASSBAND]
    sentences = list(swept.notes)
    if slow:
        sentences.append(
            f"The passband of {', '.join(slow)} begins at a quarter of the sample rate: these samples are too slow for the "
            f"thesis' {PASSBAND:g} Hz. The lower the passband begins, the more motion counts as noise."
        )
    caption = (
        "variance: of what passes, as the thesis takes it (Sec. 3.4.4), in the square of the signal's unit.\n"
        "kept: the share of white noise that passes.\n"
        "white: variance with the lost share put back, its standard error, and its root.\n"
        "low over high: density in the lower half of the passband over that in the upper half; far from 1 the noise is "
        "coloured, and jolts and the stamps' jitter are in it."
    )
    return Report(
        program="study", title=f"Noise of {log.name}", status=swept.status, sentences=sentences, has_text=True,
        draw=partial(_draw, signals),
        tables=[Table("Noise", [{"signal": name, **s.row()} for name, s in signals.items()], caption)],
        options={"passband": o.passband, "start": o.start, "until": o.until, "seed": o.seed},
        document={"schema": "ssmr.study/1", "study": "noise", "log": log.name},
    )  # fmt: skip


def _draw(signals: Mapping[str, NoisySignal], study: Report) -> Figure:
    """Return the picture: of each signal what passes, and its spectrum."""
    drawn = list(signals.items())[:_MOST_DRAWN]
    rows = [drawing.side_by_side(2.1, [partial(_draw_noise, *each), partial(_draw_spectrum, *each)]) for each in drawn]
    return picture(study, rows)


def _draw_noise(name: str, found: NoisySignal, ax: Axes) -> None:
    (t, noise), std = found.shown, math.sqrt(found.estimate.variance)
    ax.plot(t, noise, color=drawing.ALARM, linewidth=0.8, marker=".", markersize=3.0, gid="noise")
    for level in (-2.0 * std, 2.0 * std):
        ax.axhline(level, color=drawing.QUIET, linewidth=0.9, linestyle=drawing.DASHED)
    label = f"{name} [{found.unit}]" if found.unit else name
    title = f"{label} above {found.filter.passband:.3g} Hz: {std:.2g} rms, twice that dashed"
    ax.set(title=title, xlabel="time [s]", xlim=(t[0], t[-1]))


def _draw_spectrum(name: str, found: NoisySignal, ax: Axes) -> None:
    frequencies, density = found.spectrum
    seen, level = density > 0.0, 2.0 * found.estimate.white / found.filter.rate
    ax.loglog(frequencies[seen], density[seen], color="0.35", linewidth=1.0, gid="spectrum")
    ax.plot([frequencies[0], frequencies[-1]], [level, level], color=drawing.ALARM, linewidth=1.4, gid="white")
    ax.axvspan(found.filter.passband, frequencies[-1], color=drawing.ALARM, alpha=0.08, linewidth=0.0)
    ax.set(title=f"density of {name}, and of white noise", xlabel="frequency [Hz]")
    for axis in (ax.xaxis, ax.yaxis):
        drawing.plain_ticks(axis)
