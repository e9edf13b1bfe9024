"""Every program runs with a robot that is no Husky: a shipped one, and a stranger's file."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from ssmr.scenarios import TRAJECTORIES
from ssmr.types import State
from tests.conftest import EXACT, exit_status
from validation import load_profile, load_robot
from validation.compare import compare
from validation.files.csv_logs import write_csv
from validation.fit import fit
from validation.plants.profile import PLANTS, bare_profile, choose_profile, make_plant
from validation.plants.searchable import find_number
from validation.plants.table import plant_kind
from validation.simulator.checking import spot_turn
from validation.simulator.description import Robot
from validation.track import track
from validation.tune import tune


def stranger(folder: Path, seed: int = 5) -> Path:
    """Return the file of a random robot of 8 to 800 kg, with the shape that its mass asks for."""
    rng = np.random.default_rng(seed)
    mass = math.exp(rng.uniform(math.log(8.0), math.log(800.0)))
    radius = float(np.clip(0.035 * mass ** (1.0 / 3.0) * rng.uniform(0.8, 1.2), 0.05, 0.35))
    track_width = radius * rng.uniform(3.0, 4.5)
    wheelbase = max(track_width * rng.uniform(0.5, 1.6), 2.2 * radius)
    geometry = {
        "wheelbase": wheelbase,
        "track": track_width,
        "wheel_radius": radius,
        "wheel_width": 0.5 * radius,
    }
    document = {
        "schema": "ssmr.robot/1",
        "name": "stranger",
        "geometry": {name: round(value, 4) for name, value in geometry.items()},
        "mass": {"total": round(mass, 2), "com": [round(0.1 * wheelbase, 4), 0.0, 0.0]},
        "drive": {"v_max": 1.5, "w_max": 2.0, "acceleration_v": 2.0, "acceleration_w": 4.0},
    }
    path = folder / "stranger.toml"
    path.write_text(tomli_w.dumps(document), encoding="utf-8")
    return path


@pytest.fixture(scope="module", params=["jackal", "stranger"])
def robot(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The name of a shipped robot, then the path of a file."""
    name: str = request.param
    return name if name == "jackal" else str(stranger(tmp_path_factory.mktemp("robots")))


# -------------------------------------------------------------------------------------------------
# the programs


def run(program: Any, name: str, out: Path, *arguments: str) -> dict[str, Any]:
    """Run a program in this process for a robot; return its document, which names the robot."""
    assert exit_status(program, *arguments, "--robot", name, "--out", str(out)) == 0
    (path,) = (
        path
        for path in out.glob("*.json")
        if path.stem in ("compare", "track", "tune", "fit", "study")
    )
    document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    assert document["robot"] == load_robot(name).name
    return document


def test_compare(robot: str, tmp_path: Path) -> None:
    document = run(compare, robot, tmp_path, "traj4", "--no-rerun")
    for name, plant in document["plants"].items():
        # of 10 m of path; without the slip of turns it is more than a metre
        assert plant["d_rms_m"] < 0.6, name
    assert document["plants"]["mujoco"]["health"]["ok"]
    assert document["parameters"]["mujoco"]["parameters"]["mass"] == load_robot(robot).mass


def test_track(robot: str, tmp_path: Path) -> None:
    document = run(
        track,
        robot,
        tmp_path,
        "lqr-scheduled",
        "circle",
        "--plant",
        "improved,mujoco",
        "--no-rerun",
    )
    assert document["metrics"]["d_rms_m"] < 0.15
    assert document["beside"]["mujoco"]["d_rms_m"] < 0.15


def test_fit_of_a_planar_model(tmp_path: Path) -> None:
    """The fitted profile keeps its robot, also one that no other machine knows."""
    robot = str(stranger(tmp_path))
    short = ["--population", "16", "--generations", "8", "--guess", "profile", "--seed", "1"]
    document = run(fit, robot, tmp_path / "out", "improved", "--to", "traj4@mujoco", *short)
    before = (
        compare("traj4", plants=("improved",), reference="mujoco", robot=robot)
        .scores["improved"]
        .metrics["d_rms_m"]
    )
    assert document["train"]["d_rms_m"] < 0.7 * before
    fitted = load_profile(str(tmp_path / "out" / "profile.toml"))
    assert fitted.robot == load_robot(robot)
    again = compare("traj4", fitted, plants=("improved",), reference="mujoco")
    assert again.scores["improved"].metrics["d_rms_m"] == pytest.approx(
        document["train"]["d_rms_m"], rel=1e-9
    )
    assert again.profile.robot == load_robot(robot)


