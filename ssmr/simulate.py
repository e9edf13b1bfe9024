"""Time stepping: one loop for any plant, and the fused loops of the planar models, held equal to it by a test.

A planar model is three states, x, y and yaw, and two velocities, v and omega. Its velocities advance by the model's own law;
its pose follows by the midpoint rule with v_y = -x_ICR omega (Eq. 2.2, 2.10, 2.13).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace

import numba
import numpy as np

from ssmr._jit import jit
from ssmr.errors import DivergedError
from ssmr.models import coulomb, improved, kinematic, linear
from ssmr.robot.drive import Driver, fill_references, wheel_references, whole_steps
from ssmr.robot.drive import packed as packed_drive
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.types import Commands, FloatArray, Plant, State, Trajectory

Parameters = (
    coulomb.CoulombParameters | improved.ImprovedParameters | linear.LinearParameters | kinematic.KinematicParameters
)

MODELS: Mapping[str, type[Parameters]] = {
    "improved": improved.ImprovedParameters,
    "coulomb": coulomb.CoulombParameters,
    "linear": linear.LinearParameters,
    "kinematic": kinematic.KinematicParameters,
}
"""By planar model, in the order of tables. The order is the number by which the compiled loops know a model."""
PLANAR_MODELS = tuple(MODELS)
"""Names of the planar models."""
IMPROVED, COULOMB, LINEAR, KINEMATIC = range(4)
_WIDTH = 5  # numbers in a packed parameter set, the longest model's
_COLUMNS = 13
"""x, y, yaw, v_x, v_y, yaw rate, wheel left, wheel right, torque left, torque right, yaw acceleration, its least and its
greatest value since the last sample: a model that chatters from step to step hides between samples otherwise."""

PLANAR_DT = 0.001
"""Default step of the planar models [s]; Tab. 3.7."""
SAMPLE_DT = 0.008
"""Default sample period of trajectories [s]: the lab's tracking system (Tab. 3.5)."""


@jit
def advance(model, v, w, reference, disturbance, dt, vehicle, parameters, side_limit):
    """One step of a model's velocities; returns v, omega, left torque, right torque."""
    if model == IMPROVED:
        return improved.advance(v, w, reference, disturbance, dt, vehicle, parameters, side_limit)
    if model == COULOMB:
        return coulomb.advance(v, w, reference, disturbance, dt, vehicle, parameters, side_limit)
    if model == LINEAR:
        return linear.advance(v, w, reference, disturbance, dt, vehicle, parameters, side_limit)
    return kinematic.advance(v, w, reference, disturbance, dt, vehicle, parameters, side_limit)


@jit
def rotation_centre(model, vehicle, parameters):
    """x_ICR of a model [m]; zero in the improved and the linear one (Sec. 2.2.3)."""
    if model == COULOMB:
        return vehicle[7]
    if model == KINEMATIC:
        return parameters[2]
    return 0.0


@jit
def move(model, x, y, yaw, v, w, reference, disturbance, dt, vehicle, parameters, side_limit, x_icr):
    """One step of pose and velocities; returns x, y, yaw, v, omega, left torque, right torque."""
    v_next, w_next, torque_left, torque_right = advance(
        model, v, w, reference, disturbance, dt, vehicle, parameters, side_limit
    )
    v_mid, w_mid = 0.5 * (v + v_next), 0.5 * (w + w_next)
    heading = yaw + 0.5 * dt * w_mid
    c, s = math.cos(heading), math.sin(heading)
    x += dt * (v_mid * c + x_icr * w_mid * s)  # Eq. 2.13
    y += dt * (v_mid * s - x_icr * w_mid * c)
    return x, y, yaw + dt * w_mid, v_next, w_next, torque_left, torque_right


