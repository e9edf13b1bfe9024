"""The README's two commands, and `.ci/run`, which runs them as printed before all else."""

from __future__ import annotations

import ast
import os
import re
import runpy
import shutil
import signal
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from tests.conftest import Launch

ROOT = Path(__file__).resolve().parents[1]
READER = runpy.run_path(str(ROOT / ".ci" / "readme.py"))
BROUGHT = {
    "packaging": "pytest",
    "pillow": "matplotlib",
    "lz4": "rosbags",
    "llvmlite": "numba",
    "nbformat": "nbclient",
    "backports.zstd": "rosbags",
    "ruamel.yaml": "rosbags",
}
"""A package that tests import, and the one that cannot do without it."""

PYTHON = """#!/usr/bin/env bash
# Stands for python3.11: reads the README's commands, makes environments whose programs
# only say that they were called.
case "$*" in
    *readme.py*) exec {python} "$@" ;;
    "-m venv"*)
        mkdir -p "$3/bin"
        for name in pip python ruff mypy bandit; do ln -s {here}/program "$3/bin/$name"; done ;;
esac
"""
PROGRAM = """#!/usr/bin/env bash
echo "$(basename "$0") $*" >> {here}/calls
"""
ROOTS = """#!/usr/bin/env bash
# Stands for mmdebstrap: the new root has this machine's programs.
root=${{@: -1}}
echo "$root" > {here}/root
mkdir -p "$root"/{{etc,proc,dev,root,usr}}
mount -o ro,bind /usr "$root/usr"
for name in bin lib lib64; do ln -s "usr/$name" "$root/$name"; done
"""
README = (
    "\n```bash\n"
    "git clone <this repository> husky && cd husky && {main} && "
    "python3.11 -m venv .venv && .venv/bin/pip install compare traj4\n"
    "```\n\n```bash\n"
    'python3.11 -m venv .venv && .venv/bin/pip install ".[test]" && '
    '.venv/bin/python -m pytest && echo "== 3 passed in 0.10s =="\n'
    "```\n"
)


@pytest.fixture
def house(tmp_path: Path) -> Path:
    """A repository with this `.ci/run`, its own README, and programs that note their calls."""
    ci = tmp_path / "house" / ".ci"
    ci.mkdir(parents=True)
    for name in ("run", "fresh", "readme.py"):
        shutil.copy(ROOT / ".ci" / name, ci)
    stand_in(tmp_path, "python3.11", PYTHON)
    stand_in(tmp_path, "program", PROGRAM)
    for name in ("mmdebstrap", "apt-get"):
        stand_in(tmp_path, name, "#!/bin/sh\nexit 1")
    return tmp_path / "house"


def stand_in(folder: Path, name: str, text: str) -> None:
    """Write a program that stands for another."""
    (folder / name).write_text(text.format(python=sys.executable, here=folder))
    (folder / name).chmod(0o755)


def surroundings(house: Path) -> dict[str, str]:
    """The environment in which what stands for programs is found."""
    return {**os.environ, "PATH": f"{house.parent}{os.pathsep}/usr/bin{os.pathsep}/bin"}


def ci(house: Path, main: str, readme: str = README) -> tuple[int, list[str], list[str]]:
    """Commit the README with `main` in its main job and run.

    Exit status, lines of output, calls.
    """
    (house / "README.md").write_text(readme.format(main=main))
    who = ["-c", "user.name=a", "-c", "user.email=a@b"]
    for command in (["init", "-q"], ["add", "-A"], [*who, "commit", "-qm", "house"]):
        subprocess.run(["git", *command], cwd=house, check=True)
    options = {
        "cwd": house,
        "env": surroundings(house),
        "capture_output": True,
        "text": True,
        "timeout": 60,
    }
    done = subprocess.run(["bash", ".ci/run"], **options)
    return (
        done.returncode,
        done.stdout.splitlines(),
        (house.parent / "calls").read_text().splitlines(),
    )


def test_the_readme_s_commands_run_first_and_pytest_has_the_last_word(house: Path) -> None:
    status, output, calls = ci(house, "true")
    assert calls[:3] == ["pip install compare traj4", "pip install .[test]", "python -m pytest"]
    assert calls[3:7] == ["pip install -e .[dev]", "ruff check .", "ruff format --check .", "mypy "]
    assert calls[7:9] == [
        "python -m pytest -q -m slow tests/test_snippets.py",
        "bandit -q -c pyproject.toml -r ssmr validation",
    ]
    assert output[-2:] == ["everything passed", "== 3 passed in 0.10s =="]
    assert status == 0


