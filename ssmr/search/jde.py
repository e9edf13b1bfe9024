"""Self-adaptive differential evolution (jDE) with the thesis' descent of F and CR, in the unit cube, by ask and tell.

The search owns no loop and no objective: `ask` hands out a whole generation, `tell` takes its costs. Sources: thesis
Sec. 3.5.1 (mutation, adaptation, Alg. 3) and Tab. 3.7 (defaults); Brest et al. 2006, doi 10.1109/TEVC.2006.872133 (jDE).

Symbols: S vectors (NP) of n genes, i one of them, G a generation; F scales differences, CR is the share of genes crossed.

Where the thesis leaves a choice, or prints something that cannot be:

- F is drawn anew as F_min + (F_max - F_min) rand; F_min + F_max rand, as printed, leaves the bounds of Tab. 3.7.
- F and CR belong to the vector: a trial that replaces its parent brings its own, otherwise the parent keeps what it had.
  The equations name no such condition, but Sec. 3.5.1 encodes F and CR in the members of the population, as jDE does, and
  only so does selection act on them. Kept always, they would descend in every generation between two draws, late in a
  search by a fifth each, most of them down to the least. Short trials in 6 dimensions favoured neither way throughout.
- "rand <= tau" is tested as rand < tau, which for rand in [0, 1) has the probability tau exactly.
- Alg. 3 stops at the first generation that improves by no more than df. That happens by chance after a few generations,
  so the improvement is taken over `patience` generations; 1 is the thesis as printed.
- A gene of a donor beyond a bound is put midway between the base vector (the best, or r1) and that bound. Searches keep
  approaching an optimum at a bound, and no vector is thrown back into the cube at random.
- The parent's cost is remembered, not evaluated again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssmr.types import FloatArray, frozen_array

Strategy = Literal["best/2", "rand/1", "best/1"]
Crossover = Literal["bin", "exp"]
Finished = Literal["", "generations", "improvement", "target"]
IndexArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]

VERSION = "ssmr.jde/1"
"""Of the layout of `Jde.state`, and of what is drawn in which order."""
PARTNERS: Mapping[str, int] = {"best/2": 4, "rand/1": 3, "best/1": 2}
"""How many vectors, distinct and other than i, a strategy draws (nr of Tab. 3.7)."""
CROSSOVERS = ("bin", "exp")

_LOWER_64 = (1 << 64) - 1


@dataclass(frozen=True)
class JdeSettings:
    """What steers a search; the defaults are Tab. 3.7."""

    population: int = 50
    """S, vectors in a generation (NP)."""
    generations: int = 300
    """Most generations after the initial population (n_gen, ng_max)."""
    strategy: Strategy = "best/2"
    """Mutation: `best/2` is the thesis' choice; `rand/1` is slower but leaves local minima."""
    crossover: Crossover = "bin"
    """`bin` chooses each gene by itself, `exp` a run of neighbours."""
    f_init: float = 0.75
    """F of every vector at first [1]."""
    f_bounds: tuple[float, float] = (0.1, 0.9)
    """Least and greatest F [1]."""
    cr_init: float = 0.8
    """CR of every vector at first [1]."""
    cr_bounds: tuple[float, float] = (0.0, 1.0)
    """Least and greatest CR [1]."""
    tau_f: float = 0.1
    """Probability of a new F (tau_1) [1]."""
    tau_cr: float = 0.1
    """Probability of a new CR (tau_2) [1]."""
    slope: float = 0.2
    """Share of F and CR by which they descend, in proportion to the generations gone (slp) [1]; 0 is the classic jDE."""
    df: float = 1e-3
    """Stop when the best cost improved by no more than this share of its size [1] ..."""
    patience: int = 30
    """... over this many generations; more than `generations` turns the rule off."""
    target: float = -math.inf
    """Stop when the best cost is at or below this [unit of the cost]."""

    def __post_init__(self) -> None:
        """Check.

        Raises:
            ValueError: a name is unknown, a number is out of its range, or there are too few vectors for the strategy.
        """
        if self.strategy not in PARTNERS:
            raise ValueError(f"unknown strategy '{self.strategy}'; there are: {', '.join(PARTNERS)}")
        if self.crossover not in CROSSOVERS:
            raise ValueError(f"unknown crossover '{self.crossover}'; there are: {', '.join(CROSSOVERS)}")
        for name, least in (("population", 1 + PARTNERS[self.strategy]), ("generations", 1), ("patience", 1)):
            if not getattr(self, name) >= least:
                for_strategy = f" for {self.strategy}" if name == "population" else ""
                raise ValueError(f"{name} must be at least {least}{for_strategy}, got {getattr(self, name)}")
        for name, most in (("f", 2.0), ("cr", 1.0)):
            low, high = getattr(self, f"{name}_bounds")
            if not 0.0 <= low <= high <= most:
                raise ValueError(f"{name}_bounds must increase within 0 and {most:g}, got {low:g} and {high:g}")
            _require_within(f"{name}_init", getattr(self, f"{name}_init"), low, high)
        for name in ("tau_f", "tau_cr", "slope"):
            _require_within(name, getattr(self, name), 0.0, 1.0)
        if not 0.0 <= self.df < math.inf:
            raise ValueError(f"df must be finite and not negative, got {self.df:g}")
        if math.isnan(self.target):
            raise ValueError("target must be a number, got nan")


