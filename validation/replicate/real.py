"""The real robot's chapter: how far the plants of `husky-tile` are from a recorded drive, and where each one fails."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from ssmr.metrics.paths import path_length
from ssmr.metrics.poses import horizon_windows, relative_pose_error
from ssmr.types import CommandKind
from validation.compare.figure import comparison_figure
from validation.compare.result import Comparison
from validation.compare.run import CompareSettings, compare
from validation.logs.formats import read_recording
from validation.logs.recording import Recording
from validation.motion.sources import Source, source_of
from validation.plants.profile import PLANTS, Profile, load
from validation.replicate.evidence import Context, Findings, Picture, Section
from validation.replicate.residual_figure import Residuals, draw_residuals
from validation.show.tables import Cell, Grid

PROFILE = "husky-tile"
INPUTS: tuple[tuple[Literal["wheels", "commands"], CommandKind, str], ...] = (
    ("wheels", "wheels", "measured wheel rates"),
    ("commands", "twist", "commands"),
)
SHOWN = (2.0, 6.0, 30.0)
"""Horizons of the table [s]."""
WINDOW = 2.0
"""Length of the windows whose errors are laid out over speed and yaw rate [s]: commands last six."""
SPEEDS = (0.0, 0.1, 0.2, 0.3, 0.6)
YAW_RATES = (0.0, 0.1, 0.3, 0.6, 1.5)
"""Edges of the bins [m/s], [rad/s]."""
FEW = 5
"""A bin with fewer windows is left empty."""
NOT_RUN = (
    "Not run: no recording was given. `python -m validation.replicate --recording PATH` drives every plant of profile "
    "husky-tile along the log of a real Husky, such as husky_tile_train.csv of the DRIVE data set (norlab-ulaval)."
)


def split_of(profile: Profile, given: float | None) -> float | None:
    """Until when the recording was fitted to [s]: as given, else as the profile's provenance has it; None if neither."""
    if given is not None:
        return given
    until = profile.provenance.get("mujoco", {}).get("until")
    return float(until) if until is not None else None


def real(context: Context) -> Findings:
    """Everything about the recording, or that there is none."""
    settings = context.settings
    if not settings.recording:
        return Findings(notes=(NOT_RUN,))
    profile, recording = load(PROFILE), read_recording(settings.recording)
    split = split_of(profile, settings.split)
    parts = cut(recording, split)
    inputs = inputs_of(recording)
    found: dict[tuple[str, str], Comparison] = {}
    pictures, worst, numbers = [], [], {}
    for input_, kind, words in inputs:
        sources = {part: source_of(piece, "recording", kind) for part, piece in parts.items()}
        for part, source in sources.items():
            how = CompareSettings(input=input_, horizons=SHOWN)
            found[input_, part] = compare(source, profile, PLANTS, None, how, context.workers)
        last = list(parts)[-1]
        caption = f"The plants driven by {words}, {last}: paths over windows, errors by horizon, yaw rate and speed."
        pictures.append(context.picture(f"paths-{input_}", comparison_figure(found[input_, last]), caption))
        residuals = residuals_of([(found[input_, part], source) for part, source in sources.items()])
        pictures.append(_residual_picture(context, input_, words, residuals))
        worst += [worst_of(residuals, words), *straight_of(residuals, profile, words)]
        numbers[f"residuals_{input_}"] = as_numbers(residuals)
    horizons = {input_: {part: _horizons(found[input_, part]) for part in parts} for input_, _, _ in inputs}
    return Findings(
        grids={
            f"Median error of the relative pose by horizon, plant and input; windows: {_counts(found)}": horizon_grid(found),
            "What was recorded": data_grid(recording, parts),
        },
        notes=(f"{profile.description.rstrip('.')}.", *worst, *limits(recording, parts), *centre_of_mass(profile)),
        pictures=tuple(pictures),
        numbers={"profile": profile.name, "split_s": split, "horizons": horizons, **numbers},
    )


