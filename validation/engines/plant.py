"""A robot in another engine as a `Plant`: driver, motors and sampling as in all plants."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from ssmr.errors import DivergedError, ParameterError
from ssmr.geometry import yaw_to_quat_wxyz
from ssmr.robot.bodies import BodyPlant
from ssmr.robot.drive import (
    advance_integral,
    motor_numbers,
    side_torque,
    step_pushes,
    wheel_references,
    whole_steps,
)
from ssmr.robot.vehicle import Drive
from ssmr.types import Commands, FloatArray, State, Trajectory
from validation.engines.body import MakeBody, Rigid
from validation.simulator.calibration import Calibration
from validation.simulator.description import GRAVITY, WHEELS
from validation.simulator.plant import CHANNELS
from validation.simulator.terrain import FLAT, Terrain

_MOST_GAIN = 1.0
"""Greatest gain of a side's speed loop times the step over the inertia that spins with the side's
wheels [1]: motors act on the rates at the start of a step, and a loop that is faster would
swing."""
_SETTLE_TIME = 1.0
"""Time for which the robot stands before its resting height is taken [s]."""
_TURN = 2.0 * math.pi
_YAW_RATE = 5
"""Place of the yaw rate among the fields of a motion."""


class _EngineRobot:
    """One robot inside an engine, with its motors; a side's torque is `ssmr.robot.drive`'s."""

    def __init__(self, plant: EnginePlant) -> None:
        """Build the robot of a plant and let it come to rest at the origin."""
        calibration = plant.calibration
        self._plant = plant
        self._motor = motor_numbers(plant.drive, plant.dt)
        dry = 0.5 * (calibration.rolling_torque + plant.drive.gear_loss)
        self._body = plant.make(calibration, plant.terrain.gravity(GRAVITY), dry)
        self._body.place(Rigid.at_rest(calibration.base_height))
        for _ in range(round(_SETTLE_TIME / plant.dt)):
            self._body.advance_turning(np.zeros(len(WHEELS)), 0.0)
        rest = self._body.motion()
        self._rest_loads = self._body.wheel_loads()
        turned = yaw_to_quat_wxyz(-_heading_of(rest.quat_wxyz))
        self._height = float(rest.position[2])
        self._attitude = _quaternion_product(turned, rest.quat_wxyz)

    def place(self, state: State) -> None:
        """Put the robot into a state, at rest on its tyres, without memory."""
        c = math.cos(state.yaw)
        s = math.sin(state.yaw)
        velocity = np.array([c * state.v_x - s * state.v_y, s * state.v_x + c * state.v_y, 0.0])
        wheels = np.tile([state.wheel_left, state.wheel_right], 2)
        spin = np.array([0.0, 0.0, state.yaw_rate])
        quat = _quaternion_product(yaw_to_quat_wxyz(state.yaw), self._attitude)
        place = np.array([state.x, state.y, self._height])
        self._body.place(Rigid(place, quat, velocity, spin, wheels))
        self._integrals = [0.0] * len(self._plant.groups)
        self._torques = np.zeros(len(WHEELS))
        self._spun = 0.0
        self._loads = self._rest_loads
        self._yaw = state.yaw
        self._read()

    def _read(self) -> None:
        """Take over where the robot is now; yaw is unwrapped from the last step."""
        now = self._body.motion()
        yaw = _heading_of(now.quat_wxyz)
        self._yaw = yaw + _TURN * round((self._yaw - yaw) / _TURN)
        x, y = now.velocity[:2]
        c = math.cos(self._yaw)
        s = math.sin(self._yaw)
        self._rates = now.wheels
        place = now.position[:2].tolist()
        twist = [float(c * x + s * y), float(c * y - s * x), float(now.spin[2])]
        sides = now.wheels.reshape(2, 2).mean(axis=0).tolist()
        self._now = [*place, self._yaw, *twist, *sides]

    def advance(self, wheel_rates: FloatArray, push: float, prescribed: bool = False) -> bool:
        """Take a physics step; return whether the state is still finite.

        Motors turn the wheels towards (2,) rates [rad/s], which they have at once where these are
        `prescribed`; `push` is a yaw acceleration [rad/s2].
        """
        before = self._now[_YAW_RATE]
        yaw_torque = self._plant.calibration.yaw_inertia * push
        if prescribed:
            self._body.advance_turning(np.tile(wheel_rates, 2), yaw_torque)
            self._read()
        else:
            self._advance_by_motors(wheel_rates, yaw_torque)
        self._spun = (self._now[_YAW_RATE] - before) / self._plant.dt
        return math.isfinite(sum(self._now[:6]))

    def _advance_by_motors(self, wheel_rates: FloatArray, yaw_torque: float) -> None:
        gain = self._plant.calibration.gain
        groups = self._plant.groups
        errors = []
        for wheels, integral in zip(groups, self._integrals, strict=True):
            set_point = float(wheel_rates[wheels[0] % 2])
            rate = float(self._rates[wheels].mean())
            errors.append(set_point - rate)
            torque = side_torque(set_point, rate, integral, gain, self._motor)
            self._torques[wheels] = 0.5 * torque
        self._body.advance(self._torques, yaw_torque)
        self._read()
        if self._motor.integral_gain > 0.0:
            for k, error in enumerate(errors):
                self._integrals[k] = advance_integral(self._integrals[k], error, self._motor)

    def motion(self) -> list[float]:
        """Return the ten fields of `ssmr.types.Motion`."""
        return [*self._now, *self._torques.reshape(2, 2).sum(axis=0)]

    def sample(self) -> list[float]:
        """Return the numbers of a sample, see `CHANNELS`; the loads are those of the last step."""
        motion = self.motion()
        return [*motion[:8], *self._loads, *motion[8:], self._spun]

    def weigh(self) -> None:
        """Take over the loads of the wheels in the last step."""
        self._loads = self._body.wheel_loads()


class _EngineBodies:
    """Robots in an engine that advance one after another."""

    def __init__(self, robots: Sequence[_EngineRobot], state: State) -> None:
        """Put the robots into a state."""
        self._robots = robots
        self._finite = np.ones(len(robots), dtype=np.bool_)
        for robot in robots:
            robot.place(state)

    @property
    def gave_up(self) -> NDArray[np.bool_]:
        """(S,) robots that left the finite numbers."""
        return ~self._finite

    def states(self) -> FloatArray:
        """Return (S, 10) the fields of `ssmr.types.Motion`."""
        return np.array([robot.motion() for robot in self._robots])

    def advance(self, references: FloatArray, pushes: FloatArray) -> None:
        """Take the robots through n physics steps, see `Bodies.advance`."""
        for i, robot in enumerate(self._robots):
            for rates, push in zip(references[i], pushes[i], strict=True):
                if self._finite[i]:
                    self._finite[i] = robot.advance(rates, float(push))


class EnginePlant(BodyPlant):
    """A calibrated robot in an engine."""

    def __init__(
        self,
        name: str,
        make: MakeBody,
        calibration: Calibration,
        drive: Drive,
        terrain: Terrain = FLAT,
    ) -> None:
        """Build the robot and let it come to rest; it stands at the origin.

        Args:
            name: name of the plant.
            make: function that builds the robot inside the engine.
            calibration: the robot's numbers.
            drive: saturation, delays and conversions between command and wheels.
            terrain: level ground or a ramp.

        Raises:
            EngineMissingError: the engine is not installed.
            ParameterError: numbers that do not go together, or that the engine cannot have, such
                as a friction that depends on direction.
        """
        self.name = name
        self.dt = calibration.timestep
        self.drive = drive
        self.calibration = calibration
        self.make = make
        self.terrain = terrain
        self.groups = calibration.robot.motor_groups
        whole_steps(drive.hold, self.dt, "the drive's hold")
        if calibration.friction_ratio != 1.0:
            raise ParameterError(
                f"friction_ratio {calibration.friction_ratio:g}: tyres have one friction in "
                f"{name}, and two only in mujoco, which alone can drive these numbers"
            )
        inertia = 2.0 * (calibration.armature + calibration.robot.wheel_inertia[1])
        longest = _MOST_GAIN * inertia / calibration.gain if calibration.gain > 0.0 else math.inf
        if calibration.gain * self.dt > _MOST_GAIN * inertia:
            raise ParameterError(
                f"timestep {self.dt:g} s is too long for a gain of {calibration.gain:g} N m s/rad "
                f"on wheels of {inertia:.3g} kg m2 a side: {name} needs at most {longest:.2g} s"
            )
        self._robot = _EngineRobot(self)

    def make_bodies(
        self, plants: Sequence[EnginePlant], state: State, workers: int = 1
    ) -> _EngineBodies:
        """Return robots in a state; the first is the one that stands here, the others are new."""
        others = [_EngineRobot(plant) for plant in plants[1:]]
        return _EngineBodies([plants[0]._robot, *others], state)

    def run(
        self,
        commands: Commands,
        state: State,
        sample_dt: float,
        disturbance: FloatArray | None = None,
    ) -> Trajectory:
        """Drive `commands` at once.

        Returns:
            The motion, with channels `wheel_load_N` (M, 4; front left, front right, rear left, rear
            right), `torque_N_m` (M, 2; 0 where wheel rates are given) and
            `yaw_acceleration_rad_s2` (M,), each of the step that ends at the sample.

        Raises:
            DivergedError: the engine left the finite numbers.
        """
        stride = whole_steps(sample_dt, self.dt, "the sample period")
        references = wheel_references(commands, self.drive, self.dt, state)
        push = np.resize(step_pushes(disturbance, len(references)), len(references))
        robot = self._robot
        robot.place(state)
        rows = [robot.sample()]
        prescribed = commands.kind == "wheels"
        for k, rates in enumerate(references):
            if not robot.advance(rates, float(push[k]), prescribed):
                raise DivergedError(f"{self.name} gave up: no finite state", step=k)
            if (k + 1) % stride == 0:
                robot.weigh()
                rows.append(robot.sample())
        return Trajectory.of_table(sample_dt, np.array(rows), CHANNELS)


def _heading_of(quat: FloatArray) -> float:
    """Return the heading of a rotation [rad], which need not be of length 1."""
    w, x, y, z = map(float, quat)
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def _quaternion_product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the (4,) product of two rotations, w first: b, then a."""
    product = np.empty(4)
    mujoco.mju_mulQuat(product, a, b)
    return product
