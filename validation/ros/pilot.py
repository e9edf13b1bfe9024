"""A trajectory tracker for a robot that answers by messages: it decides when to start, what to command and when to stop.

The position loop runs with each message that tells the robot's pose, the velocity loop at the instants of its own clock
(Sec. 4.3.2). Mission time is counted by the messages' stamps, so target and observation belong to one instant, however long
the message took. The receiver's own clock watches that messages still come. There is no ROS in this module.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from ssmr.control.law import Command, Observation
from ssmr.control.loop import Clock, ClosedRun, LoopSettings, make_trackers, tracker_of
from ssmr.control.mission import PythonController
from ssmr.control.steered import Steered, mission_of
from ssmr.control.tick import (
    FRESH_MIND,
    LOG_COLUMNS,
    LOST,
    Mind,
    Tracker,
    Truth,
    is_lost,
    position_tick,
    record,
    velocity_tick,
)
from ssmr.control.waypoints import Waypoints
from ssmr.errors import ControllerError, SsmrError
from ssmr.geometry import compose, invert, wrap_angle
from ssmr.parameters import require_in_range
from ssmr.types import FloatArray
from validation.bench.loops import AnyController
from validation.ros.commands import STAND_STILL, Twist
from validation.ros.messages import Seen

FRESH = 0.5
"""Age from which feedback is too old to drive by [s]."""
_MOVING = 0.05
"""A robot faster than this is not taken over [m/s, rad/s]."""
_SAME_CLOCK = 5.0
"""Greatest difference between the stamps of a tracking system and of the feedback, if they are of one clock [s]."""
_AT_START = 0.5
"""Greatest distance of the robot from the reference's start with `absolute` [m]."""


class StoppedError(SsmrError):
    """The robot was stopped before the reference's end; the message says why."""


class Phase(Enum):
    """State of a pilot."""

    WAITING = "waiting"
    DRIVING = "driving"
    ARRIVED = "arrived"


@dataclass(frozen=True)
class PilotSettings:
    """Limits and periods of a pilot."""

    period: float = 0.05
    """Period of commands and of the velocity loop [s]; a Husky reads 20 commands a second."""
    v_limit: float = 1.0
    """Greatest speed ever commanded [m/s]."""
    w_limit: float = 1.0
    """Greatest yaw rate ever commanded [rad/s]."""
    lookahead: float = 0.0
    """Distance that the robot keeps behind its target [m]."""
    absolute: bool = False
    """True if waypoints are places in the feedback's frame; else the reference begins at the robot's pose."""
    settled: int = 5
    """Number of fresh messages in a row from a standing robot before it is driven."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a number out of its range."""
        require_in_range(self, "period", 0.0, 1.0, open_low=True)
        require_in_range(self, "v_limit", 0.0, 10.0, open_low=True)
        require_in_range(self, "w_limit", 0.0, 10.0, open_low=True)
        require_in_range(self, "lookahead", 0.0, LOST / 2.0)


class _Frame:
    """Turns the poses of one sender into the reference's frame, with yaw unwrapped."""

    def __init__(self, to_reference: FloatArray) -> None:
        self._to_reference = to_reference
        self._yaw: float | None = None

    @classmethod
    def onto(cls, start: FloatArray, seen: Seen) -> _Frame:
        return cls(compose(start, invert(np.array([seen.x, seen.y, seen.yaw]))))

    def take(self, seen: Seen) -> FloatArray:
        """Return the (3,) pose, its yaw unwrapped from the last one (Sec. 4.2)."""
        yaw = seen.yaw if self._yaw is None else self._yaw + float(wrap_angle(seen.yaw - self._yaw))
        self._yaw = yaw
        return compose(self._to_reference, np.array([seen.x, seen.y, yaw]))


