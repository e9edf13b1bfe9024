"""Closed loops: fused against obvious, symmetries, rates, noise, lost robots."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.control.laws import PLAIN_CONTROLLERS, PREDICTOR, Controller, make_gains
from ssmr.control.loop import ClosedRun, LoopSettings, LostError, make_clock, run_loop
from ssmr.control.population import run_bodies, run_loops
from ssmr.control.references import circle, line, sine
from ssmr.control.tick import LOG_COLUMNS, LOST, SPINNING
from ssmr.control.waypoints import Waypoints
from ssmr.geometry import wrap_angle
from ssmr.models.kinematic import KinematicParameters
from ssmr.models.law import PLANAR_MODELS
from ssmr.models.linear import LinearParameters, state_space_matrices
from ssmr.robot.drive import wheel_rates
from ssmr.robot.sensors import SensorModel, SensorNoise
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.simulation import PlanarModel, PlanarPlant
from ssmr.types import FloatArray, State
from tests.conftest import EXACT, ROUNDOFF, SYMMETRY
from validation.plants.profile import load_profile, make_plant
from validation.simulator.bodies import MujocoBodies
from validation.simulator.physics import PhysicsSettings
from validation.simulator.plant import MujocoPlant

FRAME = 1e-11
"""Coordinates of some metres round to 1e-15, times the loops' gains of about ten, through hundreds
of damped ticks."""
FEEDBACKS = ("truth", "noisy", "ekf")
TORQUES = [LOG_COLUMNS.index("torque_left"), LOG_COLUMNS.index("torque_right")]
A, B = (
    tuple(map(tuple, m.tolist()))
    for m in state_space_matrices(Vehicle(), LinearParameters(), Drive())
)
TRUTH = LoopSettings(feedback="truth", disturbance=False)
PROMPT = Drive(delay_v=0.0, delay_w=0.0)
IDEAL = PlanarModel(KinematicParameters(), Vehicle(), PROMPT)
"""Moves as commanded, at once."""
BEND = circle(0.5, 1.0, 0.08)
"""One second of a left turn."""
WEAVE = sine(0.5, 0.3, 2.0, 0.7)
MIXED: tuple[tuple[str, dict[str, float], LoopSettings], ...] = (
    ("pid", {}, TRUTH),
    ("lqr", {"k_y": 0.5}, replace(TRUTH, lookahead=0.1)),
    ("lqr", {}, replace(TRUTH, noise=SensorNoise(x=0.0))),
    ("lqr-scheduled", {}, TRUTH),
    ("pid", {"k_p_rho": 1.0, "k_i_rho": 0.5}, TRUTH),
)
"""Five loops of which no two are alike."""


def controller(name: str, **gains: float) -> Controller:
    return Controller(make_gains(name, gains), A, B, predictor=name.endswith(PREDICTOR))


COMPILED = (*PLAIN_CONTROLLERS, "pid+predictor", "lqr-scheduled+predictor")
"""The compiled laws; of those behind a predictor one of each kind, with and without a velocity
loop."""
PUBLISHED = {name: controller(name) for name in COMPILED}
"""Every law with its default gains; the PID's are the published ones."""


@cache
def model(name: str) -> PlanarModel:
    plant = load_profile("thesis-lab").plants[name]
    return PlanarModel(plant.parameters, plant.vehicle, plant.drive)


@pytest.fixture(scope="module")
def husky() -> MujocoPlant:
    plant = make_plant(load_profile("thesis-lab"), "mujoco")
    assert isinstance(plant, MujocoPlant)
    return plant


@pytest.fixture(scope="module")
def exact_husky() -> MujocoPlant:
    """Return the plant with an exact solver.

    The shipped one's tolerance turns rounding into micrometres.
    """
    section = load_profile("thesis-lab").plants["mujoco"]
    return MujocoPlant(section.parameters, section.drive, settings=PhysicsSettings(solver="Newton"))


def run_huskies(
    plants: Sequence[MujocoPlant], *rest: Any, workers: int = 1, start: State | None = None
) -> list[ClosedRun]:
    """Closed loops of MuJoCo's robots; the rest is laws, settings, waypoints and seeds."""
    drives = [plant.drive for plant in plants]
    return run_bodies(
        lambda state: MujocoBodies(plants, workers, state), drives, plants[0].dt, *rest, start
    )


