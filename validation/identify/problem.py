"""The problem of a fit: points of the unit cube in, costs and errors out.

A cost is a sum over the pieces of all targets, and no term is negative. So a candidate whose sum
over the first pieces exceeds its parent's whole cost can never be selected, and the rest of it need
not be driven: the outcome is the same.

Several logs of a robot share its body, and each has its own localiser, and where asked its own
ground: a number NAME@TAG of the space is that of the logs with the tag alone.

The profile's numbers are a prior for a log: to leave one by its spread from day to day counts as
much as one block of time with errors of the usual size. So a log changes only what it tells. Far
from its middle the prior is as robust as errors are.
"""

from __future__ import annotations

import copy
import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from functools import partial
from itertools import chain
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from ssmr.errors import ParameterError
from ssmr.robot.drive import whole_steps
from ssmr.search.space import ParameterSpace
from ssmr.types import FloatArray, IndexArray
from validation.experiment.sources import RECORDING, Source
from validation.experiment.user_law import add_model_of, model_file
from validation.identify.objective import (
    FitCost,
    Objective,
    Rater,
    make_raters,
    true_motion,
    usual_torque_weight,
)
from validation.plants.kind import PlantProfile, Population
from validation.plants.searchable import find_number, own_indices, with_values
from validation.plants.table import STANDARD, plant_kind
from validation.simulator.description import Robot
from validation.simulator.physics import SEARCHING, SHIPPED
from validation.workers import rate_there

_CHUNK = 256
"""Candidates whose motions are kept at once where one loop drives them: tens of megabytes."""
_COARSER = 2.5
"""Ratio of the physics step of a search along a log to the profile's [1]: 5 ms for 2 ms. It moves a
Husky's path by about a millimetre in 6 s, mostly a lag of two to three steps, which is nearly the
same for neighbouring candidates."""
OnShare = Callable[[float], object] | None
"""Callback from any thread, with the share of a generation that is rated."""
IGNORANCE = 12.0**-0.5
"""Standard deviation of a number of which only the bounds are known, in the unit cube [1]."""
NORMAL = 1.4826
"""Standard deviation of normal errors over their median size [1]."""
FROM_FILE = 0.15
"""The same of a robot's numbers around those of its file, where no profile tells more: eight public
runs lie about as far off [1]."""
Tags = Sequence[str]
"""Names by which numbers are a log's own: its own name, and that of its ground."""


class Day(NamedTuple):
    """Sources whose motions one plant makes."""

    tags: Tags
    """Their tags."""
    columns: tuple[int, ...]
    """Columns of the space that their motions depend on."""
    raters: list[tuple[Rater, float]]
    """The rater of each of their pieces, and the period at which plants are sampled there [s]."""


