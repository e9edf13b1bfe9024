"""Print what is measured under "What an expert would object to" in docs/physics.md.

Run from the project's root: `python docs/make_objections.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ssmr.robot.drive import wheel_rates
from ssmr.scenarios import TRAJECTORIES
from ssmr.simulation import SAMPLE_DT
from ssmr.types import Commands, FloatArray, Plant, State, Trajectory
from validation.descriptions.loading import load_robot
from validation.plants.profile import bare_profile, load_profile
from validation.plants.table import plant_kind
from validation.simulator.calibration import Calibration
from validation.simulator.description import GRAVITY
from validation.simulator.health import apparent_mass
from validation.simulator.model import FREE_DRIVE
from validation.simulator.physics import PhysicsSettings
from validation.simulator.plant import MujocoPlant

LAB = load_profile("thesis-lab")
HUSKY = load_robot("husky")
RIGID = {"stiffness_x": 1000.0, "stiffness_y": 1000.0}
TURNING_RATIO = 1.8046
SPEEDS = (0.25, 0.5, 1.0)


def changed(plant: str, part: str, **numbers: float) -> Any:
    """Return the profile's section of a plant with other numbers in one part of it."""
    section = LAB.section(plant)
    return replace(section, **{part: replace(getattr(section, part), **numbers)})


def driven(plant: str, section: Any) -> dict[str, Trajectory]:
    """Return a plant's motion on each of the four trajectories."""
    made = plant_kind(plant).build(section)
    return {name: made.run(t.commands(), State(), SAMPLE_DT) for name, t in TRAJECTORIES.items()}


def apart(a: Mapping[str, Trajectory], b: Mapping[str, Trajectory]) -> str:
    """Return the greatest distances at equal times on each trajectory, in millimetres."""
    distances = [np.hypot(*(a[name].xy - b[name].xy).T).max() for name in a]
    return ", ".join(f"{1e3 * distance:.1f}" for distance in distances)


def steady_curve(plant: Plant, v: float) -> FloatArray:
    """Return the (3,) twist in a curve of 0.5 rad/s whose wheel rates are given."""
    reach = 0.5 * TURNING_RATIO * HUSKY.track
    left, right = wheel_rates(v, 0.5, reach, HUSKY.wheel_radius)
    commands = Commands(0.05, np.tile([left, right], (160, 1)), "wheels")
    start = State(v_x=v, yaw_rate=0.5, wheel_left=left, wheel_right=right)
    motion = plant.run(commands, start, 0.01)
    return np.asarray(motion.twist[motion.t > 7.0].mean(axis=0))


def print_lags() -> None:
    """Print the lag of MuJoCo's friction: its side slip less that of rigid tyres, over v omega."""
    section = bare_profile(HUSKY).section("four_wheel")
    parameters = replace(section.parameters, **RIGID, friction=0.5)
    rigid = plant_kind("four_wheel").build(replace(section, parameters=parameters))
    calibration = replace(Calibration.of(HUSKY), friction=0.5, rolling_resistance=0.0)
    for d_0 in (0.1, 0.3):
        settings = PhysicsSettings(solimp=(d_0, 0.95, 0.005, 0.5, 2.0))
        soft = MujocoPlant(calibration, FREE_DRIVE, settings=settings)
        for speed in SPEEDS:
            v, v_y, w = steady_curve(soft, speed)
            other = steady_curve(rigid, speed)
            wanted = other[1] * (v * w) / (other[0] * other[2])
            lag = (wanted - v_y) / (v * w)
            print(
                f"d_0 {d_0}, {speed} m/s: v_y {v_y:.4f}, rigid tyres {other[1]:.4f} m/s, "
                f"lag {1e3 * lag:.2f} ms"
            )


def print_work(motions: Mapping[str, Trajectory]) -> None:
    """Print the work of the motors and of rolling losses, even and in proportion to the load."""
    numbers = LAB.section("mujoco").parameters
    of_load = numbers.rolling_resistance * numbers.wheel_radius  # torque over load [m]
    for name, motion in motions.items():
        rates = np.abs(motion.wheels)
        loads = motion.channels["wheel_load_N"]
        sides = loads[:, :2] + loads[:, 2:]
        middle = 0.5 * (motion.wheels[1:] + motion.wheels[:-1])
        work = SAMPLE_DT * (motion.channels["torque_N_m"][1:] * middle).sum()
        lost = SAMPLE_DT * (of_load * 0.5 * numbers.mass * GRAVITY * rates).sum()
        knowing = SAMPLE_DT * (of_load * sides * rates).sum()
        shift = np.abs(np.diff(sides)).max()
        moment = 0.5 * HUSKY.track * numbers.rolling_resistance * shift
        print(
            f"{name}: motors {work:.0f} J, lost {lost:.0f} J, by load {knowing:.0f} J, "
            f"moment {moment:.2f} N m"
        )


def main() -> None:
    """Print all of it."""
    print_lags()
    base = driven("mujoco", LAB.section("mujoco"))
    rigid = driven("four_wheel", changed("four_wheel", "parameters", **RIGID))
    print("MuJoCo from four rigid tyres:", apart(base, rigid), "mm")
    for plant in ("improved", "coulomb", "linear"):
        heavier = driven(plant, changed(plant, "vehicle", yaw_inertia=4.42))
        print(f"{plant} with 4.42 kg m2:", apart(driven(plant, LAB.section(plant)), heavier), "mm")
    lighter = driven("mujoco", changed("mujoco", "parameters", yaw_inertia=3.6))
    print("MuJoCo with 3.6 kg m2:", apart(base, lighter), "mm")
    section = LAB.section("mujoco")
    model = MujocoPlant(section.parameters, section.drive).model
    print(f"apparent mass {apparent_mass(model):.1f} of {section.parameters.mass} kg")
    for armature in (0.05, 0.4):
        other = driven("mujoco", changed("mujoco", "parameters", armature=armature))
        peaks = [np.abs(m.channels["torque_N_m"]).max() for m in (base["traj1"], other["traj1"])]
        print(
            f"armature {armature}:",
            apart(base, other),
            f"mm, peak torque on 1 {peaks[1]:.1f} for {peaks[0]:.1f} N m",
        )
    print_work(base)


if __name__ == "__main__":
    main()
