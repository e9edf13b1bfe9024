"""Named parameters with units and bounds, and the unit cube in which an optimiser sees them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssmr.parameters import Bounds, Declaration, Scale
from ssmr.types import FloatArray

_BOUND_SHARE = 1e-3
"""A value within this share of the width of its bounds from one of them lies at the bound [1]."""


@dataclass(frozen=True)
class Parameter:
    """One number that is searched."""

    name: str
    """Name that users see."""
    unit: str
    """Unit of value and bounds; `1` for a pure number."""
    lower: float
    """Least value."""
    upper: float
    """Greatest value."""
    scale: Scale = "linear"
    """`log` where only the order of magnitude is known: equal steps in the cube are equal
    factors."""
    least: float = -math.inf
    """Least value that is possible at all."""
    greatest: float = math.inf
    """Greatest value that is possible at all."""

    places: tuple[str, ...] = ()
    """Places of the value in its owner, as `section.field`; empty where nobody owns it."""

    def read(self, owner: Any) -> float:
        """Return the value in an owner; of several places the first."""
        section, _, field = self.places[0].partition(".")
        return float(getattr(getattr(owner, section), field))

    def text(self, value: float) -> str:
        """Return a value with its unit; a pure number has none."""
        return f"{value:g}" if self.unit == "1" else f"{value:g} {self.unit}"

    def __post_init__(self) -> None:
        """Check the bounds.

        Raises:
            ValueError: they are not finite, not in order, or not positive on a logarithmic scale.
        """
        bounds = f"{self.lower:g} and {self.upper:g}"
        if not (math.isfinite(self.lower) and math.isfinite(self.upper)):
            raise ValueError(f"the bounds of {self.name}, {bounds}, must be finite")
        if not self.lower < self.upper:
            raise ValueError(
                f"the bounds of {self.name} are {bounds}: the lower must be less than the upper"
            )
        if self.scale == "log" and not self.lower > 0.0:
            bound = f"its lower bound {self.lower:g} must be positive"
            raise ValueError(f"{self.name} is searched on a logarithmic scale; {bound}")


def declared_parameter(declaration: Declaration, bounds: Bounds | None = None) -> Parameter:
    """Return a declared number as a parameter of a search, with its declared bounds or with others.

    Raises:
        ValueError: no bounds are declared or given, or they make no sense.
    """
    d = declaration
    within = bounds or d.search
    if within is None:
        raise ValueError(f"{d.name} has no bounds of a search; give some")
    return Parameter(d.name, d.unit, *within, d.scale, d.low, d.high)


class ParameterSpace:
    """A box of parameters, seen by optimisers as the unit cube."""

    def __init__(self, parameters: tuple[Parameter, ...]) -> None:
        """Keep the parameters in their order.

        Raises:
            ValueError: there is none, or two have one name.
        """
        names = [p.name for p in parameters]
        if not names or len(set(names)) != len(names):
            given = ", ".join(names) or "none"
            raise ValueError(f"a space needs parameters with names of their own, got: {given}")
        self.parameters = parameters
        self.lower = np.array([p.lower for p in parameters], dtype=np.float64)
        self.upper = np.array([p.upper for p in parameters], dtype=np.float64)
        self._log = np.array([p.scale == "log" for p in parameters])
        self._low = self._scaled(self.lower)
        self._high = self._scaled(self.upper)

    def _scaled(self, values: FloatArray) -> FloatArray:
        """Return values, or their logarithms where the scale is logarithmic."""
        positive = np.where(self._log, values, 1.0)
        return np.where(self._log, np.log(positive), values)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in order."""
        return tuple(p.name for p in self.parameters)

    def limits(self) -> list[tuple[str, float, float, str]]:
        """Return name, bounds and scale of each parameter."""
        return [(p.name, p.lower, p.upper, p.scale) for p in self.parameters]

    def __len__(self) -> int:
        """Return the number of parameters, n."""
        return len(self.parameters)

    def values(self, points: ArrayLike) -> FloatArray:
        """Return (..., n) parameter values of points of the unit cube, never outside the bounds."""
        inner = self._low + np.asarray(points, dtype=np.float64) * (self._high - self._low)
        logarithms = np.where(self._log, inner, 0.0)
        values = np.where(self._log, np.exp(logarithms), inner)
        return np.clip(values, self.lower, self.upper)

    def points(self, values: ArrayLike) -> FloatArray:
        """Return the (..., n) points of the unit cube of parameter values.

        Raises:
            ValueError: a value lies outside its bounds, or is not finite; the message names it.
        """
        array = np.asarray(values, dtype=np.float64)
        inside = (array >= self.lower) & (array <= self.upper)
        outside = ~inside.reshape(-1, len(self))
        if outside.any():
            row, k = (int(i) for i in np.argwhere(outside)[0])
            p = self.parameters[k]
            value = p.text(array.reshape(-1, len(self))[row, k])
            bounds = f"{p.lower:g} to {p.upper:g}"
            raise ValueError(f"{p.name} = {value} lies outside its bounds, {bounds}")
        shares = (self._scaled(array) - self._low) / (self._high - self._low)
        points = np.clip(shares, 0.0, 1.0)
        return points

    def slopes(self, points: ArrayLike) -> FloatArray:
        """Return (..., n) derivatives of the values by their coordinates, at points of the cube."""
        width = self._high - self._low
        return np.where(self._log, self.values(points) * width, width)

    def at_bound(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Return (..., n) whether each coordinate lies at a bound (`_BOUND_SHARE`)."""
        array = np.asarray(points, dtype=np.float64)
        return (array <= _BOUND_SHARE) | (array >= 1.0 - _BOUND_SHARE)
