"""Sets of controller gains: TOML files with provenance, shipped or the user's own.

A file names its `controller`, its own `name` and `source`, and gives every gain of that controller
under `[gains]`; what it was tuned on, and how, stands under `[provenance]`. Whether the numbers
make sense is the controllers' to say.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Literal

import tomli_w
from msgspec import Meta

from ssmr.control.laws import LAWS
from ssmr.parameters import describe_parameters, require_one_of
from validation import output
from validation.files import reading
from validation.output import Document

SCHEMA = "ssmr.gains/1"
FIELDS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {c: tuple(describe_parameters(law.gains)) for c, law in LAWS.items()}
)
"""Names of the gains of each controller."""
DEFAULT = "default"
"""Name of the set that every controller has: the defaults of its class."""
_KINDS = {
    "schema": Annotated[Literal["ssmr.gains/1"], Meta(description=f"'{SCHEMA}'")],
    **dict.fromkeys(("controller", "name", "source"), reading.TomlText),
    **dict.fromkeys(("gains", "provenance"), reading.TomlTable),
}
"""Types of the values at the top level of a file."""
_FINITE = Annotated[reading.TomlNumber, Meta(le=sys.float_info.max, description="a finite number")]
_FOLDER = Path(str(resources.files("validation.experiment"))) / "gain_sets"


@dataclass(frozen=True, eq=False)
class GainSet:
    """All gains of one controller; checked, copied and read-only."""

    controller: str
    """One of `FIELDS`."""
    name: str
    """Name in results."""
    values: Mapping[str, float]
    """Every gain of the controller by name; the units are those of its class."""
    provenance: Document = field(default_factory=dict)
    """Circumstances of the tuning, as the file has them."""
    source: str = ""
    """Origin of the numbers, in one sentence."""

    def __post_init__(self) -> None:
        """Check and freeze.

        Raises:
            ValueError: an unknown controller, unknown or missing gains, or numbers not finite.
        """
        gains = _gains_of(self.controller)
        values = reading.typed(self.values, dict.fromkeys(gains, _FINITE), "gains")
        missing = [name for name in gains if name not in self.values]
        if missing:
            raise ValueError(
                f"[gains] lacks {', '.join(missing)}; {self.controller} needs {', '.join(gains)}"
            )
        object.__setattr__(self, "values", {name: values[name] for name in gains})
        object.__setattr__(self, "provenance", dict(self.provenance))


def shipped_sets(controller: str) -> dict[str, Path]:
    """Return the files of a controller's shipped sets, CONTROLLER-NAME.toml, by NAME.

    Those of a profile are PROFILE/CONTROLLER.toml, and have the profile's name.
    """
    files = [p for p in _FOLDER.glob("*.toml") if p.stem.rpartition("-")[0] == controller]
    sets = {p.stem.removeprefix(f"{controller}-"): p for p in sorted(files)}
    return sets | {p.parent.name: p for p in sorted(_FOLDER.glob(f"*/{controller}.toml"))}


def shipped_gains(controller: str, profile: str) -> GainSet | None:
    """Return the tuned gains that are shipped for a profile, or else for any; None without any."""
    sets = shipped_sets(controller)
    for name in (profile, "tuned"):
        if name in sets:
            return load_gains(controller, name)
    return None


def origin_sentence(gains: GainSet, profile: str) -> str | None:
    """Return a sentence on gains that were found on another profile; None if not, or unknown."""
    origin = gains.provenance.get("profile")
    profiles = origin if isinstance(origin, list) else [origin]
    if profile in profiles or not profiles or not isinstance(profiles[0], str):
        return None
    note = f"The gains {gains.name} were found on the profile {profiles[0]}, not on {profile}"
    if profile in shipped_sets(gains.controller):
        note += f"; there are {profile} gains of its own"
    return f"{note}."


def load_gains(
    controller: str, name_or_path: str | None = None, profile: str | None = None
) -> GainSet:
    """Return the gains of a controller: a shipped set by name, or a TOML file by path.

    Args:
        controller: one of `FIELDS`.
        name_or_path: a name with the controller's in front (`lqr-manual`) or without (`manual`),
            `default`, the name of a profile that gains are shipped for, or a path. None: those of
            `profile` if there are any, else `published` where the thesis has gains for that
            controller, else `tuned`, else `default`, the law's own.
        profile: name of the profile that the gains are for.

    Raises:
        ValueError: there is none, it belongs to another controller, or it has impossible values;
            one line that names file and gain.
    """
    _gains_of(controller)
    sets = shipped_sets(controller)
    usual = [name for name in (profile, "published", "tuned") if name in sets]
    name = str(name_or_path or (*usual, DEFAULT)[0])
    if name.removeprefix(f"{controller}-") in (*sets, DEFAULT):
        name = name.removeprefix(f"{controller}-")
    if name == DEFAULT:
        values = dict(vars(LAWS[controller].gains()))
        source = "defaults of the controller"
        return GainSet(controller, f"{controller}-{DEFAULT}", values, source=source)
    return reading.load_named(
        f"{controller} gains", name, sets, partial(_parse_gains, controller=controller)
    )


def dump_gains(gains: GainSet) -> str:
    """Return the set as TOML; `load_gains` reads equal bits back."""
    document: Document = {
        "schema": SCHEMA,
        "controller": gains.controller,
        "name": gains.name,
        "source": gains.source,
    }
    document["gains"] = dict(gains.values)
    if gains.provenance:
        document["provenance"] = dict(gains.provenance)
    return tomli_w.dumps(output.make_encodable(document))


def _gains_of(controller: str) -> tuple[str, ...]:
    require_one_of(controller, FIELDS, f"unknown controller '{controller}'")
    return FIELDS[controller]


def _parse_gains(document: Document, controller: str) -> GainSet:
    top = dict.fromkeys(_KINDS)
    found = reading.typed({**top, "provenance": {}, **document}, _KINDS)
    if found["controller"] != controller:
        raise ValueError(f"these are gains of {found['controller']}, wanted {controller}")
    values = [found[key] for key in ("name", "gains", "provenance", "source")]
    return GainSet(controller, *values)
