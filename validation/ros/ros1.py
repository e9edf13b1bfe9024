"""A port on a ROS 1 graph: the only module that knows rospy, which is imported when a port opens.

rospy is not on PyPI. On Debian 12 apt installs it for the system's Python 3.11, where a virtual environment of the same
version finds it too; the environment's own packages go first.
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
import xmlrpc.client  # nosec B411 # of the ROS master, whom the robot obeys; expat limits what entities grow to
from collections.abc import Callable
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from types import ModuleType
from typing import Any
from urllib.parse import urlsplit
from xml.parsers.expat import ExpatError

from validation.ros.graph import Graph
from validation.ros.inbox import Notices
from validation.ros.port import BREATH, Call, NoGraphError, Port
from validation.words import one_line

_SYSTEM_PACKAGES = Path("/usr/lib/python3/dist-packages")
"""Folder into which Debian installs rospy."""
APT_PACKAGES = (
    "ros-core python3-rospy python3-nav-msgs python3-geometry-msgs python3-sensor-msgs python3-tf2-msgs python3-std-srvs"
)
"""Packages to install with apt."""
_DEBIANS_PYTHON = (3, 11)
"""Version of Python for which they are."""
_QUEUE = 10
"""Messages of one topic that wait for a slow subscriber."""
SIM_TIME_PARAMETER = "/use_sim_time"
_LOOPBACK = "127.0.0.1"
_MASTER_PERIOD = 0.1
"""Period at which the master is asked for a sign of life [s]."""
_MASTER_PATIENCE = 0.25
"""Time within which it must answer [s]; ten times that at the start."""
_REFUSED, _SILENT, _GONE = 2, 1, 4
"""Weight of a refused question, weight of one without an answer in time, and the sum at which the master counts as gone:
after two refusals, 0.2 s, or four silences, 1.4 s. A busy machine is silent at times; if it cuts off its peers as well,
these notice within 0.5 s."""


def _here() -> tuple[int, ...]:
    """Return the version of Python that runs this."""
    return sys.version_info[:3]


def load_rospy() -> ModuleType:
    """Return rospy, from this environment or the system's.

    Raises:
        NoGraphError: it is not installed, or for another version of Python.
    """
    if importlib.util.find_spec("rospy") is None and str(_SYSTEM_PACKAGES) not in sys.path:
        sys.path.append(str(_SYSTEM_PACKAGES))  # last: what this environment has itself goes first
    try:
        with warnings.catch_warnings(action="ignore"):  # of packages as old as ROS 1
            for name in ("rosgraph", "nav_msgs.msg", "geometry_msgs.msg", "sensor_msgs.msg", "tf2_msgs.msg", "std_srvs.srv"):
                importlib.import_module(name)
            return importlib.import_module("rospy")
    except ImportError as error:
        here = _here()[:2]
        other = (
            "" if here == _DEBIANS_PYTHON else "; they are for Python {}.{}, this is {}.{}".format(*_DEBIANS_PYTHON, *here)
        )
        raise NoGraphError(
            f"ROS 1 is not there ({error}); on Debian 12: apt-get install --no-install-recommends {APT_PACKAGES}{other}"
        ) from None


def message_class(kind: str) -> type[Any]:
    """Return the class of `package/Type`; `load_rospy` must have been called."""
    package, _, name = kind.partition("/")
    found: type[Any] = getattr(importlib.import_module(f"{package}.msg"), name)
    return found


def set_pose_service() -> type[Any]:
    """Return robot_localization's service type SetPose.

    Debian does not package robot_localization. A type with the same name and checksum, made here, is the same on the wire:
    its request is one PoseWithCovarianceStamped, its answer is empty.
    """
    if importlib.util.find_spec("robot_localization") is not None:
        found: type[Any] = importlib.import_module("robot_localization.srv").SetPose
        return found
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
"""Checksum of the service's definition as genmsg computes it; a test repeats that."""


class _Impatient(xmlrpc.client.Transport):
    """HTTP with a limited time to connect and to answer."""

    def __init__(self, patience: float) -> None:
        super().__init__()
        self._patience = patience

    def make_connection(self, host: Any) -> HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = self._patience
        return connection


