"""The command `ssmr`: one name for every program.

`ssmr compare traj4` is `python -m validation.compare traj4`.
"""

from __future__ import annotations

if __name__ == "__main__":
    from validation.interrupts import end_quietly

    end_quietly()

import sys
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Annotated, Any, Literal

import tyro
from rich.text import Text

from validation import cli, store
from validation.cli.options import NUMBERS
from validation.cli.process import options_type, say
from validation.words import shortened

_EVERY: Mapping[str, str] = {
    "compare": "Drive every simulation with the same commands and compare them, "
    "with each other or with a log.",
    "fit": "Search for the parameters with which a simulation moves like a log, "
    "or like another simulation.",
    "calibrate": "Calibrate a robot from a log, and judge it on what the fits have not seen.",
    "track": "Let a controller follow a path.",
    "tune": "Search for the gains of a controller.",
    "study": "Answer a question with a table and a picture: contact, transfer or drive train.",
    "replicate": "Repeat everything that the thesis reports, with a verdict for each row.",
    "recordings": "Say what a log contains, clean it, convert it.",
    "robots": "List and check robots, write the file of a new one, import one from a URDF.",
    "ros": "Run a simulated robot or a path controller as a ROS 2 node.",
}
PROGRAMS: Mapping[str, str] = {
    name: says for name, says in _EVERY.items() if find_spec(f"validation.{name}")
}
"""Work of each program that is there, in one sentence; `ssmr PROGRAM --help` says more."""


@dataclass(frozen=True)
class CompletionOptions:
    """The options of `ssmr completion`."""

    shell: Annotated[Literal["bash", "zsh", "tcsh"], tyro.conf.Positional, cli.option()]
    """Shell that reads it."""


def completion(options: CompletionOptions) -> None:
    """Print what a shell needs to complete programs and options.

    Use it as in: eval "$(ssmr completion bash)".
    """
    kinds = [
        Annotated[
            options_type(program_named(name)),
            tyro.conf.subcommand(name, prefix_name=False, description=says),
        ]
        for name, says in PROGRAMS.items()
    ]
    everything: Any = typing.Union[tuple(kinds)]  # noqa: UP007 - of a list
    tyro.cli(
        everything,
        prog="ssmr",
        args=["--tyro-print-completion", options.shell],
        registry=NUMBERS,
        config=(tyro.conf.DisallowNone,),
    )


def program_named(name: str) -> Any:
    """Return the function behind a program, or those of its subcommands."""
    module = import_module(f"validation.{name}")
    program = getattr(module, name, None)
    if isinstance(program, cli.Program):
        return program.command()
    if not hasattr(module, "PROGRAM"):
        module = import_module(f"validation.{name}.__main__")
    return module.PROGRAM


def main() -> None:
    """Run the program that the command line names first; see `PROGRAMS`."""
    first, *rest = sys.argv[1:] or ["--help"]
    everything = {
        **PROGRAMS,
        "completion": "Print what a shell needs to complete programs and options.",
    }
    if first in ("--help", "-h"):
        usage = "usage: ssmr PROGRAM [OPTIONS]; ssmr PROGRAM --help says more; ssmr --version\n"
        lines = [usage, *(f"{name:<12}{says}" for name, says in everything.items())]
        cli.report_console().print(Text("\n".join(lines)), soft_wrap=True)
    elif first == "--version":
        print(f"ssmr-testbed {store.versions()['ssmr-testbed']}")
    elif first in everything:
        cli.run(program_named(first) if first in PROGRAMS else completion, f"ssmr {first}", rest)
    else:
        say(f"error: there is no 'ssmr {shortened(first, 40)}'; there are: {', '.join(everything)}")
        sys.exit(cli.EXIT_USER_ERROR)


if __name__ == "__main__":
    main()
