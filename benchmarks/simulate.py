"""Speed of the parts beside what else does the same: `python -m benchmarks.simulate`.

Ratios count, not seconds: machines are shared. Each pair is timed alternately, and the ratio is of
the fastest times.
"""

from __future__ import annotations

import os
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import mujoco
import numpy as np
from mujoco import rollout

from benchmarks.rows import Row, alternate, imports, ratio, report, spent
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

_POPULATION = 64
_LANES = {"improved": 5.5, "coulomb": 6.5, "linear": 4.2, "kinematic": 5.4}
"""Lanes must be so many times quicker, by model. The linear one is quick by itself and gains
least."""
_STARTS = (
    ("compare --help", 0.0, 0.95),
    ("compare traj4", 16.0, 3.9),
    ("track pid line", 21.0, 3.9),
)
"""Programs, and how many times the imports their first and later starts may take."""
LAB = load_profile("thesis-lab")


def planar(name: str) -> PlanarModel:
    """Return a planar model with the lab's numbers."""
    section = LAB.plants[name]
    return PlanarModel(section.parameters, section.vehicle, section.drive)


def _lane_row(name: str, commands: Commands, repeats: int) -> Row:
    """Drive 64 candidates of a planar model one by one and in lanes, on one thread.

    Raises:
        SsmrError: the poses differ.
    """
    drive = LAB.plants[name].drive
    models = []
    for i in range(_POPULATION):
        late = replace(drive, delay_v=0.1 + 0.002 * i, delay_w=0.1 + 0.003 * i)
        models.append(replace(planar(name), drive=late))
    plants = [PlanarPlant(model) for model in models]
    together = partial(run_population, models, commands, [State()] * _POPULATION, SAMPLE_DT)

    def alone() -> list[FloatArray]:
        return [plant.run(commands, State(), SAMPLE_DT).pose for plant in plants]

    if not np.array_equal(together(), alone()):
        raise SsmrError(f"{name}: poses in lanes differ from those of single robots")
    lanes, single = alternate(together, alone, repeats=repeats)
    what = f"{name}: {_POPULATION} robots one by one / in lanes"
    return ratio(what, single, lanes, least=_LANES[name])


def _mujoco_rows(commands: Commands, repeats: int) -> list[Row]:
    """Return rows of the Husky as a plant beside bare mujoco.rollout of the same model."""
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
    alone = ratio("trajectory 4 by the mujoco plant / imports", ours, imports(), most=0.13)
    return [ratio("mujoco plant / bare rollout", ours, bare, most=1.1), alone]


def _start_rows() -> list[Row]:
    """Return rows of programs, at their first start and later, beside their libraries' imports."""
    rows = list[Row]()
    with TemporaryDirectory() as folder:
        for program, at_first, most in _STARTS:
            name, *arguments = program.split()
            command = ("-m", f"validation.{name}", *arguments, "--out", folder, "--overwrite")
            times = []
            for _ in range(4):
                times.append(spent(*command, XDG_CACHE_HOME=f"{folder}/{name}"))
            if at_first:
                rows.append(ratio(f"first {program} / imports", times[0], imports(), at_first))
            rows.append(ratio(f"{program} / imports", min(times), imports(), most))
    return rows


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
    rows = [_lane_row(name, commands, often) for name in PLANAR_MODELS]
    rows += _mujoco_rows(commands, often)
    if not quick:
        rows += _start_rows()
    report("benchmarks/simulate: ratios of the fastest times, measured side by side", rows, out)


if __name__ == "__main__":
    cli.run(main, "python -m benchmarks.simulate")
