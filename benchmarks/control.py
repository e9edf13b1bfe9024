"""Cost of closed loops and of learning episodes, on one thread: `python -m benchmarks.control`."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import mujoco
import numpy as np
from mujoco import rollout

from benchmarks.rows import Row, alternate, imports, ratio, report
from ssmr.control.loop import LoopSettings
from ssmr.control.population import run_bodies, run_loops
from ssmr.control.references import circle
from ssmr.simulation import PlanarModel
from ssmr.types import State
from validation import cli
from validation.experiment.gains import load_gains
from validation.experiment.loops import make_controller, make_robot
from validation.learning import TrackBatch, TrackTask
from validation.plants.profile import load_profile
from validation.simulator.bodies import MujocoBodies
from validation.simulator.motors import controls
from validation.simulator.plant import MujocoPlant


def _loop_rows(repeats: int, robots: int) -> list[Row]:
    """Time closed loops of pid: improved beside the imports, MuJoCo beside rollouts."""
    profile = load_profile("thesis-lab")
    law = make_controller(profile, load_gains("pid", "published"))
    settings = LoopSettings()
    body, plant = (make_robot(profile, name).body for name in ("improved", "mujoco"))
    assert isinstance(body, PlanarModel)
    assert isinstance(plant, MujocoPlant)
    way = circle(0.5)
    short = circle(0.5, 1.5, 0.25)
    laws = [law] * robots
    loops = [settings] * robots
    run_planar = partial(run_loops, [body] * robots, laws, loops, way, range(4))
    (planar,) = alternate(run_planar, repeats=repeats)

    def bodies(state: State) -> MujocoBodies:
        return MujocoBodies([plant] * robots, 1, state)

    drives = [plant.drive] * robots
    close = partial(
        run_bodies, bodies, drives, plant.dt, laws, loops, waypoints=short, seeds=range(4)
    )
    run = close()[0]
    ticks = round(float(run.t[-1]) / plant.dt) // (len(run.t) - 1)
    set_points = np.repeat(run.table[:-1, 6:8], ticks, axis=0)
    control = np.repeat(controls(plant.model, set_points)[None], robots, axis=0)
    start = np.repeat(plant.placed(short.start)[None], robots, axis=0)
    data = mujoco.MjData(plant.model)
    roll_out = partial(rollout.rollout, plant.model, data, start, control)
    closed, opened = alternate(close, roll_out, repeats=repeats)
    return [
        ratio(f"{robots} circles by pid, improved / imports", planar, imports(), most=0.13),
        ratio(f"{robots} closed loops on MuJoCo / open-loop rollouts", closed, opened, most=1.2),
    ]


def _follow_targets(batch: TrackBatch) -> None:
    """Drive one episode in every row, from its beginning, towards where the target will be."""
    seen = batch.reset()
    for _ in range(batch.source.most_ticks):
        # The target's twist in 0.2 s, and two of its errors now.
        commands = seen[:, [10, 11]] + 1.5 * seen[:, [2, 3]]
        seen = batch.step(commands).observations


def _episode_row(repeats: int, robots: int, seconds: float) -> Row:
    """Time episodes of many robots, their beginnings included."""
    batch = TrackBatch(TrackTask(seconds=seconds), robots, 1)
    for row in range(robots):
        batch.seed(row, row)
    (episodes,) = alternate(partial(_follow_targets, batch), repeats=repeats)
    ticks = robots * batch.source.most_ticks
    return ratio(f"{ticks} ticks of episodes / imports", episodes, imports(), most=5.2)


def main(
    out: Path = Path("runs/benchmarks/control.json"), repeats: int = 5, quick: bool = False
) -> None:
    """Time closed loops and episodes; print the ratios and write them as JSON.

    Args:
        out: JSON file to write.
        repeats: Number of times that each is timed; the fastest counts.
        quick: Time small populations once: a check that everything runs.
    """
    if quick:
        rows = [*_loop_rows(1, 2), _episode_row(1, 4, 1.0)]
    else:
        rows = [*_loop_rows(repeats, 64), _episode_row(repeats, 64, 20.0)]
    report("benchmarks/control: ratios of the fastest processor times", rows, out)


if __name__ == "__main__":
    cli.run(main, "python -m benchmarks.control")
