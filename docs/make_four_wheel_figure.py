"""Draw the figure of docs/four_wheel.md and print its tables.

Run from the project's root: `python docs/make_four_wheel_figure.py`. Both have the Husky of its
file on ground of friction 0.5, and motors strong enough to let the tyres slide; the tyres are of
several slip stiffnesses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ssmr.models.four_wheel_plant import FourWheelPlant
from ssmr.robot.drive import wheel_rates
from ssmr.robot.ground import LoadModel
from ssmr.types import Commands, FloatArray, Plant, State, Trajectory
from validation import load_robot
from validation.plants.planar import tyred_defaults
from validation.simulator.calibration import Calibration
from validation.simulator.motors import actuator_inputs
from validation.simulator.physics import SHIPPED, PhysicsSettings
from validation.simulator.plant import MujocoPlant

OUT = Path(__file__).parent / "img" / "four_wheel.png"
ROBOT = load_robot("husky")
MU = 0.5
G = 9.81
LAG = 0.0095
"""Friction [1], gravity [m/s2], and the lag of friction in MuJoCo's contact, T d_max / 2
(docs/physics.md) [s]."""
NUMBERS = replace(tyred_defaults(ROBOT), friction=MU)
DRIVE = replace(
    ROBOT.drive,
    torque_limit=200.0,
    delay_v=0.0,
    delay_w=0.0,
    v_max=10.0,
    w_max=10.0,
    command_ramp=0.05,
    command_half_track=NUMBERS.half_track,
)
STIFFNESSES = (7.0, 20.0, 100.0, 1000.0)
"""Slip stiffnesses of the tyres, along and across [1]: of the drive-train study, of a car's tyre,
and nearly rigid ones."""
RIGID = STIFFNESSES[-1]
CURVES = ((0.5, 0.3), (0.5, 1.0), (1.0, 0.6), (1.0, 1.2), (1.5, 1.2))
"""Commanded speeds [m/s] and yaw rates [rad/s] of steady curves; the robot turns at some 0.55 of
them."""
THRUSTS = (0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98)
"""Accelerations of the wheels over mu g [1]."""
_COLOURS = {
    "mujoco": "#e69f00",
    7.0: "#56b4e9",
    20.0: "#0072b2",
    100.0: "#009e73",
    1000.0: "#404040",
}
Which = str | float


def make(
    which: Which, acceleration: float = math.inf, settings: PhysicsSettings = SHIPPED
) -> Plant:
    """Return a robot with a greatest acceleration of the wheels' rims [m/s2].

    `which` is a stiffness for the one on four tyres, and `mujoco` for MuJoCo's, which has Coulomb's
    friction.
    """
    drive = replace(DRIVE, acceleration_v=acceleration)
    if isinstance(which, str):
        return MujocoPlant(Calibration.of(ROBOT, friction=MU), drive, settings=settings)
    return FourWheelPlant(replace(NUMBERS, stiffness_x=which, stiffness_y=which), drive)


def held(v: float, w: float, seconds: float) -> Commands:
    """Return commands of constant speed [m/s] and yaw rate [rad/s]."""
    return Commands(0.05, np.tile([v, w], (round(seconds / 0.05), 1)))


@cache
def steady(
    which: Which, v: float, w: float, settings: PhysicsSettings = SHIPPED
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (3,) twist, (2,) wheel rates, (4,) loads: means of the last 3 of 8 s of a curve."""
    motion = make(which, settings=settings).run(held(v, w, 8.0), State(), 0.01)
    tail = motion.t > 5.0
    return (
        motion.twist[tail].mean(axis=0),
        motion.wheels[tail].mean(axis=0),
        motion.channels["wheel_load_N"][tail].mean(axis=0),
    )


def multiplier(which: Which, v: float, w: float) -> float:
    """Return the yaw rate of the wheels over that of the body [1]."""
    twist, wheels, _ = steady(which, v, w)
    return float(
        NUMBERS.wheel_radius * (wheels[1] - wheels[0]) / (2.0 * NUMBERS.half_track * twist[2])
    )