class FitProblem:
    """Problem of a fit: candidates of one plant are rated by their distance from true motions."""

    _settings = SHIPPED
    """The physics with which simulated bodies are computed."""

    def __init__(
        self,
        model: str,
        base: PlantProfile,
        space: ParameterSpace,
        sources: Sequence[Source],
        cost: FitCost,
        held: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        """Begin with the numbers of `base`; an objective of None is chosen for the sources.

        `held` are numbers of single logs, by NAME@TAG, that stay as they are.

        Raises:
            ValueError: the sources are too short.
        """
        self.model = model
        self.base = base
        self.space = space
        # pieces are enough: logs would be sent to every worker
        self.sources = tuple(replace(source, inspected=None) for source in sources)
        self.held = dict(held)
        kind = plant_kind(model)
        objective: Objective = "sync" if kind.torques else "path"  # paths do not say when
        if any(source.reference == RECORDING for source in sources):
            objective = "horizon"
        self.cost = replace(cost, objective=cost.objective or objective)
        # torques of planar models are numbers of a fit, and say nothing of a body
        if not kind.torques:
            self.cost = replace(self.cost, torque_weight=0.0)
        elif cost.torque_weight is None:
            told = any(name.partition("@")[0] == "friction" for name in space.names)
            weight = usual_torque_weight(base.robot) if told else 0.0
            self.cost = replace(self.cost, torque_weight=weight)
        self._together = kind.together is not None  # one compiled loop drives all candidates
        self.days = self._make_days(make_raters(self.cost, self.sources))
        self._raters = list[Rater]()
        for day in self.days:
            self._raters += [rater for rater, _ in day.raters]
        self._seconds = sum(rater.piece.commands.duration for rater in self._raters)
        self.weights = np.ones(len(space))
        self._set_prior()

    def _make_days(self, raters: Sequence[Rater]) -> list[Day]:
        """Return the sources' raters, those of one plant together."""
        days: dict[tuple[tuple[int, ...], tuple[str, ...]], Day] = {}
        rest = iter(raters)
        for source in self.sources:
            tags = source.tags
            columns = tuple(sorted(chain(*own_indices(self.space.names, tags).values())))
            held = tags if self.held else ()
            day = days.setdefault((columns, held), Day(tags, columns, []))
            for _ in source.pieces:
                day.raters.append((next(rest), source.sample_dt))
        return list(days.values())

    def _set_prior(self) -> None:
        """Set how strongly the profile's numbers pull."""
        values = []
        spreads = []
        for name in self.space.names:
            values.append(find_number(self.model, name, self.base.robot).read(self.base))
            spreads.append(self.base.spread.get(name.partition("@")[0], np.nan))
        # a value of before may lie outside the bounds; its nearest point is the prior's centre
        within = np.clip(values, self.space.lower, self.space.upper)
        self.begun = self.space.points(within[None])[0]
        known = np.array(spreads) / self.space.slopes(self.begun)
        usual = np.where(np.isfinite(known), known, FROM_FILE)
        self.spread = usual if self.robust else np.full(len(known), np.inf)
        self._blocks = len(np.unique(self.blocks))
        # copies as small as other errors, so that they are robust alike
        copies = max(1, round(len(self.blocks) / self._blocks)) * self.robust
        self.pulls = copies * len(self.space)
        self._pull = NORMAL * math.sqrt(len(self.blocks) / (self._blocks * max(copies, 1)))

    def __reduce__(self) -> tuple[Any, ...]:
        """Let the file of a user's own model be run in another process before the rest arrives."""
        return _read_scattered_problem, (model_file(self.model),), self.__dict__

    def identity(self) -> dict[str, object]:
        """Return all that decides the costs, by name."""
        data = hashlib.sha256()
        for source in self.sources:
            data.update(source.name.rpartition("/")[2].encode(errors="surrogatepass"))
            for piece in source.pieces:
                truth = true_motion(piece)
                arrays = [piece.commands.values, truth.t, truth.pose, piece.headings, piece.torques]
                for array in arrays:
                    if array is not None:
                        data.update(np.ascontiguousarray(array).tobytes())
        return {
            "model": self.model,
            "parameters or bounds": self.space.limits(),
            "held and spread": [self.held, self.base.spread],
            "profile": self.base.numbers(),
            "robot": self.base.robot.as_document(),
            "objective": asdict(self.cost),
            "sources": data.hexdigest(),
        }

    def coarser(self) -> FitProblem | None:
        """Return this problem with a longer physics step, which costs less.

        None stands for planar models, for scenarios, and for periods that are no whole number of
        longer steps.
        """
        if not self.robust or self.model != STANDARD:
            return None
        step = _COARSER * self.base.parameters.timestep
        try:
            for period in {self.base.drive.hold, *(source.sample_dt for source in self.sources)}:
                whole_steps(period, step, "the period")
            problem = self._with_numbers(timestep=step)
        except ParameterError:
            return None
        problem._settings = SEARCHING
        return problem

    def with_other_tyres(self) -> FitProblem | None:
        """Return this problem with tyres of another shape, where that is guessed and moves torques.

        None stands for problems without torques, for scenarios, and for a robot whose file says it.
        """
        is_known = "simulation.wheel_shape" in self.base.robot.given
        if is_known or not (self.torques and self.robust and self.model == STANDARD):
            return None
        shape = self.base.parameters.wheel_shape
        if shape == "capsule":
            # the other shapes have no friction_ratio; this wide, it is a cylinder that has one
            return self._with_numbers(capsule_half_width=0.5 * self.base.robot.wheel_width)
        return self._with_numbers(wheel_shape="ellipsoid" if shape == "cylinder" else "cylinder")

    def _with_numbers(self, **numbers: float | str) -> FitProblem:
        """Return this problem with other numbers in the plant of before."""
        problem = copy.copy(self)
        parameters = replace(self.base.parameters, **numbers)
        problem.base = replace(self.base, parameters=parameters)
        return problem

    def candidate(self, point: FloatArray, tags: Tags = ()) -> PlantProfile | None:
        """Return the plant at an (n,) point of the unit cube; None where numbers are impossible.

        It is that of logs with some tags; where none of the fitted logs has them, numbers that
        differ between logs have their mean by the `weights`.
        """
        values = self.space.values(point).tolist()
        weights = self.weights.tolist()
        base = self.before(tags)
        try:
            return with_values(self.model, base, self.space.names, values, tags, weights)
        except ValueError:
            return None

    def before(self, tags: Tags) -> PlantProfile:
        """Return the plant of before the fit on logs with some tags."""
        held = {k: v for k, v in self.held.items() if k.partition("@")[2] in tags}
        return with_values(self.model, self.base, list(held), held.values(), tags)

    @property
    def robust(self) -> bool:
        """Whether errors beyond their median count by size, not by square: those of recordings."""
        return self.cost.objective == "horizon"

    @property
    def cheap(self) -> bool:
        """Whether many motions cost little: those of planar models along scenarios."""
        return self._together and self.cost.objective != "horizon"

    @property
    def dear(self) -> bool:
        """Whether candidates are driven one by one: those of bodies on wheels."""
        return not self._together

    @property
    def blocks(self) -> FloatArray:
        """(K,) number of the block of time that each residual belongs to."""
        return np.concatenate([rater.blocks for rater in self._raters])

    @property
    def day_numbers(self) -> IndexArray:
        """(K,) number of the day that each residual belongs to."""
        sizes = [sum(len(rater.blocks) for rater, _ in day.raters) for day in self.days]
        return np.repeat(np.arange(len(sizes)), sizes)

    @property
    def torques(self) -> bool:
        """Whether torques are compared."""
        return any(rater.torques is not None for rater in self._raters)

    def costs(
        self,
        points: FloatArray,
        limits: FloatArray | None = None,
        workers: int | str = 1,
        on_share: OnShare = None,
    ) -> FloatArray:
        """Return the (S,) costs of (S, n) points of the unit cube; infinite for a failed one.

        A candidate whose partial sum exceeds its own of (S,) `limits` is abandoned, and that sum is
        returned. The result does not depend on `workers`: threads, or a scheduler's address.
        `on_share` is called with the share of the work that is done.
        """
        bounds = np.full(len(points), np.inf) if limits is None else limits
        if isinstance(workers, str):
            return rate_there(workers, self, "costs", (points, bounds), on_share)
        far = (points - self.begun) / self.spread
        # nobody knows the size of errors, so their likelihood is a power of their mean size
        factor = np.exp((np.sqrt(1.0 + far**2) - 1.0).sum(axis=1) / self._blocks)
        costs = np.zeros(len(points))
        total = self._seconds * len(points)
        # a list, which threads can add to
        done = [0.0]

        def rate(day: Day, population: Population, which: slice, threads: int) -> FloatArray:
            sums = costs[which].copy()
            for rater, dt in day.raters:
                promising = np.isfinite(sums) & (sums * factor[which] <= bounds[which])
                live = np.flatnonzero((sums == 0.0) | promising)
                if len(live):
                    motions = population.motions(list(live), rater.piece, dt)
                    terms = rater.cost(motions, threads)
                    sums[live] += np.where(np.isfinite(terms), terms, np.inf)
                done[0] += rater.piece.commands.duration * len(sums) / total
                if on_share is not None:
                    on_share(done[0])
            return sums

        for day in self.days:
            costs = self._side_by_side(partial(rate, day), day.tags, points, workers)
        return costs * factor

    def residuals(self, points: FloatArray, workers: int | str = 1) -> FloatArray:
        """Return (S, K) errors whose squares least squares make small; NaN for an impossible point.

        The `blocks` number the errors of motions; so many `pulls` of the prior follow, in the unit
        of the errors' median size. Points that differ in numbers of other logs alone make one
        motion of a log.
        """
        if isinstance(workers, str):
            return rate_there(workers, self, "residuals", (points,))

        def rate(day: Day, population: Population, which: slice, threads: int) -> FloatArray:
            every = range(which.stop - which.start)
            residuals = []
            for rater, dt in day.raters:
                motions = population.motions(every, rater.piece, dt)
                residuals.append(rater.residuals(motions, threads))
            return np.concatenate(residuals, axis=1)

        columns = []
        for day in self.days:
            own = points[:, list(day.columns)]
            _, first, back = np.unique(own, axis=0, return_index=True, return_inverse=True)
            errors = self._side_by_side(partial(rate, day), day.tags, points[first], workers)
            columns.append(errors[back.ravel()])
        pulls = self._pull * (points - self.begun) / self.spread
        columns.append(np.tile(pulls, self.pulls // len(self.space)))
        return np.concatenate(columns, axis=1)

    def _side_by_side(
        self,
        rate: Callable[[Population, slice, int], FloatArray],
        tags: Tags,
        points: FloatArray,
        workers: int,
    ) -> FloatArray:
        """Rate (S, n) points on a log with some tags, many at once or each on a thread of its own.

        An interrupt drops those that have not begun.
        """
        candidates = [self.candidate(point, tags) for point in points]
        size = _CHUNK if self._together else 1

        def share(first: int) -> FloatArray:
            which = slice(first, min(first + size, len(points)))
            population = plant_kind(self.model).population(
                candidates[which], workers, self._settings
            )
            return rate(population, which, workers if size > 1 else 1)

        firsts = range(0, len(points), size)
        # a compiled loop has threads of its own; a simulator's plants are driven side by side
        if self._together or workers == 1:
            return np.concatenate(list(map(share, firsts)))
        pool = ThreadPoolExecutor(workers)
        try:
            return np.concatenate(list(pool.map(share, firsts)))
        finally:
            pool.shutdown(cancel_futures=True)


def _read_scattered_problem(file: tuple[str, str, str] | None) -> FitProblem:
    if file is not None:
        add_model_of(file)
    return FitProblem.__new__(FitProblem)


def turning_doubt(robot: Robot) -> float:
    """Return the standard error of a wheel separation's multiplier by mechanics [1].

    It is what a fit allows the sides' centres of rotation beside those of a robot's file.
    """
    sides = [find_number("kinematic", name, robot) for name in ("y_l", "y_r")]
    return FROM_FILE * math.hypot(*(side.upper - side.lower for side in sides)) / robot.track
