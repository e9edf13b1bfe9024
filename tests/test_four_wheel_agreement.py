"""MuJoCo and the robot on four tyres, two computations of one robot (docs/four_wheel.md)."""

from __future__ import annotations

import math
import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

page = SimpleNamespace(
    **runpy.run_path(
        str(Path(__file__).resolve().parents[1] / "docs" / "make_four_wheel_figure.py")
    )
)
"""The script that prints the page's numbers."""
SOFT, CAR, STIFF, RIGID = page.STIFFNESSES


@pytest.mark.parametrize(("v", "w"), page.CURVES)
def test_curves_agree_but_for_the_lag_of_mujocos_friction(v: float, w: float) -> None:
    (ahead, aside, turning), _, loads = page.steady("mujoco", v, w)
    (_, rigid, rate), _, others = page.steady(RIGID, v, w)
    assert turning == pytest.approx(rate, rel=2.5e-3)
    assert aside < 1.09 * rigid < 0.0
    assert aside == pytest.approx(rigid - page.LAG * ahead * turning, rel=0.012)
    outwards = np.array([-1.0, 1.0, -1.0, 1.0])
    assert loads @ outwards == pytest.approx(others @ outwards, rel=0.01)
    robot = page.NUMBERS
    wheels = page.steady(RIGID, v, w)[1]
    tipping = (
        robot.mass * robot.com_height * ahead * turning
        + robot.wheel_inertia * 2.0 * wheels.sum() * turning
    )
    assert others @ outwards == pytest.approx(tipping / robot.half_track, rel=0.01)


@pytest.mark.parametrize("share", [0.5, 0.9, 0.98])
def test_starts_agree_but_for_the_slip_of_tyres(share: float) -> None:
    reached, slip, moved = page.thrust("mujoco", share)
    # the contact creeps in proportion to the force
    assert slip == pytest.approx(5.8e-4 * share, abs=5e-5)
    assert reached == pytest.approx(share, rel=1e-3)
    stiff, _, others = page.thrust(RIGID, share)
    assert moved / reached == pytest.approx(others / stiff, rel=1e-3)
    for stiffness in (SOFT, CAR, STIFF):
        less, slipping, _ = page.thrust(stiffness, share)
        # while the tyres roll on
        assert slipping == pytest.approx(page.brush_slip(less, stiffness), rel=0.02)
        assert less < reached


def test_an_arc_of_twenty_seconds_ends_near_the_others_end() -> None:
    one, other, soft = (page.arc(which) for which in ("mujoco", RIGID, SOFT))
    assert np.hypot(*(one.xy - other.xy).T).max() < 0.02
    assert np.abs(one.yaw - other.yaw).max() < math.radians(0.2)
    assert 0.03 < np.hypot(*(one.xy - soft.xy).T).max() < 0.1


def test_loads_of_a_start_a_curve_and_a_stop_agree() -> None:
    one, other = (page.manoeuvre(which) for which in ("mujoco", RIGID))
    quiet = (
        ((one.t > 0.2) & (one.t < 0.5))
        | ((one.t > 3.0) & (one.t < 4.4))
        | ((one.t > 4.8) & (one.t < 5.0))
    )
    loads = one.channels["wheel_load_N"][quiet]
    others = other.channels["wheel_load_N"][quiet]
    moved = np.abs(loads - loads.mean()).max()
    assert np.abs(loads - others).max() < 0.06 * moved
    assert np.abs(others - page.quasi_static(other)[quiet]).max() < 0.02 * moved
