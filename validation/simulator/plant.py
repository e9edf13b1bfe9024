"""A MuJoCo robot as a `Plant`."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property

import mujoco
import numpy as np
from mujoco import rollout

from ssmr.errors import DivergedError, UnhealthyRunError
from ssmr.geometry import quat_wxyz_to_roll_pitch, quat_wxyz_to_yaw, rotate_world_to_body, yaw_to_quat_wxyz
from ssmr.robot.drive import Driver, wheel_references, whole_steps
from ssmr.robot.motor import motor_numbers
from ssmr.robot.vehicle import Drive
from ssmr.types import Commands, FloatArray, State, Trajectory
from validation.simulator.calibration import Calibration
from validation.simulator.description import SIDES, WHEELS
from validation.simulator.failures import mujoco_failures
from validation.simulator.health import check_health
from validation.simulator.model import FREE_DRIVE, contact_settings, controls, pressed_in, robot_model, wheel_geoms
from validation.simulator.physics import SHIPPED, PhysicsSettings
from validation.simulator.terrain import FLAT, Terrain

PRESCRIBED_SHARE = 50.0
"""Armature of wheels whose rates are given, over mass times wheel radius squared [1]: so heavy that the ground cannot change
them (MuJoCo does not pass an armature's reaction on to the body)."""
_NO_INTEGRAL = 1e-6  # integral gain of those wheels [N m/rad]: next to nothing, but with the same parts in the model
PRESCRIBED_LAG = 2.5
"""Time constant with which given wheel rates are followed, in time steps."""
SETTLE_CONSTANTS = 50.0
"""Time for which the robot stands before its resting height is taken, in time constants of the contact; 1 s for a Husky."""


class MujocoPlant:
    """A calibrated robot on its ground."""

    name = "mujoco"
    drive: Drive
    """Saturation, delays and conversions between command and wheels."""
    wheel_dofs: tuple[list[int], ...]
    """Degrees of freedom of the left and of the right wheels."""
    yaw_inertia: float
    """Moment of inertia of the whole robot about the vertical through its centre of mass [kg m2]."""

    @mujoco_failures()
    def __init__(
        self,
        calibration: Calibration,
        drive: Drive,
        *,
        terrain: Terrain = FLAT,
        strict: bool = False,
        settings: PhysicsSettings = SHIPPED,
    ) -> None:
        """Build the model, let it settle, and start at rest at the origin.

        Args:
            calibration: the robot's numbers.
            drive: saturation, delays and conversions between command and wheels.
            terrain: ground.
            strict: raise where a run's wheel loads are unhealthy, instead of leaving the verdict in the result.
            settings: how physics is computed, if not as shipped.

        Raises:
            MemoryError: the simulator does not fit into memory.
            ValueError: numbers that do not go together.
        """
        whole_steps(drive.hold, calibration.timestep, "the drive's hold")
        self.calibration, self.terrain, self._strict, self._settings = calibration, terrain, strict, settings
        self.drive = drive
        self.model = robot_model(calibration, terrain, settings, drive)
        self._data = mujoco.MjData(self.model)
        self.wheel_dofs = tuple(
            [int(self.model.joint(f"{wheel}_wheel").dofadr[0]) for wheel in WHEELS if wheel.endswith(side)] for side in SIDES
        )
        self._wheel_bodies = [int(self.model.body(wheel).id) for wheel in WHEELS]
        self._tires = wheel_geoms(self.model)
        radii = self.model.geom_size[self._tires, 0] - pressed_in(self.model, calibration)
        self._level_height = float(radii.mean()) - calibration.robot.geometry.axle_height  # of the base, on level ground
        self._load_columns = [int(self.model.sensor(f"load_{wheel}").adr[0]) for wheel in WHEELS]
        self._torque_columns = [int(self.model.sensor(f"torque_{wheel}").adr[0]) for wheel in WHEELS]
        self._acceleration_column = int(self.model.sensor("angular_acceleration").adr[0]) + 2
        self._imu_columns = [int(self.model.sensor(f"imu_{what}").adr[0]) for what in ("gyro", "accelerometer")]
        parts = drive.integral_gain > 0.0
        motors = calibration.robot.motors if parts else ()
        self._shaft_dofs = [int(self.model.joint(f"{motor}_shaft").dofadr[0]) for motor in motors]
        self._resting = self._settle(State())
        self._rest_on_rough: tuple[State, FloatArray] | None = None
        mass_matrix = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self._data, mass_matrix)
        root = self.model.body("base").id
        offset = self._data.subtree_com[root][:2] - self._data.xpos[root][:2]
        self.yaw_inertia = float(mass_matrix[5, 5] - self.model.body_subtreemass[root] * offset @ offset)
        self.reset(State())

    def with_drive(self, drive: Drive) -> MujocoPlant:
        """Return the same robot, on the same ground and with the same physics, with another drive.

        Raises:
            ValueError: the drive does not go with the physics step.
        """
        return MujocoPlant(self.calibration, drive, terrain=self.terrain, strict=self._strict, settings=self._settings)

    @cached_property
    def _prescribed(self) -> mujoco.MjModel:
        """Return the robot's model with wheels that turn as they are told, whatever torque that takes."""
        robot = self.calibration.robot
        armature = PRESCRIBED_SHARE * robot.masses.total * robot.geometry.wheel_radius**2
        gain = 2.0 * armature / (PRESCRIBED_LAG * self.dt)
        heavy = replace(self.calibration, armature=armature, gain=gain, rolling_resistance=0.0)
        same_parts = replace(FREE_DRIVE, integral_gain=min(self.drive.integral_gain, _NO_INTEGRAL))
        return robot_model(heavy, self.terrain, self._settings, same_parts)

    @property
    def dt(self) -> float:
        """Physics step [s]."""
        return float(self.model.opt.timestep)

    def _settle(self, state: State) -> FloatArray:
        """Return the (nq,) configuration at rest in `state`: tyres pressed in, the body tilted by mass and ground."""
        data = self._data
        mujoco.mj_resetData(self.model, data)
        data.qpos[:2] = state.x, state.y
        mujoco.mju_mulQuat(data.qpos[3:7], yaw_to_quat_wxyz(state.yaw), self.model.qpos0[3:7])
        (constant, _), _ = contact_settings(self.calibration.robot)
        for _ in range(round(SETTLE_CONSTANTS * constant / self.dt)):
            self.lay_ground(data)
            mujoco.mj_step(self.model, data)
        rest = np.array(data.qpos)
        rest[:2] = state.x, state.y
        turned = float(quat_wxyz_to_yaw(rest[3:7])) - state.yaw
        mujoco.mju_mulQuat(rest[3:7], yaw_to_quat_wxyz(-turned), data.qpos[3:7])
        rest[7:] = 0.0
        return rest

    def lay_ground(self, data: mujoco.MjData) -> None:
        """Put rough ground's tangent planes under the wheels, where the body is now; nothing to do on other grounds."""
        if self.terrain.kind == "rough":
            (data.mocap_pos[:],), (data.mocap_quat[:],) = self.planes_under(data.qpos[None, :7])

    def planes_under(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (S, 4, 3) places and (S, 4, 4) quaternions (w first) of the ground under the wheels of (S, 7) poses."""
        radius = float(self.model.geom_size[self._tires[0], 0])
        return self.terrain.surface.tangent_planes(poses, self.model.body_pos[self._wheel_bodies], radius)

    def _rest(self, state: State) -> FloatArray:
        """Return the (nq,) configuration at rest, without settling anew where the ground is alike everywhere."""
        if self.terrain.kind == "rough":
            place = State(state.x, state.y, state.yaw)
            if self._rest_on_rough is None or self._rest_on_rough[0] != place:
                self._rest_on_rough = place, self._settle(place)
            return self._rest_on_rough[1]
        rest = self._resting.copy()
        rest[:2] = state.x, state.y
        mujoco.mju_mulQuat(rest[3:7], yaw_to_quat_wxyz(state.yaw), self._resting[3:7])
        return rest

    def _place(self, state: State) -> None:
        """Put the simulator into `state`, its memory of former runs wiped; on rough ground its speed is level."""
        data, rest = self._data, self._rest(state)
        mujoco.mj_resetData(self.model, data)
        data.qpos[:] = rest
        c, s = math.cos(state.yaw), math.sin(state.yaw)
        data.qvel[:2] = c * state.v_x - s * state.v_y, s * state.v_x + c * state.v_y
        data.qvel[5] = state.yaw_rate
        for dofs, rate in zip(self.wheel_dofs, (state.wheel_left, state.wheel_right), strict=True):
            data.qvel[dofs] = rate
        data.qvel[self._shaft_dofs] = np.resize((state.wheel_left, state.wheel_right), len(self._shaft_dofs))
        self._turns = round((state.yaw - float(quat_wxyz_to_yaw(data.qpos[3:7]))) / (2.0 * math.pi))

    def placed(self, state: State) -> FloatArray:
        """Return the simulator's whole (1 + nq + nv) state where the robot rests on its tyres in `state`."""
        self._place(state)
        start = np.empty(mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        mujoco.mj_getState(self.model, self._data, start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        return start

    def _read(self) -> State:
        """Return the simulator's state as a planar one; yaw is unwrapped from the last reading."""
        qpos, qvel = self._data.qpos, self._data.qvel
        yaw = float(quat_wxyz_to_yaw(qpos[3:7])) + 2.0 * math.pi * self._turns
        v = rotate_world_to_body(qvel[:2], yaw)
        return State(
            float(qpos[0]), float(qpos[1]), yaw, float(v[0]), float(v[1]), float(qvel[5]),
            *(float(np.mean(qvel[dofs])) for dofs in self.wheel_dofs),
        )  # fmt: skip

    def reset(self, state: State) -> State:
        """Start from `state`, resting on its tyres, with empty delay lines."""
        self._place(state)
        self._driver = Driver(self.drive, self.dt, state)
        self._last = self._read()
        return self._last

    def step(self, command: tuple[float, float], dt: float, yaw_acceleration: float = 0.0) -> State:
        """Hold a twist command for `dt` [s].

        Raises:
            DivergedError: the simulator warned or left the finite numbers.
        """
        data = self._data
        data.qfrc_applied[5] = self.yaw_inertia * yaw_acceleration
        turned = self._last.yaw  # to within a step: enough to count whole turns, however long the command is held
        references = self._driver.references(command, whole_steps(dt, self.dt, "the step"))
        for control in controls(self.model, references):
            data.ctrl[:] = control
            before = data.time
            self.lay_ground(data)
            mujoco.mj_step(self.model, data)
            if not data.time > before:
                raise DivergedError(f"mujoco gave up at t = {before:.3f} s", t=before, state=self._last)
            turned += self.dt * float(data.qvel[5])
        self._turns += round((turned - self._read().yaw) / (2.0 * math.pi))
        self._last = self._read()
        return self._last

    def imu(self) -> tuple[FloatArray, FloatArray]:
        """Return (3,) angular velocity [rad/s] and (3,) specific force [m/s2] at the IMU, along its axes.

        They are those at the last step's start, and zero before the first step.
        """
        gyro, accelerometer = (np.array(self._data.sensordata[column : column + 3]) for column in self._imu_columns)
        return gyro, accelerometer

    @mujoco_failures()
    def run(self, commands: Commands, state: State, sample_dt: float, disturbance: FloatArray | None = None) -> Trajectory:
        """Drive `commands` at once, by `mujoco.rollout`.

        Returns: The motion, with channels `wheel_load_N` (M, 4; front left, front right, rear left, rear right),
            `torque_N_m` (M, 2) and `yaw_acceleration_rad_s2` (M,); on rough ground also `height_m` (M,) above where it rests
            on level ground and `roll_pitch_rad` (M, 2).

        Raises:
            DivergedError: the simulator gave up.
            UnhealthyRunError: wheel loads dropped out or were not smooth, if `strict`.
        """
        stride = whole_steps(sample_dt, self.dt, "the sample period")
        references = wheel_references(commands, self.drive, self.dt, state)
        start = self.placed(state)
        spec = mujoco.mjtState.mjSTATE_CTRL
        model = self._prescribed if commands.kind == "wheels" else self.model
        control = controls(model, np.vstack([references, references[-1:]]))  # one more step: its sensors are the end's
        if disturbance is not None:
            if len(disturbance) != len(references):
                raise ValueError(f"{len(disturbance)} disturbances for {len(references)} physics steps")
            applied = np.zeros((len(control), model.nv))
            applied[:-1, 5] = self.yaw_inertia * np.asarray(disturbance)
            spec, control = spec | mujoco.mjtState.mjSTATE_QFRC_APPLIED, np.hstack([control, applied])
        states, sensors = self._roll(model, start, control, int(spec))
        # A diverged rollout resets itself: its clock jumps back.
        bad = np.flatnonzero((np.diff(states[:, 0]) <= 0.0) | ~np.isfinite(states[1:]).all(axis=1))
        if len(bad):
            t = (int(bad[0]) + 1) * self.dt
            raise DivergedError(f"mujoco gave up at t = {t:.3f} s: no finite state", t=t, states=states[: int(bad[0]) + 1])
        trajectory = self._trajectory(np.vstack([start, states[:-1]]), sensors, stride, state)
        health = check_health(trajectory.channels["wheel_load_N"])
        if self._strict and not health.ok:
            raise UnhealthyRunError(health.advice, health=health, loads=trajectory.channels["wheel_load_N"])
        return trajectory

    def _roll(
        self, model: mujoco.MjModel, start: FloatArray, control: FloatArray, spec: int
    ) -> tuple[FloatArray, FloatArray]:
        """Return states after and sensors before each of n steps from `start` under (n, ...) controls of the kind `spec`."""
        data = self._data
        if self.terrain.kind != "rough":
            states, sensors = rollout.rollout(model, data, start[None], control[None], control_spec=spec)
            return states[0], sensors[0]
        full = mujoco.mjtState.mjSTATE_FULLPHYSICS
        states, sensors = np.empty((len(control), len(start))), np.empty((len(control), model.nsensordata))
        mujoco.mj_resetData(model, data)
        mujoco.mj_setState(model, data, start, full)
        for k, applied in enumerate(control):
            mujoco.mj_setState(model, data, applied, spec)
            self.lay_ground(data)
            mujoco.mj_step(model, data)
            mujoco.mj_getState(model, data, states[k], full)
            sensors[k] = data.sensordata
        return states, sensors

    def side_torques(self, at_wheels: FloatArray, rates: FloatArray) -> FloatArray:
        """Return the (M, 2) torques of the motors [N m] from (M, 4) actuator forces on the wheels and (M, 2) side rates."""
        return np.asarray(at_wheels[:, :2] + at_wheels[:, 2:] - motor_numbers(self.drive).braking * rates)

    def _trajectory(self, table: FloatArray, sensors: FloatArray, stride: int, state: State) -> Trajectory:
        """Return every `stride`-th of (n + 1, 1 + nq + nv) states and their sensors; yaw is unwrapped over all of them."""
        nq = self.model.nq
        yaw = np.unwrap(quat_wxyz_to_yaw(table[:, 4:8]))[::stride]
        yaw += 2.0 * math.pi * round((state.yaw - yaw[0]) / (2.0 * math.pi))
        table, sensors = table[::stride], sensors[::stride]
        qpos, qvel = table[:, 1 : 1 + nq], table[:, 1 + nq : 1 + nq + self.model.nv]
        twist = np.column_stack([rotate_world_to_body(qvel[:, :2], yaw), qvel[:, 5]])
        wheels = np.column_stack([qvel[:, dofs].mean(axis=1) for dofs in self.wheel_dofs])
        channels = {
            "wheel_load_N": sensors[:, self._load_columns],
            "torque_N_m": self.side_torques(sensors[:, self._torque_columns], wheels),
            "yaw_acceleration_rad_s2": sensors[:, self._acceleration_column],
        }
        if self.terrain.kind == "rough":
            channels["height_m"] = qpos[:, 2] - self._level_height
            channels["roll_pitch_rad"] = quat_wxyz_to_roll_pitch(qpos[:, 3:7])
        t = stride * self.dt * np.arange(len(table), dtype=np.float64)
        return Trajectory(t, np.column_stack([qpos[:, :2], yaw]), twist, wheels, channels)
