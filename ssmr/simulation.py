"""Time stepping of the planar models: a whole run in one compiled loop, equal to its single steps.

A planar model is three states, x, y and yaw, and two velocities, v and omega. Its velocities
advance by the model's own law; its pose follows by the midpoint rule with
v_y = -(x_ICR + k v) omega (Eq. 2.2, 2.10, 2.13); k is 0 but for `kinematic`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssmr._jit import jit, jit_alone, multiply_add, sine_cosine, write_numbers
from ssmr.errors import DivergedError
from ssmr.models.kinematic import KinematicParameters
from ssmr.models.law import PlanarRobot, advance, law_of
from ssmr.parameters import pack_numbers
from ssmr.robot.bodies import BodyPlant
from ssmr.robot.drive import (
    Sides,
    advance_integral,
    motor_numbers,
    reference_chunks,
    side_rates,
    step_pushes,
    whole_steps,
)
from ssmr.robot.vehicle import Drive, Vehicle, vehicle_body
from ssmr.types import ChannelColumns, CommandKind, Commands, FloatArray, Motion, State

PLANAR_COLUMNS = 11
"""Numbers of a sample.

They are x, y, yaw, v_x, v_y and yaw rate, the wheel rates left and right, the torques left and
right, and the yaw acceleration.
"""
_Moving = tuple[Motion, Sides]
"""A motion, and the integral parts of the motors' torques [N m]."""
_CHANNELS: ChannelColumns = {
    "torque_N_m": slice(8, 10),
    "yaw_acceleration_rad_s2": 10,
}
_AT_ONCE = 1 << 18
"""Steps whose references are held at once, at least: those of a log of hours would fill the
memory."""
PLANAR_DT = 0.001
"""Default step of the planar models [s]; Tab. 3.7."""
SAMPLE_DT = 0.008
"""Default sample period of trajectories [s]: the lab's tracking system (Tab. 3.5)."""


@jit
def move_robot(
    now: Motion, integral: Sides, wheels: Sides, disturbance: float, robot: PlanarRobot
) -> _Moving:
    """Return the motion and the integral parts of the motors' torques [N m] after a step.

    The motors follow the wheel-rate references `wheels`; the disturbance is a yaw acceleration
    [rad/s2].
    """
    v, w, torque = advance(now.v, now.w, wheels, integral, disturbance, robot)
    half = 0.5 * robot.dt
    # Twice the velocities in the middle of the step; ideal wheels have the new ones from its start.
    v_twice = 2.0 * v if robot.ideal else now.v + v
    w_twice = 2.0 * w if robot.ideal else now.w + w
    yaw_between = multiply_add(0.5 * half, w_twice, now.yaw)
    s, c = sine_cosine(yaw_between)
    aside = multiply_add(0.5 * robot.drift, v_twice, robot.x_icr) * w_twice
    # Eq. 2.13
    x_rate = multiply_add(v_twice, c, aside * s)
    y_rate = multiply_add(v_twice, s, -aside * c)
    if robot.motor.integral_gain > 0.0 and not robot.ideal:
        mean = side_rates(0.5 * v_twice, 0.5 * w_twice, robot.vehicle)
        left = advance_integral(integral.left, wheels.left - mean.left, robot.motor)
        right = advance_integral(integral.right, wheels.right - mean.right, robot.motor)
        integral = Sides(left, right)
    # Eq. 2.9; ideal wheels turn as their references say
    rates = wheels if robot.ideal else side_rates(v, w, robot.vehicle)
    moved = Motion(
        x=multiply_add(half, x_rate, now.x),
        y=multiply_add(half, y_rate, now.y),
        yaw=multiply_add(half, w_twice, now.yaw),
        v=v,
        v_y=_sideways_speed(v, w, robot.x_icr, robot.drift),
        w=w,
        left=rates.left,
        right=rates.right,
        torque_left=torque.left,
        torque_right=torque.right,
    )
    return moved, integral


@jit
def _sideways_speed(v: float, w: float, x_icr: float, drift: float) -> float:
    """Return the body's speed to the left [m/s] at a forward speed and a yaw rate (Eq. 2.10)."""
    ahead: float = multiply_add(drift, v, x_icr)
    return -ahead * w


@jit_alone
def run_planar(
    references: FloatArray,
    disturbance: FloatArray,
    stride: int,
    robot: PlanarRobot,
    start: _Moving,
    out: FloatArray,
) -> tuple[int, _Moving]:
    """Advance a planar model over all references, writing every `stride`-th state.

    Args:
        references: (n, 2) wheel-rate references [rad/s].
        disturbance: (n,) yaw accelerations [rad/s2], or (1,) for the same at every step.
        stride: steps between samples.
        robot: numbers of the robot; the type of its parameters chooses the model.
        start: motion at the first step, and the integral parts of the motors' torques [N m].
        out: (1 + n // stride, 11) samples, see `PLANAR_COLUMNS`; row 0 is the start.

    Returns:
        The first step after which a number is not finite, or -1; and where the robot is at the end.
    """
    now, integral = start
    n = len(references)
    sample = 0
    due = 0
    turn = 0.0
    for k in range(n + 1):
        if k == due:
            write_numbers(out[sample], 0, 1, now)
            out[sample, len(now)] = turn
            sample += 1
            due += stride
        if k == n:
            break
        push = disturbance[k] if len(disturbance) > 1 else disturbance[0]
        w_before = now.w
        wheels = Sides(references[k, 0], references[k, 1])
        now, integral = move_robot(now, integral, wheels, push, robot)
        if not math.isfinite(now.v + now.w):
            return k, (now, integral)
        turn = (now.w - w_before) / robot.dt
    return -1, (now, integral)


