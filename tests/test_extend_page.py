"""docs/extend.md, followed word for word in a copy of the project.

It adds a model, a plant and a controller.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "extend.md"
STEP = re.compile(
    r"^`(?P<path>[\w/.]+)`$|^```(?P<kind>python|diff|bash)\n(?P<text>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)


def steps(section: str) -> Iterator[tuple[str, str, str]]:
    """Kind, file and text of every block of a section, in order; the file is the one named last."""
    path = ""
    for match in STEP.finditer(section):
        path = match["path"] or path
        if match["kind"]:
            yield match["kind"], path, match["text"]


def sections() -> dict[str, str]:
    """Text of the page by heading."""
    parts = re.split(r"^## ", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]
    return {part.splitlines()[0]: part for part in parts}


def patched(source: str, diff: str) -> str:
    """The source with a block of ` `, `-` and `+` lines applied.

    What it replaces must be there just once.
    """
    lines = diff.splitlines(keepends=True)
    before = "".join(line[1:] for line in lines if line[0] in " -")
    after = "".join(line[1:] for line in lines if line[0] in " +")
    assert source.count(before) == 1, f"{source.count(before)} places for\n{diff}"
    return source.replace(before, after)


def copy_project(folder: Path) -> None:
    """What the page needs of this tree."""
    for name in ("ssmr", "validation", "models", "tests"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", folder)


def write_step(folder: Path, kind: str, path: str, text: str) -> None:
    """Write a new file, or patch one that is there."""
    file = folder / path
    if kind == "python":
        assert not file.exists(), path
        file.parent.mkdir(exist_ok=True)
    file.write_text(
        text if kind == "python" else patched(file.read_text(encoding="utf-8"), text),
        encoding="utf-8",
    )


def test_every_block_of_the_page_fits_the_code(tmp_path: Path) -> None:
    copy_project(tmp_path)
    for section in sections().values():
        for kind, path, text in steps(section):
            if kind != "bash":
                write_step(tmp_path, kind, path, text)
                compile((tmp_path / path).read_text(encoding="utf-8"), path, "exec")


@pytest.mark.slow
@pytest.mark.parametrize("heading", [h for h, text in sections().items() if "```bash" in text])
def test_a_section_followed_word_for_word_works(heading: str, tmp_path: Path) -> None:
    copy_project(tmp_path)
    for kind, path, text in steps(sections()[heading]):
        if kind == "bash":
            inside = {
                **os.environ,
                "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
            }
            done = subprocess.run(
                ["bash", "-e", "-c", text], cwd=tmp_path, env=inside, capture_output=True, text=True
            )
            assert done.returncode == 0, done.stdout + done.stderr
        else:
            write_step(tmp_path, kind, path, text)
