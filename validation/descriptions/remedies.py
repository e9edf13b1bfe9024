"""Changes of an MJCF that are tried before they are named: all that may help, then as few as do."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping

import numpy as np

from ssmr.errors import SsmrError
from ssmr.types import FloatArray
from validation.descriptions.findings import OFF_AXLE, UNLIKE
from validation.descriptions.mjcf_text import Edits, MjcfText, Part
from validation.descriptions.own_robot import Measures, OwnRobot
from validation.descriptions.trials import SPEEDS, examine, mechanical_turn
from validation.simulator.composing import CONTACT_DEPTH, CONTACT_TIME, IMPEDANCE

_LIMITS: Mapping[str, float] = {
    "ratio": 0.03,
    "ripple": 0.05,
    "lifted_share": 0.01,
    "droop": 0.10,
    "droop_at_speed": 0.05,
    "saturated": 0.05,
    "rolls": 0.0025,
    "creep": 0.0007,
    "step": 0.05,
    "veer_share": 0.02,
    "diverged": 0.5,
}
"""Greatest value of each number that a sound model has [1]; speeds are over sqrt(g r)."""
_WORST = 3.0
"""Greatest badness of one number: beyond, it is as bad as it can be."""
_WORTH = 0.05
"""Badness that a change must save, or it is taken away again."""
_IMPRATIO = 100.0
"""Stiffness of friction against sliding over that of the contact [1]."""
_FIRM = 0.03
"""Droop of servos that turn the robot on the spot at the slowest speed [1]."""
_SPARE = 1.5
"""Torque of motors over that of a turn on the spot [1]."""
_LONGEST_STEP = 0.002
"""Greatest physics step that is proposed [s]."""
_OPTION = ("option", "")


def _deviations(measures: Measures) -> Measures:
    """Return how far each number is from where it should be, as `_LIMITS` has them."""
    get = measures.get
    unit = get("speed_unit_m_s", 1.0)
    out = {name: get(name, 0.0) for name in _LIMITS}
    out["veer_share"] = abs(out["veer_share"])
    out["rolls"] = get("rolls_m_s", 0.0) / unit
    out["creep"] = get("creep_m_s", 0.0) / unit
    out["step"] = get("step_halved_m", 0.0) / max(get("curve_m", 1.0), 0.05)
    if "multiplier" not in measures:
        out["ratio"] = _WORST * _LIMITS["ratio"]
        return out
    ratio = measures["multiplier"]
    out["ratio"] = abs(ratio / measures["closed_form"] - 1.0)
    spread = get("multiplier_max", ratio) - get("multiplier_min", ratio)
    out["ripple"] = spread / ratio
    return out


def exceeds(robot: OwnRobot, name: str) -> bool:
    """Return whether a number of a robot's trials, see `_LIMITS`, is more than a sound one has."""
    return _deviations(robot.measures)[name] > _LIMITS[name]


def _badness(measures: Measures) -> float:
    """Return how bad a robot is: a sum over all numbers beyond their limits, 0 for a sound one."""
    total = 0.0
    for name, value in _deviations(measures).items():
        total += min(max(value / _LIMITS[name] - 1.0, 0.0), _WORST)
    return total


def climb(
    robot: OwnRobot, text: MjcfText, files: Mapping[str, bytes]
) -> tuple[OwnRobot, dict[str, Edits], Measures]:
    """Try changes of a model: all that apply, and then take away each that is not needed.

    Args:
        robot: the model as it is, after its trials.
        text: its file.
        files: the files that this names.

    Returns:
        The robot, with the change without which its simulation does not even run; the changes that
        help, by name, with that one; and what the trials say with all of these.

    Raises:
        SsmrError: its simulation fails whatever is changed.
    """
    robot, kept = _rescued(robot, text, files)
    for name, make in _RUNGS.items():
        edits = make(robot, text)
        if edits:
            kept[name] = edits
    if not kept:
        return robot, kept, robot.measures
    after = _tried(text, files, kept)
    if _deviations(after)["step"] > _LIMITS["step"]:
        step = min(robot.timestep, _LONGEST_STEP)
        kept["halved step"] = {_OPTION: {"timestep": f"{0.5 * step:g}"}}
        after = _tried(text, files, kept)
    badness = _badness(after)
    for name in reversed(list(kept)):
        if name in _CORRECTIONS:
            continue
        fewer = {other: edits for other, edits in kept.items() if other != name}
        without = _tried(text, files, fewer)
        worse = _badness(without) - badness
        if worse < _WORTH:
            kept = fewer
            after = without
            badness = _badness(after)
    return robot, kept, after


def together(changes: Iterable[Edits]) -> Edits:
    """Return the edits of several changes; of one attribute the last one counts."""
    edits = dict[Part, Mapping[str, str]]()
    for change in changes:
        for part, values in change.items():
            edits[part] = {**edits.get(part, {}), **values}
    return edits


