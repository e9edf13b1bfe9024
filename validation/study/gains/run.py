"""Drive every shipped set of gains along the thesis' sample trajectories, at both of its speeds."""

from __future__ import annotations

from ssmr.control.laws import CONTROLLERS
from validation.plants.profile import PLANTS
from validation.progress import Progress, Report, silent
from validation.study.gains.result import GainScore, GainsOptions, GainStudy
from validation.study.result import keeping, profile_of
from validation.study.scores import score_all
from validation.track.gains import load_gains, names, profile_sets
from validation.track.loops import make_controller, make_robot
from validation.track.waypoint_files import SAMPLES, open_reference

GAIN_SPEEDS = (0.25, 0.5)
"""Speeds of the thesis [m/s]."""


def study_gains(options: GainsOptions | None = None, *, workers: int | None = None, progress: Report = silent) -> GainStudy:
    """Drive every shipped set of gains along the thesis' sample trajectories.

    Args:
        options: profile, plants and seeds; the defaults if not given.
        workers: number of threads, all processors if not given; the result does not depend on it.
        progress: called after each reference.

    Raises:
        ValueError: profile or plant do not exist.
    """
    o = options or GainsOptions()
    profile, seeds = profile_of(o.profile, o.robot), range(o.seed, o.seed + o.seeds)
    unknown = [plant for plant in o.plants if plant not in PLANTS]
    if unknown:
        raise ValueError(f"unknown plant '{', '.join(unknown)}'; there are: {', '.join(PLANTS)}")
    sets = [load_gains(name.rpartition("-")[0], name) for name in names()]
    sets += [load_gains(law, profile.name) for law in CONTROLLERS if profile.name in profile_sets(law)]
    laws = [make_controller(profile, g) for g in sets]
    robots = {plant: make_robot(profile, plant) for plant in o.plants}
    places = [(plant, reference, speed) for plant in o.plants for reference in SAMPLES for speed in GAIN_SPEEDS]
    scores = list[GainScore]()
    with keeping(scores) as course:
        for done, (plant, reference, speed) in enumerate(places):
            progress(Progress(done, len(places), f"{plant}, {reference} {speed:g}"))
            _, waypoints = open_reference(reference, speed)
            found = score_all(robots[plant], laws, waypoints, seeds, workers)
            scores += [GainScore(**vars(f), gains=g.name, plant=plant, reference=reference, speed=speed)
                       for g, f in zip(sets, found, strict=True)]  # fmt: skip
    return GainStudy(profile.name, o, tuple(scores), robot=profile.robot.name, status=course.status)
