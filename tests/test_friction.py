"""Laws that every friction formula must keep, at any load and speed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.models.friction import (
    improved_friction,
    sign_of,
    stop_at_zero_crossing,
)
from ssmr.models.linear import LinearParameters, state_space_matrices
from ssmr.robot.vehicle import Drive, Vehicle
from tests.conftest import DERIVATIVE, ROUNDOFF

speeds = st.floats(-5.0, 5.0, allow_subnormal=False)


@given(active=st.floats(-500, 500), static=st.floats(0.0, 200), share=st.floats(0.0, 1.0), v=speeds)
def test_improved_is_odd_bounded_and_dissipates(
    active: float, static: float, share: float, v: float
) -> None:
    dynamic = share * static
    force = improved_friction(active, static, dynamic, v)
    assert force == -improved_friction(-active, static, dynamic, -v)
    assert abs(force) <= static
    assert force * v <= 0.0  # it is added


@given(active=st.floats(-500, 500), static=st.floats(0.0, 200))
def test_at_rest_it_holds_up_to_stiction_and_beyond_it_slides(active: float, static: float) -> None:
    net = active + improved_friction(active, static, 0.5 * static, 0.0)
    if abs(active) <= static:
        assert net == 0.0
    else:
        assert np.sign(net) == np.sign(active)
        assert abs(net) == pytest.approx(abs(active) - 0.5 * static)


@given(before=speeds, after=speeds)
def test_a_velocity_stops_where_its_sign_changes_and_nowhere_else(
    before: float, after: float
) -> None:
    stopped = stop_at_zero_crossing(after, before)
    assert stopped == (0.0 if np.sign(before) * np.sign(after) < 0 else after)


def arctangent_friction(coefficient: float, load: float, v: float, steepness: float) -> float:
    """Return the friction force [N] of a load [N] at a speed v [m/s], to be SUBTRACTED.

    It tends to Coulomb friction as the `steepness` k_s [s/m] grows, and is 0 at rest (Eq. 2.33,
    2.35).
    """
    return coefficient * load * 2.0 / math.pi * math.atan(steepness * v)


def viscous_coefficient(coefficient: float, steepness: float) -> float:
    """Return K = (2/pi) k_s mu [s/m] (Eq. 2.39, 2.40).

    It is the slope of `arctangent_friction` at rest over the load.
    """
    return 2.0 / math.pi * steepness * coefficient


friction = st.floats(0.01, 2.0)
steepness = st.floats(0.1, 100.0)


@given(mu=friction, load=st.floats(1.0, 1e3), v=st.floats(1e-3, 5.0), k=st.floats(1.0, 1e6))
def test_the_arctangent_is_odd_and_tends_to_coulomb(
    mu: float, load: float, v: float, k: float
) -> None:
    """By arctan(z) = pi/2 - arctan(1/z), a share of at most 2/(pi k_s v) is missing (Eq. 2.34)."""
    force = arctangent_friction(mu, load, v, k)
    assert force == -arctangent_friction(mu, load, -v, k)
    missing = 1.0 - force / (mu * load * sign_of(v))
    assert -ROUNDOFF <= missing <= 2.0 / (math.pi * k * v) + ROUNDOFF


@given(u_x=friction, mu_c=friction, k_sx=steepness, k_sy=steepness)
def test_the_line_of_the_arctangent_is_the_friction_of_the_linear_model(
    u_x: float, mu_c: float, k_sx: float, k_sy: float
) -> None:
    """Eq. 2.33 to 2.46: the wheels' laws, summed and differentiated at rest, give A_22 and A_44.

    As the published coefficients ask for, each wheel carries mg along, and mg/4 across. Across,
    wheels slide with a omega and brake with the lever a, where the printed K_y has one lever, c,
    for both: it is K_y a^2 / c.
    """
    vehicle = Vehicle()
    weight = vehicle.mass * vehicle.gravity
    lever = vehicle.a

    def slowing(v: float) -> float:
        return 4.0 * arctangent_friction(u_x, weight, v, k_sx) / vehicle.mass

    def turning_less(w: float) -> float:
        aside = arctangent_friction(mu_c, 0.25 * weight, lever * w, k_sy)
        return 4.0 * lever * aside / vehicle.yaw_inertia

    k_u = viscous_coefficient(u_x, k_sx)
    k_y = viscous_coefficient(mu_c, k_sy) * lever**2 / vehicle.half_track
    free = LinearParameters(k_u=0.0, k_y=0.0)
    a_free = state_space_matrices(vehicle, free, Drive())[0]
    a_friction = state_space_matrices(vehicle, replace(free, k_u=k_u, k_y=k_y), Drive())[0] - a_free
    step = 1e-5
    slope_v = (slowing(step / k_sx) - slowing(-step / k_sx)) / (2.0 * step / k_sx)
    slope_w = (turning_less(step / k_sy) - turning_less(-step / k_sy)) / (2.0 * step / k_sy)
    assert a_friction[1, 1] == pytest.approx(-slope_v, rel=DERIVATIVE)
    assert a_friction[3, 3] == pytest.approx(-slope_w, rel=DERIVATIVE)
    assert np.count_nonzero(a_friction) == 2
