"""A robot, examined with its physics: what it does, why, and what would mend it.

A robot of others has its own physics; one of ours those of our model.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from ssmr.errors import DivergedError
from ssmr.types import Commands, State
from validation.descriptions.balance import LEAST_TURN, LOADED, TURN, BalanceRow, in_words
from validation.descriptions.causes import Competition, together
from validation.descriptions.findings import Finding
from validation.descriptions.foreign_robot import ForeignRobot
from validation.descriptions.influences import weigh_influences
from validation.descriptions.mjcf_text import MjcfText
from validation.descriptions.own_robot import OwnRobot
from validation.output import Document, one_line
from validation.simulator.calibration import Calibration
from validation.simulator.checking import load_shares, spot_turn
from validation.simulator.description import GRAVITY, ROTOR_SHARE, WHEELS, Robot, free_drive
from validation.simulator.health import apparent_mass
from validation.simulator.plant import MujocoPlant
from validation.simulator.turning import (
    SAMPLE,
    SPIN_LEAD,
    closed_form,
    load_sensitivity,
    measure_spin,
    spin_on_spot,
)

_KEYS = (
    "multiplier",
    "multiplier_min",
    "multiplier_max",
    "closed_form",
    "droop",
    "creep_m_s",
    "rolls_m_s",
    "surge_share",
    "sideways_m",
    "step_halved_m",
    "load_ripple_share",
    "lifted_share",
)
"""Measures that robot.json has."""


class Examined(NamedTuple):
    """Result of an examination of a robot."""

    sentences: list[str]
    """Sentences on how the robot moves, and on what the examination assumed."""
    findings: list[Finding]
    """Faults and questions that its own physics show, with the changes that were tried."""
    numbers: Mapping[str, Any] = MappingProxyType({})
    """What robot.json says of it; None for a number that no trial could show."""
    loads: Sequence[float] = ()
    """Loads of the four wheels at rest [N]; empty where it does not stand."""
    balance: Sequence[BalanceRow] = ()
    """Rows of what is there beside what mechanics says."""
    closes: bool = False
    """Whether a driven balance closes, with the changes: what else might stop it is none."""
    mended: str | None = None
    """The file with the changes that help; None where there are none."""


def own_physics(measures: Mapping[str, Any]) -> Document:
    """Return what robot.json says of a robot with its own physics or in another engine."""
    numbers = {key: measures.get(key) for key in _KEYS}
    return {
        "own_physics": numbers,
        "turning_multiplier": numbers["multiplier"],
        "closed_form": numbers["closed_form"],
    }


def examine_foreign(
    described: Robot, foreign: ForeignRobot, known: Sequence[Finding] = ()
) -> Examined:
    """Drive an MJCF of others with its own physics, and try what would mend it.

    Args:
        described: the robot, as a file of ours has it.
        foreign: the same in its own file.
        known: what is wrong by its numbers alone.

    Raises:
        ValueError: it cannot be compiled on a ground.
        SsmrError: the simulator gave up for good.
    """
    text = None
    notes = []
    try:
        text = MjcfText(foreign.text, foreign.files)
    except ValueError as error:
        notes.append(f"no change was tried: {error}")
    robot = OwnRobot(foreign.text if text is None else text.edited({}), foreign.files)
    competition = Competition(robot, text, foreign.files, weigh_influences(described, foreign))
    robot = competition.robot
    notes = [*robot.notes, *notes]
    if robot.given_rates:
        notes.append(
            "it has no servos that hold wheel rates on both sides: here its wheels turn at given "
            "rates, whatever torque that takes"
        )
    measures = robot.measures
    kept = competition.kept
    findings = competition.findings(known)
    return Examined(
        sentences=[in_words(robot), *notes],
        findings=findings,
        balance=competition.rows(),
        closes=competition.closes,
        numbers=own_physics(measures),
        loads=robot.loads.tolist(),
        mended=text.edited(together(kept)) if text and kept else None,
    )


# ------------------------------------------------------------------------- of our own model
_TURN_LIMIT = 0.02
"""Deviation of the turn from its closed form that a robot may have beside what loads do [1]."""
_ON_GROUND = "time of the wheels on the ground"
"""Row of wheels that may leave the ground."""
_RIM_SPEED = 0.13
"""Speed of the rims in the measured turn over sqrt(g r) [1]: slow enough for mechanics without
inertia, and similar for robots of every size (Froude's similarity)."""
_TURNS = 2.2
"""Turns that mechanics expects in the measured time [1]; the motors lag a little behind."""
_STIFF_TIME = 2e-4
"""Time constant of the measuring motors [s]: a seventieth of that of robots. Wheels that have a
motor each, of which one skids and the other rolls, then turn equally to within half a percent."""
_STAND_TIME = 2.0
"""Time for which the robot stands before its loads are read [s]; the simulator has let it settle
before."""


def examine_model(robot: Robot) -> Examined:
    """Stand and turn our MuJoCo model of a robot on the spot; there may be none of its numbers."""
    try:
        calibration = Calibration.of(robot)
        plant = MujocoPlant(calibration, robot.motor_drive)
        loads = _standing_loads(plant)
        turn = _slow_spin(calibration)
    except DivergedError as error:
        failed = f"its simulation fails: {one_line(error)}"
        return Examined([], [Finding("step", "fault", failed, "look at masses, inertia and gain")])
    except ValueError as error:
        failed = f"no model can be built of it: {one_line(error)}"
        return Examined([], [Finding("model", "fault", failed)])
    numbers = {
        "turning_multiplier": turn.get("multiplier"),
        "yaw_ripple": turn.get("ripple"),
        "apparent_mass_kg": apparent_mass(plant.model),
    }
    rows = _model_rows(calibration, loads, turn)
    return Examined([], _model_findings(rows), numbers, loads, balance=rows)


def _standing_loads(plant: MujocoPlant) -> list[float]:
    """Return the mean loads of the four wheels of a robot that stands [N]."""
    period = plant.dt * max(round(SAMPLE / plant.dt), 1)
    zeros = np.zeros((round(_STAND_TIME / period), 2))
    loads = plant.run(Commands(period, zeros), State(), period).channels["wheel_load_N"]
    means: list[float] = loads[len(loads) // 2 :].mean(axis=0).tolist()
    return means


def _slow_spin(calibration: Calibration) -> dict[str, float]:
    """Return the measures of a slow turn on the spot, by name.

    The motors have no limit and delay, and are much stiffer than the robot's own, with rotors that
    are not light: the turn shows the robot, not them.
    """
    radius = calibration.wheel_radius
    size = calibration.mass * radius**2
    # a stiff motor makes a light wheel tremble
    armature = max(calibration.armature, ROTOR_SHARE * size)
    side_inertia = 0.5 * size + 2.0 * armature
    gain = max(calibration.gain, side_inertia / _STIFF_TIME)
    # the step must divide the period of samples
    step = SAMPLE / math.ceil(SAMPLE / calibration.timestep - 1e-9)
    stiff = replace(calibration, timestep=step, armature=armature, gain=gain)
    rate = _RIM_SPEED * math.sqrt(GRAVITY * radius) / calibration.half_track
    multiplier = min(closed_form(calibration).multiplier, 10.0)
    turn_time = _TURNS * 2.0 * math.pi * multiplier / rate
    seconds = 0.05 * math.ceil((SPIN_LEAD + turn_time) / 0.05)
    motion = spin_on_spot(MujocoPlant(stiff, free_drive(calibration.robot)), seconds, rate)
    return measure_spin(motion, stiff)


def _model_rows(
    calibration: Calibration, loads: list[float], turn: Mapping[str, float]
) -> list[BalanceRow]:
    """Return the balance of a robot's MuJoCo model: its loads and its slow turn."""
    robot = calibration.robot
    weight = robot.mass * GRAVITY
    rows = [BalanceRow("load of all wheels", sum(loads), weight, "N", weight)]
    for name, load, share in zip(WHEELS, loads, load_shares(robot).tolist(), strict=True):
        words = name.replace("_", " ")
        rows.append(
            BalanceRow(f"load of the {words} wheel", load, share * weight, "N", 0.25 * weight)
        )
    spot = spot_turn(robot)
    if spot is not None and spot.yaw_rate > 0.0:
        found = 90.0 / turn.get("multiplier", math.inf)
        wanted = 90.0 / spot.multiplier
        size = max(wanted, LEAST_TURN)
        # where it barely turns, its loads decide
        limit = _TURN_LIMIT + load_sensitivity(replace(calibration, wheel_shape="ellipsoid"))
        rows.append(BalanceRow(TURN, found, wanted, "°", size, limit))
    # a wheel that the weight leaves with little load lifts without hopping
    if 4.0 * load_shares(robot).min() > LOADED:
        rows.append(BalanceRow(_ON_GROUND, 1.0 - turn["lifted_share"], 1.0, "", 1.0, 0.01))
    return rows


def _model_findings(rows: Sequence[BalanceRow]) -> list[Finding]:
    """Return what is wrong with a robot's MuJoCo model, by its rows that are off."""
    found = []
    for row in rows:
        if row.excess > 1.0 and row.row == TURN:
            ratio = 90.0 / row.found if row.found > 0.0 else math.inf
            cause = f"the simulated robot turns with a multiplier of {ratio:.3f}, and "
            cause += f"mechanics says {90.0 / row.expected:.3f}"
            remedy = "keep the usual wheel_shape and timestep"
            found.append(Finding("wheel_shape", "fault", cause, remedy))
        if row.excess > 0.0 and row.row == _ON_GROUND:
            cause = (
                f"a wheel leaves the ground in {-100.0 * row.share:.0f} % of a slow turn on the "
            )
            remedy = "move the centre of mass to the middle and down, or lower the friction"
            found.append(Finding("hopping", "fault", f"{cause}spot", remedy))
    return found
