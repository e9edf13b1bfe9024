"""Nasty texts, numbers and files."""

from __future__ import annotations

import math
import random

NASTY_BYTES = (
    b"nan", b"inf", b"-inf", b"1e308", b"-1e400", b"1e-320", b"0", b"-0", b"", b"\x00", b"\xff\xfe", "ü–".encode(),
    b"9" * 400, b"true", b"[]", b"{}", b"'", b'"', b"\\", b",", b"=", b"#", b"\r", b"0x1F", b"1_000", b"- 1", b"None",
    b"<a>", b"[red]", b"[/]", b"\x1b[31m", b"1e200", b"1700000000", b"1.7e18", b"../../x", "\u202e".encode(),
    b"[" * 3000,
)  # fmt: skip
"""What takes the place of words and numbers in files."""

NASTY_TEXTS = (
    "", " ", "nan", "inf", "-inf", "1e308", "-1e400", "1e-320", "0", "-0", "-1", "9" * 400, "1.5", "true", "None", "[]",
    "{}", "'", '"', "\\", ",", ",,", "=", "a=", "=1", "a=1,a=1", "a=nan", "a=1:0", "a=0:inf", ":", "#", "0x1F", "1_000",
    "- 1", "<b>a</b>", "[red]", "[/]", "[/x]", "\x1b[31mred", "\x1b]0;title\x07", "ü–é", "\u202eabc", "\udcff", "a\nb",
    "a\tb", "../../x", "/", ".", "..", "/dev/null", "/dev/zero", "/proc/self/mem", "~", "$HOME", "%s", "{0}", "*",
    "x" * 300, "a/" * 600, "٣", "1e5000", "1e300", "-1e300", "1e15", "1e-300", "--help", "-", "--", "@", "@x", "x@",
    "traj1@", "@mujoco", "a,b,c", "improved", "mujoco", "mujoco,mujoco", "improved,kinematic", "line", "circle@0.5",
    "circle@nan", "circle@1e9", "circle@", "rough:1e9", "ramp:89.9", "split:-1", "ramp:nan", "ramp:5,seed=-1",
    "traj4@linear", "thesis-lab", "tuned", "good.csv", "empty.csv", "folder.csv", "pipe.csv", "zero.csv", "loop.csv",
    "good.toml", "way.csv", "deep.toml", "red \x1b[31m.csv", "\udcff.csv", "[/x].csv", "nothing.csv", "good.csv/x",
    "pipe.toml", "zero.toml",
)  # fmt: skip
"""What is given to options; the files among them are those of `tests.faults.files.lay_out`."""

PLAUSIBLE = ("0.25", "0.5", "1", "1.5", "2", "3", "10", "0.01")
"""Values that many options take, so that not everything is refused."""

NASTY_COUNTS = (
    "0", "-1", "1", "2", "3", "1.5", "1e3", "nan", "", "9" * 400, str(10**30), str(2**63), str(2**31), "0x10", "٣",
)  # fmt: skip
"""What is given to options that count something."""
GENERATIONS = ("0", "-1", "1", "2", "1.5", "nan", "", "9" * 400, "x")
"""What is given to options by which a run may rightly take for ever."""