def drive(
    robot: PlanarModel | MujocoPlant,
    law: Controller,
    waypoints: Waypoints,
    settings: LoopSettings = TRUTH,
    seed: int = 1,
    start: State | None = None,
) -> ClosedRun:
    """One robot alone."""
    if isinstance(robot, PlanarModel):
        return run_loops([robot], [law], [settings], waypoints, [seed], start)[0]
    return run_huskies([robot], [law], [settings], waypoints, [seed], start=start)[0]


def rolling(speed: float, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> State:
    """A robot that rolls straight ahead."""
    return State(x, y, yaw, speed, 0.0, 0.0, *wheel_rates(speed, 0.0, 0.275, 0.1651))


def without_torques(run: ClosedRun) -> FloatArray:
    """What is recorded but for torques, which the slow loop does not know."""
    return np.delete(run.table, TORQUES, axis=1)


# ------------------------------------------------------------------------------------------- fused
# loops and the slow one


@pytest.mark.parametrize(
    ("name", "law", "feedback"),
    [
        (n, law, FEEDBACKS[(i + k) % 3])
        for i, n in enumerate(PLANAR_MODELS)
        for k, law in enumerate(COMPILED)
    ],
)  # each pair of model, law and feedback meets once
def test_the_fused_loop_of_planar_models_is_the_slow_one(
    name: str, law: str, feedback: str
) -> None:
    settings = LoopSettings(feedback=feedback)  # type: ignore[arg-type]
    fast = drive(model(name), PUBLISHED[law], BEND, settings, 3)
    slow = run_loop(PlanarPlant(model(name)), PUBLISHED[law], BEND, settings, 3)
    assert np.abs(without_torques(fast) - without_torques(slow)).max() == EXACT
    assert np.array_equal(fast.t, slow.t)
    assert fast.lost == slow.lost


@pytest.mark.parametrize("name", PLANAR_MODELS)
def test_so_it_is_from_a_rolling_start_at_other_rates_and_with_a_drive_that_lags(name: str) -> None:
    robot = replace(
        model(name), drive=Drive(delay_v=0.07, delay_w=0.13, acceleration_v=1.5, wheel_lag=0.05)
    )
    settings = LoopSettings(position_period=0.01, velocity_period=0.025, lookahead=0.1)
    start = State(0.1, -0.1, 0.3, 0.3, 0.0, 0.2, *wheel_rates(0.3, 0.2, 0.275, 0.1651))
    fast = drive(robot, PUBLISHED["pid"], BEND, settings, 3, start)
    slow = run_loop(PlanarPlant(robot), PUBLISHED["pid"], BEND, settings, 3, start)
    assert np.abs(without_torques(fast) - without_torques(slow)).max() == EXACT


@pytest.mark.parametrize("feedback", FEEDBACKS)
@pytest.mark.parametrize("law", COMPILED)
def test_the_batch_of_huskies_is_the_slow_loop(husky: MujocoPlant, law: str, feedback: str) -> None:
    """Equal to round-off.

    The slow loop's start has gone through the simulator's quaternion, and so has its filter's.
    """
    settings = LoopSettings(feedback=feedback)  # type: ignore[arg-type]
    fast = drive(husky, PUBLISHED[law], BEND, settings, 3)
    slow = run_loop(husky, PUBLISHED[law], BEND, settings, 3)
    # wheel rates of order 10
    assert np.abs(without_torques(fast) - without_torques(slow)).max() <= 10 * ROUNDOFF
    assert fast.lost == slow.lost


@pytest.mark.parametrize("feedback", FEEDBACKS)
def test_a_planar_population_is_its_members(feedback: str) -> None:
    models = [
        replace(model("improved"), drive=replace(Drive(), delay_v=0.2 + 0.01 * i))
        for i in range(len(MIXED))
    ]
    laws = [controller(law, **gains) for law, gains, _ in MIXED]
    settings = [
        replace(s, feedback=feedback, disturbance=True)  # type: ignore[arg-type]
        for *_, s in MIXED
    ]
    loops = list(zip(models, laws, settings, strict=True))
    alone = [
        run_loops([m], [law], [s], BEND, [7 + i % 2])[0] for i, (m, law, s) in enumerate(loops)
    ]
    for n in (1, 2):
        together = run_loops(models, laws, settings, BEND, [7, 8], workers=n)
        assert all(np.array_equal(a.table, b.table) for a, b in zip(alone, together, strict=True))
    assert len({run.table[-1, 0] for run in alone}) == len(loops)


# --------------------------------------------------------------------------------------------------
# symmetries


def all_robots(husky: MujocoPlant) -> list[PlanarModel | MujocoPlant]:
    return [*map(model, PLANAR_MODELS), husky]


@cache
def weaving(robot: PlanarModel | MujocoPlant, law: Controller) -> FloatArray:
    """(M, 3) poses on the reference as it is."""
    return drive(robot, law, WEAVE).columns("x", "y", "yaw")


def test_left_and_right_are_alike(exact_husky: MujocoPlant) -> None:
    mirrored = Waypoints(WEAVE.t, WEAVE.xy * [1.0, -1.0])
    flip = [1.0, -1.0, -1.0]
    for robot in all_robots(exact_husky):
        for law in PUBLISHED.values():
            one = weaving(robot, law)
            other = drive(robot, law, mirrored).columns("x", "y", "yaw")
            tolerance = FRAME if isinstance(robot, PlanarModel) else SYMMETRY
            assert np.abs(one - other * flip).max() <= tolerance, (robot.name, law.name)
            assert np.abs(one[:, 1]).max() > 0.1


@pytest.mark.parametrize("frame", [(2.0, -1.0, 0.7), (-30.0, 5.0, 3.0)])
def test_the_world_frame_does_not_matter(
    exact_husky: MujocoPlant, frame: tuple[float, float, float]
) -> None:
    c = math.cos(frame[2])
    s = math.sin(frame[2])
    turn = np.array([[c, s], [-s, c]])
    shift = frame[:2]
    moved = Waypoints(WEAVE.t, WEAVE.xy @ turn + shift)
    for robot in all_robots(exact_husky):
        for law in PUBLISHED.values():
            here = weaving(robot, law)
            there = drive(robot, law, moved).columns("x", "y", "yaw")
            tolerance = FRAME if isinstance(robot, PlanarModel) else SYMMETRY
            assert np.abs(here[:, :2] @ turn + shift - there[:, :2]).max() <= tolerance, (
                robot.name,
                law.name,
            )
            assert np.abs(wrap_angle(here[:, 2] + frame[2] - there[:, 2])).max() <= tolerance


# ------------------------------------------------------------------------------------------------
# what the equations say


def test_a_robot_on_its_reference_at_its_speed_stays_there() -> None:
    # it knows the steady gain
    robot, law = PlanarModel(LinearParameters(), Vehicle(), PROMPT), PUBLISHED["lqr-scheduled"]
    run = drive(robot, law, line(0.5, 2.0), start=rolling(0.5))
    # a metre rounds to 1e-16, the gains are ten
    assert np.abs(run.columns("e_rho", "e_y", "e_alpha")).max() <= 1e-12
    late = replace(robot, drive=replace(PROMPT, delay_v=0.2))
    run = drive(late, law, line(0.5, 6.0), start=rolling(0.5))
    deepest = int(np.argmax(run.column("e_rho")))
    assert 0.2 <= run.t[deepest] <= 0.5  # no command arrives before, and the robot has stood still
    assert np.abs(run.column("e_rho")[run.t > 8.0]).max() < 0.01 * run.column("e_rho")[deepest]


def decay(run: ClosedRun, begin: float, end: float) -> float:
    """Time constant of e_rho between two times [s]."""
    i, j = np.searchsorted(run.t, [begin, end])
    e = run.column("e_rho")
    return float((run.t[j] - run.t[i]) / math.log(e[i] / e[j]))


@pytest.mark.parametrize(("k_p", "k_i"), [(2.836, 0.115), (2.0, 0.5), (1.0, 0.1)])
def test_the_lag_of_a_pid_dies_out_as_its_equation_says(k_p: float, k_i: float) -> None:
    """On a line d e / dt = v - K_P e - K_I int e.

    So s^2 + K_P s + K_I = 0, whose slow root is -K_I / K_P to first order.
    """
    law = controller("pid", k_p_rho=k_p, k_i_rho=k_i, k_p_u=0.0, k_i_u=0.0)
    run = drive(IDEAL, law, line(0.25, 10.8))
    begin = 5.0 / k_p
    measured = decay(run, begin, min(begin + 2.0 * k_p / k_i, 40.0))
    slow = np.roots([1.0, k_p, k_i]).max()
    # commands are held for 0.05 s of some 2 to 24
    assert measured == pytest.approx(-1.0 / slow, rel=0.02)
    # what the first order leaves out
    assert measured == pytest.approx(k_p / k_i, rel=0.02 + k_i / k_p**2)


@pytest.mark.parametrize("distance", [0.0, 0.1, 0.3])
def test_the_robot_keeps_the_look_ahead(distance: float) -> None:
    """The PID's lag has died out by exp(-20 / 2.8)."""
    run = drive(
        model("improved"),
        controller("pid", k_i_rho=1.0),
        line(0.5, 10.0),
        replace(TRUTH, lookahead=distance),
    )
    assert run.column("e_rho")[-2] == pytest.approx(distance, abs=1e-3)


# --------------------------------------------------------------------------------------------------
# rates and clock


@pytest.mark.parametrize("law", COMPILED)
def test_commands_change_with_the_velocity_loop_and_never_between(law: str) -> None:
    run = drive(model("improved"), PUBLISHED[law], WEAVE, LoopSettings())
    tick = (8 * np.arange(len(run.t))) // 50  # in steps of 1 ms
    commands = run.columns("v_cmd", "w_cmd")
    changed = np.any(np.diff(commands, axis=0) != 0.0, axis=1)
    assert np.array_equal(changed, np.diff(tick) > 0)
    assert np.all(np.any(np.diff(run.columns("u_ref", "w_ref"), axis=0) != 0.0, axis=1))
    assert np.allclose(np.diff(run.t), 0.008, rtol=1e-9)


@given(st.floats(0.01, 60.0), st.sampled_from([0.002, 0.008, 0.01, 0.05]))
def test_the_clock_covers_the_whole_mission_and_no_tick_more(
    duration: float, period: float
) -> None:
    way = Waypoints(np.array([3.0, 3.0 + duration]), np.array([[0.0, 0.0], [1.0, 0.0]]))
    clock = make_clock(way, LoopSettings(position_period=period), 0.001)
    end = clock.n * clock.dt
    assert clock.n == (clock.ticks - 1) * clock.position
    assert way.duration - 1e-9 <= end < max(way.duration, period) + period


# --------------------------------------------------------------------------------------------------
# noise


def test_equal_seeds_give_equal_runs_and_others_do_not(husky: MujocoPlant) -> None:
    for robot in (model("improved"), husky):
        for settings in (
            LoopSettings(),
            LoopSettings(feedback="ekf"),
            replace(TRUTH, disturbance=True),
        ):
            one, again, other = (
                drive(robot, PUBLISHED["pid"], BEND, settings, seed) for seed in (5, 5, 6)
            )
            assert np.array_equal(one.table, again.table)
            assert np.abs(one.table - other.table).max() > 1e-6
        calm = [drive(robot, PUBLISHED["pid"], BEND, TRUTH, seed).table for seed in (5, 6)]
        assert np.array_equal(calm[0], calm[1])


@pytest.mark.parametrize("bias", [-0.0156, 0.0156])
def test_the_rest_before_the_start_tells_the_bias(bias: float) -> None:
    """Without it the yaw drifts by the bias; with it the loops see the same whatever it is."""
    loops = LoopSettings(feedback="ekf", disturbance=False)
    biased = replace(loops, sensors=SensorModel(gyro_bias=bias))
    law = PUBLISHED["lqr"]
    known, same = (drive(IDEAL, law, BEND, around, seed=3) for around in (loops, biased))
    # the bias is added and taken off again
    assert np.allclose(same.table, known.table, rtol=0.0, atol=1e-9)
    blind = drive(IDEAL, law, BEND, replace(biased, standing=0.0), seed=3)
    drift = (blind.column("seen_yaw") - blind.column("yaw"))[-1]
    apart = (known.column("seen_yaw") - known.column("yaw"))[-1]
    assert drift - apart == pytest.approx(bias * blind.t[-1], rel=0.1)


def test_noise_depends_on_the_seed_alone(husky: MujocoPlant) -> None:
    """Measurement less truth: the same for each robot and controller, to rounding of metres."""
    shown = ("seen_x", "seen_y", "seen_yaw", "seen_v", "seen_w")
    true = ("x", "y", "yaw", "v_x", "yaw_rate")
    settings = LoopSettings(noise=SensorNoise(x=1e-4, y=1e-4, yaw=1e-4))
    runs = [
        drive(robot, law, BEND, settings, 9)
        for robot in (model("improved"), husky)
        for law in PUBLISHED.values()
    ]
    noise = [run.columns(*shown) - run.columns(*true) for run in runs]
    assert all(np.abs(n - noise[0]).max() <= ROUNDOFF for n in noise)
    deviations = settings.deviations()
    # some 128 draws each: a standard deviation is known to 6 %, four of these
    assert np.allclose(noise[0].std(axis=0), deviations, rtol=0.25)


# --------------------------------------------------------------------------------------------------
# lost robots

IDLE = controller("pid", k_p_rho=0.0, k_i_rho=0.0)
"""Does not go anywhere."""
FLIGHT = line(1.0, 5.0)


@pytest.mark.parametrize("angle", [0.0, math.pi / 4, 2.0])
def test_a_robot_that_stays_is_lost_when_its_target_has_gone_too_far_wherever_to(
    angle: float, husky: MujocoPlant
) -> None:
    away = Waypoints(FLIGHT.t, FLIGHT.xy[:, :1] * [math.cos(angle), math.sin(angle)])
    for robot in (model("improved"), husky):
        run = drive(robot, IDLE, away)
        assert run.lost
        assert LOST <= run.t[-1] <= LOST + 2 * 0.008  # at 1 m/s
        assert np.isfinite(run.table).all()
        assert len(run.t) == len(run.table) == len(run.motion)
        with pytest.raises(LostError) as caught:
            run.require_complete("an idle robot")
        text = str(caught.value)
        evidence = caught.value.evidence
        assert text.startswith(f"an idle robot left its bounds at t = {run.t[-1]:.2f} s: x = ")
        gap = run.columns("target_x", "target_y")[-1] - run.columns("x", "y")[-1]
        assert f"{np.hypot(*gap):.2f} m from its" in text
        assert (evidence["t"], evidence["state"], evidence["run"]) == (run.t[-1], run.state, run)


def test_a_robot_that_spins_is_lost() -> None:
    robot = replace(IDEAL, drive=Drive(w_max=1e3))
    run = drive(robot, controller("pid", k_p_y=1e4, ff_w=1.0), WEAVE)
    assert run.lost
    assert abs(run.state.yaw_rate) >= SPINNING
    assert np.all(np.abs(run.column("yaw_rate")[:-1]) < SPINNING)
    slow = run_loop(PlanarPlant(robot), controller("pid", k_p_y=1e4, ff_w=1.0), WEAVE, TRUTH, 1)
    assert slow.lost
    assert np.array_equal(without_torques(slow), without_torques(run))


def test_one_lost_robot_does_not_disturb_the_others(husky: MujocoPlant) -> None:
    laws = (PUBLISHED["pid"], IDLE, PUBLISHED["lqr-scheduled"])
    alone = [drive(model("improved"), law, FLIGHT, LoopSettings()) for law in laws]
    together = run_loops([model("improved")] * 3, laws, [LoopSettings()] * 3, FLIGHT, [1])
    assert [run.lost for run in together] == [False, True, False]
    assert all(np.array_equal(a.table, b.table) for a, b in zip(alone, together, strict=True))
    alone = [drive(husky, law, FLIGHT, LoopSettings()) for law in laws]
    together = run_huskies([husky] * 3, laws, [LoopSettings()] * 3, FLIGHT, [1], workers=2)
    assert [run.lost for run in together] == [False, True, False]
    assert all(np.array_equal(a.table, b.table) for a, b in zip(alone, together, strict=True))


def test_a_husky_whose_simulation_gives_up_is_lost_and_does_not_begin_again(
    husky: MujocoPlant,
) -> None:
    """MuJoCo puts a diverged robot back to the origin, here not far from the target."""
    for run in run_huskies(
        [husky] * 2, [PUBLISHED["pid"]] * 2, [TRUTH] * 2, BEND, [1], start=State(v_x=1e11)
    ):
        assert run.lost
        assert len(run.t) == 1
        with pytest.raises(LostError, match="left its bounds"):
            run.require_complete("it")
