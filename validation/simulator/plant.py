"""A MuJoCo robot as a `Plant`.

A run goes chunk by chunk: the samples of each are kept and its steps are forgotten, so that hours
fit into memory. A chunk goes on from the last one's state and its solver's warm start, so
results do not depend on how long chunks are, to the bit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property

import mujoco
import numpy as np

from ssmr.geometry import (
    quat_wxyz_to_yaw,
    rotate_body_to_world,
    rotate_world_to_body,
    yaw_to_quat_wxyz,
)
from ssmr.robot.bodies import BodyPlant
from ssmr.robot.drive import motor_numbers, reference_chunks, step_pushes, whole_steps
from ssmr.robot.vehicle import Drive
from ssmr.types import ChannelColumns, CommandKind, Commands, FloatArray, State
from validation.simulator.bodies import MujocoBodies
from validation.simulator.calibration import Calibration
from validation.simulator.description import WHEELS
from validation.simulator.model import FREE_DRIVE, contact_settings, robot_model
from validation.simulator.motors import (
    GIVEN_SHARE,
    GIVEN_STEPS,
    actuator_inputs,
    lead_rates,
    rates_on_steps,
)
from validation.simulator.parts import Parts, mujoco_failures, robot_parts, rolled_out
from validation.simulator.physics import SHIPPED, PhysicsSettings, stop_the_stopwatch
from validation.simulator.resting import level_rest, solved_exactly
from validation.simulator.terrain import FLAT, Terrain

_SETTLE_CONSTANTS = 50.0
"""Time for which the robot stands before its resting height is taken, in time constants of the
contact; 1 s for a Husky."""
CHANNELS: ChannelColumns = {
    "wheel_load_N": slice(8, 12),
    "torque_N_m": slice(12, 14),
    "yaw_acceleration_rad_s2": 14,
}
"""Columns of channels among the numbers of a sample, behind those of a `State`."""
_FORCES = {"force_x_N": slice(15, 19), "force_y_N": slice(19, 23)}
CHUNK = 2000
"""Physics steps of a chunk: enough that starting one costs nothing beside them."""
_TURN = 2.0 * np.pi

stop_the_stopwatch()


class MujocoPlant(BodyPlant):
    """A calibrated robot on its ground."""

    name = "mujoco"
    _bodies: MujocoBodies
    settings: PhysicsSettings
    """Settings of the physics engine."""
    parts: Parts
    """Places of the robot's parts in the model's arrays."""

    @mujoco_failures()
    def __init__(
        self,
        calibration: Calibration,
        drive: Drive,
        *,
        terrain: Terrain = FLAT,
        settings: PhysicsSettings = SHIPPED,
    ) -> None:
        """Build the model and find out how it rests on its tyres; it stands at the origin.

        Args:
            calibration: the robot's numbers.
            drive: saturation, delays and conversions between command and wheels.
            terrain: ground.
            settings: how physics is computed, if not as shipped.

        Raises:
            ValueError: numbers that do not go together.
        """
        self.terrain = terrain
        self.settings = settings
        model = self.model = robot_model(calibration, terrain, settings, drive)
        whole_steps(drive.hold, calibration.timestep, "the drive's hold")
        self.dt = model.opt.timestep
        self.calibration = calibration
        self.drive = drive
        self.parts = robot_parts(model)
        places = [int(model.sensor(f"force_{wheel}").adr[0]) for wheel in WHEELS]
        self._forces = np.add.outer(places, range(2))
        level = None
        if terrain.level:
            level = level_rest(model, mujoco.MjData(model), calibration)
        self._resting = self._settle() if level is None else level

    @cached_property
    def yaw_inertia(self) -> float:
        """Moment of inertia of the whole robot about the vertical through its centre [kg m2]."""
        model = self.model
        data = mujoco.MjData(model)
        mass_matrix = np.zeros((model.nv, model.nv))
        data.qpos[:] = self._resting
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fullM(model, data, mass_matrix)
        base = self.parts.base
        offset = data.subtree_com[base][:2] - data.xpos[base][:2]
        return mass_matrix[5, 5] - model.body_subtreemass[base] * offset @ offset

    @cached_property
    def _prescribed(self) -> mujoco.MjModel:
        """Return the robot's model with wheels that turn at given rates, whatever the torque."""
        robot = self.calibration.robot
        armature = GIVEN_SHARE * robot.mass * robot.wheel_radius**2
        gain = 2.0 * armature / (GIVEN_STEPS * self.dt)
        heavy = replace(self.calibration, armature=armature, gain=gain, rolling_resistance=0.0)
        return robot_model(heavy, self.terrain, self.settings, FREE_DRIVE)

    def _settle(self) -> FloatArray:
        """Return the (nq,) configuration at rest at the origin, after letting the robot settle."""
        data = mujoco.MjData(self.model)
        (constant, _), _ = contact_settings(self.calibration.robot)
        with solved_exactly(self.model):
            mujoco.mj_step(self.model, data, nstep=round(_SETTLE_CONSTANTS * constant / self.dt))
        rest = np.array(data.qpos)
        rest[:2] = 0.0
        rest[7:] = 0.0
        turn_back = yaw_to_quat_wxyz(-quat_wxyz_to_yaw(rest[3:7]))
        mujoco.mju_mulQuat(rest[3:7], turn_back, data.qpos[3:7])
        return rest

    def placed(self, state: State) -> FloatArray:
        """Return the simulator's (1 + nq + nv + na) state of a robot that rests in `state`."""
        rest = self._resting.copy()
        velocity = np.zeros(self.model.nv)
        rest[:2] = state.x, state.y
        mujoco.mju_mulQuat(rest[3:7], yaw_to_quat_wxyz(state.yaw), self._resting[3:7])
        velocity[:2] = rotate_body_to_world([state.v_x, state.v_y], state.yaw)
        velocity[5] = state.yaw_rate
        for dofs, rate in zip(self.parts.sides, (state.wheel_left, state.wheel_right), strict=True):
            velocity[dofs] = rate
        return np.concatenate([[0.0], rest, velocity, np.zeros(self.model.na)])

    def make_bodies(
        self, plants: Sequence[MujocoPlant], state: State, workers: int = 1
    ) -> MujocoBodies:
        """Return robots in a state, resting on their tyres; they share `workers` threads."""
        return MujocoBodies(plants, workers, state)

    def imu(self) -> tuple[FloatArray, FloatArray]:
        """Return (3,) angular velocity [rad/s] and (3,) specific force [m/s2] at the IMU.

        Both are along its axes. The force is that under the last step's inputs; reading it changes
        nothing.
        """
        if self._driver is None:
            self.reset(State())
        model = self.model
        site = model.site("imu").id
        kind = mujoco.mjtObj.mjOBJ_SITE
        probe = self._bodies.data_of(0)
        mujoco.mj_forward(model, probe)
        mujoco.mj_rnePostConstraint(model, probe)  # bodies' accelerations
        # of both, the angular part comes first
        velocity = np.empty(6)
        acceleration = np.empty(6)
        mujoco.mj_objectVelocity(model, probe, kind, site, velocity, 1)
        mujoco.mj_objectAcceleration(model, probe, kind, site, acceleration, 1)
        return velocity[:3], acceleration[3:]

    def channels(self, kind: CommandKind) -> ChannelColumns:
        """Return the columns of channels.

        They are `wheel_load_N`, `torque_N_m` of both sides or, where wheel rates are given,
        `ground_torque_N_m`, `yaw_acceleration_rad_s2`, and `force_x_N` and `force_y_N`, the forces
        of the ground in the body's axes. Wheels are front left, front right, rear left, rear right.
        """
        columns = {**CHANNELS, **_FORCES}
        if kind == "wheels":
            columns["ground_torque_N_m"] = columns.pop("torque_N_m")
        return columns

    def run_parts(
        self, commands: Commands, state: State, sample_dt: float, disturbance: FloatArray | None
    ) -> Iterator[FloatArray]:
        """Yield the samples of parts of a run by `mujoco.rollout`, see `BodyPlant`."""
        stride = whole_steps(sample_dt, self.dt, "the sample period")
        spec = mujoco.mjtState.mjSTATE_CTRL
        if disturbance is not None:
            disturbance = step_pushes(disturbance, self._steps_of(commands))
            spec |= mujoco.mjtState.mjSTATE_QFRC_APPLIED
        model = self.model if commands.kind == "twist" else self._prescribed
        data = mujoco.MjData(model)
        now = self.placed(state)
        turns = round((state.yaw - float(quat_wxyz_to_yaw(now[4:8]))) / _TURN)
        yaw_rate = 1 + model.nq + 5
        first = 0
        with mujoco_failures():
            for control in self._inputs(commands, state, disturbance):
                after, readings = rolled_out(data, now, control, int(spec), first)
                before = np.vstack([now, after[:-1]])
                yaw = quat_wxyz_to_yaw(np.vstack([before[:, 4:8], after[-1:, 4:8]]))
                jumps = np.rint(np.diff(yaw) / _TURN).astype(np.int64)
                whole = turns - np.cumulative_sum(jumps, include_initial=True)
                # the first step of the run is a sample, and so every `stride`-th after it
                at = slice(-first % stride, len(after), stride)
                headings = yaw[:-1][at] + _TURN * whole[:-1][at]
                turned = (after[at, yaw_rate] - before[at, yaw_rate]) / model.opt.timestep
                rows = self._numbers(before[at], readings[at], headings, turned)
                if commands.kind == "wheels":
                    self._write_ground_torque(rows)
                yield rows
                now = after[-1]
                first += len(after)
                turns = int(whole[-1])

    def _write_ground_torque(self, rows: FloatArray) -> None:
        """Write the ground's torque in place of the motors', which turned the heavy wheels."""
        radius = self.calibration.wheel_radius
        difference = 0.5 * self.calibration.radius_difference
        pull = rows[:, _FORCES["force_x_N"]]
        sides = pull[:, :2] + pull[:, 2:]
        rows[:, CHANNELS["torque_N_m"]] = sides * [radius + difference, radius - difference]

    def _steps_of(self, commands: Commands) -> int:
        """Return the number of physics steps of all commands."""
        return commands.n * whole_steps(commands.dt, self.dt, "the command period")

    def _inputs(
        self, commands: Commands, state: State, disturbance: FloatArray | None
    ) -> Iterator[FloatArray]:
        """Yield the inputs of chunks of physics steps.

        These are inputs of all actuators and, with a disturbance, forces on all joints.
        There is one step more, with the last inputs but undisturbed: its sensors are those at the
        end.
        """
        steps = self._steps_of(commands)
        if commands.kind == "wheels":
            chunks = self._leading_references(commands, state)
        else:
            chunks = reference_chunks(commands, self.drive, self.dt, state, CHUNK)
        first = 0
        for chunk in chunks:
            end = first + len(chunk)
            references = chunk if end < steps else np.vstack([chunk, chunk[-1:]])
            control = actuator_inputs(self.model, references)
            if disturbance is not None:
                force = np.zeros((len(control), self.model.nv))
                force[: len(chunk), 5] = self.yaw_inertia * np.asarray(disturbance[first:end])
                control = np.hstack([control, force])
            yield control
            first = end

    def _leading_references(self, commands: Commands, state: State) -> Iterator[FloatArray]:
        """Yield the references, chunk by chunk, that give wheels the commanded rates."""
        steps = self._steps_of(commands)
        last = np.array([state.wheel_left, state.wheel_right])
        for first in range(0, steps, CHUNK):
            step = np.arange(first, min(first + CHUNK, steps))
            rates = rates_on_steps(commands, self.dt, step)
            yield lead_rates(rates, last, GIVEN_STEPS - 1.0)
            last = rates[-1]

    def _numbers(
        self, states: FloatArray, sensors: FloatArray, yaw: FloatArray, turned: FloatArray
    ) -> FloatArray:
        """Return the (m, 23) numbers of samples.

        Args:
            states: (m, 1 + nq + nv + na) time, positions and velocities before a step.
            sensors: (m, nsensordata) of the step.
            yaw: (m,) headings before the step, unwrapped from the run's start [rad].
            turned: (m,) yaw accelerations in the step [rad/s2].
        """
        nq = self.model.nq
        qvel = states[:, 1 + nq : 1 + nq + self.model.nv]
        planar = self.parts.planar(states[:, 1 : 1 + nq], qvel, yaw)
        at_wheels = sensors[:, self.parts.torques]
        braking = motor_numbers(self.drive, self.dt).braking
        torques = at_wheels[:, :2] + at_wheels[:, 2:] - braking * planar[:, 6:8]
        forces = rotate_world_to_body(sensors[:, self._forces], yaw[:, None])
        sides = np.moveaxis(forces, -1, 0)
        return np.column_stack([planar, sensors[:, self.parts.loads], torques, turned, *sides])
