"""Time stepping of the planar models: a whole run in one compiled loop, equal to its single steps.

A planar model is three states, x, y and yaw, and two velocities, v and omega. Its velocities
advance by the model's own law; its pose follows by the midpoint rule with
v_y = -(x_ICR + k v) omega (Eq. 2.2, 2.10, 2.13); k is 0 but for `kinematic`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from ssmr._jit import fused, jit, jit_alone, sine_cosine
from ssmr.errors import DivergedError
from ssmr.models.kinematic import KinematicParameters
from ssmr.models.law import PlanarRobot, advance, law_of
from ssmr.parameters import packed
from ssmr.robot.drive import (
    Driver,
    Sides,
    Wanted,
    advance_integral,
    motor_numbers,
    side_rates,
    wheel_references,
    whole_steps,
)
from ssmr.robot.vehicle import Drive, Vehicle, vehicle_body
from ssmr.types import Commands, FloatArray, State, Trajectory

PLANAR_COLUMNS = 11
"""Numbers of a sample.

They are x, y, yaw, v_x, v_y and yaw rate, the wheel rates left and right, the torques left and
right, and the yaw acceleration.
"""
PLANAR_DT = 0.001
"""Default step of the planar models [s]; Tab. 3.7."""
SAMPLE_DT = 0.008
"""Default sample period of trajectories [s]: the lab's tracking system (Tab. 3.5)."""


class PlanarMotion(NamedTuple):
    """A planar robot at one physics step, for compiled functions."""

    x: float  # world x [m]
    y: float  # world y [m]
    yaw: float  # heading, unwrapped [rad]
    v: float  # forward speed [m/s]
    w: float  # yaw rate [rad/s]
    torque_left: float = 0.0  # torque of the left side in the last step [N m]
    torque_right: float = 0.0  # torque of the right side in the last step [N m]
    integral_left: float = 0.0  # integral part of the left motor's torque [N m]
    integral_right: float = 0.0  # integral part of the right motor's torque [N m]


@jit
def move(
    now: PlanarMotion, wheels: Sides, disturbance: float, dt: float, robot: PlanarRobot
) -> PlanarMotion:
    """Advance pose and velocities by one step `dt` [s] under wheel-rate references.

    The disturbance is a yaw acceleration [rad/s2].
    """
    left = now.integral_left
    right = now.integral_right
    references = Wanted(wheels.left, wheels.right, left, right)
    v, w, torque_left, torque_right = advance(now.v, now.w, references, disturbance, dt, robot)
    half = 0.5 * dt
    # Twice the velocities in the middle of the step; ideal wheels have the new ones from its start.
    v_twice = 2.0 * v if robot.ideal else now.v + v
    w_twice = 2.0 * w if robot.ideal else now.w + w
    yaw_between = fused(0.5 * half, w_twice, now.yaw)
    s, c = sine_cosine(yaw_between)
    aside = fused(0.5 * robot.drift, v_twice, robot.x_icr) * w_twice
    # Eq. 2.13
    x_rate = fused(v_twice, c, aside * s)
    y_rate = fused(v_twice, s, -aside * c)
    if robot.motor.integral_gain > 0.0 and not robot.ideal:
        mean = side_rates(0.5 * v_twice, 0.5 * w_twice, robot.vehicle)
        left = advance_integral(left, wheels.left - mean.left, robot.motor)
        right = advance_integral(right, wheels.right - mean.right, robot.motor)
    return PlanarMotion(
        x=fused(half, x_rate, now.x),
        y=fused(half, y_rate, now.y),
        yaw=fused(half, w_twice, now.yaw),
        v=v,
        w=w,
        torque_left=torque_left,
        torque_right=torque_right,
        integral_left=left,
        integral_right=right,
    )


@jit
def sideways(v: float, w: float, robot: PlanarRobot) -> float:
    """Return the body's speed to the left [m/s] at a forward speed and a yaw rate (Eq. 2.10)."""
    ahead: float = fused(robot.drift, v, robot.x_icr)
    return -ahead * w