def _require_within(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise ValueError(f"{name} must lie within {low:g} and {high:g}, got {value:g}")


def adapt(values: FloatArray, draws: FloatArray, bounds: tuple[float, float], tau: float, descent: float) -> FloatArray:
    """F or CR of the trials (Sec. 3.5.1): drawn anew with the probability tau, else descended, but not below the least.

    Args:
        values: (S,) F or CR of the parents.
        draws: (2, S) uniform in [0, 1): whether to draw anew, and what.
        bounds: least and greatest.
        tau: probability of a new value.
        descent: slp (ng - 1) / ng_max.

    Returns:
        (S,) values within the bounds.
    """
    low, high = bounds
    return np.where(draws[0] < tau, low + (high - low) * draws[1], np.maximum(values - values * descent, low))


def distinct_partners(draws: FloatArray) -> IndexArray:
    """For each i, k indices that differ from each other and from i; every ordered choice is equally likely.

    The j-th index is drawn from the S - 1 - j that are left, then counted past the taken ones in increasing order.

    Args:
        draws: (k, S) uniform in [0, 1), k < S.

    Returns:
        (k, S) indices within 0 and S - 1; column i belongs to vector i.
    """
    k, size = draws.shape
    left = (size - 1 - np.arange(k, dtype=np.float64))[:, np.newaxis]
    indices = (draws * left).astype(np.intp)
    taken = [np.arange(size)]  # increasing, for each column
    for j in range(k):
        index = indices[j]
        for t in taken:
            index += index >= t
        if j + 1 < k:
            carried = index
            for m, t in enumerate(taken):
                taken[m], carried = np.minimum(t, carried), np.maximum(t, carried)
            taken.append(carried)
    return indices


def mutate(
    strategy: Strategy, population: FloatArray, best: FloatArray, f: FloatArray, partners: IndexArray
) -> tuple[FloatArray, FloatArray]:
    """Donors V_i before repair, and the base vectors they start from.

    best/2: V = X_best + F (X_r1 - X_r2) + F (X_r3 - X_r4) (Sec. 3.5.1); best/1: V = X_best + F (X_r1 - X_r2);
    rand/1: V = X_r1 + F (X_r2 - X_r3).

    Args:
        strategy: which of them.
        population: (S, n) parents.
        best: (n,) the best of them.
        f: (S,) F of the trials.
        partners: (k, S) indices r1 to rk.

    Returns:
        (n,) or (S, n) base vectors and (S, n) donors, which may leave the cube.
    """
    x = population[partners]
    if strategy == "rand/1":
        base, difference = x[0], x[1] - x[2]
    else:
        base, difference = best, x[0] - x[1]
        if strategy == "best/2":
            difference += x[2]
            difference -= x[3]
    difference *= f[:, np.newaxis]
    difference += base
    return base, difference


def repair(donors: FloatArray, base: FloatArray) -> FloatArray:
    """Genes beyond a bound of the cube, put midway between the base vector's gene and that bound.

    Args:
        donors: (S, n) any finite numbers.
        base: (n,) or (S, n) within the cube.

    Returns:
        (S, n) within the cube.
    """
    inside = np.where(donors < 0.0, 0.5 * base, donors)
    return np.where(donors > 1.0, 0.5 + 0.5 * base, inside)


def binomial_mask(cr: FloatArray, draws: FloatArray, first: IndexArray) -> BoolArray:
    """Which genes come from the donor: each with the probability CR, and gene `first` always.

    Args:
        cr: (S,) CR of the trials.
        draws: (S, n) uniform in [0, 1).
        first: (S,) one gene of each.

    Returns:
        (S, n) mask.
    """
    mask = draws < cr[:, np.newaxis]
    mask[np.arange(len(cr)), first] = True
    return mask


def exponential_mask(cr: FloatArray, draws: FloatArray, first: IndexArray, n: int) -> BoolArray:
    """Which genes come from the donor: a run from `first`, around the end; the p-th after it with the probability CR^p.

    Args:
        cr: (S,) CR of the trials.
        draws: (S,) uniform in [0, 1).
        first: (S,) where the run begins.
        n: how many genes there are.

    Returns:
        (S, n) mask.
    """
    after = (np.arange(n) - first[:, np.newaxis]) % n
    return draws[:, np.newaxis] < cr[:, np.newaxis] ** after


def replaces(trial_costs: FloatArray, parent_costs: FloatArray) -> BoolArray:
    """(S,) which trials replace their parents: those of finite cost that are not worse."""
    return np.isfinite(trial_costs) & (trial_costs <= parent_costs)


class Jde:
    """One search. `while not search.finished: search.tell(costs_of(search.ask()))`."""

    def __init__(self, n: int, settings: JdeSettings, seed: int, start: ArrayLike | None = None) -> None:
        """Draw the initial population.

        Args:
            n: how many genes a vector has.
            settings: what steers the search.
            seed: of the one random generator; equal seeds give equal searches.
            start: (k, n) points of the unit cube that replace the first k vectors drawn, or None.

        Raises:
            ValueError: n is not positive, the seed is negative, or the start is not in the cube or has more than S rows.
        """
        if n < 1:
            raise ValueError(f"a search needs at least one parameter, got {n}")
        if seed < 0:
            raise ValueError(f"the seed must not be negative, got {seed}")
        self.n, self.settings = n, settings
        size = settings.population
        self._rng = np.random.Generator(np.random.PCG64(seed))
        self._population = self._rng.random((size, n))
        if start is not None:
            points = frozen_array(start, "start", (None, n))
            if len(points) > size:
                raise ValueError(f"start has {len(points)} points, more than the population of {size}")
            _require_cube(points, "start")
            self._population[: len(points)] = points
        self._costs = np.full(size, np.inf)
        self._f, self._cr = np.full(size, settings.f_init), np.full(size, settings.cr_init)
        self._history: list[float] = []
        self._best = 0
        self._asked = False
        self._trials, self._trial_f, self._trial_cr = self._population, self._f, self._cr

    @property
    def generation(self) -> int:
        """Generations told after the initial population."""
        return max(0, len(self._history) - 1)

    @property
    def evaluations(self) -> int:
        """Costs told, those of the initial population included."""
        return self.settings.population * len(self._history)

    @property
    def best(self) -> FloatArray:
        """(n,) the vector of least cost so far; the first one while no cost is known."""
        return self._population[self._best].copy()

    @property
    def best_cost(self) -> float:
        """Least cost so far; infinite while none is known."""
        return float(self._costs[self._best])

    @property
    def population(self) -> FloatArray:
        """(S, n) parents."""
        return self._population.copy()

    @property
    def costs(self) -> FloatArray:
        """(S,) costs of the parents; infinite where unknown."""
        return self._costs.copy()

    @property
    def history(self) -> FloatArray:
        """(G + 1,) best cost after the initial population and after each generation."""
        return np.array(self._history)

    @property
    def finished(self) -> Finished:
        """Why the search is over, or an empty string while it is not; the first rule that holds, in this order.

        `target`: the best cost is at or below the target. `improvement`: over the last `patience` generations the best cost
        fell by no more than df times its size before; a cost that was unknown then does not count. `generations`: all done.
        """
        if self._history and self.best_cost <= self.settings.target:
            return "target"
        g, patience = self.generation, self.settings.patience
        if g >= patience:
            before, now = self._history[g - patience], self._history[g]
            if math.isfinite(before) and before - now <= self.settings.df * abs(before):
                return "improvement"
        return "generations" if g >= self.settings.generations else ""

    def ask(self) -> FloatArray:
        """The points whose costs are wanted: the initial population first, then the trials of the next generation.

        Asked again before the costs were told, it gives the same points. Random numbers are drawn here only, as many for
        each generation, whatever the costs.

        Returns:
            (S, n) points of the unit cube.

        Raises:
            ValueError: the search has finished.
        """
        if not self._asked:
            if self.finished:
                raise ValueError(f"the search has finished ({self.finished}); there is nothing to ask")
            if self._history:
                self._trials, self._trial_f, self._trial_cr = self._next_trials()
            self._asked = True
        return self._trials.copy()

    def _next_trials(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(S, n) trials, (S,) their F and (S,) their CR."""
        s, n = self.settings, self.n
        size, k = s.population, PARTNERS[s.strategy]
        binomial = s.crossover == "bin"
        draws = self._rng.random((5 + k + (n if binomial else 1)) * size)
        rows = draws[: (5 + k) * size].reshape(5 + k, size)
        crossing = draws[(5 + k) * size :]
        descent = s.slope * self.generation / s.generations  # ng - 1 generations are complete
        f = adapt(self._f, rows[0:2], s.f_bounds, s.tau_f, descent)
        cr = adapt(self._cr, rows[2:4], s.cr_bounds, s.tau_cr, descent)
        first = (rows[4] * n).astype(np.intp)
        base, donors = mutate(s.strategy, self._population, self._population[self._best], f, distinct_partners(rows[5:]))
        if binomial:
            mask = binomial_mask(cr, crossing.reshape(size, n), first)
        else:
            mask = exponential_mask(cr, crossing, first, n)
        return np.where(mask, repair(donors, base), self._population), f, cr

    def tell(self, costs: ArrayLike) -> None:
        """Take the costs of the points asked for, and select: a trial replaces its parent unless it is worse.

        A cost that is NaN or infinite counts as worse than any. A lower bound of a trial's cost will do where it exceeds the
        parent's cost, as an evaluation broken off gives it: the outcome is the same.

        Args:
            costs: (S,) in the order of the points.

        Raises:
            ValueError: nothing was asked, or the shape is another one.
        """
        if not self._asked:
            raise ValueError("costs are told, but no points were asked for")
        told = np.asarray(costs, dtype=np.float64)
        if told.shape != self._costs.shape:
            raise ValueError(f"costs have shape {told.shape}, wanted {self._costs.shape}")
        won = replaces(told, self._costs)
        self._costs = np.where(won, told, self._costs)
        if self._history:
            self._population = np.where(won[:, np.newaxis], self._trials, self._population)
            self._f, self._cr = np.where(won, self._trial_f, self._f), np.where(won, self._trial_cr, self._cr)
        self._best = int(np.argmin(self._costs))
        self._history.append(float(self._costs[self._best]))
        self._asked = False

    def state(self) -> dict[str, NDArray[Any]]:
        """All that the search is, as arrays that `numpy.savez` keeps without pickle; points asked for and not told included.

        Returns:
            Copies by name; settings under `settings.<name>`.
        """
        generator: Any = self._rng.bit_generator.state
        words = [generator["state"][key] for key in ("state", "inc")]
        return {
            "version": np.array(VERSION),
            **{f"settings.{f.name}": _setting(getattr(self.settings, f.name), f.default) for f in fields(JdeSettings)},
            "rng": np.array([half for word in words for half in (word >> 64, word & _LOWER_64)], dtype=np.uint64),
            "population": self.population,
            "costs": self.costs,
            "f": self._f.copy(),
            "cr": self._cr.copy(),
            "history": self.history,
            "asked": np.array(self._asked),
            "trials": self._trials.copy(),
            "trial_f": self._trial_f.copy(),
            "trial_cr": self._trial_cr.copy(),
        }

    @classmethod
    def restore(cls, state: Mapping[str, NDArray[Any]]) -> Jde:
        """The search that `state` was taken from; it goes on bit for bit as that one would.

        Raises:
            ValueError: the state is none: names are missing, or shapes, numbers or the version are wrong.
        """
        wanted = Jde(1, JdeSettings(), 0).state().keys()
        missing = sorted(wanted - set(state))
        if missing:
            raise ValueError(f"this is no state of a search: {', '.join(missing)} missing")
        if str(state["version"]) != VERSION:
            raise ValueError(f"the state has the version '{state['version']}', wanted '{VERSION}'")
        settings = _restored_settings(state)
        population = _cube(state, "population", (settings.population, None))
        size, n = population.shape
        search = cls(n, settings, 0)
        search._population, search._trials = population, _cube(state, "trials", (size, n))
        search._f, search._trial_f = (_within(state, key, size, settings.f_bounds) for key in ("f", "trial_f"))
        search._cr, search._trial_cr = (_within(state, key, size, settings.cr_bounds) for key in ("cr", "trial_cr"))
        search._costs, history = _numbers(state, "costs", (size,)), _numbers(state, "history", (None,))
        if np.isnan(search._costs).any() or np.isneginf(search._costs).any():
            raise ValueError("costs of the state are neither numbers nor unknown")
        search._best, search._history = int(np.argmin(search._costs)), [float(h) for h in history]
        if len(history) > 1 + settings.generations or np.any(history[1:] > history[:-1]):
            raise ValueError("history of the state is none: it is too long, or it grows")
        if search.best_cost != (search._history[-1] if search._history else math.inf):
            raise ValueError("costs and history of the state do not agree")
        search._asked = bool(_array(state, "asked", (), "b"))
        rng = [int(half) for half in _array(state, "rng", (4,), "u")]
        search._rng.bit_generator.state = {
            "bit_generator": "PCG64",
            "state": {"state": rng[0] << 64 | rng[1], "inc": rng[2] << 64 | rng[3]},
            "has_uint32": 0,  # only doubles are ever drawn
            "uinteger": 0,
        }
        return search


def _require_cube(points: FloatArray, name: str) -> None:
    outside = ~((points >= 0.0) & (points <= 1.0))
    if outside.any():
        row, k = (int(i) for i in np.argwhere(outside)[0])
        raise ValueError(f"{name} leaves the unit cube: {points[row, k]:g} at index {(row, k)}")


def _array(state: Mapping[str, NDArray[Any]], key: str, shape: tuple[int | None, ...], kinds: str) -> NDArray[Any]:
    """An array of the state, whose shape (None: any length) and kind of numbers are checked."""
    array = np.asarray(state[key])
    if array.ndim != len(shape) or any(w is not None and g != w for g, w in zip(array.shape, shape, strict=True)):
        raise ValueError(f"{key} of the state has shape {array.shape}")
    if array.dtype.kind not in kinds:
        raise ValueError(f"{key} of the state has the type {array.dtype}")
    return array


def _numbers(state: Mapping[str, NDArray[Any]], key: str, shape: tuple[int | None, ...]) -> FloatArray:
    return np.array(_array(state, key, shape, "f"), dtype=np.float64)


def _cube(state: Mapping[str, NDArray[Any]], key: str, shape: tuple[int | None, ...]) -> FloatArray:
    points = _numbers(state, key, shape)
    _require_cube(points, f"{key} of the state")
    return points


def _within(state: Mapping[str, NDArray[Any]], key: str, size: int, bounds: tuple[float, float]) -> FloatArray:
    values = _numbers(state, key, (size,))
    if not np.all((values >= bounds[0]) & (values <= bounds[1])):
        raise ValueError(f"{key} of the state leaves its bounds, {bounds[0]:g} to {bounds[1]:g}")
    return values


def _setting(value: Any, default: Any) -> NDArray[Any]:
    """A setting as an array of its default's type: a 0 given for a float is kept as 0.0."""
    return np.array(value) if isinstance(default, str) else np.array(value, dtype=np.array(default).dtype)


def _restored_settings(state: Mapping[str, NDArray[Any]]) -> JdeSettings:
    """The settings in a state; each has the shape and the kind that the default has."""
    kinds: dict[type, str] = {int: "iu", float: "f", str: "U", tuple: "f"}
    values: dict[str, Any] = {}
    for field in fields(JdeSettings):
        kind = type(field.default)
        value = _array(state, f"settings.{field.name}", (2,) if kind is tuple else (), kinds[kind]).tolist()
        values[field.name] = tuple(value) if kind is tuple else value
    return JdeSettings(**values)
