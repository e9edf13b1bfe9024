"""A robot of others, driven with its own physics: its solver, contacts and motors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco import mjtDyn, mjtGeom, mjtObj, mjtSensor, rollout

from ssmr.errors import DivergedError
from ssmr.geometry import quat_wxyz_to_yaw, rotate_world_to_body
from ssmr.types import FloatArray
from validation.descriptions.wheels import WheeledRobot
from validation.simulator import foreign
from validation.simulator.parts import mujoco_failures
from validation.simulator.plant import PRESCRIBED_LAG, PRESCRIBED_SHARE

_SETTLE_TIME = 1.0
"""Time in which the robot comes to rest before it is driven [s]."""
RAMP = 0.4
"""Time in which wheels are brought to their rate [s]: a step would let tyres jump."""
_SAMPLE = 0.01
"""Period of samples [s], about."""
_LEAST_GRAVITY = 1e-3
"""Gravity below which a robot does not stand [m/s2]."""
_LARGE = 3.0
"""Extent of a fixed shape that is ground, over that of the robot's wheels [1]."""
_NET_FORCE = [1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 3, 1]
"""Output of a sensor of contacts: the force, of all contacts together (`netforce`), as one."""
_SITE = "ssmr_middle"
_TURN = 2.0 * math.pi


class Ride(NamedTuple):
    """A motion of the middle between the axles; wheels are in the order of `WHEELS`."""

    t: FloatArray
    """(M,) instants [s]."""
    pose: FloatArray
    """(M, 3) x, y [m] and yaw [rad], unwrapped."""
    twist: FloatArray
    """(M, 3) speed ahead and to the left [m/s], and yaw rate [rad/s]."""
    wheels: FloatArray
    """(M, 4) wheel rates [rad/s], positive ahead."""
    loads: FloatArray
    """(M, 4) normal forces on the wheels [N]."""
    saturated: float
    """Greatest share of the time in which a servo is at the limit of its force [1]."""
    end: FloatArray
    """(n,) state of the simulator at the end."""


