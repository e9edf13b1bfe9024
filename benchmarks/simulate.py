"""How fast the parts are, beside their peers, all in one run: `python -m benchmarks.simulate [--out FILE.json]`.

Ratios count, not seconds: machines are shared. Each pair is timed alternately, and the ratio is of the fastest times: what
each can do when nobody disturbs it.
The thesis' Simulink times stand there for the record only (another machine, 2019).
"""

from __future__ import annotations

import ctypes
import itertools
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import control
import mujoco
import numba
import numpy as np
from mujoco import rollout
from scipy.integrate import solve_ivp
from scipy.spatial import cKDTree

from benchmarks.rows import MissingError, Row, alternate, optional, report
from ssmr.errors import SsmrError
from ssmr.lanes import run_population
from ssmr.metrics.declared import compare_paths
from ssmr.metrics.paths import nearest_squared
from ssmr.models import improved, linear
from ssmr.models.law import PlanarRobot
from ssmr.models.table import PLANAR_MODELS, planar_law
from ssmr.robot.drive import wheel_references
from ssmr.robot.motor import Wanted
from ssmr.robot.vehicle import Vehicle
from ssmr.scenarios import TRAJECTORIES
from ssmr.simulation import (
    PLANAR_DT,
    SAMPLE_DT,
    PlanarModel,
    PlanarMotion,
    PlanarPlant,
    run_planar,
)
from ssmr.types import Commands, FloatArray, State
from validation import cli
from validation.plants.kind import PlantProfile
from validation.plants.profile import load_profile
from validation.simulator.composing import add_integral_parts, compose_robot
from validation.simulator.description import WHEELS
from validation.simulator.model import calibrate, controls, robot_model, set_motors
from validation.simulator.plant import MujocoPlant

COLUMNS = 13
"""Numbers of a step, as the compiled loops write them."""
AGREED = 1e-9
"""Greatest difference of a number between C and numba, 20 000 steps long [m, rad, m/s, N m, ...]."""
SIMULINK_S = {"coulomb": 2.75, "improved": 0.70}
"""Sec. 3.6: trajectory 4 on the authors' machine [s]."""
POPULATION = 64
SAME_PATH, SAME_LOADS = 5e-5, 5e-3
"""Greatest distance between the paths of two settings of physics [m], and greatest root mean square difference of a wheel's
load over its load at rest [1]."""


def shared_header() -> str:
    """Return C declarations of what both languages share: models, their numbers, and the columns of a step."""
    lines = [f"enum {{ {', '.join(name.upper() for name in PLANAR_MODELS)} }};", f"enum {{ COLUMNS = {COLUMNS} }};"]
    lines.append(f"static const double LOAD_SUM = {linear.LOAD_SUM!r};")
    kinds = {"vehicle": Vehicle, **{name: planar_law(name).parameters for name in PLANAR_MODELS}}
    lines += [
        f"typedef struct {{ double {', '.join(f.name for f in fields(kind))}; }} {name}_t;" for name, kind in kinds.items()
    ]
    return "\n".join(lines) + "\n"


def compile_c(folder: Path) -> ctypes.CDLL:
    """Return benchmarks/planar.c, compiled by gcc -O3 in a folder.

    Raises:
        MissingError: there is no gcc.
    """
    gcc = shutil.which("gcc")
    if gcc is None:
        raise MissingError("gcc is not installed; the benchmark compiles benchmarks/planar.c with it")
    (folder / "shared.h").write_text(shared_header(), encoding="utf-8")
    source, target = Path(__file__).with_name("planar.c"), folder / "planar.so"
    subprocess.run([gcc, "-O3", "-shared", "-fPIC", "-I", folder, "-o", target, source, "-lm"], check=True)
    library = ctypes.CDLL(str(target))
    library.simulate.restype = ctypes.c_double
    return library


def simulate_in_c(library: ctypes.CDLL, name: str, robot: PlanarRobot, references: FloatArray, out: FloatArray) -> float:
    """Drive a planar model by the loop in C.

    It writes (n, COLUMNS) numbers and returns the last yaw [rad], or NaN where planar.c has no such model.
    """
    vehicle, parameters = np.array(robot.vehicle), np.array(robot.parameters)
    return float(
        library.simulate(
            ctypes.c_int(PLANAR_MODELS.index(name)), ctypes.c_long(len(references)), references.ctypes,
            ctypes.c_double(PLANAR_DT), vehicle.ctypes, parameters.ctypes, ctypes.c_double(robot.motor.limit), out.ctypes,
        )
    )  # fmt: skip


