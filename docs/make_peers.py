"""Drive controllers that others wrote about beside those of this project: docs/peers.md.

Run from the project's root: `python docs/make_peers.py`, with `pip install casadi` for the row of
IPOPT. It prints the table: path error, distance to the moving target and share of time at a limit,
means over random winding paths in MuJoCo with noise and pushes, and the processor time of a
command.

The regulated pure pursuit and the MPPI are written from their papers with the numbers that nav2
ships. They are told the robot's lasting gains, as a user of nav2 would set his wheel separation.
"""

from __future__ import annotations

import importlib.util
import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.signal import savgol_filter

from ssmr.control.law import Observation
from ssmr.control.mission import ControllerInput, Mission
from ssmr.control.mpc import Mpc, MpcGains, step_of
from ssmr.control.references import winding_path
from ssmr.control.waypoints import Waypoints
from ssmr.types import FloatArray
from validation import load_profile
from validation.experiment.loops import make_robot, slowed_to_feasible
from validation.track import track

SEED = 2023
"""Seed of the paths. Noise and pushes of the runs have this seed and those that follow it."""
PATHS = 3
SPEED = 0.5
"""Greatest speed of a path [m/s]."""
PROFILES = ("thesis-lab", "husky-tile")


class RegulatedPurePursuit:
    """S. Macenski et al., Autonomous Robots 47, 2023, with the numbers of nav2.

    It follows the path, not a moving target: the speed is the path's greatest, less in bends and
    before the end. Obstacles, for which it slows too, are not there.
    """

    look_time = 1.5
    """Time ahead at which it aims [s]."""
    look_least = 0.3
    look_most = 0.9
    """Least and greatest distance at which it aims [m]."""
    radius = 0.9
    """Bends that are tighter than this are driven more slowly [m]."""
    slowest = 0.25
    """Speed to which a bend slows it at most [m/s]."""
    approach = 0.6
    """Distance to the end from which it slows [m]."""
    slowest_approach = 0.05
    """Speed of the approach at least [m/s]."""
    arrived = 0.02
    """Distance to the end at which it stops [m]."""
    ahead = False
    """True if it acts on the state one dead time ahead."""

    def __init__(self, mission: Mission) -> None:
        """Measure the path."""
        self.waypoints = mission.waypoints
        self.path = mission.waypoints.xy
        self.along = np.cumulative_sum(mission.waypoints.lengths, include_initial=True)
        self.cruise = float(np.max(mission.waypoints.segment_speeds))
        self.gains = lasting_gains(mission)
        self.near = 0

    def command(self, now: ControllerInput) -> tuple[float, float]:
        """Return speed [m/s] and yaw rate [rad/s]."""
        robot = now.ahead if self.ahead else now.seen
        off = self.path - (robot.x, robot.y)
        distance = np.hypot(off[:, 0], off[:, 1])
        # a path may cross itself, so the next metre alone is searched for the nearest place
        within = self.along <= self.along[self.near] + 1.0
        within[: self.near] = False
        self.near = int(np.argmin(np.where(within, distance, math.inf)))
        look = min(max(self.look_time * abs(robot.v), self.look_least), self.look_most)
        beyond = distance[self.near :] >= look
        carrot = len(self.path) - 1
        if beyond.any():
            carrot = self.near + int(np.argmax(beyond))
        dx, dy = off[carrot]
        left = math.cos(robot.yaw) * dy - math.sin(robot.yaw) * dx
        curvature = 2.0 * left / max(float(dx * dx + dy * dy), 1e-3)
        speed = self.cruise
        if abs(curvature) * self.radius > 1.0:
            speed = max(speed / (abs(curvature) * self.radius), self.slowest)
        left_over = float(self.along[-1] - self.along[self.near])
        if left_over < self.approach:
            speed = max(speed * left_over / self.approach, self.slowest_approach)
        if left_over < self.arrived:
            speed = 0.0
        return speed / self.gains[0], speed * curvature / self.gains[1]


class PredictedPursuit(RegulatedPurePursuit):
    """Pure pursuit that starts from the pose which this project's predictor expects."""

    ahead = True


class ShortPursuit(PredictedPursuit):
    """Pure pursuit with a predictor that looks half as far ahead along the path."""

    look_time = 0.75
    look_least = 0.15


