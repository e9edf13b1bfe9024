"""Draw the figure of docs/tile.md, and print the numbers of its tables.

Run from the project's root: `python docs/make_wet_grass_figure.py husky_tile_train.csv
husky_wet_grass_train.csv` with the paths of both recordings; it takes a minute or two.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ssmr.geometry import integrate_rates
from ssmr.metrics.windows import (
    OverlappingErrors,
    WindowErrors,
    overlapping_windows,
    relative_pose_error,
)
from ssmr.types import FloatArray
from validation.experiment.runs import drive_piece
from validation.experiment.sources import Source, open_source
from validation.plants.kind import PlantProfile
from validation.plants.profile import Profile, load_profile, make_plant
from validation.report.palette import spell_name

OUT = Path(__file__).parent / "img" / "wet_grass.png"
HORIZON = 6.0
"""Length of the windows [s]."""
SPLIT = {"tile": 500.0, "wet grass": 182.0}
"""End of the part that the profiles were fitted to [s]."""
RADIUS = 0.154616
"""Rolling radius of profile husky-tile [m], which turns a radius difference into a ratio."""
_MOVES = 0.3
"""A window counts if one side's wheels turn by at least this much [rad]: 5 cm of way."""
_BLOCK = 6
"""Windows that are resampled together, as many as share data."""
_DRAWS = 300
_ROUNDS = 40
_SMALL = 2e-3
FLOOR = "fitted to this part itself"
Scores = dict[tuple[str, str, str], OverlappingErrors]
"""Heading errors by ground, profile and plant."""
PLANTS_SHOWN = ("kinematic", "linear", "coulomb", "improved", "mujoco")
COLOURS = {"tile": "#4477aa", "wet grass": "#228833"}


class Sides(NamedTuple):
    """Turn of the heading for a radian of the wheels of each side, and its delay."""

    left: float
    """Minus the change of heading over the rotation of the left side [1]."""
    right: float
    """Change of heading over the rotation of the right side [1]."""
    late: float
    """Delay of the headings behind the wheel rates [s]."""

    @property
    def gain(self) -> float:
        """Return the change of heading over the difference of the sides' rotations [1].

        It is the radius over the effective track.
        """
        return 0.5 * (self.left + self.right)

    @property
    def difference(self) -> float:
        """Return the radius of the left wheels less that of the right [m]."""
        return RADIUS * (self.left - self.right) / self.gain


START = Sides(0.157, 0.157, 0.1)
"""Where the search for these numbers begins."""


@dataclass(frozen=True, eq=False)
class Turns:
    """What the headings and the wheels of a log did in its windows."""

    t: FloatArray
    """(M,) stamps of the wheel rates [s]."""
    travel: FloatArray
    """(2, M) rotation of the left and of the right side since the first stamp [rad]."""
    begin: FloatArray
    """(W,) beginnings of the windows [s]."""
    end: FloatArray
    """(W,) ends of the windows [s]."""
    turned: FloatArray
    """(W,) change of the heading [rad]."""

    def wheels(self, late: float) -> FloatArray:
        """Return (2, W) rotations of the sides [rad] in windows that lie so much earlier."""
        return np.stack(
            [
                np.interp(self.end - late, self.t, s) - np.interp(self.begin - late, self.t, s)
                for s in self.travel
            ]
        )

    def errors(self, sides: Sides) -> FloatArray:
        """Return (W,) predicted less measured changes of heading [rad]."""
        left, right = self.wheels(sides.late)
        return sides.right * right - sides.left * left - self.turned


