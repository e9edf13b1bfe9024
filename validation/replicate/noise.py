"""The section on the noise of the state filter (Sec. 3.4.4, Tab. 3.3 and 3.4, Fig. 3.16 and 3.17)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ssmr.estimation.ekf import run_ekf
from ssmr.robot.sensors import SAMPLE_RATES_HZ, SensorNoise, measure, simulate_sensors
from ssmr.robot.vehicle import Drive
from ssmr.scenarios import COMMAND_PERIOD
from ssmr.types import Commands, FloatArray, State, Trajectory
from validation.files.log import Group
from validation.plants.filters import odometry_of
from validation.plants.profile import load_profile, make_plant
from validation.replicate.evidence import Context, Findings, Section, Table
from validation.report.drawing import (
    DASHED,
    QUIET,
    Panel,
    draw_footer,
    ink_of,
    line_legend,
    plain_ticks,
    put_together,
    side_by_side,
    text_row,
)
from validation.report.tables import Cell, Grid
from validation.study.noise import NoisySignal, noise_of
from validation.thesis import published
from validation.thesis.verdicts import Pair

_PROFILE, _PLANT = "thesis-lab", "mujoco"
_RATE = SAMPLE_RATES_HZ["ekf"]
_LEAD, _TIME = 5.0, 20.0
"""Time to get up to speed, which is left out, and time after that [s]; the thesis does not say how long it measured."""
_JITTER = 0.010
"""Standard deviation of the error of a sample's stamp [s] that would explain the printed variance of X."""
_SIGNALS: Mapping[str, str] = {"dx": "v_x", "dtheta": "yaw_rate", "X": "x", "Y": "y", "theta": "yaw"}
"""Signals of Tab. 3.4, and the names of their variances in `SensorNoise`."""
_UNITS: Mapping[str, str] = {"dx": "m^2/s^2", "dtheta": "rad^2/s^2", "X": "m^2", "Y": "m^2", "theta": "rad^2"}
_STRAIGHT = ("case1", "case2")
_DRAWN_IN: Mapping[str, tuple[str, float]] = {"X": ("mm", 1e3), "Y": ("µm", 1e6), "theta": ("mrad", 1e3)}
"""Unit and scale in which noise is drawn."""
_SHOWN = 2.0
"""Duration of what is drawn [s]."""


class _Case(NamedTuple):
    """A test case of Tab. 3.3 as the simulated lab records it."""

    motion: Trajectory
    """True motion at the filter's instants."""
    filtered: Trajectory
    """Output of the state filter on noisy encoders and gyro."""


def _drive(case: Mapping[str, float]) -> tuple[Trajectory, Drive]:
    """Return the MuJoCo Husky's motion under a case's command, from the lead-in's end on, and the robot's drive."""
    profile = load_profile(_PROFILE)
    n = round((_LEAD + _TIME) / COMMAND_PERIOD)
    command = Commands(COMMAND_PERIOD, np.tile([case["cmd_u_m_s"], case["cmd_omega_rad_s"]], (n, 1)))
    motion = make_plant(profile, _PLANT).run(command, State(), 1.0 / _RATE)
    kept = motion.t >= _LEAD
    return Trajectory(motion.t[kept], motion.pose[kept], motion.twist[kept], motion.wheels[kept]), profile.plants[
        _PLANT
    ].drive


def _filtered(motion: Trajectory, drive: Drive, seed: int) -> Trajectory:
    """Return what the state filter makes of noisy encoders and gyro."""
    log = simulate_sensors(motion, np.random.default_rng(seed), rate=_RATE)
    (x, y, yaw), (v, _, w) = motion.pose[0].tolist(), motion.twist[0].tolist()
    return run_ekf(log.t, log.left, log.right, log.gyro, odometry_of(drive), State(x, y, yaw, v_x=v, yaw_rate=w))


def _signals(motion: Trajectory) -> dict[str, FloatArray]:
    return dict(zip(_SIGNALS, (motion.twist[:, 0], motion.twist[:, 2], *motion.pose.T), strict=True))


def _noises(signals: Mapping[str, FloatArray], t: FloatArray) -> dict[str, NoisySignal]:
    """Return the noise of signals as the thesis takes it, as the study that users have does."""
    group = Group("state filter", t, signals)
    return {name: noise_of(group, name) for name in signals}


def _variances(signals: Mapping[str, FloatArray], t: FloatArray) -> dict[str, float]:
    return {name: noise.estimate.variance for name, noise in _noises(signals, t).items()}


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