class Mppi:
    """Model predictive path integral control: G. Williams et al., ICRA 2017, as nav2 has it.

    Numbers of samples, steps, temperature, noise and filter are nav2's. The cost is that of this
    project's `mpc`, and the model the unicycle with the lasting gains, one lag and the limits.
    """

    samples = 1000
    steps = 56
    temperature = 0.3
    gamma = 0.015
    spread = np.array([0.2, 0.4])
    """Standard deviations of the commands [m/s, rad/s]."""
    ahead = False
    """True if it acts on the state one dead time ahead."""

    def __init__(self, mission: Mission) -> None:
        """Take the numbers of the model."""
        model = mission.model
        self.mission = mission
        self.limits = np.array([model.v_max, model.w_max])
        self.gains = np.array(lasting_gains(mission))
        lags = model.lag + 1.0 / np.array([model.rate_v, model.rate_w])
        self.share = -np.expm1(-mission.period / lags)
        accelerations = np.array([model.acceleration_v, model.acceleration_w])
        self.change = self.gains * accelerations * mission.period
        self.plan = np.zeros((self.steps, 2))
        self.random = np.random.default_rng(0)

    def command(self, now: ControllerInput) -> tuple[float, float]:
        """Return the first command of the mean of the samples, weighted by their costs."""
        robot = now.ahead if self.ahead else now.seen
        begins = now.acts_at if self.ahead else now.t
        times = begins + self.mission.period * np.arange(1, self.steps + 1)
        self.plan = np.vstack([self.plan[1:], self.plan[-1:]])
        noise = self.spread * self.random.standard_normal((self.samples, self.steps, 2))
        tried = np.clip(self.plan + noise, -self.limits, self.limits)
        cost = self.cost(robot, tried, self.mission.preview(times))
        pulls = self.plan * (tried - self.plan) / self.spread**2
        cost += self.gamma * pulls.sum(axis=(1, 2))
        weights = np.exp((cost.min() - cost) / self.temperature)
        mean = np.tensordot(weights / weights.sum(), tried, axes=1)
        smooth = savgol_filter(np.vstack([now.past[-4:], mean]), 9, 2, axis=0)
        self.plan = np.clip(smooth[-self.steps :], -self.limits, self.limits)
        return float(self.plan[0, 0]), float(self.plan[0, 1])

    def speeds(self, robot: Observation, tried: FloatArray) -> FloatArray:
        """Return the (K, T, 2) speeds and yaw rates at the ends of the steps of commands."""
        wanted = self.gains * tried
        speeds = np.empty_like(wanted)
        speed = np.array([robot.v, robot.w])
        for k in range(self.steps):
            change = self.share * (wanted[:, k] - speed)
            speed = speed + np.clip(change, -self.change, self.change)
            speeds[:, k] = speed
        return speeds

    def cost(self, robot: Observation, tried: FloatArray, aims: FloatArray) -> FloatArray:
        """Return the (K,) costs of (K, T, 2) commands against (T, 5) targets."""
        gains = MpcGains()
        ways = self.mission.period * self.speeds(robot, tried)
        yaw = robot.yaw + np.cumsum(ways[:, :, 1], axis=1)
        middle = yaw - 0.5 * ways[:, :, 1]
        x = robot.x + np.cumsum(ways[:, :, 0] * np.cos(middle), axis=1) - aims[:, 0]
        y = robot.y + np.cumsum(ways[:, :, 0] * np.sin(middle), axis=1) - aims[:, 1]
        c = np.cos(aims[:, 2])
        s = np.sin(aims[:, 2])
        turned = np.remainder(yaw - aims[:, 2] + math.pi, 2.0 * math.pi) - math.pi
        along = gains.q_along * (c * x + s * y) ** 2
        across = gains.q_across * (c * y - s * x) ** 2
        total = along + across + gains.q_heading * turned**2
        # a step of mpc's plan is two periods long
        return np.asarray(0.5 * total.sum(axis=1))


class DelayedMppi(Mppi):
    """MPPI that knows its dead time as nav2 does from 1.5 (Lyrical) on, by `model_delay_*`.

    The speeds of a plan come so many steps later, and until then those of the commands that are on
    their way. The robot has no lag but within its dead time, as `robots export --to nav2` says it.
    """

    def __init__(self, mission: Mission) -> None:
        """Take the dead times of the driver."""
        super().__init__(mission)
        self.share[:] = 1.0
        drive = mission.drive
        late = np.array([drive.delay_v, drive.delay_w]) + 0.5 * drive.command_ramp + drive.wheel_lag
        self.steps_late = np.floor(late / mission.period + 0.5).astype(int)
        self.past = np.zeros((1, 2))

    def command(self, now: ControllerInput) -> tuple[float, float]:
        """Remember what is on its way."""
        self.past = now.past
        return super().command(now)

    def speeds(self, robot: Observation, tried: FloatArray) -> FloatArray:
        """Return the speeds so much later."""
        at_once = super().speeds(robot, tried)
        speeds = at_once.copy()
        for axis, late in enumerate(self.steps_late):
            under_way = self.gains[axis] * self.past[len(self.past) - late + 1 :, axis]
            speeds[:, : late - 1, axis] = under_way
            speeds[:, late - 1 :, axis] = at_once[:, : self.steps - late + 1, axis]
        return speeds


