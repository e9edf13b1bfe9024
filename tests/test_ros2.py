"""The nodes on a ROS 2 graph: names, types and bytes, then DDS on loopback, as the extra `ros2` brings it.

Nothing here waits for a certain time: what must come is polled for, with a deadline that only a broken program meets.
"""

from __future__ import annotations

import contextlib
import ctypes.util
import json
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from validation import cli
from validation.robots import import_robot
from validation.robots.urdf import read_urdf
from validation.ros import messages as msg
from validation.ros import ros2_types
from validation.ros.__main__ import PROGRAM
from validation.ros.commands import LOCK_TOPIC
from validation.ros.graph import Graph
from validation.ros.inbox import Received
from validation.ros.port import NoGraphError, Port
from validation.ros.ros2 import configuration, load_dds
from validation.ros.run import open_port
from validation.ros.sim import MESSAGE_TYPES, POSE_TOPIC
from validation.simulator.description import WHEELS, load_robot, shipped_robots
from validation.simulator.urdf_writing import urdf_text

ROOT = Path(__file__).resolve().parents[1]
PATIENCE = 90.0
"""Longest time for which anything is waited for [s]: a node starts in 3 s, and on a busy machine in twenty."""
KINDS = (
    *dict.fromkeys(MESSAGE_TYPES.values()), "std_msgs/String", "std_msgs/Bool", "geometry_msgs/Twist",
    "geometry_msgs/TwistStamped", "geometry_msgs/PoseWithCovarianceStamped", "geometry_msgs/TransformStamped",
)  # fmt: skip


@pytest.fixture
def dds() -> None:
    """Skip where DDS is missing."""
    pytest.importorskip("cyclonedds", reason="ROS 2 needs the extra `ros2`")


@pytest.fixture
def graph(dds: None, monkeypatch: pytest.MonkeyPatch) -> Iterator[Graph]:
    """A domain on loopback in which nobody is, and which no other test takes as long as a port of it is bound here."""
    monkeypatch.setenv("CYCLONEDDS_URI", configuration(""))
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    for domain in range(1, 101):  # the ports of greater ones are those that the system hands out
        port = 7400 + 250 * domain  # DDSI-RTPS 9.6.2: + 10 for the first participant, + 248 for the 120th, which none is
        with contextlib.suppress(OSError), contextlib.ExitStack() as bound:
            for offset in (248, 10):
                taken = bound.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
                taken.bind(("", port + offset))
            taken.close()
            yield Graph(domain)
            return
    pytest.fail("no domain is free")


@contextlib.contextmanager
def joined(graph: Graph, name: str = "tester") -> Iterator[Port]:
    port = open_port(name, graph)
    try:
        yield port
    finally:
        port.close()


def wait_for(true: Callable[[], Any], what: str) -> Any:
    """Return what `true` says once it says something."""
    until = time.monotonic() + PATIENCE
    while not (found := true()):
        assert time.monotonic() < until, f"{what}: waited {PATIENCE:g} s in vain"
        time.sleep(0.02)
    return found


# --- names, types and bytes: no DDS ---