def test_a_main_job_that_fails_is_told_and_hides_nothing_else(house: Path) -> None:
    status, output, calls = ci(house, "false")
    assert status == 1
    assert "pip install compare traj4" not in calls
    assert "mypy " in calls
    assert output[-2:] == ["FAILED: the README's main job", "== 3 passed in 0.10s =="]


def test_tests_that_skipped_for_the_newcomer_run_for_the_maintainer(house: Path) -> None:
    skipped = ("test_b.py::test_c[a b]", "test_a.py", "test_b.py::test_c[d]")
    message = "\n".join(f"SKIPPED tests/{name} - why" for name in skipped)
    readme = README.replace('&& echo "==', f'&& echo "{message}" && echo "==')
    calls = ci(house, "true", readme)[2]
    assert "python -m pytest -q tests/test_a.py tests/test_b.py::test_c" in calls


@pytest.mark.parametrize(
    ("command", "status"), [("exit 7", 7), ("echo ready; sleep 600", -signal.SIGTERM)]
)
def test_the_root_of_a_new_machine_goes_however_its_command_ends(
    house: Path, launch: Launch, command: str, status: int
) -> None:
    stand_in(house.parent, "mmdebstrap", ROOTS)
    subprocess.run(["git", "init", "-q"], cwd=house, check=True)
    program = launch(
        ["bash", ".ci/fresh", command], cwd=house, env=surroundings(house), stdout=subprocess.PIPE
    )
    if program.stdout.readline() == b"ready\n":
        program.terminate()
    if program.wait(60) == 69:
        pytest.skip("no root with namespaces of its own can be made here")
    assert program.returncode == status
    assert not Path((house.parent / "root").read_text().strip()).exists()


@pytest.mark.parametrize(
    ("death", "message"),
    [
        ("def test_dies():\n    os.abort()", "1 failed"),
        ("if os.environ.get('PYTEST_XDIST_WORKER') == 'gw1':\n    os.abort()", "no tests ran"),
    ],
)
def test_a_worker_that_dies_fails_the_run_and_nobody_waits_for_it(
    death: str, message: str, tmp_path: Path
) -> None:
    for name in ("first", "second"):
        (tmp_path / f"test_{name}.py").write_text("def test_one(): pass\ndef test_two(): pass\n")
    (tmp_path / "test_last.py").write_text(f"import os\n{death}\n")
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-c",
        str(ROOT / "pyproject.toml"),
        "-p",
        "tests.workers",
        "-n",
        "2",
    ]
    command += ["-p", "no:cacheprovider", "--rootdir", str(tmp_path), str(tmp_path)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=100, check=False
    )
    assert (done.returncode, message in done.stdout.splitlines()[-1]) == (1, True), done.stdout


def test_the_readme_has_both_commands() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    main, tests = (
        READER["runnable"](READER["printed"](name, text), "SOURCE") for name in ("main", "tests")
    )
    assert main.startswith("git clone -q SOURCE here && cd here\n")
    assert re.search(r"pip install -e \.(?!\[)", main), "the main job needs no extra"
    assert re.search(r"""pip install -e ["']?\.\[test\]""", tests)
    assert tests.startswith("git clone -q SOURCE here && cd here\n")


def test_a_readme_without_the_command_is_refused() -> None:
    with pytest.raises(ValueError, match="compare traj4"):
        READER["printed"]("main", "```bash\npip install ssmr-testbed\n```")


def test_the_extra_test_has_what_the_tests_import() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [*project["dependencies"], *project["optional-dependencies"]["test"]]
    installed = {re.split(r"[^\w-]", requirement)[0].lower() for requirement in wanted}
    owners = packages_distributions()
    for path in sorted((ROOT / "tests").glob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in (
                {n.split(".")[0] for n in names}
                - sys.stdlib_module_names
                - {"ssmr", "validation", "benchmarks", "tests"}
            ):
                distributions = {d.lower().replace("_", "-") for d in owners.get(name, [name])}
                assert {BROUGHT.get(d, d) for d in distributions} & installed, (
                    f"{path.name} imports {name}"
                )
