"""The sources of a fit: motions to fit to, others that are held out, and the scores on both."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from itertools import chain
from os.path import realpath
from pathlib import Path
from typing import Literal, NoReturn, TypeVar

import numpy as np

from ssmr.metrics.declared import Metrics, compare_pieces
from ssmr.scenarios import TRAJECTORIES
from ssmr.types import TORQUES, CommandKind, Plant, Trajectory
from validation.experiment.gyro import with_gyro
from validation.experiment.runs import drive_source
from validation.experiment.scores import Scores, score_windows
from validation.experiment.sources import (
    RECORDING,
    AnySource,
    Piece,
    Rates,
    Source,
    Span,
    open_source,
    source_name,
    source_of,
)
from validation.files.columns import COMMAND_COLUMNS
from validation.files.formats import log_path
from validation.files.inspection import Inspected
from validation.files.log import PLAIN, ReadOptions
from validation.files.reading import exists
from validation.identify.objective import FitCost, torque_errors, true_motion
from validation.output import file_name
from validation.plants.profile import Profile, make_plant
from validation.plants.table import plant_kind

T = TypeVar("T")
Input = Literal["commands", "wheels"]
"""Input of a recording that drives a plant along it."""
MOST_TIME = 1e12
"""Greatest size of a stamp that a recording can be cut at [s]; Unix stamps are about 1.8e9."""
_UNCOMMANDED = 0.05
"""Share of time without a command in which wheels may turn [1]; beyond it commands say little."""
HORIZONS = (2.0, 6.0, 30.0, 60.0)
"""Horizons of the relative pose errors in results [s]."""


def is_scenario(name: str) -> bool:
    """Return whether a source is one of the thesis' trajectories, and no recording."""
    return name.partition("@")[0] in TRAJECTORIES


def split_ground(name: str) -> tuple[str, str]:
    """Return the log and the ground of LOG@GROUND; the ground is empty where none is named.

    A scenario has none, and a file may have an @ in its name.
    """
    log, _, ground = name.rpartition("@")
    if not log or is_scenario(name) or exists(log_path(name)):
        return name, ""
    return log, ground


def file_of(name: str) -> str:
    """Return the file of a log by its name, LOG or LOG@GROUND."""
    # unlike Path.resolve, it takes a link that leads to itself
    return realpath(split_ground(name)[0])


