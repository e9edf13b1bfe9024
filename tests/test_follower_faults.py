"""One seeded set of faults in simulated time: what a follower names, how soon, and how far it went.

Each fault begins 4 s after the start of a circle at 0.4 m/s, on a MuJoCo robot whose messages come
at 5, 10 and 50 Hz. `python -m tests.test_follower_faults` prints the table of docs/ros.md.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from ssmr.control.law import Observation
from ssmr.control.references import circle
from ssmr.control.waypoints import Waypoints
from ssmr.types import State
from tests.ros_drive import Driven, Faults, drive_with_faults
from validation.experiment.loops import chosen_controller, make_robot, slowed_to_feasible
from validation.experiment.waypoint_files import open_reference
from validation.plants.profile import load_profile
from validation.ros.watch import Supervisor

SPEED = 0.4
RATES = (50.0, 10.0, 5.0)
SIDES = ("wheel_left", "wheel_right")


def moved_pose(
    side: float = 0.0, turned: float = 0.0
) -> Callable[[float, Observation], Observation]:
    """Return a fault by which the pose jumps to the side [m] and turns [rad]."""

    def jump(t: float, seen: Observation) -> Observation:
        return seen._replace(y=seen.y + side, yaw=seen.yaw + turned) if t >= 0.0 else seen

    return jump


def a_second_sender() -> Callable[[float, Observation], Observation]:
    """Return a fault by which every second message is of a node that has the robot elsewhere."""
    turns = itertools.cycle([0.0, 0.7])

    def send(t: float, seen: Observation) -> Observation:
        return seen._replace(x=seen.x + next(turns)) if t >= 0.0 else seen

    return send


def wrong_encoder(side: int, share: float) -> Callable[[float, State], State]:
    """Return a fault by which a side's encoder reports a share of its rate."""

    def report(t: float, state: State) -> State:
        rate = getattr(state, SIDES[side])
        return replace(state, **{SIDES[side]: share * rate}) if t >= 0.0 else state

    return report


def standing(t: float, seen: Observation) -> Observation:
    """Return odometry that says that the robot stands."""
    return seen._replace(v=0.0, w=0.0) if t >= 0.0 else seen


FAULTS: dict[str, tuple[dict[str, Any], str]] = {
    "odometry repeats its last pose and speeds, with fresh stamps": (
        {"frozen": lambda t: t >= 0.0},
        "the pose jumped, or stayed behind",
    ),
    "odometry says that the robot stands": (
        {"seen": standing, "frozen": lambda t: t > 0.01},
        "no motion is seen where it is told to move",
    ),
    "somebody else drives (a joystick)": (
        {"other": lambda t: (0.3, 0.8) if t >= 0.0 else None},
        "does somebody else drive it?",
    ),
    "the heading jumps by 0.5 rad": (
        {"seen": moved_pose(turned=0.5)},
        "the heading jumped",
    ),
    "the pose jumps by 0.30 m to the side": (
        {"seen": moved_pose(side=0.3)},
        "the pose jumped",
    ),
    "a second node sends odometry that is 0.7 m off, in turn": (
        {"seen": a_second_sender()},
        "the pose jumped",
    ),
    "the left encoder is dead": (
        {"wheels": wrong_encoder(0, 0.0), "by_filter": True},
        "the encoder of the left wheels",
    ),
    "the right encoder reports 80 %": (
        {"wheels": wrong_encoder(1, 0.8), "by_filter": True},
        "the encoder of the right wheels",
    ),
    "the left motor has 2 N m left": (
        {"weak": (0, 2.0)},
        "the left side does not turn as commanded",
    ),
    "the odometry ends": ({"silent": lambda t: t >= 0.0}, "no feedback for"),
    "the odometry is not finite": (
        {"seen": lambda t, seen: seen._replace(x=np.nan) if t >= 0.0 else seen},
        "no feedback that can be used",
    ),
}


@cache
def robot_of(profile: str) -> Any:
    return make_robot(load_profile(profile), "mujoco")


def drive(
    profile: str = "thesis-lab", law: str = "mpc", turns: float = 1.0, **faults: Any
) -> Driven:
    robot = robot_of(profile)
    controller, _ = chosen_controller(law, load_profile(profile))
    way = circle(SPEED, turns=turns)
    settings = {key: faults.pop(key) for key in ("auto_restart",) if key in faults}
    return drive_with_faults(
        robot.body, controller.on(robot.drive), way, Faults(**faults), **settings
    )


