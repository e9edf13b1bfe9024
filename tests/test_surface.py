"""Surfaces pass through their heights, are smooth, and are touched by wheels where they should be."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.robot.ground import Surface
from tests.conftest import DERIVATIVE

PERIOD, RADIUS = 4.0, 0.1651
WHEELS = np.array([[0.256, 0.2854, 0.0], [0.256, -0.2854, 0.0], [-0.256, 0.2854, 0.0], [-0.256, -0.2854, 0.0]])
TOUCHING = 2e-4
"""Fixed-point steps to the touching place gain radius times curvature each: 0.1651 x 0.3 cubed, of slopes of 0.1."""


def waves(n: int, amplitude: float = 0.02) -> Surface:
    """One wave along x and two along y over a period of 4 m."""
    x = np.arange(n) * PERIOD / n
    heights = amplitude * np.sin(2 * math.pi * x / PERIOD)[None, :] * np.cos(4 * math.pi * x / PERIOD)[:, None]
    return Surface(heights, PERIOD / n, -1.0)


def exact(xy: np.ndarray, amplitude: float = 0.02) -> np.ndarray:
    x, y = (xy + 1.0).T
    k = 2 * math.pi / PERIOD
    return np.column_stack([
        amplitude * np.sin(k * x) * np.cos(2 * k * y),
        amplitude * k * np.cos(k * x) * np.cos(2 * k * y),
        -2 * amplitude * k * np.sin(k * x) * np.sin(2 * k * y),
    ])  # fmt: skip


def test_it_passes_through_its_heights_and_repeats_itself() -> None:
    s = waves(16)
    i, j = np.meshgrid(np.arange(16), np.arange(16))
    points = np.column_stack([i.ravel(), j.ravel()]) * s.cell - 1.0
    for period in (0.0, PERIOD, -3 * PERIOD):
        np.testing.assert_allclose(s.at(points + period)[:, 0], s.heights.ravel(), atol=1e-15)


def test_height_and_slope_converge_with_the_cell_as_cubic_splines_do() -> None:
    points = np.random.default_rng(0).uniform(-5, 5, (200, 2))
    errors = [np.abs(waves(n).at(points) - exact(points)).max(axis=0) for n in (16, 32, 64)]
    for coarse, fine in pairwise(errors):
        assert coarse[0] / fine[0] > 12.0  # fourth order: 16
        assert min(coarse[1:] / fine[1:]) > 6.5  # third: 8


@given(st.floats(-20, 20), st.floats(-20, 20))
def test_slopes_are_those_of_the_heights(x: float, y: float) -> None:
    s, d = waves(16), 1e-5
    _, gx, gy = s.at([x, y])[0]
    at = s.at([[x + d, y], [x - d, y], [x, y + d], [x, y - d]])[:, 0]
    assert (at[0] - at[1]) / (2 * d) == pytest.approx(gx, abs=DERIVATIVE)
    assert (at[2] - at[3]) / (2 * d) == pytest.approx(gy, abs=DERIVATIVE)


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3.2, 3.2))
def test_a_wheel_stands_where_its_radius_meets_the_ground_at_a_right_angle(x: float, y: float, yaw: float) -> None:
    s = waves(32)
    pose = np.array([[x, y, 0.3, math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]])
    (places,), (turns,) = s.tangent_planes(pose, WHEELS, RADIUS)
    c, d = math.cos(yaw), math.sin(yaw)
    for wheel, place, (w, a, b, g) in zip(WHEELS, places, turns, strict=True):
        centre = np.array([x + c * wheel[0] - d * wheel[1], y + d * wheel[0] + c * wheel[1]])
        normal = np.array([2 * (a * g + w * b), 2 * (b * g - w * a), 1 - 2 * (a * a + b * b)])
        height, gx, gy = s.at(place[:2])[0]
        assert place[2] == pytest.approx(height, abs=1e-15)
        np.testing.assert_allclose(normal, np.array([-gx, -gy, 1.0]) / math.sqrt(1 + gx**2 + gy**2), atol=1e-12)
        np.testing.assert_allclose(place[:2], centre - RADIUS * normal[:2], atol=TOUCHING)