def _tried(text: MjcfText, files: Mapping[str, bytes], changes: Mapping[str, Edits]) -> Measures:
    """Return what the trials say of a model with some changes."""
    try:
        return examine(OwnRobot(text.edited(together(changes.values())), files))
    except (ValueError, SsmrError):
        return Measures(diverged=_WORST)


def _rescued(
    robot: OwnRobot, text: MjcfText, files: Mapping[str, bytes]
) -> tuple[OwnRobot, dict[str, Edits]]:
    """Return a robot that runs, and the change that it needs to run at all, if any does."""
    for halvings in range(5):
        if robot.measures["diverged"] == 0.0:
            break
        values = {"integrator": "implicitfast"}
        if halvings > 0:
            values["timestep"] = f"{robot.timestep / 2**halvings:g}"
        rescue = {_OPTION: values}
        mended = OwnRobot(text.edited(rescue), files)
        if examine(mended)["diverged"] == 0.0:
            mended.rescued = True
            return mended, {"rescue": rescue}
    return robot, {}


# ------------------------------------------------------------------------------- the rungs
def _cone(robot: OwnRobot, _: MjcfText) -> Edits:
    if robot.model.opt.cone == 1:
        return {}
    return {_OPTION: {"cone": "elliptic"}}


def _impratio(robot: OwnRobot, _: MjcfText) -> Edits:
    if robot.model.opt.impratio >= 0.5 * _IMPRATIO:
        return {}
    return {_OPTION: {"impratio": f"{_IMPRATIO:g}"}}


def _row(*numbers: float) -> str:
    return " ".join(f"{number:.6g}" for number in numbers)


def pairs_of(robot: OwnRobot, geom: int) -> list[int]:
    """Return the numbers of the contact pairs of a shape."""
    model = robot.wheeled.model
    hit = (model.pair_geom1 == geom) | (model.pair_geom2 == geom)
    return np.flatnonzero(hit).tolist()


def _tyre_parts(robot: OwnRobot) -> list[Part]:
    """Return what says the contact of each tyre: its pairs, else its shape."""
    parts = list[Part]()
    for drum in filter(None, robot.tyres):
        pairs = pairs_of(robot, drum.geom)
        parts += [("pair", str(pair)) for pair in pairs]
        if not pairs:
            parts.append(("geom", robot.wheeled.model.geom(drum.geom).name))
    return parts


def _soft(robot: OwnRobot, _: MjcfText) -> Edits:
    """Make the contact soft on the tyres alone, which then count alone."""
    model = robot.wheeled.model
    ground = robot.model.geom(robot.ground)
    first = int(ground.priority[0])
    time = CONTACT_TIME * math.sqrt(robot.radius / robot.gravity)
    soft = {
        "solimp": _row(*IMPEDANCE, CONTACT_DEPTH * robot.radius, 0.5, 2.0),
        "solref": _row(max(time, 2.0 * model.opt.timestep), 1.0),
    }
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
    return edits


def _needed_torque(robot: OwnRobot) -> float:
    """Return the torque of a wheel in a turn on the spot on its ground, with its dry friction."""
    friction = max(sliding(robot, drum.geom) for drum in filter(None, robot.tyres))
    slip = mechanical_turn(robot).slip
    dry = float(robot.model.dof_frictionloss[robot.dofs].max())
    return 0.25 * friction * robot.mass * robot.gravity * robot.radius * slip + dry


def sliding(robot: OwnRobot, geom: int) -> float:
    """Return the friction with which a tyre slides on the ground [1]."""
    model = robot.wheeled.model
    pairs = pairs_of(robot, geom)
    if pairs:
        return float(model.pair_friction[pairs[0], :2].max())
    sides = [model.geom(geom), robot.model.geom(robot.ground)]
    first = max(int(side.priority[0]) for side in sides)
    return max(float(side.friction[0]) for side in sides if int(side.priority[0]) == first)


def _servo(robot: OwnRobot, text: MjcfText) -> Edits:
    """Stiffen the servos, with rotors that let them be stiff."""
    if robot.given_rates:
        return {}
    model = robot.model
    slow = SPEEDS[0] * math.sqrt(robot.gravity / robot.radius)
    gain = float(f"{_needed_torque(robot) / (_FIRM * slow):.2g}")
    edits = dict[Part, Mapping[str, str]]()
    for name in robot.servos:
        servo = model.actuator(name)
        part = ("actuator", name)
        gear2 = (float(servo.gear[0]) or 1.0) ** 2
        if -float(servo.biasprm[2]) * gear2 >= gain:
            continue
        kv = f"{gain / gear2:.4g}"
        if text.tag(part) == "velocity":
            edits[part] = {"kv": kv}
        elif text.tag(part) == "general":
            edits[part] = {"gainprm": kv, "biasprm": f"0 0 -{kv}"}
    if not edits:
        return {}
    edits[_OPTION] = {"integrator": "implicitfast"}
    least = 0.025 * robot.mass * robot.radius**2
    for name, dof in zip(robot.names, robot.dofs, strict=True):
        if model.dof_armature[dof] < least and ("joint", name) in text:
            edits["joint", name] = {"armature": f"{least:.3g}"}
    return edits


