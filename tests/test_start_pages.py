"""The commands of README and of the pages can be read.

Those of README and of the Start pages run, with what ships.
"""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import data_folder, exit_status
from validation.cli import parse_command
from validation.cli.__main__ import PROGRAMS, program_named
from validation.files.formats import log_path

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"
DOCS = ROOT / "docs"
START = (
    README,
    *(DOCS / f"{name}.md" for name in ("first_comparison", "your_robot", "controllers")),
)


def commands(page: Path) -> list[list[str]]:
    """The words behind `python -m validation.` of each command of a page, in order."""
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    match = re.findall(r"^(?: {4}|\S*&& )*python -m validation\.(.*)$", text, re.MULTILINE)
    return [
        shlex.split(line, comments=True)
        for line in match
        if not re.search(r"[$…&]|\bMODEL\b", line)
    ]


@pytest.mark.parametrize(
    "page",
    [README, *sorted(set(DOCS.glob("*.md")) - {DOCS / "extend.md"})],
    ids=lambda page: page.stem,
)
def test_every_command_of_a_page_can_be_read(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those of extend.md, which adds programs and plants, run in a test of their own."""
    monkeypatch.chdir(tmp_path)
    for name, *words in commands(page):
        assert name in PROGRAMS, name
        if "--config" in words:  # of a run that an earlier command made
            result = Path(words[words.index("--config") + 1])
            result.parent.mkdir(parents=True)
            config = {"program": name, "source": "traj4"}
            result.write_text(json.dumps({"schema": "ssmr.compare/1", "config": config}))
        parse_command(program_named(name), name, words)


def shortened(words: list[str]) -> str:
    """The command with a short search and without fits of MuJoCo.

    The command is tried, not its result.
    """
    text = re.sub(r"(--population) \d+ (--generations) \d+", r"\1 5 \2 1", shlex.join(words))
    for begins, more in (("calibrate", "--plants kinematic"), ("study transfer", "--quick")):
        text += f" {more}" if text.startswith(begins) and more.split()[0] not in text else ""
    return text


@pytest.mark.slow
@pytest.mark.parametrize("page", START, ids=lambda page: page.stem)
def test_a_start_page_runs_from_top_to_bottom(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if page == README:  # which says robot.urdf and drive.csv for what its reader has
        assert (
            exit_status(
                program_named("robots"), "export", "husky", "--to", "urdf", "--out", "robot.urdf"
            )
            == 0
        )
        shutil.copy(log_path("husky"), "drive.csv")
    measured = [
        shlex.split(text) for text in dict.fromkeys(shortened(words) for words in commands(page))
    ]
    assert len(measured) > 4
    for name, *words in measured:
        assert exit_status(program_named(name), *words) == 0, (name, words)


@pytest.mark.slow
def test_numbers_of_the_pages_are_those_of_runs(tmp_path: Path) -> None:
    script = [sys.executable, str(DOCS / "write_numbers.py"), "--check"]
    if data_folder().is_dir():
        script += ["--data", str(data_folder())]
    done = subprocess.run(script, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
