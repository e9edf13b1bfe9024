"""The result of a study of transfer: what choosing a controller by each plant costs, in tables and in sentences."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from validation.report.tables import MILLIMETRES, NOTHING, Cell, Grid
from validation.study.result import StudyResult
from validation.study.transfer.comparison import RESAMPLES, mean_costs
from validation.study.transfer.contenders import PRACTICABLE, TransferOptions
from validation.study.transfer.field import TransferField


@dataclass(frozen=True, eq=False)
class TransferStudy(StudyResult):
    """Whether plants choose the right controller for the judge."""

    study = "transfer"
    title = "Transfer"
    options: TransferOptions
    """Options of the study."""
    fields: tuple[TransferField, ...]
    """What was found, by profile."""

    def heading(self) -> str:
        """Return what was driven, in one line."""
        o, names = self.options, {name for field in self.fields for name in field.names}
        profiles = ", ".join(field.label for field in self.fields)
        drives = sum(len(field.drives) for field in self.fields)
        return f"{profiles}: {len(names)} controllers, {drives} references; {o.seeds_text}"

    def grids(self) -> list[Grid]:
        """Return, for each profile, what choosing a controller by each plant costs."""
        return [self._choices(field) for field in self.fields]

    def report_grids(self) -> list[Grid]:
        """Return besides those the costs of every controller on every plant, and who wins where."""
        further = (self._choices, self._costs, self._prediction, self._correlations, self._winners)
        return [make(field) for field in self.fields for make in further]

    def notes(self) -> list[str]:
        """Return a sentence on each plant: whether it chooses the right controller, and what choosing by it costs."""
        return [sentence for field in self.fields for sentence in self._sentences(field)]

    def explanations(self) -> Sequence[str]:
        """Return sentences on what the columns mean."""
        return (
            "Cost: that of Sec. 4.3.3, which tune minimises, without the LQR's additional term; mean over the references.",
            f"A reference is driven at the speed in its label, which asks for at most {100.0 * PRACTICABLE:.0f} % of the "
            "greatest speed and yaw rate of the judge.",
            "A controller that loses a run is placed behind all that lose fewer, whatever its cost.",
            "tau: Kendall's rank correlation between the places of all controllers on plant and judge; beside it, "
            f"an interval that holds 90 % of {RESAMPLES} draws of the references.",
            "Regret: additional cost, on the judge, of the controller that the plant puts first over all references.",
        )

    def findings(self) -> dict[str, Any]:
        """Return options, and what was found by profile."""
        o = self.options
        return {
            "judge": o.judge,
            "seeds": list(range(o.seed, o.seed + o.seeds)),
            "profiles": {field.profile: {"robot": field.robot, **field.as_dict()} for field in self.fields},
        }

    def _choices(self, field: TransferField) -> Grid:
        rows, judge = [], self.options.judge
        for plant in self.options.plant_names:
            found = field.agreement(plant)
            assert found is not None
            between = NOTHING if plant == judge else _span(found.tau_interval)
            texts = (plant, _number(found.tau), between, f"{found.same_winner}/{len(field.drives)}", _percent(found.regret))
            rows.append((*map(Cell, texts), Cell(field.names[found.chosen])))
        header = (("plant", ""), ("tau", ""), ("interval", ""), ("same winner", ""), ("regret", "%"), ("chooses", ""))
        title = f"{field.label}: choosing a controller for {judge}"
        caption = (
            f"{len(field.names)} controllers, {len(field.drives)} references. Regret: what the choice costs more on {judge}."
        )
        return Grid(header, (tuple(rows[:1]), tuple(rows[1:])), 1, title, caption, 1)

    def _costs(self, field: TransferField) -> Grid:
        judge, plants = self.options.judge, self.options.plant_names
        means = {plant: dict(zip(field.names, mean_costs(field.table_of(plant)), strict=True)) for plant in plants}
        least = {plant: field.winner(plant) for plant in plants}
        beside = [mean_costs(field.table_of(judge, m)) for m in ("d_rms_m", "sync_rms_m")]
        rows = []
        for name in field.order:
            k = field.names.index(name)
            cells = [Cell(name)]
            for plant in plants:
                lost = field.lost(plant).get(name, 0)
                cells.append(Cell(f"{means[plant][name]:.2f}" + (f" ({lost} lost)" if lost else ""), least[plant] == name))
            rows.append((*cells, *(Cell(MILLIMETRES.text(float(values[k]))) for values in beside)))
        gaps = [NOTHING if plant == judge else _percent(field.usual_gap(plant)) for plant in plants]
        lost_runs = [str(sum(field.lost(plant).values())) for plant in plants]
        below = [("gap, median [%]", *gaps, "", ""), ("lost runs", *lost_runs, "", "")]
        header = (
            ("controller", ""),
            *((plant, "") for plant in plants),
            (f"d_rms, {judge}", "mm"),
            (f"sync, {judge}", "mm"),
        )
        return Grid(header, (tuple(rows), tuple(tuple(map(Cell, row)) for row in below)), 1, f"{field.label}: mean cost")

    def _prediction(self, field: TransferField) -> Grid:
        kinds = (None, False, True)
        rows = []
        for plant in field.models:
            found = [field.agreement(plant, kind) for kind in kinds]
            cells = [text for a in found for text in ((_number(a.tau), _percent(a.regret)) if a else (NOTHING, NOTHING))]
            rows.append(tuple(map(Cell, (plant, *cells))))
        header = [(f"{what}, {who}", unit) for who in ("all", "without prediction", "with it") for what, unit in _PAIR]
        return Grid((("plant", ""), *header), (tuple(rows),), 1, f"{field.label}: choosing with and without prediction")

    def _correlations(self, field: TransferField) -> Grid:
        plants, found = self.options.plant_names, field.as_dict()["plants"]
        rows = [tuple(map(Cell, (one, *(_number(found[one]["tau_with"][other]) for other in plants)))) for one in plants]
        title = f"{field.label}: rank correlation between plants"
        return Grid((("plant", ""), *((plant, "") for plant in plants)), (tuple(rows),), 1, title)

    def _winners(self, field: TransferField) -> Grid:
        plants, judge = self.options.plant_names, self.options.judge
        rows = []
        for k, drive in enumerate(field.drives):
            best = field.winner(judge, k)
            cells = [Cell(name, name == best) for name in (field.winner(plant, k) for plant in plants)]
            rows.append((Cell(drive.label), *cells))
        header = (("reference, m/s", ""), *((plant, "") for plant in plants))
        return Grid(header, (tuple(rows),), 1 + len(plants), f"{field.label}: who wins where")

    def _sentences(self, field: TransferField) -> list[str]:
        return [
            _best_sentence(field),
            *(_plant_sentence(field, plant) for plant in field.models),
            *_prediction_sentences(field),
            *_lost_sentences(field),
        ]


_PAIR = (("tau", ""), ("regret", "%"))


def _number(value: float) -> str:
    return NOTHING if math.isnan(value) else f"{value:.2f}"


def _percent(value: float) -> str:
    """Return a share in percent, or that a run was lost."""
    if math.isnan(value):
        return NOTHING
    return "lost" if math.isinf(value) else f"{100.0 * value + 0.0:.0f}".replace("-0", "0")


def _span(ends: tuple[float, float]) -> str:
    return NOTHING if math.isnan(ends[0]) else f"{ends[0]:.2f}–{ends[1]:.2f}"


def _best_sentence(field: TransferField) -> str:
    """Return who costs least on the judge, and how closely they follow."""
    judge, order = field.options.judge, field.order[:3]
    means = {m: mean_costs(field.table_of(judge, m)) for m in ("cost", "d_rms_m", "sync_rms_m")}

    def told(name: str) -> str:
        cost, d_rms, sync = (float(values[field.names.index(name)]) for values in means.values())
        path = f"{1e3 * d_rms:.0f} mm from the path, {1e3 * sync:.0f} mm from the target"
        return f"{name} {cost:.2f} ({path})" if math.isfinite(cost) else f"{name} (lost)"

    return f"{field.label}: the least mean costs on {judge} are {', '.join(map(told, order))}."


def _plant_sentence(field: TransferField, plant: str) -> str:
    """Return whether a plant chooses the right controller for the judge, and what choosing by it costs."""
    judge, found = field.options.judge, field.agreement(plant)
    assert found is not None
    chosen, best = field.names[found.chosen], field.order[0]
    if found.regret <= 0.0:
        said = f"chooses {chosen}, the best on {judge}"
    elif math.isinf(found.regret):
        said = f"chooses {chosen}, which loses runs on {judge}; the best there is {best}"
    else:
        said = f"chooses {chosen}, which costs {_percent(found.regret)} % more on {judge} than the best, {best}"
    gap = field.usual_gap(plant)
    own = "" if math.isnan(gap) else f"; its costs are {abs(100.0 * gap):.0f} % {'lower' if gap < 0.0 else 'higher'}"
    return f"{field.label}: {plant} {said} (tau {_number(found.tau)}, {_span(found.tau_interval)}){own}."


def _range(values: Sequence[float], write: Any) -> str:
    low, high = write(min(values)), write(max(values))
    return low if low == high else f"{low} to {high}"


def _agreed(field: TransferField, plants: Sequence[str], foreseeing: bool | None) -> str | None:
    """Return the range of correlation and regret of plants in words; None where there is no choice."""
    known = [a for a in (field.agreement(plant, foreseeing) for plant in plants) if a is not None and not math.isnan(a.tau)]
    if not known:
        return None
    taus, regrets = [a.tau for a in known], [a.regret for a in known]
    return f"tau {_range(taus, _number)}, regret {_range(regrets, _percent)} %"


def _prediction_sentences(field: TransferField) -> list[str]:
    """Return whether plants choose better among controllers that know their dead time."""
    knows, blind = (sum(known is kind for known in field.contenders.values()) for kind in (True, False))
    with_it, without = (_agreed(field, field.models, kind) for kind in (True, False))
    if with_it is None or without is None:
        return []
    some = f"among the {knows} controllers that know their dead time, plants choose with {with_it}"
    return [f"{field.label}: {some}; among the {blind} others, with {without}."]


def _lost_sentences(field: TransferField) -> list[str]:
    """Return who lost runs where."""
    said = [
        f"{plant} {', '.join(f'{name} {n}' for name, n in field.lost(plant).items())}"
        for plant in field.options.plant_names
        if field.lost(plant)
    ]
    runs = len(field.drives) * field.options.seeds
    return [f"{field.label}: lost runs of {runs}: {'; '.join(said)}."] if said else []
