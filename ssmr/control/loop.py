"""A trajectory tracker around a plant: its settings, its clock and noise, and the run that it leaves.

`run_loop` is the slow and obvious closed loop that drives any `Plant`; the fused loops of `ssmr.control.population` and the
batches of MuJoCo robots must equal it, and share its tick.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np

from ssmr._jit import jit_alone, named_like
from ssmr.control.laws import Controller
from ssmr.control.mission import PythonController
from ssmr.control.predictor import NO_FORESIGHT, commands_under_way, new_pipe
from ssmr.control.tick import (
    FRESH_MIND,
    LOG_COLUMNS,
    LOST,
    NO_DRAWS,
    NO_ERRORS,
    SPINNING,
    Draws,
    Tracker,
    Truth,
    is_lost,
    tick,
)
from ssmr.control.waypoints import Waypoints
from ssmr.errors import SsmrError
from ssmr.estimation.ekf import initial_belief
from ssmr.estimation.settings import NO_NUMBERS, Belief, EkfSettings
from ssmr.parameters import require_in_range
from ssmr.robot.drive import whole_steps
from ssmr.robot.sensors import SensorModel, SensorNoise, yaw_disturbance
from ssmr.types import FloatArray, Plant, State, Trajectory

Feedback = Literal["truth", "noisy", "ekf"]

POSITION_PERIOD = 0.008
"""Period of the position loop [s]: 120 Hz as Tab. 3.5 rounds it."""
VELOCITY_PERIOD = 0.05
"""Period of the velocity loop and of commands [s]: 20 Hz."""


class LostError(SsmrError):
    """A loop left its bounds; evidence: `t` [s], `state`, `run` up to then."""


@dataclass(frozen=True)
class LoopSettings:
    """Feedback, noise, disturbance and periods of a closed loop."""

    feedback: Feedback = "noisy"
    """Signal that the controller sees: the `truth`, the truth with the filter's `noisy` output (Tab. 3.4), or an `ekf` on
    noisy encoders and gyro."""
    noise: SensorNoise = field(default_factory=SensorNoise)
    """Noise of the `noisy` feedback."""
    sensors: SensorModel = field(default_factory=SensorModel)
    """Encoders and gyro of the EKF."""
    filter: EkfSettings = field(default_factory=EkfSettings)
    """Settings of the EKF."""
    disturbance: bool = True
    """Push the yaw at random (Sec. 3.4.5)."""
    lookahead: float = 0.0
    """Distance at which the robot keeps behind its target [m] (Sec. 4.5)."""
    position_period: float = POSITION_PERIOD
    """Period of the position loop [s]."""
    velocity_period: float = VELOCITY_PERIOD
    """Period of the velocity loop and of commands [s]."""

    def __post_init__(self) -> None:
        """Raise a ValueError for an unknown feedback, a negative look-ahead, or periods that are not positive."""
        if self.feedback not in ("truth", "noisy", "ekf"):
            raise ValueError(f"unknown feedback '{self.feedback}'; there are: truth, noisy, ekf")
        require_in_range(self, "lookahead", 0.0, LOST / 2.0)
        for name in ("position_period", "velocity_period"):
            require_in_range(self, name, 0.0, 10.0, open_low=True)

    def deviations(self) -> Draws:
        """Return the standard deviations of the feedback and of the sensors, zero where there is no noise."""
        n, (wheel, gyro, *_) = self.noise, self.sensors.packed()
        noisy = np.sqrt([n.x, n.y, n.yaw, n.v_x, n.yaw_rate]) * (self.feedback == "noisy")
        x, y, yaw, v, w = map(float, noisy)
        return Draws(x, y, yaw, v, w, wheel, wheel, gyro)


@dataclass(frozen=True)
class Clock:
    """The division of a mission into physics steps."""

    dt: float
    """Physics step [s]."""
    position: int
    """Steps of the position loop's period."""
    velocity: int
    """Steps of the velocity loop's period."""
    n: int
    """Steps of the whole mission, a whole number of position periods."""

    @property
    def ticks(self) -> int:
        """Number of ticks of the position loop."""
        return 1 + self.n // self.position


def make_clock(waypoints: Waypoints, settings: LoopSettings, dt: float) -> Clock:
    """Return the clock of a mission, which ends with the first tick at or after the last waypoint's time (Alg. 5).

    Raises:
        ValueError: periods that are no whole number of steps.
    """
    position = whole_steps(settings.position_period, dt, "the position loop's period")
    velocity = whole_steps(settings.velocity_period, dt, "the velocity loop's period")
    return Clock(dt, position, velocity, position * max(1, math.ceil(waypoints.duration / (position * dt) - 1e-9)))


