"""A fit in words and as a recording: every number to the digits known, doubts said, motions as they were given."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rerun.chunk import RrdReader
from rich.table import Table

from ssmr.types import FloatArray
from tests.test_fit_figure import CASES, interrupted, many, parameter, recorded, result
from tests.test_rerun_log import run_rerun
from tests.test_tables import TERMINAL, in_si, markdown_tables, rendered, rich_rows
from validation.fit.data import FittedParameter
from validation.fit.rerun import as_comparison, write_fit_recording
from validation.fit.result import FitResult
from validation.fit.table import fit_markdown, fit_notes, is_vague, number_text, unit_text, value_text
from validation.show.result import Result
from validation.show.tables import NOTHING, rich_table

ONE = FittedParameter("friction", "1", 0.5, 0.1, 1.2, "linear", 0.4, at_bound=False)


def tables_of(made: Result) -> list[Table]:
    return [rich_table(grid) for grid in made.grids()]


# --- words ---


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (0.52345, 0.00412, "0.523 ± 0.004"),
        (0.52345, 0.00345, "0.5234 ± 0.0034"),
        (0.52345, 0.00097, "0.5234 ± 0.0010"),
        (523.45, 41.2, "520 ± 40"),
        (523.45, 150.0, "520 ± 150"),
        (-0.0001, 0.4, "0.0 ± 0.4"),
        (0.52345, 1e-12, "0.5234500 ± 1e-12"),
        (0.52345, None, "0.5234"),
        (0.52345, math.nan, "0.5234"),
        (0.52345, 0.0, "0.5234"),
        (0.0, 0.02, "0.000 ± 0.020"),
    ],
)
def test_digits_follow_the_standard_error(value: float, error: float | None, text: str) -> None:
    assert value_text(replace(ONE, value=value, standard_error=error)) == text


@given(st.floats(-1e4, 1e4), st.floats(1e-4, 1e4))
def test_rounding_takes_little_of_what_is_known(value: float, error: float) -> None:
    written = [float(part) for part in value_text(replace(ONE, value=value, standard_error=error)).split(" ± ")]
    coarse = 0.5e-6 * abs(value) * 10.0  # of seven digits the last
    assert written[0] == pytest.approx(value, abs=0.15 * error + coarse)
    assert written[1] == pytest.approx(error, rel=0.15, abs=coarse)


def test_shares_of_the_bounds_are_those_of_the_search() -> None:
    gain = parameter("gain", 0.25, 0.01)
    assert gain.share(gain.value) == pytest.approx(0.25)
    assert gain.share(0.0) == -math.inf
    assert ONE.share(0.65) == pytest.approx(0.5)
    assert not is_vague(parameter("gain", 0.5, 0.12))
    assert is_vague(parameter("gain", 0.5, 0.14)), "the interval is of the searched scale"
    assert not is_vague(ONE)


@pytest.mark.parametrize("name", CASES)
def test_tables_say_the_same_in_both_forms_and_fit_a_terminal(name: str) -> None:
    made = CASES[name]()
    tables = tables_of(made)
    in_markdown = markdown_tables(fit_markdown(made))
    assert [rich_rows(table)[:2] for table in tables] == [(header, rows) for header, rows, _ in in_markdown]
    for table in tables:
        text = rendered(table)
        assert all(len(line) <= TERMINAL for line in text.splitlines())
        assert all(cell in text for row in rich_rows(table)[1] for cell in row)
    assert len(tables) == (4 if made.train_horizons else 2)


@pytest.mark.parametrize("make", [recorded, many, interrupted])
def test_every_parameter_has_its_row(make: Callable[[], FitResult]) -> None:
    made = make()
    _, rows, _ = rich_rows(tables_of(made)[0])
    for p, row in zip(made.parameters, rows, strict=True):
        assert row[:3] == [p.name, unit_text(p.unit), value_text(p)]
        assert [float(row[3]), float(row[4])] == pytest.approx([p.lower, p.upper])
        assert row[5] == number_text(p.before)
        assert ("at bound" in row[6]) == p.at_bound
        assert ("uncertain" in row[6]) == is_vague(p)
    if make is many:
        assert rows[-1][5] == "off", "a limit that was off"


def test_every_source_has_its_scores() -> None:
    made = recorded()
    header, rows, _ = rich_rows(tables_of(made)[1])
    labels = ["tile_17.csv (wheels)", "tile_17.csv (commands)"]
    assert [row[0] for row in rows] == [*labels, "all fitted to", *(f"held out: {label}" for label in labels)]
    every = [*(s.metrics for s in made.train), made.train_metrics, *(s.metrics for s in made.held_out)]
    for row, m in zip(rows, every, strict=True):
        wanted = (m["d_rms_m"], m["d_haus_m"], m["d_ratio"], m["sync_rms_m"], m["yaw_rms_rad"])
        for heading, cell, value in zip(header[1:], row[1:], wanted, strict=True):
            got, rounding = in_si(heading, cell)
            assert got == pytest.approx(value, abs=rounding)
    header, rows, _ = rich_rows(tables_of(made)[2])
    assert header[1:] == [f"{w} {h} s [{u}]" for w, u in (("position", "m"), ("yaw", "deg")) for h in (2, 6, 30)]
    for heading, cell in zip(header[1:], rows[0][1:], strict=True):
        what, horizon = heading.split()[:2]
        errors = made.train[0].horizons[float(horizon)]
        got, rounding = in_si(heading, cell)
        assert got == pytest.approx(errors.position_median_m if what == "position" else errors.yaw_median_rad, abs=rounding)


def test_medians_over_overlapping_windows_have_their_intervals_and_stand_in_the_file() -> None:
    made = recorded()
    header, rows, _ = rich_rows(tables_of(made)[3])
    for source in (*made.train, *made.held_out):
        for horizon, errors in source.windows.items():
            e = errors.summary()
            wanted = [
                row for row in rows
                if row[0] == f"{horizon:g}" and ("held out" in row[1]) == (source in made.held_out) and row[2] == str(e.n)
            ]  # fmt: skip
            assert wanted
            told = (
                (e.position_median_m, e.position_low_m, e.position_high_m),
                (e.yaw_median_rad, e.yaw_low_rad, e.yaw_high_rad),
            )
            for heading, cell, values in zip(header[3:], wanted[0][3:], told, strict=True):
                for text, value in zip(re.findall(r"[0-9.]+", cell), values, strict=True):
                    got, rounding = in_si(heading, text)
                    assert got == pytest.approx(value, abs=rounding)
    document = made.as_dict()
    for source in made.held_out:
        told = document["held_out"][source.label]["horizons"]
        assert {h: entry["overlapping"] for h, entry in told.items()} == {
            f"{h:g}": asdict(errors.summary()) for h, errors in source.windows.items()
        }
    assert document["train"]["horizons"]["6"]["overlapping"]["n"] == made.train_windows[6.0].summary().n


def test_a_horizon_that_is_longer_than_a_source_is_a_dash() -> None:
    made = recorded()
    held = (replace(made.held_out[0], horizons={2.0: made.held_out[0].horizons[2.0]}),)
    _, rows, _ = rich_rows(tables_of(replace(made, held_out=held))[2])
    assert rows[-1][2:4] == [NOTHING, NOTHING]


def test_notes_say_what_is_doubtful_and_how_errors_were_found() -> None:
    assert fit_notes(recorded()) == [*recorded().remarks, f"Standard errors come from: {recorded().uncertainty_method}."]
    (note,) = fit_notes(interrupted())
    assert "interrupted" in note
    text = fit_markdown(interrupted())
    assert "INTERRUPTED after 2 generations" in text
    assert note in text
    assert "INTERRUPTED" in rendered(tables_of(interrupted())[0])
    assert "INTERRUPTED" not in fit_markdown(recorded()) + rendered(tables_of(recorded())[0])


# --- the recording ---


def read(path: Path) -> dict[str, dict[str, tuple[FloatArray | None, list[Any]]]]:
    """By entity and component: stamps [s] or steps, None where static; and values."""
    found: dict[str, dict[str, tuple[FloatArray | None, list[Any]]]] = {}
    for chunk in RrdReader(path).stream():
        batch, entity = chunk.to_record_batch(), chunk.entity_path.removeprefix("/")
        at = None
        if not chunk.is_static:
            (timeline,) = chunk.timeline_names
            at = np.array(batch.column(timeline).cast("int64").to_pylist(), dtype=np.float64)
            at *= 1e-9 if timeline == "sim_time" else 1.0
        for name in batch.schema.names:
            found.setdefault(entity, {})[name] = (at, batch.column(name).to_pylist())
    return found


@pytest.mark.parametrize("name", ["scenario", "recording", "fitted to itself", "nothing before"])
def test_the_recording_has_truth_fitted_and_before_and_rerun_takes_it(tmp_path: Path, name: str) -> None:
    made, path = CASES[name](), tmp_path / "fit.rrd"
    first = made.train[0]
    write_fit_recording(made, path)
    checked = run_rerun("rrd", "verify", path)
    assert checked.returncode == 0, checked.stderr
    assert list(tmp_path.iterdir()) == [path]
    entities = read(path)
    truth = "truth" if first.reference_name == made.model else first.reference_name
    robots = {entity.split("/")[1] for entity in entities if entity.startswith("world/") and entity.endswith("/robot")}
    assert robots == {truth, made.model} | ({"before"} if first.before else set())
    assert entities["report"]["TextDocument:text"][1] == [[fit_markdown(made)]]
    for plant, pieces in ((made.model, first.motion), ("before", first.before)):
        if pieces:
            at, values = entities[f"plots/position_error/{plant}"]["Scalars:scalars"]
            apart = np.concatenate([np.hypot(*(p.xy - r.xy).T) for p, r in zip(pieces, first.truth, strict=True)])
            assert np.ravel(values) == pytest.approx(apart, abs=1e-9)
            assert at == pytest.approx(np.concatenate([p.t for p in first.truth]))
            assert f"plots/yaw_error/{plant}" in entities


def test_the_cost_has_a_timeline_of_its_own(tmp_path: Path) -> None:
    made = result()
    best = made.trace.best_cost.copy()
    best[0] = np.inf
    write_fit_recording(replace(made, trace=replace(made.trace, best_cost=best)), tmp_path / "fit.rrd")
    at, values = read(tmp_path / "fit.rrd")["history/cost"]["Scalars:scalars"]
    assert at is not None
    assert np.array_equal(at, np.arange(40))
    shown = np.array(values, dtype=np.float64)
    assert np.isnan(shown[0, 0])
    assert np.array_equal(shown[1:], np.column_stack([best, made.trace.median_cost])[1:])


def test_bodies_stand_by_the_tracked_point_that_was_fitted() -> None:
    made = result(1, parameters=(parameter("tracked_x", 0.75, 0.01), parameter("tracked_y", 0.5, 0.01)))
    shown = as_comparison(made)
    assert shown.plants["mujoco"].localiser.point == pytest.approx((0.2, 0.0))
    assert shown.plants["before"].localiser.point == pytest.approx(tuple(p.before for p in made.parameters))
    assert shown.plants["improved"].localiser.point == (0.0, 0.0)
    assert shown.commands == ()
