"""A trajectory tracker around a plant: many rates, one clock (Sec. 3.4.4-3.4.6, 4.3.2, Fig. 4.9, 4.26).

At the rate of the position loop the robot is observed and the errors to the moving target become reference velocities; at
the rate at which the robot reads commands these become a command, which the drive turns into wheel rates. `observe`,
`position_tick` and `velocity_step` are the robot's side of it, the same for every plant: the fused loop of the planar models
here, populations of MuJoCo Huskies, and `track`, the slow and obvious loop that drives any `Plant`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numba
import numpy as np

from ssmr._jit import jit, jit_parallel, named_like
from ssmr.control.laws import MEMORY, Controller, position_step, velocity_step
from ssmr.control.waypoints import ALPHA_SWITCH, Waypoints, position_errors, target
from ssmr.errors import SsmrError
from ssmr.estimation import ekf
from ssmr.parameters import require_in_range
from ssmr.robot.drive import DRIVE_TEMPLATE, Driven, Sides, drive_numbers, follow, rolling, whole_steps
from ssmr.robot.sensors import SensorNoise, yaw_disturbance
from ssmr.simulate import PLANAR_DT, PlanarModel, PlanarMotion, move, robot_from_row, robot_row, turning_wheels
from ssmr.types import FloatArray, Plant, State, Trajectory

Feedback = Literal["truth", "noisy", "ekf"]

POSITION_PERIOD = 0.008
"""Period of the position loop [s]: 120 Hz as Tab. 3.5 rounds it."""
VELOCITY_PERIOD = 0.05
"""Period of the velocity loop and of commands [s]: 20 Hz."""
LOST = 3.0
"""A robot farther from its target than this has lost it, and the run ends [m]."""
SPINNING = 20.0
"""A yaw rate beyond this is no robot's any more [rad/s]."""
DRAWS = 8
"""Random numbers of an observation: noise of x, y, yaw, v, omega, then of left wheels, right wheels and gyro."""
COLUMNS = (
    *("x", "y", "yaw", "v_x", "v_y", "yaw_rate", "wheel_left", "wheel_right", "torque_left", "torque_right"),
    *("target_x", "target_y", "target_yaw", "e_rho", "e_y", "e_alpha", "u_ref", "w_ref", "v_cmd", "w_cmd"),
    *("seen_x", "seen_y", "seen_yaw", "seen_v", "seen_w"),
)
"""What a run records at every tick of the position loop."""


class LostError(SsmrError):
    """A loop left its bounds; evidence: `t` [s], `state`, `run` up to then."""


@dataclass(frozen=True)
class LoopSettings:
    """What stands around controller and plant."""

    feedback: Feedback = "noisy"
    """What the controller sees: the `truth`, the truth with the filter's `noisy` output (Tab. 3.4), or an `ekf` run on noisy
    encoders and gyro."""
    noise: SensorNoise = field(default_factory=SensorNoise)
    """Of the noisy feedback."""
    sensors: ekf.SensorModel = field(default_factory=ekf.SensorModel)
    """Of the EKF's encoders and gyro."""
    filter: ekf.EkfSettings = field(default_factory=ekf.EkfSettings)
    """Of the EKF."""
    disturbance: bool = True
    """Push the yaw at random (Sec. 3.4.5)."""
    lookahead: float = 0.0
    """The distance at which the robot is told to keep behind its target [m] (Sec. 4.5)."""
    position_period: float = POSITION_PERIOD
    """[s]"""
    velocity_period: float = VELOCITY_PERIOD
    """[s]"""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            ValueError: an unknown feedback, a negative look-ahead, periods that are not positive.
        """
        if self.feedback not in ("truth", "noisy", "ekf"):
            raise ValueError(f"unknown feedback '{self.feedback}'; there are: truth, noisy, ekf")
        require_in_range(self, "lookahead", 0.0, LOST / 2.0)
        for name in ("position_period", "velocity_period"):
            require_in_range(self, name, 0.0, 10.0, open_low=True)

    def deviations(self) -> FloatArray:
        """(9,) what draws are multiplied with: five of the noise, then of the sensors, last the gyro's bias."""
        n = self.noise
        scale = np.sqrt([n.x, n.y, n.yaw, n.v_x, n.yaw_rate]) * (self.feedback == "noisy")
        wheel, gyro, bias = self.sensors.packed()
        return np.array([*scale, wheel, wheel, gyro, bias])


