"""Controllers that look ahead: predictor, model predictive control, Python objects."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import pytest

from ssmr.control import predictor
from ssmr.control.law import EMPTY_MEMORY, Memory, Observation
from ssmr.control.laws import PLAIN_CONTROLLERS, Controller, design_controller, make_gains
from ssmr.control.loop import ClosedRun, LoopSettings
from ssmr.control.mission import ControllerInput, Mission, PythonController
from ssmr.control.mpc import (
    Mpc,
    MpcGains,
    _condense_plan,
    _planned_motion,
    _step_responses,
    step_of,
)
from ssmr.control.population import run_loops
from ssmr.control.predictor import DriverEstimate
from ssmr.control.references import line, sine
from ssmr.control.tick import LOG_COLUMNS
from ssmr.control.waypoints import ALPHA_SWITCH, Errors, Waypoints, position_errors
from ssmr.models.linear import LinearParameters, state_space_matrices
from ssmr.parameters import pack_numbers
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.simulation import PlanarModel
from ssmr.types import FloatArray, State
from tests.conftest import EXACT, ROUNDOFF, SYMMETRY, distances_to_path
from validation.experiment.gains import load_gains
from validation.experiment.loops import make_controller, make_robot, run_robots
from validation.experiment.tracked import track_metrics
from validation.identify.tuning import delay_robot
from validation.plants.profile import load_profile

TRUTH = LoopSettings("truth", disturbance=False)
STRONG = Drive(delay_v=0.2, delay_w=0.2, torque_limit=1e3)
"""A driver with dead time whose motors keep the robot linear."""
A, B = (
    tuple(map(tuple, m.tolist()))
    for m in state_space_matrices(Vehicle(), LinearParameters(), STRONG)
)
WEAVE = sine(0.5, 0.3, 2.0, 1.5)
COMMANDS = [LOG_COLUMNS.index(name) for name in ("u_ref", "w_ref", "dead_time_learnt")]
"""Columns of the speeds that a controller asks for. One without a position loop has its command
there, and a law in Python always has a predictor."""


def linear(drive: Drive) -> PlanarModel:
    return PlanarModel(LinearParameters(), Vehicle(), drive)


def drive(
    body: PlanarModel,
    law: Controller | PythonController,
    way: Waypoints,
    start: State | None = None,
) -> ClosedRun:
    return run_loops([body], [law], [TRUTH], way, [1], start)[0]


class CompiledSteering:
    """A compiled law as a Python object."""

    def __init__(self, controller: Controller, mission: Mission) -> None:
        self._controller = controller
        self._mission = mission
        self._memory = EMPTY_MEMORY
        self._acts_on = Observation(0.0, 0.0, 0.0, 0.0, 0.0)

    def observe(self, now: ControllerInput) -> None:
        """Run a step of the position loop."""
        m = self._mission
        self._acts_on = now.seen
        aim = now.target
        errors = now.errors
        if self._controller.predictor:
            self._acts_on = now.ahead
            aim = m.target(now.acts_at)
            errors = position_errors(now.ahead, aim, ALPHA_SWITCH)
        kept = Errors(errors.rho - m.lookahead, errors.y, errors.alpha)
        self._memory = Memory(
            *self._controller.position_step(
                self._memory, kept, aim, self._acts_on, m.position_period
            )
        )

    def command(self, now: ControllerInput) -> tuple[float, float]:
        """Run a step of the velocity loop."""
        memory, command = self._controller.velocity_step(
            self._memory, self._acts_on, self._mission.period
        )
        self._memory = Memory(*memory)
        return command.v, command.w


def copied(law: Controller) -> PythonController:
    """The compiled law as a Python object."""
    return PythonController(
        "copy", lambda mission: CompiledSteering(law, mission), law.a, law.b, law.drive
    )


def mpc(body: PlanarModel, **gains: float) -> PythonController:
    law = design_controller("mpc", gains, np.array(A), np.array(B), body.drive)
    assert isinstance(law, PythonController)
    return law


# --------------------------------------------------------------------------------------------------
# the predictor


@pytest.mark.parametrize("name", PLAIN_CONTROLLERS)
def test_without_dead_time_the_predictor_changes_nothing(name: str) -> None:
    prompt = replace(STRONG, delay_v=0.0, delay_w=0.0)
    law = Controller(make_gains(name, {}), A, B, prompt)
    plain, behind = (
        drive(linear(prompt), each, WEAVE) for each in (law, replace(law, predictor=True))
    )
    assert np.abs(plain.table - behind.table).max() == EXACT


@pytest.mark.parametrize("name", ["pid", "lqr"])
def test_with_the_right_model_the_loop_is_that_without_dead_time_but_later(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the prediction has the robot's own steps, and the motion is seen every 8 ms only.

    No delay is learnt where there is none: with the first samples less than half of the time
    between the delays that are tried, in the end less than a millisecond.
    """
    monkeypatch.setattr(predictor, "PREDICTION_STEP", 0.001)
    prompt = replace(STRONG, delay_v=0.0, delay_w=0.0)
    law = Controller(make_gains(name, {}), A, B, STRONG, predictor=True)
    # no tick falls on a waypoint, where the target's heading jumps
    t = np.sqrt(0.0017) * np.arange(146)
    # heading counts all the way
    way = Waypoints(t, np.column_stack([0.25 * t, 0.1 * np.sin(1.5 * t)]))
    late = drive(linear(STRONG), law, way)
    here = [float(np.interp(0.2, t, way.xy[:, k])) for k in (0, 1)]
    # what is left when commands act
    rest = Waypoints(np.append(0.0, t[5:] - 0.2), np.vstack([here, way.xy[5:]]))
    at_once = drive(linear(prompt), Controller(make_gains(name, {}), A, B, prompt), rest, way.start)
    ticks = round(0.2 / 0.008)
    n = len(late.t) - ticks
    assert n > 500
    apart = late.columns("x", "y", "yaw")[ticks:] - at_once.columns("x", "y", "yaw")[:n]
    dead_time = np.abs(late.column("dead_time_learnt"))
    assert dead_time.max() <= 0.5 * predictor.GRID
    assert dead_time[-1] <= 1e-3
    assert np.abs(apart).max() <= 5e-4
    blind = drive(linear(STRONG), replace(law, predictor=False), way)
    assert (
        np.abs(blind.columns("x", "y", "yaw")[ticks:] - at_once.columns("x", "y", "yaw")[:n]).max()
        > 1e-2
    )


