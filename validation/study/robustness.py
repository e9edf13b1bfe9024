"""How well trackers keep MuJoCo robots on their path that differ from the robot of their profile (docs/robustness.md).

`validation.bench.mismatch` says by how much a robot may differ. Every set of gains drives the same robots with the same
noise: first each mismatch alone, under several seeds, which shows what the controller is sensitive to; then robots that are
drawn at random, which shows how its errors spread.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Annotated, Literal, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ssmr.control.laws import CONTROLLERS, LAWS, PLAIN_CONTROLLERS
from ssmr.control.loop import POSITION_PERIOD, ClosedRun, Feedback, LoopSettings, make_clock
from ssmr.control.tick import LOST
from ssmr.control.waypoints import Waypoints
from ssmr.parameters import require_in_range, require_within
from ssmr.robot.drive import WHOLE_STEPS
from ssmr.robot.vehicle import Drive
from validation import cli
from validation.bench.gains import DEFAULT, GainSet, load_gains, sets_of
from validation.bench.loops import ClosedLoopRobot, make_controller, rate, require_practicable, run_robots
from validation.bench.mismatch import STUDYING, Mismatch, draw_mismatches, mismatched, single_mismatches, spread
from validation.bench.waypoint_files import open_reference
from validation.plants.profile import odometry_of
from validation.report import drawing
from validation.report.columns import MILLIMETRES
from validation.report.report import Report
from validation.report.table import Row, Table
from validation.simulator.description import Robot, load_robot, with_robot
from validation.study.options import AS_NAMES, MOST_RUNS, StudyOptions, require_seeds
from validation.study.sweep import picture, sweep

_COARSE_PERIOD = 0.01  # of the position loop where the physics step does not divide the usual one [s]
_BATCH = 64  # robots that are driven at once, at most


class RobustnessCase(NamedTuple):
    """One run that every controller makes."""

    kind: Literal["nominal", "alone", "drawn"]  # the profile's own robot, one mismatch alone, or a robot drawn at random
    mismatch: Mismatch  # the difference between the robot and its profile
    seed: int  # seed of noise and disturbance


def draw_cases(runs: int, seeds: int, seed: int, robot: Robot) -> list[RobustnessCase]:
    """Return the runs of a study.

    Args:
        runs: number of runs. The nominal robot and the single mismatches come first; the remaining robots are drawn.
        seeds: number of noise seeds, counted from `seed`, for the nominal robot and for each single mismatch.
        seed: seed of the drawing, and first seed of noise. Each drawn robot has a noise seed of its own.
        robot: the robot that others differ from.

    Raises:
        ValueError: `runs` leaves fewer than 2 drawn robots.
    """
    noise = range(seed, seed + seeds)
    single = [RobustnessCase("nominal", Mismatch(), k) for k in noise]
    single += [RobustnessCase("alone", m, k) for m in single_mismatches(robot) for k in noise]
    left = runs - len(single)
    if left < 2:
        raise ValueError(
            f"{runs} runs are too few: wanted {len(single) + 2} or more, for {len(single)} drive one mismatch alone"
        )
    drawn = draw_mismatches(left, seed, STUDYING, robot)
    return [*single, *(RobustnessCase("drawn", m, seed + seeds + k) for k, m in enumerate(drawn))]


@dataclass(frozen=True, kw_only=True)
class RobustnessStudy(StudyOptions):
    """Options of the study of robustness."""

    controllers: Annotated[cli.Names, cli.option(metavar="NAME,...")] = PLAIN_CONTROLLERS
    """Controllers to test."""
    gains: Annotated[Mapping[str, GainSet] | tuple[str, ...], AS_NAMES] = ("published", "tuned", "robust")
    """Names of gain sets (published, manual, tuned, robust, default, or a profile's), of which each controller drives those
    that it has, or its defaults if it has none; or the path of a TOML file, for one controller. From Python also gain sets
    by any name."""
    reference: Annotated[str | Waypoints, cli.text_of("NAME|PATH")] = "generic"
    """Path to follow: line, circle, sine, generic, or a waypoint file."""
    speed: float = 0.25
    """Speed along the reference [m/s]."""
    runs: int = 200
    """Runs of each set of gains: single mismatches first, then robots that are drawn at random."""
    seeds: int = 4
    """Seeds of noise for each single mismatch."""
    bound: float = 0.5
    """A run has failed if its d_rms or the root mean square of its e_rho is greater than this [m]."""
    feedback: Annotated[Feedback, cli.option()] = "noisy"
    """Pose that the controllers see: the noisy one of the lab, the true one, or that of a state filter."""
    disturbance: Annotated[bool, cli.option(default="on")] = True
    """Push the robots' yaw at random (Sec. 3.4.5)."""
    timestep: float = 0.002
    """Physics step [s]; 5 ms change errors by less than 8 %, but make peaks of torque 1.8 times as high."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            ValueError: an unknown controller, no seeds, too few or too many runs, a bound or a step outside its range.
        """
        unknown = [name for name in self.controllers if name not in CONTROLLERS]
        if unknown or not self.controllers:
            raise ValueError(f"unknown controller '{', '.join(unknown)}'; there are: {', '.join(CONTROLLERS)}")
        require_seeds(self)
        require_within(self, ("runs",), 1, MOST_RUNS, whole=True)
        require_in_range(self, "timestep", 1e-5, 0.01)
        require_in_range(self, "speed", 0.0, 100.0, open_low=True)
        if not 0.0 < self.bound <= LOST:
            raise ValueError(f"bound {self.bound:g} m must be positive and at most {LOST:g} m, where a robot counts as lost")
        draw_cases(self.runs, self.seeds, self.seed, load_robot())
        self.loop()

    def loop(self, drive: Drive | None = None) -> LoopSettings:
        """Return feedback, noise and periods of a loop; a state filter knows the drive's odometry."""
        steps = POSITION_PERIOD / self.timestep
        period = POSITION_PERIOD if abs(steps - round(steps)) <= WHOLE_STEPS else _COARSE_PERIOD
        odometry = odometry_of(drive or Drive())
        return LoopSettings(self.feedback, filter=odometry, disturbance=self.disturbance, position_period=period)


class RunErrors(NamedTuple):
    """The errors of one run. They are finite, also for a run that was lost."""

    d_rms_m: float  # root mean square distance from the reference's samples, all of them, to the driven path [m]
    e_rho_rms_m: float
    """Root mean square of how far the target is ahead of the robot; after a robot is lost this counts as `LOST` [m]."""
    lost_at_s: float | None  # time at which the robot was lost [s]; None if it was not

    def failed(self, bound: float) -> bool:
        """Return whether the robot was lost, or an error is greater than `bound` [m]."""
        return self.lost_at_s is not None or max(self.d_rms_m, self.e_rho_rms_m) > bound


def errors_of(run: ClosedRun, waypoints: Waypoints, robot: ClosedLoopRobot, ticks: int) -> RunErrors:
    """Return the errors of a run that would have lasted `ticks` periods of the position loop."""
    if not run.lost:
        metrics = rate(run, waypoints, robot)
        return RunErrors(metrics["d_rms_m"], metrics["e_rho_rms_m"], None)
    kept = ClosedRun(run.t[:-1], run.table[:-1], True)  # the last tick is out of bounds and says nothing
    lost_at = float(run.t[-1]) if len(run.t) else 0.0
    if len(kept.t) < 2:
        return RunErrors(LOST, LOST, lost_at)
    squares = np.sum(np.minimum(np.square(kept.column("e_rho")), LOST**2)) + (ticks - len(kept.t)) * LOST**2
    return RunErrors(min(rate(kept, waypoints, robot)["d_rms_m"], LOST), math.sqrt(squares / ticks), lost_at)


@cli.program(RobustnessStudy)
def study_robustness(o: RobustnessStudy) -> Report:
    """Drive MuJoCo robots that differ from the robot of their profile, with every controller.

    Raises:
        SsmrError: the nominal robot cannot be driven.
        ValueError: gains, profile, step or reference do not exist or do not fit together.
    """
    profile = o.robot_profile()
    reference, path = open_reference(o.reference, o.speed) if isinstance(o.reference, str) else ("waypoints", o.reference)
    sets, remarks = (dict(o.gains), []) if isinstance(o.gains, Mapping) else _chosen_gains(o.controllers, o.gains)
    laws = {name: make_controller(profile, gains) for name, gains in sets.items()}
    require_practicable(path, profile.plants["mujoco"].drive, reference)
    ticks = make_clock(path, o.loop(), o.timestep).ticks
    cases = draw_cases(o.runs, o.seeds, o.seed, profile.robot)
    robots = {m: mismatched(profile, "mujoco", m, o.timestep) for m in {c.mismatch for c in cases}}
    crew = [robots[c.mismatch] for c in cases]
    loops, seeds = [o.loop(robot.drive) for robot in crew], [c.seed for c in cases]

    def drive(name: str) -> Row:
        errors: list[RunErrors] = []
        for part in (slice(first, first + _BATCH) for first in range(0, len(cases), _BATCH)):
            some = crew[part]
            runs = run_robots(some, [laws[name]] * len(some), loops[part], path, seeds[part], o.workers)
            errors += [errors_of(run, path, robot, ticks) for run, robot in zip(runs, some, strict=True)]
        return {"errors": errors}

    swept = sweep({name: name for name in laws}, {"runs": drive}, workers=1, progress=o.progress)  # a set is a population
    found: dict[str, list[RunErrors]] = {row["variant"]: row["errors"] for row in swept.rows}
    words = f"{reference} at {path.speed:.3g} m/s: {len(cases)} runs of each set of gains"
    whose = with_robot(profile.name, profile.robot.name)
    names = ("seed", "runs", "seeds", "bound", "feedback", "disturbance", "timestep")
    return Report(
        program="study", title=f"Robustness, profile {whose}, {words}", status=swept.status, sentences=remarks,
        tables=_tables(o.bound, cases, sets, found), options={name: getattr(o, name) for name in names},
        draw=partial(_draw, cases, found), has_text=True,
        document={
            "schema": "ssmr.study/1", "study": "robustness", "robot": profile.robot.name, "profile": profile.name,
            "reference": reference, "speed_m_s": path.speed, "parameters": profile.as_dict()["mujoco"],
            "gains": {name: {"controller": sets[name].controller, **sets[name].values} for name in found},
            "cases": [{"kind": c.kind, "seed": c.seed, **asdict(c.mismatch)} for c in cases],
            "runs": {name: [run._asdict() for run in errors] for name, errors in found.items()},
        },
    )  # fmt: skip


def _chosen_gains(controllers: Sequence[str], wanted: Sequence[str]) -> tuple[dict[str, GainSet], list[str]]:
    """Return the sets that each controller has of those that are wanted, by name, and remarks on those that have none.

    Raises:
        GainsError: no controller has such a set, or a file's is not this controller's.
    """
    chosen, remarks = dict[str, GainSet](), list[str]()
    for controller in controllers:
        some = [w for w in wanted if w in sets_of(controller) or not any(w in sets_of(c) for c in LAWS)]
        if not some:
            remarks.append(f"{controller} has no gains '{', '.join(wanted)}'; its defaults are used.")
        for own in (load_gains(controller, name) for name in some or [DEFAULT]):
            chosen[own.name] = own
    return chosen, remarks


def _tables(
    bound: float, cases: Sequence[RobustnessCase], sets: Mapping[str, GainSet], found: Mapping[str, Sequence[RunErrors]]
) -> list[Table]:
    """Return the spread of errors over the drawn robots, and the mean of d_rms under each mismatch alone."""
    over: list[Row] = []
    for name, errors in found.items():
        drawn = [e for c, e in zip(cases, errors, strict=True) if c.kind == "drawn"]
        parts = {
            f"{what}_{part}_m": value
            for what, values in (("d_rms", [e.d_rms_m for e in drawn]), ("e_rho", [e.e_rho_rms_m for e in drawn]))
            for part, value in spread(values).items()
        }
        counts = {"lost": sum(e.lost_at_s is not None for e in drawn), "failed": sum(e.failed(bound) for e in drawn)}
        over.append({"controller": sets[name].controller, "gains": name, **parts, **counts})
    alone: list[Row] = []
    for mismatch in dict.fromkeys(c.mismatch for c in cases if c.kind != "drawn"):
        which = [k for k, c in enumerate(cases) if c.kind != "drawn" and c.mismatch == mismatch]
        means = {f"{name}_m": float(np.mean([errors[k].d_rms_m for k in which])) for name, errors in found.items()}
        failed = {name: sum(errors[k].failed(bound) for k in which) for name, errors in found.items()}
        some = ", ".join(f"{name} {count}/{len(which)}" for name, count in failed.items() if count)
        alone.append({"mismatch": mismatch.label, **means, **({"failed": some} if any(failed.values()) else {})})
    caption = (
        "d_rms: distance from the reference to the robot's path; e_rho: root mean square of how far the moving target is "
        "ahead; cvar: mean of the worst fifth of the drawn robots.\n"
        f"Failed: lost, or one of both errors greater than {bound:g} m."
    )
    units = dict.fromkeys((key for row in (*over, *alone) for key in row if key.endswith("_m")), MILLIMETRES)
    return [
        Table("Errors over the drawn robots", over, caption, group="controller", units=units),
        Table("d_rms under each mismatch alone, mean over seeds of noise", alone, units=units),
    ]


def _draw(cases: Sequence[RobustnessCase], found: Mapping[str, Sequence[RunErrors]], study: Report) -> Figure:
    """Return the picture: how errors spread over the drawn robots, and what each mismatch alone does to d_rms."""

    def draw_spread(name: str, field: str, ax: Axes) -> None:
        """Draw the share of drawn robots whose error is below each abscissa, with crosses where a robot was lost."""
        for k, (gains, errors) in enumerate(found.items()):
            drawn = [e for c, e in zip(cases, errors, strict=True) if c.kind == "drawn"]
            values = sorted((1e3 * getattr(e, field), e.lost_at_s is not None) for e in drawn)
            share = np.arange(1, len(values) + 1) / len(values)
            ax.step([v for v, _ in values], share, where="post", color=f"C{k}", label=gains, gid=gains)
            lost = [(v, s) for (v, gone), s in zip(values, share, strict=True) if gone]
            ax.plot([v for v, _ in lost], [s for _, s in lost], "rx", ms=5.0, gid=f"{gains} lost" if lost else None)
        ax.set(xscale="log", xlabel=f"{name} [mm]", ylabel="share of the drawn robots", ylim=(0.0, 1.02))
        drawing.plain_ticks(ax.xaxis, (1.0, 2.0, 5.0))
        ax.legend(fontsize=8.0)

    def draw_alone(ax: Axes) -> None:
        rows = study.tables[1].rows
        drawing.inset(ax, left=1.2)
        for k, gains in enumerate(found):
            ax.plot([1e3 * row[f"{gains}_m"] for row in rows], range(len(rows)), "o", color=f"C{k}", ms=5.0, label=gains)
        ax.set_yticks(range(len(rows)), [row["mismatch"] for row in rows])
        ax.set(xscale="log", title="d_rms with each mismatch alone, mean over seeds of noise [mm]")
        drawing.plain_ticks(ax.xaxis, (1.0, 2.0, 5.0))
        ax.invert_yaxis()

    spreads = [partial(draw_spread, "d_rms", "d_rms_m"), partial(draw_spread, "e_rho", "e_rho_rms_m")]
    height = 1.0 + 0.19 * len(study.tables[1].rows)
    return picture(study, [drawing.side_by_side(3.6, spreads), drawing.side_by_side(height, [draw_alone])])
