"""Friction, losses and slip stiffness from the currents of steady driving, under several rules of what a current shows.

The wheels turn steadily, the robot does not accelerate, and so its motion and the share of the friction that each side
overcomes follow from the wheel rates alone (`ssmr.robot.drivetrain`). The torque of a side over the torque constant is then

    I = A F + loss sgn(w),    A = mu N r / K,

with F the side's force over its friction limit. What a log shows of I depends on where the current is measured; power, which
a battery's current measures, knows no torque constant, and then the same numbers are torques.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from ssmr.robot.drivetrain import SkidGeometry, battery_current, bridge_reading, quasi_static_twist, side_forces
from ssmr.types import FloatArray
from validation.study.drivetrain.samples import CurrentSamples

CurrentKind = Literal["motor", "battery"]
COULOMB_SCALE = 1e-4
"""Slip scale of a contact that is a Coulomb one as far as any current shows [1]."""
_ROBUST = 0.3
"""Residuals beyond this share of the currents' standard deviation count less than their square."""


class Sensor(NamedTuple):
    """What a log shows of its sensor without a fit."""

    ripple: float
    """Standard deviation of a steady current about its mean [A]."""
    idle: float
    """Mean reading of a bridge that does not drive [A]."""
    signed: bool
    """True if readings can be negative."""


class FittedNumber(NamedTuple):
    """A number of a rule: where its fit begins, and its bounds."""

    start: float
    low: float
    high: float
    scaled: bool = False
    """True if the three are in units of the currents' or torques' scale."""


Reading = Callable[[FloatArray, CurrentSamples, Mapping[str, float], Sensor], FloatArray]
"""Function of (n,) motor currents [A] or torques [N m], samples, numbers and sensor that returns (n,) readings [A]."""


@dataclass(frozen=True)
class ReadingRule:
    """An assumption about the tyres, and about what a log shows of the motors' currents."""

    name: str
    """Name in tables."""
    kind: CurrentKind
    """Whose current it is."""
    numbers: Mapping[str, FittedNumber]
    """What is fitted, by name."""
    read: Reading
    """What the sensor makes of the motors' currents or torques."""


def _plain(current: FloatArray, s: CurrentSamples, x: Mapping[str, float], sensor: Sensor) -> FloatArray:
    forward: FloatArray = current * np.sign(s.rate)
    return forward if sensor.signed else np.abs(forward)


def _bridge(current: FloatArray, s: CurrentSamples, x: Mapping[str, float], sensor: Sensor) -> FloatArray:
    return bridge_reading(current, s.rate, x["rho"], sensor.ripple, sensor.idle)


def _battery(torque: FloatArray, s: CurrentSamples, x: Mapping[str, float], sensor: Sensor) -> FloatArray:
    drawn = battery_current(torque, s.rate, s.voltage, x["heat"], x["efficiency"])
    return drawn if sensor.signed else np.maximum(drawn, 0.0)


_SIDES = {
    "friction": FittedNumber(1.0, 0.02, 10.0, scaled=True),
    "loss_left": FittedNumber(0.1, -1.0, 2.0, scaled=True),
    "loss_right": FittedNumber(0.1, -1.0, 2.0, scaled=True),
}
_SLIP = {"slip_scale": FittedNumber(0.09, 0.01, 0.8)}
_POWER = {"heat": FittedNumber(0.003, 0.0, 0.1), "efficiency": FittedNumber(0.9, 0.4, 1.0)}


def _rule(name: str, kind: CurrentKind, read: Reading, **more: FittedNumber) -> ReadingRule:
    return ReadingRule(name, kind, MappingProxyType({**_SIDES, **more}), read)


READING_RULES = (
    _rule("the motors', Coulomb contacts", "motor", _plain),
    _rule("the motors', contacts that give way", "motor", _plain, **_SLIP),
    _rule("the motors', shown while the bridge drives", "motor", _bridge, **_SLIP, rho=FittedNumber(0.145, 0.03, 0.5)),
    _rule("the battery's", "battery", _battery, **_SLIP, **_POWER),
)
"""Every rule that a log is tried against. The third is for sensors without a sign."""


def fitting_rules(sensor: Sensor) -> tuple[ReadingRule, ...]:
    """Return the rules that a sensor can follow."""
    return tuple(rule for rule in READING_RULES if not (sensor.signed and "rho" in rule.numbers))


def steady_effort(samples: CurrentSamples, geometry: SkidGeometry, slip_scale: float) -> tuple[FloatArray, FloatArray]:
    """Return (n,) the force of each sample's side over its friction limit [1], and (n,) the yaw rate [rad/s]."""
    unique, inverse = np.unique(samples.rates.round(4), axis=1, return_inverse=True)
    inverse = inverse.ravel()
    twist = quasi_static_twist(unique, geometry, slip_scale)
    forces = side_forces(unique, twist, geometry, slip_scale)[:, inverse]
    return forces[samples.side, np.arange(len(samples))], twist[2][inverse]


def predicted_currents(
    rule: ReadingRule, numbers: Mapping[str, float], samples: CurrentSamples, sensor: Sensor, geometry: SkidGeometry
) -> FloatArray:
    """Return (n,) readings that a rule predicts [A]."""
    effort, _ = steady_effort(samples, geometry, numbers.get("slip_scale", COULOMB_SCALE))
    loss = np.where(samples.side == 0, numbers["loss_left"], numbers["loss_right"])
    return rule.read(numbers["friction"] * effort + loss * np.sign(samples.rate), samples, numbers, sensor)


def fit_rule(
    rule: ReadingRule,
    samples: CurrentSamples,
    sensor: Sensor,
    geometry: SkidGeometry,
    start: Mapping[str, float] | None = None,
) -> dict[str, float]:
    """Return the numbers of a rule that predict the samples best: least squares, in which outliers count less.

    Args:
        rule: the assumption.
        samples: currents of steady driving.
        sensor: what is known of the sensor.
        geometry: the robot.
        start: numbers to begin with; those of the rule if not given.
    """
    unit = float(np.percentile(np.abs(samples.current), 90))
    if rule.kind == "battery":
        unit *= float(np.median(samples.voltage) / np.percentile(np.abs(samples.rate), 75))
    scales = {name: unit if n.scaled else 1.0 for name, n in rule.numbers.items()}
    begin, low, high = (
        np.array([getattr(n, field) * scales[name] for name, n in rule.numbers.items()])
        for field in ("start", "low", "high")
    )
    if start is not None:
        begin = np.clip([start[name] for name in rule.numbers], low, high)

    def residuals(x: FloatArray) -> FloatArray:
        named = dict(zip(rule.numbers, x.tolist(), strict=True))
        return predicted_currents(rule, named, samples, sensor, geometry) - samples.current

    typical = np.array([n.start * scales[name] for name, n in rule.numbers.items()])
    found = least_squares(
        residuals, begin, bounds=(low, high), x_scale=typical, loss="soft_l1", diff_step=1e-3, max_nfev=40,
        f_scale=_ROBUST * max(float(np.std(samples.current)), 1e-6),
    )  # fmt: skip
    return dict(zip(rule.numbers, found.x.tolist(), strict=True))


def explained(predicted: FloatArray, measured: FloatArray) -> float:
    """Return R^2: one less the mean square error over the variance of what was measured."""
    return float(1.0 - np.mean((predicted - measured) ** 2) / np.var(measured))
