"""Work for child processes of tests."""

from __future__ import annotations

import time
from pathlib import Path

from validation.files.guarded import Answer


def spin() -> Answer:
    """Never come to an end."""
    while True:
        pass


def rest(seconds: float) -> Answer:
    """Take so long without the processor [s]."""
    time.sleep(seconds)
    return "rested", ()


def fail() -> Answer:
    """Raise an error without words."""
    raise LookupError


def read(path: str) -> Answer:
    """Read a text."""
    return Path(path).read_text(encoding="utf-8"), ()
