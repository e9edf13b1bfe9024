"""Stability of the PID around the linear model: against closed forms, and against the loops that it stands for."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from ssmr.control.laws import Controller
from ssmr.control.loop import VELOCITY_PERIOD, ClosedRun, LoopSettings
from ssmr.control.pid import PidGains
from ssmr.control.population import Loop, run_loops
from ssmr.control.stability import CascadeLoop, gain_range
from ssmr.control.waypoints import Waypoints
from ssmr.models.linear import LinearParameters, matrices
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.simulation import PlanarModel
from ssmr.types import State

A, B = matrices(Vehicle(), LinearParameters(), Drive())
NONE = PidGains(**dict.fromkeys(PidGains.__dataclass_fields__, 0.0))
SLOW = 0.25
"""Speed of the loops that are driven [m/s]: far from every limit."""


def along(**changes: float) -> CascadeLoop:
    return CascadeLoop("along", -A[1, 1], B[1, 0], SLOW, **changes)


def across(**changes: float) -> CascadeLoop:
    return CascadeLoop("across", -A[3, 3], B[3, 1], SLOW, **changes)


# ------------------------------------------------------------------------------------------------------------- closed forms


def test_a_fast_loop_without_dead_time_has_the_roots_of_its_polynomial() -> None:
    """Sampled at 1 ms, x'' + (a + b p) x' + b (p + f) k x = 0 and its integrals, whose roots numpy finds."""
    a, b, g = 4.0, 5.0, replace(NONE, k_p_rho=1.2, k_i_rho=0.3, k_p_u=0.4, k_i_u=0.2, ff_u=0.7)
    loop = CascadeLoop("along", a, b, dead_time=0.0, position_period=1e-3, velocity_period=1e-3)
    position, velocity = np.poly1d([g.k_p_rho, g.k_i_rho]), np.poly1d([g.k_p_u, g.k_i_u])  # over s
    s = np.poly1d([1.0, 0.0])
    whole = s * s * s * (s + a) + b * velocity * s * s + b * (velocity + g.ff_u * s) * position
    expected = np.roots(whole.coeffs)
    eigenvalues = np.linalg.eigvals(loop.matrix(g)).astype(complex)
    found = np.log(eigenvalues[np.abs(eigenvalues) > 1e-6]) / 1e-3  # what is overwritten at every tick leaves zeros
    for root in expected:
        assert np.abs(found - root).min() < 0.02 * abs(root)
    assert loop.growth(g) == pytest.approx(expected.real.max(), rel=0.02)


@pytest.mark.parametrize("dead", [0.1, 0.22, 0.5])
def test_an_integrator_with_dead_time_is_stable_up_to_a_quarter_turn(dead: float) -> None:
    """A speed that obeys at once makes x' = -k x(t - T), stable below k = pi / (2 T); holding costs half a period more."""
    period = 2e-3
    loop = CascadeLoop("along", 2e3, 2e3, dead_time=dead, position_period=period, velocity_period=period)
    low, high = gain_range(loop, replace(NONE, ff_u=1.0), "k_p_rho", 100.0) or (math.nan, math.nan)
    assert low == 0.0
    assert high == pytest.approx(math.pi / (2.0 * (dead + 0.5 * period + 0.5e-3)), rel=5e-3)


def test_a_sampled_speed_loop_is_stable_up_to_jurys_bound() -> None:
    """Without dead time v <- E v - (1 - E) (b/a) p v over a period, E = exp(-a T): stable for p < (1 + E) / (1 - E) a/b."""
    loop = along(dead_time=0.0, position_period=VELOCITY_PERIOD)
    decayed = math.exp(-loop.decay * loop.velocity_period)
    expected = (1.0 + decayed) / (1.0 - decayed) * loop.decay / loop.thrust
    assert gain_range(loop, NONE, "k_p_u", 10.0) == (0.0, pytest.approx(expected, rel=1e-6))


# ------------------------------------------------------------------------------------------------------------ driven loops


