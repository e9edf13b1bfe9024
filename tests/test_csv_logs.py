"""Logs in CSV files: refusals and their messages, round trips, and gaps in time."""

from __future__ import annotations

import logging
import math
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from ssmr.parameters import describe_parameters
from validation.files import tables
from validation.files.columns import COLUMNS, RECORDED, is_column_name
from validation.files.csv_logs import read_csv, write_csv
from validation.files.formats import read_log
from validation.files.limits import USUAL, LogLimits
from validation.files.log import Log, ReadOptions
from validation.files.names import taken_by_name
from validation.files.reading import FileError
from validation.files.signals import TIME_ROUNDOFF

HEADER = "t,cmd_v,cmd_w,x,y,yaw\n"


def on_file(folder: Path, text: str | bytes) -> Path:
    path = folder / "drive.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8"))
    return path


def timed(t: list[float], **columns: list[float]) -> Log:
    """A log with these times and, unless given, commands of zero."""
    return Log.of_columns("drive.csv", {"t": t, **(columns or {"cmd_v": [0.0] * len(t)})})


# --------------------------------------------------------------------------------------------------
# bad files
BAD_FILES: dict[str, tuple[str | bytes, int | None, str | None, str]] = {
    "empty": ("", None, None, "the file is empty; wanted a header line"),
    "header alone": (
        HEADER,
        None,
        None,
        "there are no samples after the header; a log needs at least two",
    ),
    "no time below blank lines": (
        "\n\ncmd_v,cmd_w\n0,0\n1,1\n",
        3,
        None,
        "no column t among 'cmd_v', 'cmd_w'",
    ),
    "nothing known": (
        "t,foo,bar\n0,1,2\n1,1,2\n",
        1,
        None,
        "no known column among 't', 'foo', 'bar'",
    ),
    "same name twice": ("t,x,foo, x\n0,0,0,0\n1,0,0,0\n", 1, "x", "twice"),
    "one column": ("t\n0\n1\n", 1, None, "nothing separates the columns; wanted commas"),
    "other names": (
        "moment,x\n0,0\n",
        1,
        None,
        "--columns t=NAME,x=NAME says which columns have other names",
    ),
    "text for a number": (
        HEADER + "0,0,0,0,0,0\n1,0,abc,0,0,0\n",
        3,
        "cmd_w",
        "'abc', wanted a finite number [rad/s]",
    ),
    "grouped digits": (HEADER + "0,0,0,0,0,0\n1,1_0,0,0,0,0\n", 3, "cmd_v", "'1_0'"),
    "nothing": (
        HEADER + "0,0,0,0,0,0\n1,0,0,0, ,0\n",
        3,
        "y",
        "there is nothing, wanted a finite number [m]",
    ),
    "inf": (
        HEADER + "0,0,0,0,0,0\n0.1,0,0,0,0,-inf\n",
        3,
        "yaw",
        "'-inf', wanted a finite number [rad]",
    ),
    "time turns back": (
        HEADER + "0,0,0,0,0,0\n\n-1,0,0,0,0,0\n",
        4,
        "t",
        "increase, but -1 s follows 0 s",
    ),
    "too few fields": (
        HEADER + "0,0,0,0,0,0\n1,0,0\n",
        3,
        None,
        "3 fields, wanted 6 as in the header",
    ),
    "quote never closed": (HEADER + '0,0,0,0,0,0\n1,"0,0,0,0,0\n2,0,0,0,0,0\n', 3, None, "no CSV"),
    "line counted past a quoted line break": ('t,x,note\n0,0,"a\nb"\n1,?,c\n', 4, "x", "'?'"),
    "binary": (b"\x00\x01\x02\xff", 1, None, "a NUL byte; wanted a CSV file"),
    "not UTF-8": (
        HEADER.encode() + b"0,0,0,0,0,0\n1,\xb5,0,0,0,0\n",
        3,
        "cmd_v",
        "wanted a finite number",
    ),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_file_says_what_and_where_in_one_line(tmp_path: Path, case: str) -> None:
    text, line, column, what = BAD_FILES[case]
    path = on_file(tmp_path, text)
    with pytest.raises(FileError) as caught:
        read_csv(path)
    error = caught.value
    message = str(caught.value)
    assert (error.path, error.line, error.column) == (path, line, column)
    assert what in message
    assert line is None or f"{path}, line {line}" in message
    assert column is None or f"column {column}:" in message
    assert message.isprintable()
    assert len(message) < 500 + len(str(path))


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"t": [0.0], "x": [0.0]}, "at least two samples"),
        ({"x": [0.0, 1.0]}, "needs a column t"),
        ({"t": [0.0, 1.0, 1.0], "x": [0.0] * 3}, "t must increase; it does not after sample 1"),
        ({"t": [0.0, 1.0], "x": [0.0]}, "x has shape"),
        ({"t": [0.0, 1.0], "x": [0.0, math.inf]}, "x is not finite"),
        ({"t": [0.0, 1.0], "foo": [0.0, 1.0]}, "none of the columns cmd_v"),
        ({"t": [0.0, 1.0], "x": [0.0, 1.0], " a": [0.0, 1.0]}, "' a' is no name of a column"),
    ],
)
def test_logs_that_cannot_be_are_not_made(columns: dict[str, list[float]], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Log.of_columns("drive.csv", columns)


# --------------------------------------------------------------------------------------------------
# good files
def test_mark_line_endings_blank_lines_and_spaces_are_fine(tmp_path: Path) -> None:
    log = read_csv(
        on_file(
            tmp_path, "\ufefft, x ,y,yaw,acc_x\r\n0, 1,2,3,4\r\n\r\n0.5,5,6,7,8\r\n\r\n  \r\n\r\n"
        )
    )
    assert (log.name, log.t.tolist()) == ("drive", [0.0, 0.5])
    turned = 7.0 - 2.0 * math.pi  # yaw is unwrapped
    assert {n: a.tolist() for n, a in log.columns.items()} == {
        "x": [1.0, 5.0], "y": [2.0, 6.0], "yaw": [3.0, pytest.approx(turned)], "acc_x": [4.0, 8.0],
    }  # fmt: skip
    assert list(log.groups) == ["pose", "channels"]
    assert list(read_csv(on_file(tmp_path, ",t,x,\n0,0.0,1,\n1,0.5,2,\n")).columns) == [
        "x"
    ]  # pandas' index, and a last comma


@pytest.mark.parametrize("cells", [("a", "b", "c"), ("1", "hm", "3"), ("1", "2", "-inf")])
def test_columns_that_are_no_numbers_throughout_are_left_out_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, cells: tuple[str, ...]
) -> None:
    path = on_file(
        tmp_path,
        "t,x,note,acc_x\n" + "".join(f"{k},0,{cell},{k}\n" for k, cell in enumerate(cells)),
    )
    with caplog.at_level(logging.WARNING, logger="validation.files"):
        assert list(read_csv(path).columns) == ["x", "acc_x"]
    (message,) = caplog.messages
    assert "column note: there is" in message
    assert message.endswith("the column is left out")


