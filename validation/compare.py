"""Drive every plant with the same commands and compare each with one reference.

On the command line: `python -m validation.compare SOURCE`.
"""

from __future__ import annotations

if __name__ == "__main__":
    from validation.interrupts import end_quietly

    end_quietly()

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import tyro

from ssmr.metrics.declared import Metrics, compare_pieces, compare_signals
from ssmr.models.law import PlanarLaw
from ssmr.robot.sensors import SensorNoise, measure
from ssmr.scenarios import TRAJECTORIES
from ssmr.types import CommandKind, Plant
from validation import cli
from validation.experiment.gyro import find_gyro_judge
from validation.experiment.runs import Run, drive_all
from validation.experiment.scores import (
    NamedScores,
    pace_of,
    score_windows,
)
from validation.experiment.sources import (
    RECORDING,
    AnySource,
    Source,
    driver_warnings,
    open_source,
    source_name,
    unknown_robot_notes,
)
from validation.experiment.user_law import add_user_model, load_user_metric
from validation.files.formats import profile_of_log
from validation.files.log import ReadOptions
from validation.output import Document, file_name, one_line, return_memory
from validation.plants.profile import Profile, choose_profile, make_plant
from validation.plants.table import PLANTS, USUAL_PLANTS, known_plants, plant_kind
from validation.report.comparison import Comparison
from validation.report.motions import health_warnings
from validation.simulator.description import with_robot
from validation.simulator.terrain import FLAT, Terrain

if TYPE_CHECKING:
    from validation.identify.adapting import Adapted


@dataclass(frozen=True)
class Compare(cli.Filmed, ReadOptions):
    """Options of `compare`."""

    source: tyro.conf.Positional[AnySource]
    """Motion to drive: traj1 to traj4, traj4@improved for how that plant drives it, the path of a
    recording, or one that is shipped: sample (simulated), husky or warthog (real)."""
    profile: cli.AnyProfile = None
    """Name of a shipped profile, or path of a profile (.toml); if not given, thesis-lab for
    scenarios, a shipped log's own, else husky-tile, and for another --robot the numbers of its
    file."""
    plants: Sequence[str] = USUAL_PLANTS
    """Plants to drive, separated by commas, such as mujoco,improved; `all` adds four_wheel. A wrong
    name lists all names."""
    reference: str | None = None
    """Plant to compare the others with; if not given, mujoco for a scenario, the recording itself
    for a recording."""
    robot: cli.AnyRobot = None
    """Name of a shipped robot, or path of a robot's file (.toml); the profile's if not given."""
    input: Literal["commands", "wheels"] = "commands"
    """Signal of the recording that drives the plants: its commands, or its measured wheel rates."""
    horizons: Sequence[float] | str = (2.0, 6.0, 30.0, 60.0)
    """Times after which the poses of plant and recording are compared [s]."""
    since: cli.Since = None
    """Leave out what was recorded before this time [s]."""
    until: float | None = None
    """Leave out what was recorded after this time [s]."""
    bands: bool = False
    """Draw where each plant says that the robot will be nine times in ten, and count how often it
    is there."""
    adapt: float | None = None
    """Time after which planar models are calibrated again while they drive along a recording, with
    the profile as prior [s]; each prediction uses only what came before it."""
    noise: bool = False
    """See the plants through the lab's state filter: at 50 Hz, with its noise."""
    disturbance: bool = False
    """Push all plants with the same random yaw acceleration."""
    terrain: Terrain | str = FLAT
    """Ground under the MuJoCo robot: flat, or ramp:DEG; docs/physics.md has more keys."""
    own_model: Annotated[PlanarLaw | str | None, tyro.conf.arg(name="model")] = None
    """A plant of your own: a PlanarLaw in a Python file, FILE.py:NAME, which is run."""
    own_metric: Annotated[Callable[..., float] | str | None, tyro.conf.arg(name="metric")] = None
    """A column of your own: a function in a Python file, FILE.py:NAME, which is run."""

    def folder(self) -> Path:
        """Return the folder that the files are written to."""
        name = Path(source_name(self.source)).stem
        if self.terrain != FLAT:
            name += "-" + cli.text_of(self.terrain).replace(":", "-")
        return Path("runs") / "compare" / file_name(name)

    @property
    def names_robot(self) -> bool:
        """Whether a profile or a robot is given."""
        return self.profile is not None or self.robot is not None

    def as_dict(self) -> Document:
        """Return the options as compare.json has them; the seed stands beside them."""
        names = ("input", "horizons", "noise", "disturbance", "adapt", "until")
        options = {name: getattr(self, name) for name in names}
        options |= {"terrain": cli.text_of(self.terrain), "from": self.since}
        return {name: value for name, value in options.items() if value is not None}


