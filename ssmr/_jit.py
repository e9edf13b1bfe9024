"""`jit`: numba compilation whose cache on disk can never be stale.

numba notices edits to the file of the compiled function alone, not to what that function calls from other files. Here the
cache folder is named after a digest of the sources that decide what is compiled, so that an edit to any of them compiles
afresh. The compiled functions keep their Python source, see `source`.

numba unpickles what lies in its cache, and who can write there can run code as this user. So the cache is a folder that
belongs to this user and that nobody else can write: beside the sources, or in the user's own cache folder. Where there is
no such folder, every start compiles anew.
"""

from __future__ import annotations

import hashlib
import logging
import os
import re
import shutil
import stat
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core import cgutils, types
from numba.core import config as numba_config
from numba.extending import intrinsic, overload

from ssmr.types import FloatArray

config: Any = numba_config
"""Settings of numba, which it reads from the environment when it is imported; no stub declares them."""

_SHARES = 4
"""Shares of a thread: one that is done early takes another."""
CACHE_LIFETIME = 7 * 24 * 3600.0
"""Time for which the cache of older sources is kept [s]."""

_PACKAGE = Path(__file__).resolve().parent
_log = logging.getLogger(__name__)


def _user_cache() -> Path:
    """Return the folder in which this user's programs keep caches (XDG Base Directory Specification)."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ssmr-testbed"


def _is_ours(folder: Path) -> bool:
    """Return whether a folder, which is no link, belongs to this user, and nobody else can write into it."""
    if os.name != "posix":
        return True  # a user's folders elsewhere are closed by default, and no mode says so
    status = folder.lstat()
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.geteuid() and not status.st_mode & 0o022


def _compiled_sources() -> list[bytes]:
    """Return the sources that decide what is compiled: of modules that compile, and of those which they import."""
    texts = {path.relative_to(_PACKAGE.parent).as_posix(): path.read_bytes() for path in sorted(_PACKAGE.rglob("*.py"))}
    kept = {path for path, text in texts.items() if b"ssmr._jit" in text}
    imported = {name for path in kept for name in re.findall(rb"^from (ssmr[\w.]*) import", texts[path], re.MULTILINE)}
    return [t for path, t in texts.items() if path in kept or path[:-3].replace("/", ".").encode() in imported]


def _cache_folder() -> str:
    """Return the folder for compiled code, made if need be; an empty text where there is none that can be trusted."""
    digest = hashlib.sha256(numba.__version__.encode())
    for text in _compiled_sources():
        digest.update(text)
    chosen: tuple[Callable[[], Path], ...] = (lambda: _PACKAGE / "__pycache__", _user_cache)
    for place in (lambda: Path(config.CACHE_DIR),) if config.CACHE_DIR else chosen:
        try:
            folder = (root := place()) / f"numba-{digest.hexdigest()[:12]}"
            if not folder.is_dir():
                for old in root.glob("numba-*"):
                    if time.time() - old.lstat().st_mtime > CACHE_LIFETIME:
                        shutil.rmtree(old, ignore_errors=True)
                shared = root.name == "__pycache__"  # where everybody's bytecode lies, which others may read
                root.mkdir(mode=0o755 if shared else 0o700, parents=True, exist_ok=True)
                folder.mkdir(mode=0o700, exist_ok=True)
            if _is_ours(root) and _is_ours(folder) and os.access(folder, os.W_OK):
                return str(folder)
        except (OSError, RuntimeError):  # RuntimeError: this user has no home
            continue
    _log.warning("no folder belongs to this user alone where compiled code can be kept, so that every start compiles anew")
    return ""


_FOLDER = _cache_folder()
F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T", bound=tuple[Any, ...])


def jit(function: F) -> F:
    """Compile a numeric function without the interpreter lock, cached on disk; IEEE arithmetic is kept (no fast-math).

    The function is inlined where it is called: the laws are a few lines each, and a call costs as much as they do.
    """
    return _compile(function, forceinline=True)


def jit_alone(function: F) -> F:
    """Compile like `jit`, but not inlined: a long loop, which is compiled once and not again wherever it is called."""
    return _compile(function)


def share_among_threads(work: Callable[[int, int], object], count: int, workers: int) -> None:
    """Let `work(first, last)` do consecutive shares of `count` things on so many threads of Python's own.

    Compiled functions hold no interpreter lock, so the shares run side by side. numba's own threads are not used: the layer
    that it has where neither OpenMP nor TBB is installed ends the process when two threads call it at once.
    """
    shares = max(1, min(count, _SHARES * workers)) if workers > 1 else 1
    if shares == 1:
        work(0, count)
        return
    edges = [count * i // shares for i in range(shares + 1)]
    pool = ThreadPoolExecutor(min(workers, shares))
    try:
        list(pool.map(work, edges[:-1], edges[1:]))
    finally:
        pool.shutdown(cancel_futures=True)


def source(function: F) -> F:
    """Return the Python source of a compiled function: it works on whole arrays, without being compiled for them."""
    python: F = function.py_func  # type: ignore[attr-defined]  # numba's
    return python


def _compile(function: F, **options: Any) -> F:
    before = config.CACHE_DIR
    try:
        config.CACHE_DIR = _FOLDER
        compiled: F = numba.njit(cache=bool(_FOLDER), nogil=True, error_model="numpy", **options)(function)
        return compiled
    finally:
        config.CACHE_DIR = before


def named_like(template: T, row: FloatArray) -> T:
    """Return a named tuple of the template's kind with the numbers of `row`; for compiled functions only.

    The numbers of a population travel as rows of one array.
    """
    raise NotImplementedError("named_like works in compiled functions only")


def built_in(function: Any) -> Any:
    """Return a function that writes LLVM instructions into the compiled functions which call it, see numba's `intrinsic`."""
    return intrinsic(prefer_literal=True)(function)


