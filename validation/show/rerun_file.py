"""Encode a rerun recording as the bytes of a file, and say in it how it was made."""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

os.environ.setdefault("RERUN_ANALYTICS", "false")  # rerun looks at it when it is imported

import rerun as rr

from validation.words import each_line, one_line

_APPLICATION = "ssmr-testbed"
TIMELINE = "sim_time"


def encode(identity: uuid.UUID, fill: Callable[[rr.RecordingStream], None]) -> bytes:
    """Return what `fill` sends to a recording of this id, as the bytes of a file; misuse of rerun raises.

    Raises:
        RuntimeError: rerun is switched off by `RERUN=off`.
    """
    recording = rr.RecordingStream(_APPLICATION, recording_id=identity, send_properties=False)
    if not recording.is_enabled():
        raise RuntimeError("rerun is switched off: unset the environment variable RERUN to write recordings")
    stream = recording.binary_stream()
    try:
        with _strict():
            fill(recording)
    finally:
        data = stream.read()  # after a failure too: rerun complains of a stream that is not read
    if not data:
        raise RuntimeError("rerun encoded nothing")
    return data


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
