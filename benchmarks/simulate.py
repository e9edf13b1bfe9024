"""How fast the parts are, beside their peers, all in one run: `python -m benchmarks.simulate [--out FILE.json]`.

Ratios count, not seconds: machines are shared. Each pair is timed alternately, and the ratio is of the fastest times: what
each can do when nobody disturbs it.
The thesis' Simulink times stand there for the record only (another machine, 2019).
"""

from __future__ import annotations

import ctypes
import os
import platform
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import control
import mujoco
import numba
import numpy as np
from mujoco import rollout
from scipy.integrate import solve_ivp
from scipy.spatial import cKDTree

from benchmarks.rows import MissingError, Row, alternate, at_least, at_most, optional, report
from ssmr.errors import SsmrError
from ssmr.lanes import run_population
from ssmr.metrics.declared import compare_paths
from ssmr.metrics.nearest import nearest_squared
from ssmr.models import improved, linear
from ssmr.models.table import PLANAR_MODELS, planar_law
from ssmr.robot.drive import DRIVE_TEMPLATE, drive_numbers, wheel_references
from ssmr.robot.motor import Wanted
from ssmr.robot.vehicle import Drive, Vehicle
from ssmr.scenarios import TRAJECTORIES
from ssmr.simulation import PLANAR_DT, SAMPLE_DT, PlanarModel, PlanarPlant, robot_row
from ssmr.types import Commands, FloatArray, State
from validation import cli
from validation.plants.profile import load_profile
from validation.simulator.model import controls
from validation.simulator.plant import MujocoPlant

LANES = 8
"""Robots of a group in planar.cpp; it divides the population."""
AGREED = 1e-12
"""Greatest difference of a pose between C++ and numba, 20 000 steps long [m, rad]; usually not a bit."""
SIMULINK_S = {"coulomb": 2.75, "improved": 0.70}
"""Sec. 3.6: trajectory 4 on the authors' machine [s]."""
POPULATION = 64


def _fields(numbers: Any) -> str:
    """Return the fields of a named tuple of numbers, and of named tuples of them, as C++ declares them."""
    parts = zip(numbers._fields, numbers, strict=True)
    return " ".join(f"struct {{ {_fields(x)} }} {name};" if isinstance(x, tuple) else f"V {name};" for name, x in parts)


def shared_header() -> str:
    """Return C++ declarations of what both languages share: a driver's numbers, and those of each model's robots."""
    kinds: dict[str, Any] = {"drive": DRIVE_TEMPLATE}
    for name in PLANAR_MODELS:
        kinds[name] = PlanarModel(planar_law(name).parameters(), Vehicle(), Drive()).packed(PLANAR_DT)
    lines = [f"enum {{ LANES = {LANES} }};", "typedef double V __attribute__((vector_size(8 * LANES)));"]
    return "\n".join([*lines, *(f"struct {name}_t {{ {_fields(kind)} }};" for name, kind in kinds.items())]) + "\n"


def compiled(folder: Path, contract: str) -> ctypes.CDLL:
    """Return benchmarks/planar.cpp, compiled in a folder for this processor.

    Args:
        folder: where to compile.
        contract: `off` for the sums of Python, `fast` for products and sums that the compiler rounds once.

    Raises:
        MissingError: there is no g++.
    """
    compiler = shutil.which("g++")
    if compiler is None:
        raise MissingError("g++ is not installed; the benchmark compiles benchmarks/planar.cpp with it")
    (folder / "shared.h").write_text(shared_header(), encoding="utf-8")
    source, target = Path(__file__).with_name("planar.cpp"), folder / f"planar-{contract}.so"
    wide = ["-mprefer-vector-width=512"] if platform.machine() in ("x86_64", "AMD64") else []
    flags = ["-O3", "-march=native", *wide, f"-ffp-contract={contract}", "-shared", "-fPIC"]
    subprocess.run([compiler, *flags, "-I", folder, "-o", target, source], check=True)
    return ctypes.CDLL(str(target))


