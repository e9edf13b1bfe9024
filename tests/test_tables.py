"""Tables say what they were given: every number, in both forms alike, the best marked, and no foreign text as markup."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from rich.table import Table
from rich.text import Text

from ssmr.metrics.declared import Metrics
from ssmr.metrics.poses import HorizonErrors
from ssmr.types import Commands, Trajectory
from tests.conftest import ROUNDOFF, metrics_of
from validation.compare import Comparison, PlantResult
from validation.compare.table import COLUMNS, comparison_markdown, headline_error
from validation.fit.data import FittedParameter
from validation.fit.table import value_text
from validation.show.tables import BEST_STYLE, NOTHING, Cell, Grid, length_unit, rich_table
from validation.simulator.health import Health

TERMINAL = 110  # columns: what the tables must fit
STANDSTILL = Trajectory(np.array([0.0, 1.0]), np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((2, 2)))
METRICS = metrics_of(0.0145, 0.0250, 1.0312, 0.98, 0.0151, 0.0260, 0.0202, 0.0349)
ERRORS = HorizonErrors(24, 0.074, 0.131, 0.0915, 0.2401)


def plant(
    name: str,
    metrics: Metrics = METRICS,
    horizons: Mapping[float, HorizonErrors] | None = None,
    speed: float = 100.0,
    health: Health | None = None,
) -> PlantResult:
    """A plant of which only the numbers matter."""
    return PlantResult(name, (STANDSTILL,), metrics, horizons or {}, 1.0, speed, health)


def comparison(*plants: PlantResult, reference: str = "recording", source: str = "drive.csv") -> Comparison:
    """A comparison of them."""
    return Comparison(
        source, "thesis-lab", reference, (STANDSTILL,), (Commands(1.0, np.zeros((1, 2))),), {p.name: p for p in plants}, 7,
        {"input": "commands", "noise": True, "from_s": 12.5}, {"ssmr-testbed": "0.1.0", "mujoco": "3.17.0"},
    )  # fmt: skip


def comparison_table(c: Comparison) -> Table:
    """Its table of metrics, for a terminal."""
    (grid,) = [
        grid for grid in c.grids() if grid.header[0] == ("plant", "") and not grid.title.startswith(("Wheel", "Health"))
    ]
    return rich_table(grid)


def horizon_table(c: Comparison) -> Table | None:
    """Its table of horizons, for a terminal."""
    first = c.grids()[0]
    return rich_table(first) if first.header[0][0] == "horizon" else None


def rendered(table: Table, width: int = TERMINAL) -> str:
    """What a terminal without colours would show."""
    console = Console(width=width, color_system=None)
    with console.capture() as capture:
        console.print(table)
    return capture.get()


def rich_rows(table: Table) -> tuple[list[str], list[list[str]], set[tuple[int, str]]]:
    """Header, cells, and which (row, column name) are emphasised."""
    header = [" ".join(str(column.header).split()) for column in table.columns]
    columns = [list(column.cells) for column in table.columns]
    assert all(isinstance(cell, Text) for column in columns for cell in column)
    best = {(i, header[k]) for k, c in enumerate(columns) for i, cell in enumerate(c) if cell.style == BEST_STYLE}  # type: ignore[union-attr]
    return header, [[str(cell) for cell in row] for row in zip(*columns, strict=True)], best


def markdown_tables(text: str) -> list[tuple[list[str], list[list[str]], set[tuple[int, str]]]]:
    """The same of each table in a markdown text; fails where a table is not one."""
    found = []
    for block in re.findall(r"(?:^\|.*\n)+", text, flags=re.MULTILINE):
        lines = [re.split(r"(?<!\\)\|", line)[1:-1] for line in block.splitlines()]
        assert len({len(line) for line in lines}) == 1, "rows of a table have equally many cells"
        header, rule, *rows = [[cell.strip() for cell in line] for line in lines]
        assert all(re.fullmatch(r":---|---:", cell) for cell in rule)
        best = {(i, header[k]) for i, row in enumerate(rows) for k, cell in enumerate(row) if cell.startswith("**")}
        found.append((header, [[cell.strip("*") for cell in row] for row in rows], best))
    return found


def in_si(header: str, text: str) -> tuple[float, float]:
    """The number a cell stands for, and half of its last digit: what rounding may have taken."""
    scale = {"mm": 1e-3, "m": 1.0, "deg": math.pi / 180.0, "1": 1.0, "×": 1.0, "s": 1.0, "1/s²": 1.0}[
        header.split("[")[1].rstrip("]")
    ]
    decimals = len(text.partition(".")[2])
    return float(text) * scale, 0.5 * 10.0**-decimals * scale * (1.0 + 1e-9)


lengths = st.floats(0.0, 50.0)
ratios = st.floats(0.01, 50.0)
metrics = st.builds(metrics_of, lengths, lengths, ratios, ratios, lengths, lengths, lengths, st.floats(0.0, math.pi))
errors = st.builds(HorizonErrors, st.integers(1, 999), lengths, lengths, st.floats(0.0, math.pi), st.floats(0.0, math.pi))


@given(st.lists(metrics, min_size=1, max_size=5), st.floats(1e-3, 1e6))
def test_every_metric_of_every_plant_is_there_to_its_last_digit(values: list[Metrics], speed: float) -> None:
    names = ("mujoco", "improved", "coulomb", "linear", "kinematic")
    c = comparison(*(plant(n, m, speed=speed) for n, m in zip(names, values, strict=False)), reference="mujoco")
    header, rows, best = rich_rows(comparison_table(c))
    assert (header, rows, best) == markdown_tables(comparison_markdown(c))[0]
    assert [row[0].removesuffix(" (ref)") for row in rows] == list(c.plants)
    for row, result in zip(rows, c.plants.values(), strict=True):
        for column, heading, cell in zip(COLUMNS, header[1:], row[1:], strict=True):
            assert heading.startswith(column.label)
            value, rounding = in_si(heading, cell)
            if column.unit == "×":
                rounding = max(rounding, 0.005 * speed)  # three digits are known
            known = {**result.metrics, "real_time_factor": result.real_time_factor}
            assert value == pytest.approx(known[column.name], abs=rounding, rel=ROUNDOFF)


texts = st.text("abcdefg hijkl 0123456789", min_size=1, max_size=30).map(lambda t: " ".join(t.split()) or "x")
numbers = st.floats(-1e6, 1e6).map("{:.4g}".format)


@given(st.lists(st.tuples(texts, *[numbers] * 7, texts), min_size=1, max_size=4), st.sampled_from([60, 80, 200]))
def test_a_narrow_terminal_shows_fewer_numbers_but_all_their_digits(rows: list[tuple[str, ...]], width: int) -> None:
    header = (("who", ""), *((f"n{k} of all", "mm") for k in range(7)), ("remark", ""))
    table = rich_table(Grid(header, (tuple(tuple(map(Cell, row)) for row in rows),), 1, trailing=1), width)
    lines = rendered(table, width).splitlines()
    assert all(len(line) <= width and "…" not in line for line in lines)
    shown = [k for k in range(7) if f"n{k}" in rendered(table, width).partition("left out")[0].split()]
    assert shown == list(range(len(shown)))
    assert shown
    missing = re.findall(r"n\d of all", " ".join(" ".join(lines).partition("left out for want of room:")[2].split()))
    assert missing == [f"n{k} of all" for k in range(len(shown), 7)]
    if width == 200:
        assert len(shown) == 7
    for row in rows:
        assert all(number in " ".join(lines).split() for number in row[1 : 1 + len(shown)])


def test_the_best_of_each_column_is_marked_and_the_reference_only_for_speed() -> None:
    worse = metrics_of(0.02, 0.03, 0.5, 1.9, 0.02, 0.03, 0.03, 0.04)
    ideal = metrics_of(0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0)
    better_ratio = Metrics({**worse, "d_ratio": 1.9, "e_bend_ratio": 0.5, "yaw_rms_rad": 0.03})
    c = comparison(
        plant("mujoco", ideal, speed=900.0), plant("linear", worse, speed=10.0), plant("coulomb", better_ratio, speed=20.0),
        reference="mujoco",
    )  # fmt: skip
    header, _, best = rich_rows(comparison_table(c))
    names = [h.split(" [")[0] for h in header]
    marked = {(i, names[header.index(h)]) for i, h in best}
    assert {(2, "d_ratio"), (1, "e_bend ratio"), (2, "yaw rms"), (0, "real time")} <= marked
    assert (0, "d_rms") not in marked
    assert {(1, "d_rms"), (2, "d_rms")} <= marked, "what is written alike is marked alike"


def test_what_is_no_number_is_a_dash_and_never_the_best() -> None:
    broken = Metrics({**METRICS, "d_rms_m": math.nan, "d_ratio": math.inf, "e_bend_ratio": 0.0})
    c = comparison(plant("mujoco", broken, {6.0: replace(ERRORS, yaw_median_rad=math.nan)}, speed=math.inf), plant("linear"))
    report = comparison_markdown(c)
    table, by_horizon = comparison_table(c), horizon_table(c)
    assert by_horizon is not None
    for text in (report, rendered(table), rendered(by_horizon), headline_error(c, "mujoco")):
        assert NOTHING in text
        assert not re.search(r"\b(nan|inf)\b", text, flags=re.IGNORECASE)
    _, rows, best = rich_rows(table)
    assert rows[0][1] == rows[0][3] == rows[0][-1] == NOTHING
    assert all(i == 1 for i, heading in best if heading.startswith(("d_rms [", "d_ratio", "e_bend")))


@pytest.mark.parametrize(
    ("values", "symbol", "text"),
    [
        ([0.0145, 0.3], "mm", "14.5"),
        ([0.0146, 1.0], "m", "0.015"),
        ([0.0042], "mm", "4.200"),
        ([0.0], "mm", "0.0"),
        ([], "mm", ""),
    ],
)
def test_lengths_are_in_the_unit_that_reads_best(values: list[float], symbol: str, text: str) -> None:
    unit = length_unit(values)
    assert unit.symbol == symbol
    assert not values or unit.text(values[0]) == text
    assert unit.text(-1e-9) == unit.text(0.0), "no negative zero"


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (0.52345, 0.00412, "0.523 ± 0.004"),
        (0.52345, 0.00345, "0.5234 ± 0.0034"),
        (523.45, 150.0, "520 ± 150"),
        (-0.0001, 0.4, "0.0 ± 0.4"),
        (0.52345, None, "0.5234"),
        (0.52345, math.nan, "0.5234"),
        (0.0, 0.02, "0.000 ± 0.020"),
    ],
)
def test_digits_follow_the_standard_error(value: float, error: float | None, text: str) -> None:
    fitted = FittedParameter("friction", "1", value, 0.1, 1.2, "linear", 0.4, at_bound=False, standard_error=error)
    assert value_text(fitted) == text
