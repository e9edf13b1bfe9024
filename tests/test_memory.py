"""Too little memory is one line: for the simulator, which has errors of its own, and for a whole program."""

from __future__ import annotations

import subprocess
import sys

import mujoco
import pytest

from ssmr.errors import SsmrError
from validation import cli
from validation.robots.failures import mujoco_failures
from validation.robots.husky import HuskyCalibration, husky_model


@pytest.mark.parametrize("error", [mujoco.FatalError, ValueError])
def test_what_mujoco_cannot_allocate_is_memory(error: type[Exception]) -> None:
    with pytest.raises(MemoryError, match="not enough memory for the simulator"), mujoco_failures():
        raise error("Could not allocate memory")


def test_what_else_mujoco_cannot_do_is_a_failed_run() -> None:
    with pytest.raises(SsmrError, match="mujoco gave up: mj_stackAlloc: insufficient memory"), mujoco_failures():
        raise mujoco.FatalError("mj_stackAlloc:\n insufficient memory")


def test_values_that_are_wrong_stay_wrong() -> None:
    with pytest.raises(ValueError, match="which no rigid body has"):
        husky_model(HuskyCalibration(yaw_inertia=0.1))


SHORT = """
import resource
from validation.plants.profile import load_profile, make_plant
lab = load_profile("thesis-lab")
kept = [make_plant(lab, "mujoco")]
size = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (size + 60_000_000, -1))
try:
    while len(kept) < 100:
        kept.append(make_plant(lab, "mujoco"))
except MemoryError as error:
    print(error)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="sizes are told by /proc")
def test_robots_that_do_not_fit_into_memory_are_said_to_be_too_many() -> None:
    done = subprocess.run([sys.executable, "-c", SHORT], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stderr, done.stdout) == (0, "", "there is not enough memory for the simulator\n")


def test_a_program_that_cannot_be_loaded_says_so_at_once() -> None:
    command = f"ulimit -v 400000; exec {sys.executable} -m validation.fit linear --to traj4@linear"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert done.stderr == (
        "run failed: there is not enough memory: a limit of 410 MB of address space, at least 550 MB are needed\n"
    )


def test_threads_that_cannot_be_started_are_a_failed_run(capsys: pytest.CaptureFixture[str]) -> None:
    def program() -> None:
        raise RuntimeError("can't start new thread")

    with pytest.raises(SystemExit) as left:
        cli.run(program, "it", [])
    assert left.value.code == cli.EXIT_FAILED_RUN
    assert capsys.readouterr().err == "run failed: no more threads can be started; ask for fewer workers\n"
