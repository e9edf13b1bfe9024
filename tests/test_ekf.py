"""The state filter: its laws, its derivative, and that it is as sure as it says."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssmr.estimation.ekf import (
    _filter_log,
    filter_step,
    initial_belief,
    predict_belief,
    run_ekf,
    update_belief,
)
from ssmr.estimation.settings import Belief, EkfSettings
from ssmr.parameters import pack_numbers
from ssmr.robot.drive import Sides, wheel_rates
from ssmr.robot.sensors import SensorLog, SensorModel, sense_rates, simulate_sensors
from ssmr.types import FloatArray, State, Trajectory
from tests.conftest import DERIVATIVE, ROUNDOFF

STOCK = EkfSettings()
SURE = (0.02, 0.03, 0.05, 0.04, 0.06)
"""Standard deviations of a start that is roughly known."""
numbers = st.floats(-3.0, 3.0)


def random_belief(seed: int) -> Belief:
    rng = np.random.default_rng(seed)
    root = 0.3 * rng.standard_normal((5, 5))
    return rng.standard_normal(5), root @ root.T


def copied(belief: Belief) -> Belief:
    return belief[0].copy(), belief[1].copy()


def motion(mean: FloatArray, dt: float) -> FloatArray:
    """The midpoint rule as a book writes it."""
    x, y, yaw, v, w = mean
    heading = yaw + 0.5 * dt * w
    return np.array(
        [x + dt * v * np.cos(heading), y + dt * v * np.sin(heading), yaw + dt * w, v, w]
    )


def jacobian(mean: FloatArray, dt: float) -> FloatArray:
    """Its derivative, by hand."""
    heading = mean[2] + 0.5 * dt * mean[4]
    v = mean[3]
    f = np.eye(5)
    f[0, 2:] = -dt * v * np.sin(heading), dt * np.cos(heading), -0.5 * dt * dt * v * np.sin(heading)
    f[1, 2:] = dt * v * np.cos(heading), dt * np.sin(heading), 0.5 * dt * dt * v * np.cos(heading)
    f[2, 4] = dt
    return f


def process_noise(mean: FloatArray, dt: float, process: tuple[float, ...]) -> FloatArray:
    """The integral of f(s) q f(s)' over a step, by Gauss.

    f are the columns of the Jacobian after s at the step's heading.
    """
    nodes, weights = np.polynomial.legendre.leggauss(5)
    heading = mean[2] + 0.5 * dt * mean[4]
    v = mean[3]
    total = process[0] * dt * np.diag([1.0, 1.0, 0.0, 0.0, 0.0])
    for node, weight in zip(nodes, weights, strict=True):
        s = 0.5 * dt * (node + 1.0)
        across = np.array([-np.sin(heading), np.cos(heading)])
        along = np.array([np.cos(heading), np.sin(heading)])
        columns = (
            np.array([*(s * v * across), 1.0, 0.0, 0.0]),
            np.array([*(s * along), 0.0, 1.0, 0.0]),
            np.array([*(0.5 * s * s * v * across), s, 0.0, 1.0]),
        )
        for q, f in zip(process[1:], columns, strict=True):
            total += 0.5 * dt * weight * q * np.outer(f, f)
    return total


def process_of(s: EkfSettings) -> tuple[float, ...]:
    return s.process_position, s.process_yaw, s.process_v, s.process_yaw_rate


def textbook_step(
    mean: FloatArray, p: FloatArray, sensed: SensorLog, dt: float, s: EkfSettings
) -> tuple[FloatArray, FloatArray]:
    """Predict with F P F' + Q and take in all three measurements at once with K = P H' S^-1."""
    _, left, right, gyro = sensed
    f = jacobian(mean, dt)
    p = f @ p @ f.T + process_noise(mean, dt, process_of(s))
    mean = motion(mean, dt)
    h = np.array([[0, 0, 0, 1, 0], [0, 0, 0, 0, 1], [0, 0, 0, 0, 1]], dtype=float)
    z = np.array(
        [0.5 * s.radius * (left + right), 0.5 * s.radius * (right - left) / s.half_track, gyro]
    )
    r = np.diag([s.variance_v, s.variance_wheel_yaw_rate, s.variance_gyro])
    k = p @ h.T @ np.linalg.inv(h @ p @ h.T + r)
    return mean + k @ (z - h @ mean), (np.eye(5) - k @ h) @ p


def circle(
    dt: float, duration: float = 4.0, v: float = 0.8, w: float = 1.3
) -> tuple[FloatArray, FloatArray]:
    t = dt * np.arange(round(duration / dt) + 1)
    return t, np.column_stack([v / w * np.sin(w * t), v / w * (1.0 - np.cos(w * t)), w * t])


def exact_sensors(
    n: int, v: float, w: float, s: EkfSettings = STOCK
) -> tuple[FloatArray, FloatArray, FloatArray]:
    left, right = wheel_rates(v, w, s.half_track, s.radius)
    return np.full(n, left), np.full(n, right), np.full(n, w)


def test_exact_sensors_on_a_circle_err_by_the_midpoint_rule_alone() -> None:
    """Its chord is v dt instead of 2 v/w sin(w dt/2): second order, and the yaw is exact."""
    errors = []
    for dt in (0.1, 0.05, 0.025):
        t, pose = circle(dt)
        got = run_ekf(
            SensorLog(t, *exact_sensors(len(t), 0.8, 1.3)), STOCK, State(v_x=0.8, yaw_rate=1.3)
        )
        chord = 0.8 * dt / (2.0 * 0.8 / 1.3 * math.sin(0.65 * dt))
        assert np.allclose(got.pose[:, :2], chord * pose[:, :2], rtol=0.0, atol=1e-11)
        assert np.allclose(got.yaw, pose[:, 2], rtol=0.0, atol=1e-11)
        errors.append(np.abs(got.pose - pose).max())
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx(2.0, abs=0.02)


@given(st.lists(numbers, min_size=5, max_size=5), st.floats(0.001, 1.0))
def test_the_jacobian_is_the_derivative_of_the_motion(state: list[float], dt: float) -> None:
    """The derivative is that of the textbook filter below, to which the kernel is held."""
    mean = np.array(state)
    h = 1e-5
    differences = np.column_stack(
        [(motion(mean + h * e, dt) - motion(mean - h * e, dt)) / (2 * h) for e in np.eye(5)]
    )
    assert np.allclose(jacobian(mean, dt), differences, rtol=DERIVATIVE, atol=DERIVATIVE)


@given(st.integers(0, 1000), st.floats(0.001, 0.2), numbers, numbers, numbers)
def test_it_is_the_textbook_filter(
    seed: int, dt: float, left: float, right: float, gyro: float
) -> None:
    s = EkfSettings(
        process_position=0.1,
        process_yaw=0.2,
        process_v=0.3,
        process_yaw_rate=0.4,
        variance_gyro=0.05,
    )
    belief = random_belief(seed)
    mean, p = copied(belief)
    for k in range(5):
        sensed = SensorLog(0.0, left + k, right, gyro - 0.1 * k)
        filter_step(belief, sensed, dt, s.packed())
        mean, p = textbook_step(mean, p, sensed, dt, s)
        assert np.allclose(belief[0], mean, rtol=1e-10, atol=1e-10)
        assert np.allclose(belief[1], p, rtol=1e-10, atol=1e-10)


@given(numbers, numbers, st.floats(0.05, 1.0), st.floats(0.0, 1.0))
def test_how_a_straight_way_is_cut_does_not_matter(
    yaw: float, v: float, dt: float, cut: float
) -> None:
    whole = np.array([0.3, 0.4, yaw, v, 0.0]), random_belief(7)[1]
    parts = copied(whole)
    process = EkfSettings(
        process_position=0.1, process_yaw=0.2, process_v=0.3, process_yaw_rate=0.4
    ).packed()
    predict_belief(whole, dt, process)
    predict_belief(parts, cut * dt, process)
    predict_belief(parts, dt - cut * dt, process)
    for one, two in zip(whole, parts, strict=True):
        # two steps of some forty operations
        assert np.allclose(one, two, rtol=ROUNDOFF, atol=10 * ROUNDOFF)


@settings(max_examples=8)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.001, 0.02, 0.5]),
    st.sampled_from([1.0, 30.0, 1000.0]),
)
def test_the_covariance_stays_symmetric_and_positive(seed: int, dt: float, wild: float) -> None:
    rng = np.random.default_rng(seed)
    n = 1000
    belief = initial_belief(State())
    out = np.empty((n, 19))
    for _ in range(100):
        t = np.cumsum(rng.uniform(0.01 * dt, dt, n))
        left, right, gyro = wild * rng.standard_normal((3, n))
        gyro[rng.random(n) < 0.3] = np.nan
        _filter_log(SensorLog(t, left, right, gyro), STOCK.packed(), belief, out)
        p = belief[1]
        assert np.array_equal(p, p.T)
        assert np.all(np.isfinite(belief[0]))
        scale = 1.0 / np.sqrt(np.diag(p))
        np.linalg.cholesky(p * np.outer(scale, scale))  # raises unless positive definite


def test_a_sharp_measurement_of_a_wide_guess_leaves_a_positive_variance() -> None:
    """P R/S and not P - P P/S, of which 24 orders of magnitude below P nothing would be left."""
    mean, p = belief = np.zeros(5), 0.5e12 * (np.eye(5) + np.ones((5, 5)))
    update_belief(belief, 3, 1.0, 1e-12)
    assert np.allclose(p[3], 1e-12 * np.array([0.5, 0.5, 0.5, 1.0, 0.5]), rtol=ROUNDOFF, atol=0.0)
    assert np.array_equal(p, p.T)
    assert mean[3] == 1.0


class Fleet:
    """Two hundred robots that move as the filter supposes, and their filters.

    The truth in steps of a quarter of theirs.
    """

    RUNS = 200
    STEPS = 200
    DT = 0.02
    PARTS = 4

    def __init__(self) -> None:
        # enough of every noise to be seen
        rng, s = np.random.default_rng(2024), replace(STOCK, process_yaw=1e-4)
        start = np.array([0.5, -0.3, 0.4, 0.6, 0.2])
        truth = start + SURE * rng.standard_normal((self.RUNS, 5))
        beliefs = [(start.copy(), np.diag(np.square(SURE))) for _ in range(self.RUNS)]
        h = self.DT / self.PARTS
        root = np.sqrt(
            h
            * np.array(
                [
                    s.process_position,
                    s.process_position,
                    s.process_yaw,
                    s.process_v,
                    s.process_yaw_rate,
                ]
            )
        )
        self.errors = np.empty((self.STEPS, self.RUNS, 5))
        self.p = np.empty((self.STEPS, self.RUNS, 5, 5))
        self.nis = np.empty((self.STEPS, self.RUNS, 3))
        variances = (s.variance_v, s.variance_wheel_yaw_rate, s.variance_gyro)
        for k in range(self.STEPS):
            for _ in range(self.PARTS):
                truth = motion(truth.T, h).T + root * rng.standard_normal((self.RUNS, 5))
            sensed = truth[:, [3, 4, 4]] + np.sqrt(variances) * rng.standard_normal((self.RUNS, 3))
            for i, belief in enumerate(beliefs):
                predict_belief(belief, self.DT, s.packed())
                for j, (state, value, r) in enumerate(
                    zip((3, 4, 4), sensed[i], variances, strict=True)
                ):
                    self.nis[k, i, j] = (value - belief[0][state]) ** 2 / (
                        belief[1][state, state] + r
                    )
                    update_belief(belief, state, value, r)
                self.errors[k, i] = truth[i] - belief[0]
                self.p[k, i] = belief[1]


@pytest.fixture(scope="module")
def fleet() -> Fleet:
    return Fleet()


def nees(errors: FloatArray, p: FloatArray) -> FloatArray:
    """Errors squared in units of what was claimed of them, e' P^-1 e."""
    return np.einsum("...i,...i", errors, np.linalg.solve(p, errors[..., None])[..., 0])


