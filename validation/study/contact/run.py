"""Physics settings one at a time from those shipped, and together as other simulators have them: what the Husky then does.

The thesis tried friction models, iterations, steps and contact layers of ODE in Gazebo (Sec. 3.7) and gave up. This repeats
its attempt with MuJoCo, with measures that a robot of four Coulomb contacts has to meet. docs/contact.md says what came out.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from ssmr.metrics.paths import horizon_windows
from validation import cli, store
from validation.robots.physics import PhysicsSettings
from validation.show.tables import DEGREES, NOTHING, Cell, Grid, Unit, markdown_table
from validation.study.contact.bench import (
    HORIZON,
    MODELS,
    SCENARIOS,
    UNDRIVEABLE,
    Bench,
    Measures,
    Outcome,
    Variant,
    make_variant,
    measure,
    step_time,
)

SCHEMA = "ssmr.study.contact/1"
BASELINE = Variant("shipped", "as shipped")
"""What everything is held against."""
ROUNDS = 5
"""How often the cost of a step is taken, all variants in turn."""

MUJOCO_IMPEDANCE = (0.9, 0.95, 0.001, 0.5, 2.0)
"""MuJoCo's default `solimp`."""
HARD_IMPEDANCE = (0.99, 0.999, 0.001, 0.5, 2.0)
HARD_REFERENCE = (0.004, 1.0)
"""`solimp` and `solref` of a contact as hard as a step of 1 to 2 ms lets it be."""
MAKER_NOW: Mapping[str, float | str] = {"com_x": -0.00065, "com_y": -0.085}
MAKER_EARLIER: Mapping[str, float | str] = {"com_x": -0.08748, "com_y": -0.00085}
"""Centres of mass of the maker's robot descriptions [m]."""


def _soft(at_no_depth: float) -> PhysicsSettings:
    """The shipped impedance, but for what it is at no depth."""
    return PhysicsSettings(solimp=(at_no_depth, 0.95, 0.005, 0.5, 2.0))


def _one_at_a_time() -> list[Variant]:
    default = PhysicsSettings(solimp=MUJOCO_IMPEDANCE)
    v, s = Variant, PhysicsSettings
    made = [v("cone", "pyramidal", s(cone="pyramidal"))]
    made += [v("cone", "pyramidal, impratio 1", s(cone="pyramidal", impratio=1.0))]
    made += [v("impratio", f"{x:g}", s(impratio=x)) for x in (1.0, 10.0, 1000.0)]
    made += [v("noslip", f"{n} iterations", s(noslip=n)) for n in (3, 10)]
    made += [v("noslip", "3 iterations, impratio 1", s(noslip=3, impratio=1.0))]
    made += [v("condim", f"{n}", s(condim=n)) for n in (4, 6)]
    made += [v("solimp", f"over {w:g} mm of depth", s(solimp=(0.1, 0.95, 1e-3 * w, 0.5, 2.0))) for w in (2.0, 10.0)]
    made += [v("solimp", f"{d:g} at no depth", _soft(d)) for d in (0.3, 0.5, 0.9)]
    made += [v("solimp", "MuJoCo's default", default), v("solimp", "hard", s(solimp=HARD_IMPEDANCE))]
    made += [v("solref", f"{t:g} s", s(solref=(t, 1.0))) for t in (0.005, 0.01, 0.04)]
    made += [v("solref", f"damping ratio {d:g}", s(solref=(0.02, d))) for d in (0.3, 3.0)]
    made += [v("solver", "Newton, 2 iterations", s(iterations=2))]
    made += [v("solver", f"CG, {n} iterations", s(solver="CG", iterations=n)) for n in (5, 50)]
    made += [v("solver", f"PGS, {n} iteration{'s' * (n > 1)}", s(solver="PGS", iterations=n)) for n in (1, 5, 20, 50, 200)]
    made += [v("integrator", name, s(integrator=name)) for name in ("Euler", "implicit", "RK4")]
    made += [v("time step", f"{1e3 * dt:g} ms", changes={"timestep": dt}) for dt in (0.0005, 0.001, 0.005, 0.01)]
    made += [v("wheels", shape, changes={"wheel_shape": shape}) for shape in ("capsule", "cylinder")]
    for ratio in (1.24, 0.6):
        made += [v("anisotropy", f"{ratio:g}, capsule", changes={"wheel_shape": "capsule", "friction_ratio": ratio})]
        for shape in ("ellipsoid", "cylinder"):
            made += [v("anisotropy", f"{ratio:g}, {shape}", s(tangent_ratio=ratio), {"wheel_shape": shape})]
    made += [v("centre of mass", "maker's, now", changes=MAKER_NOW)]
    made += [v("centre of mass", "maker's, earlier", changes=MAKER_EARLIER)]
    made += [v("centre of mass", "maker's, now; pyramidal", s(cone="pyramidal"), MAKER_NOW)]
    made += [v("centre of mass", "30 mm to the right; pyramidal", s(cone="pyramidal"), {"com_y": -0.03})]
    return made


