"""What travels: a wheel built from the tree works from another folder, without the tree."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
pytest.importorskip("hatchling", reason="building a wheel needs the extra `test`")


def test_a_built_wheel_runs_the_main_job_elsewhere(tmp_path: Path) -> None:
    """Unpacked, not installed: what it depends on is already here, and the tree is not on the path."""
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path), str(ROOT)]
    built = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert built.returncode == 0, built.stderr
    (wheel,) = tmp_path.glob("*.whl")
    site = tmp_path / "site"
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        archive.extractall(site)
    profiles = {f"validation/plants/profiles/{p.name}" for p in (ROOT / "validation/plants/profiles").glob("*.toml")}
    data = {
        "_models/husky.xml",
        "thesis/published.toml",
        "logs/sample.csv",
        "thesis/verdicts.toml",
        "replicate/templates/replicate.html",
    }
    assert {*(f"validation/{name}" for name in data), *profiles} <= names
    assert not any(name.startswith(("tests/", "benchmarks/", "docs/")) or ".nbi" in name for name in names)
    (entries,) = site.glob("*.dist-info/entry_points.txt")
    assert "ssmr = validation.cli.__main__:main" in entries.read_text()
    program = f"import sys; sys.path.insert(0, {str(site)!r}); import validation; print(validation.__file__)"
    program += "; from validation import cli; from validation.compare.__main__ import main"
    program += "; cli.run(main, 'compare', ['traj2', '--plants', 'mujoco,improved', '--no-rerun'])"
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=tmp_path, env=environment, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert str(site) in done.stdout.splitlines()[0]
    document = json.loads((tmp_path / "runs/compare/traj2/compare.json").read_text())
    assert set(document["plants"]) == {"mujoco", "improved"}