def simulate_in_numba(robot: PlanarRobot, references: FloatArray, out: FloatArray) -> None:
    """Drive a planar model by the compiled loop; it writes (1 + n, COLUMNS) numbers."""
    run_planar(references, np.zeros(1), PLANAR_DT, 1, robot, PlanarMotion(0.0, 0.0, 0.0, 0.0, 0.0), out)


def planar_rows(commands: Commands, repeats: int) -> list[Row]:
    """Time each planar model against the same loop in C; both write the same numbers of every step.

    Raises:
        SsmrError: the numbers differ.
    """
    profile, rows = load_profile("thesis-lab"), []
    with tempfile.TemporaryDirectory() as folder:
        library = compile_c(Path(folder))
        for name in PLANAR_MODELS:
            section = profile.plants[name]
            references = wheel_references(commands, section.drive, PLANAR_DT, State())
            mine, theirs = np.empty((1 + len(references), COLUMNS)), np.empty((len(references), COLUMNS))
            robot = PlanarModel(section.parameters, section.vehicle, section.drive).packed(PLANAR_DT)
            in_numba = partial(simulate_in_numba, robot, references, mine)
            in_c = partial(simulate_in_c, library, name, robot, references, theirs)
            if np.isnan(in_c()):
                cli.warn(f"planar.c has no model {name}; it is left out")
                continue
            ours, peer = alternate(in_numba, in_c, repeats=repeats)
            difference = float(np.abs(mine[1:] - theirs).max())
            if difference > AGREED:
                raise SsmrError(f"{name}: C and numba disagree by {difference:g}; planar.c is out of date")
            rows.append(Row(f"{name}, 20 s at 1 ms / C", ours / peer, "<= 1.5", ours, peer, ours <= 1.5 * peer))
    return rows


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
    return Row(f"population of {POPULATION}: one thread / two threads", one / two, ">= 1.8", two, one, one >= 1.8 * two)


def _poses_of(plants: Sequence[PlanarPlant], commands: Commands) -> list[FloatArray]:
    return [plant.run(commands, State(), SAMPLE_DT).pose for plant in plants]


def lane_rows(commands: Commands, repeats: int) -> list[Row]:
    """64 candidates of each planar model side by side in lanes against the same ones, one by one, on one thread.

    Raises:
        SsmrError: the poses differ by a bit.
    """
    profile, rows, most = load_profile("thesis-lab"), [], numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        for name in PLANAR_MODELS:
            section = profile.plants[name]
            drives = [replace(section.drive, delay_v=0.1 + 0.002 * i, delay_w=0.1 + 0.003 * i) for i in range(POPULATION)]
            models = [PlanarModel(section.parameters, section.vehicle, drive) for drive in drives]
            plants, starts = [PlanarPlant(model) for model in models], [State()] * POPULATION
            together = partial(run_population, models, commands, starts, SAMPLE_DT)
            one_by_one = partial(_poses_of, plants, commands)
            if not np.array_equal(together(), one_by_one()):
                raise SsmrError(f"{name}: poses in lanes differ from those of single robots")
            lanes, single = alternate(together, one_by_one, repeats=repeats)
            rows.append(
                Row(
                    f"{name}: {POPULATION} robots one by one / in lanes",
                    single / lanes,
                    ">= 6",
                    lanes,
                    single,
                    single >= 6 * lanes,
                )
            )
    finally:
        numba.set_num_threads(most)
    return rows


def former_model(section: PlantProfile) -> mujoco.MjModel:
    """Return the robot as version 1.0 simulated it: with its looks, all sensors, islands, and Newton's method."""
    robot = section.parameters.robot
    root = compose_robot(robot)
    if section.drive.integral_gain > 0.0:
        add_integral_parts(root, robot)
    root.worldbody.add("geom", name="ground", type="plane", size=[0, 0, 0.05], condim=3)
    model = mujoco.MjModel.from_xml_string(root.to_xml_string())
    calibrate(model, section.parameters)
    set_motors(model, section.parameters, section.drive)
    return model


