"""Which rule a log's currents follow, and the numbers of that rule."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ssmr.types import FloatArray
from validation.study.drivetrain.evidence import SagEvidence, sag_evidence, sensor_of
from validation.study.drivetrain.friction import (
    CurrentKind,
    ReadingRule,
    Sensor,
    explained,
    fit_rule,
    fitting_rules,
    predicted_currents,
    steady_effort,
)
from validation.study.drivetrain.logs import Chassis, DriveLog, Resampling
from validation.study.drivetrain.samples import (
    CurrentSamples,
    joined_samples,
    refreshed_values,
    sample_kind,
    window_means,
    window_rows,
)

LEAST_SAMPLES = 10
"""Fewest currents that a rule is fitted to, or judged by."""
_TURNING = 0.3
"""Difference of the sides' wheel rates from which on a robot turns [rad/s]."""


class RuleScore(NamedTuple):
    """How much of the variance of the currents a rule explains."""

    rule: ReadingRule
    numbers: Mapping[str, float]
    """Its numbers, from what it was fitted to."""
    fitted: float
    """R^2 on what it was fitted to [1]."""
    held_out: float
    """R^2 on what was held out [1]."""
    rows: float
    """R^2 on what was held out, sample by sample [1]."""


class YawCheck(NamedTuple):
    """Yaw rate, which is not fitted, on what was held out."""

    gain: float
    """Measured over predicted yaw rate [1]."""
    rms: float
    """Root mean square of the difference [rad/s]."""
    n: int
    """Number of samples in which the robot turned."""


@dataclass(frozen=True, eq=False)
class CurrentFit:
    """What currents on the ground tell, under the rule that explains them best."""

    log: str
    """Name of the log."""
    sensor: Sensor
    scores: tuple[RuleScore, ...]
    """Every rule that was tried."""
    best: RuleScore
    """The rule that explains most of what was held out."""
    numbers: Mapping[str, float]
    """Its numbers, from the whole log."""
    errors: Mapping[str, float]
    """Their standard errors, from resampled blocks."""
    yaw: YawCheck | None
    """Yaw rate; None where none was measured."""
    sag: SagEvidence | None
    """What the battery's voltage says; None where it says nothing."""
    shown: tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
    """Measured and predicted currents [A], of what was fitted and of what was held out."""
    rows: tuple[CurrentSamples, FloatArray]
    """What was held out, sample by sample, and the currents predicted for it [A]."""
    counts: tuple[int, int]
    """Number of samples that were fitted, and held out."""
    windows: bool
    """True if samples are means of steady windows, false if they are single values of a slow sensor."""

    @property
    def kind(self) -> CurrentKind:
        """Whose currents they are."""
        return self.best.rule.kind


def require_currents(log: DriveLog) -> None:
    """Refuse a log without currents.

    Raises:
        ValueError: it has none, or they never change.
    """
    if log.currents is None:
        raise ValueError(f"{log.name} has no currents (current_left, current_right)")
    if not np.ptp(log.currents) > 0.0:
        raise ValueError(f"{log.name} has currents that never change")


def current_samples(log: DriveLog) -> CurrentSamples:
    """Return a log's currents in steady driving: means of windows, or the values of a slow sensor.

    Raises:
        ValueError: it has no currents.
    """
    require_currents(log)
    return (window_means(log) if sample_kind(log) == "windows" else refreshed_values(log)).moving()


def identify_friction(log: DriveLog, held_out: Sequence[DriveLog], chassis: Chassis, resampling: Resampling) -> CurrentFit:
    """Return friction, losses and slip scale from the currents of a log, and the rule that these follow.

    Args:
        log: the log to fit to.
        held_out: logs that judge the rules; if there are none, rules fitted to the log's first part are judged on its rest.
        chassis: the robot.
        resampling: the bootstrap over blocks.

    Raises:
        ValueError: a log has no currents, or too little steady driving.
    """
    whole, sensor, geometry = current_samples(log), sensor_of(log), chassis.geometry
    first, *others = (log, *held_out) if held_out else log.divided()
    fitted = whole if held_out else current_samples(first)
    judged = joined_samples([current_samples(x) for x in others])
    rows = joined_samples([window_rows(x) for x in others]).moving() if sample_kind(log) == "windows" else judged
    for name, samples in ((f"what is fitted of {log.name}", fitted), ("what is held out", judged)):
        if len(samples) < LEAST_SAMPLES:
            raise ValueError(f"{name} has {len(samples)} currents in steady driving, wanted {LEAST_SAMPLES} or more")
        if not np.ptp(samples.current) > 0.0:
            raise ValueError(f"{name} has currents that never change")

    def score(rule: ReadingRule) -> RuleScore:
        numbers = fit_rule(rule, fitted, sensor, geometry)
        resampling.tick()
        shares = [
            explained(predicted_currents(rule, numbers, s, sensor, geometry), s.current) for s in (fitted, judged, rows)
        ]
        return RuleScore(rule, numbers, *shares)

    scores = [score(rule) for rule in fitting_rules(sensor)]
    best = max(scores, key=lambda s: s.held_out)
    numbers = best.numbers if held_out else fit_rule(best.rule, whole, sensor, geometry, best.numbers)
    drawn = []
    for _ in range(resampling.draws):
        drawn.append(fit_rule(best.rule, whole.resampled(resampling.rng), sensor, geometry, numbers))
        resampling.tick()
    errors = {name: float(np.std([d[name] for d in drawn])) for name in numbers}
    shown = [(s.current, predicted_currents(best.rule, best.numbers, s, sensor, geometry)) for s in (fitted, judged)]
    sampled = rows, predicted_currents(best.rule, best.numbers, rows, sensor, geometry)
    yaw = _yaw_check(judged, chassis, best.numbers)
    sag = sag_evidence(log, resampling.rng, resampling.draws)
    counts = len(fitted), len(judged)
    windows = sample_kind(log) == "windows"
    return CurrentFit(
        log.name, sensor, tuple(scores), best, numbers, errors, yaw, sag, (shown[0], shown[1]), sampled, counts, windows
    )


def _yaw_check(samples: CurrentSamples, chassis: Chassis, numbers: Mapping[str, float]) -> YawCheck | None:
    known = np.isfinite(samples.yaw_rate) & (np.abs(samples.rates[1] - samples.rates[0]) > _TURNING)
    if "slip_scale" not in numbers or not known.any():
        return None
    _, predicted = steady_effort(samples.take(known), chassis.geometry, numbers["slip_scale"])
    measured = samples.yaw_rate[known]
    gain = float(measured @ predicted / (predicted @ predicted))
    return YawCheck(gain, float(np.sqrt(np.mean((predicted - measured) ** 2))), int(known.sum()))