@jit
def observe(by_filter, memory, numbers, deviations, draws, x, y, yaw, v, w, left, right, dt):
    """What the controller sees: x, y, yaw, v, omega. The filter's memory, (30,), advances in place by `dt`."""
    if by_filter:
        rates = (deviations[5], deviations[7], deviations[8])
        seen = ekf.sense(left, right, w, (draws[5], draws[6], draws[7]), rates)
        ekf.filter_step(memory, seen[0], seen[1], seen[2], dt, numbers)
        return memory[0], memory[1], memory[2], memory[3], memory[4]
    return (
        x + deviations[0] * draws[0],
        y + deviations[1] * draws[1],
        yaw + deviations[2] * draws[2],
        v + deviations[3] * draws[3],
        w + deviations[4] * draws[4],
    )


@jit
def position_tick(law, gains, memory, table, index, t, seen, lookahead, dt):
    """One tick of the position loop.

    Args:
        law: `Controller.number`.
        gains: `Controller.packed()`.
        memory: eight numbers of the law.
        table: `Waypoints.packed()`.
        index: segment of the last tick.
        t: mission time [s].
        seen: x, y, yaw, v, omega as the robot believes.
        lookahead: [m].
        dt: period [s].

    Returns:
        The law's memory, the segment, and x, y, phi of the target and the errors rho, y, alpha.
    """
    x_t, y_t, phi, v_ref, w_ref, index = target(table, t, index)
    e_rho, e_y, e_alpha = position_errors(seen[0], seen[1], seen[2], x_t, y_t, phi, ALPHA_SWITCH)
    memory = position_step(law, gains, memory, e_rho - lookahead, e_y, e_alpha, v_ref, w_ref, seen[3], seen[4], dt)
    return memory, index, (x_t, y_t, phi, e_rho, e_y, e_alpha)


@jit
def write_row(out, x, y, yaw, v, v_y, w, left, right, torque_left, torque_right, aim, memory, command, seen):
    """Record a tick in the order of `COLUMNS`."""
    out[0], out[1], out[2], out[3], out[4], out[5] = x, y, yaw, v, v_y, w
    out[6], out[7], out[8], out[9] = left, right, torque_left, torque_right
    for i in range(6):
        out[10 + i] = aim[i]
    out[16], out[17], out[18], out[19] = memory[5], memory[6], command[0], command[1]
    for i in range(5):
        out[20 + i] = seen[i]


@jit
def is_lost(x, y, yaw_rate, aim):
    """Whether a run left its bounds; a number that is not finite has."""
    return not (math.hypot(x - aim[0], y - aim[1]) < LOST and abs(yaw_rate) < SPINNING)


