"""A node on a ROS 2 graph: DDS by cyclonedds, the extra `ros2`, without any installation of ROS.

What ROS 2 adds to DDS is kept here. A type is a name, a layout of bytes (CDR, version 1) and, since
Iron, a hash of its definition in the user data of each reader and writer (`RIHS01_…`, REP 2011);
the definitions are those of Jazzy that rosbags ships. Writers are reliable and keep the last ten
messages, so that everybody can listen. Readers of sensors ask for best effort, so that they hear
everybody; readers of commands ask for reliable writers, as a robot's own multiplexer does; an
emergency stop is read in both ways.
"""

from __future__ import annotations

import importlib
import logging
import math
import os
import re
import struct
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from itertools import product
from types import SimpleNamespace
from typing import Any, Literal

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from validation import cli
from validation.output import shorten_text
from validation.ros.messages import Fields

_logger = logging.getLogger(__name__)

_MOST_DOMAIN = 232
"""Greatest domain whose ports exist (DDSI-RTPS, 9.6.2: 7400 + 250 each)."""
_NAME = re.compile(r"(/?[A-Za-z][A-Za-z0-9_]*)*", re.ASCII)
_INTERFACE = re.compile(r"[A-Za-z0-9_.:-]*", re.ASCII)
_GLOBAL = ("/clock", "/vrpn_mocap/")
"""Beginnings of topics outside of a robot's namespace: time, and the node of the tracking
system."""
_KEPT = 10
"""Messages that a writer keeps for slow readers: ROS 2's default."""
_RELIABLE = {
    "nav_msgs/msg/Odometry": (False,),
    "nav_msgs/msg/Path": (False,),
    "geometry_msgs/msg/PoseStamped": (False,),
    "sensor_msgs/msg/Imu": (False,),
    "tf2_msgs/msg/TFMessage": (False,),
    "std_msgs/msg/Bool": (False, True),
}
"""Whether a type is listened to with best effort, so that everybody is heard, reliably, or, as an
emergency stop, in both ways; others reliably."""
_SENT_AS = {"geometry_msgs/msg/Twist": ("geometry_msgs/msg/TwistStamped",)}
"""Types that go in two forms: robots of Humble take Twist, and those of Jazzy TwistStamped, under
one name."""
_HEARD_AS = {
    **_SENT_AS,
    "geometry_msgs/msg/PoseStamped": ("geometry_msgs/msg/PoseWithCovarianceStamped",),
}
"""Types that come in two forms."""
_LOG_PERIOD = 1.0
"""Least time between two lines of one kind in the log [s]."""
_LONGEST = 300
"""Most characters of a line in the log: it may hold foreign text."""
_UNREADABLE = (struct.error, ValueError, TypeError, IndexError, OverflowError, MemoryError)
"""Errors that decoding raises of bytes that are no message of their type."""
_FATAL = 1
"""Cyclone's DDS_LC_FATAL: of its messages only those with which it ends."""
_CONFIGURATION = (
    "<CycloneDDS><Domain Id='any'>"
    "<General><Interfaces><NetworkInterface {}/></Interfaces></General>"
    "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>{}"
    "</Discovery></Domain></CycloneDDS>"
)


