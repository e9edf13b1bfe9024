"""Errors of runs that began and failed, and of numbers that no robot has.

Other bad input raises a `ValueError`.
"""

from __future__ import annotations

from typing import Any


class SsmrError(RuntimeError):
    """Base of every failed run; `evidence` holds what a post-mortem needs."""

    def __init__(self, message: str, **evidence: Any) -> None:
        """Keep the message and, by name, the values that show what went wrong."""
        super().__init__(message)
        self.evidence = evidence


class ParameterError(ValueError):
    """A parameter lies outside its range, or parameters do not fit together."""


class DivergedError(SsmrError):
    """A simulation left the finite numbers or the simulator gave up.

    `evidence` says at which step and from which state.
    """


class ControllerError(SsmrError):
    """A Python controller raised an error, or its command is not two finite numbers."""
