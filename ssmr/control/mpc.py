"""Linear time-varying model predictive control on the planar model, with dead time, lags, and limits on command and rate.

At every command the robot is carried over its dead time (`ssmr.control.predictor`), so that the commands on their way are
the delay states. From there the unicycle with the linear model's speeds (Eq. 2.46) and the lag of the wheels is rolled out
under the last plan, linearised about that motion, and the quadratic program

    sum_k  |R(phi_k)' (p_k - p_ref,k)|^2_Q + q_heading (theta_k - phi_k)^2
         + |u_k - u_ref,k|^2_R + |(u_k - u_k-1) - (u_ref,k - u_ref,k-1)|^2_D
    with   |u_k| <= limits,   |u_k - u_k-1| <= rates * h_k

is solved for the commands u_k (a real-time iteration: M. Diehl et al., J. Process Control 12, 2002). The first one is sent,
and the rest is where the next plan begins. The states are eliminated, which leaves a dense program of 30 unknowns. DAQP
solves it exactly (D. Arnstroem et al., IEEE Trans. Autom. Control 67, 2022).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ssmr._jit import jit, jit_alone
from ssmr.control.law import Gains, Law
from ssmr.control.mission import ControllerInput, Mission
from ssmr.control.predictor import PredictorModel
from ssmr.parameters import packed, parameter
from ssmr.types import FloatArray

STEP_PERIODS = 2
"""Command periods in a step of the plan; the first step is one period long, because its command is held no longer."""

HEADING_TIME = 0.2
"""Time over which the target's heading is averaged [s]: waypoints turn it in jumps, more in one step than in the next."""
_SLOWEST = 0.1
"""A target slower than this has no slip angle [m/s]."""


@dataclass(frozen=True)
class MpcGains(Gains):
    """Weights of the plan, each over a step, and its length."""

    q_along: float = parameter(20.0, unit="1/m2", low=0.0, high=1e6, search=(2.0, 200.0), scale="log")
    """Weight of the distance to the target along its path."""
    q_across: float = parameter(200.0, unit="1/m2", low=0.0, high=1e6, search=(20.0, 2000.0), scale="log")
    """Weight of the distance to the target across its path."""
    q_heading: float = parameter(1.0, unit="1/rad2", low=0.0, high=1e6, search=(0.05, 50.0), scale="log")
    """Weight of the heading error."""
    r_v: float = parameter(0.005, unit="s2/m2", low=0.0, high=1e6, open_low=True, search=(0.001, 1.0), scale="log")
    """Weight of the speed command less that of the target."""
    r_w: float = parameter(0.01, unit="s2/rad2", low=0.0, high=1e6, open_low=True, search=(0.001, 1.0), scale="log")
    """Weight of the yaw-rate command less that of the target."""
    d_v: float = parameter(20.0, unit="s2/m2", low=0.0, high=1e6, search=(0.1, 100.0), scale="log")
    """Weight of the change of the speed command from step to step, less the target's."""
    d_w: float = parameter(0.05, unit="s2/rad2", low=0.0, high=1e6, search=(0.001, 10.0), scale="log")
    """Weight of the change of the yaw-rate command from step to step, less the target's."""
    horizon: float = parameter(1.5, unit="s", low=0.2, high=10.0)
    """Length of the plan behind the dead time."""


class Channel(NamedTuple):
    """One step of speed or of yaw rate: next speed, next reference behind the lag, and way, as sums over their causes."""

    v_v: float
    v_l: float
    v_u: float
    l_l: float
    l_u: float
    s_v: float
    s_l: float
    s_u: float


def channel(rate: float, push: float, lag: float, h: float) -> Channel:
    """Return the exact step of `h` [s] of v' = -rate v + push l, l' = (u - l) / lag, s' = v for a held command u."""
    from scipy.linalg import expm  # here: it is slow to import, and only a plan needs it

    if lag > 0.0:
        m = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, -rate, push, 0.0], [0.0, 0.0, -1.0 / lag, 1.0 / lag], [0.0] * 4])
        e = expm(m * h)
        return Channel(*map(float, (e[1, 1], e[1, 2], e[1, 3], e[2, 2], e[2, 3], e[0, 1], e[0, 2], e[0, 3])))
    e = expm(np.array([[0.0, 1.0, 0.0], [0.0, -rate, push], [0.0, 0.0, 0.0]]) * h)
    return Channel(float(e[1, 1]), 0.0, float(e[1, 2]), 0.0, 1.0, float(e[0, 1]), 0.0, float(e[0, 2]))


