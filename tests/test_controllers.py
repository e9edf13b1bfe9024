"""Controllers: the laws of their blocks and regulators, without any loop around them."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import control
import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st

from ssmr.control import lqr, pid
from ssmr.control.law import EMPTY_MEMORY, Command, Memory, Observation
from ssmr.control.laws import (
    LAWS,
    PLAIN_CONTROLLERS,
    PREDICTOR,
    Controller,
    make_gains,
    position_step_alone,
    velocity_step_alone,
)
from ssmr.control.waypoints import Errors, Target
from ssmr.models.linear import LinearParameters, state_space_matrices
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.types import FloatArray
from tests.conftest import DERIVATIVE, ROUNDOFF

RICCATI = 1e-7
"""Relative: two solvers of one Riccati equation, whose pencil has eigenvalues from 0.1 to 1000 1/s
for the weights below."""
DT = 0.008
REST = EMPTY_MEMORY
STILL = Target(0.0, 0.0, 0.0, 0.0, 0.0, 0)
NO_ERRORS = Errors(0.0, 0.0, 0.0)
A, B = state_space_matrices(Vehicle(), LinearParameters(), Drive())
SCHEDULED = PLAIN_CONTROLLERS.index("lqr-scheduled")
MODEL = tuple(map(tuple, A.tolist())), tuple(map(tuple, B.tolist()))

errors = st.floats(-2.0, 2.0)
small = st.floats(-0.1, 0.1)
gains = st.floats(0.0, 5.0)
weights = st.floats(0.05, 50.0)
speeds = st.floats(0.0, 1.5)


def controller(name: str) -> Controller:
    """The law with its default gains, on the published linear model."""
    return Controller(LAWS[name].gains(), *MODEL, predictor=name.endswith(PREDICTOR))


def moving(v: float, w: float) -> Observation:
    """A robot at the origin."""
    return Observation(0.0, 0.0, 0.0, v, w)


def target(v: float, w: float) -> Target:
    """A target at the origin."""
    return Target(0.0, 0.0, 0.0, v, w, 0)


@cache
def packed(name: str) -> FloatArray:
    """Its gains for the compiled laws."""
    return controller(name).packed()


def regulator(a: FloatArray, b: FloatArray, q: list[float], r: list[float]) -> FloatArray:
    """K = R^-1 B' P, P by scipy."""
    p = scipy.linalg.solve_continuous_are(a, b, np.diag(q), np.diag(r))
    return np.linalg.solve(np.diag(r), b.T @ p)


# --------------------------------------------------------------------------------------------------
# PI blocks


@given(st.lists(errors, min_size=1, max_size=60), gains, gains)
def test_a_block_is_p_and_a_forward_euler_integral(
    signal: list[float], k_p: float, k_i: float
) -> None:
    integral = 0.0
    out = []
    for error in signal:
        u, integral = pid._pi_block(error, integral, k_p, k_i, math.inf, DT)
        out.append(u)
    e = np.array(signal)
    before = np.concatenate([[0.0], np.cumsum(k_i * DT * e)])
    scale = 1.0 + (k_p + k_i) * np.abs(e).sum()
    assert np.abs(np.array(out) - (k_p * e + before[:-1])).max() <= ROUNDOFF * scale
    assert abs(integral - before[-1]) <= ROUNDOFF * scale


@given(errors, st.floats(-3.0, 3.0), gains, gains, st.floats(0.1, 2.0))
def test_the_integral_stops_exactly_while_the_output_is_at_its_limit_and_both_have_one_sign(
    error: float, integral: float, k_p: float, k_i: float, limit: float
) -> None:
    out, after = pid._pi_block(error, integral, k_p, k_i, limit, DT)
    free = k_p * error + integral
    assert abs(out) <= limit
    if abs(free) <= limit:
        assert out == free
    if abs(free) > limit and integral * error > 0.0:
        assert after == integral
    else:
        assert after == integral + k_i * error * DT


