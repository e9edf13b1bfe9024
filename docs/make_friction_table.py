"""Print measures of a MuJoCo robot's friction, for docs/friction.md.

Usage: `python docs/make_friction_table.py`. Standard errors are those at the profile's numbers: the
inverse of the information that poses and torques on trajectory 4 have of the six causes, by central
differences, with one independent sample a second.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ssmr.types import FloatArray
from validation.experiment.sources import open_source
from validation.plants.kind import CAUSES
from validation.plants.profile import load_profile
from validation.plants.searchable import find_number, make_space, with_values
from validation.plants.table import plant_kind

STEP = 0.005  # of the bounds' width, to either side
INF = np.inf
MEASURED: Mapping[str, tuple[float, float, float]] = {
    "positions, 2 mm, and headings, 2 mrad": (0.002, 0.002, INF),
    "headings alone, 2 mrad": (INF, 0.002, INF),
    "both and torques, 5 N m": (0.002, 0.002, 5.0),
    "both and torques, 1 N m": (0.002, 0.002, 1.0),
    "torques alone, 1 N m": (INF, INF, 1.0),
}
"""Standard deviations of the noise of positions [m], headings [rad] and torques [N m]."""
KNOWN: Mapping[str, tuple[str, ...]] = {
    "nothing": (),
    "`dc_stiffness`": ("dc_stiffness",),
    "`com_x`": ("com_x",),
    "both": ("dc_stiffness", "com_x"),
    "all but friction": tuple(name for name in CAUSES if name != "friction"),
}
"""Numbers that are held."""


def slopes() -> FloatArray:
    """Return (6, M, 5) derivatives of poses and torques, over the width of each number's bounds."""
    base = load_profile("thesis-lab").section("mujoco")
    space = make_space("mujoco", CAUSES, {}, base.robot)
    values = np.array([[find_number("mujoco", name, base.robot).read(base) for name in CAUSES]])
    point = space.points(values)[0]
    steps = STEP * np.eye(len(CAUSES))
    points = np.concatenate([point + steps, point - steps])
    made = [with_values("mujoco", base, CAUSES, space.values(p).tolist()) for p in points]
    source = open_source("traj4@mujoco")
    population = plant_kind("mujoco").population(made, 1)
    motions = population.motions(range(len(made)), source.pieces[0], source.sample_dt)
    ahead, behind = np.split(motions, 2)
    every = round(1.0 / source.sample_dt)
    return (ahead - behind)[:, ::every] / (2.0 * STEP)


def main() -> None:
    """Print the table."""
    derivative = slopes()
    base = load_profile("thesis-lab").section("mujoco")
    (friction,) = make_space("mujoco", ("friction",), {}, base.robot).parameters
    width = friction.upper - friction.lower
    print(f"| measured | {' | '.join(KNOWN)} |")
    print("|---|" + "---:|" * len(KNOWN))
    for what, (position, heading, torque) in MEASURED.items():
        noise = np.array([position, position, heading, torque, torque])
        cells = []
        for held in KNOWN.values():
            free = [k for k, name in enumerate(CAUSES) if name not in held]
            seen = (derivative[free] / noise).reshape(len(free), -1)
            ignorance = 12.0 * np.eye(len(free))  # what the bounds alone say
            covariance = np.linalg.inv(seen @ seen.T + ignorance)
            own = free.index(CAUSES.index("friction"))
            cells.append(f"±{width * np.sqrt(covariance[own, own]):.2g}")
        print(f"| {what} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
