"""A robot's file.

An error is one line that names section and key, and a good file comes back.
"""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings

from tests.robots import documents
from validation import load_robot
from validation.plants.profile import bare_profile, load_profile
from validation.simulator.calibration import Calibration
from validation.simulator.description import GRADES, SCHEMA, WHEEL_FILL, parse_robot, shipped_robots
from validation.simulator.model import robot_model

RIGHT: dict[str, Any] = {
    "schema": SCHEMA,
    "name": "mine",
    "geometry": {"wheelbase": 0.5, "track": 0.6, "wheel_radius": 0.15, "wheel_width": 0.1},
    "mass": {"total": 50.0},
}
"""The least that a file must say."""


def changed(**sections: Any) -> dict[str, Any]:
    """The right file with some of it changed: keys of a section, or a whole entry."""
    document = copy.deepcopy(RIGHT)
    for name, value in sections.items():
        if isinstance(value, dict):
            document.setdefault(name, {}).update(value)
        else:
            document[name] = value
    return document


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"schema": "ssmr.robot/9"}, r"schema is 'ssmr.robot/9', wanted 'ssmr.robot/1'"),
        ({"name": "my robot"}, r"name is 'my robot', wanted letters, digits"),
        ({"name": 3}, r"name is 3, wanted a text"),
        ({"description": "x" * 3000}, r"wanted a text of at most 2000 characters"),
        ({"colour": "red"}, r"the top level has unknown keys colour; there are: .*geometry"),
        (
            {"geometry": {"wheel_base": 0.5}},
            r"geometry has unknown keys wheel_base; there are: .*wheelbase",
        ),
        ({"geometry": [1, 2]}, r"geometry is \[1, 2\], wanted a table"),
        ({"mass": {"total": "50 kg"}}, r"mass.total is '50 kg', wanted a number \[kg\]"),
        ({"mass": {"total": True}}, r"mass.total is True, wanted a number \[kg\]"),
        ({"mass": {"total": math.nan}}, r"mass.total is nan, wanted a number \[kg\]"),
        ({"mass": {"total": math.inf}}, r"\[mass\] .*total = inf lies outside"),
        ({"mass": {"com": [0.0, 0.0]}}, r"mass.com is \[0.0, 0.0\], wanted 3 numbers"),
        (
            {"mass": {"com": [0.0, "left", 0.0]}},
            r"mass.com is \[0.0, 'left', 0.0\], wanted 3 numbers",
        ),
        (
            {"mass": {"com": [0.0, math.nan, 0.0]}},
            r"mass.com is \[0.0, nan, 0.0\], wanted 3 numbers",
        ),
        (
            {"mass": {"com": [0.0, math.inf, 0.0]}},
            r"com is \(0.0, inf, 0.0\), must be numbers from -20 to 1e\+06",
        ),
        (
            {"mass": {"inertia": [1.0, -1.0, 2.0]}},
            r"inertia is .*-1.0.*, must be numbers from 0 to",
        ),
        ({"mass": {"wheel": 13.0}}, r"four wheels of 13 kg leave nothing of 50 kg for the base"),
        ({"geometry": {"wheel_radius": -0.1}}, r"wheel_radius = -0.1 lies outside"),
        ({"geometry": {"body_size": [1.0, -0.1, 0.2]}}, r"body_size is .*-0.1"),
        ({"geometry": {"link": "chain"}}, r"link is 'chain', must be one of: belt, none"),
        ({"geometry": {"link": 2}}, r"geometry.link is 2, wanted a text"),
        (
            {"simulation": {"wheel_shape": "ball"}},
            r"wheel_shape is 'ball', must be one of: ellipsoid",
        ),
        ({"simulation": {"timestep": -1.0}}, r"timestep = -1.0 lies outside"),
        ({"drive": {"torque_limit": -1.0}}, r"\[drive\] .*torque_limit = -1.0 lies outside"),
        ({"vehicle": {"x_icr": 5.0}}, r"\[vehicle\] .*x_icr = 5.0 lies outside"),
        (
            {"sources": {"geometry": "guessed: by eye"}},
            r"sources.geometry is 'guessed: by eye', wanted 'GRADE: source'",
        ),
        (
            {"sources": {"geometry": 3}},
            r"sources.geometry is 3, wanted 'GRADE: source', with GRADE of measured, ",
        ),
        (
            {"sources": {"geometry.colour": "assumed: red"}},
            r"sources has unknown keys geometry.colour; there are:",
        ),
    ],
)
def test_what_is_wrong_is_said_with_its_section_and_key(
    wrong: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message) as failed:
        parse_robot(changed(**wrong))
    assert "\n" not in str(failed.value)


