"""A MuJoCo robot with its sensors: wheel odometry, IMU and state filter on top of the physics, without ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ssmr.estimation.ekf import filter_step, forward_speed, initial_belief
from ssmr.estimation.settings import BIAS, Belief, EkfSettings, V, W, zeroed
from ssmr.geometry import compose
from ssmr.robot.drive import body_rates, whole_steps
from ssmr.robot.sensors import YAW_DISTURBANCE_VARIANCE, SensorErrors, SensorModel, gyro_at_rest, sense
from ssmr.types import FloatArray, State
from validation.plants.filters import odometry_of
from validation.ros.commands import STAND_STILL, Twist
from validation.simulator.description import Robot
from validation.simulator.plant import MujocoPlant

SENSOR_RATE = 50.0
"""Rate of encoders, IMU and filter [Hz]; Tab. 3.5, husky_control."""
_PUSH_TIME = 0.1
"""Time for which a random push is held [s], as in `ssmr.robot.sensors.yaw_disturbance`."""
_RESTING = 5e-3
"""Speed and yaw rate below which a robot stands [m/s, rad/s]."""
_WHEEL_POSE_VARIANCE = (1e-3, 1e-3, 0.03)
"""Variances of x, y [m2] and yaw [rad2] in the maker's wheel odometry (husky_control/config/control.yaml)."""
_SIDE_SLIP_VARIANCE = 2.5e-3
"""Variance of the lateral speed, which is not measured [m2/s2]: 0.05 m/s, as in turns on the lab's floor."""
_FORCE_VARIANCE = 1e-2
"""Variance reported for the accelerometer [m2/s4]: 0.1 m/s2, a MEMS sensor on a vibrating robot. No noise is added."""


@dataclass(frozen=True)
class SensorSettings:
    """Noise of the robot's sensors, and its disturbance."""

    noise: bool = True
    """True if encoders and gyro have the noise of `model`."""
    model: SensorModel = field(default_factory=SensorModel)
    """Noise of encoders and gyro."""
    disturbance: bool = False
    """Push the yaw at random (Sec. 3.4.5)."""
    seed: int = 0
    """Seed of noise and pushes."""
    filter: EkfSettings | None = None
    """State filter on the robot; the thesis' with the driver's odometry if not given."""