def step_row(commands: Commands, repeats: int) -> Row:
    """A step of the Husky's physics against one with the settings of version 1.0, MuJoCo's stopwatch among them.

    Raises:
        SsmrError: the paths or the wheel loads differ.
    """
    section = load_profile("thesis-lab").plants["mujoco"]
    plant, former = MujocoPlant(section.parameters, section.drive), former_model(section)
    start = plant.placed(State())
    steps = wheel_references(commands, section.drive, plant.dt, State())
    data = {id(model): mujoco.MjData(model) for model in (plant.model, former)}
    stopped = mujoco.get_mjcb_time()

    def roll(model: mujoco.MjModel) -> tuple[FloatArray, FloatArray]:
        mujoco.set_mjcb_time(stopped if model is plant.model else None)
        states, sensors = rollout.rollout(model, data[id(model)], start[None], controls(model, steps)[None])
        columns = [int(model.sensor(f"load_{wheel}").adr[0]) for wheel in WHEELS]
        return states[0, :, 1:3], sensors[0][:, columns]

    try:
        (path, loads), (former_path, former_loads) = roll(plant.model), roll(former)
        now, then = alternate(lambda: roll(plant.model), lambda: roll(former), repeats=repeats)
    finally:
        mujoco.set_mjcb_time(stopped)
    apart = float(np.abs(path - former_path).max())
    shaken = float((np.sqrt(np.mean((loads - former_loads) ** 2, axis=0)) / former_loads[0]).max())
    if apart > SAME_PATH or shaken > SAME_LOADS:
        raise SsmrError(f"paths differ by {1e3 * apart:.3f} mm and loads by {100 * shaken:.2f} % from version 1.0's")
    return Row("mujoco step: settings of version 1.0 / now", then / now, ">= 1.7", now, then, then >= 1.7 * now)


def candidate_row(repeats: int) -> Row:
    """Another candidate of a fit against what it cost before: a model, its state, and a second of settling."""
    section = load_profile("thesis-lab").plants["mujoco"]
    plant = MujocoPlant(section.parameters, section.drive)
    others = itertools.cycle([replace(section.parameters, friction=friction) for friction in (0.4, 0.5)])

    def former() -> None:
        calibration = next(others)
        model = robot_model(calibration, drive=section.drive)
        mujoco.mj_step(model, mujoco.MjData(model), nstep=round(1.0 / calibration.timestep))

    now, then = alternate(lambda: plant.renumber(next(others), section.drive), former, repeats=5 * repeats)
    return Row("mujoco candidate: built and settled / renumbered", then / now, ">= 5", now, then, then >= 5.0 * now)


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
    speed = commands.duration / ours
    return [
        step_row(commands, repeats),
        candidate_row(repeats),
        Row("mujoco plant / bare rollout", ours / bare, "<= 1.1", ours, bare, ours <= 1.1 * bare),
        Row(
            f"mujoco plant, times real time at {plant.dt * 1e3:g} ms", speed, ">= 60", ours, commands.duration, speed >= 60.0
        ),
    ]


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
    return [
        Row(
            "all metrics of a 20 s run / simulating it (improved)",
            measured / simulated,
            "<= 0.5",
            measured,
            simulated,
            measured <= 0.5 * simulated,
        ),
        nearest_row(repeats),
    ]


def nearest_row(repeats: int) -> Row:
    """The search for nearest samples on a long log whose localiser jumps, against scipy's tree."""
    rng = np.random.default_rng(0)
    yaw = np.cumsum(rng.normal(0.0, 0.02, 100_000))
    path = np.cumsum(0.01 * np.column_stack([np.cos(yaw), np.sin(yaw)]), axis=0)
    path[50_000:] += 200.0
    points = path + rng.normal(0.0, 0.02, path.shape)
    longest = float(np.hypot(*np.diff(path, axis=0).T).max())
    ours, tree = alternate(
        lambda: nearest_squared(points, path, longest), lambda: cKDTree(path).query(points), repeats=min(repeats, 5)
    )
    return Row(
        "nearest samples of 100 000 poses with a jump / scipy's KD-tree", ours / tree, "<= 2", ours, tree, ours <= 2 * tree
    )


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
    rows = optional(quick, lambda: planar_rows(commands, often)) or []
    rows += [] if quick else peer_rows(commands, repeats)
    rows += [
        population_row(commands, few),
        *lane_rows(commands, few),
        *mujoco_rows(commands, few),
        *metric_rows(commands, often),
    ]
    report("benchmarks/simulate: ratios of the fastest times, measured side by side", rows, out)


if __name__ == "__main__":
    cli.run(main, "python -m benchmarks.simulate")
