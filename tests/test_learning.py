"""Environments that learning code can trust.

They repeat, pass their makers' own suites, and have the plant of all else.
"""

from __future__ import annotations

import ctypes.util
import importlib.util
import os
import subprocess
import sys
import unittest
import warnings
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from dm_env import test_utils

import validation
from ssmr.types import Commands, State
from tests.conftest import ROUNDOFF, SYMMETRY
from tests.urdf_factory import UrdfRobot
from validation.experiment.waypoint_files import open_reference
from validation.learning import TrackBatch, TrackTask, tracking
from validation.learning.episodes import DELAY, FRICTION, EpisodeSource
from validation.plants.profile import load_profile, make_plant
from validation.simulator.motors import actuator_inputs

PLAIN: dict[str, Any] = {"spread": 0.0, "noise": False, "timestep": 0.002}
"""The profile's own robot at the first waypoint, without noise, in the physics of all other
programs."""
SAME_ROBOT = 2e-5
"""Over a second of skidding [m]: the entity's free joint sits 13 cm lower, so the solver stops at
other digits."""


class TestInterface(test_utils.EnvironmentTestMixin, unittest.TestCase):
    """dm_env's own suite."""

    def make_object_under_test(self) -> Any:
        """What is tested."""
        return tracking("thesis-lab", seed=0)

    def make_action_sequence(self) -> Any:
        """Commands at random, through the end of an episode."""
        rng = np.random.default_rng(0)
        for _ in range(60):
            yield rng.uniform([-1.0, -2.0], [1.0, 2.0])


def ended(batch: TrackBatch, ticks: int, seed: int) -> list[tuple[Any, ...]]:
    """Drive all rows at random and return what each tick brought; rows share no random numbers."""
    commands = [np.random.default_rng([seed + i, 1]) for i in range(len(batch))]
    brought = [(batch.reset(),)]
    for _ in range(ticks):
        brought.append(
            tuple(batch.step([rng.uniform([0.0, -0.5], [1.0, 0.5]) for rng in commands]))
        )
    return brought


def test_a_row_does_not_know_the_others() -> None:
    """Alone or among others, on one thread or two, over several episodes: the same to the bit."""
    task = TrackTask(seconds=2.0)
    rows = 3
    ticks = 100
    together = TrackBatch(task, rows, 2)
    for row in range(rows):
        together.seed(row, row)
    brought = ended(together, ticks, 0)
    for row in range(rows):
        alone = TrackBatch(task, 1, 1)
        alone.seed(0, row)
        began = 0
        for single, many in zip(ended(alone, ticks, row), brought, strict=True):
            for ours, theirs in zip(single, many, strict=True):
                np.testing.assert_array_equal(ours[0], theirs[row])
            began += int(len(single) > 1 and single[4][0])
        assert began >= 2
    assert not np.array_equal(brought[0][0][0], brought[0][0][1])


@pytest.mark.parametrize("profile", ["thesis-lab", "husky-tile"])
def test_the_environment_is_the_plant(profile: str) -> None:
    """The same commands move it as they move the plant that everything else is measured with."""
    batch = TrackBatch(TrackTask(profile, "circle", 0.5, **PLAIN))
    table = np.random.default_rng(3).uniform([-0.2, -1.0], [0.8, 1.0], (60, 2))
    batch.reset()
    for action in table:
        seen = batch.step(action[None]).observations[0]
    _, waypoints = open_reference("circle", 0.5)
    plant = make_plant(load_profile(profile), "mujoco")
    end = plant.run(Commands(0.05, table), waypoints.start, 0.05).state(60)
    assert seen[:2] == pytest.approx([end.v_x, end.yaw_rate], abs=SYMMETRY)
    aim = waypoints.trajectory(0.05)
    gap = float(np.hypot(*(aim.xy[60] - (end.x, end.y))))
    assert np.hypot(seen[2], seen[3]) == pytest.approx(gap, abs=SYMMETRY)
    assert seen[5:7] == pytest.approx(aim.twist[60, [0, 2]], abs=ROUNDOFF)
    np.testing.assert_array_equal(
        seen[batch.source.slices["commands"][0]].reshape(-1, 2), table[-batch.source.past :]
    )


def test_who_stands_still_loses_the_target() -> None:
    environment = tracking("thesis-lab", "line", 0.5, seed=0, **PLAIN)
    step = environment.reset()
    assert step.observation["targets"][0, :3] == pytest.approx(np.zeros(3), abs=SYMMETRY)
    rewards = []
    while not step.last():
        step = environment.step(np.zeros(2))
        rewards.append(step.reward)
    assert step.discount == 0.0
    assert len(rewards) * 0.05 == pytest.approx(environment.batch.source.lost / 0.5, abs=0.1)
    assert rewards == sorted(rewards, reverse=True)
    assert environment.step(np.zeros(2)).first()


