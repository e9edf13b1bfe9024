"""Draw the figure of docs/why_drift.md on the sideways drift, and print its numbers.

Run from the project's root: `python docs/make_contact_figures.py`. The page's other figure is that
of `python -m validation.study contact`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ssmr.robot.ground import turn_on_the_spot
from ssmr.types import Commands, State, Trajectory
from tests.polygons import polygonal_turn
from validation import load_robot
from validation.experiment.runs import drive_piece
from validation.experiment.sources import open_source
from validation.plants.profile import PlantProfile, load_profile
from validation.simulator.turning import SAMPLE, SPIN_LEAD, spin_on_spot
from validation.study.contact import TURNED, Setting, all_settings, balanced_robot

_ROBOT = load_robot("husky")
WHEELBASE = _ROBOT.wheelbase
TRACK = _ROBOT.track

OUT = Path(__file__).parent / "img" / "sideways_drift.png"
LADDER = {
    "near ODE: maker's centre": ("#d55e00", "near ODE, maker's centre of mass"),
    "near ODE: also elliptic cone": ("#a0529a", "also an elliptic cone"),
    "near ODE: also soft contact": ("#0072b2", "also soft contact"),
    "near ODE: also centre in the middle": ("#009e73", "also the centre in the middle"),
}
"""Settings of the study, each with one remedy more than the one before: colour and words."""
SLOW = 0.15
"""Yaw rate commanded where theory is compared; slow, because the theory has no inertia [rad/s]."""
SLOW_TIME = 150.0
"""Duration of that turn [s]."""
BINS = 18
"""Number of bins for headings from 0 to 90 degrees."""


def whole_robot(offset: float, section: PlantProfile) -> float:
    """Return the offset of the robot's centre of mass for that of the base's [m]."""
    mass = section.parameters.mass
    return offset * (mass - 4.0 * 2.637) / mass


def by_heading(setting: Setting, section: PlantProfile) -> tuple[np.ndarray, np.ndarray]:
    """Return (BINS,) headings [deg] and mean yaw rates over rim speed [rad/m] of a slow turn."""
    plant = setting.plant(section)
    motion = plant.run(
        Commands(0.05, np.tile([0.0, SLOW], (round(SLOW_TIME / 0.05), 1))), State(), SAMPLE
    )
    tail = motion.t > SPIN_LEAD
    rims = 0.5 * section.parameters.wheel_radius * np.diff(motion.wheels[tail], axis=1)[:, 0].mean()
    heading = np.degrees(np.mod(motion.yaw[tail], 0.5 * math.pi))
    which = np.minimum((heading / 90.0 * BINS).astype(int), BINS - 1)
    rates = np.array([motion.twist[tail, 2][which == k].mean() for k in range(BINS)]) / rims
    return (np.arange(BINS) + 0.5) * 90.0 / BINS, rates


def draw_theory(section: PlantProfile, result: dict[str, Setting], ax: Axes) -> None:
    """Draw yaw rate over heading for a friction circle and a polygon, in theory and MuJoCo."""
    headings = np.linspace(0.0, 90.0, 181)
    y = whole_robot(-0.085, section)
    for place, colour, words, key in (
        (0.0, "#0072b2", "centre in the middle", "cone: pyramidal"),
        (y, "#d55e00", "maker's centre", "near ODE: maker's centre"),
    ):
        theory = [
            polygonal_turn("diamond", math.radians(h), WHEELBASE, TRACK, 0.0, place).yaw_rate
            for h in headings
        ]
        ax.plot(headings, theory, color=colour, lw=1.4, label=f"friction polygon, {words}")
        ax.axhline(
            turn_on_the_spot(WHEELBASE, TRACK, 0.0, place).yaw_rate,
            color=colour,
            lw=0.9,
            ls=(0, (4, 2)),
            label=f"friction circle, {words}",
        )
        measured = by_heading(result[key], section)
        ax.plot(*measured, "o", color=colour, ms=3.5)
    ax.set(
        xlabel="heading relative to the friction axes [deg]",
        ylabel="yaw rate over rim speed [rad/m]",
        xlim=(0, 90),
        ylim=(0, 5.6),
    )
    ax.set_xticks([0, 15, 30, 45, 60, 75, 90])
    ax.legend(fontsize=7.5, frameon=False, loc="upper left", ncols=1)
    ax.set_title("Turning slowly on the spot (dots: MuJoCo)", fontsize=10)
    straight = polygonal_turn("diamond", 0.25 * math.pi, WHEELBASE, TRACK, 0.0, y)
    print(
        f"polygon at 45 degrees, maker's centre: {straight.forward:.3f} ahead, "
        f"{straight.yaw_rate:.3f} rad/m of rim speed"
    )
    turn = turn_on_the_spot(WHEELBASE, TRACK, 0.0, y)
    print(f"circle: centre of rotation {turn.forward / turn.yaw_rate:.3f} m to the left")


def draw_paths(section: PlantProfile, measured: dict[str, Setting], ax: Axes) -> None:
    """Draw the path of the robot's middle while it turns on the spot."""
    for key, (colour, words) in LADDER.items():
        motion = spin_on_spot(measured[key].plant(section))
        tail = motion.t >= SPIN_LEAD
        xy = motion.xy[tail] - motion.xy[tail][0]
        turned = float(np.ptp(motion.yaw[tail]))
        last = words.endswith("middle")
        ax.plot(
            *xy.T,
            "o" if last else "-",
            color=colour,
            lw=1.0,
            ms=4.5,
            label=words,
            zorder=3 if last else 2,
        )
        print(
            f"{words}: {turned / (2.0 * np.pi):.2f} turns, "
            f"{np.hypot(*xy.T).max():.3f} m from its place at most"
        )
    ax.set_aspect("equal", adjustable="datalim")
    ax.set(xlabel="x [m]", ylabel="y [m]")
    ax.set_title("Path of the robot's middle, 36 s of turning", fontsize=10)


