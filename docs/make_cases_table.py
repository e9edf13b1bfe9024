"""Print how far each plant is from each answer of the cases, for the table of docs/why_drift.md.

Run from the project's root: `python docs/make_cases_table.py`. A dash means that the plant cannot
have the answer, or that its engine is not installed.
"""

from __future__ import annotations

import pytest

from tests.test_cases import ANSWERS, ENGINES, errors, possible

PLANTS = ("coulomb", "improved", "linear", "four_wheel", "mujoco", *ENGINES)


def measured(name: str, plant: str) -> dict[str, tuple[float, float]]:
    """Return error and tolerance of each number of an answer, at the steps of the tests."""
    try:
        return (
            errors(name, plant, 0.001 if name.startswith("energy") else 0.002)
            if possible(name, plant)
            else {}
        )
    except pytest.skip.Exception:
        return {}


def print_errors(name: str) -> None:
    """Print a line for each number of an answer."""
    answers = {plant: measured(name, plant) for plant in PLANTS}
    for key, limit in ANSWERS[name][0]["tolerance"].items():
        if any(key in numbers for numbers in answers.values()):
            each = " | ".join(
                f"{numbers[key][0]:.5f}" if key in numbers else "–" for numbers in answers.values()
            )
            print(f"| {name} | {key} | {limit} | {each} |", flush=True)


if __name__ == "__main__":
    print(f"| answer | number | at most | {' | '.join(PLANTS)} |")
    print("|---" * (3 + len(PLANTS)) + "|")
    for answer in ANSWERS:
        print_errors(answer)
