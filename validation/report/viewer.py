"""Open a recording in the rerun viewer, which listens on the loopback interface alone."""

from __future__ import annotations

import logging
import os
import subprocess  # nosec B404 # without a shell
import sys
from pathlib import Path

_logger = logging.getLogger(__name__)

_VIEWER_GRACE = 3.0
"""A viewer that cannot open its window has given up by then [s]."""


def open_viewer(path: Path) -> bool:
    """Open a recording in rerun's own viewer, which lives on; return whether there is one.

    If there is none, the log says why and what to do.
    """
    by_hand = (
        f"open it where there is a screen: rerun {path}; "
        f"or in a browser: rerun {path} --serve-web --bind 127.0.0.1"
    )
    has_display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform.startswith("linux") and not has_display:
        _logger.warning("there is no display for the rerun viewer; %s", by_hand)
        return False
    quiet = subprocess.DEVNULL
    # An absolute path cannot be taken for an option.
    call = [
        sys.executable,
        "-m",
        "rerun_cli",
        str(path.absolute()),
        "--bind",
        "127.0.0.1",
        "--port",
        "auto",
    ]
    try:
        viewer = subprocess.Popen(  # nosec B603 # no shell
            call,
            stdin=quiet,
            stdout=quiet,
            stderr=quiet,
            start_new_session=True,
        )
        viewer.wait(_VIEWER_GRACE)
    except subprocess.TimeoutExpired:
        return True
    except OSError as error:
        by_hand = f"{error}; {by_hand}"
    _logger.warning("the rerun viewer cannot open its window; %s", by_hand)
    return False
