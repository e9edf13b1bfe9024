"""Speed of the parts beside what else does the same: `python -m benchmarks.simulate`.

Ratios count, not seconds: machines are shared. Each pair is timed alternately, and the ratio is of
the fastest times.
"""

from __future__ import annotations

import os
from dataclasses import replace
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import mujoco
import numpy as np
from mujoco import rollout

from benchmarks.rows import Row, alternate, ratio, report
from ssmr.errors import SsmrError
from ssmr.lanes import run_population
from ssmr.models.law import PLANAR_MODELS
from ssmr.robot.drive import wheel_references
from ssmr.scenarios import TRAJECTORIES
from ssmr.simulation import SAMPLE_DT, PlanarModel, PlanarPlant
from ssmr.types import Commands, FloatArray, State
from validation import cli
from validation.plants.profile import load_profile
from validation.simulator.motors import controls
from validation.simulator.plant import MujocoPlant

POPULATION = 64
LAB = load_profile("thesis-lab")


def planar(name: str) -> PlanarModel:
    """Return a planar model with the lab's numbers."""
    section = LAB.plants[name]
    return PlanarModel(section.parameters, section.vehicle, section.drive)


def lane_row(name: str, commands: Commands, repeats: int) -> Row:
    """Drive 64 candidates of a planar model one by one and in lanes, on one thread.

    Raises:
        SsmrError: the poses differ.
    """
    drive = LAB.plants[name].drive
    models = []
    for i in range(POPULATION):
        late = replace(drive, delay_v=0.1 + 0.002 * i, delay_w=0.1 + 0.003 * i)
        models.append(replace(planar(name), drive=late))
    plants = [PlanarPlant(model) for model in models]
    together = partial(run_population, models, commands, [State()] * POPULATION, SAMPLE_DT)

    def alone() -> list[FloatArray]:
        return [plant.run(commands, State(), SAMPLE_DT).pose for plant in plants]

    if not np.array_equal(together(), alone()):
        raise SsmrError(f"{name}: poses in lanes differ from those of single robots")
    lanes, single = alternate(together, alone, repeats=repeats)
    return ratio(f"{name}: {POPULATION} robots one by one / in lanes", single, lanes, least=6.0)


def mujoco_rows(commands: Commands, repeats: int) -> list[Row]:
    """Return rows of the Husky as a plant, bare mujoco.rollout of the same model, and real time."""
    section = LAB.plants["mujoco"]
    plant = MujocoPlant(section.parameters, section.drive)
    control = controls(plant.model, wheel_references(commands, section.drive, plant.dt, State()))
    data = mujoco.MjData(plant.model)
    start = plant.placed(State())
    ours, bare = alternate(
        lambda: plant.run(commands, State(), SAMPLE_DT),
        lambda: rollout.rollout(plant.model, data, start[None], control[None]),
        repeats=repeats,
    )
    real_time = ratio("real time / mujoco plant", commands.duration, ours, least=60.0)
    return [ratio("mujoco plant / bare rollout", ours, bare, most=1.1), real_time]


def main(
    out: Path = Path("runs/benchmarks/simulate.json"), repeats: int = 10, quick: bool = False
) -> None:
    """Time every part beside its peer; print the ratios and write them as JSON.

    Args:
        out: JSON file to write.
        repeats: Number of times that each pair is timed; the fastest counts.
        quick: Time each pair once: a check that everything runs.
    """
    if repeats < 1:
        raise ValueError(f"--repeats {repeats} must be positive")
    commands = TRAJECTORIES["traj4"].commands()
    often = 1 if quick else repeats
    rows = [lane_row(name, commands, often) for name in PLANAR_MODELS]
    rows += mujoco_rows(commands, often)
    report("benchmarks/simulate: ratios of the fastest times, measured side by side", rows, out)


if __name__ == "__main__":
    cli.run(main, "python -m benchmarks.simulate")
