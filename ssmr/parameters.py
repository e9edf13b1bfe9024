"""Numbers of a model, declared once, at the dataclass field.

A declaration has default, unit, allowed range and search bounds.

For example:

    @dataclass(frozen=True)
    class Tyre:
        friction: float = parameter(0.3, unit="1", low=0.0, high=5.0, search=(0.1, 1.2))

        def __post_init__(self) -> None:
            check_parameters(self)
"""

from __future__ import annotations

import math
import reprlib
import sys
from collections import Counter, namedtuple
from collections.abc import Collection, Iterable, Mapping
from dataclasses import Field, dataclass, field, fields, replace
from numbers import Integral, Real
from types import MappingProxyType
from typing import Any, Literal

from ssmr.errors import ParameterError

Scale = Literal["linear", "log"]
"""Spacing of a search: `log` where only the order of magnitude is known."""

Bounds = tuple[float, float]
"""Least and greatest value of a search."""

_KEY = "parameter"


@dataclass(frozen=True)
class Declaration:
    """Everything that was declared about one number."""

    name: str
    """Name of the field."""
    default: float | None
    """Value of a parameter set that does not set it; None for a number that every set must say."""
    unit: str
    """Unit of the value; `1` for a pure number."""
    low: float
    """Least value allowed."""
    high: float
    """Greatest value allowed; infinity itself is allowed where `high` is infinite."""
    open_low: bool
    """Whether `low` itself is forbidden."""
    search: Bounds | None
    """Default bounds of a search; None if no search may move the number."""
    scale: Scale
    """Spacing of the search between its bounds."""
    of: tuple[str, str]
    """The sizes of the robot of which `search` has multiples, of the lower and of the upper bound;
    empty where these are in the number's own unit."""

    def check(self, name: str, value: float) -> None:
        """Raise a ParameterError that calls a value `name` if it lies outside its range."""
        _require_in_bounds(name, value, self.low, self.high, self.open_low)

    def bounds(self, sizes: Mapping[str, float]) -> Bounds | None:
        """Return the default bounds of a search for a robot of these sizes, in the number's unit.

        None says that no search may move the number.
        """
        if self.search is None:
            return None
        low, high = (sizes[name] if name else 1.0 for name in self.of)
        return self.search[0] * low, self.search[1] * high


def parameter(
    default: float | None = None,
    *,
    unit: str,
    low: float,
    high: float = math.inf,
    open_low: bool = False,
    search: Bounds | None = None,
    scale: Scale = "linear",
    of: str | tuple[str, str] = "",
) -> Any:
    """Return a dataclass field that holds a number; see `Declaration` for the arguments."""
    declaration = Declaration(
        name="",
        default=default,
        unit=unit,
        low=low,
        high=high,
        open_low=open_low,
        search=search,
        scale=scale,
        of=(of, of) if isinstance(of, str) else of,
    )
    metadata = {_KEY: declaration}
    if default is None:
        return field(metadata=metadata)
    return field(default=default, metadata=metadata)


def declaration_of(of: Field[Any]) -> Declaration | None:
    """Return what `parameter` declared at a dataclass field; None for any other field."""
    return of.metadata.get(_KEY)


_declarations: dict[type, Mapping[str, Declaration]] = {}


def describe_parameters(kind: type) -> Mapping[str, Declaration]:
    """Return the declarations of a dataclass by name, in the order of its fields.

    Undeclared fields are left out.
    """
    if kind not in _declarations:
        declared = [f for f in fields(kind) if _KEY in f.metadata]
        by_name = {f.name: replace(f.metadata[_KEY], name=f.name) for f in declared}
        _declarations[kind] = MappingProxyType(by_name)
    return _declarations[kind]


def check_parameters(owner: object) -> None:
    """Check all declared numbers of a dataclass instance against their ranges.

    Raises:
        ParameterError: a number lies outside its range, or is not a number; the message names the
            parameter and the range.
    """
    for name, d in describe_parameters(type(owner)).items():
        d.check(f"{type(owner).__name__}.{name}", getattr(owner, name))


