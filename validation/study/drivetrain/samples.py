"""Currents in steady driving: means of windows in which the wheels turn steadily, or the values of a slow sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ssmr.types import FloatArray, IndexArray
from validation.study.drivetrain.logs import DriveLog

SETTLE, LEAST, MOST = 1.2, 1.0, 6.2
"""A steady window leaves out so much of its beginning, has at least so much left, and is at most so long [s]."""
_STEADY_RATE = 0.13
"""Wheel rates that differ by less are steady [rad/s]: two steps of a Husky's set points."""
_LONG_STEP = 0.3
"""A step of time longer than this ends a window [s]."""
_STANDING = 0.15
"""Wheels whose rates add up to less stand [rad/s]."""
SLOW_SENSOR = 0.5
"""A current that is refreshed less often is used value by value, and not in windows [s]."""
_SLOW_RATE = 0.06
"""A side that turns slower than this may have its bridge off [rad/s]."""
_SEEN = 0.7
"""A slow sensor's value belongs to the wheel rates of so much time before it [s]."""
_CALM = 1.0
"""Wheel rates that vary by more within that time do not belong to one current [rad/s]."""
_FEWEST = 5
"""Fewest rows in that time."""
BLOCK = 6.0
"""Length of a block of the bootstrap [s], where no windows make blocks: as long as a command of the logs at hand."""
_FIELDS = ("t", "block", "side", "rates", "current", "voltage", "yaw_rate")


@dataclass(frozen=True, eq=False)
class CurrentSamples:
    """Currents of one side each, in steady driving, n of them."""

    t: FloatArray
    """(n,) time [s]."""
    block: IndexArray
    """(n,) which block of the bootstrap each belongs to."""
    side: IndexArray
    """(n,) 0 for the left side, 1 for the right one."""
    rates: FloatArray
    """(2, n) wheel rates, left and right [rad/s]."""
    current: FloatArray
    """(n,) current of that side [A]."""
    voltage: FloatArray
    """(n,) voltage of the battery [V]."""
    yaw_rate: FloatArray
    """(n,) measured yaw rate [rad/s]; NaN where it is unknown."""

    def __len__(self) -> int:
        return len(self.t)

    @property
    def rate(self) -> FloatArray:
        """(n,) wheel rate of each sample's own side [rad/s]."""
        own: FloatArray = self.rates[self.side, np.arange(len(self))]
        return own

    def take(self, which: IndexArray | NDArray[np.bool_]) -> CurrentSamples:
        """Return some of the samples."""
        return CurrentSamples(*(getattr(self, n)[..., which] for n in _FIELDS))

    def resampled(self, rng: np.random.Generator) -> CurrentSamples:
        """Return as many blocks as there are, drawn with replacement."""
        members = [np.flatnonzero(self.block == b) for b in np.unique(self.block)]
        return self.take(np.concatenate([members[k] for k in rng.integers(0, len(members), len(members))]))

    def moving(self) -> CurrentSamples:
        """Return those whose own side turns: a bridge at a set point of zero may be off."""
        return self.take(np.abs(self.rate) >= _SLOW_RATE)


def joined_samples(parts: Sequence[CurrentSamples]) -> CurrentSamples:
    """Return the samples of several logs together; their blocks stay apart."""
    first, *others = parts
    for other in others:
        apart = int(first.block.max(initial=-1)) + 1 - int(other.block.min(initial=0))
        pairs = [(getattr(first, n), getattr(other, n) + (apart if n == "block" else 0)) for n in _FIELDS]
        first = CurrentSamples(*(np.concatenate(pair, axis=-1) for pair in pairs))
    return first


def steady_windows(log: DriveLog) -> list[NDArray[np.bool_]]:
    """Return the windows of a log in which the wheels turn steadily, each as (M,) bool without its beginning."""
    t, rates, found, i = log.t, log.rates, [], 0
    while i < len(t) - 1:
        stop = int(np.searchsorted(t, t[i] + MOST, side="right"))
        moved = np.abs(rates[:, i:stop] - rates[:, i : i + 1]).max(axis=0) >= _STEADY_RATE
        moved[1:] |= np.diff(t[i:stop]) >= _LONG_STEP
        j = i + (int(np.argmax(moved)) if moved.any() else len(moved)) - 1
        if t[j] - t[i] >= SETTLE + LEAST and np.abs(rates[:, i]).sum() > _STANDING:
            found.append((t >= t[i] + SETTLE) & (t <= t[j]))
        i = j + 1
    return found


