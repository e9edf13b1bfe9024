"""Draw the figure of docs/lab.md, and print the numbers of its tables.

Run from the project's root: `python docs/make_printed_figure.py`; it takes half a minute.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ssmr.metrics.declared import compare_paths
from ssmr.scenarios import TRAJECTORIES
from ssmr.simulation import SAMPLE_DT
from ssmr.types import Commands, State, Trajectory
from validation.plants.profile import load_profile, make_plant
from validation.replicate import published
from validation.report.palette import plant_colour
from validation.simulator.model import GRAVITY
from validation.simulator.plant import MujocoPlant

OUT = Path(__file__).parent / "img" / "printed_parameters.png"
PROFILE = load_profile("thesis-printed")
NUMBERS = PROFILE.plants["mujoco"].parameters
AXLE = PROFILE.plants["improved"].vehicle.a
"""Distance of an axle from the middle [m]."""
GRIP = published.printed_value("3.11", "mu_d") * GRAVITY
"""Greatest acceleration towards the centre of a curve that mu_d can give [m/s2]."""
RATES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.75, 0.8, 0.82, 0.85, 0.9, 1.0)
"""Commanded yaw rates of the curves [rad/s]."""
SPEED = 0.5
TIME = 12.0
LEAD = 8.0
"""Commanded speed [m/s] and duration [s] of the curves, and the time after which they are measured
[s]."""
CHANGES: dict[str, dict[str, Any]] = {
    "as shipped": {},
    "longitudinal friction 0.5": {"friction": 0.5, "friction_ratio": 0.0818},
    "longitudinal friction 4": {"friction": 4.0, "friction_ratio": 0.010225},
    "contact points 14 mm apart": {"capsule_half_width": 0.00715},
    "contact points 0.6 mm apart": {"capsule_half_width": 0.0003},
    "step of 0.25 ms": {"timestep": 0.00025},
    "yaw inertia 3.2 kg m2": {"yaw_inertia": 3.2},
    "rotors of 0.3 kg m2, step of 2 ms": {"armature": 0.3, "timestep": 0.002},
    "the maker's half-track, 0.2854 m": {"half_track": 0.2854},
    "lateral friction mu_s, 0.0972": {"friction_ratio": 0.0972},
}
"""Words for what is changed, and the changes."""


@cache
def driven(scenario: str, plant: str) -> Trajectory:
    """Return a scenario as a plant of the profile drives it."""
    return make_plant(PROFILE, plant).run(TRAJECTORIES[scenario].commands(), State(), SAMPLE_DT)


def print_agreement() -> None:
    """Print the first table: the four trajectories by both plants."""
    print(
        "\ntrajectory; final yaws: improved, mujoco [rad]; d_rms, d_haus [mm]; published; v_y, "
        "a omega [m/s]; demand"
    )
    for scenario, motion in TRAJECTORIES.items():
        model = driven(scenario, "improved")
        robot = driven(scenario, "mujoco")
        metrics = compare_paths(model, robot)
        rate = float(np.abs(robot.twist[:, 2]).max())
        cells = (
            scenario,
            f"{model.yaw[-1]:.3f}, {robot.yaw[-1]:.3f}",
            f"{1e3 * metrics['d_rms_m']:.0f}, {1e3 * metrics['d_haus_m']:.0f}",
            f"{1e3 * published.printed_value('3.12', scenario, 'd_rms_m'):.1f}",
            f"{np.abs(robot.twist[:, 1]).max():.3f}, {AXLE * rate:.3f}",
            f"{0.5 * np.abs(motion.commands().values[:, 1]).max():.3f}",
        )
        print("| " + " | ".join(cells) + " |")


def print_choices() -> None:
    """Print the second table: what the choices change."""
    print("\nchange; final yaws on 1-4 [rad]; d_rms from the improved model on 1-4 [mm]")
    for words, changed in CHANGES.items():
        plant = MujocoPlant(replace(NUMBERS, **changed), PROFILE.plants["mujoco"].drive)
        runs = {
            name: plant.run(motion.commands(), State(), SAMPLE_DT)
            for name, motion in TRAJECTORIES.items()
        }
        gaps = [
            1e3 * compare_paths(driven(name, "improved"), run)["d_rms_m"]
            for name, run in runs.items()
        ]
        yaws = ", ".join(f"{run.yaw[-1]:.3f}" for run in runs.values())
        print(f"| {words} | {yaws} | {', '.join(f'{gap:.0f}' for gap in gaps)} |", flush=True)


def draw_path(scenario: str, ax: Axes) -> None:
    """Draw one trajectory by both plants."""
    model = driven(scenario, "improved")
    robot = driven(scenario, "mujoco")
    for motion, plant, words in (
        (model, "improved", "improved model"),
        (robot, "mujoco", "the same numbers in MuJoCo"),
    ):
        ax.plot(*motion.xy.T, color=np.array(plant_colour(plant)) / 255.0, lw=1.5, label=words)
    metrics = compare_paths(model, robot)
    ax.set_aspect("equal")
    ax.set(xlim=(-0.2, 9.8), ylim=(-0.4, 4.0))
    ax.set_title(f"Trajectory {scenario[-1]}", fontsize=9.5, loc="left")
    words = (
        f"final yaws {model.yaw[-1]:.3f} and {robot.yaw[-1]:.3f} rad\n"
        f"sideways at up to {np.abs(robot.twist[:, 1]).max():.2f} m/s\n"
        f"paths {1e3 * metrics['d_rms_m']:.0f} mm apart"
    )
    ax.text(0.0, 3.95, words, fontsize=8.5, va="top")


def draw_curves(ax: Axes) -> None:
    """Draw the centre of rotation in steady curves over the acceleration that they need."""
    plant = make_plant(PROFILE, "mujoco")
    held = []
    lost = []
    print(
        "\ncommanded yaw rate; v omega reached [m/s2]; "
        "centre of rotation ahead of the middle [m]; change of v_y [m/s2]"
    )
    for rate in RATES:
        commands = Commands(0.05, np.tile([SPEED, rate], (round(TIME / 0.05), 1)))
        motion = plant.run(commands, State(), 0.01)
        tail = motion.t > LEAD
        needed = float(np.mean(motion.twist[tail, 0] * motion.twist[tail, 2]))
        slide = float(np.polyfit(motion.t[tail], motion.twist[tail, 1], 1)[0])
        centre = float(-motion.twist[-1, 1] / motion.twist[-1, 2])
        (held if abs(slide) < 1e-3 else lost).append((needed, centre))
        print(f"{rate:.2f}  {needed:.3f}  {centre:.3f}  {slide:.4f}")
    ax.axhline(AXLE, color="0.55", lw=0.9, ls="--")
    ax.axhline(0.0, color=np.array(plant_colour("improved")) / 255.0, lw=1.5)
    ax.axvline(GRIP, color="#d55e00", lw=1.2, ls=":")
    ink = np.array(plant_colour("mujoco")) / 255.0
    ax.plot(*np.transpose(held), "o", color=ink, ms=5)
    ax.plot(*np.transpose(lost), "o", color=ink, ms=5, markerfacecolor="white")
    ax.annotate(
        "front axle", (0.02, AXLE), (0, 4), textcoords="offset points", fontsize=8.5, color="0.35"
    )
    ax.annotate(
        "improved model: in the middle",
        (0.02, 0.0),
        (0, 4),
        textcoords="offset points",
        fontsize=8.5,
    )
    ax.annotate(
        f"$\\mu_d\\,g$ = {GRIP:.3f} m/s²",
        (GRIP, 0.93),
        (-5, 0),
        textcoords="offset points",
        ha="right",
        fontsize=8.5,
    )
    ax.annotate("slides on and on\n(open: after 12 s)", (GRIP + 0.008, 0.82), fontsize=8.5)
    ax.set(
        xlim=(0.0, 0.55),
        ylim=(-0.06, 1.2),
        xlabel="acceleration $v\\,\\omega$ that the curve needs [m/s²]",
    )
    ax.set_ylabel("centre of rotation ahead of the middle [m]")
    ax.set_title("Curves at 0.5 m/s", fontsize=9.5, loc="left")


def main() -> None:
    """Draw the figure and print the tables."""
    figure = Figure(figsize=(13.0, 5.0), dpi=120, layout="constrained")
    grid = figure.add_gridspec(2, 3, width_ratios=(1.0, 1.0, 0.95))
    paths = [figure.add_subplot(grid[k // 2, k % 2]) for k in range(4)]
    for scenario, ax in zip(TRAJECTORIES, paths, strict=True):
        draw_path(scenario, ax)
    for k, ax in enumerate(paths):
        ax.set(xlabel="x [m]" if k > 1 else "", ylabel="" if k % 2 else "y [m]")
    paths[0].legend(fontsize=8.5, frameon=False, loc="lower right")
    curves = figure.add_subplot(grid[:, 2])
    draw_curves(curves)
    for ax in (*paths, curves):
        ax.spines[["top", "right"]].set_visible(False)
    figure.savefig(OUT)
    print_agreement()
    print_choices()


if __name__ == "__main__":
    main()
