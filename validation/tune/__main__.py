"""The command line `python -m validation.tune CONTROLLER`."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import tyro

from ssmr.control.laws import CONTROLLERS
from validation import cli
from validation.fit.search import CHECKPOINT, SearchOptions
from validation.tune.cost import TuneCost
from validation.tune.options import TuneParameters, TuneTask


@dataclass(frozen=True)
class _Task(TuneTask):
    """Options for plants, references and noise."""

    plants: Annotated[cli.Names, cli.option("plant", metavar="PLANT,...", default="improved")] = ("improved",)
    """Plants that the controller must drive, separated by commas; the cost is the mean over all."""
    robot: tyro.conf.Suppress[str | None] = None
    held_out: Annotated[
        cli.Names | None,
        cli.option(
            metavar="REF,...", default="line, circle, generic, slalom, square, u-turn, stop-and-go without those tuned on"
        ),
    ] = None
    """References to judge the gains on, in the form of --reference."""
    draws: Annotated[cli.Count, cli.option(default="20, or 10 with mujoco")] = None
    """Number of robots that are drawn for --robots robust, and number of others that the gains are scored on."""
    noise: Annotated[bool, tyro.conf.FlagCreatePairsOff, cli.option(default="off")] = True
    """Turn off noise and disturbances."""


@dataclass(frozen=True)
class _Parameters(TuneParameters):
    """Options for the parameters."""

    free: Annotated[cli.Names | None, cli.option(metavar="NAME,...", default="the usual ones of the controller")] = None
    """Gains to search, separated by commas. A wrong name lists all."""
    fix: Annotated[cli.Values, cli.option(default="none")] = field(default_factory=dict)
    """Gains to hold, such as ff_w=1; these are not searched."""
    bounds: Annotated[cli.Bounds, cli.option(default="those of Tab. 4.4 and 4.21, widened to hold the start")] = field(
        default_factory=dict
    )
    """Bounds of the search, such as k_p_y=0:10."""
    gains: Annotated[str | None, cli.option(metavar="NAME|PATH", default="published where the thesis has any")] = None
    all: cli.Flag = False
    from_scratch: cli.Flag = False


@dataclass(frozen=True)
class _Cost(TuneCost):
    """Options for the cost."""

    seeds: tyro.conf.Suppress[Sequence[int] | None] = None
    noise_seeds: Annotated[cli.Count, cli.option()] = 1
    """Number of draws of noise and disturbance that the cost is the mean of."""
    k_u: Annotated[cli.Number, cli.option(default="50 for lqr (Tab. 4.20), else 0")] = None


@dataclass(frozen=True)
class _Search(SearchOptions):
    """Options for the search."""

    population: Annotated[cli.Count, cli.option(default="100 (pid, smc), 50 (others), 24 with mujoco")] = None
    generations: Annotated[cli.Count, cli.option(default="300 (lqr), 150 (others), 20 with mujoco")] = None
    target: Annotated[cli.Number, cli.option(metavar="COST", default="none")] = None
    seed: cli.Seed = 0
    workers: cli.Workers = None
    executor: tyro.conf.Suppress[Executor | None] = None
    checkpoint: tyro.conf.Suppress[Path | None] = None
    resume: cli.Flag = False
    """Continue from the checkpoint in the folder of --out."""


@dataclass(frozen=True)
class _Output:
    """Options for the files that are written."""

    out: Annotated[Path | None, cli.out_option("runs/tune/CONTROLLER-PLANTS")] = None
    name: Annotated[str | None, cli.option(metavar="NAME", default="CONTROLLER-tuned")] = None
    """Name of the gain set that is written."""


@dataclass(frozen=True)
class Options:
    """The options of `python -m validation.tune`."""

    controller: Annotated[str, tyro.conf.Positional, cli.one_of(CONTROLLERS)]
    """Controller to tune."""
    reference: Annotated[cli.Names, cli.option(metavar="REF,...")] = ("generic",)
    """Paths to follow, separated by commas: line, circle, sine, generic, eight, slalom, square, spiral, u-turn, stop-and-go,
    long-line, circle@0.5 with its speed, or waypoint files."""
    robot: cli.RobotName = None
    profile: Annotated[str | None, cli.profile_option("thesis-lab")] = None
    task: Annotated[_Task, tyro.conf.OmitArgPrefixes] = _Task()
    parameters: Annotated[_Parameters, tyro.conf.OmitArgPrefixes] = _Parameters()
    cost: Annotated[_Cost, tyro.conf.OmitArgPrefixes] = _Cost()
    search: Annotated[_Search, tyro.conf.OmitArgPrefixes] = _Search()
    output: Annotated[_Output, tyro.conf.OmitArgPrefixes] = _Output()


def main(options: Options) -> None:
    """Tune the gains of a controller by differential evolution (jDE).

    Prints tables; writes tune.json, gains.toml, tune.png and checkpoint.npz.

    Ctrl-C ends the search and writes the best result found so far.
    """
    from validation.tune.run import tune  # here: a help text need not wait for MuJoCo

    plants, seed, output = options.task.plants, options.search.seed, options.output
    folder = output.out or Path("runs") / "tune" / f"{options.controller}-{'-'.join(plants)}"
    with cli.search_kept_in(folder / CHECKPOINT):
        with cli.mistakes_are_users(), cli.shown("tune") as progress:
            result = tune(
                options.controller,
                options.reference,
                options.profile,
                task=replace(options.task, robot=options.robot),
                parameters=options.parameters,
                cost=replace(options.cost, seeds=range(seed, seed + (options.cost.noise_seeds or 1))),
                search=replace(options.search, checkpoint=folder / CHECKPOINT),
                progress=progress,
            )
        if output.name is not None:
            result = replace(result, gain_set=replace(result.gain_set, name=output.name))
        cli.report_result(result, result.save(folder))
    if result.status == "interrupted":
        raise KeyboardInterrupt


PROGRAM = main

if __name__ == "__main__":
    cli.run(PROGRAM, "python -m validation.tune")
