"""Planar fits beside those of version 1.0, whose sources come out of the history of this project, on one thread each."""

from __future__ import annotations

import contextlib
import io
import json
import os
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.rows import MissingError, Row
from validation import cli
from validation.progress import Progress

VERSION_1_0 = "4e106eb19f4f10a0fd7150790822fd1c6413f842"
"""The commit that version 1.0.0 was made of."""
GENERATIONS = 9
"""Generations of a fit that is timed, after the first population."""
_FREE = {
    "coulomb": ("u_x", "mu_c", "gain"),
    "improved": ("u_x", "mu_s", "mu_d", "gain"),
    "linear": ("k_u", "k_y", "gain"),
    "kinematic": ("alpha_l", "alpha_r", "y_l", "y_r"),
}
_ROOT = Path(__file__).resolve().parents[1]


def unpack_version(commit: str, folder: Path) -> None:
    """Write the sources of a version into a folder.

    Raises:
        MissingError: there is no git, or no history that reaches back so far.
    """
    try:
        archive = subprocess.run(["git", "-C", _ROOT, "archive", commit], check=True, capture_output=True).stdout
    except (OSError, subprocess.CalledProcessError) as error:
        raise MissingError("the history does not hold version 1.0; clone the project whole, or pass --no-former") from error
    with tarfile.open(fileobj=io.BytesIO(archive)) as sources:
        sources.extractall(folder, filter="data")


@contextlib.contextmanager
def _answering(sources: Path) -> Iterator[subprocess.Popen[str]]:
    """Start the process that times planar fits with some sources."""
    script = Path(__file__).with_name("planar_fits.py")
    settings = {**os.environ, "PYTHONPATH": str(sources), "NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    with subprocess.Popen(
        [sys.executable, "-P", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=settings, cwd=sources, text=True
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def _ask(process: subprocess.Popen[str], model: str) -> dict[str, float]:
    """Return the processor times of a candidate of a model [s].

    Raises:
        MissingError: the process has ended, after it said why.
    """
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(json.dumps({"model": model, "free": _FREE[model], "generations": GENERATIONS}) + "\n")
    process.stdin.flush()
    if not (line := process.stdout.readline()):
        raise MissingError("one of the versions does not run here, see above; pass --no-former")
    return dict(json.loads(line))


def former_rows(repeats: int) -> list[Row]:
    """Time whole fits of the planar models, and rating a candidate, against version 1.0; processor time, by turns.

    Rating is what a candidate costs beside simulating it: building it, telling its poses, and Eq. 3.1.
    """
    rows = []
    with tempfile.TemporaryDirectory() as folder, cli.shown("planar fits beside version 1.0") as progress:
        unpack_version(VERSION_1_0, Path(folder))
        with _answering(Path(folder)) as then, _answering(_ROOT) as now:
            for done, model in enumerate(_FREE):
                both = [[_ask(process, model) for process in (then, now)] for _ in range(repeats)]
                former, ours = ({k: min(pair[i][k] for pair in both) for k in both[0][i]} for i in (0, 1))
                rated, former_rated = (times["rated"] - times["simulating"] for times in (ours, former))
                rows += [
                    Row(f"{model}: rating a candidate, version 1.0 / now", former_rated / rated, ">= 3", rated,
                        former_rated, former_rated >= 3.0 * rated),
                    Row(f"{model}: a candidate of a whole fit, version 1.0 / now", former["fit"] / ours["fit"], ">= 5",
                        ours["fit"], former["fit"], former["fit"] >= 5.0 * ours["fit"]),
                ]  # fmt: skip
                progress(Progress(done + 1, len(_FREE), model))
    return rows
