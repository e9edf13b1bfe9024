"""The values that flow between the parts: commands drive a plant, a plant leaves a trajectory.

N commands drive N + 1 states: `Commands.values[k]` is held over [t_k, t_k+1), and a trajectory
sampled at the commands' edges has one row more than there are commands. Arrays are copied, checked
and read-only, so a value never changes after it was made.

Units are SI and radians. The world frame is fixed; the body frame has x forward, y left; yaw is
unwrapped.
"""

from __future__ import annotations

import math
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Real
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    import pandas

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]
ChannelColumns = Mapping[str, slice | int]
"""Columns of a table of numbers, by the channels that they hold."""
CommandKind = Literal["twist", "wheels"]
CURRENTS = "current_A"
"""Channel of a motion, where its log has it: (M, 2) of the left and right motors."""
VOLTAGES = "voltage_V"
"""Likewise."""
TORQUES = "torque_N_m"
"""Channel of a motion: the (M, 2) torques of the left and the right motors at the wheels [N m]."""
MOTOR_COLUMNS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        CURRENTS: ("current_left", "current_right"),
        VOLTAGES: ("voltage_left", "voltage_right"),
        TORQUES: ("torque_left", "torque_right"),
    }
)
"""Columns of a log that such a channel is made of."""


def frozen_array(values: ArrayLike, name: str, shape: tuple[int | None, ...]) -> FloatArray:
    """Return contiguous, read-only numbers of a `shape`, in which `None` is any length.

    They are a copy, unless they were that already and nothing else holds them.

    Raises:
        ValueError: the shape is another one, or a number is not finite; the message calls the
            values `name`.
    """
    flags = values.flags if isinstance(values, np.ndarray) else None
    kept = flags is not None and flags.owndata and not flags.writeable
    array = np.array(values, dtype=np.float64, order="C", copy=None if kept else True)
    pairs = zip(array.shape, shape, strict=False)
    if array.ndim != len(shape) or any(length not in (n, None) for n, length in pairs):
        expected = "x".join("N" if length is None else str(length) for length in shape)
        raise ValueError(f"{name} has shape {array.shape}, wanted {expected}")
    if not np.all(np.isfinite(array)):
        first = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(f"{name} is not finite at index {first}")
    array.setflags(write=False)
    return array


def is_finite_number(value: object) -> bool:
    """Return whether a value is a number that a float can hold, and finite."""
    try:
        return isinstance(value, Real) and math.isfinite(value)
    except OverflowError:  # a whole number beyond the greatest float
        return False


def increasing_times(values: ArrayLike) -> FloatArray:
    """Return (M,) instants [s] as a read-only array.

    Raises:
        ValueError: they do not increase, or are not finite.
    """
    t = frozen_array(values, "t", (None,))
    stalled = np.diff(t) <= 0.0
    if np.any(stalled):
        raise ValueError(f"t must increase; it does not after sample {np.argmax(stalled)}")
    return t


@dataclass(frozen=True, eq=False)
class Commands:
    """Commands to a driver, sampled at a fixed period and held."""

    dt: float
    """Period for which each command is held [s]."""
    values: FloatArray
    """(N, 2): v [m/s] and omega [rad/s] for `twist`; left and right wheel rate [rad/s] for
    `wheels`."""
    kind: CommandKind = "twist"
    """`twist` for body velocities, which the driver turns into wheel rates; `wheels` for the wheel
    rates themselves."""
    before: tuple[float, float] = (0.0, 0.0)
    """Command before the first one, which fills the delay lines."""

    def __post_init__(self) -> None:
        """Check and freeze.

        Raises:
            ValueError: no commands, a period that is not positive, or numbers that are not finite.
        """
        if not (np.isfinite(self.dt) and self.dt > 0.0):
            raise ValueError(f"the command period must be positive, got {self.dt} s")
        if self.kind not in ("twist", "wheels"):
            raise ValueError(f"unknown kind of command '{self.kind}'; there are: twist, wheels")
        object.__setattr__(self, "values", frozen_array(self.values, "commands", (None, 2)))
        if len(self.values) == 0:
            raise ValueError("there are no commands")
        if not np.all(np.isfinite(self.before)):
            raise ValueError(
                f"the command before the first one must be two finite numbers, got {self.before}"
            )

    @property
    def n(self) -> int:
        """Number of commands, N."""
        return len(self.values)

    @property
    def duration(self) -> float:
        """Length of N periods [s]."""
        return self.n * self.dt


@dataclass(frozen=True)
class State:
    """A planar robot at one instant: the pose of its reference point, and its velocities."""

    x: float = 0.0
    """World x of the reference point [m]."""
    y: float = 0.0
    """World y of the reference point [m]."""
    yaw: float = 0.0
    """Heading, unwrapped [rad]."""
    v_x: float = 0.0
    """Forward speed of the reference point, body frame [m/s]."""
    v_y: float = 0.0
    """Leftward speed of the reference point, body frame [m/s]."""
    yaw_rate: float = 0.0
    """Yaw rate [rad/s]."""
    wheel_left: float = 0.0
    """Rate of the left wheels [rad/s]."""
    wheel_right: float = 0.0
    """Rate of the right wheels [rad/s]."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a field that is no finite number."""
        for name, value in vars(self).items():
            if not is_finite_number(value):
                raise ValueError(f"State.{name} must be a finite number, got {reprlib.repr(value)}")

    @property
    def motion(self) -> Motion:
        """Return the state for compiled functions, with motors that give no torque."""
        return Motion(*map(float, vars(self).values()))


