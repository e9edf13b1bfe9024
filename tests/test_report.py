"""Tables show every number, with its unit and digits, the best marked, at any width."""

from __future__ import annotations

import json
import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

from tests.conftest import metrics_of
from validation.report.columns import NOTHING, length_unit
from validation.report.report import Report
from validation.report.table import Cell, Grid, Row, Table, text_tables

texts = st.text("abcdefg hijkl 0123456789", min_size=1, max_size=30).map(
    lambda t: " ".join(t.split()) or "x"
)
numbers = st.floats(-1e6, 1e6).map("{:.4g}".format)


def cells(table: Table) -> list[list[Cell]]:
    return [list(row) for group in table.grid().groups for row in group]


def report(*rows: Row) -> Report:
    return Report(
        program="made-up",
        title="Made up",
        tables=[Table("Rows", rows)],
        document={"schema": "x/1"},
        draw=Figure,
    )


@given(
    st.lists(st.tuples(texts, *[numbers] * 7, texts), min_size=1, max_size=4),
    st.sampled_from([60, 80, 200]),
)
def test_a_narrow_terminal_shows_fewer_numbers_but_all_their_digits(
    rows: list[tuple[str, ...]], width: int
) -> None:
    header = (("who", ""), *((f"n{k} of all", "mm") for k in range(7)), ("remark", ""))
    grid = Grid(header, (tuple(tuple(map(Cell, row)) for row in rows),), 1, trailing=1)
    text = text_tables([grid], (), width)
    lines = text.splitlines()
    assert all(len(line) <= width and "…" not in line for line in lines)
    shown = [k for k in range(7) if f"n{k}" in text.partition("left out")[0].split()]
    assert shown == list(range(len(shown)))
    assert shown
    missing = re.findall(
        r"n\d of all", " ".join(" ".join(lines).partition("left out for want of room:")[2].split())
    )
    assert missing == [f"n{k} of all" for k in range(len(shown), 7)]
    assert width < 200 or len(shown) == 7
    for row in rows:
        assert all(number in " ".join(lines).split() for number in row[1 : 1 + len(shown)])


def test_units_stand_in_the_heading_and_are_those_of_the_key() -> None:
    row = {
        "who": "a",
        "way_m": 0.0123,
        "turn_rad": math.pi,
        "speed_m_s": 0.5,
        "push_N": 12.4,
        "n": 7,
        "loss_share": 0.25,
    }
    table = Table("Rows", [{**row, "median_m": (0.2, 0.1, 0.3)}])
    assert [unit for _, unit in table.grid().header] == ["", "mm", "deg", "m/s", "N", "", "%", "mm"]
    (texts,) = cells(table)
    written = [cell.text for cell in texts]
    assert written == ["a", "12.3", "180.00", "0.50", "12", "7", "25.0", "200.0 (100.0–300.0)"]


def test_the_best_of_each_column_is_marked_and_the_reference_only_for_speed() -> None:
    ideal, near, far = (
        metrics_of(d, d, r, 1.0, d, d, d, d) for d, r in ((0.0, 1.0), (0.01, 1.9), (0.02, 0.6))
    )
    rows = [
        {"plant": name, **metrics, "real_time_factor": speed}
        for name, metrics, speed in (
            ("ref", ideal, 900.0),
            ("near", near, 10.0),
            ("far", far, 20.0),
        )
    ]
    table = Table("Metrics", rows, best=True, reference="ref")
    marked = [
        [key for key, cell in zip(table.keys, row, strict=True) if cell.best]
        for row in cells(table)
    ]
    assert marked[0] == ["real_time_factor"]
    assert "d_rms_m" in marked[1]
    assert marked[2] == ["d_ratio", "e_bend_ratio"], (
        "1/0.6 is nearer to 1 than 1.9; equal texts are marked alike"
    )
    assert "e_bend_ratio" in marked[1]


def test_what_is_no_number_is_a_dash_and_never_the_best() -> None:
    rows = [
        {"plant": "broken", "d_rms_m": math.nan},
        {"plant": "a", "d_rms_m": 0.2},
        {"plant": "none", "d_rms_m": None},
    ]
    broken, a, none = (row[1] for row in cells(Table("Rows", rows, best=True)))
    assert broken == none == Cell(NOTHING)
    assert a.text == "200.0"


@pytest.mark.parametrize(
    ("values", "symbol", "text"),
    [
        ([0.0145, 0.3], "mm", "14.5"),
        ([0.0146, 1.0], "m", "0.015"),
        ([0.0042], "mm", "4.200"),
        ([0.0], "mm", "0.0"),
    ],
)
def test_lengths_are_in_the_unit_that_reads_best(
    values: list[float], symbol: str, text: str
) -> None:
    unit = length_unit(values)
    assert unit.symbol == symbol
    assert unit.text(values[0]) == text
    assert unit.text(-1e-9) == unit.text(0.0), "no negative zero"


def test_a_report_is_the_same_rows_in_every_form() -> None:
    made = report(
        {"name": "a [mm]", "way_m": 0.5, "hidden": None}, {"name": "b", "way_m": math.nan}
    )
    document = json.loads(json.dumps(made.as_dict()))
    assert document["schema"] == "x/1"
    assert document["tables"]["Rows"][1] == {"name": "b", "way_m": None}
    assert "a [mm]" in made.table(80)
    assert "500.0" in made.markdown()
    with pytest.raises(ValueError, match="there is no table 'other'; there are: Rows"):
        made.frame("other")
