"""What happens at a tick of many episodes at once: commands become wheel rates, and robots and targets an observation."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ssmr._jit import jit_alone, named_like
from ssmr.control.law import Observation
from ssmr.control.waypoints import Target, position_errors
from ssmr.robot.drive import DRIVE_TEMPLATE, Driven, follow
from ssmr.types import FloatArray

_DRIVEN = Driven(0.0, 0.0, 0.0, 0.0)
ERRORS = 5
"""Numbers of a target in an observation: e_rho, e_y [m], e_alpha [rad], its speed [m/s] and yaw rate [rad/s]."""


class EpisodeRows(NamedTuple):
    """State of S episodes of at most T ticks each; kernels write in place."""

    ticks: Any
    """(S,) number of ticks so far."""
    drives: FloatArray
    """(S, 13) `DriveNumbers`."""
    asked: FloatArray
    """(S, 4) states of the drives."""
    before: FloatArray
    """(S, 2) command until the beginning [m/s, rad/s]."""
    commands: FloatArray
    """(S, T, 2) commands so far [m/s, rad/s]."""
    targets: FloatArray
    """(S, T + 1 + the farthest preview, 5) x, y, heading, speed and yaw rate of the target at each tick."""
    noise: FloatArray
    """(S, T + 1, 5) what the feedback adds to x, y, yaw, v and yaw rate at each tick."""


@jit_alone
def plan_ticks(rows: EpisodeRows, which: Any, actions: FloatArray, references: FloatArray) -> None:
    """Record (k, 2) commands of the robots `which`, and write their drives' (k, n, 2) wheel rates of the n steps to come."""
    for j in range(len(which)):
        i = which[j]
        drive = named_like(DRIVE_TEMPLATE, rows.drives[i])
        rows.commands[i, rows.ticks[i], 0], rows.commands[i, rows.ticks[i], 1] = actions[j, 0], actions[j, 1]
        asked = named_like(_DRIVEN, rows.asked[i])
        before = (rows.before[i, 0], rows.before[i, 1])
        for n in range(references.shape[1]):
            asked = follow(rows.commands[i], rows.ticks[i] * drive.period + n, drive, before, asked)
            references[j, n, 0], references[j, n, 1] = asked.left, asked.right
        rows.asked[i, 0], rows.asked[i, 1], rows.asked[i, 2], rows.asked[i, 3] = asked.v, asked.w, asked.left, asked.right
        rows.ticks[i] += 1


@jit_alone
def write_view(seen: Observation, targets: FloatArray, commands: FloatArray, out: FloatArray) -> None:
    """Write an observation: v and yaw rate, the `ERRORS` of the robot to each target, and the last commands.

    Args:
        seen: the robot as it is seen.
        targets: (p, 5) x, y, heading, speed and yaw rate of the targets, the present one first.
        commands: (m, 2) the last commands, the newest last [m/s, rad/s].
        out: (2 + 5 p + 2 m,) space for the observation.
    """
    out[0], out[1] = seen.v, seen.w
    at = 2
    for p in range(len(targets)):
        t = targets[p]
        errors = position_errors(seen, Target(t[0], t[1], t[2], t[3], t[4], 0), math.inf)
        out[at], out[at + 1], out[at + 2], out[at + 3], out[at + 4] = errors.rho, errors.y, errors.alpha, t[3], t[4]
        at += 5
    for m in range(len(commands)):
        out[at], out[at + 1] = commands[m, 0], commands[m, 1]
        at += 2


@jit_alone
def observe_rows(
    rows: EpisodeRows, qpos: FloatArray, qvel: FloatArray, ahead: Any, bounds: FloatArray, out: FloatArray, away: FloatArray
) -> None:
    """Write the observations of all robots, within their bounds, and their true distances to their targets.

    Args:
        rows: the episodes.
        qpos: (S, nq) MuJoCo's positions; the first seven are the base's place and quaternion.
        qvel: (S, nv) MuJoCo's velocities; the first six are the base's, of which the linear ones are along the world's axes.
        ahead: (p,) ticks from now to each target that is seen.
        bounds: (n,) greatest size of each number of an observation.
        out: (S, n) space for observations.
        away: (S,) space for distances [m]; infinite where the robot is nowhere.
    """
    seen_targets = np.empty((len(ahead), ERRORS))
    past = np.empty(((len(bounds) - 2 - ERRORS * len(ahead)) // 2, 2))
    for i in range(len(out)):
        k, off = rows.ticks[i], rows.noise[i, rows.ticks[i]]
        x, y, (qw, qx, qy, qz) = qpos[i, 0], qpos[i, 1], (qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6])
        yaw = math.atan2(2.0 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz)
        v = math.cos(yaw) * qvel[i, 0] + math.sin(yaw) * qvel[i, 1]
        seen = Observation(x + off[0], y + off[1], yaw + off[2], v + off[3], qvel[i, 5] + off[4])
        for p in range(len(ahead)):
            seen_targets[p] = rows.targets[i, k + ahead[p]]
        for m in range(len(past)):
            since = k - len(past) + m
            past[m] = rows.commands[i, since] if since >= 0 else rows.before[i]
        write_view(seen, seen_targets, past, out[i])
        for n in range(len(bounds)):
            number = out[i, n]
            out[i, n] = min(max(number, -bounds[n]), bounds[n]) if math.isfinite(number) else 0.0
        distance = math.hypot(x - rows.targets[i, k, 0], y - rows.targets[i, k, 1])
        away[i] = distance if math.isfinite(distance) else math.inf
