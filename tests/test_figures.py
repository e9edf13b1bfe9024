"""The picture shows everybody everywhere, breaks lines at gaps, fits, stands alone, and is written whole or not at all."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.lines import Line2D
from matplotlib.text import Text
from PIL import Image

from ssmr.geometry import compose, relative
from ssmr.metrics.poses import HorizonErrors
from ssmr.metrics.windows import WindowErrors
from ssmr.types import CommandKind, Commands, FloatArray, Trajectory
from tests.conftest import metrics_of
from validation.compare import Comparison, PlantResult
from validation.compare.figure import MAX_WINDOWS, comparison_figure
from validation.show.drawing import save_figure
from validation.simulator.health import Health

PLANTS = ("mujoco", "improved", "coulomb", "linear", "kinematic")
METRICS = metrics_of(0.0145, 0.0250, 1.0312, 0.98, 0.0151, 0.0260, 0.0202, 0.0349)
SECONDS = 3.0  # of processor time: what rendering may take

TITLES = {
    "paths": "Paths [m]",
    "zoom": "Farthest apart",
    "position": "Position error",
    "yaw": "Yaw error",
    "rate": "Yaw rate [rad/s]",
    "acceleration": "Yaw acceleration [rad/s²]",
    "speed": "Speed v_x [m/s]",
    "loads": "Wheel loads [N]",
}


def motion(t: FloatArray, gain: float, loads: bool = False) -> Trajectory:
    """A wave driven at a yaw rate that `gain` stretches."""
    rate = 0.6 * gain * np.sin(0.5 * t)
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))])
    speed = 0.5 * gain
    step = speed * np.diff(t)
    xy = np.column_stack([np.concatenate([[0.0], np.cumsum(f(yaw[:-1]) * step)]) for f in (np.cos, np.sin)])
    turn = 0.3 * gain * np.cos(0.5 * t)
    channels = {"yaw_acceleration_rad_s2": turn, "torque_N_m": np.zeros((len(t), 2))}
    channels["yaw_acceleration_range_rad_s2"] = np.column_stack([turn, turn])
    if loads:
        channels["wheel_load_N"] = 180.0 + np.outer(np.sin(t), [1.0, -1.0, 2.0, -2.0])
    twist = np.column_stack([np.full(len(t), speed), np.zeros(len(t)), rate])
    return Trajectory(t, np.column_stack([xy, yaw]), twist, np.zeros((len(t), 2)), channels)


def make(
    names: Sequence[str] = PLANTS,
    reference: str = "mujoco",
    stamps: Sequence[FloatArray] | None = None,
    horizons: Sequence[float] = (),
    kind: CommandKind = "twist",
) -> Comparison:
    """A comparison of made-up plants; a recording has no channels."""
    pieces = [np.arange(0.0, 20.001, 0.05)] if stamps is None else stamps
    sizes = np.abs(np.random.default_rng(2).normal(1.0, 0.5, 90))
    errors = {h: HorizonErrors(9, 0.09 * h, 0.12 * h, 0.25 * h, 0.3 * h) for h in horizons}
    plants = {
        name: PlantResult(
            name,
            tuple(motion(t, 1.0 + 0.03 * PLANTS.index(name), name == "mujoco") for t in pieces),
            METRICS,
            errors,
            0.1,
            200.0,
            Health(0.9, 0.02) if name == "mujoco" else None,
            windows={h: WindowErrors(h, 0.09 * h * sizes, 0.25 * h * sizes) for h in horizons},
        )
        for name in names
    }
    truth = tuple(replace(motion(t, 1.01), channels={}) for t in pieces)
    against = plants[reference].pieces if reference in plants else truth
    wave = [np.column_stack([np.full(len(t), 0.5), 0.6 * np.sin(0.5 * t)])[:-1] for t in pieces]
    commands = tuple(Commands(0.05, values, kind) for values in wave)
    versions = {"ssmr-testbed": "0.1.0", "python": "3.11", "mujoco": "3.17.0"}
    return Comparison("traj4", "thesis-lab", reference, against, commands, plants, 7, {"noise": True}, versions)


def recorded(names: Sequence[str] = ("mujoco", "kinematic")) -> Comparison:
    """A long recording in one piece."""
    return make(names, "recording", [np.arange(100.0, 250.0, 0.05)], (2.0, 6.0, 30.0), "wheels")


def gappy() -> Comparison:
    """A recording in three pieces."""
    stamps = [np.arange(100.0, 110.0, 0.05), np.arange(111.0, 120.0, 0.05), np.arange(121.0, 135.0, 0.05)]
    return make(("mujoco", "linear"), "recording", stamps, (2.0, 6.0))


CASES: dict[str, Callable[[], Comparison]] = {
    "scenario": make,
    "recording": recorded,
    "five on a recording": lambda: recorded(PLANTS),
    "commanded recording": lambda: make(PLANTS, "recording", [np.arange(0.0, 90.0, 0.05)], (2.0, 6.0, 30.0, 60.0)),
    "gaps": gappy,
    "without mujoco": lambda: make(("improved", "kinematic"), "improved"),
    "only the kinematic": lambda: make(("kinematic",), "kinematic"),
    "only the reference": lambda: make(("mujoco",), "mujoco"),
    "only a recording": lambda: recorded(()),
    "short recording without horizons": lambda: make(("linear",), "recording", [np.arange(0.0, 4.0, 0.05)]),
    "pieces shorter than any window": lambda: make(PLANTS, stamps=[np.arange(a, a + 1.5, 0.05) for a in (0.0, 3.0)]),
    "two samples": lambda: make(stamps=[np.array([0.0, 0.05])]),
}


@cache
def drawn(name: str) -> tuple[Comparison, Figure]:
    """A case and its figure, which is only looked at."""
    comparison = CASES[name]()
    return comparison, comparison_figure(comparison)


@pytest.fixture(params=CASES)
def case(request: pytest.FixtureRequest) -> tuple[Comparison, Figure]:
    return drawn(request.param)


def panels(figure: Figure) -> dict[str, Axes]:
    """Panels by the keys of `TITLES`."""
    found = {}
    for ax in figure.axes:
        for key, start in TITLES.items():
            if ax.get_title(loc="left").startswith(start):
                assert key not in found
                found[key] = ax
    return found


def lines(ax: Axes) -> dict[str, Line2D]:
    """Lines of a panel by whose they are; each motion has one."""
    named = [(str(line.get_gid()), line) for line in ax.lines if line.get_gid() is not None]
    assert len({name for name, _ in named}) == len(named)
    return dict(named)


def y_of(line: Line2D) -> FloatArray:
    return np.asarray(line.get_ydata(), dtype=np.float64)


def x_of(line: Line2D) -> FloatArray:
    return np.asarray(line.get_xdata(), dtype=np.float64)


def texts(figure: Figure) -> list[Text]:
    """Everything written in a figure that can be seen, numbers at the axes left out."""
    numbers = {id(label) for ax in figure.axes for label in (*ax.get_xticklabels(), *ax.get_yticklabels())}
    every = [text for text in figure.findobj(Text) if isinstance(text, Text) and id(text) not in numbers]
    return [text for text in every if text.get_visible() and text.get_text().strip()]


def legend_texts(ax: Axes) -> list[str]:
    legend = ax.get_legend()
    return [] if legend is None else [text.get_text() for text in legend.get_texts()]


def written(figure: Figure) -> str:
    return "\n".join(text.get_text() for text in texts(figure))


def test_a_scenario_has_all_panels_and_one_line_for_each_plant() -> None:
    _, figure = drawn("scenario")
    found = panels(figure)
    assert set(found) == set(TITLES)
    others = set(PLANTS) - {"mujoco"}
    for key in ("paths", "zoom"):
        assert set(lines(found[key])) == set(PLANTS)
    for key in ("position", "yaw"):
        assert set(lines(found[key])) == others, "the reference is at no distance from itself"
    for key in ("rate", "speed"):
        assert set(lines(found[key])) == {*PLANTS, "command"}
    assert set(lines(found["acceleration"])) == set(PLANTS) - {"kinematic"}
    assert "kinematic: impulses, not drawn" in written(figure)
    assert legend_texts(found["loads"]) == ["front left", "front right", "rear left", "rear right"]


def test_lines_show_the_numbers_given() -> None:
    comparison, figure = drawn("scenario")
    found = panels(figure)
    reference = comparison.reference[0]
    for name, result in comparison.plants.items():
        piece = result.pieces[0]
        assert np.array_equal(lines(found["paths"])[name].get_xydata(), piece.xy)
        assert np.array_equal(y_of(lines(found["rate"])[name]), piece.twist[:, 2])
        assert np.array_equal(y_of(lines(found["speed"])[name]), piece.twist[:, 0])
        if name != "mujoco":
            distance = np.hypot(*(piece.xy - reference.xy).T)
            scale = 1e3 if "[mm]" in found["position"].get_title(loc="left") else 1.0
            assert np.array_equal(y_of(lines(found["position"])[name]), distance * scale)
    command = lines(found["rate"])["command"]
    assert np.array_equal(y_of(command)[:-1], comparison.commands[0].values[:, 1])
    assert np.array_equal(x_of(command), 0.05 * np.arange(401))


def test_paths_have_equal_scales_and_all_of_them_is_seen() -> None:
    comparison, figure = drawn("scenario")
    ax = panels(figure)["paths"]
    box = ax.get_window_extent()
    (x, x_end), (y, y_end) = ax.get_xlim(), ax.get_ylim()
    assert (x_end - x) / box.width == pytest.approx((y_end - y) / box.height, rel=1e-6)
    xy = np.concatenate([result.pieces[0].xy for result in comparison.plants.values()])
    assert np.all(xy > (x, y))
    assert np.all(xy < (x_end, y_end))


def test_a_plant_and_its_line_look_the_same_in_every_panel_and_no_two_alike() -> None:
    found = panels(drawn("scenario")[1])
    looks = [
        {name: (line.get_color(), str(line.get_linestyle())) for name, line in lines(found[key]).items()}
        for key in ("paths", "rate")
    ]
    assert all(looks[0][name] == looks[1][name] for name in PLANTS)
    dashes = [lines(found["paths"])[name]._dash_pattern for name in PLANTS]  # type: ignore[attr-defined]
    assert all(a != b for a, b in itertools.combinations(dashes, 2)), "they differ in grey too"
    assert len({look[0] for look in looks[0].values()}) == len(PLANTS)


def test_there_is_one_legend_of_plants() -> None:
    labels = [legend_texts(ax) for ax in drawn("scenario")[1].axes]
    ((*labels,),) = [each for each in labels if any("mujoco" in label for label in each)]
    assert [label.split("\n")[0] for label in labels] == [*PLANTS, "command"]
    assert labels[0].endswith("reference")


def test_lines_break_at_gaps() -> None:
    found = panels(drawn("gaps")[1])
    for key in ("rate", "speed"):
        for name, line in lines(found[key]).items():
            gaps = np.flatnonzero(np.isnan(x_of(line)))
            assert len(gaps) == 2, name
            assert np.array_equal(np.isnan(x_of(line)), np.isnan(y_of(line)))
            stamps = x_of(line)[~np.isnan(x_of(line))]
            assert np.all(np.diff(stamps) > 0.0)
    assert np.isnan(y_of(lines(found["loads"])["front_left"])).sum() == 2


def test_a_recording_is_shown_in_windows_laid_on_their_start() -> None:
    comparison, figure = drawn("recording")
    windows = [ax for ax in figure.axes if ax.get_xlabel() == "ahead [m]"]
    assert len(windows) == MAX_WINDOWS
    assert "windows of 6 s" in written(figure)
    reference = comparison.reference[0]
    for ax in windows:
        assert set(lines(ax)) == {"recording", "mujoco", "kinematic"}
        start, end = (float(word) for word in ax.get_title(loc="left").removesuffix(" s").split(" to "))
        assert end - start == pytest.approx(6.0, abs=0.11)
        for name, line in lines(ax).items():
            piece = reference if name == "recording" else comparison.plants[name].pieces[0]
            a = int(np.argmin(np.abs(piece.t - start)))
            seen = np.column_stack([x_of(line), y_of(line)])
            assert np.array_equal(seen, relative(piece.pose[a], piece.pose[a : a + len(seen)])[:, :2])
            assert np.array_equal(seen[0], [0.0, 0.0])


def test_windows_do_not_depend_on_where_in_the_world_it_was() -> None:
    """A quarter turn and a shift move everything alike."""

    def moved(piece: Trajectory) -> Trajectory:
        return replace(piece, pose=compose([4.0, -3.0, 0.5 * math.pi], piece.pose))

    here, figure = drawn("recording")
    there = replace(
        here,
        reference=tuple(map(moved, here.reference)),
        plants={n: replace(r, pieces=tuple(map(moved, r.pieces))) for n, r in here.plants.items()},
    )
    for a, b in zip(figure.axes, comparison_figure(there).axes, strict=True):
        for name, line in lines(a).items() if a.get_xlabel() == "ahead [m]" else ():
            assert y_of(line) == pytest.approx(y_of(lines(b)[name]), abs=1e-9)  # metres, of coordinates of some metres


def test_horizons_take_the_place_of_errors_over_time() -> None:
    comparison, figure = drawn("recording")
    found = panels(figure)
    for key, scale, of in (("position", 1.0, "position_median_m"), ("yaw", 180.0 / math.pi, "yaw_median_rad")):
        ax = found[key]
        assert "by horizon" in ax.get_title(loc="left")
        assert ax.get_yscale() == "log"
        assert [label.get_text() for label in ax.get_xticklabels()] == [f"{h} s\n9 windows" for h in (2, 6, 30)]
        for name, result in comparison.plants.items():
            assert y_of(lines(ax)[name]) == pytest.approx([scale * getattr(e, of) for e in result.horizons.values()])
        columns = [x_of(line) for line in lines(ax).values()]
        assert np.all(columns[0] < columns[1]), "points stand side by side"


def test_medians_of_overlapping_windows_and_notes_stand_in_the_picture() -> None:
    comparison, figure = drawn("recording")
    for key, scale, of in (("position", 1.0, "position_median_m"), ("yaw", 180.0 / math.pi, "yaw_median_rad")):
        ax = panels(figure)[key]
        drawn_at = [float(y) for line in ax.lines if line.get_marker() == "_" for y in np.asarray(line.get_ydata())]
        for result in comparison.plants.values():
            for errors in result.overlapping.values():
                assert any(y == pytest.approx(scale * getattr(errors, of)) for y in drawn_at)
    assert "cannot tell" in written(figure)


def test_perfect_horizons_are_no_logarithms_of_zero() -> None:
    comparison = recorded()
    perfect = {h: HorizonErrors(3, 0.0, 0.0, 0.0, 0.0) for h in (2.0, 6.0)}
    plants = {name: replace(result, horizons=perfect) for name, result in comparison.plants.items()}
    assert panels(comparison_figure(replace(comparison, plants=plants)))["position"].get_yscale() == "linear"


def test_yaw_errors_stay_within_half_a_turn_and_break_where_they_wrap() -> None:
    comparison = make(("mujoco", "linear"))
    piece = comparison.plants["linear"].pieces[0]
    ahead = np.column_stack([piece.pose[:, :2], comparison.reference[0].yaw + 0.8 * piece.t])
    plants = {**comparison.plants, "linear": replace(comparison.plants["linear"], pieces=(replace(piece, pose=ahead),))}
    error = y_of(lines(panels(comparison_figure(replace(comparison, plants=plants)))["yaw"])["linear"])
    assert np.isnan(error).sum() == 3, "16 rad are two and a half turns"
    assert np.nanmax(np.abs(error)) <= 180.0
    assert np.nanmax(np.abs(np.diff(error))) < 5.0


def chattering(peak: float) -> Comparison:
    """Coulomb's acceleration flips its sign at every sample, and once reaches `peak`."""
    comparison = make(stamps=[np.arange(0.0, 20.0, 0.008)])
    coulomb = comparison.plants["coulomb"]
    piece = coulomb.pieces[0]
    flips = 2.0 * (-1.0) ** np.arange(len(piece))
    for turn in 2.0 * math.pi * np.arange(1, 4):  # where the yaw rate changes its sign
        flips[int(np.argmin(np.abs(piece.t - turn)))] = peak
    piece = replace(piece, channels={**piece.channels, "yaw_acceleration_rad_s2": flips})
    return replace(comparison, plants={**comparison.plants, "coulomb": replace(coulomb, pieces=(piece,))})


