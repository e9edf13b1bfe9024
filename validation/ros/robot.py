"""A MuJoCo robot with its sensors and the gate of its commands, without ROS and without a clock."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ssmr.estimation.ekf import filter_step, initial_belief
from ssmr.estimation.settings import V, W
from ssmr.parameters import pack_numbers
from ssmr.robot.drive import Sides, body_rates
from ssmr.robot.sensors import SensorModel, sense_rates
from ssmr.types import FloatArray, State
from validation.plants.profile import odometry_of
from validation.ros.messages import STAND_STILL, Twist
from validation.simulator.description import Robot
from validation.simulator.plant import MujocoPlant

SENSOR_RATE = 50.0
"""Rate of encoders, IMU and filter [Hz]; Tab. 3.5, husky_control."""
BASE_TIMEOUT = 0.25
"""Time without a command after which the wheel controller brakes [s] (control.yaml,
cmd_vel_timeout)."""
_WHEEL_POSE_VARIANCE = (1e-3, 1e-3, 0.03)
"""Variances of x, y [m2] and yaw [rad2] in the maker's wheel odometry
(husky_control/config/control.yaml)."""
_SIDE_SLIP_VARIANCE = 2.5e-3
"""Variance of the lateral speed, which is not measured [m2/s2]: 0.05 m/s, as in turns on the lab's
floor."""
_FORCE_VARIANCE = 1e-2
"""Variance reported for the accelerometer [m2/s4]: 0.1 m/s2, a MEMS sensor on a vibrating robot. No
noise is added."""


class CommandGate:
    """Passes the last command on, and brakes on an emergency stop and without commands."""

    def __init__(self, topic: str, report: Callable[[str], object]) -> None:
        """Begin without a command; they come on `topic`, and `report` takes sentences."""
        self._topic = topic
        self._report = report
        self._command = STAND_STILL
        self._since = -math.inf
        self._stopped = False

    def offer(self, command: Twist, now: float) -> None:
        """Take a plausible command that came at `now` [s]; an emergency stop ignores it."""
        if self._stopped:
            return
        if self._since == -math.inf:
            self._report(f"{self._topic} commands")
        self._command = command
        self._since = now

    def emergency_stop(self, stop: bool) -> None:
        """Block commands, or release them."""
        if stop != self._stopped:
            effect = "the robot brakes and takes no commands" if stop else "released"
            self._report(f"emergency stop: {effect}")
        self._stopped = stop
        if stop:
            self._since = -math.inf

    def command(self, now: float) -> Twist:
        """The robot's command at `now` [s]: the last one passed on, or to stand if that is old."""
        if now - self._since <= BASE_TIMEOUT:
            return self._command
        if self._since > -math.inf:
            self._report(f"nothing on {self._topic} for {BASE_TIMEOUT:g} s: the robot brakes")
            self._since = -math.inf
        return STAND_STILL


class SimulatedRobot:
    """A robot that advances on request: wheel odometry, IMU and state filter on the physics."""

    def __init__(
        self, plant: MujocoPlant, start: State | None = None, *, noise: bool = True, seed: int = 0
    ) -> None:
        """Put the robot to rest at its start, with the thesis' filter, which knows that pose.

        Args:
            plant: the robot; its own drive stands between command and wheels.
            start: pose in the world; the origin if not given. The filter's frame begins there.
            noise: False for encoders and gyro without noise.
            seed: seed of the noise.
        """
        self._plant = plant
        self._start = start or State()
        self._seed = seed
        sensors = SensorModel() if noise else SensorModel(0.0, 0.0)
        self._errors = pack_numbers(sensors)
        self.filter = odometry_of(plant.drive)
        self._numbers = self.filter.packed()
        self._reset()
        self.advance(1, STAND_STILL)  # so that all is compiled before it has to keep real time
        self.sense()
        self.filtered_odometry()
        self._reset()

    def _reset(self) -> None:
        self._noise = np.random.default_rng([self._seed, 0])
        self.state = self._plant.reset(self._start)
        self.steps = self._sensed_at = 0
        self.belief = initial_belief(State())
        self._wheel_pose = np.zeros(3)
        self._wheel_twist = STAND_STILL
        self._wheels = np.zeros((2, 2))
        self._gyro = np.zeros(3)

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
    def pose(self) -> FloatArray:
        """(3,) true x, y [m], yaw [rad, unwrapped] in the world."""
        return np.array([self.state.x, self.state.y, self.state.yaw])

    def advance(self, steps: int, command: Twist) -> None:
        """Hold a command for `steps` physics steps; a DivergedError ends a failed simulation."""
        if steps:
            self.state = self._plant.step(command, steps * self.dt)
            self.steps += steps

    def sense(self) -> None:
        """Read encoders and gyro, and update wheel odometry and filter."""
        dt = (self.steps - self._sensed_at) * self.dt
        self._sensed_at = self.steps
        s = self.state
        draws = self._noise.standard_normal(5)
        wheels = Sides(s.wheel_left, s.wheel_right)
        now = self.steps * self.dt
        sample = sense_rates(now, wheels, s.yaw_rate, tuple(draws[:3]), self._errors)
        filter_step(self.belief, sample, dt, self._numbers)
        self._wheels[1] = sample.left, sample.right
        self._wheels[0] += dt * self._wheels[1]
        roll_pitch = self._plant.imu()[0][:2] + math.sqrt(self._errors.variance_gyro) * draws[3:]
        self._gyro = np.array([*roll_pitch, sample.gyro])
        ekf = self.filter
        v, w = map(float, body_rates(sample.left, sample.right, ekf.half_track, ekf.radius))
        heading = self._wheel_pose[2] + 0.5 * dt * w
        rates = np.array([v * math.cos(heading), v * math.sin(heading), w])
        self._wheel_pose = self._wheel_pose + dt * rates
        self._wheel_twist = v, w

    def filtered_odometry(self) -> tuple[FloatArray, Twist, FloatArray, FloatArray]:
        """Return the filter's pose (3,), its twist, and the (3, 3) covariances of both."""
        mean, p = self.belief
        twist_cov = np.diag([0.0, _SIDE_SLIP_VARIANCE, 0.0])
        twist_cov[np.ix_((0, 2), (0, 2))] = p[V : W + 1, V : W + 1]
        twist = (float(mean[V]), float(mean[W]))
        return mean[:3].copy(), twist, p[:3, :3].copy(), twist_cov

    def wheel_odometry(self) -> tuple[FloatArray, Twist, FloatArray, FloatArray]:
        """Return pose, twist and covariances by the wheels alone, as `filtered_odometry` does."""
        ekf = self.filter
        twist_cov = np.diag([ekf.variance_v, _SIDE_SLIP_VARIANCE, ekf.variance_wheel_yaw_rate])
        pose_cov = np.diag(_WHEEL_POSE_VARIANCE)
        return self._wheel_pose.copy(), self._wheel_twist, pose_cov, twist_cov

    def joints(self) -> tuple[FloatArray, FloatArray]:
        """The (4,) angles [rad] and rates [rad/s] of the wheels by the encoders, one a side."""
        angles, rates = np.tile(self._wheels, 2)
        return angles, rates

    def imu(self) -> tuple[FloatArray, FloatArray, tuple[float, float]]:
        """(3,) rates sensed last [rad/s], (3,) specific force [m/s2], and variances of both."""
        _, force = self._plant.imu()
        return self._gyro, force, (self.filter.variance_gyro, _FORCE_VARIANCE)
