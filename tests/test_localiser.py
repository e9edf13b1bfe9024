"""A localiser tells of a robot: frames go there and back, and delays are those that were set."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.robot.localiser import Localiser
from ssmr.types import Commands, FloatArray, State, Trajectory
from tests.robots import HUSKY
from validation.plants.kind import PlantProfile
from validation.plants.profile import Profile, make_plant
from validation.plants.searchable import find_number, searchable_numbers

PLACED = Localiser(0.15, -0.04, 0.3, 0.0, 0.0)
numbers = st.floats(-3.0, 3.0)
states = st.builds(State, numbers, numbers, numbers, numbers, numbers, numbers)
localisers = st.builds(Localiser, st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-3.0, 3.0))


def curve(profile: Profile):
    """A drive along a curve, in the body's own frame."""
    commands = Commands(
        0.05, np.column_stack([np.full(80, 0.4), 0.8 * np.sin(0.1 * np.arange(80))])
    )
    return make_plant(profile, "improved").run(commands, State(1.0, 2.0, 0.5), 0.01)


@given(localisers, states)
def test_the_body_is_where_its_tracked_frame_says(localiser: Localiser, state: State) -> None:
    body = localiser.body_state(state)
    seen = localiser.seen_pose([body.x, body.y, body.yaw])
    np.testing.assert_allclose(seen, [state.x, state.y, state.yaw], atol=1e-12)
    np.testing.assert_allclose(localiser.body_pose(seen), [body.x, body.y, body.yaw], atol=1e-12)
    twist = localiser.body_twist([state.v_x, state.v_y, state.yaw_rate])
    np.testing.assert_allclose(twist, [body.v_x, body.v_y, body.yaw_rate], atol=1e-12)


def test_a_twist_is_the_slope_of_the_pose_in_the_tracked_frame(lab: Profile) -> None:
    motion = PLACED.seen(curve(lab))
    slope = np.gradient(motion.pose, motion.t, axis=0)
    c = np.cos(motion.yaw)
    s = np.sin(motion.yaw)
    forward = c * slope[:, 0] + s * slope[:, 1]
    left = c * slope[:, 1] - s * slope[:, 0]
    inner = slice(50, -50)
    np.testing.assert_allclose(motion.twist[inner, 0], forward[inner], atol=5e-3)
    np.testing.assert_allclose(motion.twist[inner, 1], left[inner], atol=5e-3)


def test_position_and_heading_have_delays_of_their_own(lab: Profile) -> None:
    body = curve(lab)
    stamps = 7.0 + body.t
    reported = replace(PLACED, position_late=0.3, yaw_late=-0.1).seen(body, stamps)
    at_once = PLACED.seen(body, stamps)
    np.testing.assert_allclose(reported.xy[60:], at_once.xy[30 : len(reported) - 30], atol=1e-9)
    np.testing.assert_allclose(reported.yaw[:-10], at_once.yaw[10:], atol=1e-9)
    np.testing.assert_array_equal(reported.twist, at_once.twist)


@pytest.mark.parametrize(("position_late", "yaw_late"), [(0.3, 0.1), (-0.25, 0.4), (0.2, -0.1)])
def test_a_log_that_begins_while_the_robot_drives_tells_where_it_was_before(
    position_late: float, yaw_late: float
) -> None:
    """A steady motion looks the same from any instant on, however late it is told."""
    speed = np.array([0.8, -0.3, 0.05])
    t = np.linspace(0.0, 2.0, 81)
    steady = Trajectory(t, t[:, None] * speed, np.zeros((81, 3)), np.zeros((81, 2)))
    localiser = Localiser(position_late=position_late, yaw_late=yaw_late)
    late = np.array([position_late, position_late, yaw_late])
    stamps = 5.0 + t[::3]
    true = (t[::3, None] - late) * speed
    np.testing.assert_allclose(localiser.seen(steady, stamps).pose, true, atol=1e-12)
    np.testing.assert_allclose(localiser.logged_poses(steady.pose, 0.025, stamps), true, atol=1e-12)


def test_every_number_can_be_fitted(lab: Profile) -> None:
    names = {"tracked_x", "tracked_y", "tracked_yaw", "position_late", "yaw_late"}
    for plant in lab.plants:
        assert names <= {number.name for number in searchable_numbers(plant, HUSKY)}
    section: PlantProfile = replace(lab.plants["mujoco"], localiser=Localiser(yaw_late=0.07))
    assert find_number("mujoco", "yaw_late", HUSKY).read(section) == 0.07


@pytest.mark.parametrize("late", [(0.0, 0.0), (0.013, 0.013), (-0.02, 0.051)])
@pytest.mark.parametrize("stamps", [None, 3.0 + np.linspace(0.0, 4.0, 97)])
def test_poses_alone_are_told_as_with_the_rest(
    lab: Profile, late: tuple[float, float], stamps: FloatArray | None
) -> None:
    body = curve(lab)
    for localiser in (Localiser(), Localiser(0.15, -0.04, 0.3, *late), Localiser(tracked_x=-0.1)):
        assert (
            np.abs(
                localiser.logged_poses(body.pose, 0.01, stamps) - localiser.seen(body, stamps).pose
            ).max()
            < 1e-12
        )
    assert stamps is not None or np.array_equal(
        Localiser().logged_poses(body.pose, 0.01), body.pose
    )