def _together() -> list[Variant]:
    default, v, s = PhysicsSettings(solimp=MUJOCO_IMPEDANCE), Variant, PhysicsSettings
    group = "default contact"
    made = [v(group, f"{1e3 * dt:g} ms", default, {"timestep": dt}) for dt in (0.0005, 0.005)]
    made += [v(group, "noslip 10", replace(default, noslip=10)), v(group, "impratio 10", replace(default, impratio=10.0))]
    made += [v(group, "cylinders", default, {"wheel_shape": "cylinder"})]
    cylinders: dict[str, float | str] = {"wheel_shape": "cylinder"}
    plain = s("pyramidal", 1.0, solimp=MUJOCO_IMPEDANCE, iterations=100, integrator="Euler")
    ode = s("pyramidal", 1.0, solimp=HARD_IMPEDANCE, solref=HARD_REFERENCE, solver="PGS", iterations=50, integrator="Euler")
    fine: dict[str, float | str] = {**cylinders, "timestep": 0.001}
    group = "together"
    made += [v(group, "MuJoCo's defaults", plain, cylinders)]
    made += [v(group, "MuJoCo's defaults, maker's centre", plain, {**cylinders, **MAKER_NOW})]
    tab316 = replace(ode, cone="elliptic", iterations=400, tangent_ratio=0.6)
    made += [v(group, "near Tab. 3.16", tab316, {**fine, "friction": 0.25})]
    made += [v(group, "near ODE", ode, fine), v(group, "near ODE, 10 iterations", replace(ode, iterations=10), fine)]
    group = "near ODE, maker's centre"
    off = {**fine, **MAKER_NOW}
    soft = replace(ode, cone="elliptic", solimp=None, solref=None)
    made += [v(group, "as it is", ode, off), v(group, "and an elliptic cone", replace(ode, cone="elliptic"), off)]
    made += [v(group, "and soft contact", soft, off), v(group, "and the centre in the middle", soft, fine)]
    return made


def variants() -> tuple[Variant, ...]:
    """Everything that is tried, the baseline first."""
    return (BASELINE, *_one_at_a_time(), *_together())


def groups() -> tuple[str, ...]:
    """What is varied, in order."""
    return tuple(dict.fromkeys(v.group for v in variants()))


@dataclass(frozen=True)
class Column:
    """A measure as tables and the figure have it."""

    name: str
    """What it is called."""
    unit: Unit
    """How it is written."""
    value: Callable[[Measures], float | None]
    """In SI."""
    limits: tuple[float, float] | None
    """Up to the first nothing is wrong; from the second on all is [SI]; None where there is no wrong."""
    meaning: str
    """In a sentence."""


_PERCENT, _MM, _CM = Unit("%", 1e2, 1), Unit("mm", 1e3, 1), Unit("cm", 1e2, 1)

COLUMNS = (
    Column("multiplier", Unit("1", 1.0, 3), lambda m: m.multiplier, None, "wheels' yaw rate over the body's on the spot"),
    Column("off closed form", _PERCENT, lambda m: m.multiplier_error, (0.01, 0.4), "the multiplier against its closed form"),
    Column("ripple", _PERCENT, lambda m: m.ripple, (0.01, 1.0), "range of the yaw rate on the spot over its mean"),
    Column("lifted", _PERCENT, lambda m: m.lifted_share, (0.005, 0.5), "time on the spot with a wheel off the ground"),
    Column("glide", _PERCENT, lambda m: m.glide, (0.02, 1.0), "greatest speed of the middle on the spot over the rims'"),
    Column("wander", _CM, lambda m: m.wander_m, (0.01, 0.6), "how far the middle comes from its place in 36 s of turning"),
    Column("drift", _CM, lambda m: m.drift_m, (0.001, 0.06), "how far it is from its place after a whole turn, mean"),
    Column("veer", Unit("mm/m", 1e3, 1), lambda m: m.veer, (0.001, 0.03), "to the left on a straight drive"),
    Column("creep", Unit("mm/s", 1e3, 2), lambda m: m.creep_m_s, (1e-4, 5e-3), "sideways at rest on a slope of 8°"),
    Column("surge", _PERCENT, lambda m: m.surge, (0.02, 0.4), "greatest speed on trajectory 3 over what its wheels ask"),
    Column("ground turned", _MM, lambda m: m.turned_ground_m, (0.005, 1.0), "how far trajectory 3 ends elsewhere "
           "on ground turned by 45°"),
    Column("step halved", _MM, lambda m: m.halving_m, (0.01, 0.5), "how far trajectory 4 ends elsewhere at half the step"),
    Column("to improved", _MM, lambda m: m.d_rms_mean("improved"), (0.025, 0.5), "d_rms, mean over trajectories 1–4"),
    Column("to coulomb", _MM, lambda m: m.d_rms_mean("coulomb"), (0.035, 0.5), "the same"),
    Column("to linear", _MM, lambda m: m.d_rms_mean("linear"), (0.025, 0.5), "the same"),
    Column("recording", _MM, lambda m: m.recording_position_m, (0.045, 0.3), "median error of the relative pose after 6 s"),
    Column("recording yaw", DEGREES, lambda m: m.recording_yaw_rad, (0.035, 0.3), "the same"),
    Column("step", Unit("µs", 1e6, 0), lambda m: m.cost_s, None, "processor time of a step"),
)  # fmt: skip
"""In order; those of a recording are left out where there is none."""
_SPOT = ("multiplier", "off closed form", "ripple", "lifted", "glide", "wander", "drift")
_PATHS = ("veer", "creep", "surge", "ground turned", "step halved", "to improved", "to coulomb", "to linear")
_REST = ("recording", "recording yaw", "step")
TABLES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "Turning on the spot": _SPOT,
        "Straight ahead, at rest, on trajectories": _PATHS,
        "Against the recording, and what a step costs": _REST,
    }
)
"""Names of columns by title of the table that has them."""


