"""Say what a log holds, and convert it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

from ssmr.estimation.settings import EkfSettings
from validation.logs.dead_reckoning import commissioned_on, reckon, with_filter
from validation.logs.formats import check_target, losses, read_log
from validation.logs.groups import aligned, cut_groups, merge, smoothed_groups
from validation.logs.health import find_faults
from validation.logs.log import Log, ReadOptions
from validation.logs.offsets import estimate_offsets, synchronised
from validation.logs.recording import Recording, RecordingError
from validation.logs.rest import STOCK, find_rest, unbiased
from validation.plants.filters import LEARNING, THESIS, StateFilter, load_filter, odometry_of
from validation.plants.profile import Profile, choose_profile
from validation.recordings.result import ConvertedLog, LogInfo
from validation.recordings.simulated_log import LogSettings, is_simulated, simulated_log
from validation.simulator.description import WHEELS, Robot, load_robot
from validation.simulator.urdf_writing import urdf_text


@dataclass(frozen=True)
class ConvertSettings:
    """Changes that a conversion makes to a log."""

    rate: float | None = None
    """Samples a second [Hz], where it is another rate than the log's own."""
    smooth: float = 0.0
    """Standard deviation of the Gaussian that smooths measurements [s], if any does."""
    align: bool = False
    """Place the origin of the world at the first pose."""
    unbias: bool = False
    """Take out the gyro's mean at rest."""
    sync: bool = False
    """Take estimated offsets of time out of the measurements; commands stay."""
    ekf: bool = False
    """Let the state filter of wheels and gyro fill x, y and yaw."""
    filter: str | Path = THESIS
    """State filter for that: the `thesis`', with the gyro's bias learned at rest; `learning`; or the path of a TOML file."""
    gps_std: float = 0.0
    """Standard deviation of the log's GPS positions, which that filter takes in by their stamps [m]; 0 takes in none."""
    start: float | None = None
    """Leave out what was logged before this time [s]."""
    stop: float | None = None
    """Leave out what was logged after this time [s]."""

    def __post_init__(self) -> None:
        """Raise a ValueError for a rate that is not positive, or a negative width of smoothing or standard deviation."""
        if self.rate is not None and not 0.0 < self.rate < math.inf:
            raise ValueError(f"rate {self.rate} must be positive [Hz]")
        if not 0.0 <= self.gps_std < math.inf:
            raise ValueError(f"gps_std {self.gps_std} must not be negative [m]")
        if not self.ekf and (self.gps_std or str(self.filter) != THESIS):
            raise ValueError("filter and gps_std are for ekf, which is not asked for")
        if not 0.0 <= self.smooth < math.inf:
            raise ValueError(f"smooth {self.smooth} must not be negative [s]")


def open_log(
    source: str | Path,
    options: ReadOptions | None = None,
    profile: str | Path | Profile | None = None,
    seed: int = 0,
    *,
    robot: str | Path | Robot | None = None,
    faults: LogSettings | None = None,
) -> Log:
    """Read a log, or drive a plant and log it.

    Args:
        source: path of a log, or a drive to be simulated, such as traj4@mujoco.
        options: choices for logs with topics; all guessed if not given.
        profile: profile of the plant that is driven; None for `thesis-lab`, or the robot's own numbers if that is of another
            robot than `robot`.
        seed: seed of its sensors' noise.
        robot: the robot that is driven, its name or its path; None for that of the profile. The dead reckoning on a log uses
            its driver's wheel radius and half-track, a stock Husky's if it is None.
        faults: faults of its log; `LogSettings()` if not given.

    Raises:
        ValueError: the log cannot be opened, or the seed is negative.
        SsmrError: the plant diverged.
    """
    if seed < 0:
        raise ValueError(f"seed {seed} must not be negative")
    if is_simulated(str(source)):
        return Log(Path(source), simulated_log(str(source), choose_profile(profile, robot, "thesis-lab"), seed, faults))
    return read_log(source, options)


def _odometry(robot: str | Path | Robot | None) -> EkfSettings:
    """Return the state filter's settings with the numbers of a robot's driver, a stock Husky's if it is not named."""
    if robot is None:
        return STOCK
    return odometry_of((robot if isinstance(robot, Robot) else load_robot(robot)).drive)


