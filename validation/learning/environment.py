"""A robot for learning code: a dm_control entity, and trajectory tracking as a `dm_env` environment.

The robot is that of all other programs: its file, calibrated by a profile, behind the profile's drive. An action is the
command that a robot reads every 50 ms, and the errors are those that the controllers see.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from dm_control import composer
from dm_control.composer.observation import observable
from dm_env import specs

from ssmr.control.law import Observation
from ssmr.control.loop import VELOCITY_PERIOD
from ssmr.control.tick import LOST, SPINNING
from ssmr.control.waypoints import ALPHA_SWITCH, Target, Waypoints, position_errors, target
from ssmr.geometry import quat_wxyz_to_yaw, rotate_world_to_body
from ssmr.robot.drive import Driver, whole_steps
from ssmr.robot.vehicle import Drive
from ssmr.types import FloatArray, State
from validation.plants.profile import PlantProfile, Profile, choose_profile, make_plant
from validation.simulator.calibration import Calibration
from validation.simulator.composing import add_integral_parts, compose_robot
from validation.simulator.description import WHEELS, Robot
from validation.simulator.model import calibrate, controls, set_motors
from validation.simulator.plant import MujocoPlant
from validation.track.waypoint_files import open_reference
from validation.words import shortened

WIDTH = 0.1
"""Distance from the target at which the reward has fallen to 1/e [m]."""

LARGEST_ACTION = 100.0
"""Greatest size of an action [m/s, rad/s]. The drive limits what is beyond its own limits; more than this is a mistake."""


class RobotEntity(composer.Entity):
    """A robot without its free joint: `Arena.add_free_entity` gives it one."""

    def _build(self, robot: Robot, integral: bool = False) -> None:
        self._robot, self._model = robot, compose_robot(robot)
        if integral:
            add_integral_parts(self._model, robot)
        self._model.model = robot.name
        self._model.find("joint", "root").remove()

    @property
    def mjcf_model(self) -> Any:
        """The MJCF tree."""
        return self._model

    @property
    def prefix(self) -> str:
        """Prefix of all names once the robot is attached."""
        return f"{self._model.model}/"

    @property
    def wheels(self) -> list[Any]:
        """The four wheel joints, in the order of `WHEELS`."""
        return [self._model.find("joint", f"{wheel}_wheel") for wheel in WHEELS]

    @property
    def motors(self) -> list[Any]:
        """Velocity servos [rad/s]: of the left and the right side, or of every wheel."""
        return [self._model.find("actuator", f"{motor}_motor") for motor in self._robot.motors]

    def calibrate(self, physics: Any, calibration: Calibration, drive: Drive) -> None:
        """Set a calibration and the motors of a drive on compiled physics.

        Raises:
            ValueError: the drive has an integral part and the robot was built without, or the other way round.
        """
        calibrate(physics.model.ptr, calibration, self.prefix)
        set_motors(physics.model.ptr, calibration, drive, self.prefix)


def ground(robot: Robot) -> composer.Arena:
    """Return a plane under a lamp, with the solver's settings of the robot: an attached robot does not bring its own."""
    arena = composer.Arena(name="ground")
    made, root = compose_robot(robot), arena.mjcf_model
    for name in ("timestep", "integrator", "cone", "impratio", "iterations", "tolerance"):
        setattr(root.option, name, getattr(made.option, name))
    root.option.flag.multiccd = made.option.flag.multiccd
    root.compiler.angle = "radian"
    root.worldbody.add("geom", name="plane", type="plane", size=[0, 0, 0.05], condim=3)
    root.worldbody.add("light", name="sun", mode="fixed", directional=True, pos=[0, 0, 10], dir=[0.3, 0.2, -1])
    return arena


