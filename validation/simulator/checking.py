"""Checks of a robot against its file's description: by mechanics, without any simulation, and as its MuJoCo model moves."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ssmr.robot.ground import FRONT, LEFT, SkidTurn, turn_on_the_spot
from ssmr.robot.vehicle import Drive
from ssmr.types import Commands, FloatArray, State
from validation.simulator.calibration import Calibration
from validation.simulator.description import GRAVITY, ROTOR_SHARE, WHEELS, Robot
from validation.simulator.health import apparent_mass
from validation.simulator.plant import MujocoPlant
from validation.simulator.turning import SAMPLE, SPIN_LEAD, closed_form, measure_spin, spin

MULTIPLIER_LIMIT = 0.02
"""Deviation of the multiplier from its closed form that a robot may have [1]."""
DRIVER_LIMIT = 0.25
"""Deviation of the body's yaw rate from the commanded one that is not worth a word [1]."""
DENSITIES = (30.0, 6000.0)
"""Masses a cubic metre of hull between which robots are [kg/m³]: an empty box of sheet, and steel
that fills most of it."""
MOST_SPARE = 100.0
"""Torque of motors over what turns the robot on the spot on ground of friction 1, beyond which it
is asked about [1]."""
_RIM_SPEED = 0.13
"""Speed of the rims in the measured turn over sqrt(g r) [1]: slow enough for mechanics without
inertia, and alike for robots of every size (Froude's similarity)."""
_TURNS = 2.2
"""Turns that mechanics expects in the measured time [1]; the motors lag a little behind."""
_STIFF_TIME = 2e-4
"""Time constant of the measuring motors [s]: a seventieth of what robots have. Wheels that have a
motor each, of which one skids and the other rolls, then turn alike to within half a percent."""
_STAND_TIME = 2.0
"""Time for which the robot stands before its loads are read [s]; the simulator has let it settle
before."""


# ------------------------------------------------------------------------------------------- by
# mechanics
def whole_com(robot: Robot) -> tuple[float, float, float]:
    """Return the centre of mass of the whole robot, wheels included, in the base frame [m]."""
    share = robot.base_mass / robot.masses.total
    x, y, z = robot.masses.com
    return share * x, share * y, share * z + (1.0 - share) * robot.geometry.axle_height


def load_shares(robot: Robot) -> FloatArray:
    """Return the (4,) wheel loads over the weight [1] on equal springs and level ground, in the order of `WHEELS`.

    A negative one says that the robot would fall over that wheel's opposite.
    """
    x, y, _ = whole_com(robot)
    ahead = x * FRONT / (0.5 * robot.geometry.wheelbase)
    aside = y * LEFT / (0.5 * robot.geometry.track)
    shares: FloatArray = 0.25 * (1.0 + ahead + aside)
    return shares


def spot_turn(robot: Robot) -> SkidTurn | None:
    """Return the quasi-static turn on the spot of a robot; None where its wheels do not carry it."""
    g, (x, y, _) = robot.geometry, whole_com(robot)
    return turn_on_the_spot(g.wheelbase, g.track, x, y) if load_shares(robot).min() >= 0.0 else None


def turning_torque(robot: Robot, turn: SkidTurn) -> float:
    """Return the torque of either side in a turn on the spot on ground of friction 1, without losses [N m].

    What the tyres of loads N and slips s dissipate, mu N |s| each, the two sides have to give. The
    forces along the robot cancel, so both give half of it: r mu sum(N |s|) / 2 is the torque of a
    side whose rims roll at 1 m/s. For a centre of mass in the middle that is r mu (m g / 2) L / D
    with the diagonal D (docs/physics.md).
    """
    return 0.5 * robot.geometry.wheel_radius * robot.masses.total * GRAVITY * turn.slip


def robot_outline(robot: Robot) -> FloatArray:
    """Return the (2, 3) lowest and highest coordinates of hull and tyres in the base frame [m]."""
    g = robot.geometry
    centre = np.array(g.body_centre)
    half = 0.5 * np.array(g.body_size)
    reach = np.array(
        [0.5 * g.wheelbase + g.wheel_radius, 0.5 * (g.track + g.wheel_width), g.wheel_radius]
    )
    wheels = np.array([0.0, 0.0, g.axle_height])
    return np.array(
        [np.minimum(centre - half, wheels - reach), np.maximum(centre + half, wheels + reach)]
    )


# ------------------------------------------------------------------------------------------- in
# MuJoCo
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
    """Constant thrust over acceleration [kg]: the mass, and what turns with the wheels over the
    radius squared."""