def test_it_learns_how_fast_the_robot_really_is() -> None:
    """A robot with a third more half-track turns more slowly than the model.

    What is seen corrects the prediction.
    """
    seen: list[ControllerInput] = []

    class Spy(CompiledSteering):
        def command(self, now: ControllerInput) -> tuple[float, float]:
            seen.append(now)
            return super().command(now)

    law = Controller(make_gains("lqr", {}), A, B, STRONG, predictor=True)
    spy = PythonController("spy", partial(Spy, law), A, B, STRONG)
    wide = PlanarModel(
        LinearParameters(), replace(Vehicle(), effective_half_track=0.275 * 4 / 3), STRONG
    )
    run = drive(wide, spy, WEAVE)
    rate_of = state_space_matrices(wide.vehicle, LinearParameters(), STRONG)
    expected = (rate_of[1][3, 1] / rate_of[0][3, 3]) / (B[3][1] / A[3][3])
    assert expected < 0.8
    assert seen[-1].driver.gain_w == pytest.approx(expected, abs=0.02)
    assert seen[-1].driver.gain_v == pytest.approx(1.0, abs=0.02)
    reached = np.interp(seen[-8].t + 0.2, run.t, run.column("yaw"))
    assert seen[-8].ahead.yaw == pytest.approx(reached, abs=0.01)


@pytest.mark.parametrize("late", [-0.05, 0.1, 0.25])
@pytest.mark.parametrize("name", ["lqr+predictor", "mpc"])
def test_it_learns_how_much_later_the_robot_answers(name: str, late: float) -> None:
    body = linear(STRONG.later(late))
    law = design_controller(name, {}, np.array(A), np.array(B), STRONG)
    learnt = drive(body, law, WEAVE).column("dead_time_learnt")
    assert learnt[-300:] == pytest.approx(late, abs=0.01)
    assert np.abs(np.diff(learnt)).max() <= 0.4 * 0.008 + ROUNDOFF