@jit
def run_planar(model, references, disturbance, dt, vehicle, parameters, side_limit, stride, row, out):
    """Advance a planar model over all references, writing every `stride`-th state.

    Args:
        model: which one, by its place in `MODELS`.
        references: (n, 2) wheel-rate references [rad/s].
        disturbance: (n,) yaw accelerations [rad/s2], or (1,) for the same at every step.
        dt: step [s].
        vehicle: `Vehicle.packed()` as a tuple.
        parameters: the model's numbers as a tuple, padded to five.
        side_limit: torque limit of a side [N m].
        stride: steps between samples.
        row: (5,) start: x, y, yaw, v, omega; holds the end afterwards.
        out: (1 + n // stride, 13) samples, see `_COLUMNS`; row 0 is the start.

    Returns:
        The first step after which a number is not finite, or -1.
    """
    x, y, yaw, v, w = row[0], row[1], row[2], row[3], row[4]
    r, c_eff = vehicle[2], vehicle[4]
    x_icr = rotation_centre(model, vehicle, parameters)
    n = len(references)
    torque_left, torque_right, sample, due = 0.0, 0.0, 0, 0
    turn, least, most = 0.0, 0.0, 0.0  # yaw acceleration
    for k in range(n + 1):
        if k == due:
            out[sample, 0], out[sample, 1], out[sample, 2] = x, y, yaw
            out[sample, 3], out[sample, 4], out[sample, 5] = v, -x_icr * w, w
            if model == KINEMATIC and k > 0:
                out[sample, 6], out[sample, 7] = references[k - 1, 0], references[k - 1, 1]
            else:
                out[sample, 6], out[sample, 7] = (v - c_eff * w) / r, (v + c_eff * w) / r
            out[sample, 8], out[sample, 9] = torque_left, torque_right
            out[sample, 10], out[sample, 11], out[sample, 12] = turn, least, most
            sample += 1
            due += stride
            least, most = math.inf, -math.inf
        if k == n:
            break
        push = disturbance[k] if len(disturbance) > 1 else disturbance[0]
        w_before = w
        x, y, yaw, v, w, torque_left, torque_right = move(
            model, x, y, yaw, v, w, (references[k, 0], references[k, 1]), push, dt, vehicle, parameters, side_limit, x_icr
        )
        if not math.isfinite(v + w):
            return k
        turn = (w - w_before) / dt
        if turn < least:
            least = turn
        if turn > most:
            most = turn
    row[0], row[1], row[2], row[3], row[4] = x, y, yaw, v, w
    return -1


