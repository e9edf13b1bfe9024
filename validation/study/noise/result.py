"""The result of a study of noise: its tables, its picture and its files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ssmr.parameters import MOST_SEED, require_within
from ssmr.types import FloatArray
from validation.plants.profile import Profile
from validation.report.tables import NOTHING, Cell, Grid
from validation.simulator.description import Robot
from validation.study.noise.filtering import ATTENUATION, PASSBAND, HighPass, NoiseEstimate
from validation.study.result import StudyResult

TILTED = 2.0
"""Noise is called coloured where one half of its band has more than this many times the density of the other [1]."""
LONG_TAILS = 2.0
"""Noise has long tails where its variance is more than this many times that by the median [1]."""


@dataclass(frozen=True)
class NoiseOptions:
    """Options of the study of noise."""

    recording: str | None = None
    """Log: a recording (.csv, .bag, .mcap, the folder of a ROS 2 bag), or a drive to be simulated and logged, such as
    traj4@mujoco."""
    passband: float | None = None
    """Begin of the filter's passband [Hz]; by default 10 Hz, and a quarter of the sample rate where a signal is too slow."""
    start: float | None = None
    """Leave out what was logged before this time [s]."""
    until: float | None = None
    """Leave out what was logged after this time [s]."""
    profile: str | Profile | None = None
    """Profile of the robot of a simulated drive: its name or its path."""
    robot: str | Robot | None = None
    """Robot of a simulated drive: its name or the path of its file; the profile's if none is named."""
    seed: int = 0
    """Seed of a simulated drive's noise."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            ValueError: a passband that is not positive, a negative seed, or times that are no numbers.
        """
        require_within(self, ("passband",), 1e-6, 1e6)
        require_within(self, ("start", "until"), -1e12, 1e12)
        require_within(self, ("seed",), 0, MOST_SEED, whole=True)


@dataclass(frozen=True, eq=False)
class NoisySignal:
    """The noise of one column of a log."""

    name: str
    """Name of the column."""
    unit: str
    """Unit of the column; empty where it is not known."""
    filter: HighPass
    """Filter that it went through, at its own rate."""
    estimate: NoiseEstimate
    """What was left."""
    tilt: float
    """Density in the lower half of the passband over that in the upper half [1]; 1 for white noise."""
    spectrum: tuple[FloatArray, FloatArray]
    """(F,) frequencies [Hz] and (F,) density of the whole signal [unit²/Hz]."""
    shown: tuple[FloatArray, FloatArray, FloatArray]
    """(S,) times [s], values and noise of a short stretch, for the picture."""

    @property
    def label(self) -> str:
        """Name with its unit."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @property
    def std(self) -> float:
        """Standard deviation of white noise that would leave as much [unit]."""
        return math.sqrt(self.estimate.white)

    @property
    def remarks(self) -> tuple[str, ...]:
        """In words, what speaks against white noise."""
        found = []
        if not 1.0 / TILTED <= self.tilt <= TILTED:
            found.append("coloured")
        if self.estimate.white > LONG_TAILS * self.estimate.robust:
            found.append("long tails")
        return tuple(found)


@dataclass(frozen=True, eq=False, kw_only=True)
class NoiseStudy(StudyResult):
    """The noise of a log's signals."""

    study = "noise"
    title = "Noise of a log"
    log: str
    """Name of the log."""
    options: NoiseOptions
    """Options of the study."""
    signals: tuple[NoisySignal, ...]
    """Signals, in the order of the log."""
    left_out: Mapping[str, str] = field(default_factory=dict)
    """Why other columns have no estimate, by name."""

    def heading(self) -> str:
        """Return what was studied, in one line."""
        o = self.options
        span = "".join(f" {word} {at:g} s" for word, at in (("from", o.start), ("until", o.until)) if at is not None)
        return f"{self.log}{span}"

    def signal(self, name: str) -> NoisySignal:
        """Return the signal of a column.

        Raises:
            ValueError: it has no estimate; the message says why.
        """
        for found in self.signals:
            if found.name == name:
                return found
        raise ValueError(f"{self.log} has no noise of {name}: {self.left_out.get(name, 'there is no such column')}")

    def grids(self) -> list[Grid]:
        """Return one row for each signal."""
        header = (
            *(("signal", ""), ("rate", "Hz"), ("passband", "Hz"), ("variance", ""), ("kept", "%"), ("if white", "")),
            *(("±", "%"), ("std", ""), ("low/high", ""), ("remarks", "")),
        )
        rows = []
        for s in self.signals:
            e = s.estimate
            error = f"{100.0 * e.error / e.white:.1f}" if e.white > 0.0 else NOTHING
            texts = (
                *(s.label, f"{s.filter.rate:.4g}", f"{s.filter.passband:.3g}", f"{e.variance:.3g}"),
                *(f"{100.0 * s.filter.kept:.0f}", f"{e.white:.3g}", error, f"{s.std:.2g}"),
                *(f"{s.tilt:.2f}" if math.isfinite(s.tilt) else NOTHING, ", ".join(s.remarks)),
            )
            rows.append(tuple(map(Cell, texts)))
        caption = (
            "variance: of what passes, as the thesis takes it (Sec. 3.4.4), in the square of the signal's unit; kept: the "
            "share of white noise that passes; if white: the variance with the lost share put back, its standard error, and "
            "its root; low/high: density in the lower half of the passband over that in the upper half"
        )
        return [Grid(header, (tuple(rows),), 1, f"Noise, {self.heading()}", caption, trailing=1)]

    def notes(self) -> list[str]:
        """Return sentences on what the numbers cannot tell."""
        out = []
        slow = [s.name for s in self.signals if self.options.passband is None and s.filter.passband < PASSBAND]
        if slow:
            out.append(
                f"The passband of {', '.join(slow)} begins at a quarter of the sample rate: these samples are too slow for "
                f"the thesis' {PASSBAND:g} Hz. The lower the passband begins, the more motion counts as noise."
            )
        if any(s.remarks for s in self.signals):
            out.append(
                "Noise that is coloured (low/high far from 1) or has long tails (some samples stand far out) is not white "
                "and Gaussian: its variance depends on the filter, and jolts and the stamps' jitter are in it."
            )
        out += [f"{name} has no estimate: {why}." for name, why in self.left_out.items()]
        return out

    def findings(self) -> dict[str, Any]:
        """Return filter, signals and what was left out."""
        o = self.options
        return {
            "log": self.log,
            "filter": {"attenuation_db": ATTENUATION, "passband_hz": o.passband, "from_s": o.start, "until_s": o.until},
            "seed": o.seed,
            "signals": {
                s.name: {
                    "unit": s.unit,
                    "rate_hz": s.filter.rate,
                    "passband_hz": s.filter.passband,
                    "samples": s.estimate.samples,
                    "variance": s.estimate.variance,
                    "kept_share": s.filter.kept,
                    "white_variance": s.estimate.white,
                    "white_standard_error": s.estimate.error,
                    "robust_variance": s.estimate.robust,
                    "low_over_high_density": s.tilt,
                }
                for s in self.signals
            },
            "left_out": dict(self.left_out),
        }
