"""Many robots of one planar model at once, side by side in the lanes of vector instructions.

A step of the time loop advances a group of robots by the functions that advance one robot,
`drive_on` and `move_robot`. The loop over the group is the inner one, and each quantity of all its
robots lies in one row, so the compiler turns that loop into vector instructions, and the branches
of a law into selections. No arithmetic is approximated or reordered for that: a robot's motion is
that of `PlanarPlant.run` to the bit, whatever stands in the other lanes. A law that calls a
function which has no vector form, such as `math.exp`, runs lane after lane, with the same result.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numba.core import cgutils, types
from numpy.typing import NDArray

from ssmr._jit import (
    T,
    built_in,
    jit,
    jit_alone,
    numbers_as,
    python_source,
    share_among_threads,
    write_numbers,
)
from ssmr.models.law import PlanarRobot
from ssmr.robot.drive import (
    DRIVE_TEMPLATE,
    DriveNumbers,
    DriveState,
    Motor,
    Sides,
    drive_numbers,
    drive_on,
    held_value,
    rolling_references,
    whole_steps,
)
from ssmr.simulation import PLANAR_DT, PlanarModel, move_robot
from ssmr.types import Commands, FloatArray, State

LANES = 8
"""Robots of a group: the numbers in the widest vectors that there are."""
_PAIR = 2 * LANES
_CHUNK = 8
"""Steps whose held twists are laid out together, a chunk before they are read, so that no read
waits for them."""


_MOTION = State().motion
_SIDES = Sides(0.0, 0.0)
_DRIVER = DriveState(0.0, 0.0, 0.0, 0.0)
"""Templates of the rows of a group that change: motion, integral parts and driver."""
_YAW_RATE = _MOTION._fields.index("w")
_INTEGRAL = len(_MOTION)
_LAST = _INTEGRAL + len(_SIDES)
_HELD = _LAST + len(_DRIVER)
"""First of the two rows of the twist that the driver holds."""
_DRIVE = _HELD + 2
"""First row of the driver."""
_DRIVEN = DriveNumbers._fields.index("delay_v")
"""Numbers of the driver that a step needs; the others have gone into the twist that it holds."""
_ROBOT = _DRIVE + _DRIVEN
"""First row of the robot."""


@built_in
def _prefer_wide_vectors(typing: Any) -> Any:
    """Let the compiled function that calls this use the widest vectors of the processor.

    It is for compiled functions only. LLVM otherwise prefers half the width on many processors,
    lest they lower their clock for code that gains little by it.
    """

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        attributes = builder.function.attributes
        if isinstance(attributes, set):  # llvmlite's own `add` knows no attributes with values
            set.add(attributes, '"prefer-vector-width"="512"')
        return context.get_dummy_value()

    return types.void(), build


@built_in
def _copy_numbers(typing: Any, target: Any, at: Any, origin: Any, first: Any, count: Any) -> Any:
    """Copy numbers of one contiguous array from `first` on into another from `at` on.

    Their `count` is a constant. A loop would not do: where the compiler cannot tell that the arrays
    are different ones, it copies number by number, and a processor that then reads several of them
    as one vector waits until all have left its store buffer.
    """
    if not isinstance(count, types.IntegerLiteral):
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        to, start, of, begin, _ = arguments
        to_array = context.make_array(signature.args[0])(context, builder, to)
        of_array = context.make_array(signature.args[2])(context, builder, of)
        here = builder.gep(to_array.data, [start])
        there = builder.gep(of_array.data, [begin])
        number = context.get_constant(types.intp, count.literal_value)
        copy: Any = cgutils.raw_memcpy
        copy(builder, here, there, number, 8)
        return context.get_dummy_value()

    return types.void(target, at, origin, first, count), build


@jit
def _lane_of(template: T, rows: FloatArray, first: int, i: int) -> T:
    """Return a named tuple of the template's kind from lane i of the rows from `first` on."""
    place = i + first * LANES
    return numbers_as(template, rows, place, LANES)  # type: ignore[no-any-return]  # as _jit says


@jit
def _lane_robot(kind: PlanarRobot, plain: Any, rows: FloatArray, i: int) -> PlanarRobot:
    """Return the robot of lane i; `kind` is any robot of the same model."""
    at = _ROBOT + len(kind.vehicle)
    parameters = _lane_of(kind.parameters, rows, at, i)
    at += len(kind.parameters)
    motor = _lane_of(kind.motor, rows, at, i)
    at += len(kind.motor)
    if plain is not None:
        motor = Motor(motor.limit, 0.0, 0.0, 0.0, 0.0, 0.0)
    return PlanarRobot(
        vehicle=_lane_of(kind.vehicle, rows, _ROBOT, i),
        parameters=parameters,
        motor=motor,
        x_icr=rows[i + at * LANES],
        drift=rows[i + (at + 1) * LANES],
        ideal=rows[i + (at + 2) * LANES] != 0.0,
        dt=rows[i + (at + 3) * LANES],
        constants=_lane_of(kind.constants, rows, at + 4, i),
    )


