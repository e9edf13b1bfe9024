"""`python -m validation.replicate`: everything that the thesis reports, printed beside what this project gets."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from validation import cli, store
from validation.replicate import control as evidence_control
from validation.replicate import models as evidence_models
from validation.replicate import real as evidence_real
from validation.replicate.evidence import (
    FIGURES,
    SECTIONS,
    Context,
    Effort,
    Findings,
    Section,
    Settings,
    keep,
    kept,
)
from validation.replicate.html_page import render
from validation.replicate.report import Document, Found, as_json, markdown

ALL: tuple[Section, ...] = (*evidence_models.SECTIONS, *evidence_control.SECTIONS, *evidence_real.SECTIONS)
"""Every section, in the order of the report."""


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
