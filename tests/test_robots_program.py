"""`list`, `check` and `new`: what they find out, what they say, and what they write."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from validation import cli, load_robot
from validation.robots import PROGRAM, check_robot
from validation.simulator.calibration import Calibration
from validation.simulator.checking import load_shares, spot_turn, turning_torque
from validation.simulator.description import Robot, parse_robot
from validation.simulator.plant import MujocoPlant
from validation.simulator.turning import spin_on_spot

SHIPPED = ("husky", "jackal", "warthog", "pioneer3at")
KEYS = {
    "schema",
    "name",
    "mass_kg",
    "wheelbase_m",
    "track_m",
    "wheel_radius_m",
    "turning_multiplier",
    "closed_form",
    "yaw_ripple",
    "static_loads_N",
    "apparent_mass_kg",
    "ok",
    "advice",
}
"""Of robot.json, as the contract has them."""


def changed(name: str = "warthog", **sections: Mapping[str, Any]) -> Robot:
    """Return a shipped robot with some numbers of its file changed."""
    document = load_robot(name).as_document()
    for section, numbers in sections.items():
        document[section] = {**document.get(section, {}), **numbers}
    return parse_robot({**document, "name": "changed"})


def run(*arguments: str) -> None:
    cli.run_command(PROGRAM, "robots", arguments)


# ------------------------------------------------------------------------------------------- check
@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_robot_is_without_a_fault(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run("check", name, "--out", str(tmp_path))
    document = json.loads((tmp_path / "robot.json").read_text())
    assert set(document) >= KEYS
    assert document["schema"] == "ssmr.robot/1"
    assert document["ok"] is True
    assert document["faults"] == 0
    assert document["turning_multiplier"] == pytest.approx(document["closed_form"], rel=0.02)
    assert document["yaw_ripple"] < 0.01
    weight = 9.81 * document["mass_kg"]
    assert sum(document["static_loads_N"]) == pytest.approx(weight, rel=0.01)
    robot = load_robot(name)
    np.testing.assert_allclose(document["static_loads_N"], load_shares(robot) * weight, rtol=0.01)
    turning = robot.wheel_inertia[1] + robot.armature
    apparent = robot.mass + 4.0 * turning / robot.wheel_radius**2
    assert document["apparent_mass_kg"] == pytest.approx(apparent, rel=0.01)
    assert (tmp_path / "robot.png").read_bytes().startswith(b"\x89PNG")
    message = capsys.readouterr().out
    assert all(key in message for key in document["numbers"])


@pytest.mark.parametrize("shape", ["ellipsoid", "capsule"])
@pytest.mark.parametrize("com", [(0.0, 0.0), (0.15, 0.1), (-0.3, 0.0)])
def test_the_simulated_robot_needs_the_torque_that_mechanics_says(
    com: tuple[float, float], shape: str
) -> None:
    """Also where the rear wheels carry so much that they roll and only the front ones skid."""
    robot = changed(
        mass={"com": [*com, 0.1]},
        drive={"torque_limit": 1000.0, "command_half_track": 0.56821},
        simulation={"wheel_shape": shape},
    )
    spot = spot_turn(robot)
    assert spot is not None
    motion = spin_on_spot(MujocoPlant(Calibration.of(robot), robot.drive), 20.0, 0.4)
    torque = np.abs(motion.channels["torque_N_m"][motion.t > 8.0]).mean(axis=0)
    np.testing.assert_allclose(torque, robot.friction * turning_torque(robot, spot), rtol=0.03)


FAULTS: dict[str, tuple[Mapping[str, Mapping[str, Any]], str, str]] = {
    "front and rear tyres": (
        {"geometry": {"wheel_radius": 0.46}},
        "front and rear tyres touch",
        "less than 0.457",
    ),
    "left and right tyres": (
        {"geometry": {"wheel_width": 1.2}},
        "left and right tyres touch",
        "more than 0.6",
    ),
    "hull in the ground": (
        {"geometry": {"body_centre": [0.0, 0.0, -0.2]}},
        "below the ground",
        "axle_height or",
    ),
    "inertia of no body": (
        {"mass": {"inertia": [10.0, 10.0, 60.0]}},
        "10, 10, 60 kg m2 is the inertia of no body, and the body",
        "the two others together",
    ),
    "centre of mass outside": (
        {"mass": {"com": [0.0, 0.0, 2.0]}},
        "lies outside of the robot: z is 2 m",
        "from -0.288 to",
    ),
    "inertia about the axle": (
        {"mass": {"wheel_inertia": [1.0, 1.5]}},
        "1.5, 1 kg m2 is the inertia of no body, and a wheel",
        "mass and size allow 1.35 at most",
    ),
    "swapped inertia": (
        {"mass": {"wheel_inertia": [0.3, 0.7]}},
        "0.3, 0.7, 0.3 kg m2 is the inertia of no body, and a wheel",
        "the two others together",
    ),
    "loads": (
        {"mass": {"com": [0.6, 0.0, 0.1]}},
        "wheel carries nothing",
        "must add up to less than 1, not 1.03",
    ),
    "torque": (
        {"drive": {"torque_limit": 80.0}},
        "cannot turn on the spot on ground",
        "at least 89.15 N m",
    ),
    "soft servos": (
        {"simulation": {"gain": 5.0}},
        "rate of a wheel in a slow turn",
        "raise simulation.gain",
    ),
    "step": (
        {"drive": {"hold": 0.0213}},
        "no model can be built of it: the drive's hold",
        "physics steps of 0.002 s",
    ),
}
"""What is changed, and parts of the sentence that say what is wrong and what would be right."""


@pytest.mark.parametrize("com", [(0.0, 0.36), (0.0, 0.5), (0.2, 0.3), (-0.1, -0.44)])
def test_a_weight_off_the_middle_is_blamed_on_nothing_else(com: tuple[float, float]) -> None:
    """Where it barely turns, a little more or less load decides how much."""
    check = check_robot(changed(mass={"com": [*com, 0.1]}))
    assert {finding.kind for finding in check.findings if finding.severity == "fault"} == {
        "weight_off"
    }


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_told_with_what_would_be_right(name: str) -> None:
    sections, wrong, right = FAULTS[name]
    check = check_robot(changed(**sections))
    assert not check.ok
    (sentence,) = [text for text in check.faults if wrong in text]
    assert right in sentence
    assert "\n" not in sentence
    document = json.loads(json.dumps(check.as_dict(), allow_nan=False))
    assert document["ok"] is False
    assert sentence in document["advice"]
    assert document["faults"] == len(check.faults)
    assert len(document["static_loads_N"]) == 4


HINTS: dict[str, tuple[Mapping[str, Mapping[str, Any]], str]] = {
    "no limit of torque": ({"drive": {"torque_limit": math.inf}}, "no torque_limit is given"),
    "driver": ({"drive": {"command_half_track": 0.3}}, "of the commanded yaw rate"),
    "endless torque": (
        {"drive": {"torque_limit": 1e308}},
        "is it that of a wheel, behind the gear, in N m?",
    ),
    "an antenna": (
        {"geometry": {"body_size": [0.02, 0.02, 0.4]}},
        "smaller than a wheel: is it an antenna",
    ),
    "a guessed radius": (
        {"sources": {"geometry.wheel_radius": "assumed: by eye"}},
        "wheel_radius is a guess: count",
    ),
    "grams": (
        {
            "mass": {"total": 7_000.0},
            "drive": {"torque_limit": 1e5},
            "simulation": {"gain": 1e5},
        },
        "kg a cubic metre of its hull",
    ),
    "a guessed mass": (
        {"sources": {"mass.total": "assumed: by eye"}},
        "mass.total is a guess: weigh",
    ),
}


@pytest.mark.parametrize("name", HINTS)
def test_a_hint_is_no_fault(name: str) -> None:
    sections, words = HINTS[name]
    check = check_robot(changed(**sections))
    assert any(words in text for text in check.document()["advice"]), check.document()["advice"]
    assert check.ok
    assert not any("nothing is wrong" in sentence for sentence in check.notes())


def test_nothing_is_wrong_only_where_nothing_was_guessed() -> None:
    """A wheel mass of 0 stands for an estimate, and is one."""
    document = load_robot("warthog").as_document()
    document["sources"] = {
        section: "measured: on a bench" for section in ("geometry", "mass", "drive", "simulation")
    }
    document |= {
        "name": "known",
        "geometry": {**document["geometry"], "body_size": [1.4, 0.8, 0.3]},
    }
    document["simulation"] |= {"gain": 200.0, "armature": 1.0}
    assert check_robot(parse_robot(document)).notes()[0] == "known: nothing is wrong with it"
    guessed = check_robot(parse_robot({**document, "mass": {**document["mass"], "wheel": 0.0}}))
    assert guessed.ok
    assert guessed.notes()[0].endswith("nobody has measured or published mass.wheel")
    assert guessed.as_dict()["guessed"] == ["mass.wheel"]


def test_a_fault_is_a_failed_run_whose_files_are_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = changed(geometry={"wheel_width": 1.2})
    (tmp_path / "wide.toml").write_text(tomli_w.dumps(robot.as_document()))
    with pytest.raises(SystemExit) as left:
        run("check", str(tmp_path / "wide.toml"), "--out", str(tmp_path))
    assert left.value.code == 1
    assert json.loads((tmp_path / "robot.json").read_text())["ok"] is False
    assert "tyres touch" in capsys.readouterr().out


# ------------------------------------------------------------------------------------------- new,
# and the command line
def test_a_new_robot_has_what_was_measured_and_says_the_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    numbers = "--wheelbase 0.5 --track 0.6 --wheel-radius 0.15 --wheel-width 0.1 --mass 60"
    run("new", "mine", *numbers.split())
    message = capsys.readouterr().out
    assert "next: python -m validation.robots check mine.toml" in message
    assert "weigh each of the four wheels" in message
    text = Path("mine.toml").read_text()
    document = tomllib.loads(text)
    assert document["geometry"]["wheelbase"] == 0.5
    assert "com" not in document["mass"]
    robot = load_robot("mine.toml")
    assert robot.source("mass.total") == ("measured", "given to `new`")
    assert robot.source("mass.com")[0] == "assumed"
    run("check", "mine.toml")
    assert json.loads(Path("runs/robots/mine/robot.json").read_text())["ok"] is True
    run("new", "mine", *numbers.split())  # the same file again loses nothing
    with pytest.raises(SystemExit) as left:
        run("new", "mine", *numbers.replace("60", "61").split())
    assert left.value.code == cli.EXIT_USER_ERROR
    assert Path("mine.toml").read_text() == text
