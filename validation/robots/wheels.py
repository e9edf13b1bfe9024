"""The four wheels of a URDF, found by their joints."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ssmr.types import FloatArray
from validation.robots.urdf import UrdfLink, UrdfShape, UrdfTree
from validation.simulator.description import WHEELS
from validation.words import one_line

_UPRIGHT = 0.9
"""Least vertical part of the axis of a joint that steers [1]."""
_LEVEL = 0.17
"""Greatest vertical part of an axle [1]; ten degrees."""
_PARALLEL = 0.985
"""Least cosine between two axles."""
_ASKEW = 0.05
"""Greatest distance of a wheel from the corner of a rectangle, over its shorter side [1]."""
_WHEEL_WORDS = re.compile(r"wheel|tire|tyre|rueda|roue|\brad\b")


@dataclass(frozen=True, eq=False)
class FoundWheels:
    """The wheels of a URDF, and the axes in which the robot drives."""

    links: Mapping[str, UrdfLink]
    """Links of the four wheels, in the order of `WHEELS`."""
    tyres: Mapping[str, UrdfShape | None]
    """Shape of each tyre; None where there is only a mesh."""
    axes: FloatArray
    """(3, 3) unit vectors forward, left and up as rows, in the frame of the first link."""
    middle: FloatArray
    """(3,) midway between the four tyres, in the frame of the first link [m]."""
    wheelbase: float
    """Distance of the axles [m]."""
    track: float
    """Distance of the sides [m]."""
    askew: float
    """Greatest distance of a tyre from the corner of the rectangle that is taken [m]."""
    remarks: tuple[str, ...]
    """What was unusual."""


def find_wheels(tree: UrdfTree) -> FoundWheels:
    """Return the four wheels of a URDF.

    A wheel is a link on a continuous or revolute joint whose axis is level, parallel to those of the others, and that
    carries no other wheel. Names only decide where there are more than four, and which end is the front where x is not.

    Raises:
        ValueError: there are not four, they do not stand at the corners of a rectangle, one can be steered, or they have
            rollers; the message says which joints there are.
    """
    if any(word in tree.words for word in ("mecanum", "omni_wheel", "omniwheel", "swedish")):
        raise ValueError("its wheels are mecanum or omni wheels, which roll sideways; a skid-steering robot has plain ones")
    four = _four(tree)
    for link in four:
        steering = [up for up in tree.above(link.name) if _turns(up) and abs(up.axis[2]) > _UPRIGHT]
        if steering:
            raise ValueError(
                f"wheel '{one_line(link.joint)}' can be steered by joint '{one_line(steering[0].joint)}'; the wheels of a "
                "skid-steering robot cannot"
            )
    axes, remarks = _driving_axes(four)
    tyres = {link.name: _tyre(tree, link, axes[1]) for link in four}
    places = {link.name: link.place if tyres[link.name] is None else tyres[link.name].centre for link in four}  # type: ignore[union-attr]
    corners = _corners(four, places, axes)
    ordered = np.array([places[corners[wheel].name] @ axes.T for wheel in WHEELS])
    wheelbase = float(ordered[:2, 0].mean() - ordered[2:, 0].mean())
    track = float(ordered[::2, 1].mean() - ordered[1::2, 1].mean())
    middle = ordered.mean(axis=0)
    ideal = middle[:2] + 0.5 * np.array([[wheelbase, track], [wheelbase, -track], [-wheelbase, track], [-wheelbase, -track]])
    askew = float(np.abs(ordered[:, :2] - ideal).max())
    if askew > _ASKEW * min(wheelbase, track):
        raise ValueError(
            f"the four wheels do not stand at the corners of a rectangle: one is {1e3 * askew:.0f} mm away from that of "
            f"{wheelbase:.3f} by {track:.3f} m"
        )
    return FoundWheels(
        corners,
        {wheel: tyres[corners[wheel].name] for wheel in WHEELS},
        axes,
        middle @ axes,
        wheelbase,
        track,
        askew,
        remarks,
    )


def _turns(link: UrdfLink) -> bool:
    return link.joint_type in ("continuous", "revolute")


def _listed(links: Sequence[UrdfLink]) -> str:
    names = [one_line(link.joint) for link in links]
    return ", ".join(names[:8]) + (", …" if len(names) > 8 else "") or "none"


def _four(tree: UrdfTree) -> list[UrdfLink]:
    """Return the links of four wheels.

    Raises:
        ValueError: there are not four.
    """
    level = [link for link in tree.links.values() if _turns(link) and abs(link.axis[2]) < _LEVEL]
    if not level:
        every = [link for link in tree.links.values() if _turns(link)]
        raise ValueError(
            "it has no wheels: wanted four continuous joints whose axes lie level; its joints that turn are "
            + _listed(every)
        )
    names = {link.name for link in level}
    carried = {up.name for link in level for up in tree.above(link.name)}
    for link in level:
        rollers = [other for other in tree.below(link.name) if other.parent == link.name and other.name in names]
        if len(rollers) >= 4 and link.joint_type == "continuous":
            raise ValueError(
                f"wheel '{one_line(link.joint)}' has rollers, as mecanum wheels have; a skid-steering robot has none"
            )
    leaves = [link for link in level if link.name not in carried]
    found = max(([a for a in leaves if abs(a.axis @ b.axis) > _PARALLEL] for b in leaves), key=len)
    for keep in (
        lambda a: a.joint_type == "continuous",
        lambda a: _WHEEL_WORDS.search(f"{a.joint} {a.name}".lower()) is not None,
    ):
        fewer = [link for link in found if keep(link)]
        if len(found) > 4 and len(fewer) >= 4:
            found = fewer
    if len(found) != 4:
        raise ValueError(
            f"it has {len(found)} joints that look like wheels, and a skid-steering robot here has four: {_listed(found)}"
        )
    return found


def _driving_axes(four: Sequence[UrdfLink]) -> tuple[FloatArray, tuple[str, ...]]:
    """Return the axes forward, left and up, and a remark where forward is not the file's x axis."""
    axis = np.array([four[0].axis[0], four[0].axis[1], 0.0])
    left = axis / np.linalg.norm(axis)
    up = np.array([0.0, 0.0, 1.0])
    forward = np.cross(left, up)
    sign = 1.0 if forward[0] >= 0.0 else -1.0
    remarks: tuple[str, ...] = ()
    if abs(forward[0]) < 0.7:
        places = np.array([link.place for link in four])
        ahead = (places - places.mean(axis=0)) @ forward
        named = sum(
            a * (("front" in text) - ("rear" in text or "back" in text))
            for a, text in ((a, f"{link.joint} {link.name}".lower()) for a, link in zip(ahead, four, strict=True))
        )
        sign = float(np.sign(named) or np.sign(forward[1]))
        turned = np.degrees(np.arctan2(sign * forward[1], sign * forward[0]))
        remarks = (
            f"forward is {turned:.0f}° from the file's x axis, for its axles lie so; which end is the front "
            + ("is by the names of the wheels" if named else "is a guess"),
        )
    return np.array([sign * forward, sign * left, up]), remarks


