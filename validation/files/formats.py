"""The table of log formats, and reading and writing a log in the format of its path."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from validation.files.bags import read_bag
from validation.files.columns import COMMAND_COLUMNS
from validation.files.csv_logs import frame_path, read_csv, read_frame, write_csv
from validation.files.log import PLAIN, DataFrame, Log, ReadOptions, check_group
from validation.files.reading import FileError, exists, opened
from validation.files.trajectories import read_trajectory, write_tum


@dataclass(frozen=True)
class LogFormat:
    """A file format of logs."""

    endings: tuple[str, ...]
    """Endings of its files, in lower case, such as `.csv`."""
    read: Callable[[Path, ReadOptions, float | None], Log] | None = None
    """Function that reads such a file, by the options and the radius of the robot's wheels [m] or
    None, and raises `FileError`, with the place of the fault, if it cannot; None for a format that
    is only written. A format with one clock returns `Log.of_columns(path, columns)`."""
    write: Callable[[Log, Path], None] | None = None
    """Function that writes a log whole or not at all; None for a format that is only read."""
    folder: str = ""
    """Name of the folders that are read as well, such as `the folder of a ROS 2 bag`; empty where
    only files are."""

    def recognises(self, path: Path) -> bool:
        """Return whether a path looks like this format: by its ending, or as a folder."""
        if path.is_dir():
            return bool(self.folder)
        return path.suffix.lower() in self.endings


FORMATS = (
    LogFormat((".csv",), read_csv, write_csv),
    LogFormat((".tum", ".txt", ".kitti"), read_trajectory, write_tum),
    LogFormat((".bag",), read_bag),
    LogFormat((".mcap", ".db3"), read_bag, None, "the folder of a ROS 2 bag"),
)
"""Every format of logs. A new one is a module with a function that reads or writes it, and its line
here."""


_BEGINNINGS = {
    b"SQLite format 3": (".db3", "the file of a ROS 2 bag: let its name end in .db3"),
    b"\x89MCAP": (".mcap", "a ROS 2 bag: let its name end in .mcap"),
    b"#ROSBAG": (".bag", "a ROS 1 bag: let its name end in .bag"),
    b"PK\x03\x04": ("", "a workbook or an archive: save the sheet as CSV, or unpack it"),
}
"""Beginnings of files, with the ending of their names and what is said where it is another."""

SHIPPED_LOGS: Mapping[str, str] = {
    "sample": "husky-tile",
    "husky": "husky-tile",
    "warthog": "warthog-grass",
}
"""Logs that travel with the package, each with the profile of its robot. README.md beside them says
where they come from."""


def log_path(name: str | Path) -> Path:
    """Return the path of a log; a shipped log is preferred to a file of the same name."""
    if str(name) in SHIPPED_LOGS:
        return Path(__file__).parent / "shipped" / f"{name}.csv"
    return Path(name)


def profile_of_log(name: str | Path) -> str:
    """Return the default profile for a log: that of a shipped one, else `husky-tile`."""
    return SHIPPED_LOGS.get(str(name), "husky-tile")


def readable() -> str:
    """Return the endings that can be read, as a sentence names them: `.csv, .mcap or a folder`."""
    formats = [f for f in FORMATS if f.read is not None]
    names = [ending for f in formats for ending in f.endings]
    names += [f.folder for f in formats if f.folder]
    return f"{', '.join(names[:-1])} or {names[-1]}"


def is_log(path: Path) -> bool:
    """Return whether a path looks like a log that can be read; it need not exist."""
    return any(f.read is not None and f.recognises(path) for f in FORMATS)


AnyLog = str | Path | DataFrame | Log
"""A log by its path or the name of a shipped one, as a frame of pandas, or itself."""


def log_name(given: AnyLog) -> str:
    """Return the name of a log as its user gave it, or the path that a frame or a log has."""
    if isinstance(given, str | Path):
        return str(given)
    return str(given.path if isinstance(given, Log) else frame_path(given))


def read_log(given: AnyLog, options: ReadOptions = PLAIN, radius: float | None = None) -> Log:
    """Read a log of any format in `FORMATS`; `Log.on_one_clock` brings it onto one clock.

    Args:
        given: a file or folder, whose ending says which format it has, a name in `SHIPPED_LOGS`, a
            frame of pandas, or a log, which is returned.
        options: choices for formats with topics, and limits; all guessed or usual if not given.
        radius: radius of the robot's wheels [m], which some units need; None where nobody knows it.

    Raises:
        FileError: no format has that ending, or the log cannot be read, or is beyond the limits.
    """
    if isinstance(given, Log):
        return given
    if isinstance(given, str | Path):
        log = _read_path(log_path(given), options, radius)
    else:
        log = read_frame(given, options, radius)
    for group in log.groups.values():
        check_group(log.path, group, options.limits)
    return log


def _read_path(path: Path, options: ReadOptions, radius: float | None) -> Log:
    """Read a log in the format that the ending of its path names."""
    if not exists(path):
        raise FileError(path, f"there is no such file; wanted a log ({readable()})")
    read = next((f.read for f in FORMATS if f.read is not None and f.recognises(path)), None)
    if read is None:
        raise FileError(path, f"this is no log by its ending; logs are {readable()}")
    if read is read_bag and set(options.columns) - set(COMMAND_COLUMNS["wheels"]):
        what = "of a bag, columns names the joints of enc_left and enc_right; --topics names topics"
        raise FileError(path, what)
    try:
        return read(path, options, radius)
    except FileError:
        _refuse_other_content(path)
        raise


def _refuse_other_content(path: Path) -> None:
    """Say what a file is that its ending does not tell."""
    if path.is_dir():
        return
    with opened(path) as file:
        head = file.read(16)
    for beginning, (ending, what) in _BEGINNINGS.items():
        if head.startswith(beginning) and path.suffix.lower() != ending:
            raise FileError(path, f"by its content this is {what}") from None


def format_of_target(path: str | Path) -> LogFormat:
    """Return the format for writing a file of that ending; a ValueError lists the formats."""
    formats = {ending: f for f in FORMATS if f.write is not None for ending in f.endings}
    suffix = Path(path).suffix
    if suffix.lower() not in formats:
        endings = ", ".join(formats)
        raise ValueError(f"{path}: no format has the ending '{suffix}'; there are: {endings}")
    return formats[suffix.lower()]


def write_log(log: Log, path: str | Path) -> None:
    """Write a log in the format that the ending of `path` names, whole or not at all.

    Raises:
        ValueError: no format that can be written has that ending, the log lacks columns that the
            format needs, or `path` is the log itself or lies in it.
        OSError: the file cannot be written.
    """
    path = Path(path)
    write = format_of_target(path).write
    assert write is not None
    check_apart(path, log.path)
    path.parent.mkdir(parents=True, exist_ok=True)
    write(log, path)


def check_apart(target: str | Path, source: str | Path) -> None:
    """Refuse to write a file of any kind over a log or a part of it, before any work is done.

    Raises:
        ValueError: the target is a folder, or there is the source itself, or a part of the ROS 2
            bag that is the source.
    """
    target = Path(target)
    source = Path(source)
    if not exists(target):
        return
    if target.is_dir():
        raise ValueError(f"{target} is a folder; name a file")
    if exists(source) and (target.samefile(source) or source.resolve() in target.resolve().parents):
        raise ValueError(f"{target} is the log itself, or a part of it; name another file")
