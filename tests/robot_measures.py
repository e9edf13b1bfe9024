"""Measurements that set the simulator beside mechanics: turns, rolling, slopes and sliding stops.

Speeds and times are those of the robot's size: Froude numbers, and multiples of sqrt(wheel radius /
g).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from ssmr.types import FloatArray
from validation.simulator.calibration import Calibration
from validation.simulator.description import WHEELS
from validation.simulator.model import GRAVITY, robot_model
from validation.simulator.motors import actuator_inputs
from validation.simulator.parts import robot_parts
from validation.simulator.physics import PhysicsSettings
from validation.simulator.turning import closed_form

RIM_SPEED = 0.13
ROLL_SPEED = 0.4
STOP_SPEED = 1.18
"""Speeds of rims in a slow turn, of a straight drive, and at which wheels are blocked, over sqrt(g
wheel radius) [1]."""
REST_TIME = 8.0
TURN_TIME = 46.0
DRIVE_TIME = 30.0
"""Times over sqrt(wheel radius / g) [1]; 1.0, 6.0 and 3.9 s for a Husky."""
STIFF = 20.0
"""Gain of nearly rigid motors over the robot's own [1]."""
EXACT = PhysicsSettings(solver="Newton")
"""Solver that is exact enough for laws that hold to rounding; tests/test_solver.py holds the
shipped one to it."""
TILT = math.radians(8.0)
"""Slope on which a robot creeps [rad]."""
_LOAD_SHIFTS = (0.005, 0.005, 0.02, 0.2)
"""A slow turn on the spot may move the loads by these shares, see `turn_on_the_spot` [1]: forces
towards the turn's centre move half a per cent of the weight to the front or aside; the soft
contact, which carries more where it slips faster, moves two per cent between diagonals and a fifth
between a wide tyre's edges (docs/robots.md, "Robots of other sizes and shapes")."""


def load_sensitivity(calibration: Calibration) -> float:
    """Return the share by which the closed form's multiplier may change with the loads [1].

    It is small but for robots with their centre of mass far off the middle, which barely turn.
    """
    at_rest = math.log(closed_form(calibration).multiplier)
    total = 0.0
    for shift in np.diag(_LOAD_SHIFTS):
        shifted = [closed_form(calibration, tuple(sign * shift)) for sign in (1.0, -1.0)]
        total += max(abs(math.log(turn.multiplier) - at_rest) for turn in shifted)
    return total


class Bench:
    """A robot at rest on level ground, ready to be driven by wheel rates."""

    def __init__(self, calibration: Calibration) -> None:
        """Build it and let it settle."""
        self.calibration = calibration
        self.model = robot_model(calibration, settings=EXACT)
        self.data = mujoco.MjData(self.model)
        self.unit = math.sqrt(calibration.wheel_radius / GRAVITY)
        self.speed = math.sqrt(calibration.wheel_radius * GRAVITY)
        self._tires = robot_parts(self.model).tires
        self.spins = [int(self.model.joint(f"{wheel}_wheel").dofadr[0]) for wheel in WHEELS]
        self.run(REST_TIME)

    def run(self, time: float) -> float:
        """Run for so many units of time; return the time [s]."""
        steps = max(1, round(time * self.unit / self.model.opt.timestep))
        mujoco.mj_step(self.model, self.data, nstep=steps)
        return steps * float(self.model.opt.timestep)

    def ask(self, left: float, right: float) -> None:
        """Give the motors rim speeds over sqrt(g wheel radius)."""
        rates = np.array([left, right]) * self.speed / self.calibration.wheel_radius
        self.data.ctrl[:] = actuator_inputs(self.model, rates)

    def loads(self) -> FloatArray:
        """Return the (4,) wheel loads over the weight."""
        out = np.zeros(4)
        force = np.zeros(6)
        for k, contact in enumerate(self.data.contact[: self.data.ncon]):
            mujoco.mj_contactForce(self.model, self.data, k, force)
            wheel = [i for i, tire in enumerate(self._tires) if tire in contact.geom.tolist()]
            assert len(wheel) == 1, "two tyres touch each other"
            out[wheel[0]] += force[0]
        return out / (self.calibration.mass * GRAVITY)


