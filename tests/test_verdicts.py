"""Verdicts: the rules at their edges, and reasons that point at something there is."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from validation.replicate import published
from validation.replicate.verdicts import (
    EVIDENCE,
    FACTOR,
    RATIO_REACH,
    SPREADS,
    STATUSES,
    SUPPOSED_ON,
    UNEXPLAINED,
    Entry,
    Pair,
    Verdict,
    criterion_of,
    entries_of,
    judge_number,
    judge_row,
)

DOCS = Path(__file__).resolve().parents[1] / "docs"
POSITIVE = st.floats(1e-4, 1e4)


def status(pair: Pair) -> str:
    return judge_number("0.0", "row", "metric", pair, ()).status


@pytest.mark.parametrize(
    ("pair", "verdict"),
    [
        (Pair(0.010, 0.010 * FACTOR, "distance"), "agrees"),
        (Pair(0.010, 0.010 * FACTOR * 1.001, "distance"), "differs"),
        (Pair(0.010, 0.010 / FACTOR, "distance"), "agrees"),
        (Pair(0.010, 0.010 / FACTOR / 1.001, "distance"), "nearer"),
        (Pair(0.0108, 0.0259, "distance", spread=0.020), "not told apart"),
        (Pair(0.010, 0.011, "distance", spread=0.020), "agrees"),
        (Pair(0.010, 0.0301, "distance", spread=0.010), "differs"),
        (Pair(0.010, 0.0, "distance"), "nearer"),
        (Pair(1.0, 1.0 + RATIO_REACH, "ratio"), "agrees"),
        (Pair(1.0, 1.0 + 1.01 * RATIO_REACH, "ratio"), "differs"),
        (Pair(1.0, 1.0 - 1.01 * RATIO_REACH, "ratio"), "differs"),
        (Pair(1.0, 1.03, "ratio", spread=0.015), "not told apart"),
        (Pair(5.0, 5.0 + SPREADS, "spread", spread=1.0), "agrees"),
        (Pair(5.0, 5.1 + SPREADS, "spread", spread=1.0), "differs"),
        (Pair(5.0, 5.0, "spread"), "agrees"),
        (Pair(5.0, 5.0001, "spread"), "differs"),
        (Pair(5.0, 6.0, "spread", spread=1.0, bounds=(0.0, 8.1)), "agrees"),
        (Pair(5.0, 6.0, "spread", spread=1.0, bounds=(1.0, 8.9)), "not told apart"),
        (Pair(5.0, 9.0, "spread", spread=2.0, bounds=(0.0, 10.0)), "not told apart"),
        (Pair(5.0, 9.6, "spread", spread=0.1, bounds=(0.0, 10.0)), "not compared"),
        (Pair(0.2, 0.3, "spread", spread=1.0, printed_bounds=(0.0, 4.0)), "not compared"),
        # a number outside the range that is printed beside it lies at no end of it
        (Pair(-1.0, 0.3, "spread", spread=1.0, printed_bounds=(0.0, 4.0)), "agrees"),
        # a search by factors has 30 in the middle of 10 to 90, and 12 at its end
        (Pair(29.0, 30.0, "spread", spread=1.0, bounds=(10.0, 990.0), scale="log"), "agrees"),
        (Pair(29.0, 30.0, "spread", spread=1.0, bounds=(10.0, 990.0)), "not compared"),
        (Pair(12.0, 10.1, "spread", spread=1.0, bounds=(10.0, 90.0), scale="log"), "not compared"),
        (Pair(12.0, 12.0, "spread", spread=4.0, bounds=(10.0, 1000.0)), "not compared"),
        (
            Pair(30.0, 30.0, "spread", spread=14.0, bounds=(1.0, 100.0), scale="log"),
            "not told apart",
        ),
        (Pair(30.0, 30.0, "spread", spread=3.0, bounds=(1.0, 100.0), scale="log"), "agrees"),
        (Pair(None, 1.0, "distance"), "not compared"),
        (Pair(1.0, None, "distance"), "not compared"),
        (Pair(1.0, 1.0, "none"), "not compared"),
        (Pair(1.0, 1.0, "distance", obstacle="it was lost"), "not compared"),
    ],
)
def test_rules_at_their_edges(pair: Pair, verdict: str) -> None:
    assert status(pair) == verdict


@given(POSITIVE, POSITIVE)
def test_agreeing_in_distance_is_mutual(a: float, b: float) -> None:
    assert (status(Pair(a, b, "distance")) == "agrees") == (
        status(Pair(b, a, "distance")) == "agrees"
    )


@pytest.mark.parametrize(
    ("share", "spread", "verdict"),
    [
        (0.05, 0.0, "agrees"),
        (0.8, 0.0, "agrees"),
        (1.0, 0.05, "differs"),
        (0.0, 0.0, "differs"),
        (1.0, 0.1, "not told apart"),
    ],
)
def test_words_have_two_sides(share: float, spread: float, verdict: str) -> None:
    """A robot that always drives straight does not drive straight "at some point"."""
    assert (
        judge_number(
            "Sec. 3.7", "pyramid", "straight_share", Pair(None, share, "words", spread=spread), ()
        ).status
        == verdict
    )


@given(POSITIVE, POSITIVE, st.floats(0.0, 10.0))
def test_no_error_bar_makes_numbers_agree(a: float, b: float, spread: float) -> None:
    """A wide one takes away what a difference says, never more."""
    without = status(Pair(a, b, "distance"))
    wide = status(Pair(a, b, "distance", spread=spread))
    assert wide in (without, "not told apart")
    assert (wide == "agrees") == (without == "agrees")


def test_every_criterion_names_rows_and_words_with_two_sides() -> None:
    for criterion in entries_of("criterion"):
        assert criterion.evidence in EVIDENCE
        assert all(low < high < float("inf") for low, high in criterion.within.values())
        for table in criterion.tables:
            rows = published.printed_table(table)["rows"] if table[0].isdigit() else {}
            for row in criterion.rows if rows else ():
                assert any(
                    r == row or (row.endswith("*") and r.startswith(row[:-1])) for r in rows
                ), (table, row)


def test_a_row_has_the_class_that_its_numbers_deserve() -> None:
    """A calibrated robot recovers its model, a repeated row repeats, chosen limits are assumed."""
    expected = {
        ("3.12", "traj1"): "recovered",
        ("4.14", "line_0.50"): "recovered",
        ("4.37", "pid_line_0.50"): "duplicate",
        ("3.8", "delay_w_s"): "duplicate",
        ("3.8", "u_x"): "recovered",
        ("4.6", "line_0.50"): "independent",
        ("4.23", "line_0.50"): "fitted",
        ("4.8", "circle_0.50"): "impossible",
        ("4.21", "K_y"): "impossible",
    }
    assert {key: criterion_of(*key).evidence for key in expected} == expected


@given(st.lists(st.sampled_from([s for s in STATUSES if s != "agrees if"]), min_size=1, max_size=4))
def test_a_row_is_judged_by_its_worst_number(statuses: list[str]) -> None:
    verdicts = {
        f"m{k}": Verdict(s, "" if s == "agrees" else f"because {s}") for k, s in enumerate(statuses)
    }  # type: ignore[arg-type]
    row = judge_row(dict.fromkeys(verdicts, Pair(1.0, 2.0, "distance")), verdicts)
    worst = next(
        s
        for s in ("differs", "nearer", "not told apart", "agrees", "not compared")
        if s in statuses
    )
    assert row.status == worst
    assert worst not in ("differs", "nearer") or "not compared" not in row.reason


def test_a_row_agrees_under_a_supposition_only_in_all_its_numbers() -> None:
    supposed = Pair(0.010, 0.010, "distance")
    pairs = {
        m: Pair(0.010, x, "distance", supposed=supposed, supposition="the floor was wet")
        for m, x in (("d_rms_m", 0.030), ("d_haus_m", 0.011))
    }
    rows = {
        "agrees if": pairs,
        "differs": {
            **pairs,
            "d_haus_m": replace(pairs["d_haus_m"], supposed=replace(supposed, ours=0.030)),
        },
        "agrees": {"d_haus_m": pairs["d_haus_m"]},
    }
    for status, row in rows.items():
        measured = judge_row(
            row, {m: judge_number("0.0", "row", m, pair, ()) for m, pair in row.items()}
        )
        assert measured.status == status
        assert status != "agrees if" or measured == Verdict(
            "agrees if", "it agrees if the floor was wet", SUPPOSED_ON
        )


def test_a_difference_without_reason_says_so_and_agreement_needs_none() -> None:
    about = {"tables": ("9.9",), "rows": ("a*",), "metrics": ("d_rms_m",), "when": ("differs",)}
    known = (Entry(text="the moon", see="page.md", **about),)  # type: ignore[arg-type]
    far, near, same = (Pair(1.0, x, "distance") for x in (9.0, 0.1, 1.0))
    assert judge_number("9.9", "a1", "d_rms_m", far, known) == Verdict(
        "differs", "the moon", "page.md"
    )
    for table, row, metric, pair in (
        ("9.8", "a1", "d_rms_m", far),
        ("9.9", "b", "d_rms_m", far),
        ("9.9", "a1", "d_haus_m", far),
        ("9.9", "a1", "d_rms_m", near),
    ):
        assert judge_number(table, row, metric, pair, known).reason == UNEXPLAINED
    assert judge_number("9.9", "a1", "d_rms_m", same, known) == Verdict("agrees")


def test_every_known_reason_is_about_something_printed_and_shown_on_a_page() -> None:
    errata = (DOCS / "errata.md").read_text(encoding="utf-8")
    for reason in entries_of("reason"):
        page, _, number = reason.see.partition(", ")
        assert (DOCS / page).is_file(), reason.see
        assert not number or re.search(rf"^\| {number} \|", errata, re.MULTILINE), reason.see
        assert not reason.text.endswith("."), reason.text
        assert set(reason.when) <= {"nearer", "differs"}
        for table in reason.tables:
            if not table[0].isdigit():
                continue
            rows = published.printed_table(table)["rows"]
            for row in reason.rows:
                assert any(
                    r == row or (row.endswith("*") and r.startswith(row[:-1])) for r in rows
                ), (table, row)
            metrics = {m for r in rows.values() for m in r}
            assert not rows or set(reason.metrics) <= metrics, (table, reason.metrics)
