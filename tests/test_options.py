"""Options are checked against their annotations, whoever gives them.

A misspelt choice never runs something else.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import numpy as np
import pytest
import tyro
from typeguard import CollectionCheckStrategy, check_type

from ssmr.types import State
from tests.appendices import is_there
from validation import cli
from validation.calibrate import calibrate
from validation.cli.options import kinds_of
from validation.compare import Compare, compare
from validation.files.limits import USUAL
from validation.files.log import ReadOptions
from validation.fit import fit
from validation.plants.profile import load_profile, make_plant
from validation.plants.table import PLANTS
from validation.recordings import Info
from validation.robots import CheckRobot
from validation.simulator.terrain import parse_terrain
from validation.track import track
from validation.tune import tune

PROGRAMS = (compare, fit, calibrate, track, tune)
OPTIONS = [*(program.options for program in PROGRAMS), Info, CheckRobot]
if is_there("study"):
    from validation.study.__main__ import STUDIES, study_named

    OPTIONS += [study_named(name).options for name in STUDIES]
if is_there("ros"):
    from validation.ros.control import Control
    from validation.ros.simulation import Sim

    OPTIONS += [Control, Sim]
NEEDED = {
    "source": "traj4",
    "model": "linear",
    "to": "traj4",
    "log": "husky",
    "controller": "pid",
    "robot": "husky",
}
NEEDED |= {
    "logs": ("husky",),
    "recording": "husky",
    "reference": "circle",
    "own": None,
    "ground": "husky",
}


def made(options: Any, **changes: Any) -> Any:
    required = [f for f in fields(options) if f.default is MISSING and f.default_factory is MISSING]
    return options(**{**{f.name: NEEDED[f.name] for f in required}, **changes})


@pytest.mark.parametrize("options", OPTIONS, ids=lambda kind: kind.__name__)
def test_an_option_of_another_type_is_refused_by_its_name(options: Any) -> None:
    made(options)
    for name in kinds_of(options):
        with pytest.raises(ValueError, match=rf"\b{name}\b"):
            made(options, **{name: object()})


@pytest.mark.parametrize("options", OPTIONS, ids=lambda kind: kind.__name__)
def test_a_misspelt_choice_is_refused_with_the_choices(options: Any) -> None:
    for name, kind in kinds_of(options).items():
        if get_origin(kind) is Literal:
            with pytest.raises(ValueError, match=rf"{name} is 'lqs', wanted Literal\[.*") as caught:
                made(options, **{name: "lqs"})
            assert all(repr(choice) in str(caught.value) for choice in get_args(kind))


def test_a_text_is_what_the_command_line_makes_of_it() -> None:
    given = made(
        Compare,
        columns="yaw=heading:deg",
        limits="gap=1e4",
        terrain="ramp:5",
        plants="mujoco,linear",
        out="here",
        horizons="2,6",
    )
    assert given.columns == {"yaw": ("heading", "deg")}
    assert given.limits == USUAL.changed({"gap": 1e4})
    assert given.terrain == parse_terrain("ramp:5")
    assert (given.plants, given.out, given.horizons) == (
        ("mujoco", "linear"),
        Path("here"),
        (2.0, 6.0),
    )
    assert made(Compare, plants=["linear"], seed=np.int64(3)).plants == ("linear",)


GIVEN = (
    *("mujoco", "2,6", "0,0.5,0.5", "a=1", "a=1:2", "yaw=b:deg", "gap=1e4", "ramp:5", "profile"),
    *(Path("runs/x"), ["linear"], ("linear",), [2.0, 6.0], [0.0, 0.5, 0.5], [Path("a.csv")]),
    *({"a": 1.0}, {"a": "b"}, 3, 0.5, True, None),
)


@pytest.mark.parametrize("options", OPTIONS, ids=lambda kind: kind.__name__)
def test_an_annotation_is_as_wide_as_what_is_accepted(options: Any) -> None:
    accepted = 0
    # how logs are read is checked where it is declared
    reading = kinds_of(ReadOptions)
    for name, kind in kinds_of(options).items():
        for given in GIVEN if name not in reading else ():
            try:
                made(options, **{name: given})
            except ValueError:
                continue
            accepted += 1
            check_type(given, kind, collection_check_strategy=CollectionCheckStrategy.ALL_ITEMS)
    assert accepted > 5


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": -1}, "seed must lie within 0"),
        ({"seed": True}, "seed is True"),
        ({"workers": 0}, "workers must lie within 1"),
        ({"horizons": (6.0, 2.0)}, "horizons is 6.0,2.0, wanted positive numbers that increase"),
        ({"since": math.nan}, "since is nan, wanted a finite number"),
        ({"plants": "linear,linear"}, "a name stands twice"),
        ({"columns": "x"}, r"'x' must be NAME=COLUMN\[:UNIT\]"),
        ({"terrain": "x"}, "terrain 'x' is not understood"),
        ({"limits": {}}, "limits is {}, wanted LogLimits"),
        ({"input": "wheel"}, r"input is 'wheel', wanted Literal\['commands', 'wheels'\]"),
    ],
)
def test_what_an_option_cannot_be_is_one_line(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        made(Compare, **options)
    assert "\n" not in str(caught.value)


@dataclass(frozen=True, kw_only=True)
class OfAUser(cli.Common):
    """Options as a user's program may have them."""

    delays: tuple[float, ...] = (0.05, 0.1)
    """Delays [s]."""
    names: tuple[str, ...] | None = None
    """Names."""
    own: Callable[..., float] | str | None = None
    """A function."""


def test_a_tuple_of_any_length_is_a_list() -> None:
    def main(options: OfAUser) -> OfAUser:
        return options

    main.__annotations__["options"] = Annotated[OfAUser, tyro.conf.arg(name="")]
    words = ["--delays", "0.1,0.2", "--names", "a,b", "--own", "f.py:f"]
    for made_of in (
        cli.parse_command(main, "main", words)(),
        OfAUser(delays="0.1,0.2", names="a,b", own="f.py:f"),  # type: ignore[arg-type]
    ):
        assert (made_of.delays, made_of.names, made_of.own) == ((0.1, 0.2), ("a", "b"), "f.py:f")
    with pytest.raises(ValueError, match="positive numbers that increase"):
        OfAUser(delays=[0.2, 0.1])  # type: ignore[arg-type]


def test_no_plants_are_none() -> None:
    with pytest.raises(ValueError, match="plants is empty"):
        compare("traj4", plants=())


def test_every_options_class_is_checked() -> None:
    assert all(issubclass(options, cli.Options) for options in OPTIONS)


@pytest.mark.parametrize("value", [10**400, "1", None, math.nan])
def test_a_state_has_finite_numbers(value: Any) -> None:
    with pytest.raises(ValueError, match=r"State\.x must be a finite number, got "):
        State(x=value)


@pytest.mark.parametrize("name", PLANTS)
def test_a_plant_refuses_what_is_no_state_and_no_command(name: str) -> None:
    plant = make_plant(load_profile("thesis-lab"), name)
    with pytest.raises(ValueError, match="state is None, must be a State"):
        plant.reset(None)  # type: ignore[arg-type]
    plant.reset(State())
    for command in (("a", 0.0), (0.1,), None, (math.nan, 0.0)):
        with pytest.raises(ValueError, match=r"command is .*, must be a finite speed"):
            plant.step(command, 0.05)  # type: ignore[arg-type]
