"""A controller on its reference for a robot that answers by messages: when to start, what to command and when to stop.

The position loop runs with each message that has the robot's pose, the velocity loop at the instants of a clock
(Sec. 4.3.2). Mission time is counted by the messages' stamps, so target and observation belong to one instant, however long
the message took. The receiver's own clock watches that messages still come. There is no ROS and no clock in this module.

Mission time stands still while the emergency stop is on, and while the robot does not do what it is told: then it is that of
the last message by which the robot obeyed. So no error grows that the robot would chase later.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ssmr.control.law import Command, Observation
from ssmr.control.loop import VELOCITY_PERIOD, Clock, ClosedRun, LoopSettings, make_trackers, robot_sides
from ssmr.control.tick import INITIAL_STATE, LOG_COLUMNS, LOST, Truth, is_lost, record
from ssmr.control.waypoints import Waypoints
from ssmr.errors import SsmrError
from ssmr.geometry import compose, invert, wrap_angle
from ssmr.types import FloatArray
from validation.bench.loops import AnyController
from validation.ros.messages import STAND_STILL, Twist

FRESH = 0.5
"""Age from which feedback is too old to drive by [s]."""
_SETTLED = 5
"""Number of fresh messages in a row from a standing robot before it is driven."""
_MOVING = 0.05
"""A robot faster than this is not taken over [m/s, rad/s]."""
_SAME_CLOCK = 5.0
"""Greatest difference between the stamps of a tracking system and of the feedback, if they are of one clock [s]."""
_SHARE = 0.25
"""Least share of the commanded motion by which a robot counts as one that obeys [1]."""
_ANSWER = 0.5
"""Time after its dead time within which a robot begins to do what it is told [s]."""
JUMP = 0.5
"""Least distance between two poses beyond what the speed explains that is a jump [m]."""
LATE = 0.15
"""Lateness of the feedback that is worth a warning [s]: half of it is what robots take to speed up."""
GENTLE, _GENTLE_TIME = 1.2, 3.0
"""Greatest share of the path's greatest speed and yaw rate [1] that is commanded until some time [s] after the robot obeys
again, from when half the time for its answer is over."""
_GENTLE_BEND = 1.0
"""Radius of the bend that is always allowed then at the path's greatest speed [m], so that a straight path can be found."""


class StoppedError(SsmrError):
    """The robot was stopped before the reference's end; the message says why."""


class _LastResponse(NamedTuple):
    """The follower at the last message by which the robot did what it was told."""

    stamp: float  # of the message [s]
    t: float  # mission time [s]
    seen: Observation
    rows: int  # number of rows that were recorded until then
    poses: int  # the same of poses