def test_an_empty_cell_is_no_sample(tmp_path: Path) -> None:
    """Topics of different rates as pandas merges them, two at the same instant in two rows."""
    rows = [
        (0.0, 1.0, 2.0, "", ""),
        (0.0, "", "", 0.0, ""),
        (0.1, "", "", 0.2, 5.0),
        (0.15, "", "", "", 6.0),
    ]
    rows += [(0.2, 3.0, 4.0, 0.4, 7.0), (0.3, "", "", 0.6, "")]
    text = "t,enc_left,enc_right,x,cmd_v\n" + "".join(
        ",".join(map(str, row)) + "\n" for row in rows
    )
    log = read_log(on_file(tmp_path, text))
    assert {n: g.t.tolist() for n, g in log.groups.items()} == {
        "wheels": [0.0, 0.2], "pose": [0.0, 0.1, 0.2, 0.3], "cmd": [0.1, 0.15, 0.2],
    }  # fmt: skip
    assert log.columns["x"].tolist() == [0.0, 0.2, 0.4, 0.6]
    assert log.on_one_clock().t.tolist() == pytest.approx([0.0, 0.1, 0.2])


def test_columns_cannot_be_changed() -> None:
    source = np.array([0.0, 1.0, 2.0])
    log = Log.of_columns("drive.csv", {"t": source, "x": source, "a": source})
    source[0] = 9.0
    for array in (log.t, *log.columns.values(), log.table(("x",))):
        assert array.ravel()[0] == 0.0
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


