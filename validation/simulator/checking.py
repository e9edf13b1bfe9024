"""Checks of a robot's numbers: by mechanics without a simulation, and on its MuJoCo model."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ssmr.robot.ground import FRONT, LEFT, SkidTurn, turn_on_the_spot
from ssmr.types import Commands, FloatArray, State
from validation.simulator.calibration import Calibration
from validation.simulator.description import (
    GRAVITY,
    ROTOR_SHARE,
    Robot,
    Vector3,
    free_drive,
)
from validation.simulator.health import apparent_mass
from validation.simulator.plant import MujocoPlant
from validation.simulator.turning import SAMPLE, SPIN_LEAD, closed_form, measure_spin, spin

_MEASURABLE = (
    "geometry.wheelbase",
    "geometry.track",
    "geometry.wheel_radius",
    "geometry.wheel_width",
    "geometry.body_size",
    "mass.total",
    "mass.wheel",
    "mass.wheel_inertia",
    "mass.com",
    "mass.inertia",
    "simulation.friction",
    "simulation.gain",
    "simulation.armature",
    "drive.torque_limit",
)
"""Numbers of a robot that one can measure or look up, `section.key`."""
_RIM_SPEED = 0.13
"""Speed of the rims in the measured turn over sqrt(g r) [1]: slow enough for mechanics without
inertia, and similar for robots of every size (Froude's similarity)."""
_TURNS = 2.2
"""Turns that mechanics expects in the measured time [1]; the motors lag a little behind."""
_STIFF_TIME = 2e-4
"""Time constant of the measuring motors [s]: a seventieth of that of robots. Wheels that have a
motor each, of which one skids and the other rolls, then turn equally to within half a percent."""
_STAND_TIME = 2.0
"""Time for which the robot stands before its loads are read [s]; the simulator has let it settle
before."""


# ----------------------------------------------------------------------------- by mechanics
def whole_com(robot: Robot) -> Vector3:
    """Return the centre of mass of the whole robot, wheels included, in the base frame [m]."""
    share = robot.base_mass / robot.mass
    x, y, z = robot.com
    return share * x, share * y, share * z + (1.0 - share) * robot.axle_height


def load_shares(robot: Robot) -> FloatArray:
    """Return the (4,) wheel loads over the weight [1] on equal springs and level ground.

    They are in the order of `WHEELS`. A negative one says that the robot would fall over that
    wheel's opposite.
    """
    x, y, _ = whole_com(robot)
    ahead = x * FRONT / (0.5 * robot.wheelbase)
    aside = y * LEFT / (0.5 * robot.track)
    shares: FloatArray = 0.25 * (1.0 + ahead + aside)
    return shares


def spot_turn(robot: Robot) -> SkidTurn | None:
    """Return a robot's quasi-static turn on the spot; None where its wheels do not carry it."""
    if load_shares(robot).min() < 0.0:
        return None
    x, y, _ = whole_com(robot)
    return turn_on_the_spot(robot.wheelbase, robot.track, x, y)


def turning_torque(robot: Robot, turn: SkidTurn) -> float:
    """Return the torque of a side in a turn on the spot on ground of friction 1 [N m], no losses.

    What the tyres of loads N and slips s dissipate, mu N |s| each, the two sides have to give. The
    forces along the robot cancel, so both give half of it: r mu sum(N |s|) / 2 is the torque of a
    side whose rims roll at 1 m/s. For a centre of mass in the middle that is r mu (m g / 2) L / D
    with the diagonal D (docs/physics.md).
    """
    return 0.5 * robot.wheel_radius * robot.mass * GRAVITY * turn.slip


def robot_outline(robot: Robot) -> FloatArray:
    """Return the (2, 3) lowest and highest coordinates of hull and tyres in the base frame [m]."""
    centre = np.array(robot.body_centre)
    half = 0.5 * np.array(robot.body_size)
    axles = np.array([0.0, 0.0, robot.axle_height])
    ahead = 0.5 * robot.wheelbase + robot.wheel_radius
    aside = 0.5 * (robot.track + robot.wheel_width)
    reach = np.array([ahead, aside, robot.wheel_radius])
    lowest = np.minimum(centre - half, axles - reach)
    highest = np.maximum(centre + half, axles + reach)
    return np.array([lowest, highest])


# ----------------------------------------------------------------------------- in MuJoCo
@dataclass(frozen=True)
class Measured:
    """Measurements on a robot's MuJoCo model."""

    multiplier: float | None
    """Yaw rate that the wheels ask for over that of the body, turning on the spot [1]; None without
    a whole turn."""
    ripple: float | None
    """Range of the yaw rate over its mean in that turn [1]."""
    lifted_share: float
    """Share of the time of that turn in which a wheel was off the ground [1]."""
    loads: tuple[float, ...]
    """Loads of the four wheels at rest on level ground [N], in the order of `WHEELS`."""
    apparent_mass: float
    """Constant thrust over acceleration [kg]: the mass, and the inertia of wheels and rotors over
    the radius squared."""


def measure_robot(robot: Robot) -> Measured:
    """Return measurements on the robot's MuJoCo model.

    The turn has motors without limit and delay, much stiffer than the robot's own and with rotors
    that are not light: it shows the robot, not them.

    Raises:
        ValueError: no model can be built of the robot's numbers; the message says why.
        DivergedError: the simulator gave up.
    """
    calibration = Calibration.of(robot)
    plant = MujocoPlant(calibration, robot.motor_drive)
    loads = _standing_loads(plant)
    turn = _slow_spin(calibration)
    return Measured(
        multiplier=turn.get("multiplier"),
        ripple=turn.get("ripple"),
        lifted_share=turn["lifted_share"],
        loads=loads,
        apparent_mass=apparent_mass(plant.model),
    )


def _standing_loads(plant: MujocoPlant) -> tuple[float, ...]:
    """Return the mean loads of the four wheels of a robot that stands [N]."""
    period = plant.dt * max(round(SAMPLE / plant.dt), 1)
    zeros = np.zeros((round(_STAND_TIME / period), 2))
    standing = plant.run(Commands(period, zeros), State(), period)
    loads = standing.channels["wheel_load_N"][len(standing.t) // 2 :].mean(axis=0)
    return tuple(map(float, loads))


def _slow_spin(calibration: Calibration) -> dict[str, float]:
    """Return the measures of a slow turn on the spot with stiff motors, by name."""
    radius = calibration.wheel_radius
    half_track = calibration.half_track
    size = calibration.mass * radius**2
    # a stiff motor makes a light wheel tremble
    armature = max(calibration.armature, ROTOR_SHARE * size)
    side_inertia = 0.5 * size + 2.0 * armature
    gain = max(calibration.gain, side_inertia / _STIFF_TIME)
    # the step must divide the period of samples
    step = SAMPLE / math.ceil(SAMPLE / calibration.timestep - 1e-9)
    stiff = replace(calibration, timestep=step, armature=armature, gain=gain)
    rate = _RIM_SPEED * math.sqrt(GRAVITY * radius) / half_track
    multiplier = min(closed_form(calibration).multiplier, 10.0)
    turn_time = _TURNS * 2.0 * math.pi * multiplier / rate
    seconds = 0.05 * math.ceil((SPIN_LEAD + turn_time) / 0.05)
    free = free_drive(calibration.robot)
    motion = spin(MujocoPlant(stiff, free), seconds, rate)
    return measure_spin(motion, stiff)


def guessed(robot: Robot) -> list[str]:
    """Return the numbers of body, wheels and motors that nobody has measured or published.

    Each is a key `section.name`.
    """
    return [key for key in _MEASURABLE if robot.source(key)[0] == "assumed"]
