"""Find a plant's parameters from motions: `python -m validation.fit MODEL --to SOURCE`."""

from __future__ import annotations

if __name__ == "__main__":
    from validation.interrupts import end_quietly

    end_quietly()

import contextlib
import datetime
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain, compress, product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args

import numpy as np
import tyro

from ssmr.errors import SsmrError
from ssmr.metrics.bands import Band
from ssmr.models.law import PlanarLaw
from ssmr.parameters import require_within
from ssmr.search.space import ParameterSpace
from ssmr.types import FloatArray
from validation import cli
from validation.experiment.scores import (
    HEADLINE_HORIZON,
    NamedScores,
    Scores,
    pace_of,
    standing_sentences,
)
from validation.experiment.sources import (
    AnySource,
    Rates,
    Source,
    source_name,
    unknown_robot_notes,
)
from validation.experiment.user_law import add_user_model
from validation.files.formats import profile_of_log
from validation.files.log import ReadOptions
from validation.identify import beginning
from validation.identify.currents import with_torques
from validation.identify.judging import (
    held_out_scores,
    left_out_band,
    motions_of,
    plant_on,
    require_possible,
    scores_by_source,
)
from validation.identify.motor_logs import chassis_of, loss_of
from validation.identify.objective import FitCost, Objective, true_motion
from validation.identify.problem import IGNORANCE, FitProblem
from validation.identify.report import (
    SearchReport,
    bound_sentences,
    fitted_parameters,
    search_figure,
    status_of,
)
from validation.identify.search import (
    SETTINGS,
    Method,
    Search,
    Searching,
    search_for,
    usual_search,
)
from validation.identify.targets import (
    HORIZONS,
    MOST_TIME,
    Input,
    is_scenario,
    open_sources,
    worse_sentences,
)
from validation.identify.uncertainty import (
    FEWEST_DAYS,
    Uncertainty,
    estimate_uncertainty,
    uncertainty_sentences,
)
from validation.output import Document, Progress, file_name, one_line, shorten_text
from validation.plants.kind import Occasion, PlantProfile
from validation.plants.profile import Profile, choose_profile
from validation.plants.searchable import find_number, make_space, with_values
from validation.plants.table import SIMULATED, plant_kind
from validation.report import drawing
from validation.report.motions import interval_table
from validation.report.report import Writers
from validation.report.table import Table
from validation.simulator.description import with_robot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FITTED = "; fitted: "
"""What stands between a profile's description and the plants that were fitted."""
# metrics in the table of scores
_SHOWN = ("d_rms_m", "d_haus_m", "d_ratio", "sync_rms_m", "yaw_rms_rad")


