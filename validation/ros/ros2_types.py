"""ROS 2's message types as cyclonedds wants them, made from the definitions that rosbags ships (those of Jazzy).

On the wire a type is a name, a layout of bytes (CDR, version 1) and, since Iron, a hash of its definition in the user data
of each reader and writer (`RIHS01_…`, REP 2011). Peers of DDS match by name; ROS 2's tools look at the hash besides.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Iterable
from functools import cache
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

NODES = "rmw_dds_common/ParticipantEntitiesInfo"
"""Type of the topic by which ROS 2's tools learn the names of nodes."""
_LONG_GIDS = ("foxy", "galactic", "humble")
"""Distributions of ROS 2 whose identifiers of readers and writers have 24 bytes in `NODES`; others have 16."""
_SAME = {"string": str, "bool": bool}
"""Types of IDL that are Python's own; cyclonedds names all others as ROS does."""


@cache
def definitions() -> Typestore:
    """Return the definitions of ROS 2's messages, by `package/msg/Type`; ROS_DISTRO decides where distributions differ."""
    store = get_typestore(Stores.ROS2_JAZZY)
    size = 24 if os.environ.get("ROS_DISTRO") in _LONG_GIDS else 16
    gid: Any = Nodetype.ARRAY, ((Nodetype.BASE, ("uint8", 0)), size)  # rosbags has `char` there, which in ROS 2 means this
    store.fielddefs["rmw_dds_common/msg/Gid"] = [], [("data", gid)]
    return store


def wire_name(topic: str) -> str:
    """Return the name that DDS knows a topic of ROS 2 by."""
    return f"rt{topic}"


def wire_type(kind: str) -> str:
    """Return the name that DDS knows a type by: that of `package/Type` is `package::msg::dds_::Type_`."""
    package, _, name = kind.partition("/")
    return f"{package}::msg::dds_::{name}_"


def user_data(kind: str) -> bytes:
    """Return the user data of a reader or writer of `package/Type`: the type's hash."""
    return f"typehash={definitions().hash_rihs01(_full(kind))};".encode()


def _full(kind: str) -> str:
    package, _, name = kind.partition("/")
    return f"{package}/msg/{name}"


@cache
def idl_class(kind: str) -> type[Any]:
    """Return the class of `package/Type`, whose fields are those of the message; cyclonedds must be installed."""
    idl = importlib.import_module("cyclonedds.idl")
    fields = {name: _field(*description)[0] for name, description in definitions().fielddefs[_full(kind)][1]}
    made: type[Any] = idl.make_idl_struct(kind.partition("/")[2], wire_type(kind), fields)
    return made


def empty(kind: str) -> Any:
    """Return an empty message of `package/Type`: zeros, empty texts and sequences, quaternions without rotation."""
    return idl_class(kind)(*[new() for new in _blanks(kind)])


def described_node(name: str, namespace: str, guid: bytes, readers: Iterable[bytes], writers: Iterable[bytes]) -> Any:
    """Return a message of the type `NODES`: one node, with the (16,) bytes that DDS knows it and all that it has by."""

    def gid(known: bytes) -> Any:
        made = empty("rmw_dds_common/Gid")
        made.data = known.ljust(len(made.data), b"\0")
        return made

    message, node = empty(NODES), empty("rmw_dds_common/NodeEntitiesInfo")
    node.node_name, node.node_namespace = name, f"/{namespace.strip('/')}"
    node.reader_gid_seq, node.writer_gid_seq = list(map(gid, readers)), list(map(gid, writers))
    message.gid, message.node_entities_info_seq = gid(guid), [node]
    return message


@cache
def _blanks(kind: str) -> tuple[Callable[[], Any], ...]:
    if kind == "geometry_msgs/Quaternion":
        return tuple(lambda value=value: value for value in (0.0, 0.0, 0.0, 1.0))
    return tuple(_field(*description)[1] for _, description in definitions().fielddefs[_full(kind)][1])


def _field(node: Any, what: Any) -> tuple[Any, Callable[[], Any]]:
    """Return a field's type for cyclonedds, and a function that makes its empty value."""
    types = importlib.import_module("cyclonedds.idl.types")
    if node.name == "NAME":
        package, _, name = what.split("/")
        return idl_class(f"{package}/{name}"), lambda: empty(f"{package}/{name}")
    if node.name == "BASE":
        if what[0] == "string" and what[1]:
            return types.bounded_str[what[1]], str
        zero = _SAME.get(what[0]) or (float if what[0].startswith("float") else int)
        return _SAME.get(what[0]) or getattr(types, what[0]), zero
    (kind, blank), count = _field(*what[0]), what[1]
    if node.name == "ARRAY":
        return types.array[kind, count], lambda: [blank() for _ in range(count)]
    return types.sequence[kind], list
