"""The findings of `info` and `convert`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from validation.logs.dead_reckoning import Reckoning
from validation.logs.formats import check_apart, losses, write_log
from validation.logs.groups import Group
from validation.logs.health import LogHealth
from validation.logs.log import Log
from validation.logs.offsets import Offset
from validation.logs.recording import Recording
from validation.logs.rest import Rest
from validation.recordings.table import group_grid, health_grid, log_notes, offset_grid, reckoning_grid, topic_grid
from validation.report.tables import Grid, text_tables
from validation.store import versions, write_json, write_text


@dataclass(frozen=True, eq=False)
class LogInfo:
    """Contents of a log."""

    log: Log
    offsets: tuple[Offset, ...]
    """Delays between its groups."""
    rest: Rest | None
    """Readings of its gyro at rest; None where they are unknown."""
    reckoning: Reckoning | None
    """Ways of dead reckoning; None where the log allows none."""
    health: LogHealth
    """Faults of the log."""

    def grids(self) -> Sequence[Grid]:
        """Return its tables: topics or groups, faults, offsets of time, dead reckoning."""
        log = self.log
        first = topic_grid(log.path.name, log.topics) if log.topics else group_grid(log.path.name, log.groups)
        others = (health_grid(self.health), offset_grid(self.offsets), reckoning_grid(self.reckoning))
        return [first, *(grid for grid in others if grid is not None)]

    def notes(self) -> Sequence[str]:
        """Return sentences about clocks, gaps and the gyro at rest, and about numbers that are hard to believe."""
        return [*log_notes(self.log, self.rest), *self.health.implausible]

    def table(self, width: int = 110) -> str:
        """Return its tables and notes as text of at most `width` columns."""
        return text_tables(self.grids(), [*self.log.faults, *self.notes()], width)

    def as_dict(self) -> dict[str, Any]:
        """Return what its JSON file holds; null stands for what is unknown."""
        found, jumps = self.health, self.health.jumps
        seconds = {offset.behind: 0.0 for offset in self.offsets} | {offset.late: offset.seconds for offset in self.offsets}
        return {
            "schema": "ssmr.info/1",
            "source": str(self.log.path),
            "groups": {name: _group_entry(group) for name, group in self.log.groups.items()},
            "offsets_s": {name: seconds.get(name) for name in ("wheels", "pose_yaw", "position")},
            "offsets": [asdict(offset) for offset in self.offsets],
            "pose_jumps": None if jumps is None else len(jumps.t),
            "pose_jumps_at_s": None if jumps is None else jumps.t.tolist(),
            "pose_jumps_m": None if jumps is None else jumps.metres.tolist(),
            "pose_jumps_rad": None if jumps is None else jumps.radians.tolist(),
            "uncommanded_share": found.uncommanded_share,
            "dead_columns": list(found.dead_columns),
            "implausible": list(found.implausible),
            "gyro_at_rest": None if self.rest is None else asdict(self.rest),
            "dead_reckoning": None if self.reckoning is None else asdict(self.reckoning),
            "notes": [*self.log.faults, *self.notes()],
            "versions": versions(),
        }

    def save(self, path: str | Path) -> Path:
        """Write the findings as JSON, whole or not at all; return the path.

        Raises:
            ValueError: `path` is a folder, the log itself or a part of it.
            OSError: the file cannot be written.
        """
        path = Path(path)
        check_apart(path, self.log.path)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, self.as_dict())
        return path


def _group_entry(group: Group) -> dict[str, Any]:
    return {
        "source": group.source,
        "samples": len(group.t),
        "rate_hz": 1.0 / group.period,
        "from_s": float(group.t[0]),
        "to_s": float(group.t[-1]),
        "columns": list(group.columns),
        "gaps_s": [list(gap) for gap in group.gaps()],
    }


@dataclass(frozen=True, eq=False)
class ConvertedLog:
    """A log after a conversion."""

    log: Log
    """Groups with their own stamps, or on one clock where a rate was asked for."""
    recording: Recording
    """The log on one clock."""
    offsets: tuple[Offset, ...]
    """Delays between the groups of the log before the conversion."""
    synchronised: bool
    """True if these delays were taken out."""
    target: Path | None = None
    """File that it is meant for; None if that is not known yet."""

    def grids(self) -> Sequence[Grid]:
        """Return the table of offsets, where there are any."""
        grid = offset_grid(self.offsets)
        return [] if grid is None else [grid]

    def notes(self) -> Sequence[str]:
        """Return sentences about the recording, offsets that were taken out, and what the target does not hold of it."""
        r = self.recording
        names = ", ".join((*r.columns, *r.channels))
        summary = f"{len(r)} samples, {r.t[0]:.3f} to {r.t[-1]:.3f} s, {1.0 / r.period:.2f} Hz: {names}"
        taken = "the offsets of time were taken out of the measurements; commands stay as they were"
        lost = () if self.target is None else losses(self.log, self.target)
        return [summary, *([taken] if self.synchronised and self.offsets else []), *lost]

    def table(self, width: int = 110) -> str:
        """Return its tables and notes as text of at most `width` columns."""
        return text_tables(self.grids(), self.notes(), width)

    def save(self, path: str | Path) -> Path:
        """Write a recording (.csv), a TUM trajectory (.tum), a ROS 2 bag (.mcap) or a ROS 1 bag (.bag); return its path.

        Beside a ROS 2 bag lies a layout for Foxglove then, `drive.foxglove.json` beside `drive.mcap`.

        Raises:
            ValueError: no format has that ending, `path` is a folder, the log itself or a part of it, or the log lacks what
                a format needs.
            OSError: the file cannot be written.
        """
        path = Path(path)
        write_log(self.log, path)
        if path.suffix.lower() == ".mcap":
            layout = Path(__file__).with_name("foxglove.json").read_text(encoding="utf-8")
            write_text(path.with_suffix(".foxglove.json"), layout)
        return path
