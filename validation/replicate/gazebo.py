"""Gazebo (Sec. 3.7): the settings of Tab. 3.16 in ODE, its engine, with three friction models.

Gazebo itself does not run. Its Husky, its contacts and its three friction models are handed to the
distribution's ODE, see `validation.engines.ode`. Whether Gazebo 9 still had the friction direction
of the Husky's description is not known, so each model is driven with that direction, and with the
one that ODE takes without it. Friction then depends on the heading, and the time step decides when
a wheel hops, so every run starts several times, each a little turned and with another step.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from ssmr.metrics.declared import compare_paths
from ssmr.types import FloatArray, State, Trajectory
from validation.engines.body import EngineMissingError
from validation.engines.ode import GAZEBO, MAKERS_HUSKY, FrictionDirection, FrictionLaw, OdeBody
from validation.engines.ode_library import ode
from validation.engines.plant import EnginePlant
from validation.experiment.runs import drive
from validation.experiment.sources import open_source
from validation.output import Progress
from validation.plants.profile import load_profile, make_plant
from validation.replicate import published
from validation.replicate.chapters import Findings, Section, Task, deviation
from validation.replicate.verdicts import Pair, Rule
from validation.report.columns import METRES
from validation.report.table import Table
from validation.simulator.turning import STRAIGHT_SPEED

_SOURCE = "traj3"
_SAMPLE = 0.05
"""Sample period of the motions [s]."""
_LEAD = 3.0
"""Time after which a robot is under way [s]."""
_LAWS: Mapping[str, FrictionLaw] = {
    "pyramid": "pyramid",
    "box": "gazebo_box",
    "cone": "gazebo_cone",
}
_DIRECTIONS: Mapping[FrictionDirection, str] = {
    "wheel": "of the Husky's wheels",
    "world": "of the world",
}
_HARD = 0.5
"""Wheels ask for a hard turn if it is at least this share of their hardest [1]."""
_STRAIGHT = 0.05
"""The robot drives straight if it turns at less than this share of its wheels' demand [1]."""
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
    yaws = np.linspace(-_TURNED, _TURNED, n).tolist()
    fewest = 50 - n // 2  # physics steps a sample: 50 are the thesis' time step
    return [(yaw, _SAMPLE / (fewest + k)) for k, yaw in enumerate(yaws)]


def straight_share(motion: Trajectory, commanded: FloatArray) -> float:
    """Share of the hard turns, in time, in which a robot drives straight [1].

    Args:
        motion: the motion.
        commanded: (M,) yaw rate that the wheels ask for [rad/s].
    """
    hard = np.abs(commanded) >= _HARD * np.abs(commanded).max()
    straight = np.abs(motion.twist[:, 2]) < _STRAIGHT * np.abs(commanded)
    return float(straight[hard].mean())


def driven_on_trajectory_3(
    law: FrictionLaw, direction: FrictionDirection, start: tuple[float, float]
) -> GazeboRun:
    """Drive trajectory 3 with the settings of Tab. 3.16 and a friction model.

    Args:
        law: the friction model.
        direction: the first direction of friction.
        start: heading [rad] and time step [s].
    """
    profile = load_profile("thesis-lab")
    mu = published.value("3.16", "mu")
    section = profile.section("ode")
    yaw, timestep = start
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
    plant = EnginePlant("ode", partial(OdeBody, settings=settings), numbers, section.drive)
    motion = drive(plant, piece, section.localiser, _SAMPLE)
    localiser = profile.plants["improved"].localiser
    improved = drive(make_plant(profile, "improved"), piece, localiser, _SAMPLE)
    half_ratio = 0.5 * numbers.wheel_radius / numbers.half_track
    commanded = half_ratio * np.diff(motion.wheels, axis=1)[:, 0]
    on = motion.t >= _LEAD
    turning = np.mean(motion.twist[on, 2] ** 2) / np.mean(commanded[on] ** 2)
    return GazeboRun(
        straight_share(motion, commanded),
        float(np.sqrt(turning)),
        float(np.mean(np.prod(motion.wheels, axis=1) < 0.0)),
        float(motion.twist[on, 0].max()) / STRAIGHT_SPEED - 1.0,
        compare_paths(motion, improved)["d_rms_m"],
    )


