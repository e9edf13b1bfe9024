"""Frozen numbers of each program, which a rebuilding of the house must leave alone.

A file `tests/golden/NAME.json` holds a command line, and every number that the program then writes,
by its place in the files. It is at once the list of cases: for a new one, write a file with its
`command` alone, and `"slow": true` if it takes seconds, `"needs": "ode"` if it needs a library. In
a command, {out} is an empty folder, {data} the real recordings, {golden} the folder of these files;
without recordings, their cases skip. What a program writes besides does not matter; a number that
is missing fails.

A golden number changes only with its reason in the commit. This makes files anew, all of them where
none is named; with `--spread` the numbers stay, and only their spread is measured anew:

    python -m tests.test_golden [--spread] NAME...
"""

from __future__ import annotations

import csv
import json
import math
import os
import platform
import runpy
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from ctypes.util import find_library
from importlib.metadata import version
from pathlib import Path
from typing import Any
from unittest import mock

import llvmlite.binding as llvm
import pytest
from matplotlib.figure import Figure

from ssmr.robot.vehicle import Vehicle
from tests.conftest import data_folder

GOLDEN = Path(__file__).parent / "golden"
SAME = 1e-9
"""Least relative tolerance: far above rounding, and far under any change of the physics. What is
less than FLOOR is zero but for rounding."""
FLOOR = 1e-15
MOST_SPREADS = 30.0
"""Tolerance of a number over its spread: the greatest deviation that was seen between builds for
different processors (BUILDS), of the number itself or, relative to it, of its siblings. So a number
is held as well as its conditioning allows. Three builds are a small sample of all processors, and
what swings as contacts do has long tails."""
ELSEWHERE = 1e-2
"""Relative tolerance with other versions of the libraries."""
WITHOUT_WIDE_VECTORS = {
    "NUMBA_CPU_FEATURES": "-avx512",
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F,-AVX512VL",
    "OPENBLAS_CORETYPE": "Haswell",
}
WITHOUT_FUSED_PRODUCTS = {
    "NUMBA_CPU_NAME": "generic",
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F",
    "OPENBLAS_CORETYPE": "Nehalem",
}
BUILDS: Mapping[str, Mapping[str, str]] = {
    "as here": {},
    "without wide vectors": WITHOUT_WIDE_VECTORS,
    "without fused products": WITHOUT_FUSED_PRODUCTS,
}
"""Environments in which numba, numpy, BLAS and the library of sines compute as on processors with
less than this one has."""

FROZEN_WORDS = {"schema", "status", "verdict", "model", "controller", "engine", "plant", "best"}
"""Keys whose words are frozen too; other words are prose, names and paths."""
LEFT_OUT = {
    "wall_s",
    "cpu_s",
    "cost_s",
    "step_s",
    "real_time_factor",
    "versions",
    "options",
    "config",
    "settings",
    "limits",
    "published",
    "vehicle",
    "drive",
    "localiser",
    "provenance",
    "train_by_source",
    "spread",
    "supposed_spread",
}
"""Keys of what is timed or installed, of what is handed in, and of what other numbers tell too."""
MOST_ITEMS = 12
"""Greatest number of members of a list that are all frozen; of longer ones the sum and some
five."""


