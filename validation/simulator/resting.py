"""Rest of a robot on level ground, computed by Newton's method and not by letting it settle.

Height, roll and pitch are such that its contacts neither lift nor tilt it. That takes some ten
evaluations of the forces instead of hundreds of steps, and the result does not hang on how long it
had to settle.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import mujoco
import numpy as np

from ssmr.robot.ground import FRONT, LEFT
from ssmr.types import FloatArray
from validation.simulator.calibration import Calibration
from validation.simulator.parts import robot_parts

_DOFS = slice(2, 5)
"""Height, roll and pitch among the degrees of freedom."""
_STEPS = 40
"""Most steps; four or five suffice as a rule."""
_CLOSE = 1e-7
"""Step at which the search ends, in units of how far tyres are pressed in: that error's square
remains."""
_PROBE = 1e-5
"""Step of finite differences, in the same units."""
_SLOW = 0.1
"""Reduction of the residual in a step from which on the Jacobian is computed anew."""
_TOLERANCE = 1e-14
"""Tolerance of the constraint solver, which must not limit the accuracy here."""
_ITERATIONS = 100
"""Greatest number of the constraint solver's iterations."""


def level_rest(
    model: mujoco.MjModel, data: mujoco.MjData, calibration: Calibration
) -> FloatArray | None:
    """Return the (nq,) configuration in which a robot rests on level ground at the origin.

    None where the search does not converge: a robot that tips over, for example.

    Args:
        model: the calibrated model; it is left as it was.
        data: a state to compute in, reset.
        calibration: the robot's numbers.
    """
    with solved_exactly(model):
        try:
            return _search_rest(model, data, *_guess_rest(model, calibration))
        except np.linalg.LinAlgError:  # fewer than three wheels touch the ground
            return None


@contextlib.contextmanager
def solved_exactly(model: mujoco.MjModel) -> Iterator[None]:
    """Within, the model's constraints are solved to rounding.

    The rest of a robot must not depend on its solver.
    """
    option = model.opt
    before = option.solver, option.tolerance, option.iterations
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.tolerance = _TOLERANCE
    option.iterations = _ITERATIONS
    try:
        yield
    finally:
        option.solver, option.tolerance, option.iterations = before


def _guess_rest(model: mujoco.MjModel, calibration: Calibration) -> tuple[FloatArray, FloatArray]:
    """Return a first configuration, and (3,) changes of height [m], roll and pitch [rad].

    Each of these changes presses the tyres in to half their depth.
    """
    rolling = calibration.radii
    # as `set_calibration` estimated them
    depths = 2.0 * (model.geom_size[robot_parts(model).tires, 0] - rolling)
    heights = rolling - 0.5 * depths
    half_base = 0.5 * calibration.robot.wheelbase
    half_track = calibration.half_track
    pitch = -(FRONT @ heights) / (4.0 * half_base)
    roll = (LEFT @ heights) / (4.0 * half_track)
    start = np.array(model.qpos0)
    start[2] = heights.mean() - calibration.robot.axle_height
    turn = np.zeros(model.nv)
    turn[3:5] = roll, pitch
    mujoco.mj_integratePos(model, start, turn, 1.0)
    levers = np.array([1.0, 1.0 / half_track, 1.0 / half_base])
    return start, 0.5 * depths.mean() * levers


def _search_rest(
    model: mujoco.MjModel, data: mujoco.MjData, place: FloatArray, reach: FloatArray
) -> FloatArray | None:
    """Return the configuration at rest near `place`, in steps of at most `reach`; None without."""
    move = np.zeros(model.nv)
    jacobian = np.empty((3, 3))
    last = np.inf

    def pull(change: FloatArray | float) -> FloatArray:
        """Return the body's (3,) accelerations at rest after a change of height and angles."""
        data.qpos[:] = place
        move[_DOFS] = change
        mujoco.mj_integratePos(model, data.qpos, move, 1.0)
        data.qacc_warmstart[:] = 0.0
        mujoco.mj_forward(model, data)
        return np.array(data.qacc[_DOFS])

    for _ in range(_STEPS):
        residual = pull(0.0)
        size = np.abs(residual).max()
        if size > _SLOW * last or last == np.inf:
            for k, probe in enumerate(np.diag(_PROBE * reach)):
                jacobian[:, k] = (pull(probe) - residual) / (_PROBE * reach[k])
        last = size
        # a Newton step, shortened so that no tyre moves by more than half its depth
        change = np.linalg.solve(jacobian, -residual)
        far = np.max(np.abs(change) / reach)
        if not far < np.inf:
            return None
        move[_DOFS] = change / max(1.0, far)
        mujoco.mj_integratePos(model, place, move, 1.0)
        if far < _CLOSE:
            return place
    return None
