"""A Husky on tile and on wet grass: docs/tile.md and the profile husky-wet-grass."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from ssmr.metrics.paired import chance_of_difference
from ssmr.metrics.windows import WindowErrors, overlapping_windows, relative_pose_error
from ssmr.types import FloatArray, IndexArray
from tests.conftest import data_folder
from validation.experiment.runs import drive_piece
from validation.experiment.sources import Source, open_source
from validation.plants.profile import load_profile, make_plant

LOGS = {
    ground: data_folder() / ground / f"{ground}_train.csv"
    for ground in ("husky_tile", "husky_wet_grass")
}
SPLIT = {"husky_tile": 500.0, "husky_wet_grass": 182.0}
"""End of the part that the profiles come from [s]."""
HORIZON = 6.0
MOVES = 0.3
"""Wheels turn by at least this much in a window that counts [rad]."""
LATE = {"husky_tile": -0.034, "husky_wet_grass": 0.142}
"""Delay of the headings behind the wheel rates [s]; docs/tile.md, from whole logs by other
means."""


@cache
def log(ground: str, start: float | None = None) -> Source:
    if not LOGS[ground].is_file():
        pytest.skip(f"{ground}: no recording in {data_folder()}")
    return open_source(str(LOGS[ground]), "wheels", start)


def moving(source: Source) -> list[tuple[IndexArray, IndexArray, FloatArray]]:
    """Starts and ends of windows in which wheels turn, and the sides' (2, M) rotation."""
    rows = []
    for piece in source.pieces:
        assert piece.t is not None
        assert piece.reference is not None
        rates = piece.reference.wheels
        steps = np.diff(piece.t)[:, None]
        turned = np.concatenate(
            [np.zeros((1, 2)), np.cumsum(0.5 * (rates[1:] + rates[:-1]) * steps, axis=0)]
        )
        way = np.concatenate([[0.0], np.cumsum(np.abs(rates[:-1]).max(axis=1) * steps[:, 0])])
        starts, ends = piece.windows(overlapping_windows, piece.t, HORIZON)
        moves = way[ends] - way[starts] > MOVES
        rows.append((starts[moves], ends[moves], turned.T))
    return rows


def heading_per_side(ground: str) -> tuple[float, float]:
    """Mean change of heading over rotation of a side, and the share by which left exceeds right.

    Least absolute errors.
    """
    source = log(ground)
    rows = []
    turned = []
    for piece, (starts, ends, sides) in zip(source.pieces, moving(source), strict=True):
        assert piece.t is not None
        assert piece.reference is not None
        begin = piece.t[starts] - LATE[ground]
        end = piece.t[ends] - LATE[ground]
        rows.append(
            np.column_stack(
                [np.interp(end, piece.t, s) - np.interp(begin, piece.t, s) for s in sides]
            )
        )
        turned.append(piece.reference.pose[ends, 2] - piece.reference.pose[starts, 2])
    matrix = np.concatenate(rows) * np.array([-1.0, 1.0])
    wanted = np.concatenate(turned)
    x = np.array([0.15, 0.15])
    for _ in range(60):
        weight = 1.0 / np.sqrt(np.maximum(np.abs(matrix @ x - wanted), 2e-3))
        x = np.linalg.lstsq(matrix * weight[:, None], wanted * weight, rcond=None)[0]
    return float(x.mean()), float((x[0] - x[1]) / x.mean())


def heading_errors(profile: str, model: str, ground: str) -> WindowErrors:
    """Errors of a profile's plant in the part of a log that the profile does not come from."""
    source = log(ground, SPLIT[ground])
    loaded = load_profile(profile)
    plant = make_plant(loaded, model)
    rows = []
    for piece, (starts, ends, _) in zip(source.pieces, moving(source), strict=True):
        assert piece.reference is not None
        motion = drive_piece(plant, piece, loaded.plants[model].localiser, source.sample_dt)
        rows.append(relative_pose_error(motion.pose, piece.reference.pose, starts, ends)[1])
    yaw = np.concatenate(rows)
    return WindowErrors(HORIZON, np.zeros(len(yaw)), np.abs(yaw))


def test_the_robot_turns_alike_on_both_grounds_but_its_tyres_differ() -> None:
    (tile, tile_sides), (grass, grass_sides) = (
        heading_per_side("husky_tile"),
        heading_per_side("husky_wet_grass"),
    )
    # the same within two standard errors of the grass
    assert grass / tile == pytest.approx(1.0, abs=0.022)
    assert tile == pytest.approx(0.157, abs=0.002)
    radius = load_profile("husky-tile").plants["mujoco"].parameters.wheel_radius
    # two standard errors of the whole log
    assert radius * tile_sides == pytest.approx(0.0087, abs=0.0012)
    assert radius * (tile_sides - grass_sides) > 0.0047  # 6.9 +- 0.9 mm


@pytest.mark.parametrize("model", ["kinematic", "linear"])
def test_each_profile_is_better_on_its_own_ground(model: str) -> None:
    for ground, own, other in (
        ("husky_tile", "husky-tile", "husky-wet-grass"),
        ("husky_wet_grass", "husky-wet-grass", "husky-tile"),
    ):
        good = heading_errors(own, model, ground)
        bad = heading_errors(other, model, ground)
        assert (
            chance_of_difference(good.yaw, bad.yaw, np.arange(float(len(good.yaw))), 6.0) < 0.05
        ), ground
        assert np.median(good.yaw) < 0.65 * np.median(bad.yaw), ground
