"""The nodes on a ROS 2 graph: names, types and bytes, then DDS on loopback.

Nothing here waits for a certain time: what must come is polled for, with a deadline that only a
broken program meets.
"""

from __future__ import annotations

import contextlib
import copy
import json
import math
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from validation import cli
from validation.ros import dds
from validation.ros import messages as msg
from validation.ros.__main__ import PROGRAM
from validation.ros.dds import Graph, Node

ROOT = Path(__file__).resolve().parents[1]
PATIENCE = 90.0
"""Longest time for which anything is waited for [s]: a node starts in 3 s, and on a busy machine in
twenty."""
SILENT = re.compile("no feedback for|the stamps of the feedback jumped")
"""A controller ends with one of these when its robot falls silent: on a busy machine it may hear
the robot again before it gives up, and then says that the stamps jumped."""
TWIST = "geometry_msgs/msg/Twist"
STRING = "std_msgs/msg/String"
ODOMETRY = "nav_msgs/msg/Odometry"
FORMS = (TWIST, "geometry_msgs/msg/TwistStamped")
KINDS = (
    *FORMS,
    STRING,
    ODOMETRY,
    "std_msgs/msg/Bool",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "sensor_msgs/msg/Imu",
    "geometry_msgs/msg/PoseStamped",
    "sensor_msgs/msg/JointState",
    "tf2_msgs/msg/TFMessage",
    "rosgraph_msgs/msg/Clock",
)


@pytest.fixture
def cyclone() -> Any:
    """The modules of cyclonedds; a test skips where they are missing."""
    pytest.importorskip("cyclonedds", reason="ROS 2 needs the extra `ros2`")
    return dds._load_dds()


@pytest.fixture
def graph(cyclone: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Graph]:
    """An empty domain on loopback, which no other test takes while a port is bound here."""
    monkeypatch.setenv("CYCLONEDDS_URI", dds.cyclone_configuration(""))
    for domain in range(1, 101):  # the ports of greater ones are those that the system hands out
        # DDSI-RTPS 9.6.2: + 10 for the first participant, + 248 for the 120th, which none is
        port = 7400 + 250 * domain
        with contextlib.suppress(OSError), contextlib.ExitStack() as bound:
            for offset in (248, 10):
                taken = bound.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
                taken.bind(("", port + offset))
            taken.close()
            yield Graph(domain=domain)
            return
    pytest.fail("no domain is free")


@contextlib.contextmanager
def joined(graph: Graph, name: str = "tester") -> Iterator[Node]:
    node = Node(name, graph)
    try:
        yield node
    finally:
        node.close()


class Peer:
    """A participant without this project's node: readers and writers of any quality."""

    def __init__(self, cyclone: Any, graph: Graph) -> None:
        self.dds = cyclone
        self.participant = cyclone.domain.DomainParticipant(graph.domain)

    def _open(self, kind_of_port: Any, topic: str, kind: str, reliable: bool, latched: bool) -> Any:
        policy = self.dds.qos.Policy
        qos = self.dds.qos.Qos(
            policy.Reliability.Reliable(self.dds.util.duration(seconds=1))
            if reliable
            else policy.Reliability.BestEffort,
            policy.Durability.TransientLocal if latched else policy.Durability.Volatile,
        )
        place = self.dds.topic.Topic(self.participant, f"rt{topic}", dds._idl_class(kind))
        return kind_of_port(self.participant, place, qos=qos)

    def reader(self, topic: str, kind: str, reliable: bool = True, latched: bool = False) -> Any:
        """A reader of a topic."""
        return self._open(self.dds.sub.DataReader, topic, kind, reliable, latched)

    def writer(self, topic: str, kind: str, reliable: bool = True) -> Any:
        """A writer of a topic."""
        return self._open(self.dds.pub.DataWriter, topic, kind, reliable, False)


def wait_for(true: Callable[[], Any], what: str) -> Any:
    """Return what `true` says once it says something."""
    until = time.monotonic() + PATIENCE
    while not (measured := true()):
        assert time.monotonic() < until, f"{what}: waited {PATIENCE:g} s in vain"
        time.sleep(0.02)
    return measured


# --- names, types and bytes: no DDS ---


