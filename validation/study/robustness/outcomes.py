"""The outcomes of a robustness study: the errors of each run, and wheel loads."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ssmr.control.loop import ClosedRun, LoopSettings, draw, make_clock
from ssmr.control.tick import LOST
from ssmr.control.waypoints import Waypoints
from ssmr.errors import SsmrError
from ssmr.robot.drive import WHOLE_STEPS
from ssmr.types import Commands, Trajectory
from validation.bench.gains import GainSet
from validation.bench.loops import ClosedLoopRobot, rate
from validation.simulator.health import Health, check_health
from validation.simulator.plant import MujocoPlant


@dataclass(frozen=True)
class RunErrors:
    """The errors of one run. They are finite, also for a run that was lost."""

    d_rms_m: float
    """Root mean square distance from the reference's samples, all of them, to the driven path [m]."""
    e_rho_rms_m: float
    """Root mean square of how far the target is ahead of the robot; after a robot is lost this counts as `LOST` [m]."""
    lost_at_s: float | None
    """Time at which the robot was lost [s]; None if it was not."""

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


@dataclass(frozen=True, eq=False)
class ControllerRuns:
    """All runs of one controller with one set of gains."""

    gains: GainSet
    """Its gains."""
    errors: tuple[RunErrors, ...]
    """Errors of each run, in the order of the study's cases."""
    health: Health
    """Wheel loads of the first nominal run."""


def health_of(run: ClosedRun, waypoints: Waypoints, robot: ClosedLoopRobot, settings: LoopSettings, seed: int) -> Health:
    """Return the health of a run's wheel loads; the worst there is for a run in which the simulator gave up."""
    try:
        return check_health(driven_again(run, waypoints, robot, settings, seed).channels["wheel_load_N"])
    except SsmrError:
        return Health(0.0, 1.0)


def driven_again(
    run: ClosedRun, waypoints: Waypoints, robot: ClosedLoopRobot, settings: LoopSettings, seed: int
) -> Trajectory:
    """Drive the commands of a run again without feedback, and return the motion with its wheel loads.

    The disturbance is that of the run, so the motion is equal to the bit. It ends with the last whole period of the
    velocity loop.

    Raises:
        DivergedError: the simulator gave up.
    """
    assert isinstance(robot.body, MujocoPlant)
    clock = make_clock(waypoints, settings, robot.body.dt)
    commands = max(1, (len(run.t) - 1) * clock.position // clock.velocity)
    ticks = np.minimum(np.ceil(np.arange(commands) * clock.velocity / clock.position - WHOLE_STEPS), len(run.t) - 1)
    push = np.resize(draw(clock, settings, seed)[1], commands * clock.velocity)
    table = run.columns("v_cmd", "w_cmd")[ticks.astype(int)]
    return robot.body.run(Commands(settings.velocity_period, table), waypoints.start, robot.body.dt, push)