@dataclass(frozen=True)
class Fit(Searching, ReadOptions):
    """Options of `fit`."""

    model: tyro.conf.Positional[str]
    """Plant to fit: improved, coulomb, linear, kinematic, four_wheel, mujoco, or the one that
    --model adds."""
    to: AnySource | Sequence[AnySource]
    """Sources of the data, separated by commas: traj4@mujoco for how that plant drives traj4, or
    paths of recordings. Several are fitted with one body, and each recording with a localiser of
    its own. Those written as LOG@GROUND share that ground's friction and rolling resistance."""
    profile: cli.AnyProfile = None
    """Name of a shipped profile, or path of a profile (.toml); if not given, thesis-lab for
    scenarios, a shipped log's own, else husky-tile, and for another --robot the numbers of its
    file."""
    robot: cli.AnyRobot = None
    """Name of a shipped robot, or path of a robot's file (.toml); the profile's if not given."""
    input: Input = "commands"
    """Input of a recording that drives the plant: its commands, or its measured wheel rates."""
    rates: Rates = "instant"
    """Wheel rates of a recording: instant, as of a JointState, or means since the stamp before."""
    since: cli.Since = None
    """Leave out what was recorded before this time [s]."""
    until: float | None = None
    """Leave out what was recorded after this time [s]."""
    held_out: Sequence[AnySource] = ()
    """Sources to test on, separated by commas. A fitted recording stands for its parts outside
    --from and --until."""
    even_if_worse: bool = False
    """Write the fitted numbers to profile.toml even where their error on held-out sources is larger
    than before the fit."""
    own_model: Annotated[PlanarLaw | str | None, tyro.conf.arg(name="model")] = None
    """A plant of your own: a PlanarLaw in a Python file, FILE.py:NAME, which is run."""
    guess: Literal["profile"] | Mapping[str, float] | str | None = None
    """Numbers that the search begins with: the profile's, or some that replace them, such as
    friction=0.4. If not given, a fit to recordings begins with the profile's, or for mujoco and
    four_wheel without --free with those of a kinematic fit; a fit to scenarios begins at random."""
    objective: Objective | None = None
    """Errors to minimise: path (of paths, Eq. 3.1), sync (at equal times) or horizon (of relative
    poses, seconds later). If not given, horizon for recordings; else sync for bodies on wheels,
    path for others."""
    horizons: Sequence[float] | str = (2.0, 6.0)
    """Horizons of the horizon objective [s]."""
    yaw_weight: float | None = None
    """Position error that counts as much as a radian of yaw error, in the sync and horizon
    objectives [m/rad]; 1 if not given, 0.2 for bodies on wheels in scenarios."""
    torque_weight: float | None = None
    """Position error that counts as much as a newton metre of torque error, where both the source
    and the plant have torques of a body on wheels (mujoco, four_wheel) [m/(N m)]; 0 leaves them
    out. If not given, 1.2 m over weight times wheel radius."""
    position_weight: float = 1.0
    """Weight of position errors in the sync and horizon objectives; 0 fits the heading alone, where
    positions are not to be trusted."""
    torque_constant: float | None = None
    """Torque of a side's wheels per ampere of its motor [N m/A], for logs with currents of the
    motors; currents of the battery need none. The profile's, or the robot file's, if not given."""
    search: Method | None = None
    """jde: differential evolution, as in the thesis; --population and --generations choose it.
    hybrid: a short one, then bounded least squares from its best candidate and others far from it.
    descents: least squares from random candidates, then a simplex by the cost. lsq: least squares
    from --guess. If not given, descents for planar models by the path, else hybrid."""

    def __post_init__(self) -> None:
        """Raise a ValueError for an option that is out of its range."""
        super().__post_init__()
        require_within(self, ("since", "until"), -MOST_TIME, MOST_TIME)
        require_within(self, ("torque_constant",), 1e-6, 1e4)

    def folder(self) -> Path:
        """Return the folder that the files are written to."""
        first = next(iter(self.names), "")
        return Path("runs") / "fit" / file_name(f"{self.model}-{Path(first).stem}")

    @property
    def sources(self) -> list[AnySource]:
        """The sources that it is fitted to, as the user gave them."""
        given = self.to
        if isinstance(given, str) and not Path(given).exists():
            given = tuple(filter(None, map(str.strip, given.split(","))))
        parts = given if isinstance(given, tuple) else (given,)
        return list(parts)

    @property
    def names(self) -> list[str]:
        """The names of these sources."""
        return list(map(source_name, self.sources))


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Fitted(SearchReport):
    """A plant's fitted parameters, their uncertainty, and how well they predict motion."""

    program = "fit"
    asked: Fit
    """Options of the fit."""
    problem: FitProblem
    """The plant of before, what was searched, and the sources that it was fitted to."""
    base: Profile
    """The profile that the fit began with."""
    plant: PlantProfile
    """The plant with the fitted numbers."""
    sure: Uncertainty | None
    """How sure the numbers are; None where that was not estimated."""
    train: NamedScores
    """Scores on each source that it was fitted to, by the source."""
    together: Scores
    """Scores on all of them."""
    held_out: NamedScores
    """Scores on each source that the fit has not seen."""
    unfitted: NamedScores
    """Scores of the plant before the fit on the same sources."""
    judged: NamedScores
    """Scores `before` and `after` the fit on all of them together; empty where there is none."""
    objections: Sequence[str] | None = None
    """Sentences on why its numbers are not to be used, by whoever asked for the fit; None where
    nobody judged it but itself."""

    @property
    def model(self) -> str:
        """The plant that was fitted."""
        return self.problem.model

    @property
    def cost_name(self) -> str:
        """Name of the cost."""
        return str(self.problem.cost.objective)

    @property
    def correlation(self) -> FloatArray | None:
        """(n, n) correlation of the parameters' errors; None where it was not estimated."""
        return None if self.sure is None else self.sure.correlation

    def error_of(self, weights: Mapping[str, float]) -> float:
        """Return the standard error of a weighted sum of parameters; NaN where it is not known."""
        if self.sure is None or not weights.keys() <= {p.name for p in self.parameters}:
            return math.nan
        each = [weights.get(p.name, 0.0) for p in self.parameters]
        scaled = np.where(each, each * self.sure.standard_error, 0.0)
        return math.sqrt(scaled @ self.sure.correlation @ scaled)

    @cached_property
    def worse(self) -> list[str]:
        """What speaks against its numbers: objections, or a larger error on held-out sources."""
        if self.objections is not None:
            return list(self.objections)
        before = [*self.unfitted.values()]
        after = [*self.held_out.values()]
        return worse_sentences(self.problem.cost, self.asked.even_if_worse, before, after)

    @property
    def better(self) -> bool | None:
        """Whether the fitted plant errs less there than before; None where nothing was held out."""
        return not self.worse if self.held_out else None

    @cached_property
    def profile(self) -> Profile:
        """The profile that the fit began with, with the fitted numbers and their provenance in it.

        It is that of before where these are worse, unless they are wanted even so.
        """
        if self.worse and not self.asked.even_if_worse:
            return self.base
        document = self.document()
        taken = ("source", "search", "seed", "cost", "evaluations", "generations")
        parameters = self.parameters
        errors = {p.name: p.standard_error for p in parameters if p.standard_error is not None}
        earlier = self.base.provenance.get(self.model)
        fits = {}
        if isinstance(earlier, Mapping):
            fits = {kind: earlier[kind] for kind in get_args(Occasion) if kind in earlier}
        occasion = _occasion_of(self.asked)
        fits[occasion] = {
            **{name: document[name] for name in (*taken, "standard_errors_by")},
            "status": self.status,
            "options": {name: value for name, value in self.options.items() if value is not None},
            "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
            "versions": dict(self.versions),
            "standard_errors": errors,
            "of_logs": {p.name: p.value for p in parameters if "@" in p.name},
        }
        logs = ", ".join(Path(name).name for name in self.asked.names)
        fitted = f"{self.model} by {occasion} to {shorten_text(logs, 200)}"
        before, _, others = self.base.description.partition(_FITTED)
        kept = [part for part in others.split("; ") if not part.startswith(fitted.split(" to ")[0])]
        truth = [true_motion(piece) for source in self.problem.sources for piece in source.pieces]
        return replace(
            self.base,
            name=self.asked.name or f"{self.base.name.removesuffix('-fitted')}-fitted",
            description=before + _FITTED + "; ".join([*filter(None, kept), fitted]),
            plants={**self.base.plants, self.model: self.plant},
            provenance={**self.base.provenance, self.model: fits},
            fitted_at=pace_of(truth, self.base.robot.wheel_radius),
        )

    def files(self) -> Writers:
        """Return functions that write its files: profile.toml and fit.png."""
        return {"profile.toml": self.profile.save, **super().files()}

    def notes(self) -> list[str]:
        """Return first whether the fit is worse than what was before."""
        return list(dict.fromkeys([*self.worse, *super().notes()]))

    def document(self) -> Document:
        """Return the document of fit.json without its tables."""
        correlation = None
        if self.correlation is not None:
            names = [p.name for p in self.parameters]
            correlation = {"names": names, "matrix": self.correlation.tolist()}
        return {
            "schema": "ssmr.fit/1",
            "model": self.model,
            "source": ",".join(self.asked.names),
            "profile": self.base.name,
            "robot": self.base.robot.name,
            "seed": self.seed,
            **self.searched(),
            "search": self.options["search"],
            "correlation": correlation,
            "standard_errors_by": "" if self.sure is None else self.sure.method,
            "train": self.together.as_dict(),
            "train_by_source": {label: s.as_dict() for label, s in self.train.items()},
            "held_out": {label: s.as_dict() for label, s in self.held_out.items()},
            "held_out_before": {label: s.as_dict() for label, s in self.unfitted.items()},
            "better": self.better,
        }

    @property
    def _named(self) -> list[tuple[str, Scores]]:
        """All scores with their names in tables and pictures."""
        out = []
        leads = ("", "held out: ", "before, held out: ")
        for lead, scores in zip(leads, (self.train, self.held_out, self.unfitted), strict=True):
            for label, s in scores.items():
                short = shorten_text(Path(label).name, 32)
                out.append((f"{lead}{short}", s))
        return out

    def tables(self) -> list[Table]:
        """Return the parameters, the scores on each source, and the errors by horizon of logs."""
        scores = []
        for name, s in self._named:
            row: Document = {"source": name}
            for key in _SHOWN:
                row[key] = s.metrics[key]
            if "torque_rms_N_m" in s.metrics:
                row["torque_rms_N_m"] = s.metrics["torque_rms_N_m"]
            scores.append(row)
        errors = []
        for h, (name, s) in product(HORIZONS, self._named):
            if h in s.overlapping:
                errors.append((h, name, s.overlapping[h]))
        return [
            self.values("parameter", "before"),
            Table("Scores of the fitted plant", scores),
            interval_table(errors, "source"),
        ]

    def figure(self) -> Figure:
        """Draw the search, the parameters, and the errors by horizon of recordings."""
        ink = drawing.ink_of(self.model)
        marks = []
        for k, (name, s) in enumerate(self._named):
            if s.overlapping:
                colour = ink if s in self.train.values() else drawing.BESIDE_INK
                look = {"label": name, "color": colour, "marker": "osvDP"[k % 5]}
                marks.append((s.overlapping, look))

        def position(ax: Axes) -> None:
            drawing.draw_horizons(marks, "position", ax)
            ax.legend(fontsize=8.5)

        rows = []
        if marks:
            yaw = partial(drawing.draw_horizons, marks, "yaw")
            rows.append(drawing.PanelRow(2.8, [position, yaw]))
        return search_figure(self, ink, "before", rows)


