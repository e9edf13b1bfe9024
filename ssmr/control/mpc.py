"""Linear time-varying model predictive control on the planar model, along a path.

The references begin at the place of the path that is nearest to the robot, and go on by the path's
speeds. The clock is a wish. The time at which commands act has a spread, and D contains what that
makes of changes: its variance over h_k^2, times the curvature of the other costs.

The plan knows the dead time, the lags, and the limits on commands and on their rates.
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

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ssmr.control.law import REVERSAL, SPOT_TURN, Gains, Law, Observation
from ssmr.control.mission import ControllerInput, Mission
from ssmr.control.predictor import DriverEstimate, PredictorModel
from ssmr.geometry import wrap_angle
from ssmr.parameters import pack_numbers, parameter
from ssmr.types import FloatArray

_STEP_PERIODS = 2
"""Command periods in a step of the plan; the first step is one period long, because its command is
held no longer."""
_HASTE = 0.2
"""By this share of the path's speed a robot that is behind its clock may drive faster, in bends as
far as time is certain, and by this share of its greatest speed any plan may [1]."""
_SLOWEST_RATE = 0.75
"""Least speed over that of the path [1]."""
_CATCH_TIME = 2.0
"""Time in which the robot would make up for its distance to the clock's target [s]."""
_BEHIND = 1.0
"""Distance behind that target from which on a robot is faster again whose time is uncertain; at
twice as much it is as fast as any [m]."""
_CERTAIN = 0.03
"""Spread of the time at which commands act up to which time is certain [s]: pushes and noise show
as much."""
_CLOCK_SPEED = 0.03
"""Speed by which the clock draws the place on the path along where the robot does not say it
[m/s]."""
_PLACE_TIME = 0.2
"""Time constant with which that place follows the robot [s]: it goes on by as much ahead of one
that stands, and draws it along."""
_JUMP = 0.6
"""Greatest change of that place from one command to the next, but for its motion [s]."""
_KEPT = 2.0
"""Time constant with which errors of predictions are forgotten [s]."""
_TURNING = 0.2
"""Yaw rate [rad/s] below which headings say little about time. A second of it counts as one in
which time was as certain as `Mpc.margin`."""

_HEADING_TIME = 0.2
"""Time over which the target's heading is averaged [s]: waypoints turn it in jumps, more in one
step than in the next."""
_STANDS = 1e-6
"""Way in which a path has no heading of its own: its target stands [m]."""


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


def step_of(rate: float, push: float, lag: float, h: float) -> FloatArray:
    """Return the exact step of `h` [s] of s' = v, v' = -rate v + push l, l' = (u - l) / lag.

    The command u is held. Rows of the (3, 3) matrix are the way, the next speed and the next lagged
    reference; columns are the speed, the lagged reference and the command.
    """
    from scipy.linalg import expm  # here: it is slow to import, and only a plan needs it

    if lag > 0.0:
        speed = [0.0, -rate, push, 0.0]
        lagged = [0.0, 0.0, -1.0 / lag, 1.0 / lag]
        m = np.array([[0.0, 1.0, 0.0, 0.0], speed, lagged, [0.0] * 4])
        return np.asarray(expm(m * h)[:3, 1:])
    m = np.array([[0.0, 1.0, 0.0], [0.0, -rate, push], [0.0] * 3])
    e = expm(m * h)
    step = np.zeros((3, 3))
    step[:2, [0, 2]] = e[:2, 1:]
    step[2, 2] = 1.0
    return step


def _step_responses(steps: Sequence[FloatArray]) -> FloatArray:
    """Return (N, 2 + N) the way in each of N steps of `step_of`.

    Columns are the first speed, the first lagged reference and the N commands.
    """
    n = len(steps)
    ways = np.zeros((n, 2 + n))
    speed = np.zeros(2 + n)
    lagged = np.zeros(2 + n)
    speed[0] = 1.0
    lagged[1] = 1.0
    for k, step in enumerate(steps):
        command = np.zeros(2 + n)
        command[2 + k] = 1.0
        ways[k], speed, lagged = step @ np.stack([speed, lagged, command])
    return ways


