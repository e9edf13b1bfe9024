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
    "gravity": "gravity",
    "turnGravityOff": "weightless",
    "kinematic": "held",
}
"""Elements of a link and of its surfaces, and their names here."""
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
    "torque": ("torque", 1.0),
    "wheelTorque": ("torque", 1.0),
    "max_wheel_torque": ("torque", 1.0),
    "max_force": ("torque", 1.0),
}
"""Names of a controller's numbers, with the names and the factors here."""
_ENTRY = re.compile(r"(\w+)[\"']?\s*:\s*(?:!!\w+\s+)?[\"']?([-+.\deE]+)")
_SIDE_ENTRY = re.compile(
    r"\b(left|right)_wheel(?:_names?)?[\"']?\s*:\s*(\[[^\]]*\]|(?:\s*-\s+\S+)+|[\"'\w/]+)"
)
_SIDE_TAG = re.compile(r"(left|right)\w*(?:joint|front|rear)", re.IGNORECASE)
_SIDES = {"left": 1.0, "right": -1.0}
_YAML_COMMENT = re.compile(r"#.*")
NumbersByName = dict[str, float]
"""Numbers by name [SI]."""


def contact_numbers(root: ElementTree.Element) -> dict[str, NumbersByName]:
    """Return the numbers of each link and its surface in a URDF or an SDF.

    These are `mu1`, `mu2`, `kp`, `kd`, `slip1`, `slip2`, and 1 or 0 for `fdir1`, where a direction
    of friction is given that is not zero, `gravity`, `weightless` and `held`.
    """
    contacts = dict[str, NumbersByName]()
    for owner in root.iter():
        if owner.tag not in ("gazebo", "link"):
            continue
        name = owner.get("reference", owner.get("name", ""))
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
    """Return the number of a word of XML, 1 for `true`; 0 for none."""
    try:
        return float({"true": "1"}.get(word, word))
    except ValueError:
        return 0.0


def plugin_numbers(root: ElementTree.Element) -> tuple[NumbersByName, dict[str, float]]:
    """Return separation, radius, multipliers and torque of the wheels in a description's plugins.

    And the joints that they drive: 1 for one on the left, -1 for one on the right. The torque
    counts of a plugin that drives joints.
    """
    pairs = []
    sides = dict[str, float]()
    for plugin in root.iter("plugin"):
        words = [(part.tag, (part.text or "").strip()) for part in plugin.iter()]
        driven = [(_SIDE_TAG.search(tag), joint) for tag, joint in words]
        own = {
            joint.rpartition("::")[2]: _SIDES[found[1].lower()] for found, joint in driven if found
        }
        sides |= own
        pairs += [
            (tag, word) for tag, word in words if own or _CONTROLLER.get(tag, ("",))[0] != "torque"
        ]
    return _controller(pairs), sides


def controller_numbers(text: str) -> tuple[NumbersByName, dict[str, float]]:
    """Return separation, radius and multipliers of the wheels in a controller's YAML, and sides.

    Raises:
        ValueError: there are none.
    """
    plain = _YAML_COMMENT.sub("", text)
    numbers = _controller(_ENTRY.findall(plain))
    if not numbers:
        raise ValueError(
            "there is no wheel_separation and no wheel_radius in it; wanted the parameters of a "
            "diff_drive_controller"
        )
    sides = {}
    for side, words in _SIDE_ENTRY.findall(plain):
        for joint in re.findall(r"[\w/]+", words):
            sides[joint] = _SIDES[side]
    return numbers, sides


def _controller(pairs: list[tuple[str, str]]) -> NumbersByName:
    """Return the numbers among names and words; the first of each name counts."""
    numbers = NumbersByName()
    for name, word in pairs:
        key, factor = _CONTROLLER.get(name, ("", 0.0))
        value = factor * _number(word)
        if value > 0.0 or (key == "torque" and word):
            numbers.setdefault(key, value)
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