class Tracking(composer.Task):
    """Follow a moving target; the reward is exp(-(distance / 0.1 m)^2), the end is the reference's, or losing the target.

    An action is a command, v [m/s] and omega [rad/s], read every 50 ms. Each episode takes one of the profiles at random:
    variations of the domain.
    """

    def __init__(self, profiles: Sequence[Profile], waypoints: Waypoints) -> None:
        """Compose robot and ground.

        Args:
            profiles: one or more calibrations of one robot, of one time step.
            waypoints: what is followed.

        Raises:
            ValueError: no profile, several robots or time steps, or tyres that are no ellipsoids.
        """
        self._plants: list[PlantProfile] = [p.plants["mujoco"] for p in profiles]
        steps = {p.parameters.timestep for p in self._plants}
        if len(steps) != 1:
            raise ValueError(
                f"the profiles must have one time step, they have {', '.join(map(str, sorted(steps))) or 'none'}"
            )
        robots = {p.robot for p in self._plants}
        if len(robots) != 1:
            raise ValueError(f"the profiles must be of one robot, they are of {', '.join(sorted(r.name for r in robots))}")
        robot = robots.pop()
        if any(p.parameters.wheel_shape != "ellipsoid" or p.parameters.friction_ratio != 1.0 for p in self._plants):
            raise ValueError("a tracking task has ellipsoid tyres and isotropic friction")
        parts = {p.drive.integral_gain > 0.0 for p in self._plants}
        if len(parts) != 1:
            raise ValueError("the speed loops of all profiles, or of none, must have an integral part")
        self._resting: list[FloatArray] = []
        for profile in profiles:
            plant = make_plant(profile, "mujoco")
            assert isinstance(plant, MujocoPlant)
            nq = plant.model.nq
            self._resting.append(plant.placed(waypoints.start)[1 : 1 + nq])
        self._waypoints, self._course = waypoints, waypoints.course()
        self._arena, self.robot = ground(robot), RobotEntity(robot, integral=parts.pop())
        self._frame = self._arena.add_free_entity(self.robot)
        self.set_timesteps(control_timestep=VELOCITY_PERIOD, physics_timestep=steps.pop())
        self._observables = {
            name: observable.Generic(getattr(self, f"_see_{name}")) for name in ("errors", "twist", "wheels", "target")
        }
        for see in self._observables.values():
            see.enabled = True
        self._segment, self._drawn, self._start, self._substep = 0, 0, 0.0, 0
        self._driver, self._references = Driver(self._plants[0].drive, self.physics_timestep, State()), np.zeros((1, 2))

    @property
    def root_entity(self) -> composer.Entity:
        """The ground, to which the robot is attached."""
        return self._arena

    @property
    def task_observables(self) -> Mapping[str, Any]:
        """The observations of an agent.

        `errors` (3,): e_rho [m], e_y [m], e_alpha [rad]; `twist` (3,): v_x, v_y [m/s], yaw rate [rad/s]; `wheels` (2,): left
        and right [rad/s]; `target` (2,): its speed [m/s] and yaw rate [rad/s].
        """
        return dict(self._observables)

    def initialize_episode(self, physics: Any, random_state: np.random.RandomState) -> None:
        """Draw a profile, and put its robot on the first waypoint, at rest on its tyres."""
        self._drawn = int(random_state.randint(len(self._plants)))
        plant = self._plants[self._drawn]
        self.robot.calibrate(physics, plant.parameters, plant.drive)
        with physics.reset_context():
            rest, lever = self._resting[self._drawn], np.zeros(3)
            mujoco.mju_rotVecQuat(lever, np.array(physics.model.body(f"{self.robot.prefix}base").pos), rest[3:7])
            physics.data.qpos[:] = rest
            physics.data.qpos[:3] -= lever  # the free joint's frame is the MJCF's origin, not the base
            physics.data.qvel[:] = 0.0
        self._driver, self._references = Driver(plant.drive, self.physics_timestep, State()), np.zeros((1, 2))
        self._segment, self._start = 0, float(physics.data.time)

    def before_step(self, physics: Any, action: FloatArray, random_state: np.random.RandomState) -> None:
        """Turn the command into wheel-rate references for the physics steps until the next, as the drive does.

        Raises:
            ValueError: the action is not two finite numbers of at most `LARGEST_ACTION`; nothing has moved.
        """
        v, w = _checked(action)
        n = whole_steps(self.control_timestep, self.physics_timestep, "the control period")
        self._references, self._substep = self._driver.references((v, w), n), 0
        physics.data.ctrl[:] = controls(physics.model.ptr, self._references[0])

    def before_substep(self, physics: Any, action: FloatArray, random_state: np.random.RandomState) -> None:
        """Set the wheel-rate references of this physics step."""
        reference = self._references[min(self._substep, len(self._references) - 1)]
        physics.data.ctrl[:] = controls(physics.model.ptr, reference)
        self._substep += 1

    def action_spec(self, physics: Any) -> specs.BoundedArray:
        """Return the action (2,): v and omega within the drive's limits."""
        drive = self._plants[0].drive
        top = np.array([drive.v_max, drive.w_max])
        return specs.BoundedArray((2,), np.float64, -top, top, name="v\tomega")

    def _state(self, physics: Any) -> tuple[float, float, float, FloatArray]:
        """Return x, y, yaw and twist of the base, which stands above the free joint's frame and sways with it."""
        qpos, qvel, base = physics.data.qpos, physics.data.qvel, physics.model.body(f"{self.robot.prefix}base")
        lever, velocity = np.zeros(3), np.zeros(3)
        mujoco.mju_rotVecQuat(lever, np.array(base.pos), np.array(qpos[3:7]))
        mujoco.mju_rotVecQuat(velocity, np.cross(qvel[3:6], base.pos), np.array(qpos[3:7]))
        yaw = float(quat_wxyz_to_yaw(qpos[3:7]))
        v = rotate_world_to_body(np.array(qvel[:2]) + velocity[:2], yaw)
        return float(qpos[0] + lever[0]), float(qpos[1] + lever[1]), yaw, np.array([v[0], v[1], qvel[5]])

    def state(self, physics: Any) -> State:
        """Return the robot's state, as plants have it."""
        x, y, yaw, twist = self._state(physics)
        return State(x, y, yaw, *map(float, twist), *map(float, self._see_wheels(physics)))

    def _aim(self, physics: Any) -> Target:
        aim: Target = target(self._course, physics.data.time - self._start, self._segment)
        self._segment = aim.segment
        return aim

    def _see_errors(self, physics: Any) -> FloatArray:
        x, y, yaw, _ = self._state(physics)
        return np.array(position_errors(Observation(x, y, yaw, 0.0, 0.0), self._aim(physics), ALPHA_SWITCH))

    def _see_twist(self, physics: Any) -> FloatArray:
        return self._state(physics)[3]

    def _see_wheels(self, physics: Any) -> FloatArray:
        rates = np.array(physics.bind(self.robot.wheels).qvel)
        return np.array([rates[[0, 2]].mean(), rates[[1, 3]].mean()])

    def _see_target(self, physics: Any) -> FloatArray:
        aim = self._aim(physics)
        return np.array([aim.v, aim.w])

    def _distance(self, physics: Any) -> float:
        x, y, _, _ = self._state(physics)
        aim = self._aim(physics)
        return float(np.hypot(aim.x - x, aim.y - y))

    def get_reward(self, physics: Any) -> float:
        """Return exp(-(distance / 0.1 m)^2), in (0, 1]."""
        return float(np.exp(-((self._distance(physics) / WIDTH) ** 2)))

    def should_terminate_episode(self, physics: Any) -> bool:
        """Return whether the reference has ended or the robot is lost."""
        lost = self._distance(physics) >= LOST or abs(float(physics.data.qvel[5])) >= SPINNING
        return lost or physics.data.time - self._start >= self._waypoints.duration

    def get_discount(self, physics: Any) -> float:
        """Return 0 where the robot was lost and 1 otherwise: the end of a reference is no failure."""
        return 0.0 if self._distance(physics) >= LOST else 1.0


