"""Frozen numbers of each program, which a rebuilding of the house must leave alone.

A file `tests/golden/NAME.json` holds a command line, and every number that the program then writes,
by its place in the files. It is at once the list of cases: for a new one, write a file with its
`command` alone, and `"slow": true` if it takes seconds, `"needs": "ode"` if it needs a library. In
a command, {out} is an empty folder, {data} the real recordings, {golden} the folder of these files;
without recordings, their cases skip. What a program writes besides does not matter; a number that
is missing fails.

A golden number changes only with its reason in the commit. This makes files anew, all of them where
none is named:

    python -m tests.test_golden NAME...
"""

from __future__ import annotations

import csv
import json
import math
import platform
import runpy
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from ctypes.util import find_library
from importlib.metadata import version
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from matplotlib.figure import Figure
from threadpoolctl import threadpool_info

from tests.conftest import data_folder

GOLDEN = Path(__file__).parent / "golden"
SAME = {"rel_tol": 1e-9, "abs_tol": 1e-15}
"""Where the numbers were made: programs repeat themselves bit for bit, and sums in another order
stay far under this; but a run of MuJoCo may not, see ELSEWHERE. What is smaller than the floor is
zero but for rounding."""
ELSEWHERE = {"rel_tol": 1e-2, "abs_tol": 1e-6}
"""On other processors or versions: MuJoCo's contacts make of the last bit of a command up to 1e-3
of a pose within a minute (measured with the sines of another processor), and 1e-8 of a ripple that
is zero; planar models stay within 1e-9."""

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
    return dict(sorted(numbers.items()))


def made_on() -> str:
    """Causes of rounding: processor as BLAS sees it, library of sines, versions of libraries."""
    blas = next(
        (str(each["architecture"]) for each in threadpool_info() if each["user_api"] == "blas"),
        "no BLAS",
    )
    versions = (f"{name} {version(name)}" for name in ("mujoco", "numpy", "scipy", "numba"))
    return ", ".join([platform.machine(), blas, " ".join(platform.libc_ver()), *versions])


def _agree(golden: Any, measured: Any, same: Mapping[str, float]) -> bool:
    """Whether numbers agree within tolerances, or words, truth values or nothings are equal."""
    if isinstance(golden, float | int) and isinstance(measured, float | int):
        return math.isclose(golden, measured, **same) or (
            math.isnan(golden) and math.isnan(measured)
        )
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
    same = SAME if case["made_on"] == made_on() else ELSEWHERE
    different = [
        f"{key}: golden {number}, found {measured.get(key, 'nothing')}"
        for key, number in golden.items()
        if not _agree(number, measured.get(key, "nothing"), same)
    ]
    if different:
        pytest.fail(
            f"{len(different)} of {len(golden)} numbers differ:\n"
            + "\n".join(different[:MOST_ITEMS]),
            pytrace=False,
        )


if __name__ == "__main__":
    for name in sys.argv[1:] or sorted(path.stem for path in GOLDEN.glob("*.json")):
        path = GOLDEN / f"{name}.json"
        case = json.loads(path.read_text())
        with tempfile.TemporaryDirectory() as folder:
            numbers = said_by(case["command"], Path(folder))
        if numbers["exit status"] > 1:  # that of a robot that was lost is 1
            sys.exit(f"{name} ended with {numbers['exit status']}; its file stays")
        path.write_text(
            json.dumps(
                {
                    **case,
                    "made_with": version("ssmr-testbed"),
                    "made_on": made_on(),
                    "numbers": numbers,
                },
                indent=0,
            )
            + "\n"
        )
