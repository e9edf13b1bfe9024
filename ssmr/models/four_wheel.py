"""A planar body on four tyres with slip, a rung between the slipless planar models and MuJoCo.

The body has three velocities, each wheel its own rate and a tyre (`ssmr.models.friction`), each
motor the loop of every plant (`ssmr.robot.drive`). Wheel loads follow the forces of the ground, as
a rigid body on four equal springs has them, with a short lag that stands for the tyres' own give;
their sum is always the weight. docs/four_wheel.md derives the equations.

Wheels in order front left, front right, rear left, rear right.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

from ssmr._jit import jit, jit_alone, named_like, write_numbers
from ssmr.errors import ParameterError
from ssmr.models.friction import (
    AlongAcross,
    Tyre,
    bend_brushes,
    felt_slip,
    improved_friction,
    sign_of,
    steady_bend,
    stop_at_zero_crossing,
    tyre_force,
)
from ssmr.parameters import (
    check_parameters,
    numbers_of,
    pack_numbers,
    parameter,
    require_in_range,
)
from ssmr.robot.drive import Motor, advance_integral, clip_to_limit, motor_numbers
from ssmr.robot.vehicle import Drive, Vehicle, WheeledBody
from ssmr.types import FloatArray

_GRAVITY = Vehicle().gravity  # [m/s2]
_STIFFEST = 1.0
"""Greatest h^2 w^2 + 2 h d w^2 of a step h, for a stiffest motion of frequency w and damping time d
[1]: stable below 4."""
_MOST_STEPS_A_SECOND = 1e6
"""Most inner steps in a second that are worth their time [1/s]; a Husky on the default tyres needs
95."""
_Link = Literal["belt", "none"]


@dataclass(frozen=True)
class FourWheelParameters(WheeledBody):
    """The numbers of a robot on four tyres; what drives it is a `ssmr.Drive`, as for every plant.

    Those without a default are the robot's own: `validation.plants.four_wheel` takes them from its
    file. Centre of mass and moment of inertia are those of the whole robot, wheels and all.
    """

    wheelbase: float = parameter(unit="m", low=0.01, high=20.0)
    """Distance of the axles [m]."""
    com_height: float = parameter(
        unit="m", low=0.0, high=20.0, search=(0.5, 2.8), of="wheel_radius"
    )
    """Height of the centre of mass above the ground [m]."""
    wheel_inertia: float = parameter(unit="kg m2", low=0.0, high=1e6)
    """Moment of inertia of a wheel about its axle [kg m2]; it loads the axles when it spins up, a
    rotor does not."""
    link: _Link = "belt"
    """Link between the wheels of a side: `belt`, they turn together; `none`, each has its own motor
    of half the strength."""
    stiffness_x: float = parameter(
        7.0, unit="1", low=0.1, high=1e4, search=(0.5, 60.0), scale="log"
    )
    """Slip stiffness along the wheel, C_x: force over load and slip at little slip [1]."""
    stiffness_y: float = parameter(
        7.0, unit="1", low=0.1, high=1e4, search=(0.5, 60.0), scale="log"
    )
    """Slip stiffness across the wheel, C_y [1]."""
    relaxation: float = parameter(
        0.5, unit="1", low=0.01, high=100.0, search=(0.1, 3.0), scale="log"
    )
    """Way that a tyre rolls until its force has built up, over the wheel radius [1]."""
    tyre_damping: float = parameter(0.05, unit="1", low=0.0, high=10.0)
    """Time by which the force of a standing tyre leads its bend, over sqrt(wheel radius / g)
    [1]."""
    load_lag: float = parameter(0.15, unit="1", low=0.0, high=100.0)
    """Time constant with which wheel loads follow the forces of the ground, over sqrt(wheel radius
    / g) [1]."""
    strength_difference: float = parameter(0.0, unit="1", low=-1.0, high=1.0, search=(-0.5, 0.5))
    """Torque of the left motor less that of the right, over their mean, at equal demand [1]."""

    def __post_init__(self) -> None:
        """Check the ranges, that every wheel carries load, and that no tyre is too stiff."""
        check_parameters(self)
        require_in_range(self, "radius_difference", -self.wheel_radius, self.wheel_radius)
        if self.link not in get_args(_Link):
            raise ParameterError(
                f"unknown link '{self.link}'; there are: {', '.join(get_args(_Link))}"
            )
        if abs(self.com_x) / (0.5 * self.wheelbase) + abs(self.com_y) / self.half_track >= 1.0:
            raise ParameterError(
                f"com_x {self.com_x:g} m and com_y {self.com_y:g} m leave a wheel without load"
            )
        if not _least_step_rate(self) <= _MOST_STEPS_A_SECOND:
            raise ParameterError(
                "tyres are too stiff for so light a body or wheels: "
                "they swing too fast for any step that is worth its time"
            )


class FourWheels(NamedTuple):
    """All numbers of a robot on four tyres for one physics step, for compiled functions."""

    own: Any  # the packed `FourWheelParameters`
    motor: Motor  # one wheel's share of its motor, for an inner step
    tyre: Tyre  # one tyre; all four have the same
    following: float  # share of their way that the loads go in an inner step [1]
    dt: float  # inner step [s]
    inner: int  # inner steps in a physics step
    linked: bool  # whether the wheels of a side turn together
    given: bool  # whether the wheels turn at their references, whatever torque that takes


_OWN = numbers_of(FourWheelParameters)
_TEMPLATE = FourWheels(
    own=_OWN(*(0.0,) * len(_OWN._fields)),
    motor=Motor(*(0.0,) * 6),
    tyre=Tyre(*(0.0,) * 5),
    following=0.0,
    dt=0.0,
    inner=1,
    linked=True,
    given=False,
)
"""Template of the parts for `named_like`."""


def row_of(robot: FourWheels) -> list[float]:
    """Return the numbers of a robot in a row, as a population has them."""
    return [*robot.own, *robot.motor, *robot.tyre, *robot[3:]]


@jit
def robot_of(row: FloatArray) -> FourWheels:
    """Return the robot of a row of numbers, see `row_of`."""
    motor = len(_TEMPLATE.own)
    tyre = motor + len(_TEMPLATE.motor)
    rest = tyre + len(_TEMPLATE.tyre)
    return FourWheels(
        own=named_like(_TEMPLATE.own, row),
        motor=named_like(_TEMPLATE.motor, row[motor:]),
        tyre=named_like(_TEMPLATE.tyre, row[tyre:]),
        following=row[rest],
        dt=row[rest + 1],
        inner=int(row[rest + 2]),
        linked=row[rest + 3] != 0.0,
        given=row[rest + 4] != 0.0,
    )


def _least_step_rate(p: FourWheelParameters) -> float:
    """Return the least number of steps in a second [1/s].

    Their length h follows from h^2 w^2 + 2 h d w^2 = `_STIFFEST` for the stiffest motion.
    """
    spin = p.armature + p.wheel_inertia
    damping = p.tyre_damping * math.sqrt(p.wheel_radius / _GRAVITY)
    lever = (0.5 * p.wheelbase) ** 2 + p.half_track**2
    lightness = 1.0 + p.mass * lever / p.yaw_inertia + 0.25 * p.mass * p.wheel_radius**2 / spin
    stiffness = max(p.stiffness_x, p.stiffness_y)
    square = stiffness * _GRAVITY / (p.relaxation * p.wheel_radius) * lightness  # w^2
    root = math.sqrt(damping * damping * square * square + _STIFFEST * square)
    return (damping * square + root) / _STIFFEST


def four_wheels(
    p: FourWheelParameters, drive: Drive, dt: float, *, given: bool = False
) -> FourWheels:
    """Return the numbers for physics steps `dt` [s], divided where stiff tyres need it."""
    inner = max(1, math.ceil(dt * _least_step_rate(p)))
    step = dt / inner
    unit = math.sqrt(p.wheel_radius / _GRAVITY)  # of time
    motor = motor_numbers(drive, step)
    lag = p.load_lag * unit
    return FourWheels(
        own=pack_numbers(p),
        # Two motors drive four wheels, so a wheel has half of its motor.
        motor=Motor(
            limit=0.5 * motor.limit,
            braking=0.5 * motor.braking,
            integral_gain=0.5 * motor.integral_gain,
            leaked=motor.leaked,
            gained=0.5 * motor.gained,
            gear_loss=0.5 * motor.gear_loss,
        ),
        tyre=Tyre(
            friction=p.friction,
            along=p.stiffness_x,
            across=p.stiffness_y,
            relaxation=p.relaxation * p.wheel_radius,
            damping=p.tyre_damping * unit,
        ),
        following=1.0 if lag == 0.0 else -math.expm1(-step / lag),
        dt=step,
        inner=inner,
        linked=p.link == "belt",
        given=given,
    )


class Body(NamedTuple):
    """The state of a robot on four tyres: views of a row that compiled functions change."""

    motion: FloatArray
    """(6,) x, y [m], yaw [rad] of the middle between the axles; forward and leftward speed of the
    centre of mass [m/s], yaw rate [rad/s]."""
    spin: FloatArray  # (4,) wheel rates [rad/s]
    integral: FloatArray  # (4,) integral parts of the motors' torques [N m]
    torque: FloatArray  # (4,) torques of the motors in the last step, each wheel's share [N m]
    slip_x: FloatArray  # (4,) bends of the tyres along the wheel over the relaxation length [1]
    slip_y: FloatArray  # (4,) bends across the wheel [1]
    load: FloatArray  # (4,) wheel loads in the last step [N]
    shift: FloatArray
    """(2,) load that has moved to the front and to the left, over the weight [1]; 1 where the
    others carry nothing."""
    force_x: FloatArray  # (4,) forces of the ground along the wheels in the last step [N]
    force_y: FloatArray  # (4,) forces of the ground across the wheels [N]
    turn: FloatArray  # (1,) yaw acceleration in the last step [rad/s2]


STATE_NUMBERS = 41
"""Length of the row of numbers that a `Body` shows."""


@jit_alone
def body_of(row: FloatArray) -> Body:
    """Return the views of a row of `STATE_NUMBERS` numbers."""
    return Body(
        motion=row[0:6],
        spin=row[6:10],
        integral=row[10:14],
        torque=row[14:18],
        slip_x=row[18:22],
        slip_y=row[22:26],
        load=row[26:30],
        shift=row[30:32],
        force_x=row[32:36],
        force_y=row[36:40],
        turn=row[40:41],
    )


@jit
def _contact_point(i: int, robot: FourWheels) -> AlongAcross:
    """Return where wheel i touches the ground, ahead and to the left of the centre of mass [m]."""
    own = robot.own
    x = 0.5 * own.wheelbase if i < 2 else -0.5 * own.wheelbase
    y = own.half_track if i % 2 == 0 else -own.half_track
    return AlongAcross(x - own.com_x, y - own.com_y)


@jit
def _radius_of(i: int, robot: FourWheels) -> float:
    """Return the effective rolling radius of wheel i [m]."""
    more = 0.5 * robot.own.radius_difference
    radius: float = robot.own.wheel_radius + (more if i % 2 == 0 else -more)
    return radius


@jit
def _rim_speed(body: Body, i: int, robot: FourWheels) -> float:
    """Return the speed at which the rim of wheel i rolls [m/s]."""
    return body.spin[i] * _radius_of(i, robot)  # type: ignore[no-any-return]  # numba knows


@jit
def _sliding_velocity(motion: FloatArray, rolling: float, i: int, robot: FourWheels) -> AlongAcross:
    """Return the velocity of wheel i's rim over the ground [m/s]; it rolls at `rolling` [m/s]."""
    place = _contact_point(i, robot)
    along = motion[3] - motion[5] * place.y - rolling
    return AlongAcross(along, motion[4] + motion[5] * place.x)


