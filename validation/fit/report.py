"""A fit as tables and sentences: for the terminal (rich), and for a report (markdown)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from ssmr.metrics.paths import HorizonErrors, PathMetrics
from validation.compare.table import COLUMNS
from validation.fit.result import FitResult, FittedParameter, Scored
from validation.show.tables import (
    DEGREES,
    METRES,
    NOTHING,
    Cell,
    Grid,
    Quantity,
    Unit,
    code_span,
    markdown_table,
    one_line,
    option_text,
    rich_table,
    shortened,
    unit_of,
)

Search = Any
"""The result of a fit or of a tuning."""

VAGUE_SHARE = 0.5
"""An interval wider than this share of the bounds, as they were searched, says little."""
KNOWN_DIGITS = 4
"""Significant digits of a number whose error is not known."""
MOST_DIGITS = 7
"""Significant digits at most: a smaller error is that of a fit to itself, and nobody reads more."""
SHOWN_HORIZONS = (2.0, 6.0, 30.0)
"""Horizons in tables [s]; where there is none of them, all that there are."""
LONGEST_LABEL = 32
"""Characters of a source's name."""
STOPPED = {
    "generations": "all generations done",
    "improvement": "no more improvement",
    "target": "target reached",
    "interrupt": "interrupted",
}
"""Why a search ended, in words."""
AT_BOUND, VAGUE = "at bound", "vague"

_METRICS: tuple[tuple[str, Quantity, Callable[[PathMetrics], float]], ...] = (
    ("d_rms", "length", lambda m: m.d_rms_m),
    ("d_haus", "length", lambda m: m.d_haus_m),
    ("d_ratio", "ratio", lambda m: m.d_ratio),
    ("sync rms", "length", lambda m: m.sync_rms_m),
    ("yaw rms", "angle", lambda m: m.yaw_rms_rad),
)
_HORIZONS: tuple[tuple[str, Unit, Callable[[HorizonErrors], float]], ...] = (
    ("position", METRES, lambda e: e.position_median_m),
    ("yaw", DEGREES, lambda e: e.yaw_median_rad),
)


def cube_share(p: FittedParameter, value: float) -> float:
    """Where a value lies between the bounds of the search, as they were searched: 0 at the lower, 1 at the upper one.

    Args:
        p: the parameter.
        value: in its unit; on a logarithmic scale what is not positive lies infinitely far below.
    """
    if p.scale == "log":
        return math.log(value / p.lower) / math.log(p.upper / p.lower) if value > 0.0 else -math.inf
    return (value - p.lower) / (p.upper - p.lower)


def is_vague(p: FittedParameter) -> bool:
    """Whether the 95 % interval takes up more than `VAGUE_SHARE` of the bounds."""
    return p.interval_95 is not None and cube_share(p, p.interval_95[1]) - cube_share(p, p.interval_95[0]) > VAGUE_SHARE


def value_text(p: FittedParameter) -> str:
    """The value with its standard error, as `0.523 ± 0.004`; the error's size decides how many digits both have.

    An error keeps two digits up to 0.35, 3.5, 35 ... and one beyond: rounding then takes no more than a seventh of it.
    """
    error = p.standard_error
    if error is None or not (math.isfinite(error) and error > 0.0):
        return number_text(p.value)
    exponent = math.floor(math.log10(error))
    leading = error / 10.0**exponent
    decimals = (1 if leading < 3.55 else 0) - exponent
    most = MOST_DIGITS - 1 - math.floor(math.log10(abs(p.value))) if p.value != 0.0 else decimals
    if decimals > most:
        return f"{p.value:.{max(most, 0)}f} ± {error:.1g}"
    rounded = (f"{round(x, decimals):.{max(decimals, 0)}f}" for x in (p.value, error))
    return " ± ".join(x.removeprefix("-") if float(x) == 0.0 else x for x in rounded)


def number_text(value: float) -> str:
    """A number whose error is not known; `off` for the infinite value of a limit that is off."""
    if math.isinf(value):
        return "off"
    return f"{value:.{KNOWN_DIGITS}g}" if math.isfinite(value) else NOTHING


def unit_text(unit: str) -> str:
    """A unit as it follows a number: nothing for a pure one."""
    return "" if unit == "1" else unit


def label_text(scored: Scored, most: int = LONGEST_LABEL) -> str:
    """A source without the folders it lies in, in at most `most` characters."""
    return shortened(Path(scored.label).name, most)


def flags(p: FittedParameter) -> list[str]:
    """What to be wary of in a parameter."""
    return [AT_BOUND] * p.at_bound + [VAGUE] * is_vague(p)


def ending(result: Search) -> str:
    """How the search ended, in words."""
    why = STOPPED.get(result.stopped_by, result.stopped_by)
    return why if result.status == "finished" else f"INTERRUPTED after {_counted(result.generations, 'generation')}"


def effort(result: Search) -> str:
    """Cost, and what it took to find it."""
    done = f"{_counted(result.evaluations, 'evaluation')} in {_counted(result.generations, 'generation')}"
    cost = f"{result.cost:.4g}" if math.isfinite(result.cost) else NOTHING
    return f"{result.cost_name} cost {cost} · {done} · {result.wall_s:.1f} s · seed {result.seed}"


def _counted(n: int, what: str) -> str:
    return f"{n} {what}{'s' * (n != 1)}"


def parameter_grid(parameters: Sequence[FittedParameter], what: str, before: str) -> Grid:
    """What a search found, row by row; `what` it is and what it was `before`, as the header says it."""
    known = any(p.standard_error is not None for p in parameters)
    value = "value ±\u00a0standard\u00a0error" if known else "value"
    names = (what, "unit", value, "lower bound", "upper bound", before, "beware")
    rows = [
        tuple(
            map(
                Cell,
                (p.name, p.unit, value_text(p), f"{p.lower:g}", f"{p.upper:g}", number_text(p.before), ", ".join(flags(p))),
            )
        )
        for p in parameters
    ]
    return Grid(tuple((name, "") for name in names), (tuple(rows),), left=2)


