"""A robot of others in a slow turn on the spot, by its file alone: what it needs and has."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from ssmr.robot.ground import FRONT, LEFT, SkidTurn
from ssmr.types import FloatArray
from validation.descriptions.foreign_robot import ForeignRobot
from validation.descriptions.wheels import motor_moments, named_end, named_side
from validation.output import one_line
from validation.simulator.checking import turning_torque
from validation.simulator.description import GRAVITY, Robot

_FROUDE = 0.25
"""Speed of the rims in the turn that everything is weighed against, over sqrt(g r) [1]."""
NOTICED = 0.03
"""Share of the turn that raises a question [1]: a balance of torques and loads closes to this."""
SPOILT = 0.25
"""Share of the turn from which it is a fault [1]."""
_SLIPPERY = 0.01
"""Friction of tyres that hold nothing [1]: wet ice has several times that."""
_EQUAL = 0.004
"""Deviation of two frictions or radii that are one, and height by which one of four stiff tyres
misses level ground over their radius [1]."""


class SlowTurn:
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
        self.radii = np.array(
            [np.nan if drum is None else drum.radius for drum in foreign.wheeled.drums]
        )
        self.slip = turn.slip
        self.weight = robot.mass * GRAVITY
        self.load = 0.25 * self.weight
        self.rim = _FROUDE * math.sqrt(GRAVITY * self.radius)
        self.rate = self.rim / self.radius
        self.slow = 0.1 * self.rate
        self.mu = np.nan_to_num(self.of_wheels("mu1"), nan=robot.friction)
        self.push = self.weight * robot.friction
        self.need = 0.5 * robot.friction * turning_torque(robot, turn)
        self.grip = np.maximum(self.mu, _SLIPPERY) * self.load * self.radius
        self.one = 1.0
        # a line is noticed by what drives show, if at all
        self.drives = 1e9
        self.slippery = _SLIPPERY
        self.few_turns = 4.0 * np.pi
        # a wheel that differs by more is a fault
        self.spread = _EQUAL / SPOILT
        self.names = foreign.wheeled.names
        self.heights = foreign.wheeled.data.xanchor[self.joints, 2]
        self.gap = abs(float(self.heights @ (FRONT * LEFT)))
        self.strange = one_line(", ".join(self._strange_joints()))
        ground = foreign.wheeled.find_ground(self.joints[0])
        # the third axis of a plane is its normal; other grounds are taken for level
        is_plane = self.model.geom_type[ground or 0] == mujoco.mjtGeom.mjGEOM_PLANE
        self.ground = foreign.wheeled.data.geom_xmat[ground or 0][2::3] * is_plane
        self.armature = float(self.model.dof_armature[self.dofs].max())
        self.softest = float(np.nanmin(self.of_wheels("gain"), initial=np.inf))
        flaws = [drum.flaw if drum is not None else "" for drum in foreign.wheeled.drums]
        self.shapes = ", ".join(sorted(set(flaws) - {""}))
        # the hull of a mesh may be as good as round
        self.uneven = [0.9 * SPOILT if "mesh" in flaw else float(flaw != "") for flaw in flaws]

    def of_wheels(self, key: str) -> FloatArray:
        """Return a number of the wheels' surfaces, joints or motors."""
        numbers = zip(self.foreign.contacts, self.foreign.limits, strict=True)
        return np.array([(one | other).get(key, np.nan) for one, other in numbers])

    def drag(self) -> float:
        """Return what a medium takes of the base, drawn along x at the balance's speed [N]."""
        data = mujoco.MjData(self.model)
        along = self.model.body_dofadr[self.foreign.wheeled.root]
        data.qvel[along] = 2.0 * self.rim
        mujoco.mj_forward(self.model, data)
        return abs(float(data.qfrc_fluid[along]))

    def lost_rate(self, torque: FloatArray) -> FloatArray:
        """Return the share of its rate that a torque takes from each wheel; 1 where it stops."""
        gain = self.of_wheels("gain")
        spare = np.nan_to_num(self.of_wheels("effort"), nan=np.inf) - self.need
        # whether it matters where nobody knows the motor is a question at most
        unknown = np.minimum(torque / self.need, 0.9 * SPOILT)
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
        """Return how far an axle is from the plane of the three others, over what gives way [1]."""
        sinking = np.nanmax(self.load / self.of_wheels("kp"), initial=_EQUAL * self.radius)
        return NOTICED * self.gap / float(sinking)

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
        moments = np.abs(motor_moments(self.model, self.joints))
        return [
            one_line(self.model.actuator(int(of_wheel.argmax())).name) if of_wheel.any() else ""
            for of_wheel in moments.T
        ]

    @staticmethod
    def misleading_names(names: Sequence[str]) -> FloatArray:
        """Return 1 for names that say another side or end than that of their wheel, else 0."""
        sides = np.array([named_side(name) for name in names])
        ends = np.array([named_end(name) for name in names])
        return np.where((sides * LEFT < 0.0) | (ends * FRONT < 0.0), 1.0, 0.0)

    @staticmethod
    def sine_to_vertical(direction: FloatArray) -> float:
        """Return the sine of a vector's angle to the vertical; 0 for none."""
        length = float(np.linalg.norm(direction))
        return math.hypot(*direction[:2]) / max(length, 1e-9)

    @staticmethod
    def lack_of(values: FloatArray) -> FloatArray:
        """Return by how much each value is less than the greatest, over that one."""
        most = np.nanmax(values, initial=0.0)
        return np.asarray((most - values) / max(most, _SLIPPERY))