@dataclass(frozen=True, kw_only=True)
class Graph(cli.Options):
    """A graph of ROS 2: the options of every node."""

    ros: Literal["2"] = "2"
    """Version of ROS; there is 2 alone, with the extra `ros2`."""
    domain: int | None = None
    """Number of the domain; that of ROS_DOMAIN_ID, or 0, if not given."""
    namespace: str = ""
    """Namespace of the robot, such as a200_0000."""
    interface: str = ""
    """Network interface, by name or address; loopback, or what CYCLONEDDS_URI says, if not
    given."""

    def domain_number(self) -> int:
        """Return the domain's number.

        Raises:
            ValueError: domain, namespace or interface cannot be.
        """
        number = os.environ.get("ROS_DOMAIN_ID") or "0"
        if self.domain is not None:
            number = str(self.domain)
        if not number.isdecimal() or not number.isascii() or int(number[:9]) > _MOST_DOMAIN:
            raise ValueError(
                f"the domain (--domain, ROS_DOMAIN_ID) is {shorten_text(number, 20)}, "
                f"must be 0 to {_MOST_DOMAIN}"
            )
        if not _NAME.fullmatch(self.namespace):
            raise ValueError(
                "a namespace has letters, digits and underscores, a letter first, "
                "and '/' between its parts"
            )
        if not _INTERFACE.fullmatch(self.interface):
            raise ValueError("an interface is a name such as eth0, or an address")
        return int(number)

    def topic(self, name: str) -> str:
        """Return a topic's name here: in the robot's namespace, unless it belongs to all robots."""
        namespace = self.namespace.strip("/")
        if not namespace or name.startswith(_GLOBAL):
            return name
        return f"/{namespace}{name}"


def cyclone_configuration(interface: str) -> str:
    """Return Cyclone's configuration for a network interface, by name or address; empty: loopback.

    On loopback, peers are found on the ports of up to 33 participants: containers have no
    multicast.
    """
    if interface:
        by = "address" if "." in interface or ":" in interface else "name"
        return _CONFIGURATION.format(f"{by}='{interface}'", "")
    peers = "<Peers><Peer address='127.0.0.1'/></Peers>"
    return _CONFIGURATION.format("address='127.0.0.1' multicast='false'", peers)


def _load_dds() -> SimpleNamespace:
    """Return the modules of cyclonedds by their names; a ValueError says how to install it."""
    names = ("core", "domain", "internal", "pub", "qos", "sub", "topic", "util")
    try:
        modules = {name: importlib.import_module(f"cyclonedds.{name}") for name in names}
        return SimpleNamespace(**modules)
    except ImportError as error:
        raise ValueError(
            f"ROS 2 needs cyclonedds ({error}): "
            "pip install 'ssmr-testbed[ros2]' (in a source tree: '.[ros2]')"
        ) from None


@cache
def _message_definitions() -> Typestore:
    """Return the definitions of ROS 2's messages by `package/msg/Type`."""
    return get_typestore(Stores.ROS2_JAZZY)


def _user_data(kind: str) -> bytes:
    """User data of a reader or writer of a type `package/msg/Type`: its definition's hash."""
    return f"typehash={_message_definitions().hash_rihs01(kind)};".encode()


@cache
def _idl_class(kind: str) -> type[Any]:
    """Return cyclonedds' class of a type; its name on the wire is `package::msg::dds_::Type_`."""
    package, _, name = kind.split("/")
    declared = _message_definitions().fielddefs[kind][1]
    fields = {field: _idl_type(node, what) for field, (node, what) in declared}
    idl: Any = importlib.import_module("cyclonedds.idl")
    struct: type[Any] = idl.make_idl_struct(name, f"{package}::msg::dds_::{name}_", fields)
    return struct


def _idl_type(node: Any, what: Any) -> Any:
    types = importlib.import_module("cyclonedds.idl.types")
    if node is Nodetype.NAME:
        return _idl_class(what)
    if node is Nodetype.BASE:
        return {"string": str, "bool": bool}.get(what[0]) or getattr(types, what[0])
    element = _idl_type(*what[0])
    count = what[1]
    if node is Nodetype.ARRAY:
        return types.array[element, count]
    return types.sequence[element]


def _idl_message(kind: str, values: Mapping[str, Any]) -> Any:
    """A message of a type with values by its fields; a field that is left out is zero or empty."""
    fields = _message_definitions().fielddefs[kind][1]
    numbers = [_field_value(node, what, values.get(name)) for name, (node, what) in fields]
    return _idl_class(kind)(*numbers)


def _field_value(node: Any, what: Any, value: Any) -> Any:
    if node is Nodetype.NAME:
        return _idl_message(what, value or {})
    if node is Nodetype.BASE:
        if value is None:
            return {"string": "", "bool": False}.get(what[0], 0)
        return value
    (element, of_what), count = what
    if value is None:
        value = [None] * (count if node is Nodetype.ARRAY else 0)
    return [_field_value(element, of_what, v) for v in value]


