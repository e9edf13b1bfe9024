"""Who may command the robot: velocity sources by priority, locks, and what stops it when nobody speaks.

As on a Husky (husky_control: twist_mux.yaml and control.yaml). The multiplexer passes a command on when it comes and no
source of higher priority has spoken within its own time; the wheel controller brakes when nothing was passed on for a while.
No clock and no ROS here: whoever calls says what time it is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

Twist = tuple[float, float]
"""v [m/s] and omega [rad/s]."""

STILL: Twist = (0.0, 0.0)


@dataclass(frozen=True)
class Source:
    """A topic on which somebody may command the robot."""

    topic: str
    """Its name."""
    priority: int
    """The greater one wins."""
    timeout: float = 0.5
    """For how long after a message the source keeps those of lower priority out [s]."""

    def __post_init__(self) -> None:
        """Check the timeout.

        Raises:
            ValueError: it is not positive.
        """
        if not self.timeout > 0.0:
            raise ValueError(f"{self.topic}: the timeout must be positive, got {self.timeout} s")


SOURCES = (
    Source("/joy_teleop/cmd_vel", 10),
    Source("/twist_marker_server/cmd_vel", 8),
    Source("/move_base/cmd_vel", 2),
    Source("/cmd_vel", 1),
)
"""A Husky's (Sec. 3.3; husky_control/config/twist_mux.yaml)."""
LOCK_TOPIC = "/e_stop"
"""True here keeps every source out until False comes (the same file: priority 255, no timeout)."""
BASE_TIMEOUT = 0.25
"""After so long without a command the wheel controller brakes [s] (husky_control/config/control.yaml, cmd_vel_timeout)."""


class CommandGate:
    """Multiplexer and watchdog together: messages in at their times, what the robot is told out."""

    def __init__(self, sources: Sequence[Source] = SOURCES, base_timeout: float = BASE_TIMEOUT) -> None:
        """Begin with a robot that nobody has commanded.

        Args:
            sources: who may command.
            base_timeout: how long a command that was passed on holds [s].

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
        self._twist, self._from, self._since = STILL, "", -math.inf
        self._driving = self._locked = False
        self._news: list[str] = []

    def offer(self, topic: str, twist: Twist, now: float) -> bool:
        """A command that came on `topic` at `now` [s].

        Returns:
            Whether it was passed on: the robot is not locked, no source of higher priority is heard, all numbers are finite.
        """
        source = self._sources[topic]
        if not all(map(math.isfinite, twist)):
            self._news.append(f"{topic} sent {twist}, which is no command: ignored")
            return False
        self._heard[topic] = now
        if self._locked or any(s.priority > source.priority and self._hears(s, now) for s in self._sources.values()):
            return False
        if self._driving and topic != self._from:
            self._news.append(f"{topic} commands now, in the place of {self._from}")
        elif not self._driving:
            self._news.append(f"{topic} commands")
        self._twist, self._from, self._since, self._driving = twist, topic, now, True
        return True

    def _hears(self, source: Source, now: float) -> bool:
        return now - self._heard.get(source.topic, -math.inf) <= source.timeout

    def lock(self, locked: bool, why: str = LOCK_TOPIC) -> None:
        """Let nobody command any more, or somebody again; the news say why."""
        if locked != self._locked:
            self._news.append(f"{why}: the robot brakes, and takes no commands" if locked else f"{why}: released")
        self._locked = locked
        if locked:
            self._driving = False

    def stop(self, why: str) -> None:
        """Brake until the next command; the news say why."""
        if self._driving:
            self._news.append(f"{why}: the robot {'stands' if self._twist == STILL else 'brakes'}")
        self._driving = False

    def command(self, now: float) -> Twist:
        """What the robot is told at `now` [s]: the last command passed on, or to stand where that is too old."""
        if self._driving and now - self._since > self._timeout:
            self.stop(f"nothing on {self._from} for {self._timeout:g} s")
        return self._twist if self._driving else STILL

    def news(self) -> list[str]:
        """What has changed since the last call, in plain words."""
        told, self._news = self._news, []
        return told
