"""The command `ssmr`: `ssmr compare traj4` is `python -m validation.compare traj4`, and so for every program."""

from __future__ import annotations

import sys
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass, make_dataclass
from importlib import import_module
from typing import Annotated, Any, Literal

import tyro

from validation import cli, store

PROGRAMS: Mapping[str, str] = {
    "compare": "Drive every simulation with the same commands and compare them, with each other or with a log.",
    "fit": "Search for the parameters with which a simulation moves like a log, or like another simulation.",
    "track": "Let a controller follow a path.",
    "tune": "Search for the gains of a controller.",
    "study": "Answer a question with a table and a picture: contact, transfer, robustness, noise and others.",
    "replicate": "Repeat everything that the thesis reports, with a verdict for each row.",
    "recordings": "Say what a log contains, clean it, convert it.",
    "robots": "List and check robots, write the file of a new one, import one from a URDF.",
    "ros": "Be a robot, or a controller, on a ROS graph.",
    "drive": "Drive a robot by hand in a window, with the other simulations beside it, and log it.",
}
"""What each program does; `ssmr PROGRAM --help` says more."""


@dataclass(frozen=True)
class CompletionOptions:
    """The options of `ssmr completion`."""

    shell: Annotated[Literal["bash", "zsh", "tcsh"], tyro.conf.Positional, cli.option()]
    """Shell that reads it."""


def _completion(options: CompletionOptions) -> None:
    """Print what a shell needs to complete programs and options, as in: eval "$(ssmr completion bash)"."""
    kinds = []
    for name, says in PROGRAMS.items():
        kind = cli.options_type(program_named(name))
        kinds.append(Annotated[kind, tyro.conf.subcommand(name, prefix_name=False, description=says)])
    everything: Any = typing.Union[tuple(kinds)]  # noqa: UP007 - of a list that is known at run time only
    arguments = ["--tyro-print-completion", options.shell]
    tyro.cli(everything, prog="ssmr", args=arguments, registry=cli.NUMBERS, config=(tyro.conf.DisallowNone,))


def program_named(name: str) -> Any:
    """Return what runs a program: its function, or those of its subcommands."""
    module = import_module(f"validation.{name}")
    own = getattr(module, name, None)
    if isinstance(own, cli.Program):
        return own.command()
    return module.PROGRAM if hasattr(module, "PROGRAM") else import_module(f"validation.{name}.__main__").PROGRAM


def _listed(name: str) -> Callable[[Any], None]:
    """Return what stands for a program in the help of `ssmr`, which loads none of them."""

    def program(options: Any) -> None:
        cli.run(program_named(name), f"ssmr {name}", sys.argv[2:])

    program.__doc__ = PROGRAMS[name]
    program.__annotations__ = {"options": make_dataclass(name.capitalize(), [], frozen=True)}
    return program


def main() -> None:
    """Run the program that the command line names first; see `PROGRAMS`."""
    first = sys.argv[1] if len(sys.argv) > 1 else "--help"
    if first == "--version":
        print(f"ssmr-testbed {store.versions()['ssmr-testbed']}")
    elif first in PROGRAMS:
        _listed(first)(None)
    else:
        cli.run(
            {**{name: _listed(name) for name in PROGRAMS}, "completion": _completion}, "ssmr", sys.argv[1:] or ["--help"]
        )


if __name__ == "__main__":
    main()