def _planar_start(state: Motion, robot: PlanarRobot) -> _Moving:
    """Return the start of a planar robot in a state, see `start_of`."""
    return start_of(state, robot.vehicle, robot.x_icr, robot.drift, robot.ideal)


@jit_alone
def start_of(state: Motion, body: Any, x_icr: float, drift: float, ideal: bool) -> _Moving:
    """Return the start in a state of a robot whose motors give no torque.

    v_y follows from v and omega, and so do the wheel rates, but for ideal wheels. Numbers of a law
    are no arguments, so that this is compiled once for all models.
    """
    rates = Sides(state.left, state.right)
    if not ideal:
        rates = side_rates(state.v, state.w, body)
    start = Motion(
        state.x,
        state.y,
        state.yaw,
        state.v,
        v_y=_sideways_speed(state.v, state.w, x_icr, drift),
        w=state.w,
        left=rates.left,
        right=rates.right,
        torque_left=0.0,
        torque_right=0.0,
    )
    return start, Sides(0.0, 0.0)


@lru_cache(maxsize=64)
def _vehicle_body(vehicle: Vehicle) -> Any:
    """Return the `VehicleBody` of a vehicle; candidates of a fit often share theirs."""
    return vehicle_body(pack_numbers(vehicle))


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
        body = _vehicle_body(self.vehicle)
        parameters = pack_numbers(self.parameters)
        return PlanarRobot(
            vehicle=body,
            parameters=parameters,
            motor=motor_numbers(self.drive, dt),
            x_icr=float(law.rotation_centre(self.vehicle, self.parameters)),
            drift=float(law.drift(self.parameters)),
            ideal=law.ideal,
            dt=dt,
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


class PlanarBodies:
    """Planar robots of any models that are moved together."""

    def __init__(self, models: Sequence[PlanarModel], state: State, dt: float) -> None:
        """Place every robot in `state`; `dt` is the physics step [s]."""
        self._robots = [model.packed(dt) for model in models]
        self._now = [_planar_start(state.motion, robot) for robot in self._robots]
        self._failed = np.full(len(models), -1)

    @property
    def gave_up(self) -> NDArray[np.bool_]:
        """(S,) robots whose numbers were no longer finite when they last advanced."""
        return self._failed >= 0

    def states(self) -> FloatArray:
        """Return (S, 10) the fields of `ssmr.types.Motion`."""
        return np.array([now for now, _ in self._now])

    def advance(self, references: FloatArray, pushes: FloatArray) -> None:
        """Take the robots through n physics steps, see `Bodies.advance`."""
        n = references.shape[1]
        out = np.empty((2, PLANAR_COLUMNS))
        for i, robot in enumerate(self._robots):
            self._failed[i], self._now[i] = run_planar(
                references[i],
                pushes[i],
                stride=n,
                robot=robot,
                start=self._now[i],
                out=out,
            )


class PlanarPlant(BodyPlant):
    """A planar model as a `Plant`."""

    def __init__(self, model: PlanarModel, dt: float = PLANAR_DT) -> None:
        """Start at rest at the origin, with physics steps `dt` [s].

        Raises:
            ValueError: the drive's hold is no whole number of steps.
        """
        whole_steps(model.drive.hold, dt, "the drive's hold")
        self.name = model.name
        self.dt = dt
        self.drive = model.drive
        self.model = model

    def make_bodies(
        self, plants: Sequence[PlanarPlant], state: State, workers: int = 1
    ) -> PlanarBodies:
        """Return planar robots in a state, whose v_y follows from v_x and the yaw rate.

        So do their wheel rates, but for ideal wheels, which turn as the state says.
        """
        return PlanarBodies([plant.model for plant in plants], state, self.dt)

    def channels(self, kind: CommandKind) -> ChannelColumns:
        """Return the columns of the sides' torques and of the yaw acceleration."""
        return _CHANNELS

    def run_parts(
        self, commands: Commands, state: State, sample_dt: float, disturbance: FloatArray | None
    ) -> Iterator[FloatArray]:
        """Yield the samples of parts of a run, see `BodyPlant`."""
        stride = whole_steps(sample_dt, self.dt, "the sample period")
        steps = commands.n * whole_steps(commands.dt, self.dt, "the command period")
        push = step_pushes(disturbance, steps)
        model = self.model.prescribed() if commands.kind == "wheels" else self.model
        robot = model.packed(self.dt)
        now = _planar_start(state.motion, robot)
        size = stride * math.ceil(_AT_ONCE / stride)
        chunks = reference_chunks(commands, self.drive, self.dt, state, size)
        for first, references in zip(range(0, steps, size), chunks, strict=True):
            pushes = push[first : first + size] if len(push) > 1 else push
            out = np.empty((1 + len(references) // stride, PLANAR_COLUMNS))
            failed, now = run_planar(
                references, pushes, stride=stride, robot=robot, start=now, out=out
            )
            if failed >= 0:
                step = first + failed
                t = step * self.dt
                message = f"{self.name}: no finite velocity after step {step} (t = {t:.3f} s)"
                raise DivergedError(message, step=step, t=t)
            # the part before has its last sample, and knows how it turned there
            yield out[1:] if first else out
