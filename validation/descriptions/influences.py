"""What stops, slows or turns a robot of others, by its file alone: one table for all formats.

Each line weighs what an attribute does against what a turn on the spot needs: torques of an axle
against what its motor has to spare, moments against that of the tyres' friction, lost load against
the load, speeds against that of the rims.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from ssmr.robot.ground import FRONT, LEFT, SkidTurn
from ssmr.types import FloatArray
from validation.descriptions.foreign_robot import ForeignRobot
from validation.descriptions.wheels import named_end, named_side
from validation.output import one_line
from validation.simulator.checking import spot_turn, turning_torque
from validation.simulator.description import GRAVITY, Robot

_FROUDE = 0.25
"""Speed of the rims in the turn that everything is weighed against, over sqrt(g r) [1]."""
_NOTICED = 0.03
"""Share of the turn that raises a question [1]: a balance of torques and loads closes to this."""
_SPOILT = 0.25
"""Share of the turn from which it is a fault [1]."""
_SLIPPERY = 0.01
"""Friction of tyres that hold nothing [1]: wet ice has several times that."""
_EQUAL = 0.004
"""Deviation of two frictions or radii that are one, and height by which one of four stiff tyres
misses level ground over their radius [1]."""
STOPPING = ("held", "load", "effort", "motor_weak", "solver")
"""Kinds of what stops a robot, lifts it or leaves it without motors: whatever else it then does
wrong follows from that."""


class _Stand:
    """A robot of others in a slow turn on the spot: what each wheel bears, needs and has.

    Arrays are (4,), in the order of `WHEELS`; NaN stands for what the file does not say.
    """

    def __init__(self, robot: Robot, foreign: ForeignRobot, turn: SkidTurn) -> None:
        """Compute loads, torques and speeds of a turn by mechanics."""
        self.foreign = foreign
        self.model = foreign.wheeled.model
        self.joints = foreign.wheeled.joints
        self.dofs = self.model.jnt_dofadr[self.joints]
        self.radius = robot.wheel_radius
        self.radii = np.array([np.nan if drum is None else drum.radius for drum in foreign.drums])
        self.slip = turn.slip
        self.weight = robot.mass * GRAVITY
        self.load = 0.25 * self.weight
        self.rim = _FROUDE * math.sqrt(GRAVITY * self.radius)
        self.rate = self.rim / self.radius
        self.slow = 0.1 * self.rate
        self.mu = np.nan_to_num(self.of_wheels("mu1"), nan=robot.friction)
        self.need = 0.5 * robot.friction * turning_torque(robot, turn)
        reach = 0.5 * math.hypot(robot.wheelbase, robot.track)
        self.moment = self.weight * robot.friction * reach
        self.one = 1.0
        self.slippery = _SLIPPERY
        self.few_turns = 4.0 * np.pi
        # a wheel that differs by more is a fault
        self.spread = _EQUAL / _SPOILT
        self.names = foreign.wheeled.names
        self.heights = foreign.wheeled.data.xanchor[self.joints, 2]
        self.gap = abs(float(self.heights @ (FRONT * LEFT)))
        self.strange = one_line(", ".join(self._strange_joints()))
        self.passive = self._passive_moments(turn.yaw_rate * self.rim)

    def of_wheels(self, key: str) -> FloatArray:
        """Return a number of the wheels' surfaces, joints or motors."""
        numbers = zip(self.foreign.contacts, self.foreign.limits, strict=True)
        return np.array([(one | other).get(key, np.nan) for one, other in numbers])

    def _passive_moments(self, yaw_rate: float) -> Mapping[str, tuple[FloatArray, float]]:
        """Return what dampers, springs and a medium take in the turn, after a turn of the wheels.

        Each has the torques of the wheels and the moment about the vertical [N m].
        """
        model = self.model
        data = mujoco.MjData(model)
        root = model.body_jntadr[self.foreign.wheeled.root]
        is_free = model.jnt_type[root] == mujoco.mjtJoint.mjJNT_FREE
        yaw = model.jnt_dofadr[root] + 5 * is_free
        data.qvel[yaw] = yaw_rate * is_free
        data.qvel[self.dofs] = self.rate
        data.qpos[model.jnt_qposadr[self.joints]] += 2.0 * np.pi
        mujoco.mj_forward(model, data)
        moments = {}
        for name in ("damper", "spring", "fluid"):
            forces = np.abs(getattr(data, f"qfrc_{name}"))
            moments[name] = forces[self.dofs], float(forces[yaw] * is_free)
        return moments

    def lost_rate(self, torque: FloatArray) -> FloatArray:
        """Return the share of its rate that a torque takes from each wheel; 1 where it stops."""
        gain = self.of_wheels("gain")
        spare = np.nan_to_num(self.of_wheels("effort"), nan=np.inf) - self.need
        # whether it matters where nobody knows the motor is a question at most
        unknown = np.minimum(torque / self.need, 0.9 * _SPOILT)
        slowed = np.where(np.isnan(gain), unknown, torque / (gain * self.rate))
        return np.where((torque > spare) & (spare >= 0.0), 1.0, slowed)

    def lost_load(self) -> float:
        """Return the load of a wheel from which gravity is taken away [N]."""
        falls = self.model.opt.gravity[2] < 0.0
        falls &= not self.model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
        bodies = self.foreign.wheeled.group(self.foreign.wheeled.root)
        pulled = np.average(
            1.0 - self.model.body_gravcomp[bodies], weights=self.model.body_mass[bodies]
        )
        return self.load * (1.0 - float(pulled * falls))

    def unevenness(self) -> float:
        """Return how far an axle is from the plane of the three others, over what gives way [1].

        Suspensions give way to any.
        """
        sinking = np.nanmax(self.load / self.of_wheels("kp"), initial=_EQUAL * self.radius)
        return 0.0 if self.has_suspension() else _NOTICED * self.gap / float(sinking)

    def unbalance(self) -> FloatArray:
        """Return the greatest moment of each wheel's weight about its axle [N m]."""
        wheeled = self.foreign.wheeled
        data = wheeled.data
        aways = []
        for joint, body in zip(wheeled.joints, wheeled.bodies, strict=True):
            away = data.subtree_com[body] - data.xanchor[joint]
            aways.append(float(np.linalg.norm(np.cross(away, data.xaxis[joint]))))
        return GRAVITY * self.model.body_mass[wheeled.bodies] * aways

    def toe(self) -> FloatArray:
        """Return the sine of the angle of each axle to their common direction."""
        axes = self.foreign.wheeled.data.xaxis[self.joints] * self.foreign.wheeled.signs[:, None]
        common = axes.mean(axis=0)
        return np.linalg.norm(np.cross(axes, common / np.linalg.norm(common)), axis=1)

    def backward_wheels(self, by_gear: bool) -> FloatArray:
        """Return 1 for wheels that equal inputs turn against the others, by gears or by axes."""
        gears = np.nan_to_num(self.of_wheels("gear"), nan=1.0)
        ways = gears * self.foreign.wheeled.signs
        most = 1.0 if ways.sum() >= 0.0 else -1.0
        return np.where(ways * most < 0.0, float((np.ptp(gears) > 0.0) == by_gear), 0.0)

    def ties_across(self) -> FloatArray:
        """Return 1 for wheels that an equality ties to one of the other side, or to the world."""
        model = self.model
        of_robot = np.append(model.body_rootid, 0) == self.foreign.wheeled.root
        tied = np.zeros(4)
        for k in np.flatnonzero(model.eq_active0).tolist():
            ends = [int(model.eq_obj1id[k]), int(model.eq_obj2id[k])]
            is_end = np.isin(self.joints, ends)
            if model.eq_type[k] == mujoco.mjtEq.mjEQ_JOINT:
                # an angle that follows none is held
                is_held = not model.eq_data[k, 1:5].any()
                ratio = self.foreign.wheeled.signs[is_end].prod() * model.eq_data[k, 1]
                is_other = np.ptp(LEFT[is_end]) > 0.0 or abs(ratio - 1.0) > _EQUAL
                tied[is_end] = is_other if is_end.sum() == 2 else is_held
            elif model.eq_objtype[k] == mujoco.mjtObj.mjOBJ_BODY:
                tied[:] = max(tied[0], float(of_robot[ends].sum() == 1))
        return tied

    def unsolved(self) -> FloatArray | float:
        """Return what the solver's sweeps leave open of the ground's torques on the wheels [N m].

        They turn against each other, pressed a little into the ground.
        """
        model = mujoco.MjModel.__copy__(self.model)
        data = mujoco.MjData(model)
        root = model.body_jntadr[self.foreign.wheeled.root]
        gaps = self.of_wheels("gap")
        if model.jnt_type[root] != mujoco.mjtJoint.mjJNT_FREE or np.isnan(gaps).any():
            return 0.0
        data.qpos[model.jnt_qposadr[root] + 2] -= gaps.max() + _EQUAL * self.radius
        data.qvel[self.dofs] = self.rate * self.foreign.wheeled.signs * LEFT
        torques = []
        for solver, most in ((model.opt.solver, 1), (mujoco.mjtSolver.mjSOL_NEWTON, 100)):
            model.opt.solver = solver
            model.opt.iterations = max(model.opt.iterations, most)
            data.qacc_warmstart[:] = 0.0
            mujoco.mj_forward(model, data)
            torques.append(data.qfrc_constraint[self.dofs])
        return abs(np.subtract(*torques))

    def has_suspension(self) -> bool:
        """Return whether something between base and wheels gives way."""
        wheeled = self.foreign.wheeled
        moving = [b for b in range(1, self.model.nbody) if self.model.body_jntnum[b] > 0]
        for body in set(moving).difference(wheeled.bodies):
            carried = [wheeled.is_below(wheel, body) for wheel in wheeled.bodies]
            if any(carried) and not all(carried):
                return True
        return False

    def _strange_joints(self) -> list[str]:
        """Return the joints that a controller drives and that are not in the file."""
        known = {self.model.joint(j).name for j in range(self.model.njnt)}
        return sorted(self.foreign.sides.keys() - known)

    def sides_of_controller(self) -> FloatArray:
        """Return 1 and -1 for wheels that a controller takes for left and right, 0 for none."""
        sides = self.foreign.sides
        return np.array([sides.get(name, 0.0) for name in self.names])

    def motor_names(self) -> list[str]:
        """Return the names of the wheels' motors; empty for none."""
        model = self.model
        names = [""] * 4
        for a in np.flatnonzero(model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT).tolist():
            joint = int(model.actuator_trnid[a, 0])
            if joint in self.joints:
                names[self.joints.index(joint)] = model.actuator(a).name
        return names