@pytest.mark.parametrize(
    "key", ["geometry.wheelbase", "geometry.track", "geometry.wheel_radius", "mass.total"]
)
def test_what_must_be_said_is_named(key: str) -> None:
    document = copy.deepcopy(RIGHT)
    section, _, name = key.partition(".")
    del document[section][name]
    with pytest.raises(ValueError, match=rf"{key} is missing; wanted a number \["):
        parse_robot(document)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            {"geometry": {"wheel_radius": 0.25}},
            r"front and rear tyres touch: .* it must be less than 0.25",
        ),
        (
            {"geometry": {"wheel_width": 0.6}},
            r"left and right tyres touch: .* it must be more than 0.3",
        ),
        ({"simulation": {"timestep": 1e-9}}, r"timestep = 1e-09 lies outside"),
        ({"mass": {"inertia": [1.0, 1.0, 5.0]}}, r"mass.inertia .*no rigid body"),
        ({"mass": {"wheel_inertia": [0.01, 0.05]}}, r"mass.wheel_inertia .*no rigid body"),
    ],
)
def test_a_robot_that_cannot_be_is_not_built(wrong: dict[str, Any], message: str) -> None:
    """Its file can be read, so that a program can show what is wrong with it."""
    robot = parse_robot(changed(**wrong))
    with pytest.raises(ValueError, match=message) as failed:
        robot_model(Calibration.of(robot))
    assert "\n" not in str(failed.value)


def test_what_a_file_leaves_out_is_estimated_and_graded_as_assumed() -> None:
    robot = parse_robot(changed(sources={"mass": "measured: bathroom scales"}))
    assert robot.source("mass.total") == ("measured", "bathroom scales")
    assert robot.source("mass.inertia")[0] == "assumed"
    assert robot.source("geometry.track") == ("assumed", "no source is given")
    disc = robot.wheel_mass * robot.wheel_radius**2
    assert robot.wheel_inertia[1] == pytest.approx(WHEEL_FILL * disc / 2.0)
    assert robot.wheel_inertia[0] == pytest.approx(
        WHEEL_FILL * (disc / 4.0 + robot.wheel_mass * robot.wheel_width**2 / 12.0)
    )
    assert 2.0 * max(robot.inertia) < sum(robot.inertia)
    robot_model(Calibration.of(robot))


@pytest.mark.parametrize("name", shipped_robots())
def test_a_shipped_robot_says_where_its_numbers_are_from(name: str) -> None:
    robot = load_robot(name)
    for key in robot.given:
        grade, where = robot.source(key)
        assert grade in GRADES, key
        assert where not in ("", "no source is given"), key
    assert parse_robot(robot.as_document()) == robot


@settings(max_examples=40, derandomize=True, deadline=None)
@given(documents())
def test_any_robot_comes_back_from_what_it_says(document: dict[str, Any]) -> None:
    robot = parse_robot(document)
    assert robot.as_document() == document
    assert parse_robot(robot.as_document()) == robot


@settings(max_examples=8, derandomize=True, deadline=None)
@given(documents())
def test_a_profile_keeps_its_robot(
    tmp_path_factory: pytest.TempPathFactory, document: dict[str, Any]
) -> None:
    """A profile of a robot that is not shipped carries the robot's file in it."""
    robot = parse_robot(document)
    path = tmp_path_factory.mktemp("profile") / "mine.toml"
    bare_profile(robot).save(path)
    again = load_profile(path)
    assert again.robot == robot
    one, other = (robot_model(Calibration.of(r)) for r in (robot, again.robot))
    assert np.array_equal(one.geom_size, other.geom_size)
    assert np.array_equal(one.body_inertia, other.body_inertia)