def _motor(robot: OwnRobot, text: MjcfText) -> Edits:
    """Raise the limits of motors that cannot turn the robot."""
    if not exceeds(robot, "saturated"):
        return {}
    torque = float(f"{_SPARE * _needed_torque(robot):.2g}")
    limits = _row(-torque, torque)
    model = robot.model
    edits = {}
    for name in robot.servos:
        if model.actuator_forcelimited[model.actuator(name).id]:
            edits["actuator", name] = {"forcerange": limits}
    for name in robot.names:
        if model.jnt_actfrclimited[model.joint(name).id] and ("joint", name) in text:
            edits["joint", name] = {"actuatorfrcrange": limits}
    return edits


def _step(robot: OwnRobot, _: MjcfText) -> Edits:
    if robot.timestep <= _LONGEST_STEP:
        return {}
    return {_OPTION: {"timestep": f"{_LONGEST_STEP:g}"}}


def _shape(robot: OwnRobot, text: MjcfText) -> Edits:
    """Make boxes and ovals round, on their axles, and of one size."""
    wheeled = robot.wheeled
    drums = list(filter(None, robot.tyres))
    radius = float(np.median([drum.radius for drum in drums]))
    width = float(np.median([drum.half_width for drum in drums]))
    edits = {}
    for drum, joint in zip(drums, wheeled.joints, strict=False):
        part = ("geom", wheeled.model.geom(drum.geom).name)
        if part not in text:
            continue
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
        if values:
            edits[part] = values
    return edits


def _on_axle(robot: OwnRobot, geom: int, joint: int) -> FloatArray:
    """Return the (3,) place of a shape in its body that is nearest to its own and on the axle."""
    data = robot.wheeled.data
    axis = data.xaxis[joint]
    anchor = data.xanchor[joint]
    place = anchor + axis * ((data.geom_xpos[geom] - anchor) @ axis)
    body = int(robot.wheeled.model.geom_bodyid[geom])
    local = data.xmat[body].reshape(3, 3).T @ (place - data.xpos[body])
    return np.asarray(np.round(local, 6) + 0.0)


def _axes(robot: OwnRobot, text: MjcfText) -> Edits:
    """Turn the axes of wheels whose sign differs from that of the others."""
    edits = {}
    for name, joint, sign in zip(robot.names, robot.wheeled.joints, robot.signs, strict=True):
        if sign < 0.0 < robot.signs.max() and ("joint", name) in text:
            axis = -robot.wheeled.model.jnt_axis[joint] + 0.0
            edits["joint", name] = {"axis": _row(*axis)}
    return edits


def _friction(robot: OwnRobot, text: MjcfText) -> Edits:
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
    for part, (ways, rest) in rows.items():
        usual = known[len(known) // 2]
        values = dict[str, str]()
        if np.abs(ways - usual).max() > 1e-3:
            values["friction"] = _row(*[usual] * len(ways), *rest)
        if part[0] == "geom" and int(model.geom(part[1]).condim[0]) == 1:
            values["condim"] = "3"
        if values:
            edits[part] = values
    return edits


_RUNGS: Mapping[str, Callable[[OwnRobot, MjcfText], Edits]] = {
    "cone": _cone,
    "impratio": _impratio,
    "contact": _soft,
    "servo": _servo,
    "motor": _motor,
    "step": _step,
    "shape": _shape,
    "axes": _axes,
    "friction": _friction,
}
"""Function of each change that may help, which returns the edits of a robot; none where it is of no
use."""
CURES: Mapping[str, tuple[str, ...]] = {
    "rescue": ("step",),
    "cone": ("pyramid", "creep"),
    "impratio": ("creep", "pyramid"),
    "contact": ("hopping", "soft_on_one_geom", "which_friction"),
    "servo": ("servo_soft", "rolls"),
    "motor": ("motor_weak",),
    "step": ("step",),
    "halved step": ("step",),
    "shape": ("wheel_shape", "unlike_wheels"),
    "axes": ("axes",),
    "friction": ("friction_by_heading", "unlike_wheels", "which_friction"),
}
"""Kinds of findings that each change may cure."""
_CORRECTIONS = ("rescue", "shape", "axes", "friction", "cone")
"""Changes of what is wrong by the file alone, or stops it; they stay whatever the trials say."""
