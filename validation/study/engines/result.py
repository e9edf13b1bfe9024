"""The result of a study of engines: its table, its picture and its files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from validation.report.tables import DEGREES, MILLIMETRES, NEWTONS, PERCENT, Unit
from validation.study.contact.bench import SCENARIOS
from validation.study.engines.bench import TriedEngine
from validation.study.measured import MeasureColumn, MeasuredStudy, Tried

_TURN, _REST = "Turning on the spot at given wheel rates", "At rest, sliding, on trajectories and on the recording"


_ONE, _Column = Unit("1", 1.0, 3), MeasureColumn
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
class EnginesStudy(MeasuredStudy):
    """The same robot in several engines."""

    schema = "ssmr.study.engines/1"
    study = "engines"
    title = "Engines"
    all_columns = _COLUMNS
    tried: tuple[TriedEngine, ...]
    missing: tuple[str, ...]
    """A sentence for each engine that is not installed."""

    def notes(self) -> list[str]:
        """Return sentences on missing engines, on measures that could not be taken, and on what is no engine's own."""
        gazebo = "Gazebo itself was not run: its Husky's settings were given to the distribution's ODE."
        cone = "ODE has no friction cone; where one is emulated, the name says so."
        return [*(f"{line}." for line in self.missing), *super().notes(), gazebo, cone]

    def findings(self) -> dict[str, Any]:
        """Return what is missing, and each variant's settings, measures and failures."""
        seed = "ODE's quick solver shuffles its rows anew at each step; the seed is the number of the step"
        return {**super().findings(), "missing": list(self.missing), "seed": seed}

    def found_of(self, tried: Tried) -> dict[str, Any]:
        """Return what study.json holds of a variant."""
        assert isinstance(tried, TriedEngine)
        more = {"timestep_s": tried.timestep, "multiplier_by_heading": tried.by_heading.tolist()}
        return {"engine": tried.variant.group, **super().found_of(tried), **more}
