"""The balance of a robot with its own physics: what short drives find, and what mechanics says.

Each row has both numbers; what they differ by has a cause, or is itself what is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import mujoco
import numpy as np

from ssmr.errors import DivergedError
from ssmr.geometry import rotate_world_to_body
from ssmr.robot.ground import FRONT, LEFT, SkidTurn, turn_on_the_spot
from ssmr.types import FloatArray, Trajectory
from validation.descriptions.own_robot import OwnRobot
from validation.simulator.checking import resting_shares
from validation.simulator.health import LIFT_SHARE

SPEEDS = (0.08, 0.25, 0.5)
"""Speeds of the rims over sqrt(g r) [1], as for robots of every size (Froude's similarity): in the
two turns on the spot, of which the second is also that of the straight drive, and in the curve."""
_LEAD = 0.8
"""Time after which a motion counts [s]."""
_TURNS = (
    (SPEEDS[0], 0.5 * math.pi, "rate of a wheel in a slow turn", 0.10),
    (SPEEDS[1], 2.0 * math.pi, "rate of a wheel in a turn", 0.05),
)
"""Speed of the rims, heading that a turn sweeps by mechanics [rad] (a pyramid is the same after a
quarter), name of its row and share of the rate that servos may lack."""
_WINDOW = math.radians(12.0)
"""Heading over which the turning ratio is a mean [rad]."""
_SLOPE = math.radians(8.0)
"""Slope on which the robot stands where its friction can hold it there with a reserve [rad]."""
_RESERVE = 0.5
"""Tangent of the slope over the friction, at most [1]."""
_STAND_TIME = 0.5
"""Duration of standing on level ground after it has come to rest [s]."""
_SLOPE_TIME = 2.0
"""Duration of standing on the slope [s]; the second half counts."""
_DRIVE_TIME = 3.0
"""Duration of the straight drive and of the curve [s]."""
_INSIDE = 0.4
"""Rate of the inner wheels in the curve over that of the outer ones [1]."""
LOADED = 0.6
"""Load at rest over a quarter of the weight below which a wheel may lift [1]."""
_UNEVEN = 0.5
"""Share of its load that a wheel may have more or less on uneven ground [1]."""
_LONGEST = 12.0
"""Greatest duration of a turn [s]."""


TURN = "turn for 90° of the wheels"
"""BalanceRow of the turn on the spot."""
ON_GROUND = "time of the wheels on the ground"
"""Row of wheels that may leave the ground."""
MOVING_MASS = "mass to set off, wheels turning"
"""Row of the mass with what turns along."""
LOADS = "load of all wheels"
"""Row of what the wheels carry together."""
ONE_WHEEL = "load of one wheel"
"""Row of a robot whose weight lies between its wheels."""
LEAST_TURN = 9.0
"""Turn for 90° of the wheels from which on it is compared by its own size [°]."""
ROLLING = "rolling"
"""First word of the row of a robot whose wheels turn on a slope."""


class BalanceRow(NamedTuple):
    """A line of the balance."""

    row: str
    """What is weighed."""
    found: float
    """What is there."""
    expected: float
    """What mechanics says."""
    unit: str
    scale: float
    """Number that the residual is a share of."""
    limit: float = 0.03
    """Greatest share that is none [1]."""
    cause: str = ""
    """What eats the difference, as far as the numbers of the file tell."""
    is_least: bool = False
    """Whether more than expected is no residual."""

    @property
    def share(self) -> float:
        """Residual as a share of `scale` [1]."""
        residual = self.found - self.expected
        return (min(residual, 0.0) if self.is_least else residual) / self.scale

    @property
    def excess(self) -> float:
        """Residual over its limit [1]: more than 1 asks for a cause."""
        return abs(self.share) / self.limit

    def as_dict(self) -> dict[str, Any]:
        """Return what robot.json has of it."""
        return self._asdict() | {"share": self.share}

    def as_text(self) -> dict[str, str]:
        """Return what a table shows of it."""
        return {
            "row": self.row,
            "measured": f"{self.found:.4g}",
            "by mechanics": f"{self.expected:.4g} {self.unit}".rstrip(),
            "difference": f"{100.0 * self.share:.1f} %",
            "cause": self.cause,
        }

    @property
    def words(self) -> str:
        """What is there and what should be."""
        return f"{self.found:.3g} for {self.expected:.3g} {self.unit}".rstrip()


Balance = Mapping[str, BalanceRow]
"""Rows by their names."""


def mechanical_turn(
    robot: OwnRobot, *, in_the_middle: bool = False, width_share: float = 1.0
) -> SkidTurn:
    """Return the turn on the spot by mechanics, with its weight where it is or in the middle.

    `width_share` is that of the tyres' width between the two points in which each touches [1].
    """
    wheeled = robot.wheeled
    half = float(np.mean([drum.contact_half_width for drum in robot.tyres]))
    # a wheel that would lift carries nothing; mechanics knows no such turn
    most = 0.499 * np.array([wheeled.wheelbase, wheeled.track])
    x, y = (0.0 if in_the_middle else np.clip(_weight_place(robot), -most, most)) * np.ones(2)
    return turn_on_the_spot(
        wheeled.wheelbase, wheeled.track, float(x), float(y), half_width=width_share * half
    )


def _weight_place(robot: OwnRobot) -> FloatArray:
    """Return how far the centre of mass is ahead and to the left of the middle, (2,) [m]."""
    wheeled = robot.wheeled
    _, centre, _ = wheeled.lump(wheeled.group(wheeled.root))
    return centre[:2]


def weigh_robot(robot: OwnRobot) -> Balance:
    """Return the balance of a robot after short trials: stand, straight, turn, curve, slope.

    What they measure is kept as its `measures`. A trial in which the simulator gives up leaves its
    rows out, and counts as `diverged`.
    """
    measures = robot.measures
    measures["diverged"] = 0.0
    measures["rolling_radius_m"] = robot.radius
    rows = []
    for trial in _TRIALS:
        try:
            rows += trial(robot)
        except DivergedError:
            measures["diverged"] += 1.0
            if trial is _weigh_standing:
                break
    done = len(_TRIALS) - measures["diverged"]
    rows.insert(0, BalanceRow("drives that the simulator ends", done, len(_TRIALS), "", 1.0))
    return {row.row: row for row in rows}


def _speed_of_froude(robot: OwnRobot, froude: float) -> float:
    """Return a rim speed [m/s] that the inputs of the servos allow."""
    return min(froude * robot.speed_unit, 0.95 * robot.top_rate * robot.radius)


def _rest_row(robot: OwnRobot, name: str, speed: float, limit: float) -> BalanceRow:
    """Return the row of a speed [m/s] at which it should stand."""
    return BalanceRow(name, 1e3 * speed, 0.0, "mm/s", 1e3 * robot.speed_unit, limit)


def _weigh_standing(robot: OwnRobot) -> list[BalanceRow]:
    """Stand on level ground: weight against the loads, each load against its share, and rest."""
    robot.settle()
    standing = robot.ride((0.0, 0.0), _STAND_TIME)
    robot.loads = loads = standing.channels["wheel_load_N"].mean(axis=0)
    weight = robot.mass * robot.gravity
    wheeled = robot.wheeled
    shares = weight * resting_shares(wheeled.wheelbase, wheeled.track, *_weight_place(robot))
    others = robot.other_contacts()
    cause = f"also touching: {others}" if others else ""
    # of the file's own rotors
    dofs = wheeled.model.jnt_dofadr[wheeled.joints]
    armature = wheeled.model.dof_armature[dofs]
    mass = robot.mass
    turning = wheeled.model.dof_M0[dofs] - armature
    moving = mass + float(turning.sum()) / robot.radius**2
    rotors = float(armature.sum()) / robot.radius**2
    eater = "armature of the wheels' joints" if rotors > 0.0 else ""
    away = standing.pose[-1, :2] - standing.pose[0, :2]
    rows = [
        BalanceRow(LOADS, float(loads.sum()), weight, "N", weight, cause=cause),
        BalanceRow(
            MOVING_MASS,
            moving + rotors,
            moving,
            "kg",
            mass,
            limit=1.0,
            cause=eater,
        ),
        _rest_row(robot, "speed at rest", float(np.hypot(*away)) / _STAND_TIME, 0.0003),
    ]
    if shares.min() <= 0.0:
        return rows
    # how four wheels share beyond this is left open by mechanics
    for name, side in (("front", FRONT > 0.0), ("left", LEFT > 0.0)):
        found = float(loads[side].sum())
        share = float(shares[side].sum())
        rows.append(
            BalanceRow(f"load of the {name} wheels", found, share, "N", 0.5 * weight, cause=cause)
        )
    worst = int(np.abs(loads - shares).argmax())
    share = float(shares[worst])
    cause = cause or robot.names[worst]
    one = BalanceRow(ONE_WHEEL, float(loads[worst]), share, "N", share, limit=_UNEVEN, cause=cause)
    return [*rows, one]


def _weigh_straight_line(robot: OwnRobot) -> list[BalanceRow]:
    """Drive straight ahead: rolling radius, deviation, and how smooth the loads are."""
    rate = _speed_of_froude(robot, SPEEDS[1]) / robot.radius
    ride = robot.ride((rate, rate), _DRIVE_TIME)
    tail = ride.t > _LEAD
    start = ride.pose[tail][0]
    ahead, aside = rotate_world_to_body(ride.pose[-1, :2] - start[:2], float(start[2])).tolist()
    turned = _mean_rate(ride, tail) * float(ride.t[-1] - ride.t[tail][0])
    loads = ride.channels["wheel_load_N"][tail].sum(axis=1)
    robot.measures["load_ripple_share"] = float(loads.std()) / (robot.mass * robot.gravity)
    radius = robot.radius
    rolling = 0.0
    veer = 0.0
    if ahead > 0.2 * radius and turned > 0.0:
        robot.measures["rolling_radius_m"] = rolling = ahead / turned
        veer = abs(aside / ahead)
    # tyres that sink roll on less
    expected = min(max(rolling, radius - robot.sinking), radius)
    return [
        BalanceRow("radius by the way ahead", rolling, expected, "m", radius),
        BalanceRow("drift over way ahead", veer, 0.0, "", 1.0, 0.02),
    ]


def _mean_rate(motion: Trajectory, tail: Any) -> float:
    """Return the mean rate of all wheels over a part of a motion [rad/s]."""
    return float(motion.channels["wheel_rad_s"][tail].mean())


def _weigh_turns(robot: OwnRobot) -> list[BalanceRow]:
    """Turn on the spot slowly, and faster over all headings."""
    turn = mechanical_turn(robot)
    track = robot.wheeled.track
    # left wheels of the axles that are driven: others only roll along
    axles = 2 * np.flatnonzero(robot.driven.reshape(2, 2).all(axis=1))
    if not len(axles):
        axles = np.array([0, 2])
    rows = []
    droops = []
    for froude, sweep, name, limit in _TURNS:
        speed = _speed_of_froude(robot, froude)
        rate = speed / robot.radius
        seconds = min(_LEAD + 1.1 * sweep * 0.5 * track * turn.multiplier / speed, _LONGEST)
        ride = robot.ride((-rate, rate), seconds)
        turning = ride.channels["wheel_rad_s"][ride.t > _LEAD]
        wheels = 0.5 * (turning[:, axles + 1] - turning[:, axles]).mean(axis=1)
        droops.append(1.0 - float(wheels.mean()) / rate)
        each = turning.mean(axis=0) * -LEFT
        slowest = float(each[robot.driven].min(initial=rate))
        rows.append(BalanceRow(name, slowest, rate, "rad/s", rate, limit))
    rims = robot.measures["rolling_radius_m"] * wheels
    turned = _weigh_turn(robot, ride, rims)
    robot.measures |= {
        "closed_form": turn.multiplier,
        "droop": max(droops),
        "droop_at_speed": droops[-1],
    }
    if robot.given_rates:
        return turned
    motor = _weigh_motors(robot, rate)
    return [motor, *[row._replace(cause=motor.cause) for row in rows], *turned]


def needed_torques(robot: OwnRobot) -> FloatArray:
    """Return the (4,) torques of wheels in a turn on the spot by mechanics [N m], without losses.

    They are mu N r s, with the mean slip s of tyres whose rims roll at 1 m/s.
    """
    loads = np.maximum(robot.loads, 0.0)
    return robot.frictions * loads * robot.radius * mechanical_turn(robot).slip


def _weigh_motors(robot: OwnRobot, rate: float) -> BalanceRow:
    """Return what the weakest motor can give against what ground and joint take of it."""
    ground = needed_torques(robot)
    model = robot.model
    losses = {
        "ground": ground,
        "damping": model.dof_damping[robot.dofs] * rate,
        "dry friction": model.dof_frictionloss[robot.dofs],
    }
    needed = np.sum(list(losses.values()), axis=0)
    # no motor without a servo of rates comes here
    gives = np.minimum(rate * robot.of_wheels("gain", np.inf), robot.of_wheels("effort", np.inf))
    worst = int(np.where(robot.driven, gives - needed, np.inf).argmin())
    parts = [f"{name} {take[worst]:.3g}" for name, take in losses.items() if take[worst] > 0.0]
    cause = f"{robot.names[worst]}: {', '.join(parts)}"
    need = float(needed[worst])
    has = float(gives[worst])
    return BalanceRow(
        "torque of a motor", has, need, "N m", need or 1.0, cause=cause, is_least=True
    )


def _weigh_turn(robot: OwnRobot, ride: Trajectory, rims: FloatArray) -> list[BalanceRow]:
    """Weigh a turn against its closed form, at all headings, and where it takes the middle.

    Args:
        robot: the robot.
        ride: a turn on the spot.
        rims: (m,) mean speed of the rims after the lead [m/s].
    """
    tail = ride.t > _LEAD
    quarter = 0.25 * robot.mass * robot.gravity
    lifted = (ride.channels["wheel_load_N"][tail] < LIFT_SHARE * quarter).mean(axis=0)
    yaw = ride.pose[tail, 2] - ride.pose[tail][0, 2]
    xy = ride.pose[tail, :2]
    measures = robot.measures
    # a wheel that the weight leaves with little load lifts without hopping
    in_air = float(np.where(robot.loads > LOADED * quarter, lifted, 0.0).max())
    sideways = float(np.hypot(*(xy - xy[0]).T).max())
    measures |= {"lifted_share": in_air, "sideways_m": sideways}
    turned = float(yaw[-1])
    ratio = math.inf
    ratios = np.empty(0)
    if turned >= 0.1:
        means = 0.5 * (rims[1:] + rims[:-1]) * np.diff(ride.t[tail])
        swept = np.append(0.0, np.cumsum(means)) / (0.5 * robot.wheeled.track)
        measures["multiplier"] = ratio = float(swept[-1]) / turned
        rising = np.maximum.accumulate(yaw) + 1e-12 * np.arange(len(yaw))
        ratios = np.diff(np.interp(np.arange(0.0, turned, _WINDOW), rising, swept)) / _WINDOW
    # tyres that touch in a line may do so at its ends or in its middle
    turns = [mechanical_turn(robot, width_share=share) for share in (0.0, 1.0)]
    bounds = sorted(90.0 / turn.multiplier for turn in turns)
    found = 90.0 / ratio
    expected = min(max(found, bounds[0]), bounds[1])
    rows = [
        BalanceRow(TURN, found, expected, "°", max(expected, LEAST_TURN)),
        BalanceRow(ON_GROUND, 1.0 - in_air, 1.0, "", 1.0, 0.01),
    ]
    if len(ratios) > 2:
        low = float(ratios.min())
        high = float(ratios.max())
        measures |= {"multiplier_min": low, "multiplier_max": high}
        reach = 2.0 * math.hypot(turns[1].forward, turns[1].across) / turns[1].yaw_rate
        reach *= math.sin(0.5 * min(turned, math.pi))
        size = robot.wheeled.track + reach
        if expected > LEAST_TURN:
            rows += [
                BalanceRow("turning ratio at the worst heading", high, low, "", ratio, 0.05),
                BalanceRow("way of the middle in the turn", sideways, reach, "m", size),
            ]
    return rows if robot.driven.all() else []


def _drive_curve(robot: OwnRobot) -> list[BalanceRow]:
    """Drive a curve, with its own step and with half of it."""
    rate = _speed_of_froude(robot, SPEEDS[2]) / robot.radius
    rates = (_INSIDE * rate, rate)
    ride = robot.ride(rates, _DRIVE_TIME)
    tail = ride.t > _LEAD
    measures = robot.measures
    rims = measures["rolling_radius_m"] * _mean_rate(ride, tail)
    if rims > 0.0:
        speeds = np.convolve(ride.twist[tail, 0], np.full(10, 0.1), "valid")
        measures["surge_share"] = float(speeds.max()) / rims - 1.0
    finer = mujoco.MjModel.__copy__(robot.model)
    finer.opt.timestep *= 0.5
    half = robot.ride(rates, _DRIVE_TIME, finer)
    away = float(np.hypot(*(half.pose[-1] - ride.pose[-1])[:2]))
    measures["step_halved_m"] = away
    way = max(rims * _DRIVE_TIME, 0.05)
    return [BalanceRow("end of a curve by half the step", away, 0.0, "m", way, 0.05)]


def _weigh_slopes(robot: OwnRobot) -> list[BalanceRow]:
    """Stand on a slope that friction can hold, along and across: rolling is told from sliding."""
    measures = robot.measures
    slope = min(_SLOPE, math.atan(_RESERVE * robot.frictions.min()))
    slides = []
    rolls = []
    for direction in robot.wheeled.turn[:2]:
        model = mujoco.MjModel.__copy__(robot.model)
        down = robot.gravity * math.sin(slope) * direction
        model.opt.gravity = down + math.cos(slope) * robot.model.opt.gravity
        ride = robot.ride((0.0, 0.0), _SLOPE_TIME, model)
        tail = ride.t > 0.5 * _SLOPE_TIME
        seconds = float(ride.t[-1] - ride.t[tail][0])
        slides.append(float(np.hypot(*(ride.pose[-1] - ride.pose[tail][0])[:2])) / seconds)
        rolls.append(measures["rolling_radius_m"] * abs(_mean_rate(ride, tail)))
    slide = max(slides[0] - rolls[0], slides[1])
    measures |= {"creep_m_s": max(slide, 0.0), "rolls_m_s": rolls[0]}
    on_slope = f"on {math.degrees(slope):.0f}°"
    rows = [_rest_row(robot, f"sliding {on_slope}", measures["creep_m_s"], 0.0007)]
    if not robot.given_rates:
        rows.append(_rest_row(robot, f"{ROLLING} {on_slope}", rolls[0], 0.0025))
    return rows


_TRIALS = (_weigh_standing, _weigh_straight_line, _weigh_turns, _drive_curve, _weigh_slopes)


def in_words(robot: OwnRobot) -> str:
    """Return what the trials say, in the words of people who ask."""
    measures = robot.measures
    if "multiplier" not in measures:
        return "It does not turn on the spot at all."
    middle = mechanical_turn(robot, in_the_middle=True).multiplier
    expected = measures["closed_form"]
    factors = {
        "wheels that lag behind their rates": 1.0 - measures["droop_at_speed"],
        "skidding, as on a real robot,": 1.0 / middle,
        "weight off the middle": middle / expected,
        "contacts, which hop or depend on the heading,": expected / measures["multiplier"],
    }
    left = 90.0
    parts = []
    for name, factor in factors.items():
        lost = left * (1.0 - factor)
        left -= lost
        if abs(lost) >= 1.0:
            parts.append(f"{name} {'take' if lost > 0.0 else 'give back'} {abs(lost):.0f}°")
    text = f"It turns {left:.0f}° for 90° on its wheels: {', '.join(parts) or 'nothing is lost'}"
    if measures["lifted_share"] > 0.01:
        text += f"; a wheel is off the ground {100.0 * measures['lifted_share']:.0f} % of the time"
    return text + "."