class _Lab(NamedTuple):
    """Variances that the thesis' procedure finds, by seed, for every case and signal."""

    regular: Mapping[str, Mapping[str, Sequence[float]]]
    """Of the state filter's output."""
    jittered: Mapping[str, Mapping[str, Sequence[float]]]
    """Of the same with stamps that are wrong by `_JITTER`."""
    again: Mapping[str, Mapping[str, Sequence[float]]]
    """Of the noise that the thesis' simulation adds."""


def _measured(seeds: Sequence[int]) -> tuple[_Lab, _Case]:
    """Return the variances of all cases, and one run of the faster straight case for the picture."""
    found: list[dict[str, dict[str, list[float]]]] = [{}, {}, {}]
    for number, (name, case) in enumerate(published.table("3.3")["rows"].items()):
        motion, drive = _drive(case)
        for k, seed in enumerate(seeds):
            filtered, rng = _filtered(motion, drive, seed), np.random.default_rng([seed, number])
            if name == _STRAIGHT[-1] and k == 0:
                shown = _Case(motion, filtered)
            added = measure(motion, SensorNoise(), rng, _RATE)
            for kind, each in zip(found, (filtered, late(motion, filtered, _JITTER, rng), added), strict=True):
                for signal, variance in _variances(_signals(each), motion.t).items():
                    kind.setdefault(name, {s: [] for s in _SIGNALS})[signal].append(variance)
    return _Lab(*found), shown


def _table(lab: _Lab) -> Table:
    rows = {}
    for signal, printed in published.table("3.4")["rows"].items():
        regular, jittered, again = (np.mean([kind[case][signal] for case in _STRAIGHT], axis=0) for kind in lab)
        spread = float(np.std(regular, ddof=1)) if len(regular) > 1 else None
        beside = {"with jitter": float(jittered.mean()), "of what is simulated": float(again.mean())}
        pair = Pair(printed["value"], float(regular.mean()), "spread", _UNITS[signal], spread, beside)
        rows[signal] = {"variance": pair}
    return Table("Variance above 10 Hz of the state filter's output, straight runs", rows)


def _grid(lab: _Lab) -> Grid:
    def rows(kind: Mapping[str, Mapping[str, Sequence[float]]], stamps: str) -> tuple[tuple[Cell, ...], ...]:
        cases = published.table("3.3")["rows"]
        return tuple(
            (
                Cell(f"{cases[case]['cmd_u_m_s']:g}"), Cell(f"{cases[case]['cmd_omega_rad_s']:g}"), Cell(stamps),
                *(Cell(f"{np.mean(values):.2g}") for values in signals.values()),
            )
            for case, signals in kind.items()
        )  # fmt: skip

    header = (("cmd_u", "m/s"), ("cmd_omega", "rad/s"), ("stamps", ""), *((s, "") for s in _SIGNALS))
    return Grid(header, (rows(lab.regular, "exact"), rows(lab.jittered, f"± {1e3 * _JITTER:g} ms")), 3)


def _draw_speed(shown: _Case, rebuilt: FloatArray, ax: Axes) -> None:
    t = shown.motion.t
    seen = t < t[0] + _SHOWN
    ax.plot(t[seen], shown.filtered.twist[seen, 0], ".", color="0.3", markersize=4.0, gid="measured")
    ax.step(t[seen], rebuilt[seen], where="post", color=ink_of("improved"), linewidth=1.1, gid="rebuilt")
    ax.set(title="Fig. 3.17: dx [m/s] at a command of 0.5", xlabel="time [s]", xlim=(t[0], t[0] + _SHOWN))


def _draw_spectra(found: NoisySignal, rebuilt: NoisySignal, ax: Axes) -> None:
    for noise, ink, name in ((found, "0.3", "state filter"), (rebuilt, ink_of("improved"), "rebuilt")):
        ax.loglog(*noise.spectrum, color=ink, linewidth=1.2, gid=name)
    ax.axvline(found.filter.passband, color=QUIET, linewidth=0.9, linestyle=DASHED)
    for axis in (ax.xaxis, ax.yaxis):
        plain_ticks(axis)
    ax.set(title="density of dx [m²/s²/Hz]", xlabel="frequency [Hz]")


