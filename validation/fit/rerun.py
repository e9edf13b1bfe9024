"""A fit as a rerun recording: the fitted plant beside the true motion and the plant before, and the search's cost."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ssmr.metrics.declared import compare_pieces
from ssmr.parameters import described
from ssmr.robot.localiser import Localiser
from ssmr.types import Trajectory
from validation.fit.data import FitData, FittedParameter
from validation.fit.table import fit_markdown
from validation.report.motion_panels import comparison_figure
from validation.report.motion_scene import write_comparison
from validation.report.motions import Comparison, PlantResult
from validation.report.palette import colour
from validation.report.tables import option_text
from validation.report.tracks import History


def write_fit_recording(result: FitData, path: Path) -> None:
    """Write a fit as a rerun recording, whole or not at all.

    The robots are those of the first source that was fitted to. The cost has a timeline of its own, `generation`.

    Raises:
        OSError: the file cannot be written.
        RuntimeError: rerun is switched off by `RERUN=off`.
    """
    costs = np.column_stack([result.trace.best_cost, result.trace.median_cost])
    names = (f"best {result.cost_name} cost", "median of the population")
    history = History("Cost", "generation", names, (colour(result.model), colour("")), costs)
    write_comparison(as_comparison(result), path, fit_markdown(result), [history])


def as_comparison(result: FitData) -> Comparison:
    """Return the first source that was fitted to as a comparison whose reference is the true motion, without commands.

    Bodies are drawn by the tracked frame where that was fitted, else as if it were the plants' own.
    """
    first = result.train[0]
    reference = "truth" if first.reference_name == result.model else first.reference_name
    found = {p.name: p for p in result.parameters}

    def tracked(of: Callable[[FittedParameter], float]) -> Localiser:
        return Localiser(**{name: of(found[name]) for name in described(Localiser) if name in found})

    def plant(name: str, pieces: tuple[Trajectory, ...], localiser: Localiser) -> PlantResult:
        return PlantResult(name, pieces, compare_pieces(pieces, first.truth), {}, math.nan, math.nan, localiser=localiser)

    plants = [plant(result.model, first.motion, tracked(lambda p: p.value))]
    if first.before:
        plants.append(plant("before", first.before, tracked(lambda p: p.before)))
    if reference != "recording":
        plants.append(plant(reference, first.truth, Localiser()))
    return Comparison(
        program="fit",
        title=f"{first.label}, profile {result.begun_with}",
        tables=(),
        document={},
        draw=comparison_figure,
        source=first.label,
        profile=result.begun_with,
        reference_name=reference,
        reference=first.truth,
        commands=(),
        plants={p.name: p for p in plants},
        seed=result.seed,
        options={k: option_text(v) for k, v in result.options.items() if v is not None},
        versions=result.versions,
        robot=result.profile.robot,
    )