@dataclass(frozen=True)
class Turned:
    """A slow turn on the spot with nearly rigid motors."""

    multiplier: float
    """Yaw rate of the wheels over that of the body [1]."""
    error: float
    """Logarithm of the multiplier over the closed form's [1]."""
    sensitivity: float
    """`load_sensitivity` [1]."""
    ripple: float
    """Range of the yaw rate over its mean, in the second half [1]."""
    load_deviation: float
    """Greatest standard deviation of a wheel's load over its mean, in the second half [1]."""
    load_shift: float
    """Greatest difference of a wheel's load from that at rest by mechanics, over a quarter of the
    weight [1]."""


def turn(calibration: Calibration, time: float = TURN_TIME) -> Turned:
    """Turn a robot on the spot."""
    bench = Bench(replace(calibration, gain=STIFF * calibration.gain))
    bench.ask(-RIM_SPEED, RIM_SPEED)
    bench.run(0.5 * time)
    rates = []
    wheels = []
    loads = []
    for _ in range(40):
        bench.run(0.5 * time / 40)
        rates.append(float(bench.data.qvel[5]))
        wheels.append(bench.data.qvel[bench.spins].copy())
        loads.append(bench.loads())
    rims = float(np.mean(wheels, axis=0) @ [-0.5, 0.5, -0.5, 0.5]) * calibration.wheel_radius
    multiplier = rims / (2.0 * calibration.half_track * float(np.mean(rates)))
    carried = np.array(loads)
    return Turned(
        multiplier,
        math.log(multiplier / closed_form(calibration).multiplier),
        load_sensitivity(calibration),
        float(np.ptp(rates) / np.mean(rates)),
        float((carried.std(axis=0) / carried.mean(axis=0)).max()),
        4.0 * float(np.abs(carried[-1] - calibration.static_shares).max()),
    )


def resting_error(calibration: Calibration) -> tuple[float, float]:
    """Return the errors of loads at rest [1].

    Of their sum over the weight, and of each from `static_shares`, over a quarter of it.
    """
    loads = Bench(calibration).loads()
    return abs(float(loads.sum()) - 1.0), 4.0 * float(
        np.abs(loads - calibration.static_shares).max()
    )


def rolling_error(calibration: Calibration) -> float:
    """Return the rolling radius over the wanted one, less one [1]."""
    bench = Bench(replace(calibration, gain=STIFF * calibration.gain))
    bench.ask(ROLL_SPEED, ROLL_SPEED)
    bench.run(DRIVE_TIME)
    before = bench.data.qpos.copy()
    bench.run(DRIVE_TIME)
    moved = bench.data.qpos - before
    turned = float(
        np.mean([moved[bench.model.joint(f"{wheel}_wheel").qposadr[0]] for wheel in WHEELS])
    )
    return math.hypot(*moved[:2]) / (turned * calibration.wheel_radius) - 1.0


def creep(calibration: Calibration) -> float:
    """Return the speed at which a robot creeps down a side slope, over sqrt(g wheel radius) [1]."""
    bench = Bench(calibration)
    bench.model.opt.gravity[:] = 0.0, GRAVITY * math.sin(TILT), -GRAVITY * math.cos(TILT)
    bench.run(DRIVE_TIME)
    before = bench.data.qpos[:2].copy()
    time = bench.run(DRIVE_TIME)
    return math.hypot(*(bench.data.qpos[:2] - before)) / (time * bench.speed)


def stop_error(calibration: Calibration, sideways: bool) -> float:
    """Return the way that a robot with blocked wheels slides over v^2 / (2 mu g), less one [1]."""
    heavy = 1.6 * calibration.mass * calibration.wheel_radius**2
    bench = Bench(replace(calibration, armature=100.0 * heavy, gain=1e4 * calibration.gain))
    axis = int(sideways)
    speed = STOP_SPEED * bench.speed
    bench.data.qvel[axis] = speed
    before = float(bench.data.qpos[axis])
    bench.run(2.5 * STOP_SPEED / calibration.friction)
    return (float(bench.data.qpos[axis]) - before) / (
        speed**2 / (2.0 * calibration.friction * GRAVITY)
    ) - 1.0


def tipping(calibration: Calibration) -> float:
    """Return how near a robot that slides straight ahead or sideways is to lifting wheels [1].

    1 where it does.
    """
    robot = calibration.robot
    share = 1.0 - 4.0 * robot.wheel_mass / calibration.mass
    height = (
        share * (robot.base_height + calibration.com_z) + (1.0 - share) * calibration.wheel_radius
    )
    least = min(
        0.5 * robot.wheelbase - share * abs(calibration.com_x),
        calibration.half_track - share * abs(calibration.com_y),
    )
    return calibration.friction * height / least