def test_a_wrong_gain_and_weak_motors_are_no_delay() -> None:
    law = design_controller("lqr+predictor", {}, np.array(A), np.array(B), STRONG)
    wide = replace(Vehicle(), effective_half_track=0.275 * 4 / 3)
    for body in (
        PlanarModel(LinearParameters(), wide, STRONG),
        linear(replace(STRONG, torque_limit=4.0)),
    ):
        learnt = drive(body, law, WEAVE).column("dead_time_learnt")
        assert abs(learnt[-1]) < 0.02


def test_noise_that_the_law_feeds_back_is_no_delay() -> None:
    """Commands of an LQR answer the noise of the yaw rate that it saw."""
    tile = load_profile("husky-tile")
    robot = make_robot(tile, "mujoco")
    law = make_controller(tile, load_gains("lqr-scheduled+predictor", "default"))
    way = sine(0.4, 0.4, 3.0, 2.0)
    runs = run_robots([robot] * 2, [law] * 2, [LoopSettings()] * 2, way, [5, 6])
    assert np.abs([run.column("dead_time_learnt")[-1] for run in runs]).max() < 0.03


def test_mpc_follows_a_robot_that_answers_later_than_it_was_told() -> None:
    lab = load_profile("thesis-lab")
    robot = make_robot(lab, "mujoco")
    law = make_controller(lab, load_gains("mpc"))
    way = sine(0.4, 0.4, 3.0, 2.0)
    robots = [robot, make_robot(lab, "mujoco", late=0.2)]
    runs = run_robots(robots, [law] * 2, [LoopSettings()] * 2, way, [5])
    told, late = (track_metrics(run, way, robot.limits) for run in runs)
    assert late["dead_time_learnt_s"] == pytest.approx(0.2, abs=0.02)
    assert told["d_rms_m"] < 0.005
    assert late["d_rms_m"] < 0.02
    assert late["saturated_fraction"] < 0.05


def test_a_controller_does_not_know_of_a_delay_that_its_drive_does_not_tell() -> None:
    lab = load_profile("thesis-lab")
    robot = make_robot(lab, "improved")
    late = delay_robot(robot, 0.1)
    law = make_controller(lab, load_gains("lqr-scheduled+predictor"))
    rows: list[float] = []

    def spy(mission: Mission) -> CompiledSteering:
        rows.append(mission.dead_time)
        assert isinstance(law, Controller)
        return CompiledSteering(law, mission)

    run_robots(
        [robot, late],
        [PythonController("spy", spy, law.a, law.b)] * 2,
        [TRUTH] * 2,
        line(0.5, 1.0),
        [0],
    )
    assert rows == [robot.drive.delay_v] * 2
    assert late.drive.delay_v == pytest.approx(robot.drive.delay_v + 0.1)


# ---------------------------------------------------------------------------------------------
# controllers in plain Python


@pytest.mark.parametrize("plant", ["improved", "mujoco"])
@pytest.mark.parametrize("name", ["lqr", "pid+predictor"])
@pytest.mark.parametrize("feedback", ["truth", "ekf"])
def test_a_python_copy_of_a_compiled_law_drives_alike(plant: str, name: str, feedback: Any) -> None:
    lab = load_profile("thesis-lab")
    robot = make_robot(lab, plant)
    law = make_controller(lab, load_gains(name))
    assert isinstance(law, Controller)
    law = law.on(robot.drive)
    settings = LoopSettings(feedback, lookahead=0.05)
    runs = [
        run_robots([robot] * 2, [each] * 2, [settings] * 2, sine(0.5, 0.3, 2.0, 0.6), [3, 4])
        for each in (law, copied(law))
    ]
    for compiled, python in zip(*runs, strict=True):
        off = np.delete(np.abs(compiled.table - python.table), COMMANDS, axis=1)
        assert off.max() <= SYMMETRY
    assert np.abs(runs[0][0].table - runs[0][1].table).max() > 1e-3


