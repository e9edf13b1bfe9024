"""Sections of a replication on disk: what is kept comes back, and what cannot be read is run again."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ssmr.errors import SsmrError
from validation.replicate import ReplicationSettings
from validation.replicate.evidence import FIGURE_FOLDER, SECTION_FOLDER, Answer, Context, Findings, Picture, Section, Table
from validation.replicate.keeping import keep, kept, picture_bytes
from validation.report.tables import Cell, Grid
from validation.thesis.verdicts import Pair

SETTINGS, DIGEST = ReplicationSettings(), "0" * 64
PNG = b"\x89PNG\r\n\x1a\nno more"
FOUND = Findings(
    {
        "3.8": Table(
            "parameters", {"mu": {"value": Pair(0.3, 0.4, "spread", "1", 0.1, {"lower": 0.0, "upper": 1.0}, "why")}}
        ),
        "3.9": Table("distances", {"traj1": {"d_rms_m": Pair(0.1, 2.0, "at_least", "m", None, {"at_least": 1.0})}}),
    },
    {"a grid": Grid((("name", ""), ("value", "m")), (((Cell("a"), Cell("1.0", True)),),), 1, "title", "caption", 1)},
    ("a note",),
    (Picture("fake-a.png", "a caption"),),
    {"a": [1.0, None, {"b": "c"}]},
)
SECTION = Section("fake", "A section", ("3.8", "3.9"), ("seed",), lambda context: FOUND)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with one kept section."""
    out = tmp_path / "out"
    for name in (SECTION_FOLDER, FIGURE_FOLDER):
        (out / name).mkdir(parents=True)
    (out / FIGURE_FOLDER / "fake-a.png").write_bytes(PNG)
    keep(Context(SETTINGS, out, "fake", DIGEST, 1), Answer(SECTION, FOUND, 1.0, 2.0))
    return out


def section_file(folder: Path) -> Path:
    return folder / SECTION_FOLDER / "fake.json"


def test_what_is_kept_comes_back(folder: Path) -> None:
    assert kept(folder, SECTION, DIGEST) == Answer(SECTION, FOUND, 1.0, 2.0)
    assert kept(folder, SECTION, "1" * 64) is None


@pytest.mark.parametrize("text", ["", "{", "[]", "3", '{"schema": "ssmr.evidence/2"}', "\ud800"])
def test_what_is_no_section_is_run_again(folder: Path, text: str, caplog: pytest.LogCaptureFixture) -> None:
    section_file(folder).write_bytes(text.encode("utf-8", "surrogatepass"))
    assert kept(folder, SECTION, DIGEST) is None
    assert "the section is run again" in caplog.text


def test_findings_of_another_form_are_run_again(folder: Path) -> None:
    document = json.loads(section_file(folder).read_text(encoding="utf-8"))
    del document["findings"]["tables"]["3.8"]["rows"]["mu"]["value"]["ours"]
    section_file(folder).write_text(json.dumps(document), encoding="utf-8")
    assert kept(folder, SECTION, DIGEST) is None


def test_a_section_without_its_picture_is_run_again(folder: Path) -> None:
    (folder / FIGURE_FOLDER / "fake-a.png").unlink()
    with pytest.raises(SsmrError, match=r"fake-a\.png"):
        picture_bytes(folder / FIGURE_FOLDER, "fake-a.png")
    assert kept(folder, SECTION, DIGEST) is None
