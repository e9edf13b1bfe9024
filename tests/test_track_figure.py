"""The picture of robots that followed a reference: every curve as recorded, losses shown, nothing overlaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ssmr.control.loop import Feedback
from ssmr.control.references import circle, line, sine
from ssmr.control.waypoints import Waypoints
from tests.test_figures import lines, overlapping, texts, written, x_of, y_of
from tests.test_tune_figure import cut
from validation.show.tables import units_of
from validation.track.data import TrackedRobot
from validation.track.figure import draw_track
from validation.track.run import TrackSettings, track
from validation.track.table import SHOWN_METRICS, gains_text

WAYS: dict[str, Waypoints] = {
    "line": line(0.4, 1.0),
    "circle": circle(0.4, 0.6, 1.0),
    "sine": sine(0.4, 0.2, 1.5, 1.0),
    "sharp": sine(0.9, 0.6, 1.2, 1.0),
}
TITLES = {"speed": "Speed u", "yaw rate": "Yaw rate", "e_rho": "e_rho", "e_y": "e_y", "e_alpha": "e_alpha", "paths": "Paths"}


@cache
def followed(
    reference: str, plant: str, controller: str = "pid", feedback: Feedback = "noisy", lookahead: float = 0.0
) -> TrackedRobot:
    """A short run of a planar model."""
    settings = TrackSettings(feedback=feedback, disturbance=False, lookahead=lookahead, seed=4)
    made = track(controller, WAYS[reference], plant, gains="published", settings=settings, workers=1)
    return replace(made.robots[0], reference=reference)


def lost(made: TrackedRobot, n: int) -> TrackedRobot:
    """The same, lost after so many ticks."""
    return replace(made, run=cut(made.run, n))


CASES = {
    "one": lambda: [followed("line", "kinematic")],
    "truth": lambda: [followed("circle", "linear", "lqr", "truth")],
    "two": lambda: [followed("sine", plant) for plant in ("linear", "kinematic")],
    "four": lambda: [followed("sharp", plant, lookahead=0.2) for plant in ("linear", "kinematic", "improved", "coulomb")],
    "lost": lambda: [lost(followed("sine", "linear"), 150), followed("sine", "kinematic")],
    "lost alone": lambda: [lost(followed("circle", "linear", "lqr", "truth"), 150)],
    "lost at once": lambda: [lost(followed("sine", "linear"), 1)],
}


@cache
def drawn(name: str) -> tuple[Sequence[TrackedRobot], Figure]:
    """A case and its figure, which is only looked at."""
    made = CASES[name]()
    return made, draw_track(made)


@pytest.fixture(params=CASES)
def case(request: pytest.FixtureRequest) -> tuple[Sequence[TrackedRobot], Figure]:
    return drawn(request.param)


def panels(figure: Figure) -> dict[str, Axes]:
    """The six panels by what they show."""
    found = {}
    for key, start in TITLES.items():
        (found[key],) = [ax for ax in figure.axes if ax.get_title(loc="left").startswith(start)]
    return found


def test_nothing_written_overlaps_or_leaves_the_picture(case: tuple[Sequence[TrackedRobot], Figure]) -> None:
    assert overlapping(case[1]) == []


def test_six_panels_hold_what_was_recorded(case: tuple[Sequence[TrackedRobot], Figure]) -> None:
    made, figure = case
    found = panels(figure)
    longest = max((r.target for r in made), key=len)
    for key, columns, twist in (("speed", ("v_x", "u_ref", "v_cmd", "seen_v"), 0),
                                ("yaw rate", ("yaw_rate", "w_ref", "w_cmd", "seen_w"), 2)):  # fmt: skip
        curves = lines(found[key])
        assert np.array_equal(y_of(curves["reference"]), longest.twist[:-1, twist])
        for r in made:
            assert np.array_equal(x_of(curves[r.plant]), r.run.t)
            assert np.array_equal(y_of(curves[r.plant]), r.run.column(columns[0]))
            assert np.array_equal(y_of(curves[f"{r.plant} wanted"]), r.run.column(columns[1]))
            if len(made) == 1:
                assert np.array_equal(y_of(curves[f"{r.plant} command"]), r.run.column(columns[2]))
            noisy = len(made) == 1 and r.options["feedback"] != "truth"
            assert (f"{r.plant} seen" in curves) == noisy
            if noisy:
                assert np.array_equal(y_of(curves[f"{r.plant} seen"]), r.run.column(columns[3]))
    for error in ("e_rho", "e_y", "e_alpha"):
        ax = found[error]
        scale = {"[mm]": 1e3, "[m]": 1.0, "[deg]": 180.0 / np.pi}[ax.get_title(loc="left").rpartition(" ")[2]]
        for r in made:
            assert y_of(lines(ax)[r.plant]) == pytest.approx(r.run.column(error) * scale)
        goal = float(str(made[0].options["lookahead_m"])) if error == "e_rho" else 0.0
        assert y_of(lines(ax)["goal"])[0] == pytest.approx(goal * scale)


def test_paths_have_equal_scales_a_start_and_an_end(case: tuple[Sequence[TrackedRobot], Figure]) -> None:
    made, figure = case
    ax = panels(figure)["paths"]
    assert ax.get_aspect() == 1.0
    longest = max((r.target for r in made), key=len)
    assert np.array_equal(np.asarray(lines(ax)["reference"].get_xydata()), longest.xy)
    assert np.array_equal(np.asarray(lines(ax)["reference end"].get_xydata())[0], longest.xy[-1])
    rings = [line for line in ax.lines if line.get_marker() == "o"]
    assert np.array_equal(np.asarray(rings[0].get_xydata())[0], longest.xy[0])
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    for r in made:
        xy = r.run.columns("x", "y")
        assert np.array_equal(np.asarray(lines(ax)[r.plant].get_xydata()), xy)
        assert np.all((xy > (left, low)) & (xy < (right, high)))


def test_the_header_says_who_with_what_how_well(case: tuple[Sequence[TrackedRobot], Figure]) -> None:
    made, figure = case
    text, first = written(figure), made[0]
    for part in (
        first.controller,
        first.gains_name,
        first.reference,
        f"{first.speed:.3g} m/s",
        "profile thesis-lab",
        "seed 4",
    ):
        assert part in text
    assert all(part in " ".join(text.split()) for part in gains_text(first.gains).split(" · "))
    units = units_of(SHOWN_METRICS, [r.metrics for r in made])
    labels = {t.get_text() for t in texts(figure)}
    for r in made:
        assert r.plant in text
        assert all(unit.text(r.metrics[m.name]) in labels for m, unit in zip(SHOWN_METRICS, units, strict=True))


def test_losses_are_marked_in_every_panel(case: tuple[Sequence[TrackedRobot], Figure]) -> None:
    made, figure = case
    assert ("LOST" in written(figure)) == any(r.run.lost for r in made)
    for key, ax in panels(figure).items():
        for r in made:
            assert (f"{r.plant} lost" in lines(ax)) == r.run.lost, key


def test_saturation_is_that_of_the_metrics_and_shaded() -> None:
    made = [*CASES["four"](), followed("sine", "linear")]
    assert any(r.metrics["saturated_fraction"] > 0.05 for r in made)
    for r in made:
        assert np.mean(r.saturated) == pytest.approx(r.metrics["saturated_fraction"])
        assert not replace(r, options={}).saturated.any()
        for key, ax in panels(draw_track([r])).items():
            shades = [c for c in ax.collections if c.get_gid() == f"{r.plant} saturated"]
            assert len(shades) == (key != "paths" and r.metrics["saturated_fraction"] > 0.0)
    in_panels = panels(drawn("four")[1])
    for key in ("speed", "yaw rate"):
        strips = {str(c.get_gid()) for c in in_panels[key].collections}
        assert strips == {f"{r.plant} saturated" for r in made[:4] if r.metrics["saturated_fraction"] > 0.0}
    assert not in_panels["e_rho"].collections


def test_robots_that_do_not_belong_together_are_refused() -> None:
    one = followed("sine", "linear")
    with pytest.raises(ValueError, match="different plants"):
        draw_track([one, one])
    with pytest.raises(ValueError, match="follow one reference"):
        draw_track([one, followed("line", "kinematic")])
    with pytest.raises(ValueError, match="got 0"):
        draw_track([])
