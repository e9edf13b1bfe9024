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
_FOLDER = resources.files("validation.bench").joinpath("gain_sets")


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
        """Check and freeze; a ValueError refuses an unknown controller, unknown or missing gains, and numbers not finite."""
        known = _gains_of(self.controller)
        if unknown := [name for name in self.values if name not in known]:
            some = ", ".join(unknown[:5])
            raise ValueError(
                f"[gains] has unknown names {some}; {self.controller} has {', '.join(known)}"
            )
        if missing := [name for name in known if name not in self.values]:
            raise ValueError(
                f"[gains] lacks {', '.join(missing)}; {self.controller} needs {', '.join(known)}"
            )
        for name, value in self.values.items():
            if not reading.is_number(value) or not math.isfinite(value):
                raise ValueError(f"[gains] {name} is {reprlib.repr(value)}, wanted a finite number")
        object.__setattr__(self, "values", {name: float(self.values[name]) for name in known})
        object.__setattr__(self, "provenance", dict(self.provenance))


def names(controller: str | None = None) -> list[str]:
    """Return the names of the shipped sets, CONTROLLER-NAME each; only those of `controller`, if given."""
    known = sorted(
        p.name.removesuffix(".toml") for p in _FOLDER.iterdir() if p.name.endswith(".toml")
    )
    return (
        known
        if controller is None
        else [name for name in known if name.rpartition("-")[0] == controller]
    )


def profile_sets(controller: str) -> list[str]:
    """Return the names of the profiles that a set of gains is shipped for: `gain_sets/PROFILE/CONTROLLER.toml`."""
    return sorted(
        p.name
        for p in _FOLDER.iterdir()
        if p.is_dir() and p.joinpath(f"{controller}.toml").is_file()
    )


def sets_of(controller: str) -> list[str]:
    """Return every name that a shipped set of a controller's gains can be asked for by, without the controller's."""
    return [
        *(name.removeprefix(f"{controller}-") for name in names(controller)),
        *profile_sets(controller),
        DEFAULT,
    ]


def shipped_gains(controller: str, profile: str) -> GainSet | None:
    """Return the tuned gains that are shipped for a profile, else the usual tuned ones; None where there are none."""
    if profile in profile_sets(controller):
        return load_gains(controller, profile)
    return load_gains(controller, "tuned") if "tuned" in sets_of(controller) else None


def origin_sentence(gains: GainSet, profile: str) -> str | None:
    """Return a sentence on gains that were found on another profile than this; None where they were not, or do not say."""
    origin = gains.provenance.get("profile")
    known = origin if isinstance(origin, list) else [origin]
    if profile in known or not known or not isinstance(known[0], str):
        return None
    own = (
        f"; there are {profile} gains of its own"
        if profile in profile_sets(gains.controller)
        else ""
    )
    return f"The gains {gains.name} were found on the profile {known[0]}, not on {profile}{own}."


def load_gains(
    controller: str, name_or_path: str | None = None, profile: str | None = None
) -> GainSet:
    """Return the gains of a controller: a shipped set by name, or a TOML file by path.

    Args: controller: one of `FIELDS`. name_or_path: a name with the controller's in front
        (`lqr-manual`) or without (`manual`), `default`, the name of a
            profile that gains are shipped for, or a path. None: those of `profile` if there are
            any, else `published` where the thesis has gains for that controller, else `tuned`, else
            `default`, the law's own.
        profile: name of the profile that the gains are for.

    Raises: ValueError: there is none, it belongs to another controller, or it says something that
        cannot be; one line that
            names file and gain.
    """
    _gains_of(controller)
    own = profile_sets(controller)
    known = sets_of(controller)
    if name_or_path is None:
        usual = next(name for name in ("published", "tuned", DEFAULT) if name in known)
        name_or_path = profile if profile in own else usual
    if name_or_path == DEFAULT:
        values = asdict(LAWS[controller].gains())
        return GainSet(
            controller, f"{controller}-{DEFAULT}", values, source="defaults of the controller"
        )
    shipped = {f"{controller}-{name_or_path}", name_or_path} & set(names())
    file = f"{name_or_path}/{controller}" if name_or_path in own else next(iter(shipped), None)
    if file is None and not os.path.exists(name_or_path):
        every = ", ".join(known)
        raise ValueError(
            f"{controller} has no gains '{name_or_path}'; there are: {every}; or give the path of a TOML file"
        )
    shown = f"gains {name_or_path}"
    if file is None:
        document = reading.parse_toml(reading.read_text(name_or_path), shown)
    else:
        document = reading.parse_toml(
            _FOLDER.joinpath(f"{file}.toml").read_text(encoding="utf-8"), shown
        )
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
    reading.require_known(
        document, ("schema", "controller", "name", "source", "gains", "provenance"), "the top level"
    )
    if document.get("controller") != controller:
        raise ValueError(
            f"these are gains of {document.get('controller', 'no controller')}, wanted {controller}"
        )
    document = {"provenance": {}, **document}
    for key, kind, what in (("name", str, "text"), ("source", str, "text"), ("gains", dict, "a table"),
                            ("provenance", dict, "a table")):  # fmt: skip
        if not isinstance(document.get(key), kind):
            raise ValueError(f"{key} is {reprlib.repr(document.get(key))}, wanted {what}")
    return GainSet(
        controller, *(document[key] for key in ("name", "gains", "provenance", "source"))
    )
