"""Learn to follow paths with Stable-Baselines3's PPO, beside the shipped PID and LQR.

Usage: `python docs/examples/learn_with_ppo.py [FOLDER]`, with `pip install stable-baselines3`. The
policy is linear in the observation; the critic is a network. The reward is judged on 64 episodes
that no training saw. Writes `ppo.png` into the folder, the current one if none is given.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize

from ssmr.control.law import EMPTY_MEMORY, Observation
from ssmr.control.loop import VELOCITY_PERIOD
from ssmr.control.waypoints import ALPHA_SWITCH, Errors, Target
from ssmr.types import FloatArray
from validation.experiment.gains import load_gains
from validation.experiment.loops import make_controller
from validation.learning import TrackBatch, TrackTask
from validation.plants.profile import load_profile

TASK: dict[str, Any] = {"profiles": "thesis-lab", "seconds": 8.0}
EPISODES = 64
GAMMA = 0.98
STEPS = 300_000


def mean_reward(act: Any) -> float:
    """Return the mean reward of commands [m/s, rad/s] on the episodes; a lost robot earns 0."""
    batch = TrackBatch(TrackTask(**TASK), EPISODES)
    for row in range(EPISODES):
        batch.seed(row, 10**6 + row)
    seen = batch.reset()
    alive = np.ones(EPISODES, dtype=bool)
    total = np.zeros(EPISODES)
    for _ in range(batch.source.most_ticks):
        now = batch.step(act(seen))
        seen = now.observations
        alive &= ~now.lost
        total += np.where(alive, now.rewards, 0.0)
    return float(total.mean() / batch.source.most_ticks)


def shipped(name: str) -> Any:
    """Return the published law `name` as a function of observations."""
    law: Any = make_controller(load_profile("thesis-lab"), load_gains(name, "published"))
    memories = [EMPTY_MEMORY] * EPISODES

    def act(seen: FloatArray) -> FloatArray:
        commands = np.empty((EPISODES, 2))
        for i, row in enumerate(seen):
            robot = Observation(0.0, 0.0, 0.0, row[0], row[1])
            aim = Target(0.0, 0.0, 0.0, row[5], row[6], 0)
            alpha = row[4] if np.hypot(row[2], row[3]) <= ALPHA_SWITCH else 0.0
            errors = Errors(row[2], row[3], alpha)
            memory = law.position_step(memories[i], errors, aim, robot, VELOCITY_PERIOD)
            memories[i], commands[i] = law.velocity_step(memory, robot, VELOCITY_PERIOD)
        return commands

    return act


class Watch(BaseCallback):
    """Judges the policy after every tenth rollout."""

    def __init__(self, environment: VecNormalize) -> None:
        """Take the environment that scales the observations."""
        super().__init__()
        self.environment = environment
        self.source = TrackBatch(TrackTask(**TASK), 1).source
        self.curve: list[tuple[float, float]] = []
        self.spent = -time.process_time()

    def act(self, seen: FloatArray) -> FloatArray:
        """Return (S, 2) commands [m/s, rad/s] of the policy as it is."""
        shares = self.environment.normalize_obs(seen / self.source.bounds)
        actions, _ = self.model.predict(shares, deterministic=True)
        return np.asarray(np.clip(actions, -1.0, 1.0) * self.source.top)

    def judge(self) -> None:
        """Note the processor time of training so far [s], and the reward."""
        now = time.process_time()
        reward = mean_reward(self.act)
        self.curve.append((now + self.spent, reward))
        self.spent -= time.process_time() - now
        print(f"{self.num_timesteps} steps, {self.curve[-1][0]:.0f} s: {reward:.2f}", flush=True)

    def _on_rollout_start(self) -> None:
        if self.num_timesteps % 20_480 == 0:
            self.judge()

    def _on_step(self) -> bool:
        return True


def learn(steps: int) -> list[tuple[float, float]]:
    """Return the curve: processor time [s] and reward."""
    torch.set_num_threads(1)
    name = "validation.learning.gym:ssmr/Track-v0"
    robots = make_vec_env(name, 16, env_kwargs=TASK, seed=1)
    environment = VecNormalize(robots, gamma=GAMMA)
    policy = {"log_std_init": -1.0, "net_arch": {"pi": [], "vf": [64, 64]}}
    model = PPO(
        "MlpPolicy",
        environment,
        learning_rate=lambda left: 3e-3 * left + 5e-5,
        n_steps=128,
        batch_size=256,
        gamma=GAMMA,
        policy_kwargs=policy,
        seed=1,
        device="cpu",
    )
    watch = Watch(environment)
    model.learn(steps, watch)
    watch.judge()
    return watch.curve


def main(folder: Path) -> None:
    """Learn and draw."""
    rules = {name: mean_reward(shipped(name)) for name in ("pid", "lqr")}
    print(rules)
    curve = learn(STEPS)
    figure, axes = plt.subplots(figsize=(5.0, 3.0), layout="constrained")
    axes.plot(*zip(*curve, strict=True), color="#0072b2", label="PPO, linear policy")
    for (name, reward), colour in zip(rules.items(), ("#d55e00", "#009e73"), strict=True):
        axes.axhline(reward, color=colour, linestyle="--", label=f"{name.upper()}, published")
    axes.set(xlabel="processor time [s]", ylabel="mean reward", ylim=(0.0, 1.0))
    axes.legend()
    figure.savefig(folder / "ppo.png", dpi=90)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path())