@jit_alone
def place_body(start: FloatArray, robot: FourWheels, body: Body) -> None:
    """Put the robot into a state, (8,) numbers in the order of `ssmr.State`.

    Wheel loads are those at rest, and tyres are bent as in steady rolling.
    """
    tyre = robot.tyre
    own = robot.own
    w = start[5]
    v = (start[3] - w * own.com_y, start[4] + w * own.com_x)
    write_numbers(body.motion, 0, 1, (start[0], start[1], start[2], v[0], v[1], w))
    body.shift[0] = own.com_x / (0.5 * own.wheelbase)
    body.shift[1] = own.com_y / own.half_track
    for i in range(4):
        body.spin[i] = start[6 + i % 2]
        rolling = _rim_speed(body, i, robot)
        sliding = _sliding_velocity(body.motion, rolling, i, robot)
        bent = steady_bend(sliding, rolling, tyre)
        body.slip_x[i] = bent.x
        body.slip_y[i] = bent.y
        body.integral[i] = 0.0
        body.torque[i] = 0.0
        body.force_x[i] = 0.0
        body.force_y[i] = 0.0
    body.turn[0] = 0.0
    _spread_load(body, robot)


@jit
def _spread_load(body: Body, robot: FourWheels) -> None:
    """Spread the weight over the wheels as a rigid body on four equal springs does.

    A wheel that would hang, lifts. Then the robot stands on three wheels: the lack goes to the
    opposite wheel and is taken off both neighbours, which changes neither the sum nor the moments.
    """
    ahead = clip_to_limit(body.shift[0], 1.0)
    aside = clip_to_limit(body.shift[1], 1.0)
    lack = max(abs(ahead) + abs(aside) - 1.0, 0.0) * sign_of(ahead) * sign_of(aside)
    for i in range(4):
        front = 1.0 if i < 2 else -1.0
        left = 1.0 if i % 2 == 0 else -1.0
        share = 1.0 + front * ahead + left * aside + front * left * lack
        # Only rounding makes a share negative.
        body.load[i] = 0.25 * robot.own.mass * _GRAVITY * max(share, 0.0)