@given(st.lists(st.tuples(small, errors, errors), min_size=1, max_size=40))
def test_the_position_loop_is_the_printed_equations(
    signal: list[tuple[float, float, float]],
) -> None:
    """Tab. 4.1, below the limit of u_ref."""
    g = pid.PidGains()
    memory = REST
    for e_rho, e_y, e_alpha in signal:
        memory = pid._position_loop(
            g.packed(A, B), memory, Errors(e_rho, e_y, e_alpha), STILL, moving(0.0, 0.0), DT
        )
    e = np.array(signal)
    sums = DT * np.sum(signal[:-1], axis=0) if len(signal) > 1 else np.zeros(3)
    u_ref = g.k_p_rho * e[-1, 0] + g.k_i_rho * sums[0]
    w_ref = g.k_p_y * e[-1, 1] + g.k_i_y * sums[1] + g.k_p_alpha * e[-1, 2] + g.k_i_alpha * sums[2]
    assert memory.u_ref == pytest.approx(u_ref, rel=ROUNDOFF, abs=ROUNDOFF)
    assert memory.w_ref == pytest.approx(w_ref, rel=ROUNDOFF, abs=100 * ROUNDOFF)


@given(st.lists(st.tuples(errors, errors), min_size=1, max_size=40), errors, errors)
def test_the_velocity_loop_is_the_printed_equations(
    signal: list[tuple[float, float]], u_ref: float, w_ref: float
) -> None:
    """Tab. 4.2, with references that are held."""
    g = replace(pid.PidGains(), ff_w=0.3)
    memory = Memory(*REST[:5], u_ref, w_ref)
    for v, w in signal:
        memory, (u_cmd, w_cmd) = velocity_step_alone(0, g.packed(A, B), memory, moving(v, w), 0.05)
    e = np.array([u_ref, w_ref]) - np.array(signal)
    sums = 0.05 * e[:-1].sum(axis=0)
    scale = ROUNDOFF * (1.0 + np.abs(e).sum())
    assert abs(u_cmd - (g.k_p_u * e[-1, 0] + g.k_i_u * sums[0] + g.ff_u * u_ref)) <= scale
    assert abs(w_cmd - (g.k_p_w * e[-1, 1] + g.k_i_w * sums[1] + g.ff_w * w_ref)) <= scale
    assert (memory.u_ref, memory.w_ref) == (u_ref, w_ref)


# --------------------------------------------------------------------------------------------------
# all laws alike


@pytest.mark.parametrize("name", PLAIN_CONTROLLERS)
@given(st.tuples(errors, errors, errors), speeds, errors, errors, errors)
def test_left_and_right_are_alike(
    name: str, e: tuple[float, float, float], v_ref: float, w_ref: float, v: float, w: float
) -> None:
    c = controller(name)
    straight = REST
    turned = REST
    for _ in range(3):
        straight = position_step_alone(
            c.number, packed(name), straight, Errors(*e), target(v_ref, w_ref), moving(v, w), DT
        )
        mirrored = Errors(e[0], -e[1], -e[2])
        turned = position_step_alone(
            c.number, packed(name), turned, mirrored, target(v_ref, -w_ref), moving(v, -w), DT
        )
        straight, one = velocity_step_alone(c.number, packed(name), straight, moving(v, w), 0.05)
        turned, other = velocity_step_alone(c.number, packed(name), turned, moving(v, -w), 0.05)
        # the solver leaves 1e-17 where a regulator's gains are zero
        assert np.allclose(one, [other.v, -other.w], rtol=ROUNDOFF, atol=ROUNDOFF)


