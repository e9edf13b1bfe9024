"""Agreement of the shipped profiles: MuJoCo, the models and a real Husky.

Limits are the thesis' own distances between model and robot, and for the real Husky what a
kinematic fit of the field reaches; they are never set by what this project happens to get.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ssmr.metrics.declared import compare_signals
from ssmr.models.four_wheel_plant import FourWheelPlant
from ssmr.robot.localiser import Localiser
from ssmr.scenarios import TRAJECTORIES as SCENARIOS
from ssmr.types import State
from tests.conftest import data_folder
from validation.compare import compare
from validation.experiment.scores import Scores
from validation.experiment.sources import open_source
from validation.plants.profile import Profile, load_profile
from validation.replicate import published
from validation.report.comparison import Comparison
from validation.simulator.plant import MujocoPlant

TRAJECTORIES = ("traj1", "traj2", "traj3", "traj4")
OWN_TABLE = {"coulomb": "3.9", "improved": "3.12", "linear": "3.15"}
"""Each model's distance from the lab's robot."""
MODELS = tuple(OWN_TABLE)
TILE = data_folder() / "husky_tile" / "husky_tile_train.csv"
HELD_OUT_FROM = 500.0
"""What no parameter of husky-tile has seen [s]."""


def limit(model: str, trajectory: str) -> float:
    return published.printed_value(OWN_TABLE[model], trajectory, "d_rms_m")


def driven(profile: Profile, source: str, reference: str, plant: str) -> Comparison:
    return compare(open_source(source), profile, (plant,), reference)


# --------------------------------------------------------------------------------------------------
# thesis-lab


@pytest.mark.parametrize("trajectory", TRAJECTORIES)
def test_mujoco_is_as_near_the_published_model_as_the_real_robot_was(
    lab: Profile, trajectory: str
) -> None:
    result = driven(lab, trajectory, "improved", "mujoco")
    assert result.scores["mujoco"].metrics["d_rms_m"] <= limit("improved", trajectory)
    health = result.runs["mujoco"].health
    assert health is not None
    assert health["ok"]


@pytest.mark.parametrize("trajectory", TRAJECTORIES)
@pytest.mark.parametrize("model", MODELS)
def test_published_models_agree_with_mujoco_unfitted(
    lab: Profile, model: str, trajectory: str
) -> None:
    """The published parameters belong to a robot that MuJoCo stands for.

    It is no nearer to them than twice the real one's distance.
    """
    scores = driven(lab, trajectory, "mujoco", model).scores[model]
    assert scores.metrics["d_rms_m"] <= 2.0 * limit(model, trajectory)


def test_a_comparison_says_at_which_points_its_paths_are_taken(lab: Profile) -> None:
    tables = compare(open_source("traj3"), lab, ("mujoco",), "improved").tables()
    assert any("All paths are those of the robot's middle" in table.caption for table in tables)
    ahead = replace(lab.section("mujoco"), localiser=Localiser(tracked_x=0.085))
    profile = replace(lab, plants={**lab.plants, "mujoco": ahead})
    tables = compare(open_source("traj3"), profile, ("mujoco",), "improved").tables()
    assert any("mujoco (85, 0) mm" in table.caption for table in tables)


LATE = 1.5e-3
TORQUE = 0.1
"""Greatest error of the heading at equal times over the yaw rate [s], and of the torques over the
motors' limit [1]: a robot on nearly rigid tyres has all of MuJoCo's dynamics but the lag of its
friction."""
OTHER_ROBOTS: Mapping[str, tuple[dict[str, float], dict[str, float]]] = {
    "none": ({}, {}),
    "five times the armature": ({"armature": 1.0}, {}),
    "23 % less inertia": ({"yaw_inertia": 0.77 * 4.42}, {}),
    "40 ms more delay": ({}, {"delay_v": 0.235, "delay_w": 0.235}),
}


@pytest.mark.parametrize("change", OTHER_ROBOTS)
def test_mujocos_dynamics_are_those_of_a_robot_on_rigid_tyres_and_of_no_other(
    lab: Profile, change: str
) -> None:
    """Trajectory 1 turns quickest. What distances between paths hardly notice must fail here."""
    commands = SCENARIOS["traj1"].commands()
    tyred = lab.plants["four_wheel"]
    section = lab.plants["mujoco"]
    rigid = replace(tyred.parameters, stiffness_x=200.0, stiffness_y=200.0)
    wanted = FourWheelPlant(rigid, tyred.drive).run(commands, State(), 0.008)
    body, drive = OTHER_ROBOTS[change]
    plant = MujocoPlant(replace(section.parameters, **body), replace(section.drive, **drive))
    motion = plant.run(commands, State(), 0.008)
    late = np.sqrt(np.mean((motion.yaw - wanted.yaw) ** 2) / np.mean(wanted.twist[:, 2] ** 2))
    torque = compare_signals([motion], [wanted])["torque_rms_N_m"] / (
        2.0 * section.drive.torque_limit
    )
    assert (late < LATE and torque < TORQUE) == (change == "none")


# --------------------------------------------------------------------------------------------------
# husky-tile


@pytest.fixture(scope="module")
def tile() -> Mapping[str, Mapping[str, Scores]]:
    """All plants on what was held out, by input."""
    if not Path(TILE).is_file():
        pytest.skip(f"no recording at {TILE}; SSMR_DATA says where recordings lie")
    profile = load_profile("husky-tile")
    rates = open_source(str(TILE), "wheels", HELD_OUT_FROM)
    commands = open_source(str(TILE), "twist", HELD_OUT_FROM)
    return {
        "wheels": compare(rates, profile, horizons=(6.0,)).scores,
        "commands": compare(commands, profile, horizons=(6.0,)).scores,
    }


@pytest.mark.parametrize(
    ("given", "position", "yaw"), [("wheels", 0.033, 0.040), ("commands", 0.045, 0.050)]
)
def test_mujoco_follows_a_real_husky(
    tile: Mapping[str, Mapping[str, Scores]], given: str, position: float, yaw: float
) -> None:
    """The aims lie above the lower end of the medians' 90 % intervals.

    No distance from them can be shown.
    """
    after = tile[given]["mujoco"].overlapping[6.0]
    assert after.position_low_m <= position
    assert after.yaw_low_rad <= yaw
    assert after.position_median_m <= 1.2 * position
    assert after.yaw_median_rad <= 1.2 * yaw


def test_a_dynamic_model_follows_a_real_husky_from_commands(
    tile: Mapping[str, Mapping[str, Scores]],
) -> None:
    assert min(tile["commands"][m].horizons[6.0].position_median_m for m in MODELS) <= 0.095
