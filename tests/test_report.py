"""Tables show every number, with its unit and digits, the best marked, at any width."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import metrics_of
from validation.report.columns import NOTHING, Unit, length_unit
from validation.report.report import Report
from validation.report.table import Row, Table, text_tables

texts = st.text("abcdefg hijkl 0123456789", min_size=1, max_size=30).map(
    lambda t: " ".join(t.split()) or "x"
)
numbers = st.integers(-1_000_000, 1_000_000)


@dataclass(frozen=True, eq=False, kw_only=True)
class MadeUp(Report):
    """A report of rows."""

    program = "made-up"
    rows: Sequence[Row]

    def tables(self) -> list[Table]:
        """Return the rows."""
        return [Table("Rows", self.rows)]

    def document(self) -> dict[str, Any]:
        """Return a schema."""
        return {"schema": "x/1"}


@given(
    st.lists(st.tuples(texts, *[numbers] * 7, texts), min_size=1, max_size=4),
    st.sampled_from([60, 80, 200]),
)
def test_a_narrow_terminal_shows_fewer_numbers_but_all_their_digits(
    rows: list[tuple[Any, ...]], width: int
) -> None:
    keys = ("who", *(f"n{k} of all" for k in range(7)), "remark")
    units = {key: Unit("mm", 1.0, 0) for key in keys}
    table = Table("", [dict(zip(keys, row, strict=True)) for row in rows], units=units)
    text = text_tables([table], (), width)
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
        assert all(str(number) in " ".join(lines).split() for number in row[1 : 1 + len(shown)])


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
    columns = table.columns()
    assert [c.unit for c in columns] == ["", "mm", "deg", "m/s", "N", "", "%", "mm"]
    assert [c.texts[0] for c in columns] == [
        "a",
        "12.3",
        "180.00",
        "0.50",
        "12",
        "7",
        "25.0",
        "200.0 (100.0–300.0)",
    ]


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
    columns = table.columns()
    marked = [
        [key for key, c in zip(table.keys, columns, strict=True) if i in c.best] for i in range(3)
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
    _, distance = Table("Rows", rows, best=True).columns()
    assert distance.texts == [NOTHING, "200.0", NOTHING]
    assert not distance.best


@pytest.mark.parametrize(
    ("values", "symbol", "text"),
    [
        ([0.0145, 0.3], "mm", "14.5"),
        ([0.0146, 1.0], "m", "0.015"),
        ([0.0042], "mm", "4.2"),
        ([0.00042], "mm", "0.420"),
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
    rows = ({"name": "a [mm]", "way_m": 0.5, "hidden": None}, {"name": "b", "way_m": math.nan})
    made = MadeUp(title="Made up", rows=rows)
    document = json.loads(json.dumps(made.as_dict()))
    assert document["schema"] == "x/1"
    assert document["tables"]["Rows"][1] == {"name": "b", "way_m": None}
    assert "a [mm]" in made.table(80)
    assert "500.0" in made.to_markdown()
    with pytest.raises(ValueError, match="there is no table 'other'; there are: Rows"):
        made.frame("other")
