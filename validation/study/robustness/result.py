"""The result of a robustness study: its tables, its picture and its files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from validation.bench.mismatch import NOMINAL, WORST, Mismatch, spread
from validation.report.tables import MILLIMETRES, Cell, Grid, judged_cells
from validation.study.result import StudyResult
from validation.study.robustness.cases import CaseKind, RobustnessCase, RobustnessOptions
from validation.study.robustness.outcomes import ControllerRuns, RunErrors


@dataclass(frozen=True, eq=False)
class Robustness(StudyResult):
    """The errors of each controller on robots that differ from its profile."""

    study = "robustness"
    title = "Robustness"
    profile: str
    """Name of the profile."""
    parameters: Mapping[str, Any]
    """Parameters of the profile's MuJoCo robot."""
    reference: str
    """Name of the reference."""
    speed: float
    """Mean speed of the reference [m/s]."""
    duration: float
    """Duration of one run [s]."""
    options: RobustnessOptions
    """Options of the study."""
    cases: tuple[RobustnessCase, ...]
    """Runs that every set of gains made."""
    controllers: Mapping[str, ControllerRuns]
    """Runs by the name of the set of gains, such as `pid-tuned`; by any names if the user gave the sets."""
    remarks: tuple[str, ...] = ()
    """Remarks on the choice of gains."""

    def errors(self, controller: str, kind: CaseKind, mismatch: Mismatch | None = None) -> list[RunErrors]:
        """Return a controller's errors in cases of one kind, all of them or those with one mismatch."""
        pairs = zip(self.cases, self.controllers[controller].errors, strict=True)
        return [e for c, e in pairs if c.kind == kind and mismatch in (None, c.mismatch)]

    def failures(self, errors: Sequence[RunErrors]) -> int:
        """Return how many runs failed."""
        return sum(e.failed(self.options.bound) for e in errors)

    @property
    def drawn(self) -> int:
        """Number of robots that were drawn."""
        return sum(c.kind == "drawn" for c in self.cases)

    @property
    def single(self) -> list[Mismatch]:
        """The mismatches that were tried alone."""
        return list(dict.fromkeys(c.mismatch for c in self.cases if c.kind == "alone"))

    def heading(self) -> str:
        """Return what was studied, in one line."""
        return (
            f"{self.of_profile(self.profile)}, {self.reference} at {self.speed:.3g} m/s: {len(self.cases)} runs of each set "
            f"of gains, {self.drawn} of them with robots drawn at random; seed {self.options.seed}"
        )

    def notes(self) -> list[str]:
        """Return sentences on controllers whose wheel loads are not smooth or whose gains are missing."""
        unhealthy = [
            f"{name}: {found.health.advice.split(':')[0]}, already with the nominal robot."
            for name, found in self.controllers.items()
            if not found.health.ok
        ]
        return [*self.remarks, *unhealthy]

    def grids(self) -> list[Grid]:
        """Return the spread of errors over the drawn robots."""
        return [self._spread_grid()]

    def report_grids(self) -> list[Grid]:
        """Return that table, and d_rms under each mismatch alone, for which a terminal is too narrow."""
        return [*self.grids(), self._alone_grid()]

    def findings(self) -> dict[str, Any]:
        """Return options, levels, cases, and for each controller its spread, failures and single runs."""
        o = self.options
        names = ("runs", "seeds", "bound", "feedback", "disturbance", "timestep")
        return {
            "profile": self.profile,
            "reference": self.reference,
            "speed_m_s": self.speed,
            "duration_s": self.duration,
            "seed": o.seed,
            "options": {name: getattr(o, name) for name in names},
            "position_period_s": o.position_period,
            "worst_share": WORST,
            "controllers": {name: self._of_controller(name) for name in self.controllers},
            "cases": [{"kind": c.kind, "seed": c.seed, **asdict(c.mismatch)} for c in self.cases],
            "parameters": dict(self.parameters),
        }

    def _of_controller(self, name: str) -> dict[str, Any]:
        runs, drawn = self.controllers[name], self.errors(name, "drawn")
        return {
            "controller": runs.gains.controller,
            "gains": runs.gains.name,
            "gain_values": dict(runs.gains.values),
            **self._summary(drawn),
            "lost": sum(e.lost_at_s is not None for e in drawn),
            "failure_rate": self.failures(drawn) / len(drawn),
            "nominal": self._summary(self.errors(name, "nominal")),
            "alone": {m.label: self._summary(self.errors(name, "alone", m)) for m in self.single},
            "health": runs.health.as_dict(),
            "runs": [asdict(e) for e in runs.errors],
        }

    def _summary(self, errors: Sequence[RunErrors]) -> dict[str, Any]:
        return {
            "n": len(errors),
            "d_rms_m": asdict(spread([e.d_rms_m for e in errors])),
            "e_rho_rms_m": asdict(spread([e.e_rho_rms_m for e in errors])),
            "failed": self.failures(errors),
        }

    def _spread_grid(self) -> Grid:
        """Return the errors over the drawn robots; the least of each controller's are emphasised."""
        groups = []
        for controller in dict.fromkeys(runs.gains.controller for runs in self.controllers.values()):
            mine = {
                name: self.errors(name, "drawn") for name, r in self.controllers.items() if r.gains.controller == controller
            }
            columns = []
            for values in ("d_rms_m", "e_rho_rms_m"):
                found = {name: asdict(spread([getattr(e, values) for e in errors])) for name, errors in mine.items()}
                for part in ("mean", "std", "cvar", "worst"):
                    texts = {name: MILLIMETRES.text(of[part]) for name, of in found.items()}
                    columns.append(judged_cells(texts, {name: of[part] for name, of in found.items()}, "low"))
            rows = []
            for k, (name, errors) in enumerate(mine.items()):
                lost = sum(e.lost_at_s is not None for e in errors)
                own = self.controllers[name].gains.name.removeprefix(f"{controller}-")
                counts = [Cell(str(count)) for count in (lost, self.failures(errors))]
                rows.append((Cell("" if k else controller), Cell(own), *(column[name] for column in columns), *counts))
            groups.append(tuple(rows))
        parts = ("mean", "std", "CVaR", "worst")
        spreads = [(f"{what} {part}", MILLIMETRES.symbol) for what in ("d_rms", "e_rho") for part in parts]
        header = (("controller", ""), ("gains", ""), *spreads, ("lost", ""), ("failed", ""))
        caption = (
            f"Over the {self.drawn} drawn robots: d_rms, distance from the reference to the robot's path; e_rho, root mean "
            "square of how far the moving target is ahead; CVaR, mean of the worst fifth. "
            f"Failed: lost, or one of the two greater than {self.options.bound:g} m."
        )
        return Grid(header, tuple(groups), 2, f"Robustness, {self.heading()}", caption)

    def _alone_grid(self) -> Grid:
        """Return the mean of d_rms over seeds, and how many of them failed, by mismatch and set of gains."""

        def line(label: str, row: Sequence[list[RunErrors]]) -> tuple[Cell, ...]:
            cells = [Cell(label)]
            for errors in row:
                failures = self.failures(errors)
                mean = MILLIMETRES.text(float(np.mean([e.d_rms_m for e in errors])))
                cells.append(Cell(f"{failures}/{len(errors)} failed, {mean}" if failures else mean))
            return tuple(cells)

        header = (("mismatch", ""), *((name, MILLIMETRES.symbol) for name in self.controllers))
        nominal = line(NOMINAL, [self.errors(name, "nominal") for name in self.controllers])
        rows = tuple(line(m.label, [self.errors(name, "alone", m) for name in self.controllers]) for m in self.single)
        caption = f"Means over seeds of noise ({self.options.seeds}), and how many of them failed."
        return Grid(header, ((nominal,), rows), 1, "d_rms under each mismatch alone", caption)
