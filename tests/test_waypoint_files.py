"""Files of waypoints: what is refused and how it is said, and what survives a round trip."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.control.waypoints import Waypoints
from tests.conftest import ROUNDOFF
from validation.experiment.waypoint_files import REFERENCES, open_reference, read_waypoints
from validation.files.reading import FileError

HEADER = "t,x,y\n"


def on_file(folder: Path, text: str | bytes, name: str = "way.csv") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8"))
    return path


BAD_FILES: dict[str, tuple[str | bytes, str]] = {
    "empty": ("", ": the file is empty; wanted a header line with the names of columns"),
    "header alone": (
        HEADER,
        ": there are no waypoints after the header; a trajectory needs at least two",
    ),
    "one row": (HEADER + "0,0,0\n", ": there is one waypoint after the header"),
    "no x": (
        "t,y\n0,0\n1,1\n",
        ", line 1: there is no column x among 't', 'y'; a file of waypoints begins with",
    ),
    "no time": (
        "x,y\n0,0\n1,1\n",
        ", line 1: there is no column t among",
    ),
    "twice": (
        "t,x,y,X\n0,0,0,0\n1,1,1,1\n",
        ", line 1, column x: the header names this column twice",
    ),
    "nothing": (
        HEADER + "0,0,0\n1,1, \n",
        ", line 3, column y: there is nothing, wanted a finite number [m]",
    ),
    "nan": (
        HEADER + "0,0,0\n\nnan,1,1\n",
        ", line 4, column t: there is 'nan', wanted a finite number [s]",
    ),
    "waits without times": (
        "x,y\n0,0\n3,4\n3,4\n",
        ", line 4: it is where the one before is, at (3, 4) m; give times",
    ),
    "one place": (
        HEADER + "0,1,2\n1,1,2\n2,1,2\n",
        ", line 4: no waypoint is away from the first, so there is no heading",
    ),
    "time twice": (
        HEADER + "0,0,0\n0,1,2\n",
        ", line 3, column t: time must increase, but 0 s follows 0 s",
    ),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_what_has_no_waypoints_is_refused_in_one_line(case: str, tmp_path: Path) -> None:
    text, message = BAD_FILES[case]
    path = on_file(tmp_path, text)
    with pytest.raises(FileError) as caught:
        read_waypoints(path, 0.5 if case == "waits without times" else None)
    assert str(caught.value).startswith(f"{path}{message}")
    assert "\n" not in str(caught.value)


# --------------------------------------------------------------------------------------------------
# what is read


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_marks_endings_blank_lines_and_other_columns_do_not_matter(
    newline: str, mark: str, tmp_path: Path
) -> None:
    lines = ["note, X ,t,y,", "", "a,0.5,10,1,", "b,1.5,12,1,nan", "  "]
    waypoints = read_waypoints(on_file(tmp_path, mark + newline.join(lines)))
    assert np.array_equal(waypoints.t, [10.0, 12.0])
    assert np.array_equal(waypoints.xy, [[0.5, 1.0], [1.5, 1.0]])


def test_a_speed_replaces_the_times_of_a_file(tmp_path: Path) -> None:
    """Also such that are no times."""
    for text in ("x,y\n0,0\n3,4\n", HEADER + "7,0,0\n9,3,4\n", HEADER + "now,0,0\nthen,3,4\n"):
        waypoints = read_waypoints(on_file(tmp_path, text), 0.5)
        assert np.array_equal(waypoints.t, [0.0, 10.0])
    with pytest.raises(ValueError, match="speed must be positive"):
        read_waypoints(on_file(tmp_path, "x,y\n0,0\n3,4\n"), -1.0)


def test_waypoints_at_one_place_are_a_wait_that_a_speed_leaves_as_long_as_it_is(
    tmp_path: Path,
) -> None:
    path = on_file(tmp_path, HEADER + "7,0,0\n9,3,4\n12,3,4\n13,3,5\n")
    own = read_waypoints(path)
    commanded = read_waypoints(path, 0.5)
    assert np.array_equal(own.t, [7.0, 9.0, 12.0, 13.0])
    assert np.array_equal(commanded.t, [0.0, 10.0, 13.0, 15.0])
    assert np.array_equal(own.moving, [True, False, True])


@given(
    st.lists(
        st.tuples(st.floats(1e-3, 1e3), st.floats(1e-3, 1e3), st.floats(-1e6, 1e6)),
        min_size=2,
        max_size=9,
    )
)
def test_a_file_gives_the_waypoints_back(
    tmp_path_factory: pytest.TempPathFactory, steps: list[tuple[float, float, float]]
) -> None:
    table = np.cumsum(steps, axis=0)
    waypoints = Waypoints(table[:, 0], table[:, 1:])
    rows = [("t", "x", "y"), *table.tolist()]
    text = "\n".join(",".join(map(str, row)) for row in rows)
    read = read_waypoints(on_file(tmp_path_factory.mktemp("files"), text))
    assert np.array_equal(read.t, waypoints.t)
    assert np.array_equal(read.xy, waypoints.xy)


# --------------------------------------------------------------------------------------------------
# by name


@pytest.mark.parametrize("name", REFERENCES)
@pytest.mark.parametrize(("commanded", "driven"), [(0.5, 0.5), (None, 0.25)])
def test_references_open_by_name_with_a_speed(
    name: str, commanded: float | None, driven: float
) -> None:
    label, waypoints = open_reference(name, commanded)
    assert label == name
    assert waypoints.speed == pytest.approx(driven, rel=ROUNDOFF)


def test_a_reference_is_opened_with_the_speed_behind_its_name(tmp_path: Path) -> None:
    label, waypoints = open_reference("eight@0.4")
    assert label == "eight"
    assert waypoints.speed == pytest.approx(0.4, rel=ROUNDOFF)
    path = on_file(tmp_path, "x,y\n0,0\n2,0\n")
    assert open_reference(f"{path}@0.5")[1].duration == 4.0
    with pytest.raises(
        ValueError, match=r"two speeds are given, 0.4 m/s in 'eight@0.4' and 0.5 m/s"
    ):
        open_reference("eight@0.4", 0.5)
    with pytest.raises(ValueError, match="'eight@fast' is no REFERENCE@SPEED"):
        open_reference("eight@fast")
