"""A robot in MuJoCo behind a follower, in simulated time, with faults: no DDS, no wall clock."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ssmr.control.law import Observation
from ssmr.control.laws import AnyController
from ssmr.control.waypoints import Waypoints
from ssmr.types import FloatArray
from validation.ros.follower import PathFollower, StoppedError
from validation.ros.robot import CommandGate, SimulatedRobot
from validation.simulator.plant import MujocoPlant


@dataclass
class Faults:
    """Faults of a drive: functions of the time since they began [s], which is negative before."""

    late: Callable[[float], float] = lambda t: 0.005
    """Time that a message takes [s]."""
    jump: Callable[[float], float] = lambda t: 0.0
    """Distance by which the pose is off to the side [m]."""
    silent: Callable[[float], bool] = lambda t: False
    """Whether a message is lost."""
    stopped: Callable[[float], bool] = lambda t: False
    """Whether the emergency stop is on."""
    other: Callable[[float], tuple[float, float] | None] = lambda t: None
    """Function that returns the command of somebody else, or None while nobody else commands."""
    rate: float = 1.0
    """Seconds of the receiver's clock in one of the robot's."""
    begin: float = 4.0
    """Time after the robot's start at which the fault begins [s]."""


@dataclass
class Driven:
    """The outcome of a drive."""

    follower: PathFollower
    stopped: str = ""
    """Why the robot was stopped."""
    fault_at: float = math.inf
    """When the fault began [s]."""
    rows: list[tuple[float, ...]] = field(default_factory=list)
    """Time, x, y, v, w, commanded v and w, every 20 ms."""

    def table(self, since: float = 0.0) -> FloatArray:
        """Return the rows from some time after the fault on [s]."""
        table = np.array(self.rows)
        begin = self.fault_at if math.isfinite(self.fault_at) else 0.0
        return np.asarray(table[table[:, 0] >= begin + since])

    def off(self, since: float = 0.0) -> FloatArray:
        """Return the distances from the path [m]."""
        xy = self.table(since)[:, 1:3]
        path = self.follower.waypoints.xy
        steps = np.diff(path, axis=0)
        lengths = np.maximum((steps**2).sum(axis=1), 1e-18)
        offsets = xy[:, None] - path[:-1]
        share = np.clip((offsets * steps).sum(axis=2) / lengths, 0.0, 1.0)
        gaps = offsets - share[..., None] * steps
        return np.asarray(np.hypot(gaps[..., 0], gaps[..., 1]).min(axis=1))

    @property
    def rest_off(self) -> float:
        """Distance from the last waypoint at the end [m]."""
        return math.dist(self.rows[-1][1:3], self.follower.waypoints.xy[-1])


def drive_with_faults(
    body: MujocoPlant,
    law: AnyController,
    waypoints: Waypoints,
    faults: Faults | None = None,
    **settings: Any,
) -> Driven:
    """Drive a robot along waypoints from the origin, until the follower arrives or stops it.

    The follower sees the true motion with the noise of the state filter's speeds.
    """
    f = faults or Faults()
    follower = PathFollower(law, waypoints, **settings)
    robot = SimulatedRobot(body, seed=1)
    done = Driven(follower)
    gate = CommandGate("/cmd_vel", lambda text: None)
    coming: list[tuple[float, int, float, Observation]] = []
    start = follower.waypoints.start
    sense = round(0.02 / robot.dt)
    send = round(0.05 / robot.dt)
    moved = math.nan
    after = 0.0
    k = 0
    while after < 0.5 and robot.time < 120.0:
        now = robot.time
        since = now - moved - f.begin if math.isfinite(moved) else -math.inf
        if since >= 0.0:
            done.fault_at = min(done.fault_at, now)
        if k % sense == 0:
            robot.sense()
            _, (v, w), *_ = robot.filtered_odometry()
            if math.isnan(moved) and abs(v) > 0.05:
                moved = now
            x, y, yaw = robot.pose.tolist()
            seen = Observation(x, y + f.jump(since), yaw, v, w)
            if not f.silent(since):
                heapq.heappush(coming, (now + f.late(since), k, now, seen))
            c = math.cos(start.yaw)
            s = math.sin(start.yaw)
            place = (start.x + c * x - s * y, start.y + s * x + c * y)
            truth = robot.state
            sent = gate.command(now)
            done.rows.append((now, *place, truth.v_x, truth.yaw_rate, *sent))
        follower.emergency_stop = f.stopped(since)
        gate.emergency_stop(f.stopped(since))
        try:
            while coming and coming[0][0] <= now:
                _, _, stamp, seen = heapq.heappop(coming)
                follower.update(stamp, seen, f.rate * now)
            if k % send == 0 and not done.stopped:
                gate.offer(follower.command(f.rate * now), now)
        except StoppedError as error:
            done.stopped = str(error)
            done.rows.append((*done.rows[-1],))
            follower.phase = "arrived"
        command = f.other(since) or gate.command(now)
        robot.advance(1, command)
        after += robot.dt * (follower.phase == "arrived")
        k += 1
    return done