@dataclass(frozen=True, eq=False)
class ContactStudy:
    """A study that was made."""

    profile: str
    """Name of the lab's robot."""
    recording: str | None
    """What the user called the recording; None for none."""
    recording_profile: str | None
    """Name of its robot."""
    outcomes: tuple[Outcome, ...]
    """The baseline first."""
    versions: Mapping[str, str] = field(default_factory=store.versions)
    """Of the packages."""

    @property
    def groups(self) -> tuple[str, ...]:
        """What was varied, in order."""
        return tuple(dict.fromkeys(o.variant.group for o in self.outcomes))

    def of(self, group: str) -> list[Outcome]:
        """A group's outcomes."""
        return [o for o in self.outcomes if o.variant.group == group]

    @property
    def columns(self) -> tuple[Column, ...]:
        """Those that hold anything."""
        return tuple(c for c in COLUMNS if any(c.value(o.measures) is not None for o in self.outcomes))


def choose(only: Sequence[str]) -> tuple[Variant, ...]:
    """The baseline and the groups asked for."""
    return tuple(v for v in variants() if v.group in only or v == BASELINE)


def check(bench: Bench, chosen: Sequence[Variant]) -> None:
    """Refuse, before anything is driven, what cannot be.

    Raises:
        ValueError: numbers of a profile that do not go with a variant's, a recording too short for one window.
    """
    for section in (bench.lab, bench.recorded):
        for variant in chosen if section is not None else ():
            assert section is not None
            variant.calibration(section.parameters)
    pieces = () if bench.recording is None else bench.recording.pieces
    if bench.recording is not None and not any(
        p.t is not None and len(horizon_windows(p.t, HORIZON, p.fresh)[0]) for p in pieces
    ):
        raise ValueError(f"{bench.recording.name} has no stretch of {HORIZON:g} s without a gap")


def study_contact(
    bench: Bench,
    chosen: Sequence[Variant],
    workers: int | None = None,
    *,
    timed: bool = True,
) -> ContactStudy:
    """Try variants.

    Args:
        bench: what all of them have to do.
        chosen: which.
        workers: threads; the result does not depend on it, but for the cost of a step, which is taken alone.
        timed: whether to take the cost of a step.
    """
    stop = threading.Event()

    def one(variant: Variant) -> Outcome:
        outcome = measure(bench, variant, stop.is_set)
        bar.advance(task)
        return outcome

    with cli.progress() as bar:
        task = bar.add_task("driving", total=len(chosen))
        with ThreadPoolExecutor(workers or os.cpu_count()) as pool:
            try:
                outcomes = list(pool.map(one, chosen))
            except BaseException:
                stop.set()  # an interrupt ends the others at their next drive
                raise
        if timed:
            bar.update(task, description="timing", total=ROUNDS, completed=0)
            outcomes = _timed(bench, outcomes, lambda: bar.advance(task))
    recording = None if bench.recording is None else bench.recording.name
    return ContactStudy(bench.profile, recording, bench.recording_profile, tuple(outcomes))


