"""Suppositions about what the thesis does not print, under which some rows agree that do not agree as printed.

Each holds for all tables of its kind, never for a single row, and is a supposition still: nothing in the thesis says so.
docs/tracking.md shows what was tried, and what each does to every row.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ssmr.robot.sensors import SAMPLE_RATES_HZ
from ssmr.types import Trajectory
from validation.track.gains import GainSet

KNOWN_GEOMETRY = ("line", "circle")
"""References whose geometry the thesis gives, so that a supposition about anything else can be tested."""
PATH_RATE_HZ = SAMPLE_RATES_HZ["command"]
"""Supposed rate at which the simulated path was logged before it was compared with a reference [Hz]: that of commands."""
K_11, K_33 = 4.0, 2.75
"""Supposed gains of the LQR from the error along the path to speed, and from that of heading to yaw rate [1/s]."""
_LOGGED = f"the simulated path was logged at {PATH_RATE_HZ:g} Hz, so that its samples lie {{spacing:g}} mm apart"
_DRIVEN = (
    f"the LQR drove with K_11 = {K_11:g} and K_33 = {K_33:g} 1/s and no weight on the rates, instead of the manual column "
    "of Tab. 4.21"
)


def supposed_gains(gains: GainSet) -> GainSet:
    """Return an LQR's set with the supposed K_11 and K_33: K_11 = sqrt(Q_11 / R_11), K_33 = sqrt(Q_33 / R_22)."""
    old = gains.values
    new = {"q_x": K_11**2 * old["r_v"], "q_yaw": K_33**2 * old["r_w"], "q_v": 0.0, "q_w": 0.0}
    return GainSet(gains.controller, f"{gains.name}, supposed", {**old, **new})


def supposed_path(motion: Trajectory) -> Trajectory:
    """Return a motion as it is logged at `PATH_RATE_HZ`: each sample is the first of the motion at or after its time."""
    times = np.arange(motion.t[0], motion.t[-1], 1.0 / PATH_RATE_HZ)
    k = np.unique(np.append(np.searchsorted(motion.t, times - 1e-9), len(motion.t) - 1))
    return Trajectory(motion.t[k], motion.pose[k], motion.twist[k], motion.wheels[k])


def supposition(content: Mapping[str, object]) -> str:
    """Return the supposition for one of the thesis' tables in words, without a full stop; empty if there is none."""
    if content["trajectory"] not in KNOWN_GEOMETRY or content.get("suspect"):
        return ""
    logged = _LOGGED.format(spacing=1e3 * float(str(content["speed_m_s"])) / PATH_RATE_HZ)
    driven = [_DRIVEN] * (content["controller"] == "lqr")
    return ", and ".join(driven + [logged] * (content["comparison"] == "reference_vs_simulated"))
