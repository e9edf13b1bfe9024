"""The command line `python -m validation.fit MODEL --to SOURCE`."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import tyro

from validation import cli
from validation.files.limits import USUAL
from validation.fit.objective import FitCost, Objective
from validation.fit.run import FitParameters, FitSearch, Method, fit
from validation.fit.search import CHECKPOINT
from validation.fit.targets import FitSources
from validation.plants.table import PLANTS
from validation.words import file_name


@dataclass(frozen=True)
class _Sources(FitSources):
    """Options for the sources."""

    start_at: Annotated[cli.Number, cli.option("from", metavar="SECONDS", default="the beginning")] = None
    until: Annotated[cli.Number, cli.option(metavar="SECONDS", default="the end")] = None
    held_out: Annotated[cli.Names, cli.option(metavar="SOURCE,...", default="none")] = ()
    """Sources to test on, separated by commas. A fitted recording stands for its parts outside --from and --until."""
    limits: cli.Limits = USUAL


def _start(text: str) -> dict[str, float]:
    return {} if text == "profile" else cli.read_values(text)


@dataclass(frozen=True)
class _Parameters(FitParameters):
    """Options for the parameters."""

    free: Annotated[cli.Names | None, cli.option(metavar="NAME,...", default="the plant's usual ones")] = None
    """Parameters to search, separated by commas. A wrong name lists all."""
    fix: Annotated[cli.Values, cli.option(default="none")] = field(default_factory=dict)
    """Values to hold, such as friction=0.4,com_y=0; these parameters are not searched."""
    bounds: Annotated[cli.Bounds, cli.option(default="the parameters' usual ones")] = field(default_factory=dict)
    """Bounds of the search, such as friction=0.2:0.8,delay=0:0.5."""
    robot: tyro.conf.Suppress[str | None] = None
    start: Annotated[
        dict[str, float] | None, cli.parsed(_start, "profile|NAME=X,..."), cli.option(default="all are drawn at random")
    ] = None
    """A candidate of the first population: the profile's numbers, or some that replace them, such as friction=0.4."""


@dataclass(frozen=True)
class _Cost(FitCost):
    """Options for the cost."""

    objective: Annotated[Objective | None, cli.option(default="path for scenarios, horizon for recordings")] = None
    """Errors to minimise: path (of paths, Eq. 3.1), sync (at equal times) or horizon (of relative poses, seconds later)."""
    horizons: cli.Numbers = (2.0, 6.0)


@dataclass(frozen=True)
class _Search(FitSearch):
    """Options for the search."""

    method: Annotated[Method, cli.option("search")] = "hybrid"
    """hybrid: a short differential evolution (jDE) finds the region, then bounded least squares go to the optimum, from its
    best candidate and from others far from it. jde: differential evolution alone, as in the thesis; ask for it to repeat the
    thesis, or where different seeds of hybrid end at different places. lsq: least squares alone, from --start, which is the
    profile's numbers if it is not given."""
    population: Annotated[
        cli.Count, cli.option(default="of jDE: 20, and 50 for the objective path; jde alone 50, mujoco 32")
    ] = None
    """Number of candidates in a generation of jDE."""
    generations: Annotated[cli.Count, cli.option(default="10, path 100, mujoco 4; jde alone 300, mujoco 60")] = None
    """Greatest number of generations of jDE after its first population."""
    target: Annotated[cli.Number, cli.option(metavar="COST", default="none")] = None
    seed: cli.Seed = 0
    workers: cli.Workers = None
    executor: tyro.conf.Suppress[Executor | None] = None
    checkpoint: tyro.conf.Suppress[Path | None] = None
    resume: cli.Flag = False
    """Continue from the checkpoint in the folder of --out."""
    scheduler: Annotated[str | None, cli.option(metavar="ADDRESS", default="threads of this computer")] = None


@dataclass(frozen=True)
class _Output:
    """Options for the files that are written."""

    out: Annotated[Path | None, cli.out_option("runs/fit/MODEL-SOURCE")] = None
    name: Annotated[str | None, cli.option(metavar="NAME", default="the first profile's name with -fitted")] = None
    """Name of the profile that is written."""
    rerun: cli.Flag = False
    """Write the rerun recording fit.rrd too."""


@dataclass(frozen=True)
class Options:
    """The options of `python -m validation.fit`."""

    model: Annotated[str, tyro.conf.Positional, cli.one_of(PLANTS)]
    """Plant to fit."""
    to: Annotated[str, cli.option(metavar="SOURCE,...")]
    """Sources of the data, separated by commas: paths of recordings, or traj4@mujoco for how that plant drives traj4."""
    robot: cli.RobotName = None
    profile: Annotated[str | None, cli.profile_option("thesis-lab for scenarios, husky-tile for recordings")] = None
    sources: Annotated[_Sources, tyro.conf.OmitArgPrefixes] = _Sources()
    parameters: Annotated[_Parameters, tyro.conf.OmitArgPrefixes] = _Parameters()
    cost: Annotated[_Cost, tyro.conf.OmitArgPrefixes] = _Cost()
    search: Annotated[_Search, tyro.conf.OmitArgPrefixes] = _Search()
    output: Annotated[_Output, tyro.conf.OmitArgPrefixes] = _Output()


def main(options: Options) -> None:
    """Fit a plant's parameters to motions by differential evolution (jDE), least squares, or one after the other.

    Prints tables; writes fit.json, profile.toml, fit.png and checkpoint.npz.

    Ctrl-C ends the search and writes the best result found so far.
    """
    to, output = options.to, options.output
    sources = [to] if Path(to).exists() else [part.strip() for part in to.split(",") if part.strip()]
    stem = Path(sources[0]).stem if sources else ""
    folder = output.out or Path("runs") / "fit" / file_name(f"{options.model}-{stem}")
    search = replace(options.search, checkpoint=folder / CHECKPOINT)
    if output.rerun:
        cli.require_rerun("the recording", "install it, or leave out --rerun")
    with cli.search_kept_in(folder / CHECKPOINT):
        with cli.mistakes_are_users(), cli.shown("fit") as progress:
            result = fit(
                options.model,
                sources,
                options.profile,
                sources=options.sources,
                parameters=replace(options.parameters, robot=options.robot),
                cost=options.cost,
                search=search,
                progress=progress,
            )
        if output.name is not None:
            result = replace(result, profile=replace(result.profile, name=output.name))
        cli.report_result(result, result.save(folder, recording=output.rerun))
    if result.status == "interrupted":
        raise KeyboardInterrupt


PROGRAM = main

if __name__ == "__main__":
    cli.run(PROGRAM, "python -m validation.fit")
