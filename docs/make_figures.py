"""Draw the figure of docs/physics.md; with `--tables`, print the numbers of its tables.

Run from the project's root: `python docs/make_figures.py [--tables]`.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
from matplotlib.figure import Figure

from ssmr.robot.drive import wheel_rates
from ssmr.robot.ground import turn_on_the_spot
from ssmr.robot.vehicle import Drive
from ssmr.scenarios import TRAJECTORIES
from ssmr.types import Commands, State, Trajectory
from validation import load_robot
from validation.plants.profile import load_profile
from validation.simulator.calibration import Calibration
from validation.simulator.health import check_health, run_health
from validation.simulator.model import GRAVITY, WHEELS, pressed_in, robot_model
from validation.simulator.motors import actuator_inputs
from validation.simulator.physics import MUJOCO_IMPEDANCE, SHIPPED, Impedance, PhysicsSettings
from validation.simulator.plant import MujocoPlant
from validation.study.contact import creep_speed

_ROBOT = load_robot("husky")
husky = partial(Calibration.of, _ROBOT)
CAPSULE = husky().capsule_half_width
HALF_WIDTH = {"ellipsoid": 0.0, "capsule": CAPSULE, "cylinder": 0.5 * _ROBOT.wheel_width}
WHEELBASE = _ROBOT.wheelbase
TRACK = _ROBOT.track

RADIUS = 0.1651
WEIGHT = 73.30 * GRAVITY
DIAGONAL = math.hypot(WHEELBASE, TRACK)
CONTACT_TIME = 0.02
GREATEST_IMPEDANCE = 0.95
"""solref[0] [s] and solimp[1], equal in both contacts."""
HALF_TRACK = 0.5 * TRACK * 1.8
"""Half-track of the driver in all turns below [m]."""
FREE = Drive(
    v_max=5.0,
    w_max=5.0,
    delay_v=0.0,
    delay_w=0.0,
    command_half_track=HALF_TRACK,
    torque_limit=math.inf,
)
"""A drive that does at once whatever it is told."""
OUT = Path(__file__).parent / "img" / "contact.png"


@dataclass(frozen=True)
class Turn:
    """Measures of a steady turn over its last 3 s."""

    multiplier: float
    """Yaw rate of the wheels over that of the body, by the rolling radius [1]."""
    by_contact_radius: float
    """Multiplier by the distance of the contact points from the axle while turning [1]."""
    contact_radius: float
    """Distance of the contact points from the axle [m]; at rest it is the rolling radius."""
    ripple: float
    """Range of the yaw rate over its mean [1]."""
    lowest_load: float
    """Least wheel load over its mean [1]."""
    depth: float
    """Depth by which the tyres are pressed in [m]."""
    rate: float
    """Yaw rate [rad/s]."""
    torque: float
    """Torque of a side [N m]."""


def turn(
    calibration: Calibration,
    rate: float = 0.6,
    solimp: Impedance | None = None,
    seconds: float = 6.0,
) -> Turn:
    """Turn on the spot with unlimited torque."""
    model = robot_model(calibration, settings=PhysicsSettings(solimp=solimp))
    data = mujoco.MjData(model)
    rates = np.array(wheel_rates(0.0, rate, HALF_TRACK, RADIUS))
    data.ctrl[:] = actuator_inputs(model, rates)
    left = model.joint("front_left_wheel").dofadr[0]
    right = model.joint("front_right_wheel").dofadr[0]
    rows = []
    skip = round((seconds - 3.0) / calibration.timestep)
    for k in range(round(seconds / calibration.timestep)):
        mujoco.mj_step(model, data)
        if k >= skip:
            depths = [-contact.dist for contact in data.contact]
            loads = [data.sensor(f"load_{wheel}").data[0] for wheel in WHEELS]
            deep = sum(depths) / max(len(depths), 1)
            torque = sum(data.sensor(f"torque_{end}_right").data[0] for end in ("front", "rear"))
            rows.append((data.qvel[5], data.qvel[right] - data.qvel[left], deep, torque, *loads))
    table = np.array(rows)
    yaw_rate, wheels, depth, torque = table[:, :4].mean(axis=0)
    multiplier = RADIUS * wheels / (TRACK * yaw_rate)
    contact_radius = RADIUS + 0.5 * pressed_in(model, calibration).mean() - 0.5 * depth
    loads = table[:, 4:]
    return Turn(
        multiplier,
        multiplier * contact_radius / RADIUS,
        contact_radius,
        float(np.ptp(table[:, 0]) / yaw_rate),
        float((loads.min(axis=0) / loads.mean(axis=0)).min()),
        depth,
        yaw_rate,
        torque,
    )


def print_row(*cells: object) -> None:
    """Print one row of a markdown table."""
    print("| " + " | ".join(str(cell) for cell in cells) + " |", flush=True)


def table_turning() -> None:
    """Print multipliers by shape, friction and step, under soft and default contact."""
    print(
        "\nshape, friction: soft at 1, 2, 5 ms; by contact radius at 2 ms; closed form; "
        "default contact at 1, 2, 5 ms"
    )
    for shape, half_width in HALF_WIDTH.items():
        for friction in (0.1, 0.3, 0.6, 0.8):
            base = husky(friction=friction, wheel_shape=shape)  # type: ignore[arg-type]
            steps = [replace(base, timestep=dt) for dt in (0.001, 0.002, 0.005)]
            soft = [turn(c) for c in steps]
            default = [turn(c, solimp=MUJOCO_IMPEDANCE) for c in steps]
            print_row(
                shape,
                friction,
                *(f"{t.multiplier:.4f}" for t in soft),
                f"{soft[1].by_contact_radius:.4f}",
                f"{turn_on_the_spot(WHEELBASE, TRACK, half_width=half_width).multiplier:.4f}",
                *(f"{t.multiplier:.1f}" for t in default),
                f"{max(t.ripple for t in soft):.0e}",
                f"{max(t.lowest_load for t in default):.2f}",
            )
    print("\nratio of frictions (capsule, 0.4): measured, by contact radius, closed form")
    for ratio in (0.8, 1.0, 1.24, 1.5):
        shown = turn(husky(friction=0.4, wheel_shape="capsule", friction_ratio=ratio))
        form = turn_on_the_spot(WHEELBASE, TRACK, ratio=ratio, half_width=CAPSULE).multiplier
        print_row(ratio, f"{shown.multiplier:.3f}", f"{shown.by_contact_radius:.3f}", f"{form:.3f}")
    print("\nfriction: torque of a side, closed form with the contact's radius [N m]")
    for friction in (0.1, 0.3, 0.6, 0.8):
        shown = turn(husky(friction=friction))
        form = shown.contact_radius * friction * 0.5 * WEIGHT * WHEELBASE / DIAGONAL
        print_row(
            friction, f"{shown.torque:.2f}", f"{form:.2f}", f"depth {1e3 * shown.depth:.2f} mm"
        )


def table_lift() -> None:
    """Print, by impedance at zero depth, the largest friction times slip speed without lift."""
    print("\nimpedance d0, friction: mu v at which a tyre lifts [m/s]")
    for d0 in (0.1, 0.2, 0.5, 0.9):
        for friction in (0.3, 0.6, 1.0):
            low = 0.05
            high = 20.0
            impedance = (d0, 0.95, 0.005, 0.5, 2.0)
            for _ in range(8):
                rate = math.sqrt(low * high)
                shown = turn(husky(friction=friction), rate, impedance, 4.0)
                if shown.lowest_load < 0.01:
                    high = rate
                else:
                    low = rate
                    last = shown
            slip = last.rate * 0.5 * WHEELBASE * DIAGONAL / TRACK
            print_row(d0, friction, f"{friction * slip:.4f}")


def table_rise() -> None:
    """Print the body's rise at a friction times slip speed, turning on the spot."""
    print("\nfriction 0.3, mu v [m/s]: rise of the body [mm]")
    still = turn(husky(), 1e-3, None, 4.0).depth
    for product in (0.05, 0.1, 0.2, 0.4, 0.6, 0.7):
        shown = turn(husky(), product / 0.3 * TRACK / (0.5 * WHEELBASE * DIAGONAL), None, 4.0)
        print_row(product, f"{1e3 * (still - shown.depth):.2f}")


