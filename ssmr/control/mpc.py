"""Linear time-varying model predictive control on the planar model, with dead time, lags, and limits on command and rate.

At every command the robot is carried over its dead time (`ssmr.control.predictor`), so that the
commands on their way are the delay states. From there the unicycle with the linear model's speeds
(Eq. 2.46) and the lag of the wheels is rolled out under the last plan, linearised about that
motion, and the quadratic program

    sum_k  |R(phi_k)' (p_k - p_ref,k)|^2_Q + q_heading (theta_k - phi_k)^2
         + |u_k - u_ref,k|^2_R + |(u_k - u_k-1) - (u_ref,k - u_ref,k-1)|^2_D
    with   |u_k| <= limits,   |u_k - u_k-1| <= rates * h_k

is solved for the commands u_k (a real-time iteration: M. Diehl et al., J. Process Control 12,
2002). The first one is sent, and the rest is where the next plan begins. The states are eliminated,
which leaves a dense program of 30 unknowns. DAQP solves it exactly (D. Arnstroem et al., IEEE
Trans. Autom. Control 67, 2022).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ssmr.control.law import Gains, Law
from ssmr.control.mission import ControllerInput, Mission
from ssmr.control.predictor import PredictorModel
from ssmr.geometry import wrap_angle
from ssmr.parameters import packed, parameter
from ssmr.types import FloatArray

STEP_PERIODS = 2
"""Command periods in a step of the plan; the first step is one period long, because its command is
held no longer."""

HEADING_TIME = 0.2
"""Time over which the target's heading is averaged [s]: waypoints turn it in jumps, more in one
step than in the next."""
_SLOWEST = 0.1
"""A target slower than this has no slip angle [m/s]."""


@dataclass(frozen=True)
class MpcGains(Gains):
    """Weights of the plan, each over a step, and its length."""

    q_along: float = parameter(
        20.0, unit="1/m2", low=0.0, high=1e6, search=(2.0, 200.0), scale="log"
    )
    """Weight of the distance to the target along its path."""
    q_across: float = parameter(
        200.0, unit="1/m2", low=0.0, high=1e6, search=(20.0, 2000.0), scale="log"
    )
    """Weight of the distance to the target across its path."""
    q_heading: float = parameter(
        1.0, unit="1/rad2", low=0.0, high=1e6, search=(0.05, 50.0), scale="log"
    )
    """Weight of the heading error."""
    r_v: float = parameter(
        0.005, unit="s2/m2", low=0.0, high=1e6, open_low=True, search=(0.001, 1.0), scale="log"
    )
    """Weight of the speed command less that of the target."""
    r_w: float = parameter(
        0.01, unit="s2/rad2", low=0.0, high=1e6, open_low=True, search=(0.001, 1.0), scale="log"
    )
    """Weight of the yaw-rate command less that of the target."""
    d_v: float = parameter(20.0, unit="s2/m2", low=0.0, high=1e6, search=(0.1, 100.0), scale="log")
    """Weight of the change of the speed command from step to step, less the target's."""
    d_w: float = parameter(
        0.05, unit="s2/rad2", low=0.0, high=1e6, search=(0.001, 10.0), scale="log"
    )
    """Weight of the change of the yaw-rate command from step to step, less the target's."""
    horizon: float = parameter(1.5, unit="s", low=0.2, high=10.0)
    """Length of the plan behind the dead time."""


class PlannedBody(NamedTuple):
    """The robot at the start of a plan."""

    x: float
    y: float
    yaw: float
    v: float
    w: float
    lagged_v: float
    lagged_w: float
    gain_v: float
    gain_w: float
    slip: float


def step_of(rate: float, push: float, lag: float, h: float) -> FloatArray:
    """Return (3, 3) way, next speed and next lagged reference over speed, lagged reference and command, exactly.

    This is the step of `h` [s] of s' = v, v' = -rate v + push l, l' = (u - l) / lag for a held
    command u.
    """
    from scipy.linalg import expm  # here: it is slow to import, and only a plan needs it

    if lag > 0.0:
        m = [
            [0.0, 1.0, 0.0, 0.0],
            [0.0, -rate, push, 0.0],
            [0.0, 0.0, -1.0 / lag, 1.0 / lag],
            [0.0] * 4,
        ]
        return np.asarray(expm(np.array(m) * h)[:3, 1:])
    e = expm(np.array([[0.0, 1.0, 0.0], [0.0, -rate, push], [0.0, 0.0, 0.0]]) * h)
    return np.array([[e[0, 1], 0.0, e[0, 2]], [e[1, 1], 0.0, e[1, 2]], [0.0, 0.0, 1.0]])


