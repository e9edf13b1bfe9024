"""Edits of an MJCF that take away what spoils a motion; there are none where it is not there.

Each belongs to a line of the table in `influences`, and counts only once it was driven (`causes`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping

import numpy as np
from mujoco import mjtJoint

from ssmr.types import FloatArray
from validation.descriptions.balance import SPEEDS, needed_torques
from validation.descriptions.mjcf_text import Edits, MjcfText, Part
from validation.descriptions.own_robot import OwnRobot
from validation.descriptions.wheels import UNLIKE
from validation.simulator.composing import CONTACT_DEPTH, CONTACT_TIME, IMPEDANCE

_FIRM = 0.03
"""Droop of servos that turn the robot on the spot at the slowest speed [1]."""
_SPARE = 1.5
"""Torque of motors over that of a turn on the spot [1]."""
_ROTOR = 0.025
"""Inertia of a wheel's rotor over mass and radius squared of robots [1]."""
_LONGEST_STEP = 0.002
"""Greatest physics step that is proposed [s]."""
_TOE = math.radians(0.3)
"""Angle of an axle to the robot's y from which it is not parallel [rad]."""
OPTION = ("option", "")
Mend = Callable[[OwnRobot, MjcfText], Edits]
"""Returns edits of a file that take a cause away."""


def _row(*numbers: float) -> str:
    return " ".join(f"{number:.6g}" for number in numbers)


def _numbers_of(robot: OwnRobot, part: Part, attribute: str) -> FloatArray:
    """Return the numbers that an attribute of a part has in the model."""
    kind, name = part
    model = robot.wheeled.model
    if kind == "option":
        return np.ravel(getattr(model.opt, attribute))
    view = getattr(model, kind)(int(name) if kind == "pair" else name)
    others = {
        "gravcomp": model.body_gravcomp,
        "actuatorfrcrange": model.jnt_actfrcrange,
        "condim": model.pair_dim if kind == "pair" else model.geom_condim,
    }
    if attribute in others:
        return np.ravel(others[attribute][view.id])
    return np.ravel(getattr(view, attribute))


def _even_range(
    robot: OwnRobot, text: MjcfText, part: Part, attribute: str, least: float = 0.0
) -> Edits:
    """Return edits that make a range as wide either way, and at least so wide."""
    most = max(least, float(np.abs(_numbers_of(robot, part, attribute)).max()))
    return _edit_differing_parts(robot, text, [part], **{attribute: _row(-most, most)})


def _edit_differing_parts(
    robot: OwnRobot, text: MjcfText, parts: Iterable[Part], **values: str
) -> Edits:
    """Return edits that give parts of the file these values, where they have others."""
    edits = dict[Part, Mapping[str, str]]()
    for part in parts:
        others = dict[str, str]()
        for attribute, value in values.items():
            wanted = np.array(value.split(), dtype=np.float64)
            there = _numbers_of(robot, part, attribute)[: len(wanted)]
            if not np.allclose(there, wanted):
                others[attribute] = value
        if others and part in text:
            edits[part] = others
    return edits


def _reset_parts(parts: Callable[[OwnRobot], Iterable[Part]], **values: str) -> Mend:
    """Return a change that gives parts these values."""
    return lambda robot, text: _edit_differing_parts(robot, text, parts(robot), **values)


def _set_options(**values: str) -> Mend:
    """Return a change of the file's options."""
    return lambda robot, text: {OPTION: values}


# ------------------------------------------------------------------- parts
def _wheel_joints(robot: OwnRobot) -> list[Part]:
    """Return the joints of the wheels."""
    return [("joint", name) for name in robot.names]


def _free_joint(robot: OwnRobot) -> list[Part]:
    """Return the joint of a base that is free in its file."""
    model = robot.wheeled.model
    joint = int(model.body_jntadr[robot.wheeled.root])
    if joint < 0 or model.jnt_type[joint] != mjtJoint.mjJNT_FREE:
        return []
    return [("joint", model.joint(joint).name)]


def _shapes_of_contact(robot: OwnRobot) -> list[Part]:
    """Return the shapes of tyres and ground."""
    model = robot.wheeled.model
    names = [model.geom(drum.geom).name for drum in robot.tyres]
    return [("geom", name) for name in [*names, robot.ground]]