def info(
    source: str | Path,
    options: ReadOptions | None = None,
    profile: str | Path | Profile | None = None,
    seed: int = 0,
    *,
    robot: str | Path | Robot | None = None,
    faults: LogSettings | None = None,
    filter: str | Path = LEARNING,
) -> LogInfo:
    """Say what a log holds: topics or columns, rates, gaps, faults, offsets of time, the gyro's bias, dead reckoning.

    The arguments are those of `open_log`, and a state filter that the thesis' is compared with: `learning`, or the path of a
    TOML file such as `commission_log` saves. Topics that cannot be used are left out and become `LogInfo.log.faults`.

    Raises:
        ValueError: the log cannot be opened.
        SsmrError: the plant diverged.
    """
    log = open_log(source, replace(options or ReadOptions(), lenient=True), profile, seed, robot=robot, faults=faults)
    groups, odometry = log.groups, _odometry(robot)
    used = load_filter(filter, odometry)
    found = reckon(groups, odometry, {f"filter '{used.name}'": used.settings} if used.settings != odometry else {})
    return LogInfo(log, tuple(estimate_offsets(groups)), find_rest(groups), found, find_faults(groups))


def commission_log(
    source: str | Path,
    options: ReadOptions | None = None,
    profile: str | Path | Profile | None = None,
    seed: int = 0,
    *,
    robot: str | Path | Robot | None = None,
) -> StateFilter:
    """Return a state filter that knows the constants of a log's robot, from its wheels and poses of a better sensor.

    The arguments are those of `open_log`. Estimated offsets of time are taken out first.

    Raises:
        ValueError: the log cannot be opened, has no wheels or no poses, or the robot does not move and turn.
        SsmrError: the plant diverged.
    """
    log = open_log(source, options, profile, seed, robot=robot)
    settings = commissioned_on(synchronised(log.groups, tuple(estimate_offsets(log.groups))), _odometry(robot))
    if settings is None:
        raise RecordingError(log.path, "commissioning needs wheels or odometry, and poses x, y, yaw of a better sensor")
    return StateFilter(log.path.stem, settings)


def convert(
    source: str | Path,
    settings: ConvertSettings | None = None,
    options: ReadOptions | None = None,
    profile: str | Path | Profile | None = None,
    seed: int = 0,
    target: str | Path | None = None,
    *,
    robot: str | Path | Robot | None = None,
    faults: LogSettings | None = None,
) -> ConvertedLog:
    """Bring a log onto one clock, and change it as asked; `ConvertedLog.save(path)` writes it in the format of `path`.

    The order is: offsets of time, bias, filter, smoothing, cutting, one clock, alignment. The arguments are those of
    `open_log`, the changes to make, none if `settings` is not given, and the file that the log is meant for: whether it can
    be written there is checked before any work, and the notes say what it will not hold.

    Raises:
        ValueError: the log cannot be opened, does not hold what a change needs, or does not fit into the target.
        SsmrError: the plant diverged.
    """
    wanted = settings or ConvertSettings()
    if target is not None:
        check_target(target, source)
    log = open_log(source, options, profile, seed, robot=robot, faults=faults)
    offsets = tuple(estimate_offsets(log.groups))
    groups = synchronised(log.groups, offsets) if wanted.sync else log.groups
    if wanted.unbias:
        groups = unbiased(log.path, groups)
    if wanted.gps_std and "gps" not in groups:
        raise RecordingError(log.path, "gps_std needs GPS positions, which the log has none of")
    if wanted.ekf:
        filtered = with_filter(groups, load_filter(wanted.filter, _odometry(robot)).settings, wanted.gps_std)
        if filtered is None:
            raise RecordingError(log.path, "ekf needs wheels or odometry, and with an IMU samples of both at the same time")
        groups = filtered
    groups = cut_groups(log.path, smoothed_groups(groups, wanted.smooth), wanted.start, wanted.stop)
    recording = merge(log.path, groups, wanted.rate, log.limits)
    if wanted.align:
        recording = Recording.from_columns(recording.name, aligned(recording.all_columns()), recording.gap_factor)
        groups = {name: replace(g, columns=aligned(g.columns)) for name, g in groups.items()}
    on_one_clock = Log.of_recording(log.path, recording, log.limits)
    known = robot is not None or profile is not None or is_simulated(str(source))
    described = choose_profile(profile, robot, "thesis-lab").robot if known else None
    text = urdf_text(described, {wheel: f"{wheel}_wheel" for wheel in WHEELS}) if described else ""
    own_stamps = on_one_clock if wanted.rate is not None else replace(on_one_clock, groups=groups)
    own_stamps = replace(own_stamps, description=text)
    if target is not None:
        losses(own_stamps, target)
    return ConvertedLog(own_stamps, recording, offsets, wanted.sync, None if target is None else Path(target))
