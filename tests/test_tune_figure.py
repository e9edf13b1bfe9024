"""The picture of a tuning: gains and references as given, lost runs shown, nothing overlaps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ssmr.control.loop import ClosedRun, LoopSettings
from ssmr.control.references import circle, line, sine
from ssmr.control.waypoints import Waypoints
from tests.test_figures import lines, overlapping, texts, written
from tests.test_fit_figure import trace
from validation.fit.data import FittedParameter
from validation.fit.table import value_text
from validation.plants.profile import load_profile
from validation.track.data import reference_of
from validation.track.gains import GainSet, load_gains
from validation.track.loops import make_controller, make_robot, rate, run_robots
from validation.tune.data import Followed, TunedRun
from validation.tune.figure import MAX_HELD_OUT, MAX_TRAIN, tune_figure
from validation.tune.result import TuneResult
from validation.tune.table import run_text

SPEED = 0.4
WAYS: dict[str, Waypoints] = {
    "line": line(SPEED, 1.0),
    "circle": circle(SPEED, 0.6, 0.5),
    "sine": sine(SPEED, 0.2, 1.5, 1.0),
}
BOUNDS = (
    ("k_p_rho", 0.5, 5.0, "linear"),
    ("k_i_rho", 0.001, 0.2, "log"),
    ("k_p_y", 0.1, 10.0, "log"),
    ("k_p_w", 0.0, 0.65, "linear"),
)


def cut(run: ClosedRun, n: int) -> ClosedRun:
    """The same, lost after so many ticks."""
    return ClosedRun(run.t[:n], run.table[:n], lost=True)


@cache
def followed(reference: str, plant: str, lost: str = "") -> TunedRun:
    """A short reference with the published gains, and with others; `lost` names who lost it, and after how many ticks."""
    profile, ways = load_profile("thesis-lab"), WAYS[reference]
    robot, published = make_robot(profile, plant), load_gains("pid", "published")
    tuned = GainSet("pid", "tuned", {**published.values, "k_p_rho": 2.0, "k_p_y": 3.0})
    laws = [make_controller(profile, gains) for gains in (tuned, published)]
    runs = run_robots([robot] * 2, laws, [LoopSettings(disturbance=False)] * 2, ways, [4], workers=1)
    costs = [1.0, 1.5]
    for who in lost.split(",") if lost else ():
        k, n = (0 if who.startswith("tuned") else 1), int(who.partition(" ")[2])
        runs[k], costs[k] = cut(runs[k], n), math.inf
    return TunedRun(
        f"{reference} at {ways.speed:g} m/s, {plant}", reference, ways.speed, plant,
        reference_of(runs[0], ways, whole=True) if len(runs[0].t) > 1 else ways.trajectory(0.008),
        *(Followed(run, rate(run, ways, robot), cost) for run, cost in zip(runs, costs, strict=True)),
    )  # fmt: skip


def result(train: Sequence[TunedRun], held_out: Sequence[TunedRun] = (), **changes: object) -> TuneResult:
    """A made-up search around real runs; the last gain is at its bound."""
    gains = dict(load_gains("pid", "published").values)
    parameters = []
    for name, low, high, scale in BOUNDS:
        value = high if name == "k_p_w" else 0.7 * gains[name]
        gains_before = gains[name]
        gains[name] = value
        parameters.append(FittedParameter(name, "1", value, low, high, scale, gains_before, value == high))
    lost = any(f.baseline.lost for f in train)
    made = TuneResult(
        controller="pid", begun_with="thesis-lab", seed=4, status="finished", stopped_by="generations", cost=0.03,
        baseline_name="pid-published", baseline_cost=math.inf if lost else 0.8, cost_name="path", evaluations=1230,
        generations=40, wall_s=12.3, parameters=tuple(parameters), gain_set=GainSet("pid", "tuned", gains),
        remarks=("k_p_w ended at its upper bound, 0.65.",), train=tuple(train), held_out=tuple(held_out),
        trace=trace([p.share(p.value) for p in parameters], 41),
        options={"population": 30, "strategy": "best/2", "limit": math.inf}, versions={"ssmr-testbed": "0.1.0"},
    )  # fmt: skip
    return replace(made, **changes)  # type: ignore[arg-type]


CASES = {
    "one": lambda: result([followed("line", "kinematic")]),
    "several": lambda: result(
        [followed("line", "linear"), followed("sine", "linear")],
        [followed("circle", "kinematic"), followed("sine", "kinematic")],
    ),
    "lost": lambda: result(
        [followed("sine", "linear", "baseline 60"), followed("line", "linear")], [followed("circle", "linear", "tuned 90")]
    ),
    "lost at once": lambda: result([followed("sine", "linear", "baseline 1,tuned 1")], cost=math.inf),
    "interrupted": lambda: result(
        [followed("sine", "linear")],
        status="interrupted",
        stopped_by="interrupt",
        parameters=result([]).parameters[:1],
        trace=trace([0.4], 3),
    ),
    "many": lambda: result(
        [replace(followed("line", "linear"), label=f"line at {k} m/s, linear") for k in range(10)],
        [replace(followed("circle", "kinematic"), label=f"circle at {k} m/s, kinematic") for k in range(5)],
    ),
}


@cache
def drawn(name: str) -> tuple[TuneResult, Figure]:
    """A case and its figure, which is only looked at."""
    made = CASES[name]()
    return made, tune_figure(made)


@pytest.fixture(params=CASES)
def case(request: pytest.FixtureRequest) -> tuple[TuneResult, Figure]:
    return drawn(request.param)


def paths(figure: Figure, label: str) -> list[Axes]:
    return [ax for ax in figure.axes if ax.get_label() == label]


def test_nothing_written_overlaps_or_leaves_the_picture(case: tuple[TuneResult, Figure]) -> None:
    assert overlapping(case[1]) == []


def test_every_gain_is_there_within_its_bounds(case: tuple[TuneResult, Figure]) -> None:
    made, figure = case
    labels = {text.get_text() for text in texts(figure)}
    for p in made.parameters:
        (strip,) = [ax for ax in figure.axes if p.name in lines(ax)]
        assert np.asarray(lines(strip)[p.name].get_xdata())[0] == pytest.approx(p.share(p.value))
        assert np.asarray(lines(strip)[f"before {p.name}"].get_xdata())[0] == pytest.approx(p.share(p.before))
        assert value_text(p) + " · at bound" * p.at_bound in labels
    assert "tick: baseline" in written(figure)
    assert "before the fit" not in written(figure)


def test_the_convergence_is_that_given_and_has_the_baseline(case: tuple[TuneResult, Figure]) -> None:
    made, figure = case
    (ax,) = [ax for ax in figure.axes if ax.get_title(loc="left").startswith("Cost (")]
    assert np.array_equal(np.asarray(lines(ax)["best"].get_ydata()), made.trace.best_cost)
    assert ("before" in lines(ax)) == math.isfinite(made.baseline_cost)


def test_references_have_a_path_each_and_those_without_are_named(case: tuple[TuneResult, Figure]) -> None:
    made, figure = case
    for label, every, most in (("train", made.train, MAX_TRAIN), ("held out", made.held_out, MAX_HELD_OUT)):
        shown = paths(figure, label)
        assert len(shown) == min(most, len(every))
        for ax, f in zip(shown, every, strict=False):
            assert np.array_equal(np.asarray(lines(ax)["reference"].get_xydata()), f.target.xy)
            assert np.array_equal(np.asarray(lines(ax)["tuned"].get_xydata()), f.tuned.run.columns("x", "y"))
            assert np.array_equal(np.asarray(lines(ax)["baseline"].get_xydata()), f.baseline.run.columns("x", "y"))
            assert ("tuned lost" in lines(ax)) == f.tuned.lost
            assert ("baseline lost" in lines(ax)) == f.baseline.lost
            assert ax.get_aspect() == 1.0
            told = [text.get_text() for text in ax.texts]
            assert any(t.startswith("tuned: lost" if f.tuned.lost else f"tuned: cost {f.tuned.cost:.4g},") for t in told)
        for f in every[most:]:
            assert run_text(f) in " ".join(written(figure).split())


def test_an_interruption_and_losses_are_said() -> None:
    assert "INTERRUPTED" in written(drawn("interrupted")[1])
    text = " ".join(written(drawn("lost")[1]).split())
    assert "The gains pid-published lose sine at 0.4 m/s, linear: lost at t = 0.47 s" in text
    assert "The tuned gains lose circle at 0.4 m/s, linear" in text