def _tyre_parts(robot: OwnRobot) -> list[Part]:
    """Return what says the contact of each tyre: its pairs, else its shape."""
    model = robot.wheeled.model
    parts = list[Part]()
    for drum in robot.tyres:
        hit = (model.pair_geom1 == drum.geom) | (model.pair_geom2 == drum.geom)
        parts += [("pair", str(pair)) for pair in np.flatnonzero(hit)]
        if not hit.any():
            parts.append(("geom", model.geom(drum.geom).name))
    return parts


def _parts_of_contact(robot: OwnRobot) -> list[Part]:
    """Return what says the contacts of tyres and ground: pairs and shapes."""
    return [*_tyre_parts(robot), ("geom", robot.ground)]


# ------------------------------------------------------------------- what brakes, holds or lifts
def _mend_flags(robot: OwnRobot, text: MjcfText) -> Edits:
    """Return edits that enable what flags disable."""
    part = ("flag", "")
    if part not in text:
        return {}
    flags = text.attributes(part).items()
    return {part: {name: "enable" for name, value in flags if value == "disable"}}


def _mend_gravity(robot: OwnRobot, text: MjcfText) -> Edits:
    """Return edits with which all of gravity pulls down, and at every body."""
    model = robot.wheeled.model
    bodies = [("body", model.body(k).name) for k in robot.wheeled.group(robot.wheeled.root)]
    down = _edit_differing_parts(robot, text, [OPTION], gravity=_row(0.0, 0.0, -robot.gravity))
    return {**_edit_differing_parts(robot, text, bodies, gravcomp="0"), **down}


def _untie_wheels(robot: OwnRobot, text: MjcfText) -> Edits:
    """Return edits that take equalities out of action."""
    active = np.flatnonzero(robot.wheeled.model.eq_active0)
    parts = [("equality", str(number)) for number in active]
    # true and false are words
    return {part: {"active": "false"} for part in parts if part in text}


def _lighten_rotors(robot: OwnRobot, text: MjcfText) -> Edits:
    """Return edits that make rotors as light as robots of this size have them."""
    usual = float(f"{_usual_rotor(robot):.3g}")
    model = robot.wheeled.model
    heavy = [part for part in _wheel_joints(robot) if model.joint(part[1]).armature > usual]
    return _edit_differing_parts(robot, text, heavy, armature=f"{usual:g}")


def _usual_rotor(robot: OwnRobot) -> float:
    """Return the armature of a wheel that robots of this size have [kg m2]."""
    return _ROTOR * robot.mass * robot.radius**2


def _even_inputs(robot: OwnRobot, text: MjcfText) -> Edits:
    """Return edits that let wheels turn equally fast either way."""
    edits = dict[Part, Mapping[str, str]]()
    for name in robot.servos:
        if robot.model.actuator(name).ctrllimited[0]:
            edits |= _even_range(robot, text, ("actuator", name), "ctrlrange")
    return edits


# ------------------------------------------------------------------- tyres and ground
def _mend_friction(robot: OwnRobot, text: MjcfText) -> Edits:
    """Return edits that give tyres, or their pairs, one sliding friction in all directions."""
    usual = float(np.sort(robot.frictions)[2])
    edits = dict[Part, Mapping[str, str]]()
    for part in _tyre_parts(robot):
        ways = 2 if part[0] == "pair" else 1
        rest = _numbers_of(robot, part, "friction")[ways:]
        edits |= _edit_differing_parts(robot, text, [part], friction=_row(*[usual] * ways, *rest))
    return edits


def _let_tyres_decide(robot: OwnRobot, text: MjcfText) -> Edits:
    """Return edits with which the tyre's own friction counts, and not the ground's."""
    tyres = [part for part in _tyre_parts(robot) if part[0] == "geom"]
    first = int(robot.wheeled.model.geom(robot.ground).priority[0])
    return _edit_differing_parts(robot, text, tyres, priority=f"{first + 1}")


