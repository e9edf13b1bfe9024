"""A real Warthog on grass: what docs/warthog.md says of it, and of the profile warthog-grass."""

from __future__ import annotations

import runpy
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from ssmr.metrics.windows import WindowErrors
from tests.conftest import data_folder
from validation.experiment.sources import Source, open_source
from validation.plants.profile import PLANTS, load_profile

page = SimpleNamespace(
    **runpy.run_path(str(Path(__file__).resolve().parents[1] / "docs" / "make_warthog_figure.py"))
)
"""The script that prints the page's numbers."""
LOG = data_folder() / "warthog_grass" / "warthog_grass_train.csv"
PROFILE = load_profile(page.PROFILE)


@cache
def part(held_out: bool) -> Source:
    if held_out:
        return open_source("warthog", "wheels")
    if not LOG.is_file():
        pytest.skip(f"no recording of a Warthog in {data_folder()}")
    return open_source(str(LOG), "wheels", None, page.SPLIT)


def errors(plant: str, held_out: bool) -> WindowErrors:
    return page.window_errors(part(held_out), PROFILE, plant)


WANTED = [
    ("mujoco", 0.122, 0.027),
    ("kinematic", 0.122, 0.033),
    ("four_wheel", 0.11, 0.029),
]


@pytest.mark.parametrize(("plant", "position", "yaw"), WANTED)
def test_the_held_out_part_is_predicted_as_the_page_says(
    plant: str, position: float, yaw: float
) -> None:
    measured = errors(plant, held_out=True)
    assert len(measured.position) == 38
    assert np.median(measured.position) < position
    assert np.median(measured.yaw) < yaw
    kept = PROFILE.provenance[plant]["held_out"]["warthog_grass_train.csv (wheels)"]
    assert np.median(measured.position) == pytest.approx(kept["position_median_6s_m"], abs=0.002)
    assert np.median(measured.yaw) == pytest.approx(kept["yaw_median_6s_rad"], abs=0.001)


def test_a_speed_loop_with_an_integral_part_turns_the_wheels_as_slowly_as_the_robot_does() -> None:
    part(False)
    off = {}
    for plant in ("mujoco", "coulomb", "linear", "kinematic"):
        result = [page.wheel_rates(str(LOG), span, PROFILE, plant) for span in page.COMMANDED[1]]
        off[plant] = np.mean(
            [np.abs(motion.wheels - measured).mean() for _, measured, motion in result]
        )
    assert max(off["coulomb"], off["linear"]) < 0.85 * off["kinematic"]
    assert off["mujoco"] == pytest.approx(0.271, abs=0.01)


@pytest.mark.parametrize("plant", PLANTS)
def test_position_and_heading_come_from_one_localiser(plant: str) -> None:
    localiser = PROFILE.plants[plant].localiser
    assert localiser.position_late == localiser.yaw_late
    assert 0.23 < localiser.position_late < 0.27
