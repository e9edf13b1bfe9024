"""Tune a controller's gains by differential evolution: `python -m validation.tune CONTROLLER`."""

from __future__ import annotations

if __name__ == "__main__":
    from validation.interrupts import end_quietly

    end_quietly()

import datetime
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from ssmr.control.laws import LAWS
from ssmr.control.loop import LoopSettings
from ssmr.parameters import require_one_of, require_within
from ssmr.search.jde import JdeSettings
from validation import cli, output
from validation.experiment.gains import (
    DEFAULT,
    GainSet,
    dump_gains,
    load_gains,
    origin_sentence,
    shipped_gains,
    shipped_sets,
)
from validation.experiment.loops import (
    JUDGE,
    ClosedLoopRobot,
    demand_of,
    make_controller,
    make_robot,
    open_path,
)
from validation.experiment.tracked import Followed, lost_text
from validation.experiment.waypoint_files import split_speed
from validation.identify.report import (
    SearchReport,
    bound_sentences,
    fitted_parameters,
    search_figure,
    status_of,
)
from validation.identify.search import Search, Searching, search_for
from validation.identify.tuning import (
    TARGET_SHARE,
    TuneCase,
    TuneCost,
    TuneMeasure,
    TuneProblem,
    make_tuning_space,
)
from validation.output import Document, Progress, one_line
from validation.plants.profile import Profile, choose_profile, odometry_of
from validation.plants.table import SIMULATED
from validation.report import drawing
from validation.report.report import Writers
from validation.report.table import Table
from validation.simulator.description import with_robot
from validation.workers import threads_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# a simulated run costs a hundred times that of a planar model
_SIMULATED_SIZE = JdeSettings(24, 20)
# a cost that the tuning has not seen which is so many times that of before is worth a sentence
_WORSE = 1.1
_SHOWN = ("cost", "d_rms_m", "sync_rms_m", "d_haus_m", "thesis_cost")  # in the table of references
_OF_A_SET = (
    *("profile", "robot", "cost_name", "cost", "baseline", "baseline_cost"),
    *("seed", "evaluations", "generations"),
)
"""Keys of the document that a set of gains keeps."""
HELD_OUT = ("line", "circle", "generic", "slalom", "square", "u-turn", "stop-and-go")
"""References that a tuning is judged on unless others are named: paths of every kind, without those
that it is tuned on, at the greatest speed that it is tuned on."""

Drives = Mapping[str, Mapping[str, Followed]]
"""Runs by reference, speed and plant (`generic at 0.25 m/s, improved`), and by gains: `tuned`,
`baseline` and, where these are others, `shipped`."""