@cli.make_program(Fit)
def fit(o: Fit) -> Fitted:
    """Fit a plant's parameters to motions by differential evolution (jDE), least squares, or both.

    Prints tables; writes fit.json, profile.toml, fit.png and checkpoint.npz.

    Ctrl-C ends the search and writes the best result found so far.

    Raises:
        ValueError: a name, number or file that cannot be used; the message says which.
        SsmrError: a plant diverged, or no candidate could be driven.
        OSError: the checkpoint cannot be written.
        KeyboardInterrupt: interrupted before any candidate was rated.
    """
    return with_band(run_fit(o, cli.warn_user))


def with_band(f: Fitted, band: Band | None = None) -> Fitted:
    """Return a fit whose plant has a band of its predictions.

    If none is given, it is that of a log when parts of the data are left out.
    """
    if band is None and f.sure is not None and f.problem.robust:
        with contextlib.suppress(SsmrError):
            band = left_out_band(f.problem, f.sure, f.course.best)
    if band is None:
        return f
    return replace(f, plant=replace(f.plant, bands={**f.plant.bands, f.asked.input: band}))


def _occasion_of(o: Fit) -> Occasion:
    """Return the occasion of a fit, by its sources and their input."""
    return "scenario" if all(map(is_scenario, o.names)) else o.input