def test_a_namespace_stands_before_what_belongs_to_the_robot() -> None:
    names = ("/cmd_vel", "/tf", "/clock", msg.tracking_topic("jackal"))
    assert tuple(map(Graph().topic, names)) == names
    named = Graph(namespace="fleet/a200_0000")
    assert tuple(map(named.topic, names)) == (
        "/fleet/a200_0000/cmd_vel",
        "/fleet/a200_0000/tf",
        *names[2:],
    )


def test_types_on_the_wire_are_ros_2s(cyclone: Any) -> None:
    assert (
        dds._idl_class(TWIST).__idl__.idl_transformed_typename == "geometry_msgs::msg::dds_::Twist_"
    )
    # the hash of Twist in ROS 2's own documentation of `ros2 topic info --verbose`
    known = b"typehash=RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a;"
    assert dds._user_data(TWIST) == known


def filled(message: Any, rng: np.random.Generator) -> Any:
    """Return a message with something in each of its fields."""
    for field in fields(message):
        value = getattr(message, field.name)
        new = None
        if is_dataclass(value):
            new = filled(value, rng)
        elif isinstance(value, list) and field.name == "transforms":
            new = [filled(dds._idl_message("geometry_msgs/msg/TransformStamped", {}), rng)]
        elif isinstance(value, list):
            new = (
                ["joint"] * 3 if field.name == "name" else rng.normal(size=len(value) or 3).tolist()
            )
        else:
            new = {str: "Ωmega", bool: True, int: int(rng.integers(1, 2**31))}.get(
                type(value), rng.normal()
            )
        setattr(message, field.name, new)
    return message


@pytest.mark.usefixtures("cyclone")
@pytest.mark.parametrize("kind", KINDS)
def test_the_bytes_are_those_of_rosbags(kind: str) -> None:
    """An implementation of ROS 2's serialisation that knows nothing of DDS."""
    message = filled(dds._idl_message(kind, {}), np.random.default_rng(0))
    store = dds._message_definitions()
    written = message.serialize(use_version_2=False)
    again = bytes(store.serialize_cdr(store.deserialize_cdr(written, kind), kind))
    assert written[4:].rstrip(b"\0") == again[4:].rstrip(b"\0"), "but for the padding at the end"
    assert dds._idl_class(kind).deserialize(again) == message


# --- mistakes ---


def test_without_the_extra_one_line_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "cyclonedds"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "cyclonedds", None)
    with pytest.raises(SystemExit) as ended:
        cli.run_command(PROGRAM, "ros", ("control", "pid", "line", "--ros", "2"))
    assert ended.value.code == cli.EXIT_USER_ERROR
    assert "pip install 'ssmr-testbed[ros2]'" in " ".join(capsys.readouterr().err.split())


