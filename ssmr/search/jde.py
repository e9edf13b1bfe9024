"""Self-adaptive differential evolution (jDE) in the unit cube, by ask and tell.

F and CR descend as in the thesis. The search owns no loop and no objective: `ask` hands out a whole
generation, `tell` takes its costs. Sources: thesis Sec. 3.5.1 (mutation, adaptation, Alg. 3) and
Tab. 3.7 (defaults); J. Brest et al. 2006, doi 10.1109/TEVC.2006.872133 (jDE).

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

F_INIT = 0.75
"""Initial F of every vector [1]; Tab. 3.7, as all that follow."""
F_BOUNDS = (0.1, 0.9)
"""Least and greatest F [1]."""
CR_INIT = 0.8
"""Initial CR of every vector [1]."""
CR_BOUNDS = (0.0, 1.0)
"""Least and greatest CR [1]."""
TAU = 0.1
"""Probability of a new F, and of a new CR (tau_1, tau_2) [1]."""
PARTNERS = 4
"""Number of vectors, distinct and other than i, from which a donor is made (nr)."""
Finished = Literal["", "generations", "improvement"]

_VERSION = "ssmr.jde/3"
"""Version of the layout of `Jde.state`, and of the order in which random numbers are drawn."""
_MOST_VECTORS = 100_000
_MOST_GENERATIONS = 1_000_000
"""Greatest size and length of a search: beyond, its state does not fit into memory or a
checkpoint."""
_LOWER_64 = (1 << 64) - 1


@dataclass(frozen=True)
class JdeSettings:
    """Size of a search and its stop rules, by default those of Tab. 3.7, but for `patience`."""

    population: int = 50
    """Number of vectors in a generation, S (NP)."""
    generations: int = 300
    """Greatest number of generations after the initial population (n_gen, ng_max)."""
    df: float = 1e-3
    """Stop when the best cost improved by no more than this share of its size [1] ..."""
    patience: int = 30
    """... over this many generations; more than `generations` turns the rule off."""
    slope: float = 0.2
    """Share of F and CR by which they are lowered, in proportion to the generations gone (slp) [1];
    0 leaves them as they were drawn, as in the first publication of jDE (Brest et al. 2006)."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a number out of its range."""
        require_within(self, ("population",), 1 + PARTNERS, _MOST_VECTORS, whole=True)
        require_within(self, ("generations",), 1, _MOST_GENERATIONS, whole=True)
        require_within(self, ("patience",), 1, 1_000_000_000, whole=True)
        require_within(self, ("df",), 0.0, 1e6)
        require_within(self, ("slope",), 0.0, 1.0)


