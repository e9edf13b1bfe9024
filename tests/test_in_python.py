"""A notebook shows readable signatures, and has motions, changed numbers and tables as HTML."""

from __future__ import annotations

import inspect
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest

from validation import load_profile
from validation.compare import Comparison, compare
from validation.fit import fit
from validation.report.report import Report
from validation.track import track

LAB = load_profile("thesis-lab")


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    """A comparison on trajectory 4 with another friction."""
    slippery = LAB.with_(mujoco={"friction": 0.4, "command_half_track": 0.3})
    return compare("traj4", slippery, plants=("mujoco", "linear"))


@pytest.mark.parametrize("program", [compare, fit, track])
def test_a_signature_names_types_as_people_do(program: Any) -> None:
    signature = inspect.signature(program)
    words = str(signature)
    assert "profile: Profile | str | Path | None = None" in words
    assert not [
        word for word in ("validation.", "pathlib.", "typing.", "collections.") if word in words
    ]
    assert words.endswith(("-> Comparison", "-> Fitted", "-> Tracked"))


def test_numbers_change_by_their_names() -> None:
    changed = LAB.with_(mujoco={"friction": 0.4, "command_half_track": 0.3}, linear={"k_u": 0.1})
    assert changed.section("mujoco").parameters.friction == 0.4
    assert changed.section("mujoco").drive.command_half_track == 0.3
    assert changed.section("linear").parameters.k_u == 0.1
    assert LAB.section("mujoco").parameters.friction != 0.4
    assert changed.section("improved") == LAB.section("improved")
    assert changed.name != LAB.name


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gazebo": {}}, "thesis-lab has unknown keys gazebo; there are: coulomb"),
        ({"mujoco": {"y": 1.0}}, "mujoco has unknown keys y; there are: "),
        ({"mujoco": {"friction": -1.0}}, r"friction = -1.0 lies outside"),
        ({"mujoco": {"friction": "a"}}, "friction"),
        ({"mujoco": 3}, "mujoco is 3, wanted a table"),
    ],
)
def test_what_is_no_number_of_a_plant_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        LAB.with_(**change)


def test_motions_are_there_by_plant(comparison: Comparison) -> None:
    xy = comparison.motion("mujoco").xy
    np.testing.assert_array_equal(xy, comparison.runs["mujoco"].motions[0].xy)
    usual = compare("traj4", LAB, plants=("mujoco",)).motion("mujoco").xy
    assert np.abs(xy - usual).max() > 1e-3  # the changed numbers drive
    with pytest.raises(ValueError, match="no plant 'ode' was driven; there are: mujoco, linear"):
        comparison.motion("ode")
    tracked = track("pid", "circle", plant=("improved", "linear"))
    assert [robot.plant for robot in tracked.robots] == ["improved", "linear"]
    ends = [tracked.motion(name).xy[-1] for name in ("improved", "linear")]
    assert 0.0 < np.hypot(*(ends[0] - ends[1])) < 0.2
    with pytest.raises(ValueError, match="there are: improved, linear"):
        tracked.motion("mujoco")


class Cells(HTMLParser):
    """The rows of the tables of a piece of HTML."""

    def __init__(self) -> None:
        """Begin without rows."""
        super().__init__()
        self.rows = list[list[str]]()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Begin a row or a cell."""
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_data(self, data: str) -> None:
        """Add the text of a cell."""
        if self.rows and self.rows[-1]:
            self.rows[-1][-1] += data.strip()


def test_a_notebook_shows_tables(comparison: Comparison) -> None:
    cells = Cells()
    cells.feed(comparison._repr_html_())
    (linear,) = [row for row in cells.rows if row[0] == "linear"]
    frame = comparison.frame().set_index("plant")
    assert float(linear[1]) == pytest.approx(frame.loc["linear", "d_rms_m"], abs=6e-4)
    assert repr(comparison).startswith("<compare: traj4, thesis-lab")
    assert len(repr(comparison)) < 120


def test_every_result_says_in_a_line_what_it_is() -> None:
    kinds: list[Any] = [Report]
    for kind in kinds:
        kinds += kind.__subclasses__()
    assert len(kinds) > 6
    own = [kind for kind in kinds if kind.__module__.startswith("validation.")]
    assert {kind.__name__ for kind in own if kind.__repr__ is not Report.__repr__} == set()