def _planned_motion(
    start: Observation,
    driver: DriverEstimate,
    plan: FloatArray,
    model: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Return the motion of a robot under (N, 2) commands, each step a chord at its mean heading.

    The plan begins at `start`, with the references of `driver`. `model` are the (N, 2 + N)
    `_step_responses` of speed and yaw rate.

    Returns:
        (N, 3) x, y [m] and yaw [rad] at the end of each step, and (3, N, 2N) their derivatives by
        the 2N commands.
    """
    n = len(plan)
    along, turn = model
    first_v = [start.v, driver.gain_v * driver.lagged_v]
    first_w = [start.w, driver.gain_w * driver.lagged_w]
    way = along @ np.concatenate([first_v, driver.gain_v * plan[:, 0]])
    angle = turn @ np.concatenate([first_w, driver.gain_w * plan[:, 1]])
    yaw = start.yaw + np.cumsum(angle)
    heading = yaw - 0.5 * angle
    c = np.cos(heading)
    s = np.sin(heading)
    dx = way * c
    dy = way * s
    x = start.x + np.cumsum(dx)
    y = start.y + np.cumsum(dy)
    pose = np.column_stack([x, y, yaw])
    # The same quantities, differentiated by the commands.
    way_slope = np.zeros((n, 2 * n))
    angle_slope = np.zeros((n, 2 * n))
    way_slope[:, 0::2] = driver.gain_v * along[:, 2:]
    angle_slope[:, 1::2] = driver.gain_w * turn[:, 2:]
    yaw_slope = np.cumsum(angle_slope, axis=0)
    heading_slope = yaw_slope - 0.5 * angle_slope
    c = c[:, None]
    s = s[:, None]
    dx_slope = c * way_slope - dy[:, None] * heading_slope
    dy_slope = s * way_slope + dx[:, None] * heading_slope
    x_slope = np.cumsum(dx_slope, axis=0)
    y_slope = np.cumsum(dy_slope, axis=0)
    return pose, np.stack([x_slope, y_slope, yaw_slope])


def _condense_plan(
    motion: tuple[FloatArray, FloatArray],
    plan: FloatArray,
    aims: FloatArray,
    steady: FloatArray,
    last: FloatArray,
    gains: Any,
    doubts: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the quadratic program of a plan: H (2N, 2N) and f (2N,) of u' H u / 2 + f' u.

    Args:
        motion: `_planned_motion` under the plan.
        plan: (N, 2) commands about whose motion is linearised.
        aims: (N, 3) x, y [m] and heading [rad] of the target at the end of each step.
        steady: (1 + N, 2) commands that would drive as the target does: of the step before the
            plan, and of each step.
        last: (2,) command before the plan.
        gains: the weights.
        doubts: (N,) variance of the time at which each command acts, over its step squared.
    """
    n = len(plan)
    pose, slopes = motion
    off = pose - aims
    c = np.cos(aims[:, 2])
    s = np.sin(aims[:, 2])
    error_along = c * off[:, 0] + s * off[:, 1]
    error_across = c * off[:, 1] - s * off[:, 0]
    c = c[:, None]
    s = s[:, None]
    slope_along = c * slopes[0] + s * slopes[1]
    slope_across = c * slopes[1] - s * slopes[0]
    # nothing moves a robot aside where its target stands; mean headings turn by rounding
    moves = np.abs(steady[1:]).max(axis=1, keepdims=True) > 1e-9
    terms = [
        (gains.q_along, error_along, slope_along),
        (gains.q_across * moves, error_across, slope_across),
        (gains.q_heading, wrap_angle(off[:, 2]), slopes[2]),
    ]
    changes = np.eye(2 * n) - np.eye(2 * n, k=-2)
    r = np.tile([gains.r_v, gains.r_w], n)
    # a command that acts later by dt moves the robot by slope (u_k-1 - u_k) dt / h
    shares = sum((weight * slope**2).sum(axis=0) for weight, _, slope in terms)
    d = np.tile([gains.d_v, gains.d_w], n) + np.repeat(doubts, 2) * shares
    steady_changes = np.diff(steady, axis=0)
    steady_changes[0] += last
    h = np.diag(r) + changes.T @ (d[:, None] * changes)
    f = -r * steady[1:].ravel()
    f -= changes.T @ (d * steady_changes.ravel())
    for weight, error, slope in terms:
        weighted = weight * slope
        h += weighted.T @ slope
        f += weighted.T @ (error - slope @ plan.ravel())
    return 0.5 * (h + h.T), f


class Mpc:
    """The controller on one mission."""

    margin = 0.025
    """Dead time that is planned for beyond that of the drive and what was learnt [s]: a plan for
    too little of it turns from one limit to the other, one for a bit too much is only slower."""

    def __init__(self, gains: MpcGains, mission: Mission) -> None:
        """Build the parts that all plans share: the model's steps, the limits and the solver.

        Raises:
            ValueError: the linear model does not answer to commands.
        """
        import daqp  # here: only this controller needs it

        self._mission = mission
        self._gains = pack_numbers(gains)
        model: PredictorModel = mission.model
        rates = np.array([model.rate_v, model.rate_w])
        pushes = np.array([model.push_v, model.push_w])
        if not (np.all(rates > 0.0) and np.all(pushes > 0.0)):
            raise ValueError(
                "mpc needs a linear model that follows commands: "
                "rates and gains of speed and yaw rate above 0"
            )
        self._steady = rates / pushes  # command over lasting speed
        first = mission.period
        long = _STEP_PERIODS * first
        n = 1 + max(1, round((gains.horizon - first) / long))
        ends = first + long * np.arange(n)
        self._edges = np.concatenate([[-long, 0.0], ends])  # of the steps, after the dead time [s]
        self._lengths = np.diff(self._edges)
        lengths = [first, *[long] * (n - 1)]
        steps_v = [step_of(model.rate_v, model.push_v, model.lag, h) for h in lengths]
        steps_w = [step_of(model.rate_w, model.push_w, model.lag, h) for h in lengths]
        self._model = (_step_responses(steps_v), _step_responses(steps_w))
        course = mission.waypoints.course()
        fastest = float(np.abs(course["v"]).max())
        self._limits = np.array([model.v_max, model.w_max])
        self._limits[0] = min(model.v_max, (1.0 + _HASTE) * fastest * float(self._steady[0]))
        accelerations = np.minimum([model.acceleration_v, model.acceleration_w], 1e6)
        self._changes = np.outer(self._lengths[1:], accelerations)
        # a leg begins where the target goes back, by more than a right angle
        moves = course[course["v"] != 0.0]
        ways = np.sign(moves["v"]) * np.exp(1j * moves["heading"])
        back = (ways[1:] * ways[:-1].conj()).real < 0.0
        self._legs = np.concatenate([[-math.inf], moves["t"][1:][back], [math.inf]])
        # stretches on which it is driven in one sense, and the integral of headings by way
        self._stamps = course["t"]
        lengths = np.abs(course["v"][:-1]) * np.diff(self._stamps)
        self._ways = np.cumulative_sum(lengths, include_initial=True)
        self._turned_on_way = np.cumulative_sum(
            lengths * course["heading"][:-1], include_initial=True
        )
        changes = np.flatnonzero(np.diff(np.sign(course["v"])))
        self._stretches = np.concatenate([[-math.inf], self._stamps[1 + changes], [math.inf]])
        self._bounds = np.interp(self._stretches, self._stamps, self._ways)
        # the clock leads within half a plan before the target rests or goes back
        stands = (course["v"] == 0.0) | np.isin(course["t"], self._legs)
        self._rests = course["t"][1:][stands[1:] & (course["v"][:-1] != 0.0)]
        self._brakes = self._rests - 0.5 * ends[-1]
        self._steps = np.eye(2 * n) - np.eye(2 * n, k=-2)
        self._solver: Any = daqp.Model()
        self._plan: FloatArray | None = None
        self._fastest = fastest
        self._bend = max(float(np.abs(course["w"]).max()), _TURNING)
        self._place = self._acted_at = -math.inf
        self._rate = 1.0
        self._predicted = deque[tuple[float, float, float]]()
        self._errors = self._turns = 0.0
        self.failures = 0
        """Number of programs that the solver could not solve; the plan before was carried on."""

    def observe(self, now: ControllerInput) -> None:
        """Learn from the robot's heading how far predictions are off.

        Errors show whatever the predictor does not know: a dead time that changes, a side that
        answers later than the other, motors that lag, ground that lets tyres slip. They grow with
        the root of the time for which is predicted.
        """
        keep = math.exp(-self._mission.period / _KEPT)
        if not now.past.any():  # a robot that was stopped did not go on as expected
            self._predicted.clear()
        while self._predicted and self._predicted[0][0] <= now.seen_at:
            at, yaw, turned = self._predicted.popleft()
            error = now.seen.yaw - now.seen.w * (now.seen_at - at) - yaw
            self._errors = keep * self._errors + error**2
            self._turns = keep * self._turns + turned

    @property
    def spread(self) -> float:
        """Standard deviation of the time at which commands act, by errors of headings [s]."""
        known = _TURNING**2 / self._mission.period
        return math.sqrt((self._errors + known * self.margin**2) / (self._turns + known))

    def _follow_path(self, now: ControllerInput, start: Observation) -> FloatArray:
        """Return the times of the path [s] for which the steps of a plan aim.

        The plan begins at the place of the path that is nearest to the robot when the command acts,
        wherever the clock's target is, and goes on from there by the path's speeds. The clock is a
        wish: a robot behind it is faster, as far as the path's bends let it, and as time is
        certain. It alone leads where the path slows down to rest, or to go back: a robot that
        stands there is at no place of a target that brakes, and near two legs at once.
        """
        at = now.acts_at
        place = at
        if math.isfinite(self._place):
            place = self._place + self._rate * (at - self._acted_at)
        leg = int(np.searchsorted(self._legs, place, side="right"))
        (aim,) = self._aims_at(np.array([place]), now.driver.slip)
        dx = start.x - aim[0]
        dy = start.y - aim[1]
        along = dx * math.cos(aim[2]) + dy * math.sin(aim[2])
        braking = np.any((self._brakes <= place) & (place < self._rests))
        step = 0.0 if braking else along * aim[3] / (aim[3] ** 2 + _CLOCK_SPEED**2)
        step *= self._mission.period / _PLACE_TIME
        place += min(max(step, -_JUMP), _JUMP)
        place = min(max(place, float(self._legs[leg - 1])), float(self._legs[leg]))
        self._place = place
        self._acted_at = at
        bend = float(np.abs(self._mission.preview(place + self._edges)[:, 4]).max())
        hurry = min(max((at - place) * self._fastest / _BEHIND - 1.0, 0.0), 1.0)
        trust = min(_CERTAIN / self.spread, 1.0)
        trust += hurry * (1.0 - trust)
        spare = max(1.0 - (self.spread / _CERTAIN) ** 2, 0.0)
        room = (1.0 + _HASTE * spare) * trust * self._bend / max(bend, 1e-9)
        most = min(max(room, _SLOWEST_RATE), 1.0 + _HASTE * trust)
        self._rate = min(max(1.0 + (at - place) / _CATCH_TIME, _SLOWEST_RATE), most)
        return place + self._rate * self._edges

    def command(self, now: ControllerInput) -> tuple[float, float]:
        """Return the first command of the best plan."""
        driver = now.driver
        # Plans are of the robot's point that never moves aside. For its middle, turning to where
        # it has to go would first lead away from there, and standing still would seem best.
        x = now.ahead.x - driver.slip * math.cos(now.ahead.yaw)
        y = now.ahead.y - driver.slip * math.sin(now.ahead.yaw)
        start = now.ahead._replace(x=x, y=y)
        times = self._follow_path(now, start)
        share = (now.acts_at - now.seen_at) / (self._mission.dead_time + self.margin)
        self._predicted.append((now.acts_at, now.ahead.yaw, now.ahead.w**2 * share))
        aims = self._aims_at(times, driver.slip)[:, :3]
        dx, dy, turns = np.diff(aims, axis=0).T
        headings = aims[1:, 2]
        ways = dx * np.cos(headings) + dy * np.sin(headings)
        speeds = np.column_stack([ways, turns]) / self._lengths[:, None]
        steady = speeds * self._steady / (driver.gain_v, driver.gain_w)
        steady = np.clip(steady, -self._limits, self._limits)
        plan = steady[1:]
        if self._plan is not None:  # the last one, one period later: of each long step half is over
            later = np.vstack([self._plan[1:], self._plan[-1:]])
            middles = 0.5 * (later[:-1] + later[1:])
            plan = np.vstack([later[:1], middles])
        motion = _planned_motion(start, driver, plan, self._model)
        last = now.past[-1]
        doubts = (self.spread / self._lengths[1:]) ** 2
        h, f = _condense_plan(
            motion, plan, aims[2:], steady, last, gains=self._gains, doubts=doubts
        )
        before = np.clip(last, -self._limits, self._limits)
        self._plan = self._solve(h, f, plan, before)
        return float(self._plan[0, 0]), float(self._plan[0, 1])

    def _aims_at(self, times: FloatArray, slip: float) -> FloatArray:
        """Return (n, 5) the targets at (n,) path times [s] of the point that never moves aside.

        It is `slip` [m] behind the robot's middle. So with the middle on the path the robot goes
        round bends at an angle, and begins to turn before them: by theta' = (phi - theta) / slip
        per way, whose bounded solution is a mean of the path's headings phi from here on. They are
        averaged over `_HEADING_TIME` and twice that distance, as far as the path goes on. Columns
        are those of `Mission.preview`.
        """
        aims = self._mission.preview(times)
        reach = -2.0 * slip * np.sign(aims[:, 3])
        half = 0.5 * _HEADING_TIME
        places = np.interp([times - half, times + half], self._stamps, self._ways)
        places += np.minimum(reach, 0.0), np.maximum(reach, 0.0)
        stretch = np.searchsorted(self._stretches, times, side="right")
        begin, end = places.clip(self._bounds[stretch - 1], self._bounds[stretch])
        first, last = np.interp([begin, end], self._ways, self._turned_on_way)
        way = end - begin
        np.divide(last - first, way, out=aims[:, 2], where=way > _STANDS)
        directions = np.column_stack([np.cos(aims[:, 2]), np.sin(aims[:, 2])])
        aims[:, :2] -= (self._mission.lookahead + slip) * directions
        return aims

    def _solve(
        self, h: FloatArray, f: FloatArray, plan: FloatArray, before: FloatArray
    ) -> FloatArray:
        """Return the (N, 2) commands that solve the program.

        Where the solver fails they are those of `plan`, within the limits. `before` is the
        (2,) command before the plan.
        """
        upper = self._changes.copy()
        lower = -self._changes
        upper[0] += before
        lower[0] += before
        box = np.tile(self._limits, len(plan))
        above = np.concatenate([box, upper.ravel()])
        below = np.concatenate([-box, lower.ravel()])
        if self._plan is None:
            senses = np.zeros(len(above), dtype=np.int32)
            self._solver.setup(h, f, self._steps, above, below, sense=senses)
        else:
            self._solver.update(H=h, f=f, bupper=above, blower=below)
        solution, _, flag, _ = self._solver.solve()
        if flag > 0 and np.isfinite(solution).all():
            commands = np.asarray(solution, dtype=np.float64).reshape(-1, 2)
            return commands.clip(-self._limits, self._limits)
        self.failures += 1
        kept = plan.copy()
        first = np.clip(kept[0], lower[0], upper[0])
        kept[0] = np.clip(first, -self._limits, self._limits)
        return kept


LAW = Law(
    "mpc",
    MpcGains,
    searched=("q_along", "q_across", "q_heading", "r_v", "r_w", "d_v", "d_w"),
    population=24,
    generations=20,
    make=Mpc,
    manoeuvres=(REVERSAL, SPOT_TURN),
)
