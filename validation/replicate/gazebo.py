"""Gazebo (Sec. 3.7): the settings of Tab. 3.16 in ODE, Gazebo's engine, with its three friction models.

Gazebo itself does not run. Its Husky, its contacts and its three friction models are handed to the distribution's ODE, see
`validation.engines.ode`. Whether Gazebo 9 still had the friction direction of the Husky's description is not known, so each
model is driven with that direction, and with the one that ODE takes without it. Friction then depends on the heading, and
the time step decides when a wheel hops, so every run starts several times, each a little turned and with another step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ssmr.metrics.declared import compare_paths
from ssmr.types import FloatArray, State, Trajectory
from validation.bench.sources import drive, open_source
from validation.engines.body import EngineMissingError
from validation.engines.ode import GAZEBO, MAKERS_HUSKY, FrictionDirection, FrictionLaw, OdeBody
from validation.engines.ode_library import ode
from validation.engines.plant import EnginePlant
from validation.plants.profile import load_profile, make_plant
from validation.progress import Progress
from validation.replicate.chapters import Findings, Section, Task
from validation.report.columns import METRES
from validation.report.table import Table
from validation.simulator.turning import STRAIGHT_SPEED
from validation.thesis import published
from validation.thesis.verdicts import Pair, Rule

_SOURCE, _SAMPLE, _LEAD = "traj3", 0.05, 3.0
_LAWS: Mapping[str, FrictionLaw] = {"pyramid": "pyramid", "box": "gazebo_box", "cone": "gazebo_cone"}
_DIRECTIONS: Mapping[FrictionDirection, str] = {"wheel": "of the Husky's wheels", "world": "of the world"}
_HARD, _STRAIGHT = 0.5, 0.05
"""Wheels ask for a hard turn if it is at least this share of their hardest [1]; the robot drives straight if it turns at
less than this share of what they ask for [1]."""
_TURNED = 0.035
"""The starts are turned by up to so much to either side [rad]."""


class GazeboRun(NamedTuple):
    """A run on trajectory 3."""

    straight_share: float
    """Share of the hard turns in which the robot drives straight [1]."""
    turning_share: float
    """Root mean square of the yaw rate over that which the wheels ask for, once under way [1]."""
    opposite_share: float
    """Share of the time in which the wheels turn against each other [1]."""
    excess: float
    """Greatest speed, once under way, over the commanded one, less 1 [1]."""
    d_rms: float
    """Distance from the improved model [m]."""


def starts(n: int) -> list[tuple[float, float]]:
    """Return heading [rad] and time step [s] of n starts; one start has those of the thesis."""
    if n == 1:
        return [(0.0, published.value("3.16", "max_step_size"))]
    return [(yaw, _SAMPLE / (50 - n // 2 + k)) for k, yaw in enumerate(np.linspace(-_TURNED, _TURNED, n).tolist())]


def straight_share(motion: Trajectory, commanded: FloatArray) -> float:
    """Return the share of the time in which a robot drives straight while its wheels ask for a hard turn [1].

    Args:
        motion: the motion.
        commanded: (M,) yaw rate that the wheels ask for [rad/s].
    """
    hard = np.abs(commanded) >= _HARD * np.abs(commanded).max()
    return float((np.abs(motion.twist[hard, 2]) < _STRAIGHT * np.abs(commanded[hard])).mean())


def driven_on_trajectory_3(law: FrictionLaw, direction: FrictionDirection, start: tuple[float, float]) -> GazeboRun:
    """Drive trajectory 3 with the settings of Tab. 3.16 and a friction model, from a heading [rad] with a time step [s]."""
    profile, mu = load_profile("thesis-lab"), published.value("3.16", "mu")
    section, (yaw, timestep) = profile.section("ode"), start
    settings = replace(
        GAZEBO,
        friction_law=law,
        direction=direction,
        second_share=published.value("3.16", "mu2") / mu,
        iterations=int(published.value("3.16", "iters")),
        cfm=published.value("3.16", "cfm"),
        surface_layer=published.value("3.16", "contact_surface_layer"),
        max_correcting_velocity=published.value("3.16", "contact_max_correcting_velocity"),
    )
    numbers = replace(section.parameters, **{**MAKERS_HUSKY, "friction": mu, "timestep": timestep})
    piece = replace(open_source(_SOURCE).pieces[0], start=State(yaw=yaw))
    plant = EnginePlant("ode", lambda body: OdeBody(body, settings), numbers, section.drive)
    motion = drive(plant, piece, section.localiser, _SAMPLE)
    improved = drive(make_plant(profile, "improved"), piece, profile.plants["improved"].localiser, _SAMPLE)
    commanded = 0.5 * numbers.wheel_radius / numbers.half_track * np.diff(motion.wheels, axis=1)[:, 0]
    on = motion.t >= _LEAD
    return GazeboRun(
        straight_share(motion, commanded),
        float(np.sqrt(np.mean(motion.twist[on, 2] ** 2) / np.mean(commanded[on] ** 2))),
        float(np.mean(np.prod(motion.wheels, axis=1) < 0.0)),
        float(motion.twist[on, 0].max()) / STRAIGHT_SPEED - 1.0,
        compare_paths(motion, improved)["d_rms_m"],
    )


_Driven = Mapping[tuple[str, FrictionDirection], Sequence[GazeboRun]]


def _rows(driven: _Driven) -> dict[str, dict[str, Pair]]:
    """Return what the thesis says in words of each friction model, beside ours over all starts and both directions."""

    def pair(law: str, what: Callable[[GazeboRun], float], unit: str = "1") -> Pair:
        rule: Rule = "none" if law == "cone" else "words"  # of the cone alone the thesis says nothing
        wheel, world = ([what(run) for run in driven[law, direction]] for direction in _DIRECTIONS)
        spread = float(np.std(wheel, ddof=1)) if len(wheel) > 1 else None
        beside = {"world": float(np.median(world))}
        return Pair(None, float(np.median(wheel)), rule, unit, spread, beside)

    rows = {
        law: {
            "straight_share": pair(law, lambda run: run.straight_share),
            "turning_share": pair(law, lambda run: run.turning_share),
            "opposite_share": pair(law, lambda run: run.opposite_share),
            "speed_excess": pair(law, lambda run: 100.0 * run.excess, "%"),
        }
        for law in _LAWS
    }
    far = {key: float(np.median([run.d_rms for run in runs])) for key, runs in driven.items()}
    worse = {d: far["box", d] / max(far["pyramid", d], far["cone", d]) for d in _DIRECTIONS}
    rows["box"]["times_the_others"] = Pair(None, worse["wheel"], "words", beside={"world": worse["world"]})
    return rows


def _gazebo(task: Task) -> Findings:
    """Drive the three runs of Sec. 3.7, each with two friction directions and from several starts."""
    words = {"straight": _STRAIGHT, "starts": task.budget.starts, "turned": np.degrees(_TURNED), "closest": 0, "cases": 0}
    try:
        ode()
    except EngineMissingError as error:
        gone = Pair(None, None, "words", obstacle=str(error))
        return Findings({"Sec. 3.7": {law: {"straight_share": gone} for law in _LAWS}}, words)
    driven: dict[tuple[str, FrictionDirection], list[GazeboRun]] = {}
    every, done = starts(task.budget.starts), 0
    for name, law in _LAWS.items():
        for direction in _DIRECTIONS:
            for start in every:
                task.progress(Progress(done, len(_LAWS) * len(_DIRECTIONS) * len(every), name))
                driven.setdefault((name, direction), []).append(driven_on_trajectory_3(law, direction, start))
                done += 1
    rows = [
        {
            "friction model": name, "direction": _DIRECTIONS[direction],
            "straight_share": _range([run.straight_share for run in runs]),
            "faster_than_commanded_share": _range([run.excess for run in runs]),
            "d_rms_m": _range([run.d_rms for run in runs]),
        }
        for (name, direction), runs in driven.items()
    ]  # fmt: skip
    closest = {d: np.argmin([[run.d_rms for run in driven[n, d]] for n in _LAWS], axis=0) for d in _DIRECTIONS}
    cone = list(_LAWS).index("cone")
    words |= {"closest": sum(int(np.sum(k == cone)) for k in closest.values()), "cases": len(_DIRECTIONS) * len(every)}
    units = {"d_rms_m": METRES}
    more = [Table("The same by direction: median over the starts, least and greatest", rows, units=units)]
    return Findings({"Sec. 3.7": _rows(driven)}, words, more)


def _range(values: Sequence[float]) -> tuple[float, float, float]:
    return float(np.median(values)), min(values), max(values)


GAZEBO_SECTION = Section("gazebo", ("Sec. 3.7",), _gazebo)
"""The section on Gazebo."""