def responses(steps: Sequence[FloatArray]) -> FloatArray:
    """Return (N, 2 + N) the way in each of N steps of `step_of`, over first speed, first lagged reference and N commands."""
    n = len(steps)
    ways, speed, lagged = np.zeros((n, 2 + n)), np.zeros(2 + n), np.zeros(2 + n)
    speed[0] = lagged[1] = 1.0
    for k, step in enumerate(steps):
        command = np.zeros(2 + n)
        command[2 + k] = 1.0
        ways[k], speed, lagged = step @ np.stack([speed, lagged, command])
    return ways


def planned_motion(
    start: PlannedBody, plan: FloatArray, model: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return the motion of a robot under (N, 2) commands, each step a chord at its mean heading.

    `model` are the (N, 2 + N) `responses` of speed and yaw rate.

    Returns:
        (N, 3) x, y [m] and yaw [rad] at the end of each step, and (3, N, 2N) their derivatives by
        the 2N commands.
    """
    n, (along, turn) = len(plan), model
    way = along @ np.concatenate(
        [[start.v, start.gain_v * start.lagged_v], start.gain_v * plan[:, 0]]
    )
    angle = turn @ np.concatenate(
        [[start.w, start.gain_w * start.lagged_w], start.gain_w * plan[:, 1]]
    )
    yaw = start.yaw + np.cumsum(angle)
    c, s, aside = np.cos(yaw - 0.5 * angle), np.sin(yaw - 0.5 * angle), start.slip * angle
    dx, dy = way * c - aside * s, way * s + aside * c
    pose = np.column_stack([start.x + np.cumsum(dx), start.y + np.cumsum(dy), yaw])
    by_way, by_angle = np.zeros((n, 2 * n)), np.zeros((n, 2 * n))
    by_way[:, 0::2], by_angle[:, 1::2] = start.gain_v * along[:, 2:], start.gain_w * turn[:, 2:]
    turned, aside_slope = np.cumsum(by_angle, axis=0), start.slip * by_angle
    heading, c, s = turned - 0.5 * by_angle, c[:, None], s[:, None]
    slope_x = np.cumsum(c * by_way - s * aside_slope - dy[:, None] * heading, axis=0)
    slope_y = np.cumsum(s * by_way + c * aside_slope + dx[:, None] * heading, axis=0)
    return pose, np.stack([slope_x, slope_y, turned])


def condense(
    start: PlannedBody,
    plan: FloatArray,
    aims: FloatArray,
    wanted: FloatArray,
    last: FloatArray,
    model: tuple[FloatArray, FloatArray],
    gains: Any,
) -> tuple[FloatArray, FloatArray]:
    """Return the quadratic program of a plan: H (2N, 2N) and f (2N,) of u' H u / 2 + f' u.

    Args:
        start: the robot at the start of the plan.
        plan: (N, 2) commands about whose motion is linearised.
        aims: (N, 3) x, y [m] and heading [rad] of the target at the end of each step.
        wanted: (1 + N, 2) commands that would drive as the target does: of the step before the
            plan, and of each step.
        last: (2,) command before the plan.
        model: (N, 2 + N) `responses` of speed and yaw rate.
        gains: the weights.
    """
    n, (pose, slopes) = len(plan), planned_motion(start, plan, model)
    c, s, off = np.cos(aims[:, 2]), np.sin(aims[:, 2]), pose - aims
    errors = c * off[:, 0] + s * off[:, 1], c * off[:, 1] - s * off[:, 0], wrap_angle(off[:, 2])
    c, s = c[:, None], s[:, None]
    rows = c * slopes[0] + s * slopes[1], c * slopes[1] - s * slopes[0], slopes[2]
    changes = np.eye(2 * n) - np.eye(2 * n, k=-2)
    r, d = np.tile([gains.r_v, gains.r_w], n), np.tile([gains.d_v, gains.d_w], n)
    before = np.diff(wanted, axis=0)
    before[0] += last
    h = np.diag(r) + changes.T @ (d[:, None] * changes)
    f = -r * wanted[1:].ravel() - changes.T @ (d * before.ravel())
    for weight, row, error in zip(
        (gains.q_along, gains.q_across, gains.q_heading), rows, errors, strict=True
    ):
        h += weight * row.T @ row
        f += weight * row.T @ (error - row @ plan.ravel())
    return 0.5 * (h + h.T), f


class Mpc:
    """The controller on one mission."""

    def __init__(self, gains: MpcGains, mission: Mission) -> None:
        """Build what does not change from plan to plan: the model's steps, the limits and the solver.

        Raises:
            ValueError: the linear model does not answer to commands.
        """
        import daqp  # here: only this controller needs it

        self._mission, self._gains = mission, packed(gains)
        f: PredictorModel = mission.model
        if not (f.rate_v > 0.0 and f.rate_w > 0.0 and f.push_v > 0.0 and f.push_w > 0.0):
            raise ValueError(
                "mpc needs a linear model that follows commands: rates and gains of speed and yaw rate above 0"
            )
        first, long = mission.period, STEP_PERIODS * mission.period
        n = 1 + max(1, round((gains.horizon - first) / long))
        self._ends = first + long * np.arange(n)  # of the steps, after the dead time [s]
        self._starts = np.concatenate([[-long, 0.0], self._ends[:-1]])
        self._lengths = np.diff(np.append(self._starts, self._ends[-1]))
        lengths = [first, *[long] * (n - 1)]
        along, turn = (
            responses([step_of(rate, push, f.lag, h) for h in lengths])
            for rate, push in ((f.rate_v, f.push_v), (f.rate_w, f.push_w))
        )
        self._model = along, turn
        self._steady = np.array(
            [f.rate_v / f.push_v, f.rate_w / f.push_w]
        )  # command over lasting speed
        self._limits = np.array([f.v_max, f.w_max])
        rates = np.minimum([f.acceleration_v, f.acceleration_w], 1e6)
        self._changes = np.outer(self._lengths[1:], rates)
        course = mission.waypoints.course()
        reach = f.horizon + self._ends[-1] + long + HEADING_TIME
        self._times = np.concatenate([[-reach], course["t"], [course["t"][-1] + 2.0 * reach]])
        held = np.concatenate([[course["heading"][0]], course["heading"]]) * np.diff(self._times)
        self._turned = np.cumulative_sum(
            held, include_initial=True
        )  # integral of the heading [rad s]
        self._steps = np.eye(2 * n) - np.eye(2 * n, k=-2)
        self._solver: Any = daqp.Model()
        self._plan: FloatArray | None = None
        self.failures = 0
        """Number of programs that the solver could not solve; the plan before was carried on."""

    def command(self, now: ControllerInput) -> tuple[float, float]:
        """Return the first command of the best plan."""
        t = now.t + self._mission.dead_time
        driver, times = now.driver, t + np.append(self._starts, self._ends[-1])
        half = 0.5 * HEADING_TIME
        turned = [
            np.interp(times + side, self._times, self._turned, left=np.nan, right=np.nan)
            for side in (-half, half)
        ]
        aims, headings = self._mission.preview(times)[:, :3], (turned[1] - turned[0]) / HEADING_TIME
        speeds = (
            np.column_stack([np.hypot(*np.diff(aims[:, :2], axis=0).T), np.diff(headings)])
            / self._lengths[:, None]
        )
        wanted = np.clip(
            speeds * self._steady / (driver.gain_v, driver.gain_w), -self._limits, self._limits
        )
        aims[:, 2] = headings
        aims[:, :2] -= self._mission.lookahead * np.column_stack(
            [np.cos(headings), np.sin(headings)]
        )
        aims[1:, 2] -= (
            driver.slip * speeds[:, 1] / np.maximum(speeds[:, 0], _SLOWEST)
        )  # it goes round bends at an angle
        begun = np.clip([driver.v, driver.w], -self._limits, self._limits)
        plan = wanted[1:]
        if self._plan is not None:  # the last one, one period later: of each long step half is over
            later = np.vstack([self._plan[1:], self._plan[-1:]])
            plan = np.vstack([later[:1], 0.5 * (later[:-1] + later[1:])])
        start = PlannedBody(
            *now.ahead, driver.lagged_v, driver.lagged_w, driver.gain_v, driver.gain_w, driver.slip
        )
        h, f = condense(
            start, plan, aims[2:], wanted, now.past[-1].copy(), self._model, self._gains
        )
        self._plan = self._solved(h, f, plan, begun)
        return float(self._plan[0, 0]), float(self._plan[0, 1])

    def _solved(
        self, h: FloatArray, f: FloatArray, plan: FloatArray, begun: FloatArray
    ) -> FloatArray:
        """Return the (N, 2) commands that solve the program; those of `plan`, within the limits, where the solver fails."""
        upper, lower = self._changes.copy(), -self._changes
        upper[0] += begun
        lower[0] += begun
        box = np.tile(self._limits, len(plan))
        above, below = np.concatenate([box, upper.ravel()]), np.concatenate([-box, lower.ravel()])
        if self._plan is None:
            self._solver.setup(
                h, f, self._steps, above, below, np.zeros(len(above), dtype=np.int32)
            )
        else:
            self._solver.update(H=h, f=f, bupper=above, blower=below)
        solution, _, flag, _ = self._solver.solve()
        if flag > 0 and np.isfinite(solution).all():
            return (
                np.asarray(solution, dtype=np.float64)
                .reshape(-1, 2)
                .clip(-self._limits, self._limits)
            )
        self.failures += 1
        kept = plan.copy()
        kept[0] = np.clip(np.clip(kept[0], lower[0], upper[0]), -self._limits, self._limits)
        return kept


LAW = Law(
    "mpc",
    MpcGains,
    searched=("q_along", "q_across", "q_heading", "r_v", "r_w", "d_v", "d_w"),
    population=24,
    generations=20,
    make=Mpc,
)
