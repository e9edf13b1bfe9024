"""`python -m validation.fit MODEL --to SOURCE`: a plant's parameters from a motion, by differential evolution."""

from __future__ import annotations

import contextlib
import os
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from ssmr.search.jde import Crossover, JdeSettings, Strategy
from validation import cli
from validation.fit.cluster import Cluster
from validation.fit.fitting import Asked, conclude, identity
from validation.fit.objective import CostName, CostSettings, Problem
from validation.fit.report import fit_notes, fit_tables
from validation.fit.run import COSTS, GENERATIONS, POPULATION, first_points, require_possible, write
from validation.fit.search import CHECKPOINT, Evaluate, begin, shown
from validation.fit.targets import Input, held_out_targets, is_scenario, parse_sources, train_targets
from validation.plants.profile import load
from validation.plants.searchable import default_free, make_space, with_values
from validation.plants.table import PLANTS


def main(
    model: Annotated[str, tyro.conf.Positional, cli.one_of(PLANTS)],
    /,
    *,
    to: str,
    input: Input = "commands",
    start_at: Annotated[float | None, tyro.conf.arg(name="from")] = None,
    until: float | None = None,
    held_out: str | None = None,
    profile: str | None = None,
    free: str | None = None,
    fix: str = "",
    bounds: str = "",
    start: str | None = None,
    objective: CostName | None = None,
    horizons: str = "2,6",
    yaw_weight: float = 1.0,
    population: int | None = None,
    generations: int | None = None,
    strategy: Strategy = "best/2",
    crossover: Crossover = "bin",
    df: float = 1e-3,
    patience: int = 30,
    target: float | None = None,
    seed: int = 0,
    workers: int | None = None,
    scheduler: str | None = None,
    out: Path | None = None,
    name: str | None = None,
    resume: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    rerun: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
) -> None:
    """Fit a plant's parameters to a motion by self-adaptive differential evolution (jDE).

    Prints tables and writes fit.json, profile.toml, fit.png and, after every generation, checkpoint.npz.
    Ctrl-C ends the search and writes the best found so far, marked as interrupted.

    Args:
        model: The plant to fit.
        to: What to fit it to: traj4@mujoco (the scenario as that plant drives it), the path of a recording, or several,
            comma-separated.
        input: What of a recording drives the plant: commands, measured wheel rates, or both, each in its turn.
        start_at: Leave out what was recorded before this time [s].
        until: Leave out what was recorded after this time [s].
        held_out: Sources to judge the fit on, comma-separated; a recording that is also fitted to means its parts outside
            --from and --until.
        profile: The numbers to begin with, and of everything that is not fitted; thesis-lab for scenarios, husky-tile for
            recordings.
        free: Which parameters to search, comma-separated; the default depends on plant and source. A wrong name lists all.
        fix: Values to hold, such as friction=0.4,com_y=0; such a parameter is not searched.
        bounds: Bounds of the search, such as friction=0.2:0.8,delay=0:0.5.
        start: Put one candidate into the first population: 'profile', or values such as friction=0.4 (the others from the
            profile).
        objective: path (Eq. 3.1, default for scenarios), sync (errors at equal times) or horizon (errors of the relative
            pose after some seconds, default for recordings).
        horizons: Of the horizon objective [s].
        yaw_weight: What a radian counts beside a metre in the sync and horizon objectives [m/rad].
        population: Candidates in a generation; 50, and 32 for mujoco.
        generations: At most so many after the first population; 300, and 60 for mujoco.
        strategy: Mutation. best/2 converges fast; rand/1 does not get stuck.
        crossover: Binomial or exponential.
        df: Stop when the cost improved by no more than this share ...
        patience: ... over this many generations.
        target: Stop at this cost.
        seed: Seed of the search.
        workers: Threads; the result does not depend on it.
        scheduler: Address of a dask scheduler, such as tcp://127.0.0.1:8786, whose workers rate the candidates.
        out: Folder for the results; runs/fit/MODEL-SOURCE if not given.
        name: Name of the profile that is written.
        resume: Continue from the checkpoint in --out.
        rerun: Write fit.rrd too.
    """
    with cli.mistakes_are_users():
        sources = parse_sources(to, "--to")
        wanted_held_out = parse_sources(held_out, "--held-out") if held_out is not None else ()
        if seed < 0 or (workers is not None and workers < 1):
            raise cli.UserError(f"--seed {seed} must not be negative and --workers {workers} must be positive")
        occasion: Literal["scenario", "recording"] = "scenario" if all(map(is_scenario, sources)) else "recording"
        base = load(profile or ("thesis-lab" if occasion == "scenario" else "husky-tile"))
        held = cli.parse_values(fix, "--fix")
        begun = with_values(model, base.plants[model], list(held), held.values())
        names = tuple(n.strip() for n in free.split(",") if n.strip()) if free is not None else default_free(model, occasion)
        space = make_space(model, [n for n in names if n not in held], cli.parse_bounds(bounds))
        first = first_points(space, model, begun, start)
        cost = CostSettings(
            objective or COSTS[occasion], yaw_weight=yaw_weight, horizons=cli.parse_numbers(horizons, "--horizons")
        )
        settings = JdeSettings(
            population=POPULATION.get(model, 50) if population is None else population,
            generations=GENERATIONS.get(model, 300) if generations is None else generations,
            strategy=strategy,
            crossover=crossover,
            df=df,
            patience=patience,
            target=-np.inf if target is None else target,
        )
        problem = Problem(model, begun, space, train_targets(sources, base, input, start_at, until), cost)
        require_possible(problem, model)
        judged = held_out_targets(wanted_held_out, sources, base, input, start_at, until)
        folder = cli.output_folder(out or Path("runs") / "fit" / f"{model}-{Path(sources[0]).stem}")
        who = identity(problem, settings, seed, first)
        search = begin(folder / CHECKPOINT, who, len(space), settings, seed, first, resume)
    options = {
        "input": input if occasion == "recording" else None,
        "from": start_at,
        "until": until,
        "objective": cost.name,
        **({"horizons_s": list(cost.horizons)} if cost.name == "horizon" else {}),
        **({"yaw_weight_m_rad": cost.yaw_weight} if cost.name != "path" else {}),
        "fixed": held or None,
        **{k: v for k, v in asdict(settings).items() if not (k == "target" and target is None)},
        "start": start,
        "scheduler": scheduler,
    }
    threads = workers or os.cpu_count() or 1
    with contextlib.ExitStack() as stack:
        if scheduler is None:
            evaluate: Evaluate = lambda points, limits, tell: problem.costs(points, limits, threads, tell)  # noqa: E731
        else:
            with cli.mistakes_are_users():
                evaluate = stack.enter_context(Cluster(scheduler, problem))
        with shown(space, settings) as show:
            search.run(evaluate, folder / CHECKPOINT, show)
    if search.interrupted and not np.isfinite(search.jde.best_cost):
        raise KeyboardInterrupt
    with cli.progress() as bar:
        bar.add_task("standard errors and scores", total=None)
        result = conclude(search, problem, Asked(base, to, judged, seed, options), threads)
    written = write(result, search.jde.best, problem, base, name or f"{base.name}-fitted", folder, rerun=rerun)
    cli.report(fit_tables(result), fit_notes(result), written)
    if search.interrupted:
        raise KeyboardInterrupt


if __name__ == "__main__":
    cli.run(main, "python -m validation.fit")