@jit
def _turn_wheel(
    rate: float,
    integral: float,
    reference: float,
    pull: float,
    dry: float,
    strength: float,
    robot: FourWheels,
) -> tuple[float, float]:
    """Return a wheel's rate after a step [rad/s] and the mean torque of its motor [N m].

    The loop of the speed `reference` [rad/s] is stepped exactly for a load that is constant over
    the step. The motor has the `strength` of its nominal one [1] and an `integral` part of its
    torque, before `strength` [N m]; the ground brakes the wheel with the moment `pull` [N m]. `dry`
    friction [N m] holds a wheel that stands and stops one that would turn back (Eq. 2.29, 2.31).
    """
    spin_inertia = robot.own.armature + robot.own.wheel_inertia
    gain = strength * (0.5 * robot.own.gain)
    back = strength * robot.motor.braking * rate
    limit = strength * robot.motor.limit
    lasting = strength * integral
    driving = clip_to_limit(gain * (reference - rate) + lasting + back, limit) - back - pull
    if rate == 0.0 and abs(driving) <= dry:
        return 0.0, driving + pull
    load = pull - improved_friction(driving, dry, dry, rate)
    # rate that an unlimited motor would end at
    free = reference + (lasting - load) / gain
    faster = free + (rate - free) * math.exp(-gain * robot.dt / spin_inertia)
    torque = spin_inertia * (faster - rate) / robot.dt + load
    if abs(torque + back) > limit:
        torque = clip_to_limit(torque + back, limit) - back
        faster = rate + robot.dt * (torque - load) / spin_inertia
    if dry > 0.0:
        faster = stop_at_zero_crossing(faster, rate)
    return faster, torque