@jit
def run_closed_planar(
    law, gains, table, rates, lookahead, by_filter, belief, numbers, deviations, draws, disturbance, dt,
    drive, robot, start, commands, out,
):  # fmt: skip
    """A planar model in closed loop; writes (1 + n // rates[0], 25) `out`.

    Args:
        law: which law, and `gains`, `table`, `lookahead` as in `position_tick`.
        gains: of the law.
        table: of the reference.
        rates: physics steps of the position loop's and the velocity loop's period, and of the whole run.
        lookahead: [m].
        by_filter: whether the controller sees the EKF's opinion.
        belief: (30,) memory of the EKF; holds its end afterwards.
        numbers: of the EKF.
        deviations: (9,), see `LoopSettings.deviations`.
        draws: (at least as many as `out`, 8) standard normal numbers.
        disturbance: (n,) yaw accelerations [rad/s2], or (1,) for the same at every step.
        dt: physics step [s].
        drive: `DriveNumbers`; the command period is the velocity loop's.
        robot: `PlanarRobot`; the type of its parameters chooses the model.
        start: (7,) x, y, yaw, v, omega, left and right wheel rate.
        commands: (1 + n // rates[1], 2) space for what is commanded.
        out: space for what is recorded.

    Returns:
        How many ticks were recorded: fewer than `out` has where the robot was lost after the last of them.
    """
    now = PlanarMotion(start[0], start[1], start[2], start[3], start[4], 0.0, 0.0)
    asked = rolling(Sides(start[5], start[6]), drive)
    memory = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    seen = (now.x, now.y, now.yaw, now.v, now.w)
    index, tick = 0, 0
    command = (0.0, 0.0)
    for k in range(rates[2] + 1):
        left, right = turning_wheels(now, Sides(asked.left, asked.right), robot)
        due = k % rates[0] == 0
        if due:
            seen = observe(
                by_filter, belief, numbers, deviations, draws[tick], now.x, now.y, now.yaw, now.v, now.w,
                left, right, rates[0] * dt if k else 0.0,
            )  # fmt: skip
            memory, index, aim = position_tick(law, gains, memory, table, index, k * dt, seen, lookahead, rates[0] * dt)
        if k % rates[1] == 0:
            memory, v_cmd, w_cmd = velocity_step(law, gains, memory, seen[3], seen[4], rates[1] * dt)
            command = (v_cmd, w_cmd)
            commands[k // rates[1], 0], commands[k // rates[1], 1] = v_cmd, w_cmd
        if due:
            write_row(
                out[tick], now.x, now.y, now.yaw, now.v, -robot.x_icr * now.w, now.w, left, right, now.torque_left,
                now.torque_right, aim, memory, command, seen,
            )  # fmt: skip
            tick += 1
            if is_lost(now.x, now.y, now.w, aim):
                return tick
        if k == rates[2]:
            break
        asked = follow(commands, k, drive, (0.0, 0.0), asked)
        push = disturbance[k] if len(disturbance) > 1 else disturbance[0]
        now = move(now, Sides(asked.left, asked.right), push, dt, robot)
    return tick


@jit_parallel
def run_closed_planar_population(
    kind, laws, gains, table, rates, lookaheads, by_filter, beliefs, numbers, deviations, draws, disturbances, dt,
    drives, robots, start, ticks, outs,
):  # fmt: skip
    """Many closed loops at once, one a thread; `draws` and `disturbances` are taken in turn.

    `kind`, `drives` and `robots` as in `ssmr.simulate`.
    """
    for i in numba.prange(len(gains)):
        drive, robot = named_like(DRIVE_TEMPLATE, drives[i]), robot_from_row(kind, robots[i])
        commands = np.empty((1 + rates[2] // rates[1], 2))
        ticks[i] = run_closed_planar(
            laws[i], gains[i], table, rates, lookaheads[i], by_filter, beliefs[i], numbers[i], deviations[i],
            draws[i % len(draws)], disturbances[i % len(disturbances)], dt, drive, robot, start,
            commands, outs[i],
        )  # fmt: skip


@jit
def plan_chunks(
    tick, n, laws, gains, table, rates, lookaheads, by_filter, beliefs, numbers, deviations, draws, dt, drives,
    states, torques, memories, indices, asked, commands, alive, outs, references,
):  # fmt: skip
    """The robots' side of one period of the position loop, for robots that something else moves.

    What the wheels are asked for until the next tick depends on nothing that happens meanwhile, so the whole period is
    planned at once.

    Args:
        tick: which tick of the position loop.
        n: physics steps to plan, one period; 0 at the end of the mission.
        laws: (S,) and all that follows as in `run_closed_planar`, by robot.
        gains: (S, G).
        table: of the reference.
        rates: as there.
        lookaheads: (S,).
        by_filter: as there.
        beliefs: (S, 30), in place.
        numbers: (S, 9).
        deviations: (S, 9).
        draws: (D, ticks, 8), taken in turn.
        dt: physics step [s].
        drives: (S, 11) `DriveNumbers`.
        states: (S, 8) x, y, yaw, v_x, v_y, yaw rate, left and right wheel rate.
        torques: (S, 2) of the sides [N m].
        memories: (S, 8) of the laws, in place.
        indices: (S,) segments, in place.
        asked: (S, 4) of the drives, in place.
        commands: (S, 1 + rates[2] // rates[1], 2), in place.
        alive: (S,) bool, in place: robots that were lost are recorded no more.
        outs: (S, ticks, 25), in place.
        references: (S, n, 2), in place: what the wheels are asked for.
    """
    k = tick * rates[0]
    for i in range(len(laws)):
        if not alive[i]:
            continue
        s = states[i]
        period = rates[0] * dt
        seen = observe(
            by_filter, beliefs[i], numbers[i], deviations[i], draws[i % len(draws), tick], s[0], s[1], s[2], s[3], s[5],
            s[6], s[7], period if k else 0.0,
        )  # fmt: skip
        m = memories[i]
        memory, index, aim = position_tick(
            laws[i], gains[i], (m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7]), table, indices[i], k * dt, seen,
            lookaheads[i], period,
        )  # fmt: skip
        indices[i] = index
        drive, a = named_like(DRIVE_TEMPLATE, drives[i]), asked[i]
        now = Driven(a[0], a[1], a[2], a[3])
        for j in range(max(n, 1)):
            if (k + j) % rates[1] == 0:
                memory, v_cmd, w_cmd = velocity_step(laws[i], gains[i], memory, seen[3], seen[4], rates[1] * dt)
                row = (k + j) // rates[1]
                commands[i, row, 0], commands[i, row, 1] = v_cmd, w_cmd
            if j == 0:
                last = commands[i, k // rates[1]]
                write_row(
                    outs[i, tick], s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], torques[i, 0], torques[i, 1], aim, memory,
                    (last[0], last[1]), seen,
                )  # fmt: skip
                alive[i] = not is_lost(s[0], s[1], s[5], aim)
            if j < n:
                now = follow(commands[i], k + j, drive, (0.0, 0.0), now)
                references[i, j, 0], references[i, j, 1] = now.left, now.right
        for j in range(8):
            m[j] = memory[j]
        a[0], a[1], a[2], a[3] = now.v, now.w, now.left, now.right


@dataclass(frozen=True)
class Clock:
    """How a mission is cut into physics steps."""

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
        """How often the position loop runs."""
        return 1 + self.n // self.position


def make_clock(waypoints: Waypoints, settings: LoopSettings, dt: float) -> Clock:
    """The clock of a mission, which ends with the first tick at or after the last waypoint's time (Alg. 5).

    Raises:
        ValueError: periods that are no whole number of steps.
    """
    position = whole_steps(settings.position_period, dt, "the position loop's period")
    velocity = whole_steps(settings.velocity_period, dt, "the velocity loop's period")
    return Clock(dt, position, velocity, position * max(1, math.ceil(waypoints.duration / (position * dt) - 1e-9)))


def draw(clock: Clock, settings: LoopSettings, seed: int) -> tuple[FloatArray, FloatArray]:
    """The random numbers of a run: (ticks, 8) standard normal ones, and (n,) yaw accelerations [rad/s2], or (1,) none.

    They depend on the seed alone, so every plant and every controller meets the same noise.
    """
    noise, push = (np.random.default_rng([seed, k]) for k in range(2))
    draws = noise.standard_normal((clock.ticks, DRAWS))
    disturbance = yaw_disturbance(clock.n * clock.dt, clock.dt, push) if settings.disturbance else np.zeros(1)
    return draws, disturbance


def common_settings(settings: Sequence[LoopSettings], seeds: Sequence[int]) -> LoopSettings:
    """What all loops of a population share, and their clock and noise are made of; the first one's settings stand for it.

    Raises:
        ValueError: there is something that they do not share, or there are no loops or no seeds.
    """
    if len(settings) == 0 or len(seeds) == 0:
        raise ValueError(f"a population has at least one loop and one seed, got {len(settings)} and {len(seeds)}")
    if len({(s.feedback, s.disturbance, s.position_period, s.velocity_period) for s in settings}) != 1:
        raise ValueError("a population has one kind of feedback, disturbance for all or for none, and one set of periods")
    return settings[0]


@dataclass(frozen=True, eq=False)
class ClosedRun:
    """A robot that followed a reference."""

    t: FloatArray
    """(M,) ticks of the position loop [s]."""
    table: FloatArray
    """(M, 25) what was recorded, see `COLUMNS`."""
    lost: bool
    """Whether it left its bounds at the last tick."""

    def column(self, name: str) -> FloatArray:
        """(M,) one of `COLUMNS`."""
        return np.asarray(self.table[:, COLUMNS.index(name)])

    def columns(self, *names: str) -> FloatArray:
        """(M, k) some of `COLUMNS`."""
        return np.asarray(self.table[:, [COLUMNS.index(name) for name in names]])

    @property
    def motion(self) -> Trajectory:
        """The true motion, with channel `torque_N_m` (M, 2)."""
        return Trajectory(
            self.t, self.table[:, :3], self.table[:, 3:6], self.table[:, 6:8], {"torque_N_m": self.table[:, 8:10]}
        )

    @property
    def state(self) -> State:
        """Where it ended."""
        return State(*map(float, self.table[-1, :8]))

    def require_kept(self, what: str) -> ClosedRun:
        """The run itself.

        Raises:
            LostError: the robot was lost; the message says when and where.
        """
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


@dataclass(frozen=True)
class Loop:
    """One closed loop of a population: a controller around a planar model."""

    model: PlanarModel
    """The robot."""
    controller: Controller
    """The law."""
    settings: LoopSettings
    """What stands around them; feedback, disturbance and periods are the same throughout a population."""


def packed_laws(
    controllers: Sequence[Controller], settings: Sequence[LoopSettings], waypoints: Waypoints, clock: Clock, state: State
) -> tuple[object, ...]:
    """The robots' side of a population for the compiled loops, from `laws` to `deviations` in their order."""
    packs = [c.packed() for c in controllers]
    gains = np.zeros((len(packs), max(map(len, packs))))
    for row, g in zip(gains, packs, strict=True):
        row[: len(g)] = g
    return (
        np.array([c.number for c in controllers]),
        gains,
        waypoints.packed(),
        (clock.position, clock.velocity, clock.n),
        np.array([s.lookahead for s in settings]),
        settings[0].feedback == "ekf",
        np.array([ekf.initial_memory(state)] * len(settings)),
        np.array([s.filter.packed() for s in settings]),
        np.array([s.deviations() for s in settings]),
    )


def run_loops(
    loops: Sequence[Loop], waypoints: Waypoints, seeds: Sequence[int], dt: float = PLANAR_DT, start: State | None = None
) -> list[ClosedRun]:
    """Run many closed loops of one kind of planar model along one reference, one a thread.

    Args:
        loops: S of them.
        waypoints: what they follow.
        seeds: of noise and disturbance, taken in turn: loop i gets `seeds[i % len(seeds)]`.
        dt: physics step [s].
        start: where they start; the first waypoint, at rest, if not given.

    Raises:
        ValueError: several kinds of model, of feedback or disturbance, or sets of periods; periods that are no whole number
            of steps; no loops or no seeds.
    """
    settings = common_settings([p.settings for p in loops], seeds)
    if len({type(p.model.parameters) for p in loops}) != 1:
        raise ValueError("a population is one kind of model")
    clock = make_clock(waypoints, settings, dt)
    drawn = [draw(clock, settings, seed) for seed in seeds]
    state = start or waypoints.start
    robots = [p.model.packed() for p in loops]
    ticks = np.zeros(len(loops), dtype=np.int64)
    outs = np.empty((len(loops), clock.ticks, len(COLUMNS)))
    run_closed_planar_population(  # type: ignore[call-arg]
        robots[0].parameters,
        *packed_laws([p.controller for p in loops], [p.settings for p in loops], waypoints, clock, state),
        np.array([d for d, _ in drawn]),
        np.array([d for _, d in drawn]),
        dt,
        np.array([drive_numbers(p.model.drive, settings.velocity_period, dt) for p in loops], dtype=np.float64),
        np.array([robot_row(r) for r in robots]),
        np.array([state.x, state.y, state.yaw, state.v_x, state.yaw_rate, state.wheel_left, state.wheel_right]),
        ticks,
        outs,
    )
    return [closed_run(out[:n], clock) for out, n in zip(outs, ticks, strict=True)]


def closed_run(rows: FloatArray, clock: Clock) -> ClosedRun:
    """What a loop recorded, as a run; a last row that is not finite is left out."""
    lost = len(rows) < clock.ticks or bool(is_lost(rows[-1, 0], rows[-1, 1], rows[-1, 5], tuple(rows[-1, 10:16])))
    finite = np.isfinite(rows).all(axis=1)
    rows = rows[: len(rows) if finite.all() else int(np.argmin(finite))]
    return ClosedRun(clock.position * clock.dt * np.arange(len(rows), dtype=np.float64), rows, lost)


def track(
    plant: Plant,
    controller: Controller,
    waypoints: Waypoints,
    settings: LoopSettings,
    seed: int,
    start: State | None = None,
) -> ClosedRun:
    """Drive any plant, physics step by physics step: slow and obvious; the fused loops must equal it.

    Torques are not recorded: a plant does not tell them step by step.

    Args:
        plant: what is driven; its own drive stands between command and wheels.
        controller: the law.
        waypoints: the reference.
        settings: what stands around them.
        seed: of noise and disturbance.
        start: where it starts; the first waypoint, at rest, if not given.
    """
    clock = make_clock(waypoints, settings, plant.dt)
    draws, disturbance = draw(clock, settings, seed)
    table, gains, law = waypoints.packed(), controller.packed(), controller.number
    state = plant.reset(start or waypoints.start)
    belief, numbers, deviations = ekf.initial_memory(state), settings.filter.packed(), settings.deviations()
    memory: tuple[float, ...] = (0.0,) * MEMORY
    rows, index, command, tick = np.empty((clock.ticks, len(COLUMNS))), 0, (0.0, 0.0), 0
    seen: tuple[float, ...] = ()
    for k in range(clock.n + 1):
        due = k % clock.position == 0
        if due:
            period, s = clock.position * clock.dt, state
            seen = observe(
                settings.feedback == "ekf", belief, numbers, deviations, draws[tick], s.x, s.y, s.yaw, s.v_x, s.yaw_rate,
                s.wheel_left, s.wheel_right, period if k else 0.0,
            )  # fmt: skip
            memory, index, aim = position_tick(
                law, gains, memory, table, index, k * clock.dt, seen, settings.lookahead, period
            )
        if k % clock.velocity == 0:
            memory, v, w = velocity_step(law, gains, memory, seen[3], seen[4], clock.velocity * clock.dt)
            command = (float(v), float(w))
        if due:
            write_row(
                rows[tick], s.x, s.y, s.yaw, s.v_x, s.v_y, s.yaw_rate, s.wheel_left, s.wheel_right, 0.0, 0.0, aim, memory,
                command, seen,
            )  # fmt: skip
            tick += 1
            if is_lost(s.x, s.y, s.yaw_rate, aim):
                break
        if k < clock.n:
            state = plant.step(command, clock.dt, float(disturbance[k % len(disturbance)]))
    return closed_run(rows[:tick], clock)
