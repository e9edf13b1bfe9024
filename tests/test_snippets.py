"""The type checker accepts all code that pages, notebooks and examples show."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def snippets() -> Iterator[tuple[str, str]]:
    """Yield every piece of Python that users may copy, and where it is from."""
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]:
        text = page.read_text(encoding="utf-8")
        for block in re.finditer(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
            line = text.count("\n", 0, block.start(1))
            yield f"{page.stem}_md_{line}", block[1]
    folders = (ROOT / "examples", ROOT / "docs" / "examples")
    for notebook in sorted(ROOT.glob("examples/*.ipynb")):
        cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
        code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
        yield f"{notebook.stem}_ipynb", "\n".join(code)
    for script in sorted(chain(*(folder.glob("*.py") for folder in folders))):
        yield f"{script.stem}_py", script.read_text(encoding="utf-8")


ACCEPTED = """
from pathlib import Path
import ssmr
from validation import compare, fit, open_source, track, tune
motion = track("pid", ssmr.circle(speed=0.5), plant="mujoco", out="runs/x").motion("mujoco")
compare(motion.frame(), plants="mujoco,linear", horizons=[2, 6], terrain="ramp:5")
compare(Path("a.csv"), plants=["linear"], columns={"yaw": ("heading", "deg")})
fit("linear", to=["a.csv", "b.csv"], bounds="delay=0:0.5", fix={"delay": 0}, guess="delay=0.1")
tune("lqr", "circle@0.5", plant=("linear",), held_out="line", out=Path("runs/x"))
open_source(motion.frame())
"""
REFUSED = """
from validation import compare, fit, track
track("pid", "circle", plant=3)
track("pid", "circle", plants="mujoco")
compare("traj4", input="wheel")
fit("linear", "traj4", out=1)
compare("traj4").motion(0)
"""
"""Each call has one mistake."""


@pytest.mark.slow
def test_what_users_copy_passes_the_type_checker(tmp_path: Path) -> None:
    shown = [*snippets(), ("accepted", ACCEPTED), ("refused", REFUSED)]
    for name, code in shown:
        (tmp_path / f"shown_{name}.py").write_text(code, encoding="utf-8")
    assert len(shown) > 15
    command = [sys.executable, "-m", "mypy", "--config-file", str(ROOT / "pyproject.toml")]
    command += ["--cache-dir", str(ROOT / ".mypy_cache" / "shown"), "--no-error-summary"]
    command += [f"shown_{name}.py" for name, _ in shown]
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=900
    )
    said = done.stdout.splitlines()
    assert [line for line in said if not line.startswith("shown_refused.py")] == []
    refused = dict.fromkeys(int(line.split(":")[1]) for line in said)
    assert list(refused) == [3, 4, 5, 6, 7], done.stdout + done.stderr