def inputs_of(recording: Recording) -> list[tuple[Literal["wheels", "commands"], CommandKind, str]]:
    """What of a recording can drive the plants.

    Raises:
        ValueError: nothing, or it has no poses to hold them against.
    """
    there = {"wheels": recording.has_wheels, "commands": recording.has_commands}
    found = [each for each in INPUTS if there[each[0]]]
    if not found:
        raise ValueError(f"{recording.name} has neither wheel rates (enc_left, enc_right) nor commands (cmd_v, cmd_w)")
    for _, kind, _ in found:
        source_of(recording, recording.name, kind)
    return found


def cut(recording: Recording, split: float | None) -> dict[str, Recording]:
    """By name, what was fitted to and what was held out; everything where nothing was split off."""
    if split is None or not float(recording.t[0]) < split < float(recording.t[-1]):
        return {"everything": recording}
    return {"fitted to": recording.cut(None, split), "held out": recording.cut(split, None)}


def _horizons(comparison: Comparison) -> dict[str, Any]:
    return {
        name: {f"{h:g}": dict(vars(errors)) for h, errors in result.horizons.items()}
        for name, result in comparison.plants.items()
    }


def _counts(found: Mapping[tuple[str, str], Comparison]) -> str:
    counts = {}
    for (_, part), comparison in found.items():
        errors = next(iter(comparison.plants.values())).horizons
        counts[part] = ", ".join(f"{e.n} of {h:g} s" for h, e in errors.items())
    return "; ".join(f"{part} {text}" for part, text in counts.items())


def horizon_grid(found: Mapping[tuple[str, str], Comparison]) -> Grid:
    """Position [m] and yaw [rad] by horizon: plants by input and part; the best of each column of a group is emphasised."""
    horizons = [h for h in SHOWN if all(h in r.horizons for c in found.values() for r in c.plants.values())]
    header = [("input", ""), ("part", ""), ("plant", "")]
    header += [(f"{what} {h:g} s", unit) for h in horizons for what, unit in (("position", "m"), ("yaw", "rad"))]
    groups = []
    for (input_, part), comparison in found.items():
        values = {
            name: [v for h in horizons for v in (r.horizons[h].position_median_m, r.horizons[h].yaw_median_rad)]
            for name, r in comparison.plants.items()
        }
        least = [f"{min(column):.3f}" for column in zip(*values.values(), strict=True)]
        groups.append(
            tuple(
                (
                    Cell(input_),
                    Cell(part),
                    Cell(name),
                    *(Cell(f"{v:.3f}", f"{v:.3f}" == b) for v, b in zip(row, least, strict=True)),
                )
                for name, row in values.items()
            )
        )
    return Grid(tuple(header), tuple(groups), left=3)


def data_grid(recording: Recording, parts: Mapping[str, Recording]) -> Grid:
    """Extent of the recording and of its parts."""
    header = (("part", ""), ("time", "s"), ("pieces", "1"), ("path", "m"), ("poses", "Hz"), ("speed p95", "m/s"),
              ("yaw rate p95", "rad/s"))  # fmt: skip
    rows = []
    for name, part in {**parts, **({"all": recording} if len(parts) > 1 else {})}.items():
        segments = part.segments()
        time = sum(float(s.t[-1] - s.t[0]) for s in segments)
        length = sum(path_length(s.pose[s.fresh, :2]) for s in segments if int(np.sum(s.fresh)) > 1)
        fresh = sum(int(np.sum(s.fresh)) for s in segments)
        speed, rate = (np.concatenate(parts_) for parts_ in zip(*(_motion(s) for s in _pieces(part)), strict=True))
        numbers = (f"{time:.0f}", str(len(segments)), f"{length:.0f}", f"{fresh / max(time, 1e-9):.1f}",
                   f"{np.percentile(speed, 95.0):.2f}", f"{np.percentile(rate, 95.0):.2f}")  # fmt: skip
        rows.append((Cell(name), *map(Cell, numbers)))
    return Grid(header, (tuple(rows),), left=1)