def _draw_added(signal: str, found: NoisySignal, added: FloatArray, t: FloatArray, ax: Axes) -> None:
    at, noise = found.shown
    seen = (at >= at[0]) & (at < at[0] + _SHOWN)
    unit, scale = _DRAWN_IN[signal]
    ax.step(at[seen], scale * added[: len(at)][seen], where="post", color=ink_of("improved"), linewidth=1.0, gid="added")
    ax.plot(at[seen], scale * noise[seen], color="0.3", linewidth=1.0, marker=".", markersize=3.0, gid="left")
    ax.set(title=f"Fig. 3.16: noise of {signal} [{unit}]", xlabel="time [s]", xlim=(at[0], at[0] + _SHOWN))


def draw_reconstruction(shown: _Case, seed: int) -> Figure:
    """Draw Fig. 3.17, the filter's dx beside what the simulation makes of it, and below it Fig. 3.16, the added noise."""
    motion, rng = shown.motion, np.random.default_rng([seed, 99])
    profile = load_profile(_PROFILE)
    n = round((_LEAD + _TIME) / COMMAND_PERIOD)
    model = make_plant(profile, "improved").run(Commands(COMMAND_PERIOD, np.tile([0.5, 0.0], (n, 1))), State(), 1.0 / _RATE)
    kept = model.t >= _LEAD
    clean = Trajectory(model.t[kept], model.pose[kept], model.twist[kept], model.wheels[kept])
    rebuilt = measure(clean, SensorNoise(), rng, _RATE)
    found, again = (_noises(_signals(m), motion.t) for m in (shown.filtered, rebuilt))
    added = _signals(Trajectory(clean.t, rebuilt.pose - clean.pose, rebuilt.twist - clean.twist, clean.wheels))
    above: list[Panel] = [partial(_draw_speed, shown, rebuilt.twist[:, 0]), partial(_draw_spectra, found["dx"], again["dx"])]
    below: list[Panel] = [partial(_draw_added, s, found[s], added[s], motion.t) for s in ("X", "Y", "theta")]
    foot = f"the MuJoCo Husky of profile {_PROFILE} with noisy encoders and gyro, its state filter at {_RATE:g} Hz"
    rows = [side_by_side(2.9, above), side_by_side(2.6, below), text_row(0.3, _legend)]
    return put_together([*rows, text_row(0.3, partial(draw_footer, foot))])


def _legend(ax: Axes) -> None:
    ax.set_axis_off()
    handles = [Line2D([], [], color="0.3", marker=".", linewidth=0.8), Line2D([], [], color=ink_of("improved"))]
    line_legend(ax, handles, ["state filter in the simulated lab; below, what is left of it above 10 Hz",
                              "improved model with the printed white noise; below, the noise alone"])  # fmt: skip


def _noise(context: Context) -> Findings:
    """Repeat Sec. 3.4.4 in the simulated lab."""
    seeds = range(context.settings.noise_seeds)
    lab, shown = _measured(seeds)
    kept = _noises(_signals(shown.filtered), shown.motion.t)["dx"].filter.kept
    notes = (
        f"The four cases of Tab. 3.3 for {_TIME:g} s each, after {_LEAD:g} s to get up to speed, with {len(seeds)} draws of "
        f"the sensors' noise; the spread is that over the draws. The filter is the thesis', at {_RATE:g} Hz.",
        f"Of white noise at {_RATE:g} Hz, the high-pass filter lets {100.0 * kept:.0f} % of the variance pass. The thesis "
        "adds white noise of the variance that passed, so the noise in its simulation is too weak by as much: the last "
        "column is what the procedure finds in it. Our encoders and gyro have the printed variances; the state filter and "
        "the high-pass filter take their shares.",
        "The printed variance of X is a million times that of Y. The state filter integrates speeds, so neither has such "
        f"noise by itself. Stamps that are wrong by {1e3 * _JITTER:g} ms (standard deviation) give it: by then X has moved "
        "on by as much times the speed, Y has not in a straight run, and dx hardly changes. A real Husky's odometry shows "
        "such noise (docs/logs.md).",
        "Fig. 3.16 is a block diagram; what its blocks add is drawn here.",
    )
    caption = (
        "Above, Fig. 3.17: dx as the state filter gives it and as the simulation rebuilds it, and the spectra of both. "
        "Below, what the blocks of Fig. 3.16 add to X, Y and theta, and what is left of the state filter's output."
    )
    return Findings(
        {"3.4": _table(lab)},
        {"Each case of Tab. 3.3: variance above 10 Hz of the state filter's output": _grid(lab)},
        notes,
        (context.picture("filter", draw_reconstruction(shown, context.settings.seed), caption),),
    )


NOISE_SECTIONS = (Section("noise", "Noise of the state filter", ("3.4",), ("seed", "noise_seeds"), _noise),)
"""The section on the sensors' noise."""
