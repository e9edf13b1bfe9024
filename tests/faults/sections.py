"""Sections of a replication that somebody damaged or edited: they are never taken for its own, and give away nothing.

The section is one of the campaign's own, which takes no time; everything that keeps, reads and reports it is the program's.
"""

from __future__ import annotations

import base64
import functools
import json
import random
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tests.faults.damage import NASTY_TEXTS, damaged
from tests.faults.doors import Broken, call
from tests.faults.judge import USUAL as STATUSES
from tests.faults.judge import Outcome
from tests.faults.pool import Part

SECRET = "what only its owner may read"
PICTURES = ("../secret.txt", "../../secret.txt", "/dev/zero", "x" * 300, "own-one.png\n", "")
"""Names of pictures that a section never gave."""


def plan(inputs: int, kills: int) -> dict[str, int]:
    """Return how many cases there are."""
    return {"damaged": max(1, inputs // 100), "edited": max(1, inputs // 50)}


def _found(context: Any) -> Any:
    from matplotlib.figure import Figure

    from validation.replicate.evidence import Findings, Table
    from validation.report.tables import Cell, Grid
    from validation.thesis.verdicts import Pair

    figure = Figure(figsize=(1, 1))
    picture = context.picture("one", figure, "A picture.")
    pairs = {"traj1": {"d_rms": Pair(0.11, 0.12, "distance")}, "traj2": {"d_rms": Pair(0.2, 0.25, "distance")}}
    grid = Grid((("name", ""), ("value", "m")), (((Cell("a"), Cell("1.5")),),), 1)
    numbers = {"deep": [{"x": 1.5}], "count": 3}
    return Findings({"3.9": Table("A caption.", pairs)}, {"A grid.": grid}, ("A note.",), (picture,), numbers)


@functools.cache
def _kept() -> dict[str, bytes]:
    """Return the files that a replication of the section leaves."""
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        _replicated(Path(name))
        return {str(p.relative_to(name)): p.read_bytes() for p in Path(name).rglob("*") if p.is_file()}


def _replicated(folder: Path) -> tuple[Any, str]:
    """Return the findings that a replication has in the end, and its page."""
    from validation.replicate.evidence import ReplicationSettings, Section
    from validation.replicate.result import Replication
    from validation.replicate.run import run_sections

    section = Section("own", "A section", ("3.9",), (), _found)
    settings = ReplicationSettings(quick=True)
    answers = run_sections([section], settings, folder, workers=1)
    Replication(settings, folder, tuple(answers), ()).save(folder)
    return answers[0].findings, (folder / "replicate.html").read_text()


def _edit(document: dict[str, Any], rng: random.Random) -> None:
    """Change one thing in a kept section that leaves it well formed."""
    if rng.random() < 0.3:
        document["findings"]["pictures"] = [{"file": rng.choice(PICTURES), "caption": "A picture."}]
        return
    places: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        for key, value in node.items() if isinstance(node, dict) else enumerate(node):
            places.append((node, key))
            if isinstance(value, dict | list):
                walk(value)

    walk(document["findings"])
    where, key = rng.choice(places)
    value = where[key]
    if isinstance(value, bool) or not isinstance(value, int | float):
        where[key] = rng.choice((*NASTY_TEXTS, "<script>alert(1)</script>", None, [], {}, 1))
    else:
        where[key] = rng.choice((value + 0.01, -value, 1e308, None, "nan", [value]))


def run(name: str, rng: random.Random, folder: Path) -> tuple[Outcome, Sequence[int]]:
    """Damage or edit what is kept; the next run must find what an undisturbed one finds, and embed nothing foreign."""
    out = folder / "out"
    for path, data in _kept().items():
        (out / path).parent.mkdir(parents=True, exist_ok=True)
        (out / path).write_bytes(data)
    for secret in (folder / "secret.txt", out / "secret.txt"):
        secret.write_text(SECRET)
    target = out / "sections" / "own.json"
    before = json.loads(target.read_text())
    if name == "damaged":
        target.write_bytes(damaged(target.read_bytes(), rng))
    else:
        document = json.loads(target.read_text())
        _edit(document, rng)
        target.write_text(json.dumps(document))
    return call(f"{name} section", functools.partial(_again, out, before)), STATUSES


def _again(folder: Path, before: dict[str, Any]) -> None:
    findings, page = _replicated(folder)
    if json.loads(json.dumps(asdict(findings))) != before["findings"]:
        raise Broken("differs", "an edited section was taken for its own")
    if SECRET in page or base64.b64encode(SECRET.encode()).decode()[:20] in page:
        raise Broken("escape", "a foreign file was embedded")


PART = Part(plan, run)
