"""Draw the figure of docs/warthog.md, and print the numbers of its tables.

Run from the project's root: `python docs/make_warthog_figure.py warthog_grass_train.csv` with the
path of the recording. It takes a minute.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ssmr.geometry import integrate_rates, relative_pose, rotate_body_to_world, wrap_angle
from ssmr.metrics.paired import chance_of_difference
from ssmr.metrics.windows import WindowErrors, overlapping_windows
from ssmr.types import FloatArray, IndexArray, Trajectory
from validation.experiment.runs import drive_piece
from validation.experiment.sources import Piece, Source, open_source
from validation.plants.profile import Profile, load_profile, make_plant
from validation.plants.table import plant_kind
from validation.report.palette import spell_name

OUT = Path(__file__).parent / "img" / "warthog.png"
PROFILE = "warthog-grass"
SPLIT = 200.0
"""End of the part that the profile was fitted to [s]."""
COMMANDED = ((103.2, 126.1), (192.4, 200.0)), ((205.6, 249.0),)
"""Spans in which the robot obeys its commands [s]: those of the driver's fit, and a held-out one
that begins at rest."""
_MOVES = 0.3
"""A window counts if the wheels of a side turn by at least this much [rad]."""
_ROUNDS = 30
_SMALL = 0.01
_PLANTS = ("mujoco", "kinematic", "linear", "coulomb", "improved")


def moving_windows(piece: Piece, horizon: float) -> tuple[IndexArray, IndexArray]:
    """Return (W,) starts and ends of the windows of a piece in which wheels turn."""
    assert piece.t is not None
    assert piece.reference is not None
    way = np.abs(piece.reference.wheels[:-1]).max(axis=1) * np.diff(piece.t)
    turned = np.cumulative_sum(way, include_initial=True)
    starts, ends = piece.windows(overlapping_windows, piece.t, horizon)
    moves = turned[ends] - turned[starts] > _MOVES
    return starts[moves], ends[moves]


def signed_errors(source: Source, poses: list[FloatArray], horizon: float) -> FloatArray:
    """Return (W, 3) errors ahead, to the left [m] and of heading [rad] of all moving windows."""
    rows = []
    for piece, pose in zip(source.pieces, poses, strict=True):
        assert piece.reference is not None
        starts, ends = moving_windows(piece, horizon)
        true, made = (relative_pose(p[starts], p[ends]) for p in (piece.reference.pose, pose))
        error = relative_pose(true, made)
        error[:, 2] = wrap_angle(error[:, 2])
        rows.append(error)
    return np.concatenate(rows)


def window_errors(source: Source, profile: Profile, plant: str) -> WindowErrors:
    """Return the errors of a plant after 6 s, over the windows in which wheels turn."""
    made = make_plant(profile, plant)
    localiser = profile.plants[plant].localiser
    poses = [drive_piece(made, piece, localiser, source.sample_dt).pose for piece in source.pieces]
    error = signed_errors(source, poses, 6.0)
    return WindowErrors(6.0, np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2]))


def gyro_errors(source: Source) -> tuple[float, FloatArray]:
    """Return the heading's delay behind the gyro [s], (W,) errors of the gyro after 6 s [rad]."""
    rows = []
    for late in np.arange(0.2, 0.5, 0.02):
        off = []
        for piece in source.pieces:
            assert piece.t is not None
            assert piece.reference is not None
            starts, ends = moving_windows(piece, 6.0)
            t, rate = piece.t, piece.reference.twist[:, 2]  # the gyro's
            heading = integrate_rates(t, rate)
            turned = np.interp(t[ends] - late, t, heading) - np.interp(t[starts] - late, t, heading)
            off.append(
                np.abs(turned - (piece.reference.pose[ends, 2] - piece.reference.pose[starts, 2]))
            )
        rows.append((float(late), np.concatenate(off)))
    return min(rows, key=lambda pair: float(pair[1].mean()))