@jit(parallel=True)
def run_planar_population(
    model, prescribed, values, limits, steps, before, dt, vehicles, parameters, side_limits, stride, starts, poses
):
    """The same inputs for many candidates at once, one a thread; writes (S, M, 3) poses and NaN where one diverges.

    `prescribed`: the values are the wheel rates themselves.
    """
    for i in numba.prange(len(vehicles)):
        period = steps[i, 3]
        n = len(values) * period
        references = np.empty((n, 2))
        if prescribed:
            for k in range(n):
                references[k, 0], references[k, 1] = values[k // period, 0], values[k // period, 1]
        else:
            u = limits[i]
            limit = (u[0], u[1], u[2], u[3], u[4], u[5], u[6])
            whole = (steps[i, 0], steps[i, 1], steps[i, 2], period)
            fill_references(values, limit, whole, before, starts[i, 5], starts[i, 6], references)
        u = vehicles[i]
        vehicle = (u[0], u[1], u[2], u[3], u[4], u[5], u[6], u[7], u[8])
        p = parameters[i]
        row = starts[i, :5].copy()
        out = np.empty((1 + n // stride, 13))
        failed = run_planar(
            model, references, np.zeros(1), dt, vehicle, (p[0], p[1], p[2], p[3], p[4]), side_limits[i], stride, row, out
        )
        if failed >= 0:
            poses[i] = np.nan
        else:
            poses[i] = out[:, :3]


def pack_parameters(parameters: Parameters) -> tuple[int, FloatArray]:
    """The model's number and its parameters, padded to five."""
    out = np.zeros(_WIDTH)
    values = astuple(parameters)
    out[: len(values)] = values
    return list(MODELS.values()).index(type(parameters)), out


@dataclass(frozen=True)
class PlanarModel:
    """A planar model with all its numbers: everything that defines the plant, and no state."""

    parameters: Parameters
    """Which model, and its unknowns."""
    vehicle: Vehicle
    """Mass and geometry."""
    drive: Drive
    """What stands between command and wheels."""

    @property
    def name(self) -> str:
        """One of `PLANAR_MODELS`."""
        return PLANAR_MODELS[pack_parameters(self.parameters)[0]]

    def prescribed(self) -> PlanarModel:
        """What is left of the model where the wheel rates are given, whatever torque that takes.

        No planar model knows longitudinal slip, so of each dynamic one its kinematics remain, Eq. 2.9 and 2.10.
        """
        if isinstance(self.parameters, kinematic.KinematicParameters):
            return self
        c_eff = self.vehicle.effective_half_track
        model, packed = pack_parameters(self.parameters)
        x_icr = rotation_centre(model, tuple(self.vehicle.packed()), tuple(packed))
        return replace(self, parameters=kinematic.KinematicParameters(1.0, 1.0, x_icr, c_eff, -c_eff))


class PlanarPlant:
    """A planar model as a `Plant`."""

    def __init__(self, model: PlanarModel, dt: float = PLANAR_DT) -> None:
        """Start at rest at the origin.

        Args:
            model: what to simulate.
            dt: physics step [s].

        Raises:
            ValueError: the drive's hold is no whole number of steps.
        """
        whole_steps(model.drive.hold, dt, "the drive's hold")
        self._model, self._dt = model, dt
        self._kind, packed = pack_parameters(model.parameters)
        self._parameters = tuple(packed)
        self._vehicle = tuple(model.vehicle.packed())
        self._side_limit = 2.0 * model.drive.torque_limit
        self.reset(State())

    @property
    def name(self) -> str:
        """One of `PLANAR_MODELS`."""
        return self._model.name

    @property
    def dt(self) -> float:
        """Physics step [s]."""
        return self._dt

    def _advance(
        self, references: FloatArray, disturbance: FloatArray, stride: int, row: FloatArray, *, prescribed: bool = False
    ) -> FloatArray:
        """Run the fused loop; `prescribed`: the references are what the wheels do, see `PlanarModel.prescribed`."""
        kind, parameters = self._kind, self._parameters
        if prescribed:
            kind, packed = pack_parameters(self._model.prescribed().parameters)
            parameters = tuple(packed)
        out = np.empty((1 + len(references) // stride, _COLUMNS))
        failed = run_planar(
            kind, references, disturbance, self._dt, self._vehicle, parameters, self._side_limit, stride, row, out
        )
        if failed >= 0:
            t = failed * self._dt
            raise DivergedError(f"{self.name}: no finite velocity after step {failed} (t = {t:.3f} s)", step=failed, t=t)
        return out

    def reset(self, state: State) -> State:
        """Start from `state` with empty delay lines; v_y and wheel rates follow from v_x and yaw rate."""
        self._row = np.array([state.x, state.y, state.yaw, state.v_x, state.yaw_rate])
        out = self._advance(np.empty((0, 2)), np.zeros(1), 1, self._row)[0]
        began = State(*map(float, out[:8]))
        self._driver = Driver(self._model.drive, self._dt, state)
        return began

    def step(self, command: tuple[float, float], dt: float, yaw_acceleration: float = 0.0) -> State:
        """Hold a twist command for `dt` [s]."""
        n = whole_steps(dt, self._dt, "the step")
        references = self._driver.references(command, n)
        return State(*map(float, self._advance(references, np.array([yaw_acceleration]), n, self._row)[-1, :8]))

    def run(self, commands: Commands, state: State, sample_dt: float, disturbance: FloatArray | None = None) -> Trajectory:
        """Drive `commands` at once; channels are the sides' torques, the yaw acceleration and its range between samples."""
        stride = whole_steps(sample_dt, self._dt, "the sample period")
        references = wheel_references(commands, self._model.drive, self._dt, state)
        push = np.zeros(1) if disturbance is None else np.ascontiguousarray(disturbance, dtype=np.float64)
        if disturbance is not None and len(push) != len(references):
            raise ValueError(f"{len(push)} disturbances for {len(references)} physics steps")
        row = np.array([state.x, state.y, state.yaw, state.v_x, state.yaw_rate])
        out = self._advance(references, push, stride, row, prescribed=commands.kind == "wheels")
        channels = {
            "torque_N_m": out[:, 8:10],
            "yaw_acceleration_rad_s2": out[:, 10],
            "yaw_acceleration_range_rad_s2": out[:, 11:13],
        }
        return Trajectory(sample_dt * np.arange(len(out), dtype=np.float64), out[:, :3], out[:, 3:6], out[:, 6:8], channels)


def simulate(
    plant: Plant, commands: Commands, state: State, sample_dt: float, disturbance: FloatArray | None = None
) -> Trajectory:
    """The reference loop: drive any plant physics step by physics step. Slow and obvious; `Plant.run` must equal it.

    Args:
        plant: what to drive.
        commands: twist commands.
        state: where to start.
        sample_dt: time between samples of the result [s].
        disturbance: (n,) yaw acceleration at each physics step [rad/s2].

    Returns:
        The motion, without channels.

    Raises:
        ValueError: wheel-rate commands, or periods that are no whole number of steps.
    """
    if commands.kind != "twist":
        raise ValueError("a plant is stepped by twist commands; wheel rates can only be run")
    period = whole_steps(commands.dt, plant.dt, "the command period")
    stride = whole_steps(sample_dt, plant.dt, "the sample period")
    rows = [plant.reset(state)]
    for k in range(commands.n * period):
        v, w = map(float, commands.values[k // period])
        now = plant.step((v, w), plant.dt, 0.0 if disturbance is None else float(disturbance[k]))
        if (k + 1) % stride == 0:
            rows.append(now)
    table = np.array([astuple(row) for row in rows])
    return Trajectory(sample_dt * np.arange(len(rows), dtype=np.float64), table[:, :3], table[:, 3:6], table[:, 6:8])


def run_population(
    models: Sequence[PlanarModel], commands: Commands, starts: Sequence[State], sample_dt: float, dt: float = PLANAR_DT
) -> FloatArray:
    """Drive many candidates of one model with the same inputs, one a thread (`numba.set_num_threads`).

    Args:
        models: S candidates of the same kind.
        commands: what drives all of them.
        starts: where each starts.
        sample_dt: time between samples [s].
        dt: physics step [s].

    Returns:
        (S, M, 3) poses; a candidate that diverges is NaN throughout, for the caller to rate.

    Raises:
        ValueError: candidates of different kinds, or periods that are no whole number of steps.
    """
    if len({type(m.parameters) for m in models}) != 1:
        raise ValueError("a population is one kind of model")
    prescribed = commands.kind == "wheels"
    stride = whole_steps(sample_dt, dt, "the sample period")
    packed = [pack_parameters((m.prescribed() if prescribed else m).parameters) for m in models]
    drives = [packed_drive(m.drive, commands.dt, dt) for m in models]
    poses = np.empty((len(models), 1 + commands.n * drives[0][1][3] // stride, 3))
    run_planar_population(
        packed[0][0],
        prescribed,
        commands.values,
        np.array([d[0] for d in drives]),
        np.array([d[1] for d in drives]),
        commands.before,
        dt,
        np.array([m.vehicle.packed() for m in models]),
        np.array([p for _, p in packed]),
        np.array([2.0 * m.drive.torque_limit for m in models]),
        stride,
        np.array([(s.x, s.y, s.yaw, s.v_x, s.yaw_rate, s.wheel_left, s.wheel_right) for s in starts]),
        poses,
    )
    return poses