def in_cpp(library: ctypes.CDLL, models: Sequence[PlanarModel], commands: Commands, out: FloatArray) -> Callable[[], None]:
    """Return a call that drives a population in C++ from rest and writes (S, M, 3) poses. All is packed beforehand."""
    drives = [drive_numbers(m.drive, commands.dt, PLANAR_DT) for m in models]
    rows = np.array([[*d, *robot_row(m.packed(PLANAR_DT))] for d, m in zip(drives, models, strict=True)])
    rows = np.ascontiguousarray(rows.reshape(-1, LANES, rows.shape[1]).swapaxes(1, 2))
    robots, count, steps, stride = map(
        ctypes.c_long, (len(models), commands.n, commands.n * drives[0].period, round(SAMPLE_DT / PLANAR_DT))
    )

    def drive() -> None:
        getattr(library, models[0].name)(
            robots, rows.ctypes, commands.values.ctypes, count, steps, ctypes.c_double(PLANAR_DT), stride, out.ctypes
        )

    return drive


def peer_rows(commands: Commands, repeats: int) -> list[Row]:
    """The improved model by scipy and the linear one by python-control: the usual tools, for the record."""
    profile = load_profile("thesis-lab")
    plants = {
        name: PlanarPlant(
            PlanarModel(profile.plants[name].parameters, profile.plants[name].vehicle, profile.plants[name].drive)
        )
        for name in ("coulomb", "improved", "linear")
    }
    section = profile.plants["improved"]
    references = wheel_references(commands, section.drive, PLANAR_DT, State())
    robot = PlanarModel(section.parameters, section.vehicle, section.drive).packed(PLANAR_DT)

    def rates(t: float, s: np.ndarray) -> np.ndarray:
        reference = references[min(int(t / PLANAR_DT), len(references) - 1)]
        v, w, _, _ = improved.advance(s[3], s[4], Wanted(reference[0], reference[1], 0.0, 0.0), 0.0, PLANAR_DT, robot)
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
    return [
        at_most("improved, whole plant / scipy solve_ivp", mine["improved"], scipy_s),
        at_most("linear, whole plant / control input_output_response", mine["linear"], control_s),
        *(at_most(f"{n}, whole plant / Simulink (thesis)", mine[n], s) for n, s in SIMULINK_S.items()),
    ]


def population_row(commands: Commands, repeats: int) -> Row:
    """64 candidates of the improved model on two threads against one."""
    section = load_profile("thesis-lab").plants["improved"]
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
    return at_least(f"population of {POPULATION}: one thread / two threads", two, one, 1.8)


def _poses_of(plants: Sequence[PlanarPlant], commands: Commands) -> list[FloatArray]:
    return [plant.run(commands, State(), SAMPLE_DT).pose for plant in plants]


def lane_rows(commands: Commands, repeats: int, quick: bool) -> list[Row]:
    """64 candidates of each planar model in numba's lanes, against the same ones one by one and in C++, on one thread.

    Times are the processor's, so that a busy machine hurts them less.

    Raises:
        SsmrError: poses of the lanes differ from those of single robots, or from those in C++.
    """
    rows, most = list[Row](), numba.get_num_threads()
    with tempfile.TemporaryDirectory() as folder:
        libraries = optional(quick, lambda: [compiled(Path(folder), contract) for contract in ("off", "fast")])
        numba.set_num_threads(1)
        try:
            for name in PLANAR_MODELS:
                rows += lane_rows_of(name, commands, repeats, libraries or [])
        finally:
            numba.set_num_threads(most)
    return rows


def lane_rows_of(name: str, commands: Commands, repeats: int, libraries: Sequence[ctypes.CDLL]) -> list[Row]:
    """Return what `lane_rows` says of one model; without libraries nothing of C++."""
    section = load_profile("thesis-lab").plants[name]
    drives = [replace(section.drive, delay_v=0.1 + 0.002 * i, delay_w=0.1 + 0.003 * i) for i in range(POPULATION)]
    models = [PlanarModel(section.parameters, section.vehicle, drive) for drive in drives]
    plants, starts = [PlanarPlant(model) for model in models], [State()] * POPULATION
    together = partial(run_population, models, commands, starts, SAMPLE_DT)
    one_by_one = partial(_poses_of, plants, commands)
    poses = together()
    if not np.array_equal(poses, one_by_one()):
        raise SsmrError(f"{name}: poses in lanes differ from those of single robots")
    if libraries and not hasattr(libraries[0], name):
        cli.warn(f"planar.cpp has no model {name}; it is left out")
        libraries = []
    theirs = np.empty_like(poses)
    limits, apart = [in_cpp(library, models, commands, theirs) for library in libraries], 0.0
    for fused, drive in enumerate(limits):
        drive()
        apart = float(np.abs(theirs - poses).max())
        if not fused and not apart <= AGREED:  # NaN too
            raise SsmrError(f"{name}: C++ and numba disagree by {apart:g}; planar.cpp is out of date")
    lanes, single, *limit = alternate(together, one_by_one, *limits[1:], repeats=repeats, clock=time.process_time)
    what = f"{name}: {POPULATION} robots"
    together_cpp = f"{what} in lanes / in C++ (fused sums, {apart:.0e} apart)"
    return [
        at_least(f"{what} one by one / in lanes", lanes, single, 6.0),
        *(at_most(together_cpp, lanes, cpp) for cpp in limit),
    ]


