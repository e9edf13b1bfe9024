"""A comparison as tables, for the terminal (rich) and for a report (markdown): one set of columns, one formatting."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import combinations
from typing import Any

from ssmr.metrics.declared import METRICS, Metric
from ssmr.metrics.poses import HorizonErrors
from validation.compare.data import ComparisonData
from validation.show.tables import (
    DEGREES,
    METRES,
    MILLIMETRES,
    NEWTONS,
    PERCENT,
    Cell,
    Grid,
    Unit,
    interval_grid,
    judged_cells,
    length_unit,
    meanings,
    one_line,
    report_markdown,
    units_of,
)
from validation.simulator.description import WHEELS
from validation.simulator.health import Health
from validation.simulator.terrain import FLAT

HEADLINE_HORIZON = 6.0
"""The horizon whose errors stand for a plant where only one has room [s]; else the one closest to it."""


REAL_TIME = Metric(
    "real_time_factor", "real time", "×", "high",
    "simulated time over the time that simulating took; above 1 the simulation is faster than the clock",
)  # fmt: skip
COLUMNS = (*METRICS.values(), REAL_TIME)
"""Metrics of each plant, in the order of the table."""

HORIZON_VALUES: tuple[tuple[str, Unit, Callable[[HorizonErrors], float]], ...] = (
    ("position median", METRES, lambda e: e.position_median_m),
    ("position p95", METRES, lambda e: e.position_p95_m),
    ("yaw median", DEGREES, lambda e: e.yaw_median_rad),
    ("yaw p95", DEGREES, lambda e: e.yaw_p95_rad),
)


_HORIZON_LEGEND = (
    "- **horizon**: each plant's motion over a window as long as the horizon is compared with the reference's motion over"
    " that window, both seen from the pose at the window's start: the error is what dead reckoning loses in that time,"
    " however far the plant has drifted before. Windows follow one another and span no gap; p95 is the 95th percentile."
    " Others begin every second and so overlap; the interval in brackets holds their median with a probability of 90 % and"
    " comes from resampling blocks of windows as long as the horizon (in a recording shorter than four such blocks: the"
    " range of the errors)."
)
_KILOGRAMS, _NEWTON_METRES = Unit("kg", 1.0, 1), Unit("N m", 1.0, 1)
_TENTHS, _SPEED = Unit("N", 1.0, 1), Unit("m/s", 1.0, 2)
_HEALTH_CAPTION = (
    "apparent mass: thrust over acceleration; torque: of a side; loads' sum: off the weight; slip limit: where the soft"
    " contact lifts a tyre; rise: of the body at the greatest slip"
)


def _plant_grid(comparison: ComparisonData) -> Grid:
    """Plants as rows, metrics as columns; the reference, at no distance from itself, is judged by its speed only."""
    plants = comparison.plants
    columns: list[dict[str, Cell]] = []
    header = [("plant", "")]
    every = {name: {**result.metrics, REAL_TIME.name: result.real_time_factor} for name, result in plants.items()}
    for metric, unit in zip(COLUMNS, units_of(COLUMNS, list(every.values())), strict=True):
        values = {name: row[metric.name] for name, row in every.items()}
        texts = {name: unit.text(value) for name, value in values.items()}
        judged = {n: v for n, v in values.items() if n != comparison.reference_name or metric is REAL_TIME}
        header.append((metric.label, unit.symbol))
        columns.append(judged_cells(texts, judged, metric.wanted))
    rows = []
    for name in plants:
        label = f"{name} (ref)" if name == comparison.reference_name else name
        rows.append((Cell(label), *(column[name] for column in columns)))
    title = f"{one_line(comparison.source)} · profile {one_line(comparison.profile_label)}"
    if comparison.terrain != FLAT:
        title += f" · mujoco on {comparison.terrain.words}"
    caption = f"compared with {comparison.reference_name} · seed {comparison.seed} · emphasised: the best"
    for name, health in _ailing(comparison):
        if not health.ok:
            caption += f"\n{name} is unhealthy: its wheel loads show a contact that cannot be trusted"
    return Grid(tuple(header), (tuple(rows),), 1, title, caption)


def _horizon_grid(comparison: ComparisonData) -> Grid | None:
    """Horizons as groups, plants as rows; None where there is no horizon."""
    plants = comparison.plants
    horizons = sorted({h for result in plants.values() for h in result.horizons})
    if not horizons:
        return None
    header = [("horizon", "s"), ("plant", ""), ("windows", "1")]
    header += [(name, unit.symbol) for name, unit, _ in HORIZON_VALUES]
    groups = []
    for horizon in horizons:
        errors = {name: result.horizons[horizon] for name, result in plants.items() if horizon in result.horizons}
        columns = []
        for _, unit, value in HORIZON_VALUES:
            values = {name: value(e) for name, e in errors.items()}
            columns.append(judged_cells({name: unit.text(v) for name, v in values.items()}, values, "low"))
        rows = []
        for name, e in errors.items():
            rows.append((Cell(f"{horizon:g}"), Cell(name), Cell(str(e.n)), *(column[name] for column in columns)))
        groups.append(tuple(rows))
    caption = f"compared with {comparison.reference_name} · emphasised: the best"
    return Grid(tuple(header), tuple(groups), 2, "Error of the relative pose after a horizon", caption)


def _overlapping_grid(comparison: ComparisonData) -> Grid | None:
    """Return medians over windows that begin every second, with their intervals; None where there are no windows."""
    title = "The same over windows that begin every second, and how sure that is"
    return interval_grid("plant", [(name, r.overlapping) for name, r in comparison.plants.items()], title)


def comparison_notes(comparison: ComparisonData) -> list[str]:
    """Return what is wrong with a recording, and which plants it cannot tell apart.

    Plants are told apart after the horizon closest to `HEADLINE_HORIZON`.
    """
    notes = list(comparison.warnings)
    if (alike := alike_plants(comparison)) is None:
        return notes
    n = sum(alike["horizon_s"] in result.windows for result in comparison.plants.values())
    for what in ("position", "yaw"):
        pairs = [" and ".join(pair) for pair in alike[what]]
        if len(pairs) == n * (n - 1) // 2 > 1:
            notes.append(
                f"After {alike['horizon_s']:g} s the recording cannot tell any two of these plants apart in {what}."
            )
        elif pairs:
            notes.append(f"After {alike['horizon_s']:g} s the recording cannot tell apart in {what}: {', '.join(pairs)}.")
    return notes


def headline_horizon(horizons: Iterable[float]) -> float | None:
    """Return the horizon closest to `HEADLINE_HORIZON` [s]; None of none."""
    return min(horizons, key=lambda h: (abs(h - HEADLINE_HORIZON), h), default=None)


def alike_plants(comparison: ComparisonData) -> dict[str, Any] | None:
    """Return the pairs of plants that a recording cannot tell apart, as compare.json has them; None without windows.

    Medians over overlapping windows are compared, after the horizon closest to `HEADLINE_HORIZON`: `{"horizon_s",
    "position": [[name, name], ...], "yaw": [...]}`.
    """
    horizon = headline_horizon({h for result in comparison.plants.values() for h in result.windows})
    if horizon is None:
        return None
    able = {name: r.windows[horizon] for name, r in comparison.plants.items() if horizon in r.windows}
    alike: dict[str, list[list[str]]] = {"position": [], "yaw": []}
    for a, b in combinations(able, 2):
        for what, differs in zip(alike, able[a].differs_from(able[b]), strict=True):
            if not differs:
                alike[what].append([a, b])
    return {"horizon_s": horizon, **alike}


def _load_grid(comparison: ComparisonData) -> Grid | None:
    """Return the wheel loads of the plants that know them; None where none does."""
    groups = []
    for name, result in comparison.plants.items():
        if (loads := result.loads) is not None:
            values = loads.static_N, loads.mean_N, loads.lowest_N, loads.highest_N, loads.off_ground_share
            rows = []
            for wheel, *newtons, share in zip(WHEELS, *values, strict=True):
                texts = name, wheel.replace("_", " "), *map(NEWTONS.text, newtons), PERCENT.text(share)
                rows.append(tuple(map(Cell, texts)))
            groups.append(tuple(rows))
    forces = [(name, "N") for name in ("at rest", "mean", "least", "greatest")]
    header = [("plant", ""), ("wheel", ""), *forces, ("off ground", "%")]
    return Grid(tuple(header), tuple(groups), 2, "Wheel loads", _load_caption(comparison)) if groups else None


def _load_caption(comparison: ComparisonData) -> str:
    """Return in words how far the loads are from those at rest and from the quasi-static formula."""
    return "; ".join(
        f"{name} on {comparison.terrain.words}: rms {r.loads.static_rms_N:.1f} N from the loads at rest, "
        f"{r.loads.quasi_static_rms_N:.1f} N from quasi-static load transfer"
        for name, r in comparison.plants.items()
        if r.loads is not None
    )


def _health_grid(comparison: ComparisonData) -> Grid | None:
    """Return inertia, torque and slip of the plants that know them; None where none does."""
    rows = []
    for name, result in comparison.plants.items():
        if (health := result.health) is not None and health.apparent_mass_kg is not None:
            numbers = (
                (_KILOGRAMS, health.apparent_mass_kg), (_NEWTON_METRES, health.peak_torque_N_m),
                (_TENTHS, health.load_sum_rms_N), (_SPEED, health.slip_speed_m_s), (_SPEED, health.slip_limit_m_s),
                (MILLIMETRES, health.ride_rise_m),
            )  # fmt: skip
            texts = [unit.text(math.nan if value is None else value) for unit, value in numbers]
            rows.append(tuple(map(Cell, (name, *texts, health.verdict))))
    header = (
        ("plant", ""), ("apparent mass", "kg"), ("peak torque", "N m"), ("loads' sum rms", "N"), ("slip", "m/s"),
        ("slip limit", "m/s"), ("rise", "mm"), ("verdict", ""),
    )  # fmt: skip
    return Grid(header, (tuple(rows),), 1, "Health", _HEALTH_CAPTION, 1) if rows else None


def _ailing(comparison: ComparisonData) -> list[tuple[str, Health]]:
    """Plants with whose physics something is wrong, each with the verdict."""
    return [(n, r.health) for n, r in comparison.plants.items() if r.health is not None and r.health.advice]


def comparison_grids(comparison: ComparisonData) -> list[Grid]:
    """Return a comparison's tables, the most telling one first.

    On a recording the errors of the relative pose by horizon and plant come first: number of windows, median and 95th
    percentile (p95) of the position error [m] and the yaw error [deg]; then medians over windows that overlap. Then, with
    plants as rows and the reference marked, the metrics. Then, for plants that know them, the wheel loads [N], and the
    health of their physics: inertia, torque, trembling of the loads and slip. The best value of each column is emphasised.
    """
    first = _horizon_grid(comparison), _overlapping_grid(comparison), _plant_grid(comparison)
    return [grid for grid in (*first, _load_grid(comparison), _health_grid(comparison)) if grid is not None]


def headline_error(comparison: ComparisonData, name: str) -> str:
    """Return the one number, with its unit, by which a plant is known where there is no room for more.

    Where there are horizons, it is the median errors after the horizon closest to `HEADLINE_HORIZON`; else d_rms.
    """
    result = comparison.plants[name]
    if result.horizons:
        horizon = min(result.horizons, key=lambda h: abs(h - HEADLINE_HORIZON))
        errors = result.horizons[horizon]
        length = length_unit([errors.position_median_m])
        coarse = replace(length, decimals=0) if length.symbol == "mm" else replace(length, decimals=2)
        yaw = replace(DEGREES, decimals=1, significant=2).text(errors.yaw_median_rad).removesuffix(".0")
        return f"{coarse.text(errors.position_median_m)} {length.symbol}, {yaw}° in {horizon:g} s"
    d_rms = result.metrics["d_rms_m"]
    length = length_unit([d_rms])
    return f"d_rms {length.text(d_rms)} {length.symbol}"


def comparison_facts(comparison: ComparisonData) -> dict[str, str | int]:
    """Return what was compared, by name."""
    c = comparison
    return {"source": c.source, "profile": c.profile, "robot": c.robot.name, "reference": c.reference_name, "seed": c.seed}


def comparison_markdown(comparison: ComparisonData) -> str:
    """Return the whole comparison as markdown, with advice where something is wrong with a plant's physics."""
    facts = {**comparison_facts(comparison), "options": comparison.options, "versions": comparison.versions}
    advice = [f"{n}{'' if h.ok else ' is unhealthy'}: {one_line(h.advice)}." for n, h in _ailing(comparison)]
    grids = comparison_grids(comparison)
    legend = meanings(COLUMNS) + [_HORIZON_LEGEND] * any(r.horizons for r in comparison.plants.values())
    return report_markdown("Comparison", facts, grids, [*advice, *comparison_notes(comparison)], legend)