@pytest.mark.parametrize("name", PLAIN_CONTROLLERS)
def test_without_errors_and_at_rest_nothing_is_commanded(name: str) -> None:
    c = controller(name)
    memory = position_step_alone(
        c.number, packed(name), REST, NO_ERRORS, STILL, moving(0.0, 0.0), DT
    )
    memory, command = velocity_step_alone(c.number, packed(name), memory, moving(0.0, 0.0), 0.05)
    assert command == Command(0.0, 0.0)
    assert memory == REST


# --------------------------------------------------------------------------------------------------
# LQR, Eq. 4.5


@settings(max_examples=40)
@given(weights, st.floats(0.0, 5.0), weights, st.floats(0.0, 5.0), weights, weights)
def test_the_gain_solves_the_riccati_equation(
    q1: float, q2: float, q3: float, q4: float, r1: float, r2: float
) -> None:
    g = lqr.LqrGains(q1, q2, q3, q4, r1, r2)
    k = g.packed(A, B)[:8].reshape(2, 4)
    assert np.allclose(k, regulator(A, B, [q1, q2, q3, q4], [r1, r2]), rtol=RICCATI, atol=RICCATI)
    assert np.linalg.eigvals(A - B @ k).real.max() < 0.0
    # p(s) p(-s) of a chain x'' = a x' + b u at s = 0: the gain of the position does not depend on
    # the plant
    assert k[0, 0] == pytest.approx(math.sqrt(q1 / r1), rel=RICCATI)
    assert k[1, 2] == pytest.approx(math.sqrt(q3 / r2), rel=RICCATI)
    assert np.abs(k[[0, 0, 1, 1], [2, 3, 0, 1]]).max() <= RICCATI  # along and across do not touch


@given(small, small, small, small, small)
def test_the_command_is_minus_k_times_the_state(
    e_rho: float, e_y: float, e_alpha: float, v: float, w: float
) -> None:
    row = np.array([*packed("lqr")[:8], 0.7, 0.4, 0.5])
    integral = 0.05
    memory = REST._replace(i_rho=integral)
    moves = STILL._replace(v=0.5)  # where it stands, integrals are zero
    after = position_step_alone(
        1, row, memory, Errors(e_rho, e_y, e_alpha), moves, moving(v, w), DT
    )
    state = np.array([-(e_rho + integral), v, -(0.7 * e_alpha + 0.4 * e_y), w])
    assert np.allclose(
        [after.u_ref, after.w_ref], -row[:8].reshape(2, 4) @ state, rtol=ROUNDOFF, atol=ROUNDOFF
    )
    assert after.i_rho == integral + 0.5 * e_rho * DT


@pytest.mark.parametrize("name", ["lqr", "lqr-scheduled"])
def test_commands_are_saturated_and_the_integral_is_clamped(name: str) -> None:
    c = Controller(make_gains(name, {"k_i_rho": 5.0}), *MODEL)
    memory = REST
    g = c.packed()
    for _ in range(200):
        memory = position_step_alone(
            c.number, g, memory, Errors(2.0, 1.0, 1.0), STILL, moving(0.0, 0.0), DT
        )
    assert (memory.u_ref, memory.w_ref) == (lqr.V_LIMIT, lqr.W_LIMIT)
    once = position_step_alone(
        c.number, g, REST, Errors(2.0, 1.0, 1.0), STILL, moving(0.0, 0.0), DT
    )
    assert memory.i_rho == once.i_rho


# --------------------------------------------------------------------------------------------------
# scheduled


def applied(gains: FloatArray, v_ref: float) -> FloatArray:
    """(5,) k_x, k_v, k_y, k_alpha, k_w of the law at a speed: its answer to each error alone."""
    size = 1e-3 * np.eye(5)
    size[:2] *= [[-1.0], [1.0]]  # too far, too fast: away from the limit of the speed command

    def answer(e: FloatArray) -> FloatArray:
        off = Errors(*map(float, e[[0, 2, 3]]))
        after = position_step_alone(
            SCHEDULED, gains, REST, off, target(v_ref, 0.0), moving(v_ref + e[1], float(e[4])), DT
        )
        return np.array([after.u_ref, after.w_ref])

    rest = answer(np.zeros(5))
    return np.array([(rest - answer(size[k]))[int(k > 1)] / size[k, k] for k in range(5)])


