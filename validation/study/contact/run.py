"""Try physics settings on a MuJoCo robot."""

from __future__ import annotations

import os
import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

from validation.progress import Progress, Report, silent
from validation.study.contact.bench import (
    UNDRIVEABLE,
    Bench,
    make_bench,
    make_variant,
    measure_variant,
    step_time,
)
from validation.study.contact.result import ContactStudy
from validation.study.contact.variants import PhysicsVariant, chosen_variants
from validation.study.measured import Tried
from validation.study.recorded import RecordedOptions
from validation.study.result import keeping

_ROUNDS = 5
"""Number of times that the cost of a step is taken, all variants in turn; the least counts, for noise only adds."""


@dataclass(frozen=True)
class ContactOptions(RecordedOptions):
    """Options of the study of physics settings."""

    only: tuple[str, ...] = ()
    """Groups to try besides what is shipped (cone, impratio, "time step", ...); all if none is named."""

    def __post_init__(self) -> None:
        """Raise a ValueError for an unknown group, or a time without a recording."""
        chosen_variants(self.only)
        super().__post_init__()


def study_contact(
    options: ContactOptions | None = None, *, workers: int | None = None, progress: Report = silent
) -> ContactStudy:
    """Measure what physics settings do to the MuJoCo robot, one at a time and together.

    Args:
        options: groups of settings, profile and recording; the defaults if not given.
        workers: number of threads, all processors if not given; only the cost of a step depends on it.
        progress: called after each variant, and after each round of timing.

    Raises:
        ValueError: profile or recording do not exist, or do not fit the settings.
        SsmrError: a published model diverged.
    """
    o = options or ContactOptions()
    lab, recorded, sources = o.opened("wheels")
    bench = make_bench(lab, recorded, *sources)
    return try_variants(bench, chosen_variants(o.only, bench.lab.robot), workers=workers, progress=progress)


def try_variants(
    bench: Bench,
    chosen: Sequence[PhysicsVariant],
    *,
    workers: int | None = None,
    progress: Report = silent,
    timed: bool = True,
) -> ContactStudy:
    """Measure some variants on a bench; `timed` says whether to take the cost of a step too.

    Raises:
        ValueError: the parameters of a profile do not fit those of a variant.
    """
    for section in (bench.lab, bench.recorded or bench.lab):
        for variant in chosen:
            variant.calibration(section.parameters)
    total, stop = len(chosen) + (_ROUNDS if timed else 0), threading.Event()
    tried: list[Tried] = []
    with keeping(tried) as course:
        with ThreadPoolExecutor(workers or os.cpu_count()) as pool:
            try:
                for found in pool.map(lambda variant: measure_variant(bench, variant, stop.is_set), chosen):
                    tried.append(found)
                    progress(Progress(len(tried), total, found.variant.key))
            except BaseException:
                stop.set()  # an interrupt ends the other variants at their next drive
                raise
        if timed:
            plants = {k: make_variant(t.variant, bench.lab) for k, t in enumerate(tried) if UNDRIVEABLE not in t.failures}
            times: dict[int, list[float]] = {k: [] for k in plants}
            for done in range(_ROUNDS):
                progress(Progress(len(tried) + done, total, "timing"))
                for k, plant in plants.items():
                    times[k].append(step_time(plant))
            for k, taken in times.items():
                tried[k] = replace(tried[k], measures=replace(tried[k].measures, cost_s=min(taken)))
    recording = None if bench.recording is None else bench.recording.name
    made = bench.profile, recording, bench.recording_profile, tuple(tried)
    return ContactStudy(*made, robot=bench.lab.robot.name, status=course.status)