def test_chatter_is_drawn_thin_and_behind_where_the_turn_reverses() -> None:
    figure = comparison_figure(chattering(2.0))
    ax = panels(figure)["acceleration"]
    start, end = ax.get_xlim()
    reversals = 2.0 * math.pi * np.arange(1, 4)  # of sin(t / 2)
    assert np.any((start < reversals) & (reversals < end))
    drawn = lines(ax)
    for name in ("mujoco", "improved", "linear"):
        assert drawn["coulomb"].get_zorder() < drawn[name].get_zorder()
        assert drawn["coulomb"].get_linewidth() < drawn[name].get_linewidth()
    low, high = ax.get_ylim()
    assert low < -2.0
    assert 2.0 < high < 3.0
    assert "cut off" not in written(figure)


def test_a_spike_is_cut_off_and_said() -> None:
    figure = comparison_figure(chattering(400.0))
    ax = panels(figure)["acceleration"]
    assert np.nanmax(y_of(lines(ax)["coulomb"])) == 400.0, "the spike lies within what is shown"
    assert ax.get_ylim()[1] < 10.0
    assert "coulomb, which reaches 400, is cut off" in written(figure)


def test_what_all_plants_do_is_no_spike() -> None:
    comparison = chattering(400.0)
    spike = comparison.plants["coulomb"].pieces[0].channels["yaw_acceleration_rad_s2"]
    linear = comparison.plants["linear"]
    piece = replace(linear.pieces[0], channels={"yaw_acceleration_rad_s2": 0.5 * spike})
    figure = comparison_figure(replace(comparison, plants={**comparison.plants, "linear": replace(linear, pieces=(piece,))}))
    assert panels(figure)["acceleration"].get_ylim()[1] > 400.0
    assert "cut off" not in written(figure)


