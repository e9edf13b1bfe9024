r"""Make words harmless, write files whole, return memory, and report progress.

Foreign text (names of files, topics, columns, profiles) is made harmless where it leaves.
Each medium has one function. None loses a character: what could move a cursor, start an escape
sequence, turn the reading direction around or break an encoding is written as the escape that
Python has for it, such as `\x1b` or `\u202e`, and a byte of a file name that is no text as `\xff`.

- terminal and HTML (whose template escapes its marks besides): `one_line`, and `each_line` for
  several lines;
- markdown: `markdown_text` for prose, `code_span` for names, `one_line` for cells of tables;
- names of files that are made from foreign text: `file_name`;
- a line on standard error, which may quote what was given: `abridge_text`;
- titles: `shorten_text`.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import platform
import re
import secrets
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import IO, Any, NamedTuple

# --- words ---

_HARMFUL = {"Cc", "Cf", "Cs", "Zl", "Zp"}
"""Unicode categories that move a cursor, start an escape sequence or turn the reading direction
around."""
LONGEST_FILE_NAME = 100
"""Length of a name made from foreign text, at most [bytes]: file systems take 255, and endings and
marks are put to it."""
_OF_SHELLS = "/\\:*?\"<>|$&;'`!"
"""Printable characters that file systems or shells read as something else than a part of a name."""


def _escape_character(character: str) -> str:
    if unicodedata.category(character) not in _HARMFUL:
        return character
    # How Python carries a byte of a file name that is no text.
    if "\udc80" <= character <= "\udcff":
        return f"\\x{ord(character) - 0xDC00:02x}"
    return character.encode("unicode_escape").decode("ascii")


def make_visible(text: object) -> str:
    """Return text in which characters that are not to be shown, line breaks too, are escapes."""
    whole = str(text)
    if whole.isprintable():
        return whole
    return "".join(map(_escape_character, whole))


def said_once(notes: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the notes of several results, each behind the names of those that have it.

    One that all share has no name.
    """
    names: dict[str, list[str]] = {}
    for name, sentences in notes.items():
        for sentence in sentences:
            names.setdefault(sentence, []).append(name)
    said = []
    for sentence, of in names.items():
        lead = "" if len(of) == len(notes) else f"{', '.join(of)}: "
        said.append(lead + sentence)
    return said


def one_line(text: object) -> str:
    """Foreign text in one harmless line: white space is a space, control characters visible."""
    return make_visible(" ".join(str(text).split()))


def each_line(text: object) -> str:
    """Foreign text of several lines, each of them harmless; spaces at their beginnings stay."""
    return "\n".join(map(make_visible, str(text).expandtabs().replace("\r\n", "\n").split("\n")))


def shorten_text(text: object, most: int) -> str:
    """Foreign text in one line of at most `most` characters; the end, which says more, is kept."""
    line = one_line(text)
    if len(line) <= most:
        return line
    return f"…{line[1 - most :]}"


def abridge_text(text: object, most: int) -> str:
    """Foreign text in one line of at most `most` characters; a longer one loses its middle."""
    line = one_line(text)
    half = most // 2
    if len(line) <= most:
        return line
    return f"{line[: most - half]} … {line[3 - half :]}"


def code_span(text: object) -> str:
    """Return foreign text as a code span of markdown."""
    return "`" + one_line(text).replace("`", "'") + "`"


def markdown_text(text: object) -> str:
    """Foreign text for the prose of markdown, in one line: no HTML, link or picture comes of it."""
    return re.sub(r"<(?=[A-Za-z/!?])", "&lt;", one_line(text)).replace("](", "]&#40;")


def file_name(text: object) -> str:
    """Foreign text as the name of a file or folder: no path, no option, and short enough.

    It has at most `LONGEST_FILE_NAME` bytes. Usual names stay as they are.
    """
    name = "".join(c if c.isprintable() and c not in _OF_SHELLS else "_" for c in str(text))
    name = re.sub(r"^[.\-~]+", "_", name.strip(" "))
    return name.encode()[:LONGEST_FILE_NAME].decode(errors="ignore").rstrip(". ") or "_"


# --- files ---

