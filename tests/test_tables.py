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
from validation.show.tables import BEST_STYLE, NOTHING, Cell, Grid, length_unit, rich_table
from validation.simulator.health import Health

TERMINAL = 110  # columns: what the tables must fit
HEALTHY, UNHEALTHY = Health(0.9, 0.03), Health(0.0, 0.3)
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


@given(st.lists(metrics, min_size=5, max_size=5))
def test_the_terminal_shows_all_within_its_width(values: list[Metrics]) -> None:
    names = ("mujoco", "improved", "coulomb", "linear", "kinematic")
    speeds = (1e-2, 1.0, 73.9, 1e4, 123456.0)
    c = comparison(*(plant(n, m, speed=s) for n, m, s in zip(names, values, speeds, strict=True)), reference="kinematic")
    table = comparison_table(c)
    text = rendered(table)
    assert "…" not in text
    assert all(len(line) <= TERMINAL for line in text.splitlines())
    shown = text.split()
    assert all(cell in shown for row in rich_rows(table)[1] for cell in row[1:])


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


def test_the_usual_table_of_a_comparison_has_all_its_columns_on_a_usual_terminal() -> None:
    c = comparison(plant("mujoco", speed=204.0), plant("kinematic", speed=16600.0), reference="mujoco")
    (grid,) = [grid for grid in c.grids() if grid.header[0] == ("plant", "")]
    text = rendered(rich_table(grid, 80), 80)
    assert "left out" not in text
    assert "16600" in text
    assert "left out for want of room: yaw rms, real time" in rendered(rich_table(grid, 70), 70)


@given(st.dictionaries(st.sampled_from([0.5, 2.0, 6.0, 30.0]), st.tuples(errors, errors), min_size=1))
def test_every_horizon_of_every_plant_is_there(by_horizon: dict[float, tuple[HorizonErrors, HorizonErrors]]) -> None:
    c = comparison(
        *(plant(n, METRICS, {h: e[k] for h, e in by_horizon.items()}) for k, n in enumerate(("mujoco", "linear")))
    )
    table = horizon_table(c)
    assert table is not None
    header, rows, best = rich_rows(table)
    assert (header, rows, best) == markdown_tables(comparison_markdown(c))[0]
    assert all(len(line) <= TERMINAL and "…" not in line for line in rendered(table).splitlines())
    assert [(float(row[0]), row[1]) for row in rows] == [(h, n) for h in sorted(by_horizon) for n in c.plants]
    for row in rows:
        e = c.plants[row[1]].horizons[float(row[0])]
        assert int(row[2]) == e.n
        wanted = (e.position_median_m, e.position_p95_m, e.yaw_median_rad, e.yaw_p95_rad)
        for heading, cell, value in zip(header[3:], row[3:], wanted, strict=True):
            got, rounding = in_si(heading, cell)
            assert got == pytest.approx(value, abs=rounding, rel=ROUNDOFF)
    assert [h.split("[")[1] for h in header[3:]] == ["m]", "m]", "deg]", "deg]"]


def test_without_horizons_there_is_no_table_of_them() -> None:
    c = comparison(plant("mujoco"), plant("linear"), reference="mujoco")
    assert horizon_table(c) is None
    assert len(markdown_tables(comparison_markdown(c))) == 1


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


@pytest.mark.parametrize("reference", ["recording", "mujoco"])
def test_who_competes_with_nobody_is_not_the_best(reference: str) -> None:
    plants = [plant("linear"), plant("mujoco")] if reference == "mujoco" else [plant("linear")]
    c = comparison(*plants, reference=reference)
    distances = {h for _, h in rich_rows(comparison_table(c))[2]} - {"real time [×]"}
    assert not distances


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


def test_the_reference_is_marked() -> None:
    c = comparison(plant("improved"), plant("mujoco"), reference="improved")
    assert [row[0] for row in rich_rows(comparison_table(c))[1]] == ["improved (ref)", "mujoco"]
    assert "compared with improved" in rendered(comparison_table(c))


def test_the_report_says_how_it_was_run_and_what_each_metric_means() -> None:
    c = comparison(plant("mujoco"), plant("linear"))
    c = replace(c, options={**c.options, "horizons": (2.0, 6.0)})  # type: ignore[dict-item]
    text = comparison_markdown(c)
    for what in (
        "`drive.csv`",
        "`thesis-lab`",
        "`recording`",
        "seed: 7",
        "noise yes",
        "from_s 12.5",
        "horizons 2,6",
        "mujoco 3.17.0",
    ):
        assert what in text
    for column in COLUMNS:
        assert len(re.findall(rf"^- \*\*{re.escape(column.label)}\*\*: .*\.$", text, flags=re.MULTILINE)) == 1
    assert text.endswith(".\n")


def test_an_unhealthy_plant_gets_the_advice_and_a_healthy_one_does_not() -> None:
    sick = comparison(plant("mujoco", health=UNHEALTHY), plant("linear"))
    sound = comparison(plant("mujoco", health=HEALTHY), plant("linear"))
    assert UNHEALTHY.advice in comparison_markdown(sick)
    assert "unhealthy" in rendered(comparison_table(sick))
    assert "unhealthy" not in comparison_markdown(sound) + rendered(comparison_table(sound))


def test_a_trembling_plant_gets_advice_but_is_not_called_unhealthy() -> None:
    trembling = replace(
        HEALTHY, apparent_mass_kg=361.52, load_sum_rms_N=10.8, weight_N=719.0, slip_speed_m_s=0.28, slip_limit_m_s=1.03,
        ride_rise_m=0.0012,
    )  # fmt: skip
    c = comparison(plant("mujoco", health=trembling), plant("linear", health=HEALTHY))
    text = comparison_markdown(c)
    assert "- mujoco: " in text
    assert "smooth the given wheel rates" in text
    assert "unhealthy" not in text
    (grid,) = [grid for grid in c.grids() if grid.title == "Health"]
    assert [[cell.text for cell in row] for row in grid.groups[0]] == [
        ["mujoco", "361.5", NOTHING, "10.8", "0.28", "1.03", "1.2", "loads tremble"]
    ]
    assert not any(grid.title == "Health" for grid in comparison(plant("mujoco", health=HEALTHY)).grids())


def test_what_the_user_named_is_never_markup() -> None:
    c = comparison(plant("mujoco"), plant("li|near"), source="a|b`c*[red]\n# d[/]", reference="mujoco")
    text = comparison_markdown(c)
    assert "- source: `a|b'c*[red] # d[/]`\n" in text
    assert markdown_tables(text)[0][1][1][0] == r"li\|near"
    assert "a|b`c*[red] # d[/]" in rendered(comparison_table(c))


def test_the_headline_is_the_error_after_six_seconds_or_d_rms() -> None:
    errors = {2.0: ERRORS, 5.0: replace(ERRORS, position_median_m=0.0512, yaw_median_rad=math.radians(4.44)), 30.0: ERRORS}
    c = comparison(plant("mujoco", METRICS, errors), plant("linear"))
    assert headline_error(c, "mujoco") == "51 mm, 4.4° in 5 s"
    assert headline_error(c, "linear") == "d_rms 14.5 mm"
