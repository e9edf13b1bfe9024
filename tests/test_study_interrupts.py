"""Ctrl-C in a study: what was finished is kept, whatever the study, and says that it is not all."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from tests.drive_train_logs import in_the_air, on_grass
from validation.output import Progress
from validation.study.__main__ import STUDIES, study_named
from validation.study.contact import ContactStudy
from validation.study.drivetrain import DriveTrainStudy
from validation.study.transfer import TransferStudy


def rows_of(study: Any) -> int:
    """The number of rows of a study's first table."""
    return len(study.tables()[0].rows)


SHORT: dict[str, tuple[Any, Callable[[Any], int], int]] = {
    "contact": (ContactStudy(only=("cone",)), rows_of, 1),
    "transfer": (
        TransferStudy(
            plants=("kinematic",), controllers=("pid:tuned", "lqr:tuned"),
            references=("line@0.8", "circle@0.8"),
        ),
        lambda s: len(s.document()["profiles"]["thesis-lab"]["references"]), 1,
    ),
    "drivetrain": (
        DriveTrainStudy(recording=in_the_air(), ground=on_grass()),
        lambda s: 1 + (s.document()["current_is"] is not None), 1,
    ),
}  # fmt: skip
"""Short options of each study, the function that counts its cases, and the progress at which the
first is finished."""


def test_every_study_is_here() -> None:
    assert {*SHORT} == {*STUDIES}


@pytest.mark.parametrize("study", SHORT)
def test_what_was_finished_is_kept(study: str, tmp_path: Path) -> None:
    options, cases, first = SHORT[study]

    def press(now: Progress) -> None:
        if now.done >= first:
            raise KeyboardInterrupt

    own = {field.name: getattr(options, field.name) for field in fields(options)}
    report: Any = study_named(study)(**{**own, "workers": 1, "progress": press})
    assert report.status == "interrupted"
    assert cases(report) == 1
    for path in report.save(tmp_path):
        assert path.stat().st_size
    assert (
        json.loads((tmp_path / "study.json").read_text(encoding="utf-8"))["status"] == "interrupted"
    )
    assert "interrupted; only what was finished before is here." in (
        tmp_path / "study.md"
    ).read_text(encoding="utf-8")
    assert report.table()
