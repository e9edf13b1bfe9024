"""What the command line says of the ground, what it means, and the Husky on it."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssmr.scenarios import TRAJECTORIES
from ssmr.types import Commands, State
from tests.conftest import EXACT, exit_status
from validation.compare import compare
from validation.plants.profile import Profile, make_plant
from validation.simulator.physics import PhysicsSettings
from validation.simulator.terrain import FLAT, Terrain, parse_terrain
from validation.track import track

NEWTON = PhysicsSettings(solver="Newton")
"""Solver that is exact enough to tell what the ground does."""
terrains = st.one_of(
    st.just(FLAT),
    st.builds(Terrain, st.floats(0, 0.7), st.floats(-3.2, 3.2)),
)


@given(terrains)
def test_what_is_written_is_read_back(terrain: Terrain) -> None:
    assert parse_terrain(terrain.spec).gravity(9.81) == pytest.approx(
        terrain.gravity(9.81), rel=1e-10, abs=1e-10
    )
    assert terrain.words


def test_the_first_key_may_be_left_out() -> None:
    assert (
        parse_terrain("ramp:5") == parse_terrain("ramp:slope_deg=5") == Terrain(math.radians(5.0))
    )


@pytest.mark.parametrize(
    "text",
    ["hill", "ramp", "ramp:steep", "ramp:nan", "ramp:60", "ramp:5,5", "flat:1", "hill\nside"],
)
def test_mistakes_are_told(text: str) -> None:
    with pytest.raises(ValueError, match=r"^terrain '.*' is not understood: ") as reported:
        parse_terrain(text)
    assert "\n" not in str(reported.value)


def test_a_ramp_without_slope_changes_nothing(lab: Profile) -> None:
    plants = [make_plant(lab, "mujoco", parse_terrain(spec), NEWTON) for spec in ("ramp:0", "flat")]
    one, other = (
        plant.run(TRAJECTORIES["traj4"].commands(), State(), 0.05).pose[-1] for plant in plants
    )
    np.testing.assert_allclose(one, other, atol=EXACT, rtol=0.0)


def test_a_ramp_that_rises_to_the_left_mirrors_one_that_rises_to_the_right(lab: Profile) -> None:
    straight = Commands(0.05, np.tile([0.5, 0.0], (100, 1)))
    turn = Commands(0.05, np.tile([0.3, 0.4], (100, 1)))
    mirrored = Commands(0.05, np.tile([0.3, -0.4], (100, 1)))
    plants = [
        make_plant(lab, "mujoco", parse_terrain(f"ramp:slope_deg=5,toward_deg={d}"), NEWTON)
        for d in (90, -90)
    ]
    for one, other in ((straight, straight), (turn, mirrored)):
        a, b = (p.run(c, State(), 0.05).pose for p, c in zip(plants, (one, other), strict=True))
        np.testing.assert_allclose(a * [1, -1, -1], b, atol=1e-7)


def test_programs_drive_on_it(tmp_path: Path) -> None:
    commanded = (
        "traj4",
        "--plants",
        "improved",
        "--terrain",
        "ramp:3",
        "--out",
        str(tmp_path / "c"),
    )
    assert exit_status(compare, *commanded) == 0
    document = json.loads((tmp_path / "c" / "compare.json").read_text())
    assert document["options"]["terrain"] == "ramp:slope_deg=3,toward_deg=0"
    loads = document["plants"]["mujoco"]["wheel_loads"]
    assert loads["mean_N"][2] > loads["mean_N"][0]  # uphill the rear carries more
    assert "health" not in document["plants"]["mujoco"]
    commanded = (
        "lqr",
        "line",
        "--plant",
        "mujoco",
        "--terrain",
        "ramp:2",
        "--out",
        str(tmp_path / "t"),
    )
    assert exit_status(track, *commanded) == 0
    assert json.loads((tmp_path / "t" / "track.json").read_text())["options"]["terrain"].startswith(
        "ramp:slope_deg=2"
    )