def _soften_contact(robot: OwnRobot, text: MjcfText) -> Edits:
    """Return edits that make the contact soft on the tyres alone, which then count alone."""
    model = robot.wheeled.model
    ground = model.geom(robot.ground)
    first = int(ground.priority[0])
    time = CONTACT_TIME * math.sqrt(robot.radius / robot.gravity)
    soft = {
        "solimp": _row(*IMPEDANCE, CONTACT_DEPTH * robot.radius, 0.5, 2.0),
        "solref": _row(max(time, 2.0 * model.opt.timestep), 1.0),
    }
    edits = dict[Part, Mapping[str, str]]()
    for kind, name in _tyre_parts(robot):
        values = dict(soft)
        if kind == "geom" and model.geom(name).priority[0] <= first:
            values["priority"] = f"{first + 1}"
            # the tyre's alone counts from now on: it keeps what the larger one was
            values["friction"] = _row(*np.maximum(model.geom(name).friction, ground.friction))
        edits |= _edit_differing_parts(robot, text, [(kind, name)], **values)
    return edits


# ------------------------------------------------------------------- shapes and places
def _mend_shapes(robot: OwnRobot, text: MjcfText) -> Edits:
    """Return edits that make tyres round, put them on their axles, and give all one size."""
    wheeled = robot.wheeled
    drums = robot.tyres
    radius = float(np.median([drum.radius for drum in drums]))
    width = float(np.median([drum.half_width for drum in drums]))
    edits = {}
    for drum, joint in zip(drums, wheeled.joints, strict=True):
        part = ("geom", wheeled.model.geom(drum.geom).name)
        values = dict[str, str]()
        is_angular = drum.kind in ("box", "oval", "lying")
        if is_angular or abs(drum.radius / radius - 1.0) > UNLIKE:
            turn = wheeled.data.geom_xmat[drum.geom].reshape(3, 3)
            along = int(np.argmax(np.abs(turn.T @ wheeled.data.xaxis[joint])))
            size = np.full(3, radius)
            size[along] = width
            if is_angular:
                values["type"] = "ellipsoid"
            elif drum.kind in ("cylinder", "capsule"):
                size = np.array([radius, width])
            if drum.kind != "mesh":
                values["size"] = _row(*size)
        if drum.is_off_axle:
            values["pos"] = _row(*_on_axle(robot, drum.geom, joint))
        if values and part in text:
            edits[part] = values
    return edits


def _on_axle(robot: OwnRobot, geom: int, joint: int) -> FloatArray:
    """Return the (3,) place of a shape in its body that is nearest to its own and on the axle."""
    data = robot.wheeled.data
    axis = data.xaxis[joint]
    anchor = data.xanchor[joint]
    place = anchor + axis * ((data.geom_xpos[geom] - anchor) @ axis)
    body = int(robot.wheeled.model.geom_bodyid[geom])
    return _in_body(robot, body, place - data.xpos[body])


def _in_body(robot: OwnRobot, body: int, direction: FloatArray) -> FloatArray:
    """Return a (3,) vector of the world in a body's frame, rounded."""
    turn = robot.wheeled.data.xmat[body].reshape(3, 3)
    return np.asarray(np.round(turn.T @ direction, 6) + 0.0)


def _mend_axes(robot: OwnRobot, text: MjcfText) -> Edits:
    """Return edits of axes whose sign differs from that of the others, or that toe in or out."""
    wheeled = robot.wheeled
    edits = {}
    for part, joint, sign in zip(_wheel_joints(robot), wheeled.joints, robot.signs, strict=True):
        wanted = wheeled.turn[1] * (sign if robot.signs.max() < 0.0 else 1.0)
        if float(wheeled.data.xaxis[joint] @ wanted) < math.cos(_TOE) and part in text:
            body = int(wheeled.model.jnt_bodyid[joint])
            edits[part] = {"axis": _row(*_in_body(robot, body, wanted))}
    return edits


def _mend_heights(robot: OwnRobot, text: MjcfText) -> Edits:
    """Return edits that bring the axles to one height."""
    wheeled = robot.wheeled
    heights = wheeled.data.xanchor[wheeled.joints, 2]
    edits = dict[Part, Mapping[str, str]]()
    for body, away in zip(wheeled.bodies, np.median(heights) - heights, strict=True):
        part = ("body", wheeled.model.body(body).name)
        parent = int(wheeled.model.body_parentid[body])
        lift = _in_body(robot, parent, np.array([0.0, 0.0, away]))
        place = np.round(wheeled.model.body_pos[body] + lift, 6) + 0.0
        edits |= _edit_differing_parts(robot, text, [part], pos=_row(*place))
    return edits


