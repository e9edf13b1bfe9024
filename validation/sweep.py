"""A sweep: every measure of every variant, side by side."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from ssmr.errors import SsmrError
from validation.output import Document, Progress, Progressing, ignore_progress, one_line
from validation.report.report import FINISHED, INTERRUPTED
from validation.workers import complete_calls

Variant = TypeVar("Variant")
Measure = Callable[[Variant], Mapping[str, Any]]
"""A drive or calculation that gives the columns of one variant, as keys and values."""


@dataclass(frozen=True)
class Swept:
    """Result of a sweep."""

    rows: Sequence[Document]
    """A row for each variant that was measured, in the order of the variants, its name in the
    column `variant`."""
    notes: Sequence[str] = field(default_factory=tuple)
    """A sentence for each measure that failed."""
    status: str = FINISHED
    """`finished`, or `interrupted` by Ctrl-C."""


def sweep(
    variants: Mapping[str, Variant],
    measures: Mapping[str, Measure[Variant]],
    *,
    workers: int | str | None = None,
    progress: Progressing = ignore_progress,
) -> Swept:
    """Take every measure of every variant.

    Args:
        variants: objects to measure, by the name that their row gets.
        measures: drives by name, each of which gives some columns. A drive that fails leaves its
            columns empty and a note.
        workers: threads, None for all processors, or the address of a dask scheduler, to which
            variants and drives are sent; the result does not depend on it.
        progress: called after each variant.

    Returns:
        The rows; after Ctrl-C those of the variants that were finished.

    Raises:
        SsmrError: every measure of every variant failed.
        ValueError: the same, for values that do not go together.
        KeyboardInterrupt: it was pressed before the first variant was finished.
    """
    failures: dict[str, Exception] = {}
    rows = {}
    status = FINISHED
    calls = [(name, variant, measures) for name, variant in variants.items()]
    try:
        for _, (row, failed) in complete_calls(workers, _row_of, calls):
            rows[row["variant"]] = row
            failures |= failed
            progress(Progress(len(rows), len(variants), row["variant"]))
    except KeyboardInterrupt:
        if not rows:
            raise
        status = INTERRUPTED
    # a row with nothing but its name has no measure
    if failures and all(len(row) == 1 for row in rows.values()):
        raise next(iter(failures.values()))
    notes = [f"{drive}: {one_line(error)}." for drive, error in sorted(failures.items())]
    return Swept([rows[name] for name in variants if name in rows], notes, status)


def _row_of(
    name: str, variant: Any, measures: Mapping[str, Measure[Any]]
) -> tuple[Document, dict[str, Exception]]:
    """Return the columns of a variant, and the errors of the measures that failed."""
    row: Document = {"variant": name}
    failures: dict[str, Exception] = {}
    for drive, measure in measures.items():
        try:
            row.update(measure(variant))
        except (SsmrError, ValueError) as error:
            failures[f"{name}: {drive} failed"] = error
    return row, failures