def test_an_interface_that_is_not_there_is_one_line(
    cyclone: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CYCLONEDDS_URI", "")
    with pytest.raises(ValueError, match="no ROS 2 graph in domain 101 by interface nowhere0"):
        Node("tester", Graph(domain=101, interface="nowhere0"))


def test_the_domain_is_ros_domain_id(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    assert Graph().domain_number() == 7
    assert Graph(domain=9).domain_number() == 9
    monkeypatch.setenv("ROS_DOMAIN_ID", "seven")
    with pytest.raises(ValueError, match=r"the domain \(--domain, ROS_DOMAIN_ID\) is seven"):
        Graph().domain_number()


# --- nodes on a graph ---


def test_a_late_joiner_gets_what_was_latched_and_nothing_else(graph: Graph, cyclone: Any) -> None:
    with joined(graph) as node:
        for topic, latch in (("/robot_description", True), ("/old", False)):
            node.advertise(topic, STRING, latch=latch)
            node.publish(topic, {"data": "<robot/>"})
        peer = Peer(cyclone, graph)
        latched, old = (
            peer.reader(topic, STRING, latched=topic != "/old")
            for topic in ("/robot_description", "/old")
        )
        wait_for(lambda: node.subscribers("/old"), "the late joiner")
        (came,) = wait_for(latched.take, "what was latched")
        assert came.data == "<robot/>"
        assert not old.take()


@pytest.mark.parametrize("reliable", [False, True])
def test_sensors_match_readers_and_writers_of_either_quality(
    graph: Graph, cyclone: Any, reliable: bool
) -> None:
    """Drivers send with best effort; RViz and rosbag2 ask for the one or the other."""
    peer = Peer(cyclone, graph)
    came = set[str]()
    with joined(graph) as node:
        reader = peer.reader("/ours", ODOMETRY, reliable)
        writer = peer.writer("/theirs", ODOMETRY, reliable)
        node.advertise("/ours", ODOMETRY)
        node.subscribe("/theirs", ODOMETRY, msg.read_odometry)
        good = msg.odometry_message(1.0, np.zeros(3), (0.0, 0.0), np.eye(3), np.eye(3))

        def both_came() -> bool:
            node.publish("/ours", good)
            writer.write(dds._idl_message(ODOMETRY, good))
            came.update(["read"] * len(reader.take()), ["heard"] * len(node.receive()))
            return len(came) == 2

        wait_for(both_came, "odometry to and from")


@pytest.mark.parametrize("kind", FORMS)
def test_commands_come_and_go_as_twist_and_as_twist_stamped(
    graph: Graph, cyclone: Any, kind: str
) -> None:
    """Robots of Humble take the one and those of Jazzy the other.

    A node of this project speaks and hears both.
    """
    peer = Peer(cyclone, graph)
    with joined(graph) as node:
        node.advertise("/out", TWIST)
        node.subscribe("/in", TWIST, msg.read_twist)
        assert node.subscribers("/out") == 0
        reader = peer.reader("/out", kind)
        writer = peer.writer("/in", kind)
        wait_for(lambda: node.subscribers("/out"), "the robot")

        def sent() -> Any:
            node.publish("/out", msg.twist_message(0.3, 0.1))
            return reader.take()

        got = wait_for(sent, "a command")[0]
        assert type(got) is dds._idl_class(kind)
        assert msg.read_twist(getattr(got, "twist", got)) == (0.3, 0.1)
        (seen,) = {
            bytes(reader.get_matched_publication_data(handle).qos[cyclone.qos.Policy.Userdata].data)
            for handle in reader.get_matched_publications()
        }
        assert seen == dds._user_data(kind)
        values = msg.twist_message(0.4, 0.1)

        def came() -> Any:
            writer.write(dds._idl_message(kind, values if kind == TWIST else {"twist": values}))
            return node.receive()

        assert wait_for(came, "a command")[0] == ("/in", (0.4, 0.1))


def test_nonsense_is_refused_and_what_is_right_goes_on(
    graph: Graph, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A number or text that is none, and one that cannot be sent, end nothing."""
    with joined(graph) as node, joined(graph, "driver") as driver:
        node.subscribe("/cmd_vel", TWIST, msg.read_twist)
        node.subscribe("/words", STRING, lambda m: m.data)
        driver.advertise("/cmd_vel", TWIST)
        driver.advertise("/words", STRING)
        serialize = dds._idl_class(STRING).serialize
        broken = {"abc": b"\xff\xfe\xfd"}

        def no_text(message: Any, *given: Any, **named: Any) -> bytes:
            written = serialize(message, *given, **named)
            return bytes(3) if message.data == "cut" else written.replace(b"abc", broken["abc"])

        monkeypatch.setattr(dds._idl_class(STRING), "serialize", no_text)

        def refused() -> bool:
            driver.publish("/cmd_vel", msg.twist_message(float("nan"), 0.1))
            driver.publish("/words", {"data": "abc"})
            assert node.receive() == []
            return (
                "linear.x is nan" in node.refusals("/cmd_vel")
                and "cannot be decoded" in caplog.text
            )

        wait_for(refused, "refusals of both")
        driver.publish("/words", {"data": "cut"})
        assert "/words: a message could not be sent" in caplog.text

        def came() -> Any:
            driver.publish("/cmd_vel", msg.twist_message(0.1, 0.1))
            return node.receive()

        assert wait_for(came, "a command after that")[0] == ("/cmd_vel", (0.1, 0.1))
        assert node.refusals("/cmd_vel") == ""


def test_of_many_messages_the_last_ones_wait_and_a_writer_that_leaves_is_said(
    graph: Graph, caplog: pytest.LogCaptureFixture
) -> None:
    with joined(graph) as node:
        node.subscribe("/cmd_vel", TWIST, msg.read_twist)
        node.subscribe("/words", STRING, lambda m: m.data, 4)
        readers = [reader for s in node._subscriptions.values() for reader in s.readers]
        with joined(graph, "driver") as driver:
            driver.advertise("/cmd_vel", TWIST)
            driver.advertise("/words", STRING)
            wait_for(
                lambda: driver.subscribers("/cmd_vel") == 2 and driver.subscribers("/words"),
                "the robot",
            )
            for k in range(9):
                driver.publish("/cmd_vel", msg.twist_message(0.1 * k, 0.0))
                driver.publish("/words", {"data": str(k)})
            wait_for(
                lambda: [m.data for m in readers[-1].read(9)] == ["5", "6", "7", "8"],
                "the last messages",
            )
        wait_for(
            lambda: not any(r.get_matched_publications() for r in readers), "the end of the writer"
        )
        came = node.receive()
        assert {value for topic, value in came if topic == "/cmd_vel"} == {(0.8, 0.0)}
        assert [value for topic, value in came if topic == "/words"] == ["5", "6", "7", "8"]
        assert "/words: nobody sends any more" in caplog.text
        assert node.refusals("/cmd_vel") == ""


# --- the nodes, as processes ---


@contextlib.contextmanager
def process(
    tmp_path: Path, graph: Graph, *arguments: str
) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """A node's process and the file of what it says; killed at the end."""
    log = tmp_path / f"{arguments[0]}.log"
    command = [
        sys.executable,
        "-m",
        "validation.ros",
        *arguments,
        "--ros",
        "2",
        "--domain",
        str(graph.domain),
    ]
    with log.open("wb") as out:
        running = subprocess.Popen(
            command, stdout=out, stderr=subprocess.STDOUT, cwd=ROOT, start_new_session=True
        )
    try:
        yield running, log
    finally:
        running.kill()
        running.wait()


def text_of(log: Path) -> str:
    return " ".join(log.read_text(encoding="utf-8", errors="replace").split())


def short_way(tmp_path: Path) -> Path:
    """Return the file of a straight path of 0.6 m."""
    path = tmp_path / "short.csv"
    path.write_text("x,y\n0,0\n0.3,0\n0.6,0\n", encoding="utf-8")
    return path


def control_along(path: Path, out: Path, *more: str) -> tuple[str, ...]:
    """Return a command line of a controller, which waits for long."""
    waits = ("--patience", str(PATIENCE), "--out", str(out), "--overwrite")
    return ("control", "mpc", str(path), "--speed", "0.2", *waits, *more)


def wait_for_drive(node: Node, controller: subprocess.Popen[bytes]) -> None:
    """Wait for half a second of commands: a drive without motion leaves no files."""
    sent: list[float] = []

    def drives() -> bool:
        sent.extend(v for _, (v, _) in node.receive() if v > 0.0)
        return len(sent) >= 10 or controller.poll() is not None

    wait_for(drives, "commands")


def test_either_side_may_end_and_be_started_again(tmp_path: Path, graph: Graph) -> None:
    """A controller that comes back finds the robot, and one that waits finds a new robot.

    Ctrl-C ends either; a robot that is killed says no word, and its controller keeps the drive.
    """
    out = tmp_path / "out"
    command = control_along(short_way(tmp_path), out)
    with process(tmp_path, graph, "sim", "--no-noise") as (robot, _), joined(graph) as node:
        node.subscribe("/cmd_vel", TWIST, msg.read_twist, 10)
        with process(tmp_path, graph, *command) as (first, log):
            wait_for_drive(node, first)
            first.send_signal(signal.SIGINT)
            assert first.wait(PATIENCE) == cli.EXIT_INTERRUPTED, text_of(log)
        node.receive()
        with process(tmp_path, graph, *command) as (second, log):
            wait_for_drive(node, second)
            robot.kill()
            assert second.wait(PATIENCE) == 1
    assert SILENT.search(text_of(log))
    assert json.loads((out / "track.json").read_text(encoding="utf-8"))["status"] == "stopped"
    # a path in the tracking system's frame, at whose beginning the new robot stands
    rows = [f"{1.0 + d * math.cos(0.5)},{2.0 + d * math.sin(0.5)},world" for d in (0.0, 0.3, 0.6)]
    way = tmp_path / "way.csv"
    way.write_text("\n".join(["x,y,frame", *rows]), encoding="utf-8")
    command = control_along(way, out, "--feedback", "pose")
    # mission time is that of the stamps, so load does not matter, but for a machine that stalls
    for _ in range(3):
        with process(tmp_path, graph, *command) as (third, log):
            wait_for(lambda: "waiting for the robot" in text_of(log), "the controller")
            again = ("sim", "--no-noise", "--start", "1,2,0.5")
            with process(tmp_path, graph, *again) as (robot, said_by_robot):
                status = third.wait(2.0 * PATIENCE)
                robot.send_signal(signal.SIGINT)
                assert robot.wait(PATIENCE) == cli.EXIT_INTERRUPTED
        if status == 0 or not SILENT.search(text_of(log)):
            break
    assert status == 0, text_of(log)
    assert "/cmd_vel commands" in text_of(said_by_robot)
    document = json.loads((out / "track.json").read_text(encoding="utf-8"))
    assert document["status"] == "arrived"
    assert document["options"]["frame"] == "world"
    assert document["options"]["judged_by"] == "/vrpn_mocap/husky/pose"
    assert document["metrics"]["d_rms_m"] < 0.05


def test_a_localisers_pose_is_heard_as_a_tracking_systems(graph: Graph, cyclone: Any) -> None:
    kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
    peer = Peer(cyclone, graph)
    pose = msg.pose_message(1.0, "map", np.array([1.0, 2.0, 0.5]))
    localised = {"header": pose["header"], "pose": {"pose": pose["pose"]}}
    with joined(graph) as node:
        node.subscribe("/amcl_pose", "geometry_msgs/msg/PoseStamped", msg.read_pose)
        writer = peer.writer("/amcl_pose", kind)

        def came() -> Any:
            writer.write(dds._idl_message(kind, localised))
            return node.receive()

        stamp, seen, frame = wait_for(came, "a pose")[0][1]
    assert (stamp, frame) == (1.0, "map")
    assert seen[:3] == pytest.approx([1.0, 2.0, 0.5])


Odometry = dict[str, Any]


def nowhere(sent: Odometry) -> list[Odometry]:
    """Return odometry whose place is no number."""
    return [moved(sent, math.nan)]


def and_another(sent: Odometry) -> list[Odometry]:
    """Return odometry and that of a second node, which has the robot elsewhere."""
    return [sent, moved(sent, 0.7)]


def and_a_camera(sent: Odometry) -> list[Odometry]:
    """Return odometry and that of a camera on the robot."""
    return [sent, {**moved(sent, 0.7), "child_frame_id": "camera_link"}]


def moved(sent: Odometry, x: float) -> Odometry:
    """Return odometry a millisecond later and x [m] farther."""
    other = copy.deepcopy(sent)
    other["pose"]["pose"]["position"]["x"] += x
    other["header"]["stamp"]["nanosec"] += 1_000_000
    return other


def fields_of(message: Any) -> Any:
    """Return the fields of a message that came, as they are sent."""
    if is_dataclass(message):
        return {f.name: fields_of(getattr(message, f.name)) for f in fields(message)}
    return message


@pytest.mark.slow  # without processes in test_ros_control.py
@pytest.mark.parametrize(
    ("change", "reliable", "why"),
    [
        (None, False, ""),
        (nowhere, True, r"no feedback that can be used for .* position\.x is nan"),
        (and_another, False, r"the pose jumped, or stayed behind, by 0\.7\d m"),
        (and_a_camera, True, ""),
    ],
)
def test_what_comes_on_the_graph_is_driven_by_or_stops_the_robot(
    tmp_path: Path,
    graph: Graph,
    cyclone: Any,
    change: Callable[[Odometry], list[Odometry]] | None,
    reliable: bool,
    why: str,
) -> None:
    """Odometry of another quality, that is no number, and of two nodes, once the robot drives."""
    out = tmp_path / "out"
    command = control_along(short_way(tmp_path), out, "--odometry", "/relayed")
    for _ in range(3):  # a machine that stalls for half a second has the robot stopped
        peer = Peer(cyclone, graph)
        writer = peer.writer("/relayed", ODOMETRY, reliable)
        with (
            process(tmp_path, graph, "sim", "--no-noise"),
            process(tmp_path, graph, *command) as (controller, log),
            joined(graph) as node,
        ):
            node.subscribe("/platform/odom/filtered", ODOMETRY, lambda m: m, 20)
            node.subscribe("/cmd_vel", TWIST, msg.read_twist, 10)
            driven = 0
            until = time.monotonic() + 2.0 * PATIENCE
            while controller.poll() is None and time.monotonic() < until:
                for topic, value in node.receive(0.02):
                    if topic == "/cmd_vel":
                        driven += value[0] > 0.0
                        continue
                    relayed = fields_of(value)
                    faulty = change is not None and driven >= 10
                    for sent in change(relayed) if faulty and change else [relayed]:
                        writer.write(dds._idl_message(ODOMETRY, sent))
            status = controller.wait(PATIENCE)
        if not SILENT.search(text_of(log)):
            break
    assert driven >= 10
    document = json.loads((out / "track.json").read_text(encoding="utf-8"))
    assert status == (1 if why else 0), text_of(log)
    assert re.search(why, document["stopped_because"])
    if change is and_a_camera:
        assert "its frames are ['odom', 'camera_link']" in text_of(log)


@pytest.mark.parametrize("reliable", [False, True])
def test_an_emergency_stop_is_heard_whatever_its_quality(
    graph: Graph, cyclone: Any, reliable: bool
) -> None:
    """A reader that asks for reliable writers would not hear one that is not, without a word."""
    peer = Peer(cyclone, graph)
    with joined(graph) as node:
        node.subscribe("/stop", "std_msgs/msg/Bool", lambda m: bool(m.data), msg.STOPS_KEPT)
        writer = peer.writer("/stop", "std_msgs/msg/Bool", reliable)

        def came() -> Any:
            writer.write(dds._idl_message("std_msgs/msg/Bool", {"data": True}))
            return node.receive()

        assert wait_for(came, "a stop")[0] == ("/stop", True)


@pytest.mark.parametrize("latched", [False, True])
def test_transforms_and_paths_come_whether_they_were_sent_before_or_not(
    graph: Graph, cyclone: Any, latched: bool
) -> None:
    """A static transform is sent once, and kept for those who come later."""
    kinds = {"/tf_static": "tf2_msgs/msg/TFMessage", "/plan": "nav_msgs/msg/Path"}
    pose = np.array([1.0, 2.0, 0.5])
    stamped = msg.pose_message(0.0, "map", pose)
    told = {
        "/tf_static": msg.transform_message(0.0, ("map", "odom"), pose),
        "/plan": {"header": {"frame_id": "map"}, "poses": [stamped, {}]},
    }
    with joined(graph) as sender, joined(graph, "listener") as node:
        for topic, kind in kinds.items():
            sender.advertise(topic, kind, latch=latched)
            if latched:
                sender.publish(topic, told[topic])
        node.subscribe("/tf_static", kinds["/tf_static"], msg.read_transforms, latch=True)
        node.subscribe("/plan", kinds["/plan"], lambda m: m, latch=True)
        came: dict[str, Any] = {}

        def both_came() -> bool:
            for topic in kinds if not latched else ():
                sender.publish(topic, told[topic])
            came.update(node.receive())
            return len(came) == 2

        wait_for(both_came, "a transform and a path")
    ((parent, child, there),) = came["/tf_static"]
    assert (parent, child) == ("map", "odom")
    assert there == pytest.approx(pose)
    assert came["/plan"].header.frame_id == "map"
    assert len(came["/plan"].poses) == 2


def test_a_flood_of_malformed_packets_fills_no_log(
    graph: Graph, capfd: pytest.CaptureFixture[str]
) -> None:
    """Cyclone writes a line for each, and whoever reaches the port can send any number."""
    header = b"RTPS" + bytes([2, 5, 1, 16]) + bytes(12)
    cut_short = bytes([0x15, 1, 255, 255]) + bytes(range(40))
    with joined(graph) as node, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for _ in range(500):
            sender.sendto(
                header + cut_short, ("127.0.0.1", 7400 + 250 * node.graph.domain_number() + 10)
            )
        time.sleep(0.3)  # a message that nobody prints cannot be waited for
    written = capfd.readouterr().err
    assert len(written) < 500, written[:300]
