"""The result of a study of a drive train: its numbers, the evidence for them, and what stays unknown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple, TypeAlias, TypeVar

from ssmr.parameters import MOST_SEED, require_within
from validation.files.log import Log
from validation.plants.profile import Profile
from validation.report.tables import Cell, Grid
from validation.simulator.description import Robot
from validation.study.drivetrain.evidence import RateEvidence
from validation.study.drivetrain.friction import CurrentKind
from validation.study.drivetrain.inertia import InertiaFit
from validation.study.drivetrain.logs import FIT_SHARE, Chassis
from validation.study.drivetrain.obedience import RateFit
from validation.study.drivetrain.selection import CurrentFit
from validation.study.options import MOST_RUNS
from validation.study.result import StudyResult

Found: TypeAlias = RateFit | CurrentFit | InertiaFit
_Part = TypeVar("_Part", RateFit, CurrentFit, InertiaFit)
_GRAVITY = 9.81


@dataclass(frozen=True)
class DriveTrainOptions:
    """Options of the study of a drive train."""

    recording: str | Log | None = None
    """Path of a recording with commands and wheel rates, the robot standing with its wheels in the air; with currents, it
    tells the inertia too."""
    ground: str | Log | None = None
    """Path of a recording on the ground with wheel rates and currents (current_left, current_right)."""
    held_out: tuple[str | Log, ...] = ()
    """Paths of recordings that only judge: those with a heading or a gyro the currents, others the wheel rates. Without
    any, the last third of each log judges what is fitted to the rest."""
    robot: str | Robot | None = None
    """Robot whose nominal geometry and mass are taken: its name or the path of its file. If neither it nor a profile is
    named, the voltage of the battery tells a Warthog from a Husky."""
    torque_constant: float | None = None
    """Torque of one side's wheels per ampere of its motor [N m/A], where it is known."""
    resamples: int = 60
    """Number of fits to resampled data, from which standard errors are taken."""
    seed: int = 0
    """Seed of the resampling."""
    profile: str | Profile | None = None
    """Profile of the robot, which knows its mass and how large its tyres roll: a name, or the path of a TOML file. If none
    is named, it is husky-tile for a Husky, and the numbers of its file for another robot."""
    mass: float | None = None
    """Total mass with payload, where it is not the profile's [kg]."""

    def __post_init__(self) -> None:
        """Raise a ValueError for numbers out of range."""
        require_within(self, ("torque_constant", "mass"), 1e-6, 1e6)
        require_within(self, ("resamples",), 2, MOST_RUNS, whole=True)
        require_within(self, ("seed",), 0, MOST_SEED, whole=True)


class Estimate(NamedTuple):
    """An estimated number."""

    value: float
    unit: str
    standard_error: float
    meaning: str
    """What it is, in a few words."""

    def text(self) -> str:
        """Return value and standard error with two digits of the latter."""
        digits = 3
        if self.standard_error > 0.0:
            digits = min(max(1 - math.floor(math.log10(self.standard_error)), 0), 6)
        return f"{self.value:.{digits}f} ± {self.standard_error:.{digits}f}"


