"""Laws that every friction formula must keep, at any load and speed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.models.friction import improved_friction, stop_at_zero_crossing

speeds = st.floats(-5.0, 5.0, allow_subnormal=False)


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