@jit
def _turn_wheels(body: Body, left: float, right: float, robot: FourWheels) -> float:
    """Advance all wheels under references [rad/s]; return their summed accelerations [rad/s2]."""
    own = robot.own
    motor = robot.motor
    stronger = 0.5 * own.strength_difference
    total = 0.0
    for i in range(4):
        on_left = i % 2 == 0
        reference = left if on_left else right
        radius = _radius_of(i, robot)
        pull = body.force_x[i]
        load = body.load[i]
        rate = body.spin[i]
        if robot.linked:
            # A belt shares forces and loads between the wheels of its side.
            other = (i + 2) % 4
            pull = 0.5 * (pull + body.force_x[other])
            load = 0.5 * (load + body.load[other])
        if robot.given:
            faster = reference
            torque = pull * radius
        else:
            faster, torque = _turn_wheel(
                rate=rate,
                integral=body.integral[i],
                reference=reference,
                pull=pull * radius,
                dry=motor.gear_loss + own.rolling_resistance * load * radius,
                strength=1.0 + (stronger if on_left else -stronger),
                robot=robot,
            )
            if motor.integral_gain > 0.0:
                error = reference - 0.5 * (rate + faster)
                body.integral[i] = advance_integral(body.integral[i], error, motor)
        total += (faster - rate) / robot.dt
        body.spin[i] = faster
        body.torque[i] = torque
    return total