class PlannedBody(NamedTuple):
    """The robot at a step of the plan."""

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


@jit_alone
def step_body(now: PlannedBody, v: float, w: float, along: Channel, turn: Channel) -> PlannedBody:
    """Return the robot after one step under the commands `v` [m/s] and `w` [rad/s]."""
    way = along.s_v * now.v + now.gain_v * (along.s_l * now.lagged_v + along.s_u * v)
    angle = turn.s_v * now.w + now.gain_w * (turn.s_l * now.lagged_w + turn.s_u * w)
    heading, aside = now.yaw + 0.5 * angle, now.slip * angle
    c, s = np.cos(heading), np.sin(heading)
    return PlannedBody(
        now.x + way * c - aside * s, now.y + way * s + aside * c, now.yaw + angle,
        along.v_v * now.v + now.gain_v * (along.v_l * now.lagged_v + along.v_u * v),
        turn.v_v * now.w + now.gain_w * (turn.v_l * now.lagged_w + turn.v_u * w),
        along.l_l * now.lagged_v + along.l_u * v, turn.l_l * now.lagged_w + turn.l_u * w,
        now.gain_v, now.gain_w, now.slip,
    )  # fmt: skip


@jit
def _sensitivity(g: FloatArray, now: PlannedBody, after: PlannedBody, k: int, along: Channel, turn: Channel) -> None:
    """Advance (7, 2N) derivatives of the `PlannedBody` by the commands over step `k`, in place."""
    angle, dx, dy = after.yaw - now.yaw, after.x - now.x, after.y - now.y
    heading = now.yaw + 0.5 * angle
    c, s = np.cos(heading), np.sin(heading)
    for j in range(2 * k + 2):
        u_v, u_w = 1.0 if j == 2 * k else 0.0, 1.0 if j == 2 * k + 1 else 0.0
        way = along.s_v * g[3, j] + now.gain_v * (along.s_l * g[5, j] + along.s_u * u_v)
        turned = turn.s_v * g[4, j] + now.gain_w * (turn.s_l * g[6, j] + turn.s_u * u_w)
        rotated, aside = g[2, j] + 0.5 * turned, now.slip * turned
        g[0, j] += c * way - s * aside - dy * rotated
        g[1, j] += s * way + c * aside + dx * rotated
        g[2, j] += turned
        g[3, j] = along.v_v * g[3, j] + now.gain_v * (along.v_l * g[5, j] + along.v_u * u_v)
        g[4, j] = turn.v_v * g[4, j] + now.gain_w * (turn.v_l * g[6, j] + turn.v_u * u_w)
        g[5, j] = along.l_l * g[5, j] + along.l_u * u_v
        g[6, j] = turn.l_l * g[6, j] + turn.l_u * u_w


@jit
def _add_commands(h: FloatArray, f: FloatArray, wanted: FloatArray, last: FloatArray, gains: Any) -> None:
    """Add the costs of the commands and of their changes to a program, in place; see `condense`."""
    n = len(wanted) - 1
    for k in range(n):
        for j in range(2):
            i, r, d = 2 * k + j, gains.r_v if j == 0 else gains.r_w, gains.d_v if j == 0 else gains.d_w
            h[i, i] += r + d * (2.0 if k < n - 1 else 1.0)
            f[i] -= r * wanted[1 + k, j] + d * (wanted[1 + k, j] - wanted[k, j])
            if k == 0:
                f[i] -= d * last[j]
            else:
                h[i, i - 2] -= d
            if k < n - 1:
                f[i] += d * (wanted[2 + k, j] - wanted[1 + k, j])