def assert_mean_is_chi_square(values: FloatArray, degrees: int) -> None:
    """N independent chi-squares of d degrees have a mean of d, with the standard error sqrt(2 d/N).

    4 of them allowed.
    """
    assert abs(values.mean() - degrees) < 4.0 * math.sqrt(2.0 * degrees / values.size)


@pytest.mark.parametrize("k", [0, 9, 49, 99, 149, 199])
def test_it_is_as_sure_of_its_velocities_as_it_may_be(fleet: Fleet, k: int) -> None:
    """200 runs, independent; within one run errors are not, so instants are taken one by one."""
    assert_mean_is_chi_square(nees(fleet.errors[k, :, 3:], fleet.p[k, :, 3:, 3:]), 2)


@pytest.mark.parametrize("k", [0, 9, 49, 99, 149, 199])
def test_it_is_as_sure_of_its_pose_as_it_may_be(fleet: Fleet, k: int) -> None:
    """Nothing measures the pose, so what is claimed of it is all that there is to go by."""
    assert_mean_is_chi_square(nees(fleet.errors[k], fleet.p[k]), 5)
    claimed = np.sqrt(np.diagonal(fleet.p[k], axis1=-2, axis2=-1)[:, :3].mean(axis=0))
    # 4 standard errors, 4/sqrt(400)
    assert fleet.errors[k, :, :3].std(axis=0) == pytest.approx(claimed, rel=0.2)