def _thinned(values: Sequence[Any]) -> Mapping[str, Any]:
    """The numbers of a list by their index.

    Of a long one the number of them, the sum and some five.
    """
    if len(values) <= MOST_ITEMS:
        return {str(i): value for i, value in enumerate(values)}
    usable = [float(v) for v in values if isinstance(v, int | float) and math.isfinite(v)]
    some = {str(i): values[i] for i in range(0, len(values), len(values) // 4)}
    return {"count": len(values), "sum": math.fsum(usable), **some}


def _by_name(rows: Sequence[Any]) -> Mapping[str, Any]:
    """The members of a list by their words where these differ, so that rows do not move others.

    Of a long list of other rows the columns, which are thinned in their turn.
    """
    tables = [row for row in rows if isinstance(row, dict)]
    names = [" ".join(word for word in row.values() if isinstance(word, str)) for row in tables]
    if len({*names}) == len(rows) > 1:
        return dict(zip(names, rows, strict=True))
    if len(tables) == len(rows) > MOST_ITEMS:
        return {f"column {key}": [row.get(key) for row in tables] for key in tables[0]}
    return _thinned(rows)


def _flat(value: Any, path: tuple[str, ...]) -> Iterator[tuple[str, Any]]:
    """The numbers in what a JSON or TOML file holds, each with its path."""
    if isinstance(value, dict | list):
        for key, inner in (value if isinstance(value, dict) else _by_name(value)).items():
            if key not in LEFT_OUT:
                yield from _flat(inner, (*path, key))
    elif not isinstance(value, str) or path[-1] in FROZEN_WORDS:
        yield "/".join(path), value


def _table(text: str, delimiter: str) -> Mapping[str, list[float]]:
    """The columns of a table of numbers by name, or by number where it has no header."""
    rows = [
        row
        for row in csv.reader(text.splitlines(), delimiter=delimiter)
        if row and not row[0].startswith("#")
    ]
    names = [str(k) for k in range(len(rows[0]))] if delimiter == " " else rows.pop(0)
    return {name: [float(row[k] or "nan") for row in rows] for k, name in enumerate(names)}


READERS: Mapping[str, Callable[[str], Any]] = {
    ".json": json.loads,
    ".toml": tomllib.loads,
    ".csv": lambda text: _table(text, ","),
    ".tum": lambda text: _table(text, " "),
}
"""What reads a file, by its ending."""


def said_by(command: Sequence[str], out: Path) -> dict[str, Any]:
    """The numbers of a command line, which is run in this process."""
    program, *arguments = (
        word.format(out=out, data=data_folder(), golden=GOLDEN) for word in command
    )
    status = 0
    with (
        mock.patch.object(sys, "argv", [program, *arguments]),
        # drawing takes most of the time of a short program
        mock.patch.object(Figure, "draw", return_value=None),
    ):
        try:
            runpy.run_module(f"validation.{program}", run_name="__main__", alter_sys=True)
        except SystemExit as left:
            status = int(left.code or 0)
    numbers: dict[str, Any] = {"exit status": status}
    for path in sorted(out.iterdir()):
        if path.suffix in READERS:
            numbers.update(
                _flat(
                    READERS[path.suffix](path.read_text()),
                    () if path.suffix == ".json" else (path.name,),
                )
            )
    # titles have the paths of recordings, which lie elsewhere on each machine
    folder = str(data_folder())
    return {name.replace(folder, "{data}"): numbers[name] for name in sorted(numbers)}


def made_on() -> str:
    """Return the machine and the versions of libraries that numbers depend on."""
    versions = (f"{name} {version(name)}" for name in ("mujoco", "numpy", "scipy", "numba"))
    return ", ".join([platform.machine(), " ".join(platform.libc_ver()), *versions])


def _is_number(value: Any) -> bool:
    return isinstance(value, float | int) and not isinstance(value, bool)


def _spread_of(golden: Mapping[str, Any], built: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the deviations of builds that matter, two digits each; null of what is not settled.

    That is a word, a count or a missing number which is not the same in all builds.
    """
    spread: dict[str, Any] = {}
    for key, number in golden.items():
        found = [numbers.get(key) for numbers in built]
        if all(other == found[0] for other in found):
            continue
        usual = all(map(_is_number, found)) and not isinstance(number, int)
        if not usual or not all(map(math.isfinite, found)):
            if not all(_is_number(n) and math.isnan(n) for n in found):
                spread[key] = None
            continue
        # between builds: a number that is no longer what programs say widens nothing
        deviation = max(found) - min(found)
        if MOST_SPREADS * deviation > max(FLOOR, SAME * abs(number)):
            spread[key] = float(f"{deviation:.1e}")
    return spread


def _tolerances(case: Mapping[str, Any]) -> dict[str, float]:
    """Return the tolerance of each number of a case; infinite where nothing is settled."""
    numbers = case["numbers"]
    spread = case.get("spread", {})
    relative: dict[str, float] = {}
    for key, deviation in spread.items():
        size = abs(float(numbers[key])) if deviation is not None else 0.0
        if size > FLOOR:
            parent = key.rpartition("/")[0]
            relative[parent] = max(relative.get(parent, 0.0), min(deviation / size, 1.0))
    known = case["made_on"] == made_on()
    out = {}
    for key, number in numbers.items():
        if key in spread and spread[key] is None:
            out[key] = math.inf
            continue
        if not _is_number(number):
            out[key] = 0.0
            continue
        size = abs(float(number)) if math.isfinite(number) else 0.0
        share = SAME if known else ELSEWHERE
        least = max(FLOOR, share * size)
        of_siblings = relative.get(key.rpartition("/")[0], 0.0) * size
        out[key] = max(least, MOST_SPREADS * max(of_siblings, spread.get(key, 0.0)))
    return out


def _agree(golden: Any, measured: Any, tolerance: float) -> bool:
    """Whether numbers agree within a tolerance, or words, truth values or nothings are equal."""
    if math.isinf(tolerance):
        return bool(measured != "nothing")
    if _is_number(golden) and _is_number(measured):
        both_missing = math.isnan(golden) and math.isnan(measured)
        return both_missing or golden == measured or abs(golden - measured) <= tolerance
    return bool(golden == measured)


def _cases() -> Iterator[Any]:
    for path in sorted(GOLDEN.glob("*.json")):
        case = json.loads(path.read_text())
        yield pytest.param(case, id=path.stem, marks=[pytest.mark.slow] if case.get("slow") else [])


@pytest.mark.parametrize("case", list(_cases()))
def test_program_says_the_same_numbers(
    case: Mapping[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if any("{data}" in word for word in case["command"]) and not data_folder().exists():
        pytest.skip(f"there are no recordings in {data_folder()}")
    if "needs" in case and find_library(case["needs"]) is None:
        pytest.skip(f"the library {case['needs']} is not installed")
    monkeypatch.chdir(tmp_path)
    measured = said_by(case["command"], tmp_path)
    golden = case["numbers"]
    tolerances = _tolerances(case)
    different = [
        f"{key}: golden {number}, found {measured.get(key, 'nothing')}, "
        f"which may differ by {tolerances[key]:.1e}"
        for key, number in golden.items()
        if not _agree(number, measured.get(key, "nothing"), tolerances[key])
    ]
    if different:
        pytest.fail(
            f"{len(different)} of {len(golden)} numbers differ:\n"
            + "\n".join(different[:MOST_ITEMS]),
            pytrace=False,
        )


def test_numbers_are_held_as_well_as_their_conditioning_allows() -> None:
    golden = {"run/a": 1.0, "run/b": 0.5, "other/c": 2.0, "run/n": 3, "other/word": "best"}
    built = [{**golden, "run/a": 1.0 + 1e-7}, {**golden, "run/n": 4}]
    spread = _spread_of(golden, built)
    assert spread == {"run/a": 1e-7, "run/n": None}
    limits = _tolerances({"numbers": golden, "spread": spread, "made_on": made_on()})
    assert limits["run/a"] == pytest.approx(30e-7)
    assert limits["run/b"] == pytest.approx(15e-7), "a sibling is conditioned alike"
    assert limits["other/c"] == 2.0 * SAME
    assert limits["run/n"] == math.inf
    assert limits["other/word"] == 0.0
    assert not _agree("best", "worst", 0.0)
    assert not _agree(2.0, "nothing", math.inf)


@pytest.mark.parametrize("name", ["compare-traj4", "track-ekf"])
def test_a_change_of_physics_by_a_millionth_is_seen(name: str, tmp_path: Path) -> None:
    """Wheels of another radius roll further by as much."""
    case = json.loads((GOLDEN / f"{name}.json").read_text())
    original = Vehicle.__post_init__

    def grow_wheels(vehicle: Vehicle) -> None:
        original(vehicle)
        object.__setattr__(vehicle, "wheel_radius", vehicle.wheel_radius * (1.0 + 1e-6))

    with mock.patch.object(Vehicle, "__post_init__", grow_wheels):
        found = said_by(case["command"], tmp_path)
    limits = _tolerances(case)
    golden = case["numbers"]
    moved = [key for key in golden if not _agree(golden[key], found.get(key), limits[key])]
    assert len(moved) > 10, moved


def numbers_of(names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the numbers of cases by name, of this process' build."""
    found = {}
    for name in names:
        case = json.loads((GOLDEN / f"{name}.json").read_text())
        with tempfile.TemporaryDirectory() as folder:
            found[name] = said_by(case["command"], Path(folder))
    return found


def in_build(settings: Mapping[str, str], names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the numbers of cases by name, of another build."""
    with tempfile.TemporaryDirectory() as folder:
        written = Path(folder, "numbers.json")
        command = [sys.executable, "-m", "tests.test_golden", "--write", str(written), *names]
        subprocess.run(command, env={**os.environ, **build_environment(settings)}, check=True)
        found: dict[str, dict[str, Any]] = json.loads(written.read_text())
    return found


def build_environment(settings: Mapping[str, str]) -> dict[str, str]:
    """Return the environment of a build; numba wants every feature that it is to do without."""
    chosen = dict(settings)
    if "NUMBA_CPU_FEATURES" in settings:
        features = llvm.get_host_cpu_features()
        chosen["NUMBA_CPU_NAME"] = llvm.get_host_cpu_name()
        off = (settings["NUMBA_CPU_FEATURES"].lstrip("-"), "avx10")
        kept = {name: has and not name.startswith(off) for name, has in features.items()}
        chosen["NUMBA_CPU_FEATURES"] = ",".join(
            f"{'+' if on else '-'}{n}" for n, on in kept.items()
        )
    return chosen


def write_golden(names: Sequence[str]) -> None:
    """Write the files anew, with the numbers of this build and their spread over all."""
    builds = [in_build(settings, names) for settings in BUILDS.values()]
    for name in names:
        path = GOLDEN / f"{name}.json"
        case = json.loads(path.read_text())
        numbers = builds[0][name]
        if numbers["exit status"] > 1:  # that of a robot that was lost is 1
            sys.exit(f"{name} ended with {numbers['exit status']}; its file stays")
        if "--spread" in sys.argv:
            numbers = case["numbers"]
        made = {"made_with": version("ssmr-testbed"), "made_on": made_on()}
        spread = _spread_of(numbers, [build[name] for build in builds])
        whole = {**case, **made, "spread": spread, "numbers": numbers}
        path.write_text(json.dumps(whole, indent=0) + "\n")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--write"]:
        target = Path(sys.argv[2])
        target.write_text(json.dumps(numbers_of(sys.argv[3:])))
    elif sys.argv[1:2] == ["--build"]:
        print(*(f"{k}={v}" for k, v in build_environment(WITHOUT_WIDE_VECTORS).items()), sep="\n")
    else:
        given = [word for word in sys.argv[1:] if word != "--spread"]
        write_golden(given or sorted(path.stem for path in GOLDEN.glob("*.json")))
