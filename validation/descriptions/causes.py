"""Findings on a robot of others by its own physics, with changes that were tried."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from validation.descriptions.findings import Finding
from validation.descriptions.influences import STOPPING
from validation.descriptions.ladder import CURES, exceeds, pairs_of, together
from validation.descriptions.mjcf_text import Edits, MjcfText
from validation.descriptions.own_robot import LOADS, Measures, OwnRobot

_HARD = 0.05
"""Difference of two impedances or time constants that are not one [1]."""


def own_findings(
    robot: OwnRobot,
    changes: Mapping[str, Edits],
    after: Measures,
    text: MjcfText | None,
    known: Sequence[Finding] = (),
) -> list[Finding]:
    """Return what is wrong with a robot of others by its own physics, faults first.

    Args:
        robot: the robot after its trials.
        changes: the changes that help, by name.
        after: what the trials say with all of these together.
        text: its file, in which they stand; None where nothing can be changed.
        known: what is wrong by numbers alone; it is returned where a change was kept for it.
    """
    cured = set().union(*[CURES[name] for name in changes])
    looks = _LOOKS
    if not any(finding.severity == "fault" and finding.kind in STOPPING for finding in known):
        looks = (*_LOOKS, *_SYMPTOMS)
    looked = [look(robot) for look in looks]
    found = [finding for finding in known if finding.kind in cured]
    found += [finding for finding in looked if finding is not None]
    tried = []
    for finding in found:
        show = _SHOWN.get(finding.kind, _ratio)
        before = show(robot.measures)
        if finding.kind == "step" and robot.rescued:
            before = "it diverges"
        finding = finding._replace(before=before)
        kept = [edits for name, edits in changes.items() if finding.kind in CURES[name]]
        if kept and text is not None:
            change = _in_lines(together(kept), text)
            finding = finding._replace(change=change, after=show(after))
        tried.append(finding)
    return sorted(tried, key=lambda finding: finding.severity)


def _in_lines(edits: Edits, text: MjcfText) -> str:
    """Return edits as lines of the file and what to write there."""
    lines = dict[str, set[int]]()
    for part, values in edits.items():
        words = [f'{attribute}="{value}"' for attribute, value in values.items()]
        wanted = f"<{text.tag(part)} {' '.join(words)}>"
        lines.setdefault(wanted, set()).add(text.line(part))
    parts = []
    for wanted, numbers in lines.items():
        parts.append(f"line {', '.join(map(str, sorted(numbers)))}: {wanted}")
    return "; ".join(parts)


# ------------------------------------------------------------------------- what is shown
def _ratio(measures: Measures) -> str:
    if "multiplier" not in measures:
        return "it does not turn"
    low = measures.get("multiplier_min", measures["multiplier"])
    high = measures.get("multiplier_max", measures["multiplier"])
    text = f"turning ratio {measures['multiplier']:.2f}"
    return text if high - low < 0.02 else f"{text}, {low:.2f} to {high:.2f} over heading"


def _hops(measures: Measures) -> str:
    lifted = 100.0 * measures.get("lifted_share", 0.0)
    return f"{_ratio(measures)}, a wheel off the ground {lifted:.0f} %"


def _reached(measures: Measures) -> str:
    slow = 100.0 * (1.0 - measures.get("droop", 1.0))
    faster = 100.0 * (1.0 - measures.get("droop_at_speed", 1.0))
    return f"wheels reach {slow:.0f} % of a slow turn's rate, {faster:.0f} % of a faster one's"


def _speed(name: str, measures: Measures) -> str:
    return f"{1e3 * measures.get(name, math.nan):.2g} mm/s"


def _steps(measures: Measures) -> str:
    if measures["diverged"] > 0.0 or "step_halved_m" not in measures:
        return "it diverges"
    return f"half the step moves the end of a curve by {1e3 * measures['step_halved_m']:.0f} mm"


def _loads(measures: Measures) -> str:
    loads = [measures.get(name, math.nan) for name in LOADS]
    return f"wheels carry {', '.join(f'{load:.0f}' for load in loads)} N"


_SHOWN: dict[str, Callable[[Measures], str]] = {
    "hopping": _hops,
    "soft_on_one_geom": _hops,
    "servo_soft": _reached,
    "motor_weak": _reached,
    "creep": partial(_speed, "creep_m_s"),
    "rolls": partial(_speed, "rolls_m_s"),
    "step": _steps,
    "unlike_wheels": _loads,
}


# ------------------------------------------------------------------------- looks
def _step(robot: OwnRobot) -> Finding | None:
    step = 1e3 * robot.timestep
    if robot.rescued or robot.measures["diverged"] > 0.0:
        return Finding(
            "step",
            "fault",
            f"the simulation diverges with its step of {step:g} ms: servos or contacts are too "
            "stiff for it",
            "halve timestep until it does not, or set integrator to implicitfast",
        )
    if exceeds(robot, "lifted_share") or not exceeds(robot, "step"):
        return None
    return Finding(
        "step", "fault", f"the motion depends on the step of {step:g} ms", "halve timestep"
    )


def _pyramid(robot: OwnRobot) -> Finding | None:
    if robot.model.opt.cone == 1:
        return None
    return Finding(
        "pyramid",
        "fault",
        "friction is bounded by a pyramid along the world's axes, so the robot turns faster at "
        "some headings than at others, and drifts",
        'set cone="elliptic"',
    )


def _hopping(robot: OwnRobot) -> Finding | None:
    if not exceeds(robot, "lifted_share"):
        return None
    share = 100.0 * robot.measures["lifted_share"]
    return Finding(
        "hopping",
        "fault",
        f"wheels hop in a turn: one is off the ground {share:.0f} % of the time, because the "
        "contact is hard",
        "make the contact soft on tyres and ground, or on the tyres with a higher priority",
    )


def _bare_tyres(robot: OwnRobot) -> list[Any]:
    """Return the shapes of tyres whose contact no pair says."""
    geoms = [drum.geom for drum in filter(None, robot.tyres)]
    return [robot.wheeled.model.geom(geom) for geom in geoms if not pairs_of(robot, geom)]


def _soft_on_one(robot: OwnRobot) -> Finding | None:
    ground = robot.model.geom(robot.ground)
    for tyre in _bare_tyres(robot):
        if int(tyre.priority[0]) != int(ground.priority[0]):
            continue
        impedance = float(abs(tyre.solimp[0] - ground.solimp[0]))
        times = np.abs([tyre.solref[0], ground.solref[0]])
        if impedance > _HARD or float(np.ptp(times)) > _HARD * float(times.max()):
            return Finding(
                "soft_on_one_geom",
                "fault" if exceeds(robot, "lifted_share") else "question",
                f"the tyres' solimp starts at {tyre.solimp[0]:g} and the ground's at "
                f"{ground.solimp[0]:g}, and MuJoCo takes the mean of both geoms",
                "give the ground the same solimp and solref, or the tyres a higher priority",
            )
    return None


def _driven(robot: OwnRobot) -> Finding | None:
    if robot.driven.all():
        return None
    still = ", ".join(np.array(robot.names)[~robot.driven])
    return Finding(
        "driven",
        "question",
        f"no servo drives the wheels {still}: they roll along, and closed forms and models here "
        "have four driven wheels",
        "give each wheel a servo, or tie the wheels of a side",
    )


def _servo_soft(robot: OwnRobot) -> Finding | None:
    is_soft = exceeds(robot, "droop") or exceeds(robot, "droop_at_speed")
    if robot.given_rates or not is_soft or exceeds(robot, "saturated"):
        return None
    gains = [-float(robot.model.actuator(name).biasprm[2]) for name in robot.servos]
    return Finding(
        "servo_soft",
        "fault",
        f"the wheels' servos are too soft (kv is {min(gains):g}): they give way to the ground, "
        "which is no skidding, and no multiplier mends it at all speeds",
        "raise kv, with an armature that lets it be stiff",
    )


def _motor_weak(robot: OwnRobot) -> Finding | None:
    is_slow = exceeds(robot, "droop") or "multiplier" not in robot.measures
    if not exceeds(robot, "saturated") or not is_slow:
        return None
    share = 100.0 * robot.measures["saturated"]
    return Finding(
        "motor_weak",
        "fault",
        f"the motors are at their limit of force {share:.0f} % of the time in a turn on the spot",
        "raise forcerange, or lower the friction",
    )


def _creep(robot: OwnRobot) -> Finding | None:
    if not exceeds(robot, "creep"):
        return None
    return Finding(
        "creep",
        "fault",
        "at rest it slides down a slope of 8° though its wheels stand: the contact lets it slide",
        'raise impratio, with cone="elliptic"',
    )


def _rolls(robot: OwnRobot) -> Finding | None:
    if robot.given_rates or not exceeds(robot, "rolls"):
        return None
    return Finding(
        "rolls",
        "question",
        "at rest it rolls down a slope of 8°: its wheels turn, for a servo of rates holds a rate "
        "and not a place",
        "raise kv, or give the joints a frictionloss; impratio does not help",
    )


_LOOKS: Sequence[Callable[[OwnRobot], Finding | None]] = (
    _step,
    _pyramid,
    _soft_on_one,
    _driven,
)
_SYMPTOMS: Sequence[Callable[[OwnRobot], Finding | None]] = (
    _hopping,
    _servo_soft,
    _motor_weak,
    _creep,
    _rolls,
)
"""What a robot also does that something in its file holds or lifts: then that is the cause."""