def test_innovations_are_white_and_of_the_size_foreseen(fleet: Fleet) -> None:
    """The innovations of a consistent filter are independent, so all 120 000 count."""
    for j in range(3):
        assert_mean_is_chi_square(fleet.nis[:, :, j], 1)
    centred = fleet.nis - 1.0
    # variance 2 each
    assert abs((centred[1:] * centred[:-1]).mean()) < 4.0 * 2.0 / math.sqrt(centred[1:].size)


def test_the_gyro_saves_the_yaw_where_the_wheels_slip() -> None:
    """A robot with an effective half-track of 0.5 m, odometry with 0.275 m.

    Wheels alone turn it 1.8 times too far.
    """
    slipping = replace(STOCK, half_track=0.5)
    t, pose = circle(0.02)
    left, right, gyro = exact_sensors(len(t), 0.8, 1.3, slipping)
    start = State(v_x=0.8, yaw_rate=1.3)
    sound, alone = (SensorLog(t, left, right, g) for g in (gyro, np.full(len(t), np.nan)))
    turned = run_ekf(sound, STOCK, start)
    wrong = run_ekf(alone, STOCK, start)
    reported = run_ekf(alone, slipping, start)
    assert turned.yaw[-1] == pytest.approx(pose[-1, 2], rel=0.002)  # a thousandth of 0.8
    # it takes some samples to believe the wheels
    assert wrong.yaw[-1] == pytest.approx(0.5 / 0.275 * pose[-1, 2], rel=0.02)
    assert reported.yaw[-1] == pytest.approx(pose[-1, 2], rel=1e-9)
    assert reported.channels["pose_std"][-1, 2] > 3.0 * turned.channels["pose_std"][-1, 2]


