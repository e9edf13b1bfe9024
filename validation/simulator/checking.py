"""Checks of a robot's numbers: by mechanics without a simulation, and on its MuJoCo model."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ssmr.robot.ground import FRONT, LEFT, SkidTurn, turn_on_the_spot
from ssmr.types import Commands, FloatArray, State
from validation.simulator.calibration import Calibration
from validation.simulator.description import (
    GRAVITY,
    ROTOR_SHARE,
    WHEELS,
    Robot,
    Vector3,
    free_drive,
)
from validation.simulator.health import apparent_mass
from validation.simulator.plant import MujocoPlant
from validation.simulator.turning import SAMPLE, SPIN_LEAD, closed_form, measure_spin, spin

MULTIPLIER_LIMIT = 0.02
"""Deviation of the multiplier from its closed form that a robot may have [1]."""
DRIVER_LIMIT = 0.25
"""Deviation of the body's yaw rate from the commanded one that raises no question [1]."""
DENSITIES = (30.0, 6000.0)
"""Masses a cubic metre of hull between which robots are [kg/m³]: an empty box of sheet, and steel
that fills most of it."""
MOST_SPARE = 100.0
"""Torque of motors over that of a turn on the spot on ground of friction 1, beyond which it raises
a question [1]."""
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


# ----------------------------------------------------------------------------- advice
def advise(
    robot: Robot, spot: SkidTurn | None, measured: Measured | str
) -> tuple[list[str], list[str]]:
    """Return the faults of a robot and the questions that it raises, a sentence for each.

    Args:
        robot: the robot.
        spot: its turn on the spot by mechanics.
        measured: measurements on its model, or why there is none.
    """
    faults = list(_parts_faults(robot))
    if spot is not None:
        faults += _motor_faults(robot, spot)
    if isinstance(measured, str):
        faults.append(measured)
    else:
        faults += _moving_faults(spot, measured)
    return faults, list(_questions(robot, spot))


def guessed(robot: Robot) -> list[str]:
    """Return the numbers of body, wheels and motors that nobody has measured or published.

    Each is a key `section.name`.
    """
    return [key for key in _MEASURABLE if robot.source(key)[0] == "assumed"]


def _parts_faults(robot: Robot) -> Iterator[str]:
    """Yield the faults of lengths and masses with which a model can still be built."""
    lowest, highest = robot_outline(robot)
    for axis, com, low, high in zip("xyz", robot.com, lowest, highest, strict=True):
        if not low <= com <= high:
            yield (
                f"the centre of mass lies outside of the robot: {axis} is {com:g} m, "
                f"hull and tyres reach from {low:.3g} to {high:.3g} m"
            )
    bottom = robot.body_centre[2] - 0.5 * robot.body_size[2] + robot.base_height
    if bottom < -1e-6:
        yield (
            f"the hull reaches {-1e3 * bottom:.0f} mm below the ground: with tyres of "
            f"{robot.wheel_radius:g} m and axles at {robot.axle_height:g} m, the base frame is "
            f"{robot.base_height:.4g} m above it; correct axle_height or body_centre"
        )
    spin_inertia = robot.wheel_inertia[1]
    # all the mass at the rim
    most = robot.wheel_mass * robot.wheel_radius**2
    if spin_inertia > most * (1.0 + 1e-9):
        yield (
            f"no wheel of {robot.wheel_mass:g} kg and {robot.wheel_radius:g} m has "
            f"{spin_inertia:.4g} kg m2 about its axle: the most is m r^2 = {most:.4g}"
        )
    shares = load_shares(robot)
    if shares.min() <= 0.0:
        x, y, _ = whole_com(robot)
        wheel = WHEELS[int(np.argmin(shares))].replace("_", " ")
        used = 2.0 * abs(x) / robot.wheelbase + 2.0 * abs(y) / robot.track
        yield (
            f"the {wheel} wheel carries nothing: the whole robot's centre of mass is {x:.3g} m "
            f"ahead and {y:.3g} m to the left of the middle, and 2 |x| / wheelbase + "
            f"2 |y| / track must be less than 1, not {used:.2f}"
        )