# ------------------------------------------------------------------- steps and motors
def _shorten_step(robot: OwnRobot, _: MjcfText) -> Edits:
    """Return edits with a shorter physics step."""
    return {OPTION: {"timestep": f"{min(0.5 * robot.timestep, _LONGEST_STEP):g}"}}


def _stiffen_servos(robot: OwnRobot, text: MjcfText) -> Edits:
    """Return edits that stiffen the servos, with rotors that let them be stiff."""
    slow = SPEEDS[0] * math.sqrt(robot.gravity / robot.radius)
    gain = float(f"{needed_torques(robot).max() / (_FIRM * slow):.2g}")
    edits = dict[Part, Mapping[str, str]]()
    for name in [] if robot.given_rates else robot.servos:
        servo = robot.model.actuator(name)
        part = ("actuator", name)
        wanted = gain / (float(servo.gear[0]) or 1.0) ** 2
        if -float(servo.biasprm[2]) >= wanted:
            continue
        kv = f"{wanted:.4g}"
        if text.tag(part) == "velocity":
            edits[part] = {"kv": kv}
        elif text.tag(part) == "general":
            edits[part] = {"gainprm": kv, "biasprm": f"0 0 -{kv}"}
    if edits:
        least = _usual_rotor(robot)
        model = robot.wheeled.model
        light = [part for part in _wheel_joints(robot) if model.joint(part[1]).armature < least]
        edits |= _edit_differing_parts(robot, text, light, armature=f"{least:.3g}")
    return edits


def _strengthen_motors(robot: OwnRobot, text: MjcfText) -> Edits:
    """Return edits that raise the limits of motors that cannot turn the robot, each for itself."""
    model = robot.wheeled.model
    wanted = _SPARE * needed_torques(robot)
    edits = dict[Part, Mapping[str, str]]()
    for wheel in np.flatnonzero(robot.of_wheels("effort", np.inf) < wanted).tolist():
        torque = float(f"{wanted[wheel]:.2g}")
        joint = model.joint(robot.names[wheel])
        if model.jnt_actfrclimited[joint.id]:
            edits |= _even_range(robot, text, ("joint", joint.name), "actuatorfrcrange", torque)
        for name in robot.servos:
            motor = model.actuator(name)
            if motor.trnid[0] == joint.id and motor.forcelimited[0]:
                least = torque / abs(float(motor.gear[0]) or 1.0)
                edits |= _even_range(robot, text, ("actuator", name), "forcerange", least)
    return edits


MENDS: Mapping[str, Mend] = {
    "flags": _mend_flags,
    "ties": _untie_wheels,
    "gravity": _mend_gravity,
    "medium": _set_options(density="0", viscosity="0"),
    "damping of the base": _reset_parts(_free_joint, damping="0"),
    "damping": _reset_parts(_wheel_joints, damping="0"),
    "frictionloss": _reset_parts(_wheel_joints, frictionloss="0"),
    "stiffness": _reset_parts(_wheel_joints, stiffness="0"),
    "rotors": _lighten_rotors,
    "inputs": _even_inputs,
    "condim": _reset_parts(_parts_of_contact, condim="3"),
    "masks": _reset_parts(_shapes_of_contact, contype="1", conaffinity="1"),
    "friction": _mend_friction,
    "priority": _let_tyres_decide,
    "shapes": _mend_shapes,
    "axes": _mend_axes,
    "heights": _mend_heights,
    "solver": _set_options(solver="Newton", iterations="100"),
    "cone": _set_options(cone="elliptic"),
    "impratio": _set_options(impratio="100"),
    "contact": _soften_contact,
    "margin": _reset_parts(_parts_of_contact, margin="0", gap="0"),
    "integrator": _set_options(integrator="implicitfast"),
    "step": _shorten_step,
    "motors": _strengthen_motors,
    "servos": _stiffen_servos,
}
"""Changes by the names that `influences` has for them."""