@dataclass(frozen=True)
class Tune(Searching):
    """Options of `tune`."""

    controller: tyro.conf.Positional[str]
    """Controller to tune: pid, lqr or lqr-scheduled, each also with +predictor behind its name, or
    mpc."""
    reference: Sequence[str] = ("generic",)
    """Paths to follow, separated by commas: line, circle, sine, generic, eight, slalom, square,
    spiral, u-turn, stop-and-go, long-line, circle@0.5 with its speed, or waypoint files."""
    profile: cli.AnyProfile = None
    """Name of a shipped profile, or path of a profile (.toml); if not given, thesis-lab, and for
    another --robot the numbers of its file."""
    plant: Sequence[str] = ("improved",)
    """Plants that the controller must drive, separated by commas; the cost is the mean over all."""
    robot: cli.AnyRobot = None
    """Name of a shipped robot, or path of a robot's file (.toml); the profile's if not given."""
    speed: float = 0.25
    """Speed of references that name none [m/s]."""
    held_out: Sequence[str] | None = None
    """References to judge the gains on, in the form of --reference; others of every kind if not
    given."""
    no_noise: bool = False
    """Switch noise and disturbance off."""
    gains: str | None = None
    """Gain set to begin with, to hold what is not searched, and to compare the outcome with;
    published if not given, where the thesis has any."""
    all: bool = False
    """Search the gains too that the thesis sets by hand: feedforward, K_alpha, K_y, K_I."""
    from_scratch: tyro.conf.Suppress[bool] = False
    """Leave the gains it begins with out of the first population."""
    cost: TuneMeasure = "metres"
    """metres: distance to the path and a tenth of that to the moving target; the thesis' path
    (Sec. 4.3.3, 4.4.3), which is blind to time, or time: errors at equal times instead of distances
    between paths (Sec. 5). A greater path error than before is refused, whatever it costs."""
    guard: float = 0.1
    """Stability guard: candidates that lose the reference with this much more delay [s] are
    refused; 0 turns it off."""
    noise_seed: tyro.conf.Suppress[int | None] = None
    """Seed of noise and disturbance. None takes the seed of the search."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a number out of its range, or no plant or reference."""
        super().__post_init__()
        require_within(self, ("speed",), 1e-3, 100.0)
        if not self.plant:
            raise ValueError("plant is empty; name at least one")
        if not self.reference:
            raise ValueError("no reference is named; name one such as generic or circle@0.5")

    def folder(self) -> Path:
        """Return the folder that the files are written to."""
        return Path("runs") / "tune" / f"{self.controller}-{'-'.join(self.plant)}"

    def cases(
        self, references: Iterable[tuple[str, float | None]], robots: Sequence[ClosedLoopRobot]
    ) -> tuple[TuneCase, ...]:
        """Return every robot on every reference, given by name and speed [m/s].

        The option `speed` stands for None.
        """
        loop = LoopSettings("truth" if self.no_noise else "noisy", disturbance=not self.no_noise)
        out = []
        for name, speed in references:
            for robot in robots:
                v = self.speed if speed is None else speed
                label, waypoints, _ = open_path(name, v, [robot], LAWS[self.controller])
                around = replace(loop, filter=odometry_of(robot.drive))
                title = f"{label} at {waypoints.speed:.3g} m/s, {robot.name}"
                out.append(TuneCase(title, name, waypoints, robot, around))
        return tuple(out)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Tuned(SearchReport):
    """Tuned gains, and how they follow references beside the gains of before."""

    program = "tune"
    name: str
    """Name of the tuned gains."""
    problem: TuneProblem
    """The problem that was searched, with the profile and the gains of before."""
    gains: Mapping[str, float]
    """All gains of the controller by name, searched or held."""
    least: float
    """Cost of these gains."""
    baseline_cost: float
    """Cost of the gains of before; infinite where they lose a reference."""
    shipped: GainSet | None
    """The gains that are shipped for this controller and profile, if there are any."""
    shipped_cost: float
    """Cost of the gains that are shipped; infinite where they lose a reference, NaN where there are
    none."""
    train: Drives
    """Runs along the references of the tuning."""
    held_out: Drives
    """The same along references that the tuning has not seen."""
    judged: Drives
    """The same of MuJoCo's robot along the references of the tuning, if it was not among them."""

    @property
    def _all_runs(self) -> Drives:
        """The runs of all references."""
        return {**self.train, **self.held_out, **self.judged}

    @property
    def cost(self) -> float:
        """Cost of the gains."""
        return self.least

    @property
    def cost_name(self) -> str:
        """Name of the cost."""
        return self.problem.cost.cost

    @property
    def _held(self) -> list[str]:
        """Names of the gains that were not searched."""
        searched = [p.name for p in self.parameters]
        return [name for name in self.gains if name not in searched]

    @cached_property
    def gain_set(self) -> GainSet:
        """All gains with their provenance."""
        followed = {}
        for label, runs in self._all_runs.items():
            r = runs["tuned"]
            if not r.run.lost:
                followed[label] = {"d_rms_m": r.metrics["d_rms_m"], "cost": r.metrics["cost"]}
        document = self.document()
        if math.isinf(self.baseline_cost):
            del document["baseline_cost"]
        provenance = {
            "tuned_on": list(self.train),
            "searched": [p.name for p in self.parameters],
            "by_hand": self._held,
            **{key: document[key] for key in _OF_A_SET if key in document},
            "status": self.status,
            "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
            "options": {key: value for key, value in self.options.items() if value is not None},
            "versions": dict(self.versions),
            "followed": followed,
        }
        source = f"tuned by validation.tune on {', '.join(self.train)}"
        return GainSet(self.problem.base.controller, self.name, self.gains, provenance, source)

    def files(self) -> Writers:
        """Return functions that write its files: gains.toml and tune.png."""
        gains = dump_gains(self.gain_set)
        return {"gains.toml": lambda path: output.write_text(path, gains), **super().files()}

    def figure(self) -> Figure:
        """Draw the search."""
        plant = self.problem.cases[0].robot.name
        return search_figure(self, drawing.ink_of(plant), "baseline")

    def document(self) -> Document:
        """Return the document of tune.json without tables; null stands for an infinite number."""

        def runs(cases: Drives) -> Document:
            rows = Document()
            for label, rated in cases.items():
                rows[label] = {name: {**r.metrics, "lost": r.run.lost} for name, r in rated.items()}
            return rows

        return {
            "schema": "ssmr.tune/1",
            "controller": self.problem.base.controller,
            "seed": self.seed,
            "source": ",".join(dict.fromkeys(case.reference for case in self.problem.cases)),
            "profile": self.problem.profile.name,
            "robot": self.problem.profile.robot.name,
            **self.searched(),
            "baseline": self.problem.base.name,
            "baseline_cost": self.baseline_cost,
            "worse_than_start": False,  # the better of both is kept
            "shipped": "" if self.shipped is None else self.shipped.name,
            "shipped_cost": self.shipped_cost,
            "gains": dict(self.gains),
            "train": runs(self.train),
            "held_out": runs(self.held_out),
            "mujoco": runs(self.judged),
        }

    def tables(self) -> list[Table]:
        """Return the parameters, and the runs along all references."""
        base = one_line(self.problem.base.name)
        held = " · ".join(f"{name} {self.gains[name]:.4g}" for name in self._held)
        rows = []
        drives = (("", self.train), ("held out: ", self.held_out), ("", self.judged))
        for lead, cases in drives:
            for label, runs in cases.items():
                for name, rated in runs.items():
                    shown = {k: None if rated.run.lost else rated.metrics[k] for k in _SHOWN}
                    rows.append({"reference": f"{lead}{label}", "gains": name, **shown})
        caption = f"{base} costs {self.baseline_cost:.4g}\nheld: {held or 'none'}"
        return [
            self.values("gain", "baseline", caption),
            Table(f"Tuned gains compared with {base}", rows, group="reference", best=True),
        ]

    def notes(self) -> list[str]:
        """Return sentences on lost references, on gains that are no better, and the remarks."""
        out = []
        worse = []
        for label, runs in self._all_runs.items():
            for name, r in runs.items():
                if r.run.lost:
                    out.append(f"The {name} gains lose {label}: {lost_text(r.run)}.")
            now = runs["tuned"].metrics["cost"]
            if label not in self.train and now > _WORSE * runs["baseline"].metrics["cost"]:
                worse.append(label)
        if worse:
            out.append(
                f"Compared with {self.problem.base.name} these gains are worse on what they "
                f"were not tuned on: {', '.join(worse)}."
            )
        if self.shipped is not None and self.shipped_cost < self.cost:
            out.append(
                f"The shipped gains {self.shipped.name} cost less on what these were tuned on: "
                f"{self.shipped_cost:.4g}."
            )
        return [*map(one_line, out), *super().notes()]