def moving(
    source: Source, horizon: float = HORIZON
) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Return starts and ends of the windows in which wheels turn, piece by piece.

    None spans a gap or a jump.
    """
    rows = []
    for piece in source.pieces:
        assert piece.t is not None
        assert piece.reference is not None
        starts, ends = piece.windows(overlapping_windows, piece.t, horizon)
        way = np.cumulative_sum(
            np.abs(piece.reference.wheels[:-1]).max(axis=1) * np.diff(piece.t), include_initial=True
        )
        turns = way[ends] - way[starts] > _MOVES
        rows.append((starts[turns], ends[turns]))
    return rows


def turns_of(source: Source) -> Turns:
    """Return what headings and wheels did in the windows of a recording that moves."""
    t = []
    travel = []
    rows = []
    offset = np.zeros(2)
    for piece, (starts, ends) in zip(source.pieces, moving(source), strict=True):
        assert piece.t is not None
        assert piece.reference is not None
        way = offset + integrate_rates(piece.t, piece.reference.wheels)
        t.append(piece.t)
        travel.append(way)
        offset = way[-1]
        yaw = piece.reference.pose[:, 2]
        rows.append(np.column_stack([piece.t[starts], piece.t[ends], yaw[ends] - yaw[starts]]))
    begin, end, turned = np.concatenate(rows).T
    return Turns(np.concatenate(t), np.concatenate(travel).T, begin, end, turned)


def fit_sides(turns: Turns, which: NDArray[np.intp] | None = None, start: Sides = START) -> Sides:
    """Return the numbers of least absolute errors over the windows, all or those of `which`."""
    rows = slice(None) if which is None else which
    measured = start
    step = 0.02
    for _ in range(_ROUNDS):
        left, right = turns.wheels(measured.late)
        early = turns.wheels(measured.late - step)
        later = turns.wheels(measured.late + step)
        slope = (measured.right * (later - early)[1] - measured.left * (later - early)[0]) / (
            2.0 * step
        )
        matrix = np.column_stack([-left, right, slope])[rows]
        error = turns.errors(measured)[rows]
        weight = 1.0 / np.sqrt(np.maximum(np.abs(error), _SMALL))
        change = np.linalg.lstsq(matrix * weight[:, None], -error * weight, rcond=None)[0]
        measured = Sides(*(np.array(measured) + np.clip(change, -0.05, 0.05)))
    return measured


def scatter(turns: Turns, measured: Sides, seed: int = 0) -> tuple[float, float, float]:
    """Return standard errors of gain [1], radius difference [m], delay [s], by block resampling."""
    rng = np.random.default_rng(seed)
    n = len(turns.turned)
    drawn = []
    for _ in range(_DRAWS):
        begins = rng.integers(0, n, -(-n // _BLOCK))
        which = ((begins[:, None] + np.arange(_BLOCK)) % n).ravel()[:n]
        again = fit_sides(turns, which, measured)
        drawn.append((again.gain, again.difference, again.late))
    gain, difference, late = np.std(drawn, axis=0)
    return float(gain), float(difference), float(late)


def interval(errors: FloatArray) -> OverlappingErrors:
    """Return the median of (W,) heading errors with its 90 % interval."""
    return WindowErrors(HORIZON, np.zeros(len(errors)), np.abs(errors)).summary()


def scored(plant: PlantProfile, model: str, source: Source) -> OverlappingErrors:
    """Return how well a plant predicts headings in the windows of a recording that moves."""
    made = make_plant(Profile("", "", {model: plant}, {}), model)
    rows = []
    for piece, (starts, ends) in zip(source.pieces, moving(source), strict=True):
        assert piece.reference is not None
        motion = drive_piece(made, piece, plant.localiser, source.sample_dt)
        rows.append(relative_pose_error(motion.pose, piece.reference.pose, starts, ends)[1])
    return interval(np.concatenate(rows))


def text(errors: OverlappingErrors) -> str:
    """Return a median and its interval."""
    return f"{errors.yaw_median_rad:.3f} ({errors.yaw_low_rad:.3f}–{errors.yaw_high_rad:.3f})"


class Part(NamedTuple):
    """What the headings of one part of a log say about the sides, with standard errors."""

    sides: Sides
    """The numbers."""
    gain: float
    """Standard error of the gain [1]."""
    difference: float
    """Standard error of the radius difference [m]."""
    late: float
    """Standard error of the delay [s]."""


def print_sides(turns: dict[str, Turns]) -> dict[str, Part]:
    """Print what headings say about the sides in each part, and return it."""
    entries = {}
    for name, part in turns.items():
        sides = fit_sides(part)
        p = entries[name] = Part(sides, *scatter(part, sides))
        print(
            f"{name:18s} {len(part.turned):4d} windows: gain {sides.gain:.4f} ± {p.gain:.4f}, "
            "radius difference "
            f"{1e3 * sides.difference:+.1f} ± {1e3 * p.difference:.1f} mm, "
            f"late {sides.late:+.3f} ± {p.late:.3f} s, "
            f"left over {text(interval(part.errors(sides)))}"
        )
    return entries


def variants() -> dict[str, dict[str, Profile]]:
    """Return the profiles of the table by ground.

    They are as shipped, with the clock of the log, and with the other's radii too.
    """
    tile = load_profile("husky-tile")
    grass = load_profile("husky-wet-grass")

    def late_as(own: Profile, other: Profile) -> Profile:
        plants = {
            name: replace(
                plant,
                localiser=replace(plant.localiser, yaw_late=other.plants[name].localiser.yaw_late),
            )
            for name, plant in own.plants.items()
        }
        return replace(own, plants=plants)

    return {
        "tile": {
            "husky-tile": tile,
            "husky-wet-grass": grass,
            "husky-wet-grass, the tile's clock": late_as(grass, tile),
        },
        "wet grass": {
            "husky-tile": tile,
            "husky-tile, the grass's clock": late_as(tile, grass),
            "husky-wet-grass": grass,
        },
    }


def print_scores(
    rest: dict[str, Source], measured: dict[str, Part], turns: dict[str, Turns]
) -> Scores:
    """Print and return medians of heading errors on the part of each log beyond the fits.

    The last row of each ground is the floor: two radii over the track and a delay, fitted to that
    part itself.
    """
    scores: Scores = {}
    for ground, profiles in variants().items():
        for name, profile in profiles.items():
            for model in PLANTS_SHOWN:
                errors = scores[ground, name, model] = scored(
                    profile.plants[model], model, rest[ground]
                )
                print(f"{ground:10s} {name:36s} {model:10s} {text(errors)}")
        own = turns[f"{ground}, rest"]
        floor = scores[ground, FLOOR, ""] = interval(own.errors(measured[f"{ground}, rest"].sides))
        print(f"{ground:10s} {FLOOR:47s} {text(floor)}")
    return scores


def print_tracks(turns: Turns) -> None:
    """Print how well equal radii over other tracks predict headings on wet grass."""
    late = load_profile("husky-wet-grass").plants["linear"].localiser.yaw_late
    for gain in (0.153, 0.155, 0.1565, 0.160, 0.1633):
        errors = np.abs(turns.errors(Sides(gain, gain, late)))
        print(
            f"radius over track {gain:.4f}: median {text(interval(errors))}, "
            f"mean {errors.mean():.3f}"
        )


def print_commands(path: str) -> None:
    """Print the medians on wet grass from commands.

    Only after the first part did anything but a joystick give them.
    """
    source = open_source(path, "twist", SPLIT["wet grass"])
    for name in ("husky-tile", "husky-wet-grass"):
        for model in ("kinematic", "mujoco"):
            measured = scored(load_profile(name).plants[model], model, source)
            print(f"wet grass from commands {name:24s} {model:10s} {text(measured)}")


def print_frictions(source: Source) -> None:
    """Print how much MuJoCo's heading depends on its friction."""
    plant = load_profile("husky-wet-grass").plants["mujoco"]
    for friction in (0.3, 0.5, 0.8):
        other = replace(plant, parameters=replace(plant.parameters, friction=friction))
        print(f"friction {friction}: {text(scored(other, 'mujoco', source))}")


