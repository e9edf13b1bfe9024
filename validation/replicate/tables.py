"""The tables of a report: printed and own numbers side by side, a verdict for each row, and the reasons below."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from validation.fit.table import number_text, unit_text
from validation.replicate.evidence import Findings, Section, Table
from validation.report.tables import MILLIMETRES, NOTHING, Cell, Grid, Unit
from validation.thesis.verdicts import Pair, RowVerdict, Verdict, is_told, judge, judge_rows, row_verdict, short

_RATIO = Unit("", 1.0, 4)
_MOST_DECIMALS = 6
"""Numbers with more decimals than this are written with a power of ten."""


@dataclass(frozen=True)
class Part:
    """One table of a report."""

    caption: str
    """Caption above the table."""
    grid: Grid
    """Header and cells."""
    reasons: tuple[str, ...] = ()
    """Reasons below the table, in the order of the numbers in its verdicts."""


def is_printed(number: str, row: str, pairs: Mapping[str, Pair]) -> bool:
    """Return whether the thesis has such a row; its numbers may be lost."""
    return any(is_told(p) or judge(number, row, m, p).see for m, p in pairs.items())


class _Reasons:
    """The reasons below a table, numbered in the order in which its rows need them."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    def number(self, verdict: Verdict) -> int:
        """Return the number of a verdict's reason."""
        text = f"{verdict.reason[0].upper()}{verdict.reason[1:]}{f' (docs/{verdict.see})' if verdict.see else ''}."
        if text not in self.texts:
            self.texts.append(text)
        return self.texts.index(text) + 1

    def cell(self, verdict: RowVerdict) -> Cell:
        """Return a verdict with the number of its reason: `differs [1]`, or `differs: d_rms [1], …` if metrics differ."""
        parts = [f"{', '.join(map(short, metrics))} [{self.number(v)}]".strip() for metrics, v in verdict.because]
        colon = ":" if any(metrics for metrics, _ in verdict.because) else ""
        return Cell(f"{verdict.status}{colon} {', '.join(parts)}".strip())


def _metric_text(metric: str, value: float | None, unit: str) -> str:
    """Return a number without its unit; a length is in millimetres."""
    if value is None:
        return NOTHING
    if metric.endswith("ratio"):
        return _RATIO.text(value)
    if unit == "m":
        return MILLIMETRES.text(value)
    decimals = {"%": 2, "s": 3}.get(unit)
    return number_text(value) if decimals is None else f"{value:.{decimals}f}"


def wide_grid(tables: Mapping[str, Table]) -> tuple[Grid, tuple[str, ...]]:
    """Lay out tables whose rows have the same metrics: printed and own numbers side by side, and a verdict for each row.

    Returns:
        The grid, and the reasons that its verdicts refer to by number.
    """
    metrics = list(dict.fromkeys(m for t in tables.values() for pairs in t.rows.values() for m in pairs))
    pairs_of = [pairs for t in tables.values() for pairs in t.rows.values()]
    shown = {m: next(p[m] for p in pairs_of if m in p) for m in metrics}
    printed = {m for m in metrics if any(m in p and is_told(p[m]) for p in pairs_of)}
    beside = {m: [n for n in ("mujoco",) if any(m in p and n in p[m].beside for p in pairs_of)] for m in metrics}
    supposed = {m for m in metrics if any(m in p and p[m].supposed is not None for p in pairs_of)}
    several = len(tables) > 1
    header: list[tuple[str, str]] = [("Tab.", "")] * several + [("row", ""), ("verdict", "")]
    for m in metrics:
        unit = "mm" if shown[m].unit == "m" else unit_text(shown[m].unit)
        name = short(m).replace("_", " ") if m.endswith(("_s", "_percent")) else short(m)
        header += [(f"{name} printed", unit)] if m in printed else []
        header += [("ours" if m in printed else name, unit), *((n, unit) for n in beside[m])]
        header += [("supposed", unit)] * (m in supposed)
    reasons, groups = _Reasons(), []
    for number, table in tables.items():
        verdicts, rows = judge_rows(number, table.rows), []
        for row, pairs in table.rows.items():
            cells = [Cell(number)] * several + [Cell(row.replace("_", " ")), reasons.cell(row_verdict(pairs, verdicts[row]))]
            for m in metrics:
                pair = pairs.get(m, Pair(None, None, "none"))
                if m in printed:
                    limit = f"≥ {pair.beside['at_least']:g}" if pair.rule == "at_least" else ""
                    cells.append(Cell(limit or _metric_text(m, pair.published, pair.unit)))
                spread = None if pair.ours is None else pair.spread
                error = "" if spread is None else f" ± {_metric_text(m, spread, pair.unit)}"
                cells.append(Cell(_metric_text(m, pair.ours, pair.unit) + error))
                cells += [Cell(_metric_text(m, pair.beside.get(name), pair.unit)) for name in beside[m]]
                if m in supposed:
                    under = pair.supposed
                    cells.append(Cell(_metric_text(m, None if under is None else under.value, pair.unit)))
                    if under is not None and under.spread is not None:
                        cells[-1] = Cell(f"{cells[-1].text} ± {_metric_text(m, under.spread, pair.unit)}")
            rows.append(tuple(cells))
        groups.append(tuple(rows))
    if all(len(group) == 1 for group in groups):
        groups = [tuple(row for group in groups for row in group)]
    return Grid(tuple(header), tuple(groups), left=2 + several), tuple(reasons.texts)


