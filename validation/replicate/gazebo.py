"""Gazebo (Sec. 3.7): the settings of Tab. 3.16 in ODE, its engine, with three friction models.

Gazebo itself does not run. Its Husky, its contacts and its three friction models are handed to the
distribution's ODE, see `validation.engines.ode`. Whether Gazebo 9 still had the friction direction
of the Husky's description is not known, so each model is driven with that direction, and with the
one that ODE takes without it. Friction then depends on the heading, and the time step decides when
a wheel hops, so every run starts several times, each a little turned and with another step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from ssmr.metrics.declared import compare_paths
from ssmr.types import FloatArray, State, Trajectory
from validation.engines.body import EngineMissingError
from validation.engines.ode import GAZEBO, MAKERS_HUSKY, FrictionDirection, FrictionLaw, OdeBody
from validation.engines.ode_library import load_ode
from validation.engines.plant import EnginePlant
from validation.experiment.runs import drive_piece
from validation.experiment.sources import open_source
from validation.output import Document
from validation.plants.profile import load_profile, make_plant
from validation.replicate import published
from validation.replicate.chapters import Findings, Task, standard_deviation, swept_rows
from validation.replicate.verdicts import Pair, Rule
from validation.report.columns import METRES
from validation.report.table import Row, Table
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
_SHOWN = {
    "straight_share": "straight_share",
    "speed_excess": "faster_than_commanded_share",
    "d_rms_m": "d_rms_m",
}
"""Quantities of the table by direction, and their columns."""


def start_states(n: int) -> list[tuple[float, float]]:
    """Return heading [rad] and time step [s] of n starts; one start has those of the thesis."""
    if n == 1:
        return [(0.0, published.printed_value("3.16", "max_step_size"))]
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
    return straight[hard].mean()


def drive_trajectory_3(
    law: FrictionLaw, direction: FrictionDirection, start: tuple[float, float]
) -> Row:
    """Return what Sec. 3.7 speaks of, see `_SAID`, and the distance from the improved model [m].

    Args:
        law: the friction model, with the settings of Tab. 3.16.
        direction: the first direction of friction.
        start: heading [rad] and time step [s].
    """
    profile = load_profile("thesis-lab")
    table = {
        name: row.get("value") for name, row in published.printed_table("3.16")["rows"].items()
    }
    section = profile.section("ode")
    yaw, timestep = start
    settings = replace(
        GAZEBO,
        friction_law=law,
        direction=direction,
        second_share=table["mu2"] / table["mu"],
        iterations=int(table["iters"]),
        cfm=table["cfm"],
        surface_layer=table["contact_surface_layer"],
        max_correcting_velocity=table["contact_max_correcting_velocity"],
    )
    own = {**MAKERS_HUSKY, "friction": table["mu"], "timestep": timestep}
    numbers = replace(section.parameters, **own)
    plant = EnginePlant("ode", partial(OdeBody, settings=settings), numbers, section.drive)
    piece = replace(open_source(_SOURCE).pieces[0], start=State(yaw=yaw))
    motion = drive_piece(plant, piece, section.localiser, _SAMPLE)
    localiser = profile.plants["improved"].localiser
    improved = drive_piece(make_plant(profile, "improved"), piece, localiser, _SAMPLE)
    half_ratio = 0.5 * numbers.wheel_radius / numbers.half_track
    commanded = half_ratio * np.diff(motion.wheels, axis=1)[:, 0]
    on = motion.t >= _LEAD
    turning = np.mean(motion.twist[on, 2] ** 2) / np.mean(commanded[on] ** 2)
    return {
        "straight_share": straight_share(motion, commanded),
        "turning_share": np.sqrt(turning),
        "opposite_share": np.mean(np.prod(motion.wheels, axis=1) < 0.0),
        "speed_excess": 100.0 * (motion.twist[on, 0].max() / STRAIGHT_SPEED - 1.0),
        "d_rms_m": compare_paths(motion, improved)["d_rms_m"],
    }


_SAID = {"straight_share": "1", "turning_share": "1", "opposite_share": "1", "speed_excess": "%"}
"""Quantities of which Sec. 3.7 says something, and their units. The first is the share of the hard
turns in which the robot drives straight, then come the root mean square of the yaw rate over that
which the wheels ask for, once under way, the share of the time in which the wheels turn against
each other, and the greatest speed above the commanded one."""


def _repeat_gazebo(task: Task) -> Findings:
    """Drive the runs of Sec. 3.7, each with two friction directions and from several starts."""
    words = {
        "straight": _STRAIGHT,
        "starts": task.starts,
        "turned": np.degrees(_TURNED),
        "closest": 0,
        "cases": 0,
    }
    try:
        load_ode()
    except EngineMissingError as error:
        obstacle = Pair(None, None, "words", obstacle=str(error))
        return Findings({"Sec. 3.7": {law: {"straight_share": obstacle} for law in _LAWS}}, words)
    cases = list(product(_LAWS, _DIRECTIONS))
    variants = {}
    for (law, direction), start in product(cases, start_states(task.starts)):
        variants[f"{law}, {direction}, {start}"] = _LAWS[law], direction, start
    driven = swept_rows(variants, lambda variant: drive_trajectory_3(*variant), task)
    found = {}
    for name in (*_SAID, "d_rms_m"):
        values = np.reshape([row[name] for row in driven], (len(cases), -1))
        found[name] = dict(zip(cases, values, strict=True))
    rows: dict[str, dict[str, Pair]] = {law: {} for law in _LAWS}
    for law, (name, unit) in product(_LAWS, _SAID.items()):
        # of the cone alone the thesis says nothing
        rule: Rule = "none" if law == "cone" else "words"
        wheel, world = (found[name][law, direction] for direction in _DIRECTIONS)
        beside = {"world": np.median(world)}
        spread = standard_deviation(wheel)
        rows[law][name] = Pair(None, np.median(wheel), rule, unit, spread, beside)
    far = {case: np.median(values) for case, values in found["d_rms_m"].items()}
    wheel, world = (far["box", d] / max(far["pyramid", d], far["cone", d]) for d in _DIRECTIONS)
    rows["box"]["times_the_others"] = Pair(None, wheel, "words", beside={"world": world})
    beside_rows = []
    for law, direction in cases:
        row: Document = {"friction model": law, "direction": _DIRECTIONS[direction]}
        for name, shown in _SHOWN.items():
            scale = 0.01 if name == "speed_excess" else 1.0
            values = scale * found[name][law, direction]
            row[shown] = (float(np.median(values)), float(values.min()), float(values.max()))
        beside_rows.append(row)
    distances = np.reshape(list(found["d_rms_m"].values()), (len(_LAWS), -1))
    closest = np.sum(np.argmin(distances, axis=0) == list(_LAWS).index("cone"))
    words |= {"closest": closest, "cases": distances.shape[1]}
    title = "The same by direction: median over the starts, least and greatest"
    table = Table(title, beside_rows, units={"d_rms_m": METRES})
    return Findings({"Sec. 3.7": rows}, words, [table])


GAZEBO_SECTION = {"gazebo": (("Sec. 3.7",), _repeat_gazebo)}
"""The section on Gazebo."""
