"""A small share of the fault campaign with each run of the suite; `python -m tests.faults` is the whole."""

from __future__ import annotations

import json
import math
import random
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.faults import arguments, doors, files, judge, kills, pool, programs, report
from tests.faults.judge import Outcome
from tests.faults.pool import Case

SHARE = {"files": 200, "numbers": 300, "arguments": 100}
"""Inputs of each part that are tried here."""
SLOW = ("study contact", "study filter", "study robustness", "replicate", "fit recording")
"""Commands of which one run takes seconds."""
SEED = 7
pytestmark = pytest.mark.filterwarnings("ignore")  # of libraries, on damaged files; programs are judged by their own


@pytest.fixture(autouse=True)
def strict_arithmetic() -> Iterator[None]:
    """Arithmetic is as a user has it."""
    with np.errstate(divide="warn", invalid="warn", over="warn", under="ignore"):
        yield


@pytest.mark.parametrize("part", SHARE)
def test_no_input_gets_more_than_a_clear_line(part: str) -> None:
    plan = pool.part_of(part).plan(SHARE[part], 0)
    cases = [Case(part, kind, k) for kind, n in plan.items() for k in range(n) if kind not in SLOW]
    verdicts = dict(pool.run_cases(cases, SEED, workers=0))
    assert len(verdicts) >= 5
    assert [f"{case}: {v.what}: {v.faults}" for case, v in verdicts.items() if v.faults] == []


def test_a_program_that_is_killed_ends_like_one_that_was_not() -> None:
    assert pool.run_case(Case("kills", "recordings convert", 0), SEED).faults == ()


def test_every_option_of_every_program_is_tried() -> None:
    rng, given = random.Random(0), dict[str, set[str]]()
    for name in programs.USUAL:
        wanted = {o for a in programs.declared(name) for o in a.option_strings if o.startswith("--")} - {
            "--help",
            *programs.NOT_TRIED,
        }
        given[name] = {word for _ in range(800) for word in arguments.argv_of(name, rng)}
        assert wanted <= given[name]


def test_every_file_of_a_usual_command_is_there(tmp_path: Path) -> None:
    """Without it, a command is refused for that alone, and nothing else of it is tried."""
    files.lay_out(tmp_path / "work")
    named = [word for usual in programs.USUAL.values() for word in usual.argv() if word.endswith(".csv")]
    assert "good.csv" in named
    assert [name for name in named if not (tmp_path / "work" / name).is_file()] == []


def test_a_case_is_decided_by_its_name_and_the_seed() -> None:
    case = Case("numbers", "plant linear", 3)
    assert pool.run_case(case, 5) == pool.run_case(case, 5)
    cases = [Case("numbers", "terrain", k) for k in range(3)]
    assert dict(pool.run_cases(cases, 5, workers=0)) == dict(reversed(list(pool.run_cases(cases[::-1], 5, workers=0))))


def faults_of(outcome: Outcome, allowed: tuple[int, ...] = judge.USUAL) -> set[str]:
    return {kind for kind, _ in judge.judge(outcome, allowed).faults}


def test_calls_are_judged() -> None:
    def raise_long() -> None:
        raise ValueError("x" * 2000)

    assert faults_of(doors.call("a fault", lambda: math.nan)) == {"non-finite"}
    assert faults_of(doors.call("a fault", lambda: 1 // 0)) == {"traceback"}
    assert faults_of(doors.call("a fault", raise_long)) == {"unclear line"}
    assert faults_of(doors.call("no fault", lambda: float("x"))) == set()


def test_what_computes_or_waits_too_long_hangs_and_compiling_is_not_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doors, "_TICK", 0.02)
    monkeypatch.setattr(doors, "_LONGEST_IDLE", 0.5)
    code = "import time\ndef work(until):\n    while time.process_time() < until:\n        pass"
    spaces: list[dict[str, Any]] = [{"__name__": "numba.core"}, {"__name__": "elsewhere"}]
    for space in spaces:
        exec(code, space)
    compiling, computing = (
        doors.call("work", lambda work=space["work"]: work(time.process_time() + 1.0), 0.3) for space in spaces
    )
    assert (compiling.hung, computing.hung) == (False, True)
    assert doors.call("waiting", threading.Event().wait, 0.3).hung


@pytest.mark.parametrize(
    ("outcome", "fault"),
    [
        (Outcome("", 1, "", "Traceback (most recent call last):\n  x\nKeyError: 1\n"), "traceback"),
        (Outcome("", 70, "", "it has a fault"), "traceback"),
        (Outcome("", None, hung=True), "hang"),
        (Outcome("", -9), "died"),
        (Outcome("", 3, "", "error: x"), "false status"),
        (Outcome("", 0, "", "error: x"), "false status"),
        (Outcome("", 2, "", "error: x\x1b[31m"), "escape"),
        (Outcome("", 2, "", "oh dear"), "unclear line"),
        (Outcome("", 2, "", "what is this\nerror: x"), "unclear line"),
        (Outcome("", 0, "", "a.py:1: RuntimeWarning: overflow"), "stray warning"),
        (Outcome("", 0, "a | nan | 1"), "non-finite"),
    ],
)
def test_what_must_not_be_is_seen(outcome: Outcome, fault: str) -> None:
    assert faults_of(outcome) == {fault}


def test_files_are_judged(tmp_path: Path) -> None:
    for name, text in (
        ("a.json", '{"x": NaN}'),
        ("b.json", '{"x": '),
        (".x.part.json", "{}"),
        ("c.png", "PNG"),
        ("d.toml", "x ="),
    ):
        (tmp_path / name).write_text(text)
    found = judge.judge(Outcome("", 0, folder=tmp_path)).faults
    assert sorted(kind for kind, _ in found) == ["damaged file", "damaged file", "damaged file", "left over", "non-finite"]
    assert faults_of(Outcome("", 2, "", "error: x", tmp_path)) == {"left over", "wrote on a mistake"}
    assert "false claim" in faults_of(Outcome("", 0, "written: nothing.png", folder=tmp_path))


def test_results_are_compared_but_for_the_clock(tmp_path: Path) -> None:
    for name, cost, wall in (("one", 1.0, 2.0), ("other", 1.0, 3.0), ("third", 1.1, 3.0)):
        (tmp_path / name).mkdir()
        document = {"cost": cost, "wall_s": wall, "deep": [{"versions": {"x": wall}}]}
        (tmp_path / name / "a.json").write_text(json.dumps(document))
    one, other, third = (kills.result_of(tmp_path / name) for name in ("one", "other", "third"))
    assert one == other != third


def test_faults_are_counted_by_class() -> None:
    tally = report.Tally()
    tally.add(Case("a", "b", 0), judge.Verdict("what", False, 2, (("hang", "x"), ("hang", "y"), ("escape", "z"))))
    tally.add(Case("a", "b", 1), judge.Verdict("what", True, 1, ()))
    assert tally.as_dict()["faults"] == {"hang": 1, "escape": 1}
    assert (tally.inputs, tally.accepted) == (3, 1)
    assert "1 hang, 1 escape" in report.table({("a", "b"): tally})
