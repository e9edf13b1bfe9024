"""The MuJoCo Husky behind its own sensors: wheel odometry, IMU and state filter on top of the physics. No ROS here."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ssmr.estimation.ekf import EkfSettings, filter_step, initial_belief
from ssmr.estimation.sensing import SensorErrors, SensorModel, sense
from ssmr.robot.drive import body_rates, whole_steps
from ssmr.robot.sensors import YAW_DISTURBANCE_VARIANCE
from ssmr.types import FloatArray, State
from validation.robots.plant import MujocoPlant
from validation.ros.commands import STAND_STILL, Twist

SENSOR_RATE = 50.0
"""Of encoders, IMU and filter [Hz]; Tab. 3.5, husky_control."""
PUSH_TIME = 0.1
"""For how long a random push is held [s], as `ssmr.sensors.yaw_disturbance` has it."""
RESTING = 5e-3
"""A robot slower than this stands [m/s, and rad/s]."""
WHEEL_POSE_VARIANCE = (1e-3, 1e-3, 0.03)
"""What the maker's wheel odometry claims of x, y [m2] and yaw [rad2] (husky_control/config/control.yaml)."""
SIDE_SLIP_VARIANCE = 2.5e-3
"""Of the lateral speed that nobody measures [m2/s2]: 0.05 m/s, as in turns on the lab's floor (docs/physics.md)."""
FORCE_VARIANCE = 1e-2
"""What is claimed of the accelerometer [m2/s4]: 0.1 m/s2, a MEMS sensor on a vibrating robot. No noise is added to it."""


@dataclass(frozen=True)
class SensorSettings:
    """What the robot's sensors are like."""

    noise: bool = True
    """Whether encoders and gyro have the noise of `model`."""
    model: SensorModel = field(default_factory=SensorModel)
    """Their noise."""
    disturbance: bool = False
    """Push the yaw at random (Sec. 3.4.5)."""
    seed: int = 0
    """Of noise and pushes."""


class SimulatedRobot:
    """A Husky whose time passes when it is told."""

    def __init__(self, plant: MujocoPlant, settings: SensorSettings, start: State | None = None) -> None:
        """Put the robot to rest where it starts, with a filter that knows that place.

        Args:
            plant: the robot; its own drive stands between command and wheels.
            settings: its sensors.
            start: where it stands in the world; the origin, if not given. The filter's frame begins there.
        """
        self._plant, self._settings = plant, settings
        self._noise, self._push = (np.random.default_rng([settings.seed, k]) for k in range(2))
        self.state = plant.reset(start or State())
        self.steps = 0
        self._sensed_at = 0
        drive = plant.drive
        self.filter = EkfSettings(radius=drive.command_radius, half_track=drive.command_half_track)
        self._numbers = self.filter.packed()
        self._deviations = settings.model.packed() if settings.noise else SensorErrors(0.0, 0.0, 0.0)
        self.belief = initial_belief(State())
        self._wheel_pose = np.zeros(3)
        self._wheel_twist: Twist = STAND_STILL
        self._gyro = np.zeros(3)
        self._push_steps = whole_steps(PUSH_TIME, plant.dt, "the time of a push")
        self._pushing = 0.0

    @property
    def dt(self) -> float:
        """Physics step [s]."""
        return self._plant.dt

    @property
    def time(self) -> float:
        """Simulated time since the start [s]."""
        return self.steps * self.dt

    @property
    def resting(self) -> bool:
        """Whether it stands."""
        s = self.state
        return math.hypot(s.v_x, s.v_y) < RESTING and abs(s.yaw_rate) < RESTING

    def advance(self, steps: int, command: Twist) -> None:
        """Hold a command for some physics steps.

        Raises:
            DivergedError: the simulator gave up.
        """
        for _ in range(steps):
            if self._settings.disturbance and self.steps % self._push_steps == 0:
                self._pushing = math.sqrt(YAW_DISTURBANCE_VARIANCE) * self._push.standard_normal()
            self.state = self._plant.step(command, self.dt, self._pushing)
            self.steps += 1

    def sense(self) -> None:
        """Read encoders and gyro, and let wheel odometry and filter take them in."""
        dt, self._sensed_at = (self.steps - self._sensed_at) * self.dt, self.steps
        s, draws = self.state, self._noise.standard_normal(5)
        sample = sense(s.wheel_left, s.wheel_right, s.yaw_rate, tuple(draws[:3]), self._deviations)
        filter_step(self.belief, sample, dt, self._numbers)
        self._gyro = np.array([*(self._plant.imu()[0][:2] + self._deviations.gyro_std * draws[3:]), sample.gyro])
        v, w = (float(rate) for rate in body_rates(sample.left, sample.right, self.filter.half_track, self.filter.radius))
        heading = self._wheel_pose[2] + 0.5 * dt * w
        self._wheel_pose = self._wheel_pose + dt * np.array([v * math.cos(heading), v * math.sin(heading), w])
        self._wheel_twist = v, w

    def set_pose(self, pose: FloatArray, covariance: FloatArray) -> None:
        """Tell the filter where it is, as robot_localization's set_pose: at rest there. The robot itself stays.

        Args:
            pose: (3,) x, y [m], yaw [rad] in the filter's frame.
            covariance: (3, 3) of them.

        Raises:
            ValueError: a number is not finite.
        """
        belief = initial_belief(State(*map(float, pose)))
        belief.covariance[:3, :3] = covariance
        self.belief = belief

    @property
    def pose(self) -> FloatArray:
        """(3,) x, y [m], yaw [rad, unwrapped] where it really is, in the world."""
        return np.array([self.state.x, self.state.y, self.state.yaw])

    def believed(self) -> tuple[FloatArray, Twist, FloatArray, FloatArray]:
        """Pose (3,), twist, and (3, 3) covariances of both, of the filter."""
        mean, p = self.belief
        twist_cov = np.diag([0.0, SIDE_SLIP_VARIANCE, 0.0])
        twist_cov[np.ix_((0, 2), (0, 2))] = p[3:, 3:]
        return mean[:3].copy(), (float(mean[3]), float(mean[4])), p[:3, :3].copy(), twist_cov

    def wheels(self) -> tuple[FloatArray, Twist, FloatArray, FloatArray]:
        """The same by wheel odometry alone."""
        twist_cov = np.diag([self.filter.variance_v, SIDE_SLIP_VARIANCE, self.filter.variance_wheel_yaw_rate])
        return self._wheel_pose.copy(), self._wheel_twist, np.diag(WHEEL_POSE_VARIANCE), twist_cov

    def imu(self) -> tuple[FloatArray, FloatArray, tuple[float, float]]:
        """(3,) rates [rad/s] as sensed last, (3,) specific force [m/s2], and the variances claimed of both."""
        return self._gyro, self._plant.imu()[1], (self.filter.variance_gyro, FORCE_VARIANCE)


def warm_up(robot: SimulatedRobot) -> None:
    """Compile everything that a robot's time needs, on one that nobody wants any more."""
    robot.advance(1, STAND_STILL)
    robot.sense()