@cli.make_program(Compare)
def compare(o: Compare) -> Comparison:
    """Drive every plant with the same commands and compare each with the reference.

    Prints tables and writes compare.json, compare.png and compare.rrd.

    Raises:
        SsmrError: a plant diverged.
        ValueError: an unknown name, a recording that cannot be read, or values that do not go
            together.
    """
    own = add_user_model(o.own_model)
    profile, source = _open_options(o)
    reference = o.reference or source.reference
    plants = _make_all_plants(o, profile, source, own)
    metric = None if o.own_metric is None else load_user_metric(o.own_metric)
    unknown = [] if o.names_robot else unknown_robot_notes(source, profile.robot)
    pace = pace_of(source.truth, profile.robot.wheel_radius)
    doubts = [*profile.too_fast(pace, source.title), *profile.unfitted(plants)]
    foreign = driver_warnings(plants, profile.robot)
    for warning in (*source.warnings, *unknown[1:], *doubts, *foreign):
        cli.warn_user(warning)
    recorded = reference == RECORDING
    gyro = find_gyro_judge(source) if recorded else None
    if source.inspected is not None:
        source.inspected.forget_signals()
    return_memory()
    localisers = {name: profile.section(name).localiser for name in plants}
    push_seed = o.seed if o.disturbance else None
    runs = drive_all(source, plants, localisers, push_seed, o.workers, o.progress)
    if o.noise:
        runs = _add_noise(runs, reference, o.seed)
    truth = source.truth if recorded else runs[reference].motions
    adapted = _drive_adapted(o, profile, source, runs)
    runs |= {name: replace(runs[name], motions=path) for name, (*_, path) in adapted.items()}
    scores = {}
    for name, run in runs.items():
        motions = list(run.motions)
        metrics = Metrics({**compare_pieces(motions, truth), **compare_signals(motions, truth)})
        if metric is not None:
            metrics = metric(metrics, motions, truth)
        band = profile.section(name).bands.get(o.input) if o.bands else None
        horizons = cli.read_value(o.horizons) if recorded else ()
        pieces = list(source.pieces)
        late = [run.localiser.yaw_late]
        if name in adapted:
            pieces, motions, late, _ = adapted[name]
        by_gyro = []
        if gyro is not None:
            judging = chain.from_iterable(gyro.judging(source, each) for each in late)
            pairs = zip(judging, pieces, strict=True)
            by_gyro = [replace(judge, begins=piece.begins) for judge, piece in pairs]
        scores[name] = score_windows(metrics, pieces, motions, horizons, by_gyro, band)
    for sentence in health_warnings(runs):
        cli.warn_user(sentence)
    return Comparison(
        title=f"{one_line(source.name)}, {with_robot(profile.name, profile.robot.name)}",
        options=o.as_dict(),
        source=source,
        profile=profile,
        reference=reference,
        truth=truth,
        runs=runs,
        scores=scores,
        seed=o.seed,
        terrain=cli.read_value(o.terrain),
        gyro=gyro,
        remarks=[*doubts, *unknown, *_name_unjudged(o, scores, profile)],
    )


def _drive_adapted(
    o: Compare, profile: Profile, source: Source, runs: Iterable[str]
) -> dict[str, Adapted]:
    """Return the predictions of the plants that are calibrated on while they drive."""
    if o.adapt is None:
        return {}
    if source.reference != RECORDING:
        raise ValueError(f"adapt needs a recording; {source.name} is a scenario")
    names = [name for name in runs if plant_kind(name).together is not None]
    if not names:
        raise ValueError("adapt calibrates planar models on, and none is among the plants")
    from validation.identify.adapting import adapted_along  # here: it takes long to import

    adapted = {}
    for name in names:
        adapted[name] = adapted_along(name, profile.section(name), source, o.input, o.adapt)
    return adapted


def _open_options(o: Compare) -> tuple[Profile, Source]:
    """Return the profile, and what drives the plants."""
    name = source_name(o.source)
    is_trajectory = name.partition("@")[0] in TRAJECTORIES
    default = "thesis-lab" if is_trajectory else profile_of_log(name)
    profile = choose_profile(o.profile, o.robot, default)
    radius = profile.robot.wheel_radius if o.names_robot else None
    kind: CommandKind = "wheels" if o.input == "wheels" else "twist"
    return profile, open_source(o.source, kind, o.since, o.until, o, radius)


def _make_all_plants(
    o: Compare, profile: Profile, source: Source, own: Sequence[str]
) -> dict[str, Plant]:
    """Return the plants that are driven, the reference and the user's own models among them."""
    plants = PLANTS if o.plants == ("all",) else o.plants
    names = known_plants()
    if not plants and not own:
        raise ValueError(f"plants is empty; there are: {', '.join(names)}")
    driven = {*plants, *own, o.reference or source.reference}
    if source.reference == RECORDING:
        driven.discard(RECORDING)
    for name in sorted(driven):
        plant_kind(name)  # an unknown one is refused before another is built
    # in the order of tables, and then the robots of others
    ordered = [name for name in names if name in driven]
    ordered += sorted(driven - set(ordered))
    terrain = cli.read_value(o.terrain)
    return {name: make_plant(profile, name, terrain) for name in ordered}


def _add_noise(runs: Mapping[str, Run], reference: str, seed: int) -> dict[str, Run]:
    """Return the runs as the lab's state filter sees them, but that of the reference."""
    seen = {}
    for rank, (name, run) in enumerate(runs.items()):
        seen[name] = run
        if name != reference:
            # each plant has its own noise
            rng = np.random.default_rng([seed, rank])
            motions = tuple(measure(motion, SensorNoise(), rng) for motion in run.motions)
            seen[name] = replace(run, motions=motions)
    return seen


def _name_unjudged(o: Compare, scores: NamedScores, profile: Profile) -> list[str]:
    """Return a sentence on the plants whose predictions no log has judged yet."""
    plants = ", ".join(name for name, s in scores.items() if s.band is None)
    if not o.bands or not plants:
        return []
    return [
        f"The profile {one_line(profile.name)} holds no band of {plants} driven by {o.input}: "
        "calibrate and fit write one from a log."
    ]


if __name__ == "__main__":
    compare.main()
