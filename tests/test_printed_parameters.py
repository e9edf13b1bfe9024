"""What the printed numbers of the thesis do in MuJoCo, with nothing fitted.

Docs/lab.md tells the story.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ssmr.metrics.declared import compare_paths
from ssmr.scenarios import TRAJECTORIES
from ssmr.simulation import SAMPLE_DT
from ssmr.types import Commands, State, Trajectory
from validation.plants.profile import Profile, load_profile, make_plant
from validation.replicate import published
from validation.simulator.health import check_health
from validation.simulator.plant import MujocoPlant

GRAVITY = 9.81
AXLE = 0.256
"""Distance of an axle from the middle [m]."""
YAW = 0.01
"""How far the final yaws of the two plants may lie apart [rad]: 1 % of the largest."""
PATH = {"traj1": 0.10, "traj2": 0.02, "traj3": 0.04, "traj4": 0.10}
"""Least d_rms between the two paths that counts as another path [m]; two to nine times 0.0145 m, by
which the published model missed the real robot on trajectory 4 (Tab. 3.12)."""


@cache
def printed() -> Profile:
    return load_profile("thesis-printed")


@cache
def driven(scenario: str, plant: str) -> Trajectory:
    return make_plant(printed(), plant).run(TRAJECTORIES[scenario].commands(), State(), SAMPLE_DT)


def twist(v: float, w: float, seconds: float) -> Commands:
    return Commands(0.05, np.tile([v, w], (round(seconds / 0.05), 1)))


def test_the_profile_has_the_printed_numbers() -> None:
    section = printed().plants["mujoco"]
    numbers = section.parameters
    assert numbers.friction * numbers.friction_ratio == pytest.approx(
        published.printed_value("3.11", "mu_d")
    )
    assert numbers.rolling_resistance == published.printed_value("3.11", "u_x")
    assert numbers.gain == published.printed_value("3.11", "K_P_tau")
    assert numbers.mass == published.printed_value("3.1", "mass")
    assert 2.0 * numbers.half_track == published.printed_value("3.1", "track_width")
    assert section.drive.torque_limit == published.printed_value("3.8", "tau_max_wheel_N_m")
    assert section.drive.command_half_track == numbers.half_track
    assert section.localiser.point == (0.0, 0.0)
    assert printed().plants["improved"] == load_profile("thesis-lab").plants["improved"]


@pytest.mark.parametrize("scenario", list(PATH))
def test_it_turns_as_the_improved_model_but_drives_elsewhere(scenario: str) -> None:
    model = driven(scenario, "improved")
    robot = driven(scenario, "mujoco")
    assert check_health(robot.channels["wheel_load_N"])["ok"]
    assert abs(robot.yaw[-1] - model.yaw[-1]) < YAW
    assert abs(model.yaw[-1]) > 5.0 * YAW
    assert compare_paths(model, robot)["d_rms_m"] > PATH[scenario]
    assert np.abs(model.twist[:, 1]).max() == 0.0


@pytest.mark.parametrize("scenario", list(PATH))
def test_it_slides_out_of_its_curves(scenario: str) -> None:
    """The robot moves outward as fast as its axles swing, while friction holds it.

    It does where A hypot(v, 2 pi f a) < mu_d g.
    """
    robot = driven(scenario, "mujoco")
    motion = TRAJECTORIES[scenario]
    late = robot.t > 4.0
    across = robot.twist[late, 1]
    rate = robot.twist[late, 2]
    assert np.mean(across * rate) < -0.2 * AXLE * np.mean(rate**2)
    swing = AXLE * np.abs(rate).max()
    commanded = motion.amplitude * math.hypot(motion.speed, 2.0 * math.pi * motion.frequency * AXLE)
    assert (commanded < 0.0409 * GRAVITY) == (scenario in ("traj2", "traj3"))
    if commanded < 0.0409 * GRAVITY:
        assert np.abs(across).max() == pytest.approx(swing, rel=0.05)
    else:
        assert np.abs(across).max() > 0.7 * swing


@pytest.mark.parametrize("rate", [0.25, 0.5])
def test_sideways_friction_holds_a_curve_only_with_the_centre_of_rotation_at_an_axle(
    rate: float,
) -> None:
    """The axles' frictions cancel while the centre of rotation lies between them.

    No force acts towards the curve's centre.
    """
    robot = make_plant(printed(), "mujoco").run(twist(0.5, rate, 12.0), State(), 0.01)
    tail = robot.t > 8.0
    assert 0.5 * rate < 0.0409 * GRAVITY
    assert np.ptp(robot.twist[tail, 1]) < 1e-3  # steady
    assert -robot.twist[-1, 1] / robot.twist[-1, 2] == pytest.approx(AXLE, rel=0.05)


def test_a_curve_that_needs_more_than_mu_d_g_is_not_held_at_all() -> None:
    """The whole friction, m mu_d g, acts towards the centre.

    What v omega needs beyond that makes the robot slide faster.
    """
    robot = make_plant(printed(), "mujoco").run(twist(0.5, 1.0, 12.0), State(), 0.01)
    tail = robot.t > 6.0
    across = robot.twist[tail, 1]
    needed = robot.twist[tail, 0] * robot.twist[tail, 2]
    gained = (across[-1] - across[0]) / (robot.t[tail][-1] - robot.t[tail][0])
    assert needed.min() > 0.0409 * GRAVITY
    assert gained < -0.05
    assert gained + needed.mean() == pytest.approx(0.0409 * GRAVITY, rel=0.02)


def test_the_printed_torque_turns_tyres_of_equal_friction_only_below_0_158() -> None:
    """Rolling resistance and turning take their parts of a side's 14 N m.

    They are u_x (m g / 2) r and r mu (m g / 2) L / hypot(L, B).
    """
    section = printed().plants["mujoco"]
    numbers = section.parameters
    side = 2.0 * section.drive.torque_limit
    lever = numbers.wheel_radius * 0.5 * numbers.mass * GRAVITY
    limit = (
        (side / lever - numbers.rolling_resistance)
        * math.hypot(2 * AXLE, 2 * numbers.half_track)
        / (2 * AXLE)
    )
    assert limit == pytest.approx(0.158, abs=5e-4)
    for friction, turns in ((0.98 * limit, True), (1.02 * limit, False)):
        equal = replace(numbers, friction=friction, friction_ratio=1.0, wheel_shape="ellipsoid")
        motion = MujocoPlant(equal, section.drive).run(twist(0.0, 0.6, 6.0), State(), 0.05)
        assert (motion.twist[-1, 2] > 0.1) == turns
