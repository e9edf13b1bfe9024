"""The sample trajectories: geometry, demands on the robot, agreement of data and page."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.control.references import (
    SPACING,
    circle,
    eight,
    sine,
    spiral,
    square,
    stop_and_go,
    u_turn,
)
from ssmr.control.waypoints import Waypoints
from ssmr.robot.vehicle import Drive
from ssmr.types import FloatArray
from tests.conftest import ROUNDOFF
from tests.test_docs import tables
from validation.experiment.waypoint_files import REFERENCES

PRINTED = 1e-6
"""generic.csv is written to the micrometre: half of that at both ends of a segment, and of the
table's pieces [m]."""


SMOOTH = ("sine", "eight", "slalom", "square", "spiral", "u-turn", "stop-and-go", "long-line")
"""References whose curvature does not jump."""


def curvatures(waypoints: Waypoints) -> FloatArray:
    """Signed, at each waypoint between the ends once, even where the target waits [1/m]."""
    lengths = waypoints.lengths[waypoints.moving]
    headings = waypoints.headings[waypoints.moving]
    return np.diff(headings) / (0.5 * (lengths[1:] + lengths[:-1]))


@pytest.mark.parametrize("speed", [0.25, 0.5])
@pytest.mark.parametrize("name", REFERENCES)
def test_references_are_dense_smooth_and_as_fast_as_asked(name: str, speed: float) -> None:
    waypoints = REFERENCES[name](speed)
    steps = waypoints.lengths[waypoints.moving]
    assert np.max(steps) <= SPACING + PRINTED
    assert np.min(steps) > 0.5 * SPACING
    assert np.max(np.abs(np.diff(waypoints.headings)), initial=0.0) < math.radians(5.0)  # no kink
    assert waypoints.speed == pytest.approx(speed, rel=ROUNDOFF)
    assert np.array_equal(waypoints.xy[0], np.zeros(2))


@pytest.mark.parametrize("name", SMOOTH)
def test_curvature_is_continuous(name: str) -> None:
    """From waypoint to waypoint it changes by the slope of the curvature times a step.

    The slope is 15 1/m2 in a slalom's crests.
    """
    assert np.max(np.abs(np.diff(curvatures(REFERENCES[name](0.25)))), initial=0.0) < 15.0 * SPACING


@pytest.mark.parametrize(("name", "turns"), [("circle", 1.0), ("eight", 0.0), ("square", 1.0)])
def test_closed_references_end_where_they_begin_and_as_they_begin(name: str, turns: float) -> None:
    waypoints = REFERENCES[name](0.25)
    assert np.allclose(waypoints.xy[-1], waypoints.xy[0], atol=ROUNDOFF)
    turned = waypoints.headings[-1] - waypoints.headings[0]
    # the first and the last chord are a step apart
    one_step = np.max(np.abs(np.diff(waypoints.headings)))
    assert abs(turned - 2.0 * math.pi * turns) <= one_step + ROUNDOFF


@given(st.floats(0.5, 10.0))
def test_an_eight_is_the_lemniscate(half_width: float) -> None:
    """(x^2 + y^2)^2 = a^2 (x^2 - y^2), of length 5.244 a, and its curvature is 3 r / a^2."""
    waypoints = eight(0.25, half_width)
    x, y = waypoints.xy.T
    assert np.allclose((x**2 + y**2) ** 2, half_width**2 * (x**2 - y**2), rtol=1e-9, atol=1e-9)
    # the greatest share by which a chord is shorter than its arc
    short = (SPACING * 3.0 / half_width) ** 2 / 24.0
    assert (1.0 - short) * 5.244115 < waypoints.length / half_width < 5.244116
    expected = 3.0 * np.hypot(x, y)[1:-1] / half_width**2
    assert np.allclose(np.abs(curvatures(waypoints)), expected, atol=4e-3 * 3.0 / half_width)


@given(st.floats(2.0, 6.0), st.floats(2.0, 10.0))
def test_a_square_touches_its_sides_and_closes(side: float, curvature: float) -> None:
    waypoints = square(0.25, side, curvature)
    low = waypoints.xy.min(axis=0)
    high = waypoints.xy.max(axis=0)
    assert np.allclose((*low, *high), (-0.5 * side, 0.0, 0.5 * side, side), atol=1e-9)
    assert np.allclose(waypoints.xy[-1], 0.0, atol=1e-9)
    assert np.max(curvatures(waypoints)) <= curvature * (1.0 + 1e-9)


@given(st.floats(1.0, 20.0), st.floats(0.5, 3.0))
def test_the_curvature_of_a_spiral_grows_evenly(length: float, curvature: float) -> None:
    waypoints = spiral(0.25, length, curvature)
    at = np.arange(1, len(waypoints) - 1) / (len(waypoints) - 1)
    assert np.allclose(curvatures(waypoints), curvature * at, atol=1e-3 * curvature)
    assert waypoints.length == pytest.approx(length, rel=2e-4)