def ask_master(uri: str, caller: str, patience: float) -> int:
    """Return the process id of a ROS master.

    Raises:
        TimeoutError: it did not answer in time.
        OSError: nothing answers there, or not as a master does.
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


def stay_on_loopback(master: str) -> None:
    """Let rospy listen on loopback alone where the master is there, and neither ROS_IP nor ROS_HOSTNAME says otherwise."""
    told = os.environ.get("ROS_IP") or os.environ.get("ROS_HOSTNAME")
    host = urlsplit(master).hostname or ""
    if not told and (host in ("localhost", "::1") or host.startswith("127.")):
        os.environ["ROS_IP"] = _LOOPBACK


class _Complaints(logging.Handler):
    """What rospy complains of, often with a traceback and once for each message: the last line of it, as a notice."""

    def __init__(self, notices: Notices) -> None:
        super().__init__(logging.WARNING)
        self._notices = notices

    def emit(self, record: logging.LogRecord) -> None:
        lines = [line for line in record.getMessage().splitlines() if line.strip()]
        self._notices.add("ROS", f"ROS: {one_line(lines[-1] if lines else record.name)}")


class Ros1Port(Port):
    """Topics and services of a node of ROS 1."""

    def __init__(self, name: str, graph: Graph | None = None) -> None:
        """Register a node.

        Raises:
            NoGraphError: rospy is missing, or no master answers.
        """
        self._rospy = load_rospy()
        super().__init__(graph or Graph())
        self.master = os.environ.setdefault("ROS_MASTER_URI", "http://localhost:11311")
        """Address of the master."""
        stay_on_loopback(self.master)
        self._id = f"/{name}"
        try:
            self.master_pid = ask_master(self.master, self._id, 10.0 * _MASTER_PATIENCE)
        except OSError:
            raise NoGraphError(
                f"no ROS master answers at {self.master}: start one with roscore, or set ROS_MASTER_URI to where it is"
            ) from None
        root = logging.getLogger()
        handlers, level = root.handlers[:], root.level
        with warnings.catch_warnings(action="ignore"):
            self._rospy.init_node(name, disable_signals=True, disable_rosout=True)
        root.handlers[:] = handlers
        root.setLevel(level)
        for name in ("rospy", "rosout", "rosgraph"):
            (logger := logging.getLogger(name)).handlers[:] = [_Complaints(self.notices)]
            logger.propagate = False
        self._publishers: dict[str, tuple[Any, type[Any]]] = {}
        self._restore: tuple[str, Any] | None = None
        self._closed = threading.Event()
        threading.Thread(target=self._watch_master, daemon=True).start()

    def _watch_master(self) -> None:
        doubt = 0
        while not self._closed.wait(_MASTER_PERIOD):
            try:
                same = ask_master(self.master, self._id, _MASTER_PATIENCE) == self.master_pid
                doubt = 0 if same else doubt + _REFUSED
            except TimeoutError:
                doubt += _SILENT
            except OSError:
                doubt += _REFUSED
            if doubt >= _GONE:
                self.master_gone.set()
            elif doubt == 0:
                self.master_gone.clear()

    def simulate_time(self) -> None:
        """Set /use_sim_time until the port closes; then its old value comes back."""
        self._restore = SIM_TIME_PARAMETER, self._rospy.get_param(SIM_TIME_PARAMETER, None)
        self._rospy.set_param(SIM_TIME_PARAMETER, True)

    def advertise(self, topic: str, kind: str, *, latch: bool = False) -> None:
        """Open a topic for sending."""
        made = message_class(kind)
        self._publishers[topic] = self._rospy.Publisher(topic, made, queue_size=_QUEUE, latch=latch), made

    def make(self, kind: str) -> Any:
        """Return an empty message of `package/Type`."""
        return message_class(kind)()

    def send(self, topic: str, fill: Callable[[Any], None]) -> None:
        """Send a message that `fill` has filled, without waiting for slow subscribers."""
        publisher, made = self._publishers[topic]
        fill(message := made())
        publisher.publish(message)

    def listeners(self, topic: str) -> int:
        """Return the number of listeners of a topic that is open for sending."""
        return int(self._publishers[topic][0].get_num_connections())

    def listen(self, topic: str, kind: str, read: Callable[[Any], Any] = lambda m: m, depth: int | None = None) -> None:
        """Let the messages of a topic come into the inbox; a thread receives them and rests after each."""
        self.inbox.open(topic, read, depth)

        def put(message: Any) -> None:
            self.inbox.put(topic, message)
            if depth is not None:
                time.sleep(BREATH)

        self._rospy.Subscriber(topic, message_class(kind), put, queue_size=depth, tcp_nodelay=True)

    def serve_set_pose(self, name: str, read: Callable[[Any], Any]) -> None:
        """Offer the service set_pose; its calls, as `read` returns their pose, wait in a queue of their own."""
        kind = set_pose_service()

        def handle(request: Any) -> Any:
            done, wrong = threading.Event(), []

            def answer(fault: str) -> None:
                if fault:
                    wrong.append(fault)
                done.set()

            try:
                self.calls.put_nowait(Call(read(request.pose), answer))
            except ValueError as error:
                self.notices.add(f"service {name}", f"service {name}: {error}; refused")
                answer(str(error))
            except queue.Full:
                answer("the node is busy")
            if not done.wait(1.0):
                wrong.append("the node is busy")
            if wrong:
                raise self._rospy.ServiceException(wrong[0])
            return kind._response_class()

        self._rospy.Service(name, kind, handle, error_handler=lambda *_: None)

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
