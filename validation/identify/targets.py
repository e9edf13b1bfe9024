"""The sources of a fit: motions to fit to, and motions that are held out to judge the fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from itertools import chain
from os.path import realpath
from typing import Literal

from ssmr.scenarios import TRAJECTORIES
from ssmr.types import CommandKind, Plant
from validation.experiment.gyro import find_gyro_judge
from validation.experiment.sources import Source, drive, open_source
from validation.files.log import PLAIN, ReadOptions
from validation.identify.objective import FitTarget
from validation.plants.kind import TORQUES
from validation.plants.profile import Profile, make_plant
from validation.plants.table import plant_kind

Input = Literal["commands", "wheels"]
"""Input of a recording that drives a plant along it."""
MOST_TIME = 1e12
"""Greatest size of a stamp that a recording can be cut at [s]; Unix stamps are about 1.8e9."""
Span = tuple[float | None, float | None]
"""Part of a recording between two times [s]; None for its first or its last."""


def is_scenario(name: str) -> bool:
    """Return whether a source is one of the thesis' trajectories, and no recording."""
    return name.partition("@")[0] in TRAJECTORIES


def open_targets(
    names: Sequence[str],
    profile: Profile,
    held_out: Sequence[str] = (),
    input: Input = "commands",
    span: Span = (None, None),
    options: ReadOptions = PLAIN,
) -> tuple[tuple[FitTarget, ...], tuple[FitTarget, ...]]:
    """Return the targets to fit to and those that are held out.

    A plant that drives scenarios is built once.

    Args:
        names: sources to fit to.
        profile: profile of the plants that drive scenarios.
        held_out: sources to judge the fit on. A scenario is driven by the plant that drives the
            fit's own, unless it names another; a recording that is also fitted to stands for its
            parts outside the span.
        input: the plant's input along a recording.
        span: part of a recording that is fitted to.
        options: how recordings are read.

    Raises:
        ValueError: a source is missing, named twice, cannot be read, or lacks an input.
        SsmrError: the plant that drives a scenario diverged.
    """
    if not names:
        raise ValueError("to names no source")
    for option, given in (("to", names), ("held_out", held_out)):
        if len(set(given)) != len(given):
            raise ValueError(f"{option} names a source twice")
    if all(map(is_scenario, names)) and span != (None, None):
        raise ValueError(f"start_at and until cut recordings; {', '.join(names)} are scenarios")
    kind: CommandKind = "wheels" if input == "wheels" else "twist"
    truth_of = _truth(profile)
    train = []
    for name in names:
        recorded = not is_scenario(name)
        source = _recorded(name, kind, [span], options) if recorded else open_source(name, kind)
        judge = find_gyro_judge(source)
        gyro = judge if judge and judge.first else None
        train.append(replace(truth_of(source, name), gyro=gyro))
    driver = next((name.partition("@")[2] for name in names if is_scenario(name)), "")
    judged = []
    for name in held_out:
        if is_scenario(name):
            # the same plant as drives the fit's, or the fit would be judged by another truth
            full = f"{name}@{driver}" if driver and "@" not in name else name
            if full in names or name in names:
                raise ValueError(f"{name} is fitted to; it cannot be held out as well")
            judged.append(truth_of(open_source(full), name))
            continue
        spans: list[Span] = [(None, None)]
        # unlike Path.resolve, it takes a link that leads to itself
        if realpath(name) in map(realpath, names):
            spans = _outside(name, span)
        judged.append(truth_of(_recorded(name, kind, spans, options), name))
    return tuple(train), tuple(judged)


def _outside(name: str, span: Span) -> list[Span]:
    """Return the parts of a recording outside a span; a ValueError says that there is none."""
    parts: list[Span] = [(None, span[0]), (span[1], None)]
    spans = [part for part in parts if part != (None, None)]
    if not spans:
        raise ValueError(
            f"{name} is fitted to as a whole; without start_at or until nothing of it is held out"
        )
    return spans


def _recorded(name: str, kind: CommandKind, spans: Sequence[Span], options: ReadOptions) -> Source:
    """Return some parts of a recording as one source."""
    parts = [open_source(name, kind, *span, options) for span in spans]
    pieces = tuple(chain(*(part.pieces for part in parts)))
    warnings = tuple(chain(*(part.warnings for part in parts)))
    title = " and ".join(part.title for part in parts)
    return replace(parts[0], pieces=pieces, warnings=warnings, title=title)


def _truth(profile: Profile) -> Callable[[Source, str], FitTarget]:
    """Return a function that finds the true motion of a source, recorded or of a plant."""

    # building a simulated plant takes long, and several scenarios may share one
    @cache
    def plant(name: str) -> Plant:
        return make_plant(profile, name)

    def resolve(source: Source, label: str) -> FitTarget:
        if source.reference == "recording":
            truth = tuple(p.reference for p in source.pieces if p.reference is not None)
            return FitTarget(label, source, truth)
        driver = plant(source.reference)
        localiser = profile.section(source.reference).localiser
        dt = source.sample_dt
        motions = tuple(drive(driver, piece, localiser, dt) for piece in source.pieces)
        torques = None
        if plant_kind(source.reference).torques:
            torques = tuple(motion.channels[TORQUES] for motion in motions)
        return FitTarget(label, source, motions, torques=torques)

    return resolve
