"""Which ROS to join and where, and the names that topics have there.

The nodes know topics by the names of a ROS 1 Husky. Here those become the names of the graph that is joined: of another
robot in ROS 1, and in ROS 2 those of Clearpath's robots (clearpath_common: twist_mux.yaml, control.launch.py,
localization.launch.py, branches humble and jazzy).
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from validation.ros.commands import SOURCES, CommandSource, robot_topic

_ROS2_NAMES = {
    "/odometry/filtered": "platform/odom/filtered",
    "/husky_velocity_controller/odom": "platform/odom",
    "/imu/data": "sensors/imu_0/data",
    "/joint_states": "platform/joint_states",
    "/e_stop": "platform/emergency_stop",
}
_ROS2_GLOBAL = {"/clock": "/clock", "/vrpn_client_node/husky/pose": "/vrpn_mocap/husky/pose"}
"""Names that stand outside of a robot's namespace: time, and the node vrpn_mocap."""
_ROS2_SOURCES = (
    CommandSource("/rc_teleop/cmd_vel", 12),
    CommandSource("/joy_teleop/cmd_vel", 10),
    CommandSource("/twist_marker_server/cmd_vel", 8),
    CommandSource("/cmd_vel", 1),
)
"""Sources of Clearpath's robots of ROS 2 (clearpath_control/config/twist_mux.yaml)."""
_MOST_DOMAIN = 232
"""Greatest domain whose ports exist (DDSI-RTPS, 9.6.2: 7400 + 250 each)."""
_NAME = re.compile(r"(/?[A-Za-z][A-Za-z0-9_]*)*", re.ASCII)
_INTERFACE = re.compile(r"[A-Za-z0-9_.:-]*", re.ASCII)


@dataclass(frozen=True)
class Graph:
    """A graph of ROS 1 or ROS 2."""

    ros: int = 1
    """1 or 2."""
    domain: int = 0
    """ROS 2: number of the domain, as ROS_DOMAIN_ID."""
    namespace: str = ""
    """ROS 2: namespace of the robot, such as `a200_0000`; empty for none."""
    interface: str = ""
    """ROS 2: name or address of the network interface; empty for loopback alone, unless CYCLONEDDS_URI says otherwise."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a domain, a namespace or an interface that cannot be, or for one of them with ROS 1."""
        if self.ros not in (1, 2):
            raise ValueError(f"there are ROS 1 and ROS 2, not {self.ros}")
        if self.ros == 1 and (self.domain, self.namespace, self.interface) != (0, "", ""):
            raise ValueError("domain, namespace and interface belong to ROS 2")
        if not 0 <= self.domain <= _MOST_DOMAIN:
            raise ValueError(f"the domain is {self.domain}, must be 0 to {_MOST_DOMAIN}")
        if not _NAME.fullmatch(self.namespace):
            raise ValueError("a namespace has letters, digits and underscores, a letter first, and '/' between its parts")
        if not _INTERFACE.fullmatch(self.interface):
            raise ValueError("an interface is a name such as eth0, or an address")

    def topic(self, topic: str, robot: str) -> str:
        """Return the name on this graph of a topic of the usual robot, for the robot of a name."""
        if self.ros == 1:
            return robot_topic(topic, robot)
        if topic in _ROS2_GLOBAL:
            return robot_topic(_ROS2_GLOBAL[topic], robot)
        return "/".join(["", *self.namespace.split("/"), _ROS2_NAMES.get(topic, topic).lstrip("/")]).replace("//", "/")

    def joint(self, wheel: str) -> str:
        """Return the name of a wheel's joint in joint states and in the robot's description."""
        return f"{wheel}_wheel_joint" if self.ros == 2 else f"{wheel}_wheel"

    @property
    def sources(self) -> tuple[CommandSource, ...]:
        """The topics on which a robot can be commanded."""
        if self.ros == 1:
            return SOURCES
        return tuple(CommandSource(self.topic(s.topic, ""), s.priority, s.timeout) for s in _ROS2_SOURCES)