def table_trembling() -> None:
    """Print how far the loads' sum trembles on trajectories 1 and 4, by gain, armature and lag."""
    print(
        "\ngain, armature, lag [ms]: rms of the loads' sum about the weight on trajectories 1 and "
        "4 [N]"
    )
    for gain, armature, lag in (
        (2100.0, 1.8, 0.0),
        (2100.0, 1.8, 0.02),
        (2100.0, 1.8, 0.05),
        (2100.0, 0.3, 0.0),
        (118.04, 0.3, 0.0),
        (118.04, 0.1, 0.02),
        (118.04, 0.1, 0.05),
    ):
        calibration = husky(friction=0.7, gain=gain, armature=armature)
        plant = MujocoPlant(calibration, replace(lab_drive(400.0), wheel_lag=lag))
        runs = [
            plant.run(TRAJECTORIES[name].commands(), State(), plant.dt)
            for name in ("traj1", "traj4")
        ]
        print_row(
            gain,
            armature,
            1e3 * lag,
            *(f"{run_health(plant.model, [run])['load_sum_rms_N']:.1f}" for run in runs),
        )


def lab_drive(torque_limit: float) -> Drive:
    """Return the thesis' drive with another half-track and torque limit."""
    return Drive(command_half_track=HALF_TRACK, torque_limit=torque_limit)


