"""The filter that learns: its derivatives, and that it finds what no data sheet says."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.estimation.ekf import (
    filter_step,
    forward_speed,
    initial_belief,
    predict,
    run_ekf,
    stand,
    wheel_yaw_rate,
)
from ssmr.estimation.settings import (
    BIAS,
    LEFT,
    RIGHT,
    SLIDE,
    TURNING,
    Belief,
    EkfSettings,
    V,
    X,
    Y,
    commission,
    learning,
)
from ssmr.robot.sensors import SensorLog, SensorSample
from ssmr.types import FloatArray, State, Trajectory
from tests.conftest import DERIVATIVE

STOCK = EkfSettings()
LEARNS = learning(STOCK)
STATES = SLIDE + 1
NEARBY = np.array([0.4, -0.2, 0.7, 0.5, 0.3, 0.01, 1.03, 0.96, 1.6, 0.03, -0.05])
"""A state in which no derivative is 0."""


def rates(v: FloatArray, w: FloatArray, s: EkfSettings) -> tuple[FloatArray, FloatArray]:
    """Wheel rates of a robot that slips as the filter supposes, by the geometry of each side."""
    ahead, half = v - s.shift * w, s.turning * s.half_track / (0.5 * (s.scale_left + s.scale_right))
    return s.scale_left * (ahead - half * w) / s.radius, s.scale_right * (ahead + half * w) / s.radius


def drive(s: EkfSettings, seconds: float = 60.0, period: float = 0.01) -> Trajectory:
    """Return the motion of a robot with the constants of `s` that stands for 3 s, then drives in curves to both sides."""
    t = period * np.arange(round(seconds / period) + 1)
    going = np.clip(t - 3.0, 0.0, 1.0)
    v, w = 0.5 * going, going * (0.3 * np.sin(0.9 * (t - 3.0)) + 0.4 * np.sin(0.23 * t))
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * (w[1:] + w[:-1])) * period])
    across = s.slide * w
    speed = np.stack([v * np.cos(yaw) - across * np.sin(yaw), v * np.sin(yaw) + across * np.cos(yaw)])
    xy = np.concatenate([np.zeros((2, 1)), np.cumsum(0.5 * (speed[:, 1:] + speed[:, :-1]), axis=1) * period], axis=1)
    return Trajectory(t, np.column_stack([*xy, yaw]), np.column_stack([v, across, w]), np.column_stack(rates(v, w, s)))


# --------------------------------------------------------------------------------------------------------------- its laws
def test_with_constants_that_are_known_and_neutral_it_is_the_thesis_filter() -> None:
    rng, n = np.random.default_rng(3), 500
    left, right, gyro = rng.normal([4.0, 5.0, 0.4], 0.5, (n, 3)).T
    t, start = np.cumsum(rng.uniform(0.01, 0.03, n)), State(0.1, 0.2, 0.3, 0.4, 0.0, 0.5)
    plain = run_ekf(t, left, right, gyro, STOCK, start)
    assert "constants" not in plain.channels
    nothing_new = replace(STOCK, bias_std=1e-200)  # its square is zero
    learns = run_ekf(t, left, right, gyro, nothing_new, start)
    assert np.abs(learns.pose - plain.pose).max() < 1e-10  # the wheels' yaw rate is used before the gyro or after it
    assert np.array_equal(learns.channels["constants"][-1], [0.0, 1.0, 1.0, 1.0, 0.0, 0.0])


def test_the_derivatives_of_what_it_expects_are_right() -> None:
    h, step = STOCK.half_track, 1e-6
    for kernel in (forward_speed, wheel_yaw_rate):
        row, aside = np.empty(STATES), np.empty(STATES)
        kernel(NEARBY, h, row)
        numeric = [
            (kernel(NEARBY + step * e, h, aside) - kernel(NEARBY - step * e, h, aside)) / (2.0 * step)
            for e in np.eye(STATES)
        ]
        assert np.allclose(row, numeric, rtol=DERIVATIVE, atol=DERIVATIVE)


def test_the_covariance_moves_with_the_derivative_of_the_motion() -> None:
    quiet = replace(STOCK, process_position=0.0, process_yaw=0.0, process_v=0.0, process_yaw_rate=0.0).packed()
    dt, step = 0.05, 1e-6
    columns, numeric = [], []
    for e in np.eye(STATES):
        one = Belief(NEARBY.copy(), np.outer(e, e))
        predict(one, dt, quiet)
        two, three = (Belief(NEARBY + sign * step * e, np.zeros((STATES, STATES))) for sign in (1.0, -1.0))
        predict(two, dt, quiet)
        predict(three, dt, quiet)
        numeric.append((two.mean - three.mean) / (2.0 * step))
        columns.append(one.covariance)
    for covariance, f in zip(columns, numeric, strict=True):
        assert np.allclose(covariance, np.outer(f, f), rtol=0.0, atol=1e-7)


@given(st.integers(0, 200))
def test_the_covariance_stays_symmetric_and_positive(seed: int) -> None:
    rng, belief = np.random.default_rng(seed), initial_belief(State(), (0.1,) * 5, LEARNS)
    for _ in range(300):
        sample = SensorSample(*rng.normal([4.0, 5.0, 0.4], 1.0))
        filter_step(belief, sample, rng.uniform(0.001, 0.05), LEARNS.packed())
    assert np.array_equal(belief.covariance, belief.covariance.T)
    scale = 1.0 / np.sqrt(np.diag(belief.covariance))
    assert np.linalg.eigvalsh(belief.covariance * np.outer(scale, scale)).min() > -1e-9


# ------------------------------------------------------------------------------------------------------- what it learns
TRUE = replace(STOCK, half_track=0.2515, scale_left=1.05, scale_right=1.11, turning=1.95, shift=-0.02, slide=0.06)
"""Constants like those of a Husky with soft tyres on tile."""


def sensors(truth: Trajectory, bias: float, seed: int) -> SensorLog:
    rng = np.random.default_rng(seed)
    wheels = truth.wheels + math.sqrt(0.003677) * rng.standard_normal(truth.wheels.shape)
    gyro = truth.twist[:, 2] + bias + math.sqrt(STOCK.variance_gyro) * rng.standard_normal(len(truth))
    return SensorLog(truth.t, wheels[:, 0].copy(), wheels[:, 1].copy(), gyro)


def test_commissioning_finds_the_constants_of_a_robot_that_slips_so() -> None:
    found = commission([drive(TRUE)], replace(STOCK, half_track=0.2515))
    assert found.constants == pytest.approx(TRUE.constants, abs=1e-9)
    assert max(found.slip_along, found.slip_across, found.slip_turn) < 1e-15
    with pytest.raises(ValueError, match="move and turn"):
        commission([Trajectory(np.arange(3.0), *(np.zeros((3, n)) for n in (3, 3, 2)))], STOCK)


def test_a_bias_is_learned_at_rest_and_kept() -> None:
    truth = drive(STOCK)
    still = truth.t < 3.0
    log, settings = sensors(truth, -0.0156, 1), learning(STOCK)
    plain = run_ekf(*log, STOCK, State())
    learned = run_ekf(*log, settings, State(), still=still)
    assert abs(plain.yaw[-1] - truth.yaw[-1]) > 0.8  # 0.0156 rad/s for a minute
    assert abs(learned.yaw[-1] - truth.yaw[-1]) < 4.0 * learned.channels["pose_std"][-1, 2]
    assert abs(learned.yaw[-1] - truth.yaw[-1]) < 0.05
    at_rest = learned.channels["constants_std"][still, 0]
    n = np.count_nonzero(still)  # Bayes' rule for a constant, whose gyro noise is all that there is
    assert at_rest[-1] == pytest.approx(math.sqrt(STOCK.variance_gyro / n), rel=0.05)
    assert learned.channels["constants"][-1, 0] == pytest.approx(-0.0156, abs=4.0 * learned.channels["constants_std"][-1, 0])


def test_standing_tells_the_speed_and_the_bias() -> None:
    belief = initial_belief(State(), (0.0, 0.0, 0.0, 1.0, 1.0), LEARNS)
    stand(belief)
    filter_step(belief, SensorSample(0.0, 0.0, 0.013), 0.0, LEARNS.packed())
    assert belief.mean[BIAS] == pytest.approx(0.013, rel=0.1)
    assert abs(belief.mean[V]) < 1e-3
    assert [belief.mean[k] for k in (LEFT, RIGHT, TURNING, X, Y)] == pytest.approx([1.0, 1.0, 1.0, 0.0, 0.0], abs=1e-3)
