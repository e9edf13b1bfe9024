"""A robot in MuJoCo behind a follower, in simulated time, with faults: no DDS, no wall clock."""

from __future__ import annotations

import copy
import heapq
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ssmr.control.law import Observation
from ssmr.control.laws import AnyController
from ssmr.control.waypoints import Waypoints
from ssmr.types import FloatArray, State
from tests.conftest import distances_to_path
from validation.ros.follower import PathFollower, StoppedError
from validation.ros.robot import CommandGate, SimulatedRobot
from validation.simulator.plant import MujocoPlant

TICK = 0.01
"""Time between two instants at which something may happen [s]."""


@dataclass
class Faults:
    """Faults of a drive: functions of the time since they began [s], which is negative before."""

    late: Callable[[float], float] = lambda t: 0.005
    """Time that a message takes [s]."""
    seen: Callable[[float, Observation], Observation] = lambda t, seen: seen
    """The odometry that is sent in place of the right one."""
    frozen: Callable[[float], bool] = lambda t: False
    """Whether odometry repeats what it said last, with stamps that go on."""
    wheels: Callable[[float, State], State] = lambda t, state: state
    """The state whose wheels encoders report in place of the right one."""
    silent: Callable[[float], bool] = lambda t: False
    """Whether a message is lost."""
    stopped: Callable[[float], bool] = lambda t: False
    """Whether the emergency stop is on."""
    unsaid: bool = False
    """Whether nobody says that it is."""
    confirmed: Callable[[float], bool] = lambda t: True
    """Whether somebody confirms that the robot may go on."""
    other: Callable[[float], tuple[float, float] | None] = lambda t: None
    """Function that returns the command of somebody else, or None while nobody else commands."""
    weak: tuple[int, float] | None = None
    """Side whose motor becomes weak (0 is left), and the greatest torque that it has left [N m]."""
    rate: float = 1.0
    """Seconds of the receiver's clock in one of the robot's."""
    begin: float = 4.0
    """Time after the robot's start at which the fault begins [s]."""
    hertz: float = 50.0
    """Rate of odometry, wheels and gyro [Hz]."""
    by_filter: bool = False
    """Whether the follower sees the pose of the state filter, which knows wheels and gyro alone."""
    most: float = 120.0
    """Longest drive [s]."""


@dataclass
class Driven:
    """The outcome of a drive."""

    follower: PathFollower
    stopped: str = ""
    """Why the robot was stopped."""
    named: str = ""
    """Why it was not driven any more for the first time."""
    fault_at: float = math.inf
    """When the fault began [s]."""
    named_at: float = math.inf
    """When its cause was named first [s]."""
    rows: list[tuple[float, ...]] = field(default_factory=list)
    """Time, x, y, v, w, commanded v and w, every 10 ms."""

    def table(self, since: float = 0.0) -> FloatArray:
        """Return the rows from some time after the fault on [s]."""
        table = np.array(self.rows)
        begin = self.fault_at if math.isfinite(self.fault_at) else 0.0
        return np.asarray(table[table[:, 0] >= begin + since])

    def off(self, since: float = 0.0) -> FloatArray:
        """Return the distances from the path [m]."""
        return distances_to_path(self.table(since)[:, 1:3], self.follower.waypoints.xy)

    @property
    def took(self) -> float:
        """Time from the fault until its cause was named [s]."""
        return self.named_at - self.fault_at

    @property
    def way_after(self) -> float:
        """Length of the way that the robot drove after the fault [m]."""
        return float(np.hypot(*np.diff(self.table()[:, 1:3], axis=0).T).sum())

    @property
    def rest_off(self) -> float:
        """Distance from the last waypoint at the end [m]."""
        return math.dist(self.rows[-1][1:3], self.follower.waypoints.xy[-1])


