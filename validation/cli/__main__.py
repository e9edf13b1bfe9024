"""The command `ssmr`: one name for every program.

`ssmr compare traj4` is `python -m validation.compare traj4`.
"""

from __future__ import annotations

if __name__ == "__main__":
    from validation.interrupts import end_quietly

    end_quietly()

import sys
from collections.abc import Mapping
from importlib import import_module
from importlib.util import find_spec
from typing import Annotated, Any

import tyro

from validation import cli, output

_EVERY = {
    "compare": "Drive every simulation with the same commands and compare them, "
    "with each other or with a log.",
    "fit": "Search for the parameters with which a simulation moves like a log, "
    "or like another simulation.",
    "calibrate": "Calibrate a robot from a log, and judge it on what the fits have not seen.",
    "track": "Let a controller follow a path.",
    "tune": "Search for the gains of a controller.",
    "study": "Answer a question with a table and a picture: contact, transfer or drive train.",
    "table": "Lay results of several runs side by side, as text, Markdown and CSV.",
    "replicate": "Repeat everything that the thesis reports, with a verdict for each row.",
    "recordings": "Say what a log contains, clean it, convert it.",
    "robots": "List and check robots, write the file of a new one, import one from a URDF.",
    "ros": "Run a simulated robot or a path controller as a ROS 2 node.",
}
PROGRAMS: Mapping[str, str] = {
    name: says for name, says in _EVERY.items() if find_spec(f"validation.{name}")
}
"""Work of each program that is there, in one sentence; `ssmr PROGRAM --help` says more."""


def program_named(name: str) -> Any:
    """Return a program, or those of its subcommands by name."""
    module = import_module(f"validation.{name}")
    if hasattr(module, "__path__"):
        module = import_module(f"validation.{name}.__main__")
    return getattr(module, "PROGRAM", None) or getattr(module, name)


def _stand_in_command(says: str) -> Any:
    """Return a command that stands for a program in the list of all."""

    def nothing() -> None:
        pass

    nothing.__doc__ = says
    return nothing


def _read_as(programs: Mapping[str, Any]) -> Any:
    """Return the command that is one of several programs, or says the version."""

    def ssmr(call: Any, *, version: bool = False) -> None:
        """Simulate skid-steering robots, compare simulations with logs, and calibrate them.

        Options of a program: `ssmr PROGRAM --help`.

        Args:
            call: What to do.
            version: Print the version.
        """
        call()

    call = tyro.conf.arg(name="")
    ssmr.__annotations__["call"] = Annotated[cli.read_as(programs), call]
    return ssmr


def main() -> None:
    """Run the program that the command line names first; see `PROGRAMS`."""
    first, *rest = sys.argv[1:] or ["--help"]
    if first == "--version":
        print(f"ssmr-testbed {output.list_versions()['ssmr-testbed']}")
    elif first in PROGRAMS:
        cli.run_command(program_named(first), f"ssmr {first}", rest)
    elif first.startswith("--tyro-"):
        # only a shell's completion needs the options of all programs at once
        cli.run_command(_read_as({name: program_named(name) for name in PROGRAMS}), "ssmr")
    else:
        cli.run_command(
            _read_as({name: _stand_in_command(says) for name, says in PROGRAMS.items()}),
            "ssmr",
            [first],
        )


if __name__ == "__main__":
    main()