def _rows(result: FitResult) -> list[list[tuple[str, PathMetrics, dict[float, HorizonErrors]]]]:
    """What there are scores of, fitted to and held out: source, metrics, errors by horizon."""
    train = [(label_text(s), s.metrics, dict(s.horizons)) for s in result.train]
    if len(train) > 1:
        train.append(("all fitted to", result.train_metrics, dict(result.train_horizons)))
    held_out = [(f"held out: {label_text(s)}", s.metrics, dict(s.horizons)) for s in result.held_out]
    return [group for group in (train, held_out) if group]


def _score_grid(result: FitResult) -> Grid:
    groups = _rows(result)
    scores = [metrics for group in groups for _, metrics, _ in group]
    lengths = [value(m) for _, quantity, value in _METRICS if quantity == "length" for m in scores]
    units = [unit_of(q, lengths if q == "length" else [value(m) for m in scores]) for _, q, value in _METRICS]
    header = [("source", "")] + [(name, unit.symbol) for (name, _, _), unit in zip(_METRICS, units, strict=True)]

    def cells(label: str, metrics: PathMetrics) -> tuple[Cell, ...]:
        return Cell(label), *(Cell(u.text(value(metrics))) for (_, _, value), u in zip(_METRICS, units, strict=True))

    return Grid(tuple(header), tuple(tuple(cells(label, m) for label, m, _ in group) for group in groups), left=1)


def _horizon_grid(result: FitResult) -> Grid | None:
    """Medians by horizon; None where nothing was recorded."""
    groups = [[row for row in group if row[2]] for group in _rows(result)]
    known = sorted({h for group in groups for _, _, errors in group for h in errors})
    shown = [h for h in known if h in SHOWN_HORIZONS] or known
    if not shown:
        return None
    header = [("source", "")] + [(f"{name} {h:g}\u00a0s", unit.symbol) for name, unit, _ in _HORIZONS for h in shown]

    def cells(label: str, errors: dict[float, HorizonErrors]) -> tuple[Cell, ...]:
        texts = [unit.text(value(errors[h])) if h in errors else NOTHING for _, unit, value in _HORIZONS for h in shown]
        return Cell(label), *map(Cell, texts)

    return Grid(tuple(header), tuple(tuple(cells(k, e) for k, _, e in group) for group in groups if group), left=1)


def fit_tables(result: FitResult) -> list[Table]:
    """A fit for a terminal of 110 columns or more.

    Args:
        result: what was found.

    Returns:
        The parameters with their standard errors; the scores on each source, fitted to and held out; and, where there are
        recordings, median errors of the relative pose by horizon.
    """
    title = f"{result.model} fitted to {one_line(result.source)} · begun with profile {one_line(result.profile)}"
    tables = [
        rich_table(parameter_grid(result.parameters, "parameter", "before"), title, f"{effort(result)}\n{ending(result)}\n")
    ]
    tables.append(rich_table(_score_grid(result), "Scores of the fitted plant", ""))
    horizons = _horizon_grid(result)
    if horizons is not None:
        tables.append(rich_table(horizons, "Median error of the relative pose after a horizon", ""))
    return tables


def fit_notes(result: FitResult) -> list[str]:
    """What the tables do not say, sentence by sentence.

    Args:
        result: what was found.

    Returns:
        That it was interrupted, if it was; the fit's own notes; how the standard errors were found.
    """
    notes = []
    if result.status != "finished":
        notes.append("The fit was interrupted: these are the best numbers so far, without standard errors.")
    notes += [one_line(note) for note in result.notes]
    if result.uncertainty_method:
        notes.append(f"Standard errors by: {one_line(result.uncertainty_method)}.")
    return notes


def _bullets(lines: Sequence[str]) -> list[str]:
    return [f"- {line}" for line in lines]


def fit_markdown(result: FitResult) -> str:
    """The whole fit as GitHub-flavoured markdown.

    Args:
        result: what was found.

    Returns:
        How it was run, the tables of `fit_tables`, the sentences of `fit_notes`, and what each metric means.
    """
    options = ", ".join(f"{one_line(k)} {option_text(v)}" for k, v in result.options.items() if v is not None)
    versions = ", ".join(f"{one_line(k)} {one_line(v)}" for k, v in result.versions.items())
    lines = [
        "# Fit",
        "",
        *_bullets(
            [
                f"plant: {code_span(result.model)}",
                f"source: {code_span(result.source)}",
                f"begun with profile: {code_span(result.profile)}",
                effort(result),
                f"status: {ending(result)}",
                f"options: {code_span(options) if options else 'none'}",
                f"versions: {code_span(versions) if versions else 'unknown'}",
            ]
        ),
        "",
        "## Parameters",
        "",
        *markdown_table(parameter_grid(result.parameters, "parameter", "before")),
        "",
        "## Scores",
        "",
        *markdown_table(_score_grid(result)),
    ]
    horizons = _horizon_grid(result)
    if horizons is not None:
        lines += ["", "Median error of the relative pose after a horizon:", "", *markdown_table(horizons)]
    notes = fit_notes(result)
    if notes:
        lines += ["", "## Notes", "", *_bullets(notes)]
    names = [name for name, _, _ in _METRICS]
    lines += ["", "## What the metrics mean", ""]
    lines += [f"- **{column.name}**: {column.meaning}." for column in COLUMNS if column.name in names]
    return "\n".join(lines) + "\n"
