"""MuJoCo and the robot on four tyres, two computations of one robot (docs/four_wheel.md)."""

from __future__ import annotations

import math
import runpy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ssmr.models.four_wheel_plant import FourWheelPlant
from ssmr.robot.sensors import yaw_disturbance
from ssmr.types import Commands, FloatArray, Plant, State
from validation.plants.profile import load_profile, make_plant

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


def test_pushes_differ_by_the_swing_of_the_body_on_its_tyres() -> None:
    """Stiff tyres feel a push as MuJoCo's; soft ones let a robot that stands swing, not turn.

    They are springs of yaw: under constant pushes the yaw is I eps / k, with
    k = C m g (L^2 + B^2) / (4 sigma), and after a step it swings to twice that.
    """
    tile = load_profile("husky-tile")
    mujoco = make_plant(tile, "mujoco")
    soft = make_plant(tile, "four_wheel")
    p = soft.parameters
    stiff = FourWheelPlant(
        replace(p, stiffness_x=1000.0, stiffness_y=1000.0, relaxation=0.05), soft.drive
    )

    def pushes(plant: Plant) -> FloatArray:
        return yaw_disturbance(10.0, plant.dt, np.random.default_rng(0))

    def swing(plant: Any, v: float, w: float) -> tuple[FloatArray, FloatArray]:
        commands = Commands(0.05, np.tile([v, w], (200, 1)))
        calm = plant.run(commands, State(), 0.01)
        pushed = plant.run(commands, State(), 0.01, disturbance=pushes(plant))
        return pushed.yaw - calm.yaw, pushed.twist[:, 2] - calm.twist[:, 2]

    one, other = (swing(plant, 0.25, 0.25)[1].std() for plant in (mujoco, stiff))
    assert 0.5 < other / one < 2.0
    lever = (0.5 * p.wheelbase) ** 2 + p.half_track**2
    spring = p.stiffness_y * p.mass * 9.81 * lever / (p.relaxation * p.wheel_radius)
    still = p.yaw_inertia / spring * np.abs(pushes(soft)).max()
    most = np.abs(swing(soft, 0.0, 0.0)[0]).max()
    # a push may come while the last one still swings
    assert still < most < 3.0 * still