@cli.make_program(Tune)
def tune(o: Tune) -> Tuned:
    """Tune the gains of a controller by differential evolution (jDE).

    They are compared with those it began with, at last in MuJoCo.

    Prints tables; writes tune.json, gains.toml, tune.png and checkpoint.npz.

    Ctrl-C ends the search and writes the best result found so far.

    Raises:
        ValueError: a name, number or file that cannot be used; the message says which.
        SsmrError: every candidate lost a reference or failed the stability guard.
        OSError: the checkpoint cannot be written.
        KeyboardInterrupt: interrupted before any candidate was rated.
    """
    profile = choose_profile(o.profile, o.robot, "thesis-lab")
    base = _base_gains(o, profile)
    begun = None if o.from_scratch else base.values
    bounds = cli.read_value(o.bounds)
    space = make_tuning_space(o.controller, o.free, o.all, bounds, o.fix, begun)
    law = LAWS[o.controller]
    for remark in profile.unfitted(o.plant):
        cli.warn_user(remark)
    robots = [make_robot(profile, name) for name in o.plant]
    simulated = any(name in SIMULATED for name in o.plant)
    usual = _SIMULATED_SIZE if simulated else JdeSettings(law.population, law.generations)
    settings = o.settings(usual)
    references = list(map(split_speed, o.reference))
    cases = o.cases(references, robots)
    fastest = max(case.waypoints.speed for case in cases)
    tuned_on = [name for name, _ in references]
    others = [(name, fastest) for name in HELD_OUT if name not in tuned_on]
    held_out = o.cases(others if o.held_out is None else map(split_speed, o.held_out), robots)
    noise_seed = o.seed if o.noise_seed is None else o.noise_seed
    cost = TuneCost(o.cost, o.guard, seed=noise_seed, k_u=law.k_u)
    if o.from_scratch:  # no gains before
        cost = replace(cost, worse_path=math.inf)
    problem = TuneProblem(profile, base, space, cases, cost)
    start = None
    if begun is not None:
        start = space.points([begun[name] for name in space.names])[None]
    search = search_for(problem, settings, o, start)
    total = settings.generations + 1
    o.progress(Progress(total, total, "tuned and earlier gains on every reference"))
    judge = [] if JUDGE in o.plant else [make_robot(profile, JUDGE)]
    return _report_tuning(o, problem, search, held_out, o.cases(references, judge))


