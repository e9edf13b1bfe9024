"""The result of a contact study: every variant's measures, and how each measure is shown and judged."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from validation.show.tables import DEGREES, MILLIMETRES, NOTHING, Cell, Grid, Unit
from validation.study.contact.bench import PUBLISHED_MODELS, SCENARIOS, Measures, TriedVariant
from validation.study.contact.variants import BASELINE
from validation.study.result import StudyResult

SPOT, PATHS, REST = (
    "Turning on the spot",
    "Straight ahead, at rest, and on trajectories",
    "Against the recording, and processor time",
)
"""Titles of the tables."""


@dataclass(frozen=True)
class MeasureColumn:
    """One measure, as tables and picture show it."""

    name: str
    """Heading of the column."""
    unit: Unit
    """Unit in which it is shown."""
    value: Callable[[Measures], float | None]
    """Function that takes it from the measures [SI]."""
    limits: tuple[float, float] | None
    """Value up to which it is good, and value from which on it is bad [SI]; None for a measure that is not judged."""
    table: str
    """Title of the table that has it."""
    meaning: str
    """Explanation in a few words."""

    def text(self, measures: Measures) -> str:
        """Return the measure as it is written, without its unit."""
        value = self.value(measures)
        return NOTHING if value is None else self.unit.text(value)


_PERCENT, _CM, _Column = Unit("%", 1e2, 1), Unit("cm", 1e2, 1), MeasureColumn

MEASURE_COLUMNS = (
    _Column("multiplier", Unit("1", 1.0, 3), lambda m: m.multiplier, None, SPOT,
            "yaw rate that the wheels ask for over that of the body, turning on the spot"),
    _Column("off closed form", _PERCENT, lambda m: m.multiplier_error, (0.01, 0.4), SPOT,
            "deviation of the multiplier from its closed form"),
    _Column("ripple", _PERCENT, lambda m: m.ripple, (0.01, 1.0), SPOT, "range of the yaw rate on the spot over its mean"),
    _Column("lifted", _PERCENT, lambda m: m.lifted_share, (0.005, 0.5), SPOT,
            "share of the time on the spot in which a wheel is off the ground"),
    _Column("glide", _PERCENT, lambda m: m.glide, (0.02, 1.0), SPOT,
            "greatest speed of the robot's middle on the spot over that of the wheels' rims"),
    _Column("wander", _CM, lambda m: m.wander_m, (0.01, 0.6), SPOT,
            "greatest distance of the robot's middle from its first place in 36 s of turning on the spot"),
    _Column("drift", _CM, lambda m: m.drift_m, (0.001, 0.06), SPOT,
            "distance of the robot's middle from its place after a whole turn, mean"),
    _Column("veer", Unit("mm/m", 1e3, 1), lambda m: m.veer, (0.001, 0.03), PATHS,
            "deviation to the left on a straight drive"),
    _Column("creep", Unit("mm/s", 1e3, 2), lambda m: m.creep_m_s, (1e-4, 5e-3), PATHS,
            "sideways speed at rest on a slope of 8°"),
    _Column("surge", _PERCENT, lambda m: m.surge, (0.02, 0.4), PATHS,
            "greatest speed on trajectory 3 above the speed that the wheels ask for"),
    _Column("ground turned", MILLIMETRES, lambda m: m.turned_ground_m, (0.005, 1.0), PATHS,
            "distance that the end of trajectory 3 moves if the ground is turned by 45°"),
    _Column("step halved", MILLIMETRES, lambda m: m.halving_m, (0.01, 0.5), PATHS,
            "distance that the end of trajectory 4 moves if the physics step is halved"),
    _Column("to improved", MILLIMETRES, lambda m: m.d_rms_mean("improved"), (0.025, 0.5), PATHS,
            "d_rms from the improved model, mean over trajectories 1–4"),
    _Column("to coulomb", MILLIMETRES, lambda m: m.d_rms_mean("coulomb"), (0.035, 0.5), PATHS,
            "d_rms from the Coulomb model, mean over trajectories 1–4"),
    _Column("to linear", MILLIMETRES, lambda m: m.d_rms_mean("linear"), (0.025, 0.5), PATHS,
            "d_rms from the linear model, mean over trajectories 1–4"),
    _Column("recording", MILLIMETRES, lambda m: m.recording_position_m, (0.045, 0.3), REST,
            "median error of the relative position after 6 s against the recording"),
    _Column("recording yaw", DEGREES, lambda m: m.recording_yaw_rad, (0.035, 0.3), REST,
            "median error of the relative yaw after 6 s against the recording"),
    _Column("step", Unit("µs", 1e6, 0), lambda m: m.cost_s, None, REST, "processor time of a physics step"),
)  # fmt: skip
"""Every measure, in the order of tables."""


@dataclass(frozen=True, eq=False)
class ContactStudy(StudyResult):
    """The effect of physics settings on the simulated robot."""

    schema = "ssmr.study.contact/1"
    study = "contact"
    title = "Physics settings"
    profile: str
    """Name of the lab robot's profile."""
    recording: str | None
    """Name of the recording; None for none."""
    recording_profile: str | None
    """Name of the recorded robot's profile; None without a recording."""
    tried: tuple[TriedVariant, ...]
    """Variants with their measures, the baseline first."""

    def by_group(self) -> dict[str, list[TriedVariant]]:
        """Return the variants by group, in order."""
        groups: dict[str, list[TriedVariant]] = {}
        for tried in self.tried:
            groups.setdefault(tried.variant.group, []).append(tried)
        return groups

    def columns(self) -> tuple[MeasureColumn, ...]:
        """Return the columns in which at least one variant has a number."""
        return tuple(c for c in MEASURE_COLUMNS if any(c.value(t.measures) is not None for t in self.tried))

    def heading(self) -> str:
        """Return what was studied, in one line."""
        text = f"{len(self.tried)} settings, {self.of_profile(self.profile)}"
        return text if self.recording is None else f"{text}; recording with profile {self.recording_profile}"

    def notes(self) -> list[str]:
        """Return a sentence for each measure that could not be taken."""
        return [f"{t.variant.key}: {what} failed: {why}." for t in self.tried for what, why in t.failures.items()]

    def grids(self) -> list[Grid]:
        """Return the measures by variant, in three tables."""
        return [self._measure_grid(title) for title in (SPOT, PATHS, REST)]

    def report_grids(self) -> list[Grid]:
        """Return the tables of the terminal, and d_rms by published model and trajectory."""
        return [*self.grids(), self._model_grid()]

    def explanations(self) -> list[str]:
        """Return what each column means."""
        return [f"{c.name}: {c.meaning}" for c in self.columns()]

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