def test_recordings(robot: str, tmp_path: Path) -> None:
    """A comparison takes the log of a drive of this robot."""
    log = tmp_path / "log.csv"
    commands = TRAJECTORIES["traj4"].commands()
    motion = make_plant(choose_profile(None, robot, "thesis-lab"), "mujoco").run(
        commands, State(), commands.dt
    )
    given = np.vstack([commands.values, commands.values[-1:]])
    names = ("t", "x", "y", "yaw", "enc_left", "enc_right", "cmd_v", "cmd_w")
    columns = np.column_stack([motion.t, motion.pose, motion.wheels, given])
    write_csv(dict(zip(names, columns.T, strict=True)), log)
    document = run(compare, robot, tmp_path / "out", str(log), "--no-rerun")
    errors = {
        name: plant["horizons"]["6"]["position_median_m"]
        for name, plant in document["plants"].items()
    }
    assert errors["mujoco"] < min(
        0.1, *(error for name, error in errors.items() if name != "mujoco")
    )


# -------------------------------------------------------------------------------------------------
# doors


def test_every_door_takes_a_robot_in_every_form(robot: str) -> None:
    loaded = load_robot(robot)
    small: dict[str, Any] = {"population": 5, "generations": 1}
    doors: list[Callable[[str | Path | Robot], Any]] = [
        lambda r: compare("traj1", plants=("kinematic",), reference="kinematic", robot=r),
        lambda r: track("pid", "line", "kinematic", robot=r, speed=0.5),
        lambda r: fit("kinematic", "traj1@linear", robot=r, free=("y_l",), **small),
    ]
    for door in doors:
        assert door(robot).profile.robot == door(loaded).profile.robot == loaded
    if Path(robot).exists():
        assert doors[0](Path(robot)).profile.robot == loaded
    assert (
        tune(
            "lqr", "line@0.5", robot=loaded, held_out=(), free=("q_x",), **small
        ).problem.profile.robot.name
        == loaded.name
    )


def test_a_profile_of_another_robot_is_refused(robot: str) -> None:
    with pytest.raises(match="of the robot husky, not of"):
        choose_profile("husky-tile", robot, "thesis-lab")
    assert choose_profile(None, "husky", "thesis-lab").name == "thesis-lab"
    assert choose_profile(None, robot, "thesis-lab").robot == load_robot(robot)


# -------------------------------------------------------------------------------------------------
# numbers


@pytest.mark.parametrize("name", ["husky", "jackal", "warthog", "pioneer3at"])
@pytest.mark.parametrize("plant", PLANTS)
def test_a_robots_own_numbers_lie_within_its_bounds(name: str, plant: str) -> None:
    """So that a fit can begin with them.

    A driver's limit that is off, or that no tyre can follow, counts as the upper bound.
    """
    profile = bare_profile(load_robot(name)).plants[plant]
    for free in ("scenario", "commands", "wheels"):
        for number in plant_kind(plant).free[free]:
            s = find_number(plant, number, profile.robot)
            value = s.read(profile)
            if math.isinf(value) or number.startswith("acceleration"):
                value = min(value, s.upper)
            assert s.lower <= value <= s.upper, number


@pytest.mark.parametrize("name", ["jackal", "warthog", "pioneer3at"])
def test_planar_models_scale_with_the_robot(name: str) -> None:
    """Speed loops of robots of all sizes are equally fast, and turns slip by dry friction."""
    robot = load_robot(name)
    thesis = load_robot("husky")

    def rates(of: Robot) -> list[float]:
        plants = bare_profile(of).plants
        v = of.vehicle
        improved = plants["improved"].parameters.gain / (v.mass * v.wheel_radius**2)
        return [improved, plants["linear"].parameters.gain / (v.mass * v.wheel_radius)]

    assert rates(robot) == pytest.approx(rates(thesis), rel=1e-12)
    kinematic = bare_profile(robot).plants["kinematic"].parameters
    turn = spot_turn(robot)
    assert turn is not None
    # 2 over the yaw rate at rims of 1 m/s; by hand for one contact a tyre, and the weight between
    assert kinematic.y_l - kinematic.y_r == pytest.approx(2.0 / turn.yaw_rate)
    if robot.com[0] == 0.0 and robot.wheel_shape == "ellipsoid":
        by_hand = robot.track * (1.0 + (robot.wheelbase / robot.track) ** 2)
        assert kinematic.y_l - kinematic.y_r == pytest.approx(by_hand)
    assert abs(bare_profile(thesis).plants["kinematic"].parameters.y_l - 0.275) <= EXACT
