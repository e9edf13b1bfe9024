"""Reading files that people give: regular files only, of a limited size, as UTF-8 text without surprises in it."""

from __future__ import annotations

import contextlib
import json
import math
import os
import reprlib
import stat
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

MOST_TEXT = 1 << 18
"""Greatest size of a text that describes something, such as a profile [bytes]; shipped ones have less than ten thousand."""
_MOST_DEEP = 32
"""Greatest depth of tables and lists inside one another; what comes out of the parsers is walked by recursion later."""
_MOST_DOTS = 500
"""Greatest number of dots in a line of TOML: the parser's time grows with the square of those in a key."""
_MOST_NAMED = 5
"""Greatest number of unknown keys that a message names."""
_WHOLE = 2**63
"""Whole numbers lie below this in size, as TOML wants it; Python's own have no end, and floats cannot hold them."""


@contextlib.contextmanager
def opened(path: str | Path, most_bytes: int) -> Iterator[BinaryIO]:
    """Yield a regular file, open for reading bytes; neither a pipe nor a device is waited for, or read without end.

    Raises:
        ValueError: there is no such file, it is none, cannot be read, or is larger than `most_bytes`.
    """
    careful = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_BINARY", 0)
    try:
        number = os.open(path, os.O_RDONLY | careful)
        try:
            about = os.fstat(number)
            if not stat.S_ISREG(about.st_mode):
                raise ValueError(f"{path}: this is {_kind(about.st_mode)}, wanted a file")
            if about.st_size > most_bytes:
                raise ValueError(f"{path}: the file has {_size(about.st_size)}, more than the {_size(most_bytes)} allowed")
            with os.fdopen(number, "rb", closefd=False) as stream:
                yield stream
        finally:
            os.close(number)
    except FileNotFoundError:
        raise ValueError(f"{path}: there is no such file") from None
    except OSError as error:
        raise ValueError(f"{path}: the file cannot be read ({error.strerror or error})") from error


def is_number(value: object) -> bool:
    """Return whether a value of a text is a number; true and false are none."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _kind(mode: int) -> str:
    """Return in words what a thing that is no regular file is."""
    kinds = ((stat.S_ISDIR, "a folder"), (stat.S_ISFIFO, "a pipe"), (stat.S_ISSOCK, "a socket"))
    return next((words for is_kind, words in kinds if is_kind(mode)), "a device")


def _size(count: int) -> str:
    """Return a number of bytes in words."""
    return f"{count / 1e6:.3g} MB" if count >= 100_000 else f"{count} bytes"


def read_file(path: str | Path, most_bytes: int) -> bytes:
    """Return what a regular file holds.

    Raises:
        ValueError: there is no such file, it is none, cannot be read, or is larger than `most_bytes`.
    """
    with opened(path, most_bytes) as stream:
        data = stream.read(most_bytes + 1)
    if len(data) > most_bytes:  # it grew, or its size is not told, as below /proc
        raise ValueError(f"{path}: the file has more than the {_size(most_bytes)} allowed")
    return data


def read_text(path: str | Path, most_bytes: int = MOST_TEXT) -> str:
    """Return the text of a file in UTF-8, without the mark that some editors write in front.

    Raises:
        ValueError: the file cannot be read, is too large, or is no such text.
    """
    data = read_file(path, most_bytes)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ValueError(f"{path}: the file cannot be read as text; line {line} has a byte that is not UTF-8") from error


def read_toml(path: str | Path, most_bytes: int = MOST_TEXT) -> dict[str, Any]:
    """Return the document of a TOML file; numbers may be infinite or NaN there.

    Raises:
        ValueError: the file cannot be read, is too large, is no TOML, or is nested too deep.
    """
    return parse_toml(read_text(path, most_bytes), str(path))


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """Return the document of a TOML text; `name` says in messages where the text is from.

    Raises:
        ValueError: it is no TOML, or is nested too deep.
    """
    if any(line.count(".") > _MOST_DOTS for line in text.split("\n")):
        raise ValueError(f"{name}: a line has more than {_MOST_DOTS} dots; write it as several")
    try:
        return dict(_shallow(tomllib.loads(text)))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{name}: {_said(error)}") from error


def read_json(path: str | Path, most_bytes: int) -> Any:
    """Return the document of a JSON file, whose numbers are finite.

    Raises:
        ValueError: the file cannot be read, is too large, is no JSON, is nested too deep, or holds a number that is not
            finite.
    """
    return parse_json(read_text(path, most_bytes), str(path))


def parse_json(text: str, name: str) -> Any:
    """Return the document of a JSON text, whose numbers are finite; `name` says in messages where the text is from.

    Raises:
        ValueError: it is no JSON, is nested too deep, or holds a number that is not finite.
    """
    try:
        return _shallow(json.loads(text), finite=True)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{name}: {_said(error)}") from error


def require_known(table: Any, known: Iterable[str], where: str) -> None:
    """Refuse what is no table, or has keys that mean nothing; `where` says in messages which table it is.

    Raises:
        ValueError: it is none, or has others than the `known` keys; the message names the first of them.
    """
    if not isinstance(table, Mapping):
        raise ValueError(f"{where} is {reprlib.repr(table)}, wanted a table")
    if unknown := sorted(set(table) - set(known)):
        some = ", ".join(unknown[:_MOST_NAMED])
        raise ValueError(f"{where} has unknown keys {some}; there are: {', '.join(sorted(known))}")


def _said(error: Exception) -> str:
    """Return the message of a parser in one line."""
    return _TOO_DEEP if isinstance(error, RecursionError) else " ".join(str(error).split())


_TOO_DEEP = f"tables and lists lie more than {_MOST_DEEP} deep inside one another"


def _shallow(document: Any, *, finite: bool = False) -> Any:
    """Return a document that can be walked by recursion, and whose numbers and texts others can hold.

    Raises:
        ValueError: it is nested too deep, or holds a number that is too large or not `finite`, or half of a character.
    """
    level = [document]
    for _ in range(_MOST_DEEP + 1):
        for value in level:
            if isinstance(value, int) and abs(value) >= _WHOLE:
                raise ValueError("a whole number has more than 64 bits")
            if finite and isinstance(value, float) and not math.isfinite(value):
                raise ValueError("a number is not finite")
            if isinstance(value, str):
                value.encode()  # JSON can name half of a pair that stands for one character
        inner = [value for value in level if isinstance(value, dict | list)]
        level = [part for value in inner for part in ([*value, *value.values()] if isinstance(value, dict) else value)]
        if not level:
            return document
    raise ValueError(_TOO_DEEP)