def rise(w: float) -> float:
    """Return how far MuJoCo's sliding tyres lift the robot in a turn on the spot [m]."""
    plant = MujocoPlant(Calibration.of(ROBOT, friction=MU), DRIVE)
    data = mujoco.MjData(plant.model)
    mujoco.mj_setState(
        plant.model, data, plant.placed(State()), mujoco.mjtState.mjSTATE_FULLPHYSICS
    )
    start = float(data.qpos[2])
    data.ctrl[:] = actuator_inputs(
        plant.model, np.array([wheel_rates(0.0, w, DRIVE.command_half_track, DRIVE.command_radius)])
    )[0]
    mujoco.mj_step(plant.model, data, nstep=round(5.0 / plant.dt))
    return float(data.qpos[2]) - start


@cache
def thrust(which: Which, share: float) -> tuple[float, float, float]:
    """Return what a straight start reaches whose wheels gain speed at a share of mu g.

    Returns:
        Acceleration over mu g [1], longitudinal slip [1], and load that moved to the rear [N].
    """
    motion = make(which, share * MU * G).run(held(6.0, 0.0, 1.0), State(), 0.01)
    tail = (motion.t > 0.5) & (motion.t < 0.95)
    rims = NUMBERS.wheel_radius * motion.wheels[tail].mean(axis=1)
    reached = np.polyfit(motion.t[tail], motion.twist[tail, 0], 1)[0] / (MU * G)
    loads = motion.channels["wheel_load_N"][tail].mean(axis=0)
    return (
        float(reached),
        float(np.mean(1.0 - motion.twist[tail, 0] / rims)),
        float(loads @ [-1.0, -1.0, 1.0, 1.0]),
    )


def brush_slip(share: float, stiffness: float) -> float:
    """Return the slip of a brush tyre that pushes with a share of its friction limit [1].

    It solves the law of docs/four_wheel.md.
    """
    return 3.0 * MU / stiffness * (1.0 - (1.0 - share) ** (1.0 / 3.0))


@cache
def stop(which: Which, v: float) -> float:
    """Return the distance in which the robot stops whose wheels are told to stand [m]."""
    stopping = Commands(0.05, np.vstack([np.tile([v, 0.0], (60, 1)), np.zeros((60, 2))]))
    motion = make(which).run(stopping, State(), 0.002)
    return float(motion.pose[-1, 0] - motion.pose[np.argmin(np.abs(motion.t - 3.0)), 0])


@cache
def arc(which: Which) -> Trajectory:
    """Return an arc of 20 s, told to drive 0.5 m/s and 0.6 rad/s."""
    return make(which).run(held(0.5, 0.6, 20.0), State(), 0.05)


@cache
def manoeuvre(which: Which) -> Trajectory:
    """Return a start, a curve and a stop: loads move to the rear, outwards and to the front."""
    parts = [([1.2, 0.0], 40), ([1.2, 1.2], 50), ([0.0, 0.0], 30)]
    values = np.vstack([np.tile(part, (count, 1)) for part, count in parts])
    return make(which, 2.0).run(Commands(0.05, values), State(), 0.01)


def quasi_static(motion: Trajectory) -> FloatArray:
    """Return the (M, 4) loads that the accelerations of a motion mean for this robot [N]."""
    model = LoadModel(
        NUMBERS.mass,
        0.0,
        0.0,
        NUMBERS.com_height,
        NUMBERS.wheelbase,
        2.0 * NUMBERS.half_track,
        4.0 * NUMBERS.wheel_inertia,
    )
    return model.along(motion, np.tile([0.0, 0.0, -G], (len(motion), 1)), NUMBERS.wheel_radius)


