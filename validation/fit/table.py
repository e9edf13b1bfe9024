"""A fit as tables, and as sentences."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from ssmr.metrics.declared import METRICS, Metrics
from ssmr.metrics.poses import HorizonErrors
from validation.fit.data import FitData, FittedParameter, Scored, SearchData
from validation.report import tables
from validation.report.tables import NOTHING, Cell, Grid, one_line

_VAGUE_SHARE = 0.5  # a parameter with a wider interval, as a share of the space between its bounds, is marked as uncertain
_KNOWN_DIGITS = 4  # significant digits of a number whose error is not known
_MOST_DIGITS = 7  # greatest number of significant digits: only a fit to a model's own motion has smaller errors
_SHOWN_HORIZONS = (2.0, 6.0, 30.0)  # horizons in tables [s]; all that were scored where none of these was
_LONGEST_SOURCE, _SHORT_SOURCE = (
    32,
    26,
)  # greatest numbers of characters of a source's name, in narrow tables and in wide ones
STOPPED = {
    "generations": "all generations done",
    "improvement": "no more improvement",
    "target": "target reached",
    "interrupt": "interrupted",
    "least squares": "least squares ended",
}
"""Reasons why a search ended, in words."""

_METRICS = tuple(METRICS[name] for name in ("d_rms_m", "d_haus_m", "d_ratio", "sync_rms_m", "yaw_rms_rad"))
_HORIZONS: tuple[tuple[str, tables.Unit, Callable[[HorizonErrors], float]], ...] = (
    ("position", tables.METRES, lambda e: e.position_median_m),
    ("yaw", tables.DEGREES, lambda e: e.yaw_median_rad),
)


def is_vague(p: FittedParameter) -> bool:
    """Return whether the 95 % interval takes up more than `_VAGUE_SHARE` of the space between the bounds."""
    return p.interval_95 is not None and p.share(p.interval_95[1]) - p.share(p.interval_95[0]) > _VAGUE_SHARE


def value_text(p: FittedParameter) -> str:
    """Return the value with its standard error, as `0.523 ± 0.004`; the error's size decides how many digits both have.

    An error keeps two digits up to 0.35, 3.5, 35 ... and one beyond: rounding then takes no more than a seventh of it.
    """
    error = p.standard_error
    if error is None or not (math.isfinite(error) and error > 0.0):
        return number_text(p.value)
    exponent = math.floor(math.log10(error))
    leading = error / 10.0**exponent
    decimals = (1 if leading < 3.55 else 0) - exponent
    most = _MOST_DIGITS - 1 - math.floor(math.log10(abs(p.value))) if p.value != 0.0 else decimals
    if decimals > most:
        return f"{p.value:.{max(most, 0)}f} ± {error:.1g}"
    rounded = (f"{round(x, decimals):.{max(decimals, 0)}f}" for x in (p.value, error))
    return " ± ".join(x.removeprefix("-") if float(x) == 0.0 else x for x in rounded)


def number_text(value: float) -> str:
    """Return a number whose error is not known; `off` for the infinite value of a limit that is off."""
    if math.isinf(value):
        return "off"
    return f"{value:.{_KNOWN_DIGITS}g}" if math.isfinite(value) else NOTHING


def unit_text(unit: str) -> str:
    """Return a unit as it follows a number: nothing for a pure number."""
    return "" if unit == "1" else unit


def source_text(scored: Scored, most: int = _LONGEST_SOURCE) -> str:
    """Return a source's name without its folders, in at most `most` characters."""
    return tables.shortened(Path(scored.label).name, most)


def flags(p: FittedParameter) -> list[str]:
    """Return warnings about a parameter."""
    return ["at bound"] * p.at_bound + ["uncertain"] * is_vague(p)


def ending(result: SearchData) -> str:
    """Return the reason why the search ended, in words."""
    why = STOPPED.get(result.stopped_by, result.stopped_by)
    return why if result.status == "finished" else f"INTERRUPTED after {_counted(result.generations, 'generation')}"


def effort(result: SearchData) -> str:
    """Return the cost and the effort of the search, in words."""
    done = f"{_counted(result.evaluations, 'evaluation')} in {_counted(result.generations, 'generation')}"
    cost = f"{result.cost:.4g}" if math.isfinite(result.cost) else NOTHING
    return f"{result.cost_name} cost {cost} · {done} · {result.wall_s:.1f} s · seed {result.seed}"


def _counted(n: int, what: str) -> str:
    return f"{n} {what}{'s' * (n != 1)}"


