"""The way into a ROS 1 graph: the only module that knows rospy, which is imported when a port opens.

rospy is no package of PyPI. On Debian 12 it comes with apt for the system's Python 3.11, where a virtual environment of the
same version finds it too; the environment's own packages go first.
"""

from __future__ import annotations

import importlib
import importlib.util
import logging
import os
import queue
import sys
import threading
import time
import warnings
import xmlrpc.client
from collections.abc import Callable
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple
from xml.parsers.expat import ExpatError

from validation import cli

SYSTEM_PACKAGES = Path("/usr/lib/python3/dist-packages")
"""Where Debian puts rospy."""
APT_PACKAGES = (
    "ros-core python3-rospy python3-nav-msgs python3-geometry-msgs python3-sensor-msgs python3-tf2-msgs python3-std-srvs"
)
"""What apt must install."""
QUEUE = 10
"""Messages that wait for a slow subscriber, a topic."""
MASTER_PERIOD = 0.1
"""How often the master is asked whether it is there [s]."""
MASTER_PATIENCE = 0.25
"""How long it may take to answer [s]; the first time, ten times as long."""
REFUSED, SILENT, GONE = 2, 1, 4
"""What a refused question and one that was not answered in time count for, and at how much the master is gone: after two
refusals, 0.2 s, or four silences, 1.4 s. A busy machine is silent at times; a silence that cuts off peers as well is noticed
by them within 0.5 s."""


class Received(NamedTuple):
    """A message, and when it came."""

    topic: str
    arrival: float
    """Monotonic [s]."""
    message: Any


class Call(NamedTuple):
    """A service call that waits for its answer."""

    request: Any
    answer: Callable[[str], None]
    """To be called once: with nothing, or with what was wrong."""


def load_rospy() -> ModuleType:
    """rospy, from this environment or the system's.

    Raises:
        UserError: it is not there, or is another Python's.
    """
    if importlib.util.find_spec("rospy") is None and str(SYSTEM_PACKAGES) not in sys.path:
        sys.path.append(str(SYSTEM_PACKAGES))  # last: what this environment has itself goes first
    try:
        with warnings.catch_warnings(action="ignore"):  # of packages as old as ROS 1
            for name in ("rosgraph", "nav_msgs.msg", "geometry_msgs.msg", "sensor_msgs.msg", "tf2_msgs.msg", "std_srvs.srv"):
                importlib.import_module(name)
            return importlib.import_module("rospy")
    except ImportError as error:
        raise cli.UserError(
            f"ROS 1 is not there ({error}); on Debian 12: apt-get install --no-install-recommends {APT_PACKAGES}; "
            f"it is for Python 3.11, this is {sys.version_info.major}.{sys.version_info.minor}"
        ) from None


def message_class(kind: str) -> type[Any]:
    """The class of `package/Type`, after `load_rospy`."""
    package, _, name = kind.partition("/")
    found: type[Any] = getattr(importlib.import_module(f"{package}.msg"), name)
    return found


def set_pose_service() -> type[Any]:
    """robot_localization's SetPose.

    Debian does not package robot_localization. The same type made here, with the same name and checksum, is the same on the
    wire: its request is one PoseWithCovarianceStamped, its answer is empty.
    """
    try:
        found: type[Any] = importlib.import_module("robot_localization.srv").SetPose
        return found
    except ImportError:
        pass
    import genpy
    from std_srvs.srv import EmptyResponse

    posed = message_class("geometry_msgs/PoseWithCovarianceStamped")

    class SetPoseRequest(genpy.Message):
        _type = "robot_localization/SetPoseRequest"
        _md5sum = SET_POSE_MD5
        _full_text = "geometry_msgs/PoseWithCovarianceStamped pose\n"
        __slots__ = ["pose"]
        _slot_types = ["geometry_msgs/PoseWithCovarianceStamped"]  # noqa: RUF012

        def __init__(self, pose: Any = None) -> None:
            self.pose = posed() if pose is None else pose

        def _get_types(self) -> list[str]:
            return self._slot_types

        def serialize(self, buff: Any) -> None:
            self.pose.serialize(buff)

        def deserialize(self, data: bytes) -> SetPoseRequest:
            self.pose = posed()
            self.pose.deserialize(data)
            return self

    class SetPose:
        _type = "robot_localization/SetPose"
        _md5sum = SET_POSE_MD5
        _request_class = SetPoseRequest
        _response_class = EmptyResponse

    return SetPose


SET_POSE_MD5 = "4f3e0bbe7a24e1f929488cd1970222d3"
"""genmsg's checksum of the service's definition; a test recomputes it."""


class _Impatient(xmlrpc.client.Transport):
    """HTTP that waits only so long."""

    def __init__(self, patience: float) -> None:
        super().__init__()
        self._patience = patience

    def make_connection(self, host: Any) -> HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = self._patience
        return connection


def ask_master(uri: str, caller: str, patience: float) -> int:
    """Process id of a ROS master.

    Raises:
        TimeoutError: it did not answer in time.
        OSError: nobody is there, or nobody that speaks as a master does.
    """
    try:
        with xmlrpc.client.ServerProxy(uri, transport=_Impatient(patience)) as master:
            answer: Any = master.getPid(caller)
        code, _, pid = answer
        if code != 1:
            raise OSError(f"the master answers with code {code}")
        return int(pid)
    except (HTTPException, ExpatError, xmlrpc.client.Error, ValueError, TypeError) as error:
        raise OSError(f"no master's answer: {error}") from error


