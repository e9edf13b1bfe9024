"""The supervisor of a follower: it compares messages with each other and keeps what was driven.

Three pairs of signals must agree: the pose with what the last pose and the speeds predict, the
speeds and the wheels with what the commands predict, and the gyro with the wheels. Each pair is
judged by one rule, whatever the rate of messages: `Gap` sums the way by which two signals come
apart, less what their errors explain.
"""

from __future__ import annotations

import copy
import math
from collections import deque

import numpy as np

from ssmr.control.law import Observation
from ssmr.control.loop import ClosedRun
from ssmr.control.predictor import (
    LATE_FEEDBACK,
    PredictorModel,
    learnt_references,
    modelled_speeds,
)
from ssmr.geometry import wrap_angle
from ssmr.types import FloatArray
from validation.ros.messages import Twist

LATE = 0.15
"""Lateness of the robot's answers that is worth a warning [s]: half of it is what robots take to
speed up."""
GENTLE = 1.2
"""Greatest share of the path's greatest speed and yaw rate at which a robot moves that has just
been started again, until its target is near [1]."""
BRAKING = 0.5
"""Braking of the target at its end [m/s2]."""
SURE = 3
"""Messages in a row that contradict the speeds before a pose counts as wrong: one may be a slip of
the sender. Each that does not makes up for as small a part of one."""
_TAKEN_OVER = 5.0
"""Time constant with which lateness of all messages that are remembered is left to the predictor to
learn [s]."""
_APART = 3.0
"""Time over which the rate of a sender's clock is measured [s]."""
_REMEMBERED = 256
"""Messages by which scatter and the rate of a clock are known."""
_UNKNOWN = 32
"""Messages after which scatter is known: a fault at the start must not pass for it."""
_SCATTER = 3.0 * 1.4826
"""Three standard deviations over the median of absolute values, for normal noise."""
_SLIP = 0.3
"""Greatest lateral speed over yaw rate [m]: wheels slip outwards in bends."""
_GYRO_BIAS = 0.02
"""Greatest error of a gyro that is no fault [rad/s]."""
_LEARNING = 1.0
"""Time constant with which learnt gains are believed [s]: a fault is named before it is learnt."""
_TRUSTED = 3.0
"""Time constant with which a model with learnt gains comes to be trusted [s]."""
_UNMODELLED = 0.03
"""Share of its speed by which a robot then differs from it [1]."""
_TOGETHER = 0.05
"""Greatest time between samples of wheels, gyro and odometry that are compared [s]."""


class Gap:
    """The way by which two signals have come apart beyond what their errors explain.

    It is a cumulative sum (E. S. Page, 1954) in metres or radians, so its verdict depends on how
    far the robot went wrong and not on how often messages come.
    """

    def __init__(self, most: float, leak: float, share: float) -> None:
        """Begin with signals that agree.

        Args:
            most: greatest gap beside three standard deviations of the signals' scatter [m or rad].
            leak: rate at which errors of sensors take signals apart [m/s or rad/s].
            share: the same over the rate of the motion [1].
        """
        self._most = most
        self._leak = leak
        self.part = share
        """Share of the motion that errors explain now [1]."""
        self._changes = np.zeros(_UNKNOWN)
        self._last = np.zeros(1)
        self._scatter = 0.0
        self.size = np.zeros(1)
        """Gap along each axis [m or rad]."""

    def add(self, apart: FloatArray, way: FloatArray | float, dt: float) -> None:
        """Take in that signals came `apart` [m or rad] by a message `dt` [s] after the last.

        Motion that can be wrong by a share went `way` [m or rad] meanwhile, along each axis.
        """
        self._scatter = _SCATTER * np.median(self._changes)
        # arrays are replaced and never written to: a copy of a gap goes on by itself
        change = np.hypot.reduce(apart - self._last) / math.sqrt(2.0)
        self._changes = np.append(self._changes[1 - _REMEMBERED :], change)
        self._last = apart
        total = self.size + apart
        explained = self._leak * dt + self.part * way
        self.size = total - np.clip(total, -explained, explained)

    def share(self) -> float:
        """Return the gap over the greatest that errors explain."""
        return float(np.hypot.reduce(self.size)) / (self._most + self._scatter)


