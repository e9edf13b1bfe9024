"""`jit`: numba compilation whose cache on disk can never be stale.

numba notices edits to the file of the compiled function alone, not to what that function calls from other files. Here the
cache folder is named after a digest of all of this package's sources, so any edit to any of them compiles afresh. The
compiled functions keep their Python source as `.py_func`, which is what the reference loop in `simulate.py` calls.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core import config as numba_config

config: Any = numba_config
"""numba fills this module from the environment when it is imported; no stub knows what is in it."""

CACHE_LIFETIME = 7 * 24 * 3600.0
"""How long a cache that no source asks for any more is kept [s]."""

_PACKAGE = Path(__file__).resolve().parent


_PLACES: tuple[Callable[[], Path], ...] = (
    lambda: _PACKAGE / "__pycache__",
    lambda: Path(tempfile.gettempdir()) / f"ssmr-{os.getuid()}",  # a full disk has no such place
)


def _cache_folder() -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    for source in sorted(_PACKAGE.rglob("*.py")):
        digest.update(source.read_bytes())
    for place in (lambda: Path(config.CACHE_DIR),) if config.CACHE_DIR else _PLACES:
        try:
            folder = (root := place()) / f"numba-{digest.hexdigest()[:12]}"
            if not folder.is_dir():
                _forget_old(root)
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return str(folder)
    return ""


def _forget_old(root: Path) -> None:
    """Remove the caches of sources that have changed since, once they are a week old."""
    for folder in root.glob("numba-*"):
        if time.time() - folder.stat().st_mtime > CACHE_LIFETIME:
            shutil.rmtree(folder, ignore_errors=True)


_FOLDER = _cache_folder()


def jit(function: Callable[..., Any] | None = None, *, parallel: bool = False) -> Any:
    """Compile a numeric function without the interpreter lock, cached on disk; IEEE arithmetic is kept (no fast-math).

    Serial functions are inlined where they are called: the laws are a few lines each, and a call costs as much as they do.
    """
    if function is None:
        return lambda f: jit(f, parallel=parallel)
    before = config.CACHE_DIR
    try:
        config.CACHE_DIR = _FOLDER
        compiled = numba.njit(
            cache=bool(_FOLDER), nogil=True, parallel=parallel, error_model="numpy", forceinline=not parallel
        )
        return compiled(function)
    finally:
        config.CACHE_DIR = before
