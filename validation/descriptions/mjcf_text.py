"""An MJCF as text: single attributes are changed, and every other byte stays."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree  # nosec B405 # of trees that were parsed before
from collections.abc import Iterator, Mapping
from xml.sax.saxutils import quoteattr  # nosec B406 # it writes, and reads nothing

import mujoco

from validation.simulator import foreign

Part = tuple[str, str]
"""Kind and name of a part."""
Edits = Mapping[Part, Mapping[str, str]]
"""New values of attributes by part."""


class MjcfText:
    """A text whose parts are known by the names that they have in the model.

    Parts without a name have one by `foreign.complete`. Kinds are `option`, `geom`, `joint`,
    `body`, `actuator`, `flag`, `pair` and `equality` (these two by their numbers).
    """

    def __init__(self, text: str, files: Mapping[str, bytes]) -> None:
        """Find every part.

        Raises:
            ValueError: parts are made by others, such as `<replicate>`: text and model differ.
        """
        tags = foreign.xml_tags(text)
        self._plain = text
        if all(tag.element.tag != "option" for tag in tags):
            raw = text.encode()
            at = tags[0].inside
            text = (raw[:at] + b"<option/>" + raw[at:]).decode()
            tags = foreign.xml_tags(text)
        self.raw = text.encode()
        self._tags = {id(tag.element): tag for tag in tags}
        self._parts = dict[Part, foreign.Tag]()
        spec = mujoco.MjSpec.from_string(text, assets=dict(files))
        foreign.name_parts(spec)
        root = tags[0].element
        for option in root.findall("option"):
            self._parts["option", ""] = self._tags[id(option)]
            for flag in option.findall("flag"):
                self._parts["flag", ""] = self._tags[id(flag)]
        self._elements = dict[str, list[ElementTree.Element]](body=[], joint=[], geom=[])
        for world in root.findall("worldbody"):
            self._walk(list(_flat(world)))
        self._elements["actuator"] = root.findall("actuator/*")
        parts = {"joint": spec.joints, "geom": spec.geoms, "actuator": spec.actuators}
        for kind, those in {"body": spec.bodies[1:], **parts}.items():
            elements = self._elements[kind]
            if len(those) != len(elements):
                raise ValueError(
                    f"its {kind}s are not all written one by one, so that none can be changed in "
                    "place"
                )
            for part, element in zip(those, elements, strict=True):
                self._parts[kind, part.name] = self._tags[id(element)]
        pairs = root.findall("contact/pair")
        ties = root.findall("equality/*")
        for kind, elements in (("pair", pairs), ("equality", ties)):
            for number, element in enumerate(elements):
                self._parts[kind, str(number)] = self._tags[id(element)]

    def _walk(self, inside: list[ElementTree.Element]) -> None:
        """Note what is in a body, and then in those that hang on it: the order of a model."""
        for element in inside:
            if element.tag in ("geom", "joint", "freejoint"):
                self._elements[element.tag.removeprefix("free")].append(element)
        for element in inside:
            if element.tag == "body":
                self._elements["body"].append(element)
                self._walk(list(_flat(element)))

    def __contains__(self, part: Part) -> bool:
        """Return whether a part is written in the text."""
        return part in self._parts

    def attributes(self, part: Part) -> Mapping[str, str]:
        """Return what a part's tag says, by attribute."""
        return self._parts[part].element.attrib

    def tag(self, part: Part) -> str:
        """Return the tag of a part, such as `velocity` of an actuator."""
        return self._parts[part].element.tag

    def line(self, part: Part) -> int:
        """Return the number of the line in which a part begins, from 1."""
        return 1 + self.raw[: self._parts[part].start].count(b"\n")

    def edited(self, edits: Edits) -> str:
        """Return the text with attributes changed or added."""
        if not edits:
            return self._plain
        raw = self.raw
        for part in sorted(edits, key=lambda part: self._parts[part].start, reverse=True):
            tag = self._parts[part]
            opening = raw[tag.start : tag.inside].decode()
            for attribute, value in edits[part].items():
                opening = _with_attribute(opening, attribute, value)
            raw = raw[: tag.start] + opening.encode() + raw[tag.inside :]
        return raw.decode()


def _with_attribute(opening: str, attribute: str, value: str) -> str:
    """Return a start tag with one attribute changed or added."""
    pattern = re.compile(rf"""(\s{re.escape(attribute)}\s*=\s*)("[^"]*"|'[^']*')""")
    quoted = quoteattr(value)
    if pattern.search(opening):
        return pattern.sub(lambda match: match[1] + quoted, opening, count=1)
    end = "/>" if opening.endswith("/>") else ">"
    return f"{opening[: -len(end)].rstrip()} {attribute}={quoted}{end}"


def _flat(element: ElementTree.Element) -> Iterator[ElementTree.Element]:
    """Yield the elements inside one, also those in its frames."""
    for child in element:
        if child.tag == "frame":
            yield from _flat(child)
        else:
            yield child