class OwnRobot:
    """A compiled robot of others on its ground, and how its wheels are told their rates."""

    @mujoco_failures()
    def __init__(self, text: str, files: Mapping[str, bytes], *, given_rates: bool = False) -> None:
        """Build it.

        Args:
            text: the MJCF, with all that it includes.
            files: its other files, by name.
            given_rates: whether wheels turn at given rates, whatever torque that takes.

        Raises:
            ValueError: it cannot be compiled, or has not four fixed wheels.
        """
        spec = mujoco.MjSpec.from_string(text, assets=dict(files))
        foreign.complete(spec, files)
        for sensor in list(spec.sensors):
            spec.delete(sensor)
        self.wheeled = wheeled = WheeledRobot(spec.compile(), any_direction=True)
        self.notes = list[str]()
        self.names = [wheeled.model.joint(joint).name for joint in wheeled.joints]
        self.tyres = [wheeled.drum(joint) for joint in wheeled.joints]
        root = spec.body(wheeled.model.body(wheeled.root).name)
        if not list(root.joints):
            root.add_freejoint()
            self.notes.append("its base is fixed to the world; here it is free")
        self.ground = self._ground(spec)
        self._add_sensors(spec, root)
        self.given_rates = given_rates or not self._has_servos(wheeled.model)
        if self.given_rates:
            self._give_rates(spec)
        self.model = spec.compile()
        if self.gravity < _LEAST_GRAVITY:
            raise ValueError("its gravity is 0, so no wheel touches the ground")
        self.dofs = [int(self.model.joint(name).dofadr[0]) for name in self.names]
        self.signs = wheeled.signs
        self._gains = self._inputs_per_rate(self.model)
        self._start = self._placed()
        self.rest: FloatArray = self._start

    # ------------------------------------------------------------------------- building
    def _ground(self, spec: Any) -> str:
        """Return the name of the ground, which is added where there is none."""
        model = self.wheeled.model
        extent = self.wheeled.wheelbase + self.wheeled.track
        for g in range(model.ngeom):
            if model.body_weldid[model.geom_bodyid[g]] != 0:
                continue
            kind = model.geom_type[g]
            flat = kind in (mjtGeom.mjGEOM_PLANE, mjtGeom.mjGEOM_HFIELD)
            if flat or model.geom_size[g, :2].min() > _LARGE * extent:
                return str(model.geom(g).name)
        self.notes.append("its file has no ground; here it stands on a plane of MuJoCo's defaults")
        plane = {"type": mjtGeom.mjGEOM_PLANE, "size": [0, 0, 1], "pos": [0, 0, self.bottom]}
        spec.worldbody.add_geom(name="ssmr_ground", **plane)
        return "ssmr_ground"

    @property
    def bottom(self) -> float:
        """Height of the lowest point of the wheels as the file places them [m]."""
        heights = []
        for joint, drum in zip(self.wheeled.joints, self.tyres, strict=True):
            if drum is None:
                raise ValueError(
                    f"wheel '{self.wheeled.model.joint(joint).name}' has no shape that touches the "
                    "ground (is its mesh missing?)"
                )
            heights.append(float(self.wheeled.data.xanchor[joint, 2]) - drum.radius)
        return min(heights)

    def _add_sensors(self, spec: Any, root: Any) -> None:
        """Add a site between the axles, and sensors of its motion and of the wheels' loads."""
        wheeled = self.wheeled
        turn = wheeled.data.xmat[wheeled.root].reshape(3, 3)
        middle = wheeled.data.xanchor[wheeled.joints].mean(axis=0)
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, (turn.T @ wheeled.turn.T).ravel())
        place = turn.T @ (middle - wheeled.data.xpos[wheeled.root])
        root.add_site(name=_SITE, pos=place, quat=quat)
        for kind in ("FRAMEPOS", "FRAMEQUAT", "FRAMELINVEL", "FRAMEANGVEL"):
            sensor = spec.add_sensor(name=f"{_SITE}_{kind}", type=_sensor(kind))
            sensor.objtype = mjtObj.mjOBJ_SITE
            sensor.objname = _SITE
        for name in self.names:
            sensor = spec.add_sensor(name=f"ssmr_rate_{name}", type=_sensor("JOINTVEL"))
            sensor.objtype = mjtObj.mjOBJ_JOINT
            sensor.objname = name
        for body in wheeled.bodies:
            name = wheeled.model.body(body).name
            sensor = spec.add_sensor(name=f"ssmr_load_{name}", type=_sensor("CONTACT"))
            sensor.objtype = mjtObj.mjOBJ_XBODY
            sensor.objname = name
            sensor.intprm = _NET_FORCE

    def _give_rates(self, spec: Any) -> None:
        """Let heavy rotors turn the wheels; these do not push the body."""
        model = self.wheeled.model
        moving = np.flatnonzero(self._moments(model).any(axis=1))
        for a in sorted(moving.tolist(), reverse=True):
            spec.delete(spec.actuators[a])
        mass = float(model.body_subtreemass[self.wheeled.root])
        for name, drum in zip(self.names, self.tyres, strict=True):
            radius = 0.1 if drum is None else drum.radius
            armature = PRESCRIBED_SHARE * mass * radius**2
            spec.joint(name).armature = armature
            spec.joint(name).actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
            servo = spec.add_actuator(name=f"ssmr_{name}", target=name)
            servo.trntype = mujoco.mjtTrn.mjTRN_JOINT
            servo.set_to_velocity(kv=armature / ((PRESCRIBED_LAG + 1.0) * model.opt.timestep))

    def _moments(self, model: mujoco.MjModel) -> FloatArray:
        """Return the (nu, 4) rate of each actuator over the rate of each wheel [1]."""
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        moments = np.zeros((model.nu, model.nv))
        if model.nu:
            mujoco.mju_sparse2dense(
                moments,
                data.actuator_moment,
                data.moment_rownnz,
                data.moment_rowadr,
                data.moment_colind,
            )
        dofs = [int(model.joint(name).dofadr[0]) for name in self.names]
        return moments[:, dofs]

    def _inputs_per_rate(self, model: mujoco.MjModel) -> FloatArray:
        """Return the (nu, 4) inputs of the servos over the rates of the wheels [s/rad]."""
        scales = np.zeros(model.nu)
        for a in range(model.nu):
            gain = float(model.actuator_gainprm[a, 0])
            _, stiffness, damping = model.actuator_biasprm[a, :3]
            integrates = model.actuator_dyntype[a] == mjtDyn.mjDYN_INTEGRATOR
            if gain > 0.0 and integrates and stiffness < 0.0:
                scales[a] = -stiffness / gain
            elif gain > 0.0 and not integrates and stiffness == 0.0 and damping < 0.0:
                scales[a] = -damping / gain
        return np.asarray(scales[:, None] * self._moments(model))

    def _has_servos(self, model: mujoco.MjModel) -> bool:
        """Return whether each side has a servo of its rate; else the robot is driven by rates."""
        left, right = np.abs(self._inputs_per_rate(model)).sum(axis=0).reshape(2, 2).sum(axis=0)
        return bool(left > 0.0 and right > 0.0)

    @property
    def servos(self) -> list[str]:
        """Names of the actuators that drive the wheels."""
        return [self.model.actuator(int(a)).name for a in np.flatnonzero(self._gains.any(axis=1))]

    @property
    def mass(self) -> float:
        """Mass of the whole robot [kg]."""
        return float(self.model.body_subtreemass[self.wheeled.root])

    @property
    def radius(self) -> float:
        """Mean radius of the wheels [m]."""
        return float(np.mean([drum.radius for drum in self.tyres if drum is not None]))

    @property
    def gravity(self) -> float:
        """Gravity of its file [m/s2]."""
        return float(np.linalg.norm(self.model.opt.gravity))

    @property
    def top_rate(self) -> float:
        """Greatest wheel rate that the inputs of its servos allow [rad/s]."""
        most = math.inf
        for a in range(self.model.nu):
            per_rate = float(np.abs(self._gains[a]).sum())
            if per_rate > 0.0 and self.model.actuator_ctrllimited[a]:
                most = min(most, float(self.model.actuator_ctrlrange[a].max()) / per_rate)
        return most

    def _placed(self) -> FloatArray:
        """Return the state in which the wheels just touch level ground."""
        data = mujoco.MjData(self.model)
        ground = self.model.geom(self.ground)
        root = int(self.model.body_jntadr[self.wheeled.root])
        is_free = self.model.jnt_type[root] == mujoco.mjtJoint.mjJNT_FREE
        if is_free and ground.type[0] == mjtGeom.mjGEOM_PLANE:
            at = int(self.model.jnt_qposadr[root]) + 2
            data.qpos[at] += float(ground.pos[2]) - self.bottom
        return self._state(data)

    def _state(self, data: mujoco.MjData) -> FloatArray:
        kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
        state = np.empty(mujoco.mj_stateSize(self.model, kind))
        mujoco.mj_getState(self.model, data, state, kind)
        return state

    # ------------------------------------------------------------------------- driving
    def settle(self, model: mujoco.MjModel | None = None) -> Ride:
        """Let the robot stand from where its wheels just touch the ground; keep how it rests."""
        ride = self.ride((0.0, 0.0), _SETTLE_TIME, model, self._start)
        self.rest = ride.end
        return ride

    def ride(
        self,
        rates: tuple[float, float],
        seconds: float,
        model: mujoco.MjModel | None = None,
        start: FloatArray | None = None,
    ) -> Ride:
        """Drive with constant wheel rates of the left and right side, reached in `RAMP`.

        Args:
            rates: rates of the left and the right wheels [rad/s].
            seconds: duration [s].
            model: the model with other settings, of the same structure; its own if not given.
            start: state of the simulator; at rest if not given.

        Raises:
            DivergedError: the simulator gave up.
        """
        model = self.model if model is None else model
        dt = float(model.opt.timestep)
        share = np.minimum(dt * np.arange(max(round(seconds / dt), 2)) / RAMP, 1.0)
        start = self.rest if start is None else start
        stride = max(round(_SAMPLE / dt), 1)
        return self.follow(np.outer(share, rates), start, model, stride=stride)

    def follow(
        self,
        rates: FloatArray,
        start: FloatArray,
        model: mujoco.MjModel | None = None,
        *,
        stride: int = 1,
        push: FloatArray | None = None,
    ) -> Ride:
        """Drive with wheel rates of each step.

        Args:
            rates: (n, 2) rates of the left and the right wheels [rad/s].
            start: state of the simulator.
            model: the model with other settings, of the same structure; its own if not given.
            stride: steps from one sample to the next; the first step is one.
            push: (n,) yaw accelerations [rad/s2] that disturb it; none if not given.

        Raises:
            DivergedError: the simulator gave up.
        """
        model = self.model if model is None else model
        dt = float(model.opt.timestep)
        control = (np.tile(rates, 2) * self.signs) @ self._gains.T
        limited = model.actuator_ctrllimited.astype(bool)
        low = np.where(limited, model.actuator_ctrlrange[:, 0], -np.inf)
        high = np.where(limited, model.actuator_ctrlrange[:, 1], np.inf)
        control = np.clip(control, low, high)
        inputs = control
        spec = mujoco.mjtState.mjSTATE_CTRL
        if push is not None:
            _, _, tensor = self.wheeled.lump(self.wheeled.group(self.wheeled.root))
            forces = np.zeros((len(rates), model.nv))
            forces[:, model.jnt_dofadr[model.body_jntadr[self.wheeled.root]] + 5] = push
            inputs = np.hstack([control, float(tensor[2, 2]) * forces])
            spec |= mujoco.mjtState.mjSTATE_QFRC_APPLIED
        data = mujoco.MjData(model)
        # what diverges is said below, and not in a log of MuJoCo's
        mujoco.set_mju_user_warning(_say_nothing)
        try:
            states, sensors = rollout.rollout(
                model, data, start[None], inputs[None], control_spec=int(spec)
            )
        finally:
            mujoco.set_mju_user_warning(None)
        clock = np.concatenate([start[:1], states[0, :, 0]])
        bad = np.flatnonzero((np.diff(clock) <= 0.0) | ~np.isfinite(states[0]).all(axis=1))
        if len(bad):
            t = float(bad[0]) * dt
            raise DivergedError(f"mujoco gave up at t = {t:.3f} s: no finite state", t=t)
        sampled = sensors[0][::stride]
        saturated = self._saturated(control[::stride], sampled[:, 13:17])
        return self._read(sampled, stride * dt, states[0, -1], saturated)

    def pose_of(self, state: FloatArray) -> tuple[float, float, float]:
        """Return x, y [m] and yaw [rad] of the middle between the axles in a simulator's state."""
        data = mujoco.MjData(self.model)
        kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
        mujoco.mj_setState(self.model, data, state, kind)
        mujoco.mj_kinematics(self.model, data)
        site = data.site(_SITE)
        ahead = site.xmat.reshape(3, 3)[:, 0]
        x, y, _ = site.xpos
        return float(x), float(y), math.atan2(float(ahead[1]), float(ahead[0]))

    def _saturated(self, inputs: FloatArray, rates: FloatArray) -> float:
        """Return the greatest share of the time in which a servo's force is at its limit."""
        model = self.model
        limits = np.where(
            model.actuator_forcelimited, np.abs(model.actuator_forcerange).max(axis=1), np.inf
        )
        for joint, moments in zip(self.names, self._moments(model).T, strict=True):
            number = model.joint(joint).id
            if model.jnt_actfrclimited[number]:
                most = float(np.abs(model.jnt_actfrcrange[number]).max())
                acting = moments != 0.0
                limits[acting] = np.minimum(limits[acting], most / np.abs(moments[acting]))
        forces = model.actuator_gainprm[:, 0] * inputs
        forces = forces + model.actuator_biasprm[:, 2] * (rates @ self._moments(model).T)
        at_limit = (np.abs(forces) > 0.999 * limits).mean(axis=0)
        return float(at_limit[self._gains.any(axis=1)].max(initial=0.0))

    def _read(self, sensors: FloatArray, period: float, end: FloatArray, saturated: float) -> Ride:
        """Return the motion that sensors tell."""
        place, quat, velocity, spin, rates = np.split(sensors[:, :17], [3, 7, 10, 13], axis=1)
        yaw = np.unwrap(np.atleast_1d(quat_wxyz_to_yaw(quat)))
        ahead = rotate_world_to_body(velocity[:, :2], yaw)
        loads = -sensors[:, 17:29].reshape(-1, 4, 3)[:, :, 2]
        return Ride(
            t=period * np.arange(len(sensors), dtype=np.float64),
            pose=np.column_stack([place[:, :2], yaw]),
            twist=np.column_stack([ahead, spin[:, 2]]),
            wheels=rates * self.signs,
            loads=loads,
            saturated=saturated,
            end=end,
        )


def _say_nothing(message: str) -> None:
    """Take a warning of MuJoCo."""


def _sensor(kind: str) -> mjtSensor:
    sensor: mjtSensor = getattr(mjtSensor, f"mjSENS_{kind}")
    return sensor