class PredictedMppi(Mppi):
    """MPPI that starts from the pose which this project's predictor expects."""

    ahead = True


class OurMpc(Mpc):
    """`mpc` as it is shipped, as a class of one's own, so that its commands can be timed."""

    def __init__(self, mission: Mission) -> None:
        """Give it its own gains."""
        super().__init__(MpcGains(), mission)


class Nmpc(OurMpc):
    """The program of `mpc` without its linearisation, solved by IPOPT to its end at each command.

    Model, cost, limits and prediction are those of `mpc`.
    """

    def __init__(self, mission: Mission) -> None:
        """Write the program with CasADi; robot, targets and last command are parameters."""
        import casadi

        super().__init__(mission)
        weights = MpcGains()
        model = mission.model
        n = len(self._lengths) - 1
        plan = casadi.SX.sym("plan", 2, n)
        start = casadi.SX.sym("start", 10)
        aims = casadi.SX.sym("aims", 3, n)
        steady = casadi.SX.sym("steady", 2, n + 1)
        last = casadi.SX.sym("last", 2)
        x, y, yaw, v, w, lag_v, lag_w, gain_v, gain_w, slip = casadi.vertsplit(start)
        before = last
        cost = 0
        changes = []
        for k in range(n):
            u = plan[:, k]
            h = float(self._lengths[k + 1])
            of_v = step_of(model.rate_v, model.push_v, model.lag, h)
            of_w = step_of(model.rate_w, model.push_w, model.lag, h)
            way, v, lag_v = casadi.vertsplit(of_v @ casadi.vertcat(v, lag_v, gain_v * u[0]))
            angle, w, lag_w = casadi.vertsplit(of_w @ casadi.vertcat(w, lag_w, gain_w * u[1]))
            heading = yaw + 0.5 * angle
            x = x + way * casadi.cos(heading) - slip * angle * casadi.sin(heading)
            y = y + way * casadi.sin(heading) + slip * angle * casadi.cos(heading)
            yaw = yaw + angle
            dx = x - aims[0, k]
            dy = y - aims[1, k]
            c = casadi.cos(aims[2, k])
            s = casadi.sin(aims[2, k])
            off = u - steady[:, k + 1]
            rate = u - before - (steady[:, k + 1] - steady[:, k])
            cost += weights.q_along * (c * dx + s * dy) ** 2
            cost += weights.q_across * (c * dy - s * dx) ** 2
            cost += weights.q_heading * (yaw - aims[2, k]) ** 2
            cost += weights.r_v * off[0] ** 2 + weights.r_w * off[1] ** 2
            cost += weights.d_v * rate[0] ** 2 + weights.d_w * rate[1] ** 2
            changes.append(u - before)
            before = u
        told = casadi.vertcat(start, casadi.vec(aims), casadi.vec(steady), last)
        changes = casadi.vertcat(*changes)
        program = {"x": casadi.vec(plan), "f": cost, "g": changes, "p": told}
        quiet = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}
        self._ipopt = casadi.nlpsol("plan", "ipopt", program, quiet)

    def command(self, now: ControllerInput) -> tuple[float, float]:
        """Return the first command of the best plan."""
        robot = now.ahead
        driver = now.driver
        times = now.acts_at + self._edges
        headings = self._mean_headings(times)
        aims = self._mission.preview(times)[:, :3]
        chords = np.hypot(*np.diff(aims[:, :2], axis=0).T)
        speeds = np.column_stack([chords, np.diff(headings)]) / self._lengths[:, None]
        steady = speeds * self._steady / (driver.gain_v, driver.gain_w)
        steady = np.clip(steady, -self._limits, self._limits)
        headings[1:] -= driver.slip * speeds[:, 1] / np.maximum(speeds[:, 0], 0.1)
        aims[:, 2] = headings
        lags = (driver.gain_v * driver.lagged_v, driver.gain_w * driver.lagged_w)
        learnt = (driver.gain_v, driver.gain_w, driver.slip)
        last = np.clip(now.past[-1], -self._limits, self._limits)
        begin = [robot.x, robot.y, robot.yaw, robot.v, robot.w, *lags, *learnt]
        told = np.concatenate([begin, aims[2:].ravel(), steady.ravel(), last])
        guess = steady[1:] if self._plan is None else np.vstack([self._plan[1:], self._plan[-1:]])
        box = np.tile(self._limits, len(guess))
        rates = self._changes.ravel()
        found = self._ipopt(x0=guess.ravel(), p=told, lbx=-box, ubx=box, lbg=-rates, ubg=rates)
        if not self._ipopt.stats()["success"]:
            self.failures += 1
        self._plan = np.asarray(found["x"]).reshape(-1, 2)
        return float(self._plan[0, 0]), float(self._plan[0, 1])


