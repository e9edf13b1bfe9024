"""The result of a contact study: every variant's measures, and how each measure is shown and judged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from validation.report.tables import DEGREES, MILLIMETRES, NOTHING, Grid, Unit
from validation.study.contact.bench import PUBLISHED_MODELS, SCENARIOS
from validation.study.contact.variants import BASELINE
from validation.study.measured import MeasureColumn, MeasuredStudy, Tried

SPOT, PATHS, REST = (
    "Turning on the spot",
    "Straight ahead, at rest, and on trajectories",
    "Against the recording, and processor time",
)
"""Titles of the tables."""


_PERCENT, _CM, _Column = Unit("%", 1e2, 1), Unit("cm", 1e2, 1), MeasureColumn

MEASURE_COLUMNS = (
    _Column("multiplier", Unit("1", 1.0, 3), lambda m: m.multiplier, SPOT,
            "yaw rate that the wheels ask for over that of the body, turning on the spot"),
    _Column("off closed form", _PERCENT, lambda m: m.multiplier_error, SPOT,
            "deviation of the multiplier from its closed form", (0.01, 0.4)),
    _Column("ripple", _PERCENT, lambda m: m.ripple, SPOT, "range of the yaw rate on the spot over its mean", (0.01, 1.0)),
    _Column("lifted", _PERCENT, lambda m: m.lifted_share, SPOT,
            "share of the time on the spot in which a wheel is off the ground", (0.005, 0.5)),
    _Column("glide", _PERCENT, lambda m: m.glide, SPOT,
            "greatest speed of the robot's middle on the spot over that of the wheels' rims", (0.02, 1.0)),
    _Column("wander", _CM, lambda m: m.wander_m, SPOT,
            "greatest distance of the robot's middle from its first place in 36 s of turning on the spot", (0.01, 0.6)),
    _Column("drift", _CM, lambda m: m.drift_m, SPOT,
            "distance of the robot's middle from its place after a whole turn, mean", (0.001, 0.06)),
    _Column("veer", Unit("mm/m", 1e3, 1), lambda m: m.veer, PATHS,
            "deviation to the left on a straight drive", (0.001, 0.03)),
    _Column("creep", Unit("mm/s", 1e3, 2), lambda m: m.creep_m_s, PATHS,
            "sideways speed at rest on a slope of 8°", (1e-4, 5e-3)),
    _Column("surge", _PERCENT, lambda m: m.surge, PATHS,
            "greatest speed on trajectory 3 above the speed that the wheels ask for", (0.02, 0.4)),
    _Column("ground turned", MILLIMETRES, lambda m: m.turned_ground_m, PATHS,
            "distance that the end of trajectory 3 moves if the ground is turned by 45°", (0.005, 1.0)),
    _Column("step halved", MILLIMETRES, lambda m: m.halving_m, PATHS,
            "distance that the end of trajectory 4 moves if the physics step is halved", (0.01, 0.5)),
    _Column("to improved", MILLIMETRES, lambda m: m.d_rms_mean("improved"), PATHS,
            "d_rms from the improved model, mean over trajectories 1–4", (0.025, 0.5)),
    _Column("to coulomb", MILLIMETRES, lambda m: m.d_rms_mean("coulomb"), PATHS,
            "d_rms from the Coulomb model, mean over trajectories 1–4", (0.035, 0.5)),
    _Column("to linear", MILLIMETRES, lambda m: m.d_rms_mean("linear"), PATHS,
            "d_rms from the linear model, mean over trajectories 1–4", (0.025, 0.5)),
    _Column("recording", MILLIMETRES, lambda m: m.recording_position_m, REST,
            "median error of the relative position after 6 s against the recording", (0.045, 0.3)),
    _Column("recording yaw", DEGREES, lambda m: m.recording_yaw_rad, REST,
            "median error of the relative yaw after 6 s against the recording", (0.035, 0.3)),
    _Column("step", Unit("µs", 1e6, 0), lambda m: m.cost_s, REST, "processor time of a physics step"),
)  # fmt: skip
"""Every measure, in the order of tables."""


@dataclass(frozen=True, eq=False)
class ContactStudy(MeasuredStudy):
    """The effect of physics settings on the simulated robot; the baseline is tried first."""

    schema = "ssmr.study.contact/1"
    study = "contact"
    title = "Physics settings"
    all_columns = MEASURE_COLUMNS

    def report_grids(self) -> list[Grid]:
        """Return the tables of the terminal, and d_rms by published model and trajectory."""
        places = [(model, name) for model in PUBLISHED_MODELS for name in SCENARIOS]

        def texts(tried: Tried) -> list[str]:
            values = [tried.measures.d_rms_m.get(model, {}).get(name) for model, name in places]
            return [NOTHING if v is None else MILLIMETRES.text(v) for v in values]

        header = [(f"{model} {name.removeprefix('traj')}", "mm") for model, name in places]
        return [*self.grids(), self.grouped(header, texts, "d_rms from the published models")]

    def findings(self) -> dict[str, Any]:
        """Return limits, and each variant's settings, measures and failures."""
        limits = {c.name: c.limits and {"good": c.limits[0], "bad": c.limits[1]} for c in MEASURE_COLUMNS}
        return {**super().findings(), "baseline": BASELINE.key, "limits": limits}

    def found_of(self, tried: Tried) -> dict[str, Any]:
        """Return what study.json holds of a variant."""
        return {**super().found_of(tried), "multiplier_error": tried.measures.multiplier_error}