CRAWL = 1e-4
"""Speed at which a growing error stays far from all limits [m/s]; the loop along the line does not depend on it."""


def driven(gains: PidGains, start: State, speed: float, duration: float = 40.0, dt: float = 1e-3) -> ClosedRun:
    """The linear model behind the PID on a straight line, told the truth and never pushed."""
    line = Waypoints.from_path(np.column_stack([np.linspace(0.0, speed * duration, 400), np.zeros(400)]), speed)
    law = Controller(gains, tuple(map(tuple, A.tolist())), tuple(map(tuple, B.tolist())))
    quiet = LoopSettings("truth", disturbance=False)
    (run,) = run_loops([Loop(PlanarModel(LinearParameters(), Vehicle(), Drive()), law, quiet)], line, [0], dt, start)
    return run


@pytest.mark.parametrize(("dt", "apart"), [(1e-3, 3e-5), (5e-4, 8e-6)])
def test_errors_of_the_driven_loop_are_the_powers_of_the_matrix(dt: float, apart: float) -> None:
    """The difference of two runs that start a micrometre apart is what the matrix makes of that micrometre.

    The plant takes the position from the mean of two speeds, an error that falls with the square of its step.
    """
    gains, off, loop = PidGains(), 1e-6, along()
    one, other = (driven(gains, State(x=x), CRAWL, 8.0, dt) for x in (0.0, off))
    found = (other.column("x") - one.column("x"))[:: round(0.2 / loop.position_period)] / off
    matrix, now, expected = loop.matrix(gains), np.eye(len(loop.matrix(gains)))[0], []
    for _ in found:
        expected.append(now[0])
        now = matrix @ now
    assert np.abs(found - expected).max() < apart
    assert np.ptp(found) > 1.0


def measured_growth(run: ClosedRun, quiet: ClosedRun, column: str) -> float:
    """Rate at which the difference of two runs grows, between the greatest values of two late stretches."""
    off = np.abs(run.column(column) - quiet.column(column))
    early, late = ((run.t >= a) & (run.t < a + 8.0) for a in (14.0, 30.0))
    return float(np.log(off[late].max() / off[early].max())) / 16.0


@pytest.mark.parametrize(("name", "factor"), [("k_p_rho", 0.9), ("k_p_rho", 1.05), ("k_p_u", 0.9), ("k_p_u", 1.08)])
def test_beyond_its_bound_the_driven_loop_runs_away_along(name: str, factor: float) -> None:
    """As fast as the eigenvalues say; within the bound the error dies away."""
    bound = gain_range(along(), PidGains(), name, 100.0)
    assert bound is not None
    gains = replace(PidGains(), k_i_rho=1.0, **{name: factor * bound[1]})  # the slow integral does not hide the rest
    growth = along().growth(gains)
    found = measured_growth(driven(gains, State(x=1e-9), CRAWL), driven(gains, State(), CRAWL), "x")
    assert (growth > 0.1) == (factor > 1.0)
    assert found == pytest.approx(growth, abs=0.03) if growth > 0.0 else found < -0.05


@pytest.mark.parametrize(("name", "factor"), [("k_p_alpha", 0.9), ("k_p_alpha", 1.05), ("k_p_w", 1.05), ("k_i_y", 1.3)])
def test_beyond_its_bound_the_driven_loop_runs_away_across(name: str, factor: float) -> None:
    """As fast as the eigenvalues say; within the bound the offset dies away."""
    bound = gain_range(across(), PidGains(), name, 100.0)
    assert bound is not None
    gains = replace(PidGains(), k_i_rho=1.0, k_i_alpha=0.0, **{name: factor * bound[1]})
    run = driven(gains, State(y=1e-12), SLOW)
    growth = across(lag=float(run.column("e_rho")[run.t > 14.0].mean())).growth(gains)
    found = measured_growth(run, driven(gains, State(), SLOW), "y")
    assert (growth > 0.05) == (factor > 1.0)
    assert found == pytest.approx(growth, abs=0.03) if growth > 0.05 else found < -0.05