def _pieces(recording: Recording) -> Sequence[Any]:
    """Recorded motions, piece by piece."""
    kind = inputs_of(recording)[0][1]
    return [p.reference for p in source_of(recording, "recording", kind).pieces if p.reference is not None]


def _motion(piece: Any) -> tuple[Any, Any]:
    """(M,) sizes of speed [m/s] and of yaw rate [rad/s]."""
    return np.hypot(piece.twist[:, 0], piece.twist[:, 1]), np.abs(piece.twist[:, 2])


# ------------------------------------------------------------------------------------------------------------- residuals


def residuals_of(driven: Sequence[tuple[Comparison, Source]]) -> Residuals:
    """Errors of every plant over consecutive windows, laid out over the recorded speed and yaw rate.

    Args:
        driven: comparisons with a recording, each with its source.

    Returns:
        For each plant the median size of position and yaw error of the windows of each bin; NaN where there are few.
    """
    speeds: list[float] = []
    rates: list[float] = []
    errors: dict[str, list[tuple[float, float]]] = {}
    for comparison, source in driven:
        for k, piece in enumerate(source.pieces):
            if piece.reference is None or piece.t is None:
                continue
            starts, ends = horizon_windows(piece.t, WINDOW, piece.fresh)
            pose = piece.reference.pose
            for i, j in zip(starts, ends, strict=True):
                span = float(piece.t[j] - piece.t[i])
                speeds.append(path_length(pose[i : j + 1][_fresh(piece.fresh, i, j), :2]) / span)
                rates.append(abs(float(pose[j, 2] - pose[i, 2])) / span)
            for name, result in comparison.plants.items():
                position, yaw = relative_pose_error(result.pieces[k].pose, pose, starts, ends)
                errors.setdefault(name, []).extend(zip(position.tolist(), yaw.tolist(), strict=True))
    column = np.digitize(rates, YAW_RATES) - 1
    row = np.digitize(speeds, SPEEDS) - 1
    shape = len(SPEEDS) - 1, len(YAW_RATES) - 1
    count = np.zeros(shape, dtype=np.int64)
    medians = {name: np.full((2, *shape), np.nan) for name in errors}
    for i, j in np.ndindex(*shape):
        inside = (row == i) & (column == j)
        count[i, j] = int(np.sum(inside))
        if count[i, j] >= FEW:
            for name, values in errors.items():
                medians[name][:, i, j] = np.median(np.array(values)[inside], axis=0)
    return Residuals(SPEEDS, YAW_RATES, count, medians, WINDOW)


def _fresh(fresh: Any, i: int, j: int) -> Any:
    """(j - i + 1,) which samples of a window have a new pose; its ends have."""
    return np.ones(j - i + 1, dtype=np.bool_) if fresh is None else fresh[i : j + 1]


def _residual_picture(context: Context, input_: str, words: str, residuals: Residuals) -> Picture:
    caption = (
        f"Where each plant fails, driven by {words}: median error over windows of {WINDOW:g} s, by the recorded speed "
        "and yaw rate. The grey numbers on the left count the windows."
    )
    return context.picture(f"residuals-{input_}", draw_residuals(residuals, f"driven by {words}"), caption)


def worst_of(residuals: Residuals, words: str) -> str:
    """In a sentence, the bin in which each plant's yaw goes most astray."""
    if not np.any(residuals.count >= FEW):
        return f"Driven by {words}, no bin of speed and yaw rate holds {FEW} windows of {WINDOW:g} s."
    parts = []
    for name, (_, yaw) in residuals.medians.items():
        i, j = np.unravel_index(int(np.nanargmax(yaw)), yaw.shape)
        parts.append(
            f"{name} {yaw[i, j]:.3f} rad at {residuals.speeds[i]:g}–{residuals.speeds[i + 1]:g} m/s and "
            f"{residuals.yaw_rates[j]:g}–{residuals.yaw_rates[j + 1]:g} rad/s (least {np.nanmin(yaw):.3f})"
        )
    return f"Driven by {words}, yaw goes most astray in {WINDOW:g} s, as a median over a bin's windows: {'; '.join(parts)}."


