"""The Python API: every exported name is there, no name hides another, and importing costs next to nothing."""

from __future__ import annotations

import importlib
import subprocess
import sys
from types import ModuleType

import pytest

PACKAGES = ("ssmr", "validation")
PROCESSOR_TIME = 0.3
"""Greatest processor time of an import [s]."""


@pytest.mark.parametrize("package", PACKAGES)
def test_every_exported_name_resolves(package: str) -> None:
    module = importlib.import_module(package)
    assert module.__all__
    assert set(module.__all__) <= set(dir(module))
    for name in module.__all__:
        assert not isinstance(getattr(module, name), ModuleType), f"{package}.{name} is hidden by a module"


@pytest.mark.parametrize("package", PACKAGES)
def test_an_import_is_quick_and_loads_no_engine(package: str) -> None:
    program = (
        f"import time, sys; import {package}; print(time.process_time(), *{{'numba', 'mujoco', 'scipy'}} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    spent, *loaded = done.stdout.split()
    assert float(spent) < PROCESSOR_TIME
    assert not loaded