def trajectory(
    scenario: str, calibration: Calibration, drive: Drive, settings: PhysicsSettings = SHIPPED
) -> Trajectory:
    """Drive one of trajectories 1-4, sampled every 10 ms."""
    return MujocoPlant(calibration, drive, settings=settings).run(
        TRAJECTORIES[scenario].commands(), State(), 0.01
    )


def ends_apart(coarse: Trajectory, fine: Trajectory) -> float:
    """Return the distance between the end points [mm]."""
    return 1e3 * float(np.hypot(*(coarse.xy[-1] - fine.xy[-1])))


def table_steps() -> None:
    """Print convergence with the time step on trajectories 1-4, and over gain and armature."""
    print(
        "\nfriction, torque limit, trajectory: end moves from 5 to 2, 2 to 1, 1 to 0.5 ms [mm]; "
        "loads; side slip [m/s]"
    )
    lab = load_profile("thesis-lab").plants["mujoco"]
    grounds = {
        (mu, limit): (husky(friction=mu), lab_drive(limit))
        for mu, limit in ((0.14, 7.0), (0.4, 20.0))
    }
    for ground, (calibration, drive) in {
        **grounds,
        ("thesis-lab",): (lab.parameters, lab.drive),
    }.items():
        for scenario in TRAJECTORIES:
            runs = [
                trajectory(scenario, replace(calibration, timestep=dt), drive)
                for dt in (0.005, 0.002, 0.001, 0.0005)
            ]
            apart = [f"{ends_apart(a, b):.2f}" for a, b in pairwise(runs)]
            health = check_health(runs[1].channels["wheel_load_N"])
            slip = np.abs(runs[1].twist[runs[1].t > 3.0, 1]).max()
            loads = f"{health['lowest_load_share']:.2f}", f"{health['load_deviation']:.3f}"
            print_row(
                *ground,
                scenario,
                *apart,
                *loads,
                f"{slip:.3f}",
                f"yaw {np.ptp(runs[1].yaw):.2f} rad",
            )
    print("\npyramidal cone, trajectory 4: end moves from 2 to 1, 1 to 0.5 ms [mm]")
    for (friction, _), (calibration, drive) in grounds.items():
        steps = [replace(calibration, timestep=dt) for dt in (0.002, 0.001, 0.0005)]
        runs = [
            trajectory("traj4", step, drive, PhysicsSettings(cone="pyramidal")) for step in steps
        ]
        print_row(friction, *(f"{ends_apart(a, b):.0f}" for a, b in pairwise(runs)))
    print(
        "\ngain, armature: time constant [ms], end moves from 2 to 1 ms on trajectories 1 and 4 "
        "[mm]"
    )
    for gain, armature in (
        (118.04, 1.0),
        (118.04, 0.3),
        (118.04, 0.1),
        (118.04, 0.03),
        (400.0, 0.3),
        (783.0, 0.3),
        (783.0, 0.11),
    ):
        steps = [
            husky(friction=0.14, gain=gain, armature=armature, timestep=dt) for dt in (0.002, 0.001)
        ]
        moved = [
            ends_apart(*(trajectory(scenario, c, lab_drive(7.0)) for c in steps))
            for scenario in ("traj1", "traj4")
        ]
        print_row(
            gain,
            armature,
            f"{2e3 * (armature + 0.04411) / gain:.1f}",
            *(f"{mm:.1f}" for mm in moved),
        )


