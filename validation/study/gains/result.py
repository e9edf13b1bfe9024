"""The result of a gains study: its tables, its picture and its files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from validation.show.tables import NOTHING, Cell, Grid
from validation.study.gains.findings import GainScores
from validation.study.result import StudyResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MEASURES = (("cost", "Cost (Sec. 4.3.3)", "", 1.0, 2), ("d_rms_m", "d_rms", "mm", 1e3, 1))
"""Field, title, unit, scale and digits of each measure that has a table."""


@dataclass(frozen=True)
class GainStudy(GainScores, StudyResult):
    """The cost of every shipped set of gains on every named reference."""

    study = "gains"
    title = "Gains"

    def grids(self) -> list[Grid]:
        """Return cost and d_rms of every set by reference, for each plant."""
        return [self._grid(plant, k) for plant in self.options.plants for k in range(len(_MEASURES))]

    def figure(self) -> Figure:
        """Return the picture of the study, drawn anew."""
        from validation.study.gains.figure import draw_gains

        return draw_gains(self)

    def findings(self) -> dict[str, Any]:
        """Return seeds, plants and all scores."""
        o = self.options
        return {
            "profile": self.profile,
            "seeds": list(range(o.seed, o.seed + o.seeds)),
            "plants": list(o.plants),
            "scores": [vars(s) for s in self.scores],
        }

    def _grid(self, plant: str, measure: int) -> Grid:
        """Return one measure of every set by reference; the least of each row is emphasised."""
        name, title, unit, scale, digits = _MEASURES[measure]
        rows, every = [], dict[str, list[float | None]]()
        for label, scores in self.by_reference(plant):
            values: list[float | None] = [getattr(s, name) for s in scores]
            least = min((v for v in values if v is not None), default=None)
            texts = ["lost" if v is None else f"{scale * v:.{digits}f}" for v in values]
            rows.append((Cell(label), *(Cell(text, v == least) for text, v in zip(texts, values, strict=True))))
            for s, v in zip(scores, values, strict=True):
                every.setdefault(s.gains, []).append(v)
        means = []
        for values in every.values():
            known = [v for v in values if v is not None]
            means.append(Cell(f"{scale * np.mean(known):.{digits}f}" if len(known) == len(values) else NOTHING))
        rows.append((Cell("mean"), *means))
        header = (("reference", ""), *((" ".join(n.rsplit("-", 1)), unit) for n in self.sets))
        return Grid(header, (tuple(rows),), 1, f"{title}, plant {plant}; {self.heading()}")
