"""SOURCE on the fit's command line -> motions to make, and motions held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from ssmr.scenarios import TRAJECTORIES
from ssmr.types import CommandKind
from validation.fit.objective import Target
from validation.motion.driving import drive
from validation.motion.sources import Source, open_source
from validation.plants.profile import Profile, make_plant

Input = Literal["commands", "wheels", "both"]
_KINDS: dict[Input, tuple[tuple[str, CommandKind], ...]] = {
    "commands": (("commands", "twist"),),
    "wheels": (("wheels", "wheels"),),
    "both": (("wheels", "wheels"), ("commands", "twist")),
}


def parse_sources(text: str, what: str) -> tuple[str, ...]:
    """Comma-separated sources, none twice; an existing file whose name has commas is one source.

    Raises:
        ValueError: none, or one twice.
    """
    names = (text,) if Path(text).exists() else tuple(part.strip() for part in text.split(",") if part.strip())
    if not names or len(set(names)) != len(names):
        raise ValueError(f"{what} '{text}' names {'a source twice' if names else 'no source'}")
    return names


def is_scenario(name: str) -> bool:
    """Whether a source is one of the thesis' trajectories, and no recording."""
    return name.partition("@")[0] in TRAJECTORIES


def train_targets(
    names: Sequence[str], profile: Profile, given: Input, start: float | None, stop: float | None
) -> tuple[Target, ...]:
    """What the fit is held to.

    Args:
        names: sources.
        profile: gives the plant that drives a scenario its numbers.
        given: what of a recording drives the fitted plant.
        start: leave out what was recorded before [s].
        stop: leave out what was recorded after [s].

    Raises:
        ValueError: a source that cannot be read or lacks what is asked for.
        SsmrError: the plant that drives a scenario diverged.
    """
    if all(map(is_scenario, names)) and (start is not None or stop is not None):
        raise ValueError(f"--from and --until cut recordings; {', '.join(names)} are scenarios")
    found: list[Target] = []
    for name in names:
        if is_scenario(name):
            if given != "commands":
                raise ValueError(f"{name} has no measured wheel rates; --input {given} needs a recording")
            found.append(_resolved(open_source(name), name, profile))
        else:
            found += _recorded(name, profile, given, [(start, stop)])
    return tuple(found)


def held_out_targets(
    names: Sequence[str],
    train: Sequence[str],
    profile: Profile,
    given: Input,
    start: float | None,
    stop: float | None,
) -> tuple[Target, ...]:
    """What the fit is judged on: a scenario by the plant that made the fit's own scenario, unless it names another; of a
    recording that was also fitted to, what lies outside --from and --until.

    Raises:
        ValueError: a source that cannot be read, or of which nothing is left.
        SsmrError: the plant that drives a scenario diverged.
    """  # noqa: D205
    driver = next((name.partition("@")[2] for name in train if is_scenario(name)), "")
    found: list[Target] = []
    for name in names:
        if is_scenario(name):
            full = f"{name}@{driver}" if driver and "@" not in name else name
            if full in train or name in train:
                raise ValueError(f"{name} is fitted to; it cannot be held out as well")
            found.append(_resolved(open_source(full), name, profile))
        elif Path(name).resolve() in [Path(t).resolve() for t in train]:
            spans = [*([(None, start)] if start is not None else []), *([(stop, None)] if stop is not None else [])]
            if not spans:
                raise ValueError(f"{name} is fitted to as a whole; nothing of it is held out without --from or --until")
            found += _recorded(name, profile, given, spans)
        else:
            found += _recorded(name, profile, given, [(None, None)])
    return tuple(found)


def _recorded(name: str, profile: Profile, given: Input, spans: Sequence[tuple[float | None, float | None]]) -> list[Target]:
    """A recording, once for each input; several spans of it are one target."""
    targets = []
    for word, kind in _KINDS[given]:
        parts = [open_source(name, kind, start, stop) for start, stop in spans]
        whole = replace(parts[0], pieces=tuple(piece for part in parts for piece in part.pieces))
        label = f"{name} ({word})" if len(_KINDS[given]) > 1 else name
        targets.append(_resolved(whole, label, profile))
    return targets


def _resolved(source: Source, label: str, profile: Profile) -> Target:
    if source.reference == "recording":
        return Target(label, source, tuple(p.reference for p in source.pieces if p.reference is not None))
    plant, point = make_plant(profile, source.reference), profile.plants[source.reference].tracked_point
    return Target(label, source, tuple(drive(plant, piece, point, source.sample_dt) for piece in source.pieces))