class Drift:
    """Kinematics that may drift sideways: v_y = -k v omega, where k is 0 for the usual ones."""

    NAMES = (
        "radius",
        "difference",
        "half-track",
        "late",
        "tracked_x",
        "tracked_y",
        "tracked_yaw",
        "k",
    )
    START = np.array([0.287, -0.006, 0.9, 0.26, 0.0, 0.0, 0.0, 0.0])

    def __init__(self, source: Source, horizons: tuple[float, ...]) -> None:
        """Keep the recording and the horizons of the fit [s]."""
        self._source = source
        self._horizons = horizons

    def errors(self, x: FloatArray, horizon: float) -> FloatArray:
        """Return (W, 3) errors as `signed_errors` does, for the numbers `NAMES`."""
        radius, difference, half_track, late, t_x, t_y, t_yaw, k = x
        poses = []
        for piece in self._source.pieces:
            assert piece.t is not None
            dt = piece.commands.dt
            rates = piece.commands.values * (radius + difference * np.array([0.5, -0.5]))
            v = rates.mean(axis=1)
            w = (rates[:, 1] - rates[:, 0]) / (2.0 * half_track)
            yaw = np.cumulative_sum(w, include_initial=True) * dt
            steps = (
                rotate_body_to_world(np.column_stack([v, -k * v * w]), yaw[:-1] + 0.5 * w * dt) * dt
            )
            path = np.cumulative_sum(steps, axis=0, include_initial=True)
            path = path + rotate_body_to_world(np.tile([t_x, t_y], (len(path), 1)), yaw)
            reported = piece.t - piece.t[0] - late
            clock = dt * np.arange(len(yaw))
            columns = [np.interp(reported, clock, c) for c in (*path.T, yaw + t_yaw)]
            poses.append(np.column_stack(columns))
        return signed_errors(self._source, poses, horizon)

    def cost(self, x: FloatArray) -> float:
        """Return the mean of position errors [m] plus yaw errors [rad], over the horizons."""
        measured = [self.errors(x, h) for h in self._horizons]
        return float(
            np.mean([np.hypot(e[:, 0], e[:, 1]).mean() + np.abs(e[:, 2]).mean() for e in measured])
        )

    def fit(self, drifts: bool) -> FloatArray:
        """Return the numbers with the least cost; k is 0 unless the robot `drifts`."""
        x = self.START.copy()
        free = np.eye(len(self.START))[: None if drifts else -1]
        for _ in range(_ROUNDS):
            measured = [self.errors(x, h) for h in self._horizons]
            weight = [
                np.stack([1 / np.maximum(np.hypot(e[:, 0], e[:, 1]), _SMALL)] * 2, 1)
                for e in measured
            ]
            weight = [
                np.column_stack([p, 1 / np.maximum(np.abs(e[:, 2]), _SMALL)])
                for p, e in zip(weight, measured, strict=True)
            ]
            scale = np.concatenate([np.sqrt(p / len(p)).ravel() for p in weight])
            now = np.concatenate([e.ravel() for e in measured])
            there = [
                np.concatenate([self.errors(x + 1e-4 * d, h).ravel() for h in self._horizons])
                for d in free
            ]
            slope = np.column_stack([(e - now) * 1e4 for e in there])
            step = np.linalg.lstsq(slope * scale[:, None], -now * scale, rcond=None)[0] @ free
            best = min((x + f * step for f in (1.0, 0.5, 0.2)), key=self.cost)
            if self.cost(best) > self.cost(x) * (1.0 - 1e-4):
                return x
            x = best
        return x


def wheel_rates(
    path: str, span: tuple[float, float], profile: Profile, plant: str
) -> tuple[FloatArray, FloatArray, Trajectory]:
    """Return stamps [s], (N, 2) measured wheel rates [rad/s] and a plant's motion."""
    (by_command,), (by_wheels,) = (
        open_source(path, kind, *span).pieces for kind in ("twist", "wheels")
    )
    section = profile.plants[plant]
    motion = make_plant(profile, plant).run(
        by_command.commands, section.localiser.body_state(by_command.start), 0.01
    )
    measured = by_wheels.commands.values
    n = min(len(measured), len(motion.t))
    assert by_command.t is not None
    short = replace(
        motion,
        t=motion.t[:n],
        pose=motion.pose[:n],
        twist=motion.twist[:n],
        wheels=motion.wheels[:n],
        channels={},
    )
    return by_command.t[0] + motion.t[:n], measured[:n], short


