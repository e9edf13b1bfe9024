"""Drive every controller along every reference, on every plant."""

from __future__ import annotations

from dataclasses import replace

from validation.bench.loops import make_robot
from validation.progress import Progress, Report, silent
from validation.study.result import keeping, profile_of
from validation.study.scores import score_all
from validation.study.transfer.contenders import (
    TRANSFER_PROFILES,
    TransferOptions,
    contenders_of,
    gains_by_name,
    missions_of,
)
from validation.study.transfer.field import TransferDrive, TransferField
from validation.study.transfer.result import TransferStudy


def study_transfer(
    options: TransferOptions | None = None, *, workers: int | None = None, progress: Report = silent
) -> TransferStudy:
    """Let every controller follow every reference on every plant, and see whether the plants choose the same ones.

    Args:
        options: profiles, plants, controllers, references and seeds; the usual ones if not given.
        workers: number of threads, all processors if not given; the result does not depend on it.
        progress: called before each plant drives a reference.

    Raises:
        ControllerError: a user's controller failed.
        ValueError: a profile, plant, controller, gains or reference do not exist or do not go together.
    """
    o = options or TransferOptions()
    named = o.profiles or ((None,) if o.robot is not None else TRANSFER_PROFILES[:1] if o.quick else TRANSFER_PROFILES)
    profiles = [profile_of(one, o.robot) for one in named]
    robots = [{plant: make_robot(profile, plant) for plant in o.plant_names} for profile in profiles]
    fields = [contenders_of(o, profile) for profile in profiles]
    missions = [missions_of(o, made[o.judge]) for made in robots]
    total, done = len(o.plant_names) * sum(map(len, missions)), 0
    seeds, found = range(o.seed, o.seed + o.seeds), list[TransferDrive]()
    with keeping(found) as course:
        for profile, made, field, some in zip(profiles, robots, fields, missions, strict=True):
            laws = [contender.law for contender in field.values()]
            for name, waypoints in some:
                scores = {}
                for plant, robot in made.items():
                    progress(Progress(done, total, f"{profile.name}, {name} {waypoints.speed:.2g}, {plant}"))
                    scores[plant] = dict(zip(field, score_all(robot, laws, waypoints, seeds, workers), strict=True))
                    done += 1
                found.append(TransferDrive(profile.name, name, waypoints.speed, scores))
    drawn = [
        TransferField(
            profile.name,
            profile.robot.name,
            {name: contender.foresees for name, contender in field.items()},
            gains_by_name(field),
            tuple(drive for drive in found if drive.profile == profile.name),
            replace(o, profiles=()),
        )
        for profile, field in zip(profiles, fields, strict=True)
    ]
    kept = tuple(field for field in drawn if field.drives)
    return TransferStudy(o, kept, robot=profiles[0].robot.name, status=course.status)
