"""Results of all programs keep one contract.

They print, draw, and save files that are whole and finite.
"""

from __future__ import annotations

import itertools
import json
from collections import Counter
from collections.abc import Callable
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.lines import Line2D
from matplotlib.text import Text

from ssmr.control.references import circle, line
from tests.test_gains import hopeless
from tests.test_objective import recorded
from tests.test_rerun_log import run_rerun
from validation.compare import compare
from validation.files.csv_logs import write_csv
from validation.fit import fit
from validation.output import Progress
from validation.plants.profile import Profile
from validation.report.picture import png_of
from validation.robots import check_robot
from validation.track import track
from validation.tune import tune

pytestmark = pytest.mark.usefixtures("with_drawings")


def interrupt(now: Progress) -> None:
    """Press Ctrl-C after the second generation."""
    if now.done == 2.0:
        raise KeyboardInterrupt


SMALL: dict[str, Any] = {"population": 8, "generations": 3, "seed": 1}
TUNED: dict[str, Any] = {
    "plant": ("linear",),
    "free": ("q_x", "r_v"),
    "no_noise": True,
    "held_out": ("line@0.5",),
    **SMALL,
}
FITTED: dict[str, Any] = {
    "held_out": ("traj1@improved",),
    "objective": "path",
    "free": ("y_l", "alpha_l"),
    **SMALL,
}
HORIZONS = (2.0, 6.0)
MADE: dict[str, Callable[[str], Any]] = {
    "compare": lambda log: compare("traj4", "thesis-lab"),
    "compare on a log": lambda log: compare(log, "thesis-lab", horizons=HORIZONS),
    "compare one plant": lambda log: compare("traj1", plants=("kinematic",), reference="kinematic"),
    "fit": lambda log: fit("kinematic", log, **FITTED),
    "fit, interrupted": lambda log: fit("linear", "traj4@improved", progress=interrupt, **SMALL),
    "track": lambda log: track("lqr", circle(0.5), "linear"),
    "track four plants": lambda log: track(
        "pid", line(0.5), ("linear", "kinematic", "improved", "coulomb"), lookahead=0.2
    ),
    "track, lost": lambda log: track("pid", line(0.5), ("kinematic", "linear"), gains=hopeless()),
    "tune": lambda log: tune("lqr", ("circle@0.5", "line@0.4"), **TUNED),
    "tune, interrupted": lambda log: tune("lqr", "circle@0.5", progress=interrupt, **TUNED),
    "robots check": lambda log: check_robot("jackal"),
}
"""A result of every program, made of the path of a log with a gap."""