class Pilot:
    """One mission: takes messages and gives commands."""

    def __init__(self, controller: AnyController, waypoints: Waypoints, settings: PilotSettings) -> None:
        """Design the law and compile the loops, so that nothing is slow once the robot moves.

        A controller that is a Python object is made twice: the first one is asked for a command and thrown away.

        Raises:
            ControllerError: the object cannot be made, or gives no command.
            ValueError: gains that the law refuses, or a reference faster than the limit.
        """
        fastest = float(waypoints.segment_speeds.max())
        if fastest > settings.v_limit:
            raise ValueError(f"the reference asks for {fastest:.3g} m/s; the limit is {settings.v_limit:g} m/s")
        drive = controller.drive
        v_max, w_max = min(drive.v_max, settings.v_limit), min(drive.w_max, settings.w_limit)
        self._controller = controller.on(replace(drive, v_max=v_max, w_max=w_max))
        self.name = controller.name
        """Name of the controller."""
        self.waypoints, self.settings = waypoints, settings
        self.phase = Phase.WAITING
        self.why_waiting = "no feedback yet"
        self._arrival = self._stamp = -math.inf
        self._fresh, self._repeated, self._begin = 0, 0, 0.0
        self._mind: Mind = FRESH_MIND
        self._times: list[float] = []
        self._rows: list[FloatArray] = []
        self._tracked: list[FloatArray] = []
        self._last_tracked: Seen | None = None
        self._tracked_frame: _Frame | None = None
        self._frame = _Frame(np.zeros(3))
        self._tracker, self._steered = self._begin_law()
        self._run_tick(FRESH_MIND.seen, 0.0, 0.02)
        self._ask(0.0)
        is_lost(0.0, 0.0, 0.0, 0.0, 0.0)
        self._tracker, self._steered = self._begin_law()
        self._mind = FRESH_MIND

    def _begin_law(self) -> tuple[Tracker, Steered | None]:
        """Return the law's side with an empty memory, and the object of a controller that is one."""
        s, law = self.settings, self._controller
        around = LoopSettings("truth", disturbance=False, lookahead=s.lookahead, velocity_period=s.period)
        clock = Clock(s.period, 1, 1, 1)  # the messages' stamps tell the time, so only the law and the course matter
        tracker = tracker_of(make_trackers([law], [around], self.waypoints, clock, self.waypoints.start), 0)
        if not isinstance(law, PythonController):
            return tracker, None
        return tracker, Steered(tracker, law, mission_of(law, self.waypoints, around))

    def _ask(self, t: float) -> Command:
        """Return the law's command of mission time `t` [s]."""
        if self._steered is not None:
            self._steered.command(t)
            self._mind = self._steered.mind
        else:
            self._mind = velocity_tick(self._tracker, self._mind, t, self.settings.period)
        return self._mind.command

    def _run_tick(self, seen: Observation, t: float, dt: float) -> FloatArray:
        """Run the position loop and return what a run records of it; lateral speed, wheels and torques are not known."""
        if self._steered is not None:
            self._steered.see(seen, t)
            self._mind = self._steered.mind
        else:
            self._mind = position_tick(self._tracker, self._mind, seen, t, dt)
        row = np.empty(len(LOG_COLUMNS))
        truth = Truth(seen.x, seen.y, seen.yaw, seen.v, 0.0, seen.w, 0.0, 0.0, 0.0, 0.0)
        record(row, truth, self._mind)
        return row

    def track(self, seen: Seen) -> bool:
        """Take a pose from a tracking system, for the record and not for the controller.

        Returns:
            False for one that is left out: its stamp does not increase, or is of another clock than the feedback's.
        """
        last = self._last_tracked
        if self._tracked_frame is None:
            self._last_tracked = seen
            return last is None or seen.stamp > last.stamp
        if (last is not None and seen.stamp <= last.stamp) or not self._is_near(seen):
            return False
        self._last_tracked = seen
        self._tracked.append(np.array([seen.stamp - self._begin, *self._tracked_frame.take(seen)]))
        return True

    def _is_near(self, seen: Seen) -> bool:
        return abs(seen.stamp - self._stamp) <= _SAME_CLOCK

    def see(self, seen: Seen, now: float) -> None:
        """Take the robot's pose and speeds, and run the position loop.

        Args:
            seen: pose and speeds, all finite. One with the stamp of the last is the same message again: no news.
            now: time of arrival by the receiver's monotonic clock [s].

        Raises:
            StoppedError: the sender's clock jumped, the robot is farther from its target than it may be, or the controller
                failed.
        """
        dt, self._stamp = seen.stamp - self._stamp, seen.stamp
        if dt == 0.0:
            self._repeated += 1
            return
        self._arrival, self._repeated = now, 0
        if self.phase is Phase.WAITING:
            self._consider(seen, dt)
        elif self.phase is Phase.DRIVING:
            if not 0.0 < dt < FRESH:
                raise StoppedError(f"the stamps of the feedback jumped by {dt:.3f} s")
            self._tick(seen, dt)

    def _consider(self, seen: Seen, dt: float) -> None:
        start = self.waypoints.start
        away = math.hypot(seen.x - start.x, seen.y - start.y)
        if not 0.0 < dt < FRESH:
            self.why_waiting, self._fresh = "the feedback does not come steadily", 0
        elif abs(seen.v) > _MOVING or abs(seen.w) > _MOVING:
            self.why_waiting, self._fresh = f"the robot moves ({seen.v:.2f} m/s, {seen.w:.2f} rad/s)", 0
        elif self.settings.absolute and away > _AT_START:
            self.why_waiting, self._fresh = f"the robot stands {away:.2f} m from the reference's start", 0
        else:
            self._fresh += 1
        if self._fresh < self.settings.settled:
            return
        origin = np.array([start.x, start.y, start.yaw])
        if self.settings.absolute:  # as it is, but for whole turns: yaw begins near the reference's
            turn = start.yaw + float(wrap_angle(seen.yaw - start.yaw)) - seen.yaw
            self._frame = _Frame(np.array([0.0, 0.0, turn]))
        else:
            self._frame = _Frame.onto(origin, seen)
        if self._last_tracked is not None and self._is_near(self._last_tracked):
            here = self._frame.take(seen) if self.settings.absolute else origin
            self._tracked_frame = _Frame.onto(here, self._last_tracked)
        self._begin, self.phase = seen.stamp, Phase.DRIVING
        self._tick(seen, dt)

    def _tick(self, seen: Seen, dt: float) -> None:
        t = seen.stamp - self._begin
        x, y, yaw = map(float, self._frame.take(seen))
        try:
            self._rows.append(self._run_tick(Observation(x, y, yaw, seen.v, seen.w), t, dt))
        except ControllerError as error:
            raise StoppedError(str(error)) from error
        self._times.append(t)
        aim = self._mind.target
        if is_lost(x, y, seen.w, aim.x, aim.y):
            away = math.hypot(x - aim.x, y - aim.y)
            raise StoppedError(f"the robot is {away:.2f} m from its target at t = {t:.2f} s (at most {LOST:g} m)")
        if t >= self.waypoints.duration - 1e-9:
            self.phase = Phase.ARRIVED

    def command(self, now: float, fault: str = "") -> Twist:
        """Run one step of the velocity loop; return v [m/s] and omega [rad/s] to send now.

        Args:
            now: time by the receiver's monotonic clock [s].
            fault: what is wrong with feedback that came and could not be used, if the caller knows.

        Raises:
            StoppedError: the feedback is too old to drive by, the controller failed, or its output is not finite.
        """
        if self.phase is not Phase.DRIVING:
            return STAND_STILL
        if now - self._arrival > FRESH:
            raise StoppedError(self._why_stale(now - self._arrival, fault))
        try:
            v, w = self._ask(self._stamp - self._begin + max(now - self._arrival, 0.0))
        except ControllerError as error:
            raise StoppedError(str(error)) from error
        if not (math.isfinite(v) and math.isfinite(w)):
            raise StoppedError(f"the controller asks for {v} m/s and {w} rad/s")
        s = self.settings
        sent = Command(float(np.clip(v, -s.v_limit, s.v_limit)), float(np.clip(w, -s.w_limit, s.w_limit)))
        self._mind = self._mind._replace(command=sent)
        if self._tracker.predicts:
            self._tracker.past[-1] = sent
        return sent

    def _why_stale(self, age: float, fault: str) -> str:
        if fault:
            return f"no feedback that can be used for {age:.2f} s: {fault}"
        if self._repeated:
            return f"no new feedback for {age:.2f} s: {self._repeated} messages repeat the stamp {self._stamp:.3f} s"
        return f"no feedback for {age:.2f} s"

    @property
    def has_run(self) -> bool:
        """True if the robot was driven long enough for a run."""
        return len(self._times) > 1

    @property
    def tracked(self) -> bool:
        """True if a tracking system saw the whole drive."""
        return bool(self._tracked) and self._tracked[-1][0] >= self._times[-1] - FRESH

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
        for k in range(3):
            table[:, k] = np.interp(t, times, rows[:, k])
        if self.tracked:
            track = np.array(self._tracked)
            for k in range(3):
                table[:, k] = np.interp(t, track[:, 0], track[:, 1 + k])
        return ClosedRun(t, table, lost=False)