def _motor_faults(robot: Robot, spot: SkidTurn) -> Iterator[str]:
    """Yield a fault where the motors are too weak for the robot's ground."""
    mu = robot.friction
    loss = robot.drive.gear_loss
    limit = 2.0 * robot.drive.torque_limit
    torque = turning_torque(robot, spot)
    needed = mu * torque + loss
    if needed > limit:
        yield (
            f"it cannot turn on the spot on ground of friction {mu:g}: a side needs "
            f"{needed:.4g} N m and its motors give {limit:.4g} N m; torque_limit must be at least "
            f"{0.5 * needed:.4g} N m a wheel, or friction at most {(limit - loss) / torque:.2g}"
        )


def _moving_faults(spot: SkidTurn | None, measured: Measured) -> Iterator[str]:
    """Yield the faults of the moving model."""
    multiplier = measured.multiplier
    if multiplier is None:
        yield (
            "the simulated robot did not turn once on the spot in twice the time that mechanics "
            "allows it"
        )
    elif spot is not None and abs(multiplier / spot.multiplier - 1.0) > MULTIPLIER_LIMIT:
        yield (
            f"the simulated robot turns with a multiplier of {multiplier:.3f}, and mechanics says "
            f"{spot.multiplier:.3f}: keep the usual wheel_shape and timestep"
        )
    if measured.lifted_share > 0.0:
        yield (
            f"a wheel leaves the ground in {100.0 * measured.lifted_share:.0f} % of a slow turn on "
            "the spot: move the centre of mass to the middle and down, or lower the friction"
        )


def _questions(robot: Robot, spot: SkidTurn | None) -> Iterator[str]:
    """Yield questions about numbers that are possible and not likely."""
    length, width, height = robot.body_size
    density = (robot.mass - 4.0 * robot.wheel_mass) / (length * width * height)
    if not DENSITIES[0] < density < DENSITIES[1]:
        yield (
            f"the body has {density:.3g} kg a cubic metre of its hull, and water has 1000: "
            "are masses in kg and lengths in m?"
        )
    if (
        length < 2.0 * robot.wheel_radius
        or width < robot.wheel_width
        or height < 0.2 * robot.wheel_radius
    ):
        yield (
            f"the hull of {length:.3g} x {width:.3g} x {height:.3g} m is smaller than a wheel: "
            "is it an antenna or a sensor? Measure the body, and say body_size and body_centre"
        )
    guesses = guessed(robot)
    if "geometry.wheel_radius" in guesses:
        yield (
            "geometry.wheel_radius is a guess: count the wheels' turns over a straight metre, "
            "for every speed scales with it"
        )
    if "mass.total" in guesses:
        yield "mass.total is a guess: weigh the robot, for every force scales with it"
    limit = robot.drive.torque_limit
    if math.isinf(limit):
        yield "no torque_limit is given, so it can turn on any ground: say that of one wheel [N m]"
    if spot is not None:
        yield from _turning_questions(robot, spot)


def _turning_questions(robot: Robot, spot: SkidTurn) -> Iterator[str]:
    """Yield questions about the motors and the commands of a turn on the spot."""
    drive = robot.drive
    torque = turning_torque(robot, spot)
    if math.isfinite(drive.torque_limit) and 2.0 * drive.torque_limit > MOST_SPARE * torque > 0.0:
        yield (
            f"torque_limit is {drive.torque_limit:.3g} N m a wheel, and {0.5 * torque:.3g} N m "
            "turn the robot on the spot on ground of friction 1: is it that of a wheel, behind "
            "the gear, in N m?"
        )
    # yaw rate of the body over the difference of the commanded rim speeds
    response = robot.wheel_radius / drive.command_radius * spot.yaw_rate
    reached = drive.command_half_track * response
    if response > 0.0 and abs(reached - 1.0) > DRIVER_LIMIT:
        yield (
            f"turning on the spot, it reaches {100.0 * reached:.0f} % of the commanded yaw rate "
            f"because the wheels skid; set command_half_track to {1.0 / response:.3g} m "
            f"(it is {drive.command_half_track:g} m) to correct this"
        )
