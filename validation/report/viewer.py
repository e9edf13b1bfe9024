"""Open a recording in the rerun viewer, in its own window or in a browser."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import socket
import subprocess  # nosec B404 # without a shell
import sys
import time
from pathlib import Path
from urllib.parse import quote

from ssmr.errors import SsmrError

_logger = logging.getLogger(__name__)

_VIEWER_GRACE = 3.0
"""A viewer that cannot open its window has given up by then [s]."""
_LOOPBACK = "127.0.0.1"
_PORTS = (9090, 9876)
"""Ports of the page and of the recording, rerun's own, so that a tunnel can be given once; others where they are taken."""
_SERVER_GRACE = 30.0
"""Time in which the server must listen [s]."""


class ViewerError(SsmrError):
    """The viewer does not run; the message says why and what to do."""


def open_viewer(path: Path) -> bool:
    """Open a recording in rerun's own viewer, which then lives on by itself and listens on the loopback interface alone.

    Args:
        path: the recording.

    Returns:
        Whether there is a viewer; if not, the log says why and what to do.
    """
    by_hand = f"open it where there is a screen: rerun {path}"
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        _logger.warning("there is no display for the rerun viewer; %s", by_hand)
        return False
    try:
        viewer = _start(path, "--port", "auto")
    except OSError as error:
        _logger.warning("the rerun viewer cannot be started (%s); %s", error, by_hand)
        return False
    try:
        viewer.wait(_VIEWER_GRACE)
    except subprocess.TimeoutExpired:
        return True
    _logger.warning("the rerun viewer ended at once, as it does where it can open no window; %s", by_hand)
    return False


def serve_viewer(path: Path) -> None:
    """Serve a recording to browsers on this machine until an interrupt; both servers listen on the loopback interface alone.

    The page's address is printed as soon as the page can be opened.

    Args:
        path: the recording.

    Raises:
        ViewerError: the server cannot be started, or ends by itself.
        KeyboardInterrupt: the user has ended it.
    """
    page, data = map(_free_port, _PORTS)
    try:
        server = _start(path, "--serve-web", "--port", str(data), "--web-viewer-port", str(page))
    except OSError as error:
        raise ViewerError(f"the rerun viewer cannot be started ({error})") from error
    try:
        until = time.monotonic() + _SERVER_GRACE
        while not (_answers(page) and _answers(data)):
            if server.poll() is not None or time.monotonic() > until:
                raise ViewerError(f"the rerun viewer does not serve {path}; open it where there is a screen: rerun {path}")
            time.sleep(0.05)
        address = f"http://{_LOOPBACK}:{page}/?url={quote(f'rerun+http://{_LOOPBACK}:{data}/proxy', safe='')}"
        print(f"{address} shows {path.name}; Ctrl-C ends it", flush=True)
        server.wait()
        raise ViewerError(f"the rerun viewer has ended by itself while it served {path}")
    finally:
        _end(server)


def _start(path: Path, *options: str) -> subprocess.Popen[bytes]:
    """Start rerun on a recording, silent, and bound to the loopback interface."""
    command = [sys.executable, "-m", "rerun_cli", str(path.absolute()), "--bind", _LOOPBACK, *options]
    quiet = subprocess.DEVNULL
    return subprocess.Popen(  # nosec B603 # no shell, and an absolute path cannot be taken for an option
        command, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True
    )


def _end(server: subprocess.Popen[bytes]) -> None:
    """End a server and what it has started: the command `rerun` is a Python program that waits for the real one."""
    if hasattr(os, "killpg"):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(server.pid, signal.SIGTERM)
    else:
        server.terminate()
    server.wait()


def _free_port(usual: int) -> int:
    """Return a port of the loopback interface that nobody listens on: the usual one if it is free."""
    with socket.socket() as trial:
        try:
            trial.bind((_LOOPBACK, usual))
        except OSError:
            trial.bind((_LOOPBACK, 0))
        return int(trial.getsockname()[1])


def _answers(port: int) -> bool:
    with socket.socket() as trial:
        return trial.connect_ex((_LOOPBACK, port)) == 0