_SAID = {"straight_share": "1", "turning_share": "1", "opposite_share": "1", "speed_excess": "%"}
"""Quantities of which Sec. 3.7 says something, and their units: the first ones of `GazeboRun`."""
_Driven = Mapping[tuple[str, FrictionDirection], FloatArray]
"""(n, 5) `GazeboRun` from n starts, by friction model and direction."""


def _rows(driven: _Driven) -> dict[str, dict[str, Pair]]:
    """The thesis' words on each friction model beside ours, by all starts and both directions."""
    rows: dict[str, dict[str, Pair]] = {}
    for law in _LAWS:
        rows[law] = {}
        # Of the cone alone the thesis says nothing.
        rule: Rule = "none" if law == "cone" else "words"
        for k, (quantity, unit) in enumerate(_SAID.items()):
            scale = 100.0 if unit == "%" else 1.0
            wheel = scale * driven[law, "wheel"][:, k]
            beside = {"world": float(np.median(scale * driven[law, "world"][:, k]))}
            ours = float(np.median(wheel))
            rows[law][quantity] = Pair(None, ours, rule, unit, deviation(wheel), beside)
    far = {key: float(np.median(runs[:, -1])) for key, runs in driven.items()}
    worse = {d: far["box", d] / max(far["pyramid", d], far["cone", d]) for d in _DIRECTIONS}
    beside = {"world": worse["world"]}
    rows["box"]["times_the_others"] = Pair(None, worse["wheel"], "words", beside=beside)
    return rows


def _gazebo(task: Task) -> Findings:
    """Drive the runs of Sec. 3.7, each with two friction directions and from several starts."""
    words = {
        "straight": _STRAIGHT,
        "starts": task.starts,
        "turned": np.degrees(_TURNED),
        "closest": 0,
        "cases": 0,
    }
    try:
        ode()
    except EngineMissingError as error:
        obstacle = Pair(None, None, "words", obstacle=str(error))
        return Findings({"Sec. 3.7": {law: {"straight_share": obstacle} for law in _LAWS}}, words)
    every = starts(task.starts)
    cases = list(itertools.product(_LAWS, _DIRECTIONS, every))
    runs = []
    for done, (name, direction, start) in enumerate(cases):
        task.progress(Progress(done, len(cases), name))
        runs.append(driven_on_trajectory_3(_LAWS[name], direction, start))
    split = np.reshape(runs, (-1, len(every), len(GazeboRun._fields)))
    driven = dict(zip(itertools.product(_LAWS, _DIRECTIONS), split, strict=True))
    rows = []
    for (name, direction), found in driven.items():
        straight, _, _, excess, d_rms = map(_range, found.T)
        row = {
            "friction model": name,
            "direction": _DIRECTIONS[direction],
            "straight_share": straight,
            "faster_than_commanded_share": excess,
            "d_rms_m": d_rms,
        }
        rows.append(row)
    cone = list(_LAWS).index("cone")
    distances = split[:, :, -1].reshape(len(_LAWS), -1)
    closest = int(np.sum(np.argmin(distances, axis=0) == cone))
    words |= {"closest": closest, "cases": distances.shape[1]}
    title = "The same by direction: median over the starts, least and greatest"
    table = Table(title, rows, units={"d_rms_m": METRES})
    return Findings({"Sec. 3.7": _rows(driven)}, words, [table])


def _range(values: FloatArray) -> tuple[float, float, float]:
    return float(np.median(values)), float(values.min()), float(values.max())


GAZEBO_SECTION = Section("gazebo", ("Sec. 3.7",), _gazebo)
"""The section on Gazebo."""
