"""The closed forms of a turn on the spot: limits, symmetries, polygons against circles."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ssmr.robot.ground import turn_on_the_spot
from tests.polygons import polygonal_turn
from tests.robots import TRACK, WHEELBASE

MINIMUM = 1e-6
"""Relative: where a smooth power is least, its gradient vanishes to 1e-10."""


@pytest.mark.parametrize("track", [0.4, 0.55, 0.8])
def test_another_track_has_the_closed_form(track: float) -> None:
    assert turn_on_the_spot(WHEELBASE, track).multiplier == pytest.approx(
        1.0 + (WHEELBASE / track) ** 2, rel=MINIMUM
    )


def test_a_line_of_no_width_is_a_point_and_width_costs() -> None:
    point, narrow, wide = (
        turn_on_the_spot(WHEELBASE, TRACK, half_width=w).multiplier for w in (0.0, 1e-9, 0.05715)
    )
    assert narrow == pytest.approx(point, rel=MINIMUM)
    assert wide == pytest.approx(1.8480, abs=5e-5)  # docs/physics.md


def test_mirroring_the_centre_mirrors_the_turn() -> None:
    one = turn_on_the_spot(WHEELBASE, TRACK, -0.03, 0.05)
    other = turn_on_the_spot(WHEELBASE, TRACK, -0.03, -0.05)
    assert one.multiplier == pytest.approx(other.multiplier, rel=MINIMUM)
    assert one.across == pytest.approx(other.across, rel=1e-4)
    assert one.forward == pytest.approx(-other.forward, rel=1e-4)
    assert other.forward > 0.0  # heavier on the right, it turns about a place to the left


@pytest.mark.parametrize("heading", [0.0, 0.3, 0.5 * math.pi, 4.0])
def test_a_polygon_is_the_same_after_a_quarter_turn_and_a_square_is_a_turned_diamond(
    heading: float,
) -> None:
    turns = (
        ("diamond", heading),
        ("diamond", heading + 0.5 * math.pi),
        ("square", heading + 0.25 * math.pi),
    )
    rates = [polygonal_turn(limit, at, WHEELBASE, TRACK).yaw_rate for limit, at in turns]
    assert rates == pytest.approx([rates[0]] * 3, rel=1e-9)


def test_a_square_along_the_worlds_axes_turns_by_1_00_to_1_90_and_1_396_in_the_mean() -> None:
    headings = np.radians(np.arange(0.25, 90.0, 0.5))
    measured = np.array(
        [polygonal_turn("square", h, WHEELBASE, TRACK).multiplier for h in headings]
    )
    assert (measured.min(), measured.max()) == pytest.approx((1.00, 1.90), abs=0.015)
    assert measured.mean() == pytest.approx(1.396, abs=1e-3)
