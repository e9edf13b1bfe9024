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


_SPELT = dict(zip("–—−×·µ", "---x*u", strict=True)) | {"…": "...", "°": " deg", "±": "+-", "≤": "<=", "≥": ">=", "μ": "mu"}
"""Signs that ASCII lacks, as it writes them."""


def ascii_text(text: str) -> str:
    """Return a text in ASCII, for a terminal that knows nothing else: signs are spelt out, others become escapes."""
    return "".join(_SPELT.get(c) or _plain_letter(c) for c in text)


def _plain_letter(character: str) -> str:
    plain = unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode()
    return plain or character.encode("ascii", "backslashreplace").decode()
