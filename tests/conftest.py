"""Tolerances with their reasons, and what every test shares."""

from __future__ import annotations

import contextlib
import gc
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

# read when numpy is imported: threads cost more than small matrices
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# else hundreds of programs that tests start compile all sources anew
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import mujoco
import numpy as np
import pytest
from hypothesis import settings

from ssmr.metrics.declared import METRICS, Metrics
from ssmr.metrics.paths import nearest_squared
from ssmr.types import FloatArray, Plant
from tests.workers import *  # noqa: F403 - pytest's hooks
from validation import cli
from validation.engines.body import EngineMissingError
from validation.files import guarded
from validation.identify import search
from validation.output import shorten_text
from validation.plants.profile import Profile, load_profile, make_plant
from validation.plants.table import ALL_PLANTS
from validation.report.picture import Picture
from validation.simulator.physics import SHIPPED, PhysicsSettings

EXACT = 0.0
"""Bit for bit: repetition, and a fast implementation against its reference."""
ROUNDOFF = 1e-12
"""Relative: algebraic identities in double precision, some tens of operations long."""
SYMMETRY = 1e-8
"""Rollouts that mirror or move the frame: the contact solver stops at 1e-10, a thousand steps
follow; far under any physics."""
DRAKE_SYMMETRY = 1e-5
"""Drake repeats these rollouts less exactly: its solver stops at a relative 1e-6 of the sum of all
momenta, those of wheels at some 5 rad/s among them, and Python cannot set a smaller limit
(SapSolverParameters)."""
DERIVATIVE = 1e-6
"""Relative: central differences with a step of 1e-5 on smooth functions of order one."""

Launch = Callable[..., subprocess.Popen[Any]]
"""What the fixture `launch` is."""

sys.dont_write_bytecode = False
# as programs do: imports and compiling make many objects that stay
gc.set_threshold(50_000, 20, 100)
# pytest-xdist sets it to 80 in its workers, and tables would leave out columns there
os.environ.pop("COLUMNS", None)
# in a script's background; programs inherit that
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# the same examples for everybody
settings.register_profile("repeat", derandomize=True, database=None, deadline=None)
# new ones: pytest --hypothesis-profile=explore
settings.register_profile("explore", max_examples=2000, deadline=None)
settings.load_profile("repeat")


def data_folder() -> Path:
    """Where the real recordings lie: SSMR_DATA, or `shared/data` beside the source tree."""
    return Path(
        os.environ.get("SSMR_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")
    )


@cache
def _profile(name: str) -> Profile:
    return load_profile(name)


@pytest.fixture(scope="session")
def lab() -> Profile:
    """The profile of the lab's robot."""
    return _profile("thesis-lab")


@pytest.fixture(autouse=True)
def strict_arithmetic() -> Iterator[None]:
    """Numpy raises where it would warn."""
    with np.errstate(divide="raise", invalid="raise", over="raise"):
        yield


@pytest.fixture
def launch() -> Iterator[Launch]:
    """Starts processes as `subprocess.Popen` does.

    However the test ends, they are killed and their pipes closed.
    """
    with contextlib.ExitStack() as left:

        def start(command: Sequence[str], **options: Any) -> subprocess.Popen[Any]:
            process = left.enter_context(subprocess.Popen(command, **options))
            left.callback(process.kill)
            return process

        yield start


@pytest.fixture
def hangup() -> Iterator[None]:
    """SIGHUP ends programs, as it usually does: under nohup they inherit that it is ignored."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


def answer_here(
    function: Callable[..., guarded.Answer], arguments: Sequence[Any], allowance: object
) -> guarded.Answer:
    """Return the answer of a function that is called in this process, where users have a child."""
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr("tempfile.tempdir", folder)
        patch.setattr("resource.setrlimit", lambda *_: None)
        try:
            answer, parts = function(*json.loads(json.dumps(arguments)))
        except Exception as error:
            raise ValueError(shorten_text(error, 200) or type(error).__name__) from error
        finally:
            mujoco.set_mju_user_warning(None)
    return json.loads(json.dumps(answer)), [bytes(part) for part in parts]


@pytest.fixture
def with_children() -> None:
    """Let a child process with limits read foreign files, as it does for users."""


@pytest.fixture
def with_drawings() -> None:
    """Pictures have pixels, as they have for users."""


@pytest.fixture(autouse=True)
def without_the_dear(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Foreign files are read in this process, and pictures stay white, unless a test asks for more.

    To start a child takes longer than what it reads, and to draw longer than what a program does.
    """
    if "with_children" not in request.fixturenames:
        monkeypatch.setattr(guarded, "ask", answer_here)
    if "with_drawings" not in request.fixturenames:
        monkeypatch.setattr(Picture, "draw", lambda *_: None)


def keep_one_start(patch: pytest.MonkeyPatch) -> None:
    """Let searches by least squares begin at one place."""
    starts = {method: min(most, 1) for method, most in search.STARTS_OF.items()}
    patch.setattr(search, "STARTS_OF", starts)


@pytest.fixture
def one_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """Searches by least squares begin at one place: where they end is another test's question."""
    keep_one_start(monkeypatch)


def installed_plant(profile: Profile, name: str, settings: PhysicsSettings = SHIPPED) -> Plant:
    """The plant of that name.

    A test of an engine that is not installed skips with the line that says how to get it.
    """
    try:
        return make_plant(profile, name, settings=settings)
    except EngineMissingError as error:
        pytest.skip(str(error))


@pytest.fixture(params=ALL_PLANTS)
def make(request: pytest.FixtureRequest, lab: Profile) -> Callable[[], Plant]:
    """A maker of each plant in turn, with the lab's numbers."""
    return lambda: installed_plant(lab, request.param)


@pytest.fixture(params=ALL_PLANTS)
def make_exact(request: pytest.FixtureRequest, lab: Profile) -> Callable[[], Plant]:
    """A maker of each plant in turn, MuJoCo's with a solver that is exact.

    The shipped one is held to it elsewhere.
    """
    return lambda: installed_plant(lab, request.param, PhysicsSettings(solver="Newton"))


def read_only(numbers: FloatArray) -> FloatArray:
    """Numbers that nobody writes to, as results have them: kernels are compiled for no others."""
    kept = np.ascontiguousarray(numbers).view()
    kept.setflags(write=False)
    return kept


def distances_to_path(xy: FloatArray, path: FloatArray) -> FloatArray:
    """The (M,) distances [m] of (M, 2) places from the segments of an (N, 2) polyline."""
    return np.sqrt(nearest_squared(read_only(xy), read_only(path)))


def processor_time() -> float:
    """Time of the processor that this process and its children that ended have used [s]."""
    return sum(os.times()[:4])


def exit_status(program: Any, *arguments: str) -> int:
    """The exit status of a program that runs in this process.

    Starting another one takes longer than what it does.
    """
    try:
        cli.run_command(program, "program", arguments)
    except SystemExit as left:
        return int(left.code or 0)
    return 0


def metrics_of(*values: float) -> Metrics:
    """Metrics of paths with these values, in the order of their table."""
    return Metrics(zip(METRICS, values, strict=True))
