"""Planar models solved with a variable step that locates every change of a friction's sign, as block diagrams do (Sec. 3.6).

The compiled loops of this project step every model alike, so their times do not show what a model's friction costs a solver
that stops wherever friction jumps. Here scipy's `solve_ivp` integrates the same equations with events. Coulomb friction has
a jump for the treads of either side and for the yaw rate, and chatters at rest; the improved friction sticks instead; the
linear friction has none.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from ssmr.models.coulomb import accelerations
from ssmr.models.improved import active
from ssmr.models.linear import coefficients
from ssmr.robot.drive import Wanted, motor_torques, side_rates, thrusts
from ssmr.scenarios import SineScenario
from ssmr.simulation import PLANAR_DT, PlanarModel
from ssmr.types import FloatArray
from validation.plants.profile import load_profile
from validation.report.tables import Cell, Grid

PROFILE = "thesis-printed"
"""The printed parameters, with nothing fitted."""
SOLVER_TOLERANCE = 1e-3
"""Relative tolerance of the solver: the default of Simulink's ode45."""
_Event = Callable[[float, FloatArray], float]


class Effort(NamedTuple):
    """What a solution took."""

    evaluations: int
    """Number of evaluations of the right-hand side."""
    located: int
    """Number of changes of sign that were located."""
    cpu_s: float
    """Processor time [s]."""
    end: FloatArray
    """(2,) speed [m/s] and yaw rate [rad/s] at the end."""


@dataclass
class _Planar:
    """The robot's numbers and the wanted wheel rates, which all models share.

    A model's equations change where one of its event functions crosses zero; `begin` then chooses the mode to go on with.
    """

    model: PlanarModel
    scenario: SineScenario
    robot: Any = field(init=False)

    def __post_init__(self) -> None:
        self.robot = self.model.packed(PLANAR_DT)

    def wanted(self, t: float) -> Wanted:
        """Return the wanted wheel rates at a time [s]: the scenario's command as a smooth function, delayed."""
        d, s = self.model.drive, self.scenario
        on = t - d.delay_v
        v = s.speed if on >= 0.0 else 0.0
        since = t - d.delay_w - s.lead_in
        w = s.amplitude * math.sin(2.0 * math.pi * s.frequency * since) if since >= 0.0 else 0.0
        c, r = d.command_half_track, d.command_radius
        return Wanted((v - c * w) / r, (v + c * w) / r, 0.0, 0.0)

    def begin(self, t: float, y: FloatArray) -> None:
        """Keep the mode."""

    def cross(self, t: float, y: FloatArray, k: int) -> FloatArray:
        """Keep the velocities."""
        return y

    def events(self) -> list[_Event]:
        """Return none."""
        return []


class _Linear(_Planar):
    """Viscous friction: no events."""

    def rates(self, t: float, y: FloatArray) -> Sequence[float]:
        """Return the accelerations of Eq. 2.44."""
        robot, p = self.robot, coefficients(self.robot.vehicle, self.robot.parameters)
        sides = side_rates(y[0], y[1], robot.vehicle)
        torque = motor_torques(self.wanted(t), sides, robot.parameters.gain * robot.vehicle.wheel_radius, robot.motor)
        thrust = thrusts(torque, sides, robot.vehicle, robot.motor)
        mass, inertia = robot.vehicle.moved, robot.vehicle.turned
        turning = robot.vehicle.half_track * (thrust.right - thrust.left) / inertia
        return (thrust.left + thrust.right) / mass - p.friction * y[0], turning - p.friction_yaw * y[1]


