"""Which graph of ROS 2 to join, and the names that topics have there.

Topics have the names of Clearpath's robots (clearpath_common: twist_mux.yaml, control.launch.py, localization.launch.py,
branches humble and jazzy), before which a namespace may stand.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from validation.ros.commands import SOURCES, CommandSource, ros_name
from validation.simulator.description import USUAL_ROBOT

_CLOCK_TOPIC = "/clock"
_TRACKING = "/vrpn_mocap/"
"""Beginning of the names of the node vrpn_mocap, which stands outside of a robot's namespace."""
_MOST_DOMAIN = 232
"""Greatest domain whose ports exist (DDSI-RTPS, 9.6.2: 7400 + 250 each)."""
_NAME = re.compile(r"(/?[A-Za-z][A-Za-z0-9_]*)*", re.ASCII)
_INTERFACE = re.compile(r"[A-Za-z0-9_.:-]*", re.ASCII)


@dataclass(frozen=True)
class Graph:
    """A graph of ROS 2."""

    domain: int = 0
    """Number of the domain, as ROS_DOMAIN_ID."""
    namespace: str = ""
    """Namespace of the robot, such as `a200_0000`; empty for none."""
    interface: str = ""
    """Name or address of the network interface; empty for loopback alone, unless CYCLONEDDS_URI says otherwise."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a domain, a namespace or an interface that cannot be."""
        if not 0 <= self.domain <= _MOST_DOMAIN:
            raise ValueError(f"the domain is {self.domain}, must be 0 to {_MOST_DOMAIN}")
        if not _NAME.fullmatch(self.namespace):
            raise ValueError("a namespace has letters, digits and underscores, a letter first, and '/' between its parts")
        if not _INTERFACE.fullmatch(self.interface):
            raise ValueError("an interface is a name such as eth0, or an address")

    def topic(self, topic: str, robot: str) -> str:
        """Return the name on this graph of a topic of the usual robot, for the robot of a name."""
        if topic == _CLOCK_TOPIC:
            return topic
        if topic.startswith(_TRACKING):
            return topic.replace(f"/{USUAL_ROBOT}/", f"/{ros_name(robot)}/")
        return "/".join(["", *self.namespace.split("/"), topic.lstrip("/")]).replace("//", "/")

    def joint(self, wheel: str) -> str:
        """Return the name of a wheel's joint in joint states and in the robot's description."""
        return f"{wheel}_wheel_joint"

    @property
    def sources(self) -> tuple[CommandSource, ...]:
        """The topics on which a robot can be commanded."""
        return tuple(CommandSource(self.topic(s.topic, ""), s.priority, s.timeout) for s in SOURCES)
