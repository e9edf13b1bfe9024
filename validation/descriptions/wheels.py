"""The four wheels of a foreign robot, found in its model by their joints, and what they carry."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from mujoco import mjtGeom, mjtJoint

from ssmr.robot.ground import FRONT, LEFT
from ssmr.types import FloatArray
from validation.descriptions.gazebo import NumbersByName
from validation.output import one_line

_LEVEL = 0.17
"""Greatest share of z in the axis of a wheel [1]: ten degrees."""
_PARALLEL = 0.985
"""Least share of an axis along another one that is parallel to it [1]: ten degrees."""
_UPRIGHT = 0.9
"""Least share of z in the axis of a joint that steers [1]."""
_FEW_TURNS = 4.0 * np.pi
"""Range of a joint beyond which its limits are none [rad]."""
_ASKEW = 0.05
"""Greatest distance of a wheel from the corner of a rectangle, over its shorter side [1]."""
_HARD = 0.05
"""Difference of two impedances or time constants that are not one, over the greater [1]."""
_REACH = 0.25
"""Greatest height of a wheel's lowest point above that of the lowest wheel, over its radius [1]."""
_WHEEL_WORDS = re.compile(r"wheel|tire|tyre|rueda|roue|rad(?![a-z])", re.IGNORECASE)

UNLIKE = 0.004
"""Deviation of a wheel's radius from the others' from which wheels are unlike [1]."""
_OFF_AXLE = 0.01
"""Distance of a tyre's middle from its axle over its radius, from which it is off [1]."""
_FLAWS = {
    "box": "a box",
    "mesh": "a mesh, of which MuJoCo takes the hull with its corners",
    "lying": "a cylinder or capsule across the axle",
    "oval": "not round",
}
"""Shapes by kind that roll unevenly."""
_ROUND = (mjtGeom.mjGEOM_CYLINDER, mjtGeom.mjGEOM_ELLIPSOID)
"""Shapes of wheels; spheres are those of casters."""


class Drum(NamedTuple):
    """The shape with which a wheel touches the ground."""

    geom: int
    """Its number in the model."""
    kind: str
    """Type, as MuJoCo calls it: `cylinder`, `ellipsoid`, `capsule`, `sphere`, `box`, `mesh`."""
    radius: float
    """Greatest distance from the axle [m]."""
    half_width: float
    """Half its extent along the axle [m]."""
    off_axle: float
    """Distance of its middle from the axle [m]."""

    @property
    def is_off_axle(self) -> bool:
        """Whether its middle lies beside the axle."""
        return self.off_axle > _OFF_AXLE * self.radius

    @property
    def flaw(self) -> str:
        """The reason why it rolls unevenly; it is empty for a round tyre about its axle."""
        if self.is_off_axle:
            return f"{1e3 * self.off_axle:.1f} mm off the axle"
        return _FLAWS.get(self.kind, "")

    @property
    def contact_half_width(self) -> float:
        """Half the distance of the points in which it touches level ground [m]."""
        touches_in_a_line = self.kind in ("cylinder", "capsule", "lying", "mesh")
        return self.half_width if touches_in_a_line else 0.0