def parameter_grid(parameters: Sequence[FittedParameter], what: str, before: str) -> Grid:
    """Return the parameters row by row; `what` and `before` name the first column and the one of earlier values."""
    known = any(p.standard_error is not None for p in parameters)
    value = "value ±\u00a0standard\u00a0error" if known else "value"
    names = (what, "unit", value, "lower bound", "upper bound", before, "warning")
    rows = []
    for p in parameters:
        bounds = f"{p.lower:.3g}", f"{p.upper:.3g}"
        texts = p.name, unit_text(p.unit), value_text(p), *bounds, number_text(p.before), ", ".join(flags(p))
        rows.append(tuple(map(Cell, texts)))
    return Grid(tuple((name, "") for name in names), (tuple(rows),), left=2, trailing=1)


def _rows(result: FitData) -> list[list[tuple[str, Metrics, dict[float, HorizonErrors]]]]:
    """Return source, metrics and errors by horizon of what was fitted to, and of what was held out."""
    train = [(source_text(s), s.metrics, dict(s.horizons)) for s in result.train]
    if len(train) > 1:
        train.append(("all fitted to", result.train_metrics, dict(result.train_horizons)))
    held_out = [(f"held out: {source_text(s)}", s.metrics, dict(s.horizons)) for s in result.held_out]
    return [group for group in (train, held_out) if group]


def _score_grid(result: FitData) -> Grid:
    groups = _rows(result)
    scores = [metrics for group in groups for _, metrics, _ in group]
    units = tables.units_of(_METRICS, scores)
    header = [("source", "")] + [(metric.label, unit.symbol) for metric, unit in zip(_METRICS, units, strict=True)]

    def cells(label: str, metrics: Metrics) -> tuple[Cell, ...]:
        return Cell(label), *(Cell(u.text(metrics[m.name])) for m, u in zip(_METRICS, units, strict=True))

    rows = tuple(tuple(cells(label, m) for label, m, _ in group) for group in groups)
    return Grid(tuple(header), rows, title="Scores of the fitted plant", left=1)


def _horizon_grids(result: FitData) -> list[Grid]:
    """Return medians by horizon, where there are recordings."""
    groups = [[row for row in group if row[2]] for group in _rows(result)]
    known = sorted({h for group in groups for _, _, errors in group for h in errors})
    shown = [h for h in known if h in _SHOWN_HORIZONS] or known
    if not shown:
        return []
    header = [("source", "")] + [(f"{name} {h:g}\u00a0s", unit.symbol) for name, unit, _ in _HORIZONS for h in shown]

    def cells(label: str, errors: dict[float, HorizonErrors]) -> tuple[Cell, ...]:
        texts = [unit.text(value(errors[h])) if h in errors else NOTHING for _, unit, value in _HORIZONS for h in shown]
        return Cell(label), *map(Cell, texts)

    rows = tuple(tuple(cells(k, e) for k, _, e in group) for group in groups if group)
    return [Grid(tuple(header), rows, title="Median error of the relative pose after a horizon", left=1)]


def _overlapping_grids(result: FitData) -> list[Grid]:
    """Return medians over windows that begin every second, with their intervals, where there are recordings."""
    windows = [(source_text(s, _SHORT_SOURCE), s.windows) for s in result.train]
    windows += [(f"held out: {source_text(s, _SHORT_SOURCE)}", s.windows) for s in result.held_out]
    found = [(label, {h: e.summary() for h, e in by_horizon.items()}) for label, by_horizon in windows]
    grid = tables.interval_grid("source", found, "The same over windows that begin every second, and how sure that is")
    return [] if grid is None else [grid]


def fit_grids(result: FitData) -> list[Grid]:
    """Return the parameters, the scores on each source, and median errors by horizon where there are recordings."""
    title = f"{result.model} fitted to {one_line(result.source)} · begun with profile {one_line(result.profile_label)}"
    parameters = parameter_grid(result.parameters, "parameter", "before")
    caption = f"{effort(result)}\n{ending(result)}\n"
    parameters = replace(parameters, title=title, caption=caption)
    return [parameters, _score_grid(result), *_horizon_grids(result), *_overlapping_grids(result)]


def fit_notes(result: FitData) -> list[str]:
    """Return what the tables do not say, sentence by sentence."""
    notes = []
    if result.status != "finished":
        notes.append("The fit was interrupted: these are the best numbers so far, without standard errors.")
    notes += [one_line(note) for note in result.remarks]
    if result.uncertainty_method:
        notes.append(f"Standard errors come from: {one_line(result.uncertainty_method)}.")
    return notes


def fit_markdown(result: FitData) -> str:
    """Return the whole fit as markdown."""
    facts = {
        "plant": result.model,
        "source": result.source,
        "begun with profile": result.begun_with,
        "robot": result.robot,
        "options": result.options,
        "versions": result.versions,
    }
    return tables.report_markdown("Fit", facts, fit_grids(result), fit_notes(result), tables.meanings(_METRICS))
