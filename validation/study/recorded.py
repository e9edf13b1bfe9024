"""Options of studies that take a real robot's recording beside the robot of the lab."""

from __future__ import annotations

from dataclasses import dataclass

from ssmr.parameters import require_within
from ssmr.types import CommandKind
from validation.fit.targets import MOST_TIME
from validation.motion.sources import Source, open_source
from validation.plants.profile import Profile
from validation.simulator.description import Robot
from validation.study.result import profile_of


@dataclass(frozen=True, kw_only=True)
class RecordedOptions:
    """Options of studies of a robot of the lab, and of a recorded one where there is a recording."""

    profile: str | Profile | None = None
    """Robot of the lab: name of a shipped profile, or path of a TOML file."""
    recording: str | None = None
    """Path of a real robot's recording (.csv, or a bag) with wheel rates; it adds columns."""
    recording_profile: str | Profile | None = None
    """Robot of the recording: name of a shipped profile, or path of a TOML file; if none is named, husky-tile."""
    start: float | None = None
    """Leave out what was recorded before this time [s]."""
    until: float | None = None
    """Leave out what was recorded after this time [s]."""
    robot: str | Robot | None = None
    """Robot: its name or the path of its file; the profile's if none is named."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a time without a recording, or out of range."""
        require_within(self, ("start", "until"), -MOST_TIME, MOST_TIME)
        if self.recording is None and (self.start is not None or self.until is not None):
            raise ValueError("start (--from) and until cut a recording; name one as recording")

    def opened(self, *kinds: CommandKind) -> tuple[Profile, Profile | None, list[Source]]:
        """Return the robot of the lab, that of the recording, and the recording driven by each kind of input.

        Raises:
            ValueError: profile or recording do not exist, or the recording is a scenario.
        """
        lab = profile_of(self.profile, self.robot)
        if self.recording is None:
            return lab, None, []
        recorded = profile_of(self.recording_profile, self.robot, "husky-tile")
        sources = [open_source(self.recording, kind, self.start, self.until) for kind in kinds]
        if any(source.reference != "recording" for source in sources):
            raise ValueError(f"recording '{self.recording}' is a scenario; wanted the path of a recording")
        return lab, recorded, sources