class WheeledRobot:
    """A compiled robot of others with all joints at zero, and its four wheels.

    Wheels are in the order of `WHEELS`. The frame is x forward, y left, z up, midway between the
    axles, at the height of `base_link` or of the axles.
    """

    def __init__(self, model: mujoco.MjModel, any_direction: bool = False) -> None:
        """Find the wheels.

        Args:
            model: the robot, and ground if any.
            any_direction: whether it may drive along any direction; else along x.

        Raises:
            ValueError: there are not four, they do not stand at the corners of a rectangle, or one
                can be steered.
        """
        self.model = model
        self.data = mujoco.MjData(model)
        mujoco.mj_forward(model, self.data)
        four = self._four(any_direction)
        roots = model.body_rootid[model.jnt_bodyid[four]]
        self.root = int(roots[0])
        if np.ptp(roots) > 0:
            raise ValueError(
                "its wheels hang on the world and its base is part of it, as in a URDF that "
                "MuJoCo saved: put base and wheels into a body with a <freejoint/>, or import the "
                "URDF"
            )
        self.turn = self._turned(four)
        self._stand(four)
        self.drums = [self.drum(joint) for joint in self.joints]
        """Shapes with which the wheels touch the ground; None for a wheel without one."""

    @property
    def bodies(self) -> list[int]:
        """The wheels' bodies."""
        return [int(self.model.jnt_bodyid[joint]) for joint in self.joints]

    @property
    def names(self) -> list[str]:
        """The wheels' names: those of their joints, or of their bodies where these have none."""
        return [self._name(joint) for joint in self.joints]

    def _name(self, joint: int) -> str:
        own = self.model.joint(joint).name
        return one_line(own or self.model.body(int(self.model.jnt_bodyid[joint])).name)

    def _names(self, joints: Iterable[int]) -> str:
        """Return the names of joints for a message, at most eight."""
        names = [self._name(joint) for joint in joints]
        if len(names) > 8:
            names[8:] = ["…"]
        return ", ".join(names) or "none"

    def is_below(self, body: int, above: int) -> bool:
        """Return whether a body hangs on another one, or is that one."""
        while body > 0 and body != above:
            body = int(self.model.body_parentid[body])
        return body == above

    def group(self, body: int) -> list[int]:
        """Return a body and all that hang on it."""
        return [b for b in range(1, self.model.nbody) if self.is_below(b, body)]

    @property
    def base(self) -> list[int]:
        """The bodies of the robot that are no part of a wheel."""
        wheels = set[int]()
        for body in self.bodies:
            wheels |= set(self.group(body))
        return [body for body in self.group(self.root) if body not in wheels]

    # ------------------------------------------------------------------------- finding
    def _spinning(self) -> list[int]:
        """Return the hinge joints across a level axis that turn without an end.

        They are on the heaviest tree of bodies that has any: others are no part of the robot.
        """
        model = self.model
        masses = model.body_subtreemass[model.body_rootid[model.jnt_bodyid]]
        is_hinge = model.jnt_type == mjtJoint.mjJNT_HINGE
        is_endless = (model.jnt_limited == 0) | (np.ptp(model.jnt_range, axis=1) > _FEW_TURNS)
        is_level = np.abs(self.data.xaxis[:, 2]) < _LEVEL
        found = is_hinge & is_endless & is_level
        found &= masses == masses[found].max(initial=0.0)
        spinning: list[int] = np.flatnonzero(found).tolist()
        return spinning

    def _four(self, any_direction: bool) -> list[int]:
        """Return the joints of the four wheels; a ValueError says why they are none of a robot."""
        axes = np.abs(self.data.xaxis)
        spinning = self._spinning()
        self._require_no_rollers(spinning)
        along_y = [j for j in spinning if axes[j, 1] > _PARALLEL]
        crosswise = [j for j in spinning if axes[j, 0] > _PARALLEL]
        if not any_direction and len(along_y) != 4:
            if len(crosswise) == 4:
                raise ValueError(
                    f"joints {self._names(crosswise)} turn about the x axis, which is meant where "
                    "none is said, and a robot drives along x: give them the axis 0 1 0, or turn "
                    "the robot by 90 degrees"
                )
        four = spinning if any_direction else along_y
        if len(four) > 4:
            four = self._touching(four)
        if not (self.model.jnt_type == mjtJoint.mjJNT_HINGE).any():
            raise ValueError(
                "none of its joints turns, so it is a statue: make the joints of its four wheels "
                f"continuous{self._others(four)}"
            )
        if len(four) != 4:
            raise ValueError(
                f"it has {len(four)} joints that look like wheels, and a skid-steering robot has "
                f"four, continuous and about the y axis: {self._names(four)}{self._others(four)}"
            )
        for j in four:
            self._require_fixed(j)
        return four

    def _require_no_rollers(self, spinning: Sequence[int]) -> None:
        """Raise a ValueError where joints that spin hang on others that spin."""
        bodies = {int(self.model.jnt_bodyid[j]): j for j in spinning}
        hanging = set[int]()
        for body in bodies:
            hanging.update(self.group(body)[1:])
        rollers = [joint for body, joint in bodies.items() if body in hanging]
        if len(rollers) >= 4:
            raise ValueError(
                f"its wheels carry rollers ({self._names(rollers)}): mecanum or omni wheels, which "
                "roll sideways; a skid-steering robot has plain ones"
            )

    def _touching(self, joints: Sequence[int]) -> list[int]:
        """Return the joints whose wheels come about as low as the lowest; all without shapes.

        A wheel without a shape is as large as the lowest one.
        """
        heights = self.data.xanchor[list(joints), 2]
        drums = [self.drum(joint) for joint in joints]
        radii = np.array([np.nan if drum is None else drum.radius for drum in drums])
        if np.isnan(radii).all():
            return list(joints)
        lowest = np.nanargmin(heights - radii)
        most = heights[lowest] - radii[lowest] + _REACH * radii[lowest]
        bottoms = heights - np.where(np.isnan(radii), radii[lowest], radii)
        return [joint for joint, bottom in zip(joints, bottoms, strict=True) if bottom < most]

    def _require_fixed(self, joint: int) -> None:
        """Raise a ValueError where a wheel can be steered by a joint above it."""
        model = self.model
        wheel = int(model.jnt_bodyid[joint])
        root = int(model.body_rootid[wheel])
        for up in np.flatnonzero(model.jnt_type == mjtJoint.mjJNT_HINGE).tolist():
            body = int(model.jnt_bodyid[up])
            is_above = body != root and self.is_below(wheel, body)
            if is_above and abs(self.data.xaxis[up, 2]) > _UPRIGHT:
                raise ValueError(
                    f"wheel '{self._name(joint)}' can be steered by joint "
                    f"'{self._name(up)}'; the wheels of a skid-steering robot cannot"
                )

    def _others(self, wheels: Sequence[int]) -> str:
        """Return why other parts that are called wheels, or are round, are none; empty without."""
        model = self.model
        is_round = np.isin(model.geom_type, _ROUND)
        by_reason = dict[str, list[str]]()
        taken = model.jnt_bodyid[list(wheels)]
        for body in set(range(1, model.nbody)).difference(taken.tolist()):
            joint = int(model.body_jntadr[body])
            shown = one_line(model.body(body).name)
            names = shown
            reason = "fixed: make their joints continuous"
            if joint >= 0:
                names += f" {model.joint(joint).name}"
                shown = self._name(joint)
                reason = self._reason(joint)
            has_round = is_round[model.geom_bodyid == body].any()
            is_leaf = body not in model.body_parentid
            if _WHEEL_WORDS.search(names) or (has_round and is_leaf):
                by_reason.setdefault(reason, []).append(shown)
        text = ""
        for reason, shown_names in by_reason.items():
            text += f"; {', '.join(shown_names[:8])}: {reason}"
        return text

    def _reason(self, joint: int) -> str:
        model = self.model
        if model.jnt_limited[joint] and np.ptp(model.jnt_range[joint]) <= _FEW_TURNS:
            low, high = model.jnt_range[joint]
            return f"revolute, from {low:.3g} to {high:.3g} rad: make them continuous"
        x, y, z = (float(part) for part in self.data.xaxis[joint])
        return f"about the axis {x:.2g} {y:.2g} {z:.2g}: make it y"

    # ------------------------------------------------------------------------- placing
    def _turned(self, four: Sequence[int]) -> FloatArray:
        """Return the (3, 3) rotation from the world's axes to the robot's."""
        axes = self.data.xaxis[list(four)]
        across = axes[0] * [1.0, 1.0, 0.0]
        if (np.abs(axes @ across) < _PARALLEL * np.hypot(*across[:2])).any():
            raise ValueError(
                f"the axes of its wheels {self._names(four)} are not parallel, as those of a "
                "skid-steering robot"
            )
        across /= np.hypot(*across[:2])
        # left is where the body's own y points, whatever its heading at the start
        left = float(self.data.xmat[self.root].reshape(3, 3)[:, 1] @ across)
        if abs(left) > _PARALLEL:
            across *= np.sign(left)
        else:
            across *= self._left_sign(four, across)
        ahead = np.cross(across, [0.0, 0.0, 1.0])
        return np.array([ahead, across, [0.0, 0.0, 1.0]])

    def _left_sign(self, four: Sequence[int], across: FloatArray) -> float:
        """Return the sign by which an axis points to the left: by names, else as most joints."""
        side = 0.0
        for joint in four:
            place = float(across @ self.data.xanchor[joint])
            side += np.sign(place) * named_side(self._name(joint))
        if side == 0.0:
            side = float(np.sum(self.data.xaxis[list(four)] @ across))
        return 1.0 if side >= 0.0 else -1.0

    def _stand(self, four: Sequence[int]) -> None:
        """Order the wheels, and compute wheelbase, track and the frame's origin."""
        places = self.data.xanchor[list(four)] @ self.turn.T
        middle = places.mean(axis=0)
        ahead, aside, _ = (places - middle).T
        order = np.lexsort((-aside, ahead < 0.0)).tolist()
        self.wheelbase = 2.0 * float(np.abs(ahead).mean())
        self.track = 2.0 * float(np.abs(aside).mean())
        corners = 0.5 * np.array([self.wheelbase * FRONT, self.track * LEFT])
        askew = float(np.abs([ahead[order], aside[order]] - corners).max())
        if askew > _ASKEW * min(self.wheelbase, self.track):
            raise ValueError(
                "the four wheels do not stand at the corners of a rectangle: of "
                f"{self._names(four)} one is {1e3 * askew:.0f} mm away from that of "
                f"{self.wheelbase:.3f} by {self.track:.3f} m"
            )
        self.joints = [four[k] for k in order]
        named = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, "base_link")
        level = float(self.data.xpos[named, 2]) if named >= 0 else float(middle[2])
        self.axle_height = float(middle[2]) - level
        self.origin = np.array([middle[0], middle[1], level])

    @property
    def signs(self) -> FloatArray:
        """(4,) 1 where a joint turns about +y, -1 about -y."""
        return np.sign(self.data.xaxis[self.joints] @ self.turn[1])

    # ------------------------------------------------------------------------- ground
    def find_ground(self, joint: int) -> int | None:
        """Return the number of the fixed shape under a wheel, first of all one that it can touch.

        None where there is none.
        """
        model = self.model
        drum = self.drum(joint)
        place = self.data.xanchor[joint].copy()
        hit = np.zeros(1, dtype=np.int32)
        # fixed shapes alone: a tyre may end where the ground begins
        seen = mujoco.MjModel.__copy__(model)
        seen.geom_group[:] = model.body_weldid[model.geom_bodyid] != 0
        straight_down = (
            np.array([0.0, 0.0, -1.0]),
            np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8),
            1,
            -1,
        )
        found = []
        for _ in range(model.ngeom):
            away = mujoco.mj_ray(seen, self.data, place, *straight_down, hit)
            geom = int(hit[0])
            if geom < 0:
                break
            place[2] -= away + 1e-6
            if drum is not None and self.can_touch(drum.geom, geom):
                return geom
            found.append(geom)
        return found[0] if found else None

    def can_touch(self, one: int, other: int) -> bool:
        """Return whether two shapes of a model may touch: a pair, or masks and no exclusion."""
        model = self.model
        if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT:
            return False
        geoms = {one, other}
        pairs = zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)
        if any(geoms == {*pair} for pair in pairs):
            return True
        low, high = sorted(model.geom_bodyid[[one, other]].tolist())
        if (low << 16) + high in model.exclude_signature:
            return False
        masks = model.geom_contype[[one, other]] & model.geom_conaffinity[[other, one]]
        return bool(masks.any())

    # ------------------------------------------------------------------------- measuring
    def lump(self, bodies: Sequence[int]) -> tuple[float, FloatArray, FloatArray]:
        """Return mass [kg], centre [m] and (3, 3) inertia [kg m2] of bodies together.

        All are in the robot's frame; the inertia is about the centre.
        """
        masses = self.model.body_mass[bodies]
        total = float(masses.sum())
        places = self.data.xipos[bodies] @ self.turn.T - self.origin
        centre = masses @ places / total
        tensor = np.zeros((3, 3))
        for body, mass, place in zip(bodies, masses, places, strict=True):
            turn = self.turn @ self.data.ximat[body].reshape(3, 3)
            away = place - centre
            tensor += turn @ np.diag(self.model.body_inertia[body]) @ turn.T
            tensor += mass * (away @ away * np.eye(3) - np.outer(away, away))
        return total, centre, tensor

    def drum(self, joint: int) -> Drum | None:
        """Return the shape of a wheel that reaches farthest from its axle; None without any."""
        model = self.model
        is_on_wheel = np.isin(model.geom_bodyid, self.group(int(model.jnt_bodyid[joint])))
        touches = (model.geom_contype | model.geom_conaffinity) != 0
        touches[np.append(model.pair_geom1, model.pair_geom2)] = True
        touching = is_on_wheel & touches
        # of a wheel that touches nothing, what might
        shapes = np.flatnonzero(touching if touching.any() else is_on_wheel).tolist()
        drums = [self._drum_of(geom, joint) for geom in shapes]
        return max(drums, key=lambda drum: drum.radius, default=None)

    def _drum_of(self, geom: int, joint: int) -> Drum:
        model = self.model
        axis = self.data.xaxis[joint]
        away = self.data.geom_xpos[geom] - self.data.xanchor[joint]
        off = float(np.linalg.norm(away - axis * (away @ axis)))
        turn = self.data.geom_xmat[geom].reshape(3, 3)
        local = np.abs(turn.T @ axis)
        along = int(np.argmax(local))
        size = model.geom_size[geom]
        kind = mjtGeom(model.geom_type[geom])
        name = kind.name.removeprefix("mjGEOM_").lower()
        is_long = kind in (mjtGeom.mjGEOM_CYLINDER, mjtGeom.mjGEOM_CAPSULE)
        if is_long and (along != 2 or local[2] < _PARALLEL):
            name = "lying"
        if is_long:
            along = 2
            size = size[[0, 0, 1]]
        elif kind == mjtGeom.mjGEOM_SPHERE:
            size = size[[0, 0, 0]]
        across = np.delete(size, along)
        radius = float(across.max())
        width = float(size[along])
        if kind == mjtGeom.mjGEOM_MESH:
            points = self._vertices(geom) @ turn.T + away
            beside = points @ axis
            distances = np.linalg.norm(points - np.outer(beside, axis), axis=1)
            radius = float(distances.max())
            width = 0.5 * float(np.ptp(beside))
            off = 0.0
        elif kind == mjtGeom.mjGEOM_ELLIPSOID and np.ptp(across) > 1e-3 * radius:
            name = "oval"
        return Drum(geom, name, radius, width, off)

    def _vertices(self, geom: int) -> FloatArray:
        mesh = int(self.model.geom_dataid[geom])
        first = int(self.model.mesh_vertadr[mesh])
        count = int(self.model.mesh_vertnum[mesh])
        return np.asarray(self.model.mesh_vert[first : first + count], dtype=np.float64)

    def outline(self) -> FloatArray | None:
        """Return the (2, 3) lowest and highest corners of the base's shapes [m]; None without."""
        signs = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
        of_base = np.isin(self.model.geom_bodyid, self.base)
        if not of_base.any():
            return None
        boxes = self.model.geom_aabb.reshape(-1, 2, 1, 3)[of_base]
        turns = self.data.geom_xmat.reshape(-1, 3, 3)[of_base]
        corners = (boxes[:, 0] + signs * boxes[:, 1]) @ turns.transpose(0, 2, 1)
        points = (self.data.geom_xpos[of_base, None] + corners) @ self.turn.T - self.origin
        return np.array([points.min(axis=(0, 1)), points.max(axis=(0, 1))])

    # ------------------------------------------------------------------------- of an MJCF
    def servo_inputs(self) -> FloatArray:
        """Return the (nu, 4) inputs of the servos over the rates of the wheels [s/rad]."""
        model = self.model
        gain = model.actuator_gainprm[:, 0]
        stiffness = model.actuator_biasprm[:, 1]
        damping = model.actuator_biasprm[:, 2]
        integrates = model.actuator_dyntype == mujoco.mjtDyn.mjDYN_INTEGRATOR
        scales = np.zeros(model.nu)
        holds_rate = (gain > 0.0) & ~integrates & (stiffness == 0.0) & (damping < 0.0)
        np.divide(-damping, gain, out=scales, where=holds_rate)
        holds_angle = (gain > 0.0) & integrates & (stiffness < 0.0)
        np.divide(-stiffness, gain, out=scales, where=holds_angle)
        return np.asarray(scales[:, None] * motor_moments(model, self.joints))

    def limits_of_motors(self) -> list[NumbersByName]:
        """Return what the motors of each wheel can do: the least that they give either way.

        See `foreign_robot.ForeignRobot.limits`; a limit that is not given is left out.
        """
        model = self.model
        joints = self.joints
        moments = motor_moments(model, joints)
        inputs = np.abs(self.servo_inputs())
        gain = model.actuator_gainprm[:, 0]
        torques = _least_way(model.actuator_forcelimited, model.actuator_forcerange)
        most_inputs = _least_way(model.actuator_ctrllimited, model.actuator_ctrlrange)
        # without a servo the input is the torque
        is_plain = model.actuator_biastype == mujoco.mjtBias.mjBIAS_NONE
        torques = np.minimum(torques, np.where(is_plain, np.abs(gain) * most_inputs, np.inf))
        if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_ACTUATION:
            torques[:] = 0.0
        of_joints = _least_way(model.jnt_actfrclimited[joints], model.jnt_actfrcrange[joints])
        holds_rate = model.actuator_biasprm[:, 1] == 0.0
        # a servo that adds up how far a wheel lags gives more and more
        grows = ~holds_rate & (model.actuator_dyntype == mujoco.mjtDyn.mjDYN_INTEGRATOR)
        found = []
        for wheel, most in enumerate(of_joints.tolist()):
            acting = np.flatnonzero(moments[:, wheel])
            levers = moments[acting, wheel]
            needs = inputs[acting, wheel]
            numbers = NumbersByName(
                effort=min(most, float(np.abs(levers) @ torques[acting])) if len(acting) else most,
                velocity=float(
                    (most_inputs[acting] / np.maximum(needs, 1e-300)).min(initial=np.inf)
                ),
                gain=np.inf
                if grows[acting].any()
                else float(np.abs((gain * holds_rate)[acting] * levers) @ needs) or np.inf,
                gear=float(np.sign(gain[acting] @ levers)) or np.inf,
            )
            found.append({key: value for key, value in numbers.items() if value < np.inf})
        return found

    def tyre_contact(self, joint: int) -> NumbersByName:
        """Return what MuJoCo says of a tyre on the ground under it, or of the tyre alone.

        See `foreign_robot.ForeignRobot.contacts`. A pair decides, else the shape of the higher
        priority, else the larger number of both.
        """
        model = self.model
        drum = self.drum(joint)
        if drum is None:
            return NumbersByName(misses=1.0)
        ground = self.find_ground(joint)
        sides = [drum.geom] if ground is None else [drum.geom, ground]
        misses = ground is not None and not self.can_touch(drum.geom, ground)
        hit = (model.pair_geom1 == drum.geom) | (model.pair_geom2 == drum.geom)
        pairs = np.flatnonzero(hit)
        mixed = False
        if len(pairs):
            dimension = int(model.pair_dim[pairs[0]])
            mu1, mu2, torsion, rolling, _ = model.pair_friction[pairs[0]].tolist()
            own = mu1
        else:
            priority = model.geom_priority[sides]
            sides = [side for side, p in zip(sides, priority, strict=True) if p == priority.max()]
            dimension = int(model.geom_condim[sides].max())
            mu1, torsion, rolling = model.geom_friction[sides].max(axis=0).tolist()
            mu2 = mu1
            own = float(model.geom_friction[drum.geom, 0])
            softness = np.hstack([model.geom_solimp[sides, :1], model.geom_solref[sides]])
            mixed = bool((np.ptp(softness, axis=0) > _HARD * np.abs(softness).max(axis=0)).any())
        slides = float(dimension > 1)
        return NumbersByName(
            mu1=slides * mu1,
            mu2=slides * mu2,
            own=slides * own,
            torsion=torsion if dimension > 3 else 0.0,
            rolling=rolling if dimension > 4 else 0.0,
            misses=float(misses),
            mixed=float(mixed),
        )