def draw_speed(section: PlantProfile, measured: dict[str, Setting], ax: Axes) -> None:
    """Draw the speed along trajectory 3, on ground turned by 45 degrees."""
    piece = replace(open_source("traj3").pieces[0], start=State(yaw=TURNED))
    for key, (colour, words) in LADDER.items():
        motion: Trajectory = drive_piece(
            measured[key].plant(section), piece, section.localiser, SAMPLE
        )
        ax.plot(motion.t, motion.twist[:, 0], color=colour, lw=1.0, label=words)
        print(f"{words}: up to {motion.twist[motion.t > 3.0, 0].max():.3f} m/s on trajectory 3")
    ax.axhline(0.5, color="black", lw=0.8, ls=":")
    ax.set(xlabel="time [s]", ylabel="forward speed [m/s]", xlim=(0, 20), ylim=(0, 0.98))
    ax.legend(fontsize=7.5, frameon=False, loc="upper left", ncols=1)
    ax.set_xticks([0, 5, 10, 15, 20])
    ax.set_title("Speed on trajectory 3 (command: 0.5 m/s)", fontsize=10)


def main() -> None:
    """Draw the three panels."""
    section = balanced_robot(load_profile("thesis-lab").plants["mujoco"])
    measured = all_settings()
    print(
        "a centre farther aside makes a polygon's robot drive straight: "
        f"{0.5 * (TRACK - WHEELBASE):.4f} m"
    )
    figure = Figure(figsize=(12.6, 3.9), dpi=120, layout="constrained")
    panels = figure.subplots(1, 3, width_ratios=(1.15, 0.85, 1.15))
    for draw, ax in zip((draw_theory, draw_paths, draw_speed), panels, strict=True):
        draw(section, measured, ax)
        ax.spines[["top", "right"]].set_visible(False)
    figure.savefig(OUT)


if __name__ == "__main__":
    main()
