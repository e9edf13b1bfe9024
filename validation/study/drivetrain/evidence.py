"""What a log itself says of its columns: are wheel rates measured, and whose currents are they?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ssmr.types import FloatArray
from validation.study.drivetrain.friction import Sensor
from validation.study.drivetrain.logs import DriveLog
from validation.study.drivetrain.samples import BLOCK, steady_windows

RatesAre = Literal["measured", "set points"]
HELD, OBEYED, USED = 5.0, 0.5, 5.9
"""A command counts if it is held so long and the wheels' rates change so soon after it; so much of it is used [s]."""
_LATE = 2.0
"""Wheel rates have settled so long after a command [s]."""
_NO_SCATTER = 1e-6
"""Standard deviation of a rate that is logged again and again [rad/s]: rounding."""
_FINEST_STEP, _OFF_STEP = 0.01, 0.02
"""Least step of wheel rates that is no rounding of the log [rad/s], and how far rates may lie off its multiples [steps]."""


class HeldCommand(NamedTuple):
    """A command that was held, and obeyed: samples `start` to `stop` (excluded) of a log."""

    start: int
    stop: int


def held_commands(log: DriveLog) -> list[HeldCommand]:
    """Return the commands of a log, other than zero, that were held for `HELD` seconds and at once obeyed."""
    if log.commands is None:
        return []
    new = np.any(np.diff(log.commands, axis=1) != 0.0, axis=0)
    edges = [0, *(np.flatnonzero(new) + 1).tolist(), len(log.t)]
    found = []
    for i, j in pairwise(edges):
        t = log.t[i:j] - log.t[i]
        if not log.commands[:, i].any() or t[-1] < HELD or np.diff(t).max() > OBEYED:
            continue
        moved = np.flatnonzero(np.any(np.diff(log.rates[:, i:j], axis=1) != 0.0, axis=0))
        if len(moved) and t[moved[0] + 1] < OBEYED:
            found.append(HeldCommand(i, i + int(np.searchsorted(t, USED))))
    return found


@dataclass(frozen=True)
class RateEvidence:
    """What says whether the wheel rates of a log were measured."""

    log: str
    """Name of the log."""
    commands: int
    """Number of commands that were held."""
    scatter: float
    """Median standard deviation of a wheel rate in the settled part of such a command [rad/s]; NaN without any."""
    step: float | None
    """Step of which all rates are multiples [rad/s]; None if there is none."""

    @property
    def rates_are(self) -> RatesAre:
        """Rates that never change while a command is held, or that only come in steps, are no measurements."""
        return "set points" if self.scatter < _NO_SCATTER or self.step is not None else "measured"

    def sentence(self) -> str:
        """Return the evidence in a sentence."""
        step = "" if self.step is None else f", and all rates are multiples of {self.step:.4f} rad/s"
        if not self.commands:
            return f"{self.log}: wheel rates look {_AS[self.rates_are]}: no command was held for {HELD:g} s{step}."
        says = "do not change at all" if self.scatter < _NO_SCATTER else f"scatter by {self.scatter:.3f} rad/s"
        return (
            f"{self.log}: wheel rates look {_AS[self.rates_are]}: from {_LATE:g} to {USED:g} s after {self.commands} "
            f"held commands they {says} (median standard deviation){step}."
        )


_AS = {"measured": "measured", "set points": "like the driver's set points"}


def rate_evidence(log: DriveLog) -> RateEvidence:
    """Return what a log says of its wheel rates."""
    held, scatter = held_commands(log), []
    for start, stop in held:
        late = log.t[start:stop] - log.t[start] > _LATE
        scatter.append(log.rates[:, start:stop][:, late].std(axis=1))
    return RateEvidence(log.name, len(held), float(np.median(scatter)) if scatter else math.nan, _step_of(log.rates))


def _step_of(rates: FloatArray) -> float | None:
    """Return the step of which all rates are multiples; None if there is none of a size worth mention."""
    sizes = np.unique(np.abs(rates).round(4))
    if len(sizes) < 3:
        return None
    apart = np.diff(sizes)
    apart = apart[apart > 0.5 * _FINEST_STEP]
    if not len(apart):
        return None
    step = float(np.median(apart[apart < 1.5 * apart.min()]))
    for _ in range(3):  # sharper with every whole number of steps
        whole = np.round(sizes / step)
        step = float((sizes @ whole) / (whole @ whole))
    off = np.abs(sizes / step - np.round(sizes / step))
    return step if step > _FINEST_STEP and np.mean(off < _OFF_STEP) > 0.99 else None


