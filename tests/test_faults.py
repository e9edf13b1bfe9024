"""A small share of the fault campaign with each run of the suite; `python -m tests.faults` is the whole."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from tests import faults
from tests.faults import Tally


@pytest.mark.filterwarnings("ignore")  # of libraries, on damaged files
@pytest.mark.parametrize("part", ["files", "numbers"])
def test_no_input_gets_more_than_a_clear_line(part: str) -> None:
    tallies = faults.PARTS[part](600, 0, 7)
    assert sum(t.inputs for t in tallies.values()) >= 200
    assert [fault for t in tallies.values() for fault in t.faults] == []


def test_the_campaign_notices_what_it_looks_for() -> None:
    def long_line() -> None:
        raise ValueError("x" * 2000)

    for call in (lambda: math.nan, lambda: 1 // 0, lambda: {}["x"], long_line):
        tally = Tally()
        faults.try_once(tally, "a fault", call)
        assert len(tally.faults) == 1
    tally = Tally()
    faults.try_once(tally, "no fault", lambda: float("x"))
    assert (tally.refused, tally.faults) == (1, [])


def test_results_are_compared_but_for_the_clock(tmp_path: Path) -> None:
    one, other = tmp_path / "a.json", tmp_path / "b.json"
    one.write_text(json.dumps({"cost": 1.0, "wall_s": 2.0, "deep": [{"versions": {"x": 1}}]}))
    other.write_text(json.dumps({"cost": 1.0, "wall_s": 3.0, "deep": [{"versions": {"x": 2}}]}))
    assert faults.outcome(one) == faults.outcome(other)
    other.write_text(json.dumps({"cost": 1.1, "wall_s": 3.0, "deep": [{}]}))
    assert faults.outcome(one) != faults.outcome(other)
