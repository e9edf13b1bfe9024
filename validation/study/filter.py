"""How fast the pose drifts that the state filter estimates from wheels and gyro (docs/filter.md).

A regulator that sees the true state keeps MuJoCo's robot on a reference, and the filters only listen. Errors are those of
the pose relative to the beginning of a stretch of `DRIFT_STRETCH`, because on a path that closes an error of scale returns
to nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ssmr.control.loop import LoopSettings, make_clock
from ssmr.control.waypoints import Waypoints
from ssmr.estimation.ekf import run_ekf
from ssmr.estimation.settings import EkfSettings, zeroed
from ssmr.geometry import relative, travelled, wrap_angle
from ssmr.parameters import require_in_range, require_within
from ssmr.robot.sensors import STANDS, SensorModel, gyro_at_rest, simulate_sensors
from ssmr.types import FloatArray, State, Trajectory
from validation import cli
from validation.bench.gains import DEFAULT, load_gains
from validation.bench.loops import TRACKER, ClosedLoopRobot, commissioned, make_controller, require_practicable, run_robots
from validation.bench.waypoint_files import open_reference
from validation.plants.filters import odometry_of
from validation.plants.profile import Profile, choose_profile
from validation.report import drawing
from validation.report.report import Report
from validation.report.table import Row, Table
from validation.simulator.plant import MujocoPlant
from validation.study.options import AS_NAMES, AnyStudy, require_seeds
from validation.study.sweep import picture, sweep

DRIFT_STRETCH = 3.0
"""Length of a stretch over which relative errors are taken [m]: 12 s at 0.25 m/s."""
REAL_BIAS = -0.0156
"""Bias of a real Husky's gyro on tile [rad/s]."""
_CURVE = 161  # samples of an error over the distance, from 0 to the end of the drive
_LEAST_TURN = 1e-3  # a robot that turns by less has no yaw drift per radian [rad]
_TICK = 0.01  # period of the tracker, and of the truth's samples [s]: two of them are the filter's 20 ms


@dataclass(frozen=True, kw_only=True)
class FilterStudy(AnyStudy):
    """Options of the study of dead reckoning."""

    references: Annotated[cli.Names, cli.option()] = ("sine", "circle")
    """References to drive: line, circle, sine, generic, or paths of waypoint files."""
    speed: float = 0.25
    """Speed of the references [m/s]."""
    profiles: Annotated[
        tuple[str | Profile, ...], AS_NAMES, cli.option(metavar="PROFILE,...", default="thesis-lab and husky-tile")
    ] = ()
    """Robots on their grounds: names of shipped profiles or paths of TOML files."""
    frictions: Annotated[cli.Numbers, cli.option()] = (0.3, 0.6, 0.9)
    """Further frictions for the last profile's robot [1]."""
    bias: float = REAL_BIAS
    """Bias of the biased gyro [rad/s]."""
    stands: float = STANDS
    """Time for which the robot stands before a drive, while a filter that learns listens to its gyro [s]."""
    seeds: int = 20
    """Number of draws of the sensors' noise."""
    timestep: float = 0.002
    """Physics step [s]."""
    robot: cli.AnyRobot = None

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            ValueError: no references or seeds, an unknown name, a bias that is no number, or a step out of its range.
        """
        require_seeds(self)
        if not self.references:
            raise ValueError("references names none; name one, such as sine")
        require_within(self, ("bias",), -100.0, 100.0)
        require_within(self, ("speed",), 1e-3, 100.0)
        require_in_range(self, "stands", 0.0, 1000.0)
        require_in_range(self, "timestep", 1e-5, 0.01)


class FilterGround(NamedTuple):
    """A robot on a ground."""

    profile: Profile  # profile of the robot
    friction: float  # friction of tyre on ground [1], instead of the profile's
    known: EkfSettings  # filter that was commissioned on the profile's own ground

    def robot(self, timestep: float) -> ClosedLoopRobot:
        """Return the MuJoCo robot on this ground, with a physics step [s]."""
        section = self.profile.plants["mujoco"]
        parameters = replace(section.parameters, friction=self.friction, timestep=timestep)
        return ClosedLoopRobot("mujoco", MujocoPlant(parameters, section.drive))

    def filters(self, bias: float) -> dict[str, tuple[bool, float, EkfSettings]]:
        """Return whether it has a gyro, the gyro's bias [rad/s] and the settings, by the name of the filter."""
        section = self.profile.plants["mujoco"]
        drivers = odometry_of(section.drive)
        true = replace(drivers, radius=section.parameters.wheel_radius)
        return {
            "wheels": (False, 0.0, drivers),
            "wheels + gyro": (True, 0.0, drivers),
            "biased gyro": (True, bias, drivers),
            "radius known": (True, 0.0, true),
            "commissioned": (True, 0.0, self.known),
            "commissioned, biased": (True, bias, self.known),
        }


