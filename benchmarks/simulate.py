"""Speed of the parts beside what else does the same: `python -m benchmarks.simulate`.

Ratios count, not seconds: machines are shared. Each pair is timed alternately, and the ratio is of
the fastest times.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import mujoco
from mujoco import rollout

from benchmarks.rows import IMPORTS, Pair, Row, report_rows, run_python, time_pairs
from ssmr.lanes import run_population
from ssmr.robot.drive import wheel_references
from ssmr.scenarios import TRAJECTORIES
from ssmr.simulation import SAMPLE_DT, PlanarModel, PlanarPlant
from ssmr.types import FloatArray, State
from validation import cli
from validation.plants.profile import load_profile
from validation.simulator.motors import actuator_inputs
from validation.simulator.plant import MujocoPlant

_POPULATION = 64
_LANES = {"improved": 5.5, "coulomb": 6.5, "linear": 4.2, "kinematic": 5.4}
"""Lanes must be so many times quicker, by model. The linear one is quick by itself and gains
least."""
_STARTS = {"compare --help": "<= 0.95", "compare traj4": "<= 3.9", "track pid line": "<= 3.9"}
_FIRST_STARTS = {"compare traj4": "<= 16", "track pid line": "<= 21"}
"""Programs, and how many times the imports they may take, later and with nothing compiled yet."""
LAB = load_profile("thesis-lab")
COMMANDS = TRAJECTORIES["traj4"].commands()


def _pair_lanes(name: str) -> Pair:
    """Return candidates of a planar model one by one, and in lanes, on one thread."""
    own = LAB.plants[name]
    models = []
    for i in range(_POPULATION):
        late = replace(own.drive, delay_v=0.1 + 0.002 * i, delay_w=0.1 + 0.003 * i)
        models.append(PlanarModel(own.parameters, own.vehicle, late))
    plants = [PlanarPlant(model) for model in models]

    def run_alone() -> list[FloatArray]:
        return [plant.run(COMMANDS, State(), SAMPLE_DT).pose for plant in plants]

    together = partial(run_population, models, COMMANDS, [State()] * _POPULATION, SAMPLE_DT)
    return run_alone, together, f">= {_LANES[name]:g}"


def _pair_mujoco() -> dict[str, Pair]:
    """Return the Husky as a plant beside bare mujoco.rollout of the same model, and the imports."""
    section = LAB.plants["mujoco"]
    plant = MujocoPlant(section.parameters, section.drive)
    control = actuator_inputs(
        plant.model, wheel_references(COMMANDS, section.drive, plant.dt, State())
    )
    data = mujoco.MjData(plant.model)
    start = plant.placed(State())
    run = partial(plant.run, COMMANDS, State(), SAMPLE_DT)
    bare = partial(rollout.rollout, plant.model, data, start[None], control[None])
    return {
        "mujoco plant / bare rollout": (run, bare, "<= 1.1"),
        "trajectory 4 by the mujoco plant / imports": (run, IMPORTS, "<= 0.13"),
    }


def _start_program(words: Sequence[str], folder: str, fresh: bool) -> None:
    """Run a program; a `fresh` one finds nothing compiled."""
    with TemporaryDirectory(dir=folder) as new:
        cache = new if fresh else folder
        out = ("--out", new, "--overwrite")
        run_python("-m", f"validation.{words[0]}", *words[1:], *out, XDG_CACHE_HOME=cache)


def _time_starts() -> list[Row]:
    """Return rows of programs, at their first start and later, beside their libraries' imports."""
    rows = []
    with TemporaryDirectory() as folder:
        for fresh, programs in ((True, _FIRST_STARTS), (False, _STARTS)):
            starts = {}
            for program, asked in programs.items():
                start = partial(_start_program, program.split(), folder, fresh)
                starts[f"{'first ' * fresh}{program} / imports"] = (start, IMPORTS, asked)
            # of first starts, which take long, the second one counts
            rows += time_pairs(starts, 1 if fresh else 3)
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
    pairs = {f"{name}: {_POPULATION} one by one / in lanes": _pair_lanes(name) for name in _LANES}
    rows = time_pairs(pairs | _pair_mujoco(), 1 if quick else repeats)
    if not quick:
        rows += _time_starts()
    report_rows(
        "benchmarks/simulate: ratios of the fastest times, measured side by side", rows, out
    )


if __name__ == "__main__":
    cli.run_command(main, "python -m benchmarks.simulate")