@jit
def _step_lane(kind: PlanarRobot, plain: Any, prescribed: Any, rows: FloatArray, i: int) -> None:
    """Advance the robot of lane i by one step, see `_run_lanes`."""
    last = _lane_of(_DRIVER, rows, _LAST, i)
    v = rows[i + _HELD * LANES]
    w = rows[i + (_HELD + 1) * LANES]
    held = DriveState(last.v, last.w, v, w)
    if prescribed is None:
        drive = _lane_of(DRIVE_TEMPLATE, rows, _DRIVE, i)
        share = drive.share if plain is None else 1.0
        held = drive_on(v, w, drive, share, last)
    now = _lane_of(_MOTION, rows, 0, i)
    integral = _lane_of(_SIDES, rows, _INTEGRAL, i)
    robot = _lane_robot(kind, plain, rows, i)
    then, integral = move_robot(now, integral, Sides(held.left, held.right), 0.0, robot)
    write_numbers(rows, i, LANES, (then.x, then.y, then.yaw, then.v))
    rows[i + _YAW_RATE * LANES] = then.w  # a step needs no more of a motion
    write_numbers(rows, i + _INTEGRAL * LANES, LANES, integral)
    write_numbers(rows, i + _LAST * LANES, LANES, held)


@jit
def _lay_out(held: FloatArray, places: NDArray[np.uint64], first: int, ahead: FloatArray) -> None:
    """Write the held twists of each lane from step `first` on into one half of `ahead`."""
    begin = first % (2 * _CHUNK)
    for j in range(_PAIR):
        at = np.uint64(first) + places[j]
        for c in range(_CHUNK):
            ahead[(begin + c) * _PAIR + j] = held[at + np.uint64(c)]


@jit
def _record_poses(rows: FloatArray, sample: int, poses: FloatArray) -> None:
    """Write the poses of the group as one sample of each."""
    for i in range(len(poses)):
        for j in range(3):
            poses[i, sample, j] = rows[i + j * LANES]


@jit_alone
def _run_lanes(
    kind: PlanarRobot,
    plain: Any,
    prescribed: Any,
    held: FloatArray,
    places: NDArray[np.uint64],
    rows: FloatArray,
    times: tuple[int, int],
    poses: FloatArray,
) -> None:
    """Drive a group of robots; write (s, M, 3) poses, or NaN.

    Their (R LANES,) numbers in `rows` advance in place. `kind` is any robot of the model: the types
    of its parts choose the law. `plain` is None where a robot has more to its motors and its driver
    than a proportional loop, limits and a delay; a missing part is left out of the compiled loop,
    which changes no bit. `prescribed` is None unless the `held` values are the wheel rates
    themselves; `places` (2 LANES,) are the indices among them of the first v, then of the first
    omega, of each lane. `times` are the number of physics steps, and that between samples.
    """
    _prefer_wide_vectors()
    steps, stride = times
    ahead = np.empty(2 * _CHUNK * _PAIR)
    due = 0
    sample = 0
    for k in range(-_CHUNK, steps + 1):
        if k % _CHUNK == 0:
            _lay_out(held, places, k + _CHUNK, ahead)
        if k < 0:
            continue
        if k == due:
            _record_poses(rows, sample, poses)
            sample += 1
            due += stride
        if k == steps:
            break
        _copy_numbers(rows, _HELD * LANES, ahead, k % (2 * _CHUNK) * _PAIR, _PAIR)
        for i in range(LANES):
            _step_lane(kind, plain, prescribed, rows, i)
    for i in range(len(poses)):
        total = rows[i] + rows[i + LANES] + rows[i + 2 * LANES]
        if not np.isfinite(total):
            poses[i] = np.nan


@jit_alone
def _fill_held(
    values: FloatArray,
    drive: DriveNumbers,
    before: tuple[float, float],
    longest: int,
    out: FloatArray,
) -> None:
    """Write the (2, n) twists that a driver holds.

    The first one is that of `longest` steps before the first command.
    """
    for column in range(2):
        for k in range(out.shape[1]):
            out[column, k] = held_value(values, column, k - longest, 0, drive, before[column])


