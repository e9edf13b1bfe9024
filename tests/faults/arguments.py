"""Arguments: every option of every program with what nobody means, one to three at a time, in whole programs.

Nothing of the programs is replaced. The budgets are small, a window is never opened, and `ros` ends where it finds no graph.
"""

from __future__ import annotations

import argparse
import random
from collections.abc import Sequence
from pathlib import Path

from tests.faults import files
from tests.faults.damage import NASTY_TEXTS, PLAUSIBLE
from tests.faults.doors import program
from tests.faults.judge import USUAL as STATUSES
from tests.faults.judge import Outcome, visible
from tests.faults.pool import Part
from tests.faults.programs import LONG, NOT_TRIED, USUAL, WRITTEN, declared, values_of

_WEIGHTS = {"study contact": 0.3, "study filter": 0.5, "study robustness": 0.5, "replicate": 0.4}


def plan(inputs: int, kills: int) -> dict[str, int]:
    """Return how many cases of each command there are: more than a fifth of all inputs."""
    weights = {name: _WEIGHTS.get(name, 1.0) for name in USUAL}
    unit = 0.22 * inputs / sum(weights.values())
    return {name: max(1, round(unit * weight)) for name, weight in weights.items()}


def argv_of(name: str, rng: random.Random) -> list[str]:
    """Return a command line with one to three values that nobody means."""
    usual = USUAL[name]
    words, options = usual.words.split(), dict(usual.options)
    kept = set(NOT_TRIED) | (set(options) if name in LONG else set())
    actions = [a for a in declared(name) if not set(a.option_strings) & kept]
    places = [
        k for k, word in enumerate(words) if k or " " not in name or not name.startswith(("study", "recordings", "ros"))
    ]
    for action in rng.sample(actions, min(rng.choice((1, 1, 1, 2, 3)), len(actions))):
        value = _value(action, rng)
        if action.option_strings:
            options[rng.choice(action.option_strings)] = value if action.nargs != 0 else ""
        elif places:
            words[rng.choice(places)] = value
    if rng.random() < 0.02:
        options[rng.choice(NASTY_TEXTS)] = rng.choice(NASTY_TEXTS)
    flat = [w for k, v in options.items() for w in ((k,) if v == "" and _is_flag(actions, k) else (k, v))]
    return [w.replace("\x00", "") for w in (*words, *flat)]


def _is_flag(actions: Sequence[argparse.Action], option: str) -> bool:
    return any(option in a.option_strings and a.nargs == 0 for a in actions)


def _value(action: argparse.Action, rng: random.Random) -> str:
    if action.choices and rng.random() < 0.7:
        return rng.choice(sorted(map(str, action.choices)))
    value = rng.choice(values_of(action) or (PLAUSIBLE if rng.random() < 0.3 else NASTY_TEXTS))
    if set(action.option_strings) & WRITTEN and value.startswith("/"):
        return f"here{value}"  # whoever runs this may be allowed to write anywhere
    return value


def run(name: str, rng: random.Random, folder: Path) -> tuple[Outcome, Sequence[int]]:
    """Run a program with such a command line, in a folder that has files of all kinds."""
    work = folder / "a" / "b" / "work"  # what goes up two folders stays in this case's
    files.lay_out(work)
    argv = argv_of(name, rng)
    what = visible(f"{name.split()[0]} {' '.join(map(repr, argv))}")
    return program(what, name.split()[0], argv, work), STATUSES


PART = Part(plan, run)