def test_what_a_seed_draws() -> None:
    """Robots, starts, paths and speeds differ between episodes, within documented ranges."""
    source = EpisodeSource(TrackTask("thesis-lab,husky-tile"))
    rng = np.random.default_rng(0)
    drawn = [source.draw_episode(rng) for _ in range(60)]
    for section in source.sections:
        width = section.drive.command_half_track
        robots = [(c, d) for c, d, *_ in drawn if d.command_half_track == width]
        assert len(robots) > 15
        for of, usual, spread in (
            ([c.friction for c, _ in robots], section.parameters.friction, FRICTION),
            ([d.delay_w for _, d in robots], section.drive.delay_w, DELAY),
        ):
            shares = np.array(of) / usual - 1.0
            assert 0.5 * spread < np.abs(shares).max() <= spread
    _, _, starts, targets, _, _ = zip(*drawn, strict=True)
    speeds = np.array([t[0, 3] for t in targets])
    assert speeds.min() >= 0.19
    assert 0.6 < speeds.max() <= 0.81
    assert np.array([t[:, 4] for t in targets]).std() > 0.1
    assert np.array([start.yaw for start in starts]).std() > 0.1
    again = source.draw_episode(np.random.default_rng(0))
    assert again[:3] == drawn[0][:3]


def test_a_robot_that_flies_apart_is_lost_and_the_next_one_is_not() -> None:
    batch = TrackBatch(TrackTask(), 2, 1)
    batch.seed(0, 0)
    batch.seed(1, 1)
    batch.reset()
    batch._bodies.qvel[0, 0] = 1e12
    now = batch.step(np.zeros((2, 2)))
    assert now.lost.tolist() == [True, False]
    assert np.isfinite(now.observations).all()
    assert now.rewards[0] == 0.0
    now = batch.step(np.zeros((2, 2)))
    assert now.began.tolist() == [True, False]
    assert not batch.step(np.zeros((2, 2))).lost.any()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"spread": 1.5}, "spread"),
        ({"seconds": 0.0}, "seconds"),
        ({"speed": (0.5, 0.2)}, "speed"),
        ({"timestep": 0.003}, "not a whole number of physics steps"),
        ({"profiles": ","}, "of one robot"),
        ({"profiles": "thesis-lab,warthog-grass"}, "of one robot, they are of husky, warthog"),
        ({"reference": "no-such"}, "no reference 'no-such'"),
    ],
)  # fmt: skip
def test_tasks_that_cannot_be(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        EpisodeSource(TrackTask(**wrong))


def test_an_entity_on_its_ground_is_the_plant() -> None:
    """Wheel rates move a dm_control entity as the plant, over a second into a bend."""
    with warnings.catch_warnings():
        # without a screen dm_control's import warns of its search for one
        warnings.simplefilter("ignore")
        mjcf = pytest.importorskip(
            "dm_control.mjcf", reason="dm_control has no wheels for Python 3.13 and later"
        )
        from validation.learning import RobotEntity, ground

    plant = make_plant(load_profile("thesis-lab"), "mujoco")
    arena = ground(plant.calibration.robot)
    robot = RobotEntity(plant.calibration.robot)
    arena.add_free_entity(robot)
    physics = mjcf.Physics.from_mjcf_model(arena.mjcf_model)
    robot.calibrate(physics, plant.calibration, plant.drive)
    model = physics.model.ptr
    base = f"{robot.prefix}base"
    start = plant.placed(State())
    with physics.reset_context():
        physics.data.qpos[:] = start[1 : 1 + plant.model.nq]
        # the free joint's frame is the MJCF's origin, not the base
        physics.data.qpos[2] -= float(model.body(base).pos[2])
    data = mujoco.MjData(plant.model)
    mujoco.mj_setState(plant.model, data, start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    for k in range(500):
        wanted = np.array([3.0, 4.0]) * min(1.0, k / 100)
        data.ctrl[:] = actuator_inputs(plant.model, wanted)
        physics.data.ctrl[:] = actuator_inputs(model, wanted)
        mujoco.mj_step(plant.model, data)
        physics.step()
    mujoco.mj_kinematics(plant.model, data)
    assert np.allclose(physics.named.data.xpos[base], data.body("base").xpos, atol=SAME_ROBOT)
    assert np.hypot(*data.qpos[:2]) > 0.3


@pytest.fixture(scope="module")
def pair() -> tuple[Any, Any]:
    """Two environments that are one."""
    made = tuple(tracking("thesis-lab", "line", 0.5, seed=0) for _ in range(2))
    for environment in made:
        environment.reset()
    return made[0], made[1]


@pytest.mark.parametrize(
    "action",
    [
        [np.nan, 0.0],
        [],
        [0.1, 0.2, 0.3],
        [[0.1, 0.2]],
        None,
        ["\x1b[31m", 0],
        [10**400, 0],
        np.zeros((2, 1)),
    ],
)
def test_an_action_that_cannot_be_is_one_error_and_nothing_has_moved(
    pair: tuple[Any, Any], action: Any
) -> None:
    """An environment that was told nonsense in between goes on like one that was not."""
    reported, spared = pair
    with pytest.raises(ValueError, match=r"^action must be \(2,\) finite numbers") as refused:
        reported.step(action)
    assert str(refused.value).isprintable()
    after, expected = (environment.step(np.array([0.4, 0.3])) for environment in (reported, spared))
    assert after.reward == expected.reward
    for name, value in expected.observation.items():
        np.testing.assert_array_equal(after.observation[name], value)


@pytest.mark.parametrize(("place", "least", "most"), [(1, 0.55, 0.67), (-1, 0.2, 1.0)])
def test_the_examples_of_the_page_run(
    place: int, least: float, most: float, capsys: pytest.CaptureFixture[str]
) -> None:
    """Many robots side by side, and the PID, read off the page and run as they stand there.

    A robot that stands still would have less than 0.1.
    """
    pytest.importorskip("gymnasium", reason="Gymnasium is missing (extra `learning`)")
    page = (Path(__file__).resolve().parents[1] / "docs" / "learning.md").read_text(
        encoding="utf-8"
    )
    example = page.split("```python")[place].split("```")[0]
    exec(compile(example, "docs/learning.md", "exec"), {})
    reward = float(capsys.readouterr().out.split()[-1])
    assert least < reward < most


TRACK = "validation.learning.gym:ssmr/Track-v0"


@pytest.fixture(scope="module")
def gymnasium() -> Any:
    """Gymnasium, which comes with the extra `learning`."""
    return pytest.importorskip("gymnasium", reason="Gymnasium is missing (extra `learning`)")


def test_the_checker_of_gymnasium_finds_nothing(gymnasium: Any) -> None:
    from gymnasium.utils.env_checker import check_env

    environment = gymnasium.make(TRACK, profiles="thesis-lab,husky-tile")
    check_env(environment.unwrapped, skip_render_check=True)
    seen, _ = environment.reset(seed=0)
    assert seen.dtype == np.float32
    environment.step(environment.action_space.sample())


FRAME = f"""
import gymnasium
import numpy as np
environment = gymnasium.make("{TRACK}", render_mode="rgb_array")
environment.reset(seed=0)
frame = environment.render()
assert (frame.shape, frame.dtype) == ((240, 320, 3), np.uint8), frame.shape
dark = np.mean(np.all(frame < 90, axis=2))  # hull and tyres on a light floor
assert 0.02 < dark < 0.6, dark
environment.close()
"""


def test_a_vector_is_its_single_environments(gymnasium: Any) -> None:
    """Row i of a seed s is the environment of s + i, also from one episode to the next."""
    rows, ticks, seed = 3, 50, 7
    task = {"seconds": 1.0, "spread": 0.5}
    many = gymnasium.make_vec(TRACK, rows, **task)
    assert type(many.unwrapped).__name__ == "TrackVectorEnv"
    ones = gymnasium.make_vec(TRACK, rows, vectorization_mode="sync", **task)
    np.testing.assert_array_equal(many.reset(seed=seed)[0], ones.reset(seed=seed)[0])
    rng = np.random.default_rng(0)
    ended = 0
    for _ in range(ticks):
        actions = rng.uniform(-1.0, 1.0, (rows, 2)).astype(np.float32)
        *ours, info = many.step(actions)
        *theirs, other = ones.step(actions)
        for a, b in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(a, b)
        known = info["_away"]
        if "away" in other:
            np.testing.assert_array_equal(known, other["_away"])
            np.testing.assert_array_equal(info["away"][known], other["away"][known])
        ended += int(np.sum(ours[2] | ours[3]))
    assert ended >= rows
    assert many.single_observation_space == ones.single_observation_space
    assert many.action_space == ones.action_space
    many.reset(seed=[1, None, 3])
    ones.reset(seed=[1, None, 3])
    np.testing.assert_array_equal(many.reset(seed=[5, 6, 7])[0], ones.reset(seed=[5, 6, 7])[0])


def test_an_environment_gives_a_frame_of_its_robot(gymnasium: Any) -> None:
    """MuJoCo chooses how it draws when it is imported."""
    if ctypes.util.find_library("EGL") is None:
        pytest.skip("there is no EGL to draw with")
    run = subprocess.run(
        [sys.executable, "-c", FRAME],
        env={**os.environ, "MUJOCO_GL": "egl"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr


def test_frames_without_a_display_say_what_they_need(
    gymnasium: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    environment = gymnasium.make(TRACK, render_mode="rgb_array").unwrapped
    with pytest.raises(RuntimeError, match="set MUJOCO_GL=egl"):
        environment.render()


def test_a_driver_without_a_greatest_speed_is_refused_by_name(tmp_path: Path) -> None:
    shipped = (Path(validation.__file__).parents[1] / "models/jackal.toml").read_text(
        encoding="utf-8"
    )
    kept = [line for line in shipped.splitlines() if not line.startswith(("v_max", "w_max"))]
    path = tmp_path / "endless.toml"
    path.write_text("\n".join(kept), encoding="utf-8")
    with pytest.raises(ValueError, match="has no greatest speed, of which actions are shares"):
        TrackBatch(TrackTask(robot=path))


@pytest.mark.parametrize("most", [4.0, 10.0])
def test_an_imported_robot_keeps_the_limit_of_its_wheels(tmp_path: Path, most: float) -> None:
    """A URDF says how fast its wheels turn, and nothing of yaw rates: v and omega share it."""
    written = UrdfRobot(wheel=1.0)
    text = written.text().replace(
        'type="continuous">', f'type="continuous"><limit effort="20" velocity="{most}"/>'
    )
    path = tmp_path / "rover.urdf"
    path.write_text(text, encoding="utf-8")
    assert f'velocity="{most}"' in text
    batch = TrackBatch(TrackTask(robot=path, spread=0.0, noise=False, speed=0.3), 1, 1)
    half = batch.source.sections[0].drive.command_half_track
    rim = most * written.radius
    assert batch.source.top == pytest.approx([rim, rim / half])
    for action in ([9.0, 0.0], [0.0, 9.0], [9.0, -9.0], [-0.7 * rim, 0.8 * rim / half]):
        v, w = batch._commands([action])[0]
        assert abs(v) + half * abs(w) == pytest.approx(rim)
        within = np.clip(action, -batch.source.top, batch.source.top)
        assert v * within[1] == pytest.approx(w * within[0]), "the bend stays"
    gentle = [0.4 * rim, 0.5 * rim / half]
    assert batch._commands([gentle])[0] == pytest.approx(gentle, rel=1e-15)
    batch.reset()
    for _ in range(20):
        batch.step([[9.0, 9.0]])
    plant = batch._plants[0]
    rates = batch._bodies.qvel[0][plant.parts.dofs]
    assert np.abs(rates).max() < 1.05 * most


def test_seeds_of_rows_are_as_many_and_of_any_kind(gymnasium: Any) -> None:
    many = gymnasium.make_vec(TRACK, 3, seconds=1.0)
    first = many.reset(seed=5)[0]
    for seeds in (np.int64(5), [5, 6, 7], np.arange(5, 8), (5, None, 7)):
        again = many.reset(seed=seeds)[0]
        np.testing.assert_array_equal(again[[0, 2]], first[[0, 2]])
    for seeds in ([1, 2], [1, 2, 3, 4]):
        with pytest.raises(ValueError, match="argument"):
            many.reset(seed=seeds)


@pytest.mark.slow
def test_the_policy_of_the_page_learns(tmp_path: Path) -> None:
    """From standing still to following, and then the picture of the page.

    What it learnt holds on a path it never saw.
    """
    path = Path(__file__).resolve().parents[1] / "docs" / "examples" / "learn_to_track.py"
    spec = importlib.util.spec_from_file_location("learn_to_track", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    policy, weights, history = module.learn(20, every=20)
    assert history[0]["reward"] < 0.1
    assert history[-1]["reward"] > 0.5
    measured = module.judge(policy, weights, ("sine@0.5",), 1)
    assert not measured["sine"]["learnt"]["lost"]
    module.draw(history, module.pid_reward(8), measured, tmp_path / "learning.png")
    assert (tmp_path / "learning.png").stat().st_size > 10_000


@pytest.mark.slow
def test_ppo_learns() -> None:
    pytest.importorskip("stable_baselines3")
    path = Path(__file__).resolve().parents[1] / "docs" / "examples" / "learn_with_ppo.py"
    module = importlib.util.module_from_spec(
        importlib.util.spec_from_file_location("learn_with_ppo", path)  # type: ignore[arg-type]
    )
    module.__spec__.loader.exec_module(module)  # type: ignore[union-attr]
    curve = module.learn(300_000)
    assert curve[0][1] < 0.1
    assert curve[-1][1] > 0.6
