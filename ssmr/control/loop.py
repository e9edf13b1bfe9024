"""A trajectory tracker around a plant: settings, clock, noise, the robot's side, and the run.

`run_loop` is the slow and obvious closed loop that drives any `Plant`; the compiled loops of
`ssmr.control.population` and the batches of MuJoCo robots must equal it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from ssmr.control.law import Command, Observation
from ssmr.control.laws import AnyController
from ssmr.control.mission import ControllerInput, Mission, PythonController
from ssmr.control.predictor import (
    commands_under_way,
    predict_ahead,
    predictor_model,
    predictor_start,
    remember_command,
)
from ssmr.control.tick import (
    DRAWS,
    INITIAL_STATE,
    LOG_COLUMNS,
    LOST,
    SPINNING,
    Clock,
    LoopState,
    Tracker,
    is_lost,
    observe_truth,
    position_tick,
    record_tick,
    take_observation,
    velocity_tick,
)
from ssmr.control.waypoints import Waypoints
from ssmr.errors import ControllerError, SsmrError
from ssmr.estimation.ekf import initial_belief
from ssmr.estimation.settings import EkfSettings
from ssmr.parameters import pack_numbers, require_in_range, require_one_of
from ssmr.robot.drive import whole_steps
from ssmr.robot.sensors import SensorModel, SensorNoise, yaw_disturbance
from ssmr.types import FloatArray, Motion, Plant, State, Trajectory

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
    """Signal that the controller sees: the `truth`, the truth with the filter's `noisy` output
    (Tab. 3.4), or an `ekf` on noisy encoders and gyro."""
    noise: SensorNoise = field(default_factory=SensorNoise)
    """Noise of the `noisy` feedback."""
    sensors: SensorModel = field(default_factory=SensorModel)
    """Encoders and gyro of the EKF."""
    filter: EkfSettings = field(default_factory=EkfSettings)
    """Settings of the EKF."""
    standing: float = 10.0
    """Time for which the robot stands before it starts [s]. The gyro's mean reading in it is the
    bias that the EKF takes off; with 0 it is that of `filter`."""
    disturbance: bool = True
    """Push the yaw at random (Sec. 3.4.5)."""
    lookahead: float = 0.0
    """Distance at which the robot keeps behind its target [m] (Sec. 4.5)."""
    rest: float = 0.0
    """Time for which the run goes on after the reference's end, where the target stands [s]."""
    position_period: float = POSITION_PERIOD
    """Period of the position loop [s]."""
    velocity_period: float = VELOCITY_PERIOD
    """Period of the velocity loop and of commands [s]."""

    def __post_init__(self) -> None:
        """Raise a ValueError for an unknown feedback, or a look-ahead or period out of range."""
        feedbacks = ("truth", "noisy", "ekf")
        require_one_of(self.feedback, feedbacks, f"unknown feedback '{self.feedback}'")
        require_in_range(self, "lookahead", 0.0, LOST / 2.0)
        require_in_range(self, "rest", 0.0, 60.0)
        require_in_range(self, "standing", 0.0, 3600.0)
        for name in ("position_period", "velocity_period"):
            require_in_range(self, name, 0.0, 10.0, open_low=True)

    def deviations(self) -> Observation:
        """Return the standard deviations of the feedback, zero where there is no noise."""
        n = self.noise
        stds = np.sqrt([n.x, n.y, n.yaw, n.v_x, n.yaw_rate])
        return Observation(*map(float, stds * (self.feedback == "noisy")))

    def filter_at_start(self, seed: int) -> EkfSettings:
        """Return the settings of the EKF after the rest before the start; `seed` is the run's.

        The mean of n readings of white noise, one every position period, has an n-th of their
        variance, and is drawn as such.
        """
        n = round(self.standing / self.position_period)
        if n == 0:
            return self.filter
        drawn = np.random.default_rng([seed, 2]).standard_normal()
        error = math.sqrt(self.sensors.variance_gyro / n) * drawn
        return replace(self.filter, gyro_bias=self.sensors.gyro_bias + float(error))