def test_wheels_of_infinite_variance_are_not_used_and_nan_is_no_sample() -> None:
    t, _ = circle(0.02)
    left, right, gyro = exact_sensors(len(t), 0.8, 1.3)
    deaf = replace(STOCK, variance_wheel_yaw_rate=math.inf)
    start = State(v_x=0.8, yaw_rate=1.3)
    assert run_ekf(SensorLog(t, right, left, gyro), deaf, start).yaw[-1] == pytest.approx(
        1.3 * t[-1], rel=1e-12
    )
    half = gyro.copy()
    half[::2] = np.nan
    assert run_ekf(SensorLog(t, left, right, half), STOCK, start).yaw[-1] == pytest.approx(
        1.3 * t[-1], rel=1e-12
    )


def test_sensors_have_their_noise_their_bias_and_their_rate() -> None:
    n = 20001
    model = SensorModel(variance_encoder=0.01, variance_gyro=0.04, gyro_bias=-0.5)
    wheels = np.column_stack([np.full(n, 3.0), np.full(n, 4.0)])
    moving = Trajectory(0.002 * np.arange(n), np.zeros((n, 3)), np.full((n, 3), 0.7), wheels)
    log, same = (simulate_sensors(moving, np.random.default_rng(9), model) for _ in range(2))
    assert all(np.array_equal(a, b) for a, b in zip(log, same, strict=True))
    assert np.array_equal(log.t, moving.t[::10])
    m = len(log.t)  # 2001: a sample variance is within 4 standard errors, 4 sqrt(2/2000) = 13 %
    for seen, mean, variance in (
        (log.left, 3.0, 0.01),
        (log.right, 4.0, 0.01),
        (log.gyro, 0.2, 0.04),
    ):
        assert seen.var() == pytest.approx(variance, rel=0.13)
        assert seen.mean() == pytest.approx(mean, abs=4.0 * math.sqrt(variance / m))
    draws = np.random.default_rng(9).standard_normal((m, 3))
    seen = log.left[5], log.right[5], log.gyro[5]
    sample = sense_rates(0.0, Sides(3.0, 4.0), 0.7, tuple(draws[5]), pack_numbers(model))
    assert sample[1:] == pytest.approx(seen, rel=ROUNDOFF)
    uneven = simulate_sensors(moving, np.random.default_rng(9), model, rate=130.0)
    assert np.all(np.isin(uneven.t, moving.t))
    assert np.allclose(uneven.t, np.arange(len(uneven.t)) / 130.0, rtol=0.0, atol=0.002)
    with pytest.raises(ValueError, match="rate"):
        simulate_sensors(moving, np.random.default_rng(9), model, rate=0.0)


