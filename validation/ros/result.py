"""The result of a drive through ROS: that of tracking, and how the drive ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from validation.track.result import TrackResult


class DriveStatus(StrEnum):
    """End of a drive."""

    ARRIVED = "arrived"
    INTERRUPTED = "interrupted"
    STOPPED = "stopped"


@dataclass(frozen=True, eq=False)
class DriveResult(TrackResult):
    """A robot that was driven through ROS, as far as it came."""

    status: DriveStatus = DriveStatus.ARRIVED
    """How the drive ended."""
    why: str = ""
    """Reason why the robot was stopped; empty if it arrived or the user interrupted."""

    def notes(self) -> Sequence[str]:
        """Return the sentences of tracking, and first how a drive ended that did not arrive."""
        if self.status is DriveStatus.ARRIVED:
            return super().notes()
        end = (
            f"The drive ended before the reference did ({self.status}): its path is compared with the whole reference, and "
            "the errors to the moving target cover the time until then."
        )
        return [end, *super().notes()]

    def as_dict(self) -> dict[str, Any]:
        """Return what track.json holds, with `status` and, in `stopped_because`, the reason."""
        return {**super().as_dict(), "status": str(self.status), "stopped_because": self.why}