def run_fit(o: Fit, warn: Callable[[str], object]) -> Fitted:
    """Return the report of `fit`; `warn` is called with what is wrong with its sources or it."""
    add_user_model(o.own_model)
    occasion = _occasion_of(o)
    kind = plant_kind(o.model)
    is_default = o.profile is None and o.robot is None
    standard = "thesis-lab" if occasion == "scenario" else profile_of_log(o.names[0])
    base = choose_profile(o.profile, o.robot, standard)
    fix = cli.read_value(o.fix)
    held = {name: value for name, value in fix.items() if "@" in name}
    fixed = {name: value for name, value in fix.items() if name not in held}
    begun = with_values(o.model, base.section(o.model), list(fixed), fixed.values())
    radius = None if is_default else base.robot.wheel_radius
    span = (o.since, o.until)
    opened = sources, held_out = open_sources(
        o.sources, base, o.held_out, o.input, span, options=o, radius=radius, rates=o.rates
    )
    left_alone = (*kind.held(begun.parameters), *_held_turning(o))
    usual = [name for name in kind.free[occasion] if name not in left_alone]
    free = usual if o.free is None else o.free
    searched = beginning.searched_names([*free, *_mentioned(o)], free, o.fix, sources)
    space = make_space(o.model, searched, cli.read_value(o.bounds), begun.robot)
    before = np.array([find_number(o.model, name, begun.robot).read(begun) for name in space.names])
    start = None
    notes = list[str]()
    if o.guess is not None or o.search == "lsq" or occasion != "scenario":
        start = beginning.first_points(o.guess, space, before)
    for warning in dict.fromkeys(chain(*(source.warnings for source in chain(*opened)))):
        warn(warning)
    yaw_weight = o.yaw_weight
    if yaw_weight is None:
        yaw_weight = 0.2 if occasion == "scenario" and kind.torques else 1.0
    cost = FitCost(
        o.objective,
        tuple(cli.read_value(o.horizons)),
        yaw_weight,
        position_weight=o.position_weight,
        torque_weight=o.torque_weight,
    )
    if kind.torques and o.torque_weight != 0.0:
        constant = o.torque_constant or begun.drive.torque_constant
        loss = 0.0 if occasion == "wheels" else loss_of(begun)  # given wheels lose nothing
        chassis = chassis_of(base)
        sources = [with_torques(source, chassis, constant, loss) for source in sources]
        held_out = [with_torques(source, chassis, constant, loss) for source in held_out]
    problem = FitProblem(o.model, begun, space, sources, cost, held)
    require_possible(problem, o.bounds)
    # numbers that the user chooses begin where the profile has them
    if kind.torques and occasion != "scenario" and o.guess is None and o.free is None:
        names = beginning.searched_names(
            (), plant_kind(beginning.FIRST_FITTED).free[occasion], o.fix, sources
        )
        first = base.section(beginning.FIRST_FITTED)
        start = beginning.begin_at(problem, first, names, o, notes)
        untold = beginning.friction_left_untold(problem, start, o)
        for name, value in zip(compress(space.names, untold), before[untold], strict=True):
            notes.append(
                f"{name} is held at {value:.3g}: neither torques nor the speed of this motion "
                "tell it."
            )
        if untold.any():
            space = ParameterSpace(tuple(compress(space.parameters, ~untold)))
            problem = FitProblem(o.model, begun, space, sources, cost, held)
            start = start[:, ~untold]
            before = before[~untold]
    method = o.search or usual_search(o, problem)
    settings = o.settings(SETTINGS[method][o.model in SIMULATED])
    search = search_for(problem, settings, o, start, method)
    total = settings.generations + 1 + search.starts
    o.progress(Progress(total, total, "standard errors and scores"))
    report = _report_fit(o, problem, base, search, before, held_out)
    for sentence in report.worse:
        warn(sentence)
    return replace(report, remarks=[*notes, *report.remarks])