def main(path: str) -> None:
    """Print the page's numbers and draw its figure."""
    profile = load_profile(PROFILE)
    parts = {"fitted": (None, SPLIT), "held out": (SPLIT, None)}
    scores: dict[tuple[str, str], WindowErrors] = {}
    for name, span in parts.items():
        source = open_source(path, "wheels", *span)
        for plant in _PLANTS:
            scores[name, plant] = window_errors(source, profile, plant)
            s = scores[name, plant].summary()
            yaw = f"{s.yaw_median_rad:.3f} ({s.yaw_low_rad:.3f}-{s.yaw_high_rad:.3f}) rad"
            span_m = f"{s.position_median_m:.3f} ({s.position_low_m:.3f}-{s.position_high_m:.3f}) m"
            mine = scores[name, plant]
            other = scores[name, "mujoco"]
            pairs = ((mine.position, other.position), (mine.yaw, other.yaw))
            times = np.arange(float(s.n))
            chances = [chance_of_difference(a, b, times, 6.0) for a, b in pairs]
            print(
                f"{name}, {plant}: {s.n} windows, {span_m}, {yaw}, as good as mujoco by chance: "
                f"{chances}"
            )
        horizons = (6.0, 15.0) if name == "fitted" else (6.0,)
        for drifts in (False, True):
            kinematics = Drift(source, horizons)
            x = kinematics.fit(drifts)
            e = kinematics.errors(x, 6.0)
            distance = np.median(np.hypot(e[:, 0], e[:, 1]))
            medians = f"{distance:.3f} m, {np.median(np.abs(e[:, 2])):.3f} rad"
            measured = ", ".join(
                f"{label} {value:.4f}" for label, value in zip(Drift.NAMES, x, strict=True)
            )
            print(
                f"  kinematics fitted to this part: cost {kinematics.cost(x):.4f}, {medians}; "
                f"{measured}"
            )
        late, off = gyro_errors(source)
        print(
            f"  the gyro's heading, {late:.2f} s late: median {np.median(off):.3f} rad, "
            f"mean {off.mean():.3f} rad"
        )
    figure = Figure(figsize=(11.0, 6.4), layout="constrained")
    errors, rates = figure.subplots(2, 1)
    draw_errors(errors, scores)
    for plant in _PLANTS:
        for name, spans in zip(parts, COMMANDED, strict=True):
            rates_off = np.concatenate(
                [
                    np.abs(m.wheels - w)
                    for _, w, m in (wheel_rates(path, s, profile, plant) for s in spans)
                ]
            )
            print(f"wheel rates from commands, {name}, {plant}: {rates_off.mean():.3f} rad/s")
    draw_rates(rates, path, profile)
    figure.savefig(OUT)


def draw_errors(axes: Axes, scores: dict[tuple[str, str], WindowErrors]) -> None:
    """Draw medians and 90 % intervals of position errors by plant and part."""
    for k, name in enumerate(("fitted", "held out")):
        for i, plant in enumerate(_PLANTS):
            s = scores[name, plant].summary()
            at = k * (len(_PLANTS) + 1) + i
            axes.plot(
                [at, at],
                [s.position_low_m, s.position_high_m],
                color=plant_kind(plant).colour,
                lw=3,
            )
            axes.plot(
                at,
                s.position_median_m,
                "o",
                color=plant_kind(plant).colour,
                label=None if k else spell_name(plant),
            )
    counts = [scores[name, "mujoco"].summary().n for name in ("fitted", "held out")]
    labels = [f"fitted to, {counts[0]} windows", f"held out, {counts[1]} windows"]
    axes.set_xticks([2, len(_PLANTS) + 3], labels)
    axes.set(
        ylabel="position error after 6 s [m]", ylim=(0.0, None), title="From measured wheel rates"
    )
    axes.legend(ncols=5, loc="lower center")
    axes.grid(alpha=0.3)


def draw_rates(axes: Axes, path: str, profile: Profile) -> None:
    """Draw measured and simulated wheel rates of the held-out commands."""
    (span,) = COMMANDED[1]
    for plant in ("mujoco", "kinematic"):
        t, measured, motion = wheel_rates(path, span, profile, plant)
        for side, dashes in ((0, "-"), (1, "--")):
            if plant == "mujoco":
                axes.plot(
                    t,
                    measured[:, side],
                    "k",
                    ls=dashes,
                    lw=1.6,
                    label=None if side else "measured",
                )
            label = spell_name(plant) if side == 0 else None
            axes.plot(
                t,
                motion.wheels[:, side],
                ls=dashes,
                lw=1.2,
                color=plant_kind(plant).colour,
                label=label,
            )
    axes.set(
        xlabel="time [s]",
        ylabel="wheel rate [rad/s]",
        title="From commands, held out (dashed: right side)",
        xlim=span,
    )
    axes.legend(ncols=3)
    axes.grid(alpha=0.3)


if __name__ == "__main__":
    main(sys.argv[1])
