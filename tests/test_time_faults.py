"""Robots that act at another time than they were told: `mpc` beside a pursuit of the path.

The lab's eight at 0.5 m/s, slowed to what the robot can follow, in MuJoCo with noise and pushes.
`python -m tests.test_time_faults` prints the table of docs/controllers.md.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from ssmr.control.loop import ClosedRun, LoopSettings, run_loop
from ssmr.control.mission import PythonController
from ssmr.control.waypoints import Waypoints, step_lengths
from ssmr.types import State
from tests.conftest import distances_to_path
from tests.test_peers import load_peers
from validation.experiment.loops import (
    chosen_controller,
    make_robot,
    slowed_to_feasible,
)
from validation.experiment.waypoint_files import open_reference
from validation.plants.profile import load_profile
from validation.simulator.plant import MujocoPlant

SEEDS = (2023, 2024, 2025)
REST = 10.0
"""Time behind the reference's end, in which every robot comes to rest [s]."""


@dataclass(frozen=True)
class TimeFault:
    """A fault of a robot of which its controller does not know."""

    extra: Callable[[float], float] = lambda t: 0.0
    """Further dead time of commands that arrive at a time [s]."""
    left: float = 0.0
    """Further dead time of the left side [s]."""
    lag: float = 0.0
    """Further time constant of the wheels [s]."""
    slips_from: float = math.inf
    """Time from which friction is 0.29 of what it was [s]."""


def drawn_delays() -> Callable[[float], float]:
    """Return dead times of up to 0.3 s, a new one every 0.1 s."""
    drawn = np.random.default_rng(7).uniform(0.0, 0.3, 1000)
    return lambda t: float(drawn[int(10.0 * t + 1e-9)])


FAULTS = {
    "as known": TimeFault(),
    "dead time + 0 to 0.3 s, new every 0.1 s": TimeFault(extra=drawn_delays()),
    "dead time + 0.15 ± 0.15 s, a sine of 4 s": TimeFault(
        extra=lambda t: 0.15 + 0.15 * math.sin(0.5 * math.pi * t)
    ),
    "dead time + 0.3 s": TimeFault(extra=lambda t: 0.3),
    "motors lag by 0.4 s more": TimeFault(lag=0.4),
    "the left side answers 0.3 s later": TimeFault(left=0.3),
    "friction × 0.29 from 6 s on": TimeFault(slips_from=6.0),
}


class FaultyPlant(MujocoPlant):
    """A robot in MuJoCo with a fault."""

    fault = TimeFault()

    def reset(self, state: State) -> State:
        """Forget commands that are under way."""
        self._steps = 0
        self._commands: list[tuple[float, float]] = []
        self._left: list[float] = []
        return super().reset(state)

    def step(self, command: tuple[float, float], dt: float, yaw_acceleration: float = 0.0) -> State:
        """Drive on for a time [s] as the fault has it."""
        assert self._driver is not None
        n = round(dt / self.dt)
        now = self._steps * self.dt
        self._commands += [(float(command[0]), float(command[1]))] * n
        acts = len(self._commands) - n - round(self.fault.extra(now) / self.dt)
        late = self._commands[acts] if acts >= 0 else (0.0, 0.0)
        references = self._driver.references(late, n).copy()
        self._left += references[:, 0].tolist()
        behind = round(self.fault.left / self.dt)
        for k in range(n):
            at = len(self._left) - n + k - behind
            references[k, 0] = self._left[at] if at >= 0 else 0.0
        if now >= self.fault.slips_from > now - dt:
            slippery = copy.copy(self.model)
            slippery.geom_friction[:, 0] *= 0.29
            slippery.pair_friction[:, :2] *= 0.29
            self._bodies._batch.set_models([slippery])
        self._steps += n
        self._bodies.advance(references[None], np.full((1, n), yaw_acceleration))
        return self._read()


@cache
def controllers() -> dict[str, PythonController]:
    mpc, _ = chosen_controller("mpc", load_profile("thesis-lab"))
    assert isinstance(mpc, PythonController)
    pursuit = replace(mpc, name="pursuit", make=load_peers().ShortPursuit)
    return {"mpc": mpc, "pursuit": pursuit}


@cache
def eight() -> Waypoints:
    robot = make_robot(load_profile("thesis-lab"), "mujoco")
    return slowed_to_feasible(open_reference("eight", 0.5)[1], robot)