@given(data=st.data(), n=st.integers(2, 12))
def test_round_trip_is_bit_identical(
    data: st.DataObject, n: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    finite, possible = (
        st.lists(st.floats(-most, most), min_size=n, max_size=n) for most in (1e100, 100.0)
    )
    moment = st.floats(-1e9, 1e9).map(lambda v: v + 0.0)  # 0.0 and -0.0 are one instant
    names = st.text(st.characters(exclude_categories=["Cs"]), min_size=1).filter(is_column_name)
    t = sorted(data.draw(st.lists(moment, min_size=n, max_size=n, unique=True)))
    known = data.draw(st.dictionaries(st.sampled_from(RECORDED), possible, min_size=1))
    others = data.draw(
        st.dictionaries(names.filter(lambda s: s != "t" and s not in COLUMNS), finite, max_size=3)
    )
    path = tmp_path_factory.mktemp("round") / "drive.csv"
    columns = {
        n: np.zeros(len(t)) if n.endswith("yaw") else a for n, a in {**known, **others}.items()
    }
    written = Log.of_columns("drive.csv", {"t": t, **columns})
    assume(not taken_by_name(["t", *columns]))  # a heading is taken for the yaw, as it should be
    write_csv(written, path)
    got = read_csv(
        path,
        ReadOptions(limits=USUAL.changed(dict.fromkeys(describe_parameters(LogLimits), math.inf))),
    )
    assert got.t.tobytes() == written.t.tobytes()
    assert {k: a.tobytes() for k, a in got.columns.items()} == {
        k: a.tobytes() for k, a in written.columns.items()
    }


def test_columns_are_written_as_a_log_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    write_csv({"acc": [1, 2], "x": [0.1, 0.2], "t": [0, 1]}, path)
    assert path.read_bytes() == b"t,x,acc\n0.0,0.1,1.0\n1.0,0.2,2.0\n"
    with pytest.raises(ValueError, match=r"other\.csv: a log needs a column t"):
        write_csv({"x": [0.0, 1.0]}, tmp_path / "other.csv")
    assert [p.name for p in tmp_path.iterdir()] == ["drive.csv"]


# -------------------------------------------------------------------------------------------------
# gaps, cuts, columns
@given(steps=st.lists(st.floats(1e-3, 1.0), min_size=1, max_size=40))
def test_stretches_span_no_gap_and_lose_only_lone_samples(steps: list[float]) -> None:
    log = timed(np.cumsum([0.0, *steps]).tolist())
    limit = 2.5 * float(np.median(np.diff(log.t))) + TIME_ROUNDOFF
    inside = np.zeros(len(log.t), dtype=bool)
    for stretch in log.stretches():
        assert np.all(np.diff(log.t[stretch]) <= limit)
        assert not inside[stretch].any()
        inside[stretch] = True
    step = np.concatenate([[np.inf], np.diff(log.t), [np.inf]])
    assert np.array_equal(inside, (step[:-1] <= limit) | (step[1:] <= limit))


@pytest.mark.parametrize("share", [0.03, 0.1, 0.2, 0.3])
@pytest.mark.parametrize("seed", range(3))
def test_samples_that_chance_loses_end_no_piece(share: float, seed: int) -> None:
    """Rows that chance takes from an even raster make no gaps; a longer loss does."""
    draw = np.random.default_rng(seed)
    t = 0.02 * np.flatnonzero(draw.random(6000) > share)
    t = t[(t < 50.0) | (t > 51.5)]
    log = timed(t.tolist())
    pieces = [log.t[piece] for piece in log.stretches()]
    assert any(piece[-1] < 50.0 and after[0] > 51.5 for piece, after in pairwise(pieces))
    assert len(pieces) < 10
    assert max(map(np.ptp, pieces)) > 10.0
    part = log.cut(10.0, 20.0)
    ends = {float(piece[-1]) for piece in pieces}
    assert {float(part.t[s][-1]) for s in part.stretches()[:-1]} <= ends


def test_bursts_are_no_gaps() -> None:
    """A logger that writes ten samples at once, ten times a second."""
    t = (0.1 * np.arange(60)[:, None] + 0.001 * np.arange(10)).ravel()
    log = timed(t.tolist())
    assert len(log.stretches()) == 1
    broken = timed(t[(t < 2.0) | (t > 3.0)].tolist())
    assert len(broken.stretches()) == 2


def test_a_cut_keeps_both_ends_and_moves_no_gap() -> None:
    log = timed([0.0, 1.0, 2.0, 6.0, 7.0], x=list(np.arange(5.0)), a=list(np.arange(5.0)))
    part = log.cut(1.0, 6.0)
    assert part.t.tolist() == [1.0, 2.0, 6.0]
    assert {n: a.tolist() for n, a in part.columns.items()} == {
        "x": [1.0, 2.0, 3.0],
        "a": [1.0, 2.0, 3.0],
    }
    # by its own median step there would be no gap
    assert [part.t[s].tolist() for s in part.stretches()] == [[1.0, 2.0]]
    assert log.cut(None, 1.5).t.tolist() == [0.0, 1.0]
    assert log.cut().t.tolist() == log.t.tolist()
    with pytest.raises(ValueError, match="nothing but gaps between 2 and 6 s"):
        log.cut(2.0, 6.0).stretches()
    for start, stop in ((8.0, None), (None, -1.0), (3.0, 1.0), (2.0, 3.0), (math.nan, None)):
        with pytest.raises(
            FileError, match=r"nothing was logged in .*; there is drive\.csv 0 to 7 s"
        ):
            log.cut(start, stop)


def test_columns_with_other_names_and_units_are_read_as_ours(tmp_path: Path) -> None:
    ours = tmp_path / "ours.csv"
    theirs = tmp_path / "theirs.csv"
    t = 0.05 * np.arange(60)
    columns = {
        "t": t,
        "x": 0.5 * t,
        "y": 0.1 * t,
        "yaw": 0.2 * t,
        "enc_left": 3.0 + t,
        "cmd_v": 0.5 + 0.0 * t,
    }
    write_csv(columns, ours)
    factors = {"t": 1e3, "x": 1e3, "y": 1.0, "yaw": 180.0 / np.pi, "enc_left": 0.15, "cmd_v": 3.6}
    names = {
        "t": "stamp",
        "x": "pos_x",
        "y": "pos_y",
        "yaw": "heading",
        "enc_left": "wl",
        "cmd_v": "v",
    }
    rows = np.column_stack([columns[name] * factors[name] for name in names])
    np.savetxt(
        theirs, rows, delimiter=",", header=",".join(names.values()), comments="", fmt="%.12g"
    )
    read = {
        "t": ("stamp", "ms"),
        "x": ("pos_x", "mm"),
        "y": ("pos_y", ""),
        "yaw": ("heading", "deg"),
        "enc_left": ("wl", "m/s"),
        "cmd_v": ("v", "km/h"),
    }
    wanted = read_csv(ours)
    measured = read_csv(theirs, ReadOptions(columns=read), radius=0.15)
    assert set(measured.columns) == set(wanted.columns)
    for name, values in wanted.columns.items():
        assert np.allclose(measured.columns[name], values, rtol=1e-9, atol=1e-9), name
    for wrong, message in (
        ({"x": ("lost", "")}, "no column 'lost'"),
        ({"x": ("heading", ""), "yaw": ("heading", "")}, "takes one column for two"),
        ({"yaw": ("heading", "km/h")}, "yaw cannot be in 'km/h'; its units are rad, deg"),
        ({"enc_left": ("wl", "m/s")}, "needs the radius of the wheels"),
    ):
        with pytest.raises(FileError, match=message):
            read_csv(theirs, ReadOptions(columns={"t": ("stamp", "ms"), **wrong}))


PLAIN = "t,x,y\n0,1.5,-2e-3\n0.1,,0.30000000000000004\n0.2,+3,1e5\n"


@pytest.mark.parametrize(
    "text",
    [
        *(PLAIN, PLAIN.replace("\n", "\r\n"), "\ufeff" + PLAIN, PLAIN.replace("1.5", '"1.5"')),
        *(PLAIN.replace("1.5", cell) for cell in ("nan", "inf", "1e400", "1_0", "0x10", " 7 ")),
        *(PLAIN.replace("1.5", cell) for cell in ("text", "None", "2026-01-02 03:04:05", '"a\nb"')),
        *(PLAIN + "\n0.3,1,1\n", PLAIN + "0.3,1\n", PLAIN + "0.3,1,1,1\n", PLAIN.strip()),
        *(PLAIN.replace(",", sign) for sign in ";\t| "),
        *(PLAIN.replace(",", ";").replace(".", ","), "sep=,\n" + PLAIN, "log\n\n" + PLAIN),
        *("t;x;y\n0;0,5;1\n1;0.5;1\n", 't,x,y\n0,"0,5",1\n1,"0,25",1\n'),
        *('"t","x","y"\n0,1,2\n', '"t\n",x,y\n0,1,2\n', "t,x,y\n", "0,1,2\n1,2,3\n", "\n" + PLAIN),
    ],
)
def test_a_large_file_is_read_as_a_small_one_is(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files that pyarrow would read in another way are read by the careful reader."""
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8", newline="")
    found: list[object] = []
    for smallest, block in ((1 << 22, 1 << 21), (0, 1 << 21), (0, 24)):
        monkeypatch.setattr(tables, "_QUICK", smallest)
        monkeypatch.setattr(tables, "_BLOCK", block)
        try:
            table = tables.read_csv_table(path)
            columns = [column.tobytes() for column in table.columns]
            found.append((columns, table.header, list(table.lines), list(table.bad)))
        except FileError as error:
            found.append(str(error))
    assert found[0] == found[1] == found[2]


def test_a_log_keeps_the_columns_of_a_large_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second copy of the numbers would double the memory that reading takes."""
    path = tmp_path / "log.csv"
    path.write_text("t,x,y\n" + "".join(f"{k},{k}.5,{-k}\n" for k in range(100)))
    monkeypatch.setattr(tables, "_QUICK", 0)
    read = tables.read_csv_table(path)
    columns = dict(zip(read.header, read.columns, strict=True))
    log = Log.of_columns(path, columns)
    for name, values in log.columns.items():
        assert np.shares_memory(values, columns[name])


@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="there is no /proc here")
def test_a_large_table_is_read_in_little_more_than_its_numbers(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    path = tmp_path / "long.csv"
    rest = ",".join([f"{math.pi:.15f}"] * 12)
    names = ",".join(["t", "x", *(f"more_{k}" for k in range(11))])
    with path.open("w") as file:
        file.write(f"{names}\n")
        file.writelines(f"{0.05 * k:.2f},{rest}\n" for k in range(100_000))
    code = f"""
from pathlib import Path
import pyarrow.csv
import validation.files.formats
from validation.files.tables import read_csv_table
def peak():
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
before = peak()
table = read_csv_table(Path({str(path)!r}))
print(1024 * (peak() - before) - sum(column.nbytes for column in table.columns))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(done.stdout) < 40e6, "text or numbers were held twice"