@given(st.floats(0.4, 3.0), st.floats(0.1, 5.0))
def test_a_u_turn_comes_back_at_its_width(width: float, straight: float) -> None:
    waypoints = u_turn(0.25, width, straight)
    assert np.allclose(waypoints.xy[-1], (0.0, width), atol=1e-9)
    assert waypoints.headings[-1] == pytest.approx(math.pi, abs=1e-9)
    assert waypoints.xy[:, 1].max() <= width + 1e-9


@given(st.floats(0.1, 2.0), st.floats(0.2, 3.0), st.floats(0.1, 5.0), st.integers(1, 6))
def test_stop_and_go_drives_at_its_speed_and_waits(
    speed: float, leg: float, wait: float, legs: int
) -> None:
    waypoints = stop_and_go(speed, leg, wait, legs)
    assert waypoints.duration == pytest.approx(legs * (leg / speed + wait), rel=1e-9)
    assert waypoints.speed == pytest.approx(speed, rel=1e-9)
    stops = waypoints.xy[:-1][~waypoints.moving]
    assert np.allclose(stops, [((k + 1) * leg, 0.0) for k in range(legs)], atol=1e-9)
    assert not np.any(waypoints.headings)


@given(st.floats(0.2, 5.0), st.floats(0.1, 3.0))
def test_a_circle_is_as_long_and_as_far_as_its_radius_says(radius: float, turns: float) -> None:
    """The chords of steps h are shorter than the arc by the share h^2 / 24 r^2."""
    waypoints = circle(0.25, radius, turns)
    short = (SPACING / radius) ** 2 / 24.0
    assert waypoints.length <= 2.0 * math.pi * radius * turns * (1.0 + ROUNDOFF)
    assert waypoints.length >= 2.0 * math.pi * radius * turns * (1.0 - short)
    assert np.allclose(np.hypot(*(waypoints.xy - (0.0, radius)).T), radius, rtol=ROUNDOFF)
    assert np.all(curvatures(waypoints) > 0.0)


@given(st.floats(0.05, 1.0), st.floats(1.0, 6.0), st.floats(0.5, 3.0))
def test_a_sine_is_one_with_steps_of_one_length(
    amplitude: float, wavelength: float, periods: float
) -> None:
    waypoints = sine(0.25, amplitude, wavelength, periods)
    x, y = waypoints.xy.T
    k = 2.0 * math.pi / wavelength
    assert np.allclose(y, amplitude * np.sin(k * x), atol=ROUNDOFF)
    assert x[-1] == pytest.approx(periods * wavelength, rel=ROUNDOFF)
    steps = waypoints.lengths
    tightest = amplitude * k * k
    assert np.max(steps) - np.min(steps) < SPACING * ((SPACING * tightest) ** 2 / 24.0 + 1e-4)
    assert np.max(np.abs(curvatures(waypoints))) <= tightest * (1.0 + 1e-3)


# --------------------------------------------------------------------------------------------------
# generic


def test_generic_saturates_at_half_a_metre_a_second_and_not_at_a_quarter() -> None:
    """Its corners ask for 1.4 to 2 rad/s, the driver gives 2.

    Nothing is left to correct with. Half of that is easy.
    """
    w_max = Drive().w_max
    for speed, low, high in ((0.5, 0.9, 1.0), (0.25, 0.45, 0.5)):
        rates = np.abs(REFERENCES["generic"](speed).course()["w"])
        assert low * w_max < np.max(rates) < high * w_max


def drawn(pieces: list[list[str]]) -> FloatArray:
    """Corners of the pieces of docs/tracking.md.

    Each is begun where the one before ended, in complex numbers.
    """
    z = 0j
    direction = 1 + 0j
    corners = [0j]
    for kind, size, angle in pieces:
        turn = 0.0 if kind == "straight" else math.radians(float(angle))
        length = float(size) * (abs(turn) or 1.0)
        n = math.ceil(length / SPACING - 1e-9)
        for i in range(1, n + 1):
            half = 0.5 * turn * i / n
            chord = length * i / n * (math.sin(half) / half if half else 1.0)
            corners.append(z + direction * chord * complex(math.cos(half), math.sin(half)))
        z = corners[-1]
        direction = direction * complex(math.cos(turn), math.sin(turn))
    return np.column_stack([np.real(corners), np.imag(corners)])


def test_generic_is_what_its_page_says() -> None:
    expected = drawn(tables("tracking.md")["Pieces"])
    waypoints = REFERENCES["generic"](0.25)
    assert waypoints.xy.shape == expected.shape
    assert np.max(np.abs(waypoints.xy - expected)) <= 0.5 * PRINTED + ROUNDOFF


def test_the_page_lists_what_each_reference_asks_for() -> None:
    rows = tables("tracking.md")["Reference trajectories"]
    assert [row[0] for row in rows] == list(REFERENCES)
    for name, _, *written in rows:
        waypoints = REFERENCES[name](0.25)
        tightest = np.max(np.abs(curvatures(waypoints)))
        for text, value in zip(
            written, (waypoints.length, tightest, 0.25 * tightest, 0.5 * tightest), strict=True
        ):
            digits = len(text.partition(".")[2])
            assert abs(float(text) - value) <= 0.55 * 10.0**-digits, (name, text, value)