class PathFollower:
    """A controller on its reference, fed with the states of a robot, without ROS and without a clock."""

    def __init__(
        self,
        controller: AnyController,
        waypoints: Waypoints,
        *,
        v_limit: float = 1.0,
        w_limit: float = 1.0,
        lookahead: float = 0.0,
        patience: float = 30.0,
    ) -> None:
        """Design the law and compile the loops, so that nothing is slow once the robot moves.

        The reference begins at the robot's pose.
        A controller that is a Python object is made twice: the first one computes one command and is thrown away.

        Args:
            controller: the law.
            waypoints: the reference.
            v_limit: greatest speed ever commanded [m/s]; the robot's own limit if that is less.
            w_limit: greatest yaw rate ever commanded [rad/s], likewise.
            lookahead: distance that the robot keeps behind its target [m].
            patience: time for which the target waits for a robot that does not obey [s].

        Raises:
            ControllerError: the object cannot be made, or gives no command.
            ValueError: a number out of its range, gains that the law refuses, or a reference faster than the limit.
        """
        if not (0.0 < v_limit <= 10.0 and 0.0 < w_limit <= 10.0):
            raise ValueError(f"v_limit = {v_limit:g}, w_limit = {w_limit:g}: both must be positive and at most 10")
        drive, fastest = controller.drive, float(waypoints.segment_speeds.max())
        self.v_limit, self.w_limit, self.lookahead = min(drive.v_max, v_limit), min(drive.w_max, w_limit), lookahead
        if fastest > self.v_limit:
            raise ValueError(f"the reference asks for {fastest:.3g} m/s; the limit is {self.v_limit:g} m/s")
        self.controller, self.waypoints = controller.on(replace(drive, v_max=self.v_limit, w_max=self.w_limit)), waypoints
        self.phase = "waiting"
        """Phase of the drive: waiting, driving or arrived."""
        self.why_waiting = "no feedback yet"
        self.emergency_stop = False
        """Whether the robot's emergency stop is on."""
        self.held = ""
        """Why the target waits; empty while it does not."""
        self.held_time = self.late = 0.0
        """Time for which the target has waited, and greatest lateness of the feedback so far [s]."""
        course, self._patience = waypoints.course(), patience
        turn = max(float(np.abs(course["w"]).max()), fastest / _GENTLE_BEND)
        self._gentle, self._gentle_until = (GENTLE * fastest, GENTLE * turn), -math.inf
        self._sent, self._asked, self._first, self._least_age = Command(*STAND_STILL), math.inf, 0.0, math.inf
        self._arrival = self._stamp = -math.inf
        self._fresh, self._repeated, self._begin, self._at = 0, 0, 0.0, INITIAL_STATE.seen
        self._response: _LastResponse
        self._to_reference, self._yaw = np.zeros(3), 0.0
        self._times, self._rows = list[float](), list[FloatArray]()
        self._poses = list[tuple[float, float, float, float]]()
        self._pose_to_reference: FloatArray | None = None
        self._start_law()
        self._run_position_loop(INITIAL_STATE.seen, 0.0, 0.02)
        self._run_velocity_loop(0.0)
        is_lost(0.0, 0.0, 0.0, 0.0, 0.0)
        self._start_law()

    def _start_law(self) -> None:
        law = self.controller
        loop = LoopSettings("truth", disturbance=False, lookahead=self.lookahead)
        clock = Clock(VELOCITY_PERIOD, 1, 1, 1)  # the messages' stamps give the time, so only the law and the course matter
        trackers = make_trackers([law], [loop], self.waypoints, clock, self.waypoints.start)
        (self._side,) = robot_sides([law], [loop], self.waypoints, trackers)

    def _run_velocity_loop(self, t: float) -> Command:
        self._side.velocity_tick(t, VELOCITY_PERIOD)
        return self._side.state.command

    def _run_position_loop(self, seen: Observation, t: float, dt: float) -> FloatArray:
        """Return what a run records of this step; lateral speed, wheels and torques are not known."""
        self._side.position_tick(seen, t, dt)
        row = np.empty(len(LOG_COLUMNS))
        record(row, Truth(seen.x, seen.y, seen.yaw, seen.v, 0.0, seen.w, 0.0, 0.0, 0.0, 0.0), self._side.state)
        return row

    def track(self, stamp: float, seen: Observation) -> bool:
        """Take a pose from a tracking system, for the record and not for the controller.

        Return False for one whose stamp does not increase, or is of another clock than the feedback's.
        """
        if self.phase == "waiting":
            self._poses.clear()  # the last one before the start counts
        elif self._pose_to_reference is None or self.held:
            return True  # it came too late to judge, or the time does not count
        elif abs(stamp - self._stamp) > _SAME_CLOCK or stamp - self.held_time <= self._poses[-1][0]:
            return False
        self._poses.append((stamp - self.held_time, seen.x, seen.y, seen.yaw))
        return True

    def update(self, stamp: float, seen: Observation, now: float) -> None:
        """Take pose and speeds, measured at `stamp` [s] and arrived at `now` [s], and run the position loop.

        A message with the stamp of the last one is the same message again.

        Raises:
            StoppedError: the sender's clock or the pose jumped, the robot has not obeyed for too long, or it is farther from
                its target than it may be.
            ControllerError: the controller failed.
        """
        dt, self._stamp = stamp - self._stamp, stamp
        if dt == 0.0:
            self._repeated += 1
            return
        self._arrival, self._repeated = now, 0
        if self.phase == "waiting":
            self._start_if_settled(seen, dt)
        if self.phase != "driving":
            return
        if not 0.0 < dt < FRESH:
            raise StoppedError(f"the stamps of the feedback jumped by {dt:.3f} s")
        jump = math.hypot(seen.x - self._at.x, seen.y - self._at.y) - abs(seen.v) * dt
        if jump >= JUMP:
            raise StoppedError(f"the pose jumped by {jump:.2f} m (at most {JUMP:g} m)")
        self._at = seen
        self._watch_lateness(stamp, seen, now)
        if self._is_held(stamp, seen):
            return
        t = stamp - self._begin - self.held_time
        self._yaw += float(wrap_angle(seen.yaw - self._yaw))  # unwrapped from the last one (Sec. 4.2)
        x, y, yaw = map(float, compose(self._to_reference, np.array([seen.x, seen.y, self._yaw])))
        self._rows.append(self._run_position_loop(Observation(x, y, yaw, seen.v, seen.w), t, dt))
        self._times.append(t)
        aim = self._side.state.target
        if is_lost(x, y, seen.w, aim.x, aim.y):
            away = math.hypot(x - aim.x, y - aim.y)
            raise StoppedError(f"the robot is {away:.2f} m from its target at t = {t:.2f} s (at most {LOST:g} m)")
        if t >= self.waypoints.duration - 1e-9:
            self.phase = "arrived"

    def _is_held(self, stamp: float, seen: Observation) -> bool:
        """Return whether the target waits, and take back what came since the robot did not obey."""
        half, sent = self.controller.drive.command_half_track, self._sent
        demand, moved = math.hypot(sent.v, half * sent.w), math.hypot(seen.v, half * seen.w)
        last, within = self._response, max(self.controller.drive.delay_v, self.controller.drive.delay_w) + _ANSWER
        way = math.hypot(seen.x - last.seen.x, seen.y - last.seen.y) + half * abs(wrap_angle(seen.yaw - last.seen.yaw))
        if not self.emergency_stop and (demand < _MOVING or moved > _SHARE * demand or way > _SHARE * demand * within):
            self.held, t = "", stamp - self._begin - self.held_time
            self._response = _LastResponse(stamp, t, seen, len(self._rows), len(self._poses))
            return False
        waited = stamp - last.stamp
        if self.emergency_stop or waited > 0.5 * within:
            self._gentle_until = stamp + _GENTLE_TIME
        if not self.emergency_stop and waited <= within and not self.held:
            return False
        if waited > self._patience:
            raise StoppedError(f"the robot has not obeyed for {waited:.0f} s ({self.held})")
        if not self.held:
            del self._rows[last.rows :], self._times[last.rows :], self._poses[last.poses :]
        self.held = "the emergency stop is on" if self.emergency_stop else "it does not do what it is told"
        self.held_time = stamp - self._begin - last.t
        return True

    def _watch_lateness(self, stamp: float, seen: Observation, now: float) -> None:
        """Measure how late feedback comes: behind the quickest, and behind what the drive makes of the first command."""
        self._least_age = min(self._least_age, now - stamp)
        self.late = max(self.late, now - stamp - self._least_age)
        drive = self.controller.drive
        if not math.isfinite(self._asked) or abs(seen.v) <= _SHARE * self._first:
            return
        expected = drive.delay_v + _SHARE * self._first / drive.acceleration_v
        self.late, self._asked = max(self.late, now - self._asked - expected), math.nan

    def _start_if_settled(self, seen: Observation, dt: float) -> None:
        """Drive a robot that stands and whose feedback comes steadily."""
        self._fresh += 1
        if not 0.0 < dt < FRESH:
            self.why_waiting, self._fresh = "the feedback does not come steadily", 0
        elif self.emergency_stop:
            self.why_waiting, self._fresh = "the emergency stop is on", 0
        elif abs(seen.v) > _MOVING or abs(seen.w) > _MOVING:
            self.why_waiting, self._fresh = f"the robot moves ({seen.v:.2f} m/s, {seen.w:.2f} rad/s)", 0
        if self._fresh < _SETTLED:
            return
        start = self.waypoints.start
        origin = np.array([start.x, start.y, start.yaw])
        self._to_reference = compose(origin, invert(np.array([seen.x, seen.y, seen.yaw])))
        self._yaw, self._begin, self.phase, self._at = seen.yaw, self._stamp, "driving", seen
        self._response = _LastResponse(self._stamp, 0.0, seen, 0, len(self._poses))
        if self._poses and abs(self._poses[0][0] - self._stamp) <= _SAME_CLOCK:
            self._pose_to_reference = compose(origin, invert(self._poses[0][1:]))

    def command(self, now: float, fault: str = "") -> Twist:
        """Run one step of the velocity loop; return v [m/s] and omega [rad/s] to send at `now` [s].

        `fault` says what is wrong with feedback that came and could not be used.

        Raises:
            StoppedError: the feedback is too old to drive by, or the law's output is not finite.
            ControllerError: the controller failed.
        """
        if self.phase != "driving":
            return STAND_STILL
        age = now - self._arrival
        if age > FRESH:
            again = f"{self._repeated} messages repeat the stamp {self._stamp:.3f} s" if self._repeated else ""
            why = fault or again
            raise StoppedError(f"no feedback {f'that can be used for {age:.2f} s: {why}' if why else f'for {age:.2f} s'}")
        if self.held:
            aim = self._side.state.target
            v, w = STAND_STILL if self.emergency_stop else (aim.v, aim.w)  # to see when it obeys again
        else:
            v, w = self._run_velocity_loop(self._stamp - self._begin - self.held_time + age)
        if not (math.isfinite(v) and math.isfinite(w)):
            raise StoppedError(f"the controller asks for {v} m/s and {w} rad/s")
        if self._stamp < self._gentle_until:  # both less, so that the bend stays
            share = min(1.0, *(most / max(abs(u), 1e-9) for u, most in zip((v, w), self._gentle, strict=True)))
            v, w = share * v, share * w
        sent = Command(*np.clip((v, w), (-self.v_limit, -self.w_limit), (self.v_limit, self.w_limit)).tolist())
        if math.isinf(self._asked) and abs(sent.v) > _MOVING:
            self._asked, self._first = now, abs(sent.v)
        self._sent, self._side.state = sent, self._side.state._replace(command=sent)
        if self._side.tracker.predicts:
            self._side.tracker.past[-1] = sent
        return sent

    @property
    def has_run(self) -> bool:
        """True if the robot was driven long enough for a run."""
        return len(self._times) > 1

    @property
    def tracked(self) -> bool:
        """True if a tracking system saw the whole drive."""
        return len(self._poses) > 1 and self._poses[-1][0] - self._begin >= self._times[-1] - FRESH

    def run(self) -> ClosedRun:
        """Return the drive at even instants: the motion by the tracking system if there was one, else by the feedback.

        Lateral speed, wheel rates and torques are not known, and 0.

        Raises:
            StoppedError: the robot was never driven.
        """
        if not self.has_run:
            raise StoppedError("the robot was not driven")
        times, rows = np.array(self._times), np.array(self._rows)
        period = float(np.median(np.diff(times)))
        t = period * np.arange(int(times[-1] / period + 1e-6) + 1, dtype=np.float64)
        table: FloatArray = rows[np.searchsorted(times, t + 1e-9, side="right") - 1]
        motion = rows[:, :3]
        if self.tracked and self._pose_to_reference is not None:
            poses = np.array(self._poses)
            poses[:, 3] = np.unwrap(poses[:, 3])
            times, motion = poses[1:, 0] - self._begin, compose(self._pose_to_reference, poses[1:, 1:])
        for k in range(3):
            table[:, k] = np.interp(t, times, motion[:, k])
        return ClosedRun(t, table, lost=False)