@jit
def turning_wheels(now: PlanarMotion, wheels: Sides, robot: PlanarRobot) -> Sides:
    """Return the wheel rates [rad/s] that follow from the motion (Eq. 2.9).

    Ideal wheels turn as their references `wheels` say.
    """
    if robot.ideal:
        return Sides(wheels.left, wheels.right)
    return side_rates(now.v, now.w, robot.vehicle)


@jit_alone
def run_planar(
    references: FloatArray,
    disturbance: FloatArray,
    dt: float,
    stride: int,
    robot: PlanarRobot,
    start: PlanarMotion,
    out: FloatArray,
) -> tuple[int, PlanarMotion]:
    """Advance a planar model over all references, writing every `stride`-th state.

    Args:
        references: (n, 2) wheel-rate references [rad/s].
        disturbance: (n,) yaw accelerations [rad/s2], or (1,) for the same at every step.
        dt: step [s].
        stride: steps between samples.
        robot: numbers of the robot; the type of its parameters chooses the model.
        start: state at the first step.
        out: (1 + n // stride, 11) samples, see `PLANAR_COLUMNS`; row 0 is the start.

    Returns:
        The first step after which a number is not finite, or -1; and where the robot is at the end.
    """
    now = start
    n = len(references)
    wheels = side_rates(now.v, now.w, robot.vehicle)
    sample = 0
    due = 0
    turn = 0.0
    for k in range(n + 1):
        if k == due:
            rates = turning_wheels(now, wheels, robot)
            row = out[sample]
            row[0] = now.x
            row[1] = now.y
            row[2] = now.yaw
            row[3] = now.v
            row[4] = sideways(now.v, now.w, robot)
            row[5] = now.w
            row[6] = rates.left
            row[7] = rates.right
            row[8] = now.torque_left
            row[9] = now.torque_right
            row[10] = turn
            sample += 1
            due += stride
        if k == n:
            break
        push = disturbance[k] if len(disturbance) > 1 else disturbance[0]
        w_before = now.w
        wheels = Sides(references[k, 0], references[k, 1])
        now = move(now, wheels, push, dt, robot)
        if not math.isfinite(now.v + now.w):
            return k, now
        turn = (now.w - w_before) / dt
    return -1, now


@lru_cache(maxsize=64)
def _body(vehicle: Vehicle) -> Any:
    """Return the `VehicleBody` of a vehicle; candidates of a fit often share theirs."""
    return vehicle_body(packed(vehicle))


@dataclass(frozen=True)
class PlanarModel:
    """A planar model with all its numbers: everything that defines the plant, and no state."""

    parameters: Any
    """Parameter set of a planar model; its type says which model it is."""
    vehicle: Vehicle
    """Mass and geometry."""
    drive: Drive
    """Saturation, delays and conversions between command and wheels."""

    @property
    def name(self) -> str:
        """Name of the model."""
        return law_of(self.parameters).name

    def packed(self, dt: float) -> PlanarRobot:
        """Return the numbers for compiled functions and physics steps `dt` [s]."""
        law = law_of(self.parameters)
        body = _body(self.vehicle)
        parameters = packed(self.parameters)
        return PlanarRobot(
            vehicle=body,
            parameters=parameters,
            motor=motor_numbers(self.drive, dt),
            x_icr=float(law.rotation_centre(self.vehicle, self.parameters)),
            drift=float(law.drift(self.parameters)),
            ideal=law.ideal,
            constants=law.constants(body, parameters, dt),
        )

    def prescribed(self) -> PlanarModel:
        """Return the model for given wheel rates, which the wheels keep whatever torque that takes.

        No planar model has longitudinal slip, so only the kinematics of a dynamic model remain,
        Eq. 2.9 and 2.10, with a radius for each side.
        """
        law = law_of(self.parameters)
        if law.ideal:
            return self
        vehicle = self.vehicle
        c_eff = vehicle.effective_half_track
        x_icr = law.rotation_centre(vehicle, self.parameters)
        uneven = 0.5 * vehicle.radius_difference / vehicle.wheel_radius
        kinematics = KinematicParameters(1.0 + uneven, 1.0 - uneven, x_icr, c_eff, -c_eff)
        return replace(self, parameters=kinematics)


