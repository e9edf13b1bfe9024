"""Gazebo (Sec. 3.7): the settings of Tab. 3.16 in ODE, Gazebo's engine, with its three friction models.

Gazebo itself does not run. Its Husky, its contacts and its three friction models are handed to the distribution's ODE, see
`validation.engines.ode`. Whether Gazebo 9 still had the friction direction of the Husky's description is not known, so each
model is driven with that direction, and with the one that ODE takes without it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from ssmr.metrics.declared import compare_paths
from ssmr.types import Trajectory
from validation.bench.sources import drive, open_source
from validation.engines.body import EngineMissingError
from validation.engines.ode import GAZEBO, MAKERS_HUSKY, FrictionDirection, FrictionLaw, OdeBody
from validation.engines.ode_library import ode
from validation.engines.plant import EnginePlant
from validation.plants.profile import load_profile, make_plant
from validation.progress import Progress
from validation.replicate.chapters import Findings, Section, Task
from validation.report.drawing import QUIET, Row, draw_section, side_by_side, text_row
from validation.report.table import Table
from validation.simulator.turning import STRAIGHT_SPEED
from validation.thesis import published
from validation.thesis.verdicts import Pair, Supposed

_SOURCE, _SAMPLE, _LEAD = "traj3", 0.01, 3.0
_LAWS: Mapping[str, FrictionLaw] = {"pyramid": "pyramid", "box": "gazebo_box", "cone": "gazebo_cone"}
_DIRECTIONS: Mapping[FrictionDirection, str] = {"wheel": "of the Husky's wheels", "world": "of the world"}
_HARD, _STRAIGHT = 0.5, 0.05
"""Wheels ask for a hard turn if it is at least this share of their hardest [1]; the robot drives straight if it turns at
less than this share of what they ask for [1]."""
_AT_SOME_POINT, _BY_FAR = 0.05, 1.5
"""Least share of the hard turns that counts as "at some point" [1], and least factor that counts as "by far" [1]."""
_LOST = "the friction direction of the Husky's description is lost on its way to ODE"


class GazeboRun(NamedTuple):
    """A run on trajectory 3."""

    motion: Trajectory
    """Motion of the robot."""
    straight: float
    """Share of the hard turns in which the robot drives straight [1]."""
    excess: float
    """Greatest speed, once under way, over the commanded one, less 1 [1]."""
    d_rms: float
    """Distance from the improved model [m]."""


def straight_share(motion: Trajectory, wheel_radius: float, half_track: float) -> float:
    """Return the share of the time in which a robot drives straight while its wheels ask for a hard turn [1].

    Args:
        motion: motion with wheel rates.
        wheel_radius: radius of the wheels [m].
        half_track: half the distance of left and right wheels [m].
    """
    wanted = 0.5 * wheel_radius / half_track * np.diff(motion.wheels, axis=1)[:, 0]
    hard = np.abs(wanted) >= _HARD * np.abs(wanted).max()
    return float((np.abs(motion.twist[hard, 2]) < _STRAIGHT * np.abs(wanted[hard])).mean())


def driven_on_trajectory_3(law: FrictionLaw, direction: FrictionDirection, improved: Trajectory) -> GazeboRun:
    """Drive trajectory 3 with the settings of Tab. 3.16 and a friction model."""
    section, mu = load_profile("thesis-lab").section("ode"), published.value("3.16", "mu")
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
    changes = {**MAKERS_HUSKY, "friction": mu, "timestep": published.value("3.16", "max_step_size")}
    numbers = replace(section.parameters, **changes)
    plant = EnginePlant("ode", lambda body: OdeBody(body, settings), numbers, section.drive)
    motion = drive(plant, open_source(_SOURCE).pieces[0], section.localiser, _SAMPLE)
    straight = straight_share(motion, numbers.wheel_radius, numbers.half_track)
    excess = float(motion.twist[motion.t >= _LEAD, 0].max()) / STRAIGHT_SPEED - 1.0
    return GazeboRun(motion, straight, excess, compare_paths(motion, improved)["d_rms_m"])


def _rows(found: Mapping[tuple[str, FrictionDirection], GazeboRun]) -> dict[str, dict[str, Pair]]:
    """Return what the thesis says in words of each run, beside ours."""
    faster = published.table("text")["rows"]["gazebo_speed_excess_percent"]["lower"]

    def pair(ours: float, under: float, least: float, unit: str = "1") -> Pair:
        supposed = Supposed(under, None, _LOST, "why_drift.md")
        return Pair(None, ours, "at_least", unit, beside={"at_least": least}, supposed=supposed)

    rows: dict[str, dict[str, Pair]] = {}
    for law in _LAWS:
        ours, under = found[law, "wheel"], found[law, "world"]
        if law == "cone":  # of which the thesis says nothing of that kind
            shares, excess = Pair(None, ours.straight, "none"), Pair(None, 100.0 * ours.excess, "none", "%")
        else:
            shares = pair(ours.straight, under.straight, _AT_SOME_POINT)
            excess = pair(100.0 * ours.excess, 100.0 * under.excess, faster, "%")
        rows[law] = {"straight_share": shares, "speed_excess": excess}
    others = {d: max(found["pyramid", d].d_rms, found["cone", d].d_rms) for d in _DIRECTIONS}
    worse = {d: found["box", d].d_rms / others[d] for d in _DIRECTIONS}
    del rows["box"]["speed_excess"]
    beside = {"at_least": _BY_FAR, "world": worse["world"]}
    rows["box"]["times_the_others"] = Pair(None, worse["wheel"], "at_least", beside=beside)
    return rows


def _drawn(found: Mapping[tuple[str, FrictionDirection], GazeboRun], improved: Trajectory) -> list[Row]:
    """Return path and forward speed of each friction model, as Fig. 3.34 and 3.36 have them."""
    inks, styles = {"pyramid": "#d55e00", "box": "#999999", "cone": "#0072b2"}, {"wheel": "-", "world": ":"}
    drawn = [("improved model", "black", "-", improved)]
    for (law, direction), run in found.items():
        drawn.append((f"{law}, direction {_DIRECTIONS[direction]}", inks[law], styles[direction], run.motion))

    def paths(ax: Axes) -> None:
        for label, ink, style, motion in drawn:
            ax.plot(*motion.xy.T, style, color=ink, label=label)
        ax.set(xlabel="x [m]", ylabel="y [m]", ylim=(-0.5, 7.5))
        ax.legend(loc="upper left", fontsize=8.0)

    def speeds(ax: Axes) -> None:
        for _, ink, style, motion in drawn:
            ax.plot(motion.t, motion.twist[:, 0], style, color=ink, linewidth=1.3)
        ax.axhline(STRAIGHT_SPEED, color=QUIET, linewidth=0.9)
        ax.set(xlabel="time [s]", ylabel="forward speed [m/s]")

    heading = "Trajectory 3 with the settings of Tab. 3.16 in ODE, by Gazebo's friction models"
    return [text_row(0.3, partial(draw_section, heading)), side_by_side(4.2, [paths, speeds])]


def _gazebo(task: Task) -> Findings:
    """Drive the three runs of Sec. 3.7, each with two friction directions."""
    words = {"straight": _STRAIGHT, "some": _AT_SOME_POINT, "far": _BY_FAR}
    try:
        ode()
    except EngineMissingError as error:
        gone = Pair(None, None, "none", obstacle=str(error))
        return Findings({"Sec. 3.7": {law: {"straight_share": gone} for law in _LAWS}}, words)
    profile = load_profile("thesis-lab")
    localiser = profile.plants["improved"].localiser
    improved = drive(make_plant(profile, "improved"), open_source(_SOURCE).pieces[0], localiser, _SAMPLE)
    found: dict[tuple[str, FrictionDirection], GazeboRun] = {}
    for name, law in _LAWS.items():
        for direction in _DIRECTIONS:
            task.progress(Progress(len(found), len(_LAWS) * len(_DIRECTIONS), name))
            found[name, direction] = driven_on_trajectory_3(law, direction, improved)
    rows = [
        {
            "friction model": name, "direction": _DIRECTIONS[direction], "straight_share": run.straight,
            "faster_than_commanded_share": run.excess, "d_rms_m": run.d_rms,
        }
        for (name, direction), run in found.items()
    ]  # fmt: skip
    more = [Table("Gazebo's friction models on trajectory 3", rows)]
    return Findings({"Sec. 3.7": _rows(found)}, words, more, _drawn(found, improved))


GAZEBO_SECTION = Section("gazebo", ("Sec. 3.7",), _gazebo)
"""The section on Gazebo."""
