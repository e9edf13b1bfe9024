"""The command line `python -m validation.study STUDY`: one command for each study.

A study NAME is the module `validation.study.NAME` with the program `study_NAME`.
"""

from __future__ import annotations

if __name__ == "__main__":
    from validation.interrupts import end_quietly

    end_quietly()

from importlib import import_module
from typing import Any

from validation import cli

STUDIES = ("contact", "transfer", "drivetrain")
"""Names of all studies, in the order of the help text."""


def study_named(name: str) -> cli.Program[..., Any]:
    """Return the program of a study; its module is imported then."""
    module = import_module(f"validation.study.{name}")
    program = getattr(module, f"study_{name}")
    return program


PROGRAM = {name: study_named(name) for name in STUDIES}

if __name__ == "__main__":
    cli.run_command(PROGRAM, "python -m validation.study")
