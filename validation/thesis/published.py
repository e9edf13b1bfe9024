"""The thesis' printed numbers: every table, read-only, by its number.

The data are in ``published.toml`` beside this module; its head says what each key means. A number is what
the thesis prints, also where the print is wrong: such rows and tables carry ``suspect`` or a ``note``. Where
a table's numbers are not at hand it says ``lost``, or ``taken_from`` when another table repeats them.
"""

import tomllib
from collections.abc import Iterable, Mapping
from functools import cache
from importlib import resources
from types import MappingProxyType
from typing import Any

SCHEMA = "ssmr.published/1"


def _frozen(node: Any) -> Any:
    """A read-only copy of a parsed TOML value: mappings become proxies, arrays tuples."""
    if isinstance(node, dict):
        return MappingProxyType({key: _frozen(item) for key, item in node.items()})
    if isinstance(node, list):
        return tuple(_frozen(item) for item in node)
    return node


def _listed(names: Iterable[str]) -> str:
    """Names for an error message."""
    return ", ".join(names) or "none"


@cache
def load() -> Mapping[str, Any]:
    """All published numbers.

    Returns:
        Read-only mapping with ``schema``, ``source``, each table under its number (``"3.1"`` to ``"4.38"``)
        and the numbers of the running text under ``"text"``. Nested mappings are read-only too; arrays are
        tuples.

    Raises:
        ValueError: If the file is of another schema than this module reads.
    """
    data = tomllib.loads(resources.files("validation.thesis").joinpath("published.toml").read_text(encoding="utf-8"))
    if data.get("schema") != SCHEMA:
        raise ValueError(f"published.toml has schema {data.get('schema')!r}, expected {SCHEMA!r}")
    frozen: Mapping[str, Any] = _frozen(data)
    return frozen


def table(number: str) -> Mapping[str, Any]:
    """One table of the thesis.

    Args:
        number: The table's number as printed, such as ``"3.9"``, or ``"text"`` for the running text.

    Returns:
        Read-only mapping with ``caption``, ``rows`` (row name to its numbers) and what qualifies the table.

    Raises:
        ValueError: If there is no such table; the message lists those there are.
    """
    content = load().get(number)
    if not isinstance(content, Mapping):
        known = _listed(name for name, item in load().items() if isinstance(item, Mapping))
        raise ValueError(f"no published table {number!r}; known are {known}")
    return content


def value(number: str, row: str, key: str = "value") -> float:
    """One number of one table.

    Args:
        number: The table's number as printed, such as ``"3.8"``, or ``"text"`` for the running text.
        row: The row's name, such as ``"u_x"``, ``"traj4"`` or ``"line_0.25"``.
        key: Which of the row's numbers: ``"value"`` for a parameter, ``"d_rms_m"`` and its like for a metric.

    Returns:
        The number, in the SI unit that the row or the key names.

    Raises:
        ValueError: If there is no such table or row, or no number under the key; the message lists what is.
    """
    content = table(number)
    rows: Mapping[str, Mapping[str, Any]] = content["rows"]
    if row not in rows:
        note = f" ({content['note']})" if not rows and "note" in content else ""
        raise ValueError(f"published table {number} has no row {row!r}; its rows are {_listed(rows)}{note}")
    numbers = {
        name: float(item)
        for name, item in rows[row].items()
        if isinstance(item, (int, float)) and not isinstance(item, bool)
    }
    if key not in numbers:
        raise ValueError(f"row {row!r} of published table {number} has no number {key!r}; it has {_listed(numbers)}")
    return numbers[key]
