"""Which inputs of a log can drive plants along it, and what is left out of it before."""

from __future__ import annotations

from collections.abc import Callable

from validation.files.columns import COMMAND_COLUMNS
from validation.files.inspection import Inspected
from validation.identify.targets import Input

_UNCOMMANDED = 0.05
"""Share of time without a command in which wheels may turn [1]; beyond it commands say little."""


def choose_inputs(
    inspected: Inspected, trust: bool, warn: Callable[[str], object]
) -> tuple[Inspected, list[Input], list[str]]:
    """Return a log as a fit may see it, the inputs that can drive plants along it, and notes.

    Columns that contradict the others are left out where a fit does without them: a gyro, and
    commands beside wheel rates. The log is then looked at anew. Where it is refused, `warn` is
    called with all else that is wrong with it.

    Raises:
        ValueError: the columns contradict one another without them too and are not to be taken on
            `trust`, or nothing drives a plant.
    """
    name = inspected.log.name
    notes = []
    by_wheels = inspected.log.has(COMMAND_COLUMNS["wheels"])
    commands = COMMAND_COLUMNS["twist"] if by_wheels else ()
    for columns, loss in (
        (("gyro_z",), "The gyro is left out, so the localiser alone tells headings."),
        (commands, "The commands are not to be trusted, so the driver was not fitted."),
    ):
        if not trust and any({*columns} & {*fault.columns} for fault in inspected.fatal):
            inspected = Inspected(inspected.log.without(columns), inspected.radius)
            notes.append(loss)
    log = inspected.log
    lacks = inspected.lacks
    if (inspected.fatal or lacks) and not trust:
        others = [*(fault.sentence for fault in inspected.faults.named), *lacks]
        spoiled: dict[str, None] = {}
        for fault in inspected.fatal:
            spoiled |= dict.fromkeys(fault.columns)
        first = f"look at {', '.join(spoiled)} first" if spoiled else others.pop(-len(lacks))
        for sentence in others:
            warn(f"{name}: {sentence}")
        raise ValueError(f"{name}: {first}; --trust calibrates all the same")
    often = (inspected.faults.uncommanded_share or 0.0) > _UNCOMMANDED
    inputs = list[Input]()
    if by_wheels:
        inputs.append("wheels")
    if log.has(COMMAND_COLUMNS["twist"]) and not often:
        inputs.append("commands")
    if not inputs:
        raise ValueError(
            f"{name} has neither wheel rates, enc_left and enc_right, nor commands that drive it"
        )
    if often:
        notes.append("The wheels often turn without a command, so the driver was not fitted.")
    return inspected, inputs, notes
