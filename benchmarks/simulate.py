"""How fast the parts are, beside their peers, all in one run: `python -m benchmarks.simulate [--out FILE.json]`.

Ratios count, not seconds: machines are shared. Each pair is timed alternately, and the ratio is of the fastest times: what
each can do when nobody disturbs it.
The thesis' Simulink times stand there for the record only (another machine, 2019).
"""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import control
import mujoco
import numba
import numpy as np
from mujoco import rollout
from scipy.integrate import solve_ivp

from benchmarks.rows import Row, alternate, report
from ssmr.metrics.paths import compare_paths
from ssmr.models import improved, linear
from ssmr.models.table import PLANAR_MODELS
from ssmr.robot.drive import Sides, wheel_references
from ssmr.scenarios import TRAJECTORIES
from ssmr.simulate import (
    PLANAR_DT,
    SAMPLE_DT,
    PlanarModel,
    PlanarMotion,
    PlanarPlant,
    run_planar,
    run_population,
)
from ssmr.types import Commands, State
from validation import cli
from validation.plants.profile import load
from validation.robots.plant import MujocoPlant

SIMULINK_S = {"coulomb": 2.75, "improved": 0.70}
"""Sec. 3.6: trajectory 4 on the authors' machine [s]."""
POPULATION = 64


def compile_c(folder: Path) -> ctypes.CDLL:
    """benchmarks/planar.c by gcc -O3.

    Raises:
        UserError: there is no gcc.
    """
    gcc = shutil.which("gcc")
    if gcc is None:
        raise cli.UserError("gcc is not installed; the benchmark compiles benchmarks/planar.c with it")
    source, target = Path(__file__).with_name("planar.c"), folder / "planar.so"
    subprocess.run([gcc, "-O3", "-shared", "-fPIC", "-o", target, source, "-lm"], check=True)
    library = ctypes.CDLL(str(target))
    library.simulate.restype = ctypes.c_double
    return library


def planar_rows(commands: Commands, repeats: int) -> list[Row]:
    """Each planar model against the same loop in C; both write the same thirteen numbers of every step."""
    profile, rows = load("thesis-lab"), []
    with tempfile.TemporaryDirectory() as folder:
        library = compile_c(Path(folder))
        for name in PLANAR_MODELS:
            section = profile.plants[name]
            references = wheel_references(commands, section.drive, PLANAR_DT, State())
            kind, robot = PLANAR_MODELS.index(name), PlanarModel(section.parameters, section.vehicle, section.drive).packed()
            vehicle, limit = np.array(robot.vehicle), robot.side_limit
            parameters = np.zeros(5)
            parameters[: len(robot.parameters)] = robot.parameters
            mine, theirs = np.empty((1 + len(references), 13)), np.empty((len(references), 13))

            def in_c(
                kind=kind, references=references, vehicle=vehicle, parameters=parameters, limit=limit, theirs=theirs
            ) -> None:
                library.simulate(
                    ctypes.c_int(kind), ctypes.c_long(len(references)), references.ctypes, ctypes.c_double(PLANAR_DT),
                    vehicle.ctypes, parameters.ctypes, ctypes.c_double(limit), theirs.ctypes,
                )  # fmt: skip

            def in_numba(references=references, robot=robot, mine=mine) -> None:
                run_planar(references, np.zeros(1), PLANAR_DT, 1, robot, PlanarMotion(0.0, 0.0, 0.0, 0.0, 0.0), mine)

            ours, peer = alternate(in_numba, in_c, repeats=repeats)
            difference = float(np.abs(mine[1:] - theirs).max())
            if difference > 1e-9:
                raise cli.UserError(f"{name}: C and numba disagree by {difference}; planar.c is out of date")
            rows.append(Row(f"{name}, 20 s at 1 ms / C", ours / peer, "<= 1.5", ours, peer, ours <= 1.5 * peer))
    return rows