def _misleading(names: Sequence[str]) -> FloatArray:
    """Return 1 for names that say another side or end than that of their wheel, else 0."""
    sides = np.array([named_side(name) for name in names])
    ends = np.array([named_end(name) for name in names])
    return np.where((sides * LEFT < 0.0) | (ends * FRONT < 0.0), 1.0, 0.0)


class _Influence(NamedTuple):
    """An attribute that stops, slows or turns a robot."""

    kind: str
    """Kind of the finding."""
    written: str
    """How a URDF and an SDF write it."""
    mjcf: str
    """How an MJCF writes it."""
    effect: str | Callable[[_Stand], FloatArray | float]
    """What it does to each wheel, in the unit of the sentence: a number of the wheels by its key,
    or a function of the robot."""
    sentence: str
    """What it does; `{effect}` is the greatest, and `{wheels}` those of which it is said."""
    over: str = "one"
    """Number of `_Stand` that the effect is a share of; `rate` for a torque that slows wheels."""
    under: str = ""
    """Number of `_Stand` under which the effect takes the whole turn."""
    is_fault: bool = True
    """Whether it can be a fault; else it deserves a look at most."""


_NEED = "; a turn on the spot needs {need:.3g} N m a wheel"
_MOMENT = "{effect:.3g} N m in a turn on the spot, and friction gives {moment:.3g} N m at most"
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
        "<equality>",
        _Stand.ties_across,
        "an {written} ties {wheels} to the other side, to other rates or to the world: they cannot "
        "turn as told",
    ),
    _Influence(
        "load",
        "<gravity> of links",
        "gravcomp or gravity of <option>",
        _Stand.lost_load,
        "{written} takes away {effect:.3g} of the {load:.3g} N that press a tyre to the ground",
        over="load",
    ),
    _Influence(
        "held",
        "",
        "damping of the base's free joint",
        lambda stand: stand.passive["damper"][1],
        "{written} holds it with " + _MOMENT,
        over="moment",
    ),
    _Influence(
        "held",
        "",
        "density and viscosity of <option>",
        lambda stand: stand.passive["fluid"][1],
        "{written} are those of a liquid, which holds it with " + _MOMENT,
        over="moment",
        is_fault=False,
    ),
    _Influence(
        "load",
        "",
        "contype, conaffinity, <exclude> or <flag contact>",
        "misses",
        "{written} keep ground and tyres of {wheels} apart: these carry nothing",
    ),
    _Influence(
        "which_friction",
        "mu1 and mu2",
        "friction or condim",
        "mu1",
        "{written} give tyres and ground of {wheels} a friction of {effect:.3g}: they spin",
        under="slippery",
    ),
    _Influence(
        "unlike_wheels",
        "mu1 and mu2",
        "friction",
        lambda stand: _lack_of(stand.mu),
        "wheels differ in their friction: {written} of {wheels} is less by up to {effect:.2g} of "
        "that of the others, and it turns about those that hold",
    ),
    _Influence(
        "friction_by_heading",
        "mu1 and mu2",
        "a contact pair's frictions along two directions",
        lambda stand: abs(stand.of_wheels("mu1") - stand.of_wheels("mu2")),
        "friction depends on the heading, for {written} differ by {effect:.2g}: the robot turns "
        "unevenly and drifts; give both one number (docs/why_drift.md)",
        over="spread",
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
    ),
    _Influence(
        "unlike_wheels",
        "radii of the wheels",
        "radii of the wheels",
        lambda stand: _lack_of(stand.radii),
        "wheels differ in their radius, {radii} m: the robot veers, and stands on some of them; "
        "give all four one radius",
        over="spread",
    ),
    _Influence(
        "which_friction",
        "",
        "condim and torsional friction",
        lambda stand: stand.weight * stand.of_wheels("torsion"),
        "{written} of tyres and ground hold it with " + _MOMENT + " by sliding",
        over="moment",
    ),
    _Influence(
        "which_friction",
        "",
        "condim 6 and rolling friction",
        lambda stand: stand.load * stand.of_wheels("rolling"),
        "{written} of tyres and ground brake {wheels} with {effect:.3g} N m" + _NEED,
        over="rate",
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
        "unlike_wheels",
        "heights of the axles",
        "heights of the axles",
        _Stand.unevenness,
        "{written} differ: one is {gap:.2g} m above or below the plane of the three others, so "
        "that it stands on three wheels",
    ),
    _Influence(
        "solver",
        "",
        "solver and iterations of <option>",
        _Stand.unsolved,
        "{written} leave open {effect:.3g} N m of the ground's torque on {wheels}: too few sweeps; "
        "take Newton, or more iterations" + _NEED,
        over="need",
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
        "axes",
        "axes of the wheels",
        "axes of the wheels",
        lambda stand: stand.backward_wheels(by_gear=False),
        "{written} have opposite signs: {wheels} turn backward when all are told to turn ahead, so "
        "that a controller of a differential drive turns the robot when it is told to drive; give "
        "them the axis of the others",
    ),
    _Influence(
        "axes",
        "axes of the wheels",
        "axes of the wheels",
        _Stand.toe,
        "{written} are not parallel: {wheels} stand at {effect:.2g} rad to the others, and scrub",
        over="slip",
        is_fault=False,
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
        "held",
        "<dynamics damping>",
        "damping of the joints",
        lambda stand: stand.passive["damper"][0],
        "{written} takes {effect:.3g} N m of {wheels} at {rate:.2g} rad/s" + _NEED,
        over="rate",
    ),
    _Influence(
        "held",
        "<dynamics friction>",
        "frictionloss of the joints",
        lambda stand: stand.model.dof_frictionloss[stand.dofs],
        "{written} takes {effect:.3g} N m of {wheels}" + _NEED,
        over="rate",
    ),
    _Influence(
        "held",
        "<spring_stiffness>",
        "stiffness of the joints",
        lambda stand: stand.passive["spring"][0],
        "{written}: a spring turns {wheels} back, after a turn with {effect:.3g} N m" + _NEED,
        over="rate",
    ),
    _Influence(
        "mass_in_wheels",
        "<inertial> of the wheels",
        "places of the wheels' masses",
        _Stand.unbalance,
        "{written}: the centre of mass of {wheels} lies beside the axle, which its weight turns "
        "with up to {effect:.2g} N m" + _NEED,
        over="need",
        is_fault=False,
    ),
    _Influence(
        "motor_weak",
        "<limit effort> or the plugin's <torque>",
        "forcerange, ctrlrange or <flag actuation>",
        "effort",
        "{written} lets the motors of {wheels} give {effect:.3g} N m" + _NEED,
        under="need",
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
        "effort",
        "<limit velocity>",
        "ctrlrange",
        "velocity",
        "{written} lets {wheels} turn at {effect:.3g} rad/s either way, and both ways are needed",
        under="slow",
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
        lambda stand: _lack_of(stand.of_wheels("gain")),
        "{written} of {wheels} is less by up to {effect:.2g} of that of the others",
        is_fault=False,
    ),
    _Influence(
        "names",
        "",
        "names of motors",
        lambda stand: _misleading(stand.motor_names()),
        "{written} say another side or end than that of {wheels}, which they drive: it turns the "
        "wrong way",
    ),
    _Influence(
        "names",
        "names of wheels",
        "names of wheels",
        lambda stand: _misleading(stand.names),
        "{written} say other places than they have: {wheels} stand on another side or end (x is "
        "ahead, y to the left), so that a controller that goes by the names turns the wrong way",
    ),
    _Influence(
        "controller",
        "joints of the drive plugin",
        "",
        # names that mislead are said as such
        lambda stand: stand.sides_of_controller() * LEFT + _misleading(stand.names) < 0.0,
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


def _lack_of(values: FloatArray) -> FloatArray:
    """Return by how much each value is less than the greatest, over that one."""
    most = np.nanmax(values, initial=0.0)
    return np.asarray((most - values) / max(most, _SLIPPERY))


def weigh_influences(robot: Robot, foreign: ForeignRobot) -> list[tuple[str, bool, str]]:
    """Return kind, whether it is a fault, and sentence of whatever takes a share of a turn.

    Nothing is weighed of a robot that does not stand on its four wheels.
    """
    turn = spot_turn(robot)
    if turn is None:
        return []
    stand = _Stand(robot, foreign, turn)
    names = np.array(stand.names)
    found = []
    for line in _INFLUENCES:
        told = line.effect
        effect = stand.of_wheels(told) if isinstance(told, str) else told(stand)
        effect = np.broadcast_to(np.asarray(effect, dtype=np.float64), 4)
        if line.under:
            share = np.where(effect < getattr(stand, line.under), 1.0, 0.0)
        elif line.over == "rate":
            share = stand.lost_rate(effect)
        else:
            share = effect / getattr(stand, line.over)
        share = np.nan_to_num(share, nan=0.0)
        said = share > _NOTICED
        if not said.any():
            continue
        worst = int(np.argmax(share))
        words = {
            "written": line.mjcf if foreign.kind == "mjcf" else line.written,
            "effect": float(effect[worst]),
            "wheels": "all four wheels" if said.all() else ", ".join(names[said]),
        }
        is_fault = line.is_fault and float(share[worst]) >= _SPOILT
        found.append((line.kind, is_fault, line.sentence.format(**vars(stand) | words)))
    return found