@jit
def _advance_body(
    body: Body, left: float, right: float, disturbance: float, robot: FourWheels
) -> None:
    """Advance the robot by one inner step under wheel-rate references [rad/s].

    A `disturbance` adds to the yaw acceleration [rad/s2]. Tyres bend with the velocities at the
    start of the step, and their forces then change the velocities (symplectic Euler).
    """
    motion = body.motion
    own = robot.own
    tyre = robot.tyre
    dt = robot.dt
    _spread_load(body, robot)
    force_x = 0.0
    force_y = 0.0
    moment = 0.0
    for i in range(4):
        rolling = _rim_speed(body, i, robot)
        sliding = _sliding_velocity(motion, rolling, i, robot)
        slip = AlongAcross(body.slip_x[i], body.slip_y[i])
        bent = bend_brushes(slip, sliding, rolling, dt, tyre)
        force = tyre_force(felt_slip(bent, sliding, rolling, tyre), body.load[i], tyre)
        body.slip_x[i] = bent.x
        body.slip_y[i] = bent.y
        body.force_x[i] = force.x
        body.force_y[i] = force.y
        force_x = force_x + force.x
        force_y = force_y + force.y
        lever = _contact_point(i, robot)
        moment = moment + lever.x * force.y - lever.y * force.x
    spun_up = _turn_wheels(body, left, right, robot)
    w = motion[5]
    body.turn[0] = moment / own.yaw_inertia + disturbance
    w_next = w + dt * body.turn[0]
    turned = 0.5 * dt * (w + w_next)
    pushed_u = motion[3] + dt * force_x / own.mass
    pushed_v = motion[4] + dt * force_y / own.mass
    cos = math.cos(turned)
    sin = math.sin(turned)
    # The body turns under its velocity.
    u = cos * pushed_u + sin * pushed_v
    v = cos * pushed_v - sin * pushed_u
    # mean velocity of the middle between the axles
    mean_w = 0.5 * (w + w_next)
    ahead = 0.5 * (motion[3] + u) + mean_w * own.com_y
    aside = 0.5 * (motion[4] + v) - mean_w * own.com_x
    cos = math.cos(motion[2] + 0.5 * turned)
    sin = math.sin(motion[2] + 0.5 * turned)
    motion[0] += dt * (ahead * cos - aside * sin)
    motion[1] += dt * (ahead * sin + aside * cos)
    motion[2] += turned
    write_numbers(motion, 3, 1, (u, v, w_next))
    spin = body.spin[0] + body.spin[1] + body.spin[2] + body.spin[3]
    _shift_load(body, AlongAcross(force_x, force_y), spun_up, spin * w, robot)


