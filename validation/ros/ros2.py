"""A port on a ROS 2 graph: DDS by cyclonedds, the extra `ros2`, without any installation of ROS.

What ROS 2 adds to DDS is kept here: names (`ros2_types`), and quality of service as its profiles have it. Writers are
reliable and keep the last ten messages, so that everybody can listen. Readers of sensors ask for best effort, so that they
hear everybody; readers of commands ask for reliable writers, as a robot's own multiplexer does.
"""

from __future__ import annotations

import importlib
import os
import struct
import threading
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, NamedTuple

from validation.ros import ros2_types as types
from validation.ros.graph import Graph
from validation.ros.port import BREATH, NoGraphError, Port

_KEPT = 10
"""Messages that a writer keeps for slow readers: ROS 2's default."""
_SENSORS = ("nav_msgs/Odometry", "geometry_msgs/PoseStamped", "sensor_msgs/Imu", "sensor_msgs/JointState")
"""Types that are listened to with best effort."""
_ALSO_AS = {"geometry_msgs/Twist": "geometry_msgs/TwistStamped"}
"""Types that come and go in two forms: robots of Humble take Twist, and those of Jazzy TwistStamped, under one name."""
_NAMES_TOPIC = "ros_discovery_info"
"""Topic of the nodes' names (rmw_dds_common)."""
_BATCH = 100
"""Messages that are taken at once from a topic of which all are wanted."""
_LOOK = 0.2
"""Time after which the receiving thread looks whether it is to end [s]."""
_UNREADABLE = (struct.error, ValueError, TypeError, IndexError, OverflowError, MemoryError)
"""What decoding raises of bytes that are no message of their type."""
_CONFIGURATION = (
    "<CycloneDDS><Domain Id='any'><General><Interfaces><NetworkInterface {interface}/></Interfaces>{multicast}</General>"
    "<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>{peers}"
    "</Discovery></Domain></CycloneDDS>"
)
_LOOPBACK = _CONFIGURATION.format(
    interface="address='127.0.0.1' multicast='false'",
    multicast="<AllowMulticast>false</AllowMulticast>",
    peers="<Peers><Peer address='127.0.0.1'/></Peers>",
)
"""Loopback alone, where peers are found on the ports of up to 33 participants: containers have no multicast."""


class _Sender(NamedTuple):
    writer: Any
    kind: str
    stamped: bool
    """True if what is sent stands in the field `twist` of a message with a header."""


def configuration(interface: str) -> str:
    """Return Cyclone's configuration for one network interface, by name or address; for loopback alone if that is empty."""
    if not interface:
        return _LOOPBACK
    by = "address" if "." in interface or ":" in interface else "name"
    return _CONFIGURATION.format(interface=f"{by}='{interface}'", multicast="", peers="")


def load_dds() -> SimpleNamespace:
    """Return the modules of cyclonedds by their names.

    Raises:
        NoGraphError: it is not installed.
    """
    try:
        names = ("core", "domain", "internal", "pub", "qos", "sub", "topic", "util")
        return SimpleNamespace(**{name: importlib.import_module(f"cyclonedds.{name}") for name in names})
    except ImportError as error:
        raise NoGraphError(
            f"ROS 2 needs cyclonedds ({error}): pip install 'ssmr-testbed[ros2]' (in a source tree: '.[ros2]')"
        ) from None


