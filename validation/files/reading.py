"""Reading foreign files: regular files only, of a limited size, as bounded UTF-8 text."""

from __future__ import annotations

import contextlib
import os
import reprlib
import stat
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, BinaryIO, TypeVar

import msgspec

from validation.output import one_line

T = TypeVar("T")
_MOST_TEXT = 1 << 18
"""Greatest size of a text that describes something, such as a profile [bytes]; shipped ones have
less than ten thousand."""
_MOST_NAMED = 5
"""Greatest number of unknown keys that a message names."""
_KINDS = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}
_WHOLE = 2**63
"""Whole numbers lie below this in size, as TOML wants it; Python's own have no end, and floats
cannot hold them."""


TomlNumber = Annotated[float, msgspec.Meta(ge=-sys.float_info.max, description="a number")]
"""A number in a document, which may be infinite."""
TomlText = Annotated[
    str, msgspec.Meta(max_length=2000, description="a text of at most 2000 characters")
]
"""A text in a document."""
TomlTable = Annotated[dict[str, Any], msgspec.Meta(description="a table")]
"""A table in a document."""


class FileError(ValueError):
    """A bad file: one line says the fault, its place, and the right content."""

    def __init__(
        self, path: str | Path, what: str, line: int | None = None, column: str | None = None
    ) -> None:
        """Keep the place: the file, the line as an editor counts it, and the column's name."""
        super().__init__(path, what, line, column)
        self.path = path
        self.what = what
        self.line = line
        self.column = column

    def __str__(self) -> str:
        line = "" if self.line is None else f", line {self.line}"
        column = "" if self.column is None else f", column {self.column}"
        return one_line(f"{self.path}{line}{column}: {self.what}")


def quoted(texts: Iterable[str]) -> str:
    """Return foreign texts for a message: quoted, shortened and on one line."""
    short = [repr(s if len(s) <= 30 else s[:27] + "...") for s in texts]
    if len(short) > 12:
        short[12:] = ["..."]
    return ", ".join(short)


def exists(path: Path) -> bool:
    """Return whether there is a file or folder of that name; False for an impossible name."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


# ------------------------------------------------------------------------------------------ files
@contextlib.contextmanager
def opened(path: str | Path, most_bytes: int = sys.maxsize, limit: str = "") -> Iterator[BinaryIO]:
    """Yield a regular file, open for reading bytes; no pipe or device is waited for.

    Args:
        path: the file; links are followed.
        most_bytes: greatest size.
        limit: name by which a user can raise that size, for the message; empty where there is none.

    Raises:
        FileError: there is no such file, it is none, cannot be read, or is larger than
            `most_bytes`.
    """
    careful = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_BINARY", 0)
    try:
        number = os.open(path, os.O_RDONLY | careful)
        try:
            about = os.fstat(number)
            if not stat.S_ISREG(about.st_mode):
                kind = _KINDS.get(stat.S_IFMT(about.st_mode), "a device")
                raise FileError(path, f"this is {kind}, wanted a file")
            if about.st_size > most_bytes:
                allowed = f"the {_size(most_bytes)} allowed"
                if limit:
                    allowed += f" (limit {limit})"
                raise FileError(path, f"the file has {_size(about.st_size)}, more than {allowed}")
            with os.fdopen(number, "rb", closefd=False) as stream:
                yield stream
        finally:
            os.close(number)
    except FileNotFoundError:
        raise FileError(path, "there is no such file") from None
    except OSError as error:
        raise FileError(path, f"the file cannot be read ({error.strerror or error})") from error


def _size(count: int) -> str:
    if count < 100_000:
        return f"{count} bytes"
    return f"{count / 1e6:.3g} MB"


def read_file(path: str | Path, most_bytes: int) -> bytes:
    """Return the content of a regular file; the arguments and errors are those of `opened`."""
    with opened(path, most_bytes) as stream:
        size = os.fstat(stream.fileno()).st_size
        data = stream.read(min(most_bytes, max(size, _MOST_TEXT)) + 1)
    if len(data) > most_bytes:  # it grew, or the system does not say its size, as below /proc
        raise FileError(path, f"the file has more than the {_size(most_bytes)} allowed")
    return data


def read_text(path: str | Path, most_bytes: int = _MOST_TEXT) -> str:
    """Return the text of a file in UTF-8, without a byte order mark; a ValueError if it is none."""
    data = read_file(path, most_bytes)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ValueError(
            f"{path}: the file cannot be read as text; line {line} has a byte that is not UTF-8"
        ) from error


# ------------------------------------------------------------------------------------------
# documents
def load_named(
    what: str, name: str, shipped: Mapping[str, Path], parse: Callable[[dict[str, Any]], T]
) -> T:
    """Return what `parse` makes of the document of a shipped file by name, or of a file by path.

    A shipped name comes before a file of that name in the current folder.

    Raises:
        ValueError: there is no such file, or it says something that cannot be; the message names
            `what` it is for, and the file.
    """
    path = shipped.get(name, Path(name))
    if name not in shipped and not exists(path):
        raise ValueError(
            f"no {what} '{one_line(name)}'; there are: {', '.join(shipped)}; "
            "and no file has that path"
        )
    document = _parse_toml(read_text(path), f"{what} {one_line(name)}")
    try:
        return parse(document)
    except ValueError as error:
        raise ValueError(f"{what} {one_line(name)}: {one_line(error)}") from error


def _parse_toml(text: str, name: str) -> dict[str, Any]:
    """Return the document of a TOML text, where numbers may be infinite.

    Raises:
        ValueError: it is no TOML, or too deep or large; the message begins with `name`.
    """
    try:
        document = tomllib.loads(text)
        _refuse_large_numbers(document)
    except (ValueError, RecursionError) as error:
        why = "tables and lists lie too deep inside one another"
        if isinstance(error, ValueError):
            why = " ".join(str(error).split())
        raise ValueError(f"{name}: {why}") from error
    return document


def _refuse_large_numbers(value: Any) -> None:
    """Refuse numbers that are too large."""
    if isinstance(value, int) and abs(value) >= _WHOLE:
        raise ValueError("a whole number has more than 64 bits")
    if isinstance(value, dict | list):
        for part in value.values() if isinstance(value, dict) else value:
            _refuse_large_numbers(part)


def typed(table: Any, kinds: Mapping[str, Any], where: str = "") -> dict[str, Any]:
    """Return the values of a TOML table, each of the type that its key has.

    Args:
        table: the table.
        kinds: for each key that there may be, a type as msgspec has it, with a description.
        where: the section; the top level if not given.

    Raises:
        ValueError: this is no table, or it has an unknown key or a value of another type.
    """
    require_known(table, kinds, where or "the top level")
    values = {}
    for key, value in table.items():
        try:
            values[key] = msgspec.convert(value, kinds[key])
        except msgspec.ValidationError as error:
            name = f"{where}.{key}".removeprefix(".")
            wanted = kinds[key].__metadata__[-1].description
            raise ValueError(f"{name} is {reprlib.repr(value)}, wanted {wanted}") from error
    return values


def require_known(table: Any, known: Iterable[str], where: str) -> None:
    """Raise a ValueError if this is no table, or has unknown keys; `where` names it there."""
    if not isinstance(table, Mapping):
        raise ValueError(f"{where} is {reprlib.repr(table)}, wanted a table")
    unknown = sorted(set(table) - set(known))
    if unknown:
        some = ", ".join(unknown[:_MOST_NAMED])
        raise ValueError(f"{where} has unknown keys {some}; there are: {', '.join(sorted(known))}")
