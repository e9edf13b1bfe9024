"""The balance of a robot with its own physics: what short drives find, and what mechanics says.

Each row has both numbers; what they differ by has a cause, or is itself what is wrong.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import mujoco
import numpy as np

from ssmr.errors import DivergedError
from ssmr.robot.ground import FRONT, LEFT, SkidTurn, turn_on_the_spot
from ssmr.types import FloatArray, Trajectory
from validation.descriptions.own_robot import LOADS, Measures, OwnRobot
from validation.simulator.checking import resting_shares
from validation.simulator.health import LIFT_SHARE

SPEEDS = (0.08, 0.25, 0.5)
"""Speeds of the rims in the three turns on the spot over sqrt(g r) [1], as for robots of every size
(Froude's similarity)."""
_LEAD = 0.8
"""Time after which a motion counts [s]."""
_LEAST_YAW = 0.5 * math.pi
"""Heading that the slowest turn sweeps by mechanics [rad]: a pyramid is the same after each."""
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
_LOADED = 0.6
"""Load at rest over a quarter of the weight below which a wheel may lift [1]."""
_UNEVEN = 0.5
"""Share of its load that a wheel may have more or less on uneven ground [1]."""
_LONGEST = 12.0
"""Greatest duration of a turn [s]."""


TURN = "turn for 90° of the wheels"
"""BalanceRow of the turn on the spot."""
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


def mechanical_turn(
    robot: OwnRobot, *, in_the_middle: bool = False, width_share: float = 1.0
) -> SkidTurn:
    """Return the turn on the spot by mechanics, with its weight where it is or in the middle.

    `width_share` is that of the tyres' width between the two points in which each touches [1].
    """
    wheeled = robot.wheeled
    x, y = (0.0, 0.0) if in_the_middle else _weight_place(robot)
    half = float(np.mean([drum.contact_half_width for drum in robot.tyres if drum is not None]))
    # a wheel that would lift carries nothing; mechanics knows no such turn
    most_x = 0.499 * wheeled.wheelbase
    most_y = 0.499 * wheeled.track
    inside = (float(np.clip(x, -most_x, most_x)), float(np.clip(y, -most_y, most_y)))
    return turn_on_the_spot(
        wheeled.wheelbase, wheeled.track, *inside, half_width=width_share * half
    )


def _weight_place(robot: OwnRobot) -> tuple[float, float]:
    """Return how far the centre of mass is ahead and to the left of the middle [m]."""
    wheeled = robot.wheeled
    _, centre, _ = wheeled.lump(wheeled.group(wheeled.root))
    return float(centre[0]), float(centre[1])


def examine(robot: OwnRobot) -> Measures:
    """Return what short trials tell: stand, straight, turn, curve and half its step, slope.

    A trial in which the simulator gives up leaves its numbers out, and counts as `diverged`.
    """
    measures = robot.measures
    measures["diverged"] = 0.0
    measures["speed_unit_m_s"] = math.sqrt(robot.gravity * robot.radius)
    for trial in _TRIALS:
        try:
            measures |= trial(robot, measures)
        except DivergedError:
            measures["diverged"] += 1.0
            if trial is _stand:
                break
    return measures


def _stand(robot: OwnRobot, _: Measures) -> Measures:
    """Stand on level ground: the loads of the wheels, and how fast it moves."""
    robot.settle()
    standing = robot.ride((0.0, 0.0), _STAND_TIME)
    loads = standing.channels["wheel_load_N"].mean(axis=0)
    away = standing.pose[-1, :2] - standing.pose[0, :2]
    measures = dict(zip(LOADS, loads.tolist(), strict=True))
    return measures | {"rest_m_s": float(np.hypot(*away)) / _STAND_TIME}


def _speed(robot: OwnRobot, froude: float) -> float:
    """Return a rim speed [m/s] that the inputs of the servos allow."""
    unit = robot.measures["speed_unit_m_s"]
    return min(froude * unit, 0.95 * robot.top_rate * robot.radius)


def _straight(robot: OwnRobot, _: Measures) -> Measures:
    """Drive straight ahead: rolling radius, deviation, and how smooth the loads are."""
    rate = _speed(robot, SPEEDS[1]) / robot.radius
    ride = robot.ride((rate, rate), _DRIVE_TIME)
    tail = ride.t > _LEAD
    way = ride.pose[-1, :2] - ride.pose[tail][0, :2]
    yaw = float(ride.pose[tail][0, 2])
    ahead = float(way @ [math.cos(yaw), math.sin(yaw)])
    aside = float(way @ [-math.sin(yaw), math.cos(yaw)])
    turned = _mean_rate(ride, tail) * float(ride.t[-1] - ride.t[tail][0])
    weight = robot.mass * robot.gravity
    loads = ride.channels["wheel_load_N"][tail].sum(axis=1)
    measures = Measures(load_ripple_share=float(loads.std()) / weight)
    if ahead > 0.2 * robot.radius and turned > 0.0:
        measures["rolling_radius_m"] = ahead / turned
        measures["veer_share"] = aside / ahead
    return measures


def _mean_rate(motion: Trajectory, tail: Any) -> float:
    """Return the mean rate of all wheels over a part of a motion [rad/s]."""
    return float(motion.channels["wheel_rad_s"][tail].mean())


def _turns(robot: OwnRobot, known: Measures) -> Measures:
    """Turn on the spot at three speeds; the middle one sweeps all headings."""
    turn = mechanical_turn(robot)
    middle = mechanical_turn(robot, in_the_middle=True)
    measures = Measures(closed_form=turn.multiplier, closed_form_middle=middle.multiplier)
    radius = known.get("rolling_radius_m", robot.radius)
    track = robot.wheeled.track
    # left wheels of the axles that are driven: others only roll along
    axles = 2 * np.flatnonzero(robot.driven.reshape(2, 2).all(axis=1))
    if not len(axles):
        axles = np.array([0, 2])
    for froude, name in zip(SPEEDS, ("slow", "", "fast"), strict=True):
        speed = _speed(robot, froude)
        rate = speed / robot.radius
        yaw = 2.0 * math.pi if name == "" else _LEAST_YAW
        seconds = min(_LEAD + 1.1 * yaw * 0.5 * track * turn.multiplier / speed, _LONGEST)
        ride = robot.ride((-rate, rate), seconds)
        tail = ride.t > _LEAD
        turning = ride.channels["wheel_rad_s"][tail]
        wheels = 0.5 * (turning[:, axles + 1] - turning[:, axles]).mean(axis=1)
        label = f"droop_{name}".rstrip("_")
        measures[label] = 1.0 - float(wheels.mean()) / rate
        each = turning.mean(axis=0) * -LEFT / rate
        measures[f"reached_{name}"] = float(each[robot.driven].min(initial=1.0))
        if name == "":
            resting = [known[load] for load in LOADS]
            measures |= _turn_measures(robot, ride, radius * wheels, np.array(resting))
    measures["droop_at_speed"] = measures["droop"]
    measures["droop"] = max(measures["droop"], measures.pop("droop_slow"))
    return measures


def _turn_measures(
    robot: OwnRobot, ride: Trajectory, rims: FloatArray, resting: FloatArray
) -> Measures:
    """Return the turning ratio over all headings, hopping, and how far the middle goes.

    Args:
        robot: the robot.
        ride: a turn on the spot.
        rims: (m,) mean speed of the rims after the lead [m/s].
        resting: (4,) loads at rest [N].
    """
    tail = ride.t > _LEAD
    quarter = 0.25 * robot.mass * robot.gravity
    lifted = (ride.channels["wheel_load_N"][tail] < LIFT_SHARE * quarter).mean(axis=0)
    yaw = ride.pose[tail, 2]
    xy = ride.pose[tail, :2]
    measures = Measures(
        # a wheel that the weight leaves with little load lifts without hopping
        lifted_share=float(np.where(resting > _LOADED * quarter, lifted, 0.0).max()),
        sideways_m=float(np.hypot(*(xy - xy[0]).T).max()),
    )
    turned = float(yaw[-1] - yaw[0])
    measures["turned_rad"] = turned
    if turned < 0.1:
        return measures
    t = ride.t[tail]
    half = 0.5 * robot.wheeled.track
    swept = np.concatenate([[0.0], np.cumsum(0.5 * (rims[1:] + rims[:-1]) * np.diff(t))]) / half
    measures["multiplier"] = float(swept[-1]) / turned
    rising = np.maximum.accumulate(yaw - yaw[0])
    marks = np.arange(0.0, turned, _WINDOW)
    if len(marks) > 3:
        at = np.interp(marks, rising + 1e-12 * np.arange(len(rising)), swept)
        ratios = np.diff(at) / _WINDOW
        measures["multiplier_min"] = float(ratios.min())
        measures["multiplier_max"] = float(ratios.max())
    return measures


def _drive_curve(robot: OwnRobot, known: Measures) -> Measures:
    """Drive a curve, with its own step and with half of it."""
    rate = _speed(robot, SPEEDS[2]) / robot.radius
    rates = (_INSIDE * rate, rate)
    ride = robot.ride(rates, _DRIVE_TIME)
    tail = ride.t > _LEAD
    rims = known.get("rolling_radius_m", robot.radius) * _mean_rate(ride, tail)
    measures = Measures()
    if rims > 0.0:
        speeds = np.convolve(ride.twist[tail, 0], np.full(10, 0.1), "valid")
        measures["surge_share"] = float(speeds.max()) / rims - 1.0
    finer = mujoco.MjModel.__copy__(robot.model)
    finer.opt.timestep *= 0.5
    half = robot.ride(rates, _DRIVE_TIME, finer)
    measures["step_halved_m"] = float(np.hypot(*(half.pose[-1] - ride.pose[-1])[:2]))
    measures["curve_m"] = rims * _DRIVE_TIME
    return measures


def _slopes(robot: OwnRobot, known: Measures) -> Measures:
    """Stand on a slope, along it and across it: rolling is told from sliding."""
    g = robot.gravity
    radius = known.get("rolling_radius_m", robot.radius)
    friction = min(sliding(robot, drum.geom) for drum in filter(None, robot.tyres))
    slope = min(_SLOPE, math.atan(_RESERVE * friction))
    measures = Measures(creep_m_s=0.0, slope_rad=slope)
    for direction in robot.wheeled.turn[:2]:
        model = mujoco.MjModel.__copy__(robot.model)
        down = g * math.sin(slope) * direction
        model.opt.gravity = down + math.cos(slope) * robot.model.opt.gravity
        ride = robot.ride((0.0, 0.0), _SLOPE_TIME, model)
        tail = ride.t > 0.5 * _SLOPE_TIME
        seconds = float(ride.t[-1] - ride.t[tail][0])
        moved = float(np.hypot(*(ride.pose[-1] - ride.pose[tail][0])[:2])) / seconds
        if "rolls_m_s" not in measures:
            measures["rolls_m_s"] = radius * abs(_mean_rate(ride, tail))
            moved -= measures["rolls_m_s"]
        measures["creep_m_s"] = max(measures["creep_m_s"], moved)
    return measures


_TRIALS = (_stand, _straight, _turns, _drive_curve, _slopes)


# ------------------------------------------------------------------------- rows
def weigh_robot(robot: OwnRobot) -> dict[str, BalanceRow]:
    """Return the balance of a robot after its trials, by the names of its rows."""
    measures = robot.measures
    done = len(_TRIALS) - measures["diverged"]
    rows = [BalanceRow("drives that the simulator ends", done, len(_TRIALS), "", 1.0)]
    for weigh in (_weigh_loads, _weigh_motors, _weigh_turn, _weigh_way, _weigh_rest):
        rows += weigh(robot, measures)
    return {row.row: row for row in rows}


def _weigh_loads(robot: OwnRobot, measures: Measures) -> list[BalanceRow]:
    """Weight against the loads, and each load against its share."""
    if LOADS[0] not in measures:
        return []
    weight = robot.mass * robot.gravity
    loads = np.array([measures[load] for load in LOADS])
    wheeled = robot.wheeled
    shares = weight * resting_shares(wheeled.wheelbase, wheeled.track, *_weight_place(robot))
    others = robot.other_contacts()
    cause = f"also touching: {others}" if others else ""
    rows = [BalanceRow("load of all wheels", float(loads.sum()), weight, "N", weight, cause=cause)]
    # of the file's own rotors
    dofs = wheeled.model.jnt_dofadr[wheeled.joints]
    turning = float(robot.wheeled.model.dof_M0[dofs].sum()) / robot.radius**2
    mass = robot.mass
    rows.append(
        BalanceRow("mass to set off, wheels turning", mass + turning, mass, "kg", mass, 1.0)
    )
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
    found = float(loads[worst])
    cause = cause or robot.names[worst]
    share = float(shares[worst])
    rows.append(BalanceRow(ONE_WHEEL, found, share, "N", share, limit=_UNEVEN, cause=cause))
    return rows


def needed_torques(robot: OwnRobot) -> FloatArray:
    """Return the (4,) torques of wheels in a turn on the spot by mechanics [N m], without losses.

    They are mu N r s, with the mean slip s of tyres whose rims roll at 1 m/s.
    """
    frictions = [0.0 if drum is None else sliding(robot, drum.geom) for drum in robot.tyres]
    loads = [max(robot.measures.get(load, 0.0), 0.0) for load in LOADS]
    return np.array(frictions) * loads * robot.radius * mechanical_turn(robot).slip


def _weigh_motors(robot: OwnRobot, measures: Measures) -> list[BalanceRow]:
    """What motors can give against what ground and joints take, and the rates they reach."""
    if robot.given_rates or "reached_" not in measures:
        return []
    rate = _speed(robot, SPEEDS[1]) / robot.radius
    ground = needed_torques(robot)
    model = robot.model
    losses = {
        "damping": model.dof_damping[robot.dofs] * rate,
        "dry friction": model.dof_frictionloss[robot.dofs],
    }
    needed = ground + sum(losses.values())
    gives = np.minimum(robot.stiffnesses * rate, robot.most_torques)
    worst = int(np.where(robot.driven, gives - needed, np.inf).argmin())
    parts = [f"ground {ground[worst]:.3g}"]
    for name, torques in losses.items():
        if torques[worst] > 0.0:
            parts.append(f"{name} {torques[worst]:.3g}")
    cause = f"{robot.names[worst]}: {', '.join(parts)}"
    need = float(needed[worst])
    has = float(gives[worst])
    rows = [
        BalanceRow("torque of a motor", has, need, "N m", need or 1.0, cause=cause, is_least=True)
    ]
    for name, froude, limit in (("slow_", SPEEDS[0], 0.10), ("", SPEEDS[1], 0.05)):
        told = _speed(robot, froude) / robot.radius
        found = told * measures[f"reached_{name.strip('_')}"]
        text = f"rate of a wheel in a {name.replace('_', ' ')}turn"
        rows.append(BalanceRow(text, found, told, "rad/s", told, limit=limit, cause=cause))
    return rows


def _weigh_turn(robot: OwnRobot, measures: Measures) -> list[BalanceRow]:
    """The turn against its closed form, at all headings, and where it takes the middle."""
    if "sideways_m" not in measures or not robot.driven.all():
        return []
    # tyres that touch in a line may do so at its ends or in its middle
    turns = [mechanical_turn(robot, width_share=share) for share in (0.0, 1.0)]
    bounds = sorted(90.0 / turn.multiplier for turn in turns)
    found = 90.0 / measures.get("multiplier", math.inf)
    expected = min(max(found, bounds[0]), bounds[1])
    rows = [BalanceRow(TURN, found, expected, "°", max(expected, LEAST_TURN))]
    lifted = measures["lifted_share"]
    rows.append(BalanceRow("time of the wheels on the ground", 1.0 - lifted, 1.0, "", 1.0, 0.01))
    if "multiplier_max" in measures and expected > LEAST_TURN:
        low = measures["multiplier_min"]
        mean = measures["multiplier"]
        high = measures["multiplier_max"]
        rows.append(BalanceRow("turning ratio at the worst heading", high, low, "", mean, 0.05))
        turn = turns[1]
        reach = 2.0 * math.hypot(turn.forward, turn.across) / turn.yaw_rate
        reach *= math.sin(0.5 * min(measures["turned_rad"], math.pi))
        size = robot.wheeled.track + reach
        rows.append(
            BalanceRow("way of the middle in the turn", measures["sideways_m"], reach, "m", size)
        )
    return rows


def _weigh_way(robot: OwnRobot, measures: Measures) -> list[BalanceRow]:
    """The straight line against the wheels, and the curve against one of half the step."""
    rows = []
    if "load_ripple_share" in measures:
        rolling = measures.get("rolling_radius_m", 0.0)
        radius = robot.radius
        # tyres that sink roll on less
        expected = min(max(rolling, radius - robot.sinking), radius)
        rows.append(BalanceRow("radius by the way ahead", rolling, expected, "m", radius))
        rows.append(
            BalanceRow(
                "drift over way ahead", abs(measures.get("veer_share", 0.0)), 0.0, "", 1.0, 0.02
            )
        )
    if "step_halved_m" in measures:
        way = max(measures["curve_m"], 0.05)
        rows.append(
            BalanceRow(
                "end of a curve by half the step", measures["step_halved_m"], 0.0, "m", way, 0.05
            )
        )
    return rows


def _weigh_rest(robot: OwnRobot, measures: Measures) -> list[BalanceRow]:
    """Rest on level ground, and on a slope that friction can hold: sliding and rolling."""
    unit = 1e3 * measures["speed_unit_m_s"]
    slope = f"on {math.degrees(measures.get('slope_rad', 0.0)):.0f}°"
    names = {
        "rest_m_s": ("speed at rest", 0.0003),
        "creep_m_s": (f"sliding {slope}", 0.0007),
        "rolls_m_s": (f"{ROLLING} {slope}", 0.0025),
    }
    rows = []
    for key, (name, limit) in names.items():
        if key in measures and not (robot.given_rates and name.startswith(ROLLING)):
            rows.append(BalanceRow(name, 1e3 * measures[key], 0.0, "mm/s", unit, limit))
    return rows


# ------------------------------------------------------------------------- contacts
def pairs_of(robot: OwnRobot, geom: int) -> list[int]:
    """Return the numbers of the contact pairs of a shape."""
    model = robot.wheeled.model
    hit = (model.pair_geom1 == geom) | (model.pair_geom2 == geom)
    return np.flatnonzero(hit).tolist()


def sliding(robot: OwnRobot, geom: int) -> float:
    """Return the friction with which a tyre slides on the ground [1]."""
    model = robot.wheeled.model
    pairs = pairs_of(robot, geom)
    if pairs:
        return float(model.pair_friction[pairs[0], :2].max()) * (model.pair_dim[pairs[0]] > 1)
    sides = [model.geom(geom), robot.model.geom(robot.ground)]
    first = max(int(side.priority[0]) for side in sides)
    deciding = [side for side in sides if int(side.priority[0]) == first]
    slides = max(int(side.condim[0]) for side in deciding) > 1
    return slides * max(float(side.friction[0]) for side in deciding)


def in_words(measures: Measures) -> str:
    """Return what the trials say, in the words of people who ask."""
    if "multiplier" not in measures:
        return "It does not turn on the spot at all."
    droop = measures["droop_at_speed"]
    middle = measures["closed_form_middle"]
    expected = measures["closed_form"]
    measured = measures["multiplier"]
    left = [90.0]
    for factor in (1.0 - droop, 1.0 / middle, middle / expected, expected / measured):
        left.append(left[-1] * factor)
    names = (
        "wheels that lag behind their rates",
        "skidding, as on a real robot,",
        "weight off the middle",
        "contacts, which hop or depend on the heading,",
    )
    parts = []
    for name, before, after in zip(names, left, left[1:], strict=False):
        lost = before - after
        if abs(lost) >= 1.0:
            parts.append(f"{name} {'take' if lost > 0.0 else 'give back'} {abs(lost):.0f}°")
    text = f"It turns {left[-1]:.0f}° for 90° on its wheels"
    text += f": {', '.join(parts)}" if parts else ": nothing is lost"
    if measures["lifted_share"] > 0.01:
        text += f"; a wheel is off the ground {100.0 * measures['lifted_share']:.0f} % of the time"
    return text + "."