def test_a_bias_is_taken_at_rest() -> None:
    """A bias of sd 0.0156 rad/s: the mean NEES of the pose, of 3, stays below 6.

    50 robots stand for 10 s, then drive a circle for 30 s. Only the rest's share of the errors is
    in it: the drawn mean of 500 readings, of which the filter does not know how sure it is.
    """
    t = 0.02 * np.arange(2000)
    driving = t >= 10.0
    w = np.where(driving, 0.4, 0.0)
    v = np.where(driving, 0.4, 0.0)
    yaw = np.cumsum(np.append(0.0, 0.02 * w[1:]))
    middle = yaw - 0.01 * w
    pose = np.column_stack(
        [np.cumsum(0.02 * v * np.cos(middle)), np.cumsum(0.02 * v * np.sin(middle)), yaw]
    )
    left, right = wheel_rates(v, w, STOCK.half_track, STOCK.radius)
    true = Trajectory(t, pose, np.column_stack([v, 0.0 * v, w]), np.column_stack([left, right]))
    means = {}
    for standing in (0.0, 10.0):
        seen = []
        for seed in range(50):
            rng = np.random.default_rng(seed)
            sensors = SensorModel(gyro_bias=0.0156 * rng.standard_normal())
            log = simulate_sensors(true, rng, sensors)
            run = run_ekf(log, STOCK, State(), standing)
            errors = (run.pose - true.pose)[driving]
            seen.append(nees(errors, run.channels["pose_covariance"][driving]))
        means[standing] = float(np.mean(seen))
    assert means[0.0] > 100.0
    assert means[10.0] < 6.0


def test_rest_without_a_gyro_is_refused() -> None:
    t = 0.02 * np.arange(100)
    log = SensorLog(t, 0.0 * t, 0.0 * t, np.full(100, math.nan))
    with pytest.raises(ValueError, match="gave nothing in the 1 s of rest"):
        run_ekf(log, STOCK, State(), 1.0)
