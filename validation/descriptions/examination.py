"""A robot, examined with its physics: what it does, why, and what would mend it.

A robot of others has its own physics; one of ours those of our model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

from validation.descriptions.balance import MOVING_MASS, ON_GROUND, BalanceRow, in_words
from validation.descriptions.causes import LEAST_STEP, Competition, together
from validation.descriptions.findings import Finding
from validation.descriptions.foreign_robot import ForeignRobot
from validation.descriptions.influences import weigh_influences
from validation.descriptions.mjcf_text import MjcfText
from validation.descriptions.own_robot import OwnRobot
from validation.output import Document, one_line
from validation.simulator.calibration import Calibration
from validation.simulator.description import Robot
from validation.simulator.exporting import mjcf_text
from validation.simulator.plant import MujocoPlant

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
    robot = OwnRobot(foreign.text, foreign.files, least_step=LEAST_STEP)
    weighed = weigh_influences(described, foreign)
    competition = Competition(robot, text, foreign.files, weighed, known)
    robot = competition.robot
    notes = [*robot.notes, *notes]
    if robot.given_rates:
        notes.append(
            "it has no servos that hold wheel rates on both sides: here its wheels turn at given "
            "rates, whatever torque that takes"
        )
    measures = robot.measures
    kept = competition.kept
    findings = competition.findings()
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
_OWN_REMEDIES = {
    "rate of a wheel": ("servo_soft", "raise simulation.gain"),
    ON_GROUND: (
        "hopping",
        "move the centre of mass to the middle and down, or lower the friction",
    ),
}
"""Kind and remedy of what is wrong with our model of a robot, by how the name of its row begins."""


def examine_model(robot: Robot, known: Sequence[Finding] = ()) -> Examined:
    """Drive our MuJoCo model of a robot as its exported file has it; its numbers may allow none.

    `known` is what is wrong by its numbers alone.
    """
    try:
        plant = MujocoPlant(Calibration.of(robot), robot.motor_drive)
        text = mjcf_text(plant.calibration, robot.motor_drive)
        competition = Competition(OwnRobot(text, {}), None, {}, (), known)
    except ValueError as error:
        failed = Finding("model", "fault", f"no model can be built of it: {one_line(error)}")
        # what cannot be has no model, and that is known
        return Examined([], [] if any(f.severity == "fault" for f in known) else [failed])
    driven = competition.robot
    measures = driven.measures
    if measures["diverged"]:
        cause = "its simulation fails: the state diverges"
        return Examined([], [Finding("step", "fault", cause, "look at masses, inertia and gain")])
    numbers = {
        "turning_multiplier": measures.get("multiplier"),
        "yaw_ripple": None,
        "apparent_mass_kg": competition.before[MOVING_MASS].found,
    }
    if "multiplier_max" in measures:
        apart = measures["multiplier_max"] - measures["multiplier_min"]
        numbers["yaw_ripple"] = apart / measures["multiplier"]
    findings = []
    for finding in competition.findings():
        row = next((row for row in _OWN_REMEDIES if finding.cause.startswith(row)), "")
        kind, change = _OWN_REMEDIES.get(row, (finding.kind, finding.change))
        findings.append(finding._replace(kind=kind, change=change))
    rows = competition.rows()
    return Examined([], findings, numbers, driven.loads.tolist(), rows)
