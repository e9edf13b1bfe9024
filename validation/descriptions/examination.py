"""A robot, examined with its physics: what it does, why, and what would mend it.

A robot of others has its own physics; one of ours those of our model.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from ssmr.robot.ground import SkidTurn
from validation.descriptions.findings import Finding
from validation.descriptions.foreign_robot import ForeignRobot
from validation.descriptions.ladder import Rung, climb, together
from validation.descriptions.mjcf_text import MjcfText
from validation.descriptions.own_findings import own_findings
from validation.descriptions.own_robot import LOADS, OwnRobot
from validation.descriptions.trials import examine, in_words
from validation.simulator.checking import Measured

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
    numbers: dict[str, Any]
    """`own_physics` of robot.json; None for a number that no trial could show."""
    loads: list[float]
    """Loads of the four wheels at rest [N]; empty where it does not stand."""
    mended: str | None
    """The file with the changes that help; None where there are none."""


def examine_foreign(foreign: ForeignRobot, known: Sequence[Finding] = ()) -> Examined:
    """Drive an MJCF of others with its own physics, and try what would mend it.

    Args:
        foreign: the robot.
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
    after = before = examine(robot)
    rungs = list[Rung]()
    if text is not None:
        robot, rungs, after = climb(robot, text, foreign.files)
        before = robot.measures
    notes = [*robot.notes, *notes]
    if robot.given_rates:
        notes.append(
            "it has no servos that hold wheel rates on both sides: here its wheels turn at given "
            "rates, whatever torque that takes"
        )
    return Examined(
        sentences=[in_words(before), *notes],
        findings=own_findings(robot, rungs, after, text, known),
        numbers={key: before.get(key) for key in _KEYS},
        loads=[before[load] for load in LOADS if load in before],
        mended=text.edited(together(rungs)) if text is not None and rungs else None,
    )


# ------------------------------------------------------------------------- of our own model
MULTIPLIER_LIMIT = 0.02
"""Deviation of the multiplier from its closed form that a robot may have [1]."""


def model_findings(spot: SkidTurn | None, measured: Measured) -> list[Finding]:
    """Return what is wrong with a robot's MuJoCo model, by a slow turn on the spot.

    Args:
        spot: the turn by mechanics; None where its wheels do not carry it.
        measured: measurements on the model.
    """
    found = []
    multiplier = measured.multiplier
    if multiplier is None:
        found.append(
            Finding(
                "motor_weak",
                "fault",
                "the simulated robot did not turn once on the spot in twice the time that "
                "mechanics allows it",
            )
        )
    elif spot is not None and abs(multiplier / spot.multiplier - 1.0) > MULTIPLIER_LIMIT:
        found.append(
            Finding(
                "wheel_shape",
                "fault",
                f"the simulated robot turns with a multiplier of {multiplier:.3f}, and mechanics "
                f"says {spot.multiplier:.3f}",
                "keep the usual wheel_shape and timestep",
            )
        )
    if measured.lifted_share > 0.0:
        found.append(
            Finding(
                "hopping",
                "fault",
                f"a wheel leaves the ground in {100.0 * measured.lifted_share:.0f} % of a slow "
                "turn on the spot",
                "move the centre of mass to the middle and down, or lower the friction",
            )
        )
    return found
