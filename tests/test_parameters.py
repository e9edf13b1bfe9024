"""Declared numbers.

Every parameter set declares all of its own, within ranges that hold defaults and search bounds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.models.four_wheel import FourWheelParameters
from ssmr.models.law import PLANAR_MODELS, planar_law
from ssmr.parameters import check_parameters, describe_parameters, pack_numbers, parameter
from ssmr.robot.vehicle import Drive, Vehicle, vehicle_body
from tests.robots import HUSKY
from validation.simulator.calibration import Calibration

SETS = (
    *(planar_law(name).parameters for name in PLANAR_MODELS),
    Vehicle,
    Drive,
    FourWheelParameters,
    Calibration,
)


@dataclass(frozen=True)
class Tyre:
    """Two declared numbers."""

    grip: float = parameter(0.3, unit="1", low=0.0, high=5.0, open_low=True, search=(0.1, 1.0))
    load: float = parameter(10.0, unit="N", low=0.0)

    def __post_init__(self) -> None:
        check_parameters(self)


def test_what_is_declared_is_described() -> None:
    grip, load = describe_parameters(Tyre).values()
    assert (grip.name, grip.unit, grip.search, grip.scale) == ("grip", "1", (0.1, 1.0), "linear")
    assert (load.low, load.high, load.search) == (0.0, float("inf"), None)
    assert pack_numbers(Tyre(1, 2))._asdict() == {"grip": 1.0, "load": 2.0}


@pytest.mark.parametrize(
    "changed", [{"grip": 0.0}, {"grip": 6.0}, {"load": -1.0}, {"load": float("nan")}]
)
def test_numbers_outside_their_range_are_refused_by_name(changed: dict[str, float]) -> None:
    (name,) = changed
    with pytest.raises(ValueError, match=rf"Tyre\.{name} = .* lies outside"):
        replace(Tyre(), **changed)


@given(size=st.floats(1e-323, 1e-155))
def test_a_size_whose_square_is_no_number_to_divide_by_is_refused(size: float) -> None:
    for name, declared in describe_parameters(Vehicle).items():
        if declared.open_low:
            with pytest.raises(ValueError, match=rf"{name} = .* lies outside"):
                Vehicle(**{name: size})
    assert math.isfinite(vehicle_body(pack_numbers(Vehicle(wheel_radius=1e-150))).per_moved)


@pytest.mark.parametrize("kind", SETS)
def test_every_number_is_declared_within_its_range(kind: type) -> None:
    numbers = {f.name for f in fields(kind) if f.type == "float"}
    assert numbers == set(describe_parameters(kind))
    for declared in describe_parameters(kind).values():
        assert declared.default is None or declared.low <= declared.default <= declared.high
        bounds = declared.bounds(HUSKY.sizes)
        assert bounds is None or declared.low <= bounds[0] < bounds[1] <= declared.high
