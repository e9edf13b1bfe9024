"""Try the engines on one robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from validation.engines.body import EngineMissingError
from validation.progress import Progress, Report, silent
from validation.study.engines.bench import EngineBench, TriedEngine, make_engine_bench, measure_engine
from validation.study.engines.result import EnginesStudy
from validation.study.engines.variants import EngineVariant, chosen_engines
from validation.study.recorded import RecordedOptions
from validation.study.result import keeping


@dataclass(frozen=True)
class EnginesOptions(RecordedOptions):
    """Options of the study of engines."""

    engines: tuple[str, ...] = ()
    """Engines to try (mujoco, ode, drake); all if none is named."""

    def __post_init__(self) -> None:
        """Raise a ValueError for an unknown engine, or a time without a recording."""
        chosen_engines(self.engines)
        super().__post_init__()


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
    lab, recorded, found = o.opened("wheels", "twist")
    sources = dict(zip(("wheels_m", "commands_m"), found, strict=False))
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
                missing[variant.group] = str(error)
            progress(Progress(done, len(chosen), variant.key))
    if not tried:
        raise EngineMissingError("; ".join(missing.values()))
    recording = next((source.name for source in bench.sources.values()), None)
    recorded = None if bench.recorded is None else bench.recorded.name
    made = bench.lab.name, recording, recorded, tuple(tried), tuple(missing.values())
    return EnginesStudy(*made, robot=bench.lab.robot.name, status=course.status)
