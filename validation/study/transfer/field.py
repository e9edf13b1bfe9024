"""The findings with one profile: costs of every controller on every plant, and how plants agree on them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ssmr.types import FloatArray
from validation.report.tables import with_robot
from validation.study.scores import FollowedScore
from validation.study.transfer.comparison import (
    RESAMPLES,
    Agreement,
    agreement,
    choice,
    mean_costs,
    places,
    rank_correlation,
)
from validation.study.transfer.contenders import TransferOptions


@dataclass(frozen=True)
class TransferDrive:
    """One reference, which every controller followed on every plant."""

    profile: str
    """Name of the profile."""
    reference: str
    """Name of the reference."""
    speed: float
    """Mean speed along it [m/s]."""
    scores: Mapping[str, Mapping[str, FollowedScore]]
    """Scores by plant and controller."""

    @property
    def label(self) -> str:
        """Reference and speed."""
        return f"{self.reference} {self.speed:.2g}"


@dataclass(frozen=True, eq=False)
class TransferField:
    """All controllers on the references of one profile."""

    profile: str
    """Name of the profile."""
    robot: str
    """Name of its robot."""
    contenders: Mapping[str, bool | None]
    """Controllers with their gains by name: whether they know their dead time, as far as that is known."""
    gains: Mapping[str, Mapping[str, object] | None]
    """Names and numbers of their gains."""
    drives: tuple[TransferDrive, ...]
    """References that were driven."""
    options: TransferOptions
    """Options of the study."""

    @property
    def names(self) -> list[str]:
        """Names of the contenders, in order."""
        return list(self.contenders)

    @property
    def models(self) -> tuple[str, ...]:
        """Plants that are judged: all but the judge."""
        return self.options.plant_names[1:]

    @property
    def label(self) -> str:
        """Name of the profile, with its robot where that is not told by it."""
        return with_robot(self.profile, self.robot)

    def table_of(self, plant: str, measure: str = "cost") -> FloatArray:
        """Return the (R, C) values of a measure, a field of `FollowedScore`; infinite where the reference was lost."""
        rows = [[getattr(drive.scores[plant][name], measure) for name in self.names] for drive in self.drives]
        return np.array([[math.inf if value is None else value for value in row] for row in rows])

    def lost(self, plant: str) -> dict[str, int]:
        """Return the numbers of lost runs by contender, without those that lost none."""
        sums = {name: sum(drive.scores[plant][name].lost for drive in self.drives) for name in self.names}
        return {name: n for name, n in sums.items() if n}

    def agreement(self, plant: str, foreseeing: bool | None = None) -> Agreement | None:
        """Return the agreement of a plant with the judge, among all contenders or those that (do not) know their dead time.

        None where there are not two of them.
        """
        return self._agreements[plant, foreseeing]

    @cached_property
    def _agreements(self) -> dict[tuple[str, bool | None], Agreement | None]:
        every: dict[tuple[str, bool | None], Agreement | None] = {}
        labels, truth = [drive.reference for drive in self.drives], self.table_of(self.options.judge)
        for foreseeing in (None, True, False):
            some = [k for k, knows in enumerate(self.contenders.values()) if foreseeing in (None, knows)]
            for plant in self.options.plant_names:
                own = self.table_of(plant)[:, some]
                draws = RESAMPLES if foreseeing is None and plant != self.options.judge else 0
                two = len(some) > 1
                every[plant, foreseeing] = agreement(own, truth[:, some], labels, self.options.seed, draws) if two else None
        return every

    def gap(self, plant: str) -> dict[str, float]:
        """Return each contender's mean cost on a plant over that on the judge, less 1; NaN where a reference was lost."""
        own, truth = self.table_of(plant), self.table_of(self.options.judge)
        ratios = mean_costs(own) / mean_costs(truth) - 1.0
        kept = np.isfinite(own).all(axis=0) & np.isfinite(truth).all(axis=0)
        return dict(zip(self.names, np.where(kept, ratios, np.nan).tolist(), strict=True))

    def usual_gap(self, plant: str) -> float:
        """Return the median of the gaps of a plant; NaN where every contender lost a reference."""
        known = [gap for gap in self.gap(plant).values() if not math.isnan(gap)]
        return float(np.median(known)) if known else math.nan

    @cached_property
    def order(self) -> list[str]:
        """Names of the contenders as the judge places them, the best first."""
        place = places(self.table_of(self.options.judge))
        return [self.names[k] for k in np.lexsort((np.arange(len(place)), place))]

    def winner(self, plant: str, drive: int | None = None) -> str:
        """Return the contender that a plant chooses, over all references or on one of them."""
        rows = slice(None) if drive is None else slice(drive, drive + 1)
        return self.names[choice(self.table_of(plant)[rows], self.table_of(self.options.judge)[rows])]

    def as_dict(self) -> dict[str, Any]:
        """Return all that was found, plain."""
        return {
            "contenders": {name: {"foresees": knows, "gains": self.gains[name]} for name, knows in self.contenders.items()},
            "references": [{"name": drive.reference, "speed_m_s": drive.speed} for drive in self.drives],
            "plants": {plant: self._of_plant(plant) for plant in self.options.plant_names},
        }

    def _of_plant(self, plant: str) -> dict[str, Any]:
        def agreed(foreseeing: bool | None) -> dict[str, Any] | None:
            found = self.agreement(plant, foreseeing)
            some = [name for name, knows in self.contenders.items() if foreseeing in (None, knows)]
            return None if found is None else {**asdict(found), "chosen": some[found.chosen]}

        table, lost, gaps, place = self.table_of(plant), self.lost(plant), self.gap(plant), places(self.table_of(plant))
        means = {m: mean_costs(self.table_of(plant, m)).tolist() for m in ("cost", "d_rms_m", "sync_rms_m")}
        return {
            **{key: agreed(knows) for key, knows in (("all", None), ("foreseeing", True), ("others", False))},
            "lost": sum(lost.values()),
            "tau_with": {name: rank_correlation(table, self.table_of(name)) for name in self.options.plant_names},
            "winners": [self.winner(plant, k) for k in range(len(self.drives))],
            "contenders": {
                name: {
                    **{m: values[k] for m, values in means.items()},
                    "gap": gaps[name],
                    "place": 1 + int(place[k]),
                    "lost": lost.get(name, 0),
                    "by_reference": [asdict(drive.scores[plant][name]) for drive in self.drives],
                }
                for k, name in enumerate(self.names)
            },
        }