def peer_rows(commands: Commands, repeats: int) -> list[Row]:
    """The improved model by scipy and the linear one by python-control: the usual tools, for the record."""
    profile = load("thesis-lab")
    plants = {
        name: PlanarPlant(
            PlanarModel(profile.plants[name].parameters, profile.plants[name].vehicle, profile.plants[name].drive)
        )
        for name in ("coulomb", "improved", "linear")
    }
    section = profile.plants["improved"]
    references = wheel_references(commands, section.drive, PLANAR_DT, State())
    robot = PlanarModel(section.parameters, section.vehicle, section.drive).packed()

    def rates(t: float, s: np.ndarray) -> np.ndarray:
        reference = references[min(int(t / PLANAR_DT), len(references) - 1)]
        v, w, _, _ = improved.advance(s[3], s[4], Sides(*reference), 0.0, PLANAR_DT, robot)
        return np.array([s[3] * np.cos(s[2]), s[3] * np.sin(s[2]), s[4], (v - s[3]) / PLANAR_DT, (w - s[4]) / PLANAR_DT])

    system = linear.state_space(section.vehicle, profile.plants["linear"].parameters, section.drive)
    t = np.arange(len(references)) * PLANAR_DT
    held = np.repeat(commands.values, 50, axis=0)
    start = State()
    scipy_s, control_s = alternate(
        lambda: solve_ivp(rates, (0.0, t[-1]), np.zeros(5), max_step=0.05, rtol=1e-3),
        lambda: control.input_output_response(system, t, held.T, solve_ivp_kwargs={"max_step": 0.05}),
        repeats=1,
    )
    mine = dict(
        zip(
            plants,
            alternate(*(lambda p=p: p.run(commands, start, SAMPLE_DT) for p in plants.values()), repeats=repeats),
            strict=True,
        )
    )
    rows = [
        Row("improved, whole plant / scipy solve_ivp", mine["improved"] / scipy_s, "", mine["improved"], scipy_s, True),
        Row(
            "linear, whole plant / control input_output_response",
            mine["linear"] / control_s,
            "",
            mine["linear"],
            control_s,
            True,
        ),
    ]
    return rows + [
        Row(f"{n}, whole plant / Simulink (thesis)", mine[n] / s, "", mine[n], s, True) for n, s in SIMULINK_S.items()
    ]


def population_row(commands: Commands, repeats: int) -> Row:
    """64 candidates of the improved model on two threads against one."""
    section = load("thesis-lab").plants["improved"]
    models = [
        PlanarModel(replace(section.parameters, gain=60.0 + i), section.vehicle, section.drive) for i in range(POPULATION)
    ]

    def on(threads: int) -> None:
        numba.set_num_threads(threads)
        run_population(models, commands, [State()] * len(models), SAMPLE_DT)

    most = numba.get_num_threads()
    try:
        two, one = alternate(lambda: on(min(2, most)), lambda: on(1), repeats=repeats)
    finally:
        numba.set_num_threads(most)
    return Row(f"population of {POPULATION}: one thread / two threads", one / two, ">= 1.8", two, one, one >= 1.8 * two)


def mujoco_rows(commands: Commands, repeats: int) -> list[Row]:
    """The Husky as a plant against bare mujoco.rollout of the same model, and against real time."""
    section = load("thesis-lab").plants["mujoco"]
    plant = MujocoPlant(section.parameters, section.drive)
    references = wheel_references(commands, section.drive, plant.dt, State())
    data = mujoco.MjData(plant.model)
    start = np.empty(mujoco.mj_stateSize(plant.model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    plant.reset(State())
    mujoco.mj_getState(plant.model, plant._data, start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    ours, bare = alternate(
        lambda: plant.run(commands, State(), SAMPLE_DT),
        lambda: rollout.rollout(plant.model, data, start[None], references[None]),
        repeats=repeats,
    )
    speed = commands.duration / ours
    return [
        Row("mujoco plant / bare rollout", ours / bare, "<= 1.1", ours, bare, ours <= 1.1 * bare),
        Row(
            f"mujoco plant, times real time at {plant.dt * 1e3:g} ms", speed, ">= 60", ours, commands.duration, speed >= 60.0
        ),
    ]


def metric_rows(commands: Commands, repeats: int) -> list[Row]:
    """All metrics of one run against simulating it."""
    profile = load("thesis-lab")
    plants = [
        PlanarPlant(PlanarModel(s.parameters, s.vehicle, s.drive))
        for s in (profile.plants["improved"], profile.plants["coulomb"])
    ]
    one, other = (p.run(commands, State(), SAMPLE_DT) for p in plants)
    measured, simulated = alternate(
        lambda: compare_paths(one, other), lambda: plants[0].run(commands, State(), SAMPLE_DT), repeats=repeats
    )
    return [
        Row(
            "all metrics of a 20 s run / simulating it (improved)",
            measured / simulated,
            "<= 0.5",
            measured,
            simulated,
            measured <= 0.5 * simulated,
        )
    ]


def main(out: Path = Path("runs/benchmarks/simulate.json"), repeats: int = 31) -> None:
    """Time every part beside its peer; print the ratios and write them as JSON.

    Args:
        out: Where the JSON goes.
        repeats: How often each pair is timed; the fastest counts.
    """
    if repeats < 1:
        raise cli.UserError(f"--repeats {repeats} must be positive")
    commands = TRAJECTORIES["traj4"].commands()
    rows = [
        *planar_rows(commands, repeats),
        *peer_rows(commands, repeats),
        population_row(commands, max(3, repeats // 3)),
        *mujoco_rows(commands, max(3, repeats // 3)),
        *metric_rows(commands, repeats),
    ]
    report("benchmarks/simulate: ratios of the fastest times, measured side by side", rows, out)


if __name__ == "__main__":
    cli.run(main, "python -m benchmarks.simulate")
