"""Laws of the metrics: identities, invariances, inequalities.

Oracles are scipy, evo and the search over all pairs.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial import cKDTree
from scipy.spatial.distance import directed_hausdorff

from ssmr.geometry import compose_poses, wrap_angle, yaw_to_quat_wxyz
from ssmr.metrics.declared import (
    _PATH_METRICS,
    SIGNALS,
    _equal_times_rms,
    compare_paths,
    compare_pieces,
    compare_signals,
)
from ssmr.metrics.paths import (
    BENDING_FLOOR,
    LENGTH_FLOOR,
    PathMeasures,
    bend_ratio_kernel,
    bending_energy,
    measure_paths,
    one_sided_kernel,
    path_length,
)
from ssmr.metrics.windows import TIME_TOLERANCE, horizon_windows, relative_pose_error
from ssmr.types import FloatArray, Trajectory
from tests.conftest import distances_to_path, metrics_of, read_only

# relative, and in metres for paths of some metres: algebraic identities and other libraries'
# distances
ROUNDOFF = 1e-12
# relative: a rigid motion rounds each coordinate, and the bending energy divides that by the
# spacing squared
RIGID = 1e-9
# relative: chords of 2 cm on samples that miss the curve by (step)^2 / 8 R; measured at most 0.8 %
CURVATURE = 0.01

quick = settings(deadline=None)  # the first example compiles
seeds = st.integers(0, 2**32 - 1)
coordinates = st.floats(-100.0, 100.0)
# Few distinct values make coincident samples, crossings and ties, where a wrong bound would show.
coarse = st.integers(-3, 3).map(float)
paths = st.one_of(
    arrays(np.float64, st.tuples(st.integers(1, 90), st.just(2)), elements=coordinates),
    arrays(np.float64, st.tuples(st.integers(1, 90), st.just(2)), elements=coarse),
)


def compiled_measures(candidate: FloatArray, reference: FloatArray) -> PathMeasures:
    """The compiled measures of two paths."""
    return measure_paths(read_only(candidate), read_only(reference))


def geometric(candidate: FloatArray, reference: FloatArray) -> tuple[float, ...]:
    """Its measures of paths; those at equal times are left out."""
    m = compiled_measures(candidate, reference)
    return m.d_rms, m.d_haus, *m.lengths, *m.bendings, m.d_rms_symmetric, m.d_haus_symmetric


def sync_rms(candidate: Trajectory, reference: Trajectory) -> float:
    """The metric of that name."""
    return compare_paths(candidate, reference)["sync_rms_m"]


def yaw_rms(candidate: Trajectory, reference: Trajectory) -> float:
    """The metric of that name."""
    return compare_paths(candidate, reference)["yaw_rms_rad"]


def all_pairs(points: FloatArray, path: FloatArray) -> FloatArray:
    """The slow obvious version of `distances_to_path`: every point against every segment."""
    ends = path[1:] if len(path) > 1 else path
    starts = path[: len(ends)]
    steps = ends - starts
    squares = np.sum(steps**2, axis=1)
    away = points[:, None, :] - starts
    along = np.sum(away * steps, axis=2)
    share = np.clip(np.divide(along, squares, np.zeros_like(along), where=squares > 0.0), 0.0, 1.0)
    return np.asarray(np.linalg.norm(away - share[..., None] * steps, axis=2).min(axis=1))


def assert_searched_well(points: FloatArray, path: FloatArray) -> None:
    """The compiled search and the slow one differ by rounding alone, as seen from the path."""
    size = ROUNDOFF * max(1.0, float(np.abs(path).max()), float(np.abs(points).max()))
    measured = distances_to_path(points, path)
    np.testing.assert_allclose(measured, all_pairs(points, path), rtol=ROUNDOFF, atol=size)


def random_walk(seed: int, n: int = 700, step: float = 0.01) -> FloatArray:
    """(n, 2) a path of independent steps, with a standstill in it."""
    steps = np.random.default_rng(seed).normal(0.0, step, (n, 2))
    steps[n // 3 : n // 2] = 0.0
    return np.cumsum(steps, axis=0)


def drive(seed: int, n: int = 401, dt: float = 0.05) -> Trajectory:
    """A smooth random drive: speed and yaw rate are sums of a few sines."""
    rng = np.random.default_rng(seed)
    t = dt * np.arange(n)
    wave = np.sin(t[:, None] * rng.uniform(0.2, 1.5, (1, 4)) + rng.uniform(0.0, 6.0, (1, 4)))
    speed = 0.5 + 0.1 * wave[:, :2].sum(axis=1)
    yaw_rate = 0.5 * wave[:, 2:].sum(axis=1)
    yaw = np.cumsum(yaw_rate) * dt
    xy = np.cumsum(np.column_stack([speed * np.cos(yaw), speed * np.sin(yaw)]), axis=0) * dt
    return trajectory(t, np.column_stack([xy, yaw]))


def trajectory(t: FloatArray, pose: FloatArray) -> Trajectory:
    """A trajectory of which only the poses matter."""
    return Trajectory(t, pose, np.zeros((len(t), 3)), np.zeros((len(t), 2)))


def moved(path: Trajectory, pose: tuple[float, float, float]) -> Trajectory:
    """The same motion seen from another world frame."""
    return trajectory(path.t, compose_poses(np.array(pose), path.pose))


def circle(radius: float, length: float, step: float) -> FloatArray:
    """(M, 2) samples of an arc, `step` [m] apart."""
    angle = np.arange(round(length / step) + 1) * step / radius
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def winding(step: float, amplitude: float = 1.5, wave: float = 4.0, waves: int = 3) -> FloatArray:
    """(M, 2) whole waves of curvature amplitude cos(2 pi s / wave).

    The bending energy is amplitude^2 length / 2.
    """
    fine = 20
    n = round(waves * wave / step) * fine
    s = (np.arange(n) + 0.5) * waves * wave / n  # midpoint rule
    yaw = amplitude * wave / (2.0 * np.pi) * np.sin(2.0 * np.pi * s / wave)
    xy = np.cumsum(np.column_stack([np.cos(yaw), np.sin(yaw)]), axis=0) * waves * wave / n
    return np.concatenate([np.zeros((1, 2)), xy[fine - 1 :: fine]])


# Nearest segments
# --------------------------------------------------------------------------------------------------


@quick
@given(points=paths, path=paths)
def test_nearest_distances_are_those_of_the_search_over_all_pairs(
    points: FloatArray, path: FloatArray
):
    assert_searched_well(points, path)
    # no segment is farther than its ends
    assert np.all(distances_to_path(points, path) <= cKDTree(path).query(points)[0] + ROUNDOFF)


@quick
@given(seed=seeds, finer=st.integers(2, 9))
def test_a_distance_is_that_to_the_path_however_it_is_sampled(seed: int, finer: int):
    """More samples on the same polyline change nothing, and on the path itself it is zero."""
    path = random_walk(seed, 120)
    at = np.arange((len(path) - 1) * finer + 1) / finer
    fine = np.column_stack([np.interp(at, np.arange(len(path)), column) for column in path.T])
    points = path + np.random.default_rng(seed).normal(0.0, 0.05, path.shape)
    np.testing.assert_allclose(
        distances_to_path(points, path), distances_to_path(points, fine), rtol=0.0, atol=ROUNDOFF
    )
    assert distances_to_path(fine, path).max() < ROUNDOFF


def test_distance_is_evos_to_a_path_that_is_sampled_finely() -> None:
    """Evo compares samples with samples: each with its nearest on a path of a thousand times more.

    These lie within the step of the fine path, half of it along the path, and so square less.
    """
    evo = pytest.importorskip("evo.core.metrics")
    candidate = drive(5)
    reference = moved(drive(5), (0.01, -0.02, 0.01))
    times = 1000
    at = np.linspace(0.0, len(candidate) - 1.0, times * (len(candidate) - 1) + 1)
    stamps = np.arange(len(candidate))
    fine = np.column_stack([np.interp(at, stamps, column) for column in candidate.pose.T])
    nearest = cKDTree(fine[:, :2]).query(reference.xy)[1]
    ape = evo.APE(evo.PoseRelation.translation_part)
    beside = trajectory(reference.t, fine[nearest])
    ape.process_data((evo_trajectory(reference), evo_trajectory(beside)))
    step = float(np.hypot(*np.diff(fine[:, :2], axis=0).T).max())
    m = compiled_measures(candidate.pose, reference.pose)
    judged = (
        (m.d_rms, evo.StatisticsType.rmse),
        (m.d_haus, evo.StatisticsType.max),
    )
    for ours, kind in judged:
        theirs = ape.get_statistic(kind)
        assert ours <= theirs <= math.hypot(ours, 0.5 * step) + ROUNDOFF


@quick
@given(seed=seeds)
def test_a_distance_is_smooth_where_the_path_moves(seed: int):
    """Along a shift of the path a distance changes as its derivative says, without steps.

    Seen from samples 38 mm apart it would jump by the half of that times the slope.
    """
    rng = np.random.default_rng(seed)
    path = circle(3.0, 10.0, 0.038)
    reference = circle(3.0 + rng.uniform(0.002, 0.02), 10.0, 0.031)[20:-40]
    shifts = np.linspace(0.0, 0.038, 39)
    way = np.array([math.cos(rng.uniform(0.0, 6.3)), math.sin(rng.uniform(0.0, 6.3))])
    sizes = [compiled_measures(path + shift * way, reference).d_rms for shift in shifts]
    # of a distance that is bent like the path itself, over a step of 1 mm
    assert np.abs(np.diff(sizes, 2)).max() < 0.001**2 / 0.0005


@settings(quick, max_examples=25)
@given(seed=seeds, jump=st.floats(0.1, 1e4), jumps=st.integers(1, 5), still=st.integers(0, 300))
def test_nearest_distances_of_a_path_that_jumps_and_stands_still(
    seed: int, jump: float, jumps: int, still: int
):
    """Jumps of a localiser, and a robot that stands.

    Batches of points and boxes of segments lie across both.
    """
    rng = np.random.default_rng(seed)
    path = random_walk(seed, 600)
    for at in rng.integers(1, len(path), jumps):
        path[at:] += rng.normal(0.0, jump, 2)
        path = np.insert(path, at, np.tile(path[at], (still, 1)), axis=0)
    points = path[rng.integers(0, len(path), 400)] + rng.normal(0.0, 0.05, (400, 2))
    for some in (points, path + rng.normal(0.0, 0.05, path.shape)):
        assert_searched_well(some, path)


@pytest.mark.parametrize("step", [1.0, 0.01, 1.0 / 3.0])
def test_nearest_distances_where_the_bound_is_tight(step: float):
    # Straight away from the point, back, closer than before for one sample only, and away: to pass
    # over one segment more than the bound allows is to miss that one.
    for out in range(1, 120):
        along = np.concatenate(
            [10.0 + np.arange(out), np.arange(10.0 + out, 8.0, -1.0), np.arange(10.0, 200.0)]
        )
        path = step * np.column_stack([along, np.zeros(len(along))])
        for commanded in (path, path[::-1]):
            # The first batches of points lie at the end of the path, so that the search begins
            # there.
            points = np.concatenate([np.tile(commanded[-1], (64, 1)), np.zeros((1, 2))])
            for some in (points, points[-1:]):
                assert_searched_well(some, commanded)


# Length and bending energy
# -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("step", [0.0003, 0.004, 0.01, 0.0137, 0.02, 0.033, 0.1])
@pytest.mark.parametrize(("radius", "length"), [(0.5, 1.0), (1.0, 10.0), (5.0, 20.0)])
def test_bending_energy_of_a_circle(radius: float, length: float, step: float):
    xy = circle(radius, length, step)
    expected = step * (len(xy) - 1) / radius**2
    assert bending_energy(xy) == pytest.approx(expected, rel=CURVATURE)


@quick
@given(seed=seeds)
def test_bending_energy_does_not_depend_on_speed_nor_stops(seed: int):
    rng = np.random.default_rng(seed)
    xy = winding(0.002)
    # uneven steps, many coincident
    kept = np.sort(np.concatenate([[0, len(xy) - 1], rng.integers(0, len(xy), 9000)]))
    stop = np.full((500, 2), xy[0])
    assert bending_energy(np.concatenate([stop, xy[kept]])) == pytest.approx(
        bending_energy(xy), rel=CURVATURE
    )


@pytest.mark.parametrize(
    "still",
    [
        np.zeros((1, 2)),
        np.zeros((900, 2)),
        np.random.default_rng(0).normal(0.0, 0.001, (900, 2)),  # jitter within the spacing
        circle(0.008, 10.0, 0.001),  # on the spot, about a point 8 mm beside
    ],
)
def test_bending_energy_of_a_standing_robot_is_zero(still: FloatArray):
    assert bending_energy(still) == 0.0


# The metrics together
# --------------------------------------------------------------------------------------------------


@quick
@given(seed=seeds)
def test_a_path_equals_itself(seed: int):
    a = drive(seed)
    assert compare_paths(a, a) == metrics_of(0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0)


@quick
@given(
    seed=seeds, pose=st.tuples(st.floats(-10.0, 10.0), st.floats(-10.0, 10.0), st.floats(-7.0, 7.0))
)
def test_a_common_rigid_motion_changes_nothing(seed: int, pose: tuple[float, float, float]):
    a = drive(seed)
    b = drive(seed + 1)
    before = compare_paths(a, b)
    after = compare_paths(moved(a, pose), moved(b, pose))
    np.testing.assert_allclose(list(after.values()), list(before.values()), rtol=RIGID, atol=RIGID)


@quick
@given(seed=seeds, n=st.integers(2, 300))
def test_the_metrics_are_ordered_and_the_symmetric_ones_symmetric(seed: int, n: int):
    a = drive(seed)
    b = drive(seed + 1, n)
    there = compare_paths(a, b)
    back = compare_paths(b, a)
    for m in (there, back):
        assert 0.0 <= m["d_rms_m"] <= m["d_haus_m"] * (1.0 + ROUNDOFF)
        assert m["d_rms_symmetric_m"] <= m["d_haus_symmetric_m"] * (1.0 + ROUNDOFF)
    assert (
        there["d_haus_symmetric_m"]
        == back["d_haus_symmetric_m"]
        == max(there["d_haus_m"], back["d_haus_m"])
    )
    assert there["d_rms_symmetric_m"] == pytest.approx(back["d_rms_symmetric_m"], rel=ROUNDOFF)
    assert there["d_rms_symmetric_m"] == pytest.approx(
        math.hypot(there["d_rms_m"], back["d_rms_m"]) / math.sqrt(2.0), rel=ROUNDOFF
    )
    assert there["d_ratio"] * back["d_ratio"] == pytest.approx(1.0, rel=ROUNDOFF)


@quick
@given(seed=seeds)
def test_hausdorff_distances_are_scipys_but_for_half_a_step(seed: int):
    a = drive(seed)
    b = drive(seed + 1, 250)
    m = compare_paths(a, b)
    # between samples, which lie at most so far apart
    from_reference = directed_hausdorff(b.xy, a.xy)[0]
    from_candidate = directed_hausdorff(a.xy, b.xy)[0]
    step = max(float(np.hypot(*np.diff(each.xy, axis=0).T).max()) for each in (a, b))
    farther = max(from_reference, from_candidate)
    for ours, theirs in ((m["d_haus_m"], from_reference), (m["d_haus_symmetric_m"], farther)):
        assert theirs - 0.5 * step <= ours <= theirs * (1.0 + ROUNDOFF)


def test_ratios_are_finite_where_the_reference_stands_still():
    still = trajectory(np.arange(401.0), np.zeros((401, 3)))
    moving = drive(7)
    assert compare_paths(still, still)["d_ratio"] == 1.0
    assert compare_paths(still, still)["e_bend_ratio"] == 1.0
    assert compare_paths(moving, still)["d_ratio"] == path_length(moving.xy) / LENGTH_FLOOR
    assert compare_paths(moving, still)["e_bend_ratio"] == bending_energy(moving.xy) / BENDING_FLOOR
    assert compare_paths(still, moving)["d_ratio"] == 0.0
    assert compare_paths(still, moving)["e_bend_ratio"] == 0.0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e100])
def test_the_kernel_answers_a_diverged_candidate_with_nan(bad: float):
    reference = drive(1).pose
    candidate = reference.copy()
    candidate[200:, 1] = bad
    assert np.all(np.isnan(geometric(candidate, reference)))
    assert np.all(np.isnan(geometric(reference, candidate)))
    assert np.all(np.isnan(geometric(np.zeros((0, 2)), reference)))


# Synchronised errors
# --------------------------------------------------------------------------------------------------


@quick
@given(speed=st.floats(0.1, 2.0), delay=st.floats(0.0, 1.0), turn=st.floats(-0.5, 0.5))
def test_a_delayed_motion_lags_by_its_speed(speed: float, delay: float, turn: float):
    # Speed and yaw rate are constant along a straight line, so linear interpolation is exact at
    # other stamps too.
    t = 0.1 * np.arange(101)
    s = np.sort(np.concatenate([[0.0, 10.0], np.random.default_rng(0).uniform(0.0, 10.0, 60)]))
    reference = trajectory(t, np.column_stack([speed * t, 0.0 * t, turn * t]))
    candidate = trajectory(s, np.column_stack([speed * (s - delay), 0.0 * s, turn * (s - delay)]))
    assert sync_rms(candidate, reference) == pytest.approx(speed * delay, rel=RIGID, abs=ROUNDOFF)
    assert yaw_rms(candidate, reference) == pytest.approx(
        abs(turn) * delay, rel=RIGID, abs=ROUNDOFF
    )


@quick
@given(seed=seeds, turns=st.integers(-3, 3))
def test_whole_turns_and_wrapping_do_not_count(seed: int, turns: int):
    a = drive(seed)
    b = drive(seed + 1)
    expected = yaw_rms(a, b)
    later = trajectory(b.t[:-1] + 0.02, b.pose[:-1])  # between the candidate's stamps
    turned = trajectory(a.t, a.pose + np.array([0.0, 0.0, 2.0 * np.pi * turns]))
    wrapped = trajectory(a.t, np.column_stack([a.xy, wrap_angle(a.yaw)]))
    assert yaw_rms(turned, b) == pytest.approx(expected, rel=RIGID, abs=RIGID)
    assert yaw_rms(wrapped, later) == pytest.approx(yaw_rms(a, later), rel=RIGID, abs=RIGID)


def test_stamps_that_differ_by_rounding_are_the_same():
    a = drive(1)
    shifted = trajectory(a.t + 0.5 * TIME_TOLERANCE, a.pose)
    assert _equal_times_rms(shifted, a)[0] < 1.0 * TIME_TOLERANCE
    assert sync_rms(a, shifted) < 1.0 * TIME_TOLERANCE  # it moves at less than 1 m/s


# evo as oracle
# --------------------------------------------------------------------------------------------------


def evo_trajectory(path: Trajectory):
    evo = pytest.importorskip("evo.core.trajectory")
    positions = np.column_stack([path.xy, np.zeros(len(path))])
    return evo.PoseTrajectory3D(positions, yaw_to_quat_wxyz(path.yaw), path.t)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_synchronised_errors_are_evos_absolute_pose_errors(seed: int):
    evo = pytest.importorskip("evo.core.metrics")
    candidate = drive(seed)
    reference = drive(seed + 10)
    m = compare_paths(candidate, reference)
    for relation, ours in (
        (evo.PoseRelation.translation_part, m["sync_rms_m"]),
        (evo.PoseRelation.rotation_angle_rad, m["yaw_rms_rad"]),
    ):
        ape = evo.APE(relation)
        ape.process_data((evo_trajectory(reference), evo_trajectory(candidate)))
        assert ours == pytest.approx(ape.get_statistic(evo.StatisticsType.rmse), rel=ROUNDOFF)


@pytest.mark.parametrize("all_pairs_of_evo", [False, True])
@pytest.mark.parametrize("delta", [1, 7, 120])
def test_relative_pose_errors_are_evos(delta: int, all_pairs_of_evo: bool):
    evo = pytest.importorskip("evo.core.metrics")
    candidate = drive(3)
    reference = drive(4)
    edges = np.arange(0, len(reference), 1 if all_pairs_of_evo else delta)
    starts = edges[edges + delta < len(reference)]
    ours = relative_pose_error(candidate.pose, reference.pose, starts, starts + delta)
    for relation, errors in zip(
        (evo.PoseRelation.translation_part, evo.PoseRelation.rotation_angle_rad), ours, strict=True
    ):
        rpe = evo.RPE(relation, delta, evo.Unit.frames, all_pairs=all_pairs_of_evo)
        rpe.process_data((evo_trajectory(reference), evo_trajectory(candidate)))
        np.testing.assert_allclose(errors, rpe.error, rtol=0.0, atol=ROUNDOFF)


# Horizons
# --------------------------------------------------------------------------------------------------


@quick
@given(
    seed=seeds,
    n=st.integers(0, 300),
    horizon=st.floats(0.01, 20.0),
    share=st.sampled_from([0.0, 0.1, 0.5, 1.0]),
)
def test_windows_follow_each_other_and_cover_the_record(
    seed: int, n: int, horizon: float, share: float
):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.001, 0.2, n))
    usable = rng.random(n) < share
    starts, ends = horizon_windows(t, horizon, usable)
    good = np.flatnonzero(usable)
    assert np.array_equal(starts[1:], ends[:-1])  # neither overlap nor gap
    assert np.all(usable[starts])
    assert np.all(usable[ends])
    assert np.all(t[ends] - t[starts] >= horizon - 2.0 * TIME_TOLERANCE)
    for i, j in zip(starts, ends, strict=True):
        earlier = good[(good > i) & (good < j)]
        assert np.all(t[earlier] - t[i] < horizon)  # no usable sample would have done sooner
    if len(good) > 0:
        first = good[0] if len(starts) == 0 else ends[-1]
        assert len(starts) == 0 or starts[0] == good[0]
        assert t[good[-1]] - t[first] < horizon  # what is left is too short
    else:
        assert len(starts) == len(ends) == 0


@pytest.mark.parametrize("dt", [0.01, 0.02, 0.1, 1.0 / 3.0])
@pytest.mark.parametrize("samples", [1, 3, 30])
def test_rounding_of_stamps_costs_no_sample(samples: int, dt: float):
    t = 17.3 + dt * np.arange(1000)
    starts, ends = horizon_windows(t, samples * dt)
    assert np.array_equal(ends - starts, np.full(999 // samples, samples))
    assert [len(part) for part in horizon_windows(t[:1], dt)] == [0, 0]


def test_the_parts_are_those_of_the_whole() -> None:
    rng = np.random.default_rng(8)
    reference = read_only(np.cumsum(rng.normal(0.01, 0.005, (400, 2)), axis=0))
    for candidate in map(
        read_only,
        (
            reference,
            reference + 0.1,
            np.cumsum(rng.normal(0.01, 0.02, (300, 2)), axis=0),
            np.full((3, 2), np.nan),
        ),
    ):
        whole = measure_paths(candidate, reference)
        if np.isnan(whole.d_rms):
            assert np.all(np.isnan(one_sided_kernel(candidate, reference, path_length(reference))))
            continue
        measured = {
            metric.name: pool([part_of(whole, (0.0, 0.0))], [400])
            for metric, part_of, pool in _PATH_METRICS
        }
        assert one_sided_kernel(candidate, reference, path_length(reference)) == (
            measured["d_rms_m"],
            measured["d_haus_m"],
            measured["d_ratio"],
        )
        assert bend_ratio_kernel(candidate, reference) == measured["e_bend_ratio"]


# Declarations and pieces
# --------------------------------------------------------------------------------------------------


def test_pieces_are_pooled_as_declared():
    whole = drive(3), drive(4)
    one = compare_paths(*whole)
    other = compare_paths(whole[1], whole[0])
    both = compare_pieces(whole, whole[::-1])
    assert compare_pieces(whole[:1], whole[1:]) == one
    assert both["d_rms_m"] == pytest.approx(
        math.sqrt(0.5 * (one["d_rms_m"] ** 2 + other["d_rms_m"] ** 2)), rel=ROUNDOFF
    )
    assert both["d_haus_m"] == max(one["d_haus_m"], other["d_haus_m"])
    assert both["d_ratio"] == both["e_bend_ratio"] == 1.0
    with pytest.raises(ValueError, match="nothing to compare"):
        compare_pieces([], [])


def turning(rate: FloatArray, torque: float, dt: float = 0.01) -> Trajectory:
    """A motion of a given yaw rate and its slope, with both torques equal."""
    t = dt * np.arange(len(rate))
    still = np.zeros((len(t), 2))
    channels = {"torque_N_m": still + torque, "yaw_acceleration_rad_s2": np.gradient(rate, t)}
    return Trajectory(t, np.zeros((len(t), 3)), np.column_stack([still, rate]), still, channels)


def test_signals_at_equal_times_see_a_late_robot_that_paths_do_not() -> None:
    """A sine of frequency w that comes s later differs by a cosine of amplitude 2 sin(w s / 2)."""
    t = 0.01 * np.arange(2000)
    w = math.pi
    late = 0.04
    on_time = turning(np.sin(w * t), 3.0)
    delayed = turning(np.sin(w * (t - late)), 5.0)
    metrics = compare_signals([delayed], [on_time])
    wanted = math.sqrt(2.0) * math.sin(0.5 * w * late)
    assert metrics["yaw_rate_rms_rad_s"] == pytest.approx(wanted, rel=1e-3)
    assert metrics["yaw_acceleration_rms_rad_s2"] == pytest.approx(w * wanted, rel=1e-2)
    assert metrics["torque_rms_N_m"] == pytest.approx(2.0)
    assert set(compare_signals([on_time], [on_time]).values()) == {0.0}
    assert compare_paths(delayed, on_time)["d_rms_m"] == 0.0


def test_a_signal_that_a_motion_does_not_know_is_not_compared() -> None:
    known = turning(np.ones(50), 3.0)
    bare = replace(known, channels={})
    without_motors = turning(np.zeros(50), 0.0)
    assert set(compare_signals([known], [bare])) == {"yaw_rate_rms_rad_s"}
    assert set(compare_signals([without_motors], [known])) == set(SIGNALS) - {"torque_rms_N_m"}
    both = compare_signals([known, without_motors], [known, known])
    assert both["yaw_rate_rms_rad_s"] == pytest.approx(math.sqrt(0.5))
    assert "torque_rms_N_m" not in both
