"""`python -m validation.replicate`: everything that the thesis reports, printed beside what this project gets."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import tyro

from validation import cli
from validation.logs.formats import read_recording
from validation.replicate import real as evidence_real
from validation.replicate.evidence import (
    FIGURES,
    QUICK,
    SECTIONS,
    Settings,
    choose,
)
from validation.replicate.report import document_of
from validation.replicate.run import ALL, publish, run_all, write
from validation.show.tables import rich_table


def main(
    *,
    quick: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    only: str = "",
    recording: Path | None = None,
    split: float | None = None,
    seed: int = 1,
    workers: int | None = None,
    out: Path = Path("runs/replicate"),
    docs: Path | None = None,
    fresh: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
) -> None:
    """Run everything that the thesis reports and write it beside what the thesis prints, with a verdict for each row.

    Writes replicate.json, replicate.md and replicate.html, one page that needs nothing else. Each section is kept in --out
    as soon as it is done; asked again, only what is missing or was made otherwise runs. Ctrl-C keeps what is done, and
    searches as far as they are.

    Args:
        quick: Reduced budgets; under three minutes.
        only: Sections or tables, comma-separated, such as 3.9,4.5 or times; a wrong name lists all.
        recording: A real Husky's log (.csv with columns as in the README, or a bag) for the last chapter; without it that
            chapter says so.
        split: What was recorded after this time is scored by itself [s]; by default where the fit of husky-tile ended.
        seed: Of the searches.
        workers: Threads; nothing but times depends on it.
        out: Folder for the results.
        docs: Write the report there too, such as docs/results.md; its pictures go to img/ beside it.
        fresh: Run everything anew, whatever is kept; searches too.
    """
    with cli.mistakes_are_users():
        if seed < 0 or (workers is not None and workers < 1):
            raise cli.UserError(f"--seed {seed} must not be negative and --workers {workers} must be positive")
        if recording is not None:
            evidence_real.inputs_of(read_recording(recording))
        chosen = choose(ALL, only)
        if docs is not None and docs.suffix != ".md":
            raise cli.UserError(f"--docs {docs} is no markdown file; name one such as docs/results.md")
    folder = cli.output_folder(out)
    for name in (SECTIONS, FIGURES):
        cli.output_folder(folder / name)
    base = QUICK if quick else Settings()
    settings = replace(base, seed=seed, recording=str(recording) if recording is not None else "", split=split)
    found = run_all(chosen, settings, folder, workers or os.cpu_count() or 1, fresh=fresh)
    document = document_of(found, settings, [s for s in ALL if s not in chosen])
    written = write(folder, document, found, settings)
    if docs is not None:
        written += publish(docs, document, folder / FIGURES)
    cli.report([rich_table(document.summary, document.title, "rows that the thesis prints, by verdict")], (), written)


if __name__ == "__main__":
    cli.run(main, "python -m validation.replicate")