class PlanarPlant:
    """A planar model as a `Plant`."""

    name: str
    """Name of the model."""
    dt: float
    """Physics step [s]."""

    def __init__(self, model: PlanarModel, dt: float = PLANAR_DT) -> None:
        """Start at rest at the origin, with physics steps `dt` [s].

        Raises:
            ValueError: the drive's hold is no whole number of steps.
        """
        whole_steps(model.drive.hold, dt, "the drive's hold")
        self.name = model.name
        self.dt = dt
        self._model = model
        self._robot = model.packed(dt)
        self.reset(State())

    def _advance(
        self,
        references: FloatArray,
        disturbance: FloatArray,
        stride: int,
        start: PlanarMotion,
        robot: PlanarRobot,
    ) -> tuple[FloatArray, PlanarMotion]:
        out = np.empty((1 + len(references) // stride, PLANAR_COLUMNS))
        failed, end = run_planar(
            references, disturbance, dt=self.dt, stride=stride, robot=robot, start=start, out=out
        )
        if failed >= 0:
            t = failed * self.dt
            message = f"{self.name}: no finite velocity after step {failed} (t = {t:.3f} s)"
            raise DivergedError(message, step=failed, t=t)
        return out, PlanarMotion(*end)

    def reset(self, state: State) -> State:
        """Start from `state` with empty delay lines.

        v_y and the wheel rates follow from v_x and the yaw rate.
        """
        self._driver = Driver(self._model.drive, self.dt, state)
        self._now = _motion(state)
        out, _ = self._advance(np.empty((0, 2)), np.zeros(1), 1, self._now, self._robot)
        return State(*map(float, out[0, :8]))

    def step(self, command: tuple[float, float], dt: float, yaw_acceleration: float = 0.0) -> State:
        """Hold a twist command for `dt` [s]."""
        n = whole_steps(dt, self.dt, "the step")
        references = self._driver.references(command, n)
        push = np.array([float(yaw_acceleration)])
        out, self._now = self._advance(references, push, n, self._now, self._robot)
        return State(*map(float, out[-1, :8]))

    def run(
        self,
        commands: Commands,
        state: State,
        sample_dt: float,
        disturbance: FloatArray | None = None,
    ) -> Trajectory:
        """Drive `commands` at once; channels are the sides' torques and the yaw acceleration."""
        stride = whole_steps(sample_dt, self.dt, "the sample period")
        references = wheel_references(commands, self._model.drive, self.dt, state)
        push = np.zeros(1)
        if disturbance is not None:
            push = np.ascontiguousarray(disturbance, dtype=np.float64)
            if len(push) != len(references):
                raise ValueError(f"{len(push)} disturbances for {len(references)} physics steps")
        robot = self._robot
        if commands.kind == "wheels":
            robot = self._model.prescribed().packed(self.dt)
        out, _ = self._advance(references, push, stride, _motion(state), robot)
        channels = {"torque_N_m": out[:, 8:10], "yaw_acceleration_rad_s2": out[:, 10]}
        t = sample_dt * np.arange(len(out), dtype=np.float64)
        return Trajectory(t, out[:, :3], out[:, 3:6], out[:, 6:8], channels)


def _motion(state: State) -> PlanarMotion:
    """Motion of a robot that begins in a state, with no torque."""
    numbers = (state.x, state.y, state.yaw, state.v_x, state.yaw_rate)
    return PlanarMotion(*map(float, numbers))