def test_an_object_that_observes_is_called_at_every_tick_and_keeps_what_it_likes() -> None:
    class Diary:
        def __init__(self, mission: Mission) -> None:
            self.mission = mission
            self.seen = []
            self.held = []
            made.append(self)

        def observe(self, now: ControllerInput) -> None:
            self.seen.append(now.seen_at)

        def command(self, now: ControllerInput) -> tuple[float, float]:
            self.held.append((now.t, now.past[-1].tolist()))
            return 0.1 * len(self.held) % 0.5, 0.0

    made: list[Any] = []
    run = drive(linear(STRONG), PythonController("diary", Diary, A, B, STRONG), line(0.5, 0.5))
    (diary,) = made
    np.testing.assert_allclose(diary.seen, run.t)
    times, past = zip(*diary.held, strict=True)
    np.testing.assert_allclose(times, 0.05 * np.arange(len(times)))
    assert list(past[1:]) == [[0.1 * (k + 1) % 0.5, 0.0] for k in range(len(past) - 1)]
    assert diary.mission.dead_time == 0.2
    np.testing.assert_allclose(
        diary.mission.preview(np.array([-1.0, 0.5, 9.0]))[:, 0], [0.0, 0.25, 0.5]
    )
    assert diary.mission.target(0.5).x == pytest.approx(0.25)


# --------------------------------------------------------------------------------------------------
# MPC


STEPS = [
    [step_of(rate, push, 0.1, h) for h in (0.05, *(0.1,) * 7)]
    for rate, push in ((8.0, 7.0), (12.0, 11.0))
]
"""Steps of speed and of yaw rate of a model with lag."""


def model_of(n: int) -> tuple[FloatArray, FloatArray]:
    return _step_responses(STEPS[0][:n]), _step_responses(STEPS[1][:n])


def step(now: FloatArray, u: FloatArray, k: int, gains: FloatArray) -> FloatArray:
    """The (7,) robot after step k of a plan: x, y, yaw, v, w and both lagged references."""
    x, y, yaw, v, w, lagged_v, lagged_w = now
    inputs = np.array(
        [[v, gains[0] * lagged_v, gains[0] * u[0]], [w, gains[1] * lagged_w, gains[1] * u[1]]]
    )
    (way, v, l_v), (angle, w, l_w) = (STEPS[i][k] @ inputs[i] for i in (0, 1))
    heading = yaw + 0.5 * angle
    x = x + way * np.cos(heading)
    y = y + way * np.sin(heading)
    return np.array([x, y, yaw + angle, v, w, l_v / gains[0], l_w / gains[1]])


Start = tuple[Observation, DriverEstimate]


def start_of(body: FloatArray, gain_v: float = 1.0, gain_w: float = 1.0) -> Start:
    """A robot at the start of a plan: its motion, then both lagged references."""
    driver = DriverEstimate(0.0, 0.0, *map(float, body[5:]), gain_v, gain_w, 0.0)
    return Observation(*map(float, body[:5])), driver


def motion(start: Start, plan: FloatArray) -> list[FloatArray]:
    """The robot at the end of every step of a plan."""
    bodies = []
    seen, driver = start
    now = np.array([*seen, driver.lagged_v, driver.lagged_w])
    for k, u in enumerate(plan):
        now = step(now, u, k, np.array([driver.gain_v, driver.gain_w]))
        bodies.append(now)
    return bodies


@cache
def example() -> tuple[Start, FloatArray]:
    """A robot in a bend, and commands."""
    start = start_of(np.array([0.3, -0.2, 0.4, 0.45, 0.3, 0.5, 0.4]), 0.95, 0.9)
    return start, np.random.default_rng(3).uniform([0.2, -0.8], [0.7, 0.8], (6, 2))


def cost_of(
    plan: FloatArray, aims: FloatArray, wanted: FloatArray, last: FloatArray, gains: MpcGains
) -> float:
    """The cost of a plan as the docstring has it, along the motion itself."""
    start, _ = example()
    total = 0.0
    before = last
    for k, body in enumerate(motion(start, plan)):
        c = np.cos(aims[k, 2])
        s = np.sin(aims[k, 2])
        dx, dy = body[:2] - aims[k, :2]
        total += gains.q_along * (c * dx + s * dy) ** 2 + gains.q_across * (c * dy - s * dx) ** 2
        total += gains.q_heading * (body[2] - aims[k, 2]) ** 2
        off = plan[k] - wanted[1 + k]
        change = plan[k] - before - (wanted[1 + k] - wanted[k])
        total += float(off**2 @ [gains.r_v, gains.r_w] + change**2 @ [gains.d_v, gains.d_w])
        before = plan[k]
    return total


