"""Identify a robot's drive train from the commands, wheel rates and currents in its logs."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from validation.progress import Progress, Report, silent
from validation.study.drivetrain.evidence import held_commands, rate_evidence, sensor_of
from validation.study.drivetrain.friction import fitting_rules
from validation.study.drivetrain.inertia import fit_inertia
from validation.study.drivetrain.logs import DriveLog, Resampling, chassis_of, drive_log, guessed_robot
from validation.study.drivetrain.obedience import LEAST_COMMANDS, identify_driver
from validation.study.drivetrain.result import DriveTrainOptions, DriveTrainStudy, Found
from validation.study.drivetrain.selection import identify_friction, require_currents
from validation.study.result import keeping

USUAL_RHO = 0.145
"""Resistance over voltage constant of a Husky's motors, where no log on the ground tells it [rad/s per A]."""
_INERTIA_DRAWS = 10
"""Draws of the transients for each one of the other bootstraps: they cost next to nothing."""


def study_drivetrain(
    options: DriveTrainOptions | None = None, *, workers: int | None = None, progress: Report = silent
) -> DriveTrainStudy:
    """Identify what the driver makes of commands, and friction, losses and inertia, from a robot's logs.

    Args:
        options: the logs, and how often they are resampled; at least one log is needed.
        workers: not used, because one processor is enough.
        progress: called after each fit.

    Raises:
        ValueError: there is no log or no such robot, a log cannot be read, or one lacks what is needed.
    """
    o = options or DriveTrainOptions()
    recording, ground = (None if source is None else drive_log(source) for source in (o.recording, o.ground))
    held_out = [drive_log(source) for source in o.held_out]
    named = [log for log in (recording, ground) if log is not None]
    if not named:
        raise ValueError("the drive train needs a log: recording (wheels in the air), ground, or both")
    if ground is not None:
        require_currents(ground)
    named_robot = o.robot is not None or o.profile is not None
    robot, guess = (o.robot, "") if named_robot else guessed_robot(named[-1])
    chassis = chassis_of(robot, o.profile, o.mass)
    commanded = recording
    if recording is None and len(held_commands(named[0])) >= 2 * LEAST_COMMANDS:
        commanded = ground
    alike = [log for log in held_out if commanded is not None and log.on_ground == commanded.on_ground]
    driven = [log for log in held_out if ground is not None and log.on_ground and log.currents is not None]
    _require_used(held_out, [*alike, *driven])
    rules = 0 if ground is None else len(fitting_rules(sensor_of(ground)))
    total = (commanded is not None) * (o.resamples + 2) + (ground is not None) * (o.resamples + rules) + 1
    done = 0

    def tick(text: str) -> None:
        nonlocal done
        done += 1
        progress(Progress(done, total, text))

    parts = list[Found]()
    with keeping(parts) as course:
        if commanded is not None:
            others = [log for log in named if log is not commanded]
            random = Resampling(np.random.default_rng([o.seed, 1]), o.resamples, partial(tick, "commands and wheel rates"))
            parts.append(driver := identify_driver(commanded, alike, others, chassis, random))
        rho = USUAL_RHO
        if ground is not None:
            random = Resampling(np.random.default_rng([o.seed, 2]), o.resamples, partial(tick, "currents on the ground"))
            parts.append(friction := identify_friction(ground, driven, chassis, random))
            rho = friction.numbers.get("rho", rho)
        if recording is not None and recording.currents is not None and not (recording.on_ground or recording.signed):
            draws = _INERTIA_DRAWS * o.resamples
            found = fit_inertia(recording, driver.law, chassis, rho, np.random.default_rng([o.seed, 3]), draws)
            parts += [] if found is None else [found]
        tick("inertia")
    evidence = tuple(rate_evidence(log) for log in (*named, *held_out))
    return DriveTrainStudy(o, chassis, evidence, tuple(parts), guess, robot=chassis.name, status=course.status)


def _require_used(held_out: Sequence[DriveLog], used: Sequence[DriveLog]) -> None:
    """Refuse a log that could judge nothing.

    Raises:
        ValueError: it is neither like the log that commands are taken from, nor one of the ground with currents.
    """
    for log in held_out:
        if log not in used:
            where = "on the ground" if log.on_ground else "with its wheels in the air (it has no heading)"
            raise ValueError(f"held_out {log.name} was taken {where}, and no log of that kind is studied")