def test_panels_without_data_are_left_out() -> None:
    for name, missing in {
        "without mujoco": {"loads"},
        "only the reference": {"zoom", "position", "yaw"},
        "only a recording": set(TITLES) - {"rate", "speed"},
    }.items():
        assert set(TITLES) - set(panels(drawn(name)[1])) == missing


def test_the_caption_says_how_it_was_made(case: tuple[Comparison, Figure]) -> None:
    comparison, figure = case
    text = written(figure)
    for part in (
        "source traj4",
        "profile thesis-lab",
        f"reference {comparison.reference_name}",
        "seed 7",
        "noise",
        "ssmr-testbed 0.1.0",
        "mujoco 3.17.0",
    ):
        assert part in text


def overlapping(figure: Figure) -> list[str]:
    """Texts that leave the figure or cover one another."""
    renderer, whole = figure.canvas.get_renderer(), figure.bbox  # type: ignore[attr-defined]
    boxes = [(text.get_text(), text.get_window_extent(renderer)) for text in texts(figure)]
    wrong = [t for t, b in boxes if b.x0 < whole.x0 or b.x1 > whole.x1 or b.y0 < whole.y0 or b.y1 > whole.y1]
    return wrong + [
        f"{one!r} covers {other!r}" for (one, a), (other, b) in itertools.combinations(boxes, 2) if a.overlaps(b)
    ]


