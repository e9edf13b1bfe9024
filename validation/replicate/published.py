"""The numbers that the thesis prints: every table by its number.

The data are in `published.toml` beside this module; its first lines say what each key means. A
number is what the thesis prints, even if the print is wrong: such rows and tables have `suspect` or
a `note`. A table whose numbers are not available has `lost`, or `taken_from` if another table
repeats them.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any


@cache
def published_tables() -> Mapping[str, Any]:
    """Return `schema`, `source`, the tables by number ("3.1" to "4.38") and "text" of the prose."""
    file = resources.files("validation.replicate") / "published.toml"
    return tomllib.loads(file.read_text(encoding="utf-8"))


def printed_table(number: str) -> Mapping[str, Any]:
    """Return a table such as "3.9": its `caption`, `rows` (numbers by row) and remarks."""
    content = published_tables()[number]
    return content


def printed_value(number: str, row: str, key: str = "value") -> float:
    """Return one number of a table, in the SI unit that its row or key names.

    Args:
        number: the table's number, as for `printed_table`.
        row: the row's name, such as "u_x", "traj4" or "line_0.25".
        key: which of the row's numbers: "value" for a parameter, "d_rms_m" and its like for a
            metric.
    """
    return float(printed_table(number)["rows"][row][key])