def _timed(bench: Bench, outcomes: Sequence[Outcome], tell: Callable[[], object]) -> list[Outcome]:
    """The outcomes with the cost of a step: the median over rounds, in each of which everybody has a turn."""
    plants = {k: make_variant(o.variant, bench.lab) for k, o in enumerate(outcomes) if UNDRIVEABLE not in o.failures}
    times: dict[int, list[float]] = {k: [] for k in plants}
    for _ in range(ROUNDS):
        for k, plant in plants.items():
            times[k].append(step_time(plant))
        tell()
    return [
        replace(o, measures=replace(o.measures, cost_s=float(np.median(times[k])))) if k in times else o
        for k, o in enumerate(outcomes)
    ]


def _changed(variant: Variant) -> dict[str, Any]:
    """What differs from what is shipped."""
    return {k: v for k, v in asdict(variant.settings).items() if v is not None}


def as_document(study: ContactStudy) -> dict[str, Any]:
    """study.json."""
    s = study
    document = {
        "schema": SCHEMA,
        "study": "contact",
        "profile": s.profile,
        "recording": s.recording,
        "recording_profile": s.recording_profile,
        "baseline": BASELINE.key,
        "versions": dict(s.versions),
        "limits": {c.name: None if c.limits is None else {"good": c.limits[0], "bad": c.limits[1]} for c in COLUMNS},
        "variants": [
            {
                "group": o.variant.group,
                "name": o.variant.name,
                "settings": _changed(o.variant),
                "calibration": dict(o.variant.changes),
                **asdict(replace(o.measures, d_rms_m={m: dict(d) for m, d in o.measures.d_rms_m.items()})),
                "multiplier_error": o.measures.multiplier_error,
                "failures": dict(o.failures),
            }
            for o in s.outcomes
        ],
    }
    plain = store.plain(document)
    assert isinstance(plain, dict)
    return plain


def cell_text(column: Column, measures: Measures) -> str:
    """A measure as it is written, without its unit."""
    value = column.value(measures)
    return NOTHING if value is None else column.unit.text(value)


def measure_grid(study: ContactStudy, names: Sequence[str]) -> Grid:
    """Measures by name as columns, variants as rows, each group under its name."""
    columns = [c for c in study.columns if c.name in names]
    header = (("setting", ""), *((c.name, c.unit.symbol) for c in columns))
    return _grouped(study, header, lambda o: [cell_text(c, o.measures) for c in columns])


def _grouped(study: ContactStudy, header: Sequence[tuple[str, str]], texts: Callable[[Outcome], Sequence[str]]) -> Grid:
    groups = []
    for group in study.groups:
        rows = [(Cell(group, best=True), *(Cell("") for _ in header[1:]))]
        rows += [(Cell(f"  {o.variant.name}"), *map(Cell, texts(o))) for o in study.of(group)]
        groups.append(tuple(rows))
    return Grid(tuple(header), tuple(groups), left=1)


def model_grid(study: ContactStudy) -> Grid:
    """d_rms to every published model on every trajectory."""
    unit = Unit("mm", 1e3, 1)
    header = [("setting", "")]
    header += [(f"{model} {name.removeprefix('traj')}", unit.symbol) for model in MODELS for name in SCENARIOS]

    def texts(outcome: Outcome) -> list[str]:
        apart = outcome.measures.d_rms_m
        values = [apart.get(model, {}).get(name) for model in MODELS for name in SCENARIOS]
        return [NOTHING if v is None else unit.text(v) for v in values]

    return _grouped(study, header, texts)


def heading(study: ContactStudy) -> str:
    """What was studied, in one line."""
    text = f"{len(study.outcomes)} settings, profile {study.profile}"
    return text if study.recording is None else f"{text}; recording with profile {study.recording_profile}"


def captions(study: ContactStudy) -> list[str]:
    """What the columns mean."""
    return [f"{c.name}: {c.meaning}" for c in study.columns]


def remarks(study: ContactStudy) -> list[str]:
    """What could not be measured, and why."""
    return [f"{o.variant.key}: {what}: {why}" for o in study.outcomes for what, why in o.failures.items()]


def markdown(study: ContactStudy) -> list[str]:
    """study.md, as lines."""
    lines = [f"# Physics settings: {heading(study)}", ""]
    for title, names in TABLES.items():
        lines += [f"## {title}", "", *markdown_table(measure_grid(study, names)), ""]
    lines += ["## d_rms to the published models", "", *markdown_table(model_grid(study)), ""]
    lines += ["## Columns", "", *(f"- {caption}" for caption in captions(study)), ""]
    failed = remarks(study)
    lines += ["## Failed", "", *(f"- {remark}" for remark in failed), ""] if failed else []
    versions = ", ".join(f"{k} {v}" for k, v in study.versions.items() if k in ("mujoco", "numpy", "numba", "ssmr-testbed"))
    return [*lines, f"{versions}.", ""]