def _print_rows(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    print(f"\n{title}\n\n| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for row in rows:
        print(f"| {' | '.join(row)} |")


def print_tables() -> None:
    """Print the page's tables."""
    every = ("mujoco", *STIFFNESSES)
    names = ["MuJoCo", *(f"C = {c:g}" for c in STIFFNESSES)]
    _print_rows(
        "multiplier on the spot",
        ["$\\omega$ asked [rad/s]", *names],
        [
            [f"{w:g}", *(f"{multiplier(n, 0.0, w):.4f}" for n in every)]
            for w in (0.3, 0.6, 1.2, 2.4)
        ],
    )
    for w in (0.3, 2.4):
        lifted = rise(w)
        whole = multiplier("mujoco", 0.0, w) * (1.0 + 0.5 * lifted / NUMBERS.wheel_radius)
        print(
            f"asked {w:g} rad/s, MuJoCo's robot rises by {1e3 * lifted:.2f} mm; "
            f"multiplier with half of that: {whole:.4f}"
        )
    rows = []
    for v, w in CURVES:
        twists = [steady(n, v, w)[0] for n in every]
        lagged = twists[-1][1] - LAG * twists[0][0] * twists[0][2]
        rows.append(
            [
                f"{v:g}, {w:g}",
                *(f"{t[2]:.4f}" for t in twists),
                *(f"{1e3 * t[1]:.1f}" for t in twists),
                f"{1e3 * lagged:.1f}",
            ]
        )
    _print_rows(
        "yaw rate, side slip [mm/s], last with lag",
        ["asked", *names, *names, "rigid and lag"],
        rows,
    )
    patterns = {
        "outwards": [-1.0, 1.0, -1.0, 1.0],
        "front": [1.0, 1.0, -1.0, -1.0],
        "diagonal": [1.0, -1.0, -1.0, 1.0],
    }
    rows = [
        [
            f"{v:g}, {w:g}",
            *(
                f"{steady(n, v, w)[2] @ p:.2f}"
                for p in patterns.values()
                for n in ("mujoco", RIGID)
            ),
        ]
        for v, w in CURVES
    ]
    _print_rows(
        "load moved [N]: MuJoCo, rigid",
        ["asked", *(name for name in patterns for _ in range(2))],
        rows,
    )
    rows = [
        [f"{s:g}", *(f"{thrust(n, s)[0]:.3f}, {100 * thrust(n, s)[1]:.2f}" for n in every)]
        for s in THRUSTS
    ]
    _print_rows("thrust reached, slip [%]", ["rims", *names], rows)
    rows = []
    for v in (1.0, 2.0):
        rows.append(
            [f"{v:g}", *(f"{stop(n, v):.3f}" for n in every), f"{v * v / (2.0 * MU * G):.3f}"]
        )
    _print_rows("stopping distance [m]", ["speed", *names, "all friction"], rows)
    base = arc("mujoco")
    for n in STIFFNESSES:
        off = np.hypot(*(arc(n).xy - base.xy).T).max()
        print(
            f"arc, C = {n:g}: at most {1e3 * off:.0f} mm and "
            f"{np.abs(arc(n).yaw - base.yaw).max():.4f} rad from MuJoCo"
        )
    for n in ("mujoco", 7.0, RIGID):
        motion = manoeuvre(n)
        loads = motion.channels["wheel_load_N"]
        formula = quasi_static(motion)
        rms = math.sqrt(np.mean((loads - formula)[20:-20] ** 2))
        print(
            f"loads of {n}: {loads.min():.0f} to {loads.max():.0f} N, "
            f"rms {rms:.2f} N from quasi-static ones"
        )
    off = manoeuvre("mujoco").channels["wheel_load_N"] - manoeuvre(RIGID).channels["wheel_load_N"]
    print(
        f"loads, MuJoCo less C = {RIGID:g}: rms {math.sqrt(np.mean(off**2)):.2f} N, "
        f"at most {np.abs(off).max():.1f} N"
    )


def draw_thrust(ax: Axes) -> None:
    """Draw longitudinal slip over thrust."""
    shares = np.linspace(0.0, 0.999, 300)
    for n in ("mujoco", *STIFFNESSES[:3]):
        measured = np.array([thrust(n, s)[:2] for s in THRUSTS])
        words = "MuJoCo" if isinstance(n, str) else f"tyres, C = {n:g}"
        ax.plot(measured[:, 0], 100.0 * measured[:, 1], "o", color=_COLOURS[n], ms=4.5, label=words)
        if not isinstance(n, str):
            ax.plot(shares, [100.0 * brush_slip(s, n) for s in shares], color=_COLOURS[n], lw=1.0)
    ax.set(
        xlabel=r"acceleration over $\mu g$ [1]",
        ylabel="longitudinal slip [%]",
        xlim=(0, 1),
        ylim=(-0.5, 14),
    )
    ax.set_title("Straight start (lines: brush model)", fontsize=10)
    ax.legend(fontsize=7.5, frameon=False)


def draw_side_slip(ax: Axes) -> None:
    """Draw MuJoCo's side slip over that of nearly rigid tyres, with and without friction's lag."""
    mujoco = np.array([steady("mujoco", v, w)[0] for v, w in CURVES])
    rigid = np.array([steady(RIGID, v, w)[0] for v, w in CURVES])
    across = mujoco[:, 0] * mujoco[:, 2]
    ax.plot(across, -1e3 * mujoco[:, 1], "o", color=_COLOURS["mujoco"], ms=6, label="MuJoCo")
    ax.plot(
        across, -1e3 * rigid[:, 1], "s", color=_COLOURS[RIGID], ms=4, label=f"tyres, C = {RIGID:g}"
    )
    ax.plot(
        across,
        1e3 * (LAG * across - rigid[:, 1]),
        "x",
        color="#d55e00",
        ms=6,
        label="the same, with MuJoCo's lag of friction",
    )
    soft = np.array([steady(7.0, v, w)[0] for v, w in CURVES])
    ax.plot(
        soft[:, 0] * soft[:, 2],
        -1e3 * soft[:, 1],
        "^",
        color=_COLOURS[7.0],
        ms=4,
        label="tyres, C = 7",
    )
    ax.set(
        xlabel="acceleration to the side [m/s²]",
        ylabel="side slip to the outside [mm/s]",
        xlim=(0, 1.1),
        ylim=(0, 130),
    )
    ax.set_title("Steady curves", fontsize=10)
    ax.legend(fontsize=7.5, frameon=False, loc="upper left")


def draw_loads(ax: Axes) -> None:
    """Draw the loads of the front left and the rear right wheel."""
    for n, style in (("mujoco", "-"), (RIGID, "--")):
        motion = manoeuvre(n)
        for wheel, label in ((0, "front left"), (3, "rear right")):
            words = f"{'MuJoCo' if isinstance(n, str) else f'tyres, C = {n:g}'}, {label}"
            ink = _COLOURS[n] if wheel == 0 else ("#a05000" if isinstance(n, str) else "#909090")
            ax.plot(
                motion.t,
                motion.channels["wheel_load_N"][:, wheel],
                style,
                color=ink,
                lw=1.2,
                label=words,
            )
    ax.set(xlabel="time [s]", ylabel="wheel load [N]", xlim=(0, 6), ylim=(125, 245))
    ax.set_title("Start, left curve from 2 s, stop at 4.5 s", fontsize=10)
    ax.legend(fontsize=7.5, frameon=False, ncols=2, loc="upper center")


def draw_arcs(ax: Axes) -> None:
    """Draw the arc of 20 s."""
    for n, style in (("mujoco", "-"), (7.0, "-"), (RIGID, "--")):
        xy = arc(n).xy
        words = "MuJoCo" if isinstance(n, str) else f"tyres, C = {n:g}"
        ax.plot(*xy.T, style, color=_COLOURS[n], lw=2.2 if n == "mujoco" else 1.2, label=words)
        ax.plot(*xy[-1], "o", color=_COLOURS[n], ms=4)
    ax.set_aspect("equal", adjustable="datalim")
    ax.set(xlabel="x [m]", ylabel="y [m]")
    ax.set_title("20 s at 0.5 m/s and 0.6 rad/s asked", fontsize=10)
    ax.legend(fontsize=7.5, frameon=False, loc="center")


def main() -> None:
    """Print the tables and draw the four panels."""
    print_tables()
    figure = Figure(figsize=(11.0, 7.4), dpi=110, layout="constrained")
    figure.suptitle(
        "A robot on four brush tyres (stiffness C, in loads per unit of slip) beside the Husky in "
        "MuJoCo",
        fontsize=12,
    )
    for draw, ax in zip(
        (draw_thrust, draw_side_slip, draw_loads, draw_arcs),
        figure.subplots(2, 2).flat,
        strict=True,
    ):
        draw(ax)
        ax.spines[["top", "right"]].set_visible(False)
    figure.savefig(OUT)


if __name__ == "__main__":
    main()
