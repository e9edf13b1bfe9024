"""What closed loops cost: `python -m benchmarks.control [--out FILE.json]`.

- Closed loops around the improved model, as a population, in multiples of real time on one core; and the slow loop beside.
- A population of 64 closed loops on MuJoCo beside the same robots' open-loop rollouts of equal length.
- The whole budget of Tab. 4.3 (100 candidates, 150 generations) on the generic reference, from a part of it.
"""

from __future__ import annotations

import os
import time
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import mujoco
import numba
import numpy as np
from mujoco import rollout

from benchmarks.rows import Row, alternate, at_least, at_most, report
from ssmr.control.laws import Controller
from ssmr.control.loop import LoopSettings, run_loop
from ssmr.control.population import Loop, run_loops
from ssmr.control.references import circle
from ssmr.simulation import PlanarModel, PlanarPlant
from validation import cli
from validation.plants.profile import load_profile
from validation.simulator.loops import run_husky_loops
from validation.simulator.model import controls
from validation.simulator.plant import MujocoPlant
from validation.track.gains import load_gains
from validation.track.loops import make_controller, make_robot
from validation.track.waypoint_files import open_reference
from validation.tune.cost import TuneCost
from validation.tune.problem import TuneCase, TuneProblem, make_tuning_space

POPULATION = 64
BUDGET = 100 * 150
"""Candidates that Tab. 4.3 rates."""
ASKED_REAL_TIME = 2000.0
ASKED_OVERHEAD = 1.3


def planar_rows(repeats: int, population: int) -> list[Row]:
    """Time closed loops of the improved model on one core."""
    profile = load_profile("thesis-lab")
    robot = make_robot(profile, "improved")
    assert isinstance(robot.body, PlanarModel)
    waypoints, body = circle(0.5), robot.body
    rows = list[Row]()
    for controller, gains in (("pid", "published"), ("lqr", "published")):
        law = make_controller(profile, load_gains(controller, gains))
        loops = [Loop(body, law, LoopSettings())] * population
        numba.set_num_threads(1)
        (ours,) = alternate(partial(run_loops, loops, waypoints, range(4)), repeats=repeats)
        simulated = population * waypoints.duration
        rows.append(at_least(f"{controller}: times real time on one core", ours, simulated, ASKED_REAL_TIME))
        if population < POPULATION:
            continue  # the slow loop is left out of a quick run
        began = time.perf_counter()
        assert isinstance(law, Controller)  # none of those above is a Python object
        run_loop(PlanarPlant(body), law, waypoints, LoopSettings(), 0)
        slow = time.perf_counter() - began
        rows.append(at_most(f"{controller}: fused loop over the slow one", ours / population, slow))
    return rows


def mujoco_rows(repeats: int, workers: int, population: int) -> list[Row]:
    """A population of closed loops on MuJoCo beside open-loop rollouts of the same robots."""
    profile = load_profile("thesis-lab")
    robot = make_robot(profile, "mujoco")
    plant = robot.body
    assert isinstance(plant, MujocoPlant)
    waypoints = circle(0.5, 1.5, 0.25)
    law = make_controller(profile, load_gains("pid", "published"))
    loops = [plant] * population, [law] * population, [LoopSettings()] * population
    run = partial(run_husky_loops, *loops, waypoints, range(4), workers)
    runs = run()
    n = round(float(runs[0].t[-1]) / plant.dt)
    references = np.repeat(runs[0].table[:-1, 6:8], n // (len(runs[0].t) - 1), axis=0)
    control = np.repeat(controls(plant.model, references)[None], population, axis=0)
    start = np.repeat(plant.placed(waypoints.start)[None], population, axis=0)
    datas = [mujoco.MjData(plant.model) for _ in range(workers)]
    closed, opened = alternate(
        run,
        lambda: rollout.rollout(plant.model, datas, start, control),
        repeats=repeats,
    )
    what = f"{population} closed loops on MuJoCo over open-loop rollouts"
    return [at_most(what, closed, opened, ASKED_OVERHEAD)]


def budget_rows(workers: int, candidates: int) -> list[Row]:
    """Tab. 4.3's budget on the generic reference, extrapolated from two smaller generations."""
    profile = load_profile("thesis-lab")
    label, waypoints = open_reference("generic", 0.25)
    case = TuneCase(label, label, waypoints, make_robot(profile, "improved"), LoopSettings())
    space = make_tuning_space("pid", None, False, {})
    problem = TuneProblem(profile, load_gains("pid", "published"), space, (case,), TuneCost(guard=0.0))
    points = np.random.default_rng(0).random((candidates, len(space)))
    (once,) = alternate(lambda: problem.costs(points, None, workers), repeats=2)
    minutes = once * BUDGET / len(points) / 60.0
    return [Row(f"Tab. 4.3: {BUDGET} evaluations, minutes on {workers} cores", minutes, "", once, once, True)]


def main(out: Path = Path("runs/benchmarks/control.json"), repeats: int = 7, workers: int = 0, quick: bool = False) -> None:
    """Time closed loops beside real time and beside open-loop rollouts; print the ratios and write them as JSON.

    Args:
        out: JSON file to write.
        repeats: Number of times that each is timed; the fastest counts.
        workers: Threads; all cores if 0.
        quick: Time small populations once and leave out the slow loop: a check that everything runs.
    """
    if repeats < 1 or workers < 0:
        raise cli.UserError("--repeats must be positive, --workers must not be negative")
    threads = workers or os.cpu_count() or 1
    often, population, candidates = (1, 2, 4) if quick else (repeats, POPULATION, 100)
    rows = [*planar_rows(often, population), *mujoco_rows(often, threads, population), *budget_rows(threads, candidates)]
    report("benchmarks/control: fastest times, measured side by side", rows, out)


if __name__ == "__main__":
    cli.run(main, "python -m benchmarks.control")