def motor_moments(model: mujoco.MjModel, joints: Sequence[int]) -> FloatArray:
    """Return the (nu, 4) rate of each actuator over the rate of each wheel [1]."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    moments = np.zeros((model.nu, model.nv))
    if model.nu:
        rows = (data.moment_rownnz, data.moment_rowadr, data.moment_colind)
        mujoco.mju_sparse2dense(moments, data.actuator_moment, *rows)
    return moments[:, model.jnt_dofadr[joints]]


def _least_way(is_limited: FloatArray, ranges: FloatArray) -> FloatArray:
    """Return what (n, 2) ranges allow either way; infinite without a limit."""
    least = np.minimum(-ranges[:, 0], ranges[:, 1])
    return np.where(is_limited, np.maximum(least, 0.0), np.inf)


_LEFT_NAMES = re.compile(r"left|(?<![a-z])(l|fl|bl|rl|lf|lb|lr)(?![a-z])", re.IGNORECASE)
_RIGHT_NAMES = re.compile(r"right|(?<![a-z])(r|fr|br|rr|rf|rb)(?![a-z])", re.IGNORECASE)
_FRONT_NAMES = re.compile(r"front|(?<![a-z])(fl|fr|lf|rf)(?![a-z])", re.IGNORECASE)
_REAR_NAMES = re.compile(r"rear|back|(?<![a-z])(bl|br|rl|rr|lb|rb|lr)(?![a-z])", re.IGNORECASE)


def _sign(name: str, plus: re.Pattern[str], minus: re.Pattern[str]) -> int:
    """Return 1 or -1 where a name has one of two words, and 0 where it has none or both."""
    return bool(plus.search(name)) - bool(minus.search(name))


def named_side(name: str) -> int:
    """Return 1 for a name of the left, -1 for one of the right, else 0."""
    return _sign(name, _LEFT_NAMES, _RIGHT_NAMES)


def named_end(name: str) -> int:
    """Return 1 for a name of the front, -1 for one of the rear, else 0."""
    return _sign(name, _FRONT_NAMES, _REAR_NAMES)