Document = dict[str, Any]
"""Values by name, as a JSON or TOML file and the rows of its tables have them."""
PICTURES = (".png", ".pdf", ".svg")
"""Endings of pictures."""
PACKAGES = ("ssmr-testbed", "mujoco", "numpy", "scipy", "numba", "control", "rerun-sdk")
"""Packages whose versions a result records."""


def list_versions() -> dict[str, str]:
    """Return the versions of this project, Python and the packages that decide numbers."""
    packages = {package: _package_version(package) for package in PACKAGES}
    return {"python": platform.python_version(), **packages}


@cache
def _package_version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


_PART = ".ssmr-"
"""Beginning of the names of files that are being written; they are hidden."""


def write_atomic(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` make a file beside `path`, then move it there; a failure leaves the old one.

    What killed processes have left in the folder is removed.

    Args:
        path: where the file shall be; its folder must exist.
        write: gets the temporary path, whose suffix is that of `path`; an empty file is there.

    Raises:
        OSError: the file cannot be written.
    """
    for left in path.parent.glob(f"{_PART}*"):
        # one that is being written is held; without rights it stays
        with contextlib.suppress(OSError), left.open("r+b") as file:
            if _hold_file(file):
                left.unlink()
    temporary = path.with_name(f"{_PART}{secrets.token_hex(8)}.part{path.suffix}")
    try:
        with temporary.open("xb") as file:
            _hold_file(file)
            write(temporary)
            # Windows moves no file that is open
            if os.name != "posix":
                file.close()
            os.replace(temporary, path)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _hold_file(file: IO[bytes]) -> bool:
    """Hold a file until it is closed or this process ends; return whether nobody else does."""
    if os.name != "posix":
        return False
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def write_text(path: Path, text: str) -> None:
    """Write a text as UTF-8, whole or not at all; half a surrogate pair becomes an escape."""
    data = text.encode("utf-8", "backslashreplace")
    write_atomic(path, lambda temporary: temporary.write_bytes(data))


def plain_value(value: Any) -> Any:
    """A value as JSON has it: no array's number, and null for one that is not finite."""
    if isinstance(value, Mapping):
        return {str(k): plain_value(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain_value(v) for v in value]
    if hasattr(value, "item"):  # a number of numpy
        return plain_value(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write a document as JSON, or nothing and a ValueError if a number is not finite."""
    write_text(path, json.dumps(document, indent=2, allow_nan=False) + "\n")


def make_encodable(value: Any) -> Any:
    """A document of Unicode texts throughout: half a surrogate pair is a byte of no text."""
    if isinstance(value, Mapping):
        return {make_encodable(k): make_encodable(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [make_encodable(v) for v in value]
    if isinstance(value, str):
        return value.encode("utf-8", "backslashreplace").decode()
    return value


class _UnusableFolder(OSError, ValueError):
    """A folder cannot be made or written: first its namer's mistake, later a failed run."""


def make_folder(path: Path) -> Path:
    """Make a folder to write into, and return it; an _UnusableFolder says why it cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _UnusableFolder(f"{path}: the folder cannot be made ({error.strerror})") from error
    if not os.access(path, os.W_OK):
        raise _UnusableFolder(f"{path}: the folder cannot be written; name another")
    return path


# --- memory ---


def return_memory() -> None:
    """Return to the system what Python let go of, where the C library keeps it, as glibc does.

    It keeps half of what a log of hours fills, in pieces into which nothing large fits any more.
    """
    import ctypes  # here: no process that is told its limits needs it

    trim = getattr(ctypes.pythonapi, "malloc_trim", None)
    if trim is not None:
        trim(0)


# --- progress of long work: a callback, so that no library knows of terminals ---


class Progress(NamedTuple):
    """Progress of a long computation."""

    done: float
    """Number of finished steps; with a fraction while a step is under way."""
    total: float
    """Number of all steps."""
    text: str
    """The step under way in a few words, such as `traj4, mujoco` or `cost 0.0031`."""


Progressing = Callable[[Progress], object]
"""A callback that takes each `Progress` as it happens. It is called from one thread at a time."""


def ignore_progress(progress: Progress) -> None:
    """Ignore `progress`; the default where nobody asks for reports."""
