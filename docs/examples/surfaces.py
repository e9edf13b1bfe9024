"""Measure on many surfaces how far the planar models are from the MuJoCo Husky; each surface is a task of a dask cluster.

`python docs/examples/surfaces.py [tcp://HOST:8786]`; without an address it uses the cores of this machine.
"""

from __future__ import annotations

import itertools
import sys
from dataclasses import replace

import numpy as np
from distributed import Client, LocalCluster, as_completed

from ssmr.metrics.declared import compare_paths
from ssmr.scenarios import TRAJECTORIES
from ssmr.simulation import SAMPLE_DT
from ssmr.types import State
from validation.plants.profile import load_profile, make_plant
from validation.simulator.plant import MujocoPlant
from validation.simulator.terrain import parse_terrain

FRICTIONS = (0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
TERRAINS = ("flat", "ramp:2", "ramp:slope_deg=2,toward_deg=90", "rough:2", "split:0.7")


def one_surface(friction: float, terrain: str) -> dict[str, float]:
    """Return the mean d_rms [m] of each planar model over trajectories 1-4; a worker needs nothing but the arguments."""
    profile = load_profile("thesis-lab")
    section = profile.plants["mujoco"]
    husky = MujocoPlant(replace(section.parameters, friction=friction), section.drive, terrain=parse_terrain(terrain))
    found: dict[str, list[float]] = {"improved": [], "coulomb": [], "linear": []}
    for scenario in TRAJECTORIES.values():
        truth = husky.run(scenario.commands(), State(), SAMPLE_DT)
        for name, distances in found.items():
            motion = make_plant(profile, name).run(scenario.commands(), State(), SAMPLE_DT)
            distances.append(compare_paths(motion, truth)["d_rms_m"])
    return {name: float(np.mean(distances)) for name, distances in found.items()}


def main(address: str | None) -> None:
    """Spread the surfaces over the workers and print each result when it arrives."""
    with LocalCluster(threads_per_worker=1, dashboard_address=None) if address is None else Client(address) as cluster:
        client = cluster if isinstance(cluster, Client) else Client(cluster)
        surfaces = list(itertools.product(FRICTIONS, TERRAINS))
        surface_of = dict(zip(client.map(one_surface, *zip(*surfaces, strict=True)), surfaces, strict=True))
        for task in as_completed(surface_of):
            friction, terrain = surface_of[task]
            answer = ", ".join(f"{name} {1e3 * d:.0f} mm" for name, d in task.result().items())
            print(f"friction {friction}, {terrain}: {answer}")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else None)