class Motion(NamedTuple):
    """A `State` and the torques of both sides, for compiled functions."""

    x: float  # world x of the reference point [m]
    y: float  # world y of the reference point [m]
    yaw: float  # heading, unwrapped [rad]
    v: float  # forward speed [m/s]
    v_y: float  # leftward speed [m/s]
    w: float  # yaw rate [rad/s]
    left: float  # rate of the left wheels [rad/s]
    right: float  # rate of the right wheels [rad/s]
    torque_left: float = 0.0  # torque of the left side in the last step [N m]
    torque_right: float = 0.0  # torque of the right side in the last step [N m]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A motion sampled in time: N + 1 rows for N command periods."""

    t: FloatArray
    """(M,) strictly increasing [s]."""
    pose: FloatArray
    """(M, 3): x [m], y [m], yaw [rad, unwrapped] of the reference point in the world."""
    twist: FloatArray
    """(M, 3): v_x [m/s], v_y [m/s], yaw rate [rad/s] in the body frame."""
    wheels: FloatArray
    """(M, 2): left and right wheel rate [rad/s]."""
    channels: Mapping[str, FloatArray] = field(default_factory=dict)
    """Other signals by name, with the unit at the end, each (M,) or (M, k): loads, torques,
    accelerations."""

    def __post_init__(self) -> None:
        """Check and freeze.

        Raises:
            ValueError: unequal lengths, time that does not increase, or numbers that are not
                finite.
        """
        t = increasing_times(self.t)
        if len(t) == 0:
            raise ValueError("a trajectory needs at least one sample")
        object.__setattr__(self, "t", t)
        for name, width in (("pose", 3), ("twist", 3), ("wheels", 2)):
            object.__setattr__(self, name, frozen_array(getattr(self, name), name, (len(t), width)))
        channels = {}
        for name, values in self.channels.items():
            array = np.asarray(values)
            channels[name] = frozen_array(array, name, (len(t), *array.shape[1:]))
        object.__setattr__(self, "channels", MappingProxyType(channels))

    def __reduce__(self) -> tuple[type[Trajectory], tuple[object, ...]]:
        """Copy by the arrays, so that other processes can receive a trajectory."""
        return Trajectory, (self.t, self.pose, self.twist, self.wheels, dict(self.channels))

    @classmethod
    def of_table(
        cls, t: FloatArray | float, table: FloatArray, channels: ChannelColumns
    ) -> Trajectory:
        """Return the motion of a run whose samples are the rows of a table.

        Args:
            t: (M,) stamps, or the time between them, of which the first is 0 [s].
            table: (M, k) fields of a `State`, then channels.
            channels: columns of each channel.
        """
        stamps = np.multiply(t, np.arange(len(table))) if isinstance(t, float) else t
        signals = {name: table[:, columns] for name, columns in channels.items()}
        return cls(stamps, table[:, :3], table[:, 3:6], table[:, 6:8], signals)

    def __len__(self) -> int:
        """Number of samples, M."""
        return len(self.t)

    @property
    def xy(self) -> FloatArray:
        """(M, 2) positions in the world [m]."""
        return self.pose[:, :2]

    @property
    def yaw(self) -> FloatArray:
        """(M,) heading, unwrapped [rad]."""
        return self.pose[:, 2]

    def frame(self) -> pandas.DataFrame:
        """Return the motion as a frame of pandas with the columns of a log, a row for each sample.

        Its speed ahead and its yaw rate are the odometry's, `odom_v` and `odom_w`, and the yaw rate
        is the gyro's too. Columns of a channel that a log does not know end in their number.
        """
        import pandas

        columns = {"t": self.t}
        columns |= zip(("x", "y", "yaw"), self.pose.T, strict=True)
        columns |= zip(("odom_v", "v_y", "odom_w"), self.twist.T, strict=True)
        columns |= zip(("enc_left", "enc_right"), self.wheels.T, strict=True)
        columns["gyro_z"] = columns["odom_w"]
        for name, values in self.channels.items():
            table = values.reshape(len(self), -1).T
            names = MOTOR_COLUMNS.get(name, [f"{name}_{k}" for k in range(len(table))])
            columns |= zip([name] if values.ndim == 1 else names, table, strict=True)
        return pandas.DataFrame(columns)

    def state(self, k: int) -> State:
        """Return the `k`-th sample."""
        row = np.concatenate([self.pose[k], self.twist[k], self.wheels[k]])
        return State(*map(float, row))


class Plant(Protocol):
    """Anything that moves when it is commanded: an analytic model or a simulator.

    A plant includes its driver: saturation, delays, conversion to wheel rates and the wheel torque
    loop lie inside `step`.
    """

    @property
    def name(self) -> str:
        """Name in tables and pictures."""
        ...

    @property
    def dt(self) -> float:
        """Physics step [s]."""
        ...

    def reset(self, state: State) -> State:
        """Start from `state`, with empty delay lines; return the state it really starts from."""
        ...

    def step(self, command: tuple[float, float], dt: float, yaw_acceleration: float = 0.0) -> State:
        """Hold `command` (v [m/s], omega [rad/s]) for `dt` [s]; return the state at the end.

        `dt` is a whole number of physics steps. `yaw_acceleration` is a disturbance added meanwhile
        [rad/s2], see `ssmr.robot.sensors.yaw_disturbance`.
        """
        ...

    def run(
        self,
        commands: Commands,
        state: State,
        sample_dt: float,
        disturbance: FloatArray | None = None,
    ) -> Trajectory:
        """Drive `commands` from `state` at once.

        The motion is that of `reset` and repeated `step`, as fast as the plant computes it.
        `disturbance` is (n,) yaw acceleration [rad/s2] for the n physics steps.
        """
        ...