@pytest.mark.parametrize(
    ("fault", "hertz"),
    [
        # each fault has one rate, and in the slow tests all
        pytest.param(fault, hertz, marks=[pytest.mark.slow] * ((i + k) % len(RATES) > 0))
        for i, fault in enumerate(FAULTS)
        for k, hertz in enumerate(RATES)
    ],
)
def test_a_fault_is_named_within_a_second_or_five_messages_and_the_robot_is_stopped(
    fault: str, hertz: float
) -> None:
    """Then it goes no farther than it does by braking.

    That is a dead time, and 1 m/s2 on a motor that is not weak.
    """
    faults, cause = FAULTS[fault]
    done = drive(hertz=hertz, **faults)
    assert cause in done.named
    assert done.took <= max(1.0, 5.0 / hertz) + 0.06  # and the period of the commands
    assert done.way_after <= 1.2 * SPEED * (done.took + 0.3) + 0.2
    assert np.all(done.table(done.took + 0.06)[:, 5:] == 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("hertz", RATES)
@pytest.mark.parametrize("fault", [fault for fault in FAULTS if "80 %" not in fault])
def test_they_are_named_on_another_robot_too(fault: str, hertz: float) -> None:
    faults, _ = FAULTS[fault]
    done = drive("husky-tile", hertz=hertz, **faults)
    assert done.named
    assert done.took <= max(1.0, 5.0 / hertz) + 0.06


@pytest.mark.parametrize("hertz", RATES)
@pytest.mark.parametrize("twist", [(0.3, 0.8), (0.3, -0.3), (0.0, 0.5)])
def test_another_driver_is_named_by_odometry_alone_on_a_robot_that_answers_weakly(
    twist: tuple[float, float], hertz: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On tile the robot has 0.9 of its model's yaw rate, and somebody drives nearly as it should.

    There are neither wheels nor a gyro, and messages are noisy.
    """
    monkeypatch.setattr(Supervisor, "take_wheels", lambda *message: None)
    rng = np.random.default_rng(3)
    done = drive(
        "husky-tile",
        hertz=hertz,
        other=lambda t: twist if t >= 0.0 else None,
        seen=lambda t, seen: Observation(*(seen + rng.normal(0.0, [0.005] * 3 + [0.01] * 2))),
    )
    assert "does somebody else drive it?" in done.named
    assert 0.0 <= done.took <= max(1.0, 5.0 / hertz) + 0.06


@pytest.mark.parametrize("gains", [(0.87, 0.7), (1.0, 0.6)])
def test_a_robot_whose_model_is_wrong_is_no_other_driver(
    gains: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It has these shares of the model's speed and yaw rate, and learns them as it starts."""
    monkeypatch.setattr(Supervisor, "take_wheels", lambda *message: None)
    robot = robot_of("thesis-lab")
    law, _ = chosen_controller("mpc", load_profile("thesis-lab"))
    b = np.array(law.b)
    b[[1, 3], [0, 1]] /= gains
    wrong = replace(law.on(robot.drive), b=tuple(map(tuple, b.tolist())))
    done = drive_with_faults(robot.body, wrong, circle(SPEED))
    assert not done.named
    assert done.off().max() <= 0.02


@pytest.mark.parametrize("hertz", RATES)
def test_a_released_emergency_stop_starts_nothing(hertz: float) -> None:
    done = drive(
        hertz=hertz, stopped=lambda t: 0.0 <= t < 3.0, confirmed=lambda t: False, most=12.0
    )
    assert np.all(done.table(0.0)[:, 5:] == 0.0)
    assert abs(done.rows[-1][3]) < 0.01
    assert "confirm" in done.follower.held


@pytest.mark.parametrize("confirmed", [True, False])
def test_a_stop_that_was_released_goes_on_by_a_confirmation_or_by_itself_where_it_may(
    confirmed: bool,
) -> None:
    done = drive(
        turns=0.5,
        stopped=lambda t: 0.0 <= t < 3.0,
        confirmed=lambda t: confirmed and t > 5.0,
        auto_restart=not confirmed,
    )
    assert not done.stopped
    stood = 5.0 if confirmed else 3.0
    assert np.all(done.table(0.0)[: round(100 * stood), 5:] == 0.0)
    assert done.off().max() <= 0.03
    assert done.rest_off <= 0.03


def sound_drives(seed: int, seconds: float) -> list[str]:
    """Drive robots without a fault for a time; return what was taken for one.

    Messages are late by up to 0.3 s, overtake each other, and up to a tenth of them is lost.
    """
    rng = np.random.default_rng(seed)
    driven = 0.0
    alarms = []
    while driven < seconds:
        profile = str(rng.choice(["thesis-lab", "husky-tile"]))
        law = str(rng.choice(["mpc", "lqr-scheduled+predictor"]))
        name, speed = [("circle", 0.4), ("eight", 0.35), ("slalom", 0.4), ("line", 0.5)][
            rng.integers(4)
        ]
        late = float(rng.choice([0.0, 0.1, 0.3]))
        lost = float(rng.choice([0.0, 0.05, 0.1]))
        hertz = float(rng.choice(RATES))
        faults = Faults(
            hertz=hertz,
            begin=-100.0,
            by_filter=bool(rng.integers(2)),
            late=lambda t, late=late: float(rng.uniform(0.005, 0.005 + late)),
            silent=lambda t, lost=lost: bool(rng.random() < lost),
        )
        robot = robot_of(profile)
        controller, _ = chosen_controller(law, load_profile(profile))
        way: Waypoints = slowed_to_feasible(open_reference(name, speed)[1], robot)
        done = drive_with_faults(robot.body, controller.on(robot.drive), way, faults, w_limit=2.0)
        driven += done.rows[-1][0]
        if done.named:
            alarms.append(f"{profile} {law} {name} {hertz:g} Hz {late:g} s {lost:g}: {done.named}")
    return alarms


def test_sound_drives_with_late_lost_and_swapped_messages_go_on() -> None:
    assert sound_drives(1, 40.0) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 14))
def test_an_hour_of_sound_drives_has_no_false_alarm(seed: int) -> None:
    """Each is a twelfth of it."""
    assert sound_drives(seed, 300.0) == []


def main() -> None:
    """Print the table of docs/ros.md."""
    print("| what is wrong | what the robot is stopped for | 50 Hz | 10 Hz | 5 Hz |")
    print("|---|---|---:|---:|---:|")
    for fault, (faults, _) in FAULTS.items():
        cells = []
        named = ""
        for hertz in RATES:
            done = drive(hertz=hertz, **faults)
            named = named or done.named
            cells.append(f"{done.took:.2f} s, {done.way_after:.2f} m")
        print(f"| {fault} | {named} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