@settings(max_examples=10)  # a dozen Riccati equations each
# at the last the feedforward saturates
@given(*[weights] * 4, st.sampled_from(lqr.OPERATING_SPEEDS[:-1]))
def test_gains_at_the_operating_speeds_are_those_of_a_regulator(
    q_x: float, q_y: float, q_alpha: float, r_w: float, speed: float
) -> None:
    g = lqr.ScheduledGains(q_x=q_x, q_y=q_y, q_alpha=q_alpha, r_w=r_w)
    used = applied(g.packed(A, B), speed)
    along = np.array([[0.0, -1.0], [0.0, A[1, 1]]]), np.array([[0.0], [B[1, 0]]])
    across = (
        np.array([[0.0, speed, 0.0], [0.0, 0.0, -1.0], [0.0, 0.0, A[3, 3]]]),
        np.array([[0.0], [0.0], [B[3, 1]]]),
    )
    for (a, b), q, r, part in (
        (along, [q_x, g.q_v], g.r_v, used[:2]),
        (across, [q_y, q_alpha, g.q_w], r_w, used[2:]),
    ):
        k, _, poles = control.lqr(a, b, np.diag(q), np.diag([r]))
        # differences of commands of order one, over errors of 1e-3
        assert np.allclose(part, k[0], rtol=DERIVATIVE, atol=1e-9)
        assert poles.real.max() < 0.0
        assert np.linalg.eigvals(a - b @ k).real.max() < 0.0


@given(st.floats(0.1, 0.9), st.floats(0.1, 0.9))
def test_gains_change_with_speed_as_theory_says(one: float, other: float) -> None:
    """Spectral factorisation of the lateral chain at frequency zero: k_y^2 = q_y / r.

    The next coefficient makes k_alpha grow with it: without lag k_alpha^2 = q_alpha / r + 2 v
    sqrt(q_y / r).
    """
    g = lqr.ScheduledGains()
    slow, fast = (applied(packed("lqr-scheduled"), v) for v in sorted((one, other)))
    assert np.allclose([slow[2], fast[2]], -math.sqrt(g.q_y / g.r_w), rtol=DERIVATIVE)
    assert np.allclose(slow[:2], fast[:2], rtol=DERIVATIVE)
    assert abs(slow[3]) <= abs(fast[3]) * (1.0 + DERIVATIVE)
    assert slow[4] <= fast[4] * (1.0 + DERIVATIVE)


@given(st.floats(0.0, 0.9), st.floats(-1.0, 1.0))
def test_the_feedforward_holds_the_targets_twist(v_ref: float, w_ref: float) -> None:
    after = position_step_alone(
        SCHEDULED,
        packed("lqr-scheduled"),
        REST,
        NO_ERRORS,
        target(v_ref, w_ref),
        moving(v_ref, w_ref),
        DT,
    )
    change = A @ np.array([0.0, v_ref, 0.0, w_ref]) + B @ np.array([after.u_ref, after.w_ref])
    # rates of 40 1/s, so absolute accelerations of 1e-11
    assert np.abs(change[[1, 3]]).max() <= 1e-10
    assert after.i_rho == 0.0


# --------------------------------------------------------------------------------------------------
# what is refused


@pytest.mark.parametrize("name", PLAIN_CONTROLLERS)
@pytest.mark.parametrize("bad", [-1e-9, math.nan, math.inf, -math.inf, 1e7])
def test_gains_that_make_no_sense_are_refused_by_name(name: str, bad: float) -> None:
    for field in LAWS[name].gains.__dataclass_fields__:
        with pytest.raises(ValueError, match=rf"Gains\.{field} = .* lies outside"):
            make_gains(name, {field: bad})
