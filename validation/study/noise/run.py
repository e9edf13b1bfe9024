"""Take the noise of every signal of a log by a high-pass filter, as Sec. 3.4.4 does."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from ssmr.types import FloatArray
from validation.bench.simulated_logs import open_log
from validation.files.log import ANY_COLUMN, COLUMNS, POSE_COLUMNS, Group
from validation.files.signals import TIME_ROUNDOFF
from validation.progress import Progress, Report, silent
from validation.study.noise.filtering import HIGHEST, PASSBAND, HighPass, estimate_noise
from validation.study.noise.result import NoiseOptions, NoiseStudy, NoisySignal
from validation.study.result import keeping

_EVEN = 1.5
"""A step longer than this many periods ends a piece of even samples [1]."""
_STILL = 1.0
"""A value that repeats itself for longer is no measurement of something that moves [s]."""
_TOGETHER = (POSE_COLUMNS, ("enc_left", "enc_right"))
"""Columns that are measured at once."""
_SHOWN = 3.0
"""Duration of the stretch that is drawn [s]."""
_SEGMENT = 512
"""Greatest number of samples in a segment of a spectrum."""


def study_noise(options: NoiseOptions | None = None, *, workers: int | None = None, progress: Report = silent) -> NoiseStudy:
    """Estimate the noise of every measured signal of a log; commands are left out.

    Args:
        options: the log, the begin of the passband and the part of the log; a log is needed.
        workers: not used, because one processor is enough.
        progress: called after each column.

    Raises:
        SsmrError: the plant of a simulated drive diverged.
        ValueError: there is no log, it cannot be read, or no column of it is long enough.
    """
    o = options or NoiseOptions()
    if o.recording is None:
        raise ValueError("the study of noise needs a log: recording, a path or a drive such as traj4@mujoco")
    log = open_log(o.recording, profile=o.profile, seed=o.seed, robot=o.robot)
    return noise_of(log.cut(o.start, o.until).groups, log.name, o, progress)


def noise_of(groups: Mapping[str, Group], name: str, options: NoiseOptions, progress: Report = silent) -> NoiseStudy:
    """Return the study of a log that was read.

    Args:
        groups: columns of the log.
        name: name of the log.
        options: begin of the passband.
        progress: called after each column.

    Raises:
        ValueError: no column is long enough.
    """
    columns = [(group, column) for key, group in groups.items() if key != "cmd" for column in group.columns]
    signals, left_out = list[NoisySignal](), dict[str, str]()
    with keeping(signals) as course:
        for k, (group, column) in enumerate(columns):
            try:
                signals.append(_noise(group, column, options.passband))
            except ValueError as why:
                left_out[column] = str(why)
            progress(Progress(k + 1, len(columns), column))
    if not signals:
        raise ValueError(f"{name} has no noise to measure: {'; '.join(f'{n}: {why}' for n, why in left_out.items())}")
    return NoiseStudy(log=name, options=options, signals=tuple(signals), left_out=left_out, status=course.status)


def _noise(group: Group, column: str, passband: float | None) -> NoisySignal:
    values = group.columns[column]
    if not np.ptp(values) > 0.0:
        raise ValueError("it never changes")
    new = _measured_anew(group, column)
    t, values = group.t[new], values[new]
    steps = np.diff(t)
    period = float(np.median(steps))
    even = steps <= _EVEN * period
    if not even.any():
        raise ValueError("its samples are too far apart")
    pieces = [np.arange(a, b) for a, b in _runs(even)]
    rate = 1.0 / float(np.mean(steps[even]))
    begin = min(PASSBAND, rate / 4.0) if passband is None and PASSBAND > HIGHEST * rate / 2.0 else passband or PASSBAND
    filter = HighPass(rate, begin)
    estimate = estimate_noise([values[piece] for piece in pieces], filter)
    spectrum = _spectrum([values[piece] for piece in pieces], rate)
    longest = max(pieces, key=len)
    margin = len(filter.taps) // 2
    noise, inner = filter(values[longest]), longest[margin : len(longest) - margin]
    middle, half = len(inner) // 2, max(2, round(0.5 * _SHOWN * rate))
    window = slice(max(0, middle - half), middle + half)
    shown = t[inner[window]], values[inner[window]], noise[window]
    return NoisySignal(
        column, COLUMNS.get(column, ANY_COLUMN).unit, filter, estimate, _tilt(spectrum, begin, rate), spectrum, shown
    )


def _measured_anew(group: Group, column: str) -> NDArray[np.bool_]:
    """Return (M,) whether samples of a column are new and not only logged again.

    What repeats itself is taken once for each usual time between changes, and not at all once it has repeated itself for
    `_STILL`: then the robot stands, or the value is a set point.
    """
    together = next((names for names in _TOGETHER if column in names), (column,))
    values = np.column_stack([group.columns[name] for name in together if name in group.columns])
    t, changed = group.t, np.concatenate([[True], np.any(values[1:] != values[:-1], axis=1)])
    usual = min(float(np.median(np.diff(t[changed]))), _STILL) if np.count_nonzero(changed) > 1 else _STILL
    since = t - t[np.maximum.accumulate(np.where(changed, np.arange(len(t)), 0))]
    turn = np.floor((since + TIME_ROUNDOFF) / usual)
    again = np.concatenate([[False], (turn[1:] > turn[:-1]) & (since[1:] < _STILL)])
    return np.asarray(changed | again)


def _runs(even: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and last (exclusive) sample of each run of even steps."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], even, [False]]).astype(int)))
    return [(int(a), int(b) + 1) for a, b in edges.reshape(-1, 2)]


def _spectrum(pieces: Sequence[FloatArray], rate: float) -> tuple[FloatArray, FloatArray]:
    """Return (F,) frequencies [Hz] without zero and the (F,) one-sided density [unit²/Hz], over all pieces."""
    size = min(_SEGMENT, max(map(len, pieces)))
    found, total = np.zeros(size // 2), 0
    for piece in pieces:
        if len(piece) >= size:
            frequencies, density = signal.welch(piece, rate, nperseg=size, detrend="linear")
            found, total = found + len(piece) * density[1 : 1 + size // 2], total + len(piece)
    return frequencies[1 : 1 + size // 2], found / total


def _tilt(spectrum: tuple[FloatArray, FloatArray], passband: float, rate: float) -> float:
    frequencies, density = spectrum
    middle = 0.5 * (passband + 0.5 * rate)
    low, high = density[(frequencies >= passband) & (frequencies < middle)], density[frequencies >= middle]
    return float(low.mean() / high.mean()) if len(low) and len(high) and high.mean() > 0.0 else math.nan
