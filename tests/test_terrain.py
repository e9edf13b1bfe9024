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
from tests.robots import TRACK, WHEELBASE, husky
from validation.compare import compare
from validation.plants.profile import Profile, make_plant
from validation.simulator.model import robot_model
from validation.simulator.physics import PhysicsSettings
from validation.simulator.terrain import FLAT, Terrain, parse_terrain
from validation.track import track

SAMPLED = 0.06
"""Relative: statistics of 16 000 correlation areas, of which slopes are rarer than heights."""
NEWTON = PhysicsSettings(solver="Newton")
"""Solver that is exact enough to tell what the ground does."""
ROUNDED = 1e-9
"""Rough ground of no height against a plane [m]: other contact pairs, the same physics."""

terrains = st.one_of(
    st.just(FLAT),
    st.builds(lambda s, t: Terrain("ramp", slope=s, toward=t), st.floats(0, 0.7), st.floats(-3.2, 3.2)),
    st.builds(lambda h, n: Terrain("rough", height=h, seed=n), st.floats(0, 0.02), st.integers(0, 10**6)),
)


@given(terrains)
def test_what_is_written_is_read_back(terrain: Terrain) -> None:
    again = parse_terrain(terrain.spec)
    assert again.kind == terrain.kind
    for name in ("slope", "toward", "height", "length", "seed"):
        assert getattr(again, name) == pytest.approx(getattr(terrain, name), rel=1e-10, abs=1e-12)
    assert terrain.words