class _FaultyDrive:
    """One drive, advanced tick by tick."""

    def __init__(self, body: MujocoPlant, follower: PathFollower, faults: Faults) -> None:
        self.faults = faults
        self.follower = follower
        self.robot = SimulatedRobot(body, seed=1)
        self.done = Driven(follower)
        self.gate = CommandGate("/cmd_vel", lambda text: None)
        self.coming: list[tuple[float, int, Callable[[float], None]]] = []
        self.last: Observation | None = None
        self.moved = math.nan
        self.since = -math.inf
        self.count = 0
        self.start = follower.waypoints.start

    def send(self, deliver: Callable[[float], None]) -> None:
        """Let something arrive after the time that messages take now."""
        self.count += 1
        arrival = self.robot.time + self.faults.late(self.since)
        heapq.heappush(self.coming, (arrival, self.count, deliver))

    def sense(self) -> None:
        """Read the sensors, whose wheels may be wrong."""
        truth = self.robot.state
        self.robot.state = self.faults.wheels(self.since, truth)
        self.robot.sense()
        self.robot.state = truth

    def report(self) -> None:
        """Send odometry, wheels and gyro."""
        f = self.faults
        robot = self.robot
        stamp = robot.time
        pose, (v, w), *_ = robot.filtered_odometry()
        if math.isnan(self.moved) and abs(v) > 0.05:
            self.moved = stamp
        if not f.by_filter:
            pose = robot.pose
        seen = f.seen(self.since, Observation(*map(float, pose), v, w))
        if f.frozen(self.since) and self.last is not None:
            seen = self.last
        self.last = seen
        if f.silent(self.since):
            return
        follower = self.follower
        by_wheels = robot.wheel_odometry()[1]
        gyro = float(robot.imu()[0][2])
        self.send(lambda now: follower.supervisor.take_wheels(stamp, by_wheels))
        self.send(lambda now: follower.supervisor.take_gyro(stamp, gyro))
        self.send(lambda now: follower.update(stamp, seen, now))

    def tick(self, k: int) -> None:
        """Do what happens at one instant, and let the robot move until the next."""
        f = self.faults
        done = self.done
        follower = self.follower
        now = self.robot.time
        self.since = now - self.moved - f.begin if math.isfinite(self.moved) else -math.inf
        if self.since >= 0.0:
            done.fault_at = min(done.fault_at, now)
        if k % round(0.02 / TICK) == 0:
            self.sense()
        if k % round(1.0 / f.hertz / TICK) == 0:
            self.report()
        stops = f.stopped(self.since)
        self.gate.emergency_stop(stops)
        follower.take_stop(stops and not f.unsaid)
        try:
            while self.coming and self.coming[0][0] <= now:
                heapq.heappop(self.coming)[2](f.rate * now)
            if follower.held and f.confirmed(self.since):
                follower.confirm()
            if k % round(0.05 / TICK) == 0 and not done.stopped:
                self.gate.offer(follower.command(f.rate * now), now)
        except StoppedError as error:
            done.stopped = str(error)
            self.gate.offer((0.0, 0.0), now)
            follower.phase = "arrived"
        cause = done.stopped or follower.held
        if cause and not done.named:
            done.named = cause
            done.named_at = now
        truth = self.robot.state
        start = self.start
        c = math.cos(start.yaw)
        s = math.sin(start.yaw)
        place = (start.x + c * truth.x - s * truth.y, start.y + s * truth.x + c * truth.y)
        sent = self.gate.command(now)
        done.rows.append((now, *place, truth.v_x, truth.yaw_rate, *sent))
        self.robot.advance(round(TICK / self.robot.dt), f.other(self.since) or sent)


def drive_with_faults(
    body: MujocoPlant,
    law: AnyController,
    waypoints: Waypoints,
    faults: Faults | None = None,
    **settings: Any,
) -> Driven:
    """Drive a robot along waypoints from the origin, until the follower arrives or stops it.

    The follower sees the true pose, with the speeds of the state filter, unless the faults say
    otherwise.
    """
    f = faults or Faults()
    drive = _FaultyDrive(body, PathFollower(law, waypoints, **settings), f)
    done = drive.done
    k = 0
    after = 0.0
    weak = f.weak
    while after < 1.0 and drive.robot.time < f.most:
        if weak and drive.since >= 0.0:
            weaken_motor(body, *weak)
            weak = None
        drive.tick(k)
        after += TICK * (done.follower.phase == "arrived")
        k += 1
    return done


def weaken_motor(body: MujocoPlant, side: int, torque: float) -> None:
    """Leave the motor of a side no more than a torque [N m], until the robot is reset."""
    model = copy.copy(body.model)
    joints = model.dof_jntid[body.parts.sides[side]]
    model.jnt_actfrcrange[joints] = [-0.5 * torque, 0.5 * torque]
    body._bodies._batch.set_models([model])