def tall_grid(table: Table, number: str) -> tuple[Grid, tuple[str, ...]]:
    """Lay out a table with one number of ours in each row, beside its unit, its bounds and further numbers.

    Printed numbers of other metrics stand in columns of their own.
    """
    first = {row: next(iter(pairs)) for row, pairs in table.rows.items()}
    others = list(dict.fromkeys(m for row, pairs in table.rows.items() for m in pairs if m != first[row]))
    shown = {row: pairs[first[row]] for row, pairs in table.rows.items()}
    names = list(dict.fromkeys(n for pair in shown.values() for n in pair.beside if n not in ("lower", "upper")))
    searched, mixed = any("lower" in pair.beside for pair in shown.values()), len(set(first.values())) > 1
    supposed = any(pair.supposed is not None for pair in shown.values())
    titles = [
        "row",
        *["what"] * mixed,
        "unit",
        "verdict",
        "printed",
        "ours",
        *["supposed"] * supposed,
        *["searched"] * searched,
    ]
    titles += [n.replace("_", " ").replace("published", "printed") for n in names] + [f"{m} printed" for m in others]
    verdicts, reasons, rows = judge_rows(number, table.rows), _Reasons(), []
    for row, pairs in table.rows.items():
        metric, pair = first[row], shown[row]
        texts = [row, *[short(metric).replace("_", " ")] * mixed, pair.unit]
        numbers = [NOTHING if pair.published is None else f"{pair.published:g}", _with_error(pair)]
        if supposed:
            under = pair.supposed
            numbers.append(NOTHING if under is None else _with_error(replace(pair, ours=under.value, spread=under.spread)))
        if searched:
            known = "lower" in pair.beside
            numbers.append(f"{pair.beside['lower']:.4g} to {pair.beside['upper']:.4g}" if known else NOTHING)
        numbers += [number_text(pair.beside[n]) if n in pair.beside else NOTHING for n in names]
        values = [pairs[m].published if m in pairs else None for m in others]
        numbers += [NOTHING if value is None else f"{value:g}" for value in values]
        verdict = reasons.cell(row_verdict(pairs, {metric: verdicts[row][metric]}))
        rows.append((*map(Cell, texts), verdict, *map(Cell, numbers)))
    return Grid(tuple((title, "") for title in titles), (tuple(rows),), left=3 + mixed), tuple(reasons.texts)


def _with_error(pair: Pair) -> str:
    """Return `0.523 ± 0.004`; the spread decides how many digits both have."""
    if pair.ours is None:
        return NOTHING
    if pair.spread is None or not pair.spread > 0.0:
        return number_text(pair.ours)
    decimals = max(0, 1 - math.floor(math.log10(pair.spread)))
    if decimals > _MOST_DECIMALS:
        return f"{number_text(pair.ours)} ± {pair.spread:.1e}"
    return f"{pair.ours:.{decimals}f} ± {pair.spread:.{decimals}f}"


_WIDE: Mapping[str, tuple[tuple[str, tuple[str, ...]], ...]] = {
    "tables": (
        ("PID, reference against simulated", tuple(f"4.{i}" for i in range(5, 13))),
        ("PID, simulated against real", tuple(f"4.{i}" for i in range(13, 20))),
        ("LQR, reference against simulated", tuple(f"4.{i}" for i in range(22, 30))),
        ("LQR, simulated against real", tuple(f"4.{i}" for i in range(30, 37))),
    )
}
"""Tables of the thesis that are shown as one, by section."""


def parts_of(section: Section, findings: Findings) -> tuple[Part, ...]:
    """Return a section's tables as they are shown."""
    parts, done = [], set[str]()
    for caption, numbers in _WIDE.get(section.key, ()):
        some = {n: findings.tables[n] for n in numbers if n in findings.tables}
        if some:
            parts.append(Part(f"Tab. {numbers[0]}–{numbers[-1]}. {caption}", *wide_grid(some)))
            done |= set(some)
    for number, table in findings.tables.items():
        if number not in done:
            where = f"Tab. {number}" if number[0].isdigit() else number
            grid = tall_grid(table, number) if _is_tall(table) else wide_grid({number: table})
            parts.append(Part(f"{where}. {table.caption}", *grid))
    parts += [Part(caption, grid) for caption, grid in findings.grids.items()]
    return tuple(parts)


def _is_tall(table: Table) -> bool:
    """Return whether the unit changes from row to row, or each row has a metric of its own."""
    units: dict[str, set[str]] = {}
    for pairs in table.rows.values():
        for metric, pair in pairs.items():
            units.setdefault(metric, set()).add(pair.unit)
    alone = len(units) > 1 and all(len(pairs) == 1 for pairs in table.rows.values())
    return alone or any(len(u) > 1 for u in units.values())
