"""The choice of the command that drives the robot: sources by priority, locks, and a watchdog that brakes without commands.

The rules are those of Clearpath's robots (twist_mux.yaml and control.yaml). The multiplexer passes a command on when no
source of higher priority has spoken within its own timeout; the wheel controller brakes when nothing was passed on for a
while.
This module has no clock and no ROS: the caller gives the time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

Twist = tuple[float, float]
"""v [m/s] and omega [rad/s]."""

STAND_STILL: Twist = (0.0, 0.0)


@dataclass(frozen=True)
class CommandSource:
    """A topic on which the robot can be commanded."""

    topic: str
    priority: int
    """Rank of the source; the greater one wins."""
    timeout: float = 0.5
    """Time after a message for which sources of lower priority are ignored [s]."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a timeout that is not positive."""
        if not self.timeout > 0.0:
            raise ValueError(f"{self.topic}: the timeout must be positive, got {self.timeout} s")


SOURCES = (
    CommandSource("/rc_teleop/cmd_vel", 12),
    CommandSource("/joy_teleop/cmd_vel", 10),
    CommandSource("/twist_marker_server/cmd_vel", 8),
    CommandSource("/cmd_vel", 1),
)
"""Sources of Clearpath's robots (clearpath_control/config/twist_mux.yaml; Sec. 3.3 has the four of its time)."""
LOCK_TOPIC = "/platform/emergency_stop"
"""Topic on which True blocks every source until False comes (twist_mux.yaml: priority 255, no timeout)."""
BASE_TIMEOUT = 0.25
"""Time without a command after which the wheel controller brakes [s] (husky_control/config/control.yaml,
cmd_vel_timeout)."""


def ros_name(robot: str) -> str:
    """Return a robot's name as names of ROS have it: letters, digits and underscores, a letter first."""
    name = "".join(c if c.isascii() and c.isalnum() else "_" for c in robot)
    return name if name[:1].isalpha() else f"robot_{name}"


class CommandGate:
    """Multiplexer and watchdog: takes commands with their times, and gives the command for the robot."""

    def __init__(self, sources: Sequence[CommandSource] = SOURCES, base_timeout: float = BASE_TIMEOUT) -> None:
        """Begin without a command; one that was passed on holds for `base_timeout` [s].

        Raises:
            ValueError: a topic twice, or a timeout that is not positive.
        """
        if len({s.topic for s in sources}) < len(sources):
            raise ValueError(f"a source is named twice: {', '.join(s.topic for s in sources)}")
        if not base_timeout > 0.0:
            raise ValueError(f"the base's timeout must be positive, got {base_timeout} s")
        self._sources = {s.topic: s for s in sources}
        self._timeout = base_timeout
        self._heard: dict[str, float] = {}
        self._twist, self._from, self._since = STAND_STILL, "", -math.inf
        self._driving = self._locked = False
        self._news: list[str] = []

    def offer(self, topic: str, twist: Twist, now: float) -> bool:
        """Take a plausible command that came on `topic` at `now` [s].

        Returns:
            True if it was passed on: the robot is not locked, and no source of higher priority is heard.
        """
        source = self._sources[topic]
        self._heard[topic] = now
        rivals = (s for s in self._sources.values() if s.priority > source.priority)
        if self._locked or any(now - self._heard.get(s.topic, -math.inf) <= s.timeout for s in rivals):
            return False
        if self._driving and topic != self._from:
            self._news.append(f"{topic} commands now, in place of {self._from}")
        elif not self._driving:
            self._news.append(f"{topic} commands")
        self._twist, self._from, self._since, self._driving = twist, topic, now, True
        return True

    def lock(self, locked: bool, why: str = LOCK_TOPIC) -> None:
        """Block all sources, or release them; `why` goes into the news."""
        if locked != self._locked:
            self._news.append(f"{why}: the robot brakes and takes no commands" if locked else f"{why}: released")
        self._locked = locked
        if locked:
            self._driving = False

    def stop(self, why: str) -> None:
        """Brake until the next command; `why` goes into the news."""
        if self._driving:
            self._news.append(f"{why}: the robot {'stands' if self._twist == STAND_STILL else 'brakes'}")
        self._driving = False

    def command(self, now: float) -> Twist:
        """Return the robot's command at `now` [s]: the last one that was passed on, or to stand if that is too old."""
        if self._driving and now - self._since > self._timeout:
            self.stop(f"nothing on {self._from} for {self._timeout:g} s")
        return self._twist if self._driving else STAND_STILL

    def news(self) -> list[str]:
        """Return sentences about the changes since the last call; topics make a limited number of different ones."""
        told, self._news = self._news, []
        return told
