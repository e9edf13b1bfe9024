"""A controller on its reference over messages: when to start, what to command, when to stop.

The position loop runs with each message that has the robot's pose, the velocity loop at the
instants of a clock (Sec. 4.3.2). Mission time is counted by the messages' stamps, so target and
observation belong to one instant, however long the message took. The receiver's own clock watches
that messages still come. There is no ROS and no clock in this module.

A robot whose emergency stop is on, or that does not move where it is told to, is held: it is
commanded to stand, and mission time stands still. It goes on when somebody confirms that it may,
from the place of its path at which it stands, so there is no error that it would chase.
"""

from __future__ import annotations

import math
from dataclasses import replace

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
    predict_ahead,
    remember_command,
    stop_model,
)
from ssmr.control.tick import INITIAL_STATE, LOG_COLUMNS, Clock, record_tick
from ssmr.control.waypoints import Waypoints, targets_at
from ssmr.errors import SsmrError
from ssmr.geometry import compose_poses, invert_pose, wrap_angle
from ssmr.robot.vehicle import Drive
from ssmr.types import FloatArray, Motion
from validation.experiment.loops import AnyController
from validation.ros.messages import STAND_STILL, Twist
from validation.ros.watch import (
    BRAKING,
    GENTLE,
    SURE,
    SenderClock,
    Supervisor,
    even_run,
)

FRESH = 0.5
"""Age from which feedback is too old to drive by [s], where messages come often."""
_MISSED = 5
"""Messages in a row that may be lost where they come seldom."""
_SETTLED = 5
"""Number of fresh messages in a row from a standing robot before it is driven."""
_MOVING = 0.05
"""A robot faster than this is not taken over [m/s, rad/s]."""
_SAME_CLOCK = 5.0
"""Greatest difference between the stamps of a tracking system and of the feedback, if they are of
one clock [s]."""
_ASTRAY = 0.5
"""Greatest distance from the path, beyond the look-ahead [m], and greatest turn off the beginning
of a path that has a frame [rad]."""
_ANSWER = 0.5
"""Time after its dead time within which a robot that starts has its speed [s]."""
_NEAR = 0.05
"""Distance of a target that is reached again [m]."""
_GENTLE_BEND = 1.0
"""Radius of the bend that is always allowed then at the path's greatest speed [m], so that a
straight path can be found."""
_AT_REST = 0.005
"""Distance before or behind the last waypoint at which it may rest [m]."""
_SETTLING = 3.0
"""Longest time for which a robot that comes no nearer to its end is driven on after it [s]."""
_AROUND = 2.0
"""Time about that of the hold within which a held robot's place on its path lies [s]."""
DEAF = 10.0
"""Time for which a robot is held whose motion is not known [s]."""
_PROBE = 0.05
"""Speed by which a held robot is asked whether it moves [m/s]."""
_PROBE_WAY = 0.1
"""Way that all such probes of a hold may take together [m]."""
_PROBE_TIME = 0.8
"""Length of a probe [s]; as long again twice over it stands."""
STOP_ON = "the emergency stop is on"
STOP_OFF = "the emergency stop was released: confirm that the robot may go on"
NO_MOTION = "no motion is seen where it is told to move"


