"""The result of a robustness study: its tables, its picture and its files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

from validation.show.tables import MILLIMETRES, Cell, Grid
from validation.study.result import StudyResult
from validation.study.robustness.cases import (
    LEVELS,
    NOMINAL,
    CaseKind,
    Levels,
    Mismatch,
    RobustnessCase,
    RobustnessOptions,
    full_grid,
    single_mismatches,
)
from validation.study.robustness.outcomes import CVAR_LEVEL, ControllerRuns, RunErrors, spread


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
    torque: float
    """Greatest torque of a wheel that the reference needs [N m]."""
    options: RobustnessOptions
    """Options of the study."""
    cases: tuple[RobustnessCase, ...]
    """Runs that every controller made."""
    controllers: Mapping[str, ControllerRuns]
    """Runs by controller."""
    remarks: tuple[str, ...] = ()
    """Remarks on the choice of gains."""
    levels: Levels = field(default_factory=lambda: LEVELS)
    """Values that were tried, by field of `Mismatch`."""

    def errors(self, controller: str, kind: CaseKind, mismatch: Mismatch | None = None) -> list[RunErrors]:
        """Return a controller's errors in cases of one kind, all of them or those with one mismatch."""
        pairs = zip(self.cases, self.controllers[controller].errors, strict=True)
        return [e for c, e in pairs if c.kind == kind and mismatch in (None, c.mismatch)]

    def failures(self, errors: Sequence[RunErrors]) -> int:
        """Return how many runs failed."""
        return sum(e.failed(self.options.bound) for e in errors)

    @property
    def combined(self) -> int:
        """Number of runs with a combination of mismatches."""
        return sum(c.kind == "grid" for c in self.cases)

    def heading(self) -> str:
        """Return what was studied, in one line."""
        return (
            f"{self.of_profile(self.profile)}, {self.reference} at {self.speed:.3g} m/s: "
            f"{len(self.cases)} runs of each controller, {self.combined} of them from {len(full_grid())} combinations; "
            f"seed {self.options.seed}"
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
        """Return the spread of errors over combinations, and both errors under each mismatch alone."""
        explained = (
            f"Means over {self.options.seeds} seeds of noise, and how many of them failed. Torque: share of the "
            f"{self.torque:.0f} N m a wheel that the reference needs without feedback."
        )
        alone = self._alone_grid("d_rms_m", "d_rms under each mismatch alone", "")
        return [self._spread_grid(), alone, self._alone_grid("e_rho_rms_m", "e_rho under each mismatch alone", explained)]

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
            "reference_torque_N_m": self.torque,
            "cvar_level": CVAR_LEVEL,
            "levels": dict(self.levels),
            "controllers": {name: self._of_controller(name) for name in self.controllers},
            "cases": [{"kind": c.kind, "seed": c.seed, **asdict(c.mismatch)} for c in self.cases],
            "parameters": dict(self.parameters),
        }

    def _of_controller(self, name: str) -> dict[str, Any]:
        runs, grid = self.controllers[name], self.errors(name, "grid")
        return {
            "gains": runs.gains.name,
            "gain_values": dict(runs.gains.values),
            **self._summary(grid),
            "lost": sum(e.lost_at_s is not None for e in grid),
            "failure_rate": self.failures(grid) / len(grid),
            "nominal": self._summary(self.errors(name, "nominal")),
            "alone": {m.label: self._summary(self.errors(name, "alone", m)) for m in single_mismatches(self.levels)},
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
        rows = []
        for name, runs in self.controllers.items():
            grid = self.errors(name, "grid")
            both = spread([e.d_rms_m for e in grid]), spread([e.e_rho_rms_m for e in grid])
            numbers = [MILLIMETRES.text(value) for found in both for value in asdict(found).values()]
            shares = (sum(e.lost_at_s is not None for e in grid), self.failures(grid))
            percent = [f"{100.0 * share / len(grid):.0f}" for share in shares]
            rows.append(tuple(map(Cell, (name, runs.gains.name.removeprefix(f"{name}-"), *numbers, *percent))))
        parts = ("mean", "std", "CVaR", "worst")
        errors = [(f"{what} {part}", MILLIMETRES.symbol) for what in ("d_rms", "e_rho") for part in parts]
        header = (("controller", ""), ("gains", ""), *errors, ("lost", "%"), ("failed", "%"))
        caption = (
            "Over the drawn combinations of mismatches: d_rms, distance from the reference to the robot's path; e_rho, root "
            "mean square of how far the moving target is ahead; CVaR, mean of the worse half. "
            f"Failed: lost, or one of the two greater than {self.options.bound:g} m."
        )
        return Grid(header, (tuple(rows),), 2, f"Robustness, {self.heading()}", caption)

    def _alone_grid(self, name: Literal["d_rms_m", "e_rho_rms_m"], title: str, caption: str) -> Grid:
        """Return the mean of an error over seeds, and how many of them failed, by mismatch and controller."""
        nominal = {c: self.errors(c, "nominal") for c in self.controllers}
        single = {m: {c: self.errors(c, "alone", m) for c in self.controllers} for m in single_mismatches(self.levels)}

        def line(label: str, row: Mapping[str, list[RunErrors]]) -> tuple[Cell, ...]:
            cells = [Cell(label)]
            for errors in row.values():
                failures = self.failures(errors)
                mean = MILLIMETRES.text(float(np.mean([getattr(e, name) for e in errors])))
                cells.append(Cell(f"{failures}/{len(errors)} failed, {mean}" if failures else mean))
            return tuple(cells)

        header = (("mismatch", ""), *((c, MILLIMETRES.symbol) for c in self.controllers))
        rows = tuple(line(m.label, row) for m, row in single.items())
        return Grid(header, ((line(NOMINAL, nominal),), rows), 1, title, caption)
