"""Open a recording in the rerun viewer, in its own window or in a browser; it listens on the loopback interface alone."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import subprocess  # nosec B404 # without a shell
import sys
from pathlib import Path

from ssmr.errors import SsmrError

_logger = logging.getLogger(__name__)

_VIEWER_GRACE = 3.0
"""A viewer that cannot open its window has given up by then [s]."""


def _command(path: Path, *options: str) -> list[str]:
    return [sys.executable, "-m", "rerun_cli", str(path.absolute()), "--bind", "127.0.0.1", *options]


def open_viewer(path: Path) -> bool:
    """Open a recording in rerun's own viewer, which then lives on by itself; return whether there is one.

    If there is none, the log says why and what to do.
    """
    by_hand = f"open it where there is a screen: rerun {path}"
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        _logger.warning("there is no display for the rerun viewer; %s", by_hand)
        return False
    quiet = subprocess.DEVNULL
    try:
        viewer = subprocess.Popen(  # nosec B603 # no shell, and an absolute path cannot be taken for an option
            _command(path, "--port", "auto"), stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True
        )
        viewer.wait(_VIEWER_GRACE)
    except subprocess.TimeoutExpired:
        return True
    except OSError as error:
        by_hand = f"{error}; {by_hand}"
    _logger.warning("the rerun viewer cannot open its window; %s", by_hand)
    return False


def serve_viewer(path: Path) -> None:
    """Serve a recording to browsers on this machine until an interrupt; rerun says where the page is.

    Raises:
        SsmrError: the server cannot be started, or ends by itself.
        KeyboardInterrupt: the user has ended it.
    """
    command = _command(path, "--serve-web")
    try:
        server = subprocess.Popen(command, start_new_session=True)  # nosec B603 # as above
    except OSError as error:
        raise SsmrError(f"the rerun viewer cannot be started ({error})") from error
    try:
        server.wait()
        raise SsmrError(f"the rerun viewer has ended; open {path} where there is a screen: rerun {path}")
    finally:  # `rerun` is a Python program that waits for the real one
        with contextlib.suppress(ProcessLookupError):
            os.killpg(server.pid, signal.SIGTERM) if hasattr(os, "killpg") else server.terminate()
        server.wait()