class Jde:
    """One search. `while not search.finished: search.tell(costs_of(search.ask()))`."""

    def __init__(
        self, n: int, settings: JdeSettings, seed: int, start: ArrayLike | None = None
    ) -> None:
        """Draw the initial population of vectors of n genes.

        The (k, n) points `start` of the cube replace the first k drawn. Equal seeds give equal
        searches.

        Raises:
            ValueError: n is not positive, the seed is negative, or the start has more than S rows.
        """
        if n < 1:
            raise ValueError(f"a search needs at least one parameter, got {n}")
        if not 0 <= seed <= MOST_SEED:
            raise ValueError(f"the seed must not be negative, nor greater than {MOST_SEED}")
        self.n = n
        self.settings = settings
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
        self._f = np.full(size, F_INIT)
        self._cr = np.full(size, CR_INIT)
        self._history: list[float] = []
        self._best = 0
        self._asked = False
        self._trials = self._population
        self._trial_f = self._f
        self._trial_cr = self._cr

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
        """Reason why the search is over, or an empty string while it is not.

        It is the first of these rules that holds. `improvement`: over the last `patience`
        generations the best cost fell by no more than df times its size before; a cost that was
        unknown then does not count. `generations`: all done.
        """
        g = self.generation
        patience = self.settings.patience
        if g >= patience:
            before = self._history[g - patience]
            gain = before - self._history[g]
            if math.isfinite(before) and gain <= self.settings.df * abs(before):
                return "improvement"
        return "generations" if g >= self.settings.generations else ""

    def ask(self) -> FloatArray:
        """Return the (S, n) points whose costs `tell` takes next.

        These are the initial population first, then the trials of each generation. A second call
        before the costs are told returns equal points. Random numbers are drawn here only, as many
        for each generation, whatever the costs.

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
        n = self.n
        size = self.settings.population
        choices = 5 + PARTNERS  # draws of a vector besides one for each gene
        draws = self._rng.random((choices + n) * size)
        rows = draws[: choices * size].reshape(choices, size)
        crossing = draws[choices * size :].reshape(size, n)
        descent = (
            self.settings.slope * self.generation / self.settings.generations
        )  # ng - 1 are complete
        f = adapt_settings(self._f, rows[0:2], F_BOUNDS, descent)
        cr = adapt_settings(self._cr, rows[2:4], CR_BOUNDS, descent)
        first = (rows[4] * n).astype(np.intp)
        best = self._population[self._best]
        donors = _mutate_population(self._population, best, f, _distinct_partners(rows[5:]))
        mask = _binomial_mask(cr, crossing, first)
        trials = np.where(mask, _repair_donors(donors, best), self._population)
        return trials, f, cr

    def tell(self, costs: ArrayLike) -> None:
        """Take the (S,) costs of the points asked for, and select.

        A trial replaces its parent unless it is worse. A cost that is NaN or infinite counts as
        worse than any. A lower bound of a trial's cost will do where it exceeds the parent's cost,
        as an evaluation broken off gives it: the outcome is the same.

        Raises:
            ValueError: nothing was asked, or the shape is another one.
        """
        if not self._asked:
            raise ValueError("costs are told, but no points were asked for")
        new_costs = np.asarray(costs, dtype=np.float64)
        if new_costs.shape != self._costs.shape:
            raise ValueError(f"costs have shape {new_costs.shape}, wanted {self._costs.shape}")
        won = trial_replaces_parent(new_costs, self._costs)
        self._costs = np.where(won, new_costs, self._costs)
        if self._history:
            self._population = np.where(won[:, np.newaxis], self._trials, self._population)
            self._f = np.where(won, self._trial_f, self._f)
            self._cr = np.where(won, self._trial_cr, self._cr)
        self._best = int(np.argmin(self._costs))
        self._history.append(float(self._costs[self._best]))
        self._asked = False

    def state(self) -> dict[str, NDArray[Any]]:
        """Return the whole search as arrays that `numpy.savez` keeps without pickle.

        Points that were asked for, but whose costs are not told, are included. Settings have names
        such as `settings.<name>`.
        """
        generator = self._rng.bit_generator.state
        halves = []
        for key in ("state", "inc"):
            word = generator["state"][key]
            halves += [word >> 64, word & _LOWER_64]
        state = {"version": np.array(_VERSION)}
        for f in fields(JdeSettings):
            value = getattr(self.settings, f.name)
            state[f"settings.{f.name}"] = np.array(value, dtype=type(f.default))
        state["rng"] = np.array(halves, dtype=np.uint64)
        state["history"] = self.history
        state["asked"] = np.array(self._asked)
        for name in _ARRAYS:
            state[name] = getattr(self, f"_{name}").copy()
        return state

    @classmethod
    def restore(cls, state: Mapping[str, NDArray[Any]]) -> Jde:
        """Return the search that `state` was taken from; it goes on bit for bit as that one would.

        Raises:
            ValueError: the version is another, or the shape of an array, or a number is none that a
                search has.
            KeyError: an array is missing.
        """
        if str(state.get("version")) != _VERSION:
            raise ValueError(f"this is no state of a search of version '{_VERSION}'")
        names = [f.name for f in fields(JdeSettings)]
        settings = {name: state[f"settings.{name}"].tolist() for name in names}
        search = cls(state["population"].shape[-1], JdeSettings(**settings), 0)
        for name in _ARRAYS:
            shape = np.shape(state[name])
            if shape != np.shape(getattr(search, f"_{name}")):
                raise ValueError(f"{name} of the state has the shape {shape}")
            setattr(search, f"_{name}", np.array(state[name]))
            # F, CR and points of the cube
            is_share = (state[name] >= 0.0) & (state[name] <= 1.0)
            if name != "costs" and not np.all(is_share):
                raise ValueError(f"{name} of the state has a number outside [0, 1]")
        search._best = int(np.argmin(search._costs))
        search._history = [float(h) for h in state["history"]]
        if np.any(np.isnan([*search._costs, *search._history])):
            raise ValueError("the state has a cost that is no number")
        search._asked = bool(state["asked"])
        high, low, inc_high, inc_low = (int(half) for half in state["rng"])
        search._rng.bit_generator.state = {
            "bit_generator": "PCG64",
            "state": {"state": high << 64 | low, "inc": inc_high << 64 | inc_low},
            "has_uint32": 0,  # only doubles are ever drawn
            "uinteger": 0,
        }
        return search


_ARRAYS = ("population", "costs", "f", "cr", "trials", "trial_f", "trial_cr")
"""Arrays that a search is made of, besides its history and its random generator."""


def adapt_settings(
    values: FloatArray, draws: FloatArray, bounds: tuple[float, float], descent: float
) -> FloatArray:
    """Return (S,) F or CR of the trials: drawn anew with probability tau, else lowered.

    They are not lowered below the least of their bounds (Sec. 3.5.1). The first row of the (2, S)
    draws, uniform in [0, 1), decides whether to draw anew, the second gives the new value;
    `descent` is slp (ng - 1) / ng_max.
    """
    low, high = bounds
    new = low + (high - low) * draws[1]
    lowered = np.maximum(values - values * descent, low)
    return np.where(draws[0] < TAU, new, lowered)


def _distinct_partners(draws: FloatArray) -> IndexArray:
    """Return, for each i, k indices that differ from each other and from i.

    Every ordered choice is equally likely. The j-th index is drawn from the S - 1 - j that are
    left, then counted past the taken ones in increasing order. Draws are (k, S), uniform in [0, 1),
    and k < S; column i of the (k, S) indices belongs to vector i.
    """
    k, size = draws.shape
    left = (size - 1 - np.arange(k, dtype=np.float64))[:, np.newaxis]
    indices: IndexArray = (draws * left).astype(np.intp)
    taken = [np.arange(size)]  # increasing, for each column
    for j, index in enumerate(indices):
        for t in taken:
            index += index >= t
        if j + 1 == k:
            break
        inserted = index
        for m, t in enumerate(taken):
            taken[m] = np.minimum(t, inserted)
            inserted = np.maximum(t, inserted)
        taken.append(inserted)
    return indices


def _mutate_population(
    population: FloatArray, best: FloatArray, f: FloatArray, partners: IndexArray
) -> FloatArray:
    """Return (S, n) donors X_best + F (X_r1 - X_r2) + F (X_r3 - X_r4) (Sec. 3.5.1).

    They may leave the cube. `population` is (S, n), `best` (n,), `f` (S,); the (4, S) partners are
    the indices r1 to r4.
    """
    x = population[partners]
    difference: FloatArray = x[0] - x[1]
    difference += x[2]
    difference -= x[3]
    difference *= f[:, np.newaxis]
    difference += best
    return difference


def _repair_donors(donors: FloatArray, base: FloatArray) -> FloatArray:
    """Return (S, n) donors inside the cube.

    A gene beyond a bound is put midway between that of the (n,) base vector and the bound.
    """
    inside = np.where(donors < 0.0, 0.5 * base, donors)
    return np.where(donors > 1.0, 0.5 + 0.5 * base, inside)


def _binomial_mask(cr: FloatArray, draws: FloatArray, first: IndexArray) -> NDArray[np.bool_]:
    """Return an (S, n) mask of the genes that come from the donor.

    Each does with probability CR, and gene `first` always. The (S, n) draws are uniform in [0, 1).
    """
    mask = draws < cr[:, np.newaxis]
    mask[np.arange(len(cr)), first] = True
    return mask


def trial_replaces_parent(trial_costs: FloatArray, parent_costs: FloatArray) -> NDArray[np.bool_]:
    """(S,) whether each trial replaces its parent: it does if its cost is finite and not worse."""
    return np.isfinite(trial_costs) & (trial_costs <= parent_costs)