class SenderClock:
    """The clock of a sender beside that of the receiver, told by its messages."""

    def __init__(self) -> None:
        """Begin without a message."""
        self.lateness = 0.0
        """Time by which the newest message came later than the quickest ones [s]."""
        self._known = np.empty((0, 2))
        self._rates = np.empty(0)
        self._latenesses = deque[float](maxlen=_REMEMBERED)
        self._quickest = math.inf

    def take(self, stamp: float, age: float) -> None:
        """Take the `age` [s] of a message of time `stamp` [s].

        The quickest messages tell how the clocks stand to each other. That changes where the
        sender's clock is slow, as on a busy machine: by the median of all rates over a second, or,
        before these are known, by whatever grows less quickly than time. What is left is lateness.
        """
        known = self._known
        self._known = np.append(known[1 - _REMEMBERED :], [(stamp, age)], axis=0)
        if len(known):
            dt = stamp - known[-1, 0]
            self._quickest += self._drift(known, stamp, age) * dt
        self._quickest = min(self._quickest, age)
        self.lateness = min(age - self._quickest, LATE_FEEDBACK)
        self._latenesses.append(self.lateness)

    def _drift(self, known: FloatArray, stamp: float, age: float) -> float:
        """Return the rate [s/s] at which the age of the quickest messages changes now.

        `known` are (n, 2) stamps and ages of the messages before.
        """
        before = int(np.searchsorted(known[:, 0], stamp - _APART, side="right")) - 1
        if before >= 0:
            begin, age_then = known[before]
            rate = (age - age_then) / (stamp - begin)
            self._rates = np.append(self._rates[1 - _REMEMBERED :], rate)
        if not len(self._rates):
            step = (age - known[-1, 1]) / (stamp - known[-1, 0])
            return step if 0.0 < step <= 0.8 else 0.0
        rate = float(np.median(self._rates))
        scatter = np.median(np.abs(self._rates - rate))
        if abs(rate) * math.sqrt(len(self._rates)) < 2.0 * _SCATTER * scatter:
            rate = 0.0  # within six standard errors: it is asked at every message
        line = known[:, 1] + rate * (stamp - known[:, 0])
        return rate + max(float(line.min()) - self._quickest, 0.0) / _TAKEN_OVER

    def longest_silence(self, messages: int) -> float:
        """Return the time in which so many messages come, those that are late among them [s]."""
        if len(self._known) < 2:
            return 0.0
        periods = np.diff(self._known, axis=0)[:, 0]
        return messages * float(np.median(periods)) + max(self._latenesses)