def test_the_program_has_the_gradient_of_the_cost() -> None:
    start, plan = example()
    rng = np.random.default_rng(5)
    gains = MpcGains()
    model = model_of(6)
    np.testing.assert_allclose(
        _planned_motion(*start, plan, model)[0], [b[:3] for b in motion(start, plan)], rtol=1e-12
    )
    aims = np.array([b[:3] for b in motion(start, plan)]) + rng.normal(0.0, 0.05, (6, 3))
    wanted = rng.uniform(0.0, 0.5, (7, 2))
    last = np.array([0.4, 0.1])
    h, f = _condense_plan(
        _planned_motion(*start, plan, model),
        plan,
        aims,
        wanted,
        last,
        gains=pack_numbers(gains),
        doubts=np.zeros(6),
    )
    np.testing.assert_allclose(h, h.T)
    assert np.linalg.eigvalsh(h).min() > 0.0
    gradient = 2.0 * (h @ plan.ravel() + f)
    step = 1e-6
    for i in range(12):
        up, down = (plan + sign * step * np.eye(12)[i].reshape(6, 2) for sign in (1.0, -1.0))
        slope = (
            cost_of(up, aims, wanted, last, gains) - cost_of(down, aims, wanted, last, gains)
        ) / (2.0 * step)
        assert gradient[i] == pytest.approx(slope, rel=1e-6, abs=1e-6)


