"""Laws that every friction formula must keep, at any load and speed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from ssmr.models.friction import (
    arctangent_friction,
    coulomb_friction,
    hyperviscous_friction,
    improved_friction,
    stop_at_zero_crossing,
)
from tests.conftest import ROUNDOFF

loads = st.floats(0.0, 1e3, allow_subnormal=False)  # relative bounds mean nothing where a force has lost its digits
coefficients = st.floats(0.0, 2.0, allow_subnormal=False)
speeds = st.floats(-5.0, 5.0, allow_subnormal=False)
steepnesses = st.floats(0.01, 1e4)
TINY = 1e-290
"""Products of smaller numbers lose their digits."""


@given(mu=coefficients, load=loads, v=speeds)
def test_coulomb_is_odd_bounded_and_dissipates(mu: float, load: float, v: float) -> None:
    force = coulomb_friction(mu, load, v)
    assert force == -coulomb_friction(mu, load, -v)
    assert abs(force) <= mu * load
    assert force * v >= 0.0  # it is subtracted


@given(active=st.floats(-500, 500), static=st.floats(0.0, 200), share=st.floats(0.0, 1.0), v=speeds)
def test_improved_is_odd_bounded_and_dissipates(active: float, static: float, share: float, v: float) -> None:
    dynamic = share * static
    force = improved_friction(active, static, dynamic, v)
    assert force == -improved_friction(-active, static, dynamic, -v)
    assert abs(force) <= static
    assert force * v <= 0.0  # it is added


@given(active=st.floats(-500, 500), static=st.floats(0.0, 200))
def test_at_rest_it_holds_up_to_stiction_and_resists_with_it_beyond(active: float, static: float) -> None:
    net = active + improved_friction(active, static, 0.5 * static, 0.0)
    if abs(active) <= static:
        assert net == 0.0
    else:
        assert np.sign(net) == np.sign(active)
        assert abs(net) == pytest.approx(abs(active) - static)


@given(before=speeds, after=speeds)
def test_a_velocity_stops_where_its_sign_changes_and_nowhere_else(before: float, after: float) -> None:
    stopped = stop_at_zero_crossing(after, before)
    assert stopped == (0.0 if np.sign(before) * np.sign(after) < 0 else after)


@given(mu=coefficients, load=loads, v=speeds, k=steepnesses)
def test_the_arctangent_is_odd_never_drives_and_stays_below_coulomb(mu: float, load: float, v: float, k: float) -> None:
    assume(mu * load * v == 0.0 or abs(mu * load * v) > TINY)
    force = arctangent_friction(mu, load, v, k)
    assert force == -arctangent_friction(mu, load, -v, k)
    assert force * v >= 0.0  # it is subtracted
    assert abs(force) <= abs(coulomb_friction(mu, load, v)) * (1.0 + ROUNDOFF)


@given(mu=coefficients, load=loads, v=st.floats(1e-3, 5.0), k=st.floats(1.0, 1e6))
def test_the_arctangent_tends_to_coulomb_as_the_steepness_grows(mu: float, load: float, v: float, k: float) -> None:
    """Eq. 2.34, with the rate: arctan(z) = pi/2 - arctan(1/z), so mu N 2/(pi k_s v) is missing, less for small k_s v."""
    assume(mu * load == 0.0 or mu * load > TINY)
    missing = coulomb_friction(mu, load, v) - arctangent_friction(mu, load, v, k)
    most = mu * load * 2.0 / (math.pi * k * v)
    assert -ROUNDOFF * mu * load <= missing <= most + ROUNDOFF * mu * load
    if k * v > 100.0:
        assert missing == pytest.approx(most, rel=1e-4, abs=1e-9 * mu * load)  # next term: 1/(3 z^2), 3e-5 of it
    assert arctangent_friction(mu, load, math.inf, k) == pytest.approx(mu * load, rel=ROUNDOFF)


@given(mu=st.floats(0.01, 2.0), load=st.floats(1.0, 1e3), share=st.floats(-1.0, 1.0, allow_subnormal=False), k=steepnesses)
def test_the_line_is_right_about_rest_and_too_great_beyond(mu: float, load: float, share: float, k: float) -> None:
    """For small z = k_s v the arctangent is z - z^3/3 + ..., so the line is too great by z^2/3 of itself at most."""
    v = share / k
    assume(v == 0.0 or abs(v) > TINY)
    line, law = hyperviscous_friction(mu, load, v, k), arctangent_friction(mu, load, v, k)
    assert line == -hyperviscous_friction(mu, load, -v, k)
    assert abs(law) <= abs(line) * (1.0 + ROUNDOFF)
    assert abs(line - law) <= (share**2 / 3.0 + ROUNDOFF) * abs(line)
    crossing = math.pi / 2.0 / k  # the speed at which the line passes Coulomb friction
    assert hyperviscous_friction(mu, load, crossing, k) == pytest.approx(mu * load, rel=ROUNDOFF)