def test_the_first_key_may_be_left_out() -> None:
    assert parse_terrain("ramp:5") == parse_terrain("ramp:slope_deg=5") == Terrain("ramp", slope=math.radians(5.0))
    assert parse_terrain("rough:5,seed=3") == Terrain("rough", height=0.005, seed=3)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("hill", "flat, ramp:slope_deg=NUMBER"),
        ("ramp", "says too little"),
        ("ramp:steep", "not understood"),
        ("ramp:nan", "ramp:nan"),
        ("ramp:60", "outside"),
        ("ramp:5,5", "not understood"),
        ("ramp:slope_deg=5,slope_deg=6", "not understood"),
        ("flat:1", "not understood"),
        ("rough:5,seed=1.5", "not understood"),
        ("rough:5,seed=" + "9" * 180, "seed"),
        ("hill\nside", "unknown terrain 'hill side'"),
    ],
)
def test_mistakes_are_told(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        parse_terrain(text)


def test_a_wheel_needs_room_on_rough_ground() -> None:
    rough = parse_terrain("rough:60")
    rough.require_room(0.01)
    with pytest.raises(ValueError, match="as tightly as a wheel of 165 mm"):
        robot_model(husky(), rough)


def test_rough_ground_has_the_statistics_that_it_names() -> None:
    terrain = Terrain("rough", height=0.01, length=0.3, seed=4)
    heights = terrain.surface.heights
    assert heights.mean() == pytest.approx(0.0, abs=1e-12)
    assert math.sqrt(np.mean(heights**2)) == pytest.approx(0.01)
    points = np.random.default_rng(0).uniform(-20, 20, (40000, 2))
    sampled = terrain.surface.at(points)
    for axis in (1, 2):  # from the autocorrelation: slope rms = sqrt(2) height / length
        assert math.sqrt(np.mean(sampled[:, axis] ** 2)) == pytest.approx(math.sqrt(2.0) * 0.01 / 0.3, rel=SAMPLED)
    beside = terrain.height_at(points + np.array([0.3, 0.0]))
    assert np.mean(beside * sampled[:, 0]) / np.mean(sampled[:, 0] ** 2) == pytest.approx(math.exp(-1.0), abs=0.03)
    assert not np.array_equal(heights, Terrain("rough", height=0.01, seed=5).surface.heights)


def test_a_robot_lies_on_the_plane_of_its_wheels() -> None:
    terrain = Terrain("rough", height=0.005, length=5.0, seed=1)  # so long that it is nearly a plane under a robot
    pose = np.array([[1.0, 2.0, 0.7]])
    height, roll, pitch = terrain.lie(pose, WHEELBASE, TRACK)[0]
    h, gx, gy = terrain.surface.at(pose[:, :2])[0]
    ahead, aside = gx * math.cos(0.7) + gy * math.sin(0.7), gy * math.cos(0.7) - gx * math.sin(0.7)
    assert height == pytest.approx(h, abs=1e-4)
    assert pitch == pytest.approx(-ahead, rel=0.05, abs=1e-5)
    assert roll == pytest.approx(aside, rel=0.05, abs=1e-5)


def end_on(lab: Profile, spec: str, name: str = "traj4") -> np.ndarray:
    plant = make_plant(lab, "mujoco", parse_terrain(spec), NEWTON)
    return np.array(plant.run(TRAJECTORIES[name].commands(), State(), 0.05).pose[-1])


@pytest.mark.parametrize(("spec", "tolerance"), [("ramp:0", EXACT), ("rough:0", ROUNDED)])
def test_terrains_of_no_effect_change_nothing(lab: Profile, spec: str, tolerance: float) -> None:
    np.testing.assert_allclose(end_on(lab, spec), end_on(lab, "flat"), atol=tolerance, rtol=0.0)


def test_a_ramp_that_rises_to_the_left_mirrors_one_that_rises_to_the_right(lab: Profile) -> None:
    straight = Commands(0.05, np.tile([0.5, 0.0], (100, 1)))
    turn = Commands(0.05, np.tile([0.3, 0.4], (100, 1)))
    mirrored = Commands(0.05, np.tile([0.3, -0.4], (100, 1)))
    plants = [make_plant(lab, "mujoco", parse_terrain(f"ramp:slope_deg=5,toward_deg={d}"), NEWTON) for d in (90, -90)]
    for one, other in ((straight, straight), (turn, mirrored)):
        a, b = (p.run(c, State(), 0.05).pose for p, c in zip(plants, (one, other), strict=True))
        np.testing.assert_allclose(a * [1, -1, -1], b, atol=1e-7)


def test_rough_ground_lifts_the_robot_as_the_ground_lies(lab: Profile) -> None:
    terrain = Terrain("rough", height=0.01, length=2.0, seed=2)
    motion = make_plant(lab, "mujoco", terrain).run(TRAJECTORIES["traj4"].commands(), State(), 0.05)
    lies = terrain.lie(motion.pose, WHEELBASE, TRACK)
    np.testing.assert_allclose(motion.channels["height_m"], lies[:, 0], atol=2e-3)
    np.testing.assert_allclose(motion.channels["roll_pitch_rad"], lies[:, 1:], atol=8e-3)


def test_a_run_equals_its_steps_on_rough_ground(lab: Profile) -> None:
    plant = make_plant(lab, "mujoco", parse_terrain("rough:3"))
    commands = Commands(0.05, np.tile([0.4, 0.5], (40, 1)))
    whole = plant.run(commands, State(0.3, -0.2, 1.0), 0.05)
    plant.reset(State(0.3, -0.2, 1.0))
    for _ in range(commands.n):
        state = plant.step((0.4, 0.5), 0.05)
    np.testing.assert_array_equal([state.x, state.y, state.yaw], whole.pose[-1])


def test_programs_drive_on_it(tmp_path: Path) -> None:
    asked = ("traj4", "--plants", "improved", "--terrain", "ramp:3", "--out", str(tmp_path / "c"))
    assert exit_status(compare, *asked) == 0
    document = json.loads((tmp_path / "c" / "compare.json").read_text())
    assert document["options"]["terrain"] == "ramp:slope_deg=3,toward_deg=0"
    loads = document["plants"]["mujoco"]["wheel_loads"]
    assert loads["mean_N"][2] > loads["mean_N"][0]  # uphill the rear carries more
    assert "health" not in document["plants"]["mujoco"]
    asked = ("lqr", "line", "--plant", "mujoco", "--terrain", "rough:2", "--out", str(tmp_path / "t"))
    assert exit_status(track, *asked) == 0
    assert json.loads((tmp_path / "t" / "track.json").read_text())["options"]["terrain"].startswith("rough:height_mm=2")
