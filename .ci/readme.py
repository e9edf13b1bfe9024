"""Print a command of README.md, ready to run in an empty folder.

Usage: `python .ci/readme.py main|tests SOURCE`. The README's `git clone <...>` becomes a clone of
SOURCE. A command that does not clone runs inside such a clone.
"""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path

README = Path(__file__).resolve().parents[1] / "README.md"
MARKS = {"main": "compare traj4", "tests": "pytest"}
"""The word by which the README's block of each job is known; both also hold `pip install`."""


def printed(name: str, text: str) -> str:
    """Return the first bash block of `text` that installs the project and does the job `name`.

    Raises:
        ValueError: no block does.
    """
    for block in re.findall(r"```(?:bash|sh|shell|console)\n(.*?)```", text, re.DOTALL):
        if "pip install" in block and MARKS[name] in block:
            return str(block).strip()
    raise ValueError(f"README.md has no bash block with `pip install` and `{MARKS[name]}`")


def runnable(command: str, source: str) -> str:
    """Return the command with SOURCE as the repository that it clones."""
    clone = f"git clone -q {shlex.quote(source)}"
    there = re.sub(r"git clone (<[^>]*>|\S+)", lambda _: clone, command)
    return there if there != command else f"{clone} here && cd here\n{command}"


if __name__ == "__main__":
    print(runnable(printed(sys.argv[1], README.read_text(encoding="utf-8")), sys.argv[2]))