@dataclass(frozen=True, eq=False)
class DriveTrainStudy(StudyResult):
    """A drive train as the logs tell it."""

    study = "drivetrain"
    title = "The drive train"
    options: DriveTrainOptions
    """Options of the study."""
    chassis: Chassis
    """Nominal numbers of the robot."""
    evidence: tuple[RateEvidence, ...]
    """What each log says of its wheel rates."""
    parts: tuple[Found, ...]
    """What was found: driver, friction, inertia, as far as the logs tell them."""
    guess: str = ""
    """Sentence that says why the logs are taken for those of this robot; empty where it was named."""

    @property
    def driver(self) -> RateFit | None:
        """What the driver makes of commands."""
        return self._part(RateFit)

    @property
    def friction(self) -> CurrentFit | None:
        """What the currents on the ground tell."""
        return self._part(CurrentFit)

    @property
    def inertia(self) -> InertiaFit | None:
        """What the transients of wheels in the air tell."""
        return self._part(InertiaFit)

    def _part(self, kind: type[_Part]) -> _Part | None:
        return next((part for part in self.parts if isinstance(part, kind)), None)

    def parameters(self) -> dict[str, Estimate]:
        """Return every number that was found, by name."""
        found: dict[str, Estimate] = {}
        if self.friction is not None:
            found |= self._friction_numbers(self.friction)
        if self.inertia is not None:
            i, k = self.inertia, self.options.torque_constant
            found["inertia_current"] = Estimate(
                i.value, "A s²/rad", i.standard_error, "inertia of a side over torque constant"
            )
            if k is not None:
                found["rotor_inertia"] = Estimate(
                    k * i.value, "kg m²", k * i.standard_error, "inertia of a side at its wheels"
                )
        if self.driver is not None:
            units = ("s", "1", "m", "rad/s", "m/s²", "rad/s²", "s")
            law, errors = self.driver.law, self.driver.errors
            for name, value, error, unit in zip(law._fields, law, errors, units, strict=True):
                if name == "yaw_rate_limit" and not self.driver.limit_reached:
                    continue
                found[f"driver_{name}"] = Estimate(value, unit, error, _DRIVER[name])
        return found

    def _friction_numbers(self, fit: CurrentFit) -> dict[str, Estimate]:
        """Return what currents tell: currents where they are the motors', torques where they are the battery's."""
        x, e, k = fit.numbers, fit.errors, self.options.torque_constant
        found, scale = {}, 1.0 if fit.kind == "motor" else None if k is None else 1.0 / k
        torque = 1.0 if fit.kind == "battery" else k
        if scale is not None:
            for name, key in (("friction_current", "friction"), ("loss_left", "loss_left"), ("loss_right", "loss_right")):
                found[name] = Estimate(scale * x[key], "A", scale * e[key], f"{_CURRENTS[key]} over torque constant")
        if "slip_scale" in x:
            found["slip_scale"] = Estimate(x["slip_scale"], "1", e["slip_scale"], "slip at which 63 % of the friction acts")
        if torque is not None:
            friction, error = torque * x["friction"], torque * e["friction"]
            found["friction_torque"] = Estimate(friction, "N m", error, _CURRENTS["friction"])
            for side in ("left", "right"):
                loss, error_of_loss = torque * x[f"loss_{side}"], torque * e[f"loss_{side}"]
                found[f"loss_torque_{side}"] = Estimate(loss, "N m", error_of_loss, _CURRENTS[f"loss_{side}"])
            lever = 0.5 * self.chassis.mass * _GRAVITY * self.chassis.geometry.radius
            words = f"friction coefficient with {self.chassis.mass:g} kg"
            found["friction"] = Estimate(friction / lever, "1", error / lever, words)
        for name, unit, words in _MORE:
            if name in x:
                found[name] = Estimate(x[name], unit, e[name], words)
        return found

    def heading(self) -> str:
        """Return the robot and the logs, in one line."""
        names = [fit.log for fit in (self.driver, self.friction) if fit is not None]
        return f"{self.chassis.name}: {', '.join(dict.fromkeys(names))}"

    def grids(self) -> list[Grid]:
        """Return the tables of numbers, of wheel rates and of rules for currents."""
        numbers = [(Cell(name), Cell(e.text()), Cell(e.unit), Cell(e.meaning)) for name, e in self.parameters().items()]
        header = (("number", ""), ("value", ""), ("unit", ""), ("meaning", ""))
        made = [Grid(header, (tuple(numbers),), 1, f"Numbers, {self.heading()}", _CAPTION, trailing=2)]
        if self.driver is not None:
            rows = [
                (Cell(s.name), Cell("held out" if s.held_out else ""), Cell(f"{s.commands}"), Cell(f"{s.rms:.3f}"),
                 Cell(f"{s.own_time_rms:.3f}"))
                for s in self.driver.scores
            ]  # fmt: skip
            names = (("log", ""), ("", ""), ("commands", ""), ("rms", "rad/s"), ("own times", "rad/s"))
            caption = "own times: what is left if every command has a dead time of its own."
            made.append(Grid(names, (tuple(rows),), 2, "Wheel rates from commands", caption))
        if self.friction is not None:
            best = self.friction.best
            scores = [
                (Cell(s.rule.name), *(Cell(f"{x:.2f}", best=s is best) for x in (s.fitted, s.held_out, s.rows)))
                for s in self.friction.scores
            ]
            columns = (("whose currents they may be", ""), ("fitted", "1"), ("held out", "1"), ("samples", "1"))
            caption = "Share of the variance of the currents that is explained; samples: held out, not averaged."
            made.append(Grid(columns, (tuple(scores),), 1, "What the currents show", caption))
        return made

    def notes(self) -> list[str]:
        """Return the evidence, and what stays unknown."""
        guess = [self.guess] if self.guess else []
        return [*guess, *(e.sentence() for e in self.evidence), *self._current_evidence(), *self.unknown()]

    def _current_evidence(self) -> list[str]:
        says = []
        f, i = self.friction, self.inertia
        if f is not None:
            other = max((s.held_out for s in f.scores if s.rule.kind != f.kind), default=math.nan)
            whose, sign = _WHOSE[f.kind], "some are negative" if f.sensor.signed else "none is negative"
            says.append(
                f"{f.log}: currents are the {f.kind}'s ({whose}; {sign}): as such {f.best.held_out:.2f} of their variance "
                f"is explained on what was held out, and as the {'battery' if f.kind == 'motor' else 'motor'}'s {other:.2f}."
            )
            if f.sag is not None:
                says.append(
                    f"The battery's voltage sags with the currents' sum (R² {f.sag.by_currents:.2f}) or with rates times "
                    f"currents and their squares (R² {f.sag.by_power:.2f})."
                )
            if f.yaw is not None:
                says.append(
                    f"The yaw rate, which is not fitted, is {f.yaw.gain:.3f} times the predicted one in {f.yaw.n} samples "
                    f"held out, {f.yaw.rms:.3f} rad/s rms off."
                )
        if i is not None:
            ways = [(i.speed_ups, "speed-ups"), (i.reversals, "reversals")]
            found = [f"{e[0]:.2f} ± {e[1]:.2f} from {words}" for e, words in ways if e is not None]
            says.append(
                f"Inertia over torque constant: {' and '.join(found)} A s²/rad; their difference counts as uncertainty."
            )
        return says

    def unknown(self) -> list[str]:
        """Return sentences on what the logs cannot tell."""
        f, k = self.friction, self.options.torque_constant
        says = []
        if f is not None and f.kind == "motor" and k is None:
            says.append(
                "Unknown: the torque constant. Currents tell torques only over it, so that friction torque, friction "
                "coefficient and inertia stay unknown until torque_constant is given."
            )
        if f is not None and f.kind == "battery":
            says.append(
                "Power fixes the torques' scale. Unknown: the torque constant, and the friction coefficient as far as the "
                f"mass is not {self.chassis.mass:g} kg. Torques are those at the wheels if the battery's meter is right."
            )
        if self.inertia is None:
            says.append(
                "Unknown: the inertia of the rotors; that takes a log with wheels in the air and the motors' currents."
            )
        return says

    def findings(self) -> dict[str, Any]:
        """Return what study.json holds besides its schema, the study's name and the versions."""
        d, f, i = self.driver, self.friction, self.inertia
        source = d.log if d is not None else f.log if f is not None else None
        rates = next((e.rates_are for e in self.evidence if e.log == source), None)
        current_is: CurrentKind | None = None if f is None else f.kind
        return {
            "wheel_rate_rms_rad_s": None if d is None else d.rms,
            "current_r2": None if f is None else f.best.held_out,
            "current_r2_samples": None if f is None else f.best.rows,
            "current_is": current_is,
            "wheel_rates_are": rates,
            "parameters": {
                name: {"value": e.value, "unit": e.unit, "standard_error": e.standard_error, "meaning": e.meaning}
                for name, e in self.parameters().items()
            },
            "yaw_rate": None if f is None or f.yaw is None else {"gain": f.yaw.gain, "rms_rad_s": f.yaw.rms, "n": f.yaw.n},
            "inertia": None if i is None else {"speed_ups": i.speed_ups, "reversals": i.reversals, "n": len(i.transients)},
            "evidence": {
                "wheel_rates": [{**asdict(e), "rates_are": e.rates_are} for e in self.evidence],
                "commands": [] if d is None else [s._asdict() for s in d.scores],
                "currents": [] if f is None else [
                    {"rule": s.rule.name, "kind": s.rule.kind, "r2_fitted": s.fitted, "r2": s.held_out, "r2_samples": s.rows,
                     "numbers": dict(s.numbers)}
                    for s in f.scores
                ],
                "samples": None if f is None else {
                    "fitted": f.counts[0], "held_out": f.counts[1], "kind": "windows" if f.windows else "values",
                    **f.sensor._asdict(),
                },
                "battery_sag": None if f is None or f.sag is None else asdict(f.sag),
            },
            "unknown": self.unknown(),
            "robot": {**asdict(self.chassis), "geometry": self.chassis.geometry._asdict()},
            "held_out_share": 0.0 if self.options.held_out else 1.0 - FIT_SHARE,
            "logs": [e.log for e in self.evidence],
            "torque_constant_N_m_A": self.options.torque_constant,
            "resamples": self.options.resamples,
            "seed": self.options.seed,
        }  # fmt: skip


_CAPTION = "From the whole of each log; with standard errors."
_CURRENTS = {"friction": "friction torque of a side", "loss_left": "losses, left", "loss_right": "losses, right"}
_WHOSE = {"motor": "shown while the bridge drives", "battery": "power over voltage"}
_MORE: Sequence[tuple[str, str, str]] = (
    ("rho", "rad/s per A", "motors' resistance over voltage constant"),
    ("heat", "W/(N m)²", "motors' resistance over torque constant squared"),
    ("efficiency", "1", "share of the power that passes the gear, either way"),
)
_DRIVER = {
    "dead_time": "from a command to the driver's set point",
    "gain": "rim speed over commanded speed",
    "half_track": "half-track with which the driver turns yaw rates into rim speeds",
    "yaw_rate_limit": "greatest yaw rate that is obeyed",
    "acceleration": "greatest change of the commanded speed",
    "yaw_acceleration": "greatest change of the commanded yaw rate",
    "lag": "time constant of the rims",
}
