"""Changes of an MJCF that may mend its balance: each says what it holds for the cause.

None is named before it was driven (`causes`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np
from mujoco import mjtDisableBit, mjtJoint, mjtSolver

from ssmr.types import FloatArray
from validation.descriptions.balance import SPEEDS, needed_torques, pairs_of, sliding
from validation.descriptions.findings import OFF_AXLE, UNLIKE
from validation.descriptions.mjcf_text import Edits, MjcfText, Part
from validation.descriptions.own_robot import OwnRobot
from validation.simulator.composing import CONTACT_DEPTH, CONTACT_TIME, IMPEDANCE

_IMPRATIO = 100.0
"""Stiffness of friction against sliding over that of the contact [1]."""
_FIRM = 0.03
"""Droop of servos that turn the robot on the spot at the slowest speed [1]."""
_SPARE = 1.5
"""Torque of motors over that of a turn on the spot [1]."""
_ROTOR = 0.025
"""Inertia of a wheel's rotor over mass and radius squared of robots [1]."""
_LONGEST_STEP = 0.002
"""Greatest physics step that is proposed [s]."""
_SWEEPS = 100
"""Iterations of the solver by default."""
_HARD = 0.05
"""Difference of two impedances or time constants that are not one [1]."""
_TOE = math.radians(0.3)
"""Angle of an axle to the robot's y from which it is not parallel [rad]."""
OPTION = ("option", "")
Remedy = tuple[str, str, Edits]
"""Kind of a finding, a sentence on the cause, and the edits that take it away; none where it is not
there."""


def _row(*numbers: float) -> str:
    return " ".join(f"{number:.6g}" for number in numbers)


def _reset(values: Mapping[Part, float], attribute: str, neutral: str, text: MjcfText) -> Edits:
    """Return edits that give an attribute its neutral value, where it has another."""
    return {
        part: {attribute: neutral}
        for part, value in values.items()
        if value != float(neutral) and part in text
    }


# ------------------------------------------------------------------- what brakes, holds or lifts
def _mend_flags(robot: OwnRobot, text: MjcfText) -> Remedy:
    off = {}
    for bit in mjtDisableBit.__members__.values():
        is_one = bit.name.startswith("mjDSBL_")
        if is_one and robot.model.opt.disableflags & int(bit):
            off[bit.name.removeprefix("mjDSBL_").lower()] = "enable"
    part = ("flag", "")
    edits = {part: off} if off and part in text else {}
    return "held", f"<flag> disables {', '.join(off)}", edits


def _mend_gravity(robot: OwnRobot, _: MjcfText) -> Remedy:
    x, y, z = robot.model.opt.gravity.tolist()
    edits = {OPTION: {"gravity": _row(0.0, 0.0, -robot.gravity)}} if x or y or z > 0.0 else {}
    return "load", f"gravity of {x:g} {y:g} {z:g} m/s2 does not point down", edits


def _ties(robot: OwnRobot, text: MjcfText) -> Remedy:
    active = robot.model.eq_active0.tolist()
    values = {("equality", str(number)): float(value) for number, value in enumerate(active)}
    # true and false are words
    edits = {part: {"active": "false"} for part, on in values.items() if on and part in text}
    return "held", "an <equality> ties wheels to each other or to something else", edits


def _lift_robot(robot: OwnRobot, text: MjcfText) -> Remedy:
    model = robot.wheeled.model
    bodies = robot.wheeled.group(robot.wheeled.root)
    values = {("body", model.body(body).name): float(model.body_gravcomp[body]) for body in bodies}
    return "load", "gravcomp takes weight off the tyres", _reset(values, "gravcomp", "0", text)


def _medium(robot: OwnRobot, _: MjcfText) -> Remedy:
    option = robot.model.opt
    values = {"density": option.density, "viscosity": option.viscosity}
    edits = {OPTION: dict.fromkeys(values, "0")} if any(values.values()) else {}
    cause = f"density {option.density:g} and viscosity {option.viscosity:g} are those of a liquid"
    return "held", f"{cause}, which brakes it", edits