def _corners(four: Sequence[UrdfLink], places: Mapping[str, FloatArray], axes: FloatArray) -> dict[str, UrdfLink]:
    """Return the wheels by their corner.

    Raises:
        ValueError: two stand at the same corner.
    """
    middle = np.mean([places[link.name] for link in four], axis=0)
    found: dict[str, UrdfLink] = {}
    for link in four:
        ahead, aside, _ = axes @ (places[link.name] - middle)
        found.setdefault(f"{'front' if ahead > 0.0 else 'rear'}_{'left' if aside > 0.0 else 'right'}", link)
    if set(found) != set(WHEELS):
        raise ValueError(f"the four wheels do not stand at the corners of a rectangle: {_listed(four)}")
    return {wheel: found[wheel] for wheel in WHEELS}


def _tyre(tree: UrdfTree, wheel: UrdfLink, left: FloatArray) -> UrdfShape | None:
    """Return the shape of a tyre: the greatest cylinder about the axle, or sphere, of collision if there is one."""
    shapes = [shape for link in tree.below(wheel.name) for shape in link.shapes]
    round_ = [s for s in shapes if s.kind == "sphere" or (s.kind == "cylinder" and abs(s.rotation[:, 2] @ left) > _PARALLEL)]
    return max(round_, key=lambda s: (s.collides, s.size[0]), default=None)
