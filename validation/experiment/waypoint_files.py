"""Waypoints from CSV files, and by the name of a reference trajectory.

A file has a header that names x and y [m] and, where it brings its times, t [s]. A column `yaw`
[rad] says where the robot faces, so it can drive backwards and turn on the spot. A column `frame`
names the frame in which they are; other columns are ignored.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib import resources
from pathlib import Path
from types import MappingProxyType

import numpy as np

from ssmr.control.references import circle, eight, line, sine, spiral, square, stop_and_go, u_turn
from ssmr.control.waypoints import Waypoints, find_fault
from ssmr.types import FloatArray
from validation.files.columns import Column
from validation.files.reading import FileError, quoted, read_text
from validation.files.tables import CsvTable, read_csv_table

_HEADER = (
    "a file of waypoints begins with a header that names x and y [m] and, "
    "if it brings its times, t [s]; one that brings none needs speed, such as --speed 0.25"
)
_UNITS = {"x": "m", "y": "m", "t": "s", "yaw": "rad"}
DEFAULT_SPEED = 0.25
"""Speed of references that have a name, where none is given [m/s]; the slower of the thesis'."""


def read_waypoints(path: str | Path, speed: float | None = None) -> Waypoints:
    """Read waypoints (Alg. 5, lines 1-7).

    A UTF-8 byte order mark, any line ending and blank lines are fine. Upper and lower case of a
    column's name mean the same.

    Args:
        path: a CSV file.
        speed: reference speed [m/s]: it gives the times, and replaces those of the file, except the
            lengths of its waits. None: the file's own.

    Raises:
        FileError: the file cannot be read, has no waypoints, no times while there is no speed, or
            is beyond the limits.
        ValueError: the speed is not positive and finite.
    """
    path = Path(path)
    if path.suffix.lower() != ".csv" and not path.is_dir():
        raise FileError(
            path, f"files ending in '{path.suffix}' are not read; wanted waypoints (.csv)"
        )
    table = read_csv_table(path)
    names = [name.lower() for name in table.header]
    optional = ["yaw"] * ("yaw" in names)
    wanted = ("x", "y") if speed is not None else ("x", "y", "t")
    _require_columns(table, names, (*wanted, *optional))

    def column(name: str) -> FloatArray:
        return table.numbers(names.index(name), Column(_UNITS[name], "", math.inf))

    t = column("t") if speed is None else None
    xy = np.column_stack([column("x"), column("y")])
    yaw = column("yaw") if optional else None
    if len(xy) < 2:
        some = "is one waypoint" if len(xy) else "are no waypoints"
        raise FileError(path, f"there {some} after the header; a trajectory needs at least two")
    fault = find_fault(t, xy, yaw)
    waits = fault is not None and fault[1] is None
    if t is None and waits and names.count("t") == 1:  # the times say how long
        t = column("t")
        fault = find_fault(t, xy, yaw)
    if fault is not None:
        row, name, what = fault
        raise FileError(path, what, table.lines[row], name)
    if t is None:
        assert speed is not None  # or the file has times
        return Waypoints.from_path(xy, speed, yaw)
    waypoints = Waypoints(t, xy, yaw)
    return waypoints if speed is None else waypoints.at_speed(speed)


def _require_columns(table: CsvTable, names: Sequence[str], wanted: Sequence[str]) -> None:
    """Refuse a table whose columns, of these names, are not each of the `wanted` ones once."""
    for name in wanted:
        if name not in names:
            what = f"there is no column {name} among {quoted(table.header)}; {_HEADER}"
            raise FileError(table.path, what, table.header_line)
        if names.count(name) > 1:
            what = "the header names this column twice; each needs a name of its own"
            raise FileError(table.path, what, table.header_line, name)


def frame_of_waypoints(reference: str) -> str:
    """Return the frame that the column `frame` of a file of waypoints names.

    It is empty for a reference that has a name, and for a file without that column.

    Raises:
        FileError: the file cannot be read, or its waypoints are not all in one frame.
    """
    name, _ = split_speed(reference)
    path = Path(name)
    if name in REFERENCES or not path.suffix:
        return ""
    table = read_csv_table(path)
    for name, word in zip(table.header, table.bad, strict=True):
        if name.lower() == "frame" and word is not None:
            frame = word[1].strip()
            mentions = re.findall(rf"(?<![\w/]){re.escape(frame)}(?![\w/])", read_text(path))
            if len(mentions) < len(table.lines):
                what = f"not all waypoints are in the frame {quoted([frame])}"
                raise FileError(path, what, None, name)
            return frame
    return ""


def _generic_path(speed: float) -> Waypoints:
    """Return the generic trajectory: a lab's tight corners (docs/tracking.md).

    It is practicable at 0.25 m/s and hardly at 0.5. The thesis' own (Fig. 4.5) is lost. The
    reference speed is in m/s.

    Raises:
        ValueError: the speed is not positive and finite.
    """
    folder = resources.files("validation.experiment")
    with resources.as_file(folder.joinpath("references", "generic.csv")) as path:
        return read_waypoints(path, speed)


REFERENCES: Mapping[str, Callable[[float], Waypoints]] = MappingProxyType(
    {
        # of Sec. 4.1.3
        "line": line,
        "circle": circle,
        "sine": sine,
        "generic": _generic_path,
        # of this project
        "eight": eight,
        "slalom": partial(sine, amplitude=0.35, wavelength=2.4, periods=4.0),  # at most 2.40 1/m
        "square": square,
        "spiral": spiral,
        "u-turn": u_turn,
        "stop-and-go": stop_and_go,
        "long-line": partial(line, length=200.0),  # errors that grow slowly show
    }
)
"""All references that have a name, the thesis' and this project's own, each a function of the
reference speed [m/s]."""


def split_speed(reference: str) -> tuple[str, float | None]:
    """Return the name or path and the speed [m/s], or None, of a reference such as `circle@0.5`.

    Raises:
        ValueError: the speed of a reference that has a name is no number.
    """
    name, at, speed = reference.rpartition("@")
    if not at:
        return reference, None
    try:
        return name, float(speed)
    except ValueError as error:
        if name in REFERENCES:
            raise ValueError(f"'{reference}' is no REFERENCE@SPEED such as circle@0.5") from error
        return reference, None


def open_reference(name_or_path: str, speed: float | None = None) -> tuple[str, Waypoints]:
    """Return the name in tables and the waypoints of a reference by its name, or of a CSV file.

    The name or path may have a speed behind it, as `circle@0.5`, or `speed` [m/s] is given. Without
    either, a file has its own times, and a reference that has a name is driven at 0.25 m/s.

    Raises:
        ValueError: an unknown name, two different speeds, a file without times where there is no
            speed, or one that cannot be read.
    """
    name, named_speed = split_speed(name_or_path)
    if speed is None:
        speed = named_speed
    elif named_speed is not None and named_speed != speed:
        raise ValueError(
            "two speeds are given, "
            f"{named_speed:g} m/s in '{name_or_path}' and {speed:g} m/s; "
            "leave out one of them"
        )
    if name in REFERENCES:
        return name, REFERENCES[name](DEFAULT_SPEED if speed is None else speed)
    path = Path(name)
    if not path.suffix and not path.exists():
        raise ValueError(
            f"no reference '{name}'; there are: {', '.join(REFERENCES)}, and paths of .csv files"
        )
    return path.stem, read_waypoints(path, speed)