def mujoco_rows(commands: Commands, repeats: int) -> list[Row]:
    """The Husky as a plant against bare mujoco.rollout of the same model, and against real time."""
    section = load_profile("thesis-lab").plants["mujoco"]
    plant = MujocoPlant(section.parameters, section.drive)
    control = controls(plant.model, wheel_references(commands, section.drive, plant.dt, State()))
    data, start = mujoco.MjData(plant.model), plant.placed(State())
    ours, bare = alternate(
        lambda: plant.run(commands, State(), SAMPLE_DT),
        lambda: rollout.rollout(plant.model, data, start[None], control[None]),
        repeats=repeats,
    )
    real_time = f"mujoco plant, times real time at {plant.dt * 1e3:g} ms"
    return [at_most("mujoco plant / bare rollout", ours, bare, 1.1), at_least(real_time, ours, commands.duration, 60.0)]


def metric_rows(commands: Commands, repeats: int) -> list[Row]:
    """All metrics of one run against simulating it."""
    profile = load_profile("thesis-lab")
    plants = [
        PlanarPlant(PlanarModel(s.parameters, s.vehicle, s.drive))
        for s in (profile.plants["improved"], profile.plants["coulomb"])
    ]
    one, other = (p.run(commands, State(), SAMPLE_DT) for p in plants)
    measured, simulated = alternate(
        lambda: compare_paths(one, other), lambda: plants[0].run(commands, State(), SAMPLE_DT), repeats=repeats
    )
    return [at_most("all metrics of a 20 s run / simulating it (improved)", measured, simulated, 0.5), nearest_row(repeats)]


def nearest_row(repeats: int) -> Row:
    """The search for nearest samples on a long log whose localiser jumps, against scipy's tree."""
    rng = np.random.default_rng(0)
    yaw = np.cumsum(rng.normal(0.0, 0.02, 100_000))
    path = np.cumsum(0.01 * np.column_stack([np.cos(yaw), np.sin(yaw)]), axis=0)
    path[50_000:] += 200.0
    points = path + rng.normal(0.0, 0.02, path.shape)
    ours, tree = alternate(
        lambda: nearest_squared(points, path), lambda: cKDTree(path).query(points), repeats=min(repeats, 5)
    )
    return at_most("nearest samples of 100 000 poses with a jump / scipy's KD-tree", ours, tree, 2.0)


def main(out: Path = Path("runs/benchmarks/simulate.json"), repeats: int = 31, quick: bool = False) -> None:
    """Time every part beside its peer; print the ratios and write them as JSON.

    Args:
        out: JSON file to write.
        repeats: Number of times that each pair is timed; the fastest counts.
        quick: Time each pair once and leave out the slow peers: a check that everything runs.
    """
    if repeats < 1:
        raise cli.UserError(f"--repeats {repeats} must be positive")
    commands = TRAJECTORIES["traj4"].commands()
    often = 1 if quick else repeats
    few = 1 if quick else max(3, repeats // 3)
    rows = [
        *([] if quick else peer_rows(commands, repeats)),
        population_row(commands, few),
        *lane_rows(commands, few, quick),
        *mujoco_rows(commands, few),
        *metric_rows(commands, often),
    ]
    report("benchmarks/simulate: ratios of the fastest times, measured side by side", rows, out)


if __name__ == "__main__":
    cli.run(main, "python -m benchmarks.simulate")