def test_a_change_costs_what_an_uncertain_time_makes_of_it() -> None:
    """Each command acts later or earlier by chance, and then the one before acts for that time.

    The mean of the errors' cost over that is more by its variance times their curvature.
    """
    start, plan = example()
    rng = np.random.default_rng(6)
    model = model_of(6)
    aims = np.array([b[:3] for b in motion(start, plan)]) + rng.normal(0.0, 0.05, (6, 3))
    gains = MpcGains(d_v=0.0, d_w=0.0)
    driven = _planned_motion(*start, plan, model)
    last = np.array([0.4, 0.1])
    steady = np.tile(last, (7, 1))  # the target's commands do not change
    doubts = rng.uniform(0.1, 1.0, 6)
    (h, f), (h_doubted, f_doubted) = (
        _condense_plan(driven, plan, aims, steady, last, gains=pack_numbers(gains), doubts=each)
        for each in (np.zeros(6), doubts)
    )

    def cost(u: FloatArray) -> float:
        return float(0.5 * u @ h @ u + f @ u)

    def mean_cost(u: FloatArray) -> float:
        before = np.concatenate([last, u[:-2]])
        total = 0.0
        for i in range(12):
            shift = np.sqrt(doubts[i // 2]) * (before - u)[i] * np.eye(12)[i]
            total += 0.5 * (cost(u + shift) + cost(u - shift)) - cost(u)
            # the plan's own weight of commands does not act on the robot
            total -= 0.5 * (gains.r_v, gains.r_w)[i % 2] * shift[i] ** 2
        return cost(u) + total

    here = plan.ravel()
    for _ in range(3):
        other = rng.uniform(0.0, 0.8, 12)
        more = 0.5 * other @ h_doubted @ other + f_doubted @ other
        more -= 0.5 * here @ h_doubted @ here + f_doubted @ here
        assert more == pytest.approx(mean_cost(other) - mean_cost(here), rel=1e-9)


def test_without_limits_it_is_the_lqr_of_a_finite_horizon() -> None:
    """On a line the motion is linear in small errors.

    The first command of the program is that of a Riccati recursion.
    """
    gains = MpcGains(d_v=0.0, d_w=0.0)
    none = np.ones(2)
    steady = np.array([8.0 / 7.0, 12.0 / 11.0]) * (0.5, 0.0)  # holds 0.5 m/s
    level = np.array([0.0, 0.0, 0.0, 0.5, 0.0, steady[0], 0.0])
    plan = np.tile(steady, (8, 1))
    on_line = motion(start_of(level), plan)
    aims = np.array([b[:3] for b in on_line])
    p = np.zeros((7, 7))
    q = np.diag([gains.q_along, gains.q_across, gains.q_heading, 0.0, 0.0, 0.0, 0.0])
    for k in reversed(range(8)):
        now = level if k == 0 else on_line[k - 1]
        small = 1e-6
        here = step(now, plan[k], k, none)
        a = np.array(
            [(step(now + small * e, plan[k], k, none) - here) / small for e in np.eye(7)]
        ).T
        b = np.array(
            [(step(now, plan[k] + small * e, k, none) - here) / small for e in np.eye(2)]
        ).T
        inside = p + q
        gain = np.linalg.solve(np.diag([gains.r_v, gains.r_w]) + b.T @ inside @ b, b.T @ inside @ a)
        p = a.T @ inside @ (a - b @ gain)
    off = 0.05 * np.array([0.002, -0.003, 0.004, 0.01, -0.02, 0.005, 0.01])
    driven = _planned_motion(*start_of(level + off), plan, model_of(8))
    h, f = _condense_plan(
        driven,
        plan,
        aims,
        np.vstack([steady, plan]),
        steady,
        gains=pack_numbers(gains),
        doubts=np.zeros(8),
    )
    first = np.linalg.solve(h, -f)[:2]
    # the plan is linearised where it starts
    np.testing.assert_allclose(first - steady, -gain @ off, rtol=0.005, atol=1e-6)


def test_its_commands_keep_the_limits_and_their_rates() -> None:
    tight = replace(STRONG, v_max=0.55, w_max=0.8, acceleration_v=1.0, acceleration_w=2.0)
    body = linear(tight)
    way = sine(0.5, 0.2, 4.0, 2.0)
    run = drive(body, mpc(body), way, State(-0.5, 0.3, way.start.yaw + 0.5))
    sent = run.columns("v_cmd", "w_cmd")[
        np.searchsorted(run.t, np.arange(0.0, run.t[-1], 0.05) + 0.01)
    ]
    assert (np.abs(sent).max(axis=0) <= [0.55 + ROUNDOFF, 0.8 + ROUNDOFF]).all()
    assert np.abs(sent).max(axis=0) == pytest.approx([0.55, 0.8], abs=1e-6)  # it needed them
    changes = np.abs(np.diff(sent, axis=0)).max(axis=0)
    assert (changes <= [0.05 + 1e-6, 0.1 + 1e-6]).all()
    assert not run.lost
    assert distances_to_path(run.columns("x", "y")[-150:], way.xy).max() < 0.01


def test_its_left_and_right_are_alike() -> None:
    body = linear(STRONG)
    law = mpc(linear(STRONG))
    mirrored = Waypoints(WEAVE.t, WEAVE.xy * [1.0, -1.0])
    one, other = (drive(body, law, way).columns("x", "y", "yaw") for way in (WEAVE, mirrored))
    assert np.abs(one - other * [1.0, -1.0, -1.0]).max() <= SYMMETRY


def test_it_goes_on_with_its_plan_where_the_solver_fails() -> None:
    class Failing:
        def __getattr__(self, name: str) -> Any:
            return lambda *args, **named: (np.full(2, np.nan), 0.0, -1, {})

    made: list[Mpc] = []

    def broken(mission: Mission) -> Mpc:
        made.append(Mpc(MpcGains(), mission))
        made[0]._solver = Failing()
        return made[0]

    run = drive(linear(STRONG), PythonController("mpc", broken, A, B, STRONG), line(0.5, 2.0))
    assert made[0].failures == len(np.arange(0.0, run.t[-1] + 1e-9, 0.05))
    assert np.isfinite(run.table).all()
    assert (np.abs(run.columns("v_cmd", "w_cmd")) <= [1.0, 2.0]).all()


def test_mpc_is_calm_on_a_fast_straight_line() -> None:
    """Noise in the yaw rate must not come back as commands from one limit to the other.

    Dry friction answers those late.
    """
    lab = load_profile("thesis-lab")
    way = line(0.8)
    robot = make_robot(lab, "improved")
    law = make_controller(lab, load_gains("mpc"))
    runs = run_robots([robot] * 4, [law] * 4, [LoopSettings()] * 4, way, [3, 4, 5, 6])
    off = [track_metrics(run, way, robot.limits)["d_rms_m"] for run in runs]
    assert np.mean(off) < 0.01  # from 1 to 21 mm by the noise
    for run in runs:
        assert not run.lost
        turning = run.column("w_cmd")[run.t > 3.0]  # motors at their limit have brought it to speed
        assert float(np.sqrt(np.mean(turning**2))) < 0.2