def make_clock(waypoints: Waypoints, settings: LoopSettings, dt: float) -> Clock:
    """Return the clock of a mission.

    It ends with the first tick at or after the last waypoint's time (Alg. 5), and the time of rest
    behind it.

    Raises:
        ValueError: periods that are no whole number of steps.
    """
    position = whole_steps(settings.position_period, dt, "the position loop's period")
    velocity = whole_steps(settings.velocity_period, dt, "the velocity loop's period")
    duration = waypoints.duration + settings.rest
    periods = math.ceil(duration / (position * dt) - 1e-9)
    return Clock(dt, position, velocity, position * max(1, periods))


def draw_noise(clock: Clock, settings: LoopSettings, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return random numbers of a run: (ticks, 8) standard normal ones, (n,) yaw accelerations.

    The latter [rad/s2] are (1,) zero if there is no disturbance. The numbers depend on the seed
    alone, so every plant and every controller meets the same noise.
    """
    noise, push = (np.random.default_rng([seed, k]) for k in range(2))
    draws = noise.standard_normal((clock.ticks, DRAWS))
    if not settings.disturbance:
        return draws, np.zeros(1)
    return draws, yaw_disturbance(clock.n * clock.dt, clock.dt, push)


def common_settings(settings: Sequence[LoopSettings], seeds: Sequence[int]) -> LoopSettings:
    """Return the settings of the first loop, which hold for all where a population must agree.

    Raises:
        ValueError: feedback, disturbance or periods differ, or there are no loops or no seeds.
    """
    if len(settings) == 0 or len(seeds) == 0:
        counts = f"{len(settings)} and {len(seeds)}"
        raise ValueError(f"a population has at least one loop and one seed, got {counts}")
    common = {(s.feedback, s.disturbance, s.position_period, s.velocity_period) for s in settings}
    if len(common) != 1:
        raise ValueError(
            "a population has one kind of feedback, disturbance for all or for none, "
            "and one set of periods"
        )
    return settings[0]


def make_trackers(
    controllers: Sequence[AnyController],
    settings: Sequence[LoopSettings],
    waypoints: Waypoints,
    clock: Clock,
    state: State,
    seeds: Sequence[int] = (0,),
) -> list[Tracker]:
    """Return the robots' side of closed loops whose filters begin in `state`.

    `seeds` are taken in turn; they draw what the filters took for the gyro's bias.

    Raises:
        ValueError: no regulator exists for a controller's weights, or a robot shall keep behind a
            target that drives backwards.
    """
    if any(around.lookahead for around in settings) and waypoints.backwards.any():
        raise ValueError(
            "lookahead keeps the robot behind its target, which is ahead of it where it is driven "
            "backwards; leave it out on this path"
        )
    period = clock.velocity * clock.dt
    course = waypoints.course()
    models = []
    for law in controllers:
        a = np.array(law.a)
        models.append(predictor_model(a, np.array(law.b), law.drive, period))
    most = max(map(commands_under_way, models))
    trackers = []
    for i, (law, around, model) in enumerate(zip(controllers, settings, models, strict=True)):
        tracker = Tracker(
            law=law.number,
            gains=law.packed().copy(),
            predicts=law.predictor,
            predictor=model,
            past=np.zeros((most, 2)),
            predictor_state=predictor_start(state, law.drive, period),
            course=course,
            lookahead=float(around.lookahead),
            by_filter=around.feedback == "ekf",
            belief=initial_belief(state),
            filter=around.filter_at_start(seeds[i % len(seeds)]).packed(),
            noise=around.deviations(),
            sensors=pack_numbers(around.sensors),
            clock=clock,
        )
        trackers.append(tracker)
    return trackers


class _RobotSide:
    """The robot's side of one closed loop: a compiled law, its memory and observations."""

    def __init__(self, tracker: Tracker) -> None:
        """Begin with a law that has not run yet."""
        self.tracker = tracker
        self.state: LoopState = INITIAL_STATE

    def position_tick(self, seen: Observation, t: float, dt: float) -> None:
        """Take an observation of mission time `t` [s], `dt` [s] after the last."""
        self.state = position_tick(self.tracker, self.state, seen, t, dt)

    def velocity_tick(self, t: float, dt: float) -> None:
        """Compute the command of mission time `t` [s], `dt` [s] after the last."""
        self.state = velocity_tick(self.tracker, self.state, t, dt)

    def tick(self, k: int, truth: Motion, draws: FloatArray, log: FloatArray) -> bool:
        """Run the loops that are due at physics step `k`, and log; return whether it is lost."""
        tracker = self.tracker
        clock = tracker.clock
        t = k * clock.dt
        due = k % clock.position == 0
        if due:
            seen = observe_truth(tracker, k, truth, draws)
            self.position_tick(seen, t, clock.position * clock.dt)
        if k % clock.velocity == 0:
            self.velocity_tick(t, clock.velocity * clock.dt)
        if not due:
            return False
        record_tick(log[k // clock.position], truth, self.state, tracker)
        aim = self.state.target
        return is_lost(truth.x, truth.y, truth.w, aim.x, aim.y)


class PythonSide(_RobotSide):
    """The robot's side of one closed loop whose controller is a Python object.

    A tick costs tens of microseconds.
    """

    def __init__(self, tracker: Tracker, controller: PythonController, mission: Mission) -> None:
        """Make the controller's object."""
        self._name = controller.name
        self._seen_at = 0.0
        self._object: Any = controller.make(mission)
        model = tracker.predictor._replace(margin=getattr(self._object, "margin", 0.0))
        super().__init__(tracker._replace(predictor=model))
        self._observe = getattr(self._object, "observe", None)

    def _input(self, t: float) -> ControllerInput:
        state = self.state
        past = self.tracker.past
        model = self.tracker.predictor
        memory = self.tracker.predictor_state
        seen = state.seen
        ahead, driver, acts_at = predict_ahead(past, memory, seen, self._seen_at, t, model)
        return ControllerInput(
            t=t,
            seen_at=self._seen_at,
            seen=state.seen,
            target=state.target,
            errors=state.errors,
            ahead=ahead,
            acts_at=acts_at,
            driver=driver,
            past=past.copy(),
        )

    def position_tick(self, seen: Observation, t: float, dt: float) -> None:
        """Take an observation of mission time `t` [s]."""
        self.state = take_observation(self.tracker, self.state, seen, t)
        self._seen_at = t
        now = self._input(t)  # the predictor learns from every observation
        if self._observe is not None:
            self._observe(now)

    def velocity_tick(self, t: float, dt: float) -> None:
        """Ask for the command of mission time `t` [s].

        Raises:
            ControllerError: the answer is no pair of finite numbers.
        """
        given = self._object.command(self._input(t))
        try:
            v, w = map(float, given)
        except (TypeError, ValueError):
            raise ControllerError(
                f"{self._name} commands {given!r:.60}, wanted speed and yaw rate, two numbers"
            ) from None
        if not (math.isfinite(v) and math.isfinite(w)):
            raise ControllerError(
                f"{self._name} commands {v:g} m/s and {w:g} rad/s at t = {t:.2f} s, "
                "wanted finite numbers"
            )
        memory = self.state.memory._replace(u_ref=v, w_ref=w)
        self.state = self.state._replace(memory=memory, command=Command(v, w))
        remember_command(self.tracker.past, self.tracker.predictor_state, v, w, t)


def robot_sides(
    controllers: Sequence[AnyController],
    settings: Sequence[LoopSettings],
    waypoints: Waypoints,
    trackers: Sequence[Tracker],
) -> list[_RobotSide]:
    """Return the robot's side of each loop, with the `trackers` of `make_trackers`.

    Raises:
        ControllerError: a Python object cannot be made.
    """
    sides: list[_RobotSide] = []
    for law, around, tracker in zip(controllers, settings, trackers, strict=True):
        if not isinstance(law, PythonController):
            sides.append(_RobotSide(tracker))
            continue
        mission = Mission(
            waypoints,
            law.drive,
            law.a,
            law.b,
            period=around.velocity_period,
            position_period=around.position_period,
            lookahead=around.lookahead,
        )
        sides.append(PythonSide(tracker, law, mission))
    return sides


@dataclass(frozen=True, eq=False)
class ClosedRun:
    """The log of a robot that followed a reference."""

    t: FloatArray
    """(M,) ticks of the position loop [s]."""
    table: FloatArray
    """(M, 26) the log, see `LOG_COLUMNS`."""
    lost: bool
    """True if the robot left its bounds at the last tick."""

    def column(self, name: str) -> FloatArray:
        """Return (M,) one of `LOG_COLUMNS`."""
        return np.asarray(self.table[:, LOG_COLUMNS.index(name)])

    def columns(self, *names: str) -> FloatArray:
        """Return (M, k) some of `LOG_COLUMNS`."""
        places = [LOG_COLUMNS.index(name) for name in names]
        return np.asarray(self.table[:, places])

    def until(self, end: float) -> ClosedRun:
        """Return the run up to its first tick at or after the time `end` [s]."""
        ticks = 1 + int(np.searchsorted(self.t, end - 1e-9))
        if ticks >= len(self.t):
            return self
        return ClosedRun(self.t[:ticks], self.table[:ticks], lost=False)

    @property
    def motion(self) -> Trajectory:
        """The true motion, with channel `torque_N_m` (M, 2)."""
        pose = self.table[:, :3]
        twist = self.table[:, 3:6]
        wheels = self.table[:, 6:8]
        return Trajectory(self.t, pose, twist, wheels, {"torque_N_m": self.table[:, 8:10]})

    @property
    def state(self) -> State:
        """State of the robot at the last tick."""
        return State(*map(float, self.table[-1, :8]))

    def require_complete(self, what: str) -> ClosedRun:
        """Return the run itself.

        Raises:
            LostError: the robot was lost; the message says when and where.
        """
        if not self.lost:
            return self
        if not len(self.t):
            reason = "its state or its command was no finite number"
            raise LostError(f"{what} was lost at once: {reason}", run=self)
        s = self.state
        t = float(self.t[-1])
        target_x, target_y = self.columns("target_x", "target_y")[-1]
        away = math.hypot(target_x - s.x, target_y - s.y)
        raise LostError(
            f"{what} left its bounds at t = {t:.2f} s: "
            f"x = {s.x:.2f} m, y = {s.y:.2f} m, yaw = {s.yaw:.2f} rad, "
            f"v = {s.v_x:.2f} m/s, yaw rate = {s.yaw_rate:.2f} rad/s, {away:.2f} m from its target "
            f"(bounds: {LOST:g} m, {SPINNING:g} rad/s)",
            t=t,
            state=s,
            run=self,
        )


def closed_run(rows: FloatArray, clock: Clock) -> ClosedRun:
    """Return a loop's log as a run; a last row that is not finite is left out."""
    end = dict(zip(LOG_COLUMNS, rows[-1], strict=True))
    left = is_lost(end["x"], end["y"], end["yaw_rate"], end["target_x"], end["target_y"])
    finite = np.isfinite(rows).all(axis=1)
    count = len(rows) if finite.all() else int(np.argmin(finite))
    t = clock.position * clock.dt * np.arange(count, dtype=np.float64)
    return ClosedRun(t, rows[:count], len(rows) < clock.ticks or bool(left))


def run_loop(
    plant: Plant,
    controller: AnyController,
    waypoints: Waypoints,
    settings: LoopSettings,
    seed: int,
    start: State | None = None,
) -> ClosedRun:
    """Drive any plant along a reference, physics step by physics step.

    The compiled loops must equal this slow one. The plant's own drive stands between command and
    wheels. Torques are not recorded: a plant's state has none. The run begins in `start`, or at
    rest at the first waypoint; `seed` is that of noise and disturbance.

    Raises:
        ValueError: periods that are no whole number of the plant's steps.
    """
    clock = make_clock(waypoints, settings, plant.dt)
    draws, disturbance = draw_noise(clock, settings, seed)
    state = plant.reset(start or waypoints.start)
    trackers = make_trackers([controller], [settings], waypoints, clock, state, [seed])
    (side,) = robot_sides([controller], [settings], waypoints, trackers)
    log = np.empty((clock.ticks, len(LOG_COLUMNS)))
    for k in range(clock.n + 1):
        if k % clock.position == 0 or k % clock.velocity == 0:
            truth = state.motion
            if side.tick(k, truth, draws, log):
                return closed_run(log[: 1 + k // clock.position], clock)
        if k < clock.n:
            push = float(disturbance[k % len(disturbance)])
            state = plant.step(side.state.command, clock.dt, push)
    return closed_run(log, clock)