@cache
def drive(law: str, fault: str, seed: int) -> ClosedRun:
    what = FAULTS[fault]
    section = load_profile("thesis-lab").plants["mujoco"]
    known = section.drive
    plant = FaultyPlant(section.parameters, replace(known, wheel_lag=known.wheel_lag + what.lag))
    plant.fault = what
    settings = LoopSettings(rest=REST)
    return run_loop(plant, controllers()[law].on(known), eight(), settings, seed)


def off_path(run: ClosedRun) -> float:
    """Return the root mean square, over the way driven, of the distances from the path [m]."""
    xy = run.columns("x", "y")
    ways = np.append(step_lengths(xy), 0.0)
    away = distances_to_path(xy, eight().xy)
    return float(np.sqrt(np.average(away**2, weights=ways)))


def mean_off_path(law: str, fault: str, seeds: Sequence[int] = SEEDS) -> float:
    """Return the mean of `off_path` over the seeds [m]."""
    return float(np.mean([off_path(drive(law, fault, seed)) for seed in seeds]))


SHORT = {
    "dead time + 0.3 s": "1.7 times: it makes up for its clock in bends",
    "dead time + 0 to 0.3 s, new every 0.1 s": "1.4 times, on ten seeds too",
}
"""Rows that miss the aim of 1.3 times, and why."""


@pytest.mark.parametrize(
    ("fault", "seeds"),
    [
        ("as known", SEEDS[:1]),
        *(
            pytest.param(
                fault,
                SEEDS,
                marks=[
                    pytest.mark.slow,
                    pytest.mark.xfail(fault in SHORT, strict=True, reason=SHORT.get(fault, "")),
                ],
            )
            for fault in FAULTS
        ),
    ],
)
def test_mpc_keeps_to_its_path_as_well_as_a_pursuit_that_follows_no_clock(
    fault: str, seeds: Sequence[int]
) -> None:
    assert mean_off_path("mpc", fault, seeds) <= 1.3 * mean_off_path("pursuit", fault, seeds)


def test_a_dead_time_that_changes_does_not_come_back_as_commands_at_their_limits() -> None:
    """With each command the plan for one dead time answers what another one did."""
    run = drive("mpc", "dead time + 0 to 0.3 s, new every 0.1 s", SEEDS[0])
    assert off_path(run) < 0.02
    assert np.mean(np.abs(run.column("w_cmd")) >= 0.999 * 2.0) < 0.05
    # it rests at the end: what it is beside it there, no command could mend without a manoeuvre
    x, y = run.columns("x", "y")[-1] - eight().xy[-1]
    heading = float(eight().headings[-1])
    assert abs(x * math.cos(heading) + y * math.sin(heading)) < 0.01
    assert abs(run.column("v_x")[-1]) < 0.01


def test_a_robot_as_it_is_known_ends_on_its_clock() -> None:
    """It is behind by its dead time at the start, and has made up for that."""
    run = drive("mpc", "as known", SEEDS[0])
    place = run.columns("x", "y")[np.searchsorted(run.t, eight().duration)]
    assert math.dist(place, eight().xy[-1]) < 0.1
    assert off_path(run) < 0.012


@pytest.mark.parametrize("turned", [math.pi, 2.0])
def test_speeds_are_those_of_the_path_also_from_a_start_that_is_turned(turned: float) -> None:
    profile = load_profile("thesis-lab")
    robot = make_robot(profile, "mujoco")
    law = controllers()["mpc"].on(robot.drive)
    start = replace(eight().start, yaw=eight().start.yaw + turned)
    run = run_loop(robot.plant, law, eight(), LoopSettings(rest=REST), 3, start)
    assert not run.lost
    fastest = float(eight().segment_speeds.max())
    # the command of 1.2 times that; this robot rolls on 3 % less than the driver's radius
    assert np.abs(run.column("v_cmd")).max() <= 1.2 * 1.035 * fastest
    assert math.dist(run.columns("x", "y")[-1], eight().xy[-1]) < 0.05


def main() -> None:
    """Print the table of docs/controllers.md."""
    print("| the robot | `mpc` | pursuit with our predictor |")
    print("|---|---:|---:|")
    for fault in FAULTS:
        cells = [f"{1e3 * mean_off_path(law, fault):.0f}" for law in controllers()]
        print(f"| {fault} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
