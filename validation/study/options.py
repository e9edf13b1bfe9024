"""Options that studies share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, get_args

from ssmr.metrics.poses import horizon_windows
from ssmr.parameters import MOST_SEED, require_within
from ssmr.types import CommandKind
from validation import cli
from validation.bench.sources import Source, open_source
from validation.identify.targets import MOST_TIME
from validation.plants.profile import Profile, choose_profile

HORIZON = 6.0
"""Length of the windows over which errors against a recording are taken [s]."""


AS_NAMES = get_args(cli.Names)[1]
"""Annotation of an option that the command line reads as comma-separated names, whatever it may be in Python."""
MOST_RUNS = 100_000
"""Greatest number of seeds, and of runs, of one study."""


def require_seeds(options: object) -> None:
    """Check the `seed` and the number of `seeds` of a study's options; others are counted from the seed.

    Raises:
        ValueError: `seed` is negative or too great, or `seeds` is not positive or too great.
    """
    require_within(options, ("seed",), 0, MOST_SEED - 2 * MOST_RUNS, whole=True)
    require_within(options, ("seeds",), 1, MOST_RUNS, whole=True)


@dataclass(frozen=True, kw_only=True)
class AnyStudy(cli.Common):
    """Options of every study."""

    def folder(self) -> Path:
        """Return the folder that the files are written to."""
        return Path("runs") / "study" / type(self).__module__.rpartition(".")[2]


@dataclass(frozen=True, kw_only=True)
class StudyOptions(AnyStudy):
    """Options of every study of one robot."""

    profile: Annotated[cli.AnyProfile, cli.profile_option("thesis-lab")] = None
    robot: cli.AnyRobot = None

    def robot_profile(self) -> Profile:
        """Return the profile.

        Raises:
            ValueError: there is none of that name, its numbers are wrong, or it is of another robot.
        """
        return choose_profile(self.profile, self.robot, "thesis-lab")


@dataclass(frozen=True, kw_only=True)
class RecordedOptions(StudyOptions):
    """Options of studies of a robot of the lab, and of a recorded one where there is a recording."""

    recording: Annotated[str | None, cli.option(metavar="PATH", default="none")] = None
    """Path of a real robot's recording (.csv, or a bag) with wheel rates; it adds columns."""
    recording_profile: Annotated[cli.AnyProfile, cli.profile_option("husky-tile")] = None
    start: Annotated[cli.Number, cli.option("from", metavar="SECONDS", default="the beginning")] = None
    """Leave out what was recorded before this time [s]."""
    until: Annotated[cli.Number, cli.option(metavar="SECONDS", default="the end")] = None
    """Leave out what was recorded after this time [s]."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a time without a recording, or out of range."""
        require_within(self, ("start", "until"), -MOST_TIME, MOST_TIME)
        if self.recording is None and (self.start is not None or self.until is not None):
            raise ValueError("start (--from) and until cut a recording; name one as recording")

    def opened(self, *kinds: CommandKind) -> tuple[Profile | None, list[Source]]:
        """Return the robot of the recording, and the recording driven by each kind of input; None and nothing without one.

        Raises:
            ValueError: profile or recording do not exist, or the recording is a scenario or has no window of 6 s.
        """
        if self.recording is None:
            return None, []
        recorded = choose_profile(self.recording_profile, self.robot, "husky-tile")
        sources = [open_source(self.recording, kind, self.start, self.until) for kind in kinds]
        if any(source.reference != "recording" for source in sources):
            raise ValueError(f"recording '{self.recording}' is a scenario; wanted the path of a recording")
        if not any(p.t is not None and len(p.windows(horizon_windows, p.t, HORIZON)[0]) for p in sources[0].pieces):
            raise ValueError(f"{sources[0].name} has no stretch of {HORIZON:g} s without a gap or a jump of the localiser")
        return recorded, sources
