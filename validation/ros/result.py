"""The result of a drive through ROS: that of tracking, and how the drive ended."""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum

from validation.bench.tracked import TrackedRobot
from validation.report.tracking import Tracked, tracking_report


class DriveStatus(StrEnum):
    """End of a drive."""

    ARRIVED = "arrived"
    INTERRUPTED = "interrupted"
    STOPPED = "stopped"


def drive_report(robot: TrackedRobot, status: DriveStatus, why: str = "") -> Tracked:
    """Return the report on a robot that was driven through ROS, as far as it came: that of tracking, and how it ended.

    Args:
        robot: the robot.
        status: how the drive ended.
        why: reason why the robot was stopped; empty if it arrived or the user interrupted.
    """
    report = tracking_report([robot], status=str(status))
    sentences = list(report.sentences)
    if status is not DriveStatus.ARRIVED:
        sentences.insert(
            0,
            f"The drive ended before the reference did ({status}): its path is compared with the whole reference, and "
            "the errors to the moving target cover the time until then.",
        )
    return replace(report, sentences=sentences, document={**report.document, "stopped_because": why})