def _base_damping(robot: OwnRobot, text: MjcfText) -> Remedy:
    model = robot.model
    root = model.body(robot.wheeled.model.body(robot.wheeled.root).name)
    joint = int(root.jntadr[0])
    damping = float(model.dof_damping[model.jnt_dofadr[joint]])
    values = {("joint", model.joint(joint).name): damping}
    is_free = model.jnt_type[joint] == mjtJoint.mjJNT_FREE
    edits = _reset(values, "damping", "0", text) if is_free else {}
    return "held", f"damping of {damping:g} of the base's free joint brakes the robot", edits


def _of_axles(attribute: str, effect: str, robot: OwnRobot, text: MjcfText) -> Remedy:
    """Take an attribute of the wheels' joints away."""
    model = robot.model
    values = {}
    for name, dof in zip(robot.names, robot.dofs, strict=True):
        of_joint = model.jnt_stiffness[model.joint(name).id]
        own = {"damping": model.dof_damping[dof], "frictionloss": model.dof_frictionloss[dof]}
        values["joint", name] = float(own.get(attribute, of_joint))
    cause = f"{attribute} of {max(values.values()):g} in the wheels' joints {effect}"
    return "held", cause, _reset(values, attribute, "0", text)


def _rotors(robot: OwnRobot, text: MjcfText) -> Remedy:
    """Make rotors as light as robots of this size have them."""
    usual = float(f"{_ROTOR * robot.mass * robot.radius**2:.3g}")
    heavy = {}
    for name, dof in zip(robot.names, robot.dofs, strict=True):
        armature = float(robot.model.dof_armature[dof])
        if armature > usual:
            heavy["joint", name] = armature
    mass = sum(heavy.values()) / robot.radius**2
    cause = f"armature of the wheels' joints has to be set off like {mass:.3g} kg more"
    return "inertia", cause, _reset(heavy, "armature", f"{usual:g}", text)


def _mend_inputs(robot: OwnRobot, text: MjcfText) -> Remedy:
    edits = dict[Part, Mapping[str, str]]()
    for name in robot.servos:
        servo = robot.model.actuator(name)
        low, high = servo.ctrlrange.tolist()
        if servo.ctrllimited[0] and low != -high:
            most = max(-low, high)
            edits["actuator", name] = {"ctrlrange": _row(-most, most)}
    return "effort", "ctrlrange lets wheels turn faster one way than the other", edits


# ------------------------------------------------------------------- tyres and ground
def _tyre_parts(robot: OwnRobot) -> list[Part]:
    """Return what says the contact of each tyre: its pairs, else its shape."""
    parts = list[Part]()
    for drum in filter(None, robot.tyres):
        pairs = pairs_of(robot, drum.geom)
        parts += [("pair", str(pair)) for pair in pairs]
        if not pairs:
            parts.append(("geom", robot.wheeled.model.geom(drum.geom).name))
    return parts


def _torsion(robot: OwnRobot, text: MjcfText) -> Remedy:
    model = robot.wheeled.model
    values = {}
    for part in [*_tyre_parts(robot), ("geom", robot.ground)]:
        kind, name = part
        dimension = model.pair_dim[int(name)] if kind == "pair" else robot.model.geom(name).condim
        values[part] = max(float(np.ravel(dimension)[0]), 3.0)
    cause = "condim above 3: torsional or rolling friction of the contacts holds the tyres"
    return "which_friction", cause, _reset(values, "condim", "3", text)


def _masks(robot: OwnRobot, text: MjcfText) -> Remedy:
    ground = robot.model.geom(robot.ground)
    edits = {}
    for drum in filter(None, robot.tyres):
        tyre = robot.wheeled.model.geom(drum.geom)
        touches = tyre.contype & ground.conaffinity | tyre.conaffinity & ground.contype
        if not touches.any() and not pairs_of(robot, drum.geom):
            for part in (("geom", tyre.name), ("geom", robot.ground)):
                edits[part] = {"contype": "1", "conaffinity": "1"}
    edits = {part: values for part, values in edits.items() if part in text}
    return "load", "contype and conaffinity keep tyres and ground apart", edits