def _base_gains(o: Tune, profile: Profile) -> GainSet:
    """Return the gains that a tuning begins with, with those that are held.

    They are those that are named, else the published ones, else the defaults.
    """
    published = "published" in shipped_sets(o.controller)
    base = load_gains(o.controller, o.gains or ("published" if published else DEFAULT))
    for name in o.fix:
        require_one_of(name, base.values, f"{o.controller} has no gain '{name}'")
    base = replace(base, values={**base.values, **cli.read_value(o.fix)})
    # gains that no controller can have are refused before a search begins
    make_controller(profile, base)
    return base


def _report_tuning(
    o: Tune,
    problem: TuneProblem,
    search: Search,
    held_out: Sequence[TuneCase],
    judged: Sequence[TuneCase],
) -> Tuned:
    """Return the report on the better of found and earlier gains, driven beside others."""
    base = problem.base
    space = problem.space
    profile = problem.profile
    threads = threads_of(o.workers)
    remarks = [origin_sentence(base, profile.name)]
    for case in problem.cases:
        remarks.append(demand_of(case.waypoints, case.robot, profile.name, case.reference))
    notes = [remark for remark in remarks if remark is not None]
    notes += profile.unfitted(o.plant)
    values = [base.values[name] for name in space.names]
    before = problem.cost_of(base, threads)
    kept = problem.gains(search.best)
    if not o.from_scratch:
        least = problem.cost_of(base, threads, guarded=True)
        if least <= search.cost:
            notes.append(
                f"No candidate costs less than {base.name}, with which the search began: "
                "those gains are kept."
            )
            kept = base
        elif math.isinf(least) and math.isfinite(before):
            notes.append(
                f"{base.name}, with which the search began, fails the stability guard, "
                "so it had to be left."
            )
    shipped = shipped_gains(base.controller, profile.name)
    sets = {"tuned": kept, "baseline": base}
    if shipped is not None and shipped.values != base.values:
        sets["shipped"] = shipped
    there = {case.label: problem.rated(case, sets, threads) for case in judged}
    if kept is not base and not o.from_scratch:
        now, then = (
            _mean_metres([runs[name] for runs in there.values()]) for name in ("tuned", "baseline")
        )
        if not now <= then:
            notes.append(
                f"The gains that were found are refused: MuJoCo's robot is farther from path and "
                f"target with them, {1e3 * now:.1f} mm for {1e3 * then:.1f}. "
                f"{base.name} are kept."
            )
            sets["tuned"] = kept = base
            for runs in there.values():
                runs["tuned"] = runs["baseline"]
    cost, point = (before, space.points(values)) if kept is base else (search.cost, search.best)
    notes += bound_sentences(space, point)
    source = ",".join(dict.fromkeys(case.reference for case in problem.cases))
    profile_name = with_robot(profile.name, profile.robot.name)
    return Tuned(
        title=f"{base.controller} tuned on {one_line(source)}, profile {profile_name}",
        options={
            **asdict(problem.cost),
            **o.chosen(search.jde.settings),
            "noise_seed": problem.cost.seed,
        },
        status=status_of(search),
        course=search,
        seed=o.seed,
        parameters=fitted_parameters(space, point, values),
        remarks=notes,
        name=o.name or f"{base.controller}-tuned",
        problem=problem,
        gains=kept.values,
        least=cost,
        baseline_cost=before,
        shipped=shipped,
        shipped_cost=math.nan if shipped is None else problem.cost_of(shipped, threads),
        train={case.label: problem.rated(case, sets, threads) for case in problem.cases},
        held_out={case.label: problem.rated(case, sets, threads) for case in held_out},
        judged=there,
    )


def _mean_metres(runs: Sequence[Followed]) -> float:
    """Return the mean metres of some drives; infinite for a lost robot."""
    metres = 0.0
    for each in runs:
        metres += each.metrics["d_rms_m"] + TARGET_SHARE * each.metrics["sync_rms_m"]
        if each.run.lost:
            return math.inf
    return metres / max(len(runs), 1)


if __name__ == "__main__":
    tune.main()
