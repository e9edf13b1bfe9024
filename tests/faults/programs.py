"""Every program with its options, read from its own declaration, and commands of each that take a second or two."""

from __future__ import annotations

import argparse
import functools
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, get_type_hints

import tyro

from tests.faults.damage import GENERATIONS, NASTY_COUNTS


@dataclass(frozen=True)
class Usual:
    """A command that works, in which other values are put."""

    words: str
    """Words before the options: subcommand and arguments."""
    options: Mapping[str, str]
    """Options and their values."""

    def argv(self) -> list[str]:
        """Return the command line."""
        return [*self.words.split(), *(w for k, v in self.options.items() for w in (k, v) if w)]


_SMALL = {"--population": "8", "--generations": "1"}
USUAL: Mapping[str, Usual] = {
    "compare": Usual("traj4", {"--plants": "improved", "--reference": "improved", "--no-rerun": ""}),
    "compare recording": Usual("good.csv", {"--plants": "kinematic", "--no-rerun": "", "--horizons": "1,2"}),
    "fit": Usual("linear", {"--to": "traj4@linear", **_SMALL}),
    "fit recording": Usual("linear", {"--to": "good.csv", "--horizons": "1,2", **_SMALL}),
    "track": Usual("pid line", {"--speed": "0.5", "--no-rerun": ""}),
    "track waypoints": Usual("smc way.csv", {"--no-rerun": "", "--plant": "kinematic"}),
    "tune": Usual("pid", {"--reference": "line@0.5", "--held-out": "line@1", **_SMALL}),
    "study robustness": Usual(
        "robustness",
        {"--controllers": "pid", "--gains": "tuned", "--runs": "17", "--seeds": "1", "--reference": "line", "--speed": "1"},
    ),
    "study filter": Usual(
        "filter",
        {"--references": "line", "--speed": "0.5", "--profiles": "thesis-lab", "--frictions": "0.5", "--seeds": "1"},
    ),
    "study transfer": Usual(
        "transfer",
        {"--judge": "linear", "--plants": "kinematic", "--controllers": "smc:tuned,lqr:tuned", "--references": "line@0.8",
         "--profile": "thesis-lab"},
    ),
    "study contact": Usual("contact", {"--only": "cone"}),
    "study engines": Usual("engines", {"--engines": "mujoco"}),
    "study drivetrain": Usual("drivetrain", {"--recording": "up.csv", "--ground": "grass.csv", "--resamples": "2"}),
    "study terrain": Usual("terrain", {"--seeds": "0"}),
    "replicate": Usual("", {"--quick": "", "--only": "3.12", "--out": "out"}),
    "recordings info": Usual("info good.csv", {}),
    "recordings convert": Usual("convert good.csv", {"--out": "made.mcap"}),
    "robots check": Usual("check husky", {"--out": "out"}),
    "robots new": Usual(
        "new mine",
        {"--wheelbase": "0.5", "--track": "0.6", "--wheel-radius": "0.15", "--wheel-width": "0.1", "--mass": "60"},
    ),
    "ros sim": Usual("sim", {"--duration": "0.1"}),
    "ros control": Usual("control pid line", {"--speed": "0.5", "--patience": "0.1"}),
}  # fmt: skip
"""Commands by what they are called in the campaign; the first word is the program."""
LONG = ("study terrain",)
"""Commands whose shortest run takes minutes: they are judged by what they refuse."""
NOT_TRIED = {"-h": "prints the help", "--view": "opens a window"}
"""Options that the campaign does not give, and why."""
WRITTEN = {"--out", "--docs", "--json"}
"""Options that say where to write."""
_BUDGETS = {"--population", "--seeds", "--resamples", "--runs", "--noise-seeds", "--patience", "--workers", "--seed"}


@functools.cache
def mains(program: str) -> Any:
    """Return what a program hands to `validation.cli.run`."""
    return import_module(f"validation.{program}.__main__").PROGRAM


@functools.cache
def declared(name: str) -> tuple[argparse.Action, ...]:
    """Return the options and arguments that a command declares, those of its subcommand where it has any."""
    program, *_ = name.split()
    main: Callable[..., Any] = mains(program)
    if isinstance(main, Mapping):
        main = main[USUAL[name].words.split()[0]]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        parser = tyro.extras.get_parser(get_type_hints(main)["options"], config=(tyro.conf.DisallowNone,))
    return tuple(parser._actions)


def values_of(action: argparse.Action) -> tuple[str, ...] | None:
    """Return the values that are worth giving to an option that must not get just any; None if it may."""
    name = action.option_strings[-1] if action.option_strings else ""
    if name == "--generations":
        return GENERATIONS
    if name in _BUDGETS:
        return NASTY_COUNTS
    return None
