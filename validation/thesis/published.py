"""The numbers that the thesis prints: every table, read-only, by its number.

The data are in ``published.toml`` beside this module; its first lines say what each key means. A number is what the
thesis prints, even if the print is wrong: such rows and tables have ``suspect`` or a ``note``. A table whose numbers are
not available has ``lost``, or ``taken_from`` if another table repeats them.
"""

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib import resources
from types import MappingProxyType
from typing import Any

_SCHEMA = "ssmr.published/1"


def _frozen(node: Any) -> Any:
    """Return a read-only copy of a parsed TOML value: mappings become proxies, arrays become tuples."""
    if isinstance(node, dict):
        return MappingProxyType({key: _frozen(item) for key, item in node.items()})
    if isinstance(node, list):
        return tuple(_frozen(item) for item in node)
    return node


@cache
def published_tables() -> Mapping[str, Any]:
    """Return all published numbers.

    Returns:
        A read-only mapping with ``schema``, ``source``, each table under its number (``"3.1"`` to ``"4.38"``) and the
        numbers of the running text under ``"text"``. Nested mappings are read-only too; arrays are tuples.

    Raises:
        ValueError: The file has another schema than this module reads.
    """
    data = tomllib.loads(resources.files("validation.thesis").joinpath("published.toml").read_text(encoding="utf-8"))
    if data.get("schema") != _SCHEMA:
        raise ValueError(f"published.toml has schema {data.get('schema')!r}, expected {_SCHEMA!r}")
    frozen: Mapping[str, Any] = _frozen(data)
    return frozen


def table(number: str) -> Mapping[str, Any]:
    """Return one table of the thesis by its number as printed, such as ``"3.9"``, or ``"text"`` for the running text.

    Returns:
        A read-only mapping with ``caption``, ``rows`` (numbers by name of the row) and remarks on the table.

    Raises:
        ValueError: There is no such table; the message lists the known ones.
    """
    content = published_tables().get(number)
    if not isinstance(content, Mapping):
        known = ", ".join(name for name, item in published_tables().items() if isinstance(item, Mapping))
        raise ValueError(f"no published table {number!r}; known are {known}")
    return content


def value(number: str, row: str, key: str = "value") -> float:
    """Return one number of one table.

    Args:
        number: The table's number, as for `table`.
        row: The row's name, such as ``"u_x"``, ``"traj4"`` or ``"line_0.25"``.
        key: Which of the row's numbers: ``"value"`` for a parameter, ``"d_rms_m"`` and its like for a metric.

    Returns:
        The number, in the SI unit that the row or the key names.

    Raises:
        ValueError: There is no such table, row or number; the message lists the known ones.
    """
    content = table(number)
    rows: Mapping[str, Mapping[str, Any]] = content["rows"]
    if row not in rows:
        note = f" ({content['note']})" if not rows and "note" in content else ""
        raise ValueError(f"published table {number} has no row {row!r}; its rows are {', '.join(rows) or 'none'}{note}")
    numbers = {
        name: float(item)
        for name, item in rows[row].items()
        if isinstance(item, (int, float)) and not isinstance(item, bool)
    }
    if key not in numbers:
        names = ", ".join(numbers) or "none"
        raise ValueError(f"row {row!r} of published table {number} has no number {key!r}; it has {names}")
    return numbers[key]
