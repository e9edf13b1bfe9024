"""Print the table of docs/drivetrain.md on what MuJoCo's contacts can do of the slip law.

Run from the project's root: `python docs/make_drivetrain_tables.py husky_wet_grass_train.csv`. The
page's figure is that of `python -m validation.study drivetrain`.
"""

from __future__ import annotations

import sys
from functools import partial

import numpy as np
from scipy.optimize import least_squares

from ssmr.robot.drivetrain import bridge_reading, side_forces
from ssmr.robot.vehicle import Drive
from ssmr.types import Commands, FloatArray, State
from validation import load_profile, load_robot
from validation.identify.currents import COULOMB_SCALE
from validation.identify.motor_logs import chassis_of, drive_log, sensor_of, steady_samples
from validation.plants.kind import GROUND_TORQUES
from validation.simulator.calibration import Calibration
from validation.simulator.physics import PhysicsSettings
from validation.simulator.plant import MujocoPlant
from validation.study.contact import creep_speed

_ROBOT = load_robot("husky")
husky = partial(Calibration.of, _ROBOT)

FRICTION = 0.55
"""Friction coefficient of the MuJoCo Husky [1]: that of the Husky on wet grass if its torque
constant is 2.5 N m/A."""
IMPRATIOS = (100.0, 10.0, 2.0, 1.0, 0.5, 0.2, 0.1)
LAW_SCALE = 0.080
"""Slip scale of the law [1], as the study finds it."""
CHECKED = 0.5
"""`impratio` at which the other step and the other speed are tried."""
CURVE = np.array([[2.5, 1.25], [3.0, 1.5]])
"""Wheel rates of one curve at two speeds [rad/s]."""
HUSKY = chassis_of(load_profile("husky-tile"))


def mujoco_shares(
    rates: FloatArray, impratio: float, timestep: float = 0.002
) -> tuple[FloatArray, float]:
    """Return (2, n) torques of the sides over their friction torque, and the creep [m/s].

    The wheel rates, (2, n), are steady.
    """
    calibration = husky(
        friction=FRICTION,
        wheel_radius=HUSKY.vehicle.wheel_radius,
        mass=HUSKY.vehicle.mass,
        timestep=timestep,
    )
    plant = MujocoPlant(calibration, Drive(), settings=PhysicsSettings(impratio=impratio))
    # 5 s, the first one speeds up
    ramp, shares = np.clip(np.arange(100) / 20.0, 0.0, 1.0)[:, None], np.empty_like(rates)
    for k, rate in enumerate(rates.T):
        motion = plant.run(Commands(0.05, ramp * rate, "wheels"), State(), 0.01)
        late = motion.t > 3.0
        weight = motion.channels["wheel_load_N"][late].sum(axis=1).mean()
        torque = motion.channels[GROUND_TORQUES][late].mean(axis=0)
        shares[:, k] = torque / (0.5 * FRICTION * weight * HUSKY.vehicle.wheel_radius)
    return shares, creep_speed(plant)


def law_shares(rates: FloatArray, scale: float) -> FloatArray:
    """Return (2, n) forces of the sides over their friction limits under the slip law."""
    return side_forces(rates, HUSKY.vehicle, scale)


def main(path: str) -> None:
    """Fit friction, losses and rho to currents with each contact; print how much that explains."""
    log = drive_log(path)
    _, means = steady_samples(log)
    sensor = sensor_of(log)
    known = np.isfinite(means.currents)
    currents = means.currents[known]
    rates, inverse = np.unique(means.rates.round(3), axis=1, return_inverse=True)

    def explains(shares: FloatArray) -> float:
        effort = shares[:, inverse.ravel()]

        def off(x: FloatArray) -> FloatArray:
            needed = x[0] * effort + x[1:3, None] * np.sign(means.rates)
            shown = bridge_reading(needed, means.rates, x[3], sensor.ripple, sensor.idle)
            return shown[known] - currents

        bounds = ([1.0, -2.0, -2.0, 0.03], [60.0, 9.0, 9.0, 0.5])
        solution = least_squares(
            off, [12.0, 2.4, 3.0, 0.15], bounds=bounds, loss="soft_l1", f_scale=1.3
        )
        return float(1.0 - np.mean(off(solution.x) ** 2) / np.var(currents))

    print("| contacts | R² | nearest slip scale | creep on a slope [mm/s] |\n|---|---:|---:|---:|")
    print(f"| Coulomb | {explains(law_shares(rates, COULOMB_SCALE)):.2f} | 0 | |")
    print(f"| the slip law | {explains(law_shares(rates, LAW_SCALE)):.2f} | {LAW_SCALE:.3f} | |")
    for impratio in IMPRATIOS:
        shares, speed = mujoco_shares(rates, impratio)
        near = least_squares(
            lambda x, shares=shares: (law_shares(rates, x[0]) - shares).ravel(),
            [0.05],
            bounds=([0.001], [2.0]),
        )
        print(
            f"| MuJoCo, impratio {impratio:g} | {explains(shares):.2f} | {near.x[0]:.3f} | "
            f"{1e3 * speed:.2f} |",
            flush=True,
        )
    fine, _ = mujoco_shares(rates, CHECKED, 0.001)
    print(f"impratio {CHECKED:g} at 1 ms: R² {explains(fine):.2f}")
    curve, _ = mujoco_shares(CURVE, CHECKED)
    print(
        f"shares of the right side in a curve and at half its speed: MuJoCo {curve[1].round(3)}",
        end=", ",
    )
    print(f"law {law_shares(CURVE, LAW_SCALE)[1].round(3)}")


if __name__ == "__main__":
    main(sys.argv[1])
