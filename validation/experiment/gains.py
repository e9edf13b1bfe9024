"""Sets of controller gains: TOML files with provenance, shipped or the user's own.

A file names its `controller`, its own `name` and `source`, and gives every gain of that controller
under `[gains]`; what it was tuned on, and how, stands under `[provenance]`. Whether the numbers
make sense is the controllers' to say.
"""

from __future__ import annotations

import math
import os
import reprlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from importlib import resources
from types import MappingProxyType
from typing import Any

import tomli_w

from ssmr.control.laws import LAWS
from ssmr.parameters import described
from validation import store
from validation.files import reading

SCHEMA = "ssmr.gains/1"
FIELDS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {c: tuple(described(law.gains)) for c, law in LAWS.items()}
)
"""Names of the gains of each controller."""
DEFAULT = "default"
"""Name of the set that every controller has: the defaults of its class."""
_TOP_LEVEL = {
    "name": (str, "text"),
    "source": (str, "text"),
    "gains": (dict, "a table"),
    "provenance": (dict, "a table"),
}
"""Type of each value at the top level of a file, and its name in messages."""
_FOLDER = resources.files("validation.experiment").joinpath("gain_sets")


@dataclass(frozen=True, eq=False)
class GainSet:
    """All gains of one controller; checked, copied and read-only."""

    controller: str
    """One of `FIELDS`."""
    name: str
    """Name in results."""
    values: Mapping[str, float]
    """Every gain of the controller by name; the units are those of its class."""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    """Circumstances of the tuning, as the file has them."""
    source: str = ""
    """Origin of the numbers, in one sentence."""

    def __post_init__(self) -> None:
        """Check and freeze.

        Raises:
            ValueError: an unknown controller, unknown or missing gains, or numbers not finite.
        """
        gains = _gains_of(self.controller)
        unknown = [name for name in self.values if name not in gains]
        if unknown:
            raise ValueError(
                f"[gains] has unknown names {', '.join(unknown[:5])}; "
                f"{self.controller} has {', '.join(gains)}"
            )
        missing = [name for name in gains if name not in self.values]
        if missing:
            raise ValueError(
                f"[gains] lacks {', '.join(missing)}; {self.controller} needs {', '.join(gains)}"
            )
        for name, value in self.values.items():
            if not reading.is_number(value) or not math.isfinite(value):
                raise ValueError(f"[gains] {name} is {reprlib.repr(value)}, wanted a finite number")
        object.__setattr__(self, "values", {name: float(self.values[name]) for name in gains})
        object.__setattr__(self, "provenance", dict(self.provenance))


def names(controller: str | None = None) -> list[str]:
    """Return the names of the shipped sets, or of a controller's; CONTROLLER-NAME each."""
    files = [p.name for p in _FOLDER.iterdir() if p.name.endswith(".toml")]
    shipped = sorted(name.removesuffix(".toml") for name in files)
    if controller is None:
        return shipped
    return [name for name in shipped if name.rpartition("-")[0] == controller]


def profile_sets(controller: str) -> list[str]:
    """Return the names of the profiles with a set of gains, `gain_sets/PROFILE/CONTROLLER.toml`."""
    folders = [p for p in _FOLDER.iterdir() if p.is_dir()]
    return sorted(p.name for p in folders if p.joinpath(f"{controller}.toml").is_file())


def sets_of(controller: str) -> list[str]:
    """Return the names of all shipped sets of a controller's gains, without the controller's."""
    shipped = [name.removeprefix(f"{controller}-") for name in names(controller)]
    return [*shipped, *profile_sets(controller), DEFAULT]


def shipped_gains(controller: str, profile: str) -> GainSet | None:
    """Return the tuned gains that are shipped for a profile, or else for any; None without any."""
    if profile in profile_sets(controller):
        return load_gains(controller, profile)
    if "tuned" in sets_of(controller):
        return load_gains(controller, "tuned")
    return None


def origin_sentence(gains: GainSet, profile: str) -> str | None:
    """Return a sentence on gains that were found on another profile; None if not, or unknown."""
    origin = gains.provenance.get("profile")
    profiles = origin if isinstance(origin, list) else [origin]
    if profile in profiles or not profiles or not isinstance(profiles[0], str):
        return None
    note = f"The gains {gains.name} were found on the profile {profiles[0]}, not on {profile}"
    if profile in profile_sets(gains.controller):
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
    profiles = profile_sets(controller)
    sets = sets_of(controller)
    if name_or_path is None:
        tuned = next(name for name in ("published", "tuned", DEFAULT) if name in sets)
        name_or_path = profile if profile in profiles else tuned
    if name_or_path == DEFAULT:
        values = asdict(LAWS[controller].gains())
        source = "defaults of the controller"
        return GainSet(controller, f"{controller}-{DEFAULT}", values, source=source)
    shipped = {f"{controller}-{name_or_path}", name_or_path} & set(names())
    file = next(iter(shipped), None)
    if name_or_path in profiles:
        file = f"{name_or_path}/{controller}"
    if file is None and not os.path.exists(name_or_path):
        raise ValueError(
            f"{controller} has no gains '{name_or_path}'; "
            f"there are: {', '.join(sets)}; or give the path of a TOML file"
        )
    if file is None:
        text = reading.read_text(name_or_path)
    else:
        text = _FOLDER.joinpath(f"{file}.toml").read_text(encoding="utf-8")
    shown = f"gains {name_or_path}"
    document = reading.parse_toml(text, shown)
    try:
        return _parse(document, controller)
    except ValueError as error:
        raise ValueError(f"{shown}: {' '.join(str(error).split())}") from error


def dump_gains(gains: GainSet) -> str:
    """Return the set as TOML; `load_gains` reads equal bits back."""
    document: dict[str, Any] = {
        "schema": SCHEMA,
        "controller": gains.controller,
        "name": gains.name,
        "source": gains.source,
    }
    document["gains"] = dict(gains.values)
    if gains.provenance:
        document["provenance"] = dict(gains.provenance)
    return tomli_w.dumps(store.encodable(document))


def _gains_of(controller: str) -> tuple[str, ...]:
    if controller not in FIELDS:
        raise ValueError(f"unknown controller '{controller}'; there are: {', '.join(FIELDS)}")
    return FIELDS[controller]


def _parse(document: Mapping[str, Any], controller: str) -> GainSet:
    if document.get("schema") != SCHEMA:
        raise ValueError(f"schema is {reprlib.repr(document.get('schema'))}, wanted '{SCHEMA}'")
    reading.require_known(document, ("schema", "controller", *_TOP_LEVEL), "the top level")
    owner = document.get("controller", "no controller")
    if owner != controller:
        raise ValueError(f"these are gains of {owner}, wanted {controller}")
    document = {"provenance": {}, **document}
    for key, (kind, words) in _TOP_LEVEL.items():
        value = document.get(key)
        if not isinstance(value, kind):
            raise ValueError(f"{key} is {reprlib.repr(value)}, wanted {words}")
    values = [document[key] for key in ("name", "gains", "provenance", "source")]
    return GainSet(controller, *values)
