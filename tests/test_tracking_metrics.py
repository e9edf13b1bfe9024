"""Measures of tracking: distance from path and target, effort, restlessness of commands."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.control.references import circle, eight, line
from ssmr.control.waypoints import Waypoints
from ssmr.metrics.declared import command_measures, cross_track_max
from tests.conftest import ROUNDOFF
from validation.plants.profile import Profile
from validation.track import MORE_DELAY, track


def off(waypoints: Waypoints, xy: np.ndarray, t: np.ndarray, reach: float = 3.0) -> float:
    """Greatest distance of places at times from the path."""
    along = np.concatenate([[0.0], np.cumsum(waypoints.lengths)])
    return cross_track_max(xy, waypoints.xy, along, np.interp(t, waypoints.t, along), reach)


@given(st.floats(-0.5, 0.5), st.floats(-0.3, 0.3))
def test_off_a_line_it_is_the_lateral_distance_whatever_the_lag(left: float, ahead: float) -> None:
    waypoints = line(0.5, 4.0)
    t = np.linspace(1.0, 7.0, 50)
    assert off(
        waypoints, np.column_stack([0.5 * t + ahead, np.full(50, left)]), t
    ) == pytest.approx(abs(left), abs=ROUNDOFF)


def test_off_a_circle_it_is_the_difference_of_radii() -> None:
    waypoints = circle(0.5, 1.5)
    t = np.linspace(0.0, waypoints.duration, 400)
    angle = 0.5 * t / 1.5 - 0.1  # behind its target
    inner = 1.4 * np.column_stack([np.sin(angle), 1.0 / 1.4 * 1.5 - np.cos(angle)])
    sag = 1.5 * (1.0 - math.cos(0.5 * 0.02 / 1.5))  # between the waypoints the path is a chord
    assert off(waypoints, inner[20:], t[20:]) == pytest.approx(0.1, abs=sag + ROUNDOFF)


def test_another_branch_of_the_path_is_no_way() -> None:
    """A robot that waits at the crossing of an eight is on the path, but not at its target."""
    waypoints = eight(0.5)
    t = np.array([0.5 * waypoints.duration / 2.0])
    crossing = np.zeros((1, 2))
    assert off(waypoints, crossing, t, reach=10.0) == pytest.approx(0.0, abs=ROUNDOFF)
    assert off(waypoints, crossing, t, reach=0.5) > 0.9


@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.integers(1, 20))
def test_constant_commands_have_the_effort_of_one_and_no_jerk(v: float, w: float, n: int) -> None:
    effort, jerk = command_measures(np.full((n, 2), (v, w)), 0.05)
    assert effort == pytest.approx(math.hypot(v, w), rel=1e-9, abs=ROUNDOFF)
    assert jerk == 0.0


@given(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(0.01, 0.2))
def test_the_jerk_is_the_second_derivative(bend: float, slope: float, period: float) -> None:
    t = period * np.arange(40)
    _, jerk = command_measures(
        np.column_stack([0.5 * bend * t**2 + slope * t, np.zeros(40)]), period
    )
    assert jerk == pytest.approx(abs(bend), abs=1e-9 / period**2)


def test_the_report_shows_the_robot_itself_and_not_what_it_sees(lab: Profile) -> None:
    """Noise of the feedback is in no error that is drawn, nor in the place where it was worst."""
    tracked = track("pid", circle(0.5), "improved", lab, seed=3)
    run = tracked.robots[0].run
    places = run.columns("x", "y")
    off = np.abs(1.5 - np.hypot(places[:, 0], places[:, 1] - 1.5))
    worst = int(np.argmax(off))
    note = next(note for note in tracked.notes() if "farthest" in note)
    assert f"improved was farthest from its path, {1e3 * off[worst]:.0f} mm, at t = " in note
    assert f"at ({places[worst, 0]:.2f}, {places[worst, 1]:.2f}) m" in note
    axes = [ax for ax in tracked.figure().axes if ax.get_title(loc="left").startswith("e_y")]
    drawn = next(line for line in axes[0].lines if line.get_gid() == "improved")
    yaw = run.column("yaw")
    aim = run.columns("target_x", "target_y") - places
    left = np.cos(yaw) * aim[:, 1] - np.sin(yaw) * aim[:, 0]
    assert np.asarray(drawn.get_ydata()) == pytest.approx(1e3 * left, abs=1e-9)
    assert np.std(run.column("e_y") - left) > 0.001  # the controller sees noise


def test_the_report_says_what_more_delay_would_do() -> None:
    """The sentence holds the path error of a robot that is driven as late as it says."""
    tracked = track("pid", "generic@0.5", plant="improved", seed=2)
    later = track("pid", "generic@0.5", plant="improved", seed=2, late=MORE_DELAY)
    mm = [f"{1e3 * each.metrics['d_rms_m']:.0f}" for each in (later, tracked)]
    assert mm[0] != mm[1]
    wanted = f"With 0.1 s more delay improved would be {mm[0]} mm off its path (d_rms), {mm[1]} mm"
    assert any(note.startswith(wanted) for note in tracked.notes())
    path, loop = tracked.tables()
    assert path.rows[0]["rest_off_m"] == tracked.metrics["rest_off_m"]
    # nothing is learnt without a predictor
    assert "dead_time_learnt_s" not in loop.rows[0]
    learning = track("lqr+predictor", "line", plant="improved")
    learnt = learning.tables()[1].rows[0]["dead_time_learnt_s"]
    assert learnt == learning.metrics["dead_time_learnt_s"]
