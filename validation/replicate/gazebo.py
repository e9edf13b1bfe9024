"""The section on Gazebo (Sec. 3.7): the settings of Tab. 3.16 in ODE, Gazebo's engine, with its three friction models.

Gazebo itself does not run. Its Husky, its contacts and its three friction models are handed to the distribution's ODE, see
`validation.engines.ode`. Whether Gazebo 9 still had the friction direction of the
Husky's description is not known, so each model is driven with that direction, and with the one that ODE takes without it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ssmr.metrics.declared import compare_paths
from ssmr.types import Trajectory
from validation.bench.sources import drive, open_source
from validation.engines.body import EngineMissingError
from validation.engines.ode import GAZEBO, MAKERS_HUSKY, FrictionDirection, FrictionLaw, OdeBody
from validation.engines.ode_library import ode
from validation.engines.plant import EnginePlant
from validation.plants.profile import load_profile, make_plant
from validation.progress import Progress
from validation.replicate.evidence import Context, Findings, Section, Table
from validation.report.drawing import QUIET, draw_section, inset, put_together, side_by_side, text_row
from validation.report.tables import Cell, Grid
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


class _Drive(NamedTuple):
    motion: Trajectory
    straight: float  # share of the hard turns in which the robot drives straight [1]
    excess: float  # greatest speed, once under way, over the commanded one, less 1 [1]
    d_rms: float  # from the improved model [m]


def straight_share(motion: Trajectory, wheel_radius: float, half_track: float) -> float:
    """Return the share of the time in which a robot drives straight while its wheels ask for a hard turn [1].

    Args:
        motion: motion with wheel rates.
        wheel_radius: radius of the wheels [m].
        half_track: half the distance of left and right wheels [m].
    """
    asked = 0.5 * wheel_radius / half_track * np.diff(motion.wheels, axis=1)[:, 0]
    hard = np.abs(asked) >= _HARD * np.abs(asked).max()
    return float((np.abs(motion.twist[hard, 2]) < _STRAIGHT * np.abs(asked[hard])).mean())


def driven_on_trajectory_3(law: FrictionLaw, direction: FrictionDirection, improved: Trajectory) -> _Drive:
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
    return _Drive(motion, straight, excess, compare_paths(motion, improved)["d_rms_m"])


def _rows(found: Mapping[tuple[str, FrictionDirection], _Drive]) -> dict[str, dict[str, Pair]]:
    """Return what the thesis says in words of each run, beside ours."""
    lost = "the friction direction of the Husky's description is lost on its way to ODE"
    faster = published.table("text")["rows"]["gazebo_speed_excess_percent"]["lower"]

    def pair(law: str, value: Any, least: float | None, unit: str = "1") -> Pair:
        ours, under = (value(found[law, direction]) for direction in ("wheel", "world"))
        supposed = None if least is None else Supposed(under, None, lost, "engines.md")
        beside = {} if least is None else {"at_least": least}
        return Pair(None, ours, "none" if least is None else "at_least", unit, beside=beside, supposed=supposed)

    others = {d: max(found["pyramid", d].d_rms, found["cone", d].d_rms) for d in _DIRECTIONS}
    worse = {d: found["box", d].d_rms / others[d] for d in _DIRECTIONS}
    box = Pair(None, worse["wheel"], "at_least", beside={"at_least": _BY_FAR, "world": worse["world"]})
    return {
        "pyramid": {
            "straight_share": pair("pyramid", lambda d: d.straight, _AT_SOME_POINT),
            "speed_excess": pair("pyramid", lambda d: 100.0 * d.excess, faster, "%"),
        },
        "box": {"straight_share": pair("box", lambda d: d.straight, _AT_SOME_POINT), "times_the_others": box},
        "cone": {
            "straight_share": pair("cone", lambda d: d.straight, None),
            "speed_excess": pair("cone", lambda d: 100.0 * d.excess, None, "%"),
        },
    }


def _draw(found: Mapping[tuple[str, FrictionDirection], _Drive], improved: Trajectory) -> Figure:
    """Draw path and forward speed of each friction model, as Fig. 3.34 and 3.36 do."""
    inks, styles = {"pyramid": "#d55e00", "box": "#999999", "cone": "#0072b2"}, {"wheel": "-", "world": ":"}
    drawn = [("improved model", "black", "-", improved)]
    for (law, direction), d in found.items():
        drawn.append((f"{law}, direction {_DIRECTIONS[direction]}", inks[law], styles[direction], d.motion))

    def paths(ax: Axes) -> None:
        for label, ink, style, motion in drawn:
            ax.plot(*motion.xy.T, style, color=ink, linewidth=1.8, label=label)
        ax.set(xlabel="x [m]", ylabel="y [m]", ylim=(-0.5, 7.5))
        inset(ax, left=0.8)
        ax.legend(loc="upper left", fontsize=8.0)

    def speeds(ax: Axes) -> None:
        for _, ink, style, motion in drawn:
            ax.plot(motion.t, motion.twist[:, 0], style, color=ink, linewidth=1.3)
        ax.axhline(STRAIGHT_SPEED, color=QUIET, linewidth=0.9)
        ax.set(xlabel="time [s]", ylabel="forward speed [m/s]")
        inset(ax, left=0.8)

    heading = "Trajectory 3 with the settings of Tab. 3.16 in ODE, by Gazebo's friction models"
    return put_together([text_row(0.3, partial(draw_section, heading)), side_by_side(4.2, [paths, speeds])])


def _gazebo(context: Context) -> Findings:
    """Drive the three runs of Sec. 3.7, each with two friction directions."""
    caption = "What Sec. 3.7 says of three friction models in Gazebo, beside ODE with the settings of Tab. 3.16"
    if how := _how_to_get_ode():
        gone = Pair(None, None, "none", obstacle=how)
        return Findings({"Sec. 3.7": Table(caption, {law: {"straight_share": gone} for law in _LAWS})})
    profile = load_profile("thesis-lab")
    localiser = profile.plants["improved"].localiser
    improved = drive(make_plant(profile, "improved"), open_source(_SOURCE).pieces[0], localiser, _SAMPLE)
    found: dict[tuple[str, FrictionDirection], _Drive] = {}
    for name, law in _LAWS.items():
        for direction in _DIRECTIONS:
            context.progress(Progress(len(found), len(_LAWS) * len(_DIRECTIONS), name))
            found[name, direction] = driven_on_trajectory_3(law, direction, improved)
    rows = []
    for (name, direction), d in found.items():
        texts = [
            name,
            _DIRECTIONS[direction],
            f"{100.0 * d.straight:.0f}",
            f"{100.0 * d.excess:.0f}",
            f"{1e3 * d.d_rms:.0f}",
        ]
        rows.append(tuple(map(Cell, texts)))
    header = (("friction model", ""), ("direction", ""), ("straight", "%"), ("faster than commanded", "%"), ("d_rms", "mm"))
    notes = (
        "Gazebo itself does not run: the settings of Tab. 3.16 and of its Husky are handed to the distribution's ODE, with "
        "Gazebo's three friction models as its sources have them. `straight` is the share of the time in which the robot "
        f"turns at less than {100.0 * _STRAIGHT:g} % of what its wheels ask for, while they ask for at least half of their "
        "hardest turn; d_rms is that to the improved model.",
        f'"At some point" is taken to mean {100.0 * _AT_SOME_POINT:g} % of that time, "by far" a factor of {_BY_FAR:g}, and '
        "the speed to exceed the commanded one by at least the lower of the two figures in the text.",
        "The box takes mu and mu2 as newtons, so all wheels together can push with at most two newtons, and the robot "
        "hardly moves. With the cone it does not drive straight while its wheels ask for a turn, but for moments.",
    )
    picture = context.picture(
        "models", _draw(found, improved), "Left, paths; right, forward speeds; the line is the command."
    )
    grid = {"Gazebo's friction models on trajectory 3": Grid(header, (tuple(rows),), left=2)}
    return Findings({"Sec. 3.7": Table(caption, _rows(found))}, grid, notes, (picture,))


def _how_to_get_ode() -> str:
    """Return the line that says how to get ODE; empty if it is there."""
    try:
        ode()
    except EngineMissingError as error:
        return str(error)
    return ""


GAZEBO_SECTIONS = (
    Section("gazebo", "Gazebo's engine and its friction models", ("Sec. 3.7",), (), _gazebo, lambda: not _how_to_get_ode()),
)
"""The section on Gazebo."""