class Supervisor:
    """What a follower knows of its robot by comparing its signals with each other.

    A cause is a sentence; it is empty where the signals agree.
    """

    def __init__(self, model: PredictorModel, half_track: float) -> None:
        """Begin with signals that agree.

        Args:
            model: the robot as its controller knows it.
            half_track: lever of the wheels in the driver [m].
        """
        self._ratios = np.array([model.rate_v / model.push_v, model.rate_w / model.push_w])
        self._levers = half_track * np.array([-1.0, 0.0, 1.0])
        self._place = Gap(0.1, 0.02, 0.25)
        self._heading = Gap(0.15, 0.03, 0.25)
        self._speeds = Gap(0.05, 0.02, 0.1)
        self._gains = np.ones(2)
        self._wheels = Gap(0.012, 0.01, 0.03)
        self._gyro = Gap(0.05, _GYRO_BIAS, 0.05)
        self._turned: tuple[float, Twist] = (-math.inf, (0.0, 0.0))
        self._gyro_stamp = -math.inf
        self._gyro_rate = 0.0
        self._last_pair = -math.inf
        self.contradictions = 0.0
        """Number of poses lately that did not follow from the speeds [1]."""
        self.away = ""
        """Sentence on the first of these poses: how it contradicts the speeds."""
        self._wheels_lie = False

    def restart(self) -> None:
        """Begin again, with a robot that stands."""
        for gap in (self._place, self._heading, self._speeds, self._wheels, self._gyro):
            gap.size = np.zeros(1)
        self.contradictions = 0.0

    def take_wheels(self, stamp: float, twist: Twist) -> None:
        """Take speed and yaw rate by the wheels alone of time `stamp` [s]."""
        self._turned = (stamp, twist)

    def take_gyro(self, stamp: float, w: float) -> None:
        """Take the gyro's yaw rate [rad/s] of time `stamp` [s]."""
        self._gyro_stamp = stamp
        self._gyro_rate = w

    def judge_pose(self, before: Observation, seen: Observation, dt: float) -> bool:
        """Return whether a pose follows from that `before` and the speeds, `dt` [s] later.

        One that does not is forgotten: with poses of two senders in turn, those of one follow, and
        the others' distance is no scatter.
        """
        gaps = (copy.copy(self._place), copy.copy(self._heading))
        v = 0.5 * (before.v + seen.v)
        w = 0.5 * (before.w + seen.w)
        turn = wrap_angle(seen.yaw - before.yaw)
        yaw = before.yaw + 0.5 * dt * w
        way = dt * v * np.array([math.cos(yaw), math.sin(yaw)])
        # speeds between messages are not known, and wheels slip aside
        unknown = 2.0 * abs(seen.v - before.v) + 4.0 * _SLIP * abs(w)
        self._place.add(np.subtract(seen[:2], before[:2]) - way, dt * (abs(v) + unknown), dt)
        turned = dt * (abs(w) + 2.0 * abs(seen.w - before.w))
        self._heading.add(np.array([turn - dt * w]), turned, dt)
        place = self._place.share()
        heading = self._heading.share()
        if max(place, heading) <= 1.0:
            self.contradictions = max(self.contradictions - 1.0 / SURE, 0.0)
            return True
        self.contradictions += 1.0
        if self.contradictions == 1.0:
            self.away = (
                "the pose jumped, or stayed behind, by "
                f"{np.hypot.reduce(self._place.size):.2f} m: its speeds say {seen.v:.2f} m/s"
            )
            if heading > place:
                self.away = (
                    f"the heading jumped, or stayed behind, by {self._heading.size[0]:.2f} rad: "
                    f"its rates say {seen.w:.2f} rad/s"
                )
        self._place, self._heading = gaps
        return False

    def judge_motion(self, stamp: float, seen: Observation, memory: FloatArray, dt: float) -> None:
        """Compare speeds and wheels of time `stamp` [s], `dt` [s] after the last, with commands.

        `memory` is that of the predictor. How late the robot answers is not known, so all that it
        may do within the delays that a predictor tries is right. It does so with the gains that
        were learnt before.
        """
        model = modelled_speeds(memory)
        self._compare_sides(self._speeds, (seen.v, seen.w), model * self._gains[:, None], dt)
        learnt = learnt_references(memory)
        share = min(dt / _LEARNING, 1.0)
        self._gains += share * (np.array([learnt.gain_v, learnt.gain_w]) - self._gains)
        self._speeds.part += min(dt / _TRUSTED, 1.0) * (_UNMODELLED - self._speeds.part)
        turned_at, twist = self._turned
        if abs(turned_at - stamp) <= _TOGETHER:
            self._compare_sides(self._wheels, twist, model * self._ratios[:, None], dt)
        if abs(turned_at - self._gyro_stamp) > _TOGETHER or turned_at <= self._last_pair:
            return
        passed = min(turned_at - self._last_pair, dt)
        self._last_pair = turned_at
        expected = twist[1] / self._ratios[1]
        by_command = min(max(self._gyro_rate, model[1].min()), model[1].max())
        off = abs(self._gyro_rate - expected)
        self._wheels_lie = off > 2.0 * abs(self._gyro_rate - by_command) + _GYRO_BIAS
        apart = np.array([passed * (self._gyro_rate - expected)])
        # tyres of two sides differ by some hundredths
        most = (abs(twist[0]) / self._levers[2] + abs(twist[1])) / self._ratios[1]
        self._gyro.add(apart, passed * most, passed)

    def _compare_sides(self, gap: Gap, twist: Twist, model: FloatArray, dt: float) -> None:
        """Compare the speeds of both sides and of the middle with those of a model.

        Any of its (2, n) speeds and yaw rates may be right.
        """
        seen = twist[0] + self._levers * twist[1]
        sides = model[0] + self._levers[:, None] * model[1]
        low = np.minimum(seen - sides.min(axis=1), 0.0)
        high = np.maximum(seen - sides.max(axis=1), 0.0)
        gap.add(dt * (low + high), dt * np.abs(sides).max(axis=1), dt)

    def cause_of_motion(self, seen: Observation) -> str:
        """Return why the robot does not move as it is told, once that is sure."""
        moves = f"({seen.v:.2f} m/s, {seen.w:.2f} rad/s)"
        side = _one_side(self._wheels)  # of the body's speeds none is a side's alone
        if side and self._wheels_lie:
            return f"the encoder of the {side} wheels contradicts gyro and commands"
        if side:
            return f"the {side} side does not turn as commanded {moves}: its motor or its encoder"
        shares = (self._gyro.share(), self._speeds.share(), self._wheels.share())
        if max(shares) <= 1.0:
            return ""
        if self._wheels_lie:
            return "wheels and gyro contradict each other, and the gyro agrees with the commands"
        return (
            f"the robot moves otherwise than by its commands {moves}: does somebody else drive it?"
        )


def _one_side(gap: Gap) -> str:
    """Return the side to which a gap between both sides' speeds is confined, or nothing."""
    if gap.share() <= 1.0:
        return ""
    left, _, right = np.abs(gap.size)
    if min(left, right) > max(left, right) / 6.0:
        return ""
    return "left" if left > right else "right"


def even_run(
    times: FloatArray, rows: FloatArray, seen_at: FloatArray, motion: FloatArray
) -> ClosedRun:
    """Return a drive at even instants: (N, 26) `rows` at their times [s], the newest of each.

    Its (M, 3) poses are those of `motion`, seen at (M,) times [s].
    """
    period = float(np.median(np.diff(times)))
    count = int(times[-1] / period + 1e-6) + 1
    t = period * np.arange(count, dtype=np.float64)
    before = np.searchsorted(times, t + 1e-9, side="right") - 1
    table: FloatArray = rows[before]
    for k in range(3):
        table[:, k] = np.interp(t, seen_at, motion[:, k])
    return ClosedRun(t, table, lost=False)
