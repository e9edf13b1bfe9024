"""The appendices: what can be deleted without the rest noticing it.

An appendix is a room that no other room imports. This is the one list of what belongs to each.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain, product
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
APPENDICES: Mapping[str, Sequence[str]] = {
    "ros": (
        "validation/ros",
        "benchmarks/ros.py",
        "tests/test_ros*.py",
        "tests/ros_drive.py",
        "tests/ros_fakes.py",
        "tests/test_follower_faults.py",
        "docs/ros.md",
    ),
    "learning": (
        "validation/learning",
        "benchmarks/control.py",
        "tests/test_learning.py",
        "docs/learning.md",
        "docs/examples/learn_to_track.py",
        "docs/examples/learn_with_ppo.py",
    ),
    "study": (
        "validation/study",
        "tests/test_contact_study.py",
        "tests/test_drivetrain_*.py",
        "tests/test_study_*.py",
        "tests/test_transfer.py",
        "tests/golden/study-*.json",
        "docs/drivetrain.md",
        "docs/make_contact_figures.py",
        "docs/make_drivetrain_tables.py",
    ),
    "replicate": (
        "validation/replicate",
        "tests/test_agreement.py",
        "tests/test_errata.py",
        "tests/test_printed_*.py",
        "tests/test_published.py",
        "tests/test_replicate.py",
        "tests/test_verdicts.py",
        "tests/golden/replicate-*.json",
        "docs/errata.md",
        "docs/results.md",
        "docs/make_printed_figure.py",
    ),
    "benchmarks": (
        "benchmarks",
        "tests/test_benchmarks.py",
    ),
}
"""Every appendix by name: the patterns of its files, from the root, with its tests and pages."""


def room_of_appendix(name: str) -> str:
    """Return the room of an appendix, such as validation/ros."""
    return APPENDICES[name][0]


def gone_rooms() -> set[str]:
    """Return the rooms of the appendices that were deleted: tables of rooms do without them."""
    return {room_of_appendix(name) for name in APPENDICES if not is_there(name)}


def is_deleted(path: Path) -> bool:
    """Whether a path is missing because the appendix that it belongs to was deleted."""
    place = path.resolve().relative_to(ROOT)
    gone = chain.from_iterable(APPENDICES[name] for name in APPENDICES if not is_there(name))
    within = (place, *place.parents)
    return not path.exists() and any(p.match(pattern) for p, pattern in product(within, gone))


def is_possible(command: str) -> bool:
    """Whether a command, such as `study contact`, is of no appendix that was deleted."""
    program = command.split()[0]
    return program not in APPENDICES or is_there(program)


def is_there(name: str) -> bool:
    """Whether an appendix was not deleted."""
    return (ROOT / room_of_appendix(name)).is_dir()
