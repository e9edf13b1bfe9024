"""A log that was read, and the description of a file format that logs come in."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from ssmr.types import FloatArray
from validation.logs.groups import Group, groups_of, merge
from validation.logs.limits import USUAL, LogLimits
from validation.logs.recording import Recording

Stamps = Literal["header", "bag"]


@dataclass(frozen=True)
class ReadOptions:
    """Choices for formats with topics; a format without topics ignores them or refuses them."""

    topics: Mapping[str, str] = field(default_factory=dict)
    """Topic of each role (cmd, odom, wheels, imu, pose, gps), or `none`; roles that are not named are guessed."""
    stamps: Stamps = "header"
    """Clock that counts: `header`, when a message was measured, or `bag`, when it was written."""
    lenient: bool = False
    """Leave out topics that cannot be used, and say so in `Log.faults`, instead of raising an error."""
    limits: LogLimits = USUAL
    """Greatest sizes and numbers that a log may have."""


@dataclass(frozen=True, eq=False)
class Topic:
    """A topic of a log, for a table of what the log holds."""

    name: str
    type: str
    t: FloatArray
    """(M,) stamps [s]; zeros where the topic cannot be read."""
    columns: tuple[str, ...] | None
    """Names of its columns; None where the topic cannot be read."""
    role: str = ""
    """Role that it is taken for; empty for none."""


@dataclass(frozen=True, eq=False)
class Log:
    """A log that was read."""

    path: Path
    """File that the user named; the recording is called after it."""
    groups: Mapping[str, Group]
    """Columns by group, each group with its own stamps."""
    merged: Recording | None = None
    """The log on one clock, for a format whose files have one; else `recording` makes it."""
    topics: Sequence[Topic] = ()
    """Topics of the file, where its format has any."""
    remarks: Sequence[str] = ()
    """Sentences about the file's clocks."""
    faults: Sequence[str] = ()
    """Sentences about topics that were left out."""
    limits: LogLimits = USUAL
    """Limits that it was read with; they hold for its recording as well."""
    description: str = ""
    """URDF of its robot, which goes into bags; empty where it is not known."""

    @classmethod
    def of_recording(cls, path: Path, recording: Recording, limits: LogLimits = USUAL) -> Log:
        """Return a recording as a log: all groups share its clock."""
        return cls(path, groups_of(recording, path.name), recording, limits=limits)

    def recording(self) -> Recording:
        """Return the log on one clock.

        Raises:
            RecordingError: the groups do not overlap, leave nothing between their gaps, hold no known column, or make more
                samples than the limits allow.
        """
        return merge(self.path, self.groups, limits=self.limits) if self.merged is None else self.merged


@dataclass(frozen=True)
class LogFormat:
    """A file format of logs. To add one, write such a value in a module of its own and list it in `formats.FORMATS`."""

    name: str
    """Name in messages, such as `CSV recording`."""
    endings: tuple[str, ...]
    """Endings of its files, in lower case, such as `.csv`."""
    read: Callable[[Path, ReadOptions], Log] | None = None
    """Function that reads such a file into a `Log` and raises `RecordingError`, with the place of the fault, if it cannot;
    None for a format that is only written. A format with one clock returns `Log.of_recording(path, recording)`."""
    write: Callable[[Log, Path], None] | None = None
    """Function that writes a log whole or not at all; None for a format that is only read."""
    losses: Callable[[Log, Path], Sequence[str]] | None = None
    """Function that returns sentences about what such a file would not hold of a log, or hold under other names, and raises
    ValueError if it cannot hold the log; None for a format that holds everything."""
    folder: str = ""
    """Name of the folders that are read as well, such as `the folder of a ROS 2 bag`; empty where only files are."""

    def recognises(self, path: Path) -> bool:
        """Return whether a path looks like this format: by its ending, or as a folder."""
        return bool(self.folder) if path.is_dir() else path.suffix.lower() in self.endings
