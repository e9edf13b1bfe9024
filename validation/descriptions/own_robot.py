"""A robot of others, driven with its own physics: its solver, contacts and motors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from mujoco import mjtGeom, mjtJoint, mjtObj, mjtSensor

from ssmr.geometry import quat_wxyz_to_yaw, rotate_world_to_body
from ssmr.types import FloatArray, Trajectory
from validation.descriptions.wheels import WheeledRobot, motor_moments
from validation.output import one_line
from validation.simulator import foreign
from validation.simulator.motors import GIVEN_SHARE, GIVEN_STEPS, lead_rates
from validation.simulator.parts import mujoco_failures, rolled_out

_SETTLE_TIME = 1.0
"""Time in which the robot comes to rest before it is driven [s]."""
_RAMP = 0.4
"""Time in which wheels are brought to their rate [s]: a step would let tyres jump."""
_SAMPLE = 0.01
"""Period of samples [s], about."""
_LEAST_GRAVITY = 1e-3
"""Gravity below which a robot does not stand [m/s2]."""
_NET_FORCE = [1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 3, 1]
"""Output of a sensor of contacts: the force, of all contacts together (`netforce`), as one."""
_SITE = "ssmr_middle"
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
Measures = dict[str, float]
"""Measurements of trials [SI], by name."""


class OwnRobot:
    """A compiled robot of others on its ground, and how its wheels are told their rates."""

    is_fixed = False
    """Whether its file fixes its base to the world; here it is free."""

    @mujoco_failures()
    def __init__(
        self,
        text: str,
        files: Mapping[str, bytes],
        *,
        given_rates: bool = False,
        least_step: float = 0.0,
    ) -> None:
        """Build it.

        Args:
            text: the MJCF, with all that it includes.
            files: its other files, by name.
            given_rates: whether wheels turn at given rates, whatever torque that takes.
            least_step: physics step [s] that takes the place of a shorter one.

        Raises:
            ValueError: it cannot be compiled, or has not four fixed wheels.
        """
        spec = mujoco.MjSpec.from_string(text, assets=dict(files))
        foreign.complete_spec(spec, files)
        for sensor in list(spec.sensors):
            spec.delete(sensor)
        self.longer_step = max(least_step / spec.option.timestep, 1.0)
        if self.longer_step > 1.0:
            spec.option.timestep = least_step
            # with which motors and dampers of any stiffness are stable
            spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        self.measures = Measures()
        self.loads: FloatArray = np.empty(0)
        self.notes = list[str]()
        self._find_wheels(spec)
        wheeled = self.wheeled
        self.contacts = [wheeled.tyre_contact(joint) for joint in wheeled.joints]
        self.limits = wheeled.limits_of_motors()
        root = spec.body(wheeled.model.body(wheeled.root).name)
        if not list(root.joints):
            root.add_freejoint()
            self.is_fixed = True
        self._add_sensors(spec, root)
        inputs = wheeled.servo_inputs()
        left, right = np.abs(inputs).sum(axis=0).reshape(2, 2).sum(axis=0)
        # without a servo of its rate on each side the robot is driven by rates
        self.given_rates = given_rates or not (left > 0.0 and right > 0.0)
        if self.given_rates:
            self._give_rates(spec)
        self.model = spec.compile()
        if self.gravity < _LEAST_GRAVITY:
            raise ValueError("its gravity is 0, so no wheel touches the ground")
        self.dofs = [int(self.model.joint(name).dofadr[0]) for name in self.names]
        self.signs = wheeled.signs
        joints = [self.model.joint(name).id for name in self.names]
        self._gains = motor_moments(self.model, joints) if self.given_rates else inputs
        self.driven = self._gains.any(axis=0)
        self._start = self._placed()
        self.rest: FloatArray = self._start

    # ------------------------------------------------------------------------- building
    def _find_wheels(self, spec: Any) -> None:
        """Find wheels and ground, which is added where there is none."""
        self.wheeled = wheeled = WheeledRobot(spec.compile(), any_direction=True)
        self.names = [wheeled.model.joint(joint).name for joint in wheeled.joints]
        self.tyres = [drum for drum in wheeled.drums if drum is not None]
        if len(self.tyres) < len(self.names):
            raise ValueError("a wheel has no shape that touches the ground (is its mesh missing?)")
        grounds = [wheeled.find_ground(joint) for joint in wheeled.joints]
        for ground in grounds:
            if ground is not None:
                self.ground = str(wheeled.model.geom(ground).name)
                return
        self.notes.append("its file has no ground; here it stands on a plane of MuJoCo's defaults")
        plane = {"type": mjtGeom.mjGEOM_PLANE, "size": [0, 0, 1], "pos": [0, 0, self.bottom]}
        spec.worldbody.add_geom(name="ssmr_ground", **plane)
        self._find_wheels(spec)

    @property
    def bottom(self) -> float:
        """Height of the lowest point of the wheels as the file places them [m]."""
        heights = self.wheeled.data.xanchor[self.wheeled.joints, 2]
        return float((heights - [drum.radius for drum in self.tyres]).min())

    def _add_sensors(self, spec: Any, root: Any) -> None:
        """Add a site between the axles, and sensors of its motion and of the wheels' loads."""
        wheeled = self.wheeled
        data = wheeled.data
        turn = data.xmat[wheeled.root].reshape(3, 3)
        middle = data.xanchor[wheeled.joints].mean(axis=0)
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, (turn.T @ wheeled.turn.T).ravel())
        root.add_site(name=_SITE, pos=turn.T @ (middle - data.xpos[wheeled.root]), quat=quat)
        bodies = [wheeled.model.body(body).name for body in wheeled.bodies]
        kinds = ("FRAMEPOS", "FRAMEQUAT", "FRAMELINVEL", "FRAMEANGVEL")
        sensors = [(kind, mjtObj.mjOBJ_SITE, _SITE) for kind in kinds]
        sensors += [("JOINTVEL", mjtObj.mjOBJ_JOINT, name) for name in self.names]
        sensors += [("CONTACT", mjtObj.mjOBJ_XBODY, name) for name in bodies]
        for kind, part, name in sensors:
            sensor = spec.add_sensor(name=f"ssmr_{kind}_{name}", objtype=part, objname=name)
            sensor.type = getattr(mjtSensor, f"mjSENS_{kind}")
            if kind == "CONTACT":
                sensor.intprm = _NET_FORCE

    def _give_rates(self, spec: Any) -> None:
        """Let heavy rotors turn the wheels; these do not push the body.

        The solver of contacts foresees where a step takes the wheels, but knows nothing of damping
        that the integrator makes implicit: it sees wheels of stiff servos that are ahead, and so
        the body is. Rotors are damped so that it sees them as far ahead as the robot's own wheels.
        """
        model = self.wheeled.model
        turning = 1e-3 * self.wheeled.signs
        foreseen, happened = self._change_in_air(model, turning, np.zeros(model.nu))
        ahead = np.ones(len(turning))
        np.divide(foreseen, happened, out=ahead, where=happened != 0.0)
        steps = 1.0 / np.maximum(ahead - 1.0, 1.0 / GIVEN_STEPS)
        moments = motor_moments(model, self.wheeled.joints)
        for actuator in reversed(np.flatnonzero(moments.any(axis=1)).tolist()):
            spec.delete(spec.actuators[actuator])
        mass = float(model.body_subtreemass[self.wheeled.root])
        for name, drum, lag in zip(self.names, self.tyres, steps.tolist(), strict=True):
            joint = spec.joint(name)
            joint.armature = armature = GIVEN_SHARE * mass * drum.radius**2
            joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
            damping = armature / (lag * model.opt.timestep)
            joint.damping = [damping, 0.0, 0.0]
            rotor = spec.add_actuator(name=f"ssmr_{name}", target=name)
            rotor.trntype = mujoco.mjtTrn.mjTRN_JOINT
            rotor.set_to_motor()
            rotor.gainprm[0] = damping
            # what the file says of all actuators is not meant for this one
            rotor.ctrllimited = rotor.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
            rotor.gear = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]

    def _change_in_air(
        self, model: mujoco.MjModel, turning: FloatArray, control: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return how the wheels' rates change in a step without ground and gravity [rad/s].

        That is as the solver of contacts foresees it, (4,), and as it happens.
        """
        free = mujoco.MjModel.__copy__(model)
        free.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        free.opt.gravity = 0.0
        dofs = [int(model.joint(name).dofadr[0]) for name in self.names]
        data = mujoco.MjData(free)
        data.qvel[dofs] = turning
        data.ctrl = control
        mujoco.mj_step(free, data)
        return model.opt.timestep * data.qacc[dofs], data.qvel[dofs] - turning

    def _lead_of_rates(self, model: mujoco.MjModel) -> FloatArray:
        """Return the (4,) leads of given rates, in changes of a step of the model."""
        still = np.zeros(len(self.dofs))
        _, share = self._change_in_air(model, still, self._gains @ np.ones(len(self.dofs)))
        return np.asarray(1.0 / share - 1.0)

    @property
    def servos(self) -> list[str]:
        """Names of the actuators that drive the wheels."""
        return [self.model.actuator(int(a)).name for a in np.flatnonzero(self._gains.any(axis=1))]

    @property
    def timestep(self) -> float:
        """Physics step [s]."""
        return float(self.model.opt.timestep)

    @property
    def mass(self) -> float:
        """Mass of the whole robot [kg]."""
        return float(self.model.body_subtreemass[self.wheeled.root])

    @property
    def radius(self) -> float:
        """Mean radius of the wheels [m]."""
        return float(np.mean([drum.radius for drum in self.tyres]))

    @property
    def gravity(self) -> float:
        """Gravity of its file [m/s2]."""
        return float(np.linalg.norm(self.model.opt.gravity))

    @property
    def speed_unit(self) -> float:
        """Speed sqrt(g r) that speeds of robots of every size are shares of [m/s]."""
        return math.sqrt(self.gravity * self.radius)

    @property
    def top_rate(self) -> float:
        """Greatest wheel rate that the inputs of its servos allow [rad/s]."""
        model = self.model
        per_rate = np.abs(self._gains).sum(axis=1)
        limited = (per_rate > 0.0) & model.actuator_ctrllimited.astype(bool)
        most = model.actuator_ctrlrange[limited].max(axis=1) / per_rate[limited]
        return float(most.min(initial=math.inf))

    def _placed(self) -> FloatArray:
        """Return the state in which the wheels just touch level ground."""
        model = self.model
        data = mujoco.MjData(model)
        ground = model.geom(self.ground)
        root = model.body_jntadr[self.wheeled.root]
        is_free = model.jnt_type[root] == mjtJoint.mjJNT_FREE
        if is_free and ground.type[0] == mjtGeom.mjGEOM_PLANE:
            data.qpos[model.jnt_qposadr[root] + 2] += float(ground.pos[2]) - self.bottom
        return self.state_of(data)

    # ------------------------------------------------------------------------- driving
    def settle(self) -> Trajectory:
        """Let the robot stand from where its wheels just touch the ground; keep how it rests."""
        motion, self.rest = self._ramped((0.0, 0.0), _SETTLE_TIME, self.model, self._start)
        return motion

    def ride(
        self, rates: tuple[float, float], seconds: float, model: mujoco.MjModel | None = None
    ) -> Trajectory:
        """Drive from rest with constant wheel rates of the sides, reached in `_RAMP`.

        Args:
            rates: rates of the left and the right wheels [rad/s].
            seconds: duration [s].
            model: the model with other settings, of the same structure; its own if not given.

        Raises:
            DivergedError: the simulator gave up.
        """
        return self._ramped(rates, seconds, model or self.model, self.rest)[0]

    def _ramped(
        self,
        rates: tuple[float, float],
        seconds: float,
        model: mujoco.MjModel,
        start: FloatArray,
    ) -> tuple[Trajectory, FloatArray]:
        dt = float(model.opt.timestep)
        share = np.minimum(dt * np.arange(max(round(seconds / dt), 2)) / _RAMP, 1.0)
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
    ) -> tuple[Trajectory, FloatArray]:
        """Drive with wheel rates of each step.

        Args:
            rates: (n, 2) rates of the left and the right wheels, or (n, 4) of all [rad/s].
            start: state of the simulator.
            model: the model with other settings, of the same structure; its own if not given.
            stride: steps from one sample to the next; the first step is one.
            push: (n,) yaw accelerations [rad/s2] that disturb it; none if not given.

        Returns:
            The motion of the middle between the axles, and the simulator's state at the end. Its
            channels have the rates and loads of the wheels in the order of `WHEELS`,
            `wheel_rad_s` and `wheel_load_N` (M, 4), and the inputs of the actuators (M, nu).

        Raises:
            DivergedError: the simulator gave up.
        """
        model = model or self.model
        dt = float(model.opt.timestep)
        told = np.tile(rates, 4 // rates.shape[1]) * self.signs
        if self.given_rates:
            turning = start[1 + model.nq + np.array(self.dofs)]
            told = lead_rates(told, turning, self._lead_of_rates(model))
        control = told @ self._gains.T
        limited = model.actuator_ctrllimited.astype(bool)
        low = np.where(limited, model.actuator_ctrlrange[:, 0], -np.inf)
        high = np.where(limited, model.actuator_ctrlrange[:, 1], np.inf)
        control = np.clip(control, low, high)
        inputs = control
        spec = mujoco.mjtState.mjSTATE_CTRL
        if push is not None:
            root = self.wheeled.root
            _, _, tensor = self.wheeled.lump(self.wheeled.group(root))
            forces = np.zeros((len(rates), model.nv))
            forces[:, model.jnt_dofadr[model.body_jntadr[root]] + 5] = push
            inputs = np.hstack([control, float(tensor[2, 2]) * forces])
            spec |= mujoco.mjtState.mjSTATE_QFRC_APPLIED
        # what diverges is an error, and not a line in a log of MuJoCo's
        mujoco.set_mju_user_warning(_say_nothing)
        try:
            states, sensors = rolled_out(mujoco.MjData(model), start, inputs, int(spec))
        finally:
            mujoco.set_mju_user_warning(None)
        sampled = sensors[::stride]
        parts = np.split(sampled[:, :17], [3, 7, 10, 13], axis=1)
        place, quat, velocity, spin, turning = parts
        yaw = np.unwrap(np.atleast_1d(quat_wxyz_to_yaw(quat)))
        ahead = rotate_world_to_body(velocity[:, :2], yaw)
        wheels = turning * self.signs
        channels = {
            "wheel_rad_s": wheels,
            "wheel_load_N": -sampled[:, 19:29:3],
            "inputs": control[::stride],
        }
        motion = Trajectory(
            stride * dt * np.arange(len(sampled), dtype=np.float64),
            np.column_stack([place[:, :2], yaw]),
            np.column_stack([ahead, spin[:, 2]]),
            0.5 * (wheels[:, :2] + wheels[:, 2:]),
            channels,
        )
        return motion, states[-1]

    def pose_of(self, state: FloatArray) -> tuple[float, float, float]:
        """Return x, y [m] and yaw [rad] of the middle between the axles in a simulator's state."""
        site = self.data_of(state).site(_SITE)
        x, y, _ = site.xpos.tolist()
        return x, y, math.atan2(site.xmat[3], site.xmat[0])

    def data_of(self, state: FloatArray) -> mujoco.MjData:
        """Return the simulator in a state, with the places of all parts."""
        data = mujoco.MjData(self.model)
        mujoco.mj_setState(self.model, data, state, _STATE)
        mujoco.mj_kinematics(self.model, data)
        return data

    def state_of(self, data: mujoco.MjData) -> FloatArray:
        """Return the state of the simulator."""
        state = np.empty(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, data, state, _STATE)
        return state

    def of_wheels(self, key: str, usual: float) -> FloatArray:
        """Return (4,) numbers of contacts or motors, see `ForeignRobot`; `usual` for what lacks."""
        numbers = zip(self.contacts, self.limits, strict=True)
        return np.array([(one | other).get(key, usual) for one, other in numbers])

    @property
    def frictions(self) -> FloatArray:
        """(4,) frictions with which the tyres slide on the ground [1]."""
        return np.maximum(self.of_wheels("mu1", 0.0), self.of_wheels("mu2", 0.0))

    def _resting(self) -> mujoco.MjData:
        data = self.data_of(self.rest)
        mujoco.mj_forward(self.model, data)
        return data

    @property
    def sinking(self) -> float:
        """Greatest depth of the contacts at rest [m]."""
        return float(-self._resting().contact.dist.min(initial=0.0))

    def other_contacts(self) -> str:
        """Return the names of the robot's shapes that touch at rest, beside tyres on the ground."""
        model = self.model
        tyres = {self.wheeled.model.geom(drum.geom).name for drum in self.tyres}
        root = model.body(self.wheeled.model.body(self.wheeled.root).name).id
        is_of_robot = model.body_rootid[model.geom_bodyid] == root
        found = set[str]()
        for pair in self._resting().contact.geom.tolist():
            names = {model.geom(geom).name for geom in pair}
            is_rolling = self.ground in names and names & tyres
            if is_of_robot[pair].any() and not is_rolling:
                found |= names - {self.ground}
        return one_line(", ".join(sorted(found)))


def _say_nothing(message: str) -> None:
    """Take a warning of MuJoCo."""