def sensor_of(log: DriveLog) -> Sensor:
    """Return what a log shows of its currents' sensor: the ripple of steady currents, and what it reads when idle."""
    assert log.currents is not None
    sizes = np.abs(log.currents)
    if log.signed:
        return Sensor(0.0, 0.0, signed=True)
    least = float(sizes[sizes > 0.0].min(initial=np.inf))
    idle = 0.5 * least if math.isfinite(least) and least < 0.1 * sizes.max() else 0.0
    inside = [log.currents[:, w] for w in steady_windows(log)]
    ripples = [c.std(axis=1)[c.mean(axis=1) > 5.0 * max(idle, 0.1)] for c in inside]
    known = np.concatenate(ripples) if ripples else np.empty(0)
    return Sensor(float(np.median(known)) if len(known) else 1.0, idle, signed=False)


@dataclass(frozen=True)
class SagEvidence:
    """What the sag of the battery's voltage follows: a sum of battery currents, or the power of motor currents."""

    by_currents: float
    """Share of the variance that the sum of the currents explains [1]."""
    by_power: float
    """Share of the variance that rates times currents and the currents' squares explain [1]."""
    rho: float
    """Resistance over voltage constant of the motors that the power asks for [rad/s per A]. It comes out too great where the
    sensor hides what braking motors feed back."""
    rho_error: float
    """Its standard error, from resampled blocks."""


def sag_evidence(log: DriveLog, rng: np.random.Generator, resamples: int) -> SagEvidence | None:
    """Return what the battery's voltage follows, by linear regression over seconds in which the wheels turn steadily.

    If currents are the motors', the battery gives sum(w I) K_e + sum(I^2) R, and its voltage sags by that over itself. If
    they are the battery's, it sags by their sum.

    Returns:
        The evidence; None for a log without voltages, or with too few such seconds.
    """
    if log.voltages is None or log.currents is None:
        return None
    seen = log.voltages.min(axis=0) > 0.6 * log.battery
    second = np.floor(log.t).astype(np.intp)
    change = np.abs(np.diff(log.rates, axis=1, prepend=log.rates[:, :1])).sum(axis=0)
    rows = []
    for s in np.unique(second[seen]):
        k = seen & (second == s)
        if change[k].sum() < 0.5:
            current, rate, voltage = log.currents[:, k], np.abs(log.rates[:, k]), log.voltages[:, k].mean()
            sums = current.sum(axis=0), (current * rate).sum(axis=0), (current**2).sum(axis=0)
            rows.append((voltage, log.t[k].mean(), *(x.mean() for x in sums)))
    if len(rows) < 20:
        return None
    voltage, t, total, power, heat = np.array(rows).T
    base, alone = np.stack([np.ones_like(t), t], axis=1), total[:, None]
    both = log.battery / voltage[:, None] * np.stack([power, heat], axis=1)

    def regress(more: FloatArray, which: NDArray[np.intp] | slice = slice(None)) -> tuple[FloatArray, float]:
        matrix = np.hstack([base, more])[which]
        slopes = np.linalg.lstsq(matrix, voltage[which])[0]
        return slopes[2:], float(np.var(voltage[which] - matrix @ slopes))

    left = regress(both[:, :0])[1]
    slopes, by_power = regress(both)
    drawn = [regress(both, which)[0] for which in _resampled_blocks(t, rng, resamples)]
    rho = [b[1] / b[0] for b in drawn if b[0] != 0.0]
    if not (left > 0.0 and slopes[0] != 0.0):
        return None
    return SagEvidence(
        1.0 - regress(alone)[1] / left,
        1.0 - by_power / left,
        float(slopes[1] / slopes[0]),
        float(np.std(rho)) if rho else 0.0,
    )


def _resampled_blocks(t: FloatArray, rng: np.random.Generator, resamples: int) -> Sequence[NDArray[np.intp]]:
    blocks = (t // BLOCK).astype(np.intp)
    members = [np.flatnonzero(blocks == b) for b in np.unique(blocks)]
    return [np.concatenate([members[k] for k in rng.integers(0, len(members), len(members))]) for _ in range(resamples)]
