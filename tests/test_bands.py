"""Bands of predictions.

Errors grow along a path as their causes say, and nine tenths of fresh ones lie inside.
"""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
import pytest

from ssmr.geometry import relative_pose, wrap_angle
from ssmr.metrics.bands import Band, estimated_band, interval_score
from ssmr.types import FloatArray, IndexArray

# reaches of normal errors in two dimensions and in one
NOTHING = Band(1e-9, 1e-9, 0.0, 0.0, 0.0, 2.146, 1.645)
DT = 0.1


def path(n: int, seed: int) -> FloatArray:
    """Return (n, 2) ways [m] and turns [rad] of steps.

    They go straight on, bend to both sides, turn on the spot and go backwards.
    """
    rng = np.random.default_rng(seed)
    v = np.repeat(rng.choice([0.8, 0.5, 0.0, -0.4], -(-n // 40)), 40)[:n]
    w = np.repeat(rng.choice([0.0, 0.6, -0.5, 0.3], -(-n // 25)), 25)[:n]
    return np.column_stack([v, w]) * DT


def driven(steps: FloatArray) -> FloatArray:
    """Return the (..., n + 1, 3) poses of (..., n, 2) steps."""
    start = np.zeros((*steps.shape[:-2], 1))
    yaw = np.concatenate([start, np.cumsum(steps[..., 1], axis=-1)], axis=-1)
    middle = yaw[..., :-1] + 0.5 * steps[..., 1]
    x, y = (np.cumsum(steps[..., 0] * f(middle), axis=-1) for f in (np.cos, np.sin))
    return np.stack(
        [np.concatenate([start, x], axis=-1), np.concatenate([start, y], axis=-1), yaw], axis=-1
    )


def disturbed(steps: FloatArray, band: Band, rng: np.random.Generator, n: int = 1) -> FloatArray:
    """Return (n, ..., 3) poses of robots that differ from the prediction as a band says."""
    way, turn = steps.T
    lasting = rng.standard_normal((n, 1))
    walks = rng.standard_normal((3, n, len(steps)))
    turned = turn * (1.0 + band.turn_scale * lasting)
    turned = turned + band.turn_walk * np.sqrt(np.abs(turn)) * walks[0]
    pose = driven(np.stack([np.broadcast_to(way, turned.shape), turned], axis=-1))
    pose[:, 1:, :2] += np.cumsum(
        band.way_walk * np.sqrt(np.abs(way)) * walks[1:], axis=-1
    ).transpose(1, 2, 0)
    noise = np.sqrt(0.5) * np.array([band.position_noise, band.position_noise, band.yaw_noise])
    return np.asarray(pose + noise * rng.standard_normal(pose.shape))


def errors(predicted: FloatArray, true: FloatArray, i: IndexArray, j: IndexArray) -> FloatArray:
    error = relative_pose(predicted[i], predicted[j]) - relative_pose(true[i], true[j])
    return np.column_stack([error[:, :2], wrap_angle(error[:, 2])])


@pytest.mark.parametrize(
    "cause",
    [
        {"position_noise": 0.02},
        {"yaw_noise": 0.01},
        {"way_walk": 0.03},
        {"turn_walk": 0.02},
        {"turn_scale": 0.02},
    ],
    ids=lambda cause: next(iter(cause)),
)
def test_errors_of_each_cause_grow_as_it_says(cause: dict[str, float]) -> None:
    band = replace(NOTHING, **cause)
    steps = path(200, 3)
    predicted = driven(steps)
    rng = np.random.default_rng(1)
    ends = np.array([20, 90, 200])
    starts = np.array([0, 30, 60])
    drawn = np.stack(
        [errors(predicted, true, starts, ends) for true in disturbed(steps, band, rng, 4000)]
    )
    covariance = band.covariance(predicted, starts, ends)
    _, half = band.edges(predicted, starts, ends, drawn[0])
    for k in range(len(ends)):
        scale = np.trace(covariance[k]) + 1e-12
        assert np.abs(np.cov(drawn[:, k, :2].T) - covariance[k]).max() < 0.06 * scale
        assert drawn[:, k, 2].var() == pytest.approx(
            (half[k] / band.reach_yaw) ** 2, rel=0.08, abs=1e-12
        )


def test_what_is_mirrored_is_as_sure() -> None:
    band = Band(0.01, 0.01, 0.02, 0.02, 0.01, 2.1, 1.6)
    steps = path(200, 4)
    here = band.covariance(driven(steps), [0, 50], [120, 200])
    there = band.covariance(driven(steps * [1.0, -1.0]), [0, 50], [120, 200])
    flip = np.diag([1.0, -1.0])
    assert np.allclose(flip @ there @ flip, here, rtol=1e-9)


def logs(
    band: Band, n: int, seed: int
) -> list[tuple[float, FloatArray, IndexArray, IndexArray, FloatArray]]:
    """Return windows of 2, 6 and 30 s of a log with errors of a band.

    Their lasting causes change twice a minute.
    """
    rng = np.random.default_rng(seed)
    windows = []
    for k in range(n):
        steps = path(310, 100 * seed + k)
        predicted = driven(steps)
        true = disturbed(steps, band, rng)[0]
        for seconds in (2.0, 6.0, 30.0):
            size = round(seconds / DT)
            i = np.arange(0, len(predicted) - size, 10)
            error = errors(predicted, true, i, i + size)
            windows.append((seconds, predicted, i, i + size, error))
    return windows


TRUE = replace(
    NOTHING, position_noise=0.01, yaw_noise=0.008, way_walk=0.03, turn_walk=0.02, turn_scale=0.02
)


def test_a_band_is_found_again_and_holds_more_than_nine_tenths_where_nothing_changes() -> None:
    measured = estimated_band(logs(TRUE, 60, 1))
    assert measured is not None
    for name in ("position_noise", "yaw_noise", "way_walk", "turn_walk", "turn_scale"):
        assert getattr(measured, name) == pytest.approx(getattr(TRUE, name), rel=0.3), name
    fresh = logs(TRUE, 60, 2)
    position, yaw = np.concatenate([measured.edges(*window[1:]) for window in fresh], axis=1)
    error = np.concatenate([window[4] for window in fresh])
    # nothing changes from this log to the next, and bands are for what does
    assert 0.91 < np.mean(np.hypot(error[:, 0], error[:, 1]) <= position) < 0.98
    assert 0.91 < np.mean(np.abs(error[:, 2]) <= yaw) < 0.98
    assert astuple(measured)[5:] == pytest.approx(1.2 * np.array(astuple(NOTHING)[5:]), rel=0.1)


def test_the_score_is_least_for_a_band_that_holds_nine_tenths() -> None:
    """Also where the band is no circle: its edge lies in the direction of each error."""
    steps = path(200, 5)
    predicted = driven(steps)
    i = np.zeros(4000, dtype=np.intp)
    j = i + 200
    true = disturbed(steps, TRUE, np.random.default_rng(6), 4000)
    error = np.concatenate([errors(predicted, one, i[:1], j[:1]) for one in true])
    away = np.hypot(error[:, 0], error[:, 1])
    edge, half = TRUE.edges(predicted, i, j, error)
    assert np.mean(away <= edge) == pytest.approx(0.9, abs=0.015)
    assert np.mean(np.abs(error[:, 2]) <= half) == pytest.approx(0.9, abs=0.015)
    for off, size in ((away, edge), (error[:, 2], half)):
        scores = [interval_score(off, factor * size) for factor in (0.8, 0.9, 1.0, 1.1, 1.25)]
        assert min(scores) == scores[2]
    # an interval of 0.9 around nothing, and 0.1 beyond it once in four
    assert interval_score([0.0, 0.2, -0.3, 1.0], 0.9) == pytest.approx(1.8 + 20.0 * 0.1 / 4.0)
    nowhere, _ = TRUE.edges(predicted, i[:1], j[:1], np.zeros((1, 3)))
    assert np.isfinite(nowhere).all()


def test_windows_that_are_there_twice_change_little() -> None:
    once = logs(TRUE, 20, 3)
    bands = [estimated_band(windows) for windows in (once, [*once, *once])]
    assert astuple(bands[1] or NOTHING) == pytest.approx(
        astuple(bands[0] or NOTHING), rel=0.25, abs=1e-3
    )


def test_a_window_counts_as_its_own_time_and_a_length_as_any_other() -> None:
    """Windows that begin every second share their time: ten of 30 s tell of causes as one of 3 s.

    Of the reach each length tells as much, however many windows it has.
    """
    steps = path(400, 7)
    predicted = driven(steps)
    rng = np.random.default_rng(8)
    few = np.arange(0, 310, 10)
    many = np.arange(0, 235, 5)
    bands = []
    sure, unsure = (0.01 * size * rng.standard_normal((47, 3)) for size in (1.0, 4.0))
    others = (2.0, predicted, many, many + 20, sure)
    for seconds, times in ((3.0, 1), (30.0, 10)):
        i = np.repeat(few, times)
        same = (seconds, predicted, i, i + 60, np.repeat(unsure[: len(few)], times, axis=0))
        bands.append(astuple(estimated_band([others, same]) or NOTHING))
    assert bands[1] == pytest.approx(bands[0], rel=1e-6)
    alone = astuple(estimated_band([same]) or NOTHING)
    assert alone[0] > 1.2 * bands[0][0]  # the two lengths disagree, so their weights count


def test_four_parts_with_lasting_errors_of_their_own_hold_nine_tenths_of_the_next_one() -> None:
    """Turn gains are drawn for each part.

    The numbers of the others predict it, and those of all four predict the next one.
    """
    rng = np.random.default_rng(4)
    inside = list[float]()
    for _ in range(200):
        gains = rng.normal(0.0, 0.05, 5)
        steps = path(310, int(rng.integers(1e9)))
        predicted = driven(steps)
        i = np.arange(0, 11)
        others = (gains[:4].sum() - gains[:4]) / 3.0
        off = [*(gains[:4] - others), gains[4] - gains[:4].mean()]
        true = [driven(steps * [1.0, 1.0 + each]) for each in off]
        found = [errors(predicted, each, i, i + 300) for each in true]
        windows = [(30.0, predicted, i, i + 300, error) for error in found]
        band = estimated_band(windows[:4])
        assert band is not None
        inside.append(float(np.mean(np.abs(found[4][:, 2]) <= band.edges(*windows[4][1:])[1])))
    assert 0.84 < np.mean(inside) < 0.96


def test_too_few_windows_have_no_band() -> None:
    few = (2.0, np.zeros((9, 3)), np.arange(3), np.arange(3) + 5, np.zeros((3, 3)))
    assert estimated_band([few]) is None
