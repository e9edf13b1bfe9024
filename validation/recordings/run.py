"""`python -m validation.recordings info|convert SOURCE`: what a log holds; a log as a recording, a trajectory or a bag."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from validation import cli
from validation.logs.bag_recording import as_group, groups_of_bag
from validation.logs.bags import ENDINGS, Bag, Stamps, Stream, choose_topics, is_bag, read_bag
from validation.logs.dead_reckoning import with_filter
from validation.logs.export import write_bag, write_tum
from validation.logs.recording import Recording, RecordingError, read_csv, write_csv
from validation.logs.signals import (
    Group,
    groups_of,
)
from validation.plants.profile import load
from validation.recordings.simulated_log import is_simulated, simulated_log

FORMATS = (".csv", ".tum", ".mcap", ".bag")
"""What can be written, by ending."""


@dataclass(frozen=True, eq=False)
class Log:
    """A log that was opened."""

    path: Path
    """What the user named."""
    groups: Mapping[str, Group]
    """What it holds."""
    bag: Bag | None = None
    """Where it is a bag."""
    chosen: Mapping[str, Stream] | None = None
    """Which topics were taken for what."""
    faults: Sequence[str] = ()
    """Of topics that were left out for it."""


def open_log(source: str, topics: str, stamps: Stamps, profile: str, seed: int, *, lenient: bool = False) -> Log:
    """What SOURCE means.

    Args:
        source: path of a recording, or a drive to be simulated, such as traj4@mujoco.
        topics: ROLE=TOPIC, comma-separated.
        stamps: which clock of a bag counts.
        profile: of the plant that is driven.
        seed: of its sensors' noise.
        lenient: leave out topics that make no group, and say so in `faults`.

    Raises:
        ValueError: it cannot be opened.
        SsmrError: the plant diverged.
    """
    path, named = Path(source), parse_topics(topics)
    if is_simulated(source):
        return Log(path, simulated_log(source, load(profile), seed))
    if path.suffix.lower() == ".csv" and not path.is_dir():
        if named:
            raise cli.UserError(f"--topics names topics of bags; {source} is a CSV file, whose columns have names")
        return Log(path, groups_of(read_csv(path), path.name))
    if not path.exists() or path.is_dir() or is_bag(path):
        bag = read_bag(path, stamps)
        chosen = choose_topics(bag, named)
        if not lenient:
            return Log(path, groups_of_bag(bag, chosen), bag, chosen)
        groups, faults = {}, []
        for role, stream in chosen.items():
            try:
                groups[role] = as_group(bag, role, stream, "pose" in chosen)
            except RecordingError as error:
                faults.append(str(error))
        return Log(path, groups, bag, chosen, faults)
    raise cli.UserError(f"{source}: recordings are .csv, .bag, .mcap, or the folder of a ROS 2 bag")


def parse_topics(text: str) -> dict[str, str]:
    """`role=/topic,role=/topic` as a mapping.

    Raises:
        UserError: something else.
    """
    found: dict[str, str] = {}
    for part in filter(None, (p.strip() for p in text.split(","))):
        role, equals, topic = (s.strip() for s in part.partition("="))
        if not equals or not topic or role in found:
            raise cli.UserError(
                f"--topics '{part}' is no ROLE=TOPIC of its own, such as odom=/husky_velocity_controller/odom"
            )
        found[role] = topic
    return found


def _check(target: Path, rate: float | None, smooth: float, seed: int) -> None:
    if target.suffix.lower() not in FORMATS:
        raise cli.UserError(f"--out {target}: no format has the ending '{target.suffix}'; there are: {', '.join(FORMATS)}")
    if target.is_dir():
        raise cli.UserError(f"--out {target} is a folder; name a file")
    if rate is not None and not 0.0 < rate < float("inf"):
        raise cli.UserError(f"--rate {rate} must be positive [Hz]")
    if not 0.0 <= smooth < float("inf"):
        raise cli.UserError(f"--smooth {smooth} must not be negative [s]")
    if seed < 0:
        raise cli.UserError(f"--seed {seed} must not be negative")


def _filtered(path: Path, groups: Mapping[str, Group]) -> Mapping[str, Group]:
    found = with_filter(groups)
    if found is None:
        raise RecordingError(path, "--ekf needs wheels or odometry, and with an IMU samples of both at the same time")
    return found


def _columns(recording: Recording) -> dict[str, Any]:
    return {"t": recording.t, **recording.columns, **recording.channels}


def _write(recording: Recording, groups: Mapping[str, Group], target: Path) -> None:
    ending = target.suffix.lower()
    if ending in ENDINGS:
        write_bag(groups, target)
    elif ending == ".tum":
        write_tum(recording, target)
    else:
        write_csv(recording, target)


def _summary(recording: Recording) -> str:
    names = ", ".join((*recording.columns, *recording.channels))
    span = f"{recording.t[0]:.3f} to {recording.t[-1]:.3f} s"
    return f"{len(recording)} samples, {span}, {1.0 / recording.period:.2f} Hz: {names}"