def settled(calibration: Calibration) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return a robot at rest on its tyres."""
    model = robot_model(calibration)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=500)
    return model, data


def table_rest() -> None:
    """Print creep on a side slope of 8 degrees, and stops with blocked wheels."""
    print("\nshape, friction: creep at impratio 1, 10, 100 [mm/s]")
    for shape in HALF_WIDTH:
        for friction in (0.2, 0.6):
            speeds = []
            for impratio in (1.0, 10.0, 100.0):
                calibration = husky(friction=friction, wheel_shape=shape)  # type: ignore[arg-type]
                plant = MujocoPlant(
                    calibration, lab_drive(math.inf), settings=PhysicsSettings(impratio=impratio)
                )
                speeds.append(f"{1e3 * creep_speed(plant):.3f}")
            print_row(shape, friction, *speeds)
    print(
        "\nfriction: stop from 0.5 forward, 0.5 sideways, 1.5 forward, "
        "1.5 sideways [% off v^2 / (2 mu g)]"
    )
    for friction in (0.1, 0.3, 0.6, 0.8):
        off = []
        for speed in (0.5, 1.5):
            for axis in (0, 1):
                model, data = settled(husky(friction=friction, armature=30.0, gain=1e4))
                data.qvel[axis] = speed
                start = data.qpos[axis]
                mujoco.mj_step(model, data, nstep=round(2.0 * speed / (friction * GRAVITY) / 0.002))
                way = data.qpos[axis] - start
                expected = speed**2 / (2.0 * friction * GRAVITY)
                off.append(f"{100.0 * (way / expected - 1.0):+.1f}")
        print_row(friction, *off)


def table_between() -> None:
    """Print side slip and droop, in which the MuJoCo Husky differs from a planar model."""
    print(
        "\nfriction, v, omega: measured v_y, predicted [m/s], x_ICR [m], "
        "multiplier by contact radius at rest"
    )
    lag = 0.5 * CONTACT_TIME * GREATEST_IMPEDANCE
    for friction in (0.2, 0.4, 0.8):
        for v, w in ((0.25, 0.5), (0.5, 0.25), (0.5, 0.5), (0.5, 0.75), (1.0, 0.5)):
            motion = MujocoPlant(husky(friction=friction), FREE).run(
                Commands(0.05, np.tile([v, w], (200, 1))), State(), 0.01
            )
            tail = motion.t > 7.0
            (v_x, v_y, rate), wheels = (
                motion.twist[tail].mean(axis=0),
                motion.wheels[tail].mean(axis=0),
            )
            expected = (
                -v_x * rate**2 * DIAGONAL**3 / (2.0 * friction * GRAVITY * WHEELBASE * TRACK)
                - lag * v_x * rate
            )
            multiplier = RADIUS * (wheels[1] - wheels[0]) / (TRACK * rate)
            numbers = (
                f"{v_x:.3f}",
                f"{rate:.3f}",
                f"{v_y:.4f}",
                f"{expected:.4f}",
                f"{-v_y / rate:.3f}",
                f"{multiplier:.3f}",
            )
            print_row(friction, v, w, *numbers)
    print("\nfriction, gain, commanded rate: share of the wheels' share reached, predicted")
    for friction in (0.14, 0.4):
        for gain in (60.0, 118.04, 400.0):
            for w in (0.25, 0.75):
                shown = turn(husky(friction=friction, gain=gain), w)
                wheel = HALF_TRACK * w / RADIUS
                load = shown.contact_radius * friction * 0.5 * WEIGHT * WHEELBASE / DIAGONAL
                reached = shown.multiplier * TRACK * shown.rate / (2.0 * RADIUS * wheel)
                print_row(
                    friction,
                    gain,
                    w,
                    f"{reached:.4f}",
                    f"{1.0 - load / gain / wheel:.4f}",
                    f"{shown.rate / w:.3f}",
                )


def draw() -> None:
    """Draw multiplier over time step, and a wheel's load over time, of default and soft contact."""
    steps = (0.00025, 0.0005, 0.001, 0.002, 0.005, 0.01)
    figure = Figure(figsize=(9.0, 3.6), dpi=120, layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    looks = {
        "ellipsoid": ("o", "ellipsoid (touches at a point)"),
        "cylinder": ("s", "cylinder (touches along a line)"),
    }
    for solimp, colour, contact in (
        (MUJOCO_IMPEDANCE, "#d55e00", "default"),
        (None, "#0072b2", "soft"),
    ):
        for shape, (marker, label) in looks.items():
            base = husky(friction=0.6, wheel_shape=shape)  # type: ignore[arg-type]
            measured = [turn(replace(base, timestep=dt), solimp=solimp).multiplier for dt in steps]
            fill = colour if shape == "ellipsoid" else "white"
            left.plot(
                [1e3 * dt for dt in steps],
                measured,
                marker,
                ls="-",
                lw=1.2,
                color=colour,
                markerfacecolor=fill,
                label=f"{contact} contact, {label}",
            )
    for shape, style in (("ellipsoid", "-"), ("cylinder", "--")):
        form = turn_on_the_spot(WHEELBASE, TRACK, half_width=HALF_WIDTH[shape]).multiplier
        name = "a point" if shape == "ellipsoid" else "a line"
        left.axhline(form, color="black", lw=0.8, ls=style, label=f"formula for {name}: {form:.3f}")
    left.set(
        xscale="log",
        xlabel="time step [ms]",
        ylabel="wheels' yaw rate over the robot's",
        ylim=(1.7, 3.5),
    )
    left.set_xticks([1e3 * dt for dt in steps], [f"{1e3 * dt:g}" for dt in steps], minor=False)
    left.minorticks_off()
    left.legend(fontsize=8, frameon=False, loc="upper left")
    left.set_title("Turning on the spot, friction 0.6", fontsize=10)
    for solimp, colour, contact in (
        (MUJOCO_IMPEDANCE, "#d55e00", "default"),
        (None, "#0072b2", "soft"),
    ):
        plant = MujocoPlant(husky(friction=0.6), FREE, settings=PhysicsSettings(solimp=solimp))
        motion = plant.run(Commands(0.05, np.tile([0.0, 0.6], (100, 1))), State(), plant.dt)
        shown = motion.t > 4.8
        load = motion.channels["wheel_load_N"][shown, 0]
        right.plot(motion.t[shown] - 4.8, load, color=colour, lw=1.0, label=f"{contact} contact")
    right.set(xlabel="time [s]", ylabel="load of the front left wheel [N]", ylim=(0.0, 490.0))
    right.legend(fontsize=8, frameon=False, loc="upper right", ncols=2)
    right.set_title("Wheel load in this turn (ellipsoid, 2 ms)", fontsize=10)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(OUT)


if __name__ == "__main__":
    if sys.argv[1:] == ["--tables"]:
        for table in (
            table_turning,
            table_lift,
            table_rise,
            table_trembling,
            table_steps,
            table_rest,
            table_between,
        ):
            table()
    draw()
