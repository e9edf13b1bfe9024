"""The picture of a fit: every number given is in it, doubts are marked, nothing overlaps, whatever was fitted to what."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.image import imread

from ssmr.metrics.declared import compare_pieces
from ssmr.metrics.poses import HorizonErrors
from ssmr.metrics.windows import WindowErrors
from ssmr.types import FloatArray
from tests.test_figures import lines, motion, overlapping, texts, written
from validation.fit.data import FittedParameter, Scored, SearchTrace
from validation.fit.figure import MAX_HELD_OUT, MAX_TRAIN, fit_figure
from validation.fit.result import FitResult
from validation.fit.table import effort, fit_notes, value_text
from validation.plants.profile import load_profile
from validation.show.drawing import ALARM, save_figure

NAMES = {
    "friction": ("1", 0.1, 1.2, "linear"),
    "wheel_radius": ("m", 0.14, 0.18, "linear"),
    "radius_difference": ("m", -0.012, 0.012, "linear"),
    "gain": ("N m s/rad", 30.0, 3000.0, "log"),
    "com_x": ("m", -0.15, 0.15, "linear"),
    "com_y": ("m", -0.15, 0.15, "linear"),
    "delay": ("s", 0.0, 0.6, "linear"),
    "acceleration_v": ("m/s2", 0.3, 10.0, "log"),
    "acceleration_w": ("rad/s2", 0.5, 20.0, "log"),
    "wheel_lag": ("s", 0.0, 0.5, "linear"),
    "tracked_x": ("m", -0.4, 0.4, "linear"),
    "tracked_y": ("m", -0.2, 0.2, "linear"),
    "effective_half_track": ("m", 0.2, 0.8, "linear"),
    "command_half_track": ("m", 0.2, 0.8, "linear"),
    "yaw_inertia": ("kg m2", 3.2, 5.3, "linear"),
    "torque_limit": ("N m", 2.0, 100.0, "log"),
}
"""Unit, bounds and scale of parameters to be had."""
SCENARIO = (np.arange(0.0, 20.001, 0.05),)
DRIVE = (np.arange(100.0, 280.0, 0.1),)
GAPPY = (np.arange(300.0, 345.0, 0.1), np.arange(350.0, 440.0, 0.1), np.arange(441.0, 446.0, 0.1))


def parameter(name: str, share: float, error: float | None) -> FittedParameter:
    """A parameter at a share of its bounds, its error a share of their width."""
    unit, lower, upper, scale = NAMES[name]

    def value(x: float) -> float:
        x = min(max(x, 0.0), 1.0)
        return lower * (upper / lower) ** x if scale == "log" else lower + x * (upper - lower)

    known = error is not None
    interval = (value(share - 1.96 * (error or 0.0)), value(share + 1.96 * (error or 0.0))) if known else None
    slope = 0.5 * (value(share + 0.01) - value(share - 0.01)) / 0.01
    before = math.inf if name == "torque_limit" else value(0.5 * share + 0.2)
    return FittedParameter(
        name, unit, value(share), lower, upper, scale, before, not 0.002 < share < 0.998,
        (error or 0.0) * slope if known else None, interval,
    )  # fmt: skip


def scored(label: str, reference: str, stamps: Sequence[FloatArray], gain: float, horizons: Sequence[float] = ()) -> Scored:
    """A wave; the fitted plant is a little off, the one before more."""
    truth, fitted, before = (tuple(replace(motion(t, g), channels={}) for t in stamps) for g in (1.0, gain, 1.08))
    errors = {h: HorizonErrors(9, 0.009 * h, 0.02 * h, 0.005 * h, 0.009 * h) for h in horizons}
    windows = {h: window_errors(h) for h in horizons}
    return Scored(label, reference, truth, fitted, before, compare_pieces(fitted, truth), errors, windows)


def window_errors(horizon: float) -> WindowErrors:
    """Errors of eighty windows that begin every second."""
    size = np.abs(np.random.default_rng(round(horizon)).normal(1.0, 0.4, 80))
    return WindowErrors(horizon, 0.01 * horizon * size, 0.006 * horizon * size)


def correlated(n: int) -> FloatArray:
    """Correlations that fall off with distance; the first two can hardly be told apart."""
    away = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    found = (-0.6) ** away
    found[0, 1:2] = found[1:2, 0] = 0.97
    return np.asarray(found, dtype=np.float64)


def trace(shares: Sequence[float], generations: int, members: int = 30) -> SearchTrace:
    """A search that halves its cost every few generations."""
    rng = np.random.default_rng(4)
    k = np.arange(generations, dtype=np.float64)
    best, median = 0.02 + 3.0 * 0.8**k, 0.03 + 9.0 * 0.85**k
    population = np.clip(np.array(shares) + rng.normal(0.0, 0.05, (members, len(shares))), 0.0, 1.0)
    costs = rng.uniform(0.02, 0.05, members)
    costs[-1] = np.inf
    return SearchTrace(best, median, population, costs)


def result(
    n: int = 4,
    train: Sequence[Scored] | None = None,
    held_out: Sequence[Scored] = (),
    model: str = "mujoco",
    known: bool = True,
    generations: int = 40,
    **changes: object,
) -> FitResult:
    """A made-up fit of `n` parameters; with five or more, one is at its bound and one is vague."""
    shares = [0.12 + 0.76 * ((0.37 * i) % 1.0) for i in range(n)]
    if n >= 5:
        shares[4] = 1.0
    errors = [0.3 if i == 3 and n >= 5 else 0.01 + 0.004 * i for i in range(n)]
    parameters = [parameter(name, x, e if known else None) for name, x, e in zip(NAMES, shares, errors, strict=False)]
    train = tuple(train or [scored("traj4@improved", "improved", SCENARIO, 1.005)])
    motions, truths = [m for s in train for m in s.motion], [t for s in train for t in s.truth]
    horizons: Mapping[float, HorizonErrors] = next((s.horizons for s in train if s.horizons), {})
    notes = [f"{p.name} ended at its upper bound, {p.upper:g} {p.unit}: give it wider bounds, or fix it."
             for p in parameters if p.at_bound]  # fmt: skip
    if n >= 2 and known:
        notes.append("The data cannot tell friction and wheel_radius apart (correlation +0.97): only a combination is "
                     "determined.")  # fmt: skip
    source = ",".join(dict.fromkeys(s.label.partition(" ")[0] for s in train))
    made = FitResult(
        model=model, begun_with="thesis-lab", profile=load_profile("thesis-lab"), source=source, seed=7, status="finished",
        stopped_by="improvement", cost=0.02, cost_name="path", evaluations=32 * generations, generations=generations - 1,
        wall_s=12.34, parameters=tuple(parameters), correlation=correlated(n) if known else None,
        uncertainty_method="curvature at the optimum, scatter of 20 blocks of time" if known else "", remarks=tuple(notes),
        train=train, train_metrics=compare_pieces(motions, truths), train_horizons=horizons,
        train_windows={h: window_errors(h) for h in horizons},
        before_horizons=dict(horizons) if all(s.before for s in train) else {}, held_out=tuple(held_out),
        trace=trace(shares, generations),
        options={"objective": "path", "strategy": "best/2", "crossover": "bin", "population": 32, "from": None},
        versions={"ssmr-testbed": "0.1.0", "python": "3.11", "mujoco": "3.17.0", "numpy": "2.2"},
    )  # fmt: skip
    return replace(made, **changes)  # type: ignore[arg-type]


def interrupted(n: int = 1) -> FitResult:
    """Ctrl-C in the first generations: no errors."""
    return result(n, known=False, generations=3, status="interrupted", stopped_by="interrupt", remarks=())


def recorded() -> FitResult:
    """A recording driven by both inputs, and its held-out parts."""
    h = (2.0, 6.0, 30.0, 60.0)
    train = [
        scored(f"/data/tile_17.csv ({word})", "recording", DRIVE, g, h) for word, g in (("wheels", 1.01), ("commands", 1.02))
    ]
    held = [
        scored(f"/data/tile_17.csv ({word})", "recording", GAPPY, g, h[:3])
        for word, g in (("wheels", 1.02), ("commands", 1.03))
    ]
    return result(9, train, held, cost_name="horizon")


def long_names(made: FitResult) -> FitResult:
    """The same from a file of a long name, with a fourth part held out."""

    def renamed(s: Scored) -> Scored:
        return replace(s, label=s.label.replace("tile", "husky_on_tiles_WITH_A_LONG_NAME_2026"))

    others = [replace(s, label=s.label.replace("17", "18")) for s in made.held_out]
    held_out = tuple(map(renamed, [*made.held_out, *others]))
    return replace(made, train=tuple(map(renamed, made.train)), held_out=held_out, source="/data/" + 99 * "w" + ".csv")


def many() -> FitResult:
    """Six scenarios fitted to, four held out, sixteen parameters."""
    train = [scored(f"traj{i}@improved", "improved", SCENARIO, 1.0 + 0.003 * i) for i in range(1, 7)]
    held = [scored(f"traj{i}@mujoco", "mujoco", SCENARIO, 1.01) for i in range(1, 5)]
    return result(16, train, held, model="linear")


CASES: dict[str, Callable[[], FitResult]] = {
    "scenario": result,
    "recording": recorded,
    "long names": lambda: long_names(recorded()),
    "interrupted": interrupted,
    "interrupted with many parameters": lambda: interrupted(13),
    "many": many,
    "one parameter": lambda: result(1),
    "two parameters": lambda: result(2, model="kinematic"),
    "six parameters, held out": lambda: result(6, held_out=[scored("traj2", "improved", SCENARIO, 1.01)]),
    "seven parameters": lambda: result(7, held_out=[scored(f"traj{i}", "improved", SCENARIO, 1.01) for i in (1, 2, 3)]),
    "fitted to itself": lambda: result(3, model="improved"),
    "short pieces": lambda: result(train=[scored("a.csv", "recording", [t[:40] for t in GAPPY], 1.02)]),
    "nothing before": lambda: result(train=[replace(scored("b.csv", "recording", DRIVE, 1.1, (2.0,)), before=())]),
    "one generation": lambda: result(generations=1, stopped_by="generations"),
}


@cache
def drawn(name: str) -> tuple[FitResult, Figure]:
    """A case and its figure, which is only looked at."""
    made = CASES[name]()
    return made, fit_figure(made)


@pytest.fixture(params=CASES)
def case(request: pytest.FixtureRequest) -> tuple[FitResult, Figure]:
    return drawn(request.param)


def panels(figure: Figure, start: str) -> list[Axes]:
    return [ax for ax in figure.axes if ax.get_title(loc="left").startswith(start)]


def paths(figure: Figure, label: str) -> list[Axes]:
    return [ax for ax in figure.axes if ax.get_label() == label and set(lines(ax)) >= {"truth", "fitted"}]


def test_nothing_written_overlaps_or_leaves_the_picture(case: tuple[FitResult, Figure]) -> None:
    assert overlapping(case[1]) == []


def test_every_parameter_is_there_with_value_bounds_and_doubts(case: tuple[FitResult, Figure]) -> None:
    made, figure = case
    labels = {text.get_text(): text for text in texts(figure)}
    for p in made.parameters:
        assert any(label.split()[-1] == p.name for label in labels)
        text = f"{value_text(p)} {'' if p.unit == '1' else p.unit}".rstrip()
        label = f"{text} · at bound" if p.at_bound else text if text in labels else f"{text} · uncertain"
        assert (to_rgb(labels[label].get_color()) == to_rgb(ALARM)) == p.at_bound
        assert any(t.startswith(f"{p.upper:g}") and (p.unit == "1" or t.endswith(p.unit)) for t in labels)
        (strip,) = [ax for ax in figure.axes if p.name in lines(ax)]
        (x,) = np.asarray(lines(strip)[p.name].get_xdata())
        assert x == pytest.approx(p.share(p.value))
    vague = "uncertain" in "\n".join(t for t in labels if "±" in t)
    assert vague == (len(made.parameters) >= 5 and made.correlation is not None)


def test_the_header_says_what_it_took_and_how_it_ended(case: tuple[FitResult, Figure]) -> None:
    made, figure = case
    text = written(figure)
    for part in (f"{made.model} fitted to", effort(made), "seed 7", made.begun_with, "ssmr-testbed 0.1.0", "mujoco 3.17.0"):
        assert part in text
    assert ("INTERRUPTED after 2 generations" in text) == (made.status == "interrupted")
    flat = " ".join(text.split())
    for note in fit_notes(made):
        assert all(word in flat for word in note.split())


def test_the_convergence_is_that_given(case: tuple[FitResult, Figure]) -> None:
    made, figure = case
    (ax,) = panels(figure, "Cost (")
    for name, costs in (("best", made.trace.best_cost), ("median", made.trace.median_cost)):
        assert np.array_equal(np.asarray(lines(ax)[name].get_ydata()), costs)
    assert np.asarray(lines(ax)["stop"].get_xdata())[0] == len(made.trace.best_cost) - 1
    assert ax.get_yscale() == ("linear" if len(made.trace.best_cost) < 5 else "log")


def test_sources_have_a_path_each_and_those_without_are_named(case: tuple[FitResult, Figure]) -> None:
    made, figure = case
    assert len(paths(figure, "train")) == min(MAX_TRAIN, len(made.train))
    assert len(paths(figure, "held out")) == min(MAX_HELD_OUT, len(made.held_out))
    text = written(figure)
    if len(made.train) > MAX_TRAIN:
        assert f"Without a picture of their own: {made.train[4].label}" in text
    for ax, source in zip(paths(figure, "train"), made.train, strict=False):
        assert ("before" in lines(ax)) == bool(source.before)
        if len(source.truth) == 1 and source.truth[0].t[-1] <= 30.0:
            for name, pieces in (("truth", source.truth), ("fitted", source.motion)):
                assert np.array_equal(np.asarray(lines(ax)[name].get_xydata()), pieces[0].xy)
        else:
            assert all(np.array_equal(np.asarray(line.get_xydata())[0], [0.0, 0.0]) for line in lines(ax).values())


def test_horizons_are_shown_where_there_are_any(case: tuple[FitResult, Figure]) -> None:
    made, figure = case
    found = panels(figure, "Position error by horizon [mm]") + panels(figure, "Yaw error by horizon [deg]")
    assert len(found) == (2 if made.train_horizons else 0)
    if found:
        (shown,) = [line for line in found[0].lines if line.get_gid() == "fitted to"]
        assert np.asarray(shown.get_ydata()) == pytest.approx(
            [1e3 * e.position_median_m for e in made.train_horizons.values()]
        )
        held_out = [str(line.get_gid()) for line in found[0].lines if str(line.get_gid()).startswith("held out")]
        assert len(held_out) == len(made.held_out)
        assert any("90 % interval" in text.get_text() for text in found[0].texts)
        medians = [float(y) for line in found[0].lines if line.get_marker() == "_" for y in np.asarray(line.get_ydata())]
        for e in (*made.train_windows.values(), *(w for s in made.held_out for w in s.windows.values())):
            assert any(y == pytest.approx(1e3 * e.summary().position_median_m) for y in medians)


def test_no_stretch_that_is_shown_spans_a_jump() -> None:
    long = np.arange(0.0, 100.0, 0.05)
    for at in ((1300,), tuple(range(300, 2000, 300))):
        source = replace(scored("log.csv", "recording", [long], 1.005, (2.0,)), jumps=(at,))
        (ax,) = paths(fit_figure(result(train=[source])), "train")
        words = next(text.get_text() for text in ax.texts if " s · " in text.get_text())
        first, last = (float(word) for word in words.partition(" s")[0].split(" to "))
        assert last - first == pytest.approx(30.0 if len(at) == 1 else 15.0, abs=1.1)
        assert not any(first < long[i] - 0.5 and last > long[i] + 0.5 for i in at)  # the title has whole seconds


def test_correlations_are_shown_where_there_are_any(case: tuple[FitResult, Figure]) -> None:
    made, figure = case
    found = panels(figure, "Correlation")
    assert len(found) == (made.correlation is not None and len(made.parameters) > 1)
    for ax in found:
        shown, n = np.ma.masked_array(ax.images[0].get_array()), len(made.parameters)
        assert np.array_equal(np.ma.getmaskarray(shown), np.eye(n, dtype=np.bool_))
        assert np.array_equal(shown.data, made.correlation)
        assert ax.images[0].get_clim() == (-1.0, 1.0)


def test_infinite_costs_are_left_out() -> None:
    made = result()
    best, median = np.array([np.inf, np.inf, 2.0, 1.0]), np.array([np.nan, np.nan, 3.0, 2.0])
    ax = panels(fit_figure(replace(made, trace=replace(made.trace, best_cost=best, median_cost=median))), "Cost (")[0]
    assert np.array_equal(np.isfinite(np.asarray(lines(ax)["best"].get_ydata(), dtype=np.float64)), np.isfinite(best))
    costs = np.full(4, np.inf)
    hopeless = replace(made.trace, best_cost=costs, median_cost=np.full(4, np.nan), costs=np.full(30, np.inf))
    fit_figure(replace(made, cost=np.inf, trace=hopeless))


def test_what_was_before_beyond_the_bounds_is_marked_at_their_end() -> None:
    made = result()
    low, high = (replace(p, before=x) for p, x in zip(made.parameters, (-1.0, math.inf), strict=False))
    ax = panels(fit_figure(replace(made, parameters=(low, high, *made.parameters[2:]))), "Parameters")[0]
    for p, marker, x in ((low, "<", 0.0), (high, ">", 1.0)):
        tick = lines(ax)[f"before {p.name}"]
        assert (tick.get_marker(), np.asarray(tick.get_xdata())[0]) == (marker, x)


def test_no_setting_outlives_a_call_and_the_file_is_1600_pixels_wide(tmp_path: Path) -> None:
    before = dict(matplotlib.rcParams)
    path = tmp_path / "fit.png"
    save_figure(fit_figure(result(2)), path)
    assert dict(matplotlib.rcParams) == before
    assert path.stat().st_size > 20_000
    assert imread(path).shape[1] == 1600
    assert list(tmp_path.iterdir()) == [path]
