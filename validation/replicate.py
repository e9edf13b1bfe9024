"""`python -m validation.replicate`: everything that the thesis reports, printed beside what this project gets."""

from __future__ import annotations

import os
import shutil
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro

from validation import cli, evidence_control, evidence_models, evidence_real, store
from validation.evidence import (
    FIGURES,
    QUICK,
    SECTIONS,
    Context,
    Effort,
    Findings,
    Section,
    Settings,
    choose,
    keep,
    kept,
)
from validation.evidence_report import Document, Found, as_json, document_of, markdown
from validation.html_page import render
from validation.sources import read_recording
from validation.tables import rich_table

ALL: tuple[Section, ...] = (*evidence_models.SECTIONS, *evidence_control.SECTIONS, *evidence_real.SECTIONS)
"""Every section, in the order of the report."""


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


def run_all(sections: Sequence[Section], settings: Settings, folder: Path, workers: int, *, fresh: bool = False) -> Found:
    """What each section finds, now or before, told on standard error as it goes.

    Raises:
        KeyboardInterrupt: stopped; what was done is kept.
        SsmrError: a section failed; what was done before is kept.
    """
    found: list[tuple[Section, Findings, Effort]] = []
    for k, section in enumerate(sections, 1):
        digest = section.digest(settings)
        if fresh:
            for state in (folder / SECTIONS).glob(f"{section.key}-*.npz"):
                state.unlink()
        before = None if fresh else kept(folder, section, digest)
        if before is not None:
            _tell(f"[{k}/{len(sections)}] {section.title}: kept from before")
            found.append((section, *before))
            continue
        _tell(f"[{k}/{len(sections)}] {section.title} …")
        try:
            findings, effort = timed(section, Context(settings, folder, section.key, digest, workers))
        except KeyboardInterrupt:
            _tell(f"{len(found)} of {len(sections)} sections are kept in {folder}; the same command goes on from there")
            raise
        keep(folder, section, digest, settings, findings, effort)
        found.append((section, findings, effort))
        _tell(f"[{k}/{len(sections)}] {section.title}: {effort.wall_s:.0f} s, {effort.cpu_s:.0f} s of processor time")
    return found


def timed(section: Section, context: Context) -> tuple[Findings, Effort]:
    """What a section finds, and what it took."""
    wall, cpu = time.perf_counter(), time.process_time()
    findings = section.run(context)
    return findings, Effort(time.perf_counter() - wall, time.process_time() - cpu)


def write(folder: Path, document: Document, found: Found, settings: Settings) -> list[Path]:
    """Write replicate.html, replicate.md and, last, replicate.json; return what was written."""
    page, text, numbers = (folder / f"replicate.{ending}" for ending in ("html", "md", "json"))
    html = render(document, folder / FIGURES)
    store.write_atomic(page, lambda temporary: temporary.write_text(html, encoding="utf-8"))
    prose = markdown(document, f"{FIGURES}/")
    store.write_atomic(text, lambda temporary: temporary.write_text(prose, encoding="utf-8"))
    store.write_json(numbers, as_json(found, settings))
    return [page, text, numbers]


def publish(path: Path, document: Document, figures: Path) -> list[Path]:
    """Write the report as a page of docs/, its pictures as `img/results-*.png` beside it; return the page.

    Raises:
        UserError: the folder cannot be written.
    """
    images = cli.output_folder(path.parent / "img")
    prefix = f"{path.stem}-"
    for picture in (p for chapter in document.chapters for p in chapter.pictures):
        store.write_atomic(images / f"{prefix}{picture.file}", partial(shutil.copyfile, figures / picture.file))
    text = markdown(document, f"img/{prefix}", "")
    store.write_atomic(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return [path]


def _tell(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    cli.run(main, "python -m validation.replicate")