class StoppedError(SsmrError):
    """The robot was stopped before the reference's end; the message says why."""


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
        auto_restart: bool = False,
        framed: bool = False,
    ) -> None:
        """Design the law and compile the loops, so that nothing is slow once the robot moves.

        The reference begins at the robot's pose, unless it is `framed`: then `place_feedback` says
        where it is, and the robot has to stand near its beginning. A controller that is a Python
        object is made twice: the first one computes one command and is thrown away.

        Args:
            controller: the law.
            waypoints: the reference.
            v_limit: greatest speed ever commanded [m/s], `GENTLE` times the path's if not given.
            w_limit: greatest yaw rate ever commanded [rad/s].
            lookahead: distance that the robot keeps behind its target [m].
            patience: time for which a robot under an emergency stop is waited for [s].
            auto_restart: whether a held robot goes on without a confirmation; one that did not
                move is asked by creeping, over 0.1 m at most.
            framed: whether the reference has a frame of its own.

        Raises:
            ControllerError: the object cannot be made, or gives no command.
            ValueError: a number out of its range, gains that the law refuses, or a reference faster
                than the limit.
        """
        course = waypoints.course()
        fastest = float(np.abs(course["v"]).max())
        waypoints = waypoints.braked(BRAKING)
        drive = controller.drive
        self.v_limit, self.w_limit = _limits_of_drive(drive, fastest, v_limit, w_limit)
        self.lookahead = lookahead
        self.controller = controller.on(replace(drive, v_max=self.v_limit, w_max=self.w_limit))
        self.waypoints = waypoints
        self.phase = "waiting"
        """Phase of the drive: waiting, driving or arrived."""
        self.why_waiting = "no feedback yet"
        self.unplaced = "nobody says where the feedback is" if framed else ""
        """Why the feedback's frame has no place in the reference's, where it needs one."""
        self.held = ""
        """Why the robot is held; empty while it is not."""
        self.held_time = self.late = 0.0
        """Time for which the robot was held, and by which it answers later than its drive says,
        messages included [s]."""
        start = waypoints.start
        self._origin = np.array([start.x, start.y, start.yaw])
        self._framed = framed
        self.frame_step = 0.0
        """Greatest distance by which the reference's frame moved at once [m]."""
        self._stops = self._confirmed = self._gently = False
        self._auto = auto_restart
        self._hold_at = self._probed = self._gently_until = 0.0
        self._patience = patience
        self._clock = SenderClock()
        self._arrival = self._stamp = self._at_stamp = -math.inf
        self._fresh = self._repeated = 0
        self._begin = self._t = self._place = self._advanced_at = self._rests_from = 0.0
        self._at = INITIAL_STATE.seen
        self._to_reference = np.zeros(3)
        self._yaw = start.yaw
        self._times = list[float]()
        self._rows = list[FloatArray]()
        self._poses = list[tuple[float, float, float, float]]()
        self._pose_to_reference: FloatArray | None = None
        self._start_law()
        turn = max(float(np.abs(course["w"]).max()), fastest / _GENTLE_BEND)
        model = self._model
        gains = (model.rate_v / model.push_v, model.rate_w / model.push_w)
        self._gentle = GENTLE * np.multiply((fastest, turn), gains)
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
        self._answer = self._model.horizon + _ANSWER
        self.supervisor = Supervisor(self._model, self.controller.drive.command_half_track)
        """The judge of the robot's signals, which takes those of wheels and gyro."""

    def _run_velocity_loop(self, t: float) -> Command:
        side = self._side
        side.velocity_tick(t + self._clock.lateness, VELOCITY_PERIOD)
        command = side.state.command
        if not side.tracker.predicts:
            remember_command(
                side.tracker.past, side.tracker.predictor_state, *command, t + self._clock.lateness
            )
        return command

    def _run_position_loop(self, seen: Observation, t: float, dt: float) -> FloatArray:
        """What a run records of this step; lateral speed, wheels and torques are not known."""
        side = self._side
        tracker = side.tracker
        memory = tracker.predictor_state
        if not isinstance(side, PythonSide):  # that one knows when its command is sent
            horizon = self._model.horizon + self._clock.lateness
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

        A message that is not newer than the last one, or is not finite, changes nothing. Neither
        does a pose that does not follow from the last one and the speeds.

        Raises:
            StoppedError: the sender's clock jumped, the signals contradict each other, the robot
                was held for too long, or it is farther from its path than it may be.
            ControllerError: the controller failed.
        """
        dt = stamp - self._stamp
        if not (dt > 0.0 and all(map(math.isfinite, seen))):
            self._repeated += 1
            return
        self._stamp = stamp
        self._arrival = now
        self._repeated = 0
        self._clock.take(stamp, now - stamp)
        if self.phase == "waiting":
            self._start_if_settled(seen, dt)
        if self.phase != "driving":
            return
        if dt >= self.patient:
            raise StoppedError(f"the stamps of the feedback jumped by {dt:.3f} s")
        follows = self.supervisor.judge_pose(self._at, seen, stamp - self._at_stamp)
        if self.supervisor.contradictions > SURE - 1:
            raise StoppedError(self.supervisor.away)
        if follows:
            self._at = seen
            self._at_stamp = stamp
        if self.held:
            self._wait_for_restart(stamp, seen)
        if self.held or not follows:
            return
        t = stamp - self._begin - self.held_time
        on_reference = self._on_reference(seen)
        self._rows.append(self._run_position_loop(on_reference, t, dt))
        self._times.append(t)
        self._t = t
        self._judge_motion(stamp, seen, dt)
        if not self.held:
            self._go_on(t, on_reference)

    def _on_reference(self, seen: Observation) -> Observation:
        """Return the robot on its reference, with a yaw that goes on from the last (Sec. 4.2)."""
        x, y, yaw = compose_poses(self._to_reference, np.array(seen[:3])).tolist()
        self._yaw += float(wrap_angle(yaw - self._yaw))
        return Observation(x, y, self._yaw, seen.v, seen.w)

    def place_feedback(self, pose: FloatArray) -> None:
        """Take the (3,) pose of the feedback's frame in that of the reference [m, m, rad].

        Where it moves, the robot did not.
        """
        self.unplaced = ""
        before = self._on_reference(self._at)
        self._to_reference = pose
        now = self._on_reference(self._at)
        # where the predictor saw it last
        self._side.tracker.predictor_state[LEARNT - 3 : LEARNT] = now[:3]
        if self.phase == "driving":
            self.frame_step = max(self.frame_step, math.dist(now[:2], before[:2]))

    @property
    def patient(self) -> float:
        """Age from which feedback is too old to drive by [s]."""
        return max(FRESH, self._clock.longest_silence(_MISSED))

    def _go_on(self, t: float, seen: Observation) -> None:
        """Judge where the robot is on the reference: astray, near its target, or at its rest."""
        place, off = self._nearest_place(self._place, seen)
        if place > self._place + 1e-6 or t < self.waypoints.duration:  # not by rounding
            self._advanced_at = t
        self._place = max(place, self._place)
        if off > _ASTRAY + self.lookahead:
            raise StoppedError(
                f"the robot is {off:.2f} m from its path at t = {t:.2f} s (at most {_ASTRAY:g} m)"
                + f"; the path's frame moved by {self.frame_step:.2f} m" * self._framed
            )
        aim = self._side.state.target
        away = math.hypot(seen.x - aim.x, seen.y - aim.y)
        if t > self._gently_until and away <= _NEAR + self.lookahead:
            self._gently = False
        if t > _SETTLING:  # motors at their limit at a start are no lateness
            learnt_delay = float(self._side.tracker.predictor_state[LEARNT])
            self.late = learnt_delay + self._clock.lateness
        ahead = self._side.state.errors.rho - self.lookahead  # a robot that stands mends no other
        rests = self._speed_of(seen.v, seen.w) < _MOVING and abs(ahead) <= _AT_REST
        ended = t >= self.waypoints.duration - 1e-9
        if not (ended and rests):
            self._rests_from = t
        if t - self._advanced_at >= _SETTLING or t - self._rests_from >= self._answer:
            self.phase = "arrived"

    def _nearest_place(self, t: float, seen: Observation) -> tuple[float, float]:
        """Return the time of the path's pose nearest to the robot, and its path's distance [m].

        That is looked for about the time `t` [s]; a path may cross itself. Where the target stands,
        the clock says how long.
        """
        around = np.arange(-_AROUND, _AROUND, 0.01)
        times = np.clip(t + around, 0.0, self.waypoints.duration)
        aims = targets_at(self._side.tracker.course, times)
        distances = np.hypot(aims[:, 0] - seen.x, aims[:, 1] - seen.y)
        turned = self.controller.drive.command_half_track * wrap_angle(aims[:, 2] - seen.yaw)
        off = np.hypot(distances, turned)
        alike = times[off <= off.min() + 1e-6]
        nearest = max(int(np.searchsorted(alike, self._t, side="right")) - 1, 0)
        return float(alike[nearest]), float(distances.min())

    def _speed_of(self, v: float, w: float) -> float:
        """Return the speed [m/s] of the faster side's wheels, but for the sign of the bend."""
        return math.hypot(v, self.controller.drive.command_half_track * w)

    def _judge_motion(self, stamp: float, seen: Observation, dt: float) -> None:
        """Hold a robot that does not move, and stop one that moves otherwise than by commands."""
        memory = self._side.tracker.predictor_state
        self.supervisor.judge_motion(stamp, seen, memory, dt)
        cause = self.supervisor.cause_of_motion(seen)
        if not cause:
            return
        stands = self._speed_of(seen.v, seen.w) < _MOVING
        if stands and self._speed_of(*self._side.state.command) >= _MOVING:
            self._hold(NO_MOTION)
            return
        raise StoppedError(cause)

    def take_stop(self, stops: bool) -> None:
        """Hold the robot where the emergency stop is on, however short, until somebody confirms."""
        if stops:
            self._hold(STOP_ON)
            self._confirmed = False
        elif self.held == STOP_ON:
            self.held = STOP_OFF
        self._stops = stops

    def confirm(self, said: bool = True) -> None:
        """Let a held robot go on, once it stands and its emergency stop is off."""
        self._confirmed |= said and bool(self.held) and not self._stops

    def _hold(self, why: str) -> None:
        """Command a robot that is driven to stand, from now on."""
        if self.phase != "driving":
            return
        if not self.held:
            self._hold_at = self._stamp
            self._probed = 0.0
            self._confirmed = False
        self.held = why

    def _wait_for_restart(self, stamp: float, seen: Observation) -> None:
        """Let a held robot go on if it may, or give it up."""
        stands = self._speed_of(seen.v, seen.w) < _MOVING
        blind = self.held == NO_MOTION
        if self._auto and not self._stops:
            moves = self._probed > 0.0 and self._speed_of(seen.v, seen.w) > 0.5 * _PROBE
            self._confirmed = moves or not blind
            stands = stands or blind
        if self._confirmed and stands and not self._stops:
            self._restart(stamp, seen)
            return
        waited = stamp - self._hold_at
        if waited > (min(DEAF, self._patience) if blind else self._patience):
            raise StoppedError(f"the robot was held for {waited:.0f} s ({self.held})")
        self.held_time = stamp - self._begin - self._t

    def _restart(self, stamp: float, seen: Observation) -> None:
        """Go on from the place of the path that is nearest to the robot, which stands there."""
        at = self._on_reference(seen)._replace(v=0.0, w=0.0)
        t, _ = self._nearest_place(self._place, at)
        while self._times and self._times[-1] >= t:
            self._times.pop()
            self._rows.pop()
        self.held_time = stamp - self._begin - t
        while self._poses and self._poses[-1][0] - self._begin >= t:
            self._poses.pop()
        tracker = self._side.tracker
        stop_model(tracker.past, tracker.predictor_state, t, at)
        self.supervisor.restart()
        self._gently = True
        self._gently_until = t + self._answer
        self._confirmed = False
        self.held = ""

    def _start_if_settled(self, seen: Observation, dt: float) -> None:
        """Drive a robot that stands and whose feedback comes steadily."""
        obstacle = ""
        if not 0.0 < dt < FRESH:
            obstacle = "the feedback does not come steadily"
        elif self._stops:
            obstacle = "the emergency stop is on"
        elif abs(seen.v) > _MOVING or abs(seen.w) > _MOVING:
            obstacle = f"the robot moves ({seen.v:.2f} m/s, {seen.w:.2f} rad/s)"
        elif self._framed:
            obstacle = self.unplaced or self._away_from_beginning(seen)
        if obstacle:
            self.why_waiting = obstacle
            self._fresh = 0
            return
        self._fresh += 1
        if self._fresh < _SETTLED:
            return
        pose = np.array(seen[:3])
        if not self._framed:
            self._to_reference = compose_poses(self._origin, invert_pose(pose))
        self._gently = self._framed
        self._yaw = float(self._origin[2])
        self._begin = self._stamp
        self.phase = "driving"
        self._at = seen
        self._at_stamp = self._stamp
        if self._poses and abs(self._poses[0][0] - self._stamp) <= _SAME_CLOCK:
            pose = compose_poses(self._to_reference, pose)
            self._pose_to_reference = compose_poses(pose, invert_pose(self._poses[0][1:]))

    def _away_from_beginning(self, seen: Observation) -> str:
        """Return a sentence on a robot that does not stand at the beginning of a framed path."""
        x, y, self._yaw = self._origin.tolist()
        at = self._on_reference(seen)
        off = math.dist(at[:2], (x, y))
        turned = at.yaw - self._origin[2]
        if off <= _ASTRAY and abs(turned) <= _ASTRAY:
            return ""
        return (
            f"the robot stands {off:.2f} m and {turned:.2f} rad from the beginning of its path "
            f"(at most {_ASTRAY:g} m and rad)"
        )

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
        if age > self.patient:
            why = fault
            if self._repeated and not fault:
                why = f"{self._repeated} messages are not newer than {self._stamp:.3f} s"
            if why:
                raise StoppedError(f"no feedback that can be used for {age:.2f} s: {why}")
            raise StoppedError(f"no feedback for {age:.2f} s")
        v, w = self._unlimited_twist(self._stamp - self._begin - self.held_time + age)
        if not (math.isfinite(v) and math.isfinite(w)):
            raise StoppedError(f"the controller asks for {v} m/s and {w} rad/s")
        if self._gently:  # both become less by one share, so that the bend stays
            most = self._gentle / np.maximum(np.abs((v, w)), 1e-9)
            v, w = min(1.0, *most) * np.array([v, w])
        limits = np.array([self.v_limit, self.w_limit])
        sent = Command(*np.clip((v, w), -limits, limits).tolist())
        self._side.state = self._side.state._replace(command=sent)
        self._side.tracker.past[-1] = sent
        return sent

    def _unlimited_twist(self, t: float) -> Twist:
        """The law's output at mission time `t` [s]; of a held robot a stop, or a probe."""
        if not self.held:
            return self._run_velocity_loop(t)
        since = self._stamp - self._hold_at
        asks = self._auto and self.held == NO_MOTION and self._probed < _PROBE_WAY
        if not asks or since % (3.0 * _PROBE_TIME) < 2.0 * _PROBE_TIME:
            return STAND_STILL
        self._probed += _PROBE * VELOCITY_PERIOD
        forward = self._side.state.target.v >= 0.0
        return (_PROBE if forward else -_PROBE), 0.0

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


def _limits_of_drive(
    drive: Drive, fastest: float, v_limit: float | None, w_limit: float
) -> tuple[float, float]:
    """Return the greatest speed [m/s] and yaw rate [rad/s] that are commanded on a reference.

    Raises:
        ValueError: a number out of its range, or a reference that is `fastest` beyond the limit.
    """
    if v_limit is None:
        v_limit = min(GENTLE * fastest, 10.0)
    if not (0.0 < v_limit <= 10.0 and 0.0 < w_limit <= 10.0):
        raise ValueError(
            f"v_limit = {v_limit:g}, w_limit = {w_limit:g}: both must be positive and at most 10"
        )
    limits = (min(drive.v_max, v_limit), min(drive.w_max, w_limit))
    if fastest > limits[0]:
        raise ValueError(
            f"the reference asks for {fastest:.3g} m/s; the limit is {limits[0]:g} m/s"
        )
    return limits
