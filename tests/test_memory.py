"""Too little memory, or too few files, is one line: for the simulator, which has errors of its own, and for programs."""

from __future__ import annotations

import subprocess
import sys

import mujoco
import pytest

from ssmr.errors import SsmrError
from tests.robots import husky
from validation import cli
from validation.simulator.failures import mujoco_failures
from validation.simulator.model import robot_model


@pytest.mark.parametrize("error", [mujoco.FatalError, ValueError])
def test_what_mujoco_cannot_allocate_is_memory(error: type[Exception]) -> None:
    with pytest.raises(MemoryError, match="not enough memory for the simulator"), mujoco_failures():
        raise error("Could not allocate memory")


def test_what_else_mujoco_cannot_do_is_a_failed_run() -> None:
    with pytest.raises(SsmrError, match="mujoco gave up: mj_stackAlloc: insufficient memory"), mujoco_failures():
        raise mujoco.FatalError("mj_stackAlloc:\n insufficient memory")


def test_values_that_are_wrong_stay_wrong() -> None:
    with pytest.raises(ValueError, match="which no rigid body has"):
        robot_model(husky(yaw_inertia=0.1))


SHORT = """
import mujoco, resource
import numpy as np
from validation.plants.profile import load_profile, make_plant
from validation.simulator.health import examine
from validation.simulator.wheel_loads import load_model, resting_loads
from validation.report.looks import looks_of
lab = load_profile("thesis-lab")
plant = make_plant(lab, "mujoco")
kept = [plant, load_model(plant), resting_loads(plant), looks_of(lab.robot)]
kept.append(examine(plant.model, plant.calibration))
size = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (size + 60_000_000, -1))
try:
    while len(kept) < 1000:
        kept.append({kept})
except (mujoco.FatalError, ValueError, RuntimeError, MemoryError):
    pass
said = ""
for _ in range(100):
    try:
        while len(kept) < 3000:  # what the last one could not have may be enough for something smaller
            kept.append({call})
    except MemoryError as error:
        said = str(error)
    if said:
        break
    del kept[-3:]  # Python itself had no memory, outside of the simulator
print(said)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="sizes are told by /proc")
@pytest.mark.parametrize(
    ("kept", "call"),
    [
        ('make_plant(lab, "mujoco")', 'make_plant(lab, "mujoco")'),
        ("mujoco.MjData(plant.model)", "load_model(plant)"),
        ("mujoco.MjData(plant.model)", "examine(plant.model, plant.calibration)"),
        ("mujoco.MjData(plant.model)", "resting_loads(plant)"),
        ("np.ones(500_000)", "looks_of.cache_clear() or looks_of(lab.robot)"),
    ],
)
def test_what_the_simulator_has_no_memory_for_is_said(kept: str, call: str) -> None:
    program = SHORT.format(kept=kept, call=call)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stderr, done.stdout) == (0, "", "there is not enough memory for the simulator\n")


def test_threads_that_cannot_be_started_are_a_failed_run(capsys: pytest.CaptureFixture[str]) -> None:
    def program() -> None:
        raise RuntimeError("can't start new thread")

    with pytest.raises(SystemExit) as left:
        cli.run(program, "it", [])
    assert left.value.code == cli.EXIT_FAILED_RUN
    assert capsys.readouterr().err == "run failed: no more threads can be started; ask for fewer workers\n"


NO_ROOM = "libarrow.so.2600: failed to map segment from shared object"
"""What the system's loader says of a library that does not fit into the address space."""


def test_a_library_that_does_not_fit_into_memory_is_a_failed_run(capsys: pytest.CaptureFixture[str]) -> None:
    def program() -> None:
        raise ImportError(NO_ROOM)

    with pytest.raises(SystemExit) as left:
        cli.run(program, "it", [])
    assert left.value.code == cli.EXIT_FAILED_RUN
    assert capsys.readouterr().err == "run failed: there is not enough memory\n"
