"""The command line of the campaign, `python -m tests.faults [PART ...]`."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any

import tyro

from tests.faults.pool import PARTS, Case, part_of, run_cases
from tests.faults.report import Tally, table
from validation import store


def main(
    parts: tyro.conf.Positional[tuple[str, ...]] = (),
    /,
    *,
    inputs: int = 20_000,
    kills: int = 200,
    seed: int = 0,
    workers: int = os.cpu_count() or 1,
    kind: str | None = None,
    case: str | None = None,
    out: Path = Path("runs/faults.json"),
) -> None:
    """Run the campaign, print a row for each kind of case, and leave with 1 if anything was not as promised.

    Args:
        parts: Names of the parts to run; all if none is named.
        inputs: Number of arguments, files and numbers that are generated, at least.
        kills: Number of times that a program is killed, at least.
        seed: Seed of everything random.
        workers: Number of processes; the verdicts do not depend on it.
        kind: Run only cases of this kind.
        case: Run only this case, PART/KIND/NUMBER as it is printed, in this process.
        out: File for the counts.
    """
    if unknown := set(parts) - set(PARTS):
        sys.exit(f"there is no part {', '.join(sorted(unknown))}; there are: {', '.join(PARTS)}")
    if case is not None:
        part, rest = case.split("/", 1)
        name, number = rest.rsplit("/", 1)
        cases = [Case(part, name, int(number))]
        workers = 0
    else:
        plans = {part: part_of(part).plan(inputs, kills) for part in parts or PARTS}
        cases = [
            Case(part, name, k) for part, plan in plans.items() for name, n in plan.items() for k in range(n)
            if kind in (None, name)
        ]  # fmt: skip
    rows = {(c.part, c.kind): Tally() for c in cases}
    began = last = time.perf_counter()
    for done, (one, verdict) in enumerate(run_cases(cases, seed, workers), 1):
        rows[one.part, one.kind].add(one, verdict)
        for fault, text in verdict.faults:
            print(
                f"{fault.upper()}: {verdict.what}: {text}\n    python -m tests.faults --seed {seed} --case '{one}'",
                flush=True,
            )
        if time.perf_counter() - last > 30.0:
            last = time.perf_counter()
            print(f"{done} of {len(cases)} cases, {last - began:.0f} s", file=sys.stderr, flush=True)
    print(table(rows))
    document: dict[str, Any] = {"seed": seed, "wall_s": round(time.perf_counter() - began, 1), "versions": store.versions()}
    document["rows"] = [{"part": part, "kind": name, **tally.as_dict()} for (part, name), tally in rows.items()]
    out.parent.mkdir(parents=True, exist_ok=True)
    store.write_json(out, document)
    sys.exit(any(tally.faults for tally in rows.values()))


if __name__ == "__main__":
    tyro.cli(main)