def draw(measured: dict[str, Part], scores: Scores) -> None:
    """Draw what the headings say about the sides, and how well each profile predicts them."""
    figure = Figure(figsize=(13.0, 4.4), dpi=120, layout="constrained")
    gain, difference, medians = figure.subplots(1, 3, width_ratios=(1.0, 1.0, 1.5))
    names = list(measured)[::-1]
    for row, name in enumerate(names):
        part = measured[name]
        colour = COLOURS[name.partition(",")[0]]
        bar = {
            "fmt": "o",
            "color": colour,
            "capsize": 3,
            "mfc": colour if name.endswith("whole") else "white",
        }
        gain.errorbar(part.sides.gain, row, xerr=1.96 * part.gain, **bar)
        difference.errorbar(1e3 * part.sides.difference, row, xerr=1.96e3 * part.difference, **bar)
    gain.set(title="Heading per wheel difference", xlabel="radius / effective track [1]")
    difference.set(title="Left radius less right radius", xlabel="difference [mm]")
    for axes in (gain, difference):
        axes.set_yticks(range(len(names)), names if axes is gain else [""] * len(names))
        axes.set_ylim(-0.6, len(names) - 0.4)
    difference.axvline(0.0, color="0.6", lw=0.8)
    labels = []
    for row, (ground, name, model) in enumerate(
        key for key in list(scores)[::-1] if key[2] in ("kinematic", "mujoco", "")
    ):
        e = scores[ground, name, model]
        ends = [[e.yaw_median_rad - e.yaw_low_rad], [e.yaw_high_rad - e.yaw_median_rad]]
        own = name in (FLOOR, "husky-" + ground.replace(" ", "-"))
        medians.errorbar(
            e.yaw_median_rad,
            row,
            xerr=ends,
            fmt="o",
            color=COLOURS[ground],
            capsize=3,
            mfc=COLOURS[ground] if own else "white",
        )
        labels.append(spell_name(f"{name}{', ' * bool(model)}{model}"))
    medians.set_yticks(range(len(labels)), labels, fontsize=9)
    medians.set(
        title="Heading error after 6 s, part kept for the test",
        xlabel="median and 90 % interval [rad]",
        xlim=(0.0, 0.16),
    )
    for axes in (gain, difference, medians):
        axes.grid(axis="x", color="0.9")
        axes.set_axisbelow(True)
    for name, colour in COLOURS.items():
        medians.plot([], [], "o", color=colour, label=f"on {name}")
    medians.legend(loc="upper right")
    figure.savefig(OUT)


def main(paths: Sequence[str]) -> None:
    """Print all numbers of the page and draw its figure."""
    logs = dict(zip(SPLIT, paths, strict=True))
    first = {
        ground: open_source(path, "wheels", None, SPLIT[ground]) for ground, path in logs.items()
    }
    rest = {ground: open_source(path, "wheels", SPLIT[ground]) for ground, path in logs.items()}
    parts = {
        f"{g}, {w}": turns_of(s[g])
        for g in SPLIT
        for w, s in (("first part", first), ("rest", rest))
    }
    wholes = {f"{g}, whole": turns_of(open_source(p, "wheels")) for g, p in logs.items()}
    turns = {
        name: {**parts, **wholes}[name]
        for name in sorted({**parts, **wholes}, key=lambda n: n.startswith("wet"))
    }
    measured = print_sides(turns)
    draw(measured, print_scores(rest, measured, turns))
    print_tracks(turns["wet grass, rest"])
    print_commands(logs["wet grass"])
    print_frictions(rest["wet grass"])


if __name__ == "__main__":
    main(sys.argv[1:])