class Port:
    """A node's topics, services and parameters; what comes waits in one queue for whoever asks."""

    def __init__(self, name: str) -> None:
        """Register a node.

        Raises:
            UserError: rospy or the master is not there, or rospy is set up wrongly.
        """
        self._rospy = load_rospy()
        self._uri = os.environ.setdefault("ROS_MASTER_URI", "http://localhost:11311")
        self._id = f"/{name}"
        try:
            self._pid = ask_master(self._uri, self._id, 10.0 * MASTER_PATIENCE)
        except OSError:
            raise cli.UserError(
                f"no ROS master answers at {self._uri}: start one with roscore, or set ROS_MASTER_URI to where it is"
            ) from None
        self._handlers = logging.getLogger().handlers[:], logging.getLogger().level
        with warnings.catch_warnings(action="ignore"):
            self._rospy.init_node(name, disable_signals=True, disable_rosout=True)
        logging.getLogger().handlers[:], level = self._handlers
        logging.getLogger().setLevel(level)
        self._inbox: queue.SimpleQueue[Received] = queue.SimpleQueue()
        self._calls: queue.SimpleQueue[Call] = queue.SimpleQueue()
        self._publishers: dict[str, tuple[Any, type[Any]]] = {}
        self._restore: tuple[str, Any] | None = None
        self._closed = threading.Event()
        self.master_gone = threading.Event()
        """Set while the master does not answer, or another has taken its place: that one knows nothing of this node."""
        threading.Thread(target=self._watch_master, daemon=True).start()

    # --- the master ---

    def _watch_master(self) -> None:
        doubt = 0
        while not self._closed.wait(MASTER_PERIOD):
            try:
                same = ask_master(self._uri, self._id, MASTER_PATIENCE) == self._pid
                doubt = 0 if same else doubt + REFUSED
            except TimeoutError:
                doubt += SILENT
            except OSError:
                doubt += REFUSED
            if doubt >= GONE:
                self.master_gone.set()
            elif doubt == 0:
                self.master_gone.clear()

    @property
    def master_pid(self) -> int:
        """Its process id, on its own machine."""
        return self._pid

    @property
    def master(self) -> str:
        """Where the master is, or was."""
        return self._uri

    def set_parameter(self, name: str, value: Any) -> None:
        """Set a parameter until the port closes; then it becomes what it was."""
        before = self._rospy.get_param(name, None)
        self._restore = name, before
        self._rospy.set_param(name, value)

    # --- out ---

    def advertise(self, topic: str, kind: str, *, latch: bool = False) -> None:
        """Make a topic to send on."""
        made = message_class(kind)
        self._publishers[topic] = self._rospy.Publisher(topic, made, queue_size=QUEUE, latch=latch), made

    def make(self, kind: str) -> Any:
        """An empty message of `package/Type`."""
        return message_class(kind)()

    def send(self, topic: str, fill: Callable[[Any], None]) -> None:
        """Send a message that `fill` has filled; a slow subscriber holds nobody up."""
        publisher, made = self._publishers[topic]
        message = made()
        fill(message)
        publisher.publish(message)

    def listeners(self, topic: str) -> int:
        """How many listen to a topic that is sent on."""
        return int(self._publishers[topic][0].get_num_connections())

    # --- in ---

    def listen(self, topic: str, kind: str) -> None:
        """Let messages of a topic come into the queue."""

        def put(message: Any) -> None:
            self._inbox.put(Received(topic, time.monotonic(), message))

        self._rospy.Subscriber(topic, message_class(kind), put, queue_size=None, tcp_nodelay=True)

    def receive(self, timeout: float = 0.0) -> Received | None:
        """The next message, waited for at most `timeout` [s]; None where none came."""
        try:
            return self._inbox.get(block=timeout > 0.0, timeout=max(timeout, 0.0) or None)
        except queue.Empty:
            return None

    def serve_set_pose(self, name: str) -> None:
        """Offer the service set_pose; its calls wait in their own queue."""
        kind = set_pose_service()

        def handle(request: Any) -> Any:
            done, wrong = threading.Event(), []

            def answer(fault: str) -> None:
                if fault:
                    wrong.append(fault)
                done.set()

            self._calls.put(Call(request, answer))
            if not done.wait(1.0):
                wrong.append("the node is busy")
            if wrong:
                raise self._rospy.ServiceException(wrong[0])
            return kind._response_class()

        self._rospy.Service(name, kind, handle, error_handler=lambda *_: None)

    def call(self) -> Call | None:
        """The next service call; None where there is none."""
        try:
            return self._calls.get_nowait()
        except queue.Empty:
            return None

    def close(self, why: str) -> None:
        """Leave the graph."""
        self._closed.set()
        logging.disable(logging.CRITICAL)  # rospy's complaints about a master that is gone
        try:
            if self._restore is not None and not self.master_gone.is_set():
                name, before = self._restore
                with warnings.catch_warnings(action="ignore"):
                    if before is None:
                        self._rospy.delete_param(name)
                    else:
                        self._rospy.set_param(name, before)
            self._rospy.signal_shutdown(why)
        except (OSError, KeyError, xmlrpc.client.Error):
            pass
        finally:
            logging.disable(logging.NOTSET)