@pytest.fixture(scope="module")
def log(lab: Profile, tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("log") / "drive.csv"
    write_csv(recorded(lab, seconds=60.0), path)
    return str(path)


@pytest.fixture(scope="module")
def result(log: str) -> Callable[[str], Any]:
    """The result of that name, made once."""
    return cache(lambda name: MADE[name](log))


@pytest.fixture(scope="module", params=MADE)
def made(request: pytest.FixtureRequest, result: Callable[[str], Any]) -> Any:
    return result(request.param)


@pytest.fixture(scope="module")
def figure(made: Any) -> Figure:
    before = dict(matplotlib.rcParams)
    drawn: Figure = made.figure()
    assert dict(matplotlib.rcParams) == before
    return drawn


@pytest.fixture(scope="module")
def saved(made: Any, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    written: list[Path] = made.save(tmp_path_factory.mktemp("saved") / "new")
    return written


def seen(figure: Figure) -> list[Text]:
    """Everything written in a figure, numbers at the axes left out."""
    numbers = {
        id(label) for ax in figure.axes for label in (*ax.get_xticklabels(), *ax.get_yticklabels())
    }
    every = [
        text for text in figure.findobj(Text) if isinstance(text, Text) and id(text) not in numbers
    ]
    return [text for text in every if text.get_visible() and text.get_text().strip()]


def overlapping(figure: Figure) -> list[str]:
    """Texts that leave the figure or cover one another."""
    renderer, whole = figure.canvas.get_renderer(), figure.bbox  # type: ignore[attr-defined]
    boxes = [(text.get_text(), text.get_window_extent(renderer)) for text in seen(figure)]
    wrong = [
        t
        for t, b in boxes
        if b.x0 < whole.x0 or b.x1 > whole.x1 or b.y0 < whole.y0 or b.y1 > whole.y1
    ]
    return wrong + [
        f"{one!r} covers {two!r}"
        for (one, a), (two, b) in itertools.combinations(boxes, 2)
        if a.overlaps(b)
    ]


@pytest.mark.parametrize("width", [80, 120])
def test_it_prints_within_the_terminal(made: Any, width: int) -> None:
    text = made.table(width)
    assert all(len(row) <= width and "…" not in row for row in text.splitlines())
    assert not {"nan", "inf", "-inf", "None"} & set(text.split())


def test_nothing_written_in_its_picture_overlaps_or_leaves_it(figure: Figure) -> None:
    assert overlapping(figure) == []


def test_its_files_are_whole_and_finite_and_rerun_takes_them(made: Any, saved: list[Path]) -> None:
    files = {path.suffix: path for path in saved}
    assert sorted(saved) == sorted(saved[0].parent.iterdir())
    document = json.loads(saved[0].read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert document.pop("files") == [path.name for path in saved[1:]]
    assert document == json.loads(json.dumps(made.as_dict(), allow_nan=False))
    assert document["schema"] == f"ssmr.{saved[0].stem}/1"
    assert {"numpy", "mujoco", "ssmr-testbed"} <= set(document["versions"])
    assert imread(files[".png"]).shape[1] == 1600
    if ".rrd" in files:
        done = run_rerun("rrd", "verify", files[".rrd"])
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", ["compare", "track four plants"])
def test_a_picture_shows_the_paths_that_were_driven(
    name: str, result: Callable[[str], Any]
) -> None:
    made = result(name)
    paths = [r.run.columns("x", "y") for r in made.robots] if hasattr(made, "robots") else [
        run.motions[0].xy for run in made.runs.values()
    ]  # fmt: skip
    drawn = [np.asarray(curve.get_xydata()) for ax in made.figure().axes for curve in ax.lines]
    assert all(any(np.array_equal(path, curve) for curve in drawn) for path in paths)


def test_no_line_over_time_bridges_a_gap(result: Callable[[str], Any]) -> None:
    made = result("compare on a log")
    (before, after) = made.truth
    for ax in made.figure().axes:
        for curve in ax.lines:
            x, y = np.asarray(curve.get_xydata(), dtype=np.float64).T
            ends = np.flatnonzero(np.isclose(x[:-1], before.t[-1]) & np.isclose(x[1:], after.t[0]))
            assert not np.isfinite(y[ends]).any()


def test_every_line_of_a_picture_is_drawn_once(
    result: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = Counter[Line2D]()
    draw = Line2D.draw

    def count(self: Line2D, *its: Any) -> None:
        drawn[self] += 1
        draw(self, *its)

    monkeypatch.setattr(Line2D, "draw", count)
    panels = result("compare one plant").figure().axes
    assert {drawn[curve] for ax in panels for curve in ax.lines} == {1}


def test_no_setting_leaks_into_a_picture(result: Callable[[str], Any]) -> None:
    made = result("compare one plant")
    plain = png_of(made.figure())
    with matplotlib.rc_context(
        {"font.size": 30.0, "axes.facecolor": "black", "lines.linewidth": 9.0, "savefig.dpi": 20}
    ):
        styled = png_of(made.figure())
    assert np.array_equal(imread(BytesIO(plain)), imread(BytesIO(styled)))


def test_a_picture_that_fails_leaves_what_was_there_and_the_numbers_are_kept(
    result: Callable[[str], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = Path.write_bytes

    def half(self: Path, data: bytes) -> int:
        if self.suffix != ".png":
            return whole(self, data)
        whole(self, data[: len(data) // 2])
        raise OSError("disk full")

    whole(tmp_path / "compare.png", b"before")
    monkeypatch.setattr(Path, "write_bytes", half)
    with pytest.raises(OSError, match="disk full"):
        result("compare one plant").save(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"compare.png", "compare.json"}
    assert (tmp_path / "compare.png").read_bytes() == b"before"
