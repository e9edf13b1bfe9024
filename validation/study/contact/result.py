"""The result of a contact study: its tables, its picture and its files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

from validation.show.tables import MILLIMETRES, NOTHING, Cell, Grid
from validation.study.contact.bench import PUBLISHED_MODELS, SCENARIOS, TriedVariant
from validation.study.contact.findings import MEASURE_COLUMNS, PATHS, REST, SPOT, ContactFindings
from validation.study.contact.variants import BASELINE
from validation.study.result import StudyResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class ContactStudy(ContactFindings, StudyResult):
    """The effect of physics settings on the simulated Husky."""

    schema = "ssmr.study.contact/1"
    study = "contact"
    title = "Physics settings"

    def grids(self) -> list[Grid]:
        """Return the measures by variant, in three tables."""
        return [self._measure_grid(title) for title in (SPOT, PATHS, REST)]

    def report_grids(self) -> list[Grid]:
        """Return the tables of the terminal, and d_rms by published model and trajectory."""
        return [*self.grids(), self._model_grid()]

    def explanations(self) -> list[str]:
        """Return what each column means."""
        return [f"{c.name}: {c.meaning}" for c in self.columns()]

    def figure(self) -> Figure:
        """Return the picture of the study, drawn anew."""
        from validation.study.contact.figure import draw_contact

        return draw_contact(self)

    def findings(self) -> dict[str, Any]:
        """Return limits, and each variant's settings, measures and failures."""
        limits = {c.name: c.limits and {"good": c.limits[0], "bad": c.limits[1]} for c in MEASURE_COLUMNS}
        return {
            "profile": self.profile,
            "recording": self.recording,
            "recording_profile": self.recording_profile,
            "baseline": BASELINE.key,
            "limits": limits,
            "variants": [
                {
                    "group": t.variant.group,
                    "name": t.variant.name,
                    "settings": {k: v for k, v in asdict(t.variant.settings).items() if v is not None},
                    "calibration": dict(t.variant.changes),
                    **asdict(replace(t.measures, d_rms_m={m: dict(d) for m, d in t.measures.d_rms_m.items()})),
                    "multiplier_error": t.measures.multiplier_error,
                    "failures": dict(t.failures),
                }
                for t in self.tried
            ],
        }

    def _measure_grid(self, title: str) -> Grid:
        columns = [c for c in self.columns() if c.table == title]
        header = (("setting", ""), *((c.name, c.unit.symbol) for c in columns))
        shown = f"{title}, {self.heading()}" if title == SPOT else title
        return self._grouped(header, lambda t: [c.text(t.measures) for c in columns], shown)

    def _model_grid(self) -> Grid:
        """Return d_rms to every published model on every trajectory."""
        places = [(model, name) for model in PUBLISHED_MODELS for name in SCENARIOS]
        header = (("setting", ""), *((f"{model} {name.removeprefix('traj')}", "mm") for model, name in places))

        def texts(tried: TriedVariant) -> list[str]:
            values = [tried.measures.d_rms_m.get(model, {}).get(name) for model, name in places]
            return [NOTHING if v is None else MILLIMETRES.text(v) for v in values]

        return self._grouped(header, texts, "d_rms from the published models")

    def _grouped(
        self, header: Sequence[tuple[str, str]], texts: Callable[[TriedVariant], Sequence[str]], title: str
    ) -> Grid:
        groups = []
        for group, tried in self.by_group().items():
            rows = [(Cell(group, best=True), *(Cell("") for _ in header[1:]))]
            rows += [(Cell(f"  {t.variant.name}"), *map(Cell, texts(t))) for t in tried]
            groups.append(tuple(rows))
        return Grid(tuple(header), tuple(groups), 1, title)
