"""Whether a commissioned state filter is as sure of the pose as it may be, on a robot that drives in a closed loop."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from ssmr.control.loop import Feedback, LoopSettings
from ssmr.control.references import sine
from ssmr.estimation.ekf import run_ekf
from ssmr.estimation.settings import EkfSettings, zeroed
from ssmr.robot.sensors import SensorModel, gyro_at_rest, simulate_sensors
from ssmr.types import FloatArray, State, Trajectory
from validation.bench.commissioning import TRACKER, commissioned
from validation.bench.gains import DEFAULT, load_gains
from validation.bench.loops import make_controller, make_robot, run_robots
from validation.plants.filters import odometry_of
from validation.plants.profile import Profile

_SPEED, _EVERY, _RATE = 0.25, 4.0, 125.0


@dataclass(frozen=True, eq=False)
class Doubt:
    """Errors of a filter's pose in units of what it claims, over many runs."""

    case: tuple[str, str, str]
    """Names of the profile, of the plant and of the feedback."""
    settings: EkfSettings
    """The filter, as it was commissioned."""
    t: FloatArray
    """(K,) instants [s]."""
    nees: FloatArray
    """(runs, K) normalised squared errors of the pose, which should be chi-squared with 3 degrees of freedom."""
    thesis: FloatArray
    """(runs, K) those of the thesis' filter, with a gyro that has no bias."""
    thesis_biased: FloatArray
    """(runs, K) those of the thesis' filter, with the gyro of `nees`."""
    nis: FloatArray
    """(runs, M) normalised squared innovations of the wheels' yaw rate, with one degree of freedom."""

    @property
    def band(self) -> tuple[float, float]:
        """Where 95 % of the means of `nees` over the runs should lie."""
        return chi_squared_band(3, len(self.nees))

    @property
    def inside(self) -> float:
        """Share of the instants at which the mean of `nees` over the runs lies within `band`."""
        return share_within(self.nees, self.band)

    @property
    def nis_share(self) -> float:
        """Share of the instants at which the mean of `nis` over the runs lies within its own 95 % band."""
        return share_within(self.nis, chi_squared_band(1, len(self.nis)))


def chi_squared_band(degrees: int, runs: int) -> tuple[float, float]:
    """Return the band in which 95 % of the means of `runs` independent chi-squared numbers lie."""
    low, high = (float(chdtri(degrees * runs, p)) / runs for p in (0.975, 0.025))
    return low, high


def share_within(found: FloatArray, band: tuple[float, float]) -> float:
    """Return the share of the (K,) means over the rows of (runs, K) numbers that lie within a band."""
    mean = found.mean(axis=0)
    return float(np.mean((mean > band[0]) & (mean < band[1])))


def doubt_of(
    profile: Profile, plant: str, feedback: Feedback = "noisy", runs: int = 16, seed: int = 0, workers: int | None = None
) -> Doubt:
    """Commission a filter on one reference, and judge it on another, on robots that differ as it says that they may.

    A scheduled LQR drives the eight twice, from which the filter gets its constants and the size of its slip, then the sine,
    with other seeds, pushed as in Sec. 3.4.5. Each run begins with constants that are off by draws of its doubts.

    Args:
        profile: the robot and its plants.
        plant: name of the plant that is driven.
        feedback: what the controller sees; the filter that is judged only listens.
        runs: number of runs on the sine.
        seed: seed of the first.
        workers: threads; the result does not depend on it.

    Raises:
        LostError: a robot left the reference.
    """
    robot, controller = make_robot(profile, plant), make_controller(profile, load_gains(TRACKER, DEFAULT))
    loop, doubts = LoopSettings(feedback, filter=odometry_of(robot.drive)), commissioned(profile, plant, feedback)
    found = run_robots([robot] * runs, [controller] * runs, [loop] * runs, sine(_SPEED), range(seed, seed + runs), workers)
    driven = [run.require_kept(f"{plant} of {profile.name}").motion for run in found]
    each = [_judge(truth, doubts, np.random.default_rng([seed, k])) for k, truth in enumerate(driven)]
    t, *errors, nis = (np.array(column) for column in zip(*each, strict=True))
    own, thesis, biased = errors
    return Doubt((profile.name, plant, feedback), doubts, t[0], own, thesis, biased, nis)


def _judge(truth: Trajectory, doubts: EkfSettings, rng: np.random.Generator) -> tuple[FloatArray, ...]:
    """Return the fields of a `Doubt` for one run, from `t` on."""
    bias, left, right, turning, shift, slide = rng.standard_normal(6)
    begins = replace(
        doubts,
        scale_left=doubts.scale_left + doubts.scale_std * left,
        scale_right=doubts.scale_right + doubts.scale_std * right,
        turning=doubts.turning + doubts.turning_std * turning,
        shift=doubts.shift + doubts.centre_std * shift,
        slide=doubts.slide + doubts.centre_std * slide,
    )
    shown = doubts.bias_std * float(bias)
    sensors = SensorModel(gyro_bias=shown)
    log = simulate_sensors(truth, rng, sensors, _RATE)
    begins = zeroed(begins, gyro_at_rest(sensors.packed(), rng))
    (x, y, yaw), (v, _, w) = truth.pose[0].tolist(), truth.twist[0].tolist()
    at = np.searchsorted(log.t, np.arange(_EVERY, log.t[-1], _EVERY) - 1e-9)
    thesis, found = EkfSettings(radius=doubts.radius, half_track=doubts.half_track), list[FloatArray]()
    nis = list[FloatArray]()
    for settings, read in ((begins, log), (thesis, log._replace(gyro=log.gyro - shown)), (thesis, log)):
        got = run_ekf(*read, settings, State(x, y, yaw, v_x=v, yaw_rate=w))
        error = got.pose[at] - truth.pose[np.searchsorted(truth.t, log.t[at] - 1e-9)]
        covariance = got.channels["pose_covariance"][at]
        found.append(np.einsum("ki,ki->k", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0]))
        nis.append(got.channels["innovations"][1:, 1])
    return log.t[at], *found, nis[0]