def require_in_range(
    owner: object, name: str, low: float, high: float = math.inf, *, open_low: bool = False
) -> None:
    """Check that a field of a dataclass instance lies within `low` and `high`.

    `low` itself is forbidden if `open_low`. It is for ranges that depend on other numbers or are
    not declared at the field.

    Raises:
        ParameterError: the number lies outside the range, or is not a number; the message names the
            parameter and the range.
    """
    _require_in_bounds(f"{type(owner).__name__}.{name}", getattr(owner, name), low, high, open_low)


_LEAST = math.sqrt(sys.float_info.min)
"""Number above which those lie that must be positive: the square of a lesser one has few digits
left, or none, and is divided by."""


def _require_in_bounds(name: str, value: float, low: float, high: float, open_low: bool) -> None:
    if open_low and low == 0.0:
        low = _LEAST
    too_low = value <= low if open_low else value < low
    if math.isnan(value) or value > high or too_low:
        bracket = "(" if open_low else "["
        raise ParameterError(f"{name} = {value} lies outside {bracket}{low}, {high}]")


MOST_SEED = 2**63 - 1
"""Greatest seed: generators take greater ones, but the files that a seed is recorded in hold 64
bits."""


def require_one_of(name: str, known: Collection[str], trouble: str) -> None:
    """Check that a name is known.

    Raises:
        ValueError: it is not; the message begins with the `trouble`, and lists all names.
    """
    if name not in known:
        raise ValueError(f"{trouble}; there are: {', '.join(known)}")


def require_within(
    owner: object, names: Iterable[str], low: float, high: float, *, whole: bool = False
) -> None:
    """Check fields of a dataclass instance against a range.

    Each is a number, several in a tuple or a mapping, or None if it is not given.

    Raises:
        ValueError: an option is something else, not whole where it must be, or lies outside `low`
            and `high`; the message names it and the range.
    """
    kind: Any = Integral if whole else Real
    kind_text = "a whole number" if whole else "a number"
    for name in names:
        given = getattr(owner, name)
        if given is None:
            continue
        values = given.values() if isinstance(given, Mapping) else (given,)
        if isinstance(given, tuple):
            values = given
        for value in values:
            if isinstance(value, bool) or not isinstance(value, kind):
                raise ValueError(f"{name} must be {kind_text}, got {_short_text(value)}")
            if not low <= value <= high:
                bounds = f"{_short_text(low)} and {_short_text(high)}"
                raise ValueError(f"{name} must lie within {bounds}, got {_short_text(value)}")


def _short_text(value: object) -> str:
    """Return the text of a value in a message; that of a long whole number gives its size only."""
    if isinstance(value, int) and abs(value) > MOST_SEED:
        return f"one of {value.bit_length()} bits"
    return f"{value:g}" if isinstance(value, float) else reprlib.repr(value)


_name_counts = Counter[str]()


def numbers_of(kind: type) -> Any:
    """Return the named tuple type that carries declared numbers into compiled functions.

    It is kept as `kind.Numbers`, where the compiler's cache on disk finds it again; call this when
    the module is imported.
    """
    if "Numbers" not in vars(kind):
        # numba takes two named tuples of one name and the same fields for one type.
        _name_counts[kind.__name__] += 1
        name = f"{kind.__name__}{_name_counts[kind.__name__]}"
        names = list(describe_parameters(kind))
        numbers = namedtuple(name, names, module=kind.__module__)  # type: ignore[misc]
        numbers.__qualname__ = f"{kind.__qualname__}.Numbers"
        kind.Numbers = numbers  # type: ignore[attr-defined]
    return vars(kind)["Numbers"]


def pack_numbers(owner: Any) -> Any:
    """Return a dataclass instance's declared numbers for compiled functions, by their names."""
    kind = numbers_of(type(owner))
    return kind._make([float(getattr(owner, name)) for name in kind._fields])
