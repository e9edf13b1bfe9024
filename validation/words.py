r"""Foreign text (names of files, topics, columns, profiles) made harmless where it leaves.

Each medium has one function. None loses a character: what could move a cursor, start an escape
sequence, turn the reading direction around or break an encoding is written as the escape that
Python has for it, such as `\x1b` or `\u202e`, and a byte of a file name that is no text as `\xff`.

- terminal and HTML (whose template escapes its marks besides): `one_line`, and `each_line` for
  several lines;
- markdown: `markdown` for prose, `markdown_cell` for tables, `code_span` for names;
- names of files that are made from foreign text: `file_name`;
- a line on standard error, which may quote what was given: `abridged`;
- titles: `shortened`.
"""

from __future__ import annotations

import hashlib
import re
import unicodedata

_HARMFUL = {"Cc", "Cf", "Cs", "Zl", "Zp"}
"""Unicode categories that move a cursor, start an escape sequence or turn the reading direction
around."""
LONGEST_FILE_NAME = 100
"""Length of a name made from foreign text, at most [bytes]: file systems take 255, and endings and
marks are put to it."""
_OF_SHELLS = "/\\:*?\"<>|$&;'`!"
"""Printable characters that file systems or shells read as something else than a part of a name."""


def _escape(character: str) -> str:
    if unicodedata.category(character) not in _HARMFUL:
        return character
    # How Python carries a byte of a file name that is no text.
    if "\udc80" <= character <= "\udcff":
        return f"\\x{ord(character) - 0xDC00:02x}"
    return character.encode("unicode_escape").decode("ascii")


def visible(text: object) -> str:
    """Return text in which characters that are not to be shown, line breaks too, are escapes."""
    whole = str(text)
    if whole.isprintable():
        return whole
    return "".join(map(_escape, whole))


def one_line(text: object) -> str:
    """Foreign text in one harmless line: white space is a space, control characters visible."""
    return visible(" ".join(str(text).split()))


def each_line(text: object) -> str:
    """Foreign text of several lines, each of them harmless; spaces at their beginnings stay."""
    return "\n".join(map(visible, str(text).expandtabs().replace("\r\n", "\n").split("\n")))


def shortened(text: object, most: int) -> str:
    """Foreign text in one line of at most `most` characters; the end, which says more, is kept."""
    line = one_line(text)
    if len(line) <= most:
        return line
    return f"…{line[1 - most :]}"


def abridged(text: object, most: int) -> str:
    """Foreign text in one line of at most `most` characters; a longer one loses its middle."""
    line = one_line(text)
    half = most // 2
    if len(line) <= most:
        return line
    return f"{line[: most - half]} … {line[3 - half :]}"


def code_span(text: object) -> str:
    """Return foreign text as a code span of markdown."""
    return "`" + one_line(text).replace("`", "'") + "`"


def markdown(text: object) -> str:
    """Foreign text for the prose of markdown, in one line: no HTML, link or picture comes of it."""
    return re.sub(r"<(?=[A-Za-z/!?])", "&lt;", one_line(text)).replace("](", "]&#40;")


def markdown_cell(text: object) -> str:
    """Foreign text for a cell of a markdown table: as `markdown`, and it begins no other cell."""
    # A backslash before the mark would take its own away.
    return re.sub(r"(\\*)\|", r"\1\1\\|", markdown(text))


def file_name(text: object) -> str:
    """Foreign text as the name of a file or folder: no path, no option, and short enough.

    It has at most `LONGEST_FILE_NAME` bytes.
    Usual names stay as they are. Others end with a digest, so that two that differ stay two.
    """
    whole = str(text)
    name = "".join(c if c.isprintable() and c not in _OF_SHELLS else "_" for c in whole).strip(" ")
    name = re.sub(r"^[.\-~]+", "_", name).rstrip(".") or "_"
    if name == whole and len(name.encode()) <= LONGEST_FILE_NAME:
        return name
    digest = hashlib.sha256(whole.encode(errors="surrogatepass")).hexdigest()[:8]
    return f"{name.encode()[: LONGEST_FILE_NAME - 9].decode(errors='ignore')}-{digest}"