def _mend_friction(robot: OwnRobot, text: MjcfText) -> Remedy:
    """Give tyres, or their contact pairs, one sliding friction in all directions."""
    model = robot.wheeled.model
    rows = {}
    for part in _tyre_parts(robot):
        kind, name = part
        if part not in text:
            continue
        if kind == "pair":
            rows[part] = np.split(model.pair_friction[int(name)], [2])
        else:
            geom = model.geom(name)
            rows[part] = [np.array([sliding(robot, geom.id)]), geom.friction[1:]]
    known = sorted(float(ways[0]) for ways, _ in rows.values())
    edits = {}
    kind = "unlike_wheels"
    cause = f"wheels differ in their friction ({_row(*known)})"
    for part, (ways, rest) in rows.items():
        usual = known[len(known) // 2]
        values = dict[str, str]()
        if part[0] == "geom" and int(model.geom(part[1]).condim[0]) == 1:
            values["condim"] = "3"
            kind = "which_friction"
            cause = "tyres have condim 1: they touch without friction"
        elif np.abs(ways - usual).max() > 1e-3:
            values["friction"] = _row(*[usual] * len(ways), *rest)
        if np.ptp(ways) > 1e-3:
            kind = "friction_by_heading"
            cause = f"a contact pair has the frictions {_row(*ways)} along directions of the world"
        if values:
            edits[part] = values
    return kind, cause, edits


def _mend_cone(robot: OwnRobot, _: MjcfText) -> Remedy:
    edits = {} if robot.model.opt.cone == 1 else {OPTION: {"cone": "elliptic"}}
    cause = "friction is bounded by a pyramid along axes that do not turn with the robot"
    return "pyramid", cause, edits


def _mend_impratio(robot: OwnRobot, _: MjcfText) -> Remedy:
    ratio = robot.model.opt.impratio
    edits = {} if ratio >= _IMPRATIO else {OPTION: {"impratio": f"{_IMPRATIO:g}"}}
    return "creep", f"contacts of impratio {ratio:g} let standing tyres slide", edits


def _soft(robot: OwnRobot, text: MjcfText) -> Remedy:
    """Make the contact soft on the tyres alone, which then count alone."""
    model = robot.wheeled.model
    ground = robot.model.geom(robot.ground)
    first = int(ground.priority[0])
    time = CONTACT_TIME * math.sqrt(robot.radius / robot.gravity)
    soft = {
        "solimp": _row(*IMPEDANCE, CONTACT_DEPTH * robot.radius, 0.5, 2.0),
        "solref": _row(max(time, 2.0 * model.opt.timestep), 1.0),
    }
    cause = "the contact is hard, so that wheels hop, or so soft that they sink"
    edits = {}
    for part in _tyre_parts(robot):
        kind, name = part
        edits[part] = dict(soft)
        if kind == "geom":
            tyre = model.geom(name)
            priority = int(tyre.priority[0])
            edits[part]["priority"] = str(max(priority, first + 1))
            if priority <= first:
                # the tyre's alone counts from now on: it keeps what the larger one was
                edits[part]["friction"] = _row(*np.maximum(tyre.friction, ground.friction))
            impedance = abs(float(tyre.solimp[0] - ground.solimp[0]))
            times = np.array([tyre.solref[0], ground.solref[0]])
            is_unlike = impedance > _HARD or np.ptp(times) > _HARD * np.abs(times).max()
            if is_unlike and priority == first:
                cause = (
                    f"the tyres' solimp starts at {tyre.solimp[0]:g} and the ground's at "
                    f"{ground.solimp[0]:g}, and MuJoCo takes the mean of both"
                )
    kind = "hopping" if cause.startswith("the contact") else "soft_on_one_geom"
    return kind, cause, {part: values for part, values in edits.items() if part in text}


# ------------------------------------------------------------------- shapes and places
def _shape(robot: OwnRobot, text: MjcfText) -> Remedy:
    """Make boxes and ovals round, on their axles, and of one size."""
    wheeled = robot.wheeled
    drums = list(filter(None, robot.tyres))
    radius = float(np.median([drum.radius for drum in drums]))
    width = float(np.median([drum.half_width for drum in drums]))
    edits = {}
    kind = "unlike_wheels"
    for drum, joint in zip(drums, wheeled.joints, strict=False):
        part = ("geom", wheeled.model.geom(drum.geom).name)
        values = dict[str, str]()
        is_angular = drum.kind in ("box", "oval")
        if is_angular or abs(drum.radius / radius - 1.0) > UNLIKE:
            turn = wheeled.data.geom_xmat[drum.geom].reshape(3, 3)
            along = int(np.argmax(np.abs(turn.T @ wheeled.data.xaxis[joint])))
            size = np.full(3, radius)
            size[along] = width
            if is_angular:
                values["type"] = "ellipsoid"
            elif drum.kind in ("cylinder", "capsule"):
                size = np.array([radius, width])
            elif drum.kind != "ellipsoid":
                size = np.array([radius])
            if drum.kind not in ("mesh", "lying"):
                values["size"] = _row(*size)
        if drum.off_axle > OFF_AXLE * drum.radius:
            values["pos"] = _row(*_on_axle(robot, drum.geom, joint))
        if is_angular or "pos" in values:
            kind = "wheel_shape"
        if values and part in text:
            edits[part] = values
    return kind, "tyres are not round, not on their axles or not of one size", edits


def _on_axle(robot: OwnRobot, geom: int, joint: int) -> FloatArray:
    """Return the (3,) place of a shape in its body that is nearest to its own and on the axle."""
    data = robot.wheeled.data
    axis = data.xaxis[joint]
    anchor = data.xanchor[joint]
    place = anchor + axis * ((data.geom_xpos[geom] - anchor) @ axis)
    body = int(robot.wheeled.model.geom_bodyid[geom])
    local = data.xmat[body].reshape(3, 3).T @ (place - data.xpos[body])
    return np.asarray(np.round(local, 6) + 0.0)


def _mend_axes(robot: OwnRobot, text: MjcfText) -> Remedy:
    """Turn the axes of wheels whose sign differs from that of the others, or that toe in or out."""
    wheeled = robot.wheeled
    edits = {}
    for name, joint, sign in zip(robot.names, wheeled.joints, robot.signs, strict=True):
        axis = wheeled.data.xaxis[joint]
        wanted = wheeled.turn[1] * (sign if robot.signs.max() < 0.0 else 1.0)
        if float(axis @ wanted) < math.cos(_TOE) and ("joint", name) in text:
            body = int(wheeled.model.jnt_bodyid[joint])
            local = wheeled.data.xmat[body].reshape(3, 3).T @ wanted
            edits["joint", name] = {"axis": _row(*np.round(local, 6) + 0.0)}
    return "axes", "axes of the wheels do not point the same way", edits


def _mend_heights(robot: OwnRobot, text: MjcfText) -> Remedy:
    """Bring the axles to one height."""
    wheeled = robot.wheeled
    heights = wheeled.data.xanchor[wheeled.joints, 2]
    lift = np.median(heights) - heights
    edits = {}
    for body, away in zip(wheeled.bodies, lift.tolist(), strict=True):
        part = ("body", wheeled.model.body(body).name)
        parent = int(wheeled.model.body_parentid[body])
        if abs(away) > 1e-4 and part in text:
            local = wheeled.data.xmat[parent].reshape(3, 3).T @ [0.0, 0.0, away]
            place = np.round(wheeled.model.body_pos[body] + local, 6)
            edits[part] = {"pos": _row(*place + 0.0)}
    cause = f"heights of the axles differ by {1e3 * np.ptp(heights):.1f} mm: it stands on three"
    return "unlike_wheels", f"{cause} wheels", edits


# ------------------------------------------------------------------- solver and motors
def _solver(robot: OwnRobot, _: MjcfText) -> Remedy:
    option = robot.model.opt
    name = mjtSolver(option.solver).name.removeprefix("mjSOL_")
    edits = {}
    if name != "NEWTON" or option.iterations < _SWEEPS:
        edits = {OPTION: {"solver": "Newton", "iterations": f"{_SWEEPS}"}}
    cause = f"the solver {name} with {option.iterations} iterations (sweeps) finds no forces"
    return "solver", f"{cause} that hold the tyres", edits


def _step(robot: OwnRobot, _: MjcfText) -> Remedy:
    step = robot.timestep
    shorter = min(0.5 * step, _LONGEST_STEP)
    cause = f"the step of {1e3 * step:g} ms is too long for contacts and servos"
    return "step", cause, {OPTION: {"timestep": f"{shorter:g}"}}


def _servo(robot: OwnRobot, text: MjcfText) -> Remedy:
    """Stiffen the servos, with rotors that let them be stiff."""
    model = robot.model
    slow = SPEEDS[0] * math.sqrt(robot.gravity / robot.radius)
    gain = float(f"{needed_torques(robot).max() / (_FIRM * slow):.2g}")
    edits = dict[Part, Mapping[str, str]]()
    softest = gain
    for name in [] if robot.given_rates else robot.servos:
        servo = model.actuator(name)
        part = ("actuator", name)
        gear2 = (float(servo.gear[0]) or 1.0) ** 2
        stiffness = -float(servo.biasprm[2])
        softest = min(softest, stiffness)
        if stiffness * gear2 >= gain:
            continue
        kv = f"{gain / gear2:.4g}"
        if text.tag(part) == "velocity":
            edits[part] = {"kv": kv}
        elif text.tag(part) == "general":
            edits[part] = {"gainprm": kv, "biasprm": f"0 0 -{kv}"}
    cause = f"the wheels' servos are too soft (kv is {softest:g}) and give way to the ground"
    if edits:
        edits[OPTION] = {"integrator": "implicitfast"}
        least = _ROTOR * robot.mass * robot.radius**2
        for name, dof in zip(robot.names, robot.dofs, strict=True):
            if model.dof_armature[dof] < least and ("joint", name) in text:
                edits["joint", name] = {"armature": f"{least:.3g}"}
    return "servo_soft", f"{cause}, which is no skidding and which no multiplier mends", edits


def _motor(robot: OwnRobot, text: MjcfText) -> Remedy:
    """Raise the limits of motors that cannot turn the robot, each for itself."""
    model = robot.model
    wanted = _SPARE * needed_torques(robot)
    weak = np.flatnonzero(robot.most_torques < wanted).tolist()
    edits = dict[Part, Mapping[str, str]]()
    names = list[str]()
    for wheel in weak:
        torque = float(f"{wanted[wheel]:.2g}")
        joint = model.joint(robot.names[wheel])
        if model.jnt_actfrclimited[joint.id] and ("joint", joint.name) in text:
            most = max(torque, float(np.abs(model.jnt_actfrcrange[joint.id]).max()))
            edits["joint", joint.name] = {"actuatorfrcrange": _row(-most, most)}
        for name in robot.servos:
            motor = model.actuator(name)
            if motor.trnid[0] == joint.id and motor.forcelimited[0]:
                most = torque / abs(float(motor.gear[0]) or 1.0)
                most = max(most, float(np.abs(motor.forcerange).max()))
                edits["actuator", name] = {"forcerange": _row(-most, most)}
                names.append(name)
    least = float(robot.most_torques.min(initial=np.inf))
    cause = f"motors are weak ({', '.join(names)}): the weakest gives {least:.3g} N m"
    return "motor_weak", cause, edits


REMEDIES: Sequence[Callable[[OwnRobot, MjcfText], Remedy]] = (
    _mend_flags,
    _mend_gravity,
    _ties,
    _lift_robot,
    _medium,
    _base_damping,
    partial(_of_axles, "damping", "brakes them"),
    partial(_of_axles, "frictionloss", "brakes them"),
    partial(_of_axles, "stiffness", "turns them back"),
    _rotors,
    _mend_inputs,
    _torsion,
    _masks,
    _mend_friction,
    _shape,
    _mend_axes,
    _mend_heights,
    _solver,
    _mend_cone,
    _mend_impratio,
    _soft,
    _step,
    _motor,
    _servo,
)
"""Changes, first of all those of what is in the file alone for no good; where two mend the same,
the last one is not needed."""
