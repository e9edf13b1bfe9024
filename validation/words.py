"""Text from outside the project (file names, topics, messages) made harmless before it is shown."""

from __future__ import annotations

import unicodedata

_HARMFUL = {"Cc", "Cf", "Cs", "Zl", "Zp"}
"""Unicode categories that move a cursor, start an escape sequence or turn the reading direction around."""


def one_line(text: object) -> str:
    """Return foreign text in one line: runs of white space become a space, other control characters a replacement mark."""
    line = " ".join(str(text).split())
    return line if line.isprintable() else "".join("�" if unicodedata.category(c) in _HARMFUL else c for c in line)


def shortened(text: object, most: int) -> str:
    """Return foreign text in one line of at most `most` characters; the end is kept, for it says more than the beginning."""
    line = one_line(text)
    return line if len(line) <= most else f"…{line[1 - most :]}"


def code_span(text: object) -> str:
    """Return foreign text as a code span of markdown."""
    return "`" + one_line(text).replace("`", "'") + "`"