class SimulatedRobot:
    """A robot that advances only when `advance` is called."""

    def __init__(self, plant: MujocoPlant, settings: SensorSettings, start: State | None = None) -> None:
        """Put the robot to rest at its start, with a filter that knows that pose, and stood there for `STANDS`.

        Args:
            plant: the robot; its own drive stands between command and wheels.
            settings: its sensors.
            start: pose in the world; the origin if not given. The filter's frame begins there.
        """
        self._plant, self._settings = plant, settings
        self._noise, self._push = (np.random.default_rng([settings.seed, k]) for k in range(2))
        self._start = start or State()
        self.state = plant.reset(self._start)
        self.steps = 0
        self._sensed_at = 0
        self._deviations = settings.model.packed() if settings.noise else SensorErrors(0.0, 0.0, settings.model.gyro_bias)
        at_rest = gyro_at_rest(self._deviations, np.random.default_rng([settings.seed, 2]))
        self.filter = zeroed(settings.filter or odometry_of(plant.drive), at_rest)
        self._numbers = self.filter.packed()
        self.belief = initial_belief(State(), settings=self.filter if self.filter.learns else None)
        self._wheel_pose = np.zeros(3)
        self._wheels = np.zeros((2, 2))
        self._wheel_twist: Twist = STAND_STILL
        self._gyro = np.zeros(3)
        self._push_steps = whole_steps(_PUSH_TIME, plant.dt, "the time of a push")
        self._pushing = 0.0

    @property
    def description(self) -> Robot:
        """The robot that is simulated."""
        return self._plant.calibration.robot

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
        """True if the robot stands."""
        s = self.state
        return math.hypot(s.v_x, s.v_y) < _RESTING and abs(s.yaw_rate) < _RESTING

    def advance(self, steps: int, command: Twist) -> None:
        """Hold a command for `steps` physics steps.

        Raises:
            DivergedError: the simulator gave up.
        """
        for _ in range(steps):
            if self._settings.disturbance and self.steps % self._push_steps == 0:
                self._pushing = math.sqrt(YAW_DISTURBANCE_VARIANCE) * self._push.standard_normal()
            self.state = self._plant.step(command, self.dt, self._pushing)
            self.steps += 1

    def sense(self) -> None:
        """Read encoders and gyro, and update wheel odometry and filter."""
        dt, self._sensed_at = (self.steps - self._sensed_at) * self.dt, self.steps
        s, draws = self.state, self._noise.standard_normal(5)
        sample = sense(s.wheel_left, s.wheel_right, s.yaw_rate, tuple(draws[:3]), self._deviations)
        filter_step(self.belief, sample, dt, self._numbers)
        self._wheels[1] = sample.left, sample.right
        self._wheels[0] += dt * self._wheels[1]
        self._gyro = np.array([*(self._plant.imu()[0][:2] + self._deviations.gyro_std * draws[3:]), sample.gyro])
        v, w = (float(rate) for rate in body_rates(sample.left, sample.right, self.filter.half_track, self.filter.radius))
        heading = self._wheel_pose[2] + 0.5 * dt * w
        self._wheel_pose = self._wheel_pose + dt * np.array([v * math.cos(heading), v * math.sin(heading), w])
        self._wheel_twist = v, w

    def set_pose(self, pose: FloatArray, covariance: FloatArray) -> None:
        """Set the filter's pose, at rest, as robot_localization's set_pose does. The robot itself stays where it is.

        A filter that learns keeps what it knows of its constants.

        Args:
            pose: (3,) x, y [m], yaw [rad] in the filter's frame.
            covariance: (3, 3) covariance of these.

        Raises:
            ValueError: a number is not finite.
        """
        belief = initial_belief(State(*map(float, pose)))
        belief.covariance[:3, :3] = covariance
        known, p = self.belief
        p[:], p[:BIAS, :BIAS], p[BIAS:, BIAS:] = 0.0, belief.covariance, p[BIAS:, BIAS:].copy()
        self.belief = Belief(np.append(belief.mean, known[BIAS:]), p)

    def place(self, pose: FloatArray) -> None:
        """Put the robot to rest at a (3,) pose in `odom` [m, m, rad], which filter and wheel odometry are told exactly."""
        start = np.array([self._start.x, self._start.y, self._start.yaw])
        self.state = self._plant.reset(State(*map(float, compose(start, pose))))
        self.set_pose(pose, np.zeros((3, 3)))
        self._wheel_pose = pose.copy()

    @property
    def pose(self) -> FloatArray:
        """(3,) true x, y [m], yaw [rad, unwrapped] in the world."""
        return np.array([self.state.x, self.state.y, self.state.yaw])

    def believed(self) -> tuple[FloatArray, Twist, FloatArray, FloatArray]:
        """Return the filter's pose (3,), its twist, and the (3, 3) covariances of both."""
        mean, p = self.belief
        rows = np.eye(len(mean))[V : W + 1]
        v = forward_speed(mean, self.filter.half_track, rows[0]) if self.filter.learns else mean[V]
        twist_cov = np.diag([0.0, _SIDE_SLIP_VARIANCE, 0.0])
        twist_cov[np.ix_((0, 2), (0, 2))] = rows @ p @ rows.T
        return mean[:3].copy(), (float(v), float(mean[W])), p[:3, :3].copy(), twist_cov

    def wheels(self) -> tuple[FloatArray, Twist, FloatArray, FloatArray]:
        """Return pose, twist and covariances by wheel odometry alone, as `believed` does."""
        twist_cov = np.diag([self.filter.variance_v, _SIDE_SLIP_VARIANCE, self.filter.variance_wheel_yaw_rate])
        return self._wheel_pose.copy(), self._wheel_twist, np.diag(_WHEEL_POSE_VARIANCE), twist_cov

    def joints(self) -> tuple[FloatArray, FloatArray]:
        """Return the (4,) angles [rad] and rates [rad/s] of the wheels by the encoders, one a side."""
        angles, rates = np.tile(self._wheels, 2)
        return angles, rates

    def imu(self) -> tuple[FloatArray, FloatArray, tuple[float, float]]:
        """Return the (3,) rates sensed last [rad/s], the (3,) specific force [m/s2], and the variances reported for both."""
        return self._gyro, self._plant.imu()[1], (self.filter.variance_gyro, _FORCE_VARIANCE)
