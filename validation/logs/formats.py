"""The table of log formats, and reading and writing a log in whichever of them its path asks for."""

from __future__ import annotations

from pathlib import Path

from validation.logs.bag_recording import BAG
from validation.logs.log import Log, LogFormat, ReadOptions
from validation.logs.recording import Recording, RecordingError
from validation.logs.recording_csv import CSV
from validation.logs.tum import TUM

FORMATS: tuple[LogFormat, ...] = (CSV, TUM, BAG)
"""Every format of logs. A new one is a module that makes a `LogFormat`, and its name here."""


def readable() -> str:
    """Return the endings that can be read, as a sentence names them: `.csv, .mcap or a folder`."""
    known = [f for f in FORMATS if f.read is not None]
    names = [ending for f in known for ending in f.endings] + [f.folder for f in known if f.folder]
    return f"{', '.join(names[:-1])} or {names[-1]}"


def writable() -> tuple[str, ...]:
    """Return the endings that can be written."""
    return tuple(ending for f in FORMATS if f.write is not None for ending in f.endings)


def is_log(path: Path) -> bool:
    """Return whether a path looks like a log that can be read; it need not exist."""
    return _reader(path) is not None


def read_log(path: str | Path, options: ReadOptions | None = None) -> Log:
    """Read a log of any format in `FORMATS`.

    Args:
        path: a file or folder; its ending says which format it has.
        options: choices for formats with topics; all guessed if not given.

    Returns:
        The columns of the log in groups; `Log.recording()` brings them onto one clock.

    Raises:
        RecordingError: no format has that ending, or the log cannot be read.
    """
    path = Path(path)
    if not path.exists():
        raise RecordingError(path, f"there is no such file; wanted a recording ({readable()})")
    found = _reader(path)
    if found is None or found.read is None:
        raise RecordingError(path, f"this is no recording by its ending; recordings are {readable()}")
    return found.read(path, options or ReadOptions())


def read_recording(path: str | Path) -> Recording:
    """Read a log of any format in `FORMATS` and bring it onto one clock; see `read_log`."""
    return read_log(path).recording()


def write_log(log: Log, path: str | Path) -> None:
    """Write a log in the format that the ending of `path` names, whole or not at all.

    Raises:
        ValueError: no format that can be written has that ending, or the log lacks what the format needs.
        OSError: the file cannot be written.
    """
    path = Path(path)
    for one in FORMATS:
        if one.write is not None and path.suffix.lower() in one.endings:
            one.write(log, path)
            return
    raise ValueError(f"{path}: no format has the ending '{path.suffix}'; there are: {', '.join(writable())}")


def _reader(path: Path) -> LogFormat | None:
    return next((f for f in FORMATS if f.read is not None and f.recognises(path)), None)