class Drift(NamedTuple):
    """Errors of a filter after one drive."""

    position: float  # error of the relative position over stretches of `DRIFT_STRETCH`, over their length [1]
    yaw: float
    """Error of the relative yaw over the same stretches, over what the robot turned in them [1]; NaN if it did not turn."""
    end: float  # error of the position at the end, over the whole distance [1]
    end_yaw: float  # error of the yaw at the end, signed [rad]


_DRIFTS = ("position{}_share", "yaw{}_share", "end{}_share", "end_yaw{}_rad")  # columns of a `Drift`


def drift_of(believed: Trajectory, truth: Trajectory) -> Drift:
    """Return the errors of a filter.

    Args:
        believed: the filter's motion at the instants of `truth`.
        truth: the robot's motion, at least `DRIFT_STRETCH` long.

    Raises:
        ValueError: the drive is too short.
    """
    along = travelled(truth.xy)
    count = int(along[-1] / DRIFT_STRETCH + 1e-9)
    if count < 1:
        raise ValueError(f"a drive of {along[-1]:.2f} m is shorter than the {DRIFT_STRETCH:g} m over which drift is taken")
    ends = np.minimum(np.searchsorted(along, DRIFT_STRETCH * np.arange(count + 1) - 1e-9), len(along) - 1)
    first, last = ends[:-1], ends[1:]
    error = relative(truth.pose[first], truth.pose[last]) - relative(believed.pose[first], believed.pose[last])
    turned = np.cumulative_sum(np.abs(np.diff(truth.pose[:, 2])), include_initial=True)
    turn = float(turned[ends[-1]] - turned[ends[0]])
    off = believed.pose[-1] - truth.pose[-1]
    return Drift(
        float(np.hypot(error[:, 0], error[:, 1]).sum() / (along[ends[-1]] - along[ends[0]])),
        float(np.abs(wrap_angle(error[:, 2])).sum() / turn) if turn > _LEAST_TURN else math.nan,
        float(np.hypot(off[0], off[1]) / along[-1]),
        float(off[2]),
    )


def _drive(o: FilterStudy, case: tuple[str, str, FilterGround, Waypoints]) -> Row:
    """Return the truth of one reference on one ground, and rows of drift and errors over the distance by filter."""
    reference, surface, ground, waypoints = case
    robot, loop = ground.robot(o.timestep), LoopSettings("truth", disturbance=False, position_period=_TICK)
    law = make_controller(ground.profile, load_gains(TRACKER, DEFAULT))
    (run,) = run_robots([robot], [law], [loop], waypoints, [0], 1)
    truth = run.require_kept(f"{TRACKER} on {reference}, {surface},").motion
    along, rows, errors = travelled(truth.xy), list[Row](), dict[str, FloatArray]()
    for name, (gyro, bias, settings) in ground.filters(o.bias).items():
        found = [_estimate(o, truth, k, gyro, bias, settings) for k in range(o.seeds)]
        drifts = np.array([drift for drift, _ in found])
        means, stds = drifts.mean(axis=0), drifts.std(axis=0, ddof=1) if o.seeds > 1 else np.zeros(4)
        spread = {k.format(part): float(v[n]) for n, k in enumerate(_DRIFTS) for part, v in (("", means), ("_std", stds))}
        rows.append({"reference": reference, "surface": surface, "filter": name, **spread})
        errors[name] = np.array([error for _, error in found])
    slide = math.sqrt(np.mean(np.square(truth.twist[:, 1])) / np.mean(np.square(truth.twist[:, 0])))
    turned = float(np.abs(np.diff(truth.pose[:, 2])).sum())
    driven = {"reference": reference, "surface": surface, "distance_m": float(along[-1]), "turned_rad": turned}
    return {"driven": {**driven, "slide_share": slide}, "rows": rows, "errors": errors}


def _estimate(
    o: FilterStudy, truth: Trajectory, k: int, gyro: bool, bias: float, settings: EkfSettings
) -> tuple[Drift, FloatArray]:
    """Return the drift of a filter with the k-th draw of the noise, and (_CURVE,) errors of its position [m]."""
    rng, sensors = np.random.default_rng([o.seed, k]), SensorModel(gyro_bias=bias)
    log = simulate_sensors(truth, rng, sensors)
    begins = zeroed(settings, gyro_at_rest(sensors.packed(), rng, o.stands))
    believed = run_ekf(log.t, log.left, log.right, log.gyro if gyro else None, begins, _start(truth))
    seen = np.searchsorted(truth.t, log.t - 1e-9)
    then = Trajectory(truth.t[seen], truth.pose[seen], truth.twist[seen], truth.wheels[seen])
    off, along = np.hypot(*(believed.xy - then.xy).T), travelled(truth.xy)
    return drift_of(believed, then), np.interp(np.linspace(0.0, along[-1], _CURVE), along[seen], off)


