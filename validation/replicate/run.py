"""Run the sections of a replication, or take them from disk where they were run before."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path

from validation.progress import Progress, Report, silent
from validation.replicate.control import CONTROL_SECTIONS
from validation.replicate.evidence import (
    FIGURE_FOLDER,
    SECTION_FOLDER,
    Answer,
    Context,
    ReplicationSettings,
    Section,
    chosen_sections,
)
from validation.replicate.faults import FAULT_SECTIONS
from validation.replicate.friction import FRICTION_SECTIONS
from validation.replicate.gazebo import GAZEBO_SECTIONS
from validation.replicate.keeping import keep, kept
from validation.replicate.models import MODEL_SECTIONS
from validation.replicate.noise import NOISE_SECTIONS
from validation.replicate.others import OTHER_SECTIONS
from validation.replicate.real import REAL_SECTIONS
from validation.replicate.result import Replication
from validation.replicate.stability import STABILITY_SECTIONS

ALL_SECTIONS: tuple[Section, ...] = (
    *FRICTION_SECTIONS,
    *NOISE_SECTIONS,
    *MODEL_SECTIONS,
    *OTHER_SECTIONS,
    *GAZEBO_SECTIONS,
    *STABILITY_SECTIONS,
    *CONTROL_SECTIONS,
    *FAULT_SECTIONS,
    *REAL_SECTIONS,
)
"""Every section, in the order of the report."""

_DEFAULT = ReplicationSettings()


class ReplicationInterrupted(KeyboardInterrupt):
    """A replication was stopped; its finished sections, and its searches as far as they are, are on disk."""

    def __init__(self, done: int, total: int) -> None:
        """Keep how many of how many sections are finished."""
        super().__init__(f"{done} of {total} sections are finished")
        self.done, self.total = done, total


def replicate(
    settings: ReplicationSettings = _DEFAULT,
    only: Sequence[str] = (),
    folder: str | Path = "runs/replicate",
    *,
    fresh: bool = False,
    workers: int | None = None,
    progress: Report = silent,
) -> Replication:
    """Run everything that the thesis reports, and judge each row against what the thesis prints.

    Each section is kept in `folder` as soon as it is finished. A later call with equal settings, inputs and code uses it
    again, and an interrupted search goes on where it stopped.

    Args:
        settings: budgets, seeds and the recording; `QUICK_SETTINGS` takes under three minutes.
        only: keys of sections or numbers of tables, such as `("3.9", "times")`; all sections if empty.
        folder: where sections and pictures are kept; `Replication.save` writes the report beside them.
        fresh: whether to run everything anew, whatever is kept.
        workers: number of threads, all processors if not given; only times depend on it.
        progress: called as sections and their searches proceed.

    Raises:
        ReplicationInterrupted: it was stopped; what is finished is kept.
        SsmrError: a section failed; what was finished before is kept.
        ValueError: `only` names what no section answers for, or the recording cannot be used.
    """
    sections = chosen_sections(ALL_SECTIONS, only)
    answers = run_sections(sections, settings, Path(folder), fresh=fresh, workers=workers, progress=progress)
    return Replication(settings, Path(folder), tuple(answers), tuple(s.title for s in ALL_SECTIONS if s not in sections))


def run_sections(
    sections: Sequence[Section],
    settings: ReplicationSettings,
    folder: Path,
    *,
    fresh: bool = False,
    workers: int | None = None,
    progress: Report = silent,
) -> list[Answer]:
    """Return the findings of some sections; arguments and errors are those of `replicate`."""
    answers: list[Answer] = []
    for name in (SECTION_FOLDER, FIGURE_FOLDER):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for section in sections:
        tell = _part_of(progress, len(answers), len(sections), section.title)
        context = Context(settings, folder, section.key, section.digest(settings), workers or os.cpu_count() or 1, tell)
        tell(Progress(0.0, 1.0, ""))
        try:
            answers.append(_answer(section, context, fresh=fresh))
        except KeyboardInterrupt as stop:
            raise ReplicationInterrupted(len(answers), len(sections)) from stop
    return answers


def _part_of(progress: Report, done: int, total: int, title: str) -> Report:
    """Return a callback for one section's progress that moves the whole replication's."""

    def tell(now: Progress) -> None:
        text = f"{title}, {now.text}" if now.text else title
        progress(Progress(done + now.done / max(now.total, 1e-9), total, text))

    return tell


def _answer(section: Section, context: Context, *, fresh: bool) -> Answer:
    """Return what a section found before, or run it and keep what it finds."""
    if fresh:
        for state in (context.folder / SECTION_FOLDER).glob(f"{section.key}-*.npz"):
            state.unlink()
    elif (before := kept(context.folder, section, context.digest)) is not None:
        context.progress(Progress(1.0, 1.0, "kept from before"))
        return before
    wall, cpu = time.perf_counter(), time.process_time()
    findings = section.run(context)
    answer = Answer(section, findings, time.perf_counter() - wall, time.process_time() - cpu)
    keep(context, answer)
    return answer
