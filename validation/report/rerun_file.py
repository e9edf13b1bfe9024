"""Encode a rerun recording as the bytes of a file, and say in it how it was made."""

from __future__ import annotations

import os
import sys
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

os.environ.setdefault("RERUN_ANALYTICS", "false")  # rerun looks at it when it is imported

try:
    import rerun as rr
except ImportError as missing:
    raise ImportError("recordings need the package rerun-sdk; save(folder, recording=False) does without") from missing

from validation.words import each_line, one_line

TIMELINE = "sim_time"


def encode(program: str, identity: uuid.UUID, fill: Callable[[rr.RecordingStream], None]) -> bytes:
    """Return what `fill` sends to a recording of this id, as the bytes of a file; misuse of rerun raises.

    Recordings of one program share a layout in the viewer, so that each program counts as an application of its own.

    Rerun keeps what is sent to a stream as it is until it is read, and compresses at once what is sent to a file. So there
    is a file where that can be one in memory, which no full disk cuts short: a long recording takes 0.3 GB less.

    Raises:
        RuntimeError: rerun is switched off by `RERUN=off`.
    """
    recording = rr.RecordingStream(f"ssmr-testbed {program}", recording_id=identity, send_properties=False)
    if not recording.is_enabled():
        raise RuntimeError("rerun is switched off: unset the environment variable RERUN to write recordings")
    with _file_in_memory() as path:
        if path is None:
            stream = recording.binary_stream()
        else:
            recording.save(path)
        try:
            with _strict():
                fill(recording)
        finally:  # after a failure too: rerun complains of a stream that is not read
            data = stream.read() if path is None else _closed(recording, path)
    if not data:
        raise RuntimeError("rerun encoded nothing")
    return data


def _closed(recording: rr.RecordingStream, path: Path) -> bytes:
    """Return the bytes of a file once rerun has written all of it."""
    recording.disconnect()
    return path.read_bytes()


@contextmanager
def _file_in_memory() -> Iterator[Path | None]:
    """Yield the path of an empty file in memory; None where the system has none, or limits the size of files."""
    if not sys.platform.startswith("linux") or not Path("/proc/self/fd").is_dir() or _files_are_limited():
        yield None
        return
    file = os.memfd_create("recording")
    try:
        yield Path(f"/proc/self/fd/{file}")
    finally:
        os.close(file)


def _files_are_limited() -> bool:
    import resource  # POSIX only

    return resource.getrlimit(resource.RLIMIT_FSIZE)[0] != resource.RLIM_INFINITY


@contextmanager
def _strict() -> Iterator[None]:
    """Within, rerun raises where it would warn and leave something out."""
    before = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        yield
    finally:
        rr.set_strict_mode(before)


def write_about(
    recording: rr.RecordingStream, title: str, properties: Mapping[str, Mapping[str, object]], report: str
) -> None:
    """Send what a recording is called, its properties by group, and its report, all foreign text in them made harmless.

    Args:
        recording: where to.
        title: name of the recording in the viewer's list.
        properties: values by name, by group; numbers of 64 bits stay numbers, anything else becomes text.
        report: markdown, which the viewer shows as the entity `report`.
    """
    recording.send_recording_name(one_line(title))
    for group, values in properties.items():
        entries = rr.AnyValues()
        for key, value in values.items():
            number = isinstance(value, float) or (isinstance(value, int) and abs(value) < 2**63)
            entries.with_component_from_data(one_line(key), value if number else one_line(value))
        if values:
            recording.send_property(group, entries)
    recording.log("report", rr.TextDocument(each_line(report), media_type=rr.MediaType.MARKDOWN), static=True)