class _Coulomb(_Planar):
    """Friction by the signs of the speed of either side's treads and of the yaw rate, which hold until one crosses zero."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.signs = [1.0, 1.0, 1.0]

    def _speeds(self, y: FloatArray) -> tuple[float, float, float]:
        c = self.robot.vehicle.half_track
        return y[0] - c * y[1], y[0] + c * y[1], y[1]

    def rates(self, t: float, y: FloatArray) -> Sequence[float]:
        """Return the accelerations of Eq. 2.27 with a = b and x_ICR = 0."""
        vehicle, p, (left, right, lateral) = self.robot.vehicle, self.robot.parameters, self.signs
        rolling = 0.5 * p.u_x * vehicle.mass * vehicle.gravity
        moment = p.mu_c * vehicle.mass * vehicle.gravity * vehicle.a * lateral + vehicle.half_track * rolling * (
            right - left
        )
        return accelerations(y[0], y[1], self.wanted(t), (rolling * (left + right), moment), self.robot)[:2]

    def events(self) -> list[_Event]:
        """Return the three speeds."""

        def speed(k: int) -> _Event:
            return lambda t, y: self._speeds(y)[k]

        return [speed(k) for k in range(3)]

    def begin(self, t: float, y: FloatArray) -> None:
        """Take the signs of the speeds; one at zero keeps its sign."""
        self.signs = [
            math.copysign(1.0, v) if abs(v) > 1e-12 else s for v, s in zip(self._speeds(y), self.signs, strict=True)
        ]

    def cross(self, t: float, y: FloatArray, k: int) -> FloatArray:
        """Turn a sign."""
        self.signs[k] = -self.signs[k]
        return y


class _Improved(_Planar):
    """Friction that sticks, breaks away and slides (Eq. 2.29-2.31), separately for speed and yaw rate."""

    def __post_init__(self) -> None:
        super().__post_init__()
        v, p = self.robot.vehicle, self.robot.parameters
        weight = v.mass * v.gravity
        self.signs = [0.0, 0.0]
        """Direction of sliding; 0 while it sticks."""
        lever = 2.0 * v.a * v.b / (v.a + v.b)
        self.holding, self.sliding = (p.u_x * weight, p.mu_s * weight * lever), (p.u_x * weight, p.mu_d * weight * lever)

    def _active(self, t: float, y: FloatArray) -> tuple[float, float]:
        return active(y[0], y[1], self.wanted(t), self.robot)[:2]

    def rates(self, t: float, y: FloatArray) -> Sequence[float]:
        """Return the accelerations; zero for what sticks."""
        inertia = self.robot.vehicle.moved, self.robot.vehicle.turned
        both = zip(self._active(t, y), self.signs, self.sliding, inertia, strict=True)
        return [(push - sign * friction) / m if sign else 0.0 for push, sign, friction, m in both]

    def events(self) -> list[_Event]:
        """Return the velocity of what slides, and for what sticks by how much the push exceeds its hold."""

        def end_of(k: int) -> _Event:
            if self.signs[k]:
                return lambda t, y: float(y[k])
            return lambda t, y: abs(self._active(t, y)[k]) - self.holding[k]

        return [end_of(k) for k in range(2)]

    def begin(self, t: float, y: FloatArray) -> None:
        """Let go of what is pushed harder than friction holds."""
        for k, push in enumerate(self._active(t + 1e-6, y)):
            if not self.signs[k] and abs(push) > self.holding[k]:
                self.signs[k] = math.copysign(1.0, push)

    def cross(self, t: float, y: FloatArray, k: int) -> FloatArray:
        """Stop what reaches zero; it sticks unless it is pushed on."""
        push = self._active(t, y)[k]
        after = np.array(y)
        if self.signs[k]:
            after[k] = 0.0
            self.signs[k] = 0.0 if abs(push) < self.holding[k] else math.copysign(1.0, push)
        else:
            self.signs[k] = math.copysign(1.0, push)
        return after


_HYBRIDS: dict[str, type[_Planar]] = {"coulomb": _Coulomb, "improved": _Improved, "linear": _Linear}


def solve_with_events(name: str, scenario: SineScenario) -> Effort:
    """Solve a model on a scenario from rest, and return what that took.

    After a located crossing the solver goes on for one step of `PLANAR_DT` before it looks for the next: the printed Coulomb
    friction pushes a robot at rest to and fro, and a solver without that would never leave.

    Args:
        name: `coulomb`, `improved` or `linear`, with the printed parameters.
        scenario: the command.
    """
    plant = load_profile(PROFILE).plants[name]
    hybrid: Any = _HYBRIDS[name](PlanarModel(plant.parameters, plant.vehicle, plant.drive), scenario)
    ends = [plant.drive.delay_v, plant.drive.delay_w + scenario.lead_in, scenario.duration]  # the command has corners there
    t, y, evaluations, located, crossed = 0.0, np.zeros(2), 0, 0, False
    began = time.process_time()
    while t < scenario.duration:
        end = next(e for e in ends if e > t)
        hybrid.begin(t, y)
        watched: list[Any] = [] if crossed else hybrid.events()
        for event in watched:
            event.terminal = True
        found = solve_ivp(
            hybrid.rates,
            (t, min(end, t + PLANAR_DT) if crossed else end),
            y,
            rtol=SOLVER_TOLERANCE,
            atol=1e-6,
            events=watched or None,
        )
        evaluations += found.nfev
        t, y, crossed = float(found.t[-1]), found.y[:, -1], found.status == 1
        if crossed:
            located += 1
            y = hybrid.cross(t, y, next(k for k, times in enumerate(found.t_events) if len(times)))
    return Effort(evaluations, located, time.process_time() - began, y)


class Solved(NamedTuple):
    """What the solutions of a model took."""

    median_s: float
    """Median of the processor time [s]."""
    spread_s: float
    """Half the distance between its quartiles [s]."""
    evaluations: int
    """Number of evaluations of the right-hand side."""
    located: int
    """Number of changes of sign that were located."""


def solved_side_by_side(scenario: SineScenario, repeats: int) -> dict[str, Solved]:
    """Solve every model in turn, `repeats` times after one to compile, and return by model what that took."""
    for name in _HYBRIDS:
        solve_with_events(name, replace(scenario, duration=scenario.lead_in + 0.5))
    efforts = [{name: solve_with_events(name, scenario) for name in _HYBRIDS} for _ in range(repeats)]
    return {
        name: Solved(*median_and_spread([each[name].cpu_s for each in efforts]), effort.evaluations, effort.located)
        for name, effort in efforts[0].items()
    }


def median_and_spread(values: Sequence[float]) -> tuple[float, float]:
    """Return the median, and half the distance between the quartiles."""
    low, median, high = np.percentile(values, (25.0, 50.0, 75.0))
    return float(median), float(0.5 * (high - low))


def solutions_grid(solved: Mapping[str, Solved]) -> Grid:
    """Return times, evaluations and located changes of sign by model."""
    header = ("model", ""), ("time", "s"), ("over coulomb's", "1"), ("right-hand sides", "1"), ("changes of sign", "1")
    rows = []
    for name, s in solved.items():
        ratio = f"{s.median_s / solved['coulomb'].median_s:.2f}"
        texts = name, f"{s.median_s:.3f} ± {s.spread_s:.3f}", ratio, str(s.evaluations), str(s.located)
        rows.append(tuple(map(Cell, texts)))
    return Grid(header, (tuple(rows),), left=1)