PEERS: dict[str, str | type] = {
    "NMPC in IPOPT": Nmpc,
    "mpc": OurMpc,
    "lqr-scheduled+predictor": "lqr-scheduled+predictor",
    "pid": "pid",
    "MPPI": Mppi,
    "MPPI, model_delay": DelayedMppi,
    "MPPI, predictor": PredictedMppi,
    "regulated pure pursuit": RegulatedPurePursuit,
    "regulated pure pursuit, predictor": PredictedPursuit,
    "the same, look-ahead halved": ShortPursuit,
}
"""Controllers of the table, by the name that they have in it."""


def lasting_gains(mission: Mission) -> tuple[float, float]:
    """Return the speed and the yaw rate that the linear model lastingly has for commands of one."""
    model = mission.model
    return model.push_v / model.rate_v, model.push_w / model.rate_w


def random_paths(count: int, seed: int) -> list[Waypoints]:
    """Return winding paths of 8 m with curvatures drawn between -1.3 and 1.3 1/m."""
    random = np.random.default_rng(seed)
    return [winding_path(SPEED, random.uniform(-1.3, 1.3, 11).tolist()) for _ in range(count)]


def timed(kind: type, spent: list[float]) -> type:
    """Return the class with the processor time [s] of each command appended to `spent`."""

    class Timed(kind):
        def command(self, now: ControllerInput) -> tuple[float, float]:
            began = time.thread_time()
            command: tuple[float, float] = super().command(now)
            spent.append(time.thread_time() - began)
            return command

    return Timed


def path_error(places: FloatArray, path: FloatArray) -> float:
    """Return the root mean square of the distances of (N, 2) places from a (M, 2) path [m]."""
    begins = path[:-1]
    steps = np.diff(path, axis=0)
    squares = np.sum(steps**2, axis=1)
    nearest = []
    for place in places:
        share = np.clip(np.sum((place - begins) * steps, axis=1) / squares, 0.0, 1.0)
        off = begins + share[:, None] * steps - place
        nearest.append(np.min(np.sum(off**2, axis=1)))
    return math.sqrt(np.mean(nearest))


def row_of(controller: str | type, profile: str, paths: Sequence[Waypoints]) -> list[float]:
    """Return path error [mm], distance to the target [mm], time at a limit [%], a command [ms]."""
    spent: list[float] = []
    chosen = timed(controller, spent) if isinstance(controller, type) else controller
    gains = "tuned" if controller == "pid" and profile == "thesis-lab" else None
    robot = make_robot(load_profile(profile), "mujoco")
    found = []
    for k, path in enumerate(paths):
        slowed = slowed_to_feasible(path, robot)
        more: dict[str, Any] = {"profile": profile, "gains": gains, "seed": SEED + k}
        tracked = track(chosen, slowed, "mujoco", **more)
        tracked.require_complete()
        metrics = tracked.metrics
        off = 1e3 * path_error(tracked.motion("mujoco").xy, slowed.xy)
        behind = 1e3 * metrics["sync_rms_m"]
        found.append([off, behind, 1e2 * metrics["saturated_fraction"]])
    tick = 1e3 * float(np.median(spent)) if spent else math.nan
    return [*np.mean(found, axis=0).tolist(), tick]


def main() -> None:
    """Print the table, a row as soon as it is measured."""
    paths = random_paths(PATHS, SEED)
    for name, controller in PEERS.items():
        if controller is Nmpc and importlib.util.find_spec("casadi") is None:
            continue
        rows = [row_of(controller, profile, paths) for profile in PROFILES]
        cells = [f"{d:.0f}, {s:.0f}, {at:.0f}" for d, s, at, _ in rows]
        tick = rows[-1][3]
        cells.append("compiled" if math.isnan(tick) else f"{tick:.2g}")
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
