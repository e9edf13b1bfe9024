"""Self-adaptive differential evolution (jDE) with the thesis' descent of F and CR, in the unit cube, by ask and tell.

The search owns no loop and no objective: `ask` hands out a whole generation, `tell` takes its
costs. Sources: thesis Sec. 3.5.1 (mutation, adaptation, Alg. 3) and Tab. 3.7 (defaults); J. Brest
et al. 2006, doi 10.1109/TEVC.2006.872133 (jDE).

Where the thesis leaves a choice, or prints something that cannot be:

- F is drawn anew as F_min + (F_max - F_min) rand; F_min + F_max rand, as printed, leaves the bounds
of Tab. 3.7.
- F and CR belong to the vector: a trial that replaces its parent brings its own, otherwise the
  parent keeps what it had. The equations name no such condition, but Sec. 3.5.1 encodes F and CR in
  the members of the population, as jDE does, and only so does selection act on them
  (docs/identification.md compares both).
- "rand <= tau" is tested as rand < tau, which for rand in [0, 1) has the probability tau exactly.
- Alg. 3 stops at the first generation that improves by no more than df. That happens by chance
  after a few generations, so the improvement is taken over `patience` generations; 1 is the thesis
  as printed.
- A gene of a donor beyond a bound is put midway between the best vector and that bound. Searches
  keep approaching an optimum at a bound, and no vector is thrown back into the cube at random.
- The parent's cost is remembered, not evaluated again.

Symbols: S vectors (NP) of n genes, i one of them; F scales differences, CR is the share of genes
crossed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssmr.parameters import MOST_SEED, require_within
from ssmr.types import FloatArray, IndexArray, frozen_array

F_INIT, F_BOUNDS = 0.75, (0.1, 0.9)
"""Initial F of every vector, and the least and greatest F [1]; Tab. 3.7, as all that follow."""
CR_INIT, CR_BOUNDS = 0.8, (0.0, 1.0)
"""Initial CR of every vector, and the least and greatest CR [1]."""
TAU = 0.1
"""Probability of a new F, and of a new CR (tau_1, tau_2) [1]."""
SLOPE = 0.2
"""Share of F and CR by which they are lowered, in proportion to the generations gone (slp) [1]."""
PARTNERS = 4
"""Number of vectors, distinct and other than i, from which a donor is made (nr)."""
Finished = Literal["", "generations", "improvement"]

VERSION = "ssmr.jde/2"
"""Version of the layout of `Jde.state`, and of the order in which random numbers are drawn."""
_MOST_VECTORS, _MOST_GENERATIONS = 100_000, 1_000_000
"""Greatest size and length of a search: beyond, its state does not fit into memory or a
checkpoint."""
_LOWER_64 = (1 << 64) - 1


@dataclass(frozen=True)
class JdeSettings:
    """Size of a search and its stop rules; the defaults are those of Tab. 3.7, but for `patience`."""

    population: int = 50
    """Number of vectors in a generation, S (NP)."""
    generations: int = 300
    """Greatest number of generations after the initial population (n_gen, ng_max)."""
    df: float = 1e-3
    """Stop when the best cost improved by no more than this share of its size [1] ..."""
    patience: int = 30
    """... over this many generations; more than `generations` turns the rule off."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a number out of its range."""
        require_within(self, ("population",), 1 + PARTNERS, _MOST_VECTORS, whole=True)
        require_within(self, ("generations",), 1, _MOST_GENERATIONS, whole=True)
        require_within(self, ("patience",), 1, 1_000_000_000, whole=True)
        require_within(self, ("df",), 0.0, 1e6)


