"""The robot on four tyres as a `Plant`, as a population for fits, and as bodies of closed loops."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssmr._jit import jit_alone
from ssmr.errors import DivergedError
from ssmr.models.four_wheel import (
    SAMPLE_COLUMNS,
    STATE_NUMBERS,
    FourWheelParameters,
    FourWheels,
    body_of,
    four_wheels,
    place_body,
    robot_of,
    row_of,
    run_wheels,
    write_sample,
)
from ssmr.robot.bodies import BodyPlant
from ssmr.robot.drive import step_pushes, wheel_references, whole_steps
from ssmr.robot.vehicle import Drive
from ssmr.types import ChannelColumns, Commands, FloatArray, State, Trajectory

_CHANNELS: ChannelColumns = {
    "torque_N_m": slice(8, 10),
    "yaw_acceleration_rad_s2": 10,
    "yaw_acceleration_range_rad_s2": slice(11, 13),
    "wheel_load_N": slice(13, 17),
    "force_x_N": slice(17, 21),
    "force_y_N": slice(21, 25),
}
"""Columns of channels among those of a sample, `SAMPLE_COLUMNS`."""
FOUR_WHEEL_DT = 0.001
"""Physics step [s], that of the planar models; stiff tyres divide it further."""


class FourWheelPlant(BodyPlant):
    """A robot on four tyres as a `Plant`; its reference point is the middle between the axles."""

    name = "four_wheel"
    parameters: FourWheelParameters
    """Body, tyres and motors."""
    robot: FourWheels
    """The numbers for compiled functions."""

    def __init__(
        self, parameters: FourWheelParameters, drive: Drive, dt: float = FOUR_WHEEL_DT
    ) -> None:
        """Start at rest at the origin, with physics steps `dt` [s].

        Raises:
            ValueError: the hold is no whole number of steps.
        """
        whole_steps(drive.hold, dt, "the drive's hold")
        self.dt = dt
        self.parameters = parameters
        self.drive = drive
        self.robot = four_wheels(parameters, drive, dt)

    def make_bodies(
        self, plants: Sequence[FourWheelPlant], state: State, workers: int = 1
    ) -> FourWheelBodies:
        """Return robots on four tyres in a state."""
        return FourWheelBodies(plants, state)

    def run(
        self,
        commands: Commands,
        state: State,
        sample_dt: float,
        disturbance: FloatArray | None = None,
    ) -> Trajectory:
        """Drive `commands` at once.

        Returns:
            The motion, with channels `torque_N_m` (M, 2), `yaw_acceleration_rad_s2` (M,) and its
            range between samples (M, 2), and for the wheels front left, front right, rear left,
            rear right `wheel_load_N` (M, 4) and the forces of the ground in the body's axes,
            `force_x_N` and `force_y_N` (M, 4).

        Raises:
            DivergedError: a velocity is no longer finite.
            ValueError: periods that are no whole number of steps, or disturbances that are not one
                a step.
        """
        stride = whole_steps(sample_dt, self.dt, "the sample period")
        given = commands.kind == "wheels"
        references = wheel_references(commands, self.drive, self.dt, state)
        push = step_pushes(disturbance, len(references))
        robot = self.robot._replace(given=given)
        out = np.empty((1 + len(references) // stride, SAMPLE_COLUMNS))
        body = body_of(_place_state(state, robot))
        failed = run_wheels(references, push, stride, robot, body, out)
        if failed >= 0:
            t = failed * self.dt
            raise DivergedError(
                f"{self.name}: no finite velocity after step {failed} (t = {t:.3f} s)",
                step=failed,
                t=t,
            )
        return Trajectory.of_table(sample_dt, out, _CHANNELS)


def _place_state(state: State, robot: FourWheels) -> FloatArray:
    row = np.zeros(STATE_NUMBERS)
    place_body(np.array(state.motion), robot, body_of(row))
    return row


@jit_alone
def _advance_all(
    references: FloatArray,
    pushes: FloatArray,
    robots: FloatArray,
    rows: FloatArray,
    now: FloatArray,
    failed: Any,
) -> None:
    """Advance S robots in place; write samples of starts and ends, and where robots failed.

    `now` has (S, 2, 25) samples. This is one thread's work: a period of the position loop is too
    short for threads to be worth their start.
    """
    for i in range(len(robots)):
        robot = robot_of(robots[i])
        failed[i] = run_wheels(
            references[i], pushes[i], len(references[i]), robot, body_of(rows[i]), now[i]
        )


class FourWheelBodies:
    """S robots that advance together under wheel-rate references."""

    def __init__(self, plants: Sequence[FourWheelPlant], state: State) -> None:
        """Put robots that move as `plants` do into `state`."""
        robots = [plant.robot for plant in plants]
        self._robots = np.array([row_of(robot) for robot in robots], dtype=np.float64)
        self._rows = np.array([_place_state(state, r) for r in robots])
        self._failed = np.full(len(robots), -1)
        self._now = np.zeros((len(robots), 2, SAMPLE_COLUMNS))
        for row, robot, now in zip(self._rows, robots, self._now, strict=True):
            write_sample(body_of(row), now[1], robot)

    @property
    def gave_up(self) -> NDArray[np.bool_]:
        """(S,) robots whose numbers were no longer finite in the last run."""
        return self._failed >= 0

    def states(self) -> FloatArray:
        """Return (S, 10) the fields of `ssmr.types.Motion`."""
        return np.ascontiguousarray(self._now[:, 1, :10])

    def advance(self, references: FloatArray, pushes: FloatArray) -> None:
        """Take n steps under (S, n, 2) references [rad/s], (S, n) yaw accelerations [rad/s2]."""
        _advance_all(references, pushes, self._robots, self._rows, self._now, self._failed)