class Ros2Port(Port):
    """Topics of a node of ROS 2."""

    def __init__(self, name: str, graph: Graph) -> None:
        """Join the graph's domain.

        Raises:
            NoGraphError: cyclonedds is missing, or the network interface is not there.
        """
        self._dds = dds = load_dds()
        super().__init__(graph)
        if graph.interface:
            os.environ["CYCLONEDDS_URI"] = configuration(graph.interface)
        where = os.environ.setdefault("CYCLONEDDS_URI", configuration(""))
        policy = dds.qos.Policy
        try:
            qos = dds.qos.Qos(policy.Userdata(b"enclave=/;"), policy.EntityName(name))
            self._node = dds.domain.DomainParticipant(graph.domain, qos=qos)
        except dds.core.DDSException as error:
            asked = f"interface {graph.interface}" if graph.interface else f"CYCLONEDDS_URI {where}"
            raise NoGraphError(f"no ROS 2 graph in domain {graph.domain} by {asked}: {error.msg}") from None
        self._name = name
        self._names: Any = None
        """Writer that tells ROS 2's tools the node's name; where ROS_DISTRO does not say in which of its two forms, there is
        none, because nodes of Humble can die of the other one."""
        if os.environ.get("ROS_DISTRO"):
            topic = dds.topic.Topic(self._node, _NAMES_TOPIC, types.idl_class(types.NODES))
            quality = self._qos(types.NODES, 1, reliable=True, latch=True)
            self._names = dds.pub.DataWriter(self._node, topic, qos=quality)
        self._senders: dict[str, list[_Sender]] = {}
        self._readers: list[tuple[Any, str, int | None, Callable[[Any], Any]]] = []
        self._news = dds.core.WaitSet(self._node)
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._receive, daemon=True)
        """Receives; it begins with the first reader, because a wait for nothing ends at once."""

    def _qos(self, kind: str, depth: int | None, *, reliable: bool, latch: bool) -> Any:
        policy = self._dds.qos.Policy
        patience = self._dds.util.duration(milliseconds=1)
        return self._dds.qos.Qos(
            policy.Reliability.Reliable(patience) if reliable else policy.Reliability.BestEffort,
            policy.Durability.TransientLocal if latch else policy.Durability.Volatile,
            policy.History.KeepAll if depth is None else policy.History.KeepLast(depth),
            policy.Userdata(types.user_data(kind)),
            policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
            policy.WriterDataLifecycle(autodispose=False),
        )

    def _topic(self, topic: str, kind: str) -> Any:
        return self._dds.topic.Topic(self._node, types.wire_name(topic), types.idl_class(kind))

    def advertise(self, topic: str, kind: str, *, latch: bool = False) -> None:
        """Open a topic for sending; one of Twist is open for TwistStamped too."""
        self._senders[topic] = []
        for form in filter(None, (kind, _ALSO_AS.get(kind))):
            qos = self._qos(form, 1 if latch else _KEPT, reliable=True, latch=latch)
            writer = self._dds.pub.DataWriter(self._node, self._topic(topic, form), qos=qos)
            self._senders[topic].append(_Sender(writer, form, form != kind))
        self._tell_name()

    def _tell_name(self) -> None:
        """Tell ROS 2's tools the node's name, and what readers and writers it has."""
        if self._names is not None:
            readers = [reader.guid.bytes for reader, *_ in self._readers]
            writers = [sender.writer.guid.bytes for senders in self._senders.values() for sender in senders]
            own = self._name, self.graph.namespace, self._node.guid.bytes
            self._names.write(types.described_node(*own, readers, writers))

    def make(self, kind: str) -> Any:
        """Return an empty message."""
        return types.empty(kind)

    def send(self, topic: str, fill: Callable[[Any], None]) -> None:
        """Send a message that `fill` has filled; in two forms, each only to those who listen to it.

        A TwistStamped has the stamp 0, which robots take as the time of its arrival.
        """
        senders = self._senders[topic]
        for sender in senders:
            if len(senders) > 1 and not sender.writer.get_matched_subscriptions():
                continue
            message = types.empty(sender.kind)
            fill(message.twist if sender.stamped else message)
            try:
                sender.writer.write(message)
            except self._dds.core.DDSException as error:
                self.notices.add(f"send {topic}", f"{topic}: a message could not be sent: {error.msg}")

    def listeners(self, topic: str) -> int:
        """Return the number of listeners of a topic that is open for sending."""
        return sum(len(sender.writer.get_matched_subscriptions()) for sender in self._senders[topic])

    def listen(self, topic: str, kind: str, read: Callable[[Any], Any] = lambda m: m, depth: int | None = None) -> None:
        """Let the messages of a topic come into the inbox; on one of Twist, TwistStamped is heard too."""
        forms = list(filter(None, (kind, _ALSO_AS.get(kind))))
        self.inbox.open(topic, read, depth and depth * len(forms))  # who speaks in both forms replaces nothing
        for form in forms:
            latch = topic.endswith(("/tf_static", "/robot_description"))
            qos = self._qos(form, depth, reliable=form not in _SENSORS, latch=latch)
            reader = self._dds.sub.DataReader(self._node, self._topic(topic, form), qos=qos)
            status = self._dds.core
            states = status.ViewState.Any | status.InstanceState.Any | status.SampleState.Any
            self._news.attach(status.ReadCondition(reader, states))
            stamped = form != kind
            self._readers.append((reader, topic, depth, (lambda m: m.twist) if stamped else (lambda m: m)))
        self._tell_name()
        if not self._thread.is_alive():
            self._thread.start()

    def _receive(self) -> None:
        """Take messages as they come, and rest after each, so that a flood is thrown away before it is decoded."""
        patience = self._dds.util.duration(milliseconds=round(1e3 * _LOOK))
        while not self._closed.is_set():
            try:
                self._news.wait(patience)
            except self._dds.core.DDSException:
                if not self._closed.is_set():
                    raise
                return
            rest = False
            for reader, topic, depth, part in tuple(self._readers):
                rest |= self._take(reader, topic, depth, part) and depth is not None
            if rest:
                time.sleep(BREATH)

    def _take(self, reader: Any, topic: str, depth: int | None, part: Callable[[Any], Any]) -> bool:
        """Take what a reader has, one message where only the last ones are kept; return whether there was any."""
        try:
            came = reader.take(N=_BATCH if depth is None else 1)
        except _UNREADABLE as error:
            self.notices.add(f"unreadable {topic}", f"{topic}: a message that cannot be decoded ({error}); ignored")
            return True
        for sample in came:
            if sample.sample_info.instance_state == self._dds.core.InstanceState.NotAliveNoWriters:
                self.notices.add(f"left {topic}", f"{topic}: nobody sends any more")
            if not isinstance(sample, self._dds.internal.InvalidSample):  # the last message, or the end alone
                self.inbox.put(topic, part(sample))
        return bool(came)

    def close(self) -> None:
        """Leave the domain; what was sent last is still delivered."""
        self._closed.set()
        if self._thread.is_alive():
            self._thread.join()
        self._senders.clear()  # cyclonedds deletes what nobody refers to
        self._readers.clear()
        del self._news, self._names, self._node
