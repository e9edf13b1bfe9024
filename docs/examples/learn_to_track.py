"""Learn to follow paths from nothing, in minutes on two cores.

Usage: `python docs/examples/learn_to_track.py [FOLDER]`. An evolution strategy in numpy moves the
weights of a linear policy. It is trained on robots, starts and winding paths that are drawn anew in
each generation, and judged beside the shipped controllers on references that it has never seen, in
the physics of all other programs. The folder gets `policy.json` and `learning.png`.
"""

from __future__ import annotations

import json
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from ssmr.control.law import EMPTY_MEMORY, Observation
from ssmr.control.laws import Controller
from ssmr.control.loop import VELOCITY_PERIOD, LoopSettings
from ssmr.control.mission import ControllerInput, Mission, PythonController
from ssmr.control.waypoints import ALPHA_SWITCH, Errors, Target
from ssmr.types import FloatArray
from validation.experiment.gains import load_gains
from validation.experiment.loops import make_controller, make_robot, run_robots
from validation.experiment.tracked import track_metrics
from validation.experiment.waypoint_files import open_reference
from validation.learning import TrackBatch, TrackTask
from validation.learning.batch import write_view
from validation.learning.episodes import AHEAD_TICKS
from validation.plants.profile import load_profile

ROBOTS = 64
"""Episodes of a generation: 32 pairs of opposite changes of the weights."""
SECONDS = 8.0
"""Length of a training episode [s]."""
NOISE = 0.05
RATE = 0.03
"""Standard deviation of the changes that are tried, and length of a step, both in units of the
scaled weights."""
HELD_OUT = ("eight@0.5", "slalom@0.5", "square@0.5", "u-turn@0.5", "sine@0.5", "circle@0.5")
TASK = TrackTask("thesis-lab", seconds=SECONDS)
RULES = ("pid", "lqr", "mpc")


class Policy:
    """Speed and yaw rate, each linear in numbers that a mirror changes in the same way."""

    def __init__(self, past: int) -> None:
        """Choose the numbers of an observation with `past` commands, and their scales."""
        targets = 2 + 5 * np.arange(len(AHEAD_TICKS))
        commands = 2 + 5 * len(AHEAD_TICKS) + 2 * np.arange(past)
        # speeds, and distances ahead
        self.even = np.concatenate([[0], targets, targets + 3, commands])
        # what has a left and a right
        self.odd = np.concatenate([[1], targets + 1, targets + 2, targets + 4, commands + 1])
        scale = np.full(2 + 5 * len(AHEAD_TICKS) + 2 * past, 0.5)
        scale[targets] = 0.2
        scale[targets + 1] = 0.2
        self._even_scale = 0.5 / scale[self.even]
        self._odd_scale = 0.5 / scale[self.odd]

    @property
    def size(self) -> int:
        """Number of weights."""
        return len(self.even) + len(self.odd)

    def __call__(self, weights: FloatArray, seen: FloatArray) -> FloatArray:
        """Return (S, 2) commands [m/s, rad/s] for (S, n) observations and (S, size) weights."""
        v = np.sum(weights[..., : len(self.even)] * self._even_scale * seen[:, self.even], axis=-1)
        w = np.sum(weights[..., len(self.even) :] * self._odd_scale * seen[:, self.odd], axis=-1)
        return np.stack([v, w], axis=-1)


def episode_rewards(
    batch: TrackBatch, act: Any, seeds: NDArray[np.integer]
) -> tuple[FloatArray, FloatArray]:
    """Return (S,) mean reward of an episode a robot, and its mean distance to the target.

    Lost time counts as 1.1 m.
    """
    for row, seed in enumerate(seeds):
        batch.seed(row, int(seed))
    seen = batch.reset()
    alive = np.ones(len(batch), dtype=bool)
    rewards = np.zeros(len(batch))
    away = np.zeros(len(batch))
    for _ in range(batch.source.most_ticks):
        now = batch.step(act(seen))
        seen = now.observations
        alive &= ~now.lost
        rewards += np.where(alive, now.rewards, 0.0)
        away += np.where(alive, now.away, batch.source.lost)
    return rewards / batch.source.most_ticks, away / batch.source.most_ticks


