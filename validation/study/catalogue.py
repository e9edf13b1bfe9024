"""The table of studies: each is declared once, and the command line, the documentation and the tests read it here.

A study NAME is the module `validation.study.NAME`, which has the program `study_NAME`; or still a package of that name,
which exports a function `study_NAME(options, *, workers, progress)` that returns a `StudyResult`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, get_args, get_type_hints

from validation.cli.program import Program
from validation.report.report import Report
from validation.study.result import StudyResult


@dataclass(frozen=True)
class Study:
    """One study, declared."""

    name: str
    """Name of its module and of its command."""
    question: str
    """Question that the study answers, in one sentence."""

    @property
    def run(self) -> Callable[..., StudyResult | Report]:
        """The function that makes the study; its module is imported when this is asked for."""
        found: Callable[..., StudyResult | Report] = getattr(
            import_module(f"validation.study.{self.name}"), f"study_{self.name}"
        )
        return found

    @property
    def options(self) -> type[Any]:
        """The dataclass of its options: that of the program, or the type of the function's first parameter."""
        if isinstance(self.run, Program):
            return type(self.run.options())
        hint = get_type_hints(self.run)["options"]
        return next((kind for kind in get_args(hint) if kind is not type(None)), hint)


STUDIES = (
    Study("robustness", "How well do trackers keep a robot on its path that is not the robot they were given?"),
    Study("terrain", "Up to which speed, slope, roughness and loss of grip do planar models and trackers hold?"),
    Study("contact", "What does each physics setting of MuJoCo do to the simulated robot?"),
    Study("engines", "Do ODE, which is Gazebo's engine, and Drake move the robot as MuJoCo does, and with which settings?"),
    Study(
        "transfer",
        "Does an analytic model choose the right controller for the MuJoCo robot, and what does choosing by it cost?",
    ),
    Study("filter", "How fast does the pose drift that the state filter estimates from wheels and gyro?"),
    Study("drivetrain", "What are the driver, the friction, the losses and the inertia of a real robot's drive train?"),
    Study("noise", "How noisy is each signal of a log, by what a high-pass filter leaves of it (Sec. 3.4.4)?"),
)
"""Every study, in the order of the help text."""