def tags_of(names: Sequence[str], held_out: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the tags of each log to fit to, its own name first, and of each that is held out.

    A log that is only judged has the tag of its ground alone.
    """
    tags = {}
    own: dict[str, str] = {}
    for name in (*names, *held_out):
        log, ground = split_ground(name)
        file = file_of(name)
        if name in names and file not in own:
            label = file_name(Path(log).stem)
            # logs of several days often have one name, in folders of their own
            count = sum(known.partition(":")[0] == label for known in own.values())
            own[file] = f"{label}:{count + 1}" if count else label
        tags[name] = tuple(filter(None, (own.get(file), ground)))
    return tags


def open_sources(
    given: Sequence[AnySource],
    profile: Profile,
    held_out: Sequence[AnySource] = (),
    input: Input = "commands",
    span: Span = (None, None),
    options: ReadOptions = PLAIN,
    radius: float | None = None,
    rates: Rates = "instant",
) -> tuple[list[Source], list[Source]]:
    """Return the sources to fit to and those that are held out, all with their true motion.

    They have the names that the user gave them. A log that is both is opened once, and a plant
    that drives scenarios is built once.

    Args:
        given: sources to fit to.
        profile: profile of the plants that drive scenarios.
        held_out: sources to judge the fit on. A scenario is driven by the plant that drives the
            fit's own, unless it names another; a recording that is also fitted to stands for its
            parts outside the span.
        input: the plant's input along a recording.
        span: part of recordings that is fitted to.
        options: how recordings are read.
        radius: radius of the robot's wheels [m], where it is known.
        rates: what wheel rates of recordings are.

    Raises:
        ValueError: a source is missing, named twice, cannot be read, or lacks an input.
        SsmrError: the plant that drives a scenario diverged.
    """
    if not given:
        raise ValueError("to names no source")
    names = distinct_names("to", given)
    if all(map(is_scenario, names)) and span != (None, None):
        raise ValueError(f"since and until cut recordings; {', '.join(names)} are scenarios")
    kind: CommandKind = "wheels" if input == "wheels" else "twist"
    truth_of = _truth_finder(profile)
    judges = distinct_names("held_out", held_out)
    tags = tags_of(names, judges)
    train = []
    for name, each in zip(names, given, strict=True):
        ends = (None, None) if is_scenario(name) else span
        source = open_source(without_ground(each), kind, *ends, options, radius, rates=rates)
        train.append(replace(truth_of(with_gyro(source)), name=name, tags=tags[name]))
    fitted = {file_of(source.name): source.inspected for source in train}
    driver = next((name.partition("@")[2] for name in names if is_scenario(name)), "")
    judged = []
    for name, each in zip(judges, held_out, strict=True):
        inspected = fitted.get(file_of(name))
        if isinstance(each, Source):
            source = each
        elif is_scenario(name):
            # the same plant as drives the fit's, or the fit would be judged by another truth
            full = f"{name}@{driver}" if driver and "@" not in name else name
            if full in names or name in names:
                raise ValueError(f"{name} is fitted to; it cannot be held out as well")
            source = open_source(full)
        elif inspected is not None:
            source = source_outside(inspected, name, kind, span, rates)
        else:
            log = without_ground(each)
            source = open_source(log, kind, options=options, radius=radius, rates=rates)
        judged.append(replace(truth_of(with_gyro(source)), name=name, tags=tags[name]))
    return train, judged


def distinct_names(option: str, given: Sequence[AnySource]) -> list[str]:
    """Return the names of sources; a ValueError says that one is named twice."""
    names = list(map(source_name, given))
    if len(set(names)) != len(names):
        raise ValueError(f"{option} names a source twice")
    return names


def without_ground(given: T) -> T | str:
    """Return a source, or the log of LOG@GROUND."""
    return split_ground(str(given))[0] if isinstance(given, str | Path) else given


def source_outside(
    inspected: Inspected, name: str, kind: CommandKind, span: Span, rates: Rates = "instant"
) -> Source:
    """Return the parts of a recording outside a span as one source, see `source_of`.

    A ValueError says that there are none.
    """
    start, stop = span
    ends = [(None, start)] * (start is not None) + [(stop, None)] * (stop is not None)
    parts = [source_of(inspected, name, kind, each, rates) for each in ends]
    if not parts:
        raise ValueError(
            f"{name} is fitted to as a whole; without since or until nothing of it is held out"
        )
    pieces = tuple(chain(*(part.pieces for part in parts)))
    warnings = tuple(dict.fromkeys(chain(*(part.warnings for part in parts))))
    title = " and ".join(part.title for part in parts)
    return replace(parts[0], pieces=pieces, warnings=warnings, title=title)


def _truth_finder(profile: Profile) -> Callable[[Source], Source]:
    """Return a function that gives a source its true motion, recorded or of a plant."""

    # building a simulated plant takes long, and several scenarios may share one
    @cache
    def plant(name: str) -> Plant:
        return make_plant(profile, name)

    def resolve(source: Source) -> Source:
        driver = source.reference
        if driver == RECORDING:
            return source
        motions = drive_source(plant(driver), source, profile.section(driver).localiser)
        pieces = []
        for piece, motion in source.driven(motions):
            torques = motion.channels[TORQUES] if plant_kind(driver).torques else None
            pieces.append(replace(piece, reference=motion, torques=torques))
        return replace(source, pieces=tuple(pieces))

    return resolve


def score_pieces(pieces: Sequence[Piece], motions: Sequence[Trajectory]) -> Scores:
    """Return the scores of a plant's motions over some pieces together."""
    metrics = compare_pieces(motions, list(map(true_motion, pieces)))
    torques = torque_errors(pieces, motions)
    if len(torques):
        metrics = Metrics({**metrics, "torque_rms_N_m": float(np.sqrt(np.mean(torques**2)))})
    return score_windows(metrics, pieces, motions, HORIZONS)


def worse_sentences(
    cost: FitCost, even_if_worse: bool, before: Sequence[Scores], after: Sequence[Scores]
) -> list[str]:
    """Return a sentence where the error on held-out sources is larger than before the fit."""

    def size(s: Scores) -> float:
        """The error at the headline's horizon, weighed as in the cost; of scenarios, d_rms."""
        if s.headline is None:
            return s.metrics["d_rms_m"]
        e = s.overlapping[s.headline]
        yaw = cost.yaw_weight * e.yaw_median_rad
        return cost.position_weight * e.position_median_m + yaw

    was = np.mean([*map(size, before)]) if before else 0.0
    now = np.mean([*map(size, after)]) if after else 0.0
    if now <= was:
        return []
    kept = "keeps the old ones (--even-if-worse)"
    if even_if_worse:
        kept = "has the fitted numbers all the same"
    return [
        f"The fit is no better on held-out data than what was before, by the cost that it lowered: "
        f"{now:.4g} instead of {was:.4g}. profile.toml {kept}."
    ]


def choose_inputs(
    inspected: Inspected, trust: bool, warn: Callable[[str], object]
) -> tuple[Inspected, list[Input], list[str]]:
    """Return a log as a fit may see it, the inputs that can drive plants along it, and notes.

    Columns that contradict the others are left out where a fit does without them: a gyro, and
    commands beside wheel rates. So is all but its longest part in which columns agree, where others
    do not in a part alone. The log is then looked at anew. Where it is refused, `warn` is called
    with all else that is wrong with it.

    Raises:
        ValueError: the columns contradict one another without them too and are not to be taken on
            `trust`, or nothing drives a plant.
    """
    name = inspected.log.name
    notes = []
    by_wheels = inspected.log.has(COMMAND_COLUMNS["wheels"])
    commands = COMMAND_COLUMNS["twist"] if by_wheels else ()
    for columns, loss in (
        (("gyro_z",), "The gyro is left out, so the localiser alone tells headings."),
        (commands, "The commands are not to be trusted, so the driver was not fitted."),
    ):
        if not trust and any({*columns} & {*fault.columns} for fault in inspected.fatal):
            inspected = Inspected(inspected.log.without(columns), inspected.radius)
            notes.append(loss)
    if not trust:
        inspected, taken = _sound_part(inspected)
        notes += taken
    log = inspected.log
    if not trust and (inspected.fatal or inspected.lacks):
        _raise_refusal(inspected, warn)
    often = (inspected.uncommanded_share or 0.0) > _UNCOMMANDED
    inputs = list[Input]()
    if by_wheels:
        inputs.append("wheels")
    if log.has(COMMAND_COLUMNS["twist"]) and not often:
        inputs.append("commands")
    if not inputs:
        raise ValueError(
            f"{name} has neither wheel rates, enc_left and enc_right, nor commands that drive it"
        )
    if often:
        notes.append("The wheels often turn without a command, so the driver was not fitted.")
    return inspected, inputs, notes


def _raise_refusal(inspected: Inspected, warn: Callable[[str], object]) -> NoReturn:
    """Raise a ValueError on the first thing to look at; `warn` gets the others."""
    name = inspected.log.name
    lacks = inspected.lacks
    others = [*(fault.sentence for fault in inspected.faults), *lacks]
    spoiled: dict[str, None] = {}
    for fault in inspected.fatal:
        spoiled |= dict.fromkeys(fault.columns)
    first = f"look at {', '.join(spoiled)} first" if spoiled else others.pop(-len(lacks))
    for sentence in others:
        warn(f"{name}: {sentence}")
    raise ValueError(f"{name}: {first}; --trust calibrates all the same")


def _sound_part(inspected: Inspected) -> tuple[Inspected, list[str]]:
    """Return the part of a log that a fit may see, and a note where that is not the whole."""
    if inspected.sound_part is None:
        return inspected, []
    start, end = inspected.sound_part
    part = Inspected(inspected.log.cut(start, end), inspected.radius)
    return part, [f"Only {start:.1f} to {end:.1f} s are taken, where the columns agree."]
