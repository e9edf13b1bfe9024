"""numba with a cache on disk that is never stale, with threads, and with functions it lacks.

numba notices edits to the file of the compiled function alone, not to what that function calls from
other files. Here the key of a compiled function holds its file's path and a digest of that file and
of all that it imports from this project, so an edit compiles afresh what it touches, and clones of
one version do not meet. The compiled functions keep their Python source, see `source`.

numba unpickles what lies in its cache, and who can write there can run code as this user. So the
cache is in the user's own cache folder. Where that cannot be written, every start compiles anew.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import math
import os
import re
import shutil
import stat
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba
from llvmlite import ir
from numba.core import cgutils, types
from numba.core import config as numba_config
from numba.core.caching import FunctionCache
from numba.extending import intrinsic

from ssmr.types import FloatArray

config: Any = numba_config
"""Settings of numba, which it reads from the environment when it is imported; no stub declares
them."""
_njit: Any = numba.njit
_item_pointer: Any = cgutils.get_item_pointer
_code_on_disk: Any = FunctionCache

_SHARES = 4
"""Shares of a thread: one that is done early takes another."""
_CACHE_LIFETIME = 30 * 24 * 3600.0
"""Time for which code is kept that nobody loads [s]."""
_WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH
_IMPORTED = re.compile(
    r"""(?:^\s*from[ ]|import_module\(f")((?:ssmr|validation)\.[\w.]*\w)(?:[ ]import|\.\{)""",
    re.MULTILINE | re.VERBOSE,
)
"""A module or a package that is imported from, also one whose modules are imported by name."""

_PER_QUARTER = 0.6366197723675814  # 2 / pi
_QUARTER = 0.5 * math.pi
_SHIFT = 1.5 * 2.0**52  # a number plus this has its nearest whole number in its last bits
# Polynomials of fdlibm (Sun Microsystems, 1993) for sine and cosine between -pi/4 and pi/4.
_SINE = (
    -1.66666666666666307295e-1,
    8.33333333332211858878e-3,
    -1.98412698295895385996e-4,
    2.75573136213857245213e-6,
    -2.50507477628578072866e-8,
    1.58962301576546568060e-10,
)
_COSINE = (
    4.16666666666665929218e-2,
    -1.38888888888730564116e-3,
    2.48015872888517045348e-5,
    -2.75573141792967388112e-7,
    2.08757008419747316778e-9,
    -1.13585365213876817300e-11,
)
_ROOT = Path(__file__).resolve().parents[1]
_log = logging.getLogger(__name__)


def _cache_folder() -> str:
    """Return the folder for compiled code, made if need be; "" where none can be trusted."""
    # XDG Base Directory Specification
    mine = f"{os.environ.get('XDG_CACHE_HOME') or '~/.cache'}/ssmr-testbed"
    why = "no folder for it can be written"
    try:
        root = Path(config.CACHE_DIR or mine).expanduser()
        root.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not _is_mine_alone(root):
            why = f"others can write to {root}, or it is theirs"
        elif os.access(root, os.W_OK):
            return str(root)
    except (OSError, RuntimeError):  # RuntimeError: this user has no home
        pass
    _log.warning("compiled code is not kept, so that every start compiles anew: %s", why)
    return ""


def _is_mine_alone(folder: Path) -> bool:
    """Return whether a folder is this user's and nobody else can write there.

    Windows does not say, so there it is taken to be so.
    """
    if not hasattr(os, "geteuid"):
        return True
    status = folder.stat()
    return status.st_uid == os.geteuid() and not status.st_mode & _WRITABLE_BY_OTHERS


@cache
def _imports_of(path: Path) -> tuple[bytes, frozenset[Path]]:
    """Return the content of a file of Python, and the files of this project that it imports."""
    content = path.read_bytes()
    found = set[Path]()
    for name in _IMPORTED.findall(content.decode(errors="replace")):
        place = _ROOT / name.replace(".", "/")
        module = place.with_suffix(".py")
        found |= {module} if module.is_file() else set(place.glob("*.py"))
    return content, frozenset(found)


@cache
def _digest_of(path: Path) -> str:
    """Return a digest of a file and of all that it imports from this project, and they in turn."""
    found = {path}
    waiting = [path]
    while waiting:
        new = _imports_of(waiting.pop())[1] - found
        found |= new
        waiting += new
    digest = hashlib.sha256(numba.__version__.encode())
    for source_path in sorted(found):
        digest.update(_imports_of(source_path)[0])
    return digest.hexdigest()


_FOLDER = _cache_folder()
F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T", bound=tuple[Any, ...])


def jit(function: F) -> F:
    """Compile a numeric function that compiled functions call.

    It holds no interpreter lock and computes in IEEE arithmetic. It is inlined wherever it is
    called, because the laws are a few lines each and a call costs as much as they do. So it is not
    kept on disk: what calls it is. Called from Python, it is compiled anew in every process; see
    `jit_alone`.
    """
    compiled: F = _njit(nogil=True, error_model="numpy", forceinline=True)(function)
    return compiled


_saves = bool(_FOLDER)


def stop_saving() -> None:
    """Keep nothing on disk that this process compiles from now on.

    It may call code from files that the digest of the cache folder does not cover.
    """
    global _saves
    _saves = False


class _Kept:
    """Compiled code of one function on disk, in a folder for each signature and processor.

    numba keeps all signatures of a function in one index, which two processes that write at once
    can spoil: then a signature has the code of another one. Here each is alone in its index. What
    is not found stays where it is: it may be another version's.
    """

    cache_path = _FOLDER

    def __init__(self, function: Callable[..., Any]) -> None:
        """Keep the code of a Python function."""
        self._function = function
        self._path = Path(function.__code__.co_filename)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the code for a signature; None where there is none, or none that can be used."""
        folder = self._folder(sig, target_context.codegen())
        code = None
        if folder.is_dir():
            try:
                code = self._in(folder).load_overload(sig, target_context)
            except Exception:  # noqa: BLE001 - unpickling a damaged file can raise anything
                shutil.rmtree(folder, ignore_errors=True)
            else:
                with contextlib.suppress(OSError):
                    os.utime(folder)  # for `_remove_unused`
        if code is None and _saves:
            _say_that_it_happens_once()
        return code

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the code for a signature; where the disk is full it is compiled again next time."""
        if _saves:
            _remove_unused()
            with contextlib.suppress(OSError):
                self._in(self._folder(sig, data.codegen)).save_overload(sig, data)

    def _folder(self, signature: Any, codegen: Any) -> Path:
        digest = _digest_of(self._path)
        name = self._function.__qualname__
        key = f"{self._path} {digest} {name} {signature} {codegen.magic_tuple()}"
        return Path(_FOLDER, f"numba-{hashlib.sha256(key.encode()).hexdigest()[:16]}")

    def _in(self, folder: Path) -> Any:
        before = config.CACHE_DIR
        try:
            config.CACHE_DIR = str(folder)
            return _code_on_disk(self._function)
        finally:
            config.CACHE_DIR = before


@cache
def _say_that_it_happens_once() -> None:
    _log.info("compiling for this processor: this takes seconds once, later starts are quick")


@cache
def _remove_unused() -> None:
    """Remove the code that nobody has loaded for long."""
    oldest = time.time() - _CACHE_LIFETIME
    for folder in Path(_FOLDER).glob("numba-*"):
        with contextlib.suppress(OSError):
            if folder.stat().st_mtime < oldest:
                shutil.rmtree(folder, ignore_errors=True)


def jit_alone(function: F) -> F:
    """Compile a function that Python calls, or a long loop.

    Unlike that of `jit`, it is not inlined, and is kept on disk.
    """
    compiled: F = _njit(nogil=True, error_model="numpy")(function)
    if _FOLDER:
        compiled._cache = _Kept(function)  # type: ignore[attr-defined]  # numba's
    return compiled


def share_among_threads(work: Callable[[int, int], object], count: int, workers: int) -> None:
    """Let `work(first, last)` do consecutive shares of `count` things on Python's threads.

    Compiled functions hold no interpreter lock, so the shares run side by side. numba's own threads
    are not used: the layer that it has where neither OpenMP nor TBB is installed ends the process
    when two threads call it at once.
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
    """Return the Python function behind a compiled one, which works on whole arrays."""
    python: F = function.py_func  # type: ignore[attr-defined]  # numba's
    return python


def built_in(function: Any) -> Any:
    """Return a function that writes LLVM instructions into its callers (numba's `intrinsic`)."""
    return intrinsic(prefer_literal=True)(function)


@built_in
def numbers_as(typing: Any, template: Any, numbers: Any, first: Any, step: Any) -> Any:
    """Return a named tuple of the template's kind from every `step`-th number of an array.

    It begins with number `first`. Numbers become whole numbers and truth values where the template
    has such: numba types no loop over mixed fields.
    """

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(numbers)(context, builder, arguments[1])
        at = arguments[2]
        values = []
        for kind in template.types:
            pointer = _item_pointer(context, builder, numbers, array, [at])
            values.append(context.cast(builder, builder.load(pointer), types.float64, kind))
            at = builder.add(at, arguments[3])
        return context.make_tuple(builder, template, values)

    return template(template, numbers, types.intp, types.intp), build


@built_in
def write_numbers(typing: Any, array: Any, first: Any, step: Any, numbers: Any) -> Any:
    """Write the numbers of a named tuple into every `step`-th place of an array, from `first` on.

    A loop over the tuple does the same, and takes longer to compile.
    """

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        target = context.make_array(array)(context, builder, arguments[0])
        at = arguments[1]
        for k, kind in enumerate(numbers.types):
            pointer = _item_pointer(context, builder, array, target, [at])
            value = builder.extract_value(arguments[3], k)
            builder.store(context.cast(builder, value, kind, types.float64), pointer)
            at = builder.add(at, arguments[2])
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, numbers), build


@jit
def named_like(template: T, row: FloatArray) -> T:
    """Return a named tuple of the template's kind with the numbers of `row`.

    The numbers of a population are rows of one array.
    """
    named: T = numbers_as(template, row, 0, 1)
    return named


@built_in
def fused(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """Return a b + c, rounded once in all loops where the processor can, else twice."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        double = ir.DoubleType()
        function = builder.module.declare_intrinsic(
            "llvm.fmuladd", [double], ir.FunctionType(double, [double] * 3)
        )
        return builder.call(function, arguments)

    return types.float64(types.float64, types.float64, types.float64), build


@built_in
def _bits(typing: Any, x: Any) -> Any:
    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.IntType(64))

    return types.int64(types.float64), build


@jit
def sine_cosine(angle: float) -> tuple[float, float]:
    """Return sine and cosine of an angle [rad] by arithmetic alone.

    So a loop over angles becomes vector instructions. The angle less the nearest multiple of pi/2
    goes into two polynomials. That pi/2 is a rounded number moves the angle by 4e-17 of itself,
    less than its own rounding. Each is within 2e-16 of that of an angle that lies less than one
    rounding away from the one given. Beyond 1e15 rad, where a rounding is as large as the angle's
    direction, they mean nothing.
    """
    shifted = fused(angle, _PER_QUARTER, _SHIFT)
    n = shifted - _SHIFT
    r = fused(-n, _QUARTER, angle)
    z = r * r
    s = _SINE[5]
    c = _COSINE[5]
    s = fused(s, z, _SINE[4])
    c = fused(c, z, _COSINE[4])
    s = fused(s, z, _SINE[3])
    c = fused(c, z, _COSINE[3])
    s = fused(s, z, _SINE[2])
    c = fused(c, z, _COSINE[2])
    s = fused(s, z, _SINE[1])
    c = fused(c, z, _COSINE[1])
    s = fused(s, z, _SINE[0])
    c = fused(c, z, _COSINE[0])
    s = fused(r * z, s, r)
    c = fused(z * z, c, fused(-0.5, z, 1.0))
    quadrant = _bits(shifted)
    odd = (quadrant & 1) != 0
    sine = c if odd else s
    cosine = s if odd else c
    signed_sine = -sine if (quadrant & 2) != 0 else sine
    signed_cosine = -cosine if ((quadrant + 1) & 2) != 0 else cosine
    return signed_sine, signed_cosine
