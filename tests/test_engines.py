"""ODE and Drake against closed forms and against MuJoCo.

The laws of all plants are in test_plant_conformance.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from ssmr.robot.ground import turn_on_the_spot
from ssmr.types import Commands, State
from tests.conftest import installed_plant
from validation.engines import ode_library
from validation.engines.body import EngineMissingError, MakeBody
from validation.engines.ode import OdeBody, OdeSettings
from validation.engines.plant import EnginePlant
from validation.plants.profile import Profile, make_plant
from validation.plants.table import SECOND_OPINIONS
from validation.simulator.description import GRAVITY

SPIN = Commands(0.05, np.tile([-4.0, 4.0], (80, 1)), "wheels")
"""Four seconds of wheels that turn against each other at given rates."""


@pytest.fixture
def lab(lab: Profile) -> Profile:
    """The lab's robot with its weight in the middle, as the closed forms want it."""
    section = lab.section("mujoco")
    centred = replace(section, parameters=replace(section.parameters, com_x=0.0))
    return replace(lab, plants={**lab.plants, "mujoco": centred})


def made(profile: Profile, name: str, body: MakeBody, **changes: object) -> EnginePlant:
    installed_plant(profile, name)
    section = profile.section(name)
    calibration = replace(section.parameters, **changes)  # type: ignore[arg-type]
    return EnginePlant(name, body, calibration, section.drive)


def multiplier(plant: EnginePlant) -> tuple[float, float]:
    """Multiplier of a turn on the spot, and the range of the yaw rate over its mean."""
    motion = plant.run(SPIN, State(), 0.01)
    c = plant.calibration
    rate = motion.twist[motion.t > 1.0, 2]
    return c.wheel_radius * 8.0 / (2.0 * c.half_track) / float(rate.mean()), float(
        np.ptp(rate) / rate.mean()
    )


def test_gazebo_s_cone_turns_as_a_cone_does(lab: Profile) -> None:
    """Its bounds split Coulomb's friction by the slip's direction, whatever axes they refer to."""
    settings = OdeSettings("gazebo_cone", "world", "quick", 50)
    measured, ripple = multiplier(made(lab, "ode", partial(OdeBody, settings=settings)))
    expected = turn_on_the_spot(lab.robot.wheelbase, lab.robot.track).multiplier
    assert measured == pytest.approx(expected, rel=1e-2)
    assert ripple < 1e-2


def test_gazebo_s_box_bounds_friction_in_newtons(lab: Profile) -> None:
    """Four contacts push with at most mu newtons each, so the robot gains at most 4 mu t / m."""
    plant = made(
        lab, "ode", partial(OdeBody, settings=OdeSettings("gazebo_box", "world", "quick", 50))
    )
    ahead = Commands(0.05, np.tile([4.0, 4.0], (40, 1)), "wheels")
    speed = float(plant.run(ahead, State(), 0.01).twist[-1, 0])
    assert speed == pytest.approx(
        4.0 * plant.calibration.friction * 2.0 / plant.calibration.mass, rel=1e-2
    )


def test_load_transfer_speeds_the_robot_up_in_a_bend_whatever_the_step(lab: Profile) -> None:
    """The outer wheels carry more and so pull more.

    The robot is faster than its rims by 1.96 mm/s in MuJoCo, 1.57 in Drake. Bounds of friction from
    the normal forces without friction, as dWorldStep has them, give 0.70 at 2 ms and 0.91 at 1 ms.
    """
    bend = Commands(0.05, np.tile([2.0, 4.0], (60, 1)), "wheels")
    plants = [made(lab, "ode", OdeBody, timestep=dt) for dt in (2e-3, 1e-3)]
    rims = 3.0 * plants[0].calibration.wheel_radius
    coarse, fine, mujoco = (
        float(p.run(bend, State(), 0.01).twist[-1, 0]) - rims
        for p in [*plants, make_plant(lab, "mujoco")]
    )
    assert coarse == pytest.approx(fine, rel=0.01)
    assert coarse == pytest.approx(mujoco, rel=0.2)


@pytest.mark.parametrize("name", SECOND_OPINIONS)
def test_loads_at_rest_are_the_weight(name: str, lab: Profile) -> None:
    plant = installed_plant(lab, name)
    motion = plant.run(Commands(0.05, np.zeros((20, 2))), State(), 0.05)
    loads = motion.channels["wheel_load_N"]
    weight = lab.section(name).parameters.mass * GRAVITY
    assert loads.sum(axis=1) == pytest.approx(np.full(len(loads), weight), rel=1e-4)
    assert loads[-1] == pytest.approx(np.full(4, 0.25 * weight), rel=1e-4)


def test_a_missing_engine_is_one_line_that_says_how_to_get_it(
    lab: Profile, monkeypatch: pytest.MonkeyPatch
) -> None:
    ode_library.load_ode.cache_clear()
    monkeypatch.setattr(ode_library, "NAMES", ("libode_that_is_not.so.8",))
    with pytest.raises(EngineMissingError, match=r"ODE is missing: install libode 0\.16") as caught:
        make_plant(lab, "ode")
    assert "\n" not in str(caught.value)
    monkeypatch.setitem(__import__("sys").modules, "pydrake", None)
    monkeypatch.setitem(__import__("sys").modules, "pydrake.geometry", None)
    with pytest.raises(
        EngineMissingError,
        match=r"Drake is missing: install it with pip install 'ssmr-testbed\[engines\]'",
    ):
        make_plant(lab, "drake")
    ode_library.load_ode.cache_clear()


def test_what_an_engine_cannot_have_is_refused(lab: Profile) -> None:
    section = lab.section("ode")
    capsules = replace(section.parameters, wheel_shape="capsule", friction_ratio=1.2)
    with pytest.raises(ValueError, match=r"friction_ratio 1\.2"):
        EnginePlant("ode", OdeBody, capsules, section.drive)
    light = replace(section.parameters, armature=1e-6, gain=1e4)
    with pytest.raises(ValueError, match="too long for a gain of 10000"):
        EnginePlant("ode", OdeBody, light, section.drive)
