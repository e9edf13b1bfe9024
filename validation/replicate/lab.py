"""The lab's instruments: noise of the state filter (Sec. 3.4.4, Tab. 3.4)."""

from __future__ import annotations

import numpy as np
from scipy import signal

from ssmr.estimation.ekf import run_ekf
from ssmr.geometry import rotate_body_to_world
from ssmr.robot.sensors import SAMPLE_RATES_HZ, SensorNoise, measure, simulate_sensors
from ssmr.scenarios import COMMAND_PERIOD
from ssmr.types import Commands, FloatArray, State, Trajectory, frozen_array
from validation.compare import compare
from validation.experiment.sources import Piece, Source
from validation.plants.profile import load_profile, odometry_of
from validation.replicate import published
from validation.replicate.chapters import Findings, Task, standard_deviation
from validation.replicate.verdicts import Pair

_PROFILE = "thesis-lab"
_PLANT = "mujoco"
_RATE = SAMPLE_RATES_HZ["ekf"]
_LEAD = 5.0
"""Time to get up to speed, which is left out [s]."""
_TIME = 20.0
"""Time after that [s]; the thesis does not say how long it measured."""
_JITTER = 0.010
"""Standard deviation of the error of a sample's stamp [s] that would explain the printed variance
of X."""
_STRAIGHT = ("case1", "case2")
_SIGNALS = ("dx", "dtheta", "X", "Y", "theta")
"""Rows of Tab. 3.4."""


def high_pass(rate: float) -> FloatArray:
    """Return the (K,) symmetric taps of the filter of Sec. 3.4.4 for samples at a rate [Hz].

    Matlab's `highpass` leaves a thousandth of the motion itself; here constants and ramps are taken
    away exactly. The transition is as wide as Matlab makes it, and below the passband.
    """
    text = (f"noise_highpass_{what}" for what in ("frequency", "steepness", "attenuation"))
    passband, steepness, attenuation = (published.printed_value("text", name) for name in text)
    width = (1.0 - steepness) * passband
    count, beta = signal.kaiserord(attenuation, width / (0.5 * rate))
    count += 1 - count % 2
    cutoff = passband - 0.5 * width
    taps = signal.firwin(count, cutoff, window=("kaiser", beta), pass_zero=False, fs=rate)
    window = np.kaiser(count, beta)
    return frozen_array(taps - window * (taps.sum() / window.sum()), "taps", (None,))


def variance_above(values: FloatArray, rate: float) -> float:
    """Variance of the noise in (M,) samples [unit²], as the thesis takes it, without the ends."""
    noise = np.convolve(values - values.mean(), high_pass(rate), "valid")
    return float(np.var(noise, ddof=1))


def _drive_case(name: str) -> Trajectory:
    """Return the MuJoCo Husky's motion under the command of a case of Tab. 3.3, after `_LEAD`."""
    case = published.printed_table("3.3")["rows"][name]
    n = round((_LEAD + _TIME) / COMMAND_PERIOD)
    twist = [case["cmd_u_m_s"], case["cmd_omega_rad_s"]]
    commands = Commands(COMMAND_PERIOD, np.tile(twist, (n, 1)))
    source = Source(name, (Piece(commands, State(), None, None),), _PLANT, 1.0 / _RATE)
    motion = compare(source, _PROFILE, (_PLANT,)).motion(_PLANT)
    k = motion.t >= _LEAD
    return Trajectory(motion.t[k], motion.pose[k], motion.twist[k], motion.wheels[k])


def with_late_samples(
    motion: Trajectory, seen: Trajectory, jitter: float, rng: np.random.Generator
) -> Trajectory:
    """Return an estimate whose samples were taken a little before or after their stamps.

    Args:
        motion: the true motion at the stamps.
        seen: the estimate at the stamps.
        jitter: standard deviation of the stamps' errors [s].
        rng: generator of these errors.
    """
    off = rng.normal(0.0, jitter, len(motion))
    velocities = rotate_body_to_world(motion.twist[:, :2], motion.yaw)
    moved = np.column_stack([velocities, motion.twist[:, 2]]) * off[:, None]
    return Trajectory(seen.t, seen.pose + moved, seen.twist, seen.wheels)


def _find_noise(task: Task) -> Findings:
    """Find the variances of Tab. 3.4 in the simulated lab.

    Three noises: the lab's as it is, that with wrong stamps, and the one that the thesis simulates.
    """
    draws = task.draws
    settings = odometry_of(load_profile(_PROFILE).plants[_PLANT].drive)
    found = np.empty((3, len(_STRAIGHT), draws, len(_SIGNALS)))
    for case, name in enumerate(_STRAIGHT):
        motion = _drive_case(name)
        x, y, yaw = motion.pose[0].tolist()
        v, _, w = motion.twist[0].tolist()
        start = State(x, y, yaw, v_x=v, yaw_rate=w)
        for seed in range(draws):
            log = simulate_sensors(motion, np.random.default_rng(seed), rate=_RATE)
            rng = np.random.default_rng([seed, case])
            exact = run_ekf(log, settings, start)
            added = measure(motion, SensorNoise(), rng, _RATE)
            wrong = with_late_samples(motion, exact, _JITTER, rng)
            for way, each in enumerate((exact, wrong, added)):
                signals = (*each.twist[:, [0, 2]].T, *each.pose.T)
                found[way, case, seed] = [variance_above(each, _RATE) for each in signals]
    means = dict(zip(_SIGNALS, np.moveaxis(found.mean(axis=1), 2, 0), strict=True))
    rows = {}
    for name, printed in published.printed_table("3.4")["rows"].items():
        exact, wrong, added = means[name]
        beside = {"with jitter": float(wrong.mean()), "of what is simulated": float(added.mean())}
        ours = exact.mean()
        spread = standard_deviation(exact)
        pair = Pair(printed["value"], ours, "spread", printed["unit"], spread, beside)
        rows[name] = {"variance": pair}
    words = {
        "lead": _LEAD,
        "time": _TIME,
        "draws": draws,
        "rate": _RATE,
        "jitter": 1e3 * _JITTER,
        "kept": np.sum(np.square(high_pass(_RATE))),
    }
    return Findings({"3.4": rows}, words)


NOISE_SECTION = {"noise": (("3.4",), _find_noise)}
"""The section on the sensors' noise."""
