"""The Husky as an entity, and tracking as an environment that learning code can trust."""

from __future__ import annotations

import unittest
import warnings
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dm_env import test_utils

from ssmr.types import Commands
from tests.conftest import SYMMETRY
from validation.plants.profile import load_profile, make_plant
from validation.track.waypoint_files import open_reference

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # without a screen dm_control's import warns of its search for one
    from validation.learning import tracking


SAME_ROBOT = 2e-5
"""Over 3 s of skidding [m, rad, m/s, rad/s]: the free joint sits 13 cm lower, so the solver stops at other digits."""


class TestInterface(test_utils.EnvironmentTestMixin, unittest.TestCase):
    """dm_env's own suite."""

    def make_object_under_test(self) -> Any:
        """What is tested."""
        return tracking("thesis-lab", "line", 0.5, seed=0)

    def make_action_sequence(self) -> Any:
        """Commands at random."""
        rng = np.random.default_rng(0)
        for _ in range(20):
            yield rng.uniform([-1.0, -2.0], [1.0, 2.0])


@pytest.mark.parametrize("profile", ["thesis-lab", "husky-tile"])
def test_the_environment_is_the_plant(profile: str) -> None:
    """The same commands move the entity as they move the plant that everything else is measured with."""
    environment = tracking(profile, "circle", 0.5, seed=0)
    rng = np.random.default_rng(3)
    table = rng.uniform([-0.2, -1.0], [0.8, 1.0], (60, 2))
    environment.reset()
    for action in table:
        step = environment.step(action)
    _, waypoints = open_reference("circle", 0.5)
    plant = make_plant(load_profile(profile), "mujoco")
    motion = plant.run(Commands(0.05, table), waypoints.start, 0.05)
    state, end = environment.task.state(environment.physics), motion.state(len(motion) - 1)
    assert np.allclose(astuple(state), astuple(end), atol=SAME_ROBOT)
    assert np.allclose(step.observation["twist"], motion.twist[-1], atol=SAME_ROBOT)


def test_who_stands_still_loses_the_target() -> None:
    environment = tracking("thesis-lab", "line", 0.5, seed=0)
    step = environment.reset()
    assert step.observation["errors"] == pytest.approx(np.zeros(3), abs=SYMMETRY)
    rewards = []
    while not step.last():
        step = environment.step(np.zeros(2))
        rewards.append(step.reward)
    assert step.discount == 0.0
    assert len(rewards) * 0.05 == pytest.approx(3.0 / 0.5, abs=0.1)
    assert rewards == sorted(rewards, reverse=True)


def test_who_follows_reaches_the_end() -> None:
    """Feedforward with a little feedback is enough on a line."""
    environment = tracking("thesis-lab", "line", 0.5, seed=0)
    step = environment.reset()
    while not step.last():
        e_rho, e_y, e_alpha = step.observation["errors"]
        step = environment.step(np.array([0.5 + 2.0 * e_rho, 3.0 * e_y + 2.0 * e_alpha]))
    assert step.discount == 1.0
    assert step.reward > 0.5


def test_episodes_draw_their_robot() -> None:
    environment = tracking("thesis-lab,husky-tile", "line", 0.5, seed=1)
    radii = set()
    for _ in range(12):
        environment.reset()
        radii.add(float(environment.physics.named.model.geom_size["husky/front_left_tire", 0]))
    assert len(radii) == 2


def test_the_example_of_the_page_runs(capsys: pytest.CaptureFixture[str]) -> None:
    """The PID, read off the page and run as it stands there; a robot that lags 0.12 m would have 0.24."""
    page = (Path(__file__).resolve().parents[1] / "docs" / "learning.md").read_text(encoding="utf-8")
    example = page.split("```python")[-1].split("```")[0]
    exec(compile(example, "docs/learning.md", "exec"), {})
    reward = float(capsys.readouterr().out.split()[-1])
    assert 0.1 < reward < 1.0


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
        [np.nan, 0.0], [0.0, np.inf], [1e300, 0.0], [0.0, -101.0], [], [0.1], [0.1, 0.2, 0.3], [[0.1, 0.2]], 0.1, None, "ab",
        ["\x1b[31m", 0], [10**400, 0], [1j, 0], np.zeros((2, 1)),
    ],
)  # fmt: skip
def test_an_action_that_cannot_be_is_one_error_and_nothing_has_moved(pair: tuple[Any, Any], action: Any) -> None:
    """An environment that was told nonsense in between goes on like one that was not."""
    told, spared = pair
    before = told.physics.data.qpos.copy(), told.physics.data.qvel.copy(), told.physics.data.time
    with pytest.raises(ValueError, match=r"^action must be \(2,\) finite numbers") as refused:
        told.step(action)
    assert str(refused.value).isprintable()
    np.testing.assert_array_equal(told.physics.data.qpos, before[0])
    np.testing.assert_array_equal(told.physics.data.qvel, before[1])
    assert told.physics.data.time == before[2]
    after, expected = (environment.step(np.array([0.4, 0.3])) for environment in (told, spared))
    assert after.reward == expected.reward
    for name, value in expected.observation.items():
        np.testing.assert_array_equal(after.observation[name], value)