def _checked(action: Any) -> tuple[float, float]:
    """Return v and omega of an action.

    Raises:
        ValueError: it is not two finite numbers of at most `LARGEST_ACTION`.
    """
    try:
        numbers = np.asarray(action, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        numbers = np.empty(0)
    if numbers.shape != (2,) or not np.all(np.abs(numbers) <= LARGEST_ACTION):  # not so for NaN either
        raise ValueError(
            f"action must be (2,) finite numbers, v [m/s] and omega [rad/s], of at most {LARGEST_ACTION:g}; "
            f"got {shortened(action, 60)}"
        )
    return float(numbers[0]), float(numbers[1])


def tracking(
    profiles: str | None = None,
    reference: str = "circle",
    speed: float | None = 0.25,
    seed: int | None = None,
    *,
    robot: str | Path | Robot | None = None,
) -> composer.Environment:
    """Return trajectory tracking as a `dm_env` environment.

    Args:
        profiles: names of profiles or paths, comma-separated; each episode takes one at random. None for `thesis-lab`, or
            the robot's own numbers if that is of another robot than `robot`.
        reference: line, circle, sine, generic, or a file of waypoints.
        speed: mean speed of the reference [m/s].
        seed: seed of the draws.
        robot: the robot, its name or its path; None for that of the profiles.

    Raises:
        ValueError: profiles or waypoints that cannot be read, or do not go together.
    """
    named = [None] if profiles is None else [name.strip() for name in profiles.split(",") if name.strip()]
    chosen = [choose_profile(name, robot, "thesis-lab") for name in named]
    _, waypoints = open_reference(reference, speed)
    return composer.Environment(
        Tracking(chosen, waypoints),
        random_state=seed,
        strip_singleton_obs_buffer_dim=True,
        raise_exception_on_physics_error=True,
    )
