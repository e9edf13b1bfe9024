"""Counts of a campaign: a row for each kind of case, as a table and as JSON."""

from __future__ import annotations

import dataclasses
from collections import Counter
from typing import Any

from tests.faults.judge import CLASSES, Verdict
from tests.faults.pool import Case

EXAMPLES = 20
"""Faults of a row that are written down in full."""


@dataclasses.dataclass
class Tally:
    """What came of one kind of case."""

    inputs: int = 0
    cases: int = 0
    accepted: int = 0
    faults: Counter[str] = dataclasses.field(default_factory=Counter)
    examples: list[str] = dataclasses.field(default_factory=list)

    def add(self, case: Case, verdict: Verdict) -> None:
        """Count a case; a case counts once in each class of faults that it has."""
        self.inputs += verdict.weight
        self.cases += 1
        self.accepted += verdict.accepted and not verdict.faults
        self.faults.update({kind for kind, _ in verdict.faults})
        for kind, text in verdict.faults:
            self.examples.append(f"{case}: {verdict.what}: {kind}: {text}")

    def as_dict(self) -> dict[str, Any]:
        """Return the counts for JSON."""
        counts = {kind: self.faults[kind] for kind in CLASSES if self.faults[kind]}
        refused = self.cases - self.accepted
        return {"inputs": self.inputs, "cases": self.cases, "accepted": self.accepted, "refused": refused,
                "faults": counts, "examples": sorted(self.examples)[:EXAMPLES]}  # fmt: skip


def table(rows: dict[tuple[str, str], Tally]) -> str:
    """Return a row for each part and kind, in their order, and the sum."""
    whole = Tally()
    lines = [f"{'part':13s} {'kind':34s} {'inputs':>7s} {'cases':>6s} {'good':>6s} {'refused':>7s}  faults"]
    for (part, kind), tally in rows.items():
        lines.append(_row(part, kind, tally))
        for name in ("inputs", "cases", "accepted", "faults"):
            setattr(whole, name, getattr(whole, name) + getattr(tally, name))
    return "\n".join([*lines, _row("all", "", whole)])


def _row(part: str, kind: str, tally: Tally) -> str:
    faults = ", ".join(f"{n} {name}" for name in CLASSES if (n := tally.faults[name])) or "none"
    refused = tally.cases - tally.accepted
    return f"{part:13s} {kind:34s} {tally.inputs:7d} {tally.cases:6d} {tally.accepted:6d} {refused:7d}  {faults}"
