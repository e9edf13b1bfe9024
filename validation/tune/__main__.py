"""`python -m validation.tune CONTROLLER`: a controller's gains by differential evolution, along references, on any plant."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from ssmr.control.laws import CONTROLLERS
from ssmr.control.loop import Feedback, LoopSettings
from ssmr.search.jde import Crossover, JdeSettings, Strategy
from validation import cli
from validation.fit.search import CHECKPOINT, Evaluate, begin, shown
from validation.plants.profile import PLANTS, Profile, load
from validation.track.tracking import make_controller, make_robot
from validation.tune.report import tune_notes, tune_tables
from validation.tune.run import (
    HELD_OUT,
    K_U,
    MUJOCO_SIZE,
    SIZES,
    USUAL_SIZE,
    baseline_of,
    first_point,
    make_cases,
    parse_references,
    write,
)
from validation.tune.tuning import Asked, CostName, TuneCost, TuneProblem, conclude, make_tuning_space


def main(
    controller: Annotated[str, tyro.conf.Positional, cli.one_of(CONTROLLERS)],
    /,
    *,
    plant: str = "improved",
    reference: str = "generic",
    speed: float = 0.25,
    held_out: str | None = None,
    profile: str = "thesis-lab",
    gains: str | None = None,
    all: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    free: str | None = None,
    fix: str = "",
    bounds: str = "",
    cost: CostName = "path",
    feedback: Feedback = "noisy",
    no_noise: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    lookahead: float = 0.0,
    guard: float = 0.1,
    noise_seeds: int = 1,
    from_scratch: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    population: int | None = None,
    generations: int | None = None,
    strategy: Strategy = "best/2",
    crossover: Crossover = "bin",
    df: float = 1e-3,
    patience: int = 30,
    seed: int = 0,
    workers: int | None = None,
    out: Path | None = None,
    name: str | None = None,
    resume: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
) -> None:
    """Tune a controller by self-adaptive differential evolution (jDE), and hold it against the gains it began with.

    Prints tables and writes tune.json, gains.toml, tune.png and, after every generation, checkpoint.npz.
    Ctrl-C ends the search and writes the best found so far, marked as interrupted.

    Args:
        controller: Which one.
        plant: Which plants it must drive, comma-separated; the cost is the mean over all.
        reference: References it must follow, comma-separated, such as generic or circle@0.5,sine@0.25; or files.
        speed: Of references without one [m/s].
        held_out: References to judge the gains on, in the same form; by default the four named ones at 0.25 and 0.5 m/s that
            are not tuned on.
        profile: Name of a shipped profile or path of a TOML file.
        gains: The set to begin with, to hold what is not searched, and to be held against; published where the thesis has
            any.
        all: Search the gains too that the thesis sets by hand: feedforward, K_alpha, K_y, K_I.
        free: Which gains to search, comma-separated; a wrong name lists all.
        fix: Gains to hold, such as ff_w=1.
        bounds: Bounds of the search, such as k_p_y=0:10; else those of Tab. 4.4 and 4.21.
        cost: path (Sec. 4.3.3, 4.4.3) or time (errors at equal times instead of distances between paths).
        feedback: What the controller sees: truth, noisy or ekf.
        no_noise: No noise and no disturbance.
        lookahead: Distance at which the robot keeps behind its target [m].
        guard: Stability guard: candidates that lose the reference with so much more delay are refused [s]; 0: off.
        noise_seeds: Over so many draws of noise and disturbance the cost is averaged.
        from_scratch: Do not put the gains it begins with into the first population.
        population: Candidates in a generation; 100 (PID), 50 (LQR), 24 with mujoco.
        generations: At most so many; 150 (PID), 300 (LQR), 20 with mujoco.
        strategy: Mutation. best/2 converges fast; rand/1 does not get stuck.
        crossover: Binomial or exponential.
        df: Stop when the cost improved by no more than this share ...
        patience: ... over this many generations.
        seed: Seed of the search; noise has the seeds from this one on.
        workers: Threads; the result does not depend on it.
        out: Folder for the results; runs/tune/CONTROLLER-PLANTS if not given.
        name: Name of the gain set that is written.
        resume: Continue from the checkpoint in --out.
    """
    with cli.mistakes_are_users():
        plants = cli.parse_names(plant, PLANTS, "plant")
        if seed < 0 or noise_seeds < 1 or (workers is not None and workers < 1):
            raise cli.UserError(
                f"--seed {seed} must not be negative, --noise-seeds {noise_seeds} and --workers {workers} must be positive"
            )
        chosen: Profile = load(profile)
        held = cli.parse_values(fix, "--fix")
        base = baseline_of(controller, gains, held)
        make_controller(chosen, base)
        wanted_free = [n.strip() for n in free.split(",") if n.strip()] if free is not None else None
        space = make_tuning_space(controller, wanted_free, all, cli.parse_bounds(bounds))
        if any(n in held for n in space.names):
            kept = [n for n in space.names if n not in held]
            space = make_tuning_space(controller, kept, all, cli.parse_bounds(bounds))
        heavy = "mujoco" in plants
        usual = MUJOCO_SIZE if heavy else SIZES.get(controller, USUAL_SIZE)
        settings = JdeSettings(
            population=population or usual[0],
            generations=usual[1] if generations is None else generations,
            strategy=strategy,
            crossover=crossover,
            df=df,
            patience=patience,
        )
        around = LoopSettings("truth" if no_noise else feedback, disturbance=not no_noise, lookahead=lookahead)
        robots = [make_robot(chosen, n) for n in plants]
        wanted = parse_references(reference, speed)
        cases = make_cases(wanted, robots, around)
        judged = (
            parse_references(held_out, speed)
            if held_out is not None
            else tuple(p for p in parse_references(",".join(HELD_OUT), None) if p not in wanted)
        )
        problem = TuneProblem(
            chosen,
            base,
            space,
            cases,
            TuneCost(cost, k_u=K_U.get(controller, 0.0), guard=guard, seeds=tuple(range(seed, seed + noise_seeds))),
        )
        asked = Asked(
            make_cases(judged, robots, around),
            seed,
            {
                **{k: v for k, v in asdict(problem.cost).items() if k != "seeds"},
                "noise_seeds": list(problem.cost.seeds),
                "feedback": around.feedback,
                "disturbance": around.disturbance,
                "lookahead_m": lookahead,
                "fixed": held or None,
                **{k: v for k, v in asdict(settings).items() if k != "target"},
                "from_scratch": from_scratch,
            },
        )
        first = None if from_scratch else first_point(problem)
        folder = cli.output_folder(out or Path("runs") / "tune" / f"{controller}-{'-'.join(plants)}")
        search = begin(
            folder / CHECKPOINT, problem.identity(settings, seed, first), len(space), settings, seed, first, resume
        )
    threads = workers or os.cpu_count() or 1
    evaluate: Evaluate = lambda points, limits, tell: problem.costs(points, limits, threads, tell)  # noqa: E731
    with shown(space, settings) as show:
        search.run(evaluate, folder / CHECKPOINT, show)
    if search.interrupted and not np.isfinite(search.jde.best_cost):
        raise KeyboardInterrupt
    with cli.progress() as bar:
        bar.add_task("tuned and baseline on every reference", total=None)
        result = conclude(search, problem, asked, threads)
    cli.report(tune_tables(result), tune_notes(result), write(result, name or f"{controller}-tuned", folder))
    if search.interrupted:
        raise KeyboardInterrupt


if __name__ == "__main__":
    cli.run(main, "python -m validation.tune")