def run_population(
    models: Sequence[PlanarModel],
    commands: Commands,
    starts: Sequence[State],
    sample_dt: float,
    dt: float = PLANAR_DT,
    workers: int = 1,
) -> FloatArray:
    """Drive many candidates of one model with the same inputs.

    Args:
        models: S candidates of the same kind.
        commands: commands that all of them get.
        starts: state from which each starts.
        sample_dt: time between samples [s].
        dt: physics step [s].
        workers: threads; the result does not depend on it.

    Returns:
        (S, M, 3) poses, those of `PlanarPlant.run` to the bit; a candidate that diverges is NaN
        throughout, for the caller to rate.

    Raises:
        ValueError: candidates of different kinds, or periods that are no whole number of steps.
    """
    if len({type(m.parameters) for m in models}) != 1:
        raise ValueError("a population is one kind of model")
    wheels = commands.kind == "wheels"
    stride = whole_steps(sample_dt, dt, "the sample period")
    if wheels:
        models = [m.prescribed() for m in models]
    robots = [m.packed(dt) for m in models]
    drives = [drive_numbers(m.drive, commands.dt, dt) for m in models]
    period = drives[0].period
    steps = commands.n * period
    times = (steps, stride)
    if wheels:  # those of all steps, and the places of each robot's first left and right one
        step = np.arange(steps + 2 * _CHUNK)
        last = commands.n - 1
        held = commands.values[np.minimum(step // period, last)].T.ravel()
        place = np.array([0, len(step)], dtype=np.uint64)
        places = np.tile(place, (len(models), 1))
    else:
        held, places = _held_twists(commands, drives, steps)
    lanes = [_lane_numbers(*numbers) for numbers in zip(starts, drives, robots, strict=True)]
    rows = np.array(lanes, dtype=np.float64)
    plain = None if any(map(_is_special, drives, robots)) else True
    kind = (robots[0], plain, True if wheels else None)
    poses = np.empty((len(models), 1 + steps // stride, 3))

    def run(first_group: int, last_group: int) -> None:
        for group in range(first_group, last_group):
            first = LANES * group
            which = np.arange(first, first + LANES)
            which = np.minimum(which, len(models) - 1)  # the last one fills the last group up
            group_places = places[which].T.ravel()
            group_rows = rows[which].T.ravel()
            group_poses = poses[first : first + LANES]
            _run_lanes(*kind, held, group_places, group_rows, times, group_poses)

    share_among_threads(run, -(-len(models) // LANES), workers)
    return poses


def _lane_numbers(start: State, drive: DriveNumbers, robot: PlanarRobot) -> list[float]:
    """Return the numbers of one lane, as `_step_lane` and `_lane_robot` read them.

    These are its state, the twist that its driver holds, its driver and its robot.
    """
    held = python_source(rolling_references)(Sides(start.wheel_left, start.wheel_right), drive)
    centre = (robot.x_icr, robot.drift, float(robot.ideal), robot.dt)
    numbers = (*robot.vehicle, *robot.parameters, *robot.motor, *centre, *robot.constants)
    state = (*start.motion, *_SIDES, *held)
    return [*state, 0.0, 0.0, *drive[:_DRIVEN], *numbers]


def _is_special(drive: DriveNumbers, robot: PlanarRobot) -> bool:
    """Return whether there is more than delays, limits and a proportional loop to a robot."""
    motor = robot.motor
    if drive.share != 1.0:
        return True
    return any((motor.braking, motor.integral_gain, motor.gear_loss))


def _held_twists(
    commands: Commands, drives: Sequence[DriveNumbers], steps: int
) -> tuple[FloatArray, NDArray[np.uint64]]:
    """Return the twists that the drivers hold, and where those of each one begin.

    The latter are (S, 2) places of the first v and the first omega.
    """
    longest = max(max(d.delay_v, d.delay_w) for d in drives)
    length = longest + steps + 2 * _CHUNK
    samplings = {(d.hold, d.ramp): d for d in drives}  # usually one: a fit moves neither
    held = np.empty((len(samplings), 2, length))
    for drive, out in zip(samplings.values(), held, strict=True):
        _fill_held(commands.values, drive, commands.before, longest, out)
    begins = {sampling: 2 * k * length + longest for k, sampling in enumerate(samplings)}
    places = []
    for drive in drives:
        begin = begins[drive.hold, drive.ramp]
        places.append((begin - drive.delay_v, begin + length - drive.delay_w))
    return held.ravel(), np.array(places, dtype=np.uint64)