def test_topics_have_clearpaths_names() -> None:
    graph = Graph()
    names = {topic: graph.topic(topic, "husky") for topic in (*MESSAGE_TYPES, "/cmd_vel", LOCK_TOPIC, "/tf_static")}
    assert all(name == topic for topic, name in names.items())
    named = Graph(namespace="a200_0000")
    assert named.topic("/cmd_vel", "husky") == "/a200_0000/cmd_vel"
    assert named.topic("/clock", "husky") == "/clock"
    assert named.topic(POSE_TOPIC, "jackal") == "/vrpn_mocap/jackal/pose"
    assert [(s.topic, s.priority) for s in named.sources][-1] == ("/a200_0000/cmd_vel", 1)
    assert Graph(namespace="/fleet/a200_0000").topic("/tf", "husky") == "/fleet/a200_0000/tf"


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        ({"domain": 233}, "0 to 232"),
        ({"domain": -1}, "0 to 232"),
        ({"namespace": "a b"}, "namespace has letters"),
        ({"interface": "lo'/><x"}, "interface is a name"),
    ],
)
def test_graphs_that_cannot_be(wrong: dict[str, Any], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        Graph(**wrong)


def test_names_on_the_wire_are_ros_2s() -> None:
    assert ros2_types.wire_name("/a200_0000/cmd_vel") == "rt/a200_0000/cmd_vel"
    assert ros2_types.wire_type("geometry_msgs/Twist") == "geometry_msgs::msg::dds_::Twist_"
    # the hash of Twist in ROS 2's own documentation of `ros2 topic info --verbose`
    known = b"typehash=RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a;"
    assert ros2_types.user_data("geometry_msgs/Twist") == known


def filled(message: Any, rng: np.random.Generator) -> Any:
    """Return a message with something in each of its fields."""
    for field in fields(message):
        value = getattr(message, field.name)
        if is_dataclass(value):
            filled(value, rng)
        elif isinstance(value, list) and field.name == "transforms":
            value.append(filled(ros2_types.empty("geometry_msgs/TransformStamped"), rng))
        elif isinstance(value, list):
            names = field.name == "name"
            size = len(value) or 3
            new: list[Any] = [f"joint {k}" for k in range(size)] if names else rng.normal(size=size).tolist()
            setattr(message, field.name, new)
        else:
            new_value: Any = {str: "Ωmega", bool: True, int: int(rng.integers(1, 2**31))}.get(type(value), rng.normal())
            setattr(message, field.name, new_value)
    return message


def theirs(message: Any, kind: str) -> Any:
    """Return a message as rosbags has it."""
    package, name = kind.split("/")
    store = ros2_types.definitions()
    found: dict[str, Any] = {}
    for (key, (node, what)), field in zip(store.fielddefs[f"{package}/msg/{name}"][1], fields(message), strict=True):
        value = getattr(message, field.name)
        if node.name == "NAME":
            value = theirs(value, what.replace("/msg/", "/"))
        elif node.name in ("ARRAY", "SEQUENCE") and what[0][0].name == "NAME":
            value = [theirs(v, what[0][1].replace("/msg/", "/")) for v in value]
        elif node.name in ("ARRAY", "SEQUENCE") and what[0][1][0] != "string":
            value = np.array(value)
        found[key] = value
    return store.types[f"{package}/msg/{name}"](**found)


@pytest.mark.usefixtures("dds")
@pytest.mark.parametrize("kind", KINDS)
def test_the_bytes_are_those_of_rosbags(kind: str) -> None:
    """An implementation of ROS 2's serialisation that knows nothing of DDS."""
    package, name = kind.split("/")
    message = filled(ros2_types.empty(kind), np.random.default_rng(0))
    wanted = bytes(ros2_types.definitions().serialize_cdr(theirs(message, kind), f"{package}/msg/{name}"))
    written = message.serialize(use_version_2=False)
    assert written[4:].rstrip(b"\0") == wanted[4:].rstrip(b"\0"), "but for the padding at the end"
    assert ros2_types.idl_class(kind).deserialize(wanted) == message


@pytest.mark.usefixtures("dds")
def test_what_cannot_be_decoded_raises_what_is_expected() -> None:
    from validation.ros.ros2 import _UNREADABLE

    rng = np.random.default_rng(1)
    for kind in KINDS:
        good = ros2_types.empty(kind).serialize(use_version_2=False)
        for _ in range(60):
            bad = bytearray(good[: rng.integers(4, len(good) + 1)])
            for at in rng.integers(4, max(5, len(bad)), size=3):
                if at < len(bad):
                    bad[at] = int(rng.integers(256))
            with contextlib.suppress(*_UNREADABLE):
                ros2_types.idl_class(kind).deserialize(bytes(bad))
    with pytest.raises(struct.error):
        ros2_types.idl_class("geometry_msgs/Twist").deserialize(b"\0\1\0\0" + bytes(7))


@pytest.mark.usefixtures("dds")
def test_an_empty_quaternion_turns_nothing() -> None:
    assert msg.get_yaw(ros2_types.empty("geometry_msgs/PoseStamped").pose.orientation) == 0.0


def test_without_the_extra_one_line_says_so(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "cyclonedds"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "cyclonedds", None)
    with pytest.raises(NoGraphError, match=r"pip install 'ssmr-testbed\[ros2\]'"):
        load_dds()
    for node in (("sim",), ("control", "pid", "line")):
        with pytest.raises(SystemExit) as ended:
            cli.run(PROGRAM, "ros", node)
        assert ended.value.code == cli.EXIT_USER_ERROR
        said = " ".join(capsys.readouterr().err.split())
        assert said.count("error:") == 1
        assert "ROS 2 needs cyclonedds" in said


@pytest.mark.parametrize("node", [("sim",), ("control", "pid", "line")])
@pytest.mark.parametrize("version", ["1", "noetic", ""])
def test_ros_1_is_said_to_be_gone(node: tuple[str, ...], version: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.run(PROGRAM, "ros", (*node, "--ros", version))
    assert ended.value.code == cli.EXIT_USER_ERROR
    (line,) = capsys.readouterr().err.splitlines()
    assert "nodes of ROS 1 are gone (tag 1.7 keeps them)" in line


def test_the_domain_is_ros_domain_id(monkeypatch: pytest.MonkeyPatch) -> None:
    from validation.ros.__main__ import GraphOptions

    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    assert GraphOptions().graph().domain == 7
    assert GraphOptions(domain=9).graph().domain == 9
    monkeypatch.setenv("ROS_DOMAIN_ID", "seven")
    with pytest.raises(ValueError, match="no whole number"):
        GraphOptions().graph()


# --- ports on a graph ---


def twist(v: float) -> Callable[[Any], None]:
    return lambda message: msg.fill_twist(message, v, 0.1)


def test_messages_come_and_a_late_joiner_gets_what_was_latched(graph: Graph) -> None:
    with joined(graph) as port:
        port.advertise("/tf_static", "tf2_msgs/TFMessage", latch=True)
        placed = port.make("geometry_msgs/TransformStamped")
        msg.fill_transform(placed, 0.0, ("base_link", "imu_link"), (0.1, 0.2, 0.3), 0.5)
        port.send("/tf_static", lambda message: setattr(message, "transforms", [placed]))
        port.advertise("/robot_description", "std_msgs/String", latch=True)
        port.send("/robot_description", lambda message: setattr(message, "data", "<robot/>"))
        port.advertise("/old_news", "std_msgs/String")
        port.send("/old_news", lambda message: setattr(message, "data", "not kept"))
        with joined(graph, "late") as late:
            for topic, kind in (("/tf_static", "tf2_msgs/TFMessage"), ("/robot_description", "std_msgs/String")):
                late.listen(topic, kind, depth=1)
            late.listen("/old_news", "std_msgs/String", depth=1)
            wait_for(lambda: port.listeners("/old_news"), "the late joiner")
            got: dict[str, Any] = {}

            def both() -> bool:
                got.update({r.topic: r.message for r in late.drain()})
                return len(got) == 2

            wait_for(both, "what was latched")
            assert got["/tf_static"].transforms == [placed]
            assert got["/robot_description"].data == "<robot/>"


@pytest.mark.parametrize("reliable", [False, True])
def test_sensors_match_readers_and_writers_of_either_quality(graph: Graph, reliable: bool) -> None:
    """Drivers send what they measure with best effort, and RViz and rosbag2 ask for the one or the other."""
    dds = load_dds()
    policy = dds.qos.Policy.Reliability
    qos = dds.qos.Qos(policy.Reliable(dds.util.duration(seconds=1)) if reliable else policy.BestEffort)
    with joined(graph) as port:
        kind, node = "nav_msgs/Odometry", dds.domain.DomainParticipant(graph.domain)
        heard, said = (dds.topic.Topic(node, f"rt/{name}", ros2_types.idl_class(kind)) for name in ("ours", "theirs"))
        reader, writer = dds.sub.DataReader(node, heard, qos=qos), dds.pub.DataWriter(node, said, qos=qos)
        port.advertise("/ours", kind)
        port.listen("/theirs", kind, msg.read_odometry, 1)

        def both_came() -> bool:
            port.send("/ours", lambda message: None)
            writer.write(ros2_types.empty(kind))
            came.update(read=bool(reader.take()) or came["read"], heard=bool(list(port.drain())) or came["heard"])
            return all(came.values())

        came = {"read": False, "heard": False}
        wait_for(both_came, "odometry to and from")


def test_nodes_tell_their_names_where_the_distribution_is_known(graph: Graph, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever joins, also late, reads names, readers and writers; without a distribution, nothing is sent."""
    dds = load_dds()
    policy, named = dds.qos.Policy, Graph(graph.domain, "a200_0000")
    node = dds.domain.DomainParticipant(graph.domain)
    topic = dds.topic.Topic(node, "ros_discovery_info", ros2_types.idl_class(ros2_types.NODES))
    wanted = dds.qos.Qos(policy.Reliability.Reliable(0), policy.Durability.TransientLocal, policy.History.KeepAll)
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    with joined(named, "nameless"):
        monkeypatch.setenv("ROS_DISTRO", "jazzy")
        with joined(named, "husky_simulation") as port:
            port.advertise("/cmd_vel", "geometry_msgs/Twist")
            port.listen("/words", "std_msgs/String", lambda m: m.data, 1)
            reader = dds.sub.DataReader(node, topic, qos=wanted)
            (seen,) = wait_for(reader.take, "the node's name")
            assert seen.gid.data == port._node.guid.bytes
            (told,) = seen.node_entities_info_seq
            assert (told.node_namespace, told.node_name) == ("/a200_0000", "husky_simulation")
            assert [gid.data for gid in told.reader_gid_seq] == [reader.guid.bytes for reader, *_ in port._readers]
            assert [gid.data for gid in told.writer_gid_seq] == [s.writer.guid.bytes for s in port._senders["/cmd_vel"]]


@pytest.mark.usefixtures("dds")
def test_the_type_of_names_is_that_of_the_distribution(monkeypatch: pytest.MonkeyPatch) -> None:
    """Foxy to Humble have longer identifiers, and their nodes cannot read the others."""
    # the hash that Cyclone's rmw and its bridges have, for Iron and later
    known = b"typehash=RIHS01_91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e;"
    sizes = {}
    for name in ("humble", "jazzy"):
        monkeypatch.setenv("ROS_DISTRO", name)
        store = ros2_types.definitions.__wrapped__()
        sizes[name] = store.fielddefs["rmw_dds_common/msg/Gid"][1][0][1][1][1]
    assert sizes == {"humble": 24, "jazzy": 16}
    message = ros2_types.described_node("husky_simulation", "", bytes(range(16)), [bytes(16)], [])
    read = store.deserialize_cdr(message.serialize(use_version_2=False), "rmw_dds_common/msg/ParticipantEntitiesInfo")
    (node,) = read.node_entities_info_seq
    assert (bytes(read.gid.data), node.node_name, node.node_namespace) == (bytes(range(16)), "husky_simulation", "/")
    assert (len(node.reader_gid_seq), len(node.writer_gid_seq)) == (1, 0)
    assert ros2_types.user_data(ros2_types.NODES) == known


@pytest.mark.parametrize("kind", ["geometry_msgs/Twist", "geometry_msgs/TwistStamped"])
def test_commands_come_as_twist_and_as_twist_stamped(graph: Graph, kind: str) -> None:
    """From robots' drivers of Humble and of Jazzy; a node of this project takes both."""
    dds = load_dds()
    with joined(graph) as port:
        port.listen("/cmd_vel", "geometry_msgs/Twist", msg.read_twist, 1)
        node = dds.domain.DomainParticipant(graph.domain)
        topic = dds.topic.Topic(node, "rt/cmd_vel", ros2_types.idl_class(kind))
        reliable = dds.qos.Qos(dds.qos.Policy.Reliability.Reliable(dds.util.duration(seconds=1)))
        writer = dds.pub.DataWriter(node, topic, qos=reliable)
        message = ros2_types.empty(kind)
        twist(0.4)(getattr(message, "twist", message))

        def came() -> list[Received]:
            writer.write(message)
            return list(port.drain())

        assert wait_for(came, "a command")[0].message == (0.4, 0.1)


@pytest.mark.parametrize("kind", ["geometry_msgs/Twist", "geometry_msgs/TwistStamped"])
def test_a_robot_of_either_kind_is_commanded(graph: Graph, kind: str) -> None:
    dds = load_dds()
    with joined(graph) as port:
        port.advertise("/cmd_vel", "geometry_msgs/Twist")
        assert port.listeners("/cmd_vel") == 0
        node = dds.domain.DomainParticipant(graph.domain)
        topic = dds.topic.Topic(node, "rt/cmd_vel", ros2_types.idl_class(kind))
        reader = dds.sub.DataReader(node, topic, qos=dds.qos.Qos(dds.qos.Policy.Reliability.Reliable(0)))
        wait_for(lambda: port.listeners("/cmd_vel"), "the robot")

        def came() -> list[Any]:
            port.send("/cmd_vel", twist(0.3))
            return list(reader.take())

        (got, *_) = wait_for(came, "a command")
        assert type(got) is ros2_types.idl_class(kind)
        assert msg.read_twist(getattr(got, "twist", got)) == (0.3, 0.1)
        (seen,) = {bytes(reader.get_matched_publication_data(h).qos[dds.qos.Policy.Userdata].data) for h in
                   reader.get_matched_publications()}  # fmt: skip
        assert seen == ros2_types.user_data(kind)


def test_a_writer_that_leaves_is_said_and_nothing_else_comes_of_it(graph: Graph) -> None:
    """Also where it leaves while the receiving thread is busy, so that its end comes together with its last message."""
    entered, go_on = threading.Event(), threading.Event()

    def read(message: Any) -> tuple[float, float]:
        entered.set()
        go_on.wait(PATIENCE)
        return msg.read_twist(message)

    with joined(graph) as port:
        port.listen("/cmd_vel", "geometry_msgs/Twist", read, 1)
        with joined(graph, "driver") as driver:
            driver.advertise("/cmd_vel", "geometry_msgs/Twist")

            def came() -> bool:
                driver.send("/cmd_vel", twist(0.2))
                return entered.is_set()

            wait_for(came, "a command")
            driver.send("/cmd_vel", twist(0.2))
        wait_for(lambda: not any(r.get_matched_publications() for r, *_ in port._readers), "the end of the writer")
        go_on.set()
        wait_for(lambda: "left /cmd_vel" in port.notices._kinds, "what is said of it")
        assert port.inbox.tally.refused.total() == 0
        assert {got.message for got in port.drain()} == {(0.2, 0.1)}


def test_nonsense_is_refused_and_what_is_right_goes_on(graph: Graph) -> None:
    """A number that is none, and a text that is none: neither ends the thread that receives."""
    with joined(graph) as port, joined(graph, "driver") as driver:
        port.listen("/cmd_vel", "geometry_msgs/Twist", msg.read_twist, 1)
        port.listen("/words", "std_msgs/String", lambda m: m.data, 1)
        driver.advertise("/cmd_vel", "geometry_msgs/Twist")
        driver.advertise("/words", "std_msgs/String")

        def no_text(message: Any) -> None:
            message.data = "abc"
            written = message.serialize(use_version_2=False).replace(b"abc", b"\xff\xfe\xfd")
            message.serialize = lambda *_, **__: written

        def refused() -> bool:
            driver.send("/cmd_vel", twist(float("nan")))
            driver.send("/words", no_text)
            return port.inbox.tally.refused["/cmd_vel"] > 0 and "unreadable /words" in port.notices._kinds

        wait_for(refused, "refusals of both")
        assert list(port.drain()) == []

        def came() -> list[Received]:
            driver.send("/cmd_vel", twist(0.1))
            return list(port.drain())

        assert wait_for(came, "a command after that")[0].message == (0.1, 0.1)


def test_what_cannot_be_sent_is_said(graph: Graph) -> None:
    with joined(graph) as port:
        port.advertise("/words", "std_msgs/String")
        port.send("/words", lambda message: setattr(message, "serialize", lambda *_, **__: bytes(3)))
        assert "/words: a message could not be sent" in port.notices._kinds["send /words"].text


def test_an_interface_that_is_not_there_is_one_line(dds: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CYCLONEDDS_URI", "")
    with pytest.raises(NoGraphError, match="no ROS 2 graph in domain 101 by interface nowhere0"):
        open_port("tester", Graph(101, interface="nowhere0"))


# --- the nodes, as processes ---


@contextlib.contextmanager
def node(tmp_path: Path, graph: Graph, *arguments: str) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """A node's process and the file of what it says; killed at the end."""
    log = tmp_path / f"{arguments[0]}.log"
    command = [sys.executable, "-m", "validation.ros", *arguments, "--domain", str(graph.domain)]
    with log.open("wb") as out:
        running = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT, cwd=ROOT, start_new_session=True)
    try:
        yield running, log
    finally:
        running.kill()
        running.wait()


def said(log: Path) -> str:
    return " ".join(log.read_text(encoding="utf-8", errors="replace").split())


def test_a_robot_is_driven_along_a_line_and_ctrl_c_ends_it(tmp_path: Path, graph: Graph) -> None:
    """The controller finds the robot, drives it and arrives. Mission time is that of the stamps, so load does not matter."""
    path = tmp_path / "short.csv"
    path.write_text("x,y\n0,0\n0.3,0\n0.6,0\n", encoding="utf-8")
    out = tmp_path / "out"
    with node(tmp_path, graph, "sim", "--no-noise") as (robot, said_by_robot):
        control = ("control", "pid", str(path), "--speed", "0.2", "--patience", str(PATIENCE), "--out", str(out))
        for _ in range(3):  # a machine that stalls for half a second has the robot stopped, as it should
            with node(tmp_path, graph, *control) as (controller, log):
                status = controller.wait(2.0 * PATIENCE)
            if status == 0 or "no feedback for" not in said(log):
                break
        assert status == 0, said(log)
        robot.send_signal(signal.SIGINT)
        assert robot.wait(PATIENCE) == cli.EXIT_INTERRUPTED
        assert "/cmd_vel commands" in said(said_by_robot)
        assert "/platform/joint_states" in said(said_by_robot)
    document = json.loads((out / "track.json").read_text(encoding="utf-8"))
    assert document["status"] == "arrived"
    assert document["options"]["judged_by"] == "/vrpn_mocap/husky/pose"
    assert document["metrics"]["d_rms_m"] < 0.05


def test_silence_and_a_killed_driver_stop_the_robot(tmp_path: Path, graph: Graph) -> None:
    """The watchdog brakes when the stream ends, also when its writer was killed and could not say that it leaves."""
    code = (
        "import time; from validation.ros.graph import Graph; from validation.ros.run import open_port;"
        f"port = open_port('driver', Graph({graph.domain})); port.advertise('/cmd_vel', 'geometry_msgs/Twist');\n"
        "while True: port.send('/cmd_vel', lambda m: setattr(m.linear, 'x', 0.3)); time.sleep(0.05)"
    )
    with joined(graph) as port, node(tmp_path, graph, "sim", "--no-noise") as (_, log):
        pose = graph.topic(POSE_TOPIC, "husky")
        port.listen(pose, MESSAGE_TYPES[POSE_TOPIC], msg.read_pose_stamped, 1)
        last: list[msg.Seen] = []

        def moved_on() -> float:
            """How fast the robot is by its own clock [m/s], over at least 0.2 s of it; NaN before."""
            last.extend(got.message for got in port.drain())
            first = next((k for k in range(len(last)) if last[-1].stamp - last[k].stamp < 0.2), 0) - 1
            if first < 0:
                return float("nan")
            a, b = last[first], last[-1]
            return float(np.hypot(b.x - a.x, b.y - a.y) / (b.stamp - a.stamp))

        wait_for(lambda: moved_on() < 0.01, "a robot that stands")
        driver = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT)
        try:
            wait_for(lambda: moved_on() > 0.2, "a robot that is driven")
        finally:
            driver.kill()
            driver.wait()
        wait_for(lambda: "nothing on /cmd_vel for 0.25 s: the robot brakes" in said(log), "the watchdog")
        killed = last[-1].stamp
        wait_for(lambda: moved_on() < 0.01, "a robot at rest")
        assert last[-1].stamp > killed


def test_a_killed_robot_stops_the_controller(tmp_path: Path, graph: Graph) -> None:
    """Feedback ends without a word; the controller says so, and keeps the drive."""
    out = tmp_path / "out"
    control = ("control", "pid", "line", "--patience", str(PATIENCE), "--out", str(out))
    with node(tmp_path, graph, "sim") as (robot, _), node(tmp_path, graph, *control) as (controller, log):
        wait_for(lambda: "driving" in said(log) or controller.poll() is not None, "a drive")
        with joined(graph) as port:
            port.listen("/cmd_vel", "geometry_msgs/Twist", msg.read_twist, 1)
            told: list[float] = []

            def half_a_second() -> bool:
                """Whether so many commands came: a drive that had not yet gone anywhere leaves no files."""
                told.extend(got.message[0] for got in port.drain() if got.message[0] > 0.0)
                return len(told) >= 10 or controller.poll() is not None

            wait_for(half_a_second, "commands")
        robot.kill()
        assert controller.wait(PATIENCE) == 1
    assert "no feedback for" in said(log)
    assert json.loads((out / "track.json").read_text(encoding="utf-8"))["status"] == "stopped"


# --- another DDS ---


@pytest.fixture(scope="module")
def peer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A program on eProsima's Fast DDS, which knows ROS 2's types by their IDL alone."""
    if None in (shutil.which("fastddsgen"), shutil.which("g++"), ctypes.util.find_library("fastrtps")):
        pytest.skip(
            "there is no Fast DDS; on Debian 12: apt-get install --no-install-recommends libfastrtps-dev fastddsgen g++"
        )
    folder, source = tmp_path_factory.mktemp("fastdds"), ROOT / "tests" / "fastdds"
    program = folder / "peer"
    for command in (
        ("fastddsgen", "-replace", "-d", str(folder), str(source / "ros2.idl")),
        ("g++", "-O0", f"-I{folder}", *(str(folder / f"ros2{part}.cxx") for part in ("", "PubSubTypes")),
         str(source / "peer.cpp"), "-o", str(program), "-lfastrtps", "-lfastcdr", "-lpthread"),
    ):  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder, timeout=600.0)
        assert done.returncode == 0, done.stderr or done.stdout
    return program


def test_a_peer_of_another_dds_drives_the_robot(
    tmp_path: Path, graph: Graph, peer: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It joins late, gets the description, hears the odometry, learns whose it is, and commands the robot 0.2 m far."""
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    with node(tmp_path, graph, "sim") as (_, log):
        wait_for(lambda: "Ctrl-C ends" in said(log), "the robot")
        command = [str(peer), str(graph.domain), str(round(PATIENCE))]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=2.0 * PATIENCE)
    assert done.returncode == 0, f"{done.stdout} {done.stderr} {said(log)}"
    assert "odom to base_link" in done.stdout
    assert "odometry by /husky_simulation" in done.stdout
    assert int(done.stdout.split("description of ")[1].split()[0]) == len(urdf_text(load_robot(), JOINTS))


# --- the robot's description ---

JOINTS = {wheel: Graph().joint(wheel) for wheel in WHEELS}


@pytest.mark.parametrize("name", shipped_robots())
def test_the_description_is_read_back_as_the_robot(name: str, tmp_path: Path) -> None:
    """By this project's own reader of URDFs, which is MuJoCo's, and by MuJoCo alone."""
    robot, path = load_robot(name), tmp_path / "robot.urdf"
    path.write_text(urdf_text(robot, JOINTS), encoding="utf-8")
    tree = read_urdf(path)
    assert sum(link.mass for link in tree.links.values()) == pytest.approx(robot.masses.total, rel=1e-6)
    g = robot.geometry
    for wheel, joint in JOINTS.items():
        link = next(link for link in tree.links.values() if link.joint == joint)
        signs = (1.0 if "front" in wheel else -1.0, 1.0 if "left" in wheel else -1.0)
        place = (0.5 * signs[0] * g.wheelbase, 0.5 * signs[1] * g.track, g.axle_height)
        np.testing.assert_allclose(link.place, place, atol=1e-9)
        np.testing.assert_allclose(np.diag(link.inertia), np.array(robot.masses.wheel_inertia)[[0, 1, 0]], rtol=1e-6)
        assert link.joint_type == "continuous"
        assert tuple(link.axis) == (0.0, 1.0, 0.0)
        np.testing.assert_allclose(np.sort(link.shapes[0].size), np.sort([0.5 * g.wheel_width, *2 * [g.wheel_radius]]))
    np.testing.assert_allclose(tree.links["imu_link"].place, g.imu, atol=1e-9)
    chassis = tree.links["chassis_link"]
    np.testing.assert_allclose(chassis.com, robot.masses.com, atol=1e-9)
    np.testing.assert_allclose(np.diag(chassis.inertia), robot.masses.inertia, rtol=1e-6)
    drafted = import_robot(path, name=f"{name}-again")
    assert drafted.robot.geometry.wheelbase == pytest.approx(g.wheelbase, rel=1e-6)
