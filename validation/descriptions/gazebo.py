"""Numbers for Gazebo and for controllers, beside a robot's links and joints."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree  # nosec B405 # of trees that were parsed before
from collections.abc import Mapping

_CONTACT = {
    "mu": "mu1",
    "mu1": "mu1",
    "mu2": "mu2",
    "kp": "kp",
    "kd": "kd",
    "slip1": "slip1",
    "slip2": "slip2",
    "fdir1": "fdir1",
}
"""Elements of a surface, and their names here."""
_CONTROLLER = {
    "wheel_separation": ("separation", 1.0),
    "wheelSeparation": ("separation", 1.0),
    "wheel_radius": ("radius", 1.0),
    "wheelRadius": ("radius", 1.0),
    "wheel_diameter": ("radius", 0.5),
    "wheelDiameter": ("radius", 0.5),
    "wheel_separation_multiplier": ("separation_multiplier", 1.0),
    "wheel_radius_multiplier": ("radius_multiplier", 1.0),
    "left_wheel_radius_multiplier": ("radius_multiplier", 1.0),
}
"""Names of a controller's numbers, with the names and the factors here."""
_ENTRY = re.compile(r"(\w+)[\"']?\s*:\s*(?:!!\w+\s+)?[\"']?([-+.\deE]+)")
_YAML_COMMENT = re.compile(r"#.*")
NumbersByName = dict[str, float]
"""Numbers by name [SI]."""


def contact_numbers(root: ElementTree.Element) -> dict[str, NumbersByName]:
    """Return the numbers of each link's surface in a URDF or an SDF.

    These are `mu1`, `mu2`, `kp`, `kd`, `slip1`, `slip2`, and `fdir1`, 1 where a direction of
    friction is given that is not zero.
    """
    contacts = dict[str, NumbersByName]()
    for owner in root.iter():
        if owner.tag == "gazebo" and "reference" in owner.attrib:
            name = owner.get("reference", "")
        elif owner.tag == "link" and owner.find(".//surface") is not None:
            name = owner.get("name", "")
        else:
            continue
        numbers = contacts.setdefault(name, {})
        for part in owner.iter():
            key = _CONTACT.get(part.tag.rpartition(":")[2])
            words = part.get("value", part.text or "").split()
            if key == "fdir1":
                numbers[key] = float(any(_number(word) for word in words))
            elif key is not None and len(words) == 1:
                numbers.setdefault(key, _number(words[0]))
    return contacts


def _number(word: str) -> float:
    """Return the number of a word of XML; 0 for none."""
    try:
        return float(word)
    except ValueError:
        return 0.0


def plugin_numbers(root: ElementTree.Element) -> NumbersByName:
    """Return separation, radius and multipliers of the wheels in the plugins of a URDF or SDF."""
    pairs = []
    for plugin in root.iter("plugin"):
        for part in plugin.iter():
            pairs.append((part.tag, (part.text or "").strip()))
    return _controller(pairs)


def controller_numbers(text: str) -> NumbersByName:
    """Return separation, radius and multipliers of the wheels in a controller's YAML.

    Raises:
        ValueError: there are none.
    """
    numbers = _controller(_ENTRY.findall(_YAML_COMMENT.sub("", text)))
    if not numbers:
        raise ValueError(
            "there is no wheel_separation and no wheel_radius in it; wanted the parameters of a "
            "diff_drive_controller"
        )
    return numbers


def _controller(pairs: list[tuple[str, str]]) -> NumbersByName:
    """Return the numbers among names and words; the first of each name counts."""
    numbers = NumbersByName()
    for name, word in pairs:
        key, factor = _CONTROLLER.get(name, ("", 1.0))
        value = _number(word)
        if key and value > 0.0:
            numbers.setdefault(key, factor * value)
    return numbers


def driver_sizes(controller: Mapping[str, float]) -> tuple[float | None, float | None]:
    """Return half the separation and the radius that a controller reckons with [m]."""
    separation = controller.get("separation")
    half = None
    if separation is not None:
        half = 0.5 * separation * controller.get("separation_multiplier", 1.0)
    radius = controller.get("radius")
    if radius is not None:
        radius *= controller.get("radius_multiplier", 1.0)
    return half, radius


_SIDEWAYS = re.compile(r"mecanum|omni_?wheel|swedish", re.IGNORECASE)
_STEERED = re.compile(r"ackermann", re.IGNORECASE)
_TRACKS = re.compile(
    r"(^|[_\W])(tracks?|crawlers?|caterpillars?|flippers?)([_\W\d](?!cam|width|sensor)|$)"
    r"|tracked|trackcontroller",
    re.IGNORECASE,
)
_PARTS = ("link", "joint", "body", "geom", "plugin")
_WHOLES = ("robot", "model", "mujoco")


def require_plain_wheels(root: ElementTree.Element) -> None:
    """Raise a ValueError that says what stands in place of four plain wheels, by name."""
    parts = list[str]()
    wholes = list[str]()
    for element in root.iter():
        names = parts if element.tag in _PARTS else wholes
        if element.tag in (*_PARTS, *_WHOLES):
            names += [element.get(key, "") for key in ("name", "model", "filename")]
    tracked = [name for name in wholes if "tracked" in name.lower()]
    for pattern, words, names in (
        (_SIDEWAYS, "wheels are mecanum or omni wheels, which roll sideways", parts + wholes),
        (_STEERED, "wheels are steered, as a car's are (Ackermann)", parts + wholes),
        # a world may have a race track
        (_TRACKS, "ground is touched by tracks, not by wheels", parts + tracked),
    ):
        found = next((name for name in names if pattern.search(name)), None)
        if found is not None:
            raise ValueError(
                f"its {words} ('{found}'); a skid-steering robot here has four plain, fixed wheels"
            )