@overload(named_like, strict=False)
def _named_like(template: Any, row: Any) -> Any:
    kind = template.instance_class
    convert: dict[type, str] = {types.Integer: "int(row[{}])", types.Boolean: "row[{}] != 0.0"}
    numbers = [convert.get(type(t), "row[{}]").format(i) for i, t in enumerate(template.types)]
    names: dict[str, Any] = {"kind": kind}
    source = f"def read(template, row):\n    return kind({', '.join(numbers)})"  # numba types no loop over mixed fields
    exec(source, names)  # nosec B102 # the source is made of numbers alone
    return names["read"]


@built_in
def prefer_wide_vectors(typing: Any) -> Any:
    """Let the compiled function that calls this use the widest vectors of the processor; for compiled functions only.

    LLVM otherwise prefers half the width on many processors, lest they lower their clock for code that gains little by it.
    """

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        attributes = builder.function.attributes
        if isinstance(attributes, set):  # llvmlite's own `add` knows no attributes with values
            set.add(attributes, '"prefer-vector-width"="512"')
        return context.get_dummy_value()

    return types.void(), build


@built_in
def copy_numbers(typing: Any, target: Any, at: Any, origin: Any, first: Any, count: Any) -> Any:
    """Copy `count` numbers, a constant, of one contiguous array from index `first` on into another from `at` on.

    A loop would not do: where the compiler cannot tell that the arrays are different ones, it copies number by number, and a
    processor that then reads several of them as one vector waits until all have left its store buffer.
    """
    if not isinstance(count, types.IntegerLiteral):
        return None

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        to, start, of, begin, _ = arguments
        here = builder.gep(context.make_array(signature.args[0])(context, builder, to).data, [start])
        there = builder.gep(context.make_array(signature.args[2])(context, builder, of).data, [begin])
        copy: Any = cgutils.raw_memcpy
        copy(builder, here, there, context.get_constant(types.intp, count.literal_value), 8)
        return context.get_dummy_value()

    return types.void(target, at, origin, first, count), build
