"""The result of a study of engines: its table, its picture and its files."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

from validation.show.tables import DEGREES, MILLIMETRES, NEWTONS, NOTHING, PERCENT, Cell, Grid, Unit
from validation.study.contact.bench import SCENARIOS
from validation.study.engines.bench import EngineMeasures, TriedEngine
from validation.study.result import StudyResult

_TURN, _REST = "Turning on the spot at given wheel rates", "At rest, sliding, on trajectories and on the recording"


class _Column(NamedTuple):
    name: str
    unit: Unit
    value: Callable[[EngineMeasures], float | None]
    table: str
    meaning: str


_ONE = Unit("1", 1.0, 3)
_COLUMNS = (
    _Column("multiplier", _ONE, lambda m: m.multiplier, _TURN,
            "yaw rate that the wheels suggest over that of the body, over the whole turn"),
    _Column("cone", _ONE, lambda m: m.multiplier_expected, _TURN,
            "closed form with Coulomb's friction cone for these wheels and this centre of mass"),
    _Column("least", _ONE, lambda m: m.multiplier_low, _TURN, "least multiplier over a sector of 15° of the heading"),
    _Column("most", _ONE, lambda m: m.multiplier_high, _TURN, "greatest multiplier over a sector of 15° of the heading"),
    _Column("wander", Unit("cm", 1e2, 1), lambda m: m.wander_m, _TURN,
            "greatest distance of the robot's middle from its first place within 14 s"),
    _Column("cone's", Unit("cm", 1e2, 1), lambda m: m.wander_expected_m, _TURN, "what the closed form has for the wander"),
    _Column("lifted", PERCENT, lambda m: m.lifted_share, _TURN, "share of the time in which a wheel is off the ground"),
    _Column("loads", NEWTONS, lambda m: m.load_sum_rms_n, _TURN,
            "root mean square deviation of the loads' sum from the weight"),
    _Column("gave up", PERCENT, lambda m: m.gave_up_share, _TURN, "share of steps in which the solver said that it gave up"),
    _Column("step", Unit("µs", 1e6, 0), lambda m: m.step_s, _TURN,
            "processor time of a physics step with the Python loop around it (MuJoCo's loop is compiled)"),
    _Column("creep", Unit("mm/s", 1e3, 3), lambda m: m.creep_m_s, _REST,
            "speed down a slope of 8° with locked wheels, the greater of two headings"),
    _Column("slide", _ONE, lambda m: m.slide_ratio, _REST, "distance of a slide to a stop over v²/2μg"),
    _Column("aside", DEGREES, lambda m: m.slide_aside_rad, _REST, "how far that slide goes to a side of its first velocity"),
    _Column("energy", PERCENT, lambda m: m.energy_error, _REST,
            "power of the motors in a slow turn over what friction on a cone takes, less 1"),
    _Column("step halved", MILLIMETRES, lambda m: m.halving_m, _REST,
            "distance that the end of trajectory 4 moves if the physics step is halved"),
    _Column("surge", PERCENT, lambda m: m.surge, _REST,
            "greatest speed on trajectory 3, at either of two headings, over the speed that its wheels suggest, less 1"),
    *(_Column(f"to improved {k}", MILLIMETRES, lambda m, name=name: m.d_rms_m.get(name), _REST,  # type: ignore[misc]
              f"d_rms from the improved model on trajectory {k}") for k, name in enumerate(SCENARIOS, 1)),
    _Column("wheels", MILLIMETRES, lambda m: m.wheels_m, _REST,
            "median error of the relative position after 6 s against the recording, driven with its wheel rates"),
    _Column("commands", MILLIMETRES, lambda m: m.commands_m, _REST, "as wheels, driven with its commands"),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class EnginesStudy(StudyResult):
    """The same robot in several engines."""

    schema = "ssmr.study.engines/1"
    study = "engines"
    title = "Engines"
    profile: str
    """Name of the lab robot's profile."""
    recording: str | None
    """Name of the recording; None for none."""
    recording_profile: str | None
    """Name of the recorded robot's profile; None without a recording."""
    tried: tuple[TriedEngine, ...]
    """Variants with their measures."""
    missing: tuple[str, ...]
    """A sentence for each engine that is not installed."""

    def heading(self) -> str:
        """Return what was studied, in one line."""
        text = f"{len(self.tried)} settings, {self.of_profile(self.profile)}"
        return text if self.recording is None else f"{text}; recording with profile {self.recording_profile}"

    def notes(self) -> list[str]:
        """Return sentences on missing engines, on measures that could not be taken, and on what is no engine's own."""
        failed = [f"{t.variant.key}: {what} failed: {why}." for t in self.tried for what, why in t.failures.items()]
        gazebo = "Gazebo itself was not run: its Husky's settings were given to the distribution's ODE."
        cone = "ODE has no friction cone; where one is emulated, the name says so."
        return [*(f"{line}." for line in self.missing), *failed, gazebo, cone]

    def grids(self) -> list[Grid]:
        """Return the measures by variant, in two tables."""
        return [self._measures_of(title) for title in (_TURN, _REST)]

    def explanations(self) -> list[str]:
        """Return what each column means."""
        return [f"{c.name}: {c.meaning}" for c in _COLUMNS]

    def findings(self) -> dict[str, Any]:
        """Return each variant's settings, measures and failures."""
        return {
            "profile": self.profile,
            "recording": self.recording,
            "recording_profile": self.recording_profile,
            "missing": list(self.missing),
            "seed": "ODE's quick solver shuffles its rows anew at each step; the seed is the number of the step",
            "variants": [
                {
                    "engine": t.variant.engine,
                    "name": t.variant.name,
                    "timestep_s": t.timestep,
                    "settings": {k: v for k, v in asdict(t.variant.settings).items() if v is not None},
                    "calibration": dict(t.variant.changes),
                    **asdict(replace(t.measures, d_rms_m=dict(t.measures.d_rms_m))),
                    "multiplier_by_heading": [m if math.isfinite(m) else None for m in t.by_heading.tolist()],
                    "failures": dict(t.failures),
                }
                for t in self.tried
            ],
        }

    def _measures_of(self, title: str) -> Grid:
        columns = [c for c in _COLUMNS if c.table == title]
        columns = [c for c in columns if any(c.value(t.measures) is not None for t in self.tried)]
        header = (("engine", ""), ("setting", ""), *((c.name, c.unit.symbol) for c in columns))
        groups: dict[str, list[tuple[Cell, ...]]] = {}
        for t in self.tried:
            values = [c.value(t.measures) for c in columns]
            texts = [NOTHING if v is None else c.unit.text(v) for c, v in zip(columns, values, strict=True)]
            row = (Cell(t.variant.engine), Cell(t.variant.name), *map(Cell, texts))
            groups.setdefault(t.variant.engine, []).append(row)
        shown = f"{title}, {self.heading()}" if title == _TURN else title
        return Grid(header, tuple(tuple(rows) for rows in groups.values()), 2, shown)