@jit
def _add_errors(h: FloatArray, f: FloatArray, rows: FloatArray, errors: FloatArray, plan: FloatArray, weights: Any) -> None:
    """Add the costs of the errors at one step to a program, in place.

    Args:
        h: (2N, 2N) lower half of H.
        f: (2N,).
        rows: (3, m) derivatives of the errors by the first m commands.
        errors: (3,) errors under the plan: along, across and of heading.
        plan: (N, 2) commands.
        weights: those of the three errors.
    """
    m = rows.shape[1]
    for r in range(3):
        left = errors[r]
        for j in range(m):
            left -= rows[r, j] * plan[j // 2, j % 2]
        for i in range(m):
            weighted = weights[r] * rows[r, i]
            f[i] += weighted * left
            for j in range(i + 1):
                h[i, j] += weighted * rows[r, j]


@jit_alone
def condense(
    start: PlannedBody, plan: FloatArray, aims: FloatArray, wanted: FloatArray, last: FloatArray, model: Any, gains: Any
) -> tuple[FloatArray, FloatArray]:
    """Return the quadratic program of a plan: H (2N, 2N) and f (2N,) of u' H u / 2 + f' u.

    Args:
        start: the robot at the start of the plan.
        plan: (N, 2) commands about whose motion is linearised.
        aims: (N, 3) x, y [m] and heading [rad] of the target at the end of each step.
        wanted: (1 + N, 2) commands that would drive as the target does: of the step before the plan, and of each step.
        last: (2,) command before the plan.
        model: `Channel`s of speed and of yaw rate for the first step, and for the others.
        gains: the weights.
    """
    n = len(plan)
    h, f, g = np.zeros((2 * n, 2 * n)), np.zeros(2 * n), np.zeros((7, 2 * n))
    rows, errors = np.empty((3, 2 * n)), np.empty(3)
    weights = (gains.q_along, gains.q_across, gains.q_heading)
    now = start
    for k in range(n):
        along, turn = (model[0], model[1]) if k == 0 else (model[2], model[3])
        after = step_body(now, plan[k, 0], plan[k, 1], along, turn)
        _sensitivity(g, now, after, k, along, turn)
        now = after
        c, s = np.cos(aims[k, 2]), np.sin(aims[k, 2])
        dx, dy = now.x - aims[k, 0], now.y - aims[k, 1]
        errors[0], errors[1] = c * dx + s * dy, -s * dx + c * dy
        errors[2] = np.pi - (np.pi - (now.yaw - aims[k, 2])) % (2.0 * np.pi)
        m = 2 * k + 2
        for j in range(m):
            rows[0, j], rows[1, j], rows[2, j] = c * g[0, j] + s * g[1, j], -s * g[0, j] + c * g[1, j], g[2, j]
        _add_errors(h, f, rows[:, :m], errors, plan, weights)
    _add_commands(h, f, wanted, last, gains)
    for i in range(2 * n):
        for j in range(i):
            h[j, i] = h[i, j]
    return h, f


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
            raise ValueError("mpc needs a linear model that follows commands: rates and gains of speed and yaw rate above 0")
        first, long = mission.period, STEP_PERIODS * mission.period
        n = 1 + max(1, round((gains.horizon - first) / long))
        self._ends = first + long * np.arange(n)  # of the steps, after the dead time [s]
        self._starts = np.concatenate([[-long, 0.0], self._ends[:-1]])
        self._lengths = np.diff(np.append(self._starts, self._ends[-1]))
        self._model = tuple(
            channel(rate, push, f.lag, h)
            for h in (first, long)
            for rate, push in ((f.rate_v, f.push_v), (f.rate_w, f.push_w))
        )
        self._steady = np.array([f.rate_v / f.push_v, f.rate_w / f.push_w])  # command over lasting speed
        self._limits = np.array([f.v_max, f.w_max])
        rates = np.minimum([f.acceleration_v, f.acceleration_w], 1e6)
        self._changes = np.outer(self._lengths[1:], rates)
        course = mission.waypoints.course()
        reach = f.horizon + self._ends[-1] + long + HEADING_TIME
        self._times = np.concatenate([[-reach], course["t"], [course["t"][-1] + 2.0 * reach]])
        held = np.concatenate([[course["heading"][0]], course["heading"]]) * np.diff(self._times)
        self._turned = np.cumulative_sum(held, include_initial=True)  # integral of the heading [rad s]
        self._steps = np.eye(2 * n) - np.eye(2 * n, k=-2)
        self._solver: Any = daqp.Model()
        self._plan: FloatArray | None = None
        self.failures = 0
        """Number of programs that the solver could not solve; the plan before was carried on."""

    def command(self, now: ControllerInput) -> tuple[float, float]:
        """Return the first command of the best plan."""
        t = now.t + self._mission.dead_time
        asked, times = now.driver, t + np.append(self._starts, self._ends[-1])
        aims, headings = self._mission.preview(times)[:, :3], self._headings(times)
        speeds = np.column_stack([np.hypot(*np.diff(aims[:, :2], axis=0).T), np.diff(headings)]) / self._lengths[:, None]
        wanted = np.clip(speeds * self._steady / (asked.gain_v, asked.gain_w), -self._limits, self._limits)
        aims[:, 2] = headings
        aims[:, :2] -= self._mission.lookahead * np.column_stack([np.cos(headings), np.sin(headings)])
        aims[1:, 2] -= asked.slip * speeds[:, 1] / np.maximum(speeds[:, 0], _SLOWEST)  # it goes round bends at an angle
        begun = np.clip([asked.v, asked.w], -self._limits, self._limits)
        plan = wanted[1:] if self._plan is None else self._carried_on()
        start = PlannedBody(*now.ahead, asked.lagged_v, asked.lagged_w, asked.gain_v, asked.gain_w, asked.slip)
        h, f = condense(start, plan, aims[2:], wanted, now.past[-1].copy(), self._model, self._gains)
        self._plan = self._solved(h, f, plan, begun)
        return float(self._plan[0, 0]), float(self._plan[0, 1])

    def _headings(self, times: FloatArray) -> FloatArray:
        """Return the target's heading at mission times, averaged over `HEADING_TIME`."""
        half = 0.5 * HEADING_TIME
        turned = [np.interp(times + side, self._times, self._turned, left=np.nan, right=np.nan) for side in (-half, half)]
        return np.asarray((turned[1] - turned[0]) / HEADING_TIME)

    def _carried_on(self) -> FloatArray:
        """Return the last plan one period later: of each long step half is over."""
        assert self._plan is not None
        later = np.vstack([self._plan[1:], self._plan[-1:]])
        return np.vstack([later[:1], 0.5 * (later[:-1] + later[1:])])

    def _solved(self, h: FloatArray, f: FloatArray, plan: FloatArray, begun: FloatArray) -> FloatArray:
        """Return the (N, 2) commands that solve the program; those of `plan`, within the limits, where the solver fails."""
        change = self._changes.copy()
        upper, lower = change.copy(), -change
        upper[0] += begun
        lower[0] += begun
        box = np.tile(self._limits, len(plan))
        above, below = np.concatenate([box, upper.ravel()]), np.concatenate([-box, lower.ravel()])
        if self._plan is None:
            self._solver.setup(h, f, self._steps, above, below, np.zeros(len(above), dtype=np.int32))
        else:
            self._solver.update(H=h, f=f, bupper=above, blower=below)
        found, _, flag, _ = self._solver.solve()
        if flag > 0 and np.isfinite(found).all():
            return np.asarray(found, dtype=np.float64).reshape(-1, 2).clip(-self._limits, self._limits)
        self.failures += 1
        kept = plan.copy()
        kept[0] = np.clip(np.clip(kept[0], lower[0], upper[0]), -self._limits, self._limits)
        return kept


LAW = Law(
    "mpc",
    MpcGains,
    searched=("q_along", "q_across", "q_heading", "r_v", "r_w", "d_v", "d_w"),
    colour="#111111",
    population=24,
    generations=20,
    make=Mpc,
)