def test_nothing_written_overlaps_or_leaves_the_picture(case: tuple[Comparison, Figure]) -> None:
    assert overlapping(case[1]) == []


def test_no_setting_outlives_a_call_and_none_leaks_in(tmp_path: Path) -> None:
    before = dict(matplotlib.rcParams)
    plain = comparison_figure(make(("mujoco", "linear")))
    save_figure(plain, tmp_path / "plain.png")
    assert dict(matplotlib.rcParams) == before
    with matplotlib.rc_context({"font.size": 30.0, "axes.facecolor": "black", "lines.linewidth": 9.0, "savefig.dpi": 20}):
        save_figure(comparison_figure(make(("mujoco", "linear"))), tmp_path / "styled.png")
    assert np.array_equal(imread(tmp_path / "plain.png"), imread(tmp_path / "styled.png"))


def test_a_failure_leaves_what_was_there_and_nothing_beside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "compare.png"
    path.write_bytes(b"before")
    figure = comparison_figure(make(("mujoco",)))

    def half(self: Image.Image, fname: Path, **_: object) -> None:
        fname.write_bytes(b"half")
        raise OSError("disk full")

    with monkeypatch.context() as patch:
        patch.setattr(Image.Image, "save", half)
        with pytest.raises(OSError, match="disk full"):
            save_figure(figure, path)
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(ValueError, match="nonsense"):
        save_figure(figure, tmp_path / "compare.nonsense")
    with pytest.raises(OSError, match="missing"):
        save_figure(figure, tmp_path / "missing" / "compare.png")
    assert list(tmp_path.iterdir()) == [path]
    save_figure(figure, path)
    assert path.read_bytes().startswith(b"\x89PNG")


def test_the_zoom_shows_less_than_the_paths_and_is_outlined_in_them() -> None:
    ax = panels(comparison_figure(make(stamps=[np.arange(0.0, 20.0, 0.008)])))
    width = {name: float(np.ptp(ax[name].get_xlim())) for name in ("paths", "zoom")}
    assert width["zoom"] < 0.4 * width["paths"]
    (outline,) = ax["paths"].patches[-1:]
    assert outline.get_width() == pytest.approx(width["zoom"])  # type: ignore[attr-defined]
