"""Try the engines on one robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ssmr.parameters import require_within
from validation.engines.body import EngineMissingError
from validation.fit.targets import MOST_TIME
from validation.motion.sources import open_source
from validation.plants.profile import Profile
from validation.progress import Progress, Report, silent
from validation.simulator.description import Robot
from validation.study.engines.bench import EngineBench, TriedEngine, make_engine_bench, measure_engine
from validation.study.engines.result import EnginesStudy
from validation.study.engines.variants import EngineVariant, chosen_engines
from validation.study.result import keeping, profile_of


@dataclass(frozen=True)
class EnginesOptions:
    """Options of the study of engines."""

    engines: tuple[str, ...] = ()
    """Engines to try (mujoco, ode, drake); all if none is named."""
    profile: str | Profile | None = None
    """Robot of the lab: name of a shipped profile, or path of a TOML file."""
    recording: str | None = None
    """Path of a real robot's recording (.csv, or a bag) with commands and wheel rates; it adds columns."""
    recording_profile: str | Profile | None = None
    """Robot of the recording: name of a shipped profile, or path of a TOML file; if none is named, husky-tile."""
    start: float | None = None
    """Leave out what was recorded before this time [s]."""
    until: float | None = None
    """Leave out what was recorded after this time [s]."""
    robot: str | Robot | None = None
    """Robot: its name or the path of its file; the profile's if none is named."""

    def __post_init__(self) -> None:
        """Raise a ValueError for an unknown engine, or a time without a recording."""
        chosen_engines(self.engines)
        require_within(self, ("start", "until"), -MOST_TIME, MOST_TIME)
        if self.recording is None and (self.start is not None or self.until is not None):
            raise ValueError("start (--from) and until cut a recording; name one as recording")


def study_engines(
    options: EnginesOptions | None = None, *, workers: int | None = None, progress: Report = silent
) -> EnginesStudy:
    """Drive the same robot in several engines with several settings.

    Args:
        options: engines, profile and recording; the defaults if not given.
        workers: no effect: processor time is measured, so one engine runs after another.
        progress: called after each variant.

    Raises:
        ValueError: profile or recording do not exist, or none of the engines is installed.
        SsmrError: the improved model diverged.
    """
    o = options or EnginesOptions()
    lab, recorded, sources = profile_of(o.profile, o.robot), None, {}
    if o.recording is not None:
        recorded = profile_of(o.recording_profile, o.robot, "husky-tile")
        sources = {
            "wheels_m": open_source(o.recording, "wheels", o.start, o.until),
            "commands_m": open_source(o.recording, "twist", o.start, o.until),
        }
        if sources["wheels_m"].reference != "recording":
            raise ValueError(f"recording '{o.recording}' is a scenario; wanted the path of a recording")
    return try_engines(make_engine_bench(lab, recorded, sources), chosen_engines(o.engines), progress=progress)


def try_engines(bench: EngineBench, chosen: Sequence[EngineVariant], *, progress: Report = silent) -> EnginesStudy:
    """Measure some variants on a bench; those of an engine that is missing are left out, and the result says so.

    Raises:
        EngineMissingError: no engine of any variant is installed.
    """
    tried: list[TriedEngine] = []
    missing: dict[str, str] = {}
    with keeping(tried) as course:
        for done, variant in enumerate(chosen, 1):
            try:
                tried.append(measure_engine(bench, variant))
            except EngineMissingError as error:
                missing[variant.engine] = str(error)
            progress(Progress(done, len(chosen), variant.key))
    if not tried:
        raise EngineMissingError("; ".join(missing.values()))
    recording = next((source.name for source in bench.sources.values()), None)
    recorded = None if bench.recorded is None else bench.recorded.name
    made = bench.lab.name, recording, recorded, tuple(tried), tuple(missing.values())
    return EnginesStudy(*made, robot=bench.lab.robot.name, status=course.status)
