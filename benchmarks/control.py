"""Cost of closed loops and of learning episodes, on one thread: `python -m benchmarks.control`."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import mujoco
import numpy as np
from mujoco import rollout

from benchmarks.rows import IMPORTS, Pair, report_rows, time_pairs
from ssmr.control.loop import LoopSettings
from ssmr.control.references import circle
from validation import cli
from validation.experiment.gains import load_gains
from validation.experiment.loops import make_controller, make_robot, run_robots
from validation.learning import TrackBatch, TrackTask
from validation.plants.profile import load_profile
from validation.simulator.motors import actuator_inputs
from validation.simulator.plant import MujocoPlant


def _pair_loops(robots: int) -> dict[str, Pair]:
    """Return closed loops of pid: improved beside the imports, MuJoCo beside rollouts."""
    profile = load_profile("thesis-lab")
    law = make_controller(profile, load_gains("pid", "published"))
    planar, simulated = (make_robot(profile, name) for name in ("improved", "mujoco"))
    common = ([law] * robots, [LoopSettings()] * robots)
    run_planar = partial(run_robots, [planar] * robots, *common, circle(0.5), range(4), 1)
    short = circle(0.5, 1.5, 0.25)
    close = partial(run_robots, [simulated] * robots, *common, short, range(4), 1)
    plant = simulated.body
    assert isinstance(plant, MujocoPlant)
    run = close()[0]
    ticks = round(run.t[-1] / plant.dt) // (len(run.t) - 1)
    set_points = np.repeat(run.table[:-1, 6:8], ticks, axis=0)
    control = np.repeat(actuator_inputs(plant.model, set_points)[None], robots, axis=0)
    start = np.repeat(plant.placed(short.start)[None], robots, axis=0)
    data = mujoco.MjData(plant.model)
    roll_out = partial(rollout.rollout, plant.model, data, start, control)
    return {
        f"{robots} circles by pid, improved / imports": (run_planar, IMPORTS, "<= 0.13"),
        f"{robots} closed loops on MuJoCo / open-loop rollouts": (close, roll_out, "<= 1.2"),
    }


def _follow_targets(batch: TrackBatch) -> None:
    """Drive one episode in every row, from its beginning, towards where the target will be."""
    seen = batch.reset()
    for _ in range(batch.source.most_ticks):
        # The target's twist in 0.2 s, and two of its errors now.
        commands = seen[:, [10, 11]] + 1.5 * seen[:, [2, 3]]
        seen = batch.step(commands).observations


def _pair_episodes(robots: int, seconds: float) -> dict[str, Pair]:
    """Return episodes of many robots, their beginnings included, beside the imports."""
    batch = TrackBatch(TrackTask(seconds=seconds), robots, 1)
    for row in range(robots):
        batch.seed(row, row)
    return {
        f"{robots * batch.source.most_ticks} ticks of episodes / imports": (
            partial(_follow_targets, batch),
            IMPORTS,
            "<= 5.2",
        )
    }


def main(
    out: Path = Path("runs/benchmarks/control.json"), repeats: int = 5, quick: bool = False
) -> None:
    """Time closed loops and episodes; print the ratios and write them as JSON.

    Args:
        out: JSON file to write.
        repeats: Number of times that each is timed; the fastest counts.
        quick: Time small populations once: a check that everything runs.
    """
    loops = 2 if quick else 64
    episodes = (4, 1.0) if quick else (64, 20.0)
    pairs = _pair_loops(loops) | _pair_episodes(*episodes)
    rows = time_pairs(pairs, 1 if quick else repeats)
    report_rows("benchmarks/control: ratios of the fastest processor times", rows, out)


if __name__ == "__main__":
    cli.run_command(main, "python -m benchmarks.control")
