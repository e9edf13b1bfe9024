"""A controller on its reference over messages: when to start, what to command, when to stop.

The position loop runs with each message that has the robot's pose, the velocity loop at the
instants of a clock (Sec. 4.3.2). Mission time is counted by the messages' stamps, so target and
observation belong to one instant, however long the message took. The receiver's own clock watches
that messages still come. There is no ROS and no clock in this module.

Mission time stands still while the emergency stop is on, and while the robot does not do what it is
told: then it is that of the last message by which the robot obeyed. So no error grows that the
robot would chase later.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ssmr.control.law import Command, Observation
from ssmr.control.loop import (
    VELOCITY_PERIOD,
    ClosedRun,
    LoopSettings,
    PythonSide,
    make_trackers,
    robot_sides,
)
from ssmr.control.predictor import (
    LEARNT,
    MODEL_V,
    MODEL_W,
    learnt_references,
    predict_ahead,
    remember_command,
)
from ssmr.control.tick import INITIAL_STATE, LOG_COLUMNS, Clock, record_tick
from ssmr.control.waypoints import Waypoints
from ssmr.errors import SsmrError
from ssmr.geometry import compose_poses, invert_pose, wrap_angle
from ssmr.types import FloatArray, Motion
from validation.experiment.loops import AnyController
from validation.ros.messages import STAND_STILL, Twist
from validation.ros.watch import (
    ASTRAY,
    BRAKING,
    GENTLE,
    JUMP,
    STRANGE_FOR,
    Watch,
    even_run,
    limited_motion,
)

FRESH = 0.5
"""Age from which feedback is too old to drive by [s]."""
_SETTLED = 5
"""Number of fresh messages in a row from a standing robot before it is driven."""
_MOVING = 0.05
"""A robot faster than this is not taken over [m/s, rad/s]."""
_SAME_CLOCK = 5.0
"""Greatest difference between the stamps of a tracking system and of the feedback, if they are of
one clock [s]."""
_SHARE = 0.25
"""Least share of the commanded motion by which a robot counts as one that obeys [1]."""
_ANSWER = 0.5
"""Time after its dead time within which a robot begins to obey [s]."""
_NEAR = 0.05
"""Distance of a target that is reached again [m]."""
_GENTLE_BEND = 1.0
"""Radius of the bend that is always allowed then at the path's greatest speed [m], so that a
straight path can be found."""
_AT_REST = 0.02
"""Distance of the last waypoint at which it may rest [m]."""
_SETTLING = 3.0
"""Longest time for which the robot is driven behind the end until it rests [s]."""


class StoppedError(SsmrError):
    """The robot was stopped before the reference's end; the message says why."""


class _LastResponse(NamedTuple):
    """The follower at the last message by which the robot obeyed."""

    stamp: float  # of the message [s]
    t: float  # mission time [s]
    seen: Observation
    rows: int  # number of rows that were recorded until then
    poses: int  # the same of poses
    predictor: tuple[FloatArray, FloatArray]  # the commands and the memory of the predictor


