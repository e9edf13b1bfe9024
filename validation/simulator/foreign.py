"""A foreign MJCF or URDF: MuJoCo tries it in a child process with only the files of its folder.

MuJoCo's reader answers no signal while it works. A file that the child has read is as quick for
this process.
"""

from __future__ import annotations

import os
import re
import xml.etree.ElementTree as ElementTree  # nosec B405 # of texts that declare no entities
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.parsers import expat  # nosec B407 # of texts that declare no entities

import mujoco
import numpy as np

from ssmr.types import FloatArray
from validation.files import guarded
from validation.files.reading import read_file

ALLOWANCE: guarded.Allowance = (10.0, 2 << 30, 0)
"""Limits of reading and compiling a model, with all files that it includes."""
MOST_BYTES = 1 << 22
"""Greatest size of a text [bytes]; large ones of manipulators have a few hundred thousand."""
_MOST_FILES = 1000
"""Greatest number of the files that an MJCF brings."""
_MOST_SIZE = 1 << 26
"""Greatest total size of these files [bytes]."""
_DEEPEST = 20
"""Greatest depth to which files include files."""
_ELSEWHERE = "in its folder, and files from elsewhere are not read"
_COMMENT = re.compile(r"<!--(.*?)-->", re.DOTALL)
_DECLARATION = re.compile(r"^[\ufeff\s]*<\?xml[^>]*\?>")
_START_TAG = re.compile(rb"""<(?:[^>"']|"[^"]*"|'[^']*')*>""")


class Tag(NamedTuple):
    """An element of an XML text, and where it stands there."""

    element: ElementTree.Element
    """The element."""
    start: int
    """Place of its first byte."""
    inside: int
    """Place behind its start tag."""
    end: int
    """Place of its end tag; `inside` for an element without one."""
    behind: int
    """Place behind it."""


def xml_tags(text: str) -> list[Tag]:
    """Return the elements of an XML text in its order, the root first.

    It is as tolerant as simulators are: a comment may hold any dashes, prefixes need no
    declaration, and spaces may stand before the declaration.

    Raises:
        ValueError: it is no XML, or declares entities, which could grow.
    """
    quiet = _COMMENT.sub(_without_dashes, text)
    bare = _COMMENT.sub("", text)
    if "<!DOCTYPE" in bare or "<!ENTITY" in bare:
        raise ValueError(
            "the file declares a document type or entities, which no robot has a use for; "
            "take them out"
        )
    raw = _DECLARATION.sub(lambda match: " " * len(match[0]), quiet).encode()
    builder = ElementTree.TreeBuilder()
    parser = expat.ParserCreate("utf-8")
    tags = list[Tag]()
    open_tags = []

    def begin(name: str, attributes: dict[str, str]) -> None:
        start = parser.CurrentByteIndex
        match = _START_TAG.match(raw, start)
        inside = start if match is None else match.end()
        open_tags.append(len(tags))
        tags.append(Tag(builder.start(name, attributes), start, inside, inside, inside))

    def finish(name: str) -> None:
        builder.end(name)
        number = open_tags.pop()
        tag = tags[number]
        if raw[tag.inside - 2 : tag.inside] != b"/>":
            end = parser.CurrentByteIndex
            tags[number] = tag._replace(end=end, behind=raw.find(b">", end) + 1)

    parser.StartElementHandler = begin
    parser.EndElementHandler = finish
    parser.CharacterDataHandler = builder.data
    try:
        # without declarations there are no entities to grow
        parser.Parse(raw, True)
    except (expat.ExpatError, ValueError) as error:
        raise ValueError(f"this is no XML ({error})") from error
    return tags


def _without_dashes(match: re.Match[str]) -> str:
    """Return a comment of the same length in which no two dashes follow each other."""
    return f"<!--{match[1].replace('-', '.')}-->"


def xml_tree(text: str) -> ElementTree.Element:
    """Return the tree of an XML text; a ValueError as that of `xml_tags`."""
    return xml_tags(text)[0].element


def _inline_includes(text: str, folder: Path, depth: int = 0) -> str:
    """Return an MJCF with the content of the files that it includes in place of each `<include>`.

    Raises:
        ValueError: one lies outside of `folder` or is no XML, or they include each other.
    """
    if depth > _DEEPEST:
        raise ValueError("its files include each other without end")
    raw = text.encode()
    for tag in reversed(xml_tags(text)):
        if tag.element.tag != "include":
            continue
        path = _find_file(tag.element.get("file", ""), folder, {""})
        if path is None:
            raise ValueError(f"there is no file '{tag.element.get('file', '')}' {_ELSEWHERE}")
        included = read_file(path, MOST_BYTES)
        if len(included) + len(raw) > MOST_BYTES:
            raise ValueError(f"with the files that it includes it has more than {MOST_BYTES} bytes")
        part = _inline_includes(included.decode("utf-8", "replace"), folder, depth + 1)
        root = xml_tags(part)[0]
        content = part.encode()[root.inside : root.end]
        raw = raw[: tag.start] + content + raw[tag.behind :]
    return raw.decode()