def measure_robot(robot: Robot) -> Measured:
    """Return what the robot's MuJoCo model shows.

    The turn has motors without limit and delay, much stiffer than the robot's own and with rotors
    that are not light: it shows the robot, not them.

    Raises:
        ValueError: no model can be built of the robot's numbers; the message says why.
        DivergedError: the simulator gave up.
    """
    calibration = Calibration.of(robot)
    own = MujocoPlant(calibration, robot.motor_drive)
    period = own.dt * max(round(SAMPLE / own.dt), 1)
    standing = own.run(
        Commands(period, np.zeros((round(_STAND_TIME / period), 2))), State(), period
    )
    loads = standing.channels["wheel_load_N"][len(standing.t) // 2 :].mean(axis=0)
    # one that divides the period of samples
    step = SAMPLE / math.ceil(SAMPLE / calibration.timestep - 1e-9)
    radius = calibration.wheel_radius
    half_track = calibration.half_track
    size = calibration.mass * radius**2
    # a stiff motor makes a light wheel tremble
    armature = max(calibration.armature, ROTOR_SHARE * size)
    inertia = 0.5 * size + 2.0 * armature  # of a side
    stiff = replace(
        calibration,
        timestep=step,
        armature=armature,
        gain=max(calibration.gain, inertia / _STIFF_TIME),
    )
    rate = _RIM_SPEED * math.sqrt(GRAVITY * radius) / half_track
    turn = _TURNS * 2.0 * math.pi * min(closed_form(calibration).multiplier, 10.0) / rate
    free = Drive(
        math.inf,
        math.inf,
        0.0,
        0.0,
        0.05,
        command_half_track=half_track,
        command_radius=radius,
        torque_limit=math.inf,
    )
    spun = measure_spin(
        spin(MujocoPlant(stiff, free), 0.05 * math.ceil((SPIN_LEAD + turn) / 0.05), rate), stiff
    )
    return Measured(
        spun.get("multiplier"), spun.get("ripple"), spun["lifted_share"], tuple(map(float, loads)),
        apparent_mass(own.model),
    )  # fmt: skip


# ------------------------------------------------------------------------------------------- advice
def advise(
    robot: Robot, spot: SkidTurn | None, measured: Measured | str
) -> tuple[list[str], list[str]]:
    """Return what is wrong with a robot and what would be right, and what deserves a second look; a sentence for each.

    Args:
        robot: the robot.
        spot: its turn on the spot by mechanics.
        measured: what its model shows, or why there is none.
    """
    faults = _parts_faults(robot) | ({} if spot is None else _motor_faults(robot, spot))
    faults |= {measured: True} if isinstance(measured, str) else _moving_faults(spot, measured)
    wrong, questions = (
        [text for text, applies in each.items() if applies]
        for each in (faults, _questions(robot, spot))
    )
    return wrong, questions


def guessed(robot: Robot) -> list[str]:
    """Return the numbers of body, wheels and motors that nobody has measured or published, as `section.key`."""
    keys = [
        f"geometry.{name}"
        for name in ("wheelbase", "track", "wheel_radius", "wheel_width", "body_size")
    ]
    keys += [f"mass.{name}" for name in ("total", "wheel", "wheel_inertia", "com", "inertia")]
    keys += ["simulation.friction", "simulation.gain", "simulation.armature", "drive.torque_limit"]
    return [key for key in keys if robot.source(key)[0] == "assumed"]


def _parts_faults(robot: Robot) -> dict[str, bool]:
    """Return what can be wrong with lengths and masses, and whether it is; what no model can have, its builder says."""
    g = robot.geometry
    m = robot.masses
    shares = load_shares(robot)
    bottom = g.body_centre[2] - 0.5 * g.body_size[2] + g.base_height
    spin = m.wheel_inertia[1]
    most = m.wheel * g.wheel_radius**2
    wheel, (x, y, _) = WHEELS[int(np.argmin(shares))].replace("_", " "), whole_com(robot)
    used = 2.0 * abs(x) / g.wheelbase + 2.0 * abs(y) / g.track
    outside = {
        f"the centre of mass lies outside of the robot: {axis} is {com:g} m, hull and tyres reach from {low:.3g} "
        f"to {high:.3g} m": not low <= com <= high
        for axis, com, low, high in zip("xyz", m.com, *robot_outline(robot), strict=True)
    }
    return outside | {
        f"the hull reaches {-1e3 * bottom:.0f} mm below the ground: with tyres of {g.wheel_radius:g} m and axles at "
        f"{g.axle_height:g} m, the base frame is {g.base_height:.4g} m above it; correct axle_height or body_centre": (
            bottom < -1e-6
        ),
        f"no wheel of {m.wheel:g} kg and {g.wheel_radius:g} m has {spin:.4g} kg m2 about its axle: the most is "
        f"m r^2 = {most:.4g}": spin > most * (1.0 + 1e-9),
        f"the {wheel} wheel carries nothing: the whole robot's centre of mass is {x:.3g} m ahead and {y:.3g} m to the "
        f"left of the middle, and 2 |x| / wheelbase + 2 |y| / track must be less than 1, not {used:.2f}": (
            bool(shares.min() <= 0.0)
        ),
    }


def _motor_faults(robot: Robot, spot: SkidTurn) -> dict[str, bool]:
    """Return the same of the motors."""
    mu = robot.simulation.friction
    loss = robot.drive.gear_loss
    has = 2.0 * robot.drive.torque_limit
    torque = turning_torque(robot, spot)
    needed = mu * torque + loss
    return {
        f"it cannot turn on the spot on ground of friction {mu:g}: a side needs {needed:.4g} N m and its motors give "
        f"{has:.4g} N m; torque_limit must be at least {0.5 * needed:.4g} N m a wheel, or friction at most "
        f"{(has - loss) / torque:.2g}": needed > has
    }


def _moving_faults(spot: SkidTurn | None, measured: Measured) -> dict[str, bool]:
    """Return the same of how the model moves."""
    multiplier = measured.multiplier or math.nan
    expected = math.nan if spot is None else spot.multiplier
    return {
        "the simulated robot did not turn once on the spot in twice the time that mechanics allows it": (
            measured.multiplier is None
        ),
        f"the simulated robot turns with a multiplier of {multiplier:.3f}, and mechanics says {expected:.3f}: keep the "
        "usual wheel_shape and timestep": abs(multiplier / expected - 1.0) > MULTIPLIER_LIMIT,
        f"a wheel leaves the ground in {100.0 * measured.lifted_share:.0f} % of a slow turn on the spot: move the centre "
        "of mass to the middle and down, or lower the friction": measured.lifted_share > 0.0,
    }


def _questions(robot: Robot, spot: SkidTurn | None) -> dict[str, bool]:
    """Return what deserves a second look, and whether it applies."""
    drive = robot.drive
    guesses = guessed(robot)
    torque = 0.0 if spot is None else turning_torque(robot, spot)
    rims = (
        0.0 if spot is None else robot.geometry.wheel_radius / drive.command_radius * spot.yaw_rate
    )
    turned = drive.command_half_track * rims  # yaw rate over the wanted one
    endless = not math.isfinite(drive.torque_limit)
    g = robot.geometry
    length, width, height = g.body_size
    density = (robot.masses.total - 4.0 * robot.masses.wheel) / (length * width * height)
    return {
        f"the body has {density:.3g} kg a cubic metre of its hull, and water has 1000: are masses in kg and lengths in m?": (
            not DENSITIES[0] < density < DENSITIES[1]
        ),
        f"the hull of {length:.3g} x {width:.3g} x {height:.3g} m is smaller than a wheel: is it an antenna or a sensor? "
        "Measure the body, and say body_size and body_centre": (
            length < 2.0 * g.wheel_radius or width < g.wheel_width or height < 0.2 * g.wheel_radius
        ),
        "geometry.wheel_radius is a guess: count the wheels' turns over a straight metre, for every speed scales with "
        "it": "geometry.wheel_radius" in guesses,
        "mass.total is a guess: weigh the robot, for every force scales with it": "mass.total"
        in guesses,
        "no torque_limit is given, so it can turn on any ground: say that of one wheel [N m]": endless,
        f"torque_limit is {drive.torque_limit:.3g} N m a wheel, and {0.5 * torque:.3g} N m turn the robot on the spot on "
        "ground of friction 1: is it that of a wheel, behind the gear, in N m?": (
            not endless and 2.0 * drive.torque_limit > MOST_SPARE * torque > 0.0
        ),
        f"turning on the spot, it reaches {100.0 * turned:.0f} % of the commanded yaw rate because the wheels skid; set "
        f"command_half_track to {1.0 / (rims or 1.0):.3g} m (it is {drive.command_half_track:g} m) to correct this": (
            rims > 0.0 and abs(turned - 1.0) > DRIVER_LIMIT
        ),
    }