def _start(truth: Trajectory) -> State:
    (x, y, yaw), (v, _, w) = truth.pose[0].tolist(), truth.twist[0].tolist()
    return State(x, y, yaw, v_x=v, yaw_rate=w)


@cli.program(FilterStudy)
def study_filter(o: FilterStudy) -> Report:
    """Measure how fast the pose drifts that the state filter estimates from wheels and gyro.

    Raises:
        LostError: a robot left the reference.
        ValueError: a profile or a reference cannot be read, or numbers do not go together.
    """
    chosen = [choose_profile(name, o.robot, "thesis-lab") for name in o.profiles]
    usual = [choose_profile(None, o.robot, name) for name in ("thesis-lab", "husky-tile")]
    profiles = {profile.name: profile for profile in chosen or usual}
    missions = dict(open_reference(name, o.speed) for name in o.references)
    return drive_missions(list(profiles.values()), missions, o)


def drive_missions(profiles: Sequence[Profile], missions: Mapping[str, Waypoints], o: FilterStudy) -> Report:
    """Make the study with these profiles and references in place of those of the options, see `study_filter`."""
    loop = LoopSettings("truth", disturbance=False, position_period=_TICK)
    for name, waypoints in missions.items():
        make_clock(waypoints, loop, o.timestep)
        for profile in profiles:
            require_practicable(waypoints, profile.plants["mujoco"].drive, name)
        if waypoints.speed * waypoints.duration < 1.1 * DRIFT_STRETCH:
            raise ValueError(f"{name} is shorter than the {DRIFT_STRETCH:g} m over which drift is taken, with some to spare")
    known = {profile.name: commissioned(profile, "mujoco") for profile in profiles}
    grounds = {p.name: FilterGround(p, p.plants["mujoco"].parameters.friction, known[p.name]) for p in profiles}
    last = profiles[-1]
    grounds |= {f"{last.name}, friction {f:g}": FilterGround(last, f, known[last.name]) for f in o.frictions}
    drives = {f"{n}, {s}": (n, s, ground, waypoints) for n, waypoints in missions.items() for s, ground in grounds.items()}
    swept = sweep(drives, {"drive": partial(_drive, o)}, workers=o.workers, progress=o.progress)
    found = [row for row in swept.rows if "rows" in row]
    drift = (
        f"position and yaw: error of the relative pose over stretches of {DRIFT_STRETCH:g} m, in percent of their length "
        "and of what the robot turned in them; mean and standard deviation over seeds.\n"
        f"The biased gyro shows {o.bias:+g} rad/s at rest. end: at the end of the drive."
    )
    what = f"{', '.join(missions)} at {next(iter(missions.values())).speed:.3g} m/s, {o.seeds} seeds from {o.seed}"
    return Report(
        program="study", title=f"Dead reckoning, {what}", has_text=True, draw=partial(_draw, found),
        status=swept.status, sentences=swept.notes,
        tables=[
            Table("Drift", [drifted for row in found for drifted in row["rows"]], drift, group="surface"),
            Table("Drives", [row["driven"] for row in found], "slide: rms of the speed sideways over that ahead."),
        ],
        options={"seed": o.seed, "seeds": o.seeds, "bias": o.bias, "stands": o.stands, "timestep": o.timestep},
        document={
            "schema": "ssmr.study/1", "study": "filter", "profile": ", ".join(p.name for p in profiles),
            "robot": ", ".join(dict.fromkeys(p.robot.name for p in profiles)), "tracker": TRACKER, "window_m": DRIFT_STRETCH,
        },
    )  # fmt: skip


def _draw(found: Sequence[Row], study: Report) -> Figure:
    """Return the picture: error of the position over the distance, by drive and filter."""
    panels = [partial(_draw_errors, row) for row in found]
    rows = [drawing.side_by_side(3.0, panels[k : k + 4]) for k in range(0, len(panels), 4)]
    return picture(study, rows)


def _draw_errors(row: Row, ax: Axes) -> None:
    driven, least = row["driven"], 1e-3  # the filter starts without an error, and zero has no logarithm
    along = np.linspace(0.0, driven["distance_m"], _CURVE)
    for k, (name, errors) in enumerate(row["errors"].items()):
        shown = np.maximum(errors, least)
        ax.fill_between(along, shown.min(axis=0), shown.max(axis=0), color=f"C{k}", alpha=0.22, linewidth=0.0)
        ax.plot(along, np.median(shown, axis=0), color=f"C{k}", linewidth=1.5, label=name, gid=name)
    ax.set(yscale="log", xlabel="driven [m]", xlim=(0.0, driven["distance_m"]), ylim=(least, 5.0))
    ax.set_title(f"{driven['reference']}, {driven['surface']}: position error [m]", fontsize=8.5)
    drawing.plain_ticks(ax.yaxis)
    ax.legend(fontsize=7.0)