def _own_files(text: str, folder: Path) -> dict[str, bytes]:
    """Return the files that an MJCF names and that are there, by these names.

    Raises:
        ValueError: they are too many or too large.
    """
    files = dict[str, bytes]()
    root = xml_tree(text)
    places = {""}
    for compiler in root.iter("compiler"):
        places |= {compiler.get(key, "") for key in ("meshdir", "texturedir", "assetdir")}
    for part in root.iter():
        for name in [v for k, v in part.attrib.items() if k.startswith("file") and v]:
            path = _find_file(name, folder, places)
            if path is None or name in files:
                continue
            size = path.stat().st_size + sum(map(len, files.values()))
            if size > _MOST_SIZE or len(files) >= _MOST_FILES:
                raise ValueError(
                    f"it brings more than {_MOST_FILES} files or {_MOST_SIZE >> 20} MiB"
                )
            files[name] = read_file(path, _MOST_SIZE)
    return files


def _find_file(name: str, folder: Path, places: Iterable[str]) -> Path | None:
    """Return the path of a file that lies in one of the places below `folder`; None without."""
    for place in places:
        path = (folder / place / name).resolve()
        if name and path.is_relative_to(folder) and path.is_file():
            return path
    return None


def complete_spec(spec: mujoco.MjSpec, files: Mapping[str, bytes]) -> set[str]:
    """Take out of an MJCF whatever would keep a robot from being compiled, and tells nothing of it.

    Returns the names of files of meshes that are not there.

    These are shapes whose file is not there, looks, keyframes, and inertia that no body has, which
    becomes its mean. A floor that only contact pairs know of is added, and parts get names.
    """
    name_parts(spec)
    mend_inertia(spec)
    for key in list(spec.keys):
        spec.delete(key)
    away = [mesh for mesh in spec.meshes if mesh.file and mesh.file not in files]
    lost = {mesh.name for mesh in away}
    missing = {mesh.file for mesh in away}
    for geom in list(spec.geoms):
        geom.material = ""
        if geom.meshname in lost:
            spec.delete(geom)
    for mesh in away:
        spec.delete(mesh)
    for look in (*spec.skins, *spec.materials, *spec.textures):
        spec.delete(look)
    for part in (*spec.sites, *spec.tendons):
        part.material = ""
    _add_floors(spec)
    return missing


def mend_inertia(spec: mujoco.MjSpec) -> None:
    """Let inertia that no body has be its mean about every axis."""
    spec.compiler.balanceinertia = True
    for body in spec.bodies:
        tensor = inertia_tensor(body)
        if body.explicitinertial and np.linalg.eigvalsh(tensor)[0] < 0.0:
            body.fullinertia = np.full(6, np.nan)
            body.inertia = np.full(3, np.abs(np.diag(tensor)).mean())


def inertia_tensor(body: Any) -> FloatArray:
    """Return the (3, 3) inertia that a file says of a body [kg m2]."""
    xx, yy, zz, xy, xz, yz = np.asarray(body.fullinertia).tolist()
    if np.isnan(xx):
        return np.diag(np.asarray(body.inertia, dtype=np.float64))
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def name_parts(spec: mujoco.MjSpec) -> None:
    """Give a name to each body, joint, shape and actuator that has none: its kind and number."""
    for kind in ("bodies", "joints", "geoms", "actuators"):
        word = "body" if kind == "bodies" else kind.removesuffix("s")
        for number, part in enumerate(getattr(spec, kind)):
            part.name = part.name or f"{word} {number}"


def _add_floors(spec: mujoco.MjSpec) -> None:
    """Add the floors that contact pairs name, of a scene that includes the robot's file."""
    shapes = {geom.name for geom in spec.geoms}
    for pair in spec.pairs:
        for name in {pair.geomname1, pair.geomname2} - shapes:
            shapes.add(name)
            plane = mujoco.mjtGeom.mjGEOM_PLANE
            spec.worldbody.add_geom(name=name, type=plane, size=[0, 0, 1])


def try_compiling(
    text: str, folder: Path | None = None, tolerant: bool = False
) -> tuple[str, Mapping[str, bytes]]:
    """Return an MJCF or a URDF and its files by name, once a child process has compiled it.

    An MJCF comes back with all that it includes in one text.

    Args:
        text: the MJCF or URDF.
        folder: folder of its files; None for a text that may have none.
        tolerant: leave out what `complete_spec` leaves out.

    Raises:
        ValueError: MuJoCo cannot, or not within `ALLOWANCE`, or a file is not to be had.
    """
    place = None if folder is None else str(folder.resolve())
    answer = guarded.ask(_compile_foreign, [text, place, tolerant], ALLOWANCE)
    (whole, names), parts = answer
    return whole, dict(zip(names, parts, strict=True))


def _compile_foreign(text: str, folder: str | None, tolerant: bool) -> guarded.Answer:
    """Compile a text with the files of a folder and no others; return it, their names and bytes."""
    files = {}
    if folder is not None:
        text = _inline_includes(text, Path(folder))
        files = _own_files(text, Path(folder))
    if os.name == "posix":
        import resource

        resource.setrlimit(resource.RLIMIT_NOFILE, (0, 0))
    warnings = list[str]()
    mujoco.set_mju_user_warning(warnings.append)
    spec = mujoco.MjSpec.from_string(text, include=files, assets=files)
    lost = complete_spec(spec, files) if tolerant else set()
    try:
        spec.compile()
    except ValueError as error:
        if lost:
            raise ValueError(f"{error}; it lacks the files {', '.join(sorted(lost))}") from error
        raise
    if any("NaN" in warning for warning in warnings):
        raise ValueError("it contains a NaN, but every number must be finite")
    return [text, list(files)], list(files.values())