def straight_of(residuals: Residuals, profile: Profile, words: str) -> list[str]:
    """In a sentence, what plants make of driving straight and fast, where unequal wheel radii show; none without data."""
    fast = [i for i in range(residuals.count.shape[0]) if residuals.count[i, 0] >= FEW]
    if not fast:
        return []
    i = fast[-1]
    errors = ", ".join(f"{name} {yaw[i, 0]:.3f}" for name, (_, yaw) in residuals.medians.items())
    difference = float(profile.plants["mujoco"].parameters.radius_difference)
    return [
        f"Driving straight (below {residuals.yaw_rates[1]:g} rad/s) at {residuals.speeds[i]:g} m/s and more, driven by "
        f"{words}, yaw goes astray by {errors} rad. The Coulomb, improved and linear models have one wheel radius for "
        f"both sides; the MuJoCo Husky was fitted with a difference of {1e3 * difference:.1f} mm, and the kinematics "
        "have a factor for each side."
    ]


def as_numbers(residuals: Residuals) -> dict[str, Any]:
    """For `replicate.json`; null where there are few windows."""

    def plain(values: Any) -> Any:
        return [[None if math.isnan(v) else float(v) for v in line] for line in values]

    return {
        "window_s": residuals.window,
        "speed_edges_m_s": list(residuals.speeds),
        "yaw_rate_edges_rad_s": list(residuals.yaw_rates),
        "windows": residuals.count.tolist(),
        "position_median_m": {name: plain(m[0]) for name, m in residuals.medians.items()},
        "yaw_median_rad": {name: plain(m[1]) for name, m in residuals.medians.items()},
    }


# ------------------------------------------------------------------------------------------------------------ sentences


def limits(recording: Recording, parts: Mapping[str, Recording]) -> list[str]:
    """What the recording cannot tell, as far as it shows by itself."""
    speed, rate = (np.concatenate(x) for x in zip(*(_motion(p) for p in _pieces(recording)), strict=True))
    gaps = len(recording.segments()) - 1
    out = [
        f"Limits of the data: one robot on one floor, {gaps} gap{'s' * (gaps != 1)}; half of the time it moves at less than "
        f"{np.median(speed):.2f} m/s and turns at less than {np.median(rate):.2f} rad/s, and speed hardly exceeds "
        f"{np.percentile(speed, 99.0):.2f} m/s. Of other grounds, loads or speeds it says nothing.",
        "Poses and wheel rates are refreshed more seldom than they are logged (table above); windows begin and end at "
        "fresh poses only. A median of n windows is uncertain by about 1.25 standard deviations over √n: where plants "
        "differ by less than a tenth, the windows do not decide.",
    ]
    if len(parts) == 1:
        out.append("Nothing of it is held out: what these plants were fitted to is scored with the rest.")
    return out


def centre_of_mass(profile: Profile) -> list[str]:
    """The finding of docs/centre_of_mass.md, with the profile's own numbers."""
    husky = profile.plants["mujoco"].parameters
    errors = profile.provenance.get("mujoco", {}).get("standard_errors", {})

    def place(axis: str, positive: str, negative: str) -> str:
        value, error = float(getattr(husky, f"com_{axis}")), errors.get(f"com_{axis}")
        spread = f" ± {1e3 * error:.0f}" if error is not None else ""
        return f"{1e3 * abs(value):.0f}{spread} mm {positive if value >= 0.0 else negative}"

    return [
        "Centre of mass (docs/centre_of_mass.md): fitted with friction alike in all directions it lies "
        f"{place('x', 'before', 'behind')} the middle between the axles and "
        f"{place('y', 'to the left', 'to the right')}. Neither of the maker's two places (85 mm to the right, 87 mm to "
        "the rear) then explains the recording; but with 6 % less grip across than along, a centre in the very middle "
        "does as well. Motion alone does not tell which; weighing the axles would."
    ]


SECTIONS = (Section("real", "A real Husky on tile", (), ("recording", "split"), real),)
"""That of the real robot."""
