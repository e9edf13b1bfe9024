"""A table of all that stops, slows or turns a robot of others, in any format, and of the remedies.

Each line weighs what an attribute does against what a turn on the spot needs: torques of an axle
against what its motor has to spare, moments against that of the tyres' friction, lost load against
the load, speeds against that of the rims. Some lines tell only what drives of an MJCF can show.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import mujoco
import numpy as np

from ssmr.robot.ground import LEFT
from ssmr.types import FloatArray
from validation.descriptions.foreign_robot import ForeignRobot
from validation.descriptions.slow_turn import (
    NOTICED,
    SPOILT,
    SlowTurn,
)
from validation.simulator.checking import spot_turn
from validation.simulator.description import Robot

_NOTHING = 0.01
"""Share of what is only just enough [1]."""
_IMPRATIO = 100.0
"""Stiffness of friction against sliding over that of the contact, in which tyres stand still
[1]."""
STOPPING = ("held", "load", "effort", "motor_weak")
"""Kinds of what stops a robot, lifts it or leaves it without motors: whatever else it then does
wrong follows from that."""
Weighed = tuple[str, Literal["fault", "question", ""], str, str]
"""Kind of a line, how severe it is by the file alone (empty for what only drives can show), what it
does, and the name of what takes it away."""


class _Influence(NamedTuple):
    """An attribute that stops, slows or turns a robot."""

    kind: str
    """Kind of the finding."""
    written: str
    """How a URDF and an SDF write it."""
    mjcf: str
    """How an MJCF writes it."""
    effect: str | Callable[[SlowTurn], FloatArray | float]
    """What it does to each wheel, in the unit of the sentence: a number of the wheels by its key,
    or a function of the robot."""
    sentence: str
    """What it does; `{effect}` is the greatest, and `{wheels}` those of which it is said."""
    over: str = "one"
    """Number of `SlowTurn` that the effect is a share of; `rate` for a torque that slows wheels."""
    under: str = ""
    """Number of `SlowTurn` under which the effect takes the whole turn."""
    is_fault: bool = True
    """Whether it can be a fault; else it deserves a look at most."""
    mend: str = ""
    """Name of what takes it away in an MJCF, tried where it has any effect."""


_NEED = "; a turn on the spot needs {need:.3g} N m a wheel"
_INFLUENCES: Sequence[_Influence] = (
    _Influence(
        "held",
        "<static> or <kinematic>",
        "",
        lambda stand: stand.foreign.controller.get("held", 0.0),
        "{written} is true: it never moves",
    ),
    _Influence(
        "held",
        "",
        "<flag>",
        lambda stand: float(stand.model.opt.disableflags > 0),
        "{written} disables a part of what moves it",
        over="drives",
        mend="flags",
    ),
    _Influence(
        "held",
        "",
        "<equality>",
        lambda stand: float(stand.model.eq_active0.any()),
        "an {written} ties wheels to the other side, to other rates or to the world: they cannot "
        "turn as told",
        over="drives",
        mend="ties",
    ),
    _Influence(
        "load",
        "<gravity> of links",
        "gravcomp or gravity of <option>",
        SlowTurn.lost_load,
        "{written} takes away {effect:.3g} of the {load:.3g} N that press a tyre to the ground",
        over="load",
        mend="gravity",
    ),
    _Influence(
        "load",
        "",
        "gravity of <option>",
        lambda stand: SlowTurn.sine_to_vertical(stand.model.opt.gravity),
        "{written} leans: the sine of its angle to the vertical is {effect:.2g}, as on a slope",
        mend="gravity",
    ),
    _Influence(
        "slope",
        "",
        "the ground",
        lambda stand: SlowTurn.sine_to_vertical(stand.ground),
        "{written} leans: the sine of its slope is {effect:.2g}, and the rows of a balance are for "
        "level ground",
    ),
    _Influence(
        "held",
        "",
        "density and viscosity of <option>",
        SlowTurn.drag,
        "{written} are those of a liquid, which holds it with {effect:.3g} N, and friction pushes "
        "with {push:.3g} N at most",
        over="push",
        is_fault=False,
        mend="medium",
    ),
    _Influence(
        "held",
        "",
        "damping of the base's free joint",
        lambda stand: float(stand.model.dof_damping.max(initial=0.0)),
        "{written} holds it",
        over="drives",
        mend="damping of the base",
    ),
    _Influence(
        "held",
        "<dynamics damping>",
        "damping of the joints",
        lambda stand: stand.model.dof_damping[stand.dofs] * stand.rate,
        "{written} takes {effect:.3g} N m of {wheels} at {rate:.2g} rad/s" + _NEED,
        over="rate",
        mend="damping",
    ),
    _Influence(
        "held",
        "<dynamics friction>",
        "frictionloss of the joints",
        lambda stand: stand.model.dof_frictionloss[stand.dofs],
        "{written} takes {effect:.3g} N m of {wheels}" + _NEED,
        over="rate",
        mend="frictionloss",
    ),
    _Influence(
        "held",
        "<spring_stiffness>",
        "stiffness of the joints",
        lambda stand: stand.model.jnt_stiffness[stand.joints] * 2.0 * np.pi,
        "{written}: a spring turns {wheels} back, after a turn with {effect:.3g} N m" + _NEED,
        over="rate",
        mend="stiffness",
    ),
    _Influence(
        "inertia",
        "",
        "armature of the wheels' joints",
        lambda stand: stand.armature / stand.radius**2,
        "{written} has to be set off like {effect:.3g} kg more a wheel",
        over="drives",
        mend="rotors",
    ),
    _Influence(
        "effort",
        "<limit velocity>",
        "ctrlrange",
        "velocity",
        "{written} lets {wheels} turn at {effect:.3g} rad/s either way, and both ways are needed",
        under="slow",
        mend="inputs",
    ),
    _Influence(
        "which_friction",
        "",
        "condim and torsional friction",
        "torsion",
        "{written} of tyres and ground hold it in a turn",
        over="drives",
        mend="condim",
    ),
    _Influence(
        "which_friction",
        "",
        "condim 6 and rolling friction",
        lambda stand: stand.load * stand.of_wheels("rolling"),
        "{written} of tyres and ground brake {wheels} with {effect:.3g} N m, which is a share of "
        "what the tyres' grip can give",
        over="grip",
        is_fault=False,
        mend="condim",
    ),
    _Influence(
        "load",
        "",
        "contype, conaffinity, <exclude> or <flag contact>",
        "misses",
        "{written} keep ground and tyres of {wheels} apart: these carry nothing",
        mend="masks",
    ),
    _Influence(
        "which_friction",
        "mu1 and mu2",
        "friction or condim",
        "mu1",
        "{written} give tyres and ground of {wheels} a friction of {effect:.3g}: they spin",
        under="slippery",
        mend="condim",
    ),
    _Influence(
        "unlike_wheels",
        "mu1 and mu2",
        "friction",
        lambda stand: SlowTurn.lack_of(stand.mu),
        "wheels differ in their friction: {written} of {wheels} is less by up to {effect:.2g} of "
        "that of the others, and it turns about those that hold",
        mend="friction",
    ),
    _Influence(
        "friction_by_heading",
        "mu1 and mu2",
        "a contact pair's frictions along two directions",
        lambda stand: abs(stand.of_wheels("mu1") - stand.of_wheels("mu2")),
        "friction depends on the heading, for {written} differ by {effect:.2g}: the robot turns "
        "unevenly and drifts; give both one number (docs/why_drift.md)",
        over="spread",
        mend="friction",
    ),
    _Influence(
        "friction_by_heading",
        "fdir1",
        "",
        "fdir1",
        "friction depends on the heading, for {written} is fixed in the wheels and rolls with "
        "them; take it out (docs/why_drift.md)",
        is_fault=False,
    ),
    _Influence(
        "which_friction",
        "",
        "friction",
        lambda stand: stand.of_wheels("mu1") - stand.of_wheels("own"),
        "the ground has a {written} that is larger by {effect:.3g} than that of {wheels}, and "
        "MuJoCo takes the larger one: give the tyres a higher priority, or the ground a smaller "
        "friction",
        is_fault=False,
        mend="priority",
    ),
    _Influence(
        "wheel_shape",
        "shapes of the wheels",
        "shapes of the wheels",
        lambda stand: np.array(stand.uneven),
        "{written} are not round about their axles ({wheels}: {shapes}), so that it hops and turns "
        "unevenly; take an ellipsoid or a cylinder about the axle",
        mend="shapes",
    ),
    _Influence(
        "unlike_wheels",
        "radii of the wheels",
        "radii of the wheels",
        lambda stand: SlowTurn.lack_of(stand.radii),
        "wheels differ in their radius, {radii} m: the robot veers, and stands on some of them; "
        "give all four one radius",
        over="spread",
        mend="shapes",
    ),
    _Influence(
        "which_friction",
        "slip1 and slip2",
        "",
        lambda stand: (
            stand.mu * stand.load * np.fmax(stand.of_wheels("slip1"), stand.of_wheels("slip2"))
        ),
        "{written} let {wheels} slide at {effect:.3g} m/s, as if on oil, under the forces of a "
        "turn whose rims run at {rim:.2g} m/s",
        over="rim",
        is_fault=False,
    ),
    _Influence(
        "load",
        "kp",
        "",
        lambda stand: stand.load / stand.of_wheels("kp"),
        "{written} is so soft that {wheels} of {radius:.3g} m sink {effect:.2g} m into the ground "
        "under their load of {load:.3g} N",
        over="radius",
        is_fault=False,
    ),
    _Influence(
        "axes",
        "axes of the wheels",
        "axes of the wheels",
        lambda stand: stand.backward_wheels(by_gear=False),
        "{written} have opposite signs: {wheels} turn backward when all are told to turn ahead, so "
        "that a controller of a differential drive turns the robot when it is told to drive; give "
        "them the axis of the others",
        mend="axes",
    ),
    _Influence(
        "axes",
        "axes of the wheels",
        "axes of the wheels",
        SlowTurn.toe,
        "{written} are not parallel: {wheels} stand at {effect:.2g} rad to the others, and scrub",
        over="slip",
        is_fault=False,
        mend="axes",
    ),
    _Influence(
        "unlike_wheels",
        "heights of the axles",
        "heights of the axles",
        SlowTurn.unevenness,
        "{written} differ: one is {gap:.2g} m above or below the plane of the three others, so "
        "that it stands on three wheels",
        mend="heights",
    ),
    _Influence(
        "unlike_wheels",
        "heights of the axles",
        "heights of the axles",
        lambda stand: float(np.ptp(stand.heights)),
        "{written} differ by {effect:.2g} m: it leans, or some wheels hang in the air",
        over="radius",
        is_fault=False,
    ),
    _Influence(
        "solver",
        "",
        "solver and iterations of <option>",
        lambda stand: float(
            stand.model.opt.solver != mujoco.mjtSolver.mjSOL_NEWTON
            or stand.model.opt.iterations < 100
        ),
        "{written} ({model.opt.iterations} sweeps) leave torques of the ground on the wheels open: "
        "too few sweeps; take Newton, or more iterations",
        over="drives",
        mend="solver",
    ),
    _Influence(
        "pyramid",
        "",
        "cone of <option>",
        lambda stand: float(stand.model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL),
        "{written}: friction is bounded by a pyramid along axes that do not turn with the robot",
        over="drives",
        mend="cone",
    ),
    _Influence(
        "creep",
        "",
        "impratio",
        lambda stand: float(stand.model.opt.impratio < _IMPRATIO),
        "contacts with an {written} of {model.opt.impratio:g} let standing tyres slide",
        over="drives",
        mend="impratio",
    ),
    _Influence(
        "soft_on_one_geom",
        "",
        "solimp and solref of tyres and ground",
        "mixed",
        "{written} are not the same, and MuJoCo takes the mean of both",
        over="drives",
        mend="contact",
    ),
    _Influence(
        "hopping",
        "",
        "solimp and solref of the tyres",
        lambda stand: stand.of_wheels("mixed") == 0.0,
        "{written}: the contact is hard, so that wheels hop, or so soft that they sink",
        over="drives",
        mend="contact",
    ),
    _Influence(
        "hopping",
        "",
        "margin of tyres and ground",
        lambda stand: float(stand.model.geom_margin.max()),
        "{written} lets contacts begin up to {effect:.2g} m above the ground: it floats",
        over="drives",
        mend="margin",
    ),
    _Influence(
        "step",
        "",
        "integrator of <option>",
        lambda stand: float(stand.model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER),
        "{written} is Euler, and servos and dampers are too stiff for it: wheels tremble; take "
        "implicitfast",
        over="drives",
        mend="integrator",
    ),
    _Influence(
        "step",
        "",
        "timestep of <option>",
        lambda stand: stand.model.opt.timestep,
        "{written} of {effect:g} s is too long for contacts and servos",
        over="drives",
        mend="step",
    ),
    _Influence(
        "motor_weak",
        "<limit effort> or the plugin's <torque>",
        "forcerange, ctrlrange or <flag actuation>",
        "effort",
        "{written} lets the {motors} of {wheels} give {effect:.3g} N m" + _NEED,
        under="need",
        mend="motors",
    ),
    _Influence(
        "servo_soft",
        "",
        "kv",
        lambda stand: stand.need / stand.of_wheels("gain"),
        "the wheels' servos are too soft ({written} is {softest:.3g}) and give way to the ground, "
        "which is no skidding and which no multiplier mends",
        over="drives",
        mend="servos",
    ),
    _Influence(
        "held",
        "<limit lower upper> of revolute joints",
        "",
        "range",
        "{written} let {wheels} turn {effect:.3g} rad (0..0 is none): make them continuous",
        under="few_turns",
    ),
    _Influence(
        "mass_in_wheels",
        "<inertial> of the wheels",
        "places of the wheels' masses",
        SlowTurn.unbalance,
        "{written}: the centre of mass of {wheels} lies beside the axle, which its weight turns "
        "with up to {effect:.2g} N m" + _NEED,
        over="need",
        is_fault=False,
    ),
    _Influence(
        "effort",
        "<limit effort velocity> of 0",
        "",
        "nothing",
        "{written} leaves {wheels} no torque or no velocity in ros_control",
        is_fault=False,
    ),
    _Influence(
        "axes",
        "",
        "gear",
        lambda stand: stand.backward_wheels(by_gear=True),
        "{written} has another sign at {wheels}: equal inputs turn it backward",
        is_fault=False,
    ),
    _Influence(
        "effort",
        "",
        "kv",
        lambda stand: SlowTurn.lack_of(stand.of_wheels("gain")),
        "{written} of {wheels} is less by up to {effect:.2g} of that of the others",
        is_fault=False,
    ),
    _Influence(
        "names",
        "",
        "names of motors",
        lambda stand: SlowTurn.misleading_names(stand.motor_names()),
        "{written} say another side or end than that of {wheels}, which they drive: it turns the "
        "wrong way",
    ),
    _Influence(
        "names",
        "names of wheels",
        "names of wheels",
        lambda stand: SlowTurn.misleading_names(stand.names),
        "{written} say other places than they have: {wheels} stand on another side or end (x is "
        "ahead, y to the left), so that a controller that goes by the names turns the wrong way",
    ),
    _Influence(
        "controller",
        "joints of the drive plugin",
        "",
        # names that mislead are said as such
        lambda stand: (
            stand.sides_of_controller() * LEFT + SlowTurn.misleading_names(stand.names) < 0.0
        ),
        "sides are swapped: the {written} have {wheels} on the wrong side, so that it turns the "
        "wrong way",
    ),
    _Influence(
        "controller",
        "drive plugin",
        "",
        lambda stand: (stand.sides_of_controller() == 0.0) & bool(stand.foreign.sides),
        "the {written} drives two of the four wheels or none of a side; {wheels} only roll along",
        is_fault=False,
    ),
    _Influence(
        "controller",
        "drive plugin",
        "",
        lambda stand: float(bool(stand.strange)),
        "the {written} has joints that are not in the file: {strange}",
    ),
)
"""In the order in which changes are made: where two mend the same, the last one is not needed."""


def weigh_influences(robot: Robot, foreign: ForeignRobot) -> list[Weighed]:
    """Return whatever has any effect on a turn, with its share of the turn.

    Nothing is weighed of a robot that does not stand on its four wheels.
    """
    turn = spot_turn(robot)
    if turn is None:
        return []
    stand = SlowTurn(robot, foreign, turn)
    names = np.array(stand.names)
    motors = np.array(stand.motor_names())
    found = []
    for line in _INFLUENCES:
        told = line.effect
        effect = stand.of_wheels(told) if isinstance(told, str) else told(stand)
        effect = np.broadcast_to(np.asarray(effect, dtype=np.float64), 4)
        if line.under:
            lack = getattr(stand, line.under) / np.maximum(effect, 1e-9)
            share = np.where(lack > 1.0, lack, _NOTHING * lack)
        elif line.over == "rate":
            share = stand.lost_rate(effect)
        else:
            share = effect / getattr(stand, line.over)
        share = np.nan_to_num(share, nan=0.0)
        worst = int(np.argmax(share))
        most = float(share[worst])
        if most <= 0.0:
            continue
        said = share >= min(NOTICED, most)
        named = [name for name in motors[said].tolist() if name]
        words = {
            "written": line.mjcf if foreign.kind == "mjcf" else line.written,
            "effect": float(effect[worst]),
            "wheels": "all four wheels" if said.all() else ", ".join(names[said]),
            "motors": " ".join(["motors", ", ".join(named)]).strip(),
        }
        severity: Literal["fault", "question", ""] = ""
        if most >= NOTICED:
            severity = "fault" if line.is_fault and most >= SPOILT else "question"
        cause = line.sentence.format(**vars(stand) | words)
        found.append((line.kind, severity, cause, line.mend))
    return found
