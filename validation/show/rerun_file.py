"""Encode a rerun recording as the bytes of a file, and say in it how it was made."""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

os.environ.setdefault("RERUN_ANALYTICS", "false")  # rerun looks at it when it is imported

import rerun as rr

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


def write_circumstances(recording: rr.RecordingStream, options: Mapping[str, object], versions: Mapping[str, str]) -> None:
    """Send options and versions as properties of the recording."""
    for name, values in (("options", options), ("versions", versions)):
        entries = rr.AnyValues()
        for key, value in values.items():
            entries.with_component_from_data(key, str(value))
        if values:
            recording.send_property(name, entries)
