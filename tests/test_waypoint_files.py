"""Files of waypoints: what is refused and how it is said, and what survives a round trip."""

from __future__ import annotations

import datetime
import sys
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.control.waypoints import Waypoints
from tests.conftest import ROUNDOFF
from validation import cli
from validation.logs.limits import USUAL
from validation.track.waypoint_files import REFERENCES, WaypointError, open_reference, read_waypoints

openpyxl = pytest.importorskip("openpyxl", reason="spreadsheets need the extra `xlsx`")
HEADER = "t,x,y\n"
ROWS = [(0.0, 0.1, 0.2), (1.0, 1.1, 0.2), (2.5, 1.1, 1.0 / 3.0)]

SHEET = 1e-15
"""Relative: openpyxl writes 16 digits, where a double needs 17."""


def on_file(folder: Path, text: str | bytes, name: str = "way.csv") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8"))
    return path


def on_sheet(folder: Path, rows: Sequence[Sequence[object]], name: str = "way.xlsx") -> Path:
    book = openpyxl.Workbook()
    for row in rows:
        book.active.append(list(row))
    book.create_sheet("other").append(["not", "read"])
    book.save(folder / name)
    return folder / name


def refused(path: Path, speed: float | None = None) -> str:
    """The one line that a file is refused with; a command line would leave with status 2 on it."""
    with pytest.raises(WaypointError) as caught:
        read_waypoints(path, speed)
    with pytest.raises(cli.UserError), cli.mistakes_are_users():
        read_waypoints(path, speed)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(str(path))
    return text.removeprefix(str(path))


# ------------------------------------------------------------------------------------------------------------ bad files