class Jde:
    """One search. `while not search.finished: search.tell(costs_of(search.ask()))`."""

    def __init__(
        self, n: int, settings: JdeSettings, seed: int, start: ArrayLike | None = None
    ) -> None:
        """Draw the initial population of vectors of n genes; (k, n) points of the cube replace the first k drawn.

        Equal seeds give equal searches.

        Raises:
            ValueError: n is not positive, the seed is negative, or the start has more than S rows.
        """
        if n < 1:
            raise ValueError(f"a search needs at least one parameter, got {n}")
        if not 0 <= seed <= MOST_SEED:
            raise ValueError(f"the seed must not be negative, nor greater than {MOST_SEED}")
        self.n, self.settings = n, settings
        size = settings.population
        self._rng = np.random.Generator(np.random.PCG64(seed))
        self._population = self._rng.random((size, n))
        if start is not None:
            points = frozen_array(start, "start", (None, n))
            if len(points) > size:
                raise ValueError(
                    f"start has {len(points)} points, more than the population of {size}"
                )
            self._population[: len(points)] = points
        self._costs = np.full(size, np.inf)
        self._f, self._cr = np.full(size, F_INIT), np.full(size, CR_INIT)
        self._history: list[float] = []
        self._best = 0
        self._asked = False
        self._trials, self._trial_f, self._trial_cr = self._population, self._f, self._cr

    @property
    def generation(self) -> int:
        """Number of generations told after the initial population."""
        return max(0, len(self._history) - 1)

    @property
    def evaluations(self) -> int:
        """Number of costs told, those of the initial population included."""
        return self.settings.population * len(self._history)

    @property
    def best(self) -> FloatArray:
        """(n,) the vector of least cost so far; the first one while no cost is known."""
        return np.array(self._population[self._best])

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
        """Reason why the search is over, or an empty string while it is not: the first of these rules that holds.

        `improvement`: over the last `patience` generations the best cost fell by no more than df
        times its size before; a cost that was unknown then does not count. `generations`: all done.
        """
        g, patience = self.generation, self.settings.patience
        if g >= patience:
            before, now = self._history[g - patience], self._history[g]
            if math.isfinite(before) and before - now <= self.settings.df * abs(before):
                return "improvement"
        return "generations" if g >= self.settings.generations else ""

    def ask(self) -> FloatArray:
        """Return the (S, n) points whose costs are wanted: the initial population first, then the trials of each generation.

        A second call before the costs are told returns equal points. Random numbers are drawn here
        only, as many for each generation, whatever the costs.

        Raises:
            ValueError: the search has finished.
        """
        if not self._asked:
            if self.finished:
                raise ValueError(
                    f"the search has finished ({self.finished}); there is nothing to ask"
                )
            if self._history:
                self._trials, self._trial_f, self._trial_cr = self._next_trials()
            self._asked = True
        return self._trials.copy()

    def _next_trials(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return (S, n) trials, (S,) their F and (S,) their CR."""
        n, k, size = self.n, PARTNERS, self.settings.population
        draws = self._rng.random((5 + k + n) * size)
        rows = draws[: (5 + k) * size].reshape(5 + k, size)
        crossing = draws[(5 + k) * size :]
        descent = (
            SLOPE * self.generation / self.settings.generations
        )  # ng - 1 generations are complete
        f, cr = (
            adapt(self._f, rows[0:2], F_BOUNDS, descent),
            adapt(self._cr, rows[2:4], CR_BOUNDS, descent),
        )
        first = (rows[4] * n).astype(np.intp)
        best = self._population[self._best]
        donors = repair(mutate(self._population, best, f, distinct_partners(rows[5:])), best)
        mask = binomial_mask(cr, crossing.reshape(size, n), first)
        return np.where(mask, donors, self._population), f, cr

    def tell(self, costs: ArrayLike) -> None:
        """Take the (S,) costs of the points asked for, and select: a trial replaces its parent unless it is worse.

        A cost that is NaN or infinite counts as worse than any. A lower bound of a trial's cost
        will do where it exceeds the parent's cost, as an evaluation broken off gives it: the
        outcome is the same.

        Raises:
            ValueError: nothing was asked, or the shape is another one.
        """
        if not self._asked:
            raise ValueError("costs are told, but no points were asked for")
        new_costs = np.asarray(costs, dtype=np.float64)
        if new_costs.shape != self._costs.shape:
            raise ValueError(f"costs have shape {new_costs.shape}, wanted {self._costs.shape}")
        won = replaces(new_costs, self._costs)
        self._costs = np.where(won, new_costs, self._costs)
        if self._history:
            self._population = np.where(won[:, np.newaxis], self._trials, self._population)
            self._f, self._cr = (
                np.where(won, self._trial_f, self._f),
                np.where(won, self._trial_cr, self._cr),
            )
        self._best = int(np.argmin(self._costs))
        self._history.append(float(self._costs[self._best]))
        self._asked = False

    def state(self) -> dict[str, NDArray[Any]]:
        """Return the whole search as arrays that `numpy.savez` keeps without pickle, points asked for but not told included.

        Settings have names such as `settings.<name>`.
        """
        generator: Any = self._rng.bit_generator.state
        words = [generator["state"][key] for key in ("state", "inc")]
        settings = ((f, getattr(self.settings, f.name)) for f in fields(JdeSettings))
        return {
            "version": np.array(VERSION),
            **{f"settings.{f.name}": np.array(v, dtype=type(f.default)) for f, v in settings},
            "rng": np.array(
                [half for word in words for half in (word >> 64, word & _LOWER_64)], dtype=np.uint64
            ),
            "history": self.history,
            "asked": np.array(self._asked),
            **{name: getattr(self, f"_{name}").copy() for name in _ARRAYS},
        }

    @classmethod
    def restore(cls, state: Mapping[str, NDArray[Any]]) -> Jde:
        """Return the search that `state` was taken from; it goes on bit for bit as that one would.

        Raises:
            ValueError: the version is another, or the shape of an array.
            KeyError: an array is missing.
        """
        if str(state.get("version")) != VERSION:
            raise ValueError(f"this is no state of a search of version '{VERSION}'")
        values: dict[str, Any] = {
            f.name: state[f"settings.{f.name}"].tolist() for f in fields(JdeSettings)
        }
        search = cls(state["population"].shape[-1], JdeSettings(**values), 0)
        for name in _ARRAYS:
            if np.shape(state[name]) != np.shape(getattr(search, f"_{name}")):
                raise ValueError(f"{name} of the state has the shape {np.shape(state[name])}")
            setattr(search, f"_{name}", np.array(state[name]))
        search._best, search._history = (
            int(np.argmin(search._costs)),
            [float(h) for h in state["history"]],
        )
        search._asked = bool(state["asked"])
        rng = [int(half) for half in state["rng"]]
        search._rng.bit_generator.state = {
            "bit_generator": "PCG64",
            "state": {"state": rng[0] << 64 | rng[1], "inc": rng[2] << 64 | rng[3]},
            "has_uint32": 0,  # only doubles are ever drawn
            "uinteger": 0,
        }
        return search


_ARRAYS = ("population", "costs", "f", "cr", "trials", "trial_f", "trial_cr")
"""Arrays that a search is made of, besides its history and its random generator."""


def adapt(
    values: FloatArray, draws: FloatArray, bounds: tuple[float, float], descent: float
) -> FloatArray:
    """Return (S,) F or CR of the trials (Sec. 3.5.1): drawn anew with probability tau, else lowered, not below the least.

    The first row of the (2, S) draws, uniform in [0, 1), decides whether to draw anew, the second
    gives the new value; `descent` is slp (ng - 1) / ng_max.
    """
    low, high = bounds
    return np.where(
        draws[0] < TAU, low + (high - low) * draws[1], np.maximum(values - values * descent, low)
    )


def distinct_partners(draws: FloatArray) -> IndexArray:
    """Return, for each i, k indices that differ from each other and from i; every ordered choice is equally likely.

    The j-th index is drawn from the S - 1 - j that are left, then counted past the taken ones in
    increasing order. Draws are (k, S), uniform in [0, 1), and k < S; column i of the (k, S) indices
    belongs to vector i.
    """
    k, size = draws.shape
    left = (size - 1 - np.arange(k, dtype=np.float64))[:, np.newaxis]
    indices: IndexArray = (draws * left).astype(np.intp)
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
    population: FloatArray, best: FloatArray, f: FloatArray, partners: IndexArray
) -> FloatArray:
    """Return (S, n) donors X_best + F (X_r1 - X_r2) + F (X_r3 - X_r4), which may leave the cube (Sec. 3.5.1).

    `population` is (S, n), `best` (n,), `f` (S,); the (4, S) partners are the indices r1 to r4.
    """
    x = population[partners]
    difference: FloatArray = x[0] - x[1]
    difference += x[2]
    difference -= x[3]
    difference *= f[:, np.newaxis]
    difference += best
    return difference


def repair(donors: FloatArray, base: FloatArray) -> FloatArray:
    """Return (S, n) donors; genes beyond a bound are put midway between the (n,) base vector's and that bound."""
    inside = np.where(donors < 0.0, 0.5 * base, donors)
    return np.where(donors > 1.0, 0.5 + 0.5 * base, inside)


def binomial_mask(cr: FloatArray, draws: FloatArray, first: IndexArray) -> NDArray[np.bool_]:
    """Return an (S, n) mask of the genes that come from the donor: each with probability CR, and gene `first` always.

    The (S, n) draws are uniform in [0, 1).
    """
    mask = draws < cr[:, np.newaxis]
    mask[np.arange(len(cr)), first] = True
    return mask


def replaces(trial_costs: FloatArray, parent_costs: FloatArray) -> NDArray[np.bool_]:
    """(S,) whether each trial replaces its parent: it does if its cost is finite and not worse."""
    return np.isfinite(trial_costs) & (trial_costs <= parent_costs)