def _mentioned(o: Fit) -> list[str]:
    """Return the names of numbers that options fix, bound or guess."""
    return [*o.fix, *o.bounds, *(o.guess if isinstance(o.guess, Mapping) else ())]


def _held_turning(o: Fit) -> list[str]:
    """Return the frictions that resist turns which nobody asked for and the sources do not tell."""
    if o.free is not None or _occasion_of(o) != "scenario":
        return []
    return [n for n in beginning.untold_by_amplitude(o.model, o.names) if n not in _mentioned(o)]


def _report_fit(
    o: Fit,
    problem: FitProblem,
    base: Profile,
    search: Search,
    before: FloatArray,
    held_out: Sequence[Source],
) -> Fitted:
    """Return the report: the numbers with their uncertainty, and scores on all sources."""
    point = search.best
    sure = None
    notes = _source_notes(o, problem, base, held_out)
    notes += bound_sentences(problem.space, point)
    if _occasion_of(o) == "scenario":
        notes += beginning.amplitude_sentences(problem, _held_turning(o))
    if not search.interrupted:
        try:
            sure = estimate_uncertainty(search.coarser or problem, point, o.raters, search.driven)
            notes += uncertainty_sentences(problem, sure, point)
            notes.append(f"Standard errors come from: {sure.method}.")
            # the mean localiser of several logs is that of those which tell it best
            sound = np.isfinite(sure.share) & (sure.share > 0.0)
            problem.weights = np.where(sound, sure.share, IGNORANCE) ** -2.0
        except (SsmrError, np.linalg.LinAlgError) as error:
            notes.append(f"How sure numbers and predictions are could not be estimated: {error}.")
    fitted = problem.candidate(point)
    assert fitted is not None
    known = {} if sure is None else sure.spread
    # a day or two more do not tell how much days differ
    spread = {**known, **fitted.spread}
    if len(problem.days) >= FEWEST_DAYS:
        spread = {**fitted.spread, **known}
    fitted = replace(fitted, spread=spread)
    unfitted, judged, all_judged, _, undriven = held_out_scores([(problem, point, held_out)])
    notes += undriven
    options = o.chosen(search.jde.settings)
    options["held_out"] = tuple(map(source_name, o.held_out))
    options["search"] = search.method
    options["objective"] = problem.cost.objective
    options["yaw_weight"] = problem.cost.yaw_weight
    motions = [motions_of(problem, plant_on(problem, point, s), s) for s in problem.sources]
    train, together = scores_by_source(problem.sources, motions)
    begun = with_robot(base.name, base.robot.name)
    return Fitted(
        title=f"{o.model} fitted to {one_line(','.join(o.names))}, begun with profile {begun}",
        options=options,
        status=status_of(search),
        course=search,
        seed=o.seed,
        parameters=fitted_parameters(problem.space, point, before, sure),
        remarks=notes,
        asked=o,
        problem=problem,
        base=base,
        plant=fitted,
        sure=sure,
        train=train,
        together=together,
        held_out=judged,
        unfitted=unfitted,
        judged=all_judged,
    )


def _source_notes(
    o: Fit, problem: FitProblem, base: Profile, held_out: Sequence[Source]
) -> list[str]:
    """Sentences on the sources of the fit, and on those that were held out."""
    notes = []
    if o.profile is None and o.robot is None:
        for source in problem.sources:
            notes += unknown_robot_notes(source, base.robot)
    for source in (*problem.sources, *held_out):
        notes += [*source.remarks, *source.warnings]
        notes += standing_sentences(source, HEADLINE_HORIZON)
    return notes


if __name__ == "__main__":
    fit.main()
