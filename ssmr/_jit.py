"""numba with a cache on disk that is never stale, with threads, and with functions it lacks.

numba notices edits to the file of the compiled function alone, not to what that function calls from
other files, and keeps the code of each place of a file apart. Here code is kept under a digest of
what it is made of: the bytecode, constants and types of the function and of all that it calls. So
an edit compiles what it touches, and copies of the sources share what they have in common. The
compiled functions keep their Python source, see `python_source`.

numba unpickles what lies in its cache, and who can write there can run code as this user. So the
cache is in the user's own cache folder. Where that cannot be written, every start compiles anew.
"""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import logging
import math
import os
import shutil
import stat
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, TypeVar

import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core import config as numba_config
from numba.core.caching import IndexDataCacheFile
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.extending import intrinsic

from ssmr.types import FloatArray

config: Any = numba_config
"""Settings of numba, which it reads from the environment when it is imported; no stub declares
them."""
_njit: Any = numba.njit
_item_pointer: Any = cgutils.get_item_pointer
_result: Any = CompileResult
_index_and_data: Any = IndexDataCacheFile

_SHARES = 4
"""Shares of a thread: one that is done early takes another."""
_CACHE_LIFETIME = 30 * 24 * 3600.0
"""Time for which compiled code is kept that nobody uses [s]."""
_ONLY = 0
"""Key of the one thing in an index."""
_OF_OTHERS = ("numpy.", "numba.", "llvmlite.")
"""Packages whose functions have the names that they go by: a version for a version."""
_WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH

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
_log = logging.getLogger(__name__)


def _cache_folder() -> str:
    """Return the folder for compiled code, made if need be; "" where none can be trusted."""
    # XDG Base Directory Specification
    mine = f"{os.environ.get('XDG_CACHE_HOME') or '~/.cache'}/ssmr-testbed"
    why = "no folder for it can be written"
    try:
        folder = Path(config.CACHE_DIR or mine).expanduser()
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not _is_mine_alone(folder):
            why = f"others can write to {folder}, or it is theirs"
        elif os.access(folder, os.W_OK):
            return str(folder)
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

    It may call a user's code, of which the digest need not know all.
    """
    global _saves
    _saves = False


class _Kept:
    """Compiled code of one function on disk, in a folder for each digest of what it is made of.

    numba's own cache has one index for all signatures of a function, which two processes that write
    at once can spoil. Here each has its own, and whoever writes there writes the same.
    """

    cache_path = _FOLDER

    def __init__(self, function: Callable[..., Any]) -> None:
        """Keep the code of a Python function."""
        self._function = function

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the code for a signature; None where there is none, or none that can be used."""
        target_context.refresh()
        place = self._place(sig, target_context.codegen())
        with contextlib.suppress(Exception):  # unpickling a damaged file can raise anything
            kept = _file_in(place).load(_ONLY)
            if kept is not None:
                with contextlib.suppress(OSError):
                    os.utime(place)  # it is in use, see `_remove_unused`
                return _result._rebuild(target_context, *kept)
        if _saves:
            _say_that_it_happens_once()
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the code for a signature; where the disk is full it is compiled again next time."""
        if _saves and not data.library.has_dynamic_globals:
            with contextlib.suppress(OSError):
                _remove_unused()
                place = self._place(sig, data.codegen)
                place.mkdir(exist_ok=True)
                file = _file_in(place)
                file.flush()  # an index that is damaged
                file.save(_ONLY, data._reduce())

    def _place(self, signature: Any, codegen: Any) -> Path:
        processor = codegen.magic_tuple()
        python = sys.implementation.cache_tag
        digest = _digest_of((numba.__version__, python, processor, self._function, *signature))
        return Path(_FOLDER, f"numba-{digest[:24]}")


def _file_in(place: Path) -> Any:
    """Return numba's index and data file for one thing, which it writes whole or not at all."""
    return _index_and_data(str(place), "code", None)


@cache
def _say_that_it_happens_once() -> None:
    _log.info("compiling for this processor: this takes seconds once, later starts are quick")


