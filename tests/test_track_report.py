"""Tracking and tuning in words, as documents and as a recording: every number finite and named, losses said plainly."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ssmr.metrics.declared import Metrics
from tests.test_fit_report import read, tables_of
from tests.test_rerun_log import SINGLE, run_rerun
from tests.test_tables import TERMINAL, in_si, markdown_tables, rendered, rich_rows
from tests.test_track_figure import CASES, followed, lost
from tests.test_tune_figure import CASES as TUNINGS
from validation import store
from validation.fit.table import number_text, value_text
from validation.show.tables import rich_table
from validation.track.rerun import TRAIL_HEIGHT, write_track_rerun
from validation.track.result import TrackResult
from validation.track.table import SHOWN_METRICS, track_grids, track_markdown, track_notes
from validation.tune.table import tune_notes

PATH_METRICS = {
    *("d_rms_m", "d_haus_m", "d_ratio", "e_bend_ratio", "d_rms_symmetric_m", "d_haus_symmetric_m", "sync_rms_m"),
    "yaw_rms_rad",
}
METRICS = PATH_METRICS | {
    *("e_rho_rms_m", "e_y_rms_m", "e_alpha_rms_rad", "u_rms_ratio", "saturated_fraction"),
    *("cross_track_max_m", "command_effort", "command_jerk"),
}


def numbers(value: Any) -> Iterator[float]:
    """Every number of a document, however deep."""
    if isinstance(value, Mapping):
        for v in value.values():
            yield from numbers(v)
    elif isinstance(value, list):
        for v in value:
            yield from numbers(v)
    elif isinstance(value, float | int):
        yield float(value)


# --- tables ---


@pytest.mark.parametrize("name", CASES)
def test_tables_hold_every_measure_in_both_forms_and_fit_a_terminal(name: str) -> None:
    made = CASES[name]()
    tables = list(map(rich_table, track_grids(made)))
    in_markdown = markdown_tables(track_markdown(made))
    assert [rich_rows(table)[:2] for table in tables] == [(header, rows) for header, rows, _ in in_markdown]
    (header, rows, _), (more, others, _) = map(rich_rows, tables)
    for k, r in enumerate(made):
        assert rows[k][0] == others[k][0] == r.plant + " (lost)" * r.run.lost
        cells = dict(zip(header[1:] + more[1:], rows[k][1:] + others[k][1:], strict=True))
        for measure in SHOWN_METRICS:
            ((heading, cell),) = [(h, c) for h, c in cells.items() if h.partition(" [")[0] == measure.label]
            if measure.unit == "share":
                assert float(cell) == pytest.approx(100.0 * r.metrics[measure.name], abs=0.051)
            else:
                got, rounding = in_si(heading, cell)
                assert got == pytest.approx(r.metrics[measure.name], abs=rounding)
    for table in tables:
        assert all(len(line) <= TERMINAL for line in rendered(table).splitlines())


def test_notes_say_who_was_lost_saturated_or_far_away() -> None:
    assert track_notes([followed("line", "kinematic")]) == []
    made = followed("sine", "linear")
    note = track_notes([lost(made, 150)])[0]
    assert "linear was lost at t = 1.19 s" in note
    saturated = replace(made, metrics=Metrics({**made.metrics, "saturated_fraction": 0.3}))
    assert any("at its limit 30% of the time" in note for note in track_notes([saturated]))
    assert any("keep 0.2 m behind" in note for note in track_notes(CASES["four"]()))
    for name in CASES:
        assert all(note in track_markdown(CASES[name]()) for note in track_notes(CASES[name]()))


# --- documents ---


@pytest.mark.parametrize("name", CASES)
def test_the_document_keeps_the_contract(name: str, tmp_path: Path) -> None:
    made = CASES[name]()
    first, document = made[0], TrackResult(tuple(made)).as_dict()
    store.write_json(tmp_path / "track.json", document)
    assert json.loads((tmp_path / "track.json").read_text()) == document
    assert document["schema"] == "ssmr.track/1"
    named = ("controller", "reference", "plant", "profile", "gains_name", "seed")
    assert [document[k] for k in named] == [getattr(first, k) for k in named]
    assert document["speed_m_s"] == first.speed
    assert document["gains"] == dict(first.gains)
    assert document["metrics"] == {**first.metrics, "lost": first.run.lost}
    assert set(first.metrics) == METRICS
    assert set(document["options"]) == set(first.options)
    assert document["versions"] == dict(first.versions)
    assert document["real_time_factor"] == pytest.approx(first.run.t[-1] / first.wall_s)
    assert list(document.get("beside", {})) == [r.plant for r in made[1:]]
    for r in made[1:]:
        assert set(document["beside"][r.plant]) > METRICS
        assert document["beside"][r.plant]["e_y_rms_m"] == r.metrics["e_y_rms_m"]
    assert all(map(math.isfinite, numbers(document)))


def test_numbers_that_are_not_finite_are_null() -> None:
    made = followed("line", "kinematic")
    worst = Metrics({**made.metrics, "e_y_rms_m": math.nan})
    odd = replace(made, metrics=worst, wall_s=0.0, options={"limit": [math.inf, 1.0]})
    document = TrackResult((odd,)).as_dict()
    assert document["metrics"]["e_y_rms_m"] is None
    assert document["real_time_factor"] is None
    assert document["options"] == {"limit": [None, 1.0]}


@pytest.mark.parametrize("name", TUNINGS)
def test_the_tuning_document_keeps_the_contract(name: str, tmp_path: Path) -> None:
    made = TUNINGS[name]()
    document = made.as_dict()
    store.write_json(tmp_path / "tune.json", document)
    assert json.loads((tmp_path / "tune.json").read_text()) == document
    assert document["schema"] == "ssmr.tune/1"
    assert document["source"] == ",".join(dict.fromkeys(f.reference for f in made.train))
    assert document["cost"] == (made.cost if math.isfinite(made.cost) else None)
    assert document["baseline_cost"] == (made.baseline_cost if math.isfinite(made.baseline_cost) else None)
    assert document["gains"] == dict(made.gains)
    for p in made.parameters:
        found = document["parameters"][p.name]
        assert found["standard_error"] is None
        assert [found[k] for k in ("value", "unit", "lower", "upper", "at_bound")] == [
            p.value,
            p.unit,
            p.lower,
            p.upper,
            p.at_bound,
        ]
        assert document["gains"][p.name] == p.value
    for key, every in (("train", made.train), ("held_out", made.held_out)):
        assert list(document[key]) == [f.label for f in every]
        for f in every:
            for who, cost, metrics in (
                ("tuned", f.tuned.cost, f.tuned.metrics),
                ("baseline", f.baseline.cost, f.baseline.metrics),
            ):
                found = document[key][f.label][who]
                assert set(found) == METRICS | {"cost", "lost"}
                assert found["cost"] == (cost if math.isfinite(cost) else None)
                assert found["d_haus_m"] == metrics["d_haus_m"]
    assert all(map(math.isfinite, numbers(document)))


@pytest.mark.parametrize("name", TUNINGS)
def test_tuning_tables_hold_every_gain_and_score_and_fit_a_terminal(name: str) -> None:
    made = TUNINGS[name]()
    tables = tables_of(made)
    _, gains, _ = rich_rows(tables[0])
    for p, row in zip(made.parameters, gains, strict=True):
        assert row[0] == p.name
        assert row[2] == value_text(p)
        assert row[5] == number_text(p.before)
        assert ("at bound" in row[6]) == p.at_bound
    header, rows, best = rich_rows(tables[1])
    assert header[:3] == ["reference", "gains", "cost"]
    every = [*made.train, *made.held_out]
    for k, f in enumerate(every):
        tuned, baseline = rows[2 * k : 2 * k + 2]
        assert tuned[0].removeprefix("held out: ") == f.label
        assert tuned[0].startswith("held out") == (k >= len(made.train))
        assert (tuned[2] == "lost") == f.tuned.lost
        assert (baseline[2] == "lost") == f.baseline.lost
        if f.tuned.lost or f.baseline.lost:
            assert not {(2 * k, "cost"), (2 * k + 1, "cost")} & best
        else:
            assert (2 * k, "cost") in best
    for table in tables:
        assert all(len(line) <= TERMINAL for line in rendered(table).splitlines())
    assert sum(" lose " in note for note in tune_notes(made)) == sum(f.tuned.lost + f.baseline.lost for f in every)


# --- the recording ---


@pytest.mark.parametrize("name", ["one", "four", "lost", "lost at once"])
def test_the_recording_has_reference_target_robots_and_plots_and_rerun_takes_it(tmp_path: Path, name: str) -> None:
    made, path = CASES[name](), tmp_path / "track.rrd"
    write_track_rerun(made, path)
    checked = run_rerun("rrd", "verify", path)
    assert checked.returncode == 0, checked.stderr
    assert list(tmp_path.iterdir()) == [path]
    entities = read(path)
    robots = {entity.split("/")[1] for entity in entities if entity.startswith("world/") and entity.endswith("/robot")}
    assert robots == {r.plant for r in made}
    assert entities["report"]["TextDocument:text"][1] == [[track_markdown(made)]]
    longest = max((r.target for r in made), key=len)
    at, places = entities["world/target"]["Transform3D:translation"]
    assert at is not None
    assert np.ravel(places)[-3:-1] == pytest.approx(longest.xy[-1], rel=SINGLE, abs=SINGLE)
    assert "LineStrips3D:strips" in entities["world/reference/path"]
    for r in made:
        at, trails = entities[f"world/{r.plant}/trail"]["LineStrips3D:strips"]
        assert at is not None
        assert at[-1] == pytest.approx(r.run.t[-1])
        lengths = [len(trail[0]) for trail in trails]
        assert lengths == sorted(lengths)
        assert np.asarray(trails[-1][0])[-1] == pytest.approx(
            [*r.run.columns("x", "y")[-1], TRAIL_HEIGHT], rel=1e-6, abs=1e-6
        )
        columns = {
            f"speed/{r.plant}": "v_x",
            f"speed/{r.plant}_wanted": "u_ref",
            f"speed/{r.plant}_command": "v_cmd",
            f"yaw_rate/{r.plant}": "yaw_rate",
            f"yaw_rate/{r.plant}_wanted": "w_ref",
            f"yaw_rate/{r.plant}_command": "w_cmd",
            **{f"{error}/{r.plant}": error for error in ("e_rho", "e_y", "e_alpha")},
        }
        for entity, column in columns.items():
            at, values = entities[f"plots/{entity}"]["Scalars:scalars"]
            assert at == pytest.approx(r.run.t, abs=1e-9)
            assert np.array_equal(np.ravel(values), r.run.column(column))
        _, torques = entities[f"plots/torque/{r.plant}"]["Scalars:scalars"]
        assert np.array_equal(np.array(torques), r.run.columns("torque_left", "torque_right"))


def test_a_repeated_run_is_the_same_recording_and_a_failure_leaves_nothing(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_track_rerun(CASES["two"](), tmp_path / f"{name}.rrd")
    assert run_rerun("rrd", "compare", "--unordered", tmp_path / "a.rrd", tmp_path / "b.rrd").returncode == 0
    with pytest.raises(ValueError, match="different plants"):
        write_track_rerun(CASES["one"]() * 2, tmp_path / "c.rrd")
    assert {p.name for p in tmp_path.iterdir()} == {"a.rrd", "b.rrd"}