BAD_FILES: dict[str, tuple[str | bytes, str]] = {
    "empty": ("", ": the file is empty; a file of waypoints begins with a header that names x and y [m]"),
    "header alone": (HEADER, ": there are no waypoints after the header; a trajectory needs at least two"),
    "one row": (HEADER + "0,0,0\n", ": there is one waypoint after the header"),
    "no x": ("t,y\n0,0\n1,1\n", ", line 1: there is no column x among 't', 'y'; a file of waypoints begins with"),
    "no header": ("0,0,0\n1,1,0\n", ", line 1: there is no column x among '0', '0', '0'"),
    "semicolons": ("t;x;y\n0;0;0\n", ", line 1: semicolons separate the columns"),
    "no time": ("x,y\n0,0\n1,1\n", ", line 1: there is no column t [s]: add one, or give the reference speed"),
    "twice": ("t,x,y,X\n0,0,0,0\n1,1,1,1\n", ", line 1, column x: the header names this column twice"),
    "text": (HEADER + "0,0,0\n1,abc,0\n", ", line 3, column x: there is 'abc', wanted a finite number [m]"),
    "nothing": (HEADER + "0,0,0\n1,1, \n", ", line 3, column y: there is nothing, wanted a finite number [m]"),
    "nan": (HEADER + "0,0,0\n\nnan,1,1\n", ", line 4, column t: there is 'nan', wanted a finite number [s]"),
    "far": (HEADER + "0,0,0\n1,1e300,0\n", ", line 3, column x: x is 1e+300, wanted a finite number [m] no larger"),
    "ragged": (HEADER + "0,0,0\n1,1\n", ", line 3: there are 2 fields, wanted 3 as in the header"),
    "one place": (HEADER + "0,1,2\n1,1,2\n2,1,2\n", ", line 4: no waypoint is away from the first, so there is no heading"),
    "time back": (HEADER + "0,0,0\n\n2,1,2\n1,2,2\n", ", line 5, column t: time must increase, but 1 s follows 2 s"),
    "time twice": (HEADER + "0,0,0\n0,1,2\n", ", line 3, column t: time must increase, but 0 s follows 0 s"),
    "rubbish": (bytes(range(256)), ", line 2: there is a byte that is not UTF-8"),
    "open quote": (HEADER + '0,"0,0\n', ", line 2: this is no CSV"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_what_has_no_waypoints_is_refused_in_one_line(case: str, tmp_path: Path) -> None:
    text, message = BAD_FILES[case]
    assert refused(on_file(tmp_path, text)).startswith(message)


BAD_SHEETS: dict[str, tuple[Sequence[Sequence[object]], str]] = {
    "empty": ((), ": the first sheet is empty; a file of waypoints begins with a header"),
    "header alone": ((("t", "x", "y"),), ": there are no waypoints after the header"),
    "one row": ((("t", "x", "y"), (0, 0, 0)), ": there is one waypoint after the header"),
    "no header": (((0, 0.5, 0), (1, 1, 0)), ", row 1: there is no column x among '0', '0.5', '0'"),
    "text": ((("t", "x", "y"), (0, 0, 0), (), (1, "abc", 0)), ", row 4, column x: there is 'abc', wanted a finite number"),
    "truth": ((("t", "x", "y"), (0, 0, 0), (1, True, 0)), ", row 3, column x: there is 'True'"),
    "date": ((("t", "x", "y"), (datetime.datetime(2020, 1, 31), 0, 0)), ", row 2, column t: there is '2020-01-31"),
    "nothing": ((("t", "x", "y"), (0, 0), (1, 1, 1)), ", row 2, column y: there is nothing"),
    "formula": ((("t", "x", "y"), (0, 0, 0), (1, "=1+1", 0)), ", row 3, column x: there is nothing"),
    "one place": ((("t", "x", "y"), (0, 1, 2), (1, 1, 2)), ", row 3: no waypoint is away from the first"),
    "time back": ((("t", "x", "y"), (1, 1, 2), (0, 2, 2)), ", row 3, column t: time must increase"),
}


@pytest.mark.parametrize("case", BAD_SHEETS)
def test_a_sheet_without_waypoints_is_refused_in_one_line(case: str, tmp_path: Path) -> None:
    rows, message = BAD_SHEETS[case]
    assert refused(on_sheet(tmp_path, rows)).startswith(message)


@pytest.mark.parametrize("name", ["way.csv", "way.xlsx"])
def test_a_file_that_is_not_there_or_a_folder_is_refused(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    assert refused(path) == ": there is no such file; wanted waypoints (.csv or .xlsx)"
    path.mkdir()
    assert refused(path) == ": this is a folder; wanted waypoints (.csv or .xlsx)"


@pytest.mark.parametrize("name", ["way.txt", "way.xls", "way"])
def test_other_endings_are_refused(name: str, tmp_path: Path) -> None:
    message = refused(on_file(tmp_path, HEADER + "0,0,0\n1,1,0\n", name))
    assert message == f": files ending in '{Path(name).suffix}' are not read; wanted waypoints (.csv or .xlsx)"


def test_rubbish_is_no_spreadsheet(tmp_path: Path) -> None:
    for data in (b"", b"PK\x03\x04rubbish", HEADER.encode(), bytes(range(256)) * 9):
        assert "this is no xlsx file, or a damaged one" in refused(on_file(tmp_path, data, "way.xlsx"))


def test_a_damaged_spreadsheet_is_refused_or_read_as_it_was(tmp_path: Path) -> None:
    """One byte changed, or the end cut off: 300 times, wherever."""
    whole = on_sheet(tmp_path, [("t", "x", "y"), *ROWS]).read_bytes()
    rng = np.random.default_rng(0)
    refusals = []
    for _ in range(150):
        bad = bytearray(whole)
        bad[int(rng.integers(len(bad)))] ^= int(rng.integers(1, 256))
        for data in (bytes(bad), whole[: int(rng.integers(len(whole)))]):
            path = on_file(tmp_path, data, "damaged.xlsx")
            try:
                waypoints = read_waypoints(path)
            except WaypointError as error:
                refusals.append(str(error))
            else:
                assert np.allclose(np.column_stack([waypoints.t, waypoints.xy]), ROWS, rtol=SHEET, atol=0.0)
    assert len(refusals) > 100
    assert not any("\n" in text for text in refusals)


def in_sheet(xml: bytes) -> Callable[[bytes], bytes]:
    return lambda text: text.replace(b"</sheetData>", xml + b"</sheetData>")


HOSTILE_SHEETS: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "far row": (in_sheet(b'<row r="90000000"><c r="A90000000"><v>1</v></c></row>'), "there is a row beyond 1048576"),
    "bomb": (in_sheet(b" " * 70_000_000), "files once it is unpacked, but the limit sheet_size is 64 MB"),
    "deep": (in_sheet(b"<row>" + b"<c>" * 200 + b"</c>" * 200 + b"</row>"), "elements of XML"),
    "many": (in_sheet(b"<d/>" * 80_000), "70000 besides those of cells"),
    "laughs": (
        lambda text: b'<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;">]>' + text.partition(b"?>")[2],
        "declares a type of document",
    ),
}


@pytest.mark.parametrize("case", HOSTILE_SHEETS)
def test_a_hostile_spreadsheet_is_refused_before_it_takes_time_or_memory(case: str, tmp_path: Path) -> None:
    change, message = HOSTILE_SHEETS[case]
    whole, hostile = on_sheet(tmp_path, [("t", "x", "y"), *ROWS]), tmp_path / "hostile.xlsx"
    with zipfile.ZipFile(whole) as source, zipfile.ZipFile(hostile, "w", zipfile.ZIP_DEFLATED) as target:
        for name in source.namelist():
            text = source.read(name)
            target.writestr(name, change(text) if name.endswith("sheet1.xml") else text)
    assert message in refused(hostile)


def test_a_spreadsheet_beyond_limits_that_were_asked_for_is_refused(tmp_path: Path) -> None:
    path = on_sheet(tmp_path, [("t", "x", "y"), *ROWS])
    assert len(read_waypoints(path).t) == 3
    for limits, message in (({"samples": 2}, "row 4: there are too many rows"), ({"columns": 2}, "there are 3 columns")):
        with pytest.raises(WaypointError, match=message):
            read_waypoints(path, limits=USUAL.changed(limits))


def test_without_openpyxl_a_spreadsheet_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = on_sheet(tmp_path, [("t", "x", "y"), *ROWS])
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    assert "pip install 'ssmr-testbed[xlsx]'" in refused(path)


# ------------------------------------------------------------------------------------------------------- what is read


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_marks_endings_blank_lines_and_other_columns_do_not_matter(newline: str, mark: str, tmp_path: Path) -> None:
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


def test_waypoints_at_one_place_are_a_wait_that_a_speed_leaves_as_long_as_it_is(tmp_path: Path) -> None:
    path = on_file(tmp_path, HEADER + "7,0,0\n9,3,4\n12,3,4\n13,3,5\n")
    own, asked = read_waypoints(path), read_waypoints(path, 0.5)
    assert np.array_equal(own.t, [7.0, 9.0, 12.0, 13.0])
    assert np.array_equal(asked.t, [0.0, 10.0, 13.0, 15.0])
    assert np.array_equal(own.moving, [True, False, True])


def test_places_that_repeat_without_times_are_refused(tmp_path: Path) -> None:
    path = on_file(tmp_path, "x,y\n0,0\n3,4\n3,4\n")
    expected = "line 4: it is where the one before is, at \\(3, 4\\) m; give times, to wait, or leave out one of them"
    with pytest.raises(WaypointError, match=expected):
        read_waypoints(path, 0.5)


@given(st.lists(st.tuples(st.floats(1e-3, 1e3), st.floats(1e-3, 1e3), st.floats(-1e6, 1e6)), min_size=2, max_size=9))
def test_both_kinds_of_file_give_the_waypoints_back(
    tmp_path_factory: pytest.TempPathFactory, steps: list[tuple[float, float, float]]
) -> None:
    table = np.cumsum(steps, axis=0)
    waypoints = Waypoints(table[:, 0], table[:, 1:])
    folder = tmp_path_factory.mktemp("files")
    rows = [("t", "x", "y"), *table.tolist()]
    text = "\n".join(",".join(map(str, row)) for row in rows)
    from_csv, from_sheet = read_waypoints(on_file(folder, text)), read_waypoints(on_sheet(folder, rows))
    assert np.array_equal(from_csv.t, waypoints.t)
    assert np.array_equal(from_csv.xy, waypoints.xy)
    assert np.allclose(from_sheet.t, waypoints.t, rtol=SHEET, atol=0.0)
    assert np.allclose(from_sheet.xy, waypoints.xy, rtol=SHEET, atol=0.0)


# -------------------------------------------------------------------------------------------------------------- by name


@pytest.mark.parametrize("name", REFERENCES)
@pytest.mark.parametrize(("asked", "driven"), [(0.5, 0.5), (None, 0.25)])
def test_references_open_by_name_with_a_speed(name: str, asked: float | None, driven: float) -> None:
    label, waypoints = open_reference(name, asked)
    assert label == name
    assert waypoints.speed == pytest.approx(driven, rel=ROUNDOFF)


def test_files_open_by_path(tmp_path: Path) -> None:
    path = on_file(tmp_path, HEADER + "0,0,0\n2,1,0\n")
    label, waypoints = open_reference(str(path))
    assert (label, waypoints.speed) == ("way", 0.5)
    assert open_reference(str(path), 0.25)[1].duration == 4.0


def test_a_reference_is_opened_with_the_speed_behind_its_name(tmp_path: Path) -> None:
    label, waypoints = open_reference("eight@0.4")
    assert label == "eight"
    assert waypoints.speed == pytest.approx(0.4, rel=ROUNDOFF)
    path = on_file(tmp_path, "x,y\n0,0\n2,0\n")
    assert open_reference(f"{path}@0.5")[1].duration == 4.0
    assert open_reference("eight@0.4", 0.4)[1].speed == pytest.approx(0.4, rel=ROUNDOFF)
    with pytest.raises(ValueError, match=r"two speeds are given, 0.4 m/s in 'eight@0.4' and 0.5 m/s"):
        open_reference("eight@0.4", 0.5)
    with pytest.raises(ValueError, match="'eight@fast' is no REFERENCE@SPEED"):
        open_reference("eight@fast")
    at = tmp_path / "me@home.csv"
    at.write_text(HEADER + "0,0,0\n2,1,0\n")
    assert open_reference(str(at))[0] == "me@home"


def test_an_unknown_name_lists_those_there_are() -> None:
    with pytest.raises(
        ValueError, match=r"no reference 'oval'; there are: line, circle, sine, generic, eight, .*, and paths of"
    ):
        open_reference("oval", 0.25)
    with pytest.raises(WaypointError, match="no such file"):
        open_reference("nowhere.csv", 0.25)
