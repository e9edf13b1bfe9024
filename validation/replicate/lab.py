"""The lab's instruments: noise of the state filter (Sec. 3.4.4, Tab. 3.4)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy import signal

from ssmr.estimation.ekf import run_ekf
from ssmr.robot.sensors import SAMPLE_RATES_HZ, SensorNoise, measure, simulate_sensors
from ssmr.robot.vehicle import Drive
from ssmr.scenarios import COMMAND_PERIOD
from ssmr.types import Commands, FloatArray, State, Trajectory, frozen_array
from validation.plants.profile import load_profile, make_plant, odometry_of
from validation.replicate.chapters import Findings, Section, Task
from validation.thesis import published
from validation.thesis.verdicts import Pair

_PROFILE, _PLANT = "thesis-lab", "mujoco"
_RATE = SAMPLE_RATES_HZ["ekf"]
_LEAD, _TIME = 5.0, 20.0
"""Time to get up to speed, which is left out, and time after that [s]; the thesis does not say how long it measured."""
_JITTER = 0.010
"""Standard deviation of the error of a sample's stamp [s] that would explain the printed variance of X."""
_STRAIGHT = ("case1", "case2")


def high_pass(rate: float) -> FloatArray:
    """Return the (K,) taps of the filter of Sec. 3.4.4 for samples at a rate [Hz]: symmetric, and blind for ramps.

    Matlab's `highpass` leaves a thousandth of the motion itself; here constants and ramps are taken away exactly. The
    transition is as wide as Matlab makes it, and below the passband.
    """
    text = (f"noise_highpass_{what}" for what in ("frequency", "steepness", "attenuation"))
    passband, steepness, attenuation = (published.value("text", name) for name in text)
    width = (1.0 - steepness) * passband
    count, beta = signal.kaiserord(attenuation, width / (0.5 * rate))
    count += 1 - count % 2
    taps = signal.firwin(count, passband - 0.5 * width, window=("kaiser", beta), pass_zero=False, fs=rate)
    window = np.kaiser(count, beta)
    return frozen_array(taps - window * (taps.sum() / window.sum()), "taps", (None,))


def variance_above(values: FloatArray, rate: float) -> float:
    """Return the variance of what passes of (M,) samples [unit²], as the thesis takes it; the filter's ends are left out."""
    return float(np.var(np.convolve(values - values.mean(), high_pass(rate), "valid"), ddof=1))


def _driven(case: Mapping[str, float]) -> tuple[Trajectory, Drive]:
    """Return the MuJoCo Husky's motion under a case's command, from the lead-in's end on, and the robot's drive."""
    profile = load_profile(_PROFILE)
    n = round((_LEAD + _TIME) / COMMAND_PERIOD)
    command = Commands(COMMAND_PERIOD, np.tile([case["cmd_u_m_s"], case["cmd_omega_rad_s"]], (n, 1)))
    motion = make_plant(profile, _PLANT).run(command, State(), 1.0 / _RATE)
    kept = motion.t >= _LEAD
    drive = profile.plants[_PLANT].drive
    return Trajectory(motion.t[kept], motion.pose[kept], motion.twist[kept], motion.wheels[kept]), drive


def late(motion: Trajectory, seen: Trajectory, jitter: float, rng: np.random.Generator) -> Trajectory:
    """Return an estimate whose samples were taken a little before or after their stamps: the pose has moved on meanwhile.

    Args:
        motion: the true motion at the stamps.
        seen: the estimate at the stamps.
        jitter: standard deviation of the stamps' errors [s].
        rng: generator of these errors.
    """
    off = rng.normal(0.0, jitter, len(motion))
    cos, sin = np.cos(motion.pose[:, 2]), np.sin(motion.pose[:, 2])
    v_x, v_y, w = motion.twist.T
    moved = np.column_stack([cos * v_x - sin * v_y, sin * v_x + cos * v_y, w]) * off[:, None]
    return Trajectory(seen.t, seen.pose + moved, seen.twist, seen.wheels)


def _noise(task: Task) -> Findings:
    """Find the variances of Tab. 3.4 in the simulated lab: as it is, with wrong stamps, and of what the thesis simulates."""
    seeds, cases = range(task.budget.draws), {case: published.table("3.3")["rows"][case] for case in _STRAIGHT}
    variances: dict[tuple[str, str], list[dict[str, float]]] = {}
    for number, (case, commands) in enumerate(cases.items()):
        motion, drive = _driven(commands)
        (x, y, yaw), (v, _, w) = motion.pose[0].tolist(), motion.twist[0].tolist()
        for seed in seeds:
            log = simulate_sensors(motion, np.random.default_rng(seed), rate=_RATE)
            rng = np.random.default_rng([seed, number])
            filtered = run_ekf(log, odometry_of(drive), State(x, y, yaw, v_x=v, yaw_rate=w))
            added = measure(motion, SensorNoise(), rng, _RATE)
            ways = {"exact": filtered, "wrong": late(motion, filtered, _JITTER, rng), "added": added}
            for way, each in ways.items():
                signals = zip(("dx", "dtheta", "X", "Y", "theta"), (*each.twist[:, [0, 2]].T, *each.pose.T), strict=True)
                noises = {name: variance_above(values, _RATE) for name, values in signals}  # above 10 Hz
                variances.setdefault((way, case), []).append(noises)
    rows = {}
    for name, printed in published.table("3.4")["rows"].items():
        regular, jittered, again = (
            np.mean([[each[name] for each in variances[way, case]] for case in _STRAIGHT], axis=0)
            for way in ("exact", "wrong", "added")
        )
        spread = float(np.std(regular, ddof=1)) if len(regular) > 1 else None
        beside = {"with jitter": float(jittered.mean()), "of what is simulated": float(again.mean())}
        rows[name] = {"variance": Pair(printed["value"], float(regular.mean()), "spread", printed["unit"], spread, beside)}
    words = {
        "lead": _LEAD, "time": _TIME, "draws": len(seeds), "rate": _RATE, "jitter": 1e3 * _JITTER,
        "kept": float(np.sum(np.square(high_pass(_RATE)))),
    }  # fmt: skip
    return Findings({"3.4": rows}, words)


NOISE_SECTION = Section("noise", ("3.4",), _noise)
"""The section on the sensors' noise."""