def window_means(log: DriveLog) -> CurrentSamples:
    """Return the mean currents of a log's steady windows, two for each window; a window is a block."""
    assert log.currents is not None
    rows = []
    for k, window in enumerate(steady_windows(log)):
        rates, yaw_rate = log.rates[:, window].mean(axis=1), _yaw_rate(log, window)
        for side in (0, 1):
            current = log.currents[side, window].mean()
            rows.append((log.t[window][0], k, side, *rates, current, _voltage(log, window), yaw_rate))
    return _samples(rows)


def window_rows(log: DriveLog) -> CurrentSamples:
    """Return the currents of a log's steady windows sample by sample."""
    assert log.currents is not None
    rows = []
    for k, window in enumerate(steady_windows(log)):
        voltage = _voltage(log, window)
        for m in np.flatnonzero(window):
            for side in (0, 1):
                rows.append((log.t[m], k, side, *log.rates[:, m], log.currents[side, m], voltage, np.nan))
    return _samples(rows)


def refreshed_values(log: DriveLog) -> CurrentSamples:
    """Return each new value of a slow sensor with the mean wheel rates before it; `BLOCK` seconds are a block."""
    assert log.currents is not None
    t, rows = log.t, []
    for side in (0, 1):
        for k in np.flatnonzero(np.diff(log.currents[side]) != 0.0) + 1:
            seen = (t > t[k] - _SEEN) & (t <= t[k] + 0.05)
            rates = log.rates[:, seen]
            gap = seen.sum() < _FEWEST or np.diff(t[seen]).max() >= _LONG_STEP
            if gap or np.ptp(rates, axis=1).max() >= _CALM or np.abs(rates.mean(axis=1)).sum() <= 2.0 * _STANDING:
                continue
            yaw_rate = np.nan if log.gyro is None else float(log.gyro[seen].mean())
            voltage = _voltage(log, seen)
            rows.append((t[k], int(t[k] // BLOCK), side, *rates.mean(axis=1), log.currents[side, k], voltage, yaw_rate))
    return _samples(rows)


def refresh_period(log: DriveLog) -> float:
    """Return how often the currents are refreshed: the median time between new values [s]."""
    assert log.currents is not None
    steps = [np.diff(log.t[np.flatnonzero(np.diff(c) != 0.0) + 1]) for c in log.currents]
    known = np.concatenate(steps)
    return float(np.median(known)) if len(known) else float("inf")


SampleKind = Literal["windows", "values"]


def sample_kind(log: DriveLog) -> SampleKind:
    """Return how a log's currents are sampled: means of steady windows, or the single values of a slow sensor."""
    return "windows" if refresh_period(log) < SLOW_SENSOR else "values"


def _samples(rows: list[tuple[float, ...]]) -> CurrentSamples:
    table = np.array(rows, dtype=np.float64).reshape(-1, 8).T
    t, block, side, left, right, current, voltage, yaw_rate = table
    whole = block.astype(np.intp), side.astype(np.intp)
    return CurrentSamples(t, *whole, np.stack([left, right]), current, voltage, yaw_rate)


def _voltage(log: DriveLog, which: NDArray[np.bool_]) -> float:
    """Return the mean voltage of both sides; the log's median where nothing was measured yet."""
    known = np.empty(0) if log.voltages is None else log.voltages[:, which]
    known = known[known > 1.0]
    return float(known.mean()) if len(known) else log.battery


def _yaw_rate(log: DriveLog, which: NDArray[np.bool_]) -> float:
    """Return the mean yaw rate of the gyro, or the slope of the heading; NaN where the localiser jumped."""
    if log.gyro is not None:
        return float(log.gyro[which].mean())
    if log.yaw is None:
        return float("nan")
    t, yaw = log.t[which] - log.t[which][0], log.yaw[which]
    slope, start = np.polyfit(t, yaw, 1)
    return float(slope) if np.std(yaw - start - slope * t) < 0.15 else float("nan")