@cache
def _remove_unused() -> None:
    """Remove what no process has used for long, also of other versions of this package."""
    for old in Path(_FOLDER).glob("numba-*"):
        if time.time() - old.lstat().st_mtime > _CACHE_LIFETIME:
            shutil.rmtree(old, ignore_errors=True)


def _digest_of(thing: Any) -> str:
    """Return a digest of what is compiled and of all that it refers to.

    Names of places, lines and docstrings are not in it, nor what else its modules hold.
    """
    digest = hashlib.sha256()
    seen: dict[int, tuple[int, Any]] = {}
    waiting = [thing]
    while waiting:
        now = waiting.pop()
        if id(now) in seen:
            digest.update(b"%d;" % seen[id(now)][0])
            continue
        text, parts = _made_of(now)
        if parts:
            seen[id(now)] = len(seen), now  # which lives, so that no other thing gets its id
        digest.update(f"{text!r} {len(parts)};".encode())
        waiting += parts
    return digest.hexdigest()


def _made_of(thing: Any) -> tuple[str, Sequence[Any]]:
    """Return what compiled code takes from a thing itself, and the things that this refers to."""
    if isinstance(thing, tuple):
        return "", (type(thing), *thing)
    if isinstance(thing, types.Type):
        return str(thing), (getattr(thing, "instance_class", None), *getattr(thing, "types", ()))
    if isinstance(thing, np.ndarray):
        return f"{thing.dtype.str} {thing.shape}", (thing.tobytes(),)
    if isinstance(thing, ModuleType):
        return thing.__name__, ()
    if not hasattr(thing, "__qualname__"):
        return repr(thing), ()
    name = f"{thing.__module__}.{thing.__qualname__}"
    if isinstance(thing, type):
        held = [each for each in vars(thing).values() if isinstance(each, Dispatcher)]
        return name, (getattr(thing, "_fields", ()), *held)
    function = inspect.unwrap(thing)
    if not isinstance(function, FunctionType) or name.startswith(_OF_OTHERS):
        return name, ()
    return name, (getattr(thing, "targetoptions", None), *_parts_of(function))


def _parts_of(function: FunctionType) -> list[Any]:
    """Return the code of a function and of those inside it, and all that they can refer to.

    So a function that is compiled in place of another one (`built_in`) must be in that one's place.
    """
    parts: list[Any] = [function.__defaults__]
    parts += [cell.cell_contents for cell in function.__closure__ or ()]
    codes = [function.__code__]
    for code in codes:
        inner = [each for each in code.co_consts if isinstance(each, CodeType)]
        codes += inner
        parts += [each for each in code.co_consts if each not in (*inner, function.__doc__)]
        parts += [code.co_code, code.co_names, code.co_varnames]
        named = [function.__globals__.get(name) for name in code.co_names]
        parts += named
        for module in named:
            if isinstance(module, ModuleType):
                parts += [vars(module).get(name) for name in code.co_names]
    return parts


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


def python_source(function: F) -> F:
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
def multiply_add(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """Return a b + c, rounded once in all loops where the processor can, else twice."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        double = ir.DoubleType()
        function = builder.module.declare_intrinsic(
            "llvm.fmuladd", [double], ir.FunctionType(double, [double] * 3)
        )
        return builder.call(function, arguments)

    return types.float64(types.float64, types.float64, types.float64), build


@built_in
def _float_bits(typing: Any, x: Any) -> Any:
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
    shifted = multiply_add(angle, _PER_QUARTER, _SHIFT)
    n = shifted - _SHIFT
    r = multiply_add(-n, _QUARTER, angle)
    z = r * r
    s = _SINE[5]
    c = _COSINE[5]
    for k in range(4, -1, -1):  # becomes one line of instructions
        s = multiply_add(s, z, _SINE[k])
        c = multiply_add(c, z, _COSINE[k])
    s = multiply_add(r * z, s, r)
    c = multiply_add(z * z, c, multiply_add(-0.5, z, 1.0))
    quadrant = _float_bits(shifted)
    odd = (quadrant & 1) != 0
    sine = c if odd else s
    cosine = s if odd else c
    signed_sine = -sine if (quadrant & 2) != 0 else sine
    signed_cosine = -cosine if ((quadrant + 1) & 2) != 0 else cosine
    return signed_sine, signed_cosine
