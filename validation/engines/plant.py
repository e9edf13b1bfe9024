"""A robot in another engine as a `Plant`: driver, motors and sampling as in all plants."""

from __future__ import annotations

import math
from dataclasses import astuple

import mujoco
import numpy as np

from ssmr.errors import DivergedError, ParameterError
from ssmr.geometry import yaw_to_quat_wxyz
from ssmr.robot.drive import (
    Driver,
    Sides,
    advance_integral,
    motor_numbers,
    side_torque,
    step_pushes,
    wheel_references,
    whole_steps,
)
from ssmr.robot.vehicle import Drive
from ssmr.types import Commands, FloatArray, State, Trajectory
from validation.engines.body import EngineBody, MakeBody, Rigid
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


class EnginePlant:
    """A calibrated robot in an engine; a side's torque is `ssmr.robot.drive`'s, half a wheel."""

    def __init__(
        self,
        name: str,
        make: MakeBody,
        calibration: Calibration,
        drive: Drive,
        terrain: Terrain = FLAT,
    ) -> None:
        """Build the robot and find out how it rests; it stands at the origin.

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
        whole_steps(drive.hold, self.dt, "the drive's hold")
        if calibration.friction_ratio != 1.0:
            raise ParameterError(
                f"friction_ratio {calibration.friction_ratio:g}: this engine's tyres have one "
                "friction"
            )
        self._groups = calibration.robot.motor_groups
        self._motor = motor_numbers(drive, self.dt)
        inertia = 2.0 * (calibration.armature + calibration.robot.wheel_inertia[1])
        longest = _MOST_GAIN * inertia / calibration.gain if calibration.gain > 0.0 else math.inf
        if calibration.gain * self.dt > _MOST_GAIN * inertia:
            raise ParameterError(
                f"timestep {self.dt:g} s is too long for a gain of {calibration.gain:g} N m s/rad "
                f"on wheels of {inertia:.3g} kg m2 a side: {name} needs at most {longest:.2g} s"
            )
        dry = 0.5 * (calibration.rolling_torque + drive.gear_loss)
        self._body: EngineBody = make(calibration, terrain.gravity(GRAVITY), dry)
        self._rest = self._settle()
        self.reset(State())

    def _settle(self) -> tuple[float, FloatArray]:
        """Return the height and the (4,) attitude of the robot at rest, facing along x."""
        self._body.place(Rigid.at_rest(self.calibration.base_height))
        for _ in range(round(_SETTLE_TIME / self.dt)):
            self._body.advance_turning(np.zeros(len(WHEELS)), 0.0)
        rest = self._body.motion()
        self._rest_loads = self._body.wheel_loads()
        turned = yaw_to_quat_wxyz(-_yaw(rest.quat_wxyz))
        return float(rest.position[2]), _product(turned, rest.quat_wxyz)

    def reset(self, state: State) -> State:
        """Start from `state`, at rest on its tyres, with empty delay lines and no memory."""
        self._driver = Driver(self.drive, self.dt, state)
        height, attitude = self._rest
        c = math.cos(state.yaw)
        s = math.sin(state.yaw)
        velocity = np.array([c * state.v_x - s * state.v_y, s * state.v_x + c * state.v_y, 0.0])
        wheels = np.tile([state.wheel_left, state.wheel_right], 2)
        spin = np.array([0.0, 0.0, state.yaw_rate])
        quat = _product(yaw_to_quat_wxyz(state.yaw), attitude)
        self._body.place(Rigid(np.array([state.x, state.y, height]), quat, velocity, spin, wheels))
        self._integrals = [0.0] * len(self._groups)
        self._torques = np.zeros(len(WHEELS))
        self._spun = 0.0
        self._loads = self._rest_loads
        self._yaw = state.yaw
        self._read()
        return self._state

    def _read(self) -> None:
        """Take over where the robot is now; yaw is unwrapped from the last step."""
        now = self._body.motion()
        yaw = _yaw(now.quat_wxyz)
        self._yaw = yaw + _TURN * round((self._yaw - yaw) / _TURN)
        x, y = now.velocity[:2]
        c = math.cos(self._yaw)
        s = math.sin(self._yaw)
        self._rates = now.wheels
        place = now.position[:2].tolist()
        twist = [float(c * x + s * y), float(c * y - s * x), float(now.spin[2])]
        sides = now.wheels.reshape(2, 2).mean(axis=0).tolist()
        self._state = State(*[*place, self._yaw, *twist, *sides])

    def _advance(self, wheel_rates: Sides, push: float, prescribed: bool) -> None:
        """Take a physics step towards wheel rates [rad/s] under a yaw acceleration [rad/s2]."""
        before = self._state
        yaw_torque = self.calibration.yaw_inertia * push
        if prescribed:
            self._body.advance_turning(np.tile(wheel_rates, 2), yaw_torque)
            self._read()
        else:
            self._advance_by_motors(wheel_rates, yaw_torque)
        self._spun = (self._state.yaw_rate - before.yaw_rate) / self.dt
        now = self._state
        if not math.isfinite(now.x + now.y + now.v_x + now.v_y + now.yaw_rate):
            raise DivergedError(f"{self.name} gave up: no finite state", state=before)

    def _advance_by_motors(self, wheel_rates: Sides, yaw_torque: float) -> None:
        gain = self.calibration.gain
        errors = []
        for wheels, integral in zip(self._groups, self._integrals, strict=True):
            set_point = wheel_rates[wheels[0] % 2]
            rate = float(self._rates[wheels].mean())
            errors.append(set_point - rate)
            torque = side_torque(set_point, rate, integral, gain, self._motor)
            self._torques[wheels] = 0.5 * torque
        self._body.advance(self._torques, yaw_torque)
        self._read()
        if self._motor.integral_gain > 0.0:
            for k, error in enumerate(errors):
                self._integrals[k] = advance_integral(self._integrals[k], error, self._motor)

    def step(self, command: tuple[float, float], dt: float, yaw_acceleration: float = 0.0) -> State:
        """Hold a twist command for `dt` [s].

        Raises:
            DivergedError: the engine left the finite numbers.
        """
        steps = whole_steps(dt, self.dt, "the step")
        for left, right in self._driver.references(command, steps):
            self._advance(Sides(float(left), float(right)), yaw_acceleration, False)
        return self._state

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
        self.reset(state)
        rows = [self._row()]
        prescribed = commands.kind == "wheels"
        for k, (left, right) in enumerate(references):
            self._advance(Sides(float(left), float(right)), float(push[k]), prescribed)
            if (k + 1) % stride == 0:
                self._loads = self._body.wheel_loads()
                rows.append(self._row())
        return Trajectory.of_table(sample_dt, np.array(rows), CHANNELS)

    def _row(self) -> list[float]:
        sides = self._torques.reshape(2, 2).sum(axis=0)
        return [*astuple(self._state), *self._loads, *sides, self._spun]


def _yaw(quat: FloatArray) -> float:
    """Return the heading of a rotation [rad], which need not be of length 1."""
    w, x, y, z = map(float, quat)
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the (4,) product of two rotations, w first: b, then a."""
    product = np.empty(4)
    mujoco.mju_mulQuat(product, a, b)
    return product
