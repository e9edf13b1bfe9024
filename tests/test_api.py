"""The Python API.

Every exported name is there, no name hides another, and importing costs next to nothing.
"""

from __future__ import annotations

import importlib
import inspect
import json
import math
import pickle
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import ssmr
import validation
from validation import load_profile
from validation.compare import compare
from validation.fit import fit
from validation.track import track
from validation.tune import tune

PACKAGES = ("ssmr", "validation")
PROCESSOR_TIME = 0.3
"""Greatest processor time of an import [s]."""


@pytest.mark.parametrize("package", PACKAGES)
def test_every_exported_name_resolves(package: str) -> None:
    module = importlib.import_module(package)
    assert module.__all__
    assert set(module.__all__) <= set(dir(module))
    for name in module.__all__:
        exported = getattr(module, name)
        assert callable(exported) or not isinstance(exported, ModuleType), (
            f"{package}.{name} is hidden by a module"
        )


@pytest.mark.parametrize("package", PACKAGES)
def test_an_import_is_quick_and_loads_no_engine(package: str) -> None:
    program = (
        f"import time, sys; import {package}; "
        "print(time.process_time(), *{'numba', 'mujoco', 'scipy'} & set(sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    spent, *loaded = done.stdout.split()
    assert float(spent) < PROCESSOR_TIME
    assert not loaded


def test_a_comparison_in_python_pays_for_no_picture_and_no_recording() -> None:
    program = (
        "import sys; from validation.compare import compare; "
        "print(*{'scipy.optimize', 'scipy.stats'} & set(sys.modules)); "
        "compare('traj4', plants=('improved',)); "
        "print(*{'matplotlib', 'rerun', 'pandas', 'pyarrow'} & set(sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert not done.stdout.split()


def test_a_program_imports_nothing_for_files_that_nobody_wants(tmp_path: Path) -> None:
    program = (
        "import sys; from validation.compare import compare; "
        "sys.argv = ['compare', *'traj2 --plants linear --reference linear'.split(), '--no-rerun',"
        f" '--no-picture', '--out', {str(tmp_path)!r}]; compare.main(); "
        "print('loaded', *{'matplotlib', 'rerun', 'pandas', 'pyarrow'} & set(sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "loaded"
    assert [path.name for path in tmp_path.iterdir()] == ["compare.json"]
    assert json.loads((tmp_path / "compare.json").read_text())["files"] == []


def test_results_and_profiles_can_be_pickled() -> None:
    lab = load_profile("thesis-lab")
    small = {"generations": 1, "population": 6}
    results = (
        validation.compare("traj4", lab, plants="linear", reference="improved"),
        track("pid", "circle", profile=lab, plant="linear"),
        fit("linear", "traj4@linear", profile=lab, search="jde", **small),
        tune("lqr", "circle@0.5", lab, plant=("linear",), held_out=(), **small),
    )
    assert pickle.loads(pickle.dumps(lab)).as_dict() == lab.as_dict()  # noqa: S301 - our own
    for result in results:
        copied = pickle.loads(pickle.dumps(result))  # noqa: S301 - our own
        assert str(copied.table()) == str(result.table())


@pytest.mark.parametrize("name", ["calibrate", "compare", "fit", "track", "tune"])
def test_help_has_every_option_once_and_what_it_means(name: str) -> None:
    program = getattr(validation, name)
    for option in inspect.signature(program).parameters:
        meanings = re.findall(rf"^    {option}: \w.*", program.__doc__, re.MULTILINE)
        assert len(meanings) == 1, option


def test_a_program_promises_only_what_its_options_take() -> None:
    by_address = validation.fit.options("linear", "traj4", workers="tcp://127.0.0.1:8786")
    assert by_address.workers == "tcp://127.0.0.1:8786"
    with pytest.raises(ValueError, match="workers"):
        validation.compare.options("traj4", workers="tcp://127.0.0.1:8786")
    says = {name: getattr(validation, name).__doc__ for name in ("fit", "compare", "track")}
    assert [name for name, text in says.items() if "scheduler" in text] == ["fit"]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ssmr.State(x=math.nan), r"State\.x must be a finite number"),
        (
            lambda: ssmr.Commands(0.05, np.zeros((2, 2)), before=(math.nan, 0.0)),
            "must be two finite numbers",
        ),
        (
            lambda: compare("traj4", profile={}),
            r"profile is {}, wanted Profile \| str \| Path \| None",
        ),
        (lambda: track("pid", "circle", seed=1.5), r"seed is 1\.5, wanted int"),
    ],
)
def test_wrong_values_are_refused_by_name(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