def draw(clock: Clock, settings: LoopSettings, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return random numbers of a run: (ticks, 8) standard normal ones, (n,) yaw accelerations [rad/s2], (1,) for none.

    They depend on the seed alone, so every plant and every controller meets the same noise.
    """
    noise, push = (np.random.default_rng([seed, k]) for k in range(2))
    draws = noise.standard_normal((clock.ticks, len(Draws._fields)))
    disturbance = yaw_disturbance(clock.n * clock.dt, clock.dt, push) if settings.disturbance else np.zeros(1)
    return draws, disturbance


def common_settings(settings: Sequence[LoopSettings], seeds: Sequence[int]) -> LoopSettings:
    """Return the settings of the first loop, which stand for what all loops of a population must share.

    Raises:
        ValueError: feedback, disturbance or periods differ, or there are no loops or no seeds.
    """
    if len(settings) == 0 or len(seeds) == 0:
        raise ValueError(f"a population has at least one loop and one seed, got {len(settings)} and {len(seeds)}")
    if len({(s.feedback, s.disturbance, s.position_period, s.velocity_period) for s in settings}) != 1:
        raise ValueError("a population has one kind of feedback, disturbance for all or for none, and one set of periods")
    return settings[0]


class Trackers(NamedTuple):
    """The robots' side of S closed loops along one reference, as arrays; see `Tracker` for the fields."""

    laws: Any
    gains: FloatArray
    predicts: Any
    foresights: FloatArray
    """(S, 16) numbers of the predictors."""
    pasts: FloatArray
    """(S, n, 2) commands that were sent."""
    pipes: FloatArray
    """(S, 16) the rest of the predictors' memories."""
    course: Any
    lookaheads: FloatArray
    by_filter: bool
    means: FloatArray
    """(S, n) means of the beliefs, n the 5 or 10 states of the filters; a parallel loop takes no nested tuples of arrays."""
    covariances: FloatArray
    """(S, n, n) covariances of the beliefs."""
    filters: FloatArray
    noises: FloatArray
    sensors: FloatArray
    position_steps: int
    velocity_steps: int
    dt: float


@jit_alone
def tracker_of(trackers: Trackers, i: int) -> Tracker:
    """Return the `Tracker` of loop `i`."""
    return Tracker(
        trackers.laws[i], trackers.gains[i], trackers.predicts[i], named_like(NO_FORESIGHT, trackers.foresights[i]),
        trackers.pasts[i], trackers.pipes[i], trackers.course, trackers.lookaheads[i], trackers.by_filter,
        Belief(trackers.means[i], trackers.covariances[i]), named_like(NO_NUMBERS, trackers.filters[i]),
        named_like(NO_DRAWS, trackers.noises[i]), named_like(NO_ERRORS, trackers.sensors[i]), trackers.position_steps,
        trackers.velocity_steps, trackers.dt,
    )  # fmt: skip


def make_trackers(
    controllers: Sequence[Controller | PythonController],
    settings: Sequence[LoopSettings],
    waypoints: Waypoints,
    clock: Clock,
    state: State,
) -> Trackers:
    """Return the robots' side of a population whose filters begin in `state`.

    Raises:
        ValueError: no regulator exists for a controller's weights.
    """
    rows, learns = [c.packed() for c in controllers], any(s.filter.learns for s in settings)
    beliefs = [initial_belief(state, settings=s.filter if learns else None) for s in settings]
    period = clock.velocity * clock.dt
    seers = [c.foresight(period) for c in controllers]
    gains = np.zeros((len(rows), max(map(len, rows))))
    for row, packed in zip(gains, rows, strict=True):
        row[: len(packed)] = packed
    return Trackers(
        np.array([c.number for c in controllers]),
        gains,
        np.array([c.predictor for c in controllers]),
        np.array(seers, dtype=np.float64),
        np.zeros((len(rows), max(map(commands_under_way, seers)), 2)),
        np.array([new_pipe(state, c.drive, period) for c in controllers], dtype=np.float64),
        waypoints.course(),
        np.array([s.lookahead for s in settings]),
        settings[0].feedback == "ekf",
        np.array([belief.mean for belief in beliefs]),
        np.array([belief.covariance for belief in beliefs]),
        np.array([s.filter.packed() for s in settings]),
        np.array([s.deviations() for s in settings]),
        np.array([s.sensors.packed() for s in settings]),
        clock.position,
        clock.velocity,
        clock.dt,
    )


class Batch(NamedTuple):
    """State of S closed loops whose robots something else moves; kernels write in place."""

    memories: FloatArray
    """(S, 8) memories of the laws."""
    segments: Any
    """(S,) segments of the targets."""
    asked: FloatArray
    """(S, 4) states of the drives."""
    commands: FloatArray
    """(S, 1 + n // velocity steps, 2) commands so far."""
    alive: Any
    """(S,) bool; the log of a robot that was lost grows no more."""
    logs: FloatArray
    """(S, ticks, 25) logs."""
    references: FloatArray
    """(S, steps, 2) wheel rates to ask for in the next period [rad/s]."""


@dataclass(frozen=True, eq=False)
class ClosedRun:
    """The log of a robot that followed a reference."""

    t: FloatArray
    """(M,) ticks of the position loop [s]."""
    table: FloatArray
    """(M, 25) the log, see `LOG_COLUMNS`."""
    lost: bool
    """True if the robot left its bounds at the last tick."""

    def column(self, name: str) -> FloatArray:
        """Return (M,) one of `LOG_COLUMNS`."""
        return np.asarray(self.table[:, LOG_COLUMNS.index(name)])

    def columns(self, *names: str) -> FloatArray:
        """Return (M, k) some of `LOG_COLUMNS`."""
        return np.asarray(self.table[:, [LOG_COLUMNS.index(name) for name in names]])

    @property
    def motion(self) -> Trajectory:
        """The true motion, with channel `torque_N_m` (M, 2)."""
        return Trajectory(
            self.t, self.table[:, :3], self.table[:, 3:6], self.table[:, 6:8], {"torque_N_m": self.table[:, 8:10]}
        )

    @property
    def state(self) -> State:
        """State of the robot at the last tick."""
        return State(*map(float, self.table[-1, :8]))

    def require_kept(self, what: str) -> ClosedRun:
        """Return the run itself.

        Raises:
            LostError: the robot was lost; the message says when and where.
        """
        if self.lost and not len(self.t):
            raise LostError(f"{what} was lost at once: its state or its command was no finite number", run=self)
        if self.lost:
            s, t = self.state, float(self.t[-1])
            away = math.hypot(*(self.columns("target_x", "target_y")[-1] - (s.x, s.y)))
            raise LostError(
                f"{what} left its bounds at t = {t:.2f} s: x = {s.x:.2f} m, y = {s.y:.2f} m, yaw = {s.yaw:.2f} rad, "
                f"v = {s.v_x:.2f} m/s, yaw rate = {s.yaw_rate:.2f} rad/s, {away:.2f} m from its target "
                f"(bounds: {LOST:g} m, {SPINNING:g} rad/s)",
                t=t,
                state=s,
                run=self,
            )
        return self


def closed_run(rows: FloatArray, clock: Clock) -> ClosedRun:
    """Return a loop's log as a run; a last row that is not finite is left out."""
    end = dict(zip(LOG_COLUMNS, rows[-1], strict=True))
    left = is_lost(end["x"], end["y"], end["yaw_rate"], end["target_x"], end["target_y"])
    finite = np.isfinite(rows).all(axis=1)
    kept = rows[: len(rows) if finite.all() else int(np.argmin(finite))]
    t = clock.position * clock.dt * np.arange(len(kept), dtype=np.float64)
    return ClosedRun(t, kept, len(rows) < clock.ticks or bool(left))


def true_state(state: State, torques: tuple[float, float] = (0.0, 0.0)) -> Truth:
    """Return a plant's state and its sides' torques [N m] as the tick takes them."""
    s = state
    numbers = (s.x, s.y, s.yaw, s.v_x, s.v_y, s.yaw_rate, s.wheel_left, s.wheel_right, *torques)
    return Truth(*map(float, numbers))


def run_loop(
    plant: Plant, controller: Controller, waypoints: Waypoints, settings: LoopSettings, seed: int, start: State | None = None
) -> ClosedRun:
    """Drive any plant along a reference, physics step by physics step. The fused loops must equal this slow one.

    Torques are not recorded: a plant does not tell them step by step.

    Args:
        plant: the plant; its own drive stands between command and wheels.
        controller: the law.
        waypoints: the reference.
        settings: feedback, noise and periods.
        seed: seed of noise and disturbance.
        start: state to start in; at rest at the first waypoint if not given.

    Raises:
        ValueError: periods that are no whole number of the plant's steps.
    """
    clock = make_clock(waypoints, settings, plant.dt)
    draws, disturbance = draw(clock, settings, seed)
    state = plant.reset(start or waypoints.start)
    tracker = tracker_of(make_trackers([controller], [settings], waypoints, clock, state), 0)
    mind, log = FRESH_MIND, np.empty((clock.ticks, len(LOG_COLUMNS)))
    for k in range(clock.n + 1):
        if k % clock.position == 0 or k % clock.velocity == 0:
            mind, lost = tick(tracker, mind, k, true_state(state), draws, log)
            if lost:
                return closed_run(log[: 1 + k // clock.position], clock)
        if k < clock.n:
            state = plant.step(mind.command, clock.dt, float(disturbance[k % len(disturbance)]))
    return closed_run(log, clock)
