"""The table of log formats, and reading and writing a log in whichever of them its path asks for."""

from __future__ import annotations

from pathlib import Path

from validation.logs.bag_recording import BAG
from validation.logs.bags import METADATA
from validation.logs.files import exists
from validation.logs.limits import USUAL, LogLimits, find_time_fault
from validation.logs.log import Log, LogFormat, ReadOptions
from validation.logs.recording import Recording, RecordingError
from validation.logs.recording_csv import CSV
from validation.logs.tum import TUM

FORMATS: tuple[LogFormat, ...] = (CSV, TUM, BAG)
"""Every format of logs. A new one is a module that makes a `LogFormat`, and its name here."""
SAMPLE_LOG = "sample"
"""Name, where the path of a log is wanted, of the one that travels with the package: 70 s of the MuJoCo Husky of profile
husky-tile at 20 Hz, as `recordings convert varied@mujoco --profile husky-tile --rate 20` writes it, rounded."""


def log_path(name: str | Path) -> Path:
    """Return the path of a log: `sample` is the one that travels with the package, unless there is a file of that name."""
    path = Path(name)
    return Path(__file__).with_name("sample.csv") if str(name) == SAMPLE_LOG and not exists(path) else path


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
        path: a file or folder, whose ending says which format it has, or `sample`.
        options: choices for formats with topics; all guessed if not given.

    Returns:
        The columns of the log in groups; `Log.recording()` brings them onto one clock.

    Raises:
        RecordingError: no format has that ending, or the log cannot be read, or is beyond the limits.
    """
    path = log_path(path)
    if not exists(path):
        raise RecordingError(path, f"there is no such file; wanted a recording ({readable()})")
    found = _reader(path)
    if found is None or found.read is None:
        raise RecordingError(path, f"this is no recording by its ending; recordings are {readable()}")
    log = found.read(path, options or ReadOptions())
    _check_within_limits(log)
    return log


def _check_within_limits(log: Log) -> None:
    """Refuse times and numbers that cannot be, of any format; a reader that knows where they stand has said so before.

    Raises:
        RecordingError: the name of the group and the number of the sample stand for the place.
    """
    for group in log.groups.values():
        fault = find_time_fault(group.t, log.limits)
        if fault is not None:
            raise RecordingError(log.path, f"{group.source}, sample {fault.row + 1}: {fault.what}")
        for name, values in group.columns.items():
            bound = log.limits.of_column(name)
            k = bound.first_beyond(values)
            if k is not None:
                what = f"{group.source}, sample {k + 1}: there is {values[k]:g}, but {bound.says}"
                raise RecordingError(log.path, what, column=name)


def read_recording(path: str | Path, limits: LogLimits = USUAL) -> Recording:
    """Read a log of any format in `FORMATS` and bring it onto one clock; see `read_log`."""
    return read_log(path, ReadOptions(limits=limits)).recording()


def write_log(log: Log, path: str | Path) -> None:
    """Write a log in the format that the ending of `path` names, whole or not at all.

    Raises:
        ValueError: no format that can be written has that ending, the log lacks what the format needs, or `path` is the log
            itself or a part of it.
        OSError: the file cannot be written.
    """
    path = Path(path)
    check_target(path, log.path)
    write = _writer(path).write
    assert write is not None
    path.parent.mkdir(parents=True, exist_ok=True)
    write(log, path)


def losses(log: Log, path: str | Path) -> tuple[str, ...]:
    """Return sentences about what the file at `path` would not hold of a log, or hold under other names.

    Raises:
        ValueError: no format that can be written has that ending, or it cannot hold the log.
    """
    path = Path(path)
    told = _writer(path).losses
    return () if told is None else tuple(told(log, path))


def check_target(target: str | Path, source: str | Path) -> None:
    """Refuse to write into what is read, before any work is done.

    Args:
        target: file that is to be written.
        source: log that is read; it need not exist, as a simulated drive does not.

    Raises:
        ValueError: no format that can be written has the target's ending; or the target is a folder, the source itself, a
            link to a part of it, or lies in the folder of a ROS 2 bag that is the source or holds it.
    """
    _writer(Path(target))
    check_apart(target, source)


def check_apart(target: str | Path, source: str | Path) -> None:
    """Refuse to write a file of any kind over a log or into it; the arguments are those of `check_target`.

    Raises:
        ValueError: as `check_target`, but for the ending.
    """
    target, source = Path(target), Path(source)
    if exists(target) and target.is_dir():
        raise ValueError(f"{target} is a folder; name a file")
    if not exists(source):
        return
    whole = source.parent if not source.is_dir() and (source.parent / METADATA).is_file() else source
    if exists(target) and (target.samefile(source) or target.samefile(whole)):
        raise ValueError(f"{target} is the log itself; name another file")
    if not whole.is_dir():
        return
    try:
        inside = any(exists(folder) and folder.samefile(whole) for folder in target.absolute().resolve().parents)
        linked = exists(target) and any(target.samefile(part) for part in whole.iterdir() if exists(part))
    except (OSError, RuntimeError) as cause:  # a link that leads to itself
        raise ValueError(f"{target}: where it lies cannot be seen ({cause})") from cause
    if inside:
        raise ValueError(f"{target} lies in the bag {whole}; name a file outside of it")
    if linked:
        raise ValueError(f"{target} is a link to a part of the bag {whole}; name another file")


def _writer(path: Path) -> LogFormat:
    """Return the format that writes a path's ending; a ValueError lists those that there are."""
    found = next((f for f in FORMATS if f.write is not None and path.suffix.lower() in f.endings), None)
    if found is None:
        raise ValueError(f"{path}: no format has the ending '{path.suffix}'; there are: {', '.join(writable())}")
    return found


def _reader(path: Path) -> LogFormat | None:
    return next((f for f in FORMATS if f.read is not None and f.recognises(path)), None)
