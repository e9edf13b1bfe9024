"""The chapter on the real robot: errors of the plants of `husky-tile` against a recorded drive, by speed and yaw rate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ssmr.metrics.paths import path_length
from ssmr.metrics.poses import horizon_windows, relative_pose_error
from ssmr.types import CommandKind, FloatArray
from validation import store
from validation.bench.sources import Source, source_of
from validation.compare import compare
from validation.files.formats import read_log
from validation.files.log import COMMAND_COLUMNS, POSE_COLUMNS, Log
from validation.files.signals import fresh_poses
from validation.plants.profile import Profile, load_profile
from validation.plants.table import USUAL_PLANTS
from validation.replicate.evidence import Context, Findings, Section
from validation.replicate.figures import BinnedErrors, draw_residuals
from validation.report.motions import Comparison
from validation.report.tables import Cell, Grid

_PROFILE = "husky-tile"
_DRIVEN_BY: tuple[tuple[Literal["wheels", "commands"], CommandKind, str], ...] = (
    ("wheels", "wheels", "measured wheel rates"),
    ("commands", "twist", "commands"),
)
_HORIZONS = (2.0, 6.0, 30.0)
"""Horizons of the table [s]."""
_WINDOW = 2.0
"""Length of the windows whose errors are sorted by speed and yaw rate [s]; commands of the log last six seconds."""
SPEED_EDGES = (0.0, 0.1, 0.2, 0.3, 0.6)
YAW_RATE_EDGES = (0.0, 0.1, 0.3, 0.6, 1.5)
"""Edges of the bins [m/s] and [rad/s]."""
_FEW = 5
"""Least number of windows of a bin; one with fewer is left empty."""
NOT_RUN = (
    "Not run: no recording was given. `python -m validation.replicate --recording PATH` drives every plant of profile "
    "husky-tile along the log of a real Husky, such as husky_tile_train.csv of the DRIVE data set (norlab-ulaval)."
)


def _real(context: Context) -> Findings:
    """Compare the plants with the recording; without one, say so."""
    settings = context.settings
    if not settings.recording:
        return Findings(notes=(NOT_RUN,))
    profile, recording = load_profile(_PROFILE), read_log(settings.recording).on_one_clock()
    split = settings.split
    if split is None:  # the end of what the profile was fitted to, if its provenance says it
        until = profile.provenance.get("mujoco", {}).get("until")
        split = float(until) if until is not None else None
    parts = {"everything": recording}
    if split is not None and float(recording.t[0]) < split < float(recording.t[-1]):
        parts = {"fitted to": recording.cut(None, split), "held out": recording.cut(split, None)}
    inputs = inputs_of(recording)
    found: dict[tuple[str, str], Comparison] = {}
    pictures, worst, numbers = [], [], {}
    for input_, kind, words in inputs:
        sources = {part: source_of(piece, "recording", kind) for part, piece in parts.items()}
        for part, source in sources.items():
            found[input_, part] = compare(
                source, profile, USUAL_PLANTS, input=input_, horizons=_HORIZONS, workers=context.workers
            )
        last = list(parts)[-1]
        caption = f"The plants driven by {words}, {last}: paths over windows, errors by horizon, yaw rate and speed."
        pictures.append(context.picture(f"paths-{input_}", found[input_, last].figure(), caption))
        residuals = _binned([(found[input_, part], source) for part, source in sources.items()])
        caption = (
            f"Errors by motion, plants driven by {words}: median over windows of {_WINDOW:g} s, by recorded speed and yaw "
            "rate. The grey numbers on the left count the windows."
        )
        pictures.append(context.picture(f"residuals-{input_}", draw_residuals(residuals, f"driven by {words}"), caption))
        worst += [worst_of(residuals, words), *_straight_of(residuals, profile, words)]
        numbers[f"residuals_{input_}"] = {
            "window_s": residuals.window,
            "speed_edges_m_s": list(residuals.speeds),
            "yaw_rate_edges_rad_s": list(residuals.yaw_rates),
            "windows": residuals.count.tolist(),
            "position_median_m": store.plain({name: m[0].tolist() for name, m in residuals.medians.items()}),
            "yaw_median_rad": store.plain({name: m[1].tolist() for name, m in residuals.medians.items()}),
        }
    horizons: dict[str, dict[str, Any]] = {}
    for (signals, part), comparison in found.items():
        horizons.setdefault(signals, {})[part] = {
            name: {f"{h:g}": dict(vars(errors)) for h, errors in result.horizons.items()}
            for name, result in comparison.plants.items()
        }
    return Findings(
        grids={
            f"Median pose errors by horizon, plant and input; windows: {_counts(found)}": _horizon_grid(found),
            "What was recorded": _data_grid(recording, parts),
        },
        notes=(f"{profile.description.rstrip('.')}.", *worst, *_limits_of_data(recording, parts), *_centre_of_mass(profile)),
        pictures=tuple(pictures),
        numbers={"profile": profile.name, "split_s": split, "horizons": horizons, **numbers},
    )


def require_usable(path: str | Path) -> None:
    """Refuse a recording that cannot drive the plants.

    Raises:
        ValueError: it cannot be read, or lacks signals or poses.
    """
    inputs_of(read_log(path).on_one_clock())


def inputs_of(recording: Log) -> list[tuple[Literal["wheels", "commands"], CommandKind, str]]:
    """Return which signals of a recording can drive the plants.

    Raises:
        ValueError: it has neither wheel rates nor commands, or no poses to compare with.
    """
    found = [each for each in _DRIVEN_BY if recording.has(COMMAND_COLUMNS[each[1]])]
    if not found:
        raise ValueError(f"{recording.name} has neither wheel rates (enc_left, enc_right) nor commands (cmd_v, cmd_w)")
    for _, kind, _ in found:
        source_of(recording, recording.name, kind)
    return found


def _counts(found: Mapping[tuple[str, str], Comparison]) -> str:
    counts = {}
    for (_, part), comparison in found.items():
        errors = next(iter(comparison.plants.values())).horizons
        counts[part] = ", ".join(f"{e.n} of {h:g} s" for h, e in errors.items())
    return "; ".join(f"{part} {text}" for part, text in counts.items())


def _horizon_grid(found: Mapping[tuple[str, str], Comparison]) -> Grid:
    """Return position [m] and yaw errors [rad] by input, part, plant and horizon; the best of a group is emphasised."""
    horizons = [h for h in _HORIZONS if all(h in r.horizons for c in found.values() for r in c.plants.values())]
    header = [("input", ""), ("part", ""), ("plant", "")]
    header += [(f"{what} {h:g} s", unit) for h in horizons for what, unit in (("position", "m"), ("yaw", "rad"))]
    groups = []
    for (input_, part), comparison in found.items():
        values = {
            name: [v for h in horizons for v in (r.horizons[h].position_median_m, r.horizons[h].yaw_median_rad)]
            for name, r in comparison.plants.items()
        }
        least = [f"{min(column):.3f}" for column in zip(*values.values(), strict=True)]
        rows = []
        for name, row in values.items():
            cells = [Cell(f"{v:.3f}", f"{v:.3f}" == b) for v, b in zip(row, least, strict=True)]
            rows.append((*map(Cell, (input_, part, name)), *cells))
        groups.append(tuple(rows))
    return Grid(tuple(header), tuple(groups), left=3)


def _data_grid(recording: Log, parts: Mapping[str, Log]) -> Grid:
    """Return duration, length and rates of the recording and of its parts."""
    header = (("part", ""), ("time", "s"), ("pieces", "1"), ("path", "m"), ("poses", "Hz"), ("speed p95", "m/s"),
              ("yaw rate p95", "rad/s"))  # fmt: skip
    rows = []
    for name, part in {**parts, **({"all": recording} if len(parts) > 1 else {})}.items():
        pose, segments = part.table(POSE_COLUMNS), part.stretches()
        new = [fresh_poses(part.t[s], pose[s]) for s in segments]
        time = sum(float(part.t[s][-1] - part.t[s][0]) for s in segments)
        length = sum(path_length(pose[s][f, :2]) for s, f in zip(segments, new, strict=True) if int(np.sum(f)) > 1)
        fresh = sum(int(np.sum(f)) for f in new)
        speed, rate = _speeds(part)
        numbers = (f"{time:.0f}", str(len(segments)), f"{length:.0f}", f"{fresh / max(time, 1e-9):.1f}",
                   f"{np.percentile(speed, 95.0):.2f}", f"{np.percentile(rate, 95.0):.2f}")  # fmt: skip
        rows.append((Cell(name), *map(Cell, numbers)))
    return Grid(header, (tuple(rows),), left=1)


def _speeds(recording: Log) -> tuple[FloatArray, FloatArray]:
    """Return the (M,) sizes of speed [m/s] and yaw rate [rad/s] of all recorded poses."""
    pieces = source_of(recording, "recording", inputs_of(recording)[0][1]).pieces
    twist = np.concatenate([p.reference.twist for p in pieces if p.reference is not None])
    return np.hypot(twist[:, 0], twist[:, 1]), np.abs(twist[:, 2])


def _binned(driven: Sequence[tuple[Comparison, Source]]) -> BinnedErrors:
    """Return the median errors of every plant over consecutive windows, by recorded speed and yaw rate."""
    speeds: list[float] = []
    rates: list[float] = []
    errors: dict[str, list[tuple[float, float]]] = {}
    for comparison, source in driven:
        for k, piece in enumerate(source.pieces):
            if piece.reference is None or piece.t is None:
                continue
            starts, ends = piece.windows(horizon_windows, piece.t, _WINDOW)
            pose = piece.reference.pose
            for i, j in zip(starts, ends, strict=True):
                span = float(piece.t[j] - piece.t[i])
                new = slice(None) if piece.fresh is None else piece.fresh[i : j + 1]
                speeds.append(path_length(pose[i : j + 1, :2][new]) / span)
                rates.append(abs(float(pose[j, 2] - pose[i, 2])) / span)
            for name, result in comparison.plants.items():
                position, yaw = relative_pose_error(result.pieces[k].pose, pose, starts, ends)
                errors.setdefault(name, []).extend(zip(position.tolist(), yaw.tolist(), strict=True))
    column = np.digitize(rates, YAW_RATE_EDGES) - 1
    row = np.digitize(speeds, SPEED_EDGES) - 1
    shape = len(SPEED_EDGES) - 1, len(YAW_RATE_EDGES) - 1
    count = np.zeros(shape, dtype=np.int64)
    medians = {name: np.full((2, *shape), np.nan) for name in errors}
    for i, j in np.ndindex(*shape):
        inside = (row == i) & (column == j)
        count[i, j] = int(np.sum(inside))
        if count[i, j] >= _FEW:
            for name, values in errors.items():
                medians[name][:, i, j] = np.median(np.array(values)[inside], axis=0)
    return BinnedErrors(SPEED_EDGES, YAW_RATE_EDGES, count, medians, _WINDOW)


def worst_of(residuals: BinnedErrors, words: str) -> str:
    """Return a sentence with the bin in which each plant has its greatest yaw error."""
    if not np.any(residuals.count >= _FEW):
        return f"Driven by {words}, no bin of speed and yaw rate holds {_FEW} windows of {_WINDOW:g} s."
    parts = []
    for name, (_, yaw) in residuals.medians.items():
        i, j = np.unravel_index(int(np.nanargmax(yaw)), yaw.shape)
        parts.append(
            f"{name} {yaw[i, j]:.3f} rad at {residuals.speeds[i]:g}–{residuals.speeds[i + 1]:g} m/s and "
            f"{residuals.yaw_rates[j]:g}–{residuals.yaw_rates[j + 1]:g} rad/s (least {np.nanmin(yaw):.3f})"
        )
    return f"Driven by {words}, the greatest median yaw error of a bin after {_WINDOW:g} s is: {'; '.join(parts)}."


def _straight_of(residuals: BinnedErrors, profile: Profile, words: str) -> list[str]:
    """Return a sentence on driving straight and fast, where unequal wheel radii matter; none without data."""
    fast = [i for i in range(residuals.count.shape[0]) if residuals.count[i, 0] >= _FEW]
    if not fast:
        return []
    i = fast[-1]
    errors = ", ".join(f"{name} {yaw[i, 0]:.3f}" for name, (_, yaw) in residuals.medians.items())
    radii = {
        "mujoco": profile.plants["mujoco"].parameters.radius_difference,
        **{name: profile.plants[name].vehicle.radius_difference for name in ("improved", "coulomb", "linear")},
    }
    differences = ", ".join(f"{1e3 * float(value):.1f} ({name})" for name, value in radii.items())
    return [
        f"Straight ahead (below {residuals.yaw_rates[1]:g} rad/s) at {residuals.speeds[i]:g} m/s and more, driven by "
        f"{words}, the median yaw errors are {errors} rad. In this profile the wheel radii of the two sides differ by "
        f"{differences} mm; the kinematics have a factor for each side."
    ]


def _limits_of_data(recording: Log, parts: Mapping[str, Log]) -> list[str]:
    """Return sentences on what the recording cannot show."""
    speed, rate = _speeds(recording)
    gaps = len(recording.stretches()) - 1
    out = [
        f"Limits of the data: one robot on one floor, {gaps} gap{'s' * (gaps != 1)}; half of the time it moves at less than "
        f"{np.median(speed):.2f} m/s and turns at less than {np.median(rate):.2f} rad/s, and speed hardly exceeds "
        f"{np.percentile(speed, 99.0):.2f} m/s. It says nothing about other grounds, loads or speeds.",
        "New poses and wheel rates come less often than they are logged (table above); windows begin and end at new poses "
        "only. The median of n windows is uncertain by about 1.25 standard deviations over √n, so differences between "
        "plants of less than a tenth are not significant.",
    ]
    if len(parts) == 1:
        out.append("No part of it is held out: the part that these plants were fitted to is scored with the rest.")
    return out


def _centre_of_mass(profile: Profile) -> list[str]:
    """Return the finding of docs/centre_of_mass.md with the profile's own numbers."""
    husky = profile.plants["mujoco"].parameters
    errors = profile.provenance.get("mujoco", {}).get("standard_errors", {})

    def place(axis: str, positive: str, negative: str) -> str:
        value, error = float(getattr(husky, f"com_{axis}")), errors.get(f"com_{axis}")
        spread = f" ± {1e3 * error:.0f}" if error is not None else ""
        return f"{1e3 * abs(value):.0f}{spread} mm {positive if value >= 0.0 else negative}"

    return [
        "Centre of mass (docs/centre_of_mass.md): fitted with equal friction in all directions, it lies "
        f"{place('x', 'ahead of', 'behind')} the middle between the axles and "
        f"{place('y', 'to the left', 'to the right')}. The places in the maker's robot descriptions (85 mm to the right, "
        "87 mm to the rear) do not explain the recording then. But with 5 % less grip sideways than ahead, a centre in the "
        "middle explains it as well. Motion alone cannot decide between these; weighing the axles would."
    ]


REAL_SECTIONS = (Section("real", "A real Husky on tile", (), ("recording", "split"), _real),)
"""The section of the real robot."""