@dataclass
class _Subscription:
    read: Callable[[Any], Any]
    depth: int
    readers: list[Any] = field(default_factory=list)
    refused: int = 0
    """Messages refused since the last good one."""
    why: str = ""


class Node:
    """A node's topics, whose messages come on request; types are named `package/msg/Type`."""

    def __init__(self, name: str, graph: Graph) -> None:
        """Join the graph's domain; a ValueError says that it cannot be, or what is missing."""
        domain = graph.domain_number()
        self._dds = dds = _load_dds()
        self.graph = graph
        self.clock = time.monotonic
        self.sleep = time.sleep
        self._subscriptions: dict[str, _Subscription] = {}
        self._logged_at: dict[str, float] = {}
        if graph.interface:
            os.environ["CYCLONEDDS_URI"] = cyclone_configuration(graph.interface)
        os.environ.setdefault("CYCLONEDDS_URI", cyclone_configuration(""))
        policy = dds.qos.Policy
        try:
            qos = dds.qos.Qos(policy.Userdata(b"enclave=/;"), policy.EntityName(name))
            self._participant = dds.domain.DomainParticipant(domain, qos=qos)
        except dds.core.DDSException as error:
            where = f"CYCLONEDDS_URI {os.environ['CYCLONEDDS_URI']}"
            if graph.interface:
                where = f"interface {graph.interface}"
            raise ValueError(f"no ROS 2 graph in domain {domain} by {where}: {error.msg}") from None
        # From here on whoever reaches the port could fill a log with warnings of malformed packets.
        dds.internal.load_cyclonedds().dds_set_log_mask(_FATAL)
        self._waitset = dds.core.WaitSet(self._participant)
        self._writers: dict[str, list[tuple[Any, str]]] = {}

    def say(self, kind: str, text: str, level: int = logging.WARNING) -> None:
        """Log a line, at most once a second for each kind; kinds never come from a message."""
        now = self.clock()
        if now - self._logged_at.get(kind, -math.inf) >= _LOG_PERIOD:
            self._logged_at[kind] = now
            _logger.log(level, "%s", shorten_text(text, _LONGEST))

    def _qos(self, kind: str, depth: int, *, reliable: bool, latch: bool = False) -> Any:
        policy = self._dds.qos.Policy
        reliability = policy.Reliability.BestEffort
        if reliable:
            reliability = policy.Reliability.Reliable(self._dds.util.duration(milliseconds=1))
        return self._dds.qos.Qos(
            reliability,
            policy.Durability.TransientLocal if latch else policy.Durability.Volatile,
            policy.History.KeepLast(depth),
            policy.Userdata(_user_data(kind)),
            policy.DataRepresentation(
                use_cdrv0_representation=True, use_xcdrv2_representation=False
            ),
            policy.WriterDataLifecycle(autodispose=False),
        )

    def _topics(self, topic: str, *forms: str) -> list[tuple[str, Any]]:
        new = partial(self._dds.topic.Topic, self._participant, f"rt{topic}")
        return [(form, new(_idl_class(form))) for form in forms]

    def advertise(self, topic: str, kind: str, *, latch: bool = False) -> None:
        """Open a topic for sending, one of Twist for TwistStamped too.

        With `latch`, late joiners get the last message.
        """
        self._writers[topic] = []
        for form, place in self._topics(topic, kind, *_SENT_AS.get(kind, ())):
            qos = self._qos(form, 1 if latch else _KEPT, reliable=True, latch=latch)
            writer = self._dds.pub.DataWriter(self._participant, place, qos=qos)
            self._writers[topic].append((writer, form))

    def publish(self, topic: str, values: Fields) -> None:
        """Send a message without waiting; in two forms, each only to those who listen to it.

        A TwistStamped has the stamp 0, which robots take as the time of its arrival.
        """
        forms = self._writers[topic]
        for k, (writer, form) in enumerate(forms):
            if len(forms) == 1 or writer.get_matched_subscriptions():
                try:
                    writer.write(_idl_message(form, {"twist": values} if k else values))
                except self._dds.core.DDSException as error:
                    self.say(f"send {topic}", f"{topic}: a message could not be sent: {error.msg}")

    def subscribers(self, topic: str) -> int:
        """Return the number of subscribers of a topic that is open for sending."""
        return sum(len(writer.get_matched_subscriptions()) for writer, _ in self._writers[topic])

    def subscribe(
        self,
        topic: str,
        kind: str,
        read: Callable[[Any], Any],
        depth: int = 1,
        *,
        latch: bool = False,
    ) -> None:
        """Receive the last `depth` messages of a topic.

        TwistStamped is heard as Twist is, and PoseWithCovarianceStamped as PoseStamped. `read`
        returns what the node needs of a message, and raises a ValueError if that cannot be. With
        `latch`, what was sent before and kept for late joiners comes too.
        """
        subscription = _Subscription(read, depth)
        core = self._dds.core
        self._subscriptions[topic] = subscription
        states = core.ViewState.Any | core.InstanceState.Any | core.SampleState.Any
        places = self._topics(topic, kind, *_HEARD_AS.get(kind, ()))
        # a reader that asks for what a writer does not offer hears nothing, without a word
        wishes = [(reliable, False) for reliable in _RELIABLE.get(kind, (True,))]
        for (form, place), (reliable, kept) in product(places, wishes + [(True, True)] * latch):
            qos = self._qos(form, depth, reliable=reliable, latch=kept)
            reader = self._dds.sub.DataReader(self._participant, place, qos=qos)
            self._waitset.attach(core.ReadCondition(reader, states))
            subscription.readers.append(reader)

    def receive(self, timeout: float = 0.0) -> list[tuple[str, Any]]:
        """Messages that came, topic and value; if none did, wait for at most `timeout` [s].

        A message that cannot be is logged, and changes nothing.
        """
        messages = []
        for topic, message in self._take(timeout):
            subscription = self._subscriptions[topic]
            try:
                messages.append((topic, subscription.read(message)))
                subscription.refused = 0
            except ValueError as error:
                subscription.refused = subscription.refused + 1
                subscription.why = str(error)
                self.say(topic, f"{topic}: {error}; ignored")
        return messages

    def refusals(self, topic: str) -> str:
        """How many messages of a topic were refused since its last good one, and why, or empty."""
        s = self._subscriptions[topic]
        if s.refused:
            return f"{s.refused} messages on {topic} were refused, the last one because {s.why}"
        return ""

    def _take(self, timeout: float) -> list[tuple[str, Any]]:
        if not self._waitset.wait(self._dds.util.duration(seconds=timeout)):
            return []
        messages = []
        for topic, subscription in self._subscriptions.items():
            for reader in subscription.readers:
                for message in self._samples(topic, reader, subscription.depth):
                    messages.append((topic, message))
        return messages

    def _samples(self, topic: str, reader: Any, depth: int) -> list[Any]:
        samples = []
        for _ in range(depth):  # one by one: of a batch, one that cannot be decoded would lose all
            try:
                batch = reader.take()
            except _UNREADABLE as error:
                text = f"{topic}: a message that cannot be decoded ({error}); ignored"
                self.say(f"unreadable {topic}", text)
                continue
            if not batch:
                break
            (sample,) = batch
            if sample.sample_info.instance_state == self._dds.core.InstanceState.NotAliveNoWriters:
                self.say(f"left {topic}", f"{topic}: nobody sends any more")
            # An invalid sample is the end alone; others come with the last message.
            if not isinstance(sample, self._dds.internal.InvalidSample):
                samples.append(sample)
        return samples

    def close(self) -> None:
        """Leave the domain; the last messages are still delivered."""
        self._writers.clear()  # cyclonedds deletes what nobody refers to
        self._subscriptions.clear()
        del self._waitset, self._participant
