"""What travels: a wheel built from the tree works from another folder, without the tree."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from tests.appendices import is_there

ROOT = Path(__file__).resolve().parents[1]
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = SETTINGS["project"]
LACKING = {"3.13": {"dm-control"}, "3.14": {"dm-control", "cyclonedds"}}
"""Later Pythons do without these packages, which have no wheels for them."""
BARE = """
import sys
sys.modules.update(dict.fromkeys(("dm_control", "labmaze", "rerun", "rerun_cli", "pyarrow")))
from validation import cli, learning, load_profile
from validation.compare import compare
cli.run_command(compare, "compare", ["traj2", "--plants", "mujoco,improved", "--no-rerun"])
learning.TrackBatch(learning.TrackTask(), 2).reset()
try:
    learning.RobotEntity
except ImportError as error:
    print("entity:", error)
cli.run_command(compare, "compare", ["traj2"])
"""
pytest.importorskip("hatchling", reason="building a wheel needs the extra `test`")


@pytest.mark.slow
def test_a_built_wheel_runs_the_main_job_elsewhere(tmp_path: Path) -> None:
    """Unpacked, not installed: its dependencies are here, and the tree is not on the path."""
    command = [
        sys.executable,
        "-m",
        "build",
        "--wheel",
        "--no-isolation",
        "--outdir",
        str(tmp_path),
        str(ROOT),
    ]
    built = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert built.returncode == 0, built.stderr
    (wheel,) = tmp_path.glob("*.whl")
    site = tmp_path / "site"
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        archive.extractall(site)
    profiles = {
        f"validation/plants/profiles/{p.name}"
        for p in (ROOT / "validation/plants/profiles").glob("*.toml")
    }
    data = {
        "_models/husky.toml",
        "_models/husky.xml",
        *(
            f"files/shipped/{name}"
            for name in ("sample.csv", "husky.csv", "warthog.csv", "LICENSE", "README.md")
        ),
    }
    if is_there("replicate"):
        files = ("published.toml", "verdicts.toml", "templates/lead.md")
        data |= {f"replicate/{name}" for name in files}
    assert {*(f"validation/{name}" for name in data), *profiles} <= names
    assert not any(
        name.startswith(("tests/", "benchmarks/", "docs/")) or ".nbi" in name for name in names
    )
    (entries,) = site.glob("*.dist-info/entry_points.txt")
    assert "ssmr = validation.__main__:main" in entries.read_text()
    options = ["traj2", "--plants", "mujoco,improved", "--no-rerun"]
    program = f"import sys; sys.path.insert(0, {str(site)!r}); "
    program += "import validation; print(validation.__file__); "
    program += "from validation import cli; from validation.compare import compare; "
    program += f"cli.run_command(compare, 'compare', {options!r})"
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=environment,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert str(site) in done.stdout.splitlines()[0]
    document = json.loads((tmp_path / "runs/compare/traj2/compare.json").read_text())
    assert set(document["plants"]) == {"mujoco", "improved"}


def wanted(version: str) -> list[Requirement]:
    """Return the packages that the project and its extras ask for in a Python of that version."""
    extras = PROJECT["optional-dependencies"]
    everything = [
        *PROJECT["dependencies"],
        *(r for name in extras for r in extras[name] if not r.startswith(PROJECT["name"])),
    ]
    measured = [Requirement(text) for text in everything]
    return [
        r for r in measured if r.marker is None or r.marker.evaluate({"python_version": version})
    ]


@pytest.mark.skipif(not is_there("learning"), reason="what needs dm_control was deleted")
def test_the_main_job_runs_without_dm_control_and_rerun(tmp_path: Path) -> None:
    """As in Python 3.13, and in a thin installation; what needs either says so in one line."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", BARE],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=environment,
        timeout=300,
    )
    assert done.returncode == 2, done.stderr
    assert "entity: RobotEntity and ground need dm_control" in done.stdout
    assert "needs the package rerun-sdk" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr
    assert set(
        json.loads((tmp_path / "runs/compare/traj2/compare.json").read_text())["plants"]
    ) == {"mujoco", "improved"}


def test_later_pythons_do_without_what_has_no_wheels_for_them() -> None:
    usual = {r.name for r in wanted("3.12")}
    assert {version: usual - {r.name for r in wanted(version)} for version in LACKING} == LACKING


@pytest.mark.slow
@pytest.mark.parametrize("version", LACKING)
def test_every_dependency_has_wheels_for_later_pythons(version: str, tmp_path: Path) -> None:
    """The index resolves them, with what they bring; nothing is installed."""
    resolve = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "-q",
        "--dry-run",
        "--ignore-installed",
        "--only-binary=:all:",
    ]
    resolve += ["--target", str(tmp_path), "--python-version", version]
    if (
        subprocess.run(
            [*resolve, "lazy-loader"], capture_output=True, timeout=300, check=False
        ).returncode
        != 0
    ):
        pytest.skip("no package index can be reached")
    texts = {r.name: str(r).partition(";")[0].strip() for r in wanted("3.12")}
    done = subprocess.run(
        [*resolve, *(texts[r.name] for r in wanted(version))],
        capture_output=True,
        text=True,
        timeout=900,
    )
    assert done.returncode == 0, done.stderr
    for package in sorted(LACKING[version]):  # a package that has got wheels can be had again
        again = subprocess.run(
            [*resolve, texts[package]], capture_output=True, timeout=300, check=False
        )
        assert again.returncode != 0, package


def test_the_sources_that_travel_are_whole() -> None:
    """The sdist has all that tests, pages and builds need, and no hidden files."""
    included = SETTINGS["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    asked = ["git", "-C", str(ROOT), "ls-files"]
    tracked = subprocess.run(asked, capture_output=True, text=True, check=False).stdout.split()
    if not tracked:
        pytest.skip("this is no clone, so nothing says which files are tracked")
    tops = {name.partition("/")[0] for name in tracked if not name.startswith(".")}
    assert tops - {"pyproject.toml"} == set(included)


def test_a_release_is_the_same_everywhere() -> None:
    """The version stands in pyproject.toml; a release has a date, and only it is stable."""
    version = PROJECT["version"]
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    newest, said = re.findall(r"^## ([\d.]+) \(([\w-]+)\)$", changelog, re.MULTILINE)[0]
    is_release = re.fullmatch(r"\d+\.\d+\.\d+", version) is not None
    assert version.partition(".dev")[0] == newest
    assert (said != "unreleased") == is_release
    stable = "Development Status :: 5 - Production/Stable"
    assert (stable in PROJECT["classifiers"]) == is_release
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    if is_release:
        assert f"\nversion: {version}\ndate-released: {said}\n" in citation
    (author,) = re.findall(r'^  - name: "(.+)"$', citation, re.MULTILINE)
    assert PROJECT["authors"] == [{"name": author}]


def test_the_changelog_can_be_read() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    prose = re.sub(r"^\|.*$", "", text, flags=re.MULTILINE)
    assert len(prose.split()) <= 2500