EXTREMES = (
    math.nan, math.inf, -math.inf, 0.0, -0.0, 1e308, -1e308, 1e-308, 5e-324, -1.0, 1e6, -1e6, 1e15, 1e-15, 1.0, 0.5, 2.0,
    1e200, 1.7e9, 1.7e18,
)  # fmt: skip
"""Numbers that somebody did not mean."""
WHOLE_EXTREMES = (0, -1, 1, 2, -(2**31), 2**31, 2**63, -(2**63), 10**30)
"""For what counts something."""


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Return data with one to four things wrong."""
    out = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(out) + 1)
        span = min(len(out) - at, rng.choice((1, 4, 16, 64, 512)))
        kind = rng.randrange(9)
        if kind == 0 and span:
            out[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            del out[at:]
        elif kind == 2:
            del out[at : at + span]
        elif kind == 3:
            out[at:at] = rng.randbytes(span)
        elif kind == 4:
            out[at : at + span] = rng.randbytes(span)
        elif kind == 5:
            out[at:at] = out[at : at + span]
        else:  # a word, a number or a field by something else
            words = [i for i, byte in enumerate(out) if byte in b" ,=\n:"]
            if words:
                start = rng.choice(words) + 1
                end = next((i for i in words if i >= start), len(out))
                out[start:end] = rng.choice(NASTY_BYTES)
    return bytes(out)


COLUMN_NAMES = (
    "pose", "cmd vel", "cmd_vel", "ü", "é", "[/x]", "[red]", "\x1b[31m", "a,b", "", " ", "t", "x", "odom", "\u202ex",
    "__index__", "../x", "<b>", "nan", "1", "x" * 300, "gyro_z", "current_left", "tf", "topic/with/slashes", "/", "a b",
    "-", "%s",
)  # fmt: skip
"""Names of channels that somebody has in a log."""


def hostile_table(rows: list[list[str]], rng: random.Random) -> list[list[str]]:
    """Return a table of text, header first, that is well formed and yet means what nobody meant."""
    header, body = list(rows[0]), [list(row) for row in rows[1:]]
    for _ in range(rng.randint(1, 3)):
        rng.choice(_CHANGES)(header, body, rng)
    return [header, *body]


def _other_clock(header: list[str], body: list[list[str]], rng: random.Random) -> None:
    """Unix time, nanoseconds, before 1970, backwards, absurd."""
    shift, factor = rng.choice(((1.7e9, 1), (0, 1e9), (-1e6, 1), (0, 1e300), (1.7e18, 1), (0, 1e-12), (0, -1)))
    for row in body:
        row[0] = repr(_number(row[0]) * factor + shift)


def _stray_stamp(header: list[str], body: list[list[str]], rng: random.Random) -> None:
    if body:
        body[-1][0] = rng.choice(("1e9", "1e18", "1e308", "nan", "-1"))


def _scaled(header: list[str], body: list[list[str]], rng: random.Random) -> None:
    column, factor = rng.randrange(len(header)), rng.choice((1e200, 1e308, 1e-308, 1e15, -1e6))
    for row in body:
        row[column] = repr(_number(row[column]) * factor)


def _constant(header: list[str], body: list[list[str]], rng: random.Random) -> None:
    column, value = rng.randrange(len(header)), rng.choice(("nan", "inf", "0", "1e308", "-1e308", "", "x", "1e200"))
    for row in body:
        row[column] = value


def _one_value(header: list[str], body: list[list[str]], rng: random.Random) -> None:
    if body:
        rng.choice(body)[rng.randrange(len(header))] = repr(rng.choice(EXTREMES))


def _more_columns(header: list[str], body: list[list[str]], rng: random.Random) -> None:
    for name in rng.sample(COLUMN_NAMES, rng.randint(1, 4)):
        header.append(name)
        for row in body:
            row.append(rng.choice(("1", "0.5", "nan", "x", "1e308")))


def _renamed(header: list[str], body: list[list[str]], rng: random.Random) -> None:
    header[rng.randrange(len(header))] = rng.choice((*COLUMN_NAMES, *header))


def _other_rows(header: list[str], body: list[list[str]], rng: random.Random) -> None:
    """In another order, doubled, or few."""
    kind = rng.randrange(3)
    if kind == 0:
        rng.shuffle(body)
    elif kind == 1:
        body.extend(list(row) for row in body[: rng.randrange(len(body) + 1)])
    else:
        del body[rng.choice((0, 1, 2, 3)) :]


_CHANGES = (_other_clock, _stray_stamp, _scaled, _constant, _one_value, _more_columns, _renamed, _other_rows)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return 0.0
