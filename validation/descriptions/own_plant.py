"""A robot of others as a `Plant`: its own physics and servos behind our driver."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from ssmr.errors import DivergedError, ParameterError
from ssmr.geometry import rotate_body_to_world, wrap_angle, yaw_to_quat_wxyz
from ssmr.parameters import check_parameters, parameter
from ssmr.robot.bodies import BodyPlant
from ssmr.robot.drive import wheel_references, whole_steps
from ssmr.robot.vehicle import Drive
from ssmr.types import Commands, FloatArray, Motion, State, Trajectory
from validation.descriptions.own_robot import OwnRobot
from validation.simulator.motors import rates_on_steps
from validation.simulator.parts import mujoco_failures
from validation.simulator.terrain import FLAT, Terrain

_YAW = Motion._fields.index("yaw")
_SAMPLE = 0.01
"""Period that the physics step divides [s]: of samples, commands and logs it is a part."""


@dataclass(frozen=True)
class OwnNumbers:
    """Numbers of a robot of others that a fit may move, against those of its file."""

    friction: float = parameter(
        1.0, unit="1", low=0.0, high=50.0, open_low=True, search=(0.2, 5.0), scale="log"
    )
    """Friction of tyres and ground over the file's [1]."""
    rolling: float = parameter(1.0, unit="1", low=0.1, high=10.0, search=(0.85, 1.15))
    """Rolling radius of the wheels over the file's [1]: wheels turn that much faster than told."""
    com_x: float = parameter(
        0.0, unit="m", low=-10.0, high=10.0, search=(-0.59, 0.59), of="half_wheelbase"
    )
    """How far the base's centre of mass is ahead of where the file has it [m]."""
    com_y: float = parameter(
        0.0, unit="m", low=-10.0, high=10.0, search=(-0.53, 0.53), of="half_track"
    )
    """How far the base's centre of mass is to the left of where the file has it [m]."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_parameters(self)


class _OwnBodies:
    """Robots of others that advance one after another."""

    def __init__(self, plants: Sequence[OwnPlant], state: State) -> None:
        """Put the robots into a state."""
        self._plants = plants
        self._now = [plant.place(state) for plant in plants]
        self._motions = np.tile(np.array(state.motion), (len(plants), 1))
        self._failed = np.zeros(len(plants), dtype=np.bool_)

    @property
    def gave_up(self) -> NDArray[np.bool_]:
        """(S,) robots of which the simulator gave up."""
        return self._failed

    def states(self) -> FloatArray:
        """Return (S, 10) the fields of `ssmr.types.Motion`; torques are not told, and so 0."""
        return self._motions.copy()

    def advance(self, references: FloatArray, pushes: FloatArray) -> None:
        """Take the robots through n physics steps, see `Bodies.advance`."""
        for i, plant in enumerate(self._plants):
            if self._failed[i]:
                continue
            yaw = self._motions[i, _YAW]
            try:
                self._now[i], motion = plant.advance(self._now[i], references[i], pushes[i])
            except DivergedError:
                self._failed[i] = True
                continue
            self._motions[i] = motion
            # goes on from the last one
            self._motions[i, _YAW] = yaw + wrap_angle(motion.yaw - yaw)


class OwnPlant(BodyPlant):
    """An MJCF of others that is driven by commands or by wheel rates."""

    @mujoco_failures()
    def __init__(
        self,
        name: str,
        content: tuple[str, Mapping[str, bytes]],
        numbers: OwnNumbers,
        drive: Drive,
        terrain: Terrain = FLAT,
    ) -> None:
        """Build the robot and let it come to rest.

        Args:
            name: name of the plant.
            content: the MJCF, with all that it includes, and its other files by name.
            numbers: what differs from the file.
            drive: saturation, delays and conversions between command and wheels.
            terrain: level ground or a ramp.

        Raises:
            ParameterError: it cannot be built, or its base does not move freely.
        """
        self.name = name
        self.drive = drive
        self.terrain = terrain
        self._content = content
        self._numbers = numbers
        self._robot = self._built(given_rates=False)
        self.dt = self._robot.timestep

    def _built(self, *, given_rates: bool) -> OwnRobot:
        """Return the robot at rest with the numbers of a fit."""
        try:
            robot = OwnRobot(*self._content, given_rates=given_rates)
        except ValueError as error:
            raise ParameterError(str(error)) from error
        model = robot.model
        root = robot.wheeled.root
        if model.jnt_type[model.body_jntadr[root]] != mujoco.mjtJoint.mjJNT_FREE:
            held = [model.joint(j).name for j in np.flatnonzero(model.jnt_bodyid == root)]
            raise ParameterError(
                f"its base moves only as its joints {', '.join(held)} let it, so it "
                "neither settles on its wheels nor tilts; give it a <freejoint/> in their place"
            )
        # samples need a whole number of steps
        model.opt.timestep = _SAMPLE / math.ceil(_SAMPLE / robot.timestep - 1e-9)
        numbers = self._numbers
        model.geom_friction[:, 0] *= numbers.friction
        model.pair_friction[:, :2] *= numbers.friction
        shift = robot.wheeled.turn.T @ [numbers.com_x, numbers.com_y, 0.0]
        model.body_ipos[root] += robot.wheeled.data.xmat[root].reshape(3, 3).T @ shift
        mujoco.mj_setConst(model, mujoco.MjData(model))
        robot.settle()
        model.opt.gravity = self.terrain.gravity(robot.gravity)
        return robot

    @cached_property
    def _given(self) -> OwnRobot:
        """The robot whose wheels turn at given rates."""
        return self._built(given_rates=True)

    def run(
        self,
        commands: Commands,
        state: State,
        sample_dt: float,
        disturbance: FloatArray | None = None,
    ) -> Trajectory:
        """Drive `commands` at once.

        Returns:
            The motion of the middle between the axles, with the channel `wheel_load_N` (M, 4; front
            left, front right, rear left, rear right).

        Raises:
            DivergedError: the simulator gave up.
        """
        stride = whole_steps(sample_dt, self.dt, "the sample period")
        push = None if disturbance is None else np.append(disturbance, 0.0)
        if commands.kind == "wheels":
            robot = self._given
            rates = self._all_rates(commands, state, push)
        else:
            robot = self._robot
            rates = self._one_step_more(wheel_references(commands, self.drive, self.dt, state))
        motion, _ = robot.follow(rates, self._placed(robot, state), stride=stride, push=push)
        return replace(
            motion,
            t=sample_dt * np.arange(len(motion.t), dtype=np.float64),
            pose=motion.pose + np.array([0.0, 0.0, state.yaw - motion.pose[0, 2]]),
            wheels=motion.wheels / self._numbers.rolling,
            channels={"wheel_load_N": motion.channels["wheel_load_N"]},
        )

    def _one_step_more(self, rates: FloatArray) -> FloatArray:
        """Return the (n, 2) rates as this robot's wheels need them, and once more the last ones.

        The step more tells the end of the last one.
        """
        return self._numbers.rolling * np.vstack([rates, rates[-1:]])

    def _all_rates(self, commands: Commands, state: State, push: FloatArray | None) -> FloatArray:
        """Return the (n + 1, 4) rates of all wheels, of which the mean of each side is given.

        By how much front and rear differ is what the robot's own servos make of it.
        """
        steps = commands.n * whole_steps(commands.dt, self.dt, "the command period")
        sides = self._one_step_more(rates_on_steps(commands, self.dt, np.arange(steps)))
        robot = self._robot
        if robot.given_rates:
            return np.tile(sides, 2)
        motion, _ = robot.follow(sides, self._placed(robot, state), push=push)
        before = motion.channels["wheel_rad_s"]
        after = np.vstack([before[1:], before[-1:]])
        apart = 0.5 * (after[:, :2] - after[:, 2:])
        return np.hstack([sides + apart, sides - apart])

    def make_bodies(self, plants: Sequence[OwnPlant], state: State, workers: int = 1) -> _OwnBodies:
        """Return robots in a state, at rest on their tyres."""
        return _OwnBodies(plants, state)

    def advance(
        self, now: FloatArray, rates: FloatArray, push: FloatArray
    ) -> tuple[FloatArray, Motion]:
        """Return simulator's state and motion after steps with (n, 2) wheel rates of the sides.

        The yaw is not unwrapped; `push` are (n,) yaw accelerations [rad/s2].

        Raises:
            DivergedError: the simulator gave up.
        """
        motion, now = self._robot.follow(self._numbers.rolling * rates, now, push=push)
        wheels = motion.wheels[-1] / self._numbers.rolling
        pose = self._robot.pose_of(now)
        return now, Motion._make([*pose, *motion.twist[-1], *wheels, 0.0, 0.0])

    def place(self, state: State) -> FloatArray:
        """Return the simulator's state of the robot that is driven by commands, at rest there."""
        return self._placed(self._robot, state)

    def _placed(self, robot: OwnRobot, state: State) -> FloatArray:
        """Return the simulator's state of a robot that rests in `state`."""
        data = robot.data_of(robot.rest)
        data.time = 0.0
        x, y, yaw = robot.pose_of(robot.rest)
        root = data.joint(int(robot.model.body_jntadr[robot.wheeled.root]))
        turned = state.yaw - yaw
        away = rotate_body_to_world(root.qpos[:2] - [x, y], turned)
        root.qpos[:2] = away + np.array([state.x, state.y])
        mujoco.mju_mulQuat(root.qpos[3:7], yaw_to_quat_wxyz(turned), root.qpos[3:7].copy())
        velocity = rotate_body_to_world([state.v_x, state.v_y], state.yaw)
        root.qvel[:] = 0.0
        # the root moves about the middle
        root.qvel[:2] = velocity + state.yaw_rate * (away[::-1] * [-1.0, 1.0])
        root.qvel[5] = state.yaw_rate
        rates = self._numbers.rolling * np.tile([state.wheel_left, state.wheel_right], 2)
        data.qvel[robot.dofs] = rates * robot.signs
        return robot.state_of(data)