def learn(
    generations: int, seed: int = 0, every: int = 10
) -> tuple[Policy, FloatArray, list[dict[str, float]]]:
    """Return the policy, its weights, and its history.

    The history has the reward every few generations on 64 episodes that no training saw.
    """
    batch = TrackBatch(TASK, ROBOTS)
    policy = Policy(batch.source.past)
    rng = np.random.default_rng(seed)
    weights = np.zeros(policy.size)
    drift = np.zeros(policy.size)
    size = np.zeros(policy.size)
    fresh = 10**6 + np.arange(ROBOTS)
    history = list[dict[str, float]]()
    began = time.process_time()
    for generation in range(generations + 1):
        if generation % every == 0:
            seconds = time.process_time() - began
            reward, away = (
                float(x.mean()) for x in episode_rewards(batch, partial(policy, weights), fresh)
            )
            history.append(
                {"generation": generation, "reward": reward, "away_m": away, "processor_s": seconds}
            )
            print(
                f"generation {generation:4d}: reward {reward:.3f}, {1e3 * away:5.0f} mm away, "
                f"{seconds:4.0f} s",
                flush=True,
            )
        changes = rng.standard_normal((ROBOTS // 2, policy.size))
        candidates = weights + NOISE * np.concatenate([changes, -changes])
        # both of a pair have the same episode
        seeds = np.tile(rng.integers(10**6, size=ROBOTS // 2), 2)
        measured, _ = episode_rewards(batch, partial(policy, candidates), seeds)
        gain = measured[: ROBOTS // 2] - measured[ROBOTS // 2 :]
        slope = gain @ changes / (np.abs(gain).mean() + 1e-9) / len(changes)
        drift, size = 0.9 * drift + 0.1 * slope, 0.99 * size + 0.01 * slope**2  # Adam
        steps = generation + 1
        step = drift / (1.0 - 0.9**steps) / (np.sqrt(size / (1.0 - 0.99**steps)) + 1e-8)
        weights = weights + RATE * (1.0 - generation / (generations + 1)) * step
    return policy, weights, history


class Learnt:
    """The policy as a controller of this project, which sees what it saw in training."""

    def __init__(self, mission: Mission, policy: Policy, weights: FloatArray, past: int) -> None:
        """Take over a mission."""
        self._mission = mission
        self._policy = policy
        self._weights = weights
        self._sent = np.zeros((past, 2))
        self._seen = np.empty(2 + 5 * len(AHEAD_TICKS) + 2 * past)

    def command(self, now: ControllerInput) -> tuple[float, float]:
        """Return the command."""
        ahead = self._mission.preview(now.seen_at + VELOCITY_PERIOD * np.array(AHEAD_TICKS))
        write_view(now.seen, ahead, self._sent, self._seen)
        drive = self._mission.drive
        command = np.clip(
            self._policy(self._weights, self._seen[None])[0],
            [-drive.v_max, -drive.w_max],
            [drive.v_max, drive.w_max],
        )
        self._sent = np.vstack([self._sent[1:], command])
        return float(command[0]), float(command[1])


def pid_reward(episodes: int = ROBOTS) -> tuple[float, float]:
    """Return reward and distance [m] of the published PID on the episodes of the history."""
    pid = make_controller(load_profile("thesis-lab"), load_gains("pid", "published"))
    assert isinstance(pid, Controller)
    batch = TrackBatch(TASK, episodes)
    memories = [EMPTY_MEMORY] * episodes

    def act(seen: FloatArray) -> FloatArray:
        commands = np.empty((episodes, 2))
        for i, row in enumerate(seen):
            robot = Observation(0.0, 0.0, 0.0, row[0], row[1])
            aim = Target(0.0, 0.0, 0.0, row[5], row[6], 0)
            alpha = row[4] if np.hypot(row[2], row[3]) <= ALPHA_SWITCH else 0.0
            memories[i] = pid.position_step(
                memories[i], Errors(row[2], row[3], alpha), aim, robot, VELOCITY_PERIOD
            )
            memories[i], commands[i] = pid.velocity_step(memories[i], robot, VELOCITY_PERIOD)
        return commands

    reward, away = episode_rewards(batch, act, 10**6 + np.arange(episodes))
    return float(reward.mean()), float(away.mean())


def judge(
    policy: Policy, weights: FloatArray, references: tuple[str, ...] = HELD_OUT, seeds: int = 2
) -> dict[str, dict[str, Any]]:
    """Return metrics of shipped controllers and policy on MuJoCo, by reference and controller."""
    profile = load_profile("thesis-lab")
    past = (policy.size - 2 - 5 * len(AHEAD_TICKS)) // 2
    robot = make_robot(profile, "mujoco")
    laws: dict[str, Any] = {name: make_controller(profile, load_gains(name)) for name in RULES}
    mpc = laws["mpc"]
    laws["learnt"] = PythonController(
        "learnt", lambda m: Learnt(m, policy, weights, past), mpc.a, mpc.b, mpc.drive
    )
    entries: dict[str, dict[str, Any]] = {}
    for reference in references:
        label, waypoints = open_reference(reference)
        entries[label] = {}
        for name, law in laws.items():
            runs = run_robots(
                [robot] * seeds, [law] * seeds, [LoopSettings()] * seeds, waypoints, range(seeds)
            )
            rated = [track_metrics(run, waypoints, robot.limits) for run in runs]
            entries[label][name] = {
                key: float(np.mean([r[key] for r in rated]))
                for key in ("sync_rms_m", "d_rms_m", "command_jerk")
            } | {"lost": any(run.lost for run in runs)}
    return entries


def draw(
    history: list[dict[str, float]],
    pid: tuple[float, float],
    measured: dict[str, dict[str, Any]],
    path: Path,
) -> None:
    """Draw the curve, and the errors on the references that no training saw."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 4.0), layout="constrained")
    left.plot(
        [h["generation"] for h in history],
        [h["reward"] for h in history],
        color="#0072b2",
        label="learnt policy",
    )
    left.axhline(pid[0], color="#d55e00", linestyle="--", label="PID, published gains")
    left.set(
        xlabel="generation of 64 episodes",
        ylabel="mean reward of 64 other episodes",
        ylim=(0.0, 1.0),
        title="Learning",
    )
    left.legend(loc="lower right")
    names = [*RULES, "learnt"]
    width = 0.2
    for k, (name, colour) in enumerate(
        zip(names, ("#d55e00", "#009e73", "#cc79a7", "#0072b2"), strict=True)
    ):
        heights = [1e3 * of[name]["sync_rms_m"] for of in measured.values()]
        right.bar(
            np.arange(len(measured)) + (k - 1.5) * width,
            heights,
            width,
            color=colour,
            label=name if name == "learnt" else name.upper(),
        )
    right.set_xticks(range(len(measured)), list(measured))
    right.set(
        ylabel="RMS distance to the moving target [mm]",
        title="References at 0.5 m/s that no training saw",
    )
    right.set_ylim(0.0, 1.25 * right.get_ylim()[1])
    right.legend(ncols=len(names), loc="upper center")
    figure.savefig(path, dpi=120)
    plt.close(figure)


def main(folder: Path, generations: int = 60) -> dict[str, Any]:
    """Learn, judge, write; return what was found."""
    policy, weights, history = learn(generations)
    pid = pid_reward()
    measured = judge(policy, weights)
    folder.mkdir(parents=True, exist_ok=True)
    out = {"weights": weights.tolist(), "history": history, "pid": pid, "held_out": measured}
    (folder / "policy.json").write_text(json.dumps(out, indent=1), encoding="utf-8")
    draw(history, pid, measured, folder / "learning.png")
    print(f"PID in the same episodes: reward {pid[0]:.3f}, {1e3 * pid[1]:.0f} mm away")
    for reference, of in measured.items():
        print(
            reference,
            *(
                f"{name} {1e3 * m['sync_rms_m']:.0f} mm{' LOST' if m['lost'] else ''}"
                for name, m in of.items()
            ),
            sep="  ",
        )
    return out


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "runs/learning"), *map(int, sys.argv[2:]))