class PathFollower:
    """A controller on its reference, fed with a robot's states, without ROS and a clock."""

    def __init__(
        self,
        controller: AnyController,
        waypoints: Waypoints,
        *,
        v_limit: float | None = None,
        w_limit: float = 1.0,
        lookahead: float = 0.0,
        patience: float = 30.0,
    ) -> None:
        """Design the law and compile the loops, so that nothing is slow once the robot moves.

        The reference begins at the robot's pose. A controller that is a Python object is made
        twice: the first one computes one command and is thrown away.

        Args:
            controller: the law.
            waypoints: the reference.
            v_limit: greatest speed ever commanded [m/s], `GENTLE` times the path's if not given.
            w_limit: greatest yaw rate ever commanded [rad/s].
            lookahead: distance that the robot keeps behind its target [m].
            patience: time for which the target waits for a robot that does not obey [s].

        Raises:
            ControllerError: the object cannot be made, or gives no command.
            ValueError: a number out of its range, gains that the law refuses, or a reference faster
                than the limit.
        """
        course = waypoints.course()
        fastest = float(course["v"].max())
        waypoints = waypoints.braked(BRAKING)
        if v_limit is None:
            v_limit = min(GENTLE * fastest, 10.0)
        if not (0.0 < v_limit <= 10.0 and 0.0 < w_limit <= 10.0):
            raise ValueError(
                f"v_limit = {v_limit:g}, w_limit = {w_limit:g}: "
                "both must be positive and at most 10"
            )
        drive = controller.drive
        self.v_limit = min(drive.v_max, v_limit)
        self.w_limit = min(drive.w_max, w_limit)
        self.lookahead = lookahead
        if fastest > self.v_limit:
            raise ValueError(
                f"the reference asks for {fastest:.3g} m/s; the limit is {self.v_limit:g} m/s"
            )
        self.controller = controller.on(replace(drive, v_max=self.v_limit, w_max=self.w_limit))
        self.waypoints = waypoints
        self.phase = "waiting"
        """Phase of the drive: waiting, driving or arrived."""
        self.why_waiting = "no feedback yet"
        self.emergency_stop = False
        """Whether the robot's emergency stop is on."""
        self.held = ""
        """Why the target waits; empty while it does not."""
        self.held_time = self.late = 0.0
        """Time for which the target has waited, and by which the robot answers later than its drive
        says, messages included [s]."""
        self._patience = patience
        turn = max(float(np.abs(course["w"]).max()), fastest / _GENTLE_BEND)
        self._gentle = (GENTLE * fastest, GENTLE * turn)
        self._gently = False
        self._released = -math.inf
        self._sent = Command(*STAND_STILL)
        self._watch = Watch()
        self._arrival = self._stamp = -math.inf
        self._fresh = self._repeated = 0
        self._begin = 0.0
        self._at = INITIAL_STATE.seen
        self._response: _LastResponse
        self._to_reference = np.zeros(3)
        self._yaw = 0.0
        self._times = list[float]()
        self._rows = list[FloatArray]()
        self._poses = list[tuple[float, float, float, float]]()
        self._pose_to_reference: FloatArray | None = None
        self._start_law()
        self._run_position_loop(INITIAL_STATE.seen, 0.0, 0.02)
        self._run_velocity_loop(0.0)
        self._start_law()

    def _start_law(self) -> None:
        law = self.controller
        loop = LoopSettings("truth", disturbance=False, lookahead=self.lookahead)
        # The messages' stamps give the time, so only the law and the course matter.
        clock = Clock(VELOCITY_PERIOD, 1, 1, 1)
        trackers = make_trackers([law], [loop], self.waypoints, clock, self.waypoints.start)
        (self._side,) = robot_sides([law], [loop], self.waypoints, trackers)
        self._model = self._side.tracker.predictor

    def _run_velocity_loop(self, t: float) -> Command:
        side = self._side
        side.velocity_tick(t + self._watch.lateness, VELOCITY_PERIOD)
        command = side.state.command
        if not side.tracker.predicts:
            remember_command(
                side.tracker.past, side.tracker.predictor_state, *command, t + self._watch.lateness
            )
        return command

    def _run_position_loop(self, seen: Observation, t: float, dt: float) -> FloatArray:
        """What a run records of this step; lateral speed, wheels and torques are not known."""
        side = self._side
        tracker = side.tracker
        memory = tracker.predictor_state
        if not isinstance(side, PythonSide):  # that one knows when its command is sent
            horizon = self._model.horizon + self._watch.lateness
            side.tracker = tracker._replace(predictor=self._model._replace(horizon=horizon))
        if not tracker.predicts:  # what the robot should do is known under any law
            predict_ahead(tracker.past, memory, seen, t, t, self._model)
        side.position_tick(seen, t, dt)
        row = np.empty(len(LOG_COLUMNS))
        unknown = (0.0, 0.0, 0.0, 0.0)  # wheel rates and torques
        truth = Motion(seen.x, seen.y, seen.yaw, seen.v, 0.0, seen.w, *unknown)
        record_tick(row, truth, side.state, tracker)
        row[-1] = memory[LEARNT]
        return row

    def track(self, stamp: float, seen: Observation) -> bool:
        """Take a pose from a tracking system, for the record and not for the controller.

        Return False for one whose stamp does not increase, or is of another clock than the
        feedback's.
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
        """Take pose and speeds of `stamp` [s] that came at `now` [s], and run the position loop.

        A message with the stamp of the last one is the same message again.

        Raises:
            StoppedError: the sender's clock or the pose jumped, the robot has not obeyed for too
                long, or it is farther from its target than it may be.
            ControllerError: the controller failed.
        """
        dt = stamp - self._stamp
        self._stamp = stamp
        if dt == 0.0:
            self._repeated += 1
            return
        self._arrival = now
        self._repeated = 0
        self._watch.message(now - stamp, dt)
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
        self._watch_motion(stamp, seen)
        if self._is_held(stamp, seen):
            return
        t = stamp - self._begin - self.held_time
        self._yaw += float(wrap_angle(seen.yaw - self._yaw))  # unwrapped (Sec. 4.2)
        pose = np.array([seen.x, seen.y, self._yaw])
        x, y, yaw = map(float, compose_poses(self._to_reference, pose))
        on_reference = Observation(x, y, yaw, seen.v, seen.w)
        self._rows.append(self._run_position_loop(on_reference, t, dt))
        self._times.append(t)
        self._go_on(stamp, t, on_reference)

    def _go_on(self, stamp: float, t: float, seen: Observation) -> None:
        """Judge where the robot is on the reference: astray, near its target, or at its rest."""
        aim = self._side.state.target
        away = math.hypot(seen.x - aim.x, seen.y - aim.y)
        if away > ASTRAY + self.lookahead:
            raise StoppedError(
                f"the robot is {away:.2f} m from its target at t = {t:.2f} s (at most {ASTRAY:g} m)"
            )
        if stamp > self._released + self._answer and away <= _NEAR + self.lookahead:
            self._gently = False
        if t > _SETTLING:  # motors at their limit at a start are no lateness
            learnt_delay = float(self._side.tracker.predictor_state[LEARNT])
            self.late = learnt_delay + self._watch.lateness
        behind = t - self.waypoints.duration
        rests = self._speed_of(seen.v, seen.w) < _MOVING and away <= _AT_REST + self.lookahead
        if behind >= _SETTLING or (behind >= -1e-9 and rests):
            self.phase = "arrived"

    @property
    def _answer(self) -> float:
        """Time within which a robot begins to obey [s]."""
        return self._model.horizon + _ANSWER

    def _speed_of(self, v: float, w: float) -> float:
        """Return the speed [m/s] of the faster side's wheels, but for the sign of the bend."""
        return math.hypot(v, self.controller.drive.command_half_track * w)

    def _watch_motion(self, stamp: float, seen: Observation) -> None:
        """Stop a robot that moves otherwise than by its commands: somebody else drives it."""
        memory = self._side.tracker.predictor_state
        driver = learnt_references(memory)
        v = driver.gain_v * memory[MODEL_V]
        w = driver.gain_w * memory[MODEL_W]
        moves = 0.0 if self.emergency_stop else self._speed_of(seen.v, seen.w)
        difference = self._speed_of(seen.v - v, seen.w - w)
        if self._watch.is_strange(stamp, moves, self._speed_of(v, w), difference):
            raise StoppedError(
                f"the robot has moved otherwise than by its commands for {STRANGE_FOR:g} s: "
                f"{seen.v:.2f} m/s and {seen.w:.2f} rad/s where {v:.2f} and {w:.2f} were expected; "
                "does somebody else drive it?"
            )

    def _is_held(self, stamp: float, seen: Observation) -> bool:
        """Whether the target waits; if so, drop the record since the robot last obeyed."""
        within = self._answer
        last = self._response
        if not self.emergency_stop and self._obeys(seen, within):
            self.held = ""
            t = stamp - self._begin - self.held_time
            self._response = self._responded(stamp, t, seen)
            return False
        waited = stamp - last.stamp
        if self.emergency_stop or (waited > 0.5 * within and last.t > 0.0):
            self._gently = True
            self._released = stamp
        if not self.emergency_stop and waited <= within and not self.held:
            return False
        if waited > self._patience:
            raise StoppedError(f"the robot has not obeyed for {waited:.0f} s ({self.held})")
        if not self.held:
            del self._rows[last.rows :]
            del self._times[last.rows :]
            del self._poses[last.poses :]
            tracker = self._side.tracker
            for array, kept in zip(
                (tracker.past, tracker.predictor_state), last.predictor, strict=True
            ):
                array[:] = kept
        self.held = "it does not do what it is told"
        if self.emergency_stop:
            self.held = "the emergency stop is on"
        self.held_time = stamp - self._begin - last.t
        return True

    def _responded(self, stamp: float, t: float, seen: Observation) -> _LastResponse:
        tracker = self._side.tracker
        predictor = (tracker.past.copy(), tracker.predictor_state.copy())
        counts = (len(self._rows), len(self._poses))
        return _LastResponse(stamp, t, seen, *counts, predictor=predictor)

    def _obeys(self, seen: Observation, within: float) -> bool:
        """Return whether the robot moves as commanded, or has since its last response.

        Args:
            seen: its pose and speeds.
            within: time in which it answers [s].
        """
        demand = self._speed_of(*self._sent)
        least = _SHARE * demand
        if self._response.t >= self.waypoints.duration:
            return True  # the target waits already
        if demand < _MOVING or self._speed_of(seen.v, seen.w) > least:
            return True
        last = self._response.seen
        turn = float(wrap_angle(seen.yaw - last.yaw))
        way = math.hypot(seen.x - last.x, seen.y - last.y)
        return self._speed_of(way, turn) > least * within

    def _start_if_settled(self, seen: Observation, dt: float) -> None:
        """Drive a robot that stands and whose feedback comes steadily."""
        obstacle = ""
        if not 0.0 < dt < FRESH:
            obstacle = "the feedback does not come steadily"
        elif self.emergency_stop:
            obstacle = "the emergency stop is on"
        elif abs(seen.v) > _MOVING or abs(seen.w) > _MOVING:
            obstacle = f"the robot moves ({seen.v:.2f} m/s, {seen.w:.2f} rad/s)"
        if obstacle:
            self.why_waiting = obstacle
            self._fresh = 0
            return
        self._fresh += 1
        if self._fresh < _SETTLED:
            return
        start = self.waypoints.start
        origin = np.array([start.x, start.y, start.yaw])
        self._to_reference = compose_poses(
            origin, invert_pose(np.array([seen.x, seen.y, seen.yaw]))
        )
        self._yaw = seen.yaw
        self._begin = self._stamp
        self.phase = "driving"
        self._at = seen
        self._response = self._responded(self._stamp, 0.0, seen)
        if self._poses and abs(self._poses[0][0] - self._stamp) <= _SAME_CLOCK:
            self._pose_to_reference = compose_poses(origin, invert_pose(self._poses[0][1:]))

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
            why = fault
            if self._repeated and not fault:
                why = f"{self._repeated} messages repeat the stamp {self._stamp:.3f} s"
            if why:
                raise StoppedError(f"no feedback that can be used for {age:.2f} s: {why}")
            raise StoppedError(f"no feedback for {age:.2f} s")
        v, w = self._unlimited_twist(self._stamp - self._begin - self.held_time + age)
        if not (math.isfinite(v) and math.isfinite(w)):
            raise StoppedError(f"the controller asks for {v} m/s and {w} rad/s")
        if self._gently:
            v, w = limited_motion((v, w), self._gentle, self._model)
        limits = np.array([self.v_limit, self.w_limit])
        sent = Command(*np.clip((v, w), -limits, limits).tolist())
        self._sent = sent
        self._side.state = self._side.state._replace(command=sent)
        self._side.tracker.past[-1] = sent
        return sent

    def _unlimited_twist(self, t: float) -> Twist:
        """The law's output at mission time `t` [s]; while the target waits, its twist or a stop."""
        if not self.held:
            return self._run_velocity_loop(t)
        if self.emergency_stop:
            return STAND_STILL
        target = self._side.state.target  # its twist shows when the robot obeys again
        return target.v, target.w

    @property
    def has_run(self) -> bool:
        """True if the robot was driven long enough for a run."""
        return len(self._times) > 1

    @property
    def tracked(self) -> bool:
        """True if a tracking system saw the whole drive."""
        if len(self._poses) < 2:
            return False
        last = self._poses[-1][0] - self._begin
        return last >= self._times[-1] - FRESH

    def run(self) -> ClosedRun:
        """Return the drive at even instants, by the tracking system if there was one, or feedback.

        Lateral speed, wheel rates and torques are not known, and 0.

        Raises:
            StoppedError: the robot was never driven.
        """
        if not self.has_run:
            raise StoppedError("the robot was not driven")
        times = np.array(self._times)
        rows = np.array(self._rows)
        if self.tracked and self._pose_to_reference is not None:
            poses = np.array(self._poses)
            poses[:, 3] = np.unwrap(poses[:, 3])
            motion = compose_poses(self._pose_to_reference, poses[1:, 1:])
            return even_run(times, rows, poses[1:, 0] - self._begin, motion)
        return even_run(times, rows, times, rows[:, :3])
