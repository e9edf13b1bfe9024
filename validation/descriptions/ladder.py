"""Changes of an MJCF that are tried before they are named: all that may help, then as few as do."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ssmr.errors import SsmrError
from validation.descriptions.findings import OFF_AXLE, UNLIKE
from validation.descriptions.mjcf_text import Edits, MjcfText
from validation.descriptions.own_robot import OwnRobot
from validation.descriptions.trials import SPEEDS, Measures, examine, mechanical_turn
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


def deviations(measures: Measures, robot: OwnRobot) -> Measures:
    """Return how far each number is from where it should be, as `_LIMITS` has them."""
    unit = math.sqrt(robot.gravity * robot.radius)
    out = Measures()
    for name in ("lifted_share", "droop", "droop_at_speed", "saturated", "diverged"):
        out[name] = measures.get(name, 0.0)
    out["veer_share"] = abs(measures.get("veer_share", 0.0))
    out["rolls"] = measures.get("rolls_m_s", 0.0) / unit
    out["creep"] = measures.get("creep_m_s", 0.0) / unit
    out["step"] = measures.get("step_halved_m", 0.0) / max(measures.get("curve_m", 1.0), 0.05)
    if "multiplier" in measures:
        ratio = measures["multiplier"]
        out["ratio"] = abs(ratio / measures["closed_form"] - 1.0)
        spread = measures.get("multiplier_max", ratio) - measures.get("multiplier_min", ratio)
        out["ripple"] = spread / ratio
    else:
        out["ratio"] = _WORST * _LIMITS["ratio"]
    return out


def exceeds(measures: Measures, robot: OwnRobot, name: str) -> bool:
    """Return whether a number of `deviations` is more than a sound model has."""
    return deviations(measures, robot).get(name, 0.0) > _LIMITS[name]


def _badness(measures: Measures, robot: OwnRobot) -> float:
    """Return how bad a robot is: a sum over all numbers beyond their limits, 0 for a sound one."""
    total = 0.0
    for name, value in deviations(measures, robot).items():
        total += min(max(value / _LIMITS[name] - 1.0, 0.0), _WORST)
    return total


class Rung(NamedTuple):
    """A change that may help."""

    name: str
    """The change that it makes."""
    kinds: tuple[str, ...]
    """Kinds of findings that it may cure."""
    edits: Edits
    """The attributes, and their values."""


class Climb(NamedTuple):
    """A model of others with as few changes as help."""

    robot: OwnRobot
    """The robot before any change but the rescue."""
    before: Measures
    """Measurements before the changes."""
    after: Measures
    """Measurements with the changes."""
    rescue: Rung | None
    """The change without which its simulation does not even run; None where it does."""
    rungs: Sequence[Rung]
    """The changes that help, with the rescue."""
    text: str
    """The file with these changes."""


def climb(text: MjcfText | str, files: Mapping[str, bytes]) -> Climb:
    """Try changes of a model: all that apply, and then take away each that is not needed.

    A plain text is of a model whose parts cannot be changed one by one: it is only examined.

    Raises:
        ValueError: the model cannot be compiled.
        SsmrError: its simulation fails whatever is changed.
    """
    if isinstance(text, str):
        robot = OwnRobot(text, files)
        before = examine(robot)
        return Climb(robot, before, before, None, (), text)
    robot, before, rescue = _rescued(text, files)
    rungs = [rung for make in _RUNGS if (rung := make(robot, text, before)) is not None]
    if rescue is not None:
        rungs.insert(0, rescue)
    if not rungs:
        return Climb(robot, before, before, rescue, (), text.edited({}))
    kept = list(rungs)
    after = _tried(text, files, kept)
    if exceeds(after, robot, "step"):
        step = min(float(robot.model.opt.timestep), _LONGEST_STEP)
        kept.append(Rung("step", ("step",), {("option", "", "timestep"): f"{0.5 * step:g}"}))
        after = _tried(text, files, kept)
    badness = _badness(after, robot)
    for rung in reversed(list(kept)):
        fewer = [other for other in kept if other is not rung]
        without = _tried(text, files, fewer)
        worse = _badness(without, robot) - badness
        if rung is not rescue and rung.name not in _CORRECTIONS and worse < _WORTH:
            kept = fewer
            after = without
            badness = _badness(after, robot)
    return Climb(robot, before, after, rescue, kept, text.edited(_together(kept)))


def _together(rungs: Sequence[Rung]) -> Edits:
    edits = dict[tuple[str, str, str], str]()
    for rung in rungs:
        edits |= rung.edits
    return edits


def _tried(text: MjcfText, files: Mapping[str, bytes], rungs: Sequence[Rung]) -> Measures:
    """Return what the trials say of a model with some changes."""
    try:
        return examine(OwnRobot(text.edited(_together(rungs)), files))
    except (ValueError, SsmrError):
        return Measures(diverged=_WORST)


def _rescued(text: MjcfText, files: Mapping[str, bytes]) -> tuple[OwnRobot, Measures, Rung | None]:
    """Return a robot that runs, what it measured, and the change that it needs to run at all."""
    robot = OwnRobot(text.edited({}), files)
    before = examine(robot)
    step = float(robot.model.opt.timestep)
    option = ("option", "", "integrator")
    ways: list[dict[tuple[str, str, str], str]] = [{option: "implicitfast"}]
    for halvings in (1, 2, 3, 4):
        ways.append({option: "implicitfast", ("option", "", "timestep"): f"{step / 2**halvings:g}"})
    for edits in ways:
        if before["diverged"] == 0.0:
            break
        rescue = Rung("step", ("step",), edits)
        mended = OwnRobot(text.edited(edits), files)
        measures = examine(mended)
        if measures["diverged"] == 0.0:
            return mended, measures, rescue
    return robot, before, None


# ------------------------------------------------------------------------------- the rungs
def _cone(robot: OwnRobot, _text: MjcfText, _: Measures) -> Rung | None:
    if robot.model.opt.cone == 1:
        return None
    return Rung("cone", ("pyramid", "creep"), {("option", "", "cone"): "elliptic"})


def _impratio(robot: OwnRobot, _text: MjcfText, _: Measures) -> Rung | None:
    if robot.model.opt.impratio >= 0.5 * _IMPRATIO:
        return None
    edits = {("option", "", "impratio"): f"{_IMPRATIO:g}"}
    return Rung("impratio", ("creep", "pyramid"), edits)


def _row(*numbers: float) -> str:
    return " ".join(f"{number:.6g}" for number in numbers)


def pairs_of(robot: OwnRobot, geom: int) -> list[int]:
    """Return the numbers of the contact pairs of a shape."""
    model = robot.wheeled.model
    hit = (model.pair_geom1 == geom) | (model.pair_geom2 == geom)
    return [int(pair) for pair in np.flatnonzero(hit)]


def tyre_parts(robot: OwnRobot) -> list[tuple[str, str]]:
    """Return kind and name of what says the contact of each tyre: its pairs, else its shape."""
    parts = []
    for drum in robot.tyres:
        if drum is None:
            continue
        pairs = pairs_of(robot, drum.geom)
        parts += [("pair", str(pair)) for pair in pairs]
        if not pairs:
            parts.append(("geom", robot.wheeled.model.geom(drum.geom).name))
    return parts


def _soft(robot: OwnRobot, _text: MjcfText, _: Measures) -> Rung | None:
    """Make the contact soft on the tyres alone, which then count alone."""
    model = robot.wheeled.model
    ground = robot.model.geom(robot.ground)
    solimp = _row(*IMPEDANCE, CONTACT_DEPTH * robot.radius, 0.5, 2.0)
    time = CONTACT_TIME * math.sqrt(robot.radius / robot.gravity)
    edits = {}
    for kind, name in tyre_parts(robot):
        edits[kind, name, "solimp"] = solimp
        edits[kind, name, "solref"] = _row(max(time, 2.0 * model.opt.timestep), 1.0)
        if kind == "geom":
            tyre = model.geom(name)
            edits[kind, name, "priority"] = str(int(max(tyre.priority[0], ground.priority[0] + 1)))
            friction = np.maximum(tyre.friction, ground.friction)
            if int(tyre.priority[0]) <= int(ground.priority[0]):
                # the tyre's alone counts from now on: it keeps what the larger one was
                edits[kind, name, "friction"] = _row(*friction)
    return Rung("contact", ("hopping", "soft_on_one_geom", "which_friction"), edits)


def needed_torque(robot: OwnRobot) -> float:
    """Return the torque of a wheel in a turn on the spot on its ground, with its dry friction."""
    friction = float(np.max([sliding(robot, drum.geom) for drum in robot.tyres if drum]))
    slip = mechanical_turn(robot).slip
    model = robot.model
    dofs = [int(model.joint(name).dofadr[0]) for name in robot.names]
    dry = float(model.dof_frictionloss[dofs].max())
    return 0.25 * friction * robot.mass * robot.gravity * robot.radius * slip + dry


def sliding(robot: OwnRobot, geom: int) -> float:
    """Return the friction with which a tyre slides on the ground [1]."""
    model = robot.wheeled.model
    pairs = pairs_of(robot, geom)
    if pairs:
        return float(model.pair_friction[pairs[0], :2].max())
    tyre = model.geom(geom)
    ground = robot.model.geom(robot.ground)
    if tyre.priority[0] > ground.priority[0]:
        return float(tyre.friction[0])
    if tyre.priority[0] < ground.priority[0]:
        return float(ground.friction[0])
    return float(max(tyre.friction[0], ground.friction[0]))


def _servo(robot: OwnRobot, text: MjcfText, _: Measures) -> Rung | None:
    """Stiffen the servos, with rotors that let them be stiff."""
    if robot.given_rates:
        return None
    slow = SPEEDS[0] * math.sqrt(robot.gravity / robot.radius)
    gain = float(f"{needed_torque(robot) / (_FIRM * slow):.2g}")
    edits: dict[tuple[str, str, str], str] = {}
    for name in robot.servos:
        number = robot.model.actuator(name).id
        own = -float(robot.model.actuator_biasprm[number, 2])
        gear = float(robot.model.actuator_gear[number, 0]) or 1.0
        if own * gear**2 >= gain:
            continue
        kv = f"{gain / gear**2:.4g}"
        if text.tag("actuator", name) == "velocity":
            edits["actuator", name, "kv"] = kv
        elif text.tag("actuator", name) == "general":
            edits["actuator", name, "gainprm"] = kv
            edits["actuator", name, "biasprm"] = f"0 0 -{kv}"
    if not edits:
        return None
    edits["option", "", "integrator"] = "implicitfast"
    least = 0.025 * robot.mass * robot.radius**2
    for name in robot.names:
        dof = int(robot.model.joint(name).dofadr[0])
        if robot.model.dof_armature[dof] < least and text.has("joint", name):
            edits["joint", name, "armature"] = f"{least:.3g}"
    return Rung("servo", ("servo_soft", "rolls"), edits)


def _motor(robot: OwnRobot, text: MjcfText, before: Measures) -> Rung | None:
    """Raise the limits of motors that cannot turn the robot."""
    if before.get("saturated", 0.0) <= _LIMITS["saturated"]:
        return None
    torque = float(f"{_SPARE * needed_torque(robot):.2g}")
    edits = {}
    for name in robot.servos:
        number = robot.model.actuator(name).id
        if robot.model.actuator_forcelimited[number]:
            edits["actuator", name, "forcerange"] = _row(-torque, torque)
    for name in robot.names:
        if robot.model.jnt_actfrclimited[robot.model.joint(name).id] and text.has("joint", name):
            edits["joint", name, "actuatorfrcrange"] = _row(-torque, torque)
    return Rung("motor", ("motor_weak",), edits) if edits else None


def _step(robot: OwnRobot, _text: MjcfText, _: Measures) -> Rung | None:
    if robot.model.opt.timestep <= _LONGEST_STEP:
        return None
    edits = {("option", "", "timestep"): f"{_LONGEST_STEP:g}"}
    return Rung("step", ("step",), edits)


def _shape(robot: OwnRobot, text: MjcfText, _: Measures) -> Rung | None:
    """Make boxes and ovals round, on their axles, and of one size."""
    model = robot.wheeled.model
    drums = [drum for drum in robot.tyres if drum is not None]
    radius = float(np.median([drum.radius for drum in drums]))
    width = float(np.median([drum.half_width for drum in drums]))
    edits = {}
    for drum, joint in zip(drums, robot.wheeled.joints, strict=False):
        name = model.geom(drum.geom).name
        if not text.has("geom", name):
            continue
        turn = robot.wheeled.data.geom_xmat[drum.geom].reshape(3, 3)
        along = int(np.argmax(np.abs(turn.T @ robot.wheeled.data.xaxis[joint])))
        if drum.kind in ("box", "oval") or abs(drum.radius / radius - 1.0) > UNLIKE:
            size = np.full(3, radius)
            size[along] = width
            if drum.kind in ("box", "oval"):
                edits["geom", name, "type"] = "ellipsoid"
            elif drum.kind in ("cylinder", "capsule"):
                size = np.array([radius, width])
            elif drum.kind != "ellipsoid":
                size = np.array([radius])
            if drum.kind not in ("mesh", "lying"):
                edits["geom", name, "size"] = _row(*size)
        if drum.off_axle > OFF_AXLE * drum.radius:
            edits["geom", name, "pos"] = _row(*_on_axle(robot, drum.geom, joint))
    return Rung("shape", ("wheel_shape", "unlike_wheels"), edits) if edits else None


def _on_axle(robot: OwnRobot, geom: int, joint: int) -> list[float]:
    """Return the place of a shape in its body that is nearest to its own and on the axle."""
    data = robot.wheeled.data
    axis = data.xaxis[joint]
    away = data.geom_xpos[geom] - data.xanchor[joint]
    place = data.xanchor[joint] + axis * (away @ axis)
    body = int(robot.wheeled.model.geom_bodyid[geom])
    turn = data.xmat[body].reshape(3, 3)
    local = turn.T @ (place - data.xpos[body])
    return [float(number) for number in np.round(local, 6) + 0.0]


def _axes(robot: OwnRobot, text: MjcfText, _: Measures) -> Rung | None:
    """Turn the axes of wheels whose sign differs from that of the others."""
    model = robot.wheeled.model
    edits = {}
    for joint, sign in zip(robot.wheeled.joints, robot.wheeled.signs, strict=True):
        name = model.joint(joint).name
        if sign < 0.0 < robot.wheeled.signs.max() and text.has("joint", name):
            edits["joint", name, "axis"] = _row(*(-model.jnt_axis[joint] + 0.0))
    return Rung("axes", ("axes",), edits) if edits else None


def _friction(robot: OwnRobot, text: MjcfText, _: Measures) -> Rung | None:
    """Give tyres, or their contact pairs, one sliding friction in all directions."""
    model = robot.wheeled.model
    parts = [part for part in tyre_parts(robot) if text.has(*part)]
    rows = []
    for kind, name in parts:
        row = model.pair_friction[int(name)] if kind == "pair" else model.geom(name).friction
        if kind == "geom":
            row = np.append(sliding(robot, model.geom(name).id), row[1:])
        rows.append(row)
    usual = sorted(float(row[0]) for row in rows)[len(rows) // 2] if rows else 0.0
    edits = {}
    for (kind, name), row in zip(parts, rows, strict=True):
        ways = 2 if kind == "pair" else 1
        if np.abs(row[:ways] - usual).max() > 1e-3:
            edits[kind, name, "friction"] = _row(*[usual] * ways, *row[ways:])
        if kind == "geom" and int(model.geom(name).condim[0]) == 1:
            edits[kind, name, "condim"] = "3"
    kinds = ("friction_by_heading", "unlike_wheels", "which_friction")
    return Rung("friction", kinds, edits) if edits else None


_RUNGS: Sequence[Callable[[OwnRobot, MjcfText, Measures], Rung | None]] = (
    _cone,
    _impratio,
    _soft,
    _servo,
    _motor,
    _step,
    _shape,
    _axes,
    _friction,
)
_CORRECTIONS = ("shape", "axes", "friction", "cone")
"""Changes of what is wrong by the file alone; they stay whatever the trials say."""
