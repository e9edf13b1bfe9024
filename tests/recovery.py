"""A MuJoCo robot whose friction and other causes were drawn, and what noisy sensors saw of it.

`python -m tests.recovery` fits robots one after another and prints what was found of each.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ssmr.search.jde import JdeSettings
from validation.experiment.runs import drive_piece
from validation.experiment.sources import Source, open_source
from validation.fit import Fit
from validation.identify.objective import FitCost
from validation.identify.problem import FitProblem
from validation.identify.search import Method, search_for
from validation.identify.uncertainty import estimate_uncertainty, uncertainty_sentences
from validation.plants.kind import TORQUES
from validation.plants.profile import Profile, load_profile, make_plant
from validation.plants.searchable import find_number, make_space, with_values
from validation.plants.table import plant_kind

POSITION = 0.002
HEADING = 0.002
TORQUE = 1.0
"""Standard deviations of the noise of each sample [m], [rad], [N m]."""
SECONDS = 10.0
"""Length of the drive: the first half of trajectory 4, in which every kind of bend occurs [s]."""
RANGES: Mapping[str, tuple[float, float]] = {
    "friction": (0.3, 0.9),
    "com_x": (-0.03, 0.03),
    "command_half_track": (0.45, 0.55),
    "wheel_radius": (0.157, 0.168),
    "acceleration_v": (0.8, 2.0),
    "dc_stiffness": (400.0, 2500.0),
}
"""Ranges from which a robot's numbers are drawn, evenly."""


@dataclass(frozen=True)
class Way:
    """A way to search for the numbers."""

    population: int
    generations: int
    method: Method = "jde"
    """What it is made of; lsq begins with the profile."""


JDE = Way(20, 90)
HYBRID = Way(20, 4, method="hybrid")
LEAST_SQUARES = Way(5, 1, method="lsq")


@dataclass(frozen=True, eq=False)
class Recovered:
    """The result of a fit to one robot whose numbers are known."""

    off: Mapping[str, float]
    """Errors of the fitted numbers, fitted less true, by name."""
    errors: Mapping[str, float]
    """Standard errors, by name."""
    seconds: float
    """Time that the search took [s]."""
    evaluations: int
    """Candidates that it rated."""
    notes: list[str]
    """Sentences on what the data cannot tell."""


def drawn(seed: int) -> dict[str, float]:
    """Return the numbers of a robot."""
    rng = np.random.default_rng([seed, 41])
    return {name: float(rng.uniform(*ends)) for name, ends in RANGES.items()}


def noisy_target(truth: Mapping[str, float], seed: int, seconds: float = SECONDS) -> Source:
    """Return what sensors see of the robot with these numbers along a part of trajectory 4."""
    lab = load_profile("thesis-lab")
    section = with_values("mujoco", lab.section("mujoco"), list(truth), truth.values())
    source = open_source("traj4@mujoco")
    commands = source.pieces[0].commands
    kept = replace(commands, values=commands.values[: round(seconds / commands.dt)])
    piece = replace(source.pieces[0], commands=kept)
    plant = make_plant(Profile("drawn", "", {"mujoco": section}, {}), "mujoco")
    motion = drive_piece(plant, piece, section.localiser, source.sample_dt)
    rng = np.random.default_rng([seed, 42])
    noise = rng.normal(size=motion.pose.shape) * [POSITION, POSITION, HEADING]
    torques = motion.channels[TORQUES] + TORQUE * rng.normal(size=(len(motion.t), 2))
    seen = replace(motion, pose=motion.pose + noise)
    known = replace(piece, reference=seen, torques=torques)
    return replace(source, name="drawn", pieces=(known,))


def recover(seed: int, way: Way, torque_weight: float | None = None, workers: int = 1) -> Recovered:
    """Fit the default list from default bounds to a robot that was drawn."""
    truth = drawn(seed)
    base = load_profile("thesis-lab").section("mujoco")
    space = make_space("mujoco", plant_kind("mujoco").free["scenario"], {}, base.robot)
    cost = FitCost(yaw_weight=0.2, torque_weight=torque_weight)
    problem = FitProblem("mujoco", base, space, [noisy_target(truth, seed)], cost)
    asked = Fit("mujoco", "traj4@mujoco", workers=workers, seed=seed)
    profile = [find_number("mujoco", name, base.robot).read(base) for name in space.names]
    start = space.points(np.array([profile])) if way.method == "lsq" else None
    settings = JdeSettings(way.population, way.generations)
    search = search_for(problem, settings, asked, start, way.method)
    sure = estimate_uncertainty(problem, search.best, workers, search.driven)
    values = zip(space.names, space.values(search.best).tolist(), strict=True)
    errors = dict(zip(space.names, sure.standard_error.tolist(), strict=True))
    off = {name: value - truth[name] for name, value in values}
    notes = uncertainty_sentences(problem, sure, search.best)
    return Recovered(off, errors, search.wall_s, search.evaluations, notes)


def main() -> None:
    """Print what jDE and the hybrid search find of 20 robots, each line as soon as it is known."""
    for seed in range(20):
        for name, way in (("jde", JDE), ("hybrid", HYBRID)):
            found = recover(seed, way)
            numbers = {key: (off, found.errors[key]) for key, off in found.off.items()}
            print(seed, name, round(found.seconds, 1), found.evaluations, numbers, flush=True)


if __name__ == "__main__":
    main()