@jit
def _shift_load(
    body: Body, force: AlongAcross, spun_up: float, gyroscopic: float, robot: FourWheels
) -> None:
    """Let the loads follow the moments of the ground's forces [N] and of the wheels' rotation.

    Over the inertia of a wheel, the moment about the axles is `spun_up` [rad/s2], and that about
    the robot's length `gyroscopic`, the wheels' rates times the yaw rate [rad2/s2].
    """
    own = robot.own
    inertia = own.wheel_inertia
    weight = own.mass * _GRAVITY
    about_y = weight * own.com_x - own.com_height * force.x - inertia * spun_up
    about_x = weight * own.com_y - own.com_height * force.y - inertia * gyroscopic
    ahead = about_y / (weight * (0.5 * own.wheelbase))
    aside = about_x / (weight * own.half_track)
    body.shift[0] += robot.following * (ahead - body.shift[0])
    body.shift[1] += robot.following * (aside - body.shift[1])


SAMPLE_COLUMNS = 25
"""x, y, yaw, v_x, v_y, yaw rate of the middle between the axles, wheel left, wheel right, torque
left, torque right, yaw acceleration, its least and greatest value since the last sample, loads,
forces along and across the four wheels."""


@jit_alone
def write_sample(body: Body, row: FloatArray, robot: FourWheels) -> None:
    """Write the state into a row of `SAMPLE_COLUMNS`, but for the yaw acceleration's range."""
    motion = body.motion
    own = robot.own
    w = body.motion[5]
    spin = body.spin
    torque = body.torque
    write_numbers(row, 0, 1, (motion[0], motion[1], motion[2]))
    write_numbers(row, 3, 1, (motion[3] + w * own.com_y, motion[4] - w * own.com_x, w))
    write_numbers(row, 6, 1, (0.5 * (spin[0] + spin[2]), 0.5 * (spin[1] + spin[3])))
    write_numbers(row, 8, 1, (torque[0] + torque[2], torque[1] + torque[3], body.turn[0]))
    for i in range(4):
        row[13 + i] = body.load[i]
        row[17 + i] = body.force_x[i]
        row[21 + i] = body.force_y[i]


@jit_alone
def run_wheels(
    references: FloatArray,
    disturbance: FloatArray,
    stride: int,
    robot: FourWheels,
    body: Body,
    out: FloatArray,
) -> int:
    """Advance a robot in place; return the step after which a number is not finite, or -1.

    `references` are (n, 2) wheel rates [rad/s]. `disturbance` is (n,) yaw accelerations [rad/s2],
    or (1,) for the same at every step. Every `stride`-th state is written to `out` (1 + n //
    stride, 25), see `SAMPLE_COLUMNS`; row 0 is the start. `body` is then the state at the last
    step.
    """
    write_sample(body, out[0], robot)
    out[0, 11:13] = body.turn[0]
    least = math.inf
    most = -math.inf
    for k in range(len(references)):
        push = disturbance[k] if len(disturbance) > 1 else disturbance[0]
        before = body.motion[5]
        for _ in range(robot.inner):
            _advance_body(body, references[k, 0], references[k, 1], push, robot)
        u = body.motion[3]
        v = body.motion[4]
        w = body.motion[5]
        if not math.isfinite(u + v + w):
            return k
        turn = (w - before) / (robot.inner * robot.dt)
        least = min(least, turn)
        most = max(most, turn)
        if (k + 1) % stride == 0:
            row = out[(k + 1) // stride]
            write_sample(body, row, robot)
            row[11] = least
            row[12] = most
            least = math.inf
            most = -math.inf
    return -1
